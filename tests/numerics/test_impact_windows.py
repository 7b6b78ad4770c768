"""Laws of the windows of a hit: 1 on the signal, 0 on the noise, and a decay followed below the noise."""

import numpy as np
import pytest

from millcal.numerics.impact_hits import survey_hit
from millcal.numerics.impact_windows import decay_length, decay_lengths, gate_hit, pulse_margins, window


def test_a_window_is_one_inside_zero_outside_and_half_in_the_middle_of_a_flank():
    w = window(200, 50, 100, 20, 40)
    assert (w[50:100] == 1).all()
    assert (w[:30] == 0).all()
    assert (w[140:] == 0).all()
    assert 0.5 * (w[39] + w[40]) == pytest.approx(0.5)
    assert 0.5 * (w[119] + w[120]) == pytest.approx(0.5)
    assert (np.diff(w[30:51]) > 0).all()
    assert (np.diff(w[99:141]) < 0).all()


@pytest.mark.parametrize(("start", "stop"), [(-5, 50), (50, 300), (-5, 300)])
def test_a_window_may_reach_over_either_end(start, stop):
    whole = window(600, start + 200, stop + 200, 30, 30)
    assert window(200, start, stop, 30, 30) == pytest.approx(whole[200:400])


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_a_decay_is_followed_below_its_noise(rate):
    """Level falling by `rate` dB a block from 60 dB above the noise: `below_db` under the noise at (60 + below) / rate."""
    k = np.arange(400)
    power = 10 ** ((60 - rate * k) / 10) + 1.0
    for below in (15.0, 25.0):
        found = decay_length(power, 1.0, below_db=below)
        assert found == pytest.approx((60 + below) / rate, rel=0.05, abs=6)
        assert found > (60 + below) / rate - 2


def test_a_decay_that_ends_above_the_noise_has_no_end_and_noise_alone_has_no_decay():
    k = np.arange(100)
    assert decay_length(10 ** (-k / 100), 1e-6, below_db=15) == np.inf
    assert np.isnan(decay_length(np.ones(100), 1.0, below_db=15))


def make_hit(rng, *, noise=0.01, offset=(2.0, 0.5), n=8192):
    t = np.arange(n - 210) / 25600.0
    response = offset[1] + noise * rng.standard_normal((1, n))
    response[0, 210:] += 40 * np.exp(-80 * t) * np.sin(2 * np.pi * 300 * t)
    force = offset[0] + 10 * noise * rng.standard_normal((1, n))
    force[0, 200:220] += 500 * np.sin(np.pi * (np.arange(20) + 0.5) / 20)
    return force, response


def test_windows_drop_offset_and_most_of_the_noise_and_keep_pulse_and_decay():
    rng = np.random.default_rng(1)
    force, response = make_hit(rng)
    clean_force, clean_response = make_hit(rng, noise=0.0, offset=(0.0, 0.0))
    survey = survey_hit(force, response, 26)
    gated = gate_hit(force, response, (0, 8192), survey, decay_lengths([survey], 26), 0)
    assert np.linalg.norm(gated.force - clean_force) < 0.2 * np.linalg.norm(force - 2.0 - clean_force)
    assert np.linalg.norm(gated.response - clean_response) < 0.7 * np.linalg.norm(response - 0.5 - clean_response)
    assert gated.force_noise[0] < 0.05 * 8192 * survey.force_noise[0] ** 2
    assert gated.force[0, 200:220] == pytest.approx(clean_force[0, 200:220], abs=0.5)


def test_quiet_signals_are_left_as_they_are():
    force, response = make_hit(np.random.default_rng(2), noise=0.0, offset=(0.0, 0.0))
    survey = survey_hit(force, response, 26)
    gated = gate_hit(force, response, (0, 8192), survey, decay_lengths([survey], 26), 0)
    assert gated.force == pytest.approx(force)
    assert gated.response == pytest.approx(response)
    assert gated.force_noise[0] == 0


def test_samples_that_belong_to_the_next_hit_are_zero():
    rng = np.random.default_rng(3)
    force, response = make_hit(rng)
    survey = survey_hit(force, response, 26)
    gated = gate_hit(force, response, (0, 1500), survey, decay_lengths([survey], 26), 0)
    assert (gated.force[:, 1500:] == 0).all()
    assert (gated.response[:, 1500:] == 0).all()
    assert abs(gated.response[0, 1499]) < 0.1 * abs(response[0, 1300:1500]).max()


def test_force_margins_follow_a_pulse_that_rings_on():
    n = np.arange(1000)
    clean = np.where((n >= 300) & (n < 320), 100.0, 0.0)
    ringing = clean + np.where((n >= 320) & (n < 360), 2.0 * (-1.0) ** n, 0.0)
    short, long = (pulse_margins(pulse, 300, 320, 20, 0.1) for pulse in (clean, ringing))
    assert short == (300 - 36, pytest.approx(320 + 36, abs=3))
    assert long == (300 - 36, pytest.approx(360 + 36, abs=3))
