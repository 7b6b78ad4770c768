"""What a result says to a script and to a reader: the JSON `result` of each record, and a short table of the same.

Numbers carry their shop unit in the key; what cannot be known is null (None here).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from millcal.data import AXES, Coefficients, CutForce, Frf, Modes, Posterior, Record, Recording, StabilityMap
from millcal.io.keys import keys_of
from millcal.units import SUFFIXES, to_shop

_SHOP = {  # SI unit of a parameter -> its unit on the shop floor: as the key says it, and as it is written
    "N/m^2": ("N_per_mm2", "N/mm^2"),
    "N/m": ("N_per_mm", "N/mm"),
    "m": ("um", "um"),
    "rad": ("deg", "deg"),
}


def summarise(record: Record) -> dict[str, Any]:
    """The JSON `result` of a record: recording, cut, FRF, modes, coefficients or stability map."""
    return _SUMMARIES[type(record)](record)


def text_of(record: Record) -> str:
    """A short readable table of the same."""
    return _TEXTS[type(record)](record)


def value_at(summary: Mapping[str, Any], path: str) -> Any:
    """What a summary holds at a dotted path, None where it holds nothing.

    A coefficient may be asked for with its unit: `coefficients.Ktc_N_per_mm2` is `coefficients.Ktc.value`.
    """
    value: Any = summary
    for part in path.split("."):
        if isinstance(value, Mapping) and part not in value:
            named = value.get(_without_unit(part))
            value = named.get("value") if isinstance(named, Mapping) else None
        elif isinstance(value, Mapping):
            value = value[part]
        elif isinstance(value, (list, tuple)) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            return None
    return value.get("value") if isinstance(value, Mapping) else value


def _without_unit(key: str) -> str:
    return next((key[: -len(unit) - 1] for unit in sorted(SUFFIXES, key=len)[::-1] if key.endswith("_" + unit)), key)


def _known(value: Any) -> float | None:
    return float(value) if value is not None and isfinite(value) else None


def _shop(value: float | None, key: str) -> float | None:
    """An SI value in the unit of the key, None where there is none."""
    return None if value is None else _known(to_shop(value, key))


def _by_axis(values: np.ndarray | None) -> dict[str, float | None] | None:
    return None if values is None else {axis: _known(value) for axis, value in zip(AXES, values, strict=True)}


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "name": recording.name,
        "kind": recording.kind,
        "sample_rate_hz": recording.sample_rate,
        "samples": recording.samples.shape[1],
        "duration_s": recording.duration,
        "channels": [
            {"name": c.name, "quantity": c.quantity, "unit": c.unit, "dof": c.dof} for c in recording.channels
        ],
        "conditions": keys_of(recording.cutter, recording.conditions),
    }


def _cut_force(cut: CutForce) -> dict[str, Any]:
    return {
        "name": cut.name,
        "conditions": keys_of(cut.cutter, cut.conditions),
        "sample_rate_hz": cut.sample_rate,
        "spindle_speed_rpm": _known(60 * cut.spindle_frequency),
        "spindle_speed_sd_rpm": _known(60 * cut.spindle_frequency_sd),
        "revolutions": cut.revolutions,
        "steady_s": list(cut.steady),
        "air_s": [list(span) for span in cut.air],
        "phase_from_pulse": cut.phase_from_pulse,
        "lowpass_hz": cut.lowpass,
        "mean_N": _by_axis(cut.harmonics[:, 0].real),
        "ac_rms_N": _by_axis(cut.ac_rms),
        "asynchronous_rms_N": _by_axis(cut.asynchronous_rms),
        "synchronous_share": _by_axis(cut.synchronous_share),
        "removed_offset_N": _by_axis(cut.removed_offset),
        "removed_drift_N_per_s": _by_axis(cut.removed_drift),
        "asynchronous_peaks": [
            {"axis": p.axis, "frequency_hz": _known(p.frequency), "amplitude_N": _known(p.amplitude), "exceeds": _known(p.exceeds)}
            for p in cut.peaks
        ],
    }  # fmt: skip


def _frf(frf: Frf) -> dict[str, Any]:
    low, high = frf.usable_band
    coherence = None
    if frf.coherence is not None:
        inside = frf.coherence[(frf.frequency >= low) & (frf.frequency <= high)]
        inside = inside[np.isfinite(inside)]
        coherence = float(np.median(inside)) if inside.size else None
    return {
        "form": frf.form,
        "estimator": frf.estimator,
        "outputs": list(frf.outputs),
        "inputs": list(frf.inputs),
        "hits_used": list(frf.hits_used),
        "frequency_hz": [_known(frf.frequency[0]), _known(frf.frequency[-1]), len(frf.frequency)],
        "usable_band_hz": [_known(low), _known(high)],
        "coherence_median": coherence,
        "hits": [
            {"recording": hit.recording, "index": hit.index, "onset_s": _known(hit.onset), "peak_N": _known(hit.peak),
             "accepted": hit.accepted, "reasons": list(hit.reasons)}
            for hit in frf.hits
        ],
    }  # fmt: skip


def _modes(modes: Modes) -> dict[str, Any]:
    return {
        "modes": [
            {"axis": axis, "fn_hz": float(fn), "zeta": float(zeta), "k_N_per_m": float(k),
             "m_kg": float(k / (2 * np.pi * fn) ** 2), "c_Ns_per_m": float(2 * zeta * k / (2 * np.pi * fn))}
            for axis, fn, zeta, k in zip(
                modes.axes, modes.natural_frequency, modes.damping_ratio, modes.stiffness, strict=True
            )
        ]
    }  # fmt: skip


def _posterior(posterior: Posterior) -> dict[str, Any]:
    """Each parameter under its contract name: Ktc and mt as they are, the runout with its unit, c0_um."""
    spread = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    told = {}
    for i, (name, si_unit) in enumerate(zip(posterior.names, posterior.units, strict=True)):
        suffix, unit = _SHOP.get(si_unit, ("", si_unit))
        key = f"x_{suffix}"
        told[f"{name}_{suffix}" if suffix in ("um", "deg") else name] = {
            "value": _shop(posterior.mean[i], key),
            "unit": unit,
            "sd": _shop(spread[i], key),
            "ci95": [_shop(bound, key) for bound in posterior.interval[i]],
        }
    return told


def _coefficients(fit: Coefficients) -> dict[str, Any]:
    cuts = [
        {
            "name": name,
            "conditions": keys_of(fit.cutter, conditions),
            "measured_mean_N": _by_axis(fit.measured_mean[i]),
            "modelled_mean_N": _by_axis(fit.modelled_mean[i]),
            "left_out": None if fit.left_out_by_cut is None else _by_axis(fit.left_out_by_cut[i]),
            "phase_deg": None if fit.phase is None else _shop(fit.phase[i], "phase_deg"),
        }
        for i, (name, conditions) in enumerate(zip(fit.cuts, fit.conditions, strict=True))
    ]
    return {
        "method": fit.posterior.method,
        "law": fit.posterior.law,
        "coefficients": _posterior(fit.posterior),
        "verdict": fit.verdict,
        "checks": [{"name": c.name, "passed": c.passed, "message": c.message} for c in fit.checks],
        "r2": _by_axis(fit.r2),
        "residual_rms_N": _by_axis(fit.residual_rms),
        "harmonics": list(fit.band),
        "in_sample": _by_axis(fit.in_sample),
        "left_out": _by_axis(fit.left_out),
        "in_sample_wide": _by_axis(fit.in_sample_wide),
        "left_out_wide": _by_axis(fit.left_out_wide),
        "alternatives": [
            {"model": name, "values": {key: _known(value) for key, value in values}}
            for name, values in fit.alternatives
        ],
        "cuts": cuts,
    }


def _stability(found: StabilityMap) -> dict[str, Any]:
    banded = found.limit_low is not None and found.limit_high is not None
    limit = []
    for i, speed in enumerate(found.spindle_speed):
        crossing = {
            "ap_mm": _shop(found.limit_depth[i], "ap_mm"),
            "kind": "hopf",  # the zero-order approximation knows no flip
            "chatter_hz": _known(found.chatter_frequency[i]),
            "lobe": _known(found.lobe[i]),
        }
        if banded:
            crossing["ap_mm_ci95"] = [_shop(bound[i], "ap_mm") for bound in (found.limit_low, found.limit_high)]
        limit.append({"rpm": _shop(speed, "x_rpm"), "crossings": [] if crossing["ap_mm"] is None else [crossing]})
    point = found.operating_point
    return {
        "method": found.method,
        "teeth": found.teeth,
        "diameter_mm": _shop(found.diameter, "diameter_mm"),
        "radial_depth_mm": _shop(found.radial_depth, "radial_depth_mm"),
        "direction": found.direction,
        "feed_per_tooth_mm": _shop(found.feed_per_tooth, "feed_per_tooth_mm"),
        "minimum": {
            "ap_mm": _shop(found.absolute_minimum, "ap_mm"),
            "chatter_hz": _known(found.absolute_minimum_frequency),
        },
        "best": [
            {
                "rpm": _shop(best.spindle_speed, "x_rpm"),
                "ap_mm": _shop(best.axial_depth, "ap_mm"),
                "mrr_cm3_per_min": _shop(best.removal_rate, "mrr_cm3_per_min"),
                "p_stable": None if best.p_stable is None else _known(best.p_stable),
                "safe_ap_mm": _shop(best.safe_depth, "ap_mm"),
            }
            for best in found.best
        ],
        "operating_point": None
        if point is None
        else {
            "rpm": _shop(point[0], "x_rpm"),
            "ap_mm": _shop(point[1], "ap_mm"),
            "p_stable": _known(found.operating_p_stable),
            "limit_ap_mm": _shop(found.operating_limit, "ap_mm"),
            "limit_ap_mm_ci95": None
            if found.operating_limit_interval is None
            else [_shop(bound, "ap_mm") for bound in found.operating_limit_interval],
        },
        "limit": limit,
    }


_SUMMARIES: dict[type, Callable[[Any], dict[str, Any]]] = {
    Recording: _recording,
    CutForce: _cut_force,
    Frf: _frf,
    Modes: _modes,
    Coefficients: _coefficients,
    StabilityMap: _stability,
}


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Rows under a header, columns two blanks apart; numbers to the right, texts to the left."""
    shown = [[_cell(item) for item in row] for row in rows]
    numeric = [all(_is_number(row[i]) for row in shown) for i in range(len(header))]
    widths = [max([len(name), *(len(row[i]) for row in shown)]) for i, name in enumerate(header)]
    lines = [
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        )
        for line in [list(header), *shown]
    ]
    return "\n".join(line.rstrip() for line in lines)


