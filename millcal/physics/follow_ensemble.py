"""Coefficients followed by an ensemble, compiled: `numerics.ensemble_kalman` with the force law written into its loop.

Every member is a parameter vector of `sampled_force`, runout included, so every member meets chips of its own. At each sample
the members stand side by side in the innermost loops, which run on whole vectors: that, and nothing else, makes a record of a
minute a matter of seconds. The draws are those of the plain step, in its order, so both go the same way to round-off.

Where the amplifier's low-pass stands between force and record, every member carries the states of that filter, driven by its own
force at every sample, used or not, and the gain moves them too. Left out, or taken for a delay, it spoils the coefficients.

This module imports numba and so is imported where it is used. The loop calls compiled functions of `edge_kernel`, of whose edits
numba's cache knows nothing: that module's `STAMP` is a variable around the loop and so belongs to the cache's key.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from millcal.numerics.ensemble_kalman import Disc, Inflation, semidefinite_root
from millcal.physics import edge_kernel
from millcal.physics.cutter import Cutter
from millcal.physics.edge_kernel import (
    SMALLEST_CHIP,
    contact,
    contact_turns,
    edge_of,
    exponential,
    logarithm,
    sine_cosine,
)
from millcal.physics.followed import Followed
from millcal.physics.sampled_force import Passage, columns, directions_of, fixed

LANES = 8  # members are filled up to a multiple of this, so that no loop ends in single steps


def follow_ensemble(
    members: np.ndarray,
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
    rng: np.random.Generator,
    limits: np.ndarray | None = None,
    disc: Disc | None = None,
    inflation: Inflation | None = None,
    walk: np.ndarray | None = None,
    lowpass: tuple[np.ndarray, np.ndarray] | None = None,
    nodes: int = 12,
) -> Followed:
    """Follow the parameters of `sampled_force` through a cut by perturbed observations.

    Order of the draws at a used sample: walk (member, parameter), perturbations (member, axis), and when an inflation's turn has
    come permutation(member) and (subset, parameter), as `ensemble_kalman.step`; nothing is drawn for what is not asked for.
    members : at the start, (member, parameter)   passage : (sample,) each
    measured : (sample, axis) N   used : (sample,) bool; others may hold anything, even nan
    edges : first sample of each step and the end of the last, (step + 1,) int; samples before and behind are not looked at
    noise : covariance, (axis, axis) N^2   limits : lowest and highest, (parameter, 2)   disc : index of c0 and radius, m
    walk : standard deviation of the step before each used sample, (parameter,)
    lowpass : b, a of the discrete filter between force and record, at rest at the first edge; None: none
    """
    theta = np.asarray(members, float)
    J, P = theta.shape
    directions_of(P, axes)
    seen, steps = len(axes), len(edges) - 1
    deviation = theta - theta.mean(axis=0)
    first, radius = (-1, 0.0) if disc is None else disc
    every, subset, fraction = (0, 0, 0.0) if inflation is None else inflation
    bounds = np.array([[-np.inf, np.inf]] * P if limits is None else limits, float)
    b, a = (np.ones(1), np.ones(1)) if lowpass is None else (np.array(c, float) for c in lowpass)
    length = max(len(a), len(b))
    rows = np.repeat(theta[:1].T, -(-J // LANES) * LANES, axis=1)  # (parameter, member), filled up with the first one
    rows[:, :J] = theta.T
    out = Followed(
        np.empty((steps, P)),
        np.empty((steps, P, P)),
        np.full((steps, seen), np.nan),
        np.full((steps, seen), np.nan),
        np.zeros(steps, int),
        np.zeros((steps, P)),
    )
    _loop(
        rows,
        J,
        *columns(passage),
        fixed(measured),
        fixed(used, bool),
        fixed(edges, np.int64),
        edge_of(cutter, law, reference_chip, axes, nodes),
        np.array(noise, float),
        semidefinite_root(noise),
        bounds,
        limits is not None,
        first,
        float(radius),
        every,
        subset,
        math.sqrt(fraction) * semidefinite_root(deviation.T @ deviation / J),
        np.zeros(P) if walk is None else np.array(walk, float),
        walk is not None,
        np.pad(b / a[0], (0, length - len(b))),
        np.pad(a / a[0], (0, length - len(a))),
        lowpass is not None,
        rng,
        out.mean,
        out.covariance,
        out.innovation_mean,
        out.innovation_square,
        out.count,
        out.at_bound,
    )
    return out._replace(members=np.ascontiguousarray(rows[:, :J].T))


class Room(NamedTuple):
    """Space for the force of all members, (member,) each but where said."""

    h: np.ndarray  # chip, then its part of the integral
    other: np.ndarray  # logarithm of the chip; or the fall of the chip, then the part of the edge itself
    U: np.ndarray  # (k, member), waves of the chip's lines
    V: np.ndarray
    tangential: np.ndarray  # (2, member), integrals times sin(phi), cos(phi), per unit of exp(kappa)
    radial: np.ndarray
    axial: np.ndarray


@njit(cache=True, fastmath={"contract"})
def _lines(h, U, V, height, cos_x, sin_x):  # type: ignore[no-untyped-def]
    """The chip under one more line of the lower envelope, for every member."""
    for j in range(h.size):
        line = height + U[j] * cos_x - V[j] * sin_x
        h[j] = line if line < h[j] else h[j]


@njit(cache=True, fastmath={"contract"})
def _falling_lines(h, fall, U, V, height, falls, cos_x, sin_x):  # type: ignore[no-untyped-def]
    """The same, with how steeply the chip falls along the edge, -dh/dx."""
    for j in range(h.size):
        line = height + U[j] * cos_x - V[j] * sin_x
        lower = line < h[j]
        fall[j] = falls + U[j] * sin_x + V[j] * cos_x if lower else fall[j]
        h[j] = line if lower else h[j]


@njit(cache=True, fastmath={"contract"})
def _logarithms(h, logs, width, inverse):  # type: ignore[no-untyped-def]
    """Logarithms of the chips over the reference; the chips become their parts of the integral."""
    for j in range(h.size):
        chip = h[j] if h[j] > SMALLEST_CHIP else SMALLEST_CHIP
        logs[j] = logarithm(chip * inverse)
        h[j] = chip * width if h[j] > 0.0 else 0.0


@njit(cache=True, fastmath={"contract"})
def _shares(h, fall, width, half, weight, before, reference):  # type: ignore[no-untyped-def]
    """Parts of the integral of the chip, and of the edge's own force: `edge_kernel.contact_share` for every member."""
    extent = 2 * half * weight
    down, up = before / weight, 1 - before / weight
    for j in range(h.size):
        steep = abs(fall[j])
        steep = steep if steep > 1e-15 else 1e-15
        share = h[j] / (steep * extent) + (down if fall[j] > 0.0 else up)
        share = share if share < 1.0 else 1.0
        share = share if share > 0.0 else 0.0
        fall[j] = share * reference * width
        h[j] = h[j] * width if h[j] > 0.0 else 0.0


