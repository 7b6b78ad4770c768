"""The spindle: its frequency, its angle, and the force revolution by revolution."""

from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.pulses import pulse_times
from millcal.numerics.spectra import Reader
from millcal.stages.conditioning.forces import Note

NYQUIST_SHARE = 0.45  # of the sample rate: above, an anti-aliasing filter has its say
FEWEST_REVOLUTIONS = 2  # below, nothing can be said of a revolution
FEW_REVOLUTIONS = 5
BLOCK = 5  # revolutions whose harmonics are one draw for the variance: longer than the memory of a chip or a mode
LONGEST_SEARCH = 32  # revolutions
FAR_FROM_STATED = 0.01


def whole_revolutions(start: int, stop: int, cycle: float) -> tuple[int, int]:
    """How many revolutions the samples hold, to half a sample, and where the last of them ends."""
    revolutions = int((stop - start + 0.5) * cycle)
    return revolutions, min(start + round(revolutions / cycle), stop)


def spindle_cycle(
    read: Reader,
    start: int,
    stop: int,
    stated: float,
    teeth: int,
    where: str,
    note: Note,
    *,
    signal: str = "force",
    followed: float = 0.3,
) -> spectra.Cycle:
    """The spindle frequency in cycles per sample, from the harmonics of the force (or another signal).

    Searched 10 % to either side of the stated speed over some revolutions, then refined over stretches four times as long
    each, so that the spindle never turns by half a period of a harmonic unseen.

    stated : cycles per sample   followed : share of the power in the harmonics, with less the stated speed is kept
    """
    revolutions, _ = whole_revolutions(start, stop, stated)
    if revolutions < FEWEST_REVOLUTIONS:
        raise RecordingError(
            f"{where}: the steady cut holds {revolutions} whole revolutions, at least {FEWEST_REVOLUTIONS} are needed; "
            "check the spindle speed, the sample rate and steady_s"
        )
    if revolutions < FEW_REVOLUTIONS:
        note("few-revolutions", f"only {revolutions} whole revolutions: scatter and spindle speed are hardly known")
    highest = max(1, min(max(12, 2 * teeth), int(NYQUIST_SHARE / stated)))
    middle = (start + stop) // 2
    half = int(min(revolutions, LONGEST_SEARCH) / stated / 2)
    low, high = max(start, middle - half), min(stop, middle + half)
    cycle = spectra.search_cycle(read(low, high), stated, harmonics=highest)
    while True:
        found = spectra.refine_cycle(read, low, high, cycle, harmonics=highest)
        cycle = found.cycle
        if (low, high) == (start, stop):
            break
        half *= 4
        low, high = max(start, middle - half), min(stop, middle + half)
    y = read(low, min(low + (1 << 16), high))
    fitted = spectra.fit_harmonics(spectra.reader_of(y), 0, y.shape[1], cycle, highest)
    share = 0.5 * np.sum(np.abs(fitted[:, 1:]) ** 2) / max(float(y.var(axis=1).sum()), 1e-300)
    if share < followed:
        note(
            "not-synchronous",
            f"only {share:.0%} of the {signal}'s power follows a spindle near the stated speed, which is kept; "
            "is this a steady cut at that speed?",
        )
        return spectra.Cycle(stated, found.sd)
    if abs(cycle / stated - 1) > FAR_FROM_STATED:
        note(
            "speed-off",
            f"the harmonics say {cycle / stated - 1:+.1%} against the stated spindle speed; the measured one is used, "
            "check spindle_speed_rpm and the sample rate",
        )
    return found


class Revolutions(NamedTuple):
    """The harmonics revolution by revolution, in short."""

    means: np.ndarray  # (axis, revolution) N
    variance: np.ndarray  # (axis, harmonic) N^2, of the harmonics of the whole cut
    lead: np.ndarray  # (revolution,) rad, of the spindle angle before the uniform one
    gain: np.ndarray  # (revolution,), of the harmonics, about 1


