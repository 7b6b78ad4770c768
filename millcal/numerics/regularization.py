"""How much Tikhonov regularization: generalized cross-validation, the corner of the L-curve, the discrepancy principle.

All three follow from one singular value decomposition of A with b turned into it. The weight that is sought has the unit of A and
enters squared: |A x - b|^2 + weight^2 |x|^2.

The range of the search decides more than the rule does. Where A is well conditioned the best weight lies far below the
smallest singular value, and a search between the smallest and the largest, as some programs do it, ends on its lower edge: a
bias that stays when the noise goes. So the range here is wide by default, and who meets its edge says so.

References
----------
.. [Golub1979] G. H. Golub, M. Heath, G. Wahba, Generalized cross-validation as a method for choosing a good ridge parameter,
   Technometrics 21 (1979) 215-223.
.. [Hansen1992] P. C. Hansen, Analysis of discrete ill-posed problems by means of the L-curve, SIAM Review 34 (1992) 561-580.
.. [Hansen1998] P. C. Hansen, Rank-Deficient and Discrete Ill-Posed Problems, SIAM 1998, sections 4.6 and 7.2 to 7.5.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

WIDE = (1e-4, 1e2)  # times the smallest and times the largest singular value
BETWEEN_THE_SINGULAR_VALUES = (1.0, 1.0)
POINTS = 200  # of the range, at equal ratios
RANK = 1e-12  # singular values below this, relative to the largest, are zero


class Decomposition(NamedTuple):
    """A = U diag(s) V^H and b in its terms; A and b themselves are not needed any more."""

    s: np.ndarray  # (r,) falling, those that are not zero
    beta: np.ndarray  # U^H b, (r,)
    V: np.ndarray  # (n, r)
    outside: float  # |b|^2 that no x reaches
    rows: int  # of A


class Choice(NamedTuple):
    """A weight, and the range along which it was looked for."""

    regularization: float  # unit of A
    edge: Literal["", "low", "high"]  # of the range, where the choice stands on it
    weights: np.ndarray  # (point,) rising
    criterion: np.ndarray  # (point,): GCV's function, the curvature, or the norm of the residual over the noise
    residual_norm: np.ndarray  # |A x - b|, (point,)
    solution_norm: np.ndarray  # |x|, (point,)


def decompose(A: np.ndarray, b: np.ndarray) -> Decomposition:
    """The one decomposition that all choices share.   A : (m, n)   b : (m,)   real or complex"""
    A, b = np.asarray(A), np.asarray(b)
    U, s, Vh = np.linalg.svd(A, full_matrices=False)
    r = int(np.count_nonzero(s > RANK * s[0]))
    beta = U[:, :r].conj().T @ b
    outside = float(np.linalg.norm(b - U[:, :r] @ beta) ** 2)
    return Decomposition(s[:r], beta, Vh[:r].conj().T, outside, A.shape[0])


def filter_factors(system: Decomposition, weight: np.ndarray | float) -> np.ndarray:
    """s^2 / (s^2 + weight^2), the share of each singular component that is let through.   returns (..., r)"""
    return np.asarray(system.s**2 / (system.s**2 + np.asarray(weight)[..., np.newaxis] ** 2))


def solution(system: Decomposition, weight: float) -> np.ndarray:
    """Tikhonov's x.   returns (n,)"""
    return np.asarray(system.V @ (filter_factors(system, weight) * system.beta / system.s))


