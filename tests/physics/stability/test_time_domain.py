"""Cuts in the time domain: the slow way, exact free motion, forced response of a stable cut, and growth by the multiplier."""

from dataclasses import replace

import numpy as np
import pytest
from slow_time_domain import simulate

from millcal.errors import IllPosedError
from millcal.numerics.periodicity import change, periodicity
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import LinearEdge, chip_thickness, force_harmonics, to_machine_axes
from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import Regeneration, TipModes, tip_of_modes, tip_of_shapes
from millcal.physics.stability.time_domain import flashes_per_revolution, simulate_cut, simulate_points, steps_for
from millcal.physics.structure import Mode

RPM = 2 * np.pi / 60
INSPERGER = [[1 / np.sqrt(0.03993), 0.0]]  # one direction, 922 Hz
ONE = tip_of_shapes([922.0], [0.011], INSPERGER)
ISOTROPIC = tip_of_shapes([922.0, 922.0], [0.011, 0.011], [INSPERGER[0], INSPERGER[0][::-1]])
ROTATED = tip_of_shapes(
    [922.0, 1100.0], [0.011, 0.02], 4 * np.array([[np.cos(0.5), np.sin(0.5)], [np.cos(1.9), np.sin(1.9)]])
)
TWO_BY_TWO = tip_of_modes(
    (
        Mode(456.780432115313, 0.111705399393456, 7933097.18086825, "x"),
        Mode(1448.88914030656, 0.0170370095790783, 14691778.4389479, "x"),
        Mode(516.51818914797, 0.0245796327070992, 9374613.81193087, "y"),
        Mode(1408.44814086966, 0.0313576019295683, 12406389.7145168, "y"),
    )
)
RIGID = tip_of_shapes([2000.0], [0.05], [[1e-6, 1e-6]])
FLEXURE = tip_of_shapes([np.sqrt(1.64e6 / 2.51) / (2 * np.pi)], [114 / 2 / np.sqrt(1.64e6 * 2.51)], [[2.51**-0.5, 0.0]])
INSERT = Regeneration(1, np.arccos(2 * 5 / 15.88 - 1), np.pi, 903.9e6, 534.5e6)  # one tooth, 15.88 mm, 5 mm down


def milling(teeth, immersion, direction, ktc=600e6, krc=200e6, **more):
    swept = np.arccos(1 - 2 * immersion)
    entry, leave = (0.0, swept) if direction == "up" else (np.pi - swept, np.pi)
    return Regeneration(teeth, entry, leave, ktc, krc, **more)


def pitches(*degrees):
    return tuple(np.deg2rad(degrees))


SLOW = [  # cut, slices, runout: teeth that meet whole steps, a helix between them, and pitches that do not
    (milling(2, 0.3, "down"), 1, (0.0, 0.0)),
    (milling(1, 0.1, "up"), 1, (0.0, 0.0)),
    (milling(3, 1.0, "up", wind=40.0), 3, (5e-6, -8e-6)),
    (milling(3, 0.4, "down", pitch=pitches(110.3, 121.9, 127.8)), 1, (0.0, 0.0)),
    (milling(2, 0.4, "up", pitch=pitches(170.3, 189.7), wind=30.0), 2, (4e-6, 3e-6)),
]


@pytest.mark.parametrize(("cut", "slices", "runout"), SLOW)
def test_the_compiled_loop_is_the_slow_way(cut, slices, runout):
    """Chatter with teeth out of the cut, so that every branch is walked; edges, runout and a kick at the start."""
    modes = [(922.0, 0.011, np.array([5.0, 1.0])), (650.0, 0.03, np.array([-0.5, 3.0]))]
    tip = tip_of_shapes([m[0] for m in modes], [m[1] for m in modes], [m[2] for m in modes])
    options = {"kte": 12e3, "kre": 7e3, "runout": runout, "revolutions": 4, "slices": slices, "kick": (2e-3, -1e-3)}
    speed, depth, steps = 9000 * RPM, 3e-3, 120
    fast = simulate_cut(speed, depth, tip, cut, feed_per_tooth=6e-5, steps_per_revolution=steps, **options)
    slow = simulate(speed, depth, modes, cut, feed=6e-5, steps=steps, **options)
    engaged = np.abs(slow[1]).sum(axis=0) > 0
    assert 0.03 < engaged.mean() < 1.0 or cut.leave - cut.entry > 3
    assert fast.displacement == pytest.approx(slow[0], rel=0, abs=1e-11 * np.abs(slow[0]).max())
    assert fast.force == pytest.approx(slow[1], rel=0, abs=1e-11 * np.abs(slow[1]).max())


