"""Where the spindle stands at every sample: from an encoder, from a pulse per revolution, or from its speed alone.

An encoder says it outright. Between pulses the speed is smooth, and as smooth as the pulses themselves say: their times are
known to a sample only, so that a speed from one to the next would jump. Without either, the harmonics of the force give the
speed, and how they run ahead of it from revolution to revolution gives its slow changes.
"""

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics import spectra
from millcal.numerics.phase_tracking import track_phase
from millcal.numerics.pulses import number_pulses, pulse_times
from millcal.numerics.revolutions import block_size
from millcal.numerics.smooth_sequence import smooth_sequence
from millcal.stages.conditioning.forces import Note
from millcal.stages.conditioning.spindle import FAR_FROM_STATED, NYQUIST_SHARE, each_revolution, spindle_cycle

TURN = 2 * np.pi
FARTHEST = 0.2  # from the stated speed, of an encoder or a pulse that is believed
FEWEST_PULSES = 0.5  # of those expected
REACH = 3  # revolutions beside the cut whose pulses help
TO_A_SAMPLE = 0.6  # samples: pulses that are this near to a constant speed say nothing of another
FEW_SAMPLES = 2.0  # from the first pulse to the last, by which their speed may be wrong
WANDERS = 0.006  # rad, rms, of a spindle whose speed is not constant: less may be the force that changes its shape
ROUNDS = 4
LOOK = 32  # revolutions in the middle, over which the speed may pass for constant
FOLLOWED = 0.3  # share of the force's power at the harmonics of a spindle that wanders: less is no such spindle


def encoder_angle(recording: Recording, start: int, stop: int, stated: float, note: Note) -> np.ndarray | None:
    """The angle from a channel of angles, which may begin again at each turn; None where there is no usable one.

    stated : cycles per sample   returns (sample,) rad, rising
    """
    rows = recording.rows_of("angle")[:1]
    if not rows:
        return None
    size = block_size(stop - start)
    raw = np.concatenate(
        [np.asarray(recording.block(at, min(at + size, stop), rows))[0] for at in range(start, stop, size)]
    )
    bad = np.flatnonzero(~np.isfinite(raw))
    if len(bad):
        note("encoder-unusable", f"the angle is no number at {(start + bad[0]) / recording.sample_rate:g} s: not used")
        return None
    angle = np.unwrap(_without_glitches(raw, note))
    if angle[-1] < angle[0]:
        angle = -angle
        note("encoder-sense", "the encoder counts down while the spindle turns: its angle is turned round", "note")
    measured = (angle[-1] - angle[0]) / (TURN * (len(angle) - 1))
    if abs(measured / stated - 1) > FARTHEST:
        note(
            "encoder-unusable",
            f"the encoder turns {measured / stated:.3g} times as fast as the stated spindle: not used, check its unit",
        )
        return None
    changes = np.flatnonzero(np.diff(angle, prepend=angle[0] - 1.0) > 0)
    if len(changes) < 0.5 * len(angle):  # coarse: between two counts the spindle turns on
        angle = _straight_through(changes, angle[changes], len(angle))
    return angle


def _without_glitches(angle: np.ndarray, note: Note) -> np.ndarray:
    """Single samples far off while their neighbours agree, as where a wrap falls into a sample, are put between them.

    All of it modulo a turn, so that no such sample costs or adds one.   angle : (sample,) rad, wrapped or not
    """

    def nearest(turn: np.ndarray) -> np.ndarray:
        return (turn + np.pi) % TURN - np.pi

    step = float(np.median(nearest(np.diff(angle))))
    limit = max(0.2, abs(step))
    off = np.abs(nearest(np.diff(angle)[:-1] - step))
    across = nearest(angle[2:] - angle[:-2] - 2 * step)
    wrong = np.flatnonzero((off > limit) & (np.abs(across) < limit / 2)) + 1
    if len(wrong):
        note(
            "encoder-glitches",
            f"{len(wrong)} samples of the angle lie far off their neighbours: put between them",
            "note",
        )
        angle = np.array(angle)
        angle[wrong] = angle[wrong - 1] + step + across[wrong - 1] / 2
    return angle


def _straight_through(at: np.ndarray, values: np.ndarray, length: int) -> np.ndarray:
    """Values at some samples, straight between them and on from there.   returns (length,)"""
    samples = np.arange(length)
    slope = (values[-1] - values[0]) / (at[-1] - at[0])
    outside = np.minimum(samples - at[0], 0) + np.maximum(samples - at[-1], 0)
    return np.interp(samples, at, values) + slope * outside


