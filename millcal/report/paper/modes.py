"""Fitted modes for print: measured and fitted driving points, the stabilisation chart, and how alike the shapes are."""

from typing import Any

import numpy as np

from millcal.data import ModalFit, Modes
from millcal.report.charts import thin
from millcal.report.digits import fixed, significant
from millcal.report.driving_points import PHASE_MIDDLE
from millcal.report.modal_curves import (
    FittedPair,
    driving_pairs,
    fitted_in_words,
    fitted_pair,
    magnitudes_drawn,
    marks_drawn,
    mean_magnitude,
    share,
)
from millcal.report.paper import sheet
from millcal.report.paper.frf import ABREAST, POINTS, joined, magnitude_label

_DASHES = {"color": sheet.MODEL, "linestyle": "--", "linewidth": 0.9}
_RULE = {"color": sheet.MUTED, "linestyle": ":", "linewidth": 0.7}
_MOST_MODES = 16  # whose MAC can be read in a column


def modal_figures(modes: Modes) -> dict[str, Any]:
    """All figures of fitted modes; none of modes given by hand."""
    fit = modes.fit
    if fit is None:
        return {}
    return {**_driving_points(modes, fit), **_chart(modes, fit)}


def _driving_points(modes: Modes, fit: ModalFit) -> dict[str, Any]:
    """Sheets of up to three driving points, magnitude with what the fit leaves, and phase; one scale on all."""
    shown = {pair: fitted_pair(modes, fit, *pair) for pair in driving_pairs(fit)}
    pairs = list(shown)
    groups = [pairs[start : start + ABREAST] for start in range(0, len(pairs), ABREAST)]
    decades = magnitudes_drawn(*shown.values())
    names = ["modal-fit"] if len(groups) == 1 else [f"modal-fit-{number}" for number in range(1, len(groups) + 1)]
    return {
        name: _sheet(modes, fit, {pair: shown[pair] for pair in group}, decades)
        for name, group in zip(names, groups, strict=True)
    }


def _sheet(modes: Modes, fit: ModalFit, pairs: dict[tuple[int, int], FittedPair], decades: tuple[float, float]) -> Any:
    middle = PHASE_MIDDLE[fit.form]
    width = sheet.SINGLE if len(pairs) == 1 else sheet.DOUBLE
    figure, panels = sheet.sheet(width, 84.0, 2, len(pairs), heights=(2.2, 1))
    entries: dict[str, Any] = {}
    for column, ((output, given), pair) in enumerate(pairs.items()):
        upper, lower = panels[:, column]
        ends = (float(pair.frequency[0]), float(pair.frequency[-1]))
        log = ends[0] > 0 and ends[1] > 6 * ends[0]
        for panel in (upper, lower):
            for frequency, _ in marks_drawn(modes, ends):
                entries["modes"] = panel.axvline(frequency, **_RULE)
        for panel, values, fitted, scaled in (
            (upper, pair.measured, pair.fitted, True),
            (lower, pair.measured_phase, pair.fitted_phase, False),
        ):
            look = {"color": sheet.BAND, "linewidth": 2.2}
            (entries["measured"],) = panel.plot(*_curve(pair.frequency, values, scaled), **look)
            (entries["fitted"],) = panel.plot(*_curve(pair.frequency, fitted, scaled), **_DASHES)
        x, y = _curve(pair.frequency, pair.left, True)
        entries["left by the fit"] = upper.fill_between(x, decades[0] / 10, y, color=sheet.LEFT, zorder=0.5)
        sheet.scale(upper, "y", decades, label=magnitude_label(fit.form), log=True, most=6)
        ticks = [middle - 90.0, middle, middle + 90.0]
        sheet.scale(lower, "y", (middle - 135.0, middle + 135.0), label="phase (deg)", ticks=ticks)
        for panel in (upper, lower):
            sheet.scale(panel, "x", ends, label="frequency (Hz)", log=log, most=4)
            if column:
                sheet.quiet(panel, "y")
        sheet.quiet(upper, "x")
        to, at = (sheet.plain(dof.lstrip("+")) for dof in (fit.inputs[given], fit.outputs[output]))
        where = to if to == at else f"{at} over {to}"
        letter = f"({sheet.letter(column)}) " if len(pairs) > 1 else ""
        upper.set_title(f"{letter}{where}, {share(float(fit.residual[output, given]))} left", loc="left")
    figure.align_ylabels()
    entries[fitted_in_words(fit)] = entries.pop("fitted")
    order = ("measured", fitted_in_words(fit), "left by the fit", "modes")
    sheet.legend(
        figure, [(entries[name], name) for name in order if name in entries], columns=4 if len(pairs) > 1 else 2
    )
    return figure


