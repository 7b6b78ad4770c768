"""Line charts as inline SVG: panels stacked over one abscissa, drawn with classes that the page's style sheet colours.

The style sheet gives each class its colour for light, dark and paper and its own line style, so one drawing serves all
three, nothing depends on colour alone, and the text is the page's text. Own code and not a plotting library: a page holds
some dozens of small charts, and an SVG of a few kB each, the same bytes every time, is all they need.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from math import log10

import numpy as np

from millcal.report import svg
from millcal.report.digits import log_tick_labels, log_ticks, nice_ticks, tick_labels


@dataclass(frozen=True, eq=False)
class Line:
    """A line through points; a gap where a value is not finite."""

    x: np.ndarray  # (point,)
    y: np.ndarray  # (point,)
    kind: str  # classes of the style sheet: "measured", "modelled x"
    label: str = ""  # stands at the right end of the line


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two lines; several areas where values that are not finite part them."""

    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    kind: str


@dataclass(frozen=True, eq=False)
class Marks:
    """Points: dot, ring, square, diamond, cross, dash or, where they are many, point; labels stand above them.

    The shape word is the label itself in the place of the point.
    """

    x: np.ndarray
    y: np.ndarray
    kind: str
    shape: str = "dot"
    labels: Sequence[str] = ()
    size: float = 3.5
    below: bool = False  # the labels stand below the points


@dataclass(frozen=True, eq=False)
class Whiskers:
    """Intervals with end strokes: upright at places of the abscissa, or lying at places of the ordinate."""

    at: np.ndarray
    low: np.ndarray
    high: np.ndarray
    kind: str
    lying: bool = False


@dataclass(frozen=True)
class Span:
    """A stretch of the abscissa, shaded over the whole height."""

    start: float
    stop: float
    kind: str
    label: str = ""  # above the panel, over a bracket that spans the stretch


@dataclass(frozen=True)
class Rule:
    """A straight line across the panel at one value of an axis."""

    at: float
    axis: str  # "x": vertical; "y": horizontal
    kind: str = "rule"
    label: str = ""


@dataclass(frozen=True)
class Note:
    """A word at a place of the panel."""

    x: float
    y: float
    text: str
    anchor: str = "middle"
    kind: str = "note"


@dataclass(frozen=True)
class Tags:
    """Short names of places of the abscissa, above the panel, pushed apart where they would overlap."""

    at: Sequence[float]
    labels: Sequence[str]


Item = Line | Band | Marks | Whiskers | Span | Rule | Note | Tags


@dataclass(frozen=True, eq=False)
class Panel:
    """One ordinate: what is drawn on it, in order, and its scale."""

    label: str  # quantity and unit; stands above the ordinate
    items: Sequence[Item]
    height: float
    y_range: tuple[float, float]
    log: bool = False
    ticks: Sequence[tuple[float, str]] | None = None  # None: round numbers
    most_ticks: int = 5
    right_label: str = ""  # of a second ordinate, in the values of the first
    right_ticks: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True)
class Frame:
    """Size and margins of a chart, in the SVG's units."""

    width: float = 900.0
    left: float = 58.0
    right: float = 30.0
    head: float = 26.0  # above a panel, for the ordinate's label
    foot: float = 42.0  # under the last panel, for ticks and the abscissa's label
    css: str = "wide"


HALF = Frame(width=450.0, left=52.0, right=20.0, head=25.0, foot=40.0, css="half")
SMALL = Frame(width=320.0, left=44.0, right=16.0, head=23.0, foot=40.0, css="small")
TAG = 14.0  # height of a row of tags
SAMPLE = 16.0  # length of a piece of a line beside its name


class _Scale:
    """Where a value lies on the drawing."""

    def __init__(self, values: tuple[float, float], pixels: tuple[float, float], log: bool = False):
        self.log = log
        low, high = (log10(v) for v in values) if log else values
        self.factor = (pixels[1] - pixels[0]) / ((high - low) or 1.0)
        self.offset = pixels[0] - low * self.factor

    def __call__(self, value):
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                value = np.log10(value)
        return np.clip(self.offset + np.asarray(value, float) * self.factor, -9e3, 9e3)


def span_of(*values: np.ndarray | None, margin: float = 0.06, include: Sequence[float] = ()) -> tuple[float, float]:
    """A range that holds all finite values and a margin around them."""
    arrays = [np.ravel(np.asarray(v, float)) for v in values if v is not None]
    finite = np.concatenate([*arrays, np.asarray(include, float)])
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    pad = margin * (high - low) or 0.05 * abs(high) or 1.0
    return low - pad, high + pad


