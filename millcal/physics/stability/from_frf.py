"""Crossings of milling straight from a receptance matrix on lines: no modes, flip lobes included, cross terms and all.

The motion is e^{j w t} times a period of the teeth, w = theta / T, so a force in cut f(t) = -b sum_j H_j(t) (1 - e^{-j theta}) r(t)
answers at the frequencies v_k = (theta + 2 pi k) / T, and

    r(t) = -b (1 - e^{-j theta}) sum_k e^{j v_k t} G(v_k) (1/T) integral over the cut of e^{-j v_k s} H(s) r(s) ds.

Budak, Altintas and Hill write this for the harmonics of r: a matrix as large as the band has harmonics, and the band must
reach beyond what takes part. Here it is written for r in the cut alone, where it is a smooth function: by Lagrange on n
Gauss nodes of each piece between entries and leavings of teeth, its integral against e^{-j v s} exact to rounding. The
matrix stays as small as the cut is short, however many harmonics there are. Where one tooth cuts, the chip C^T r is the
unknown, one for a node; where several cut together, both components of r. It has the form det(I + b M(theta)) = 0 of
`circle_sweep`, and M is independent of b.

The harmonics are an even number, k = -K .. K - 1: then at theta = pi they are pairs of opposite frequency and M is real. With
an odd number, which looks more natural, it is not, and every flip is lost without a word.

Time counts in periods of the teeth, so that of all that is needed only G(v_k) depends on the spindle speed.

References
----------
Budak, Altintas 1998, Analytical prediction of chatter stability in milling, part I, J. Dyn. Syst. Meas. Control 120.
Merdol, Altintas 2004, Multi frequency solution of chatter stability for low immersion milling, J. Manuf. Sci. Eng. 126.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from millcal.numerics.circle_sweep import circle_crossings
from millcal.physics.stability.regeneration import FLIP, FOLD, HOPF, Crossings, Regeneration, h0

STATIC_LINES = 5  # of the lowest, whose median real part is held below the first
TAKES_PART = 0.3  # a receptance takes part where, at the deepest cut, force per motion times it is at least this
LARGEST_ORDER = 160  # nodes in a piece


@dataclass(frozen=True, eq=False)
class Receptance:
    """G at any frequency from its lines: a cubic spline of the complex values, static below them, nothing above.

    A spline of 1/G would go through a lone resonance with far fewer lines, but where G is small it is the inverse of noise.
    """

    frequency: np.ndarray  # (line,) Hz, ascending, > 0
    values: np.ndarray  # complex (line, 2, 2) m/N
    spline: Callable[[np.ndarray], np.ndarray]
    static: np.ndarray  # (2, 2) m/N

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """G, for frequencies of either sign.   frequency : (...,) Hz   returns complex (..., 2, 2) m/N"""
        size = np.abs(frequency)
        matrix = np.zeros((*size.shape, 2, 2), complex)
        inside = (size >= self.frequency[0]) & (size <= self.frequency[-1])
        matrix[inside] = self.spline(size[inside])
        matrix[size < self.frequency[0]] = self.static
        return np.where((frequency < 0)[..., np.newaxis, np.newaxis], matrix.conj(), matrix)


def receptance_of_lines(frequency: np.ndarray, values: np.ndarray) -> Receptance:
    """frequency : (line,) Hz, ascending, > 0   values : complex (line, 2, 2) m/N"""
    from scipy.interpolate import CubicSpline

    frequency, values = np.asarray(frequency, float), np.asarray(values, complex)
    static = np.median(values[:STATIC_LINES].real, axis=0)
    return Receptance(frequency, values, CubicSpline(frequency, values), static)


@dataclass(frozen=True, eq=False)
class CutBasis:
    """The unknowns of a cut: nodes within a tooth period, and how each reads the motion and makes a force."""

    node: np.ndarray  # (node,) share of the tooth period
    of: np.ndarray  # integer (unknown,): its node
    reads: np.ndarray  # (unknown, 2): unknown = reads . r
    forces: np.ndarray  # (unknown, 2) N/m^2: H r = sum of forces x unknown
    quadrature: np.ndarray  # (point,) share of the tooth period
    lagrange: np.ndarray  # (point, node): polynomial of the node times the weight of the point
    forward: np.ndarray  # e^{2 pi j k x} of the nodes, complex (harmonic, node)
    backward: np.ndarray  # e^{-2 pi j k x} of the points, complex (harmonic, point)
    harmonic: np.ndarray  # k, (harmonic,)


def pieces_of_cut(cut: Regeneration) -> list[tuple[float, float, int]]:
    """Parts of a tooth period with the same teeth in cut.   returns from, to (shares of the period), teeth"""
    pitch = 2 * np.pi / cut.teeth
    whole = int((cut.leave - cut.entry) / pitch + 1e-9)
    rest = max((cut.leave - cut.entry) / pitch - whole, 0.0)
    pieces = [(0.0, rest, whole + 1)] if rest > 1e-9 else []
    return [*pieces, (rest if pieces else 0.0, 1.0, whole)] if whole else pieces


def order_of_cut(cut: Regeneration, spindle_speed: float, highest: float, tolerance: float = 1e-4) -> int:
    """Nodes in a piece, by the rule measured for the Floquet solution.   highest : Hz, the highest that takes part"""
    longest = max(to - since for since, to, _ in pieces_of_cut(cut)) * 2 * np.pi / cut.teeth  # rad
    waves = (2 * np.pi * highest / spindle_speed + 2) * longest
    return int(np.ceil(0.5 * waves + 5 + 2 * np.log10(1e-3 / tolerance)))


def highest_that_takes_part(receptance: Receptance, cut: Regeneration, deepest: float) -> float:
    """The highest line at which the tip gives way to the deepest cut as much as the cut pushes it, Hz."""
    size = np.linalg.norm(receptance.values, axis=(1, 2)) * np.hypot(cut.ktc, cut.krc) * deepest
    part = np.flatnonzero(size >= TAKES_PART)
    return float(receptance.frequency[part[-1]]) if len(part) else float(receptance.frequency[0])


def cut_basis(cut: Regeneration, order: int, harmonics: int) -> CutBasis:
    """harmonics : K, of k = -K .. K - 1"""
    from scipy.special import roots_legendre

    k = np.arange(-harmonics, harmonics)
    unit, _ = roots_legendre(order)
    barycentric = _barycentric(unit)
    nodes, of, reads, forces, points, tables = [], [], [], [], [], []
    for since, to, teeth in pieces_of_cut(cut):
        half = (to - since) / 2
        node = since + half * (unit + 1)
        angle = cut.entry + (node[:, np.newaxis] + np.arange(teeth)) * 2 * np.pi / cut.teeth
        matrix = h0(angle, cut.ktc, cut.krc).sum(axis=1)  # (node, 2, 2)
        index = len(nodes) * order + np.arange(order)
        if teeth == 1:
            chip = np.stack([np.sin(angle[:, 0]), np.cos(angle[:, 0])], axis=-1)
            of.append(index)
            reads.append(chip)
            forces.append(np.einsum("nij,nj->ni", matrix, chip))  # H0 C = B (C^T C) = B
        else:
            of.append(np.repeat(index, 2))
            reads.append(np.tile(np.eye(2), (order, 1)))
            forces.append(matrix.transpose(0, 2, 1).reshape(-1, 2))
        count = int(np.ceil((order + 2 * np.pi * harmonics * half + 24) / 2))
        x, weight = roots_legendre(count)
        nodes.append(node)
        points.append(since + half * (x + 1))
        tables.append(_lagrange(x, unit, barycentric) * (half * weight)[:, np.newaxis])
    lagrange = np.zeros((sum(map(len, points)), order * len(nodes)))
    row = 0
    for piece, table in enumerate(tables):
        lagrange[row : row + len(table), piece * order : (piece + 1) * order] = table
        row += len(table)
    node, point = np.concatenate(nodes), np.concatenate(points)
    turns = 2j * np.pi * k[:, np.newaxis]
    return CutBasis(
        node,
        np.concatenate(of),
        np.concatenate(reads),
        np.concatenate(forces),
        point,
        lagrange,
        np.exp(turns * node),
        np.exp(-turns * point),
        k,
    )


def _barycentric(node: np.ndarray) -> np.ndarray:
    """Weights of the barycentric formula, scaled so that they neither over- nor underflow."""
    gap = 2 * (node[:, np.newaxis] - node)
    np.fill_diagonal(gap, 1.0)
    return 1 / np.prod(gap, axis=1)


def _lagrange(x: np.ndarray, node: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The polynomials that are 1 at one node and 0 at the others.   returns (x, node)"""
    gap = x[:, np.newaxis] - node
    at_node = gap == 0
    terms = weight / np.where(at_node, 1.0, gap)
    table = terms / terms.sum(axis=1, keepdims=True)
    hit = at_node.any(axis=1)
    table[hit] = at_node[hit]
    return table


