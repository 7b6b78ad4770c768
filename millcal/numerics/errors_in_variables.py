"""Unknowns behind a linear system whose matrix is measured as well: y = (A + Delta) f(theta) + e, lines coupled or not.

Delta and e are normal with known covariances. The errors of the matrix are as many unknowns as it has entries, and all of them
can be taken out exactly: for a given theta the residual r = y - A f is normal with covariance

    C(theta) = noise + sum over columns d, e of f_d f_e* cov(Delta_d, Delta_e),

so the joint likelihood of matrix and data, at its best Delta, is the quadratic form r^H C(theta)^-1 r. That is total least
squares with every error weighted by what is known of it [Van Huffel & Vandewalle 1991, ch. 8; Markovsky & Van Huffel 2007].
The log-determinant of C belongs to the likelihood in which Delta is integrated out, not to this one; it draws f to zero,
because a small f makes C small.

Weighted least squares with C frozen at the last estimate is not this minimum: it takes the measured matrix for the true one
and shrinks the unknowns. The slope of the quadratic form is that of ordinary least squares with the matrix at its best,
A + Delta(theta), and Gauss-Newton with that matrix is what is done here.

The covariance of the estimate is H^-1 I H^-1, with I the information J^T C^-1 J of that matrix and H the curvature of the
quadratic form. Where the lines say little both differ: what noise of the matrix looks like is no information, and I alone
gives intervals that hold 88 times in a hundred where these hold 94.

Complex lines are held as real and imaginary parts, so that errors that are not circular (a fitted model of the matrix has real
parameters) are weighted as they are.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from millcal.errors import IllPosedError

FLOOR = 1e-6  # of the mean variance, added to each: without noise in the data the covariance loses rank
STEPS = 60
CLOSE = 1e-10  # relative change of the quadratic form at which it is at its minimum

BEYOND = 100.0  # times f at the start: there the quadratic form has no minimum but a limit
WORST = 1e12  # condition number of the scaled information beyond which nothing is told
NOT_APART = "the lines do not tell the unknowns apart; use more of them"
NO_MINIMUM = "the errors that the matrix may have explain the data the better, the larger the unknowns are"

Model = Callable[
    [np.ndarray], tuple[np.ndarray, np.ndarray]
]  # theta (p,) -> f (line, column), slopes (line, column, p)


class MatrixError(NamedTuple):
    """What is known of the errors of a measured matrix (line, row, column); either part may be missing."""

    shared: np.ndarray | None = None  # E[Delta_lsd Delta_mtd*], circular, columns apart: (column, line, row, line, row)
    deviations: np.ndarray | None = None  # Delta = sum_q z_q deviations_q, z standard normal: (q, line, row, column)


class Fit(NamedTuple):
    """The minimum, and what is known about it."""

    theta: np.ndarray  # (p,)
    covariance: np.ndarray  # (p, p)
    chi2: float  # the quadratic form: chi-square with `dof` degrees of freedom where model and covariances are right
    dof: int
    values: np.ndarray  # f, complex (line, column)
    slopes: np.ndarray  # (line, column, p)
    residual: np.ndarray  # y - A f, complex (line, row)
    expected: np.ndarray  # E|residual|^2, (line, row)
    residual_covariance: np.ndarray  # C, of the parts of the residual, (2 line row, 2 line row)
    matrix: np.ndarray  # A + Delta at its best, (line, row, column)
    information: np.ndarray  # what each row adds to the inverse covariance, (row, p, p)
    converged: bool


def parts(values: np.ndarray) -> np.ndarray:
    """Complex (line, row, ...) as real parts then imaginary parts.   returns (2 line row, ...)"""
    flat = values.reshape(values.shape[0] * values.shape[1], *values.shape[2:])
    return np.concatenate([flat.real, flat.imag])


def circular(covariance: np.ndarray) -> np.ndarray:
    """Covariance of the parts of circular errors.   covariance : E[e e^H], (n, n)   returns (2n, 2n)"""
    return 0.5 * np.block([[covariance.real, -covariance.imag], [covariance.imag, covariance.real]])


def residual_covariance(noise: np.ndarray, error: MatrixError, values: np.ndarray) -> np.ndarray:
    """C, of the parts of the residual.

    noise : complex (line, row, row)   values : f, complex (line, column)   returns (2 line row, 2 line row)
    """
    lines, rows = noise.shape[:2]
    n = lines * rows
    total = np.zeros((lines, rows, lines, rows), complex)
    at = np.arange(lines)
    total[at, :, at, :] = noise
    if error.shared is not None:
        for column, shared in enumerate(error.shared):
            f = values[:, column]
            total += np.multiply.outer(f, f.conj())[:, None, :, None] * shared
    covariance = circular(total.reshape(n, n))
    if error.deviations is not None:
        moved = parts(np.einsum("qlsd,ld->lsq", error.deviations, values))
        covariance += moved @ moved.T
    covariance[np.diag_indices(2 * n)] += FLOOR * np.trace(covariance) / (2 * n)
    return covariance


def best_matrix(matrix: np.ndarray, error: MatrixError, values: np.ndarray, weighted: np.ndarray) -> np.ndarray:
    """The most likely matrix given the residual.   weighted : C^-1 residual, as parts   returns (line, row, column)"""
    lines, rows, _ = matrix.shape
    n = lines * rows
    best = np.array(matrix, complex)
    if error.shared is not None:
        q = (weighted[:n] + 1j * weighted[n:]).reshape(lines, rows) / 2
        for column, shared in enumerate(error.shared):
            seen = values[:, column].conj()[:, None] * q
            best[:, :, column] += np.tensordot(shared, seen, 2)
    if error.deviations is not None:
        moved = parts(np.einsum("qlsd,ld->lsq", error.deviations, values))
        best += np.tensordot(moved.T @ weighted, error.deviations, 1)
    return best


def fit_errors_in_variables(
    matrix: np.ndarray,
    measured: np.ndarray,
    noise: np.ndarray,
    error: MatrixError,
    model: Model,
    start: np.ndarray,
    *,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    steps: int = STEPS,
) -> Fit:
    """The theta whose f(theta) explains the data best when matrix and data both have errors.

    matrix : A, complex (line, row, column)   measured : y, complex (line, row)
    noise : E[e e^H], complex (line, row, row)   start : theta, (p,)
    prior : what is known of theta beforehand, mean (p,) and precision (p,); precision 0 where nothing is
    steps : at most; 0 tells everything about the start

    Raises
    ------
    IllPosedError
        The data do not determine theta near the start, or contradict the matrix so much that there is no minimum.
    """
    mean, precision = prior if prior is not None else (np.zeros(len(start)), np.zeros(len(start)))

    def look(theta: np.ndarray) -> _State:
        return _look(matrix, measured, noise, error, model, theta, mean, precision)

    state, damping, converged = look(np.array(start, float)), 0.0, False
    furthest = BEYOND * np.abs(state.values).max()
    for _ in range(steps):
        normal, scale = _information(state, precision)
        pull = state.pull
        while True:
            try:
                step = np.linalg.solve(normal / np.outer(scale, scale) + damping * np.eye(len(scale)), pull / scale)
            except np.linalg.LinAlgError:
                raise IllPosedError(NOT_APART) from None
            trial = look(state.theta + step / scale)
            if trial.chi2 <= state.chi2 * (1 + CLOSE) or damping > 1e8:
                break
            damping = max(4 * damping, 1e-3)
        gain, promised = state.chi2 - trial.chi2, float(pull @ (step / scale))
        if gain < 0:  # no way down: at the minimum to rounding
            converged = promised <= 1e-6 * max(state.chi2, 1.0)
            break
        state = trial
        if np.abs(state.values).max() > furthest > 0:
            raise IllPosedError(NO_MINIMUM)
        damping = 0.0 if damping < 1e-3 else damping / 8
        if gain <= CLOSE * state.chi2 or promised <= 1e-12:
            converged = True
            break
    return _answer(matrix, error, model, state, precision, converged)


class _State(NamedTuple):
    theta: np.ndarray
    chi2: float
    values: np.ndarray
    slopes: np.ndarray
    residual: np.ndarray
    covariance: np.ndarray
    root: np.ndarray
    weighted: np.ndarray  # C^-1 residual, as parts
    best: np.ndarray
    pull: np.ndarray  # minus half the slope of chi2


def _look(
    matrix: np.ndarray,
    measured: np.ndarray,
    noise: np.ndarray,
    error: MatrixError,
    model: Model,
    theta: np.ndarray,
    mean: np.ndarray,
    precision: np.ndarray,
) -> _State:
    """Everything at one theta."""
    values, slopes = model(theta)
    residual = measured - np.einsum("lsd,ld->ls", matrix, values)
    covariance = residual_covariance(noise, error, values)
    root = np.linalg.cholesky(covariance)
    left = solve_triangular(root, parts(residual), lower=True, check_finite=False)
    weighted = solve_triangular(root, left, lower=True, trans=1, check_finite=False)
    best = best_matrix(matrix, error, values, weighted)
    off = theta - mean
    chi2 = float(left @ left) + float(off @ (precision * off))
    pull = parts(_moved(best, slopes)).T @ weighted - precision * off
    return _State(theta, chi2, values, slopes, residual, covariance, root, weighted, best, pull)


def _moved(matrix: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Matrix times slopes.   (line, row, column), (line, column, p)   returns (line, row, p)"""
    return np.asarray(matrix @ slopes)


