"""Tones between harmonics: place, power, sharpness, company."""

import numpy as np
import pytest

from millcal.numerics import spectra
from millcal.numerics.residual_lines import residual_spectra
from millcal.numerics.tones import Tone, families, find_tones, folded

N, CYCLE = 30_000, 0.0101


def found_in(y, n=N, wander=0.0):
    """The tones that harmonics 0..20 leave.   y : (sample,)"""
    read = spectra.reader_of(y[np.newaxis])
    harmonics = spectra.fit_harmonics(read, 0, n, CYCLE, 20)
    return find_tones(residual_spectra(read, 0, n, 1, CYCLE, harmonics), 0, CYCLE, harmonics[0], wander=wander)


@pytest.mark.parametrize("place", [3.2, 7.5, 11.93])
def test_place_and_power_of_a_tone_beside_large_harmonics(place):
    rng, time = np.random.default_rng(0), np.arange(N)
    y = sum(np.cos(2 * np.pi * k * CYCLE * time + k) for k in range(1, 15)) + 0.02 * rng.normal(size=N)
    y += 0.1 * np.cos(2 * np.pi * place * CYCLE * time)
    (tone,) = found_in(y)
    assert tone.frequency == pytest.approx(place * CYCLE, abs=3 * tone.deviation)
    assert tone.power == pytest.approx(0.005, rel=0.1)
    assert tone.sharp


def test_noise_has_no_tones():
    rng = np.random.default_rng(2)
    assert [tone for _ in range(20) for tone in found_in(rng.normal(size=N))] == []


def test_what_noise_makes_of_a_resonance_is_no_sharp_tone():
    """A resonance of 1 % damping at 0.11 cycles per sample, driven by white noise."""
    rng = np.random.default_rng(4)
    frequency = np.fft.rfftfreq(N)
    gain = 1 / (1 - (frequency / 0.11) ** 2 + 2j * 0.01 * frequency / 0.11)
    for _ in range(10):
        y = np.fft.irfft(gain * np.fft.rfft(rng.normal(size=N)), N)
        assert not [tone for tone in found_in(y) if tone.sharp and tone.power > 0.1 * y.var()]


def test_a_harmonic_whose_phase_wanders_leaves_no_tone_beside_it():
    rng, time = np.random.default_rng(6), np.arange(N)
    phase = 2 * np.pi * CYCLE * time + 0.3 * np.cos(2 * np.pi * 2.5 * time / N)
    y = sum(np.cos(k * phase) / k for k in range(1, 8)) + 0.01 * rng.normal(size=N)
    told = [tone for tone in found_in(y, wander=2e-3) if tone.power > 0.02 * y.var()]
    assert told == []


def test_tones_that_modulate_each_other_fall_on_one_place_when_folded():
    by, f = 0.02, 0.0743
    assert folded(f + 3 * by, by) == pytest.approx(folded(f, by))
    assert folded(by * 5 - f, by) == pytest.approx(folded(f, by))


def test_a_family_is_a_whole_number_of_steps_apart_and_the_strongest_comes_first():
    step, f = 0.02, 0.0743
    tones = [Tone(x, 1e-6, p, True) for x, p in ((0.11, 0.9), (f, 0.5), (f + step, 0.3), (5 * step - f, 0.3))]
    first, second = families(tones, step, 1e-4)
    assert [tone.frequency for tone in first] == [f, f + step, 5 * step - f]
    assert second == tones[:1]
