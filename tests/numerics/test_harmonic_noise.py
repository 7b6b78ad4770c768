"""Errors of harmonics against what the lines between them say of them."""

import numpy as np
import pytest

from millcal.numerics.harmonic_noise import harmonic_noise
from millcal.numerics.residual_lines import WINDOWED, fast_length, lines_standing_out, residual_spectra
from millcal.numerics.spectra import fit_harmonics, reader_of

CYCLE = 1 / 123.7  # cycles per sample
K = 6


def some_harmonics(channels=3):
    rng = np.random.default_rng(1)
    c = rng.standard_normal((channels, K + 1)) + 1j * rng.standard_normal((channels, K + 1))
    c[:, 0] = 0
    return c


def signal(c, n, share=1.0):
    angle = 2 * np.pi * CYCLE * np.arange(n)
    return share * np.real(c @ np.exp(1j * np.outer(np.arange(K + 1), angle)))


def errors_and_noise(y, c, *, stretches=1, windowed=True):
    n = y.shape[1]
    read = reader_of(y)
    fitted = fit_harmonics(read, 0, n, CYCLE, K)
    size = fast_length(n // stretches) if windowed else n
    lines = int((K + 0.5) * CYCLE * size) + 1
    spectra = residual_spectra(read, 0, size, stretches, CYCLE, fitted, cross_lines=lines, windowed=windowed)
    apart = lines_standing_out(spectra, CYCLE)[1]
    return fitted - c, harmonic_noise(spectra, CYCLE, fitted, n, apart)


def whitened(error, covariance):
    """e^H C^-1 e per channel, of each harmonic from 1."""
    return [
        (error[:, k].conj() @ np.linalg.solve(covariance[k], error[:, k])).real / len(error) for k in range(1, K + 1)
    ]


def whole(periods):
    return round(periods / CYCLE)


@pytest.mark.parametrize(
    ("n", "kind"), [(whole(200), {}), (whole(200), {"stretches": 16}), (whole(4), {"windowed": False})]
)
def test_of_white_noise_the_covariance_is_4_s2_over_n(n, kind):
    s = np.array([0.3, 2.0, 0.01])
    rng = np.random.default_rng(2)
    found = [
        errors_and_noise(
            signal(some_harmonics(), n) + s[:, None] * rng.standard_normal((3, n)), some_harmonics(), **kind
        )
        for _ in range(60)
    ]
    mean = np.mean([noise.covariance for _, noise in found], axis=0)
    scale = 4 * np.multiply.outer(s, s) / n
    assert np.mean(mean[1:] / scale, axis=0) == pytest.approx(np.eye(3), abs=0.07)
    assert np.all(mean[0] == 0)


def test_of_coloured_noise_that_channels_share_the_covariance_is_that_of_the_errors():
    """A resonance at the third harmonic reaches every channel; each channel has noise of its own, too."""
    from scipy.signal import lfilter

    n, rng = whole(150), np.random.default_rng(3)
    mix, r = rng.standard_normal((3, 2)), 0.99
    errors, told = [], []
    for _ in range(60):
        shared = lfilter([1 - r], [1, -2 * r * np.cos(6 * np.pi * CYCLE), r * r], rng.standard_normal((2, n + 4000)))
        y = signal(some_harmonics(), n) + 3 * mix @ shared[:, 4000:] + 0.01 * rng.standard_normal((3, n))
        error, noise = errors_and_noise(y, some_harmonics())
        errors.append(error)
        told.append(noise.covariance)
    mean, errors = np.mean(told, axis=0), np.array(errors)
    ratio = np.mean([whitened(error, mean) for error in errors], axis=0)
    assert ratio == pytest.approx(np.ones(K), abs=0.35)  # 180 complex draws each, and the resonance is narrow
    spread = np.einsum("sak,sbk->kab", errors, errors.conj()) / len(errors)
    for k in (2, 3, 4):
        assert np.linalg.norm(spread[k] - mean[k]) < 0.4 * np.linalg.norm(mean[k])


def test_the_draws_count_lines_less_what_the_window_makes_alike():
    n = whole(50)
    y = signal(some_harmonics(), n) + np.random.default_rng(4).standard_normal((3, n))
    noise = errors_and_noise(y, some_harmonics())[1]
    assert noise.draws[0] == 0
    assert np.all(noise.draws[1:] <= (50 - 3 + 2) / WINDOWED)
    assert np.all(noise.draws[2:] > 0.8 * (50 - 3) / WINDOWED)


def test_few_periods_borrow_lines_beside_other_harmonics():
    n = whole(9)
    y = signal(some_harmonics(), n) + np.random.default_rng(5).standard_normal((3, n))
    noise = errors_and_noise(y, some_harmonics())[1]
    assert np.all(noise.draws[1:] >= 14)
    assert all(np.linalg.cond(c) < 100 for c in noise.covariance[1:])


def test_a_line_between_harmonics_is_no_noise_of_those_far_from_it():
    """At 3.3 times the fundamental: harmonics 1 and 6 keep the covariance of the noise, and 3 has what reaches it."""
    n, rng = whole(400), np.random.default_rng(6)
    y = signal(some_harmonics(), n) + 0.05 * rng.standard_normal((3, n))
    plain = errors_and_noise(y, some_harmonics())[1].covariance
    chatter = np.outer([1.0, 0.4, 0.2], np.cos(2 * np.pi * 3.3021 * CYCLE * np.arange(n) + 0.3))
    errors, noise = errors_and_noise(y + chatter, some_harmonics())
    level = np.trace(noise.covariance, axis1=1, axis2=2).real
    before = np.trace(plain, axis1=1, axis2=2).real
    assert np.all(level[[1, 6]] < 1.6 * before[[1, 6]])
    assert level[3] < 0.02 * 1.2 / 400  # were it noise of the 400 lines nearby
    assert np.all(np.linalg.norm(errors, axis=0)[1:] < 4 * np.sqrt(level[1:]))


@pytest.mark.parametrize("stretches", [1, 16])
def test_harmonics_whose_size_changes_slowly_err_by_what_their_side_lines_hold(stretches):
    """Every harmonic swells together, over some periods: the mean over the cut misses by far more than the noise between."""
    from scipy.signal import lfilter

    n, rng, c = whole(300), np.random.default_rng(7), some_harmonics()
    memory = 0.999
    ratios, noises = [], []
    for _ in range(60):
        swell = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(n + 8000))[8000:]
        y = signal(c, n, 1 + 0.03 * swell) + 0.05 * rng.standard_normal((3, n))
        error, noise = errors_and_noise(y, c, stretches=stretches)
        ratios.append(whitened(error, noise.covariance))
        noises.append(np.trace(noise.covariance[2]).real)
    assert np.mean(noises) > 20 * 3 * 4 * 0.05**2 / n
    assert 0.6 < np.mean(ratios) < 1.6


