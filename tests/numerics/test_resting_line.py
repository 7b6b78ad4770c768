"""Laws of the resting line: drift is read where it is, noise and ringing are no drift, a step is no line."""

import numpy as np
import pytest

from millcal.numerics.resting_line import resting_line, resting_line_beside

N, ONSET = 8192, 200


def response(rng, *, noise=0.01, decay=80.0, peak=40.0):
    t = np.arange(N - ONSET) / 25600.0
    out = noise * rng.standard_normal((1, N))
    out[0, ONSET:] += peak * np.exp(-decay * t) * np.sin(2 * np.pi * 300 * t)
    return out


def line_of(samples, peak=40.0):
    return resting_line(samples, ONSET - 16, N - 1600, ONSET, np.array([peak]))


@pytest.mark.parametrize("share", [-0.1, 0.002, 0.05])
def test_a_drift_is_read_and_its_line_leaves_the_noise(share):
    rng = np.random.default_rng(1)
    drift = 40.0 * share * np.arange(N) / N
    line, head, tail = line_of(response(rng) + 3.0 + drift)
    assert line.change[0] == pytest.approx(40.0 * share, rel=0.1)
    assert line.over(0, N)[0] == pytest.approx(3.0 + drift, abs=0.01)
    assert line.bend[0] == 0
    assert head[0] == pytest.approx(0.01, rel=0.2)
    assert tail[0] == pytest.approx(0.01, rel=0.1)


def test_noise_is_no_drift_and_the_rest_is_the_mean_before_the_hit():
    seen = 0
    for seed in range(200):
        samples = response(np.random.default_rng(seed)) + 3.0
        line, _, _ = line_of(samples)
        seen += bool(line.slope.any() or line.bend.any())
        assert line.value[0] == pytest.approx(samples[0, : ONSET - 16].mean())
        assert line.over(0, N).shape == (1, 1)
    assert seen == 0


def test_a_decay_that_still_rings_is_no_drift():
    for seed in range(20):
        line, _, _ = line_of(response(np.random.default_rng(seed), decay=3.0))
        assert line.slope[0] == 0


def test_a_step_and_a_curve_are_bends_and_not_lines():
    rng = np.random.default_rng(2)
    step = 2.0 * (np.arange(N) > ONSET)
    curve = 2.0 * (1 - np.exp(-np.arange(N) / 2000))
    for shape in (step, curve):
        line, _, _ = line_of(response(rng) + shape)
        assert line.slope[0] == 0
        assert line.bend[0] == pytest.approx(2.0, rel=0.1)


def hammer(rng, noise=0.5):
    out = noise * rng.standard_normal((1, N))
    out[0, ONSET : ONSET + 20] += 800 * np.sin(np.pi * (np.arange(20) + 0.5) / 20)
    return out


def test_the_rest_of_a_hammer_is_a_constant_a_line_or_what_is_beside_the_pulse():
    rng = np.random.default_rng(3)
    gap, size = (ONSET - 36, ONSET + 56), np.array([800.0])
    line, noise = resting_line_beside(hammer(rng) + 5.0, gap, ONSET, size)
    assert (line.slope[0], line.bend[0]) == (0, 0)
    assert line.value[0] == pytest.approx(5.0, abs=0.03)
    assert noise[0] == pytest.approx(0.5, rel=0.05)
    drift = 40.0 * np.arange(N) / N
    line, noise = resting_line_beside(hammer(rng) + drift, gap, ONSET, size)
    assert line.over(0, N)[0] == pytest.approx(drift, abs=0.3)
    assert noise[0] == pytest.approx(0.5, rel=0.05)
    swing = 30.0 * np.sin(2 * np.pi * np.arange(N) / 9000 + 1.0)
    line, noise = resting_line_beside(hammer(rng) + swing, gap, ONSET, size)
    assert line.bend[0] > 0
    assert line.change[0] == 0
    assert noise[0] < 5.0
    assert line.over(ONSET, ONSET + 20)[0] == pytest.approx(swing[ONSET : ONSET + 20], abs=0.3)
