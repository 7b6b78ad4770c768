"""What a result says to a reader: a short table of each record, with the numbers of its JSON."""

from collections.abc import Callable, Sequence
from math import floor, log10
from typing import Any

from millcal.data import (
    AXES,
    CoefficientHistory,
    Coefficients,
    CutForce,
    ForceHarmonics,
    Frf,
    Judgement,
    Modes,
    Record,
    Recording,
    SpeedAdvice,
    StabilityMap,
)
from millcal.io.force_readable import advice_text, forces_brief, forces_text
from millcal.io.judge_summary import judgement_text
from millcal.io.stability_readable import stability_brief, stability_text
from millcal.io.summaries import summarise
from millcal.io.text_table import cell as _cell
from millcal.io.text_table import interval as _interval
from millcal.io.text_table import table


def text_of(record: Record) -> str:
    """A short readable table of a record."""
    return _TEXTS[type(record)](record)


def brief_of(record: Record) -> str:
    """The same without what goes hit by hit or speed by speed."""
    return _BRIEFS[type(record)](record)


def _recording_text(recording: Recording) -> str:
    s = summarise(recording)
    head = f"{s['name']}: {s['kind']}, {s['samples']} samples at {s['sample_rate_hz']:g} Hz, {s['duration_s']:.4g} s"
    return f"{head}\n" + table(("channel", "quantity", "unit", "dof"), [tuple(c.values()) for c in s["channels"]])


def _cut_force_text(cut: CutForce) -> str:
    s = summarise(cut)
    head = f"{s['name']}: {s['spindle_speed_rpm']:.3f} rpm, {s['revolutions']} whole revolutions"
    keys = ("mean_N", "ac_rms_N", "asynchronous_rms_N", "removed_offset_N", "removed_drift_N_per_s")
    names = ("axis", "mean N", "AC rms N", "asynchronous N", "removed offset N", "drift N/s")
    return f"{head}\n" + table(names, [(axis, *(s[key][axis] for key in keys)) for axis in AXES])


def _frf_text(frf: Frf) -> str:
    if not frf.hits:
        return _frf_brief(frf)
    rows = [
        (
            hit.recording,
            hit.index,
            hit.onset,
            hit.peak,
            "; ".join(("used" if hit.accepted else ", ".join(hit.reasons) or "left out", *hit.remarks)),
        )
        for hit in frf.hits
    ]
    return f"{_frf_brief(frf)}\n" + table(("recording", "hit", "onset s", "peak N", ""), rows)


def _frf_brief(frf: Frf) -> str:
    """Without the hits one by one."""
    s = summarise(frf)
    low, high, lines = s["frequency_hz"]
    head = [
        f"{s['form']} by {s['estimator']}: {' '.join(frf.outputs)} over {' '.join(frf.inputs)}, "
        f"{lines} lines from {low:g} to {high:g} Hz",
        f"usable from {_cell(s['usable_band_hz'][0])} to {_cell(s['usable_band_hz'][1])} Hz, "
        f"median coherence there {_cell(s['coherence_median'])}",
    ]
    if frf.hits:
        head.append(f"{sum(hit.accepted for hit in frf.hits)} of {len(frf.hits)} hits used")
    return "\n".join(head)


