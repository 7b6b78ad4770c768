"""Laws of the space of a linear law, and of what it does not show."""

import numpy as np
import pytest

from millcal.numerics.linear_constraint import column_space, unobservable


def law(seed=0, *, rows=10, columns=4, kind="real"):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(rows, columns))
    return M + 1j * rng.normal(size=(rows, columns)) if kind == "complex" else M


@pytest.mark.parametrize("kind", ["real", "complex"])
def test_basis_and_complement_are_one_orthonormal_frame_and_the_complement_sees_no_column(kind):
    M = law(kind=kind)
    space = column_space(M)
    frame = np.hstack([space.basis, space.complement])
    assert space.rank == 4
    np.testing.assert_allclose(frame.conj().T @ frame, np.eye(10), atol=1e-14)
    assert np.abs(space.complement.conj().T @ M).max() < 1e-14
    np.testing.assert_allclose(space.basis @ (space.basis.conj().T @ M), M, atol=1e-14)
    assert unobservable(space) == []


def test_units_of_the_columns_change_neither_rank_nor_space():
    M = law()
    space, other = column_space(M), column_space(M * [1.0, 1e-4, 1e3, 1e-6])
    np.testing.assert_allclose(other.basis @ other.basis.T, space.basis @ space.basis.T, atol=1e-12)
    assert other.condition == pytest.approx(space.condition)


def test_a_column_of_rounding_is_no_direction():
    M = law()
    M[:, 2] = 1e-17 * law(1)[:, 0]
    space = column_space(M)
    assert space.rank == 3
    assert unobservable(space) == [(2,)]
    np.testing.assert_array_equal(space.null, np.eye(4)[:, [2]])
    assert column_space(M / np.linalg.norm(M, axis=0)).rank == 4  # what scaling first would say


def test_parameters_that_only_their_sums_show_are_named_together():
    M = law(columns=6) * [1.0, 1e-4, 1.0, 1.0, 1.0, 1.0]
    M[:, 3] = 2e4 * M[:, 1]
    M[:, 4] = 0.0
    M[:, 5] = M[:, 0] - M[:, 2]
    space = column_space(M)
    assert space.rank == 3
    assert unobservable(space) == [(0, 2, 5), (1, 3), (4,)]
    assert space.null.shape == (6, 3)
    assert np.abs(M @ space.null).max() < 1e-13
    seen = column_space(M[:, [0, 1, 3, 4]])
    assert unobservable(seen) == [(1, 2), (3,)]


def test_a_law_of_nothing_shows_nothing():
    space = column_space(np.zeros((4, 2)))
    assert space.rank == 0
    assert space.complement.shape == (4, 4)
    assert unobservable(space) == [(0,), (1,)]
