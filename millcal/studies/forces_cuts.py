"""Cuts of the study of forces from accelerations: a slot with two teeth, heard by six accelerometers for a second.

Fourier coefficients are two-sided, as numpy.fft.rfft(x) / n, since the paper's total least squares weighs the force against 1.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.force_subspace import NAMES, force_constraint, harmonic_basis
from millcal.studies.forces_structure import SENSORS, Structure
from millcal.studies.forces_tests import SAMPLE_RATE, SAMPLES

TRUTH = {  # N/m^2 and N/m
    "Ktc": 1000e6, "Krc": 700e6, "Kac": 250e6, "Kte": 50e3, "Kre": 30e3, "Kae": 15e3,
}  # fmt: skip
SOUGHT = ("Ktc", "Kte", "Krc", "Kre")
CUTTER = Cutter(diameter=20e-3, teeth=2)  # the diameter changes nothing: no helix
PASSINGS = tuple(range(53, 109, 5))  # f_t, Hz, whole ones: each is a line
NEAR = 20  # lines to either side of a harmonic that tell the noise there


class CutRecord(NamedTuple):
    """Accelerations at the harmonics of the tooth passing."""

    values: np.ndarray  # complex (line, sensor) m/s^2
    noise: np.ndarray  # E[e e^H], complex (line, sensor, sensor)


class ForceLaw(NamedTuple):
    """What the linear-edge law says of the first harmonics of the tooth passing, in the order x, y, z of each."""

    basis: np.ndarray  # force of each coefficient that can be told, complex (line, axis, coefficient)
    names: tuple[str, ...]  # of these coefficients
    constraint: np.ndarray  # all rows that vanish, real (row, 2 line axis): [Re F; Im F]
    inverse: np.ndarray  # eq. 23 in its right order: the sought coefficients of [Re F_xy; Im F_xy], (4, 4 line)

    def coefficients(self, force: np.ndarray) -> np.ndarray:
        """The sought coefficients by eq. 23.   force : complex (line, axis)   returns (4,)"""
        plane = force[:, :2].ravel()
        return self.inverse @ np.concatenate([plane.real, plane.imag])


def conditions(passing: float) -> CuttingConditions:
    """The slot at a tooth passing frequency, Hz."""
    return CuttingConditions(
        spindle_speed=2 * np.pi * passing / CUTTER.teeth,
        feed_per_tooth=0.15e-3,
        axial_depth=2e-3,
        radial_depth=CUTTER.diameter,
        direction="slot",
    )


@lru_cache(maxsize=8)
def whole_basis(harmonics: int) -> np.ndarray:
    """Of all six coefficients; any speed has the same.   returns complex (line, axis, coefficient)"""
    orders = CUTTER.teeth * np.arange(1, harmonics + 1)
    return harmonic_basis(CUTTER, conditions(PASSINGS[0]), orders) / 2


@lru_cache(maxsize=8)
def force_law(harmonics: int) -> ForceLaw:
    """The law with its constraint."""
    basis = whole_basis(harmonics)
    constraint = force_constraint(basis)
    plane = basis[:, :2][:, :, [NAMES.index(name) for name in SOUGHT]].reshape(-1, len(SOUGHT))
    inverse = np.linalg.pinv(np.concatenate([plane.real, plane.imag]))
    names = tuple(name for name, told in zip(NAMES, constraint.told, strict=True) if told)
    return ForceLaw(basis[:, :, constraint.told], names, constraint.rows, inverse)


def exact_accelerations(structure: Structure, passing: int) -> np.ndarray:
    """Of all harmonics below half the sample rate.   passing : Hz   returns complex (line, sensor) m/s^2"""
    harmonics = int((SAMPLE_RATE / 2 - 1) // passing)
    force = whole_basis(harmonics) @ np.array([TRUTH[name] for name in NAMES])
    G = structure.accelerance(passing * np.arange(1.0, harmonics + 1))
    return np.einsum("lsa,la->ls", G, force)


def cut_record(
    exact: np.ndarray, passing: int, sigma: float, harmonics: int, rng: np.random.Generator, *, angle: float = 0.0
) -> CutRecord:
    """A second of a steady cut with white noise, of which the lines between the harmonics tell the level.

    exact : complex (line, sensor) m/s^2   passing : Hz   sigma : m/s^2, of a sample
    angle : rad, by which the spindle lags where its pulse says it is
    """
    order = np.arange(1, len(exact) + 1)
    spectrum = np.zeros((SAMPLES // 2 + 1, SENSORS), complex)
    spectrum[passing * order] = exact * np.exp(-1j * CUTTER.teeth * order * angle)[:, np.newaxis]
    record = np.fft.irfft(spectrum, SAMPLES, axis=0) * SAMPLES + sigma * rng.standard_normal((SAMPLES, SENSORS))
    seen = np.fft.rfft(record, axis=0) / SAMPLES
    between = np.ones(len(seen))
    between[passing * order] = 0.0
    power = np.mean(np.abs(seen) ** 2, axis=1) * between
    kept = passing * order[:harmonics]
    around = kept[:, np.newaxis] + np.arange(-NEAR, NEAR + 1)
    level = power[around].sum(axis=1) / between[around].sum(axis=1)
    return CutRecord(seen[kept], level[:, np.newaxis, np.newaxis] * np.eye(SENSORS))


def wanted_lines(passings: Sequence[int], harmonics: int) -> np.ndarray:
    """Lines at which FRFs are needed, Hz, ascending."""
    return np.unique(np.outer(passings, np.arange(1, harmonics + 1)))
