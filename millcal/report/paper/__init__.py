"""Figures for print, as files: what a paper wants of a result, drawn from the records alone.

Any record may be missing; then the figures it would give are missing too. `sheet` says how a figure looks and becomes a
file, the other modules what is drawn.
"""

import re
from collections.abc import Mapping
from typing import Any

from millcal.data import CoefficientHistory
from millcal.report.axes import mean_is_known
from millcal.report.paper import coefficients, force_harmonics, forces, frf, history, modes, sheet, stability

NAMES = re.compile(
    r"stability-map|stability-methods|bifurcation|frf(-\d+)?|modal-fit(-\d+)?|modal-chart|force-revolution(-\d+)?|mean-force|coefficients|history|"
    r"force-harmonics|force-methods|speed-advice"
)  # of all there can be


def figures_of(results: Mapping[str, Any]) -> dict[str, Any]:
    """Every figure that the records give, by name; to be called and used within `sheet.style()`.

    results : as for the page, any of "cuts", "frf", "modes", "forces", "coefficients", "stability", "stability_compared"
    """
    cuts, fit = tuple(results.get("cuts") or ()), results.get("coefficients")
    figures: dict[str, Any] = {}
    if results.get("stability") is not None:
        figures["stability-map"] = stability.stability_map(results["stability"])
        sampled = stability.bifurcation(results["stability"])
        figures |= {"bifurcation": sampled} if sampled is not None else {}
    if len(compared := tuple(results.get("stability_compared") or ())) > 1:
        figures["stability-methods"] = stability.comparison(compared)
    if results.get("frf") is not None:
        figures |= frf.driving_points(results["frf"], results.get("modes"))
    if results.get("modes") is not None:
        figures |= modes.modal_figures(results["modes"])
    heard = results.get("forces")
    if heard is not None:
        figures |= force_harmonics.figures(heard)
    if isinstance(fit, CoefficientHistory):
        figures["history"] = history.history_sheet(fit)
    elif fit is not None:
        if heard is None or mean_is_known(fit):  # else the force is drawn with all that accelerations tell
            figures |= forces.revolutions(fit, cuts)
        if mean_is_known(fit):
            figures["mean-force"] = forces.mean_force(fit, cuts)
        figures |= coefficients.intervals(fit)
    return figures


def figure_files(results: Mapping[str, Any], format: str = "pdf") -> dict[str, bytes]:
    """The files of these figures, by file name; the same records give the same bytes.   format : one of `sheet.FORMATS`"""
    with sheet.style():
        return {f"{name}.{format}": sheet.file_bytes(figure, format) for name, figure in figures_of(results).items()}
