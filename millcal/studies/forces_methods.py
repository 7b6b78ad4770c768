"""The methods of the study of forces from accelerations: coefficients from one cut and one FRF.

As the paper has them: LS, TLS, Tikhonov with two ways to choose its weight, and RTLS with one equation between the harmonics.
With all equations that the force law sets between them: "LS, all rows" and "TLS, all rows". With every error weighted by what is
known of it, besides: GTLS, from plain H1, from windowed H1 and from fitted modes.

What had to be settled to compute anything
    eq. 13      a = G F holds in N and m/s^2: with kN the 1 of the denominator means something else
    eq. 14      lambda between the smallest and the largest singular value, as tools of that time search it; "wide" is beside it
    eq. 15, 16  = delta^2 with delta = 0 has no gradient: unknowns are eliminated
    eq. 19      x and y are exchanged, and both harmonics too large by factors of their own
    eq. 20, 21  the row of Fourier coefficients with exp(-j w t) is [1 j 0 -5/3 -5j/3 0]; the printed one is kept beside it
    eq. 23      Re before Im in the second harmonic as in the first
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from millcal.numerics.errors_in_variables import (
    Fit,
    MatrixError,
    Model,
    fit_errors_in_variables,
    parts,
    residual_covariance,
)
from millcal.numerics.linear_inverse import (
    as_complex_vector,
    as_real,
    as_real_vector,
    constrained_least_squares,
    constrained_total_least_squares,
    least_squares,
    total_least_squares,
)
from millcal.numerics.regularization import (
    BETWEEN_THE_SINGULAR_VALUES,
    WIDE,
    Choice,
    decompose,
    gcv,
    l_curve,
    solution,
)
from millcal.studies.forces_cuts import CUTTER, SOUGHT, CutRecord, ForceLaw, force_law
from millcal.studies.forces_tests import Estimate, ImpactTest

ROW = np.array([[1, 1j, 0, -5 / 3, -5j / 3, 0]])
PRINTED_ROW = np.array([[1j, 1, 0, -5j / 3, -5 / 3, 0]])  # eq. 21

LS, TLS = "LS", "TLS"
GCV, L_CURVE, GCV_WIDE, L_CURVE_WIDE = "Tikhonov GCV", "Tikhonov L-curve", "GCV wide", "L-curve wide"
RLS, RTLS, RTLS_PRINTED, RTLS_WINDOWED = "RLS", "RTLS", "RTLS as printed", "RTLS windowed"
LS_ALL, TLS_ALL = "LS all rows", "TLS all rows"
GTLS, GTLS_MORE, GTLS_WINDOWED, GTLS_MODAL = "GTLS", "GTLS 4 harmonics", "GTLS windowed", "GTLS modal"

HARMONICS, MORE_HARMONICS = 2, 4  # of the tooth passing
WEIGHTINGS = 3  # before the fit begins

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Told(NamedTuple):
    """What a method says of Ktc, Kte, Krc, Kre, SI."""

    value: np.ndarray  # (4,)
    deviation: np.ndarray | None = None  # standard deviations, (4,), where the method has them


def _tikhonov(choose: Callable[..., Choice], span: tuple[float, float]) -> Solver:
    def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        system = decompose(A, b)
        return solution(system, choose(system, span=span).regularization)

    return solve


def _on_parts(solve: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> Solver:
    """A solver under all rows of the force law, which hold for real and imaginary parts."""

    def solve_parts(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        return as_complex_vector(solve(as_real(A), as_real_vector(b), force_law(HARMONICS).constraint))

    return solve_parts


BY_FORCE: dict[str, tuple[str, Solver]] = {  # the FRF, and what solves for the harmonics of the force
    LS: ("plain", least_squares),
    TLS: ("plain", total_least_squares),
    GCV: ("plain", _tikhonov(gcv, BETWEEN_THE_SINGULAR_VALUES)),
    L_CURVE: ("plain", _tikhonov(l_curve, BETWEEN_THE_SINGULAR_VALUES)),
    GCV_WIDE: ("plain", _tikhonov(gcv, WIDE)),
    L_CURVE_WIDE: ("plain", _tikhonov(l_curve, WIDE)),
    RLS: ("plain", partial(constrained_least_squares, constraint=ROW)),
    RTLS: ("plain", partial(constrained_total_least_squares, constraint=ROW)),
    RTLS_PRINTED: ("plain", partial(constrained_total_least_squares, constraint=PRINTED_ROW)),
    LS_ALL: ("plain", _on_parts(constrained_least_squares)),
    TLS_ALL: ("plain", _on_parts(constrained_total_least_squares)),
    RTLS_WINDOWED: ("windowed", partial(constrained_total_least_squares, constraint=ROW)),
}
WEIGHTED: dict[str, tuple[str, int]] = {  # the FRF, and how many harmonics
    GTLS: ("plain", HARMONICS),
    GTLS_MORE: ("plain", MORE_HARMONICS),
    GTLS_WINDOWED: ("windowed", HARMONICS),
    GTLS_MODAL: ("modal", HARMONICS),
}
METHODS = (*BY_FORCE, *WEIGHTED)


def estimate_by(method: str, test: ImpactTest, record: CutRecord, passing: int) -> Told:
    """What one method says of a cut.   method : one of METHODS   passing : f_t, Hz"""
    name, solve = BY_FORCE[method] if method in BY_FORCE else (WEIGHTED[method][0], None)
    frf: Estimate = getattr(test, name)
    if solve is None:
        return weighted(frf, record, passing, WEIGHTED[method][1])
    A = block_diagonal(frf.at(lines_of(passing, HARMONICS))[0])
    force = solve(A, record.values[:HARMONICS].ravel())
    return Told(force_law(HARMONICS).coefficients(force.reshape(HARMONICS, -1)))


def lines_of(passing: int, harmonics: int) -> np.ndarray:
    """Hz"""
    return passing * np.arange(1, harmonics + 1)


def block_diagonal(matrix: np.ndarray) -> np.ndarray:
    """G of eq. 11.   matrix : complex (line, sensor, axis)   returns (line sensor, line axis)"""
    lines, sensors, axes = matrix.shape
    A = np.zeros((lines, sensors, lines, axes), complex)
    A[np.arange(lines), :, np.arange(lines)] = matrix
    return A.reshape(lines * sensors, lines * axes)


def weighted(frf: Estimate, record: CutRecord, passing: int, harmonics: int) -> Told:
    """GTLS: the coefficients themselves, each error weighted by what is known of it."""
    return gtls(frf.at(lines_of(passing, harmonics)), record, force_law(harmonics))


def gtls(frf: tuple[np.ndarray, MatrixError], record: CutRecord, law: ForceLaw) -> Told:
    """The same for any lines.   frf, record, law : of these lines; the record may have more behind them"""
    return told_by(law, fit_gtls(frf, record, law))


def fit_gtls(frf: tuple[np.ndarray, MatrixError], record: CutRecord, law: ForceLaw) -> Fit:
    """The minimum with all that is known about it."""

    def model(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return law.basis @ theta, law.basis

    return _fit(frf, record, model, weighted_start(law, frf, record))


def with_angle(
    frf: tuple[np.ndarray, MatrixError],
    record: CutRecord,
    law: ForceLaw,
    order: np.ndarray,
    *,
    believed: float = np.inf,
) -> tuple[Told, float, float]:
    """GTLS with the angle of the spindle among the unknowns.

    order : of the tooth passing, (line,)   believed : standard deviation of an angle of zero, rad, before anything is cut
    returns the coefficients, and of the angle by which the spindle lags its pulse the value and the standard deviation, rad
    """
    start = np.append(weighted_start(law, frf, record), 0.0)
    precision = np.zeros(len(start))
    precision[-1] = believed**-2
    fit = _fit(frf, record, partial(turned, law, order), start, prior=(np.zeros(len(start)), precision))
    return told_by(law, fit), float(fit.theta[-1]), float(np.sqrt(fit.covariance[-1, -1]))


def turned(law: ForceLaw, order: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force of coefficients and an angle, theta, and its slopes.   returns complex (line, axis), (line, axis, theta)"""
    turn = -1j * CUTTER.teeth * order
    basis = law.basis * np.exp(turn * theta[-1])[:, np.newaxis, np.newaxis]
    force = basis @ theta[:-1]
    return force, np.concatenate([basis, (turn[:, np.newaxis] * force)[:, :, np.newaxis]], axis=2)


