"""From the recording of a cut to the force that follows the spindle, and what does not.

Everything goes block by block through one reader of the three forces (offset and drift taken out, smoothed on request),
so a long recording never lies in memory. Revolutions are not resampled: the harmonics are least-squares fits at the
refined spindle frequency, exact for any number of samples per revolution.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from millcal.data import AXES, AsynchronousPeak, CutForce, Notice, Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra

FEWEST_REVOLUTIONS = 2  # below, nothing can be said of a revolution
FEW_REVOLUTIONS = 5
OVERVIEW_POINTS = 2000
BLOCK = 5  # revolutions whose harmonics are one draw for the variance: longer than the memory of a chip or a mode
AIR_REVOLUTIONS = 5  # fewer do not carry an offset
NYQUIST_SHARE = 0.45  # of the sample rate; above, an anti-aliasing filter has its say

Progress = Callable[[float, str], None]
Span = tuple[float, float]


class _Forces:
    """The three forces on the tool, read in large blocks and served in small ones."""

    def __init__(self, recording: Recording, rows: Sequence[int], size: int = 1 << 18) -> None:
        self.recording, self.rows, self.size = recording, list(rows), size
        self.length = recording.samples.shape[1]
        self.offset, self.drift = np.zeros(3), np.zeros(3)  # N at sample 0, N per sample
        self._start, self._block = 0, np.empty((3, 0))

    def __call__(self, start: int, stop: int) -> np.ndarray:
        """Forces at the samples start..stop.   returns (axis, stop - start) N"""
        if not self._start <= start <= stop <= self._start + self._block.shape[1]:
            end = min(max(stop, start + self.size), self.length)
            samples = np.asarray(self.recording.block(start, end)[self.rows], dtype=float)
            line = np.multiply.outer(self.drift, np.arange(start, end)) + self.offset[:, np.newaxis]
            self._start, self._block = start, samples - line
        return self._block[:, start - self._start : stop - self._start]

    def take_out(self, offset: np.ndarray, drift: np.ndarray) -> None:
        """Subtract offset + drift n from now on.   offset : (axis,) N   drift : (axis,) N per sample"""
        self.offset, self.drift = offset, drift
        self._start, self._block = 0, np.empty((3, 0))


def condition_cut(
    recording: Recording,
    *,
    steady: Span | None = None,
    air: Sequence[Span] | None = None,
    lowpass: float | None = None,
    harmonics: int = 30,
    offset: str = "auto",
    progress: Progress | None = None,
) -> CutForce:
    """Trim, zero, refine the spindle speed and take the harmonics of the force of one cut.

    steady, air : s after the first sample; what the recording says, else found
    lowpass : Hz, zero phase, -3 dB there
    harmonics : highest wished; never above 0.45 of the sample rate
    offset : "auto" line through the air cuts, or one level where there is one air cut; "constant" one level; "none"
    progress : called with (share, label)
    """
    if offset not in ("auto", "constant", "none"):
        raise ValueError(f"{offset=} is none of auto, constant, none")
    tell = progress or (lambda share, label: None)
    where = recording.name or "recording"
    rate, stated = recording.sample_rate, _stated_frequency(recording, where)
    forces = _Forces(recording, _rows(recording, where))
    notices: list[Notice] = []

    def note(code: str, message: str) -> None:
        notices.append(Notice(code, message, where))

    tell(0.0, "reading")
    survey = _survey(forces, rate / stated)
    start, stop = _steady_samples(recording, steady, survey, where, note)
    spans = _air_spans(recording, air, survey, (start, stop), rate)
    line = _offset_line(forces, spans, rate / stated, rate, offset, note)
    forces.take_out(*line)
    removed_offset, removed_drift = line[0] + line[1] * (start + stop) / 2, line[1] * rate

    read: spectra.Reader = forces
    if lowpass is not None:
        if not 0 < lowpass < rate / 2:
            raise RecordingError(
                f"{where}: the low-pass of {lowpass:g} Hz is not below half the sample rate of {rate:g} Hz; "
                "choose a lower cutoff or none"
            )
        read = spectra.smoothed(forces, forces.length, spectra.low_pass_kernel(lowpass / rate))
    _check_clipping(recording, forces, survey, start, stop, note)

    tell(0.2, "spindle speed")
    highest = int(NYQUIST_SHARE * rate / stated)
    cycle, cycle_sd = _spindle(read, start, stop, stated / rate, recording.cutter.teeth, highest, note)
    frequency = cycle * rate
    revolutions = int((stop - start) * cycle + 0.5 * cycle)
    _check_revolutions(revolutions, where, note)
    end = min(start + round(revolutions / cycle), stop)

    tell(0.4, "harmonics")
    limit = max(1, int(NYQUIST_SHARE * rate / frequency))
    analysed, saved = min(max(harmonics, 30), limit), min(harmonics, limit)
    if saved < harmonics:
        note("nyquist", f"{saved} of {harmonics} harmonics are kept: above lie 0.45 of the sample rate of {rate:g} Hz")
    fitted = spectra.fit_harmonics(read, start, end, cycle, analysed)
    turns = _each_revolution(read, start, cycle, revolutions, fitted)
    fitted[:, 0] = _mean(read, start, stop, stated / rate, fitted[:, 0].real, turns.variance[:, 0])

    tell(0.7, "average and spectrum")
    shift, from_pulse = _pulse_phase(recording, start, end, frequency, cycle_sd * rate, note)
    averaged = spectra.average_periods(read, start, end, cycle, fitted, phase=shift)
    ac_rms = np.sqrt(_ac_power(read, start, end))
    asynchronous = np.sqrt(averaged.residual_power)
    peaks = tuple(
        AsynchronousPeak(AXES[line.channel], line.frequency * rate, line.amplitude, line.exceeds)
        for line in spectra.asynchronous_lines(read, start, end, cycle, fitted)
        if line.amplitude >= 0.01 * ac_rms[line.channel]
    )
    _judge(peaks, turns, fitted, ac_rms, asynchronous, recording.cutter.teeth * frequency, rate / (end - start), note)

    tell(1.0, "conditioned")
    return CutForce(
        name=recording.name,
        cutter=recording.cutter,
        conditions=recording.conditions,
        harmonics=(fitted * np.exp(-1j * shift * np.arange(analysed + 1)))[:, : saved + 1],
        harmonics_variance=turns.variance[:, : saved + 1],
        mean_all_rows=_mean_of_rows(read, start, stop),
        revolution_means=turns.means,
        average_angle=averaged.angle,
        average=averaged.average,
        scatter=averaged.scatter,
        ac_rms=ac_rms,
        asynchronous_rms=asynchronous,
        overview_time=survey.time / rate,
        overview_low=survey.low,
        overview_high=survey.high,
        removed_offset=removed_offset,
        removed_drift=removed_drift,
        sample_rate=rate,
        spindle_frequency=frequency,
        spindle_frequency_sd=cycle_sd * rate,
        revolutions=revolutions,
        steady=(start / rate, stop / rate),
        air=tuple((low / rate, high / rate) for low, high in spans),
        phase_from_pulse=from_pulse,
        lowpass=lowpass,
        peaks=peaks,
        notices=tuple(notices),
    )


def _rows(recording: Recording, where: str) -> list[int]:
    """Rows of fx, fy, fz; each axis must be there."""
    rows = recording.force_rows()
    missing = [f"f{axis}" for axis, row in zip(AXES, rows, strict=True) if row < 0]
    if missing:
        have = ", ".join(
            f"{channel.name} ({channel.quantity}, {channel.dof or 'no dof'})" for channel in recording.channels
        )
        raise RecordingError(
            f"{where}: no force channel for {', '.join(missing)}; it has {have}. "
            f'Name it in the map, for example {missing[0]} = "+F{missing[0][1]}"'
        )
    return rows


def _stated_frequency(recording: Recording, where: str) -> float:
    """The stated spindle frequency, Hz, after a look at what the recording must say about itself."""
    if recording.kind == "impact":
        raise RecordingError(f"{where}: is an impact test, not a cut; name it under [impact]")
    if recording.cutter is None:
        raise RecordingError(f"{where}: says nothing of the cutter; give a [cutter] table or a setup")
    if recording.conditions is None:
        raise RecordingError(f"{where}: says nothing of the cutting conditions; give its [[cuts]] entry or a setup")
    frequency = recording.conditions.spindle_speed / (2 * np.pi)
    if not frequency > 0:
        raise RecordingError(f"{where}: the spindle speed is not positive; state spindle_speed_rpm")
    if recording.sample_rate < 8 * frequency:
        raise RecordingError(
            f"{where}: {recording.sample_rate:g} samples per second are fewer than 8 per revolution at "
            f"{60 * frequency:g} rpm; check the sample rate and spindle_speed_rpm"
        )
    return frequency


class _Survey(NamedTuple):
    """One look at every sample."""

    edges: np.ndarray  # (revolution + 1,) samples, at the stated speed
    strength: np.ndarray  # (revolution,) N, AC rms of the three axes together; nan where a sample is no number
    time: np.ndarray  # (overview,) samples
    low: np.ndarray  # (axis, overview) N
    high: np.ndarray  # (axis, overview) N


def _survey(forces: _Forces, samples_per_revolution: float) -> _Survey:
    """AC rms of every revolution, and the envelope of the whole record."""
    n = forces.length
    edges = np.rint(np.arange(0, n + 1e-9, samples_per_revolution)).astype(np.int64)
    edges = edges[edges <= n]
    strength = np.empty(max(len(edges) - 1, 0))
    width = max(1, -(-n // OVERVIEW_POINTS))
    bounds = np.arange(0, n, width)
    low, high = np.empty((3, len(bounds))), np.empty((3, len(bounds)))
    at = 0
    while at < len(strength):
        upto = max(at + 1, int(np.searchsorted(edges, edges[at] + forces.size, "right")) - 1)
        y = forces(edges[at], edges[upto])
        cuts = edges[at:upto] - edges[at]
        count = np.diff(edges[at : upto + 1])
        y = y - y[:, :1]  # one pass, without the loss of digits that a large offset would bring
        mean = np.add.reduceat(y, cuts, axis=1) / count
        power = np.add.reduceat(y**2, cuts, axis=1) / count - mean**2
        strength[at:upto] = np.sqrt(np.maximum(power, 0.0).sum(axis=0))
        at = upto
    step = max(1, forces.size // width)
    for first in range(0, len(bounds), step):
        last = min(first + step, len(bounds))
        y = forces(bounds[first], min(bounds[last - 1] + width, n))
        cuts = bounds[first:last] - bounds[first]
        low[:, first:last] = np.minimum.reduceat(y, cuts, axis=1)
        high[:, first:last] = np.maximum.reduceat(y, cuts, axis=1)
    return _Survey(edges, strength, np.minimum(bounds + (width - 1) / 2, n - 1), low, high)


def _level(values: np.ndarray) -> tuple[float, float]:
    """Level and spread of the densest half of the values, which ramps and bursts do not move.   returns (level, sd)"""
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
    at = int(np.argmin(widths))
    return float(ordered[at : at + half].mean()), float(widths[at] / 1.349)


def _runs(mask: np.ndarray, bridge: int = 0) -> list[tuple[int, int]]:
    """Stretches of True, with gaps of up to `bridge` closed: (first, last + 1)."""
    steps = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    runs: list[tuple[int, int]] = []
    for low, high in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1), strict=True):
        if runs and low - runs[-1][1] <= bridge:
            runs[-1] = (runs[-1][0], int(high))
        else:
            runs.append((int(low), int(high)))
    return runs


def _steady_samples(
    recording: Recording, steady: Span | None, survey: _Survey, where: str, note: Callable[[str, str], None]
) -> tuple[int, int]:
    """The steady cut as samples start..stop: as stated, else the longest stretch of revolutions at the level of the cut."""
    n, rate = recording.samples.shape[1], recording.sample_rate
    steady = steady if steady is not None else recording.steady
    if steady is not None:
        start, stop = round(steady[0] * rate), round(steady[1] * rate)
        if not 0 <= start < stop <= n + 1:
            raise RecordingError(
                f"{where}: steady_s = [{steady[0]:g}, {steady[1]:g}] does not lie within the record of {n / rate:g} s; "
                "give times after its first sample"
            )
        stop = min(stop, n)
    else:
        strength = survey.strength
        usable = np.isfinite(strength)
        if usable.sum() < FEWEST_REVOLUTIONS:
            raise RecordingError(
                f"{where}: holds {len(strength)} revolutions at the stated speed, {int(usable.sum())} of them whole numbers; "
                "a cut needs at least 2, check the spindle speed and the sample rate"
            )
        cutting = strength[usable & (strength > 0.5 * np.quantile(strength[usable], 0.95))]
        if not len(cutting) or not np.max(cutting) > 0:
            raise RecordingError(f"{where}: the forces never change; check the channels named in the map")
        level, spread = _level(cutting)
        runs = _runs(usable & (np.abs(strength - level) <= max(4 * spread, 0.02 * level)), bridge=3)
        first, last = max(runs, key=lambda run: run[1] - run[0])
        inside = strength[first:last][np.isfinite(strength[first:last])]
        level, spread = _level(inside)  # once more, without the ramps and the air
        near = usable & (np.abs(strength - level) <= max(5 * spread, 0.02 * level))
        first, last = max(_runs(near, bridge=3), key=lambda run: run[1] - run[0])
        others = [run for run in _runs(near, bridge=3) if run[1] - run[0] > 0.5 * (last - first) and run[0] != first]
        if others:
            note(
                "several-cuts",
                f"{1 + len(others)} stretches look like a steady cut; the longest is used, else give steady_s",
            )
        start = int(survey.edges[first])
        stop = n if last == len(strength) else int(survey.edges[last])
    for begin in range(start, stop, 1 << 18):
        block = recording.block(begin, min(begin + (1 << 18), stop))
        if not np.all(np.isfinite(block[recording.force_rows()])):
            bad = begin + int(np.flatnonzero(~np.isfinite(block[recording.force_rows()]).all(axis=0))[0])
            raise RecordingError(
                f"{where}: a force is not a number at {bad / rate:g} s, within the steady cut; give steady_s without it"
            )
    return start, stop


def _air_spans(
    recording: Recording, air: Sequence[Span] | None, survey: _Survey, steady: tuple[int, int], rate: float
) -> list[tuple[int, int]]:
    """Air cuts as samples: as stated, else the quiet revolutions at the beginning and at the end of the record."""
    n = recording.samples.shape[1]
    air = air if air is not None else recording.air
    if air is not None:
        spans = [(max(round(low * rate), 0), min(round(high * rate), n)) for low, high in air]
        return [(low, high) for low, high in spans if high > low]
    edges, strength = survey.edges, survey.strength
    inside = (edges[:-1] >= steady[0]) & (edges[1:] <= steady[1])
    before, after = edges[1:] <= steady[0], edges[:-1] >= steady[1]
    if not inside.any() or not (before | after).any():
        return []
    level = float(np.nanmedian(strength[inside]))
    spans = []
    for side in (before, after):
        values = strength[side]
        quiet = values[np.isfinite(values) & (values < 0.25 * level)]
        if len(quiet) < AIR_REVOLUTIONS:
            continue
        floor, spread = _level(quiet)
        runs = _runs(side & (np.nan_to_num(strength, nan=np.inf) <= floor + max(5 * spread, 0.002 * level)), bridge=1)
        if not runs:
            continue
        low, high = max(runs, key=lambda run: run[1] - run[0])
        low, high = (low, high - 1) if side is before else (low + 1, high)  # the ramp may begin within a revolution
        if high - low >= AIR_REVOLUTIONS:
            spans.append((int(edges[low]), int(edges[high])))
    return spans


def _offset_line(
    forces: _Forces,
    spans: list[tuple[int, int]],
    samples_per_revolution: float,
    rate: float,
    offset: str,
    note: Callable[[str, str], None],
) -> tuple[np.ndarray, np.ndarray]:
    """The line through the air cuts: N at sample 0 and N per sample, each (axis,); zero where nothing is taken out."""
    if offset == "none":
        note("offset-kept", "offset and drift are left in, as asked; edge coefficients absorb them")
        return np.zeros(3), np.zeros(3)
    if not spans:
        note(
            "no-air-cut",
            "no air cut in the record: offset and drift cannot be told from the force, and the edge coefficients absorb "
            "them; record a second of air cut before and after",
        )
        return np.zeros(3), np.zeros(3)
    times, means = [], []
    for low, high in spans:
        whole = max(int((high - low) / samples_per_revolution), 1)
        edges = np.rint(low + np.arange(whole + 1) * samples_per_revolution).astype(np.int64)
        edges = np.minimum(edges, high)
        for a, b in pairwise(edges):
            times.append((a + b - 1) / 2)
            means.append(forces(int(a), int(b)).mean(axis=1))
    time, mean = np.array(times), np.array(means)  # (revolution,), (revolution, axis)
    centre = time.mean()
    slope = np.zeros(3)
    if offset == "auto" and len(spans) > 1:
        slope = (time - centre) @ (mean - mean.mean(axis=0)) / np.sum((time - centre) ** 2)
    level = mean.mean(axis=0)
    seconds = sum(high - low for low, high in spans) / rate
    said = ", ".join(f"{axis} {v:.3g} N" for axis, v in zip(AXES, level, strict=True))
    if len(spans) > 1 and offset == "auto":
        drifts = ", ".join(f"{axis} {v * rate:.3g} N/s" for axis, v in zip(AXES, slope, strict=True))
        note("offset-removed", f"removed the offset ({said}) and the drift ({drifts}) of {seconds:.2g} s of air cut")
    else:
        why = "" if offset == "constant" else "; the air cut is on one side only, so drift stays in"
        note("offset-removed", f"removed the offset ({said}) of {seconds:.2g} s of air cut{why}")
    return level - slope * centre, slope


def _check_clipping(
    recording: Recording, forces: _Forces, survey: _Survey, start: int, stop: int, note: Callable[[str, str], None]
) -> None:
    """Say where samples of the steady cut stand at the limit of the input."""
    limits = [recording.channels[row].full_scale for row in forces.rows]
    top, bottom = np.nanmax(survey.high, axis=1), np.nanmin(survey.low, axis=1)
    clipped, flat = np.zeros(3, int), np.zeros(3, int)
    for at in range(start, stop, forces.size):
        y = np.asarray(recording.block(at, min(at + forces.size, stop))[forces.rows], dtype=float)
        for axis, limit in enumerate(limits):
            if limit:
                clipped[axis] += int(np.sum(np.abs(y[axis]) >= 0.999 * limit))
            still = (y[axis] == top[axis]) | (y[axis] == bottom[axis])
            flat[axis] += int(np.sum(still[3:] & still[2:-1] & still[1:-2] & still[:-3]))
    for axis in range(3):
        if clipped[axis]:
            note(
                "clipped",
                f"f{AXES[axis]} reaches its input range of {limits[axis]:g} N at {clipped[axis]} samples of the cut",
            )
        elif flat[axis] >= 3 and top[axis] > bottom[axis]:
            note(
                "clipped",
                f"f{AXES[axis]} stands still at its extreme value {flat[axis]} times: the input may have clipped",
            )


def _spindle(
    read: spectra.Reader,
    start: int,
    stop: int,
    stated: float,
    teeth: int,
    highest: int,
    note: Callable[[str, str], None],
) -> spectra.Cycle:
    """The spindle frequency in cycles per sample, from the harmonics.   stated : cycles per sample"""
    revolutions = int((stop - start) * stated)
    order = max(1, min(max(12, 2 * teeth), highest))
    if revolutions < FEWEST_REVOLUTIONS:
        return spectra.Cycle(stated, float("nan"))
    stretch = min(revolutions, 32)
    middle = (start + stop) // 2
    half = int(stretch / stated / 2)
    low, high = max(start, middle - half), min(stop, middle + half)
    cycle = spectra.search_cycle(read(low, high), stated, harmonics=order)
    found = spectra.Cycle(cycle, np.inf)
    while True:  # longer and longer, so that the turn from segment to segment stays small
        found = spectra.refine_cycle(read, low, high, found.cycle, harmonics=order)
        if (low, high) == (start, stop):
            break
        half *= 4
        low, high = max(start, middle - half), min(stop, middle + half)
    off = found.cycle / stated - 1
    if abs(off) > 0.01:
        note(
            "speed-off",
            f"the harmonics say {off:+.1%} against the stated spindle speed; the measured one is used, check the recipe",
        )
    return found


def _check_revolutions(revolutions: int, where: str, note: Callable[[str, str], None]) -> None:
    if revolutions < FEWEST_REVOLUTIONS:
        raise RecordingError(
            f"{where}: the steady cut holds {revolutions} whole revolutions; at least {FEWEST_REVOLUTIONS} are needed, "
            "check the spindle speed, the sample rate and steady_s"
        )
    if revolutions < FEW_REVOLUTIONS:
        note("few-revolutions", f"only {revolutions} whole revolutions: scatter and spindle speed are hardly known")


class _Revolutions(NamedTuple):
    """The harmonics revolution by revolution, in short."""

    means: np.ndarray  # (axis, revolution) N
    variance: np.ndarray  # (axis, harmonic) N^2, of the harmonics of the whole cut
    turn: np.ndarray  # (revolution,) rad, spindle angle ahead of the uniform one
    gain: np.ndarray  # (revolution,), harmonics relative to their mean, minus 1


def _each_revolution(
    read: spectra.Reader, start: int, cycle: float, revolutions: int, fitted: np.ndarray
) -> _Revolutions:
    """Harmonics of every revolution: their means, their variance from blocks, and how far the spindle runs ahead."""
    K = fitted.shape[1] - 1
    edges = start + np.rint(np.arange(revolutions + 1) / cycle).astype(np.int64)
    size = BLOCK if revolutions >= 4 * BLOCK else 1
    order = np.arange(min(K, 12) + 1)
    main = fitted[:, : len(order)]
    weight = np.sum(order**2 * np.abs(main) ** 2)
    means, turn, gain, blocks = [], [], [], []
    step = 200 * size
    for first in range(0, revolutions, step):
        last = min(first + step, revolutions)
        found = spectra.block_harmonics(read, edges[first : last + 1], cycle, K)
        found = found * np.exp(-2j * np.pi * np.arange(K + 1) * ((edges[first] - start) * cycle % 1.0))
        means.append(found[:, :, 0].real)
        pull = np.sum(order**2 * main.conj() * found[:, :, : len(order)], axis=(1, 2)) / max(weight, 1e-300)
        along = np.sum(order * main.conj() * found[:, :, : len(order)], axis=(1, 2)).imag / max(weight, 1e-300)
        turn.append(along)
        gain.append(pull.real - 1)
        full = (last - first) // size
        if full:
            blocks.append(found[: full * size].reshape(full, size, 3, K + 1).mean(axis=1))
    drawn = np.concatenate(blocks)
    count = len(drawn)
    variance = np.sum(np.abs(drawn - drawn.mean(axis=0)) ** 2, axis=0) / (count * max(count - 1, 1))
    return _Revolutions(np.concatenate(means).T, variance, np.concatenate(turn), np.concatenate(gain))


def _mean(
    read: spectra.Reader, start: int, stop: int, stated: float, refined: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """Mean force over whole revolutions: of the stated speed while that tells no other mean than the refined speed does.

    A stated speed of a whole number of samples per revolution makes this the plain mean over those rows. Where the two
    speeds part by a sample over the cut, or the means by more than their standard error, the refined speed decides.
    returns (axis,) N
    """
    revolutions = int((stop - start) * stated + 0.5 * stated)
    end = min(start + round(revolutions / stated), stop)
    K = max(1, min(30, int(NYQUIST_SHARE / stated)))
    if revolutions < FEWEST_REVOLUTIONS:
        return refined
    mean = spectra.fit_harmonics(read, start, end, stated, K)[:, 0].real
    return mean if np.all(np.abs(mean - refined) <= np.sqrt(variance)) else refined


def _mean_of_rows(read: spectra.Reader, start: int, stop: int, size: int = 1 << 18) -> np.ndarray:
    """Mean of every row.   returns (axis,)"""
    total = sum(read(at, min(at + size, stop)).sum(axis=1) for at in range(start, stop, size))
    return np.asarray(total) / (stop - start)


def _ac_power(read: spectra.Reader, start: int, stop: int, size: int = 1 << 18) -> np.ndarray:
    """Mean square about the mean.   returns (axis,)"""
    mean = _mean_of_rows(read, start, stop)[:, np.newaxis]
    total = sum(((read(at, min(at + size, stop)) - mean) ** 2).sum(axis=1) for at in range(start, stop, size))
    return np.asarray(total) / (stop - start)


def _pulse_phase(
    recording: Recording, start: int, stop: int, frequency: float, sd: float, note: Callable[[str, str], None]
) -> tuple[float, bool]:
    """Spindle angle at the first steady sample, from the once-per-revolution pulse: (rad, whether there was one)."""
    rows = recording.rows_of("pulse")
    if not rows:
        return 0.0, False
    pulses = pulse_times(recording, rows[0], start, stop)  # samples after start
    expected = (stop - start) * frequency / recording.sample_rate
    if len(pulses) < 2 or not 0.8 * expected - 1 <= len(pulses) <= 1.2 * expected + 1:
        note(
            "pulse-unusable",
            f"{len(pulses)} pulses in {expected:.0f} revolutions; the phase is counted from the first sample",
        )
        return 0.0, False
    turns = pulses * frequency / recording.sample_rate
    offset = np.angle(np.mean(np.exp(-2j * np.pi * turns)))
    number = np.rint(turns + offset / (2 * np.pi))
    slope, _ = np.polyfit(number, pulses, 1)
    by_pulse = recording.sample_rate / slope
    wander = np.std(turns - number)
    if abs(by_pulse / frequency - 1) > max(1e-4, 5 * sd / frequency) or wander > 0.1:
        note(
            "pulse-disagrees",
            f"the pulse says {60 * by_pulse:.2f} rpm, the harmonics {60 * frequency:.2f} rpm; the harmonics are used, "
            "check the pulse for missed or double edges",
        )
    return float(offset), True


def pulse_times(recording: Recording, row: int, start: int, stop: int, size: int = 1 << 18) -> np.ndarray:
    """Leading edges of a pulse channel, interpolated between samples.   returns (pulse,) samples after start

    The level that holds for most of the time is the rest; an edge leaves it through the middle, and counts again only
    after the signal has come back by a quarter of the swing, so that noise on a slow edge makes no second pulse.
    """
    low, high, total = np.inf, -np.inf, 0.0
    for at in range(start, stop, size):
        y = recording.block(at, min(at + size, stop))[row]
        low, high, total = min(low, float(y.min())), max(high, float(y.max())), total + float(y.sum())
    middle, swing = (low + high) / 2, high - low
    if not swing > 0:
        return np.empty(0)
    sign = 1.0 if total / (stop - start) < middle else -1.0
    edges: list[float] = []
    armed, last = False, 0.0
    for at in range(start, stop, size):
        y = sign * (np.asarray(recording.block(at, min(at + size, stop))[row], dtype=float) - middle)
        joined = np.concatenate([[last if at > start else y[0]], y])
        ups = np.flatnonzero((joined[:-1] < 0) & (joined[1:] >= 0))
        rests = np.flatnonzero(y < -0.25 * swing)
        for up in ups:
            seen = np.searchsorted(rests, up, "left")
            if armed or seen > 0:
                edges.append(at - start + up - 1 + joined[up] / (joined[up] - joined[up + 1]))
                armed, rests = False, rests[seen:]
        armed = armed or len(rests) > 0
        last = float(y[-1])
    return np.array(edges)


def _judge(
    peaks: tuple[AsynchronousPeak, ...],
    turns: _Revolutions,
    fitted: np.ndarray,
    ac_rms: np.ndarray,
    asynchronous: np.ndarray,
    tooth_passing: float,
    resolution: float,
    note: Callable[[str, str], None],
) -> None:
    """Say what spoils the synchronous force: chatter, drift, a wandering speed, noise."""
    tolerance = max(2 * resolution, 0.005 * tooth_passing)
    lines: dict[float, float] = {}  # frequency -> amplitude, one for all axes
    for peak in sorted(peaks, key=lambda peak: -peak.amplitude):
        if all(abs(peak.frequency - line) > tolerance for line in lines):
            lines[peak.frequency] = peak.amplitude
    pairs = [
        (a, b)
        for a in sorted(lines)
        for b in sorted(lines)
        if abs(b - a - tooth_passing) <= tolerance and max(lines[a], lines[b]) >= 0.02 * ac_rms.max()
    ]
    if pairs:
        said = ", ".join(f"{a:.0f} and {b:.0f} Hz" for a, b in pairs[:3])
        note(
            "chatter-lines",
            f"lines one tooth passing ({tooth_passing:.1f} Hz) apart that do not follow the spindle: {said}; "
            "chatter, or a mode that the cut excites",
        )
    share = (asynchronous / np.maximum(ac_rms, 1e-300)) ** 2
    for axis, value in enumerate(share):
        if value > 0.02:
            note("asynchronous", f"{value:.1%} of the AC power of f{AXES[axis]} does not follow the spindle")
    wander = np.sqrt(max(float(np.var(turns.turn) - np.var(turns.gain)), 0.0))
    order = min(fitted.shape[1] - 1, 10)
    if (order * wander) ** 2 / 2 > 0.01:
        note(
            "speed-wander",
            f"the spindle angle wanders by {np.degrees(wander):.2g} deg rms about a uniform speed: harmonic {order} loses "
            f"{1 - np.exp(-((order * wander) ** 2) / 2):.0%}",
        )
    thirds = np.array_split(turns.means, 3, axis=1) if turns.means.shape[1] >= 9 else []
    if thirds:
        drift = np.abs(thirds[-1].mean(axis=1) - thirds[0].mean(axis=1))
        for axis in np.flatnonzero(drift > np.maximum(0.05 * ac_rms, 1e-9)):
            note(
                "mean-drift",
                f"the mean of f{AXES[axis]} moves by {drift[axis]:.3g} N from the first to the last third of the cut",
            )
