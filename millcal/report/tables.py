"""The tables of the report: what was measured, how good it is, the coefficients, the best speeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from millcal.data import (
    AXES,
    CoefficientHistory,
    Coefficients,
    CutForce,
    CutVibration,
    ForceHarmonics,
    Frf,
    Posterior,
)
from millcal.report.axes import axes_measured, mean_is_known
from millcal.report.digits import UNKNOWN, decimals_for, fixed, nominal, significant, with_interval
from millcal.report.wording import channels_in_words, cut_names, parameter, short_names
from millcal.units import to_shop

MOST_PEAKS = 12  # lines of the spectrum that are listed
LINEAR_EDGE = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
SHADES = 9  # of cells that show a number by their colour too


@dataclass(frozen=True)
class Table:
    """Rows of text under headings; `groups` spans headings, `words` names the columns that hold words, not numbers.

    `levels` shades the cells, 0 to SHADES - 1 or none, in the colour of agreement or of doubt.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    groups: Sequence[tuple[str, int]] = ()
    words: Sequence[int] = (0,)
    note: str = ""
    levels: Sequence[Sequence[int | None]] = ()  # (row, column)
    shade: Literal["agree", "doubt"] = "agree"


def _rpm(speed: float) -> float:
    return to_shop(speed, "spindle_speed_rpm")


def conditions(
    cuts: Sequence[CutForce | CutVibration], fit: Coefficients | CoefficientHistory | ForceHarmonics | None
) -> Table | None:
    """The conditions of each cut."""
    if cuts:
        named = [(cut.name, cut.conditions, cut.cutter.teeth) for cut in cuts]
    elif fit is not None:
        named = [(name, c, fit.cutter.teeth) for name, c in zip(fit.cuts, fit.conditions, strict=True)]
    else:
        return None
    short = cut_names(name for name, _, _ in named)
    rows = [
        [
            short[name],
            fixed(_rpm(c.spindle_speed), 0),
            nominal(c.feed_per_tooth * 1e3),
            fixed(_rpm(c.spindle_speed) * teeth * c.feed_per_tooth * 1e3, 0),
            nominal(c.axial_depth * 1e3),
            nominal(c.radial_depth * 1e3),
            c.direction,
        ]
        for name, c, teeth in named
    ]
    headings = ("cut", "speed, rpm", "f_z, mm", "feed, mm/min", "a_p, mm", "a_e, mm", "direction")
    return Table("Cuts", headings, rows, words=(0, 6))


def recordings(summary: Mapping[str, Any], provenance: Mapping[str, Any]) -> Table | None:
    """The files that were read: rate, duration, sensors, and the first digits of their sha256."""
    inputs: dict[str, str] = dict(provenance.get("inputs") or {})
    entries = list(summary.get("recordings") or ())
    paths = [str(entry.get("path") or entry.get("name") or "") for entry in entries]
    short = short_names([*paths, *inputs])
    rows = [
        [
            short[path],
            str(entry.get("kind") or ""),
            nominal(entry.get("sample_rate_hz")),
            significant(entry.get("duration_s"), 4),
            channels_in_words(entry.get("channels") or ()),
            (inputs.pop(path, None) or entry.get("sha256") or "")[:12],
        ]
        for path, entry in zip(paths, entries, strict=True)
    ]
    rows += [[short[path], "", UNKNOWN, UNKNOWN, "", digest[:12]] for path, digest in inputs.items()]
    if not rows:
        return None
    headings = ["file", "kind", "rate, Hz", "duration, s", "channels", "sha256"]
    words = [0, 1, 4, 5]
    empty = [column for column in (1, 2, 3, 4) if all(row[column] in ("", UNKNOWN) for row in rows)]
    kept = [column for column in range(6) if column not in empty]
    rows = [[row[column] for column in kept] for row in rows]
    return Table("Recordings", [headings[c] for c in kept], rows, words=[kept.index(c) for c in words if c in kept])


def synchronous(cuts: Sequence[CutForce]) -> Table:
    """How well each cut follows the spindle."""
    short = cut_names(cut.name for cut in cuts)
    rows = []
    for cut in cuts:
        decimals = decimals_for(60 * cut.spindle_frequency_sd, 60 * cut.spindle_frequency)
        duration = cut.steady[1] - cut.steady[0]
        rows.append(
            [
                short[cut.name],
                fixed(60 * cut.spindle_frequency, min(decimals, 3)),
                str(cut.revolutions),
                fixed(duration, 2),
                nominal(cut.sample_rate),
                *(fixed(100 * float(share), 2) for share in cut.synchronous_share),
                *(significant(float(rms)) for rms in cut.asynchronous_rms),
            ]
        )
    return Table(
        "Does the force follow the spindle?",
        ("cut", "refined, rpm", "revolutions", "steady, s", "rate, Hz", *AXES, *AXES),
        rows,
        groups=(("", 5), ("share of the AC power, %", 3), ("rest, N rms", 3)),
        note="The rest is what no harmonic of the spindle explains: chatter, drift, other machines, noise.",
    )


