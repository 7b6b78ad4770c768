"""The lines of a universal file's datasets 58 and 164: fixed columns, read as what they are in the field.

Columns are those of the published description; a line whose columns were shifted is read by its blanks. Numbers may be
Fortran's (1.5D+03, 1.5-101), and a name may be one of the words that mean none.
"""

import re
import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from millcal.errors import RecordingError

ORDINATES = {2: (1, 4), 4: (1, 8), 5: (2, 4), 6: (2, 8)}  # type -> numbers of a value, bytes of a number
# Units code -> length and force per SI unit ("divide by the factor to get SI"); 9 is the user's own.
SYSTEMS = {
    1: (1.0, 1.0), 2: (3.28083989501312, 0.224808943099711), 3: (1.0, 0.101971621297793), 4: (3.28083989501312, 7.23301385120989),
    5: (1000.0, 1000.0), 6: (100.0, 100.0), 7: (39.3700787401575, 0.224808943099711), 8: (1000.0, 0.101971621297793),
}  # fmt: skip
_IDENTITY = re.compile(
    r"\s*(\d+)\s+(-?\d+)\s+(-?\d+)\s+(-?\d+)\s+(\S.*?)\s+(-?\d+)\s+(-?\d+)\s+(\S.*?)\s+(-?\d+)\s+(-?\d+)\s*"
)
_LARGEST = 1e30  # first abscissa or step; what is larger is damage
_NAMELESS = ("", "NONE", "NULL", "N/A", "-", "?", "UNKNOWN")


@dataclass(frozen=True)
class Axis:
    """One of the records 8 to 10: what an axis measures and in which unit, as far as it is said."""

    kind: int  # specific data type: 8 displacement, 11 velocity, 12 acceleration, 13 excitation force, 17 time, ...
    length_exponent: int
    force_exponent: int
    label: str
    unit: str


@dataclass(frozen=True)
class Units:
    """Dataset 164: what a length and a force of the file are in SI."""

    code: int
    description: str
    length: float  # per m
    force: float  # per N

    @property
    def contradicts_itself(self) -> bool:
        """Whether the factors are not those of the named system of units."""
        known = SYSTEMS.get(self.code)
        return known is not None and not np.allclose(known, (self.length, self.force), rtol=1e-3)


@dataclass(frozen=True)
class Dof:
    """A node with its direction: 0 scalar, 1 to 3 along x, y, z, 4 to 6 about them, negative the other way."""

    entity: str  # "" where unused
    node: int
    direction: int


class Form(NamedTuple):
    """Record 7: how the numbers of a function stand in the file."""

    ordinate: int  # 2, 4 real, 5, 6 complex; 2 and 5 are single precision
    count: int
    even: bool
    first: float
    step: float
    step_rounding: float  # half of the last digit that the step is written with


def identity(where: str, line: str) -> tuple:
    """Record 6: function type, number, version, load case, response entity, node, direction, and those of the reference."""
    wide = line.ljust(80)
    edges = ((0, 5), (5, 15), (15, 20), (20, 30), (30, 41), (41, 51), (51, 55), (55, 66), (66, 76), (76, 80))
    parts: tuple[str, ...] = tuple(wide[a:b] for a, b in edges)
    loose = _IDENTITY.fullmatch(line)
    for cells in (parts, loose.groups() if loose else ()):
        try:
            numbers = [int(cell) for i, cell in enumerate(cells) if i not in (4, 7)]
        except ValueError:
            continue
        if cells and abs(numbers[5]) <= 6 and abs(numbers[7]) <= 6:
            return (*numbers[:4], name_of(cells[4]), *numbers[4:6], name_of(cells[7]), *numbers[6:])
    raise RecordingError(f"{where}: no response and reference in {line.strip()[:60]!r}; export the file again")


