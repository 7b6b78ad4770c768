"""Impact tests to a frequency response matrix: hits found, judged, windowed and averaged.

Each hit gets a verdict with a reason, and a rejected one stays in the table, so that the operator can overrule it
(`keep`, `drop`). Inputs are the dofs of the force channels, outputs those of the response channels, both in channel order;
recordings with the same input add hits, others add inputs. Several force channels in one recording are inputs at the same
time, told apart by least squares over the hits.

The estimate stays in the form that was measured unless another is asked for: dividing an accelerance by -w^2 blows up what
little offset and drift is left at low frequency, and has no value at all at 0 Hz (nan).

Where force channels answer the hammer (`Channel.role`), they are a dynamometer under it and the FRF is its transmissibility,
force over force: 1 at rest, and the only form there is.
"""

from collections.abc import Callable, Sequence

import numpy as np

from millcal.data import Frf, Hit, HitSpectra, Notice, Recording
from millcal.errors import IllPosedError, RecordingError
from millcal.numerics.frequency_response import ESTIMATORS, condition, divide, estimate
from millcal.physics.structure import DERIVATIVES, convert_frf, convert_frf_variance
from millcal.stages.frf.taps import (
    FORM_OF,
    Tap,
    judge,
    named_hits,
    plan_windows,
    reject_inconsistent,
    survey_recording,
    transform,
)

GAIN_AT_REST = 0.05  # what hammer and dynamometer may differ by


