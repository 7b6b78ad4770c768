"""A judged cut as the page draws it: its spectrum with the harmonics of the teeth, what remains, and the motion once per tooth."""

import numpy as np

from millcal.data import Judgement
from millcal.report import charts
from millcal.report.charts import HALF, Band, Frame, Item, Line, Marks, Panel, Span, Tags, chart, span_of
from millcal.report.digits import significant
from millcal.report.figures import ENVELOPE, POINTS, Column, Figure, envelope
from millcal.report.wording import time_unit

BEAT = {"tooth": "tooth", "revolution": "turn"}
SYMBOLS = {
    "displacement": ("x", "µm", 1e6),
    "acceleration": ("a", "m/s²", 1.0),
    "velocity": ("v", "mm/s", 1e3),
    "force": ("F", "N", 1.0),
    "sound_pressure": ("p", "Pa", 1.0),
    "sound": ("p", "FS", 1.0),
}  # letter, unit of the figures, factor from SI
BEYOND = 2.5  # times the highest frequency that matters, to which the spectrum is drawn
FEWEST_PASSINGS = 8
DECADES = 4.5


def highest_drawn(found: Judgement) -> float:
    """Hz: as far as lines stand out."""
    passing = found.teeth * found.spindle_frequency
    wanted = [BEYOND * peak.frequency for peak in found.peaks[:1]]
    wanted += [FEWEST_PASSINGS * passing, BEYOND * (found.chatter_frequency or 0.0)]
    return float(min(max(wanted), found.frequency[-1]))


def marked_lines(found: Judgement) -> list[tuple[float, float]]:
    """Frequency and amplitude of the chatter and its company, the strongest first; of a flip its line alone."""
    if found.chatter_frequency is None:
        return []
    near = [(peak.frequency, peak.amplitude) for peak in found.peaks if peak.frequency <= highest_drawn(found)]
    if found.peaks and abs(found.peaks[0].frequency - found.chatter_frequency) < 1e-6 * found.chatter_frequency:
        return near[:6]
    at = int(np.argmin(np.abs(found.frequency - found.chatter_frequency)))
    around = slice(max(at - 2, 0), at + 3)
    return [(found.chatter_frequency, float(found.spectrum[around].max()))]


def amplitude_range(found: Judgement) -> tuple[float, float]:
    """SI: the highest line and the decades under it that are worth a look."""
    drawn = found.frequency <= highest_drawn(found)
    drawn[: max(1, int(np.searchsorted(found.frequency, 0.3 * found.spindle_frequency)))] = False
    top = float(found.spectrum[drawn].max()) if drawn.any() else 1.0
    floor = float(np.median(found.remaining[drawn])) if drawn.any() else 0.0
    return max(0.3 * floor, top * 10**-DECADES, 1e-300), 2.0 * top


def spectrum(found: Judgement) -> Figure:
    """Amplitudes as recorded and after the harmonics of the spindle are taken out."""
    letter, unit, factor = SYMBOLS[found.quantity]
    high = highest_drawn(found)
    drawn = found.frequency <= high
    f, whole, rest = found.frequency[drawn], factor * found.spectrum[drawn], factor * found.remaining[drawn]
    low, top = (factor * value for value in amplitude_range(found))
    kept = np.union1d(charts.thin(f, np.log(whole + 1e-300), POINTS), charts.thin(f, np.log(rest + 1e-300), POINTS))
    passing = found.teeth * found.spindle_frequency
    teeth = passing * np.arange(1, int(high / passing) + 1)
    items: list[Item] = [
        Line(f[kept], np.maximum(whole[kept], low), "measured thin"),
        Line(f[kept], np.maximum(rest[kept], low), "main"),
    ]
    marked = marked_lines(found)
    at = np.array([value for value, _ in marked])
    size = factor * np.array([value for _, value in marked])
    if marked:
        items.append(Marks(at, size, "modelled", "diamond", [f"{at[0]:.5g} Hz"], size=4.5))
    items.append(Tags(teeth[:6].tolist(), [str(k) for k in range(1, min(len(teeth), 6) + 1)]))
    label = (
        f"Amplitude spectrum of {found.channel} to {high:.0f} Hz, as recorded and without the harmonics of the spindle"
    )
    svg = chart(
        [Panel(f"amplitude |{letter}|, {unit}", items, 220, (low, top), log=True, most_ticks=6)],
        x_label="frequency, Hz",
        x_range=(0.0, high),
        label=label + (f"; the chatter at {at[0]:.5g} Hz" if marked else ""),
        frame=Frame(),
        hover=True,
    )
    columns = [
        Column("frequency", "Hz", f[kept]),
        Column("as recorded", unit, whole[kept]),
        Column("remains", unit, rest[kept]),
    ]
    key = [("line measured thin", "as recorded"), ("line main", "without the harmonics of the spindle")]
    if marked:
        key.append(("marks diamond modelled", "lines of the chatter"))
    caption = (
        f"Numbers above: harmonics of the tooth passing, {significant(passing, 5)} Hz. What follows the spindle is taken out with "
        "the speed that the record itself tells; chatter is what remains and is sharp."
    )
    return Figure("judge-spectrum", "What does not follow the teeth", caption, (svg,), columns, key, hint="frequency")


