"""Lines that are the teeth at another speed than the stated one.

A speed that is far off may still be followed by a few harmonics: where 11 of its turns are 9 of the true ones, every ninth
harmonic of the true spindle falls on an eleventh of it. What then remains is no chatter but a comb of its own. Chatter makes
lines that lie whole tooth passings apart; they are multiples of one frequency only where that is a fraction of the tooth
passing, or where they are its overtones.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.tones import Tone, folded

TONES, SMALLEST = 12, 1e-3  # that are compared, and their power over that of the strongest
FEWEST = 5
HIGHEST_ORDER = 30  # of the strongest
LINES_APART = 6.0  # lines of the spectrum at least from one to the next
BY_CHANCE = 1e-7  # probability that tones lie so
FAR = 3.0  # times the stated speed, or slower: so far off nobody states one
MOST_BESIDE = 0.01  # of their power in others
MOST_OF_IT = 0.5  # of all power in them
LONGEST_PERIOD = 8  # turns after which a motion of this speed may repeat
AS_OVERTONES = 2.0  # tooth passings, from which a strongest line is that of chatter and the others its overtones


class OtherComb(NamedTuple):
    """The fundamental of a comb that is not the stated one's."""

    fundamental: float  # cycles per sample
    tones: int
    share: float  # of the power


def other_comb(tones: list[Tone], power: float, size: int, cycle: float, teeth: int) -> OtherComb | None:
    """The comb of which the tones that do not follow the spindle are lines; None where they are of none, or of one that a motion
    with this spindle has as well.

    tones : the strongest first   power : of all that is no noise   size : samples of the spectrum   cycle : turns per sample
    """
    tones = [tone for tone in tones if tone.sharp]
    held = sum(tone.power for tone in tones)
    compared = [tone for tone in tones if tone.power > SMALLEST * tones[0].power][:TONES]
    if len(compared) < FEWEST or held < MOST_OF_IT * power:
        return None
    f = np.array([tone.frequency for tone in compared])
    reach = 0.3 / size + 3 * np.array([tone.deviation for tone in compared])
    for first in range(1, HIGHEST_ORDER + 1):
        base = float(f[0]) / first
        if base * size < LINES_APART or base < cycle / FAR:
            break
        if base > FAR * teeth * cycle:
            continue
        fits = np.abs(folded(f, base)) < reach + reach[0] * f / f[0]
        if fits.sum() < FEWEST:
            continue
        order = np.rint(f / base)
        weight = np.where(fits, 1 / reach**2, 0.0)
        base = float(np.sum(weight * order * f) / np.sum(weight * order**2))
        fits = np.abs(folded(f, base)) < reach
        chance = HIGHEST_ORDER * float(np.prod(np.minimum(2 * reach[fits] / base, 1.0)[1:]))
        beside = sum(tone.power for tone, fit in zip(compared, fits, strict=True) if not fit)
        if not fits[0] or fits.sum() < FEWEST or chance > BY_CHANCE or beside > MOST_BESIDE * held:
            continue
        turns = teeth * cycle / base  # of the tooth passing
        repeats = round(turns) >= 1 and abs(turns / round(turns) - 1) < 0.5 / size / base
        if (repeats and round(turns) <= LONGEST_PERIOD * teeth) or (first == 1 and base > AS_OVERTONES * teeth * cycle):
            return None
        return OtherComb(base, int(fits.sum()), (held - beside) / power)
    return None


def told_comb(comb: OtherComb, teeth: int, rate: float, cycle: float) -> str:
    """What to say of it.   rate : Hz"""
    rpm = 60 * comb.fundamental * rate
    at = f"{rpm:.5g} rpm" if teeth == 1 else f"{rpm / teeth:.5g} rpm (or the spindle at {rpm:.5g} rpm)"
    return (
        f"{comb.tones} lines with {comb.share:.0%} of the power are multiples of {comb.fundamental * rate:.5g} Hz, as those of the "
        f"teeth at {at}, and no harmonics of a spindle at {60 * cycle * rate:.5g} rpm; state the speed of this cut"
    )
