"""Modes to receptance, and the three forms of an FRF into each other."""

import numpy as np
import pytest

from millcal.physics.structure import Mode, convert_frf, convert_frf_variance, receptance

FORMS = ("receptance", "mobility", "accelerance")
MODE = Mode(natural_frequency=500.0, damping_ratio=0.03, stiffness=8e6, axis="x")


def test_the_receptance_of_a_mode_is_its_flexibility_at_rest_and_peaks_as_the_closed_forms_say():
    """|Y(f_n)| = 1/c, Re G least at f_n sqrt(1 + 2 zeta): -1 / (4 k zeta (1 + zeta)), Im G < 0 everywhere above DC."""
    k, zeta, fn = MODE.stiffness, MODE.damping_ratio, MODE.natural_frequency
    frequency = np.array([0.0, fn, fn * np.sqrt(1 + 2 * zeta)])
    g = receptance(frequency, [MODE])[:, 0, 0]
    damping = 2 * zeta * k / (2 * np.pi * fn)
    assert g[0] == pytest.approx(1 / k, rel=1e-14)
    assert abs(g[1] * 2j * np.pi * fn) == pytest.approx(1 / damping, rel=1e-12)
    assert g[2].real == pytest.approx(-1 / (4 * k * zeta * (1 + zeta)), rel=1e-12)
    assert np.all(receptance(np.linspace(1, 3000, 100), [MODE])[:, 0, 0].imag < 0)


def test_modes_along_one_axis_add_and_axes_do_not_couple():
    frequency = np.linspace(0, 2000, 50)
    other = Mode(900.0, 0.02, 2e7, "x")
    across = Mode(700.0, 0.05, 1e7, "y")
    g = receptance(frequency, [MODE, other, across])
    assert g.shape == (50, 2, 2)
    np.testing.assert_allclose(
        g[:, 0, 0], receptance(frequency, [MODE])[:, 0, 0] + receptance(frequency, [other])[:, 0, 0]
    )
    assert np.all(g[:, 0, 1] == 0)
    assert np.all(g[:, 1, 0] == 0)


def test_a_mode_along_z_makes_the_matrix_three_by_three_unless_axes_are_named():
    up = Mode(700.0, 0.05, 1e7, "z")
    assert receptance(np.ones(4), [MODE, up]).shape == (4, 3, 3)
    assert receptance(np.ones(4), [MODE, up], axes=("x", "y")).shape == (4, 2, 2)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("to", FORMS)
def test_a_form_and_back_is_the_same_frf_except_at_dc(form, to):
    frequency = np.linspace(0, 2000, 21)
    values = receptance(frequency, [MODE])
    there = convert_frf(frequency, values, form, to)
    back = convert_frf(frequency, there, to, form)
    np.testing.assert_allclose(back[1:], values[1:], rtol=1e-12)
    lost_at_dc = FORMS.index(to) < FORMS.index(form)
    assert np.isnan(there[0]).all() == lost_at_dc


def test_accelerance_is_minus_the_angular_frequency_squared_times_receptance():
    frequency = np.linspace(0, 2000, 21)
    values = receptance(frequency, [MODE])
    expected = -((2 * np.pi * frequency[:, None, None]) ** 2) * values
    np.testing.assert_allclose(convert_frf(frequency, values, "receptance", "accelerance"), expected, rtol=1e-12)


def test_the_variance_of_a_form_is_that_of_scattered_values_of_that_form():
    rng = np.random.default_rng(0)
    frequency = np.full(20_000, 340.0)
    values = rng.standard_normal(20_000) + 1j * rng.standard_normal(20_000)
    variance = convert_frf_variance(frequency, np.full(20_000, 2.0), "accelerance", "receptance")
    assert np.var(convert_frf(frequency, values, "accelerance", "receptance")) == pytest.approx(variance[0], rel=0.03)


@pytest.mark.parametrize(
    "wrong", [{"damping_ratio": 0.0}, {"stiffness": -1.0}, {"natural_frequency": 0.0}, {"axis": "u"}]
)
def test_a_mode_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match=r"positive|none of x, y, z"):
        Mode(**{"natural_frequency": 1.0, "damping_ratio": 0.01, "stiffness": 1.0, "axis": "x", **wrong})
