"""What modes say to a script: those given by hand as they were given, fitted ones with intervals and what they rest on."""

from math import isfinite
from typing import Any

import numpy as np

from millcal.data import ModalFit, Modes
from millcal.units import to_shop


def summarise_modes(modes: Modes) -> dict[str, Any]:
    """The JSON `result` of modes; of a fit also how well it explains the FRF, each FRF as `residual[output][input]`."""
    if modes.fit is None:
        return {"modes": [_by_hand(modes, index) for index in range(len(modes.axes))]}
    fit = modes.fit
    told = {
        "modes": _fitted(modes, fit),
        "form": fit.form,
        "outputs": list(fit.outputs),
        "inputs": list(fit.inputs),
        "band_hz": [_known(end) for end in fit.band],
        "residual_relative": _known(fit.residual_relative),
        "residual": {
            output: {given: _known(fit.residual[o, i]) for i, given in enumerate(fit.inputs)}
            for o, output in enumerate(fit.outputs)
        },
        "interval_from": fit.interval_from,
        "complex_modes": fit.complex_modes,
        "mac": [[_known(value) for value in row] for row in fit.mac],
    }
    return told if fit.delay is None else {**told, **_delays(modes, fit, fit.delay)}


def _known(value: Any) -> float | None:
    return float(value) if isfinite(value) else None


def _bounds(interval: np.ndarray) -> list[float | None] | None:
    """Low and high, None where nothing is known."""
    return [_known(bound) for bound in interval] if np.isfinite(interval).any() else None


def _by_hand(modes: Modes, index: int) -> dict[str, Any]:
    fn, zeta, k = (float(v[index]) for v in (modes.natural_frequency, modes.damping_ratio, modes.stiffness))
    w = 2 * np.pi * fn
    return {
        "axis": modes.axes[index],
        "fn_hz": fn,
        "zeta": zeta,
        "k_N_per_m": k,
        "m_kg": k / w**2,
        "c_Ns_per_m": 2 * zeta * k / w,
    }


def _fitted(modes: Modes, fit: ModalFit) -> list[dict[str, Any]]:
    """Each mode with its constants where the first hammer hits, and at every driving point."""
    points = {dof: _constants(modes, output, given) for dof, (output, given) in fit.driving_points.items()}
    unknown = dict.fromkeys(key for name in ("k_N_per_m", "m_kg", "c_Ns_per_m") for key in (name, f"{name}_ci95"))
    first = points.get(fit.inputs[0].lstrip("+-"), [unknown] * len(modes.axes))
    frequency, damping = modes.interval(modes.frequency_estimate), modes.interval(modes.damping_estimate)
    return [
        {
            "axis": axis,
            "fn_hz": _known(modes.natural_frequency[r]),
            "fn_hz_ci95": _bounds(frequency[r]),
            "zeta": _known(modes.damping_ratio[r]),
            "zeta_ci95": _bounds(damping[r]),
            **first[r],
            "driving": {dof: constants[r] for dof, constants in points.items()},
            "complexity_deg": _known(to_shop(fit.complexity[r], "complexity_deg")),
        }
        for r, axis in enumerate(modes.axes)
    ]


def _constants(modes: Modes, output: int, given: int) -> list[dict[str, Any]]:
    """k, m and c of each mode at one driving point with their intervals; null with a low end where it hardly moves."""
    named = list(zip(("k_N_per_m", "m_kg", "c_Ns_per_m"), modes.driving_constants(output, given), strict=True))
    told: list[dict[str, Any]] = [{} for _ in modes.axes]
    for name, constant in named:
        for entry, value, bounds in zip(told, constant.value, modes.interval_of_constant(constant), strict=True):
            entry[name] = _known(value)
            entry[f"{name}_ci95"] = _bounds(bounds)
    return told


def _delays(modes: Modes, fit: ModalFit, delay: np.ndarray) -> dict[str, Any]:
    """How late each response is behind the hammer; below 0 it would be early."""
    told: dict[str, Any] = {"delay_us": dict(zip(fit.outputs, map(_known, to_shop(delay, "x_us")), strict=True))}
    ends = modes.delay_interval
    if ends is not None:
        told["delay_us_ci95"] = dict(zip(fit.outputs, map(_bounds, to_shop(ends, "x_us")), strict=True))
    return told
