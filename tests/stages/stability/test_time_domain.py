"""Points and limits of a map in the time domain against multipliers, and what the multipliers do not see."""

import numpy as np
import pytest

from millcal.errors import IllPosedError
from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import KINDS, Regeneration, tip_of_modes, tip_of_shapes
from millcal.physics.stability.time_domain import simulate_cut
from millcal.physics.structure import Mode
from millcal.stages.stability.time_domain import crossings_in_time, simulated_cuts, with_bifurcation

RPM = 2 * np.pi / 60
FLEXURE = tip_of_shapes([np.sqrt(1.64e6 / 2.51) / (2 * np.pi)], [114 / 2 / np.sqrt(1.64e6 * 2.51)], [[2.51**-0.5, 0.0]])
INSERT = Regeneration(1, np.arccos(2 * 5 / 15.88 - 1), np.pi, 903.9e6, 534.5e6)  # one tooth, 15.88 mm, 5 mm down
FEED = {"feed_per_tooth": 0.1e-3}
TWO_TEETH = Regeneration(2, np.pi - np.arccos(1 - 2 * 0.1), np.pi, 600e6, 200e6)
TWO_BY_TWO = tip_of_modes(
    (Mode(456.780432115313, 0.111705399393456, 7933097.18086825, "x"),
     Mode(1448.88914030656, 0.0170370095790783, 14691778.4389479, "x"),
     Mode(516.51818914797, 0.0245796327070992, 9374613.81193087, "y"),
     Mode(1408.44814086966, 0.0313576019295683, 12406389.7145168, "y"))
)  # fmt: skip
THIN = tip_of_shapes([922.0], [0.011], [[1 / np.sqrt(0.03993), 0.0]])


def grid(speeds, depths):
    """Speeds rad/s and depths m of all pairs."""
    return [values.ravel() for values in np.meshgrid(speeds, depths)]


@pytest.mark.parametrize(
    "points",
    [
        grid(np.linspace(2500, 7500, 11) * RPM, np.linspace(0.5, 10, 10) * 1e-3),
        pytest.param(grid(np.linspace(2500, 7500, 41) * RPM, np.linspace(0.5, 10, 20) * 1e-3), marks=pytest.mark.long),
    ],
    ids=["110", "820"],
)
def test_simulated_cuts_agree_with_multipliers_away_from_the_limit(points):
    """At least 98 % where |rho - 1| > 0.01; the others are cuts that chatter though small waves die."""
    cuts, notices = simulated_cuts(FLEXURE, INSERT, *points, **FEED)
    radius = floquet.spectral_radius(*points, FLEXURE, INSERT)
    far = np.abs(radius - 1) > 0.01
    same = (cuts.period == 1) == (radius < 1)
    assert np.mean(same[far]) >= 0.98
    assert not np.any((cuts.period == 1) & (radius > 1.01))
    assert cuts.per == "tooth"
    assert notices == ()


def test_a_cut_that_lasts_in_chatter_though_its_multiplier_is_below_one_is_found():
    """5125 rpm, 10 mm: rho 0.9875, and a motion of period five in which the tooth leaves the cut."""
    speed, depth = np.array([5125 * RPM]), np.array([10e-3])
    assert floquet.spectral_radius(speed, depth, FLEXURE, INSERT)[0] == pytest.approx(0.9875, abs=1e-4)
    assert simulated_cuts(FLEXURE, INSERT, speed, depth, **FEED)[0].period == 5


PUBLISHED = {  # rpm: crossings mm
    2500: "7.79251 hopf", 3000: "2.56558 flip", 3500: "3.40265 hopf", 4117: "7.20995 flip", 4500: "4.10073 flip",
    4750: "2.72027 flip", 5233: "7.23551 hopf", 5500: "4.39657 hopf", 7000: "5.85903 hopf", 7500: "none",
}  # fmt: skip


def test_limits_of_the_flexure_are_those_of_the_published_table():
    """To the last halving, 16 um, and the little by which lasting chatter comes before the multiplier."""
    speeds = np.array(list(PUBLISHED)) * RPM
    found, cuts, notices = crossings_in_time(FLEXURE, INSERT, speeds, deepest=10e-3, **FEED)
    first = found.first(len(speeds))
    exact = floquet.boundary(speeds, FLEXURE, INSERT, deepest=10e-3).first(len(speeds))
    for i, text in enumerate(PUBLISHED.values()):
        if text == "none":
            assert np.isinf(first.depth[i])
            continue
        depth, kind = text.split()
        assert 1e3 * first.depth[i] == pytest.approx(float(depth), abs=0.04)
        assert KINDS[first.kind[i]] == kind
        assert first.frequency[i] == pytest.approx(exact.frequency[i], rel=1e-9 if kind == "flip" else 3e-3)
    assert cuts.period.shape == (20 * len(speeds),)
    assert [notice.code for notice in notices] == ["depth-grid"]


