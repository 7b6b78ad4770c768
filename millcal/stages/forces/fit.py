"""The noise-weighted fit of the law: phases searched all round, then everything at once.

A phase that nobody knows has several minima, so every trial angle gets the coefficients that suit it best, by weighted least
squares with the covariance of the force as it is without the law; the best are then followed to their minimum.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from millcal.numerics.errors_in_variables import (
    Fit,
    fit_errors_in_variables,
    parts,
    residual_covariance,
)
from millcal.stages.forces.law import Law
from millcal.stages.forces.problem import Problem

TRIALS = 48  # angles over a period
FOLLOWED = 3  # of them, to their minimum
ALIKE = 6.0  # of chi-square: what lies closer than this to the best is as good
PENALTY = 12.0  # of chi-square, for coefficients of a tool that pulls itself into the work


@dataclass(frozen=True, eq=False)
class LawFit:
    """The law fitted to the lines."""

    fit: Fit
    law: Law
    phases: np.ndarray  # (group,) rad
    phase_sd: np.ndarray  # (group,)
    ambiguous: tuple[float, ...]  # rad: other phases that are as good, beside the first group's


def free_force(problem: Problem) -> np.ndarray:
    """Force of every line by itself, by least squares weighted with the noise of the cut.   returns (line, axis)"""
    force = np.empty(problem.matrix.shape[::2], complex)
    for line, (A, y, noise) in enumerate(zip(problem.matrix, problem.measured, problem.noise, strict=True)):
        floor = 1e-9 * np.trace(noise).real + 1e-300
        root = np.linalg.cholesky(noise + floor * np.eye(len(noise)))
        force[line] = np.linalg.lstsq(np.linalg.solve(root, A), np.linalg.solve(root, y), rcond=None)[0]
    return force


def fit_law(problem: Problem, law: Law) -> LawFit:
    """The most likely coefficients and phases.

    Raises
    ------
    IllPosedError
        The lines do not tell the coefficients apart.
    """
    n = law.combinations.shape[1]
    groups = len(law.phase_mean)
    starts = [_best_phases(problem, law, g) for g in range(groups)]
    phases = np.array([own[0] for own in starts])
    best = _follow(problem, law, phases)
    scores = {float(phases[0]) if groups else 0.0: _score(best, law)}
    for g, own in enumerate(starts):
        for other in own[1:]:
            trial = phases.copy()
            trial[g] = other
            found = _follow(problem, law, trial)
            if g == 0:
                scores[float(found.theta[n])] = _score(found, law)
            if _score(found, law) < _score(best, law):
                best, phases = found, found.theta[n:].copy()
    if groups:
        middle = best.theta[n:]
        middle = middle - law.period * np.round((middle - law.phase_mean) / law.period)
        best = best._replace(theta=np.append(best.theta[:n], middle))
    least = _score(best, law)
    others = [
        phase
        for phase, score in scores.items()
        if groups
        and score < least + ALIKE
        and abs(_nearest(phase - best.theta[n], law.period)) > 4 * np.sqrt(best.covariance[n, n]) + 0.02
    ]
    return LawFit(
        fit=best,
        law=law,
        phases=best.theta[n:],
        phase_sd=np.sqrt(np.diag(best.covariance)[n:]),
        ambiguous=tuple(others),
    )


def _nearest(angle: float, period: float) -> float:
    return angle - period * round(angle / period)


def _follow(problem: Problem, law: Law, phases: np.ndarray) -> Fit:
    """From some phases to the minimum."""
    known = law.turned(phases)
    start = np.append(_weighted(problem, known)[0], phases)
    prior = (
        np.append(np.zeros(law.combinations.shape[1]), law.phase_mean),
        np.append(np.zeros(law.combinations.shape[1]), law.phase_precision),
    )
    return fit_errors_in_variables(
        problem.matrix, problem.measured, problem.noise, problem.error, law.values, start, prior=prior
    )


def _score(fit: Fit, law: Law) -> float:
    """Chi-square, and more for a negative Ktc where the lines tell it."""
    coefficients = law.combinations @ fit.theta[: law.combinations.shape[1]]
    return fit.chi2 + (PENALTY if 0 in law.known and coefficients[0] < 0 else 0.0)


def _weighted(problem: Problem, law: Law) -> tuple[np.ndarray, float]:
    """Unknowns at known phases by least squares weighted as for the force without the law, and chi-square."""
    covariance = residual_covariance(problem.noise, problem.error, free_force(problem))
    root = np.linalg.cholesky(covariance)
    slopes = law.values(np.zeros(law.combinations.shape[1]))[1]
    A = np.linalg.solve(root, parts(problem.matrix @ slopes))
    y = np.linalg.solve(root, parts(problem.measured))
    z = np.linalg.lstsq(A, y, rcond=None)[0]
    return z, float(np.sum((y - A @ z) ** 2))


def _best_phases(problem: Problem, law: Law, group: int) -> list[float]:
    """Trial angles of one group that its lines like best, from minima of chi-square over a period; best first."""
    if law.stated[group]:
        return [float(law.phase_mean[group])]
    own = problem.of_lines(law.group == group)
    covariance = residual_covariance(own.noise, own.error, free_force(own))
    root = np.linalg.cholesky(covariance)
    y = np.linalg.solve(root, parts(own.measured))
    slopes = (law.basis @ law.combinations)[law.group == group]
    order = law.order[law.group == group]
    angles = np.arange(TRIALS) * law.period / TRIALS
    chi2 = np.empty(TRIALS)
    for i, angle in enumerate(angles):
        turned = slopes * np.exp(1j * order * angle)[:, None, None]
        A = np.linalg.solve(root, parts(own.matrix @ turned))
        z = np.linalg.lstsq(A, y, rcond=None)[0]
        chi2[i] = np.sum((y - A @ z) ** 2)
        if 0 in law.known and (law.combinations @ z)[0] < 0:
            chi2[i] += PENALTY
    around = np.concatenate([chi2[-1:], chi2, chi2[:1]])
    rises = [b > a for a, b in pairwise(around)]
    minima = [i for i in range(TRIALS) if not rises[i] and rises[i + 1]]
    minima = sorted(minima or [int(np.argmin(chi2))], key=lambda i: chi2[i])
    return [float(angles[i]) for i in minima[:FOLLOWED]]
