"""Forces from accelerations in JSON, as text, as a table and on disk: numbers of the record in shop units, nothing lost."""

import csv
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from reconstructed_forces import MAKERS, advice, bare, four_teeth, reconstructed, two_cuts, vibrations

from millcal.data import CutForce, CutVibration, ForceHarmonics, Record, SpeedAdvice
from millcal.errors import RecordingError
from millcal.io.force_readable import compared_text
from millcal.io.force_table import force_table
from millcal.io.readable import brief_of, text_of
from millcal.io.results import read_result, read_results, write_result, write_results
from millcal.io.summaries import summarise, value_at, without_nan

MADE = {name: maker() for name, maker in MAKERS.items()}
SIX = {"Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"}


@pytest.fixture(params=MADE)
def forces(request) -> ForceHarmonics:
    return MADE[request.param]


def equal(one, other) -> bool:
    """Whether two records hold the same, arrays with their types, and nan is nan."""
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, Record):
            same = type(a) is type(b) and equal(a, b)
        elif "dims" in field.metadata and a is not None:
            same = b is not None and np.asarray(a).dtype.kind == b.dtype.kind and np.array_equal(a, b, equal_nan=True)
        else:
            same = a == b or (a != a and b != b)
        if not same:
            return False
    return True


def test_the_json_is_without_nan_and_names_all_six_coefficients(forces):
    told = summarise(forces)
    json.dumps(told, allow_nan=False)
    assert without_nan(told) == told
    assert set(told["coefficients"]) == SIX
    for name, entry in told["coefficients"].items():
        assert set(entry) == {"value", "unit", "sd", "ci95"}
        assert entry["unit"] == ("N/mm^2" if name[2] == "c" else "N/mm")
        assert (entry["value"] is None) == (name in told["unobservable"])
    assert set(told["unobservable"]) == SIX - set(forces.posterior.names)
    assert len(told["harmonics"]) == len(forces.order)
    assert value_at(told, "coefficients.Kte_N_per_mm") == pytest.approx(forces.posterior["Kte"] / 1e3)


def test_a_harmonic_is_told_as_the_transform_of_one_revolution_gives_it():
    """rfft(x) / n of the force that the lines make, and its peak amplitude in a turn of that harmonic."""
    forces = MADE["a slot"]
    told = summarise(forces)
    assert "numpy.fft.rfft(x) / n" in told["convention"]
    n = 360
    angle = 2 * np.pi * np.arange(n) / n
    for row, line in enumerate(told["harmonics"]):
        order = line["spindle_harmonic"]
        assert line["k"] * forces.cutter.teeth == order
        for i, axis in enumerate(forces.axes):
            x = np.real(forces.force[row, i] * np.exp(1j * order * angle))
            coefficient = np.fft.rfft(x)[order] / n
            assert line[f"F{axis}_N"] == pytest.approx([coefficient.real, coefficient.imag])
            assert line[f"F{axis}_amplitude_N"] == pytest.approx(abs(forces.force[row, i]))


def test_the_deviation_of_an_amplitude_is_that_of_draws_around_it():
    forces = MADE["a slot"]
    rng = np.random.default_rng(0)
    line, axes = 0, len(forces.axes)
    parts = np.concatenate([forces.force[line].real, forces.force[line].imag])
    draws = rng.multivariate_normal(parts, 1e-2 * forces.force_covariance[line], 20_000)
    spread = 10 * np.abs(draws[:, :axes] + 1j * draws[:, axes:]).std(axis=0)
    told = summarise(forces)["harmonics"][line]
    assert [told[f"F{axis}_sd_N"] for axis in forces.axes] == pytest.approx(spread, rel=0.03)


def test_an_axis_without_an_input_and_a_harmonic_between_the_teeth_are_null():
    forces = replace(two_cuts(), order=two_cuts().order + 1)
    line = summarise(forces)["harmonics"][0]
    assert (line["Fz_N"], line["Fz_amplitude_N"], line["Fz_sd_N"]) == (None, None, None)
    assert line["k"] is None
    assert line["spindle_harmonic"] == 3
    assert "3/2" in text_of(forces)


def test_a_phase_that_was_not_fitted_has_no_interval_and_one_that_was_has():
    assert summarise(two_cuts())["phase_deg_ci95"] == [None, None]
    told = summarise(reconstructed())
    assert told["phase_deg"] == pytest.approx([41.3])
    assert told["phase_deg_ci95"][0] == pytest.approx([41.3 - 1.96 * 0.47, 41.3 + 1.96 * 0.47])
    assert told["phase_from"] == "fitted"


def test_methods_stand_beside_each_other_with_their_units_and_the_recommended_one_is_marked():
    forces = MADE["a slot"]
    told = summarise(forces)
    assert list(told["compared"]) == list(forces.compared_methods)
    assert told["compared"]["rtls"]["Ktc_N_per_mm2"] == pytest.approx(forces.compared[4, 0] / 1e6)
    assert told["compared"]["gtls"]["Kte_N_per_mm_sd"] == pytest.approx(
        forces.compared_sd[5, forces.posterior.names.index("Kte")] / 1e3
    )
    assert told["compared"]["tls"]["Ktc_N_per_mm2_sd"] is None
    lines = compared_text(forces).splitlines()
    (marked,) = [line for line in lines if "used, recommended" in line]
    assert marked.startswith("gtls")
    assert lines[-1] == f"recommended: gtls, because {forces.recommended_why}"


