"""A history of coefficients as a table for other programs: CSV, a line for each step, shop units in the headings.

`time_s, cut, kt_N_per_mm2, kt_low_N_per_mm2, kt_high_N_per_mm2, ...`, then the specific force in each direction on a chip of
`reference_chip_um`. Low and high are the 95 % band; what is not known is empty.
"""

import csv
from io import StringIO
from math import isfinite
from pathlib import Path

import numpy as np

from millcal.data import CoefficientHistory
from millcal.io.parameter_summary import SHOP_UNITS
from millcal.io.results import write_text_atomically
from millcal.units import to_shop

DIGITS = 10  # of every number: a round trip loses less than any sensor knows


def write_history_table(path: Path, history: CoefficientHistory) -> None:
    """Write every step of a history to a CSV file, whole or not at all.   raises RecordingError where that cannot be"""
    write_text_atomically(path, history_table(history))


def history_table(history: CoefficientHistory) -> str:
    """The table as text, lines ended as RFC 4180 wants them."""
    named = [
        (name, SHOP_UNITS.get(unit, ("",))[0], values)
        for i, (name, unit) in enumerate(zip(history.names, history.units, strict=True))
        for values in [(history.value[:, i], history.low[:, i], history.high[:, i])]
    ]
    named += [
        (f"specific_{direction}", "N_per_mm2", (value, low, high))
        for direction, value, low, high in zip(
            history.directions, history.specific_force.T, history.specific_low.T, history.specific_high.T, strict=True
        )
    ]
    headings, columns = ["time_s", "cut"], []
    for name, suffix, values in named:
        for kind, column in zip(("", "_low", "_high"), values, strict=True):
            headings.append(f"{name}{kind}_{suffix}" if suffix else f"{name}{kind}")
            columns.append(to_shop(column, f"x_{suffix}"))
    headings.append("reference_chip_um")
    chip = _number(to_shop(history.reference_chip, "x_um"))
    text = StringIO()
    lines = csv.writer(text)
    lines.writerow(headings)
    rows = np.stack(columns, axis=1)
    for time, cut, row in zip(history.time.tolist(), history.cut.astype(int).tolist(), rows.tolist(), strict=True):
        lines.writerow([_number(time), history.cuts[cut], *map(_number, row), chip])
    return text.getvalue()


def _number(value: float) -> str:
    return f"{value:.{DIGITS}g}" if isfinite(value) else ""
