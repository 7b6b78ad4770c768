"""What multipliers must obey whatever the numbers: closed forms where nothing depends on time, symmetries, scalings, limits."""

from dataclasses import replace

import numpy as np
import pytest
from cutting_matrix import integral
from stability_cases import (
    IS_DAMPING,
    IS_FREQUENCY,
    IS_STIFFNESS,
    RPM,
    case_cut,
    case_name,
    cut,
    machine,
    oracles,
    rotated_modes,
)

from millcal.errors import IllPosedError
from millcal.physics.stability.floquet import boundary, flip_depths, multipliers, radius_map, spectral_radius
from millcal.physics.stability.regeneration import (
    FLIP,
    FOLD,
    HOPF,
    Regeneration,
    TipModes,
    tip_of_residues,
    tip_of_shapes,
)
from millcal.physics.stability.zero_order import dynamics_of_tip, limit, mean_cutting_matrix


def radius(rpm, depth, tip, this, **options):
    return abs(multipliers(rpm * RPM, depth, tip, this, **options)[0])


def along_x(natural, damping, stiffness):
    """One mode along x."""
    return tip_of_shapes([natural], [damping], [[2 * np.pi * natural / np.sqrt(stiffness), 0.0]])


def off_the_characteristic_equation(mu, period, tip, force):
    """How far exp(s T) = mu is from a root of det(1 + force(s) G(s)) = 0: the share by which G would have to change.

    The multiplier tells s up to whole numbers of 2 pi j / T; one of them must be the root.
    """
    alias = np.arange(-60, 61)
    best = np.inf
    for s in (np.log(complex(mu)) + 2j * np.pi * alias) / period:
        receptance = tip.flexibility + sum(
            np.outer(c, b) / (s - pole) + np.outer(c.conj(), b.conj()) / (s - pole.conj())
            for pole, c, b in zip(tip.pole, tip.output, tip.given, strict=True)
        )
        best = min(best, np.abs(1 + np.linalg.eigvals(force(s) @ receptance)).min())
    return best


@pytest.mark.parametrize("teeth", [4, 6])
@pytest.mark.parametrize("name", ["IS1", "IS2", "ASYM2", "UBC22"])
def test_slots_of_four_and_six_teeth_are_the_zero_order_theory(name, teeth):
    """The cutting matrix is constant there, so that the mean is no approximation: 1e-6 of the depth."""
    tip, this = machine(name), cut(teeth, 1.0, "down", name)
    speed = np.array([3000, 5200, 8000, 11000, 14500]) * RPM
    mean = mean_cutting_matrix(this.ktc, this.krc, teeth=teeth, entry=0, leave=np.pi)
    known = limit(speed, dynamics_of_tip(tip, speed, teeth), mean, teeth).depth
    found = boundary(speed, tip, this, deepest=20e-3, tolerance=1e-8, depth_tolerance=1e-12).first(5)
    assert found.depth == pytest.approx(known, rel=1e-6)
    assert np.all(found.kind == HOPF)


def test_the_least_depth_of_one_mode_is_the_closed_form_at_the_closed_frequency():
    """Slot, four teeth: 2 k zeta (1 + zeta) / K at f_n sqrt(1 + 2 zeta), K = N K_rc / 4 the mean along x."""
    least = 2 * IS_STIFFNESS * IS_DAMPING * (1 + IS_DAMPING) / 200e6
    assert least == pytest.approx(0.149026921e-3, rel=1e-8)
    tip, this = machine("IS1"), cut(4, 1.0, "down")
    frequency = IS_FREQUENCY * np.sqrt(1 + 2 * IS_DAMPING)
    answer = tip.receptance(np.array([frequency]))[0, 0, 0]
    delay = np.angle(1 + 1 / (least * 200e6 * answer))  # of exp(-j w tau) where 1 + b K G (1 - exp(-j w tau)) = 0
    for whole in range(1, 4):
        speed = (2 * np.pi) ** 2 * frequency / (4 * (2 * np.pi * whole - delay))
        assert abs(multipliers(speed, least, tip, this, tolerance=1e-10)[0]) == pytest.approx(1, abs=1e-12)
        found = boundary(np.array([speed]), tip, this, deepest=3 * least, tolerance=1e-10, depth_tolerance=1e-14)
        assert found.depth[0] == pytest.approx(least, rel=1e-9)
        assert found.frequency[0] == pytest.approx(frequency, abs=1e-4)


