"""Laws of hits in a record: found at any block size, judged by shape, not by scale."""

import numpy as np
import pytest

from millcal.numerics.impact_hits import (
    find_hits,
    moving_mean,
    noise_of,
    pulse_crest,
    runs,
    second_pulse,
    survey_hit,
)


def half_sine(n, start, length, peak=1.0):
    pulse = np.zeros(n)
    pulse[start : start + length] = peak * np.sin(np.pi * (np.arange(length) + 0.5) / length)
    return pulse


def record(rng, starts, n=200_000, length=20, peak=100.0, noise=0.2, offset=3.0):
    force = offset + noise * rng.standard_normal(n)
    for start in starts:
        force += half_sine(n, start, length, peak)
    return force[None]


def blocks(force, size):
    return [(a, force[:, a : a + size]) for a in range(0, force.shape[1], size)]


STARTS = (5000, 40_000, 65_530, 120_000)  # one across the border of a block of 65536


def test_noise_and_mean_do_not_see_the_pulses():
    force = record(np.random.default_rng(1), STARTS)
    mean, noise = noise_of(force)
    assert mean[0] == pytest.approx(3.0, abs=0.01)
    assert noise[0] == pytest.approx(0.2, rel=0.02)


def test_noise_is_seen_where_a_coarse_converter_rests_on_one_count():
    counts = np.where(np.random.default_rng(2).uniform(size=10_000) < 0.2, 1.0, 0.0)
    assert noise_of(counts[None])[1][0] > 0.2


def test_moving_mean_is_the_mean_of_each_window():
    x = np.random.default_rng(3).standard_normal(50)
    assert moving_mean(x, 7) == pytest.approx([x[i : i + 7].mean() for i in range(44)])


def test_runs_are_the_stretches_of_true():
    assert runs(np.array([1, 1, 0, 1, 0, 0, 1], bool)).tolist() == [[0, 2], [3, 4], [6, 7]]
    assert runs(np.zeros(3, bool)).tolist() == []


@pytest.mark.parametrize("size", [200_000, 65_536, 7001])
def test_hits_are_found_where_they_are_at_any_block_size(size):
    force = record(np.random.default_rng(4), STARTS)
    found = find_hits(blocks(force, size), hold_off=2000)
    assert [a for a, _ in found] == pytest.approx(STARTS, abs=2)
    assert [b for _, b in found] == pytest.approx([start + 20 for start in STARTS], abs=2)


@pytest.mark.parametrize("scale", [-1.0, 1e-6, 1e6])
def test_detection_does_not_depend_on_unit_or_sign(scale):
    force = record(np.random.default_rng(5), STARTS)
    expected = find_hits(blocks(force, 65_536), hold_off=2000)
    assert find_hits(blocks(scale * force, 65_536), hold_off=2000) == expected


def test_a_slow_drift_of_the_offset_is_no_hit():
    force = record(np.random.default_rng(6), STARTS) + np.linspace(0, 30, 200_000)
    found = find_hits(blocks(force, 8192), hold_off=2000)
    assert [a for a, _ in found] == pytest.approx(STARTS, abs=2)


def test_pulses_closer_than_the_hold_off_are_one_hit():
    force = record(np.random.default_rng(7), (5000, 5800, 40_000))
    assert len(find_hits(blocks(force, 65_536), hold_off=2000)) == 2
    assert len(find_hits(blocks(force, 65_536), hold_off=500)) == 3


def test_noise_alone_and_silence_hold_no_hit():
    rng = np.random.default_rng(8)
    assert find_hits(blocks(rng.standard_normal((1, 100_000)), 65_536), hold_off=100) == []
    assert find_hits(blocks(np.zeros((1, 100_000)), 65_536), hold_off=100) == []


