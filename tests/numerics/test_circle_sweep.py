"""The sweep of half a circle, held against counting the eigenvalues of matrices one can simply look at."""

import numpy as np
import pytest

from millcal.numerics.circle_sweep import STEPS, circle_crossings

LARGEST = 3.0


def feedback(seed, size=6, damped=0.9):
    """z -> (A - b C) z with A inside the circle; mu is an eigenvalue where det(I + b M) = 0, M = (mu - A)^-1 C."""
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((size, size))
    a *= damped / np.abs(np.linalg.eigvals(a)).max()
    c = rng.standard_normal((size, size)) / np.sqrt(size)

    def matrix(angle):
        mu = np.exp(1j * angle)[:, np.newaxis, np.newaxis]
        return np.linalg.solve(mu * np.eye(size) - a, np.broadcast_to(c, (len(angle), size, size)))

    return a, c, matrix


@pytest.mark.parametrize("seed", range(40))
def test_the_crossings_below_a_factor_add_up_to_the_multipliers_outside_the_circle(seed):
    a, c, matrix = feedback(seed)
    found = circle_crossings(matrix, LARGEST)
    each = np.where((found.angle == 0) | (found.angle == np.pi), 1, 2) * np.where(found.rising, 1, -1)
    for factor in np.linspace(0.05, LARGEST, 60):
        outside = np.count_nonzero(np.abs(np.linalg.eigvals(a - factor * c)) > 1)
        assert each[found.factor < factor].sum() == outside


@pytest.mark.parametrize("seed", range(5))
def test_at_a_crossing_the_multiplier_lies_on_the_circle_at_its_angle(seed):
    a, c, matrix = feedback(seed, size=8)
    found = circle_crossings(matrix, LARGEST)
    assert len(found.angle) >= 3
    assert np.all(np.diff(found.factor) >= 0)
    for angle, factor in zip(found.angle, found.factor, strict=True):
        assert np.abs(np.linalg.eigvals(a - factor * c) - np.exp(1j * angle)).min() < 1e-7


@pytest.mark.parametrize("beside", [0.0045, 0.05, 0.4])
def test_a_pair_that_crosses_right_beside_a_flip_is_found_with_it(beside):
    """With s = pi - theta, lambda = -(1 - (1 + mu) (1 - cos beside) + (1 + mu)^2 / 2) is real at s = 0 and s = beside."""

    def matrix(angle):
        up = 1 + np.exp(1j * angle)
        return -(1 - up * (1 - np.cos(beside)) + up**2 / 2)[:, np.newaxis, np.newaxis]

    found = circle_crossings(matrix, 1.5, start=2.0)
    np.testing.assert_allclose(np.sort(found.angle), [np.pi - beside, np.pi], atol=1e-5)
    assert found.rising[found.angle == np.pi] != found.rising[found.angle < np.pi]


def test_a_resonance_much_narrower_than_the_first_steps_is_found_where_it_is_said_to_be():
    """A pole a distance of 1e-4 from the circle: the loop it draws is over within a hundredth of a step."""
    pole = (1 - 1e-4) * np.exp(1.2345j)

    def matrix(angle):
        mu = np.exp(1j * angle)[:, np.newaxis, np.newaxis]
        turn = np.exp(3.7345j)  # of the loop: it goes through -0.8
        return 1e-4 * (turn / (mu - pole) + turn.conjugate() / (mu - pole.conjugate()))

    found = circle_crossings(matrix, 5.0, extra=np.array([1.2345]))
    assert len(found.angle) == 1
    assert found.angle[0] == pytest.approx(1.2345, abs=1e-3)
    assert found.factor[0] == pytest.approx(-1 / np.cos(2.5), rel=1e-3)


@pytest.mark.parametrize("place", [0.35, 0.4, 0.6, 0.65])
def test_two_crossings_at_the_foot_of_a_cusp_are_found_though_a_parabola_stays_above_them(place):
    """Im lambda falls and rises in straight lines, as beside a resonance, and is below zero within half a step."""
    step = np.pi / STEPS
    foot = (20 + place) * step

    def matrix(angle):
        return (-1 + 1j * (np.abs(angle - foot) - step / 4))[:, np.newaxis, np.newaxis]

    found = circle_crossings(matrix, 1.5)
    np.testing.assert_allclose(np.sort(found.angle), [foot - step / 4, foot + step / 4], atol=1e-9)
    assert found.rising[np.argsort(found.angle)].tolist() == [False, True]


def test_no_factor_above_the_largest_is_told():
    *_, matrix = feedback(3)
    all_of_them = circle_crossings(matrix, LARGEST)
    some = circle_crossings(matrix, LARGEST / 3)
    kept = all_of_them.factor <= LARGEST / 3
    np.testing.assert_allclose(some.factor, all_of_them.factor[kept], rtol=1e-8)
    assert 0 < kept.sum() < len(kept)
