"""The boundary of stability along columns of a map: at each speed all depths at which a multiplier crosses the unit circle.

Each column is sampled at a number of depths; where the count of multipliers outside the circle differs between two samples,
each crossing is found by Chandrupatla's method on the logarithm of the multiplier of that rank, a continuous function of the
depth whatever multipliers meet. Flips, which are known beforehand, divide the column, so that a narrow flip island is never
missed; a bulge of the next multiplier between samples that reaches the circle is found by its parabola. All columns go
through each step together, so that a step is one call of the model.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from millcal.physics.stability.regeneration import FLIP, FOLD, HOPF

BESIDE = 1e-6  # of its depth, to both sides of a flip
BULGE = 3  # parabolas through a bulge
STEPS = 60
HIDES = 1e6  # |mu| beside which those at the circle are known to 1e-5 or so

Model = Callable[[np.ndarray, np.ndarray], np.ndarray]  # column (n,), depth (n,) -> multipliers (n, k), largest first


class Found(NamedTuple):
    """Crossings of all columns, sorted by column, then depth."""

    column: np.ndarray
    depth: np.ndarray
    kind: np.ndarray
    multiplier: np.ndarray  # complex
    loses: np.ndarray


class _Bracket(NamedTuple):
    """A change of sign of ln |mu| of one rank between two depths."""

    column: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rank: np.ndarray
    at_low: np.ndarray  # ln |mu|
    at_high: np.ndarray
    pair: np.ndarray  # bool: the next rank changes as well; of a complex pair one will do


def crossings_in_columns(
    model: Model, columns: int, deepest: float, samples: int, flips: tuple[np.ndarray, np.ndarray], tolerance: float
) -> Found:
    """All crossings up to a depth.

    flips : column (f,) and depth (f,) of the crossings at -1 that are known   tolerance : m
    """
    column, depth = _sampled(columns, deepest, samples, flips)
    multiplier = model(column, depth)
    told = _told(column, multiplier)
    column, depth, multiplier = column[told], depth[told], multiplier[told]
    size = _log(multiplier)
    count = np.sum(size > 0, axis=1)
    step = np.flatnonzero(column[1:] == column[:-1])
    known, sure = np.empty(0, int), np.empty(0, int)
    if len(flips[0]):
        within = (depth[step + 1] - depth[step]) < 3 * BESIDE * depth[step]
        known = step[within]
        known = known[count[known + 1] != count[known]]  # of two that meet, or beyond what the model keeps, none counts
        sure = np.sign(count[known + 1] - count[known])
        step = step[~within]
    brackets = [_changes(column, depth, size, count, step), *_bulges(model, column, depth, size, count, step)]
    bracket = _Bracket(*(np.concatenate(parts) for parts in zip(*brackets, strict=True)))
    root, mu = _roots(model, bracket, tolerance)
    bracket, root, mu = _completed(model, bracket, root, mu, len(brackets[0].column), tolerance)
    twins = bracket.pair & (mu.imag == 0)  # two real multipliers, no complex pair: the other one is to be found, too
    if twins.any():
        other = _Bracket(*(part[twins] for part in bracket))._replace(rank=bracket.rank[twins] + 1)
        low, high = (_log(_of_rank(model, other.column, at, other.rank)) for at in (other.low, other.high))
        other = other._replace(at_low=low, at_high=high)
        again, mu_again = _roots(model, other, tolerance)
        bracket = _Bracket(*(np.concatenate(parts) for parts in zip(bracket, other, strict=True)))
        root, mu = np.concatenate([root, again]), np.concatenate([mu, mu_again])
    kind = np.where(mu.imag != 0, HOPF, np.where(mu.real < 0, FLIP, FOLD))
    middle = (depth[known] + depth[known + 1]) / 2
    parts = Found(
        np.concatenate([bracket.column, column[known]]),
        np.concatenate([root, middle]),
        np.concatenate([kind, np.full(len(known), FLIP)]),
        np.concatenate([mu, np.full(len(known), -1.0 + 0j)]),
        np.concatenate([bracket.at_high > bracket.at_low, sure > 0]),
    )
    order = np.lexsort((parts.depth, parts.column))
    return Found(*(part[order] for part in parts))


def _sampled(columns: int, deepest: float, samples: int, flips: tuple[np.ndarray, np.ndarray]) -> tuple:
    """Depths to begin with, those beside flips among them.   returns column (n,), depth (n,), sorted"""
    depth = np.linspace(0.0, deepest, samples + 1)
    every = np.repeat(np.arange(columns), samples + 1), np.tile(depth, columns)
    column = np.concatenate([every[0], flips[0], flips[0]])
    depth = np.concatenate([every[1], flips[1] * (1 - BESIDE), flips[1] * (1 + BESIDE)])
    order = np.lexsort((depth, column))
    return column[order], depth[order]


def _told(column: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
    """Samples down to the first of those, to the end of their column, beside whose largest multiplier rounding hides the others.

    A revolution far beyond the limit multiplies a wave by 1e8 and more, while others stay at the circle, where rounding alone
    would have them cross, to and fro.   returns bool (n,)
    """
    index = np.arange(len(column))
    last = np.zeros(column.max(initial=0) + 1, int)
    clear = np.abs(multiplier[:, 0]) <= HIDES
    np.maximum.at(last, column[clear], index[clear])
    return index <= last[column] + 1


def _log(multiplier: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(np.abs(multiplier), 1e-30))


def _changes(column: np.ndarray, depth: np.ndarray, size: np.ndarray, count: np.ndarray, step: np.ndarray) -> _Bracket:
    """Brackets where the count changes from one sample to the next: every second rank that crosses, as of complex pairs."""
    fewer, more = np.minimum(count[step], count[step + 1]), np.maximum(count[step], count[step + 1])
    many = (more - fewer + 1) // 2
    which = np.repeat(np.arange(len(step)), many)
    rank = fewer[which] + 2 * (np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many))
    low = step[which]
    ends = size[low, rank], size[low + 1, rank]
    return _Bracket(column[low], depth[low], depth[low + 1], rank, *ends, rank + 1 < more[which])


def _completed(
    model: Model, bracket: _Bracket, root: np.ndarray, mu: np.ndarray, changes: int, tolerance: float
) -> tuple[_Bracket, np.ndarray, np.ndarray]:
    """With what hides behind a pair: a pair changes the count by two, so that an odd change has a real multiplier beside it.

    A flip that comes back and a pair that leaves between two samples are a pocket, of which the count alone shows the pair.

    changes : so many of the brackets, the first ones, are changes of the count   returns brackets, depths, multipliers
    """
    odd = np.flatnonzero(~bracket.pair[:changes] & (mu.imag[:changes] != 0))
    if not len(odd):
        return bracket, root, mu
    column = np.repeat(bracket.column[odd], 4)
    depth = np.stack([bracket.low, root * (1 - BESIDE), root * (1 + BESIDE), bracket.high], axis=1)[odd]
    fits = np.repeat((depth[:, 1] > depth[:, 0]) & (depth[:, 2] < depth[:, 3]), 2)
    size = _log(model(column, depth.ravel()))
    step = (4 * np.arange(len(odd))[:, np.newaxis] + [0, 2]).ravel()[fits]
    beside = _changes(column, depth.ravel(), size, np.sum(size > 0, axis=1), step)
    again, mu_again = _roots(model, beside, tolerance)
    # what else changes in such a step is found anew
    others = np.zeros(len(root), bool)
    for i in odd:
        others[:changes] |= (bracket.column[:changes] == bracket.column[i]) & (bracket.low[:changes] == bracket.low[i])
    others[odd] = False
    kept = _Bracket(*(part[~others] for part in bracket))
    whole = _Bracket(*(np.concatenate(parts) for parts in zip(kept, beside, strict=True)))
    return whole, np.concatenate([root[~others], again]), np.concatenate([mu[~others], mu_again])


def _bulges(
    model: Model, column: np.ndarray, depth: np.ndarray, size: np.ndarray, count: np.ndarray, step: np.ndarray
) -> list[_Bracket]:
    """Brackets to both sides of a bulge (of the largest multiplier inside) or a dent (of the smallest outside) that crosses.

    Three samples without a crossing between, the middle one nearest to the circle: parabolas are laid through it until their
    summit is beyond the circle or stays short of it.
    """
    follows = step[:-1][np.diff(step) == 1]
    follows = follows[(count[follows] == count[follows + 1]) & (count[follows] == count[follows + 2])]
    found = []
    for inside in (True, False):
        at = follows if inside else follows[count[follows] > 0]
        rank = count[at] if inside else count[at] - 1
        keep = rank < size.shape[1]
        at, rank = at[keep], rank[keep]
        sign = -1.0 if inside else 1.0  # distance from the circle, positive while it is not crossed
        y = np.stack([sign * size[at + k, rank] for k in range(3)])
        x = np.stack([depth[at + k] for k in range(3)])
        near = (y[1] <= y[0]) & (y[1] <= y[2]) & (_summit(x, y)[1] < np.maximum(0.5 * y[1], 0.02))
        at, rank, x, y = at[near], rank[near], x[:, near], y[:, near]
        for _ in range(BULGE):
            if not len(at):
                break
            new, _ = _summit(x, y)
            fresh = sign * _log(_of_rank(model, column[at], new, rank))
            none = np.zeros(len(at), bool)
            over = fresh < 0
            points, sizes = (x[0], new, x[2]), (sign * y[0], sign * fresh, sign * y[2])
            for k in range(2):
                ends = [part[j][over] for part in (points, sizes) for j in (k, k + 1)]
                found.append(_Bracket(column[at[over]], ends[0], ends[1], rank[over], ends[2], ends[3], none[over]))
            right = new > x[1]
            better = fresh < y[1]
            # the middle moves to the nearer point, and the ends close in
            x, y = (
                np.where(
                    better,
                    np.where(right, [v[1], f, v[2]], [v[0], f, v[1]]),
                    np.where(right, [v[0], v[1], f], [f, v[1], v[2]]),
                )
                for v, f in ((x, new), (y, fresh))
            )
            go = ~over & (y[1] < 0.9 * np.maximum(y[0], y[2]))
            at, rank, x, y = at[go], rank[go], x[:, go], y[:, go]
    return found


def _summit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest point of the parabola through three points.   x, y : (3, n)   returns x (n,), y (n,)"""
    left, right = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    bend = (right - left) / (x[2] - x[0])
    slope = left + bend * (x[1] - x[0])
    flat = bend <= 1e-300
    shift = np.where(flat, 0.0, -slope / np.where(flat, 1.0, 2 * bend))
    shift = np.clip(shift, 0.9 * (x[0] - x[1]), 0.9 * (x[2] - x[1]))
    tiny = 1e-3 * (x[2] - x[0])
    shift = np.where(np.abs(shift) < tiny, np.where(x[2] - x[1] > x[1] - x[0], tiny, -tiny), shift)
    return x[1] + shift, y[1] + slope * shift + bend * shift**2


