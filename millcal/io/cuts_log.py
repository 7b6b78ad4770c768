"""The cuts log: cuts that were made and judged, one row for each, a CSV table with a header.

    rpm, axial_depth_mm, radial_depth_mm, feed_per_tooth_mm, stable, M_um, chatter_hz, power_W
    9200, 1.5, 0.8, 0.08, 1, 0.6, , 310

`stable` is 1 or 0; rpm, axial_depth_mm and stable are needed, the rest may be absent or blank, and `direction` (up, down,
slot) may be added. A row whose `stable` is blank was not judged. Columns of other names are the shop's own and are left alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from millcal.data import CutTests, Notice
from millcal.errors import RecordingError
from millcal.io.formats.dialect import DELIMITERS, is_comment, is_missing, is_number, sniff_encoding, split
from millcal.units import from_shop, to_shop

NEEDED = ("rpm", "axial_depth_mm", "stable")
POSITIVE = ("rpm", "axial_depth_mm", "radial_depth_mm", "feed_per_tooth_mm")
MEASURED = ("M_um", "chatter_hz", "power_W")
DIRECTIONS = ("up", "down", "slot")
SAME = 0.01  # of a radial depth
SLOWEST_RPM = 400.0  # a log without a faster cut was perhaps written in Hz,
DEEP = 10  # diameters: a deeper row was perhaps written in um,
MOST_DEEP = 3  # told one by one
SHALLOWEST_MM = 0.05  # and one without a deeper in m
_ALSO = {"spindle_speed_rpm": "rpm"}
_VERDICTS = {
    **dict.fromkeys(("1", "1.0", "1,0", "true", "yes", "stable"), True),
    **dict.fromkeys(("0", "0.0", "0,0", "false", "no", "chatter", "unstable"), False),
}


@dataclass(frozen=True)
class LoggedCut:
    """One row."""

    line: int  # of the file, from 1
    spindle_speed: float  # rad/s
    axial_depth: float  # m
    stable: bool | None  # None: not judged
    radial_depth: float | None = None  # m
    feed_per_tooth: float | None = None  # m
    direction: str | None = None
    metric: float | None = None  # M, m
    chatter_frequency: float | None = None  # Hz
    power: float | None = None  # W


def read_cuts_log(path: Path) -> tuple[LoggedCut, ...]:
    """Read and check a cuts log."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise RecordingError(f"{path}: {reason}; check the path of the cuts log") from None
    text = data.decode(sniff_encoding(path, data), errors="replace").lstrip("\ufeff")
    written = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = [(i, line) for i, line in enumerate(written, 1) if line.strip() and not is_comment(line)]
    if not lines:
        raise RecordingError(f"{path}: holds nothing; a cuts log has a header and a row for each cut")
    delimiter, columns, width = _columns(path, *lines[0])
    return tuple(_cut(path, number, split(line, delimiter), columns, width, delimiter) for number, line in lines[1:])


def cuts_on_map(
    cuts: Sequence[LoggedCut], path: Path, *, radial_depth: float, direction: str, diameter: float | None = None
) -> tuple[CutTests, tuple[Notice, ...]]:
    """The cuts that belong on a map of this engagement, and what was left out.

    path : of the log, for what is said   radial_depth : m; a cut that does not say its own belongs to the map
    diameter : m, of the cutter: a row that is many times as deep is told; None: not known
    """
    belong, others, unjudged = [], [], 0
    for cut in cuts:
        same = cut.radial_depth is None or abs(cut.radial_depth / radial_depth - 1) <= SAME
        if cut.stable is None:
            unjudged += 1
        elif same and (cut.direction is None or cut.direction == direction):
            belong.append(cut)
        else:
            others.append(cut)
    if not belong:
        raise RecordingError(f"{path}: {_none(others, radial_depth, direction)}")
    notices = []
    if others:
        what = f"{_rows(len(others))} of another radial depth or direction: not on this map, left out"
        notices.append(Notice("tests-left-out", what, str(path)))
    if unjudged:
        notices.append(Notice("tests-not-judged", f"{_rows(unjudged)} with a blank `stable`: left out", str(path)))
    notices += _other_units(cuts, path)
    if diameter is not None:
        deep = [cut for cut in belong if cut.axial_depth > DEEP * diameter]
        for cut in deep[:MOST_DEEP]:
            depth = f"axial_depth_mm: {to_shop(cut.axial_depth, '_mm'):g}"
            what = f"{depth} is more than {DEEP} diameters; if it is in um, divide by 1000"
            notices.append(Notice("tests-unit", what, f"{path}: line {cut.line}"))
    found = CutTests(
        spindle_speed=np.array([cut.spindle_speed for cut in belong]),
        axial_depth=np.array([cut.axial_depth for cut in belong]),
        stable=np.array([float(cut.stable is True) for cut in belong]),
        name=path.name,
    )
    return found, tuple(notices)