@pytest.mark.parametrize("name", ["IS1", "ROT2", "UBC22"])
@pytest.mark.parametrize(("teeth", "immersion"), [(2, 0.1), (3, 0.5)])
def test_an_edge_as_deep_as_its_axial_pitch_cuts_without_pulses(name, teeth, immersion):
    """Where one tooth leaves the next comes in: the matrix is the integral of H0 over the engagement, at every angle."""
    tip, depth = machine(name), 1.5e-3
    this = cut(teeth, immersion, "down", name, wind=2 * np.pi / (teeth * depth))
    whole = integral(this.leave, this.ktc, this.krc) - integral(this.entry, this.ktc, this.krc)
    for rpm in (5000, 9300):
        mu = multipliers(rpm * RPM, depth, tip, this, tolerance=1e-12)[0]
        off = off_the_characteristic_equation(
            mu, 2 * np.pi / (teeth * rpm * RPM), tip, lambda s, mu=mu: whole / this.wind * (1 - 1 / mu)
        )
        assert off < 1e-9


@pytest.mark.parametrize("name", ["IS1", "ROT2", "UBC22"])
def test_process_damping_in_a_slot_of_four_teeth_is_a_damper(name):
    """A constant matrix against the motion and one against the velocity."""
    this = cut(4, 1.0, "down", name, indentation=3e4, indentation_friction=0.25, radius=5e-3)
    tip, depth = machine(name), 0.2e-3
    cutting = depth * mean_cutting_matrix(this.ktc, this.krc, teeth=4, entry=0, leave=np.pi)
    rubbing = depth * mean_cutting_matrix(0.25 * 3e4, 3e4, teeth=4, entry=0, leave=np.pi) / this.radius
    for rpm in (3000, 7000):
        mu = multipliers(rpm * RPM, depth, tip, this, tolerance=1e-10)[0]
        off = off_the_characteristic_equation(
            mu,
            np.pi / (2 * rpm * RPM),
            tip,
            lambda s, mu=mu, rpm=rpm: cutting * (1 - 1 / mu) + rubbing * s / (rpm * RPM),
        )
        assert off < 1e-9
        assert abs(mu) < radius(rpm, depth, tip, replace(this, indentation=0.0)) - 1e-4


def test_a_flexibility_answers_at_once():
    """Constant matrix; G with what lies above the modes."""
    modes = machine("ASYM2")
    tip = replace(modes, flexibility=np.array([[2e-7, 5e-8], [5e-8, 3e-7]]))
    this, depth = cut(4, 1.0, "down"), 0.25e-3
    cutting = depth * mean_cutting_matrix(this.ktc, this.krc, teeth=4, entry=0, leave=np.pi)
    for rpm in (5000, 9300):
        mu = multipliers(rpm * RPM, depth, tip, this, tolerance=1e-10)[0]
        off = off_the_characteristic_equation(mu, np.pi / (2 * rpm * RPM), tip, lambda s, mu=mu: cutting * (1 - 1 / mu))
        assert off < 1e-9
        assert abs(abs(mu) - radius(rpm, depth, modes, this)) > 1e-4


def test_complex_modes_are_those_of_masses_dampers_and_springs():
    """Damping in no proportion: det(M s^2 + C s + K + b H (1 - 1 / mu)) = 0 at our multiplier."""
    mass = np.diag([0.04, 0.05])
    damping = np.array([[9.0, -6.0], [-6.0, 16.0]])
    stiffness = np.array([[1.4e6, 0.3e6], [0.3e6, 2.1e6]])
    tip = tip_of_matrices(mass, damping, stiffness)
    assert np.abs(np.imag(tip.output[:, 0] * tip.output[:, 1].conj())).max() > 1e-3 * np.abs(tip.output).max() ** 2
    this, depth, rpm = cut(4, 1.0, "down"), 0.25e-3, 9300
    cutting = depth * mean_cutting_matrix(this.ktc, this.krc, teeth=4, entry=0, leave=np.pi)
    mu, period = multipliers(rpm * RPM, depth, tip, this, tolerance=1e-12)[0], np.pi / (2 * rpm * RPM)
    off = [
        np.abs(
            1 + np.linalg.eigvals(np.linalg.solve(mass * s**2 + damping * s + stiffness, cutting * (1 - 1 / mu)))
        ).min()
        for s in (np.log(mu) + 2j * np.pi * np.arange(-20, 21)) / period
    ]
    assert min(off) < 1e-9


