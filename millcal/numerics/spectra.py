"""Harmonics of a known fundamental by least squares, its frequency, the average period, and the residual.

Nothing is resampled. With `cycle` the fundamental in cycles per sample, the model y_n = sum over k = -K..K of
a_k exp(2 pi j k cycle n) has normal equations whose matrix is known in closed form (a Dirichlet kernel, so Toeplitz) and
whose right-hand side is one pass over the samples: O(n K), in blocks, for any number of samples per period.

Signals come as a reader, `read(start, stop)` -> (channel, stop - start), so that they may stay on disk. Harmonics are
one-sided and complex: y = Re sum_k c_k exp(j k theta), with c_0 the mean.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

Reader = Callable[[int, int], np.ndarray]

CHUNK = 4096  # samples per matrix product: the table of exponentials stays in the cache


def reader_of(samples: np.ndarray) -> Reader:
    """A reader of samples in memory.   samples : (channel, sample)"""
    return lambda start, stop: samples[:, start:stop]


def buffered(read: Reader, length: int, size: int = 1 << 18) -> Reader:
    """The same reader, asked for large blocks while small ones are served from the last of them.   length : of the signal"""
    first, block = 0, np.empty((0, 0))

    def read_buffered(start: int, stop: int) -> np.ndarray:
        nonlocal first, block
        if not first <= start <= stop <= first + block.shape[1]:
            first, block = start, read(start, min(max(stop, start + size), length))
        return block[:, start - first : stop - first]

    return read_buffered


def _table(cycle: float, harmonics: int, length: int) -> np.ndarray:
    """cos k theta and -sin k theta at the samples 0..length, side by side.   returns (length, 2 (K + 1))"""
    turn = _rotation(cycle, harmonics, np.arange(length))
    return np.concatenate([turn.real, turn.imag], axis=1)


def _rotation(cycle: float, harmonics: int, sample: float | np.ndarray) -> np.ndarray:
    """exp(-j k theta) at the samples.   sample : (...)   returns (..., K + 1)"""
    turns = np.multiply.outer(np.asarray(sample) * cycle % 1.0, np.arange(harmonics + 1))
    return np.exp(-2j * np.pi * turns)


def _normal_matrix(cycle: float, harmonics: int, length: int) -> np.ndarray:
    """sum over n < length of exp(j (l - k) theta_n).   returns (k, l), k and l in -K..K"""
    x = np.arange(1, 2 * harmonics + 1) * cycle
    dirichlet = np.sin(np.pi * (x * length % 2.0)) / np.sin(np.pi * x) * np.exp(1j * np.pi * (x * (length - 1) % 2.0))
    sums = np.concatenate([[float(length)], dirichlet])
    order = np.arange(-harmonics, harmonics + 1)
    lag = order[np.newaxis, :] - order[:, np.newaxis]
    return np.where(lag >= 0, sums[np.abs(lag)], sums[np.abs(lag)].conj())


def block_harmonics(read: Reader, edges: np.ndarray, cycle: float, harmonics: int) -> np.ndarray:
    """Harmonics 0..K of each block of samples by least squares, with theta = 0 at the sample edges[0].

    The blocks need not hold whole periods, but each must hold more samples than 2K + 1 and about one period.

    edges : (block + 1,) ascending sample indices   cycle : cycles per sample, with K cycle < 1/2
    returns (block, channel, K + 1) complex
    """
    edges = np.asarray(edges, dtype=np.int64)
    lengths = np.diff(edges)
    K = harmonics
    table = _table(cycle, K, int(min(lengths.max(), CHUNK)))
    solve: dict[int, np.ndarray] = {}
    found = []
    for start, length in zip(edges[:-1], lengths, strict=True):
        sums: np.ndarray | float = 0.0
        for at in range(start, start + length, CHUNK):
            y = read(at, min(at + CHUNK, start + length))
            part = y @ table[: y.shape[1]]
            sums = sums + (part[:, : K + 1] + 1j * part[:, K + 1 :]) * _rotation(cycle, K, at - start)
        sums = np.asarray(sums)
        if int(length) not in solve:
            solve[int(length)] = np.linalg.inv(_normal_matrix(cycle, K, int(length)))
        right = np.concatenate([sums[:, :0:-1].conj(), sums], axis=1)  # the samples are real
        one_sided = (right @ solve[int(length)].T)[:, K:]
        one_sided[:, 0] = one_sided[:, 0].real
        one_sided[:, 1:] *= 2.0
        found.append(one_sided * _rotation(cycle, K, start - edges[0]))
    return np.array(found)


def fit_harmonics(read: Reader, start: int, stop: int, cycle: float, harmonics: int) -> np.ndarray:
    """Harmonics 0..K by least squares over the samples start..stop, theta = 0 at start.   returns (channel, K + 1)"""
    return block_harmonics(read, np.array([start, stop]), cycle, harmonics)[0]


def evaluate(harmonics: np.ndarray, cycle: float, first: int, length: int) -> np.ndarray:
    """Re sum_k c_k exp(j k theta) at the samples first..first + length, theta = 0 at sample 0.

    harmonics : (channel, K + 1)   returns (channel, length)
    """
    K = harmonics.shape[1] - 1
    table = _table(cycle, K, min(length, CHUNK))
    y = np.empty((harmonics.shape[0], length))
    for at in range(0, length, CHUNK):
        here = harmonics * _rotation(cycle, K, first + at).conj()
        size = min(CHUNK, length - at)
        y[:, at : at + size] = np.concatenate([here.real, here.imag], axis=1) @ table[:size].T
    return y


def turned(harmonics: np.ndarray, phase: float) -> np.ndarray:
    """The harmonics of the same signal in an angle that is greater by `phase` (rad).   harmonics : (channel, K + 1)"""
    return harmonics * np.exp(-1j * phase * np.arange(harmonics.shape[1]))


def mean_of(read: Reader, start: int, stop: int, size: int = 1 << 16) -> np.ndarray:
    """Mean of every sample.   returns (channel,)"""
    total = sum(read(at, min(at + size, stop)).sum(axis=1) for at in range(start, stop, size))
    return np.asarray(total) / (stop - start)


def residuals(
    read: Reader, start: int, stop: int, cycle: float, harmonics: np.ndarray, size: int = 1 << 16
) -> Iterator[tuple[int, np.ndarray]]:
    """What the harmonics leave of the samples, block by block: (index after start, (channel, size))."""
    for at in range(start, stop, size):
        y = read(at, min(at + size, stop))
        yield at - start, y - evaluate(harmonics, cycle, at - start, y.shape[1])


def search_cycle(samples: np.ndarray, cycle: float, *, span: float = 0.1, harmonics: int = 12) -> float:
    """The fundamental near a stated one, by the sum of the power at its harmonics; good to a fraction of a bin.

    Lines of the true fundamental are all caught only there; between equals the one nearer to the stated one is taken.

    samples : (channel, sample), some tens of periods   cycle : cycles per sample   span : relative, to either side
    """
    n = samples.shape[1]
    K = max(1, min(harmonics, int(0.5 / (cycle * (1 + span)))))
    size = 1 << int(np.ceil(np.log2(8 * n)))
    windowed = (samples - samples.mean(axis=1, keepdims=True)) * np.hanning(n)
    power = np.sum(np.abs(np.fft.rfft(windowed, size)) ** 2, axis=0)
    steps = int(np.ceil(span * cycle * 4 * n * K))
    candidates = cycle * (1 + span * np.arange(-steps, steps + 1) / steps)
    bins = np.rint(np.multiply.outer(candidates, np.arange(1, K + 1)) * size).astype(int)
    score = power[np.minimum(bins, len(power) - 1)].sum(axis=1)
    score *= 1 - 0.02 * np.abs(candidates / cycle - 1) / span
    return float(candidates[np.argmax(score)])


class Cycle(NamedTuple):
    """A fundamental in cycles per sample and its standard deviation."""

    cycle: float
    sd: float


def refine_cycle(
    read: Reader, start: int, stop: int, cycle: float, *, harmonics: int = 12, segments: int = 64
) -> Cycle:
    """The fundamental that maximises the power of its harmonics over the samples start..stop.

    The harmonics of segments turn by 2 pi k (error) per sample from one to the next; Newton's method on the power of their
    turned-back sum, repeated at the corrected fundamental, ends at the maximum over the samples themselves. The start must
    be right to about half a period of the highest harmonic over one segment. The standard deviation comes from the scatter
    of the segments' pulls, so it needs no white noise.
    """
    K = max(1, min(harmonics, int(0.49 / cycle)))
    count = int(np.clip((stop - start) * cycle, 2, segments))
    edges = np.rint(np.linspace(start, stop, count + 1)).astype(np.int64)
    time = (edges[:-1] + edges[1:] - start - stop) / 2
    rate = 2 * np.pi * np.multiply.outer(time, np.arange(1, K + 1))[:, np.newaxis, :]  # rad per unit of cycle
    sd = np.inf
    steps = 2 * count  # reach the turn that segments can tell from its opposite
    for _ in range(12):
        found = block_harmonics(read, edges, cycle, K)[:, :, 1:]  # (segment, channel, harmonic)
        error = _common_turn(found, rate, 0.25 / K / (stop - start), steps)
        steps = 1
        found = found * np.exp(-1j * error * rate)
        mean = found.mean(axis=0)
        pull = np.sum((mean.conj() * found).imag * rate, axis=(1, 2))
        stiffness = np.sum(np.abs(mean) ** 2 * rate**2)
        if stiffness > 0:
            sd = float(np.sqrt(np.sum(pull**2) * count / max(count - 2, 1)) / stiffness)
        cycle += error
        if abs(error) <= max(1e-11 * cycle, 1e-4 * sd):
            break
    return Cycle(cycle, sd)


def _common_turn(found: np.ndarray, rate: np.ndarray, spacing: float, steps: int) -> float:
    """The x that maximises sum |sum over segments of found exp(-j x rate)|^2: trials to either side, then Newton.

    found : (segment, channel, harmonic)   rate : (segment, 1, harmonic)
    """
    trials = spacing * np.arange(-steps, steps + 1)
    power = [np.sum(np.abs(np.sum(found * np.exp(-1j * x * rate), axis=0)) ** 2) for x in trials]
    x = float(trials[int(np.argmax(power))])
    for _ in range(20):
        c = found * np.exp(-1j * x * rate)
        total, slope, bend = c.sum(axis=0), (-1j * rate * c).sum(axis=0), -((rate**2) * c).sum(axis=0)
        first = np.sum((total.conj() * slope).real)
        second = np.sum(np.abs(slope) ** 2 + (total.conj() * bend).real)
        if second >= 0:  # not near a maximum: no signal
            return x
        step = float(np.clip(-first / second, -spacing, spacing))
        x += step
        if abs(step) <= 1e-9 * spacing:
            break
    return x


class PeriodAverage(NamedTuple):
    """The average over the periods on a grid of angles, and what scatters about it."""

    angle: np.ndarray  # (angle,) rad, 0 .. 2 pi
    average: np.ndarray  # (channel, angle)
    scatter: np.ndarray  # (channel, angle), standard deviation of a sample at that angle
    power: np.ndarray  # (channel,), mean square about the mean
    residual_power: np.ndarray  # (channel,), mean square of what the harmonics leave


def average_periods(
    read: Reader, start: int, stop: int, cycle: float, harmonics: np.ndarray, *, phase: float = 0.0, angles: int = 360
) -> PeriodAverage:
    """Synchronous average: the harmonics, plus the mean of their residual in bins of angle.

    Only the small residual is binned, so neither interpolation nor the slope of the signal within a bin spoils it.

    harmonics : (channel, K + 1) with theta = 0 at start   phase : rad, theta there in the angle of the result
    angles : wished; never more than samples per period, so that no bin is empty
    """
    bins = max(1, min(angles, int(1 / cycle)))
    channels = harmonics.shape[0]
    count, total, square = np.zeros(bins), np.zeros((channels, bins)), np.zeros((channels, bins))
    alternating = np.array(harmonics)
    alternating[:, 0] = 0.0
    power, mean = np.zeros(channels), np.zeros(channels)  # about harmonic 0, which is close to the mean
    for at, rest in residuals(read, start, stop, cycle, harmonics):
        swing = rest + evaluate(alternating, cycle, at, rest.shape[1])
        power += np.sum(swing**2, axis=1) / (stop - start)
        mean += np.sum(swing, axis=1) / (stop - start)
        turn = (at + np.arange(rest.shape[1])) * cycle + phase / (2 * np.pi)
        index = np.rint(turn % 1.0 * bins).astype(np.int64) % bins
        count += np.bincount(index, minlength=bins)
        for channel in range(channels):
            total[channel] += np.bincount(index, rest[channel], bins)
            square[channel] += np.bincount(index, rest[channel] ** 2, bins)
    seen = np.maximum(count, 1)
    binned = total / seen
    spread = np.sqrt(np.maximum(square / seen - binned**2, 0.0) * seen / np.maximum(seen - 1, 1))
    model = evaluate(turned(harmonics, phase), 1 / bins, 0, bins)
    angle = 2 * np.pi * np.arange(bins) / bins
    return PeriodAverage(angle, model + binned, spread, power - mean**2, square.sum(axis=1) / (stop - start))