@njit(cache=True)
def _straight(h, edge, width, reference):  # type: ignore[no-untyped-def]
    """The same where no helix spreads the contact over a stretch."""
    for j in range(h.size):
        edge[j] = reference * width if h[j] > 0.0 else 0.0
        h[j] = h[j] * width if h[j] > 0.0 else 0.0


@njit(cache=True, fastmath={"contract"})
def _kienzle_pair(total, h, logs, shape, sin_phi, cos_phi):  # type: ignore[no-untyped-def]
    """Adds one direction's force per unit of exp(kappa), times sine and cosine."""
    with_sin, with_cos = total[0], total[1]
    for j in range(h.size):
        g = h[j] * exponential(-shape[j] * logs[j])
        with_sin[j] += g * sin_phi
        with_cos[j] += g * cos_phi


@njit(cache=True, fastmath={"contract"})
def _kienzle_axial(total, h, logs, shape):  # type: ignore[no-untyped-def]
    for j in range(h.size):
        total[j] += h[j] * exponential(-shape[j] * logs[j])


@njit(cache=True, fastmath={"contract"})
def _linear_pair(total, h, edge, shape, sin_phi, cos_phi):  # type: ignore[no-untyped-def]
    with_sin, with_cos = total[0], total[1]
    for j in range(h.size):
        g = h[j] + shape[j] * (edge[j] - h[j])
        with_sin[j] += g * sin_phi
        with_cos[j] += g * cos_phi


