"""What is left of a signal when its harmonics of the spindle are taken out, and which of its tones are the cut's.

A tone of the machine is heard in the air as well; hum of the mains sits at multiples of 50 or 60 Hz and has no company; a
harmonic of the teeth above half the sample rate comes back folded. What is left are tones that the waves between the teeth
have made: sharp, and a whole number of tooth passings apart.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from millcal.numerics import spectra
from millcal.numerics.residual_lines import ResidualSpectra, fast_length, residual_spectra
from millcal.numerics.tones import Tone, families, find_tones, folded, surroundings

MOST_HARMONICS = 400  # taken out
REVOLUTIONS = 400  # of one spectrum
LARGEST_WANDER = 2e-3
IN_AIR = 0.5  # of the amplitude in the cut: the tone is the machine's
HUM = (50.0, 60.0)  # Hz
HIGHEST_HUM = 650.0  # Hz
LOW_HUM = 350.0  # Hz; a higher one is no louder than the loudest up to here
LARGEST_HUM = 0.1  # of the power: more is no hum
ALONE = 0.05  # of its power: smaller company says nothing
OVERTONES = 4  # of the chatter frequency that belong to it
FOLDS = 3
LARGEST_FOLDED = 0.1  # share of the power: more is no high harmonic folded
AS_LARGE = (
    4.0  # times the largest harmonic of the teeth in the upper half of the spectrum; beyond, harmonics are smaller
)
BLOCKS = 12
BROAD_BANDS = 64  # of the spectrum, in which a hump too wide for a line is looked for
FLOOR = 0.25  # quantile of them that is taken for noise
HUMP, FOOT = 100.0, 10.0  # a band over it, from which it is the top of a hump, and of its foot
SURELY_FOLDED = (
    0.03  # probability that a tone lies so by chance, up to which a large one is taken for a folded harmonic
)


class Remains(NamedTuple):
    """One channel, its harmonics taken out."""

    row: int
    signal: np.ndarray  # (sample,), mean taken out
    rest: np.ndarray  # (sample,)
    harmonics: np.ndarray  # complex (K + 1,)
    noise: np.ndarray  # (K + 1,) mean square of noise in each harmonic
    spectra: ResidualSpectra  # of the rest
    tones: list[Tone]  # all
    family: list[Tone]  # those of the chatter, the strongest first
    humps: list[Tone]
    folded_from: float | None  # Hz, a harmonic of the teeth that the strongest tone of the family may be, come back
    machine: list[tuple[Tone, str]]  # tones that are not the cut's, and why
    followed: float  # mean square that follows the spindle, noise taken off
    share: float  # of the family, of all that is no noise
    hump_share: float

    @property
    def power(self) -> float:
        """Mean square of all that is no noise."""
        return self.followed + sum(tone.power for tone in self.tones)


def look(
    row: int,
    signal: np.ndarray,
    air: np.ndarray | None,
    cycle: float,
    cycle_sd: float,
    teeth: int,
    rate: float,
    rolled_off: bool | None = None,
) -> Remains:
    """Take the harmonics out of one channel and sort the tones that remain.

    signal : (sample,) of the cut   air : (sample,) of the air   cycle : turns per sample   rate : Hz
    """
    signal = _without_drift(signal)
    n = len(signal)
    read = spectra.reader_of(signal[np.newaxis])
    K = max(1, min(MOST_HARMONICS, int(0.49 / cycle)))
    harmonics = spectra.fit_harmonics(read, 0, n, cycle, K)
    count = max(1, int(np.ceil(n * cycle / REVOLUTIONS)))
    size = fast_length(n // count)
    rest = signal - spectra.evaluate(harmonics, cycle, 0, n)[0]
    spectrum = residual_spectra(read, 0, size, count, cycle, harmonics)
    tones = find_tones(spectrum, 0, cycle, harmonics[0], wander=_wander(read, n, cycle, harmonics[0], teeth))
    level = surroundings(spectrum.power[0], 101)
    place = np.minimum(np.rint(np.arange(K + 1) * cycle * size).astype(int), len(level) - 1)
    noise = 2 * level[place] / np.log(2) / n  # of 0.5 |c|^2
    own = 0.5 * np.abs(harmonics[0]) ** 2
    own[0] = 0.0
    followed = float(np.sum(np.maximum(own - noise, 0.0)[own > 4 * noise]))
    sharp = [tone for tone in tones if tone.sharp]
    whole = max(followed + sum(tone.power for tone in tones), 1e-300)
    groups = families(sharp, cycle, 1.0 / size)
    rolled_off = falls_off(spectrum.power[0]) if rolled_off is None else rolled_off
    upper = own[teeth * int(np.ceil(0.25 / (teeth * cycle))) :: teeth]  # from a quarter of the sample rate on
    foldable = 0.0 if rolled_off else AS_LARGE * float(upper.max(initial=0.0))
    machine: list[tuple[Tone, str]] = []
    left = []
    loudest_hum = {
        hum: max((t.power for t in sharp if t.frequency * rate < LOW_HUM and _is_hum(t, hum, rate, size)), default=0.0)
        for hum in HUM
    }
    for group in groups:
        why = _not_of_the_cut(
            group,
            sum(tone.power for tone in group) / whole,
            air,
            cycle,
            cycle_sd,
            teeth,
            rate,
            size,
            foldable,
            loudest_hum,
        )
        machine += [(tone, why) for tone in group] if why else []
        left += [] if why else [group]
    family: list[Tone] = []
    if left:
        family = list(left[0])
        for group in left[1:]:
            if _overtone(group[0], family[0], cycle, size):
                family += group
        family.sort(key=lambda tone: -tone.power)
    humps = [tone for tone in tones if not tone.sharp]
    wide = _wide_hump(spectrum, air, humps, 0.5 * teeth * cycle)
    if wide is not None:
        humps = [wide]
        whole += wide.power
    return Remains(
        row,
        signal,
        rest,
        harmonics[0],
        noise,
        spectrum,
        tones,
        family,
        humps,
        None if rolled_off or not family else _folded_from(family, cycle, cycle_sd, teeth, rate, size),
        machine,
        followed,
        sum(tone.power for tone in family) / whole,
        sum(tone.power for tone in humps) / whole,
    )


def _without_drift(signal: np.ndarray) -> np.ndarray:
    """The signal without its mean, slope and bend, which in a short record reach into the lowest lines.   signal : (sample,)"""
    x = np.linspace(-1.0, 1.0, len(signal))
    for shape in (np.ones_like(x), x, x**2 - np.mean(x**2)):
        signal = signal - shape * (shape @ signal) / (shape @ shape)
    return signal


def _wander(read: spectra.Reader, n: int, cycle: float, harmonics: np.ndarray, teeth: int) -> float:
    """How much the speed wanders, relative: from the phase of the strongest harmonic of the teeth, block by block."""
    orders = np.arange(teeth, len(harmonics), teeth)
    if not len(orders):
        return 0.0
    k = int(orders[np.argmax(np.abs(harmonics[orders]))])
    edges = np.rint(np.linspace(0, n, int(np.clip(n * cycle / 8, 2, 64)) + 1)).astype(int)
    found = spectra.block_harmonics(read, edges, cycle, k)[:, 0, k]
    step = np.angle(found[1:] * found[:-1].conj())
    return float(min(np.std(step) / (2 * np.pi * k * cycle * np.diff(edges).mean()), LARGEST_WANDER))


def _wide_hump(spectrum: ResidualSpectra, air: np.ndarray | None, humps: list[Tone], lowest: float) -> Tone | None:
    """A hump so wide that it hides its own surroundings, as chatter without order makes it; None where bands stand out no more than
    noise does, or than they do in the air.   lowest : cycles per sample
    """
    power, size = spectrum.power[0].copy(), spectrum.size
    first = int(np.ceil(lowest * size))
    edges = np.linspace(first, len(power), BROAD_BANDS + 1).astype(int)
    if len(power) - first < 4 * BROAD_BANDS:
        return None
    if air is not None and len(air) > 4 * BROAD_BANDS:
        window = np.hanning(len(air) + 1)[:-1]
        calm = np.abs(np.fft.rfft((air - air.mean()) * window)) ** 2 / np.sum(window**2)
        power -= np.interp(spectrum.frequency, np.arange(len(calm)) / len(air), calm)
    usual = np.array([np.median(power[a:b]) for a, b in pairwise(edges)])
    floor = max(float(np.quantile(usual, FLOOR)), 1e-300)
    top = int(np.argmax(usual))
    if usual[top] < HUMP * floor:
        return None
    part = np.flatnonzero(usual > FOOT * floor)
    held = sum(float(np.sum(power[edges[i] : edges[i + 1]] - floor)) for i in part)
    if 2 * held / size < 2 * sum(hump.power for hump in humps):  # told by these
        return None
    at = np.arange(edges[top], edges[top + 1])
    weight = np.maximum(power[at], 0.0)
    return Tone(
        float(np.sum(at * weight) / weight.sum()) / size, float(edges[1] - edges[0]) / size, 2 * held / size, False
    )


def _folded_from(family: list[Tone], cycle: float, cycle_sd: float, teeth: int, rate: float, size: int) -> float | None:
    """The frequency in Hz above half the sample rate at which a harmonic of the teeth would come back as the strongest tone."""
    tone, passing = family[0], teeth * cycle
    for fold in range(1, FOLDS + 1):
        for above in (fold - tone.frequency, fold + tone.frequency):
            reach = 0.3 / size + 3 * tone.deviation + 3 * above / cycle * cycle_sd
            if above > 0.5 and folded(above, passing) < reach and 4 * FOLDS * reach / passing < SURELY_FOLDED:
                return float(above * rate)
    return None


def falls_off(power: np.ndarray) -> bool:
    """Whether the noise falls off towards half the sample rate, as an anti-aliasing filter makes it.   power : (line,)"""
    lines = len(power)
    end, middle = power[int(0.96 * lines) :], power[int(0.4 * lines) : int(0.8 * lines)]
    return bool(len(end) > 4 and np.median(end) < 0.03 * np.median(middle))


def _not_of_the_cut(
    group: list[Tone],
    share: float,
    air: np.ndarray | None,
    cycle: float,
    cycle_sd: float,
    teeth: int,
    rate: float,
    size: int,
    foldable: float,
    loudest_hum: dict[float, float],
) -> str:
    """Why the tones of a family are none of chatter; empty where they are.

    foldable : power up to which one may be folded   loudest_hum : power of the loudest low line of each mains frequency
    """
    tone = group[0]
    heard = air is not None and len(air) > 16 / cycle
    if heard and amplitude_at(air, tone.frequency) > IN_AIR * np.sqrt(2 * tone.power):
        return "heard in the air as well: the machine's"
    if share < LARGEST_HUM:
        for hum in HUM:
            large = [other for other in group if other.power > ALONE * tone.power]
            of_teeth = [t for t in large[1:] if abs(t.frequency - tone.frequency) > 0.4 * teeth * cycle]
            quiet = all(t.power <= loudest_hum[hum] for t in large if t.frequency * rate >= LOW_HUM)
            if quiet and all(_is_hum(other, hum, rate, size) for other in (large if of_teeth else large[:1])):
                return f"a multiple of {hum:g} Hz: hum of the mains"
    if share < LARGEST_FOLDED and tone.power < foldable:
        passing = teeth * cycle
        for fold in range(1, FOLDS + 1):
            for above in (fold - tone.frequency, fold + tone.frequency):
                reach = 1.0 / size + 3 * above / cycle * cycle_sd
                if folded(above, passing) < min(reach, 0.05 * passing):
                    return "where a harmonic of the tooth passing above half the sample rate comes back"
    return ""


def _is_hum(tone: Tone, hum: float, rate: float, size: int) -> bool:
    f = tone.frequency * rate
    return bool(hum / 2 < f < HIGHEST_HUM and folded(f, hum) < rate * (0.5 / size + 3 * tone.deviation))


def _overtone(tone: Tone, of: Tone, cycle: float, size: int) -> bool:
    """Whether a tone lies at a multiple of another, give or take whole turns of the spindle."""
    for m in range(2, OVERTONES + 1):
        reach = (1.0 + 0.5 * m) / size + 3 * (tone.deviation + m * of.deviation)
        if abs(float(folded(tone.frequency, cycle)) - float(folded(m * of.frequency, cycle))) < reach:
            return True
    return False


def amplitude_at(signal: np.ndarray, frequency: float) -> float:
    """Amplitude of a tone at a known frequency.   signal : (sample,)   frequency : cycles per sample"""
    window = np.hanning(len(signal) + 2)[1:-1]
    turn = np.exp(-2j * np.pi * (np.arange(len(signal)) * frequency % 1.0))
    return float(2 * np.abs(np.sum(window * (signal - signal.mean()) * turn)) / window.sum())


def course(signal: np.ndarray, frequency: float, blocks: int = BLOCKS) -> np.ndarray:
    """Amplitude of a tone in equal parts of a signal.   returns (block,)"""
    return np.array([amplitude_at(part, frequency) for part in np.array_split(signal, blocks)])
