"""Cuts that are short against the wave of the tool, and edges that wind to the left."""

import numpy as np
import pytest

from millcal.physics.stability import floquet, from_frf
from millcal.physics.stability.regeneration import Regeneration, tip_of_shapes
from millcal.physics.stability.stable_depths import edge_table, edges_of

SHORT = np.arccos(1 - 2 * 0.01)  # rad in cut


def edges(crossings, speeds):
    return edge_table(edges_of(crossings, complete=True), speeds)


@pytest.mark.parametrize(("teeth", "damping"), [(2, 0.01), (4, 0.01), (6, 0.03), (8, 0.01), (8, 0.06)])
def test_going_round_the_circle_misses_no_limit_where_hardly_anything_is_cut(teeth, damping):
    speed = np.linspace(3000, 36000, 24) * np.pi / 30
    tip = tip_of_shapes([360.0], [damping], [[2 * np.pi * 360 / 2e3, 0.0]])
    cut = Regeneration(teeth, np.pi - SHORT, np.pi, 7e8, 2e8)
    by_columns = edges(floquet.boundary(speed, tip, cut, deepest=0.06), 24)
    round_the_circle = edges(floquet.all_crossings(speed, tip, cut, deepest=0.06), 24)
    np.testing.assert_allclose(round_the_circle, by_columns, rtol=1e-4)


def test_a_receptance_limits_a_cut_of_hardly_anything_too():
    speed, frequency = np.array([23087.0, 28826.0]) * np.pi / 30, np.arange(1.0, 4000.0)
    tip = tip_of_shapes([360.0], [0.01], [[2 * np.pi * 360 / 2e3, 0.0]])
    cut = Regeneration(6, np.pi - SHORT, np.pi, 7e8, 2e8)
    measured = from_frf.crossings_of_receptance(speed, frequency, tip.receptance(frequency), cut, deepest=0.06)
    modal = floquet.boundary(speed, tip, cut, deepest=0.06)
    np.testing.assert_allclose(edges(measured, 2)[:, 0], edges(modal, 2)[:, 0], rtol=1e-2)


@pytest.mark.parametrize("pitch", [None, tuple(np.radians([85.0, 95.0, 85.0, 95.0]))])
@pytest.mark.parametrize("leave", [0.3, 1.0, np.pi])
def test_an_edge_that_winds_to_the_left_is_as_stable_as_one_that_winds_to_the_right(pitch, leave):
    tip = tip_of_shapes([922.0, 700.0], [0.011, 0.03], [[5.0, 0.0], [0.0, 4.0]])
    speed, depth = np.full(3, 1200.0), np.array([5e-4, 2e-3, 2e-2])
    right, left = (
        floquet.spectral_radius(speed, depth, tip, Regeneration(4, 0.0, leave, 6e8, 2e8, pitch, wind))
        for wind in (90.0, -90.0)
    )
    np.testing.assert_allclose(left, right, rtol=1e-6)
