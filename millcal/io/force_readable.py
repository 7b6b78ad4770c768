"""What forces from accelerations say to a reader: coefficients, harmonics, what cannot be told, methods side by side."""

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from millcal.data import AXES, ForceHarmonics, SpeedAdvice
from millcal.io.force_summary import summarise_advice, summarise_forces
from millcal.io.text_table import cell, interval, table

TELLS_NOTHING = 0.01  # share of what is known of the coefficients, below which a sensor is named
MOST_PHASES = 4  # told one by one
HARMONICS_SHOWN = 24  # lines; the rest is in the JSON and the table


def forces_text(forces: ForceHarmonics) -> str:
    """Coefficients, the harmonics, and what a reader needs to believe them."""
    s = summarise_forces(forces)
    rows = [(name, c["value"], *c["ci95"], c["unit"]) for name, c in s["coefficients"].items()]
    head, *rest = _what_it_rests_on(forces, s)
    lines = [head, table(("", "value", "95 % from", "to", "unit"), rows), *_unobservable(s), "", _harmonics(forces, s)]
    advised = [] if s["advice"] is None else ["", _advice(s["advice"])]
    return "\n".join([*lines, "", *rest, *_residual(s), "", *_verdict(forces), *advised])


def forces_brief(forces: ForceHarmonics) -> str:
    """Without the harmonics, and without coefficients and verdict, which those after this stage repeat."""
    s = summarise_forces(forces)
    lines = [*_what_it_rests_on(forces, s), *_residual(s)]
    return "\n".join([*lines, *([] if s["advice"] is None else [_advice(s["advice"])])])


def compared_text(forces: ForceHarmonics) -> str:
    """Every method's coefficients on the same lines, the recommended method marked, and why."""
    s = summarise_forces(forces)
    if not s["compared"]:
        return "no other method was tried on these lines"
    names = forces.posterior.names
    keys = list(next(iter(s["compared"].values())))[::2]
    rows = []
    for method, values in s["compared"].items():
        shown = [_with_sd(values[key], values[f"{key}_sd"]) for key in keys]
        marks = ["used"] * (method == s["method"]) + ["recommended"] * (method == s["recommended"])
        rows.append((method, *shown, ", ".join(marks)))
    lines = ["methods side by side, value +- sd; Ktc Krc Kac in N/mm^2, Kte Kre Kae in N/mm:"]
    lines.append(table(("", *names, ""), rows))
    return "\n".join([*lines, *_recommended(s)])


def advice_text(advice: SpeedAdvice) -> str:
    """The best speeds for the next cut."""
    return _advice(summarise_advice(advice))


def _what_it_rests_on(forces: ForceHarmonics, s: Mapping[str, Any]) -> list[str]:
    n, axes = len(forces.cuts), " ".join(axis for axis in AXES if axis in forces.axes)
    frf = "the FRF as measured" if s["frf_from"] == "measured" else "the modes of the FRF"
    constraint, regularization = s["constraint"], s["regularization"]
    lines = [
        f"forces along {axes} by {s['method']} from {n} cut{'s' if n > 1 else ''}, {len(s['sensors'])} sensors and {frf}: "
        f"{len(s['harmonics'])} line{'s' if len(s['harmonics']) > 1 else ''}, {interval(s['bandwidth_hz'])} Hz",
        f"the law: rank {constraint['rank']}, and {constraint['rows']} real equations between the harmonics "
        f"({constraint['complex_rows']} rows linear in complex ones)",
    ]
    conditioned = f"condition number {cell(s['condition_number'])}"
    if regularization is not None:
        conditioned += (
            f"; regularization {cell(regularization)} (m/s^2)/N from {s['regularization_from'] or 'the recipe'}"
        )
    lines += [conditioned, _phase(s)]
    if s["runout"] is not None:
        told = [
            f"{name} {cell(s['runout'][f'{name}_um'])} ({interval(s['runout'][f'{name}_um_ci95'])})"
            for name in ("c0", "s0")
        ]
        lines.append(f"runout, um: {', '.join(told)}")
    silent = [
        f"{sensor['dof']} ({cell(100 * sensor['share'])} %)"
        for sensor in s["sensors"]
        if sensor["share"] is not None and sensor["share"] < TELLS_NOTHING
    ]
    if silent:
        lines.append(f"sensors that tell next to nothing of the coefficients: {', '.join(silent)}")
    return lines


