"""How parameters may change over a record: each direction by itself, or all with one shared trend.

A direction has two parameters, a level and a shape; beside the directions there are constants. The record lasts from 0 to 1.

    independent   level_d is integrated twice from white noise (a trend), shape_d once (a walk), each with a scale of its own
    shared        level_d = k_d + c_d w, shape_d = m_d + d_d w with one trend w from w(0) = 0; c_0 = 1, and the other loadings
                  c ~ N(1, 1), d ~ N(0, .3^2) are states, so they are learned and not given

A wear that moves everything together is seen by every observation at once: where the shared trend is true its intervals
are about half as wide, and where it is not its evidence is lower.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.state_space import Dynamics

TREND_GRID = np.logspace(-2, 2, 13)  # of a trend's scale, for averaging; half as many miss a scale that is known well
WALK_GRID = np.logspace(-2.5, -0.5, 4)  # of a walk's
TREND_BOX, WALK_BOX = (-2.5, 2.5), (-3.5, 0.5)  # of their decadic logarithms, for the search of the likeliest
LEVEL_JUMP, SHAPE_JUMP = 0.25, 0.04  # standard deviation of a sudden change
LOADING, SHAPE_LOADING = 1.0, 0.3  # standard deviations of c about 1 and d about 0
LARGEST_STEP = (0.5, 0.15)  # of a level, of a shape, in one pass of Gauss-Newton
SPEED = 1.0  # standard deviation of the trend's slope over the record


class Layout(NamedTuple):
    """Which parameter is what: the levels and shapes of the directions; the rest are constants."""

    levels: tuple[int, ...]
    shapes: tuple[int, ...]


class TrendModel(NamedTuple):
    """States that move, and the parameters they stand for."""

    name: str
    dynamics: Dynamics
    scale_of: np.ndarray  # (noise,) int: which scale is the intensity of each noise
    box: np.ndarray  # (scale, 2) of log10
    groups: tuple[tuple[tuple[int, np.ndarray], ...], ...]  # for averaging: scales that vary together, with their grids
    shock: np.ndarray  # (state,) variance of a jump
    limits: np.ndarray  # (parameter,) largest change in one pass of Gauss-Newton
    begin: Callable[[np.ndarray], np.ndarray]  # parameters that do not change, (parameter,) -> state (state,)
    parameters: Callable[[np.ndarray], np.ndarray]  # (step, state) -> (step, parameter)
    slopes: Callable[[np.ndarray], np.ndarray]  # (step, state) -> (step, parameter, state)


def independent(mean: np.ndarray, covariance: np.ndarray, layout: Layout) -> TrendModel:
    """Every direction with a trend of its own.   mean, covariance : prior of the parameters, (parameter,) and its square"""
    n, D = len(mean), len(layout.levels)
    speeds = n + np.arange(D)
    start_covariance = np.zeros((n + D, n + D))
    start_covariance[:n, :n] = covariance
    start_covariance[speeds, speeds] = SPEED**2
    shock = np.zeros(n + D)
    shock[list(layout.levels)] = LEVEL_JUMP**2
    shock[list(layout.shapes)] = SHAPE_JUMP**2
    picked = np.eye(n, n + D)
    return TrendModel(
        "independent",
        Dynamics(
            np.concatenate([mean, np.zeros(D)]),
            start_covariance,
            np.stack([layout.levels, speeds], axis=1).astype(np.int64),
            np.concatenate([speeds, layout.shapes]).astype(np.int64),
        ),
        np.arange(2 * D),
        np.array([TREND_BOX] * D + [WALK_BOX] * D),
        tuple(((d, TREND_GRID), (D + d, WALK_GRID)) for d in range(D)),
        shock,
        _limits(n, layout),
        lambda p: np.concatenate([p, np.zeros(D)]),
        lambda x: x[:, :n],
        lambda x: np.broadcast_to(picked, (len(x), n, n + D)),
    )


def shared(mean: np.ndarray, covariance: np.ndarray, layout: Layout) -> TrendModel:
    """One trend for all directions, with loadings; arguments as of `independent`.

    States: w, its speed, the parameters at the start, c of all directions but the first, d of all.
    """
    n, D = len(mean), len(layout.levels)
    c = 2 + n + np.arange(D - 1)
    d = 2 + n + D - 1 + np.arange(D)
    states = 2 + n + 2 * D - 1
    start = np.zeros(states)
    start[2 : 2 + n], start[c] = mean, 1.0
    start_covariance = np.zeros((states, states))
    start_covariance[1, 1] = SPEED**2
    start_covariance[2 : 2 + n, 2 : 2 + n] = covariance
    start_covariance[c, c], start_covariance[d, d] = LOADING**2, SHAPE_LOADING**2
    shock = np.zeros(states)
    shock[0] = LEVEL_JUMP**2

    def begin(p: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[2 : 2 + n] = p
        return x

    def parameters(x: np.ndarray) -> np.ndarray:
        p, w = x[:, 2 : 2 + n].copy(), x[:, :1]
        p[:, layout.levels[:1]] += w
        p[:, layout.levels[1:]] += x[:, c] * w
        p[:, layout.shapes] += x[:, d] * w
        return p

    def slopes(x: np.ndarray) -> np.ndarray:
        G = np.zeros((len(x), n, states))
        G[:, :, 2 : 2 + n] = np.eye(n)
        G[:, layout.levels[0], 0] = 1.0
        G[:, layout.levels[1:], 0] = x[:, c]
        G[:, layout.shapes, 0] = x[:, d]
        G[:, layout.levels[1:], c] = x[:, :1]
        G[:, layout.shapes, d] = x[:, :1]
        return G

    return TrendModel(
        "shared",
        Dynamics(start, start_covariance, np.array([[0, 1]]), np.array([1])),
        np.array([0]),
        np.array([TREND_BOX]),
        (((0, TREND_GRID),),),
        shock,
        _limits(n, layout),
        begin,
        parameters,
        slopes,
    )


def _limits(parameters: int, layout: Layout) -> np.ndarray:
    limits = np.full(parameters, np.inf)
    limits[list(layout.levels)], limits[list(layout.shapes)] = LARGEST_STEP
    return limits


MODELS: dict[str, Callable[[np.ndarray, np.ndarray, Layout], TrendModel]] = {
    "independent": independent,
    "shared": shared,
}


def layout_of(directions: int) -> Layout:
    """Level and shape of each direction in turn, then constants."""
    return Layout(tuple(range(0, 2 * directions, 2)), tuple(range(1, 2 * directions, 2)))


def uniform_prior(limits: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of independent uniform distributions.   limits : (parameter,) low and high"""
    low, high = np.asarray(limits, float).T
    return (low + high) / 2, np.diag((high - low) ** 2 / 12)
