"""Tones of their own in what a comb of harmonics leaves: where they are, how large, how sharp, and which belong together.

A line is a run of neighbouring lines of the spectrum above its surroundings. A tone is a sharp one: what noise makes of a
resonance is as wide as the resonance. Beside a harmonic stands what the wander of its own frequency leaves, so a line there counts
only where it holds more than a share of the harmonic itself.

Tones that modulate each other lie a whole number of some frequency apart, to either side of zero: folded by that frequency they
fall on one place.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.residual_lines import ResidualSpectra

STANDS_OUT = 25.0  # peak over the surroundings in one spectrum: noise does that once in e^25
BELONGS = 5.0  # a neighbour over the surroundings
SURROUNDINGS = 101  # lines
SHARP = 5.0  # lines: a tone under a Hann window is 2 wide
SHARP_SHARE = 0.006  # of the frequency: an unsteady tone may be as wide; resonances are wider


class Tone(NamedTuple):
    """A line of the spectrum that is no harmonic."""

    frequency: float  # cycles per sample
    deviation: float  # standard deviation of it
    power: float  # mean square
    sharp: bool  # a tone; else a hump, as noise makes of a resonance


def find_tones(
    spectra: ResidualSpectra, channel: int, cycle: float, harmonics: np.ndarray, *, wander: float = 0.0
) -> list[Tone]:
    """The lines that stand out of what harmonics leave, the strongest first.

    harmonics : (K + 1,) complex, those that were taken out   wander : relative, of the fundamental
    """
    power, size = spectra.power[channel], spectra.size
    level = surroundings(power, SURROUNDINGS)
    frequency = spectra.frequency
    order = np.rint(frequency / cycle).astype(int)
    off = np.abs(frequency - order * cycle) * size  # lines from the nearest harmonic
    reach = 3.0 + 3.0 * wander * order * cycle * size
    inside = order < len(harmonics)
    needed = np.where(off < reach, np.inf, 0.0)  # beside a harmonic that was not taken out
    share = np.where(off[inside] < 0.8, 1.0, 0.5 * np.exp(-((off[inside] / reach[inside]) ** 2)))
    held = 0.5 * np.abs(harmonics[order[inside]]) ** 2
    needed[inside] = 0.25 * size * share * held  # power of the highest line of a tone of that share
    threshold = level * (STANDS_OUT / spectra.stretches**0.5 if spectra.stretches > 1 else STANDS_OUT)
    beyond = np.flatnonzero((power > np.maximum(threshold, needed)) & (frequency > 0.4 * cycle))
    taken = np.zeros(len(power), bool)
    found = []
    for i in beyond[np.argsort(-power[beyond])]:
        if taken[i]:
            continue
        low = high = int(i)
        while low > 0 and power[low - 1] > BELONGS * level[low - 1] and not taken[low - 1]:
            low -= 1
        while high < len(power) - 1 and power[high + 1] > BELONGS * level[high + 1] and not taken[high + 1]:
            high += 1
        low, high = min(low, max(i - 2, 0)), max(high, min(i + 2, len(power) - 1))
        if i + 1 < len(power) and taken[low : high + 1].any() and (taken[i - 1] or taken[i + 1]):
            taken[low : high + 1] = True  # the foot of a stronger one
            continue
        run = np.arange(low, high + 1)[~taken[low : high + 1]]
        p = np.maximum(power[run] - level[run], 0.0)
        taken[low : high + 1] = True
        width = float(p.sum() ** 2 / np.sum(p**2))
        place, spread = _peak(power, int(i), level[i])
        found.append(
            Tone(
                place / size,
                spread / size * (width / 2 if width > 3 else 1.0),
                float(2 * p.sum() / size),
                width <= max(SHARP, SHARP_SHARE * frequency[i] * size),
            )
        )
    return sorted(found, key=lambda tone: -tone.power)


def _peak(power: np.ndarray, i: int, level: float) -> tuple[float, float]:
    """Where between the lines a tone under a Hann window is, and how well that is known; both in lines."""
    left, here, right = np.sqrt(power[i - 1 : i + 2]) if 0 < i < len(power) - 1 else (0.0, 1.0, 0.0)
    ratio = max(left, right) / here
    shift = float(np.clip((2 * ratio - 1) / (ratio + 1), 0.0, 0.5))
    return i + (shift if right > left else -shift), 0.02 + 0.7 * float(np.sqrt(level / power[i]))


def surroundings(power: np.ndarray, width: int) -> np.ndarray:
    """The median of the lines around each, never of more than a quarter of all.   power : (line,)"""
    from scipy.ndimage import median_filter

    width = max(5, min(width, len(power) // 4)) | 1
    return np.asarray(median_filter(power, width, mode="reflect"))


def folded(frequency: float | np.ndarray, by: float) -> np.ndarray:
    """The distance from the nearest multiple: what all tones that modulation by `by` makes of one have in common."""
    turn = np.asarray(frequency) / by
    return np.abs(turn - np.rint(turn)) * by


def families(tones: list[Tone], by: float, tolerance: float) -> list[list[Tone]]:
    """Tones that lie whole multiples of `by` apart, or so after a change of sign; the strongest family first.

    tolerance : of the folded frequency
    """
    groups: list[list[Tone]] = []
    for tone in tones:  # the strongest first
        place = float(folded(tone.frequency, by))
        for group in groups:
            if abs(place - float(folded(group[0].frequency, by))) <= tolerance + 3 * (
                tone.deviation + group[0].deviation
            ):
                group.append(tone)
                break
        else:
            groups.append([tone])
    return sorted(groups, key=lambda group: -sum(tone.power for tone in group))
