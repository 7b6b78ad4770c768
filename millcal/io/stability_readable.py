"""What a stability map says to a reader: limits at round speeds, best speeds, the operating point and what to do about it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np

from millcal.data import StabilityMap
from millcal.io.stability_summary import compared, summarise_stability
from millcal.io.text_table import cell, interval, table
from millcal.physics.cutter import CuttingConditions, engagement

ROUND_SPEEDS = 14  # shown at most
SHORT = 0.5  # teeth in the cut on average: fewer, and one that is thrown out is missed
MOST_MISSED = 5  # test cuts told one by one
MOST_PERIODS = 3  # of more than one tooth


def stability_text(found: StabilityMap) -> str:
    """With the limits at round speeds."""
    s = summarise_stability(found)
    banded = found.limit_low is not None
    rows = []
    for i in round_speeds(np.array([entry["rpm"] for entry in s["limit"]])):
        entry = s["limit"][i]
        first = next((c for c in entry["crossings"] if c["loses"]), {})
        band = [interval(first.get("ap_mm_ci95"))] if banded else []
        rows.append(
            (round(entry["rpm"]), first.get("ap_mm"), *band, first.get("kind"), first.get("chatter_hz"),
             first.get("lobe"), _islands(entry["crossings"]))
        )  # fmt: skip
    header = ["rpm", "limit mm", *(["95 %"] if banded else []), "lost by", "chatter Hz", "lobe", "stable again mm"]
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    head, *rest = _brief(found, s)
    return "\n".join([head, table(header, rows), *rest])


def stability_brief(found: StabilityMap) -> str:
    """Without the limit speed by speed."""
    return "\n".join(_brief(found, summarise_stability(found)))


def compared_text(maps: Sequence[StabilityMap]) -> str:
    """Methods side by side at the round speeds of the coarsest map, and where they disagree.

    maps : the first is what others are held against
    """
    fewest = min((found.spindle_speed for found in maps), key=len)
    rpm = fewest * 60 / (2 * np.pi)
    s = compared(maps, fewest if len(fewest) <= ROUND_SPEEDS else [fewest[i] for i in round_speeds(rpm)])
    rows = []
    for entry in s["limit"]:
        shown = []
        for name in s["methods"]:
            if name not in entry:  # not solved at this speed
                shown.append("")
                continue
            kind = entry[name]["kind"]
            shown.append(cell(entry[name]["ap_mm"]) + ("" if kind in (None, "hopf") else f" {kind}"))
        rows.append((round(entry["rpm"]), *shown))
    lines = ["methods side by side, first limit in mm:", table(("rpm", *s["methods"]), rows)]
    for other in s["difference"]:
        if other["ratio"] is None:
            lines.append(f"{other['method']}: no speed at which both it and {s['against']} have a limit")
            continue
        lines.append(
            f"{other['method']} against {s['against']}: median difference {100 * other['median']:.2g} %, more than 10 % at "
            f"{other['beyond']} of {other['speeds']} speeds, most at {other['rpm']:.0f} rpm: {_times(other['ratio'])}"
        )
    return "\n".join(lines)


def round_speeds(rpm: np.ndarray) -> list[int]:
    """Indices of the speeds of a map nearest to round ones, about a dozen of them."""
    span = float(rpm[-1] - rpm[0])
    steps = [mantissa * 10.0**power for power in range(-6, 16) for mantissa in (1, 2, 5)]
    step = next(step for step in steps if span / step <= ROUND_SPEEDS)
    first = int(np.ceil(rpm[0] / step - 1e-9))
    wanted = step * np.arange(first, int(np.floor(rpm[-1] / step + 1e-9)) + 1)
    return list(dict.fromkeys(int(np.argmin(np.abs(rpm - speed))) for speed in wanted))


def _brief(found: StabilityMap, s: Mapping[str, Any]) -> list[str]:
    everywhere = "stable at any speed below" if found.method == "zoa" else "at these speeds stable below"
    lowest = s["minimum"]["ap_mm"]
    lines = [
        f"{s['method']}, {_count(found.teeth, 'tooth', 'teeth')}, {found.direction}, radial depth "
        f"{s['radial_depth_mm']:.4g} mm: "
        + ("at these speeds no limit was found" if lowest is None else f"{everywhere} {cell(lowest)} mm")
    ]
    if s["deepest_mm"] is not None and lowest is not None and lowest > s["deepest_mm"]:  # zoa knows it for every speed
        lines[0] += f"; the map goes down to {cell(s['deepest_mm'])} mm, where there is no limit yet"
    elif s["deepest_mm"] is not None:
        lines[0] += f", looked for down to {cell(s['deepest_mm'])} mm"
    if s["best"]:
        lines += _best_speeds(s["best"], s["draws"])
        if _leaves(found):
            lines.append(
                "limits are those of small vibrations: where a knock throws a tooth out of so short a cut, it may chatter before "
                "them (--method time-domain, --simulate-points)"
            )
    elif lowest is None:
        lines.append("no speed is better than another without a limit; look deeper (--deepest-mm) for the best speeds")
    else:
        lines.append("no pocket between lobes in this range of speeds")
    if s["operating_point"] is not None:
        lines += _operating(s["operating_point"], [s["limit"][i]["rpm"] for i in (0, -1)], s["draws"])
    if "tests" in s:
        lines += _tests(s["tests"])
    if "simulated" in s:
        lines += _simulated(s["simulated"])
    return lines


def _leaves(found: StabilityMap) -> bool:
    """Whether less than half a tooth is in the cut on average, and the method keeps it there."""
    cut = CuttingConditions(float(found.spindle_speed[0]), 0.0, 1.0, found.radial_depth, found.direction)
    entry, leave = engagement(cut, found.diameter)
    return found.method != "time-domain" and found.teeth * (leave - entry) / (2 * np.pi) < SHORT


def _islands(crossings: Sequence[Mapping[str, Any]]) -> str | None:
    """Depths above the first limit that are stable again: `2.100 to 2.600`."""
    outside, since, found = 0, None, []
    for crossing in crossings:
        before = outside
        outside += (2 if crossing["kind"] == "hopf" else 1) * (1 if crossing["loses"] else -1)
        if before > 0 >= outside:
            since = crossing["ap_mm"]
        elif since is not None and before <= 0 < outside:
            found.append(interval([since, crossing["ap_mm"]]))
            since = None
    if since is not None:
        found.append(f"above {cell(since)}")
    return ", ".join(found) or None


def _best_speeds(best: Sequence[Mapping[str, Any]], draws: int | None) -> list[str]:
    """What to cut at each speed and what that removes; with a band the safe depth, else the limit itself."""
    safe = not all(b["safe_ap_mm"] is None for b in best)
    powered = not all(b["power_W"] is None for b in best)
    spread = [] if all(b["speed_margin_rpm"] is None for b in best) else ["+- rpm"]
    header = ["rpm", *spread]
    header += ["safe mm", "cm3/min", "limit mm", "p stable at limit"] if safe else ["limit mm", "cm3/min"]
    rows = []
    for b in best:
        removal = b["mrr_cm3_per_min"]
        if safe:
            at_safe = None if b["safe_ap_mm"] is None or removal is None else removal * b["safe_ap_mm"] / b["ap_mm"]
            row = [b["safe_ap_mm"], at_safe, b["ap_mm"], _chance(b["p_stable"], draws)]
        else:
            row = [b["ap_mm"], removal]
        margin = [None if b["speed_margin_rpm"] is None else round(b["speed_margin_rpm"])] if spread else []
        rows.append((round(b["rpm"]), *margin, *row, *([b["torque_Nm"], b["power_W"]] if powered else [])))
    if safe:
        what = "cm3/min, N m and W" if powered else "cm3/min"
        head = f"best speeds, the most material first (safe: stable with 97.5 %; {what} at the safe depth):"
    else:
        head = "best speeds, the most material first, at the limit:"
    head = head[:-1] + "; depths are the least within 0.5 % of the speed:"
    if spread:
        head = head[:-1] + "; +- rpm: so far off nine tenths of that depth still hold:"
    return [head, table((*header, *(["N m", "W"] if powered else [])), rows)]


def _chance(p: float | None, draws: int | None) -> str | None:
    """A share of so many draws, with no more said than they bear: none of n is still any chance below 3 / n, by 95 %."""
    if p is None:
        return None
    least = min(ceil(3000 / draws) / 1000, 0.5) if draws else 0.0
    if p < least:
        return f"below {least:g}"
    return f"above {1 - least:g}" if p > 1 - least else f"{p:.2f}"


def _operating(p: Mapping[str, Any], ends: Sequence[float], draws: int | None) -> list[str]:
    """ends : the lowest and the highest speed of the map, rpm; a margin that reaches them may be wider"""
    bound = "no limit found" if p["limit_ap_mm"] is None else f"limit {cell(p['limit_ap_mm'])} mm"
    if p["limit_ap_mm_ci95"] is not None and p["limit_ap_mm"] is not None:
        bound += f" ({interval(p['limit_ap_mm_ci95'])})"
    chance = "" if p["p_stable"] is None else f", stable with probability {_chance(p['p_stable'], draws)}"
    lines = [f"operating point {p['rpm']:.0f} rpm, {p['ap_mm']:.4g} mm: {bound}{chance}"]
    by = "" if p["kind"] is None else f" by {p['kind']}"
    at = "" if p["chatter_hz"] is None else f" about {p['chatter_hz']:.0f} Hz"
    above = p["bound_ap_mm"]
    if not p["stable"]:
        lines.append(f"  chatters{by}{at}")
    elif above is not None and p["limit_ap_mm"] is not None and p["ap_mm"] > p["limit_ap_mm"]:
        lines.append(f"  stable on an island, which ends at {cell(above)} mm{by}{at}")
    else:
        lines.append(f"  stable; the limit is lost{by}{at}" if by or at else "  stable")
    if p["speed_margin_rpm"] is not None and p["stable"]:
        sides = [
            f"{way} by {side:.0f}" + (" or more" if side > abs(end - p["rpm"]) - 0.5 else "") + " rpm"
            for way, side, end in zip(("fall", "rise"), p["speed_margin_rpm"], ends, strict=True)
            if side is not None and abs(end - p["rpm"]) >= 0.5  # at the end of the map nothing is known of that way
        ]
        lines += [f"  before this depth chatters the speed may {' and '.join(sides)}"] if sides else []
    return lines + [f"  - {what}" for what in p["advice"]]


def _tests(s: Mapping[str, Any]) -> list[str]:
    if not s["cuts"]:
        return []
    of = f" of {s['from']}" if s["from"] else ""
    lines = [f"test cuts{of}: {s['as_mapped']} of {s['on_map']} came out as the map says"]
    missed = [cut for cut in s["cuts"] if cut["stable_by_map"] not in (None, cut["stable"])]
    for cut in missed[:MOST_MISSED]:
        was, says = ("stable" if stable else "chatter" for stable in (cut["stable"], cut["stable_by_map"]))
        lines.append(f"  {cut['rpm']:.0f} rpm, {cut['ap_mm']:.4g} mm: {was}, and the map says {says}")
    if len(missed) > MOST_MISSED:
        lines.append(f"  and {len(missed) - MOST_MISSED} more")
    outside = len(s["cuts"]) - s["on_map"]
    return lines + ([f"  {outside} {'lies' if outside == 1 else 'lie'} outside the map"] if outside else [])


def _simulated(s: Mapping[str, Any]) -> list[str]:
    periods = Counter(cut["period"] for cut in s["cuts"])
    told = [f"{periods[1]} repeat every {s['per']}"]
    named = sorted(n for n in periods if n and n > 1)[:MOST_PERIODS]
    told += [f"{periods[n]} every {n} {_plural(s['per'])}" for n in named]
    more = s["period_n"] - sum(periods[n] for n in named)
    told += [f"{more} after more"] if more else []
    told += [f"{periods[None]} never: chatter"] if periods[None] else []
    where = []
    for key, unit in (("rpm", "rpm"), ("ap_mm", "mm")):
        values = {cut[key] for cut in s["cuts"]}
        low, high = (f"{end:.0f}" if unit == "rpm" else f"{end:.3g}" for end in (min(values), max(values)))
        where.append(f"{low} {unit}" if low == high else f"{low} to {high} {unit}")
    return [f"simulated cuts: {len(s['cuts'])} at {', '.join(where)}; {', '.join(told)}"]


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _plural(per: str) -> str:
    return "teeth" if per == "tooth" else f"{per}s"


def _times(ratio: float) -> str:
    if f"{ratio:.2f}" == "1.00":
        return "as deep"
    return f"{ratio:.3g} times as deep" if ratio >= 1 else f"{1 / ratio:.3g} times less deep"
