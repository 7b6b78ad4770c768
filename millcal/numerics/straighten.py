"""A periodic signal whose period wanders, read at even steps of its phase instead of time: its lines are lines again."""

import numpy as np

from millcal.numerics import spectra
from millcal.numerics.periodicity import strobe
from millcal.numerics.phase_tracking import track_phase

PERIODS = 3  # of one stretch, over which the phase is taken for even
FEWEST = 8  # stretches
SMOOTH = 0.8  # correlation of the phase from one stretch to the next: less is noise
LARGEST = 0.004  # change of the fundamental, relative: a larger one is another signal's
GAINS = 0.02  # of the power, that more of it follows the fundamental
MOST_OF_IT = 0.4  # of what did not: a tone of its own that draws the phase explains little


def straightened(samples: np.ndarray, cycle: float, *, harmonics: int, every: int) -> tuple[np.ndarray, float] | None:
    """The signals at even steps of the phase that their harmonics tell; None where that makes little difference.

    samples : (channel, sample)   cycle : the fundamental, cycles per sample
    harmonics : whose phase is followed   every : of the fundamental, the first and the step of those
    returns the samples, (channel, sample), and what share of the power follows the fundamental more than before
    """
    n = samples.shape[1]
    K = min(harmonics * every, int(0.45 / cycle)) // every * every
    count = int(n * cycle / PERIODS)
    if every > K or count < FEWEST or (2 * K + 1) * cycle > 0.9 * PERIODS:
        return None
    swing = samples - samples.mean(axis=1, keepdims=True)
    size = swing.std(axis=1, keepdims=True)
    swing = swing / np.where(size > 0, size, 1.0)
    edges = np.rint(np.linspace(0, n, count + 1)).astype(np.int64)
    found = spectra.block_harmonics(spectra.reader_of(swing), edges, cycle, K)[:, :, every::every]
    lead = track_phase(found)
    off = lead - np.polyval(np.polyfit(np.arange(count), lead, 1), np.arange(count))
    if not np.std(off) > 0 or np.corrcoef(off[1:], off[:-1])[0, 1] < SMOOTH:
        return None
    middle = (edges[:-1] + edges[1:] - 1) / 2
    late = np.interp(np.arange(n), middle, lead - lead.mean()) / (
        2 * np.pi * cycle * every
    )  # samples by which the phase is ahead
    if np.abs(np.diff(lead) / np.diff(middle)).max() > LARGEST * 2 * np.pi * cycle * every:
        return None
    at = np.arange(n) - late
    at = np.clip(np.arange(n) - np.interp(at, np.arange(n), late), 0, n - 1)
    straight = np.array([strobe(row, at) for row in samples])
    before, after = (_followed(y, cycle, K) for y in (samples, straight))
    return (straight, after - before) if after - before > max(GAINS, MOST_OF_IT * (1 - before)) else None


def _followed(samples: np.ndarray, cycle: float, harmonics: int) -> float:
    """Share of the power, mean over the channels."""
    found = spectra.fit_harmonics(spectra.reader_of(samples), 0, samples.shape[1], cycle, harmonics)
    return float(np.mean(0.5 * np.sum(np.abs(found[:, 1:]) ** 2, axis=1) / np.maximum(samples.var(axis=1), 1e-300)))
