"""What a stability map cannot be drawn of: numbers that are none, and a cut that no cutter makes; and what is doubtful.

Doubtful is a number about a decade beyond what metals and cutters have. A factor of a thousand between two units leaves it.
"""

from math import isfinite

from millcal.data import Notice
from millcal.errors import IllPosedError
from millcal.units import to_shop

NO_CUTTER = 10  # times the diameter: no edge is so long, and the number is in another unit
MOST_POINTS = 100_000  # speeds of a map: no screen shows more, and every one of them is solved
WHOLE = 1e-9  # share by which a radial depth may exceed the diameter in the last digit
CUTTING = (50.0, 20_000.0)  # Ktc, N/mm2: plastics to hardened steel at thin chips
RADIAL = 3.0  # times Ktc: Krc at most
EDGE = (-10.0, 1000.0)  # Kte and Kre, N/mm: a fit may leave them a little below zero
DIAMETERS = (0.02, 1000.0)  # mm
THINNEST = 5e-4  # of the diameter: a radial depth,
SHALLOW = 1e-3  # an axial one or a limit that nobody cuts,
DEEP = 20.0  # nor so many diameters
FINEST_FEED = 2e-4  # mm: chips of 0.2 um are not cut
INDENTATION = (1.0, 1e5)  # of process damping, N/mm
FRICTION = (0.0, 1.5)  # of the flank
RIM = (0.01, 500.0)  # m/s


def refuse_impossible(
    *,
    spindle_speed: tuple[float, float],
    points: int,
    diameter: float,
    radial_depth: float,
    deepest: float | None,
    operating_point: tuple[float, float] | None,
) -> None:
    """Refuse what has no map, with the key that is wrong.

    spindle_speed : rad/s   diameter, radial_depth, deepest : m   operating_point : rad/s, m
    """
    low, high = spindle_speed
    if not (0 < low < high and isfinite(high)):
        raise IllPosedError(
            f"stability.rpm: {spindle_speed} rad/s is no range of spindle speeds; give [lowest, highest]"
        )
    if not 2 <= points <= MOST_POINTS:
        raise IllPosedError(f"stability.points: {points} speeds; a map has 2 to {MOST_POINTS}")
    if not (diameter > 0 and isfinite(diameter)):
        raise IllPosedError(f"cutter.diameter_mm: {to_shop(diameter, '_mm'):g} is no diameter; give one above 0")
    if not radial_depth <= diameter * (1 + WHOLE):
        raise IllPosedError(
            f"stability.radial_depth_mm: {to_shop(radial_depth, '_mm'):g} is more than the diameter, "
            f"{to_shop(diameter, '_mm'):g}; correct one"
        )
    if deepest is not None and not (deepest > 0 and isfinite(deepest)):
        raise IllPosedError(f"stability.deepest_mm: {to_shop(deepest, '_mm'):g} is no depth; leave it out, or give one")
    for key, value in zip(("spindle_speed_rpm", "axial_depth_mm"), operating_point or (), strict=False):
        if not (value > 0 and isfinite(value)):
            raise IllPosedError(f"stability.{key}: {to_shop(value, key):g} is no operating point; give one above 0")
    if operating_point is not None and operating_point[1] > NO_CUTTER * diameter:
        raise IllPosedError(
            f"stability.axial_depth_mm: {to_shop(operating_point[1], '_mm'):g} mm is more than {NO_CUTTER} diameters of the "
            "operating point's cutter (--operating); give the depth in mm"
        )


