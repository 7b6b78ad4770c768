"""What goes wrong with a hit beside its pulse: overload, samples lost or stuck, a bump in the decay, a shifted response.

Each test asks for something that no sound signal does and compares with what surrounds it, so that neither the unit nor
the converter matters, and noise-free records of a simulation pass.
"""

import numpy as np

from millcal.numerics.impact_hits import moving_mean, runs
from millcal.numerics.impact_windows import flank

STUCK = 8  # equal samples, at least
AGAIN = 5  # times that a decay reaches one extreme before it is cut off there
SMALL = 1e-3  # of the largest value, below which nothing that is lost does harm
NEAR = 48  # samples on either side that a stretch of zeros is judged by
PIECE = 3  # blocks over which the level of a decay is averaged
BUMP = 3.0  # times the power of the other hits
JUMP = 6.0  # times the power of all that was not explained before
ALONE = 12.0  # times the power of what was before, where no other hits can be compared
LATE = 2  # blocks that are looked at, at least


def is_flat_topped(samples: np.ndarray, least: int = 3) -> bool:
    """Whether a channel ends in a flat top: `least` equal extreme samples between steps no rounded peak would have.

    A rounded peak too may stay some samples on one count of the converter, but then its neighbours are within two counts
    (parabola); here more than four are asked for on both sides. Noise may put three to five samples on one count by
    chance, so that so short a top must also stand clear of the noise. A decay that is cut off reaches the same extreme
    again and again, if only for a sample each time; a rounded one does so two or three times at most.   samples : (n,)
    """
    for extreme in (samples.max(), samples.min()):
        at_extreme = samples == extreme
        if np.count_nonzero(at_extreme) < least:
            continue
        steps = np.abs(np.diff(samples))
        if not steps.any():
            return False
        count = steps[steps > 0].min()
        noise = np.percentile(steps[:: max(1, len(steps) // 1024)], 25) / 0.45  # |difference| of white noise
        clear = 0
        for a, b in runs(at_extreme):
            if a == 0 or b == len(samples):
                continue
            drop = min(abs(extreme - samples[a - 1]), abs(extreme - samples[b]))
            if drop <= 4.0 * count or (b - a <= 5 and drop <= 5.0 * noise):
                continue
            clear += drop > 20.0 * noise
            if b - a >= least or clear >= AGAIN:
                return True
    return False


def overloaded(samples: np.ndarray, full_scale: np.ndarray) -> np.ndarray:
    """Whether channels reached their input range or, with or without a known range, have a flat top.

    samples : (channel, n)   full_scale : (channel,) inf where it is not known   returns bool (channel,)
    """
    top, bottom = samples.max(axis=1), samples.min(axis=1)
    found = np.maximum(top, -bottom) >= 0.999 * full_scale
    for row in np.flatnonzero(~found):
        own = samples[row]
        if np.count_nonzero(own == top[row]) >= 3 or np.count_nonzero(own == bottom[row]) >= 3:
            found[row] = is_flat_topped(own)
    return found


def frozen(samples: np.ndarray, noise: np.ndarray) -> list[tuple[int, int, int]]:
    """Where channels stand still while they should move: samples lost and filled with zeros, or one value held.

    Eight equal samples or more count where the samples on both sides differ from each other far too often for that to be
    chance, by more than one count of the converter; what begins or ends the record must jump as well, because a noise-free
    record rests at its ends. Fewer zeros count where the samples about them let expect something else.

    samples : (channel, n)   noise : (channel,) standard deviation   returns (channel, first, after last)
    """
    same = samples[:, 1:] == samples[:, :-1]
    two = same[:, 1:] & same[:, :-1]
    four = two[:, 2:] & two[:, :-2]
    seven = four[:, 3:] & four[:, :-3]
    large = np.abs(samples) > 6.0 * noise[:, None]
    dropped = (samples[:, 1:-1] == 0) & (large[:, :-2] | large[:, 2:])
    found = []
    for row in np.flatnonzero(seven.any(axis=1) | dropped.any(axis=1)):
        stretches = _stuck(samples[row], same[row]) if seven[row].any() else []
        if dropped[row].any():
            stretches += [s for s in _zeros(samples[row], float(noise[row])) if not _within(s, stretches)]
        found += [(int(row), a, b) for a, b in sorted(stretches)]
    return found


def _within(stretch: tuple[int, int], others: list[tuple[int, int]]) -> bool:
    return any(a <= stretch[0] and stretch[1] <= b for a, b in others)


def _stuck(samples: np.ndarray, same: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of one value in a signal that moves.   samples : (n,)   same : (n - 1,) whether the next is equal"""
    n = len(samples)
    found = []
    for a, stop in runs(same):
        b = int(stop) + 1  # samples a..b are equal
        if b - a < STUCK or samples[a] in (samples.max(), samples.min()):
            continue  # the extremes are the overload's
        steps = []
        for width in (max(64, 4 * (b - a)), 512):
            width = min(width, 4096)
            steps += [np.abs(np.diff(samples[max(0, a - width) : a])), np.abs(np.diff(samples[b : b + width]))]
        steps = [side for side in steps if len(side) >= STUCK]
        if not steps:
            continue
        count = min(side[side > 0].min(initial=np.inf) for side in steps)
        if min(side.mean() for side in steps) < 1.5 * count:
            continue  # a converter at rest
        chance = max((np.count_nonzero(side == 0) + 1) / (len(side) + 2) for side in steps)
        if n * chance ** (b - a - 1) > 1e-4:
            continue
        if (a == 0 or b == n) and not _jumps(samples, int(a), b):
            continue  # a record without noise rests at its ends
        found.append((int(a), b))
    return found


def _jumps(samples: np.ndarray, a: int, b: int) -> bool:
    """Whether a stretch at an end of the record is left with a step larger than those beside it.

    What begins there rises from rest, and so in steps that grow; what ends there has come down to any height.
    """
    beside = samples[b : b + 32] if a == 0 else samples[max(0, a - 32) : a][::-1]
    steps = np.abs(np.diff(beside))
    if len(steps) < STUCK:
        return False
    usual = max((5.0 if a == 0 else 1.5) * float(np.sqrt(np.mean(steps**2))), SMALL * float(np.abs(samples).max()))
    return abs(float(beside[0] - samples[a])) > usual


def _zeros(samples: np.ndarray, noise: float) -> list[tuple[int, int]]:
    """Short stretches of exact zeros in the midst of a signal.   samples : (n,)

    What should be in the middle of the stretch is the cubic through two samples on either side; it counts as missing when it
    is ten times as large as the same cubic errs elsewhere near by, which it does a lot where the signal is fast.
    """
    n, found = len(samples), []
    stretches = runs(samples == 0)
    stretches = stretches[(stretches[:, 0] >= 2) & (stretches[:, 1] <= n - 2)]
    sizes = stretches[:, 1] - stretches[:, 0]
    for size in range(1, STUCK):
        starts = stretches[sizes == size, 0]
        if not len(starts):
            continue
        at, middle = np.array([-2, -1, size, size + 1]), (size - 1) // 2
        others = [np.delete(at, k) for k in range(4)]
        cubic = np.array([np.prod((middle - rest) / (x - rest)) for x, rest in zip(at, others, strict=True)])
        missing = np.abs(samples[starts[:, None] + at] @ cubic)
        clear = missing > 10.0 * noise  # few: the others cross zero
        for a, value in zip(starts[clear], missing[clear], strict=True):
            if value > _usual(samples, int(a), size, at, cubic):
                found.append((int(a), int(a) + size))
    return sorted(found)


def _usual(samples: np.ndarray, a: int, size: int, at: np.ndarray, cubic: np.ndarray) -> float:
    """What the cubic about a stretch may say without anything being lost; infinite where there is too little beside it."""
    n, b = len(samples), a + size
    starts = np.concatenate([np.arange(max(2, a - NEAR), a - size - 2), np.arange(b + 2, min(b + NEAR, n - size - 2))])
    if len(starts) < 2 * STUCK:
        return np.inf
    errs = samples[starts[:, None] + at] @ cubic - samples[starts + (size - 1) // 2]
    near = float(np.abs(samples[max(0, a - 16) : b + 16]).max())  # where a signal begins, it is small beside this
    steps = np.abs(np.diff(samples[max(0, a - NEAR) : b + NEAR]))
    count = float(steps[steps > 0].min(initial=np.inf))
    return max(10.0 * float(np.sqrt(np.mean(errs**2))), 0.3 * near, 5.0 * count)


def late_bumps(power: np.ndarray, peak: np.ndarray, noise: np.ndarray, begin: int) -> list[tuple[int, float] | None]:
    """Where the response of a hit rises although nothing hit: something fell, a door, a step. None where it does not.

    From three hits on, each is compared with the median of all, scaled by what it has of it: three times the power is
    asked for (and more where the decay is far down, since damping differs a little from hit to hit), clear of the noise.
    Of one or two, the level must rise twelve times above all of the last quarter of the time since the hit, and above the
    straight line in decibels through the last three: a beat rises as well, but to where it has been before.

    power : (hit, output, block) mean square, nan where a record has ended   peak : (hit,) force
    noise : (hit, output) standard deviation   begin : first block without force
    returns for each hit the block and the amplitude there, as a share of the largest
    """
    hits, outputs, blocks = power.shape
    if blocks < begin + PIECE + LATE:
        return [None] * hits
    level = moving_mean(np.nan_to_num(power), PIECE)  # (hit, output, block)
    risen = np.zeros(level.shape, bool)
    for o in range(outputs):  # one by one: there may be very many hits
        measured = np.isfinite(power[:, o, PIECE - 1 :])
        floor = noise[:, o, None] ** 2
        if hits >= 3:
            risen[:, o] = _above_usual(level[:, o], measured, peak, floor)
        else:
            risen[:, o] = _above_trend(level[:, o], floor, begin)
        risen[:, o] &= measured
    risen[:, :, :begin] = False
    return _first_rises(risen, level)


def _above_trend(level: np.ndarray, floor: np.ndarray, begin: int) -> np.ndarray:
    """Where a hit's level rises above its own trend.   level : (hit, block)   floor : (hit, 1)"""
    found = np.zeros(level.shape, bool)
    for k in range(begin + 4 * PIECE, level.shape[1]):
        recent = level[:, begin + 3 * (k - begin) // 4 : k - PIECE + 1]
        high = level[:, k] > ALONE * np.maximum(recent.max(axis=1), floor[:, 0])
        if not high.any():
            continue
        before = np.log(np.maximum(level[high, begin + (k - begin) // 4 : k - PIECE + 1], 0.1 * floor[high] + 1e-300))
        at = np.arange(before.shape[1]) - 0.5 * (before.shape[1] - 1)
        slope = np.minimum(before @ at / (at @ at), 0.0)
        trend = before.mean(axis=1) + slope * (at[-1] + PIECE)
        found[high, k] = np.log(level[high, k]) > trend + np.log(ALONE)
    return found


def _above_usual(level: np.ndarray, measured: np.ndarray, peak: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Where a hit's level is above that of the median hit.   level, measured : (hit, block)   floor : (hit, 1)"""
    scaled = np.where(measured, level / peak[:, None] ** 2, np.nan)
    there = measured.any(axis=0)
    usual = np.zeros(level.shape[1])
    usual[there] = np.nanmedian(scaled[:, there], axis=0)
    clear = measured & (level > 20.0 * floor)
    scaled = np.where(clear, scaled / np.maximum(usual, 1e-300), np.nan)
    known = clear.any(axis=1)
    own = np.ones(len(level))
    own[known] = np.clip(np.nanpercentile(scaled[known], 25, axis=1), 0.5, 2.0)  # a bump is in all that follows it
    down = np.maximum(usual.max() / np.maximum(usual, 1e-300), 1.0)
    expected = usual * down**0.1 * (own * peak**2)[:, None]
    return level > BUMP * expected + 3.0 * floor


def unexplained_level(
    force: np.ndarray,
    response: np.ndarray,
    H: np.ndarray,
    share: np.ndarray,
    points: int,
    samples: int,
    block: int,
) -> np.ndarray:
    """Level of what a frequency response does not explain of a hit, in time: mean squares, averaged over a few blocks.

    The hit is in the frequency response itself: what it lacks for that is made up for by its share there.
    force : complex (input, line), lines from 0 Hz on   response : complex (output, line)   H : complex (output, input, line)
    share : (line,) of this hit in H   points : of the transform   samples : that the time is divided in
    block : samples of a block, of these
    returns (output, block)
    """
    lines = response.shape[1]
    fall = max(1, lines // 5)
    gain = samples / points / np.maximum(1.0 - share, 0.1)
    gain[lines - fall :] *= flank(fall)[::-1]
    rest = response - (H[:, 0] * force[0] if len(force) == 1 else np.einsum("oif,if->of", H, force))
    rest *= gain
    time = np.fft.irfft(rest, samples, axis=1)
    blocks = samples // block
    whole = time[:, : blocks * block].reshape(len(time), blocks, block)
    return moving_mean(np.einsum("obk,obk->ob", whole, whole) / block, PIECE)


def bumps_beside_model(level: np.ndarray, floor: np.ndarray, begin: int) -> list[tuple[int, float] | None]:
    """Where what the frequency response does not explain of a hit rises: bumps well below the decay itself.

    What good hits differ by (their place, their direction) is largest at the hit and decays. A bump is asked to have six times
    the power of all that was before it in the last three quarters of the time, of the noise, and of the usual hit at that
    time, since each hit has a little of every other's through H.

    level : (hit, output, block) of `unexplained_level`   floor : (output,) mean square of the noise in these lines
    begin : first block without force   returns for each hit the block and the amplitude there
    """
    risen = level > JUMP * np.maximum(np.median(level, axis=0), floor[:, None])
    return _first_rises(_above_before(risen, level, begin, JUMP), level, absolute=True)


def _above_before(risen: np.ndarray, level: np.ndarray, begin: int, times: float) -> np.ndarray:
    """Where a level that has risen is also well above all that was before it, in the last three quarters of the time.

    risen, level : (..., block)   begin : first block that counts   returns as risen
    """
    found = np.zeros(level.shape, bool)
    for k in np.flatnonzero(risen.reshape(-1, risen.shape[-1]).any(axis=0)):
        before = level[..., begin + (k - begin) // 4 : k - PIECE + 1]
        if k >= begin + 2 * PIECE and before.shape[-1]:
            found[..., k] = risen[..., k] & (level[..., k] > times * before.max(axis=-1))
    return found


def _first_rises(risen: np.ndarray, level: np.ndarray, *, absolute: bool = False) -> list[tuple[int, float] | None]:
    """The first of two successive blocks in which a level has risen, and its amplitude: as a share of the largest, or as such.

    risen, level : (hit, output, block)
    """
    found: list[tuple[int, float] | None] = []
    for own, size in zip(risen, level, strict=True):
        both = own[:, 1:] & own[:, :-1]
        if not both.any():
            found.append(None)
            continue
        first = int(np.flatnonzero(both.any(axis=0))[0])
        unit = 1.0 if absolute else np.maximum(size.max(axis=1, keepdims=True), 1e-300)
        found.append((first + PIECE - 1, float(np.sqrt(np.where(own, size / unit, 0.0).max()))))
    return found


def phase_slopes(actual: np.ndarray, expected: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """About how much later signals are than expected, s, where that is little: the mean slope of the phase.

    actual, expected : (..., line) complex   frequency : (line,) Hz   returns (...,)
    """
    product = actual * expected.conj()
    w = 2 * np.pi * frequency
    return -(product.imag @ w) / np.maximum(np.abs(product) @ w**2, 1e-300)


def delays_of(actual: np.ndarray, expected: np.ndarray, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much later signals are than expected, and the standard deviation of that: s.

    First the lag at which they are most alike, where every line that stands out of the rest counts the same, so that one
    resonance does not hide it; then the slope of the phase through the origin, where no lag has a phase.

    actual, expected : (signal, line) complex   frequency : (line,) Hz, evenly spaced   returns two (signal,)
    """
    product = actual * expected.conj()
    size = np.abs(product)
    weight = size / (size + 0.03 * size.max(axis=1, keepdims=True) + 1e-300)
    turned = product / np.maximum(size, 1e-300) * weight
    step = frequency[1] - frequency[0]
    points = 1 << int(np.ceil(np.log2(8.0 * frequency[-1] / step)))
    first = round(frequency[0] / step)  # the spectrum of the correlation from 0 Hz on
    spectrum = np.zeros((len(turned), points), complex)
    spectrum[:, first : first + len(frequency)] = turned
    alike = np.fft.ifft(spectrum, axis=1).real
    lag = np.argmax(alike, axis=1)
    lag = np.where(lag > points // 2, lag - points, lag) / (points * step)
    w = 2 * np.pi * frequency
    for _ in range(4):
        phase = np.angle(turned * np.exp(1j * w * lag[:, None]))
        lag = lag - (weight * phase) @ w / np.maximum(weight @ w**2, 1e-300)
    phase = np.angle(turned * np.exp(1j * w * lag[:, None]))
    scatter = (weight * phase) ** 2 @ w**2
    return lag, np.sqrt(scatter) / np.maximum(weight @ w**2, 1e-300)
