"""Coefficients followed by recursive least squares, compiled: `numerics.recursive_least_squares` fused with the force law.

At each sample that is used the force of `sampled_force` is linearised at the estimate before it, and older samples count
less by the forgetting; between used samples nothing is forgotten. What linearising leaves out is noise
(`followed.left_out`). No variance grows beyond the one at the start, so that a parameter that the cut does not excite, such
as the runout of a cutter with one tooth, stays as it was.

Where the amplifier's low-pass stands between force and record, it runs over the linearised force as in `follow_imm`.

This module imports numba and so is imported where it is used. The loop calls compiled functions of two other modules, of whose
edits numba's cache knows nothing; their `STAMP`s are variables around the loop and so belong to the cache's key.
"""

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from millcal.numerics import difference_kernel
from millcal.numerics.difference_kernel import filter_sample, padded
from millcal.numerics.recursive_least_squares import PROJECTIONS, Disc
from millcal.physics import edge_kernel
from millcal.physics.cutter import Cutter
from millcal.physics.edge_kernel import add_force, edge_of
from millcal.physics.followed import LEFT_OUT, Followed
from millcal.physics.sampled_force import Passage, columns, directions_of


def follow_rls(
    mean: np.ndarray,
    covariance: np.ndarray,
    passage: Passage,
    measured: np.ndarray,
    used: np.ndarray,
    edges: np.ndarray,
    cutter: Cutter,
    *,
    law: str,
    reference_chip: float,
    axes: tuple[str, ...],
    noise: np.ndarray,
    forgetting: float = 0.98,
    limits: np.ndarray | None = None,
    disc: Disc | None = None,
    projection: str = "nearest",
    lowpass: tuple[np.ndarray, np.ndarray] | None = None,
    nodes: int = 12,
) -> Followed:
    """Follow the parameters of `sampled_force` through a cut.

    mean, covariance : at the start, (parameter,), (parameter, parameter); no variance: known, and stays
    passage : (sample,) each   measured : (sample, axis) N   used : (sample,) bool; others may hold anything, even nan
    edges : first sample of each step and the end of the last, (step + 1,) int; samples before and behind are not looked at
    noise : standard deviation, (axis,) N   forgetting : rho per used sample
    limits : (parameter, 2), infinite where there are none   disc : index of c0, and the largest runout, m
    projection : nearest, clip, as in `recursive_least_squares`
    lowpass : b, a of the discrete filter between force and record, at rest at the first edge; None: none
    """
    theta, P = np.asarray(mean, float), np.asarray(covariance, float)
    directions_of(theta.size, axes)
    if projection not in PROJECTIONS:
        raise ValueError(f"{projection=} is none of {', '.join(PROJECTIONS)}")
    steps, seen = len(edges) - 1, len(axes)
    first, radius = disc or (-1, np.inf)
    box = np.tile([-np.inf, np.inf], (theta.size, 1)) if limits is None else np.ascontiguousarray(limits, float)
    out = Followed(
        np.empty((steps, theta.size)),
        np.empty((steps, theta.size, theta.size)),
        np.full((steps, seen), np.nan),
        np.full((steps, seen), np.nan),
        np.zeros(steps, int),
        np.zeros((steps, theta.size)),
    )
    _loop(
        theta,
        P,
        *columns(passage),
        np.ascontiguousarray(measured, float),
        np.ascontiguousarray(used, bool),
        np.ascontiguousarray(edges, np.int64),
        edge_of(cutter, law, reference_chip, axes, nodes),
        np.asarray(noise, float) ** 2,
        forgetting,
        box,
        first,
        radius,
        projection == "nearest",
        *padded(lowpass),
        lowpass is not None,
        *out[:6],
    )
    return out


@njit(cache=True)
def _set_on(x, P, i, way):  # type: ignore[no-untyped-def]
    """State i goes its way, those still free follow, and P becomes that given state i; in place."""
    pivot = P[i, i]
    column = P[:, i] / pivot
    for a in range(x.size):
        x[a] += column[a] * way
    row = P[i].copy()
    for a in range(x.size):
        for b in range(x.size):
            P[a, b] -= column[a] * row[b]
    P[i, :] = 0.0
    P[:, i] = 0.0


