"""Crossings of milling straight from a receptance matrix on lines: no modes, flip lobes included, cross terms and all.

The motion is e^{j w t} times something that repeats with the teeth, w = theta / T. A force in cut
F(t) = -b H(t) (1 - e^{-j theta}) r(t) answers at the frequencies v_k = (theta + 2 pi k) / T, and

    r(t) = -b (1 - e^{-j theta}) sum over k of e^{j v_k t} G(v_k) (1/T) integral over the cut of e^{-j v_k s} H(s) r(s) ds.

Budak, Altintas and Hill write this for the harmonics of r: a matrix as large as the band has harmonics. Here it is written for
r in the cut alone, where it is a smooth function: a polynomial through n Gauss nodes on each piece between entries and
leavings of teeth, whose integral against e^{-j v s} is exact to rounding. The matrix stays as small as the cut is short,
however many harmonics there are. Where one tooth cuts, the chip C . r is the unknown, one on each node; where several cut
together, the components of r. That is det(1 + b M(theta)) = 0 of `circle_sweep`, with M independent of b.

The harmonics are an even number, k = -K .. K - 1: then at theta = pi they come in pairs of opposite frequency and M is real.
With an odd number, which looks more natural, it is not, and every flip is lost without a word.

Time counts in periods of the teeth, so that of all that is needed only G(v_k) depends on the spindle speed.

References
----------
Budak, Altintas 1998, Analytical prediction of chatter stability in milling, part I, J. Dyn. Syst. Meas. Control 120.
Merdol, Altintas 2004, Multi frequency solution of chatter stability for low immersion milling, J. Manuf. Sci. Eng. 126.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from millcal.errors import IllPosedError
from millcal.numerics.circle_sweep import circle_crossings, first_angles
from millcal.physics.stability.cut_period import lagrange, nodes_of, pieces_of
from millcal.physics.stability.measured_receptance import Receptance, receptance_of_lines, resonances
from millcal.physics.stability.regeneration import FLIP, FOLD, HOPF, Crossings, Regeneration, h0

TAKES_PART = 1.0  # a line takes part where the deepest cut is as stiff as the tip there,
MAY_CROSS = 0.3  # and a resonance is looked at where its eigenvalue comes that near to a crossing
BESIDE = 3.0  # half widths beside a resonance at which the sweep looks as well as at its peak
HIGHEST_ORDER = 160  # nodes on a piece: a matrix above that takes seconds for a speed


@dataclass(frozen=True, eq=False)
class CutBasis:
    """The unknowns of a cut: nodes within a tooth period, and how each reads the motion and makes a force."""

    node: np.ndarray  # (node,) share of the tooth period
    of: np.ndarray  # integer (unknown,): its node
    reads: np.ndarray  # (unknown, 2): unknown = reads . r
    forces: np.ndarray  # (unknown, 2) N/m^2: H r = sum of forces x unknown
    point: np.ndarray  # of the integrals, (point,) share of the tooth period
    weight: np.ndarray  # (point, node): polynomial of the node times the weight of the point
    harmonic: np.ndarray  # k, (harmonic,)
    forward: np.ndarray  # e^{2 pi j k x} of the nodes, complex (harmonic, node)
    backward: np.ndarray  # e^{-2 pi j k x} of the points, complex (harmonic, point)

    def tables(self, angle: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
        """e^{j v t} on the nodes, and integrals of their polynomials against e^{-j v t}, for k = -most .. most - 1.

        angle : (t,) rad   returns 2 x complex (t, harmonic, node)
        """
        middle = len(self.harmonic) // 2
        kept = slice(middle - most, middle + most)
        first = first_angles()
        place = np.minimum(np.searchsorted(first, angle), len(first) - 1)
        known = first[place] == angle
        if not known.any():
            return self._tables(angle, kept)
        out, back = (table[place, kept] for table in self._first_tables)
        if not known.all():
            out[~known], back[~known] = self._tables(angle[~known], kept)
        return out, back

    @cached_property
    def _first_tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Those of the angles with which every sweep begins: they do not depend on the speed."""
        return self._tables(first_angles(), slice(None))

    def _tables(self, angle: np.ndarray, kept: slice) -> tuple[np.ndarray, np.ndarray]:
        turn = 1j * angle[:, np.newaxis]
        out = np.exp(turn * self.node)[:, np.newaxis] * self.forward[kept]
        seen = np.exp(-turn * self.point)[:, np.newaxis] * self.backward[kept]
        return out, seen @ self.weight


