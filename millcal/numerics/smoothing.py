"""Parameters that change over a record, seen through a nonlinear model: the iterated smoother and all it takes to trust it.

The record is linearised about the present trajectory, smoothed, and linearised again (Gauss-Newton): the minimum of
|measured - predicted|^2 + penalty of the trend model, in O(steps). Around that one step stand

    scales      how fast things may change, by the innovations' likelihood with its exact score, then averaged over a grid,
                because a scale that is itself uncertain makes intervals too short
    jumps       the Bayes factor of a shock at every step comes with a pass of the smoother; the best is put in, kept if the
                evidence pays for its position, moved, and taken out again if it no longer does
    models      independent trends or a shared one (`trend_models`): the larger evidence
    blocks      steps whose parameters are taken as equal are compressed to as many observations as there are parameters
                by a QR factorisation, which loses nothing else

`smooth` does all of this; the steps are functions of their own.

References
----------
.. [deJong1988] P. de Jong, A cross-validation filter for time series models, Biometrika 75 (1988) 594-600.
.. [Koopman1992] S. J. Koopman, N. Shephard, Exact score for time series models in state space form, Biometrika 79 (1992) 823-826.
.. [Bell1994] B. M. Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optim. 4 (1994) 626-636.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from millcal.numerics.state_space import (
    Filtered,
    Observed,
    Smoothed,
    filter_states,
    motion_penalty,
    shock_evidence,
    smooth_states,
)
from millcal.numerics.trend_models import TrendModel

CONVERGED = 0.01  # what another pass promises to take off the penalised squares: the tenth of a standard deviation
NEARLY = 1.0  # a promise below this that is not kept is the grain of the model (nodes that come and go), not a way down
PASSES = 20  # of Gauss-Newton at most
HALVINGS = 8
SLOW = 0.03  # scale of a trend that cannot swallow a jump
MOST_JUMPS = 8
AT_ODDS = 3.5  # standard deviations by which a block's own residual may exceed what is usual
LEAST_WEIGHT = 1e-6  # of a scale, to be counted in the average
LEAST_GAIN = 1.0  # of a jump at given scales, below which none is tried
DOUBT = 3.0  # a guess of the evidence that misses by less than this is worth a fit
REACH = 60  # steps to either side over which the place of a jump is refined

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
        return self.log_likelihood - _price(self, self.jumps)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Parameters over the record with their uncertainty, averaged over the scales."""

    fit: TrendFit
    block_mean: np.ndarray  # (block, parameter)
    block_covariance: np.ndarray  # (block, parameter, parameter)
    evidence: dict[str, float]  # of each model that was tried
    alternatives: dict[str, TrendFit]

    @property
    def mean(self) -> np.ndarray:
        """(step, parameter)"""
        return self.block_mean[self.fit.problem.block]

    @property
    def covariance(self) -> np.ndarray:
        """(step, parameter, parameter)"""
        return self.block_covariance[self.fit.problem.block]


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


def _price(fit: TrendFit, jumps: Sequence[int]) -> float:
    """Log of the places that each jump might have taken."""
    return len(jumps) * float(np.log(len(fit.problem.measured)))


def _put(seen: Observed, model: TrendModel, jumps: Sequence[int]) -> None:
    seen.shock[list(jumps)] = model.shock


def _with_shocks(fit: TrendFit, jumps: Sequence[int]) -> Observed:
    """What was seen, with other jumps."""
    seen = fit.seen._replace(shock=np.zeros_like(fit.seen.shock))
    _put(seen, fit.model, jumps)
    return seen


def likeliest(fit: TrendFit, rounds: int = 2) -> TrendFit:
    """The scales that maximise the innovations' likelihood, linearised again in between."""
    for _ in range(rounds):
        scales, _evidence = _guessed(fit, fit.jumps, fit.scales)
        moved = np.abs(np.log10(scales / fit.scales)).max()
        fit = fit_at(fit.problem, fit.model, scales, fit.jumps, start=fit)
        if moved < 0.02:
            break
    return fit


def _guessed(fit: TrendFit, jumps: Sequence[int], start: np.ndarray) -> tuple[np.ndarray, float]:
    """The likeliest scales and the evidence with these jumps, by the linearisation that is there.

    start : scales to begin with, (scale,); a faint pull to them keeps flat directions in place
    """
    from scipy.optimize import minimize

    model, seen, begin = fit.model, _with_shocks(fit, jumps), np.log10(start)

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
    return 10.0**found.x, -float(found.fun) - _price(fit, jumps)


