"""The stability map: limit depth and chatter frequency against spindle speed, with what a shop wants to know marked."""

from itertools import pairwise

import numpy as np

from millcal.data import StabilityMap
from millcal.report.charts import Band, Frame, Item, Line, Marks, Note, Panel, Rule, chart, span_of, thin
from millcal.report.digits import significant
from millcal.report.figures import POINTS, Column, Figure
from millcal.units import to_shop


def depth_drawn(map_: StabilityMap) -> float:
    """Highest depth of the picture, m: a lobe's peak may go to infinity, the depths of a shop do not."""
    finite = map_.limit_depth[np.isfinite(map_.limit_depth)]
    highest = 1.08 * float(finite.max()) if len(finite) else 0.0
    operating = 1.35 * map_.operating.axial_depth if map_.operating else 0.0
    wanted = [1.4 * best.axial_depth for best in map_.best]
    if np.isfinite(map_.absolute_minimum) and map_.absolute_minimum > 0:
        wanted.append(5.0 * map_.absolute_minimum)
    top = max(min(max(wanted), highest) if wanted and highest else highest or max(wanted, default=0.0), operating)
    return top or 1e-3


def _lobe_numbers(rpm: np.ndarray, lobe: np.ndarray, at: float, width: float) -> list[Item]:
    """The number of each lobe in the middle of its stretch, where there is room for it."""
    change = np.flatnonzero(np.diff(lobe) != 0) + 1
    edges = [0, *change.tolist(), len(lobe)]
    room = 34.0 / width * (rpm[-1] - rpm[0])
    notes: list[Item] = []
    for start, stop in pairwise(edges):
        if np.isfinite(lobe[start]) and rpm[stop - 1] - rpm[start] > room:
            notes.append(Note((rpm[start] + rpm[stop - 1]) / 2, at, f"{lobe[start]:.0f}"))
    return notes


def lobes(map_: StabilityMap) -> Figure:
    """The limit with its 95 % band, the chatter frequency with the lobes' numbers, best speeds, the operating point."""
    rpm = to_shop(map_.spindle_speed, "spindle_speed_rpm")
    top = depth_drawn(map_) * 1e3
    out_of_sight = 3 * top  # where no limit was found
    limit = np.where(np.isfinite(map_.limit_depth), map_.limit_depth * 1e3, out_of_sight)
    corners = np.flatnonzero(np.diff(map_.lobe) != 0)
    kept = np.union1d(thin(rpm, np.minimum(limit, out_of_sight), POINTS), np.concatenate([corners, corners + 1]))
    n, depth, lobe = rpm[kept], limit[kept], map_.lobe[kept]
    frequency = map_.chatter_frequency[kept]
    columns = [Column("spindle speed", "rpm", n), Column("limit depth", "mm", map_.limit_depth[kept] * 1e3)]
    items: list[Item] = [Band(n, np.zeros(len(n)), depth, "stable")]
    if map_.limit_low is not None and map_.limit_high is not None:
        low, high = map_.limit_low[kept] * 1e3, map_.limit_high[kept] * 1e3
        columns += [Column("limit low", "mm", low), Column("limit high", "mm", high)]
        shown = np.where(np.isfinite(high), high, out_of_sight)
        items += [Band(n, np.where(np.isfinite(low), low, out_of_sight), shown, "main")]
        items += [Line(n, np.where(np.isfinite(v), v, out_of_sight), "main faint") for v in (low, high)]
    items.append(Line(n, depth, "main strong"))
    if np.isfinite(map_.absolute_minimum):
        smallest = map_.absolute_minimum * 1e3
        items.append(Rule(smallest, "y", "limit"))
    if map_.best:
        speeds = np.array([to_shop(best.spindle_speed, "spindle_speed_rpm") for best in map_.best])
        safe = [best.axial_depth if best.safe_depth is None else best.safe_depth for best in map_.best]
        depths = np.array(safe) * 1e3
        items.append(Marks(speeds, depths, "best", "diamond", [str(i + 1) for i in range(len(speeds))], size=4.5))
    if map_.operating:
        speed = to_shop(map_.operating.spindle_speed, "spindle_speed_rpm")
        at = np.array([map_.operating.axial_depth * 1e3])
        items.append(Marks(np.array([speed]), at, "operating", "cross", ["operating point"], size=5.5, below=True))
    columns += [Column("chatter frequency", "Hz", frequency), Column("lobe", "", lobe)]
    frame = Frame()
    split = np.concatenate([[False], np.diff(lobe) != 0])
    jumps = np.flatnonzero(split)
    f_range = span_of(frequency, margin=0.16)
    chatter: list[Item] = [Line(np.insert(n, jumps, np.nan), np.insert(frequency, jumps, np.nan), "main")]
    high_in_panel = f_range[1] - 0.04 * (f_range[1] - f_range[0])
    chatter += _lobe_numbers(
        n, lobe, high_in_panel - 0.06 * (f_range[1] - f_range[0]), frame.width - frame.left - frame.right
    )
    panels = [
        Panel("limit of the axial depth, mm", items, 300, (0.0, top), most_ticks=6),
        Panel("chatter frequency, Hz, and number of the lobe", chatter, 90, f_range, most_ticks=3),
    ]
    label = (
        f"Limit of the axial depth from {rpm[0]:.0f} to {rpm[-1]:.0f} rpm; smallest limit "
        f"{significant(map_.absolute_minimum * 1e3)} mm with chatter at {significant(map_.absolute_minimum_frequency, 4)} Hz"
    )
    svg = chart(
        panels, x_label="spindle speed, rpm", x_range=(float(n[0]), float(n[-1])), label=label, frame=frame, hover=True
    )
    key = [("line main strong", "limit: stable below, chatter above"), ("span stable", "stable")]
    if map_.limit_low is not None:
        key.insert(1, ("span band-main", "95 % band of the limit"))
    if np.isfinite(map_.absolute_minimum):
        key.append(("line limit", f"stable at every speed below {significant(map_.absolute_minimum * 1e3)} mm"))
    if map_.best:
        at_safe = ", at the safe depth" if all(best.safe_depth is not None for best in map_.best) else ""
        key.append(("marks diamond best", "best speeds, numbered as in the table" + at_safe))
    if map_.operating:
        key.append(("marks cross operating", "operating point"))
    caption = "Between two lobes the cut takes most; a speed a little off the pocket loses it, so aim at its middle."
    return Figure("stability-map", "Limit depth and speed", caption, (svg,), columns, key, hint="spindle speed")
