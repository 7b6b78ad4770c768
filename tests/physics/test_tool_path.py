"""The engagement along a path: straight between rows, steps where a place comes twice, the way by exact integration."""

import numpy as np
import pytest

from millcal.physics.tool_path import ToolPath

PATH = ToolPath(
    position=np.array([0.0, 0.02, 0.02, 0.05]),
    axial_depth=np.array([1e-3, 2e-3, 3e-3, 3e-3]),
    entry=np.radians([100.0, 120.0, 90.0, 90.0]),
    leave=np.radians([180.0, 180.0, 180.0, 150.0]),
    feed_direction=np.radians([350.0, 350.0, 350.0, 20.0]),
)


def test_between_rows_it_is_straight_and_at_a_step_it_is_what_comes_after():
    found = PATH.at(np.array([0.0, 0.01, 0.02 - 1e-12, 0.02, 0.035, 0.05]))
    assert found.axial_depth == pytest.approx([1e-3, 1.5e-3, 2e-3, 3e-3, 3e-3, 3e-3])
    assert np.degrees(found.entry) == pytest.approx([100, 110, 120, 90, 90, 90])
    assert np.degrees(found.leave) == pytest.approx([180, 180, 180, 180, 165, 150])
    assert np.degrees(found.feed_direction) == pytest.approx([350, 350, 350, 350, 365, 380])  # the shorter way


def test_the_way_is_the_integral_of_the_feed_rate():
    speed = np.array([4e-3, 8e-3, 2e-3, 2e-3])
    time = np.linspace(-1.0, 25.0, 2001)
    found = PATH.position_after(time, speed)
    rate = np.gradient(found, time)
    inside = (found > 1e-4) & (found < 0.05 - 1e-4) & (np.abs(found - 0.02) > 2e-4)
    expected = np.where(found < 0.02, 4e-3 + (8e-3 - 4e-3) * found / 0.02, 2e-3)
    assert rate[inside] == pytest.approx(expected[inside], rel=1e-4)
    assert found[time < 0] == pytest.approx(4e-3 * time[time < 0])
    assert found[-1] == pytest.approx(0.05 + 2e-3 * (25 - 0.02 * np.log(2) / 4e-3 - 15))


def test_a_constant_feed_is_a_straight_way():
    time = np.linspace(0, 5, 50)
    assert PATH.position_after(time, np.full(4, 5e-3)) == pytest.approx(5e-3 * time)