def test_stability_that_comes_back_with_depth_is_a_crossing_too():
    """The island of flips at 3000 rpm, 2.57 to 4.95 mm, then a Hopf at 7.11 mm; the flip lasts a little past its end."""
    found, *_ = crossings_in_time(FLEXURE, INSERT, np.array([3000 * RPM]), deepest=8e-3, depths=16, **FEED)
    assert found.depth * 1e3 == pytest.approx([2.566, 5.05, 7.06], abs=0.12)
    assert found.loses.tolist() == [True, False, True]
    assert [KINDS[kind] for kind in found.kind] == ["flip", "flip", "hopf"]


def test_halving_the_feed_changes_no_limit():
    whole, half = (
        crossings_in_time(FLEXURE, INSERT, np.array([5500 * RPM]), deepest=6e-3, depths=6, feed_per_tooth=feed)[0]
        for feed in (2e-4, 1e-4)
    )
    assert np.array_equal(whole.depth, half.depth)


def test_a_flip_of_two_teeth_is_not_hidden_by_runout():
    """With runout both repeat every revolution; without, the flip does not repeat every tooth."""
    speed, (shallow, deep) = 10_000 * RPM, (1.2e-3, 2.7e-3)
    mu = floquet.multipliers(speed, deep, THIN, TWO_TEETH)[0]
    assert mu.real < -1.01
    assert abs(mu.imag) < 1e-9
    options = {**FEED, "runout": (3e-6, 0.0)}
    cuts, notices = simulated_cuts(THIN, TWO_TEETH, np.full(2, speed), np.array([shallow, deep]), **options)
    assert cuts.per == "revolution"
    assert cuts.period.tolist() == [1, 0]
    assert [notice.code for notice in notices] == ["hidden-flips"]


def test_a_line_of_cuts_branches_where_the_flip_begins():
    """One displacement for each stable depth, two beyond 2.72 mm at 4750 rpm, and many in chatter."""
    depths = np.array([1e-3, 2e-3, 2.5e-3, 3.5e-3, 4.5e-3, 8e-3])
    cuts, _ = simulated_cuts(FLEXURE, INSERT, np.full(6, 4750 * RPM), depths, **FEED)
    line = with_bifurcation(cuts, FLEXURE, INSERT, 4750 * RPM, depths, flashes=40, **FEED)
    branches = []
    for depth in depths:
        seen = line.bifurcation_displacement[line.bifurcation_depth == depth]
        assert len(seen) == 40
        branches.append(len(np.unique(np.round(seen / 2e-6))))
    assert branches[:3] == [1, 1, 1]
    assert branches[3:5] == [2, 2]
    assert branches[5] > 4


def test_the_same_cuts_give_the_same_answers():
    speeds = np.array([4500, 6500]) * RPM
    once, again = (crossings_in_time(FLEXURE, INSERT, speeds, deepest=6e-3, depths=6, **FEED)[0] for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))


def test_what_is_done_is_told():
    told = []
    crossings_in_time(
        FLEXURE, INSERT, np.array([4500, 6500]) * RPM, deepest=2e-3, depths=2, progress=told.append, **FEED
    )
    assert told == [0.0, 0.5]


def test_a_cut_without_a_feed_is_refused():
    with pytest.raises(IllPosedError, match="feed_per_tooth_mm"):
        crossings_in_time(FLEXURE, INSERT, np.array([4500 * RPM]), deepest=6e-3, feed_per_tooth=None)


def test_edge_forces_lower_the_limit_the_more_the_smaller_the_feed():
    """Down milling runs out to no chip, and waves move the place where the edge force ends; at a large feed they do not."""
    speed, cut = np.array([6000 * RPM]), Regeneration(2, np.pi / 2, np.pi, 1319.4e6, 788.8e6)
    limits = [
        crossings_in_time(TWO_BY_TWO, cut, speed, deepest=3e-3, depths=3, feed_per_tooth=feed, kte=kte, kre=0.6 * kte)[
            0
        ]
        for kte, feed in ((0.0, 1e-4), (20e3, 1e-2), (20e3, 1e-3), (20e3, 4e-4), (20e3, 1e-4))
    ]
    without, coarse, *finer = [float(limit.depth[0]) * 1e3 for limit in limits]
    assert without == pytest.approx(1.8428, abs=0.035)
    assert coarse == pytest.approx(without, abs=0.035)
    assert np.all(np.diff([without, *finer]) <= 0)
    assert finer[-1] < 0.96 * without


