"""How the tool meets the work at every sample of a cut: by its conditions, or by an engagement table along its path."""

from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import block_size
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.tool_path import ToolPath

FEED_OVER = 3  # revolutions over which the feed is taken from the position
PATH_DOF = "path"


class AtSamples(NamedTuple):
    """Feed per tooth, depth, entry, exit and feed direction at every sample, SI, (sample,) each."""

    feed_per_tooth: np.ndarray
    axial_depth: np.ndarray
    entry: np.ndarray
    leave: np.ndarray
    feed_direction: np.ndarray


def constant_engagement(cutter: Cutter, conditions: CuttingConditions, length: int) -> AtSamples:
    """The conditions at every sample."""
    values = (conditions.feed_per_tooth, conditions.axial_depth, *engagement(conditions, cutter.diameter), 0.0)
    return AtSamples(*(np.full(length, value) for value in values))


def engagement_along(
    recording: Recording,
    path: ToolPath,
    path_start: float | None,
    samples: tuple[int, int],
    revolution: float,
    where: str,
) -> AtSamples:
    """The rows of an engagement table by where the tool is at each sample.

    The place comes from a channel of displacement whose dof is `path`, else from the feed rate and the moment the path begins.
    The feed per tooth is that of the table, else the way of some revolutions from that channel, else the conditions'.

    path_start : s after the first sample of the recording   revolution : samples
    """
    start, stop = samples
    cutter, conditions = recording.cutter, recording.conditions
    spindle = conditions.spindle_speed / (2 * np.pi)
    per_second = cutter.teeth * spindle  # teeth passing
    stated = conditions.feed_per_tooth * per_second
    at_rows = path.feed_rate if path.feed_rate is not None else np.full(len(path.position), stated)
    if path.feed_per_tooth is not None:
        at_rows = path.feed_per_tooth * per_second
    row = next((r for r in recording.rows_of("displacement") if recording.channels[r].dof.lower() == PATH_DOF), None)
    measured = per_revolution = None
    if row is not None:
        around = round(FEED_OVER * revolution / 2) + 1
        first, last = max(start - around, 0), min(stop + around, recording.samples.shape[1])
        way = _channel(recording, row, first, last)
        _refuse_what_is_no_number(way, first, recording, where)
        measured = way[start - first : stop - first]
        per_revolution = _way_of_revolutions(way, revolution, FEED_OVER)[start - first : stop - first]
        position = measured
    elif path_start is None:
        raise RecordingError(
            f"{where}: an engagement table, and nothing says where on the path the tool is; give path_start_s, or a "
            f'channel of displacement with dof = "{PATH_DOF}"'
        )
    else:
        position = path.position_after(np.arange(start, stop) / recording.sample_rate - path_start, at_rows)
    position = _within(path, position, float(at_rows.max()) / spindle, samples, recording.sample_rate, where)
    found = path.at(position)
    if found.feed_per_tooth is not None:
        feed = found.feed_per_tooth
    elif found.feed_rate is not None:
        feed = found.feed_rate / per_second
    elif per_revolution is not None:
        feed = np.maximum(per_revolution, 0.0) / cutter.teeth
    else:
        feed = np.full(stop - start, conditions.feed_per_tooth)
    return AtSamples(feed, found.axial_depth, found.entry, found.leave, found.feed_direction)


def _channel(recording: Recording, row: int, start: int, stop: int) -> np.ndarray:
    size = block_size(stop - start)
    blocks = [np.asarray(recording.block(at, min(at + size, stop), [row]))[0] for at in range(start, stop, size)]
    return np.concatenate(blocks)


def _refuse_what_is_no_number(way: np.ndarray, first: int, recording: Recording, where: str) -> None:
    bad = np.flatnonzero(~np.isfinite(way))
    if len(bad):
        raise RecordingError(
            f"{where}: the position along the path is no number at {(first + bad[0]) / recording.sample_rate:g} s, within "
            "the cut; mend the channel, or leave it out and give path_start_s"
        )


def _way_of_revolutions(way: np.ndarray, revolution: float, over: int) -> np.ndarray:
    """Way per revolution about every sample, over some revolutions, fewer at the ends.   returns (sample,) m"""
    half = max(round(over * revolution / 2), 1)
    index = np.arange(len(way))
    low, high = np.maximum(index - half, 0), np.minimum(index + half, len(way) - 1)
    return (way[high] - way[low]) / np.maximum(high - low, 1) * revolution


def _within(
    path: ToolPath, position: np.ndarray, slack: float, samples: tuple[int, int], rate: float, where: str
) -> np.ndarray:
    """Places within the table; those beyond by up to a revolution's feed, `slack`, are taken for its ends."""
    begin, end = path.span
    for beyond, side, at in ((begin - position, "begins", begin), (position - end, "ends", end)):
        far = np.flatnonzero(beyond > slack * (1 + 1e-9))
        if len(far):
            index = far[np.argmax(beyond[far])]
            raise RecordingError(
                f"{path.name or where}: the table {side} at {1e3 * at:g} mm, and the cut is at {1e3 * position[index]:.4g} mm "
                f"{(samples[0] + index) / rate:.4g} s after the first sample of {where}; let it cover the whole cut, or "
                "correct path_start_s and the feed"
            )
    return np.clip(position, begin, end)
