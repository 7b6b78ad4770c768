"""Limits of cuts near to a known one, against their own columns."""

import numpy as np
import pytest

from millcal.physics.stability.floquet import boundary
from millcal.physics.stability.moved_limits import moved_limits
from millcal.physics.stability.regeneration import Regeneration, tip_of_modes
from millcal.physics.stability.stable_depths import edge_table, edges_of
from millcal.physics.structure import Mode

RPM = 2 * np.pi / 60
SPEED = np.array([4300.0, 6100.0, 8700.0]) * RPM


def machine(rng=None):
    """Three modes, the last a local one that hardly counts and dies out slowly; with `rng` all of them a few percent off."""
    off = np.ones((3, 3)) if rng is None else np.exp(0.01 * rng.standard_normal((3, 3)) * [0.3, 3.0, 3.0])
    known = [(922.0, 0.02, 1.34e6, "x"), (1100.0, 0.03, 2.0e6, "y"), (1900.0, 0.004, 8e8, "y")]
    return tip_of_modes(
        [Mode(f * a, z * b, k * c, axis) for (f, z, k, axis), (a, b, c) in zip(known, off, strict=True)]
    )


def limits(tip, cut):
    found = boundary(SPEED, tip, cut, deepest=8e-3, heard=False)
    return edge_table(edges_of(found, complete=True), len(SPEED))[:, 0]


@pytest.mark.parametrize("wind", [0.0, np.tan(0.5) / 8e-3])
def test_limits_of_cuts_near_by_are_those_of_their_own_columns(wind):
    cut = Regeneration(2, 0.0, 1.5, 600e6, 200e6, wind=wind)
    known = limits(machine(), cut)
    rng = np.random.default_rng(3)
    others = [(machine(rng), cut.with_force(600e6 * s, 200e6 * s)) for s in np.exp(0.03 * rng.standard_normal(6))]
    exact = np.array([limits(*other) for other in others])
    assert np.ptp(np.log(exact), axis=0).min() > 0.03  # so far do they differ
    np.testing.assert_allclose(moved_limits(SPEED, known, machine(), cut, others), exact, rtol=2e-3)


def test_where_there_is_no_limit_there_stays_none():
    cut = Regeneration(2, 0.0, 1.5, 600e6, 200e6)
    known = np.append(limits(machine(), cut)[:2], np.inf)
    found = moved_limits(SPEED, known, machine(), cut, [(machine(), cut)])
    np.testing.assert_allclose(found[0], known, rtol=1e-6)
