"""The sections of coefficients that change while cutting, and their numbers at the head of the page."""

from math import isfinite

from millcal.data import CoefficientHistory
from millcal.report import blocks, history_figures, history_tables
from millcal.report.digits import nominal, plus_minus, significant
from millcal.report.wording import QUESTIONS, SIDES, fit_level, law_in_words, parameter, time_unit

METHODS = {
    "smooth": "smoothed: every instant knows the whole record (smooth)",
    "imm": "followed by several trend models at once (imm)",
    "rls": "followed by recursive least squares (rls)",
    "enkf": "followed by an ensemble Kalman filter (enkf)",
    "enkf-inflated": "followed by an ensemble Kalman filter with inflation (enkf-inflated)",
}


def sections(history: CoefficientHistory | None) -> list[dict | None]:
    """The coefficients over time, then the force and what was not foreseen; nothing without a history."""
    if history is None:
        return []
    duration = float(history.time[-1] - history.time[0])
    unit, word = time_unit(duration)
    cuts = f"{len(history.cuts)} cut{'s' if len(history.cuts) > 1 else ''}"
    method = METHODS.get(history.method, history.method)
    told = f"{law_in_words(history.law)}, {method}; {cuts}, {significant(duration / unit)} {word}."
    innovations = history_figures.innovations(history)
    present = {"specific-force", "coefficient-history", "coefficients", "force"}
    present |= {"innovations"} if innovations is not None else set()
    hidden = {asked.place for asked in QUESTIONS.values()} - present
    course = blocks.section(
        "coefficients",
        "Cutting coefficients while cutting",
        blocks.text(told),
        blocks.text(f"Chosen among the trends: {history.model}.") if history.model else None,
        blocks.figure(history_figures.specific_force(history)),
        blocks.table(history_tables.change(history)),
        blocks.table(history_tables.jumps(history)),
        blocks.figure(history_figures.coefficients(history)),
        blocks.table(history_tables.at_the_end(history)),
        blocks.table(history_tables.told_apart(history)),
    )
    windows = history_figures.windows(history)
    caption = "Force on the tool in short windows of the record; an axis has one scale in all of them."
    force = blocks.section(
        "force",
        "Measured against modelled force",
        blocks.reasons([check for check in history.checks if not check.passed], fit_level(history), hidden),
        blocks.figures(windows, "Force in the cut", caption, "stack", history_figures.windows_key(history)),
        blocks.figure(innovations),
        blocks.table(history_tables.agreement(history)),
        blocks.checks("Checks of the fit", history.checks),
    )
    return [course, force]


def key_numbers(history: CoefficientHistory) -> list[dict]:
    """Coefficients as the record leaves them, and how fast the force changed."""
    numbers = []
    posterior = history.posterior
    for name, mean, (low, high) in zip(posterior.names, posterior.mean, posterior.interval, strict=True):
        if name not in history.names:
            continue
        known = parameter(name)
        value = plus_minus(*(float(v) / known.factor for v in (mean, low, high)))
        numbers.append({"name": f"{name} at the end", "value": value, "unit": known.unit.strip("1"), "word": ""})
    factor, unit = history_tables.rate_unit(history)
    chip = nominal(round(history.reference_chip * 1e6, 1))
    for i, direction in enumerate(history.directions):
        if not isfinite(history.slope_per_minute[i]):
            continue
        slope = (float(v[i]) * factor for v in (history.slope_per_minute, history.slope_low, history.slope_high))
        name, word = f"{SIDES[direction].capitalize()} change", f"of the force on a chip of {chip} µm"
        numbers.append({"name": name, "value": plus_minus(*slope), "unit": unit, "word": word})
    if history.jumps:
        length, word = time_unit(float(history.time[-1] - history.time[0]))
        at = ", ".join(significant(jump.time / length) for jump in history.jumps[:3])
        more = f" and {len(history.jumps) - 3} more" if len(history.jumps) > 3 else ""
        numbers.append({"name": "Jumps", "value": str(len(history.jumps)), "unit": "", "word": f"at {at} {word}{more}"})
    return numbers
