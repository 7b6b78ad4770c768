"""Writing an FRF as a universal file: a header, the units (SI), and one function for each pair and each coherence.

The fields of a record are short: ten letters for a name, six digits for a frequency step. What they cut off stands in the
record's free lines, from where `millcal` takes it again; other programs show these lines and do not mind. A text record
holds 13 digits of each number, a binary one all of them. No clock: the same FRF gives the same bytes.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from millcal import __version__
from millcal.data import Frf
from millcal.io.formats.uff import SI
from millcal.io.formats.uff_dofs import nodes_of
from millcal.io.formats.uff_frf import COHERENCE, FRF, MULTIPLE_COHERENCE, OURS, TRANSMISSIBILITY
from millcal.io.formats.universal_records import Dof
from millcal.io.frf_units import QUANTITY_OF
from millcal.io.replacing import replaced_atomically

_DATA_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
_EVEN = 1e-9  # of a step: lines this close to even ones are written as such
_NO_DOF = Dof("", 0, 0)


def write_universal(path: Path, frf: Frf, *, binary: bool = False) -> None:
    """Write an FRF; a pair that was not measured has no record.

    binary : numbers as they are in memory (58b), a third of the size and without rounding
    """
    nodes = nodes_of((*frf.outputs, *frf.inputs))
    with replaced_atomically(Path(path)) as temporary, open(temporary, "wb") as file:
        file.write(_header(frf) + _units())
        for number, (kind, names, dofs, values) in enumerate(_functions(frf, nodes), start=1):
            file.write(_function(frf, number, kind, names, dofs, values, binary))


def _functions(frf: Frf, nodes: dict[str, Dof]) -> Iterator[tuple[int, list[str], tuple[Dof, Dof], np.ndarray]]:
    """Function type, names, dofs and values of every record."""
    of_pairs = TRANSMISSIBILITY if frf.form == "transmissibility" else FRF
    for array, kind in ((frf.values, of_pairs), (frf.coherence, COHERENCE)):
        if array is None:
            continue
        for i, one in enumerate(frf.inputs):
            for o, output in enumerate(frf.outputs):
                if np.isfinite(array[:, o, i]).any():
                    yield kind, [output, one], (nodes[output], nodes[one]), array[:, o, i]
    if frf.multiple_coherence is not None:
        for o, output in enumerate(frf.outputs):
            if np.isfinite(frf.multiple_coherence[:, o]).any():
                yield MULTIPLE_COHERENCE, [output], (nodes[output], _NO_DOF), frf.multiple_coherence[:, o]


def _header(frf: Frf) -> bytes:
    """Dataset 151, without dates."""
    lines = ["NONE", f"{frf.form} {', '.join(frf.outputs)} over {', '.join(frf.inputs)}", f"millcal {__version__}"]
    lines += [f"{'':20}{0:10d}{0:10d}{0:10d}", "", f"millcal {__version__}", ""]
    return _dataset("   151", [line[:80] for line in lines])


def _units() -> bytes:
    """Dataset 164: SI."""
    factors = [f"{x:.17E}".replace("E", "D") for x in (1.0, 1.0, 1.0, 273.15)]
    return _dataset(
        "   164",
        [f"{1:10d}{'Meter (newton)':20}{2:10d}", "".join(f"{x:>25}" for x in factors[:3]), f"{factors[3]:>25}"],
    )


def _dataset(number: str, lines: list[str]) -> bytes:
    return "".join(f"{line}\n" for line in ["    -1", number, *lines, "    -1"]).encode("ascii", "replace")


def _function(
    frf: Frf, number: int, kind: int, names: list[str], dofs: tuple[Dof, Dof], values: np.ndarray, binary: bool
) -> bytes:
    """One dataset 58 or 58b."""
    *_, even = even_lines(frf.frequency)
    parts = [values.real, values.imag] if np.iscomplexobj(values) else [values]
    table = np.stack(parts if even else [frf.frequency, *parts], axis=1)
    header = "".join(f"{line:<80}\n" for line in _header_lines(frf, number, kind, names, dofs, values))
    if binary:
        data = table.astype("<f8").tobytes()
        mark = f"    58b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
        return f"    -1\n{mark}\n{header}".encode("ascii", "replace") + data + b"    -1\n"
    text = "".join(f"{line}\n" for line in _text_lines(table, even))
    return f"    -1\n    58\n{header}{text}    -1\n".encode("ascii", "replace")


def _header_lines(
    frf: Frf, number: int, kind: int, names: list[str], dofs: tuple[Dof, Dof], values: np.ndarray
) -> list[str]:
    """Records 1 to 11."""
    first, step, even = even_lines(frf.frequency)
    of_pairs = kind in (FRF, TRANSMISSIBILITY)
    what = frf.form if of_pairs else "coherence" if kind == COHERENCE else "multiple coherence"
    lines: dict = {"lines": [first, step]} if even else {}
    lines["band"] = _band(frf)
    words: dict = {"estimator": frf.estimator}
    if of_pairs and any(frf.hits_used):
        words["hits"] = int(frf.hits_used[frf.inputs.index(names[1])])
    if frf.damping_shift:
        words["shift"] = frf.damping_shift
    identity = f"{kind:5d}{number:10d}{0:5d}{0:10d}"
    for dof in dofs:
        identity += f" {dof.entity or 'NONE':<10}{dof.node:10d}{dof.direction:4d}"
    quantity = QUANTITY_OF[frf.form]
    above = _axis(_DATA_TYPES[quantity], quantity.capitalize(), SI[quantity])
    return [
        f"{what} {'/'.join(names)}"[:80],
        _free_line({"pair": names} if len(names) == 2 else {}),
        "NONE",
        _free_line(lines),
        _free_line(words),
        identity,
        f"{6 if np.iscomplexobj(values) else 4:10d}{len(values):10d}{int(even):10d}"
        f"{_in_13(first if even else 0.0)}{_in_13(step if even else 0.0)}{_in_13(0.0)}",
        _axis(18, "Frequency", "Hz"),
        above if of_pairs else _axis(1, what.capitalize(), "NONE"),
        _axis(13, "Force", "N") if of_pairs else _axis(0, "NONE", "NONE"),
        _axis(0, "NONE", "NONE"),
    ]


def _band(frf: Frf) -> list:
    """The usable band as the numbers of its first and last line where it ends on lines, else in Hz."""
    ends = [int(np.argmin(np.abs(frf.frequency - end))) for end in frf.usable_band]
    on_lines = all(frf.frequency[k] == end for k, end in zip(ends, frf.usable_band, strict=True))
    return ends if on_lines else [float(f"{end:.9g}") for end in frf.usable_band]


def _free_line(words: dict) -> str:
    """Words for our own reader in a free line; the last ones go where the line is too long for all."""
    kept = dict(words)
    while kept and len(line := OURS + json.dumps(kept, separators=(",", ":"))) > 80:
        kept.popitem()
    return line if kept else "NONE"


def _axis(kind: int, label: str, unit: str) -> str:
    """Records 8 to 11: data type, no exponents (SI by dataset 164), label and unit."""
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}"


def even_lines(frequency: np.ndarray) -> tuple[float, float, bool]:
    """First line and step of even lines in Hz, and whether they are even; the step that gives them back to the last digit."""
    first, n = float(frequency[0]), len(frequency)
    steps = [float(frequency[1] - frequency[0]), float(frequency[-1] - frequency[0]) / (n - 1)]
    if frequency[1]:
        steps.append(float(frequency[-1] / round(frequency[-1] / steps[1])))
    for step in steps:
        if np.array_equal(first + step * np.arange(n), frequency):
            return first, step, True
    even = bool(np.all(np.abs(first + steps[1] * np.arange(n) - frequency) <= _EVEN * steps[1]))
    return first, steps[1], even


def _in_13(value: float) -> str:
    """A number in 13 columns, with more digits than E13.5 where it needs them and a blank before it."""
    if float(f"{value:.5E}") == value:
        return f"{value:13.5E}"
    for digits in range(12, 4, -1):
        plain = f"{value:.{digits}g}"
        text = plain.upper() if "." in plain or "e" in plain else plain + "."
        if len(text) <= 12:
            return f"{text:>13}"
    return f"{value:13.5E}"


def _text_lines(table: np.ndarray, even: bool) -> Iterator[str]:
    """Record 12 as text: 4E20.12 for even lines, E13.5 and E20.12 for the others.   table : (value, part)"""
    if even:
        flat = table.ravel()
        for start in range(0, len(flat), 4):
            yield "".join(_in_20(x) for x in flat[start : start + 4])
        return
    per_line = 2 if table.shape[1] == 2 else 1
    for start in range(0, len(table), per_line):
        rows = table[start : start + per_line]
        yield "".join(_in_13(row[0]) + "".join(_in_20(x) for x in row[1:]) for row in rows)


def _in_20(value: float) -> str:
    return f"{value:20.12E}" if np.isfinite(value) else f"{'NaN':>20}"
