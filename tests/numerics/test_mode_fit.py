"""The joint fit of modes: exact data, independent solvers, and what must not change the answer."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from millcal.numerics.modal_basis import pole_of
from millcal.numerics.mode_fit import (
    Channels,
    Model,
    columns,
    combined,
    fit_poles,
    residual_after,
    sensitivity,
    whitened,
)

FN, ZETA = np.array([61.0, 83.0, 104.0]), np.array([0.08, 0.03, 0.05])
S = 2j * np.pi * np.linspace(20.0, 180.0, 161)
REAL = Model(False, (-2, 0, 2))


def a_test(rng, inputs=1, outputs=2, model=REAL, noise=0.0, power=2):
    """A test whose values follow the model with random unknowns, in coloured force."""
    root = np.linalg.cholesky(
        np.einsum("lik,ljk->lij", *(2 * [rng.standard_normal((len(S), inputs, inputs + 3)) + 0j]))
    )
    empty = Channels(
        S, np.zeros((outputs, len(S), inputs), complex), root, np.ones(outputs), np.full(outputs, power), None
    )
    phi, _ = columns(empty, FN, ZETA, model)
    size = np.abs(phi).mean(axis=(0, 1, 2))
    linear = rng.uniform(0.5, 1.5, (outputs, phi.shape[-1])) / size
    values = combined(phi, linear)
    white = rng.standard_normal((*values.shape, 2)) @ [1, 1j] * noise / np.sqrt(2)
    coloured = np.einsum("oli,lij->olj", white, np.linalg.inv(root))
    return empty._replace(values=values + coloured), linear


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("model", [REAL, Model(True, (-2, 0)), Model(False, ())])
def test_exact_data_are_found_from_poor_seeds(inputs, model):
    test, linear = a_test(np.random.default_rng(0), inputs, model=model)
    fit = fit_poles([test], FN * [0.97, 1.02, 1.03], ZETA * [1.5, 0.6, 1.4], model)
    np.testing.assert_allclose(fit.natural_frequency, FN, rtol=1e-9)
    np.testing.assert_allclose(fit.damping_ratio, ZETA, rtol=1e-8)
    np.testing.assert_allclose(fit.linear[0], linear, rtol=1e-6)


@pytest.mark.parametrize("model", [REAL, Model(True, (0,))])
def test_slopes_are_differences(model):
    test, _ = a_test(np.random.default_rng(1), 2)
    _, slopes = columns(test, FN, ZETA, model)
    modal = slopes.shape[-1]
    h = 1e-6
    for k in range(2):
        step = [np.exp(h * np.eye(2)[k][i]) for i in range(2)]
        up = columns(test, FN * step[0], ZETA * step[1], model)[0]
        down = columns(test, FN / step[0], ZETA / step[1], model)[0]
        np.testing.assert_allclose(slopes[k], (up - down)[..., :modal] / (2 * h), atol=1e-7 * np.abs(slopes[k]).max())


def test_a_general_solver_ends_at_the_same_place():
    rng = np.random.default_rng(2)
    test, _ = a_test(rng, noise=0.02)
    fit = fit_poles([test], FN, ZETA, REAL)

    def residuals(x):
        functions = columns(test, *np.exp(x).reshape(2, 3), REAL)[0][0]
        a = np.stack([whitened(test, np.stack(2 * [own]))[0] for own in np.moveaxis(functions, -1, 0)], axis=1)
        a = a / np.linalg.norm(a, axis=0)
        return np.concatenate([own - a @ np.linalg.lstsq(a, own, rcond=None)[0] for own in whitened(test, test.values)])

    slow = least_squares(residuals, np.log([FN, ZETA]).ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose([fit.natural_frequency, fit.damping_ratio], np.exp(slow.x).reshape(2, 3), rtol=1e-6)
    assert fit.cost == pytest.approx(2 * slow.cost, rel=1e-9)


def test_white_noise_leaves_one_a_row():
    tests = [a_test(np.random.default_rng(seed), noise=np.sqrt(2.0), inputs=2)[0] for seed in range(20)]
    fits = [fit_poles([test], FN, ZETA, REAL) for test in tests]
    assert np.mean([fit.cost / (fit.rows - fit.unknowns) for fit in fits]) == pytest.approx(1.0, abs=0.02)


def test_scales_and_the_order_of_channels_change_nothing():
    test, _ = a_test(np.random.default_rng(3), noise=0.02)
    fit = fit_poles([test], FN, ZETA, REAL)
    other = test._replace(values=-1e3 * test.values[::-1], noise=1e3 * test.noise, root=test.root * 7)
    again = fit_poles([other], FN[::-1], ZETA[::-1], REAL)
    np.testing.assert_allclose(again.natural_frequency, fit.natural_frequency, rtol=1e-7)
    np.testing.assert_allclose(again.linear[0], -1e3 * fit.linear[0][::-1], rtol=1e-5)
    assert again.cost == pytest.approx(49 * fit.cost)


def test_two_tests_are_one_with_all_outputs():
    rng = np.random.default_rng(4)
    test, _ = a_test(rng, outputs=3, noise=0.02)
    parts = [
        test._replace(values=test.values[rows], noise=test.noise[rows], power=test.power[rows])
        for rows in ([0], [1, 2])
    ]
    one, two = fit_poles([test], FN, ZETA, REAL), fit_poles(parts, FN, ZETA, REAL)
    np.testing.assert_allclose(two.natural_frequency, one.natural_frequency, rtol=1e-10)
    assert two.cost == pytest.approx(one.cost)


def test_without_modes_the_remainder_is_fitted():
    test, _ = a_test(np.random.default_rng(5))
    fit = fit_poles([test], np.zeros(0), np.zeros(0), REAL)
    left = residual_after([test], fit, REAL)[0]
    assert fit.cost == pytest.approx(np.sum(whitened(test, left) ** 2))
    assert fit.unknowns == 6


def test_a_step_follows_a_small_change_of_the_data():
    """The linearised answer against a fit of the changed data."""
    rng = np.random.default_rng(6)
    test, _ = a_test(rng, noise=0.01)
    fit = fit_poles([test], FN, ZETA, REAL, tolerance=1e-14)
    change = 1e-5 * np.abs(test.values).mean() * rng.standard_normal((*test.values.shape, 2)) @ [1, 1j]
    moved = test._replace(values=test.values + change)
    again = fit_poles([moved], fit.natural_frequency, fit.damping_ratio, REAL, tolerance=1e-14)
    phi, _ = columns(moved, fit.natural_frequency, fit.damping_ratio, REAL)
    residual = whitened(moved, moved.values - combined(phi, fit.linear[0]))
    poles, linear = sensitivity([test], fit, REAL).step([(0, residual)])
    found = np.log([again.natural_frequency / fit.natural_frequency, again.damping_ratio / fit.damping_ratio]).ravel()
    np.testing.assert_allclose(poles, found, rtol=0.02, atol=0.02 * np.abs(found).max())
    np.testing.assert_allclose(linear[0], again.linear[0] - fit.linear[0], atol=0.02 * np.abs(linear[0]).max())


@pytest.mark.parametrize("inputs", [1, 2])
def test_many_steps_at_once_are_those_one_by_one(inputs):
    rng = np.random.default_rng(7)
    tests = [a_test(rng, inputs, noise=0.01)[0], a_test(rng, inputs, outputs=3, noise=0.01)[0]]
    fit = fit_poles(tests, FN, ZETA, REAL, tolerance=1e-14)
    known = sensitivity(tests, fit, REAL)
    changes = rng.standard_normal((*known.parts[1].residual.shape, 4))
    poles, linear = known.steps(1, changes)
    resting = known.step([])
    for k in range(4):
        one, own = known.step([(1, known.parts[1].residual + changes[..., k])])
        np.testing.assert_allclose(poles[k], one - resting[0], rtol=1e-9, atol=1e-12 * np.abs(poles).max())
        for many, alone, still in zip(linear, own, resting[1], strict=True):
            np.testing.assert_allclose(many[k], alone - still, rtol=1e-6, atol=1e-9 * np.abs(many).max())


def test_a_pole_decays():
    assert (pole_of(FN, ZETA).real < 0).all()
    np.testing.assert_allclose(np.abs(pole_of(FN, ZETA)), 2 * np.pi * FN)
