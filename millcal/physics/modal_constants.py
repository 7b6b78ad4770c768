"""What the residues of fitted modes say in a shop's words: stiffness, mass and damping where the tool is hit, and shapes.

The receptance is H(s) = sum_r A_r / (s - p_r) + its conjugate, p = -zeta w + j w_d with w_d = w sqrt(1 - zeta^2). At a
driving point alpha = Re(2j w_d A) = 1/m, so that m = 1/alpha, k = w^2/alpha and c = 2 zeta w/alpha; for real modes that is
exact, a complex mode has them at its peak only. Spread goes through to first order, row by row of the deviations, whose
product deviation^T deviation is the covariance: no correlation between frequency, damping and residue is lost. The inverses 1/k,
1/m and 1/c are what is near to normal, and they may be zero: at most driving points a mode across them hardly moves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.jackknife import student_quantile


class Estimate(NamedTuple):
    """A number of every mode, nan where it cannot be known, and its deviations."""

    value: np.ndarray  # (mode,)
    deviation: np.ndarray  # (deviation, mode)


class Constant(NamedTuple):
    """k, m or c of every mode: the inverse of what is fitted, which may be zero or, by noise, below it."""

    value: np.ndarray  # (mode,), nan where the inverse is not positive
    inverse: Estimate


class DrivingConstants(NamedTuple):
    """Every mode as a spring, a mass and a damper at one driving point."""

    stiffness: Constant  # k, N/m
    mass: Constant  # m, kg
    damping: Constant  # c, N s/m


def driving_points(outputs: Sequence[str], inputs: Sequence[str]) -> list[tuple[int, int]]:
    """(output, input) that are one point in one direction, whatever the signs of their dofs, in the order of the inputs."""
    names = [dof.lstrip("+-") for dof in outputs]
    return [(names.index(dof.lstrip("+-")), i) for i, dof in enumerate(inputs) if dof.lstrip("+-") in names]


def turned(output: str, given: str) -> float:
    """-1 where response and hammer count against each other, as in -tipX over tipX, else 1."""
    return -1.0 if output.startswith("-") != given.startswith("-") else 1.0


def driving_constants(frequency: Estimate, damping_ratio: Estimate, residue: Estimate) -> DrivingConstants:
    """k, m and c of every mode at a driving point.

    frequency : undamped natural frequency, Hz   residue : A of the receptance at that point, complex, s/kg
    """
    w, dw = (2 * np.pi * values for values in frequency)
    zeta, dzeta = damping_ratio
    a, da = residue
    root = np.sqrt(1 - zeta**2)
    alpha = np.real(2j * w * root * a)
    d_alpha = np.real(2j * (dw * root * a - w * zeta / root * dzeta * a + w * root * da))
    return DrivingConstants(
        _constant(alpha / w**2, (d_alpha - 2 * alpha * dw / w) / w**2),
        _constant(alpha, d_alpha),
        _constant(alpha / (2 * zeta * w), (d_alpha - alpha * (dzeta / zeta + dw / w)) / (2 * zeta * w)),
    )


def _constant(inverse: np.ndarray, deviation: np.ndarray) -> Constant:
    positive = inverse > 0
    return Constant(1 / np.where(positive, inverse, np.nan), Estimate(inverse, deviation))


def interval(estimate: Estimate, dof: float, *, share: float = 0.95, lowest: float = 0.0) -> np.ndarray:
    """The interval of a number by Student's t, cut where the number cannot be; nan where there are no deviations.

    dof : degrees of freedom behind the deviations   lowest : what the number cannot be below
    returns (mode, low and high)
    """
    value, deviation = estimate
    if not len(deviation) or not dof > 0:
        return np.full((len(value), 2), np.nan)
    half = student_quantile(dof, share) * np.sqrt(np.sum(deviation**2, axis=0))
    return np.stack([np.maximum(value - half, lowest), value + half], axis=1)


def interval_of_constant(constant: Constant, dof: float, *, share: float = 0.95) -> np.ndarray:
    """The interval of k, m or c: that of the inverse, turned over.

    Symmetric where it is narrow; without a high end (infinite) where the inverse cannot be told from zero, as where the mode
    hardly moves; nan where the inverse is below zero for sure, which no structure's is.   returns (mode, low and high)
    """
    ends = interval(constant.inverse, dof, share=share)[:, ::-1]
    with np.errstate(divide="ignore"):
        return 1 / np.where(ends[:, :1] > 0, ends, np.nan)


def mode_shapes(residue: np.ndarray) -> np.ndarray:
    """Shapes over the longer side of the residues, which is what was measured at more places.

    A = phi_o phi_i, so the shape is the vector nearest to all columns (or rows) at once, the first of the singular value
    decomposition; where pairs are missing (nan), the strongest column. It is turned to the phase along which it moves most,
    and its largest real part is 1.
    residue : complex (mode, output, input)   returns complex (mode, output), or (mode, input) where these are more
    """
    if residue.shape[2] > residue.shape[1]:
        residue = residue.transpose(0, 2, 1)
    if np.isfinite(residue).all():
        shape = np.linalg.svd(residue, full_matrices=False)[0][:, :, 0]
    else:
        strongest = np.argmax(np.nansum(np.abs(residue) ** 2, axis=1), axis=1)
        shape = residue[np.arange(len(residue)), :, strongest]
    shape = shape * np.exp(-0.5j * np.angle(np.nansum(shape**2, axis=1, keepdims=True)))
    largest = np.argmax(np.abs(np.nan_to_num(shape.real)), axis=1)
    scale = shape.real[np.arange(len(shape)), largest]
    return shape / np.where(scale == 0, 1.0, scale)[:, np.newaxis]
