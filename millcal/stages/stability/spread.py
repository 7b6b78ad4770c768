"""What is uncertain in coefficients and dynamics makes of the limit: a band, and probabilities that a cut is stable.

A draw of coefficients and structure has its own set of stable depths at every speed. P_stable at a depth is the share of
draws whose set holds it, islands and all; the band is that of the first limit, speed by speed: 95 % at each speed, not for
the whole curve at once.

Coefficients. Without helix and process damping the depths are f(K_rc / K_tc) / K_tc: K_tc only scales them and edge
coefficients do not enter. So f is solved exactly at a few dozen ratios across the draws and each draw is an interpolation
between two of them (of 1/f, where a change of lobe is a convex corner: interpolating errs to the safe side). Where two
ratios differ in how many edges there are, the nearer one counts.

FRF. Drawing noisy lines would add the noise a second time to lines that carry it already, and the lowest of several noisy
crossings is biased low. So the variance goes through the eigenvalue at the limiting frequency to first order, centred on the
limit of the measured lines, and is normal in 1/b, in which the eigenvalue is linear; edges above go with the first.

Fitted modes. Their errors move frequencies, damping and residues together and with them the lobes, which no first order at
one frequency sees; so the limit is solved anew for structures drawn from the fit, each with coefficients of its own.
"""

from dataclasses import dataclass

import numpy as np

from millcal.physics.stability.regeneration import Regeneration
from millcal.physics.stability.stable_depths import edge_table, stable_share
from millcal.stages.stability.method import Method, Sampling


@dataclass(frozen=True, eq=False)
class Spread:
    """The edges of the stable set in every draw, at the speeds of the band."""

    speed: np.ndarray  # (speed,) rad/s, ascending
    edges: np.ndarray  # (member, speed, edge) m

    def band(self, speed: np.ndarray) -> np.ndarray:
        """Ends of the interval of 95 % of the first limit, between the speeds of the band by 1/b.   returns (2, speed) m"""
        inverse = np.quantile(1 / self.edges[:, :, 0], [0.975, 0.025], axis=0)
        at = np.stack([np.interp(speed, self.speed, q) for q in inverse])
        return np.where(at > 0, 1 / np.where(at > 0, at, 1.0), np.inf)

    def share(self, depth: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """P_stable.   depth : (depth,) m, ascending   speed : (speed,) rad/s   returns (depth, speed)"""
        share = stable_share(self.edges, depth)
        return np.stack([np.interp(speed, self.speed, row) for row in share])

    def at(self, speed: float, depth: float) -> float:
        """P_stable of one cut."""
        return float(self.share(np.array([depth]), np.array([speed]))[0, 0])


def spread_of(
    method: Method, cut: Regeneration, nominal: np.ndarray, noise: np.ndarray | None, sampling: Sampling
) -> Spread | None:
    """The draws of the map, None where nothing is uncertain.

    nominal : edges with the mean of everything, (speed, edge) m   noise : of 1/b of the first, (speed,) 1/m; both at the speeds
    of `sampling`
    """
    if sampling.members < 2:
        return None
    if method.draw is not None:
        return Spread(sampling.speeds, method.draw(sampling))
    if sampling.draws is None and noise is None:
        return None
    if sampling.draws is None:
        edges = np.broadcast_to(nominal, (sampling.members, *nominal.shape))
    elif method.ratios:
        edges = _by_ratio(method, cut, sampling)
    else:
        edges = _one_by_one(method, cut, sampling)
    if noise is not None:
        first = 1 / edges[:, :, :1]
        moved = first + (sampling.rng.standard_normal((len(edges), 1)) * noise)[:, :, np.newaxis]
        scale = np.where(moved > 0, first / np.where(moved > 0, moved, 1.0), np.inf)
        edges = np.where(first > 0, edges * np.where(first > 0, scale, 1.0), np.inf)
    return Spread(sampling.speeds, edges)


def _by_ratio(method: Method, cut: Regeneration, sampling: Sampling) -> np.ndarray:
    """Edges of every draw of the coefficients, by way of their ratio.   returns (member, speed, edge) m"""
    draws = sampling.draws
    ratio = draws[:, 1] / draws[:, 0]
    # Quantiles, so that a far draw of few cuts' long tails does not stretch the grid; closer at the ends, where the band is.
    nodes = np.unique(np.quantile(ratio, (1 - np.cos(np.linspace(0, np.pi, method.ratios))) / 2))
    # With the strongest force, whose edges stand highest: what a method sees above its deepest is then enough for every draw.
    strongest = float(np.quantile(draws[:, 0], 0.99))
    share = 0.0

    def step(part: float) -> None:
        sampling.progress(share + part / len(nodes))

    tables = []
    for i, node in enumerate(nodes):
        share = i / len(nodes)
        step(0.0)
        solution = method.solve(sampling.speeds, cut.with_force(strongest, strongest * node), step)
        tables.append(edge_table(solution.edges, len(sampling.speeds)))
    inverse = 1 / joined(tables)
    right = np.clip(np.searchsorted(nodes, ratio), 1, max(len(nodes) - 1, 1)) % len(nodes)
    left = np.maximum(right - 1, 0)
    part = (ratio - nodes[left]) / np.where(right > left, nodes[right] - nodes[left], 1.0)
    part = np.clip(part, 0.0, 1.0)[:, np.newaxis, np.newaxis]
    if inverse.shape[2] > 1:
        alike = ((inverse[left] > 0) == (inverse[right] > 0)).all(axis=2, keepdims=True)
        part = np.where(alike, part, np.round(part))
    inverse = (inverse[left] * (1 - part) + inverse[right] * part) * (draws[:, 0] / strongest)[
        :, np.newaxis, np.newaxis
    ]
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)


def _one_by_one(method: Method, cut: Regeneration, sampling: Sampling) -> np.ndarray:
    """The same where depths do not go with 1 / K: every draw solved by itself."""
    tables = []
    for i, (ktc, krc) in enumerate(sampling.draws):
        sampling.progress(i / len(sampling.draws))
        solution = method.solve(sampling.speeds, cut.with_force(float(ktc), float(krc)), lambda share: None)
        tables.append(edge_table(solution.edges, len(sampling.speeds)))
    return joined(tables)


def joined(tables: list[np.ndarray]) -> np.ndarray:
    """Tables of edges (speed, edge) one behind the other, as wide as the widest.   returns (member, speed, edge)"""
    edges = np.full((len(tables), len(tables[0]), max(table.shape[1] for table in tables)), np.inf)
    for row, table in zip(edges, tables, strict=True):
        row[:, : table.shape[1]] = table
    return edges


def band_speeds(speeds: np.ndarray, own: np.ndarray, many: int | None) -> np.ndarray:
    """The speeds of the band: all of the map, or as many of them as a method can afford, and always the `own` ones.

    speeds : of the map, ascending   own : where the band must be exact   returns ascending, rad/s
    """
    if many is None or len(speeds) <= many:
        return np.unique(np.concatenate([speeds, own]))
    return np.unique(np.concatenate([speeds[np.linspace(0, len(speeds) - 1, many).round().astype(int)], own]))
