"""An FRF as a table of text whose header names its columns.

A column of frequencies comes first; each pair has a real and an imaginary part, or a magnitude and a phase:

    frequency_hz, tipX/tipX re [m/N], tipX/tipX im [m/N], tipX/tipX coherence
    Frequency (Hz); Magnitude (um/N); Phase (deg)

`output/input` may be left out where the file holds one pair. Lines such as `# form = accelerance` above the header say
what the columns do not; our own files have `unit`, `estimator`, `hits_used`, `usable_band_hz` there, and columns
`variance`, `multiple_coherence` and `force_spectrum`. Encoding, delimiter and decimal sign are found by looking.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats import dynoware
from millcal.io.formats.dialect import HEAD, Dialect, is_comment, is_missing, sniff_dialect, split
from millcal.io.frf_pairs import Measured, Pair, bare_dof, check_frequency, known_values
from millcal.io.frf_units import FORMS, form_of_words, frf_unit, stated_unit
from millcal.io.keys import TextTable

_FREQUENCY = re.compile(r"(f|freq|frequency|frequenz|fr[eé]quence|frequencia|频率)", re.IGNORECASE)
_HERTZ = {None: 1.0, "hz": 1.0, "khz": 1e3, "1/s": 1.0, "rad/s": 1 / (2 * np.pi)}
_WORDS = {
    "re": "real", "real": "real", "im": "imag", "imag": "imag", "imaginary": "imag", "mag": "magnitude",
    "magnitude": "magnitude", "abs": "magnitude", "amplitude": "magnitude", "amp": "magnitude", "modulus": "magnitude",
    "phase": "phase", "angle": "phase", "arg": "phase", "coherence": "coherence", "coh": "coherence",
    "gamma2": "coherence", "variance": "variance", "var": "variance", "multiple_coherence": "multiple_coherence",
    "force_spectrum": "force_spectrum",
}  # fmt: skip
_LONGEST_FIRST = sorted(_WORDS, key=len, reverse=True)
_SUFFIXES = {"_hz": "hz", "_khz": "khz", "_deg": "deg", "_rad": "rad", "_db": "db", "_rad_s": "rad/s"}
_ANGLES = {"deg": np.pi / 180, "degrees": np.pi / 180, "°": np.pi / 180, "rad": 1.0}
_UNIT = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^()]*(?:\([^()]*\)[^()]*)?)\))\s*")
_DOF = r"[+-]?[^\s/,()]+"
_NAMES = re.compile(rf"(?:(?:H|FRF)[_ ]?)?\(?\s*(?P<output>{_DOF})\s*[/,|]\s*(?P<input>{_DOF})\s*\)?")
_NO_DOF = re.compile(r"(h|g|frf|tf)\d*[xyz]{0,2}\d*", re.IGNORECASE)  # what an FRF is called, not where it was measured


def read_frf_table(path: Path, data: bytes, *, form: str | None = None, unit: str | None = None) -> Measured | None:
    """The FRF in a table whose header is one of an FRF; None for any other text.

    data : the bytes of the file   form, unit : as the user states them, before what the file says
    """
    found = _named_columns(path, data)
    return None if found is None else _read(path, data, *found, stated_unit(form, unit))


def is_frf_table(path: Path, beginning: bytes) -> bool:
    """Whether a text begins as a table whose header is one of an FRF."""
    return _named_columns(path, beginning) is not None


class _Cell:
    """What one header cell says of its column."""

    def __init__(self, written: str) -> None:
        name, unit = _name_and_unit(written)
        self.written, self.unit = written, unit
        self.part, rest = _part_of(name)
        pair = _NAMES.fullmatch(rest)
        self.output, self.input = (pair["output"], pair["input"]) if pair else (None, None)
        self.label = "" if pair else rest
        if self.part in ("multiple_coherence", "force_spectrum"):
            self.output, self.input, self.label = (rest, None, "") if self.part[0] == "m" else (None, rest, "")


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """`phase [deg]`, `phase (deg)` and `phase_deg` are a phase in degrees."""
    cell = cell.strip().strip("'\"").strip()
    found = _UNIT.fullmatch(cell)
    inside = None if found is None else found["square"] if found["square"] is not None else found["round"]
    is_unit = inside is not None and (_is_unit(inside) or (found is not None and found["square"] is not None))
    if found and inside is not None and found["name"] and is_unit:
        return found["name"], inside.strip()
    ending = next((s for s in sorted(_SUFFIXES, key=len, reverse=True) if cell.lower().endswith(s)), None)
    return (cell[: -len(ending)], _SUFFIXES[ending]) if ending else (cell, None)


def _is_unit(text: str) -> bool:
    bare = text.strip().lower()
    return (
        frf_unit(text) is not None
        or bare in ("deg", "°", "rad", "db", "degrees", "n s", "n·s", "ns", "")
        or bare in _HERTZ
    )


def _part_of(name: str) -> tuple[str | None, str]:
    """`tipX/tipX re`, `re(tipX/tipX)`, `H_real`: which part of which pair."""
    low = name.lower()
    if _FREQUENCY.fullmatch(low):
        return "frequency", ""
    for word in _LONGEST_FIRST:
        ending = re.fullmatch(rf"(?P<rest>.*?)(?:^|[\s_.:])\(?{word}(?:\s*part)?\)?", name, re.IGNORECASE)
        begin = re.fullmatch(rf"{word}(?:\s*part)?(?:[\s_.:]+|(?=\())(?P<rest>.*)", name, re.IGNORECASE)
        found = ending or begin
        if found:
            return _WORDS[word], found["rest"].strip(" _.:")
    return None, name


def _named_columns(path: Path, data: bytes) -> tuple[Dialect, list[_Cell]] | None:
    """The dialect and the columns of a table whose header is one of an FRF, None for any other text."""
    try:
        dialect = sniff_dialect(path, data[:HEAD], TextTable())
    except RecordingError:
        return None
    cells = [_Cell(written) for written in dialect.written]
    parts = [cell.part for cell in cells]
    whole = {"real", "imag"} <= set(parts) or {"magnitude", "phase"} <= set(parts)
    return (dialect, cells) if parts and parts[0] == "frequency" and whole else None


def _read(
    path: Path, data: bytes, dialect: Dialect, cells: list[_Cell], stated: tuple[str | None, float | None]
) -> Measured:
    """A table with a header."""
    table = _rows(path, data, dialect, len(cells))
    unit = cells[0].unit.lower() if cells[0].unit else None
    if unit not in _HERTZ:
        raise RecordingError(f"{path}: the frequency is in {cells[0].unit!r}; write it in Hz")
    frequency = table[0] * _HERTZ[unit]
    check_frequency(str(path), frequency)
    said = {key.lower(): value for key, value in dynoware.keys_of(dialect.preamble).items()}
    problems: list[str] = []
    notices = [n for n in dialect.notices if n.code != "duplicate-names"]
    groups: dict[tuple[str | None, str | None, str], dict[str, int]] = {}
    multiple, spectrum = {}, {}
    for k, cell in enumerate(cells[1:], start=1):
        if cell.part == "multiple_coherence":
            multiple[bare_dof(cell.output or "")] = table[k]
        elif cell.part == "force_spectrum":
            spectrum[bare_dof(cell.input or "")] = table[k]
        elif cell.part is None or cell.part == "frequency":
            notices.append(Notice("columns-left-out", f"column '{cell.written}' is no part of an FRF", str(path)))
        elif groups.setdefault((cell.output, cell.input, cell.label), {}).setdefault(cell.part, k) != k:
            raise RecordingError(f"{path}: two columns '{cell.written}'; name the pair of each, as in 'tipX/tipX re'")
    pairs = []
    for (output, one, label), parts in _with_shared_coherence(groups).items():
        place = f"{path}: columns {', '.join(repr(cells[k].written) for k in parts.values())}"
        values, form, factor = _values(path, place, table, cells, parts, said, stated, problems, notices)
        output, one = _dofs(output, one, label, said)
        variance = table[parts["variance"]] * factor**2 if "variance" in parts else None
        coherence = table[parts["coherence"]] if "coherence" in parts else None
        pairs.append(Pair(place, values, output, one, form, coherence, variance))
    inputs = list(dict.fromkeys(bare_dof(pair.input or "") for pair in pairs))
    return Measured(
        path=path,
        format="csv",
        frequency=frequency,
        pairs=tuple(pairs),
        multiple=multiple,
        spectrum=spectrum,
        estimator=said.get("estimator", "unknown"),
        hits_used=dict(zip(inputs, (int(n) for n in _numbers(said, "hits_used")), strict=False)),
        band=_band(said),
        damping_shift=next(iter(_numbers(said, "damping_shift_per_s")), 0.0),
        problems=tuple(dict.fromkeys(problems)),
        notices=tuple(dict.fromkeys(notices)),
        details={"header": said},
    )


def _with_shared_coherence(groups: dict) -> dict:
    """One coherence beside the only pair of a file belongs to it, whatever it is called."""
    whole = {key: parts for key, parts in groups.items() if set(parts) - {"coherence", "variance"}}
    if len(whole) == 1:
        (only,) = whole.values()
        for key, parts in groups.items():
            if key not in whole:
                for part, k in parts.items():
                    only.setdefault(part, k)
    return whole


def _dofs(output: str | None, one: str | None, label: str, said: Mapping[str, str]) -> tuple[str | None, str | None]:
    """The pair by its columns, or by the lines above them."""
    if output is None and one is None:
        place = None if _NO_DOF.fullmatch(label) or form_of_words(label) else label or None
        return said.get("output", place), said.get("input")
    return output, one


def _band(said: Mapping[str, str]) -> tuple[float, float] | None:
    numbers = _numbers(said, "usable_band_hz")
    return (numbers[0], numbers[1]) if len(numbers) == 2 else None


def _numbers(said: Mapping[str, str], key: str) -> list[float]:
    try:
        return [float(word) for word in re.split(r"[,;\s]+", said[key]) if word] if key in said else []
    except ValueError:
        return []


def _values(
    path: Path,
    place: str,
    table: np.ndarray,
    cells: Sequence[_Cell],
    parts: Mapping[str, int],
    said: Mapping[str, str],
    stated: tuple[str | None, float | None],
    problems: list[str],
    notices: list[Notice],
) -> tuple[np.ndarray, str | None, float]:
    """Complex values of one pair in SI, its form, and the factor of its unit."""
    if {"real", "imag"} <= set(parts):
        raw = table[parts["real"]] + 1j * table[parts["imag"]]
        unit = cells[parts["real"]].unit
        if frf_unit(cells[parts["imag"]].unit or unit or "1") != frf_unit(unit or cells[parts["imag"]].unit or "1"):
            raise RecordingError(f"{place}: real and imaginary part in unequal units; write one unit")
        unit = unit or cells[parts["imag"]].unit
    elif {"magnitude", "phase"} <= set(parts):
        magnitude, phase = table[parts["magnitude"]], table[parts["phase"]]
        unit, angle = cells[parts["magnitude"]].unit, (cells[parts["phase"]].unit or "").lower()
        if (unit or "").lower() == "db":
            magnitude, unit = 10.0 ** (np.clip(magnitude, -600, 620) / 20), None
        if angle not in _ANGLES:
            angle = "deg" if np.nanmax(np.abs(phase), initial=0.0) > 2 * np.pi else ""
            if not angle:
                problems.append("the phase has no unit; write deg or rad behind it, as in 'phase [deg]'")
        raw = magnitude * np.exp(1j * phase * _ANGLES.get(angle, 1.0))
    else:
        held = ", ".join(parts)
        raise RecordingError(f"{place}: only {held}; an FRF needs real and imaginary part, or magnitude and phase")
    label = cells[next(iter(parts.values()))].label
    unit, own = unit or said.get("unit"), said.get("form")
    if unit is None and own is None and path.suffix.lower() == ".frf":
        unit = "m/N"
        message = "the file says no unit; m/N is taken, as CutPro writes it (--unit for another)"
        notices.append(Notice("unit-assumed", message, str(path), "note"))
    form, factor = _form(label, unit, own, stated, problems)
    if stated[0] is not None and own not in (None, form):
        notices.append(Notice("form-overruled", f"{form} as stated, though the file says {own}", str(path)))
    return known_values(place, raw) * factor, form, factor


def _form(
    label: str, unit: str | None, said: str | None, stated: tuple[str | None, float | None], problems: list[str]
) -> tuple[str | None, float]:
    """Form and factor by what the user states, else by unit, by the line above the table, by the columns' label."""
    known = frf_unit(unit) if unit else None
    if stated[0] is not None:
        factor = stated[1] if stated[1] is not None else known[1] if known and known[0] == stated[0] else 1.0
        return stated[0], factor
    if unit and known is None:
        problems.append(f"the unit {unit!r} is not known; state it with --unit g/N or the like")
        return None, 1.0
    forms = {form for form in (known and known[0], said if said in FORMS else None) if form}
    if not forms and (word := form_of_words(label)):
        forms = {word}
    if len(forms) == 1:
        return forms.pop(), 1.0 if known is None else known[1]
    if forms:
        problems.append(f"the file says {' and '.join(sorted(forms))}; state the unit with --unit g/N or the like")
    else:
        problems.append(
            "neither unit nor form of the FRF is said; write the unit behind the names, as in 're [m/N]', or state it with "
            "--unit m/N"
        )
    return None, 1.0


def _rows(path: Path, data: bytes, dialect: Dialect, width: int) -> np.ndarray:
    """The numbers of a table to the last digit, nan where a cell holds none.   returns (column, row)"""
    text = data.decode(dialect.encoding, errors="replace").lstrip("\ufeff")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    rows = []
    for number, line in enumerate(lines[dialect.first_line - 1 :], start=dialect.first_line):
        if not line.strip() or is_comment(line):
            continue
        cells = split(line, dialect.delimiter)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) != width:
            if number >= len(lines) - 1 and len(cells) < width:
                raise RecordingError(f"{path}: line {number}, the last one, is cut short; export the file again")
            raise RecordingError(f"{path}: line {number}: {len(cells)} cells under {width} names; mend the line")
        row = []
        for k, cell in enumerate(cells):
            try:
                row.append(
                    np.nan if is_missing(cell) else float(cell.replace(",", ".") if dialect.decimal == "," else cell)
                )
            except ValueError:
                name = dialect.names[k]
                raise RecordingError(
                    f"{path}: line {number}: column '{name}' holds {cell[:40]!r} where a number is needed; mend the cell"
                ) from None
        rows.append(row)
    table = np.array(rows).reshape(-1, width).T
    return np.where(np.isfinite(table), table, np.nan)
