"""The tables of coefficients that change while cutting: the end of the record, wear, jumps, and what the record can tell."""

from math import expm1, log

import numpy as np

from millcal.data import CoefficientHistory
from millcal.report.digits import UNKNOWN, fixed, nominal, plus_minus, significant, with_interval
from millcal.report.history_figures import cut_spans
from millcal.report.tables import Table
from millcal.report.wording import SIDES, cut_names, parameter, spelt, time_unit

_NORMAL = 1.96  # quantile of 95 %
_RUNOUT = {
    "c0": "runout: how far tooth 0 stands out at the bottom",
    "s0": "runout: across c0, at the bottom",
}


def rate_unit(history: CoefficientHistory) -> tuple[float, str]:
    """What a change per minute is shown in: the factor to it, and its name; per second where the record is short."""
    duration = float(history.time[-1] - history.time[0]) if len(history.time) else 0.0
    return (100.0, "%/min") if duration >= 30 else (100.0 / 60.0, "%/s")


def at_the_end(history: CoefficientHistory) -> Table:
    """Every parameter as the record leaves it, with its interval."""
    posterior = history.posterior
    rows = []
    for index, name in enumerate(posterior.names):
        known = parameter(name)
        value, low, high = (float(v) / known.factor for v in (posterior.mean[index], *posterior.interval[index]))
        sd = float(np.sqrt(np.maximum(posterior.covariance[index, index], 0.0))) / known.factor
        centre, lowest, highest = with_interval(value, low, high)
        meaning = _RUNOUT.get(name, known.meaning)
        if low < 0 < high:
            meaning = f"{meaning}; not told from zero" if meaning else "not told from zero"
        between = f"{lowest} to {highest}" if np.isfinite([low, high]).any() else UNKNOWN
        rows.append([name, centre, between, significant(sd, 2), known.unit, meaning])
    headings = ("", "value", "95 % interval", "sd", "unit", "what it is")
    unit, word = time_unit(float(history.time[-1] - history.time[0]))
    title = f"The coefficients at the end, {significant(float(history.time[-1]) / unit)} {word}"
    return Table(title, headings, rows, words=(0, 4, 5))


def change(history: CoefficientHistory) -> Table:
    """Specific force at the reference chip at both ends, and its change with time."""
    factor, rate = rate_unit(history)
    rows = []
    for i, direction in enumerate(history.directions):
        values = (history.specific_force[:, i], history.specific_low[:, i], history.specific_high[:, i])
        ends = [plus_minus(*(float(v[step]) / 1e6 for v in values)) for step in (0, -1)]
        slope = [factor * float(v[i]) for v in (history.slope_per_minute, history.slope_low, history.slope_high)]
        told = UNKNOWN
        if np.isfinite(slope).all():
            told = "not told from zero" if slope[1] <= 0 <= slope[2] else "rises" if slope[0] > 0 else "falls"
        rows.append([SIDES[direction], *ends, plus_minus(*slope), told])
    chip = nominal(round(history.reference_chip * 1e6, 1))
    headings = ["direction", "start, N/mm²", "end, N/mm²", f"change, {rate}", ""]
    note = f"Of the force per area on a chip {chip} µm thick; ± and brackets are 95 %. The change is that of a straight line."
    shown = [0, 1, 2, 3, 4]
    if history.method != "smooth":  # a filter starts with its prior, which is no finding
        shown.remove(1)
    words, title = (0, len(shown) - 1), "Change over time"
    if not np.isfinite(history.slope_per_minute).any():
        shown, words, title, note = (
            [c for c in shown if c < 3],
            (0,),
            "Specific force",
            note.partition(" The change")[0],
        )
    return Table(title, [headings[c] for c in shown], [[row[c] for c in shown] for row in rows], words=words, note=note)


