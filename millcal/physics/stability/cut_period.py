"""One period of a cut in pieces on which the force is smooth, with its nodes: the geometry behind `floquet`.

A period runs from the entry of tooth 0 over one pitch, where all pitches are equal, else over one revolution. Teeth that enter
or leave, and the ends of a helical edge, divide it into pieces; where several teeth of unequal pitch cut at once, so do the
kinks that reappear in the motion one delay later. Pieces without a tooth in cut are free flight and are left out. On each
piece stand Gauss nodes, and on each node as few unknowns as the force needs: one, the chip w = C . r, where a single straight
tooth cuts; one, the motion along the only direction in which the tip can move; else r itself.

A helix counts by its size: seen in a mirror, or from the other end, a left-hand edge is a right-hand one that enters earlier
by its whole lag, a shift in time that no multiplier knows.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from millcal.physics.stability.regeneration import Regeneration, TipModes, h0

STRAIGHT = 1e-4  # rad of helix over the depth, below which the mean angle stands for all heights (cancellation)
ON_A_POINT = 4  # nodes of a piece so short that the force on it hardly changes
INNER = 8  # nodes of the integrals from a node to the next, where a polynomial of any order is half a wave: 1e-11


class Pieces(NamedTuple):
    """Where something is cut, from the entry of tooth 0 on."""

    period: float  # rad
    start: np.ndarray  # (piece,), rad
    length: np.ndarray  # (piece,), rad
    teeth: tuple[tuple[int, ...], ...]  # in cut on each piece, by number; of equal pitch: pitches ahead of tooth 0


class Unknowns(NamedTuple):
    """What is unknown on the nodes and the force it makes: F = - b sum of column (S0 now - S1 before); see `floquet_kernel`."""

    piece: np.ndarray
    place: np.ndarray
    row: np.ndarray
    column: np.ndarray
    rubs: np.ndarray
    now: np.ndarray
    before: np.ndarray
    memory: np.ndarray
    plain: bool


@lru_cache(maxsize=256)
def gauss_table(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes on 0..1, those of the integrals from one to the next, and the weights that integrate each Lagrange polynomial.

    With h the gap from node i - 1 (from 0) to node i, the integral over it of g(x_i - t) l_j(t) is the sum over k of
    weight[i, k, j] g(h (1 - u_k)); the last i leads to the end of the piece.   returns (n,), (q,), (n + 1, q, n)
    """
    node, inner, inner_weight = unit_gauss(order)[0], *unit_gauss(INNER)
    gap = np.diff(node, prepend=0.0, append=1.0)
    at = np.append(0.0, node)[:, np.newaxis] + gap[:, np.newaxis] * inner
    weight = lagrange(node, at.ravel()).reshape(*at.shape, order)
    weight *= (gap[:, np.newaxis] * inner_weight)[:, :, np.newaxis]
    for part in (node, inner, weight):
        part.flags.writeable = False
    return node, inner, weight


