"""The mean torque: what the force model gives sample by sample, and the closed form where there is one."""

import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import Kienzle, LinearEdge, chip_thickness
from millcal.physics.mean_torque import mean_torque

LINEAR = LinearEdge(np.array([700e6, 200e6, 100e6]), np.array([20e3, 3e3, 1e3]))
KIENZLE = Kienzle(np.array([700e6, 200e6, 0.0]), np.array([0.25, 0.3, 0.0]))
CUT = CuttingConditions(900.0, 1e-4, 3e-3, 8e-3, "down")
UNEQUAL = (1.2, 2.2, 2 * np.pi - 3.4)


@pytest.mark.parametrize("law", [LINEAR, KIENZLE], ids=["linear edge", "kienzle"])
@pytest.mark.parametrize("helix", [0.0, 0.5])
@pytest.mark.parametrize("pitch", [None, UNEQUAL], ids=["equal", "unequal"])
@pytest.mark.parametrize("runout", [0.0, 8e-6])
def test_it_is_the_average_of_the_tangential_force_over_angles_and_slices(law, helix, pitch, runout):
    cutter = Cutter(20e-3, 3, helix, pitch, runout, 0.3)
    angle = 2 * np.pi * (np.arange(3600) + 0.5) / 3600
    height = CUT.axial_depth * (np.arange(40) + 0.5) / 40
    chip = chip_thickness(cutter, CUT, angle, height)
    tangential = law.edge_force(chip, CUT.axial_depth / 40)[..., 0]
    average = cutter.radius * tangential.sum(axis=(0, 1)).mean()
    assert mean_torque(law, cutter, CUT) == pytest.approx(average, rel=1e-3)


@pytest.mark.parametrize("direction", ["up", "down", "slot"])
@pytest.mark.parametrize("pitch", [None, UNEQUAL], ids=["equal", "unequal"])
def test_without_runout_it_is_the_closed_form_whatever_helix_and_pitch(direction, pitch):
    cut = CuttingConditions(900.0, 1e-4, 3e-3, 8e-3, direction)
    entry, leave = engagement(cut, 20e-3)
    per_depth = 10e-3 * 3 / (2 * np.pi) * (700e6 * 1e-4 * (np.cos(entry) - np.cos(leave)) + 20e3 * (leave - entry))
    assert mean_torque(LINEAR, Cutter(20e-3, 3, 0.4, pitch), cut) == pytest.approx(3e-3 * per_depth, rel=1e-12)


def test_a_kienzle_law_without_rise_is_the_linear_law_without_edge():
    straight = Kienzle(np.array([700e6, 0.0, 0.0]), np.zeros(3))
    edgeless = LinearEdge(np.array([700e6, 0.0, 0.0]), np.zeros(3))
    cutter = Cutter(20e-3, 3)
    assert mean_torque(straight, cutter, CUT) == pytest.approx(mean_torque(edgeless, cutter, CUT), rel=1e-12)


def test_without_edge_forces_power_is_the_specific_force_times_the_metal_removed():
    """K_tc is a force per chip section, so an energy per volume: P = K_tc a_e b f_z N n."""
    edgeless = LinearEdge(np.array([700e6, 0.0, 0.0]), np.zeros(3))
    torque = mean_torque(edgeless, Cutter(20e-3, 3, 0.5, UNEQUAL), CUT)
    removed = CUT.radial_depth * CUT.axial_depth * CUT.feed_per_tooth * 3 * CUT.spindle_speed / (2 * np.pi)
    assert torque * CUT.spindle_speed == pytest.approx(700e6 * removed, rel=1e-12)
