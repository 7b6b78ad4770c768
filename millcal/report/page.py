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

from millcal.data import Coefficients, CutForce, Frf, Modes, StabilityMap
from millcal.report import figures, force_figures, modal_figures, modal_tables, notices, stability_figure, tables
from millcal.report.digits import fixed, nominal, plus_minus, rounded_down, significant
from millcal.report.driving_points import driving_pairs
from millcal.report.wording import (
    Verdict,
    cutter_in_words,
    fit_level,
    fit_verdict,
    map_verdict,
    operating_verdict,
    parameter,
    question,
    spelt,
)
from millcal.units import to_shop


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


def render(results: Mapping[str, Any], summary: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """The report as HTML text; the same input gives the same bytes.

    results : any of "cuts" (sequence of CutForce), "frf" (Frf), "sensor" (Frf), "modes" (Modes), "coefficients" (Coefficients),
        "stability" (StabilityMap); a missing or None entry leaves its sections out
    summary : what `summary.json` holds; read are `title`, `warnings` and `notes` [{code, message, where}],
        `expect` [{key, value, interval, ok}] and `recordings` [{name, path, kind, sample_rate_hz, duration_s,
        channels: [{name, quantity, unit, dof}]}], each optional
    provenance : as `io.provenance` makes it: versions, `inputs` {path: sha256}, `seed`, `recipe` (its text), each optional
    """
    cuts: Sequence[CutForce] = tuple(results.get("cuts") or ())
    frf: Frf | None = results.get("frf")
    sensor: Frf | None = results.get("sensor")
    modes: Modes | None = results.get("modes")
    fit: Coefficients | None = results.get("coefficients")
    map_: StabilityMap | None = results.get("stability")
    records = (*cuts, frf, sensor, modes, fit, map_)
    sections = [
        _measured(cuts, fit, summary, provenance),
        _quality(cuts, frf),
        _dynamics(frf),
        _modal(modes),
        _dynamometer(sensor),
        _force(fit, cuts),
        _coefficients(fit),
        _stability(map_, fit),
    ]
    return _TEMPLATES.get_template("page.html.j2").render(
        title=summary.get("title") or "Calibration report",
        subtitle=_subtitle(cuts, fit, frf, modes),
        verdicts=_verdicts(fit, map_, summary),
        key_numbers=_key_numbers(fit, map_, frf, modes),
        expected=tables.expected(summary),
        sections=[section for section in sections if section],
        warnings=notices.grouped(summary, records, "warning"),
        notes=notices.grouped(summary, records, "note"),
        provenance=_provenance(provenance),
        inputs=sorted((provenance.get("inputs") or {}).items()),
        recipe=provenance.get("recipe") or "",
    )


def _section(name: str, title: str, *blocks: dict | None) -> dict | None:
    """A section of what there is; none where there is nothing."""
    there = [block for block in blocks if block]
    return {"name": name, "title": title, "blocks": there} if there else None


def _table(table: tables.Table | None) -> dict | None:
    return {"kind": "table", "table": table} if table else None


def _figure(figure: figures.Figure | None) -> dict | None:
    if figure is None:
        return None
    return {"kind": "figure", "figure": figure, "charts": [Markup(svg) for svg in figure.charts]}


def _figures(shown: Sequence[figures.Figure], title: str, caption: str, layout: str, key: Sequence = ()) -> dict | None:
    """Several figures under one heading, side by side where the page is wide."""
    inner = [_figure(figure) for figure in shown]
    head = {"kind": "figures", "title": title, "caption": caption, "layout": layout, "key": key}
    return {**head, "figures": inner} if inner else None


def _facts(title: str, facts: Sequence[tuple[str, str]]) -> dict | None:
    return {"kind": "facts", "title": title, "facts": facts} if facts else None


def _measured(
    cuts: Sequence[CutForce], fit: Coefficients | None, summary: Mapping[str, Any], provenance: Mapping[str, Any]
) -> dict | None:
    cutter = fit.cutter if fit is not None else cuts[0].cutter if cuts else None
    return _section(
        "measured",
        "What was measured, and with what",
        _facts("Cutter", cutter_in_words(cutter)) if cutter else None,
        _table(tables.conditions(cuts, fit)),
        _table(tables.recordings(summary, provenance)),
    )


def _quality(cuts: Sequence[CutForce], frf: Frf | None) -> dict | None:
    shown = [cuts[number] for number in force_figures.cuts_shown(len(cuts))] if cuts else []
    caption = (
        "Lowest and highest force of every short stretch. Shaded: the steady part, which was used, and the air cuts."
    )
    if len(shown) < len(cuts):
        caption += f" {len(shown)} of {len(cuts)} cuts are drawn."
    return _section(
        "quality",
        "How good the recordings are",
        _table(tables.synchronous(cuts)) if cuts else None,
        _table(tables.peaks(cuts)),
        _table(tables.removed(cuts)) if cuts else None,
        _figures(
            figures.overview(shown),
            "The whole records",
            caption,
            "halves",
            (("span steady", "steady cut"), ("span air", "air cut"), ("span signal", "envelope of the force")),
        ),
        _table(tables.hits(frf)) if frf is not None else None,
    )


def _dynamics(frf: Frf | None) -> dict | None:
    return _section("frf", "Frequency response", *_curves(frf)) if frf is not None else None


def _modal(modes: Modes | None) -> dict | None:
    """The modes: given by hand, or fitted and then with everything that makes them believable."""
    if modes is None:
        return None
    if modes.fit is None:
        return _section("structure", "Structure", _table(modal_tables.modes(modes)))
    fit = modes.fit
    corrected = modal_tables.corrections_in_words(fit)
    key = modal_figures.key(fit)
    driving, cross = modal_figures.driving_points(modes, fit), modal_figures.cross(modes, fit)
    return _section(
        "modes",
        "Modes",
        {"kind": "text", "text": modal_tables.fit_in_words(fit)},
        {"kind": "text", "text": corrected} if corrected else None,
        _table(modal_tables.modes(modes)),
        _table(modal_tables.stiffness(modes)),
        _table(modal_tables.delays(modes)),
        _figures(
            driving, "Fitted over measured at the driving points", _drawn(driving, fit.driving_points), "halves", key
        ),
        _figures(
            cross,
            "Fitted over measured between other points and directions",
            _drawn(cross, modal_figures.cross_pairs(fit)),
            "thirds",
            key,
        ),
        _table(modal_tables.residual(fit)),
        _figure(modal_figures.stabilisation(modes, fit)),
        _table(modal_tables.alike(modes)),
        _figure(modal_figures.shapes(modes, fit)),
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
    return _section("sensor", "Dynamometer", *curves, _table(tables.hits(sensor)))


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
    blocks = (
        _figures([*driving, hammer] if hammer else driving, "Driving points and hammer", caption, "halves", key),
        _figure(figures.cross_directions(frf)),
    )
    return [block for block in blocks if block]


def _force(fit: Coefficients | None, cuts: Sequence[CutForce]) -> dict | None:
    if fit is None:
        return None
    revolutions = force_figures.one_revolution(fit, cuts)
    key = list(force_figures.MEASURED_AND_MODELLED)
    if force_figures.conditioned_cuts(fit, cuts):
        key.insert(1, ("span band-measured", "± 2 sd of the revolutions"))
    caption = "Force on the tool over one revolution of the spindle; an axis has one scale in all cuts."
    if len(revolutions) < len(fit.cuts):
        caption += f" {len(revolutions)} of {len(fit.cuts)} cuts are drawn."
    return _section(
        "force",
        "Measured against modelled force",
        _reasons(fit, cuts),
        _figures(revolutions, "Force over one revolution", caption, "stack", key),
        _figure(force_figures.harmonics(fit)),
        _table(tables.spectrum(fit)),
        _figure(force_figures.mean_force(fit)),
    )


def _reasons(fit: Coefficients, cuts: Sequence[CutForce]) -> dict | None:
    """What the checks hold against the model, and where to see it: the figures below prove or refute each."""
    level = fit_level(fit)
    asked = [question(check.name) for check in fit.checks if not check.passed]
    if level not in ("bad", "part") or not asked:
        return None
    drawn = {"quality": cuts, "harmonics": force_figures.harmonics(fit), "intervals": force_figures.intervals(fit)}
    hidden = {name for name, there in drawn.items() if not there}
    reasons = [replace(one, place="", look="") if one.place in hidden else one for one in asked]
    title = "Why the model does not fit" if level == "bad" else "Why the model fits in part only"
    return {"kind": "reasons", "title": title, "reasons": reasons}


_METHODS = {"nls": "fitted to the force within the revolution (nls)", "average": "fitted to the mean forces (average)"}


def _coefficients(fit: Coefficients | None) -> dict | None:
    if fit is None:
        return None
    law = {"linear-edge": "Linear-edge law", "kienzle": "Kienzle law"}.get(fit.posterior.law, fit.posterior.law)
    method = _METHODS.get(fit.posterior.method, fit.posterior.method)
    return _section(
        "coefficients",
        "Cutting coefficients",
        {"kind": "text", "text": f"{law}, {method}, {len(fit.cuts)} cut{'s' if len(fit.cuts) > 1 else ''}."},
        _table(tables.coefficients(fit)),
        _figure(force_figures.intervals(fit)),
        {"kind": "checks", "title": "Checks of the fit", "checks": fit.checks} if fit.checks else None,
        _table(tables.agreement(fit)),
        _table(tables.left_out(fit)),
        _table(tables.alternatives(fit)),
    )


def _stability(map_: StabilityMap | None, fit: Coefficients | None) -> dict | None:
    if map_ is None:
        return None
    doubt = map_verdict(fit)
    return _section(
        "stability",
        "Stability",
        {"kind": "verdict", "verdict": doubt} if doubt else None,
        _facts("", tables.map_facts(map_)),
        _figure(stability_figure.lobes(map_)),
        _table(tables.best_speeds(map_)),
    )


def _subtitle(cuts: Sequence[CutForce], fit: Coefficients | None, frf: Frf | None, modes: Modes | None) -> str:
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


def _verdicts(fit: Coefficients | None, map_: StabilityMap | None, summary: Mapping[str, Any]) -> list[Verdict]:
    """The answers, most wanted first."""
    said = [fit_verdict(fit)] if fit is not None else []
    operating = operating_verdict(map_, fit) if map_ is not None else None
    said += [operating] if operating else []
    missed = [entry for entry in summary.get("expect") or () if not entry.get("ok")]
    if missed:
        text = ", ".join(str(entry.get("key")) for entry in missed) + ": outside the interval that the recipe states."
        said.append(Verdict("bad", "✕", "Not what the recipe expects", text))
    return said


def _key_numbers(
    fit: Coefficients | None, map_: StabilityMap | None, frf: Frf | None, modes: Modes | None
) -> list[dict]:
    """The numbers to take along: what, how much, unit, a word."""
    numbers = []
    if fit is not None:
        p = fit.posterior
        for name, mean, (low, high) in zip(p.names, p.mean, p.interval, strict=True):
            known = parameter(name)
            if name[0] not in "Kkm":
                continue
            value = plus_minus(*(float(v) / known.factor for v in (mean, low, high)))
            numbers.append({"name": name, "value": value, "unit": known.unit.strip("1"), "word": ""})
    if map_ is not None:
        if map_.absolute_minimum < float("inf"):
            value = significant(map_.absolute_minimum * 1e3)
            numbers.append(
                {"name": "Smallest limit", "value": value, "unit": "mm", "word": "stable below it at every speed"}
            )
        for best in map_.best[:1]:
            limit, safe = best.axial_depth * 1e3, best.safe_depth
            word = f"limit {significant(limit)} mm" if safe is None else f"safe to {rounded_down(safe * 1e3, 2)} mm"
            speed = fixed(to_shop(best.spindle_speed, "spindle_speed_rpm"), 0)
            numbers.append({"name": "Best speed", "value": speed, "unit": "rpm", "word": word})
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
