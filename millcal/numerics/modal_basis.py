"""What one mode contributes to an estimated frequency response: exactly, with the windows that cut its decay short.

The response to a pulse f is a free decay once the pulse is over. A record holds it up to a window that begins to fall at
sample a, over L samples along half a cosine, and is zero from a + L on; what is lost of the mode with residue 1 and pole p is

    D p^d e^{-s a D} E(p) S(q),   E(p) = sum_m f[m] e^{p (a - m) D},   S(q) = sum_k v_k q^k,   q = e^{(p - s) D},

with D the time between samples, d the power of s by which the form differs from the receptance, and v = 1 - window from a on.
All sums are geometric. Least squares over hits, H = (sum_h x_h f_h^H) S_ff^-1, passes the loss on, so that the estimate obeys

    H(s) = sum_r s^d A_r / (s - p_r) - D p_r^d A_r (sum_h E_h(p_r) S_h e^{-s a_h D} f_h^H) S_ff^-1

for any grid of lines, any padding with zeros and any s, also s = a + j w of an exponential window. With one input and no
cosine end this is the truncated basis of a single force channel; with several force channels the loss of one column of A
leaks into the others, and the product above says how much.
"""

from typing import NamedTuple

import numpy as np

NEGLIGIBLE = 1e-9  # share of a mode that may be lost without being reckoned


class Loss(NamedTuple):
    """What the windows of one test take away, prepared for any pole. Records with one length of fall share a sum S."""

    force: np.ndarray  # (hit, input, sample)
    lag: np.ndarray  # (hit, sample) from each sample to the last of its pulse
    reach: np.ndarray  # (output, hit) samples from the last of the pulse to the fall of the window
    carried: np.ndarray  # (output, hit, input, line) e^{-s a D} f_h^H S_ff^-1
    falls: tuple[tuple[int, np.ndarray], ...]  # length of the fall, (output, hit) whether it is that of this hit
    interval: float  # D, s


def plan_loss(
    s: np.ndarray,
    force: np.ndarray,
    force_start: np.ndarray,
    window_stop: np.ndarray,
    window_fall: np.ndarray,
    mixing: np.ndarray,
    interval: float,
) -> Loss:
    """Prepare the loss of one test.

    s : (line,) complex, 1/s   force : (hit, input, sample)   force_start : (hit,) samples
    window_stop, window_fall : (hit, output) samples   mixing : (hit, input, line) f_h^H S_ff^-1   interval : s
    """
    samples = np.arange(force.shape[2])
    loaded = np.any(force != 0, axis=1)  # (hit, sample)
    last = np.where(np.any(loaded, axis=1), force.shape[2] - 1 - np.argmax(loaded[:, ::-1], axis=1), 0)
    delay = np.exp(-s * window_stop.T[:, :, None] * interval)
    falls = tuple((int(fall), fall == window_fall.T) for fall in np.unique(window_fall))
    return Loss(
        force,
        np.maximum(last[:, None] - samples, 0),
        np.maximum(window_stop.T - (force_start + last), 0),
        delay[:, :, None, :] * mixing,
        falls,
        interval,
    )


def without_hit(loss: Loss, hit: int, ratio: np.ndarray) -> Loss:
    """The loss with one hit left out.   ratio : complex (line, input, input), S_ff of all times S_ff^-1 of the rest"""
    kept = np.arange(len(loss.force)) != hit
    if ratio.shape[1] == 1:
        carried = loss.carried[:, kept] * ratio[:, 0, 0]
    else:
        carried = np.einsum("ohil,lij->ohjl", loss.carried[:, kept], ratio)
    falls = tuple((fall, own[:, kept]) for fall, own in loss.falls if own[:, kept].any())
    return Loss(loss.force[kept], loss.lag[kept], loss.reach[:, kept], carried, falls, loss.interval)


def window_end(q: np.ndarray, end: np.ndarray, fall: int) -> tuple[np.ndarray, np.ndarray]:
    """sum v_k q^k and sum k v_k q^k of v = 1 - window, over all k from where the window begins to fall; |q| < 1.

    end : q^fall   fall : samples of the cosine, v = 1/2 - 1/2 cos(pi (k + 1/2) / fall); 0 for a record that just ends
    """
    rest = 1.0 / (1.0 - q)
    whole = end * rest
    first = whole * (fall + q * rest)
    if not fall:
        return whole, first
    half = np.exp(0.5j * np.pi / fall)
    for share, turn, last in ((0.5, 1.0, end), (-0.25 * half, half**2, -end), (-0.25 / half, half**-2, -end)):
        z = q * turn
        rest = share / (1.0 - z)
        total = (1.0 - last) * rest
        whole = whole + total
        first = first + (z * total - (fall * share) * last) * (rest / share)
    return whole, first