def _curve(frequency: np.ndarray, values: np.ndarray, magnitude: bool) -> list[np.ndarray]:
    """Points enough for print."""
    with np.errstate(divide="ignore"):
        kept = thin(frequency, np.log(values) if magnitude else values, POINTS)
    return joined(frequency[kept], values[kept], magnitude)


def _chart(modes: Modes, fit: ModalFit) -> dict[str, Any]:
    """The stabilisation chart over the mean FRF, and beside it the modal assurance criterion."""
    count = len(modes.axes)
    if not len(fit.chart_order):
        return {}
    with_mac = 1 < count <= _MOST_MODES and max(len(fit.outputs), len(fit.inputs)) > 1
    figure, panels = sheet.sheet(sheet.DOUBLE, 72.0, 1, 2 if with_mac else 1, widths=(2.1, 1) if with_mac else None)
    poles = panels[0, 0]
    stable = fit.chart_stable > 0
    entries: dict[str, Any] = {}
    behind = poles.twinx()
    behind.set_zorder(0)
    poles.set_zorder(1)
    poles.patch.set_visible(False)
    magnitude = mean_magnitude(fit)
    (curve,) = behind.plot(*_curve(fit.frequency, magnitude, True), color=sheet.BAND, linewidth=1.2)
    behind.grid(False)
    sheet.quiet(behind, "x")
    ends = (float(fit.frequency[0]), float(fit.frequency[-1]))
    for frequency, _ in marks_drawn(modes, ends):
        entries["modes"] = poles.axvline(frequency, **_RULE)
    look = {"color": sheet.MUTED, "fillstyle": "none", "markersize": 2.6, "markeredgewidth": 0.5, "linestyle": "none"}
    (other,) = poles.plot(fit.chart_frequency[~stable], fit.chart_order[~stable], "o", **look)
    (sure,) = poles.plot(
        fit.chart_frequency[stable], fit.chart_order[stable], "D", color=sheet.MAIN, markersize=2.6, linestyle="none"
    )
    sheet.scale(poles, "x", ends, label="frequency (Hz)", most=6)
    orders = (float(fit.chart_order.min()) - 1, float(fit.chart_order.max()) + 1)
    sheet.scale(poles, "y", orders, label="order of the model (1)", most=8)
    low, high = float(magnitude[magnitude > 0].min()) / 1.25, float(np.nanmax(magnitude)) * 1.25
    sheet.scale(behind, "y", (low, high), label=f"rms {magnitude_label(fit.form, lines=1)}", log=True, most=5)
    entries = {"stable pole": sure, "other pole": other, **entries, "all FRFs, rms": curve}
    if with_mac:
        _mac(panels[0, 1], modes, fit)
        sheet.letters(panels[0], ("", "MAC (1)"))
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=4)
    return {"modal-chart": figure}


def _mac(panel: Any, modes: Modes, fit: ModalFit) -> None:
    """Cells with their numbers, the leading zero left out so that a dozen modes fit."""
    count = len(modes.axes)
    panel.imshow(fit.mac, cmap="Blues", vmin=0.0, vmax=1.6, aspect="equal")
    for row in range(count):
        for column in range(count):
            value = float(fit.mac[row, column])
            text = fixed(value, 2).removeprefix("0") if value < 0.995 else "1"
            if count <= 10 or value >= 0.1:
                panel.text(column, row, text, ha="center", va="center", fontsize=7)
    names = [significant(float(f), 4 if f >= 1000 else 3) for f in modes.natural_frequency]
    panel.grid(False)
    panel.tick_params(length=0)
    panel.set_xticks(range(count), names, rotation=90)
    panel.set_yticks(range(count), names)
    panel.set(xlabel="mode at (Hz)", ylabel="mode at (Hz)")
