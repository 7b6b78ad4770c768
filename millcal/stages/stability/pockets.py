"""The best speeds of a map: where depth times speed has its tops, and what the spindle gives for them.

Only depths below the first limit count: a stable island above one is reached through chatter. A depth counts as far as it
holds half a percent either way of the speed, for no spindle turns as fast as it is told to the last revolution: a limit that
stands on the edge of a cliff is worth what lies at its foot. Where a method looked as far as it looks and found no limit, the
pocket is that deep at least, and its middle is the speed that is farthest from both walls. Where a band is known the best
speed of a pocket is that of the deepest safe cut, which is not that of the highest limit.
"""

from collections.abc import Callable

import numpy as np

from millcal.data import BestSpeed
from millcal.stages.stability.spread import Spread

POCKETS = 5  # best speeds told,
LOOKED_AT = 7  # and looked at: the band may change their order
HELD = 0.005  # share of a speed by which a spindle under load may be off it, slip and override dial together
PLACES = 101  # between two speeds, where the held depth is read off the limits that are known
NOTHING = 1e-12  # m: a depth of none
OFF = 0.9  # of the depth of a best speed: what a speed that is a little off should still hold


def around(speeds: np.ndarray, low: float, high: float) -> np.ndarray:
    """Speeds and as far as each has to hold, within the map.   speeds : (n,) rad/s   returns (3 n,): slower, as told, faster"""
    return np.clip(np.concatenate([speeds * (1 - HELD), speeds, speeds * (1 + HELD)]), low, high)


