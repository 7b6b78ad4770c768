"""What a figure of the page is, and the figures of the recordings and of the FRF; figures for print are in `paper`.

A figure is one or more charts over one table of numbers: the table under the chart, the CSV to copy and the values that the
mouse reads are the same columns. Drawn as SVG by `charts` and not by a plotting library, also for a whole record: a
CutForce keeps its envelope, which is no longer than the page is wide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from millcal.data import AXES, CutForce, Frf
from millcal.report import charts, driving_points
from millcal.report.charts import HALF, Band, Item, Line, Panel, Rule, Span, chart, decades_of, span_of
from millcal.report.digits import csv_number, fixed
from millcal.report.driving_points import FORMS, PHASE_MIDDLE, driving_pairs, rows_drawn
from millcal.report.wording import cut_names

TABLE_ROWS = 24  # of the table under a chart
CSV_ROWS = 1000  # of the CSV under a chart: all that is drawn
POINTS = 700  # of a line across the page
MOST_CROSS = 6  # lines that an eye can follow
ENVELOPE = 240  # stretches of a whole record, about as many as its picture has columns to show


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a figure's numbers, or of words."""

    name: str
    unit: str
    values: np.ndarray  # (row,), numbers or str

    @property
    def heading(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def words(self) -> bool:
        return self.values.dtype.kind == "U"

    @property
    def decimals(self) -> int:
        """So many that the largest value shows four digits, and whole numbers none."""
        finite = self.values[np.isfinite(self.values)]
        largest = float(np.max(np.abs(finite))) if len(finite) else 0.0
        if largest == 0 or np.array_equal(finite, np.round(finite)):
            return 0
        return int(np.clip(3 - np.floor(np.log10(largest)), 0, 9))

    def texts(self, rows: np.ndarray) -> list[str]:
        """As the table under the chart shows them."""
        chosen = self.values[rows].tolist()
        return chosen if self.words else [fixed(value, self.decimals) for value in chosen]

    def csv(self, rows: np.ndarray) -> list[str]:
        """As the CSV holds them."""
        chosen = self.values[rows].tolist()
        return [text.replace(",", ";") for text in chosen] if self.words else [csv_number(value) for value in chosen]


@dataclass(frozen=True, eq=False)
class Figure:
    """Charts with what is said about them and the numbers behind them."""

    name: str  # id on the page
    title: str
    caption: str
    charts: Sequence[str]  # svg elements
    columns: Sequence[Column]
    key: Sequence[tuple[str, str]] = ()  # (classes of the sample, what it is)
    layout: str = "wide"  # wide, halves, thirds
    hint: str = field(default="", kw_only=True)  # shown where the reading of the mouse will stand

    def _rows(self, most: int) -> np.ndarray:
        n = len(self.columns[0].values)
        return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)) if n else np.arange(0)

    @property
    def thinned(self) -> bool:
        return len(self.columns[0].values) > TABLE_ROWS

    @property
    def rows(self) -> list[list[str]]:
        """The table under the chart, as text."""
        index = self._rows(TABLE_ROWS)
        return [list(row) for row in zip(*(column.texts(index) for column in self.columns), strict=True)]

    @property
    def csv(self) -> str:
        """The numbers to copy: a heading line, then a line for each row."""
        index = self._rows(CSV_ROWS)
        texts = [column.csv(index) for column in self.columns]
        heading = ",".join(column.heading.replace(",", ";") for column in self.columns)
        return "\n".join([heading, *(",".join(row) for row in zip(*texts, strict=True))])


