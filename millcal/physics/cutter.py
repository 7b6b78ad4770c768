"""The cutter, the cutting conditions, and where a tooth is engaged.

Angles run clockwise from +y with the feed along +x (Altintas). Tooth 0 is the reference at the helix bottom; tooth j lags:
its angle is phi_j = theta - psi_j - kappa(z), with psi_j the sum of the pitches before it and kappa(z) = z tan(helix) / R.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Cutter:
    """A cylindrical end mill."""

    diameter: float  # m
    teeth: int
    helix: float = 0.0  # rad
    pitch: tuple[float, ...] | None = None  # rad, from tooth k to tooth k + 1; None: equal
    runout: float = 0.0  # rho, m: distance of the cutter's axis from the spindle's
    runout_angle: float = 0.0  # rad, from tooth 0 at the helix bottom to the offset, in the direction of rotation

    def __post_init__(self) -> None:
        if self.teeth < 1:
            raise ValueError(f"{self.teeth=} is not at least 1")
        if self.pitch is not None and len(self.pitch) != self.teeth:
            raise ValueError(f"{len(self.pitch)} pitches for {self.teeth} teeth")
        if self.pitch is not None and abs(sum(self.pitch) - 2 * np.pi) > 1e-6:
            raise ValueError("the pitches do not add up to one revolution")

    @property
    def radius(self) -> float:
        """m"""
        return self.diameter / 2

    def tooth_lag(self) -> np.ndarray:
        """psi_j, by how much tooth j lags tooth 0.   returns (tooth,) rad"""
        pitch = np.full(self.teeth, 2 * np.pi / self.teeth) if self.pitch is None else np.asarray(self.pitch)
        return np.concatenate([[0.0], np.cumsum(pitch)[:-1]])

    def helix_lag(self, height: np.ndarray) -> np.ndarray:
        """kappa(z), by how much the edge at a height lags its bottom.   height : (...,) m   returns (...,) rad"""
        return np.asarray(height) * np.tan(self.helix) / self.radius


@dataclass(frozen=True)
class CuttingConditions:
    """How one cut was made."""

    spindle_speed: float  # rad/s
    feed_per_tooth: float  # m, mean over the teeth
    axial_depth: float  # m
    radial_depth: float  # m
    direction: str  # up, down, slot

    def __post_init__(self) -> None:
        if self.direction not in ("up", "down", "slot"):
            raise ValueError(f"{self.direction=} is none of up, down, slot")


def engagement(conditions: CuttingConditions, diameter: float) -> tuple[float, float]:
    """Entry and exit angle of a tooth, rad.

    up: 0 .. arccos(1 - 2 a_e/D); down: pi - arccos(..) .. pi; a slot, or a_e = D, is 0 .. pi.
    """
    if conditions.direction == "slot":
        return 0.0, np.pi
    swept = float(np.arccos(np.clip(1 - 2 * conditions.radial_depth / diameter, -1.0, 1.0)))
    return (0.0, swept) if conditions.direction == "up" else (np.pi - swept, np.pi)
