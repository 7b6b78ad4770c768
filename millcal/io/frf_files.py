"""One door for the FRF files of millcal and of other programs, in and out.

    Frf = read_frf("tip.uff")
    Frf = read_frf(["x.frf", "y.frf"], outputs=["tipX", "tipY"], inputs=["tipX", "tipY"])
    write_frf("tip.uff", frf, binary=True)

Read are results of millcal and the plain FRF file of the contract (HDF5), universal files (58 and 58b), tables of text
whose header names the columns, and the three bare columns of CutPro. What a file does not say of form, unit and dofs
must be stated; nothing is guessed in silence. A driving point that gives power back is told, with its cause where the
impulse response shows it.

Written are HDF5, UFF, CSV and CutPro's files, by the suffix. What a format cannot hold is told.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from millcal.data import Frf, Notice
from millcal.errors import RecordingError
from millcal.io.formats import cutpro, uff
from millcal.io.formats.dialect import HEAD as SNIFFED
from millcal.io.formats.foreign import refuse_foreign
from millcal.io.formats.frf_table import is_frf_table, read_frf_table
from millcal.io.formats.frf_table_writer import write_frf_table
from millcal.io.formats.hdf5 import SIGNATURE, number_of, opened, text_of
from millcal.io.formats.uff_frf import holds_frf, measured_of
from millcal.io.formats.uff_writer import write_universal
from millcal.io.formats.universal import is_universal, read_universal
from millcal.io.frf_doubts import doubts
from millcal.io.frf_pairs import Measured, Pair, bare_dof, joined, pairs_of, problems_of, renamed
from millcal.io.frf_units import SI_UNITS, stated_unit
from millcal.io.results import FORMAT, read_result, write_result
from millcal.physics.structure import DERIVATIVES, convert_frf, convert_frf_variance

HEAD = 4096  # bytes by which a format is recognised
SUFFIXES = {".h5": "hdf5", ".hdf5": "hdf5", ".uff": "uff", ".unv": "uff", ".csv": "csv", ".frf": "cutpro"}


class Written(NamedTuple):
    """What was written."""

    paths: tuple[Path, ...]
    notices: tuple[Notice, ...]  # what the format could not hold


def read_frf(
    path: Path | str | Sequence[Path | str],
    *,
    form: str | None = None,
    unit: str | None = None,
    outputs: str | Sequence[str] | None = None,
    inputs: str | Sequence[str] | None = None,
    conjugate: bool = False,
    band: tuple[float, float] | None = None,
) -> Frf:
    """Read an FRF from one file of any known format, or from several that hold its pairs.

    form : accelerance, mobility, receptance or transmissibility; wins over what a file says
    unit : of the numbers, `g/N`, `m/s^2/N`, `m/N`; wins over what a file says, and tells the form
    outputs, inputs : dofs, in the order of the files where each holds one pair (or one for all), else in that of the
        dofs in the file; a sign in front, `-tipX`, turns the values
    conjugate : the file was written with the other sign of the imaginary part, x = Re X e^{-jwt}
    band : usable, Hz; wins over what a file says
    raises RecordingError for a file that is damaged, or that does not say what is not stated either
    """
    paths = [Path(path)] if isinstance(path, (str, Path)) else [Path(one) for one in path]
    if not paths:
        raise RecordingError("frf: no file given; name at least one")
    stated_unit(form, unit)
    if len(paths) == 1 and form is unit is outputs is inputs is band is None and not conjugate:
        own = _own_result(paths[0])
        if own is not None:
            return own
    files = renamed([_measured(one, form, unit) for one in paths], _names(outputs), _names(inputs))
    if conjugate:
        files = [replace(f, pairs=tuple(replace(p, values=p.values.conj()) for p in f.pairs), tests=()) for f in files]
    frf = joined(files)
    if band is not None:
        frf = replace(frf, usable_band=_band(band, frf))
    return replace(frf, notices=tuple(dict.fromkeys([*frf.notices, *doubts(frf, str(paths[0]))])))


def _names(given: str | Sequence[str] | None) -> Sequence[str]:
    return () if given is None else (given,) if isinstance(given, str) else tuple(given)


def _band(band: tuple[float, float], frf: Frf) -> tuple[float, float]:
    low, high = float(band[0]), float(band[1])
    if not low < high or low > frf.frequency[-1] or high < frf.frequency[0]:
        raise RecordingError(
            f"--band {low:g} {high:g}: no part of the lines from {frf.frequency[0]:g} to {frf.frequency[-1]:g} Hz; "
            "give the lowest and the highest frequency"
        )
    return low, high


def is_frf_file(path: Path) -> bool:
    """Whether a file holds an FRF and no recording, by what it says; for a text without a header by its name or numbers."""
    path = Path(path)
    head = _head(path)
    if head.startswith(SIGNATURE):
        return _is_frf_hdf5(path)
    if is_universal(head):
        found = read_universal(path)
        return holds_frf(found) and not uff.holds_time_records(found)
    if path.suffix.lower() == ".frf":
        return True
    if b"\x00" in head:
        return False
    with open(path, "rb") as file:
        beginning = file.read(SNIFFED)
    return is_frf_table(path, beginning) or cutpro.looks_like_frequencies(path, beginning)


def _head(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: a folder; name the file in it")
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError as problem:
        raise RecordingError(f"{path}: {(problem.strerror or str(problem)).lower()}; check the path") from None
    if not head.strip():
        raise RecordingError(f"{path}: empty; export the FRF again")
    return head


def _is_frf_hdf5(path: Path) -> bool:
    with opened(path) as file:
        held = text_of(file.attrs.get("record", ""))
        said = text_of(file.attrs.get("format", ""))
        return held == "Frf" if said else {"frequency", "values"} <= set(file)


def _own_result(path: Path) -> Frf | None:
    """The FRF that millcal itself wrote, as it is, with its hits and notices; None for any other file."""
    if not _head(path).startswith(SIGNATURE):
        return None
    with opened(path) as file:
        ours = text_of(file.attrs.get("format", "")) == FORMAT
    if not ours and _is_frf_hdf5(path):
        return None
    return read_result(path, Frf)


def _measured(path: Path, form: str | None, unit: str | None) -> Measured:
    """What one file holds, by its first bytes."""
    head = _head(path)
    if head.startswith(SIGNATURE):
        return _in_stated_form(_of_hdf5(path), form, unit)
    if is_universal(head):
        return measured_of(read_universal(path), form=form, unit=unit)
    refuse_foreign(path, head)
    data = path.read_bytes()
    return read_frf_table(path, data, form=form, unit=unit) or cutpro.read_cutpro(path, data, form=form, unit=unit)


def _of_hdf5(path: Path) -> Measured:
    """A result, or the plain FRF file of the contract, whose unit may be another than SI."""
    frf = read_result(path, Frf)
    file = pairs_of(path, frf)
    with opened(path) as opened_file:
        if text_of(opened_file.attrs.get("format", "")):
            return file
        written = opened_file["values"].attrs.get("unit")
        rows = number_of(opened_file["values"].shape[0])
    if rows != len(frf.frequency):
        raise RecordingError(f"{path}: {rows:g} lines of values and {len(frf.frequency)} frequencies; write it again")
    if written is None or text_of(written) in ("", "by form"):
        return replace(file, format="hdf5")
    own, factor = stated_unit(None, text_of(written))
    if own != frf.form:
        raise RecordingError(f"{path}: a {frf.form} in {text_of(written)}; correct one of the two attributes")
    return _scaled(replace(file, format="hdf5"), factor or 1.0, frf.form)


def _in_stated_form(file: Measured, form: str | None, unit: str | None) -> Measured:
    """A file whose form or unit the user knows better."""
    own, factor = stated_unit(form, unit)
    if own is None or not file.pairs or (own == file.pairs[0].form and factor in (None, 1.0)):
        return file
    message = (
        f"{own} as stated, though the file says {file.pairs[0].form} in {SI_UNITS[file.pairs[0].form or 'receptance']}"
    )
    notices = (*file.notices, Notice("form-overruled", message, str(file.path)))
    return _scaled(replace(file, notices=notices, tests=()), factor or 1.0, own)


def _scaled(file: Measured, factor: float, form: str) -> Measured:
    def scaled(pair: Pair) -> Pair:
        variance = None if pair.variance is None else factor**2 * pair.variance
        return replace(pair, values=factor * pair.values, variance=variance, form=form)

    return replace(file, pairs=tuple(scaled(pair) for pair in file.pairs))


def converted(frf: Frf, form: str) -> Frf:
    """An FRF in another form.   raises RecordingError where there is none, as of a transmissibility"""
    if form == frf.form:
        return frf
    if form not in DERIVATIVES or frf.form not in DERIVATIVES:
        raise RecordingError(f"--form {form}: a {frf.form} cannot be converted into it; leave --form out")
    variance = frf.variance
    return replace(
        frf,
        values=convert_frf(frf.frequency, frf.values, frf.form, form),
        variance=None if variance is None else convert_frf_variance(frf.frequency, variance, frf.form, form),
        form=form,  # type: ignore[arg-type]
        tests=(),
    )


def write_frf(path: Path | str, frf: Frf, *, binary: bool = False, provenance: dict | None = None) -> Written:
    """Write an FRF in the format of the suffix: .h5, .uff or .unv, .csv, .frf; an existing file is replaced in the end.

    binary : a universal file with binary numbers   provenance : of an HDF5 result
    returns the paths, several for the pairs of a .frf, and what the format could not hold
    raises RecordingError for a suffix that is not known
    """
    path = Path(path)
    kind = SUFFIXES.get(path.suffix.lower())
    if kind is None:
        raise RecordingError(f"{path}: no format has the suffix {path.suffix!r}; use one of {', '.join(SUFFIXES)}")
    if binary and kind != "uff":
        raise RecordingError(f"{path}: only a universal file can be binary; leave --binary out, or write a .uff")
    return WRITERS[kind](path, frf, binary, provenance or {})


def _write_hdf5(path: Path, frf: Frf, binary: bool, provenance: dict) -> Written:
    write_result(path, frf, provenance=provenance)
    return Written((path,), ())


def _write_uff(path: Path, frf: Frf, binary: bool, provenance: dict) -> Written:
    write_universal(path, frf, binary=binary)
    lost = _lost(frf, variance=frf.variance, force_spectrum=frf.force_spectrum, hits=frf.hits, tests=frf.tests)
    if not binary:
        lost.append("more than 13 digits (--binary holds all)")
    long = [dof for dof in (*frf.outputs, *frf.inputs) if len(bare_dof(dof)) > 11]
    if long:
        lost.append(f"names longer than 10 letters for other programs ({', '.join(dict.fromkeys(long))})")
    return Written((path,), (*_not_held(path, "a universal file", lost), *_windowed(path, frf)))


def _write_csv(path: Path, frf: Frf, binary: bool, provenance: dict) -> Written:
    write_frf_table(path, frf)
    return Written(
        (path,), (*_not_held(path, "a table", _lost(frf, hits=frf.hits, tests=frf.tests)), *_windowed(path, frf))
    )


def _write_cutpro(path: Path, frf: Frf, binary: bool, provenance: dict) -> Written:
    notices: list[Notice] = []
    if frf.form != "receptance":
        notices.append(
            Notice("form-converted", f"CutPro reads a receptance; the {frf.form} is converted", str(path), "note")
        )
        frf = converted(frf, "receptance")
    paths = cutpro.write_cutpro(path, frf)
    if not paths:
        raise RecordingError(f"{path}: the FRF has no values; measure it again")
    gaps = int((~np.isfinite(frf.values)).all(axis=(1, 2)).sum())
    if gaps:
        notices.append(Notice("lines-left-out", f"{gaps} lines without a value are left out", str(path), "note"))
    parts = {name: getattr(frf, name) for name in ("coherence", "multiple_coherence", "variance", "force_spectrum")}
    lost = _lost(frf, **parts, hits=frf.hits, tests=frf.tests)
    lost.append("the dofs" if len(paths) == 1 else "the dofs but in the name of the file")
    return Written(paths, (*notices, *_not_held(path, "a CutPro file", lost), *_windowed(path, frf)))


WRITERS: dict[str, Callable[[Path, Frf, bool, dict], Written]] = {
    "hdf5": _write_hdf5,
    "uff": _write_uff,
    "csv": _write_csv,
    "cutpro": _write_cutpro,
}


def _lost(frf: Frf, **parts: Any) -> list[str]:
    """Which of these parts an FRF has."""
    words = {
        "force_spectrum": "force spectrum",
        "multiple_coherence": "multiple coherence",
        "tests": "spectra of the hits",
    }
    return [words.get(name, name) for name, part in parts.items() if part is not None and len(part)]


def _not_held(path: Path, what: str, lost: list[str]) -> list[Notice]:
    return [Notice("not-held", f"{what} does not hold {', '.join(lost)}", str(path), "note")] if lost else []


def _windowed(path: Path, frf: Frf) -> list[Notice]:
    """Another program cannot know that an exponential window was used: it would find it as damping."""
    if not frf.damping_shift:
        return []
    message = (
        f"the FRF was measured under an exponential window of {frf.damping_shift:.4g}/s, which another program takes for "
        "damping; fit its modes with 'millcal modes', or estimate it without the window"
    )
    return [Notice("exponential-window", message, str(path))]


def describe_frf(path: Path) -> tuple[dict[str, Any], tuple[Notice, ...]]:
    """What is in an FRF file, as the contract's JSON of `inspect`, and notices; what must be stated is under `missing`."""
    file = _measured(Path(path), None, None)
    missing = list(problems_of(file))
    pairs = [_described(pair) for pair in file.pairs]
    form = file.pairs[0].form if file.pairs else None
    notices = list(file.notices)
    if not missing:
        try:
            frf = joined([file])
            form, notices = frf.form, [*frf.notices, *doubts(frf, str(path))]
        except RecordingError as problem:
            missing.append(str(problem).removeprefix(f"{path}: "))
    low, high = file.band or (float(file.frequency[0]), float(file.frequency[-1]))
    result = {
        "file": str(path),
        "format": file.format,
        "sample_rate_hz": None,
        "samples": len(file.frequency),
        "duration_s": None,
        "start_time_s": None,
        "time_column": None,
        "channels": pairs,
        "frf": {
            "form": form,
            "unit": SI_UNITS.get(form or ""),
            "estimator": file.estimator,
            "outputs": list(dict.fromkeys(pair.output for pair in file.pairs)),
            "inputs": list(dict.fromkeys(pair.input for pair in file.pairs)),
            "frequency_hz": [float(file.frequency[0]), float(file.frequency[-1]), len(file.frequency)],
            "usable_band_hz": [low, high],
            "coherence": any(pair.coherence is not None for pair in file.pairs),
        },
        "missing": missing,
        "details": dict(file.details),
    }
    return result, tuple(dict.fromkeys(notices))


def _described(pair: Pair) -> dict[str, Any]:
    """One pair as `inspect` tells a channel: the range of its magnitude, in SI where the unit is known."""
    size = np.abs(pair.values)
    known = size[np.isfinite(size)]
    numbers = {"min": known.min, "max": known.max, "mean": known.mean} if len(known) else {}
    return {
        "name": f"{pair.output or '?'}/{pair.input or '?'}",
        "quantity": pair.form,
        "unit": SI_UNITS.get(pair.form or ""),
        "dof": pair.output,
        **{name: float(numbers[name]()) if numbers else None for name in ("min", "max", "mean")},
        "rms": float(np.sqrt(np.mean(known**2))) if len(known) else None,
        "missing_values": int(len(size) - len(known)),
    }