def usual_scales(model: TrendModel, trend: float = 1.0, walk: float = 0.03) -> np.ndarray:
    """Scales to begin with: one for every trend, one for every walk."""
    is_trend = np.array([tuple(box) == tuple(model.box[0]) for box in model.box])
    return np.where(is_trend, trend, walk)


def find_jumps(fit: TrendFit, *, reach: int = REACH) -> TrendFit:
    """Put in jumps that the evidence pays for, move them to where they are best, and take out those that no longer pay.

    They are looked for in the linearised record, from the likeliest scales and, where that leads nowhere, from a trend too
    slow to swallow a jump; what promises to pay is fitted.
    reach : blocks to either side over which a place is refined
    """
    slow = np.where(usual_scales(fit.model, 1.0, 0.0) > 0, np.minimum(fit.scales, SLOW), fit.scales)
    for scales in (None, slow):
        while len(fit.jumps) < MOST_JUMPS:
            found = _promising(fit, fit.scales if scales is None else scales)
            if found is None:
                break
            likely, jumps = found
            candidate = likeliest(fit_at(fit.problem, fit.model, likely, jumps, start=fit), 1)
            if candidate.evidence <= fit.evidence:
                break
            fit = candidate
    return _pruned(_refined(fit, reach))


def _promising(fit: TrendFit, scales: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]] | None:
    """Jumps that are put in one by one, the best at these scales, as long as they pay there or at the likeliest scales.

    Of jumps that undo each other the first alone does not pay at the likeliest scales; with slow trends it does.
    returns the likeliest scales and the jumps of the largest evidence, None where it does not come near that of the fit
    """
    jumps, likely, best = fit.jumps, fit.scales, None
    most = fit.evidence - DOUBT
    while len(jumps) < MOST_JUMPS:
        seen, intensity = _with_shocks(fit, jumps), scales[fit.model.scale_of]
        filtered = filter_states(fit.model.dynamics, intensity, seen)
        smoothed = smooth_states(fit.model.dynamics, intensity, seen, filtered, covariance=False)
        gain = shock_evidence(smoothed, fit.model.shock)
        gain[[0, *jumps]] = -np.inf
        at = int(np.argmax(gain))
        if gain[at] < LEAST_GAIN:
            break
        jumps = tuple(sorted((*jumps, at)))
        likely, evidence = _guessed(fit, jumps, likely)
        if evidence > most:
            best, most = (likely, jumps), evidence
        elif gain[at] < _price(fit, (at,)):
            break
    return best


def _refined(fit: TrendFit, reach: int) -> TrendFit:
    """Each jump where its Bayes factor is largest, all others in place; twice."""
    for _ in range(2):
        jumps = list(fit.jumps)
        for number, at in enumerate(fit.jumps):
            others = [*jumps[:number], *jumps[number + 1 :]]
            seen = _with_shocks(fit, others)
            intensity = fit.scales[fit.model.scale_of]
            filtered = filter_states(fit.model.dynamics, intensity, seen)
            smoothed = smooth_states(fit.model.dynamics, intensity, seen, filtered, covariance=False)
            low = max(at - reach, 1)
            gain = shock_evidence(smoothed, fit.model.shock)[low : at + reach + 1].copy()
            taken = [other - low for other in others if low <= other < low + len(gain)]
            gain[taken] = -np.inf
            jumps[number] = low + int(np.argmax(gain))
        if tuple(sorted(jumps)) == fit.jumps:
            break
        moved = fit_at(fit.problem, fit.model, fit.scales, sorted(jumps), start=fit)
        if moved.evidence <= fit.evidence:
            break
        fit = moved
    return fit


def _pruned(fit: TrendFit) -> TrendFit:
    """Without the jumps whose evidence does not pay for their place."""
    while fit.jumps:
        without = []
        for i in range(len(fit.jumps)):
            others = (*fit.jumps[:i], *fit.jumps[i + 1 :])
            scales, evidence = _guessed(fit, others, fit.scales)
            if evidence > fit.evidence - DOUBT:
                without.append(likeliest(fit_at(fit.problem, fit.model, scales, others, start=fit), 1))
        best = max([fit, *without], key=lambda candidate: candidate.evidence)
        if best is fit:
            break
        fit = best
    return fit


