"""Force and coefficients of the structure of 2012 by every plain solver: exact without noise, and equal where they must be."""

import numpy as np
import pytest
from scipy.optimize import minimize
from structure_2012 import COEFFICIENTS, CUTTER, block_accelerance, conditions

from millcal.numerics.linear_inverse import (
    as_complex_vector,
    as_real,
    as_real_vector,
    constrained_least_squares,
    constrained_total_least_squares,
    least_squares,
    null_basis,
    tikhonov,
    total_least_squares,
)
from millcal.numerics.regularization import BETWEEN_THE_SINGULAR_VALUES, CHOICES, decompose
from millcal.physics.force_subspace import force_constraint, harmonic_basis

W = harmonic_basis(CUTTER, conditions(80.0), [2, 4]).reshape(6, 6) / 2  # two-sided, as in the paper
SHOWN = slice(0, 5)  # all but Kae
FORCE = W @ COEFFICIENTS
ROW = np.array([[1, 1j, 0, -5 / 3, -5j / 3, 0]])
FULL = force_constraint(2 * W.reshape(2, 3, 6)).rows


def noisy(seed, tooth_passing=78.0, *, matrix=0.1, data=0.05):
    """G and a with errors, as shares of their mean sizes.   returns complex (12, 6), (12,)"""
    rng = np.random.default_rng([2012, seed])
    G = block_accelerance(tooth_passing)
    a = G @ FORCE

    def errors(like):
        return (rng.normal(size=like.shape) + 1j * rng.normal(size=like.shape)) * np.sqrt(
            np.mean(np.abs(like) ** 2) / 2
        )

    return G + matrix * errors(G) * (G != 0), a + data * errors(a)


def coefficients_of(force):
    M = as_real_vector(W)[:, SHOWN] * COEFFICIENTS[SHOWN]
    return np.linalg.lstsq(M, as_real_vector(force))[0] * COEFFICIENTS[SHOWN]


def tls_objective(G, a, F):
    return np.linalg.norm(G @ F - a) ** 2 / (np.linalg.norm(F) ** 2 + 1)


def full(solve, G, a):
    return as_complex_vector(solve(as_real(G), as_real_vector(a), FULL))


SOLUTIONS = {
    "LS": least_squares,
    "TLS": total_least_squares,
    "RLS": lambda G, a: constrained_least_squares(G, a, ROW),
    "RTLS": lambda G, a: constrained_total_least_squares(G, a, ROW),
    "dLS": lambda G, a: full(constrained_least_squares, G, a),
    "dTLS": lambda G, a: full(constrained_total_least_squares, G, a),
    "Tikhonov": lambda G, a: tikhonov(G, a, regularization=CHOICES["gcv"](decompose(G, a)).regularization),
}


@pytest.mark.parametrize("tooth_passing", [53.0, 78.0, 108.0])
@pytest.mark.parametrize("name", SOLUTIONS)
def test_without_noise_the_coefficients_come_back(name, tooth_passing):
    G = block_accelerance(tooth_passing)
    found = coefficients_of(SOLUTIONS[name](G, G @ FORCE))
    rtol = 1e-6 if name == "Tikhonov" else 1e-8  # the lower end of its search is not zero
    np.testing.assert_allclose(found, COEFFICIENTS[SHOWN], rtol=rtol)


@pytest.mark.parametrize("seed", range(3))
def test_least_squares_under_the_full_constraint_is_least_squares_of_the_coefficients(seed):
    """F = W K says the same as L_R [Re F; Im F] = 0."""
    G, a = noisy(seed)
    law = as_real_vector(W)[:, SHOWN] * COEFFICIENTS[SHOWN]
    direct = np.linalg.lstsq(as_real(G) @ law, as_real_vector(a))[0]
    F = SOLUTIONS["dLS"](G, a)
    np.testing.assert_allclose(as_real_vector(F), law @ direct, rtol=0, atol=1e-12 * np.abs(F).max())
    np.testing.assert_allclose(coefficients_of(F), direct * COEFFICIENTS[SHOWN], rtol=1e-11)