def each_revolution(read: Reader, start: int, stop: int, cycle: float, fitted: np.ndarray) -> Revolutions:
    """Means and variance from the harmonics of every revolution, and how far the spindle runs ahead of uniform motion.

    Blocks of a few revolutions are the draws of the variance, so that what a mode or a chip remembers is in it. Lead and
    gain are the projections on the harmonics' change with angle and with size; noise moves both alike, so the lead's
    variance beyond the gain's is the spindle's.

    fitted : (axis, harmonic), of the whole cut
    """
    revolutions, _ = whole_revolutions(start, stop, cycle)
    K = fitted.shape[1] - 1
    edges = np.minimum(start + np.rint(np.arange(revolutions + 1) / cycle).astype(np.int64), stop)
    size = BLOCK if revolutions >= 4 * BLOCK else 1
    order = np.arange(min(K, 12) + 1)
    change = order * fitted[:, : len(order)]  # d harmonics / d angle, over j
    weight = max(float(np.sum(np.abs(change) ** 2)), 1e-300)
    means, lead, gain = [], [], []
    draws, off, square = 0, np.zeros(fitted.shape, complex), np.zeros(fitted.shape)  # about the whole cut's harmonics
    for first in range(0, revolutions, 100 * size):
        last = min(first + 100 * size, revolutions)
        found = spectra.block_harmonics(read, edges[first : last + 1], cycle, K)
        found = found * np.exp(-2j * np.pi * np.arange(K + 1) * ((edges[first] - start) * cycle % 1.0))
        means.append(found[:, :, 0].real.copy())  # a view would keep every harmonic in memory
        along = np.sum(change.conj() * found[:, :, : len(order)], axis=(1, 2)) / weight
        across = np.sum(change.conj() * (order * found[:, :, : len(order)]), axis=(1, 2)) / weight
        lead.append(along.imag)
        gain.append(across.real)
        full = (last - first) // size
        drawn = found[: full * size].reshape(full, size, *fitted.shape).mean(axis=1) - fitted
        draws += full
        off += drawn.sum(axis=0)
        square += np.sum(np.abs(drawn) ** 2, axis=0)
    variance = np.maximum(square / draws - np.abs(off / draws) ** 2, 0.0) / max(draws - 1, 1)
    return Revolutions(np.concatenate(means).T, variance, np.concatenate(lead), np.concatenate(gain))


def mean_force(
    read: Reader, start: int, stop: int, stated: float, refined: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """Mean over whole revolutions of the stated speed, while nobody can tell it from that of the refined speed.

    With a whole number of samples per revolution, as a machinist's round speed often gives, that is the plain mean of
    those rows, which anyone can check. Where the two means differ by more than the standard error, the refined decides.

    refined, variance : (axis,)   returns (axis,) N
    """
    revolutions, end = whole_revolutions(start, stop, stated)
    if revolutions < FEWEST_REVOLUTIONS:
        return refined
    plain = spectra.fit_harmonics(read, start, end, stated, max(1, min(30, int(NYQUIST_SHARE / stated))))[:, 0].real
    return plain if np.all(np.abs(plain - refined) <= np.sqrt(variance)) else refined


def pulse_phase(
    recording: Recording, start: int, stop: int, frequency: float, sd: float, note: Note
) -> tuple[float, bool]:
    """Spindle angle at the sample `start` from the once-per-revolution pulse: (rad, whether there is a usable one)."""
    rows = recording.rows_of("pulse")
    if not rows:
        return 0.0, False
    cycle = frequency / recording.sample_rate
    pulses = pulse_times(lambda a, b: np.asarray(recording.block(a, b))[rows[:1]], start, stop)
    expected = (stop - start) * cycle
    if not max(2, 0.8 * expected - 1) <= len(pulses) <= 1.2 * expected + 1:
        note(
            "pulse-unusable",
            f"{len(pulses)} pulses in {expected:.0f} revolutions: not used, the spindle angle counts from the first sample",
        )
        return 0.0, False
    turns = pulses * cycle
    phase = float(np.angle(np.mean(np.exp(-2j * np.pi * turns))))
    number = np.rint(turns + phase / (2 * np.pi))
    slope = np.polyfit(number, pulses, 1)[0] if np.ptp(number) > 0 else 1 / cycle
    scatter = float(np.std(pulses - slope * number)) * cycle  # of a pulse, in revolutions
    tolerance = max(1e-4, 5 * sd / frequency, 5 * scatter * np.sqrt(12 / len(pulses)) / expected)
    if abs(1 / (slope * cycle) - 1) > tolerance or scatter > 0.05:
        note(
            "pulse-disagrees",
            f"the pulse says {60 * recording.sample_rate / slope:.2f} rpm, the harmonics {60 * frequency:.2f} rpm; "
            "the speed is of the harmonics, check the pulse for missed or double edges",
        )
    return phase, True
