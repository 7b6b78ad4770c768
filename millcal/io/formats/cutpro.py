"""CutPro's `.frf` and the FRF texts of MALTF: rows of frequency, real and imaginary part of a receptance in m/N.

There may be words before the numbers, or behind those of the first row, and a unit among them. Columns are parted by
tabs, blanks, commas or semicolons; line ends may be mixed; the decimal sign may be a comma. The file does not say where
it was measured, but its name may: ours are called `STEM_tipX_tipY.frf`, response before hammer.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from millcal.data import Frf, Notice
from millcal.errors import RecordingError
from millcal.io.formats.dialect import HEAD, sniff_encoding
from millcal.io.frf_pairs import Measured, Pair, check_frequency, known_values
from millcal.io.frf_units import frf_unit, stated_unit
from millcal.io.results import write_text_atomically

_IN_FILE_NAME = re.compile(r".*_(?P<output>-?[A-Za-z]*\d*R?[XYZ])_(?P<input>-?[A-Za-z]*\d*R?[XYZ])")
_NUMBER = r"[+-]?(?:(?:\d+{0}?\d*|{0}\d+)(?:[eEdD][+-]?\d+)?|nan|inf(?:inity)?|1{0}#\w+)"
_GAPS = {".": r"(?:\s*[,;]\s*|\s+)", ",": r"(?:\s*;\s*|\s+)"}
_COMMENT = ("#", "%", "//", "!")


class _Rows(NamedTuple):
    """What is found in a text under one decimal sign."""

    rows: list[list[float]]
    words: list[str]
    trouble: str | None  # `line 7 ...; mending`


def read_cutpro(path: Path, data: bytes, *, form: str | None = None, unit: str | None = None) -> Measured:
    """The FRF in three bare columns.   data : the bytes of the file   form, unit : as the user states them"""
    text = data.decode(sniff_encoding(path, data[:HEAD]), errors="replace").lstrip("\ufeff")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    found = _rows(lines, ".")
    if found.trouble or not found.rows:
        other = _rows(lines, ",")
        found = other if other.rows and not other.trouble else found
    if found.trouble:
        raise RecordingError(f"{path}: {found.trouble}")
    if not found.rows:
        raise RecordingError(
            f"{path}: no FRF was found; give rows of frequency, real and imaginary part, or a table that names its columns"
        )
    table = np.array(found.rows).T
    check_frequency(str(path), table[0])
    notices: list[Notice] = []
    problems: list[str] = []
    own, factor = _unit(path, found.words, stated_unit(form, unit), problems, notices)
    told = _IN_FILE_NAME.fullmatch(Path(path).stem)
    if told:
        message = f"response {told['output']} and hammer {told['input']} are taken from the name of the file"
        notices.append(Notice("dofs-from-name", message, str(path), "note"))
    values = factor * known_values(str(path), table[1] + 1j * table[2])
    pair = Pair(str(path), values, told and told["output"], told and told["input"], own)
    return Measured(
        path=path,
        format="cutpro",
        frequency=table[0],
        pairs=(pair,),
        problems=tuple(problems),
        notices=tuple(notices),
        details={"words": " ".join(found.words)[:200]},
    )


def _unit(
    path: Path,
    words: Sequence[str],
    stated: tuple[str | None, float | None],
    problems: list[str],
    notices: list[Notice],
) -> tuple[str | None, float]:
    """Form and factor to SI: as stated, by the words of the file, else those of CutPro."""
    cells = [word.strip("()[],;") for word in words]
    named = list(dict.fromkeys(known for cell in cells if "/" in cell and (known := frf_unit(cell))))
    form, factor = stated
    if form is not None:
        own = next((f for f, _ in named if f != form), None)
        if own:
            notices.append(Notice("form-overruled", f"{form} as stated, though the file says {own}", str(path)))
        return form, next((k for f, k in named if f == form), 1.0) if factor is None else factor
    if len(named) > 1:
        problems.append(f"several units in its words, {' '.join(cells)[:60]!r}; state one with --unit m/N")
        return None, 1.0
    if named:
        return named[0]
    message = "the file says no unit; m/N is taken, as CutPro writes it (--unit for another)"
    notices.append(Notice("unit-assumed", message, str(path), "note"))
    return "receptance", 1.0


def _rows(lines: Sequence[str], point: str) -> _Rows:
    """Rows of three numbers, and the words before them and behind the first.   point : decimal sign"""
    number, gap = _NUMBER.format(re.escape(point)), _GAPS[point]
    row_of = re.compile(rf"\s*({number}){gap}({number}){gap}({number})", re.IGNORECASE)
    begins = re.compile(rf"[\s,;]*{number}(?:[\s,;]|$)", re.IGNORECASE)
    rows: list[list[float]] = []
    words: list[str] = []
    last = max((k for k, line in enumerate(lines, start=1) if line.strip()), default=0)
    for k, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        found = None if line.lstrip().startswith(_COMMENT) else row_of.match(line)
        rest = line[found.end() :] if found else ""
        if found and begins.match(rest):
            named = "name the columns in a line above, as in 'frequency_hz, tipX/tipX re [m/N], tipX/tipX im [m/N]'"
            return _Rows(rows, words, f"line {k} has more than three numbers; {named}")
        if found:
            words += rest.replace("\t", " ").split() if rest.strip(" \t,;") else []
            rows.append([_value(found[i], point) for i in (1, 2, 3)])
        elif rows and begins.match(line):
            if k == last:
                return _Rows(rows, words, f"line {k}, the last one, is cut short; export the file again")
            return _Rows(rows, words, f"line {k} holds {line.strip()[:40]!r} where three numbers are needed; mend it")
        elif not rows:
            words += line.split()
    return _Rows(rows, words, None)


def _value(text: str, point: str) -> float:
    try:
        number = float(text.replace(point, ".").upper().replace("D", "E"))
    except ValueError:  # 1.#QNAN
        return np.nan
    return number if np.isfinite(number) else np.nan


def looks_like_frequencies(path: Path, beginning: bytes) -> bool:
    """Whether a text begins with three bare columns of which the first are frequencies rather than times in s."""
    whole_lines = beginning[: beginning.rfind(b"\n") + 1] if len(beginning) >= HEAD else beginning
    try:
        found = read_cutpro(path, whole_lines)
    except RecordingError:
        return False
    return bool(found.frequency[-1] >= 100 and np.median(np.diff(found.frequency)) >= 0.01)


def write_cutpro(path: Path, frf: Frf) -> tuple[Path, ...]:
    """Write a receptance, one file for each pair; lines without a value are left out.

    returns the paths: the one given, or STEM_output_input.frf for each of several pairs
    """
    pairs = [
        (o, i)
        for i in range(len(frf.inputs))
        for o in range(len(frf.outputs))
        if np.isfinite(frf.values[:, o, i]).any()
    ]
    written = []
    for o, i in pairs:
        named = path.with_name(f"{path.stem}_{_in_a_name(frf.outputs[o])}_{_in_a_name(frf.inputs[i])}{path.suffix}")
        own = path if len(pairs) == 1 else named
        column = frf.values[:, o, i]
        known = np.isfinite(column)
        rows = zip(frf.frequency[known], column[known], strict=True)
        write_text_atomically(own, "".join(f"{f:.16e}\t{h.real:.16e}\t{h.imag:.16e}\r\n" for f, h in rows))
        written.append(own)
    return tuple(written)


def _in_a_name(dof: str) -> str:
    """A dof as a part of a file's name."""
    return re.sub(r"[^\w+-]", "-", dof)
