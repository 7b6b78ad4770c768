"""A published experiment again, beside its own numbers: `millcal study`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, Quiet, progress_bar, reply

FILES = tuple(
    ["summary.json", "table.txt", "table.csv", "ratios.csv", "courses.csv"]
    + [f"{name}.{format}" for name in ("errors", "coefficients") for format in ("png", "svg")]
)


class Name(StrEnum):
    """The studies there are."""

    trending_coefficients = "trending-coefficients"


def study(
    name: Annotated[Name, typer.Argument(metavar="NAME", help="trending-coefficients.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for tables and figures; an old study there is replaced.")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer starts and fewer draws of the noise.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of everything random.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a published experiment again and set its numbers beside the paper's.

    trending-coefficients: Schwenzer et al. 2020, Table 3 and Figures 2 and 3. Sixteen ensemble Kalman filters and least squares
    follow cutting coefficients that rest, rise or swing, and so do two methods that the paper did not try.

    Example: millcal study trending-coefficients --out build/trending-coefficients --quick
    """
    import json

    from millcal.io.provenance import provenance
    from millcal.io.replacing import check_folder, replaced_folder, tidy_remains
    from millcal.report.trending_tables import courses_csv, ratios_csv, table_csv, text_of
    from millcal.studies.trending_coefficients import FULL, QUICK, run
    from millcal.studies.trending_summary import summarise

    tidy_remains(out.resolve())
    check_folder(out, FILES.__contains__, "study")
    with progress_bar(quiet) as progress:
        found = run(QUICK if quick else FULL, seed=seed, progress=progress)
    summary = {**summarise(found), "quick": quick}
    text = text_of(summary)
    files = {
        "summary.json": json.dumps(
            {**summary, "provenance": provenance([], seed=seed)}, indent=1, ensure_ascii=False, allow_nan=False
        )
        + "\n",
        "table.txt": text + "\n",
        "table.csv": table_csv(summary),
        "ratios.csv": ratios_csv(summary),
        "courses.csv": courses_csv(_courses(found)),
        **_figures(found),
    }
    with replaced_folder(out) as folder:
        for file, content in files.items():
            (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    result = {**summary, "output": str(out), "files": [str(out / file) for file in files]}
    lines = [text, "", *(f"{out / file}" for file in files)]
    reply("study", "\n".join(lines), result, inputs={}, notices=(), as_json=as_json, quiet=quiet)


def _drawn() -> dict[str, str]:
    """The methods that are drawn, and what they are called there."""
    from millcal.studies.trending_coefficients import ENKF, MODELS, RLS, SMOOTHER, STARRED

    return {RLS: RLS, ENKF: ENKF, STARRED: f"{ENKF}*", MODELS: MODELS, SMOOTHER: SMOOTHER}


QUANTITIES = ("force_error_N", "kt_N_per_mm2", "mt")


def _figures(found: Any) -> dict[str, bytes]:
    """Both figures, for a screen and for print."""
    from millcal.report.paper import sheet, trending
    from millcal.studies.trending_coefficients import CHOSEN, MODELS, SMOOTHER, STARRED

    drawn = _drawn()
    errors, specific, rise = (
        {
            label: {
                case: trending.Course(runs.mean[q], runs.deviation[q], own=method == SMOOTHER)
                for case, runs in found.runs[method].items()
            }
            for method, label in drawn.items()
        }
        for q in range(len(QUANTITIES))
    )
    rms = {drawn[m]: {case: runs.force_rms for case, runs in found.runs[m].items()} for m in drawn}
    truth = {case: (values[:, 0], values[:, 1]) for case, values in found.truth.items()}
    further = [MODELS, SMOOTHER]
    groups = {"published": [drawn[m] for m in drawn if m not in further], "others": further}
    with sheet.style():
        figures = {
            "errors": trending.errors(errors, rms, {drawn[STARRED]: CHOSEN[0]}),
            "coefficients": trending.coefficients(specific, rise, truth, groups),
        }
        return {
            f"{name}.{format}": sheet.file_bytes(figure, format)
            for name, figure in figures.items()
            for format in ("png", "svg")
        }


def _courses(found: Any) -> dict[str, Any]:
    """What the figures draw, by heading."""
    columns: dict[str, Any] = {}
    for case, truth in found.truth.items():
        columns[f"{case} truth kt_N_per_mm2"], columns[f"{case} truth mt"] = truth[:, 0], truth[:, 1]
        for method in _drawn():
            runs = found.runs[method][case]
            for number, quantity in enumerate(QUANTITIES):
                columns[f"{case} {method} {quantity}"] = runs.mean[number]
                columns[f"{case} {method} {quantity} sd"] = runs.deviation[number]
    return columns
