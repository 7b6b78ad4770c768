"""A low-pass without phase: the Butterworth filter run forward and backward, as one symmetric kernel."""

import numpy as np

from millcal.numerics.spectra import Reader


def low_pass_kernel(cutoff: float, order: int = 4) -> np.ndarray:
    """The symmetric impulse response of a Butterworth filter run forward and backward, with unit gain at zero frequency.

    Its gain is 1 / (1 + (tan(pi f) / tan(pi f0))^(2 order)), with f0 chosen so that the gain of both runs together, not of
    one, is 1/sqrt(2) at the cutoff. The response falls off exponentially and is cut where it is 1e-13 of its peak.

    cutoff : cycles per sample, below 1/2   returns (2 m + 1,)
    """
    if not 0 < cutoff < 0.5:
        raise ValueError(f"{cutoff=} is not between 0 and 1/2 cycles per sample")
    size = 1 << int(np.ceil(np.log2(64 / min(cutoff, 0.5 - cutoff))))
    warped = np.tan(np.pi * np.minimum(np.arange(size // 2 + 1) / size, 0.5 - 1e-12)) / np.tan(np.pi * cutoff)
    gain = 1.0 / (1.0 + (np.sqrt(2.0) - 1.0) * warped ** (2 * order))
    response = np.fft.irfft(gain, size)[: size // 2]
    reach = int(np.flatnonzero(np.abs(response) > 1e-13 * response[0])[-1])
    kernel = np.concatenate([response[reach:0:-1], response[: reach + 1]])
    return kernel / kernel.sum()


def smoothed(read: Reader, first: int, last: int, kernel: np.ndarray) -> Reader:
    """A reader of the samples first..last convolved with a symmetric kernel, mirrored in the points at their ends.

    A line stays a line up to the ends.   kernel : (2 m + 1,)
    """
    reach = len(kernel) // 2

    def read_smoothed(start: int, stop: int) -> np.ndarray:
        low, high = start - reach, stop + reach
        y = read(max(low, first), min(high, last))
        before, after = max(first - low, 0), max(high - last, 0)
        if before or after:
            y = np.pad(y, ((0, 0), (before, after)), mode="reflect", reflect_type="odd")
        size = 1 << int(np.ceil(np.log2(y.shape[1] + 2 * reach)))
        product = np.fft.irfft(np.fft.rfft(y, size) * np.fft.rfft(kernel, size), size)
        return product[:, 2 * reach : 2 * reach + stop - start]

    return read_smoothed