def envelope(low: np.ndarray, high: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest and highest of each of at most so many stretches.   low, high : (axis, overview)   returns the starts too"""
    n = low.shape[1]
    starts = np.unique(np.linspace(0, n, min(n, most), endpoint=False).astype(int))
    return starts, np.fmin.reduceat(low, starts, axis=1), np.fmax.reduceat(high, starts, axis=1)


def overview(cuts: Sequence[CutForce]) -> list[Figure]:
    """The whole record of each cut as envelopes, with the steady part and the air cuts marked."""
    short = cut_names([cut.name for cut in cuts])
    return [_overview(cut, short[cut.name], number) for number, cut in enumerate(cuts)]


def _overview(cut: CutForce, name: str, number: int) -> Figure:
    starts, low, high = envelope(cut.overview_low, cut.overview_high, ENVELOPE)
    time = cut.overview_time[starts]
    panels = []
    for row, axis in enumerate(AXES):
        spans: list[Item] = [Span(*cut.steady, "steady", "steady" if row == 0 else "")]
        spans += [Span(*air, "air", "air" if row == 0 else "") for air in cut.air]
        y_range = span_of(low[row], high[row], include=(0.0,))
        items = [*spans, Rule(0.0, "y", "zero"), Band(time, low[row], high[row], "signal")]
        panels.append(Panel(f"F{axis}, N", items, 56, y_range, most_ticks=4))
    label = (
        f"Force against time of cut {name} in x, y and z as envelopes; steady from {cut.steady[0]:.2f} to "
        f"{cut.steady[1]:.2f} s, {len(cut.air)} stretches of air cut"
    )
    svg = chart(panels, x_label="time, s", x_range=(min(0.0, float(time[0])), float(time[-1])), label=label, frame=HALF)
    columns = [Column("time", "s", time)]
    for row, axis in enumerate(AXES):
        columns += [Column(f"F{axis} lowest", "N", low[row]), Column(f"F{axis} highest", "N", high[row])]
    return Figure(f"overview-{number}", name, "", (svg,), columns)


def driving_point(frf: Frf, output: int, given: int) -> Figure:
    """Magnitude, phase and coherence of one driving direction with the 95 % band of its variance."""
    symbol, unit, _ = FORMS[frf.form]
    middle = PHASE_MIDDLE[frf.form]
    point = driving_points.driving_point(frf, output, given)
    frequency, magnitude = point.frequency, point.magnitude
    chosen = np.union1d(
        charts.thin(frequency, np.log(magnitude + 1e-300), POINTS), charts.thin(frequency, point.phase, 200)
    )
    f, m, p = frequency[chosen], magnitude[chosen], point.phase[chosen]
    columns = [Column("frequency", "Hz", f), Column("magnitude", unit, m), Column("phase", "deg", p)]
    magnitude_items: list[Item] = [Span(*frf.usable_band, "usable")]
    phase_items: list[Item] = [Span(*frf.usable_band, "usable")]
    if point.low is not None and point.high is not None and point.turn is not None:
        low, high, turn = point.low[chosen], point.high[chosen], point.turn[chosen]
        magnitude_items.append(Band(f, low, high, "main"))
        phase_items.append(Band(f, p - turn, p + turn, "main"))
        columns[2:2] = [Column("magnitude low", unit, low), Column("magnitude high", unit, high)]
    magnitude_items.append(Line(f, m, "main"))
    phase_items.append(Line(f, p, "main"))
    quarter = [(angle, fixed(angle, 0)) for angle in (middle - 90.0, middle, middle + 90.0)]
    panels = [
        Panel(f"magnitude |{symbol}|, {unit}", magnitude_items, 170, decades_of(m), log=True, most_ticks=8),
        Panel("phase, deg", phase_items, 84, (middle - 135.0, middle + 135.0), ticks=quarter),
    ]
    if point.coherence is not None:
        coherence = point.coherence
        kept = np.union1d(chosen, charts.thin(frequency, coherence, 200))
        line = Line(frequency[kept], coherence[kept], "main")
        items: list[Item] = [Span(*frf.usable_band, "usable"), Rule(0.9, "y", "rule"), line]
        panels.append(Panel("coherence γ²", items, 70, (0.0, 1.04), ticks=[(0, "0"), (0.5, "0.5"), (0.9, "0.9")]))
        columns.append(Column("coherence", "", coherence[chosen]))
    to, at = frf.inputs[given], frf.outputs[output]
    peak = int(np.argmax(magnitude))
    label = (
        f"{frf.form} from {to} to {at} against frequency: magnitude, phase and coherence; the highest magnitude "
        f"{magnitude[peak]:.3g} {unit} stands at {frequency[peak]:.0f} Hz"
    )
    svg = chart(
        panels,
        x_label="frequency, Hz",
        x_range=(float(f[0]), float(f[-1])),
        x_log=True,
        label=label,
        frame=HALF,
        hover=True,
    )
    hits = frf.hits_used[given] if given < len(frf.hits_used) else 0
    one = " One hit: its coherence is 1 by definition and says nothing." if hits == 1 else ""
    caption = f"{hits} hits, {frf.estimator.upper()}.{one}" if hits else frf.estimator.upper()
    return Figure(f"frf-{output}-{given}", f"Hammer {to}, response {at}", caption, (svg,), columns, hint="frequency")


def cross_directions(frf: Frf) -> Figure | None:
    """Magnitudes across the directions of the driving points; None where there is only one."""
    driving = driving_pairs(frf)
    pairs = [(o, i) for _, i in driving for o, _ in driving if (o, i) not in driving][:MOST_CROSS]
    if not pairs:
        return None
    symbol, unit, factor = FORMS[frf.form]
    rows = rows_drawn(frf)
    frequency = frf.frequency[rows]
    kept = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), POINTS)).round().astype(int))
    columns, lines = [Column("frequency", "Hz", frequency[kept])], []
    for number, (o, i) in enumerate(pairs):
        magnitude = factor * np.abs(frf.values[rows, o, i])
        chosen = charts.thin(frequency, np.log(magnitude + 1e-300), 300)
        name = f"{frf.outputs[o]}/{frf.inputs[i]}"
        lines.append(Line(frequency[chosen], magnitude[chosen], f"thin shade{number % 6}", name))
        columns.append(Column(name, unit, magnitude[kept]))
    items: list[Item] = [Span(*frf.usable_band, "usable", "usable band"), *lines]
    panel = Panel(
        f"magnitude |{symbol}|, {unit}", items, 220, decades_of(*(line.y for line in lines)), log=True, most_ticks=8
    )
    svg = chart(
        [panel],
        x_label="frequency, Hz",
        x_range=(float(frequency[0]), float(frequency[-1])),
        x_log=True,
        label=f"Magnitude of the {len(pairs)} cross {frf.form}s against frequency",
        frame=charts.Frame(right=130.0),
        hover=True,
    )
    caption = "Response across the direction of the hammer, named response/hammer."
    return Figure("frf-cross", "Cross directions", caption, (svg,), columns, hint="frequency")


def hammer_spectrum(frf: Frf) -> Figure | None:
    """Force spectrum of the mean hit of each input; None where the record keeps none."""
    if frf.force_spectrum is None:
        return None
    shown = (frf.frequency >= frf.usable_band[1] / 80) & (frf.frequency <= 2.5 * frf.usable_band[1])
    if np.count_nonzero(shown) < 2:
        return None
    frequency, force = frf.frequency[shown], frf.force_spectrum[shown]
    lines = []
    for i, name in enumerate(frf.inputs):
        chosen = charts.thin(frequency, force[:, i], 300)
        lines.append(Line(frequency[chosen], force[chosen, i], f"shade{i % 6}", name))
    kept = np.unique(np.linspace(0, len(frequency) - 1, min(len(frequency), CSV_ROWS)).round().astype(int))
    columns = [Column("frequency", "Hz", frequency[kept])]
    columns += [Column(name, "N s", force[kept, i]) for i, name in enumerate(frf.inputs)]
    high = decades_of(*(line.y for line in lines))[1]
    items: list[Item] = [Span(*frf.usable_band, "usable", "usable band"), *lines]
    svg = chart(
        [Panel("|F|, N s", items, 170, (high * 2e-4, high), log=True)],
        x_label="frequency, Hz",
        x_range=(float(frequency[0]), float(frequency[-1])),
        x_log=True,
        label="Force spectrum of the hammer against frequency for " + ", ".join(frf.inputs),
        frame=replace(HALF, right=78.0),
        hover=True,
    )
    caption = "Spectrum of the hits. Where the hammer gives little force, the FRF is noise."
    return Figure("hammer", "Force of the hammer", caption, (svg,), columns, hint="frequency")
