"""The noise-weighted fit of the law: angles and runout searched all round, then everything at once.

An angle that nobody knows has several minima, and so has the runout. Every trial gets the coefficients that suit it best, by
weighted least squares with the covariance of the force as it is without the law; the best are followed to their minimum.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from millcal.errors import IllPosedError
from millcal.numerics.errors_in_variables import STEPS, Fit, fit_errors_in_variables, parts, residual_covariance
from millcal.numerics.linear_inverse import as_real
from millcal.stages.forces.law import USUAL_RUNOUT, Law
from millcal.stages.forces.problem import Problem

TRIALS = 12  # angles over a period of the highest line, whose minima are the narrowest
FOLLOWED = 3  # of them, to their minimum,
HOPEFUL = 2.0  # where chi-square is at most so many times the best one's
RUNOUTS = (2e-6, 6e-6, 15e-6)  # m, tried in eight directions
ALIKE = 6.0  # of chi-square: what lies closer than this to the best is as good
APART = np.radians(5.0)  # of two angles that are not one
PENALTY = 12.0  # of chi-square, for coefficients of a tool that pulls itself into the work


@dataclass(frozen=True, eq=False)
class LawFit:
    """The law fitted to the lines."""

    fit: Fit
    law: Law
    phases: np.ndarray  # (cut,) rad
    phase_sd: np.ndarray  # (cut,); 0 where it was not fitted
    common_phase: tuple[float, float] | None  # rad, of the cuts that count as the first one does, and its deviation
    runout: tuple[float, float] | None  # m, c0 and s0
    runout_sd: tuple[float, float] | None
    ambiguous: tuple[float, ...]  # rad: other angles of the first cut that are as good


class Weighted(NamedTuple):
    """The lines with the weights that the force has without the law."""

    matrix: np.ndarray  # (2 line row, 2 line axis), of the parts
    data: np.ndarray  # (2 line row,)

    def solve(self, slopes: np.ndarray) -> tuple[np.ndarray, float]:
        """Unknowns of slopes (line, axis, unknown), and chi-square."""
        A = self.matrix @ parts(slopes)
        z = np.linalg.lstsq(A, self.data, rcond=None)[0]
        return z, float(np.sum((self.data - A @ z) ** 2))


def weighted_lines(problem: Problem) -> Weighted:
    """All lines over the root of the residual's covariance at the free force."""
    covariance = residual_covariance(problem.noise, problem.error, free_force(problem))
    root = np.linalg.cholesky(covariance)
    lines, rows, axes = problem.matrix.shape
    blocks = np.zeros((lines, rows, lines, axes), complex)
    blocks[np.arange(lines), :, np.arange(lines), :] = problem.matrix
    whole = as_real(blocks.reshape(lines * rows, lines * axes))
    return Weighted(
        matrix=solve_triangular(root, whole, lower=True, check_finite=False),
        data=solve_triangular(root, parts(problem.measured), lower=True, check_finite=False),
    )


def free_force(problem: Problem) -> np.ndarray:
    """Force of every line by itself, by least squares weighted with the noise of the cut.   returns (line, axis)"""
    force = np.empty(problem.matrix.shape[::2], complex)
    for line, (A, y, noise) in enumerate(zip(problem.matrix, problem.measured, problem.noise, strict=True)):
        floor = 1e-9 * np.trace(noise).real + 1e-300
        root = np.linalg.cholesky(noise + floor * np.eye(len(noise)))
        force[line] = np.linalg.lstsq(np.linalg.solve(root, A), np.linalg.solve(root, y), rcond=None)[0]
    return force