def weighted_start(law: ForceLaw, frf: tuple[np.ndarray, MatrixError], record: CutRecord) -> np.ndarray:
    """Least squares of the coefficients, weighted with the covariance of the residual at the last estimate.

    Plain least squares may lie beyond the watershed: with much noise the descent then ends in another minimum, or nowhere.
    """
    matrix, error = frf
    n = len(matrix)
    slopes, measured = parts(matrix @ law.basis), parts(record.values[:n])
    scale = np.linalg.norm(slopes, axis=0)
    theta = least_squares(slopes / scale, measured) / scale
    for _ in range(WEIGHTINGS):
        root = np.linalg.cholesky(residual_covariance(record.noise[:n], error, law.basis @ theta))
        theta = least_squares(np.linalg.solve(root, slopes / scale), np.linalg.solve(root, measured)) / scale
    return theta


def _fit(
    frf: tuple[np.ndarray, MatrixError],
    record: CutRecord,
    model: Model,
    start: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
) -> Fit:
    matrix, error = frf
    n = len(matrix)
    return fit_errors_in_variables(matrix, record.values[:n], record.noise[:n], error, model, start, prior=prior)


def told_by(law: ForceLaw, fit: Fit) -> Told:
    """The coefficients that are sought."""
    place = [law.names.index(name) for name in SOUGHT]
    return Told(fit.theta[place], np.sqrt(np.diag(fit.covariance)[place]))
