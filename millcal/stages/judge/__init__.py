"""Was that chatter? A recorded cut judged by what does not repeat with the teeth.

Forced vibration repeats with every tooth, and with runout every turn of the spindle: its lines are harmonics of the spindle. They
are found, with the speed that the record itself tells, and taken out. Chatter leaves tones of its own, a whole number of tooth
passings apart; where these lie at fractions of the tooth passing, the motion repeats after some teeth. What the record cannot
tell is said: a flip that runout hides, a sample rate too low, too few turns. Not known, with its reason, is better than a guess.

References
----------
Insperger, Stepan, Bayly, Mann 2003, Multiple chatter frequencies in milling processes, J. Sound Vib. 262 (the lines of Hopf and
flip, and how they lie to the tooth passing).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from millcal.data import Judgement, Level, Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.straighten import straightened
from millcal.stages.judge.alternation import Alternation, alternation, expected_chips
from millcal.stages.judge.answer import answer
from millcal.stages.judge.other_comb import other_comb, told_comb
from millcal.stages.judge.remains import Remains, course, falls_off, look
from millcal.stages.judge.signal import (
    cutting_stretch,
    judged_rows,
    note_clipping,
    reader,
    refuse_what_is_no_number,
)
from millcal.stages.judge.speed import FAR_FROM_STATED, refined_cycle
from millcal.stages.judge.strobes import once_per_tooth
from millcal.stages.judge.verdict import HIGHEST, MUCH, WITH_COMPANY, WITH_MUCH, Finding, company, judged

__all__ = ["judge_cut"]

MOST_CHANNELS = 6
FEWEST_PER_TOOTH = 2.1  # samples
HARMONICS = 6  # of the tooth passing, by which a wandering speed is followed
TOLD = 0.005  # share of the power of a tone that is not the cut's, from which it is told
SEEN_UP_TO = 0.45  # of the sample rate
LOW = 1000.0  # Hz: tools vibrate above it as a rule
PASSINGS = 5  # tooth passings that a spectrum should hold
LATE = 0.3  # share of the cut that is looked at by itself, where the whole shows nothing
BEGINS = 2.0  # times its power in the whole has a tone that begins there
FEWEST_LATE = 12  # revolutions of it
GROWS = 3.0  # of the alternating lines over those of the tooth passing, from the first third to the last
DOUBTFUL_MODE = 0.2  # relative distance of a chatter frequency from all modes, from which another alias is looked for


def judge_cut(
    recording: Recording,
    *,
    channel: str | None = None,
    teeth: int | None = None,
    spindle_speed: float | None = None,
    steady: tuple[float, float] | None = None,
    modes: Sequence[float] = (),
    no_runout: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Judgement:
    """Judge one recorded cut.

    Displacement goes before acceleration, velocity, sound and force; of several channels the one that shows most is told.

    channel : name; None: chosen   teeth : None: the cutter's   spindle_speed : rad/s, to a few percent; None: the recording's
    steady : s after the first sample; else what the recording says, else found
    modes : natural frequencies of the tool, Hz, where known: what the sample rate cannot show is then known too
    no_runout : the cutter is known to have none, so teeth that cut differently do so of themselves
    progress : called with (share, label)

    Raises RecordingError where teeth or speed are not known, where no channel tells, or where the cut holds no turns.
    """
    tell = progress or (lambda share, label: None)
    where = recording.name or "recording"
    rate = recording.sample_rate
    notices: list[Notice] = []

    def note(code: str, message: str, level: Level = "warning") -> None:
        notices.append(Notice(code, message, where, level))

    tell(0.0, "cut and air")
    teeth, stated = _stated(recording, teeth, spindle_speed, where)
    rows = surveyed = judged_rows(recording, channel, where)[:MOST_CHANNELS]
    stretch = cutting_stretch(recording, rows, stated / rate, teeth, steady, where, note)
    samples = reader(recording, rows)(stretch.start, stretch.stop)
    for row, signal in zip(rows, samples, strict=True):
        refuse_what_is_no_number(signal, stretch.start, rate, where, recording.channels[row].name)
    moving = np.ptp(samples, axis=1) > 0
    if not moving.any():
        raise RecordingError(f"{where}: the signal never changes during the cut; check the channel")
    rows, samples = [row for row, there in zip(rows, moving, strict=True) if there], samples[moving]
    recorded = samples

    tell(0.2, "spindle speed")
    cycle, follows = refined_cycle(recording, samples, stretch.start, stated / rate, teeth, note)
    straight = straightened(samples, cycle.cycle, harmonics=HARMONICS, every=teeth) if follows else None
    if straight is not None:
        samples = straight[0]
        note(
            "speed-wander",
            f"the speed wanders: the signal is read at even steps of the spindle angle, which {straight[1]:.0%} more of its power "
            "follows",
            "note",
        )
    revolutions = (stretch.stop - stretch.start) * cycle.cycle

    tell(0.5, "what does not follow the teeth")
    air = None if stretch.air is None else reader(recording, rows)(*stretch.air)
    if air is not None and not np.isfinite(air).all():
        air = None
    quiet = [None] * len(rows) if air is None else list(air)
    known = {"cycle": cycle.cycle, "cycle_sd": cycle.sd, "teeth": teeth, "rate": rate}
    looks = [look(row, signal, calm, **known) for row, signal, calm in zip(rows, samples, quiet, strict=True)]
    late = int(LATE * samples.shape[1])
    if max(one.share for one in looks) < WITH_COMPANY and late * cycle.cycle >= FEWEST_LATE:
        # a spectrum under a window sees little of what begins at the end
        ends = [look(row, y[-late:], calm, **known) for row, y, calm in zip(rows, samples, quiet, strict=True)]
        if any(
            end.share >= WITH_COMPANY and _is_new(end, whole, teeth * cycle.cycle)
            for end, whole in zip(ends, looks, strict=True)
        ):
            looks = ends
            stretch = stretch._replace(start=stretch.stop - late)
            revolutions = late * cycle.cycle
            note(
                "late",
                f"what is told is of the end of the cut, from {stretch.start / rate:.4g} s: it begins there",
                "note",
            )
    loudest = max(one.followed for one in looks) or 1.0
    found = max(looks, key=lambda one: _told_share(one, teeth * cycle.cycle) + 1e-6 * one.followed / loudest)
    cutter = recording.cutter
    if cutter is not None and cutter.teeth != teeth:  # stated otherwise: its pitch is then of another cutter
        cutter = replace(cutter, teeth=teeth, pitch=None)
    drive = 1 if cutter is not None and _uneven(cutter.pitch) and teeth > 1 else teeth
    note_clipping(
        recorded[rows.index(found.row)],
        recording.channels[found.row].full_scale,
        recording.channels[found.row].name,
        note,
    )

    tell(0.8, "verdict")
    plain = once_per_tooth(found.signal, found.rest, found.harmonics, cycle.cycle, drive, kept=np.arange(0))
    differs = alternation(found.harmonics, found.noise, drive)
    feed = None if recording.conditions is None else recording.conditions.feed_per_tooth
    expected = 0.0 if no_runout else None if differs is None else expected_chips(cutter, feed, differs.step)
    other = None
    if not recording.rows_of("pulse"):
        other = other_comb(found.tones, found.power, found.spectra.size, cycle.cycle, teeth)
    if other is not None and follows:  # else said before
        note(
            "not-synchronous",
            f"most of the signal repeats with {other.fundamental * rate:.5g} Hz and not with the stated speed; is it the "
            "speed of this cut?",
        )
    verdict = judged(
        found,
        teeth=drive,
        cycle=cycle.cycle,
        rate=rate,
        revolutions=revolutions,
        follows=follows,
        far_off=abs(cycle.cycle * rate / stated - 1) > FAR_FROM_STATED and not recording.rows_of("pulse"),
        amplitudes=course(found.signal, found.family[0].frequency) if found.family else np.empty(0),
        changes=plain.change,
        alternating=differs,
        alternating_grows=_alternating_grows(found.signal, cycle.cycle, drive, revolutions),
        expected=expected,
        by_force=recording.channels[found.row].quantity == "force",
        swing=_swing(recording, found, differs, feed),
        by_turns=drive != teeth,
        other=None if other is None else told_comb(other, teeth, rate, cycle.cycle),
    )
    order = np.arange(len(found.harmonics))
    kept = np.zeros(len(order), bool)
    if verdict.alternates and differs is not None:
        kept = (order % drive == differs.step) | (order % drive == drive - differs.step)
    strobes = once_per_tooth(found.signal, found.rest, found.harmonics, cycle.cycle, drive, kept=order[kept])
    for tone, why in found.machine[:3]:
        if tone.power >= TOLD * found.power:
            note(
                "not-of-the-cut",
                f"a line at {tone.frequency * rate:.5g} Hz is {why}; it is left out of the verdict",
                "note",
            )
    _note_sample_rate(verdict, found, rate, cycle.cycle * rate * teeth, modes, note)
    if drive != teeth:
        note(
            "uneven-pitch",
            "the teeth are not evenly pitched: the motion is looked at once a turn, not once a tooth",
            "note",
        )
    return answer(
        recording, stretch, found, verdict, strobes, cycle, revolutions, teeth, drive, surveyed, tuple(notices)
    )


def _stated(recording: Recording, teeth: int | None, spindle_speed: float | None, where: str) -> tuple[int, float]:
    """Teeth and spindle frequency in Hz, as stated."""
    if teeth is None:
        if recording.cutter is None:
            raise RecordingError(f"{where}: says nothing of the teeth; give --teeth, or a setup with a [cutter] table")
        teeth = recording.cutter.teeth
    if spindle_speed is None:
        if recording.conditions is None:
            raise RecordingError(
                f"{where}: says nothing of the spindle speed; give --rpm, or a setup with [conditions]"
            )
        spindle_speed = recording.conditions.spindle_speed
    if not spindle_speed > 0 or teeth < 1:
        raise RecordingError(f"{where}: {teeth} teeth at {spindle_speed:g} rad/s are no cut; check teeth and speed")
    frequency = spindle_speed / (2 * np.pi)
    if recording.sample_rate < FEWEST_PER_TOOTH * teeth * frequency:
        raise RecordingError(
            f"{where}: {recording.sample_rate:g} samples per second are fewer than {FEWEST_PER_TOOTH:g} per tooth at "
            f"{60 * frequency:g} rpm and do not show the tooth passing; check the sample rate and the speed"
        )
    return teeth, frequency


def _told_share(one: Remains, passing: float) -> float:
    """The share of a channel's tones, where there is something to be told of them."""
    if not one.family:
        return 0.0
    needed = WITH_MUCH if company(one.family, passing, one.spectra.size) >= MUCH else WITH_COMPANY
    return one.share if one.share >= needed else 0.0


