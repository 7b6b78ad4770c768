"""A judged cut for print: its spectrum and what remains of it, the record, and the motion once per tooth."""

from typing import Any

import numpy as np

from millcal.data import Judgement
from millcal.report.charts import span_of, thin
from millcal.report.judge_figure import BEAT, SYMBOLS, amplitude_range, highest_drawn, marked_lines
from millcal.report.paper import sheet
from millcal.report.wording import time_unit

POINTS = 1600
MOST_TEETH = 600  # dots that can be told apart


def judgement_file(found: Judgement, format: str) -> bytes:
    """The sheet as a file of one of `sheet.FORMATS`; the same record gives the same bytes."""
    with sheet.style():
        return sheet.file_bytes(judgement_sheet(found), format)


def judgement_sheet(found: Judgement) -> Any:
    """One figure: spectrum over the width; under it the record, and each tooth against the one before."""
    figure, (upper, lower) = sheet.stacked(sheet.DOUBLE, 120.0, [((1.35,), 1), ((1.0,), 3)])
    entries: dict[str, Any] = {}
    _spectrum(found, upper[0, 0], entries)
    _overview(found, lower[0, 0], entries)
    _teeth(found, lower[0, 1], lower[0, 2], entries)
    period = f", period {found.period}" if found.verdict == "period-n" else ""
    at = f", {found.chatter_frequency:.5g} Hz" if found.chatter_frequency is not None else ""
    beat = BEAT[found.per]
    panels = [upper[0, 0], *lower[0]]
    sheet.letters(panels, [f"{found.verdict}{period}{at}", "record", f"once per {beat}", f"{beat} by {beat}"])
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=4)
    return figure


def _spectrum(found: Judgement, panel: Any, entries: dict[str, Any]) -> None:
    _, unit, factor = SYMBOLS[found.quantity]
    high = highest_drawn(found)
    low, top = (factor * value for value in amplitude_range(found))
    drawn = found.frequency <= high
    f = found.frequency[drawn]
    for name, amplitude, style in (
        ("as recorded", found.spectrum, {"color": sheet.MUTED, "linewidth": 0.7}),
        ("without the harmonics of the spindle", found.remaining, {"color": sheet.MAIN, "linewidth": 0.9}),
    ):
        y = np.maximum(factor * amplitude[drawn], 0.5 * low)
        kept = thin(f, np.log(y), POINTS)
        (entries[name],) = panel.plot(f[kept], y[kept], **style)
    passing = found.teeth * found.spindle_frequency
    for k in range(1, int(high / passing) + 1):
        panel.axvline(k * passing, ymin=0.96, color=sheet.INK, linewidth=0.8)
    (entries["tooth passing"],) = panel.plot(
        [], [], "|", color=sheet.INK, markersize=6, linestyle="none"
    )  # a tick, no line
    marked = marked_lines(found)
    if marked:
        at, size = zip(*marked, strict=True)
        (entries["lines of the chatter"],) = panel.plot(
            at, factor * np.array(size), "D", color=sheet.MODEL, markersize=3.5, zorder=4, linestyle="none"
        )
    sheet.scale(panel, "x", (0.0, high), label="frequency (Hz)", most=10)
    sheet.scale(panel, "y", (low, top), label=f"amplitude ({unit})", log=True, most=6)


def _overview(found: Judgement, panel: Any, entries: dict[str, Any]) -> None:
    letter, unit, factor = SYMBOLS[found.quantity]
    scale, word = time_unit(float(found.overview_time[-1]))
    entries["judged"] = panel.axvspan(found.steady[0] / scale, found.steady[1] / scale, color=sheet.STABLE)
    low, high = factor * found.overview_low, factor * found.overview_high
    panel.fill_between(found.overview_time / scale, low, high, color=sheet.MAIN, linewidth=0.3)
    sheet.scale(panel, "x", (0.0, float(found.overview_time[-1]) / scale), label=f"time ({word})", most=4)
    sheet.scale(panel, "y", span_of(low, high, include=(0.0,)), label=f"${letter}$ ({unit})", most=4)


def _teeth(found: Judgement, over: Any, back: Any, entries: dict[str, Any]) -> None:
    letter, unit, factor = SYMBOLS[found.quantity]
    value, time = factor * found.once_per_tooth[-MOST_TEETH:], found.sample_time[-MOST_TEETH:]
    scale, word = time_unit(float(found.overview_time[-1]))
    reach = span_of(value)
    dots = {"color": sheet.MAIN, "markersize": 1.8, "linestyle": "none", "markeredgewidth": 0}
    over.plot(time / scale, value, "o", **dots)
    ends = (float(time[0]) / scale, float(time[-1]) / scale)
    sheet.scale(over, "x", ends if ends[1] > ends[0] else (ends[0], ends[0] + 1), label=f"time ({word})", most=4)
    sheet.scale(over, "y", reach, label=f"${letter}$ ({unit})", most=4)
    back.plot(reach, reach, color=sheet.MUTED, linewidth=0.6, linestyle=":")
    (entries[f"once per {BEAT[found.per]}"],) = back.plot(value[:-1], value[1:], "o", **dots)
    sheet.scale(back, "x", reach, label=f"this {BEAT[found.per]} ({unit})", most=4)
    sheet.scale(back, "y", reach, label=f"next {BEAT[found.per]} ({unit})", most=4)
