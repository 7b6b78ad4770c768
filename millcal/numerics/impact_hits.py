"""Hits in a record: where a pulse excites a structure, and what the stretch of samples about it holds.

A hit is a short pulse in one or several force channels, followed by a decay in the response channels. What a hit is
judged by is cheap and robust: quantiles for the noise, moving means for a second pulse, means of pieces for the rest.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from millcal.numerics.resting_line import RestingLine, resting_line, resting_line_beside

RINGING = 1.5  # times what a force swings below zero may swing above it beside a pulse
NORMAL = 1.349  # interquartile range of the unit normal distribution
NORMAL_90 = 3.290  # its 5..95 % range


class Survey(NamedTuple):
    """What one stretch of samples with one hit holds. Indices count from the start of the stretch."""

    onset: int  # first sample of the largest pulse
    stop: int  # first sample after it
    first: int  # as onset and stop, of all the pulses of the hit together
    last: int
    peak: float  # largest force, along the direction of the hit
    crest: float  # peak times area over energy of the pulse: 4/pi of a half-sine at any length
    direction: np.ndarray  # (input,) unit vector of the hit in the force channels
    second: tuple[float, int] | None  # a second pulse: its share of the first, its distance in samples
    force_rest: RestingLine  # beside the pulses
    force_noise: np.ndarray  # (input,) standard deviation beside the pulses
    response_rest: RestingLine  # before the hit and, where that has come to rest, after it
    response_noise: np.ndarray  # (output,) standard deviation, of the quieter of head and tail
    head_noise: np.ndarray  # (output,) standard deviation just before the hit
    response_peak: np.ndarray  # (output,)
    power: np.ndarray  # (output, block) mean square of the response from the onset on


def noise_of(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median and robust standard deviation along the last axis.

    The quartiles give what the median absolute deviation gives; the 5..95 % range stands in where a coarse converter
    holds more than half of the samples on one count. Pulses may fill up to 5 % of the samples.
    """
    ordered = np.sort(samples, axis=-1)
    place = np.array([0.05, 0.25, 0.5, 0.75, 0.95]) * (ordered.shape[-1] - 1)
    low = place.astype(int)
    below, above = ordered[..., low], ordered[..., np.minimum(low + 1, ordered.shape[-1] - 1)]
    q05, q25, q50, q75, q95 = np.moveaxis(below + (place - low) * (above - below), -1, 0)
    return q50, np.maximum((q75 - q25) / NORMAL, (q95 - q05) / NORMAL_90)


def moving_mean(samples: np.ndarray, width: int) -> np.ndarray:
    """Mean of `width` successive samples; element i covers i..i+width.   samples : (..., n), returns (..., n - width + 1)"""
    total = np.empty((*samples.shape[:-1], samples.shape[-1] + 1))
    total[..., 0] = 0.0
    np.cumsum(samples, axis=-1, out=total[..., 1:])
    return (total[..., width:] - total[..., :-width]) / width


def runs(flags: np.ndarray) -> np.ndarray:
    """Start and stop of each stretch of True.   flags : (n,)   returns (run, 2)"""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return edges.reshape(-1, 2)


