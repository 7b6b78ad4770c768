"""The step of `interacting_models` compiled, in pieces that a loop over samples calls: mix and move, observe, weigh.

For observations of independent noise, each a row of slopes taken in one at a time, so that nothing is inverted, and for states
of levels, each with a speed, and of constants: one sample later, with white noise of variance walk^2 on a level and drift^2 on a
speed,

    level += speed,    noise drift^2 [[1/3, 1/2], [1/2, 1]] on level and speed,    walk^2 on the level;

a model without drift has no speed: its speeds are zero. `transitions` gives the same as matrices for the plain step.

This module imports numba and so is imported where it is used. numba's cache does not notice an edit here in what it keeps of
loops of other modules; they take `STAMP` in as a variable of an enclosing function, which is part of the cache's key.
"""

import hashlib
import inspect
import math
import sys
from typing import NamedTuple

import numpy as np
from numba import njit

from millcal.numerics.interacting_models import Model

STAMP = int(hashlib.sha256(inspect.getsource(sys.modules[__name__]).encode()).hexdigest()[:15], 16)


class Motions(NamedTuple):
    """How each model moves the levels; constants rest in all of them."""

    level: np.ndarray  # (level,) int: index of each level among the states
    speed: np.ndarray  # (level,) int: index of its speed
    walk: np.ndarray  # (model,) standard deviation per sample, of a level
    drift: np.ndarray  # (model,) of a speed; 0: none


def transitions(motions: Motions, states: int) -> list[Model]:
    """The models as matrices."""
    models = []
    for walk, drift in zip(motions.walk, motions.drift, strict=True):
        F, Q = np.eye(states), np.zeros((states, states))
        for level, speed in zip(motions.level, motions.speed, strict=True):
            F[level, speed], F[speed, speed] = (1.0, 1.0) if drift > 0 else (0.0, 0.0)
            Q[np.ix_([level, speed], [level, speed])] = drift**2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
            Q[level, level] += walk**2
        models.append(Model(F, Q))
    return models


@njit(cache=True)
def move(  # type: ignore[no-untyped-def]
    mean, covariance, probability, chances, level, speed, walk, drift, mixed_mean, mixed_covariance, prior, centre
):
    """Mixes and moves all models; what they foretell goes into `mixed_*`, its mean over the models into `centre`."""
    models, n = mean.shape
    for j in range(models):
        total = 0.0
        for i in range(models):
            total += probability[i] * chances[i, j]
        prior[j] = total
    for j in range(models):
        x, P = mixed_mean[j], mixed_covariance[j]
        for a in range(n):
            total = 0.0
            for i in range(models):
                total += probability[i] * chances[i, j] * mean[i, a]
            x[a] = total / prior[j]
        for a in range(n):
            for b in range(a + 1):
                P[a, b] = 0.0
        for i in range(models):
            share = probability[i] * chances[i, j] / prior[j]
            C, y = covariance[i], mean[i]
            for a in range(n):
                scaled = share * (y[a] - x[a])
                for b in range(a + 1):
                    P[a, b] += share * C[a, b] + scaled * (y[b] - x[b])
        for a in range(n):
            for b in range(a):
                P[b, a] = P[a, b]
        q, moves = drift[j] ** 2, drift[j] > 0.0
        for d in range(level.size):
            l, v = level[d], speed[d]
            if moves:
                x[l] += x[v]
                for b in range(n):
                    P[l, b] += P[v, b]
                for b in range(n):
                    P[b, l] += P[b, v]
                P[l, l] += q / 3
                P[l, v] += q / 2
                P[v, l] += q / 2
                P[v, v] += q
            else:
                x[v] = 0.0
                for b in range(n):
                    P[v, b] = 0.0
                    P[b, v] = 0.0
            P[l, l] += walk[j] ** 2
    for a in range(n):
        total = 0.0
        for j in range(models):
            total += prior[j] * mixed_mean[j, a]
        centre[a] = total


@njit(cache=True)
def take_in(mean, covariance, value, slopes, variance, scratch):  # type: ignore[no-untyped-def]
    """One row of one model, in place: value = slopes x + noise. Trailing states have no slope.   returns its log-likelihood"""
    n, seen = mean.size, slopes.size
    S, v = variance, value
    for a in range(n):
        total = 0.0
        for b in range(seen):
            total += covariance[a, b] * slopes[b]
        scratch[a] = total
    for b in range(seen):
        S += slopes[b] * scratch[b]
        v -= slopes[b] * mean[b]
    gain = v / S
    for a in range(n):
        mean[a] += scratch[a] * gain
    for a in range(n):
        scaled = scratch[a] / S
        for b in range(a + 1):
            covariance[a, b] -= scaled * scratch[b]
            covariance[b, a] = covariance[a, b]
    return -0.5 * (v * gain + math.log(2 * math.pi * S))


@njit(cache=True)
def weigh(prior, log_likelihood, probability):  # type: ignore[no-untyped-def]
    """The models' probabilities after an observation, in place.   returns its log-likelihood over all models"""
    top = -np.inf
    for j in range(prior.size):
        probability[j] = math.log(prior[j]) + log_likelihood[j]
        top = max(top, probability[j])
    total = 0.0
    for j in range(prior.size):
        probability[j] = math.exp(probability[j] - top)
        total += probability[j]
    for j in range(prior.size):
        probability[j] /= total
    return top + math.log(total)


@njit(cache=True)
def foretold_variance(means, covariances, prior, centre, slopes, variance):  # type: ignore[no-untyped-def]
    """Of one row's innovation about the common mean: noise, every model's own doubt, and the spread between models."""
    total = variance
    for j in range(prior.size):
        quadratic, apart = 0.0, 0.0
        for a in range(slopes.size):
            row = 0.0
            for b in range(slopes.size):
                row += covariances[j, a, b] * slopes[b]
            quadratic += slopes[a] * row
            apart += slopes[a] * (means[j, a] - centre[a])
        total += prior[j] * (quadratic + apart * apart)
    return total
