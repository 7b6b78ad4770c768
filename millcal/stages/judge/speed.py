"""The spindle speed during the cut: from the pulse per revolution, else from the harmonics, else from how far apart tones are.

Heavy chatter may leave nothing of the harmonics to be seen. But the cut modulates it once a tooth, and with runout once a turn:
tones that lie whole turns from the strongest tell the speed as well.
"""

from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.numerics.comb import comb_cycle
from millcal.numerics.pulses import number_pulses, pulse_times
from millcal.numerics.residual_lines import fast_length, residual_spectra
from millcal.numerics.spectra import Cycle, reader_of
from millcal.numerics.tones import find_tones, folded
from millcal.stages.judge.signal import Note, reader

NEAR, FAR = 0.012, 0.032  # how far the stated speed may be off: usually, and at most
MORE = 2  # times as many harmonics stand out at a speed far off, before it is believed
MANY = 6  # and so many at least
FAR_FROM_STATED = 0.01
HARMONICS = 60
FEWEST_OTHERS = 4  # harmonics that stand out, for a speed by them, if none is of the teeth
FEWEST_OF_TEETH = 3  # for a speed far off, where nothing follows a nearer one
FEWEST_SEEN = 2  # if one is; or the first of the tooth passing alone
PULSE_SCATTER = 0.05  # of a revolution
TONES, SMALLEST = 10, 1e-4  # whose distances are looked at, and their power over that of the strongest
FARTHEST = 4  # tooth passings from it
BY_CHANCE = 0.04  # probability at which tones lie so, up to which they tell a speed
SURELY = 1e-4  # and up to which they are believed against harmonics
MANY_SEEN, OF_TEETH = 12, 5  # harmonics, of the spindle or of the teeth, that are believed all the same


def refined_cycle(
    recording: Recording, samples: np.ndarray, start: int, stated: float, teeth: int, note: Note
) -> tuple[Cycle, bool]:
    """The spindle frequency in cycles per sample, and whether anything in the signal follows it.

    samples : (channel, sample) from `start` on   stated : cycles per sample
    """
    by_comb, seen = _by_harmonics(samples, stated, teeth)
    follows = _follows(seen, teeth)
    many = len(seen) >= MANY_SEEN or sum(k % teeth == 0 for k in seen) >= OF_TEETH
    apart = None if many and follows else _by_distances(samples, stated, teeth)
    if apart is not None and (not follows or (apart.chance < SURELY and apart.leaves(by_comb.cycle))):
        by_comb, follows = (
            apart.cycle,
            True,
        )  # the strongest tone is then no harmonic, though a speed nearby makes it one
    by_pulse = _pulse_cycle(recording, start, start + samples.shape[1], stated, note)
    if by_pulse is not None:
        found = by_pulse
        if follows and by_comb.sd < found.sd:  # the pulse is right to a revolution, the harmonics are finer
            near = abs(by_comb.cycle - found.cycle) < 5 * np.hypot(found.sd, by_comb.sd)
            found = by_comb if near else found
    else:
        found = by_comb if follows else Cycle(stated, 0.005 * stated)
    if abs(found.cycle / stated - 1) > FAR_FROM_STATED:
        note(
            "speed-off",
            f"the record says {found.cycle / stated - 1:+.1%} against the stated spindle speed; the measured one is used, "
            "check the speed and the sample rate",
        )
    if not follows:
        note(
            "not-synchronous",
            "nothing in the signal follows a spindle near the stated speed; is it the speed of this cut?",
        )
    return found, follows


def _by_harmonics(samples: np.ndarray, stated: float, teeth: int) -> tuple[Cycle, tuple[int, ...]]:
    """The speed near the stated one; one farther off where far more follows that, or where nothing follows the near one, with
    the tooth passing itself, since overtones of chatter are a comb as well."""
    harmonics = max(HARMONICS, 6 * teeth)
    near, seen = comb_cycle(samples, stated, harmonics=harmonics, every=teeth, span=NEAR)
    far, more = comb_cycle(samples, stated, harmonics=harmonics, every=teeth, span=FAR)
    of_teeth = sum(k % teeth == 0 for k in more)
    many = len(more) >= max(MANY, MORE * len(seen)) or (of_teeth >= FEWEST_OF_TEETH and not _follows(seen, teeth))
    believed = many and teeth in more
    return (far, more) if believed else (near, seen)


