"""The motion once per tooth, and the metric M of it."""

from typing import NamedTuple

import numpy as np

from millcal.numerics.periodicity import change, strobe
from millcal.numerics.spectra import evaluate

PHASES = 64  # with 8 the largest change is missed by up to a fifth where teeth strike a sharp motion
LONGEST = 8  # teeth after which a motion may repeat
MOST = 20_000  # flashes of one phase
MARGIN = 3  # samples at either end


class Strobes(NamedTuple):
    """Samples once per tooth."""

    time: np.ndarray  # (flash,) samples after the first
    value: np.ndarray  # (flash,) of the signal as it is, at the worst phase
    change: np.ndarray  # (n,) M(1), M(2), .. of what the tooth passing does not explain, worst phase


def once_per_tooth(
    signal: np.ndarray, rest: np.ndarray, harmonics: np.ndarray, cycle: float, per_turn: int, *, kept: np.ndarray
) -> Strobes:
    """Look at a signal once per tooth, at several phases.

    Harmonics of the tooth passing are the same at every flash. So M is of the rest, and of the harmonics between them that are
    not runout.

    signal, rest : (sample,), the rest without harmonics   harmonics : complex (K + 1,)   cycle : turns per sample
    per_turn : flashes in a turn   kept : orders of the harmonics that count beside the rest
    """
    moving = rest
    if len(kept):
        chosen = np.zeros((1, len(harmonics)), complex)
        chosen[0, kept] = harmonics[kept]
        moving = rest + evaluate(chosen, cycle, 0, len(rest))[0]
    period = 1 / (cycle * per_turn)
    count = int((len(signal) - 2 * MARGIN - 1) / period) - 1
    count = max(min(count, MOST), 1)
    first = len(signal) - MARGIN - 1 - (count + 1) * period
    at = first + np.arange(PHASES)[:, np.newaxis] * period / PHASES + np.arange(count) * period
    flashes = strobe(moving, np.maximum(at, 0.0))
    found = np.array([change(flashes, n) if count > n else np.full(PHASES, np.nan) for n in range(1, LONGEST + 1)])
    worst = int(np.argmax(np.nan_to_num(found[0])))
    largest = np.nan_to_num(found, nan=-np.inf).max(axis=1)
    return Strobes(
        at[worst], strobe(signal, np.maximum(at[worst], 0.0)), np.where(np.isfinite(largest), largest, np.nan)
    )