def test_slow_waves_below_the_fundamental_add_what_reaches_the_harmonics_and_are_not_taken_for_noise():
    n, rng = whole(40), np.random.default_rng(8)
    errors, told = [], []
    for _ in range(40):
        y = signal(some_harmonics(), n) + 0.02 * rng.standard_normal((3, n))
        slow = np.cos(2 * np.pi * (rng.uniform(2, 4) * np.arange(n) / n + rng.uniform()))
        error, noise = errors_and_noise(y + np.outer([4.0, 0.0, 0.0], slow), some_harmonics())
        errors.append(np.abs(error[:, 1:]) ** 2)
        told.append(np.diagonal(noise.covariance[1:], axis1=1, axis2=2).real.T)
    ratio = np.mean(errors, axis=0) / np.mean(told, axis=0)
    assert np.mean(told, axis=0)[0, 0] > 10 * 4 * 0.02**2 / n
    assert np.all((ratio > 0.4) & (ratio < 2.5))
    assert np.mean(told, axis=0)[1:] == pytest.approx(4 * 0.02**2 / n, rel=0.15)


@pytest.mark.parametrize("longest", [1, 2, 7, 97, 1000, 128_003, 1 << 20])
def test_a_fast_length_has_no_factor_beyond_five_and_is_near(longest):
    found = fast_length(longest)
    assert 0.85 * longest <= found <= longest
    for factor in (2, 3, 5):
        while found % factor == 0:
            found //= factor
    assert found == 1
