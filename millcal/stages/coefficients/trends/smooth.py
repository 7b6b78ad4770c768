"""`method = smooth`: what a file allows that a stream does not, a look into the future.

The trends of `numerics.trend_models` are smoothed through the force law with runout and phase as constants, under both models
of change; the one with the larger evidence is the answer. Where the residuals exceed the noise of the air cut, the law does
not hold to the noise, and intervals are widened by what exceeds, and by how long residuals stay alike.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from millcal.numerics.smoothing import Problem, Trajectory, TrendFit, draw_deviations, smooth
from millcal.numerics.trend_models import MODELS, layout_of
from millcal.stages.coefficients.trends.problem import CutRecord, Noise, whitened

FINEST = 4000  # used samples of a record that is fitted sample by sample in the end
LONG = 20_000  # used samples from which a block lasts a whole tooth pass
MOST_BLOCKS = 6000
DRAWS = 40  # of whole trajectories, for the interval of the slope

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class SmoothedCut:
    """The trajectory at the used samples, and what the two models of change left over."""

    trajectory: Trajectory
    used: np.ndarray  # (sample,) bool
    chi2: float  # of the stiff model, mean square of the whitened residuals
    residual: np.ndarray  # (used sample, axis), whitened, of the answer


def problem_of(record: CutRecord, noise: Noise, used: np.ndarray, parameters: np.ndarray) -> Problem:
    """The used samples as a problem for the smoother, in units of the noise.

    parameters : where the slopes in the phases are taken, which hardly change   used : (sample,) bool
    """
    plain = record.memory == 0 and noise.order == 0
    here = record.of(used) if plain else record
    at = np.flatnonzero(used)
    last = np.maximum(
        np.searchsorted(at, np.arange(len(used)), "right") - 1, 0
    )  # idle samples keep the parameters before
    picked = slice(None) if plain else used
    of_phase = whitened(here, noise, here.phase_slopes(parameters))[picked]
    measured = whitened(here, noise, here.force)[picked]
    own = 2 * record.directions + 2

    def predict(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, slopes = here.response(p if plain else p[last])
        slopes = np.concatenate([whitened(here, noise, slopes)[picked], of_phase], axis=2)
        return whitened(here, noise, force)[picked], slopes

    assert of_phase.shape[2] + own == record.parameters
    time = record.time[used]
    span = max(time[-1] - time[0], 1e-12)
    return Problem(measured, predict, (time - time[0]) / span, np.arange(len(time)))


def smooth_cut(
    record: CutRecord,
    noise: Noise,
    used: np.ndarray,
    start: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray],
    *,
    jumps: bool,
    tell: Progress,
) -> SmoothedCut:
    """Both models of change, and the better one.   start : (parameter,)   prior : mean and sd, (parameter,)"""
    problem = problem_of(record, noise, used, start)
    layout = layout_of(record.directions)
    models = [make(prior[0], np.diag(prior[1] ** 2), layout) for make in MODELS.values()]
    count = len(problem.time)
    per_pass = samples_per_pass(record, used)
    block = max(1, round(per_pass / 4))
    if count > LONG:
        block = max(round(per_pass), -(-count // MOST_BLOCKS))
    breaks = np.diff(record.cut[used], prepend=record.cut[used][0]) != 0
    trajectory = smooth(problem, models, block=block, breaks=breaks, finest=FINEST, jumps=jumps, start=start, tell=tell)
    stiff = trajectory.alternatives["shared"]
    return SmoothedCut(trajectory, used, float(np.mean(_residual(stiff) ** 2)), _residual(trajectory.fit))


def samples_per_pass(record: CutRecord, used: np.ndarray) -> float:
    """Used samples from one tooth to the next, on average.   used : (sample,) bool"""
    turns = sum(
        float(np.ptp(record.passage.angle[used & (record.cut == number)])) / (2 * np.pi)
        for number in range(len(record.cuts))
        if np.any(used & (record.cut == number))
    )
    return float(used.sum()) / max(turns * record.cutter.teeth, 1.0)


def _residual(fit: TrendFit) -> np.ndarray:
    p = fit.model.parameters(fit.state)[fit.problem.block]
    return fit.problem.measured - fit.problem.predict(p)[0]


def correlation_time(residual: np.ndarray, longest: int) -> float:
    """Over how many samples residuals stay alike, 1 where they are white.   residual : (sample, axis)"""
    r = residual - residual.mean(axis=0)
    power = float(np.sum(r * r))
    total = 1.0
    for lag in range(1, min(longest, len(r) // 4)):
        alike = float(np.sum(r[:-lag] * r[lag:])) / power
        if alike <= 0.05:
            break
        total += 2 * alike
    return total


@dataclass(frozen=True, eq=False)
class Wear:
    """How the specific force changes over the whole time, without its jumps."""

    slope: np.ndarray  # (direction,) 1/s, relative
    sd: np.ndarray  # (direction,)


def wear_of(found: SmoothedCut, record: CutRecord, rng: np.random.Generator) -> Wear:
    """Least-squares line through each level less its jumps; its spread by draws of whole trajectories."""
    fit = found.trajectory.fit
    time = np.bincount(fit.problem.block, record.time[found.used]) / np.bincount(fit.problem.block)
    along = time - time.mean()
    along /= max(float(along @ along), 1e-300)
    levels = list(layout_of(record.directions).levels)
    G = fit.model.slopes(fit.state)[:, levels]
    after = [np.arange(len(time)) >= at for at in fit.jumps]
    level = found.trajectory.block_mean[:, levels].copy()
    for at, later in zip(fit.jumps, after, strict=True):
        level -= later[:, np.newaxis] * (G[at] @ (fit.model.shock * fit.smoothed.r[at]))
    states, shocks = draw_deviations(fit, rng, DRAWS)
    errors = np.einsum("bdn,ibn->ibd", G, states)
    for number, (at, later) in enumerate(zip(fit.jumps, after, strict=True)):
        errors -= later[:, np.newaxis] * (shocks[:, number] @ G[at].T)[:, np.newaxis]
    return Wear(along @ level, np.sqrt(np.mean(np.einsum("b,ibd->id", along, errors) ** 2, axis=0)))
