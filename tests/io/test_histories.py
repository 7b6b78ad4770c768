"""A history of coefficients in JSON, as a table and on disk: the numbers of the record in shop units, nothing lost."""

import csv
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from histories import MAKERS, two_cuts, unknown, wide, worn

from millcal.data import CoefficientHistory, Coefficients, Jump
from millcal.errors import RecordingError
from millcal.io.history_table import history_table, write_history_table
from millcal.io.readable import text_of
from millcal.io.results import read_result, write_result
from millcal.io.summaries import summarise, value_at, without_nan
from millcal.units import from_shop

MADE = {name: maker() for name, maker in MAKERS.items()}


@pytest.fixture(params=MADE)
def history(request) -> CoefficientHistory:
    return MADE[request.param]


def test_the_json_is_without_nan_and_holds_what_the_recipes_ask_for(history):
    told = summarise(history)
    json.dumps(told, allow_nan=False)
    assert without_nan(told) == told
    keys = {"verdict", "coefficients", "method", "law", "r2", "residual_rms_N", "checks"}
    assert keys <= set(told)
    assert set(history.names) <= set(told["coefficients"])
    assert (
        value_at(told, f"coefficients.{history.names[0]}_N_per_mm2") == told["coefficients"][history.names[0]]["value"]
    )
    text = text_of(history)
    assert "nan" not in text
    assert "None" not in text
    assert max(map(len, text.splitlines()[:-3])) < 140


def test_the_course_is_thinned_with_both_ends_and_bands_around_the_values():
    history = worn()
    course = summarise(history)["history"]
    assert 40 <= len(course["time_s"]) <= 60
    assert course["time_s"][0] == history.time[0]
    assert course["time_s"][-1] == history.time[-1]
    assert course["kt_N_per_mm2"][-1] == pytest.approx(history.value[-1, 0] / 1e6)
    assert course["mt"][0] == pytest.approx(history.value[0, 2])
    assert course["specific_force_N_per_mm2"]["r"][0] == pytest.approx(history.specific_force[0, 1] / 1e6)
    for name in ("kt_N_per_mm2", "mr"):
        low, high = np.array(course[f"{name}_ci95"]).T
        assert np.all(low < course[name])
        assert np.all(course[name] < high)
    lengths = {len(value) for value in course.values() if isinstance(value, list)}
    assert lengths == {len(course["time_s"])}


def test_wear_and_jumps_are_told_in_per_cent_of_the_specific_force():
    told = summarise(worn())
    assert told["slope_percent_per_min"]["t"] == {
        "value": pytest.approx(60.0), "unit": "%/min", "ci95": [pytest.approx(48.0), pytest.approx(72.0)]
    }  # fmt: skip
    assert value_at(told, "slope_percent_per_min.t") == pytest.approx(60.0)
    (jump,) = told["jumps"]
    by = jump["change_percent"]["t"]
    assert by["value"] == pytest.approx(100 * np.expm1(0.09))
    assert by["ci95"] == pytest.approx([100 * np.expm1(0.09 - 1.96 * 0.012), 100 * np.expm1(0.09 + 1.96 * 0.012)])
    assert jump["time_s"] == pytest.approx(7.44)


def test_what_was_not_measured_or_is_not_known_is_null():
    told = summarise(unknown())
    assert told["r2"] == {"x": None, "y": None, "z": None}
    assert told["residual_rms_N"]["z"] is None
    assert told["chi2"] is None
    assert told["slope_percent_per_min"]["t"]["ci95"] == [None, None]
    assert told["specific_force_end_N_per_mm2"]["t"]["value"] > 0
    huge = replace(worn(), jumps=(Jump(1.0, (900.0, np.nan), (1.0, np.inf), np.inf),))
    assert summarise(huge)["jumps"][0]["change_percent"]["t"]["value"] is None


def test_the_runout_is_told_as_its_parts_and_as_distance_and_direction_from_the_bottom():
    told = summarise(worn())["coefficients"]
    assert told["rho_um"]["value"] == pytest.approx(np.hypot(6.6, 9.5))
    assert told["lambda_deg"]["value"] == pytest.approx(np.degrees(np.arctan2(9.5, 6.6)))
    assert told["rho_um"]["ci95"][0] < told["rho_um"]["value"] < told["rho_um"]["ci95"][1]


