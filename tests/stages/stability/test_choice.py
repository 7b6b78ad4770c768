"""The method that is taken where nobody asks for one: zero order where it is right, else a rival that knows the whole cut."""

import numpy as np
import pytest

from millcal.physics.stability.regeneration import tip_of_modes
from millcal.physics.structure import Mode
from millcal.stages.stability import map_stability
from tests.stages.stability.test_from_frf import measured
from tests.stages.stability.test_methods import BOTH, CUT, KRC, KTC, ONE, RPM, TWO, codes

LINES = measured(modes=tip_of_modes([Mode(922.0, 0.02, 1.34e6, "x"), Mode(1100.0, 0.03, 2.0e6, "y")]))  # of TWO
SLOT = {**BOTH, "direction": "slot", "radial_depth": None, "points": 20}
WIDE = {**CUT, "radial_depth": 9e-3, "points": 20}  # three quarters of the diameter: .67 teeth in cut


@pytest.mark.parametrize("cut", [{**CUT, "points": 20}, WIDE])
def test_where_zero_order_promises_too_much_the_rival_is_taken_and_told(cut):
    found = map_stability(ONE, (KTC, KRC), **cut)
    asked = map_stability(ONE, (KTC, KRC), **cut, method="floquet")
    assert found.method == "floquet"
    np.testing.assert_array_equal(found.limit_depth, asked.limit_depth)
    assert [notice.level for notice in found.notices if notice.code == "method"] == ["note"]
    assert "method" not in codes(asked)


def test_zero_order_asked_for_is_kept_and_says_how_far_too_deep_it_is():
    """By the two maps themselves: the numbers of the warning are theirs."""
    told = [n for n in map_stability(ONE, (KTC, KRC), **WIDE, method="zoa").notices if n.code == "zoa-unsafe"]
    assert len(told) == 1
    assert told[0].level == "warning"
    rpm = float(told[0].message.split(" at ")[1].split(" rpm")[0])
    at = {**WIDE, "spindle_speed": (rpm * RPM, (rpm + 1) * RPM), "points": 2}
    limits = [map_stability(ONE, (KTC, KRC), **at, method=name).limit_depth[0] * 1e3 for name in ("zoa", "floquet")]
    said = [float(part.split()[-1]) for part in told[0].message.split(" mm")[:2]]
    assert said == pytest.approx(limits, rel=0.02)
    assert limits[0] > 1.2 * limits[1]


@pytest.mark.parametrize("teeth", [4, 6])
def test_zero_order_stays_where_the_force_is_its_mean(teeth):
    for dynamics in (TWO, LINES):
        found = map_stability(dynamics, (KTC, KRC), **{**SLOT, "teeth": teeth})
        assert found.method == "zoa"
        assert not {"method", "zoa-unsafe", "flip-lobes"} & codes(found)


def test_an_frf_alone_is_held_against_its_own_lines_and_warned_of_and_with_modes_these_are_taken():
    cut = {**BOTH, "radial_depth": 1.2e-3, "points": 10}
    alone = map_stability(LINES, (KTC, KRC), **cut)
    assert alone.method == "zoa"
    assert [n.level for n in alone.notices if n.code == "zoa-unsafe"] == ["warning"]
    with_modes = map_stability(LINES, (KTC, KRC), **cut, modes=TWO)
    assert with_modes.method == "floquet"
    np.testing.assert_array_equal(
        with_modes.limit_depth, map_stability(TWO, (KTC, KRC), **cut, method="floquet").limit_depth
    )


def test_what_zero_order_does_not_know_at_all_goes_to_the_rival_and_without_one_is_warned_of():
    pitch = np.radians([170.0, 190.0])
    assert map_stability(TWO, (KTC, KRC), **{**SLOT, "points": 5}, pitch=pitch).method == "floquet"
    assert map_stability(ONE, (KTC, KRC), **{**CUT, "points": 5}, indentation=2e5).method == "floquet"
    alone = map_stability(LINES, (KTC, KRC), **{**SLOT, "points": 5}, pitch=pitch)
    assert alone.method == "zoa"
    assert "mean-pitch" in codes(alone)
    wound = map_stability(LINES, (KTC, KRC), **{**BOTH, "points": 5}, helix=0.5)
    assert wound.method == "zoa"
    assert "flip-lobes" in codes(wound)
