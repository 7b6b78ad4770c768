"""A long record revolution by revolution: how strong each is, the envelope of all, and where a level holds."""

from typing import NamedTuple

import numpy as np

from millcal.numerics.spectra import Reader

Samples = tuple[int, int]  # start, stop

OVERVIEW_POINTS = 2000
WHOLE_RECORD = 1 << 21  # samples that may stay in memory at once; of a longer record, blocks of a sixteenth


def block_size(length: int, channels: int = 3) -> int:
    """Samples to hold at once of a record of this length; as many of more than three channels as of three."""
    share = max(channels / 3, 1.0)
    return length if length * share <= WHOLE_RECORD else int(WHOLE_RECORD / 16 / share)


class Survey(NamedTuple):
    """One look at every sample."""

    edges: np.ndarray  # (revolution + 1,) samples, at the stated speed
    strength: np.ndarray  # (revolution,) N, AC rms of the axes together; nan where a sample is no number
    time: np.ndarray  # (overview,) samples
    low: np.ndarray  # (axis, overview) N
    high: np.ndarray  # (axis, overview) N
    mean: np.ndarray  # (axis, revolution) N


def survey_record(read: Reader, length: int, samples_per_revolution: float) -> Survey:
    """AC rms of every revolution, which knows no offset and no drift, and the envelope of the whole record.

    A sample on the border of two revolutions is shared between them, or else the strength of a perfectly steady cut would
    swing with the number of samples in a revolution.
    """
    exact = np.minimum(np.arange(0, length + 0.5, samples_per_revolution), length)
    edges = np.rint(exact).astype(np.int64)
    channels = len(read(0, 1))
    moments = np.zeros((2, channels, len(edges)))  # sum and sum of squares; the last is a part of a revolution
    width = max(1, -(-length // OVERVIEW_POINTS))
    low, high = [], []
    level: np.ndarray | None = None
    size = max(1, block_size(length, channels) // width) * width
    for start in range(0, length, size):
        before = min(start, 1)  # one sample of the block before, for the borders
        y = read(start - before, min(start + size, length))
        bins = np.arange(before, y.shape[1], width)
        low.append(np.fmin.reduceat(y, bins, axis=1))
        high.append(np.fmax.reduceat(y, bins, axis=1))
        if level is None:  # near the mean, so that a large offset costs no digits
            level = _finite_level(y[:, :1000])
        y = y - level
        powers = np.stack([y, y**2])
        borders = np.flatnonzero((edges >= max(start, 1)) & (edges < start - before + y.shape[1]))
        cuts = np.unique(np.concatenate([[start], edges[borders]]))
        turn = np.searchsorted(edges, cuts, "right") - 1
        moments[:, :, turn] += np.add.reduceat(powers, cuts - start + before, axis=2)
        late = exact[borders] - edges[borders]  # share of the sample after the border that belongs before it; < 0: back
        at = edges[borders] - start + before - (late < 0)
        moments[:, :, borders] -= late * powers[:, :, at]
        moments[:, :, borders - 1] += late * powers[:, :, at]
    mean, square = moments[:, :, :-1] / np.diff(exact)
    middle = np.minimum(np.arange(0, length, width) + (width - 1) / 2, length - 1)
    return Survey(
        edges,
        np.sqrt(np.maximum(square - mean**2, 0.0).sum(axis=0)),
        middle,
        np.concatenate(low, axis=1),
        np.concatenate(high, axis=1),
        mean + level,
    )


def _finite_level(y: np.ndarray) -> np.ndarray:
    """About the mean of each row, 0 where nothing is a number.   returns (row, 1)"""
    finite = np.isfinite(y)
    return np.where(finite, y, 0.0).sum(axis=1, keepdims=True) / np.maximum(finite.sum(axis=1, keepdims=True), 1)


def densest_half(values: np.ndarray) -> tuple[float, float]:
    """Level and spread of the shortest interval with half of the values: ramps and bursts do not move it.

    returns (level, standard deviation if they were normal)
    """
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
    at = int(np.argmin(widths))
    return float(ordered[at : at + half].mean()), float(widths[at] / 1.349)


def stretches(mask: np.ndarray, bridge: int = 0) -> list[Samples]:
    """Runs of True, with gaps of up to `bridge` closed: (first, last + 1)."""
    steps = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    found: list[Samples] = []
    for low, high in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1), strict=True):
        if found and low - found[-1][1] <= bridge:
            found[-1] = (found[-1][0], int(high))
        else:
            found.append((int(low), int(high)))
    return found


def longest(runs: list[Samples]) -> Samples:
    return max(runs, key=lambda run: run[1] - run[0])