@njit(cache=True, fastmath={"contract"})
def _linear_axial(total, h, edge, shape):  # type: ignore[no-untyped-def]
    for j in range(h.size):
        total[j] += h[j] + shape[j] * (edge[j] - h[j])


@njit(cache=True)
def _forces(rows, angle, feed, depth, entry, leave, direction, edge, room, force):  # type: ignore[no-untyped-def]
    """Force of every member at one instant, overwritten; False where no edge is within entry..leave.

    rows : (parameter, member)   force : (axis, member) N
    """
    force[:, :] = 0.0
    if depth <= 0.0 or leave <= entry:
        return False
    last, teeth = rows.shape[0], edge.lag.size
    axial = last == 8
    met = False
    for tooth in range(teeth):
        p = angle + direction - edge.lag[tooth]
        first, end = contact_turns(p, depth, edge.wind, entry, leave)
        if first >= end:
            continue
        if not met:
            met = True
            room.tangential[:, :] = 0.0
            room.radial[:, :] = 0.0
            room.axial[:] = 0.0
        for k in range(teeth - 1):
            C, S = edge.cosines[tooth, k], edge.sines[tooth, k]
            for j in range(rows.shape[1]):
                c0, s0 = rows[last - 2, j], rows[last - 1, j]
                room.U[k, j] = c0 * C - s0 * S
                room.V[k, j] = c0 * S + s0 * C
        for turn in range(first, end):
            middle, half, height = contact(p, depth, edge.wind, entry, leave, turn)
            if half <= 0.0 and edge.wind != 0.0:
                continue
            sin_p, cos_p, sin_m, cos_m = math.sin(p), math.cos(p), math.sin(middle), math.cos(middle)
            for i in range(edge.node.size):
                sin_d, cos_d = sine_cosine(half * edge.node[i])
                sin_x, cos_x = sin_m * cos_d + cos_m * sin_d, cos_m * cos_d - sin_m * sin_d
                sin_phi, cos_phi = sin_p * cos_x - cos_p * sin_x, cos_p * cos_x + sin_p * sin_x
                width = height * edge.weight[i]
                room.h[:] = feed * edge.rise[tooth, teeth - 1] * sin_phi
                if edge.linear:
                    room.other[:] = feed * edge.rise[tooth, teeth - 1] * cos_phi
                    for k in range(teeth - 1):
                        a = feed * edge.rise[tooth, k]
                        _falling_lines(room.h, room.other, room.U[k], room.V[k], a * sin_phi, a * cos_phi, cos_x, sin_x)
                    if half > 0.0:
                        _shares(room.h, room.other, width, half, edge.weight[i], edge.before[i], edge.reference)
                    else:
                        _straight(room.h, room.other, width, edge.reference)
                    _linear_pair(room.tangential, room.h, room.other, rows[1], sin_phi, cos_phi)
                    _linear_pair(room.radial, room.h, room.other, rows[3], sin_phi, cos_phi)
                    if axial:
                        _linear_axial(room.axial, room.h, room.other, rows[5])
                else:
                    for k in range(teeth - 1):
                        _lines(room.h, room.U[k], room.V[k], feed * edge.rise[tooth, k] * sin_phi, cos_x, sin_x)
                    _logarithms(room.h, room.other, width, 1 / edge.reference)
                    _kienzle_pair(room.tangential, room.h, room.other, rows[1], sin_phi, cos_phi)
                    _kienzle_pair(room.radial, room.h, room.other, rows[3], sin_phi, cos_phi)
                    if axial:
                        _kienzle_axial(room.axial, room.h, room.other, rows[5])
    if not met:
        return False
    sin_f, cos_f = math.sin(direction), math.cos(direction)
    for row in range(edge.axes.size):
        axis = edge.axes[row]
        on_x, on_y = (cos_f, -sin_f) if axis == 0 else (sin_f, cos_f)
        for j in range(rows.shape[1]):
            if axis == 2:
                force[row, j] = exponential(rows[4, j]) * room.axial[j]
            else:
                t = exponential(rows[0, j]) * (on_y * room.tangential[0, j] - on_x * room.tangential[1, j])
                r = exponential(rows[2, j]) * (on_x * room.radial[0, j] + on_y * room.radial[1, j])
                force[row, j] = t - r
    return True


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _mean(values, count):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(count):
        total += values[j]
    return total / count


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _mean_product(a, b, count):  # type: ignore[no-untyped-def]
    """The order of a sum is no part of the method: it may be that of the vectors."""
    total = 0.0
    for j in range(count):
        total += a[j] * b[j]
    return total / count


