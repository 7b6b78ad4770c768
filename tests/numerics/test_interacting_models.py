"""Interacting models against the Kalman filter they become when there is nothing to choose, and in what they choose."""

import numpy as np
import pytest

from millcal.numerics import interacting_models as imm

F = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # level, constant, speed of the level
Q = np.diag([0.0, 0.0, 1e-4])
REST = imm.Model(F, np.zeros((3, 3)))
TREND = imm.Model(F, Q)
NOISE = np.array([[0.2, 0.05], [0.05, 0.1]])
X0, P0 = np.array([1.0, -1.0, 0.0]), np.diag([1.0, 0.5, 1e-4])


def record(steps=300, seed=0, level=lambda k: 0.0):
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((steps, 2, 3))
    H[:, :, 2] = 0.0
    truth = np.stack([np.array([level(k), 0.5, 0.0]) for k in range(steps)])
    return H, np.einsum("kij,kj->ki", H, truth) + rng.standard_normal((steps, 2)) @ np.linalg.cholesky(NOISE).T, truth


def run(H, y, models, stay=0.99, **options):
    state = imm.start(X0, P0, len(models))
    chances = imm.switching(len(models), stay)
    infos, states = [], []
    for row, value in zip(H, y, strict=True):
        state, info = imm.step(
            state,
            value,
            models=models,
            chances=chances,
            observe=lambda x, row=row: (row @ x, row),
            noise=NOISE,
            **options,
        )
        infos.append(info)
        states.append(state)
    return states, infos


def kalman(H, y, model):
    """The textbook's filter, with inverses."""
    x, P, means, covariances, total = X0, P0, [], [], 0.0
    for row, value in zip(H, y, strict=True):
        x, P = model.transition @ x, model.transition @ P @ model.transition.T + model.noise
        S = row @ P @ row.T + NOISE
        v = value - row @ x
        total -= 0.5 * (v @ np.linalg.inv(S) @ v + np.log(np.linalg.det(2 * np.pi * S)))
        K = P @ row.T @ np.linalg.inv(S)
        x, P = x + K @ v, P - K @ row @ P
        means.append(x)
        covariances.append(P)
    return np.array(means), np.array(covariances), total


@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("common", [True, False])
def test_models_that_move_alike_are_the_kalman_filter(count, common):
    H, y, _ = record(60)
    states, infos = run(H, y, [TREND] * count, common=common)
    means, covariances, total = kalman(H, y, TREND)
    assert np.array([info.mean for info in infos]) == pytest.approx(means, rel=1e-9, abs=1e-12)
    assert np.array([info.covariance for info in infos]) == pytest.approx(covariances, rel=1e-8, abs=1e-13)
    assert sum(info.log_likelihood for info in infos) == pytest.approx(total)
    assert states[-1].probability == pytest.approx(np.full(count, 1 / count))


def test_the_order_of_the_models_is_nothing():
    H, y, _ = record(80, level=lambda k: 0.02 * k)
    models = [REST, TREND, imm.Model(F, 10 * Q)]
    forth, back = run(H, y, models)[1], run(H, y, models[::-1])[1]
    assert forth[-1].mean == pytest.approx(back[-1].mean, rel=1e-10)
    assert forth[-1].covariance == pytest.approx(back[-1].covariance, rel=1e-9, abs=1e-15)


def test_what_rests_is_given_to_the_model_that_rests():
    still = imm.Model(np.eye(3), np.zeros((3, 3)))
    walk = imm.Model(np.eye(3), np.diag([0.05, 0.05, 0.0]))
    H, y, _ = record(400)
    states, _ = run(H, y, [still, walk], stay=0.999)
    assert states[-1].probability[0] > 0.995
    H, y, _ = record(400, level=lambda k: np.sin(0.05 * k))
    states, _ = run(H, y, [still, walk], stay=0.999)
    assert states[-1].probability[1] > 0.9


