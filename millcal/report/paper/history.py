"""Coefficients that change while cutting, for print: their course, the force in windows, and what was not foreseen."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from millcal.data import CoefficientHistory
from millcal.report.charts import span_of, thin
from millcal.report.digits import nominal, significant
from millcal.report.history_figures import (
    cut_spans,
    expected_mean,
    expected_rms,
    innovations_are_known,
    range_of,
    stretches,
    time_ends,
)
from millcal.report.paper import sheet
from millcal.report.paper.coefficients import symbol
from millcal.report.wording import SIDES, parameter, time_unit

POINTS = 800  # of a line; the sheet is as wide as two columns
WINDOWS = 3  # abreast
STRETCHES = 40  # of the whole time, for the innovations
_MARKERS = ("o", "s", "D")


def history_file(history: CoefficientHistory, format: str) -> bytes:
    """The sheet as a file of one of `sheet.FORMATS`; the same record gives the same bytes."""
    with sheet.style():
        return sheet.file_bytes(history_sheet(history), format)


def history_sheet(history: CoefficientHistory) -> Any:
    """One figure: specific force and coefficients over time, forces start, middle and end, innovations."""
    numbers = np.unique(history.shown_window)
    chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), WINDOWS)).round().astype(int))]
    with_innovations = innovations_are_known(history)
    groups: list = [((1.25, 1.0, 1.0), len(history.directions)), ((1.0,) * len(history.axes), len(chosen))]
    groups += [((1.1,), 2)] if with_innovations else []
    height = 24.0 * sum(sum(heights) for heights, _ in groups) + 40.0
    figure, panels = sheet.stacked(sheet.DOUBLE, height, groups)
    course, forces = panels[:2]
    entries: dict[str, Any] = {}
    unit, word = time_unit(float(history.time[-1] - history.time[0]))
    _specific(history, course[0], entries, unit)
    for row, first in ((1, 0), (2, len(history.directions))):
        _coefficients(history, course[row], first, entries, unit, word)
    for column, number in enumerate(chosen.tolist()):
        place = ("start", "middle", "end")[column] if len(chosen) == WINDOWS else "window"
        _window(history, number, forces[:, column], entries, place)
    lettered = [*course[0], *forces[0]]
    if with_innovations:
        _innovations(history, panels[2][0], entries, unit, word)
        lettered += panels[2][0].tolist()
    for group in panels:
        figure.align_ylabels(group.ravel().tolist())
    sheet.letters(lettered, [panel.get_title(loc="left") for panel in lettered])
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=4)
    return figure


def _marked(history: CoefficientHistory, panel: Any, entries: dict[str, Any], unit: float) -> None:
    """Where a cut begins and where a jump was found."""
    for _, start, _ in cut_spans(history)[1:]:
        entries["next cut"] = panel.axvline(start / unit, color=sheet.MUTED, linewidth=0.7, linestyle="-.")
    for jump in history.jumps:
        entries["jump"] = panel.axvline(jump.time / unit, color=sheet.MODEL, linewidth=0.9, linestyle=":")


def _course(panel: Any, time: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray) -> Any:
    """The line in its band; returns what stands in the legend for both."""
    kept = np.unique(np.concatenate([thin(time, v, POINTS) for v in (value, low, high)]))
    (line,) = panel.plot(time[kept], value[kept], color=sheet.MAIN)
    if not (np.isfinite(low) & np.isfinite(high)).any():
        return line
    return panel.fill_between(time[kept], low[kept], high[kept], color=sheet.BAND), line


def _specific(history: CoefficientHistory, panels: Sequence[Any], entries: dict[str, Any], unit: float) -> None:
    time = history.time / unit
    chip = nominal(round(history.reference_chip * 1e6, 1))
    for i, (panel, direction) in enumerate(zip(panels, history.directions, strict=True)):
        value, low, high = (
            v[:, i] / 1e6 for v in (history.specific_force, history.specific_low, history.specific_high)
        )
        entries[_with_band(low)] = _course(panel, time, value, low, high)
        _marked(history, panel, entries, unit)
        sheet.scale(panel, "x", time_ends(history, unit), most=_ticks(panels))
        sheet.quiet(panel, "x")
        sheet.scale(panel, "y", range_of(value, low, high), label="specific force\n(N/mm²)", most=5)
        panel.set_title(f"{SIDES[direction]}, chip of {chip} µm", loc="left")


def _ticks(panels: Sequence[Any]) -> int:
    """How many ticks of the time a panel has room for."""
    return 5 if len(panels) > 2 else 7


def _with_band(low: np.ndarray) -> str:
    return "estimate, with 95 % band" if np.isfinite(low).any() else "estimate"


def _coefficients(
    history: CoefficientHistory, panels: Sequence[Any], first: int, entries: dict[str, Any], unit: float, word: str
) -> None:
    time = history.time / unit
    last = first > 0
    for panel, i in zip(panels, range(first, first + len(panels)), strict=True):
        name = history.names[i]
        known = parameter(name)
        value, low, high = (v[:, i] / known.factor for v in (history.value, history.low, history.high))
        _marked(history, panel, entries, unit)
        _course(panel, time, value, low, high)
        if not np.isfinite(value).any():
            panel.text(0.5, 0.5, "not known", transform=panel.transAxes, ha="center", va="center")
        sheet.scale(panel, "x", time_ends(history, unit), label=f"time ({word})" if last else "", most=_ticks(panels))
        if not last:
            sheet.quiet(panel, "x")
        sheet.scale(panel, "y", range_of(value, low, high), label=f"{symbol(name)} ({known.unit})", most=4)


def _window(
    history: CoefficientHistory, number: float, panels: Sequence[Any], entries: dict[str, Any], place: str
) -> None:
    rows = np.flatnonzero(history.shown_window == number)
    start = float(history.shown[rows[0]])
    time = history.shown[rows] - start
    inner, inner_word = (1.0, "s") if time[-1] > 2 else (1e-3, "ms")
    time = time / inner
    for row, (panel, axis) in enumerate(zip(panels, history.axes, strict=True)):
        measured, modelled = history.measured[row, rows], history.modelled[row, rows]
        kept = thin(time, measured, POINTS)
        dots = {"color": sheet.INK, "markersize": 2.2, "linestyle": "none", "markeredgewidth": 0}
        (entries["measured"],) = panel.plot(time[kept], measured[kept], ".", **dots)
        kept = thin(time, modelled, POINTS)
        (entries["modelled"],) = panel.plot(time[kept], modelled[kept], color=sheet.MODEL, linestyle=(0, (4, 1.5)))
        limits = span_of(history.measured[row], history.modelled[row], include=(0.0,))
        sheet.scale(panel, "y", limits, label=f"$F_{axis}$ (N)", most=4)
        last = row == len(panels) - 1
        ends = (0.0, float(time[-1]) or 1.0)
        sheet.scale(panel, "x", ends, label=f"time ({inner_word})" if last else "", most=5)
        if not last:
            sheet.quiet(panel, "x")
    unit, word = time_unit(float(history.time[-1] - history.time[0]))
    panels[0].set_title(f"{place}, {significant(start / unit)} {word}", loc="left")


def _innovations(
    history: CoefficientHistory, panels: Sequence[Any], entries: dict[str, Any], unit: float, word: str
) -> None:
    seen = stretches(history, STRETCHES)
    time = seen["time"] / unit
    for panel, kind, right, expected in zip(
        panels, ("mean", "rms"), (0.0, 1.0), (expected_mean, expected_rms), strict=True
    ):
        _marked(history, panel, entries, unit)
        low, high = (end[:, 0] for end in expected(seen["samples"]))
        if np.isfinite(low).any():
            band = panel.fill_between(time, low, high, color=sheet.LEFT)
            entries["95 % range of innovations if all is right"] = band
        panel.axhline(right, color=sheet.MUTED, linewidth=0.6)
        for row, axis in enumerate(history.axes):
            color = (sheet.MAIN, sheet.MODEL, sheet.MUTED)[row]
            look = {"color": color, "markersize": 2.4, "linestyle": "none", "fillstyle": "none", "markeredgewidth": 0.8}
            look |= {"clip_on": False, "zorder": 4}
            (entries[f"innovation of $F_{axis}$"],) = panel.plot(time, seen[kind][:, row], _MARKERS[row], **look)
        sheet.scale(panel, "x", time_ends(history, unit), label=f"time ({word})", most=_ticks(panels))
        limits = span_of(seen[kind], low, high, include=(right,), margin=0.1)
        sheet.scale(panel, "y", limits, label=f"{kind} of\ninnovations (1)", most=4)