def test_total_least_squares_under_the_full_constraint_is_that_in_an_orthonormal_basis_of_the_law():
    G, a = noisy(1)
    Q, _ = np.linalg.qr(as_real_vector(W)[:, SHOWN] * COEFFICIENTS[SHOWN])
    expected = Q @ total_least_squares(as_real(G) @ Q, as_real_vector(a))
    np.testing.assert_allclose(
        as_real_vector(SOLUTIONS["dTLS"](G, a)), expected, rtol=0, atol=1e-11 * np.abs(expected).max()
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("constraint", [ROW, None], ids=["one row", "full"])
def test_the_constraint_holds_to_rounding(seed, constraint):
    G, a = noisy(seed)
    if constraint is None:
        F = as_real_vector(SOLUTIONS["dTLS"](G, a))
        constraint = FULL
    else:
        F = SOLUTIONS["RTLS"](G, a)
    assert np.linalg.norm(constraint @ F) < 1e-12 * np.linalg.norm(F)


def test_total_least_squares_is_the_minimum_of_equation_13():
    G, a = noisy(2)
    for basis, F in [(np.eye(6), SOLUTIONS["TLS"](G, a)), (null_basis(ROW), SOLUTIONS["RTLS"](G, a))]:
        start = as_real_vector(basis.conj().T @ F) * 0.9

        def function(v, basis=basis):
            return tls_objective(G, a, basis @ as_complex_vector(v))

        found = minimize(function, start, method="BFGS", options={"gtol": 1e-12, "maxiter": 3000})
        assert function(as_real_vector(basis.conj().T @ F)) <= found.fun * (1 + 1e-12)
        np.testing.assert_allclose(basis @ as_complex_vector(found.x), F, rtol=0, atol=1e-3 * np.abs(F).max())


@pytest.mark.parametrize("seed", range(4))
def test_the_form_with_slack_tends_to_the_one_without(seed):
    G, a = noisy(seed)
    strict = SOLUTIONS["RTLS"](G, a)
    away = []
    for slack in (30.0, 3.0, 0.3, 0.03):  # N
        F = constrained_total_least_squares(G, a, ROW, slack=slack)
        assert np.linalg.norm(ROW @ F) <= slack * (1 + 1e-9)
        away.append(np.linalg.norm(F - strict) / np.linalg.norm(strict))
    assert away == sorted(away, reverse=True)
    assert away[-1] < 1e-3


@pytest.mark.parametrize("choice", ["gcv", "l-curve"])
def test_a_search_between_the_singular_values_is_biased_without_noise(choice):
    for tooth_passing in (53.0, 78.0, 108.0):
        G = block_accelerance(tooth_passing)
        system = decompose(G, G @ FORCE)
        narrow = CHOICES[choice](system, span=BETWEEN_THE_SINGULAR_VALUES)
        found = coefficients_of(tikhonov(G, G @ FORCE, regularization=narrow.regularization))
        assert narrow.edge == "low"
        assert np.abs(found[:2] / COEFFICIENTS[:2] - 1).max() > 0.01
        wide = coefficients_of(tikhonov(G, G @ FORCE, regularization=CHOICES[choice](system).regularization))
        np.testing.assert_allclose(wide, COEFFICIENTS[SHOWN], rtol=1e-6)


def test_the_printed_row_ruins_the_coefficients_without_any_noise():
    """Eq. 21 with the coefficients of a Fourier transform, RMSE over the speeds of the paper."""
    printed = np.array([[1j, 1, 0, -5j / 3, -5 / 3, 0]])
    error = []
    for tooth_passing in np.arange(53.0, 109.0, 5.0):
        G = block_accelerance(tooth_passing)
        force = constrained_total_least_squares(G, G @ FORCE, printed)
        error.append(coefficients_of(force)[:2] / COEFFICIENTS[:2] - 1)
    np.testing.assert_allclose(100 * np.sqrt(np.mean(np.square(error), axis=0)), [114, 105], atol=0.6)