def fit_law(problem: Problem, law: Law) -> LawFit:
    """The most likely coefficients, angles and runout.

    Raises
    ------
    IllPosedError
        The lines do not tell the coefficients apart.
    """
    n, angles = law.sizes
    choices = [_best_angles(problem, law, i) for i in range(angles)]
    first = np.array([own[0] for own in choices])
    trials = [first]
    for i, own in enumerate(choices):
        for other in own[1:]:
            trials.append(np.where(np.arange(angles) == i, other, first))
    trials = [_same_teeth(problem, law, trial) for trial in trials]
    weighted = weighted_lines(problem)
    found = _minima(problem, weighted, law, trials)
    scores = [_score(fit, law) for fit in found]
    best = found[int(np.argmin(scores))]
    best = _with_first_tooth(problem, law, best)
    if angles:
        best = best._replace(theta=_wound(best.theta, law))
    others = [
        float(fit.theta[n])
        for fit, score in zip(found, scores, strict=True)
        if angles and score < min(scores) + ALIKE and abs(_nearest(fit.theta[n] - best.theta[n], law.period)) > APART
    ]
    theta, covariance = best.theta, best.covariance
    own = slice(n, n + angles)
    spread = law.turns @ covariance[own, own] @ law.turns.T if angles else np.zeros((len(law.turns),) * 2)
    end = n + angles
    return LawFit(
        fit=best,
        law=law,
        phases=law.turns @ theta[own] if angles else np.zeros(len(law.turns)),
        phase_sd=np.sqrt(np.maximum(np.diag(spread), 0.0)),
        common_phase=_common(law, theta[own], covariance[own, own]) if angles else None,
        runout=_pair(theta[end:] * USUAL_RUNOUT) if law.fits_runout else None,
        runout_sd=_pair(np.sqrt(np.diag(covariance)[end:]) * USUAL_RUNOUT) if law.fits_runout else None,
        ambiguous=tuple(others),
    )


