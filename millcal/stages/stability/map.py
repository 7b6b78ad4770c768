"""Stability map: limit depth against spindle speed, with a band from what is uncertain in coefficients and FRF.

Coefficients. The zero-order limit is f(K_rc / K_tc) / K_tc: K_tc only scales it, the ratio turns the eigenvectors, edge
coefficients do not enter. So f is solved exactly at a few dozen ratios across the draws and each draw is an interpolation
between two of them (of 1/f, where a change of lobe is a convex corner: interpolating errs to the safe side). A Kienzle
law enters by its tangent at the mean chip of the operating feed, draw by draw.

FRF. Drawing noisy lines would add the noise a second time to lines that carry it already, and the lowest of several noisy
crossings is biased low. So the variance goes through the eigenvalue at the limiting frequency to first order
(`inverse_depth_sd`), centred on the limit of the measured lines, and is normal in 1/b, in which the eigenvalue is linear.

Fitted modes. Their errors move frequencies, damping and residues together and with them the lobes, which no first order at
one frequency sees; so the limit is solved anew for a few hundred structures drawn from the fit, with the coefficients at their
mean, and what that moves 1/b by is added to the draws of the coefficients.

The band holds speed by speed: 95 % at each speed, not for the whole curve at once.
"""

from collections.abc import Callable, Sequence

import numpy as np

from millcal.data import BestSpeed, CutTests, Frf, Modes, Notice, OperatingPoint, Posterior, StabilityMap
from millcal.errors import IllPosedError
from millcal.physics.cutter import CuttingConditions, engagement
from millcal.physics.stability.regeneration import HOPF
from millcal.physics.stability.zero_order import Limit, mean_cutting_matrix
from millcal.stages.stability.coefficients import cutting_draws
from millcal.stages.stability.lines import tip_of_lines
from millcal.stages.stability.modes import tip_of_modes
from millcal.stages.stability.tip import Solver, Tip

RATIOS = 41  # K_rc / K_tc at which the limit is solved exactly for the band
STRUCTURES = 400  # draws of fitted modes, at most
POCKETS = 5  # best speeds told


