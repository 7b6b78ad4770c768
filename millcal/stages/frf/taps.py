"""One impact recording on its way to spectra: which channels it has, where its hits are, what each holds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from millcal.data import Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics.frequency_response import CrossSpectra
from millcal.numerics.impact_faults import frozen, overloaded
from millcal.numerics.impact_hits import Survey, find_hits, survey_hit

FORM_OF = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
    "force": "transmissibility",
}
LONGEST = 1 << 18  # samples of one hit that are looked at
SHORTEST = 128  # samples that a hit must have
PIECE = 1 << 16  # samples that hits are searched in at a time
MARK_RESPONSES = "mark the dynamometer's channels: role = 'response' under [channels.NAME], or --response NAME"


@dataclass(frozen=True)
class Loss:
    """Samples of a channel that were lost or stuck."""

    channel: str
    output: int | None  # which response; None for a force
    start: int  # within the stretch
    stop: int
    kind: str  # drop-out, stuck


@dataclass
class Tap:
    """One recording on its way to spectra; filled from top to bottom by the functions of this package."""

    recording: Recording
    forces: list[int]  # rows
    responses: list[int]
    delays: np.ndarray  # (output,) s that each response comes late
    signs: np.ndarray  # (channel,) -1 for a channel that is to be turned
    stretches: list[tuple[int, int]] = field(default_factory=list)
    surveys: list[Survey] = field(default_factory=list)
    losses: list[list[Loss]] = field(default_factory=list)
    reasons: list[list[str]] = field(default_factory=list)
    remarks: list[list[str]] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    before: int = 0  # samples of the record before the onset
    length: int = 0  # samples of the record
    decay: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (output,) samples after the onset; inf: no end
    sums: CrossSpectra | None = None
    thin: dict[int, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict
    )  # hit -> complex64 (input, f), (output, f)
    late: dict[int, np.ndarray] = field(default_factory=dict)  # hit -> (output,) s later than in the other hits
    noise: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # hit -> E|noise|^2 of a line
    pulse: dict[int, tuple[int, np.ndarray]] = field(default_factory=dict)  # hit -> first sample, (input, sample) N
    ends: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # hit -> window stop, fall (output,)
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

    @property
    def block(self) -> int:
        """Samples of one block of the decay, 1 ms."""
        return max(8, round(1e-3 * self.recording.sample_rate))

    def used(self) -> list[int]:
        return [hit for hit, good in enumerate(self.accepted) if good]

    def names(self, rows: Sequence[int]) -> str:
        return ", ".join(self.recording.channels[row].name for row in rows)

    def read(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray, list[int]]:
        """Forces and responses of some samples, turned as asked for, and the rows in which samples are missing, now zero.

        returns (input, n), (output, n), rows; the samples may be the recording's own
        """
        samples = np.asarray(self.recording.block(start, stop), float)
        parts, gaps = [], []
        for rows in (self.forces, self.responses):
            in_a_row = rows == list(range(rows[0], rows[-1] + 1))
            own = samples[rows[0] : rows[-1] + 1] if in_a_row else samples[rows]
            if (self.signs[rows] < 0).any():
                own = own * self.signs[rows][:, None]
            if not np.isfinite(own.sum()):
                gaps += [row for row, values in zip(rows, own, strict=True) if not np.isfinite(values).all()]
                own = np.where(np.isfinite(own), own, 0.0)
            parts.append(own)
        return parts[0], parts[1], gaps


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


def open_taps(
    recordings: Sequence[Recording], form: str | None, delays: Mapping[str, float], flip: Sequence[str]
) -> list[Tap]:
    """The recordings with their channels sorted, signs and delays assigned.

    delays, flip : of channels by name, or by dof: then of the response there, or of the hammer where nothing answers
    """
    taps = []
    for recording in recordings:
        forces, responses = hammer_and_responses(recording, form)
        for rows in (forces, responses):
            dofs = [recording.channels[row].dof for row in rows]
            if twice := {dof for dof in dofs if dofs.count(dof) > 1}:
                name = recording.name
                raise RecordingError(
                    f"{name}: two channels measure {min(twice)}; give each its own dof, or leave one out"
                )
        own = np.array([recording.channels[row].delay for row in range(len(recording.channels))])
        taps.append(Tap(recording, forces, responses, own, np.ones(len(own))))
    for option, names in (("flip", flip), ("delay", delays)):
        for name in names:
            places = [(tap, row) for tap in taps for row in _rows_called(tap, name)]
            if not places:
                known = dict.fromkeys(c.name for tap in taps for c in tap.recording.channels)
                raise RecordingError(f"{option} {name}: no channel or dof of that name; there are {', '.join(known)}")
            for tap, row in places:
                if option == "flip":
                    tap.signs[row] = -tap.signs[row]
                else:
                    tap.delays[row] = delays[name]
    for tap in taps:
        late = tap.delays[tap.forces]
        if np.ptp(late) > 0:
            raise RecordingError(
                f"{tap.recording.name}: force channels with unequal delays; give them one, and the responses the rest"
            )
        tap.delays = tap.delays[tap.responses] - late[0]
    return taps


def _rows_called(tap: Tap, name: str) -> list[int]:
    """Rows of a channel's name or, failing that, of the responses at a dof, or of the hammer there."""
    channels = tap.recording.channels
    for rows in (tap.forces + tap.responses, tap.responses, tap.forces):
        key = "name" if len(rows) > max(len(tap.responses), len(tap.forces)) else "dof"
        found = [row for row in rows if getattr(channels[row], key) == name]
        if found:
            return found
    return []


