"""Forces for print: measured against modelled over one revolution, and the mean force against the feed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from millcal.data import AXES, Coefficients, CutForce
from millcal.report.axes import axes_measured, comparable, mean_is_known
from millcal.report.charts import span_of
from millcal.report.digits import fixed
from millcal.report.force_figures import conditioned_cuts, series_of_feed
from millcal.report.paper import sheet
from millcal.report.wording import conditions_in_words, cut_names

TOGETHER = 6  # cuts on one sheet
_TURN = (0.0, 90.0, 180.0, 270.0, 360.0)  # deg


def revolutions(fit: Coefficients, cuts: Sequence[CutForce]) -> dict[str, Any]:
    """Force over one revolution: a grid of up to six cuts by three axes, or a figure for each of more cuts.

    An axis has one scale over all cuts, so that figures compare.
    """
    numbers = range(len(fit.cuts))
    measured, modelled = comparable(fit)
    fit = replace(fit, measured=measured, modelled=modelled)
    scatter = np.full(fit.measured.shape, np.nan)  # where the conditioned cut is at hand
    for number, cut in conditioned_cuts(fit, cuts).items():
        for row in range(3):
            scatter[number, row] = np.interp(fit.angle, cut.average_angle, cut.scatter[row], period=2 * np.pi)
    if len(numbers) <= TOGETHER:
        return {"force-revolution": _grid(fit, scatter, numbers)}
    digits = len(str(len(numbers)))
    return {f"force-revolution-{n + 1:0{digits}}": _grid(fit, scatter, [n]) for n in numbers}


def _grid(fit: Coefficients, scatter: np.ndarray, numbers: Sequence[int]) -> Any:
    """A row of panels for each cut.   scatter : (cut, axis, angle) N, standard deviation over the revolutions"""
    axes = axes_measured(fit)
    heard = "from accelerations, without mean" if not mean_is_known(fit) else ""
    figure, panels = sheet.sheet(sheet.DOUBLE, 31.0 * len(numbers) + 22, len(numbers), len(axes))
    degrees = np.degrees(fit.angle)
    entries: dict[str, Any] = {}
    low, high = fit.measured - 2 * scatter, fit.measured + 2 * scatter
    drawn = (fit.measured, fit.modelled, low, high)
    ranges = [span_of(*(values[:, row] for values in drawn), include=(0.0,)) for row in range(3)]
    titles = _titles(fit)
    for place, number in enumerate(numbers):
        for column, row in enumerate(axes):
            panel, axis = panels[place, column], AXES[row]
            if np.isfinite(scatter[number, row]).all():
                band = panel.fill_between(degrees, low[number, row], high[number, row], color=sheet.BAND)
                entries["±2 sd of the revolutions"] = band
            (entries[heard or "measured"],) = panel.plot(degrees, fit.measured[number, row], color=sheet.MAIN)
            dashes = {"color": sheet.MODEL, "linestyle": (0, (3, 2)), "linewidth": 1.2}
            (entries["modelled"],) = panel.plot(degrees, fit.modelled[number, row], **dashes)
            sheet.scale(panel, "x", (0.0, 360.0), label="spindle angle (deg)", ticks=_TURN)
            if place < len(numbers) - 1:
                sheet.quiet(panel, "x")
            sheet.scale(panel, "y", ranges[row], label=f"$F_{axis}$ (N)", most=8)
        title = titles[number]
        panels[place, 0].set_title(f"({sheet.letter(place)}) {title}" if len(numbers) > 1 else title, loc="left")
    figure.align_ylabels()
    order = [name for name in (heard, "measured", "modelled", "±2 sd of the revolutions") if name in entries]
    sheet.legend(figure, [(entries[name], name) for name in order], columns=3)
    return figure


def _titles(fit: Coefficients) -> list[str]:
    """The conditions of each cut, and its name where two cuts have the same."""
    words = [conditions_in_words(conditions) for conditions in fit.conditions]
    names = cut_names(fit.cuts)
    alike = {text for text in words if words.count(text) > 1}
    pairs = zip(words, fit.cuts, strict=True)
    return [sheet.plain(f"{text}: {names[cut]}" if text in alike else text) for text, cut in pairs]


def mean_force(fit: Coefficients, cuts: Sequence[CutForce]) -> Any:
    """Mean force against feed per tooth with the model's line, and below it what the model leaves.

    The intervals are those of the mean of a steady cut, from its blocks of revolutions, where the cut is at hand.
    """
    figure, panels = sheet.sheet(sheet.DOUBLE, 88.0, 2, 3, heights=(2, 1))
    feed = fit.feed_per_tooth * 1e3
    left = fit.measured_mean - fit.modelled_mean
    conditioned = conditioned_cuts(fit, cuts)
    half = np.full(left.shape, np.nan)
    for number, cut in conditioned.items():
        half[number] = 1.96 * np.sqrt(np.maximum(np.real(cut.harmonics_variance[:, 0]), 0.0))
    entries: list = []
    x_range = span_of(feed, margin=0.08)
    for row, axis in enumerate(AXES):
        upper, lower = panels[:, row]
        lower.axhline(0.0, color=sheet.MUTED, linewidth=0.6)
        for members in series_of_feed(fit):
            (line,) = upper.plot(feed[members], fit.modelled_mean[members, row], color=sheet.MODEL, linestyle="--")
        (squares,) = upper.plot(feed, fit.modelled_mean[:, row], "s", color=sheet.MODEL, fillstyle="none", markersize=5)
        whisker = half[:, row] if conditioned else None
        look = {"color": sheet.MAIN, "markersize": 3, "capsize": 2, "elinewidth": 0.8, "capthick": 0.8}
        measured = upper.errorbar(feed, fit.measured_mean[:, row], whisker, fmt="o", **look)
        lower.errorbar(feed, left[:, row], whisker, fmt="o", **look)
        entries = [
            (measured, "measured, with 95 % interval" if conditioned else "measured"),
            ((line, squares), "modelled"),
        ]
        sheet.scale(upper, "x", x_range, most=4)
        sheet.quiet(upper, "x")
        sheet.scale(lower, "x", x_range, label="feed per tooth $f_\\mathrm{z}$ (mm)", most=4)
        y_range = span_of(fit.measured_mean[:, row], fit.modelled_mean[:, row], margin=0.1)
        sheet.scale(upper, "y", y_range, label=rf"$\bar{{F}}_{axis}$ (N)")
        reach = 1.2 * float(np.nanmax(np.abs(left[:, row]) + np.nan_to_num(half[:, row]))) or 1e-9
        sheet.scale(lower, "y", (-reach, reach), label="difference (N)", most=4)
    figure.align_ylabels()
    quality = [f"$R^2$ = {fixed(float(r2), 4)}" for r2 in fit.r2] if fit.posterior.method == "average" else []
    sheet.letters(panels[0], quality)  # of another method R² is not that of the means
    sheet.legend(figure, entries, columns=2)
    return figure
