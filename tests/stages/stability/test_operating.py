"""The operating point: margins that end where chatter begins, and advice that the map bears out."""

import re
from dataclasses import replace

import numpy as np
import pytest

from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import tip_of_modes
from millcal.stages.stability import map_stability
from millcal.stages.stability.pockets import pockets, tolerance
from tests.stages.stability.test_methods import CUT, KRC, KTC, MODES_OF_ONE, ONE, PROBLEM, RPM, coefficients


def point(rpm, depth_mm, method="floquet", known=(KTC, KRC), **options):
    found = map_stability(
        ONE, known, **{**CUT, **options}, method=method, points=151, operating_point=(rpm * RPM, depth_mm * 1e-3),
        rng=np.random.default_rng(0),
    )  # fmt: skip
    return found.operating


def radius(rpm, depth_mm, cut=PROBLEM):
    return floquet.spectral_radius(np.array([rpm * RPM]), np.array([depth_mm * 1e-3]), tip_of_modes(MODES_OF_ONE), cut)[
        0
    ]


@pytest.mark.parametrize(("rpm", "depth_mm"), [(9000, 2.0), (7500, 1.0), (14_000, 4.0), (7500, 2.45)])
def test_the_speed_margin_ends_where_the_multiplier_leaves_the_circle(rpm, depth_mm):
    """Stable all the way to its ends, and beyond them not; the map has a speed every 100 rpm, looked at 16 times closer."""
    found = point(rpm, depth_mm)
    assert found.stable
    down, up = (margin / RPM for margin in found.speed_margin)
    for end, turn in ((rpm - down, -1), (rpm + up, 1)):
        for inside in np.linspace(rpm, end, 9):
            assert radius(inside, depth_mm) < 1
        if 5000 < end < 20_000:
            assert radius(end + 10 * turn, depth_mm) > 1


def test_a_point_that_chatters_has_no_margin_and_its_advice_is_stable():
    found = point(8000, 2.0)
    assert not found.stable
    assert found.speed_margin is None
    assert any(word.startswith("reduce the depth") for word in found.advice)
    for word in found.advice:
        if (speed := re.match(r"(?:raise|lower) the speed to (\d+) rpm", word)) is not None:
            assert radius(float(speed[1]), 2.0) < 1
        if (depth := re.match(r"reduce the depth to ([\d.]+) mm", word)) is not None:
            assert radius(8000, float(depth[1])) < 1
            assert radius(8000, float(depth[1]) / 0.88) > 1


def test_advice_is_ranked_by_the_metal_it_removes():
    found = point(8000, 2.0)
    removed = []
    for word in found.advice:
        if (speed := re.match(r"(?:raise|lower) the speed to (\d+) rpm", word)) is not None:
            removed.append(float(speed[1]) / 8000)
        elif (depth := re.match(r"reduce the depth to ([\d.]+) mm", word)) is not None:
            removed.append(float(depth[1]) / 2.0)
        elif (times := re.search(r": ([\d.]+) times the metal", word)) is not None:
            removed.append(float(times[1]))
    assert len(removed) >= 3
    assert removed == sorted(removed, reverse=True)


def test_where_the_period_doubles_another_cutter_is_named_if_it_is_stable_there():
    found = point(10_000, 2.7)
    assert found.kind == "flip"
    assert not found.stable
    assert found.chatter_frequency / (10_000 * 2 / 60) % 1 == pytest.approx(0.5)
    for word in found.advice:
        if (teeth := re.match(r"a cutter of (\d+) teeth: limit", word)) is not None:
            assert radius(10_000, 2.7, replace(PROBLEM, teeth=int(teeth[1]))) < 1
        if word.startswith("a cutter of one tooth"):
            assert radius(10_000, 2.7, replace(PROBLEM, teeth=1)) < 1
        if word.startswith("a helix of 30 deg"):
            assert radius(10_000, 2.7, replace(PROBLEM, wind=np.tan(np.radians(30)) / 6e-3)) < 1
    assert any(word.startswith(("a cutter", "a helix")) for word in found.advice)


def test_with_uncertain_coefficients_the_reduced_depth_is_stable_in_975_of_1000_draws():
    found = point(8000, 2.0, known=coefficients())
    (depth,) = (float(m[1]) for word in found.advice if (m := re.match(r"reduce the depth to ([\d.]+) mm", word)))
    assert depth * 1e-3 == pytest.approx(found.limit_interval[0], rel=5e-3)
    assert "97.5 %" in " ".join(found.advice)
    draws = coefficients().sample(np.random.default_rng(5), 400)
    stable = [radius(8000, depth, PROBLEM.with_force(*draw)) < 1 for draw in draws]
    assert abs(np.mean(stable) - 0.975) < 0.03


