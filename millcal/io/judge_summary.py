"""What a judged cut says: the JSON of it, the line of the cuts log, and the words for a reader."""

import csv
from collections.abc import Sequence
from io import StringIO
from typing import Any

from millcal.data import Judgement
from millcal.io.keys import keys_of
from millcal.io.parameter_summary import known, shop
from millcal.io.text_table import cell, table
from millcal.units import to_shop

LOG = ("rpm", "axial_depth_mm", "radial_depth_mm", "feed_per_tooth_mm", "direction", "stable", "M_um", "chatter_hz")
STABLE = {"stable": "1", "period-n": "0", "chatter": "0", "not known": ""}
BEAT = {"tooth": "tooth", "revolution": "turn"}
PEAKS_SHOWN = 6
SPEEDS_SHOWN = 6
TOLD = ("alias",)  # codes of notes that a reader of the frequency needs beside it


def summarise_judgement(found: Judgement) -> dict[str, Any]:
    """The JSON `result`: the contract's verdict, M_um, period, chatter_hz, and what they rest on."""
    metric = known(found.metric)
    return {
        "name": found.name,
        "verdict": found.verdict,
        "why": found.why,
        "period": found.period,
        "per": found.per,
        "M_um": shop(found.metric, "M_um") if found.quantity == "displacement" else None,
        "chatter_hz": known(found.chatter_frequency),
        "chatter_sd_hz": known(found.chatter_frequency_sd),
        "chatter_share": known(found.chatter_share),
        "channel": found.channel,
        "quantity": found.quantity,
        "metric": {"value": metric, "unit": found.unit, "relative": known(found.metric_relative)},
        "teeth": found.teeth,
        "spindle_speed_rpm": known(60 * found.spindle_frequency),
        "spindle_speed_sd_rpm": known(60 * found.spindle_frequency_sd),
        "tooth_passing_hz": known(found.teeth * found.spindle_frequency),
        "sample_rate_hz": found.sample_rate,
        "steady_s": list(found.steady),
        "revolutions": found.revolutions,
        "stable_rpm": [shop(speed, "x_rpm") for speed in found.stable_speeds],
        "peaks": [
            {
                "frequency_hz": known(peak.frequency),
                "amplitude": {"value": known(peak.amplitude), "unit": found.unit},
                "share": known(peak.share),
                "alias_of_hz": known(peak.alias_of),
            }
            for peak in found.peaks
        ],
        "conditions": keys_of(None, found.conditions),
    }


def cuts_log(found: Sequence[Judgement], depths: Sequence[float | None]) -> str:
    """The cuts as a log that `millcal stability --tests` and `millcal update --cuts` read; not known is blank.

    depths : m, axial, of each cut
    """
    text = StringIO()
    rows = csv.writer(text)
    rows.writerow([*LOG, "recording"])
    for cut, depth in zip(found, depths, strict=True):
        told = summarise_judgement(cut)
        keys = told["conditions"]
        values = {
            "rpm": told["spindle_speed_rpm"],
            "axial_depth_mm": None if depth is None else to_shop(depth, "_mm"),
            **{key: keys.get(key) for key in LOG[2:5]},
            "stable": STABLE[cut.verdict],
            "M_um": told["M_um"],
            "chatter_hz": told["chatter_hz"],
        }
        rows.writerow([*(_cell(values[key]) for key in LOG), cut.name])
    return text.getvalue()


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.7g}" if isinstance(value, float) else str(value)


def judgement_text(found: Judgement) -> str:
    """The verdict with its reason, and the numbers behind it."""
    s = summarise_judgement(found)
    lines = [f"{found.verdict}: {found.why}", ""]
    speed = f"{s['spindle_speed_rpm']:.6g} rpm"
    if s["spindle_speed_sd_rpm"] is not None:
        speed += f" +- {s['spindle_speed_sd_rpm']:.2g}"
    lines.append(
        f"{found.channel} ({found.quantity}), {found.revolutions} revolutions from {found.steady[0]:.4g} to "
        f"{found.steady[1]:.4g} s at {speed}, tooth passing {s['tooth_passing_hz']:.5g} Hz"
    )
    if found.chatter_frequency is not None:
        spread = "" if s["chatter_sd_hz"] is None else f" +- {s['chatter_sd_hz']:.2g}"
        lines.append(
            f"chatter frequency {found.chatter_frequency:.5g}{spread} Hz, {found.chatter_share:.0%} of the power"
        )
    if found.stable_speeds:
        speeds = ", ".join(f"{to_shop(speed, 'x_rpm'):.0f}" for speed in found.speeds_near()[:SPEEDS_SHOWN])
        lines.append(f"speeds it points to, the nearest first: {speeds} rpm")
    lines += [f"note: {notice.message}" for notice in found.notices if notice.code in TOLD and notice.level == "note"]
    unit = "um" if found.quantity == "displacement" else found.unit
    metric = s["M_um"] if found.quantity == "displacement" else s["metric"]["value"]
    lines.append(
        f"M {cell(metric)} {unit} from {BEAT[found.per]} to {BEAT[found.per]}, {s['metric']['relative']:.2f} of the rms"
        if metric is not None and s["metric"]["relative"] is not None
        else "M is not known"
    )
    if found.peaks:
        factor = 1e6 if found.quantity == "displacement" else 1.0
        rows = [(peak.frequency, factor * peak.amplitude, f"{peak.share:.2%}") for peak in found.peaks[:PEAKS_SHOWN]]
        lines += ["", "lines that do not follow the spindle:"]
        lines.append(table(("Hz", f"amplitude {unit}", "of the power"), rows))
    return "\n".join(lines)


def judgements_text(found: Sequence[Judgement], depths: Sequence[float | None]) -> str:
    """Several cuts, a line each.   depths : m, axial, of each cut"""
    rows = []
    for cut, depth in zip(found, depths, strict=True):
        s = summarise_judgement(cut)
        deep = None if depth is None else to_shop(depth, "_mm")
        period = f"{cut.period} turns" if cut.per == "revolution" and (cut.period or 1) > 1 else cut.period
        rows.append((cut.name, f"{s['spindle_speed_rpm']:.0f}", deep, cut.verdict, period, s["M_um"], s["chatter_hz"]))
    header = ("recording", "rpm", "depth mm", "verdict", "period", "M um", "chatter Hz")
    unknown = [f"{cut.name}: {cut.why}" for cut in found if cut.verdict == "not known"]
    more = ["", "not known:", *unknown] if unknown else []
    noted = [cut.name for cut in found if any(n.code in TOLD and n.level == "note" for n in cut.notices)]
    if noted:
        more += ["", f"the chatter frequency may stand for one above half the sample rate: {', '.join(noted)}"]
    return "\n".join([table(header, rows), *more])
