"""The sections of a force that accelerations tell, and its numbers at the head of the page."""

from math import degrees, isfinite

from millcal.data import ForceHarmonics
from millcal.report import blocks, speed_advice_figure
from millcal.report import force_harmonics_figures as figures
from millcal.report import force_harmonics_tables as tables
from millcal.report.digits import fixed, nominal, plus_minus, significant
from millcal.report.wording import QUESTIONS, fit_level, law_in_words

PLACES = {
    "reconstruction",
    "force-harmonics",
    "law-distance",
    "accelerations",
    "methods",
    "law",
}  # ids of these sections and figures


def sections(forces: ForceHarmonics | None) -> list[dict | None]:
    """The force and the accelerations behind it; nothing without a force."""
    if forces is None:
        return []
    return [_reconstruction(forces), _accelerations(forces)]


def _reconstruction(forces: ForceHarmonics) -> dict | None:
    drawn = figures.courses(forces)
    caption = f"Force on the tool. {bandwidth(forces)}; an axis has one scale in all cuts."
    if len(drawn) < len(forces.cuts):
        caption += f" {len(drawn)} of {len(forces.cuts)} cuts are drawn."
    if forces.law_force is None:
        caption += " The record holds no force by the law."
    if forces.dynamometer is None:
        caption += " No dynamometer was there to compare."
    hidden = {asked.place for asked in QUESTIONS.values()} - PLACES - {"coefficients"}
    distance = figures.law_distance(forces)
    hidden |= set() if distance else {"law-distance"}
    failed = [check for check in forces.checks if not check.passed]
    return blocks.section(
        "reconstruction",
        "Force from accelerations",
        blocks.facts("", facts(forces)),
        blocks.reasons(failed, fit_level(forces), hidden),
        blocks.figures(drawn, "Force over one revolution", caption, "stack", figures.courses_key(forces)),
        blocks.figure(figures.harmonics(forces)),
        blocks.figure(distance),
        blocks.table(tables.harmonics(forces)),
    )


def bandwidth(forces: ForceHarmonics) -> str:
    """Which lines stand behind the force, as a sentence begins."""
    low, high = (fixed(end, 0) for end in forces.band)
    between = f"at {low} Hz" if low == high else f"from {low} to {high} Hz"
    return (
        f"{_harmonics(len(forces.cut))} {between}: what is slower or faster, and the mean, no accelerometer tells here"
    )


def _harmonics(n: int) -> str:
    return "1 harmonic" if n == 1 else f"{n} harmonics"


def facts(forces: ForceHarmonics) -> list[tuple[str, str]]:
    """How the force was found."""
    low, high = (nominal(round(end, 1)) for end in forces.band)
    between = f"{low} Hz" if low == high else f"{low} to {high} Hz"
    n, lines = len(forces.cuts), _harmonics(len(forces.cut))
    known = [
        ("method", tables.METHODS.get(forces.method, forces.method)),
        ("bandwidth", f"{between}, {lines} of {n} cut{'s' if n > 1 else ''}"),
        ("FRF", {"measured": "as measured", "modes": "of the fitted modes"}[forces.frf_from]),
        ("condition number", significant(forces.condition_number)),
    ]
    if forces.regularization is not None:
        by = tables.FITTED_WITH.get(forces.regularization_from, forces.regularization_from)
        chosen = f", by {by}" if by and by != "given" else by and ", given"
        known.append(("regularisation", f"{significant(forces.regularization)} (m/s²)/N{chosen}"))
    if isfinite(forces.chi2):
        known.append(("χ² per degree of freedom", f"{fixed(forces.chi2, 2)}, {forces.dof} degrees of freedom"))
    else:
        known.append(("χ²", "not known" if forces.dof else "not known: nothing is left over to test the force"))
    if n == 1:
        angle, sd = degrees(float(forces.phase[0])), degrees(float(forces.phase_sd[0]))
        turned = (
            plus_minus(angle, angle - figures.NORMAL * sd, angle + figures.NORMAL * sd) if sd > 0 else fixed(angle, 1)
        )
        known.append(("tooth 0 where the cut was counted from", f"{turned}°, {forces.phase_from}"))
    return known


def _accelerations(forces: ForceHarmonics) -> dict | None:
    drawn = figures.accelerations(forces)
    unknown = not figures.there(forces.deviation)
    caption = "Every harmonic as measured and as the FRF makes it of the force."
    if not unknown:
        caption += " A dot below its stroke is noise. Under each, the difference of the complex harmonics beside the expected one."
    if len(drawn) < len(forces.sensors):
        caption += f" The {len(drawn)} sensors that fit worst of {len(forces.sensors)}."
    return blocks.section(
        "accelerations",
        "Do the accelerations fit?",
        blocks.text("The record does not say what difference is to be expected.") if unknown else None,
        blocks.table(tables.residuals(forces)),
        blocks.table(tables.residuals_by_cut(forces)),
        blocks.table(tables.sensors(forces)),
        blocks.figures(drawn, "Measured against FRF times force", caption, "thirds", figures.accelerations_key(forces)),
    )


def coefficients(forces: ForceHarmonics | None, *, elsewhere: bool) -> list[dict | None]:
    """The coefficients behind the force, unless they stand elsewhere; the methods; what the law demands."""
    if forces is None:
        return []
    told = f"{law_in_words(forces.posterior.law)}, {tables.METHODS.get(forces.method, forces.method)}."
    own = blocks.section(
        "coefficients",
        "Cutting coefficients",
        blocks.text(told),
        blocks.table(tables.coefficients(forces)),
        blocks.checks("Checks of the fit", forces.checks),
    )
    more = blocks.section(
        "law",
        "Methods, and what the law demands",
        blocks.figure(figures.methods(forces)),
        blocks.table(tables.compared(forces)),
        blocks.table(tables.law(forces, tables.untold_in_words(forces) if elsewhere else "")),
    )
    return [None if elsewhere else own, more]


def advice(forces: ForceHarmonics | None) -> dict | None:
    """At which speed to cut next, where that was asked."""
    if forces is None or forces.advice is None:
        return None
    return blocks.section(
        "next-cut",
        "The next cut with accelerometers",
        blocks.figure(speed_advice_figure.expected_spread(forces.advice, forces.conditions)),
        blocks.table(tables.best_speeds(forces.advice)),
    )
