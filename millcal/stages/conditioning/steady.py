"""Where in the record the tool cuts steadily, and where it is in the air."""

from collections.abc import Sequence

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import (
    Samples,
    Survey,
    block_size,
    densest_half,
    longest,
    stretches,
)
from millcal.stages.conditioning.forces import Note, Span

AIR_REVOLUTIONS = 5  # fewer do not carry an offset
EVEN = 0.003  # of the level: strengths this near to it are the same


def steady_samples(
    recording: Recording,
    rows: list[int],
    steady: Span | None,
    survey: Survey,
    where: str,
    note: Note,
    signal: str = "force",
) -> Samples:
    """The steady cut: as stated, else the longest stretch of revolutions at the level of the cut.

    rows : the channels that were surveyed   signal : what one of them is, for messages
    """
    found = stated_samples(recording, steady, where) or samples_of(
        recording, survey, *_steady_revolutions(survey, where, note, signal)
    )
    refuse_what_is_no_number(recording, rows, *found, where, signal)
    return found


def stated_samples(recording: Recording, steady: Span | None, where: str) -> Samples | None:
    """The cut as the call or the recording states it, None where neither does."""
    n, rate = recording.samples.shape[1], recording.sample_rate
    steady = steady if steady is not None else recording.steady
    if steady is None:
        return None
    start, stop = round(steady[0] * rate), round(steady[1] * rate)
    if not 0 <= start < stop <= n + 1:
        raise RecordingError(
            f"{where}: steady_s = [{steady[0]:g}, {steady[1]:g}] does not lie within the record of {n / rate:g} s; "
            "give times after its first sample"
        )
    return start, min(stop, n)


def samples_of(recording: Recording, survey: Survey, first: int, last: int) -> Samples:
    """The samples of revolutions first..last, to the end of the record where the last is the record's."""
    stop = int(survey.edges[last]) if last < len(survey.strength) else recording.samples.shape[1]
    return int(survey.edges[first]), stop


def _steady_revolutions(survey: Survey, where: str, note: Note, signal: str) -> Samples:
    """Revolutions of the steady cut.

    The level of the cut is the densest half of what exceeds half of the strongest, found a second time without ramps and
    air. A long ramp still has a flat foot inside the band about that level: about as many revolutions as it takes from nine
    tenths of the level to the band are left out beside it.
    """
    strength = survey.strength
    usable = np.isfinite(strength)
    if usable.sum() < 2:
        raise RecordingError(
            f"{where}: holds {len(strength)} whole revolutions at the stated speed, {int(usable.sum())} of them all numbers; "
            "a cut needs at least 2, check the spindle speed and the sample rate"
        )
    inside = usable & (strength > 0.5 * np.quantile(strength[usable], 0.95))
    if not inside.any():
        raise RecordingError(f"{where}: the {signal}s never change; check the channels named in the map")
    even = max(
        EVEN, 10.0 / float(np.diff(survey.edges).mean()) ** 2
    )  # what few samples in a revolution leave to chance
    for spreads in (4.0, 5.0):
        level, spread = densest_half(strength[inside])
        near = usable & (np.abs(strength - level) <= max(spreads * spread, even * level))
        runs = stretches(near, bridge=3)
        first, last = longest(runs)
        inside = np.zeros_like(usable)
        inside[first:last] = usable[first:last]
    if any(low != first and high - low > 0.5 * (last - first) for low, high in runs):
        note("several-cuts", "several stretches look like a steady cut; the longest is used, give steady_s for another")
    weak = np.flatnonzero(~(strength >= 0.9 * level))
    before, after = weak[weak < first], weak[weak >= last]
    foot = max(first - before[-1] - 2, 0) if len(before) else 0
    heel = max(after[0] - last - 1, 0) if len(after) else 0
    if last - first > 4 * (foot + heel):
        first, last = first + int(foot), last - int(heel)
    return first, last


def all_numbers_around(survey: Survey, steady: Samples) -> Samples:
    """The samples about the steady cut, by whole revolutions, that are all numbers: room for a filter to run in."""
    gaps = np.flatnonzero(~np.isfinite(survey.strength))
    before, after = survey.edges[gaps + 1], survey.edges[gaps]
    first = max(before[before <= steady[0]], default=0)
    last = min(after[after >= steady[1]], default=max(survey.edges[-1], steady[1]))
    return min(int(first), steady[0]), int(last)


def refuse_what_is_no_number(
    recording: Recording, rows: list[int], start: int, stop: int, where: str, signal: str = "force"
) -> None:
    """Every sample of the cut must be a number; the first that is none is told by its channel and time."""
    size = block_size(stop - start, len(rows))
    for at in range(start, stop, size):
        block = np.asarray(recording.block(at, min(at + size, stop), rows))
        bad = np.flatnonzero(~np.isfinite(block).all(axis=0))
        if len(bad):
            name = recording.channels[rows[int(np.argmin(np.isfinite(block[:, bad[0]])))]].name
            raise RecordingError(
                f"{where}: a {signal} is not a number at {(at + bad[0]) / recording.sample_rate:g} s, within the steady cut "
                f"({name}); give steady_s without it"
            )


def air_samples(
    recording: Recording,
    air: Sequence[Span] | None,
    survey: Survey,
    steady: Samples,
    where: str,
    limit: float | None = None,
) -> list[Samples]:
    """Air cuts: as stated, else the quiet revolutions before and after the cut, less the one beside it.

    limit : N, strength below which a revolution may be quiet; None: a quarter of the cut's
    """
    n, rate = recording.samples.shape[1], recording.sample_rate
    air = air if air is not None else recording.air
    if air is not None:
        spans = [(max(round(low * rate), 0), min(round(high * rate), n)) for low, high in air]
        for (low, high), (start, stop) in zip(air, spans, strict=True):
            if stop <= start:
                raise RecordingError(
                    f"{where}: air_s = [{low:g}, {high:g}] does not lie within the record of {n / rate:g} s; "
                    "give times after its first sample"
                )
        return spans
    edges, strength = survey.edges, survey.strength
    cutting = strength[(edges[:-1] >= steady[0]) & (edges[1:] <= steady[1]) & np.isfinite(strength)]
    if not len(cutting):
        return []
    limit = 0.25 * float(np.median(cutting)) if limit is None else limit
    found = []
    for side, trim in ((edges[1:] <= steady[0], (0, 1)), (edges[:-1] >= steady[1], (1, 0))):
        quiet = strength[side & (np.nan_to_num(strength, nan=np.inf) < limit)]
        if len(quiet) <= AIR_REVOLUTIONS:
            continue
        floor, spread = densest_half(quiet)
        still = floor + max(5 * spread, 0.002 * float(np.median(cutting)))
        first, last = longest(stretches(side & (np.nan_to_num(strength, nan=np.inf) <= still), bridge=1))
        if last - first > AIR_REVOLUTIONS:  # the revolution beside the ramp may hold its beginning
            found.append((int(edges[first + trim[0]]), int(edges[last - trim[1]])))
    return found
