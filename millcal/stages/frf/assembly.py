"""The matrix from the sums of all recordings: which belong together, what is known of each entry, what the user is told."""

from collections.abc import Sequence

import numpy as np

from millcal.data import Frf, Hit, HitSpectra, Notice
from millcal.errors import IllPosedError, RecordingError
from millcal.numerics.frequency_response import condition, divide, estimate, joined
from millcal.physics.structure import convert_frf, convert_frf_variance
from millcal.stages.frf.checks import gain_at_rest, lateness, signs
from millcal.stages.frf.taps import FORM_OF, Tap


def assemble(taps: list[Tap], points: int, rate: float, estimator: str, form: str | None, damping: float) -> Frf:
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
    behind: list[tuple[list[Tap], list[int], list[int]]] = []  # recordings, rows and columns of the tests

    for group in _groups(taps):
        columns = [j for j, dof in enumerate(inputs) if any(dof in tap.inputs for tap in group)]
        given = [inputs[j] for j in columns]
        where = group[0].recording.name
        active = [tap for tap in group if tap.used()]
        if not active or set(given) - {dof for tap in active for dof in tap.inputs}:
            raise IllPosedError(
                f"{where}: no hit is good enough: {_complaints(group)}; hit again, or overrule with keep"
            )
        places = {id(tap): [given.index(dof) for dof in tap.inputs] for tap in active}
        forces = joined([(tap.sums, places[id(tap)], []) for tap in active], len(columns))
        for c, j in enumerate(columns):
            hits_used[j] = sum(tap.sums.hits for tap in active if inputs[j] in tap.inputs)
            spectrum[:, j] = np.sqrt(np.maximum(forces.Sff[c, c].real, 0.0) / hits_used[j]) / rate
            line_noise[j] = forces.force_noise[c] / hits_used[j] / rate**2
        if len(columns) > 1:
            _enough(forces.hits, len(columns), where)
            notices += _told_apart(forces.Sff, where)
        patterns = {o: tuple(k for k, tap in enumerate(active) if dof in tap.outputs) for o, dof in enumerate(outputs)}
        for pattern in dict.fromkeys(own for own in patterns.values() if own):
            rows = [row for row, own in patterns.items() if own == pattern]
            here = [active[k] for k in pattern]
            sums = joined(
                [(tap.sums, places[id(tap)], [tap.outputs.index(outputs[row]) for row in rows]) for tap in here],
                len(columns),
            )
            _enough(sums.hits, len(columns), where)
            found = estimate(sums, estimator=estimator)
            place = np.ix_(range(len(frequency)), rows, columns)
            values[place], coherence[place], variance[place] = found.values, found.coherence, found.variance
            explained[:, rows] += found.explained
            total[:, rows] += found.total
            enough[rows] |= sums.hits > len(columns)
            behind.append((here, rows, columns))

    notices += _told_of_hits(taps, inputs, outputs, hits_used, values)
    multiple = np.where(enough, divide(explained, total), np.nan)
    band = _usable_band(frequency, spectrum, line_noise, rate / max(tap.length for tap in taps))
    measured = [FORM_OF[quantity] for quantity in _quantities(taps, outputs)]
    form = form or measured[0]
    if damping and form != "transmissibility":
        message = (
            f"an exponential window added {damping:.3g} 1/s of damping to every mode; modes are corrected for it, "
        )
        notices.append(Notice("exponential-window", message + "the curve itself cannot be"))
    if form == "transmissibility":
        notices += gain_at_rest(frequency, values, outputs, inputs, band)
    else:
        turned = signs(frequency, values, measured, outputs, inputs, band)
        notices += turned or lateness(frequency, values, variance, measured, outputs, inputs, band)
    tests = tuple(_hit_spectra(frequency, band, rate, inputs, outputs, measured, *test) for test in behind)
    for row, own in enumerate(measured):
        if own != form:
            values[:, row] = convert_frf(frequency, values[:, row], own, form)
            variance[:, row] = convert_frf_variance(frequency, variance[:, row], own, form)
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
        hits=tuple(hit for tap in taps for hit in _hits_of(tap)),
        damping_shift=damping,
        tests=tests,
        notices=tuple(dict.fromkeys(notices)),
    )


