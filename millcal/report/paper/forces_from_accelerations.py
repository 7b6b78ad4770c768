"""Figures of the study of forces from accelerations: what Figures 6 to 9 of Pawelko et al. (2012) show, and more methods.

Nothing here knows the study: who calls names the methods and brings what is drawn.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from millcal.report.paper import sheet

SMALLEST = 1e-6  # per cent
Courses = Mapping[str, Sequence[float] | np.ndarray]  # by method: errors along the abscissa, per cent


class Look(NamedTuple):
    """How a method is drawn; marks and lines tell it apart where colours do not."""

    color: str
    marker: str
    line: str = "-"
    size: float = 3.2  # pt, of the marker


LOOKS = (  # after Okabe & Ito, darkened until thin lines stand out from white
    Look("#58616d", "o"),
    Look("#58616d", "x", ":"),
    Look("#b07d00", "s", "--"),
    Look("#b07d00", "+", ":", 7.0),  # two ways to choose one weight: seldom apart, so this reaches beyond the other
    Look("#c2410c", "^"),
    Look("#7b2f8f", "v", "--"),
    Look("#0b5cad", "D"),
    Look("#00755c", "p"),
    Look("#00755c", "*", "--"),
)


def errors(
    abscissa: Sequence[float] | np.ndarray,
    panels: Mapping[str, Courses],
    label: str,
    *,
    limit: float,
    log: bool = False,
    looks: Mapping[str, Look] | None = None,
) -> Any:
    """Root mean square errors of some methods, a panel for each coefficient, with logarithmic ordinates.

    abscissa : (point,), ascending   panels : by title   label : of the abscissa   limit : per cent, drawn as a line
    log : whether the abscissa is logarithmic, too   looks : by method; None: in the order of LOOKS
    Errors that are nothing but rounding have no place on the scale and are left out.
    """
    x = np.asarray(abscissa, float)
    curves = {
        title: {method: np.asarray(course, float) for method, course in courses.items()}
        for title, courses in panels.items()
    }
    methods = list(next(iter(curves.values())))
    looks = looks_of(methods) if looks is None else looks
    figure, axes = sheet.sheet(sheet.DOUBLE, 82.0, 1, len(curves))
    drawn = np.concatenate([course for courses in curves.values() for course in courses.values()])
    drawn = drawn[drawn > SMALLEST]
    low = _below(float(drawn.min()))
    high = _above(max(float(drawn.max()), limit))
    entries: dict[str, Any] = {}
    for panel, courses in zip(axes[0], curves.values(), strict=True):
        entries["limit of the paper's claim"] = panel.axhline(limit, color=sheet.LEFT, linewidth=0.8, zorder=1)
        for method, course in courses.items():
            look = looks[method]
            seen = np.where(course > SMALLEST, course, np.nan)
            (entries[method],) = panel.plot(
                x, seen, color=look.color, linestyle=look.line, linewidth=0.9,
                marker=look.marker, markersize=look.size, markeredgewidth=0.7, zorder=3,
            )  # fmt: skip
        margin = 0.04 * np.ptp(x)
        span = (x[0] / 1.1, x[-1] * 1.1) if log else (float(x[0] - margin), float(x[-1] + margin))
        sheet.scale(panel, "x", span, label=label, log=log, most=5)
        sheet.scale(panel, "y", (low, high), label="root mean square error (%)", log=True)
        if panel is not axes[0, 0]:
            sheet.quiet(panel, "y")
    sheet.letters(list(axes[0]), list(curves))
    entries["limit of the paper's claim"] = entries.pop("limit of the paper's claim")  # last
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=5)
    return figure


def looks_of(methods: Sequence[str]) -> dict[str, Look]:
    """One for each method, in their order."""
    return dict(zip(methods, LOOKS, strict=False))


def _below(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value))


def _above(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(value))
    return float(min(step * power for step in (1, 2, 5, 10) if step * power >= value))
