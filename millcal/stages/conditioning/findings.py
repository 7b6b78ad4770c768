"""What a user should know of the signals of a cut: clipping, chatter, drift, a wandering spindle."""

from collections.abc import Sequence

import numpy as np

from millcal.data import AXES, AsynchronousPeak, Recording
from millcal.numerics.residual_lines import Line
from millcal.numerics.revolutions import block_size
from millcal.stages.conditioning.forces import Note
from millcal.stages.conditioning.spindle import Revolutions

MOST_PEAKS = 10  # per axis
SMALLEST_PEAK = 0.01  # of the AC rms of its axis
CHATTER = 0.02  # of the largest AC rms
ASYNCHRONOUS = 0.02  # of the AC power of an axis
ASYNCHRONOUS_FORCE = 0.05  # of the AC force of the loudest axis: less is a sensor's noise on a quiet axis
STILL = 4  # samples in a row at the same extreme value


def peaks_of(
    lines: Sequence[Line], names: Sequence[str], ac_rms: np.ndarray, rate: float
) -> tuple[AsynchronousPeak, ...]:
    """The asynchronous lines worth telling, by axis (or sensor) and frequency."""
    peaks: list[AsynchronousPeak] = []
    for row, axis in enumerate(names):
        told = [line for line in lines if line.channel == row and line.amplitude >= SMALLEST_PEAK * ac_rms[row]]
        told = sorted(told, key=lambda line: -line.amplitude)[:MOST_PEAKS]
        peaks += [
            AsynchronousPeak(axis, line.frequency * rate, line.amplitude, line.exceeds)
            for line in sorted(told, key=lambda line: line.frequency)
        ]
    return tuple(peaks)


def note_clipping(
    recording: Recording, rows: list[int], start: int, stop: int, note: Note, names: Sequence[str]
) -> None:
    """Say where samples of the steady cut stand at the limit of the input, or stand still at their extremes."""
    reaching, still = np.zeros(len(rows), int), np.zeros(len(rows), int)
    limits = np.array([recording.channels[row].full_scale or np.inf for row in rows])
    top, bottom = np.full(len(rows), -np.inf), np.full(len(rows), np.inf)
    size = block_size(stop - start, len(rows))
    for at in range(start, stop, size):
        y = np.asarray(recording.block(at, min(at + size, stop), rows))
        reaching += np.sum(np.abs(y) >= 0.999 * limits[:, np.newaxis], axis=1)
        higher, lower = y.max(axis=1), y.min(axis=1)
        still[(higher > top) | (lower < bottom)] = 0  # what stood still before was no extreme
        top, bottom = np.maximum(top, higher), np.minimum(bottom, lower)
        for extreme in (top, bottom):
            at_it = y == extreme[:, np.newaxis]
            run = at_it[:, STILL - 1 :]
            for back in range(1, STILL):
                run = run & at_it[:, STILL - 1 - back : -back]
            still += np.sum(run, axis=1)
    for row, name in enumerate(names):
        if reaching[row]:
            limit = f"{limits[row]:g} {recording.channels[rows[row]].unit}"
            note("clipped", f"{name} reaches its input range of {limit} at {reaching[row]} samples of the cut")
        elif still[row] >= 3 and top[row] > bottom[row]:
            note(
                "clipped",
                f"{name} stands still at its extreme value at {still[row]} samples: the input may have clipped",
            )


def note_chatter(
    peaks: Sequence[AsynchronousPeak], ac_rms: np.ndarray, tooth_passing: float, resolution: float, note: Note
) -> None:
    """Say where strong asynchronous lines are one tooth passing apart, as a chatter frequency's sidebands are.

    tooth_passing, resolution : Hz
    """
    tolerance = max(2 * resolution, 0.005 * tooth_passing)
    lines: dict[float, float] = {}  # frequency -> amplitude, the same line in several axes once
    for peak in sorted(peaks, key=lambda peak: -peak.amplitude):
        if all(abs(peak.frequency - line) > tolerance for line in lines):
            lines[peak.frequency] = peak.amplitude
    pairs = [
        (a, b)
        for a in sorted(lines)
        for b in sorted(lines)
        if abs(b - a - tooth_passing) <= tolerance and max(lines[a], lines[b]) >= CHATTER * ac_rms.max()
    ]
    if pairs:
        said = ", ".join(f"{a:.0f} and {b:.0f} Hz" for a, b in pairs[:3])
        note(
            "chatter-lines",
            f"lines one tooth passing ({tooth_passing:.1f} Hz) apart do not follow the spindle: {said}; "
            "chatter, or a mode that the cut excites",
        )


def note_asynchronous(
    names: Sequence[str],
    ac_rms: np.ndarray,
    asynchronous_rms: np.ndarray,
    note: Note,
    tolerated: float = ASYNCHRONOUS,
) -> None:
    """Say which axes (or sensors) hold much power that the spindle does not explain."""
    share = (asynchronous_rms / np.maximum(ac_rms, 1e-300)) ** 2
    loud = (share > tolerated) & (asynchronous_rms > ASYNCHRONOUS_FORCE * ac_rms.max())
    told = [f"{value:.1%} in {axis}" for axis, value, tell in zip(names, share, loud, strict=True) if tell]
    if told:
        note("asynchronous", f"AC power that does not follow the spindle: {', '.join(told)}")


def note_wander(turns: Revolutions, harmonics: int, note: Note) -> None:
    """Say where the spindle's speed wanders so far that harmonics shrink."""
    wander = float(np.sqrt(max(np.var(turns.lead) - np.var(turns.gain), 0.0)))
    order = min(harmonics, 10)
    loss = -np.expm1(-((order * wander) ** 2) / 2)
    if loss > 0.01:
        note(
            "speed-wander",
            f"the spindle angle wanders by {np.degrees(wander):.2g} deg rms about uniform motion: harmonic {order} comes out "
            f"{loss:.0%} too small, higher ones more",
        )


def note_mean_drift(turns: Revolutions, ac_rms: np.ndarray, note: Note) -> None:
    """Say where the mean force drifts."""
    if turns.means.shape[1] < 9:
        return
    thirds = np.array_split(turns.means, 3, axis=1)
    drift = thirds[2].mean(axis=1) - thirds[0].mean(axis=1)
    told = [f"{axis} {drift[row]:+.3g} N" for row, axis in enumerate(AXES) if abs(drift[row]) > 0.05 * ac_rms[row]]
    if told:
        note(
            "mean-drift",
            f"the mean force moves from the first to the last third of the cut: {', '.join(told)}; if that is wear and not the "
            "amplifier, method smooth follows it",
        )
