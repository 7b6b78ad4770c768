"""Windows of a hit: the pulse and the decay are kept, what is noise alone is dropped.

That divides the noise power in the force spectrum by (record / pulse) and in the response by (record / decay). Nothing is
scaled: windows that are 1 where the signal is leave X(f)/F(f) as it is, whereas an exponential window would add damping,
and force and response keep one origin. Means come off before a window goes on, or the window's own spectrum comes in.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.impact_hits import Survey, moving_mean

QUIET = 1e-5  # noise below this share of the peak is rounding: windows would only remove signal
FALL = 0.15  # cosine end of the response window, as a share of its length


class Gated(NamedTuple):
    """A hit with its means off and its windows on, but for an exponential window, which is the transform's business."""

    force: np.ndarray  # (input, n)
    response: np.ndarray  # (output, n)
    force_noise: np.ndarray  # (input,) expected |noise|^2 of a line of the transform
    response_noise: np.ndarray  # (output,)
    stop: np.ndarray  # (output,) sample where the response window begins to fall
    fall: np.ndarray  # (output,) samples over which it falls


def window(length: int, start: int, stop: int, rise: int, fall: int) -> np.ndarray:
    """1 between start and stop, 0 outside, with cosine flanks: `rise` samples before start and `fall` after stop."""
    out = np.zeros(length)
    out[max(0, start) : max(0, stop)] = 1.0
    for edge, flank in ((start - rise, _flank(rise)), (stop, _flank(fall)[::-1])):
        low, high = max(0, edge), min(length, edge + len(flank))
        if low < high:
            out[low:high] = np.maximum(out[low:high], flank[low - edge : high - edge])
    return out


def _flank(samples: int) -> np.ndarray:
    """From 0 to 1 along half a cosine."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(samples) + 0.5) / max(samples, 1))


def pulse_margins(pulse: np.ndarray, first: int, last: int, length: int, noise: float) -> tuple[int, int]:
    """Where a force window may begin and end: one pulse length and 16 samples beside the pulse, and more while it rings.

    The pulse rings on while two of four successive samples exceed 2.5 standard deviations, at most four pulse lengths
    and 64 samples far.   pulse : (n,) along the hit, without its mean
    """
    loud = moving_mean((np.abs(pulse) > 2.5 * noise).astype(float), 4) >= 0.5
    reach = 4 * length + 64
    after = np.flatnonzero(~loud[last : last + reach])
    before = np.flatnonzero(~loud[max(0, first - 4 - reach) : max(0, first - 3)][::-1])
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
    window cuts off is the same in every hit and no averaging takes it away, so the end is 15 dB below the noise of one
    hit and, from three hits on, 12 dB below that of their mean.

    block : samples of one block of `Survey.power`   returns (output,)
    """
    blocks = max(survey.power.shape[1] for survey in surveys)
    if not blocks:
        return np.full(len(surveys[0].response_peak), np.inf)
    power = np.full((len(surveys), len(surveys[0].response_peak), blocks), np.nan)
    for own, survey in zip(power, surveys, strict=True):
        own[:, : survey.power.shape[1]] = survey.power / survey.peak**2
    count = np.isfinite(power[:, 0]).sum(axis=0)
    power = np.nanmean(power[:, :, count >= max(1, len(surveys) // 2)], axis=0)
    noise = np.mean([(survey.response_noise / survey.peak) ** 2 for survey in surveys], axis=0)
    peak = np.max([survey.response_peak / survey.peak for survey in surveys], axis=0)
    below_db = max(15.0, 12.0 + 10.0 * np.log10(len(surveys)))
    decay = np.full(len(peak), np.inf)
    for output in np.flatnonzero(noise > (QUIET * peak) ** 2):
        decay[output] = block * decay_length(power[output], float(noise[output]), below_db=below_db)
    known = decay[np.isfinite(decay)]
    decay[np.isnan(decay)] = known.max() if len(known) else np.inf  # too weak to show a decay of its own
    return decay


def gate_hit(
    force: np.ndarray,
    response: np.ndarray,
    valid: np.ndarray,
    survey: Survey,
    decay: np.ndarray,
    shift: int,
    damping: float = 0.0,
) -> Gated:
    """Take the means off a hit's record and put the windows on.

    An exponential window on both channels, from one origin, is the Laplace variable moved to s = damping + j w, exactly:
    no scale factor belongs to it, and the noise that is given back already has it in, like the other windows.

    force : (input, n)   response : (output, n)   valid : (n,) False outside of what belongs to this hit
    decay : (output,) samples after the onset   shift : the record's first sample, counted as in the survey
    damping : decay of the exponential window per sample
    """
    n = len(valid)
    onset, first, last = survey.onset - shift, survey.first - shift, survey.last - shift
    begin, end = int(np.argmax(valid)), n - int(np.argmax(valid[::-1]))
    length = survey.stop - survey.onset
    flank = 16 + length // 2

    force = np.where(valid, force - survey.force_mean[:, None], 0.0)
    noise = float(np.linalg.norm(survey.direction * survey.force_noise))
    low, high = pulse_margins(survey.direction @ force, first, last, length, noise)
    quiet = noise <= QUIET * survey.peak
    force_window = np.ones(n) if quiet else window(n, low, high, flank, flank)

    windows = np.ones(response.shape)
    stops, falls = np.full(len(response), n), np.zeros(len(response), int)
    for i, samples in enumerate(decay):
        if np.isfinite(samples):
            falls[i] = max(1, int(FALL * min(samples, end / (1.0 + FALL))))  # the same in every hit
            stops[i] = min(onset + int(samples), end - falls[i])
            windows[i] = window(n, low, stops[i], flank, falls[i])
        elif end < n or begin > 0:  # cut by the next hit or by an end of the recording
            falls[i] = max(1, int(FALL / 3 * end)) if end < n else 0
            stops[i] = end - falls[i]
            windows[i] = window(n, begin, stops[i], 0, falls[i])
    rest = resting_mean(response, (windows == 0.0) & valid, survey)
    response = np.where(valid, response - rest[:, None], 0.0)
    fading = np.exp(-damping * np.arange(n)) if damping else 1.0
    return Gated(
        force * force_window,
        response * windows,
        np.zeros(len(force)) if quiet else np.sum((force_window * fading) ** 2) * survey.force_noise**2,
        np.sum((windows * fading) ** 2, axis=1) * survey.response_noise**2,
        stops,
        falls,
    )


def resting_mean(response: np.ndarray, rest: np.ndarray, survey: Survey) -> np.ndarray:
    """Mean of each response at rest: of all its resting samples, when they agree with those before the hit.

    response, rest : (output, n)   returns (output,)
    """
    count = rest.sum(axis=1)
    mean = np.where(rest, response, 0.0).sum(axis=1) / np.maximum(count, 1)
    spread = survey.response_noise * np.sqrt(1.0 / 64.0 + 1.0 / np.maximum(count, 1))
    agree = (count >= 64) & (np.abs(mean - survey.response_mean) < 4.0 * spread)
    return np.where(agree, mean, survey.response_mean)
