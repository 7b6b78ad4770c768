"""The tables of the modes: their numbers, how alike their shapes are, and how much of each FRF they leave."""

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


def corrections_in_words(fit: ModalFit) -> str:
    """What is said where the structure's FRF is not the one that was recorded; empty where it is."""
    said = []
    lost = taken_away(fit)
    if lost >= UNDONE:
        said.append(f"Windows and the ends of the records took {share(lost)} of the FRF away.")
    if fit.delay is not None:
        said.append("The responses came later than the hammer.")
    if not said:
        return ""
    said.append(
        "The fit knows that: what it leaves is counted against the FRF as it was recorded, and the fitted curve is the "
        "corrected one, of the structure itself."
    )
    return " ".join(said)


def delays(found: Modes) -> Table | None:
    """How late each response is behind the hammer; None where that was not estimated."""
    fit = found.fit
    bounds = found.delay_interval if fit is not None else None
    if fit is None or fit.delay is None or bounds is None:
        return None
    shown = _with_intervals(fit.delay, bounds, 1e6)
    rows = [[dof, text] for dof, text in zip(fit.outputs, shown, strict=True)]
    note = "Estimated from the phase over all modes and taken out of them; the measured FRF still has it."
    return Table("Delay of the responses behind the hammer", ("response", "delay, µs"), rows, note=note)


def modes(found: Modes) -> Table:
    """Every mode; a fitted one with intervals, as a spring, a mass and a damper where it is softest."""
    if found.fit is None:
        numbers = zip(found.axes, found.natural_frequency, found.damping_ratio, found.stiffness, strict=True)
        by_hand = [
            [axis, significant(float(f), 4), fixed(100 * float(z), 2), significant(float(k) / 1e6)]
            for axis, f, z, k in numbers
        ]
        return Table("Modes of the structure", ("axis", "f_n, Hz", "ζ, %", "k, N/µm"), by_hand)
    columns = [
        [str(number) for number in range(1, len(found.axes) + 1)],
        list(found.axes),
        _with_intervals(found.natural_frequency, found.interval(found.frequency_estimate), 1.0),
        _with_intervals(found.damping_ratio, found.interval(found.damping_estimate), 100.0),
    ]
    headings, groups, words = ["", "along", "f_n, Hz", "ζ, %"], [("", 4)], [0, 1]
    note = _FROM[found.fit.interval_from]
    softest, places = _softest(found)
    if softest is not None:
        columns.append(places)
        for (values, bounds), factor in zip(softest, (1e-6, 1.0, 1.0), strict=True):
            columns.append(_with_intervals(values, bounds, factor))
        headings, words = [*headings, "at", "k, N/µm", "m, kg", "c, N s/m"], [*words, 4]
        groups = [*groups, ("where it is softest" if len(found.fit.driving_points) > 1 else "", 4)]
    else:
        note += " No point was both hit and measured in one direction, so k, m and c are not known."
    columns.append([fixed(float(np.degrees(angle)), 1) for angle in found.fit.complexity])
    rows = [list(row) for row in zip(*columns, strict=True)]
    note += " Complexity: the angle by which the points of a shape do not move in step."
    return Table("Modes of the structure", (*headings, "complexity, °"), rows, (*groups, ("", 1)), words, note)


def _softest(found: Modes) -> tuple[list[tuple[np.ndarray, np.ndarray]] | None, list[str]]:
    """k, m and c of every mode with their intervals at the driving point where it gives way the most, and its name."""
    points = found.fit.driving_points if found.fit else {}
    if not points:
        return None, []
    at = [found.driving_constants(*pair) for pair in points.values()]
    flexibility = np.stack([constants.stiffness.inverse.value for constants in at])
    chosen, modes_ = np.argmax(flexibility, axis=0), np.arange(len(found.axes))
    numbers = []
    for constants in zip(*at, strict=True):  # k at every point, then m, then c
        values = np.stack([constant.value for constant in constants])[chosen, modes_]
        bounds = np.stack([found.interval_of_constant(constant) for constant in constants])[chosen, modes_]
        numbers.append((values, bounds))
    names = list(points)
    return numbers, [names[point] for point in chosen]


def key_numbers(found: Modes) -> list[dict[str, str]]:
    """The modes with the highest peaks as the numbers to take along, each where it is softest."""
    softest, places = _softest(found)
    if softest is None:
        return []
    k = softest[0][0]
    peak = np.nan_to_num(1 / (2 * found.damping_ratio * k))
    shown = _with_intervals(found.natural_frequency, found.interval(found.frequency_estimate), 1.0)
    numbers = []
    for r in np.sort(np.argsort(-peak, kind="stable")[:MOST_KEY]):
        word = f"ζ {fixed(100 * float(found.damping_ratio[r]), 2)} %"
        if peak[r] > 0:
            word += f", k {significant(float(k[r]) / 1e6)} N/µm at {places[r]}"
        numbers.append({"name": f"Mode {r + 1}", "value": shown[r], "unit": "Hz", "word": word})
    return numbers


def stiffness(found: Modes) -> Table | None:
    """k of every mode at every driving point; None where there is but one."""
    points = found.fit.driving_points if found.fit else {}
    if len(points) < 2:
        return None
    at_points = [found.driving_constants(*pair).stiffness for pair in points.values()]
    columns = [_with_intervals(k.value, found.interval_of_constant(k), 1e-6) for k in at_points]
    rows = [[name, *cells] for name, *cells in zip(mode_names(found), *columns, strict=True)]
    note = "" if found.fit and found.fit.interval_from != "none" else _FROM["none"]
    if any("over" in cell for row in rows for cell in row):
        note = "over: the mode hardly moves there, and only how stiff it is at least can be told."
    if any(UNKNOWN in row for row in rows):
        note += f" {UNKNOWN}: the fitted constant there is below zero, which no structure's is; look at that sensor."
    return Table(
        "Stiffness at every driving point",
        ("mode", *points),
        rows,
        (("", 1), ("k, N/µm", len(points))),
        note=note.strip(),
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
    """`16.17 ± 0.37`; `over 460` where there is no high end."""
    shown = []
    for value, (low, high) in zip((factor * values).tolist(), (factor * bounds).tolist(), strict=True):
        if isfinite(low) and not isfinite(high):
            shown.append(f"over {fixed(low, 1 - floor(log10(low)))}" if low > 0 else UNKNOWN)
        elif not (isfinite(value) and high > low):
            shown.append(significant(value, 4))
        elif high - low > 2e-5 * abs(value):
            shown.append(plus_minus(value, low, high))
        else:  # finer than six digits show
            decimals, half = 6 - floor(log10(abs(value))), (high - low) / 2
            width = fixed(half, decimals) if half >= 10.0**-decimals else significant(half, 1)
            shown.append(f"{fixed(value, decimals)} ± {width}")
    return shown
