"""Noise of a measuring chain, drawn from a generator that is handed in."""

import numpy as np

from millcal.physics.measuring_chain import MeasuringChain


def coloured_noise(rng: np.random.Generator, shape: tuple[int, int], corner: float, sample_rate: float) -> np.ndarray:
    """Unit-variance noise with the power spectrum of a first-order low-pass, 1 / (1 + (f/corner)^2).

    shape : channel, sample   corner, sample_rate : Hz   returns (channel, sample)
    """
    frequency = np.fft.rfftfreq(shape[1], 1 / sample_rate)
    response = 1 / np.sqrt(1 + (frequency / corner) ** 2)
    response[0] = 0.0  # its mean would be an offset, which has its own place
    weight = np.full(len(frequency), 2.0)  # every line but the last stands for two of the full spectrum
    weight[-1] = 1.0 if shape[1] % 2 == 0 else 2.0
    power = np.sum(weight * response**2) / shape[1]
    white = np.fft.rfft(rng.standard_normal(shape), axis=1)
    return np.fft.irfft(white * response, shape[1], axis=1) / np.sqrt(power)


def measured(
    values: np.ndarray, chain: MeasuringChain, sample_rate: float, rng: np.random.Generator, *, time: np.ndarray
) -> np.ndarray:
    """True values with the chain's wander and noise, then as counts times their step.

    values : (channel, sample), already through the chain's gain   time : (sample,) s   returns (channel, sample)
    """
    total = values + chain.wander(time, len(values))
    if chain.noise > 0:
        total += chain.noise * rng.standard_normal(values.shape)
    if chain.coloured_noise > 0:
        total += chain.coloured_noise * coloured_noise(rng, values.shape, chain.coloured_corner, sample_rate)
    return chain.quantise(total)
