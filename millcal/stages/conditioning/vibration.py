"""From the recording of a cut to the accelerations that follow the spindle, and the noise beside them.

What accelerometers say of the force they say at the spindle's harmonics alone: their mean and slow drift are the sensor's
own. How wrong the harmonics are is read from the spectral lines between them, sensor against sensor, because what a
machine does of its own reaches all sensors at once. Velocities and displacements become accelerations harmonic by
harmonic; where samples of several quantities are added or drawn, they are scaled as at the tooth passing. Every sensor has
an equal say in the speed, so that one that rattles does not drown the others.
"""

from collections.abc import Callable

import numpy as np

from millcal.data import AXES, CutVibration, Level, Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.harmonic_noise import harmonic_noise
from millcal.numerics.residual_lines import ResidualSpectra, fast_length, lines_standing_out, residual_spectra
from millcal.numerics.revolutions import Samples, Survey, block_size, survey_record
from millcal.numerics.spectra import Reader
from millcal.stages.conditioning import findings, spindle
from millcal.stages.conditioning.forces import Note, Span, stated_frequency
from millcal.stages.conditioning.reference import angle_reference
from millcal.stages.conditioning.sensors import silent, vibration_sensors
from millcal.stages.conditioning.steady import steady_samples

ANALYSED_HARMONICS = 30  # taken out before the rest is called noise, however few are saved
FOLLOWED = 0.05  # of the power; sensors are noisier than forces
ASYNCHRONOUS = 0.1  # of the power of a sensor, before it is worth a word
WINDOWED = 8  # revolutions, from which lines between the harmonics stand clear of them under a window
LONGEST = 1 << 20  # samples of all sensors in one stretch


