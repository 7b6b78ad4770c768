"""The operating point: margins that end where chatter begins, and advice that the map bears out."""

import re
from dataclasses import replace

import numpy as np
import pytest

from millcal.data import CutTests
from millcal.errors import IllPosedError
from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import FLIP, HOPF, Crossings, tip_of_modes
from millcal.stages.stability import map_stability
from millcal.stages.stability.operating import Columns, _limit, judged
from millcal.stages.stability.pockets import HELD, held, pockets, tolerance
from tests.stages.stability.test_methods import CUT, KRC, KTC, MODES_OF_ONE, ONE, PROBLEM, RPM, coefficients

DOUBLING_MM = 2.6  # at 10,000 rpm, where a cutter of other teeth does not


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
            assert max(radius(8000 * share, float(depth[1]) / 0.88) for share in (1 - HELD, 1, 1 + HELD)) > 1


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
    found = point(10_000, DOUBLING_MM)
    assert found.kind == "flip"
    assert not found.stable
    assert found.chatter_frequency / (10_000 * 2 / 60) % 1 == pytest.approx(0.5)
    for word in found.advice:
        if (teeth := re.match(r"a cutter of (\d+) teeth: limit", word)) is not None:
            assert radius(10_000, DOUBLING_MM, replace(PROBLEM, teeth=int(teeth[1]))) < 1
        if word.startswith("a cutter of one tooth"):
            assert radius(10_000, DOUBLING_MM, replace(PROBLEM, teeth=1)) < 1
        if word.startswith("a helix of 30 deg"):
            assert radius(10_000, DOUBLING_MM, replace(PROBLEM, wind=np.tan(np.radians(30)) / 6e-3)) < 1
    assert any(word.startswith(("a cutter", "a helix")) for word in found.advice)


def test_with_uncertain_coefficients_the_reduced_depth_is_stable_in_975_of_1000_draws():
    found = point(8000, 2.0, known=coefficients())
    (depth,) = (float(m[1]) for word in found.advice if (m := re.match(r"reduce the depth to ([\d.]+) mm", word)))
    near = [point(8000 * share, 2.0, known=coefficients()).limit_interval[0] for share in (1 - HELD, 1, 1 + HELD)]
    assert depth * 1e-3 == pytest.approx(min(near), rel=1e-2)
    assert "97.5 %" in " ".join(found.advice)
    draws = coefficients().sample(np.random.default_rng(5), 400)
    stable = [radius((1 - HELD, 1 + HELD)[np.argmin([near[0], near[2]])] * 8000, depth, PROBLEM.with_force(*draw)) < 1
              for draw in draws]  # fmt: skip
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
    safe = held(found.spindle_speed, safe, found.spindle_speed)
    most = np.argmax(np.where(safe < (deepest or np.inf), safe, 0.0) * found.spindle_speed)
    ranked = [best.safe_depth * best.spindle_speed for best in found.best]
    assert ranked == sorted(ranked, reverse=True)
    assert ranked[0] >= 0.99 * safe[most] * found.spindle_speed[most]
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


def test_what_holds_is_the_least_within_half_a_percent_of_the_speed():
    speeds = np.linspace(100.0, 200.0, 1001)
    depth = np.where(np.abs(speeds - 150.0) < 0.05, 1e-3, 5e-3)  # a dip narrower than a spindle keeps its speed
    slow = [min(depth[np.abs(speeds - at) <= HELD * at * (1 + 1e-12)]) for at in (120.0, 149.6, 150.4, 151.5)]
    assert held(speeds, depth, np.array([120.0, 149.6, 150.4, 151.5])) == pytest.approx(slow)
    line = np.array([1.0, 2.0])
    assert held(np.array([100.0, 200.0]), 1 / line, np.array([150.0])) == pytest.approx(1 / (1.5 + 150 * HELD / 100))


