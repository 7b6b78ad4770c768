"""Whether every other tooth cuts otherwise because of runout, or because the cut flips.

With an even number of teeth the lines of a flip, at odd multiples of half the tooth passing, are harmonics of the spindle as
those of runout are, and both last without a change. What tells them apart is their size. Teeth of the same shape that
cut chips in the ratios w_0, w_1, .. make the harmonics P(p) W(p mod N), P the spectrum of one tooth and W the transform of
the ratios: |W(N/2)| / W(0) is how far chips alternate, the same at all harmonics, and at most 1, where every other tooth
cuts nothing. The structure scales every harmonic by its own receptance, which the neighbours on either side have as well but
for resonances; the median over the harmonics leaves these out. Runout of a fraction of the feed alternates chips by such
a fraction. A flip grows until every other tooth leaves the cut, and is largest where its lines meet a resonance.

Runout that is amplified near a flip passes into a flip without a step, so between the two nobody can tell.
"""

from typing import NamedTuple

import numpy as np

from millcal.physics.cutter import Cutter

FEWEST = 3  # harmonics that are compared
MOST = 12  # of them: the lowest, whose neighbours are most alike
SEEN = 25.0  # power over the noise, of the neighbours
LITTLE = 0.4  # alternation of the chips up to which it is runout
MUCH = 0.55  # from which it may be a flip that has grown up
SMALL = 0.2  # power of the alternating lines over the others', up to which it is runout all the same
LARGE = 4.0  # from which it is a flip
OF_MANY_TEETH = 1.5  # the same with four teeth or more, whose runout alternates from tooth to tooth only a little
BEYOND = 3.0  # times the alternation that a measured runout makes: a flip
NEAR = 1.5  # times that: runout


class Alternation(NamedTuple):
    """How every other tooth differs."""

    chips: float  # |W(N/2)| / W(0); nan where too few harmonics tell
    power: float  # of the lines at odd multiples of half the tooth passing, over that at the tooth passing's own
    strongest: int  # order of the strongest such line, in turns of the spindle


def alternation(harmonics: np.ndarray, noise: np.ndarray, teeth: int) -> Alternation | None:
    """Of an even number of teeth; None of an odd one, whose flip lies between the spindle's harmonics.

    harmonics : complex (K + 1,) of the spindle   noise : (K + 1,) mean square in each
    """
    half, odd = divmod(teeth, 2)
    if odd or len(harmonics) <= teeth:
        return None
    own = 0.5 * np.abs(harmonics) ** 2
    alternating = np.arange(half, len(own), teeth)
    passing = np.arange(teeth, len(own), teeth)
    ratios = []
    for p in alternating[:MOST]:
        beside = [q for q in (p - half, p + half) if teeth <= q < len(own)]
        if beside and all(own[q] > SEEN * noise[q] for q in beside):
            ratios.append(np.sqrt(own[p]) / np.exp(np.mean([0.5 * np.log(own[q]) for q in beside])))
    others = float(np.sum(np.maximum(own[passing] - noise[passing], 0.0)))
    mine = float(np.sum(np.maximum(own[alternating] - noise[alternating], 0.0)))
    return Alternation(
        float(np.median(ratios)) if len(ratios) >= FEWEST else np.nan,
        mine / max(others, 1e-300),
        int(alternating[np.argmax(own[alternating])]),
    )


def expected_chips(cutter: Cutter | None, feed_per_tooth: float | None) -> float | None:
    """|W(N/2)| / W(0) by a runout that was measured; None where none was.   feed_per_tooth : m"""
    if cutter is None or not cutter.runout > 0 or not feed_per_tooth:
        return None
    offset = cutter.runout * np.cos(cutter.runout_angle + cutter.tooth_lag())
    chip = offset - np.roll(offset, 1)
    return float(min(abs(np.mean(chip * (-1.0) ** np.arange(cutter.teeth))) / feed_per_tooth, 1.0))


def reading(found: Alternation, teeth: int, expected: float | None = None) -> str:
    """`flip`, `runout`, or `either`.   expected : alternation of the chips by the runout, where that is known"""
    if found.power < SMALL or (found.chips < LITTLE and found.power < LARGE):
        return "runout"
    if expected is not None and np.isfinite(found.chips):
        if found.chips > BEYOND * expected:
            return "flip"
        return "runout" if found.chips < NEAR * expected else "either"
    if not found.chips >= MUCH:
        return "either"
    return "flip" if found.power > (LARGE if teeth == 2 else OF_MANY_TEETH) else "either"