def condition_vibration(
    recording: Recording,
    *,
    steady: Span | None = None,
    harmonics: int = 30,
    spindle_phase: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> CutVibration:
    """Trim, refine the spindle speed, and take the harmonics of the accelerations of one cut with their covariance.

    The overview shows the record as it is, before anything is removed.

    steady : s after the first sample; else what the recording says, else found
    harmonics : of the spindle, highest wished; never above 0.45 of the sample rate
    spindle_phase : rad, angle of tooth 0 where the pulse rises or the encoder is zero, else at the first sample of the
        recording; None: what the recording says, and if that is nothing, the angle misses a constant
    progress : called with (share, label)
    """
    tell = progress or (lambda share, label: None)
    where = recording.name or "recording"
    if recording.engagement is not None:
        raise RecordingError(
            f"{where}: the engagement changes along its table, and revolutions that differ have no common harmonics; "
            "give steady_s of a stretch at one engagement, and leave the engagement table out"
        )
    spindle_phase = spindle_phase if spindle_phase is not None else recording.spindle_phase
    rate, length = recording.sample_rate, recording.samples.shape[1]
    notices: list[Notice] = []

    def note(code: str, message: str, level: Level = "warning") -> None:
        notices.append(Notice(code, message, where, level))

    tell(0.0, "steady cut")
    stated = stated_frequency(recording, where)
    sensors = vibration_sensors(recording, where, note)
    scale = 2 * np.pi * stated * recording.cutter.teeth
    survey = survey_record(sensors.reader(recording, scale), length, rate / stated)
    dead = silent(sensors, survey, where, note)
    if dead.any():
        sensors = sensors.without(dead)
        survey = survey_record(sensors.reader(recording, scale), length, rate / stated)
    start, stop = steady_samples(recording, sensors.rows, steady, survey, where, note, "vibration")
    dead = silent(sensors, survey, where, note, (start, stop))
    if dead.any():
        sensors = sensors.without(dead)
        survey = survey_record(sensors.reader(recording, scale), length, rate / stated)
    findings.note_clipping(recording, sensors.rows, start, stop, note, sensors.names)
    level, drift = _trend(survey, start, stop)
    size = _spread(survey, start, stop)
    read = sensors.reader(recording, scale, level, drift, size)
    read = spectra.buffered(read, stop, block_size(stop - start, len(sensors.rows)))

    tell(0.3, "spindle speed")
    cycle, cycle_sd = spindle.spindle_cycle(
        read, start, stop, stated / rate, recording.cutter.teeth, where, note, signal="vibration", followed=FOLLOWED
    )
    frequency, frequency_sd = cycle * rate, cycle_sd * rate
    revolutions, end = spindle.whole_revolutions(start, stop, cycle)
    cut = (start, end)

    tell(0.5, "harmonics")
    limit = max(1, int(spindle.NYQUIST_SHARE / cycle))
    saved = min(harmonics, limit)
    if saved < harmonics:
        said = f"{saved} of {harmonics} harmonics: the others lie above 0.45 of the sample rate of {rate:g} Hz"
        note("nyquist", said, "note")
    few = revolutions < WINDOWED
    analysed = limit if few else min(max(saved, ANALYSED_HARMONICS), limit)
    fitted = spectra.fit_harmonics(read, start, end, cycle, analysed)

    tell(0.7, "what does not follow the spindle")
    between = _between(read, cut, cycle, fitted, saved, revolutions)
    lines, apart = lines_standing_out(between, cycle)
    noise = harmonic_noise(between, cycle, fitted[:, : saved + 1], end - start, apart)
    _note_few(noise.draws[1:], len(sensors.rows), note)
    seen = min(max(6, 2 * recording.cutter.teeth), analysed)  # higher ones lose sight of a spindle that wanders far
    findings.note_wander(spindle.each_revolution(read, start, end, cycle, fitted[:, : seen + 1]), seen, note)
    turn = 2 * np.pi * rate / scale  # what a signal differentiated gains, by cycles per sample
    ac_rms, asynchronous_rms = (size * rms for rms in _powers(between, turn, sensors.powers, cycle, fitted))
    lines = [
        line._replace(
            amplitude=line.amplitude * size[line.channel] * (turn * line.frequency) ** sensors.powers[line.channel]
        )
        for line in lines
    ]
    peaks = findings.peaks_of(lines, sensors.dofs, ac_rms, rate)
    findings.note_chatter(peaks, ac_rms, recording.cutter.teeth * frequency, rate / (end - start), note)
    findings.note_asynchronous(sensors.dofs, ac_rms, asynchronous_rms, note, ASYNCHRONOUS)

    tell(0.9, "angle")
    reference = angle_reference(recording, cut, (cycle, cycle_sd), spindle_phase, note)
    order = np.arange(saved + 1)
    gain = size[:, np.newaxis] * (1j * turn * cycle * order) ** sensors.powers[:, np.newaxis]  # (sensor, harmonic)
    found = spectra.turned(fitted[:, : saved + 1], reference.phase) * gain
    found[:, 0] = 0.0
    covariance = noise.covariance * np.einsum("ak,bk->kab", gain, gain.conj())
    if reference.source == "stated":  # else whoever fits the constant fits this error with it
        covariance += np.einsum("k,ak,bk->kab", (order * reference.sd) ** 2, found, found.conj())
    tell(1.0, "conditioned")
    return CutVibration(
        name=recording.name,
        cutter=recording.cutter,
        conditions=recording.conditions,
        sensors=sensors.dofs,
        harmonics=found,
        covariance=covariance,
        lines_between=noise.draws,
        angle_from=reference.source,
        counts_from=reference.counts_from,
        angle_sd=reference.sd,
        ac_rms=ac_rms,
        asynchronous_rms=asynchronous_rms,
        overview_time=survey.time / rate,
        overview_low=survey.low,
        overview_high=survey.high,
        force=_force(recording, cut, cycle, saved, reference.phase),
        sample_rate=rate,
        spindle_frequency=frequency,
        spindle_frequency_sd=frequency_sd,
        revolutions=revolutions,
        steady=(start / rate, stop / rate),
        peaks=peaks,
        notices=tuple(notices),
    )


def _trend(survey: Survey, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
    """The line through the means of the cut's revolutions.   returns level at sample 0 and drift by sample, both (sensor,)"""
    inside = (survey.edges[:-1] >= start) & (survey.edges[1:] <= stop) & np.isfinite(survey.strength)
    if inside.sum() < 2:
        return np.zeros(len(survey.mean)), np.zeros(len(survey.mean))
    time = ((survey.edges[:-1] + survey.edges[1:] - 1) / 2)[inside]
    mean, centre = survey.mean[:, inside], time.mean()
    drift = mean @ (time - centre) / np.sum((time - centre) ** 2)
    return mean.mean(axis=1) - drift * centre, drift


def _spread(survey: Survey, start: int, stop: int) -> np.ndarray:
    """How far each sensor usually swings in the cut, m/s^2; 1 for one that hardly ever does.   returns (sensor,)"""
    inside = (survey.time >= start) & (survey.time < stop)
    swing = (survey.high - survey.low)[:, inside] if inside.any() else survey.high - survey.low
    usual = np.nanmedian(swing, axis=1)
    return np.where(usual > 0, usual, 1.0)


def _between(
    read: Reader, cut: Samples, cycle: float, fitted: np.ndarray, highest: int, revolutions: int
) -> ResidualSpectra:
    """Spectra of what the harmonics leave: of stretches under a window, or of few revolutions as they are.

    highest : harmonic up to which cross spectra are wanted
    """
    length = cut[1] - cut[0]
    if revolutions < WINDOWED:
        stretches, size = 1, length
    else:
        stretches = min(-(-length * len(fitted) // LONGEST), revolutions // WINDOWED)
        size = fast_length(length // stretches)
    return residual_spectra(
        read,
        cut[0],
        size,
        stretches,
        cycle,
        fitted,
        cross_lines=int((highest + 0.5) * cycle * size) + 1,
        windowed=revolutions >= WINDOWED,
    )


def _powers(
    between: ResidualSpectra, turn: float, powers: np.ndarray, cycle: float, fitted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rms of the accelerations, and of what in them does not follow the spindle, both (sensor,) in the unit read.

    Lines near a multiple of the spindle stand for noise like the others, whether the multiple was fitted or not. A noise
    that is to be differentiated grows without end: it counts up to the highest harmonic that was fitted.

    turn : what one differentiation gains, times cycles per sample   powers : (sensor,) differentiations
    """
    frequency, K = between.frequency, fitted.shape[1] - 1
    counted = (frequency >= 0.5 * cycle) & ((powers[:, np.newaxis] == 0) | (frequency <= (K + 0.5) * cycle))
    clear = counted & between.clear(cycle)
    gain = (turn * frequency) ** powers[:, np.newaxis]
    density = gain**2 * between.power * (2 / between.size)
    share = counted.sum(axis=1) / np.maximum(clear.sum(axis=1), 1)
    asynchronous = np.sum(density, axis=1, where=clear) * share
    order = (turn * cycle * np.arange(K + 1)) ** powers[:, np.newaxis]
    synchronous = 0.5 * np.sum(np.abs(fitted * order)[:, 1:] ** 2, axis=1)
    whole = synchronous + np.maximum(np.sum(density, axis=1, where=counted), asynchronous)
    return np.sqrt(whole), np.sqrt(asynchronous)


def _note_few(draws: np.ndarray, sensors: int, note: Note) -> None:
    """Say where so few lines lie between the harmonics that their covariance is hardly known."""
    least = float(draws.min())
    if least < 2 * sensors:
        note(
            "few-lines",
            f"the noise of {sensors} sensors is known from {least:.0f} spectral lines between the harmonics only: the "
            "intervals of the forces are rough; record a longer cut",
        )


def _force(recording: Recording, cut: Samples, cycle: float, highest: int, phase: float) -> np.ndarray | None:
    """Harmonics of a dynamometer that was there too, nan for an axis it has not.   returns (axis, highest + 1) N"""
    rows = recording.force_rows()
    if max(rows) < 0:
        return None
    force = np.full((len(AXES), highest + 1), np.nan, complex)
    there = [axis for axis, row in enumerate(rows) if row >= 0]
    wanted = [rows[axis] for axis in there]

    def read(start: int, stop: int) -> np.ndarray:
        return np.asarray(recording.block(start, stop, wanted))

    read_on = spectra.buffered(read, cut[1], block_size(cut[1] - cut[0]))
    force[there] = spectra.turned(spectra.fit_harmonics(read_on, *cut, cycle, highest), phase)
    return force