def _cell(item: Any) -> str:
    """Four digits are enough to read; a dash is what is not known."""
    if item is None or (isinstance(item, float) and not isfinite(item)):
        return "-"
    if isinstance(item, float):
        return f"{item:.0f}" if abs(item) >= 1e3 else f"{item:.4g}"
    return str(item)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True


def _recording_text(recording: Recording) -> str:
    s = _recording(recording)
    head = f"{s['name']}: {s['kind']}, {s['samples']} samples at {s['sample_rate_hz']:g} Hz, {s['duration_s']:.4g} s"
    return f"{head}\n" + table(("channel", "quantity", "unit", "dof"), [tuple(c.values()) for c in s["channels"]])


def _cut_force_text(cut: CutForce) -> str:
    s = _cut_force(cut)
    head = f"{s['name']}: {s['spindle_speed_rpm']:.3f} rpm, {s['revolutions']} whole revolutions"
    keys = ("mean_N", "ac_rms_N", "asynchronous_rms_N", "removed_offset_N", "removed_drift_N_per_s")
    names = ("axis", "mean N", "AC rms N", "asynchronous N", "removed offset N", "drift N/s")
    return f"{head}\n" + table(names, [(axis, *(s[key][axis] for key in keys)) for axis in AXES])


def _frf_text(frf: Frf) -> str:
    s = _frf(frf)
    low, high, lines = s["frequency_hz"]
    used = sum(hit.accepted for hit in frf.hits)
    coherence = s["coherence_median"]
    head = [
        f"{s['form']} by {s['estimator']}: {' '.join(frf.outputs)} over {' '.join(frf.inputs)}, "
        f"{lines} lines from {low:g} to {high:g} Hz",
        f"usable from {_cell(s['usable_band_hz'][0])} to {_cell(s['usable_band_hz'][1])} Hz, "
        f"median coherence there {_cell(coherence)}",
    ]
    if not frf.hits:
        return "\n".join(head)
    rows = [
        (
            hit.recording,
            hit.index,
            hit.onset,
            hit.peak,
            "used" if hit.accepted else ", ".join(hit.reasons) or "left out",
        )
        for hit in frf.hits
    ]
    hits = table(("recording", "hit", "onset s", "peak N", ""), rows)
    return "\n".join([*head, f"{used} of {len(frf.hits)} hits used", hits])


