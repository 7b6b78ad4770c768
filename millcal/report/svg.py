"""The smallest pieces of a drawing as SVG: numbers, points of a line, words, marks."""

from html import escape

import numpy as np


def number(value: float) -> str:
    """A coordinate: a tenth of a unit is finer than any eye."""
    return f"{value:.1f}".removesuffix(".0")


def pairs(x: np.ndarray, y: np.ndarray) -> str:
    """The points of a line."""
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def runs(*values: np.ndarray) -> list[slice]:
    """Stretches in which all values are finite."""
    good = np.all([np.isfinite(v) for v in values], axis=0)
    steps = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    return [slice(a, b) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def text(x: float, y: float, words: str, kind: str, anchor: str = "start") -> str:
    """Words at a place."""
    return f'<text class="{kind}" x="{number(x)}" y="{number(y)}" text-anchor="{anchor}">{escape(words)}</text>'


def mark(x: float, y: float, shape: str, size: float) -> str:
    """A mark of one of the shapes: dot, ring, square, diamond, triangle, cross, tripod, dash."""
    a, b, s = number(x), number(y), size
    if shape in ("dot", "ring"):
        return f'<circle cx="{a}" cy="{b}" r="{s:g}"/>'
    if shape == "square":
        return f'<rect x="{number(x - s)}" y="{number(y - s)}" width="{2 * s:g}" height="{2 * s:g}"/>'
    if shape == "diamond":
        r = 1.35 * s
        return f'<path d="M{a},{number(y - r)}l{r:g},{r:g}l-{r:g},{r:g}l-{r:g},-{r:g}z"/>'
    if shape == "triangle":
        r = 1.2 * s
        return f'<path d="M{a},{number(y - r)}l{r:g},{2 * r:g}h-{2 * r:g}z"/>'
    if shape == "cross":
        return f'<path d="M{number(x - s)},{number(y - s)}l{2 * s:g},{2 * s:g}m0,-{2 * s:g}l-{2 * s:g},{2 * s:g}"/>'
    if shape == "tripod":
        return f'<path d="M{a},{number(y + s)}V{b}l-{s:g},-{s / 2:g}m{s:g},{s / 2:g}l{s:g},-{s / 2:g}"/>'
    return f'<path d="M{number(x - s)},{b}h{2 * s:g}"/>'  # dash
