"""Laws of the faults of a hit: each is found where it was put, and nothing is found in sound records of any converter."""

import numpy as np
import pytest

from millcal.numerics.impact_faults import (
    bumps_beside_model,
    delays_of,
    frozen,
    is_flat_topped,
    late_bumps,
    overloaded,
    phase_slopes,
    unexplained_level,
)

RATE = 25600.0


def half_sine(n, start, length, peak=1.0):
    pulse = np.zeros(n)
    pulse[start : start + length] = peak * np.sin(np.pi * (np.arange(length) + 0.5) / length)
    return pulse


def decay(n, start, *, frequency=(650.0, 1200.0), sigma=60.0, peak=1.0):
    """A ringing that begins at rest."""
    t = np.arange(n - start) / RATE
    out = np.zeros(n)
    for f in frequency:
        out[start:] += peak * np.exp(-sigma * t) * np.sin(2 * np.pi * f * t)
    return out


def test_a_flat_top_is_found_and_a_rounded_peak_on_few_counts_is_not():
    rng = np.random.default_rng(14)
    pulse = np.round(1000 * half_sine(400, 100, 60) + rng.standard_normal(400))  # counts of a converter
    assert not is_flat_topped(pulse)
    assert is_flat_topped(np.minimum(pulse, 850))
    assert not is_flat_topped(np.round(8 * half_sine(400, 100, 200)))  # many equal samples on the top count
    assert not is_flat_topped(np.zeros(100))
    assert is_flat_topped(-np.minimum(pulse, 850))


