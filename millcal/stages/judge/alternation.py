"""Whether teeth cut differently because of runout, or because the cut flips or locks to the spindle.

With an even number of teeth the lines of a flip, at odd multiples of half the tooth passing, are harmonics of the spindle as
those of runout are, and both last without a change; so it is with every motion that repeats after a number of teeth which divides
theirs. What tells them apart is their size. Teeth of the same shape that cut chips in the ratios w_0, w_1, .. make the
harmonics P(p) W(p mod N), P the spectrum of one tooth and W the transform of the ratios: |W(q)| / W(0) is how far chips
differ, the same at all harmonics of one q, and at most 1, where some teeth cut nothing. The structure scales every harmonic by
its own receptance, which the neighbours on either side have as well but for resonances; the median over the harmonics leaves
these out. Runout of a fraction of the feed makes chips differ by such a fraction, mostly from turn to turn (q = 1). A flip
(q = N/2) grows until teeth leave the cut, and is largest where its lines meet a resonance.

Runout that is amplified near a flip passes into a flip without a step, so between the two nobody can tell: with a multiplier
of -mu the tool swings 1 / (1 - mu) times as far as on a stiff path, so that a runout which was measured tells a flip only
where it is next to nothing.
"""

from math import gcd
from typing import NamedTuple

import numpy as np

from millcal.physics.cutter import Cutter

FEWEST = 3  # harmonics that are compared
MOST = 24  # of them: the lowest, whose neighbours are most alike
SEEN = 25.0  # power over the noise, of the neighbours
LITTLE = 0.4  # difference of the chips up to which it is runout
MUCH = 0.55  # from which it may be a motion of its own that has grown up
TOO_MUCH = 2.0  # beyond, the tooth passing is silent for another reason
SMALL = 0.5  # power of these lines over that of the tooth passing, up to which it is runout all the same
LARGE = 4.0  # from which it is no runout, where runout makes such lines (q = 1)
LARGE_OTHER = 1.5  # and where it hardly does
BEYOND = 30.0  # times the difference that a measured runout makes: more than a stable cut makes of it at a resonance
NEAR = 1.5  # times that: runout
QUIET, LOUD = (
    0.03,
    0.15,
)  # of the feed per tooth, rms: up to which teeth differ little, and from which some leave the cut


class Alternation(NamedTuple):
    """How teeth differ, in the strongest way they do."""

    step: int  # q
    chips: float  # |W(q)| / W(0); nan where too few harmonics tell
    power: float  # of the lines of q, over that of the tooth passing
    strongest: int  # order of the strongest such line, in turns of the spindle
    period: int  # teeth after which such a motion repeats
    own_power: float  # mean square of these lines


def alternation(harmonics: np.ndarray, noise: np.ndarray, teeth: int) -> Alternation | None:
    """The strongest way in which teeth differ; None of a single tooth.

    harmonics : complex (K + 1,) of the spindle   noise : (K + 1,) mean square in each
    """
    if teeth < 2 or len(harmonics) <= teeth:
        return None
    own = 0.5 * np.abs(harmonics) ** 2
    clean = np.maximum(own - noise, 0.0)
    order = np.arange(len(own))
    others = max(float(clean[teeth::teeth].sum()), 1e-300)
    ways = [np.flatnonzero((order % teeth == q) | (order % teeth == teeth - q)) for q in range(1, teeth // 2 + 1)]
    q = int(np.argmax([clean[way].sum() for way in ways])) + 1
    lines = ways[q - 1]
    ratios = []
    for p in lines[:MOST]:
        below = p // teeth * teeth
        beside = [k for k in (below, below + teeth) if teeth <= k < len(own)]
        if beside and all(own[k] > SEEN * noise[k] for k in beside):
            place = (p - below) / teeth if len(beside) == 2 else 0.0
            level = sum(w * 0.5 * np.log(own[k]) for k, w in zip(beside, (1 - place, place), strict=False))
            ratios.append(np.sqrt(own[p]) / np.exp(level))
    return Alternation(
        q,
        float(np.median(ratios)) if len(ratios) >= FEWEST else np.nan,
        float(clean[lines].sum()) / others,
        int(lines[np.argmax(own[lines])]),
        teeth // gcd(q, teeth),
        float(clean[lines].sum()),
    )


def expected_chips(cutter: Cutter | None, feed_per_tooth: float | None, step: int) -> float | None:
    """|W(q)| / W(0) by a runout that was measured; None where none was.   feed_per_tooth : m"""
    if cutter is None or not cutter.runout > 0 or not feed_per_tooth:
        return None
    offset = cutter.runout * np.cos(cutter.runout_angle + cutter.tooth_lag())
    chip = offset - np.roll(offset, 1)
    turn = np.exp(-2j * np.pi * step * np.arange(cutter.teeth) / cutter.teeth)
    return float(min(abs(np.mean(chip * turn)) / feed_per_tooth, 1.0))


def reading(found: Alternation, teeth: int, expected: float | None = None, swing: float | None = None) -> str:
    """`own` (a flip, or locked to the spindle), `runout`, or `either`.

    expected : difference of the chips by known runout, 0 where there is none
    swing : rms of the lines over the feed, of a motion of the tip
    """
    by_runout = found.step == 1
    if swing is not None and swing < QUIET:
        return "runout"
    large = LARGE if by_runout else LARGE_OTHER
    if found.power < SMALL:
        return "runout"
    if found.chips < LITTLE and found.power < LARGE:
        return "either" if swing is not None and swing > LOUD and found.power > 1 else "runout"
    if by_runout and teeth > 2:  # with many teeth in cut the tooth passing vanishes, and runout is all there is
        moves = MUCH < found.chips < TOO_MUCH if swing is None else swing > LOUD
        return "either" if moves and found.power > LARGE else "runout"
    if expected == 0.0:
        return "own"
    if expected is not None and by_runout and np.isfinite(found.chips):
        if found.chips > BEYOND * expected:
            return "own"
        return "runout" if found.chips < NEAR * expected else "either"
    if not found.chips >= MUCH:
        return "either"
    return "own" if found.power > large else "either"
