"""A smooth course through noise: a line where there is one, the wave where there is one, exact values left alone."""

import numpy as np
import pytest

from millcal.numerics.smooth_sequence import smooth_sequence


def test_a_line_stays_the_line():
    assert smooth_sequence(3.0 + 0.2 * np.arange(50)) == pytest.approx(3.0 + 0.2 * np.arange(50))


@pytest.mark.parametrize("seed", range(5))
def test_noise_about_a_line_is_smoothed_to_nearly_the_fitted_line(seed):
    noise = np.random.default_rng(seed).uniform(-0.5, 0.5, 300)
    found = smooth_sequence(noise)
    assert np.sqrt(np.mean(found**2)) < 0.08


def test_a_slow_wave_is_followed_and_its_noise_is_not():
    i = np.arange(400)
    wave = 4 * np.sin(2 * np.pi * i / 90)
    found = smooth_sequence(wave + np.random.default_rng(1).normal(0, 0.3, 400))
    assert np.sqrt(np.mean((found - wave) ** 2)) < 0.12
    assert smooth_sequence(wave) == pytest.approx(wave, abs=2e-2)


def test_missing_values_are_bridged_smoothly():
    i = np.arange(200)
    wave = np.sin(2 * np.pi * i / 80)
    weights = np.ones(200)
    weights[[50, 51, 52, 120]] = 0
    values = np.where(weights > 0, wave, 1e6)
    assert smooth_sequence(values, weights) == pytest.approx(wave, abs=5e-3)


def test_the_likelihood_is_that_of_the_dense_gaussian():
    """The chosen course is the posterior mean of an integrated walk: against the dense solution at every penalty."""
    rng = np.random.default_rng(3)
    y = np.cumsum(np.cumsum(rng.normal(0, 0.02, 40))) + rng.normal(0, 0.3, 40)
    D = np.diff(np.eye(40), 2, axis=0)
    X = np.column_stack([np.ones(40), np.arange(40.0)])
    best, course = np.inf, None
    for penalty in 10.0 ** np.arange(-2, 14.1, 0.5):
        S = np.linalg.pinv(D.T @ D) / penalty
        V = np.eye(40) + S
        Vi = np.linalg.inv(V)
        P = Vi - Vi @ X @ np.linalg.solve(X.T @ Vi @ X, X.T @ Vi)
        cost = 38 * np.log(y @ P @ y) + np.linalg.slogdet(V)[1] + np.linalg.slogdet(X.T @ Vi @ X)[1]
        if cost < best:
            best, course = cost, np.linalg.solve(np.eye(40) + penalty * D.T @ D, y)
    assert smooth_sequence(y) == pytest.approx(course, abs=1e-6)