def removed(cuts: Sequence[CutForce]) -> Table:
    """What conditioning took away from each cut."""
    short = cut_names(cut.name for cut in cuts)
    rows = [
        [
            short[cut.name],
            f"{fixed(sum(stop - start for start, stop in cut.air), 2)} s" if cut.air else "none",
            *(fixed(float(value), 2) for value in cut.removed_offset),
            *(fixed(float(value), 2) for value in cut.removed_drift),
            f"{nominal(cut.lowpass)} Hz" if cut.lowpass else "none",
            "pulse" if cut.phase_from_pulse else "fitted",
        ]
        for cut in cuts
    ]
    without = any(not cut.air for cut in cuts)
    return Table(
        "What was removed before the fit",
        ("cut", "air cut", *AXES, *AXES, "low-pass", "tooth phase"),
        rows,
        groups=(("", 2), ("offset, N", 3), ("drift, N/s", 3), ("", 2)),
        words=(0, 1, 8, 9),
        note="Where there is no air cut, the edge coefficients absorb the sensor's offset." if without else "",
    )


def peaks(cuts: Sequence[CutForce]) -> Table | None:
    """Lines of the spectrum that are no harmonics of the spindle."""
    short = cut_names(cut.name for cut in cuts)
    found = [peak.exceeds for cut in cuts for peak in cut.peaks]
    least = sorted(found, reverse=True)[:MOST_PEAKS][-1] if found else 0.0
    rows = [
        [short[cut.name], peak.axis, fixed(peak.frequency, 1), significant(peak.amplitude), fixed(peak.exceeds, 1)]
        for cut in cuts
        for peak in cut.peaks
        if peak.exceeds >= least
    ]
    headings = ("cut", "axis", "frequency, Hz", "amplitude, N", "times its surroundings")
    note = "A line that is no harmonic may be chatter, a resonance rung by every tooth, or mains."
    if len(rows) < len(found):
        note = f"The {len(rows)} clearest of {len(found)}. {note}"
    return (
        Table("Lines that are no harmonics of the spindle", headings, rows, words=(0, 1), note=note) if rows else None
    )


def hits(frf: Frf) -> Table | None:
    """Every hit of the hammer and what was found about it."""
    short = short_names(hit.recording for hit in frf.hits)
    rows = [
        [
            short[hit.recording],
            str(hit.index),
            fixed(hit.onset, 3),
            significant(hit.peak, 4),
            "✓ used" if hit.accepted else "✕ left out",
            "; ".join((*hit.reasons, *hit.remarks)),
        ]
        for hit in frf.hits
    ]
    headings = ("recording", "hit", "at, s", "peak, N", "", "why")
    used = sum(hit.accepted for hit in frf.hits)
    note = f"{used} of {len(rows)} hits used."
    return Table("Hits of the impact test", headings, rows, words=(0, 4, 5), note=note) if rows else None


def untold(fit: Coefficients) -> list[str]:
    """Coefficients of the linear-edge law that accelerations do not tell, beside those they do; none of other fits."""
    if mean_is_known(fit) or fit.posterior.law != "linear-edge":
        return []
    return [name for name in LINEAR_EDGE if name not in fit.posterior.names]


def coefficients(posterior: Posterior, untold: Sequence[str] = (), *, title: str = "", note: str = "") -> Table:
    """Every parameter with its interval and spread.   untold : coefficients that the data cannot show"""
    rows = []
    for index, name in enumerate(posterior.names):
        known = parameter(name)
        value, low, high = (float(v) / known.factor for v in (posterior.mean[index], *posterior.interval[index]))
        sd = float(np.sqrt(np.maximum(posterior.covariance[index, index], 0.0))) / known.factor
        centre, lowest, highest = with_interval(value, low, high)
        doubt = "not told from zero" if low < 0 < high else ""
        meaning = f"{known.meaning}; {doubt}" if doubt and known.meaning else known.meaning or doubt
        between = f"{lowest} to {highest}" if np.isfinite([low, high]).any() else UNKNOWN
        rows.append([name, centre, between, significant(sd, 2), known.unit, meaning])
    for name in untold:
        known = parameter(name)
        rows.append([name, UNKNOWN, UNKNOWN, UNKNOWN, known.unit, f"{known.meaning}; not told by accelerations"])
    order = {name: place for place, name in enumerate(LINEAR_EDGE)} if untold else {}
    rows.sort(key=lambda row: order.get(row[0], len(order)))
    headings = ("", "value", "95 % interval", "sd", "unit", "what it is")
    return Table(title, headings, rows, words=(0, 4, 5), note=note)


