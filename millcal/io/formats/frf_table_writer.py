"""Writing an FRF as a table of text: one line for each frequency, the columns that `frf_table` reads.

Numbers have as many digits as it takes to get the same number back; what is not known is `nan`.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from millcal.data import Frf
from millcal.io.frf_units import SI_UNITS
from millcal.io.results import write_text_atomically


def write_frf_table(path: Path, frf: Frf) -> None:
    """Write an FRF as comma separated values; a pair that was not measured has no columns."""
    names, columns = zip(*_columns(frf), strict=True)
    said = {
        "form": frf.form,
        "unit": SI_UNITS[frf.form],
        "estimator": frf.estimator,
        "hits_used": ", ".join(str(n) for n in frf.hits_used),
        "usable_band_hz": ", ".join(repr(float(end)) for end in frf.usable_band),
    }
    if frf.damping_shift:
        said["damping_shift_per_s"] = repr(float(frf.damping_shift))
    lines = [f"# {key} = {value}" for key, value in said.items()]
    lines.append(",".join(_quoted(name) for name in names))
    lines += [",".join(map(repr, row)) for row in np.stack(columns, axis=1).tolist()]
    write_text_atomically(Path(path), "\n".join(lines) + "\n")


def _columns(frf: Frf) -> Iterator[tuple[str, np.ndarray]]:
    """Header cell and numbers of each column."""
    yield "frequency_hz", frf.frequency
    unit = SI_UNITS[frf.form]
    for i, one in enumerate(frf.inputs):
        for o, output in enumerate(frf.outputs):
            values = frf.values[:, o, i]
            if not np.isfinite(values).any():
                continue
            yield f"{output}/{one} re [{unit}]", values.real
            yield f"{output}/{one} im [{unit}]", values.imag
            for what, array in (("coherence", frf.coherence), ("variance", frf.variance)):
                if array is not None and np.isfinite(array[:, o, i]).any():
                    yield f"{output}/{one} {what}", array[:, o, i]
    if frf.multiple_coherence is not None:
        for o, output in enumerate(frf.outputs):
            yield f"{output} multiple_coherence", frf.multiple_coherence[:, o]
    if frf.force_spectrum is not None:
        for i, one in enumerate(frf.inputs):
            yield f"{one} force_spectrum [N s]", frf.force_spectrum[:, i]


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name
