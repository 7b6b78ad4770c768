"""Leading edges of a pulse signal, timed between the samples."""

import numpy as np

from millcal.numerics.spectra import Reader


def pulse_times(read: Reader, start: int, stop: int, size: int = 1 << 18) -> np.ndarray:
    """Times of the leading edges in a one-channel signal.   returns (pulse,) samples after start

    The level that holds for most of the time is the rest. An edge leaves it through the middle, and counts again only after
    the signal has come back to a quarter of the swing from its rest, so that noise on a slow edge makes no second pulse.
    """
    low, high, total = np.inf, -np.inf, 0.0
    for at in range(start, stop, size):
        y = read(at, min(at + size, stop))[0]
        low, high, total = min(low, float(y.min())), max(high, float(y.max())), total + float(y.sum())
    middle, swing = (low + high) / 2, high - low
    if not swing > 0:
        return np.empty(0)
    sign = 1.0 if total / (stop - start) < middle else -1.0
    edges: list[float] = []
    armed, before = False, 0.0  # at rest since the last edge; the sample before the block
    for at in range(start, stop, size):
        y = sign * (read(at, min(at + size, stop))[0] - middle)
        joined = np.concatenate([[before if at > start else y[0]], y])
        rests = np.flatnonzero(y < -0.25 * swing)
        for up in np.flatnonzero((joined[:-1] < 0) & (joined[1:] >= 0)):
            seen = int(np.searchsorted(rests, up))  # rests before this edge
            if armed or seen:
                edges.append(at - start + up - 1 + joined[up] / (joined[up] - joined[up + 1]))
                armed, rests = False, rests[seen:]
        armed = armed or len(rests) > 0
        before = float(y[-1])
    return np.array(edges)


def number_pulses(times: np.ndarray, period: float, *, tolerance: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Which pulses are once-per-revolution marks, and the number of the revolution each begins.

    A mark comes a whole number of periods after the last one, to the tolerance; more than one where marks were missed. What
    comes in between is a double edge or a disturbance. The period follows slowly. Should the first pulse be a false one, a
    start from a later one explains more of them.

    times : (pulse,) rising   period : about, in the unit of the times   tolerance : share of a period
    returns indices of the marks and their numbers, both (mark,) and the number rising from 0
    """
    best: tuple[list[int], list[int]] = ([], [])
    for first in range(min(6, len(times))):
        kept, numbers, now = [first], [0], period
        for i in range(first + 1, len(times)):
            gap = (times[i] - times[kept[-1]]) / now
            whole = round(gap)
            if whole < 1 or abs(gap - whole) > tolerance:
                continue
            seen = (times[i] - times[kept[-1]]) / whole
            now = float(np.clip((now + seen) / 2, 0.75 * period, 1.25 * period))
            kept.append(i)
            numbers.append(numbers[-1] + whole)
        if len(kept) > len(best[0]):
            best = kept, numbers
    return np.array(best[0], int), np.array(best[1], int)
