"""Laws of least squares and its relatives: limits, optimality, constraints, scaling."""

import numpy as np
import pytest
from scipy.optimize import minimize

from millcal.errors import IllPosedError
from millcal.numerics.linear_inverse import (
    SOLVERS,
    as_complex_vector,
    as_real,
    as_real_vector,
    condition_number,
    constrained_least_squares,
    constrained_total_least_squares,
    in_ball,
    least_squares,
    null_basis,
    tikhonov,
    total_least_squares,
)

KINDS = ("real", "complex")


def drawn(rng, kind, *shape):
    values = rng.normal(size=shape)
    return values + 1j * rng.normal(size=shape) if kind == "complex" else values


def system(seed, kind, *, rows=9, columns=4, noise=0.1):
    """A, b, x with b = A x + noise, and a constraint of two rows that x does not fulfil."""
    rng = np.random.default_rng(seed)
    A, x = drawn(rng, kind, rows, columns), drawn(rng, kind, columns)
    return A, A @ x + noise * drawn(rng, kind, rows), x, drawn(rng, kind, 2, columns)


def tls_objective(A, b, x, matrix_noise=1.0, data_noise=1.0):
    return np.linalg.norm(A @ x - b) ** 2 / (matrix_noise**2 * np.linalg.norm(x) ** 2 + data_noise**2)


def flat(x):
    return as_real_vector(x) if np.iscomplexobj(x) else x


