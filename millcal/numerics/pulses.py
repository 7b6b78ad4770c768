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
