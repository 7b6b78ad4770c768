"""A receptance matrix at any frequency, from its lines.

Between lines it is a cubic spline of the complex values. A spline of 1/G would hold a lone resonance with a quarter of the
lines, but away from resonance it would go through the inverse of noise. Below the first line the static value is held.

Above the last line stands the mass line -A / w^2 of the modes below, with A from the real parts of the highest fifth of the
band, and passes to nothing at twice the band. Cut off sharply instead, lines up to five times the highest mode lose what all
modes leave to the high harmonics of a short cut, 0.3 % of a limit at worst; and the step at the end of the band is a step in
theta, across which no eigenvalue can be followed. With the mass line, limits of short cuts (138 speeds of converged cuts of
modes, two to four teeth, a_e up to a tenth of the diameter) are off by

    band over the highest mode   1.3    1.6    2       2.5     3.3      5
    median                       7 %    1 %    0.07 %  0.01 %  0.008 %  0.003 %
    worst                        45 %   15 %   7 %     2.4 %   1.1 %    0.3 %

Where the real part is positive, modes beyond the band rule it; a line of mass cannot say what they do, and nothing is put there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

STATIC_LINES = 5  # of the lowest, whose median real part is held below the first
PASSES = 0.8  # share of the band from which the lines pass into the mass line
ENDS = (1.6, 2.0)  # times the band, where the mass line passes to nothing
HALF_POWER = 0.5  # share of the height of Im G that a resonance falls below on both sides
MOST_PEAKS = 200  # of a driving point, that are looked at


@dataclass(frozen=True, eq=False)
class Receptance:
    """G of a tip in x and y, defined for all frequencies."""

    frequency: np.ndarray  # (line,) Hz, ascending, > 0
    values: np.ndarray  # complex (line, 2, 2) m/N
    spline: Callable[[np.ndarray], np.ndarray]
    static: np.ndarray  # (2, 2) m/N
    mass_line: np.ndarray  # A / (2 pi)^2, (2, 2) m Hz^2/N, positive semidefinite

    @property
    def reach(self) -> float:
        """The frequency beyond which nothing answers, Hz."""
        return float(self.frequency[-1]) * (ENDS[1] if self.mass_line.any() else 1.0)

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """G, for frequencies of either sign.   frequency : (...,) Hz   returns complex (..., 2, 2) m/N"""
        size, last = np.abs(frequency), self.frequency[-1]
        matrix = np.zeros((*size.shape, 2, 2), complex)
        inside = (size >= self.frequency[0]) & (size <= last)
        matrix[inside] = self.spline(size[inside])
        matrix[size < self.frequency[0]] = self.static
        high = (size > PASSES * last) & (size < ENDS[1] * last)
        share = self.share_of_mass_line(size[high])[:, np.newaxis, np.newaxis]
        end = 1 - _smooth_step(size[high] / last, *ENDS)
        mass_line = -self.mass_line * (end / size[high] ** 2)[:, np.newaxis, np.newaxis]
        matrix[high] = (1 - share) * matrix[high] + share * mass_line
        return np.where((frequency < 0)[..., np.newaxis, np.newaxis], matrix.conj(), matrix)

    def share_of_mass_line(self, size: np.ndarray) -> np.ndarray:
        """What the mass line has in G; the rest is the lines'.   size : (...,) Hz, >= 0"""
        return _smooth_step(size / self.frequency[-1], PASSES, 1.0)


def _smooth_step(x: np.ndarray, low: float, high: float) -> np.ndarray:
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    return share**2 * (3 - 2 * share)


def receptance_of_lines(frequency: np.ndarray, values: np.ndarray) -> Receptance:
    """frequency : (line,) Hz, ascending, > 0   values : complex (line, 2, 2) m/N"""
    from scipy.interpolate import CubicSpline

    frequency, values = np.asarray(frequency, float), np.asarray(values, complex)
    static = np.median(values[:STATIC_LINES].real, axis=0)
    high = frequency >= PASSES * frequency[-1]
    mass = -np.median(values[high].real * frequency[high, np.newaxis, np.newaxis] ** 2, axis=0)
    size, direction = np.linalg.eigh((mass + mass.T) / 2)
    mass = (direction * np.maximum(size, 0.0)) @ direction.T
    return Receptance(frequency, values, CubicSpline(frequency, values), static, mass)


def resonances(frequency: np.ndarray, values: np.ndarray, least: float) -> np.ndarray:
    """Where Im G of a driving point stands out by half its height, and where it is down to the half.

    Who goes through the frequencies by steps of their own passes over a resonance that is narrower than a step.

    frequency : (line,) Hz, ascending   values : complex (line, 2, 2) m/N   least : |Im G| below which nothing counts, m/N
    returns (resonance, 3) Hz: below, at and above the peak
    """
    found = []
    for axis in (0, 1):
        size = np.abs(values[:, axis, axis].imag)
        inner = size[1:-1]
        top = 1 + np.flatnonzero((inner > size[:-2]) & (inner >= size[2:]) & (inner >= least))
        for i in top[np.argsort(-size[top], kind="stable")][:MOST_PEAKS].tolist():
            half = []
            for side, first in ((size[:i][::-1], 0), (size[i + 1 :], len(size) - 1)):
                low, over = np.argmax(side < HALF_POWER * size[i]), np.argmax(side > size[i])
                falls, rises = bool(len(side)) and side[low] < HALF_POWER * size[i], side[over] > size[i]
                if rises and (not falls or over < low):
                    break  # the flank of a higher one, or its noise
                half.append(first if not falls else i - 1 - low if first == 0 else i + 1 + low)
            else:
                found.append((frequency[half[0]], frequency[i], frequency[half[1]]))
    return np.array(found).reshape(-1, 3)
