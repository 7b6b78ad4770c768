"""What a filter that follows coefficients through a cut leaves behind, the same for all of them.

A step is a run of samples; its values are those at its end, its innovations those of the samples in it that were used. An
innovation is the measured force less what was foretold before the sample was seen, over its foretold standard deviation: where
model and noise are right, its mean is 0 and its mean square 1.
"""

from typing import NamedTuple

import numpy as np

LEFT_OUT = 2.0  # see `left_out`


class Followed(NamedTuple):
    """Parameters as in `sampled_force`, runout last."""

    mean: np.ndarray  # (step, parameter)
    covariance: np.ndarray  # (step, parameter, parameter)
    innovation_mean: np.ndarray  # (step, axis); nan where a step has no used sample
    innovation_square: np.ndarray  # (step, axis); likewise
    count: np.ndarray  # type: ignore[assignment]  # (step,) int, samples used
    at_bound: np.ndarray  # (step, parameter), share of the used samples, or of the members, at a bound
    members: np.ndarray = np.empty((0, 0))  # (member, parameter) at the end; none but of an ensemble
    probability: np.ndarray = np.empty((0, 0))  # (step, model), of interacting models; else none
    log_likelihood: float = float("nan")  # of all used samples; nan where it is not known


def left_out(slopes: np.ndarray, spread: np.ndarray, directions: int) -> np.ndarray:
    """Variance of what linearising the force at the mean may have left out: noise on top of that of the sensor.

    The second-order term of exp(kappa) is the force times half the square of the doubt, those of shape and runout are of that
    kind. So the size is (sum J_p^2 P_pp)^2 / F^2, F the sum of what the directions contribute. The parameters' own
    variances count, not their covariances: doubts that cancel in the slope do not cancel in the curvature, and a filter
    that trusts the slope alone becomes certain of something false within the first tooth. The factor of two was found by
    trial, on cuts with noise down to 1e-4 of the force and starts a standard deviation off in everything. As the filter
    learns, it vanishes with the square of its variances.
    slopes : (axis, state), kappas at 0, 2, ...   spread : covariance, (state, state)   returns (axis,) N^2
    """
    alone = slopes**2 @ np.diag(spread)
    size = np.abs(slopes[:, 0 : 2 * directions : 2]).sum(axis=1)
    return LEFT_OUT * alone**2 / np.maximum(np.maximum(size**2, 1e-6 * alone), 1e-300)
