"""Laws of the cutting force: closed forms, symmetries, conservation, and true kinematics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import (
    Kienzle,
    LinearEdge,
    chip_thickness,
    force_at,
    force_harmonics,
    to_machine_axes,
)

ALUMINIUM = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
UNEQUAL = tuple(np.radians([84.0, 96.0, 87.0, 93.0]))
SPEED = 600.0  # rad/s


def conditions(direction="slot", *, feed=0.1e-3, depth=2e-3, radial=0.016):
    return CuttingConditions(SPEED, feed, depth, radial, direction)


def force_by_brute_sum(law, cutter, cut, angle, slices=200):
    """Force at spindle angles by summing thin slices at each instant: the slow form.   returns (3, angle) N"""
    height = (np.arange(slices) + 0.5) * cut.axial_depth / slices
    chip = chip_thickness(cutter, cut, angle, height)  # (tooth, slice, angle)
    lag = cutter.tooth_lag()[:, np.newaxis] + cutter.helix_lag(height)
    on_edge = law.edge_force(chip, cut.axial_depth / slices)
    return to_machine_axes(on_edge, angle - lag[:, :, np.newaxis]).sum(axis=(0, 1)).T


def chip_by_kinematics(cutter, feed_per_tooth, angle):
    """Chip of points on the teeth that turn and travel, measured along the ray from the spindle's axis to what the teeth before
    have left of the material: no linearised geometry, no knowledge of which tooth went there last.

    angle : (angle,) rad, of each tooth itself   returns (tooth, angle) m
    """
    teeth, lag, radius = cutter.teeth, cutter.tooth_lag(), cutter.radius
    feed = feed_per_tooth * teeth / (2 * np.pi)  # m per radian of the spindle

    def point(tooth, spindle):
        """x, y of a tooth's tip; clockwise from +y, feed along +x."""
        offset, own = spindle + cutter.runout_angle, spindle - lag[tooth]
        x = feed * spindle + cutter.runout * np.sin(offset) + radius * np.sin(own)
        return x, cutter.runout * np.cos(offset) + radius * np.cos(own)

    chip = np.empty((teeth, len(angle)))
    for tooth in range(teeth):
        for i, own in enumerate(angle):
            now = own + lag[tooth]
            axis = feed * now
            x, y = point(tooth, now)
            ray, reach = np.arctan2(x - axis, y), np.hypot(x - axis, y)
            surface = 0.0
            for earlier in range(teeth):
                for turn in (1, 2, 3):  # revolutions back, and the part of one between the two teeth
                    passed = own + lag[earlier] - 2 * np.pi * turn
                    if now - passed > 4 * np.pi + 0.1:
                        continue
                    for revolution in (0, 1):
                        at = passed + 2 * np.pi * revolution
                        if at > now - 0.1:
                            continue
                        path_x, path_y = point(earlier, at + np.linspace(-0.05, 0.05, 201))
                        direction = np.unwrap(np.arctan2(path_x - axis, path_y))
                        at_ray = direction[100] + (ray - direction[100] + np.pi) % (2 * np.pi) - np.pi
                        surface = max(surface, np.interp(at_ray, direction, np.hypot(path_x - axis, path_y)))
            chip[tooth, i] = max(reach - surface, 0.0)
    return chip


@pytest.mark.parametrize(
    "cutter",
    [
        Cutter(0.016, 3, runout=12e-6, runout_angle=0.7),
        Cutter(0.016, 4, runout=20e-6, runout_angle=-1.9),
        Cutter(0.016, 4, pitch=UNEQUAL, runout=15e-6, runout_angle=2.4),
        Cutter(0.016, 3, pitch=tuple(np.radians([110.0, 125.0, 125.0]))),
    ],
    ids=["3 teeth", "4 teeth", "4 unequal teeth", "3 unequal teeth, true"],
)
def test_the_chip_is_that_of_turning_and_travelling_teeth_to_first_order_in_feed_over_radius(cutter):
    angle = np.linspace(0.15, np.pi - 0.15, 41)
    errors = []
    for scale in (1.0, 0.5):
        small = Cutter(cutter.diameter, cutter.teeth, 0.0, cutter.pitch, scale * cutter.runout, cutter.runout_angle)
        feed = scale * 0.05e-3
        lag = small.tooth_lag()
        linear = np.array(
            [
                chip_thickness(small, conditions(feed=feed), angle + lag[j], np.zeros(1))[j, 0]
                for j in range(small.teeth)
            ]
        )
        error = np.abs(chip_by_kinematics(small, feed, angle) - linear).max()
        assert error < (small.teeth * feed) ** 2 / small.radius  # 1.6 to 5 % of the feed here
        errors.append(error / feed)
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.15)


