"""What the states of the two models of change stand for."""

import numpy as np
import pytest

from millcal.numerics.state_space import Observed, filter_states, smooth_states
from millcal.numerics.trend_models import MODELS, layout_of, uniform_prior

MEAN = np.array([8.0, 0.2, 7.0, 0.5, 6.0, 0.4, 3.0])  # three directions and a constant
COVARIANCE = np.diag([0.2, 0.02, 0.3, 0.03, 0.1, 0.01, 4.0])
COVARIANCE[0, 1] = COVARIANCE[1, 0] = -0.03
LAYOUT = layout_of(3)

every_model = pytest.mark.parametrize("name", MODELS)


def model_of(name):
    return MODELS[name](MEAN, COVARIANCE, LAYOUT)


def trajectories(model, steps=6, draws=20_000, seed=0):
    """States drawn from the dynamics, by their definition.   returns (draw, step, state)"""
    rng = np.random.default_rng(seed)
    dynamics, n = model.dynamics, len(model.dynamics.start)
    root = np.linalg.cholesky(dynamics.start_covariance + 1e-14 * np.eye(n))
    x = dynamics.start + rng.standard_normal((draws, n)) @ root.T
    level_of = {speed: level for level, speed in dynamics.speeds}
    drawn = []
    for _ in range(steps):
        for _small in range(20):
            dt = 1 / steps / 20
            for speed, level in level_of.items():
                x[:, level] += dt * x[:, speed]
            for state in dynamics.noisy:
                x[:, state] += 0.5 * np.sqrt(dt) * rng.standard_normal(draws)
        drawn.append(x.copy())
    return np.stack(drawn, axis=1)


@every_model
def test_parameters_that_do_not_change_come_back(name):
    model, p = model_of(name), MEAN + 0.1
    assert model.parameters(model.begin(p)[np.newaxis])[0] == pytest.approx(p)


@every_model
def test_the_prior_of_the_parameters_is_that_of_the_start(name):
    model = model_of(name)
    x = model.dynamics.start[np.newaxis]
    G = model.slopes(x)[0]
    assert model.parameters(x)[0] == pytest.approx(MEAN)
    assert G @ model.dynamics.start_covariance @ G.T == pytest.approx(COVARIANCE)


@every_model
def test_slopes_are_those_of_the_parameters(name):
    model = model_of(name)
    x = model.dynamics.start + np.random.default_rng(0).normal(size=(4, len(model.dynamics.start)))
    slopes = model.slopes(x)
    for state in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[state] = 1e-6
        change = (model.parameters(x + step) - model.parameters(x - step)) / 2e-6
        assert slopes[:, :, state] == pytest.approx(change, abs=1e-8)


@every_model
def test_constants_do_not_change(name):
    model = model_of(name)
    p = model.parameters(trajectories(model, draws=50).reshape(-1, len(model.dynamics.start))).reshape(50, 6, -1)
    assert np.ptp(p[:, :, 6], axis=1) == pytest.approx(0.0)
    assert np.all(np.ptp(p[:, :, [0, 2, 4]], axis=1) > 0)


def test_with_one_trend_all_parameters_move_along_one_line():
    model = model_of("shared")
    one = trajectories(model, draws=1)[0]
    change = np.diff(model.parameters(one), axis=0)[:, :6]
    assert np.linalg.matrix_rank(change, tol=1e-9) == 1
    assert np.linalg.matrix_rank(np.diff(trajectories(model_of("independent"), draws=1)[0][:, :6], axis=0)) == 5


@every_model
def test_the_filter_knows_the_dynamics_it_is_given(name):
    """The spread of many drawn trajectories against the filter's prediction when nothing is seen."""
    model, steps = model_of(name), 6
    n = len(model.dynamics.start)
    blind = Observed(np.zeros((steps, 1, n)), np.zeros((steps, 1)), np.full(steps, 1 / steps), np.zeros((steps, n)))
    filtered = filter_states(model.dynamics, np.full(len(model.dynamics.noisy), 0.5), blind)
    drawn = trajectories(model)
    for k in (0, 3, 5):
        sd = np.sqrt(np.diag(filtered.covariance[k]))
        assert np.std(drawn[:, k], axis=0) == pytest.approx(sd, rel=0.06, abs=1e-6)


def test_directions_of_independent_trends_do_not_hear_of_each_other():
    model = model_of("independent")
    n, steps = len(model.dynamics.start), 9
    H = np.zeros((steps, 1, n))
    H[:, 0, 0] = 1.0
    seen = Observed(H, np.random.default_rng(0).normal(size=(steps, 1)) + 9, np.full(steps, 0.1), np.zeros((steps, n)))
    intensity = np.full(len(model.dynamics.noisy), 0.3)
    smoothed = smooth_states(model.dynamics, intensity, seen, filter_states(model.dynamics, intensity, seen))
    assert model.parameters(smoothed.mean)[:, 2:] == pytest.approx(np.tile(MEAN[2:], (steps, 1)))


@every_model
def test_a_jump_moves_every_direction_and_no_constant(name):
    model = model_of(name)
    G = model.slopes(model.dynamics.start[np.newaxis])[0]
    jumped = np.diag(G @ np.diag(model.shock) @ G.T)
    assert np.all(jumped[list(LAYOUT.levels)] > 0)
    assert jumped[6] == 0


def test_every_scale_is_averaged_over_once_and_every_noise_has_one():
    for name in MODELS:
        model = model_of(name)
        assert sorted(index for group in model.groups for index, _ in group) == list(range(len(model.box)))
        assert set(model.scale_of) == set(range(len(model.box)))
        assert len(model.scale_of) == len(model.dynamics.noisy)
        for group in model.groups:
            for index, grid in group:
                assert np.all(np.log10(grid) >= model.box[index, 0] - 1e-9)
                assert np.all(np.log10(grid) <= model.box[index, 1] + 1e-9)


def test_the_prior_of_a_box_is_that_of_uniform_draws():
    limits = [(1.0, 3.0), (-2.0, 0.0), (5.0, 5.5)]
    mean, covariance = uniform_prior(limits)
    drawn = np.random.default_rng(0).uniform(*np.transpose(limits), size=(200_000, 3))
    assert mean == pytest.approx(drawn.mean(axis=0), abs=0.01)
    assert covariance == pytest.approx(np.cov(drawn.T), abs=0.01)
