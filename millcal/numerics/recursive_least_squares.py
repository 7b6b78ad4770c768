"""Recursive least squares with forgetting, for observations that see the unknowns through any function.

Each observation is linearised at the estimate before it (Gauss-Newton; Schwenzer et al. 2020, eq. 4-6, where f must be that
of x_{k-1} and the forgetting divides):

    x_k = x_{k-1} + G (y_k - f(x_{k-1})),   G = P H' (rho R + H P H')^-1,   P <- (I - G H) P / rho.

With a linear f this is, at every instant k, the minimum of

    sum_i rho^(k-i) |y_i - H_i x|^2_R + rho^k |x - x_0|^2_P0.

What is not excited is forgotten all the same: its variance grows by 1/rho at every observation, so hold the filter where
there is nothing to see. An estimate that leaves its box goes back to it the way its covariance points (`nearest`): the
unknowns that stay free follow, as if the bound had been observed. Clipping each by itself (`clip`) leaves the others at
values that fitted the data only together with the one that was clipped.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Linearised = tuple[np.ndarray, np.ndarray]  # predicted (observation,), slopes (observation, state)
Observe = Callable[[np.ndarray], Linearised]
Project = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Estimate(NamedTuple):
    """Where the recursion stands."""

    mean: np.ndarray  # (state,)
    covariance: np.ndarray  # (state, state), true where nothing is forgotten and the noise is known


class RecursiveInfo(NamedTuple):
    """What an observation told."""

    innovation: np.ndarray  # (observation,)
    innovation_covariance: np.ndarray  # (observation, observation), as predicted: H P H' / rho + R
    normalised: np.ndarray  # (observation,): innovation over its predicted standard deviation
    at_bound: np.ndarray  # (state,) bool


def step(
    state: Estimate,
    observation: np.ndarray,
    *,
    observe: Observe,
    noise: np.ndarray,
    forgetting: float = 1.0,
    limits: np.ndarray | None = None,
    projection: str | Project = "nearest",
) -> tuple[Estimate, RecursiveInfo]:
    """One observation.

    observation : (observation,)   noise : its covariance, (observation, observation)   forgetting : rho, within 0..1
    limits : lowest and highest of every state, (state, 2), infinite where there are none   projection : of `PROJECTIONS`
    """
    x, P = state.mean, state.covariance / forgetting
    predicted, H = observe(x)
    innovation = observation - predicted
    S = H @ P @ H.T + noise
    G = np.linalg.solve(S, H @ P).T
    keep = np.eye(len(x)) - G @ H
    P = keep @ P @ keep.T + G @ noise @ G.T
    P = (P + P.T) / 2
    x = x + G @ innovation
    at_bound = np.zeros(len(x), bool)
    if limits is not None:
        into = PROJECTIONS[projection] if isinstance(projection, str) else projection
        x = into(x, P, limits)
        at_bound = (x <= limits[:, 0]) | (x >= limits[:, 1])
    return Estimate(x, P), RecursiveInfo(innovation, S, innovation / np.sqrt(np.diag(S)), at_bound)


def clip(x: np.ndarray, P: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Each state by itself.   returns (state,)"""
    return np.clip(x, limits[:, 0], limits[:, 1])


def nearest(x: np.ndarray, P: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """One state after the other is set on the bound that it is farthest beyond, and those still free follow.

    Farthest in its standard deviations; each time x moves by P_i / P_ii times the way of state i, with P given the states
    set so far. Where one bound is hit this is the minimum of (x' - x) P^-1 (x' - x) within the box.
    x : (state,)   P : (state, state)   limits : (state, 2)   returns (state,)
    """
    x, P = x.copy(), P.copy()
    for _ in range(len(x)):
        way = np.clip(x, limits[:, 0], limits[:, 1]) - x
        deviation = np.sqrt(np.maximum(np.diag(P), 0.0))
        free = deviation > 0
        beyond = np.where(free, np.abs(way) / np.where(free, deviation, 1.0), 0.0)
        i = int(np.argmax(beyond))
        if beyond[i] == 0.0:
            break
        column = P[:, i] / P[i, i]
        x += column * way[i]
        P -= np.outer(column, P[i])
        P[i], P[:, i] = 0.0, 0.0
    return np.clip(x, limits[:, 0], limits[:, 1])


PROJECTIONS: dict[str, Project] = {"nearest": nearest, "clip": clip}
