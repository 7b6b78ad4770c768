"""Whether a response comes late against the hammer: two amplifiers, two filters, two clocks.

A delay tau turns a response by e^{-s tau}, by more the higher the frequency, as no real mode does. It is one unknown more
for each output, linearised about the fit and estimated together with the poles, for what a delay would do to them alone.
"""

from collections.abc import Sequence

import numpy as np

from millcal.numerics.mode_fit import Channels, Fit, Model, columns, combined, fit_poles, sensitivity, whitened
from millcal.stages.modes.problem import Problem

STEPS = 3  # of Gauss and Newton: a delay of a sample or two is no small one at the upper end of the band
LEAST_TURN = np.radians(2.0)  # at the upper end of the band; less does no harm
SURE = 5.0  # standard deviations: they are those of the lines, which know nothing of errors that the lines share


def is_plausible(delay: np.ndarray, deviation: np.ndarray, highest: float) -> bool:
    """Whether any delay is one, and worth taking out.   delay, deviation : (output,) s   highest : Hz, of the band"""
    known = np.isfinite(delay) & np.isfinite(deviation)
    turn = 2 * np.pi * highest * np.abs(delay[known])
    return bool(np.any((turn > LEAST_TURN) & (np.abs(delay[known]) > SURE * deviation[known]) & (turn < np.pi)))


def estimate_delays(problem: Problem, fit: Fit, real: Model) -> tuple[np.ndarray, np.ndarray]:
    """Delay of each output behind the force and its standard deviation, s; nan where an output is not in the problem.

    real : the model of the fit; its modes are real, as complex ones would turn with the delay
    """
    outputs = len(problem.outputs)
    delay, deviation = np.zeros(outputs), np.full(outputs, np.nan)
    tests = problem.channels
    poles = fit.natural_frequency, fit.damping_ratio
    for _ in range(STEPS):
        own = fit_poles(tests, *poles, real, tolerance=1e-3, smallest_step=1e-3, max_steps=10)
        step, deviation = _one_step(problem, tests, own, real, outputs)
        delay += np.nan_to_num(step)
        poles = own.natural_frequency, own.damping_ratio
        tests = problem.turned(delay).channels
    return np.where(np.isfinite(deviation), delay, np.nan), deviation


def _one_step(
    problem: Problem, tests: Sequence[Channels], fit: Fit, model: Model, outputs: int
) -> tuple[np.ndarray, np.ndarray]:
    """One step towards the delays, the poles moving along.   returns step and deviation, (output,) s"""
    known = sensitivity(tests, fit, model)
    n = len(known.inverse)
    normal, gradient = np.zeros((n + outputs, n + outputs)), np.zeros(n + outputs)
    for channels, test, part, linear in zip(tests, problem.tests, known.parts, fit.linear, strict=True):
        phi, _ = columns(channels, fit.natural_frequency, fit.damping_ratio, model)
        late = whitened(channels, -channels.s[:, None] * combined(phi, linear))[..., None]
        every = np.concatenate([part.slope, late], axis=-1)
        every = every - part.basis @ (np.swapaxes(part.basis, 1, 2) @ every)
        for o, row in enumerate(test.rows[:, 0]):
            at = np.append(np.arange(n), n + row)
            normal[np.ix_(at, at)] += every[o].T @ every[o]
            gradient[at] += every[o].T @ part.residual[o]
    seen = np.append(np.ones(n, bool), np.diag(normal)[n:] > 0)
    scale = np.sqrt(np.where(seen, np.diag(normal), 1.0))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    spread = np.sqrt(np.diag(inverse) * max(fit.cost / max(fit.rows - fit.unknowns, 1), 1.0))
    step = inverse @ gradient
    return np.where(seen, step, np.nan)[n:], np.where(seen, spread, np.nan)[n:]
