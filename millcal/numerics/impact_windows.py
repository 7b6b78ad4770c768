"""Windows of a hit: the pulse and the decay are kept, what is noise alone is dropped.

That divides the noise power in the force spectrum by (record / pulse) and in the response by (record / decay). Nothing is
scaled: windows that are 1 where the signal is leave X(f)/F(f) as it is, whereas an exponential window would add damping,
and force and response keep one origin. What the channels rest on comes off before a window goes on, or the window's own
spectrum comes in.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from millcal.numerics.impact_hits import Survey, moving_mean

QUIET = 1e-5  # noise below this share of the peak is rounding: windows would only remove signal
FALL = 0.15  # cosine end of the response window, as a share of its length
CUT = 0.05  # the same where the record is cut by the next hit


class Gated(NamedTuple):
    """A hit with its rest off and its windows on, but for an exponential window, which is the transform's business."""

    force: np.ndarray  # (input, n)
    response: np.ndarray  # (output, n)
    force_noise: np.ndarray  # (input,) expected |noise|^2 of a line of the transform
    response_noise: np.ndarray  # (output,)
    stop: np.ndarray  # (output,) sample where the response window begins to fall
    fall: np.ndarray  # (output,) samples over which it falls


@lru_cache(maxsize=256)
def flank(samples: int) -> np.ndarray:
    """From 0 to 1 along half a cosine.   returns (samples,), read-only"""
    out = 0.5 - 0.5 * np.cos(np.pi * (np.arange(samples) + 0.5) / max(samples, 1))
    out.flags.writeable = False
    return out


def put_window(samples: np.ndarray, start: int, stop: int, rise: int, fall: int) -> None:
    """Leave what is between start and stop, in place, and nothing beside the cosine flanks: `rise` samples before start and
    `fall` after stop, either of which may be beyond the record.   samples : (..., n)
    """
    n = samples.shape[-1]
    samples[..., : min(max(0, start - rise), n)] = 0.0
    samples[..., min(max(0, stop + fall), n) :] = 0.0
    for edge, own in ((start - rise, flank(rise)), (stop, flank(fall)[::-1])):
        low, high = max(0, edge), min(n, edge + len(own))
        if low < high:
            samples[..., low:high] *= own[low - edge : high - edge]


def window(length: int, start: int, stop: int, rise: int, fall: int) -> np.ndarray:
    """1 between start and stop, 0 outside, with cosine flanks: `rise` samples before start and `fall` after stop."""
    out = np.ones(length)
    put_window(out, start, stop, rise, fall)
    return out


def pulse_margins(pulse: np.ndarray, first: int, last: int, length: int, noise: float) -> tuple[int, int]:
    """Where a force window may begin and end: one pulse length and 16 samples beside the pulse, and more while it rings.

    The pulse rings on while two of four successive samples exceed 2.5 standard deviations, at most four pulse lengths
    and 64 samples far.   pulse : (n,) along the hit, without its mean
    """
    reach = 4 * length + 64
    low, high = max(0, first - 4 - reach), min(len(pulse), last + reach + 4)
    near = pulse[low:high]
    if len(near) < 4:
        return first - length - 16, last + length + 16
    loud = moving_mean((np.abs(near) > 2.5 * noise).astype(float), 4) >= 0.5
    after = np.flatnonzero(~loud[last - low : last - low + reach])
    before = np.flatnonzero(~loud[max(0, first - 4 - reach) - low : max(0, first - 3) - low][::-1])
    grown_last = last + (int(after[0]) if len(after) else reach)
    grown_first = first - (int(before[0]) if len(before) else reach)
    return grown_first - length - 16, grown_last + length + 16


def decay_length(power: np.ndarray, noise: float, *, below_db: float) -> float:
    """Blocks after the onset until a decay is `below_db` under the noise: measured to the noise, then extrapolated.

    The slope of the level in dB is fitted over the last 20 dB above the noise, where the slowest mode is alone.
    inf where the decay does not reach the noise; nan where it never leaves it.

    power : (block,) mean square of the response, averaged over hits   noise : mean square of the noise
    """
    width = min(5, len(power))
    smooth = moving_mean(power, width)
    loud = np.flatnonzero(smooth > 2.0 * noise)
    if not len(loud):
        return np.nan
    cross = int(loud[-1])
    if cross >= len(smooth) - 1:
        return np.inf
    high = np.flatnonzero(smooth[: cross + 1] > 100.0 * noise)
    begin = int(high[-1]) if len(high) else int(np.argmax(smooth[: cross + 1]))
    begin = max(0, min(begin, cross - 3))
    level = 10.0 * np.log10(np.maximum(smooth[begin : cross + 1] - noise, 0.1 * noise))
    k = np.arange(len(level)) - 0.5 * (len(level) - 1)
    slope = -float(k @ level) / max(float(k @ k), 1e-300)
    return cross + width + below_db / slope if slope > 0 else np.inf


