"""What of a recording is judged: which channels, and the stretch in which the tool cuts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import Samples, Survey, longest, stretches, survey_record

Note = Callable[..., None]  # takes code, sentence and level of a notice

QUANTITIES = (
    "displacement",
    "acceleration",
    "velocity",
    "sound_pressure",
    "force",
)  # the first that is there is judged
PATH = "path"  # dof of a channel that says where the tool is on its path
MOST_SAMPLES = 1 << 22  # of a channel, that are judged
PARTED = 2.0  # times as strong is the cut as the air, in the mean of either
EVEN = 0.25  # of log strength: as even is the air
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
    recording: Recording, rows: list[int], cycle: float, steady: tuple[float, float] | None, where: str, note: Note
) -> Stretch:
    """The stretch that is stated, else the longest that is stronger than the air, without its ends.

    Chatter grows, so a cut need not be steady: only what is even and far weaker is air.   cycle : turns per sample
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
    cut = _stronger_than_air(strength)
    found = longest(stretches(cut, bridge=BRIDGE))
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
        first, last = found
        trim = max(2, (last - first) // 30)  # ramps
        first += trim if first > 0 and last - first > 4 * trim else 0
        last -= trim if last < len(strength) and last - first > 4 * trim else 0
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


def _stronger_than_air(strength: np.ndarray) -> np.ndarray:
    """Revolutions of the cut: all where nothing is far weaker and even.   returns bool (revolution,)"""
    usable = np.isfinite(strength) & (strength > 0)
    log = np.sort(np.log(strength[usable]))
    n = len(log)
    if n < 6:
        return usable
    count = np.arange(1, n)
    low = np.cumsum(log)[:-1] / count
    high = (log.sum() - np.cumsum(log)[:-1]) / (n - count)
    at = int(np.argmax(count * (n - count) * (high - low) ** 2))
    quiet = log[: at + 1]
    apart = high[at] - low[at]
    spread = float(np.subtract(*np.quantile(quiet, [0.75, 0.25])))
    if apart < np.log(PARTED) or spread > EVEN:
        return usable
    return usable & (np.log(np.where(usable, strength, 1.0)) > (low[at] + high[at]) / 2)


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
