"""A trend model fitted to a record that is seen through a nonlinear law: the iterated smoother.

The record is linearised about the present trajectory, smoothed, and linearised again (Gauss-Newton): the minimum of
|measured - predicted|^2 + penalty of the trend model, in O(steps). At the minimum the likelihood of the linearised record is
Laplace's evidence, whose maximum over the scales of the trends is found by its exact score.

References
----------
.. [Bell1994] B. M. Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optim. 4 (1994) 626-636.
.. [Koopman1992] S. J. Koopman, N. Shephard, Exact score for time series models in state space form, Biometrika 79 (1992) 823-826.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.numerics.state_space import Filtered, Observed, Smoothed, filter_states, motion_penalty, smooth_states
from millcal.numerics.trend_models import TrendModel

CONVERGED = 0.01  # what another pass promises to take off the penalised squares: the tenth of a standard deviation
NEARLY = 1.0  # a promise below this that is not kept is the grain of the model (nodes that come and go), not a way down
PASSES = 20  # of Gauss-Newton at most
HALVINGS = 8

Predict = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class Problem(NamedTuple):
    """A record: what was measured at each step, and what parameters would have given, both in units of the noise."""

    measured: np.ndarray  # (step, observation)
    predict: (
        Predict  # parameters (step, parameter) -> prediction (step, observation), slopes (step, observation, parameter)
    )
    time: np.ndarray  # (step,) rising from 0 to 1
    block: np.ndarray  # (step,) int, rising from 0 without gaps: steps with equal parameters


@dataclass(frozen=True, eq=False)
class TrendFit:
    """A trend model fitted to a record, at given or at the likeliest scales."""

    model: TrendModel
    problem: Problem
    scales: np.ndarray  # (scale,)
    jumps: tuple[int, ...]  # blocks before which the states may jump
    state: np.ndarray  # (block, state)
    seen: Observed  # linearised no further than CONVERGED from there
    filtered: Filtered
    smoothed: Smoothed
    converged: bool

    @property
    def log_likelihood(self) -> float:
        return self.filtered.log_likelihood

    @property
    def evidence(self) -> float:
        """Log evidence: each jump pays ln(steps) for its place."""
        return self.log_likelihood - price(self, self.jumps)


def blocks_of(time: np.ndarray, longest: int, breaks: np.ndarray | None = None) -> np.ndarray:
    """Blocks of at most `longest` consecutive steps, never across a break.

    breaks : (step,) bool, True where a step does not follow on the one before   returns (step,) int
    """
    breaks = np.zeros(len(time), bool) if breaks is None else np.asarray(breaks)
    run = np.cumsum(breaks)
    first = np.flatnonzero(np.concatenate([[True], run[1:] != run[:-1]]))
    within = np.arange(len(time)) - np.repeat(first, np.diff(np.append(first, len(time))))
    return np.cumsum(np.concatenate([[0], (within[1:] % longest == 0).astype(np.int64)]))


def linearised(problem: Problem, model: TrendModel, state: np.ndarray) -> tuple[Observed, float]:
    """The record as linear observations of the states about a trajectory.

    state : (block, state)   returns what was seen, without shocks, and the sum of squares of the residuals
    """
    p = model.parameters(state)
    predicted, slopes = problem.predict(p[problem.block])
    residual = problem.measured - predicted
    value = residual + np.einsum("saP,sP->sa", slopes, p[problem.block])
    if len(p) < len(problem.block):
        slopes, value = _compressed(slopes, value, problem.block)
    G = model.slopes(state)
    matrix = slopes @ G
    value = value - np.einsum("boP,bP->bo", slopes, p - np.einsum("bPn,bn->bP", G, state))
    count = np.bincount(problem.block)
    time = np.bincount(problem.block, problem.time) / count
    seen = Observed(
        np.ascontiguousarray(matrix), np.ascontiguousarray(value), np.diff(time, prepend=0.0), np.zeros_like(state)
    )
    return seen, float(np.sum(residual**2))


def _compressed(slopes: np.ndarray, value: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All observations of a block as those of a triangular factor; its last row is what no parameters explain.

    returns slopes (block, parameter + 1, parameter), values (block, parameter + 1)
    """
    steps, seen, n = slopes.shape
    count = np.bincount(block)
    joined = np.concatenate([slopes, value[:, :, np.newaxis]], axis=2)
    height = max(int(count.max()) * seen, n + 1)
    if height == seen * steps / len(count):
        stacked = joined.reshape(len(count), height, n + 1)
    else:
        place = np.arange(steps) - np.repeat(np.cumsum(count) - count, count)
        stacked = np.zeros((len(count), height, n + 1))
        row = (block * height + place * seen)[:, np.newaxis] + np.arange(seen)
        stacked.reshape(-1, n + 1)[row] = joined
    R: np.ndarray = np.linalg.qr(stacked, mode="r")  # type: ignore[assignment]
    R[:, n, :n] = 0.0
    return R[:, :, :n], R[:, :, n]


