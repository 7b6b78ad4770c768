"""Cuts beside a map: those that were made and judged, and those that are simulated on points of it."""

from dataclasses import replace

import numpy as np

from millcal.data import CutTests, Frf, Modes, Notice, SimulatedCuts
from millcal.errors import IllPosedError
from millcal.physics.stability.regeneration import Regeneration
from millcal.physics.stability.stable_depths import is_stable
from millcal.stages.stability.method import Asked, Method, Progress
from millcal.stages.stability.modes import poles_of_modes
from millcal.units import to_shop

ROUNDED = 1e-9  # share of a speed: a cut at the end of the map lies on it
LINE = 100  # depths of a line of cuts whose resting places are drawn


def on_speeds(tests: CutTests, low: float, high: float) -> np.ndarray:
    """Which cuts lie between two speeds.   low, high : rad/s   returns (test,) bool"""
    return (tests.spindle_speed >= low * (1 - ROUNDED)) & (tests.spindle_speed <= high * (1 + ROUNDED))


def held_against(
    tests: CutTests, speeds: np.ndarray, chosen: Method, cut: Regeneration
) -> tuple[CutTests, list[Notice]]:
    """The cuts with what the map says of each at its own speed, and what is to be told of that.

    This is the one place where a cut is held against the map: text, JSON and page read it off the record. Of cuts outside the
    map it says nothing.
    """
    here = on_speeds(tests, speeds[0], speeds[-1]) & (tests.axial_depth <= chosen.deepest)
    outside = int(np.count_nonzero(~here))
    by_map = np.full(len(here), np.nan)
    if not len(here):
        return replace(tests, stable_by_map=by_map), []
    if not here.any():
        low, high = (f"{to_shop(end, 'x_rpm'):.0f}" for end in speeds[[0, -1]])
        deep = "" if np.isinf(chosen.deepest) else f" and {to_shop(chosen.deepest, 'x_mm'):.3g} mm"
        what = f"no test cut lies on this map of {low} to {high} rpm{deep}; map the speeds of the cuts"
        return replace(tests, stable_by_map=by_map), [Notice("tests", what, tests.name)]
    speed, depth, stable = tests.spindle_speed[here], tests.axial_depth[here], tests.stable[here].astype(bool)
    at = speed
    if not chosen.refine[0]:  # a method too dear for speeds of their own
        at = speeds[np.argmin(np.abs(speeds - at[:, np.newaxis]), axis=1)]
    own, where = np.unique(at, return_inverse=True)
    table = chosen.table(own, cut)[where]
    mapped = is_stable(table, depth)
    by_map[here] = mapped
    held = replace(tests, stable_by_map=by_map)
    wrong = np.flatnonzero(mapped != stable)
    what = f"{len(at) - len(wrong)} of {len(at)} test cuts went as the map says"
    left = f"; {outside} more {'lies' if outside == 1 else 'lie'} outside the map" if outside else ""
    if not len(wrong):
        return held, [Notice("tests", what + left, tests.name, "note")]
    cuts = [
        f"{to_shop(speed[i], 'x_rpm'):.0f} rpm {to_shop(depth[i], 'x_mm'):.3g} mm "
        f"{'was stable' if stable[i] else 'chattered'}"
        for i in wrong[:3]
    ]
    more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
    return held, [Notice("tests", f"{what}; not {', '.join(cuts)}{more}{left}", tests.name)]


def simulated_over(
    dynamics: Frf | Modes,
    asked: Asked,
    speeds: np.ndarray,
    grid: tuple[int, int],
    deepest: float,
    along: tuple[float, float] | None,
    progress: Progress,
) -> tuple[SimulatedCuts, list[Notice]]:
    """Cuts of the time domain on a grid over the map, and where those of one speed come to rest as the depth grows.

    grid : speeds and depths   along : an operating point, rad/s and m, down to twice whose depth the line goes; None: no line
    """
    from millcal.stages.stability.time_domain import simulated_cuts, with_bifurcation

    if not isinstance(dynamics, Modes):
        raise IllPosedError("stability.simulate: the time domain needs modes; fit them first (millcal modes)")
    if asked.feed_per_tooth is None:
        raise IllPosedError("stability.feed_per_tooth_mm: the time domain cuts chips, so it needs the feed; give it")
    kte, kre = asked.edge or (0.0, 0.0)
    many, deep = grid
    speed, depth = np.meshgrid(
        np.linspace(speeds[0], speeds[-1], many), deepest * np.arange(1, deep + 1) / deep, indexing="ij"
    )
    tip = poles_of_modes(dynamics).tip
    force = {"feed_per_tooth": asked.feed_per_tooth, "kte": kte, "kre": kre, "runout": asked.runout}
    found, notices = simulated_cuts(
        tip, asked.cut, speed.ravel(), depth.ravel(), progress=lambda share: progress(0.7 * share), **force
    )
    if along is not None:
        line = min(deepest, 2 * along[1]) * np.arange(1, LINE + 1) / LINE
        found = with_bifurcation(
            found, tip, asked.cut, along[0], line, progress=lambda share: progress(0.7 + 0.3 * share), **force
        )
    return found, list(notices)
