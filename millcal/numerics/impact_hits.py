"""Hits in a record: where a pulse excites a structure, and whether the hit can be used.

A hit is a short pulse in one or several force channels, followed by a decay in the response channels. What a hit is
judged by is cheap and robust: quantiles for the noise, moving means for a second pulse, exact equality for a clipped top.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

NORMAL = 1.349  # interquartile range of the unit normal distribution
NORMAL_90 = 3.290  # its 5..95 % range


class Survey(NamedTuple):
    """What one stretch of samples with one hit holds. Indices count from the start of the stretch."""

    onset: int  # first sample of the largest pulse
    stop: int  # first sample after it
    first: int  # as onset and stop, of all the pulses of the hit together
    last: int
    peak: float  # largest force, along the direction of the hit
    direction: np.ndarray  # (input,) unit vector of the hit in the force channels
    second: tuple[float, int] | None  # a second pulse: its share of the first, its distance in samples
    force_mean: np.ndarray  # (input,) without the pulses
    force_noise: np.ndarray  # (input,) standard deviation without the pulses
    response_mean: np.ndarray  # (output,) before the hit
    response_noise: np.ndarray  # (output,) standard deviation, of the quieter of head and tail
    head_noise: np.ndarray  # (output,) standard deviation just before the hit
    response_peak: np.ndarray  # (output,)
    power: np.ndarray  # (output, block) mean square of the response from the onset on


def noise_of(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median and robust standard deviation along the last axis.

    The quartiles give what the median absolute deviation gives; the 5..95 % range stands in where a coarse converter
    holds more than half of the samples on one count. Pulses may fill up to 5 % of the samples.
    """
    q05, q25, q50, q75, q95 = np.percentile(samples, (5, 25, 50, 75, 95), axis=-1)
    return q50, np.maximum((q75 - q25) / NORMAL, (q95 - q05) / NORMAL_90)


def moving_mean(samples: np.ndarray, width: int) -> np.ndarray:
    """Mean of `width` successive samples; element i covers i..i+width.   samples : (n,)   returns (n - width + 1,)"""
    total = np.concatenate([[0.0], np.cumsum(samples)])
    return (total[width:] - total[:-width]) / width


def runs(flags: np.ndarray) -> np.ndarray:
    """Start and stop of each stretch of True.   flags : (n,)   returns (run, 2)"""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return edges.reshape(-1, 2)


