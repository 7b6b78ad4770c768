"""Stability of milling from its multipliers: the period map by its Volterra equation on Gauss nodes.

Over a period T the tip moves by what it was at the start and by the forces since (modes: `regeneration`),

    r(t) = Phi(t) z0 + integral of g(t - s) F(s) ds,      z1 = E z0 + integral of e^{A (T - s)} b F(s) ds,

with Phi, E and g exact exponentials, so that free flight costs nothing. F is smooth between the entry and the exit of a
tooth; on each such piece it is the Lagrange polynomial through n Gauss nodes, whose integrals against exponentials are
exact. With w what the force needs of r on the nodes (`cut_period`) and b the depth,

    w = Phi z0 - b Gamma (S0 w - S1 w_before),     z1 = E z0 - b V (S0 w - S1 w_before),

S0 = S1 = 1 where all pitches are equal. Solved for (w, z1) it is the map of (w_before, z0), whose eigenvalues mu say whether
a wave dies out. Gamma, Phi, E, V do not depend on the depth: one preparation serves all depths of a speed. A mode adds two
states and nothing else.

Eliminating z, mu is a multiplier at depth b where det(1 + b K(mu) (S0 - S1 / mu)) = 0 with K = Gamma + Phi (mu - E)^-1 V. So
all depths at which mu is a given number of the unit circle are eigenvalues of one small matrix: those of period doubling at
mu = -1 at once, all others by going round the circle (`all_crossings`).

Order: n = ceil(x / 2 + 5 + 2 log10(1e-3 / tolerance)) with x = (w / Omega + 2) L, L the longest piece and w the highest
frequency that matters, stiffened by the cut. It is a rule from experience, not a bound: of the random cases of the tests none
misses the tolerance.

What it leaves out: a tooth that loses contact, motion along z and twist, forces that change with the feed. Peers step through
the period (semi-discretization: Insperger, Stepan 2002 and 2011) and need tens to hundreds of times the work for the same
error; the error of their usual forty steps moves limits by up to a tenth.
"""

import math
from collections.abc import Callable

import numpy as np

from millcal.errors import IllPosedError
from millcal.physics.stability.cut_period import gauss_table, pieces_of, unknowns_of
from millcal.physics.stability.regeneration import Crossings, Regeneration, TipModes, chatter_frequency

TOLERANCE = 1e-4  # of |mu|
HIGHEST_ORDER = 160


def order_of(
    spindle_speed: np.ndarray, depth: np.ndarray | float, tip: TipModes, cut: Regeneration, tolerance: float = TOLERANCE
) -> np.ndarray:
    """Gauss nodes on each piece that hold |mu| to the tolerance.   spindle_speed : (n,) rad/s   depth : (n,) m

    returns integer (n,)
    raises IllPosedError where a tooth cuts through too many waves of the highest mode
    """
    speed, depth = np.broadcast_arrays(np.asarray(spindle_speed, float), np.asarray(depth, float))
    softness = 2 * np.sum(np.abs(tip.pole) * np.linalg.norm(tip.output, axis=1) * np.linalg.norm(tip.given, axis=1))
    stiffened = np.sqrt(np.max(np.abs(tip.pole)) ** 2 + depth * math.hypot(cut.ktc, cut.krc) * softness)
    longest = np.empty(speed.shape)
    for b in np.unique(depth) if cut.wind else (0.0,):
        longest[depth == b if cut.wind else ...] = pieces_of(cut, float(b)).length.max()
    waves = (stiffened / speed + 2) * longest
    order = np.ceil(waves / 2 + 5 + 2 * np.log10(1e-3 / tolerance)).astype(int)
    if np.any(order > HIGHEST_ORDER):
        slowest = float(speed.flat[int(np.argmax(order))]) * 60 / (2 * math.pi)
        raise IllPosedError(
            f"stability.rpm: at {slowest:.0f} rpm a tooth cuts through {waves.max() / 6.3:.0f} waves of the highest mode, too many for "
            "floquet; begin the map at a higher speed, or use zoa, which is good where so many lobes crowd"
        )
    return np.maximum(order, 3)


def problem_of(tip: TipModes, cut: Regeneration, depth: float, order: int):
    """The `Problem` of `floquet_kernel`; the depth counts with a helix alone, whose columns hold it."""
    from millcal.physics.stability.floquet_kernel import Problem

    pieces = pieces_of(cut, depth)
    unknowns = unknowns_of(pieces, tip, cut, depth, order)
    node, inner, weight = gauss_table(order)
    direct = 2 * np.real(np.einsum("mi,mj->ij", tip.output, tip.given))
    size = 2 * np.sum(np.linalg.norm(tip.output, axis=1) * np.linalg.norm(tip.given, axis=1))
    direct = np.where(np.abs(direct) > 1e-9 * size, direct, 0.0)
    return Problem(
        pole=np.ascontiguousarray(tip.pole, complex),
        output=np.ascontiguousarray(tip.output, complex),
        given=np.ascontiguousarray(tip.given, complex),
        flexibility=np.ascontiguousarray(tip.flexibility, float),
        direct=direct,
        period=pieces.period,
        start=pieces.start,
        length=pieces.length,
        node=node,
        inner=inner,
        weight=weight,
        **unknowns._asdict(),
    )


def multipliers(
    spindle_speed: float,
    depth: float,
    tip: TipModes,
    cut: Regeneration,
    *,
    order: int | None = None,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """Multipliers of one point, largest first: per tooth period, with unequal pitch per revolution.

    spindle_speed : rad/s   depth : m   returns complex (k,)
    """
    from millcal.physics.stability.floquet_kernel import multipliers_of

    order = order or int(order_of(np.array([spindle_speed]), depth, tip, cut, tolerance)[0])
    found = multipliers_of(
        problem_of(tip, cut, depth, order), float(spindle_speed), 1.0 if cut.wind and depth else float(depth)
    )
    return found[np.argsort(-np.abs(found), kind="stable")]


def spectral_radius(
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    order: int | None = None,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """The largest |mu| of many points: below 1 the cut is stable.   spindle_speed, depth : (n,) rad/s, m   returns (n,)"""
    from millcal.physics.stability.floquet_kernel import radii

    speed, depth = np.broadcast_arrays(np.asarray(spindle_speed, float), np.asarray(depth, float))
    found = np.empty(speed.shape)

    def run(problem, chosen: np.ndarray, depth: np.ndarray) -> None:
        out = np.empty(len(chosen))
        radii(problem, np.ascontiguousarray(speed[chosen]), depth, out)
        found[chosen] = out

    _grouped(speed, depth, tip, cut, order, tolerance, run)
    return found


def _grouped(
    speed: np.ndarray,
    depth: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    order: int | None,
    tolerance: float,
    run: Callable,
) -> None:
    """Call `run(problem, points, depths)` for each order, and with a helix for each depth."""
    orders = np.full(len(speed), order) if order else order_of(speed, depth, tip, cut, tolerance)
    for n in np.unique(orders):
        chosen = np.flatnonzero(orders == n)
        if not cut.wind:
            run(problem_of(tip, cut, 0.0, int(n)), chosen, np.ascontiguousarray(depth[chosen]))
            continue
        for b in np.unique(depth[chosen]):
            those = chosen[depth[chosen] == b]
            run(problem_of(tip, cut, float(b), int(n)), those, np.full(len(those), 1.0 if b else 0.0))
