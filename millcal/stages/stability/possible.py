"""What a stability map cannot be drawn of: numbers that are none, and a cut that no cutter makes."""

from math import isfinite

from millcal.errors import IllPosedError
from millcal.units import to_shop

MOST_POINTS = 100_000  # speeds of a map: no screen shows more, and every one of them is solved
WHOLE = 1e-9  # share by which a radial depth may exceed the diameter in the last digit


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