def test_the_text_says_what_cannot_be_told_and_has_no_nan(forces):
    for text in (text_of(forces), brief_of(forces), compared_text(forces)):
        assert "nan" not in text
        assert "None" not in text
        assert max(map(len, text.splitlines())) < 170
    assert len(brief_of(forces)) < len(text_of(forces))
    missing = SIX - set(forces.posterior.names)
    if missing:
        (line,) = [line for line in text_of(forces).splitlines() if line.startswith("these lines do not tell")]
        assert all(name in line for name in missing)
    assert f"verdict: {forces.verdict}" in text_of(forces)


def test_combinations_that_cannot_be_told_apart_are_told_as_such():
    forces = replace(four_teeth(), unobservable=(("Ktc", "Kte"), ("Kac",)))
    assert summarise(forces)["unobservable_combinations"] == [["Ktc", "Kte"]]
    assert "cannot tell apart: Ktc with Kte" in text_of(forces)


def test_a_sensor_that_tells_nothing_is_named():
    share = np.array([0.5, 0.3, 0.19, 0.005, 0.005, 0.0])
    assert "spindleY" not in text_of(MADE["a slot"]).split("verdict")[0]
    text = text_of(replace(reconstructed(), sensor_share=share))
    (line,) = [line for line in text.splitlines() if line.startswith("sensors that tell next to nothing")]
    assert [dof in line for dof in reconstructed().sensors] == [False, False, False, True, True, True]


def test_the_table_is_the_harmonics_of_the_json(forces):
    rows = list(csv.DictReader(force_table(forces).splitlines()))
    told = summarise(forces)["harmonics"]
    assert len(rows) == len(told)
    for row, line in zip(rows, told, strict=True):
        assert (row["cut"], int(row["spindle_harmonic"])) == (line["cut"], line["spindle_harmonic"])
        assert float(row["frequency_hz"]) == pytest.approx(line["frequency_hz"])
        for axis in forces.axes:
            assert [float(row[f"F{axis}_re_N"]), float(row[f"F{axis}_im_N"])] == pytest.approx(line[f"F{axis}_N"])
            sd = line[f"F{axis}_sd_N"]
            assert row[f"F{axis}_sd_N"] == "" if sd is None else float(row[f"F{axis}_sd_N"]) == pytest.approx(sd)
    assert "Fz_re_N" not in rows[0] or "z" in forces.axes


def test_advice_tells_the_best_speeds_in_rpm():
    told = summarise(advice(("Ktc", "Krc")))
    assert [best["rpm"] for best in told["best"]] == pytest.approx([2400, 1950, 2800])
    assert set(told["best"][0]["relative_sd"]) == {"Ktc", "Krc"}
    assert len(told["curve"]["rpm"]) == len(told["curve"]["relative_sd"]["Ktc"]) == 200
    assert "2400" in text_of(advice(("Ktc",)))
    assert summarise(MADE["a slot"])["advice"]["harmonics"] == 3
    nowhere = replace(advice(("Ktc",)), best=(), relative_sd=np.full((200, 1), np.inf))
    json.dumps(summarise(nowhere), allow_nan=False)
    assert "nan" not in text_of(nowhere)


def test_a_record_comes_back_from_disk_as_it_was_and_the_same_bytes_twice(forces, tmp_path):
    for name in ("a.h5", "b.h5"):
        write_result(tmp_path / name, forces, provenance={})
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert equal(read_result(tmp_path / "a.h5", ForceHarmonics), forces)


def test_the_cuts_behind_the_forces_come_back_and_are_told_apart_from_measured_forces(tmp_path):
    cuts = vibrations(two_cuts())
    write_results(tmp_path / "cuts.h5", cuts, provenance={})
    back = read_results(tmp_path / "cuts.h5", (CutForce, CutVibration))
    assert all(equal(a, b) for a, b in zip(cuts, back, strict=True))
    told = summarise(back[0])
    json.dumps(told, allow_nan=False)
    assert set(told["ac_rms_m_per_s2"]) == set(cuts[0].sensors)
    with pytest.raises(RecordingError, match="holds CutVibration where CutForce is needed"):
        read_results(tmp_path / "cuts.h5", CutForce)


def test_a_file_of_another_kind_says_which_command_makes_the_one_that_is_needed(tmp_path):
    write_result(tmp_path / "f.h5", bare(), provenance={})
    write_result(tmp_path / "a.h5", advice(("Ktc",)), provenance={})
    with pytest.raises(RecordingError, match=r"holds SpeedAdvice where ForceHarmonics is needed; .*millcal forces"):
        read_result(tmp_path / "a.h5", ForceHarmonics)
    with pytest.raises(RecordingError, match=r"holds ForceHarmonics where SpeedAdvice is needed; .*--advise"):
        read_result(tmp_path / "f.h5", SpeedAdvice)