def test_without_a_cut_the_tip_rings_down_as_its_receptance_says():
    """The response to an impulse is 2 Re c e^(s t) b, to rounding."""
    kick = np.array([3e-3, -2e-3])
    free = simulate_cut(
        9000 * RPM, 0.0, TWO_BY_TWO, milling(2, 0.5, "up"), feed_per_tooth=1e-4, kick=tuple(kick), revolutions=3
    )
    exact = 2 * np.real(
        np.einsum(
            "mi,mt,m->it", TWO_BY_TWO.output, np.exp(np.outer(TWO_BY_TWO.pole, free.time)), TWO_BY_TWO.given @ kick
        )
    )
    assert not free.force.any()
    assert free.displacement == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())


def response(tip, force, speed, harmonics):
    """Harmonics of the spindle in the motion, from those of the force.   force : (2, k)   returns (2, k)"""
    receptance = tip.receptance(speed / (2 * np.pi) * np.arange(harmonics + 1))
    return np.einsum("kij,jk->ik", receptance, force)


FLEXIBLE = replace(TWO_BY_TWO, flexibility=np.array([[2e-9, 4e-10], [4e-10, 3e-9]]))


@pytest.mark.parametrize("tip", [TWO_BY_TWO, FLEXIBLE], ids=["modes", "with a flexibility"])
@pytest.mark.parametrize("helix", [0.0, 0.6])
def test_a_stable_cut_moves_as_the_static_chip_forces_it(tip, helix):
    """Every tooth finds the waves of the one before in step with its own, so regeneration cancels: a rigid tool's force."""
    cutter = Cutter(16e-3, 3, helix)
    conditions = CuttingConditions(7000 * RPM, 8e-5, 0.4e-3, 6e-3, "down")
    law = LinearEdge(np.array([1319.4e6, 788.8e6, 0.0]), np.array([20e3, 12e3, 0.0]))
    cut = Regeneration(
        3, *engagement(conditions, cutter.diameter), 1319.4e6, 788.8e6, wind=np.tan(helix) / cutter.radius
    )
    harmonics, speed, depth = 12, conditions.spindle_speed, conditions.axial_depth
    assert floquet.spectral_radius([speed], [depth], tip, cut)[0] < 0.9
    exact = response(tip, force_harmonics(law, cutter, conditions, harmonics)[:2], speed, harmonics)
    errors = []
    for factor in (1, 3):
        steps = factor * steps_for(speed, depth, tip, cut)
        done = simulate_cut(
            speed, depth, tip, cut, feed_per_tooth=8e-5, kte=20e3, kre=12e3, revolutions=60,
            steps_per_revolution=steps, slices=12 if helix else 1,
        )  # fmt: skip
        # The displacement is that at the start of a step; a flexibility answers to the force of mid-step.
        last = done.displacement[:, -steps:] - tip.flexibility @ done.force[:, -steps:]
        found = np.fft.fft(last)[:, : harmonics + 1] / steps * np.where(np.arange(harmonics + 1), 2, 1)
        held = np.fft.fft(done.force[:, -steps:])[:, : harmonics + 1] / steps * np.where(np.arange(harmonics + 1), 2, 1)
        held = held * np.exp(-1j * np.pi * np.arange(harmonics + 1) / steps)
        errors.append(np.abs(found + tip.flexibility @ held - exact).max() / np.abs(exact[:, 1:]).max())
    assert errors[0] < 2e-3
    assert errors[1] < errors[0] / 5


