"""Least squares in which some unknowns enter linearly: they are projected out, and only the others are searched.

Golub & Pereyra 1973 (variable projection) with Kaufman's 1975 simplification of the Jacobian, which drops a term of second
order in the residual: Gauss-Newton steps then cost one QR, and the search keeps its convergence.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Separable(NamedTuple):
    """Where the search ended."""

    nonlinear: np.ndarray  # (p,)
    linear: np.ndarray  # (q,)
    residual: np.ndarray  # data - model, (rows,)
    cost: float  # |residual|^2, and the pull where there is one


def solve_linear(matrix: np.ndarray, data: np.ndarray) -> np.ndarray:
    """The linear unknowns, with columns scaled so that coefficients of 1e9 and 1e4 are solved alike.   returns (q,)"""
    scale = np.linalg.norm(matrix, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.lstsq(matrix / scale, data, rcond=1e-12)[0] / scale


def separable_least_squares(
    matrix: Callable[[np.ndarray], np.ndarray],
    derivative: Callable[[np.ndarray, np.ndarray], np.ndarray],
    data: np.ndarray,
    start: np.ndarray,
    *,
    lower: np.ndarray,
    upper: np.ndarray,
    scale: np.ndarray,
    pull_to: np.ndarray | None = None,
    pull: np.ndarray | None = None,
    held: np.ndarray | None = None,
    tolerance: float = 1e-8,
    max_steps: int = 100,
) -> Separable:
    """Minimise |data - matrix(p) q|^2 over p within bounds and q free.

    matrix : p -> (rows, q)   derivative : (p, q) -> d(matrix(p) q)/dp, (rows, p)   data : (rows,)
    start, lower, upper, scale : (p,), the last the size of a natural step
    pull_to, pull : (p,), adds |pull (p - pull_to)|^2 to the cost, for unknowns that the data may not reach
    tolerance : relative change of the cost at which the search ends; exact data are fitted on to the last digits
    held : (q,), the linear unknowns are held at these instead of projected out
    """
    from scipy.optimize import least_squares

    def projected(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a = matrix(p)
        q = solve_linear(a, data) if held is None else held
        return a, q, data - a @ q

    last: dict[bytes, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def at(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        key = p.tobytes()
        if key not in last:
            last.clear()
            last[key] = projected(p)
        return last[key]

    def jacobian(x: np.ndarray) -> np.ndarray:
        a, q, _ = at(x * scale)
        slope = derivative(x * scale, q) * scale
        if held is None:
            norm = np.linalg.norm(a, axis=0)
            basis, triangle = np.linalg.qr(a[:, norm > 0] / norm[norm > 0])
            basis = basis[:, np.abs(np.diag(triangle)) > 1e-10]
            slope = slope - basis @ (basis.T @ slope)
        return np.concatenate([-slope, -np.diag(pull * scale)]) if pull is not None else -slope

    def residuals(x: np.ndarray) -> np.ndarray:
        residual = at(x * scale)[2]
        return np.concatenate([residual, pull * (pull_to - x * scale)]) if pull is not None else residual

    found = least_squares(
        residuals,
        np.clip(start, lower, upper) / scale,
        jac=jacobian,
        bounds=(lower / scale, upper / scale),
        method="trf",
        x_scale=1.0,
        ftol=tolerance,
        xtol=1e-10,
        gtol=1e-14,
        max_nfev=max_steps,
    )
    p = found.x * scale
    _, q, residual = projected(p)
    return Separable(p, q, residual, 2 * float(found.cost))