@njit(cache=True)
def _centre(values, anomalies, count):  # type: ignore[no-untyped-def]
    """Anomalies of rows of members; returns nothing.   values, anomalies : (row, member)"""
    for i in range(values.shape[0]):
        middle = _mean(values[i], count)
        for j in range(count):
            anomalies[i, j] = values[i, j] - middle


@njit(cache=True)
def _solve(A, b):  # type: ignore[no-untyped-def]
    """x of A x = b for a small positive definite A; both are overwritten, b by x.   A : (m, m)   b : (m,)"""
    m = b.size
    for i in range(m):
        for k in range(i + 1, m):
            ratio = A[k, i] / A[i, i]
            for l in range(i, m):
                A[k, l] -= ratio * A[i, l]
            b[k] -= ratio * b[i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]


@njit(cache=True)
def _project(rows, count, limits, bounded, first, radius):  # type: ignore[no-untyped-def]
    """`ensemble_kalman.project`, in place."""
    if bounded:
        for i in range(rows.shape[0]):
            low, high = limits[i, 0], limits[i, 1]
            for j in range(count):
                rows[i, j] = min(max(rows[i, j], low), high)
    if first >= 0:
        for j in range(count):
            distance = math.hypot(rows[first, j], rows[first + 1, j])
            if distance > radius:
                rows[first, j] *= radius / distance
                rows[first + 1, j] *= radius / distance


@njit(cache=True)
def _at_bound(rows, count, limits, bounded, first, radius, share):  # type: ignore[no-untyped-def]
    """`ensemble_kalman.at_bound`."""
    share[:] = 0.0
    for j in range(count):
        if bounded:
            for i in range(rows.shape[0]):
                if rows[i, j] <= limits[i, 0] or rows[i, j] >= limits[i, 1]:
                    share[i] += 1 / count
    if first >= 0:
        rim = 0.0
        for j in range(count):
            if math.hypot(rows[first, j], rows[first + 1, j]) >= radius * (1 - 1e-12):
                rim += 1 / count
        share[first], share[first + 1] = max(share[first], rim), max(share[first + 1], rim)


