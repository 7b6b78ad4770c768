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
    """Rest of channels that are at rest before and after a gap: the hammer. Where it bends, the line through the pieces
    next to the gap counts, and `bend` is how far apart these are.

    samples : (channel, n)   gap : first and after-last sample that is not at rest   returns line, standard deviation
    """
    n, (low, high) = samples.shape[1], gap
    left, right = samples[:, :low], samples[:, high:]
    if low + n - high < FEWEST:
        nothing = np.zeros(len(samples))
        return RestingLine(nothing, nothing, reference, nothing, nothing), np.full(len(samples), np.nan)
    count = low + n - high
    mean = (left.sum(axis=1) + right.sum(axis=1)) / count
    piece = max(FEWEST // 2, count // (2 * PIECES))
    k, m = low // piece, (n - high) // piece
    means = np.concatenate(
        [
            left[:, low - k * piece :].reshape(len(samples), k, piece).mean(axis=2),
            right[:, : m * piece].reshape(len(samples), m, piece).mean(axis=2),
        ],
        axis=1,
    )
    starts = np.concatenate([low - piece * (k - np.arange(k)), high + piece * np.arange(m)])
    times = starts + 0.5 * (piece - 1)
    variance = (_squares(left, mean) + _squares(right, mean)) / count
    noise = np.sqrt(variance)
    if k + m < 4:
        nothing = np.zeros(len(samples))
        return RestingLine(mean, nothing, reference, nothing, nothing), noise
    within = np.maximum(variance - means.var(axis=1), 0.0)
    value, slope, bend = _line(times, np.full(k + m, float(piece)), means, within, reference, n, size)
    if (bend > 0).any() and k and m:
        step = means[:, k] - means[:, k - 1]
        local = step / (times[k] - times[k - 1])
        here = means[:, k - 1] + local * (reference - times[k - 1])
        slope, value = np.where(bend > 0, local, slope), np.where(bend > 0, here, value)
        bend = np.where(bend > 0, np.abs(step), 0.0)
    line = RestingLine(np.where(slope != 0, value, mean), slope, reference, slope * n, bend)
    if slope.any():
        noise = np.where(slope != 0, np.sqrt(within), noise)
    return line, noise


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
