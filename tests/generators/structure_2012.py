"""The structure, the cut and the coefficients of `tests/references/structure_2012`, in SI and in the terms of the project."""

import json
from pathlib import Path

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.shaped_modes import ShapedMode, accelerance_between

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "references" / "structure_2012" / "structure_2012.json").read_text()
)

SENSORS = tuple(f"s{i + 1}" for i in range(len(REFERENCE["phi_sensor_mode"])))
DIRECTIONS = ("toolX", "toolY", "toolZ")
MODES = tuple(
    ShapedMode(
        frequency, zeta, mass * (2 * np.pi * frequency) ** 2, tuple(zip((*SENSORS, *DIRECTIONS), shape, strict=True))
    )
    for frequency, zeta, mass, shape in zip(
        REFERENCE["fn_hz"],
        REFERENCE["zeta"],
        REFERENCE["mass_kg"],
        np.vstack([REFERENCE["phi_sensor_mode"], REFERENCE["psi_direction_mode"]]).T.tolist(),
        strict=True,
    )
)
TOOTH_PASSING = np.arange(53.0, 109.0, 5.0)  # Hz, the twelve of the paper
CUTTER = Cutter(diameter=20e-3, teeth=REFERENCE["cut"]["teeth"])  # a straight edge: the diameter plays no part
_K = REFERENCE["cut"]["K_N_per_mm2_and_N_per_mm"]
COEFFICIENTS = np.array(
    [_K["Ktc"] * 1e6, _K["Krc"] * 1e6, _K["Kac"] * 1e6, _K["Kte"] * 1e3, _K["Kre"] * 1e3, _K["Kae"] * 1e3]
)


def accelerance(frequency, inputs=DIRECTIONS):
    """The exact FRF.   frequency : (f,) Hz   returns complex (f, sensor, direction) (m/s^2)/N"""
    return accelerance_between(np.asarray(frequency, float), MODES, SENSORS, inputs)


def conditions(tooth_passing):
    """The slot of the paper.   tooth_passing : Hz"""
    cut = REFERENCE["cut"]
    return CuttingConditions(
        spindle_speed=2 * np.pi * tooth_passing / cut["teeth"],
        feed_per_tooth=cut["feed_per_tooth_mm"] * 1e-3,
        axial_depth=cut["axial_depth_mm"] * 1e-3,
        radial_depth=CUTTER.diameter,
        direction="slot",
    )


def block_accelerance(tooth_passing, harmonics=2, inputs=DIRECTIONS):
    """G of several harmonics of the tooth passing, block by block.   returns complex (harmonic sensor, harmonic direction)"""
    G = accelerance(tooth_passing * np.arange(1, harmonics + 1), inputs)
    return np.block([[G[i] if i == j else np.zeros(G[i].shape) for j in range(harmonics)] for i in range(harmonics)])
