"""How wrong harmonics fitted to many periods are, from the spectrum of what they leave.

Noise errs a harmonic by what it has at the harmonic's own frequency, which nobody sees; the lines beside it have the same,
if they are near enough. Three things come on top. A harmonic whose size or phase changes slowly has side lines: where the
nearest lines hold more than those farther off, they count. A line of its own between the harmonics is no noise that they
share: it is left out, and what reaches a harmonic over the length of the fit is added. The same goes for slow drift.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.residual_lines import ResidualSpectra

WISHED = 25  # draws per channel: an inverse of the covariance is then right to 4 %
NEEDED = 5  # draws per channel; with fewer, lines beside other harmonics are taken to help
FEWEST = 8.0  # draws that tell whether the nearest lines hold more
STRETCHES = 8  # of which each lost so little to the fit that the harmonic's own line counts
ALONE = 3.0  # standard deviations by which the nearest lines must hold more along the harmonic itself
ANYHOW = 1.2  # times the most that noise gives in any direction


class HarmonicNoise(NamedTuple):
    """Errors of harmonics of several channels."""

    covariance: np.ndarray  # (K + 1, channel, channel) complex, E[e e^H]; 0 for harmonic 0
    draws: np.ndarray  # (K + 1,) independent draws behind each


def harmonic_noise(
    spectra: ResidualSpectra, cycle: float, harmonics: np.ndarray, length: int, apart: np.ndarray
) -> HarmonicNoise:
    """Covariance of the errors of one-sided harmonics, 4 s^2 / length for white noise of variance s^2.

    spectra : of what at least these harmonics leave, its cross spectra up to half a fundamental above the highest
    harmonics : (channel, K + 1), fitted to `length` samples   apart : (line,) True for lines that are no noise
    """
    channels, K = len(harmonics), harmonics.shape[1] - 1
    spacing = cycle * spectra.size  # lines from one harmonic to the next
    line = np.arange(len(spectra.cross))
    apart = apart[: len(line)] | (line < 0.5 * spacing)
    usable = ~apart
    if spectra.stretches < STRETCHES:
        usable &= spectra.clear(cycle)[: len(line)]
    place, cross = np.flatnonzero(usable), spectra.cross[usable]
    worth = spectra.draws_per_line
    covariance, draws = np.zeros((K + 1, channels, channels), complex), np.zeros(K + 1)
    if not len(place):
        return HarmonicNoise(covariance, draws)
    for k in range(1, K + 1):
        distance = np.abs(place - k * spacing)
        nearest = np.sort(distance)
        at_half = max(int(np.searchsorted(nearest, 0.5 * spacing, "right")), 1)
        wished = min(int(np.ceil(WISHED * channels / worth)), at_half)
        count = min(max(wished, int(np.ceil(NEEDED * channels / worth))), len(nearest))
        reach = float(nearest[count - 1])
        wide = cross[distance <= reach]
        found, behind = wide.mean(axis=0), len(wide) * worth
        if count > at_half:
            found = found * _level(found, cross[distance <= max(0.5 * spacing, nearest[0])].mean(axis=0))
        nearer = []
        while True:
            reach /= 2
            near = cross[distance <= reach]
            if len(near) * worth < FEWEST:
                break
            nearer.append((near.mean(axis=0), len(near) * worth))
        if nearer:
            found = _at_least(found, behind, nearer, harmonics[:, k])
        covariance[k], draws[k] = found * (4 / length), behind
    covariance[1:] += _leaked(spectra, np.flatnonzero(apart), cycle, K, length)
    return HarmonicNoise(covariance, draws)


def _level(pooled: np.ndarray, own: np.ndarray) -> float:
    """How much stronger the harmonic's own lines are, all channels together: that takes few lines."""
    size = np.sqrt(np.maximum(np.diag(pooled).real, 0.0))
    if not np.all(size > 0):
        return 1.0
    scale = np.multiply.outer(size, size)
    return float(np.trace(np.linalg.solve(pooled / scale + 1e-9 * np.eye(len(size)), own / scale)).real) / len(size)


def _at_least(
    wide: np.ndarray, wide_draws: float, nearer: list[tuple[np.ndarray, float]], along: np.ndarray
) -> np.ndarray:
    """The covariance `wide`, with more of what nearer lines surely hold more of.

    First along the harmonic, because that is how changes of its size and phase look: as much as the nearest lines hold of
    those that surely hold more. Then in any direction, where more than the edge of what the ratio of two sample covariances
    reaches by chance is sure, and in all others together, as where a resonance is at the harmonic.

    nearer : covariance and draws, of ever nearer lines   along : (channel,)
    """
    channels = len(wide)
    size = np.sqrt(np.maximum(np.diag(wide).real, 0.0))
    if not np.all(size > 0):
        return wide
    scale = np.multiply.outer(size, size)
    base, along = wide / scale + 1e-9 * np.eye(channels), along / size
    if np.any(along):
        pointer = np.linalg.solve(base, along)  # unbiased, least variance, for a change along it
        pointer /= np.vdot(along, pointer)
        before = np.vdot(pointer, base @ pointer).real
        more = 0.0
        for near, draws in nearer:
            now = np.vdot(pointer, near / scale @ pointer).real
            more = now - before if now > before * (1 + ALONE / np.sqrt(draws)) else more
        base = base + more * np.outer(along, along.conj())
    for near, draws in nearer:
        factor = np.linalg.cholesky(base)
        inside = np.linalg.solve(factor, np.linalg.solve(factor, near / scale).conj().T)
        values, vectors = np.linalg.eigh((inside + inside.conj().T) / 2)
        edge = (1 + np.sqrt(channels / draws)) / max(1 - np.sqrt(channels / wide_draws), 0.2)
        over = values > ANYHOW * edge**2
        others = values[~over]
        level = float(others.mean()) if len(others) else 1.0
        sure = (1 + ALONE / np.sqrt(draws * max(len(others), 1))) * wide_draws / max(wide_draws - channels, 1.0)
        root = factor @ vectors * np.sqrt(np.where(over, values, level if level > sure else 1.0))
        base = root @ root.conj().T
    return base * scale


def _leaked(spectra: ResidualSpectra, lines: np.ndarray, cycle: float, highest: int, length: int) -> np.ndarray:
    """What lines far from the harmonics 1..K leave in them over the length of the fit.

    A line of amplitude a, d cycles off over the fit, gives a sin(pi d) / (pi d); its mean square has a half for sin^2.
    returns (K, channel, channel)
    """
    off = (np.arange(1, highest + 1)[:, np.newaxis] * cycle - lines / spectra.size) * length
    weights = 2.0 / spectra.size / (np.pi * np.maximum(np.abs(off), 1.0)) ** 2
    return np.tensordot(weights, spectra.cross[lines], axes=1)
