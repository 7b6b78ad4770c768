"""What forces from accelerations say to a script: harmonics, coefficients, what cannot be told, and who tells it.

Inside, harmonics are one-sided, x(theta) = Re sum_k c_k exp(j k theta). A script gets what `numpy.fft.rfft(x) / n` of one
revolution would give it, half of that, with the amplitudes beside it; the key `convention` says so.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from millcal.data import AXES, CutVibration, ForceHarmonics, SpeedAdvice
from millcal.io.keys import keys_of
from millcal.io.parameter_summary import known, posterior_summary, shop, shop_value

COEFFICIENTS = {"Ktc": "N/mm^2", "Krc": "N/mm^2", "Kac": "N/mm^2", "Kte": "N/mm", "Kre": "N/mm", "Kae": "N/mm"}
CONVENTION = (
    "re, im: two-sided Fourier coefficients X_k = numpy.fft.rfft(x) / n over one revolution, k = spindle_harmonic, "
    "angle 0 where tooth 0 stands at +y; amplitude = 2 |X_k|, sd that of the amplitude"
)
_NORMAL = 1.96  # quantile of 95 %


def summarise_forces(forces: ForceHarmonics) -> dict[str, Any]:
    """The JSON `result` of forces reconstructed from accelerations."""
    sided = {"low": forces.phase - _NORMAL * forces.phase_sd, "high": forces.phase + _NORMAL * forces.phase_sd}
    return {
        "method": forces.method,
        "law": forces.posterior.law,
        "verdict": forces.verdict,
        "coefficients": coefficients_of(forces),
        "unobservable": [name for name in COEFFICIENTS if name not in forces.posterior.names],
        "unobservable_combinations": [list(names) for names in forces.unobservable if len(names) > 1],
        "checks": [{"name": c.name, "passed": c.passed, "message": c.message} for c in forces.checks],
        "chi2": known(forces.chi2),
        "dof": int(forces.dof),
        "condition_number": known(forces.condition_number),
        "regularization": known(forces.regularization),
        "regularization_from": forces.regularization_from or None,
        "bandwidth_hz": [known(end) for end in forces.band],
        "constraint": {
            "rank": int(forces.rank),
            "rows": int(forces.constraint_rows),
            "complex_rows": int(forces.complex_rows),
        },
        "sensors": [
            {"dof": dof, "residual": known(residual), "share": known(share)}
            for dof, residual, share in zip(forces.sensors, forces.sensor_residual, forces.sensor_share, strict=True)
        ],
        "phase_deg": [shop(value, "x_deg") for value in forces.phase],
        "phase_deg_ci95": [
            [shop(low, "x_deg"), shop(high, "x_deg")] if sd > 0 else None
            for low, high, sd in zip(sided["low"], sided["high"], forces.phase_sd, strict=True)
        ],
        "phase_from": forces.phase_from,
        "runout": _runout(forces),
        "frf_from": forces.frf_from,
        "compared": _compared(forces),
        "recommended": forces.recommended,
        "recommended_why": forces.recommended_why,
        "convention": CONVENTION,
        "harmonics": [_line(forces, row) for row in range(len(forces.order))],
        "cuts": [
            {"name": name, "conditions": keys_of(forces.cutter, conditions)}
            for name, conditions in zip(forces.cuts, forces.conditions, strict=True)
        ],
        "advice": None if forces.advice is None else summarise_advice(forces.advice),
    }


def _runout(forces: ForceHarmonics) -> dict[str, Any] | None:
    """c0 and s0 that were fitted, with their intervals; None where they were not."""
    if forces.runout is None or forces.runout_sd is None:
        return None
    told: dict[str, Any] = {}
    for name, value, sd in zip(("c0", "s0"), forces.runout, forces.runout_sd, strict=True):
        told[f"{name}_um"] = shop(value, "x_um")
        told[f"{name}_um_ci95"] = [shop(value - _NORMAL * sd, "x_um"), shop(value + _NORMAL * sd, "x_um")]
    return told


def coefficients_of(forces: ForceHarmonics) -> dict[str, Any]:
    """All six, in the shape of an identification; those that no line shows are null."""
    told = posterior_summary(forces.posterior)
    named = {
        name: {"value": None, "unit": unit, "sd": None, "ci95": [None, None]} for name, unit in COEFFICIENTS.items()
    }
    return {**named, **told}


def amplitudes(forces: ForceHarmonics) -> tuple[np.ndarray, np.ndarray]:
    """Peak amplitude of each line along each axis, and its standard deviation.   returns (line, axis) twice, N

    To first order: that of the part along the harmonic's own phase; of a harmonic that is nothing, the mean of both parts.
    """
    force = forces.force
    axes = force.shape[1]
    amplitude = np.abs(force)
    diagonal = np.einsum("lpp->lp", forces.force_covariance)
    real, imaginary = diagonal[:, :axes], diagonal[:, axes:]
    mixed = np.stack([forces.force_covariance[:, i, axes + i] for i in range(axes)], axis=1)
    there = amplitude > 0
    length = np.where(there, amplitude, 1.0)
    c, s = force.real / length, force.imag / length
    along = np.where(there, c**2 * real + 2 * c * s * mixed + s**2 * imaginary, (real + imaginary) / 2)
    return amplitude, np.sqrt(np.maximum(along, 0.0))


def tooth_harmonic(forces: ForceHarmonics, line: int) -> int | None:
    """Number of a line among the harmonics of the tooth passing, None for one between them."""
    order, teeth = round(float(forces.order[line])), forces.cutter.teeth
    return order // teeth if order % teeth == 0 else None


def summarise_advice(advice: SpeedAdvice) -> dict[str, Any]:
    """What one more cut would tell, against its spindle speed."""
    return {
        "best": [_at_speed(advice, speed) for speed in advice.best],
        "harmonics": int(advice.harmonics),
        "curve": {
            "rpm": [shop(speed, "x_rpm") for speed in advice.spindle_speed],
            "relative_sd": {
                name: [known(value) for value in advice.relative_sd[:, i]] for i, name in enumerate(advice.names)
            },
            "condition_number": [known(value) for value in advice.condition],
            "worst_harmonic": [known(float(value)) for value in advice.worst_harmonic],
        },
    }


def summarise_vibration(cut: CutVibration) -> dict[str, Any]:
    """A conditioned cut that accelerometers heard."""
    noise = np.sqrt(np.maximum(np.einsum("kss->ks", cut.covariance[1:]).real, 0.0)).mean(axis=0)
    return {
        "name": cut.name,
        "conditions": keys_of(cut.cutter, cut.conditions),
        "sample_rate_hz": cut.sample_rate,
        "spindle_speed_rpm": known(60 * cut.spindle_frequency),
        "spindle_speed_sd_rpm": known(60 * cut.spindle_frequency_sd),
        "revolutions": cut.revolutions,
        "steady_s": list(cut.steady),
        "angle_from": cut.angle_from,
        "harmonics": cut.harmonics.shape[1] - 1,
        "ac_rms_m_per_s2": _by_sensor(cut, cut.ac_rms),
        "asynchronous_rms_m_per_s2": _by_sensor(cut, cut.asynchronous_rms),
        "synchronous_share": _by_sensor(cut, cut.synchronous_share),
        "harmonic_noise_m_per_s2": _by_sensor(cut, noise),
        "asynchronous_peaks": [
            {
                "dof": peak.axis,
                "frequency_hz": known(peak.frequency),
                "amplitude_m_per_s2": known(peak.amplitude),
                "exceeds": known(peak.exceeds),
            }
            for peak in cut.peaks
        ],
    }


def _line(forces: ForceHarmonics, line: int) -> dict[str, Any]:
    amplitude, sd = (values[line] for values in amplitudes(forces))
    told: dict[str, Any] = {
        "cut": forces.cuts[int(forces.cut[line])],
        "k": tooth_harmonic(forces, line),
        "spindle_harmonic": round(float(forces.order[line])),
        "frequency_hz": known(forces.frequency[line]),
    }
    at = {axis: i for i, axis in enumerate(forces.axes)}
    for axis in AXES:
        told[f"F{axis}_N"] = told[f"F{axis}_amplitude_N"] = told[f"F{axis}_sd_N"] = None
        if axis in at:
            half = forces.force[line, at[axis]] / 2
            told[f"F{axis}_N"] = [known(half.real), known(half.imag)]
            told[f"F{axis}_amplitude_N"] = known(amplitude[at[axis]])
            told[f"F{axis}_sd_N"] = known(sd[at[axis]])
    return {**told, "condition_number": known(forces.condition[line])}


def _compared(forces: ForceHarmonics) -> dict[str, dict[str, float | None]]:
    """Every method's coefficients, and their standard deviations where it has any."""
    found = {}
    for row, method in enumerate(forces.compared_methods):
        values = {}
        for i, name in enumerate(forces.posterior.names):
            key, value = shop_value(name, forces.compared[row, i])
            values[key] = value
            values[f"{key}_sd"] = shop_value(name, forces.compared_sd[row, i])[1]
        found[method] = values
    return found


def _at_speed(advice: SpeedAdvice, speed: float) -> dict[str, Any]:
    at = int(np.argmin(np.abs(advice.spindle_speed - speed)))
    return {
        "rpm": shop(speed, "x_rpm"),
        "relative_sd": {name: known(advice.relative_sd[at, i]) for i, name in enumerate(advice.names)},
        "condition_number": known(advice.condition[at]),
        "worst_harmonic": known(float(advice.worst_harmonic[at])),
    }


def _by_sensor(cut: CutVibration, values: np.ndarray) -> Mapping[str, float | None]:
    return {dof: known(value) for dof, value in zip(cut.sensors, values, strict=True)}
