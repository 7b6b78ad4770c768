"""Where the lines of an FRF end: what is told of it, whether or not a band is drawn, and that it is no less than the truth."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.physics.stability.from_frf import crossings_of_receptance
from millcal.stages.stability import map_stability
from millcal.stages.stability.band_end import modes_at_the_end, moved_by_the_end
from millcal.stages.stability.lines import usable_lines
from tests.stages.stability.test_from_frf import CUT, DEEPEST, RPM, measured

SPEEDS = np.linspace(7000, 13_000, 25) * RPM
MAP = {"teeth": 2, "diameter": 12e-3, "radial_depth": 1.2e-3, "direction": "down", "points": 8, "feed_per_tooth": 1e-4}


def ending(highest):
    return usable_lines(replace(measured(), usable_band=(10.0, highest)), "")[0]


def limits(lines):
    found = crossings_of_receptance(SPEEDS, lines.frequency, lines.values, CUT, deepest=DEEPEST)
    return np.minimum(found.first(len(SPEEDS)).depth, DEEPEST)


@pytest.mark.parametrize("highest", [1130.0, 1200.0, 1500.0, 1800.0, 2500.0, 4000.0])
def test_a_band_that_moves_limits_by_a_tenth_is_told_and_a_long_one_is_not(highest):
    off = np.abs(np.log(limits(ending(highest)) / limits(ending(5000.0)))).max()
    said = moved_by_the_end(ending(highest), SPEEDS, CUT, DEEPEST)
    if off > 0.1:
        assert said
    if highest >= 2500:
        assert off < 0.05
        assert not said


def test_a_mode_where_the_band_ends_or_above_it_is_told():
    assert {notice.code for notice in modes_at_the_end(ending(1080.0))} == {"mode-at-end"}  # rising to 1100 Hz
    assert {notice.code for notice in modes_at_the_end(ending(600.0))} == {"mode-at-end"}  # a spring below 922 Hz
    assert not modes_at_the_end(ending(1300.0))
    assert not modes_at_the_end(ending(5000.0))


@pytest.mark.parametrize("members", [0, 20])
def test_a_short_band_is_told_with_and_without_draws(members):
    frf = replace(measured(noise=0.005, rng=np.random.default_rng(0)), usable_band=(10.0, 1180.0))
    found = map_stability(
        frf, (600e6, 200e6), **MAP, spindle_speed=(7000 * RPM, 13_000 * RPM), method="frf", deepest=DEEPEST,
        members=members, rng=np.random.default_rng(0) if members else None,
    )  # fmt: skip
    codes = {notice.code for notice in found.notices}
    assert {"short-band", "band-end"} <= codes
    assert not any("a tenth" in notice.message for notice in found.notices)
