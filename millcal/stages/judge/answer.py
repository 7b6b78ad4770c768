"""The judgement of a cut as a record: verdict, frequencies, speeds, and all that a report draws."""

from typing import Any

import numpy as np

from millcal.data import ChatterPeak, Judgement, Notice, Recording
from millcal.numerics import spectra
from millcal.numerics.residual_lines import residual_spectra
from millcal.numerics.spectra import Cycle
from millcal.numerics.tones import Tone
from millcal.stages.judge.remains import Remains, falls_off
from millcal.stages.judge.signal import Stretch
from millcal.stages.judge.verdict import HIGHEST, Finding

MOST_PEAKS = 12
SMALLEST_PEAK = 1e-3  # of the power
MOST_SPEEDS = 10  # that a chatter frequency points to
SLOWEST = 0.5  # of the cut's speed
LINES = 4000  # of the spectrum that are kept
FLASHES = 2000  # of the motion once per tooth that are kept


def answer(
    recording: Recording,
    stretch: Stretch,
    found: Remains,
    verdict: Finding,
    strobes: Any,
    cycle: Cycle,
    revolutions: float,
    teeth: int,
    drive: int,
    surveyed: list[int],
    notices: tuple[Notice, ...],
) -> Judgement:
    """The judgement of one cut, with what a report draws of it.

    revolutions : judged   drive : flashes in a turn   surveyed : channels of the stretch's survey
    """
    rate, channel = recording.sample_rate, recording.channels[found.row]
    tones = verdict.tones
    chatter = tones[0].frequency * rate if tones else None
    rms = float(np.std(found.signal))
    frequency, spectrum, remaining = _spectra(found, rate)
    told = [tone for tone in found.tones if tone.sharp and tone.power >= SMALLEST_PEAK * found.power]
    open_ended = not falls_off(found.spectra.power[0])
    speeds: tuple[float, ...] = ()
    if chatter is not None and drive == teeth:
        all_of_them = 2 * np.pi * chatter / (teeth * np.arange(1, MOST_SPEEDS + 1))
        speeds = tuple(float(s) for s in all_of_them if s > SLOWEST * 2 * np.pi * cycle.cycle * rate)
    i = np.unique(np.linspace(0, len(strobes.time) - 1, min(FLASHES, len(strobes.time))).round().astype(int))
    if len(strobes.time) > FLASHES:  # neighbours belong together
        i = np.arange(len(strobes.time) - FLASHES, len(strobes.time))
    survey, own = stretch.survey, surveyed.index(found.row)
    return Judgement(
        name=recording.name,
        channel=channel.name,
        quantity=channel.quantity,  # type: ignore[arg-type]
        unit=channel.unit,
        teeth=teeth,
        sample_rate=rate,
        spindle_frequency=cycle.cycle * rate,
        spindle_frequency_sd=cycle.sd * rate if np.isfinite(cycle.sd) else np.nan,
        steady=(stretch.start / rate, stretch.stop / rate),
        revolutions=int(revolutions),
        verdict=verdict.verdict,  # type: ignore[arg-type]
        why=verdict.why,
        period=verdict.period,
        metric=float(strobes.change[0]),
        metric_relative=float(strobes.change[0]) / rms,
        chatter_frequency=chatter,
        chatter_frequency_sd=None if chatter is None else _sd(tones[0], verdict, cycle, rate),
        chatter_share=verdict.share,
        peaks=tuple(_peak(tone, found, rate, open_ended) for tone in told[:MOST_PEAKS]),
        stable_speeds=speeds,
        frequency=frequency,
        spectrum=spectrum,
        remaining=remaining,
        sample_time=(stretch.start + strobes.time[i]) / rate,
        once_per_tooth=strobes.value[i],
        overview_time=survey.time / rate,
        overview_low=survey.low[own],
        overview_high=survey.high[own],
        per="tooth" if drive == teeth else "revolution",
        conditions=recording.conditions,
        notices=notices,
    )


def _sd(tone: Tone, verdict: Finding, cycle: Cycle, rate: float) -> float:
    """Of the chatter frequency; where it is a harmonic of the spindle, that of the spindle.   Hz"""
    if verdict.alternates:
        return float(tone.frequency / cycle.cycle * cycle.sd * rate) if np.isfinite(cycle.sd) else float("nan")
    return tone.deviation * rate


def _peak(tone: Tone, found: Remains, rate: float, open_ended: bool) -> ChatterPeak:
    f = tone.frequency * rate
    share = tone.power / max(float(np.mean(found.signal**2)), 1e-300)
    return ChatterPeak(
        f, float(np.sqrt(2 * tone.power)), share, rate - f if open_ended and rate - f < HIGHEST else None
    )


def _spectra(found: Remains, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes as recorded and as left, the highest of each few lines where there are many.   returns Hz and both"""
    rest = found.spectra
    read = spectra.reader_of(found.signal[np.newaxis])
    nothing = np.zeros((1, 2), complex)
    whole = residual_spectra(read, 0, rest.size, rest.stretches, 0.01, nothing)
    step = max(1, -(-rest.power.shape[1] // LINES))
    edges = np.arange(0, rest.power.shape[1], step)
    amplitude = [np.sqrt(np.maximum.reduceat(s.power[0], edges) * 6 / rest.size) for s in (whole, rest)]
    return rest.frequency[edges] * rate, amplitude[0], amplitude[1]
