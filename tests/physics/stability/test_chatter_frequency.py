"""The chatter frequency of a multiplier against the motion itself, followed in time, and against the chatter of one mode alone."""

import numpy as np
import pytest

from millcal.physics.stability.floquet import boundary, chatter_frequency, multipliers
from millcal.physics.stability.regeneration import Regeneration, tip_of_modes
from millcal.physics.stability.time_domain import simulate_cut
from millcal.physics.structure import Mode

RPM = 2 * np.pi / 60


def down(share, teeth, ktc=6e8, krc=2e8):
    swept = np.arccos(1 - 2 * share)
    return Regeneration(teeth, np.pi - swept, np.pi, ktc, krc)


def test_a_mode_that_the_cut_does_not_feel_is_not_the_chatter_however_soft_it_is():
    """y chatters as it does alone; the softer x mode has an alias nearer by, and stays quiet."""
    y, x = Mode(1200.0, 0.02, 2e7, "y"), Mode(500.0, 0.05, 5e6, "x")
    speed = np.array([5085 * RPM])
    alone = boundary(speed, tip_of_modes([y]), down(0.05, 3), deepest=20e-3).first(1)
    both = boundary(speed, tip_of_modes([x, y]), down(0.05, 3), deepest=20e-3).first(1)
    assert both.depth[0] == pytest.approx(alone.depth[0], rel=0.01)
    assert both.frequency[0] == pytest.approx(alone.frequency[0], abs=3)
    tooth = 3 * 5085 / 60
    assert np.abs(both.frequency[0] - 500) > tooth / 2


@pytest.mark.parametrize(
    ("rpm", "share", "teeth"), [(10000, 0.05, 2), (5000, 0.5, 2), (14000, 0.1, 3), (7500, 0.75, 4), (10000, 0.5, 4)]
)
def test_the_frequency_is_the_strongest_line_of_the_motion_that_the_wave_makes(rpm, share, teeth):
    """A kick in the linear cut, just beyond the limit: the spectrum of the growing wave, its growth taken out."""
    tip = tip_of_modes([Mode(922.0, 0.011, 1.34005e6, "x"), Mode(1100.0, 0.02, 2.010075e6, "y")])
    cut, speed = down(share, teeth), rpm * RPM
    first = boundary(np.array([speed]), tip, cut, deepest=20e-3).first(1)
    depth = 1.02 * first.depth[0]
    largest = multipliers(speed, depth, tip, cut)[0]
    told = chatter_frequency(np.array([speed]), np.array([depth]), np.array([largest]), tip, cut)[0]
    cut_away = simulate_cut(
        speed, depth, tip, cut, feed_per_tooth=1e-4, revolutions=400, linear=True, kick=(1e-3, 1e-3)
    )
    steps = len(cut_away.time) // 4
    time, motion = cut_away.time[-steps:], cut_away.displacement[:, -steps:]
    period = 2 * np.pi / teeth / speed
    motion = motion * np.abs(largest) ** (-(time - time[0]) / period) * np.hanning(steps)
    power = (np.abs(np.fft.rfft(motion, axis=1)) ** 2).sum(axis=0)
    seen = np.argmax(power) / (steps * (time[1] - time[0]))
    assert told == pytest.approx(seen, abs=3)
