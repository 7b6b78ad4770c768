"""The study in words and as CSV."""

import csv
import io

import numpy as np
import pytest

from millcal.report.trending_tables import courses_csv, ratios_csv, table_csv, text_of


def cell(value, paper):
    return {
        "force_rms_N": value, "force_rms_mean_N": value + 0.5, "force_rms_sd_N": 0.75, "paper_N": paper,
        "kt_rms_N_per_mm2": 101.4, "mt_rms": 0.0213,
    }  # fmt: skip


SUMMARY = {
    "paper": "A paper, Table 3",
    "seed": 7,
    "starts": 24,
    "draws": 4,
    "starts_of_draw": 8,
    "table": [
        {"method": "EnKF* 50, 10", "step": 50, "lambda": 10.0, "cases": {"static": cell(6.4321, 6.4)}},
        {"method": "EnKF* 100, 10", "step": 100, "lambda": 10.0, "cases": {"static": cell(5.5, 5.6)}},
        {"method": "RLS", "step": None, "lambda": None, "cases": {"static": cell(17.5, None)}},
    ],
    "rms_log_ratio_to_paper": {"static": {"one_draw": 0.163, "mean_of_draws": 0.1}},
    "ratios": [
        {
            "method": "EnKF* 50, 10", "other": "RLS", "case": "static", "expected": "smaller", "said_by": "paper",
            "paper": None, "mean": 0.91, "least": 0.6, "most": 1.2, "holds": 2, "draws": 4,
        }
    ],
}  # fmt: skip


def test_the_text_sets_ours_beside_the_papers_and_says_what_does_not_hold():
    text = text_of(SUMMARY)
    (row,) = [line for line in text.splitlines() if line.startswith("EnKF* 50, 10   ") and "6.4" in line]
    assert row.split()[3:] == ["6.4", "6.9", "±", "0.8", "6.4"]
    assert "static 16 %" in text
    assert "< 1 in 2 of 4" in text
    assert "24 initial ensembles" in text
    assert "seed 7" in text
    assert max(len(line) for line in text.splitlines()) < 110


def test_a_number_that_the_paper_does_not_print_is_a_dash_in_words_and_empty_in_csv():
    (row,) = [line for line in text_of(SUMMARY).splitlines() if line.startswith("RLS") and "17.5" in line]
    assert row.endswith("–")
    rows = list(csv.DictReader(io.StringIO(table_csv(SUMMARY))))
    assert [row["paper_N"] for row in rows] == ["6.4", "5.6", ""]
    assert rows[2]["step"] == rows[2]["lambda"] == ""


def test_the_csv_keeps_digits_and_names_with_commas():
    rows = list(csv.DictReader(io.StringIO(table_csv(SUMMARY))))
    assert rows[0]["method"] == "EnKF* 50, 10"
    assert float(rows[0]["force_rms_N"]) == pytest.approx(6.4321)
    (ratio,) = csv.DictReader(io.StringIO(ratios_csv(SUMMARY)))
    assert (ratio["method"], ratio["other"], ratio["holds"], ratio["draws"]) == ("EnKF* 50, 10", "RLS", "2", "4")


def test_coefficients_are_told_of_methods_and_not_of_every_setting():
    block = text_of(SUMMARY).split("\n\n")[2]
    assert "EnKF* 50, 10" in block
    assert "EnKF* 100, 10" not in block
    assert "0.021" in block


def test_courses_are_a_column_each():
    text = courses_csv({"a, mt": np.array([0.1, 0.25]), "b": np.array([1.0, np.nan])})
    assert text == '"a, mt",b\n0.1,1\n0.25,\n'
