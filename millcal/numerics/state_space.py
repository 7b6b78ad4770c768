"""Kalman filter and smoother of slow states seen through a matrix that changes at every step, with likelihood and score.

States are levels, the speeds at which some of them change, and constants. Between two steps, dt apart,

    level += speed dt,    white noise of intensity q^2 on a level (random walk) or on a speed (trend),

so that a noise on the speed of a level adds q^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]] to the covariance of the two. Steps carry
any number of observations, each of unit variance and taken in one at a time, so that nothing is inverted. The smoother is
de Jong's (1988): its r and N also give the score of every q (Koopman & Shephard 1992) and the Bayes factor of a shock at
every step, all from one pass.
"""

from typing import NamedTuple

import numpy as np
from numba import njit


class Dynamics(NamedTuple):
    """What the states are before anything is seen, and how they move."""

    start: np.ndarray  # (state,) mean
    start_covariance: np.ndarray  # (state, state); zero for what is known
    speeds: np.ndarray  # (pair, 2) int: level, and the state that is its speed
    noisy: np.ndarray  # (noise,) int: the state that a noise drives; on a speed it moves the level too


class Observed(NamedTuple):
    """What was seen: value = matrix state + unit noise. Rows of zeros are no observations."""

    matrix: np.ndarray  # (step, observation, state)
    value: np.ndarray  # (step, observation)
    interval: np.ndarray  # (step,) time since the step before, or since the start
    shock: np.ndarray  # (step, state) variance that is added to the states before a step: a jump there


class Filtered(NamedTuple):
    """A pass forward, and what a pass backward needs of it."""

    log_likelihood: float  # without the constants of the observations' number
    mean: np.ndarray  # (step, state) before the observations of the step
    covariance: np.ndarray  # (step, state, state)
    innovation: np.ndarray  # (step, observation)
    innovation_variance: np.ndarray  # (step, observation)
    gain: np.ndarray  # (step, observation, state)


class Smoothed(NamedTuple):
    """A pass backward."""

    mean: np.ndarray  # (step, state) given all observations
    covariance: np.ndarray  # (step, state, state); empty where not asked for
    score: np.ndarray  # (noise,) d log-likelihood / d ln q
    r: np.ndarray  # (step, state)
    N: np.ndarray  # (step, state, state)


def filter_states(dynamics: Dynamics, intensity: np.ndarray, seen: Observed) -> Filtered:
    """The Kalman filter.   intensity : q, (noise,)"""
    level_of = _level_of(dynamics)
    return Filtered(
        *_forward(
            dynamics.start,
            dynamics.start_covariance,
            dynamics.speeds,
            dynamics.noisy,
            level_of,
            np.asarray(intensity, float) ** 2,
            *seen,
        )
    )


def smooth_states(
    dynamics: Dynamics, intensity: np.ndarray, seen: Observed, filtered: Filtered, *, covariance: bool = True
) -> Smoothed:
    """The smoother after the filter; r and N are those of the predicted state of each step."""
    level_of = _level_of(dynamics)
    steps, n = filtered.mean.shape
    V = np.empty((steps if covariance else 0, n, n))
    mean, score, r, N = _backward(
        dynamics.speeds,
        dynamics.noisy,
        level_of,
        np.asarray(intensity, float) ** 2,
        seen.matrix,
        seen.interval,
        *filtered[1:],
        V,
    )
    return Smoothed(mean, V, score, r, N)


def motion_penalty(dynamics: Dynamics, intensity: np.ndarray, seen: Observed, state: np.ndarray) -> float:
    """-2 log-density of a trajectory before anything is seen, less its constant: what the smoother adds to the squares.

    state : (step, state), which moves only as noises and their shocks may move it
    """
    dt, q2 = seen.interval, np.asarray(intensity, float) ** 2
    w = np.diff(state, axis=0, prepend=dynamics.start[np.newaxis])
    before = np.concatenate([dynamics.start[np.newaxis], state[:-1]])
    levels, speeds = dynamics.speeds.T
    w[:, levels] -= dt[:, np.newaxis] * before[:, speeds]
    transition = np.eye(state.shape[1])
    transition[levels, speeds] = dt[0]
    first = transition @ dynamics.start_covariance @ transition.T + np.diag(seen.shock[0])
    total = 0.0
    for j, (i, level) in enumerate(zip(dynamics.noisy, _level_of(dynamics), strict=True)):
        speed = q2[j] * dt
        if level < 0:
            first[i, i] += speed[0]
            total += float(np.sum(w[1:, i] ** 2 / (speed + seen.shock[:, i])[1:]))
            continue
        size, both = speed * dt**2 / 3 + seen.shock[:, level], speed * dt / 2
        first[np.ix_([level, i], [level, i])] += np.array(
            [[size[0] - seen.shock[0, level], both[0]], [both[0], speed[0]]]
        )
        squares = speed * w[:, level] ** 2 - 2 * both * w[:, level] * w[:, i] + size * w[:, i] ** 2
        total += float(np.sum(squares[1:] / (size * speed - both**2)[1:]))
    unit = np.sqrt(np.diag(first))
    unit[unit == 0.0] = 1.0
    e = w[0] / unit
    return total + float(e @ np.linalg.pinv(first / np.outer(unit, unit), hermitian=True) @ e)