def circle_matrix(angle: np.ndarray, basis: CutBasis, receptance: Receptance, period: float) -> np.ndarray:
    """M(theta).   angle : theta, (t,) rad   period : of the teeth, s   returns complex (t, unknown, unknown) 1/m"""
    turn = angle[:, np.newaxis] + 2 * np.pi * basis.harmonic
    matrix = receptance.at(turn / (2 * np.pi * period))  # (t, harmonic, 2, 2)
    out, back = harmonic_tables(angle, basis)
    total = np.zeros((len(angle), len(basis.of), len(basis.of)), complex)
    for a in range(2):
        for b in range(2):
            entry = matrix[:, :, a, b]
            if not entry.any():
                continue
            between = np.matmul((out * entry[:, :, np.newaxis]).transpose(0, 2, 1), back)  # (t, node, node)
            total += np.outer(basis.reads[:, a], basis.forces[:, b]) * between[:, basis.of][:, :, basis.of]
    return (1 - np.exp(-1j * angle))[:, np.newaxis, np.newaxis] * total


def harmonic_tables(angle: np.ndarray, basis: CutBasis) -> tuple[np.ndarray, np.ndarray]:
    """e^{j v t} at the nodes, and the integrals of their polynomials against e^{-j v t}.   returns 2 x (t, harmonic, node)"""
    out = np.exp(1j * angle[:, np.newaxis] * basis.node)[:, np.newaxis] * basis.forward
    seen = np.exp(-1j * angle[:, np.newaxis] * basis.quadrature)[:, np.newaxis] * basis.backward
    return out, seen @ basis.lagrange


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

    spindle_speed : (speed,) rad/s   frequency : (line,) Hz, ascending, > 0   values : complex (line, 2, 2) m/N, output, input
    deepest : m   order : nodes in a piece of the cut; None takes the rule of `order_of_cut` at the given tolerance

    Raises ValueError for unequal pitch, helix and process damping, which this form does not hold.
    """
    if not cut.equal_pitch or cut.wind or cut.indentation:
        raise ValueError("crossings from a receptance need equal pitch, no helix and no process damping")
    receptance = receptance_of_lines(frequency, values)
    highest = highest_that_takes_part(receptance, cut, deepest)
    parts = []
    for i, speed in enumerate(np.asarray(spindle_speed, float)):
        parts.append(_of_one_speed(i, speed, receptance, cut, deepest, order, highest, tolerance))
        if progress is not None:
            progress((i + 1) / len(spindle_speed))
    return joined_crossings(parts)


def joined_crossings(parts: list[Crossings]) -> Crossings:
    if not parts:
        return Crossings(np.empty(0, int), np.empty(0), np.empty(0, int), np.empty(0), np.empty(0, bool))
    return Crossings(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _of_one_speed(
    index: int,
    speed: float,
    receptance: Receptance,
    cut: Regeneration,
    deepest: float,
    order: int | None,
    highest: float,
    tolerance: float,
) -> Crossings:
    period = 2 * np.pi / (cut.teeth * speed)
    order = order or order_of_cut(cut, speed, highest, tolerance)
    harmonics = int(np.ceil(receptance.frequency[-1] * period)) + 1
    basis = cut_basis(cut, order, harmonics)
    found = circle_crossings(lambda angle: circle_matrix(angle, basis, receptance, period), deepest)
    count = len(found.factor)
    kind = np.select([found.angle == np.pi, found.angle == 0], [FLIP, FOLD], HOPF)
    chatter = loudest(found.angle, receptance, period)
    return Crossings(np.full(count, index), found.factor, kind, chatter, found.rising)


def loudest(angle: np.ndarray, receptance: Receptance, period: float) -> np.ndarray:
    """Of the frequencies |theta + 2 pi k| / (2 pi T) the one at which the tip answers most.   returns (angle,) Hz"""
    reach = int(np.ceil(receptance.frequency[-1] * period)) + 1
    alias = np.abs(angle[:, np.newaxis] / (2 * np.pi) + np.arange(-reach, reach)) / period
    size = np.abs(receptance.at(alias)).max(axis=(2, 3))
    return alias[np.arange(len(angle)), np.argmax(size, axis=1)]
