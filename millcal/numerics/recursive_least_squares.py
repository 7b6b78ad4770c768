"""Recursive least squares with forgetting, for observations that see the unknowns through any function.

Each observation is linearised at the estimate before it (Gauss-Newton; Schwenzer et al. 2020, eq. 4-6, where f must be that
of x_{k-1} and the forgetting divides):

    x_k = x_{k-1} + G (y_k - f(x_{k-1})),   G = P H' (rho R + H P H')^-1,   P <- (I - G H) P / rho.

With a linear f this is, at every instant k, the minimum of

    sum_i rho^(k-i) |y_i - H_i x|^2_R + rho^k |x - x_0|^2_P0.

What is not excited is forgotten all the same: its variance grows by 1/rho at every observation, without end unless a
`ceiling` is set, such as the variance at the start: more than that nobody can forget.

An estimate that leaves its box goes back to it the way its covariance points (`nearest`): the unknowns that stay free
follow, as if the bound had been observed. Clipping each by itself (`clip`) leaves the others at values that fitted the data
only together with the one that was clipped.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

Linearised = tuple[np.ndarray, np.ndarray]  # predicted (observation,), slopes (observation, state)
Observe = Callable[[np.ndarray], Linearised]
LeftOut = Callable[[np.ndarray, np.ndarray], np.ndarray]
Disc = tuple[int, float]  # the first of two neighbouring states, and the radius of the disc about 0 that holds both
Project = Callable[[np.ndarray, np.ndarray, np.ndarray, Sequence[Disc]], np.ndarray]


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
    ceiling: np.ndarray | None = None,
    left_out: LeftOut | None = None,
    limits: np.ndarray | None = None,
    discs: Sequence[Disc] = (),
    projection: str | Project = "nearest",
) -> tuple[Estimate, RecursiveInfo]:
    """One observation.

    observation : (observation,)   noise : its covariance, (observation, observation)   forgetting : rho, within 0..1
    ceiling : variances that forgetting does not go beyond, (state,); rows and columns of P are scaled down to them
    left_out : slopes (observation, state), P / rho (state, state) -> variance of what linearising leaves out,
        (observation,), which is added to the noise
    limits : lowest and highest of every state, (state, 2), infinite where there are none; None: no box and no disc
    projection : of `PROJECTIONS`, or a function
    """
    x, P = state.mean, state.covariance / forgetting
    if ceiling is not None:
        variance = np.diag(P)
        scale = np.sqrt(np.where(variance > ceiling, ceiling / np.where(variance > 0, variance, 1.0), 1.0))
        P = P * np.outer(scale, scale)
    predicted, H = observe(x)
    if left_out is not None:
        noise = noise + np.diag(left_out(H, P))
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
        x = into(x, P, limits, discs)
        at_bound = (x <= limits[:, 0]) | (x >= limits[:, 1])
        for first, radius in discs:
            at_bound[first : first + 2] |= np.hypot(x[first], x[first + 1]) >= radius * (1 - 1e-12)
    return Estimate(x, P), RecursiveInfo(innovation, S, innovation / np.sqrt(np.diag(S)), at_bound)


def clip(x: np.ndarray, P: np.ndarray, limits: np.ndarray, discs: Sequence[Disc] = ()) -> np.ndarray:
    """Each state by itself, each pair towards 0.   returns (state,)"""
    x = np.clip(x, limits[:, 0], limits[:, 1])
    for first, radius in discs:
        x[first : first + 2] *= min(1.0, radius / max(np.hypot(x[first], x[first + 1]), 1e-300))
    return x


def nearest(x: np.ndarray, P: np.ndarray, limits: np.ndarray, discs: Sequence[Disc] = ()) -> np.ndarray:
    """One state after the other is set on the bound that it is farthest beyond, and those still free follow.

    Farthest in its standard deviations; each time x moves by P_i / P_ii times the way of state i, with P given the states
    set so far. Where one bound is hit this is the minimum of (x' - x) P^-1 (x' - x) within the box. Pairs outside their disc
    are set first, on the rim straight towards 0.
    x : (state,)   P : (state, state)   limits : (state, 2)   returns (state,)
    """
    x, P = x.copy(), P.copy()

    def set_on(i: int, way: float) -> None:
        column = P[:, i] / P[i, i]
        x[:] += column * way
        P[:] -= np.outer(column, P[i])
        P[i], P[:, i] = 0.0, 0.0

    for first, radius in discs:
        distance = np.hypot(x[first], x[first + 1])
        if distance > radius:
            rim = x[first : first + 2] * radius / distance
            for i in (0, 1):
                if P[first + i, first + i] > 0:
                    set_on(first + i, rim[i] - x[first + i])
    for _ in range(len(x)):
        way = np.clip(x, limits[:, 0], limits[:, 1]) - x
        deviation = np.sqrt(np.maximum(np.diag(P), 0.0))
        is_free = deviation > 0
        beyond = np.where(is_free, np.abs(way) / np.where(is_free, deviation, 1.0), 0.0)
        i = int(np.argmax(beyond))
        if beyond[i] == 0.0:
            break
        set_on(i, way[i])
    return clip(x, P, limits, discs)


PROJECTIONS: dict[str, Project] = {"nearest": nearest, "clip": clip}
