"""Whether a response comes late against the hammer: two amplifiers, two filters, two clocks.

A delay tau turns a response by e^{-s tau}, by more the higher the frequency, as no real mode does. It is one unknown more
for each output, linearised about the fit and estimated together with the poles, for what a delay would do to them alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.jackknife import jackknife_covariance
from millcal.numerics.mode_fit import Fit, Model, Sensitivity, columns, combined, fit_poles, sensitivity, whitened
from millcal.stages.modes.intervals import can_leave_hits_out, hits_of, residual_without
from millcal.stages.modes.problem import Problem

STEPS = 3  # of Gauss and Newton: a delay of a sample or two is no small one at the upper end of the band
LEAST_TURN = np.radians(2.0)  # at the upper end of the band; less does no harm
SURE = 5.0  # standard deviations


def is_plausible(delay: np.ndarray, deviation: np.ndarray, highest: float) -> bool:
    """Whether any delay is one, and worth taking out.   delay, deviation : (output,) s   highest : Hz, of the band"""
    known = np.isfinite(delay) & np.isfinite(deviation)
    turn = 2 * np.pi * highest * np.abs(delay[known])
    return bool(np.any((turn > LEAST_TURN) & (np.abs(delay[known]) > SURE * deviation[known]) & (turn < np.pi)))


def estimate_delays(problem: Problem, fit: Fit, real: Model) -> tuple[np.ndarray, np.ndarray]:
    """Delay of each output behind the force and its standard deviation, s; nan where an output is not in the problem.

    real : the model of the fit; its modes are real, as complex ones would turn with the delay
    """
    delay, in_time = np.zeros(len(problem.outputs)), problem
    poles = fit.natural_frequency, fit.damping_ratio
    for _ in range(STEPS):
        own = fit_poles(in_time.channels, *poles, real, tolerance=1e-3, smallest_step=1e-3, max_steps=10)
        linear = _linearised(in_time, own, real)
        delay = delay + linear.step([part.residual for part in linear.known.parts])
        poles = own.natural_frequency, own.damping_ratio
        before, in_time = in_time, problem.turned(delay)
    deviation = linear.deviation
    if can_leave_hits_out(problem):
        deviation = _deviation_by_hit(before, own, real, linear)
    return np.where(linear.seen, delay, np.nan), np.where(linear.seen, deviation, np.nan)


class _Linearised(NamedTuple):
    """How delays and poles follow the residual, about a fit."""

    known: Sensitivity
    free: tuple[
        np.ndarray, ...
    ]  # of each test: derivatives by the poles and its outputs' delays, (output, row, 2 mode + 1)
    places: tuple[np.ndarray, ...]  # outputs of the FRF that these delays belong to
    inverse: np.ndarray  # of the normal matrix, (2 mode + output, ...)
    seen: np.ndarray  # (output,) whether an output is in any test
    deviation: np.ndarray  # (output,) s, by the scatter of the lines

    def step(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """The delays that explain residuals of the tests, the poles moving along.   returns (output,) s"""
        n = len(self.known.inverse)
        gradient = np.zeros(len(self.inverse))
        for free, rows, residual in zip(self.free, self.places, residuals, strict=True):
            along = np.einsum("ork,or->ok", free, residual)
            gradient[:n] += along[:, :n].sum(axis=0)
            np.add.at(gradient, n + rows, along[:, n])
        return (self.inverse @ gradient)[n:]


def _linearised(problem: Problem, fit: Fit, model: Model) -> _Linearised:
    known = sensitivity(problem.channels, fit, model)
    n, outputs = len(known.inverse), len(problem.outputs)
    normal = np.zeros((n + outputs, n + outputs))
    every, places = [], []
    for test, part, linear in zip(problem.tests, known.parts, fit.linear, strict=True):
        channels, rows = test.channels, test.rows[:, 0]
        phi, _ = columns(channels, fit.natural_frequency, fit.damping_ratio, model)
        late = whitened(channels, -channels.s[:, None] * combined(phi, linear))[..., None]
        free = np.concatenate([part.slope, late], axis=-1)
        free = free - part.basis @ (np.swapaxes(part.basis, 1, 2) @ free)
        for own, row in zip(free, rows, strict=True):
            at = np.append(np.arange(n), n + row)
            normal[np.ix_(at, at)] += own.T @ own
        every.append(free)
        places.append(rows)
    seen = np.append(np.ones(n, bool), np.diag(normal)[n:] > 0)
    scale = np.sqrt(np.where(seen, np.diag(normal), 1.0))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    spread = np.sqrt(np.diag(inverse) * max(fit.cost / max(fit.rows - fit.unknowns, 1), 1.0))
    return _Linearised(known, tuple(every), tuple(places), inverse, seen[n:], spread[n:])


def _deviation_by_hit(problem: Problem, fit: Fit, model: Model, linear: _Linearised) -> np.ndarray:
    """Standard deviation of the delays by leaving out one hit after the other.   returns (output,) s"""
    steps: dict[int, list[np.ndarray]] = {}
    for places in hits_of(problem):
        residuals = [part.residual for part in linear.known.parts]
        for number, hit in places:
            residuals[number] = residual_without(problem, number, hit, fit, model)
        steps.setdefault(places[0][0], []).append(linear.step(residuals))
    variance = [np.diag(jackknife_covariance(np.array(own))) for own in steps.values()]
    return np.sqrt(np.sum(variance, axis=0))
