"""The cuts on which stability is tested: the machines of the oracles and of the literature, and what was found there."""

import json
from functools import lru_cache
from pathlib import Path

import numpy as np

from millcal.physics.stability.regeneration import Regeneration, TipModes, tip_of_modes, tip_of_shapes
from millcal.physics.structure import Mode

RPM = 2 * np.pi / 60
ORACLES = Path(__file__).parents[1] / "references" / "stability" / "oracles.json"
TYPES = {"H": 0, "F": 1, "N": 2}  # of the oracles -> HOPF, FLIP, FOLD

IS_MASS, IS_FREQUENCY, IS_DAMPING = 0.03993, 922.0, 0.011  # the benchmark of Insperger and Stepan
IS_STIFFNESS = IS_MASS * (2 * np.pi * IS_FREQUENCY) ** 2


@lru_cache
def oracles() -> dict:
    """The whole of oracles.json."""
    return json.loads(ORACLES.read_text())


def machine(name: str) -> TipModes:
    """IS1, IS2, ASYM2, UBC22 of the oracles; AB603, SYM500, ROT2 of the literature and by hand; FLEXURE of Cornelius et al."""
    if name in oracles()["modes"]:
        rows = oracles()["modes"][name]
        return tip_of_modes([Mode(*row, axis) for axis in "xy" for row in rows[axis]])
    if name == "AB603":
        return tip_of_modes([Mode(603, 0.039, 5.59e6, "x"), Mode(666, 0.035, 5.715e6, "y")])
    if name == "SYM500":
        return tip_of_modes([Mode(500, 0.02, 8e6, "x"), Mode(500, 0.02, 8e6, "y")])
    if name == "ROT2":  # the modes of ASYM2 turned to 30 and 110 degrees from x
        return rotated_modes()
    if name == "FLEXURE":
        stiffness, mass, damping = 1.64e6, 2.51, 114.0
        natural = np.sqrt(stiffness / mass) / (2 * np.pi)
        return tip_of_modes([Mode(natural, damping / (2 * np.sqrt(stiffness * mass)), stiffness, "x")])
    raise KeyError(name)


def rotated_modes(degrees: tuple[float, float] = (30.0, 110.0)) -> TipModes:
    """The two modes of ASYM2, each along a direction of its own."""
    natural, damping = np.array([922.0, 1100.0]), np.array([0.011, 0.02])
    stiffness = IS_STIFFNESS * np.array([1.0, 1.5])
    angle = np.radians(degrees)
    size = 2 * np.pi * natural / np.sqrt(stiffness)
    return tip_of_shapes(natural, damping, size[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


COEFFICIENTS = {"AB603": (600e6, 42e6), "SYM500": (695.388e6, 280.955e6), "FLEXURE": (903.9e6, 534.5e6),
                "UBC22": (1319.4e6, 788.8e6)}  # fmt: skip


def engaged(immersion: float, direction: str) -> tuple[float, float]:
    """Entry and exit angle, rad, at a radial depth of that share of the diameter."""
    swept = np.arccos(1 - 2 * immersion)
    return (0.0, swept) if direction == "up" else (np.pi - swept, np.pi)


def cut(teeth: int, immersion: float, direction: str, name: str = "IS1", **more) -> Regeneration:
    """A cut with the coefficients that go with a machine; `more` are fields of `Regeneration`."""
    entry, leave = engaged(immersion, direction)
    ktc, krc = COEFFICIENTS.get(name, (600e6, 200e6))
    return Regeneration(teeth, entry, leave, ktc, krc, **more)


def case_cut(case: dict) -> Regeneration:
    """The cut of one case of the oracles."""
    entry, leave = engaged(case["a_over_D"], case["milling"])
    return Regeneration(case["N"], entry, leave, case["Kt"], case["Kn"])


def case_name(case: dict) -> str:
    """What the case is called among the tests."""
    return f"{case['modes']} N={case['N']} a/D={case['a_over_D']} {case['milling']}"