def decades_of(*values: np.ndarray | None) -> tuple[float, float]:
    """A range for a logarithmic ordinate: holds all positive values, and not more than eight decades."""
    finite = np.concatenate([np.ravel(np.asarray(v, float)) for v in values if v is not None])
    finite = finite[np.isfinite(finite) & (finite > 0)]
    if not len(finite):
        return 0.1, 10.0
    high = float(finite.max()) * 1.25
    return max(float(finite.min()) / 1.25, high * 1e-8), high


def thin(x: np.ndarray, y: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most so many points that keep the lowest and highest of every stretch.   returns (index,) ascending"""
    n = len(x)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, most // 2 + 1).astype(int)
    filled = np.where(np.isfinite(y), y, 0.0)
    chosen = {0, n - 1}
    for start, stop in pairwise(edges.tolist()):
        chosen.add(start + int(np.argmin(filled[start:stop])))
        chosen.add(start + int(np.argmax(filled[start:stop])))
    return np.array(sorted(chosen))


def _draw(item: Item, sx: _Scale, sy: _Scale, width: float, height: float) -> list[str]:
    """The item in the panel's own coordinates; what leaves the panel is cut off by the inner svg."""
    if isinstance(item, Line):
        x, y = sx(item.x), sy(item.y)
        return [f'<polyline class="line {item.kind}" points="{svg.pairs(x[run], y[run])}"/>' for run in svg.runs(x, y)]
    if isinstance(item, Band):
        x, low, high = sx(item.x), sy(item.low), sy(item.high)
        rings = [
            f"{svg.pairs(x[run], high[run])} {svg.pairs(x[run][::-1], low[run][::-1])}"
            for run in svg.runs(x, low, high)
        ]
        if len(rings) < 2:
            return [f'<polygon class="band {item.kind}" points="{points}"/>' for points in rings]
        d = "".join(f"M{points}z" for points in rings)  # one shape: no seam where two meet
        return [f'<path class="band {item.kind}" d="{d}"/>']
    if isinstance(item, Span):
        start, stop = float(sx(item.start)), float(sx(item.stop))
        start, stop = max(start, 0.0), min(stop, width)
        if stop <= start:
            return []
        area = f'<rect class="span {item.kind}" x="{svg.number(start)}" y="0" width="{svg.number(stop - start)}"'
        return [f'{area} height="{svg.number(height)}"/>']
    if isinstance(item, Rule):
        if item.axis == "y":
            y = float(sy(item.at))
            parts = [f'<path class="{item.kind}" d="M0,{svg.number(y)}h{svg.number(width)}"/>']
            return parts + ([svg.text(width - 4, y - 5, item.label, "note", "end")] if item.label else [])
        x = float(sx(item.at))
        parts = [f'<path class="{item.kind}" d="M{svg.number(x)},0v{svg.number(height)}"/>']
        return parts + ([svg.text(x + 4, 12, item.label, "note")] if item.label else [])
    if isinstance(item, Tags):
        return []  # they stand above
    if isinstance(item, Note):
        return [svg.text(float(sx(item.x)), float(sy(item.y)), item.text, item.kind, item.anchor)]
    if isinstance(item, Whiskers):
        along, across = (sx, sy) if item.lying else (sy, sx)
        at, low, high = across(item.at), along(item.low), along(item.high)
        good = np.isfinite(at) & np.isfinite(low) & np.isfinite(high)
        shape = "M{b},{a}H{c}m0,-4v8M{b},{a4}v8" if item.lying else "M{a},{b}V{c}m-3,0h6M{a3},{b}h6"
        d = "".join(
            shape.format(a=svg.number(a), a3=svg.number(a - 3), a4=svg.number(a - 4), b=svg.number(b), c=svg.number(c))
            for a, b, c in zip(at[good], low[good], high[good], strict=True)
        )
        return [f'<path class="whisker {item.kind}" d="{d}"/>'] if d else []
    x, y = sx(item.x), sy(item.y)
    good = np.flatnonzero((x >= -0.5) & (x <= width + 0.5) & (y >= -0.5) & (y <= height + 0.5))
    if item.shape == "point":  # one path for all, and those that fall together once
        places = dict.fromkeys(f"M{svg.number(a)},{svg.number(b)}h0" for a, b in zip(x[good], y[good], strict=True))
        path = f'<path class="marks point {item.kind}" stroke-width="{2 * item.size:g}" d="{"".join(places)}"/>'
        return [path] if places else []
    if item.shape == "word":
        return [svg.text(float(x[i]), float(y[i]) + 4, item.labels[i], f"note {item.kind}", "middle") for i in good]
    shapes = "".join(svg.mark(float(x[i]), float(y[i]), item.shape, item.size) for i in good)
    parts = [f'<g class="marks {item.shape} {item.kind}">{shapes}</g>'] if shapes else []
    for i in good[: len(item.labels)]:
        text, a = item.labels[i], float(x[i])
        anchor = "start" if a < 6 * len(text) / 2 else "end" if a > width - 6 * len(text) / 2 else "middle"
        parts.append(
            svg.text(a, float(y[i]) + (item.size + 14 if item.below else -item.size - 5), text, "note strong", anchor)
        )
    return parts


def _end_labels(lines: Sequence[Line], sx: _Scale, sy: _Scale, height: float, x: float, top: float) -> list[str]:
    """Labels beside the right ends of the lines, pushed apart where they would overlap."""
    placed = []
    for line in lines:
        good = np.flatnonzero(np.isfinite(line.x) & np.isfinite(sy(line.y)))
        if line.label and len(good):
            placed.append([float(np.clip(sy(line.y[good[-1]]), 6, height - 4)), line.label, line.kind])
    placed.sort(key=lambda entry: entry[0])
    for before, entry in pairwise(placed):
        entry[0] = max(entry[0], before[0] + 15)
    over = placed[-1][0] - (height - 2) if placed else 0.0
    for entry in reversed(placed):
        if over <= 0:
            break
        entry[0] -= over
    parts = []
    for y, label, kind in placed:  # each behind a piece of its line, so that they are told apart without colour too
        parts.append(f'<path class="line {kind}" d="M{svg.number(x)},{svg.number(top + y)}h{SAMPLE:g}"/>')
        parts.append(svg.text(x + SAMPLE + 4, top + y + 4, label, f"series {kind}"))
    return parts


def _tags(panel: Panel, sx: _Scale, frame: Frame, top: float) -> list[str]:
    """Tags in a row between the ordinate's label and the panel, each joined to its place."""
    parts = []
    for item in (i for i in panel.items if isinstance(i, Tags)):
        placed = sorted(
            (frame.left + float(sx(at)), 3.6 * len(label) + 2, label)
            for at, label in zip(item.at, item.labels, strict=True)
        )
        middles = [x for x, _, _ in placed]
        for i in range(1, len(placed)):
            middles[i] = max(middles[i], middles[i - 1] + placed[i - 1][1] + placed[i][1])
        limit = frame.width - (placed[-1][1] if placed else 0.0)
        for i in reversed(range(len(placed))):
            middles[i] = min(middles[i], limit)
            limit = middles[i] - placed[i][1] - (placed[i - 1][1] if i else 0.0)
        for (x, _, label), middle in zip(placed, middles, strict=True):
            parts.append(
                f'<path class="zero" d="M{svg.number(x)},{svg.number(top)}L{svg.number(middle)},{svg.number(top - 5)}"/>'
            )
            parts.append(svg.text(middle, top - 7, label, "tick strong", "middle"))
    return parts


def _brackets(panel: Panel, sx: _Scale, frame: Frame, top: float) -> list[str]:
    """The labels of spans above the panel, where they hide nothing, each over a bracket."""
    parts = []
    free = 2 + 6.5 * len(panel.label) + 8  # to the right of the panel's own label
    top -= TAG if any(isinstance(item, Tags) for item in panel.items) else 0.0  # tags stand between
    inner = frame.width - frame.left - frame.right
    for item in sorted((i for i in panel.items if isinstance(i, Span) and i.label), key=lambda span: span.start):
        start, stop = (frame.left + float(np.clip(sx(value), 0.0, inner)) for value in (item.start, item.stop))
        if stop - start < 1:
            continue
        d = f"M{svg.number(start)},{svg.number(top - 1)}v-4H{svg.number(stop)}v4"
        parts.append(f'<path class="axis" d="{d}"/>')
        middle, half = (start + stop) / 2, 3.3 * len(item.label)
        if middle - half > free and middle + half < frame.width:
            parts.append(svg.text(middle, top - 9, item.label, "note", "middle"))
            free = middle + half + 6
    return parts


def symmetric_ticks(reach: float) -> list[tuple[float, str]]:
    """Ticks at zero and at one round number to either side, within a range of plus and minus `reach`."""
    tick = nice_ticks(0.0, 0.9 * reach, 1)[-1] or 0.5 * reach
    values = [-tick, 0.0, tick]
    return list(zip(values, tick_labels(values), strict=True))


def chart(
    panels: Sequence[Panel],
    *,
    x_label: str,
    x_range: tuple[float, float],
    label: str,
    frame: Frame | None = None,
    x_ticks: Sequence[tuple[float, str]] | None = None,
    x_log: bool = False,
    hover: bool = False,
    by_point: bool = False,
) -> str:
    """The chart as an `<svg>` element.

    label : says what is drawn, for those who do not see it
    x_ticks : (value, text) of each tick; None: round numbers
    hover : readable point by point with the mouse and the arrow keys; the page's script needs where the panels lie
    by_point : the point nearest in both directions is read, its ordinate in the figure's second column, not the nearest in x
    """
    frame = frame or Frame()
    inner = frame.width - frame.left - frame.right
    sx = _Scale(x_range, (0.0, inner), x_log)
    if x_ticks is None:
        values = log_ticks(*x_range) if x_log else nice_ticks(*x_range, most=9 if frame.width > 600 else 4)
        x_ticks = list(zip(values, (log_tick_labels if x_log else tick_labels)(values), strict=True))
    columns = [(frame.left + float(sx(value)), text) for value, text in x_ticks]
    parts: list[str] = []
    top = 0.0
    heads = [frame.head + (TAG if any(isinstance(item, Tags) for item in panel.items) else 0.0) for panel in panels]
    for panel, head in zip(panels, heads, strict=True):
        top += head
        sy = _Scale(panel.y_range, (panel.height, 0.0), panel.log)
        if panel.ticks is not None:
            ticks = list(panel.ticks)
        else:
            values = (log_ticks if panel.log else nice_ticks)(*panel.y_range, panel.most_ticks)
            ticks = list(zip(values, (log_tick_labels if panel.log else tick_labels)(values), strict=True))
        rows = [(top + float(sy(value)), text) for value, text in ticks]
        grid = "".join(f"M{svg.number(frame.left)},{svg.number(y)}h{svg.number(inner)}" for y, _ in rows)
        grid += "".join(f"M{svg.number(x)},{svg.number(top)}v{svg.number(panel.height)}" for x, _ in columns)
        parts.append(f'<path class="grid" d="{grid}"/>')
        box = f'x="{svg.number(frame.left)}" y="{svg.number(top)}" width="{svg.number(inner)}" height="{svg.number(panel.height)}"'
        drawn = [(item, "".join(_draw(item, sx, sy, inner, panel.height))) for item in panel.items]
        cut_off = "".join(text for item, text in drawn if not isinstance(item, Marks))
        parts.append(f"<svg {box}>{cut_off}</svg>")
        parts.append(
            f'<path class="axis" d="M{svg.number(frame.left)},{svg.number(top + panel.height)}h{svg.number(inner)}"/>'
        )
        whole = "".join(text for item, text in drawn if isinstance(item, Marks))  # a mark on the rim is not cut in half
        if whole:
            parts.append(f'<g transform="translate({svg.number(frame.left)} {svg.number(top)})">{whole}</g>')
        parts += [svg.text(frame.left - 6, y + 4, text, "tick", "end") for y, text in rows]
        parts.append(svg.text(2, top + frame.head - head - 9, panel.label, "label"))
        parts += [
            svg.text(frame.left + inner + 6, top + float(sy(y)) + 4, text, "tick") for y, text in panel.right_ticks
        ]
        if panel.right_label:
            parts.append(svg.text(frame.width - 2, top + frame.head - head - 9, panel.right_label, "label", "end"))
        parts += _tags(panel, sx, frame, top)
        parts += _brackets(panel, sx, frame, top)
        lines = [item for item in panel.items if isinstance(item, Line)]
        parts += _end_labels(lines, sx, sy, panel.height, frame.left + inner + 6, top)
        top += panel.height
    parts += [svg.text(x, top + 16, text, "tick", "middle") for x, text in columns]
    parts.append(svg.text(frame.left + inner, top + frame.foot - 7, x_label, "label", "end"))
    size = f'viewBox="0 0 {svg.number(frame.width)} {svg.number(top + frame.foot)}"'
    reading = ""
    if hover:
        reading = (
            f' tabindex="0" data-x="{x_range[0]:.9g} {x_range[1]:.9g}"{" data-log" if x_log else ""}'
            f' data-box="{svg.number(frame.left)} {svg.number(heads[0])} {svg.number(inner)} {svg.number(top - heads[0])}"'
        )
        if by_point:
            low, high = panels[0].y_range
            reading += f' data-y="{low:.9g} {high:.9g}"'
    return (
        f'<svg class="chart {frame.css}" {size} role="img" aria-label="{escape(label)}"{reading}>{"".join(parts)}</svg>'
    )
