"""What a recording must hold to be a cut, its three forces, and the line through its air cuts."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from millcal.data import AXES, Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import Samples
from millcal.numerics.spectra import Reader

Note = Callable[..., None]  # takes code, sentence and level of a notice
Span = tuple[float, float]  # s


def stated_frequency(recording: Recording, where: str) -> float:
    """The stated spindle frequency, Hz, after a look at what the recording says about itself."""
    if recording.kind != "cut":
        raise RecordingError(f"{where}: is marked as {recording.kind}, not as a cut; correct its kind or leave it out")
    if recording.cutter is None:
        raise RecordingError(f"{where}: says nothing of the cutter; give a [cutter] table or a setup")
    if recording.conditions is None:
        raise RecordingError(f"{where}: says nothing of the cutting conditions; give its [[cuts]] entry or a setup")
    frequency = recording.conditions.spindle_speed / (2 * np.pi)
    if not frequency > 0:
        raise RecordingError(f"{where}: the spindle speed is not positive; state spindle_speed_rpm")
    if recording.sample_rate < 8 * frequency:
        raise RecordingError(
            f"{where}: {recording.sample_rate:g} samples per second are fewer than 8 per revolution at "
            f"{60 * frequency:g} rpm; check the sample rate and spindle_speed_rpm"
        )
    return frequency


def force_rows(recording: Recording, where: str, needed: Sequence[str] = AXES) -> list[int]:
    """Rows of fx, fy, fz; each axis that is needed must be there, and another one that is missing has row -1."""
    rows = recording.force_rows()
    missing = [f"f{axis}" for axis, row in zip(AXES, rows, strict=True) if row < 0 and axis in needed]
    if missing:
        have = ", ".join(f"{c.name} ({' '.join(filter(None, (c.quantity, c.dof)))})" for c in recording.channels)
        raise RecordingError(
            f"{where}: no force channel for {', '.join(missing)}; it has {have or 'no channels'}. "
            f'Name it in the map, as in {missing[0]} = "+F{missing[0][1]}"'
        )
    return rows


def read_forces(recording: Recording, rows: list[int], offset: np.ndarray, drift: np.ndarray) -> Reader:
    """A reader of the forces less offset + drift n.   offset : (axis,) N   drift : (axis,) N per sample"""

    def read(start: int, stop: int) -> np.ndarray:
        line = np.multiply.outer(drift, np.arange(start, stop)) + offset[:, np.newaxis]
        return np.asarray(recording.block(start, stop, rows)) - line

    return read


class AirLine(NamedTuple):
    """Offset and drift by sample, and how well they are known."""

    offset: np.ndarray  # N at sample 0, (axis,)
    drift: np.ndarray  # N per sample, (axis,)
    centre: float  # sample at which the level is known best
    level_variance: np.ndarray  # N^2, (axis,)
    drift_variance: np.ndarray  # (N per sample)^2, (axis,)

    def variance_at(self, sample: float) -> np.ndarray:
        """Variance of what is removed at a sample.   returns (axis,) N^2"""
        return self.level_variance + (sample - self.centre) ** 2 * self.drift_variance


def offset_line(
    read: Reader,
    spans: list[Samples],
    samples_per_revolution: float,
    rate: float,
    offset: str,
    where: str,
    note: Note,
    axes: Sequence[str] = AXES,
) -> AirLine:
    """The line through the revolution means of the air cuts.

    Air cut on one side of the cut only gives its level and no drift: a slope from there would be an extrapolation. Its
    variance is that of the scatter of the revolution means, more where neighbours are alike (slow noise of the amplifier).
    """
    zero = np.zeros(len(axes))
    nothing = AirLine(zero, zero, 0.0, zero, zero)
    if offset == "none":
        note("offset-kept", "offset and drift are left in, as asked; the edge coefficients absorb them", "note")
        return nothing
    if not spans:
        if offset == "air":
            raise RecordingError(f'{where}: no air cut was found for offset = "air"; give air_s, or offset = "auto"')
        note(
            "no-air-cut",
            "no air cut in the record: offset and drift cannot be told from the force, so the edge coefficients absorb "
            "them; record a second of air cut before and after",
        )
        return nothing
    times, means = [], []
    for low, high in spans:
        whole = max(int((high - low) / samples_per_revolution), 1)
        edges = np.minimum(np.rint(low + np.arange(whole + 1) * samples_per_revolution), high).astype(np.int64)
        for a, b in pairwise(edges):
            mean_force = read(int(a), int(b)).mean(axis=1)
            if np.all(np.isfinite(mean_force)):
                times.append((a + b - 1) / 2)
                means.append(mean_force)
    if not means:
        raise RecordingError(f"{where}: the air cut holds samples that are no numbers; give air_s without them")
    time, mean = np.array(times), np.array(means)  # (revolution,), (revolution, axis)
    centre, level, slope = float(time.mean()), mean.mean(axis=0), zero
    moment = float(np.sum((time - centre) ** 2))
    if len(spans) > 1:
        slope = (time - centre) @ (mean - level) / moment
    left = mean - level - np.outer(time - centre, slope)
    alike = np.sum(left[1:] * left[:-1], axis=0) / np.maximum(np.sum(left**2, axis=0), 1e-300)
    scatter = (
        np.sum(left**2, axis=0) / max(len(time) - 2, 1) * (1 + np.clip(alike, 0, 0.8)) / (1 - np.clip(alike, 0, 0.8))
    )
    offsets = ", ".join(f"{axis} {value:.3g}" for axis, value in zip(axes, level, strict=True))
    drifts = ", ".join(f"{axis} {value * rate:.3g}" for axis, value in zip(axes, slope, strict=True))
    seconds = sum(high - low for low, high in spans) / rate
    note(
        "offset-removed",
        f"removed an offset of {offsets} N"
        + (f" and a drift of {drifts} N/s" if len(spans) > 1 else "")
        + f", from {seconds:.2g} s of air cut"
        + ("" if len(spans) > 1 else "; it lies on one side of the cut only, so drift stays in"),
        "note" if len(spans) > 1 else "warning",
    )
    drift_variance = scatter / moment if len(spans) > 1 else zero
    return AirLine(level - slope * centre, slope, centre, scatter / len(time), drift_variance)
