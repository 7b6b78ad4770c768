"""Several methods on the same cut in one picture: where they agree one line hides the others, where not they stand apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import StabilityMap
from millcal.report.charts import Band, Frame, Item, Line, Marks, Panel, chart
from millcal.report.figures import POINTS, Column, Figure
from millcal.report.stability_figure import FINE, columns_of, depth_drawn, rpm_of
from millcal.report.stability_regions import KINDS, Edge, areas, edges, simplified, stable_stretches
from millcal.report.stability_wording import METHODS
from millcal.units import to_shop

ORDER = ("floquet", "frf", "zoa", "time-domain")  # how they lie over each other, the lowest first
POINTWISE = "time-domain"  # whose speeds are too few for lines


def in_order(maps: Sequence[StabilityMap]) -> list[StabilityMap]:
    """The maps as they are drawn, one over the other."""
    return sorted(maps, key=lambda m: ORDER.index(m.method) if m.method in ORDER else len(ORDER))


def shaded(maps: Sequence[StabilityMap]) -> StabilityMap | None:
    """The map whose stable area is shaded: the most exact that has lines.   maps : as `in_order` has them"""
    return next((map_ for map_ in maps if map_.method != POINTWISE), None)


def depth_compared(maps: Sequence[StabilityMap]) -> float:
    """Highest depth of the picture, m: what the shaded map alone would show, not the highest of all.   maps : as above"""
    of_lines = shaded(maps)
    chosen = maps if of_lines is None else [of_lines]
    return float(np.median([depth_drawn(replace(m, simulated=None, tests=None)) for m in chosen]))


def bounds(map_: StabilityMap) -> list[Edge]:
    """The edges of what is stable, in rpm and mm."""
    found = edges(areas(rpm_of(map_.spindle_speed), stable_stretches(map_)))
    return [Edge(e.x, e.y * 1e3, e.kind) for e in found]


def comparison(maps: Sequence[StabilityMap]) -> Figure:
    """The bounds of every map over what the most exact holds for stable; its kinds alone are told apart.

    maps : of the same cut, each by a method of its own
    """
    rows = in_order(maps)
    top, frame = depth_compared(rows) * 1e3, Frame()
    ends = (
        min(to_shop(m.spindle_speed[0], "spindle_speed_rpm") for m in rows),
        max(to_shop(m.spindle_speed[-1], "spindle_speed_rpm") for m in rows),
    )
    height = 260.0
    fine = (FINE * top / height, FINE * (ends[1] - ends[0]) / (frame.width - frame.left - frame.right))
    items: list[Item] = []
    key = []
    below = shaded(rows)
    for map_ in rows:
        name = METHODS.get(map_.method, map_.method)
        if map_.method == POINTWISE:
            items.append(Marks(rpm_of(map_.spindle_speed), map_.limit_depth * 1e3, "by-time-domain", "ring", size=3.2))
            key.append(("marks ring by-time-domain", name))
            continue
        kind, flipped = f"by-{map_.method}", False
        out_of_sight = min(3 * top, map_.deepest * 1e3)
        for area in areas(rpm_of(map_.spindle_speed), stable_stretches(map_)) if map_ is below else ():
            low, high = (np.minimum(depth * 1e3, out_of_sight) for depth in (area.low, area.high))
            kept = np.union1d(simplified(area.x, low, *fine), simplified(area.x, high, *fine))
            items.insert(0, Band(area.x[kept], low[kept], high[kept], "stable"))
        for edge in bounds(map_):
            y = np.minimum(edge.y, out_of_sight)
            kept = simplified(edge.x, y, *fine)
            flip = map_ is below and edge.kind == KINDS.index("flip")
            items.append(Line(edge.x[kept], y[kept], "by-flip" if flip else kind))
            flipped |= flip
        key.append((f"line {kind}", name))
        key += [("line by-flip", f"{name}: flip limit")] if flipped else []
        key += [("span stable", f"{name}: stable")] if map_ is below else []
    svg = chart(
        [Panel("limit of the axial depth, mm", items, height, (0.0, top), most_ticks=6)],
        x_label="spindle speed, rpm",
        x_range=(float(ends[0]), float(ends[1])),
        label="Limits of the axial depth by " + ", ".join(METHODS.get(m.method, m.method) for m in rows),
        frame=frame,
    )
    columns = []
    per_map = [(columns_of(map_, POINTS // len(rows)), map_.method) for map_ in rows]
    names = np.concatenate([np.full(len(c[0].values), METHODS.get(m, m)) for c, m in per_map])
    columns.append(Column("method", "", names))
    for heading in ("spindle speed", "limit depth", "kind", "chatter frequency"):
        parts = [next(c for c in table if c.name == heading) for table, _ in per_map]
        columns.append(Column(heading, parts[0].unit, np.concatenate([part.values for part in parts])))
    caption = "Where the lines lie on each other the methods agree."
    if any(map_.method == "zoa" for map_ in rows):
        caption += " The zero-order limit takes the mean of the cut over a tooth: it knows nothing of period doubling."
    return Figure("stability-methods", "The methods against each other", caption, (svg,), columns, key)
