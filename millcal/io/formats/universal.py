"""The universal file (UFF, UNV): the functions it holds, the units they are in, and who wrote it.

A universal file is a row of datasets between lines of `-1`. Read here are 58 (function at a nodal degree of freedom), its
binary sister 58b, 164 (units) and 151 (header); the others are counted and passed over. The layout follows the published
description of the datasets (University of Cincinnati SDRL, "58.asc", "58b.asc", "164.asc"); where files in the field
depart from it, the file is believed rather than the description:

- the byte count of a 58b is often wrong (half for complex numbers, or with padding) and a line end may follow the data, so
  the closing `-1` decides how long the data are, and which of the two widths an uneven abscissa has;
- numbers of a 58 fill fixed columns and may touch each other, so columns are cut where blanks do not part them.

The numbers of a record are read when they are asked for; a 58b in pieces.
"""

import mmap
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats.universal_records import (
    ORDINATES,
    SYSTEMS,
    Axis,
    Dof,
    Units,
    axis_of,
    form_of,
    identity,
    numbers_of,
    text_of,
    units_of,
)

SIGNATURE = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?: {4}-1[ \t]*\r?\n){1,2} *\d{2,5}(?:[bB][ \t\d]*|[ \t]*)\r?(?:\n|$)")
FUNCTIONS = {
    0: "unknown function", 1: "time record", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF", 5: "transmissibility",
    6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    10: "energy spectral density", 12: "spectrum", 18: "mode indicator function", 21: "partial coherence",
    26: "multiple coherence", 27: "order function",
}  # fmt: skip
_END = re.compile(rb"(?:\r?\n)? {4}-1[ \t]*(?:\r?\n|\Z)")
_END_LINE = re.compile(rb"\n {4}-1[ \t]*(?=\r?\n|\Z)")
_HEADER_LINES = 11