def decay_lengths(surveys: list[Survey], block: int) -> np.ndarray:
    """Samples from the onset to the end of the decay, of each output and common to the hits; inf where it has no end.

    The hits are averaged, each scaled by its peak force, so that the level is followed further into the noise. What the
    window cuts off is the same in every hit and no averaging takes it away, so the end is 18 dB below the noise of one
    hit and, from three hits on, 15 dB below that of their mean.

    block : samples of one block of `Survey.power`   returns (output,)
    """
    blocks = max(survey.power.shape[1] for survey in surveys)
    if not blocks:
        return np.full(len(surveys[0].response_peak), np.inf)
    power = stacked_power(surveys) / np.array([survey.peak for survey in surveys])[:, None, None] ** 2
    count = np.isfinite(power[:, 0]).sum(axis=0)
    power = np.nanmean(power[:, :, count >= max(1, len(surveys) // 2)], axis=0)
    noise = np.mean([(survey.response_noise / survey.peak) ** 2 for survey in surveys], axis=0)
    peak = np.max([survey.response_peak / survey.peak for survey in surveys], axis=0)
    below_db = max(18.0, 15.0 + 10.0 * np.log10(len(surveys)))
    decay = np.full(len(peak), np.inf)
    for output in np.flatnonzero(noise > (QUIET * peak) ** 2):
        decay[output] = block * decay_length(power[output], float(noise[output]), below_db=below_db)
    known = decay[np.isfinite(decay)]
    decay[np.isnan(decay)] = known.max() if len(known) else np.inf  # too weak to show a decay of its own
    return decay


def stacked_power(surveys: list[Survey]) -> np.ndarray:
    """Power of all hits, nan where one has ended.   returns (hit, output, block)"""
    blocks = max(survey.power.shape[1] for survey in surveys)
    power = np.full((len(surveys), len(surveys[0].response_peak), blocks), np.nan)
    for own, survey in zip(power, surveys, strict=True):
        own[:, : survey.power.shape[1]] = survey.power
    return power


def gate_hit(
    force: np.ndarray,
    response: np.ndarray,
    valid: tuple[int, int],
    survey: Survey,
    decay: np.ndarray,
    shift: int,
    damping: float = 0.0,
    late: np.ndarray | None = None,
) -> Gated:
    """Take what the channels rest on off a hit's record and put the windows on.

    An exponential window on both channels, from one origin, is the Laplace variable moved to s = damping + j w, exactly:
    no scale factor belongs to it, and the noise that is given back already has it in, like the other windows.

    force : (input, n)   response : (output, n)   valid : first and after-last sample of what belongs to this hit
    decay : (output,) samples after the onset   shift : the record's first sample, counted as in the survey
    damping : decay of the exponential window per sample   late : (output,) samples that each response comes late
    """
    n, (begin, end) = force.shape[1], valid
    onset, first, last = survey.onset - shift, survey.first - shift, survey.last - shift
    length = survey.stop - survey.onset
    rise = 16 + length // 2

    force = force - survey.force_rest.over(shift, shift + n)
    force[:, :begin] = 0.0
    force[:, end:] = 0.0
    noise = float(np.linalg.norm(survey.direction * survey.force_noise))
    low, high = pulse_margins(survey.direction @ force, first, last, length, noise)
    quiet = noise <= QUIET * survey.peak
    if not quiet:
        put_window(force, low, high, rise, rise)

    moved = np.zeros(len(response), int) if late is None else np.rint(late).astype(int)
    starts, rises = np.zeros(len(response), int), np.zeros(len(response), int)
    stops, falls = np.full(len(response), n), np.zeros(len(response), int)
    for i, samples in enumerate(decay):
        if np.isfinite(samples):
            falls[i] = max(1, int(FALL * min(samples, n / (1.0 + FALL))))
            stops[i] = min(onset + moved[i] + int(samples), max(end - falls[i], onset + 1))
            starts[i], rises[i] = low + moved[i], rise
        elif end < n or begin > 0:  # cut by the next hit or by an end of the recording
            falls[i] = max(1, int(CUT * end)) if end < n else 0
            stops[i], starts[i] = end - falls[i], begin
    response = response - resting_level(response, survey, shift, stops + falls, end)
    response[:, :begin] = 0.0
    response[:, end:] = 0.0
    for own, start, stop, up, fall in zip(response, starts, stops, rises, falls, strict=True):
        put_window(own, int(start), int(stop), int(up), int(fall))
    sizes = np.array([_square(n, *edges, damping) for edges in zip(starts, stops, rises, falls, strict=True)])
    return Gated(
        force,
        response,
        np.zeros(len(force)) if quiet else _square(n, low, high, rise, rise, damping) * survey.force_noise**2,
        sizes * survey.response_noise**2,
        stops,
        falls,
    )


def _square(n: int, start: int, stop: int, rise: int, fall: int, damping: float) -> float:
    """Sum of the squares of a window, of n samples, with an exponential window on it."""
    if damping:
        return float(
            np.sum((window(n, int(start), int(stop), int(rise), int(fall)) * np.exp(-damping * np.arange(n))) ** 2)
        )
    total = float(min(stop, n) - max(start, 0))
    for edge, size in ((start - rise, rise), (stop, fall)):
        if size and edge >= 0 and edge + size <= n:
            total += 0.375 * size  # of a whole flank
        elif size:
            own = flank(int(size)) if edge < start else flank(int(size))[::-1]
            total += float(np.sum(own[max(0, -edge) : max(0, n - edge)] ** 2))
    return total


def resting_level(response: np.ndarray, survey: Survey, shift: int, ends: np.ndarray, end: int) -> np.ndarray:
    """What each response rests on: the mean of its samples at rest, when those after the decay agree with those before the
    hit, or a line where it drifts.

    response : (output, n)   ends : (output,) where the windows end   end : after the last sample of this hit
    returns (output, 1), or (output, n) where a channel drifts
    """
    line = survey.response_rest.over(shift, shift + response.shape[1])
    level = np.array(np.broadcast_to(line, (len(response), line.shape[1])))
    before = max(0, survey.first - 16)
    for i, last in enumerate(ends):
        count = end - int(last)
        if count < 64 or survey.response_rest.slope[i]:
            continue
        mean = float(response[i, int(last) : end].sum()) / count
        spread = survey.response_noise[i] * np.sqrt(1.0 / max(before, 64) + 1.0 / count)
        rest = survey.response_rest.value[i]
        if abs(mean - rest) < 4.0 * spread:
            level[i] = (before * rest + count * mean) / (before + count) if before >= 64 else mean
    return level
