"""What a filter that follows coefficients through a cut leaves behind, the same for all of them.

A step is a run of samples; its values are those at its end, its innovations those of the samples in it that were used. An
innovation is the measured force less what was foretold before the sample was seen, over its foretold standard deviation: where
model and noise are right, its mean is 0 and its mean square 1.
"""

from typing import NamedTuple

import numpy as np


class Followed(NamedTuple):
    """Parameters as in `sampled_force`, runout last."""

    mean: np.ndarray  # (step, parameter)
    covariance: np.ndarray  # (step, parameter, parameter)
    innovation_mean: np.ndarray  # (step, axis); nan where a step has no used sample
    innovation_square: np.ndarray  # (step, axis); likewise
    count: np.ndarray  # (step,) int, samples used
    at_bound: np.ndarray  # (step, parameter), share of the used samples, or of the members, at a bound
    members: np.ndarray = np.empty((0, 0))  # (member, parameter) at the end; none but of an ensemble
    probability: np.ndarray = np.empty((0, 0))  # (step, model), of interacting models; else none
    log_likelihood: float = float("nan")  # of all used samples; nan where it is not known