@lru_cache(maxsize=256)
def unit_gauss(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes on 0..1 and their weights.   returns (n,), (n,)"""
    node, weight = np.polynomial.legendre.leggauss(order)
    return (node + 1) / 2, weight / 2


def lagrange(node: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Lagrange polynomials of Gauss nodes, barycentric.   node : (n,) on 0..1   at : (m,)   returns (m, n)"""
    barycentric = (-1.0) ** np.arange(len(node)) * np.sqrt(node * (1 - node) * unit_gauss(len(node))[1])
    gap = at[:, np.newaxis] - node
    there = np.abs(gap) < 1e-15
    terms = barycentric / np.where(there, 1.0, gap)
    values = terms / terms.sum(axis=1, keepdims=True)
    on_node = there.any(axis=1)
    values[on_node] = there[on_node]
    return values


def nodes_of(waves: np.ndarray | float, tolerance: float) -> np.ndarray:
    """Nodes that hold |mu| to a tolerance: with d = -log10(tolerance), n = ceil(x / 2 + d / 4 + d / 2 x^(1/3)).

    The polynomials of a wave of phase x die out as Bessel functions do, beyond the order x / 2 over a width of x^(1/3); the
    factors are from experience, no bound: of the random cases of the tests none misses the tolerance.

    waves : x, (...,) rad along the longest piece   returns integer (...,), at least 3
    """
    decades = -np.log10(tolerance)
    return np.maximum(np.ceil(waves / 2 + decades / 4 + decades / 2 * np.cbrt(waves)), 3).astype(int)


def orders_of(pieces: Pieces, order: int) -> np.ndarray:
    """Nodes of each piece where the longest needs `order`: fewer on shorter ones.   returns integer (piece,)"""
    share = pieces.length / pieces.length.max()
    return np.ceil(np.minimum(ON_A_POINT, order) * (1 - share) + order * share - 1e-9).astype(int)


def gauss_tables(orders: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`gauss_table` of several orders in arrays of one size.   returns which table (piece,), nodes, inner nodes, weights"""
    kinds, table = np.unique(orders, return_inverse=True)
    most = int(kinds[-1])
    node, weight = np.zeros((len(kinds), most)), np.zeros((len(kinds), most + 1, INNER, most))
    for i, n in enumerate(kinds.tolist()):
        node[i, :n], inner, weight[i, : n + 1, :, :n] = gauss_table(n)
    return table, node, inner, weight


def pieces_of(cut: Regeneration, depth: float) -> Pieces:
    """The pieces of a period; the depth counts with a helix alone.   depth : m"""
    swept, lag = cut.leave - cut.entry, abs(cut.wind) * depth
    lag = lag if lag > STRAIGHT else 0.0
    if cut.equal_pitch:
        period = 2 * np.pi / cut.teeth
        ends = np.array([0.0, swept + lag, *([lag, swept] if lag else [])])
        marks = _marks(np.mod(ends, period), period)
        start, length = marks[:-1], np.diff(marks)
        middle = start + length / 2
        most = int(np.ceil((swept + lag) / period)) + 1
        teeth = [tuple(k for k in range(most) if t + k * period < swept + lag) for t in middle]
    else:
        period = 2 * np.pi
        lags = np.concatenate([[0.0], np.cumsum(pitches_of(cut))[:-1]])
        ends = np.concatenate([lags + end for end in (0.0, swept + lag, *([lag, swept] if lag else []))])
        marks = _marks(np.mod(ends, period), period)
        engaged = (np.mod(marks[:-1, np.newaxis] + np.diff(marks)[:, np.newaxis] / 2 - lags, period) < swept + lag).sum(
            1
        )
        if engaged.max() > 1 or lag:
            later = []
            for tooth, delay in enumerate(delays_of(cut)):
                again = np.mod(marks[:-1] + delay, period)
                later.append(again[np.mod(again - lags[tooth], period) <= swept + lag])
            marks = _marks(np.concatenate([marks[:-1], *later]), period)
        start, length = marks[:-1], np.diff(marks)
        middle = start + length / 2
        teeth = [tuple(np.flatnonzero(np.mod(t - lags, period) < swept + lag)) for t in middle]
    cuts = np.array([len(those) > 0 for those in teeth])
    return Pieces(period, start[cuts], length[cuts], tuple(those for those in teeth if those))


def _marks(ends: np.ndarray, period: float) -> np.ndarray:
    """Ends of pieces from 0 to the period, ascending; what differs by rounding is one."""
    ends = np.sort(np.where(period - ends < 1e-9, 0.0, ends))
    kept = [0.0]
    for end in ends:
        if end - kept[-1] > 1e-9:
            kept.append(float(end))
    return np.array([*kept, period])


def pitches_of(cut: Regeneration) -> np.ndarray:
    """From tooth k to tooth k + 1, which is also the delay of tooth k + 1.   returns (tooth,) rad"""
    return np.full(cut.teeth, 2 * np.pi / cut.teeth) if cut.pitch is None else np.asarray(cut.pitch, float)


def delays_of(cut: Regeneration) -> np.ndarray:
    """By how much each tooth comes after the one that cut before it.   returns (tooth,) rad"""
    return np.roll(pitches_of(cut), 1)


def _tooth_angle(cut: Regeneration, tooth: int, at: np.ndarray) -> np.ndarray:
    """Angle of a tooth at the helix bottom.   tooth : as in `Pieces.teeth`   at : rad since the entry of tooth 0"""
    if cut.equal_pitch:
        return cut.entry + at + tooth * 2 * np.pi / cut.teeth
    lag = float(np.sum(pitches_of(cut)[:tooth]))
    return cut.entry + np.mod(at - lag, 2 * np.pi)


def force_matrix(angle: np.ndarray, cut: Regeneration, depth: float, ktc: float, krc: float) -> np.ndarray:
    """H of a tooth whose bottom is at an angle, over the depth: of a straight edge per depth, of a helical one as a whole.

    With I an antiderivative of H0, the integral over the height is [I(min(phi, exit)) - I(max(phi - lag, entry))] / wind.

    angle : (n,) rad   returns (n, 2, 2), N/m^2, with a helix N/m
    """
    wind = abs(cut.wind)
    lag = wind * depth
    if lag == 0.0:
        return h0(angle, ktc, krc)
    if lag <= STRAIGHT:
        return depth * h0(angle - lag / 2, ktc, krc)
    low, high = np.maximum(angle - lag, cut.entry), np.minimum(angle, cut.leave)
    return (_antiderivative(high, ktc, krc) - _antiderivative(low, ktc, krc)) / wind


def _antiderivative(angle: np.ndarray, ktc: float, krc: float) -> np.ndarray:
    s, ss = np.sin(angle) ** 2 / 2, angle / 2 - np.sin(2 * angle) / 4
    cc = angle / 2 + np.sin(2 * angle) / 4
    rows = [[ktc * s + krc * ss, ktc * cc + krc * s], [krc * s - ktc * ss, krc * cc - ktc * s]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _only_direction(vectors: np.ndarray) -> np.ndarray | None:
    """The direction that complex vectors share, or None.   vectors : (n, 2)   returns (2,) of length 1"""
    both = np.concatenate([vectors.real, vectors.imag])
    _, size, axes = np.linalg.svd(both, full_matrices=False)
    return axes[0] if size[-1] <= 1e-12 * size[0] else None


def unknowns_of(pieces: Pieces, tip: TipModes, cut: Regeneration, depth: float, orders: np.ndarray) -> Unknowns:
    """The unknowns of a period.   depth : m, counts with a helix alone   orders : nodes of each piece, integer (piece,)"""
    moves = _only_direction(np.concatenate([tip.output, tip.flexibility.T]))
    pushed = _only_direction(np.concatenate([tip.given, tip.flexibility]))
    alone = moves is not None and pushed is not None
    rows = np.array([moves]) if alone else np.eye(2)  # of the motion
    columns = np.array([pushed]) if alone else np.eye(2)  # of the force
    single = cut.wind * depth == 0.0 and all(len(those) == 1 for those in pieces.teeth)
    # where the delayed motion lies between nodes, force and motion each need a frame of their own
    apart = not (cut.equal_pitch or single)
    friction = cut.indentation / cut.radius if cut.indentation else 0.0
    laws = ((cut.ktc, cut.krc, False), (cut.indentation_friction * friction, friction, True))[: 2 if friction else 1]
    row, column, rubs, piece, place = [], [], [], [], []
    forces = []  # of each piece and law: by tooth, node and frame, (tooth, n, d, d)
    for p, teeth in enumerate(pieces.teeth):
        n = int(orders[p])
        at = pieces.start[p] + pieces.length[p] * gauss_table(n)[0]
        angles = [_tooth_angle(cut, k, at) for k in teeth]
        for ktc, krc, rubbing in laws:
            each = np.array([force_matrix(angle, cut, depth, ktc, krc) for angle in angles])
            framed = np.einsum("ai,tnij,bj->tnab", columns, each, rows)
            if single and not alone:
                chip = np.stack([np.sin(angles[0]), np.cos(angles[0])], axis=1)
                row.append(chip)
                column.append(np.einsum("nij,nj->ni", each[0], chip))
            else:
                row.append(np.tile(rows, (n, 1)))
                force = np.broadcast_to(np.eye(len(rows)), (n, len(rows), len(rows))) if apart else framed.sum(axis=0)
                column.append(np.einsum("nab,ai->nbi", force, columns).reshape(-1, 2))
            count = len(row[-1])
            rubs.append(np.full(count, rubbing))
            piece.append(np.full(count, p))
            place.append(np.repeat(np.arange(n), count // n))
            forces.append((at, rubbing, framed))
    where = _Where(*(np.concatenate(part) for part in (piece, place, rubs)))
    if apart:
        now, before = _waves_between_nodes(pieces, cut, orders, where, forces)
    else:
        now, before = _waves_on_nodes(pieces, cut, where)
    memory = np.flatnonzero(before.any(axis=0))
    matched = (np.concatenate(row), np.concatenate(column))
    return Unknowns(where.piece, where.place, *matched, where.rubs, now, before[:, memory], memory, cut.equal_pitch)


class _Where(NamedTuple):
    """Of each unknown, (unknown,)."""

    piece: np.ndarray
    place: np.ndarray
    rubs: np.ndarray


def _waves_on_nodes(pieces: Pieces, cut: Regeneration, where: _Where) -> tuple[np.ndarray, np.ndarray]:
    """S0 and S1 where a node stands at the same angle for every tooth: its wave is that of the same node one tooth before."""
    count = len(where.piece)
    now, before = np.eye(count), np.zeros((count, count))
    places = [np.flatnonzero((where.piece == p) & ~where.rubs) for p in range(len(pieces.start))]
    if cut.equal_pitch:
        waves = np.concatenate(places)
        before[waves, waves] = 1.0
        return now, before
    for mine, last in zip(places[1:], places[:-1], strict=True):
        now[mine, last] = -1.0
    before[places[0], places[-1]] = 1.0
    return now, before


def _waves_between_nodes(
    pieces: Pieces,
    cut: Regeneration,
    orders: np.ndarray,
    where: _Where,
    forces: list[tuple[np.ndarray, bool, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """S0 and S1 where every tooth has its own delay: the wave is read from the polynomial of the piece that made it."""
    count = len(where.piece)
    now, before = np.zeros((count, count)), np.zeros((count, count))
    delays, ends = delays_of(cut), pieces.start + pieces.length
    size = forces[0][2].shape[-1]
    of_piece = [np.flatnonzero((where.piece == p) & ~where.rubs).reshape(-1, size) for p in range(len(ends))]
    first = 0
    for (at, rubs, framed), p in zip(forces, np.repeat(np.arange(len(ends)), len(forces) // len(ends)), strict=True):
        mine = first + np.arange(len(at) * size).reshape(-1, size)  # unknowns of the nodes, (n, d)
        first += mine.size
        now[mine[:, :, np.newaxis], mine[:, np.newaxis, :]] = framed.sum(axis=0)
        for tooth, force in zip(pieces.teeth[p], framed, strict=True) if not rubs else ():
            past = at - delays[tooth]
            sources = np.clip(np.searchsorted(ends, np.mod(past, pieces.period)), 0, len(ends) - 1)
            for source in np.unique(sources):  # a piece of the wave may end within this one, smoothly
                those = sources == source
                target, sign = (now, -1.0) if past[those][0] >= 0 else (before, 1.0)
                inside = (np.mod(past[those], pieces.period) - pieces.start[source]) / pieces.length[source]
                share = lagrange(gauss_table(int(orders[source]))[0], inside)
                wave = sign * share[:, np.newaxis, :, np.newaxis] * force[those][:, :, np.newaxis, :]  # (n, d, node, d)
                target[mine[those][:, :, np.newaxis, np.newaxis], of_piece[source][np.newaxis, np.newaxis]] += wave
    return now, before