def cut_basis(cut: Regeneration, order: int, most: int, moves: tuple[int, ...] = (0, 1)) -> CutBasis:
    """order : nodes on a piece   most : K of the harmonics -K .. K - 1   moves : axes along which the tip can move"""
    pieces, pitch = pieces_of(cut, 0.0), 2 * np.pi / cut.teeth
    harmonics = np.arange(-most, most)
    count = 8 * int(np.ceil((order + np.pi * (most + 1) * pieces.length.max() / pitch + 24) / 16))
    unit_node, unit_point, unit_weight = _unit_tables(order, count)
    n = len(pieces.start)
    weight = np.zeros((n * count, n * order))
    node, point, of, reads, forces = [], [], [], [], []
    for i, (start, length, teeth) in enumerate(zip(pieces.start, pieces.length, pieces.teeth, strict=True)):
        share = length / pitch
        node.append(start / pitch + share * unit_node)
        point.append(start / pitch + share * unit_point)
        weight[i * count : (i + 1) * count, i * order : (i + 1) * order] = share * unit_weight
        angle = cut.entry + pitch * (node[i][:, np.newaxis] + np.array(teeth))
        matrix = h0(angle, cut.ktc, cut.krc).sum(axis=1)  # (node, 2, 2)
        if len(teeth) == 1 and len(moves) == 2:
            chip = np.stack([np.sin(angle[:, 0]), np.cos(angle[:, 0])], axis=-1)
            of.append(i * order + np.arange(order))
            reads.append(chip)
            forces.append(np.einsum("nij,nj->ni", matrix, chip))  # H0 C = B, for C . C = 1
        else:
            of.append(i * order + np.repeat(np.arange(order), len(moves)))
            reads.append(np.tile(np.eye(2)[list(moves)], (order, 1)))
            forces.append(matrix[:, :, list(moves)].transpose(0, 2, 1).reshape(-1, 2))
    nodes, points = np.concatenate(node), np.concatenate(point)
    turn = 2j * np.pi * harmonics[:, np.newaxis]
    return CutBasis(
        node=nodes,
        of=np.concatenate(of),
        reads=np.concatenate(reads),
        forces=np.concatenate(forces),
        point=points,
        weight=weight,
        harmonic=harmonics,
        forward=np.exp(turn * nodes),
        backward=np.exp(-turn * points),
    )


