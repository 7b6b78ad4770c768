"""A force that accelerations tell, for print: its course, its harmonics, what does not fit; the methods; the next speed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from millcal.data import CuttingConditions, ForceHarmonics, SpeedAdvice
from millcal.report.charts import decades_of, span_of
from millcal.report.digits import significant
from millcal.report.force_harmonics_figures import (
    NORMAL,
    OUTSIDE,
    amplitude_sd,
    near,
    normalised,
    reach_of,
    recommended_row,
    there,
)
from millcal.report.paper import sheet
from millcal.report.paper.coefficients import symbol
from millcal.report.speed_advice_figure import cutting_first, in_rpm
from millcal.report.wording import conditions_in_words, parameter

MOST_CUTS = 3  # whose course is drawn
_TURN = (0.0, 90.0, 180.0, 270.0, 360.0)  # deg
_MARKERS = ("o", "s", "D", "^", "v", "x")
_COLORS = (sheet.MAIN, sheet.MODEL, "#117a4b", "#7a3fa0", "#8a6100", sheet.MUTED)
_LINES = ("-", "--", ":")  # "-." are the speeds of the cuts


def forces_file(forces: ForceHarmonics, format: str) -> bytes:
    """The sheet as a file of one of `sheet.FORMATS`; the same record gives the same bytes."""
    with sheet.style():
        return sheet.file_bytes(forces_sheet(forces), format)


def advice_file(advice: SpeedAdvice, format: str, conditions: Sequence[CuttingConditions] = ()) -> bytes:
    """The advice alone as a file, for a machine at which nothing was cut yet."""
    with sheet.style():
        return sheet.file_bytes(advice_sheet(advice, conditions), format)


def figures(forces: ForceHarmonics) -> dict[str, Any]:
    """Every figure that the record gives, by name."""
    drawn = {"force-harmonics": forces_sheet(forces)}
    if len(forces.compared_methods) > 1 and there(forces.compared):
        drawn["force-methods"] = methods_sheet(forces)
    if forces.advice is not None and forces.advice.names:
        drawn["speed-advice"] = advice_sheet(forces.advice, forces.conditions)
    return drawn


def forces_sheet(forces: ForceHarmonics) -> Any:
    """One figure: force over a revolution, amplitudes of its harmonics, differences and condition numbers."""
    n = len(forces.cuts)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_CUTS)).round().astype(int)).tolist()
    groups = [((1.25,) * len(chosen), len(forces.axes)), ((1.0,), len(forces.axes)), ((1.0,), 2)]
    height = 27.0 * sum(sum(heights) for heights, _ in groups) + 42.0
    figure, (courses, amplitudes, under) = sheet.stacked(sheet.DOUBLE, height, groups)
    entries: dict[str, Any] = {}
    _courses(forces, chosen, courses, entries)
    _amplitudes(forces, amplitudes[0], entries)
    _differences(forces, under[0, 0], entries)
    _condition(forces, under[0, 1])
    for group in (courses, amplitudes, under):
        figure.align_ylabels(group.ravel().tolist())
    lettered = [*courses[:, 0], *amplitudes[0], *under[0]]
    sheet.letters(lettered, [panel.get_title(loc="left") for panel in lettered])
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=3)
    return figure


def _courses(forces: ForceHarmonics, chosen: Sequence[int], panels: Any, entries: dict[str, Any]) -> None:
    degrees, half = np.degrees(forces.angle), NORMAL * forces.alternating_sd
    drawn = (forces.alternating, forces.law_force, forces.dynamometer)
    for place, number in enumerate(chosen):
        left_out = (
            f" ({len(chosen)} of {len(forces.cuts)} cuts drawn)"
            if place == 0 and len(chosen) < len(forces.cuts)
            else ""
        )
        title = sheet.plain(conditions_in_words(forces.conditions[number])) + left_out
        panels[place, 0].set_title(title, loc="left")
        for row, axis in enumerate(forces.axes):
            panel = panels[place, row]
            panel.axhline(0.0, color=sheet.MUTED, linewidth=0.5)
            value, spread = forces.alternating[number, row], half[number, row]
            (line,) = panel.plot(degrees, value, color=sheet.MAIN)
            if np.isfinite(spread).all():
                band = panel.fill_between(degrees, value - spread, value + spread, color=sheet.BAND)
                entries["from accelerations, without mean; 95 % band"] = (band, line)
            else:
                entries["from accelerations, without mean"] = line
            if forces.law_force is not None:
                dashes = {"color": sheet.MODEL, "linestyle": "--"}
                (entries["the law's whole force, with its mean"],) = panel.plot(
                    degrees, forces.law_force[number, row], **dashes
                )
            if forces.dynamometer is not None:
                dots = {"color": sheet.INK, "linestyle": ":", "linewidth": 1.1}
                (entries["dynamometer, the same harmonics"],) = panel.plot(
                    degrees, forces.dynamometer[number, row], **dots
                )
            last = place == len(chosen) - 1
            sheet.scale(panel, "x", (0.0, 360.0), label="angle of tooth 0 (deg)" if last else "", ticks=_TURN)
            if not last:
                sheet.quiet(panel, "x")
            limits = span_of(*(v[:, row] for v in drawn if v is not None), include=(0.0,))
            sheet.scale(panel, "y", limits, label=f"$F_{axis}$ (N)", most=5)


def _frequency(forces: ForceHarmonics, panel: Any, most: int) -> None:
    sheet.scale(panel, "x", (0.0, 1.05 * float(forces.frequency.max())), label="frequency (Hz)", most=most)


def _amplitudes(forces: ForceHarmonics, panels: Any, entries: dict[str, Any]) -> None:
    deviation, size = amplitude_sd(forces), np.abs(forces.force)
    low, high = decades_of(size, deviation)
    for row, (panel, axis) in enumerate(zip(panels, forces.axes, strict=True)):
        look: dict[str, Any] = {"linestyle": "none", "clip_on": False, "zorder": 4}
        (entries["amplitude of a harmonic"],) = panel.plot(
            forces.frequency, np.maximum(size[:, row], high * 1e-4), ".", color=sheet.MAIN, markersize=8, **look
        )
        if there(deviation):
            strokes = {"color": sheet.MUTED, "markersize": 6, "markeredgewidth": 1.2}
            (entries["its standard deviation"],) = panel.plot(
                forces.frequency, np.maximum(deviation[:, row], high * 1e-4), "_", **look, **strokes
            )
        _frequency(forces, panel, 4)
        limits = (max(low / 1.5, high * 1e-4 / 1.5), high * 1.5)
        sheet.scale(panel, "y", limits, label=f"amplitude\nof $F_{axis}$ (N)", log=True, most=4)


def _differences(forces: ForceHarmonics, panel: Any, entries: dict[str, Any]) -> None:
    left = normalised(forces)
    if not there(left):
        panel.text(0.5, 0.5, "expected difference not known", transform=panel.transAxes, ha="center", va="center")
        sheet.scale(panel, "y", (0.0, 1.0), label="difference /\nexpected (1)", most=2)
        _frequency(forces, panel, 6)
        return
    ends = (0.0, 1.05 * float(forces.frequency.max()))
    band = panel.fill_between(ends, 0.0, OUTSIDE, color=sheet.LEFT)
    entries["19 of 20 differences, if all is right"] = band
    few = len(forces.sensors) <= len(_MARKERS)
    for row, sensor in enumerate(forces.sensors):
        look = {"color": _COLORS[row] if few else sheet.INK, "markersize": 3.5, "fillstyle": "none", "clip_on": False}
        name = f"difference of {sensor}" if few else "difference of a sensor"
        (entries[sheet.plain(name)],) = panel.plot(
            forces.frequency, left[:, row], _MARKERS[row] if few else "+", linestyle="none", zorder=4, **look
        )
    _frequency(forces, panel, 6)
    high = 1.08 * max(float(np.nanmax(left)), 1.5 * OUTSIDE)
    sheet.scale(panel, "y", (0.0, high), label="difference /\nexpected (1)", most=4)


def _condition(forces: ForceHarmonics, panel: Any) -> None:
    look = {"color": sheet.MAIN, "markersize": 3.5, "clip_on": False}
    panel.plot(forces.frequency, forces.condition, "o", linestyle="none", zorder=4, **look)
    _frequency(forces, panel, 6)
    low, high = decades_of(forces.condition)
    sheet.scale(panel, "y", (min(low, 0.9), max(high, 12.0)), label="condition\nnumber (1)", log=True, most=4)


def methods_sheet(forces: ForceHarmonics) -> Any:
    """Each coefficient by each method, a panel for each; the recommended method first."""
    names = forces.compared_methods
    first = [row for row in [recommended_row(forces)] if row >= 0]
    order = first + [k for k in range(len(names)) if k not in first]
    place = -np.arange(len(order), dtype=float)
    coefficients = forces.posterior.names
    abreast = min(3, len(coefficients))
    rows = -(-len(coefficients) // abreast)
    figure, panels = sheet.sheet(sheet.DOUBLE, rows * (15.0 + 4.6 * len(order)) + 8, rows, abreast)
    entries: dict[str, Any] = {}
    for i, (panel, name) in enumerate(zip(panels.flat, coefficients, strict=False)):
        known = parameter(name)
        value, half = (v[order, i] / known.factor for v in (forces.compared, NORMAL * forces.compared_sd))
        kept = near(value, float(half[0]), float(value[0])) if first else np.isfinite(value)
        limits = reach_of(value, half, kept, 0 if first else -1)
        for k in range(len(order)):
            if not np.isfinite(value[k]):
                continue
            best = bool(first) and k == 0
            if not kept[k]:
                below = value[k] < limits[0]
                words = f"← {significant(float(value[k]))}" if below else f"{significant(float(value[k]))} →"
                panel.text(
                    0.02 if below else 0.98, place[k], words, transform=panel.get_yaxis_transform(),
                    ha="left" if below else "right", va="center", fontsize=7, color=sheet.MUTED,
                )  # fmt: skip
                continue
            look = {"color": sheet.MODEL if best else sheet.MAIN, "markersize": 4.5 if best else 3.5}
            whisker = [[half[k]]] * 2 if np.isfinite(half[k]) else None
            word = "recommended" if best else "other method"
            drawn = panel.errorbar(
                [value[k]],
                [place[k]],
                xerr=whisker,
                fmt="D" if best else "o",
                capsize=2,
                elinewidth=0.9,
                capthick=0.9,
                **look,
            )
            entries.setdefault(word, drawn)
        if first and np.isfinite(half[0]):
            panel.axvspan(value[0] - half[0], value[0] + half[0], color=sheet.USABLE, zorder=0)
        sheet.scale(panel, "x", limits, most=4, label=f"{symbol(name)} ({known.unit})")
        panel.set_yticks(place, [names[k] for k in order])
        panel.set_ylim(place[-1] - 0.6, 0.6)
        if i % abreast:
            sheet.quiet(panel, "y")
    for panel in panels.flat[len(coefficients) :]:
        panel.remove()
    sheet.letters(panels.flat[: len(coefficients)])
    sheet.legend(figure, [(handle, f"{name}, with 95 % interval") for name, handle in entries.items()], columns=2)
    return figure


def advice_sheet(advice: SpeedAdvice, conditions: Sequence[CuttingConditions] = ()) -> Any:
    """Expected standard deviations against spindle speed, and the condition number below."""
    figure, ((upper,), (lower,)) = sheet.sheet(sheet.DOUBLE, 88.0, 2, heights=(2.4, 1))
    order = np.argsort(advice.spindle_speed, kind="stable")
    rpm, percent = in_rpm(advice.spindle_speed)[order], 100 * advice.relative_sd[order]
    ends = (float(rpm[0]), float(rpm[-1]))
    entries: list = []
    shown = cutting_first(advice.names)
    best = in_rpm(advice.best)
    for k, column in enumerate(shown):
        look = {"color": _COLORS[k % len(_COLORS)], "linestyle": _LINES[k % len(_LINES)]}
        (line,) = upper.plot(rpm, percent[:, column], **look)
        entries.append((line, symbol(advice.names[column])))
        level = np.interp(best, rpm, percent[:, column])
        (marks,) = upper.plot(
            best, level, "D", color=sheet.INK, markersize=3.5, fillstyle="none", linestyle="none", zorder=4
        )
    if len(best):
        entries.append((marks, "best speeds, best first"))
        for number, speed in enumerate(best, 1):
            upper.annotate(
                str(number), (speed, 1.0), (0, 2), xycoords=upper.get_xaxis_transform(), textcoords="offset points",
                ha="center", va="bottom", fontsize=7, annotation_clip=False,
            )  # fmt: skip
    cuts = np.unique(in_rpm([c.spindle_speed for c in conditions]))
    for speed in cuts[(cuts >= ends[0]) & (cuts <= ends[1])]:
        rules = [panel.axvline(speed, color=sheet.MUTED, linewidth=0.8, linestyle="-.") for panel in (upper, lower)]
        entries[len(shown) + bool(len(best)) :] = [(rules[0], "speeds of the cuts")]
    lower.plot(rpm, advice.condition[order], color=sheet.MAIN)
    sheet.scale(upper, "x", ends, most=8)
    sheet.quiet(upper, "x")
    low, high = decades_of(percent[:, shown])
    label = "expected standard\ndeviation (%)"
    sheet.scale(upper, "y", (low / 1.1, high * 1.1), label=label, log=True, most=5)
    sheet.scale(lower, "x", ends, label="spindle speed (rpm)", most=8)
    low, high = decades_of(advice.condition)
    sheet.scale(lower, "y", (low, max(high, 2 * low)), label="condition\nnumber (1)", log=True, most=3)
    figure.align_ylabels()
    sheet.letters((upper, lower))
    sheet.legend(figure, entries, columns=len(entries))
    return figure