def _compiled(stamp: int) -> Callable[..., None]:
    """The loop, with the stamp of what it calls in the key under which it is kept."""

    @njit(cache=True)
    def loop(  # type: ignore[no-untyped-def]
        rows, J, angle, feed, depth, entry, leave, direction, measured, used, edges, edge, noise, noise_root,
        limits, bounded, disc, radius, every, subset, inflation_root, walk, walking, b, a, filtered, rng,
        out_mean, out_covariance, out_innovation, out_square, out_count, out_bound,
    ):  # fmt: skip
        stamp  # noqa: B018
        P, width = rows.shape
        m, order, teeth = noise.shape[0], b.size - 1, edge.lag.size
        room = Room(
            np.empty(width),
            np.empty(width),
            np.zeros((max(teeth - 1, 1), width)),
            np.zeros((max(teeth - 1, 1), width)),
            np.zeros((2, width)),
            np.zeros((2, width)),
            np.zeros(width),
        )
        force, Y = np.zeros((m, width)), np.zeros((m, width))
        memory = np.zeros((m * order, width))  # states of the low-pass: those of the first axis, then of the next
        A, A_memory, A_Y = np.zeros((P, width)), np.zeros((m * order, width)), np.zeros((m, width))
        E, away = np.zeros((m, width)), np.zeros((m, width))
        D, R_D, S, gain = np.empty((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty(m)
        fresh, middle, normal = np.empty((P, subset)), np.empty(P), np.empty(P)
        updates = 0
        for step in range(edges.size - 1):
            total, square = np.zeros(m), np.zeros(m)
            for i in range(edges[step], edges[step + 1]):
                if not (filtered or used[i]):
                    continue
                if walking and used[i]:
                    for j in range(J):
                        for q in range(P):
                            rows[q, j] += walk[q] * rng.standard_normal()
                cuts = _forces(rows, angle[i], feed[i], depth[i], entry[i], leave[i], direction[i], edge, room, force)
                if filtered:
                    for k in range(m):
                        base = k * order
                        for j in range(width):
                            y = b[0] * force[k, j] + (memory[base, j] if order > 0 else 0.0)
                            Y[k, j] = y
                            for n in range(order):
                                later = memory[base + n + 1, j] if n + 1 < order else 0.0
                                memory[base + n, j] = later + b[n + 1] * force[k, j] - a[n + 1] * y
                elif cuts:
                    Y[:, :] = force
                else:
                    Y[:, :] = 0.0
                if not used[i]:
                    continue
                for j in range(J):
                    for k in range(m):
                        away[k, j] = rng.standard_normal()
                for k in range(m):
                    for j in range(J):
                        value = 0.0
                        for l in range(k + 1):
                            value += noise_root[k, l] * away[l, j]
                        E[k, j] = value
                _centre(rows, A, J)
                _centre(memory, A_memory, J)
                _centre(Y, A_Y, J)
                for k in range(m):
                    for l in range(m):
                        D[k, l] = _mean_product(A_Y[k], A_Y[l], J)
                    innovation = measured[i, k] - _mean(Y[k], J)
                    foretold = D[k, k] + noise[k, k]
                    total[k] += innovation / math.sqrt(foretold)
                    square[k] += innovation * innovation / foretold
                    for j in range(J):
                        away[k, j] = measured[i, k] + E[k, j] - Y[k, j]
                for k in range(m):
                    for l in range(m):
                        R_D[k, l] = D[k, l] + _mean_product(E[k], E[l], J)
                for q in range(P + m * order):
                    of = A[q] if q < P else A_memory[q - P]
                    moved = rows[q] if q < P else memory[q - P]
                    for k in range(m):
                        gain[k] = _mean_product(of, A_Y[k], J)
                        for l in range(m):
                            S[k, l] = R_D[k, l]
                    _solve(S, gain)
                    for k in range(m):
                        for j in range(J):
                            moved[j] += gain[k] * away[k, j]
                _project(rows, J, limits, bounded, disc, radius)
                updates += 1
                out_count[step] += 1
                if every > 0 and updates % every == 0:
                    chosen = rng.permutation(J)[:subset]
                    for q in range(P):
                        middle[q] = _mean(rows[q], J)
                    for c in range(subset):
                        for q in range(P):
                            normal[q] = rng.standard_normal()
                        for q in range(P):
                            fresh[q, c] = middle[q]
                            for l in range(q + 1):
                                fresh[q, c] += inflation_root[q, l] * normal[l]
                    for q in range(m * order):
                        held = _mean(memory[q], J)
                        for c in range(subset):
                            memory[q, chosen[c]] = held
                    for q in range(P):
                        for c in range(subset):
                            rows[q, chosen[c]] = fresh[q, c]
                    _project(rows, J, limits, bounded, disc, radius)
            _centre(rows, A, J)
            for q in range(P):
                out_mean[step, q] = _mean(rows[q], J)
                for r in range(P):
                    out_covariance[step, q, r] = _mean_product(A[q], A[r], J)
            if out_count[step] > 0:
                for k in range(m):
                    out_innovation[step, k] = total[k] / out_count[step]
                    out_square[step, k] = square[k] / out_count[step]
            _at_bound(rows, J, limits, bounded, disc, radius, out_bound[step])

    return loop


_loop = _compiled(edge_kernel.STAMP)
