"""Text tables: CSV in every dialect, tab and blank separated columns, and the exports of measuring programs.

The file is cut into blocks of whole lines. A block that holds nothing but numbers goes through pandas' C parser into
float64 at once; only a block that fails there is looked at line by line, so that a good file is read at full speed and a
bad cell is named with its line and column. Memory does not grow with the file.

The `[text]` table of a setup states what looking cannot tell.
"""

import codecs
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats import dynoware
from millcal.io.formats.dialect import CLOCK, Dialect, is_comment, is_missing, sniff_dialect, split
from millcal.io.formats.dialect import HEAD as SNIFFED
from millcal.io.formats.headers import is_time
from millcal.io.formats.source import Column, Progress, Source
from millcal.io.formats.time_base import unwrapped_midnights
from millcal.io.keys import TextTable

BLOCK = 1 << 23  # bytes of text at a time: 8 MB keeps the whole under 300 MB and the parser at full speed
_LONGEST_LINE = 1 << 22  # bytes
_LINE_FEED = 10
_LONGEST_FOOTER = 5  # lines


@dataclass
class _Reading:
    """What is learned while the rows of one file pass by."""

    path: Path
    dialect: Dialect
    line: int  # of the next block's first line, from 1
    rows: int = 0
    notices: list[Notice] = field(default_factory=list)
    left_out: int = 0  # lines between the numbers that are remarks
    first_left_out: int = 0

    def error(self, line: int, what: str, mending: str) -> RecordingError:
        return RecordingError(f"{self.path}: line {line}: {what}; {mending}")


def sniff(path: Path, head: bytes) -> bool:
    """Whatever no other format claims is taken for text; the dialect decides whether it is."""
    return True


def open_source(path: Path, setup: Any = None) -> Source:
    """Look at the head of a text file; its numbers are read when the blocks are asked for."""
    layout = getattr(setup, "text", None) or TextTable()
    with open(path, "rb") as file:
        head = file.read(SNIFFED)
    dialect = sniff_dialect(path, head, layout)
    keys = dynoware.keys_of(dialect.preamble)
    from_dynoware = dynoware.is_dynoware(dialect.preamble)
    numeric = [i for i, kind in enumerate(dialect.kinds) if kind != "text"]
    notices = list(dialect.notices)
    words = [dialect.names[i] for i, kind in enumerate(dialect.kinds[: len(dialect.names)]) if kind == "text"]
    if words:
        message = f"columns without numbers are left out: {', '.join(words)}"
        notices.append(Notice("text-columns", message, str(path)))
    promised = dynoware.stated_rows(keys) if from_dynoware else None

    def blocks(progress: Progress) -> Iterator[np.ndarray]:
        return _blocks(_Reading(path, dialect, dialect.first_line, notices=notices), numeric, promised, progress)

    return Source(
        path=path,
        format="dynoware" if from_dynoware else "text",
        columns=_columns(path, dialect, numeric, layout),
        blocks=blocks,
        sample_rate=dynoware.stated_rate(keys),
        place=lambda row: f"line {dialect.first_line + row}",
        notices=notices,
        details={
            "encoding": dialect.encoding,
            "delimiter": "whitespace" if dialect.delimiter == " " else dialect.delimiter,
            "decimal": dialect.decimal,
            "first_line": dialect.first_line,
            "header": keys,
        },
    )


def _columns(path: Path, dialect: Dialect, numeric: list[int], layout: TextTable) -> tuple[Column, ...]:
    """The columns of numbers; the time among them where the file or the setup tells it."""
    if layout.time is not None and layout.time not in dialect.names:
        raise RecordingError(
            f"{path}: the time column '{layout.time}' is not in the file; it has {', '.join(dialect.names)}"
            ". Correct [text] time of the setup"
        )
    columns = []
    for i in numeric:
        name, clock = dialect.names[i], dialect.kinds[i] == "clock"
        is_the_time = name == layout.time if layout.time else clock or is_time(name, dialect.units[i])
        unit = "s" if clock else dialect.units[i]
        if is_the_time and layout.time_unit and not clock:
            unit = layout.time_unit
        columns.append(Column(name, unit=unit, written=dialect.written[i], quantity="time" if is_the_time else None))
    return tuple(columns)


