"""From where the spindle angle counts in a steady cut: an encoder, a pulse per revolution, or the first sample."""

from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from millcal.data import Level, Recording
from millcal.numerics.revolutions import Samples
from millcal.stages.conditioning import spindle, spindle_angle
from millcal.stages.conditioning.forces import Note

Source = Literal["speed", "pulse", "encoder", "stated"]

BLOCK = 1 << 18  # samples of an encoder to hold at once
AHEAD = 0.1  # rad over the cut, by which an encoder may disagree with the harmonics' speed


class Reference(NamedTuple):
    """The angle of uniform motion at the first sample of the cut."""

    phase: float  # rad
    source: Source
    counts_from: Literal["start", "pulse", "encoder"]  # also of a stated angle
    sd: float  # rad, of the angle in the middle of the cut: of the speed on the way there, or of a pulse between samples


def angle_reference(
    recording: Recording, cut: Samples, found: tuple[float, float], spindle_phase: float | None, note: Note
) -> Reference:
    """The best there is: an encoder, a pulse, else the first sample of the recording.

    cut : first and last sample of whole revolutions   found : spindle frequency and its standard deviation, cycles per
    sample   spindle_phase : rad, angle of tooth 0 at the reference
    """
    start, stop = cut
    cycle, cycle_sd = found
    phase: float | None = encoder_phase(recording, start, stop, cycle, note)
    source: Source = "encoder"
    counts_from: Literal["start", "pulse", "encoder"] = "encoder"
    sd = 0.0
    if phase is None:
        rate = recording.sample_rate
        phase, usable = spindle.pulse_phase(recording, start, stop, cycle * rate, cycle_sd * rate, note)
        source, counts_from, sd = "pulse", "pulse", _between_samples(cycle, stop - start)
        if not usable:
            phase, sd = 2 * np.pi * (start * cycle % 1.0), np.pi * cycle_sd * (start + stop)
            source, counts_from = "speed", "start"
    if spindle_phase is None:
        return Reference(phase, source, counts_from, sd)
    return Reference(phase + spindle_phase, "stated", counts_from, sd)


def _between_samples(cycle: float, length: int) -> float:
    """Standard deviation of the mean angle of edges that are seen a part of a sample late, rad.

    The parts differ from revolution to revolution and cancel, but not where a revolution is a whole number of samples.
    """
    turns = np.arange(max(int(length * cycle), 1)) / cycle
    late = np.mean(np.add.outer(np.arange(32) / 32, turns) % 1.0, axis=1)
    return 2 * np.pi * cycle * float(late.std())


def encoder_phase(recording: Recording, start: int, stop: int, cycle: float, note: Note) -> float | None:
    """Mean lead of the encoder's angle before uniform motion from 0 at `start`, rad; None without a usable encoder."""
    if not recording.rows_of("angle"):
        return None
    told: set[str] = set()

    def once(code: str, message: str, level: Level = "warning") -> None:
        if code not in told:
            told.add(code)
            note(code, message, level)

    leads, weights = [], []
    pieces = max(1, -(-(stop - start) // BLOCK))
    edges = np.linspace(start, stop, pieces + 1).astype(int)
    for low, high in pairwise(edges):
        angle = spindle_angle.encoder_angle(recording, int(low), int(high), cycle, once)
        if angle is None:
            return None
        lead = angle - 2 * np.pi * cycle * np.arange(low - start, high - start)
        leads += [float(half.mean()) for half in np.array_split(lead, 2)]
        weights += [len(half) for half in np.array_split(lead, 2)]
    course = np.unwrap(leads)
    if np.ptp(course) > AHEAD:
        note(
            "encoder-disagrees",
            f"the encoder's angle moves by {np.degrees(np.ptp(course)):.2g} deg against the speed of the harmonics; "
            "the speed is of the harmonics, check the encoder, or cut at a steadier speed",
        )
    return float(np.average(course, weights=weights))
