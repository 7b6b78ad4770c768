"""How good recorded accelerations are: whole records, what follows the spindle, lines that do not."""

from collections.abc import Sequence

import numpy as np

from millcal.data import CutVibration
from millcal.report import blocks
from millcal.report.charts import HALF, Band, Item, Panel, Rule, Span, chart, span_of
from millcal.report.digits import decimals_for, fixed, nominal, significant
from millcal.report.figures import ENVELOPE, Column, Figure, envelope
from millcal.report.tables import MOST_PEAKS, Table
from millcal.report.wording import cut_names

MOST_RECORDS = 4  # that are drawn
MOST_PANELS = 8  # sensors of a record that are drawn
ANGLES = {"speed": "not known, fitted", "pulse": "from the pulse", "encoder": "from the encoder", "stated": "stated"}


def quality(cuts: Sequence[CutVibration]) -> list[dict | None]:
    """The blocks of the section: tables, then the records."""
    if not cuts:
        return []
    chosen = np.unique(np.linspace(0, len(cuts) - 1, min(len(cuts), MOST_RECORDS)).round().astype(int))
    shown = [cuts[number] for number in chosen.tolist()]
    caption = "Lowest and highest acceleration of every short stretch. Shaded: the steady part, which was used."
    if len(shown) < len(cuts):
        caption += f" {len(shown)} of {len(cuts)} cuts are drawn."
    if any(len(cut.sensors) > MOST_PANELS for cut in shown):
        caption += f" The first {MOST_PANELS} sensors."
    key = (("span steady", "steady cut"), ("span signal", "envelope of the acceleration"))
    names = cut_names(cut.name for cut in cuts)
    drawn = [overview(cut, names[cut.name], number) for number, cut in enumerate(shown)]
    return [
        blocks.table(revolutions(cuts)),
        blocks.table(synchronous(cuts)),
        blocks.table(peaks(cuts)),
        blocks.figures(drawn, "The whole records", caption, "halves", key),
    ]


def overview(cut: CutVibration, name: str, number: int) -> Figure:
    """The whole record as envelopes, a panel for each sensor."""
    starts, low, high = envelope(cut.overview_low, cut.overview_high, ENVELOPE)
    time = cut.overview_time[starts]
    panels = []
    columns = [Column("time", "s", time)]
    for row, sensor in enumerate(cut.sensors[:MOST_PANELS]):
        items: list[Item] = [Span(*cut.steady, "steady", "steady" if row == 0 else "")]
        items += [Rule(0.0, "y", "zero"), Band(time, low[row], high[row], "signal")]
        panels.append(Panel(f"{sensor}, m/s²", items, 46, span_of(low[row], high[row], include=(0.0,)), most_ticks=3))
        columns += [Column(f"{sensor} lowest", "m/s²", low[row]), Column(f"{sensor} highest", "m/s²", high[row])]
    label = (
        f"Acceleration against time of cut {name} of {len(cut.sensors)} sensors as envelopes; steady from "
        f"{cut.steady[0]:.2f} to {cut.steady[1]:.2f} s"
    )
    ends = (min(0.0, float(time[0])), float(time[-1]))
    svg = chart(panels, x_label="time, s", x_range=ends, label=label, frame=HALF)
    return Figure(f"vibration-{number}", name, "", (svg,), columns)


def revolutions(cuts: Sequence[CutVibration]) -> Table:
    """What was used of each cut, and where its angle comes from."""
    short = cut_names(cut.name for cut in cuts)
    rows = []
    for cut in cuts:
        decimals = decimals_for(60 * cut.spindle_frequency_sd, 60 * cut.spindle_frequency)
        rows.append(
            [
                short[cut.name],
                fixed(60 * cut.spindle_frequency, min(decimals, 3)),
                str(cut.revolutions),
                fixed(cut.steady[1] - cut.steady[0], 2),
                nominal(cut.sample_rate),
                ANGLES.get(cut.angle_from, cut.angle_from),
            ]
        )
    headings = ("cut", "refined, rpm", "revolutions", "steady, s", "rate, Hz", "angle of tooth 0")
    return Table("What was used of each cut", headings, rows, words=(0, 5))


def synchronous(cuts: Sequence[CutVibration]) -> Table:
    """How well each sensor of each cut follows the spindle."""
    short = cut_names(cut.name for cut in cuts)
    rows = [
        [
            short[cut.name],
            sensor,
            significant(float(cut.ac_rms[row])),
            fixed(100 * float(cut.synchronous_share[row]), 2),
            significant(float(cut.asynchronous_rms[row])),
        ]
        for cut in cuts
        for row, sensor in enumerate(cut.sensors)
    ]
    headings = ("cut", "sensor", "AC, m/s² rms", "follows the spindle, %", "rest, m/s² rms")
    note = "The rest is what no harmonic of the spindle explains: chatter, spindle bearings, other machines, noise."
    return Table("Do the accelerations follow the spindle?", headings, rows, words=(0, 1), note=note)


def peaks(cuts: Sequence[CutVibration]) -> Table | None:
    """Lines of the spectrum that are no harmonics of the spindle."""
    short = cut_names(cut.name for cut in cuts)
    found = sorted(((peak, cut.name) for cut in cuts for peak in cut.peaks), key=lambda pair: -pair[0].exceeds)
    kept = {id(peak) for peak, _ in found[:MOST_PEAKS]}
    rows = [
        [short[cut.name], peak.axis, fixed(peak.frequency, 1), significant(peak.amplitude), fixed(peak.exceeds, 1)]
        for cut in cuts
        for peak in cut.peaks
        if id(peak) in kept
    ]
    if not rows:
        return None
    headings = ("cut", "sensor", "frequency, Hz", "amplitude, m/s²", "times its surroundings")
    more = f"The {len(rows)} clearest of {len(found)}. " if len(rows) < len(found) else ""
    note = f"{more}A line that is no harmonic may be chatter, a bearing, a resonance rung by every tooth, or mains."
    return Table("Lines that are no harmonics of the spindle", headings, rows, words=(0, 1), note=note)
