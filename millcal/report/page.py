"""The report of a result folder: one self-contained HTML page from the records, the summary and the provenance.

Everything drawn comes from the records; this room scales, thins and words it, and computes nothing that a stage did not
save. Any record may be missing: its sections are then left out. The page loads nothing from anywhere.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from millcal.data import (
    CoefficientHistory,
    Coefficients,
    CutForce,
    CutVibration,
    ForceHarmonics,
    Frf,
    Judgement,
    Modes,
    StabilityMap,
)
from millcal.report import (
    blocks,
    figures,
    force_figures,
    force_harmonics_section,
    force_harmonics_tables,
    history_section,
    judge_section,
    modal_figures,
    modal_tables,
    notices,
    stability_section,
    tables,
    vibration_quality,
)
from millcal.report.axes import mean_is_known
from millcal.report.digits import nominal, plus_minus, significant
from millcal.report.driving_points import driving_pairs
from millcal.report.stability_wording import operating_verdict
from millcal.report.wording import (
    HISTORY_PLACES,
    Verdict,
    cutter_in_words,
    fit_level,
    fit_verdict,
    law_in_words,
    parameter,
    question,
    spelt,
)


def _with_indices(text: str) -> Markup:
    """Escaped text with the indices of symbols set low: f_z, a_p, a_e, f_n."""
    return Markup(re.sub(r"\b([af])_([zpen])\b", r"<var>\1<sub>\2</sub></var>", str(escape(text))))


_TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent / "template"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["indices"] = _with_indices
_TEMPLATES.filters["spelt"] = spelt
_TEMPLATES.filters["question"] = question


Cut = CutForce | CutVibration
Fit = (
    Coefficients | CoefficientHistory | ForceHarmonics
)  # what all hold: posterior, cutter, conditions, cuts, verdict, checks


def render(results: Mapping[str, Any], summary: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """The report as HTML text; the same input gives the same bytes.

    results : any of "cuts" (sequence of CutForce), "vibrations" (sequence of CutVibration), "frf" (Frf), "sensor" (Frf),
        "modes" (Modes), "forces" (ForceHarmonics), "coefficients" (Coefficients or CoefficientHistory), "stability"
        (StabilityMap), "stability_compared" (sequence of StabilityMap, the same cut by several methods); "judgements" (sequence of
        Judgement); a missing or None entry leaves its sections out
    summary : what `summary.json` holds; read are `title`, `warnings` and `notes` [{code, message, where}],
        `expect` [{key, value, interval, ok}] and `recordings` [{name, path, kind, sample_rate_hz, duration_s,
        channels: [{name, quantity, unit, dof}]}], each optional
    provenance : as `io.provenance` makes it: versions, `inputs` {path: sha256}, `seed`, `recipe` (its text), each optional
    """
    conditioned: Sequence[Cut] = (*(results.get("cuts") or ()), *(results.get("vibrations") or ()))
    cuts = [cut for cut in conditioned if isinstance(cut, CutForce)]
    heard = [cut for cut in conditioned if isinstance(cut, CutVibration)]
    frf: Frf | None = results.get("frf")
    sensor: Frf | None = results.get("sensor")
    modes: Modes | None = results.get("modes")
    forces: ForceHarmonics | None = results.get("forces")
    found: Coefficients | CoefficientHistory | None = results.get("coefficients")
    judged: Fit | None = found if found is not None else forces
    fit = found if isinstance(found, Coefficients) else None
    history = found if isinstance(found, CoefficientHistory) else None
    map_: StabilityMap | None = results.get("stability")
    judgements: Sequence[Judgement] = tuple(results.get("judgements") or ())
    records = (*conditioned, frf, sensor, modes, forces, found, map_, *judgements)
    sections = [
        _measured(conditioned, judged, summary, provenance),
        _quality(cuts, heard, frf),
        _dynamics(frf),
        _modal(modes),
        _dynamometer(sensor),
        *force_harmonics_section.sections(forces),
        _force(fit, cuts, forces),
        _coefficients(fit, compared=forces is not None),
        *history_section.sections(history),
        *force_harmonics_section.coefficients(forces, elsewhere=found is not None),
        stability_section.section(map_, judged, results.get("stability_compared") or ()),
        force_harmonics_section.advice(forces),
        *judge_section.sections(judgements),
    ]
    return _TEMPLATES.get_template("page.html.j2").render(
        title=summary.get("title") or "Calibration report",
        subtitle=_subtitle(conditioned, judged, frf, modes),
        verdicts=[*_verdicts(judged, map_, summary), *judge_section.verdicts(judgements)],
        key_numbers=_key_numbers(judged, map_, frf, modes),
        expected=tables.expected(summary),
        sections=[section for section in sections if section],
        warnings=notices.grouped(summary, records, "warning"),
        notes=notices.grouped(summary, records, "note"),
        provenance=_provenance(provenance),
        inputs=sorted((provenance.get("inputs") or {}).items()),
        recipe=provenance.get("recipe") or "",
    )


def _measured(
    cuts: Sequence[Cut], fit: Fit | None, summary: Mapping[str, Any], provenance: Mapping[str, Any]
) -> dict | None:
    cutter = fit.cutter if fit is not None else cuts[0].cutter if cuts else None
    return blocks.section(
        "measured",
        "What was measured, and with what",
        blocks.facts("Cutter", cutter_in_words(cutter)) if cutter else None,
        blocks.table(tables.conditions(cuts, fit)),
        blocks.table(tables.recordings(summary, provenance)),
    )


def _quality(cuts: Sequence[CutForce], heard: Sequence[CutVibration], frf: Frf | None) -> dict | None:
    shown = [cuts[number] for number in force_figures.cuts_shown(len(cuts))] if cuts else []
    caption = (
        "Lowest and highest force of every short stretch. Shaded: the steady part, which was used, and the air cuts."
    )
    if len(shown) < len(cuts):
        caption += f" {len(shown)} of {len(cuts)} cuts are drawn."
    return blocks.section(
        "quality",
        "How good the recordings are",
        blocks.table(tables.synchronous(cuts)) if cuts else None,
        blocks.table(tables.peaks(cuts)),
        blocks.table(tables.removed(cuts)) if cuts else None,
        blocks.figures(
            figures.overview(shown),
            "The whole records",
            caption,
            "halves",
            (("span steady", "steady cut"), ("span air", "air cut"), ("span signal", "envelope of the force")),
        ),
        *vibration_quality.quality(heard),
        blocks.table(tables.hits(frf)) if frf is not None else None,
    )


def _dynamics(frf: Frf | None) -> dict | None:
    return blocks.section("frf", "Frequency response", *_curves(frf)) if frf is not None else None


def _modal(modes: Modes | None) -> dict | None:
    """The modes: given by hand, or fitted and then with everything that makes them believable."""
    if modes is None:
        return None
    if modes.fit is None:
        return blocks.section("structure", "Structure", blocks.table(modal_tables.modes(modes)))
    fit = modes.fit
    corrected = modal_tables.corrections_in_words(fit)
    key = modal_figures.key(fit)
    driving, cross = modal_figures.driving_points(modes, fit), modal_figures.cross(modes, fit)
    return blocks.section(
        "modes",
        "Modes",
        blocks.text(modal_tables.fit_in_words(fit)),
        blocks.text(corrected) if corrected else None,
        blocks.table(modal_tables.modes(modes)),
        blocks.table(modal_tables.stiffness(modes)),
        blocks.table(modal_tables.delays(modes)),
        blocks.figures(
            driving, "Fitted over measured at the driving points", _drawn(driving, fit.driving_points), "halves", key
        ),
        blocks.figures(
            cross,
            "Fitted over measured between other points and directions",
            _drawn(cross, modal_figures.cross_pairs(fit)),
            "thirds",
            key,
        ),
        blocks.table(modal_tables.residual(fit)),
        blocks.figure(modal_figures.stabilisation(modes, fit)),
        blocks.table(modal_tables.alike(modes)),
        blocks.figure(modal_figures.shapes(modes, fit)),
    )


def _drawn(shown: Sequence[figures.Figure], there: Collection) -> str:
    return f"{len(shown)} of {len(there)} are drawn." if len(shown) < len(there) else ""


def _dynamometer(sensor: Frf | None) -> dict | None:
    """What the fit looked through: force read over force applied, 1 where the dynamometer is stiff."""
    if sensor is None:
        return None
    curves = _curves(sensor)
    for block in curves:  # ids of their own beside those of the structure
        for shown in block.get("figures", [block]):
            shown["figure"] = replace(shown["figure"], name=f"sensor-{shown['figure'].name}")
    return blocks.section("sensor", "Dynamometer", *curves, blocks.table(tables.hits(sensor)))


def _curves(frf: Frf) -> list[dict]:
    """Driving points with the hammer beside them, then the cross directions."""
    driving = [figures.driving_point(frf, output, given) for output, given in driving_pairs(frf)]
    hammer = figures.hammer_spectrum(frf)
    key = [("line main", "measured"), ("span usable", "usable band")]
    if frf.variance is not None:
        key.insert(1, ("span band-main", "95 % band"))
    caption = (
        "Response and hammer in one direction. Where the coherence falls under 0.9 the curve is not to be relied on."
    )
    drawn = (
        blocks.figures([*driving, hammer] if hammer else driving, "Driving points and hammer", caption, "halves", key),
        blocks.figure(figures.cross_directions(frf)),
    )
    return [block for block in drawn if block]


def _force(fit: Coefficients | None, cuts: Sequence[CutForce], forces: ForceHarmonics | None) -> dict | None:
    """Measured against modelled force; where the force of accelerations is at hand, its own sections show that."""
    with_mean = fit is not None and mean_is_known(fit)
    if fit is None or (forces is not None and not with_mean):
        return None
    revolutions = force_figures.one_revolution(fit, cuts)
    key = list(force_figures.MEASURED_AND_MODELLED if with_mean else force_figures.HEARD_AND_MODELLED)
    if force_figures.conditioned_cuts(fit, cuts):
        key.insert(1, ("span band-measured", "± 2 sd of the revolutions"))
    caption = "Force on the tool over one revolution of the spindle; an axis has one scale in all cuts."
    if len(revolutions) < len(fit.cuts):
        caption += f" {len(revolutions)} of {len(fit.cuts)} cuts are drawn."
    if not with_mean:
        caption += " Both are without their mean, which accelerations do not tell."
    return blocks.section(
        "force",
        "Measured against modelled force" if with_mean else "Force from accelerations against the law",
        _reasons(fit, cuts),
        blocks.figures(revolutions, "Force over one revolution", caption, "stack", key),
        blocks.figure(force_figures.harmonics(fit)),
        blocks.table(tables.spectrum(fit)),
        blocks.figure(force_figures.mean_force(fit)),
    )


def _reasons(fit: Coefficients, cuts: Sequence[CutForce]) -> dict | None:
    """What the checks hold against the model: the figures below prove or refute each."""
    drawn = {
        "quality": cuts,
        "harmonics": force_figures.harmonics(fit),
        "intervals": force_figures.intervals(fit),
        "mean-force": force_figures.mean_force(fit),
    }
    hidden = {name for name, there in drawn.items() if not there} | HISTORY_PLACES | force_harmonics_section.PLACES
    return blocks.reasons([check for check in fit.checks if not check.passed], fit_level(fit), hidden)


_METHODS = {
    **force_harmonics_tables.METHODS,
    "nls": "fitted to the force within the revolution (nls)",
    "average": "fitted to the mean forces (average)",
}


def _coefficients(fit: Coefficients | None, *, compared: bool) -> dict | None:
    """The coefficients and what stands behind them.   compared : the methods stand side by side in a section of their own"""
    if fit is None:
        return None
    law = law_in_words(fit.posterior.law)
    method = _METHODS.get(fit.posterior.method, fit.posterior.method)
    return blocks.section(
        "coefficients",
        "Cutting coefficients",
        blocks.text(f"{law}, {method}, {len(fit.cuts)} cut{'s' if len(fit.cuts) > 1 else ''}."),
        blocks.table(tables.coefficients(fit.posterior, tables.untold(fit))),
        None if compared else blocks.figure(force_figures.intervals(fit)),
        blocks.checks("Checks of the fit", fit.checks),
        blocks.table(tables.agreement(fit)),
        blocks.table(tables.left_out(fit)),
        None if compared else blocks.table(tables.alternatives(fit)),
    )


def _subtitle(cuts: Sequence[Cut], fit: Fit | None, frf: Frf | None, modes: Modes | None) -> str:
    parts = []
    cutter = fit.cutter if fit is not None else cuts[0].cutter if cuts else None
    if cutter is not None:
        parts.append(f"End mill D {nominal(cutter.diameter * 1e3)} mm, {cutter.teeth} teeth")
    n = len(cuts) or (len(fit.cuts) if fit is not None else 0)
    parts += [f"{n} cuts" if n > 1 else "1 cut"] if n else []
    if frf is not None:
        parts.append(f"impact test {', '.join(frf.inputs)}")
    if modes is not None and modes.fit is not None:
        parts.append(f"{len(modes.axes)} modes")
    return " · ".join(parts)


def _verdicts(fit: Fit | None, map_: StabilityMap | None, summary: Mapping[str, Any]) -> list[Verdict]:
    """The answers, most wanted first."""
    said = [fit_verdict(fit)] if fit is not None else []
    operating = operating_verdict(map_, fit) if map_ is not None else None
    said += [operating] if operating else []
    missed = [entry for entry in summary.get("expect") or () if not entry.get("ok")]
    if missed:
        text = ", ".join(str(entry.get("key")) for entry in missed) + ": outside the interval that the recipe states."
        said.append(Verdict("bad", "✕", "Not what the recipe expects", text))
    return said


def _key_numbers(fit: Fit | None, map_: StabilityMap | None, frf: Frf | None, modes: Modes | None) -> list[dict]:
    """The numbers to take along: what, how much, unit, a word."""
    numbers = []
    if isinstance(fit, CoefficientHistory):
        numbers += history_section.key_numbers(fit)
    elif fit is not None:
        p = fit.posterior
        for name, mean, (low, high) in zip(p.names, p.mean, p.interval, strict=True):
            known = parameter(name)
            if name[0] not in "Kkm":
                continue
            value = plus_minus(*(float(v) / known.factor for v in (mean, low, high)))
            numbers.append({"name": name, "value": value, "unit": known.unit.strip("1"), "word": ""})
    numbers += stability_section.key_numbers(map_)
    if modes is not None and modes.fit is not None and not numbers:
        numbers += modal_tables.key_numbers(modes)
    if frf is not None and fit is None and map_ is None:
        low, high = (significant(end) for end in frf.usable_band)
        numbers.append({"name": "Usable band", "value": f"{low} to {high}", "unit": "Hz", "word": ""})
        if frf.hits:
            used = sum(hit.accepted for hit in frf.hits)
            numbers.append({"name": "Hits used", "value": f"{used} of {len(frf.hits)}", "unit": "", "word": ""})
    return numbers


def _provenance(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Versions and seed; inputs and recipe stand apart."""
    facts: list[tuple[str, str]] = []
    for name, value in provenance.items():
        if isinstance(value, Mapping) and name != "inputs":
            facts += [(str(key), str(item)) for key, item in sorted(value.items())]
        elif name not in ("inputs", "recipe"):
            facts.append((name, str(value)))
    return sorted(facts, key=lambda fact: (fact[0] == "seed", fact[0] != "millcal", fact[0]))