def test_mean_force_in_slotting_is_the_closed_form_of_altintas():
    """Manufacturing Automation, mean forces of a full slot."""
    cutter, cut = Cutter(0.016, 4, np.radians(30)), conditions()
    (Ktc, Krc, Kac), (Kte, Kre, Kae) = ALUMINIUM.cutting, ALUMINIUM.edge
    N, a, f = cutter.teeth, cut.axial_depth, cut.feed_per_tooth
    assert force_harmonics(ALUMINIUM, cutter, cut, 4)[:, 0] == pytest.approx(
        [
            -N * a / 4 * Krc * f - N * a / np.pi * Kre,
            +N * a / 4 * Ktc * f + N * a / np.pi * Kte,
            +N * a / np.pi * Kac * f + N * a / 2 * Kae,
        ],
        rel=1e-12,
    )


def test_kienzle_without_rise_is_the_linear_law_without_edge():
    linear = LinearEdge(ALUMINIUM.cutting, np.zeros(3))
    kienzle = Kienzle(ALUMINIUM.cutting, np.zeros(3))
    cutter = Cutter(0.012, 3, 0.6, runout=10e-6, runout_angle=0.4)
    args = (cutter, conditions("down", radial=4e-3), 20)
    assert force_harmonics(kienzle, *args) == pytest.approx(force_harmonics(linear, *args), rel=1e-9, abs=1e-9)


def test_there_is_no_chip_and_no_force_outside_the_engagement():
    cutter, cut = Cutter(0.016, 1), conditions("up", radial=4e-3)
    entry, leave = engagement(cut, cutter.diameter)
    angle = np.linspace(0, 2 * np.pi, 721)
    outside = (angle < entry - 1e-9) | (angle > leave + 1e-9)
    assert np.all(chip_thickness(cutter, cut, angle, np.zeros(1))[0, 0, outside] == 0)
    assert np.all(ALUMINIUM.edge_force(np.array([0.0, -1e-6]), 1e-3) == 0)
    assert np.all(Kienzle(ALUMINIUM.cutting, np.full(3, 0.3)).edge_force(np.array([0.0, -1e-6]), 1e-3) == 0)


def test_up_and_down_milling_of_the_same_width_mirror_each_other():
    cutter = Cutter(0.016, 2)
    angle = np.linspace(0, np.pi, 301)
    up = chip_thickness(cutter, conditions("up", radial=5e-3), angle, np.zeros(1))[0, 0]
    down = chip_thickness(cutter, conditions("down", radial=5e-3), angle, np.zeros(1))[0, 0]
    assert down == pytest.approx(up[::-1], abs=1e-18)


def test_half_a_slot_up_and_half_down_are_a_slot():
    cutter = Cutter(0.016, 3, 0.5)
    halves = [force_harmonics(ALUMINIUM, cutter, conditions(way, radial=8e-3), 24) for way in ("up", "down")]
    assert sum(halves) == pytest.approx(force_harmonics(ALUMINIUM, cutter, conditions(), 24), abs=1e-9)


@pytest.mark.parametrize(
    ("law", "tolerance"), [(ALUMINIUM, 2e-3), (Kienzle(ALUMINIUM.cutting, np.array([0.25, 0.4, 0.3])), 2e-3)]
)
@pytest.mark.parametrize("direction", ["slot", "down", "up"])
def test_harmonics_are_those_of_the_slow_sum_over_slices(law, tolerance, direction):
    cutter = Cutter(0.012, 4, np.radians(38), pitch=UNEQUAL, runout=14e-6, runout_angle=1.9)
    cut = conditions(direction, feed=0.05e-3, depth=3e-3, radial=0.012 if direction == "slot" else 3e-3)
    angle = 2 * np.pi * np.arange(1024) / 1024
    slow = force_by_brute_sum(law, cutter, cut, angle)
    spectrum = np.fft.rfft(slow, axis=1)[:, :33] / len(angle)
    spectrum[:, 1:] *= 2
    fast = force_harmonics(law, cutter, cut, 32)
    assert np.abs(fast - spectrum).max() < tolerance * np.abs(spectrum).max()


def test_equal_teeth_without_runout_repeat_every_tooth():
    cutter = Cutter(0.016, 3, 0.5)
    harmonics = force_harmonics(ALUMINIUM, cutter, conditions("down", radial=3e-3), 30)
    others = [k for k in range(31) if k % cutter.teeth]
    assert np.abs(harmonics[:, others]).max() < 1e-10 * np.abs(harmonics).max()


