"""The staircase of discs: how it is cut, and its polynomials beside the plain sum."""

import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle
from millcal.physics.disc_force import disc_chips, force_and_slopes, is_cutting, shape, shape_and_slope, shape_tables

CUTTER = Cutter(10e-3, 2, np.pi / 4)
CONDITIONS = CuttingConditions(270.0, 0.1e-3, 2e-3, 3e-3, "down")
HEIGHT = 2e-3 / 23
ANGLE = 2 * np.pi * np.arange(234) / 234
CHIPS = disc_chips(CUTTER, CONDITIONS, ANGLE, 23)
ACTIVE = CHIPS[:, :, is_cutting(CHIPS, 0.01e-3)]
RISES = np.linspace(0.1, 0.8, 15)


def printed_staircase(join):
    """Eq. 22 with the engagement function of eq. 24 as a loop, in mm and degrees.   join : of the two conditions"""
    b, n_discs, diameter, beta = 2.0, 23, 10.0, 45.0
    lag = 360 * b / (n_discs * np.pi * diameter * np.tan(np.radians(90 - beta)))
    entry = 180 - np.degrees(np.arccos(1 - 2 * 3.0 / diameter))
    found = np.zeros((2, n_discs, 234))
    for k in range(234):
        for z in range(2):
            for n in range(n_discs):
                phi = (360 * k / 234 + 180 * z - n * lag) % 360
                if join(phi >= entry, phi <= 180):
                    found[z, n, k] = 0.1 * np.sin(np.radians(phi))
    return found


def test_the_discs_are_those_of_the_paper_with_both_teeth_and_wrapped_angles():
    expected = printed_staircase(lambda after, before: after and before)
    assert np.sort(1e3 * CHIPS, axis=0) == pytest.approx(np.sort(expected, axis=0), abs=1e-12)


def test_eq_24_joined_by_or_as_printed_would_cut_backwards():
    assert printed_staircase(lambda after, before: after or before).min() < -0.09  # whose powers are complex


def test_112_of_234_samples_are_above_the_threshold_and_116_cut():
    assert np.count_nonzero(is_cutting(CHIPS, 0.01e-3)) == 112
    assert np.count_nonzero(CHIPS.any(axis=(0, 1))) == 116


def test_many_discs_become_the_helix():
    law = Kienzle(np.array([1.7e9, 3.5e8, 0.0]), np.array([0.18, 0.55, 0.2]))
    fine = 4000
    chips = disc_chips(CUTTER, CONDITIONS, ANGLE, fine)
    mean = law.edge_force(chips, 2e-3 / fine)[..., 0].sum(axis=(0, 1))
    ours = 1.7e9 * shape(chips, 0.18, 2e-3 / fine, 1e-3)
    assert ours == pytest.approx(mean, rel=1e-12)
    coarse = 1.7e9 * shape(CHIPS, 0.18, HEIGHT, 1e-3)
    assert coarse.mean() == pytest.approx(ours.mean(), rel=0.02)


def test_the_polynomials_are_within_5e_7_of_the_sum_over_discs_and_their_slope_within_1e_5():
    tables = shape_tables(ACTIVE, HEIGHT, 1e-3)
    for rise in RISES:
        value, slope = shape_and_slope(tables, np.full(ACTIVE.shape[2], rise))
        up, down = (shape(ACTIVE, rise + step, HEIGHT, 1e-3) for step in (1e-5, -1e-5))
        assert np.max(np.abs(value / shape(ACTIVE, rise, HEIGHT, 1e-3) - 1)) < 5e-7
        assert np.max(np.abs(slope / ((up - down) / 2e-5) - 1)) < 1e-5


def test_force_and_slopes_are_those_of_the_specific_force_at_any_reference_chip():
    tables = shape_tables(ACTIVE, HEIGHT, 1e-3)
    k, m, h0 = 1.7e9, 0.18, 0.06e-3
    rise = np.full(ACTIVE.shape[2], m)
    level = np.log(k) - m * np.log(h0 / 1e-3)
    force, slopes = force_and_slopes(tables, np.full_like(rise, level), rise, h0)
    assert force == pytest.approx(k * shape(ACTIVE, m, HEIGHT, 1e-3), rel=1e-6)
    step = 1e-6
    by_level = (force_and_slopes(tables, level + step, rise, h0)[0] - force) / step
    by_rise = (force_and_slopes(tables, level, rise + step, h0)[0] - force) / step
    assert slopes[:, 0] == pytest.approx(by_level, rel=1e-5)
    assert slopes[:, 1] == pytest.approx(by_rise, rel=1e-4, abs=1e-3 * force.max())


def test_chips_of_a_tenth_keep_the_polynomials_good():
    thin = 0.1 * ACTIVE
    value, _ = shape_and_slope(shape_tables(thin, HEIGHT, 1e-3), np.full(thin.shape[2], 0.8))
    assert value == pytest.approx(shape(thin, 0.8, HEIGHT, 1e-3), rel=5e-6)
