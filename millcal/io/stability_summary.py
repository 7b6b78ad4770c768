"""What a stability map says to a script: limits with every crossing, best speeds, the operating point, tests beside them.

Crossings are told lowest first at each speed. The first loss of stability carries the 95 % band; a crossing that does not
lose stability is where one multiplier comes back, so that above it there may be an island of stable depths.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from millcal.data import BestSpeed, CutTests, OperatingPoint, SimulatedCuts, StabilityMap
from millcal.io.parameter_summary import known, shop
from millcal.physics.stability.regeneration import KINDS
from millcal.units import to_shop

SAME = 1e-9  # share of a speed: one is another but for rounding
DISAGREE = 0.1  # of the limit: methods that differ by more are told apart


def summarise_stability(found: StabilityMap) -> dict[str, Any]:
    """The JSON `result` of a map."""
    told = {
        "method": found.method,
        "teeth": found.teeth,
        "diameter_mm": shop(found.diameter, "diameter_mm"),
        "radial_depth_mm": shop(found.radial_depth, "radial_depth_mm"),
        "direction": found.direction,
        "feed_per_tooth_mm": shop(found.feed_per_tooth, "feed_per_tooth_mm"),
        "deepest_mm": shop(found.deepest, "deepest_mm"),
        "draws": found.draws,
        "minimum": {
            "ap_mm": shop(found.absolute_minimum, "ap_mm"),
            "chatter_hz": known(found.absolute_minimum_frequency),
            **_speed_of_minimum(found),
        },
        "best": [_best(best) for best in found.best],
        "operating_point": None if found.operating is None else _operating(found.operating),
        "limit": _limits(found),
    }
    if found.probability is not None and found.probability_depth is not None:
        told["probability"] = {
            "rpm": [shop(speed, "x_rpm") for speed in found.spindle_speed],
            "ap_mm": [shop(depth, "ap_mm") for depth in found.probability_depth],
            "p_stable": np.round(found.probability, 4).tolist(),
        }
    if found.tests is not None:
        told["tests"] = _tests(found.tests)
    if found.simulated is not None:
        told["simulated"] = _simulated(found.simulated)
    return told


def _speed_of_minimum(found: StabilityMap) -> dict[str, float]:
    """Where the smallest limit lies; nothing where that is of no one speed, as that of zero order."""
    speed = found.absolute_minimum_speed
    return {"rpm": shop(speed, "x_rpm")} if np.isfinite(speed) else {}


def compared(maps: Sequence[StabilityMap], speeds: Sequence[float]) -> dict[str, Any]:
    """Limits of several methods side by side, and how far each is from the first, each at that very speed.

    maps : of the same cut, the first is what the others are held against   speeds : rad/s, those to show; a map without such
    a speed is left out of its row
    """
    rows = []
    for speed in speeds:
        at = [column_at(found.spindle_speed, speed) for found in maps]
        rows.append(
            {"rpm": shop(speed, "x_rpm")}
            | {
                found.method: {"ap_mm": shop(found.limit_depth[i], "ap_mm"), "kind": kind_name(found.limit_kind[i])}
                for found, i in zip(maps, at, strict=True)
                if i is not None
            }
        )
    return {
        "methods": [found.method for found in maps],
        "against": maps[0].method,
        "limit": rows,
        "difference": [_difference(maps[0], other) for other in maps[1:]],
    }


def _difference(one: StabilityMap, other: StabilityMap) -> dict[str, Any]:
    """How far the first limit of another method is from that of one, at the speeds that both have; deep ones cut off."""
    at = [column_at(one.spindle_speed, speed) for speed in other.spindle_speed]
    own = np.array([i for i in at if i is not None], int)
    others = np.array([j for j, i in enumerate(at) if i is not None], int)
    speeds = one.spindle_speed[own]
    deepest = min(one.deepest, other.deepest)
    limits = [np.minimum(one.limit_depth[own], deepest), np.minimum(other.limit_depth[others], deepest)]
    bounded = np.isfinite(limits[0]) & np.isfinite(limits[1])
    told = {"method": other.method, "speeds": len(speeds), "rpm": None, "ratio": None, "median": None, "beyond": 0}
    if not bounded.any():
        return told
    ratio = limits[1][bounded] / limits[0][bounded]
    worst = int(np.argmax(np.abs(np.log(ratio))))
    return told | {
        "rpm": shop(speeds[bounded][worst], "x_rpm"),  # where they differ the most
        "ratio": known(ratio[worst]),  # there, of the other limit to this one
        "median": known(np.median(np.abs(ratio - 1))),
        "beyond": int(np.count_nonzero(np.abs(ratio - 1) > DISAGREE)),  # speeds
    }


def kind_name(kind: float) -> str | None:
    """How stability is lost, None where it is not."""
    return None if kind < 0 else KINDS[int(kind)]


def column_at(speeds: np.ndarray, speed: float) -> int | None:
    """Which of the speeds of a map is that speed, None where none is: of another the limit may be quite another."""
    nearest = int(np.argmin(np.abs(speeds - speed)))
    return nearest if abs(speeds[nearest] - speed) <= SAME * speed else None


def _limits(found: StabilityMap) -> list[dict[str, Any]]:
    banded = found.limit_low is not None and found.limit_high is not None
    # crossings are of all speeds one behind the other; rounding may have touched the speeds
    at = np.searchsorted((found.spindle_speed[1:] + found.spindle_speed[:-1]) / 2, found.crossing_speed)
    order = np.lexsort((found.crossing_depth, at))
    starts = np.searchsorted(at[order], np.arange(len(found.spindle_speed) + 1))
    told = []
    for i, speed in enumerate(found.spindle_speed):
        crossings = []
        for j in order[starts[i] : starts[i + 1]]:
            crossings.append(
                {
                    "ap_mm": shop(found.crossing_depth[j], "ap_mm"),
                    "kind": kind_name(found.crossing_kind[j]),
                    "chatter_hz": known(found.crossing_frequency[j]),
                    "loses": bool(found.crossing_loses[j]),
                    "lobe": _lobe(found, i, float(found.crossing_depth[j]), float(found.crossing_frequency[j])),
                }
            )
        lost = [crossing for crossing in crossings if crossing["loses"]]
        if banded and lost:
            lost[0]["ap_mm_ci95"] = [shop(bound[i], "ap_mm") for bound in (found.limit_low, found.limit_high)]
        told.append({"rpm": shop(speed, "x_rpm"), "crossings": crossings})
    return told


def _lobe(found: StabilityMap, i: int, depth: float, frequency: float) -> int | None:
    """Whole waves between two teeth; those of the limit the method has counted."""
    if np.isclose(depth, found.limit_depth[i], rtol=1e-9):
        return int(found.lobe[i]) if found.lobe[i] >= 0 else None
    if not np.isfinite(frequency):
        return None
    return int(np.floor(frequency * 2 * np.pi / (found.teeth * found.spindle_speed[i]) + 1e-9))


def _best(best: BestSpeed) -> dict[str, Any]:
    return {
        "rpm": shop(best.spindle_speed, "x_rpm"),
        "ap_mm": shop(best.axial_depth, "ap_mm"),
        "mrr_cm3_per_min": shop(best.removal_rate, "mrr_cm3_per_min"),
        "p_stable": known(best.p_stable),
        "safe_ap_mm": shop(best.safe_depth, "ap_mm"),
        "torque_Nm": known(best.torque),
        "power_W": known(best.power),
        "speed_margin_rpm": None if best.speed_margin is None else known(to_shop(best.speed_margin, "x_rpm")),
    }


def _operating(point: OperatingPoint) -> dict[str, Any]:
    return {
        "rpm": shop(point.spindle_speed, "x_rpm"),
        "ap_mm": shop(point.axial_depth, "ap_mm"),
        "stable": point.stable,
        "p_stable": known(point.p_stable),
        "limit_ap_mm": shop(point.limit, "ap_mm"),
        "limit_ap_mm_ci95": None
        if point.limit_interval is None
        else [shop(bound, "ap_mm") for bound in point.limit_interval],
        "kind": point.kind or None,
        "bound_ap_mm": shop(point.bound, "ap_mm"),
        "chatter_hz": known(point.chatter_frequency),
        "speed_margin_rpm": None
        if point.speed_margin is None
        else [known(to_shop(side, "x_rpm")) for side in point.speed_margin],
        "advice": list(point.advice),
    }


def _tests(tests: CutTests) -> dict[str, Any]:
    """Each cut with what the map says of it, as the stage has found at its own speed; outside the map that is nothing."""
    by_map = np.full(len(tests.stable), np.nan) if tests.stable_by_map is None else tests.stable_by_map
    cuts = []
    for speed, depth, stable, mapped in zip(tests.spindle_speed, tests.axial_depth, tests.stable, by_map, strict=True):
        cuts.append(
            {
                "rpm": shop(speed, "x_rpm"),
                "ap_mm": shop(depth, "ap_mm"),
                "stable": bool(stable),
                "stable_by_map": None if np.isnan(mapped) else bool(mapped),
            }
        )
    on_map = [cut for cut in cuts if cut["stable_by_map"] is not None]
    return {
        "from": tests.name,
        "cuts": cuts,
        "on_map": len(on_map),
        "as_mapped": sum(cut["stable"] == cut["stable_by_map"] for cut in on_map),
    }


def _simulated(cuts: SimulatedCuts) -> dict[str, Any]:
    periods = np.rint(cuts.period)
    return {
        "per": cuts.per,
        "stable": int(np.count_nonzero(periods == 1)),
        "period_n": int(np.count_nonzero(periods > 1)),
        "chatter": int(np.count_nonzero(periods < 1)),
        "cuts": [
            {
                "rpm": shop(speed, "x_rpm"),
                "ap_mm": shop(depth, "ap_mm"),
                "period": int(period) or None,
                "M_um": shop(metric, "M_um"),
            }
            for speed, depth, period, metric in zip(
                cuts.spindle_speed, cuts.axial_depth, cuts.period, cuts.metric, strict=True
            )
        ],
    }
