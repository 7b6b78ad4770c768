"""The recursion against the batch solution, and the projections against their definitions."""

import numpy as np
import pytest

from millcal.numerics import recursive_least_squares as rls

X0, P0 = np.array([0.5, -0.3, 2.0]), np.diag([4.0, 1.0, 9.0])
NOISE = np.array([[0.2, 0.05], [0.05, 0.1]])
FREE = np.array([[-np.inf, np.inf]] * 3)


def record(steps=40, seed=0):
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((steps, 2, 3))
    y = H @ np.array([1.0, 2.0, -1.0]) + rng.standard_normal((steps, 2)) @ np.linalg.cholesky(NOISE).T
    return H, y


def run(H, y, **options):
    state = rls.Estimate(X0, P0)
    infos = []
    for row, value in zip(H, y, strict=True):
        state, info = rls.step(state, value, observe=lambda x, row=row: (row @ x, row), noise=NOISE, **options)
        infos.append(info)
    return state, infos


def batch(H, y, forgetting):
    """The normal equations of the sum that is minimised."""
    steps = len(H)
    weight = forgetting ** np.arange(steps - 1, -1, -1)
    W = np.linalg.inv(NOISE)
    A = forgetting**steps * np.linalg.inv(P0) + np.einsum("k,kij,il,klm->jm", weight, H, W, H)
    b = forgetting**steps * np.linalg.solve(P0, X0) + np.einsum("k,kij,il,kl->j", weight, H, W, y)
    return np.linalg.solve(A, b), np.linalg.inv(A)


@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.7])
def test_the_recursion_is_the_weighted_batch_solution_at_every_instant(forgetting):
    H, y = record()
    for steps in (1, 7, 40):
        state, _ = run(H[:steps], y[:steps], forgetting=forgetting)
        mean, covariance = batch(H[:steps], y[:steps], forgetting)
        assert state.mean == pytest.approx(mean, rel=1e-9)
        assert state.covariance == pytest.approx(covariance, rel=1e-9, abs=1e-14)


def test_a_bent_observation_is_linearised_at_the_estimate_before_it():
    state, info = rls.step(
        rls.Estimate(np.array([2.0]), np.array([[0.5]])),
        np.array([4.5]),
        observe=lambda x: (x**2, 2 * x[:, np.newaxis]),
        noise=np.array([[1.0]]),
        forgetting=0.9,
    )
    gain = 0.5 * 4 / (0.9 + 4 * 0.5 * 4)  # P g / (rho + g P g)
    assert state.mean == pytest.approx([2 + gain * 0.5])
    assert state.covariance[0, 0] == pytest.approx((1 - gain * 4) * 0.5 / 0.9)
    assert info.innovation_covariance[0, 0] == pytest.approx(16 * 0.5 / 0.9 + 1)


def test_innovations_of_a_true_model_have_unit_variance():
    squares, total = 0.0, 0
    for seed in range(60):
        rng = np.random.default_rng(1000 + seed)
        H, _ = record(seed=seed)
        truth = X0 + np.sqrt(np.diag(P0)) * rng.standard_normal(3)
        y = H @ truth + rng.standard_normal((40, 2)) @ np.linalg.cholesky(NOISE).T
        _, infos = run(H, y)
        squares += sum(np.sum(info.normalised**2) for info in infos)
        total += 80
    assert squares / total == pytest.approx(1.0, abs=3.5 * np.sqrt(2 / total))


def test_forgetting_follows_what_a_full_memory_averages():
    H, _ = record(200)
    truth = np.where(np.arange(200)[:, np.newaxis] < 100, [1.0, 2.0, -1.0], [2.0, 1.0, 1.0])
    y = np.einsum("kij,kj->ki", H, truth)
    late = [np.abs(run(H, y, forgetting=rho)[0].mean - truth[-1]).max() for rho in (0.9, 1.0)]
    assert late[0] < 1e-3
    assert late[1] > 0.3


@pytest.mark.parametrize("projection", rls.PROJECTIONS)
def test_an_estimate_inside_its_box_is_not_touched(projection):
    H, y = record()
    boxed, infos = run(H, y, limits=np.array([[-50.0, 50.0]] * 3), projection=projection)
    assert np.array_equal(boxed.mean, run(H, y)[0].mean)
    assert not any(info.at_bound.any() for info in infos)
    assert np.array_equal(run(H, y, limits=FREE, projection=projection)[0].mean, boxed.mean)