def survey_tap(
    tap: Tap, hold_off: float, record_length: float | None, progress: Callable[[float], None] = lambda share: None
) -> None:
    """Find the hits of a recording and look at each.   progress : called with the share done"""
    recording = tap.recording
    name, rate = recording.name, recording.sample_rate
    total = recording.samples.shape[1]
    if tap.segmented:
        tap.stretches = [(int(start), int(start + count)) for start, count in recording.segments]  # type: ignore[union-attr]
        around = [(0, stop - start) for start, stop in tap.stretches]
    else:
        hits = find_hits(_force_blocks(tap), round(hold_off * rate), progress=lambda n: progress(0.6 * n / total))
        if not hits:
            raise RecordingError(f"{name}: no hit found in the force; check that it is an impact test and its channels")
        pulse = int(np.median([b - a for a, b in hits]))
        tap.before = min(4 * pulse, round(0.05 * rate)) + 128
        following = [a - pulse - 16 for a, _ in hits[1:]] + [total]
        tap.stretches = [
            (max(0, a - tap.before), min(total, max(c, b, a + SHORTEST), a + LONGEST))
            for (a, b), c in zip(hits, following, strict=True)
        ]
        around = [(a - s, b - s) for (a, b), (s, _) in zip(hits, tap.stretches, strict=True)]
    for number, ((start, stop), where) in enumerate(zip(tap.stretches, around, strict=True)):
        if stop - start < SHORTEST:
            raise RecordingError(f"{name}: a hit of {stop - start} samples; at least {SHORTEST} are needed")
        _look_at(tap, start, stop, where)
        progress((0.0 if tap.segmented else 0.6) + (1.0 if tap.segmented else 0.4) * (number + 1) / len(around))
    if tap.segmented:
        tap.before = min(survey.first for survey in tap.surveys)
        tap.length = max(stop - start for start, stop in tap.stretches)
    if record_length is not None:
        tap.length = round(record_length * rate)


def _force_blocks(tap: Tap) -> Iterator[tuple[int, np.ndarray]]:
    """The force of a whole recording, in pieces; samples that are missing are zero."""
    for start, block in tap.recording.blocks(rows=tap.forces):
        force = np.nan_to_num(block)
        for a in range(0, force.shape[1], PIECE):
            yield start + a, force[:, a : a + PIECE]


def _look_at(tap: Tap, start: int, stop: int, around: tuple[int, int]) -> None:
    """Survey one hit, and find what can be told from it alone."""
    force, response, gaps = tap.read(start, stop)
    survey = survey_hit(force, response, tap.block, around)
    rows = tap.forces + tap.responses
    reasons: list[str] = []
    room = survey.power.shape[1] * tap.block / tap.recording.sample_rate
    if room < 0.005:
        reasons.append(f"cut: only {1e3 * room:.0f} ms of response before the next hit or the end")
    if gaps:
        reasons.append("gap: " + tap.names(gaps))
    channels = [tap.recording.channels[row] for row in rows]
    limits = np.array([np.inf if c.full_scale is None else c.full_scale for c in channels])
    m = len(tap.forces)
    clipped = np.concatenate([overloaded(force, limits[:m]), overloaded(response, limits[m:])])
    if clipped.any():
        reasons.append("overload: " + tap.names([row for row, bad in zip(rows, clipped, strict=True) if bad]))
    losses = []
    for part, noise, first in ((force, survey.force_noise, 0), (response, survey.response_noise, m)):
        for row, a, b in frozen(part, noise):
            if rows[first + row] in gaps:
                continue
            kind = "drop-out" if part[row, a] == 0 else "stuck"
            losses.append(Loss(channels[first + row].name, row if first else None, a, b, kind))
    tap.surveys.append(survey)
    tap.losses.append(losses)
    tap.reasons.append(reasons)
    tap.remarks.append([])
