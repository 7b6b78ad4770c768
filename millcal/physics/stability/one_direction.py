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

from millcal.physics.stability.regeneration import Regeneration, TipModes, h0
from millcal.physics.stability.zero_order import single_modes

NODES = 16  # of Gauss in a stretch,
TURN = 4.0  # and the free phase of a stretch, rad: the oscillation is resolved to 1e-11 at 1 + xi q = 3
STEP = 0.02  # of sigma: six-point interpolation errs by 1e-7 where 1 + xi q = 1.5
NEGLIGIBLE = 1e-11
MOST_TERMS = 512
MOST_NODES = 40


class TraceTable(NamedTuple):
    """t as a power series in xi, on nodes of sigma and of K_rc / K_tc."""

    lowest: float  # the first sigma
    step: float
    reach: float  # X: the coefficients are those of (xi / X)^n
    ratio: np.ndarray  # K_rc / K_tc at Chebyshev's nodes, (ratio,)
    series: np.ndarray  # (ratio, sigma, term)


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
    1e-6 of the deepest. Where terms cancel to less than 1e-6, at speeds of dozens of waves between two teeth and depths
    far beyond the limit, the cut is taken as unstable.

    spindle_speed : (speed,) rad/s   tips : one real mode each, all along one direction; one for each draw, or one for all
    cut : its forces take no part   force : K_tc, K_rc, (draw, 2) N/m^2, K_tc > 0   deepest : m   depths : of the scan
    returns (draw, speed, edge) m, ascending, inf behind the last; the first is the first limit
    """
    from millcal.physics.stability.one_direction_kernel import edges_of_draw

    speeds = np.asarray(spindle_speed, float)
    force = np.asarray(force, float).reshape(-1, 2)
    found, direction = single_modes(tips), common_direction(tips)
    if found is None or direction is None:
        raise ValueError("the tips are not one real mode each along one direction")
    if not cut.equal_pitch or cut.wind or cut.indentation:
        raise ValueError("unequal pitch, helix and process damping are beyond one function of two numbers")
    if not np.all(force[:, 0] > 0):
        raise ValueError("K_tc must be above zero in every draw")
    columns = np.broadcast_arrays(*found[:3], force[:, 0], force[:, 1])
    natural, damping, stiffness, ktc, krc = (np.ascontiguousarray(column, float) for column in columns)
    turns = natural * np.sqrt(1 - damping**2) * 2 * np.pi / cut.teeth  # sigma times the spindle speed
    scale = ktc / (stiffness * (1 - damping**2))  # xi / (1 - z) per depth
    ratio = krc / ktc
    table = trace_table(
        (float(np.min(turns)) / speeds.max(), float(np.max(turns)) / speeds.min()),
        (float(np.min(ratio)), float(np.max(ratio))),
        2 * deepest * float(np.max(scale)),
        cut,
        direction,
    )
    weights = _barycentric(table.ratio, ratio)  # (draw, ratio)
    edges = np.full((len(ratio), len(speeds), 8), np.inf)
    for i in range(len(ratio)):
        series = np.tensordot(weights[i], table.series, 1)  # (sigma, term)
        decay = damping[i] / np.sqrt(1 - damping[i] ** 2) * 2 * np.pi  # zeta w tau / sigma
        place = turns[i] / speeds
        edges_of_draw(
            series, (place - table.lowest) / table.step, np.exp(-decay * place), 2 * scale[i] / table.reach,
            deepest, depths, edges[i],
        )  # fmt: skip
        if progress is not None and i % 16 == 0:
            progress(i / len(ratio))
    used = max(1, int(np.isfinite(edges).any(axis=(0, 1)).sum()))
    return edges[:, :, :used]


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


def trace_table(
    sigma: tuple[float, float], ratio: tuple[float, float], reach: float, cut: Regeneration, direction: np.ndarray
) -> TraceTable:
    """The series of t over ranges of sigma and K_rc / K_tc, for |xi| up to `reach`.   direction : u, (2,)"""
    from millcal.physics.stability.one_direction_kernel import add_series

    node, weight, inner, inner_weight, lagrange = _GAUSS
    lowest = sigma[0] - 2.5 * STEP
    nodes = lowest + STEP * np.arange(int(np.ceil((sigma[1] - sigma[0]) / STEP)) + 6)
    length, plain, with_ratio = _stretches(cut, direction, float(nodes[-1]))

    def series_at(sigma: np.ndarray, ratio: np.ndarray, terms: int) -> np.ndarray:
        series = np.empty((len(ratio), len(sigma), terms))
        add_series(
            sigma, ratio, reach, length, plain, with_ratio, node, weight, inner, inner_weight, lagrange, series
        )  # fmt: skip
        return series

    # At the largest sigma both series are longest.
    terms, count = 32, 1
    while True:
        at = _chebyshev(*ratio, count)
        series = np.abs(series_at(nodes[-1:], at, terms)[:, 0]).max(axis=0)
        last = np.flatnonzero(series > NEGLIGIBLE * series.sum())[-1]
        if last > 0.9 * terms and terms < MOST_TERMS:
            terms *= 2
            continue
        if count > 1 or ratio[1] - ratio[0] < 1e-12:
            break
        count = min(_nodes_needed(series_at(nodes[-1:], _chebyshev(*ratio, MOST_NODES), terms)[:, 0]), last + 1)
    return TraceTable(lowest, STEP, reach, at, series_at(nodes, at, int(last) + 1))


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
        pieces = int(np.ceil(2 * np.pi * sigma * (stop - start) / pitch / TURN)) if len(teeth) else 1
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