def test_far_below_the_limit_there_is_room_and_nothing_to_mend():
    found = point(9000, 0.5)
    assert found.stable
    assert any(word.startswith("there is room") for word in found.advice)
    assert not any(word.startswith("reduce") for word in found.advice)


def test_a_pocket_without_a_bottom_is_run_in_its_middle():
    """Nothing limits it as deep as was looked: the speed farthest from both walls."""
    speeds = np.linspace(100.0, 200.0, 11)
    depth = np.array([1, 1, 1, np.inf, np.inf, np.inf, 1, 1, 2, 1, 1]) * 1e-3
    found = pockets(lambda some: np.interp(some, speeds, depth), speeds, depth, 3e-3, (0, 0))
    np.testing.assert_allclose(found[:2], [140.0, 180.0])


def test_a_point_outside_the_speeds_of_the_map_is_told():
    def told(rpm):
        found = map_stability(ONE, (KTC, KRC), **CUT, points=20, operating_point=(rpm * RPM, 1e-3))
        return [notice.message for notice in found.notices if notice.code == "operating-outside"]

    assert told(5000) == told(20_000) == []
    (message,) = told(30_000)
    assert "30000 rpm, lies outside the map, 5000 to 20000 rpm" in message


def test_a_cut_of_almost_nothing_is_not_told_how_many_times_more_there_is():
    assert any("more than 100 times the metal" in line for line in point(8000, 1e-6, method="zoa").advice)


def test_without_a_limit_no_speed_is_the_best():
    found = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=20, deepest=0.2e-3)
    assert np.isinf(found.limit_depth).all()
    assert found.best == ()


@pytest.mark.parametrize(("method", "deepest"), [("zoa", None), ("floquet", 6e-3)])
def test_no_speed_of_its_pocket_removes_more_with_safety_than_the_best_one(method, deepest):
    """Where the safe depth is as deep as was looked, the middle is better than the rim; the rest is what is compared."""
    asked = {**CUT, "method": method, "points": 151, "deepest": deepest}
    found = map_stability(ONE, coefficients(0.1), **asked, rng=np.random.default_rng(0))
    safe = np.minimum(found.limit_low, found.limit_depth)
    most = np.argmax(np.where(safe < (deepest or np.inf), safe, 0.0) * found.spindle_speed)
    ranked = [best.safe_depth * best.spindle_speed for best in found.best]
    assert ranked == sorted(ranked, reverse=True)
    assert ranked[0] >= 0.999 * safe[most] * found.spindle_speed[most]
    assert all(best.safe_depth <= best.axial_depth for best in found.best)


@pytest.mark.parametrize("known", [(KTC, KRC), coefficients(0.1)], ids=["exact", "uncertain"])
def test_a_speed_off_by_its_margin_still_holds_nine_tenths_of_the_depth_and_by_more_it_does_not(known):
    found = map_stability(ONE, known, **CUT, method="floquet", points=301, deepest=6e-3, rng=np.random.default_rng(0))
    runnable = found.limit_depth if found.limit_low is None else np.minimum(found.limit_low, found.limit_depth)
    for best in found.best:
        depth = 0.9 * (best.axial_depth if best.safe_depth is None else best.safe_depth)
        off = np.abs(found.spindle_speed - best.spindle_speed)
        assert (runnable[off < best.speed_margin] >= depth * (1 - 1e-9)).all()
        step = found.spindle_speed[1] - found.spindle_speed[0]
        ends = np.abs(found.spindle_speed[[0, -1]] - best.spindle_speed)
        if best.speed_margin < ends.min() - step:
            assert runnable[off < best.speed_margin + 2 * step].min() < depth


def test_at_the_end_of_the_map_a_margin_is_that_of_the_other_way():
    speeds, runnable = np.array([100.0, 110.0, 120.0, 130.0]), np.array([1.0, 2.0, 4.0, 4.0]) * 1e-3
    assert tolerance(130.0, 4e-3, speeds, runnable) == pytest.approx(10.0)
    assert tolerance(130.0, 2e-3, speeds, runnable) == pytest.approx(20.0)
    assert tolerance(120.0, 3e-3, speeds, runnable) == pytest.approx(10 / 3)  # by 1/b: 1/3 of the way from 1/4 to 1/2
    assert tolerance(120.0, 0.5e-3, speeds, runnable) == pytest.approx(10.0)  # the map ends before the depth does