def alternatives(fit: Coefficients) -> Table | None:
    """What other models say, in the units of the table above."""
    if not fit.alternatives:
        return None
    adopted = [(name, float(v)) for name, v in zip(fit.posterior.names, fit.posterior.mean, strict=True)]
    models = [(f"{fit.posterior.method} (this report)", dict(adopted))]
    models += [(name, dict(pairs)) for name, pairs in fit.alternatives]
    keys = list(dict.fromkeys(key for _, values in models for key in values))
    headings = [""]
    for key in keys:
        known = parameter(key)
        headings.append(f"{known.name}, {known.unit}" if known.unit not in ("", "1") else known.name)
    rows = []
    for name, values in models:
        row = [name]
        for key in keys:
            value = values.get(key)
            row.append(UNKNOWN if value is None else significant(value / parameter(key).factor))
        rows.append(row)
    return Table("Other models on the same cuts", headings, rows)


def agreement(fit: Coefficients) -> Table:
    """How far the model is from the force, per axis."""
    of_means = " of the mean forces" if fit.posterior.method == "average" else ""
    rows = [[f"R²{of_means}", *(fixed(float(v), 4) for v in fit.r2)]]
    rows.append([f"residual{of_means}, N rms", *(significant(float(v)) for v in fit.residual_rms)])
    low, high = fit.band
    band = f"harmonics {low} to {high}" if high else "band of the fit"
    for values, words in (
        (fit.in_sample, f"residual / AC rms, {band}"),
        (fit.left_out, f"the same on cuts left out, {band}"),
        (fit.in_sample_wide, "residual / AC rms, all saved harmonics"),
        (fit.left_out_wide, "the same on cuts left out, all saved harmonics"),
    ):
        if values is not None:
            rows.append([words, *(fixed(float(v), 3) for v in values)])
    return Table("How close the model comes", ("", *(f"F{axis}" for axis in AXES)), rows)


def spectrum(fit: Coefficients) -> Table | None:
    """Where in the spectrum the alternating force sits, measured and modelled, in per cent of the measured AC power."""
    measured, modelled = (np.nan_to_num(v[:, :, 1:]) ** 2 for v in (fit.measured_amplitude, fit.modelled_amplitude))
    axes = axes_measured(fit)
    order = np.arange(1, measured.shape[2] + 1)
    teeth = fit.cutter.teeth
    kinds = (
        (f"tooth passing, harmonic {teeth}", order == teeth),
        ("multiples of it", (order % teeth == 0) & (order > teeth)),
        ("all others: runout, unequal teeth", order % teeth != 0),
    )
    whole = np.maximum(measured.sum(axis=(0, 2)), 1e-300)  # (axis,) over all cuts
    rows = []
    for words, kind in kinds:
        if kind.any():
            shares = ((100 * v[:, :, kind].sum(axis=(0, 2)) / whole)[axes] for v in (measured, modelled))
            rows.append([words, *(fixed(float(v), 1) for pair in zip(*shares, strict=True) for v in pair)])
    return (
        Table(
            "Where the alternating force sits",
            ("", *("measured", "modelled") * len(axes)),
            rows,
            groups=(("", 1), *((f"F{AXES[row]}, % of the measured AC power", 2) for row in axes)),
        )
        if rows
        else None
    )


def left_out(fit: Coefficients) -> Table | None:
    """Each cut predicted from the others."""
    if fit.left_out_by_cut is None:
        return None
    short = cut_names(fit.cuts)
    rows = [
        [short[name], nominal(float(feed) * 1e3), *(fixed(float(v), 3) for v in ratios)]
        for name, feed, ratios in zip(fit.cuts, fit.feed_per_tooth, fit.left_out_by_cut, strict=True)
    ]
    note = "Residual over AC rms when the cut is predicted from the others; below 0.15 is good, 1 is no better than the mean."
    headings = ("cut", "f_z, mm", *(f"F{axis}" for axis in AXES))
    return Table("Each cut predicted from the others", headings, rows, note=note)


def expected(summary: Mapping[str, Any]) -> Table | None:
    """What the recipe expects, and whether it came true."""
    rows = []
    for entry in summary.get("expect") or ():
        wanted = entry.get("interval") or (None, None)  # an interval, or how a text begins
        if not isinstance(wanted, str):
            wanted = f"{nominal(wanted[0])} to {nominal(wanted[1])}"
        value = entry.get("value")
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        rows.append(
            [
                str(entry.get("key", "")),
                nominal(value) if number else _beginning(str(value)) if value is not None else UNKNOWN,
                wanted,
                "✓ yes" if entry.get("ok") else "✕ no",
            ]
        )
    headings = ("key", "value", "expected", "met")
    return Table("What the recipe expects", headings, rows, words=(0, 3)) if rows else None


def _beginning(text: str, most: int = 32) -> str:
    """A text as far as its first colon, where it is long: a verdict without its reasons, which stand at the top."""
    head = text.partition(":")[0]
    return text if len(text) <= most else f"{head if len(head) <= most else text[:most].rstrip()} …"