@njit(cache=True)
def _project(x, covariance, box, first, radius, follow):  # type: ignore[no-untyped-def]
    """`nearest` or, without `follow`, `clip`, in place."""
    inside = first < 0 or math.hypot(x[first], x[first + 1]) <= radius
    for a in range(x.size):
        inside = inside and box[a, 0] <= x[a] <= box[a, 1]
    if inside:
        return
    if follow:
        P = covariance.copy()
        if first >= 0:
            distance = math.hypot(x[first], x[first + 1])
            if distance > radius:
                rim = (x[first] * radius / distance, x[first + 1] * radius / distance)
                for i in range(2):
                    if P[first + i, first + i] > 0:
                        _set_on(x, P, first + i, rim[i] - x[first + i])
        for _ in range(x.size):
            worst, farthest, way = -1, 0.0, 0.0
            for a in range(x.size):
                off = min(max(x[a], box[a, 0]), box[a, 1]) - x[a]
                if P[a, a] > 0 and abs(off) / math.sqrt(P[a, a]) > farthest:
                    worst, farthest, way = a, abs(off) / math.sqrt(P[a, a]), off
            if worst < 0:
                break
            _set_on(x, P, worst, way)
    for a in range(x.size):
        x[a] = min(max(x[a], box[a, 0]), box[a, 1])
    if first >= 0:
        shrink = min(1.0, radius / max(math.hypot(x[first], x[first + 1]), 1e-300))
        x[first] *= shrink
        x[first + 1] *= shrink


def _compiled(stamp: tuple[float, ...]) -> Callable[..., None]:
    """The loop, with the stamps of what it calls in the key under which it is kept."""

    @njit(cache=True)
    def loop(  # type: ignore[no-untyped-def]
        start, spread, angle, feed, depth, entry, leave, direction, measured, used, edges, edge, variance,
        forgetting, box, first, radius, follow, b, a, filtered,
        out_mean, out_covariance, out_innovation, out_square, out_count, out_bound,
    ):  # fmt: skip
        stamp  # noqa: B018
        n, axes, order = start.size, variance.size, b.size - 1
        x, P, column, scale = start.copy(), spread.copy(), np.empty(n), np.empty(n)
        force, slopes, left_out = np.zeros(axes), np.zeros((axes, n)), np.zeros(axes)
        intercept, columns = np.zeros(axes), np.zeros((axes, n))
        memory = np.zeros((axes, n + 1, order))
        for step in range(edges.size - 1):
            sums, squares, bound, count = np.zeros(axes), np.zeros(axes), np.zeros(n), 0
            for k in range(edges[step], edges[step + 1]):
                if not (used[k] or filtered):
                    continue
                add_force(x, angle[k], feed[k], depth[k], entry[k], leave[k], direction[k], edge, force, slopes)
                for i in range(axes):
                    at_start = force[i]
                    for p in range(n):
                        at_start -= slopes[i, p] * (x[p] - start[p])
                    if not filtered:
                        intercept[i] = at_start
                        columns[i] = slopes[i]
                        continue
                    intercept[i] = filter_sample(at_start, b, a, memory[i, n])
                    for p in range(n):
                        columns[i, p] = filter_sample(slopes[i, p], b, a, memory[i, p])
                if not used[k]:
                    continue
                for p in range(n):
                    grown = P[p, p] / forgetting
                    scale[p] = math.sqrt(spread[p, p] / grown) if grown > spread[p, p] else 1.0
                for p in range(n):
                    for q in range(n):
                        P[p, q] *= scale[p] * scale[q] / forgetting
                for i in range(axes):
                    innovation, doubt, alone, size = measured[k, i] - intercept[i], 0.0, 0.0, 0.0
                    for p in range(n):
                        innovation -= columns[i, p] * (x[p] - start[p])
                        row = 0.0
                        for q in range(n):
                            row += P[p, q] * columns[i, q]
                        doubt += columns[i, p] * row
                        alone += columns[i, p] ** 2 * P[p, p]
                    for p in range(0, n - 2, 2):
                        size += abs(columns[i, p])
                    left_out[i] = LEFT_OUT * alone * (alone / max(size * size, 1e-6 * alone)) if alone > 0.0 else 0.0
                    foretold = doubt + left_out[i] + variance[i]
                    sums[i] += innovation / math.sqrt(foretold)
                    squares[i] += innovation * innovation / foretold
                for i in range(axes):
                    innovation, foretold = measured[k, i] - intercept[i], variance[i] + left_out[i]
                    for p in range(n):
                        innovation -= columns[i, p] * (x[p] - start[p])
                        column[p] = 0.0
                        for q in range(n):
                            column[p] += P[p, q] * columns[i, q]
                        foretold += columns[i, p] * column[p]
                    for p in range(n):
                        x[p] += column[p] / foretold * innovation
                        for q in range(p + 1):
                            P[p, q] -= column[p] / foretold * column[q]
                            P[q, p] = P[p, q]
                _project(x, P, box, first, radius, follow)
                for p in range(n):
                    at_rim = (first == p or first == p - 1) and first >= 0
                    at_rim = at_rim and math.hypot(x[first], x[first + 1]) >= radius * (1 - 1e-12)
                    bound[p] += at_rim or x[p] <= box[p, 0] or x[p] >= box[p, 1]
                count += 1
            out_mean[step], out_covariance[step], out_count[step] = x, P, count
            if count:
                out_innovation[step] = sums / count
                out_square[step] = squares / count
                out_bound[step] = bound / count

    return loop


_loop = _compiled((edge_kernel.STAMP, difference_kernel.STAMP, LEFT_OUT))
