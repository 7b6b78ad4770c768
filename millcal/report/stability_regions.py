"""Where a map is stable, as areas and edges to draw: from crossings, which a stage saves as points, column by column.

At one speed the crossings tell which stretches of depth are stable. Between neighbouring columns a stretch goes on where it
overlaps one stretch alone; where stretches come, go, split or merge, what closes does so half a column further, at the middle
of what closes. So islands of chatter and stable pockets are closed areas, and no crossing has to be followed from
speed to speed. The same serves the areas of a probability, whose stretches end where it passes a level.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from millcal.data import StabilityMap

KINDS = ("Hopf", "flip", "fold")  # as the record numbers them
EVERY_CROSSING = ("floquet", "frf")  # methods that save each multiplier's, not what the cut as a whole does
MULTIPLIERS = (2, 1, 1)  # that cross the unit circle together
LEAP = 0.5  # of a probability between two depths, beyond which it is no slope
RIM = -1  # an end that is no crossing: no depth at all, or as deep as was looked


class Stretch(NamedTuple):
    """Depths of one column, from low to high, and the kinds of its ends."""

    low: float
    high: float  # inf: as deep as one likes
    below: int = RIM
    above: int = RIM


@dataclass(frozen=True, eq=False)
class Area:
    """Stretches that hang together, from column to column."""

    x: np.ndarray  # (column,)
    low: np.ndarray
    high: np.ndarray
    below: np.ndarray  # kinds of the ends
    above: np.ndarray


class Edge(NamedTuple):
    """A line of one kind that bounds an area."""

    x: np.ndarray
    y: np.ndarray
    kind: int


def stable_stretches(map_: StabilityMap) -> list[list[Stretch]]:
    """The stable depths of every speed, lowest first.

    Of methods that save every crossing the multipliers outside the unit circle are counted: a pair that left together may
    part on the real axis, and with the first of the two back inside the cut still chatters. Others save what the whole cut
    does; where there stability is lost and comes back in turn, every crossing is an end of what is stable.
    """
    counted = map_.method in EVERY_CROSSING
    columns: list[list[Stretch]] = []
    order = np.lexsort([map_.crossing_depth, map_.crossing_speed])
    speeds = map_.crossing_speed[order]
    starts = np.searchsorted(speeds, map_.spindle_speed * (1 - 1e-7))
    stops = np.searchsorted(speeds, map_.spindle_speed * (1 + 1e-7))
    depth, kind, loses = (v[order] for v in (map_.crossing_depth, map_.crossing_kind, map_.crossing_loses))
    for i, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        at = slice(start, stop)
        crossings = [
            (float(d), int(k), bool(lost)) for d, k, lost in zip(depth[at], kind[at], loses[at], strict=True) if d > 0
        ]
        if not any(lost for _, _, lost in crossings):  # a record of the limit alone
            limit = float(map_.limit_depth[i])
            crossings = [(limit, int(map_.limit_kind[i]), True)] if np.isfinite(limit) else []
        columns.append(_between(crossings, counted))
    return columns


def stretches_with_best(map_: StabilityMap) -> tuple[np.ndarray, list[list[Stretch]]]:
    """The stable depths of every speed and, between them, of the best speeds and of the smallest limit.

    Those were refined, and a coarse map would cut off the top of the pocket or the bottom of the lobe. Further up, such a
    speed has the mean of its neighbours' stretches, or those of the nearer one where they are not as many.
    returns the speeds (column,) rad/s, ascending, and the stretches of each
    """
    speeds, columns = map_.spindle_speed, stable_stretches(map_)
    refined = [(best.spindle_speed, best.axial_depth, True) for best in map_.best]
    refined.append((map_.absolute_minimum_speed, map_.absolute_minimum, False))
    added: dict[float, list[Stretch]] = {}
    for speed, depth, top in refined:
        i = int(np.searchsorted(speeds, speed))
        if not 0 < i < len(speeds) or np.isclose(speed, speeds[i - 1 : i + 1], rtol=1e-7, atol=0).any():
            continue
        left, right = columns[i - 1], columns[i]
        if not left or not right or not np.isfinite(depth):
            continue  # no top: as deep as was looked
        removed = [speeds[i - 1] * left[0].high, speeds[i] * right[0].high]  # in the manner of the removal rate
        if max(removed) > (1 + 1e-9) * speed * depth if top else depth > min(left[0].high, right[0].high):
            continue  # of another map
        first = min(left[0], right[0], key=lambda s: abs(s.high - depth))
        share = (speed - speeds[i - 1]) / (speeds[i] - speeds[i - 1])
        above = (left if share < 0.5 else right)[1:]
        if len(left) == len(right):
            above = [
                a._replace(low=a.low + share * (b.low - a.low), high=a.high + share * (b.high - a.high))
                if np.isfinite([a.high, b.high]).all()
                else a
                for a, b in zip(left[1:], right[1:], strict=True)
            ]
        added[float(speed)] = [Stretch(0.0, depth, RIM, first.above), *(s for s in above if s.low > depth)]
    every = np.array([*speeds.tolist(), *added])
    order = np.argsort(every)
    every_column = [*columns, *added.values()]
    return every[order], [every_column[k] for k in order]


def _between(crossings: Sequence[tuple[float, int, bool]], counted: bool) -> list[Stretch]:
    """The stable stretches between crossings, each with its depth, its kind and whether stability is lost."""
    in_turn = not counted and all(lost == (number % 2 == 0) for number, (_, _, lost) in enumerate(crossings))
    stretches: list[Stretch] = []
    outside, low, below = 0, 0.0, RIM  # multipliers
    for depth, kind, lost in crossings:
        many = 1 if in_turn or kind == RIM else MULTIPLIERS[kind]
        before, outside = outside, max(outside + (many if lost else -many), 0)
        if before == 0 < outside:
            stretches.append(Stretch(low, depth, below, kind))
        elif outside == 0 < before:
            low, below = depth, kind
    return stretches if outside else [*stretches, Stretch(low, np.inf, below, RIM)]


def chances(map_: StabilityMap) -> list[tuple[np.ndarray, np.ndarray]]:
    """The probability of a stable cut against depth at every speed, (depth,) m and (depth,); none where it is not known.

    Where it leaps from one depth to the next, the bound of the map between them says where, and its band how steeply: else
    coefficients that are known well would give steps as high as the depths are apart.
    """
    if map_.probability is None or map_.probability_depth is None:
        return []
    depth, found = map_.probability_depth, []
    for i, stretches in enumerate(stable_stretches(map_)):
        chance = map_.probability[:, i]
        d, p = [depth], [chance]
        for end in sorted({end for s in stretches for end in (s.low, s.high) if depth[0] < end < depth[-1]}):
            k = int(np.searchsorted(depth, end)) - 1
            if abs(chance[k + 1] - chance[k]) < LEAP:
                continue
            low, high = end * (1 - 1e-6), end * (1 + 1e-6)
            first, last = chance[k], chance[k + 1]
            if end == map_.limit_depth[i] and map_.limit_low is not None and map_.limit_high is not None:
                band = float(map_.limit_low[i]), float(map_.limit_high[i])
                within = depth[k] < band[0] <= end <= band[1] < depth[k + 1]
                low, high, first, last = (*band, 0.975, 0.025) if within else (low, high, first, last)
            d.append(np.array([low, end, high]))
            p.append(np.array([first, (first + last) / 2, last]))
        order = np.argsort(np.concatenate(d), kind="stable")
        found.append((np.concatenate(d)[order], np.concatenate(p)[order]))
    return found


def stretches_above(columns: Sequence[tuple[np.ndarray, np.ndarray]], level: float) -> list[list[Stretch]]:
    """Where a quantity reaches a level.   columns : depth (n,), ascending, and the quantity there (n,), of each column"""
    found = []
    for depth, values in columns:
        inside = values >= level
        change = np.flatnonzero(np.diff(inside.astype(int)))
        share = (level - values[change]) / (values[change + 1] - values[change])
        ends = (depth[change] + share * np.diff(depth)[change]).tolist()
        kinds = [0] * len(ends)
        if inside[0]:
            ends, kinds = [0.0, *ends], [RIM, *kinds]
        if inside[-1]:
            ends, kinds = [*ends, float(depth[-1])], [*kinds, RIM]
        found.append(
            [Stretch(ends[i], ends[i + 1], kinds[i], kinds[i + 1]) for i in range(0, len(ends), 2)]
        )  # they come in pairs
    return found


def areas(x: np.ndarray, columns: Sequence[Sequence[Stretch]]) -> list[Area]:
    """Stretches of neighbouring columns put together.   x : (column,) ascending"""
    done: list[list[tuple[float, Stretch]]] = []
    going: list[list[tuple[float, Stretch]]] = [[(float(x[0]), s)] for s in columns[0]] if len(x) else []
    for i in range(1, len(x)):
        left, right = columns[i - 1], columns[i]
        here, middle = float(x[i]), float(x[i - 1] + x[i]) / 2
        next_: list[list[tuple[float, Stretch]]] = [[] for _ in right]
        for lefts, rights in _together(left, right):
            if len(lefts) == len(rights):  # also where an island moves on by more than its height
                for a, b in zip(lefts, rights, strict=True):
                    next_[b] = [*going[a], (here, right[b])]
                continue
            from_left, from_right = _closed([left[k] for k in lefts], [right[k] for k in rights])
            for k, end in zip(lefts, from_left, strict=True):
                done.append([*going[k], (middle, end)])
            for k, end in zip(rights, from_right, strict=True):
                next_[k] = [(middle, end), (here, right[k])]
        going = next_
    return [_area(points) for points in [*done, *going]]


def _together(left: Sequence[Stretch], right: Sequence[Stretch]) -> list[tuple[list[int], list[int]]]:
    """Stretches of two columns in groups that overlap, as indices."""
    groups: list[tuple[list[int], list[int], list[float]]] = []
    entries = sorted(
        [(s.low, s.high, 0, k) for k, s in enumerate(left)] + [(s.low, s.high, 1, k) for k, s in enumerate(right)]
    )
    for low, high, side, k in entries:
        if not groups or low > groups[-1][2][0]:
            groups.append(([], [], [high]))
        group = groups[-1]
        group[side].append(k)
        group[2][0] = max(group[2][0], high)
    return [(lefts, rights) for lefts, rights, _ in groups]


def _closed(left: Sequence[Stretch], right: Sequence[Stretch]) -> tuple[list[Stretch], list[Stretch]]:
    """How the stretches of either column end between them: the gaps of each close, and what has no neighbour closes itself."""
    if not left or not right:
        ends = []
        for s in left or right:
            at = s.high if np.isinf(s.high) else (s.low + s.high) / 2
            ends.append(Stretch(at, at, s.below, s.above))
        return (ends, []) if left else ([], ends)
    low, high = (left[0].low + right[0].low) / 2, (left[-1].high + right[-1].high) / 2

    def side(column: Sequence[Stretch]) -> list[Stretch]:
        gaps = [(a.high + b.low) / 2 for a, b in pairwise(column)]
        lows, highs = [low, *gaps], [*gaps, high]
        return [Stretch(a, b, s.below, s.above) for a, b, s in zip(lows, highs, column, strict=True)]

    return side(left), side(right)


def _area(points: Sequence[tuple[float, Stretch]]) -> Area:
    low, high, below, above = (np.array(values) for values in zip(*(s for _, s in points), strict=True))
    return Area(np.array([x for x, _ in points]), low, high, below, above)


def edges(found: Sequence[Area]) -> list[Edge]:
    """The lines around areas, one for each stretch of one kind; where the kind changes they meet half way."""
    lines = []
    for area in found:
        for y, kind in ((area.low, area.below), (area.high, area.above)):
            lines += _of_one_kind(area.x, y, kind)
    return lines


def _of_one_kind(x: np.ndarray, y: np.ndarray, kind: np.ndarray) -> list[Edge]:
    changes = np.flatnonzero(np.diff(kind)) + 1
    lines = []
    for start, stop in pairwise([0, *changes.tolist(), len(x)]):
        if kind[start] == RIM:
            continue
        before = [_towards(start, start - 1, x, y, kind)] if start else []
        after = [_towards(stop - 1, stop, x, y, kind)] if stop < len(x) else []
        points = [*before, *zip(x[start:stop], y[start:stop], strict=True), *after]
        xs, ys = (np.array(values) for values in zip(*points, strict=True))
        lines.append(Edge(xs, ys, int(kind[start])))
    return lines


def _towards(own: int, other: int, x: np.ndarray, y: np.ndarray, kind: np.ndarray) -> tuple[float, float]:
    """As far as a line goes towards a neighbour of another kind: half way, or all the way to a rim."""
    return (x[other], y[other]) if kind[other] == RIM else ((x[own] + x[other]) / 2, (y[own] + y[other]) / 2)


def simplified(x: np.ndarray, y: np.ndarray, across: float, along: float) -> np.ndarray:
    """Indices of the points that a line needs to stay within so much of all of them  [DouglasPeucker1973]_.

    across, along : how far off the line may be in y and in x
    """
    kept = np.zeros(len(x), bool)
    kept[[0, -1]] = True
    u, v = x / along, y / across
    waiting = [(0, len(x) - 1)]
    while waiting:
        a, b = waiting.pop()
        if b - a < 2:
            continue
        du, dv = u[b] - u[a], v[b] - v[a]
        length = np.hypot(du, dv)
        pu, pv = u[a + 1 : b] - u[a], v[a + 1 : b] - v[a]
        off = np.abs(du * pv - dv * pu) / length if length > 0 else np.hypot(pu, pv)
        worst = int(np.argmax(off))
        if off[worst] > 1:
            kept[a + 1 + worst] = True
            waiting += [(a, a + 1 + worst), (a + 1 + worst, b)]
    return np.flatnonzero(kept)


def inner_crossings(map_: StabilityMap, columns: Sequence[Sequence[Stretch]]) -> np.ndarray:
    """Crossings beyond which the cut chatters as before.   returns their indices"""
    ends = {(i, end) for i, stretches in enumerate(columns) for s in stretches for end in (s.low, s.high)}
    column = np.searchsorted(map_.spindle_speed * (1 + 1e-7), map_.crossing_speed)
    inner = [
        k
        for k, (i, depth) in enumerate(zip(column.tolist(), map_.crossing_depth.tolist(), strict=True))
        if (i, depth) not in ends
    ]
    return np.array(inner, int)