def shock_evidence(smoothed: Smoothed, variance: np.ndarray) -> np.ndarray:
    """Log Bayes factor of a shock N(0, D) before each step, alone, against none.

    1/2 r' (D^-1 + N)^-1 r - 1/2 ln|I + D N|, which needs no further pass.
    variance : diagonal of D, (state,), zero where there is no shock   returns (step,)
    """
    moved = np.flatnonzero(variance)
    size = np.sqrt(variance[moved])
    M = smoothed.N[:, moved[:, np.newaxis], moved] * np.outer(size, size) + np.eye(len(moved))
    g = smoothed.r[:, moved] * size
    solved = np.linalg.solve(M, g[:, :, np.newaxis])[:, :, 0]
    return 0.5 * np.sum(g * solved, axis=1) - 0.5 * np.linalg.slogdet(M)[1]


def _level_of(dynamics: Dynamics) -> np.ndarray:
    """For each noise, the level whose speed it drives, -1 where it drives a level itself.   returns (noise,) int"""
    level = {int(speed): int(level) for level, speed in dynamics.speeds}
    return np.array([level.get(int(state), -1) for state in dynamics.noisy], dtype=np.int64)


@njit(cache=True)
def _forward(start, start_covariance, speeds, noisy, level_of, q2, H, z, interval, shock):  # type: ignore[no-untyped-def]
    steps, seen, n = H.shape
    means, covariances = np.empty((steps, n)), np.empty((steps, n, n))
    innovation, variance = np.zeros((steps, seen)), np.ones((steps, seen))
    gains = np.zeros((steps, seen, n))
    x, P = start.copy(), start_covariance.copy()
    ph = np.empty(n)
    log_likelihood = 0.0
    for k in range(steps):
        dt = interval[k]
        for p in range(len(speeds)):
            level, speed = speeds[p, 0], speeds[p, 1]
            x[level] += dt * x[speed]
            for j in range(n):
                P[level, j] += dt * P[speed, j]
            for j in range(n):
                P[j, level] += dt * P[j, speed]
        for j in range(len(noisy)):
            i, level = noisy[j], level_of[j]
            P[i, i] += q2[j] * dt
            if level >= 0:
                P[i, level] += q2[j] * dt**2 / 2
                P[level, i] += q2[j] * dt**2 / 2
                P[level, level] += q2[j] * dt**3 / 3
        for i in range(n):
            P[i, i] += shock[k, i]
        means[k], covariances[k] = x, P
        for o in range(seen):
            h = H[k, o]
            S, v, idle = 1.0, z[k, o], True
            for i in range(n):
                idle = idle and h[i] == 0.0
            if idle:
                log_likelihood -= 0.5 * v * v
                innovation[k, o] = v
                continue
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += P[i, j] * h[j]
                ph[i] = total
                S += h[i] * total
                v -= h[i] * x[i]
            for i in range(n):
                gain = ph[i] / S
                gains[k, o, i] = gain
                x[i] += gain * v
                for j in range(i + 1):
                    P[i, j] -= gain * ph[j]
                    P[j, i] = P[i, j]
            innovation[k, o], variance[k, o] = v, S
            log_likelihood -= 0.5 * (v * v / S + np.log(S))
    return log_likelihood, means, covariances, innovation, variance, gains


@njit(cache=True)
def _backward(speeds, noisy, level_of, q2, H, interval, means, covariances, innovation, variance, gains, V):  # type: ignore[no-untyped-def]
    steps, seen, n = H.shape
    smoothed, score = np.empty((steps, n)), np.zeros(len(noisy))
    r_all, N_all = np.empty((steps, n)), np.empty((steps, n, n))
    r, N, u = np.zeros(n), np.zeros((n, n)), np.empty(n)
    PN = np.empty((n, n))
    for k in range(steps - 1, -1, -1):
        for o in range(seen - 1, -1, -1):
            h, gain, S = H[k, o], gains[k, o], variance[k, o]
            kr, kNk = 0.0, 0.0
            for i in range(n):
                kr += gain[i] * r[i]
                total = 0.0
                for j in range(n):
                    total += N[i, j] * gain[j]
                u[i] = total
                kNk += gain[i] * total
            change = innovation[k, o] / S - kr
            for i in range(n):
                r[i] += h[i] * change
                for j in range(i + 1):
                    N[i, j] += h[i] * h[j] * (kNk + 1.0 / S) - u[i] * h[j] - h[i] * u[j]
                    N[j, i] = N[i, j]
        r_all[k], N_all[k] = r, N
        P = covariances[k]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += P[i, j] * r[j]
            smoothed[k, i] = means[k, i] + total
        if len(V):
            for i in range(n):
                for j in range(n):
                    total = 0.0
                    for m in range(n):
                        total += P[i, m] * N[m, j]
                    PN[i, j] = total
            for i in range(n):
                for j in range(i + 1):
                    total = P[i, j]
                    for m in range(n):
                        total -= PN[i, m] * P[m, j]
                    V[k, i, j] = total
                    V[k, j, i] = total
        dt = interval[k]
        for j in range(len(noisy)):
            i, level = noisy[j], level_of[j]
            gradient = dt * (r[i] ** 2 - N[i, i])
            if level >= 0:
                gradient += dt**2 * (r[i] * r[level] - N[i, level]) + dt**3 / 3 * (r[level] ** 2 - N[level, level])
            score[j] += q2[j] * gradient
        for p in range(len(speeds)):
            level, speed = speeds[p, 0], speeds[p, 1]
            r[speed] += dt * r[level]
            for j in range(n):
                N[speed, j] += dt * N[level, j]
            for j in range(n):
                N[j, speed] += dt * N[j, level]
    return smoothed, score, r_all, N_all