def test_the_nearest_point_of_a_half_space_is_the_constrained_minimum():
    P = np.array([[2.0, 0.9, 0.1], [0.9, 1.0, -0.3], [0.1, -0.3, 0.7]])
    x = np.array([3.0, 0.2, -0.4])
    limits = FREE.copy()
    limits[0, 1] = 1.0
    got = rls.nearest(x, P, limits)
    assert got[0] == 1.0
    assert np.linalg.solve(P, got - x)[1:] == pytest.approx([0, 0], abs=1e-12)  # no pull in the directions left free
    assert rls.nearest(got, P, limits) == pytest.approx(got)


def test_several_bounds_are_kept_at_once():
    rng = np.random.default_rng(3)
    limits = np.array([[-1.0, 1.0], [0.0, 0.5], [-0.2, 0.2]])
    for _ in range(200):
        root = rng.standard_normal((3, 3))
        x = rls.nearest(3 * rng.standard_normal(3), root @ root.T, limits)
        assert np.all((x >= limits[:, 0]) & (x <= limits[:, 1]))


def test_a_bound_that_is_reached_takes_the_others_along():
    """Sum well seen, difference not: where one is held back the other must make up for it, or the sum is wrong."""
    state = rls.Estimate(np.array([0.5, 0.5]), 25 * np.eye(2))
    H = np.array([[1.0, 1.0], [1.0, 0.8]])
    options = {"observe": lambda x: (H @ x, H), "noise": np.diag([1e-4, 1e-2])}
    limits = np.array([[0.0, 1.0], [-9.0, 9.0]])
    sums = {}
    for projection in rls.PROJECTIONS:
        got, _ = rls.step(state, H @ [1.3, 0.7], limits=limits, projection=projection, **options)
        assert got.mean[0] == 1.0
        sums[projection] = got.mean.sum()
    assert sums["nearest"] == pytest.approx(2.0, abs=1e-2)
    assert sums["clip"] < 1.75


@pytest.mark.parametrize("project", rls.PROJECTIONS.values())
def test_a_pair_outside_its_disc_comes_to_the_rim(project):
    P = np.array([[2.0, 0.9, 0.1], [0.9, 1.0, -0.3], [0.1, -0.3, 0.7]])
    x = project(np.array([0.3, 3.0, -4.0]), P, FREE, [(1, 2.0)])
    assert x[1:] == pytest.approx([1.2, -1.6])
    if project is rls.nearest:  # the state left free takes its conditional mean
        assert np.linalg.solve(P, x - [0.3, 3.0, -4.0])[0] == pytest.approx(0.0, abs=1e-12)
    inside = np.array([9.0, 0.1, -0.2])
    assert np.array_equal(project(inside, P, FREE, [(1, 2.0)]), inside)


def test_what_is_never_seen_is_not_forgotten_beyond_its_ceiling():
    """The third state has no slope: without a ceiling its variance overflows in a few minutes of samples."""
    H, y = record(300)
    H[:, :, 2] = 0.0
    free, _ = run(H, y, forgetting=0.9)
    held, _ = run(H, y, forgetting=0.9, ceiling=np.diag(P0))
    assert free.covariance[2, 2] > 1e13
    assert held.covariance[2, 2] == pytest.approx(P0[2, 2])
    assert held.mean == pytest.approx(free.mean)
    assert held.covariance[:2, :2] == pytest.approx(free.covariance[:2, :2])


def test_what_linearising_leaves_out_is_noise():
    H, y = record(20)
    plain, _ = run(H, y)
    louder, _ = run(H, y, left_out=lambda slopes, P: np.zeros(2))
    assert np.array_equal(plain.mean, louder.mean)
    _, infos = run(H[:1], y[:1], left_out=lambda slopes, P: np.array([1.0, (slopes[1] ** 2 @ np.diag(P)) ** 2]))
    extra = infos[0].innovation_covariance - run(H[:1], y[:1])[1][0].innovation_covariance
    assert extra == pytest.approx(np.diag([1.0, (H[0, 1] ** 2 @ np.diag(P0)) ** 2]))
