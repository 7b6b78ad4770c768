"""The jackknife and Student's quantile against what is known in closed form."""

import numpy as np
import pytest

from millcal.numerics.jackknife import jackknife_covariance, student_quantile


def test_the_jackknife_of_a_mean_is_the_textbook_standard_error():
    x = np.random.default_rng(0).standard_normal((9, 2))
    left_out = np.stack([np.delete(x, i, axis=0).mean(axis=0) for i in range(9)])
    assert jackknife_covariance(left_out) == pytest.approx(np.cov(x.T) / 9)


@pytest.mark.parametrize(("dof", "value"), [(1, 12.7062), (4, 2.77645), (np.inf, 1.95996)])
def test_the_quantile_is_that_of_the_tables(dof, value):
    assert student_quantile(dof) == pytest.approx(value, abs=1e-4)


def test_without_degrees_of_freedom_the_interval_is_infinite():
    assert student_quantile(0) == float("inf")
