"""The study of forces from accelerations in words and as CSV, from its summary."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from millcal.report.digits import csv_number, fixed
from millcal.report.trending_tables import aligned

MAIN = ("Ktc", "Krc")  # the paper's Kc and Kt
CHIEF = (
    "LS",
    "Tikhonov GCV",
    "RTLS",
    "LS all rows",
    "GTLS",
    "GTLS windowed",
    "GTLS modal",
)  # all are in Fig. 6 and in the CSV
Row = Mapping[str, Any]


def text_of(summary: Mapping[str, Any]) -> str:
    """The paper's four figures as tables, its claims beside what is found, and what better methods reach."""
    parts = [
        _head(summary),
        _errors(summary, "Fig. 6: noise of the accelerations alone, m/s²", _along(summary, "acceleration")),
        _errors(summary, "Fig. 7: noise of the hammer alone, N", _along(summary, "force"), CHIEF),
        _errors(summary, "Fig. 8: condition number of the FRF, all levels", _by(summary, "by_condition"), CHIEF),
        _errors(summary, "Fig. 9: error of the FRF, %", _by(summary, "by_frf_error"), CHIEF),
        _claims(summary),
        _bands(summary),
        _coverage(summary),
        _ensemble(summary),
        _angle(summary),
        _further(summary),
    ]
    return "\n\n".join(part for part in parts if part)


def tables_csv(summary: Mapping[str, Any]) -> str:
    """Root mean square errors of everything tabled: a row for each table, place in it, method and coefficient."""
    lines = ["table,force_noise_N,acceleration_noise_m_per_s2,abscissa,method,coefficient,rmse_percent"]

    def rows(table: str, noise: Sequence[str], abscissa: str, row: Row) -> Iterator[str]:
        for method, errors in row["rmse_percent"].items():
            for name, value in errors.items():
                yield ",".join([table, *noise, abscissa, method, name, csv_number(value)])

    for row in summary["levels"]:
        noise = [csv_number(row["force_noise_N"]), csv_number(row["acceleration_noise_m_per_s2"])]
        lines += rows("level", noise, "", row)
    for row in summary["by_condition"]:
        lines += rows("condition number", ["", ""], csv_number(row["condition_number"]), row)
    for row in summary["by_frf_error"]:
        middle = (row["from_percent"] + row["to_percent"]) / 2
        lines += rows("FRF error percent", ["", ""], csv_number(middle), row)
    ensemble = summary["ensemble"]
    noise = [csv_number(ensemble["force_noise_N"]), csv_number(ensemble["acceleration_noise_m_per_s2"])]
    for number, row in enumerate(ensemble["each"]):
        lines += rows("structure", noise, str(number + 1), row)
    further = summary["further"]
    noise = [csv_number(further["force_noise_N"]), csv_number(further["acceleration_noise_m_per_s2"])]
    for row in further["ways"]:
        lines += rows("further", noise, "", {"rmse_percent": {f"{row['group']}: {row['way']}": row["rmse_percent"]}})
    return "\n".join(lines) + "\n"


def claims_csv(summary: Mapping[str, Any]) -> str:
    """A row for each claim."""
    lines = ["said_by,holds,printed,found"]
    for claim in summary["claims"]:
        words = [claim["said_by"], _held(claim["holds"]), claim["printed"], claim["found"]]
        lines.append(",".join(f'"{word}"' for word in words))
    return "\n".join(lines) + "\n"


def bands_csv(summary: Mapping[str, Any]) -> str:
    """A row for each band."""
    lines = ["force_noise_N,acceleration_noise_m_per_s2,what,of,found,from,to,inside"]
    for row in summary["bands"]:
        numbers = [csv_number(row[key]) for key in ("found", "from", "to")]
        noise = [csv_number(row[key]) for key in ("force_noise_N", "acceleration_noise_m_per_s2")]
        lines.append(",".join([*noise, f'"{row["what"]}"', row["of"], *numbers, _held(row["inside"])]))
    return "\n".join(lines) + "\n"


def _held(holds: bool) -> str:
    return "yes" if holds else "no"


def _head(summary: Mapping[str, Any]) -> str:
    variants = len(summary["forces"]) * len(summary["accelerations"])
    return (
        f"{summary['paper']}\n"
        f"{variants} levels of noise, 12 speeds, {summary['repeats']} repeats (seed {summary['seed']}); "
        "root mean square errors of Ktc / Krc in %"
    )


def _along(summary: Mapping[str, Any], kind: str) -> list[tuple[str, Row]]:
    """The levels at which the other noise is nil."""
    own, other = {"acceleration": (1, 0), "force": (0, 1)}[kind]
    keys = ("force_noise_N", "acceleration_noise_m_per_s2")
    return [(f"{row[keys[own]]:g}", row) for row in summary["levels"] if row[keys[other]] == 0]


def _by(summary: Mapping[str, Any], table: str) -> list[tuple[str, Row]]:
    if table == "by_condition":
        return [(fixed(row["condition_number"], 1), row) for row in summary[table]]
    return [(f"{row['from_percent']:g}–{row['to_percent']:g}", row) for row in summary[table]]


