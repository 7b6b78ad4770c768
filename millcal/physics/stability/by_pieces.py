"""Multipliers of cuts with a helix or unequal pitch, where many pieces follow one another: the method of `floquet`, step by step.

On each piece of the period the motion u of the tip follows from its modes y at the start and from the waves that teeth meet,

    u = free y - A (H u - h),     y_end = e^{s L} y - V (H u - h),     h = sum over teeth of H_j u(t - tau_j),

with A and V the integrals of the impulse response over polynomials through Gauss nodes, H the force against the motion, and
u(t - tau) read from the polynomial of the piece that made the wave. So the map of a period is never written down: it is a walk
through the pieces, at a cost that grows with the number of nodes and not with its cube, and Arnoldi's method finds its largest
eigenvalues, which are those that count. Three things make the walk cheap:

- Pieces of many waves are divided (`WAVES`): twice the nodes in one piece cost eight times as much, in two pieces twice.
- The impulse response is taken for a polynomial, too, so that A is a sum over tables of what polynomials do to each other in a
  convolution, one for each order, whatever the speed and the length.
- Where the pitches repeat within the revolution (85, 95, 85, 95 degrees) the period is that of the pattern. Its multipliers to the
  power of the repeats are those of the revolution, which is what is returned.

Process damping needs the velocity on the nodes and stays with `floquet_kernel`.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from millcal.physics.stability.cut_period import (
    STRAIGHT,
    _only_direction,
    delays_of,
    lagrange,
    pieces_of,
    pitches_of,
    unit_gauss,
)
from millcal.physics.stability.regeneration import Regeneration, TipModes

if TYPE_CHECKING:
    from millcal.physics.stability import by_pieces_kernel as kernel

WAVES = 16.0  # rad of the highest mode on one piece
FINE = 6  # nodes of the impulse response beyond those of the motion
HIGHEST = 48  # nodes of a piece
KEPT = 12  # multipliers of a point, largest first
FEWEST, MORE = 20, 6  # steps of Arnoldi's method before the first look, and at least to the next
MOST = 480
FLOOR = 0.3  # multipliers of which nothing needs to be known
SETTLED = 1e-8  # of |mu|, from one look to the next: the error is far less
ROUNDING = 1e-11  # of the largest, by which the smaller ones are not known
WITHIN = 1e-2  # of the way from a multiplier to 0.9, which need not be known so well


def suits(cut: Regeneration) -> bool:
    """Whether the cut is one for this module: a helix, or teeth of unequal pitch that overlap."""
    overlap = cut.leave - cut.entry > float(np.min(pitches_of(cut)))
    return not cut.indentation and (cut.wind != 0.0 or (overlap and not cut.equal_pitch))


@lru_cache(maxsize=1)
def _tables() -> "kernel.Tables":
    from millcal.physics.stability.by_pieces_kernel import Tables

    parts: tuple[list[np.ndarray], ...] = ([], [], [], [])  # nodes, their barycentric weights, fine nodes, weights
    node_at, fine_at, weight_at = (np.zeros(HIGHEST + 1, np.int64) for _ in range(3))
    for n in range(3, HIGHEST + 1):
        x, w = unit_gauss(n)
        node_at[n], fine_at[n], weight_at[n] = (sum(map(len, parts[k])) for k in (0, 2, 3))
        parts[0].append(x)
        parts[1].append((-1.0) ** np.arange(n) * np.sqrt((1 - (2 * x - 1) ** 2) * w))
        response = unit_gauss(n + FINE)[0]
        parts[2].append(response)
        inner, inner_weight = unit_gauss(n + FINE // 2)
        ends = np.append(x, 1.0)
        reach = np.multiply.outer(ends, inner)
        force = lagrange(x, reach.ravel()).reshape(n + 1, len(inner), n)
        answer = lagrange(response, (ends[:, np.newaxis] - reach).ravel()).reshape(n + 1, len(inner), n + FINE)
        parts[3].append(np.einsum("i,k,ikq,ikj->qij", ends, inner_weight, answer, force, optimize=True).ravel())
    node, bary, fine, weight = (np.concatenate(part) for part in parts)
    return Tables(node, bary, node_at, fine, fine_at, weight, weight_at, FINE)


def repeats_of(cut: Regeneration) -> int:
    """How often the pattern of the pitches repeats in a revolution."""
    pitch = pitches_of(cut)
    for teeth in range(1, cut.teeth):
        if cut.teeth % teeth == 0 and np.allclose(pitch, np.roll(pitch, teeth), rtol=0, atol=1e-9):
            return cut.teeth // teeth
    return 1


class Cut:
    """A cut and a tip, ready for points of any speed and depth."""

    def __init__(self, tip: TipModes, cut: Regeneration, *, whole: bool = False):
        """whole : a revolution in any case"""
        from millcal.physics.stability import by_pieces_kernel as kernel

        self.cut, self.modes = cut, tip
        self.repeats = 1 if whole or cut.equal_pitch else repeats_of(cut)
        teeth = 1 if cut.equal_pitch else cut.teeth // self.repeats
        pitch = pitches_of(cut)[:teeth]
        period = 2 * math.pi / cut.teeth if cut.equal_pitch else 2 * math.pi / self.repeats
        self.shape = kernel.Shape(
            period, np.concatenate([[0.0], np.cumsum(pitch)[:-1]]),
            np.array([period]) if teeth == 1 else delays_of(cut)[:teeth].copy(),
            cut.entry, cut.leave - cut.entry, cut.ktc, cut.krc, abs(cut.wind), STRAIGHT,
        )  # fmt: skip
        moves = _only_direction(np.concatenate([tip.output, tip.flexibility.T]))
        pushed = _only_direction(np.concatenate([tip.given, tip.flexibility]))
        rows = columns = np.eye(2)
        if moves is not None and pushed is not None:
            rows, columns = moves[np.newaxis], pushed[np.newaxis]
        size = np.linalg.norm(tip.output, axis=1)[:, np.newaxis]
        self.tip = kernel.Tip(
            np.ascontiguousarray(tip.pole, dtype=complex),
            np.ascontiguousarray(tip.output / size @ rows.T, dtype=complex),
            np.ascontiguousarray(2 * size * tip.given @ columns.T, dtype=complex),
            np.ascontiguousarray(rows @ tip.flexibility @ columns.T, dtype=float),
            np.ascontiguousarray(rows), np.ascontiguousarray(columns),
        )  # fmt: skip
        self._softness = 2 * np.sum(np.abs(tip.pole) * size[:, 0] * np.linalg.norm(tip.given, axis=1))
        self._laid: tuple[tuple[float, ...], kernel.Lay, kernel.Prepared] | None = None

    def rate(self, speed: float, depth: float) -> float:
        """Waves of the highest mode, stiffened by the cut, in rad per rad; see `floquet.order_of`."""
        cut = self.cut
        stiffened = math.hypot(
            np.max(np.abs(self.modes.pole)), math.sqrt(depth * math.hypot(cut.ktc, cut.krc) * self._softness)
        )
        return stiffened / speed + 2

    def decades(self, order: int, rate: float, depth: float) -> float:
        """That lead to an order on the longest piece by `cut_period.nodes_of`."""
        waves = rate * float(pieces_of(self.cut, depth).length.max())
        return min(max((order - waves / 2) / (0.25 + np.cbrt(waves) / 2), 1.0), 16.0)

    def at(self, speed: float, depth: float, rate: float, decades: float) -> "Period":
        """The period of one point."""
        from millcal.physics.stability import by_pieces_kernel as kernel

        tables, winds = _tables(), self.shape.wind > 0
        key = (speed, depth if winds else 0.0, rate, decades)
        if self._laid is None or self._laid[0] != key:
            lay = kernel.lay(self.shape, self.tip, tables, depth, rate, decades, WAVES)
            self._laid = key, lay, kernel.prepare(lay, self.shape, self.tip, tables, speed)
        return Period(self, speed, *self._laid[1:], (1.0 if depth else 0.0) if winds else depth)


class Period:
    """The map of one period at one point."""

    def __init__(self, cut: Cut, speed: float, lay: "kernel.Lay", prepared: "kernel.Prepared", depth: float):
        from millcal.physics.stability.by_pieces_kernel import solve

        self.cut, self.speed, self.lay, self.prepared, self.depth = cut, speed, lay, prepared, depth
        self.answer = solve(lay, prepared, cut.tip, depth)
        self.size = int(lay.first[-1] - lay.first[lay.kept]) + 2 * len(cut.tip.pole)

    def through(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state a period later, and the force on the way, per direction and node as `by_pieces_kernel` has them."""
        from millcal.physics.stability.by_pieces_kernel import pass_through

        state, motion, pushed = np.array(state, float), np.empty(self.lay.first[-1]), np.empty(self.lay.first[-1])
        pass_through(self.lay, self.prepared, self.answer, self.cut.tip, self.depth, state, motion, pushed)
        return state, pushed

    def flips(self, deepest: float) -> np.ndarray:
        """Depths at which a multiplier of the period is -1, of straight edges.   returns (k,) m, ascending

        A motion u that changes its sign from period to period makes forces H u - h, and these, each per depth, a motion w of the
        same kind; where w = - u / b, b is such a depth. Arnoldi's method on the map from u to w.
        """
        from millcal.physics.stability.by_pieces_kernel import answer_to

        count, least = int(self.lay.first[-1]), 1 / deepest
        most = min(count, MOST)
        basis, hessenberg = np.zeros((most + 1, count)), np.zeros((most + 1, most))
        start = np.cos(1.0 + np.arange(count) ** 2)
        basis[0] = start / np.linalg.norm(start)
        before, check = np.empty(0), FEWEST
        for k in range(most):
            new = np.empty(count)
            answer_to(self.lay, self.prepared, self.cut.tip, basis[k], new)
            size = np.linalg.norm(new)
            for _ in range(2):
                along = basis[: k + 1] @ new
                new -= along @ basis[: k + 1]
                hessenberg[: k + 1, k] += along
            left = np.linalg.norm(new)
            last = not left > 1e-14 * size or k + 1 == most
            if not last:
                hessenberg[k + 1, k] = left
                basis[k + 1] = new / left
            if last or k + 1 == check:
                found = _largest(hessenberg[: k + 1, : k + 1], k + 1)
                found = found[np.abs(found) >= 0.9 * least]
                if last or (k >= FEWEST and _alike(before, found)):
                    break
                before, check = found, check + max(MORE, check // 4)
        flips = found.real[(found.imag == 0) & (found.real < 0) & (-found.real >= least)]
        return np.sort(-1 / flips)

    def matrix(self) -> np.ndarray:
        """The map, written down.   returns (state, state)"""
        return np.stack([self.through(row)[0] for row in np.eye(self.size)], axis=1)

    def largest(self, keep: int) -> np.ndarray:
        """The largest multipliers of a revolution (of equal pitch: of a tooth), largest first.   returns complex (keep,)"""
        return self._krylov(keep)[0]

    def loudest(self, multiplier: complex) -> float:
        """`floquet.chatter_frequency` of one of the largest multipliers, by its motion over the period, Hz."""
        _, basis, hessenberg = self._krylov(KEPT)
        value, vector = np.linalg.eig(hessenberg)
        nearest = int(np.argmin(np.abs(value**self.cut.repeats - multiplier)))
        time = self.cut.shape.period / self.speed
        if not 0.0 < abs(value[nearest]) < np.inf:  # lost beside much larger ones: the lowest alias
            return float(abs(np.angle(multiplier))) / (2 * math.pi * time * self.cut.repeats)
        state = vector[:, nearest] @ basis
        pushed = self.through(state.real)[1] + 1j * self.through(state.imag)[1]
        lay, size = self.lay, len(self.cut.tip.rows)
        angle, force = [], []
        for p, n in enumerate(lay.order.tolist()):
            node, weight = unit_gauss(n)
            angle.append(lay.start[p] + lay.length[p] * node)
            force.append(pushed[lay.first[p] : lay.first[p + 1]].reshape(size, n) * (weight * lay.length[p]))
        modes = self.cut.modes
        reach = math.ceil(1.5 * float(np.abs(modes.pole).max()) * time / (2 * math.pi)) + 2
        s = np.log(value[nearest]) / time + 2j * math.pi * np.arange(-reach, reach + 1) / time
        wave = np.exp(-s[:, np.newaxis] * np.concatenate(angle) / self.speed)
        push = wave @ np.concatenate(force, axis=1).T @ self.cut.tip.columns  # (frequency, 2)
        motion = push @ modes.flexibility.T + 0j
        for pole, output, given in (
            (modes.pole, modes.output, modes.given),
            (modes.pole.conj(), modes.output.conj(), modes.given.conj()),
        ):
            motion += (push @ given.T / (s[:, np.newaxis] - pole)) @ output
        return float(abs(s[np.argmax(np.sum(np.abs(motion) ** 2, axis=1))].imag) / (2 * math.pi))

    def _krylov(self, keep: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """returns multipliers (keep,), basis (step, state), Hessenberg matrix (step, step)"""
        from millcal.physics.stability.by_pieces_kernel import krylov

        most = min(self.size, MOST)
        room = min(most, 64)
        basis, hessenberg = np.zeros((room + 1, self.size)), np.zeros((room + 1, room))
        start = np.cos(1.0 + np.arange(self.size) ** 2)
        basis[0] = start / np.linalg.norm(start)
        done, before = 0, np.empty(0)
        wanted = min(FEWEST, most)
        while True:
            if wanted > room:
                basis = np.concatenate([basis, np.zeros((room, self.size))])
                hessenberg = np.pad(hessenberg, ((0, room), (0, room)))
                room *= 2
            reached = krylov(
                self.lay, self.prepared, self.answer, self.cut.tip, self.depth, basis, hessenberg, done, wanted
            )
            found = _largest(hessenberg[:reached, :reached], keep) ** self.cut.repeats
            if reached < wanted or reached >= most or (done and _settled(before, found)):
                return found, basis[:reached], hessenberg[:reached, :reached]
            done, before = reached, found
            wanted = min(reached + max(MORE, reached // 4), most)


def _largest(matrix: np.ndarray, keep: int) -> np.ndarray:
    from millcal.physics.stability.floquet_kernel import _eigenvalues

    n = len(matrix)
    real, imag = np.empty(n), np.empty(n)
    _eigenvalues(matrix.copy(), n, real, imag)
    size = np.hypot(real, imag)
    size[np.isnan(size)] = np.inf
    top = np.argsort(-size, kind="stable")[:keep]
    found = np.zeros(keep, complex)
    found[: len(top)] = real[top] + 1j * imag[top]
    return found


def _alike(before: np.ndarray, now: np.ndarray) -> bool:
    return len(before) == len(now) and bool(np.all(np.abs(np.abs(now) - np.abs(before)) < 1e-10 * np.abs(now)))


def _settled(before: np.ndarray, now: np.ndarray) -> bool:
    """Whether more steps change what counts: the largest, and less the farther within the circle, the others."""
    size, change = np.abs(now), np.abs(np.abs(now) - np.abs(before))
    room = SETTLED * np.maximum(size, 1.0) + WITHIN * np.maximum(0.9 - size, 0.0) + ROUNDING * size[0]
    room[0] = SETTLED * size[0]
    return bool(np.all((change <= room) | (size < FLOOR)))


def all_multipliers(
    speed: float, depth: float, tip: TipModes, cut: Regeneration, order: int | None, tolerance: float
) -> np.ndarray:
    """Every multiplier of one point, by the matrix written down; see `floquet.multipliers`.   returns complex (k,), unsorted"""
    ready = Cut(tip, cut)
    rate = ready.rate(speed, depth)
    decades = -math.log10(tolerance) if order is None else ready.decades(order, rate, depth)
    return np.linalg.eigvals(ready.at(speed, depth, rate, decades).matrix()).astype(complex) ** ready.repeats


def largest_multipliers(
    speed: np.ndarray,
    depth: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    order: int | np.ndarray | None,
    tolerance: float,
    keep: int = 1,
) -> np.ndarray:
    """The largest multipliers of many points, largest first.   speed, depth : (n,)   returns complex (n, keep)"""
    ready = Cut(tip, cut)
    orders = np.broadcast_to(0 if order is None else order, speed.shape)
    found = np.empty((len(speed), keep), complex)
    for i, (omega, b, n) in enumerate(zip(speed.tolist(), depth.tolist(), orders.tolist(), strict=True)):
        rate = ready.rate(omega, b)
        decades = ready.decades(n, rate, b) if n else -math.log10(tolerance)
        found[i] = ready.at(omega, b, rate, decades).largest(keep)
    return found


def frequencies(
    speed: np.ndarray, depth: np.ndarray, multiplier: np.ndarray, tip: TipModes, cut: Regeneration, tolerance: float
) -> np.ndarray:
    """`floquet.chatter_frequency` of points with their multipliers.   (n,) each   returns (n,) Hz"""
    ready, found = Cut(tip, cut), np.empty(len(speed))
    for i, (omega, b, mu) in enumerate(zip(speed.tolist(), depth.tolist(), multiplier.tolist(), strict=True)):
        found[i] = ready.at(omega, b, ready.rate(omega, b), -math.log10(tolerance)).loudest(mu)
    return found


class Columns:
    """The largest multipliers of points in columns, for `columns.crossings_in_columns`: each at the order of its deepest point."""

    def __init__(
        self,
        speed: np.ndarray,
        deepest: float,
        tip: TipModes,
        cut: Regeneration,
        order: int | None,
        tolerance: float,
        progress: Callable[[float], None] | None = None,
    ):
        self.ready, self.speed, self.deepest = Cut(tip, cut), speed.tolist(), deepest
        self.progress = progress or (lambda share: None)
        self.rate = [self.ready.rate(omega, deepest) for omega in self.speed]
        decades = -math.log10(tolerance)
        self.decades = [self.ready.decades(order, rate, deepest) if order else decades for rate in self.rate]

    def __call__(self, column: np.ndarray, depth: np.ndarray) -> np.ndarray:
        found = np.empty((len(column), KEPT), complex)
        for done, i in enumerate(np.lexsort((depth, column)).tolist()):
            at = int(column[i])
            found[i] = self.ready.at(self.speed[at], float(depth[i]), self.rate[at], self.decades[at]).largest(KEPT)
            if at != int(column[0]):
                self.progress(done / len(column))
        self.progress = lambda share: None  # what follows the first samples is short
        return found

    def frequencies(self, column: np.ndarray, depth: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        """`floquet.chatter_frequency` of points and their multipliers.   column, depth, multiplier : (n,)   returns (n,) Hz"""
        found = np.empty(len(column))
        for i, (at, b, mu) in enumerate(zip(column.tolist(), depth.tolist(), multiplier.tolist(), strict=True)):
            found[i] = self.ready.at(self.speed[at], b, self.rate[at], self.decades[at]).loudest(mu)
        return found

    def flips(self) -> tuple[np.ndarray, np.ndarray]:
        """All depths at which a multiplier of the revolution is -1, of straight edges.   returns which speed (f,), depth (f,)"""
        whole = Cut(self.ready.modes, self.ready.cut, whole=True)
        column, depth = [np.empty(0, int)], [np.empty(0)]
        for i, omega in enumerate(self.speed):
            found = whole.at(omega, 0.0, self.rate[i], self.decades[i]).flips(self.deepest)
            column.append(np.full(len(found), i))
            depth.append(found)
        return np.concatenate(column), np.concatenate(depth)