def shaped(v, like):
    return as_complex_vector(v) if np.iscomplexobj(like) else v


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SOLVERS)
def test_without_noise_every_solver_recovers_x(name, kind):
    A, b, x, L = system(1, kind, noise=0.0)
    L = L @ (np.eye(4) - np.outer(x, x.conj()) / np.vdot(x, x).real)  # L x = 0
    options = {"tikhonov": {"regularization": 1e-9}, "constrained-ls": {"constraint": L}, "rtls": {"constraint": L}}
    np.testing.assert_allclose(SOLVERS[name](A, b, **options.get(name, {})), x, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("noises", [(1.0, 1.0), (0.3, 2.0), (5.0, 0.1)])
def test_total_least_squares_is_the_minimum_of_its_objective(kind, noises):
    A, b, _, _ = system(2, kind, noise=1.0)
    x = total_least_squares(A, b, matrix_noise=noises[0], data_noise=noises[1])
    found = minimize(lambda v: tls_objective(A, b, shaped(v, A), *noises), flat(least_squares(A, b)), tol=1e-12)
    np.testing.assert_allclose(flat(x), found.x, atol=1e-4)
    assert tls_objective(A, b, x, *noises) <= found.fun * (1 + 1e-12)


def test_total_least_squares_becomes_least_squares_as_the_matrix_grows_exact():
    A, b, _, _ = system(3, "complex", noise=0.5)
    gap = [np.linalg.norm(total_least_squares(A, b, matrix_noise=s) - least_squares(A, b)) for s in (0.1, 0.01, 0.001)]
    assert gap[0] > 50 * gap[1] > 2500 * gap[2] > 0  # second order in the noise of the matrix
    np.testing.assert_array_equal(total_least_squares(A, b, matrix_noise=0.0), least_squares(A, b))


def test_another_unit_of_x_changes_total_least_squares_unless_the_noise_of_the_matrix_is_in_that_unit_too():
    A, b, _, _ = system(4, "complex", noise=0.5)
    x = total_least_squares(A, b, matrix_noise=0.2, data_noise=0.5)
    np.testing.assert_allclose(total_least_squares(1e3 * A, b, matrix_noise=200.0, data_noise=0.5) * 1e3, x, rtol=1e-10)
    naive = total_least_squares(1e3 * A, b) * 1e3
    assert np.linalg.norm(naive - total_least_squares(A, b)) > 1e-2


def test_only_the_ratio_of_the_noises_matters():
    A, b, _, _ = system(5, "real", noise=0.5)
    np.testing.assert_allclose(
        total_least_squares(A, b, matrix_noise=0.3, data_noise=0.7),
        total_least_squares(A, b, matrix_noise=3.0, data_noise=7.0),
        rtol=1e-12,
    )


def test_a_direction_that_only_the_noise_of_the_data_shows_has_no_total_least_squares():
    """The textbook's non-generic case: the smallest singular vector of [A b] has nothing of b."""
    A = np.array([[1.0, 0.0], [0.0, 1e-3], [0.0, 0.0]])
    b = np.array([1.0, 0.0, 1.0])
    with pytest.raises(IllPosedError, match="no finite solution"):
        total_least_squares(A, b)


def test_with_fewer_rows_than_unknowns_total_least_squares_is_the_shortest_exact_solution():
    A, b, _, _ = system(6, "complex", rows=3)
    np.testing.assert_allclose(total_least_squares(A, b), least_squares(A, b), rtol=1e-10)


def test_tikhonov_goes_from_least_squares_to_nothing():
    A, b, _, _ = system(7, "complex", noise=0.5)
    sizes = [np.linalg.norm(tikhonov(A, b, regularization=w)) for w in (0.0, 0.1, 1.0, 10.0, 1e6)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 1e-10
    normal = np.linalg.solve(A.conj().T @ A + 0.49 * np.eye(4), A.conj().T @ b)
    np.testing.assert_allclose(tikhonov(A, b, regularization=0.7), normal, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("solve", [constrained_least_squares, constrained_total_least_squares])
def test_the_constraint_holds_to_rounding_and_needs_no_independent_rows(solve, kind):
    A, b, _, L = system(8, kind, noise=0.5)
    x = solve(A, b, L)
    assert np.linalg.norm(L @ x) < 1e-12 * np.linalg.norm(x)
    np.testing.assert_allclose(solve(A, b, np.vstack([L, 1e4 * L[0] + L[1]])), x, rtol=1e-9)


def test_a_constraint_of_no_rows_binds_nothing():
    A, b, _, _ = system(9, "real", noise=0.5)
    none = np.zeros((0, 4))
    np.testing.assert_allclose(constrained_least_squares(A, b, none), least_squares(A, b), rtol=1e-12)
    np.testing.assert_allclose(constrained_total_least_squares(A, b, none), total_least_squares(A, b), rtol=1e-12)


def test_a_constraint_of_full_rank_leaves_nothing():
    A, b, _, _ = system(10, "real")
    np.testing.assert_array_equal(constrained_least_squares(A, b, np.eye(4)), np.zeros(4))
    np.testing.assert_array_equal(constrained_total_least_squares(A, b, np.eye(4)), np.zeros(4))


def test_constrained_least_squares_solves_the_equations_of_lagrange():
    A, b, _, L = system(11, "complex", noise=0.5)
    bordered = np.block([[A.conj().T @ A, L.conj().T], [L, np.zeros((2, 2))]])
    expected = np.linalg.solve(bordered, np.concatenate([A.conj().T @ b, np.zeros(2)]))[:4]
    np.testing.assert_allclose(constrained_least_squares(A, b, L), expected, rtol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_slack_goes_from_the_constrained_to_the_free_solution(kind):
    A, b, _, L = system(12, kind, noise=0.5)
    free, bound = total_least_squares(A, b), constrained_total_least_squares(A, b, L)
    enough = np.linalg.norm(L @ free)
    values = []
    for share in (1e-6, 1e-3, 0.1, 0.5, 0.99):
        x = constrained_total_least_squares(A, b, L, slack=share * enough)
        np.testing.assert_allclose(np.linalg.norm(L @ x), share * enough, rtol=1e-9)
        values.append(tls_objective(A, b, x))
    assert tls_objective(A, b, bound) > values[0]
    assert values == sorted(values, reverse=True)
    np.testing.assert_allclose(constrained_total_least_squares(A, b, L, slack=1e-6 * enough), bound, atol=1e-4)
    np.testing.assert_allclose(constrained_total_least_squares(A, b, L, slack=1.01 * enough), free, rtol=1e-7)


@pytest.mark.parametrize("seed", range(24))
def test_no_optimiser_finds_a_better_x_within_the_slack(seed):
    """Random shapes, scales and slacks against sequential quadratic programming from several starts."""
    rng = np.random.default_rng([71, seed])
    kind = KINDS[seed % 2]
    columns = int(rng.integers(2, 6))
    rows, bound = columns + int(rng.integers(0, 5)), int(rng.integers(1, columns + 1))
    A = drawn(rng, kind, rows, columns) * 10 ** rng.uniform(-1, 0, columns)
    b = A @ drawn(rng, kind, columns) + drawn(rng, kind, rows) * 10 ** rng.uniform(-2, 0.5)
    L, slack, noise = drawn(rng, kind, bound, columns), 10 ** rng.uniform(-2, 0.5), 10 ** rng.uniform(-2, 0)
    x = constrained_total_least_squares(A, b, L, slack=slack, matrix_noise=noise)
    assert np.linalg.norm(L @ x) <= slack * (1 + 1e-9)
    best = tls_objective(A, b, x, noise)

    def room(v):
        return 1 - np.linalg.norm(L @ shaped(v, A)) ** 2 / slack**2

    for start in (flat(x) * 1.1, rng.normal(size=len(flat(x))) * np.linalg.norm(x)):
        with np.errstate(all="ignore"):
            found = minimize(
                lambda v: tls_objective(A, b, shaped(v, A), noise),
                start,
                method="SLSQP",
                constraints={"type": "ineq", "fun": room},
                options={"ftol": 1e-13, "maxiter": 200},
            )
        if room(found.x) > -1e-9:
            assert found.fun >= best * (1 - 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_with_slack_the_conditions_of_the_global_minimum_hold(kind):
    """The equation of Golub, Hansen and O'Leary with mu >= 0, and a matrix in it that is not negative: nothing is lower."""
    rng = np.random.default_rng(13)
    bound = 0
    for _ in range(150):
        columns = int(rng.integers(1, 8))
        A = drawn(rng, kind, columns + int(rng.integers(0, 8)), columns) * 10 ** rng.uniform(-2, 0, columns)
        b, L = 10 ** rng.uniform(-3, 1) * drawn(rng, kind, len(A)), drawn(rng, kind, int(rng.integers(1, 9)), columns)
        slack, s, t = 10 ** rng.uniform(-3, 2), 10 ** rng.uniform(-3, 1), 10 ** rng.uniform(-1, 1)
        x = constrained_total_least_squares(A, b, L, slack=slack, matrix_noise=s, data_noise=t)
        shifted = A.conj().T @ A - tls_objective(A, b, x, s, t) * s**2 * np.eye(columns)
        left, right = A.conj().T @ b - shifted @ x, L.conj().T @ L @ x
        mu = np.vdot(right, left).real / np.vdot(right, right).real
        size = np.linalg.norm(A.conj().T @ b)
        if np.linalg.norm(L @ x) < slack * (1 - 1e-6):
            assert abs(mu) * np.linalg.norm(right) < 1e-7 * size
            mu = 0.0
        else:
            assert np.linalg.norm(L @ x) <= slack * (1 + 1e-9)
            assert mu > 0
            bound += 1
        assert np.linalg.norm(left - mu * right) < 1e-6 * size
        assert np.linalg.eigvalsh(shifted + mu * L.conj().T @ L)[0] > -1e-9 * np.linalg.norm(A) ** 2
    assert 30 < bound < 140  # both cases were there


def test_in_a_ball_the_least_value_is_found_where_the_quadratic_falls_without_end_and_has_two_minima():
    """The hard case: nothing pulls along the direction in which it falls most."""
    S, q = np.diag([-2.0, 1.0, 3.0]), np.array([0.0, 1.0, 1.0])
    u = in_ball(S, q, 2.0)
    assert np.linalg.norm(u) == pytest.approx(2.0)
    rng = np.random.default_rng(3)
    others = rng.normal(size=(20000, 3))
    others *= 2.0 / np.linalg.norm(others, axis=1, keepdims=True)
    value = np.einsum("ni,ij,nj->n", others, S, others) - 2 * others @ q
    assert u @ S @ u - 2 * q @ u <= value.min()


def test_real_and_complex_form_of_a_system_have_the_same_solutions():
    A, b, _, L = system(14, "complex", noise=0.5)
    real = (as_real(A), as_real_vector(b))
    for form, complex_form in [
        (least_squares(*real), least_squares(A, b)),
        (tikhonov(*real, regularization=0.3), tikhonov(A, b, regularization=0.3)),
        (constrained_least_squares(*real, as_real(L)), constrained_least_squares(A, b, L)),
        (total_least_squares(*real), total_least_squares(A, b)),
        (
            constrained_total_least_squares(*real, as_real(L), slack=0.1),
            constrained_total_least_squares(A, b, L, slack=0.1),
        ),
    ]:
        np.testing.assert_allclose(as_complex_vector(form), complex_form, rtol=1e-8)


def test_the_null_basis_is_orthonormal():
    L = system(15, "complex")[3]
    N = null_basis(L)
    assert N.shape == (4, 2)
    np.testing.assert_allclose(N.conj().T @ N, np.eye(2), atol=1e-14)


def test_the_condition_number_is_infinite_where_a_column_adds_nothing():
    assert condition_number(np.diag([1.0, 5.0])) == pytest.approx(5.0)
    assert condition_number(np.array([[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]])) == np.inf
    assert condition_number(np.ones((1, 2))) == np.inf


def test_noise_and_slack_below_zero_are_refused():
    A, b, _, L = system(19, "real")
    with pytest.raises(ValueError, match="data_noise"):
        total_least_squares(A, b, data_noise=0.0)
    with pytest.raises(ValueError, match="slack"):
        constrained_total_least_squares(A, b, L, slack=-1.0)
