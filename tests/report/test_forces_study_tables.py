"""The study of forces from accelerations in words and as CSV."""

import csv
import io

import pytest

from millcal.report.forces_study_tables import CHIEF, bands_csv, claims_csv, tables_csv, text_of

METHODS = ["TLS", *CHIEF]
COEFFICIENTS = ["Ktc", "Kte", "Krc", "Kre"]


def errors(factor):
    return {"rmse_percent": {m: {c: factor * (i + 1) for c in COEFFICIENTS} for i, m in enumerate(METHODS)}}


def four(value):
    return dict.fromkeys(COEFFICIENTS, value)


def way(bias):
    return {
        f"{word}_percent": four(value)
        for word, value in (("bias", bias), ("rmse", 2.0), ("bound", 1.5), ("coverage", 95.0))
    }


@pytest.fixture
def summary():
    return {
        "paper": "A paper, Figs. 6-9",
        "seed": 7,
        "repeats": 10,
        "forces": [0.0, 25.0],
        "accelerations": [0.0, 1.0],
        "methods": METHODS,
        "coefficients": COEFFICIENTS,
        "levels": [
            {
                "force_noise_N": f, "acceleration_noise_m_per_s2": a,
                "frf_error_percent": {"plain": 15.0, "windowed": 5.5, "modal": 1.5}, **errors(f + 10 * a + 1e-12),
            }
            for f in (0.0, 25.0) for a in (0.0, 1.0)
        ],
        "by_condition": [{"tooth_passing_hz": 50 + i, "condition_number": 3.0 + i, **errors(1.0)} for i in range(12)],
        "by_frf_error": [{"from_percent": 0.0, "to_percent": 2.5, "variants": 3, **errors(0.5)}],
        "claims": [
            {"printed": "it is, with a comma", "found": "it is not", "holds": False, "said_by": "paper"},
            {"printed": "ours", "found": "so it is", "holds": True, "said_by": "this study"},
        ],
        "bands": [
            {
                "force_noise_N": 0.0, "acceleration_noise_m_per_s2": 1.0, "what": "Ktc, %", "of": "GTLS",
                "found": value, "from": 6.2, "to": 13.0, "inside": value < 13,
            }
            for value in (9.3, 14.5)
        ],
        "coverage": [
            {"method": "GTLS", "force_noise_N": noise, "acceleration_noise_m_per_s2": noise, "coverage_percent": four(held)}
            for noise, held in ((None, 94.4), (5.0, 12.3))
        ],
        "ensemble": {
            "force_noise_N": 0.0, "acceleration_noise_m_per_s2": 1.0, "structures": 30,
            "within_10_percent": {"LS": 0}, "range_percent": {"LS": {"Ktc": [15.2, 82.8], "Krc": [19.3, 128.2]}},
            "ratio_to_LS": {"LS": {"Ktc": 1.0, "Krc": 1.0}}, "each": [{"condition_number": [3.0, 20.0], **errors(2.0)}],
        },
        "angle": {
            "angle_deg": 3.0, "acceleration_noise_m_per_s2": 0.4, "fitted_mean_deg": 2.95, "fitted_sd_deg": 0.62,
            "bound_sd_deg": 0.51, "ways": {"known": way(0.1), "ignored": way(-10.8), "fitted": way(0.2)},
        },
        "further": {
            "force_noise_N": 5.0, "acceleration_noise_m_per_s2": 1.0,
            "ways": [{"group": "three cuts", "way": "three speeds", "answers": 160, **way(0.4)}],
        },
    }  # fmt: skip


def test_the_text_has_a_table_for_each_figure_and_fits_a_screen(summary):
    text = text_of(summary)
    words = (
        "Fig. 6",
        "Fig. 7",
        "Fig. 8",
        "10 repeats (seed 7)",
        "4 levels",
        "0 of 30",
        "2.95 ± 0.62°",
        "−10.8 %",
        "three speeds",
    )
    for word in words:
        assert word in text, word
    assert "Fig. 9" not in text  # of one bin there is nothing to compare
    assert max(len(line) for line in text.splitlines()) < 121
    (row,) = [line for line in text.splitlines() if line.startswith("TLS")]  # only in Fig. 6
    assert row.split()[1:] == ["0/0", "10.0/10.0"]


def test_what_does_not_hold_is_said(summary):
    text = text_of(summary)
    assert "it is, with a comma: does not hold\n    it is not" in text
    assert "ours *: holds" in text
    assert "1 of 2 bands" in text
    assert "not GTLS at 0 N, 1 m/s²: Ktc, % 14.5, band 6.2 to 13" in text


def test_coverage_in_words_is_that_of_all_levels(summary):
    (row,) = [line for line in text_of(summary).splitlines() if line.startswith("GTLS ") and "94.4" in line]
    assert row.split() == ["GTLS", *["94.4"] * 4]
    assert "12.3" not in text_of(summary)


def test_the_csv_has_every_number_once(summary):
    rows = list(csv.DictReader(io.StringIO(tables_csv(summary))))
    assert len(rows) == ((4 + 12 + 1 + 1) * len(METHODS) + 1) * len(COEFFICIENTS)
    keys = [tuple(row.values())[:-1] for row in rows]
    assert len(set(keys)) == len(keys)
    (loud,) = [
        row for row in rows
        if (row["table"], row["force_noise_N"], row["acceleration_noise_m_per_s2"]) == ("level", "25", "1")
        and (row["method"], row["coefficient"]) == ("TLS", "Kre")
    ]  # fmt: skip
    assert float(loud["rmse_percent"]) == pytest.approx(35.0)
    claims = list(csv.DictReader(io.StringIO(claims_csv(summary))))
    assert [(row["printed"], row["holds"]) for row in claims] == [("it is, with a comma", "no"), ("ours", "yes")]
    bands = list(csv.DictReader(io.StringIO(bands_csv(summary))))
    assert [(row["what"], row["inside"]) for row in bands] == [("Ktc, %", "yes"), ("Ktc, %", "no")]