def jumps(history: CoefficientHistory) -> Table | None:
    """Each sudden change: when, in which cut, how much in each direction, and how sure that is."""
    if not history.jumps:
        return None
    unit, word = time_unit(float(history.time[-1] - history.time[0]))
    names, spans = cut_names(history.cuts), cut_spans(history)
    rows = []
    for number, jump in enumerate(history.jumps, 1):
        cut = next((cut for cut, _, stop in spans if jump.time <= stop), spans[-1][0])
        by = [
            plus_minus(*(100 * _percent(change + side * _NORMAL * sd) for side in (0, -1, 1)))
            for change, sd in zip(jump.change, jump.sd, strict=True)
        ]
        rows.append(
            [
                str(number),
                significant(jump.time / unit, 4),
                names[history.cuts[cut]],
                *by,
                significant(jump.log_bayes_factor),
            ]
        )
    headings = ["", f"time, {word}", "cut", *(f"{SIDES[d]}, %" for d in history.directions), "ln Bayes factor"]
    note = (
        "Of the specific force, ± and brackets 95 %. The Bayes factor is for the record with the jump against without."
    )
    shown = [c for c in range(len(headings)) if c != 2 or len(history.cuts) > 1]
    return Table(
        "Jumps",
        [headings[c] for c in shown],
        [[row[c] for c in shown] for row in rows],
        words=[shown.index(c) for c in (0, 2) if c in shown],
        note=note,
    )


def _percent(change: float) -> float:
    return expm1(change) if np.isfinite(change) and change < 300 else np.nan


def told_apart(history: CoefficientHistory) -> Table | None:
    """How well the record knows the force at the reference chip and each coefficient by itself, at the end; None without bands."""
    rows = []
    for i, direction in enumerate(history.directions):
        force = _relative_sd(*(float(v[-1, i]) for v in (history.specific_low, history.specific_high)))
        row = [SIDES[direction], _in_percent(force)]
        for j, name in enumerate(history.names):
            if direction != name[1:2]:
                continue
            low, high = float(history.low[-1, j]), float(history.high[-1, j])
            is_exponent = name[0] == "m"
            row.append(
                significant((high - low) / (2 * _NORMAL), 2) if is_exponent else _in_percent(_relative_sd(low, high))
            )
        rows.append(row)
    if all(cell == UNKNOWN for row in rows for cell in row[1:]):
        return None
    first, second = ("k, %", "m") if history.law == "kienzle" else ("Kc, %", "Ke, %")
    low, high = (nominal(round(end * 1e6, 1)) for end in history.chip_range)
    chip = nominal(round(history.reference_chip * 1e6, 1))
    said = "".join(f" {_sentence(check.message)}" for check in history.checks if check.name == "separable")
    note = (
        f"Standard deviations at the end. The chips of these cuts are {low} to {high} µm thick (5\u00a0% and 95\u00a0%): there "
        f"the force is known, beyond it the law is an extrapolation.{said}"
    )
    headings = ("direction", f"force at {chip} µm, %", first, second)
    return Table("What the record can tell", headings, rows, note=note)


def _sentence(message: str) -> str:
    return spelt(message if message[-1:] in ".!?" else f"{message}.")


def _relative_sd(low: float, high: float) -> float:
    """Standard deviation of the logarithm behind a 95 % band of either sign; infinite where the band holds zero."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return np.nan
    return abs(log(high / low)) / (2 * _NORMAL) if low * high > 0 else np.inf


def _in_percent(sd: float) -> str:
    if np.isinf(sd):
        return "not told from zero"
    return significant(100 * sd, 2) if np.isfinite(sd) else UNKNOWN


_NOISE = {"air": "air cut", "idle": "teeth out of cut", "residual": "residual"}


def agreement(history: CoefficientHistory) -> Table:
    """How close the model comes on each axis, beside the noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        over = history.residual_rms / history.noise
    rows = [
        ["R²", *(fixed(float(v), 4) for v in history.r2)],
        ["residual, N rms", *(significant(float(v)) for v in history.residual_rms)],
        [f"noise, N rms ({_NOISE[history.noise_from]})", *(significant(float(v)) for v in history.noise)],
        ["residual / noise", *(fixed(float(v), 2) for v in over)],
    ]
    note = ""
    if np.isfinite(history.chi2):
        note = (
            f"χ² {fixed(history.chi2, 2)}: mean square of the normalised residual of the stiff model, 1 where model and "
            "noise are right."
        )
    return Table("How close the model comes", ("", *(f"F{axis}" for axis in history.axes)), rows, note=note)
