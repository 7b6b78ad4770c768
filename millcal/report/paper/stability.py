"""The stability map for print: limit depth and chatter frequency against spindle speed."""

from typing import Any

import numpy as np

from millcal.data import StabilityMap
from millcal.report.charts import span_of
from millcal.report.digits import significant
from millcal.report.paper import sheet
from millcal.report.stability_figure import depth_drawn
from millcal.units import to_shop


def stability_map(map_: StabilityMap) -> Any:
    """Limit with its 95 % band, smallest limit, best speeds and operating point; below it the chatter frequency."""
    rpm = to_shop(map_.spindle_speed, "spindle_speed_rpm")
    top = depth_drawn(map_) * 1e3
    if map_.best:
        top = max(top, 1.12 * max(best.axial_depth for best in map_.best) * 1e3)  # room for the number over the mark
    out_of_sight = 3 * top  # where no limit was found

    def shown(depth: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(depth), np.minimum(depth * 1e3, out_of_sight), out_of_sight)

    limit = shown(map_.limit_depth)
    figure, ((upper,), (lower,)) = sheet.sheet(sheet.DOUBLE, 105.0, 2, heights=(3, 1))
    stable = upper.fill_between(rpm, 0, limit, color=sheet.STABLE)
    (line,) = upper.plot(rpm, limit, color=sheet.MAIN, linewidth=0.9)
    entries: list = [(line, "stability limit")]
    if map_.limit_low is not None and map_.limit_high is not None:
        band = upper.fill_between(rpm, shown(map_.limit_low), shown(map_.limit_high), color=sheet.BAND)
        entries.append((band, "95 % band of the limit"))
    entries.append((stable, "stable"))
    if np.isfinite(map_.absolute_minimum):
        smallest = map_.absolute_minimum * 1e3
        rule = upper.axhline(smallest, color=sheet.INK, linewidth=0.8, linestyle=(0, (1, 1.5)))
        entries.append((rule, f"smallest limit, {significant(smallest)} mm"))
    if map_.best:
        speeds = [to_shop(best.spindle_speed, "spindle_speed_rpm") for best in map_.best]
        depths = [best.axial_depth * 1e3 for best in map_.best]
        (marks,) = upper.plot(speeds, depths, "D", color=sheet.MODEL, markersize=4, clip_on=False, zorder=4)
        entries.append((marks, "best speeds, best first"))
        for number, place in enumerate(zip(speeds, depths, strict=True), 1):
            upper.annotate(str(number), place, (0, 4), textcoords="offset points", ha="center", va="bottom", fontsize=7)
    if (point := map_.operating) is not None:
        place = (to_shop(point.spindle_speed, "spindle_speed_rpm"), point.axial_depth * 1e3)
        (mark,) = upper.plot(*place, "X", color=sheet.INK, markersize=6, markeredgewidth=0, clip_on=False, zorder=5)
        entries.append((mark, "operating point"))
    jumps = np.flatnonzero(np.diff(map_.lobe) != 0) + 1  # from lobe to lobe the frequency leaps
    lower.plot(np.insert(rpm, jumps, np.nan), np.insert(map_.chatter_frequency, jumps, np.nan), color=sheet.MAIN)
    ends = (float(rpm[0]), float(rpm[-1]))
    sheet.scale(upper, "x", ends, most=8)
    sheet.quiet(upper, "x")
    sheet.scale(upper, "y", (0.0, top), label="axial depth $a_\\mathrm{p}$ (mm)", most=7)
    sheet.scale(lower, "x", ends, label="spindle speed (rpm)", most=8)
    sheet.scale(lower, "y", span_of(map_.chatter_frequency, margin=0.12), label="chatter\nfrequency (Hz)", most=3)
    figure.align_ylabels()
    sheet.letters((upper, lower))
    sheet.legend(figure, entries, columns=3)
    return figure
