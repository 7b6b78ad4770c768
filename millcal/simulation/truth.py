"""What a simulation knows, as JSON in the units of the shop."""

from typing import Any

import numpy as np

from millcal.physics.changing_coefficients import Trend, coefficients_at
from millcal.physics.cutter import CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.units import to_shop


def rounded(value: float) -> float:
    """Nine digits: what is left by a change of unit, and by another machine's order of summing."""
    return float(f"{value:.9g}")


def shop_values(**values: float) -> dict[str, float]:
    """SI values in the unit of their key."""
    return {key: rounded(to_shop(value, key)) for key, value in values.items()}


def truth_over_time(law: LinearEdge | Kienzle, trend: Trend, time: np.ndarray) -> dict:
    """The coefficients at these instants in shop units, as the keys of a law name them, and the chips (JSON)."""
    names = (
        ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
        if isinstance(law, LinearEdge)
        else ("kt_N_per_mm2", "kr_N_per_mm2", "ka_N_per_mm2", "mt", "mr", "ma")
    )
    values = np.concatenate(coefficients_at(law, trend, time))
    known: dict = {"time_s": [rounded(t) for t in time]}
    known |= {name: [rounded(to_shop(v, name)) for v in row] for name, row in zip(names, values, strict=True)}
    if trend.chips:
        known["chips"] = [{"time_s": rounded(chip.time), "size": list(chip.size)} for chip in trend.chips]
    return known


def shop_conditions(conditions: CuttingConditions) -> dict[str, Any]:
    """How a cut was made, under the keys of a recipe."""
    values = shop_values(
        spindle_speed_rpm=conditions.spindle_speed,
        feed_per_tooth_mm=conditions.feed_per_tooth,
        axial_depth_mm=conditions.axial_depth,
        radial_depth_mm=conditions.radial_depth,
    )
    return values | {"direction": conditions.direction}
