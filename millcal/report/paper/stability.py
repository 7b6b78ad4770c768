"""The stability map for print: what is stable against spindle speed, with the kinds of chatter that end it and their frequencies;
several methods in one picture; and simulated cuts sampled once per period.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from millcal.data import StabilityMap
from millcal.report.charts import span_of
from millcal.report.digits import significant
from millcal.report.paper import sheet
from millcal.report.stability_against import otherwise
from millcal.report.stability_comparison import POINTWISE, bounds, depth_compared, in_order, shaded
from millcal.report.stability_figure import CONTOURS, LEVELS, depth_drawn, leaps, reach, rpm_of
from millcal.report.stability_regions import (
    KINDS,
    Area,
    areas,
    chances,
    edges,
    inner_crossings,
    stable_stretches,
    stretches_above,
    stretches_with_best,
)
from millcal.report.stability_samples import held_in_words, samples_of
from millcal.report.wording import percent

INKS = (sheet.MAIN, sheet.MODEL, "#7a3fa0")  # by kind
STYLES = ("-", "--", "-.")
LIMITS = ("Hopf limit", "flip limit", "fold limit")
SHADES = ("#eff5fb", "#dbe8f5", "#c5d9ee", "#adc9e6", "#93b8dd")  # from each of LEVELS on
FLIP = KINDS.index("flip")
GREEN, RED, PURPLE = "#117a4b", "#a01525", "#7a3fa0"
BY_METHOD: dict[str, tuple] = {  # name, ink, style, width
    "floquet": ("Floquet", sheet.MAIN, "-", 1.1),
    "frf": ("straight from the FRF", GREEN, "-.", 0.9),
    "zoa": ("zero-order", sheet.MUTED, "--", 1.0),
}


def stability_file(map_: StabilityMap, format: str, *, others: Sequence[StabilityMap] = ()) -> bytes:
    """The map as a file, or the bounds by several methods where others stand beside it.   format : one of `sheet.FORMATS`"""
    with sheet.style():
        return sheet.file_bytes(comparison([map_, *others]) if others else stability_map(map_), format)


def bifurcation_file(map_: StabilityMap, format: str) -> bytes | None:
    """Where the simulated cuts of one speed come to rest as a file; None where there are none.   format : as above"""
    with sheet.style():
        figure = bifurcation(map_)
        return None if figure is None else sheet.file_bytes(figure, format)


def stability_map(map_: StabilityMap) -> Any:
    """Stable area or probabilities, limits by kind, what was asked, tried and advised; below it the chatter frequency."""
    rpm = rpm_of(map_.spindle_speed)
    top = depth_drawn(map_) * 1e3
    if map_.best:
        top = max(top, 1.12 * max(best.axial_depth for best in map_.best) * 1e3)  # room for the number over the mark
    ends = (float(rpm[0]), float(rpm[-1]))
    figure, ((upper,), (lower,)) = sheet.sheet(sheet.DOUBLE, 105.0, 2, heights=(3, 1))
    entries = _limits(upper, map_, rpm, top)
    if np.isfinite(map_.absolute_minimum):
        smallest = map_.absolute_minimum * 1e3
        rule = upper.axhline(smallest, color=sheet.INK, linewidth=0.8, linestyle=":")
        entries.append((rule, f"smallest limit, {significant(smallest)} mm"))
    entries += _tried(upper, map_)
    entries += _best(upper, map_, "best speeds, best first", top)
    entries += _operating(upper, map_, ends, top)
    _chatter(lower, map_, rpm)
    sheet.scale(upper, "x", ends, most=8)
    sheet.quiet(upper, "x")
    sheet.scale(upper, "y", (0.0, top), label="axial depth $a_\\mathrm{p}$ (mm)", most=7)
    sheet.scale(lower, "x", ends, label="spindle speed (rpm)", most=8)
    sheet.scale(lower, "y", span_of(map_.chatter_frequency, margin=0.12), label="chatter\nfrequency (Hz)", most=3)
    figure.align_ylabels()
    sheet.letters((upper, lower))
    sheet.legend(figure, entries, columns=4)
    return figure


def _best(axes: Any, map_: StabilityMap, name: str, top: float) -> list[tuple[Any, str]]:
    """The best speeds at their limits, numbered, as far as the picture goes.   name : in the legend   top : mm"""
    inside = [(i, best) for i, best in enumerate(map_.best, 1) if best.axial_depth * 1e3 <= top]
    if not inside:
        return []
    speeds = rpm_of(np.array([best.spindle_speed for _, best in inside]))
    depths = [best.axial_depth * 1e3 for _, best in inside]
    look: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": sheet.INK, "markeredgewidth": 0.9}
    look |= {"markersize": 4.5, "clip_on": False, "zorder": 4}  # hollow: periods are read through it
    (marks,) = axes.plot(speeds, depths, "D", **look)
    for (number, _), place in zip(inside, zip(speeds, depths, strict=True), strict=True):
        over = {"textcoords": "offset points", "ha": "center", "va": "bottom", "fontsize": 7}
        sheet.haloed(axes.annotate(str(number), place, (0, 4), zorder=6, **over))
    return [(marks, name)]


def _operating(
    axes: Any, map_: StabilityMap, ends: tuple[float, float], top: float, *, bars: bool = True
) -> list[tuple[Any, str]]:
    """The operating point, with bars as far as it may move; nothing where it lies beside the picture."""
    point = map_.operating
    if point is None or not ends[0] <= float(rpm_of(point.spindle_speed)) <= ends[1]:
        return []
    speed, depth = float(rpm_of(point.spindle_speed)), point.axial_depth * 1e3
    bar_shown = None
    if point.stable and bars:
        (left, right), (low, high) = reach(point, ends, top)
        ink = {"color": sheet.INK, "markeredgewidth": 0.6, "markersize": 5.0, "zorder": 4.5}
        bar = {"linewidth": 0.5}
        if high > low:
            axes.plot([speed, speed], [low, high], **bar, **ink)
            axes.plot(speed, high, linestyle="none", marker="_", **ink)
        if right > left:
            axes.plot([left, right], [depth, depth], marker="|", **bar, **ink)
        if high > low or right > left:
            (bar_shown,) = axes.plot([], [], marker="|", **bar, **ink)
    (mark,) = axes.plot(speed, depth, "X", color=sheet.INK, markersize=6, markeredgewidth=0, clip_on=False, zorder=5)
    return [(mark, "operating point"), *([(bar_shown, "it may move so far")] if bar_shown is not None else [])]


def _limits(axes: Any, map_: StabilityMap, rpm: np.ndarray, top: float) -> list[tuple[Any, str]]:
    """The area, the band and the bounds; returns what the legend says of them."""
    out_of_sight = min(3 * top, map_.deepest * 1e3)  # where no limit was found

    def shown(depth: np.ndarray) -> np.ndarray:
        return np.minimum(np.where(np.isnan(depth), np.inf, depth) * 1e3, out_of_sight)

    def filled(found: Sequence[Area], ink: str) -> Any:
        for area in found:
            axes.fill_between(
                area.x, shown(area.low), shown(area.high), color=ink, linewidth=0.3
            )  # no seam between two
        return _patch(axes, ink)

    columns = stable_stretches(map_)
    speeds, topped = stretches_with_best(map_)
    stable = areas(rpm_of(speeds), topped)
    shades: list[tuple[Any, str]] = []
    if likely := chances(map_):
        patches = []
        for level, ink in zip(LEVELS, SHADES, strict=True):
            found = areas(rpm, stretches_above(likely, level))
            patches.append(filled(found, ink))
            if level in CONTOURS:
                for edge in edges(found):
                    axes.plot(edge.x, shown(edge.y), color=sheet.MUTED, linewidth=0.6 if level == 0.5 else 0.4)
        shades += [(patch, f"stable with > {percent(level)}") for patch, level in zip(patches, LEVELS, strict=True)]
    else:
        shades.append((filled(stable, sheet.STABLE), "stable"))
        if map_.limit_low is not None and map_.limit_high is not None:
            low, high = shown(map_.limit_low), shown(map_.limit_high)
            band = axes.fill_between(rpm, low, high, color=sheet.BAND, alpha=0.8)
            shades.insert(0, (band, "95 % band of the limit"))
    within = inner_crossings(map_, columns)
    if len(within):
        places = rpm_of(map_.crossing_speed[within]), map_.crossing_depth[within] * 1e3
        look = {"color": sheet.MUTED, "markeredgewidth": 0}
        axes.plot(*places, ".", markersize=1.2, zorder=2, **look)
        shades.append((axes.plot([], [], ".", markersize=3, **look)[0], "crossings within chatter"))
    entries: dict[int, Any] = {}
    for edge in edges(stable):
        look = {"color": INKS[edge.kind], "linestyle": STYLES[edge.kind], "linewidth": 0.9}
        (entries[edge.kind],) = axes.plot(edge.x, shown(edge.y), zorder=3, **look)
    if set(entries) <= {0}:
        return [*((line, "stability limit") for line in entries.values()), *shades]
    return [*((entries[kind], LIMITS[kind]) for kind in sorted(entries)), *shades]


def _patch(axes: Any, ink: str) -> Any:
    """A piece of an area for the legend."""
    return axes.fill_between([], [], [], color=ink)


def _tried(axes: Any, map_: StabilityMap) -> list[tuple[Any, str]]:
    """Cuts made and cuts simulated."""
    entries = []
    if (cuts := map_.simulated) is not None:
        several = "teeth" if cuts.per == "tooth" else "revolutions"
        told: dict[str, Any] = {}
        for period in np.unique(cuts.period):
            n, b = rpm_of(cuts.spindle_speed[cuts.period == period]), cuts.axial_depth[cuts.period == period] * 1e3
            look: dict[str, Any] = {"marker": f"${period:.0f}$", "color": PURPLE, "markersize": 4 if period < 10 else 6}
            text = f"simulated: repeats every so many {several}"
            if period == 1:
                look, text = {"marker": "s", "color": GREEN, "markersize": 2}, "simulated: stable"
            elif period == 0:
                look, text = {"marker": "1", "color": PURPLE, "markersize": 3}, "simulated: chatter"
            above = 4.2 if period > 1 else 3.5  # a number is read over the mark of a best speed
            look |= {"markeredgewidth": 0.7 if period < 1 else 0.2, "zorder": above, "clip_on": False}
            if period == 1:  # read on the darkest shade too
                look |= {"markersize": 3, "markeredgecolor": "white", "markeredgewidth": 0.5}
            told.setdefault(text, axes.plot(n, b, linestyle="none", **look)[0])
        differ = np.logical_or(*otherwise(map_))
        if differ.any():
            n, b = rpm_of(cuts.spindle_speed[differ]), cuts.axial_depth[differ] * 1e3
            ring = {"markerfacecolor": "none", "markeredgecolor": sheet.INK, "markeredgewidth": 0.6, "markersize": 6.5}
            told["simulated otherwise than mapped"] = axes.plot(n, b, "h", zorder=4, clip_on=False, **ring)[0]
        entries += [(marks, text) for text, marks in told.items()]
    if (tests := map_.tests) is not None:
        for stable, marker, ink, text in ((True, "o", GREEN, "stable"), (False, "x", RED, "chatter")):
            which = (tests.stable > 0) == stable
            if which.any():
                n, b = rpm_of(tests.spindle_speed[which]), tests.axial_depth[which] * 1e3
                look = {"markerfacecolor": "none", "markeredgecolor": ink, "markeredgewidth": 1.0, "markersize": 4.5}
                (marks,) = axes.plot(n, b, linestyle="none", marker=marker, zorder=4, clip_on=False, **look)
                entries.append((marks, f"cut made: {text}"))
    return entries


def _chatter(axes: Any, map_: StabilityMap, rpm: np.ndarray) -> None:
    """The chatter frequency by kind; from lobe to lobe it leaps."""
    jumps = leaps(map_)
    found = False
    for kind in range(len(KINDS)):
        own = np.where(map_.limit_kind == kind, map_.chatter_frequency, np.nan)
        if np.isfinite(own).any() or (not found and kind == len(KINDS) - 1):
            look = {"color": INKS[kind], "linestyle": STYLES[kind]}
            x, y = np.insert(rpm, jumps, np.nan), np.insert(own, jumps, np.nan)
            axes.plot(x, y, **look)
            around = np.pad(np.isfinite(y), 1)
            alone = around[1:-1] & ~around[:-2] & ~around[2:]  # no line goes through it
            if alone.any():
                axes.plot(x[alone], y[alone], ".", color=INKS[kind], markersize=3, clip_on=False)
            found = True


def comparison(maps: Sequence[StabilityMap]) -> Any:
    """The bounds of the same cut by several methods, over what the most exact of them holds for stable.

    A method that follows cuts in time is shown by points. Kinds of chatter are told apart for the method that is shaded.

    maps : the first is the one whose best speeds and operating point are marked
    """
    asked, rows = maps[0], in_order(maps)
    top = depth_compared(rows) * 1e3
    rpm = [rpm_of(m.spindle_speed) for m in rows]
    ends = (min(float(n[0]) for n in rpm), max(float(n[-1]) for n in rpm))
    within = tuple(best for best in asked.best if best.axial_depth * 1e3 <= (1 + 1e-9) * top)
    top = max([top, *(1.12 * best.axial_depth * 1e3 for best in within)])  # room for the number over the mark
    figure, ((axes,),) = sheet.sheet(sheet.DOUBLE, 80.0)
    entries: list[tuple[Any, str]] = []
    below = shaded(rows)
    for number, (map_, n) in enumerate(zip(rows, rpm, strict=True)):
        if map_.method == POINTWISE:
            limit = np.where(map_.limit_depth * 1e3 <= top, map_.limit_depth * 1e3, np.nan)
            look = {"markerfacecolor": "white", "markeredgecolor": sheet.INK, "markersize": 3.6, "markeredgewidth": 0.8}
            (shown,) = axes.plot(n, limit, "o", zorder=4, clip_on=False, **look)
            entries.append((shown, "time domain"))
            continue
        out_of_sight = min(3 * top, map_.deepest * 1e3)
        name, ink, style, width = BY_METHOD.get(map_.method, (map_.method, sheet.MUTED, ":", 0.8))
        look = {"color": ink, "linestyle": style, "linewidth": width, "zorder": 2.5 + 0.1 * number}
        kinds: dict[str, Any] = {}
        for edge in bounds(map_):
            flips = map_ is below and edge.kind == FLIP
            own = look | ({"color": sheet.MODEL, "linestyle": ":", "linewidth": 1.4} if flips else {})
            (kinds[f"{name}: {LIMITS[edge.kind]}" if map_ is below else name],) = axes.plot(
                edge.x, np.minimum(edge.y, out_of_sight), **own
            )
        if map_ is below:
            for area in areas(n, stable_stretches(map_)):
                low, high = (np.minimum(depth * 1e3, out_of_sight) for depth in (area.low, area.high))
                axes.fill_between(area.x, low, high, color=sheet.STABLE, linewidth=0.3)
            kinds[f"{name}: stable"] = _patch(axes, sheet.STABLE)
        entries += [(line, text) for text, line in sorted(kinds.items(), key=lambda entry: entry[0])]
        if not kinds:
            entries.append((axes.plot([], [], **look)[0], name))
    name = BY_METHOD.get(asked.method, ("time domain",))[0]
    entries += _best(axes, asked, f"best speeds, {name}", top)
    entries += _operating(axes, asked, ends, top, bars=False)  # how far it may move is one method's word
    axes.tick_params(axis="x", pad=5)  # the first number stands in the corner beside the 0
    sheet.scale(axes, "x", ends, label="spindle speed (rpm)", most=8)
    sheet.scale(axes, "y", (0.0, top), label="axial depth $a_\\mathrm{p}$ (mm)", most=7)
    sheet.legend(figure, entries, columns=4)
    return figure


def bifurcation(map_: StabilityMap) -> Any | None:
    """Displacement once per period of simulated cuts along one line of the map; None without samples."""
    found = samples_of(map_)
    if found is None:
        return None
    figure, ((axes,),) = sheet.sheet(sheet.SINGLE, 62.0)
    entries = []
    micro = found.displacement * 1e6
    look = {"color": sheet.MAIN, "markeredgewidth": 0}
    axes.plot(found.at, micro, ".", markersize=1.5, zorder=3, rasterized=True, **look)
    entries.append((axes.plot([], [], ".", markersize=4, **look)[0], f"once per {found.per}, {held_in_words(found)}"))
    rules: dict[int, Any] = {}
    for at, kind in found.bounds:
        rules[kind] = axes.axvline(at, color=sheet.MUTED, linewidth=0.8, linestyle=STYLES[kind])
    entries += [(rules[kind], LIMITS[kind]) for kind in sorted(rules)]
    name = "spindle speed (rpm)" if found.along == "speed" else "axial depth $a_\\mathrm{p}$ (mm)"
    margin = 0.01 * float(np.ptp(found.at)) or 1.0
    sheet.scale(axes, "x", (float(found.at.min()) - margin, float(found.at.max()) + margin), label=name, most=5)
    sheet.scale(axes, "y", span_of(micro), label="displacement (µm)")
    sheet.legend(figure, entries, columns=2)
    return figure
