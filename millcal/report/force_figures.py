"""Figures of the coefficients: measured against modelled force, its harmonics, the mean forces and the intervals."""

from collections.abc import Sequence

import numpy as np

from millcal.data import AXES, Coefficients, CutForce
from millcal.report.axes import axes_measured, comparable, mean_is_known
from millcal.report.charts import (
    SMALL,
    Band,
    Frame,
    Item,
    Line,
    Marks,
    Panel,
    Rule,
    Span,
    Whiskers,
    chart,
    span_of,
    symmetric_ticks,
)
from millcal.report.digits import fixed
from millcal.report.figures import Column, Figure
from millcal.report.wording import conditions_in_words, cut_names, parameter

MOST_CUTS = 12  # shown as curves; more would be a wall of small pictures
ANGLES = 180  # points of a curve over one revolution

MEASURED_AND_MODELLED = (("line measured", "measured"), ("line modelled", "modelled"))
HEARD_AND_MODELLED = (("line measured", "from accelerations"), ("line modelled", "by the law"))


def cuts_shown(n: int) -> list[int]:
    """Indices of the cuts that are drawn as curves: all, or a spread of them from the first to the last."""
    return np.unique(np.linspace(0, n - 1, min(n, MOST_CUTS)).round().astype(int)).tolist()


def conditioned_cuts(fit: Coefficients, cuts: Sequence[CutForce]) -> dict[int, CutForce]:
    """The conditioned cut behind each cut of the fit, by its number, where it is at hand: same place, same conditions."""
    same = enumerate(zip(cuts, fit.conditions, strict=False))
    return {number: cut for number, (cut, conditions) in same if cut.conditions == conditions}


def one_revolution(fit: Coefficients, cuts: Sequence[CutForce]) -> list[Figure]:
    """Measured and modelled force over one revolution, a figure for each cut with a chart for each axis.

    An axis has one scale over all cuts, so that the pictures compare. Around the measured force stands the scatter of the
    revolutions, where the conditioned cut is at hand.
    """
    conditioned = conditioned_cuts(fit, cuts)
    measured, modelled = comparable(fit)
    y_ranges = [span_of(measured[:, row], modelled[:, row], include=(0.0,)) for row in range(3)]
    residual = measured - modelled
    reach = [max(float(np.nan_to_num(np.abs(residual[:, row])).max()) * 1.1, 1e-9) for row in range(3)]
    return [
        _revolution(fit, number, conditioned.get(number), (measured, modelled, residual), y_ranges, reach)
        for number in cuts_shown(len(fit.cuts))
    ]


