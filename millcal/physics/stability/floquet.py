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

With a helix, or where teeth of unequal pitch overlap, a period has many pieces: `by_pieces` walks through them instead.

Order: `cut_period.nodes_of`, with the phase x = (w / Omega + 2) L of the highest mode, stiffened by the cut, along the longest
piece L.

What it leaves out: a tooth that loses contact, motion along z and twist, forces that change with the feed. Peers step through
the period (semi-discretization: Insperger, Stepan 2002 and 2011) and need tens to hundreds of times the work for the same
error; the error of their usual forty steps moves limits by up to a tenth.
"""

import math
from collections.abc import Callable

import numpy as np

from millcal.errors import IllPosedError
from millcal.physics.stability import by_pieces
from millcal.physics.stability.cut_period import gauss_tables, nodes_of, orders_of, pieces_of, unknowns_of
from millcal.physics.stability.regeneration import (
    FLIP,
    FOLD,
    HOPF,
    Crossings,
    Regeneration,
    TipModes,
)

TOLERANCE = 1e-4  # of |mu|
HIGHEST_ORDER = 200
WOUND = 8  # samples of a column, at least, while the edge winds from one tooth to the next


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
    order = nodes_of(waves, tolerance)
    if np.any(order > HIGHEST_ORDER):
        at = int(np.argmax(order))
        rpm, mm = float(speed.flat[at]) * 60 / (2 * math.pi), float(depth.flat[at]) * 1e3
        raise IllPosedError(
            f"stability.rpm: at {rpm:.0f} rpm and {mm:.3g} mm a tooth cuts through {waves.max() / 6.3:.0f} waves, too many for "
            "floquet; begin the map at a higher speed, look less deep, or take zoa, which may be too deep in an interrupted cut"
        )
    return order


def problem_of(tip: TipModes, cut: Regeneration, depth: float, order: int):
    """The `Problem` of `floquet_kernel`; the depth counts with a helix alone, whose columns hold it."""
    from millcal.physics.stability.floquet_kernel import Problem

    pieces = pieces_of(cut, depth)
    orders = orders_of(pieces, order)
    table, node, inner, weight = gauss_tables(orders)
    unknowns = unknowns_of(pieces, tip, cut, depth, orders)
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
        order=orders,
        table=table,
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

    if by_pieces.suits(cut):
        found = by_pieces.all_multipliers(float(spindle_speed), float(depth), tip, cut, order, tolerance)
    else:
        order = order or int(order_of(np.array([spindle_speed]), depth, tip, cut, tolerance)[0])
        by = 1.0 if cut.wind and depth else float(depth)
        found = multipliers_of(problem_of(tip, cut, depth, order), float(spindle_speed), by)
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
    if by_pieces.suits(cut):
        return np.abs(by_pieces.largest_multipliers(speed, depth, tip, cut, order, tolerance)[:, 0])
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
    order: int | np.ndarray | None,
    tolerance: float,
    run: Callable,
) -> None:
    """Call `run(problem, points, depths)` for each order, and with a helix for each depth."""
    orders = order_of(speed, depth, tip, cut, tolerance) if order is None else np.broadcast_to(order, speed.shape)
    for n in np.unique(orders):
        chosen = np.flatnonzero(orders == n)
        if not cut.wind:
            run(problem_of(tip, cut, 0.0, int(n)), chosen, np.ascontiguousarray(depth[chosen]))
            continue
        for b in np.unique(depth[chosen]):
            those = chosen[depth[chosen] == b]
            run(problem_of(tip, cut, float(b), int(n)), those, np.full(len(those), 1.0 if b else 0.0))


def radius_map(
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    order: int | None = None,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """The largest |mu| on a grid; each speed is prepared once.   spindle_speed : (s,)   depth : (d,)   returns (d, s)"""
    speed, depth = np.asarray(spindle_speed, float), np.asarray(depth, float)
    if order is None and not (cut.wind or by_pieces.suits(cut)):
        # one order for a speed, so that all its depths share what was prepared
        orders = order_of(speed, float(depth.max()), tip, cut, tolerance)
        found = np.empty((len(speed), len(depth)))
        for n in np.unique(orders):
            those = speed[orders == n]
            points = np.repeat(those, len(depth)), np.tile(depth, len(those))
            found[orders == n] = spectral_radius(*points, tip, cut, order=int(n)).reshape(len(those), len(depth))
        return found.T
    points = np.repeat(speed, len(depth)), np.tile(depth, len(speed))
    return spectral_radius(*points, tip, cut, order=order, tolerance=tolerance).reshape(len(speed), len(depth)).T


def flip_depths(
    spindle_speed: float, tip: TipModes, cut: Regeneration, *, deepest: float, order: int | None = None
) -> np.ndarray:
    """All depths at which a multiplier is -1 (period doubling), from one eigenvalue problem.   returns (k,) m, ascending

    raises ValueError with a helix, whose matrix depends on the depth
    """
    speed = np.array([float(spindle_speed)])
    if by_pieces.suits(cut) and not cut.wind:
        return by_pieces.Columns(speed, deepest, tip, cut, order, TOLERANCE).flips()[1]
    orders = np.array([order]) if order else order_of(speed, deepest, tip, cut)
    return _flips(speed, tip, cut, deepest, orders)[1]


def _flips(
    speed: np.ndarray, tip: TipModes, cut: Regeneration, deepest: float, orders: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths at which a multiplier is -1.   returns which speed (f,), depth (f,)"""
    from millcal.physics.stability.floquet_kernel import flips

    if cut.wind:
        raise ValueError("with a helix the matrix depends on the depth: the flips are no eigenvalues of one matrix")
    column, depth = [np.empty(0, int)], [np.empty(0)]
    for n in np.unique(orders):
        those = np.flatnonzero(orders == n)
        problem = problem_of(tip, cut, 0.0, int(n))
        found, count = np.empty((len(those), len(problem.piece))), np.empty(len(those), np.int64)
        flips(problem, np.ascontiguousarray(speed[those]), deepest, found, count)
        column.append(np.repeat(those, count))
        depth.append(found[np.arange(found.shape[1]) < count[:, np.newaxis]])
    return np.concatenate(column), np.concatenate(depth)