def _roots(model: Model, bracket: _Bracket, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """The depths of change, all at once, by Chandrupatla's method (Advances in Engineering Software 28, 1997).

    returns (n,) m, and the multiplier there, complex (n,)
    """
    n = len(bracket.low)
    a, b, fa, fb = bracket.high.copy(), bracket.low.copy(), bracket.at_high.copy(), bracket.at_low.copy()
    c, fc = a.copy(), fa.copy()
    share = np.clip(fa / np.where(fa == fb, 1.0, fa - fb), 0.05, 0.95)
    best, multiplier = a.copy(), np.ones(n, complex)
    live = np.arange(n)
    for _ in range(STEPS):
        if not len(live):
            break
        x = a[live] + share[live] * (b[live] - a[live])
        mu = _of_rank(model, bracket.column[live], x, bracket.rank[live])
        f = _log(mu)
        same = np.sign(f) == np.sign(fa[live])
        # the secant to the point before tells how far the root still is, before the other end of the bracket comes in
        ahead = np.abs(f * (x - a[live]) / np.where(f == fa[live], np.inf, f - fa[live]))
        c[live], fc[live] = np.where(same, a[live], b[live]), np.where(same, fa[live], fb[live])
        b[live] = np.where(same, b[live], a[live])
        fb[live] = np.where(same, fb[live], fa[live])
        a[live], fa[live] = x, f
        best[live], multiplier[live] = x, mu
        width = np.abs(b[live] - a[live])
        room = 0.5 * tolerance / np.maximum(width, 1e-300)
        done = (room > 0.5) | (f == 0) | (ahead < 0.01 * tolerance)
        xi = (a[live] - b[live]) / np.where(c[live] == b[live], np.inf, c[live] - b[live])
        eta = (fa[live] - fb[live]) / np.where(fc[live] == fb[live], np.inf, fc[live] - fb[live])
        quadratic = (eta**2 < xi) & ((1 - eta) ** 2 < 1 - xi)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = fa[live] / (fb[live] - fa[live]) * fc[live] / (fb[live] - fc[live]) + (c[live] - a[live]) / (
                b[live] - a[live]
            ) * fa[live] / (fc[live] - fa[live]) * fb[live] / (fc[live] - fb[live])
        t = np.where(quadratic & np.isfinite(t), t, 0.5)
        share[live] = np.clip(t, np.minimum(room, 0.5), 1 - np.minimum(room, 0.5))
        live = live[~done]
    return best, multiplier


def _of_rank(model: Model, column: np.ndarray, depth: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """The multiplier of a rank by size.   column, depth, rank : (n,)   returns complex (n,)"""
    return model(column, depth)[np.arange(len(column)), rank]
