"""Filters that follow the coefficients of a staircase of discs through a cut, compiled.

Each is one step of `numerics` with the force of `disc_force` written into it, and gives the same to rounding from the same
draws: the perturbed ensemble Kalman filter with and without inflation, recursive least squares, and interacting models. All
take the instants at which the law holds, one after the other; between them they hold.

A state is (k, m) of each direction, tangential before radial; k is in whatever unit makes k S(m) newtons.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from millcal.numerics.ensemble_kalman import Inflation, semidefinite_root
from millcal.numerics.interacting_kernel import STAMP, Motions, move, take_in, weigh
from millcal.numerics.interacting_models import Mixture
from millcal.physics.disc_force import ShapeTables

_SUMS_IN_ANY_ORDER = {
    "reassoc",
    "contract",
    "nsz",
}  # so that members are summed four at a time; rounding aside the same


def follow_ensemble(
    tables: ShapeTables,
    force: np.ndarray,
    sigma: np.ndarray,
    members: np.ndarray,
    *,
    rng: np.random.Generator,
    limits: np.ndarray,
    inflation: Inflation | None = None,
    normals: np.ndarray | None = None,
) -> np.ndarray:
    """`ensemble_kalman.step` with perturbed observations at every instant, both directions together.

    force : (instant, 2) N   sigma : of the noise, (2,) N   members : at the start, (member, 4) k_t, m_t, k_r, m_r
    limits : (4, 2)   normals : (instant, member, 2), what the perturbations are made of, for who compares filters on the
    same draws; then `rng` draws the inflations alone   returns the mean of the members after every instant, (instant, 4)
    """
    instants, J = len(force), len(members)
    coefficients, force = _plain(tables, force)
    X = np.array(np.asarray(members, float).T, order="C")
    means = np.empty((instants, 4))
    low, high = np.ascontiguousarray(limits[:, 0]), np.ascontiguousarray(limits[:, 1])
    deviations = X - X.mean(axis=1, keepdims=True)
    root = semidefinite_root(deviations @ deviations.T / J)
    every = instants if inflation is None else inflation.every
    for first in range(0, instants, every):
        last = min(first + every, instants)
        now = slice(first, last)
        # one draw for many instants is the same stream as one (J, 2) for each
        drawn = rng.standard_normal((last - first, J, 2)) if normals is None else normals[now]
        _perturbed(coefficients[now], force[now], sigma, drawn, X, low, high, tables.centre, tables.half, means[now])
        if inflation is not None and last == first + every:
            chosen = rng.permutation(J)[: inflation.subset]
            z = rng.standard_normal((inflation.subset, 4))
            anew = X.mean(axis=1) + np.sqrt(inflation.fraction) * z @ root.T
            X[:, chosen] = np.clip(anew, low, high).T
            means[last - 1] = X.mean(axis=1)
    return means


def _plain(tables: ShapeTables, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(tables.coefficients), np.ascontiguousarray(force, dtype=float)


@njit(cache=True, fastmath=_SUMS_IN_ANY_ORDER)
def _perturbed(coefficients, force, sigma, normals, X, low, high, centre, half, means):
    """Updates of all members X (4, member), in place, at a run of instants.

    Deviations of the members are taken from their mean before, which serves as well: those of the forces sum to nothing.
    """
    instants, powers = coefficients.shape
    J = X.shape[1]
    u, Y0, Y1, E0, E1 = np.empty(J), np.empty(J), np.empty(J), np.empty(J), np.empty(J)
    sigma_0, sigma_1 = sigma[0], sigma[1]  # what is read in a loop is a number: an array might be what the loop writes
    near = np.empty(4)
    for a in range(4):
        near[a] = X[a].mean()
    for k in range(instants):
        for i in range(2):
            S, specific, rise = (Y0, X[0], X[1]) if i == 0 else (Y1, X[2], X[3])
            leading = coefficients[k, powers - 1]
            for j in range(J):
                u[j] = (rise[j] - centre) / half
                S[j] = leading
            for p in range((powers - 1) % 4):
                c0 = coefficients[k, powers - 2 - p]
                for j in range(J):
                    S[j] = S[j] * u[j] + c0
            for p in range((powers - 1) // 4 * 4 - 1, -1, -4):  # four at a time, for fewer ways to memory
                c3, c2, c1, c0 = (
                    coefficients[k, p],
                    coefficients[k, p - 1],
                    coefficients[k, p - 2],
                    coefficients[k, p - 3],
                )
                for j in range(J):
                    S[j] = (((S[j] * u[j] + c3) * u[j] + c2) * u[j] + c1) * u[j] + c0
            for j in range(J):
                S[j] *= specific[j]
        mean_0, mean_1 = 0.0, 0.0
        for j in range(J):
            mean_0 += Y0[j]
            mean_1 += Y1[j]
        mean_0 /= J
        mean_1 /= J
        s00, s01, s11 = 0.0, 0.0, 0.0  # J (D + R)
        normal = normals[k]
        for j in range(J):
            y0, y1 = Y0[j] - mean_0, Y1[j] - mean_1
            e0, e1 = sigma_0 * normal[j, 0], sigma_1 * normal[j, 1]
            s00 += y0 * y0 + e0 * e0
            s01 += y0 * y1 + e0 * e1
            s11 += y1 * y1 + e1 * e1
            Y0[j], Y1[j], E0[j], E1[j] = y0, y1, e0, e1
        determinant = s00 * s11 - s01 * s01
        innovation_0, innovation_1 = force[k, 0] - mean_0, force[k, 1] - mean_1
        for j in range(J):
            E0[j] += innovation_0 - Y0[j]
            E1[j] += innovation_1 - Y1[j]
        for a in range(4):
            x, shift = X[a], near[a]
            c0, c1 = 0.0, 0.0  # J C
            for j in range(J):
                c0 += (x[j] - shift) * Y0[j]
                c1 += (x[j] - shift) * Y1[j]
            g0 = (c0 * s11 - c1 * s01) / determinant
            g1 = (c1 * s00 - c0 * s01) / determinant
            total = 0.0
            lowest, highest = low[a], high[a]
            for j in range(J):
                moved = min(max(x[j] + g0 * E0[j] + g1 * E1[j], lowest), highest)
                x[j] = moved
                total += moved
            near[a] = total / J
            means[k, a] = near[a]


def follow_least_squares(
    tables: ShapeTables,
    force: np.ndarray,
    start: np.ndarray,
    covariance: np.ndarray,
    *,
    forgetting: float,
    limits: np.ndarray | None = None,
) -> np.ndarray:
    """`recursive_least_squares.step` in one direction, unit noise, the box kept by `clip`, from many starts.

    Beyond the rises that the tables hold for, S stays as it is at their end.

    force : (instant,) N   start : k, m, (start, 2)   covariance : at the start, (2, 2)   limits : (2, 2), None: no box
    returns the estimate after every instant, (start, instant, 2)
    """
    box = np.array([[-np.inf, np.inf]] * 2) if limits is None else np.ascontiguousarray(limits, dtype=float)
    coefficients, force = _plain(tables, force)
    start = np.ascontiguousarray(start, dtype=float)
    found = np.empty((len(start), len(force), 2))
    _least_squares(
        coefficients, force, start, np.asarray(covariance, float), forgetting, box, tables.centre, tables.half, found
    )
    return found


@njit(cache=True)
def _least_squares(coefficients, force, start, covariance, forgetting, box, centre, half, found):
    powers = coefficients.shape[1]
    for s in range(start.shape[0]):
        specific, rise = start[s, 0], start[s, 1]
        P00, P01, P11 = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        for k in range(force.shape[0]):
            u = min(max((rise - centre) / half, -1.0), 1.0)
            S, slope = coefficients[k, powers - 1], 0.0
            for p in range(powers - 2, -1, -1):
                slope = slope * u + S
                S = S * u + coefficients[k, p]
            g0, g1 = S, specific * slope / half
            P00, P01, P11 = P00 / forgetting, P01 / forgetting, P11 / forgetting
            a0, a1 = P00 * g0 + P01 * g1, P01 * g0 + P11 * g1
            total = g0 * a0 + g1 * a1 + 1.0
            G0, G1 = a0 / total, a1 / total
            k00, k01, k10, k11 = 1 - G0 * g0, -G0 * g1, -G1 * g0, 1 - G1 * g1
            b00, b01 = k00 * P00 + k01 * P01, k00 * P01 + k01 * P11
            b10, b11 = k10 * P00 + k11 * P01, k10 * P01 + k11 * P11
            innovation = force[k] - specific * S
            P00 = b00 * k00 + b01 * k01 + G0 * G0
            P01 = (b00 * k10 + b01 * k11 + b10 * k00 + b11 * k01) / 2 + G0 * G1
            P11 = b10 * k10 + b11 * k11 + G1 * G1
            specific = min(max(specific + G0 * innovation, box[0, 0]), box[0, 1])
            rise = min(max(rise + G1 * innovation, box[1, 0]), box[1, 1])
            found[s, k, 0], found[s, k, 1] = specific, rise


def follow_models(
    tables: ShapeTables,
    force: np.ndarray,
    sigma: np.ndarray,
    starts: Sequence[Mixture],
    *,
    motions: Motions,
    chances: np.ndarray,
) -> np.ndarray:
    """`interacting_models.step`, linearised at the common mean, from many starts; both directions share the models.

    Here a state is (kappa_t, m_t, kappa_r, m_r) and then the change of both kappa to the next instant, with kappa = ln k at the
    chip of the tables. What moves one direction moves the other at the same time, so both tell which model holds.
    force : (instant, 2) N   sigma : (2,) N   starts : of (model, 6)   motions : of kappa, with its changes as speeds
    chances : (from, to)   returns the common mean after every instant, (start, instant, 4)
    """
    coefficients, force = _plain(tables, force)
    found = np.empty((len(starts), len(force), 4))
    for start, means in zip(starts, found, strict=True):
        _models(
            coefficients,
            force,
            np.ascontiguousarray(sigma, float) ** 2,
            start.mean.copy(),
            start.covariance.copy(),
            start.probability.copy(),
            motions.level,
            motions.speed,
            motions.walk,
            motions.drift,
            np.ascontiguousarray(chances),
            tables.centre,
            tables.half,
            means,
        )
    return found


def _compiled(stamp: int) -> Callable[..., None]:
    """The loop, with the stamp of what it calls in the key under which it is kept."""

    @njit(cache=True)
    def loop(  # type: ignore[no-untyped-def]
        coefficients, force, variance, x, P, probability, level, speed, walk, drift, chances, centre_of, half, found
    ):
        stamp  # noqa: B018
        M, n = x.shape
        powers = coefficients.shape[1]
        moved_x, moved_P, prior = np.empty((M, n)), np.empty((M, n, n)), np.empty(M)
        centre, scratch, log_likelihood = np.empty(n), np.empty(n), np.empty(M)
        slopes, at_zero = np.zeros((2, 4)), np.empty(2)
        for k in range(force.shape[0]):
            move(x, P, probability, chances, level, speed, walk, drift, moved_x, moved_P, prior, centre)
            for d in range(2):
                u = min(max((centre[2 * d + 1] - centre_of) / half, -1.0), 1.0)
                S, slope = coefficients[k, powers - 1], 0.0
                for p in range(powers - 2, -1, -1):
                    slope = slope * u + S
                    S = S * u + coefficients[k, p]
                size = np.exp(centre[2 * d])
                slopes[d, 2 * d], slopes[d, 2 * d + 1] = size * S, size * slope / half
                at_zero[d] = force[k, d] - size * S
                for p in range(4):
                    at_zero[d] += slopes[d, p] * centre[p]
            for j in range(M):
                log_likelihood[j] = 0.0
                for d in range(2):
                    log_likelihood[j] += take_in(moved_x[j], moved_P[j], at_zero[d], slopes[d], variance[d], scratch)
            weigh(prior, log_likelihood, probability)
            for p in range(4):
                found[k, p] = 0.0
            for j in range(M):
                x[j], P[j] = moved_x[j], moved_P[j]
                for p in range(4):
                    found[k, p] += probability[j] * x[j, p]

    return loop


_models = _compiled(STAMP)
