"""The spectrum of what harmonics leave of a signal, and the lines in it that belong to no harmonic.

Periodograms of equal stretches are averaged. A Hann window keeps a line where it is: without one, a line between two
harmonics would stand at the foot of every other.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.spectra import Reader, residuals

WINDOWED = 1.94  # lines of a Hann window that are worth one: neighbours are alike


class ResidualSpectra(NamedTuple):
    """Mean periodograms, scaled so that white noise has its variance at every line."""

    power: np.ndarray  # (channel, line)
    cross: np.ndarray  # (line, channel, channel), complex, mean of y y^H, of the lowest lines
    size: int  # samples of a stretch: lines are 1 / size apart
    stretches: int
    windowed: bool

    @property
    def frequency(self) -> np.ndarray:
        """Cycles per sample.   returns (line,)"""
        return np.arange(self.power.shape[1]) / self.size

    @property
    def draws_per_line(self) -> float:
        """Independent draws that each line of the mean is worth."""
        return self.stretches / (WINDOWED if self.windowed else 1.0)

    def beside(self, cycle: float) -> np.ndarray:
        """How far each line is from the nearest multiple of the fundamental, in lines.   returns (line,)"""
        turn = self.frequency / cycle
        return np.abs(turn - np.rint(turn)) * (cycle * self.size)

    def clear(self, cycle: float) -> np.ndarray:
        """Lines into which a multiple of the fundamental, or its being taken out, does not reach.   returns (line,)"""
        return self.beside(cycle) >= (2.0 if self.windowed else 0.5)


def fast_length(longest: int) -> int:
    """The largest length up to `longest` whose transform is fast: 2^a 3^b 5^c."""
    return max(
        two * three * five
        for five in (5**power for power in range(28))
        if five <= longest
        for three in (3**power for power in range(41))
        if five * three <= longest
        for two in [1 << ((longest // (five * three)).bit_length() - 1)]
    )


def residual_spectra(
    read: Reader,
    start: int,
    size: int,
    stretches: int,
    cycle: float,
    harmonics: np.ndarray,
    *,
    cross_lines: int = 0,
    windowed: bool = True,
) -> ResidualSpectra:
    """Mean periodograms of what harmonics leave of `stretches` times `size` samples.

    harmonics : (channel, K + 1) with theta = 0 at start   cross_lines : how many lines to keep the cross spectra of
    """
    channels = len(harmonics)
    window = np.hanning(size + 1)[:-1] if windowed else np.ones(size)
    scale = 1.0 / (stretches * float(np.sum(window**2)))
    power = np.zeros((channels, size // 2 + 1))
    cross = np.zeros((min(cross_lines, size // 2 + 1), channels, channels), complex)
    for _, rest in residuals(read, start, start + size * stretches, cycle, harmonics, size):
        y = np.fft.rfft((rest - rest.mean(axis=1, keepdims=True)) * window)
        power += (y.real**2 + y.imag**2) * scale
        if len(cross):
            low = np.ascontiguousarray(y[:, : len(cross)].T)
            cross += low[:, :, np.newaxis] * (low.conj() * scale)[:, np.newaxis, :]
    return ResidualSpectra(power, cross, size, stretches, windowed)


class Line(NamedTuple):
    """A line that stands out of a spectrum."""

    channel: int
    frequency: float  # cycles per sample
    amplitude: float
    exceeds: float  # times the local median amplitude


def lines_standing_out(
    spectra: ResidualSpectra,
    cycle: float,
    *,
    family_error: float = 0.01,
    neighbours: int = 101,
    guard: float = 0.05,
) -> tuple[list[Line], np.ndarray]:
    """Lines that noise would reach once in 1 / family_error recordings, and all lines of the spectrum that they take up.

    Where there is only noise, the mean of periodograms is chi-square about its level, and the local median that tells the
    level is itself nearly chi-square, so the ratio follows F. Beside a multiple of the fundamental stands what its own
    wander leaves: three bins, and a share `guard` of the fundamental, are left out.

    neighbours : bins of the local median, odd   returns lines, and (line,) True where one is
    """
    power, size, stretches = spectra.power, spectra.size, spectra.stretches
    taken = np.zeros(power.shape[1], bool)
    if size < 2 * neighbours or not spectra.windowed:
        return [], taken
    from scipy.special import fdtri, gammaincinv

    frequency = spectra.frequency
    distance = np.abs(frequency / cycle - np.rint(frequency / cycle))  # in fundamentals; multiple 0 is the drift
    clear = distance > max(3.0 / (size * cycle), guard)
    level = np.array([_running_median(p, neighbours) for p in power])
    bins = max(int(clear.sum()) * len(power), 1)
    freedom = stretches * neighbours / WINDOWED  # of the median
    above_mean = fdtri(2 * stretches, freedom, 1 - family_error / bins)
    threshold = above_mean * stretches / gammaincinv(stretches, 0.5)
    lines = []
    for channel, p in enumerate(power):
        over = (p > threshold * level[channel]) & clear
        for i in np.flatnonzero(over):
            near = slice(max(i - 2, 0), i + 3)  # the main lobe of the window
            taken[near] = True
            centre = float(np.sum(frequency[near] * p[near]) / np.sum(p[near]))
            if p[i] < p[near].max() or abs(centre / cycle - round(centre / cycle)) <= guard:
                continue
            amplitude = 2 * np.sqrt(np.sum(p[near]) / size)
            lines.append(Line(channel, centre, float(amplitude), float(np.sqrt(p[i] / level[channel, i]))))
    return lines, taken


def asynchronous_lines(
    read: Reader,
    start: int,
    stop: int,
    cycle: float,
    harmonics: np.ndarray,
    *,
    family_error: float = 0.01,
    longest: int = 1 << 17,
    neighbours: int = 101,
    guard: float = 0.05,
) -> list[Line]:
    """Lines of the residual's spectrum that stand out of its noise; see `lines_standing_out`.

    harmonics : (channel, K + 1) with theta = 0 at start   longest : samples of a stretch
    """
    stretches = max(1, -(-(stop - start) // longest))
    size = (stop - start) // stretches
    if size < 2 * neighbours:
        return []
    spectra = residual_spectra(read, start, size, stretches, cycle, harmonics)
    return lines_standing_out(spectra, cycle, family_error=family_error, neighbours=neighbours, guard=guard)[0]


def _running_median(values: np.ndarray, width: int) -> np.ndarray:
    """The median of `width` (odd) neighbours around each value; at the ends, of those there are on the inner side."""
    from scipy.ndimage import median_filter

    inner = median_filter(values, width)[width // 2 : len(values) - width // 2]
    return np.pad(inner, width // 2, mode="edge")
