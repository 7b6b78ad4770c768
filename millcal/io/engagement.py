"""Engagement tables: how the tool meets the work along its path, one row for each place where something begins to change.

    s_mm, axial_depth_mm, entry_deg, exit_deg, feed_direction_deg
    0, 2, 113.6, 180, 0
    24, 2, 90, 180, 0

and, where it is not that of the conditions, `feed_per_tooth_mm` or `feed_mm_per_min`. Between two rows everything is straight,
two rows at one place are a step. A table says all of this for the whole cut, so what it does not say is not guessed.
"""

from pathlib import Path

import numpy as np

from millcal.errors import RecordingError
from millcal.io.formats.dialect import HEAD, Dialect, is_comment, is_number, sniff_dialect, split
from millcal.io.formats.headers import name_and_unit
from millcal.io.keys import ConditionsTable, TextTable
from millcal.physics.cutter import Cutter
from millcal.physics.tool_path import ToolPath
from millcal.units import FILE_UNITS, from_shop, normal_unit, to_shop

NEEDED = ("s_mm", "axial_depth_mm", "entry_deg", "exit_deg", "feed_direction_deg")
FEEDS = ("feed_per_tooth_mm", "feed_mm_per_min")
_ROUNDING = 1e-6  # deg
_BARE = {key.rsplit("_", 1)[0]: key for key in (*NEEDED, "feed_per_tooth_mm")}  # without the unit


def read_engagement(path: Path) -> ToolPath:
    """Read and check an engagement table."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise RecordingError(f"{path}: {reason}; check the path of the engagement table") from None
    dialect = sniff_dialect(path, data[:HEAD], TextTable())
    keys, factors = _columns(path, dialect)
    lines, rows = _rows(path, data, dialect)
    values = np.array([[row[i] for i in keys.values()] for row in rows]) * [factors[key] for key in keys]
    columns = dict(zip(keys, values.T, strict=True))
    _check(path, lines, columns)
    si = {key: from_shop(column, key) for key, column in columns.items()}
    return ToolPath(
        position=si["s_mm"],
        axial_depth=si["axial_depth_mm"],
        entry=np.clip(si["entry_deg"], 0.0, np.pi),
        leave=np.clip(si["exit_deg"], 0.0, np.pi),
        feed_direction=si["feed_direction_deg"],
        feed_per_tooth=si.get("feed_per_tooth_mm"),
        feed_rate=si.get("feed_mm_per_min"),
        name=str(path),
    )


def completed(keys: ConditionsTable, path: ToolPath, cutter: Cutter | None) -> ConditionsTable:
    """Conditions of a cut along a path: the table's largest depth, and where they are not given, its widest engagement."""
    found: dict[str, object] = {"axial_depth_mm": to_shop(float(path.axial_depth.max()), "_mm")}
    if cutter is not None:
        cutting = path.axial_depth > 0
        width = np.where(cutting, np.cos(path.entry) - np.cos(path.leave), 0.0) * cutter.radius
        widest = int(np.argmax(width))
        before, after = path.entry[widest], np.pi - path.leave[widest]
        slot = max(before, after) < 1e-3
        if keys.direction is None:
            found["direction"] = "slot" if slot else "down" if after < before else "up"
        if keys.radial_depth_mm is None and found.get("direction", keys.direction) != "slot" and width[widest] > 0:
            found["radial_depth_mm"] = to_shop(min(float(width[widest]), cutter.diameter), "_mm")
    return keys.model_copy(update=found)


def _columns(path: Path, dialect: Dialect) -> tuple[dict[str, int], dict[str, float]]:
    """Key -> number of the column, and key -> factor to the unit of the key."""
    keys: dict[str, int] = {}
    factors: dict[str, float] = {}
    for number, (cell, kind) in enumerate(zip(dialect.written, dialect.kinds, strict=False)):
        key, factor = _key_of(path, cell)
        if key is None:
            if is_number(cell, dialect.decimal):  # a row that is too short or too long parts the table
                raise RecordingError(
                    f"{path}: line {dialect.first_line - 1}: not as many cells as in the rows below it; write one for "
                    "each column"
                )
            if kind == "number":
                raise RecordingError(
                    f"{path}: line {dialect.first_line - 1}: unknown column '{cell}'; an engagement table has "
                    f"{', '.join(NEEDED)}, and may have {' or '.join(FEEDS)}"
                )
            continue
        if key in keys:
            raise RecordingError(f"{path}: line {dialect.first_line - 1}: two columns are {key}; take one out")
        keys[key], factors[key] = number, factor
    missing = [key for key in NEEDED if key not in keys]
    if missing:
        have = ", ".join(cell for cell in dialect.written if cell) or "no header"
        raise RecordingError(
            f"{path}: no column {', '.join(missing)}; it has {have}. Name the columns in a header line: {', '.join(NEEDED)}"
        )
    if all(feed in keys for feed in FEEDS):
        raise RecordingError(f"{path}: {FEEDS[0]} and {FEEDS[1]} both say the feed; keep one of the columns")
    return keys, factors