def once_per_tooth(found: Judgement) -> Figure:
    """The motion once per tooth, or per turn, against time, and each against the one before."""
    beat = BEAT[found.per]
    letter, unit, factor = SYMBOLS[found.quantity]
    value, time = factor * found.once_per_tooth, found.sample_time
    scale, word = time_unit(float(time[-1]) if len(time) else 1.0)
    reach = span_of(value)
    dots: list[Item] = [Marks(time / scale, value, "sampled", "dot", size=1.6)]
    over = chart(
        [Panel(f"{letter} once per {beat}, {unit}", dots, 190, reach)],
        x_label=f"time, {word}",
        x_range=(float(time[0]) / scale, float(time[-1]) / scale),
        label=f"{found.channel} sampled once per {beat} against time",
        frame=HALF,
    )
    pairs: list[Item] = [
        Line(np.array(reach), np.array(reach), "rule"),
        Marks(value[:-1], value[1:], "sampled", "dot", size=1.6),
    ]
    back = chart(
        [Panel(f"next {beat}, {unit}", pairs, 190, reach)],
        x_label=f"this {beat}, {unit}",
        x_range=reach,
        label=f"{found.channel} at each {beat} against the {beat} before",
        frame=HALF,
    )
    columns = [Column("time", "s", time), Column(f"{letter} once per {beat}", unit, value)]
    caption = (
        "A cut that repeats with every tooth is a point; runout makes as many points as there are teeth, a motion of period "
        "n makes n, and chatter a closed curve."
        if found.per == "tooth"
        else "A cut that repeats with every turn is a point, a motion of period n makes n, and chatter a closed curve."
    )
    return Figure("judge-teeth", f"Once per {beat}", caption, (over, back), columns, (), "halves")


def overview(found: Judgement) -> Figure:
    """The whole record as an envelope, with what was judged."""
    letter, unit, factor = SYMBOLS[found.quantity]
    starts, low, high = envelope(
        factor * found.overview_low[np.newaxis], factor * found.overview_high[np.newaxis], ENVELOPE
    )
    time = found.overview_time[starts]
    items: list[Item] = [Span(*found.steady, "steady", "judged"), Band(time, low[0], high[0], "signal")]
    svg = chart(
        [Panel(f"{letter}, {unit}", items, 90, span_of(low[0], high[0], include=(0.0,)), most_ticks=4)],
        x_label="time, s",
        x_range=(min(0.0, float(time[0])), float(time[-1])),
        label=f"Envelope of {found.channel}; judged from {found.steady[0]:.3g} to {found.steady[1]:.3g} s",
        frame=Frame(),
    )
    columns = [Column("time", "s", time), Column("lowest", unit, low[0]), Column("highest", unit, high[0])]
    return Figure("judge-overview", "The record", "Lowest and highest of every short stretch.", (svg,), columns)


def figures(found: Judgement) -> list[Figure]:
    """All figures of a judged cut."""
    return [spectrum(found), once_per_tooth(found), overview(found)]