def _is_new(end: Remains, whole: Remains, passing: float) -> bool:
    """Whether the strongest tone at the end of a cut is smaller in the whole of it, and has company: in so short a stretch what
    noise makes of a resonance is as sharp.
    """
    if not company(end.family, passing, end.spectra.size):
        return False
    tone, near = end.family[0], 1.5 / end.spectra.size
    return tone.power > BEGINS * sum(
        other.power for other in whole.tones if abs(other.frequency - tone.frequency) < near
    )


def _uneven(pitch: tuple[float, ...] | None) -> bool:
    return pitch is not None and float(np.ptp(pitch)) > 1e-3


def _swing(recording: Recording, found: Remains, differs: Alternation | None, feed: float | None) -> float | None:
    """Rms of the lines in which teeth differ over the feed, where a probe at the tip says it."""
    channel = recording.channels[found.row]
    if differs is None or not feed or channel.quantity != "displacement" or "tip" not in channel.dof:
        return None
    return float(np.sqrt(differs.own_power)) / feed


def _alternating_grows(signal: np.ndarray, cycle: float, teeth: int, revolutions: float) -> bool:
    """Whether the lines at odd multiples of half the tooth passing grow while those of the tooth passing do not."""
    if teeth % 2 or revolutions < 24:
        return False
    edges = np.rint(np.linspace(0, len(signal), 7)).astype(int)
    K = max(teeth, min(40, int(0.45 / cycle)))
    if len(signal) < (K + 1) * 2 * 6:
        return False
    found = np.abs(spectra.block_harmonics(spectra.reader_of(signal[np.newaxis]), edges, cycle, K)[:, 0]) ** 2
    alternating = found[:, np.arange(teeth // 2, K + 1, teeth)].sum(axis=1)
    passing = found[:, np.arange(teeth, K + 1, teeth)].sum(axis=1)
    ratio = alternating / np.maximum(passing, 1e-300)
    return bool(ratio[-2:].mean() > GROWS**2 * ratio[:2].mean() and passing[-2:].mean() > 0.3 * passing[:2].mean())


def _note_sample_rate(
    verdict: Finding, found: Remains, rate: float, passing: float, modes: Sequence[float], note: Any
) -> None:
    """Say what the sample rate cannot show, and where a line may be the alias of a higher one."""
    seen = SEEN_UP_TO * rate
    above = [mode for mode in modes if mode > seen]
    if above:
        note(
            "sample-rate",
            f"{rate:g} samples per second show nothing above {seen:.4g} Hz, and the tool has modes there "
            f"({', '.join(f'{mode:.0f} Hz' for mode in above[:3])}): chatter of theirs would not be seen, or at another frequency",
        )
    elif not modes and verdict.verdict == "stable" and seen < max(LOW, PASSINGS * passing):
        note(
            "sample-rate",
            f"{rate:g} samples per second show nothing above {seen:.4g} Hz, where tools often chatter: stable below is all "
            "that is said; sample faster",
        )
    if verdict.tones and not verdict.alternates:
        f = verdict.tones[0].frequency * rate
        other = _other_alias(f, rate, modes)
        if other is not None:
            note(
                "alias",
                f"no mode of the tool is near {f:.5g} Hz, but one is near {other:.5g} Hz, which this sample rate shows there: the "
                "chatter frequency may be that; sample faster, or behind an anti-aliasing filter",
            )
        elif not modes and rate - f < HIGHEST and not falls_off(found.spectra.power[0]):
            note(
                "alias",
                f"the noise does not fall off towards {rate / 2:g} Hz, so no anti-aliasing filter shows: {f:.5g} Hz may stand for "
                f"{rate - f:.5g} Hz",
                "note",
            )


def _other_alias(f: float, rate: float, modes: Sequence[float]) -> float | None:
    """A frequency above half the sample rate that is near a mode where this one is near none."""
    if not modes or min(abs(f / mode - 1) for mode in modes) < DOUBTFUL_MODE:
        return None
    others = [rate - f, rate + f, 2 * rate - f]
    near = [other for other in others if min(abs(other / mode - 1) for mode in modes) < DOUBTFUL_MODE / 2]
    return near[0] if near else None
