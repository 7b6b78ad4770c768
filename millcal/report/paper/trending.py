"""Figures of the study of trending coefficients: what Figures 2 and 3 of Schwenzer et al. (2020) show, and more methods.

Nothing here knows the study: who calls names the cases and the methods, and brings what is drawn.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from millcal.report.charts import span_of
from millcal.report.digits import fixed
from millcal.report.paper import sheet

TUBE = 2.0  # standard deviations to either side
MARKS = 160  # active samples from one mark on a line to the next


class Course(NamedTuple):
    """What a method finds at the active samples: mean over its starts, and their standard deviation."""

    mean: np.ndarray  # (active,)
    deviation: np.ndarray  # (active,)
    own: bool = False  # the deviation is what the method itself says, for it has no starts

    @property
    def tube(self) -> tuple[np.ndarray, np.ndarray]:
        return self.mean - TUBE * self.deviation, self.mean + TUBE * self.deviation


class Look(NamedTuple):
    """How a method is drawn; marks tell it apart where colours do not."""

    line: str
    tube: str
    marker: str


LOOKS = (  # after Okabe & Ito, darkened until thin lines stand out from white
    Look("#b07d00", "#f0dcae", ""),
    Look("#0b5cad", "#b9d3ec", "o"),
    Look("#c2410c", "#f3c3ad", "s"),
    Look("#00755c", "#afdccd", "^"),
    Look("#7b2f8f", "#dfc3e6", "D"),
)
_DOTS: dict[str, Any] = {"color": sheet.LEFT, "linewidth": 0.5, "linestyle": (0, (1, 1.5))}
Courses = Mapping[str, Mapping[str, Course]]  # by method and case


def looks_of(methods: Sequence[str]) -> dict[str, Look]:
    """One for each method, in their order."""
    return dict(zip(methods, LOOKS, strict=False))


def errors(courses: Courses, rms: Mapping[str, Mapping[str, float]], inflated: Mapping[str, int]) -> Any:
    """Error of the tangential force over the active samples, a row for each case and a column for each method.

    courses : N   rms : by method and case, N   inflated : by method, samples from one inflation to the next
    """
    methods = list(courses)
    cases = list(courses[methods[0]])
    looks = looks_of(methods)
    figure, panels = sheet.sheet(sheet.DOUBLE, 36.0 * len(cases) + 17, len(cases), len(methods))
    corner = panels[0, 0]  # lines of no colour of their own, for the legend of all
    entries = [(corner.plot([], [], color=sheet.MUTED)[0], "mean error, and the rms of all starts")]
    if any(np.any(course.deviation > 0) for by_case in courses.values() for course in by_case.values()):
        own = [method for method in methods if courses[method][cases[0]].own]
        told = "± 2 sd of the starts" + "".join(f"; {method}: of its own" for method in own)
        entries.append((corner.fill_between([], [], [], color=sheet.LEFT), told))
    if inflated:
        entries.append((corner.plot([], [], **_DOTS)[0], "inflations"))
    for row, case in enumerate(cases):
        reach = max(_reach(courses[method][case]) for method in methods)
        for column, method in enumerate(methods):
            panel, course, look = panels[row, column], courses[method][case], looks[method]
            step = np.arange(1, len(course.mean) + 1)
            _inflations(panel, inflated.get(method), len(step))
            if np.any(course.deviation > 0):
                panel.fill_between(step, *course.tube, color=look.tube)
            panel.plot(step, course.mean, color=look.line, linewidth=0.45)
            panel.set_title(f"{fixed(rms[method][case], 1)} N", loc="right", fontsize=7, color=sheet.MUTED)
            _samples(panel, len(step), shown=row + 1 == len(cases))
            sheet.scale(panel, "y", (-reach, reach), label=f"{case}\n$\\Delta F_\\mathrm{{t}}$ (N)", most=4)
            if column:
                sheet.quiet(panel, "y")
    figure.align_ylabels()
    titles = [method if row == 0 else "" for row in range(len(cases)) for method in methods]
    sheet.letters(list(panels.flat), titles)
    sheet.legend(figure, entries, columns=len(entries))
    return figure


def coefficients(
    specific: Courses,
    rise: Courses,
    truth: Mapping[str, tuple[np.ndarray, np.ndarray]],
    groups: Mapping[str, Sequence[str]],
) -> Any:
    """k_t and m_t over the active samples with their truth: a column for each case, two rows for each group of methods.

    specific : k_t, N/mm^2   rise : m_t   truth : of both by case, (active,)
    groups : methods that share panels, by what they are
    """
    methods = list(specific)
    cases = list(specific[methods[0]])
    looks = looks_of(methods)
    kinds = ((specific, "$k_\\mathrm{t}$ (N/mm²)"), (rise, "$m_\\mathrm{t}$ (1)"))
    figure, panels = sheet.sheet(sheet.DOUBLE, 36.0 * 2 * len(groups) + 19, 2 * len(groups), len(cases))
    entries: dict[str, Any] = {}
    for row, (group, (kind, (courses, label))) in enumerate(product(groups.values(), enumerate(kinds))):
        true = [truth[case][kind] for case in cases]
        limits = _limits([courses[method][case] for method in group for case in cases], true)
        for column, case in enumerate(cases):
            panel = panels[row, column]
            step = np.arange(1, len(true[column]) + 1)
            for place, method in enumerate(group):
                course, look = courses[method][case], looks[method]
                tube = panel.fill_between(step, *course.tube, color=look.tube, alpha=0.55)
                first = MARKS // 2 + place * MARKS // len(group)
                (line,) = panel.plot(
                    step, course.mean, color=look.line, linewidth=0.7, zorder=3,
                    marker=look.marker, markersize=3, markevery=(first, MARKS), markeredgewidth=0,
                )  # fmt: skip
                entries[f"{method} ± 2 sd of its own" if course.own else method] = (tube, line)
            (entries["truth"],) = panel.plot(
                step, true[column], color=sheet.INK, linewidth=1.0, linestyle="--", zorder=4
            )
            _samples(panel, len(step), shown=row + 1 == len(panels))
            sheet.scale(panel, "y", limits, label=label, most=5)
            if column:
                sheet.quiet(panel, "y")
    figure.align_ylabels()
    titles = [f"{case}, {group}" if first else "" for group in groups for first in (True, False) for case in cases]
    sheet.letters(list(panels.flat), titles)
    entries["truth"] = entries.pop("truth")  # last
    sheet.legend(figure, [(handle, name) for name, handle in entries.items()], columns=len(entries))
    return figure


def _samples(panel: Any, count: int, *, shown: bool) -> None:
    """The abscissa: samples at which filters are active, with numbers only at the foot of the sheet."""
    sheet.scale(panel, "x", (0, count), label="active sample (1)", most=4)
    if not shown:
        sheet.quiet(panel, "x")


def _inflations(panel: Any, every: int | None, count: int) -> None:
    """Faint dotted lines where ensembles are inflated."""
    for step in range(every or count + 1, count + 1, every or 1):
        panel.axvline(step, **_DOTS, zorder=0.5)


def _reach(course: Course) -> float:
    """Half a scale that holds nearly all of a tube, but not every spike of the first samples."""
    return 1.15 * float(np.quantile(np.abs(course.mean) + TUBE * course.deviation, 0.97))


def _limits(courses: Sequence[Course], truth: Sequence[np.ndarray]) -> tuple[float, float]:
    """A scale for the truth and nearly all of the tubes."""
    low = np.concatenate([course.tube[0] for course in courses])
    high = np.concatenate([course.tube[1] for course in courses])
    ends = np.array([np.quantile(low, 0.01), np.quantile(high, 0.99)])
    return span_of(ends, *truth, margin=0.05)