def test_a_jump_wakes_the_fast_model_and_the_rest_comes_back():
    still = imm.Model(np.eye(3), np.zeros((3, 3)))
    fast = imm.Model(np.eye(3), np.diag([0.5, 0.0, 0.0]))
    H, y, truth = record(600, level=lambda k: 2.0 * (k >= 300))
    states, infos = run(H, y, [still, fast], stay=0.995)
    probability = np.array([state.probability[1] for state in states])
    assert probability[250:300].max() < 0.3
    assert probability[300:306].max() > 0.95
    assert probability[-50:].max() < 0.3
    assert abs(infos[330].mean[0] - truth[330, 0]) < 0.4
    lone = run(H, y, [still])[1]
    assert abs(lone[330].mean[0] - truth[330, 0]) > 1.5


def test_chances_of_a_sure_switch_and_of_none():
    assert np.array_equal(imm.switching(1, 0.9), [[1.0]])
    assert imm.switching(3, 0.9).sum(axis=1) == pytest.approx(np.ones(3))
    assert np.diag(imm.switching(3, 0.9)) == pytest.approx(np.full(3, 0.9))


def test_an_observation_that_none_foretold_leaves_numbers():
    """Ten thousand standard deviations off: densities underflow, weights do not."""
    state = imm.start(X0, P0, 2)
    H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    state, info = imm.step(
        state,
        np.array([1e5, -1e5]),
        models=[REST, TREND],
        chances=imm.switching(2, 0.99),
        observe=lambda x: (H @ x, H),
        noise=NOISE,
    )
    assert np.isfinite(info.log_likelihood)
    assert state.probability.sum() == pytest.approx(1.0)
    assert np.all(np.isfinite(state.mean))


def test_the_intervals_of_a_true_mixture_cover():
    """A level that rests and walks by turns, as the models suppose: normalised errors have unit variance."""
    still = imm.Model(np.eye(3), np.zeros((3, 3)))
    walk = imm.Model(np.eye(3), np.diag([0.02, 0.0, 0.0]))
    errors = []
    for seed in range(30):
        rng = np.random.default_rng(500 + seed)
        x = X0 + np.sqrt(np.diag(P0)) * rng.standard_normal(3)
        moving, H, y, truth = rng.random() < 0.5, rng.standard_normal((150, 2, 3)), [], []
        H[:, :, 2] = 0.0
        for row in H:
            moving = moving if rng.random() < 0.98 else not moving
            x = x + moving * np.array([np.sqrt(0.02), 0, 0]) * rng.standard_normal()
            y.append(row @ x + np.linalg.cholesky(NOISE) @ rng.standard_normal(2))
            truth.append(x)
        _, infos = run(H, np.array(y), [still, walk], stay=0.98)
        errors += [(i.mean[0] - t[0]) / np.sqrt(i.covariance[0, 0]) for i, t in zip(infos, truth, strict=True)][::10]
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.25)


def test_what_linearising_leaves_out_is_noise():
    """exp, with a start far off and hardly any noise: trusting its slopes ends in a certain error, not trusting them does not."""
    H = np.random.default_rng(0).standard_normal((40, 2, 3))
    H[:, :, 2] = 0.0
    truth = np.array([2.0, -0.5, 0.0])
    errors = {}
    for name, left_out in {"slopes": None, "noise": lambda slopes, P: (slopes**2 @ np.diag(P)) ** 2}.items():
        state = imm.start(np.zeros(3), np.diag([1.0, 1.0, 1e-8]), 2)
        for row in H:
            state, info = imm.step(
                state,
                np.exp(row @ truth),
                models=[REST, imm.Model(np.eye(3), np.zeros((3, 3)))],
                chances=imm.switching(2, 0.99),
                observe=lambda x, row=row: (np.exp(row @ x), np.exp(row @ x)[:, np.newaxis] * row),
                noise=1e-6 * np.eye(2),
                left_out=left_out,
            )
        errors[name] = np.abs(info.mean - truth)[:2] / np.sqrt(np.diag(info.covariance))[:2]
    assert errors["noise"].max() < 4
    assert errors["slopes"].max() > 30
