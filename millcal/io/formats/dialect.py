"""How a text file writes its table: encoding, delimiter, decimal sign, where the numbers begin, and what stands above.

Every pair of delimiter and decimal sign is tried on the first lines; the pair under which most lines are rows of numbers
of one length wins, and of two equals the one that the header agrees with. Nothing is guessed from the file's name.
"""

import codecs
import csv
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats.headers import is_units_row, name_and_unit, unique_names
from millcal.io.keys import TextTable

HEAD = 1 << 18  # bytes looked at
_MOST_LINES = 600
WHITESPACE = " "
DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)
MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "inf", "+inf", "-inf", "1.#qnan", "-1.#ind")
_COMMENT = ("#", "%", "//", "!")
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eE][+-]?\d+)?"),
}
_GROUPED = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+,\d+|\d{1,3}(,\d{3})+\.\d+)")  # 1.234,5
CLOCK = re.compile(r"(\d{4}-\d\d-\d\d[ T])?(\d{1,3}:\d{2}:\d{2}([.,]\d+)?|\d{1,3}:\d{2}[.,]\d+)")
_SPACED_HEADER = re.compile(r"[^\s\[(]\S*(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True)
class Dialect:
    """Everything needed to read the rows."""

    encoding: str
    delimiter: str  # WHITESPACE: any run of blanks
    decimal: str
    first_line: int  # of the numbers, from 1
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    written: tuple[str, ...]  # header cells as they stand
    kinds: tuple[str, ...]  # of each column: number, clock, text
    preamble: tuple[str, ...]  # the lines above the header
    lone_returns: bool = False  # some lines end in CR alone
    notices: tuple[Notice, ...] = ()

    @property
    def recodes(self) -> bool:
        """Whether the bytes must be decoded before they can be cut into lines."""
        return self.lone_returns or self.encoding.startswith("utf-16")


def sniff_dialect(path: Path, head: bytes, layout: TextTable) -> Dialect:
    """Look at the first bytes of a text file.

    head : the first HEAD bytes   layout : what the user states, instead of looking
    """
    encoding = _known_encoding(path, layout.encoding) if layout.encoding else sniff_encoding(path, head)
    text = head.decode(encoding, errors="replace").lstrip("\ufeff")
    lone_returns = re.search(r"\r(?!\n|$)", text) is not None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if len(head) >= HEAD and len(lines) > 1:
        lines.pop()  # cut by the end of the look
    lines = lines[:_MOST_LINES]
    if not any(line.strip() for line in lines):
        raise RecordingError(f"{path}: holds nothing; export the recording again")
    skipped = min(layout.skip_rows or 0, len(lines))
    lines = [""] * skipped + lines[skipped:]
    delimiter, decimal, first, width = _best_pair(path, lines, layout.delimiter, layout.decimal)
    rows = [split(line, delimiter) for line in lines[first:] if line.strip()]
    rows = [row for row in rows if len(row) == width]
    kinds = tuple(_kind([row[i] for row in rows], decimal) for i in range(width))
    for i in (i for i, kind in enumerate(kinds) if kind == "text"):
        _refuse_other_numbers(path, [row[i] for row in rows], decimal)
    above = lines[:first]
    names, units, written, used, notices = _header(path, above, delimiter, width)
    if layout.columns:
        if len(layout.columns) != width:
            raise RecordingError(
                f"{path}: {width} columns in the file and {len(layout.columns)} names in [text] columns of the setup; "
                "name each column"
            )
        names, notices = list(layout.columns), []
    if not names[-1] and all(not row[-1].strip() for row in rows):  # every line ends in a delimiter
        names, units, written, kinds = names[:-1], units[:-1], written[:-1], (*kinds[:-1], "text")
    unique, repeated = unique_names(names)
    if repeated:
        message = f"several columns are named {', '.join(sorted(set(repeated)))}; numbers were added: " + ", ".join(
            unique
        )
        notices.append(Notice("duplicate-names", message, str(path)))
    kept = len(unique)
    return Dialect(
        encoding=encoding,
        delimiter=delimiter,
        decimal=decimal,
        first_line=first + 1,
        names=tuple(unique),
        units=tuple(units),
        written=tuple(written),
        kinds=kinds[:kept] + ("text",) * (width - kept),
        preamble=tuple(line for line in above[: len(above) - used] if line.strip()),
        lone_returns=lone_returns,
        notices=tuple(notices),
    )


def _known_encoding(path: Path, encoding: str) -> str:
    try:
        return codecs.lookup(encoding).name
    except LookupError:
        raise RecordingError(f"{path}: unknown encoding {encoding!r}; write utf-8, utf-16, latin-1 or gbk") from None


def sniff_encoding(path: Path, head: bytes) -> str:
    """UTF-8 with or without its mark, UTF-16, GBK, or else Latin-1, in which every byte is a letter."""
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    zeros = head[:4096].count(0)
    if zeros:
        sample = head[:4096]
        if sample[1::2].count(0) > 0.9 * len(sample[1::2]) and not sample[::2].count(0):
            return "utf-16-le"
        raise RecordingError(f"{path}: binary, and of no format that is known; export it as text or HDF5")
    odd = sum(head.count(bytes([byte])) for byte in range(1, 32) if byte not in b"\t\n\r\f\x1a\x1b")
    if odd > 0.01 * len(head):
        raise RecordingError(f"{path}: binary, and of no format that is known; export it as text or HDF5")
    whole = head[: head.rfind(b"\n") + 1] or head  # not the middle of a letter
    try:
        whole.decode("utf-8")
        return "utf-8"
    except UnicodeDecodeError:
        pass
    # GB 2312 letters are pairs of high bytes. Latin-1 letters mostly stand alone between plain ones.
    runs = re.findall(rb"[\x80-\xff]+", whole)
    pairs = all(len(run) % 2 == 0 and min(run) >= 0xA1 and max(run[::2]) <= 0xF7 for run in runs)
    return "gbk" if pairs else "latin-1"


def split(line: str, delimiter: str) -> list[str]:
    """The cells of one line; quotes hold a cell together."""
    if delimiter == WHITESPACE:
        return line.split()
    if '"' in line:
        with suppress(csv.Error):  # quotes that hold nothing together stay in their cells
            return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    return [cell.strip() for cell in line.split(delimiter)]


def is_comment(line: str) -> bool:
    """Whether a line is a remark between the numbers."""
    return line.lstrip().startswith(_COMMENT)


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number written with this decimal sign."""
    return _NUMBER[decimal].fullmatch(cell) is not None


def is_missing(cell: str) -> bool:
    """Whether a cell holds no number by intention: blank, NaN, an overflow."""
    return cell.strip().lower() in MISSING


def _is_row(cells: list[str], decimal: str) -> bool:
    numbers = 0
    for cell in cells:
        if is_number(cell, decimal) or CLOCK.fullmatch(cell):
            numbers += 1
        elif not is_missing(cell):
            return False
    return numbers > 0


def _kind(cells: list[str], decimal: str) -> str:
    """Number, unless most of the written cells are times of day or words."""
    written = [cell for cell in cells if not is_missing(cell)]
    clocks = sum(CLOCK.fullmatch(cell) is not None for cell in written)
    numbers = sum(is_number(cell, decimal) for cell in written)
    if 2 * clocks > len(written):
        return "clock"
    return "number" if 2 * numbers >= len(written) else "text"


def _best_pair(path: Path, lines: list[str], delimiter: str | None, decimal: str | None) -> tuple[str, str, int, int]:
    """Delimiter, decimal sign, index of the first row of numbers, and the number of its cells."""
    pairs = [
        (d, point)
        for d in ([delimiter] if delimiter else DELIMITERS)
        for point in ([decimal] if decimal else (".", ","))
        if d != point
    ]
    best, best_rank = None, (0, 0, 0)
    for whole_rows in (True, False):  # a column of words is looked for only where rows of numbers alone are not found
        for d, point in pairs:
            found = _rows_of(lines, d, point, whole_rows)
            if found is None:
                continue
            count, first, width = found
            rank = (count, _names_match(lines[:first], d, width), width)
            if rank > best_rank:
                best, best_rank = (d, point, first, width), rank
        if best:
            break
    if best is None:
        raise RecordingError(f"{path}: {_why_no_table(lines)}")
    d, point, first, width = best
    names = _cells_above(lines[:first], d)
    decimals_split = 1 < len(names) < width <= 2 * len(names) and not any("." in line for line in lines[first:])
    if d == "," and decimals_split and not lines[first].rstrip().endswith(","):
        raise RecordingError(
            f"{path}: {len(names)} names over {width} numbers, as with decimal commas in a table whose cells are "
            "separated by commas; export with semicolons or tabs"
        )
    return best


def _rows_of(lines: list[str], delimiter: str, decimal: str, whole_rows: bool) -> tuple[int, int, int] | None:
    """How many lines are rows of numbers of the commonest length, the first of them, and that length."""
    widths: dict[int, int] = {}
    for index, line in enumerate(lines):
        if not line.strip() or is_comment(line):
            continue
        cells = split(line, delimiter)
        if whole_rows:
            fits = _is_row(cells, decimal)
        else:
            fits = len(cells) > 1 and 2 * sum(is_number(c, decimal) or is_missing(c) for c in cells) >= len(cells)
            fits = fits and any(is_number(c, decimal) for c in cells)
        if fits:
            widths[index] = len(cells)
    if not widths:
        return None
    width, count = Counter(widths.values()).most_common(1)[0]
    rows = [index for index, cells in widths.items() if cells == width]
    # A lone number line far above the table belongs to the preamble ("Channels;3").
    for index, following in pairwise([*rows, len(lines)]):
        blank_between = all(not line.strip() or is_comment(line) for line in lines[index + 1 : following])
        if blank_between or index == rows[-1]:
            return count, index, width
    return count, rows[0], width


def _cells_above(above: list[str], delimiter: str) -> list[str]:
    """Cells of the line nearest above the numbers, without a comment sign."""
    written = [line for line in above if line.strip()]
    return _header_cells(written[-1], delimiter) if written else []


def _header_cells(line: str, delimiter: str) -> list[str]:
    bare = line.strip("\n")
    for sign in _COMMENT:
        bare = bare.removeprefix(sign)
    if delimiter == WHITESPACE:
        return [cell.strip() for cell in _SPACED_HEADER.findall(bare)]
    cells = split(bare, delimiter)
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return cells


def _names_match(above: list[str], delimiter: str, width: int) -> int:
    """How well the header agrees: 2 a name for each cell, 1 all but one (lines that end in a delimiter), 0 not."""
    return max(0, 2 - abs(len(_cells_above(above, delimiter)) - width))


def _header(
    path: Path, above: list[str], delimiter: str, width: int
) -> tuple[list[str], list[str | None], list[str], int, list[Notice]]:
    """Names, units and cells of the header, how many lines of `above` it took, and notices."""
    written = [index for index, line in enumerate(above) if line.strip()]
    rows = [_header_cells(above[index], delimiter) for index in written[-2:]]
    fits = [0 < len(row) <= width and (len(row) >= width - 1 or width <= 2) for row in rows]
    notices: list[Notice] = []
    if rows and fits[-1]:
        units_below = len(rows) == 2 and fits[0] and is_units_row(rows[1]) and not is_units_row(rows[0])
        cells = rows[0] if units_below else rows[-1]
        unit_cells = rows[-1] if units_below else []
        used = len(above) - written[-2 if units_below else -1]
        cells = cells + [""] * (width - len(cells))
        parsed = [name_and_unit(cell) for cell in cells]
        below = [cell.strip().strip("[]()").strip() or None for cell in unit_cells]
        below += [None] * (width - len(below))
        units = [under or beside for under, (_, beside) in zip(below, parsed, strict=True)]
        return [name for name, _ in parsed], units, cells, used, notices
    if rows:
        message = (
            f"the line above the numbers has {len(rows[-1])} cells and the rows {width}; "
            "the columns are named col1, col2, ..."
        )
        notices.append(Notice("header-not-understood", message, str(path)))
    names = [f"col{i}" for i in range(1, width + 1)]
    return names, [None] * width, [""] * width, 0, notices


def _refuse_other_numbers(path: Path, cells: list[str], decimal: str) -> None:
    """A column of numbers in another notation is not a column of words."""
    other = "," if decimal == "." else "."
    written = [cell for cell in cells if not is_missing(cell)]
    if 2 * sum(is_number(cell, other) or bool(_GROUPED.fullmatch(cell)) for cell in written) > len(written):
        raise RecordingError(f"{path}: {_why_no_table([*cells, '1.5', '1,5'])}")


def _why_no_table(lines: list[str]) -> str:
    text = "\n".join(lines)
    if any(_GROUPED.fullmatch(cell) for cell in re.split(r"[;|\s]+", text)):
        return "numbers with a point and a comma in one; export without thousands separators"
    both = [sum(bool(re.search(rf"\d{re.escape(sign)}\d", line)) for line in lines) for sign in ".,"]
    if all(both):
        return "no table: some numbers have a decimal point and some a decimal comma; export with one of them"
    written = [line for line in lines if line.strip()]
    if len(written) <= 3:
        return "a header, but no rows of numbers; export the recording again"
    return "no table of numbers was found; give a text file with one row of numbers per sample"
