"""The force of changing coefficients is, at every instant, that of the law as it then is."""

import numpy as np
import pytest

from millcal.physics.changing_coefficients import Chip, Trend, coefficients_at, force_series
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge, force_harmonics

CUTTER = Cutter(0.012, 2, np.radians(30), runout=8e-6, runout_angle=0.5)
DOWN = CuttingConditions(2 * np.pi * 40, 0.08e-3, 3e-3, 4e-3, "down")
LINEAR = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
KIENZLE = Kienzle(np.array([1700e6, 350e6, 200e6]), np.array([0.18, 0.55, 0.3]))
TIME = np.array([0.0, 1.0, 2.2, 4.0, 4.999, 5.0, 9.0])
WEAR = Trend(
    drift=(((1.0, 1.0), (5.0, 1.2)), ((1.0, 1.0), (5.0, 1.5)), ((0.0, 1.0),)),
    shape=(((1.0, 1.0), (5.0, 1.2)), ((1.0, 1.0), (5.0, 0.8)), ((0.0, 1.0),)),
    chips=(Chip(4.0, (0.12, 0.3, 0.0)),),
)


def test_drift_is_straight_between_its_points_and_a_chip_stays():
    factor = WEAR.specific_factor(TIME)
    assert factor[0] == pytest.approx([1, 1, 1.06, 1.15 * 1.12, 1.19995 * 1.12, 1.2 * 1.12, 1.2 * 1.12])
    assert factor[2] == pytest.approx(np.ones(7))


@pytest.mark.parametrize("law", [LINEAR, KIENZLE])
def test_the_weighted_series_are_the_force_of_the_law_at_each_instant(law):
    """For Kienzle with rises that change by a fifth the interpolation is told to be good to 1e-8."""
    series = force_series(law, WEAR, CUTTER, DOWN, 40, TIME)
    first, last = coefficients_at(law, WEAR, TIME)
    for i in range(len(TIME)):
        now = type(law)(first[:, i], last[:, i])
        expected = force_harmonics(now, CUTTER, DOWN, 40)
        found = np.einsum("s,sak->ak", series.weights[:, i], series.harmonics)
        assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("law", [LINEAR, KIENZLE])
def test_without_any_change_it_is_the_plain_force(law):
    series = force_series(law, Trend(), CUTTER, DOWN, 20, TIME)
    expected = force_harmonics(law, CUTTER, DOWN, 20)
    assert np.einsum("s,sak->ak", series.weights[:, 3], series.harmonics) == pytest.approx(expected)


def test_series_that_change_alike_are_one():
    alike = (((1.0, 1.0), (5.0, 1.2)),) * 3
    assert len(force_series(LINEAR, Trend(drift=alike), CUTTER, DOWN, 5, TIME).harmonics) == 1
    assert len(force_series(KIENZLE, Trend(drift=alike), CUTTER, DOWN, 5, TIME).harmonics) == 1
    assert len(force_series(LINEAR, Trend(drift=alike, shape=alike), CUTTER, DOWN, 5, TIME).harmonics) == 2
    assert (
        len(force_series(LINEAR, WEAR, CUTTER, DOWN, 5, TIME).harmonics) == 5
    )  # a does not change: both its series are one


def test_edge_coefficients_take_drift_and_shape_together():
    first, last = coefficients_at(LINEAR, WEAR, np.array([5.0]))
    assert first[1, 0] == pytest.approx(LINEAR.cutting[1] * 1.5 * 1.3)
    assert last[1, 0] == pytest.approx(LINEAR.edge[1] * 1.5 * 1.3 * 0.8)