@dataclass(frozen=True, eq=False)
class Function:
    """One dataset 58, its header read and its numbers still in the file."""

    path: Path
    number: int  # among the functions of the file, from 1
    ids: tuple[str, ...]
    kind: int  # function type: 1 time, 4 FRF, 6 coherence, ...
    version: int
    load_case: int
    response: Dof
    reference: Dof
    ordinate: int  # 2, 4 real, 5, 6 complex; odd sisters are single precision
    count: int
    even: bool
    first: float
    step: float
    step_rounding: float  # half of the last digit that the step is written with
    abscissa: Axis
    numerator: Axis
    denominator: Axis
    units: Units | None
    start: int  # of the data in the file, bytes
    stop: int
    binary: np.dtype | None = None  # of one value; None for text

    @property
    def where(self) -> str:
        """What errors call it."""
        return f"{self.path}: record {self.number}"

    @property
    def what(self) -> str:
        """Its kind in words."""
        return FUNCTIONS.get(self.kind, f"function of type {self.kind}")

    @property
    def is_complex(self) -> bool:
        """Whether a value is a pair of numbers."""
        return ORDINATES[self.ordinate][0] == 2

    def x(self) -> np.ndarray:
        """The abscissa.   returns (count,) in the file's unit"""
        if self.even:
            return self.first + self.step * np.arange(self.count)
        return self._table()[0]

    def values(self, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Values start..stop, complex where the record is.   returns (stop - start,) in the file's unit"""
        stop = self.count if stop is None else min(stop, self.count)
        if self.binary is not None:
            with np.errstate(invalid="ignore"):  # a signalling nan of single precision
                values = self._from_bytes(start, stop)["y"].astype(np.float64)
        else:
            values = np.ascontiguousarray(self._table()[1][:, start:stop].T)
        return values.view(np.complex128)[:, 0] if self.is_complex else values[:, 0]

    def _from_bytes(self, start: int, stop: int) -> np.ndarray:
        assert self.binary is not None
        width = self.binary.itemsize
        with open(self.path, "rb") as file:
            return np.fromfile(file, self.binary, count=stop - start, offset=self.start + start * width)

    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Abscissa and ordinate: (count,) and (1 or 2, count); without an abscissa in the file the first is empty."""
        if self.binary is not None:
            rows = self._from_bytes(0, self.count)
            return rows["x"].astype(np.float64), rows["y"].T
        with open(self.path, "rb") as file:
            file.seek(self.start)
            text = file.read(self.stop - self.start)
        per_value = ORDINATES[self.ordinate][0] + (not self.even)
        numbers = numbers_of(text, self.count * per_value, self.ordinate, self.even)
        if numbers is None:
            raise RecordingError(
                f"{self.where}: its text holds something that is no number; export the file again, or without this record"
            )
        if len(numbers) < self.count * per_value:
            raise RecordingError(
                f"{self.where}: cut short, {len(numbers)} of {self.count * per_value} numbers are there; copy the file again"
            )
        table = numbers[: self.count * per_value].reshape(self.count, per_value).T
        return (np.empty(0), table) if self.even else (table[0], table[1:])


@dataclass(frozen=True)
class Universal:
    """What a universal file holds."""

    path: Path
    functions: tuple[Function, ...]
    program: str = ""
    model: str = ""
    others: dict[int, int] = field(default_factory=dict)  # other datasets: number -> how many
    notices: tuple[Notice, ...] = ()


def is_universal(head: bytes) -> bool:
    """Whether the first bytes are those of a universal file."""
    return SIGNATURE.match(head) is not None


def read_universal(path: Path) -> Universal:
    """Look through a universal file: the headers of its functions, its units, its author.

    raises RecordingError where a dataset is cut short or no header
    """
    path = Path(path)
    functions: list[Function] = []
    units: list[Units | None] = []  # that stand before each function
    current: Units | None = None
    program = model = ""
    others: dict[int, int] = {}
    notices: list[Notice] = []
    with _mapped(path) as data:
        for number, binary, begin, after in _datasets(path, data):
            if number == 58:
                function = _function(path, data, len(functions) + 1, binary, begin, after)
                functions.append(function)
                units.append(current)
            elif number == 164:
                current = units_of(path, text_of(data[begin:after]))
                if current.contradicts_itself:
                    message = (
                        f"the units of the file contradict each other: code {current.code} and factors {current.length:g}, "
                        f"{current.force:g}; the code is taken, state another with --unit"
                    )
                    notices.append(Notice("units-contradict", message, str(path)))
            elif number == 151:
                lines = [line.strip() for line in text_of(data[begin:after]).splitlines()] + [""] * 6
                model, program = lines[0], lines[5] or lines[2]
            else:
                others[number] = others.get(number, 0) + 1
    if not functions:
        held = ", ".join(f"{n} of type {number}" for number, n in others.items()) or "nothing"
        raise RecordingError(
            f"{path}: a universal file without functions (dataset 58); it holds {held}: export the functions"
        )
    fitted = [_with_units(f, before or current) for f, before in zip(functions, units, strict=True)]
    return Universal(path, tuple(fitted), program, model, others, tuple(notices))


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise RecordingError(f"{path}: {reason}; check the path and the permissions") from None
    except ValueError:
        raise RecordingError(f"{path}: empty; export the file again") from None


def _datasets(path: Path, data: mmap.mmap) -> Iterator[tuple[int, tuple[int, int] | None, int, int]]:
    """Each dataset: its number, byte order and byte count of a binary one, where its lines begin and where it ends.

    A binary one is not searched for its end, which its numbers may seem to hold: it ends where its header says.
    """
    at, records = 0, 0
    while (mark := _line(data, at)) is not None:
        text, after = mark
        if text.strip(b" \t\r\n\xef\xbb\xbf") in (b"", b"-1"):
            at = after
            continue
        found = re.match(rb" *(\d+)([bB])?(.*)", text.strip(b"\r\n"))
        if found is None:
            raise RecordingError(
                f"{path}: no dataset begins at byte {at}, where one should; a universal file that is damaged, copy it again"
            )
        number, binary = int(found[1]), None
        records += number == 58
        if number == 58 and found[2]:
            binary = _binary_header(f"{path}: record {records}", found[3].decode("ascii", "replace"))
            begin = after
            for _ in range(_HEADER_LINES):
                line = _line(data, after)
                if line is None:
                    raise RecordingError(
                        f"{path}: record {records} of the universal file is cut short; copy the file again"
                    )
                after = line[1]
            end = _end_of_binary(path, data, records, binary, begin, after)
        else:
            begin, closing = after, _END_LINE.search(data, max(after - 1, 0))
            end = len(data) if closing is None else closing.start() + 1
        yield number, binary, begin, end
        closing = _END.match(data, end)
        at = end if closing is None else closing.end()


def _line(data: mmap.mmap, at: int) -> tuple[bytes, int] | None:
    """The line at a place and where the next begins; None at the end of the file."""
    if at >= len(data):
        return None
    stop = data.find(b"\n", at)
    after = len(data) if stop < 0 else stop + 1
    return data[at:after], after


def _binary_header(where: str, text: str) -> tuple[int, int]:
    """Byte order (1 little, 2 big) and the stated number of bytes of a 58b."""
    words = [int(word) for word in text.split() if re.fullmatch(r"-?\d+", word)]
    order, encoding, _, length = [*words, *[0] * 4][:4]
    if len(words) < 4 or order not in (1, 2):
        raise RecordingError(
            f"{where}: a binary record without byte order and length; export the file again, or as text"
        )
    if encoding not in (0, 2):
        raise RecordingError(f"{where}: numbers in another notation than IEEE 754 (code {encoding}); export it as text")
    return order, length


def _end_of_binary(
    path: Path, data: mmap.mmap, record: int, binary: tuple[int, int], begin: int, data_begin: int
) -> int:
    """Where the numbers of a 58b end: where the closing line stands, of all places where the header lets it stand."""
    lines = text_of(data[begin:data_begin]).splitlines()
    form = form_of(f"{path}: record {record}", lines[6])
    count = form.count
    lengths = [count * dtype.itemsize for dtype in _dtypes(form.ordinate, form.even, binary[0])]
    for length in (*lengths, binary[1]):
        if length >= lengths[0] and _END.match(data, data_begin + length):
            return data_begin + length
    for length in lengths:
        left = len(data) - data_begin - length
        if 0 <= left <= 2 and not data[data_begin + length :].strip():  # the closing line was never written
            return data_begin + length
    if data_begin + lengths[0] > len(data):
        there = (len(data) - data_begin) * count // max(lengths[0], 1)
        raise RecordingError(
            f"{path}: record {record} of the universal file is cut short, {there} of {count} values are there; copy it again"
        )
    closing = re.compile(rb"(?:\r?\n)? {4}-1[ \t]*\r?\n(?= {4}-1|\s*\Z)").search(data, data_begin + lengths[0])
    if closing is not None and closing.start() - data_begin - lengths[0] <= 64:  # padded to a whole number of lines
        return closing.start()
    raise RecordingError(
        f"{path}: record {record}: its {count} values do not end where its header says; export the file again, or as text"
    )


def _dtypes(ordinate: int, even: bool, order: int) -> list[np.dtype]:
    """How one value may stand in a binary record: the description has a single abscissa, most writers one like the ordinate."""
    parts, width = ORDINATES[ordinate]
    sign = "<" if order == 1 else ">"
    y = ("y", f"{sign}f{width}", (parts,))
    if even:
        return [np.dtype([y])]
    return [np.dtype([("x", f"{sign}f{x}"), y]) for x in sorted({4, width})]


def _function(
    path: Path, data: mmap.mmap, number: int, binary: tuple[int, int] | None, begin: int, end: int
) -> Function:
    """One dataset 58 from its header lines."""
    at, lines = begin, []
    while len(lines) < _HEADER_LINES and at < end and (line := _line(data, at)) is not None:
        lines.append(text_of(line[0]).rstrip("\r\n"))
        at = line[1]
    where = f"{path}: record {number}"
    if len(lines) < _HEADER_LINES:
        raise RecordingError(f"{where} of the universal file is cut short, before its numbers; copy the file again")
    kind, _, version, case, *dofs = identity(where, lines[5])
    form = form_of(where, lines[6])
    dtype = None
    if binary is not None:
        dtypes = _dtypes(form.ordinate, form.even, binary[0])
        dtype = next((d for d in reversed(dtypes) if at + form.count * d.itemsize <= end), dtypes[0])
    elif 2 * form.count * (ORDINATES[form.ordinate][0] + (not form.even)) > end - at + 2:  # a digit and a blank each
        raise RecordingError(
            f"{where}: cut short, {end - at} bytes cannot hold {form.count} values; copy the file again"
        )
    axes = [axis_of(where, line) for line in lines[7:10]]
    return Function(
        path=path,
        number=number,
        ids=tuple(line.strip() for line in lines[:5]),
        kind=kind,
        version=version,
        load_case=case,
        response=Dof(*dofs[:3]),
        reference=Dof(*dofs[3:]),
        **form._asdict(),
        abscissa=axes[0],
        numerator=axes[1],
        denominator=axes[2],
        units=None,
        start=at,
        stop=end,
        binary=dtype,
    )


def _with_units(function: Function, units: Units | None) -> Function:
    """The function in the units of the file; a known system's own factors where the file contradicts itself."""
    if units is not None and units.contradicts_itself:
        units = Units(units.code, units.description, *SYSTEMS[units.code])
    return replace(function, units=units)
