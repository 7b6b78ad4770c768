"""Coloured noise made white: an autoregression fitted to noise alone, and the filter that it is.

    e_n = sum_{i=1..p} a_i e_{n-i} + w_n,    w white

Data and model columns go through w = e_n - sum a_i e_{n-i} alike, after which least squares count every sample rightly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Autoregression(NamedTuple):
    """Noise of one channel."""

    coefficients: np.ndarray  # (order,) a_i
    sd: float  # of w
    total_sd: float  # of e


def fit_autoregression(pieces: Sequence[np.ndarray], highest: int = 4) -> Autoregression:
    """The order with the smallest Akaike criterion, by the pooled autocovariance of all pieces (Yule-Walker).

    pieces : stretches of noise about zero, (sample,) each   highest : order tried at most
    """
    n = sum(len(piece) for piece in pieces)
    longest = max(len(piece) for piece in pieces)
    highest = min(highest, longest - 1)
    r = (
        np.array(
            [sum(float(p[: len(p) - lag] @ p[lag:]) for p in pieces if len(p) > lag) for lag in range(highest + 1)]
        )
        / n
    )
    best, criterion = (
        Autoregression(np.zeros(0), float(np.sqrt(r[0])), float(np.sqrt(r[0]))),
        n * np.log(max(r[0], 1e-300)),
    )
    for order in range(1, highest + 1):
        matrix = r[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
        a = np.linalg.solve(matrix + 1e-12 * r[0] * np.eye(order), r[1 : order + 1])
        variance = float(r[0] - a @ r[1 : order + 1])
        if variance <= 0:
            break
        cost = n * np.log(variance) + 2 * order
        if cost < criterion - 2:
            best, criterion = Autoregression(a, float(np.sqrt(variance)), float(np.sqrt(r[0]))), cost
    return best


def whiten(noise: Autoregression, values: np.ndarray) -> np.ndarray:
    """w in units of its standard deviation; the first `order` samples miss their past.   values : (sample, ...)"""
    white = np.array(values, dtype=float)
    for i, a in enumerate(noise.coefficients, start=1):
        white[i:] -= a * values[:-i]
    return white / noise.sd
