"""Variable projection against the plain search of all unknowns, and in its limits."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from millcal.numerics.separable_least_squares import separable_least_squares, solve_linear

T = np.linspace(0.0, 4.0, 60)


def decays(p):
    """Two exponentials, the classic of Golub & Pereyra.   returns (rows, 2)"""
    return np.exp(-np.outer(T, p))


def slopes(p, q):
    return -T[:, np.newaxis] * decays(p) * q


def ask(data, **more):
    every = np.ones(2)
    return separable_least_squares(
        decays, slopes, data, np.array([0.3, 2.5]), lower=0.01 * every, upper=20 * every, scale=0.1 * every, **more
    )


def test_exact_data_give_back_their_unknowns():
    found = ask(decays(np.array([0.5, 1.7])) @ [2.0, -1.0])
    assert found.nonlinear == pytest.approx([0.5, 1.7], rel=1e-6)
    assert found.linear == pytest.approx([2.0, -1.0], rel=1e-6)


def test_projection_ends_where_the_search_of_all_unknowns_ends():
    rng = np.random.default_rng(1)
    data = decays(np.array([0.5, 1.7])) @ [2.0, 1.5] + 0.01 * rng.standard_normal(len(T))
    found = ask(data)
    plain = least_squares(lambda x: data - decays(x[:2]) @ x[2:], [0.3, 2.5, 1.0, 1.0], xtol=1e-14, ftol=1e-14)
    assert found.cost == pytest.approx(2 * plain.cost, rel=1e-8)
    assert found.nonlinear == pytest.approx(plain.x[:2], rel=1e-4)


def test_held_linear_unknowns_stay_where_they_are():
    data = decays(np.array([0.5, 1.7])) @ [2.0, 1.5]
    found = ask(data, held=np.array([2.0, 1.5]))
    assert found.linear is not None
    assert np.array_equal(found.linear, [2.0, 1.5])
    assert found.nonlinear == pytest.approx([0.5, 1.7], rel=1e-6)


def test_a_pull_wins_where_the_data_say_nothing():
    flat = separable_least_squares(
        lambda p: np.ones((len(T), 1)),
        lambda p, q: np.zeros((len(T), 1)),
        np.full(len(T), 3.0),
        np.array([0.0]),
        lower=np.array([-9.0]),
        upper=np.array([9.0]),
        scale=np.array([1.0]),
        pull_to=np.array([1.5]),
        pull=np.array([0.1]),
    )
    assert flat.nonlinear == pytest.approx([1.5])
    assert flat.linear == pytest.approx([3.0])


def test_coefficients_of_very_different_size_are_solved_alike():
    matrix = np.column_stack([1e-9 * np.cos(T), 1e3 * np.sin(T)])
    assert solve_linear(matrix, matrix @ [4e9, 2e-3]) == pytest.approx([4e9, 2e-3], rel=1e-10)