def test_the_text_says_the_verdict_the_wear_and_the_jump():
    text = text_of(worn())
    assert "kienzle law by smooth from 1 cut, 12.00 s" in text
    assert "jump at 7.440 s: t +9.42 % (6.874 to 12.02), r +15.5 %" in text
    assert text.endswith("verdict: fits")
    assert "failed: separable" in text_of(wide())


def test_the_table_holds_every_step_and_gives_back_the_record(history, tmp_path):
    path = tmp_path / "course.csv"
    write_history_table(path, history)
    with path.open(newline="", encoding="utf-8") as file:
        heading, *rows = list(csv.reader(file))
    assert heading[:5] == ["time_s", "cut", *(f"{history.names[0]}{k}_N_per_mm2" for k in ("", "_low", "_high"))]
    assert len(rows) == len(history.time)
    assert [row[1] for row in rows] == [history.cuts[int(cut)] for cut in history.cut]
    back = {
        name: from_shop(np.array([float(row[i]) if row[i] else np.nan for row in rows]), name)
        for i, name in enumerate(heading)
        if name != "cut"
    }
    wanted = {"time_s": history.time}
    for i, name in enumerate(history.names):
        for kind, values in (("", history.value), ("_low", history.low), ("_high", history.high)):
            found = next(key for key in back if key == f"{name}{kind}" or key.startswith(f"{name}{kind}_N"))
            wanted[found] = values[:, i]
    for i, direction in enumerate(history.directions):
        wanted[f"specific_{direction}_N_per_mm2"] = history.specific_force[:, i]
        wanted[f"specific_{direction}_high_N_per_mm2"] = history.specific_high[:, i]
    for name, values in wanted.items():
        np.testing.assert_allclose(back[name], values, rtol=1e-9)
    assert np.all(back["reference_chip_um"] == pytest.approx(history.reference_chip))
    assert "nan" not in history_table(history)


def test_a_name_with_a_comma_stays_one_cell():
    named = replace(worn(), cuts=('cuts/"a", b.csv',))
    rows = list(csv.reader(history_table(named).splitlines()))
    assert {len(row) for row in rows} == {len(rows[0])}
    assert rows[1][1] == 'cuts/"a", b.csv'


def test_a_history_comes_back_from_disk_as_it_went(history, tmp_path):
    write_result(tmp_path / "c.h5", history, provenance={})
    back = read_result(tmp_path / "c.h5", CoefficientHistory)
    for field in fields(history):
        a, b = getattr(history, field.name), getattr(back, field.name)
        if "dims" in field.metadata and a is not None:
            np.testing.assert_array_equal(a, b)
        elif field.name == "posterior":
            np.testing.assert_array_equal(a.covariance, b.covariance)
            assert a.names == b.names
        else:
            assert repr(a) == repr(b), field.name
    assert back.jumps == history.jumps
    assert back.runout == history.runout
    assert (back.innovation_samples is None) == (history.innovation_samples is None)


def test_a_reader_that_takes_either_kind_of_coefficients_gets_the_one_there_is(make_record, tmp_path):
    write_result(tmp_path / "h.h5", two_cuts(), provenance={})
    write_result(tmp_path / "c.h5", make_record("coefficients"), provenance={})
    write_result(tmp_path / "m.h5", make_record("modes"), provenance={})
    either = (Coefficients, CoefficientHistory)
    assert type(read_result(tmp_path / "h.h5", either)) is CoefficientHistory
    assert type(read_result(tmp_path / "c.h5", either)) is Coefficients
    with pytest.raises(RecordingError, match="holds Modes where Coefficients or CoefficientHistory is needed; "):
        read_result(tmp_path / "m.h5", either)
    with pytest.raises(RecordingError, match="holds CoefficientHistory where Coefficients is needed"):
        read_result(tmp_path / "h.h5", Coefficients)
