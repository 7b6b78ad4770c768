"""What is drawn of a driving point, on the page and on paper: magnitude, phase, coherence, and the band of the variance.

The variance of an FRF is that of the complex value, half of it along the value and half across: the standard deviation of
the magnitude is sqrt(variance / 2), that of the phase the same over the magnitude.
"""

from dataclasses import dataclass

import numpy as np

from millcal.data import Frf

FORMS = {  # form -> (symbol, unit, factor from SI)
    "receptance": ("X/F", "µm/N", 1e6),
    "mobility": ("V/F", "(mm/s)/N", 1e3),
    "accelerance": ("A/F", "(m/s²)/N", 1.0),
    "transmissibility": ("F/F", "N/N", 1.0),
}
PHASE_MIDDLE = {"receptance": -90.0, "mobility": 0.0, "accelerance": 90.0, "transmissibility": -90.0}  # deg


def _direction(dof: str) -> str:
    return dof.lstrip("+-")


def driving_pairs(frf: Frf) -> list[tuple[int, int]]:
    """(output, input) of every driving point: response and hammer at one point in one direction, whatever the sign."""
    outputs = [_direction(dof) for dof in frf.outputs]
    pairs = [(outputs.index(_direction(dof)), i) for i, dof in enumerate(frf.inputs) if _direction(dof) in outputs]
    return pairs or [(0, 0)]


def rows_drawn(frf: Frf) -> np.ndarray:
    """Rows of the FRF that are drawn: the usable band and a little around it, at most two decades."""
    low, high = frf.usable_band[0] / 1.25, frf.usable_band[1] * 1.25
    shown = (frf.frequency >= max(low, high / 100)) & (frf.frequency <= high) & (frf.frequency > 0)
    return np.flatnonzero(shown) if np.count_nonzero(shown) > 1 else np.arange(len(frf.frequency))


@dataclass(frozen=True, eq=False)
class DrivingPoint:
    """The curves of one driving point, in the unit that the report shows."""

    frequency: np.ndarray  # (row,) Hz
    magnitude: np.ndarray  # (row,)
    phase: np.ndarray  # (row,) deg, its branch cut where a driving point cannot be
    low: np.ndarray | None  # (row,) 95 % band of the magnitude
    high: np.ndarray | None
    turn: np.ndarray | None  # (row,) deg, half the 95 % band of the phase
    coherence: np.ndarray | None  # (row,); None where there is none, or one hit has made it meaningless


def driving_point(frf: Frf, output: int, given: int) -> DrivingPoint:
    """The curves of one pair of output and input over the rows that are drawn."""
    rows = rows_drawn(frf)
    factor, middle = FORMS[frf.form][2], PHASE_MIDDLE[frf.form]
    value = frf.values[rows, output, given]
    magnitude = factor * np.abs(value)
    low = high = turn = coherence = None
    if frf.variance is not None:
        half = 1.96 * factor * np.sqrt(np.maximum(frf.variance[rows, output, given], 0.0) / 2)
        low, high = np.maximum(magnitude - half, magnitude * 1e-3), magnitude + half
        turn = np.degrees(np.minimum(half / np.maximum(magnitude, 1e-300), np.pi))
    if frf.coherence is not None and np.isfinite(frf.coherence[rows, output, given]).any():
        coherence = frf.coherence[rows, output, given]
    phase = middle + np.degrees(np.angle(value * np.exp(-1j * np.radians(middle))))
    return DrivingPoint(frf.frequency[rows], magnitude, phase, low, high, turn, coherence)
