"""Figures of coefficients that change while cutting: their course, the force in short windows, what was not foreseen.

A filter begins with the wide band of its prior. A picture shows the band from where it has come down to three times what
it comes to, so that wear is seen; before that the band leaves the picture, which the caption says.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import CoefficientHistory
from millcal.report.charts import (
    HALF,
    SMALL,
    Band,
    Item,
    Line,
    Marks,
    Note,
    Panel,
    Rule,
    Span,
    Tags,
    chart,
    span_of,
    symmetric_ticks,
    thin,
)
from millcal.report.digits import fixed, nice_ticks, nominal, significant, tick_labels
from millcal.report.figures import Column, Figure
from millcal.report.wording import SIDES, cut_names, parameter, time_unit

POINTS = 320  # of a line over the whole time
STRETCHES = 80  # of the whole time, over which innovations are put together
WINDOW_POINTS = 400  # of a line in a window
MOST_WINDOWS = 6
UNSETTLED = 3.0  # times the width of its narrow quarter: a band that a filter has not yet narrowed
_BAND = ("span band-main", "95 % band")


def settled(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Steps whose band is no wider than three times what it comes down to; all where no band is known.   (step,) each"""
    width = high - low
    known = np.isfinite(width)
    usual = float(np.quantile(width[known], 0.25)) if known.any() else np.inf
    return ~(width > UNSETTLED * usual)


