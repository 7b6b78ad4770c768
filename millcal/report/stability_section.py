"""The section of the stability map, and its numbers at the head of the page."""

from collections.abc import Sequence

from millcal.data import CoefficientHistory, Coefficients, ForceHarmonics, StabilityMap
from millcal.report import blocks, stability_figure, stability_tables
from millcal.report.digits import MINUS, fixed, rounded_down, significant
from millcal.report.stability_comparison import comparison
from millcal.report.stability_samples import bifurcation
from millcal.report.stability_wording import every_speed, map_verdict
from millcal.units import to_shop


def section(
    map_: StabilityMap | None,
    fit: Coefficients | CoefficientHistory | ForceHarmonics | None,
    compared: Sequence[StabilityMap] = (),
) -> dict | None:
    """The map and what follows from it.   fit : the coefficients behind it   compared : the same by several methods"""
    if map_ is None:
        return None
    doubt = map_verdict(fit)
    several = [one for one in compared if len(one.spindle_speed)]
    return blocks.section(
        "stability",
        "Stability",
        {"kind": "verdict", "verdict": doubt} if doubt else None,
        blocks.facts("", stability_tables.map_facts(map_)),
        blocks.figure(stability_figure.lobes(map_)),
        _advice(map_),
        blocks.table(stability_tables.best_speeds(map_)),
        blocks.table(stability_tables.limits(map_)),
        blocks.figure(bifurcation(map_)),
        blocks.figure(comparison(several) if len(several) > 1 else None),
        blocks.table(stability_tables.methods_compared(several)),
    )


def _advice(map_: StabilityMap) -> dict | None:
    """What to do about the operating point, best first."""
    if map_.operating is None:
        return None
    steps = [f"{text[:1].upper()}{text[1:]}".replace("(-", f"({MINUS}") for text in map_.operating.advice]
    return blocks.steps("What would help at the operating point", steps)


def key_numbers(map_: StabilityMap | None) -> list[dict]:
    """The smallest limit and the best speed."""
    numbers = []
    if map_ is None:
        return []
    if map_.absolute_minimum < float("inf"):
        value = significant(map_.absolute_minimum * 1e3)
        numbers.append(
            {"name": "Smallest limit", "value": value, "unit": "mm", "word": f"stable below it at {every_speed(map_)}"}
        )
    for best in map_.best[:1]:
        limit, safe = best.axial_depth * 1e3, best.safe_depth
        word = f"limit {significant(limit)} mm" if safe is None else f"safe to {rounded_down(safe * 1e3, 2)} mm"
        speed = fixed(to_shop(best.spindle_speed, "spindle_speed_rpm"), 0)
        numbers.append({"name": "Best speed", "value": speed, "unit": "rpm", "word": word})
    return numbers