@pytest.mark.parametrize("pitch", [None, pitches(115.0, 121.0, 124.0)], ids=["equal", "unequal"])
@pytest.mark.parametrize("helix", [0.0, 0.5])
def test_a_rigid_tool_makes_the_force_of_its_geometry(pitch, helix):
    """Runout, pitch and helix: the surface knows which tooth cut last, and the closed integrals agree."""
    cutter = Cutter(12e-3, 3, helix, pitch, 14e-6, 0.8)
    conditions = CuttingConditions(6000 * RPM, 5e-5, 2e-3, 5e-3, "up")
    law = LinearEdge(np.array([700e6, 250e6, 0.0]), np.array([18e3, 11e3, 0.0]))
    cut = Regeneration(3, *engagement(conditions, cutter.diameter), 700e6, 250e6, pitch, np.tan(helix) / cutter.radius)
    c0, s0 = 14e-6 * np.cos(0.8), 14e-6 * np.sin(0.8)
    steps, slices = 1440, 40 if helix else 1
    done = simulate_cut(
        conditions.spindle_speed, 2e-3, RIGID, cut, feed_per_tooth=5e-5, kte=18e3, kre=11e3, runout=(c0, s0),
        revolutions=3, steps_per_revolution=steps, slices=slices,
    )  # fmt: skip
    angle = (np.arange(steps) + 0.5) * 2 * np.pi / steps
    height = (np.arange(slices) + 0.5) * 2e-3 / slices
    chip = chip_thickness(cutter, conditions, angle, height)  # (tooth, slice, angle)
    phi = angle - cutter.tooth_lag()[:, np.newaxis, np.newaxis] - cutter.helix_lag(height)[:, np.newaxis]
    exact = to_machine_axes(law.edge_force(chip, 2e-3 / slices), phi).sum(axis=(0, 1))[:, :2].T
    found = done.force[:, -steps:]
    span, near = np.array([cut.entry, cut.leave]), 2 * np.pi / steps
    partly = np.abs((phi[..., np.newaxis] - span + np.pi) % (2 * np.pi) - np.pi).min(axis=(0, 1, 3)) < near
    tight = np.abs(found - exact)[:, ~partly if not helix else slice(None)]
    assert tight.max() < (1e-9 if pitch is None and not helix else 0.02) * np.abs(exact).max()
    mean = force_harmonics(law, cutter, conditions, 0)[:2, 0].real
    assert found.mean(axis=1) == pytest.approx(mean, abs=3e-4 * np.abs(exact).max())


GROWTH = {  # tip, cut, rpm, depth mm; the first two are published beside a slower simulation
    ".1 down": (ONE, milling(2, 0.1, "down"), 9000, 2.0),
    ".05 down": (ONE, milling(2, 0.05, "down"), 7500, 3.0),
    "two by two": (TWO_BY_TWO, milling(2, 0.5, "down", 1319.4e6, 788.8e6), 6000, 1.5),
    "rotated": (ROTATED, milling(3, 0.5, "up"), 9000, 0.5),
    "slot": (ISOTROPIC, milling(4, 1.0, "up"), 9000, 0.1),
    "alternating": (ISOTROPIC, milling(4, 0.3, "down", pitch=pitches(70, 110, 70, 110)), 9000, 0.3),
    "unequal": (ISOTROPIC, milling(3, 0.3, "down", pitch=pitches(111.3, 121.9, 126.8)), 9000, 0.3),
    "helix": (ONE, milling(2, 0.1, "down", wind=np.tan(0.5) / 8e-3), 9000, 2.0),
    "process damping": (ONE, milling(2, 0.1, "down", indentation=2e5, radius=8e-3), 9000, 2.0),
}


def growth(samples):
    """|mu| of the pair that outlives the others, by linear prediction.   samples : (flash,)"""
    x = samples / np.abs(samples).max()
    a, b = np.linalg.lstsq(np.stack([x[:-2], x[1:-1]], axis=1), x[2:], rcond=None)[0]
    return np.abs(np.roots([1, -b, -a])).max()


@pytest.mark.parametrize("case", GROWTH)
def test_small_waves_grow_by_the_floquet_multiplier(case):
    """By steps of second order: their error falls fourfold on halving the step, and what is left is nothing."""
    tip, cut, rpm, depth = GROWTH[case]
    speed, depth = rpm * RPM, depth * 1e-3
    flashes = flashes_per_revolution(cut)
    per_flash = cut.teeth / flashes if cut.equal_pitch else 1 / flashes
    exact = abs(floquet.multipliers(speed, depth, tip, cut, tolerance=1e-8)[0]) ** per_flash
    found = []
    for factor in (1, 2):
        steps = factor * steps_for(speed, depth, tip, cut)
        seen = simulate_points(
            [speed], [depth], tip, cut, feed_per_tooth=0.0, linear=True, kick=(1.0, 0.7), revolutions=100, kept=20,
            phases=1, steps_per_revolution=steps,
        )  # fmt: skip
        found.append(growth(seen.displacement[0, 0, :, 0]))
    assert found[0] == pytest.approx(exact, abs=5e-4)
    extrapolated = found[1] + (found[1] - found[0]) / 3
    assert extrapolated == pytest.approx(exact, abs=3e-5)