def _hits_of(tap: Tap) -> list[Hit]:
    """The table of the hits of one recording."""
    rate, late = tap.recording.sample_rate, tap.recording.start_time
    return [
        Hit(
            tap.recording.name,
            i,
            (start + survey.onset) / rate + late,
            survey.peak,
            tap.accepted[i],
            tuple(tap.reasons[i]),
            tuple(tap.remarks[i]),
        )
        for i, ((start, _), survey) in enumerate(zip(tap.stretches, tap.surveys, strict=True))
    ]


def _told_of_hits(
    taps: list[Tap], inputs: Sequence[str], outputs: Sequence[str], hits_used: np.ndarray, values: np.ndarray
) -> list[Notice]:
    """What too few hits, or none, leave unknown."""
    notices = []
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
    for tap in taps:
        moved = [hit for hit in tap.late if tap.accepted[hit]]
        if moved:
            message = f"the response of {len(moved)} of the hits was late or early beside the others, and moved back; "
            notices.append(Notice("skew", message + "check the trigger", tap.recording.name))
    return notices


def _hit_spectra(
    frequency: np.ndarray,
    band: tuple[float, float],
    rate: float,
    inputs: Sequence[str],
    outputs: Sequence[str],
    forms: Sequence[str],
    taps: list[Tap],
    rows: list[int],
    columns: list[int],
) -> HitSpectra:
    """What a modal fit needs of the hits behind some entries, on the lines about the usable band."""
    hits = [(tap, hit) for tap in taps for hit in tap.used()]
    top = min(tap.thin[hit][0].shape[1] for tap, hit in hits)
    kept = np.flatnonzero((frequency[:top] >= 0.5 * band[0]) & (frequency[:top] <= 2.0 * band[1]))
    lines = slice(int(kept[0]), int(kept[-1]) + 1) if len(kept) else slice(0, 0)
    m, o = len(columns), len(rows)
    response = np.zeros((len(hits), o, lines.stop - lines.start), np.complex64)
    force = np.zeros((len(hits), m, max(tap.pulse[hit][1].shape[1] for tap, hit in hits)))
    stop, fall = np.zeros((len(hits), o)), np.zeros((len(hits), o))
    force_noise, response_noise = np.zeros((len(hits), m)), np.zeros((len(hits), o))
    for k, (tap, hit) in enumerate(hits):
        at = [tap.outputs.index(outputs[row]) for row in rows]
        mine = [c for c, j in enumerate(columns) if inputs[j] in tap.inputs]
        source = [tap.inputs.index(inputs[columns[c]]) for c in mine]
        response[k] = tap.thin[hit][1][at, lines]
        pulse = tap.pulse[hit][1][source]
        force[k, mine, : pulse.shape[1]] = pulse
        stop[k], fall[k] = (edge[at] for edge in tap.ends[hit])
        force_noise[k, mine], response_noise[k] = tap.noise[hit][0][source], tap.noise[hit][1][at]
    return HitSpectra(
        response=response,
        force=force,
        force_start=np.array([tap.pulse[hit][0] for tap, hit in hits]),
        window_stop=stop,
        window_fall=fall,
        force_noise=force_noise.sum(axis=0),
        response_noise=response_noise.mean(axis=0),
        first_line=lines.start,
        outputs=tuple(outputs[row] for row in rows),
        forms=tuple(forms[row] for row in rows),
        inputs=tuple(inputs[j] for j in columns),
        sample_rate=rate,
        names=tuple(f"{tap.recording.name}:{hit}" for tap, hit in hits),
    )


def _groups(taps: list[Tap]) -> list[list[Tap]]:
    """Recordings that share an input, directly or through others, belong to one least-squares problem."""
    groups: list[list[Tap]] = []
    for tap in taps:
        touched = [group for group in groups if any(set(tap.inputs) & set(other.inputs) for other in group)]
        groups = [group for group in groups if group not in touched] + [[t for group in touched for t in group] + [tap]]
    return groups


def _complaints(group: list[Tap]) -> str:
    """The reasons against the hits of some recordings, each kind once."""
    kinds = [reason.split(":")[0] for tap in group for reasons in tap.reasons for reason in reasons]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))


def _enough(hits: int, inputs: int, where: str) -> None:
    if hits < inputs:
        raise IllPosedError(f"{where}: {hits} usable hits for {inputs} force channels; hit more often")


def _told_apart(Sff: np.ndarray, where: str) -> list[Notice]:
    """Whether the hits go in directions different enough for several inputs.   Sff : (input, input, frequency)"""
    strong = np.sqrt(np.einsum("jjf->f", Sff).real)
    spread = condition(Sff[:, :, strong > 0.1 * strong.max()])
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
