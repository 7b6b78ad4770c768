"""The tables of the modes: their numbers, how alike their shapes are, and how much of each FRF they leave."""

from collections.abc import Sequence
from math import floor, isfinite, log10

import numpy as np

from millcal.data import ModalFit, Modes
from millcal.report.digits import UNKNOWN, fixed, plus_minus, significant
from millcal.report.modal_curves import UNDONE, mode_names, share, taken_away, was_measured
from millcal.report.tables import SHADES, Table

MOST_KEY = 4  # modes at the top of the page
_FROM = {
    "jackknife": "Intervals: 95 %, from leaving out one hit after the other.",
    "least squares": "Intervals: 95 %, of the least squares alone; they know nothing of what the model lacks.",
    "none": "No intervals: one hit, or an FRF without a variance, cannot tell them.",
}


def fit_in_words(fit: ModalFit) -> str:
    """What was fitted to what, and how much of it is left."""
    r, o, i = fit.residue.shape
    kind = "complex" if fit.complex_modes else "real"
    pairs = sum(was_measured(fit, *pair) for pair in np.ndindex(o, i))
    of = f"to all {pairs} {fit.form}s at once" if pairs > 1 else f"to one {fit.form}"
    low, high = (significant(end) for end in fit.band)
    return (
        f"{r} {kind} mode{'s' if r != 1 else ''} fitted {of} from {low} to {high} Hz. They leave "
        f"{share(fit.residual_relative)} of what was measured, noise included."
    )


def taken_away_in_words(fit: ModalFit) -> str:
    """What is said where the structure's FRF is not the one that was recorded; empty where it is."""
    lost = taken_away(fit)
    if lost < UNDONE:
        return ""
    return (
        f"Windows and the ends of the records took {share(lost)} of the FRF away. The fit knows that: what it leaves is "
        "counted against the FRF as it was recorded, and the fitted curve is the corrected one, of the structure itself."
    )


def modes(found: Modes) -> Table:
    """Every mode; a fitted one with intervals, as a spring, a mass and a damper where the first hammer hits."""
    if found.fit is None:
        numbers = zip(found.axes, found.natural_frequency, found.damping_ratio, found.stiffness, strict=True)
        by_hand = [
            [axis, significant(float(f), 4), fixed(100 * float(z), 2), significant(float(k) / 1e6)]
            for axis, f, z, k in numbers
        ]
        return Table("Modes of the structure", ("axis", "f_n, Hz", "ζ, %", "k, N/µm"), by_hand)
    fit, first = found.fit, found.fit.inputs[0].lstrip("+-")
    frequency, damping = found.frequency_estimate, found.damping_estimate
    columns: list[Sequence[str]] = [
        [str(number) for number in range(1, len(found.axes) + 1)],
        found.axes,
        _with_intervals(frequency.value, found.interval(frequency), 1.0),
        _with_intervals(damping.value, found.interval(damping), 100.0),
    ]
    headings, groups = ["", "along", "f_n, Hz", "ζ, %"], [("", 4)]
    note = _FROM[fit.interval_from]
    if first in fit.driving_points:
        for estimate, factor in zip(found.driving_constants(*fit.driving_points[first]), (1e-6, 1.0, 1.0), strict=True):
            columns.append(_with_intervals(estimate.value, found.interval_by_inverse(estimate), factor))
        headings, groups = [*headings, "k, N/µm", "m, kg", "c, N s/m"], [*groups, (f"at {first}", 3)]
    else:
        note += f" Nothing was measured at {first} along the hit, so k, m and c are not known there."
    columns.append([fixed(float(np.degrees(angle)), 1) for angle in fit.complexity])
    rows = [list(row) for row in zip(*columns, strict=True)]
    note += " Complexity: the angle by which the points of a shape do not move in step."
    return Table(
        "Modes of the structure", (*headings, "complexity, °"), rows, (*groups, ("", 1)), words=(0, 1), note=note
    )


