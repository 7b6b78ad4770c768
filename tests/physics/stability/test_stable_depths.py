"""Sets of stable depths: edges from crossings by counting, and shares of draws by looking at each draw."""

import numpy as np
import pytest

from millcal.physics.stability.regeneration import FLIP, FOLD, HOPF, Crossings
from millcal.physics.stability.stable_depths import edge_table, edges_of, is_stable, stable_share


def crossings(*rows):
    """Rows of speed, depth, kind, whether stability is lost."""
    speed, depth, kind, loses = (np.array(column) for column in zip(*rows, strict=True))
    return Crossings(speed, depth.astype(float), kind, np.full(len(depth), 100.0), loses.astype(bool))


def unstable_by_counting(found, speed, depth):
    total = 0
    for s, b, kind, loses in zip(found.speed, found.depth, found.kind, found.loses, strict=True):
        if s == speed and b <= depth:
            total += (2 if kind == HOPF else 1) * (1 if loses else -1)
    return total > 0


def test_an_island_of_flips_has_two_edges_and_the_hopf_above_it_a_third():
    found = edges_of(crossings((0, 1.0, FLIP, True), (0, 2.0, FLIP, False), (0, 3.0, HOPF, True)), complete=True)
    np.testing.assert_array_equal(found.depth, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(found.loses, [True, False, True])
    table = edge_table(found, 1)
    np.testing.assert_array_equal(is_stable(table, np.array([[0.5], [1.5], [2.5], [3.5]]))[:, 0], [1, 0, 1, 0])


def test_a_multiplier_that_comes_back_while_another_is_outside_is_no_edge():
    found = edges_of(crossings((0, 1.0, FLIP, True), (0, 2.0, HOPF, True), (0, 3.0, FLIP, False)), complete=True)
    np.testing.assert_array_equal(found.depth, [1.0])


def test_a_pair_that_comes_back_as_two_flips_is_back_with_the_second():
    found = edges_of(crossings((0, 1.0, HOPF, True), (0, 2.0, FLIP, False), (0, 3.0, FLIP, False)), complete=True)
    np.testing.assert_array_equal(found.depth, [1.0, 3.0])
    assert not found.loses[1]


@pytest.mark.parametrize("seed", range(20))
def test_edges_tell_what_counting_tells_at_any_depth(seed):
    """Crossings at random, of which no more come back than went out."""
    rng = np.random.default_rng(seed)
    rows = []
    for speed in range(5):
        outside = {HOPF: 0, FLIP: 0, FOLD: 0}
        for depth in np.sort(rng.random(rng.integers(0, 8))):
            kind = int(rng.integers(3))
            loses = outside[kind] == 0 or rng.random() < 0.5
            outside[kind] += 1 if loses else -1
            rows.append((speed, depth, kind, loses))
    rows.append((4, 1.0, HOPF, True))
    found = crossings(*rows)
    order = rng.permutation(len(rows))
    shuffled = Crossings(*(part[order] for part in found))
    table = edge_table(edges_of(shuffled, complete=True), 5)
    for depth in rng.random(30):
        stable = is_stable(table, np.full(5, depth))
        assert [not unstable_by_counting(found, speed, depth) for speed in range(5)] == stable.tolist()


def test_edges_of_a_method_that_tells_edges_alone_are_taken_as_they_are():
    """Kinds differ, and counted the pair would stay outside."""
    found = edges_of(crossings((0, 1.0, HOPF, True), (0, 2.0, FLIP, False), (0, 3.0, FLIP, True)))
    np.testing.assert_array_equal(found.depth, [1.0, 2.0, 3.0])


def test_no_crossings_are_a_stable_column():
    none = Crossings(np.empty(0, int), np.empty(0), np.empty(0, int), np.empty(0), np.empty(0, bool))
    table = edge_table(edges_of(none, complete=True), 3)
    assert table.shape == (3, 1)
    assert is_stable(table, np.full(3, 1e9)).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_share_of_draws_is_that_of_asking_each_draw(seed):
    rng = np.random.default_rng(seed)
    table = np.sort(rng.random((50, 4, 3)), axis=2)
    table[rng.random(table.shape) < 0.3] = np.inf
    table = np.sort(table, axis=2)
    depth = np.unique(np.append(rng.random(17), table[0, 0, 0] if np.isfinite(table[0, 0, 0]) else 0.5))
    share = stable_share(table, depth)
    for i, b in enumerate(depth):
        np.testing.assert_allclose(share[i], is_stable(table, np.full((50, 4), b)).mean(axis=0), atol=1e-12)
