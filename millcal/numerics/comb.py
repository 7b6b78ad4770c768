"""The fundamental of a comb of lines, found among lines that belong to no comb.

`spectra.refine_cycle` maximises the power of the harmonics, so a strong tone of its own near the comb draws the fundamental
towards one of which it is a harmonic. Here each harmonic counts by the logarithm of what it stands above its surroundings: ten
small harmonics that agree outweigh one large tone. The frequency is then a weighted mean over the harmonics, each timed by its
own peak; one that does not agree with the others is left out.
"""

from itertools import pairwise

import numpy as np

from millcal.numerics.spectra import Cycle

MOST_SAMPLES = 1 << 22  # of which the spectrum is taken
FIRST_LOOK = 48  # periods; longer stretches follow, four times as long each
CAP = 6.0  # log of the power over the surroundings: beyond, a harmonic counts no more
SKIRT, LINES_OF_SKIRT = 0.05, 8  # of the highest within so many lines: below, it is the foot of that one
NEAR_STATED = 0.2  # of the span: standard deviation of what is stated
STANDS_OUT = 20.0  # power over the surroundings from which a harmonic is timed


def comb_cycle(
    samples: np.ndarray, stated: float, *, harmonics: int = 40, every: int = 1, span: float = 0.03
) -> tuple[Cycle, tuple[int, ...]]:
    """The fundamental near a stated one.

    samples : (channel, sample)   stated : cycles per sample
    harmonics : of the fundamental that are looked at   every : each `every`-th of them counts twice (teeth of a cutter)
    span : how far it may be off, relative, to either side
    returns the cycle with its standard deviation, and the orders of the harmonics that stand out where it says
    """
    samples = np.atleast_2d(samples)
    length = samples.shape[1]
    if length > MOST_SAMPLES:
        first = (length - MOST_SAMPLES) // 2
        samples, length = samples[:, first : first + MOST_SAMPLES], MOST_SAMPLES
    K = max(1, min(harmonics, int(0.48 / (stated * (1 + span)))))
    order = np.arange(1, K + 1)
    weight = np.where(order % every == 0, 2.0, 1.0)
    size, cycle, reach = int(FIRST_LOOK / stated), stated, span * stated
    while True:
        size = min(size, length)
        first = (length - size) // 2
        power, bins = _power(samples[:, first : first + size])
        above = _above_surroundings(power, max(5, int(2 * cycle * bins)))
        steps = int(np.ceil(reach * K * size * 4))
        trial = cycle + reach * np.arange(-steps, steps + 1) / max(steps, 1)
        place = np.clip(np.rint(np.multiply.outer(trial, order) * bins).astype(int), 0, above.shape[1] - 1)
        score = _stands(power, above, round(bins / size))[:, place].sum(axis=0) @ weight
        score -= 0.5 * ((trial - stated) / (NEAR_STATED * span * stated)) ** 2
        cycle = float(trial[np.argmax(score)])
        if size == length:
            break
        reach = 3.0 / (np.sqrt(K) * size)
        size *= 4
    return _timed(power, above, bins, size, cycle, order)


def _power(samples: np.ndarray) -> tuple[np.ndarray, int]:
    """Periodograms of each channel under a Hann window, twice as fine as its lines.   returns (channel, bin), the length"""
    from scipy.fft import next_fast_len

    n = samples.shape[1]
    bins = next_fast_len(2 * n, real=True)
    windowed = (samples - samples.mean(axis=1, keepdims=True)) * np.hanning(n + 1)[:-1]
    return np.abs(np.fft.rfft(windowed, bins)) ** 2, bins


def _above_surroundings(power: np.ndarray, width: int) -> np.ndarray:
    """Power over the median of its surroundings.   power : (channel, bin)   width : bins to be looked at"""
    blocks = max(1, power.shape[1] // width)
    edges = np.linspace(0, power.shape[1], blocks + 1).astype(int)
    level = np.array([np.median(power[:, a:b], axis=1) for a, b in pairwise(edges)]).T
    middle = (edges[:-1] + edges[1:] - 1) / 2
    floor = np.array([np.interp(np.arange(power.shape[1]), middle, row) for row in level])
    return power / np.maximum(floor, 1e-300 + 1e-20 * power.max(axis=1, keepdims=True))


def _stands(power: np.ndarray, above: np.ndarray, half: int) -> np.ndarray:
    """What each bin counts: the log of what it stands above its surroundings, but nothing on the skirt of a higher one, which
    without noise would stand there as well.   half : bins from one line to the next
    """
    from scipy.ndimage import maximum_filter1d

    highest = maximum_filter1d(power, 2 * LINES_OF_SKIRT * half + 1, axis=1)
    counts = np.minimum(np.log(np.maximum(above, 1.0)), CAP)
    return np.where(power < SKIRT * highest, 0.0, counts)


def _timed(
    power: np.ndarray, above: np.ndarray, bins: int, size: int, cycle: float, order: np.ndarray
) -> tuple[Cycle, tuple[int, ...]]:
    """The fundamental from the peaks of the harmonics, and the orders of those that stand out."""
    half = round(bins / size)  # bins from one line to the next
    channel, k, frequency, spread = [], [], [], []
    for row in range(len(power)):
        for n in order:
            at = round(n * cycle * bins)
            low, high = max(at - 2 * half, 1), min(at + 2 * half, power.shape[1] - 2)
            if high <= low:
                continue
            peak = low + int(np.argmax(power[row, low : high + 1]))
            if above[row, peak] < STANDS_OUT or peak in (low, high):
                continue
            left, here, right = np.log(power[row, peak - 1 : peak + 2] + 1e-300)
            bend = left - 2 * here + right
            shift = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else 0.0
            channel.append(row)
            k.append(n)
            frequency.append((peak + shift) / bins)
            spread.append((0.6 / np.sqrt(above[row, peak]) + 0.003) / size)
    found, f, sd = np.array(k, float), np.array(frequency), np.array(spread)
    if not len(found):
        return Cycle(cycle, np.inf), ()
    kept = np.ones(len(found), bool)
    for _ in range(5):
        w = kept / sd**2
        mean = float(np.sum(w * found * f) / np.sum(w * found**2))
        off = (f - found * mean) / sd
        scale = max(1.0, 1.4826 * float(np.median(np.abs(off[kept]))))
        again = np.abs(off) <= 4.0 * scale
        if np.array_equal(again, kept) or again.sum() < min(3, len(found)):
            break
        kept = again
    w = kept / sd**2
    mean = float(np.sum(w * found * f) / np.sum(w * found**2))
    chi2 = float(np.sum(w * (f - found * mean) ** 2)) / max(int(kept.sum()) - 1, 1)
    deviation = np.sqrt(max(chi2, 1.0) / float(np.sum(w * found**2)))
    return Cycle(mean, float(deviation)), tuple(sorted({int(n) for n in found[kept]}))
