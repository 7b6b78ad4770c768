"""The linear cut followed in time by an ordinary differential equation solver: multipliers from how motions grow.

The delayed equation is a plain one as long as the delayed motion is known (method of steps). A few motions with any start are
followed at once; after some periods they lie in the span of the slowest to decay, where one period acts as a small matrix.
"""

from bisect import bisect_right
from itertools import pairwise

import numpy as np
from cutting_matrix import at_angle, delays, lags, real_form
from scipy.integrate import solve_ivp

from millcal.physics.stability.regeneration import Regeneration, TipModes


def multipliers(
    spindle_speed: float,
    depth: float,
    tip: TipModes,
    cut: Regeneration,
    *,
    motions: int = 6,
    periods: int | None = None,
    tolerance: float = 1e-9,
) -> np.ndarray:
    """As many multipliers as motions, largest first; the first is the good one. Of a tooth period or a revolution.

    spindle_speed : rad/s   depth : m   returns complex (motions,)
    """
    if tip.flexibility.any():
        raise ValueError("a flexibility that answers at once is no differential equation")
    a, b, c = real_form(tip)
    period = (2 * np.pi / cut.teeth if cut.equal_pitch else 2 * np.pi) / spindle_speed
    late = delays(cut) / spindle_speed
    breaks = _breaks(cut, depth, period * spindle_speed) / spindle_speed
    periods = periods or (12 if cut.equal_pitch else 5)
    rng = np.random.default_rng(0)
    start = rng.normal(size=(2, 3, motions))
    fastest = np.abs(tip.pole).max()

    def before(t):  # any smooth motion
        return np.einsum("akm,k->am", start, np.cos(fastest * t * np.array([0.3, 0.6, 1.0]) + np.arange(3)))

    begins, pieces = [], []

    def tip_at(t):
        if t < 0 or not pieces:
            return before(t)
        piece = pieces[min(bisect_right(begins, t), len(pieces)) - 1]
        return c @ piece(t).reshape(-1, motions)

    def slope(t, flat, middle):
        x = flat.reshape(-1, motions)
        # the teeth in cut do not change inside a piece: at its very ends they are those of its middle
        angle = np.array([np.clip(t, middle - reach, middle + reach) * spindle_speed % (2 * np.pi)])
        cutting = at_angle(angle, depth, cut, cut.ktc, cut.krc)[0]
        force = -cutting.sum(axis=0) @ c @ x
        for matrix, lag in zip(cutting, late, strict=True):
            if matrix.any():
                force = force + matrix @ tip_at(t - lag)
        if cut.indentation:
            rubbing = at_angle(angle, depth, cut, cut.indentation_friction * cut.indentation, cut.indentation)[0]
            force = force - rubbing.sum(axis=0) @ c @ a @ x / (cut.radius * spindle_speed)
        return (a @ x + b @ force).ravel()

    scale = np.sqrt(np.mean(c**2))
    x = (rng.normal(size=(len(a), motions)) / scale).ravel()
    snapshots = []
    for number in range(periods):
        edges = number * period + breaks
        for first, last in pairwise(edges):
            reach = (last - first) / 2 * (1 - 1e-9)
            solved = solve_ivp(
                slope, (first, last), x, method="DOP853", dense_output=True, rtol=tolerance,
                atol=tolerance * np.abs(x).max(), args=((first + last) / 2,),
            )  # fmt: skip
            begins.append(first)
            pieces.append(solved.sol)
            x = solved.y[:, -1]
        seen = [tip_at(t) for t in edges[-1] - period * np.linspace(0.01, 0.99, 60)]
        snapshots.append(np.vstack([x.reshape(-1, motions) * scale, *seen]))
    once, again = snapshots[-2:]
    found = np.linalg.eigvals(np.linalg.lstsq(once, again)[0])
    return found[np.argsort(-np.abs(found))]


def spectral_radius(spindle_speed: float, depth: float, tip: TipModes, cut: Regeneration, **options) -> float:
    """The largest multiplier's size."""
    return float(np.abs(multipliers(spindle_speed, depth, tip, cut, **options)[0]))


def _breaks(cut, depth, period):
    """Angles of one period at which the motion has a kink: a tooth comes in or goes out, here or one delay before."""
    ends = np.array([cut.entry, cut.leave, cut.entry + cut.wind * depth, cut.leave + cut.wind * depth])
    events = np.concatenate([[0.0], (ends[:, np.newaxis] + lags(cut)).ravel()])
    events = np.concatenate([events, (events[:, np.newaxis] + delays(cut)).ravel()]) % period
    events = np.unique(np.concatenate([events, [0.0, period]]))
    return events[np.concatenate([[True], np.diff(events) > 1e-9 * period])]