def _revolution(
    fit: Coefficients,
    number: int,
    cut: CutForce | None,
    drawn: Sequence[np.ndarray],  # measured, modelled, residual: (cut, axis, angle) N
    y_ranges: Sequence[tuple[float, float]],
    reach: Sequence[float],
) -> Figure:
    name = cut_names(fit.cuts)[fit.cuts[number]]
    step = max(1, len(fit.angle) // ANGLES)
    kept = np.arange(0, len(fit.angle), step)
    degrees = np.degrees(fit.angle[kept])
    columns, drawings = [Column("spindle angle", "deg", degrees)], []
    for row in axes_measured(fit):
        axis = AXES[row]
        measured, modelled, left = (v[number, row, kept] for v in drawn)
        items: list[Item] = [Rule(0.0, "y", "zero")]
        if cut is not None:
            spread = np.interp(fit.angle[kept], cut.average_angle, cut.scatter[row], period=2 * np.pi)
            items.append(Band(degrees, measured - 2 * spread, measured + 2 * spread, "measured"))
        items += [Line(degrees, measured, "measured"), Line(degrees, modelled, "modelled")]
        under: list[Item] = [Rule(0.0, "y", "zero"), Line(degrees, left, "residual")]
        rms, whole = (float(np.sqrt(np.mean((v - v.mean()) ** 2))) for v in (left, measured))
        share = f": {100 * rms / whole:.0f} % of the AC force" if whole > 0 else ""
        panels = [
            Panel(f"F{axis}, N", items, 118, y_ranges[row], most_ticks=4),
            Panel(f"difference, N{share}", under, 46, (-reach[row], reach[row]), ticks=symmetric_ticks(reach[row])),
        ][: 2 if np.isfinite(rms) else 1]  # where the law does not know this axis, there is no difference
        drawings.append(
            chart(
                panels,
                x_label="spindle angle, deg",
                x_range=(0.0, 360.0),
                x_ticks=[(a, fixed(a, 0)) for a in (0, 90, 180, 270, 360)],
                frame=SMALL,
                label=f"Force F{axis} over one revolution of cut {name}: measured, modelled and their difference"
                + (f", which has {rms:.3g} N rms" if np.isfinite(rms) else ", which is not known"),
            )
        )
        columns += [Column(f"F{axis} measured", "N", measured), Column(f"F{axis} modelled", "N", modelled)]
    return Figure(
        f"revolution-{number}",
        name,
        conditions_in_words(fit.conditions[number]),
        drawings,
        columns,
        layout="thirds",
    )


def _last_harmonic(fit: Coefficients) -> int:
    """The last harmonic worth drawing: above four per cent of the axis's largest somewhere, and beyond the fit's band."""
    amplitude = np.nan_to_num(np.fmax(fit.measured_amplitude, fit.modelled_amplitude)[:, :, 1:])
    largest = amplitude.max(axis=(0, 2), keepdims=True)
    tall = np.flatnonzero((amplitude > 0.04 * np.maximum(largest, 1e-300)).any(axis=(0, 1)))
    needed = max(2 * fit.cutter.teeth + 2, fit.band[1] + 2, int(tall[-1]) + 1 if len(tall) else 0)
    return min(needed, amplitude.shape[2], 30)


def harmonics(fit: Coefficients) -> Figure | None:
    """Amplitude of each harmonic of the spindle, measured and modelled; within a harmonic the cuts stand by rising feed."""
    if fit.measured_amplitude.shape[2] < 2:
        return None
    last, teeth = _last_harmonic(fit), fit.cutter.teeth
    order = np.argsort(fit.feed_per_tooth, kind="stable")
    n = len(order)
    within = (np.arange(n) - (n - 1) / 2) / max(n - 1, 1) * 0.62 if n > 1 else np.zeros(1)
    numbers = np.arange(1, last + 1)
    x = (numbers[:, np.newaxis] + within).ravel()
    gaps = np.concatenate([numbers[:, np.newaxis] + within, np.full((last, 1), np.nan)], axis=1).ravel()
    tooth_passing = [Span(k - 0.5, k + 0.5, "slot") for k in range(teeth, last + 1, teeth)]
    beyond: list[Item] = []
    if 0 < fit.band[1] < last:
        beyond = [Rule(fit.band[1] + 0.5, "x", "limit"), Rule(fit.band[1] + 0.5, "x", "none", "not used in the fit →")]
    columns = [
        Column("harmonic", "", np.repeat(numbers, n).astype(float)),
        Column("feed per tooth", "mm", np.tile(fit.feed_per_tooth[order] * 1e3, last)),
    ]
    panels: list[Panel] = []
    axes = axes_measured(fit)
    for row in axes:
        axis = AXES[row]
        items: list[Item] = [*tooth_passing, *(beyond[:1] if panels else beyond)]
        for kind, shape, values in (
            ("measured", "dot", fit.measured_amplitude),
            ("modelled", "ring", fit.modelled_amplitude),
        ):
            amplitude = values[order, row, 1 : last + 1].T  # (harmonic, cut)
            line = np.concatenate([amplitude, np.full((last, 1), np.nan)], axis=1).ravel()
            items += [
                Line(gaps, line, f"{kind} thin"),
                Marks(x, amplitude.ravel(), kind, shape, size=2.2 if shape == "dot" else 3.4),
            ]
            columns.append(Column(f"F{axis} {kind}", "N", amplitude.ravel()))
        high = span_of(fit.measured_amplitude[:, row, 1:], fit.modelled_amplitude[:, row, 1:])[1]
        panels.append(Panel(f"amplitude of F{axis}, N", items, 116, (0.0, high), most_ticks=4))
    svg = chart(
        panels,
        x_label="harmonic of the spindle",
        x_range=(0.4, last + 0.6),
        x_ticks=[(k, str(k)) for k in range(1, last + 1)],
        label=f"Amplitudes of the harmonics 1 to {last} of the spindle, measured and modelled, for {n} cuts and {len(axes)} axes",
    )
    caption = (
        "Within each harmonic the cuts stand side by side by rising feed, so a line that rises is a force that grows with "
        f"feed. Shaded: tooth passing ({teeth} teeth) and its multiples. Harmonics that no multiple of the tooth number "
        "accounts for come from runout or unequal teeth."
    )
    key = (("marks dot measured", "measured"), ("marks ring modelled", "modelled"), ("span slot", "tooth passing"))
    return Figure("harmonics", "Harmonics of the force", caption, (svg,), columns, key)


def series_of_feed(fit: Coefficients) -> list[list[int]]:
    """Numbers of the cuts that differ in nothing but their feed, by rising feed; a list for each set of conditions."""
    groups: dict[tuple, list[int]] = {}
    for number in np.argsort(fit.feed_per_tooth, kind="stable").tolist():
        c = fit.conditions[number]
        same = (c.spindle_speed, c.axial_depth, c.radial_depth, c.direction)
        groups.setdefault(tuple(f"{v:.6g}" if isinstance(v, float) else v for v in same), []).append(number)
    return list(groups.values())


def mean_force(fit: Coefficients) -> Figure | None:
    """Mean force against feed per tooth, measured and modelled, with the residuals; a line for each set of conditions.

    None where no mean force is known.
    """
    if not mean_is_known(fit):
        return None
    groups = series_of_feed(fit)
    feed = fit.feed_per_tooth * 1e3
    left = fit.measured_mean - fit.modelled_mean
    drawings = []
    axes = np.flatnonzero(np.isfinite(fit.measured_mean).any(axis=0)).tolist()
    for row in axes:
        axis = AXES[row]
        items: list[Item] = [Rule(0.0, "y", "zero")]
        under: list[Item] = [Rule(0.0, "y", "zero")]
        for members in groups:
            items.append(Line(feed[members], fit.modelled_mean[members, row], "modelled"))
            under.append(Line(feed[members], left[members, row], "residual"))
        items += [
            Marks(feed, fit.modelled_mean[:, row], "modelled", "ring", size=4.2),
            Marks(feed, fit.measured_mean[:, row], "measured", "dot", size=2.8),
        ]
        under.append(Marks(feed, left[:, row], "measured", "dot", size=2.5))
        reach = max(float(np.nanmax(np.abs(left[:, row]))) * 1.25, 1e-9)
        panels = [
            Panel(f"mean F{axis}, N", items, 130, span_of(fit.measured_mean[:, row], fit.modelled_mean[:, row])),
            Panel("difference, N", under, 56, (-reach, reach), ticks=symmetric_ticks(reach)),
        ]
        drawings.append(
            chart(
                panels,
                x_label="feed per tooth, mm",
                x_range=span_of(feed, include=(0.0,) if len(feed) > 1 else ()),
                frame=SMALL,
                label=f"Mean force F{axis} against feed per tooth of {len(feed)} cuts: measured, modelled and difference; "
                f"R² {fit.r2[row]:.4f}",
            )
        )
    columns = [Column("feed per tooth", "mm", feed)]
    for row in axes:
        axis = AXES[row]
        columns += [
            Column(f"F{axis} measured", "N", fit.measured_mean[:, row]),
            Column(f"F{axis} modelled", "N", fit.modelled_mean[:, row]),
        ]
    more = f" {len(groups)} sets of conditions, a line for each." if len(groups) > 1 else ""
    caption = (
        "A straight law of the feed leaves residuals without a pattern. A bow in them is contact loss, drift or a law "
        f"that does not hold.{more}"
    )
    key = (("marks dot measured", "measured"), ("line modelled", "modelled"), ("line residual", "difference"))
    return Figure("mean-force", "Mean force against feed", caption, drawings, columns, key, layout="thirds")


SHAPES = ("ring", "square", "diamond", "triangle", "cross")


def intervals(fit: Coefficients) -> Figure | None:
    """Each coefficient with its 95 % interval, and beside it what other models say; a chart for each unit."""
    posterior = fit.posterior
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(posterior.names):
        if name[0] in "Kkm":
            groups.setdefault(parameter(name).unit, []).append(index)
    if not groups:
        return None
    drawings, rows, units = [], [], []
    others = fit.alternatives[: len(SHAPES)]
    for unit, members in groups.items():
        factor = parameter(posterior.names[members[0]]).factor
        n = len(members)
        place = np.arange(n, 0.0, -1.0)
        low, high = (posterior.interval[members, side] / factor for side in (0, 1))
        value = posterior.mean[members] / factor
        items: list[Item] = [
            Rule(0.0, "x", "zero"),
            Whiskers(place, low, high, "measured", lying=True),
            Marks(value, place, "measured", "dot", size=4),
        ]
        alternatives = []
        for number, (_, pairs) in enumerate(others):
            known = dict(pairs)
            x = np.array([known.get(posterior.names[i], np.nan) for i in members]) / factor
            below = place - 0.2 - 0.5 * number / max(len(others), 1)
            items.append(Marks(x, below, f"shade{number + 1}", SHAPES[number], size=3.4))
            alternatives.append(x)
        names = [parameter(posterior.names[i]).name for i in members]
        x_range = span_of(low, high, value, *alternatives, include=(0.0,))
        quantity = {"1": "exponent, 1"}.get(unit, f"coefficient, {unit}")
        drawings.append(
            chart(
                [Panel("", items, 46.0 * n, (0.2, n + 0.5), ticks=list(zip(place, names, strict=True)))],
                x_label=quantity,
                x_range=x_range,
                frame=Frame(width=450.0, left=52.0, right=12.0, head=8.0, foot=38.0, css="half"),
                label=f"Coefficients {', '.join(names)} in {unit} with 95 % intervals and the values of other models",
            )
        )
        units += [unit] * n
        rows += [
            (index, float(v), float(a), float(b)) for index, v, a, b in zip(members, value, low, high, strict=True)
        ]
    columns = [
        Column("coefficient", "", np.array([posterior.names[row[0]] for row in rows])),
        Column("unit", "", np.array(units)),
        *(Column(name, "", np.array([row[k] for row in rows])) for k, name in ((1, "value"), (2, "low"), (3, "high"))),
    ]
    key = [("marks dot measured", "this fit, with its 95 % interval")]
    key += [(f"marks {SHAPES[i]} shade{i + 1}", name) for i, (name, _) in enumerate(others)]
    caption = "An interval that holds zero does not tell the coefficient from zero. Marks far from the dot: the model matters."
    return Figure("intervals", "What the data say about each coefficient", caption, drawings, columns, key, "halves")