def _errors(summary: Mapping[str, Any], title: str, columns: list[tuple[str, Row]], methods: Sequence[str] = ()) -> str:
    """A row for each method, or for those named; the columns in lines of nine at most."""
    if len(columns) < 2:
        return ""
    blocks = []
    each = -(-len(columns) // -(-len(columns) // 9))
    for start in range(0, len(columns), each):
        part = columns[start : start + each]
        rows = [[title if start == 0 else "", *(head for head, _ in part)]]
        if any("frf_error_percent" in row for _, row in part):
            rows.append(["FRF error, plain H1", *(fixed(row["frf_error_percent"]["plain"], 1) for _, row in part)])
        for method in methods or summary["methods"]:
            rows.append(
                [method, *("/".join(_short(row["rmse_percent"][method][name]) for name in MAIN) for _, row in part)]
            )
        blocks.append(_titled(rows))
    return "\n".join(blocks)


def _titled(rows: list[list[str]]) -> str:
    """The title on a line of its own, so that it does not widen the column of methods."""
    title = rows[0][0]
    rows[0][0] = ""
    return "\n".join([title, aligned(rows, gap=1)]) if title else aligned(rows, gap=1)


def _short(value: float) -> str:
    """Per cent in four characters at most."""
    return fixed(value, 1 if 0.95 <= value < 99.95 else 0 if value >= 99.95 or value < 1e-6 else 2)


def _claims(summary: Mapping[str, Any]) -> str:
    lines = ["what is claimed, whether it holds, and what is found"]
    for claim in summary["claims"]:
        mark = "" if claim["said_by"] == "paper" else " *"
        holds = "holds" if claim["holds"] else "does not hold"
        lines += [f"- {claim['printed']}{mark}: {holds}", f"    {claim['found']}"]
    return "\n".join([*lines, "* said by this study, not by the paper"])


def _bands(summary: Mapping[str, Any]) -> str:
    if not summary["bands"]:
        return ""
    out = [row for row in summary["bands"] if not row["inside"]]
    lines = [
        f"{len(summary['bands']) - len(out)} of {len(summary['bands'])} bands of a study of ten repeats hold what is found"
    ]
    for row in out:
        noise = f"{row['force_noise_N']:g} N, {row['acceleration_noise_m_per_s2']:g} m/s²"
        lines.append(
            f"  not {row['of']} at {noise}: {row['what']} {row['found']:.3g}, band {row['from']:g} to {row['to']:g}"
        )
    return "\n".join(lines)


def _coverage(summary: Mapping[str, Any]) -> str:
    rows = [["95 % intervals hold, %", *summary["coefficients"]]]
    for row in summary["coverage"]:
        if row["force_noise_N"] is None:
            rows.append([row["method"], *(fixed(row["coverage_percent"][name], 1) for name in summary["coefficients"])])
    return aligned(rows) + "\nall levels with noise in the accelerations"


def _ensemble(summary: Mapping[str, Any]) -> str:
    ensemble = summary["ensemble"]
    rows = [
        ["other structures, at 1 m/s²", "within 10 %", *(f"{name}, % from to" for name in MAIN), "to LS, Ktc", "Krc"]
    ]
    for method, count in ensemble["within_10_percent"].items():
        spans = ["–".join(fixed(end, 1) for end in ensemble["range_percent"][method][name]) for name in MAIN]
        ratios = [fixed(ensemble["ratio_to_LS"][method][name], 2) for name in MAIN]
        rows.append([method, f"{count} of {ensemble['structures']}", *spans, *ratios])
    return aligned(rows) + "\nwithin 10 %: Ktc and Krc both; to LS: geometric mean of the ratios of errors"


def _angle(summary: Mapping[str, Any]) -> str:
    angle = summary["angle"]
    rows = [[f"spindle {angle['angle_deg']:g}° off", *(f"{n} {w}" for n in MAIN for w in ("bias", "rmse", "bound"))]]
    for way, row in angle["ways"].items():
        cells = [fixed(row[f"{word}_percent"][name], 1) + " %" for name in MAIN for word in ("bias", "rmse", "bound")]
        rows.append([f"angle {way}", *cells])
    return (
        f"{aligned(rows)}\nGTLS windowed at {angle['acceleration_noise_m_per_s2']:g} m/s²; fitted angle "
        f"{angle['fitted_mean_deg']:.2f} ± {angle['fitted_sd_deg']:.2f}°, its bound ± {angle['bound_sd_deg']:.2f}°"
    )


def _further(summary: Mapping[str, Any]) -> str:
    """Everything of one level; the bound where it is reckoned."""
    further, names = summary["further"], summary["coefficients"]
    if not further["ways"]:
        return ""
    rows = [["what else pays", "answers", *(f"{name} %" for name in names), "bound", *MAIN, "bias Kte", "hold", *names]]
    group = ""
    for row in further["ways"]:
        if row["group"] != group:
            group = row["group"]
            rows.append([group, *[""] * (len(rows[0]) - 1)])
        bound = row["bound_percent"]
        rows.append(
            [
                f"  {row['way']}",
                str(row["answers"]),
                *(fixed(row["rmse_percent"][name], 1) for name in names),
                "",
                *("" if bound is None else fixed(bound[name], 1) for name in MAIN),
                fixed(row["bias_percent"]["Kte"], 1),
                "",
                *(fixed(row["coverage_percent"][name], 0) for name in names),
            ]
        )
    noise = f"{further['force_noise_N']:g} N, {further['acceleration_noise_m_per_s2']:g} m/s²"
    return (
        f"{aligned(rows, gap=1)}\n"
        f"GTLS of windowed H1 at {noise} with 2 harmonics, where nothing else is said; bound: of Cramér, Rao and Fisher\n"
        "hold: 95 % intervals, %; unlinked: as if FRF errors were independent from line to line; by the stages: millcal forces"
    )
