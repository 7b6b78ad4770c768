"""What single numbers say to a script: values in shop units, parameters with their intervals, the runout behind c0 and s0."""

from math import isfinite
from typing import Any

import numpy as np

from millcal.data import Posterior
from millcal.units import to_shop

SHOP_UNITS = {  # SI unit of a parameter -> its unit on the shop floor: as the key says it, and as it is written
    "N/m^2": ("N_per_mm2", "N/mm^2"),
    "N/m": ("N_per_mm", "N/mm"),
    "m": ("um", "um"),
    "rad": ("deg", "deg"),
}


def known(value: Any) -> float | None:
    """The number, None where it is not finite."""
    return float(value) if value is not None and isfinite(value) else None


def shop(value: float | None, key: str) -> float | None:
    """An SI value in the unit of the key, None where there is none."""
    return None if value is None else known(to_shop(value, key))


def posterior_summary(posterior: Posterior) -> dict[str, Any]:
    """Each parameter under its contract name: Ktc and mt as they are, the runout with its unit, c0_um."""
    spread = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    told = {}
    for i, (name, si_unit) in enumerate(zip(posterior.names, posterior.units, strict=True)):
        suffix, unit = SHOP_UNITS.get(si_unit, ("", si_unit))
        key = f"x_{suffix}"
        told[f"{name}_{suffix}" if suffix in ("um", "deg") else name] = {
            "value": shop(posterior.mean[i], key),
            "unit": unit,
            "sd": shop(spread[i], key),
            "ci95": [shop(bound, key) for bound in posterior.interval[i]],
        }
    return told


def shop_value(name: str, value: float) -> tuple[str, float | None]:
    """A parameter of another model, its unit in the key: Ktc_N_per_mm2, Kte_N_per_mm, kt_N_per_mm2, c0_um, mt."""
    if name in ("c0", "s0", "t0"):
        return f"{name}_um", shop(value, "x_um")
    if name in ("mt", "mr", "ma"):
        return name, known(value)
    suffix = "N_per_mm" if name in ("Kte", "Kre", "Kae") else "N_per_mm2"
    return f"{name}_{suffix}", shop(value, f"x_{suffix}")


def offset_of_the_cutter(posterior: Posterior, lag: float) -> dict[str, Any]:
    """rho and lambda of a parallel offset from its parts c0 and s0, where both are there and seen.

    Intervals to first order, with the quantile of c0's own; a runout is never below 0, and one that may be 0 has no
    direction.   lag : rad, by how much the edge lags its bottom where c0 and s0 are counted; lambda is counted at the bottom
    """
    names = posterior.names
    if not {"c0", "s0"} <= set(names):
        return {}
    at = [names.index("c0"), names.index("s0")]
    c0, s0 = posterior.mean[at]
    rho = np.hypot(c0, s0)
    if rho == 0:
        return {}
    turn = (np.arctan2(s0, c0) - lag + np.pi) % (2 * np.pi) - np.pi
    slopes = np.array([[c0, s0], [-s0 / rho, c0 / rho]]) / rho
    spread = np.sqrt(np.diag(slopes @ posterior.covariance[np.ix_(at, at)] @ slopes.T))
    own = np.sqrt(posterior.covariance[at[0], at[0]])
    width = np.ptp(posterior.interval[at[0]]) / 2
    quantile = width / own if own > 0 else np.nan
    low, high = rho - quantile * spread[0], rho + quantile * spread[0]
    told = {
        "rho_um": {
            "value": shop(rho, "rho_um"),
            "unit": "um",
            "sd": shop(spread[0], "rho_um"),
            "ci95": [shop(max(low, 0.0), "rho_um"), shop(high, "rho_um")],
        }
    }
    has_direction = not low <= 0
    told["lambda_deg"] = {
        "value": shop(turn, "x_deg") if has_direction else None,
        "unit": "deg",
        "sd": shop(spread[1], "x_deg") if has_direction else None,
        "ci95": [shop(turn + side * quantile * spread[1], "x_deg") if has_direction else None for side in (-1, 1)],
    }
    return told