def _modes_text(modes: Modes) -> str:
    s = summarise(modes)
    if modes.fit is None:
        return table(
            ("axis", "fn Hz", "zeta", "k N/m", "m kg", "c Ns/m"), [tuple(mode.values()) for mode in s["modes"]]
        )
    low, high = s["band_hz"]
    kind = "complex" if s["complex_modes"] else "real"
    lines = [f"{len(s['modes'])} {kind} modes from {low:g} to {high:g} Hz, {_residual(s)}"]
    rows = []
    for number, mode in enumerate(s["modes"], 1):
        dof, point = _softest(mode)
        poles = (
            _plus_minus(mode["fn_hz"], mode["fn_hz_ci95"]),
            _plus_minus(mode["zeta"], mode["zeta_ci95"], 100),
        )
        rows.append((number, mode["axis"] or None, *poles, dof, _stiffness(point), point["m_kg"], point["c_Ns_per_m"]))
    lines.append(table(("", "axis", "fn Hz", "zeta %", "at", "k N/um", "m kg", "c Ns/m"), rows))
    points = list(modes.fit.driving_points)
    if len(points) > 1:
        at = [[_stiffness(mode["driving"][dof]) for dof in points] for mode in s["modes"]]
        header = ("", *(f"k N/um at {dof}" for dof in points))
        lines.append(table(header, [(number, *row) for number, row in enumerate(at, 1)]))
    if "delay_us" in s:
        late = (f"{dof} {_cell(value)}" for dof, value in s["delay_us"].items())
        lines.append(f"delay us behind the hammer, taken out: {', '.join(late)}")
    lines.append(_INTERVALS[s["interval_from"]])
    if not points:
        outputs, inputs = " ".join(s["outputs"]), " ".join(s["inputs"])
        lines.append(f"k is not known: no point is both hit ({inputs}) and measured ({outputs}) in one direction")
    return "\n".join(lines)


def _softest(mode: dict[str, Any]) -> tuple[str | None, dict[str, Any]]:
    """The driving point where a mode gives way the most; nothing where none is known."""
    known = {dof: point for dof, point in mode["driving"].items() if point["k_N_per_m"] is not None}
    if not known:
        return None, dict.fromkeys(("k_N_per_m", "k_N_per_m_ci95", "m_kg", "c_Ns_per_m"))
    dof = min(known, key=lambda name: known[name]["k_N_per_m"])
    return dof, known[dof]


def _stiffness(point: dict[str, Any]) -> str:
    return _plus_minus(point["k_N_per_m"], point["k_N_per_m_ci95"], 1e-6)


_INTERVALS = {
    "jackknife": "+- and intervals: 95 %, by leaving out one hit after the other",
    "least squares": "+- and intervals: 95 %, of the least squares alone; what the model lacks is not in them",
    "none": "no intervals: a single hit, or an FRF without a variance, cannot tell them",
}


def _residual(s: dict[str, Any]) -> str:
    """How much of the FRF the modes leave, and where the most."""
    told = f"residual {_percent(s['residual_relative'])}"
    single = {f"{o}/{i}": value for o, row in s["residual"].items() for i, value in row.items() if value is not None}
    if len(single) < 2:
        return told
    worst = max(single, key=lambda name: single[name])
    return f"{told}, the most at {worst}: {_percent(single[worst])}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.2g} %"


def _plus_minus(value: float | None, bounds: Sequence[float | None] | None, factor: float = 1.0) -> str:
    """`650.12 +- 0.04`, to the two digits that the half width deserves; a lopsided interval by its ends."""
    low, high = (None if bound is None else factor * bound for bound in bounds or (None, None))
    if low is None or value is None or high is None:
        if low is not None:
            return f"over {_rough(low)}"
        return _cell(None if value is None else factor * value)
    value, half = factor * value, (high - low) / 2
    if not half > 0:
        return _cell(value)
    finest = 6 - floor(log10(value)) if value > 0 else 6
    decimals = min(1 - floor(log10(half)), finest)
    if abs(value - low - half) < 0.1 * half:
        return f"{_to(value, decimals)} +- {_to(half, decimals) if half >= 10.0**-finest else f'{half:.1g}'}"
    return f"{_to(value, decimals)} ({_to(low, decimals)} to {_to(high, decimals)})"


def _to(number: float, decimals: int) -> str:
    return f"{round(number, decimals):.{max(decimals, 0)}f}"


def _rough(number: float) -> str:
    """Two digits."""
    return _to(number, 1 - floor(log10(number))) if number > 0 else "0"


