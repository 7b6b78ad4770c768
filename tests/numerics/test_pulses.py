"""Pulse edges between the samples."""

import numpy as np
import pytest

from millcal.numerics.pulses import number_pulses, pulse_times
from millcal.numerics.spectra import reader_of

PERIOD = 97.3


def pulses(n, width=0.06, rise=3.0, first=20.0):
    """A train with linear flanks `rise` samples long; the leading edge passes the middle at first + i PERIOD."""
    phase = (np.arange(n) - first + PERIOD / 4) % PERIOD - PERIOD / 4
    up = np.clip(phase / rise + 0.5, 0, 1)
    down = np.clip((width * PERIOD - phase) / rise + 0.5, 0, 1)
    return np.minimum(up, down)


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (5.0, -1.0), (-2.0, 3.0)])
def test_leading_edges_are_timed_between_samples_whatever_level_and_polarity(scale, offset):
    y = offset + scale * pulses(5000)
    found = pulse_times(reader_of(y[np.newaxis]), 0, 5000)
    assert found == pytest.approx(20.0 + PERIOD * np.arange(len(found)), abs=1e-9)
    assert len(found) == 52


def test_blocks_of_any_size_give_the_same_edges():
    y = pulses(5000)[np.newaxis]
    assert np.array_equal(pulse_times(reader_of(y), 0, 5000, size=37), pulse_times(reader_of(y), 0, 5000))


def test_noise_on_a_slow_edge_makes_no_second_pulse():
    rng = np.random.default_rng(1)
    y = pulses(20_000, width=0.4, rise=20.0) + 0.05 * rng.standard_normal(20_000)
    found = pulse_times(reader_of(y[np.newaxis]), 0, 20_000)
    assert np.diff(found) == pytest.approx(PERIOD, abs=6.0)


def test_a_constant_signal_has_no_pulses():
    assert len(pulse_times(reader_of(np.ones((1, 100))), 0, 100)) == 0


def test_marks_are_numbered_through_missed_and_false_pulses_at_a_varying_speed():
    turns = np.arange(400)
    true = 125.4 * (turns + 0.5 * np.sin(2 * np.pi * turns / 150))  # 2 % faster and slower
    missed = np.delete(turns, [17, 18, 200])
    false = np.array([true[0] - 40.0, true[50] + 6.0, true[90] + 60.0, true[300] - 50.0])
    times = np.sort(np.concatenate([true[missed], false]))
    kept, numbers = number_pulses(times, 125.4)
    assert np.array_equal(times[kept], true[missed])
    assert np.array_equal(numbers, missed)


def test_one_pulse_or_none_is_no_trouble():
    assert [len(part) for part in number_pulses(np.empty(0), 10.0)] == [0, 0]
    assert [len(part) for part in number_pulses(np.array([3.0]), 10.0)] == [1, 1]