def pole_terms(
    s: np.ndarray, pole: np.ndarray, power: np.ndarray, loss: Loss | None, inputs: int
) -> tuple[np.ndarray, np.ndarray]:
    """What residue 1 at a pole contributes to the estimate, and its derivative with respect to the pole.

    s : (line,) complex   pole : (pole,) complex   power : (output,) d of each output's form
    returns two complex (output, pole, line, input, input): force that the residue belongs to, column of the estimate
    """
    distance = 1.0 / (s - pole[:, None])  # (pole, line)
    value = np.zeros((len(power), *distance.shape, inputs, inputs), complex)
    slope = np.zeros_like(value)
    for d in np.unique(power):
        plain = s**d * distance
        for i in range(inputs):
            value[power == d, :, :, i, i] = plain
            slope[power == d, :, :, i, i] = plain * distance
    if loss is None:
        return value, slope
    D = loss.interval
    lost = (np.exp(pole.real * loss.reach.min(axis=1)[:, None] * D) > NEGLIGIBLE).any(axis=0)
    if not lost.any():
        return value, slope
    p, hits = pole[lost], len(loss.force)
    fading = np.exp(p[:, None, None] * loss.lag * D)  # (pole, hit, sample)
    start = np.moveaxis(loss.force @ np.moveaxis(fading, 0, -1), -1, 0)  # (pole, hit, input)
    start_slope = np.moveaxis(loss.force @ np.moveaxis(fading * loss.lag * D, 0, -1), -1, 0)
    fall_off = np.exp(p[:, None, None] * loss.reach * D)[..., None]  # (pole, output, hit, 1)
    E = fall_off * start[:, None]  # (pole, output, hit, input)
    dE = fall_off * (start_slope[:, None] + loss.reach[..., None] * D * start[:, None])
    both = np.stack([E, dE]).transpose(2, 0, 1, 4, 3)  # (output, 2, pole, input, hit)
    q = np.exp(p * D)[:, None] * np.exp(-s * D)
    scale, scale_slope = (part[:, :, None, None, None] * D for part in _power_of(p, power))  # (output, pole)
    for fall, mine in loss.falls:
        own = np.flatnonzero(mine.any(axis=1))  # outputs
        S, first = window_end(q, np.exp(p * (D * fall))[:, None] * np.exp(-s * (D * fall)), fall)  # (pole, line)
        if mine[own].all():
            sent, carried = both[own], loss.carried[own]
        else:
            sent, carried = both[own] * mine[own][:, None, None, None, :], loss.carried[own]
        W = sent.reshape(len(own), -1, hits) @ carried.reshape(len(own), hits, -1)
        W = W.reshape(-1, 2, len(p), inputs, inputs, len(s)).transpose(1, 0, 2, 5, 3, 4)  # source, then column
        S, first = S[:, :, None, None], first[:, :, None, None]
        c, dc = scale[own], scale_slope[own]
        place = np.ix_(own, np.flatnonzero(lost))
        value[place] -= c * (S * W[0])
        slope[place] -= (dc * S + c * (D * first)) * W[0] + c * (S * W[1])
    return value, slope


def _power_of(p: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p^d and its derivative.   returns two (output, pole)"""
    d = power[:, None]
    return p**d, np.where(d == 0, 0.0, d * p ** np.maximum(d - 1, 0))


def pole_of(natural_frequency: np.ndarray, damping_ratio: np.ndarray) -> np.ndarray:
    """-zeta w + j w sqrt(1 - zeta^2), 1/s.   natural_frequency : (mode,) Hz   returns (mode,)"""
    w = 2 * np.pi * natural_frequency
    return w * (-damping_ratio + 1j * np.sqrt(1.0 - damping_ratio**2))


def pole_slopes(natural_frequency: np.ndarray, damping_ratio: np.ndarray) -> np.ndarray:
    """Derivatives of the pole by ln f_n and by ln zeta.   returns (2, mode)"""
    w, zeta = 2 * np.pi * natural_frequency, damping_ratio
    by_zeta = -w * (1.0 + 1j * zeta / np.sqrt(1.0 - zeta**2))
    return np.stack([pole_of(natural_frequency, zeta), by_zeta * zeta])