def map_stability(
    dynamics: Frf | Modes,
    posterior: Posterior | tuple[float, float],
    *,
    teeth: int,
    diameter: float,
    radial_depth: float | None,
    direction: str,
    spindle_speed: tuple[float, float],
    feed_per_tooth: float | None = None,
    pitch: Sequence[float] | None = None,
    helix: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    rigid: str = "",
    method: str = "zoa",
    points: int = 400,
    deepest: float | None = None,
    indentation: float = 0.0,
    indentation_friction: float = 0.3,
    edge: tuple[float, float] | None = None,
    members: int = 2000,
    probability: bool | int = False,
    operating_point: tuple[float, float] | None = None,
    tests: CutTests | None = None,
    simulate: tuple[int, int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> StabilityMap:
    """Limit depth over a range of spindle speeds, the best speeds in it, and the operating point among them.

    dynamics : an FRF with driving points along x and y at one point, or modes, given along x and y or fitted to such an FRF
    posterior : coefficients, or (K_tc, K_rc) in N/m^2 taken as exact
    diameter, radial_depth, feed_per_tooth : m   spindle_speed : (lowest, highest) rad/s   pitch : (tooth,) rad   helix : rad
    runout : (c0, s0) m as in the time domain, which alone knows of it
    rigid : axes that may be missing from `dynamics`, "x" or "y", because the user knows them to be rigid
    method : zoa, floquet (needs modes), frf (needs an FRF), time-domain (needs modes)
    deepest : m, how deep to look; None: chosen from the absolute minimum, the operating point and the tests
    indentation, indentation_friction : C in N/m and mu of process damping; 0: none
    edge : (K_te, K_re) N/m, for torque, power and the time domain; None: those of the coefficients, if they have them
    members : draws for the band and the probabilities   probability : a map of them, True or its number of depths
    operating_point : (rad/s, m)   tests : cuts made, drawn over the map and held against it
    simulate : (speeds, depths) of points cut in the time domain, whatever the method   rng : needed for a band
    """
    if method not in METHODS:
        raise ValueError(f"{method=} is none of {', '.join(METHODS)}")
    low, high = spindle_speed
    if not 0 < low < high:
        raise IllPosedError(
            f"stability.rpm: {spindle_speed} rad/s is no range of spindle speeds; give [lowest, highest]"
        )
    progress = progress or (lambda share, label: None)
    radial_depth = diameter if direction == "slot" or radial_depth is None else radial_depth
    conditions = CuttingConditions(high, feed_per_tooth or 0.0, 0.0, radial_depth, direction)
    entry, leave = engagement(conditions, diameter)
    if leave - entry <= 0:
        raise IllPosedError("stability.radial_depth_mm: the cutter is not engaged; give a radial depth above zero")

    def cutting(ktc: float, krc: float) -> np.ndarray:
        return mean_cutting_matrix(ktc, krc, teeth=teeth, entry=entry, leave=leave)

    mean_chip = (feed_per_tooth or 0.0) * (np.cos(entry) - np.cos(leave)) / (leave - entry)
    (ktc, krc), draws, notices = cutting_draws(posterior, mean_chip, members, rng)
    notices += _geometry_notices(pitch, teeth, leave - entry)
    speeds = np.linspace(low, high, points)
    asked = np.array([low, high] if operating_point is None else [low, high, operating_point[0]])
    tip = METHODS[method](dynamics, asked, teeth, rigid)
    nominal = cutting(ktc, krc)
    progress(0.1, "limit")
    limit = tip.solve(speeds, nominal)

    tops = _pockets(lambda speed: tip.solve(speed, nominal).depth, speeds, limit.depth)
    extra = np.concatenate([tops, [] if operating_point is None else [operating_point[0]]])
    at_extra = tip.solve(extra, nominal)
    everywhere = np.concatenate([speeds, extra])
    together = Limit(*(np.concatenate(pair) for pair in zip(limit, at_extra, strict=True)))

    inverse = None  # of the depth, (member, speed), 1/m
    spread = None if tip.inverse_sd is None else tip.inverse_sd(everywhere, nominal, together)
    if members > 1 and rng is not None and (draws is not None or spread is not None or tip.draws is not None):
        share = 0.8 if tip.draws is None else 0.2  # of the progress
        inverse = _inverse_depths(
            tip.solve,
            cutting,
            everywhere,
            together,
            (ktc, krc),
            draws,
            members,
            lambda s: progress(0.15 + share * s, "band"),
        )
        if spread is not None:
            inverse = inverse + rng.standard_normal((len(inverse), 1)) * spread
        if tip.draws is not None:
            moved = np.empty((min(members, STRUCTURES), len(everywhere)))
            for i, solve in enumerate(tip.draws(rng, len(moved))):
                progress(0.35 + 0.6 * i / len(moved), "band")
                moved[i] = 1 / solve(everywhere, nominal).depth - 1 / together.depth
            stronger = 1.0 if draws is None else draws[:, :1] / ktc
            inverse = inverse + moved[np.arange(len(inverse)) % len(moved)] * stronger
    band = None if inverse is None else np.array([_depth_of(q) for q in np.quantile(inverse, [0.975, 0.025], axis=0)])

    n, width = len(speeds), None if feed_per_tooth is None else radial_depth * feed_per_tooth * teeth / (2 * np.pi)
    best = []
    for i in range(n, n + len(tops)):
        speed, depth = float(everywhere[i]), float(together.depth[i])
        rate = np.nan if width is None else depth * width * speed
        p_stable = None if inverse is None else float(np.mean(inverse[:, i] * depth < 1))
        best.append(BestSpeed(speed, depth, rate, p_stable, None if band is None else float(band[0, i])))
    best.sort(key=lambda b: -b.spindle_speed * (b.axial_depth if b.safe_depth is None else b.safe_depth))

    limits = np.isfinite(limit.depth)
    operating = None
    if operating_point is not None:
        bound = float(together.depth[-1])
        operating = OperatingPoint(
            spindle_speed=operating_point[0],
            axial_depth=operating_point[1],
            limit=bound,
            stable=operating_point[1] < bound,
            kind="hopf" if np.isfinite(bound) else "",
            chatter_frequency=float(together.frequency[-1]),
            limit_interval=None if band is None else (float(band[0, -1]), float(band[1, -1])),
            p_stable=None if inverse is None else float(np.mean(inverse[:, -1] * operating_point[1] < 1)),
        )
    progress(1.0, "limit")
    return StabilityMap(
        spindle_speed=speeds,
        limit_depth=limit.depth,
        chatter_frequency=limit.frequency,
        limit_kind=np.where(limits, HOPF, -1),
        lobe=limit.lobe,
        crossing_speed=speeds[limits],
        crossing_depth=limit.depth[limits],
        crossing_kind=np.full(np.count_nonzero(limits), HOPF),
        crossing_frequency=limit.frequency[limits],
        crossing_loses=np.ones(np.count_nonzero(limits)),
        operating=operating,
        limit_low=None if band is None else band[0, :n],
        limit_high=None if band is None else band[1, :n],
        method=method,
        teeth=teeth,
        radial_depth=radial_depth,
        diameter=diameter,
        direction=direction,
        feed_per_tooth=feed_per_tooth,
        absolute_minimum=(minimum := tip.minimum(nominal))[0],
        absolute_minimum_frequency=minimum[1],
        best=tuple(best[:POCKETS]),
        notices=(
            *notices,
            *tip.notices,
            *_band_notices(tip, speeds, nominal, limit.depth),
            *_feed_notices(feed_per_tooth),
        ),
    )


def _inverse_depths(
    solve: Solver,
    cutting: Callable[[float, float], np.ndarray],
    speeds: np.ndarray,
    limit: Limit,
    mean: np.ndarray,
    draws: np.ndarray | None,
    members: int,
    progress: Callable[[float], None],
) -> np.ndarray:
    """1/b of every draw of the coefficients at every speed.   returns (member, speed) 1/m"""
    if draws is None:
        return np.tile(1 / limit.depth, (members, 1))
    ratio = draws[:, 1] / draws[:, 0]
    # Quantiles, so that a far draw of few cuts' long tails does not stretch the grid; closer at the ends, where the band is.
    nodes = np.unique(np.quantile(ratio, (1 - np.cos(np.linspace(0, np.pi, RATIOS))) / 2))
    table = np.empty((len(nodes), len(speeds)))  # 1/b for K_tc = that of the mean
    for i, node in enumerate(nodes):
        progress(i / len(nodes))
        table[i] = 1 / solve(speeds, cutting(mean[0], mean[0] * node)).depth
    right = np.clip(np.searchsorted(nodes, ratio), 1, max(len(nodes) - 1, 1)) % len(nodes)
    left = np.maximum(right - 1, 0)
    share = (ratio - nodes[left]) / np.where(right > left, nodes[right] - nodes[left], 1.0)
    share = np.clip(share, 0.0, 1.0)[:, np.newaxis]
    return (table[left] * (1 - share) + table[right] * share) * (draws[:, :1] / mean[0])


def _depth_of(inverse: np.ndarray) -> np.ndarray:
    """b from 1/b, inf where 1/b is not positive."""
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)


def _pockets(depth_at: Callable[[np.ndarray], np.ndarray], speeds: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Speeds at which speed times limit has its highest local maxima, each found finer than the grid.   returns (pocket,)"""
    rate = np.where(np.isfinite(depth), depth * speeds, -np.inf)
    padded = np.concatenate([[-np.inf], rate, [-np.inf]])
    top = np.flatnonzero((rate >= padded[:-2]) & (rate > padded[2:]) & np.isfinite(rate))
    top = top[np.argsort(-rate[top], kind="stable")][: 2 * POCKETS]  # the band may change the order
    low, high = speeds[np.maximum(top - 1, 0)], speeds[np.minimum(top + 1, len(speeds) - 1)]
    best = speeds[top]
    if not len(top):
        return best
    for _ in range(3):
        fine = low + (high - low) * np.linspace(0, 1, 21)[:, np.newaxis]  # (21, pocket)
        fine[10] = best
        fine.sort(axis=0)
        found = depth_at(fine.ravel()).reshape(fine.shape) * fine
        i, pocket = np.argmax(np.where(np.isfinite(found), found, -np.inf), axis=0), np.arange(len(top))
        best = fine[i, pocket]
        low, high = fine[np.maximum(i - 1, 0), pocket], fine[np.minimum(i + 1, len(fine) - 1), pocket]
    return best


def _geometry_notices(pitch: Sequence[float] | None, teeth: int, swept: float) -> list[Notice]:
    """What the zero-order theory leaves out of this cutter and this engagement."""
    notices = []
    if pitch is not None and np.ptp(pitch) > 1e-6:
        notices.append(
            Notice(
                "mean-pitch",
                "the zero-order limit knows one pitch: the mean is used, and what the unequal pitch gains or loses is not shown",
            )
        )
    in_cut = teeth * swept / (2 * np.pi)
    if in_cut < 0.5:
        notices.append(
            Notice(
                "flip-lobes",
                f"{in_cut:.2f} teeth cut on average: period doubling, which the zero-order theory leaves out, can halve the "
                "limit at some speeds; test deep pockets with a shallower cut first",
            )
        )
    return notices


def _band_notices(tip: Tip, speeds: np.ndarray, nominal: np.ndarray, depth: np.ndarray) -> list[Notice]:
    """Where the usable band of the FRF may hide a lower limit."""
    notices = []
    if tip.band is None:
        return notices
    band = f"{tip.band[0]:.0f} to {tip.band[1]:.0f} Hz, {tip.band_of}"
    none = int(np.count_nonzero(np.isinf(depth)))
    if none:
        what = f"{none} of {len(depth)} speeds have no chatter frequency from {band}; what limits them is not shown"
        notices.append(Notice("band-limited", what))
    if tip.beyond is not None:
        beyond = tip.beyond(speeds, nominal)
        lower = (beyond.depth < 0.95 * depth) & (beyond.frequency > tip.band[1])
        if lower.any():
            at = np.median(beyond.frequency[lower])
            what = (
                f"limits count chatter from {band}; lines above it, if they can be trusted, lower the limit at "
                f"{np.count_nonzero(lower)} of {len(depth)} speeds, by chatter about {at:.0f} Hz; hit with a harder tip"
            )
            notices.append(Notice("band-limited", what))
    return notices


def _feed_notices(feed_per_tooth: float | None) -> list[Notice]:
    if feed_per_tooth is not None:
        return []
    return [
        Notice(
            "no-feed",
            "no feed per tooth: best speeds are ranked by depth times speed, and removal rates are not known",
            "stability.feed_per_tooth_mm",
        )
    ]


def zero_order_tip(dynamics: Frf | Modes, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    """The zero-order method on modes or on the lines of an FRF.

    speeds : rad/s, among them the lowest and the highest that will be asked   rigid : axes that may be missing
    """
    if isinstance(dynamics, Modes):
        return tip_of_modes(dynamics, speeds, teeth, rigid)
    return tip_of_lines(dynamics, teeth, rigid)


METHODS: dict[str, Callable[..., Tip]] = {"zoa": zero_order_tip}
