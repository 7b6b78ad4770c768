"""What is known of the force of a fit: which axes, and whether its mean. Accelerations know no mean, and not always every axis."""

import numpy as np

from millcal.data import Coefficients


def mean_is_known(fit: Coefficients) -> bool:
    """Whether any mean force was measured; a fit to accelerations has none."""
    return bool(np.isfinite(fit.measured_mean).any())


def axes_measured(fit: Coefficients) -> list[int]:
    """Rows of the axes along which there is a force; all where there is none at all."""
    rows = np.flatnonzero(np.isfinite(fit.measured).any(axis=(0, 2))).tolist()
    return rows or [0, 1, 2]


def comparable(fit: Coefficients) -> tuple[np.ndarray, np.ndarray]:
    """Measured and modelled force over the revolution, both without their mean where none was measured.

    returns (cut, axis, angle) N each
    """
    mean = np.isfinite(fit.measured_mean)[:, :, np.newaxis]
    measured, modelled = (np.where(mean, v, v - v.mean(axis=2, keepdims=True)) for v in (fit.measured, fit.modelled))
    return measured, modelled
