"""Coloured noise made white: an autoregression fitted to noise alone, and the filter that it is.

    e_n = sum_{i=1..p} a_i e_{n-i} + w_n,    w white

Data and model columns go through w = e_n - sum a_i e_{n-i} alike, after which least squares count every sample rightly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

SAMPLES_PER_COEFFICIENT = 10


class Autoregression(NamedTuple):
    """Noise of one channel."""

    coefficients: np.ndarray  # (order,) a_i
    sd: float  # of w
    total_sd: float  # of e


def fit_autoregression(pieces: Sequence[np.ndarray], highest: int = 4) -> Autoregression:
    """Least squares over all pieces, of the order with the smallest Akaike criterion.

    Not by the autocovariance: that of short pieces leans to zero, and for the noise of a low-pass, whose neighbours are nearly
    alike, a bias of some percent makes the white part several times too strong.
    pieces : stretches of noise about zero, (sample,) each   highest : order tried at most, less where the pieces are short
    """
    total = np.concatenate([np.asarray(piece, float) for piece in pieces])
    total_sd = float(np.sqrt(np.mean(total**2)))
    while highest and sum(max(len(piece) - highest, 0) for piece in pieces) < SAMPLES_PER_COEFFICIENT * highest:
        highest -= 1
    best, criterion = 0, np.inf
    for order in range(highest + 1):
        now, past = _beside_their_past(pieces, order, highest)  # the same samples for all orders
        left = now - past @ np.linalg.lstsq(past, now, rcond=None)[0]
        cost = len(now) * np.log(max(float(left @ left), 1e-300)) + 2 * order
        if cost < criterion - 2:
            best, criterion = order, cost
    now, past = _beside_their_past(pieces, best, best)
    coefficients = np.linalg.lstsq(past, now, rcond=None)[0]
    left = now - past @ coefficients
    sd = float(np.sqrt(left @ left / (len(now) - best))) if best else total_sd
    return Autoregression(coefficients, sd, total_sd)


def _beside_their_past(pieces: Sequence[np.ndarray], order: int, skipped: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples but the first of each piece, and those before each.   returns (sample,), (sample, order)"""
    now = np.concatenate([piece[skipped:] for piece in pieces])
    past = [
        np.concatenate([piece[skipped - i : len(piece) - i] for piece in pieces if len(piece) > skipped])
        for i in range(1, order + 1)
    ]
    return now, np.stack(past, axis=1) if order else np.zeros((len(now), 0))


def whiten(noise: Autoregression, values: np.ndarray) -> np.ndarray:
    """w in units of its standard deviation; the first `order` samples miss their past.   values : (sample, ...)"""
    white = np.array(values, dtype=float)
    for i, a in enumerate(noise.coefficients, start=1):
        white[i:] -= a * values[:-i]
    return white / noise.sd
