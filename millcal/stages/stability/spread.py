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

Between the speeds of the band. The limit turns and jumps from speed to speed, its uncertainty does not: so a draw is carried as
a share of the nominal edges of each speed, which are known there. All of this looks deeper than the map (`PAST`), since a
limit just above the deepest cut that is told is as uncertain as one just below it.
"""

from dataclasses import dataclass

import numpy as np

from millcal.physics.stability.regeneration import Regeneration
from millcal.physics.stability.stable_depths import stable_share
from millcal.stages.stability.method import Method, Sampling

PAST = 1.5  # times the deepest depth of the map: so far the draws are followed
JUMP = 0.15  # of ln b from one speed to the next: more is no slope
AT_ONCE = 256  # speeds, so that many draws of a fine map fit the memory


@dataclass(frozen=True, eq=False)
class Spread:
    """The edges of the stable set in every draw, at the speeds of the band."""

    speed: np.ndarray  # (speed,) rad/s, ascending
    edges: np.ndarray  # (member, speed, edge) m
    everywhere: np.ndarray  # (place,) rad/s, ascending, those of the band among them
    nominal: np.ndarray  # edges there with the mean of everything, (place, edge) m
    deepest: float = np.inf  # m: ends of the band below it are told

    @property
    def members(self) -> int:
        """Draws there are."""
        return len(self.edges)

    def band(self, speed: np.ndarray) -> np.ndarray:
        """Ends of the interval of 95 % of the first limit, inf below `deepest`.   speed : rad/s   returns (2, speed) m"""
        ends = [self._inverse(part)[:, :, 0] for part in _parts(speed)]
        inverse = np.concatenate([np.stack([_end(part, 0.975), _end(part, 0.025)]) for part in ends], axis=1)
        depth = _depth(inverse)
        return np.where(depth <= self.deepest, depth, np.inf)

    def share(self, depth: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """P_stable.   depth : (depth,) m, ascending   speed : (speed,) rad/s   returns (depth, speed)"""
        return np.concatenate([stable_share(self.edges_at(part), depth) for part in _parts(speed)], axis=1)

    def edges_at(self, speed: np.ndarray) -> np.ndarray:
        """Edges of every draw, between the speeds of the band as shares of the nominal ones.   returns (member, speed, edge)

        Interpolating P itself would make steps of a steep limit. Speeds that have no nominal edges take those of the nearest.
        """
        return _depth(self._inverse(speed))

    def at(self, speed: float, depth: float) -> float:
        """P_stable of one cut."""
        return float(self.share(np.array([depth]), np.array([speed]))[0, 0])

    def _inverse(self, speed: np.ndarray) -> np.ndarray:
        """1/b of every edge, 0 where there is none.   returns (member, speed, edge) 1/m"""
        left, right, share = _place(self.speed, speed)
        exact = (share == 0) | (share == 1)
        if exact.all():
            return 1 / self.edges[:, np.where(share == 1, right, left)]
        one, other = 1 / self.edges[:, left], 1 / self.edges[:, right]
        own, of_one, of_other = (
            1 / self.nominal[_nearest(self.everywhere, at)] for at in (speed, self.speed[left], self.speed[right])
        )
        near = (share >= 0.5)[:, np.newaxis]
        many, many_one, many_other = (np.count_nonzero(part, axis=1) for part in (own, of_one, of_other))
        count, count_other = np.count_nonzero(one, axis=2), np.count_nonzero(other, axis=2)
        alike = count == count_other  # (member, speed)
        # The nominal edge by which each edge is measured: its own where a draw has as many, else the first.
        level = np.log([_depth(part[:, 0]) for part in (own, of_one, of_other)])
        steady, near_steady = (
            np.isfinite(some).all(axis=0) & (np.ptp(np.where(np.isfinite(some), some, 0.0), axis=0) < 2 * JUMP)
            for some in (level, np.stack([level[0], np.where(near[:, 0], level[2], level[1])]))
        )
        equal = (many_one == many) & (many_other == many) & (many > 0)
        same, near_same = equal | steady, near_steady
        measured = np.where(alike, same, near_same)[:, :, np.newaxis]
        each = (alike & equal & (count == many))[:, :, np.newaxis]
        unit_one, unit_other, unit = (
            np.where(measured, np.where(each, _wide(part, one.shape[2]), part[:, :1]), 1.0)
            for part in (of_one, of_other, own)
        )
        one, other = (
            np.divide(edge, by, out=np.zeros_like(edge), where=by > 0)
            for edge, by in ((one, unit_one), (other, unit_other))
        )
        part = np.where(alike, share, near[:, 0].astype(float))[:, :, np.newaxis]
        mixed = (one * (1 - part) + other * part) * unit
        return -np.sort(-mixed, axis=2)


def _end(inverse: np.ndarray, share: float) -> np.ndarray:
    """The order statistic of a share, (n + 1) share, which few draws do not pull inwards; none is no number to mix with.

    inverse : (member, ...) 1/m, 0 where there is no limit   returns (...)
    """
    ordered, n = np.sort(inverse, axis=0), len(inverse)
    place = np.clip((n + 1) * share, 1, n) - 1
    below = int(place)
    part = place - below
    one, other = ordered[below], ordered[min(below + 1, n - 1)]
    outer = other if share > 0.5 and part > 0 else one
    return np.where((one > 0) & (other > 0), one + part * (other - one), outer)


def _depth(inverse: np.ndarray) -> np.ndarray:
    """inf where 1/b is 0 or less."""
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)


def _parts(speed: np.ndarray) -> list[np.ndarray]:
    return np.array_split(speed, -(-len(speed) // AT_ONCE) or 1)


def _wide(table: np.ndarray, edges: int) -> np.ndarray:
    """As many columns, 0 behind the last."""
    return np.pad(table, ((0, 0), (0, max(edges - table.shape[1], 0))))[:, :edges]


def _nearest(ascending: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Where the nearest of ascending values is."""
    left, right, share = _place(ascending, values)
    return np.where(share > 0.5, right, left)


