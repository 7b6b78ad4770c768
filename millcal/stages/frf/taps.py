"""One impact recording on its way to spectra: hits found, judged, windowed, transformed.

Each hit gets its reasons against it, in words that begin with a kind: overload, gap, weak, double, unsettled, cut,
inconsistent, dropped. A hit without a reason is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from millcal.data import Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics.frequency_response import deviation
from millcal.numerics.impact_hits import Survey, find_hits, is_overloaded, survey_hit
from millcal.numerics.impact_windows import decay_lengths, gate_hit

FORM_OF = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
    "force": "transmissibility",
}
LONGEST = 1 << 18  # samples of one hit that are looked at
SHORTEST = 128  # samples that a hit must have
MARK_RESPONSES = "mark the dynamometer's channels: role = 'response' under [channels.NAME], or --response NAME"


@dataclass
class Tap:
    """One recording on its way to spectra; filled from top to bottom by the functions below."""

    recording: Recording
    forces: list[int]  # rows
    responses: list[int]
    stretches: list[tuple[int, int]]
    surveys: list[Survey] = field(default_factory=list)
    reasons: list[list[str]] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    spectra: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # hit -> (input, f), (output, f)
    noise: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # hit -> E|noise|^2 of a line
    pulse: dict[int, tuple[int, np.ndarray]] = field(default_factory=dict)  # hit -> first sample, (input, sample) N
    ends: dict[int, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict
    )  # hit -> window stop and fall (output,)
    before: int = 0  # samples of the record before the onset
    length: int = 0  # samples of the record
    decay: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (output,) samples after the onset; inf: no end
    notices: list[Notice] = field(default_factory=list)

    @property
    def segmented(self) -> bool:
        return self.recording.segments is not None and len(self.recording.segments) > 0

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(self.recording.channels[row].dof for row in self.forces)

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(self.recording.channels[row].dof for row in self.responses)

    def used(self) -> list[int]:
        return [hit for hit, good in enumerate(self.accepted) if good]


def hammer_and_responses(recording: Recording, form: str | None) -> tuple[list[int], list[int]]:
    """Rows of the hammer and of what answers it: sensors of motion, or a dynamometer's forces. One FRF holds one kind.

    form : the form asked for, which chooses the kind where both were recorded
    """
    name, channels = recording.name, recording.channels
    forces = recording.rows_of("force")
    hammer = [row for row in forces if channels[row].role != "response"]
    dynamometer = [row for row in forces if channels[row].role == "response"]
    moving = [row for row, c in enumerate(channels) if c.quantity in FORM_OF and c.quantity != "force"]
    if not hammer:
        what = "every force channel is a response; one must be the hammer" if forces else "no force channel"
        raise RecordingError(f"{name}: {what}; an impact test needs the hammer, state its unit (N)")
    if form == "transmissibility" and not dynamometer:
        raise RecordingError(f"{name}: no force answers the hammer; {MARK_RESPONSES}")
    if form not in (None, "transmissibility") and dynamometer and not moving:
        raise RecordingError(
            f"{name}: the responses are forces, and force over force is a transmissibility in no other form, "
            f"{form} neither; leave the form out"
        )
    if form is None and dynamometer and moving:
        raise RecordingError(
            f"{name}: accelerations and a dynamometer's forces cannot share one FRF; choose with form = "
            f"transmissibility (the forces) or {FORM_OF[channels[moving[0]].quantity]} (the motion)"
        )
    responses = dynamometer if form == "transmissibility" or not moving else moving
    if not responses:
        more = f"; or {MARK_RESPONSES}" if len(hammer) > 1 else ""
        raise RecordingError(
            f"{name}: no acceleration, velocity or displacement channel; state the units of the responses{more}"
        )
    return hammer, responses


def survey_recording(recording: Recording, hold_off: float, record_length: float | None, form: str | None) -> Tap:
    """Find the hits of a recording and look at each."""
    name, rate = recording.name, recording.sample_rate
    forces, responses = hammer_and_responses(recording, form)
    for rows in (forces, responses):
        dofs = [recording.channels[row].dof for row in rows]
        if twice := {dof for dof in dofs if dofs.count(dof) > 1}:
            raise RecordingError(f"{name}: two channels measure {min(twice)}; give each its own dof, or leave one out")
    total = recording.samples.shape[1]
    if recording.segments is not None and len(recording.segments):
        stretches = [(int(start), int(start + count)) for start, count in recording.segments]
        around = [(0, stop - start) for start, stop in stretches]
        before = None
    else:
        blocks = (
            (start + a, np.nan_to_num(block[forces, a : a + (1 << 16)]))
            for start, block in recording.blocks()
            for a in range(0, block.shape[1], 1 << 16)
        )
        hits = find_hits(blocks, round(hold_off * rate))
        if not hits:
            raise RecordingError(f"{name}: no hit found in the force; check that it is an impact test and its channels")
        pulse = int(np.median([b - a for a, b in hits]))
        before = min(4 * pulse, round(0.05 * rate)) + 128
        following = [a - pulse - 16 for a, _ in hits[1:]] + [total]
        stretches = [
            (max(0, a - before), min(total, max(c, b, a + SHORTEST), a + LONGEST))
            for (a, b), c in zip(hits, following, strict=True)
        ]
        around = [(a - s, b - s) for (a, b), (s, _) in zip(hits, stretches, strict=True)]
    tap = Tap(recording, forces, responses, stretches)
    for (start, stop), where in zip(stretches, around, strict=True):
        if stop - start < SHORTEST:
            raise RecordingError(f"{name}: a hit of {stop - start} samples; at least {SHORTEST} are needed")
        samples = np.asarray(recording.block(start, stop), float)
        gaps = [row for row in forces + responses if np.isnan(samples[row]).any()]
        samples = np.nan_to_num(samples) if gaps else samples
        survey = survey_hit(samples[forces], samples[responses], _block(recording), where)
        tap.surveys.append(survey)
        tap.reasons.append([])
        room = survey.power.shape[1] * _block(recording) / rate
        if room < 0.005:
            tap.reasons[-1].append(f"cut: only {1e3 * room:.0f} ms of response before the next hit or the end")
        if gaps:
            tap.reasons[-1].append("gap: " + ", ".join(recording.channels[row].name for row in gaps))
        clipped = [row for row in forces + responses if is_overloaded(samples[row], recording.channels[row].full_scale)]
        if clipped:
            tap.reasons[-1].append("overload: " + ", ".join(recording.channels[row].name for row in clipped))
    if before is None:
        tap.before = min(survey.first for survey in tap.surveys)
        tap.length = min(stop - start for start, stop in stretches)
    else:
        tap.before = before
    if record_length is not None:
        tap.length = round(record_length * rate)
    return tap


def judge(tap: Tap, weak: float, allow_double: bool, kept: set, dropped: set) -> None:
    """Give each hit its reasons against it, and accept those without one."""
    rate = tap.recording.sample_rate
    median_peak = float(np.median([survey.peak for survey in tap.surveys]))
    usual = np.median([survey.response_noise for survey in tap.surveys], axis=0)
    for hit, (survey, reasons) in enumerate(zip(tap.surveys, tap.reasons, strict=True)):
        if survey.peak <= 10.0 * float(np.linalg.norm(survey.direction * survey.force_noise)):
            reasons.append("weak: no pulse above the noise")
        elif survey.peak < weak * median_peak:
            reasons.append(f"weak: {100 * survey.peak / median_peak:.0f} % of the median peak")
        if survey.second is not None:
            share, distance = survey.second
            side = "after" if distance > 0 else "before"
            reasons.append(f"double: second pulse of {100 * share:.0f} % {1e3 * abs(distance) / rate:.1f} ms {side}")
        loud = (survey.head_noise > 3.0 * usual) & (survey.head_noise > 0.01 * survey.response_peak)
        if len(tap.surveys) > 1 and np.mean(loud) > 0.5:
            reasons.append("unsettled: the response still rings from before")
        against = [reason for reason in reasons if not (allow_double and reason.startswith("double"))]
        me = (id(tap), hit)
        if me in dropped:
            reasons.append("dropped: by request")
        tap.accepted.append(me not in dropped and (me in kept or not against))


def named_hits(taps: list[Tap], wanted: Sequence[int | str], option: str) -> set[tuple[int, int]]:
    """The hits that `keep` or `drop` name, as (id of the tap, hit)."""
    chosen = set()
    for item in wanted:
        name, _, number = str(item).rpartition(":")
        known = [tap for tap in taps if not name or name in _names(tap)]
        if not name and len(taps) > 1:
            example = f"{_names(taps[0])[2]}:{item}"
            raise RecordingError(f"{option} {item}: there are {len(taps)} recordings; say which one, as in {example}")
        if not known:
            names = ", ".join(_names(tap)[2] for tap in taps)
            raise RecordingError(f"{option} {item}: no recording is called {name}; there are {names}")
        if not number.isdigit() or int(number) >= len(known[0].stretches):
            raise RecordingError(
                f"{option} {item}: no such hit; {known[0].recording.name} has hits 0 to {len(known[0].stretches) - 1}"
            )
        chosen |= {(id(tap), int(number)) for tap in known}
    return chosen


def _names(tap: Tap) -> tuple[str, str, str]:
    """What a recording may be called: its path, its file name, and that without the ending."""
    file = tap.recording.name.replace("\\", "/").rsplit("/", 1)[-1]
    return tap.recording.name, file, file.rsplit(".", 1)[0]


def plan_windows(tap: Tap) -> None:
    """The length of the response windows, common to the hits of a recording, and of the record if that is open."""
    used = [tap.surveys[hit] for hit in tap.used()] or tap.surveys
    tap.decay = decay_lengths(used, _block(tap.recording))
    if not tap.length:
        room = int(np.median([stop - start for start, stop in tap.stretches]))
        needed = 2.0 * float(tap.decay.max()) + tap.before
        tap.length = max(SHORTEST, int(min(room, needed)))
    recording = tap.recording
    dead = [
        recording.channels[row].name for i, row in enumerate(tap.responses) if not any(s.response_peak[i] for s in used)
    ]
    for name in dead:
        tap.notices.append(Notice("dead-channel", f"{name} does not move in any hit; check its cable", recording.name))
    left = [_left_over(survey, (tap.length - survey.onset) // _block(recording)) for survey in used]
    if max(left) > 0.01:
        message = f"the response is still {100 * max(left):.0f} % of its largest where the record of {sum(v > 0.01 for v in left)} "
        message += (
            "of the hits ends: resonances come out too low and too wide; record longer, space the hits further apart"
        )
        tap.notices.append(Notice("truncated", message, recording.name))


def _left_over(survey: Survey, blocks: int) -> float:
    """Amplitude left at the end of the record, above the noise, as a share of the largest: median over the outputs."""
    power = survey.power[:, : max(blocks, 0)]
    if not power.shape[1]:
        return 1.0
    last = power[:, -3:].mean(axis=1) - 2.0 * survey.response_noise**2
    return float(np.median(np.sqrt(np.maximum(last, 0.0) / np.maximum(power.max(axis=1), 1e-300))))


def _block(recording: Recording) -> int:
    """Samples of one block of the decay, 1 ms."""
    return max(8, round(1e-3 * recording.sample_rate))


def transform(tap: Tap, hit: int, length: int, points: int, damping: float = 0.0) -> None:
    """Spectra of one hit, with its means off and its windows on; force and response have one origin.

    damping : of an exponential window, per sample
    """
    survey, (start, stop) = tap.surveys[hit], tap.stretches[hit]
    origin = 0 if tap.segmented else survey.onset - tap.before
    begin, end = max(0, origin), min(stop - start, origin + length)
    samples = np.zeros((len(tap.recording.channels), length))
    valid = np.zeros(length, bool)
    samples[:, begin - origin : end - origin] = tap.recording.block(start + begin, start + end)
    valid[begin - origin : end - origin] = True
    gated = gate_hit(samples[tap.forces], samples[tap.responses], valid, survey, tap.decay, origin, damping)
    fading = np.exp(-damping * np.arange(length)) if damping else 1.0
    tap.spectra[hit] = (np.fft.rfft(gated.force * fading, points), np.fft.rfft(gated.response * fading, points))
    tap.noise[hit] = (gated.force_noise, gated.response_noise)
    loaded = np.flatnonzero(gated.force.any(axis=0))
    first, last = (loaded[0], loaded[-1] + 1) if len(loaded) else (0, 1)
    tap.pulse[hit] = (int(first), gated.force[:, first:last].copy())
    tap.ends[hit] = (gated.stop, gated.fall)


def reject_inconsistent(tap: Tap, kept: set) -> None:
    """Leave out hits whose response is not that of the others: another point, another direction, something loose.

    The response of each is compared with the median of the recording where the force is within 20 dB of its largest; 10 %
    and five times the usual deviation are asked for.
    """
    used = tap.used()
    if len(used) < 3 or len(tap.forces) > 1:
        return
    F = np.stack([tap.spectra[hit][0][0] for hit in used])
    size = np.mean(np.abs(F) ** 2, axis=0)
    band = np.flatnonzero(size > 1e-2 * size.max())
    band = band[:: max(1, len(band) // 256)]  # enough lines to tell
    found = deviation(F[:, band], np.stack([tap.spectra[hit][1][:, band] for hit in used]))
    limit = max(0.1, 5.0 * float(np.median(found)))
    for hit, value in zip(used, found, strict=True):
        if value > limit:
            tap.reasons[hit].append(f"inconsistent: response {100 * value:.0f} % off the other hits")
            tap.accepted[hit] = (id(tap), hit) in kept