def tip_of_matrices(mass, damping, stiffness):
    """Modes by their residues at the poles of M s^2 + C s + K."""
    zero, one = np.zeros((2, 2)), np.eye(2)
    first = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    poles, right = np.linalg.eig(np.vstack([np.hstack([zero, one]), first]))
    left = np.linalg.inv(right) @ np.vstack([zero, np.linalg.inv(mass)])
    those = poles.imag > 0
    return TipModes(poles[those], right[:2, those].T, left[those], zero)


@pytest.mark.parametrize(("name", "teeth", "immersion"), [("IS2", 2, 0.1), ("IS2", 3, 0.5), ("SYM500", 4, 0.75)])
def test_where_all_directions_are_alike_up_is_down(name, teeth, immersion):
    up, down = (cut(teeth, immersion, direction, name) for direction in ("up", "down"))
    for rpm, depth in ((4000, 0.2e-3), (11000, 1e-3)):
        assert radius(rpm, depth, machine(name), up) == pytest.approx(
            radius(rpm, depth, machine(name), down), rel=1e-12
        )


@pytest.mark.parametrize("more", [{}, {"wind": 80.0}, {"pitch": tuple(np.radians([110, 120, 130]))}], ids=str)
def test_it_is_the_same_cut_from_another_side(more):
    """Modes and engagement turned together."""
    at, turned = 0.3, 0.5
    here = Regeneration(3, at, at + 0.9, 600e6, 200e6, **more)
    there = Regeneration(3, at + turned, at + 0.9 + turned, 600e6, 200e6, **more)
    tips = rotated_modes((30, 110)), rotated_modes((30 - np.degrees(turned), 110 - np.degrees(turned)))
    for rpm in (5000, 12000):
        assert radius(rpm, 0.5e-3, tips[0], here) == pytest.approx(radius(rpm, 0.5e-3, tips[1], there), rel=1e-11)


def test_time_mass_and_force_only_set_the_scale():
    """All frequencies and the speed by a; mass, stiffness and force by a; force by a and depth by 1 / a."""
    a, this, depth = 1.7, cut(3, 0.3, "down", "UBC22", wind=40.0), 0.7e-3
    tip = machine("UBC22")
    here = radius(6000, depth, tip, this)
    faster = TipModes(a * tip.pole, tip.output * a, tip.given, tip.flexibility)
    assert radius(6000 * a, depth, faster, this) == pytest.approx(here, rel=1e-12)
    heavier = TipModes(tip.pole, tip.output / a, tip.given, tip.flexibility)
    assert radius(6000, depth, heavier, this.with_force(a * this.ktc, a * this.krc)) == pytest.approx(here, rel=1e-12)
    shallower = replace(this.with_force(a * this.ktc, a * this.krc), wind=a * this.wind)
    assert radius(6000, depth / a, tip, shallower) == pytest.approx(here, rel=1e-12)


@pytest.mark.parametrize("more", [{}, {"wind": 80.0}, {"pitch": tuple(np.radians([110, 120, 130]))}], ids=str)
def test_without_a_cut_the_slowest_mode_rings_out(more):
    """|mu| = max exp(-zeta w T) at no depth, of a tooth period or, with unequal pitch, of a revolution."""
    tip, this, speed = machine("UBC22"), cut(3, 0.4, "up", **more), 5000 * RPM
    period = (2 * np.pi / 3 if this.equal_pitch else 2 * np.pi) / speed
    assert radius(5000, 0.0, tip, this) == pytest.approx(np.exp(tip.pole.real.max() * period), rel=1e-12)