def test_hits_in_any_direction_of_a_three_axis_sensor_are_found():
    rng = np.random.default_rng(9)
    force = rng.standard_normal((3, 60_000)) * 0.2
    for start, direction in ((10_000, (1, 0, 0)), (25_000, (0, -1, 0.5)), (50_000, (-0.6, 0.6, 0.5))):
        force += np.array(direction)[:, None] * half_sine(60_000, start, 20, 100.0)
    assert [a for a, _ in find_hits(blocks(force, 65_536), 2000)] == pytest.approx([10_000, 25_000, 50_000], abs=2)


@pytest.mark.parametrize(("share", "after"), [(0.4, 400), (0.06, 100), (0.3, 26), (0.3, 21), (0.4, -300), (0.3, -26)])
def test_a_second_pulse_is_found_far_beside_and_merged_after_and_before(share, after):
    rng = np.random.default_rng(10)
    pulse = half_sine(8192, 2000, 20) + half_sine(8192, 2000 + after, 20, share) + 0.002 * rng.standard_normal(8192)
    found = second_pulse(pulse, 2000, 2020, 0.002)
    assert found is not None
    assert found[0] == pytest.approx(share, rel=0.25)
    assert found[1] == pytest.approx(after, abs=12)
    assert found[2] <= min(2000, 2000 + after) + 2
    assert found[3] >= max(2020, 2020 + after) - 2


def test_a_single_pulse_with_the_ringing_of_a_filter_is_no_double():
    n, t = 8192, np.arange(8192) - 2000.0
    ringing = half_sine(n, 2000, 8) + 0.03 * np.sinc(0.92 * t)
    pulse = ringing + 0.001 * np.random.default_rng(11).standard_normal(n)
    assert second_pulse(pulse, 2000, 2008, 0.001) is None


def test_the_survey_of_a_hit_reads_what_was_put_in():
    rng = np.random.default_rng(13)
    t = np.arange(8192 - 210) / 25600.0
    response = 0.5 + 0.01 * rng.standard_normal((1, 8192))
    response[0, 210:] += 40 * np.exp(-50 * t) * np.sin(2 * np.pi * 100 * t)
    force = 2.0 + 0.1 * rng.standard_normal((1, 8192)) + half_sine(8192, 200, 60, 500.0)
    found = survey_hit(force, response, 26)
    assert (found.onset, found.stop) == (pytest.approx(200, abs=2), pytest.approx(260, abs=2))
    assert (found.first, found.last) == (found.onset, found.stop)
    assert found.peak == pytest.approx(500, rel=0.01)
    assert found.second is None
    assert found.force_rest.value[0] == pytest.approx(2.0, abs=0.01)
    assert found.force_noise[0] == pytest.approx(0.1, rel=0.05)
    assert found.response_rest.value[0] == pytest.approx(0.5, abs=0.01)
    assert found.response_noise[0] == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("length", [6.3, 20.0, 71.6])
@pytest.mark.parametrize("place", [0.0, 0.4])
def test_the_crest_of_a_half_sine_is_4_over_pi_at_any_length_size_and_place_and_less_where_it_is_cut(length, place):
    """Peak P, area 2 P d / pi, energy P^2 d / 2."""
    t = np.arange(200) - 60.0 - place
    pulse = 700.0 * np.where((t >= 0) & (t <= length), np.sin(np.pi * t / length), 0.0)
    onset, stop = 60, 62 + int(length)
    assert pulse_crest(pulse, onset, stop) == pytest.approx(4 / np.pi, rel=0.02)
    assert pulse_crest(np.minimum(pulse, 0.85 * 700.0), onset, stop) == pytest.approx(1.172, rel=0.02)


def test_noise_of_is_the_quantiles_of_the_samples():
    x = np.random.default_rng(15).standard_normal((3, 777))
    q05, q25, q50, q75, q95 = np.percentile(x, (5, 25, 50, 75, 95), axis=1)
    mean, noise = noise_of(x)
    assert mean == pytest.approx(q50)
    assert noise == pytest.approx(np.maximum((q75 - q25) / 1.349, (q95 - q05) / 3.290))