def find_hits(
    blocks: Iterable[tuple[int, np.ndarray]],
    hold_off: int,
    *,
    sigmas: float = 10.0,
    share: float = 0.01,
    progress: Callable[[int], None] | None = None,
) -> list[tuple[int, int]]:
    """Hits in a continuous record, block by block: sample of the first and after the last excursion of each.

    An excursion counts when it rises above `sigmas` times the noise (over blocks the median) and above `share` of the
    largest one; excursions less than `hold_off` samples apart are one hit, so that a bouncing hammer is not two hits.

    blocks : (index of the first sample, force channels (input, n)); any length, at best some seconds
    progress : called with the number of samples searched so far
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
        if progress is not None:
            progress(start + force.shape[1])
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
    a third of the pulse so that the ringing of an anti-alias filter is no pulse. A hammer only pushes: what swings below
    zero is ringing too, of a pulse that is short for the converter, and as much may swing above.

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
        middle, scatter = map(float, noise_of(means[far][:: max(1, length // 8, len(means) // 2048)]))
        least = max(chance * scatter, 0.03 * mean)
        hit = far & (means - middle > max(least, RINGING * _swing(means[far], middle, least)))
        if hit.any():
            at = int(np.argmax(np.where(hit, means, -np.inf)))
            where = np.flatnonzero(hit)
            found.append((float(means[at]) / mean, at - start, int(where[0]), int(where[-1]) + length))
    width = max(2, length // 3)
    low, high = max(0, start - 2 * length), min(len(pulse), stop + 2 * length + width)
    if high - low > width:
        near = moving_mean(pulse[low:high], width)
        top = int(np.argmax(near))
        peak = float(near[top])
        least = 6.0 * noise / np.sqrt(width)
        limit = max(least, 0.05 * peak, RINGING * _swing(near, 0.0, least))
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


def _swing(means: np.ndarray, middle: float, noise: float) -> float:
    """How far below its middle a force goes, where that is more than noise."""
    below = middle - float(means.min(initial=middle))
    return below if below > noise else 0.0


def pulse_crest(pulse: np.ndarray, onset: int, stop: int) -> float:
    """Peak times area over energy, of the curve through the samples: the shape of a pulse, whatever its length and size.

    A half-sine has 4/pi, a rectangle 1: a top that is cut off lowers it. No width is in it, which noise beside the pulse
    would spoil.   pulse : (n,), without its mean
    """
    low, high = max(0, onset - 3), min(len(pulse), stop + 3)
    own = pulse[low:high]
    ends = np.linspace(own[0], own[-1], len(own))
    fine = np.fft.irfft(np.fft.rfft(own - ends), 8 * len(own)) * 8.0
    energy = float(own @ own)
    return float(fine.max()) * float(own.sum()) / energy if energy > 0.0 else 0.0


def survey_hit(force: np.ndarray, response: np.ndarray, block: int, around: tuple[int, int] | None = None) -> Survey:
    """Look at one stretch of samples that holds one hit.

    force : (input, n)   response : (output, n)   block : length of the blocks of the decay
    around : samples between which the hit was found, or None to search the whole stretch
    """
    n = force.shape[1]
    mean, noise = noise_of(force[:, :: max(1, min(8, n // 1024))])
    free = force - mean[:, None]
    size = np.abs(free[0]) if len(free) == 1 else np.linalg.norm(free, axis=0)
    low, high = around or (0, n)
    top = low + int(np.argmax(size[low:high]))
    direction = free[:, top] / max(size[top], 1e-300)
    pulse = direction @ free
    scatter = float(np.linalg.norm(direction * noise))
    onset, stop = pulse_around(pulse, top, max(3.0 * scatter, 0.02 * float(pulse[top])))
    second = second_pulse(pulse, onset, stop, scatter)
    first, last = (onset, stop) if second is None else second[2:]
    length = stop - onset
    gap = (max(0, first - length - 16), min(n, last + length + 16))
    force_rest, force_noise = resting_line_beside(force, gap, onset, np.abs(direction) * float(pulse[top]))
    if not np.isfinite(force_noise).all():
        force_rest, force_noise = force_rest._replace(value=mean), noise

    beside = max(64, (n - last) // 5)
    response_peak = np.maximum(response[:, onset:].max(axis=1), -response[:, onset:].min(axis=1))
    rest, head_noise, tail_noise = resting_line(response, max(0, first - 16), n - beside, onset, response_peak)
    away = rest.over(onset, n)
    decay = response[:, onset:] - away
    blocks = decay.shape[1] // block
    if blocks:
        whole = decay[:, : blocks * block].reshape(len(response), blocks, block)
        power = np.einsum("obk,obk->ob", whole, whole) / block
    else:
        power = np.zeros((len(response), 0))
    return Survey(
        onset,
        stop,
        first,
        last,
        float(pulse[top]),
        pulse_crest(pulse, onset, stop),
        direction,
        None if second is None else second[:2],
        force_rest,
        force_noise,
        rest,
        np.fmin(head_noise, tail_noise),
        head_noise,
        np.maximum(decay.max(axis=1), -decay.min(axis=1)),
        power,
    )