def _follows(seen: tuple[int, ...], teeth: int) -> bool:
    """Whether the harmonics that stand out are enough to tell a speed."""
    of_teeth = any(k % teeth == 0 for k in seen)
    return len(seen) >= (FEWEST_SEEN if of_teeth else FEWEST_OTHERS) or seen == (teeth,)


class Apart(NamedTuple):
    """A speed by the distances between tones."""

    chance: float  # that tones lie so at random
    cycle: Cycle
    strongest: float  # frequency of the strongest tone, cycles per sample
    line: float  # cycles per sample

    def leaves(self, cycle: float) -> bool:
        """Whether the strongest tone is no harmonic by this speed, but one by another."""
        off = abs(float(folded(self.strongest, self.cycle.cycle)))
        return off > self.line and off > 3 * float(folded(self.strongest, cycle))


def _by_distances(samples: np.ndarray, stated: float, teeth: int) -> Apart | None:
    """The speed by which tones lie whole turns from the strongest; None where so many might do so by chance.

    A tone d away is k turns from it at the speed d / k. That this is as near the stated speed as it is, by chance, has the
    probability 2 k times the relative distance; that another tone then fits, that of two lines in one turn.
    """
    n = samples.shape[1]
    size = fast_length(n)
    line = 1.0 / size
    best: Apart | None = None
    for row in range(len(samples)):
        read = reader_of(samples[row : row + 1] - samples[row].mean())
        spectrum = residual_spectra(read, 0, size, 1, stated, np.zeros((1, 2), complex))
        tones = [tone for tone in find_tones(spectrum, 0, stated, np.zeros(2, complex)) if tone.sharp][:TONES]
        tones = [tone for tone in tones if tone.power > SMALLEST * tones[0].power]
        if len(tones) < 2 or _multiples(np.array([tone.frequency for tone in tones]), line):
            continue
        away = np.abs(np.array([tone.frequency for tone in tones[1:]]) - tones[0].frequency)
        sd = np.hypot([tone.deviation for tone in tones[1:]], tones[0].deviation) + 0.1 * line
        for distance in away:
            k = round(distance / stated)
            if not 1 <= k <= FARTHEST * teeth or abs(distance / k / stated - 1) > NEAR:
                continue
            turns = np.rint(away * k / distance)
            reach = 0.3 * line + 3 * sd
            fit = (turns >= 1) & (np.abs(away - turns * distance / k) < reach)
            weight = (turns / sd)[fit] ** 2
            cycle = float(np.sum(weight * away[fit] / turns[fit]) / weight.sum())
            off = max(abs(cycle / stated - 1), line / distance)
            others = np.sort(2 * reach[fit] / cycle)[1:]
            chance = 2 * k * off * float(np.prod(np.minimum(others, 1.0)))
            if chance < BY_CHANCE and (best is None or chance < best.chance):
                best = Apart(chance, Cycle(cycle, float(1 / np.sqrt(weight.sum()))), tones[0].frequency, line)
    return best


def _multiples(frequency: np.ndarray, line: float) -> bool:
    """Whether all are multiples of one frequency, as the teeth at another speed would leave them."""
    for part in range(1, 5):
        base = frequency.min() / part
        if np.all(np.abs(frequency - np.rint(frequency / base) * base) < line):
            return bool(base > 4 * line)
    return False


def _pulse_cycle(recording: Recording, start: int, stop: int, stated: float, note: Note) -> Cycle | None:
    rows = recording.rows_of("pulse")
    if not rows:
        return None
    times = pulse_times(reader(recording, rows[:1]), start, stop)
    kept, number = number_pulses(times, 1 / stated)
    expected = (stop - start) * stated
    if len(kept) < max(3, 0.5 * expected):
        note("pulse-unusable", f"{len(times)} pulses in {expected:.0f} revolutions: not used")
        return None
    slope, origin = np.polyfit(number, times[kept], 1)
    scatter = float(np.std(times[kept] - slope * number - origin))
    if scatter > PULSE_SCATTER * slope:
        note("pulse-unusable", "the pulses do not come at an even pace: not used")
        return None
    sd = max(scatter, 0.05) * np.sqrt(12 / len(kept)) / max(float(np.ptp(number)), 1.0)
    return Cycle(float(1 / slope), float(sd / slope**2))