def pulse_angle(recording: Recording, start: int, stop: int, stated: float, note: Note) -> np.ndarray | None:
    """The angle from a pulse per revolution, 0 where one rises; None where there is no usable one.

    stated : cycles per sample   returns (sample,) rad, rising
    """
    rows = recording.rows_of("pulse")[:1]
    if not rows:
        return None
    first = max(start - round(REACH / stated), 0)
    last = min(stop + round(REACH / stated), recording.samples.shape[1])
    times = first + pulse_times(lambda a, b: np.asarray(recording.block(a, b, rows)), first, last)
    expected = (last - first) * stated
    period = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    kept, turns = number_pulses(times, period) if abs(period * stated - 1) <= FARTHEST else (np.empty(0, int),) * 2
    if len(kept) < max(2, FEWEST_PULSES * expected - 1):
        note(
            "pulse-unusable",
            f"{len(times)} pulses in {expected:.0f} revolutions, {len(kept)} of them in step: not used",
        )
        return None
    marks = times[kept]
    missed, false = int(turns[-1]) + 1 - len(kept), len(times) - len(kept)
    ends = max(marks[0] - start, stop - marks[-1], 0.0) / period
    if missed or false or ends > REACH:
        told = [f"{missed} missed"] * (missed > 0) + [f"{false} double or false"] * (false > 0)
        told += [f"none in {ends:.0f} revolutions at an end of the cut"] * (ends > REACH)
        note("pulse-mended", f"pulses: {', '.join(told)}; the spindle angle is bridged there by its speed")
    return TURN * _turns_between(marks, turns, start, stop)