def spread_of(
    method: Method,
    cut: Regeneration,
    everywhere: np.ndarray,
    nominal: np.ndarray,
    noise: np.ndarray | None,
    sampling: Sampling,
    deepest: float = np.inf,
) -> Spread | None:
    """The draws of the map, None where nothing is uncertain.

    method : one that looks past the `deepest` of the map, m   everywhere : speeds of the map and beside them, ascending, those
    of `sampling` among them, (place,) rad/s   nominal : edges there with the mean of everything, (place, edge) m
    noise : of 1/b of the first, (place,) 1/m
    """
    if sampling.members < 2:
        return None
    if method.draw is not None:
        return Spread(sampling.speeds, method.draw(sampling), everywhere, nominal, deepest)
    if sampling.draws is None and noise is None:
        return None
    here = np.searchsorted(everywhere, sampling.speeds)
    if sampling.draws is None:
        edges = np.broadcast_to(nominal[here], (sampling.members, len(here), nominal.shape[1]))
    else:
        edges = _by_nodes(method, cut, sampling)
    if noise is not None:
        first = 1 / edges[:, :, :1]
        moved = first + (sampling.rng.standard_normal((len(edges), 1)) * noise[here])[:, :, np.newaxis]
        scale = np.where(moved > 0, first / np.where(moved > 0, moved, 1.0), np.inf)
        edges = np.where(first > 0, edges * np.where(first > 0, scale, 1.0), np.inf)
    return Spread(sampling.speeds, edges, everywhere, nominal, deepest)


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
            tables.append(method.table(sampling.speeds, cut.with_force(float(ktc), float(ktc * node)), step))
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
    return _depth(inverse)


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


def band_speeds(speeds: np.ndarray, depth: np.ndarray, own: np.ndarray, many: int | None) -> np.ndarray:
    """The speeds of the band: all of the map, or about as many of them as a method can afford, and always the `own` ones.

    They are spread over the speeds, over the slopes of the limit and about its corners, in equal parts, with both sides of its
    jumps.

    speeds : of the map, ascending   depth : its first limit, (speed,) m   own : where the band must be exact
    returns ascending, rad/s
    """
    if many is None or len(speeds) <= many:
        return np.unique(np.concatenate([speeds, own]))
    known = np.isfinite(depth)
    level = np.log(np.where(known, depth, depth[known].max(initial=1e-9)))
    step = np.where(np.diff(known.astype(int)) != 0, np.inf, np.diff(level))
    jump = np.argsort(-np.abs(step), kind="stable")[: many // 4]
    jump = jump[np.abs(step[jump]) > JUMP]
    slope = np.clip(step, -JUMP, JUMP)
    slope[jump] = 0.0
    turn = np.abs(np.diff(slope, prepend=slope[0]))
    about = 1 + 2 * (2 * len(speeds) // many)  # a corner of the limit is many corners of the draws, beside one another
    turn = np.convolve(turn, np.bartlett(about + 2)[1:-1])[about // 2 :][: len(slope)]
    parts = (np.diff(speeds), np.abs(slope), turn)
    along = np.concatenate([[0.0], np.cumsum(sum(part / max(part.sum(), 1e-9) for part in parts))])
    chosen = _nearest(along, np.linspace(0.0, along[-1], many - 2 * len(jump)))
    return np.unique(np.concatenate([speeds[np.concatenate([chosen, jump, jump + 1])], own]))