def test_a_pocket_without_a_bottom_is_not_lost_on_its_faster_wall():
    """Depth falls there more slowly than the speed grows, and yet the speed to run is the one in the middle."""
    speeds = np.linspace(100.0, 200.0, 101)
    inside = np.abs(speeds - 140.0) <= 10.0
    depth = np.where(
        inside, np.inf, np.where(speeds > 150.0, 9e-3 * 150.0 / speeds + 1e-6 * (150.0 - speeds) + 3e-6, 1e-3)
    )
    (best, *others) = pockets(lambda some: np.interp(some, speeds, depth), speeds, depth, 9e-3, (0, 0))
    assert best == pytest.approx(140.0, abs=1.0)
    assert all(abs(other - 140.0) > 12.0 for other in others)


def test_a_best_speed_stands_where_its_depth_holds_and_not_on_a_cliff():
    """At 10,885 rpm the limit is 6.2, a revolution slower 4: the best speed keeps away from the wall."""

    def limit(speed):
        return np.where(speed < 1000.0, 3e-3, 6e-3 - 2e-5 * (speed - 1000.0))

    speeds = np.linspace(800.0, 1200.0, 81)
    (best, *_) = pockets(limit, speeds, limit(speeds), 20e-3, (3, 21))
    assert best == pytest.approx(1000 / (1 - HELD), rel=2e-4)
    assert limit(np.linspace(best * (1 - HELD) + 0.3, best * (1 + HELD), 50)).min() > 5.7e-3


def test_beside_the_map_nothing_is_said_of_how_far_the_speed_may_go():
    found = map_stability(ONE, (KTC, KRC), **CUT, method="zoa", points=60, operating_point=(30_000 * RPM, 0.1e-3))
    assert found.operating.stable
    assert found.operating.speed_margin is None


def test_the_crossing_that_ends_an_island_is_told_with_its_depth():
    """Flips from 5.5 to 6.4 mm, beyond them stable again: the limit is not what bounds a cut above it."""
    crossings = Crossings(
        np.zeros(3, int), np.array([1e-3, 2e-3, 4e-3]), np.array([FLIP, FLIP, HOPF]), np.array([500.0, 500.0, 900.0]),
        np.array([True, False, True]),
    )  # fmt: skip
    flat = np.full((3, 3), [1e-3, 2e-3, 4e-3])
    columns = Columns(np.array([100.0, 101.0, 102.0]), flat, np.full(3, 0.9e-3), 0.9e-3, 5e-3, None)
    found = judged((101.0, 3e-3), crossings, 1e-3, columns, (), None)
    assert found.stable
    assert (found.kind, found.limit, found.bound) == ("hopf", 1e-3, 4e-3)


def test_a_short_cut_is_told_that_a_knock_throws_teeth_out_and_no_advice_goes_without_a_number():
    found = point(10_000, DOUBLING_MM)
    assert "small vibrations" in found.advice[-1]
    slot = {**CUT, "direction": "slot", "radial_depth": CUT["diameter"], "teeth": 4}
    assert not any("small vibrations" in word for word in point(8000, 0.3, method="zoa", **slot).advice)
    assert _limit(np.inf, 9e-3, None) == "no limit was found down to 9 mm within 0.5 % of the speed"


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ((8000, 2.1), "axial_depth_mm: 2100 mm is more than 10 diameters"),
        ((3, 1e-3), r"spindle_speed_rpm: the operating point \(--operating\): at 3 rpm"),
    ],
)
def test_an_operating_point_that_no_map_has_is_refused_in_its_own_name(at, words):
    with pytest.raises(IllPosedError, match=words):
        map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=5, operating_point=(at[0] * RPM, at[1]))


def test_one_odd_row_of_the_tests_does_not_rule_how_deep_the_map_looks():
    def looked(*rows):
        rpm, mm = np.array(rows).T
        made = CutTests(spindle_speed=rpm * RPM, axial_depth=mm * 1e-3, stable=np.zeros(len(rpm)))
        return map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=5, tests=made).deepest

    assert looked((9000, 1.0), (90_000, 150.0), (10_800, 1500.0)) == looked((9000, 1.0))