def held(speeds: np.ndarray, depth: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The least depth within `HELD` of a speed, between known ones by 1/b; beyond the ends of the map nothing is known.

    speeds : ascending, (speed,) rad/s   depth : (speed,) m   at : (place,) rad/s   returns (place,) m
    """
    inverse = 1 / np.maximum(depth, NOTHING)
    low, high = np.clip(at * (1 - HELD), *speeds[[0, -1]]), np.clip(at * (1 + HELD), *speeds[[0, -1]])
    worst = np.maximum(np.interp(low, speeds, inverse), np.interp(high, speeds, inverse))
    first, last = np.searchsorted(speeds, low), np.searchsorted(speeds, high, side="right")
    padded = np.append(inverse, 0.0)  # that a window may end with the last speed
    pairs = np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2]
    worst = np.where(last > first, np.maximum(worst, pairs), worst)
    return np.where(worst > 0, 1 / np.where(worst > 0, worst, 1.0), np.inf)


def pockets(
    depth_at: Callable[[np.ndarray], np.ndarray],
    speeds: np.ndarray,
    depth: np.ndarray,
    deepest: float,
    refine: tuple[int, int],
) -> np.ndarray:
    """Speeds at which speed times the limit that holds has its highest local maxima, each found finer than the grid.

    depth_at : speeds (n,) -> first limit (n,), for `refine`: rounds, and speeds in each   depth : at the speeds, (speed,)
    deepest : where no limit is found it is at least that   returns (pocket,) rad/s
    """
    if not np.isfinite(depth).any():  # nothing tells one speed from another
        return np.empty(0)
    if np.isinf(deepest):  # where as deep as one likes was looked, no limit is one that is not known
        depth = np.where(np.isfinite(depth), depth, 0.0)
    kept = np.minimum(held(speeds, depth, speeds), deepest)
    open_ended = kept >= deepest
    rate = np.where(depth > 0, kept * speeds, -np.inf)
    padded = np.concatenate([[-np.inf], rate, [-np.inf]])
    top = np.flatnonzero((rate >= padded[:-2]) & (rate > padded[2:]) & np.isfinite(rate))
    top = np.array(list(dict.fromkeys(_up_the_wall(int(i), kept, open_ended) for i in top)), int)
    best = _middles(speeds, open_ended)[top]
    first = np.argsort(-kept[top] * best, kind="stable")[:LOOKED_AT]
    top, best = top[first], best[first]
    low, high = speeds[np.maximum(top - 1, 0)], speeds[np.minimum(top + 1, len(speeds) - 1)]
    walled = ~open_ended[top]
    if not walled.any():
        return best
    best[walled] = _held_best(
        depth_at, best[walled], low[walled], high[walled], refine, speeds, np.minimum(depth, deepest)
    )
    return best


def _held_best(
    depth_at: Callable[[np.ndarray], np.ndarray],
    best: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    refine: tuple[int, int],
    speeds: np.ndarray,
    depth: np.ndarray,
) -> np.ndarray:
    """Where speed times held limit is highest between two speeds. What counts is the limit at the ends of what is to hold, so
    there it is looked at, closer with every round.   best, low, high : (place,) rad/s   returns (place,) rad/s
    """
    rounds, many = refine
    half = (high - low) / 2
    for _ in range(rounds):
        ends = np.stack([best * (1 - HELD), best * (1 + HELD)])[..., np.newaxis]  # (2, place, 1)
        fine = ends + half[:, np.newaxis] * np.linspace(-1, 1, max(many // 2, 2))
        fine = np.unique(np.clip(fine, *speeds[[0, -1]]))
        found = depth_at(fine)
        merged = np.concatenate([speeds, fine])
        order = np.argsort(merged, kind="stable")
        speeds, depth = merged[order], np.concatenate([depth, np.where(np.isnan(found), 0.0, found)])[order]
        places = np.clip(best + half * np.linspace(-1, 1, PLACES)[:, np.newaxis], low, high)  # (PLACES, place)
        value = places * held(speeds, depth, places.ravel()).reshape(places.shape)
        best = places[np.argmax(value, axis=0), np.arange(len(best))]
        half = half / max(many // 2, 2)
    return best


def _up_the_wall(top: int, kept: np.ndarray, open_ended: np.ndarray) -> int:
    """The pocket without a bottom whose faster wall a top stands on, where rate still grows as depth falls; else the top."""
    i = top
    while i > 0 and not open_ended[i] and kept[i - 1] >= kept[i]:
        i -= 1
    if not open_ended[i]:
        return top
    while i > 0 and open_ended[i - 1]:
        i -= 1
    return i


def _middles(speeds: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Each speed, or the middle of the stretch of chosen ones that it belongs to."""
    middle = speeds.copy()
    ends = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    for start, stop in ends.reshape(-1, 2):
        middle[start:stop] = (speeds[start] + speeds[stop - 1]) / 2
    return middle


def refined(
    value_at: Callable[[np.ndarray], np.ndarray],
    best: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    refine: tuple[int, int],
) -> np.ndarray:
    """Where a value is highest between two speeds, by finer and finer grids.

    value_at : speeds (n,) -> (n,)   best, low, high : (place,) rad/s   refine : rounds, and speeds in each
    returns (place,) rad/s
    """
    rounds, many = refine
    for _ in range(rounds):
        fine = low + (high - low) * np.linspace(0, 1, many)[:, np.newaxis]  # (many, pocket)
        fine[many // 2] = best
        fine.sort(axis=0)
        found = value_at(fine.ravel()).reshape(fine.shape)
        i, pocket = np.argmax(np.where(np.isfinite(found), found, -np.inf), axis=0), np.arange(len(best))
        best = fine[i, pocket]
        low, high = fine[np.maximum(i - 1, 0), pocket], fine[np.minimum(i + 1, len(fine) - 1), pocket]
    return best


def safest(tops: np.ndarray, speeds: np.ndarray, depth: np.ndarray, safe: np.ndarray, deepest: float) -> np.ndarray:
    """The speed of each pocket at which what is safe removes the most: the top of the limit often stands on a wall.

    tops : (pocket,) rad/s, among the speeds   speeds : ascending, (speed,) rad/s   depth, safe : first limit, and the lower end
    of its band, (speed,) m   returns (pocket,) rad/s, or fewer where two pockets meet in one
    """
    depth, safe = np.minimum(depth, deepest), np.minimum(safe, deepest)
    rate = depth * speeds
    falls = np.stack([depth[:-1] - depth[1:], rate[:-1] - rate[1:]])  # to the next speed
    downwards, upwards = ((turn * falls >= 0).any(axis=0) for turn in (-1, 1))
    found = []
    for top in tops:
        at = int(np.argmin(np.abs(speeds - top)))
        up, down = np.flatnonzero(~upwards[at:]), np.flatnonzero(~downwards[:at])
        pocket = np.arange(down[-1] + 1 if len(down) else 0, (at + up[0] if len(up) else len(speeds) - 1) + 1)
        capped = np.isfinite(deepest) & (safe[pocket] >= deepest)
        value = np.where(np.isfinite(depth[pocket]), np.minimum(safe, depth)[pocket], 0.0) * speeds[pocket]
        best = speeds[pocket[np.argmax(value)]]
        if capped.any():
            ends = np.flatnonzero(np.diff(np.concatenate([[False], capped, [False]]).astype(int))).reshape(-1, 2)
            start, stop = max(
                ends.tolist(), key=lambda stretch: speeds[pocket[stretch[1] - 1]] - speeds[pocket[stretch[0]]]
            )
            middle = (speeds[pocket[start]] + speeds[pocket[stop - 1]]) / 2
            best = speeds[pocket[start:stop]][np.argmin(np.abs(speeds[pocket[start:stop]] - middle))]
        found.append(float(best))
    return np.array(list(dict.fromkeys(found)))


def tolerance(speed: float, depth: float, speeds: np.ndarray, runnable: np.ndarray) -> float:
    """How far a speed may be off, either way, while the depth stays within what may be run; to the end of the map at most.

    speeds : ascending, (speed,) rad/s   runnable : (speed,) m, between the speeds taken by 1/b   returns rad/s
    """
    inverse = np.where(runnable > 0, 1 / np.where(runnable > 0, runnable, 1.0), np.inf)
    ends = []
    for turn, beyond in ((-1, np.flatnonzero(speeds < speed)[::-1]), (1, np.flatnonzero(speeds > speed))):
        if not len(beyond):  # at the end of the map nothing is known of that way
            continue
        bad = np.flatnonzero(inverse[beyond] > 1 / depth)
        if not len(bad):
            ends.append(abs(float(speeds[beyond[-1]]) - speed))
            continue
        wrong = beyond[bad[0]]
        good = wrong - turn
        share = (1 / depth - inverse[good]) / (inverse[wrong] - inverse[good])
        end = speeds[good] + (speeds[wrong] - speeds[good]) * np.clip(np.nan_to_num(share), 0.0, 1.0)
        ends.append(max(turn * (float(end) - speed), 0.0))
    return min(ends, default=0.0)


def best_speeds(
    speeds: np.ndarray,
    depth: np.ndarray,
    safe_depth: np.ndarray | None,
    spread: Spread | None,
    *,
    width: float | None,
    torque: float | None,
    column: tuple[np.ndarray, np.ndarray],
) -> tuple[BestSpeed, ...]:
    """The pockets as the record has them, best first.

    speeds, depth : (pocket,) rad/s, m   safe_depth : lower end of the band, (pocket,) m; both as far as they hold
    width : radial depth times feed per radian, m^2, None: no feed
    torque : N m per m of depth, None where it is not known   column : speeds ascending and what may be run at each, rad/s, m
    """

    def near(speed: float) -> np.ndarray:
        return around(np.array([speed]), *column[0][[0, -1]])

    best = []
    for i, (speed, limit) in enumerate(zip(speeds.tolist(), depth.tolist(), strict=True)):
        safe = None if safe_depth is None else float(min(safe_depth[i], limit))
        run = limit if safe is None else safe
        best.append(
            BestSpeed(
                spindle_speed=speed,
                axial_depth=limit,
                removal_rate=np.nan if width is None else limit * width * speed,
                p_stable=None if spread is None else min(spread.at(float(at), limit) for at in near(speed)),
                safe_depth=safe,
                torque=None if torque is None else torque * run,
                power=None if torque is None else torque * run * speed,
                speed_margin=tolerance(speed, OFF * run, *column) if run > 0 else None,
            )
        )
    best.sort(key=lambda b: -b.spindle_speed * (b.axial_depth if b.safe_depth is None else b.safe_depth))
    return tuple(best[:POCKETS])