def test_a_ringing_cut_off_for_single_samples_is_found_by_its_equal_peaks():
    rng = np.random.default_rng(1)
    ringing = np.round(20_000 * decay(8192, 200, frequency=(2100.0,), sigma=30.0) + 5 * rng.standard_normal(8192))
    assert not is_flat_topped(ringing)
    assert is_flat_topped(np.minimum(ringing, 0.8 * ringing.max() // 1))


def test_a_known_input_range_shows_overload_of_either_sign_in_each_channel():
    pulse = 100 * half_sine(400, 100, 60) + 0.01 * np.random.default_rng(12).standard_normal(400)
    both = np.stack([pulse, -pulse, 0.5 * pulse])
    assert overloaded(both, np.full(3, 101.0)).tolist() == [False, False, False]
    assert overloaded(both, np.full(3, 100.0)).tolist() == [True, True, False]
    assert not overloaded(both, np.full(3, np.inf)).any()


def channel(rng, *, amplitude=3000.0, noise=5.0, n=8192, whole=True):
    samples = amplitude * decay(n, 200) + noise * rng.standard_normal(n)
    return np.round(samples) if whole else samples


@pytest.mark.parametrize("length", [8, 30, 400])
@pytest.mark.parametrize("value", [0.0, None])
def test_samples_that_stand_still_in_a_moving_signal_are_found_where_they_are(length, value):
    samples = channel(np.random.default_rng(2))
    held = samples[299] if value is None else value
    samples[300 : 300 + length] = held
    found = frozen(np.stack([channel(np.random.default_rng(3)), samples]), np.array([5.0, 5.0]))
    assert [row for row, *_ in found] == [1]
    assert found[0][1:] == (pytest.approx(300, abs=1), pytest.approx(300 + length, abs=1))


@pytest.mark.parametrize("length", [1, 2, 3])
def test_single_samples_lost_are_found_where_the_signal_is_slow_enough_to_tell(length):
    samples = 3000.0 * decay(8192, 200, frequency=(100.0,)) + np.random.default_rng(4).standard_normal(8192)
    top = 200 + int(0.25 * RATE / 100)
    samples[top : top + length] = 0.0
    assert frozen(samples[None], np.ones(1)) == [(0, top, top + length)]


@pytest.mark.parametrize("count", [0.01, 0.5, 3.0, 20.0])
def test_nothing_stands_still_in_a_sound_record_of_any_converter(count):
    """Noise of one, on converters from fine to so coarse that most of the samples rest on one count."""
    for seed in range(20):
        samples = channel(np.random.default_rng(seed), amplitude=300.0, noise=1.0, whole=False)
        assert frozen((np.round(samples / count) * count)[None], np.ones(1)) == []


def test_a_record_without_noise_may_rest_before_and_after_its_signal():
    pulses = half_sine(8192, 200, 20, 1000.0) + half_sine(8192, 900, 20, 400.0)
    ringing = decay(8192, 200, sigma=200.0)
    ringing[np.abs(ringing) < 1e-9] = 0.0
    assert frozen(np.stack([pulses, ringing]), np.zeros(2)) == []


def test_a_record_that_is_filled_up_with_zeros_while_it_rings_is_found():
    samples = channel(np.random.default_rng(5))
    samples[1000:] = 0.0
    assert frozen(samples[None], np.array([5.0])) == [(0, 1000, 8192)]


def levels(rng, hits, *, bump=None, size=0.1, beat=0.0, blocks=200, noise=1e-3):
    """Mean squares of decays with scatter, in blocks; one hit with a bump."""
    k = np.arange(blocks)
    power = np.exp(-k / 15) * (1 + beat * np.cos(2 * np.pi * k / 36)) / (1 + beat)
    out = power * rng.uniform(0.9, 1.1, (hits, 2, 1)) * rng.chisquare(26, (hits, 2, blocks)) / 26
    if bump is not None:
        out[0, :, bump:] += size**2 * np.exp(-(k[bump:] - bump) / 15)
    return out + noise**2 * rng.chisquare(26, out.shape) / 26, np.ones(hits), np.full((hits, 2), noise)


@pytest.mark.parametrize("hits", [3, 9])
@pytest.mark.parametrize("bump", [40, 120])
def test_a_bump_in_one_decay_is_found_by_the_others(hits, bump):
    for seed in range(20):
        found = late_bumps(*levels(np.random.default_rng(seed), hits, bump=bump, size=0.9 if bump == 40 else 0.1), 3)
        assert found[1:] == [None] * (hits - 1)
        assert found[0][0] == pytest.approx(bump, abs=3)


@pytest.mark.parametrize("hits", [1, 2, 9])
@pytest.mark.parametrize("beat", [0.0, 0.98])
def test_neither_a_decay_nor_a_beat_is_a_bump(hits, beat):
    for seed in range(40):
        assert late_bumps(*levels(np.random.default_rng(seed), hits, beat=beat), 3) == [None] * hits


def test_a_large_bump_is_found_in_a_hit_that_is_alone():
    for seed in range(20):
        (found,) = late_bumps(*levels(np.random.default_rng(seed), 1, bump=100, size=0.5), 3)
        assert found[0] == pytest.approx(100, abs=3)


def test_what_the_model_does_not_explain_shows_a_bump_far_below_the_decay():
    """Five hits on a known system, in one of which something of 1 % of the response happens 100 ms later."""
    rng = np.random.default_rng(6)
    n, lines, samples = 8192, 1024, 2048
    H = np.fft.rfft(decay(n, 0))[:lines]
    pulses = [half_sine(n, 160, 12, rng.uniform(0.7, 1.3)) for _ in range(5)]
    F = np.array([np.fft.rfft(pulse)[None, :lines] for pulse in pulses])
    noise = 1e-3
    X = np.array([np.fft.rfft(noise * rng.standard_normal(n))[None, :lines] for _ in range(5)]) + H * F
    X[2] += 0.01 * np.fft.rfft(decay(n, 160 + 2560, peak=np.abs(pulses[2]).sum()))[:lines]
    power = np.sum(np.abs(F[:, 0]) ** 2, axis=0)
    found_H = (np.sum(F.conj() * X, axis=0) / power)[:, None]
    shares = np.abs(F[:, 0]) ** 2 / power
    level = [unexplained_level(*hit, found_H, share, n, samples, 8) for *hit, share in zip(F, X, shares, strict=True)]
    found = bumps_beside_model(np.array(level), np.array([noise**2 * 2 * lines / n]), 8)
    assert [hit for hit, bump in enumerate(found) if bump] == [2]
    assert found[2][0] * 8 * n / samples == pytest.approx(160 + 2560, abs=128)


@pytest.mark.parametrize("delay", [-40e-6, 3e-6, 0.8e-3, -4e-3])
@pytest.mark.parametrize("first", [20.0, 500.0])
def test_a_delay_is_found_with_its_sign_whatever_its_size(delay, first):
    frequency = first + 12.5 * np.arange(200)
    rng = np.random.default_rng(7)
    expected = np.exp(2j * np.pi * rng.uniform(size=(2, 200))) * rng.uniform(0.01, 1, (2, 200))
    actual = expected * np.exp(-2j * np.pi * frequency * delay)
    actual = actual + 0.02 * np.abs(expected) * (rng.standard_normal((2, 200)) + 1j * rng.standard_normal((2, 200)))
    found, error = delays_of(actual, expected, frequency)
    assert np.abs(found - delay).max() < 5 * error.max()
    assert error.max() < 1e-6
    if abs(delay) < 5e-6:
        assert phase_slopes(actual, expected, frequency) == pytest.approx(np.full(2, delay), abs=1e-6)