def fit_at(
    problem: Problem,
    model: TrendModel,
    scales: np.ndarray,
    jumps: Sequence[int] = (),
    *,
    start: "np.ndarray | TrendFit | None" = None,
) -> TrendFit:
    """Gauss-Newton at given scales. Every pass lowers what is minimised, and the last finds no more to gain.

    start : where to begin, (block, state), or a fit of the same problem whose linearisation serves once more
    """
    intensity = np.asarray(scales)[model.scale_of]
    if isinstance(start, TrendFit) and start.converged and start.problem is problem:
        x, seen = start.state, start.seen._replace(shock=np.zeros_like(start.state))
        misfit = float(np.sum((seen.value - np.einsum("bon,bn->bo", seen.matrix, x)) ** 2))
    else:
        given = start.state if isinstance(start, TrendFit) else start
        blocks = int(problem.block[-1]) + 1
        x = np.broadcast_to(model.dynamics.start, (blocks, len(model.dynamics.start))) if given is None else given
        seen, misfit = linearised(problem, model, x)
    _put(seen, model, jumps)
    cost = misfit + motion_penalty(model.dynamics, intensity, seen, x)
    for left in range(PASSES, -1, -1):
        filtered = filter_states(model.dynamics, intensity, seen)
        smoothed = smooth_states(model.dynamics, intensity, seen, filtered, covariance=False)
        promised = float(np.sum(filtered.innovation**2 / filtered.innovation_variance))
        converged = cost - promised < CONVERGED
        if converged or not left:
            break
        change = np.abs(model.parameters(smoothed.mean) - model.parameters(x)).max(axis=0)
        share = min(1.0, float(np.min(model.limits / np.maximum(change, 1e-12))))
        for _halving in range(HALVINGS):
            new = x + share * (smoothed.mean - x)
            there, misfit = linearised(problem, model, new)
            _put(there, model, jumps)
            lower = misfit + motion_penalty(model.dynamics, intensity, there, new)
            if lower < cost or cost - promised < NEARLY:
                break
            share /= 2
        if not lower < cost:  # nor where the model has no value there
            converged = cost - promised < NEARLY
            break
        x, seen, cost = new, there, lower
    state = smoothed.mean if converged else x
    return TrendFit(model, problem, np.asarray(scales), tuple(jumps), state, seen, filtered, smoothed, converged)


def price(fit: TrendFit, jumps: Sequence[int]) -> float:
    """Log of the places that each jump might have taken."""
    return len(jumps) * float(np.log(len(fit.problem.measured)))


def _put(seen: Observed, model: TrendModel, jumps: Sequence[int]) -> None:
    seen.shock[list(jumps)] = model.shock


def with_jumps(fit: TrendFit, jumps: Sequence[int]) -> Observed:
    """What was seen, with other jumps."""
    seen = fit.seen._replace(shock=np.zeros_like(fit.seen.shock))
    _put(seen, fit.model, jumps)
    return seen


def likeliest(fit: TrendFit, rounds: int = 2) -> TrendFit:
    """The scales that maximise the innovations' likelihood, linearised again in between."""
    for _ in range(rounds):
        scales, _evidence = guessed(fit, fit.jumps, fit.scales)
        moved = np.abs(np.log10(scales / fit.scales)).max()
        fit = fit_at(fit.problem, fit.model, scales, fit.jumps, start=fit)
        if moved < 0.02:
            break
    return fit


def guessed(fit: TrendFit, jumps: Sequence[int], start: np.ndarray) -> tuple[np.ndarray, float]:
    """The likeliest scales and the evidence with these jumps, by the linearisation that is there.

    start : scales to begin with, (scale,); a faint pull to them keeps flat directions in place
    """
    from scipy.optimize import minimize

    model, seen, begin = fit.model, with_jumps(fit, jumps), np.log10(start)

    def cost(log_scale: np.ndarray) -> tuple[float, np.ndarray]:
        intensity = (10.0**log_scale)[model.scale_of]
        filtered = filter_states(model.dynamics, intensity, seen)
        smoothed = smooth_states(model.dynamics, intensity, seen, filtered, covariance=False)
        score = np.log(10) * np.bincount(model.scale_of, smoothed.score, minlength=len(log_scale))
        pull = (log_scale - begin) / 25
        return -filtered.log_likelihood + 0.5 * float(pull @ (log_scale - begin)), pull - score

    found = minimize(
        cost,
        np.clip(begin, *model.box.T),
        jac=True,
        bounds=model.box,
        method="L-BFGS-B",
        options={"maxiter": 25, "ftol": 1e-7},
    )
    return 10.0**found.x, -float(found.fun) - price(fit, jumps)


def usual_scales(model: TrendModel, trend: float = 1.0, walk: float = 0.03) -> np.ndarray:
    """Scales to begin with: one for every trend, one for every walk."""
    is_trend = np.array([tuple(box) == tuple(model.box[0]) for box in model.box])
    return np.where(is_trend, trend, walk)
