"""Numbers that look like another unit: each told, and none of those that cutters and metals have."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Modes
from millcal.errors import IllPosedError
from millcal.stages.stability import map_stability

RPM = 2 * np.pi / 60
MODES = Modes(natural_frequency=[920.0, 1040.0], damping_ratio=[0.02, 0.02], stiffness=[5e6, 8e6], axes=("x", "y"))
CUT = {
    "teeth": 4,
    "diameter": 16e-3,
    "radial_depth": 8e-3,
    "direction": "down",
    "feed_per_tooth": 1e-4,
    "spindle_speed": (8000 * RPM, 14_000 * RPM),
    "points": 4,
    "method": "zoa",
}
KNOWN = (800e6, 260e6)


def told(known=KNOWN, modes=MODES, **changed):
    found = map_stability(modes, known, **{**CUT, **changed})
    return [notice.where for notice in found.notices if notice.code == "implausible"]


@pytest.mark.parametrize("diameter", [0.3e-3, 16e-3, 125e-3])
def test_nothing_is_said_of_what_is_milled(diameter):
    """A micro mill, an end mill and a face mill, in wood's, aluminium's and hard steel's coefficients."""
    stiffer = replace(MODES, stiffness=MODES.stiffness * diameter / 16e-3)
    cut = {"diameter": diameter, "radial_depth": diameter / 2, "feed_per_tooth": min(diameter / 50, 2e-4)}
    speeds = (0.5 / diameter, 10 / diameter)  # rad/s
    for ktc in (100e6, 800e6, 6000e6):
        assert not told(
            (ktc, 0.4 * ktc), stiffer, **cut, spindle_speed=speeds, operating_point=(speeds[0], diameter / 20)
        )


@pytest.mark.parametrize(
    ("changed", "where"),
    [
        ({"radial_depth": 0.8e-6}, "stability.radial_depth_mm"),
        ({"feed_per_tooth": 80e-3}, "stability.feed_per_tooth_mm"),
        ({"feed_per_tooth": 8e-8}, "stability.feed_per_tooth_mm"),
        ({"operating_point": (10_800 * RPM, 3.5e-6)}, "stability.axial_depth_mm"),
        ({"deepest": 5.0}, "stability.deepest_mm"),
        ({"diameter": 16.0, "radial_depth": 8.0}, "cutter.diameter_mm"),
        ({"spindle_speed": (8 * RPM, 11 * RPM)}, "stability.rpm"),
        ({"indentation": 4e8, "method": "floquet", "deepest": 1e-3}, "stability.process_damping_N_per_mm"),
        ({"known": (800e6, -260e6)}, "coefficients.Krc"),
        ({"known": (260e6, 1800e6)}, "coefficients.Krc"),
        ({"known": (800e12, 260e12)}, "coefficients.Ktc"),
        ({"known": (0.8e6, 0.26e6)}, "coefficients.Ktc"),
        ({"edge": (2e7, 2e7)}, "coefficients.Kte"),
        ({"modes": replace(MODES, stiffness=MODES.stiffness / 1000)}, "stability"),
        ({"modes": replace(MODES, stiffness=MODES.stiffness * 1000)}, "stability"),
    ],
)
def test_a_number_in_another_unit_is_told_by_its_key(changed, where):
    assert where in told(**changed)


def test_an_operating_depth_that_no_cutter_reaches_is_refused():
    with pytest.raises(IllPosedError, match=r"stability.axial_depth_mm: 3500 mm .* 10 diameters"):
        told(operating_point=(10_800 * RPM, 3.5))
