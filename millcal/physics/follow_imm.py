"""Coefficients followed by interacting models, compiled: `numerics.interacting_models` with the force law written into its loop.

Every model has the states [kappa_t, s_t, kappa_r, s_r, (kappa_a, s_a,) c0, s0 | change of each kappa per sample] and moves the
kappas its own way; shapes and runout rest. At each sample that is used the force and its slopes are taken once, at the mean of all
models. What linearising leaves
out is noise (`followed.left_out`). Time goes on with the samples that are used: what cuts nothing wears nothing.

Where the amplifier's low-pass stands between force and record, the filter runs over the linearised force, F - J x and every column
of J, at all samples: a filter is linear, so its output is linear in the same x,

    filtered force = filter(F - J (x_i - x)) + filter(J) (x - x_ref),

as long as x moves little within the filter's memory. Taking the filter for a delay is not enough by far.

This module imports numba and so is imported where it is used. The loop calls compiled functions of other modules, of whose
edits numba's cache knows nothing; their `STAMP`s are variables around the loop and so belong to the cache's key.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from millcal.numerics import difference_kernel, interacting_kernel
from millcal.numerics.difference_kernel import filter_sample, padded
from millcal.numerics.interacting_kernel import Motions, foretold_variance, move, take_in, weigh
from millcal.numerics.interacting_models import switching
from millcal.physics import edge_kernel
from millcal.physics.cutter import Cutter
from millcal.physics.edge_kernel import add_force, edge_of
from millcal.physics.followed import LEFT_OUT, Followed
from millcal.physics.sampled_force import Passage, columns, directions_of


class Motion(NamedTuple):
    """How one model lets the specific forces move, per sample that is used."""

    walk: float = 0.0  # standard deviation of the step of kappa
    drift: float = 0.0  # of the step of kappa's change per sample; 0: kappa has no trend


TRENDS = (Motion(), Motion(drift=1e-5), Motion(drift=1e-4))  # rest, and what moves within a few revolutions
JUMP = Motion(walk=0.02)  # one more, where an edge may chip
STAY = 0.999  # chance to keep to a model from one sample to the next
SHORT_CUT = 1000  # samples used for which these were found


def bank(samples: int, *, pace: float = 1.0, jumps: bool = False) -> tuple[tuple[Motion, ...], float]:
    """Models, and the chance to keep to one, for a cut of so many used samples.

    pace : how far the cut goes from one used sample to the next, over a 56th of a tooth pass, which was that of the cuts the
        models were found for; so they do not depend on the rate of sampling

    A drift q of the speed moves kappa by q n^1.5 / sqrt(3) in n samples, so what changes by as much over a long cut as over a
    short one needs a drift that is smaller by n^1.5. Between that and the fastest there is a model to every two decades. That
    the fastest and the chance to change models fall with n^0.4 was found by trial on simulated cuts of 25 000 to 280 000 used
    samples that rest, wear, chip and swing: beside the models of a short cut, a third of the error where nothing happens, three
    quarters with wear and a chipped edge, no more with fast swings, and intervals that cover.
    """
    longer = max(samples * pace / SHORT_CUT, 1.0)
    slow, fast = TRENDS[1].drift * longer**-1.5, TRENDS[-1].drift * longer**-0.4
    several = max(2, 1 + math.ceil(math.log10(fast / slow) / 2 - 1e-9))
    trends = tuple(Motion(drift=float(q)) for q in np.geomspace(slow, fast, several) * pace**1.5)
    jump = (Motion(walk=JUMP.walk * pace**0.5),) if jumps else ()
    return (Motion(), *trends, *jump), 1 - (1 - STAY) * longer**-0.4 * pace


def motions_of(models: Sequence[tuple[float, float]], parameters: int) -> Motions:
    """The models for states of `parameters` parameters and one speed for each direction."""
    count = (parameters - 2) // 2
    walk, drift = np.array(models, float).reshape(-1, 2).T
    return Motions(2 * np.arange(count), parameters + np.arange(count), walk.copy(), drift.copy())


def follow_imm(
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
    models: Sequence[tuple[float, float]] = TRENDS,
    stay: float = STAY,
    rate: float = 1e-4,
    lowpass: tuple[np.ndarray, np.ndarray] | None = None,
    nodes: int = 12,
) -> Followed:
    """Follow the parameters of `sampled_force` through a cut.

    mean, covariance : at the start, (parameter,), (parameter, parameter); no variance: known, and stays
    passage : (sample,) each   measured : (sample, axis) N   used : (sample,) bool; others may hold anything, even nan
    edges : first sample of each step and the end of the last, (step + 1,) int; samples before and behind are not looked at
    noise : standard deviation, (axis,) N   models : (walk, drift) of each, as `Motion`
    stay : chance to keep to a model   rate : standard deviation at the start of the change of kappa per sample
    lowpass : b, a of the discrete filter between force and record, at rest at the first edge; None: none
    """
    theta = np.asarray(mean, float)
    count = directions_of(theta.size, axes)
    motions = motions_of(models, theta.size)
    n = theta.size + count
    start, spread = np.zeros(n), np.zeros((n, n))
    start[: theta.size], spread[: theta.size, : theta.size] = theta, covariance
    spread[range(theta.size, n), range(theta.size, n)] = rate**2
    steps, seen, several = len(edges) - 1, len(axes), len(motions.walk)
    out = Followed(
        np.empty((steps, theta.size)),
        np.empty((steps, theta.size, theta.size)),
        np.full((steps, seen), np.nan),
        np.full((steps, seen), np.nan),
        np.zeros(steps, int),
        np.zeros((steps, theta.size)),
        probability=np.empty((steps, several)),
    )
    total = _loop(
        start,
        spread,
        *columns(passage),
        np.ascontiguousarray(measured, float),
        np.ascontiguousarray(used, bool),
        np.ascontiguousarray(edges, np.int64),
        edge_of(cutter, law, reference_chip, axes, nodes),
        np.asarray(noise, float) ** 2,
        switching(several, stay),
        *motions,
        *padded(lowpass),
        lowpass is not None,
        out.mean,
        out.covariance,
        out.innovation_mean,
        out.innovation_square,
        out.count,
        out.probability,
    )
    return out._replace(log_likelihood=total)


def _compiled(stamp: tuple[float, ...]) -> Callable[..., float]:
    """The loop, with the stamps of what it calls in the key under which it is kept."""

    @njit(cache=True)
    def loop(  # type: ignore[no-untyped-def]
        start, spread, angle, feed, depth, entry, leave, direction, measured, used, edges, edge, variance,
        chances, level, speed, walk, drift, b, a, filtered,
        out_mean, out_covariance, out_innovation, out_square, out_count, out_probability,
    ):  # fmt: skip
        stamp  # noqa: B018
        n, models, axes, P = start.size, walk.size, variance.size, out_mean.shape[1]
        order = b.size - 1
        x, C, probability = np.empty((models, n)), np.empty((models, n, n)), np.full(models, 1.0 / models)
        for j in range(models):
            x[j], C[j] = start, spread
        moved_x, moved_C, prior = np.empty((models, n)), np.empty((models, n, n)), np.empty(models)
        centre, scratch, log_likelihood = start.copy(), np.empty(n), np.empty(models)
        force, slopes, left_out = np.zeros(axes), np.zeros((axes, P)), np.zeros(axes)
        intercept, columns = np.zeros(axes), np.zeros((axes, P))
        memory = np.zeros((axes, P + 1, order))
        total = 0.0
        for step in range(edges.size - 1):
            sums, squares, count = np.zeros(axes), np.zeros(axes), 0
            for k in range(edges[step], edges[step + 1]):
                if used[k]:
                    move(x, C, probability, chances, level, speed, walk, drift, moved_x, moved_C, prior, centre)
                elif not filtered:
                    continue
                add_force(
                    centre[:P], angle[k], feed[k], depth[k], entry[k], leave[k], direction[k], edge, force, slopes
                )
                for i in range(axes):
                    at_reference = force[i]
                    for p in range(P):
                        at_reference -= slopes[i, p] * (centre[p] - start[p])
                    if not filtered:
                        intercept[i] = at_reference
                        columns[i] = slopes[i]
                        continue
                    intercept[i] = filter_sample(at_reference, b, a, memory[i, P])
                    for p in range(P):
                        columns[i, p] = filter_sample(slopes[i, p], b, a, memory[i, p])
                if not used[k]:
                    continue
                log_likelihood[:] = 0.0
                for i in range(axes):
                    innovation = measured[k, i] - intercept[i]
                    value, size = innovation, 0.0
                    for p in range(P):
                        innovation -= columns[i, p] * (centre[p] - start[p])
                        value += columns[i, p] * start[p]
                    for d in range(level.size):
                        size += abs(columns[i, level[d]])
                    doubt = foretold_variance(moved_x, moved_C, prior, centre, columns[i], 0.0)
                    alone = 0.0
                    for p in range(P):
                        spread_p = 0.0
                        for j in range(models):
                            spread_p += prior[j] * (moved_C[j, p, p] + (moved_x[j, p] - centre[p]) ** 2)
                        alone += columns[i, p] ** 2 * spread_p
                    left_out[i] = LEFT_OUT * alone * (alone / max(size * size, 1e-6 * alone)) if alone > 0.0 else 0.0
                    foretold = doubt + left_out[i] + variance[i]
                    sums[i] += innovation / math.sqrt(foretold)
                    squares[i] += innovation * innovation / foretold
                    intercept[i] = value
                for i in range(axes):
                    for j in range(models):
                        log_likelihood[j] += take_in(
                            moved_x[j], moved_C[j], intercept[i], columns[i], variance[i] + left_out[i], scratch
                        )
                total += weigh(prior, log_likelihood, probability)
                count += 1
                centre[:] = 0.0
                for j in range(models):
                    x[j], C[j] = moved_x[j], moved_C[j]
                    for p in range(n):
                        centre[p] += probability[j] * x[j, p]
            out_mean[step], out_probability[step], out_count[step] = centre[:P], probability, count
            out_covariance[step] = 0.0
            for j in range(models):
                for p in range(P):
                    for q in range(P):
                        apart = (x[j, p] - centre[p]) * (x[j, q] - centre[q])
                        out_covariance[step, p, q] += probability[j] * (C[j, p, q] + apart)
            if count:
                out_innovation[step] = sums / count
                out_square[step] = squares / count
        return total

    return loop


_loop = _compiled((edge_kernel.STAMP, difference_kernel.STAMP, interacting_kernel.STAMP, LEFT_OUT))