def test_neither_the_order_of_modes_nor_the_scale_of_a_mode_matters():
    """c z and b / z are the same mode for any complex z, so that a real mode may come in complex clothes."""
    tip, this = machine("UBC22"), cut(2, 0.2, "up", "UBC22", wind=60.0)
    known = radius(6000, 1.5e-3, tip, this)
    shuffled = TipModes(*(part[[2, 0, 3, 1]] for part in (tip.pole, tip.output, tip.given)), tip.flexibility)
    assert radius(6000, 1.5e-3, shuffled, this) == pytest.approx(known, rel=1e-11)
    clothes = np.array([1.3j, -0.4 + 2j, 3.0, 1 - 1j])[:, np.newaxis]
    dressed = replace(tip, output=tip.output * clothes, given=tip.given / clothes)
    assert radius(6000, 1.5e-3, dressed, this) == pytest.approx(known, rel=1e-11)
    natural, damping = np.abs(tip.pole) / (2 * np.pi), -tip.pole.real / np.abs(tip.pole)
    fitted = tip_of_residues(natural, damping, tip.output[:, :, np.newaxis] * tip.given[:, np.newaxis, :])
    assert radius(6000, 1.5e-3, fitted, this) == pytest.approx(known, rel=1e-11)


@pytest.mark.parametrize("immersion", [0.1, 0.75])
@pytest.mark.parametrize("teeth", [2, 3, 4])
def test_a_revolution_is_as_many_tooth_periods(teeth, immersion):
    """Pitches equal to within 1e-8 rad go the way of unequal ones: the map of a revolution is the N-th power."""
    tip, this = machine("ROT2"), cut(teeth, immersion, "down")
    pitch = 2 * np.pi / teeth + 1e-8 * np.array([1, *[0] * (teeth - 2), -1])
    uneven = replace(this, pitch=tuple(pitch))
    assert not uneven.equal_pitch
    for rpm, depth in ((7000, 0.3e-3), (12000, 0.6e-3)):
        one = multipliers(rpm * RPM, depth, tip, this, tolerance=1e-8)[:3]
        whole = multipliers(rpm * RPM, depth, tip, uneven, tolerance=1e-8)[:3]
        assert np.abs(whole) == pytest.approx(np.abs(one) ** teeth, abs=1e-6)
        assert np.abs(whole[0] - one[0] ** teeth) < 1e-6 or np.abs(whole[0] - one[0].conj() ** teeth) < 1e-6


def test_a_flexibility_is_the_limit_of_a_stiff_mode_far_above():
    """Interrupted cut; twice the frequency, half the difference."""
    mode, this, compliance = machine("IS1"), cut(2, 0.3, "up"), 1e-7
    known = radius(9000, 0.3e-3, replace(mode, flexibility=np.diag([compliance, 0.0])), this)
    off = []
    for natural in (15e3, 30e3, 60e3):
        above = along_x(natural, 0.9, 1 / compliance)
        both = TipModes(
            *(np.concatenate([getattr(tip, part) for tip in (mode, above)]) for part in ("pole", "output", "given")),
            np.zeros((2, 2)),
        )
        off.append(radius(9000, 0.3e-3, both, this, order=90) - known)
    assert abs(off[2]) < 2e-4
    assert 1.7 < off[0] / off[1] < 2.4
    assert 1.8 < off[1] / off[2] < 2.3


def test_a_little_helix_changes_little():
    """Over the depth at which the midpoint stands for the integral, and down to none at all."""
    tip, depth = machine("ROT2"), 0.4e-3
    straight, below, above = (
        radius(9000, depth, tip, cut(3, 0.5, "down", wind=lag / depth), tolerance=1e-10)
        for lag in (0, 0.99e-4, 1.01e-4)
    )
    assert below == pytest.approx(straight, abs=1e-4)
    assert above == pytest.approx(below, abs=1e-5)


