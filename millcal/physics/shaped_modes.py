"""A structure by modes with shapes over named points: what a hit or a cut at one point does at another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ShapedMode:
    """One mode; points that its shape does not name stand still."""

    natural_frequency: float  # f_n, Hz
    damping_ratio: float  # zeta
    stiffness: float  # k, N/m, at a point where the shape is 1
    shape: tuple[tuple[str, float], ...]  # (dof, value): ("tipX", 1.0)

    def at(self, dofs: Sequence[str]) -> np.ndarray:
        """The shape at some dofs.   returns (dof,)"""
        known = dict(self.shape)
        return np.array([known.get(dof, 0.0) for dof in dofs])

    @property
    def decay_rate(self) -> float:
        """zeta w_n, 1/s"""
        return self.damping_ratio * 2 * np.pi * self.natural_frequency


def receptance_between(
    frequency: np.ndarray, modes: Sequence[ShapedMode], outputs: Sequence[str], inputs: Sequence[str]
) -> np.ndarray:
    """Displacement over force, sum of phi_o phi_i / k * w_n^2 / (w_n^2 - w^2 + 2 j zeta w_n w).

    frequency : (f,) Hz   returns complex (f, output, input) m/N
    """
    f = np.asarray(frequency, float)
    total = np.zeros((len(f), len(outputs), len(inputs)), complex)
    for mode in modes:
        own = mode.natural_frequency
        response = own**2 / (own**2 - f**2 + 2j * mode.damping_ratio * own * f) / mode.stiffness
        total += response[:, np.newaxis, np.newaxis] * np.outer(mode.at(outputs), mode.at(inputs))
    return total


def accelerance_between(
    frequency: np.ndarray, modes: Sequence[ShapedMode], outputs: Sequence[str], inputs: Sequence[str]
) -> np.ndarray:
    """Acceleration over force, -w^2 times the receptance.   frequency : (f,) Hz   returns complex (f, output, input) 1/kg"""
    w = 2 * np.pi * np.asarray(frequency, float)
    return -(w**2)[:, np.newaxis, np.newaxis] * receptance_between(frequency, modes, outputs, inputs)
