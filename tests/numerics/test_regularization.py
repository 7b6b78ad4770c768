"""Laws of the choice of Tikhonov's weight: what grows, what shrinks, what the range does."""

import numpy as np
import pytest

from millcal.numerics.linear_inverse import least_squares, tikhonov
from millcal.numerics.regularization import (
    BETWEEN_THE_SINGULAR_VALUES,
    CHOICES,
    decompose,
    discrepancy,
    filter_factors,
    gcv,
    l_curvature,
    l_curve,
    norms,
    search_range,
    solution,
)


def blurred(seed=0, *, noise=1e-3, size=32):
    """A smoothing kernel: ill posed, singular values down to rounding.   returns A, b, x"""
    t = (np.arange(size) + 0.5) / size
    A = np.exp(-((t[:, None] - t) ** 2) / (2 * 0.05**2)) / size
    x = np.sin(np.pi * t) + 0.5 * np.sin(2 * np.pi * t)
    return A, A @ x + noise * np.random.default_rng(seed).normal(size=size), x


def well_conditioned(seed=0, *, noise=0.1):
    """Complex, 12 rows and 6 columns, condition number about 10.   returns A, b, x"""
    rng = np.random.default_rng([5, seed])
    U, _ = np.linalg.qr(rng.normal(size=(12, 6)) + 1j * rng.normal(size=(12, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(6, 6)) + 1j * rng.normal(size=(6, 6)))
    A = U * np.geomspace(10, 1, 6) @ V.conj().T
    x = rng.normal(size=6) + 1j * rng.normal(size=6)
    return A, A @ x + noise * (rng.normal(size=12) + 1j * rng.normal(size=12)), x


def test_the_decomposition_solves_as_the_plain_form_does():
    A, b, _ = well_conditioned()
    system = decompose(A, b)
    for weight in (1e-3, 0.5, 20.0):
        x = tikhonov(A, b, regularization=weight)
        np.testing.assert_allclose(solution(system, weight), x, rtol=1e-10)
        np.testing.assert_allclose(norms(system, weight), [np.linalg.norm(A @ x - b), np.linalg.norm(x)], rtol=1e-10)


def test_the_residual_grows_and_the_solution_shrinks_with_the_weight():
    choice = gcv(decompose(*blurred()[:2]))
    assert np.all(np.diff(choice.weights) > 0)
    assert np.all(np.diff(choice.residual_norm) > 0)
    assert np.all(np.diff(choice.solution_norm) < 0)
    factors = filter_factors(decompose(*blurred()[:2]), choice.weights)
    assert np.all((factors >= 0) & (factors <= 1))


@pytest.mark.parametrize("name", CHOICES)
def test_every_choice_takes_the_noise_out_of_an_ill_posed_system(name):
    A, b, x = blurred()
    system = decompose(A, b)
    options = {"noise_norm": 1e-3 * np.sqrt(32)} if name == "discrepancy" else {}
    choice = CHOICES[name](system, **options)
    errors = [np.linalg.norm(solution(system, w) - x) for w in search_range(system)]
    assert choice.edge == ""
    assert min(errors) <= np.linalg.norm(solution(system, choice.regularization) - x) < 0.3 * np.linalg.norm(x)
    assert np.linalg.norm(least_squares(A, b) - x) > 100 * np.linalg.norm(x)


def test_generalized_cross_validation_is_the_least_of_its_function_by_the_hat_matrix():
    """The slow form: the trace of I - A (A^H A + w^2 I)^-1 A^H."""
    A, b, _ = well_conditioned(noise=2.0)
    choice = gcv(decompose(A, b))

    def function(weight):
        hat = A @ np.linalg.solve(A.conj().T @ A + weight**2 * np.eye(6), A.conj().T)
        return np.linalg.norm(b - hat @ b) ** 2 / np.trace(np.eye(12) - hat).real ** 2

    np.testing.assert_allclose(choice.criterion, [function(w) for w in choice.weights], rtol=1e-8)
    assert choice.edge == ""
    here = function(choice.regularization)
    assert here <= min(function(choice.regularization * 1.01), function(choice.regularization / 1.01))
    assert here <= choice.criterion.min() * (1 + 1e-12)


def test_the_curvature_of_the_l_curve_is_that_of_the_curve_itself():
    system = decompose(*blurred()[:2])
    weights = np.geomspace(1e-6, 1e-2, 4001)
    residual, size = np.log(norms(system, weights))
    dx, dy = np.gradient(residual), np.gradient(size)
    curvature = (dx * np.gradient(dy) - np.gradient(dx) * dy) / (dx**2 + dy**2) ** 1.5
    inside = slice(20, -20)
    exact = l_curvature(system, weights)[inside]
    np.testing.assert_allclose(exact, curvature[inside], atol=2e-3 * np.abs(exact).max())


def test_the_corner_is_the_largest_curvature_of_the_range():
    system = decompose(*blurred()[:2])
    choice = l_curve(system)
    assert l_curvature(system, np.array([choice.regularization]))[0] >= choice.criterion.max() * (1 - 1e-9)


def test_the_discrepancy_meets_its_level():
    system = decompose(*blurred()[:2])
    choice = discrepancy(system, noise_norm=0.01)
    assert choice.edge == ""
    assert norms(system, choice.regularization)[0] == pytest.approx(0.01, rel=1e-9)


@pytest.mark.parametrize(("noise_norm", "edge"), [(1e-30, "low"), (1e30, "high")])
def test_a_level_that_no_weight_meets_is_answered_with_the_edge(noise_norm, edge):
    system = decompose(*well_conditioned()[:2])
    choice = discrepancy(system, noise_norm=noise_norm)
    assert choice.edge == edge
    assert choice.regularization == choice.weights[0 if edge == "low" else -1]


@pytest.mark.parametrize("name", ["gcv", "l-curve"])
def test_between_the_singular_values_the_choice_sits_on_the_edge_and_is_biased_without_noise(name):
    A, b, x = well_conditioned(noise=0.0)
    system = decompose(A, b)
    narrow = CHOICES[name](system, span=BETWEEN_THE_SINGULAR_VALUES)
    assert narrow.edge == "low"
    assert narrow.regularization == pytest.approx(system.s[-1])
    assert np.linalg.norm(solution(system, narrow.regularization) - x) > 0.1 * np.linalg.norm(x)
    wide = CHOICES[name](system)
    assert np.linalg.norm(solution(system, wide.regularization) - x) < 1e-7 * np.linalg.norm(x)


def test_scaling_the_system_scales_the_weight():
    A, b, _ = blurred()
    for choose in (gcv, l_curve):
        w = choose(decompose(A, b)).regularization
        assert choose(decompose(1e3 * A, b)).regularization == pytest.approx(1e3 * w, rel=1e-3)
        assert choose(decompose(A, 1e3 * b)).regularization == pytest.approx(w, rel=1e-3)


@pytest.mark.parametrize("choose", [gcv, l_curve])
def test_data_that_no_x_reaches_have_a_choice_too(choose):
    A, _, _ = well_conditioned()
    nothing = np.zeros(12)
    assert np.isfinite(choose(decompose(A, nothing)).regularization)


def test_a_curve_without_a_corner_leaves_the_lowest_weight():
    """One singular value and nothing outside: |x| and |A x - b| are on an arc that bends the other way."""
    choice = l_curve(decompose(np.eye(3), np.ones(3)))
    assert np.all(choice.criterion <= 0)
    assert choice.edge == "low"
