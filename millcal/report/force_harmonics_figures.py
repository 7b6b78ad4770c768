"""Figures of a force that accelerations tell: its course, its harmonics, the accelerations behind it, the methods side by side.

Wherever an amplitude stands beside its standard deviation, both are on one logarithmic scale: a mark that does not rise
above its stroke says nothing.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import ForceHarmonics
from millcal.report.charts import (
    SMALL,
    Band,
    Frame,
    Item,
    Line,
    Marks,
    Note,
    Panel,
    Rule,
    Span,
    Whiskers,
    chart,
    decades_of,
    span_of,
)
from millcal.report.digits import fixed, significant
from millcal.report.figures import Column, Figure
from millcal.report.force_figures import ANGLES, cuts_shown
from millcal.report.wording import conditions_in_words, cut_names, parameter

NORMAL = 1.96  # quantile of 95 %
SHAPES = ("dot", "ring", "square", "diamond", "triangle", "cross")
OUTSIDE = 1.73  # |difference| / expected: above it one in twenty, where all is right (Rayleigh)
MOST_SENSORS = 12  # drawn as charts
FAR = 4.0  # half-widths of the nearer methods: what is farther off leaves the picture

KEY = {  # of the courses over a revolution
    "band": ("span band-main", "95 % band"),
    "alternating": ("line main", "from accelerations, without mean"),
    "law": ("line modelled", "the law's whole force, with its mean"),
    "dynamometer": ("line beside", "dynamometer, the same harmonics"),
}


def amplitude_sd(forces: ForceHarmonics) -> np.ndarray:
    """Standard deviation of |force|: that of the part along the force, or of either part where there is no force.

    returns (line, axis) N
    """
    n = len(forces.axes)
    size = np.abs(forces.force)
    real, imaginary = np.arange(n), np.arange(n, 2 * n)
    covariance = forces.force_covariance
    variances = covariance[:, real, real], covariance[:, imaginary, imaginary]
    with np.errstate(divide="ignore", invalid="ignore"):
        c, s = forces.force.real / size, forces.force.imag / size
        along = c**2 * variances[0] + 2 * c * s * covariance[:, real, imaginary] + s**2 * variances[1]
    variance = np.where(size > 0, along, (variances[0] + variances[1]) / 2)
    return np.sqrt(np.maximum(variance, 0.0))


def normalised(forces: ForceHarmonics) -> np.ndarray:
    """|measured - FRF times force| over what is expected of it.   returns (line, sensor)"""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(forces.measured - forces.modelled) / forces.deviation


def there(values: np.ndarray | None) -> bool:
    """Whether any of these values is known."""
    return values is not None and bool(np.isfinite(values).any())


def courses_key(forces: ForceHarmonics) -> list[tuple[str, str]]:
    """What is drawn over a revolution."""
    drawn = {
        "alternating": True,
        "band": there(forces.alternating_sd),
        "law": there(forces.law_force),
        "dynamometer": there(forces.dynamometer),
    }
    return [KEY[name] for name, shown in drawn.items() if shown]


def courses(forces: ForceHarmonics) -> list[Figure]:
    """Force over one revolution, a figure for each cut with a chart for each axis; an axis has one scale in all cuts."""
    half = NORMAL * forces.alternating_sd
    drawn = (
        forces.alternating,
        forces.alternating - half,
        forces.alternating + half,
        forces.law_force,
        forces.dynamometer,
    )
    ranges = [
        span_of(*(values[:, row] for values in drawn if values is not None), include=(0.0,))
        for row in range(len(forces.axes))
    ]
    return [_course(forces, number, ranges) for number in cuts_shown(len(forces.cuts))]


def _course(forces: ForceHarmonics, number: int, ranges: Sequence[tuple[float, float]]) -> Figure:
    kept = np.arange(0, len(forces.angle), max(1, len(forces.angle) // ANGLES))
    degrees = np.degrees(forces.angle[kept])
    columns, drawings = [Column("angle of tooth 0", "deg", degrees)], []
    name = cut_names(forces.cuts)[forces.cuts[number]]
    for row, axis in enumerate(forces.axes):
        value, half = forces.alternating[number, row, kept], NORMAL * forces.alternating_sd[number, row, kept]
        columns += [Column(f"F{axis} alternating", "N", value), Column(f"F{axis} 95 % ±", "N", half)]
        items: list[Item] = [
            Rule(0.0, "y", "zero"),
            Band(degrees, value - half, value + half, "main"),
            Line(degrees, value, "main"),
        ]
        said = ""
        if forces.law_force is not None:
            whole = forces.law_force[number, row]
            items.append(Line(degrees, whole[kept], "modelled"))
            columns.append(Column(f"F{axis} by the law", "N", whole[kept]))
            known = bool(np.isfinite(whole).all())
            said = f"; mean by the law {fixed(float(whole.mean()), 1)} N" if known else "; mean not known"
        if forces.dynamometer is not None:
            beside = forces.dynamometer[number, row, kept]
            items.append(Line(degrees, beside, "beside"))
            columns.append(Column(f"F{axis} dynamometer", "N", beside))
        drawings.append(
            chart(
                [Panel(f"F{axis}, N{said}", items, 130, ranges[row], most_ticks=5)],
                x_label="angle of tooth 0, deg",
                x_range=(0.0, 360.0),
                x_ticks=[(a, fixed(a, 0)) for a in (0, 90, 180, 270, 360)],
                frame=SMALL,
                label=f"Alternating force F{axis} over one revolution of cut {name} as the accelerations tell it, "
                f"{float(np.ptp(value)):.3g} N from lowest to highest",
            )
        )
    conditions = conditions_in_words(forces.conditions[number])
    return Figure(f"course-{number}", name, conditions, drawings, columns, layout="thirds")


def _by_cut(forces: ForceHarmonics) -> list[tuple[np.ndarray, str, str, str]]:
    """Lines that share a mark: those of a cut where cuts can be told apart, else all: (rows, class, shape, words)."""
    names = cut_names(forces.cuts)
    if len(forces.cuts) == 1 or len(forces.cuts) > len(SHAPES):
        word = "" if len(forces.cuts) == 1 else f", {len(forces.cuts)} cuts"
        return [(np.arange(len(forces.cut)), "shade0", "dot", f"amplitude{word}")]
    return [
        (np.flatnonzero(forces.cut == number), f"shade{number}", SHAPES[number], names[name])
        for number, name in enumerate(forces.cuts)
    ]


def _names_of_lines(forces: ForceHarmonics) -> np.ndarray:
    """The cut of each line, in words."""
    names = cut_names(forces.cuts)
    return np.array([names[forces.cuts[int(number)]] for number in forces.cut])


def _frequencies(forces: ForceHarmonics) -> tuple[float, float]:
    return 0.0, 1.04 * float(forces.frequency.max())


def harmonics(forces: ForceHarmonics) -> Figure:
    """Amplitude of the force at every line with its standard deviation, and how well the FRF of that line is conditioned."""
    deviation = amplitude_sd(forces)
    amplitude = np.abs(forces.force)
    groups = _by_cut(forces)
    at = forces.frequency
    panels = []
    columns = [
        Column("frequency", "Hz", at),
        Column("harmonic of the spindle", "", forces.order.astype(float)),
        Column("cut", "", _names_of_lines(forces)),
    ]
    for row, axis in enumerate(forces.axes):
        size, sd = amplitude[:, row], deviation[:, row]
        items: list[Item] = [Marks(at, sd, "expected", "dash", size=5)]
        items += [Marks(at[rows], size[rows], kind, shape) for rows, kind, shape, _ in groups]
        panels.append(Panel(f"amplitude of F{axis}, N", items, 112, _shown(size, sd), log=True, most_ticks=4))
        columns += [Column(f"F{axis}", "N", size), Column(f"F{axis} sd", "N", sd)]
    columns.append(Column("condition number", "", forces.condition))
    marks: list[Item] = [Marks(at[rows], forces.condition[rows], kind, shape) for rows, kind, shape, _ in groups]
    low, high = decades_of(forces.condition)
    panels.append(
        Panel("condition number of the FRF", marks, 84, (min(low, 0.9), max(high, 12.0)), log=True, most_ticks=4)
    )
    svg = chart(
        panels,
        x_label="frequency, Hz",
        x_range=_frequencies(forces),
        label=f"Amplitudes of the force at {len(at)} harmonics from {forces.band[0]:.4g} to {forces.band[1]:.4g} Hz with their "
        f"standard deviations; condition numbers from {forces.condition.min():.2g} to {forces.condition.max():.2g}",
    )
    key = [(f"marks {shape} {kind}", words) for _, kind, shape, words in groups]
    if there(deviation):
        key.append(("line expected", "standard deviation of the amplitude"))
    below = " A mark below its stroke is a force that is not told from zero." if there(deviation) else ""
    caption = (
        f"Peak amplitudes.{below} A high condition number makes noise into force: another spindle speed moves the harmonic "
        "to where the FRF tells the directions apart."
    )
    return Figure("force-harmonics", "Harmonics of the force", caption, (svg,), columns, key)


def misses(forces: ForceHarmonics) -> np.ndarray:
    """|force less that of each line by itself| over the standard deviation of the latter.   returns (line, axis)"""
    if forces.free_force is None or forces.free_sd is None:
        return np.full(forces.force.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(forces.force - forces.free_force) / forces.free_sd


def law_distance(forces: ForceHarmonics) -> Figure | None:
    """How far the force of every line is from what that line tells by itself; None where the record does not hold that."""
    missed = misses(forces)
    if not there(missed):
        return None
    at, ends = forces.frequency, np.array(_frequencies(forces))
    looks = [(f"shade{row}", SHAPES[row], axis) for row, axis in enumerate(forces.axes)]
    items: list[Item] = [Band(ends, np.zeros(2), np.full(2, OUTSIDE), "left")]
    items += [Marks(at, missed[:, row], kind, shape, size=3) for row, (kind, shape, _) in enumerate(looks)]
    high = 1.1 * max(float(np.nanmax(missed)), 1.5 * OUTSIDE)
    svg = chart(
        [Panel("distance, standard deviations", items, 110, (0.0, high), most_ticks=4)],
        x_label="frequency, Hz",
        x_range=_frequencies(forces),
        label=f"Distance of the force at {len(at)} harmonics from that of each harmonic by itself, at most "
        f"{float(np.nanmax(missed)):.2g} standard deviations",
    )
    columns = [
        Column("frequency", "Hz", at),
        Column("harmonic of the spindle", "", forces.order.astype(float)),
        Column("cut", "", _names_of_lines(forces)),
        *(Column(f"F{axis} distance", "sd", missed[:, row]) for row, axis in enumerate(forces.axes)),
    ]
    key = [(f"marks {shape} {kind}", f"F{axis}") for kind, shape, axis in looks]
    key.append(("span left", "19 of 20 marks, if the law holds"))
    caption = (
        "How far this force is from that of each harmonic by itself, for which the law was not asked. Marks that stand out "
        "at one frequency blame the FRF there; marks that stand out at all of them blame law, cutter or conditions."
    )
    return Figure("law-distance", "Does the law hold?", caption, (svg,), columns, key)


def _shown(size: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """A logarithmic scale for amplitudes, not more than four decades, and for the strokes as far as they are in it."""
    low, high = decades_of(size, sd)
    return max(low / 1.3, high * 1e-4), 1.3 * high


def accelerations(forces: ForceHarmonics) -> list[Figure]:
    """Measured against FRF times force at every line, a chart for each sensor, with the difference that is to be expected."""
    at = forces.frequency
    y_range = _shown(np.abs(np.stack([forces.measured, forces.modelled])), forces.deviation)
    left = normalised(forces)
    high = 1.1 * max(float(np.nan_to_num(left).max()), 2 * OUTSIDE)
    made = []
    for row in sensors_shown(forces):
        sensor = forces.sensors[row]
        measured, modelled = np.abs(forces.measured[:, row]), np.abs(forces.modelled[:, row])
        items: list[Item] = [
            Marks(at, forces.deviation[:, row], "expected", "dash", size=5),
            Marks(at, modelled, "modelled", "ring", size=4.4),
            Marks(at, measured, "measured", "dot", size=2.4),
        ]
        panels = [Panel("acceleration, m/s²", items, 118, y_range, log=True, most_ticks=4)]
        if there(left):
            ends = np.array(_frequencies(forces))
            under: list[Item] = [Band(ends, np.zeros(2), np.full(2, OUTSIDE), "left")]
            under.append(Marks(at, left[:, row], "measured", "dot", size=2.4))
            panels.append(Panel("difference / expected", under, 50, (0.0, high), most_ticks=3))
        svg = chart(
            panels,
            x_label="frequency, Hz",
            x_range=_frequencies(forces),
            frame=SMALL,
            label=f"Accelerations of {sensor} at {len(at)} harmonics, measured and as the FRF makes them of the force",
        )
        columns = [
            Column("frequency", "Hz", at),
            Column("cut", "", _names_of_lines(forces)),
            Column("measured", "m/s²", measured),
            Column("FRF times force", "m/s²", modelled),
            Column("difference", "m/s²", np.abs(forces.measured[:, row] - forces.modelled[:, row])),
            Column("expected difference", "m/s²", forces.deviation[:, row]),
            Column("difference / expected", "", left[:, row]),
        ]
        residual = float(forces.sensor_residual[row])
        caption = f"difference {fixed(residual**0.5, 2)} times the expected one" if np.isfinite(residual) else ""
        made.append(Figure(f"sensor-lines-{row}", sensor, caption, (svg,), columns))
    return made


def sensors_shown(forces: ForceHarmonics) -> list[int]:
    """Rows of the sensors that are drawn: all, or those that fit worst, in their order."""
    n = len(forces.sensors)
    if n <= MOST_SENSORS:
        return list(range(n))
    worst = np.argsort(-np.nan_to_num(forces.sensor_residual), kind="stable")[:MOST_SENSORS]
    return sorted(worst.tolist())


def accelerations_key(forces: ForceHarmonics) -> list[tuple[str, str]]:
    key = [("marks dot measured", "measured"), ("marks ring modelled", "FRF times force")]
    if not there(forces.deviation):
        return key
    return [*key, ("line expected", "expected difference"), ("span left", "19 of 20 differences, if all is right")]


def near(values: np.ndarray, half: float, best: float) -> np.ndarray:
    """Which values of other methods stay in the picture: those within four times what separates half of them from the best."""
    away = np.abs(values - best)
    finite = away[np.isfinite(away)]
    usual = float(np.median(finite)) if len(finite) else 0.0
    return away <= FAR * max(usual, half if np.isfinite(half) else 0.0, 1e-300)


def recommended_row(forces: ForceHarmonics) -> int:
    """The row of the recommended method among those compared; -1 where there is none or it has no answer."""
    if forces.recommended not in forces.compared_methods:
        return -1
    row = forces.compared_methods.index(forces.recommended)
    return row if np.isfinite(forces.compared[row]).all() else -1


def methods(forces: ForceHarmonics) -> Figure | None:
    """Each coefficient by each method, with its interval where the method has one; None where only one was tried."""
    names = forces.compared_methods
    if len(names) < 2 or not there(forces.compared):
        return None
    n = len(names)
    place = np.arange(n, 0.0, -1.0)
    best = recommended_row(forces)
    drawings = []
    columns = [Column("method", "", np.array(names))]
    for i, coefficient in enumerate(forces.posterior.names):
        known = parameter(coefficient)
        value, half = forces.compared[:, i] / known.factor, NORMAL * forces.compared_sd[:, i] / known.factor
        columns += [
            Column(known.name, known.unit, value),
            Column(f"{known.name} sd", known.unit, forces.compared_sd[:, i] / known.factor),
        ]
        kept = near(value, float(half[best]), float(value[best])) if best >= 0 else np.isfinite(value)
        x_range = reach_of(value, half, kept, best)
        inside = kept & np.isfinite(value)
        items: list[Item] = []
        if best >= 0 and np.isfinite(half[best]):
            items.append(Span(value[best] - half[best], value[best] + half[best], "agree-span"))
        items += [Whiskers(place[inside], (value - half)[inside], (value + half)[inside], "measured", lying=True)]
        others = inside & (np.arange(n) != best)
        items.append(Marks(value[others], place[others], "shade0", "ring", size=4))
        if best >= 0:
            items.append(Marks(value[[best]], place[[best]], "best", "diamond", size=4.5))
        for k in np.flatnonzero(~kept & np.isfinite(value)):
            below = value[k] < x_range[0]
            text = f"← {significant(float(value[k]))}" if below else f"{significant(float(value[k]))} →"
            edge = x_range[0] if below else x_range[1]
            items.append(Note(float(edge), float(place[k]) - 0.14, text, "start" if below else "end"))
        ticks = [(p, f"{name} ◂" if k == best else name) for k, (p, name) in enumerate(zip(place, names, strict=True))]
        drawings.append(
            chart(
                [Panel(f"{known.name}, {known.unit}", items, 23.0 * n, (0.4, n + 0.6), ticks=ticks)],
                x_label="",
                x_range=x_range,
                frame=Frame(width=320.0, left=108.0, right=14.0, head=24.0, foot=24.0, css="small"),
                label=f"{known.name} by {', '.join(names)} in {known.unit}; recommended is {forces.recommended or 'none'}",
            )
        )
    key = [("marks ring shade0", "method, with its 95 % interval where it has one")]
    caption = "A method far from the others, or with no interval, is no second opinion."
    if best >= 0:
        key.insert(0, ("marks diamond best", f"recommended: {forces.recommended}"))
        key.append(("span agree-span", "95 % interval of the recommended one"))
        why = forces.recommended_why.strip().rstrip(".")
        caption = (f"Recommended: {forces.recommended}, because {why}. " if why else "") + caption
        if forces.method != forces.recommended:
            caption += f" The coefficients of this report are those of {forces.method}."
    return Figure("methods", "Every method on the same lines", caption, drawings, columns, key, layout="thirds")


def reach_of(value: np.ndarray, half: np.ndarray, kept: np.ndarray, best: int) -> tuple[float, float]:
    """A scale for those values, the interval of the best among them, and the others' up to four times that.

    best : row, -1 for none: then four times the shortest
    """
    known = half[np.isfinite(half) & kept]
    usual = float(half[best]) if best >= 0 and np.isfinite(half[best]) else float(known.min()) if len(known) else 0.0
    short = np.minimum(np.nan_to_num(half), FAR * usual)
    shown = np.where(kept, value, np.nan)
    return span_of(shown, shown - short, shown + short)
