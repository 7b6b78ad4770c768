"""The tables of a stability map: what it was made for, its limits, the best speeds, the methods side by side."""

from collections.abc import Sequence
from math import inf

import numpy as np

from millcal.data import StabilityMap
from millcal.report.digits import UNKNOWN, fixed, nice_ticks, nominal, rounded_down, significant
from millcal.report.stability_regions import KINDS, Stretch, stable_stretches
from millcal.report.stability_wording import METHODS, SHORT
from millcal.report.tables import Table
from millcal.report.wording import percent
from millcal.units import to_shop

ROUND_SPEEDS = 16  # of the table of limits, at most about


def _rpm(speed: float) -> float:
    return to_shop(speed, "spindle_speed_rpm")


def _removal(rate: float) -> str:
    return significant(to_shop(rate, "removal_rate_cm3_per_min"))


def map_facts(map_: StabilityMap) -> list[tuple[str, str]]:
    """What the map was made for, as pairs of what and how much."""
    width = "slot" if map_.direction == "slot" else f"{nominal(map_.radial_depth * 1e3)} mm, {map_.direction} milling"
    smallest = "none found" if map_.absolute_minimum == inf else f"{significant(map_.absolute_minimum * 1e3)} mm"
    if np.isfinite(map_.absolute_minimum_speed):
        smallest += f" at {fixed(_rpm(map_.absolute_minimum_speed), 0)} rpm"
    if np.isfinite(map_.absolute_minimum_frequency):
        smallest += f", chatter at {significant(map_.absolute_minimum_frequency, 4)} Hz"
    facts = [
        ("method", METHODS.get(map_.method, map_.method)),
        ("cutter", f"D {nominal(map_.diameter * 1e3)} mm, {map_.teeth} teeth"),
        ("radial depth", width),
        ("smallest limit", smallest),
    ]
    if (point := map_.operating) is not None:
        speed, depth = point.spindle_speed, point.axial_depth
        share = "" if point.p_stable is None else f", stable with {percent(point.p_stable)}"
        facts.append(("operating point", f"{fixed(_rpm(speed), 0)} rpm, {nominal(depth * 1e3)} mm{share}"))
    if map_.tests is not None and len(map_.tests.stable):
        stable = int(np.count_nonzero(map_.tests.stable > 0))
        facts.append(("cuts made", f"{stable} stable, {len(map_.tests.stable) - stable} chatter"))
    return facts


def best_speeds(map_: StabilityMap) -> Table | None:
    """The speeds worth running, best first: what to cut there, what that removes and asks of the spindle, and the limit."""
    banded = any(best.safe_depth is not None for best in map_.best)
    near = any(best.speed_margin is not None for best in map_.best)
    drive = any(best.torque is not None or best.power is not None for best in map_.best)
    rows = []
    for number, best in enumerate(map_.best, 1):
        limit = fixed(best.axial_depth * 1e3, 2)
        row = [str(number), fixed(_rpm(best.spindle_speed), 0), *([_margin(best.speed_margin)] if near else [])]
        asked = (
            [significant(best.torque), significant(None if best.power is None else best.power * 1e-3)] if drive else []
        )
        if not banded:
            rows.append([*row, limit, _removal(best.removal_rate), *asked])
        elif best.safe_depth is None:
            rows.append([*row, UNKNOWN, UNKNOWN, *asked, limit])
        else:
            share = best.safe_depth / best.axial_depth
            rows.append(
                [*row, rounded_down(best.safe_depth * 1e3, 2), _removal(share * best.removal_rate), *asked, limit]
            )
    asked = ["torque, N m", "power, kW"] if drive else []
    margin = ["± rpm"] if near else []
    if banded:
        headings = ("", "speed, rpm", *margin, "safe a_p, mm", "removal rate, cm³/min", *asked, "limit a_p, mm")
        note = (
            "Safe: stable with 97.5 %, as far as coefficients and FRF go; the removal rate is that of the safe depth. At "
            "the limit itself the cut is as likely to chatter as not."
        )
    else:
        headings = ("", "speed, rpm", *margin, "limit a_p, mm", "removal rate, cm³/min", *asked)
        note = (
            "No band is known, so no safe depth: the removal rate is that at the limit, and a cut has to stay below it."
        )
    if drive:
        note += f" Torque and power are means over a revolution at the {'safe depth' if banded else 'limit'}."
    note += " Depths are the least within 0.5 % of the speed."
    if near:
        note += f" ± rpm: so far off, either way, nine tenths of the {'safe depth' if banded else 'limit'} still hold."
    return Table("Best speeds", headings, rows, note=note) if rows else None


