"""The filter and the smoother against the joint Gaussian distribution of all states, written down and inverted."""

from typing import NamedTuple

import numpy as np
import pytest

from millcal.numerics.state_space import (
    Dynamics,
    Filtered,
    Observed,
    Smoothed,
    filter_states,
    motion_penalty,
    shock_evidence,
    smooth_states,
)

STATES, STEPS, SEEN = 5, 30, 3


def example(seed=0):
    """Two trends and a walk, a known state, a jump, and rows without an observation."""
    rng = np.random.default_rng(seed)
    dynamics = Dynamics(
        rng.normal(size=STATES), np.diag([1.0, 0.5, 0.0, 2.0, 1.0]), np.array([[0, 1], [2, 3]]), np.array([1, 3, 4])
    )
    matrix, value = rng.normal(size=(STEPS, SEEN, STATES)), rng.normal(size=(STEPS, SEEN))
    matrix[5], value[5] = 0.0, 0.0
    matrix[11, 1], value[11, 1] = 0.0, 0.0
    shock = np.zeros((STEPS, STATES))
    shock[20, [0, 4]] = 0.3, 0.1
    return dynamics, np.array([0.7, 0.3, 0.2]), Observed(matrix, value, rng.uniform(0.01, 0.2, STEPS), shock)


class Dense(NamedTuple):
    log_likelihood: float
    mean: np.ndarray
    covariance: np.ndarray  # (step, state, step, state)


def transition(dynamics, intensity, seen, k):
    """F and Q of the interval before step k, from the definition of a noise on a level or on a speed."""
    dt = seen.interval[k]
    F, Q = np.eye(STATES), np.diag(seen.shock[k])
    level_of = {speed: level for level, speed in dynamics.speeds}
    for speed, level in level_of.items():
        F[level, speed] = dt
    for state, q in zip(dynamics.noisy, intensity, strict=True):
        if state in level_of:
            pair = np.ix_([level_of[state], state], [level_of[state], state])
            Q[pair] += q**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        else:
            Q[state, state] += q**2 * dt
    return F, Q


def dense(dynamics, intensity, seen):
    """All states of all steps at once."""
    mean, m, P = np.empty((STEPS, STATES)), dynamics.start, dynamics.start_covariance
    X = np.zeros((STEPS, STATES, STEPS, STATES))
    moves = [transition(dynamics, intensity, seen, k) for k in range(STEPS)]
    for k, (F, Q) in enumerate(moves):
        m, P = F @ m, F @ P @ F.T + Q
        mean[k], X[k, :, k] = m, P
        between = P
        for j in range(k + 1, STEPS):
            between = moves[j][0] @ between
            X[j, :, k], X[k, :, j] = between, between.T
    rows, columns = STEPS * SEEN, STEPS * STATES
    A = np.zeros((STEPS, SEEN, STEPS, STATES))
    A[np.arange(STEPS), :, np.arange(STEPS)] = seen.matrix
    A, X = A.reshape(rows, columns), X.reshape(columns, columns)
    S = A @ X @ A.T + np.eye(rows)
    v = seen.value.ravel() - A @ mean.ravel()
    gain = np.linalg.solve(S, A @ X).T
    return Dense(
        -0.5 * v @ np.linalg.solve(S, v) - 0.5 * np.linalg.slogdet(S)[1],
        (mean.ravel() + gain @ v).reshape(STEPS, STATES),
        (X - gain @ A @ X).reshape(STEPS, STATES, STEPS, STATES),
    )


def passes(dynamics, intensity, seen, **options) -> tuple[Filtered, Smoothed]:
    filtered = filter_states(dynamics, intensity, seen)
    return filtered, smooth_states(dynamics, intensity, seen, filtered, **options)


@pytest.mark.parametrize("seed", range(3))
def test_likelihood_mean_and_covariance_are_those_of_the_joint_distribution(seed):
    filtered, smoothed = passes(*example(seed))
    joint = dense(*example(seed))
    each = np.arange(STEPS)
    assert filtered.log_likelihood == pytest.approx(joint.log_likelihood, abs=1e-9)
    assert smoothed.mean == pytest.approx(joint.mean, abs=1e-9)
    assert smoothed.covariance == pytest.approx(joint.covariance[each, :, each], abs=1e-9)


def test_the_prediction_of_a_step_knows_the_steps_before_it_alone():
    dynamics, intensity, seen = example()
    filtered = filter_states(dynamics, intensity, seen)
    blind = seen._replace(matrix=seen.matrix.copy(), value=seen.value.copy())
    blind.matrix[17:], blind.value[17:] = 0.0, 0.0
    joint = dense(dynamics, intensity, blind)
    assert filtered.mean[17] == pytest.approx(joint.mean[17], abs=1e-9)
    assert filtered.covariance[17] == pytest.approx(joint.covariance[17, :, 17], abs=1e-9)


def test_means_and_score_do_not_depend_on_whether_covariances_are_asked_for():
    _, full = passes(*example())
    _, short = passes(*example(), covariance=False)
    assert short.covariance.shape == (0, STATES, STATES)
    assert np.array_equal(full.mean, short.mean)
    assert np.array_equal(full.score, short.score)


