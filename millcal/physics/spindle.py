"""The turning of the spindle: its angle over time, at constant or slowly varying speed."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SpindleMotion:
    """Speed f (1 + a sin(2 pi g t)) from an initial angle, with a and g the share and frequency of the variation."""

    frequency: float  # f, Hz: revolutions per second
    initial_angle: float = 0.0  # rad, at the first sample
    variation: float = 0.0  # a
    variation_frequency: float = 1.0  # g, Hz

    @property
    def highest_frequency(self) -> float:
        """Hz"""
        return self.frequency * (1 + abs(self.variation))

    def angle(self, time: np.ndarray) -> np.ndarray:
        """Spindle angle.   time : (t,) s   returns (t,) rad"""
        slow = 2 * np.pi * self.variation_frequency
        swing = self.variation * (1 - np.cos(slow * time)) / slow
        return self.initial_angle + 2 * np.pi * self.frequency * (time + swing)

    def pulse(self, time: np.ndarray, mark: float, width: float) -> np.ndarray:
        """Once-per-revolution pulse, 1 while the mark passes.   time : (t,) s   mark, width : rad   returns (t,)"""
        return ((self.angle(time) - mark) % (2 * np.pi) < width).astype(float)