def boundary(
    spindle_speed: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    deepest: float,
    depths: int = 16,
    order: int | None = None,
    tolerance: float = TOLERANCE,
    depth_tolerance: float = 1e-9,
    heard: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Crossings:
    """All crossings of the unit circle up to a depth, column by column (`columns`); the crossings of every multiplier.

    Of equal orders a column holds tens of eigenvalue problems instead of a hundred pixels, and returns depths and kinds. A
    pocket between two samples that no bulge betrays is missed; `all_crossings` does not scan. Where a period multiplies waves by a
    million, to the end of the column, no further crossings are told.

    spindle_speed : (s,) rad/s   deepest : m   depths : samples of a column, with a helix more if it winds far
    depth_tolerance : m   heard : whether to find the chatter frequencies, else nan
    """
    from millcal.physics.stability.columns import crossings_in_columns

    speed = np.asarray(spindle_speed, float)
    orders = np.full(len(speed), order) if order else order_of(speed, deepest, tip, cut, tolerance)
    model: _Multipliers | by_pieces.Columns
    if by_pieces.suits(cut):
        model = by_pieces.Columns(speed, deepest, tip, cut, order, tolerance, progress)
        known = (np.empty(0, int), np.empty(0)) if cut.wind else model.flips()
    else:
        known = (np.empty(0, int), np.empty(0)) if cut.wind else _flips(speed, tip, cut, deepest, orders)
        model = _Multipliers(speed, orders, tip, cut, progress)
    depths = max(depths, math.ceil(WOUND * deepest * abs(cut.wind) * cut.teeth / (2 * math.pi)))
    found = crossings_in_columns(model, len(speed), deepest, depths, known, depth_tolerance)
    if not heard:
        return Crossings(found.column, found.depth, found.kind, np.full(len(found.depth), np.nan), found.loses)
    if isinstance(model, by_pieces.Columns):
        frequency = model.frequencies(found.column, found.depth, found.multiplier)
        return Crossings(found.column, found.depth, found.kind, frequency, found.loses)
    return _crossings(speed, found.column, found.depth, found.kind, found.multiplier, found.loses, tip, cut, orders)


def all_crossings(
    spindle_speed: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    deepest: float,
    order: int | None = None,
    tolerance: float = TOLERANCE,
    steps: int = 32,
    progress: Callable[[float], None] | None = None,
) -> Crossings:
    """All crossings of the unit circle up to a depth by going round it (`numerics.circle_sweep`): no scan of the depth.

    A check of `boundary` that misses no pocket of depth, at some ten times its cost.

    spindle_speed : (s,) rad/s   deepest : m   steps : angles to begin with, on half a circle
    raises ValueError with a helix, whose matrix depends on the depth
    """
    from millcal.numerics.circle_sweep import circle_crossings
    from millcal.physics.stability.floquet_kernel import matrices

    if cut.wind:
        raise ValueError("with a helix the matrix depends on the depth: crossings are no eigenvalues of one matrix")
    speed = np.asarray(spindle_speed, float)
    orders = np.full(len(speed), order) if order else order_of(speed, deepest, tip, cut, tolerance)
    parts = []
    problems = {n: problem_of(tip, cut, 0.0, n) for n in np.unique(orders).tolist()}
    for i, (omega, n) in enumerate(zip(speed, orders.tolist(), strict=True)):
        if progress is not None:
            progress(i / len(speed))
        gamma, phi, evolution, feed = matrices(problems[n], float(omega))
        now, before = problems[n].now, np.zeros_like(gamma)
        before[:, problems[n].memory] = problems[n].before

        def loop(angle: np.ndarray, gamma=gamma, phi=phi, evolution=evolution, feed=feed, now=now, before=before):
            mu = np.exp(1j * angle)[:, np.newaxis, np.newaxis]
            carried = np.linalg.solve(mu * np.eye(len(evolution)) - evolution, feed[np.newaxis].astype(complex))
            return (gamma + phi @ carried) @ (now - before / mu)

        natural = np.angle(np.exp(tip.pole * (problems[n].period / omega)))
        found = circle_crossings(loop, deepest, steps=steps, extra=np.abs(natural))
        at_end = np.where(found.angle == 0, FOLD, FLIP)
        kind = np.where((found.angle == 0) | (found.angle == np.pi), at_end, HOPF)
        parts.append((np.full(len(kind), i), found.factor, kind, np.exp(1j * found.angle), found.rising))
    column, depth, kind, multiplier, loses = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _crossings(speed, column, depth, kind, multiplier, loses, tip, cut, orders)


KEPT = 12  # multipliers of a point, largest first


class _Multipliers:
    """The largest multipliers of points in columns, each column at its own order."""

    def __init__(self, speed, orders, tip, cut, progress):
        self.speed, self.orders, self.tip, self.cut = speed, orders, tip, cut
        self.progress = progress or (lambda share: None)
        self.problems = {} if cut.wind else {n: problem_of(tip, cut, 0.0, int(n)) for n in np.unique(orders).tolist()}

    def __call__(self, column: np.ndarray, depth: np.ndarray) -> np.ndarray:
        from millcal.physics.stability.floquet_kernel import spectra

        found = np.empty((len(column), KEPT), complex)
        for n in np.unique(self.orders[column]).tolist():
            those = np.flatnonzero(self.orders[column] == n)
            if not self.cut.wind:
                those = those[np.argsort(column[those], kind="stable")]
                out = np.empty((len(those), KEPT), complex)
                spectra(self.problems[n], self.speed[column[those]], depth[those], KEPT, out)
                found[those] = out
                continue
            for b in np.unique(depth[those]):
                here = those[depth[those] == b]
                out = np.empty((len(here), KEPT), complex)
                force = np.full(len(here), 1.0 if b else 0.0)
                spectra(problem_of(self.tip, self.cut, float(b), n), self.speed[column[here]], force, KEPT, out)
                found[here] = out
        return found


def chatter_frequency(
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    multiplier: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    orders: np.ndarray | None = None,
) -> np.ndarray:
    """Of the aliases |arg(mu) / (2 pi T) + k / T| of multipliers the one at which the tip moves most, by its eigenvector.

    A multiplier tells a frequency up to whole numbers of the period. The nearest to the largest receptance, which is often
    taken, is another one in a fifth of the reference cases: what a mode does depends on what the cut feels of it.

    spindle_speed, depth : (n,) rad/s, m   multiplier : complex (n,)   orders : nodes, integer (n,); None: by the rule
    returns (n,) Hz
    """
    from millcal.physics.stability.floquet_kernel import loudest

    speed, depth = np.asarray(spindle_speed, float), np.asarray(depth, float)
    if by_pieces.suits(cut):
        return by_pieces.frequencies(speed, depth, np.asarray(multiplier, complex), tip, cut, TOLERANCE)
    found = np.empty(len(speed))

    def run(problem, chosen: np.ndarray, force: np.ndarray) -> None:
        out = np.empty(len(chosen))
        loudest(problem, np.ascontiguousarray(speed[chosen]), force, np.ascontiguousarray(multiplier[chosen]), out)
        found[chosen] = out

    _grouped(speed, depth, tip, cut, orders, TOLERANCE, run)
    return found


def _crossings(speed, column, depth, kind, multiplier, loses, tip, cut, orders) -> Crossings:
    frequency = chatter_frequency(speed[column], depth, multiplier, tip, cut, orders=orders[column])
    return Crossings(column, depth, kind, frequency, loses)