def doubtful(
    *,
    ktc: float,
    krc: float,
    edge: tuple[float, float] | None,
    spindle_speed: tuple[float, float],
    diameter: float,
    radial_depth: float,
    feed_per_tooth: float | None,
    deepest: float | None,
    indentation: float,
    friction: float,
    operating_point: tuple[float, float] | None,
) -> list[Notice]:
    """What no metal and no cutter has, as numbers in another unit look; each told once, with the unit that is meant.

    ktc, krc : N/m^2   edge : K_te, K_re, N/m   spindle_speed : rad/s   diameter, radial_depth, feed_per_tooth, deepest : m
    indentation : N/m   operating_point : rad/s, m
    """
    said = [
        _outside("coefficients.Ktc", to_shop(ktc, "Ktc_N_per_mm2"), CUTTING, "N/mm2"),
        _outside("cutter.diameter_mm", to_shop(diameter, "_mm"), DIAMETERS, "mm"),
        _outside("stability.radial_depth_mm", to_shop(radial_depth, "_mm"), _mm(THINNEST * diameter, diameter), "mm"),
    ]
    if abs(krc) > RADIAL * ktc:
        said.append(_odd("coefficients.Krc", to_shop(krc, "Krc_N_per_mm2"), "N/mm2", f"{krc / ktc:.3g} times Ktc"))
    elif krc < 0:
        said.append(
            _odd(
                "coefficients.Krc", to_shop(krc, "Krc_N_per_mm2"), "N/mm2", "negative, as if the chip drew the tool in"
            )
        )
    for name, value in zip(("Kte", "Kre"), edge or (), strict=False):
        said.append(_outside(f"coefficients.{name}", to_shop(value, f"{name}_N_per_mm"), EDGE, "N/mm"))
    if feed_per_tooth is not None:
        size = to_shop(feed_per_tooth, "_mm")
        said.append(_outside("stability.feed_per_tooth_mm", size, (FINEST_FEED, _mm(0.0, diameter / 10)[1]), "mm"))
    if deepest is not None:
        said.append(
            _outside("stability.deepest_mm", to_shop(deepest, "_mm"), _mm(SHALLOW * diameter, DEEP * diameter), "mm")
        )
    if operating_point is not None:
        depth = to_shop(operating_point[1], "_mm")
        said.append(_outside("stability.axial_depth_mm", depth, _mm(SHALLOW * diameter, DEEP * diameter), "mm"))
    if indentation:
        said.append(
            _outside("stability.process_damping_N_per_mm", to_shop(indentation, "x_N_per_mm"), INDENTATION, "N/mm")
        )
        said.append(_outside("stability.friction", friction, FRICTION, ""))
    rim = spindle_speed[1] * diameter / 2
    if not RIM[0] <= rim <= RIM[1]:
        value = to_shop(spindle_speed[1], "x_rpm")
        said.append(_odd("stability.rpm", value, "rpm", f"{60 * rim:.3g} m/min at the rim of the cutter"))
    return [notice for notice in said if notice is not None]


def doubtful_limit(lowest: float, diameter: float) -> list[Notice]:
    """A lowest limit that no cutter is run at: dynamics or coefficients in another unit.   lowest, diameter : m"""
    if not isfinite(lowest) or SHALLOW * diameter <= lowest <= DEEP * diameter:
        return []
    size = f"{SHALLOW:g} of" if lowest < diameter else f"{DEEP:g} times"
    what = (
        f"the lowest limit is {to_shop(lowest, '_mm'):.3g} mm, {'below' if lowest < diameter else 'above'} {size} the cutter's "
        "diameter; check the units of the dynamics (receptance m/N, stiffness N/m) and of the coefficients (N/mm2)"
    )
    return [Notice("implausible", what, "stability")]


def _mm(low: float, high: float) -> tuple[float, float]:
    return to_shop(low, "_mm"), to_shop(high, "_mm")


def _outside(where: str, value: float, between: tuple[float, float], unit: str) -> Notice | None:
    low, high = between
    if low * (1 - WHOLE) <= value <= high * (1 + WHOLE):
        return None
    return _odd(where, value, unit, f"outside {low:g} to {high:g}")


def _odd(where: str, value: float, unit: str, why: str) -> Notice:
    what = f"{value:.4g} {unit}".rstrip() + f" is {why}; check the " + ("unit and the sign" if unit else "number")
    return Notice("implausible", what, where)
