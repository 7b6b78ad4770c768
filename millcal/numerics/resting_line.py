"""The level that a channel rests on about a hit: a constant, or a straight line where it is seen to drift.

A slope is believed when it is eight times its own scatter, which is taken from means of pieces of the rest, so that slow
noise and a decay that is not over count as well as white noise. Where the pieces lie on no line, the rest is bent.
"""

from typing import NamedTuple

import numpy as np

PIECES = 8  # of the rest on one side
FEWEST = 64  # samples of a rest that a mean is taken of
SURE = 8.0  # standard deviations of a slope
STRAIGHT = 0.05  # of the drift, by which its pieces may leave the line
SMALL = 1e-4  # share of the peak below which a drift does no harm


class RestingLine(NamedTuple):
    """Where each channel rests. `slope` is 0 where no drift is seen."""

    value: np.ndarray  # (channel,) at the reference sample
    slope: np.ndarray  # (channel,) per sample
    reference: int  # sample
    change: np.ndarray  # (channel,) over the stretch, by the slope
    bend: np.ndarray  # (channel,) by which a rest that is on no line leaves its first level, 0 elsewhere

    def over(self, start: int, stop: int) -> np.ndarray:
        """The line over some samples.   returns (channel, stop - start), or (channel, 1) where nothing drifts"""
        if not self.slope.any():
            return self.value[:, None]
        return self.value[:, None] + self.slope[:, None] * (np.arange(start, stop) - self.reference)


def resting_line(
    samples: np.ndarray, before: int, after: int, reference: int, size: np.ndarray
) -> tuple[RestingLine, np.ndarray, np.ndarray]:
    """Rest of channels that answer a hit, whose end may still ring.

    samples : (channel, n)   before : rest up to this sample   after : rest from this sample on, perhaps
    reference : sample of the hit   size : (channel,) the largest value
    returns the line, and the standard deviations of the two rests (channel,), nan where there are too few samples
    """
    n = samples.shape[1]
    head, tail = samples[:, :before], samples[:, after:]
    enough = before >= FEWEST
    head_mean = head.mean(axis=1) if enough else None
    head_noise = head.std(axis=1) if enough else np.full(len(samples), np.nan)
    tail_noise = tail.std(axis=1)
    piece = tail.shape[1] // PIECES
    used = tail[:, tail.shape[1] - PIECES * piece :].reshape(len(samples), PIECES, piece)
    means = used.mean(axis=2)
    times = n - piece * (PIECES - np.arange(PIECES)) + 0.5 * (piece - 1)
    counts = np.full(PIECES, float(piece))
    if head_mean is not None:
        means = np.concatenate([head_mean[:, None], means], axis=1)
        times, counts = np.concatenate([[0.5 * (before - 1)], times]), np.concatenate([[float(before)], counts])
    variance = np.maximum(tail_noise**2 - means[:, -PIECES:].var(axis=1), 0.0)
    value, slope, bend = _line(times, counts, means, variance, reference, n, size)
    plain = head_mean if head_mean is not None else tail.mean(axis=1)
    line = RestingLine(np.where(slope != 0, value, plain), slope, reference, slope * n, bend)
    if slope.any():
        tail_noise = np.where(slope != 0, (tail - line.over(after, n)).std(axis=1), tail_noise)
        if enough:
            head_noise = np.where(slope != 0, (head - line.over(0, before)).std(axis=1), head_noise)
    return line, head_noise, tail_noise


