"""The structure at the tool tip: modes to receptance, and receptance, mobility and accelerance into each other.

Convention: x(t) = Re X e^{+j w t}, so at a driving point the receptance has Im < 0 at a resonance. A mode moves along one
machine axis; its stiffness is that seen at the tip, G(0) = 1/k for a single mode.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

DERIVATIVES = {"receptance": 0, "mobility": 1, "accelerance": 2}  # of the displacement with respect to time


@dataclass(frozen=True)
class Mode:
    """One mode of vibration along a machine axis, as seen at the tool tip."""

    natural_frequency: float  # f_n, Hz, undamped
    damping_ratio: float  # zeta; 2 % is 0.02
    stiffness: float  # k, N/m
    axis: str  # x, y or z

    def __post_init__(self) -> None:
        if not (self.natural_frequency > 0 and self.damping_ratio > 0 and self.stiffness > 0):
            raise ValueError(f"{self} has a frequency, damping ratio or stiffness that is not positive")
        if self.axis not in ("x", "y", "z"):
            raise ValueError(f"{self.axis=} is none of x, y, z")


def receptance(frequency: np.ndarray, modes: Iterable[Mode], *, axes: Sequence[str] | None = None) -> np.ndarray:
    """Receptance matrix of modes along machine axes, G = sum of 1 / (k (1 - r^2 + 2j zeta r)) with r = f / f_n.

    frequency : (frequency,) Hz   axes : rows and columns of the matrix; None: x, y, and z where a mode has it
    returns complex (frequency, axis, axis) m/N
    """
    modes = tuple(modes)
    if axes is None:
        axes = ("x", "y", "z") if any(mode.axis == "z" for mode in modes) else ("x", "y")
    frequency = np.asarray(frequency, float)
    matrix = np.zeros((len(frequency), len(axes), len(axes)), complex)
    for mode in modes:
        if mode.axis in axes:
            r = frequency / mode.natural_frequency
            i = axes.index(mode.axis)
            matrix[:, i, i] += 1 / (mode.stiffness * (1 - r**2 + 2j * mode.damping_ratio * r))
    return matrix


def modal_receptance(
    frequency: np.ndarray,
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    residue: np.ndarray,
    remainder: np.ndarray | None = None,
    remainder_power: np.ndarray | Sequence[float] = (),
) -> np.ndarray:
    """Receptance of modes by their residues, G = sum_r [A_r / (s - p_r) + A_r* / (s - p_r*)] + sum_d R_d s^d at s = j w.

    The poles are p = -zeta w_n + j w_n sqrt(1 - zeta^2); the remainder R stands for the modes outside the band of a fit and
    means nothing far from it. A power below zero has no value at 0 Hz (nan).

    frequency : (frequency,) Hz   natural_frequency : (mode,) Hz   damping_ratio : (mode,)
    residue : complex (mode, output, input) s/kg   remainder : (power, output, input)   remainder_power : (power,) d
    returns complex (frequency, output, input) m/N
    """
    frequency = np.asarray(frequency, float)
    s = 2j * np.pi * frequency
    w, zeta = 2 * np.pi * np.asarray(natural_frequency, float), np.asarray(damping_ratio, float)
    pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    matrix = np.einsum("fm,moi->foi", 1 / (s[:, np.newaxis] - pole), residue)
    matrix += np.einsum("fm,moi->foi", 1 / (s[:, np.newaxis] - pole.conj()), np.conj(residue))
    for power, term in zip(remainder_power, () if remainder is None else remainder, strict=True):
        factor = _derivative_factor(frequency, int(power))
        matrix += factor[:, np.newaxis, np.newaxis] * term
    return matrix


def convert_frf(frequency: np.ndarray, values: np.ndarray, form: str, to: str) -> np.ndarray:
    """An FRF in another form: times (j w) for each derivative of the displacement; nan where that divides by zero (DC).

    frequency : (frequency,) Hz   values : complex (frequency, ...)   form, to : receptance, mobility, accelerance
    returns complex (frequency, ...)
    """
    factor = _derivative_factor(frequency, DERIVATIVES[to] - DERIVATIVES[form])
    return values * factor.reshape(-1, *[1] * (np.ndim(values) - 1))


def convert_frf_variance(frequency: np.ndarray, variance: np.ndarray, form: str, to: str) -> np.ndarray:
    """The variance of an FRF in another form; see `convert_frf`.   variance : real (frequency, ...)   returns the same shape"""
    factor = np.abs(_derivative_factor(frequency, DERIVATIVES[to] - DERIVATIVES[form])) ** 2
    return variance * factor.reshape(-1, *[1] * (np.ndim(variance) - 1))


def _derivative_factor(frequency: np.ndarray, order: int) -> np.ndarray:
    """(j w)^order, nan at DC for a negative order.   returns complex (frequency,)"""
    s = 2j * np.pi * np.asarray(frequency, float)
    if order >= 0:
        return s**order
    factor = np.full(s.shape, np.nan + 0j)
    moving = s != 0
    factor[moving] = s[moving] ** order
    return factor