def estimate_frf(
    recordings: Recording | Sequence[Recording],
    *,
    estimator: str = "h1",
    form: str | None = None,
    keep: Sequence[int | str] = (),
    drop: Sequence[int | str] = (),
    allow_double: bool = False,
    weak: float = 0.15,
    hold_off: float = 0.1,
    record_length: float | None = None,
    resolution: float | None = None,
    exponential: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Frf:
    """Frequency response of all outputs to all inputs from impact tests.

    estimator : "h1", "h2" or "hv"
    form : "accelerance", "mobility" or "receptance"; None keeps what the first response channel measures;
        "transmissibility" takes the dynamometer's forces where motion was recorded beside them
    keep, drop : hits to use or leave out whatever is found, from 0 in each recording; `"tap_y.h5:3"` among several
    allow_double : use double hits too, with both pulses inside the force window
    weak : hits below this share of the median peak are left out
    hold_off : s; in a continuous recording, pulses closer than this belong to one hit
    record_length : s of each hit; None takes what the decay of the response needs, or the segments
    resolution : Hz between the lines at most, by adding zeros; None takes the record, and at least twice the decay
    exponential : value at the record's end of an exponential window on force and response; None puts on none
    progress : called with (share done, label)
    """
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not recordings:
        raise RecordingError("frf: no recording given; name at least one impact test")
    if estimator not in ESTIMATORS:
        raise IllPosedError(f"estimator {estimator}: not known; use one of {', '.join(ESTIMATORS)}")
    if form not in (None, "transmissibility", *DERIVATIVES):
        raise IllPosedError(f"form {form}: not known; use one of {', '.join(DERIVATIVES)}, transmissibility")
    progress = progress or (lambda share, label: None)
    rate = recordings[0].sample_rate
    taps = []
    for i, recording in enumerate(recordings):
        progress(0.7 * i / len(recordings), f"hits of {recording.name}")
        if abs(recording.sample_rate - rate) > 1e-6 * rate:
            raise RecordingError(
                f"{recording.name}: sampled at {recording.sample_rate:g} Hz, {recordings[0].name} at {rate:g} Hz; "
                "recordings of one FRF need one rate"
            )
        taps.append(survey_recording(recording, hold_off, record_length, form))
    _check_one_kind(taps)
    kept, dropped = named_hits(taps, keep, "keep"), named_hits(taps, drop, "drop")
    for tap in taps:
        judge(tap, weak, allow_double, kept, dropped)
        plan_windows(tap)
    length = min(tap.length for tap in taps)
    points = _points(taps, length, rate, resolution)
    if exponential is not None and not 0 < exponential < 1:
        raise IllPosedError(f"exponential {exponential:g}: no window ends there; give its value at the end, as 0.05")
    damping = 0.0 if exponential is None else -float(np.log(exponential)) / length
    for i, tap in enumerate(taps):
        progress(0.7 + 0.2 * i / len(taps), f"spectra of {tap.recording.name}")
        for hit in tap.used():
            transform(tap, hit, length, points, damping)
        reject_inconsistent(tap, kept)
    progress(0.95, "frequency response")
    return _assemble(taps, length, points, rate, estimator, form, damping * rate)


def _check_one_kind(taps: list[Tap]) -> None:
    """Motion in one recording and forces in another are two FRFs."""
    of_forces = [tap.recording.channels[tap.responses[0]].quantity == "force" for tap in taps]
    if len(set(of_forces)) > 1:
        forces, motion = (taps[of_forces.index(kind)].recording.name for kind in (True, False))
        raise RecordingError(
            f"{forces}: the responses are a dynamometer's forces, in {motion} they are motions; "
            "estimate the two FRFs one by one"
        )


def _points(taps: list[Tap], length: int, rate: float, resolution: float | None) -> int:
    """Points of the transform: a power of two that holds the record and twice the decay, or the resolution asked for.

    Twice the decay gives at least four lines in the half-power width of the slowest mode.
    """
    if resolution is not None:
        return max(length, int(np.ceil(rate / resolution)))
    decays = [2.0 * float(tap.decay.max()) for tap in taps if tap.decay.max() < length]
    return 1 << int(np.ceil(np.log2(max([length, *decays]))))


def _groups(taps: list[Tap]) -> list[list[Tap]]:
    """Recordings that share an input, directly or through others, belong to one least-squares problem."""
    groups: list[list[Tap]] = []
    for tap in taps:
        touched = [group for group in groups if any(set(tap.inputs) & set(other.inputs) for other in group)]
        groups = [group for group in groups if group not in touched] + [[t for group in touched for t in group] + [tap]]
    return groups


def _assemble(
    taps: list[Tap], length: int, points: int, rate: float, estimator: str, form: str | None, damping: float
) -> Frf:
    """Estimate each group of inputs, and put the matrix, the table of hits and the notices together."""
    inputs = tuple(dict.fromkeys(dof for tap in taps for dof in tap.inputs))
    outputs = tuple(dict.fromkeys(dof for tap in taps for dof in tap.outputs))
    notices = [notice for tap in taps for notice in (*tap.recording.notices, *tap.notices)]
    frequency = np.arange(points // 2 + 1) * (rate / points)
    shape = (len(frequency), len(outputs), len(inputs))
    values, coherence, variance = np.full(shape, np.nan, complex), np.full(shape, np.nan), np.full(shape, np.nan)
    explained, total = np.zeros(shape[:2]), np.zeros(shape[:2])
    enough = np.zeros(len(outputs), bool)
    spectrum, line_noise = np.zeros((len(frequency), len(inputs))), np.zeros(len(inputs))
    hits_used = np.zeros(len(inputs), int)
    behind: list[tuple[list[tuple[Tap, int]], list[int], list[int]]] = []  # hits, rows and columns of the tests

    for group in _groups(taps):
        columns = [j for j, dof in enumerate(inputs) if any(dof in tap.inputs for tap in group)]
        hits = [(tap, hit) for tap in group for hit in tap.used()]
        where = group[0].recording.name
        force, force_noise, in_force = _stacked(hits, [inputs[j] for j in columns], 0)
        response, response_noise, in_response = _stacked(hits, outputs, 1)
        if not hits or not in_force.any(axis=0).all():
            raise IllPosedError(
                f"{where}: no hit is good enough: {_complaints(group)}; hit again, or overrule with keep"
            )
        for c, j in enumerate(columns):
            mine = in_force[:, c]
            spectrum[:, j] = np.sqrt(np.mean(np.abs(force[mine, c]) ** 2, axis=0)) / rate
            line_noise[j] = force_noise[mine, c].mean() / rate**2
            hits_used[j] = mine.sum()
        if len(columns) > 1:
            notices += _told_apart(force, where)
        for pattern in np.unique(in_response[:, in_response.any(axis=0)], axis=1).T:
            rows = [row for row in range(len(outputs)) if (in_response[:, row] == pattern).all()]
            if pattern.sum() < len(columns):
                raise IllPosedError(
                    f"{where}: {pattern.sum()} usable hits for {len(columns)} force channels; hit more often"
                )
            found = estimate(
                force[pattern],
                response[np.ix_(pattern, rows)],
                force_noise[pattern].sum(axis=0),
                response_noise[np.ix_(pattern, rows)].sum(axis=0),
                estimator=estimator,
            )
            place = np.ix_(range(len(frequency)), rows, columns)
            values[place], coherence[place], variance[place] = found.values, found.coherence, found.variance
            explained[:, rows] += found.explained
            total[:, rows] += found.total
            enough[rows] |= pattern.sum() > len(columns)
            behind.append(([hit for hit, there in zip(hits, pattern, strict=True) if there], rows, columns))

    if hits_used.min() == 1:
        single = ", ".join(dof for dof, n in zip(inputs, hits_used, strict=True) if n == 1)
        message = f"one hit at {single}: coherence and variance cannot be known from it; hit at least three times"
        notices.append(Notice("single-hit", message))
    if np.isnan(values[1:]).all(axis=0).any():
        o, i = np.argwhere(np.isnan(values[1:]).all(axis=0))[0]
        message = f"some pairs stand in no recording, {outputs[o]}/{inputs[i]} among them"
        notices.append(Notice("not-measured", message, level="note"))
    if not set(inputs) & set(outputs):
        message = (
            f"no response was measured where the hammer hit ({', '.join(inputs)}); name the dofs of the channels, "
        )
        notices.append(Notice("no-driving-point", message + "as in --map hammer@tipX=force"))
    multiple = np.where(enough, divide(explained, total), np.nan)

    band = _usable_band(frequency, spectrum, line_noise, rate / length)
    measured = [FORM_OF[quantity] for quantity in _quantities(taps, outputs)]
    form = form or measured[0]
    if damping and form != "transmissibility":
        message = (
            f"an exponential window added {damping:.3g} 1/s of damping to every mode; modes are corrected for it, "
        )
        notices.append(Notice("exponential-window", message + "the curve itself cannot be"))
    if form == "transmissibility":
        notices += _gain_at_rest(frequency, values, outputs, inputs, band)
    else:
        notices += _signs(frequency, values, measured, outputs, inputs, band)
    for row, own in enumerate(measured):
        if own != form:
            values[:, row] = convert_frf(frequency, values[:, row], own, form)
            variance[:, row] = convert_frf_variance(frequency, variance[:, row], own, form)
    hits = tuple(
        Hit(
            tap.recording.name,
            i,
            (start + survey.onset) / rate + tap.recording.start_time,
            survey.peak,
            good,
            tuple(why),
        )
        for tap in taps
        for i, ((start, _), survey, good, why) in enumerate(
            zip(tap.stretches, tap.surveys, tap.accepted, tap.reasons, strict=True)
        )
    )
    return Frf(
        frequency=frequency,
        values=values,
        coherence=coherence,
        multiple_coherence=multiple,
        variance=variance,
        force_spectrum=spectrum,
        form=form,
        estimator=estimator,
        outputs=outputs,
        inputs=inputs,
        hits_used=tuple(int(n) for n in hits_used),
        usable_band=band,
        hits=hits,
        damping_shift=damping,
        tests=tuple(_hit_spectra(frequency, band, rate, inputs, outputs, measured, *test) for test in behind),
        notices=tuple(dict.fromkeys(notices)),
    )


def _hit_spectra(
    frequency: np.ndarray,
    band: tuple[float, float],
    rate: float,
    inputs: Sequence[str],
    outputs: Sequence[str],
    forms: Sequence[str],
    hits: list[tuple[Tap, int]],
    rows: list[int],
    columns: list[int],
) -> HitSpectra:
    """What a modal fit needs of the hits behind some entries, on the lines about the usable band."""
    kept = np.flatnonzero((frequency >= 0.5 * band[0]) & (frequency <= 2.0 * band[1]))
    lines = slice(kept[0], kept[-1] + 1) if len(kept) else slice(0, 0)
    where = [[list(tap.outputs).index(outputs[row]) for row in rows] for tap, _ in hits]
    sources = [[list(tap.inputs).index(inputs[j]) for j in columns] for tap, _ in hits]
    longest = max(tap.pulse[hit][1].shape[1] for tap, hit in hits)
    force = np.zeros((len(hits), len(columns), longest))
    for own, (tap, hit), source in zip(force, hits, sources, strict=True):
        pulse = tap.pulse[hit][1][source]
        own[:, : pulse.shape[1]] = pulse
    ends = [[side[at] for side in tap.ends[hit]] for (tap, hit), at in zip(hits, where, strict=True)]
    noise = [
        (tap.noise[hit][0][j], tap.noise[hit][1][o]) for (tap, hit), j, o in zip(hits, sources, where, strict=True)
    ]
    return HitSpectra(
        response=np.stack(
            [tap.spectra[hit][1][at][:, lines].astype(np.complex64) for (tap, hit), at in zip(hits, where, strict=True)]
        ),
        force=force,
        force_start=np.array([tap.pulse[hit][0] for tap, hit in hits]),
        window_stop=np.array([stop for stop, _ in ends]),
        window_fall=np.array([fall for _, fall in ends]),
        force_noise=np.sum([of_force for of_force, _ in noise], axis=0),
        response_noise=np.mean([of_response for _, of_response in noise], axis=0),
        first_line=int(lines.start),
        outputs=tuple(outputs[row] for row in rows),
        forms=tuple(forms[row] for row in rows),
        inputs=tuple(inputs[j] for j in columns),
        sample_rate=rate,
        names=tuple(f"{tap.recording.name}:{hit}" for tap, hit in hits),
    )


def _stacked(hits: list[tuple[Tap, int]], dofs: Sequence[str], part: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spectra of all hits in common rows, zero where a recording lacks a dof.   part : 0 force, 1 response

    returns spectra (hit, dof, frequency), their noise (hit, dof), and which were measured (hit, dof)
    """
    if not hits:
        return np.zeros((0, len(dofs), 1)), np.zeros((0, len(dofs))), np.zeros((0, len(dofs)), bool)
    size = hits[0][0].spectra[hits[0][1]][0].shape[-1]
    spectra = np.zeros((len(hits), len(dofs), size), complex)
    noise, measured = np.zeros((len(hits), len(dofs))), np.zeros((len(hits), len(dofs)), bool)
    for k, (tap, hit) in enumerate(hits):
        rows = [dofs.index(dof) for dof in (tap.inputs, tap.outputs)[part]]
        spectra[k, rows], noise[k, rows], measured[k, rows] = tap.spectra[hit][part], tap.noise[hit][part], True
    return spectra, noise, measured


def _complaints(group: list[Tap]) -> str:
    """The reasons against the hits of some recordings, each kind once."""
    kinds = [reason.split(":")[0] for tap in group for reasons in tap.reasons for reason in reasons]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))


def _told_apart(force: np.ndarray, where: str) -> list[Notice]:
    """Whether the hits go in directions different enough for several inputs.   force : (hit, input, frequency)"""
    strong = np.linalg.norm(force, axis=(0, 1))
    spread = condition(force[:, :, strong > 0.1 * strong.max()])
    if spread > 1e6:
        raise IllPosedError(f"{where}: all hits go in one direction; add hits in as many directions as force channels")
    if spread > 30:
        message = f"the hits hardly tell the inputs apart (condition {spread:.0f}); hit in more different directions"
        return [Notice("inputs-alike", message, where)]
    return []


def _quantities(taps: list[Tap], outputs: Sequence[str]) -> list[str]:
    """What each output measures."""
    found: dict[str, str] = {}
    for tap in taps:
        for row in tap.responses:
            channel = tap.recording.channels[row]
            if found.setdefault(channel.dof, channel.quantity) != channel.quantity:
                raise RecordingError(
                    f"{tap.recording.name}: {channel.dof} is a {channel.quantity} here and a {found[channel.dof]} "
                    "in another recording; give the two sensors different dofs"
                )
    return [found[dof] for dof in outputs]


def _usable_band(
    frequency: np.ndarray, spectrum: np.ndarray, line_noise: np.ndarray, lowest: float
) -> tuple[float, float]:
    """Band around the largest force where every input is within 20 dB of its largest and 10 dB above its noise.

    spectrum : (frequency, input) rms over the hits   line_noise : (input,) expected |noise|^2 of a line
    lowest : Hz, one over the record
    """
    power = spectrum**2
    good = ((power > 1e-2 * power.max(axis=0)) & (power > 10.0 * line_noise)).all(axis=1)
    good[frequency < 0.999 * lowest] = False
    if not good.any():
        return (0.0, 0.0)
    top = int(np.argmax(np.where(good, (power / power.max(axis=0)).min(axis=1), -1.0)))
    worse = np.flatnonzero(~good)
    low = worse[worse < top].max(initial=-1) + 1
    high = worse[worse > top].min(initial=len(good)) - 1
    return (float(frequency[low]), float(frequency[high]))


def _gain_at_rest(
    frequency: np.ndarray,
    values: np.ndarray,
    outputs: Sequence[str],
    inputs: Sequence[str],
    band: tuple[float, float],
) -> list[Notice]:
    """At rest a dynamometer reads the force that acts on it: where it does not, a sign or a calibration is wrong."""
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[0] + 0.02 * (band[1] - band[0])))
    notices = []
    for dof in inputs:
        if dof not in outputs or not len(lines):
            continue
        gain = float(np.median(values[lines, outputs.index(dof), inputs.index(dof)].real))
        if gain < 0:
            message = (
                f"the dynamometer answers against the hammer at {dof}; turn one of them with a sign before its dof"
            )
            notices.append(Notice("dynamometer-polarity", message))
        elif abs(gain - 1) > GAIN_AT_REST:
            message = f"at low frequency the dynamometer reads {gain:.2f} of the hammer's force at {dof}; "
            notices.append(Notice("gain-at-rest", message + "check both calibrations, and that the hit was straight"))
    return notices


def _signs(
    frequency: np.ndarray,
    values: np.ndarray,
    measured: Sequence[str],
    outputs: Sequence[str],
    inputs: Sequence[str],
    band: tuple[float, float],
) -> list[Notice]:
    """A driving point takes power up: the real part of its mobility cannot be negative. Where it is, something is turned."""
    inside = (frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0)
    turned, right = [], []
    for dof in dict.fromkeys(inputs):
        if dof not in outputs or not inside.any():
            continue
        row = outputs.index(dof)
        taken = convert_frf(frequency[inside], values[inside, row, inputs.index(dof)], measured[row], "mobility").real
        share = taken.sum() / max(np.abs(taken).sum(), 1e-300)
        if share < -0.5:
            turned.append(dof)
        elif share > 0.5:
            right.append(dof)
    if not turned:
        return []
    if not right:
        message = f"the response at {', '.join(turned)} moves against the hammer: accelerometer polarity or hammer sign; " \
            "turn the channel with a sign in front of its dof"  # fmt: skip
        return [Notice("accelerometer-polarity", message)]
    message = f"the response at {', '.join(turned)} moves against the hammer, elsewhere it does not; check that sensor"
    return [Notice("driving-point-sign", message)]
