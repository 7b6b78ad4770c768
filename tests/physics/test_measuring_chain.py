"""The analog low-pass as a recursion over samples."""

import numpy as np
import pytest
from scipy import signal

from millcal.physics.measuring_chain import butterworth, discrete_butterworth

CHAINS = [(300.0, 2, 10e3), (600.0, 2, 10e3), (600.0, 2, 5e3), (300.0, 1, 5e3), (800.0, 4, 10e3), (1000.0, 8, 25e3)]


@pytest.mark.parametrize(("corner", "order", "rate"), CHAINS)
def test_the_recursion_answers_as_the_analog_filter(corner, order, rate):
    b, a = discrete_butterworth(corner, order, rate)
    frequency = np.linspace(0, rate / 4, 400)
    _, found = signal.freqz(b, a, worN=frequency, fs=rate)
    expected = butterworth(frequency, corner, order)
    difference = np.abs(found - expected)
    assert found[0] == pytest.approx(1.0, abs=1e-9)
    assert difference.max() < (0.007 if order > 1 else 0.03)
    low = frequency <= rate / 10
    assert (difference / np.abs(expected))[low].max() < (0.004 if order > 1 else 0.02)


def test_a_band_limited_signal_comes_out_as_by_the_analog_filter():
    """Harmonics up to 900 Hz through 300 Hz at 10 kHz; a first-order hold would be twenty times as far off."""
    rate, corner, order = 10e3, 300.0, 2
    rng, time = np.random.default_rng(3), np.arange(20_000) / rate
    frequency = 85.0 * np.arange(1, 11)
    amplitude = rng.standard_normal(10) + 1j * rng.standard_normal(10)
    wave = np.exp(2j * np.pi * np.outer(time, frequency))
    through = signal.lfilter(*discrete_butterworth(corner, order, rate), (wave @ amplitude).real)
    expected = (wave @ (amplitude * butterworth(frequency, corner, order))).real
    settled = time > 0.1

    def off(out):
        return np.std((out - expected)[settled]) / np.std(expected)

    assert off(through) < 7e-4
    poles = np.exp(1j * np.pi * np.array([3, 5]) / 4)
    b, a, _ = signal.cont2discrete(([1.0], np.poly(poles).real), 2 * np.pi * corner / rate, method="foh")
    assert off(signal.lfilter(b[0], a, (wave @ amplitude).real)) > 10 * off(through)


def test_refuses_a_corner_that_the_samples_cannot_show():
    with pytest.raises(ValueError, match="half of sample_rate"):
        discrete_butterworth(2500.0, 2, 5000.0)
