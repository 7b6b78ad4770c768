"""What of a recording is judged: which channels, and the stretch in which the tool cuts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.revolutions import Samples, Survey, longest, stretches, survey_record

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
HARMONICS, ORDERS = 2, 4  # of the teeth, and of the spindle if these are more, that tell the cut from the air
FRAME = 8  # turns of one spectrum
PARTED = 2.5  # times as strong they are in the cut, in the mean of either
WEAK = 0.4  # of the usual strength: at an end of the cut that is air
FOLLOWS = 0.3  # share of the power in them, from which it is no air
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
    cut = _of_the_cut(strength, *_of_the_teeth(reader(recording, rows), survey, cycle, teeth))
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
        first, last = _without_quiet_ends(strength, *found)
        trim = max(FRAME // 2 + 2, (last - first) // 20)  # ramps, and what rings when the tool enters or leaves
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


def _of_the_teeth(read: spectra.Reader, survey: Survey, cycle: float, teeth: int) -> tuple[np.ndarray, np.ndarray]:
    """Turn by turn, rms of the lowest harmonics of the teeth, and what share of the power that is; both (revolution,).

    From spectra of some turns under a window: a tone beside the harmonics must not pass for one.
    """
    turns = len(survey.strength)
    size = round(FRAME / cycle)
    if turns < 2 * FRAME:
        return survey.strength, np.ones(turns)
    window = np.hanning(size + 1)[:-1]
    starts = np.arange(0, int(survey.edges[-1]) - size + 1, size // 2)
    order = teeth * np.arange(1, max(HARMONICS, ORDERS // teeth) + 1)
    order = order[order * cycle < 0.45]
    power, share = np.zeros(len(starts)), np.zeros(len(starts))
    for i, start in enumerate(starts):
        y = read(start, start + size)
        spectrum = np.abs(np.fft.rfft((y - y.mean(axis=1, keepdims=True)) * window)) ** 2
        for p in order:
            middle, reach = p * cycle * size, max(1.0, 0.012 * p * cycle * size)
            low, high = int(np.floor(middle - reach)), int(np.ceil(middle + reach)) + 1
            power[i] += spectrum[:, low:high].max(axis=1).sum() * 3.0  # all of the line, by its highest
        share[i] = power[i] / max(2 * float(spectrum[:, 1:].sum()), 1e-300)
    at = (starts + size / 2) * cycle - 0.5
    turn = np.arange(turns)
    return np.interp(turn, at, np.sqrt(power)), np.interp(turn, at, share)


def _of_the_cut(strength: np.ndarray, of_teeth: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Revolutions of the cut: all, unless some are far weaker in the harmonics of the teeth, evenly so, and hold little else of
    them.   returns bool (revolution,)
    """
    usable = np.isfinite(strength) & (strength > 0) & np.isfinite(of_teeth) & (of_teeth > 0)
    log = np.sort(np.log(of_teeth[usable]))
    n = len(log)
    if n < 6:
        return usable
    count = np.arange(1, n)
    low = np.cumsum(log)[:-1] / count
    high = (log.sum() - np.cumsum(log)[:-1]) / (n - count)
    at = int(np.argmax(count * (n - count) * (high - low) ** 2))
    weak = usable & (np.log(np.where(usable, of_teeth, 1.0)) <= (low[at] + high[at]) / 2)
    if high[at] - low[at] < np.log(PARTED) or np.median(share[weak]) > FOLLOWS:
        return usable
    return usable & ~weak


def _without_quiet_ends(strength: np.ndarray, first: int, last: int) -> Samples:
    """Revolutions first..last without those at either end that are much weaker: air too short for a spectrum of it."""
    quiet = ~(strength[first:last] > WEAK * np.nanmedian(strength[first:last]))
    loud = np.flatnonzero(~quiet)
    ahead, behind = int(loud[0]), int(len(quiet) - 1 - loud[-1])
    return first + min(ahead, FRAME), last - min(behind, FRAME)


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
