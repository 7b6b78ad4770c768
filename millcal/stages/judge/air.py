"""Which turns of a recording are of the cut, and which of the air beside it.

Chatter grows, the mains hum and the machine sounds in the air as well, so loud and quiet tell little. What enters and leaves with
the tool are the harmonics of the teeth and what is heard between them. Each harmonic and each band is measured against its own
quiet level in the record, so that one line of hum does not hide the others; and where the quiet turns show the harmonics too,
they are a cut that has not yet begun to chatter, and no air.
"""

import numpy as np

from millcal.numerics.revolutions import Survey
from millcal.numerics.spectra import Reader

HARMONICS = 20  # of the teeth
BANDS, LOWEST = 16, 0.5  # of all frequencies, from this share of the tooth passing on
ASTRAY = 0.012  # relative, by which the stated speed may be off
QUIET, TOGETHER = 0.02, 3  # quantile of the frames, some taken together, that is the quiet level of a harmonic
PARTED = 2.5  # times as strong the harmonics are in the cut, in the mean of either
FEWEST = 6  # turns that are parted
SEEN, LARGE = 8.0, 0.01  # a harmonic over its surroundings, and over the largest, from which it is seen
AS_STRONG = 1e-3  # power of a harmonic where a cut is gentle, over that where it chatters
SHARE_SEEN = 0.5  # of the harmonics of the cut, from which quiet turns with these are of a cut
TIMES = 3  # that the quiet turns are parted again


def turns_of_the_cut(read: Reader, survey: Survey, cycle: float, teeth: int, frame: int) -> np.ndarray:
    """The revolutions in which the tool cuts.   returns bool (revolution,)

    cycle : turns per sample   frame : turns of one spectrum
    """
    strength = survey.strength
    usable = np.isfinite(strength) & (strength > 0)
    size, turns = round(frame / cycle), len(strength)
    starts = np.arange(0, int(survey.edges[-1]) - size + 1, max(size // 2, 1))
    order = np.arange(1, HARMONICS + 1) * teeth
    order = order[order * cycle < 0.45]
    if usable.sum() < FEWEST or len(starts) < 4 or not len(order):
        return usable
    line, level, band = _lines(read, starts, size, order * cycle * size, teeth * cycle * size)
    heard = np.concatenate([line, band], axis=1)
    together = np.lib.stride_tricks.sliding_window_view(heard, TOGETHER, axis=0).mean(axis=-1)
    quiet = np.maximum(np.quantile(together, QUIET, axis=0), 1e-12 * heard.max(axis=0))
    over = np.log(np.sum(heard / np.maximum(quiet, 1e-300), axis=1) + 1e-300) / 2
    at = (starts + size / 2) * cycle - 0.5
    over = np.interp(np.arange(turns), at, over)
    nearest = np.abs(np.arange(turns)[:, np.newaxis] - at).argmin(axis=1)
    candidates = usable.copy()
    for _ in range(TIMES):
        weak = _weaker(over, candidates)
        if weak is None:
            break
        strong = usable & ~weak
        if not _seen_alike(line, level, np.unique(nearest[weak]), np.unique(nearest[strong])):
            return strong
        candidates = weak  # a cut that is gentle there; beside it may be air
    return usable


def _lines(
    read: Reader, starts: np.ndarray, size: int, middle: np.ndarray, apart: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Power of each harmonic in each frame, all channels together, the median of what surrounds it, both (frame, harmonic), and
    the power in bands of all frequencies (frame, band).

    middle : (harmonic,) lines   apart : lines from one harmonic of the teeth to the next
    """
    window = np.hanning(size + 1)[:-1]
    reach = np.minimum(np.maximum(1.0, ASTRAY * middle), 0.3 * apart)
    low, high = np.floor(middle - reach).astype(int), np.ceil(middle + reach).astype(int) + 1
    half = max(apart / 2, 3.0)
    line, level = np.empty((2, len(starts), len(middle)))
    edges = np.unique(np.geomspace(max(LOWEST * apart, 2.0), 0.45 * size, BANDS + 1).astype(int))
    band = np.empty((len(starts), len(edges) - 1))
    for i, start in enumerate(starts):
        y = np.nan_to_num(read(int(start), int(start) + size))
        power = (np.abs(np.fft.rfft((y - y.mean(axis=1, keepdims=True)) * window)) ** 2).sum(axis=0)
        for k, (a, b) in enumerate(zip(low, high, strict=True)):
            line[i, k] = power[max(a, 1) : b].max()
            level[i, k] = np.median(power[max(int(middle[k] - half), 1) : int(middle[k] + half) + 1])
        band[i] = np.add.reduceat(power[: edges[-1]], edges[:-1]) if len(edges) > 1 else 0.0
    return line, level, band


def _weaker(over: np.ndarray, candidates: np.ndarray) -> np.ndarray | None:
    """Of some turns the weaker ones, where they fall into two groups; None where they do not.   returns bool (revolution,)"""
    log = np.sort(over[candidates])
    n = len(log)
    if n < FEWEST:
        return None
    count = np.arange(1, n)
    below = np.cumsum(log)[:-1]
    low, high = below / count, (log.sum() - below) / (n - count)
    at = int(np.argmax(count * (n - count) * (high - low) ** 2))
    if high[at] - low[at] < np.log(PARTED):
        return None
    return candidates & (over <= (low[at] + high[at]) / 2)


def _seen_alike(line: np.ndarray, level: np.ndarray, weak: np.ndarray, strong: np.ndarray) -> bool:
    """Whether the harmonics that stand out in the strong frames do so in the weak ones as well; in the usual one of either, since
    frames on the border hold some of both.
    """
    usual = np.median(line[strong], axis=0)
    seen = (usual > SEEN * np.median(level[strong], axis=0)) & (usual > LARGE * usual.max())
    there = np.median(line[weak] / np.maximum(level[weak], 1e-300), axis=0) > SEEN
    there &= np.median(line[weak], axis=0) > AS_STRONG * usual
    return bool(seen.any() and there[seen].mean() >= SHARE_SEEN)
