"""The study of trending coefficients in words and as CSV, from its summary."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from millcal.report.digits import csv_number, fixed

_KEYS = ("force_rms_N", "force_rms_mean_N", "force_rms_sd_N", "paper_N", "kt_rms_N_per_mm2", "mt_rms")


def text_of(summary: Mapping[str, Any]) -> str:
    """The table beside the paper's, the errors of the coefficients, and what holds of one method against another."""
    return "\n\n".join([_head(summary), _forces(summary), _coefficients(summary), _ratios(summary)])


def table_csv(summary: Mapping[str, Any]) -> str:
    """A row for each method and case."""
    lines = [",".join(("method", "step", "lambda", "case", *_KEYS))]
    for row in summary["table"]:
        for case, found in row["cases"].items():
            setting = ["" if row[key] is None else f"{row[key]:g}" for key in ("step", "lambda")]
            lines.append(",".join([_quoted(row["method"]), *setting, case, *(_number(found[key]) for key in _KEYS)]))
    return "\n".join(lines) + "\n"


def ratios_csv(summary: Mapping[str, Any]) -> str:
    """A row for each claim."""
    words, numbers = ("method", "other", "case", "expected", "said_by"), ("paper", "mean", "least", "most")
    counts = ("holds", "draws")
    lines = [",".join((*words, *numbers, *counts))]
    for ratio in summary["ratios"]:
        cells = [*(_quoted(ratio[key]) for key in words), *(_number(ratio[key]) for key in numbers)]
        lines.append(",".join([*cells, *(str(ratio[key]) for key in counts)]))
    return "\n".join(lines) + "\n"


def courses_csv(columns: Mapping[str, np.ndarray]) -> str:
    """What the figures draw, a row for each active sample.   columns : by heading, (active,)"""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(_quoted(name) for name in columns)]
    return "\n".join([*lines, *(",".join(map(csv_number, row)) for row in rows)]) + "\n"


def _head(summary: Mapping[str, Any]) -> str:
    return (
        f"{summary['paper']}\n"
        f"{summary['starts']} initial ensembles on one draw of the noise (seed {summary['seed']}); "
        f"scatter from {summary['draws']} other draws, {summary['starts_of_draw']} ensembles each"
    )


def _forces(summary: Mapping[str, Any]) -> str:
    cases = list(summary["table"][0]["cases"])
    rows = [["force error, N", *(word for case in cases for word in (case, "scatter", "paper"))]]
    for row in summary["table"]:
        cells = [row["method"]]
        for case in cases:
            found = row["cases"][case]
            cells += [fixed(found["force_rms_N"], 1), _scatter(found), fixed(found["paper_N"], 1)]
        rows.append(cells)
    distance = summary["rms_log_ratio_to_paper"]
    apart = ", ".join(f"{case} {100 * distance[case]['one_draw']:.0f} %" for case in cases)
    return f"{aligned(rows)}\nfrom the paper's, rms over its settings: {apart}"


def _scatter(found: Mapping[str, Any]) -> str:
    return f"{fixed(found['force_rms_mean_N'], 1)} ± {fixed(found['force_rms_sd_N'], 1)}"


def _coefficients(summary: Mapping[str, Any]) -> str:
    """Of the methods, not of every setting."""
    cases = list(summary["table"][0]["cases"])
    heads = [word for case in cases for word in (f"{case} kt", "mt")]
    rows = [["error in the 2nd half", *heads]]
    for row in summary["table"]:
        if row["step"] is None or (row["step"], row["lambda"]) == (50, 10):
            cells = [row["method"]]
            for case in cases:
                found = row["cases"][case]
                cells += [fixed(found["kt_rms_N_per_mm2"], 0), fixed(found["mt_rms"], 3)]
            rows.append(cells)
    return aligned(rows) + "\nkt in N/mm²; the smoother knows the whole record, all others only what was before"


def _ratios(summary: Mapping[str, Any]) -> str:
    rows = [["ratio of force errors", "case", "paper", "mean", "from", "to", "as said"]]
    for ratio in summary["ratios"]:
        sign = "< 1" if ratio["expected"] == "smaller" else "> 1"
        held = f"{sign} in {ratio['holds']} of {ratio['draws']}" + ("" if ratio["said_by"] == "paper" else " *")
        numbers = [fixed(ratio[key], 2) for key in ("paper", "mean", "least", "most")]
        rows.append([f"{ratio['method']} / {ratio['other']}", ratio["case"], *numbers, held])
    return aligned(rows, words=2) + "\npaired: both on the same noise; * not said by the paper"


def aligned(rows: Sequence[Sequence[str]], words: int = 1, gap: int = 2) -> str:
    """Columns of equal width; the first ones, of words, to the left and the rest to the right.   gap : between them"""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if number < words else cell.rjust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append((" " * gap).join(cells).rstrip())
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "" if value is None else csv_number(value)


def _quoted(text: str) -> str:
    return f'"{text}"' if "," in text else text