def _modes_text(modes: Modes) -> str:
    rows = [tuple(mode.values()) for mode in _modes(modes)["modes"]]
    return table(("axis", "fn Hz", "zeta", "k N/m", "m kg", "c Ns/m"), rows)


def _coefficients_text(fit: Coefficients) -> str:
    s = _coefficients(fit)
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


def _stability_text(found: StabilityMap) -> str:
    s = _stability(found)
    minimum = s["minimum"]
    lines = [
        f"{s['method']}, {found.teeth} teeth, {found.direction}, radial depth {s['radial_depth_mm']:.4g} mm: "
        f"stable at any speed below {_cell(minimum['ap_mm'])} mm"
    ]
    banded = found.limit_low is not None
    rows = []
    for i in _round_speeds(np.array([entry["rpm"] for entry in s["limit"]])):
        entry = s["limit"][i]
        first = entry["crossings"][0] if entry["crossings"] else dict.fromkeys(("ap_mm", "chatter_hz", "lobe"))
        interval = [_interval(first.get("ap_mm_ci95"))] if banded else []
        rows.append((round(entry["rpm"]), first["ap_mm"], *interval, first["chatter_hz"], first["lobe"]))
    lines.append(table(("rpm", "limit mm", *(["95 %"] if banded else []), "chatter Hz", "lobe"), rows))
    if s["best"]:
        lines.append("best speeds, the most material first:")
        keys = ("ap_mm", "mrr_cm3_per_min", "p_stable", "safe_ap_mm")[: 4 if banded else 2]
        rows = [(round(b["rpm"]), *(b[key] for key in keys)) for b in s["best"]]
        lines.append(table(("rpm", "limit mm", "cm3/min", "p stable", "safe mm")[: len(keys) + 1], rows))
    else:
        lines.append("no pocket between lobes in this range of speeds")
    if s["operating_point"] is not None:
        p = s["operating_point"]
        stable = "" if p["p_stable"] is None else f", stable with probability {p['p_stable']:.3g}"
        limit = f"limit {_cell(p['limit_ap_mm'])} mm"
        if p["limit_ap_mm_ci95"] is not None:
            limit += f" ({_interval(p['limit_ap_mm_ci95'])})"
        lines.append(f"operating point {p['rpm']:.0f} rpm, {p['ap_mm']:.4g} mm: {limit}{stable}")
    return "\n".join(lines)


def _round_speeds(rpm: np.ndarray) -> list[int]:
    """Indices of the speeds of a map nearest to round ones, about a dozen of them."""
    span = float(rpm[-1] - rpm[0])
    steps = [mantissa * 10.0**power for power in range(-1, 6) for mantissa in (1, 2, 5)]
    step = next(step for step in steps if span / step <= 14)
    first = int(np.ceil(rpm[0] / step - 1e-9))
    wanted = step * np.arange(first, int(np.floor(rpm[-1] / step + 1e-9)) + 1)
    return list(dict.fromkeys(int(np.argmin(np.abs(rpm - speed))) for speed in wanted))


def _interval(bounds: Sequence[float | None] | None) -> str:
    return "-" if bounds is None else " to ".join(_cell(bound) for bound in bounds)


_TEXTS: dict[type, Callable[[Any], str]] = {
    Recording: _recording_text,
    CutForce: _cut_force_text,
    Frf: _frf_text,
    Modes: _modes_text,
    Coefficients: _coefficients_text,
    StabilityMap: _stability_text,
}