def norms(system: Decomposition, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|A x - b| and |x| of Tikhonov's x.   weight : (...,)   returns (...,), (...,)"""
    squared = np.asarray(weight)[..., np.newaxis] ** 2
    below = system.s**2 + squared
    size = np.abs(system.beta) ** 2
    residual = np.sqrt(np.sum((squared / below) ** 2 * size, axis=-1) + system.outside)
    return residual, np.sqrt(np.sum((system.s / below) ** 2 * size, axis=-1))


def gcv(system: Decomposition, *, span: tuple[float, float] = WIDE) -> Choice:
    """The least |A x - b|^2 / (m - sum of the filter factors)^2  [Golub1979]_.   span : see `search_range`"""

    def function(weight: np.ndarray) -> np.ndarray:
        free = system.rows - len(system.s) + np.sum(1 - filter_factors(system, weight), axis=-1)
        return np.asarray((norms(system, weight)[0] / free) ** 2)

    weights = search_range(system, span)
    criterion = function(weights)
    return _choice(system, weights, criterion, *_least(function, weights, criterion))


def l_curve(system: Decomposition, *, span: tuple[float, float] = WIDE) -> Choice:
    """The sharpest corner of log |x| against log |A x - b|: the largest curvature  [Hansen1998, eq. 4.37]_.

    A curve without a corner, which bends the other way all along, leaves the lowest weight.
    """
    weights = search_range(system, span)
    curvature = l_curvature(system, weights)
    if not np.any(curvature > 0):
        return _choice(system, weights, curvature, float(weights[0]), "low")
    return _choice(system, weights, curvature, *_least(lambda w: -l_curvature(system, w), weights, -curvature))


def l_curvature(system: Decomposition, weight: np.ndarray) -> np.ndarray:
    """Curvature of the L-curve, positive in the corner.   weight : (point,)   returns (point,)

    With the falls p = -d log |x|^2 / d log w and q p = d log |A x - b|^2 / d log w it is 2 q (2 / p - 1 - q) / (1 + q^2)^(3/2).
    """
    w = np.asarray(weight)
    if not np.any(system.beta):  # x is zero for every weight
        return np.zeros(len(w))
    residual, size = norms(system, w)
    below = system.s**2 + w[:, np.newaxis] ** 2
    p = 4 * w**2 * np.sum((system.s * np.abs(system.beta)) ** 2 / below**3, axis=1) / size**2
    q = (w * size / residual) ** 2
    return np.asarray(2 * q * (2 / p - 1 - q) / (1 + q**2) ** 1.5)


def discrepancy(system: Decomposition, *, noise_norm: float, span: tuple[float, float] = WIDE) -> Choice:
    """The weight at which |A x - b| is what the noise of b leaves  [Hansen1998, section 7.2]_.

    Where even the smallest weight leaves more, or the largest less, the choice is that edge.
    noise_norm : expected |noise of b|, e.g. sqrt(m) times its standard deviation
    """
    weights = search_range(system, span)
    low, high = weights[0], weights[-1]
    criterion = norms(system, weights)[0] / noise_norm
    if criterion[0] >= 1:
        return _choice(system, weights, criterion, float(low), "low")
    if criterion[-1] <= 1:
        return _choice(system, weights, criterion, float(high), "high")
    for _ in range(100):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if norms(system, middle)[0] < noise_norm else (low, middle)
    return _choice(system, weights, criterion, float(np.sqrt(low * high)), "")


def search_range(system: Decomposition, span: tuple[float, float] = WIDE) -> np.ndarray:
    """Weights at equal ratios.   span : lowest over the smallest, highest over the largest singular value

    returns (point,)
    """
    return _grid(span[0] * system.s[-1], span[1] * system.s[0], POINTS)


def _grid(low: float, high: float, points: int) -> np.ndarray:
    """Equal ratios, ends exact; a tenth of the time of numpy's geomspace."""
    grid = np.exp(np.linspace(np.log(low), np.log(high), points))
    grid[0], grid[-1] = low, high
    return np.asarray(grid)


def _least(
    function: Callable[[np.ndarray], np.ndarray], weights: np.ndarray, values: np.ndarray
) -> tuple[float, Literal["", "low", "high"]]:
    """The weight with the least value: on the grid, then on finer grids between the neighbours."""
    i = int(np.argmin(values))
    if i == 0:
        return float(weights[0]), "low"
    if i == len(weights) - 1:
        return float(weights[-1]), "high"
    around = weights[i - 1 : i + 2]
    for _ in range(4):
        finer = _grid(around[0], around[-1], 41)
        i = min(max(int(np.argmin(function(finer))), 1), len(finer) - 2)
        around = finer[i - 1 : i + 2]
    return float(around[1]), ""


def _choice(
    system: Decomposition,
    weights: np.ndarray,
    criterion: np.ndarray,
    regularization: float,
    edge: Literal["", "low", "high"],
) -> Choice:
    return Choice(regularization, edge, weights, criterion, *norms(system, weights))


CHOICES = {"gcv": gcv, "l-curve": l_curve, "discrepancy": discrepancy}
