"""Writing the recording file of the contract: block by block, the same bytes for the same recording, whole or not at all."""

import os
from pathlib import Path

import h5py
import numpy as np

from millcal.data import Recording
from millcal.io.formats.hdf5 import FORMAT, VERSION
from millcal.io.keys import keys_of
from millcal.io.replacing import replaced_atomically
from millcal.units import to_shop

CHUNK = 65536  # samples
_BLOCK = 8 * CHUNK  # samples at a time; whole chunks, so that none is compressed twice
_LARGEST_COUNT = 2**31 - 1


def write_recording(path: Path, recording: Recording, *, counts: bool = False) -> None:
    """Write a recording; an existing file is replaced in the end, or stays.

    counts : store a channel whose values are all multiples of one step as integers with a scale, which is smaller
    """
    with replaced_atomically(Path(path)) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        file.attrs["kind"] = recording.kind
        file.attrs["sample_rate_hz"] = float(recording.sample_rate)
        file.attrs["start_time_s"] = float(recording.start_time)
        names = [channel.name for channel in recording.channels]
        file.attrs.create("channel_order", names, dtype=h5py.string_dtype())
        for key, value in keys_of(recording.cutter, recording.conditions).items():
            file.attrs[key] = value
        if recording.steady is not None:
            file.attrs["steady_s"] = np.asarray(recording.steady, dtype=float)
        if recording.air is not None:
            file.attrs["air_s"] = np.asarray(recording.air, dtype=float).reshape(-1, 2)
        if recording.path_start is not None:
            file.attrs["path_start_s"] = float(recording.path_start)
        if recording.spindle_phase is not None:
            file.attrs["spindle_phase_deg"] = float(to_shop(recording.spindle_phase, "_deg"))
        if recording.engagement is not None and recording.engagement.name:
            file.attrs["engagement"] = os.path.relpath(recording.engagement.name, Path(path).parent)
        if recording.segments is not None:
            segments = np.asarray(recording.segments, dtype=np.int64)
            file.create_dataset("segments", data=segments, track_times=False)
        steps = _steps(recording) if counts else [None] * len(names)
        datasets = [_dataset(file, recording, row, step) for row, step in enumerate(steps)]
        for start, block in recording.blocks(_BLOCK):
            for dataset, values, step in zip(datasets, block, steps, strict=True):
                dataset[start : start + len(values)] = values if step is None else np.round(values / step)


def _dataset(file: h5py.File, recording: Recording, row: int, step: float | None) -> h5py.Dataset:
    channel, length = recording.channels[row], recording.samples.shape[1]
    dtype = np.float64 if step is None else np.int16
    if step is not None and max(np.max(np.abs(block[row])) for _, block in recording.blocks()) / step > 32767:
        dtype = np.int32
    dataset = file.create_dataset(
        f"channels/{channel.name}",
        shape=(length,),
        dtype=dtype,
        chunks=(CHUNK,),  # also where the recording is shorter: one chunk
        maxshape=(None,),
        shuffle=True,
        compression="gzip",
        compression_opts=1,
        track_times=False,
    )
    dataset.attrs["unit"] = channel.unit
    dataset.attrs["quantity"] = channel.quantity
    dataset.attrs["dof"] = channel.dof
    if step is not None:
        dataset.attrs["scale"] = step
    if channel.full_scale is not None:
        dataset.attrs["full_scale"] = float(channel.full_scale)
    if channel.quantity == "force":
        dataset.attrs["acts_on"] = "tool"
    if channel.role is not None:
        dataset.attrs["role"] = channel.role
    if channel.delay:
        dataset.attrs["delay_s"] = float(channel.delay)
    return dataset


def _steps(recording: Recording) -> list[float | None]:
    """The step of which all values of a channel are multiples, None where there is none."""
    first = np.asarray(recording.block(0, min(1 << 20, recording.samples.shape[1])))
    return [_step(values, recording, row) for row, values in enumerate(first)]


def _step(values: np.ndarray, recording: Recording, row: int) -> float | None:
    levels = np.unique(values)
    if len(levels) < 2:
        return None
    largest = float(np.max(np.abs(levels)))
    steps = np.diff(levels)
    smallest = float(steps[steps > 1e-12 * largest].min(initial=np.inf))
    # Differences carry the rounding of large values; the mean over the whole range does not.
    span = float(levels[-1] - levels[0])
    step = span / max(round(span / smallest), 1)
    for _, block in recording.blocks():
        counts = block[row] / step
        whole = np.round(counts)
        if np.max(np.abs(counts - whole)) > 1e-6 or np.max(np.abs(whole)) > _LARGEST_COUNT:
            return None
    return step
