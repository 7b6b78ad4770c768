"""From what remains of a cut to its verdict: stable, period-n, chatter, or not known, each with its reason.

A limit cycle ends where teeth leave the cut, so developed chatter moves the tool about as far as the feed per tooth: it is
never a small share of the signal near the tool. Small tones are therefore not called chatter unless their company a tooth passing
away shows that the cut modulates them.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.tones import STANDS_OUT, Tone, folded
from millcal.stages.judge.alternation import SMALL, Alternation, reading
from millcal.stages.judge.remains import Remains

SURE = 0.15  # share of the power from which a tone without company is chatter
WITH_COMPANY = 0.02  # with tones a tooth passing away
MUCH, WITH_MUCH = 3, 0.003  # with so many of them: nothing else is modulated so
WEAK = 0.0005  # with any: worth a word
TOLD = 0.0005  # share of the power from which lines are not passed over in silence
IN_COMB = 0.01  # of the strongest tone's power, from which one counts as of a comb
COMPANY = 0.003  # of its power, from which a tone a tooth passing away is one
BROAD = 0.5  # share of a hump from which it is chatter that wanders
DOUBTFUL_HUMP = 0.2
FEWEST_REVOLUTIONS = 8  # for a verdict of what is not there
ALONE = 1e3  # times the least that would be seen: a line without overtones then is none of teeth at another speed
MOST_OF_IT = 0.5  # share of the power of a tone that is told from fewer
BESIDE = (
    1.2  # lines from a harmonic of the teeth, within which a tone without company may be that harmonic come and gone
)
LONGEST_PERIOD = 8
REPEATS = 0.2  # M(n) over M(1)
GROWS = 3.0
NEAR = 0.012  # how far a stated speed may be off
MOST_TOLD = 100.0  # beyond, the tooth passing is nearly silent
STRAY = 3.0  # times the power of the tooth passing, in one harmonic of the spindle alone
DIES = 0.3
HIGHEST = 12_000.0  # Hz: no tool chatters above it
WORDS = {False: ("the tooth passing", "a tooth passing", "teeth"), True: ("the spindle", "whole turns", "turns")}


class Finding(NamedTuple):
    """The verdict and what it rests on."""

    verdict: str
    why: str
    period: int | None
    tones: list[Tone]  # of the chatter, strongest first
    share: float
    alternates: bool  # harmonics of the spindle between those of the tooth passing are chatter


def company(family: list[Tone], passing: float, size: int) -> int:
    """Tones a whole number of tooth passings from the strongest, or so after a change of sign.   passing : per sample"""
    first = family[0]
    count = 0
    for tone in family[1:]:
        if tone.power < COMPANY * first.power:
            continue
        reach = 1.0 / size + 3 * (tone.deviation + first.deviation)
        near = abs(float(folded(tone.frequency, passing)) - float(folded(first.frequency, passing))) < reach
        count += near and abs(tone.frequency - first.frequency) > 0.4 * passing
    return count


def rational_period(tone: Tone, passing: float, size: int, changes: np.ndarray) -> int | None:
    """Teeth after which a motion with this tone repeats; None where it does not soon.

    A frequency near a fraction repeats nearly: the mean change over n teeth must have fallen as well.
    """
    turn = tone.frequency / passing
    reach = (0.1 / size + 3 * tone.deviation) / passing
    for n in range(2, LONGEST_PERIOD + 1):
        near = abs(turn * n - round(turn * n)) / n < min(reach, 0.05 / n**2)
        if near and len(changes) >= n and changes[n - 1] < REPEATS * changes[0]:
            return n
    return None


def judged(
    found: Remains,
    *,
    teeth: int,
    cycle: float,
    rate: float,
    revolutions: float,
    follows: bool,
    far_off: bool,
    amplitudes: np.ndarray,
    changes: np.ndarray,
    alternating: Alternation | None,
    alternating_grows: bool,
    expected: float | None,
    by_force: bool,
    swing: float | None,
    by_turns: bool = False,
    other: str | None = None,
) -> Finding:
    """The verdict on one channel.

    far_off : the speed is known from the harmonics alone, and is not what was stated
    amplitudes : (block,) course of the strongest tone   changes : M(1), M(2), .. without harmonics of the spindle
    alternating_grows : the lines at odd multiples of half the tooth passing grow against those of the tooth passing
    expected : by how much chips alternate by a runout that was measured, 0 where there is none; None: not known
    by_force : the channel is a force, whose tooth passing edge forces and teeth in cut may hide
    swing : rms of the lines in which teeth differ over the feed per tooth, of a motion of the tip; None: not known
    by_turns : the teeth are not evenly pitched, and `teeth` is 1 for what repeats with the turn
    other : what to say of the teeth at another speed, where the lines that remain are theirs
    """
    if other is not None:
        return _unknown(other)
    size, passing = found.spectra.size, teeth * cycle
    driven, away, beats = WORDS[by_turns]
    share = found.share
    if len(amplitudes) and found.family:
        mean_square = float(np.mean(amplitudes**2))
        thirds = [float(np.sqrt(np.mean(part**2))) for part in np.array_split(amplitudes, 3)]
        if thirds[2] < DIES * thirds[0] and mean_square > 0:
            share *= thirds[2] ** 2 / mean_square
    several = company(found.family, passing, size) if found.family else 0
    needed = WITH_MUCH if several >= MUCH else WITH_COMPANY if several else SURE
    few = revolutions < FEWEST_REVOLUTIONS
    if found.family and share >= needed and not several and not follows:
        f, k = found.family[0].frequency, round(found.family[0].frequency / passing)
        if k and abs(f / (k * passing) - 1) < NEAR:
            return _unknown(
                f"one line stands out alone, at {f * rate:.5g} Hz, and nothing shows the speed so well that it could be told "
                f"from harmonic {k} of {driven}; record a pulse per revolution, or less noise"
            )
    if found.family and share >= needed and not several and not follows and not (_without_overtones(found) and not few):
        return _unknown(_comb_of_another_speed(found.family, teeth, size, rate, cycle))
    if found.family and share >= needed and not several:
        f, k = found.family[0].frequency, round(found.family[0].frequency / passing)
        if k and abs(f - k * passing) * size < BESIDE:
            return _unknown(
                f"a line at {f * rate:.5g} Hz stands so near harmonic {k} of {driven} that so short a record does not "
                "tell whether it is one of its own; record more turns, without entry and exit"
            )
    if found.family and share >= needed and found.folded_from is not None:
        f = found.family[0].frequency
        return _unknown(
            f"the line at {f * rate:.5g} Hz is where a harmonic of {driven}, at {found.folded_from:.5g} Hz, comes back "
            f"from above half the sample rate: sample faster, or behind an anti-aliasing filter"
        )
    if found.family and few and (share < MOST_OF_IT or found.family[0].frequency < cycle):
        needed = np.inf
    if found.family and share >= needed:
        tone = found.family[0]
        f = tone.frequency * rate
        period = rational_period(tone, passing, size, changes)
        beside = f" with {several} more {away} apart" if several else ""
        course = _course(amplitudes)
        if period is not None:
            return Finding(
                "period-n",
                f"a line at {f:.5g} Hz{beside} holds {share:.0%} of the power and the motion repeats every {period} {beats}"
                + (": a flip" if period == 2 else "") + course,
                period, found.family, found.share, False,
            )  # fmt: skip
        return Finding(
            "chatter",
            f"a line at {f:.5g} Hz{beside} follows neither teeth nor spindle and holds {share:.0%} of the power{course}",
            None, found.family, found.share, False,
        )  # fmt: skip
    if found.hump_share >= BROAD and not few:
        hump = found.humps[0]
        return Finding(
            "chatter",
            f"a broad line about {hump.frequency * rate:.4g} Hz holds {found.hump_share:.0%} of the power: chatter whose "
            "frequency wanders",
            None, [hump], found.hump_share, False,
        )  # fmt: skip
    if alternating is not None and follows and not few:
        told = _alternation(alternating, teeth, cycle, rate, alternating_grows, expected, swing, by_force)
        if told is not None:
            return told
    if few:
        return _unknown(
            f"{int(revolutions)} whole revolutions are too few to see what lies between the harmonics of the spindle"
        )
    if not follows:
        return _unknown(
            "nothing in the signal follows the spindle, and no line of its own stands out: is the cut in it?"
        )
    if found.family and share >= WITH_COMPANY:
        return _unknown(
            f"a line at {found.family[0].frequency * rate:.5g} Hz holds {share:.1%} of the power and has no company {away} "
            "away: chatter that begins, or another machine; an air cut would tell"
        )
    if found.hump_share >= DOUBTFUL_HUMP:
        return _unknown(
            f"a broad hump about {found.humps[0].frequency * rate:.4g} Hz holds {found.hump_share:.0%} of the power: a "
            "resonance that noise excites, or chatter that wanders"
        )
    stray = _stray(found, teeth) if far_off else None
    if stray is not None:
        order, ratio = stray
        return _unknown(
            f"harmonic {order} of the spindle, at {order * cycle * rate:.5g} Hz, has {ratio:.2g} times the power of the tooth "
            "passing and is none of its harmonics: runout that meets a resonance, or chatter on that line; a pulse per "
            "revolution would tell, or a cut at a speed some percent away"
        )
    others = [tone for tone in found.tones if tone.sharp and tone.power >= TOLD * found.power]
    all_of_it = (
        "what stands out follows the teeth and the spindle, but for weak lines"
        if others
        else ("all that stands out follows the teeth and the spindle")
    )
    why = f"{all_of_it}, up to {rate / 2:.5g} Hz"
    if alternating is not None and SURE < alternating.power < MOST_TOLD:
        order = alternating.strongest
        why += (
            f"; runout shows {alternating.power:.2g} times the power of the tooth passing between its harmonics, the most at "
            f"{order * cycle * rate:.5g} Hz"
        )
    if found.family and several and share >= WEAK:
        why += (
            f"; one at {found.family[0].frequency * rate:.5g} Hz with {several} more {away} apart holds "
            f"{share:.2%} of the power, as chatter begins: watch it"
        )
    elif found.family and found.share >= WITH_COMPANY:
        why += f"; a line at {found.family[0].frequency * rate:.5g} Hz dies away"
    return Finding("stable", why, 1, [], share, False)


def _without_overtones(found: Remains) -> bool:
    """Whether the strongest line stands far above the least that would be seen, and nothing is at its multiples or fractions: a cut
    that breaks off has overtones.
    """
    first, size = found.family[0], found.spectra.size
    least = 2 * STANDS_OUT * float(np.median(found.spectra.power[0])) / size
    related = [m / n for n in (1, 2, 3) for m in (1, 2, 3, 4, 6) if m != n]
    alone = all(
        abs(tone.frequency - ratio * first.frequency) * size > 1.0
        for tone in found.tones
        if tone is not first
        for ratio in related
    )
    return found.share >= MOST_OF_IT and first.power > ALONE * least and alone


def _comb_of_another_speed(family: list[Tone], teeth: int, size: int, rate: float, cycle: float) -> str:
    """What to say of lines where nothing follows the stated speed: multiples of one frequency may be the teeth at another."""
    large = [tone.frequency for tone in family if tone.power > IN_COMB * family[0].power]
    said = f"lines stand out, the most at {large[0] * rate:.5g} Hz, but nothing follows a spindle near {60 * cycle * rate:.5g} rpm"
    for part in range(1, 5):
        base = min(large) / part
        if len(large) > 1 and all(folded(f, base) < 1.0 / size for f in large) and base > 4.0 / size:
            rpm = 60 * base * rate
            at = f"{rpm:.5g} rpm" if teeth == 1 else f"{rpm / teeth:.5g} rpm (or the spindle at {rpm:.5g} rpm)"
            return f"{said}: they are multiples of {base * rate:.5g} Hz, as those of the teeth at {at}; state the speed of this cut"
    return f"{said}: chatter, or teeth at another speed; check the speed, or record a pulse per revolution"


def _stray(found: Remains, teeth: int) -> tuple[int, float] | None:
    """The harmonic of the spindle that outweighs all of the teeth, where one does: its order and by how much."""
    own = np.maximum(0.5 * np.abs(found.harmonics) ** 2 - found.noise, 0.0)
    own[0] = 0.0
    of_teeth = float(own[::teeth].sum())
    own[::teeth] = 0.0
    if teeth % 2 == 0:
        own[teeth // 2 :: teeth] = 0.0  # judged by themselves
    order = int(np.argmax(own))
    ratio = float(own[order]) / max(of_teeth, 1e-300)
    return (order, ratio) if ratio > STRAY else None


def _unknown(why: str) -> Finding:
    return Finding("not known", why, None, [], 0.0, False)


def _course(amplitudes: np.ndarray) -> str:
    """What is to be told of how a tone grows or goes."""
    if len(amplitudes) < 6:
        return ""
    first, _, last = (float(np.sqrt(np.mean(part**2))) for part in np.array_split(amplitudes, 3))
    if last > GROWS * first:
        return "; it grows during the cut"
    if last < DIES * first:
        return "; it dies away during the cut"
    return ""


def _alternation(
    found: Alternation,
    teeth: int,
    cycle: float,
    rate: float,
    grows: bool,
    expected: float | None,
    swing: float | None,
    by_force: bool,
) -> Finding | None:
    """A flip, or why it cannot be told from runout; None where it is runout.   cycle : turns per sample   rate : Hz"""
    said = reading(found, teeth, expected, swing)
    flips = found.period == 2
    grows = grows and flips
    at = found.strongest * cycle * rate
    share = found.power / (1 + found.power)
    who = "every other tooth cuts otherwise" if flips else f"the teeth cut differently, again after {found.period}"
    if said == "runout" and not (grows and found.power >= SMALL):
        return None
    if (said == "own" and not (by_force and expected is None)) or grows:
        line = Tone(found.strongest * cycle, 0.0, share, True)
        cause = ": a flip" if flips else ": chatter locked to the spindle"
        if grows:
            cause = "; it grows against the tooth passing" + cause
        elif expected is None:
            cause += "; only runout so large that some teeth cut nothing would look the same"
        else:
            cause += ", far more than the measured runout makes" if expected else ", and there is no runout to make it"
        why = f"{who}, with {share:.0%} of the power in such lines, the most at {at:.5g} Hz{cause}"
        return Finding("period-n", why, found.period, [line], share, True)
    it = "a flip" if flips else "chatter locked to the spindle"
    seen = f"{who} ({found.power:.2g} times the power of the tooth passing, the most at {at:.5g} Hz)"
    if expected:
        return _unknown(
            f"{seen}: the measured runout makes chips differ by {expected:.0%}, which a tool near its limit amplifies until it "
            f"looks like {it}; a cut at a speed some percent away would tell"
        )
    return _unknown(
        f"{seen}: strong runout near a resonance and {it} look the same here; a cut at a speed some percent away, or a cutter "
        "measured to have no runout, would tell"
    )
