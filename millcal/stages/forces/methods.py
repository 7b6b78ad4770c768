"""Every method by its name: harmonics of the force from accelerations and the FRF, with the spread that the errors give them.

Only `gtls` weights the lines by what is known of their errors, and only it finds the angle of tooth 0; the others take the
angle that it found. What a method solves is A f = a with A one block for each line. The spread of a linear method is what it
makes of the residual's covariance; total least squares, whose errors are second-order small, has that of least squares.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from millcal.errors import RecipeError
from millcal.numerics.errors_in_variables import residual_covariance
from millcal.numerics.linear_inverse import (
    as_complex_vector,
    as_real,
    as_real_vector,
    condition_number,
    constrained_total_least_squares,
    least_squares,
    null_basis,
    total_least_squares,
)
from millcal.numerics.regularization import Decomposition, decompose, discrepancy, filter_factors, gcv, l_curve
from millcal.stages.forces.law import Law
from millcal.stages.forces.problem import Problem

CHOICES = ("gcv", "l-curve", "discrepancy")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The force on the lines by one method."""

    force: np.ndarray  # complex (line, axis) N
    covariance: np.ndarray  # of [Re; Im] of the raveled force, (2 line axis, 2 line axis) N^2
    condition_number: float
    regularization: float | None = None  # (m/s^2)/N
    edge: str = ""  # of the search range, where Tikhonov's weight stands on it: low, high


@dataclass(frozen=True, eq=False)
class System:
    """The lines as one system, and what is known of its errors."""

    matrix: np.ndarray  # complex (line sensor, line axis), blocks
    data: np.ndarray  # complex (line sensor,)
    spread: np.ndarray  # covariance of the residual's parts at the force itself, (2 line sensor, 2 line sensor)
    matrix_noise: float  # rms standard deviation of an entry of a block
    data_noise: float
    shape: tuple[int, int]  # line, axis

    def answer(self, force: np.ndarray, gain: np.ndarray, condition: float, **more: object) -> Reconstruction:
        """gain : what the parts of the force owe to the parts of the data, (2 line axis, 2 line sensor)"""
        return Reconstruction(force.reshape(self.shape), gain @ self.spread @ gain.T, condition, **more)  # type: ignore[arg-type]


def system_of(problem: Problem, force: np.ndarray) -> System:
    """One system of all lines.   force : an estimate of it, (line, axis), for the spread"""
    lines, sensors, axes = problem.matrix.shape
    blocks = np.zeros((lines, sensors, lines, axes), complex)
    at = np.arange(lines)
    blocks[at, :, at, :] = problem.matrix
    noise = np.einsum("lss->l", problem.noise).real / sensors
    return System(
        matrix=blocks.reshape(lines * sensors, lines * axes),
        data=problem.measured.ravel(),
        spread=residual_covariance(problem.noise, problem.error, force),
        matrix_noise=float(np.sqrt(np.mean(problem.frf_variance))),
        data_noise=float(np.sqrt(np.mean(noise))),
        shape=(lines, axes),
    )


def by_least_squares(system: System) -> Reconstruction:
    """Every line by itself, all sensors alike."""
    gain = np.linalg.pinv(system.matrix)
    return system.answer(least_squares(system.matrix, system.data), as_real(gain), condition_number(system.matrix))


def by_total_least_squares(system: System) -> Reconstruction:
    """Errors in the FRF too, alike in all its entries and scaled against those of the accelerations."""
    force = total_least_squares(system.matrix, system.data, **_noise_of(system))
    return system.answer(force, as_real(np.linalg.pinv(system.matrix)), condition_number(system.matrix))


def by_tikhonov(system: System, *, regularization: float | str) -> Reconstruction:
    """The force is kept small; its spread is that of the noise alone, and knows nothing of the bias."""
    own = decompose(system.matrix, system.data)
    weight, edge = _weight(own, system, regularization)
    factors = filter_factors(own, weight) / own.s
    gain = own.V @ (factors[:, None] * (own.V / own.s).conj().T) @ system.matrix.conj().T
    force = own.V @ (factors * own.beta)
    condition = float(np.sqrt((own.s[0] ** 2 + weight**2) / (own.s[-1] ** 2 + weight**2)))
    return system.answer(force, as_real(gain), condition, regularization=weight, edge=edge)


def _weight(own: Decomposition, system: System, regularization: float | str) -> tuple[float, str]:
    if not isinstance(regularization, str):
        return float(regularization), ""
    if regularization not in CHOICES:
        raise RecipeError(
            f"forces.regularization: {regularization!r} is unknown; choose one of {', '.join(CHOICES)}, or give a number"
        )
    if regularization == "discrepancy":
        chosen = discrepancy(own, noise_norm=float(np.sqrt(np.trace(system.spread))))
    else:
        chosen = {"gcv": gcv, "l-curve": l_curve}[regularization](own)
    return chosen.regularization, chosen.edge


def by_constrained_least_squares(system: System, *, constraint: np.ndarray) -> Reconstruction:
    """Least squares among the forces that the law allows."""
    return _constrained(system, constraint)


def by_regularized_total_least_squares(system: System, *, constraint: np.ndarray, slack: float = 0.0) -> Reconstruction:
    """Total least squares among the forces that the law allows, or that miss it by `slack` N at most."""
    found = _constrained(system, constraint)
    force = constrained_total_least_squares(
        as_real(system.matrix), as_real_vector(system.data), constraint, slack=slack, **_noise_of(system)
    )
    covariance = found.covariance
    if slack > 0:  # what the law forbids may differ by as much
        covariance = covariance + slack**2 / len(constraint) * constraint.T @ constraint
    return Reconstruction(as_complex_vector(force).reshape(system.shape), covariance, found.condition_number)


def _constrained(system: System, constraint: np.ndarray) -> Reconstruction:
    allowed = null_basis(constraint)
    moved = as_real(system.matrix) @ allowed
    gain = allowed @ np.linalg.pinv(moved)
    return system.answer(as_complex_vector(gain @ as_real_vector(system.data)), gain, condition_number(moved))


def _noise_of(system: System) -> dict[str, float]:
    """Both noises, with equal ones where neither is known."""
    if system.data_noise > 0:
        return {"matrix_noise": system.matrix_noise, "data_noise": system.data_noise}
    return {"matrix_noise": 1.0, "data_noise": 1.0}


# gtls stands in `fit`: it goes first, since it finds the angle that the others need
METHODS: dict[str, Callable[..., Reconstruction]] = {
    "ls": by_least_squares,
    "tls": by_total_least_squares,
    "tikhonov": by_tikhonov,
    "constrained-ls": by_constrained_least_squares,
    "rtls": by_regularized_total_least_squares,
}
NAMES = (*METHODS, "gtls")


def solver(method: str, law: Law, regularization: float | str, slack: float) -> Callable[[System], Reconstruction]:
    """A method with its own options.   law : with its phases known"""
    own = {
        "tikhonov": {"regularization": regularization},
        "constrained-ls": {"constraint": law.constraint.rows},
        "rtls": {"constraint": law.constraint.rows, "slack": slack},
    }.get(method, {})
    return partial(METHODS[method], **own)


def coefficients_from_force(found: Reconstruction, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients whose force is nearest, by least squares [Pawelko et al. 2012, eq. 23, with its rows in order].

    law : with its phases known   returns (6,), (6, 6) SI
    """
    slopes = as_real_vector((law.basis @ law.combinations).reshape(-1, law.combinations.shape[1]))
    gain = np.linalg.pinv(slopes)
    theta = gain @ as_real_vector(found.force.ravel())
    return law.coefficients(theta, gain @ found.covariance @ gain.T)