def _turns_between(marks: np.ndarray, turns: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Revolutions at every sample from the times of marks, smoothed.   marks : (mark,) samples   turns : their numbers"""
    samples = np.arange(start, stop)
    line = np.polynomial.Polynomial.fit(turns, marks, 1)
    to_a_sample = np.all(np.abs(marks % 1.0 - 0.5) < 0.05)  # a pulse without slope
    if len(marks) < 5 or (to_a_sample and np.abs(marks - line(turns)).max() <= TO_A_SAMPLE):
        origin, slope = line.convert().coef
        return (samples - origin) / slope
    from scipy.interpolate import CubicSpline

    number = np.arange(turns[-1] + 1)
    weights, values = np.zeros(len(number)), np.zeros(len(number))
    weights[turns], values[turns] = 1.0, marks
    smooth = smooth_sequence(values, weights)
    inner = CubicSpline(smooth, number)(np.clip(samples, smooth[0], smooth[-1]))
    ahead = min(4, len(number)) - 1
    before = (samples - smooth[0]) * ahead / (smooth[ahead] - smooth[0])
    after = number[-1] + (samples - smooth[-1]) * ahead / (smooth[-1] - smooth[-1 - ahead])
    return np.where(samples < smooth[0], before, np.where(samples > smooth[-1], after, inner))


def with_speed_of_force(angle: np.ndarray, force: np.ndarray, teeth: int, where: str) -> np.ndarray:
    """Where pulses say that the speed is constant, the harmonics of the force say it far better than pulses known to a sample.

    angle : (sample,) rad, by the pulses   force : (axis, sample)   returns (sample,) rad, the same in the middle of the cut
    """
    length = len(angle)
    by_pulses = (angle[-1] - angle[0]) / (TURN * (length - 1))
    if np.ptp(np.diff(angle)) > 1e-6 * by_pulses:
        return angle
    cycle = spindle_cycle(spectra.reader_of(force), 0, length, by_pulses, teeth, where, lambda *_: None).cycle
    if abs(cycle / by_pulses - 1) * length > FEW_SAMPLES:  # more than quantised pulses can be off by
        return angle
    return angle[length // 2] + TURN * cycle * (np.arange(length) - length // 2)


def speed_angle(
    force: np.ndarray, start: int, stated: float, teeth: int, where: str, note: Note, *, steady: bool
) -> np.ndarray:
    """The angle from the harmonics of the force, 0 at the first sample of the recording.

    A speed that changes slowly is followed where it is sure, and the engagement is constant: else the force changes its shape
    by itself, and only its mean speed can be told.

    force : (axis, sample), of the cut   start : its first sample   stated : cycles per sample   steady : constant engagement
    returns (sample,) rad, rising
    """
    wandering = _wandering(force, stated, teeth, where) if steady else None
    if wandering is None:
        cycle = spindle_cycle(spectra.reader_of(force), 0, force.shape[1], stated, teeth, where, note).cycle
        return TURN * cycle * (start + np.arange(force.shape[1]))
    mean = (wandering[-1] - wandering[0]) / (len(wandering) - 1)
    if abs(mean / stated - 1) > FAR_FROM_STATED:
        note_speed(mean, stated, "force", note)
    at_first = min(round(4 / mean), len(wandering) - 1)
    return TURN * (wandering - wandering[0] + start * (wandering[at_first] - wandering[0]) / at_first)


def _wandering(force: np.ndarray, stated: float, teeth: int, where: str) -> np.ndarray | None:
    """Revolutions at each sample where the speed surely changes; None where it may be constant.

    The phase is followed from revolution to revolution, at the speed in the middle of the cut. Then each round puts the force
    on equal steps of the angle found so far, where its harmonics are no longer smeared, and looks for what is left.
    """
    length = force.shape[1]
    half = min(round(LOOK / stated / 2), length // 2)
    read = spectra.reader_of(force[:, length // 2 - half : length // 2 + half])
    cycle = spindle_cycle(read, 0, 2 * half, stated, teeth, where, lambda *_: None).cycle
    uniform = np.arange(length) * cycle
    edges = np.rint(np.arange(int(length * cycle) + 1) / cycle).astype(np.int64)
    if len(edges) < 9:
        return None
    highest = max(1, min(12, int(NYQUIST_SHARE / cycle)))
    read = spectra.reader_of(force)
    found = spectra.block_harmonics(read, edges, cycle, highest)[:, :, 1:]
    lead = _along_revolutions(smooth_sequence(track_phase(found)) / TURN, cycle, length)
    for _ in range(ROUNDS):
        even = np.array([np.interp(uniform, uniform + lead, row) for row in force])
        read = spectra.reader_of(even)
        fitted = spectra.fit_harmonics(read, 0, length, cycle, highest)
        turns = each_revolution(read, 0, length, cycle, fitted)
        ahead = turns.lead / np.where(np.abs(turns.gain) > 0.1, turns.gain, np.inf)
        course = smooth_sequence(ahead) / TURN
        lead += _along_revolutions(course, cycle, length)
        if np.sqrt(np.mean(course**2)) * TURN < 1e-4:
            break
    wander = lead - np.polynomial.Polynomial.fit(uniform, lead, 1)(uniform)
    if np.sqrt(np.mean(wander**2)) * TURN < WANDERS or np.any(np.diff(lead) < -0.5 * cycle):
        return None
    even = np.array([np.interp(uniform, uniform + lead, row) for row in force])
    fitted = spectra.fit_harmonics(spectra.reader_of(even), 0, length, cycle, highest)
    explained = 0.5 * float(np.sum(np.abs(fitted[:, 1:]) ** 2)) / max(float(force.var(axis=1).sum()), 1e-300)
    return uniform + lead if explained > FOLLOWED else None


def _along_revolutions(course: np.ndarray, cycle: float, length: int) -> np.ndarray:
    """Values at the middles of the revolutions, straight between them and on beyond the first and the last, at every sample."""
    at = (np.arange(-1, len(course) + 1) + 0.5) / cycle
    before, after = 2 * course[0] - course[1], 2 * course[-1] - course[-2]
    return np.interp(np.arange(length), at, np.concatenate([[before], course, [after]]))


def note_speed(frequency: float, stated: float, source: str, note: Note) -> None:
    """Say where encoder or pulse tell another speed than the stated one.   frequency, stated : Hz"""
    if source != "speed" and abs(frequency / stated - 1) > FAR_FROM_STATED:
        note(
            "speed-off",
            f"the {source} says {frequency / stated - 1:+.1%} against the stated spindle speed; the measured one is used, "
            "check spindle_speed_rpm and the sample rate",
        )


def synchronous_share(force: np.ndarray, angle: np.ndarray, highest: int) -> float:
    """Share of the force's variance that harmonics of the spindle explain, less what chance explains.

    force : (axis, sample)   angle : (sample,) rad
    """
    turn = np.exp(1j * np.multiply.outer(angle, np.arange(1, highest + 1)))
    columns = np.column_stack([np.ones(len(angle)), turn.real, turn.imag])
    about = (force - force.mean(axis=1, keepdims=True)).T
    rest = about - columns @ np.linalg.lstsq(columns, about)[0]
    freedom = columns.shape[1] / len(angle)
    explained = 1.0 - float(np.sum(rest**2)) / max(float(np.sum(about**2)), 1e-300)
    return (explained - freedom) / max(1.0 - freedom, 1e-9)


def refuse_what_is_no_cut(share: float, where: str, note: Note) -> None:
    """A record whose force does not follow the spindle at all holds nothing to follow."""
    if share < 0.05:
        raise RecordingError(
            f"{where}: {max(share, 0.0):.1%} of the force follows the spindle: this is no cut at the stated speed, or the "
            "speed varies; check spindle_speed_rpm and the map, give steady_s, or record a pulse per revolution"
        )
    if share < 0.3:
        note(
            "not-synchronous",
            f"only {share:.0%} of the force's power follows the spindle; is this a cut at that speed?",
        )