def _phase(s: Mapping[str, Any]) -> str:
    found = [
        "-" if value is None else _degrees(value) + (f" ({' to '.join(map(_degrees, bounds))})" if bounds else "")
        for value, bounds in zip(s["phase_deg"], s["phase_deg_ci95"], strict=True)
    ]
    shown = list(dict.fromkeys(found))  # cuts may share one
    if len(shown) > MOST_PHASES:
        shown = [*shown[:MOST_PHASES], f"... of {len(found)} cuts"]
    return f"tooth 0 at the angle counted from, degrees, {s['phase_from']}: {', '.join(shown)}"


def _degrees(value: float) -> str:
    return f"{value:.2f}"


def _recommended(s: Mapping[str, Any]) -> list[str]:
    return [f"recommended: {s['recommended']}, because {s['recommended_why']}"] if s["recommended"] else []


def _unobservable(s: Mapping[str, Any]) -> list[str]:
    lines = []
    if s["unobservable"]:
        lines.append(f"these lines do not tell: {', '.join(s['unobservable'])}")
    if s["unobservable_combinations"]:
        together = "; ".join(" with ".join(names) for names in s["unobservable_combinations"])
        lines.append(f"and cannot tell apart: {together}")
    return lines


def _harmonics(forces: ForceHarmonics, s: Mapping[str, Any]) -> str:
    axes = [axis for axis in AXES if axis in forces.axes]
    several = len(forces.cuts) > 1
    header = [*(["cut"] if several else []), "k", "Hz"]
    header += [name for axis in axes for name in (f"F{axis} N", "sd")]
    rows = []
    for line in s["harmonics"][:HARMONICS_SHOWN]:
        # harmonics of the spindle between those of the teeth are told as what they are of the tooth passing
        k = line["k"] if line["k"] is not None else f"{line['spindle_harmonic']}/{forces.cutter.teeth}"
        row = [*([PurePath(line["cut"]).stem] if several else []), k, line["frequency_hz"]]
        for axis in axes:
            row += [line[f"F{axis}_amplitude_N"], line[f"F{axis}_sd_N"]]
        rows.append([*row, line["condition_number"]])
    told = "peak amplitudes of the force; k counts the tooth passing:"
    left = len(s["harmonics"]) - len(rows)
    more = [f"... and {left} more"] if left > 0 else []
    return "\n".join([told, table([*header, "condition"], rows), *more])


def _residual(s: Mapping[str, Any]) -> list[str]:
    lines = [f"chi2 per degree of freedom {cell(s['chi2'])}, {s['dof']} of them"]
    return lines + (_recommended(s) if s["recommended"] != s["method"] else [])


def _verdict(forces: ForceHarmonics) -> list[str]:
    failed = [f"  failed: {check.name}: {check.message}" for check in forces.checks if not check.passed]
    return [f"verdict: {forces.verdict}", *failed]


def _with_sd(value: float | None, sd: float | None) -> str:
    return cell(value) if sd is None else f"{cell(value)} +- {_rough(sd)}"


def _rough(number: float) -> str:
    """Two digits."""
    return f"{number:.2g}" if number < 99.5 else f"{number:.0f}"


def _advice(s: Mapping[str, Any]) -> str:
    if not s["best"]:
        return "no spindle speed in this range would tell more than another"
    names: Sequence[str] = list(s["best"][0]["relative_sd"])
    rows = []
    for best in s["best"]:
        spread = [None if best["relative_sd"][name] is None else 100 * best["relative_sd"][name] for name in names]
        rows.append((round(best["rpm"]), *spread, best["condition_number"], f"{best['worst_harmonic']:g}"))
    finite = [
        max(values) for values in s["curve"]["relative_sd"].values() if values and not any(v is None for v in values)
    ]
    worst = f"; the worst speed here: up to {cell(100 * float(np.max(finite)))} %" if finite else ""
    head = f"best spindle speeds for the next acceleration cut, expected sd in %{worst}:"
    return "\n".join([head, table(("rpm", *names, "condition", "worst harmonic"), rows)])