@lru_cache(maxsize=256)
def _unit_tables(order: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and points on 0..1, and the polynomials at the points times their weights.   returns (n,), (q,), (q, n)"""
    (x, _), (u, w) = np.polynomial.legendre.leggauss(order), np.polynomial.legendre.leggauss(count)
    node, point = (x + 1) / 2, (u + 1) / 2
    return node, point, lagrange(node, point) * (w / 2)[:, np.newaxis]


def circle_matrix(angle: np.ndarray, basis: CutBasis, receptance: Receptance, period: float) -> np.ndarray:
    """M(theta).   angle : theta, (t,) rad   period : of the teeth, s   returns complex (t, unknown, unknown) 1/m"""
    most = harmonics_within(receptance, period)
    turn = angle[:, np.newaxis] / (2 * np.pi) + np.arange(-most, most)
    matrix = receptance.at(turn / period)  # (t, harmonic, 2, 2)
    out, back = basis.tables(angle, most)
    total = np.zeros((len(angle), len(basis.of), len(basis.of)), complex)
    for a, b in np.ndindex(2, 2):
        entry = matrix[:, :, a, b]
        if entry.any():
            between = np.matmul((out * entry[:, :, np.newaxis]).transpose(0, 2, 1), back)  # (t, node, node)
            total += np.outer(basis.reads[:, a], basis.forces[:, b]) * between[:, basis.of][:, :, basis.of]
    return (1 - np.exp(-1j * angle))[:, np.newaxis, np.newaxis] * total


@dataclass(frozen=True, eq=False)
class MeasuredCut:
    """A cut with a measured tip, and how finely it is to be written down."""

    receptance: Receptance
    cut: Regeneration
    deepest: float  # m
    moves: tuple[int, ...]  # axes along which the tip can move
    highest: float  # Hz, that takes part
    resonance: np.ndarray  # (resonance, 3) Hz, as `resonances` has them
    order: int | None  # nodes on a piece, where given
    tolerance: float

    def period(self, spindle_speed: float) -> float:
        """Of the teeth, s.   spindle_speed : rad/s"""
        return 2 * np.pi / (self.cut.teeth * spindle_speed)

    def resonant_angles(self, period: float) -> np.ndarray:
        """theta about which the resonances stand: where many waves of the tip pass between two teeth the circle is long
        for them, where the teeth pass faster than the tip swings a step of the sweep holds a whole resonance.

        period : s   returns (angle,) rad, 0 to pi
        """
        low, peak, high = self.resonance.T
        near = np.concatenate([peak, peak - BESIDE * (peak - low), peak + BESIDE * (high - peak)])
        return np.abs(np.angle(np.exp(2j * np.pi * near * period)))

    def order_at(self, spindle_speed: float) -> int:
        """Nodes on a piece, by the rule measured for the Floquet solution (`floquet.order_of`).   spindle_speed : rad/s"""
        if self.order is not None:
            return self.order
        longest = float(pieces_of(self.cut, 0.0).length.max())
        waves = (2 * np.pi * self.highest / spindle_speed + 2) * longest
        order = int(nodes_of(waves, self.tolerance))
        if order > HIGHEST_ORDER:
            rpm = spindle_speed * 30 / np.pi
            raise IllPosedError(
                f"a tooth at {rpm:.0f} 1/min cuts through {waves / 2 / np.pi:.0f} waves of {self.highest:.0f} Hz, more than the "
                "cut basis holds; begin at a higher speed, or take zoa, which in an interrupted cut may be too deep"
            )
        return order

    def bases(self, spindle_speed: np.ndarray) -> Iterator[tuple[np.ndarray, CutBasis]]:
        """Speeds that share a basis, by index, and the basis.   spindle_speed : (speed,) rad/s"""
        order = np.array([self.order_at(speed) for speed in spindle_speed.tolist()], int)
        coarse = np.maximum(order // 12, 1)  # a node more in a dozen is no cost, a basis more is
        shared = coarse * -(-order // coarse) if self.order is None else order
        for nodes in np.unique(shared).tolist():
            those = np.flatnonzero(shared == nodes)
            period = self.period(float(spindle_speed[those].min()))
            yield those, cut_basis(self.cut, nodes, harmonics_within(self.receptance, period), self.moves)


def harmonics_within(receptance: Receptance, period: float) -> int:
    """K, so that the harmonics -K .. K - 1 hold all that answers, for every theta.   period : s"""
    return int(np.ceil(receptance.reach * period)) + 1


def measured_cut(
    frequency: np.ndarray,
    values: np.ndarray,
    cut: Regeneration,
    *,
    deepest: float,
    order: int | None = None,
    tolerance: float = 1e-4,
) -> MeasuredCut:
    """frequency : (line,) Hz, ascending, > 0   values : complex (line, 2, 2) m/N   deepest : m

    Raises ValueError for unequal pitch, helix and process damping, which the form does not hold.
    """
    if not cut.equal_pitch or cut.wind or cut.indentation:
        raise ValueError("crossings from a receptance need equal pitch, no helix and no process damping")
    values = np.asarray(values, complex)
    moves = tuple(axis for axis in (0, 1) if values[:, axis].any() or values[:, :, axis].any())
    stiffness = np.linalg.norm(values, axis=(1, 2)) * np.hypot(cut.ktc, cut.krc) * deepest
    part = np.flatnonzero(stiffness >= TAKES_PART)
    highest = float(frequency[part[-1]] if len(part) else frequency[0])
    mean_stiffness = (
        2 * cut.in_cut * np.hypot(cut.ktc, cut.krc) * deepest
    )  # no eigenvalue is larger than this times |G|
    peaks = resonances(frequency, values, MAY_CROSS / mean_stiffness)
    return MeasuredCut(receptance_of_lines(frequency, values), cut, deepest, moves, highest, peaks, order, tolerance)


def crossings_of_receptance(
    spindle_speed: np.ndarray,
    frequency: np.ndarray,
    values: np.ndarray,
    cut: Regeneration,
    *,
    deepest: float,
    order: int | None = None,
    tolerance: float = 1e-4,
    progress: Callable[[float], None] | None = None,
) -> Crossings:
    """All depths up to the deepest at which a multiplier crosses the unit circle, from a receptance matrix on lines.

    spindle_speed : (speed,) rad/s   frequency : (line,) Hz, ascending, > 0   values : complex (line, output, input) m/N
    deepest : m   order : nodes on a piece of the cut; None: by the rule   tolerance : of |mu|, for the rule

    Raises IllPosedError where the cut holds too many waves, ValueError for unequal pitch, helix and process damping.
    """
    problem = measured_cut(frequency, values, cut, deepest=deepest, order=order, tolerance=tolerance)
    speeds = np.asarray(spindle_speed, float)
    parts: list[Crossings] = []
    for those, basis in problem.bases(speeds):
        for i in those.tolist():
            if progress is not None:
                progress(len(parts) / len(speeds))
            parts.append(crossings_at(problem, float(speeds[i]), basis, i)[0])
    return one_behind_the_other(parts)


def crossings_at(
    problem: MeasuredCut, spindle_speed: float, basis: CutBasis, index: int
) -> tuple[Crossings, np.ndarray]:
    """Crossings of one speed, under its index, and their theta.   spindle_speed : rad/s"""
    period = problem.period(spindle_speed)
    found = circle_crossings(
        lambda angle: circle_matrix(angle, basis, problem.receptance, period),
        problem.deepest,
        extra=problem.resonant_angles(period),
    )
    kind = np.select([found.angle == np.pi, found.angle == 0], [FLIP, FOLD], HOPF)
    chatter = loudest(found.angle, found.factor, problem, basis, period)
    return Crossings(np.full(len(kind), index), found.factor, kind, chatter, found.rising), found.angle


def one_behind_the_other(parts: list[Crossings]) -> Crossings:
    """Crossings of many speeds, each under its index, as one."""
    none = Crossings(np.empty(0, int), np.empty(0), np.empty(0, int), np.empty(0), np.empty(0, bool))
    ascending = sorted(parts, key=lambda part: int(part.speed[0]) if len(part.speed) else -1)
    return Crossings(*(np.concatenate(part) for part in zip(none, *ascending, strict=True)))


def loudest(angle: np.ndarray, depth: np.ndarray, problem: MeasuredCut, basis: CutBasis, period: float) -> np.ndarray:
    """Of the frequencies |theta + 2 pi k| / (2 pi T) the one at which the tip moves most, by the eigenvector.

    angle : theta of crossings, (n,) rad   depth : (n,) m   returns (n,) Hz
    """
    if not len(angle):
        return np.empty(0)
    most = harmonics_within(problem.receptance, period)
    frequency = (angle[:, np.newaxis] / (2 * np.pi) + np.arange(-most, most)) / period
    loop = circle_matrix(angle, basis, problem.receptance, period)
    unit = (1 + 1e-12j) * np.eye(len(basis.of))  # beside the pole, not on it
    begin = np.cos(1.0 + np.arange(len(basis.of)) ** 2)  # any vector that no mode is at right angles to
    unknown = np.linalg.solve(
        unit + depth[:, np.newaxis, np.newaxis] * loop, np.tile(begin, (len(angle), 1))[..., None]
    )
    back = basis.tables(angle, most)[1][:, :, basis.of]  # (n, harmonic, unknown)
    force = np.einsum("nku,nu,ui->nki", back, unknown[..., 0], basis.forces)
    motion = np.einsum("nkij,nkj->nki", problem.receptance.at(frequency), force)
    return np.abs(frequency[np.arange(len(angle)), np.argmax(np.linalg.norm(motion, axis=2), axis=1)])
