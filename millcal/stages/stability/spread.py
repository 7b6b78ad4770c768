"""What is uncertain in coefficients and dynamics makes of the limit: a band, and probabilities that a cut is stable.

A draw of coefficients and structure has its own set of stable depths at every speed. P_stable at a depth is the share of
draws whose set holds it, islands and all; the band is that of the first limit, speed by speed: 95 % at each speed, not for
the whole curve at once.

Coefficients. Without helix and process damping the depths are f(K_rc / K_tc) / K_tc: K_tc only scales them and edge
coefficients do not enter. So f is solved exactly at a few dozen ratios across the draws and each draw is an interpolation
between two of them (of 1/f, where a change of lobe is a convex corner: interpolating errs to the safe side). Where two
ratios differ in how many edges there are, the nearer one counts. With helix or process damping f depends on K_tc a little,
and a few values of that are solved as well.

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
        return stable_share(self.edges_at(speed), depth)

    def edges_at(self, speed: np.ndarray) -> np.ndarray:
        """Edges of every draw between the speeds of the band, by 1/b; of several edges where both sides have as many.

        Interpolating P itself would make steps of a steep limit.   returns (member, speed, edge) m
        """
        left, right, share = _place(self.speed, speed)
        by_speed = np.swapaxes(1 / self.edges, 0, 1)  # (speed, member, edge)
        inverse = np.swapaxes(_mixed(by_speed[left], by_speed[right], share), 0, 1)
        return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)

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
    else:
        edges = _by_nodes(method, cut, sampling)
    if noise is not None:
        first = 1 / edges[:, :, :1]
        moved = first + (sampling.rng.standard_normal((len(edges), 1)) * noise)[:, :, np.newaxis]
        scale = np.where(moved > 0, first / np.where(moved > 0, moved, 1.0), np.inf)
        edges = np.where(first > 0, edges * np.where(first > 0, scale, 1.0), np.inf)
    return Spread(sampling.speeds, edges)


def _by_nodes(method: Method, cut: Regeneration, sampling: Sampling) -> np.ndarray:
    """Edges of every draw of the coefficients, by way of a few of them.   returns (member, speed, edge) m"""
    draws = sampling.draws
    assert draws is not None
    ratio, strength = draws[:, 1] / draws[:, 0], draws[:, 0]
    ratios = _nodes(ratio, method.ratios)
    # Where K_tc scales the depths, the strongest serves all: its edges stand highest, above what the method calls deepest.
    strengths = _nodes(strength, method.strengths) if method.strengths > 1 else np.quantile(strength, [0.99])
    done = 0.0

    def step(part: float) -> None:
        sampling.progress(done + part / (len(ratios) * len(strengths)))

    tables = []
    for ktc in strengths:
        for node in ratios:
            solution = method.solve(sampling.speeds, cut.with_force(float(ktc), float(ktc * node)), step)
            tables.append(edge_table(solution.edges, len(sampling.speeds)))
            done = len(tables) / (len(ratios) * len(strengths))
    scaled = 1 / joined(tables)  # and over K_tc: 1 / f
    scaled = scaled.reshape(len(strengths), len(ratios), *scaled.shape[1:]) / strengths[:, None, None, None]
    between = [_between(scaled[k], ratios, ratio) for k in range(len(strengths))]
    if len(strengths) == 1:
        inverse = between[0]
    else:
        left, right, share = _place(strengths, strength)
        both = np.stack(between)
        member = np.arange(len(draws))
        inverse = _mixed(both[left, member], both[right, member], share)
    inverse = inverse * strength[:, np.newaxis, np.newaxis]
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)


def _nodes(values: np.ndarray, many: int) -> np.ndarray:
    """Quantiles, so that a far draw of few cuts' long tails does not stretch the grid; closer at the ends, where the band is."""
    return np.unique(np.quantile(values, (1 - np.cos(np.linspace(0, np.pi, many))) / 2))


def _place(nodes: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nodes to the left and to the right of each value, and the share of the right one."""
    right = np.clip(np.searchsorted(nodes, values), 1, max(len(nodes) - 1, 1)) % len(nodes)
    left = np.maximum(right - 1, 0)
    share = (values - nodes[left]) / np.where(right > left, nodes[right] - nodes[left], 1.0)
    return left, right, np.clip(share, 0.0, 1.0)


def _between(table: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A table (node, speed, edge) at values between its nodes.   returns (value, speed, edge)"""
    left, right, share = _place(nodes, values)
    return _mixed(table[left], table[right], share)


def _mixed(left: np.ndarray, right: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Inverse edges (node, ., edge) between two nodes; of several edges the nearer node's, unless both have as many."""
    part = share[:, np.newaxis, np.newaxis]
    if left.shape[2] > 1:
        alike = ((left > 0) == (right > 0)).all(axis=2, keepdims=True)
        part = np.where(alike, part, np.round(part))
    return left * (1 - part) + right * part


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
