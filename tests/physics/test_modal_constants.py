"""k, m and c from residues, their spread, and shapes."""

import numpy as np
import pytest

from millcal.numerics.jackknife import student_quantile
from millcal.physics.modal_constants import (
    Constant,
    Estimate,
    driving_constants,
    interval,
    interval_of_constant,
    mode_shapes,
)
from millcal.physics.shaped_modes import ShapedMode, receptance_between

FREQUENCY, DAMPING, STIFFNESS = np.array([60.0, 650.0, 2100.0]), np.array([0.1, 0.03, 0.002]), np.array([4e5, 2e7, 8e7])


def residue_of(frequency, damping, stiffness):
    """A = alpha / (2j w_d) of a real mode, alpha = w^2 / k."""
    w = 2 * np.pi * frequency
    return w**2 / stiffness / (2j * w * np.sqrt(1 - damping**2))


def sure(value):
    return Estimate(value, np.zeros((0, len(value)), value.dtype))


def constants(frequency=FREQUENCY, damping=DAMPING, residue=None):
    residue = residue_of(FREQUENCY, DAMPING, STIFFNESS) if residue is None else residue
    return driving_constants(sure(frequency), sure(damping), sure(residue))


def test_springs_masses_and_dampers_rebuild_the_receptance_of_the_residues():
    """1 / (k - m w^2 + j c w), summed, is the sum of A / (j w - p) and its conjugate."""
    k, m, c = (estimate.value for estimate in constants())
    w = 2 * np.pi * np.linspace(1, 3000, 200)[:, np.newaxis]
    parts = np.sum(1 / (k - m * w**2 + 1j * c * w), axis=1)
    own = 2 * np.pi * FREQUENCY
    pole = -DAMPING * own + 1j * own * np.sqrt(1 - DAMPING**2)
    a = residue_of(FREQUENCY, DAMPING, STIFFNESS)
    assert parts == pytest.approx(np.sum(a / (1j * w - pole) + a.conj() / (1j * w - pole.conj()), axis=1), rel=1e-9)
    assert k == pytest.approx(STIFFNESS)


def test_a_modal_constant_that_no_structure_has_gives_nothing():
    residue = residue_of(FREQUENCY, DAMPING, STIFFNESS) * [1, -1, 0]
    for estimate in constants(residue=residue):
        assert np.isfinite(estimate.value).tolist() == [True, False, False]


def test_spread_to_first_order_is_that_of_many_draws_with_all_correlations():
    rng = np.random.default_rng(5)
    a = residue_of(FREQUENCY, DAMPING, STIFFNESS)
    mixing = rng.standard_normal((4, 4))  # frequency, damping, both parts of the residue: correlated
    draws = rng.standard_normal((4000, 3, 4)) @ mixing * 2e-4  # (draw, mode, quantity)
    rows = np.broadcast_to(2e-4 * mixing[:, np.newaxis], (4, 3, 4))  # their covariance is that of the draws

    def scaled(d):
        return d[..., 0] * FREQUENCY, d[..., 1] * DAMPING, (d[..., 2] + 1j * d[..., 3]) * abs(a)

    found = driving_constants(*map(Estimate, (FREQUENCY, DAMPING, a), scaled(rows)))
    drawn = [constants(FREQUENCY + df, DAMPING + dz, a + da) for df, dz, da in zip(*scaled(draws), strict=True)]
    for constant, many in zip(found, zip(*drawn, strict=True), strict=True):
        first_order = np.sqrt(np.sum(constant.inverse.deviation**2, axis=0))
        assert first_order == pytest.approx(np.std([one.inverse.value for one in many], axis=0), rel=0.05)


def test_an_interval_is_students_stays_above_zero_and_is_unknown_without_deviations():
    estimate = Estimate(np.array([10.0, 1.0]), np.array([[0.6, 3.0], [0.8, 4.0]]))  # sd 1 and 5
    low, high = interval(estimate, 4.0).T
    reach = student_quantile(4.0)
    assert low == pytest.approx([10 - reach, 0.0])
    assert high == pytest.approx([10 + reach, 1 + 5 * reach])
    assert np.isnan(interval(Estimate(estimate.value, np.empty((0, 2))), 4.0)).all()
    assert np.isnan(interval(estimate, 0.0)).all()


def constant_of(inverse, sd):
    return Constant(1 / np.array([inverse]), Estimate(np.array([inverse]), np.array([[sd]])))


def test_an_interval_of_a_constant_is_symmetric_where_it_is_narrow_and_open_where_the_mode_hardly_moves():
    low, high = interval_of_constant(constant_of(0.1, 1e-4), 9.0)[0]
    assert high - 10 == pytest.approx(10 - low, rel=0.01)
    assert high - low == pytest.approx(2 * student_quantile(9.0) * 1e-2, rel=1e-3)
    hardly = constant_of(0.1, 0.1)  # half width over 0.1
    assert interval_of_constant(hardly, np.inf)[0] == pytest.approx([1 / (0.1 + 0.195996), np.inf], rel=1e-5)
    below = constant_of(-0.1, 0.1)  # below zero by noise
    assert interval_of_constant(below, np.inf)[0] == pytest.approx([1 / (-0.1 + 0.195996), np.inf], rel=1e-5)
    assert np.isnan(interval_of_constant(constant_of(-0.1, 0.01), np.inf)).all()
    assert np.isnan(interval_of_constant(Constant(np.ones(1), Estimate(np.ones(1), np.empty((0, 1)))), 3.0)).all()


@pytest.mark.parametrize("turn", [1.0, -1.0, 1j, np.exp(0.3j)])
@pytest.mark.parametrize("roving", ["accelerometer", "hammer"])
def test_a_shape_is_found_whatever_its_phase_and_whichever_side_was_moved(turn, roving):
    shape = np.array([0.3, -1.0, 0.7, 0.2])
    residue = turn * np.outer(shape, [0.5, 0.1])[np.newaxis]
    found = mode_shapes(residue if roving == "accelerometer" else residue.transpose(0, 2, 1))
    assert found[0] == pytest.approx(-shape)
    assert found[0].real.max() == pytest.approx(1.0)


def test_a_pair_that_was_not_measured_leaves_its_place_in_the_shape_open_and_the_others_as_they_are():
    residue = 1j * np.outer([0.3, -1.0, 0.7], [1.0, 0.2])[np.newaxis]
    residue[0, 0, 0] = np.nan
    found = mode_shapes(residue)[0]
    assert np.isnan(found[0])
    assert found[1:] == pytest.approx([1.0, -0.7])


def test_the_shape_of_a_structure_is_that_of_its_receptance_at_resonance():
    mode = ShapedMode(800.0, 0.01, 1e7, (("tipX", 1.0), ("tipY", -0.4), ("noseX", 0.25)))
    dofs = ("tipX", "tipY", "noseX")
    at_resonance = receptance_between(np.array([800.0]), [mode], dofs, ("tipX",))
    assert mode_shapes(at_resonance)[0] == pytest.approx([1.0, -0.4, 0.25])
