"""Parameters that change over a record, seen through a nonlinear law: all that it takes to trust the iterated smoother.

    fit         `trend_fit`: the trajectory of least squares and penalty, and how fast things may change, by their likelihood
    jumps       `trend_jumps`: put in where the evidence pays for them
    models      independent trends or, where its evidence is decisively larger, a shared one (`trend_models`)
    blocks      steps whose parameters are taken as equal are compressed to as many observations as there are parameters
                by a QR factorisation, which loses nothing else
    average     over a grid of the scales, because one that is itself uncertain makes intervals too short

`smooth` does all of this; the steps are functions of their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from millcal.numerics.state_space import Filtered, Smoothed, filter_states, smooth_states
from millcal.numerics.trend_fit import Problem, TrendFit, blocks_of, fit_at, likeliest, usual_scales
from millcal.numerics.trend_jumps import REACH, blocks_at_odds, find_jumps, jump_sizes, pruned, refined
from millcal.numerics.trend_models import TrendModel

__all__ = ["Problem", "Trajectory", "TrendFit", "averaged", "draw_deviations", "jump_sizes", "smooth"]

DECISIVE = 3.0  # log odds of twenty to one
LEAST_WEIGHT = 1e-6  # of a scale, to be counted in the average


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

    models : the freest first. A stiffer one must be decisively better: it is never quite true, and of a long record, where
        both follow the force closely, its narrow intervals miss the rest
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
            at_odds = blocks_at_odds(fit) if number == 0 else np.zeros(0, np.int64)
            if len(at_odds):
                fit = likeliest(_reblocked(fit, np.isin(coarse.block, at_odds)), 1)
                coarse = fit.problem
            fit = find_jumps(fit, reach=max(1, -(-REACH // block)))
        fits[model.name] = fit
    free, *stiffer = fits.values()
    best = max(
        [free, *(fit for fit in stiffer if fit.evidence > free.evidence + DECISIVE)], key=lambda fit: fit.evidence
    )
    if coarse.block[-1] + 1 < len(problem.time) and (best.jumps or len(problem.time) <= finest):
        tell(0.8, "to the sample")
        best = _sharpened(best, len(problem.time) <= finest)
    tell(0.9, "averaging over the scales")
    mean, covariance = averaged(best)
    evidence = {name: fit.evidence for name, fit in fits.items()}
    return Trajectory(best, mean, covariance, evidence, fits)


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
        best = pruned(refined(best, REACH))
    return likeliest(best, 1)


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