def resting_line_beside(
    samples: np.ndarray, gap: tuple[int, int], reference: int, size: np.ndarray
) -> tuple[RestingLine, np.ndarray]:
    """Rest of channels that are at rest before and after a gap: the hammer. Where it bends, the line through what is right
    beside the gap counts, and `bend` is the step across.

    samples : (channel, n)   gap : first and after-last sample that is not at rest   returns line, standard deviation
    """
    n, (low, high) = samples.shape[1], gap
    left, right = samples[:, :low], samples[:, high:]
    if low + n - high < FEWEST:
        nothing = np.zeros(len(samples))
        return RestingLine(nothing, nothing, reference, nothing, nothing), np.full(len(samples), np.nan)
    count = low + n - high
    mean = (left.sum(axis=1) + right.sum(axis=1)) / count
    variance = (_squares(left, mean) + _squares(right, mean)) / count
    noise = np.sqrt(variance)
    sides = [_pieces(left, 0), _pieces(right, high)]
    times, counts, means = (np.concatenate([side[i] for side in sides], axis=-1) for i in range(3))
    if len(times) < 4:
        nothing = np.zeros(len(samples))
        return RestingLine(mean, nothing, reference, nothing, nothing), noise
    within = np.maximum(variance - (means - mean[:, None]) ** 2 @ counts / counts.sum(), 0.0)
    value, slope, bend = _line(times, counts, means, within, reference, n, size)
    if (bend > 0).any():
        value, slope, bend = _local(samples, gap, reference, value, slope, bend)
    drifts = (slope != 0) & (bend == 0)
    line = RestingLine(
        np.where(drifts | (bend > 0), value, mean), slope, reference, np.where(drifts, slope * n, 0.0), bend
    )
    if drifts.any():
        off = np.concatenate([left - line.over(0, low), right - line.over(high, n)], axis=1)
        noise = np.where(drifts, off.std(axis=1), noise)
    return line, np.where(bend > 0, np.sqrt(within), noise)


def _pieces(side: np.ndarray, start: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles, counts and means of the pieces of one side.   side : (channel, n)   returns (piece,), (piece,), (channel, piece)"""
    number = min(PIECES, side.shape[1] // (FEWEST // 2))
    if not number:
        return np.zeros(0), np.zeros(0), np.zeros((len(side), 0))
    size = side.shape[1] // number
    means = side[:, : number * size].reshape(len(side), number, size).mean(axis=2)
    return start + size * np.arange(number) + 0.5 * (size - 1), np.full(number, float(size)), means


def _local(
    samples: np.ndarray, gap: tuple[int, int], reference: int, value: np.ndarray, slope: np.ndarray, bend: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, slope and bend of the channels that bend by what is right beside the gap; the others stay.

    The bend is then the step across the gap, which no sound channel has.
    """
    low, high = gap
    width = max(FEWEST // 2, high - low)
    before, after = samples[:, max(0, low - width) : low], samples[:, high : high + width]
    if min(before.shape[1], after.shape[1]) < FEWEST // 2:
        one = before if before.shape[1] > after.shape[1] else after
        return np.where(bend > 0, one.mean(axis=1), value), np.where(bend > 0, 0.0, slope), bend
    first, last = low - 0.5 * (before.shape[1] + 1), high + 0.5 * (after.shape[1] - 1)
    step = after.mean(axis=1) - before.mean(axis=1)
    here = before.mean(axis=1) + step * (reference - first) / (last - first)
    return (
        np.where(bend > 0, here, value),
        np.where(bend > 0, step / (last - first), slope),
        np.where(bend > 0, np.maximum(np.abs(step), 1e-300), bend),
    )


def _squares(samples: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Sum of squares about a mean.   samples : (channel, n)"""
    return np.einsum("cn,cn->c", samples, samples) - 2 * mean * samples.sum(axis=1) + mean**2 * samples.shape[1]


def _line(
    times: np.ndarray,
    counts: np.ndarray,
    means: np.ndarray,
    variance: np.ndarray,
    reference: int,
    n: int,
    size: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value at the reference, slope and bend of the line through means of pieces.

    times, counts : (piece,)   means : (channel, piece)   variance : (channel,) of the samples within pieces
    """
    total = counts.sum()
    middle = float(counts @ times) / total
    away = times - middle
    spread = float(counts @ away**2)
    mean = means @ counts / total
    slope = (means - mean[:, None]) @ (counts * away) / spread
    off = means - mean[:, None] - slope[:, None] * away
    scatter = off**2 @ counts / (len(times) - 2)
    seen = (np.abs(slope) > SURE * np.sqrt(np.maximum(scatter, variance) / spread)) & (np.abs(slope) * n > SMALL * size)
    leaves = np.abs(off).max(axis=1)
    crooked = (scatter > 9.0 * variance) & (leaves > np.maximum(SMALL * size, STRAIGHT * np.abs(slope) * n))
    bend = np.where(crooked, np.abs(means - means[:, :1]).max(axis=1), 0.0)
    slope = np.where(seen & ~crooked, slope, 0.0)
    return mean + slope * (reference - middle), slope, bend
