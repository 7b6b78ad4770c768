"""What of a recording is judged: which channels, and the stretch in which the tool cuts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import Samples, Survey, longest, stretches, survey_record
from millcal.stages.judge.air import turns_of_the_cut

Note = Callable[..., None]  # takes code, sentence and level of a notice

QUANTITIES = (
    "displacement",
    "acceleration",
    "velocity",
    "sound_pressure",
    "sound",
    "force",
)  # the first that is there is judged
PATH = "path"  # dof of a channel that says where the tool is on its path
MOST_SAMPLES = 1 << 22  # of a channel, that are judged
FRAME, SHORTEST_FRAME = 8, 2  # turns of one spectrum
FRAMES = 6  # that a short record should hold
LARGEST_TRIM = 8  # of the cut, at either end: one part in so many
WEAK = 0.4  # of the usual strength: at an end of the cut that is air
BRIDGE = 3  # revolutions
FEWEST = 3  # revolutions
STILL = 4  # samples in a row at the same extreme value


def judged_rows(recording: Recording, channel: str | None, where: str) -> list[int]:
    """The channels that are judged: the one that is named, else all of the first quantity that tells."""
    channels = recording.channels
    have = ", ".join(f"{c.name} ({c.quantity})" for c in channels) or "no channels"
    if channel is not None:
        named = [row for row, c in enumerate(channels) if c.name == channel]
        if not named:
            raise RecordingError(f"{where}: there is no channel {channel!r}; it has {have}")
        if channels[named[0]].quantity not in QUANTITIES:
            raise RecordingError(
                f"{where}: channel {channel!r} is a {channels[named[0]].quantity}, by which no cut is judged; name a channel "
                f"of {', '.join(QUANTITIES)}"
            )
        return named
    for quantity in QUANTITIES:
        rows = [row for row in recording.rows_of(quantity) if channels[row].dof.lstrip("+-") != PATH]
        if rows:
            return rows
    raise RecordingError(f"{where}: no channel of {', '.join(QUANTITIES)}; it has {have}")


def reader(recording: Recording, rows: list[int]) -> Callable[[int, int], np.ndarray]:
    """A reader of some channels."""
    return lambda start, stop: np.asarray(recording.block(start, stop, rows), float)


class Stretch(NamedTuple):
    """Where the tool cuts, where it is in the air, and the envelope of all."""

    start: int  # sample
    stop: int
    air: Samples | None  # the longest quiet stretch beside it
    survey: Survey


def cutting_stretch(
    recording: Recording,
    rows: list[int],
    cycle: float,
    teeth: int,
    steady: tuple[float, float] | None,
    where: str,
    note: Note,
) -> Stretch:
    """The stretch that is stated, else the longest in which the teeth are heard, without its ends.

    Chatter grows and the machine hums, so loud and quiet tell little: where the harmonics of the teeth are far weaker is air.

    cycle : turns per sample
    """
    length, rate = recording.samples.shape[1], recording.sample_rate
    survey = survey_record(reader(recording, rows), length, 1 / cycle)
    strength = survey.strength
    if np.isfinite(strength).sum() < FEWEST:
        raise RecordingError(
            f"{where}: holds {len(strength)} whole revolutions at the stated speed, at least {FEWEST} are needed; check the "
            "spindle speed and the sample rate"
        )
    if not np.nanmax(strength) > 0:
        raise RecordingError(f"{where}: the signal never changes; check the channel")
    frame = int(np.clip(len(strength) // FRAMES, SHORTEST_FRAME, FRAME))
    cut = turns_of_the_cut(reader(recording, rows), survey, cycle, teeth, frame)
    found = longest(stretches(cut, bridge=max(BRIDGE, frame)))
    air = _air(strength, cut, survey)
    steady = steady if steady is not None else recording.steady
    if steady is not None:
        start, stop = round(steady[0] * rate), round(steady[1] * rate)
        if not 0 <= start < stop <= length + 1:
            raise RecordingError(
                f"{where}: steady_s = [{steady[0]:g}, {steady[1]:g}] does not lie within the record of {length / rate:g} s; "
                "give times after its first sample"
            )
        stop = min(stop, length)
    else:
        first, last = _without_quiet_ends(strength, *found, frame)
        trim = max(frame // 2 + 2, (last - first) // 20)  # ramps, and what rings when the tool enters or leaves
        trim = min(trim, (last - first) // LARGEST_TRIM)
        first, last = first + (trim if first > 0 else 0), last - (trim if last < len(strength) else 0)
        start = int(survey.edges[first])
        stop = int(survey.edges[last]) if last < len(strength) else length
    if stop - start > MOST_SAMPLES:
        note(
            "long-record",
            f"only the last {MOST_SAMPLES / rate:.4g} s of the cut are judged; state steady_s for others",
            "note",
        )
        start = stop - MOST_SAMPLES
    if (stop - start) * cycle < FEWEST:
        raise RecordingError(
            f"{where}: the cut holds {(stop - start) * cycle:.2g} revolutions, at least {FEWEST} are needed; check the spindle "
            "speed, the sample rate and steady_s"
        )
    return Stretch(start, stop, air, survey)


def _without_quiet_ends(strength: np.ndarray, first: int, last: int, most: int) -> Samples:
    """Revolutions first..last without those at either end that are much weaker: air too short for a spectrum of it."""
    quiet = ~(strength[first:last] > WEAK * np.nanmedian(strength[first:last]))
    loud = np.flatnonzero(~quiet)
    ahead, behind = int(loud[0]), int(len(quiet) - 1 - loud[-1])
    return first + min(ahead, most), last - min(behind, most)


def _air(strength: np.ndarray, cut: np.ndarray, survey: Survey) -> Samples | None:
    quiet = stretches(np.isfinite(strength) & ~cut)
    if not quiet:
        return None
    first, last = longest(quiet)
    if last - first < 6:
        return None
    return int(survey.edges[first + 1]), int(survey.edges[last - 1])


def note_clipping(samples: np.ndarray, full_scale: float | None, name: str, note: Note) -> None:
    """Say where samples stand at the limit of the input, or stand still at their extremes.   samples : (sample,)"""
    reaching = int(np.sum(np.abs(samples) >= 0.999 * full_scale)) if full_scale else 0
    still = 0
    for extreme in (samples.max(), samples.min()):
        run = np.convolve(samples == extreme, np.ones(STILL), "valid")
        still += int(np.sum(run > STILL - 0.5))
    if reaching:
        note(
            "clipped",
            f"{name} reaches its input range at {reaching} samples of the cut; lines of its clipping are no chatter",
        )
    elif still >= 3:
        note("clipped", f"{name} stands still at its extreme value at {still} samples: the input may have clipped")


def refuse_what_is_no_number(samples: np.ndarray, start: int, rate: float, where: str, name: str) -> None:
    """Every sample of the cut must be a number."""
    bad = np.flatnonzero(~np.isfinite(samples))
    if len(bad):
        raise RecordingError(
            f"{where}: {name} is not a number at {(start + bad[0]) / rate:g} s, within the cut; give steady_s without it"
        )