def _blocks(reading: _Reading, numeric: list[int], promised: int | None, progress: Progress) -> Iterator[np.ndarray]:
    """The numeric columns, block by block.   yields (column, n)"""
    size = reading.path.stat().st_size
    clocks = [k for k, i in enumerate(numeric) if reading.dialect.kinds[i] == "clock"]
    last_clock: dict[int, float] = {}
    for block, done, last in _byte_blocks(reading.path, reading.dialect):
        values = _parse(reading, block, last)[numeric]
        for k in clocks:
            values[k] = unwrapped_midnights(values[k], last_clock.get(k)) if values.shape[1] else values[k]
            last_clock[k] = values[k, -1] if values.shape[1] else last_clock.get(k, 0.0)
        reading.line += int(np.count_nonzero(np.frombuffer(block, np.uint8) == _LINE_FEED))
        reading.rows += values.shape[1]
        progress(min(done / max(size, 1), 1.0), "reading")
        if values.shape[1]:
            yield values
    if reading.left_out:
        message = (
            f"{reading.left_out} lines without numbers were passed over, the first is line {reading.first_left_out}"
        )
        reading.notices.append(Notice("lines-left-out", message, str(reading.path)))
    reading.notices.extend(dynoware.rows_against_header(str(reading.path), reading.rows, promised))


def _byte_blocks(path: Path, dialect: Dialect) -> Iterator[tuple[bytes, int, bool]]:
    """Whole lines from the first row on: (bytes, how many bytes of the file are done, whether it is the last)."""
    with open(path, "rb") as raw:
        file: BinaryIO = _Recoded(raw, dialect.encoding) if dialect.recodes else raw  # type: ignore[assignment]
        if dialect.encoding == "utf-8-sig" and not dialect.recodes:
            raw.seek(len(codecs.BOM_UTF8))
        for _ in range(dialect.first_line - 1):
            file.readline()
        following = file.read(BLOCK)
        while block := following:
            tail = file.readline(_LONGEST_LINE)
            if len(tail) == _LONGEST_LINE:
                raise RecordingError(f"{path}: a line of more than 4 MB; this is no table, export the recording again")
            following = file.read(BLOCK)
            yield block + tail if tail else block, raw.tell(), not following


class _Recoded:
    """A file in an encoding whose bytes cannot be cut into lines, as UTF-8 with plain line ends."""

    def __init__(self, raw: BinaryIO, encoding: str) -> None:
        self.text = io.TextIOWrapper(raw, encoding=encoding, errors="replace", newline=None)

    def readline(self, size: int = -1) -> bytes:
        return self.text.readline(size).encode()

    def read(self, size: int) -> bytes:
        return self.text.read(size).encode()


def _parse(reading: _Reading, block: bytes, last: bool) -> np.ndarray:
    """All columns of one block, NaN where a cell is blank or holds words in a column of words.   returns (column, n)"""
    dialect = reading.dialect
    width = len(dialect.kinds)
    first_row = block[: block.find(b"\n")] if b"\n" in block else block
    plain = all(kind == "number" for kind in dialect.kinds)
    # pandas silently cuts a first row that is too long, and fills up any row that is too short (caught by the filter).
    if plain and _cell_count(first_row, dialect) == width:
        try:
            frame = _read_csv(block, dialect, np.float64, na_filter=False, skip_blank_lines=True)
            return _transposed(frame)
        except (ValueError, pd.errors.ParserError):
            pass
    if _cell_count(first_row, dialect) == width:
        values = _parse_with_gaps(reading, block, last)
        if values is not None:
            return values
    return _parse_by_line(reading, block, last)


def _read_csv(block: bytes, dialect: Dialect, dtype: Any, **options: Any) -> pd.DataFrame:
    return pd.read_csv(
        io.BytesIO(block),
        header=None,
        names=range(len(dialect.kinds)),
        dtype=dtype,
        sep=r"\s+" if dialect.delimiter == " " else dialect.delimiter,
        decimal=dialect.decimal,
        encoding="latin-1",  # never fails; the numbers are plain in every encoding that comes here
        index_col=False,
        engine="c",
        **options,
    )


def _transposed(frame: pd.DataFrame) -> np.ndarray:
    return np.ascontiguousarray(frame.to_numpy(dtype=np.float64, copy=False).T)


def _cell_count(line: bytes, dialect: Dialect) -> int:
    return len(split(line.decode("latin-1"), dialect.delimiter)) if line.strip() else len(dialect.kinds)


