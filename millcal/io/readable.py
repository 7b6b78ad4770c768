"""What a result says to a reader: a short table of each record, with the numbers of its JSON."""

from collections.abc import Callable, Iterable, Sequence
from math import isfinite
from typing import Any

import numpy as np

from millcal.data import AXES, Coefficients, CutForce, Frf, Modes, Record, Recording, StabilityMap
from millcal.io.summaries import summarise


def text_of(record: Record) -> str:
    """A short readable table of a record."""
    return _TEXTS[type(record)](record)


def brief_of(record: Record) -> str:
    """The same without what goes hit by hit or speed by speed."""
    return _BRIEFS[type(record)](record)


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Rows under a header, columns two blanks apart; numbers to the right, texts to the left."""
    shown = [[_cell(item) for item in row] for row in rows]
    numeric = [all(_is_number(row[i]) for row in shown) for i in range(len(header))]
    widths = [max([len(name), *(len(row[i]) for row in shown)]) for i, name in enumerate(header)]
    lines = [
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        )
        for line in [list(header), *shown]
    ]
    return "\n".join(line.rstrip() for line in lines)


def _cell(item: Any) -> str:
    """Four digits are enough to read, and all four are shown; a dash is what is not known."""
    if item is None or (isinstance(item, float) and not isfinite(item)):
        return "-"
    if isinstance(item, float):
        return f"{item:.0f}" if abs(item) >= 999.95 or item == 0 else f"{item:#.4g}"
    return str(item)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True


def _recording_text(recording: Recording) -> str:
    s = summarise(recording)
    head = f"{s['name']}: {s['kind']}, {s['samples']} samples at {s['sample_rate_hz']:g} Hz, {s['duration_s']:.4g} s"
    return f"{head}\n" + table(("channel", "quantity", "unit", "dof"), [tuple(c.values()) for c in s["channels"]])


def _cut_force_text(cut: CutForce) -> str:
    s = summarise(cut)
    head = f"{s['name']}: {s['spindle_speed_rpm']:.3f} rpm, {s['revolutions']} whole revolutions"
    keys = ("mean_N", "ac_rms_N", "asynchronous_rms_N", "removed_offset_N", "removed_drift_N_per_s")
    names = ("axis", "mean N", "AC rms N", "asynchronous N", "removed offset N", "drift N/s")
    return f"{head}\n" + table(names, [(axis, *(s[key][axis] for key in keys)) for axis in AXES])


def _frf_text(frf: Frf) -> str:
    if not frf.hits:
        return _frf_brief(frf)
    rows = [
        (
            hit.recording,
            hit.index,
            hit.onset,
            hit.peak,
            "used" if hit.accepted else ", ".join(hit.reasons) or "left out",
        )
        for hit in frf.hits
    ]
    return f"{_frf_brief(frf)}\n" + table(("recording", "hit", "onset s", "peak N", ""), rows)


def _frf_brief(frf: Frf) -> str:
    """Without the hits one by one."""
    s = summarise(frf)
    low, high, lines = s["frequency_hz"]
    head = [
        f"{s['form']} by {s['estimator']}: {' '.join(frf.outputs)} over {' '.join(frf.inputs)}, "
        f"{lines} lines from {low:g} to {high:g} Hz",
        f"usable from {_cell(s['usable_band_hz'][0])} to {_cell(s['usable_band_hz'][1])} Hz, "
        f"median coherence there {_cell(s['coherence_median'])}",
    ]
    if frf.hits:
        head.append(f"{sum(hit.accepted for hit in frf.hits)} of {len(frf.hits)} hits used")
    return "\n".join(head)


def _modes_text(modes: Modes) -> str:
    rows = [tuple(mode.values()) for mode in summarise(modes)["modes"]]
    return table(("axis", "fn Hz", "zeta", "k N/m", "m kg", "c Ns/m"), rows)


def _coefficients_text(fit: Coefficients) -> str:
    s = summarise(fit)
    rows = [(name, c["value"], *c["ci95"], c["unit"]) for name, c in s["coefficients"].items()]
    lines = [
        f"{s['law']} law by {s['method']} from {len(fit.cuts)} cuts",
        table(("", "value", "95 % from", "to", "unit"), rows),
        "",
    ]
    quality = [
        ("R2", "r2"),
        ("residual rms N", "residual_rms_N"),
        ("residual/AC, fitted", "in_sample"),
        ("left out", "left_out"),
    ]
    known = [(name, *s[key].values()) for name, key in quality if s[key] is not None]
    lines += [table(("", *AXES), known), "", f"verdict: {fit.verdict}"]
    lines += [f"  failed: {check.name}: {check.message}" for check in fit.checks if not check.passed]
    return "\n".join(lines)


def _stability_text(found: StabilityMap) -> str:
    s = summarise(found)
    banded = found.limit_low is not None
    rows = []
    for i in _round_speeds(np.array([entry["rpm"] for entry in s["limit"]])):
        entry = s["limit"][i]
        first = entry["crossings"][0] if entry["crossings"] else dict.fromkeys(("ap_mm", "chatter_hz", "lobe"))
        interval = [_interval(first.get("ap_mm_ci95"))] if banded else []
        rows.append((round(entry["rpm"]), first["ap_mm"], *interval, first["chatter_hz"], first["lobe"]))
    head, *rest = _stability_brief(found).splitlines()
    limits = table(("rpm", "limit mm", *(["95 %"] if banded else []), "chatter Hz", "lobe"), rows)
    return "\n".join([head, limits, *rest])


def _stability_brief(found: StabilityMap) -> str:
    """Without the limit speed by speed."""
    s = summarise(found)
    lines = [
        f"{s['method']}, {found.teeth} teeth, {found.direction}, radial depth {s['radial_depth_mm']:.4g} mm: "
        f"stable at any speed below {_cell(s['minimum']['ap_mm'])} mm"
    ]
    if s["best"]:
        lines += _best_speeds(s["best"])
    else:
        lines.append("no pocket between lobes in this range of speeds")
    if s["operating_point"] is not None:
        p = s["operating_point"]
        stable = "" if p["p_stable"] is None else f", stable with probability {p['p_stable']:.3g}"
        limit = f"limit {_cell(p['limit_ap_mm'])} mm"
        if p["limit_ap_mm_ci95"] is not None:
            limit += f" ({_interval(p['limit_ap_mm_ci95'])})"
        lines.append(f"operating point {p['rpm']:.0f} rpm, {p['ap_mm']:.4g} mm: {limit}{stable}")
    return "\n".join(lines)


def _best_speeds(best: Sequence[dict[str, Any]]) -> list[str]:
    """What to cut at each speed and what that removes; with a band the safe depth, else the limit itself."""
    if all(b["safe_ap_mm"] is None for b in best):
        rows = [(round(b["rpm"]), b["ap_mm"], b["mrr_cm3_per_min"]) for b in best]
        return ["best speeds, the most material first, at the limit:", table(("rpm", "limit mm", "cm3/min"), rows)]
    rows = []
    for b in best:
        safe, removal = b["safe_ap_mm"], b["mrr_cm3_per_min"]
        at_safe = None if safe is None or removal is None else removal * safe / b["ap_mm"]
        rows.append((round(b["rpm"]), safe, at_safe, b["ap_mm"], b["p_stable"]))
    head = "best speeds, the most material first (safe: stable with 97.5 %; cm3/min at the safe depth):"
    return [head, table(("rpm", "safe mm", "cm3/min", "limit mm", "p stable at limit"), rows)]


def _round_speeds(rpm: np.ndarray) -> list[int]:
    """Indices of the speeds of a map nearest to round ones, about a dozen of them."""
    span = float(rpm[-1] - rpm[0])
    steps = [mantissa * 10.0**power for power in range(-1, 6) for mantissa in (1, 2, 5)]
    step = next(step for step in steps if span / step <= 14)
    first = int(np.ceil(rpm[0] / step - 1e-9))
    wanted = step * np.arange(first, int(np.floor(rpm[-1] / step + 1e-9)) + 1)
    return list(dict.fromkeys(int(np.argmin(np.abs(rpm - speed))) for speed in wanted))


def _interval(bounds: Sequence[float | None] | None) -> str:
    return "-" if bounds is None else " to ".join(_cell(bound) for bound in bounds)


_TEXTS: dict[type, Callable[[Any], str]] = {
    Recording: _recording_text,
    CutForce: _cut_force_text,
    Frf: _frf_text,
    Modes: _modes_text,
    Coefficients: _coefficients_text,
    StabilityMap: _stability_text,
}

_BRIEFS: dict[type, Callable[[Any], str]] = {**_TEXTS, Frf: _frf_brief, StabilityMap: _stability_brief}