@pytest.mark.parametrize("noise", range(3))
def test_the_score_is_the_slope_of_the_likelihood(noise):
    dynamics, intensity, seen = example()
    _, smoothed = passes(dynamics, intensity, seen)
    step = np.zeros(3)
    step[noise] = 1e-5
    up, down = (filter_states(dynamics, intensity * np.exp(s), seen).log_likelihood for s in (step, -step))
    assert smoothed.score[noise] == pytest.approx((up - down) / 2e-5, rel=1e-6)


def test_the_bayes_factor_of_a_shock_is_that_of_a_rerun_with_it():
    dynamics, intensity, seen = example()
    filtered, smoothed = passes(dynamics, intensity, seen)
    variance = np.array([0.1, 0.0, 0.2, 0.0, 0.0])
    factor = shock_evidence(smoothed, variance)
    for k in range(STEPS):
        shock = seen.shock.copy()
        shock[k] += variance
        rerun = filter_states(dynamics, intensity, seen._replace(shock=shock))
        assert factor[k] == pytest.approx(rerun.log_likelihood - filtered.log_likelihood, abs=1e-8)


def test_a_row_of_zeros_tells_the_likelihood_its_square_and_the_states_nothing():
    dynamics, intensity, seen = example()
    before, smooth = passes(dynamics, intensity, seen)
    value = seen.value.copy()
    value[5, 0] = 3.0
    after, again = passes(dynamics, intensity, seen._replace(value=value))
    assert before.log_likelihood - after.log_likelihood == pytest.approx(4.5)
    assert np.array_equal(smooth.mean, again.mean)


def test_observations_of_a_step_may_be_turned():
    """Their noise is white, so that an orthogonal matrix changes nothing."""
    dynamics, intensity, seen = example()
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(SEEN, SEEN)))[0]
    turned = seen._replace(matrix=turn @ seen.matrix, value=seen.value @ turn.T)
    (filtered, smoothed), (filtered_too, smoothed_too) = (
        passes(dynamics, intensity, seen),
        passes(dynamics, intensity, turned),
    )
    assert filtered_too.log_likelihood == pytest.approx(filtered.log_likelihood, abs=1e-9)
    assert smoothed_too.mean == pytest.approx(smoothed.mean, abs=1e-9)
    assert np.allclose(smoothed_too.N, smoothed.N, rtol=1e-9, atol=1e-9)


def test_a_step_in_between_without_an_observation_changes_nothing():
    """The noise of an interval is that of its two halves."""
    dynamics, intensity, seen = example()
    at = 13
    halves = np.insert(seen.interval, at, seen.interval[at] / 2)
    halves[at + 1] /= 2
    split = Observed(
        np.insert(seen.matrix, at, 0.0, axis=0),
        np.insert(seen.value, at, 0.0, axis=0),
        halves,
        np.insert(seen.shock, at, 0.0, axis=0),
    )
    filtered, smoothed = passes(dynamics, intensity, seen)
    filtered_too, smoothed_too = passes(dynamics, intensity, split)
    assert filtered_too.log_likelihood == pytest.approx(filtered.log_likelihood, abs=1e-9)
    assert np.delete(smoothed_too.covariance, at, axis=0) == pytest.approx(smoothed.covariance, abs=1e-9)
    assert smoothed_too.score == pytest.approx(smoothed.score, abs=1e-9)


def test_the_penalty_of_a_motion_is_its_density_before_anything_is_seen():
    """Against the same density by its joint covariance; a known state moves nowhere."""
    dynamics, intensity, seen = example()
    nothing = seen._replace(matrix=np.zeros_like(seen.matrix), value=np.zeros_like(seen.value))
    prior = dense(dynamics, intensity, nothing)
    trajectory = passes(dynamics, intensity, seen)[1].mean
    away = (trajectory - prior.mean).ravel()
    X = prior.covariance.reshape(STEPS * STATES, STEPS * STATES)
    moving = np.linalg.lstsq(X, away, rcond=1e-12)[0]
    assert X @ moving == pytest.approx(away, abs=1e-7)
    assert motion_penalty(dynamics, intensity, seen, trajectory) == pytest.approx(away @ moving, rel=1e-6)


def test_no_trajectory_costs_less_than_the_smoothed_one():
    dynamics, intensity, seen = example()
    best = passes(dynamics, intensity, seen)[1].mean

    def cost(state):
        residual = seen.value - np.einsum("kon,kn->ko", seen.matrix, state)
        return np.sum(residual**2) + motion_penalty(dynamics, intensity, seen, state)

    rng = np.random.default_rng(5)
    for _ in range(20):
        value = seen.value + rng.normal(size=seen.value.shape)
        value[5], value[11, 1] = 0.0, 0.0
        other = passes(dynamics, intensity, seen._replace(value=value))[1].mean  # moves as it may
        assert cost(best + 0.01 * (other - best)) > cost(best)
        assert cost(best - 0.01 * (other - best)) > cost(best)
