"""Coefficients for print: each with its 95 % interval, beside what other models say of the same cuts."""

from typing import Any

import numpy as np

from millcal.data import Coefficients
from millcal.report.charts import span_of
from millcal.report.paper import sheet
from millcal.report.wording import parameter

ABREAST = 3


def intervals(fit: Coefficients) -> dict[str, Any]:
    """A panel for each coefficient, on a scale of its own; none where the fit holds no coefficient."""
    names = [name for name in fit.posterior.names if name[0] in "Kkm"]
    if not names:
        return {}
    others = [(label, dict(pairs)) for label, pairs in fit.alternatives if set(names) & set(dict(pairs))]
    rows = -(-len(names) // ABREAST)
    labels = [f"this fit ({fit.posterior.method})", *(label for label, _ in others)]
    height = rows * (15.0 + 4.6 * len(labels)) + 6
    figure, panels = sheet.sheet(sheet.DOUBLE, height, rows, ABREAST)
    place = -np.arange(len(labels), dtype=float)
    entries: dict[str, Any] = {}
    for panel, name in zip(panels.flat, names, strict=False):
        known, index = parameter(name), fit.posterior.names.index(name)
        low, high = fit.posterior.interval[index] / known.factor
        value = fit.posterior.mean[index] / known.factor
        elsewhere = np.array([pairs.get(name, np.nan) for _, pairs in others]) / known.factor
        panel.axvspan(low, high, color=sheet.USABLE, zorder=0)
        whiskers = {"color": sheet.MAIN, "markersize": 4, "capsize": 2.5, "elinewidth": 1.2, "capthick": 1.0}
        error = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
        entries["this fit, with its 95 % interval"] = panel.errorbar([value], [0.0], xerr=error, fmt="o", **whiskers)
        if others:
            ring = {"color": sheet.MODEL, "fillstyle": "none", "markersize": 4}
            (entries["other models"],) = panel.plot(elsewhere, place[1:], "D", **ring)
        sheet.scale(panel, "x", span_of(np.array([low, high, value]), elsewhere, margin=0.1), most=4)
        panel.set_xlabel(f"{symbol(name)} ({known.unit})")
        panel.set_yticks(place, [sheet.plain(label) for label in labels])
        panel.set_ylim(place[-1] - 0.6, 0.6)
    for number, panel in enumerate(panels.flat):
        if number >= len(names):
            panel.remove()
        elif number % ABREAST:
            sheet.quiet(panel, "y")
    sheet.letters(panels.flat[: len(names)])
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=2)
    return {"coefficients": figure}


def symbol(name: str) -> str:
    """Ktc -> K with index tc."""
    return rf"${name[0]}_{{\mathrm{{{name[1:]}}}}}$"
