"""The phase of a periodic signal whose period wanders, from one short stretch to the next.

Harmonic k of a stretch is turned by k times the phase by which the stretch runs ahead of uniform motion. From neighbour to
neighbour that phase changes little, so it is followed outwards from the middle, each stretch against the mean of those before it.
"""

import numpy as np

MEMORY = (
    0.2  # weight of the newest stretch in the mean it is compared with: a signal that changes its shape is followed
)
TRIALS = 25
BEGINNING = 5  # stretches about the middle whose own change of phase is found first


def track_phase(harmonics: np.ndarray) -> np.ndarray:
    """By how much each stretch runs ahead, 0 in the middle.

    harmonics : complex (stretch, channel, 1..K)   returns (stretch,) rad
    """
    count = len(harmonics)
    middle = count // 2
    phase = np.zeros(count)
    for order in (range(middle + 1, count), range(middle - 1, -1, -1)):
        reference, step, last = harmonics[middle], 0.0, 0.0
        for number, i in enumerate(order):
            ahead = last + step
            ahead += _turn_between(reference, turned_back(harmonics[i], ahead))
            step = ahead - last if number < BEGINNING else 0.7 * step + 0.3 * (ahead - last)
            phase[i] = last = ahead
            reference = (1 - MEMORY) * reference + MEMORY * turned_back(harmonics[i], ahead)
    return phase


def turned_back(harmonics: np.ndarray, phase: float) -> np.ndarray:
    """The harmonics as they would be without this phase.   harmonics : complex (channel, 1..K)   phase : rad"""
    return harmonics * np.exp(-1j * phase * np.arange(1, harmonics.shape[-1] + 1))


def _turn_between(reference: np.ndarray, harmonics: np.ndarray) -> float:
    """The phase at which the harmonics agree best with the reference: trials within a period of the highest, then Newton."""
    order = np.arange(1, harmonics.shape[-1] + 1)
    cross = np.sum(reference.conj() * harmonics, axis=0)
    trials = np.linspace(-1.0, 1.0, TRIALS) * min(0.6, 6.0 / len(order))
    turn = float(trials[np.argmax(np.real(np.exp(-1j * np.multiply.outer(trials, order)) @ cross))])
    limit = trials[1] - trials[0]
    for _ in range(4):
        c = cross * np.exp(-1j * turn * order)
        slope, bend = np.sum(order * c.imag), np.sum(order**2 * c.real)
        if bend <= 0:
            break
        turn += float(np.clip(slope / bend, -limit, limit))
    return turn
