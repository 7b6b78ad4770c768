"""From the recording of a cut to its samples: the force, where the spindle stands, and how the tool meets the work.

What follows a cut sample by sample needs the raw force, so nothing is smoothed and nothing is averaged: offset and drift are
taken out as in `condition_cut`, and the samples of the cut lie in memory. A level that changes is no reason to end the cut.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from millcal.data import AXES, CutSamples, Level, Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import Samples, block_size, stretches, survey_record
from millcal.numerics.spectra import Reader
from millcal.physics.tool_path import ToolPath
from millcal.stages.conditioning import findings, spindle_angle
from millcal.stages.conditioning.along_path import constant_engagement, engagement_along
from millcal.stages.conditioning.contact import contact_revolutions
from millcal.stages.conditioning.forces import Note, Span, force_rows, offset_line, read_forces, stated_frequency
from millcal.stages.conditioning.spindle import FEW_REVOLUTIONS, FEWEST_REVOLUTIONS, NYQUIST_SHARE
from millcal.stages.conditioning.steady import air_samples, refuse_what_is_no_number, samples_of, stated_samples

LOOK = 64  # revolutions in the middle of the cut by which it is judged to be one

AngleFrom = Literal["speed", "pulse", "encoder", "stated"]


def sample_cut(
    recording: Recording,
    *,
    engagement: ToolPath | None = None,
    path_start: float | None = None,
    steady: Span | None = None,
    air: Sequence[Span] | None = None,
    offset: str = "auto",
    spindle_phase: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> CutSamples:
    """The samples of one cut from its first contact to its last.

    Without an engagement table the ramps where the tool enters and leaves are left out; with one they are described by it.
    The spindle angle comes from an encoder (a channel of angle), else from a pulse per revolution, else from the speed.

    engagement, path_start : the table, and when (s after the first sample) its path begins, where no channel of displacement
        with dof `path` says where the tool is; else what the recording says. The conditions' depth is then the table's largest
    steady, air : s after the first sample; else what the recording says, else found
    offset : "auto" from the air cuts if there are any, "air" an error if there are none, "none" left in
    spindle_phase : rad, angle of tooth 0 where the pulse rises or the encoder is zero, else at the first sample of the
        recording; None: what the recording says, and if that is nothing, the angle misses a constant
    progress : called with (share, label)
    """
    if offset not in ("auto", "air", "none"):
        raise ValueError(f"{offset=} is none of auto, air, none")
    tell = progress or (lambda share, label: None)
    where = recording.name or "recording"
    rate, length = recording.sample_rate, recording.samples.shape[1]
    engagement = engagement if engagement is not None else recording.engagement
    path_start = path_start if path_start is not None else recording.path_start
    spindle_phase = spindle_phase if spindle_phase is not None else recording.spindle_phase
    notices: list[Notice] = []

    def note(code: str, message: str, level: Level = "warning") -> None:
        notices.append(Notice(code, message, where, level))

    tell(0.0, "cut and air")
    stated = stated_frequency(recording, where)
    of_axes = dict(zip(AXES, force_rows(recording, where, ("x", "y")), strict=True))
    axes = tuple(axis for axis, row in of_axes.items() if row >= 0)
    rows = [of_axes[axis] for axis in axes]
    zero = np.zeros(len(axes))
    raw = read_forces(recording, rows, zero, zero)
    survey = survey_record(raw, length, rate / stated)
    span, limit = stated_samples(recording, steady, where), None
    if span is None:
        first, last, limit = contact_revolutions(survey, where, note, whole=engagement is not None)
        span = samples_of(recording, survey, first, last)
    start, stop = span
    refuse_what_is_no_number(recording, rows, start, stop, where)
    findings.note_clipping(recording, rows, start, stop, note, [f"f{axis}" for axis in axes])
    spans = air_samples(recording, air, survey, span, where, limit)
    line = offset_line(raw, spans, rate / stated, rate, offset, where, note, axes)

    tell(0.4, "force")
    read = read_forces(recording, rows, line.offset, line.drift)
    force = _in_memory(read, span)
    air_force, air_spans = _air(read, spans, len(axes))

    tell(0.6, "spindle angle")
    angle, source = _angle(recording, force, span, stated, where, note, steady=engagement is None)
    turns = (angle[-1] - angle[0]) / (2 * np.pi)
    if turns < FEWEST_REVOLUTIONS - 0.1:
        raise RecordingError(
            f"{where}: the cut holds {turns:.2g} revolutions, at least {FEWEST_REVOLUTIONS} are needed; check the spindle "
            "speed, the sample rate and steady_s"
        )
    if turns < FEW_REVOLUTIONS and not any(notice.code == "few-revolutions" for notice in notices):
        note("few-revolutions", f"only {turns:.2g} revolutions: little can be said of what changes within them")
    frequency = turns * rate / (len(angle) - 1)
    spindle_angle.note_speed(frequency, stated, source, note)
    _judge(force, angle, rate / frequency, where, note, notices)
    angle += (spindle_phase or 0.0) - 2 * np.pi * np.floor((angle[0] + (spindle_phase or 0.0)) / (2 * np.pi))

    tell(0.9, "engagement")
    conditions = recording.conditions
    if engagement is None:
        at = constant_engagement(recording.cutter, conditions, stop - start)
    else:
        at = engagement_along(recording, engagement, path_start, span, rate / frequency, where)
        conditions = replace(conditions, axial_depth=float(engagement.axial_depth.max()))
        if source == "speed":
            note(
                "angle-from-speed",
                "the engagement changes, and the spindle angle comes from the force alone, whose shape changes with it: "
                "it may be off by some degrees; record a pulse per revolution or an encoder",
            )
    tell(1.0, "samples")
    return CutSamples(
        name=recording.name,
        cutter=recording.cutter,
        conditions=conditions,
        force=force,
        axes=axes,
        angle=angle,
        angle_from=source if spindle_phase is None else "stated",
        **at._asdict(),
        sample_rate=rate,
        start=start / rate,
        spindle_frequency=frequency,
        air_force=air_force,
        air_spans=air_spans,
        notices=tuple(notices),
    )


def _in_memory(read: Reader, span: Samples) -> np.ndarray:
    """Samples start..stop of a reader.   returns (axis, sample)"""
    start, stop = span
    size = block_size(stop - start)
    return np.concatenate([read(at, min(at + size, stop)) for at in range(start, stop, size)], axis=1)


def _air(read: Reader, spans: Sequence[Samples], axes: int) -> tuple[np.ndarray, tuple[Samples, ...]]:
    """The force of the air cuts one behind the other, and its pieces; what is no number parts one from the next."""
    pieces, places, length = [np.empty((axes, 0))], [], 0
    for span in spans:
        force = _in_memory(read, span)
        for low, high in stretches(np.isfinite(force).all(axis=0)):
            pieces.append(force[:, low:high])
            places.append((length, length + high - low))
            length += high - low
    return np.concatenate(pieces, axis=1), tuple(places)


def _angle(
    recording: Recording, force: np.ndarray, span: Samples, stated: float, where: str, note: Note, *, steady: bool
) -> tuple[np.ndarray, AngleFrom]:
    """The spindle angle at the samples of the cut by the best there is.   stated : Hz   returns (sample,) rad, its source"""
    cycle = stated / recording.sample_rate
    angle = spindle_angle.encoder_angle(recording, *span, cycle, note)
    if angle is not None:
        return angle, "encoder"
    teeth = recording.cutter.teeth
    angle = spindle_angle.pulse_angle(recording, *span, cycle, note)
    if angle is not None:
        return (spindle_angle.with_speed_of_force(angle, force, teeth, where) if steady else angle), "pulse"
    return spindle_angle.speed_angle(force, span[0], cycle, teeth, where, note, steady=steady), "speed"


def _judge(
    force: np.ndarray, angle: np.ndarray, revolution: float, where: str, note: Note, said: Sequence[Notice]
) -> None:
    """Whether the force follows the spindle at all.   revolution : samples"""
    look = slice(*_middle(force.shape[1], round(LOOK * revolution)))
    share = spindle_angle.synchronous_share(
        force[:, look], angle[look], max(1, min(12, int(NYQUIST_SHARE * revolution)))
    )
    told = any(notice.code == "not-synchronous" for notice in said)
    spindle_angle.refuse_what_is_no_cut(share, where, (lambda *_: None) if told else note)


def _middle(length: int, wished: int) -> Samples:
    start = max((length - wished) // 2, 0)
    return start, min(start + wished, length)
