"""Hits to spectra: summed as they come, compared with each other, and taken off the sum again where they do not belong."""

from collections.abc import Callable

import numpy as np

from millcal.numerics.frequency_response import CrossSpectra, condition, deviation, inverse_of, predicted
from millcal.numerics.impact_faults import bumps_beside_model, delays_of, phase_slopes, unexplained_level
from millcal.numerics.impact_windows import gate_hit
from millcal.stages.frf.taps import Tap

ODD = 0.1  # deviation of a response from the other hits' that is asked for at least
SLIGHT = 0.02  # the same where the others agree
ALIKE = 1e5  # condition of several forces above which hits are not compared
LINES = 256  # that hits are compared on
SHIFT = 0.1  # samples by which a response must be late to be moved
BETTER = 0.7  # of the deviation that may be left when it is moved
FAR = 5e-3  # s by which a response may be late at most
BLOCK = 2e-3  # s over which the level of what is unexplained is averaged
SINGLE = 1e-6  # of the largest value, what single precision leaves of it
FEWEST_LINES = 32  # that tell where in time something happened
PULSES = 3.2  # lines up to this many over the pulse are kept of each hit


def transform(
    tap: Tap, hit: int, points: int, damping: float, late: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Spectra of one hit, with its rest off and its windows on; force and response have one origin.

    A response that comes late by tau is brought back by e^{+s tau}, exactly, with its window: what the sensor said at t is of
    t - tau, so that the window ends that much earlier as well.

    damping : of an exponential window, per sample   late : (output,) s later than in the other hits
    returns complex (input, frequency), (output, frequency)
    """
    survey, (start, stop) = tap.surveys[hit], tap.stretches[hit]
    rate, length = tap.recording.sample_rate, tap.length
    origin = 0 if tap.segmented else survey.onset - tap.before
    begin, end = max(0, origin), min(stop - start, origin + length)
    valid = (begin - origin, end - origin)
    force, response, _ = tap.read(start + begin, start + end)
    if valid != (0, length):
        force, response = (np.pad(part, ((0, 0), (valid[0], length - valid[1]))) for part in (force, response))
    tau = tap.delays if late is None else tap.delays + late
    gated = gate_hit(force, response, valid, survey, tap.decay, origin, damping, tau * rate)
    tap.noise[hit] = (gated.force_noise, gated.response_noise)
    loaded = np.flatnonzero(gated.force.any(axis=0))
    first, last = (loaded[0], loaded[-1] + 1) if len(loaded) else (0, 1)
    tap.pulse[hit] = (int(first), gated.force[:, first:last].copy())
    tap.ends[hit] = (gated.stop - tau * rate, gated.fall)
    force, response = gated.force, gated.response
    if damping:
        fading = np.exp(-damping * np.arange(length))
        force, response = force * fading, response * fading
    F, X = np.fft.rfft(force, points), np.fft.rfft(response, points)
    if tau.any():
        s = rate * damping + 2j * np.pi * np.fft.rfftfreq(points, 1.0 / rate)
        for own, time in zip(X, tau, strict=True):
            own *= np.exp(s * time)
    return F, X


def sum_up(tap: Tap, points: int, damping: float, progress: Callable[[float], None] = lambda share: None) -> None:
    """Spectra of all hits in use, and what is kept of each: the lines that the pulses may have excited."""
    rate = tap.recording.sample_rate
    tap.sums = CrossSpectra(len(tap.forces), len(tap.responses), points // 2 + 1)
    used = tap.used()
    if not used:
        return
    shortest = min(tap.surveys[hit].stop - tap.surveys[hit].onset for hit in used) / rate
    top = min(points // 2 + 1, int(PULSES / shortest * points / rate) + 2)
    for number, hit in enumerate(used):
        progress(number / len(used))
        F, X = transform(tap, hit, points, damping)
        tap.sums.add(F, X, *tap.noise[hit])
        tap.thin[hit] = (F[:, :top].astype(np.complex64), X[:, :top].astype(np.complex64))


def _take_off(tap: Tap, hit: int, points: int, damping: float) -> None:
    assert tap.sums is not None
    F, X = transform(tap, hit, points, damping, tap.late.get(hit))
    tap.sums.add(F, X, *tap.noise[hit], sign=-1)
    del tap.thin[hit]


def compare(tap: Tap, points: int, damping: float, kept: set) -> None:
    """Leave out hits whose response is not that of the others: another point, another direction, something loose.

    The response of each is compared with what the others let expect, where the force is within 20 dB of its largest; 10 %,
    five times the usual deviation and four times that of the noise are asked for. Less is enough where five hits or more
    agree so well that it is ten times the usual. Where the response is the others' but for a delay, as by a late trigger,
    it is moved; the sensors of one hit must then agree on the delay, or have none.
    """
    if len(tap.used()) < max(3, len(tap.forces) + 2):
        return
    while True:
        used = tap.used()
        force, response, frequency = _lines(tap, used, points)
        if len(tap.forces) > 1 and condition(np.einsum("hjf,hkf->jkf", force.conj(), force)) > ALIKE:
            return  # hits in one direction say nothing about each other; the estimate refuses them
        expected, usual = predicted(force, response)
        found = deviation(response, expected)
        if len(tap.forces) == 1:
            late = np.abs(phase_slopes(response, expected, frequency)) * tap.recording.sample_rate
            unlike = (late > 0.5 * SHIFT).any(axis=1) | (found > 1.5 * np.median(found))
            moved = [
                used[k]
                for k in np.flatnonzero(unlike)
                if _move(tap, used[k], response[k], expected[k], frequency, points, damping)
            ]
            if moved:
                force, response, frequency = _lines(tap, used, points)
                expected, usual = predicted(force, response)
                found = deviation(response, expected)
        noisy = [np.sqrt(np.sum(tap.noise[hit][1]) / _power(response[k])) for k, hit in enumerate(used)]
        limit = np.maximum(np.maximum(ODD, 5.0 * usual), 4.0 * np.array(noisy))
        if len(used) >= len(tap.forces) + 4:
            limit = np.minimum(limit, np.maximum(SLIGHT, 10.0 * usual))
        order = np.argsort(found / limit)[::-1]
        # several inputs have no median: the worst goes first, since it bends what is expected of the others
        odd = [used[k] for k in order[: len(order) if len(tap.forces) == 1 else 1] if found[k] > limit[k]]
        for hit in odd:
            value = found[used.index(hit)]
            tap.reasons[hit].append(f"inconsistent: response {100 * value:.0f} % off the other hits")
            tap.accepted[hit] = (id(tap), hit) in kept
            if not tap.accepted[hit]:
                _take_off(tap, hit, points, damping)
        if len(tap.forces) == 1 or not odd or len(tap.used()) < len(tap.forces) + 2 or tap.accepted[odd[0]]:
            break
    _judge_residuals(tap, points, damping, kept)


def _power(response: np.ndarray) -> float:
    """Power of a hit, mean over the lines and sum over the outputs.   response : (output, line)"""
    return max(float(np.sum(np.mean(np.abs(response) ** 2, axis=1))), 1e-300)


def _judge_residuals(tap: Tap, points: int, damping: float, kept: set) -> None:
    """Leave out hits in whose decay something else happened, too small to see in the decay itself."""
    assert tap.sums is not None
    used = tap.used()
    if len(used) < max(3, len(tap.forces) + 2):
        return
    rate = tap.recording.sample_rate
    size = np.einsum("jjf->f", tap.sums.Sff).real[: tap.thin[used[0]][0].shape[1]]
    lines = int(np.flatnonzero(size > 1e-2 * size.max())[-1]) + 1
    if lines < FEWEST_LINES:
        return
    inverse = inverse_of(tap.sums.Sff[:, :, :lines].transpose(2, 0, 1))
    H = np.einsum("fjk,kof->ojf", inverse, tap.sums.Sfx[:, :, :lines]).astype(np.complex64)
    samples = 1 << int(np.ceil(np.log2(2 * lines)))  # a signal of these lines alone needs no more over the record
    step = points / samples / rate
    block = max(4, round(BLOCK / step))
    levels = []
    for hit in used:
        F, X = (part[:, :lines] for part in tap.thin[hit])
        share = np.einsum("jf,fjk,kf->f", F.conj(), inverse, F).real.astype(np.float32)
        levels.append(unexplained_level(F, X, H, share, points, samples, block))
    seconds = block * step
    last = max(tap.surveys[hit].last - tap.surveys[hit].onset for hit in used)
    surveys = [tap.surveys[hit] for hit in used]
    floor = 2.0 * lines / points * np.mean([s.response_noise**2 for s in surveys], axis=0)
    floor = np.maximum(floor, np.mean([(SINGLE * s.response_peak) ** 2 for s in surveys], axis=0))
    found = bumps_beside_model(np.array(levels), floor, int((tap.before + 2 * last + 32) / rate / seconds) + 1)
    for hit, bump in zip(used, found, strict=True):
        if bump is None:
            continue
        after = 1e3 * (bump[0] * seconds - tap.before / rate)
        share = 100.0 * bump[1] / float(tap.surveys[hit].response_peak.max())
        tap.reasons[hit].append(
            f"late: the response moves by itself {after:.0f} ms after the hit, {share:.1g} % of its largest"
        )
        tap.accepted[hit] = (id(tap), hit) in kept
        if not tap.accepted[hit]:
            _take_off(tap, hit, points, damping)


def _lines(tap: Tap, hits: list[int], points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spectra on some lines where the force is strong, evenly spaced.

    returns complex (hit, input, line), (hit, output, line), frequency (line,) in Hz
    """
    size = sum(np.sum(np.abs(tap.thin[hit][0]) ** 2, axis=0) for hit in hits)
    strong = np.flatnonzero(size > 1e-2 * size.max())
    band = np.arange(max(1, strong[0]), strong[-1] + 1)
    band = band[:: max(1, len(band) // LINES)]
    force, response = (np.stack([tap.thin[hit][part][:, band] for hit in hits]).astype(complex) for part in (0, 1))
    return force, response, band * (tap.recording.sample_rate / points)


def _move(
    tap: Tap,
    hit: int,
    response: np.ndarray,
    expected: np.ndarray,
    frequency: np.ndarray,
    points: int,
    damping: float,
) -> bool:
    """Bring a response back that is late, where that explains it."""
    assert tap.sums is not None
    rate = tap.recording.sample_rate
    lag, error = delays_of(response, expected, frequency)
    before = deviation(response[None], expected[None])[0]
    late = np.where((np.abs(lag) > SHIFT / rate) & (np.abs(lag) > 8.0 * error) & (np.abs(lag) < FAR), lag, 0.0)
    if not late.any():
        return False
    own = late[late != 0]
    together = float(np.median(own))
    if np.ptp(own) > max(1.0 / rate, 0.1 * abs(together)):
        return False  # sensors do not move one by one
    late = np.where(late != 0, together, 0.0)
    turned = response * np.exp(2j * np.pi * frequency * late[:, None])
    after = deviation(turned[None], expected[None])[0]
    if after > BETTER * before:
        return False
    top = tap.thin[hit][0].shape[1]
    _take_off(tap, hit, points, damping)
    F, X = transform(tap, hit, points, damping, late)
    tap.late[hit] = late
    tap.sums.add(F, X, *tap.noise[hit])
    tap.thin[hit] = (F[:, :top].astype(np.complex64), X[:, :top].astype(np.complex64))
    which = "response" if late.all() else tap.names([row for row, t in zip(tap.responses, late, strict=True) if t])
    samples = together * rate
    word = "late" if samples > 0 else "early"
    tap.remarks[hit].append(f"skew: {which} {abs(samples):.2f} samples {word} beside the other hits, moved back")
    return True
