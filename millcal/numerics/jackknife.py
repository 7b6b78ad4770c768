"""Standard errors from leaving one observation unit out at a time [Efron & Tibshirani 1993, ch. 11; Tukey 1958]."""

import numpy as np


def student_quantile(dof: float, share: float = 0.95) -> float:
    """Half width, in standard errors, of the two-sided interval of Student's t; infinite without degrees of freedom."""
    from scipy.special import ndtri, stdtrit

    if dof <= 0:
        return float("inf")
    return float(stdtrit(dof, 0.5 + share / 2)) if np.isfinite(dof) else float(ndtri(0.5 + share / 2))


def jackknife_covariance(left_out: np.ndarray) -> np.ndarray:
    """Covariance of an estimate from its values with each of the n units left out in turn.

    (n - 1)/n sum (theta_i - mean)(theta_i - mean)^T, to be read with n - 1 degrees of freedom.
    left_out : (unit, parameter)   returns (parameter, parameter)
    """
    n = len(left_out)
    deviation = left_out - left_out.mean(axis=0)
    return (n - 1) / n * deviation.T @ deviation