def range_of(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[float, float]:
    """The range of a picture of a course and its band."""
    shown = settled(low, high)
    return span_of(value[shown], low[shown], high[shown], margin=0.08)


def cut_spans(history: CoefficientHistory) -> list[tuple[int, float, float]]:
    """Each cut with the time, s, from its first step to the first of the next: (index, start, stop)."""
    starts = np.flatnonzero(np.diff(history.cut, prepend=np.nan) != 0)
    ends = [*history.time[starts[1:]].tolist(), float(history.time[-1])]
    return [(int(history.cut[i]), float(history.time[i]), end) for i, end in zip(starts.tolist(), ends, strict=True)]


def time_ends(history: CoefficientHistory, unit: float) -> tuple[float, float]:
    """The range of a picture of the whole time, in units of so many seconds; from zero where that is near."""
    low, high = float(history.time[0]) / unit, float(history.time[-1]) / unit
    if 0 < low < 0.1 * high:
        low = 0.0
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _instants(ends: tuple[float, float], most: int) -> list[tuple[float, str]]:
    """Ticks of the time of a small chart."""
    ticks = nice_ticks(*ends, most)
    return list(zip(ticks, tick_labels(ticks), strict=True))


def _marked(history: CoefficientHistory, unit: float, *, named: bool) -> list[Item]:
    """Where a cut begins and where a jump was found; with names over the panel or without."""
    spans = cut_spans(history)
    names = cut_names(history.cuts)
    items: list[Item] = []
    if len(spans) > 1:
        for number, (cut, start, stop) in enumerate(spans):
            label = names[history.cuts[cut]] if named else ""
            items.append(Span(start / unit, stop / unit, "slot" if number % 2 else "clear", label))
        items += [Rule(start / unit, "x", "border") for _, start, _ in spans[1:]]
    items += [Rule(jump.time / unit, "x", "jump") for jump in history.jumps]
    if named and history.jumps:
        numbers = [str(number) for number, _ in enumerate(history.jumps, 1)]
        items.append(Tags([jump.time / unit for jump in history.jumps], numbers))
    return items


def _marks_key(history: CoefficientHistory) -> list[tuple[str, str]]:
    key = []
    if history.jumps:
        key.append(("line jump", "a jump" if len(history.jumps) == 1 else "jumps, numbered as in the table"))
    if len(cut_spans(history)) > 1:
        key.append(("line border", "the next cut begins"))
    return key


def _course(time: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray, points: int) -> list[Item]:
    """The band and the line in it, thinned with their peaks."""
    ends = [thin(time, v, points // 2) for v in (low, high) if np.isfinite(v).any()]
    kept = np.unique(np.concatenate([thin(time, value, points), *ends]))
    return [Band(time[kept], low[kept], high[kept], "main"), Line(time[kept], value[kept], "main")]


def _leaves(history: CoefficientHistory, low: np.ndarray, high: np.ndarray) -> str:
    """A word about bands that leave the picture.   low, high : (step, column)"""
    gone = [not settled(low[:, i], high[:, i]).all() for i in range(low.shape[1])]
    return " Where a band is wider than three times what it comes down to, it leaves the picture." if any(gone) else ""


def specific_force(history: CoefficientHistory) -> Figure:
    """The specific force at the reference chip over time, a panel for each direction, with band, jumps and cuts."""
    unit, word = time_unit(history.time[-1] - history.time[0])
    time = history.time / unit
    value, low, high = (v / 1e6 for v in (history.specific_force, history.specific_low, history.specific_high))
    panels, columns = [], [Column("time", word, time)]
    for i, direction in enumerate(history.directions):
        items = _marked(history, unit, named=i == 0)
        items += _course(time, value[:, i], low[:, i], high[:, i], 2 * POINTS)
        y_range = range_of(value[:, i], low[:, i], high[:, i])
        panels.append(Panel(f"{SIDES[direction]}, N/mm²", items, 118, y_range, most_ticks=4))
        columns += [
            Column(SIDES[direction], "N/mm²", value[:, i]),
            Column(f"{SIDES[direction]} low", "N/mm²", low[:, i]),
            Column(f"{SIDES[direction]} high", "N/mm²", high[:, i]),
        ]
    chip = nominal(round(history.reference_chip * 1e6, 1))
    ends = "; ".join(
        f"{SIDES[d]} {significant(value[0, i], 4)} to {significant(value[-1, i], 4)} N/mm²"
        for i, d in enumerate(history.directions)
    )
    label = f"Specific force on a chip of {chip} µm over time, from the first step to the last: {ends}"
    svg = chart(panels, x_label=f"time, {word}", x_range=time_ends(history, unit), label=label, hover=True)
    caption = (
        f"Force per area of a chip {chip} µm thick, the thickness at which these cuts tell it best: what the edge costs, "
        f"whatever law it follows.{_leaves(history, low, high)}"
    )
    key = [("line main", "specific force")]
    key += [_BAND] if np.isfinite(low).any() else []
    key += _marks_key(history)
    return Figure("specific-force", "Specific force over time", caption, (svg,), columns, key, hint="time")


def coefficients(history: CoefficientHistory) -> Figure:
    """Every coefficient of the law over time, a small chart for each."""
    unit, word = time_unit(history.time[-1] - history.time[0])
    time = history.time / unit
    frame, layout = (SMALL, "thirds") if len(history.directions) > 2 else (HALF, "halves")
    columns, drawings = [Column("time", word, time)], []
    ends, banded = time_ends(history, unit), False
    x_ticks = _instants(ends, 6 if frame is HALF else 4)
    for i, name in enumerate(history.names):
        known = parameter(name)
        value, low, high = (v[:, i] / known.factor for v in (history.value, history.low, history.high))
        items = [*_marked(history, unit, named=False), *_course(time, value, low, high, POINTS)]
        if not np.isfinite(value).any():
            items.append(Note((ends[0] + ends[1]) / 2, 0.5, "not known"))
        shown = known.unit.strip("1")
        panel = Panel(f"{name}, {shown}" if shown else name, items, 104, range_of(value, low, high), most_ticks=4)
        label = (
            f"{name} over time: {significant(value[0])} at the start and {significant(value[-1])} {shown} at the end"
        )
        drawings.append(
            chart([panel], x_label=f"time, {word}", x_range=ends, x_ticks=x_ticks, frame=frame, label=label)
        )
        columns += [Column(name, shown, value), Column(f"{name} low", shown, low), Column(f"{name} high", shown, high)]
        banded |= bool(np.isfinite(low).any())
    moves = "Force per area of chip and force per length of edge move against each other"
    if history.law == "kienzle":
        moves = (
            "k is the force on a chip of 1 mm × 1 mm, far from the chips of these cuts, so that k and m move together"
        )
    caption = f"{moves}; each band is that of one coefficient by itself.{_leaves(history, history.low, history.high)}"
    key = [("line main", "coefficient"), *([_BAND] if banded else []), *_marks_key(history)]
    return Figure("coefficient-history", "Each coefficient over time", caption, drawings, columns, key, layout)


def windows(history: CoefficientHistory) -> list[Figure]:
    """Measured and modelled force in the windows that are shown, a figure for each with a chart for each axis.

    An axis has one scale in all windows, so that they compare.
    """
    y_ranges = [span_of(m, f, include=(0.0,)) for m, f in zip(history.measured, history.modelled, strict=True)]
    left = np.abs(history.measured - history.modelled)
    reach = [
        max(1.1 * float(np.nanmax(row)) if np.isfinite(row).any() else 0.0, 2.5 * float(np.nan_to_num(noise)), 1e-9)
        for row, noise in zip(left, history.noise, strict=True)
    ]
    numbers = np.unique(history.shown_window)
    chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), MOST_WINDOWS)).round().astype(int))]
    return [
        _window(history, number, _place(order, len(chosen)), y_ranges, reach)
        for order, number in enumerate(chosen.tolist())
    ]


