"""The section of the stability map, and its numbers at the head of the page."""

from collections.abc import Sequence

from millcal.data import CoefficientHistory, Coefficients, ForceHarmonics, StabilityMap
from millcal.report import blocks, stability_figure, stability_tables
from millcal.report.digits import MINUS, fixed, rounded_down, significant
from millcal.report.stability_comparison import comparison
from millcal.report.stability_samples import bifurcation
from millcal.report.stability_wording import every_speed, map_verdict, theory_verdict, too_deep, unsafe
from millcal.units import to_shop


def section(
    map_: StabilityMap | None,
    fit: Coefficients | CoefficientHistory | ForceHarmonics | None,
    compared: Sequence[StabilityMap] = (),
) -> dict | None:
    """The map and what follows from it.   fit : the coefficients behind it   compared : the same by several methods"""
    if map_ is None:
        return None
    doubts = [doubt for doubt in (map_verdict(fit), theory_verdict(map_)) if doubt is not None]
    several = [one for one in compared if len(one.spindle_speed)]
    return blocks.section(
        "stability",
        "Stability",
        *({"kind": "verdict", "verdict": doubt} for doubt in doubts),
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
    """The smallest limit and the best speed, marked as doubtful where the method or the cutter does not reach so far."""
    numbers: list[dict] = []
    if map_ is None:
        return numbers
    alone = ["zero-order limit: no period doubling in it"] if unsafe(map_) else []

    def add(name: str, value: str, unit: str, words: Sequence[str], *, doubtful: bool) -> None:
        entry = {"name": name, "value": value, "unit": unit, "word": "; ".join(words)}
        numbers.append(entry | ({"level": "part"} if doubtful else {}))

    if map_.absolute_minimum < float("inf"):
        value = significant(map_.absolute_minimum * 1e3)
        add("Smallest limit", value, "mm", [f"stable below it at {every_speed(map_)}", *alone], doubtful=bool(alone))
    for best in map_.best[:1]:
        limit, safe = best.axial_depth * 1e3, best.safe_depth
        word = f"limit {significant(limit)} mm" if safe is None else f"safe to {rounded_down(safe * 1e3, 2)} mm"
        deep = too_deep(map_, best.axial_depth if safe is None else safe)
        words = [word, *(["longer than a cutter's edges"] if deep else []), *alone]
        speed = fixed(to_shop(best.spindle_speed, "spindle_speed_rpm"), 0)
        add("Best speed", speed, "rpm", words, doubtful=deep or bool(alone))
    return numbers
