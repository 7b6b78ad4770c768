"""Pawelko et al. 2012 for the command line: which files its study leaves, and what is drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

from millcal.cli.studies import Made, Progress, figure_files, names_of

DRAWN = ("acceleration_noise", "force_noise", "condition_number", "frf_error")  # Figs. 6 to 9 of the paper
FILES = names_of(("table.txt", "tables.csv", "claims.csv", "bands.csv"), DRAWN)
COEFFICIENTS = ("Ktc", "Krc")


def make(quick: bool, seed: int, progress: Progress) -> Made:
    """Run the study and lay out what it found."""
    from millcal.report.forces_study_tables import bands_csv, claims_csv, tables_csv, text_of
    from millcal.studies import forces_from_accelerations
    from millcal.studies.forces_summary import summarise

    extent = forces_from_accelerations.QUICK if quick else forces_from_accelerations.FULL
    summary = summarise(forces_from_accelerations.run(extent, seed=seed, progress=progress))
    text = text_of(summary)
    files: dict[str, str | bytes] = {
        "table.txt": text + "\n",
        "tables.csv": tables_csv(summary),
        "claims.csv": claims_csv(summary),
        "bands.csv": bands_csv(summary),
        **figures(summary),
    }
    return Made(summary, text, files)


def figures(summary: Mapping[str, Any]) -> dict[str, bytes]:
    """The paper's four figures with more methods, for a screen and for print."""
    from millcal.report.paper import forces_from_accelerations as paper
    from millcal.report.paper import sheet
    from millcal.studies.forces_methods import GCV, GTLS, GTLS_MODAL, GTLS_WINDOWED, L_CURVE, LS, LS_ALL, RTLS, TLS
    from millcal.studies.forces_summary import LIMIT

    methods = (LS, TLS, GCV, L_CURVE, RTLS, LS_ALL, GTLS, GTLS_WINDOWED, GTLS_MODAL)
    looks = paper.looks_of(methods)
    beside = tuple(method for method in methods if method != TLS)  # the paper draws it in Fig. 6 alone

    def drawn(
        rows: Sequence[Mapping[str, Any]], abscissa: Sequence[float], names: Sequence[str], **options: Any
    ) -> Any:
        panels = {
            name: {method: [row["rmse_percent"][method][name] for row in rows] for method in names}
            for name in COEFFICIENTS
        }
        return paper.errors(abscissa, panels, limit=LIMIT, looks=looks, **options)

    def level(key: str, other: str) -> tuple[Sequence[Mapping[str, Any]], list[float]]:
        rows = [row for row in summary["levels"] if row[other] == 0]
        return rows, [row[key] for row in rows]

    force, acceleration = "force_noise_N", "acceleration_noise_m_per_s2"
    conditions, bins = summary["by_condition"], summary["by_frf_error"]
    with sheet.style():
        return figure_files(
            {
                DRAWN[0]: drawn(*level(acceleration, force), methods, label="noise of the accelerations (m/s²)"),
                DRAWN[1]: drawn(*level(force, acceleration), beside, label="noise of the hammer (N)"),
                DRAWN[2]: drawn(
                    conditions,
                    [row["condition_number"] for row in conditions],
                    beside,
                    label="condition number of the FRF (1)",
                    log=True,
                ),
                DRAWN[3]: drawn(
                    bins,
                    [(row["from_percent"] + row["to_percent"]) / 2 for row in bins],
                    beside,
                    label="error of the FRF (%)",
                ),
            }
        )
