"""Offset and drift of the force channels, measured where the tool cuts nothing, and taken off on request.

Ingesting leaves the samples as they are unless spans of air are named: conditioning finds and removes offset and drift
itself, and says so. It is done here only for files that go on to other programs.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.io.samples import Straightened, in_memory_if_small


def without_offset(
    recording: Recording, spans: Sequence[tuple[float, float]]
) -> tuple[Recording, np.ndarray, np.ndarray]:
    """The recording less a straight line through its means in the air: one span gives an offset, more give a drift, too.

    spans : [from, to] of each, s after the first sample
    returns the recording, the offset (channel,) at its first sample in SI, and the drift (channel,) in SI per s
    """
    times, means = [], []
    for begin, end in spans:
        start, stop = round(begin * recording.sample_rate), round(end * recording.sample_rate)
        if not 0 <= start < stop <= recording.samples.shape[1]:
            raise RecordingError(
                f"{recording.name}: no air cut from {begin:g} to {end:g} s; "
                f"name seconds after the first sample, in 0 to {recording.duration:g}"
            )
        times.append((start + stop - 1) / 2 / recording.sample_rate)
        means.append(_mean(recording, start, stop))
    mean, time = np.array(means), np.array(times)
    drift = np.zeros(mean.shape[1])
    if len(time) > 1 and np.ptp(time) > 0:
        about = time - time.mean()
        drift = about @ mean / (about @ about)
    offset = mean.mean(axis=0) - drift * time.mean()
    others = [row for row, channel in enumerate(recording.channels) if channel.quantity != "force"]
    offset[others] = drift[others] = 0.0
    straight = in_memory_if_small(Straightened(recording.samples, offset, drift, recording.sample_rate))
    return replace(recording, samples=straight, air=tuple(spans)), offset, drift


def _mean(recording: Recording, start: int, stop: int) -> np.ndarray:
    """Mean of each channel over samples start..stop.   returns (channel,)"""
    size = 1 << 18
    sums = [recording.block(at, min(at + size, stop)).sum(axis=1) for at in range(start, stop, size)]
    return np.sum(sums, axis=0) / (stop - start)
