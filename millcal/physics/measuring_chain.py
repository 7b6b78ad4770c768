"""What a measuring chain makes of a true signal: resonance, low-pass, offset and drift, counts.

Everything here is deterministic; the noise's size is a property of the chain, its draw is the simulation's.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MeasuringChain:
    """Sensor, charge amplifier and converter of one kind of channel.

    Where a field is a tuple it has one entry per channel of that kind, or is empty: none.
    """

    resonance: tuple[float, ...] = ()  # Hz, of the sensor on its mount
    damping_ratio: tuple[float, ...] = ()
    cross_talk: float = 0.0  # share of each other channel's signal that a channel shows
    lowpass: float | None = None  # Hz, Butterworth corner of the amplifier
    lowpass_order: int = 2
    offset: tuple[float, ...] = ()  # in the channel's SI unit
    drift: tuple[float, ...] = ()  # per second
    warming: tuple[float, ...] = ()  # what a change of temperature adds in the end
    warming_time: float = 10.0  # s, time constant of that change
    noise: float = 0.0  # rms, white
    coloured_noise: float = 0.0  # rms, first-order low-passed
    coloured_corner: float = 10.0  # Hz, corner of the coloured noise
    full_scale: float | None = None  # input range; None: no converter, real numbers
    bits: int = 16

    def gain(self, frequency: np.ndarray, channels: int) -> np.ndarray:
        """Measured over true amplitude; 1 at rest.   frequency : (f,) Hz   returns complex (channel, f)

        Second-order sensor w_n^2 / (w_n^2 - w^2 + 2 j zeta w_n w), Butterworth low-pass.
        """
        f = np.asarray(frequency, float)
        gain = np.ones((channels, len(f)), complex)
        for row, (own, zeta) in enumerate(zip(self.resonance, self.damping_ratio, strict=True)):
            gain[row] *= own**2 / (own**2 - f**2 + 2j * zeta * own * f)
        if self.lowpass is not None:
            gain *= butterworth(f, self.lowpass, self.lowpass_order)
        return gain

    def transfer(self, frequency: np.ndarray, channels: int) -> np.ndarray:
        """Measured channels over true ones, cross-talk and `gain`.   returns complex (channel, channel, f)"""
        mixing = np.eye(channels) + self.cross_talk * (1 - np.eye(channels))
        return mixing[:, :, np.newaxis] * self.gain(frequency, channels)[:, np.newaxis, :]

    @property
    def decay_rate(self) -> float:
        """Of the slowest resonance, zeta w_n, 1/s; inf without one."""
        rates = [2 * np.pi * zeta * own for own, zeta in zip(self.resonance, self.damping_ratio, strict=True)]
        return min(rates, default=np.inf)

    def wander(self, time: np.ndarray, channels: int) -> np.ndarray:
        """Offset, linear drift and warming, which a cut knows nothing of.   time : (t,) s   returns (channel, t)"""
        total = np.zeros((channels, len(time)))
        curves = (
            (self.offset, np.ones(len(time))),
            (self.drift, time),
            (self.warming, -np.expm1(-time / self.warming_time)),
        )
        for sizes, curve in curves:
            if sizes:
                total += np.asarray(sizes)[:, np.newaxis] * curve
        return total

    def quantise(self, values: np.ndarray) -> np.ndarray:
        """Values rounded to the converter's steps and cut off at the full scale.   values : (...,)   returns (...,)"""
        if self.full_scale is None:
            return values
        step = quantisation_step(self.full_scale, self.bits)
        top = 2 ** (self.bits - 1) - 1
        return np.clip(np.rint(values / step), -top, top) * step


def quantisation_step(full_scale: float, bits: int) -> float:
    """Value of one count, so that the full scale is the largest count of a signed converter."""
    return full_scale / (2 ** (bits - 1) - 1)


def butterworth(frequency: np.ndarray, corner: float, order: int) -> np.ndarray:
    """Frequency response of a Butterworth low-pass, gain 1 at rest.   frequency : (f,) Hz   returns complex (f,)"""
    s = 1j * np.asarray(frequency) / corner
    poles = np.exp(1j * np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order))
    return np.prod(-poles[:, np.newaxis] / (s - poles[:, np.newaxis]), axis=0)


def discrete_butterworth(corner: float, order: int, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """The analog low-pass as a recursion over samples, b and a of `scipy.signal.lfilter`, gain 1 at rest.

    The poles are those of the analog filter, exp(s / sample_rate). Those of b are the least squares fit of its frequency
    response up to a quarter of the sample rate, which leaves out what a hold adds of its own: for corners up to an eighth of
    the rate and order 2 or more the responses differ by less than 0.007 up to there, and by 0.4 % of the analog one up to a
    tenth of the rate (order 1: 0.03, 2 %). A first-order hold has the same poles and is 3 % low at that tenth, for it draws
    straight lines between samples.
    corner, sample_rate : Hz   returns b (order + 1,) but no less than 3, a (order + 1,)
    raises ValueError where the corner is not below half the rate
    """
    if not 0 < corner < sample_rate / 2:
        raise ValueError(f"{corner=} Hz is not between 0 and half of {sample_rate=} Hz")
    poles = np.exp(1j * np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order))
    a = np.poly(np.exp(poles * 2 * np.pi * corner / sample_rate)).real
    turn = np.linspace(0, 0.25, 201)  # of the sample rate
    powers = np.exp(-2j * np.pi * np.outer(turn, np.arange(max(order, 2) + 1)))
    basis = powers / (powers[:, : order + 1] @ a)[:, np.newaxis]
    wanted = butterworth(turn * sample_rate, corner, order)
    b = np.linalg.lstsq(np.concatenate([basis.real, basis.imag]), np.concatenate([wanted.real, wanted.imag]))[0]
    return b * (a.sum() / b.sum()), a


def anti_alias(frequency: np.ndarray, sample_rate: float) -> np.ndarray:
    """Gain of the converter's own filter: flat to sample_rate / 2.56, a cosine down to nothing at half the rate.

    Linear phase and the same on every channel, so it cancels in a ratio of two of them.
    frequency : (f,) Hz   returns (f,)
    """
    flat, end = sample_rate / 2.56, sample_rate / 2
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((np.asarray(frequency) - flat) / (end - flat), 0.0, 1.0))
