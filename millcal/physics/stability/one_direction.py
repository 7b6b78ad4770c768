"""One mode, one direction: the stable depths of thousands of structures and forces, from one function of two numbers.

A mode of natural frequency w, damping ratio zeta and stiffness k along the direction u is cut by straight teeth of one pitch,
x'' + 2 zeta w x' + w^2 x = -w^2 beta q(t) [x(t) - x(t - tau)], beta = b K_tc / k, with q the sum over the teeth of
u^T H0 u / K_tc, periodic in the tooth period tau. A motion of multiplier mu repeats itself times mu, so that x(t - tau) is
z x(t) with z = 1 / mu, and the delay is gone: what is left is an oscillator whose spring is stiffened by xi = beta (1 - z)
times q(t). Its own monodromy matrix has the determinant D = exp(-2 zeta w tau), whatever xi, and so

    1 - z T(beta (1 - z)) + z^2 D = 0,      T the trace of the monodromy matrix,

is the whole characteristic equation, exactly. With the damping taken out, T = exp(-zeta w tau) t(xi / (1 - zeta^2)), where t is
the trace of an undamped equation of Hill and depends on sigma = w tau sqrt(1 - zeta^2) / 2 pi and on K_rc / K_tc alone. It is an
entire function of xi, its coefficients are smooth in sigma and polynomials in K_rc / K_tc. They are tabulated: damping,
stiffness, K_tc and depth cost nothing. At a depth the equation is then a polynomial in z, and stable where it has no root in the
unit disc, which the recursion of Schur and Cohn decides. At z = -1 it gives all flips, T(2 beta) = -(1 + D).

What it cannot do: two directions, several modes, flexibility or complex residues beside the mode, unequal pitch, a helix and
process damping (`floquet` has them). Overlapping teeth are as good as others.

References
----------
Magnus, Winkler 1966, Hill's Equation, part I. Schur 1917, J. reine angew. Math. 147.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import FLIP, HOPF, Crossings, Regeneration, TipModes, h0
from millcal.physics.stability.stable_depths import edge_table, edges_of
from millcal.physics.stability.zero_order_draws import single_modes

NODES = 16  # of Gauss in a stretch,
TURN = 4.0  # and the free phase of a stretch, rad: the oscillation is resolved to 1e-11 at 1 + xi q = 3
STEP = 0.02  # of sigma: six-point interpolation errs by 1e-7 where 1 + xi q = 1.5
NEGLIGIBLE = 1e-11
MOST_TERMS = 512
MOST_EDGES = 9  # told at one speed: odd, so that what is beyond them counts as chatter
MOST_NODES = 40


class TraceTable(NamedTuple):
    """t as a power series in xi, on nodes of sigma and of K_rc / K_tc."""

    lowest: float  # the first sigma
    step: float  # to the next; 0: the sigmas are those that are asked, one after the other
    reach: float  # X: the coefficients are those of (xi / X)^n
    ratio: np.ndarray  # K_rc / K_tc at Chebyshev's nodes, (ratio,)
    series: np.ndarray  # (ratio, sigma, term)


class _Draws(NamedTuple):
    """What the characteristic equation knows of each structure and force."""

    turns: np.ndarray  # sigma times the spindle speed, (draw,) rad/s
    damping: np.ndarray  # zeta w tau over sigma, (draw,)
    scale: np.ndarray  # xi / (1 - z) per depth, (draw,) 1/m
    ratio: np.ndarray  # K_rc / K_tc, (draw,)


def stable_edges(
    spindle_speed: np.ndarray,
    tips: Sequence[TipModes],
    cut: Regeneration,
    force: np.ndarray,
    *,
    deepest: float,
    depths: int = 32,
    progress: Callable[[float], None] | None = None,
) -> np.ndarray:
    """The edges of the set of stable depths of every draw at every speed, as `stable_depths.edge_table` has them.

    Depths are scanned, flips that come and go between two of them are looked for apart, and each edge is halved down to
    1e-6 of the deepest. Where terms cancel to less than 1e-6 before stability is lost, `floquet.boundary` takes their place.

    A thousand draws at three hundred speeds cost seconds; the table that different structures share grows with the square of
    the waves between two teeth, and with fifty of them costs a minute.

    spindle_speed : (speed,) rad/s   tips : one real mode each, all along one direction; one for each draw, or one for all
    cut : its forces take no part   force : K_tc, K_rc, (draw, 2) N/m^2, K_tc > 0   deepest : m   depths : of the scan
    returns (draw, speed, edge) m, ascending, inf behind the last; the first is the first limit
    """
    from millcal.physics.stability.one_direction_kernel import edges_of_draw

    speeds = np.asarray(spindle_speed, float)
    draws, table = _tabulated(speeds, tips, cut, force, deepest)
    weights = _barycentric(table.ratio, draws.ratio)  # (draw, ratio)
    edges = np.full((len(draws.ratio), len(speeds), MOST_EDGES), np.inf)
    flips, cancelled = np.empty(edges.shape[1:], bool), np.empty(len(speeds), bool)
    for i, weight in enumerate(weights):
        series = np.tensordot(weight, table.series, 1)  # (sigma, term)
        sigma = draws.turns[i] / speeds
        place = (sigma - table.lowest) / table.step if table.step else np.arange(len(speeds)) + 0.0
        edges_of_draw(
            series, place, table.step > 0, np.exp(-draws.damping[i] * sigma), 2 * draws.scale[i] / table.reach,
            deepest, depths, edges[i], flips, cancelled,
        )  # fmt: skip
        if cancelled.any():
            own = cut.with_force(*np.asarray(force, float)[i % len(force)].tolist())
            found = floquet.boundary(speeds[cancelled], tips[i % len(tips)], own, deepest=deepest)
            exact = edge_table(edges_of(found, complete=True), int(cancelled.sum()))[:, :MOST_EDGES]
            edges[i, cancelled, : exact.shape[1]] = exact
        if progress is not None and i % 16 == 0:
            progress(i / len(weights))
    used = max(1, int(np.isfinite(edges).any(axis=(0, 1)).sum()))
    return edges[:, :, :used]


def boundary(
    spindle_speed: np.ndarray, tip: TipModes, cut: Regeneration, *, deepest: float, depths: int = 64
) -> Crossings:
    """The crossings that bound the stable set of one structure, with the forces of the cut.

    Flips are roots of T(2 beta) = -(1 + D), the others of the characteristic equation on the unit circle, by Newton.

    spindle_speed : (speed,) rad/s   tip : one real mode   deepest : m   depths : of the scan, as in `stable_edges`
    """
    from millcal.physics.stability.one_direction_kernel import edges_of_draw, polish

    speeds = np.asarray(spindle_speed, float)
    draws, table = _tabulated(speeds, [tip], cut, np.array([[cut.ktc, cut.krc]]), deepest)
    series, scale = table.series[0], 2 * draws.scale[0] / table.reach
    decay = np.exp(-draws.damping[0] * draws.turns[0] / speeds)
    edges, flips = np.full((len(speeds), MOST_EDGES), np.inf), np.zeros((len(speeds), MOST_EDGES), bool)
    cancelled = np.empty(len(speeds), bool)
    edges_of_draw(series, np.arange(len(speeds)) + 0.0, False, decay, scale, deepest, depths, edges, flips, cancelled)
    if cancelled.any():
        return edges_of(floquet.boundary(speeds, tip, cut, deepest=deepest), complete=True)
    speed, place = np.nonzero(np.isfinite(edges))
    depth, flip = edges[speed, place], flips[speed, place]
    angle = np.empty(len(depth))
    polish(series, speed, scale, decay, flip, depth, angle)
    frequency = floquet.chatter_frequency(speeds[speed], depth, np.exp(1j * angle), tip, cut)
    return Crossings(speed, depth, np.where(flip, FLIP, HOPF), frequency, place % 2 == 0)


def _tabulated(
    speeds: np.ndarray, tips: Sequence[TipModes], cut: Regeneration, force: np.ndarray, deepest: float
) -> tuple[_Draws, TraceTable]:
    """The draws in the numbers of the equation, and the table that spans them."""
    force = np.asarray(force, float).reshape(-1, 2)
    found, direction = single_modes(tips), common_direction(tips)
    if found is None or direction is None:
        raise ValueError("the tips are not one real mode each along one direction")
    if not cut.equal_pitch or cut.wind or cut.indentation:
        raise ValueError("unequal pitch, helix and process damping are beyond one function of two numbers")
    if not np.all(force[:, 0] > 0):
        raise ValueError("K_tc must be above zero in every draw")
    natural, damping, stiffness, ktc, krc = np.broadcast_arrays(*found[:3], force[:, 0], force[:, 1])
    undamped = np.sqrt(1 - damping**2)
    draws = _Draws(
        natural * undamped * 2 * np.pi / cut.teeth,
        2 * np.pi * damping / undamped,
        ktc / (stiffness * undamped**2),
        krc / ktc,
    )
    low, high = float(draws.turns.min()) / speeds.max(), float(draws.turns.max()) / speeds.min()
    lowest, step = low - 2.5 * STEP, STEP
    sigma = lowest + step * np.arange(int(np.ceil((high - low) / step)) + 6)
    if np.ptp(draws.turns) == 0:  # one structure: no more is needed than the speeds asked
        sigma, lowest, step = draws.turns[0] / speeds, 0.0, 0.0
    reach = 2 * deepest * float(draws.scale.max())
    at, series = trace_series(sigma, (float(draws.ratio.min()), float(draws.ratio.max())), reach, cut, direction)
    return draws, TraceTable(lowest, step, reach, at, series)


def signed_distance(edges: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Depth from a cut to the nearest edge of the stable set, above zero where the cut is stable.

    edges : of `stable_edges`, (..., edge) m   depth : (...,) m   returns (...,) m, inf where nothing limits
    """
    depth = np.asarray(depth, float)[..., np.newaxis]
    return np.min(np.abs(edges - depth), axis=-1) * np.where(np.sum(edges <= depth, axis=-1) % 2, -1.0, 1.0)


