"""The operating point on a map: stable or not, by how much, and what would make it better.

Advice is what the map shows with numbers and nothing else: another speed, another depth, the pocket worth moving to, and where
the cut doubles its period a cutter that does not. It is ranked by the metal it removes. A depth counts as safe at the lower end of
the band, or without one at nine tenths of the limit, as far as it holds half a percent either way of the speed (`pockets.held`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from millcal.data import BestSpeed, OperatingPoint
from millcal.physics.stability.regeneration import KINDS, Crossings
from millcal.physics.stability.stable_depths import edge_table, is_stable
from millcal.stages.stability.pockets import HELD
from millcal.stages.stability.spread import Spread
from millcal.units import to_shop

SAFE = 0.9  # of the limit, where there is no band
WORTH = 1.1  # times as much metal as now: less is not worth a change
MANY_TIMES = 100  # as much: what is more is a cut of nothing, and no digit of it matters
ROUNDED = 1e-9  # share of a speed: a point at the end of the map lies on it
STEPS = 17  # speeds in the search for the end of a stable stretch


@dataclass(frozen=True, eq=False)
class Columns:
    """A map as the operating point sees it."""

    speed: np.ndarray  # (speed,) rad/s, ascending
    edges: np.ndarray  # of the stable set, (speed, edge) m
    runnable: np.ndarray  # depth that is safe below the first limit, as far as it holds, (speed,) m
    here: float  # the same at the speed of the point, m; inf where the map says nothing of it
    deepest: float  # m: nothing deeper is advised
    solve: (
        Callable[[np.ndarray], np.ndarray] | None
    )  # speeds (n,) -> edges (n, edge): for what lies between; None: too dear


def judged(
    point: tuple[float, float],
    crossings: Crossings,
    limit: float,
    columns: Columns,
    best: tuple[BestSpeed, ...],
    spread: Spread | None,
    others: Callable[[], list[tuple[str, float]]] | None = None,
    caution: str = "",
) -> OperatingPoint:
    """The record of an operating point.

    point : rad/s, m   crossings : edges of the stable set at its speed   limit : the first of them, m, inf where none
    others : cutters that may do better, each with its least limit about that speed, asked for where the period doubles
    caution : what the limits leave out, told last
    """
    speed, depth = point
    table = edge_table(crossings, 1)
    stable = bool(is_stable(table, np.array([depth]))[0])
    # What bounds a stable depth from above, or what an unstable one lies beyond.
    bounding = np.flatnonzero(crossings.loses & ((crossings.depth > depth) == stable))
    i = None if not len(bounding) else int(bounding[0] if stable else bounding[-1])
    kind = "" if i is None else KINDS[int(crossings.kind[i])]
    band = None if spread is None else spread.band(np.array([speed]))[:, 0]
    low = min(float(band[0]), limit) if band is not None else SAFE * limit
    p_stable = None if spread is None else spread.at(speed, depth)
    return OperatingPoint(
        spindle_speed=speed,
        axial_depth=depth,
        limit=limit,
        stable=stable,
        kind=kind,  # type: ignore[arg-type]
        chatter_frequency=np.nan if i is None else float(crossings.frequency[i]),
        limit_interval=None if band is None else (low, max(float(band[1]), limit)),
        p_stable=p_stable,
        speed_margin=_margin(point, columns) if stable else None,
        advice=tuple(
            [
                *_island(point, crossings, stable),
                *_advice(point, stable, kind, min(low, columns.here), columns, best, spread, others),
                *([caution] if caution else []),
            ]
        ),
        bound=np.nan if i is None else float(crossings.depth[i]),
    )


def _margin(point: tuple[float, float], columns: Columns) -> tuple[float, float] | None:
    """By how much the speed may fall and rise before the depth chatters, or the map ends.   rad/s

    None beside the map: between its end and the point nothing is known.
    """
    speed, depth = point
    low, high = columns.speed[[0, -1]]
    if not low * (1 - ROUNDED) <= speed <= high * (1 + ROUNDED):
        return None
    stable = is_stable(columns.edges, np.full(len(columns.speed), depth))
    below, above = columns.speed[::-1] < speed, columns.speed > speed
    ends = []
    for ordered, fine in ((columns.speed[::-1][below], stable[::-1][below]), (columns.speed[above], stable[above])):
        bad = np.flatnonzero(~fine)
        if not len(bad):
            ends.append(float(abs(ordered[-1] - speed)) if len(ordered) else 0.0)
            continue
        last = speed if bad[0] == 0 else float(ordered[bad[0] - 1])
        ends.append(abs(_last_stable(last, float(ordered[bad[0]]), depth, columns) - speed))
    return ends[0], ends[1]


def _last_stable(good: float, bad: float, depth: float, columns: Columns) -> float:
    """The last stable speed on the way from one that is stable to one that is not."""
    if columns.solve is None:
        return good
    between = np.linspace(good, bad, STEPS)[1:-1]
    stable = is_stable(columns.solve(between), np.full(len(between), depth))
    first = np.flatnonzero(~stable)
    return float(([good, *between])[first[0] if len(first) else len(between)])


def _island(point: tuple[float, float], crossings: Crossings, stable: bool) -> list[str]:
    """That a stable depth lies above chatter, with the depths between."""
    below = crossings.depth[crossings.depth <= point[1]]
    if not stable or not len(below):
        return []
    return [
        f"stable, but on an island: at this speed {_mm(below[-2])} to {_mm(below[-1])} mm chatter, on the way in and out too"
    ]


def _advice(
    point: tuple[float, float],
    stable: bool,
    kind: str,
    safe: float,
    columns: Columns,
    best: tuple[BestSpeed, ...],
    spread: Spread | None,
    others: Callable[[], list[tuple[str, float]]] | None,
) -> list[str]:
    speed, depth = point
    safe, unlimited = min(safe, columns.deepest), safe >= columns.deepest
    found: list[tuple[float, str]] = []  # removal against now, what to do
    if not stable or depth > safe:
        for turn in (1, -1):
            if (at := _nearest_safe(point, columns, turn)) is not None:
                to, runnable, free = at
                verb = "raise" if to > speed else "lower"
                what = f"{verb} the speed to {_rpm(to)} ({to / speed - 1:+.1%}): there {_depth(runnable, free, spread)}"
                found.append((to / speed, what))
        if 0 < safe < depth:
            found.append((safe / depth, f"reduce the depth to {_mm(safe)} mm ({_surely(spread)})"))
        if kind == "flip" and others is not None:
            for what, reached in others():
                if SAFE * reached > depth:
                    found.append((0.0, f"{what}: {_limit(reached, columns.deepest, spread)}"))
    elif safe > WORTH * depth:
        found.append((safe / depth, f"there is room: at this speed {_depth(safe, unlimited, spread)}"))
    pocket = best[0] if best else None
    if pocket is not None:
        run = pocket.safe_depth if pocket.safe_depth is not None else SAFE * pocket.axial_depth
        rate = pocket.spindle_speed * run / (speed * depth)
        if rate > WORTH * max([1.0, *(gain for gain, _ in found)]):
            where = f"{_rpm(pocket.spindle_speed)} and {_mm(run)} mm ({_surely(spread)})"
            found.append((rate, f"the best pocket is {where}: {_times(rate)} the metal"))
    return [what for _, what in sorted(found, key=lambda one: -one[0])]


def _nearest_safe(point: tuple[float, float], columns: Columns, turn: int) -> tuple[float, float, bool] | None:
    """The top of the nearest stretch of speeds, upwards or downwards, that holds the depth.

    returns rad/s, m, and whether no limit was found there
    """
    speed, depth = point
    beyond = np.flatnonzero((columns.speed - speed) * turn > 0)[::turn]
    safe = columns.runnable[beyond] >= depth
    if not safe.any():
        return None
    start = int(np.argmax(safe))
    stop = start + int(np.argmin(np.append(safe[start:], False)))
    stretch = beyond[start:stop]
    top = columns.runnable[stretch]
    widest = np.flatnonzero(top >= top.max() * (1 - 1e-9))
    i = stretch[widest[len(widest) // 2]]
    return float(columns.speed[i]), float(columns.runnable[i]), bool(columns.runnable[i] >= columns.deepest)


_NEAR = f"within {100 * HELD:g} % of the speed"


def _surely(spread: Spread | None) -> str:
    return f"{'stable with 97.5 %' if spread is not None else f'{SAFE:.0%} of the limit'} {_NEAR}"


def _depth(depth: float, unlimited: bool, spread: Spread | None) -> str:
    """What may be cut, and how far that is to be relied on."""
    if unlimited and spread is None:
        return f"no limit was found down to {_mm(depth)} mm {_NEAR}"
    return f"{_mm(depth)} mm are {_surely(spread)}"


def _times(rate: float) -> str:
    return f"{rate:.3g} times" if rate < MANY_TIMES else f"more than {MANY_TIMES} times"


def _rpm(speed: float) -> str:
    return f"{to_shop(speed, 'x_rpm'):.0f} rpm"


def _mm(depth: float) -> str:
    return f"{to_shop(depth, 'x_mm'):.3g}"


def _limit(depth: float, deepest: float, spread: Spread | None) -> str:
    """The limit of another cutter, of which nothing is drawn but the mean."""
    found = f"no limit was found down to {_mm(deepest)} mm" if np.isinf(depth) else f"limit {_mm(depth)} mm, the least"
    return f"{found} {_NEAR}{'; no band is known of it' if spread is not None else ''}"