def test_a_tooth_set_back_by_more_than_the_feed_never_cuts_and_the_other_takes_both_chips():
    cutter = Cutter(0.016, 2, runout=60e-6)  # tooth 0 reaches out 120 um farther than tooth 1
    cut = conditions(feed=0.1e-3)
    angle = np.linspace(0.1, np.pi - 0.1, 50)
    chips = chip_thickness(cutter, cut, np.concatenate([angle, angle + np.pi]), np.zeros(1))[:, 0]
    assert chips[0, :50] == pytest.approx(2 * cut.feed_per_tooth * np.sin(angle))
    assert np.all(chips[1, 50:] == 0)
    one_tooth = CuttingConditions(SPEED, 2 * cut.feed_per_tooth, cut.axial_depth, cut.radial_depth, "slot")
    alone = force_harmonics(ALUMINIUM, Cutter(0.016, 1), one_tooth, 10)
    assert force_harmonics(ALUMINIUM, cutter, cut, 10) == pytest.approx(alone, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    runout=st.floats(0, 80e-6),
    runout_angle=st.floats(-np.pi, np.pi),
    pitches=st.lists(st.floats(0.5, 1.5), min_size=1, max_size=6),
    angle=st.floats(0.05, np.pi - 0.05),
)
def test_the_teeth_share_the_feed_of_a_revolution_whatever_the_runout(runout, runout_angle, pitches, angle):
    """What one tooth leaves the next one takes: the chips at one place add up to N f_z sin(phi), contact lost or not."""
    pitch = tuple(2 * np.pi * np.array(pitches) / sum(pitches))
    cutter = Cutter(0.016, len(pitch), pitch=pitch, runout=runout, runout_angle=runout_angle)
    cut = conditions(feed=0.05e-3)
    chips = [
        chip_thickness(cutter, cut, np.array([angle + lag]), np.zeros(1))[j, 0, 0]
        for j, lag in enumerate(cutter.tooth_lag())
    ]
    assert sum(chips) == pytest.approx(cutter.teeth * cut.feed_per_tooth * np.sin(angle), rel=1e-9)


def test_the_force_does_not_jump_where_runout_lifts_a_tooth_out_of_the_cut():
    """At 2 rho = f_z the second tooth leaves the cut: the force has a root there, not a step."""
    cut = conditions(feed=0.05e-3)
    at = force_harmonics(ALUMINIUM, Cutter(0.016, 2, 0.5, runout=25e-6), cut, 8)
    near = [
        force_harmonics(ALUMINIUM, Cutter(0.016, 2, 0.5, runout=25e-6 + d), cut, 8)
        for d in (-1e-8, -1e-10, 1e-10, 1e-8)
    ]
    change = [np.abs(force - at).max() / np.abs(at).max() for force in near]
    assert max(change) < 3e-3
    assert change[1] < 0.2 * change[0]
    assert change[2] < 0.2 * change[3]


def test_the_force_of_the_harmonics_is_real_and_has_their_mean():
    harmonics = force_harmonics(ALUMINIUM, Cutter(0.016, 2, 0.5, runout=5e-6), conditions(), 40)
    force = force_at(harmonics, 2 * np.pi * np.arange(200) / 200)
    assert force.mean(axis=1) == pytest.approx(harmonics[:, 0].real, abs=1e-9)


def test_a_left_hand_helix_with_runout_mirrors_the_axial_order_of_a_right_hand_one():
    """Seen from the other end of the edge, a left-hand cutter is a right-hand one: the same force, earlier by the whole lag."""
    conditions = CuttingConditions(600.0, 0.1e-3, 3e-3, 4e-3, "down")
    law = LinearEdge(np.array([800e6, 250e6, 120e6]), np.array([20e3, 15e3, 5e3]))
    right = Cutter(12e-3, 2, np.radians(30), runout=8e-6, runout_angle=0.4)
    lag = float(right.helix_lag(np.array(3e-3)))
    left = Cutter(12e-3, 2, -np.radians(30), runout=8e-6, runout_angle=0.4 + lag)
    angle = np.linspace(0, 2 * np.pi, 50)
    ours, mirrored = (force_harmonics(law, cutter, conditions, 20) for cutter in (right, left))
    assert force_at(ours, angle) == pytest.approx(force_at(mirrored, angle - lag), rel=1e-6, abs=1e-3)