def _parse_with_gaps(reading: _Reading, block: bytes, last: bool) -> np.ndarray | None:
    """Blocks with blank cells, clocks or words: still pandas, then a look at the lines with gaps. None where it fails."""
    dialect = reading.dialect
    dtype = {i: np.float64 if kind == "number" else str for i, kind in enumerate(dialect.kinds)}
    try:
        frame = _read_csv(block, dialect, dtype, skip_blank_lines=False, na_values=["-", "--", "none", "None"])
    except (ValueError, pd.errors.ParserError):
        return None
    lines = None
    values = np.empty((len(dialect.kinds), len(frame)))
    for i, kind in enumerate(dialect.kinds):
        if kind == "number":
            values[i] = frame[i].to_numpy()
        elif kind == "clock":
            try:
                values[i] = _seconds(frame[i], dialect.decimal)
            except ValueError:
                return None
        else:
            values[i] = 0.0
    needed = [i for i, kind in enumerate(dialect.kinds) if kind != "text"]
    suspicious = np.flatnonzero(~np.isfinite(values[needed]).all(axis=0))
    keep = np.ones(values.shape[1], dtype=bool)
    for row in suspicious:
        lines = block.split(b"\n") if lines is None else lines
        keep[row] = _cells_of(reading, lines[row], reading.line + row, last and row >= len(frame) - 1) is not None
    return values[:, keep]


def _cells_of(reading: _Reading, line: bytes, number: int, last: bool) -> list[str] | None:
    """The cells of one line of text, None where it is no row: blank, a remark, or the last one cut short."""
    text = line.decode("latin-1").strip("\r\n")
    if not text.strip():
        return None
    if is_comment(text):
        reading.first_left_out = reading.first_left_out or number
        reading.left_out += 1
        return None
    cells = split(text, reading.dialect.delimiter)
    width = len(reading.dialect.kinds)
    if len(cells) == width:
        return cells
    if last and len(cells) < width:
        message = f"the last line, {number}, is cut short and left out"
        reading.notices.append(Notice("last-line-cut", message, str(reading.path)))
        return None
    raise reading.error(
        number,
        f"{len(cells)} cells where the table has {width} columns",
        "mend the line, or export the recording again",
    )


def _parse_by_line(reading: _Reading, block: bytes, last: bool) -> np.ndarray:
    """The slow look: every cell of every line, to name the one that is wrong or to pass over remarks."""
    dialect = reading.dialect
    rows: list[list[float]] = []
    lines = block.split(b"\n")
    if lines and not lines[-1].strip():
        lines.pop()
    for offset, line in enumerate(lines):
        number = reading.line + offset
        if last and len(lines) - offset <= _LONGEST_FOOTER and _is_footer(lines[offset:], dialect):
            reading.first_left_out = reading.first_left_out or number
            reading.left_out += len(lines) - offset
            break
        cells = _cells_of(reading, line, number, last and offset == len(lines) - 1)
        if cells is not None:
            rows.append([_value(reading, cell, i, number) for i, cell in enumerate(cells)])
    return np.array(rows, dtype=np.float64).reshape(-1, len(dialect.kinds)).T.copy()


def _is_footer(lines: list[bytes], dialect: Dialect) -> bool:
    """Whether only words follow, as in `End of data`: a few lines in which no cell is a number."""
    cells = [cell for line in lines for cell in split(line.decode("latin-1"), dialect.delimiter)]
    return not any(re.search(r"\d", cell) for cell in cells) and not all(is_missing(cell) for cell in cells)


def _value(reading: _Reading, cell: str, column: int, line: int) -> float:
    kind = reading.dialect.kinds[column]
    if kind == "text":
        return 0.0
    if is_missing(cell):
        return np.nan
    try:
        if kind == "clock" and CLOCK.fullmatch(cell):
            return float(_seconds(pd.Series([cell]), reading.dialect.decimal)[0])
        return float(cell.replace(",", ".") if reading.dialect.decimal == "," else cell)
    except ValueError:
        name = reading.dialect.names[column]
        raise reading.error(
            line, f"column '{name}' holds {cell[:40]!r} where a number is needed", "mend the cell or delete the line"
        ) from None


def _seconds(cells: pd.Series, decimal: str) -> np.ndarray:
    """Times of day, or since a start, in s: `13:59:58.125`, `59:58.125`, `2018-03-15 13:59:58,125`."""
    plain = cells.str.replace(",", ".", regex=False)
    first = plain.dropna()
    if len(first) and "-" in first.iloc[0]:
        return (pd.to_datetime(plain, format="ISO8601") - pd.Timestamp(0)).to_numpy() / np.timedelta64(1, "ns") * 1e-9
    if len(first) and first.iloc[0].count(":") == 1:
        plain = "00:" + plain
    return pd.to_timedelta(plain).to_numpy() / np.timedelta64(1, "ns") * 1e-9