def find_hits(
    blocks: Iterable[tuple[int, np.ndarray]], hold_off: int, *, sigmas: float = 10.0, share: float = 0.01
) -> list[tuple[int, int]]:
    """Hits in a continuous record, block by block: sample of the first and after the last excursion of each.

    An excursion counts when it rises above `sigmas` times the noise (over blocks the median) and above `share` of the
    largest one; excursions less than `hold_off` samples apart are one hit, so that a bouncing hammer is not two hits.

    blocks : (index of the first sample, force channels (input, n)); any length, at best some seconds
    """
    found, noises = [], []
    for start, force in blocks:
        mean, noise = noise_of(force[:, :: max(1, min(16, force.shape[1] // 512))])
        level = float(np.linalg.norm(noise))
        size = np.abs(force[0] - mean[0]) if len(force) == 1 else np.linalg.norm(force - mean[:, None], axis=0)
        noises.append(level)
        above = runs(size > max(0.5 * sigmas * level, share * share * size.max()))
        if len(above):
            tops = np.maximum.reduceat(size, above.ravel())[::2] if above[-1, 1] < len(size) else None
            if tops is None:  # reduceat takes no index behind the last sample
                tops = np.array([size[a:b].max() for a, b in above])
            found += [(start + int(a), start + int(b), float(top)) for (a, b), top in zip(above, tops, strict=True)]
    if not found:
        return []
    level = max(sigmas * float(np.median(noises)), share * max(top for _, _, top in found))
    hits: list[tuple[int, int]] = []
    for a, b, top in found:
        if top <= level:
            continue
        if hits and a - hits[-1][1] < hold_off:
            hits[-1] = (hits[-1][0], b)
        else:
            hits.append((a, b))
    return hits


def pulse_around(pulse: np.ndarray, at: int, level: float) -> tuple[int, int]:
    """First sample and first sample after the pulse that stands above `level` around sample `at`.   pulse : (n,)"""
    before = np.flatnonzero(pulse[:at] <= level)
    after = np.flatnonzero(pulse[at:] <= level)
    return (int(before[-1]) + 1 if len(before) else 0), (int(after[0]) + at if len(after) else len(pulse))


def second_pulse(pulse: np.ndarray, start: int, stop: int, noise: float) -> tuple[float, int, int, int] | None:
    """A second pulse beside the largest one: share, distance in samples, first and after-last sample of both; or None.

    Far from the pulse the mean over one pulse length is tested (some five standard deviations and 3 % of its mean);
    beside it, where both may be merged, a rise after a dip (six standard deviations and 5 % of the peak), smoothed over
    a third of the pulse so that the ringing of an anti-alias filter is no pulse.

    pulse : (n,), along the hit and without its mean
    """
    length = stop - start
    mean = float(pulse[start:stop].mean())
    found = []
    means = moving_mean(pulse, min(length, len(pulse)))
    index = np.arange(len(means))
    gap = max(2, length // 2)
    far = (index + length <= start - gap) | (index >= stop + gap)
    if far.sum() > 2 * length:
        chance = np.sqrt(2.0 * np.log(100.0 * len(means)))  # standard deviations that noise passes once in 1000 records
        middle, scatter = noise_of(means[far][:: max(1, length // 8)])
        hit = far & (means - middle > max(chance * scatter, 0.03 * mean))
        if hit.any():
            at = int(np.argmax(np.where(hit, means, -np.inf)))
            where = np.flatnonzero(hit)
            found.append((float(means[at]) / mean, at - start, int(where[0]), int(where[-1]) + length))
    width = max(1, length // 3)
    low, high = max(0, start - 2 * length), min(len(pulse), stop + 2 * length + width)
    if high - low > width:
        near = moving_mean(pulse[low:high], width)
        top = int(np.argmax(near))
        peak = float(near[top])
        limit = max(6.0 * noise / np.sqrt(width), 0.05 * peak)
        for side, step in ((near[top:], 1), (near[top::-1], -1)):
            rise = side - np.minimum.accumulate(side)
            if rise.max() > limit:
                at = int(np.argmax(rise))
                spot = low + top + step * at
                found.append((float(side[at]) / peak, step * at, spot - length, spot + length + width))
    if not found:
        return None
    share, distance, *_ = max(found)
    first, last = min(start, *(f[2] for f in found)), max(stop, *(f[3] for f in found))
    return share, distance, max(0, first), min(len(pulse), last)


def survey_hit(force: np.ndarray, response: np.ndarray, block: int, around: tuple[int, int] | None = None) -> Survey:
    """Look at one stretch of samples that holds one hit.

    force : (input, n)   response : (output, n)   block : length of the blocks of the decay
    around : samples between which the hit was found, or None to search the whole stretch
    """
    n = force.shape[1]
    mean, noise = noise_of(force[:, :: max(1, min(8, n // 1024))])
    size = np.linalg.norm(force - mean[:, None], axis=0)
    low, high = around or (0, n)
    top = low + int(np.argmax(size[low:high]))
    direction = (force[:, top] - mean) / max(size[top], 1e-300)
    pulse = direction @ (force - mean[:, None])
    peak = float(pulse[top])
    scatter = float(np.linalg.norm(direction * noise))
    level = max(3.0 * scatter, 0.02 * peak)
    onset, stop = pulse_around(pulse, top, level)
    second = second_pulse(pulse, onset, stop, scatter)
    first, last = (onset, stop) if second is None else second[2:]
    length = stop - onset

    outside = np.ones(n, bool)
    outside[max(0, first - length - 16) : last + length + 16] = False
    if outside.sum() >= 64:
        force_mean, force_noise = force[:, outside].mean(axis=1), force[:, outside].std(axis=1)
    else:
        force_mean, force_noise = mean, noise

    head = response[:, : max(0, first - 16)]
    tail = response[:, n - max(64, (n - last) // 5) :]
    tail_noise = tail.std(axis=1)
    enough = head.shape[1] >= 64
    response_mean = head.mean(axis=1) if enough else tail.mean(axis=1)
    head_noise = head.std(axis=1) if enough else np.full(len(response), np.nan)
    decay = response[:, onset:] - response_mean[:, None]
    blocks = decay.shape[1] // block
    power = np.mean(decay[:, : blocks * block].reshape(len(response), blocks, block) ** 2, axis=2)
    return Survey(
        onset,
        stop,
        first,
        last,
        peak,
        direction,
        None if second is None else second[:2],
        force_mean,
        force_noise,
        response_mean,
        np.fmin(head_noise, tail_noise),
        head_noise,
        np.abs(decay).max(axis=1),
        power,
    )


def is_flat_topped(samples: np.ndarray, least: int = 3) -> bool:
    """Whether a channel ends in a flat top: `least` equal extreme samples between steps no rounded peak would have.

    A rounded peak too may stay some samples on one count of the converter, but then its neighbours are within two counts
    (parabola); here more than four are asked for on both sides. Noise may put three to five samples on one count by
    chance, so that so short a top must also stand clear of the noise.   samples : (n,)
    """
    for extreme in (samples.max(), samples.min()):
        at_extreme = samples == extreme
        if np.count_nonzero(at_extreme) < least:
            continue
        steps = np.abs(np.diff(samples))
        if not steps.any():
            return False
        count = steps[steps > 0].min()
        noise = np.percentile(steps[:: max(1, len(steps) // 1024)], 25) / 0.45  # |difference| of white noise
        for a, b in runs(at_extreme):
            if b - a < least or a == 0 or b == len(samples):
                continue
            drop = min(abs(extreme - samples[a - 1]), abs(extreme - samples[b]))
            if drop > 4.0 * count and (b - a > 5 or drop > 5.0 * noise):
                return True
    return False


def is_overloaded(samples: np.ndarray, full_scale: float | None) -> bool:
    """Whether a channel reached its input range or, with or without a known range, has a flat top.   samples : (n,)"""
    if full_scale is not None and max(samples.max(), -samples.min()) >= 0.999 * full_scale:
        return True
    return is_flat_topped(samples)
