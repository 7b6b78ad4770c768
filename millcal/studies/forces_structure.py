"""Structures of the study of forces from accelerations: three modes seen by six accelerometers, hit and cut in x, y and z.

Pawelko et al. (2012) print natural frequencies and damping, neither masses nor shapes nor the hammer's force. What is missing is
drawn: shapes between 0.3 and 1 with a sign, and the directions in which the modes are driven. The study's own structure has
orthogonal directions; those of an ensemble are orthogonal or each of its own, which conditions the FRF worse.
"""

from typing import NamedTuple

import numpy as np

SENSORS, AXES = 6, 3
NATURAL_FREQUENCY = np.array([60.0, 82.0, 103.0])  # Hz, as printed
DAMPING = np.array([0.1, 0.15, 0.07])  # as printed
MASS = np.array([200.0, 150.0, 130.0])  # kg
SEED = 2012  # of the study's own structure


class Structure(NamedTuple):
    """Modes with what each sensor sees of them and how each axis drives them."""

    natural_frequency: np.ndarray  # (mode,) Hz
    damping_ratio: np.ndarray  # (mode,)
    mass: np.ndarray  # (mode,) kg
    shape: np.ndarray  # (sensor, mode)
    direction: np.ndarray  # (axis, mode)

    def accelerance(self, frequency: np.ndarray) -> np.ndarray:
        """Acceleration over force: sum of -w^2 phi psi / (M (w_n^2 - w^2 + 2 j zeta w_n w)).

        frequency : (line,) Hz   returns complex (line, sensor, axis) 1/kg
        """
        w = 2 * np.pi * np.asarray(frequency)[:, np.newaxis]
        own = 2 * np.pi * self.natural_frequency
        response = -(w**2) / (self.mass * (own**2 - w**2 + 2j * self.damping_ratio * own * w))  # (line, mode)
        return np.einsum("lm,sm,am->lsa", response, self.shape, self.direction)


def random_structure(seed: int, *, orthogonal: bool = True) -> Structure:
    """A structure whose shapes and directions are drawn.

    orthogonal : whether the directions of the modes stand at right angles to each other; else each points anywhere
    """
    rng = np.random.default_rng(seed)
    shape = rng.uniform(0.3, 1.0, (SENSORS, len(MASS)))
    shape = shape * rng.choice([-1, 1], shape.shape)
    direction = rng.standard_normal((AXES, len(MASS)))
    direction = np.linalg.qr(direction)[0] if orthogonal else direction / np.linalg.norm(direction, axis=0)
    return Structure(NATURAL_FREQUENCY, DAMPING, MASS, shape, direction)


def condition(matrix: np.ndarray) -> float:
    """Of all lines together, of which each stands alone.   matrix : complex (line, sensor, axis)"""
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values.max() / values.min())