def test_teeth_that_are_not_alike_may_leave_the_cut_and_so_keep_it_stable():
    """Pitches 70/110/70/110: the steady motion near the resonance, larger than the feed, takes teeth out of the cut."""
    swept = np.arccos(1 - 2 * 0.3)
    cut = Regeneration(4, np.pi - swept, np.pi, 600e6, 200e6, tuple(np.deg2rad([70, 110, 70, 110])))
    tip = tip_of_shapes([922.0, 922.0], [0.011, 0.011], np.eye(2) / np.sqrt(0.03993))
    speed, depth = np.array([9000 * RPM]), np.array([1e-3])
    assert floquet.spectral_radius(speed, depth, tip, cut)[0] > 1.2
    assert simulated_cuts(tip, cut, speed, depth, **FEED)[0].period == 1
    settled = simulate_cut(speed[0], depth[0], tip, cut, **FEED, revolutions=150)
    last = settled.force[:, -settled.steps_per_revolution :]
    assert np.mean(np.abs(last).sum(axis=0) > 0) < 0.8 * cut.in_cut


def test_what_only_the_steps_do_not_repeat_is_no_chatter():
    """Five percent immersion, far below the limits: a tooth leaves the cut a step earlier or later, and that is all."""
    tip = tip_of_modes([Mode(920.0, 0.014, 2.6e6, "x"), Mode(1040.0, 0.016, 8e6, "y")])
    swept = np.arccos(1 - 2 * 0.05)
    cut = Regeneration(2, np.pi - swept, np.pi, 800e6, 260e6)
    speed, depth = np.array([8400, 11_000]) * RPM, np.array([2.4e-3, 3.6e-3])
    assert np.all(floquet.spectral_radius(speed, depth, tip, cut) < 0.95)
    found, _ = simulated_cuts(tip, cut, speed, depth, feed_per_tooth=0.1e-3, kte=14e3, kre=17e3)
    assert found.period.tolist() == [1, 1]


AB603 = tip_of_modes([Mode(603.0, 0.039, 5.59e6, "x"), Mode(666.0, 0.035, 5.715e6, "y")])
BOTH = tip_of_shapes([922.0, 922.0], [0.011, 0.011], np.eye(2) / np.sqrt(0.03993))
DUG_IN = [  # tip, teeth, share of the diameter, direction, ktc, krc, rpm, depth mm, feed per tooth m, kte: 3 to 10 times the limit
    pytest.param(AB603, 4, 1.0, "down", 600e6, 42e6, 6411.314, 5.904263964, 1e-4, 20e3, id="back after a rest"),
    pytest.param(AB603, 3, 1.0, "up", 600e6, 42e6, 14139.898, 9.748507920, 2e-4, 0.0, id="in the air"),
    pytest.param(BOTH, 1, 0.3, "down", 600e6, 200e6, 9261.342, 9.491466708, 3e-5, 20e3, id="on a part of its arc"),
    pytest.param(AB603, 1, 0.3, "up", 600e6, 42e6, 9656.47, 79.55891939, 1e-4, 0.0, id="ringing down"),
    pytest.param(BOTH, 2, 0.5, "up", 600e6, 200e6, 14033.026, 3.315401030, 2e-4, 0.0, id="touching again"),
]


@pytest.mark.parametrize(("tip", "teeth", "share", "direction", "ktc", "krc", "rpm", "depth", "feed", "kte"), DUG_IN)
def test_a_tip_that_has_dug_out_what_it_should_cut_is_not_stable(
    tip, teeth, share, direction, ktc, krc, rpm, depth, feed, kte
):
    """The motion repeats, or changes by less and less with finer steps, because nothing is cut where much was cut before."""
    swept = np.arccos(1 - 2 * share)
    entry, leave = (0.0, swept) if direction == "up" else (np.pi - swept, np.pi)
    cut, point = Regeneration(teeth, entry, leave, ktc, krc), (np.array([rpm * RPM]), np.array([depth * 1e-3]))
    assert floquet.spectral_radius(*point, tip, cut)[0] > 1.5
    found, _ = simulated_cuts(tip, cut, *point, feed_per_tooth=feed, kte=kte, kre=kte / 2)
    assert found.period[0] != 1
