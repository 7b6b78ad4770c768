"""Schwenzer et al. 2020 for the command line: which files its study leaves, and what is drawn."""

from typing import Any

from millcal.cli.studies import Made, Progress, figure_files, names_of

FILES = names_of(("table.txt", "table.csv", "ratios.csv", "courses.csv"), ("errors", "coefficients"))
QUANTITIES = ("force_error_N", "kt_N_per_mm2", "mt")


def make(quick: bool, seed: int, progress: Progress) -> Made:
    """Run the study and lay out what it found."""
    from millcal.report.trending_tables import courses_csv, ratios_csv, table_csv, text_of
    from millcal.studies import trending_coefficients
    from millcal.studies.trending_summary import summarise

    extent = trending_coefficients.QUICK if quick else trending_coefficients.FULL
    found = trending_coefficients.run(extent, seed=seed, progress=progress)
    summary = summarise(found)
    text = text_of(summary)
    files: dict[str, str | bytes] = {
        "table.txt": text + "\n",
        "table.csv": table_csv(summary),
        "ratios.csv": ratios_csv(summary),
        "courses.csv": courses_csv(_courses(found)),
        **figures(found),
    }
    return Made(summary, text, files)


def _drawn() -> dict[str, str]:
    """The methods that are drawn, and what they are called there."""
    from millcal.studies.trending_coefficients import ENKF, MODELS, RLS, SMOOTHER, STARRED

    return {RLS: RLS, ENKF: ENKF, STARRED: f"{ENKF}*", MODELS: MODELS, SMOOTHER: SMOOTHER}


def figures(found: Any) -> dict[str, bytes]:
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
        return figure_files(
            {
                "errors": trending.errors(errors, rms, {drawn[STARRED]: CHOSEN[0]}),
                "coefficients": trending.coefficients(specific, rise, truth, groups),
            }
        )


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
