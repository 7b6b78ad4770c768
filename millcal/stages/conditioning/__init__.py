"""From the recording of a cut to the force that follows the spindle, and what does not.

Everything goes block by block through one reader of the three forces (offset and drift taken out, smoothed on request),
so a long recording never lies in memory. Revolutions are not resampled: the harmonics are least-squares fits at the
refined spindle frequency, exact for any number of samples per revolution.
"""

from collections.abc import Callable, Sequence

import numpy as np

from millcal.data import AXES, CutForce, Level, Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.low_pass import low_pass_kernel, smoothed
from millcal.numerics.residual_lines import asynchronous_lines
from millcal.numerics.revolutions import block_size, survey_record
from millcal.stages.conditioning import findings, spindle
from millcal.stages.conditioning.forces import Span, force_rows, offset_line, read_forces, stated_frequency
from millcal.stages.conditioning.samples import sample_cut
from millcal.stages.conditioning.steady import air_samples, all_numbers_around, steady_samples

__all__ = ["condition_cut", "sample_cut"]

ANALYSED_HARMONICS = 30  # taken out before the rest is called asynchronous, however few are saved
AVERAGE_ANGLES = 360
FORCES = tuple("f" + axis for axis in AXES)


def condition_cut(
    recording: Recording,
    *,
    steady: Span | None = None,
    air: Sequence[Span] | None = None,
    lowpass: float | None = None,
    harmonics: int = 30,
    offset: str = "auto",
    progress: Callable[[float, str], None] | None = None,
) -> CutForce:
    """Trim, zero, refine the spindle speed and take the harmonics of the force of one cut.

    The overview shows the record as it is, before anything is removed.

    steady, air : s after the first sample; else what the recording says, else found
    lowpass : Hz, zero phase, -3 dB there
    harmonics : highest wished; never above 0.45 of the sample rate
    offset : "auto" from the air cuts if there are any, "air" an error if there are none, "none" left in
    progress : called with (share, label)
    """
    if offset not in ("auto", "air", "none"):
        raise ValueError(f"{offset=} is none of auto, air, none")
    tell = progress or (lambda share, label: None)
    where = recording.name or "recording"
    if recording.engagement is not None:
        raise RecordingError(
            f"{where}: the engagement changes along its table, and revolutions that differ cannot be averaged; use a method "
            "that follows the samples (smooth, imm, rls, enkf), or leave the engagement table out"
        )
    rate, length = recording.sample_rate, recording.samples.shape[1]
    notices: list[Notice] = []

    def note(code: str, message: str, level: Level = "warning") -> None:
        notices.append(Notice(code, message, where, level))

    tell(0.0, "steady cut and air")
    stated = stated_frequency(recording, where)
    rows = force_rows(recording, where)
    raw = read_forces(recording, rows, np.zeros(3), np.zeros(3))
    survey = survey_record(raw, length, rate / stated)
    start, stop = steady_samples(recording, rows, steady, survey, where, note)
    findings.note_clipping(recording, rows, start, stop, note, FORCES)
    spans = air_samples(recording, air, survey, (start, stop), where)
    line = offset_line(raw, spans, rate / stated, rate, offset, where, note)
    read = read_forces(recording, rows, line.offset, line.drift)
    if lowpass is not None:
        if not 0 < lowpass < rate / 2:
            raise RecordingError(
                f"{where}: a low-pass at {lowpass:g} Hz does not lie below half the sample rate of {rate:g} Hz; "
                "choose a lower one, or none"
            )
        read = smoothed(read, *all_numbers_around(survey, (start, stop)), low_pass_kernel(lowpass / rate))
        said = f"low-pass at {lowpass:g} Hz: harmonics from {int(lowpass / stated)} on come out smaller"
        note("low-pass", said, "note")
    read = spectra.buffered(read, stop, block_size(stop - start))

    tell(0.3, "spindle speed")
    cycle, cycle_sd = spindle.spindle_cycle(read, start, stop, stated / rate, recording.cutter.teeth, where, note)
    frequency, frequency_sd = cycle * rate, cycle_sd * rate
    revolutions, end = spindle.whole_revolutions(start, stop, cycle)

    tell(0.5, "harmonics")
    limit = max(1, int(spindle.NYQUIST_SHARE / cycle))
    saved, analysed = min(harmonics, limit), min(max(harmonics, ANALYSED_HARMONICS), limit)
    if saved < harmonics:
        said = f"{saved} of {harmonics} harmonics: the others lie above 0.45 of the sample rate of {rate:g} Hz"
        note("nyquist", said, "note")
    fitted = spectra.fit_harmonics(read, start, end, cycle, analysed)
    turns = spindle.each_revolution(read, start, end, cycle, fitted)

    tell(0.8, "what does not follow the spindle")
    phase, from_pulse = spindle.pulse_phase(recording, start, end, frequency, frequency_sd, note)
    averaged = spectra.average_periods(read, start, end, cycle, fitted, phase=phase, angles=AVERAGE_ANGLES)
    ac_rms, asynchronous_rms = np.sqrt(averaged.power), np.sqrt(averaged.residual_power)
    lines = asynchronous_lines(read, start, end, cycle, fitted)
    peaks = findings.peaks_of(lines, AXES, ac_rms, rate)
    findings.note_chatter(peaks, ac_rms, recording.cutter.teeth * frequency, rate / (end - start), note)
    findings.note_asynchronous(AXES, ac_rms, asynchronous_rms, note)
    findings.note_wander(turns, analysed, note)
    findings.note_mean_drift(turns, ac_rms, note)

    fitted[:, 0] = spindle.mean_force(read, start, stop, stated / rate, fitted[:, 0].real, turns.variance[:, 0])
    variance = turns.variance[:, : saved + 1].copy()
    middle = (start + stop - 1) / 2
    variance[:, 0] += line.variance_at(middle)
    tell(1.0, "conditioned")
    return CutForce(
        name=recording.name,
        cutter=recording.cutter,
        conditions=recording.conditions,
        harmonics=spectra.turned(fitted, phase)[:, : saved + 1],
        harmonics_variance=variance,
        mean_all_rows=spectra.mean_of(read, start, stop),
        revolution_means=turns.means,
        average_angle=averaged.angle,
        average=averaged.average,
        scatter=averaged.scatter,
        ac_rms=ac_rms,
        asynchronous_rms=asynchronous_rms,
        overview_time=survey.time / rate,
        overview_low=survey.low,
        overview_high=survey.high,
        removed_offset=line.offset + line.drift * middle,
        removed_drift=line.drift * rate,
        sample_rate=rate,
        spindle_frequency=frequency,
        spindle_frequency_sd=frequency_sd,
        revolutions=revolutions,
        steady=(start / rate, stop / rate),
        air=tuple((low / rate, high / rate) for low, high in spans),
        phase_from_pulse=from_pulse,
        lowpass=lowpass,
        peaks=peaks,
        notices=tuple(notices),
    )