@pytest.mark.parametrize("wind", [0.0, 60.0])
@pytest.mark.parametrize("immersion", [0.1, 0.6, 0.9])
def test_overlapping_teeth_of_unequal_pitch_converge_fast(immersion, wind):
    """The kinks that come back one delay later are ends of pieces; without that, errors stay at 1e-3 whatever the order."""
    tip = machine("ROT2")
    this = cut(4, immersion, "up", pitch=tuple(np.radians([80, 95, 85, 100])), wind=wind)
    coarse, middle, fine = (radius(7000, 0.3e-3, tip, this, order=order) for order in (16, 20, 26))
    assert middle == pytest.approx(fine, abs=1e-7)
    assert coarse == pytest.approx(fine, abs=1e-5)


def test_two_pitches_in_turn_lose_stability_by_a_fold():
    """70/110/70/110: a motion that changes sign every half turn is whole after a turn, mu = +1."""
    tip, this = machine("IS1"), cut(4, 0.1, "down", pitch=tuple(np.radians([70, 110, 70, 110])))
    speed = np.arange(4000, 12000, 250) * RPM
    found = boundary(speed, tip, this, deepest=8e-3)
    folds = np.flatnonzero(found.kind == FOLD)
    assert len(folds) > 0
    for i in folds:
        mu = multipliers(speed[found.speed[i]], found.depth[i], tip, this, tolerance=1e-8)
        assert np.abs(mu - 1).min() < 1e-4
    equal = boundary(speed, tip, cut(4, 0.1, "down"), deepest=8e-3)
    assert not np.any(equal.kind == FOLD)


def test_flips_are_where_a_multiplier_is_minus_one():
    for case in [case for case in oracles()["cases"] if case["a_over_D"] < 0.2][::4]:
        tip, this = machine(case["modes"]), case_cut(case)
        for row in case["crossings"]:
            known = [at["ap_m"] for at in row["list"] if at["type"] == "F"]
            found = flip_depths(row["rpm"] * RPM, tip, this, deepest=row["amax_m"], order=row["n2"])
            for depth in known:
                assert np.abs(found - depth).min() < 1e-7, case_name(case)
            for depth in found:
                mu = multipliers(row["rpm"] * RPM, depth, tip, this, order=row["n2"])
                assert np.abs(mu + 1).min() < 1e-6


def test_points_grids_and_single_multipliers_agree():
    speed, depth = np.array([4000, 7000, 15000]) * RPM, np.array([0.2e-3, 0.9e-3])
    for tip, this in (
        (machine("UBC22"), cut(2, 0.3, "down", "UBC22")),
        (machine("ROT2"), cut(3, 0.2, "up", wind=70.0)),
        (machine("IS1"), cut(3, 0.2, "up", pitch=tuple(np.radians([100, 120, 140])))),
    ):
        grid = radius_map(speed, depth, tip, this, order=24)
        for i, b in enumerate(depth):
            assert spectral_radius(speed, np.full(3, b), tip, this, order=24) == pytest.approx(grid[i], rel=1e-12)
            single = [abs(multipliers(w, b, tip, this, order=24)[0]) for w in speed]
            assert single == pytest.approx(grid[i], rel=1e-12)


def test_crossings_say_when_and_how_stability_is_lost():
    """Just below and just above a crossing one multiplier goes out, real at a flip, or comes back."""
    tip, this = machine("IS1"), cut(2, 0.1, "down")
    found = boundary(np.array([7500 * RPM]), tip, this, deepest=3e-3, tolerance=1e-8)
    for depth, kind, loses in zip(found.depth, found.kind, found.loses, strict=True):
        outside = [
            np.sum(np.abs(multipliers(7500 * RPM, depth * (1 + side * 1e-4), tip, this, tolerance=1e-8)) > 1)
            for side in (-1, 1)
        ]
        assert outside[1] - outside[0] == (1 if loses else -1) * (1 if kind == FLIP else 2)


def test_a_speed_at_which_a_tooth_cuts_through_hundreds_of_waves_is_told_and_zoa_named():
    with pytest.raises(IllPosedError, match=r"stability\.rpm: at 100 rpm .* zoa"):
        radius(100, 1e-3, machine("UBC22"), cut(2, 1.0, "down", "UBC22"))