def common_direction(tips: Sequence[TipModes]) -> np.ndarray | None:
    """The unit vector along which all tips move, each with one real mode; None where it is not so.   returns (2,)"""
    found = single_modes(tips)
    if found is None:
        return None
    direction = found[3]
    return direction[0] if np.abs(direction @ [-direction[0, 1], direction[0, 0]]).max() < 1e-9 else None


def trace_series(
    sigma: np.ndarray, ratio: tuple[float, float], reach: float, cut: Regeneration, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The series of t in (xi / reach)^n, for a range of K_rc / K_tc.

    sigma : (sigma,), in any order   direction : u, (2,)   returns K_rc / K_tc (ratio,), coefficients (ratio, sigma, term)
    """
    from millcal.physics.stability.one_direction_kernel import add_series

    node, weight, inner, inner_weight, lagrange = _GAUSS

    def series_at(sigma: np.ndarray, ratio: np.ndarray, terms: int) -> np.ndarray:
        length, plain, with_ratio = _stretches(cut, direction, float(sigma.max()))
        series = np.empty((len(ratio), len(sigma), terms))
        add_series(
            sigma, ratio, reach, length, plain, with_ratio, node, weight, inner, inner_weight, lagrange, series
        )  # fmt: skip
        return series

    # At the largest sigma both series are longest.
    most = sigma.max(keepdims=True)
    terms, count = 32, 1
    while True:
        at = _chebyshev(*ratio, count)
        largest = np.abs(series_at(most, at, terms)[:, 0]).max(axis=0)
        last = int(np.flatnonzero(largest > NEGLIGIBLE * largest.sum())[-1])
        if last > 0.9 * terms and terms < MOST_TERMS:
            terms *= 2
        elif count > 1 or ratio[1] - ratio[0] < 1e-12:
            break
        else:
            many = series_at(most, _chebyshev(*ratio, MOST_NODES), terms)[:, 0]
            count = min(_nodes_needed(many), last + 1)
    # Lower speeds need more stretches, and each octave of sigma has its own.
    octave = np.ceil(np.log2(most / sigma)).astype(int)
    series = np.empty((count, len(sigma), last + 1))
    for part in np.unique(octave):
        series[:, octave == part] = series_at(sigma[octave == part], at, last + 1)
    return at, series


def _nodes_needed(values: np.ndarray) -> int:
    """Chebyshev's nodes with which nothing that matters is lost.   values : at many nodes, (node, term)"""
    order = np.arange(len(values))
    waves = np.abs(np.cos(np.pi * np.outer(order, order + 0.5) / len(values)) @ values).sum(axis=1)
    return 2 + int(np.flatnonzero(waves > 1e-9 * waves.sum())[-1])


def _stretches(cut: Regeneration, direction: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One tooth period in stretches on which q is smooth and that turn the mode by less than TURN.

    returns lengths in tooth periods (stretch,), and q at Gauss's nodes per unit of 1 and of K_rc / K_tc, (stretch, node)
    """
    pitch = 2 * np.pi / cut.teeth
    events = sorted({round(angle % pitch, 12) for angle in (cut.entry, cut.leave)})
    lengths, factors = [], []
    for start, stop in zip(events, [*events[1:], events[0] + pitch], strict=True):
        angles = start + pitch * np.arange(-1, cut.teeth)
        middle = angles + (stop - start) / 2
        teeth = angles[(cut.entry < middle) & (middle < cut.leave)]
        pieces = 1 + int(2 * np.pi * sigma * (stop - start) / pitch / TURN) if len(teeth) else 1
        length = (stop - start) / pieces
        for i in range(pieces):
            at = teeth + length * (i + _GAUSS[0][:, np.newaxis])  # (node, tooth)
            both = [np.einsum("i,ntij,j->n", direction, h0(at, *unit), direction) for unit in ((1.0, 0.0), (0.0, 1.0))]
            lengths.append(length / pitch)
            factors.append(both)
    plain, with_ratio = np.array(factors).transpose(1, 0, 2).copy()
    return np.array(lengths), plain, with_ratio


def _gauss_tables() -> tuple[np.ndarray, ...]:
    """Nodes and weights on 0..1, those of the inner integrals from 0 to each node, and Lagrange's polynomials there."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    inner, inner_weight = np.polynomial.legendre.leggauss(NODES + 4)
    node, inner, weight, inner_weight = (node + 1) / 2, (inner + 1) / 2, weight / 2, inner_weight / 2
    at = node[:, np.newaxis] * inner  # (node, inner)
    apart = at[..., np.newaxis] - node
    lagrange = np.empty(apart.shape)
    for j in range(NODES):
        others = np.arange(NODES) != j
        lagrange[..., j] = np.prod(apart[..., others] / (node[j] - node[others]), axis=-1)
    return node, weight, inner, inner_weight, lagrange


_GAUSS = _gauss_tables()


def _chebyshev(low: float, high: float, count: int) -> np.ndarray:
    """Chebyshev's nodes of a range, ascending.   returns (count,)"""
    angle = np.pi * (np.arange(count) + 0.5) / count
    return (low + high) / 2 - (high - low) / 2 * np.cos(angle)


def _barycentric(node: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Weights of interpolation through Chebyshev's nodes.   node : (node,)   at : (n,)   returns (n, node)"""
    if len(node) == 1:
        return np.ones((len(at), 1))
    count = np.arange(len(node))
    weight = (-1.0) ** count * np.sin(np.pi * (count + 0.5) / len(node))
    apart = at[:, np.newaxis] - node
    hit = np.abs(apart) < 1e-14 * (node[-1] - node[0])
    share = weight / np.where(hit, 1.0, apart)
    share = np.where(hit.any(axis=1)[:, np.newaxis], hit, share)
    return share / share.sum(axis=1)[:, np.newaxis]