def averaged(fit: TrendFit) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the parameters over the scales, weighted by their evidence.

    The scales of one group (a direction) vary together while the others stay at their likeliest; what each group adds to
    mean and covariance is summed.   returns (block, parameter), (block, parameter, parameter)
    """
    model = fit.model
    here = _smoothed_at(fit, fit.scales)
    mean, covariance = here.mean.copy(), here.covariance.copy()
    for group in model.groups:
        choices = []
        for values in product(*(grid for _, grid in group)):
            scales = fit.scales.copy()
            scales[[index for index, _ in group]] = values
            choices.append(scales)
        log_weight = np.array([_filtered_at(fit, scales).log_likelihood for scales in choices])
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        shift, spread = np.zeros_like(mean), np.zeros_like(covariance)
        for w, scales in zip(weight, choices, strict=True):
            if w > LEAST_WEIGHT:
                there = _smoothed_at(fit, scales)
                away = there.mean - here.mean
                shift += w * away
                spread += w * (there.covariance - here.covariance + away[:, :, np.newaxis] * away[:, np.newaxis])
        mean += shift
        covariance += spread - shift[:, :, np.newaxis] * shift[:, np.newaxis]
    G = model.slopes(mean)
    return model.parameters(mean), G @ covariance @ G.transpose(0, 2, 1)


def _filtered_at(fit: TrendFit, scales: np.ndarray) -> Filtered:
    return filter_states(fit.model.dynamics, scales[fit.model.scale_of], fit.seen)


def _smoothed_at(fit: TrendFit, scales: np.ndarray) -> Smoothed:
    return smooth_states(fit.model.dynamics, scales[fit.model.scale_of], fit.seen, _filtered_at(fit, scales))


def jump_sizes(fit: TrendFit) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """Each jump: its block, the change of the parameters, its covariance, and the log Bayes factor against its absence."""
    found = []
    for at in fit.jumps:
        D = np.diag(fit.model.shock)
        G = fit.model.slopes(fit.state[at : at + 1])[0]
        r, N = fit.smoothed.r[at], fit.smoothed.N[at]
        others = tuple(other for other in fit.jumps if other != at)
        without = fit_at(fit.problem, fit.model, fit.scales, others, start=fit)
        factor = fit.log_likelihood - without.log_likelihood
        found.append((at, G @ D @ r, G @ (D - D @ N @ D) @ G.T, factor))
    return found


def smooth(
    problem: Problem,
    models: Sequence[TrendModel],
    *,
    block: int = 14,
    breaks: np.ndarray | None = None,
    finest: int = 4000,
    jumps: bool = True,
    start: np.ndarray | None = None,
    limits: np.ndarray | None = None,
    tell: Callable[[float, str], None] | None = None,
) -> Trajectory:
    """The trajectory under the model with the largest evidence.

    block : steps that share their parameters while scales, jumps and models are looked for
    breaks : (step,) bool, where a block must end
    finest : records of no more steps are in the end fitted with a block for every step; of longer ones only the steps near
        a jump, so that it comes to its step
    start : parameters to begin with, (parameter,); the prior's mean when absent
    limits : (parameter,) largest change of a parameter in one pass; the models' own when absent
    """
    tell = tell or (lambda share, label: None)
    if limits is not None:
        models = [model._replace(limits=np.asarray(limits)) for model in models]
    coarse = problem._replace(block=blocks_of(problem.time, block, breaks)) if block > 1 else problem
    fits: dict[str, TrendFit] = {}
    for number, model in enumerate(models):
        tell(number / len(models) * 0.8, f"{model.name} trend")
        x = None if start is None else np.tile(model.begin(start), (int(coarse.block[-1]) + 1, 1))
        fit = likeliest(fit_at(coarse, model, usual_scales(model), start=x))
        if jumps:
            tell((number + 0.4) / len(models) * 0.8, f"{model.name} trend, jumps")
            at_odds = _at_odds(fit) if number == 0 else np.zeros(0, np.int64)
            if len(at_odds):
                fit = likeliest(_reblocked(fit, np.isin(coarse.block, at_odds)), 1)
                coarse = fit.problem
            fit = find_jumps(fit, reach=max(1, -(-REACH // block)))
        fits[model.name] = fit
    best = max(fits.values(), key=lambda fit: fit.evidence)
    if coarse.block[-1] + 1 < len(problem.time) and (best.jumps or len(problem.time) <= finest):
        tell(0.8, "to the sample")
        best = _sharpened(best, len(problem.time) <= finest)
    tell(0.9, "averaging over the scales")
    mean, covariance = averaged(best)
    evidence = {name: fit.evidence for name, fit in fits.items()}
    return Trajectory(best, mean, covariance, evidence, fits)


def _at_odds(fit: TrendFit) -> np.ndarray:
    """Blocks that no parameters explain as others are explained: there may be a jump within.   returns blocks, sorted"""
    count = np.bincount(fit.problem.block)
    if count.max() == 1:
        return np.zeros(0, np.int64)
    freedom = np.maximum(count * fit.problem.measured.shape[1] - len(fit.model.limits), 0)
    unexplained = fit.seen.value[:, -1] ** 2
    usual = np.median(unexplained[freedom > 0] / freedom[freedom > 0]) if np.any(freedom) else 1.0
    excess = (unexplained / max(usual, 1e-300) - freedom) / np.sqrt(2 * np.maximum(freedom, 1))
    worst = np.argsort(excess)[-2 * MOST_JUMPS :]
    return np.sort(worst[(excess[worst] > AT_ODDS) & (freedom[worst] > 0)])


def _reblocked(fit: TrendFit, alone: np.ndarray) -> TrendFit:
    """The same fit with a block of its own for some steps.   alone : (step,) bool"""
    old = fit.problem.block
    first = np.diff(old, prepend=-1) != 0
    opens = first | alone | np.concatenate([[False], alone[:-1]])
    block = np.cumsum(opens) - 1
    jumps = tuple(int(block[at]) for at in np.flatnonzero(first)[list(fit.jumps)])
    problem = fit.problem._replace(block=block)
    return fit_at(problem, fit.model, fit.scales, jumps, start=fit.state[old[opens]])


def _sharpened(fit: TrendFit, every: bool) -> TrendFit:
    """The same fit with a block for every step, or only for those near a jump, so that the jump comes to its step."""
    alone = np.full(len(fit.problem.block), every)
    for at in np.searchsorted(fit.problem.block, fit.jumps):
        alone[max(at - REACH, 0) : at + REACH + 1] = True
    best = _reblocked(fit, alone)
    if best.jumps:
        best = _pruned(_refined(best, REACH))
    return likeliest(best, 1)


def draw_deviations(fit: TrendFit, rng: np.random.Generator, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """How far the truth may lie from the fit, as draws of whole trajectories, at the fit's scales.

    A trajectory and a record of it are drawn from the model and smoothed like the record itself; what the smoother misses
    is a draw of its error [Durbin & Koopman, Biometrika 89 (2002) 603].
    returns errors of the states (draw, block, state), and of the shocks at the jumps (draw, jump, state)
    """
    dynamics, seen = fit.model.dynamics, fit.seen
    steps, n = fit.state.shape
    intensity = fit.scales[fit.model.scale_of]
    level_of = {int(speed): int(level) for level, speed in dynamics.speeds}
    values, vectors = np.linalg.eigh(dynamics.start_covariance)
    x = (rng.standard_normal((draws, n)) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    truth, shocks = np.empty((draws, steps, n)), np.zeros((draws, len(fit.jumps), n))
    for k in range(steps):
        dt = float(seen.interval[k])
        for level, speed in dynamics.speeds:
            x[:, level] += dt * x[:, speed]
        for state, q in zip(dynamics.noisy, intensity, strict=True):
            kick = q * np.sqrt(dt) * rng.standard_normal((draws, 2))
            x[:, state] += kick[:, 0]
            if int(state) in level_of:
                x[:, level_of[int(state)]] += dt * (kick[:, 0] / 2 + kick[:, 1] / np.sqrt(12))
        if k in fit.jumps:
            shock = rng.standard_normal((draws, n)) * np.sqrt(seen.shock[k])
            shocks[:, fit.jumps.index(k)] = shock
            x += shock
        truth[:, k] = x
    is_seen = np.any(seen.matrix != 0, axis=2)
    zero = dynamics._replace(start=np.zeros(n))
    for i in range(draws):
        value = np.einsum("kon,kn->ko", seen.matrix, truth[i]) + rng.standard_normal(is_seen.shape)
        record = seen._replace(value=np.where(is_seen, value, 0.0))
        smoothed = smooth_states(zero, intensity, record, filter_states(zero, intensity, record), covariance=False)
        truth[i] -= smoothed.mean
        for number, at in enumerate(fit.jumps):
            shocks[i, number] -= seen.shock[at] * smoothed.r[at]
    return truth, shocks