def _coefficients_text(fit: Coefficients) -> str:
    s = summarise(fit)
    rows = [(name, c["value"], *c["ci95"], c["unit"]) for name, c in s["coefficients"].items()]
    lines = [
        f"{s['law']} law by {s['method']} from {len(fit.cuts)} cuts",
        table(("", "value", "95 % from", "to", "unit"), rows),
        "",
    ]
    quality = [
        ("R2", "r2"),
        ("residual rms N", "residual_rms_N"),
        ("residual/AC, fitted", "in_sample"),
        ("left out", "left_out"),
    ]
    known = [(name, *s[key].values()) for name, key in quality if s[key] is not None]
    lines += [table(("", *AXES), known), "", f"verdict: {fit.verdict}"]
    lines += [f"  failed: {check.name}: {check.message}" for check in fit.checks if not check.passed]
    return "\n".join(lines)


def _history_text(history: CoefficientHistory) -> str:
    s = summarise(history)
    n = len(history.cuts)
    duration = "" if s["duration_s"] is None else f", {_cell(s['duration_s'])} s"
    rows = [(name, c["value"], *c["ci95"], c["unit"]) for name, c in s["coefficients"].items()]
    course, last = s["history"]["specific_force_N_per_mm2"], s["specific_force_end_N_per_mm2"]
    change = {
        # a filter starts with its prior, which is no finding
        "start": [course[d][0] if course[d] and s["method"] == "smooth" else None for d in history.directions],
        "end": [last[d]["value"] if last else None for d in history.directions],
        "95 %": [_interval(last[d]["ci95"] if last else None) for d in history.directions],
        "%/min": [s["slope_percent_per_min"][d]["value"] for d in history.directions],
        "by 95 %": [_interval(s["slope_percent_per_min"][d]["ci95"]) for d in history.directions],
    }
    told = {name: values for name, values in change.items() if set(values) - {None, "-"}}
    lines = [
        f"{s['law']} law by {s['method']} from {n} cut{'s' if n > 1 else ''}{duration}; at the end:",
        table(("", "value", "95 % from", "to", "unit"), rows),
        "",
        f"specific force on a chip of {_cell(s['reference_chip_um'])} um, N/mm^2 (the chips are "
        f"{_interval(s['chip_range_um'])} um):",
        table(("", *told), list(zip(history.directions, *told.values(), strict=True))),
    ]
    for jump in s["jumps"]:
        by = ", ".join(
            f"{d} {_percentage(c['value'])} ({_interval(c['ci95'])})" for d, c in jump["change_percent"].items()
        )
        lines.append(f"jump at {_cell(jump['time_s'])} s: {by}; ln Bayes factor {_cell(jump['log_bayes_factor'])}")
    lines += [f"model: {s['model']}"] if s["model"] else []
    quality = [("R2", "r2"), ("residual rms N", "residual_rms_N"), (f"noise N ({s['noise_from']})", "noise_N")]
    known = [(name, *(s[key][axis] for axis in history.axes)) for name, key in quality]
    lines += ["", table(("", *history.axes), known), f"chi2 {_cell(s['chi2'])}", "", f"verdict: {history.verdict}"]
    lines += [f"  failed: {check.name}: {check.message}" for check in history.checks if not check.passed]
    return "\n".join(lines)


def _percentage(value: float | None) -> str:
    return "-" if value is None else f"{value:+.3g} %"


_TEXTS: dict[type, Callable[[Any], str]] = {
    Recording: _recording_text,
    CutForce: _cut_force_text,
    Frf: _frf_text,
    Modes: _modes_text,
    Coefficients: _coefficients_text,
    CoefficientHistory: _history_text,
    ForceHarmonics: forces_text,
    SpeedAdvice: advice_text,
    Judgement: judgement_text,
    StabilityMap: stability_text,
}

_BRIEFS: dict[type, Callable[[Any], str]] = {
    **_TEXTS,
    Frf: _frf_brief,
    ForceHarmonics: forces_brief,
    StabilityMap: stability_brief,
}