def _other_units(cuts: Sequence[LoggedCut], path: Path) -> list[Notice]:
    """Numbers that are right in another unit: all of them, for one cut may be an odd one."""
    fastest = to_shop(max(cut.spindle_speed for cut in cuts), "x_rpm")
    deepest = to_shop(max(cut.axial_depth for cut in cuts), "_mm")
    doubtful = []
    if fastest < SLOWEST_RPM:
        doubtful.append(f"no rpm is above {fastest:.3g}; if these are Hz, write 60 times as much")
    if deepest < SHALLOWEST_MM:
        doubtful.append(f"no axial_depth_mm is above {deepest:.3g}; if these are m, write 1000 times as much")
    return [Notice("tests-unit", what, str(path)) for what in doubtful]


def _columns(path: Path, number: int, header: str) -> tuple[str, dict[str, int], int]:
    """The delimiter, key -> number of its column, and how many columns there are."""
    keys = {key.lower(): key for key in (*NEEDED, *POSITIVE, *MEASURED, "direction")}
    best: tuple[str, dict[str, int], int] = (",", {}, 0)
    for delimiter in DELIMITERS:
        cells = [cell.strip("'\" ").lower() for cell in split(header, delimiter)]
        known = [keys.get(_ALSO.get(cell, cell)) for cell in cells]
        twice = {key for key in known if key and known.count(key) > 1}
        if twice:
            raise RecordingError(f"{path}: line {number}: two columns are {min(twice)}; take one out")
        columns = {key: i for i, key in enumerate(known) if key}
        if len(columns) > len(best[1]):
            best = delimiter, columns, len(cells)
    missing = [key for key in NEEDED if key not in best[1]]
    if missing:
        raise RecordingError(
            f"{path}: line {number}: no column {', '.join(missing)}; the first line of a cuts log is its header: rpm, "
            "axial_depth_mm, radial_depth_mm, feed_per_tooth_mm, stable"
        )
    return best


def _cut(path: Path, line: int, cells: Sequence[str], columns: dict[str, int], width: int, delimiter: str) -> LoggedCut:
    if len(cells) > width and any(cells[width:]):
        raise RecordingError(f"{path}: line {line}: {len(cells)} cells under {width} columns; write one for each")
    cells = [*cells, *[""] * (width - len(cells))]
    decimals = "." if delimiter == "," else ".,"
    values: dict[str, float | None] = {}
    for key in (*POSITIVE, *MEASURED):
        cell = cells[columns[key]] if key in columns else ""
        values[key] = None
        if is_missing(cell):
            if key in NEEDED:
                raise RecordingError(f"{path}: line {line}, {key}: is blank; every cut has one")
            continue
        if not any(is_number(cell, sign) for sign in decimals):
            raise RecordingError(f"{path}: line {line}, {key}: {cell!r} is no number; write one, or leave it blank")
        value = float(cell.replace(",", "."))
        if key in POSITIVE and not value > 0:
            raise RecordingError(f"{path}: line {line}, {key}: {cell} is not above 0; correct it")
        values[key] = from_shop(value, f"x_{key}")
    return LoggedCut(
        line=line,
        spindle_speed=values["rpm"],
        axial_depth=values["axial_depth_mm"],
        stable=_verdict(path, line, cells[columns["stable"]]),
        radial_depth=values["radial_depth_mm"],
        feed_per_tooth=values["feed_per_tooth_mm"],
        direction=_direction(path, line, cells[columns["direction"]] if "direction" in columns else ""),
        metric=values["M_um"],
        chatter_frequency=values["chatter_hz"],
        power=values["power_W"],
    )


def _verdict(path: Path, line: int, cell: str) -> bool | None:
    if is_missing(cell):
        return None
    if cell.lower() not in _VERDICTS:
        raise RecordingError(
            f"{path}: line {line}, stable: {cell!r} is neither 1 nor 0; write 1 for stable, 0 for chatter"
        )
    return _VERDICTS[cell.lower()]


def _direction(path: Path, line: int, cell: str) -> str | None:
    if is_missing(cell):
        return None
    if cell.lower() not in DIRECTIONS:
        raise RecordingError(f"{path}: line {line}, direction: {cell!r} is none of {', '.join(DIRECTIONS)}; correct it")
    return cell.lower()


def _none(others: Sequence[LoggedCut], radial_depth: float, direction: str) -> str:
    if not others:
        return "no cut in it is judged; write 1 or 0 under `stable`"
    depths = sorted({to_shop(cut.radial_depth, "_mm") for cut in others if cut.radial_depth is not None})
    have = f"radial depth {', '.join(f'{depth:g}' for depth in depths)} mm" if depths else "other directions"
    return (
        f"none of its cuts belongs on this map of {direction}, {to_shop(radial_depth, '_mm'):g} mm; they have {have}. Make the map "
        "for these, or name another log"
    )


def _rows(count: int) -> str:
    return f"{count} row{'s' if count != 1 else ''}"
