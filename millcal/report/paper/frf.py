"""Driving points for print: magnitude, phase and coherence against frequency."""

from typing import Any

import numpy as np

from millcal.data import Frf, Modes
from millcal.report.charts import decades_of, thin
from millcal.report.driving_points import FORMS, PHASE_MIDDLE, DrivingPoint, driving_pairs, driving_point
from millcal.report.modal_curves import FittedPair, fitted_in_words, fitted_pair
from millcal.report.paper import sheet

ABREAST = 3  # driving points on one sheet
POINTS = 2000  # of a curve; a column of a journal shows no more
_ONE_LINE = {"(m/s²)": "m s⁻²", "(mm/s)": "mm s⁻¹"}  # no brackets within brackets


def magnitude_label(form: str, *, lines: int = 2) -> str:
    """What stands at the ordinate of a magnitude, on one line or two."""
    symbol, unit, _ = FORMS[form]
    for bracketed, bare in _ONE_LINE.items():
        unit = unit.replace(bracketed, bare)
    return f"magnitude $|{symbol}|$\n({unit})" if lines > 1 else f"$|{symbol}|$ ({unit})"


def driving_points(frf: Frf, modes: Modes | None = None) -> dict[str, Any]:
    """A figure of up to three driving points, each a column of panels; several figures where there are more.

    modes : where they were fitted to this FRF, in its form, their curves stand over the measured ones
    """
    pairs = driving_pairs(frf)
    groups = [pairs[start : start + ABREAST] for start in range(0, len(pairs), ABREAST)]
    names = ["frf"] if len(groups) == 1 else [f"frf-{number}" for number in range(1, len(groups) + 1)]
    points = {pair: driving_point(frf, *pair) for pair in pairs}
    decades = decades_of(*(point.magnitude for point in points.values()))
    return {
        name: _sheet(frf, {pair: points[pair] for pair in group}, decades, modes)
        for name, group in zip(names, groups, strict=True)
    }


def _sheet(
    frf: Frf, points: dict[tuple[int, int], DrivingPoint], decades: tuple[float, float], modes: Modes | None
) -> Any:
    """One figure; magnitudes have one scale, so that directions compare."""
    middle = PHASE_MIDDLE[frf.form]
    with_coherence = any(point.coherence is not None for point in points.values())
    rows, heights = (3, (2.2, 1.2, 1)) if with_coherence else (2, (2.2, 1.2))
    width = sheet.SINGLE if len(points) == 1 else sheet.DOUBLE
    figure, panels = sheet.sheet(width, 36.0 * rows + 8, rows, len(points), heights=heights)
    entries: dict[str, Any] = {}
    fitted_name = fitted_in_words(modes.fit) if modes is not None and modes.fit is not None else ""
    for column, ((output, given), point) in enumerate(points.items()):
        f = point.frequency
        for panel in panels[:, column]:
            entries["usable band"] = panel.axvspan(*frf.usable_band, color=sheet.USABLE, zorder=0)
        for panel, value, log in ((panels[0, column], point.magnitude, True), (panels[1, column], point.phase, False)):
            kept = thin(f, np.log(value) if log else value, POINTS)
            if point.low is not None and point.high is not None and point.turn is not None:
                low, high = (point.low, point.high) if log else (value - point.turn, value + point.turn)
                entries["95 % interval"] = panel.fill_between(f[kept], low[kept], high[kept], color=sheet.BAND)
            (entries["measured"],) = panel.plot(*joined(f[kept], value[kept], log), color=sheet.MAIN)
            fitted = _fitted(frf, output, given, modes)
            if fitted is not None:
                y = fitted.fitted if log else fitted.fitted_phase
                kept = thin(fitted.frequency, np.log(y) if log else y, POINTS)
                look = {"color": sheet.MODEL, "linestyle": "--", "linewidth": 0.9}
                (entries[fitted_name],) = panel.plot(*joined(fitted.frequency[kept], y[kept], log), **look)
        sheet.scale(panels[0, column], "y", decades, label=magnitude_label(frf.form), log=True, most=6)
        sheet.scale(
            panels[1, column],
            "y",
            (middle - 135.0, middle + 135.0),
            label="phase (deg)",
            ticks=[middle - 90.0, middle, middle + 90.0],
        )
        if with_coherence:
            panel = panels[2, column]
            if point.coherence is not None:
                kept = thin(f, point.coherence, POINTS)
                panel.plot(f[kept], point.coherence[kept], color=sheet.MAIN, linewidth=0.8)
            sheet.scale(panel, "y", (0.0, 1.05), label="coherence\n$\\gamma^2$ (1)", ticks=[0.0, 0.5, 1.0])
        for row in range(rows):
            last = row == rows - 1
            sheet.scale(panels[row, column], "x", (float(f[0]), float(f[-1])), label="frequency (Hz)", log=True)
            if not last:
                sheet.quiet(panels[row, column], "x")
            if column:
                sheet.quiet(panels[row, column], "y")
        hits = frf.hits_used[given] if given < len(frf.hits_used) else 0
        panels[0, column].set_title(_title(frf, output, given, hits, len(points) > 1, column), loc="left")
    figure.align_ylabels()
    order = [name for name in ("measured", "95 % interval", fitted_name, "usable band") if name in entries]
    columns = len(order) if len(points) > 1 or len(order) < 4 else 2
    sheet.legend(figure, [(entries[name], name) for name in order], columns=columns)
    return figure


def joined(x: np.ndarray, y: np.ndarray, magnitude: bool) -> list[np.ndarray]:
    """A curve as it is, but a phase not joined from one branch to the next."""
    leaps = [] if magnitude else np.flatnonzero(np.abs(np.diff(y)) > 180.0) + 1
    return [np.insert(v, leaps, np.nan) for v in (x, y)]


def _fitted(frf: Frf, output: int, given: int, modes: Modes | None) -> FittedPair | None:
    """The curves of the fit to this pair, None where there was none or in another form."""
    fit = modes.fit if modes is not None else None
    if modes is None or fit is None or fit.form != frf.form:
        return None
    to, at = frf.inputs[given], frf.outputs[output]
    if to not in fit.inputs or at not in fit.outputs:
        return None
    return fitted_pair(modes, fit, fit.outputs.index(at), fit.inputs.index(to))


def _title(frf: Frf, output: int, given: int, hits: int, several: bool, column: int) -> str:
    """Which direction, and how many hits stand behind it."""
    to, at = (sheet.plain(dof.lstrip("+")) for dof in (frf.inputs[given], frf.outputs[output]))
    where = to if to == at else f"{at} over {to}"
    count = f", {hits} hit{'s' if hits > 1 else ''}" if hits else ""
    return f"({sheet.letter(column)}) {where}{count}" if several else f"{where}{count}"