def _key_of(path: Path, cell: str) -> tuple[str | None, float]:
    """The key that a header cell stands for, and the factor from its unit: `s_mm`, `Entry [deg]`, `s (m)`."""
    written = cell.strip().strip("'\"").strip()
    known = written.lower().replace(" ", "_")
    if known in (*NEEDED, *FEEDS):
        return known, 1.0
    name, unit = name_and_unit(written)
    key = _BARE.get(name.strip().lower().replace(" ", "_"))
    if key is None or unit is None:
        return None, 1.0
    measured, wanted = FILE_UNITS.get(normal_unit(unit)), FILE_UNITS[key.rsplit("_", 1)[1]]
    if measured is None or measured[0] != wanted[0]:
        raise RecordingError(f"{path}: column '{cell}' is in {unit}; write it as {key}")
    return key, measured[2] / wanted[2]


def _rows(path: Path, data: bytes, dialect: Dialect) -> tuple[list[int], list[list[float]]]:
    """The numbers and the lines they stand in."""
    text = data.decode(dialect.encoding, errors="replace").lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    width = len(dialect.written)
    lines, rows = [], []
    for number, line in enumerate(text.split("\n"), start=1):
        if number < dialect.first_line or not line.strip() or is_comment(line):
            continue
        cells = split(line, dialect.delimiter)
        if len(cells) < width or any(cells[width:]):
            raise RecordingError(f"{path}: line {number}: {len(cells)} cells under {width} columns; write one for each")
        values = []
        for cell, kind in zip(cells, dialect.kinds, strict=False):
            if kind == "number" and not is_number(cell, dialect.decimal):
                raise RecordingError(
                    f"{path}: line {number}: '{cell}' is no number; write one, an empty cell says nothing"
                )
            values.append(float(cell.replace(",", ".")) if kind == "number" else np.nan)
        lines.append(number)
        rows.append(values)
    if len(rows) < 2:
        raise RecordingError(
            f"{path}: {len(rows)} rows of numbers; a path has a beginning and an end, write at least 2"
        )
    return lines, rows


def _check(path: Path, lines: list[int], columns: dict[str, np.ndarray]) -> None:
    """What no path can be is refused at its line."""
    s, entry, leave = columns["s_mm"], columns["entry_deg"], columns["exit_deg"]
    step = np.diff(s)
    feeds = [columns[feed] for feed in FEEDS if feed in columns]
    tests = [
        (np.append(False, step < 0), "s_mm goes back; put the rows in the order of the path"),
        (
            np.append([False, False], (step[1:] == 0) & (step[:-1] == 0)),
            "the third row at one place; a step has two, one for what ends and one for what begins",
        ),
        (columns["axial_depth_mm"] < 0, "axial_depth_mm is below 0; write 0 where nothing is cut"),
        (
            (entry < -_ROUNDING) | (leave > 180 + _ROUNDING),
            "an angle outside 0 to 180 degrees, where no chip is cut: they count clockwise from +y with the feed along +x; "
            "end the engagement at 0 and 180",
        ),
        (entry > leave, "entry_deg is above exit_deg; write the smaller angle first"),
        *((feed <= 0, "the feed is not above 0; leave the tool where it stands out of the table") for feed in feeds),
    ]
    for wrong, what in tests:
        if wrong.any():
            raise RecordingError(f"{path}: line {lines[int(np.argmax(wrong))]}: {what}")
    if s[-1] <= s[0]:
        raise RecordingError(f"{path}: line {lines[-1]}: all rows are at {s[0]:g} mm; a path goes on")
