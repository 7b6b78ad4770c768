"""What a result says to a script: the JSON `result` of each record (`readable` is the same for a reader).

Numbers carry their shop unit in the key; what cannot be known is null (None here).
"""

from collections.abc import Callable, Iterable, Mapping
from math import isfinite
from typing import Any

import numpy as np

from millcal.data import (
    AXES,
    CoefficientHistory,
    Coefficients,
    CutForce,
    CutSamples,
    CutVibration,
    ForceHarmonics,
    Frf,
    Judgement,
    Modes,
    Notice,
    Record,
    Recording,
    SpeedAdvice,
    StabilityMap,
)
from millcal.io.force_summary import summarise_advice, summarise_forces, summarise_vibration
from millcal.io.history_summary import summarise_history
from millcal.io.judge_summary import summarise_judgement
from millcal.io.keys import keys_of
from millcal.io.modal_summary import summarise_modes
from millcal.io.parameter_summary import known, offset_of_the_cutter, posterior_summary, shop, shop_value
from millcal.io.stability_summary import summarise_stability
from millcal.units import SUFFIXES


def summarise(record: Record) -> dict[str, Any]:
    """The JSON `result` of a record: recording, cut, FRF, modes, coefficients, forces, a stability map and so on."""
    return _SUMMARIES[type(record)](record)


def summarise_notices(notices: Iterable[Notice]) -> dict[str, list[dict[str, str]]]:
    """Warnings and notes apart, each as its code, message and place."""
    told: dict[str, list[dict[str, str]]] = {"warnings": [], "notes": []}
    for notice in notices:
        told[f"{notice.level}s"].append({"code": notice.code, "message": notice.message, "where": notice.where})
    return told


def without_nan(value: Any) -> Any:
    """The same JSON tree with null where a number cannot be known (NaN, infinity)."""
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    if hasattr(value, "tolist"):  # numpy scalar or array
        return without_nan(value.tolist())
    return value


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


def _by_axis(values: np.ndarray | None) -> dict[str, float | None] | None:
    return None if values is None else {axis: known(value) for axis, value in zip(AXES, values, strict=True)}


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "name": recording.name,
        "kind": recording.kind,
        "sample_rate_hz": recording.sample_rate,
        "samples": recording.samples.shape[1],
        "duration_s": recording.duration,
        "channels": [
            {
                "name": c.name,
                "quantity": c.quantity,
                "unit": c.unit,
                "dof": c.dof,
                **({"role": c.role} if c.role else {}),
                **({"delay_s": c.delay} if c.delay else {}),
            }
            for c in recording.channels
        ],
        "conditions": keys_of(recording.cutter, recording.conditions),
    }


def _cut_force(cut: CutForce) -> dict[str, Any]:
    return {
        "name": cut.name,
        "conditions": keys_of(cut.cutter, cut.conditions),
        "sample_rate_hz": cut.sample_rate,
        "spindle_speed_rpm": known(60 * cut.spindle_frequency),
        "spindle_speed_sd_rpm": known(60 * cut.spindle_frequency_sd),
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
            {"axis": p.axis, "frequency_hz": known(p.frequency), "amplitude_N": known(p.amplitude), "exceeds": known(p.exceeds)}
            for p in cut.peaks
        ],
    }  # fmt: skip


def _cut_samples(cut: CutSamples) -> dict[str, Any]:
    length = cut.force.shape[1]
    return {
        "name": cut.name,
        "conditions": keys_of(cut.cutter, cut.conditions),
        "sample_rate_hz": cut.sample_rate,
        "spindle_speed_rpm": known(60 * cut.spindle_frequency),
        "revolutions": known(length * cut.spindle_frequency / cut.sample_rate),
        "cut_s": [cut.start, cut.start + length / cut.sample_rate],
        "angle_from": cut.angle_from,
        "mean_N": _measured(cut, cut.force.mean(axis=1)),
        "rms_N": _measured(cut, np.sqrt(np.mean(cut.force**2, axis=1))),
    }


def _measured(cut: CutSamples, values: np.ndarray) -> dict[str, float | None]:
    """Of x, y and z, None for an axis that was not measured."""
    found = dict(zip(cut.axes, values, strict=True))
    return {axis: known(found.get(axis)) for axis in AXES}


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
        "frequency_hz": [known(frf.frequency[0]), known(frf.frequency[-1]), len(frf.frequency)],
        "usable_band_hz": [known(low), known(high)],
        "coherence_median": coherence,
        "hits": [
            {"recording": hit.recording, "index": hit.index, "onset_s": known(hit.onset), "peak_N": known(hit.peak),
             "accepted": hit.accepted, "reasons": list(hit.reasons), "remarks": list(hit.remarks)}
            for hit in frf.hits
        ],
    }  # fmt: skip


def _offset_of_the_cutter(fit: Coefficients) -> dict[str, Any]:
    """rho and lambda where the cuts share one depth: c0 and s0 are the parts of the offset in x and y at mid depth."""
    depths = {conditions.axial_depth for conditions in fit.conditions}
    if len(depths) > 1:
        return {}
    return offset_of_the_cutter(fit.posterior, float(fit.cutter.helix_lag(depths.pop() / 2)))


def _coefficients(fit: Coefficients) -> dict[str, Any]:
    cuts = [
        {
            "name": name,
            "conditions": keys_of(fit.cutter, conditions),
            "measured_mean_N": _by_axis(fit.measured_mean[i]),
            "modelled_mean_N": _by_axis(fit.modelled_mean[i]),
            "left_out": None if fit.left_out_by_cut is None else _by_axis(fit.left_out_by_cut[i]),
            "phase_deg": None if fit.phase is None else shop(fit.phase[i], "phase_deg"),
        }
        for i, (name, conditions) in enumerate(zip(fit.cuts, fit.conditions, strict=True))
    ]
    return {
        "method": fit.posterior.method,
        "law": fit.posterior.law,
        "coefficients": {**posterior_summary(fit.posterior), **_offset_of_the_cutter(fit)},
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
            {"model": name, "values": dict(shop_value(key, value) for key, value in values)}
            for name, values in fit.alternatives
        ],
        "cuts": cuts,
    }


_SUMMARIES: dict[type, Callable[[Any], dict[str, Any]]] = {
    Recording: _recording,
    CutForce: _cut_force,
    CutSamples: _cut_samples,
    CutVibration: summarise_vibration,
    Frf: _frf,
    Modes: summarise_modes,
    Coefficients: _coefficients,
    CoefficientHistory: summarise_history,
    ForceHarmonics: summarise_forces,
    SpeedAdvice: summarise_advice,
    Judgement: summarise_judgement,
    StabilityMap: summarise_stability,
}