def _common(law: Law, angles: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """The mean over the cuts that count from one pulse, and its deviation."""
    share = law.turns[law.turns[:, 0] > 0].mean(axis=0)
    return float(share @ angles), float(np.sqrt(share @ covariance @ share))


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _nearest(angle: float, period: float) -> float:
    return float(angle - period * np.round(angle / period))


def _wound(theta: np.ndarray, law: Law) -> np.ndarray:
    """The same with the angles nearest to zero, where a period more or less changes nothing."""
    n, angles = law.sizes
    period = 2 * np.pi if law.fits_runout else law.period  # less would exchange the teeth
    wound = theta.copy()
    wound[n : n + angles] -= period * np.round(theta[n : n + angles] / period)
    return wound


def _with_first_tooth(problem: Problem, law: Law, best: Fit) -> Fit:
    """The same minimum with that tooth as tooth 0 which the runout pushes out most, where nobody said which it is."""
    cutter = problem.cuts[0].cutter
    equal = cutter.pitch is None or np.ptp(cutter.pitch) < 1e-9
    if not law.fits_runout or not equal or any(cut.angle_from == "stated" for cut in problem.cuts):
        return best
    n, angles = law.sizes
    offset = complex(*best.theta[n + angles :])
    lag = 2 * np.pi / cutter.teeth * np.arange(cutter.teeth)
    first = lag[int(np.argmax(np.real(offset * np.exp(1j * lag))))]
    if first == 0:
        return best
    turned = offset * np.exp(1j * first)
    theta = best.theta.copy()
    theta[n : n + angles][~law.stated] -= first
    theta[n + angles :] = turned.real, turned.imag
    return _fit(problem, law, theta)


def _minima(problem: Problem, weighted: Weighted, law: Law, trials: list[np.ndarray]) -> list[Fit]:
    """The minima that trials lead to; where data and FRF contradict each other so much that there is none, the start, so
    that the checks can say what is wrong.
    """
    found = []
    for trial in trials:
        try:
            found.append(_follow(problem, weighted, law, trial))
        except IllPosedError:
            continue
    return found or [_follow(problem, weighted, law, trials[0], steps=0)]


def _follow(problem: Problem, weighted: Weighted, law: Law, angles: np.ndarray, steps: int = STEPS) -> Fit:
    """From some angles to the minimum, with the runout that suits them best at first."""
    starts = []
    for runout in _runouts() if law.fits_runout else [np.zeros(2)]:
        z, chi2 = weighted.solve(_slopes(law, angles, runout))
        tail = runout / USUAL_RUNOUT if law.fits_runout else np.zeros(0)
        starts.append((chi2, np.concatenate([z, angles, tail])))
    return _fit(problem, law, min(starts, key=lambda own: own[0])[1], steps)


def _fit(problem: Problem, law: Law, start: np.ndarray, steps: int = STEPS) -> Fit:
    return fit_errors_in_variables(
        problem.matrix,
        problem.measured,
        problem.noise,
        problem.error,
        law.values,
        start,
        prior=(np.zeros(len(start)), law.precision),
        steps=steps,
    )


def _same_teeth(problem: Problem, law: Law, angles: np.ndarray) -> np.ndarray:
    """The angles with one tooth of all cuts as tooth 0, where several are counted from starts of their own.

    The harmonics of the tooth passing do not know the teeth apart, those between do by the runout: it is that of the first
    cuts, and each further cut takes the tooth with which that runout explains it best.
    """
    free = [i for i in range(len(angles)) if not law.stated[i]]
    if not law.fits_runout or len(free) < 2:
        return angles
    angles = angles.copy()
    seen = law.turns[law.cut, free[0]] > 0
    weighted = weighted_lines(problem.of_lines(seen))
    runouts = _runouts()
    chi2 = [weighted.solve(_slopes(law, angles, runout)[seen])[1] for runout in runouts]
    runout = runouts[int(np.argmin(chi2))]
    for i in free[1:]:
        seen = seen | (law.turns[law.cut, i] > 0)
        weighted = weighted_lines(problem.of_lines(seen))
        shifts = angles[i] + law.period * np.arange(round(2 * np.pi / law.period))
        chi2 = []
        for shift in shifts:
            angles[i] = shift
            chi2.append(weighted.solve(_slopes(law, angles, runout)[seen])[1])
        angles[i] = shifts[int(np.argmin(chi2))]
    return angles


def _runouts() -> list[np.ndarray]:
    """Trials of (c0, s0), m."""
    directions = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    return [np.zeros(2)] + [size * np.array([np.cos(a), np.sin(a)]) for size in RUNOUTS for a in directions]


def _slopes(law: Law, angles: np.ndarray, runout: np.ndarray) -> np.ndarray:
    """Force of unit unknowns on the lines.   runout : m   returns complex (line, axis, combination)"""
    tail = runout / USUAL_RUNOUT if law.fits_runout else np.zeros(0)
    fixed = law.fixed(np.concatenate([np.zeros(law.sizes[0]), angles, tail]))
    return np.asarray(fixed.basis @ law.combinations)


def _score(fit: Fit, law: Law) -> float:
    """Chi-square, and more for a negative Ktc where the lines tell it."""
    coefficients = law.combinations @ fit.theta[: law.sizes[0]]
    return fit.chi2 + (PENALTY if 0 in law.known and coefficients[0] < 0 else 0.0)


def _best_angles(problem: Problem, law: Law, angle: int) -> list[float]:
    """Trials of one angle that its lines like best, from minima of chi-square over a period; best first.

    The harmonics of the tooth passing decide: those between them are a matter of the runout.
    """
    if law.stated[angle]:
        return [0.0]
    teeth = problem.cuts[0].cutter.teeth
    chosen = law.turns[law.cut, angle] > 0
    passing = chosen & (law.order % teeth == 0)
    chosen = passing if law.fits_runout and passing.any() else chosen
    weighted = weighted_lines(problem.of_lines(chosen))
    slopes = (law.basis_at(0.0, 0.0) @ law.combinations)[chosen]
    count = TRIALS * max(1, round(law.order[chosen].max() * law.period / (2 * np.pi)))
    trials = np.arange(count) * law.period / count
    chi2 = np.empty(count)
    for i, trial in enumerate(trials):
        z, chi2[i] = weighted.solve(slopes * np.exp(1j * law.order[chosen] * trial)[:, None, None])
        if 0 in law.known and (law.combinations @ z)[0] < 0:
            chi2[i] += PENALTY
    around = np.concatenate([chi2[-1:], chi2, chi2[:1]])
    rises = [b > a for a, b in pairwise(around)]
    minima = [i for i in range(count) if not rises[i] and rises[i + 1]]
    minima = sorted(minima or [int(np.argmin(chi2))], key=lambda i: chi2[i])
    hopeful = [i for i in minima[:FOLLOWED] if chi2[i] <= HOPEFUL * chi2[minima[0]] + PENALTY]
    return [float(trials[i]) for i in hopeful]
