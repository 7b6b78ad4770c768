"""Compiled filters of the staircase of discs against the plain steps of numerics, on the same draws."""

import numpy as np
import pytest

from millcal.numerics import ensemble_kalman, interacting_models, recursive_least_squares
from millcal.numerics.interacting_kernel import Motions, transitions
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.disc_filters import follow_ensemble, follow_least_squares, follow_models
from millcal.physics.disc_force import disc_chips, is_cutting, shape_and_slope, shape_tables

LIMITS = np.array([[500.0, 2500.0], [0.1, 0.7], [200.0, 1600.0], [0.2, 0.8]])
SIGMA = np.array([30.0, 20.0])
INFLATIONS = {
    "none": None,
    "often": ensemble_kalman.Inflation(7, 4, 0.5),
    "at the end": ensemble_kalman.Inflation(112, 40, 1.0),
    "later": ensemble_kalman.Inflation(500, 4, 1.0),
}


@pytest.fixture(scope="module")
def tables():
    """Of one revolution; k S(m) is newtons with k in N/mm^2 at a chip of 1 mm."""
    chips = disc_chips(
        Cutter(10e-3, 2, np.pi / 4),
        CuttingConditions(270.0, 0.1e-3, 2e-3, 3e-3, "down"),
        2 * np.pi * np.arange(234) / 234,
        23,
    )
    found = shape_tables(chips[:, :, is_cutting(chips, 0.01e-3)], 2e-3 / 23, 1e-3)
    return found._replace(coefficients=1e6 * found.coefficients)


@pytest.fixture(scope="module")
def force(tables):
    k, m = np.array([1700.0, 350.0]), np.array([0.18, 0.55])
    clean = [k[i] * shape_and_slope(tables, np.full(112, m[i]))[0] for i in range(2)]
    return np.stack(clean, axis=1) + SIGMA * np.random.default_rng(3).standard_normal((112, 2))


def members_at(seed, count):
    return LIMITS[:, 0] + np.ptp(LIMITS, axis=1) * np.random.default_rng(seed).random((count, 4))


def plain_ensemble(tables, force, members, rng, inflation):
    state, means = ensemble_kalman.start(members), []
    for k, observation in enumerate(force):
        here = tables.of(slice(k, k + 1))

        def observe(X, here=here):
            return np.stack([X[:, i] * shape_and_slope(here, X[:, i + 1, None])[0][:, 0] for i in (0, 2)], axis=1)

        state, _ = ensemble_kalman.step(
            state, observation, observe=observe, noise=np.diag(SIGMA**2), rng=rng, limits=LIMITS, inflation=inflation
        )
        means.append(state.members.mean(axis=0))
    return np.array(means)


@pytest.mark.parametrize("members", [41, 100])
@pytest.mark.parametrize("inflation", INFLATIONS.values(), ids=INFLATIONS)
def test_the_ensemble_is_the_plain_step(tables, force, inflation, members):
    start = members_at(1, members)
    plain = plain_ensemble(tables, force, start, np.random.default_rng(9), inflation)
    fast = follow_ensemble(
        tables, force, SIGMA, start, rng=np.random.default_rng(9), limits=LIMITS, inflation=inflation
    )
    assert fast == pytest.approx(plain, rel=1e-10)


def test_draws_that_are_handed_in_give_the_same_as_draws_of_its_own(tables, force):
    start, rng = members_at(1, 30), np.random.default_rng(9)
    normals = rng.standard_normal((len(force), 30, 2))
    handed = follow_ensemble(tables, force, SIGMA, start, rng=rng, limits=LIMITS, normals=normals)
    own = follow_ensemble(tables, force, SIGMA, start, rng=np.random.default_rng(9), limits=LIMITS)
    assert np.array_equal(handed, own)


def test_it_does_not_touch_what_it_is_given(tables, force):
    start = members_at(1, 30)
    before = start.copy()
    follow_ensemble(tables, force, SIGMA, start, rng=np.random.default_rng(9), limits=LIMITS)
    assert np.array_equal(start, before)


@pytest.mark.parametrize("limits", [None, LIMITS[:2]], ids=["free", "box"])
def test_least_squares_are_the_plain_step(tables, force, limits):
    starts = members_at(2, 5)[:, :2]
    fast = follow_least_squares(tables, force[:, 0], starts, 10 * np.eye(2), forgetting=0.98, limits=limits)
    for start, found in zip(starts, fast, strict=True):
        state = recursive_least_squares.Estimate(start, 10 * np.eye(2))
        for k, observation in enumerate(force[:, 0]):

            def observe(x, here=tables.of(slice(k, k + 1))):
                value, slope = shape_and_slope(here, x[1:])
                return x[0] * value, np.array([[value[0], x[0] * slope[0]]])

            state, _ = recursive_least_squares.step(
                state,
                np.array([observation]),
                observe=observe,
                noise=np.eye(1),
                forgetting=0.98,
                limits=limits,
                projection="clip",
            )
            assert found[k] == pytest.approx(state.mean, rel=1e-8)


def test_interacting_models_are_the_plain_step(tables, force):
    motions = Motions(np.array([0, 2]), np.array([4, 5]), np.zeros(2), np.array([0.0, 1e-4]))
    chances = interacting_models.switching(2, 0.99)
    P = np.diag([0.2, 0.03, 0.2, 0.03, 1e-6, 1e-6])
    P[0, 1] = P[1, 0] = 0.05
    starts = [interacting_models.start(np.array([a, 0.4, b, 0.5, 0, 0]), P, 2) for a, b in ((7.1, 6.5), (7.6, 6.1))]
    fast = follow_models(tables, force, SIGMA, starts, motions=motions, chances=chances)
    for state, found in zip(starts, fast, strict=True):
        for k, observation in enumerate(force):

            def observe(x, here=tables.of(slice(k, k + 1))):
                predicted, slopes = np.empty(2), np.zeros((2, 6))
                for d in range(2):
                    value, slope = shape_and_slope(here, x[2 * d + 1 : 2 * d + 2])
                    predicted[d] = np.exp(x[2 * d]) * value[0]
                    slopes[d, 2 * d], slopes[d, 2 * d + 1] = predicted[d], np.exp(x[2 * d]) * slope[0]
                return predicted, slopes

            state, info = interacting_models.step(
                state,
                observation,
                models=transitions(motions, 6),
                chances=chances,
                observe=observe,
                noise=np.diag(np.square(SIGMA)),
            )
            assert found[k] == pytest.approx(info.mean[:4], rel=1e-8, abs=1e-11)