def form_of(where: str, line: str) -> Form:
    """Record 7."""
    wide = line.ljust(69)
    parts = [wide[0:10], wide[10:20], wide[20:30], wide[30:43], wide[43:56]]
    for cells in (parts, line.split()):
        try:
            ordinate, count, even = (int(cell) for cell in cells[:3])
            first, step = (_number(cell) if cell.strip() else 0.0 for cell in cells[3:5])
        except ValueError:
            continue
        if ordinate not in ORDINATES:
            raise RecordingError(
                f"{where}: values of type {ordinate}, which is none of 2, 4, 5, 6; export real or complex numbers"
            )
        if count < 1:
            raise RecordingError(f"{where}: holds no values; leave it out of the export, or measure it again")
        if max(abs(first), abs(step)) > _LARGEST or (even and not step > 0):
            raise RecordingError(
                f"{where}: evenly spaced at steps of {step:g}; export the file again with its abscissa"
            )
        return Form(ordinate, count, bool(even), first, step, _rounding(cells[4]))
    raise RecordingError(f"{where}: no number of values in {line.strip()[:60]!r}; export the file again")


def axis_of(where: str, line: str) -> Axis:
    """Records 8 to 10: data type, exponents of the units, label and unit."""
    wide = line.ljust(80)
    for cells in ((wide[:10], wide[10:15], wide[15:20], wide[20:25], wide[25:46], wide[46:67]), line.split()):
        try:
            kind, length, force = (int(cell) for cell in cells[:3])
        except ValueError:
            continue
        labels = [name_of(cell) for cell in cells[4:6]]
        return Axis(kind, length, force, *[*labels, "", ""][:2])
    raise RecordingError(f"{where}: no axis in {line.strip()[:60]!r}; export the file again")


def units_of(path: Path, text: str) -> Units:
    """Dataset 164."""
    lines = text.splitlines()
    try:
        code, described = int(lines[0][:10]), lines[0][10:30].strip()
        factors = [_number(word) for word in " ".join(lines[1:]).split()[:2]]
        length, force = factors
    except (ValueError, IndexError):
        raise RecordingError(f"{path}: its units (dataset 164) cannot be read; export the file again") from None
    if not (length > 0 and force > 0):
        raise RecordingError(
            f"{path}: its units (dataset 164) have factors {length:g}, {force:g}; export the file again"
        )
    return Units(code, described, length, force)


def name_of(text: str) -> str:
    """A name as written, "" for the words that mean none."""
    return "" if text.strip().upper() in _NAMELESS else text.strip()


def text_of(data: bytes) -> str:
    """Text of a universal file, in UTF-8 or else Latin-1."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _number(text: str) -> float:
    """A number as Fortran writes it: 1.5D+03, and 1.5-101 where the exponent has three digits."""
    text = text.strip().upper().replace("D", "E")
    return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"E\1", text) if "E" not in text else text)


def _rounding(text: str) -> float:
    """Half a unit of the last digit of a number as it is written."""
    found = re.fullmatch(r"\s*[+-]?\d*\.?(\d*)(?:[EeDd]([+-]?\d+))?\s*", text)
    return float(f"0.5E{int(found[2] or 0) - len(found[1])}") if found else 0.0


def _widths(ordinate: int, even: bool) -> tuple[int, ...]:
    """Widths of the columns of text, repeated along a line: 6E13.5, 4E20.12, 2(E13.5,E20.12), E13.5,2E20.12."""
    parts, width = ORDINATES[ordinate]
    if width == 4:
        return (13,) * 6
    return (20,) * 4 if even else ((13, 20) * 2 if parts == 1 else (13, 20, 20))


def numbers_of(text: bytes, wanted: int, ordinate: int, even: bool) -> np.ndarray | None:
    """The numbers of a text record: up to the next blank or sign or, where that does not work out, by columns.

    ordinate, even : by which the columns are known
    returns (n,), fewer than wanted where the text is short; None where it holds something else
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(text, dtype=np.float64, sep=" ")
            if len(numbers) <= wanted:  # with more, exponents without their letter were taken for numbers
                return numbers
        except (DeprecationWarning, ValueError):
            numbers = None
    edges = np.cumsum((0, *_widths(ordinate, even)))
    found = []
    for line in text.decode("latin-1").splitlines():
        cells = [line[a:b] for a, b in pairwise(edges)]
        try:
            found += [_number(cell) for cell in cells if cell.strip()]
        except ValueError:
            return numbers
    return np.array(found) if numbers is None or len(found) >= wanted else numbers