def _margin(margin: float | None) -> str:
    """How far a speed may be off, in whole rpm."""
    if margin is None or np.isnan(margin):
        return UNKNOWN
    rpm = _rpm(margin)
    return "below 1" if rpm < 1 else fixed(rpm, 0)


def round_columns(map_: StabilityMap) -> list[int]:
    """Columns of the map nearest to round speeds."""
    rpm = to_shop(map_.spindle_speed, "spindle_speed_rpm")
    wanted = nice_ticks(float(rpm[0]), float(rpm[-1]), ROUND_SPEEDS)
    return list(dict.fromkeys(int(np.argmin(np.abs(rpm - speed))) for speed in wanted))


def limits(map_: StabilityMap) -> Table | None:
    """The limit at the speeds of the map nearest to round ones, how stability is lost there, and where it comes back."""
    chosen = round_columns(map_)
    stretches = stable_stretches(map_)
    banded = map_.limit_low is not None and map_.limit_high is not None
    rows = []
    for i in chosen:
        kind = int(map_.limit_kind[i])
        row = [fixed(_rpm(map_.spindle_speed[i]), 0), _depth(map_, map_.limit_depth[i])]
        if map_.limit_low is not None and map_.limit_high is not None:
            low, high = (_depth(map_, bound[i]) for bound in (map_.limit_low, map_.limit_high))
            row.append(low if low == high else f"{low} to {high}")
        row += [
            KINDS[kind] if 0 <= kind < len(KINDS) else UNKNOWN,
            significant(map_.chatter_frequency[i], 4),
            fixed(map_.lobe[i], 0) if map_.lobe[i] >= 0 else UNKNOWN,
            _again(stretches[i]),
        ]
        rows.append(row)
    headings = ["speed, rpm", "limit a_p, mm", *(["95 % band, mm"] if banded else [])]
    headings += ["kind", "chatter, Hz", "lobe", "stable again, mm"]
    words = [len(headings) - 4, len(headings) - 1]
    if all(row[-1] == UNKNOWN for row in rows):
        rows, headings, words = [row[:-1] for row in rows], headings[:-1], words[:1]
    note = "Hopf: chatter between the tooth passings. Flip: every second tooth cuts alike, at half the tooth passing."
    note = note if any("flip" in row for row in rows) else ""
    return Table("Limits at speeds of the map", headings, rows, words=words, note=note) if rows else None


def _depth(map_: StabilityMap, depth: float) -> str:
    """A limit in mm; where there is none, how deep was looked."""
    return f"> {nominal(map_.deepest * 1e3)}" if depth == inf and np.isfinite(map_.deepest) else fixed(depth * 1e3, 2)


def _again(stretches: Sequence[Stretch]) -> str:
    """Where it is stable beyond the limit."""
    told = [
        f"above {fixed(s.low * 1e3, 2)}" if s.high == inf else f"{fixed(s.low * 1e3, 2)} to {fixed(s.high * 1e3, 2)}"
        for s in stretches[1:]
    ]
    return ", ".join(told) or UNKNOWN


def methods_compared(maps: Sequence[StabilityMap]) -> Table | None:
    """The first limit by every method at speeds of the first map, each from the column of its own map that lies nearest."""
    if len(maps) < 2:
        return None
    rows = []
    for i in round_columns(maps[0]):
        speed = float(maps[0].spindle_speed[i])
        row = [fixed(_rpm(speed), 0)]
        for map_ in maps:
            k = int(np.argmin(np.abs(map_.spindle_speed - speed)))
            off = abs(map_.spindle_speed[k] - speed)
            row.append(_depth(map_, map_.limit_depth[k]) if off <= 0.005 * speed else UNKNOWN)
        rows.append(row)
    headings = ("speed, rpm", *(SHORT.get(map_.method, map_.method) for map_ in maps))
    groups = (("", 1), ("first loss of stability, a_p, mm", len(maps)))
    return Table("The methods side by side", headings, rows, groups=groups)
