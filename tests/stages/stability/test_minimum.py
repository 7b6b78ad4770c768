"""The smallest limit is refined between the speeds of a map, and the record says where it lies."""

import numpy as np
import pytest

from millcal.data import Modes
from millcal.stages.stability import map_stability

RPM = 2 * np.pi / 60
ONE = Modes(natural_frequency=[500.0], damping_ratio=[0.03], stiffness=[8e6], axes=("x",))
CUT = {
    "teeth": 2,
    "diameter": 20e-3,
    "radial_depth": 10e-3,
    "direction": "down",
    "feed_per_tooth": 0.1e-3,
    "rigid": "y",
}


def test_the_limit_at_the_speed_of_the_smallest_limit_is_the_smallest_limit():
    coarse = map_stability(
        ONE, (800e6, 300e6), **CUT, spindle_speed=(6000 * RPM, 10_000 * RPM), method="floquet", points=9
    )
    at = coarse.absolute_minimum_speed
    assert coarse.absolute_minimum < 0.999 * coarse.limit_depth.min()
    assert np.abs(coarse.spindle_speed - at).min() > 1 * RPM
    there = map_stability(
        ONE, (800e6, 300e6), **CUT, spindle_speed=(at, at + RPM), method="floquet", points=2, deepest=coarse.deepest
    )
    assert there.limit_depth[0] == pytest.approx(coarse.absolute_minimum, rel=1e-6)


def test_the_zero_order_limit_is_smallest_at_no_one_speed():
    found = map_stability(ONE, (800e6, 300e6), **CUT, spindle_speed=(6000 * RPM, 10_000 * RPM), method="zoa", points=9)
    assert np.isnan(found.absolute_minimum_speed)