MEASURED = [  # rpm, depth mm, M um, class: methods of the measured flexure; 0.1 mm per tooth, 400 steps, 400 revolutions
    (2500, 2, 0.00, 1), (4500, 4, 0.01, 1), (5500, 4, 0.07, 1), (7500, 4, 0.00, 1), (7500, 9.8, 0.00, 1),
    (4222, 6, 0.01, 1), (3873, 8.3, 0.00, 1), (3920, 7.6, 0.00, 1), (3750, 8.7, 0.00, 1),
    (4500, 6, 88.07, 2), (6500, 4, 84.75, 0), (5500, 6, 128.07, 0), (4500, 8, 111.84, 0), (4117, 8.5, 107.62, 8),
    (5233, 9.8, 167.73, 0), (7000, 9.8, 148.27, 0), (4252, 9.7, 112.57, 0), (3679, 9.4, 138.62, 0),
    (4567, 9.8, 174.63, None),
]  # fmt: skip


@pytest.mark.parametrize(("rpm", "depth", "metric", "period"), MEASURED)
def test_period_n_metrics_of_the_measured_flexure_come_out(rpm, depth, metric, period):
    """Once per tooth at the start of the revolution, last 200 of 400; chatter is chaotic, so to some percent."""
    seen = simulate_points(
        [rpm * RPM], [depth * 1e-3], FLEXURE, INSERT, feed_per_tooth=1e-4, steps_per_revolution=400, phases=8
    )
    along_x = seen.displacement[0, :, :, 0]
    assert 1e6 * change(along_x[0], 1) == pytest.approx(metric, rel=0.08, abs=0.05)
    if period is not None:
        assert periodicity(along_x, 1e-6).period == period


def test_a_flip_that_one_phase_does_not_see_is_seen_by_another():
    """5000 rpm, 3 mm: multiplier -1.106, but under a strobe at the start of the revolution nothing moves."""
    seen = simulate_points([5000 * RPM], [3e-3], FLEXURE, INSERT, feed_per_tooth=1e-4, steps_per_revolution=400)
    assert 1e6 * change(seen.displacement[0, 0, :, 0], 1) < 1
    assert periodicity(seen.displacement[0, :, :, 0], 1e-6).period == 2


def test_with_runout_a_stable_cut_repeats_every_revolution_and_not_every_tooth():
    cut = milling(3, 0.3, "down")
    options = {"feed_per_tooth": 1e-4, "revolutions": 200, "kept": 40}
    smooth = simulate_points([9000 * RPM], [0.3e-3], ONE, cut, **options)
    rough = simulate_points([9000 * RPM], [0.3e-3], ONE, cut, runout=(10e-6, 0.0), **options)
    assert (smooth.per_revolution, rough.per_revolution) == (3, 1)
    assert periodicity(smooth.displacement[0, :, :, 0], 1e-9).period == 1
    assert periodicity(rough.displacement[0, :, :, 0], 1e-9).period == 1
    every_tooth = simulate_cut(9000 * RPM, 0.3e-3, ONE, cut, feed_per_tooth=1e-4, runout=(10e-6, 0.0), revolutions=200)
    steps = every_tooth.steps_per_revolution // 3
    assert periodicity(every_tooth.displacement[0, -100 * steps :: steps], 1e-9).period == 3


def test_what_repeats_within_a_revolution_is_known_from_the_pitches():
    assert flashes_per_revolution(milling(4, 0.3, "up")) == 4
    assert flashes_per_revolution(milling(4, 0.3, "up", pitch=pitches(70, 110, 70, 110))) == 2
    assert flashes_per_revolution(milling(4, 0.3, "up", pitch=pitches(70, 110, 80, 100))) == 1
    assert flashes_per_revolution(milling(4, 0.3, "up"), (1e-6, 0.0)) == 1


def test_motions_scale_with_the_feed_in_chatter_too():
    """Force is linear in chip and motion, and whether a tooth cuts is a sign: chaos is the same, only larger."""
    small, large = (
        simulate_cut(6500 * RPM, 4e-3, FLEXURE, INSERT, feed_per_tooth=feed, revolutions=30)
        for feed in (2.0**-14, 2.0**-12)
    )
    assert np.array_equal(4 * small.displacement, large.displacement)


