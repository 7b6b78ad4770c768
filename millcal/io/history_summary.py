"""What a history of coefficients says to a script: the tool as the record leaves it, how it wore, where it jumped.

The course over time is thinned to some fifty instants; the result file and the table `history_table` hold every step.
"""

from collections.abc import Sequence
from math import exp
from typing import Any

import numpy as np

from millcal.data import AXES, CoefficientHistory, Jump
from millcal.io.keys import keys_of
from millcal.io.parameter_summary import SHOP_UNITS, known, offset_of_the_cutter, posterior_summary, shop

INSTANTS = 50  # of the course over time in the JSON
_NORMAL = 1.96  # quantile of 95 %


def summarise_history(history: CoefficientHistory) -> dict[str, Any]:
    """The JSON `result` of a history; `coefficients` are those at its last step, as of a fit without time."""
    posterior = history.posterior
    um = "x_um"
    last = {
        direction: _estimate(*(v[-1, i] for v in _specific(history)), "x_N_per_mm2")
        for i, direction in enumerate(history.directions)
    }
    return {
        "method": history.method,
        "law": history.law,
        "coefficients": {**posterior_summary(posterior), **offset_of_the_cutter(posterior, 0.0)},
        "verdict": history.verdict,
        "checks": [{"name": c.name, "passed": c.passed, "message": c.message} for c in history.checks],
        "r2": _by_axis(history, history.r2),
        "residual_rms_N": _by_axis(history, history.residual_rms),
        "noise_N": _by_axis(history, history.noise),
        "noise_from": history.noise_from,
        "chi2": known(history.chi2),
        "model": history.model or None,
        "duration_s": known(history.time[-1] - history.time[0]) if len(history.time) else None,
        "steps": len(history.time),
        "reference_chip_um": shop(history.reference_chip, um),
        "chip_range_um": [shop(end, um) for end in history.chip_range],
        "specific_force_end_N_per_mm2": last if len(history.time) else None,
        "slope_percent_per_min": {
            direction: {
                "value": known(100 * history.slope_per_minute[i]),
                "unit": "%/min",
                "ci95": [known(100 * bound[i]) for bound in (history.slope_low, history.slope_high)],
            }
            for i, direction in enumerate(history.directions)
        },
        "jumps": [_jump(history, jump) for jump in history.jumps],
        "history": _course(history),
        "cuts": [
            {"name": name, "conditions": keys_of(history.cutter, conditions)}
            for name, conditions in zip(history.cuts, history.conditions, strict=True)
        ],
    }


def percent_of(change: float) -> float:
    """A change of ln(specific force) as one of the force itself, in per cent."""
    return 100 * (exp(change) - 1) if np.isfinite(change) and change < 300 else np.nan


def thinned(steps: int, most: int = INSTANTS) -> np.ndarray:
    """Steps that stand for all of them, the first and the last among them.   returns (index,) ascending"""
    return np.unique(np.linspace(0, steps - 1, min(steps, most)).round().astype(int)) if steps else np.arange(0)


def _specific(history: CoefficientHistory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return history.specific_force, history.specific_low, history.specific_high


def _estimate(value: float, low: float, high: float, key: str) -> dict[str, Any]:
    return {"value": shop(value, key), "unit": "N/mm^2", "ci95": [shop(low, key), shop(high, key)]}


def _jump(history: CoefficientHistory, jump: Jump) -> dict[str, Any]:
    """Of the specific force in each direction, with an interval."""
    pairs = zip(history.directions, jump.change, jump.sd, strict=True)
    return {
        "time_s": known(jump.time),
        "change_percent": {
            direction: {
                "value": known(percent_of(change)),
                "unit": "%",
                "ci95": [known(percent_of(change + side * _NORMAL * sd)) for side in (-1, 1)],
            }
            for direction, change, sd in pairs
        },
        "log_bayes_factor": known(jump.log_bayes_factor),
    }


def _by_axis(history: CoefficientHistory, values: np.ndarray) -> dict[str, float | None]:
    """Of x, y and z, None for an axis that was not measured."""
    found = dict(zip(history.axes, values, strict=True))
    return {axis: known(found.get(axis)) for axis in AXES}


def _course(history: CoefficientHistory) -> dict[str, Any]:
    """Thinned over time: every coefficient and specific force with its band, and what the filter did not foresee."""
    at = thinned(len(history.time))
    told: dict[str, Any] = {
        "time_s": [known(value) for value in history.time[at]],
        "cut": [int(value) for value in history.cut[at]],
    }
    for i, (name, si_unit) in enumerate(zip(history.names, history.units, strict=True)):
        suffix = SHOP_UNITS.get(si_unit, ("",))[0]
        key = f"{name}_{suffix}" if suffix else name
        told[key] = _shop(history.value[at, i], f"x_{suffix}")
        told[f"{key}_ci95"] = _bands(history.low[at, i], history.high[at, i], f"x_{suffix}")
    value, low, high = (v[at] for v in _specific(history))
    unit, directions = "N_per_mm2", list(enumerate(history.directions))
    told[f"specific_force_{unit}"] = {d: _shop(value[:, i], f"x_{unit}") for i, d in directions}
    told[f"specific_force_{unit}_ci95"] = {d: _bands(low[:, i], high[:, i], f"x_{unit}") for i, d in directions}
    axes = list(enumerate(history.axes))
    told["innovation_mean"] = {axis: [known(v) for v in history.innovation_mean[at, i]] for i, axis in axes}
    told["innovation_square"] = {axis: [known(v) for v in history.innovation_square[at, i]] for i, axis in axes}
    return told


def _shop(values: Sequence[float] | np.ndarray, key: str) -> list[float | None]:
    return [shop(value, key) for value in values]


def _bands(low: np.ndarray, high: np.ndarray, key: str) -> list[list[float | None]]:
    return [[shop(a, key), shop(b, key)] for a, b in zip(low, high, strict=True)]
