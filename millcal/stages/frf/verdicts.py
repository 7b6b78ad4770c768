"""Which hits may be used, and why not the others.

Each hit gets its reasons against it, in words that begin with a kind: overload, gap, drop-out, stuck, weak, double, cut,
unsettled, drift, late, skew, inconsistent, dropped. A hit without a reason is used. What was mended, or does no harm,
is a remark.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.numerics.impact_faults import late_bumps
from millcal.numerics.impact_windows import FALL, decay_lengths, stacked_power
from millcal.stages.frf.taps import SHORTEST, Tap

BENT = 0.005  # of the largest value, by which a channel may leave its rest without a line
STEEP = 0.2  # of the largest value, by which a channel may drift along a line
CREST = 0.04  # by which the crest of a pulse may fall short of the others'


def judge(tap: Tap, weak: float, allow_double: bool, kept: set, dropped: set) -> None:
    """Give each hit its reasons against it, plan the windows, and accept the hits without a reason."""
    rate = tap.recording.sample_rate
    median_peak = float(np.median([survey.peak for survey in tap.surveys]))
    usual = np.median([survey.response_noise for survey in tap.surveys], axis=0)
    for survey, reasons in zip(tap.surveys, tap.reasons, strict=True):
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
    _judge_pulse_shapes(tap)
    _judge_rest(tap)
    sound = [hit for hit, reasons in enumerate(tap.reasons) if not _against(reasons, allow_double)]
    whole = [hit for hit in sound if not tap.losses[hit]]
    bumps = _late_bumps(tap, whole or sound)
    quiet = [hit for hit in whole if hit not in bumps]
    _plan_windows(tap, quiet or whole or sound or list(range(len(tap.surveys))))
    _judge_losses(tap)
    _judge_late_bumps(tap, bumps)
    for hit, reasons in enumerate(tap.reasons):
        against = _against(reasons, allow_double)
        me = (id(tap), hit)
        if me in dropped:
            reasons.append("dropped: by request")
        tap.accepted.append(me not in dropped and (me in kept or not against))
    _tell_of_windows(tap)


def _against(reasons: list[str], allow_double: bool) -> list[str]:
    return [reason for reason in reasons if not (allow_double and reason.startswith("double"))]


def _judge_pulse_shapes(tap: Tap) -> None:
    """Where no input range is known, a pulse that was cut off is flatter than the others, and among the largest."""
    channels = [tap.recording.channels[row] for row in tap.forces]
    sound = [hit for hit, survey in enumerate(tap.surveys) if survey.second is None and not tap.reasons[hit]]
    if len(sound) < 3 or all(channel.full_scale is not None for channel in channels):
        return
    crest = np.array([tap.surveys[hit].crest for hit in sound])
    peak = np.array([tap.surveys[hit].peak for hit in sound])
    usual = float(np.median(crest))
    scatter = 1.4826 * float(np.median(np.abs(crest - usual)))
    for hit, own, size in zip(sound, crest, peak, strict=True):
        if usual - own > max(CREST * usual, 5.0 * scatter) and size >= np.median(peak):
            flat = 100.0 * (1.0 - own / usual)
            tap.reasons[hit].append(
                f"overload: {tap.names(tap.forces)} by its shape, {flat:.0f} % flatter than the other pulses"
            )


def _judge_rest(tap: Tap) -> None:
    """Channels that drift: along a line it comes off; else, unless every hit does so, the hit is left out."""
    for part, rows in (("force_rest", tap.forces), ("response_rest", tap.responses)):
        sizes = np.array(
            [np.abs(s.direction) * s.peak if part == "force_rest" else s.response_peak for s in tap.surveys]
        )
        sizes = np.maximum(sizes, 1e-300 + 0.1 * sizes.max(axis=1, keepdims=True)) if part == "force_rest" else sizes
        sizes = np.maximum(sizes, 1e-300)
        bend = np.array([getattr(survey, part).bend for survey in tap.surveys]) / sizes
        change = np.array([getattr(survey, part).change for survey in tap.surveys]) / sizes
        common = 3.0 * np.median(bend, axis=0) if len(bend) >= 3 else np.full(bend.shape[1], np.inf)
        for hit, reasons in enumerate(tap.reasons):
            for i, row in enumerate(rows):
                name = tap.recording.channels[row].name
                if bend[hit, i] > max(BENT, common[i]):
                    reasons.append(
                        f"drift: {name} leaves its rest by {100 * bend[hit, i]:.0f} % of its largest, on no line"
                    )
                elif bend[hit, i] > BENT and len(bend) < 3:
                    tap.remarks[hit].append(f"{name} leaves its rest by {100 * bend[hit, i]:.0f} % of its largest")
                elif abs(change[hit, i]) > STEEP:
                    reasons.append(f"drift: {name} by {100 * change[hit, i]:.0f} % of its largest over the record")
                elif abs(change[hit, i]) > 0:
                    tap.remarks[hit].append(f"drift of {name} taken off, {100 * change[hit, i]:.2g} % of its largest")


def _judge_losses(tap: Tap) -> None:
    """Samples lost within the windows cost the hit; elsewhere nothing was lost."""
    rate = tap.recording.sample_rate
    late = np.rint(tap.delays * rate)
    for survey, losses, reasons, remarks in zip(tap.surveys, tap.losses, tap.reasons, tap.remarks, strict=True):
        length = survey.stop - survey.onset
        for loss in losses:
            start, stop = survey.first - 2 * length - 32, survey.last + 2 * length + 32
            if loss.output is not None:
                start, stop = (
                    start + late[loss.output],
                    survey.onset + late[loss.output] + (1 + FALL) * tap.decay[loss.output],
                )
            lasts, after = 1e3 * (loss.stop - loss.start) / rate, 1e3 * (loss.start - survey.onset) / rate
            where = f"{loss.channel} for {lasts:.2g} ms, {after:.1f} ms after the hit"
            if loss.stop > start and loss.start < stop:
                reasons.append(f"{loss.kind}: {where}")
            else:
                remarks.append(f"{loss.kind} of {where}, outside of its window")


def _late_bumps(tap: Tap, hits: list[int]) -> dict[int, tuple[int, float]]:
    """Where the response of hits rises with no force: hit -> block after the onset, share of the largest."""
    if not hits:
        return {}
    surveys = [tap.surveys[hit] for hit in hits]
    begin = max(-(-(s.last - s.onset + 16 + s.stop - s.onset) // tap.block) for s in surveys) + 1
    data = (
        stacked_power(surveys),
        np.array([s.peak for s in surveys]),
        np.array([s.response_noise for s in surveys]),
    )
    if len(tap.forces) == 1:
        found = late_bumps(*data, begin)
    else:  # hits in different directions have different decays
        found = [late_bumps(*(part[k : k + 1] for part in data), begin)[0] for k in range(len(hits))]
    return {hit: bump for hit, bump in zip(hits, found, strict=True) if bump is not None}


def _judge_late_bumps(tap: Tap, bumps: dict[int, tuple[int, float]]) -> None:
    """A response that rises with no force costs the hit while its window is open."""
    rate, end = tap.recording.sample_rate, (1 + FALL) * float(tap.decay.max())
    for hit, (block, share) in bumps.items():
        after = block * tap.block
        what = f"{1e3 * after / rate:.0f} ms after the hit, to {100 * share:.2g} % of its largest"
        if after < end:
            tap.reasons[hit].append(f"late: the response rises again {what}, without force")
        else:
            tap.remarks[hit].append(f"the response rises again {what}, after its window")


def _plan_windows(tap: Tap, hits: list[int]) -> None:
    """The length of the response windows, common to the hits of a recording, and of the record if that is open."""
    tap.decay = decay_lengths([tap.surveys[hit] for hit in hits], tap.block)
    if not tap.length:
        room = int(np.median([stop - start for start, stop in tap.stretches]))
        needed = 2.0 * float(tap.decay.max()) + tap.before
        tap.length = max(SHORTEST, int(min(room, needed)))


def _tell_of_windows(tap: Tap) -> None:
    """Channels that do not move, and records that end too early."""
    recording = tap.recording
    used = [tap.surveys[hit] for hit in tap.used()] or tap.surveys
    for i, row in enumerate(tap.responses):
        if not any(survey.response_peak[i] for survey in used):
            name = recording.channels[row].name
            message = f"{name} does not move in any hit; check its cable"
            tap.notices.append(Notice("dead-channel", message, recording.name))
    left = [_left_over(survey, (tap.length - tap.before) // tap.block) for survey in used]
    if max(left) > 0.01:
        message = f"the response is still {100 * max(left):.0f} % of its largest where the record of {sum(v > 0.01 for v in left)} "
        message += (
            "of the hits ends: resonances come out too low and too wide; record longer, space the hits further apart"
        )
        tap.notices.append(Notice("truncated", message, recording.name))


def _left_over(survey, blocks: int) -> float:
    """Amplitude left at the end of the record, above the noise, as a share of the largest: median over the outputs."""
    power = survey.power[:, : max(blocks, 0)]
    if not power.shape[1]:
        return 1.0
    last = power[:, -3:].mean(axis=1) - 2.0 * survey.response_noise**2
    return float(np.median(np.sqrt(np.maximum(last, 0.0) / np.maximum(power.max(axis=1), 1e-300))))


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