def _information(state: _State, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J^T C^-1 J with the matrix at its best, and the root of its diagonal."""
    left = solve_triangular(state.root, parts(_moved(state.best, state.slopes)), lower=True, check_finite=False)
    normal = left.T @ left + np.diag(precision)
    scale = np.sqrt(np.diag(normal))
    if not np.all(scale > 0):
        raise IllPosedError("no line depends on some of the unknowns; leave them out")
    return normal, scale


def _curvature(
    matrix: np.ndarray, error: MatrixError, model: Model, state: _State, precision: np.ndarray
) -> np.ndarray:
    """Half the second derivative of chi2, exact but for the model's own bend, which is a difference of its slopes.

    Each column is the change of the pull with one unknown: of the residual's weight, and of the best matrix.
    """
    lines, rows, columns = matrix.shape
    n, p = lines * rows, len(state.theta)
    w, f, s = state.weighted, state.values, state.slopes
    q = (w[:n] + 1j * w[n:]).reshape(lines, rows)
    turned = -parts(_moved(matrix, s))  # of the residual, then less what C changes
    if error.shared is not None:
        changed = np.zeros((lines, rows, p), complex)
        for d in range(columns):
            shared, q_seen = error.shared[d], f[:, d].conj()[:, None] * q
            changed += s[:, d][:, None, :] * np.tensordot(shared, q_seen, 2)[:, :, None]
            moving = s[:, d].conj()[:, None, :] * q[:, :, None]
            changed += f[:, d][:, None, None] * np.tensordot(shared, moving, 2)
        turned -= parts(changed) / 2
    if error.deviations is not None:
        moved = parts(np.einsum("qlsd,ld->lsq", error.deviations, f))
        moving = np.stack([parts(np.einsum("qlsd,ld->lsq", error.deviations, s[:, :, i])) for i in range(p)], axis=2)
        weight = np.tensordot(w, moving, 1)  # (q, p)
        turned -= np.tensordot(moving, moved.T @ w, ([1], [0])) + moved @ weight
    dw = solve_triangular(
        state.root, solve_triangular(state.root, turned, lower=True, check_finite=False), lower=True, trans=1
    )
    change = parts(_moved(state.best, s)).T @ dw  # of the pull by the weight
    if error.shared is not None:
        dq = (dw[:n] + 1j * dw[n:]).reshape(lines, rows, p)
        for d in range(columns):
            moving = s[:, d].conj()[:, None, :] * q[:, :, None] + f[:, d].conj()[:, None, None] * dq
            delta = np.tensordot(error.shared[d], moving, 2) / 2  # (line, row, p): of the matrix's column
            change += np.einsum("lsi,lj,ls->ji", delta, s[:, d], q.conj()).real
    if error.deviations is not None:
        dz = weight + moved.T @ dw  # (q, p)
        seen = np.einsum("qlsd,ldj,ls->qj", error.deviations, s, q.conj()).real
        change += seen.T @ dz
    adjoint = np.einsum("lsd,ls->ld", state.best.conj(), q)
    for i, size in enumerate(1e-4 / _information(state, precision)[1]):
        shift = np.zeros(p)
        shift[i] = size
        bend = (model(state.theta + shift)[1] - model(state.theta - shift)[1]) / (2 * size)
        change[:, i] += np.einsum("ldp,ld->p", bend.conj(), adjoint).real
    return np.asarray(np.diag(precision) - (change + change.T) / 2)


def _answer(
    matrix: np.ndarray, error: MatrixError, model: Model, state: _State, precision: np.ndarray, converged: bool
) -> Fit:
    lines, rows, _ = matrix.shape
    flat = parts(_moved(state.best, state.slopes))
    normal, scale = _information(state, precision)
    toward = solve_triangular(
        state.root, solve_triangular(state.root, flat, lower=True, check_finite=False), lower=True, trans=1
    )
    by_row = np.einsum("clsp,clsq->spq", flat.reshape(2, lines, rows, -1), toward.reshape(2, lines, rows, -1))
    size = np.outer(scale, scale)
    if np.linalg.cond(normal / size) > WORST:
        raise IllPosedError(NOT_APART)
    inverse = np.linalg.inv(normal / size)
    curvature = _curvature(matrix, error, model, state, precision) / size
    if np.linalg.eigvalsh(curvature)[0] > 0.02 * np.linalg.eigvalsh(normal / size)[0]:
        bent = np.linalg.inv(curvature)
        inverse = bent @ (normal / size) @ bent
    diagonal = np.diag(state.covariance)
    n = lines * rows
    return Fit(
        theta=state.theta,
        covariance=inverse / size,
        chi2=state.chi2,
        dof=2 * n - len(state.theta) + int(np.count_nonzero(precision)),
        values=state.values,
        slopes=state.slopes,
        residual=state.residual,
        expected=(diagonal[:n] + diagonal[n:]).reshape(lines, rows),
        residual_covariance=state.covariance,
        matrix=state.best,
        information=(by_row + by_row.transpose(0, 2, 1)) / 2,
        converged=converged,
    )
