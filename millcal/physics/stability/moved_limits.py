"""How far the first limit moves when structure and coefficients are a little others: a few multipliers a speed, not a column.

Beyond its limit the largest multiplier of a cut grows along the depth. That of a cut a little other grows alike, stretched: so
what it has at a depth somewhat beyond the limit says how far it is stretched, the better the nearer to the limit it is looked at.
Below the limit nothing can be told, since there the lightly damped modes that have no part in it are the largest.
"""

from collections.abc import Callable, Sequence

import numpy as np

from millcal.physics.stability.floquet import spectral_radius
from millcal.physics.stability.regeneration import Regeneration, TipModes

BEYOND = (1.1, 1.05, 1.03, 1.02, 1.01)  # times the limit as it is known so far
GRID = np.array([1.0, 1.005, 1.01, 1.02, 1.05, 1.1, 1.2, 1.4])  # at which the growth of the known cut is followed


def moved_limits(
    spindle_speed: np.ndarray,
    limit: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    others: Sequence[tuple[TipModes, Regeneration]],
    progress: Callable[[float], None] = lambda share: None,
) -> np.ndarray:
    """First limits of other cuts near to one whose limits are known.

    spindle_speed : (speed,) rad/s   limit : of `tip` and `cut`, (speed,) m, inf where there is none, which stays
    others : near to them   returns (other, speed) m
    """
    found = np.full((len(others), len(limit)), np.inf)
    there = np.flatnonzero(np.isfinite(limit))
    speed, known = spindle_speed[there], limit[there]
    depth = np.multiply.outer(GRID[1:], known)
    growth = np.log(spectral_radius(np.broadcast_to(speed, depth.shape).ravel(), depth.ravel(), tip, cut))
    growth = np.maximum.accumulate(np.vstack([np.zeros(len(known)), growth.reshape(depth.shape)]), axis=0)
    for i, (other, moved) in enumerate(others):
        progress(i / len(others))
        stretched = np.ones(len(known))
        for beyond in BEYOND:
            at = beyond * stretched
            seen = np.log(spectral_radius(speed, at * known, other, moved))
            alike = [np.interp(size, curve, GRID) for size, curve in zip(seen, growth.T, strict=True)]
            stretched = at / np.array(alike)
        found[i, there] = stretched * known
    return found
