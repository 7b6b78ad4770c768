"""Noise of known colour: what is found, what is left, and what becomes of least squares."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from millcal.numerics.whitening import Autoregression, fit_autoregression, whiten

TRUE = np.array([1.2, -0.5, 0.15])


def coloured(samples, seed=0, a=TRUE, sd=2.0):
    w = np.random.default_rng(seed).standard_normal(samples + 300) * sd
    return lfilter([1.0], np.concatenate([[1.0], -a]), w)[300:]


def correlations(values, lags=6):
    return np.array([values[lag:] @ values[:-lag] for lag in range(1, lags + 1)]) / (values @ values)


def test_the_coefficients_come_back():
    found = fit_autoregression([coloured(40_000)])
    assert found.coefficients == pytest.approx(TRUE, abs=0.02)
    assert found.sd == pytest.approx(2.0, rel=0.02)
    assert found.total_sd == pytest.approx(np.std(coloured(40_000)), rel=1e-3)


def test_short_pieces_tell_what_one_long_piece_tells():
    """Without the lean to zero of an autocovariance: forty samples between teeth, noise of a 300 Hz low-pass at 10 kHz."""
    low_passed = lfilter(*butter(2, 300 / 5000), np.random.default_rng(1).standard_normal(60_000))[1000:]
    low_passed += 0.02 * np.random.default_rng(2).standard_normal(len(low_passed))
    long = fit_autoregression([low_passed[20_000:]])
    short = fit_autoregression(list(low_passed[:4000].reshape(100, 40)))
    assert short.sd == pytest.approx(long.sd, rel=0.05)
    left = whiten(short, low_passed[20_000:])[4:]
    assert np.std(left) == pytest.approx(1.0, rel=0.05)


def test_whitened_noise_is_white_and_of_unit_size():
    noise = coloured(20_000, seed=3)
    white = whiten(fit_autoregression([noise[:10_000]]), noise)[10_000:]
    assert np.std(white) == pytest.approx(1.0, rel=0.03)
    assert np.all(np.abs(correlations(white)) < 4 / np.sqrt(len(white)))


@pytest.mark.parametrize("seed", range(8))
def test_white_noise_gets_no_filter(seed):
    white = np.random.default_rng(seed).standard_normal(2000)
    found = fit_autoregression([white])
    assert len(found.coefficients) <= 2  # by chance, and then faint ones
    assert np.all(np.abs(found.coefficients) < 0.1)
    assert found.sd == pytest.approx(1.0, rel=0.05)


def test_whitening_is_the_difference_equation_for_columns_of_any_shape():
    noise = Autoregression(np.array([0.5, -0.2]), 2.0, 3.0)
    values = np.random.default_rng(0).normal(size=(9, 2, 3))
    white = whiten(noise, values)
    assert white[5] == pytest.approx((values[5] - 0.5 * values[4] + 0.2 * values[3]) / 2)
    assert white[0] == pytest.approx(values[0] / 2)
    assert whiten(noise, values[:, 1, 2]) == pytest.approx(white[:, 1, 2])


def test_intervals_of_least_squares_are_right_after_whitening_and_too_short_before():
    """The mean of 400 samples: its spread over 300 records in units of the standard error that white noise would give."""
    noise = fit_autoregression([coloured(20_000, seed=99)])
    before, after = [], []
    for seed in range(300):
        record = coloured(400, seed)
        before.append(record.mean() / (noise.total_sd / 20))
        y, column = whiten(noise, record)[3:], whiten(noise, np.ones(400))[3:]
        after.append((column @ y) / np.sqrt(column @ column))
    assert np.std(before) > 2
    assert np.std(after) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("samples", [1, 3, 12])
def test_too_few_samples_for_any_coefficient_leave_the_noise_white(samples):
    piece = np.random.default_rng(0).standard_normal(samples)
    found = fit_autoregression([piece])
    assert len(found.coefficients) <= samples // 10
    assert found.total_sd == pytest.approx(np.sqrt(np.mean(piece**2)))


def test_pieces_shorter_than_the_order_are_no_harm():
    pieces = [coloured(3000), np.zeros(2), np.zeros(0)]
    assert fit_autoregression(pieces).coefficients == pytest.approx(
        fit_autoregression(pieces[:1]).coefficients, rel=1e-12
    )


def test_a_dead_channel_has_no_noise():
    assert fit_autoregression([np.zeros(500)]).sd == 0.0