def key_numbers(found: Modes) -> list[dict[str, str]]:
    """The modes with the highest peaks as the numbers to take along, each where it is softest."""
    points = found.fit.driving_points if found.fit else {}
    if not points:
        return []
    k = np.stack([found.driving_constants(*pair).stiffness.value for pair in points.values()], axis=1)
    k = np.where(np.isfinite(k), k, np.inf)
    softest = np.argmin(k, axis=1)
    peak = 1 / (2 * found.damping_ratio * k.min(axis=1))
    shown = _with_intervals(found.natural_frequency, found.interval(found.frequency_estimate), 1.0)
    numbers = []
    for r in np.sort(np.argsort(-peak, kind="stable")[:MOST_KEY]):
        word = f"ζ {fixed(100 * float(found.damping_ratio[r]), 2)} %"
        if peak[r] > 0:
            word += f", k {significant(float(k[r].min()) / 1e6)} N/µm at {list(points)[softest[r]]}"
        numbers.append({"name": f"Mode {r + 1}", "value": shown[r], "unit": "Hz", "word": word})
    return numbers


def stiffness(found: Modes) -> Table | None:
    """k of every mode at every driving point; None where there is but one."""
    points = found.fit.driving_points if found.fit else {}
    if len(points) < 2:
        return None
    at_points = [found.driving_constants(*pair).stiffness for pair in points.values()]
    columns = [_with_intervals(k.value, found.interval_by_inverse(k), 1e-6) for k in at_points]
    rows = [[name, *cells] for name, *cells in zip(mode_names(found), *columns, strict=True)]
    note = ""
    if any(UNKNOWN in row for row in rows):
        note = f"{UNKNOWN}: the fitted constant there is not positive, which no structure's is; the mode hardly moves there."
    return Table(
        "Stiffness at every driving point", ("mode", *points), rows, (("", 1), ("k, N/µm", len(points))), note=note
    )


def alike(found: Modes) -> Table | None:
    """The modal assurance criterion between the shapes; None where one mode or one place can show none."""
    if found.fit is None or len(found.axes) < 2 or max(len(found.fit.outputs), len(found.fit.inputs)) < 2:
        return None
    rows = [
        [name, *(fixed(float(v), 2) for v in row)] for name, row in zip(mode_names(found), found.fit.mac, strict=True)
    ]
    levels = [[None, *(_level(float(value)) for value in row)] for row in found.fit.mac]
    note = "Modal assurance criterion: 1 for one and the same shape, 0 for shapes at right angles."
    headings = ("mode", *(str(number) for number in range(1, len(rows) + 1)))
    return Table("How alike the shapes are", headings, rows, note=note, levels=levels, shade="agree")


def residual(fit: ModalFit) -> Table | None:
    """What the modes leave of each FRF; None of a single one, of which the text says it."""
    if fit.residual.size < 2:
        return None
    rows, levels = [], []
    for o, output in enumerate(fit.outputs):
        values = [float(fit.residual[o, i]) if was_measured(fit, o, i) else np.nan for i in range(len(fit.inputs))]
        rows.append([output, *(share(value) if isfinite(value) else UNKNOWN for value in values)])
        levels.append([None, *(_level((log10(max(v, 1e-3)) + 3) / 3) if isfinite(v) else None for v in values)])
    note = "Share of each FRF in the band that the modes leave, noise included."
    return Table(
        "What the modes leave of each FRF",
        ("response", *fit.inputs),
        rows,
        (("", 1), ("hammer", len(fit.inputs))),
        note=note,
        levels=levels,
        shade="doubt",
    )


def _level(part: float) -> int:
    return int(np.clip(np.floor(part * SHADES), 0, SHADES - 1))


def _with_intervals(values: np.ndarray, bounds: np.ndarray, factor: float) -> list[str]:
    """`16.17 ± 0.37`; `1120 (above 460)` where there is no high end."""
    shown = []
    for value, (low, high) in zip(factor * values, factor * bounds, strict=True):
        if isfinite(value) and isfinite(low) and not isfinite(high):
            shown.append(f"{_rough(float(value))} (above {_rough(float(low))})")
        elif isfinite(high) and high - low > 2e-5 * value:
            shown.append(plus_minus(float(value), float(low), float(high)))
        elif isfinite(high) and value > 0:  # finer than six digits show
            shown.append(f"{significant(float(value), 7)} ± {significant(float(high - low) / 2, 1)}")
        else:
            shown.append(significant(float(value), 4))
    return shown


def _rough(value: float) -> str:
    """Two digits of a positive number."""
    return fixed(value, 1 - floor(log10(value))) if value > 0 else fixed(value, 0)
