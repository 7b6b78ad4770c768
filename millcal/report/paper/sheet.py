"""A figure for print: its size, type, ink and bytes. The only file that imports matplotlib.

Widths are those of a journal's columns, the type is 8 pt and vector files carry their fonts. Figures are made without
pyplot, the user's matplotlibrc does not count, and nothing of the clock or of chance enters a file: the same records give
the same bytes. Ink has the colours of the page; what must be told apart differs in line style or marker too.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from millcal.report.digits import log_tick_labels, log_ticks, nice_ticks, tick_labels

SINGLE, DOUBLE = 85.0, 175.0  # mm, one and two columns of a journal
FORMATS = ("pdf", "png", "svg")
MM = 1 / 25.4  # inches
VECTOR = 72  # dots per inch in vector files
ROWS = 3  # of a legend, for which the height of a figure is meant

INK, MUTED, GRID = "#1a1f26", "#58616d", "#e9ecf0"
MAIN, MODEL = "#0b5cad", "#c2410c"
STABLE, USABLE, BAND, LEFT = "#dcebf8", "#eef2f6", "#a9c8e6", "#d3d7dc"

_STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so it is the same everywhere
    "font.size": 8.0,
    "mathtext.fontset": "dejavusans",
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlepad": 4.0,
    "axes.labelpad": 2.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "legend.columnspacing": 1.6,
    "legend.borderpad": 0.2,
    "lines.linewidth": 1.0,
    "lines.markersize": 4.0,
    "patch.linewidth": 0.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.minor.size": 1.8,
    "ytick.minor.size": 1.8,
    "axes.spines.top": True,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
    "figure.constrained_layout.wspace": 0.04,
    "pdf.fonttype": 42,  # TrueType, whole and searchable
    "svg.fonttype": "path",  # looks the same where the font is missing
    "svg.hashsalt": "millcal",
    "savefig.dpi": 600,  # what journals ask of line art
}
_METADATA = {
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
}


@contextmanager
def style() -> Iterator[None]:
    """Within the block figures are drawn and written in the style of this file, and in no other."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def sheet(
    width: float,
    height: float,
    rows: int = 1,
    columns: int = 1,
    *,
    heights: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
) -> tuple[Figure, np.ndarray]:
    """An empty figure, width and height in mm, with its panels.   returns the figure and its axes (row, column)"""
    figure = Figure(figsize=(width * MM, height * MM))
    return figure, figure.subplots(rows, columns, squeeze=False, height_ratios=heights, width_ratios=widths)


def stacked(
    width: float, height: float, groups: Sequence[tuple[Sequence[float], int]]
) -> tuple[Figure, list[np.ndarray]]:
    """An empty figure, in mm, of groups of panels one under the other, each with columns of its own.

    groups : the heights of its rows relative to those of all groups, and how many columns
    returns the figure and the axes of each group (row, column)
    """
    figure = Figure(figsize=(width * MM, height * MM))
    outer = figure.add_gridspec(len(groups), 1, height_ratios=[sum(heights) for heights, _ in groups])
    panels = []
    for place, (heights, columns) in enumerate(groups):
        inner = outer[place].subgridspec(len(heights), columns, height_ratios=list(heights))
        panels.append(inner.subplots(squeeze=False))
    return figure, panels


def file_bytes(figure: Figure, format: str) -> bytes:
    """The figure as a file of one of FORMATS.

    The panels are laid out once and their places rounded: the solver of the layout adds in an order that changes with
    the memory, and names within a file are made of all digits.
    """
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = (round(value, 6) for value in axes.get_position(original=True).bounds)
        axes.set_position((left, bottom, width, height))
    buffer = BytesIO()
    figure.savefig(buffer, format=format, metadata=_METADATA[format])
    return buffer.getvalue()


def scale(
    axes: Axes,
    which: str,
    limits: tuple[float, float],
    *,
    label: str = "",
    log: bool = False,
    most: int = 5,
    ticks: Sequence[float] | None = None,
) -> None:
    """Limits of an axis, ticks written as on the page, and what stands at it.

    which : "x" or "y"
    ticks : None: round numbers, in at most so many intervals
    """
    axis = {"x": axes.xaxis, "y": axes.yaxis}[which]
    axes.set(**{f"{which}scale": "log" if log else "linear"})
    if ticks is None:
        ticks = (log_ticks if log else nice_ticks)(*limits, most)
    axis.set_ticks(ticks, (log_tick_labels if log else tick_labels)(ticks))
    if log:
        powers = 10.0 ** np.arange(np.floor(np.log10(limits[0])), np.ceil(np.log10(limits[1])))
        between = np.ravel(np.outer(powers, np.arange(2, 10)))
        between = between[(between >= limits[0]) & (between <= limits[1])]
        axis.set_ticks(between, [""] * len(between), minor=True)
    axes.set(**{f"{which}lim": limits, f"{which}label": label})


def quiet(axes: Axes, which: str) -> None:
    """No numbers and no label at an axis that shares those of a neighbour."""
    axes.tick_params(axis=which, which="both", labelbottom=which != "x", labelleft=which != "y")
    axes.set(**{f"{which}label": ""})


def letters(panels: Sequence[Axes], titles: Sequence[str] = ()) -> None:
    """(a), (b) ... at the upper left of the panels, each with its title."""
    for number, panel in enumerate(panels):
        title = titles[number] if number < len(titles) else ""
        panel.set_title(f"({letter(number)}) {title}".rstrip(), loc="left")


def letter(number: int) -> str:
    """a to z, then aa, ab ...

    >>> letter(0), letter(25), letter(26)
    ('a', 'z', 'aa')
    """
    return (letter(number // 26 - 1) if number >= 26 else "") + chr(ord("a") + number % 26)


def legend(figure: Figure, entries: Sequence[tuple[Artist | tuple[Artist, ...], str]], columns: int) -> None:
    """What each line and mark is, above all panels, where it can cover nothing, in so many columns as the figure has room for.

    Rows beyond ROWS make the figure higher, so that the panels keep their size.

    columns : at most so many
    """
    handles, texts = zip(*entries, strict=True)
    for some in range(min(columns, len(entries)), 0, -1):
        made = figure.legend(handles, texts, loc="outside upper center", ncols=some)
        if some == 1 or _widest(figure, made) <= 1:
            break
        made.remove()
    rows = -(-len(entries) // some)
    if rows > ROWS:
        row = made.get_window_extent().height / figure.dpi / rows
        figure.set_figheight(figure.get_figheight() + (rows - ROWS) * row)


def _widest(figure: Figure, made: Legend) -> float:
    """Width of a legend over that of its figure, at the resolution where it is widest: letters are as wide as dots allow."""
    own, found = figure.dpi, []
    for dots in (VECTOR, own, matplotlib.rcParams["savefig.dpi"]):
        figure.set_dpi(dots)
        found.append(made.get_window_extent().width / figure.bbox.width)
    figure.set_dpi(own)
    return max(found)


def haloed(text: Text) -> None:
    """A word that can be read where a line passes behind it."""
    text.set_path_effects([withStroke(linewidth=1.6, foreground="white")])


def plain(text: str) -> str:
    """A text for a figure: signs of formulas in it mean themselves, but f_z, a_p and a_e have low indices.

    >>> plain("f_z 0.1 mm, 5 $")
    '$f_\\\\mathrm{z}$ 0.1 mm, 5 \\\\$'
    """
    return re.sub(r"\b([af])_([zpe])\b", r"$\1_\\mathrm{\2}$", text.replace("$", r"\$"))
