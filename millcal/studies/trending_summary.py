"""What the study of trending coefficients found, as plain numbers with their units in the keys."""

from typing import Any

import numpy as np

from millcal.studies.trending_coefficients import ENSEMBLES, PAPER, PAPER_CASES, Paired, Study, samples_at_work


def summarise(study: Study) -> dict[str, Any]:
    """The result of the study for JSON.

    Of a method in a case: the force error over all starts on one draw of the noise, its mean and standard deviation over
    other draws, what the paper prints, and the errors of k_t and m_t in the second half of the record.
    """
    table = [_row(study, method) for method in study.runs]
    return {
        "study": "trending-coefficients",
        "paper": "Schwenzer et al., Identifying trending model coefficients with an ensemble Kalman filter, IFAC 2020, Table 3",
        "seed": study.seed,
        **study.extent._asdict(),
        "active_samples": samples_at_work(),
        "table": table,
        "rms_log_ratio_to_paper": {
            case: {
                "one_draw": _distance([row["cases"][case]["force_rms_N"] for row in table], case, table),
                "mean_of_draws": _distance([row["cases"][case]["force_rms_mean_N"] for row in table], case, table),
            }
            for case in PAPER_CASES
        },
        "ratios": [_ratio(paired) for paired in study.claims],
        "smoother": {case: {"model": model, "jumps": jumps} for case, (model, jumps) in study.smoothers.items()},
    }


def _row(study: Study, method: str) -> dict[str, Any]:
    setting = ENSEMBLES.get(method)
    scatter = study.scatter[method]
    cases = {}
    for column, case in enumerate(PAPER_CASES):
        runs, draws = study.runs[method][case], scatter[:, column]
        cases[case] = {
            "force_rms_N": runs.force_rms,
            "force_rms_mean_N": float(draws.mean()),
            "force_rms_sd_N": float(draws.std(ddof=1)) if len(draws) > 1 else None,
            "paper_N": PAPER[setting][column] if method in ENSEMBLES else None,
            "kt_rms_N_per_mm2": runs.k_rms,
            "mt_rms": runs.m_rms,
        }
    step, divisor = setting or (None, None)
    return {"method": method, "step": step, "lambda": divisor, "cases": cases}


def _distance(ours: list[float], case: str, table: list[dict[str, Any]]) -> float:
    """Root mean square of ln(ours / paper) over the settings that the paper prints."""
    printed = [row["cases"][case]["paper_N"] for row in table]
    logarithms = [np.log(value / paper) for value, paper in zip(ours, printed, strict=True) if paper is not None]
    return float(np.sqrt(np.mean(np.square(logarithms))))


def _ratio(paired: Paired) -> dict[str, Any]:
    claim, ratios = paired.claim, paired.ratios
    return {
        "method": claim.method,
        "other": claim.other,
        "case": claim.case,
        "expected": "smaller" if claim.smaller else "larger",
        "said_by": "paper" if claim.said else "this study",
        "paper": paired.paper,
        "mean": float(ratios.mean()),
        "least": float(ratios.min()),
        "most": float(ratios.max()),
        "holds": paired.holds,
        "draws": len(ratios),
    }
