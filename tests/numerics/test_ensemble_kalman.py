"""The ensemble filters against the Kalman filter, against their other form, and against their own laws."""

import numpy as np
import pytest

from millcal.numerics import ensemble_kalman as ek

H = np.array([[1.0, -0.5, 0.2], [0.3, 2.0, 0.0]])
NOISE = np.array([[0.4, 0.1], [0.1, 0.3]])
PRIOR = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, -0.2], [0.1, -0.2, 0.7]])
SEEN = np.array([1.3, -0.8])


def linear(members):
    return members @ H.T


def curved(members):
    return np.stack([np.exp(0.3 * members[:, 0]) + members[:, 1], np.sin(members[:, 2]) * members[:, 1]], axis=1)


def kalman(mean, P, y=SEEN, H=H, R=NOISE):
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return mean + K @ (y - H @ mean), P - K @ H @ P


def ensemble(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.array([1.0, -1.0, 0.5]) + rng.standard_normal((count, 3)) @ np.linalg.cholesky(PRIOR).T


def moments(members):
    return members.mean(axis=0), np.cov(members.T, bias=True)


@pytest.mark.parametrize("count", [4, 10, 200])
def test_the_square_root_is_the_kalman_filter_of_its_own_moments(count):
    members = ensemble(count)
    state, info = ek.step(
        ek.start(members), SEEN, observe=linear, noise=NOISE, rng=np.random.default_rng(0), update="square-root"
    )
    mean, P = kalman(*moments(members))
    assert moments(state.members)[0] == pytest.approx(mean, rel=1e-12)
    assert moments(state.members)[1] == pytest.approx(P, rel=1e-10, abs=1e-13)
    assert info.innovation == pytest.approx(SEEN - H @ members.mean(axis=0))
    assert info.innovation_covariance == pytest.approx(H @ moments(members)[1] @ H.T + NOISE)
    assert info.spread == pytest.approx(np.sqrt(np.diag(P)))


@pytest.mark.parametrize("update", ek.UPDATES)
def test_many_members_become_the_kalman_filter_at_the_monte_carlo_rate(update):
    """The error falls as 1 / sqrt(members): a hundred times the members, a tenth of the error."""
    mean, P = kalman(np.array([1.0, -1.0, 0.5]), PRIOR)
    error = {}
    for count in (400, 40_000):
        misses = []
        for seed in range(20):
            rng = np.random.default_rng(100 + seed)
            state, _ = ek.step(
                ek.start(ensemble(count, seed)), SEEN, observe=linear, noise=NOISE, rng=rng, update=update
            )
            got = moments(state.members)
            misses.append(np.concatenate([got[0] - mean, (got[1] - P).ravel()]))
        error[count] = np.sqrt(np.mean(np.square(misses)))
    assert error[40_000] < 0.01
    assert error[400] / error[40_000] == pytest.approx(10, rel=0.35)


def test_the_augmented_form_moves_the_members_alike():
    """[Y; X] with H = [I 0], the Kalman gain of the joint covariance, the same perturbations."""
    members, Y = ensemble(30), curved(ensemble(30))
    moved = ek.perturbed(members, Y, SEEN, NOISE, np.random.default_rng(5))
    E = np.random.default_rng(5).standard_normal((30, 2)) @ np.linalg.cholesky(NOISE).T
    Z = np.hstack([Y, members])
    P = np.cov(Z.T, bias=True)
    select = np.eye(2, 5)
    G = P @ select.T @ np.linalg.inv(select @ P @ select.T + E.T @ E / 30)
    augmented = Z + (SEEN + E - Z @ select.T) @ G.T
    assert moved == pytest.approx(augmented[:, 2:], rel=1e-11)


def test_independent_observations_may_come_in_any_order():
    noise = np.diag([0.4, 0.3])
    both, _ = ek.step(
        ek.start(ensemble(12)), SEEN, observe=linear, noise=noise, rng=np.random.default_rng(0), update="square-root"
    )
    for order in ([0, 1], [1, 0]):
        state = ek.start(ensemble(12))
        for i in order:
            state, _ = ek.step(
                state,
                SEEN[[i]],
                observe=lambda members, i=i: members @ H[[i]].T,
                noise=noise[[i]][:, [i]],
                rng=np.random.default_rng(0),
                update="square-root",
            )
        assert moments(state.members)[0] == pytest.approx(moments(both.members)[0], rel=1e-11)
        assert moments(state.members)[1] == pytest.approx(moments(both.members)[1], rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("update", ek.UPDATES)
def test_an_ensemble_never_leaves_its_subspace(update):
    """Three members span a plane in three dimensions; no observation takes them out of it, an inflation does."""
    members = ensemble(3)
    normal = np.cross(members[1] - members[0], members[2] - members[0])
    state = ek.start(members)
    rng = np.random.default_rng(1)
    for _ in range(5):
        state, _ = ek.step(state, SEEN, observe=curved, noise=NOISE, rng=rng, update=update)
    assert (state.members - members[0]) @ normal == pytest.approx(np.zeros(3), abs=1e-10)
    inflated = ek.inflate(state.members, PRIOR, count=1, fraction=0.5, rng=rng)
    assert np.abs((inflated - members[0]) @ normal).max() > 1e-3


@pytest.mark.parametrize("update", ek.UPDATES)
def test_units_of_states_and_observations_do_not_matter(update):
    """Metres beside logarithms: scaled states and observations give the scaled ensemble."""
    scale, force = np.array([1e-6, 1.0, 1e9]), np.array([1e3, 1e-2])
    plain, _ = ek.step(
        ek.start(ensemble(8)), SEEN, observe=linear, noise=NOISE, rng=np.random.default_rng(3), update=update
    )
    scaled, _ = ek.step(
        ek.start(ensemble(8) * scale),
        SEEN * force,
        observe=lambda members: linear(members / scale) * force,
        noise=NOISE * np.outer(force, force),
        rng=np.random.default_rng(3),
        update=update,
    )
    assert scaled.members / scale == pytest.approx(plain.members, rel=1e-9)


def test_the_walk_adds_its_variance_and_nothing_else():
    members = ensemble(100_000)
    walked = ek.random_walk(members, np.array([0.5, 0.0, 2.0]), np.random.default_rng(1))
    assert np.array_equal(walked[:, 1], members[:, 1])
    assert moments(walked)[1] == pytest.approx(PRIOR + np.diag([0.25, 0, 4.0]), abs=0.05)


def test_inflation_draws_a_few_members_anew_about_the_mean():
    members = 5.0 + 1e-3 * ensemble(50_000)
    inflated = ek.inflate(members, PRIOR, count=10_000, fraction=0.1, rng=np.random.default_rng(2))
    is_new = np.any(inflated != members, axis=1)
    assert is_new.sum() == 10_000
    new = inflated[is_new] - members.mean(axis=0)
    assert new.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.02)
    assert new.T @ new / len(new) == pytest.approx(PRIOR / 10, abs=0.01)


def test_inflation_goes_by_the_start_and_by_the_count_of_updates():
    state = ek.start(ensemble(20))
    rng = np.random.default_rng(4)
    for k in range(1, 7):
        before = state.members
        state, _ = ek.step(
            state,
            SEEN,
            observe=linear,
            noise=NOISE,
            rng=rng,
            update="square-root",
            inflation=ek.Inflation(every=3, subset=20, fraction=1.0),
        )
        grown = np.trace(moments(state.members)[1]) > np.trace(moments(before)[1])
        assert grown == (k % 3 == 0)
    assert np.array_equal(state.covariance0, ek.start(ensemble(20)).covariance0)


def test_further_states_take_the_mean_where_a_member_is_drawn_anew():
    members = np.hstack([ensemble(10), np.arange(10.0)[:, np.newaxis]])
    inflated = ek.inflate(members, PRIOR, count=4, fraction=0.1, rng=np.random.default_rng(0))
    assert np.sum(inflated[:, 3] == 4.5) == 4


def test_the_draws_come_in_the_order_that_is_written_down():
    members = ensemble(6)
    options = {"observe": linear, "noise": NOISE, "walk": np.full(3, 0.1), "inflation": ek.Inflation(1, 2, 0.1)}
    state, _ = ek.step(ek.start(members), SEEN, rng=np.random.default_rng(9), **options)
    rng = np.random.default_rng(9)
    X = members + 0.1 * rng.standard_normal((6, 3))
    E = rng.standard_normal((6, 2)) @ np.linalg.cholesky(NOISE).T
    C = (X - X.mean(0)).T @ (linear(X) - linear(X).mean(0)) / 6
    D = np.cov(linear(X).T, bias=True)
    X = X + (SEEN + E - linear(X)) @ (C @ np.linalg.inv(D + E.T @ E / 6)).T
    chosen = rng.permutation(6)[:2]
    X[chosen] = (
        X.mean(0) + np.sqrt(0.1) * rng.standard_normal((2, 3)) @ np.linalg.cholesky(np.cov(members.T, bias=True)).T
    )
    assert state.members == pytest.approx(X, rel=1e-11)


def test_projection_is_the_nearest_point_and_does_nothing_twice():
    rng = np.random.default_rng(6)
    members = 3 * rng.standard_normal((500, 4))
    limits = np.array([[-1.0, 2.0], [-np.inf, np.inf], [-2.0, 2.0], [-2.0, 2.0]])
    once = ek.project(members, limits, [(2, 1.5)])
    assert ek.project(once, limits, [(2, 1.5)]) == pytest.approx(once, rel=1e-15)
    assert np.array_equal(once[:, 1], members[:, 1])
    assert np.ptp(once[:, 0]) == 3.0
    assert np.hypot(once[:, 2], once[:, 3]).max() == pytest.approx(1.5)
    inside = (np.hypot(members[:, 2], members[:, 3]) <= 1.5) & (np.abs(members[:, 0] - 0.5) <= 1.5)
    assert np.array_equal(once[inside], members[inside])
    share = ek.at_bound(once, limits, [(2, 1.5)])
    outside = [np.mean(np.abs(members[:, 0] - 0.5) >= 1.5), 0.0, np.mean(np.hypot(*members[:, 2:].T) >= 1.5)]
    assert share == pytest.approx([*outside, outside[2]])


def test_a_known_state_has_no_column_in_the_root():
    P = np.diag([4.0, 0.0, 9.0])
    P[0, 2] = P[2, 0] = 3.0
    L = ek.semidefinite_root(P)
    assert np.linalg.norm(L @ L.T - P) < 1e-14
    assert not L[:, 1].any()
    assert ek.semidefinite_root(PRIOR) == pytest.approx(np.linalg.cholesky(PRIOR), rel=1e-14)


def test_a_sample_too_late_is_seen_in_the_error():
    """Predictions of the instant before, against an observation of now: the error of a swinging signal grows many times."""
    t = np.arange(400)
    row = np.stack([np.sin(0.3 * t), np.cos(0.3 * t)], axis=1)
    truth = np.array([2.0, -1.0])
    rng = np.random.default_rng(0)
    y = row @ truth + 0.1 * rng.standard_normal(400)
    error = []
    for lag in (0, 1):
        state = ek.start(rng.standard_normal((40, 2)))
        for k in range(1, 400):
            H = row[[k - lag]]
            state, _ = ek.step(
                state, y[[k]], observe=lambda members, H=H: members @ H.T, noise=np.array([[0.01]]), rng=rng
            )
        error.append(np.linalg.norm(state.members.mean(axis=0) - truth))
    assert error[0] < 0.05
    assert error[1] > 10 * error[0]