def test_a_real_mode_given_as_a_complex_one_moves_the_same():
    turned = TipModes(ONE.pole, ONE.output * (2 - 1j), ONE.given / (2 - 1j), ONE.flexibility)
    plain, other = (
        simulate_cut(9000 * RPM, 3e-3, tip, milling(2, 0.1, "down"), feed_per_tooth=1e-4, revolutions=20)
        for tip in (ONE, turned)
    )
    assert other.displacement == pytest.approx(plain.displacement, abs=1e-9 * np.abs(plain.displacement).max())


def test_a_finer_helix_changes_nothing():
    cut = milling(2, 0.3, "up", wind=np.tan(0.6) / 8e-3)
    coarse, fine = (
        simulate_cut(
            9000 * RPM, 1e-3, ONE, cut, feed_per_tooth=1e-4, revolutions=40, steps_per_revolution=600, slices=n
        )
        for n in (None, 60)
    )
    last = slice(-600, None)
    assert coarse.displacement[:, last] == pytest.approx(
        fine.displacement[:, last], abs=2e-3 * np.abs(fine.displacement).max()
    )


def test_a_cut_is_run_on_as_long_as_it_is_undecided():
    asked = []

    def undecided(samples):
        asked.append(samples.shape)
        return len(asked) < 3

    seen = simulate_points(
        [9000 * RPM], [0.3e-3], ONE, milling(2, 0.3, "up"), feed_per_tooth=1e-4, revolutions=50, kept=20, phases=4,
        undecided=undecided,
    )  # fmt: skip
    at_once = simulate_points(
        [9000 * RPM], [0.3e-3], ONE, milling(2, 0.3, "up"), feed_per_tooth=1e-4, revolutions=90, kept=20, phases=4
    )
    assert asked == [(4, 40, 2)] * 3
    assert seen.revolutions == 90
    assert np.array_equal(seen.displacement, at_once.displacement)


@pytest.mark.parametrize(
    ("cut", "runout"),
    [
        (milling(2, 0.3, "up"), (0.0, 0.0)),
        (milling(3, 1.0, "up", wind=40.0), (5e-6, -8e-6)),
        (milling(3, 0.4, "down", pitch=pitches(110.3, 121.9, 127.8)), (0.0, 0.0)),
        (milling(2, 0.05, "down"), (60e-6, 0.0)),
    ],
    ids=["plain", "helix and runout", "unequal pitch", "one of two teeth cuts for both"],
)
def test_in_a_stable_cut_the_surface_goes_with_the_feed(cut, runout):
    """Whatever the deflection, the motion repeats every revolution, and so does the surface but for the feed."""
    seen = simulate_points([9000 * RPM], [0.05e-3], ONE, cut, feed_per_tooth=1e-4, kte=10e3, kre=8e3, runout=runout)
    assert seen.astray < 1e-5


def test_a_tip_that_has_dug_in_leaves_a_surface_that_does_not_follow():
    seen = simulate_points([14_000 * RPM], [3.3e-3], ISOTROPIC, milling(2, 0.5, "up"), feed_per_tooth=2e-4)
    assert seen.astray > 0.9
    waves = simulate_points([9000 * RPM], [0.3e-3], ONE, milling(2, 0.3, "up"), feed_per_tooth=1e-4, linear=True)
    assert np.isnan(waves.astray)  # there is no feed to follow


def test_two_teeth_side_by_side_get_steps_between_them_and_cut_as_one():
    """Where the second meets what the first has just left, the cutter is one of a single tooth."""
    both = simulate_cut(
        9000 * RPM,
        0.2e-3,
        ONE,
        milling(2, 0.9, "down", pitch=pitches(2.0, 358.0)),
        feed_per_tooth=0.1e-3,
        revolutions=60,
    )
    lone = simulate_cut(9000 * RPM, 0.2e-3, ONE, milling(1, 0.9, "down"), feed_per_tooth=0.2e-3, revolutions=60)
    sway = [np.ptp(history.displacement[0, -history.steps_per_revolution :]) for history in (both, lone)]
    assert sway[0] == pytest.approx(sway[1], rel=0.1)


def test_a_tip_that_gives_way_within_a_step_is_refused():
    soft = replace(ONE, flexibility=np.diag([1e-6, 1e-6]))
    with pytest.raises(IllPosedError, match="flexibility"):
        simulate_cut(9000 * RPM, 3e-3, soft, milling(2, 0.3, "up"), feed_per_tooth=1e-4)
