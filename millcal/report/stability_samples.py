"""Simulated cuts along one line of the map, sampled once per period: where one branch of points becomes several, or a cloud."""

from typing import NamedTuple

import numpy as np

from millcal.data import StabilityMap
from millcal.report.charts import Item, Marks, Panel, Rule, chart, span_of
from millcal.report.digits import fixed, nominal
from millcal.report.figures import Column, Figure
from millcal.report.stability_regions import KINDS, RIM, areas, edges, stable_stretches
from millcal.units import to_shop

MOST_POINTS = 12000  # that are drawn
BORDERS = ("border", "jump", "border")  # by kind


class Samples(NamedTuple):
    """The points of the picture and what bounds the stable cuts along its line."""

    at: np.ndarray  # (sample,) rpm or mm
    displacement: np.ndarray  # (sample,) m
    along: str  # "speed" or "depth"
    other: float  # what is held: mm or rpm
    bounds: list[tuple[float, int]]  # where the map has an edge there, rpm or mm, and its kind
    per: str  # tooth or revolution


def samples_of(map_: StabilityMap) -> Samples | None:
    """What there is to draw; None without samples."""
    cuts = map_.simulated
    if cuts is None or cuts.bifurcation_speed is None or cuts.bifurcation_displacement is None:
        return None
    if cuts.bifurcation_depth is None or not len(cuts.bifurcation_speed):
        return None
    speed = to_shop(cuts.bifurcation_speed, "spindle_speed_rpm")
    depth = cuts.bifurcation_depth * 1e3
    finite = np.flatnonzero(np.isfinite(cuts.bifurcation_displacement))
    finite = finite[np.unique(np.linspace(0, len(finite) - 1, MOST_POINTS).astype(int))] if len(finite) else finite
    displacement = cuts.bifurcation_displacement[finite]
    lines = edges(areas(to_shop(map_.spindle_speed, "spindle_speed_rpm"), stable_stretches(map_)))
    if np.ptp(speed) / np.mean(speed) >= np.ptp(depth) / np.mean(depth):
        held = float(np.median(depth))
        span = (float(speed.min()), float(speed.max()))
        bounds = [(at, e.kind) for e in lines for at in _passes(e.x, e.y * 1e3, held) if span[0] <= at <= span[1]]
        return Samples(speed[finite], displacement, "speed", held, bounds, cuts.per)
    held = float(np.median(speed))
    span = (float(depth.min()), float(depth.max()))
    bounds = [(at, e.kind) for e in lines for at in _passes(e.y * 1e3, e.x, held) if span[0] <= at <= span[1]]
    return Samples(depth[finite], displacement, "depth", held, bounds, cuts.per)


def _passes(x: np.ndarray, y: np.ndarray, level: float) -> list[float]:
    """Where a line through points passes a level."""
    x, y = x[np.isfinite(x) & np.isfinite(y)], y[np.isfinite(x) & np.isfinite(y)]
    i = np.flatnonzero(np.diff((y > level).astype(int)))
    return (x[i] + (level - y[i]) / (y[i + 1] - y[i]) * (x[i + 1] - x[i])).tolist()


def bifurcation(map_: StabilityMap) -> Figure | None:
    """Displacement once per period against speed or depth, with the bounds of the map; None without samples."""
    found = samples_of(map_)
    if found is None:
        return None
    name, unit = ("spindle speed", "rpm") if found.along == "speed" else ("axial depth", "mm")
    micro = found.displacement * 1e6
    items: list[Item] = [Rule(at, "x", BORDERS[kind] if kind != RIM else "border") for at, kind in found.bounds]
    items.append(Marks(found.at, micro, "sampled", "point", size=0.8))
    margin = 0.01 * float(np.ptp(found.at)) or 1.0
    svg = chart(
        [Panel(f"displacement once per {found.per}, µm", items, 200, span_of(micro))],
        x_label=f"{name}, {unit}",
        x_range=(float(found.at.min()) - margin, float(found.at.max()) + margin),
        label=f"Displacement of simulated cuts once per {found.per} against the {name}, {held_in_words(found)}",
    )
    caption = (
        f"Simulated cuts at {held_in_words(found)}, after they have settled. One branch repeats every {found.per}, two "
        "repeat every second, a cloud never."
    )
    key = [("line sampled", f"one sample per {found.per}")]
    for kind in sorted({kind for _, kind in found.bounds}):
        key.append((f"line {BORDERS[kind]}", f"{KINDS[kind]} limit of the map"))
    order = np.argsort(found.at, kind="stable")
    columns = [Column(name, unit, found.at[order]), Column("displacement", "µm", micro[order])]
    return Figure("bifurcation", "From one branch to many", caption, (svg,), columns, key)


def held_in_words(found: Samples) -> str:
    """What is the same for all samples."""
    return f"{nominal(round(found.other, 4))} mm" if found.along == "speed" else f"{fixed(found.other, 0)} rpm"