def _place(order: int, count: int) -> str:
    if count < 2:
        return "Window"
    if order in (0, count - 1):
        return "Start" if order == 0 else "End"
    return "Middle" if count == 3 else f"Window {order + 1}"


def _window(
    history: CoefficientHistory,
    number: float,
    place: str,
    y_ranges: Sequence[tuple[float, float]],
    reach: Sequence[float],
) -> Figure:
    rows = np.flatnonzero(history.shown_window == number)
    start = float(history.shown[rows[0]])
    span = float(history.shown[rows[-1]]) - start
    inner, inner_word = (1.0, "s") if span > 2 else (1e-3, "ms")
    time = (history.shown[rows] - start) / inner
    unit, word = time_unit(history.time[-1] - history.time[0])
    at = f"{significant(start / unit)} {word}"
    if len(history.cuts) > 1 and len(history.time):
        step = min(int(np.searchsorted(history.time, start)), len(history.time) - 1)
        at += f", {cut_names(history.cuts)[history.cuts[int(history.cut[step])]]}"
    frame = SMALL if len(history.axes) > 2 else HALF
    columns, drawings = [Column("time", inner_word, time)], []
    for row, axis in enumerate(history.axes):
        measured, modelled = history.measured[row, rows], history.modelled[row, rows]
        left = measured - modelled
        kept = np.union1d(thin(time, measured, WINDOW_POINTS), thin(time, modelled, WINDOW_POINTS // 2))
        items: list[Item] = [Rule(0.0, "y", "zero")]
        items += [Line(time[kept], measured[kept], "measured"), Line(time[kept], modelled[kept], "modelled")]
        noise = float(history.noise[row])
        ends = np.array([time[0], time[-1]])
        under: list[Item] = [Band(ends, np.full(2, -2 * noise), np.full(2, 2 * noise), "left")]
        kept = thin(time, left, WINDOW_POINTS)
        under += [Rule(0.0, "y", "zero"), Line(time[kept], left[kept], "residual")]
        rms = float(np.sqrt(np.nanmean(left**2))) if np.isfinite(left).any() else np.nan
        panels = [
            Panel(f"F{axis}, N", items, 118, y_ranges[row], most_ticks=4),
            Panel("difference, N", under, 46, (-reach[row], reach[row]), ticks=symmetric_ticks(reach[row])),
        ]
        x_range = (0.0, float(time[-1]) or 1.0)
        label = (
            f"Force F{axis} measured and modelled over {significant(span / inner)} {inner_word} from {at} on, "
            f"and their difference, which has {significant(rms)} N rms"
        )
        drawings.append(chart(panels, x_label=f"time, {inner_word}", x_range=x_range, frame=frame, label=label))
        columns += [Column(f"F{axis} measured", "N", measured), Column(f"F{axis} modelled", "N", modelled)]
    layout = "thirds" if len(history.axes) > 2 else "halves"
    return Figure(f"force-window-{number:.0f}", f"{place}: {at}", "", drawings, columns, layout=layout)


def windows_key(history: CoefficientHistory) -> list[tuple[str, str]]:
    """What the lines of the windows are."""
    key = [("line measured", "measured"), ("line modelled", "modelled"), ("line residual", "difference")]
    return [*key, ("span left", "± 2 sd of the noise")] if np.isfinite(history.noise).any() else key


def stretches(history: CoefficientHistory, most: int = STRETCHES) -> dict[str, np.ndarray]:
    """Innovations put together over stretches of the record, in standard deviations of the noise and of the forecast.

    returns time (stretch,) s, mean and rms (stretch, axis), samples (stretch, axis), nan where they are not known
    """
    steps = len(history.time)
    edges = np.unique(np.linspace(0, steps, min(steps, most), endpoint=False).astype(int))
    weight = np.ones(steps) if history.innovation_samples is None else history.innovation_samples
    known = np.isfinite(history.innovation_mean) & np.isfinite(history.innovation_square)
    weights = np.where(known, weight[:, np.newaxis], 0.0)

    def over(values: np.ndarray) -> np.ndarray:
        total = np.add.reduceat(weights, edges, axis=0)
        summed = np.add.reduceat(np.where(known, weights * np.nan_to_num(values), 0.0), edges, axis=0)
        return np.where(total > 0, summed / np.maximum(total, 1e-300), np.nan)

    samples = np.add.reduceat(weights, edges, axis=0)
    return {
        "time": np.add.reduceat(history.time, edges) / np.diff(np.append(edges, steps)),
        "mean": over(history.innovation_mean),
        "rms": np.sqrt(np.maximum(over(history.innovation_square), 0.0)),
        "samples": np.where(samples > 0, samples, np.nan)
        if history.innovation_samples is not None
        else np.full(samples.shape, np.nan),
    }


def expected_mean(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the mean of so many innovations lies with 95 % if model and noise are right."""
    half = 1.96 / np.sqrt(samples)
    return -half, half


def expected_rms(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of their root mean square, by the cube root that is nearly normal  [Wilson, Hilferty 1931]."""
    spread = 2 / (9 * samples)
    ends = [np.maximum(1 - spread + side * 1.96 * np.sqrt(spread), 0.0) ** 1.5 for side in (-1, 1)]
    return ends[0], ends[1]


def innovations_are_known(history: CoefficientHistory) -> bool:
    """Whether the record holds any."""
    return bool((np.isfinite(history.innovation_mean) & np.isfinite(history.innovation_square)).any())


def innovations(history: CoefficientHistory) -> Figure | None:
    """How far the force was from its forecast, mean and rms over stretches, with the range that is to be expected."""
    if not innovations_are_known(history):
        return None
    unit, word = time_unit(history.time[-1] - history.time[0])
    seen = stretches(history)
    time = seen["time"] / unit
    ends = time_ends(history, unit)
    columns, drawings, outside = [Column("time", word, time)], [], []
    for kind, right, expected in (("mean", 0.0, expected_mean), ("rms", 1.0, expected_rms)):
        panels = []
        for row, axis in enumerate(history.axes):
            values = seen[kind][:, row]
            low, high = expected(seen["samples"][:, row])
            items: list[Item] = [*_marked(history, unit, named=False), Band(time, low, high, "left")]
            items += [Rule(right, "y", "zero"), Marks(time, values, "main", "dot", size=2.2)]
            y_range = span_of(values, low, high, include=(right,), margin=0.1)
            panels.append(Panel(f"F{axis}: {kind}", items, 74, y_range, most_ticks=4))
            columns += [Column(f"F{axis} {kind}", "", values)]
            columns += [Column(f"F{axis} {kind} expected {end}", "", v) for end, v in (("low", low), ("high", high))]
            if np.isfinite(low).any():
                share = np.mean((values < low) | (values > high))
                outside.append(f"F{axis} {kind} {fixed(100 * float(share), 0)} %")
        drawings.append(
            chart(
                panels,
                x_label=f"time, {word}",
                x_range=ends,
                x_ticks=_instants(ends, 6),
                frame=HALF,
                label=f"{kind} of the normalised innovations of F{', F'.join(history.axes)} over {len(time)} stretches of time",
            )
        )
    caption = (
        f"Measured less foreseen force, in standard deviations, over {len(time)} stretches. "
        "A mean off zero is what the law cannot follow; an rms above 1 is more than noise."
    )
    if outside:
        caption += f" Outside the range: {', '.join(outside)}; 5 % are to be expected."
    key = [("marks dot main", "over a stretch")]
    key += [("span left", "95 % range if model and noise are right")] if outside else []
    key += _marks_key(history)
    columns = [column for column in columns if np.isfinite(column.values).any()]
    return Figure("innovations", "What was not foreseen", caption, drawings, columns, key, "halves")
