"""Whether a motion repeats after n strobe periods, from samples taken once per period.

A motion driven with one period looks still under a strobe of that period. If it repeats only every n-th flash, the mean change
over n flashes vanishes (Honeycutt, Schmitz 2017, A numerical and experimental investigation of period-n bifurcations in
milling, J. Manuf. Sci. Eng. 139),

    M(n) = mean over i of |x(i) - x(i - n)|,

and a motion that never repeats has no such n. One strobe phase can be blind: a motion of period two whose two halves cross at
the flash looks still. So several phases are looked at, and the worst counts.

A transient that dies slowly keeps M above any threshold for long. It falls as a power of the number of flashes, so that log M
of successive blocks lies on a straight line; M that falls so is taken for nothing. What beats, bursts or fills a torus
does not lie on a line. Noise of standard deviation sigma alone makes M = 2 sigma / sqrt(pi).
"""

from typing import NamedTuple

import numpy as np

BLOCKS = 6  # of flashes, for the fall of a transient
LEAST_FALL = 0.5  # of log M over all blocks, to be called one
STRAIGHT = 0.1  # of that fall: how far log M may lie off the line
RESTS = 0.1  # of M in the last block: what a power may leave, where M tends to


class Periodicity(NamedTuple):
    """After how many flashes a motion repeats."""

    period: int  # 0: never
    change: np.ndarray  # M(1), M(2), .. of the worst phase, (n,)
    lasting: np.ndarray  # the same without what dies, (n,): 0 where M falls as a transient does
    phase: int  # the worst for M(1)


def strobe(signal: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A signal between its samples, by the polynomial of degree five through the six around.

    signal : (sample,)   at : places in samples, (...,), within the signal   returns (...,)
    """
    signal, at = np.asarray(signal, float), np.asarray(at, float)
    if len(signal) < 6:
        raise ValueError(f"{len(signal)} samples are too few to be looked at between them")
    if at.size and not (at.min() >= 0 and at.max() <= len(signal) - 1):
        raise ValueError("flashes lie outside the signal")
    first = np.clip(np.floor(at).astype(int) - 2, 0, len(signal) - 6)
    x = at - first
    total = np.zeros(at.shape)
    for j in range(6):
        weight = np.ones(at.shape)
        for k in range(6):
            if k != j:
                weight *= (x - k) / (j - k)
        total += weight * signal[first + j]
    return total


def change(samples: np.ndarray, n: int) -> np.ndarray:
    """M(n), the mean change from one sample to the n-th after it.   samples : (..., flash)   returns (...,)"""
    samples = np.asarray(samples, float)
    return np.abs(samples[..., n:] - samples[..., :-n]).mean(axis=-1)


def changes(samples: np.ndarray, longest: int) -> np.ndarray:
    """M(1) .. M(longest).   samples : (..., flash)   returns (longest, ...)"""
    return np.array([change(samples, n) for n in range(1, longest + 1)])


def dies(samples: np.ndarray, n: int) -> np.ndarray:
    """Whether M(n) falls from block to block as a transient does.   samples : (..., flash)   returns bool (...,)"""
    samples = np.asarray(samples, float)
    steps = np.abs(samples[..., n:] - samples[..., :-n])
    size = steps.shape[-1] // BLOCKS
    if size < 2:
        return np.zeros(samples.shape[:-1], bool)
    level = steps[..., -size * BLOCKS :].reshape(*steps.shape[:-1], BLOCKS, size).mean(axis=-1)
    log = np.log(np.maximum(level, 1e-300))
    x = np.arange(BLOCKS) - (BLOCKS - 1) / 2
    slope = log @ x / (x @ x)
    off = np.abs(log - log.mean(axis=-1, keepdims=True) - slope[..., np.newaxis] * x).max(axis=-1)
    fall = -slope * (BLOCKS - 1)
    first, second, third = np.moveaxis(level.reshape(*level.shape[:-1], 3, BLOCKS // 3).mean(axis=-1), -1, 0)
    bend = (first - second) - (second - third)
    with np.errstate(over="ignore", invalid="ignore"):  # what grows beyond all bounds does not die
        rest = third - (second - third) ** 2 / np.where(bend > 0, bend, np.inf)  # Aitken: where a power tends to
    return np.asarray((fall >= LEAST_FALL) & (off <= STRAIGHT * fall) & (bend > 0) & (rest <= RESTS * level[..., -1]))


def periodicity(samples: np.ndarray, threshold: float, *, longest: int = 12) -> Periodicity:
    """The smallest n after which a motion repeats to within the threshold, at every phase.

    samples : the settled motion once per period, (phase, flash) or (flash,)
    threshold : M(n) up to which it repeats, unit of the samples
    longest : n looked at; at least twice as many flashes are needed
    """
    samples = np.atleast_2d(np.asarray(samples, float))
    if samples.shape[1] < 2 * longest:
        raise ValueError(f"{samples.shape[1]} flashes are fewer than twice the {longest=} period looked for")
    found = changes(samples, longest)  # (n, phase)
    lasting = np.where(np.array([dies(samples, n) for n in range(1, longest + 1)]), 0.0, found)
    repeats = np.flatnonzero(lasting.max(axis=1) <= threshold)
    period = int(repeats[0]) + 1 if len(repeats) else 0
    return Periodicity(period, found.max(axis=1), lasting.max(axis=1), int(np.argmax(found[0])))
