"""The impact hammer: half-sine pulses and their exact spectrum, and what goes wrong with hits."""

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Pulse:
    """Force peak sin(pi (t - onset) / duration) while it lasts."""

    onset: float  # s
    duration: float  # s
    peak: float  # N

    def spectrum(self, frequency: np.ndarray) -> np.ndarray:
        """Fourier integral.   frequency : (f,) Hz   returns complex (f,) N s

        F = peak (2 d / pi) cos(w d/2) / (1 - (w d/pi)^2) exp(-j w (onset + d/2)), written as two sincs, which are
        regular at w d = pi; the first zero is at 1.5 / d.
        """
        f = np.asarray(frequency)
        y = f * self.duration
        shape = np.sinc(y + 0.5) + np.sinc(y - 0.5)
        return 0.5 * self.peak * self.duration * shape * np.exp(-2j * np.pi * f * (self.onset + self.duration / 2))

    def force(self, time: np.ndarray) -> np.ndarray:
        """The force itself.   time : (t,) s   returns (t,) N"""
        x = (np.asarray(time) - self.onset) / self.duration
        return np.where((x >= 0) & (x <= 1), self.peak * np.sin(np.pi * x), 0.0)


@dataclass(frozen=True)
class HitFault:
    """A hit gone wrong.

    double: a second pulse of `ratio` of the first, `delay` later; weak: `ratio` of the usual peak; overload: the peak is
    `ratio` of the hammer's full scale.
    """

    hit: int  # from 0
    kind: Literal["double", "weak", "overload"]
    ratio: float
    delay: float = 0.0  # s
