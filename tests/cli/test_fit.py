"""`millcal fit` and `millcal schema` as a shell sees them: stdout, stderr and the exit code."""

import json

import pytest

from millcal.cli import main


@pytest.fixture
def shell(capsys):
    """shell("fit", ...) -> (exit code, stdout, stderr)"""

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        streams = capsys.readouterr()
        return end.value.code, streams.out, streams.err

    return call


CUTS_ONLY = """\
title = "Two cuts"
[[cuts]]
recording = "cut-0.h5"
[[cuts]]
recording = "cut-2.h5"
[conditioning]
harmonics = 6
[coefficients]
method = "average"
"""


def test_the_result_is_short_and_ends_with_the_path_of_the_report(shell, small_recipe, tmp_path):
    code, out, _ = shell("fit", small_recipe(), "--out", tmp_path / "out")
    assert code == 0
    assert out.splitlines()[0] == "Small slot cuts"
    assert out.splitlines()[-1] == f"report: {tmp_path / 'out' / 'report.html'}"
    assert "Ktc" in out
    assert "verdict: fits" in out
    assert len(out.splitlines()) < 50


def test_json_is_one_object_with_the_answers_of_summary_json(shell, small_recipe, tmp_path):
    recipe = small_recipe()
    code, out, _ = shell("fit", recipe, "--out", tmp_path / "out", "--json", "--quiet")
    said = json.loads(out)
    kept = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert code == 0
    assert said["command"] == "fit"
    assert len(said["inputs"][str(recipe)]) == 64
    assert len(said["inputs"]) == 6
    assert said["result"].pop("report") == str(tmp_path / "out" / "report.html")
    assert kept.pop("report") == "report.html"
    assert said["result"] == kept
    assert said["warnings"] == kept["warnings"]
    assert said["notes"] == kept["notes"]


def test_what_a_sound_run_did_is_a_note_and_no_warning(shell, small_recipe, tmp_path):
    code, out, err = shell("fit", small_recipe(), "--out", tmp_path / "out", "--json")
    said = json.loads(out)
    assert code == 0
    assert "offset-removed" in {note["code"] for note in said["notes"]}
    warned = {warning["code"] for warning in said["warnings"]}
    assert warned == {line.split("[")[-1].rstrip("]") for line in err.splitlines()}
    assert not warned & {note["code"] for note in said["notes"]}


def test_a_missed_expectation_is_exit_code_1_and_one_line_that_names_it(shell, small_recipe, tmp_path, recipe_text):
    recipe = small_recipe(recipe_text.replace("[810, 830]", "[900, 910]"))
    code, out, err = shell("fit", recipe, "--out", tmp_path / "out", "--quiet")
    assert code == 1
    assert err.count("\n") == 1
    assert err.startswith(f"error: {recipe}:43: expect.coefficients.Ktc_N_per_mm2: 820.")
    assert "is not within 900 .. 910; " in err
    assert "MISSED" in out
    assert (tmp_path / "out" / "report.html").exists()  # which shows what was missed


def test_an_expectation_of_what_is_not_there_is_missed_too(shell, small_recipe, tmp_path):
    recipe = small_recipe(CUTS_ONLY + '[expect]\n"coefficients.Kxx" = [0, 1]\n')
    code, _, err = shell("fit", recipe, "--out", tmp_path / "out", "--quiet")
    assert code == 1
    assert "there is no such number in the summary; " in err


def test_a_verdict_other_than_fits_is_no_failure_unless_a_gate_is_asked_for(shell, small_recipe, tmp_path):
    bent = small_recipe(
        CUTS_ONLY.replace(
            'recording = "cut-2.h5"',
            'recording = "cut-2.h5"\n[[cuts]]\nrecording = "cut-1.h5"\nspindle_speed_rpm = 6000\n'
            'feed_per_tooth_mm = 0.02\naxial_depth_mm = 2\ndirection = "slot"',
        )
        + "[cutter]\ndiameter_mm = 16\nteeth = 2\nhelix_deg = 30\n"
    )
    code, out, _ = shell("fit", bent, "--out", tmp_path / "out", "--quiet")
    assert "verdict: does not fit" in out or "verdict: fits in part" in out
    assert code == 0
    code, _, err = shell("fit", bent, "--out", tmp_path / "out", "--quiet", "--gate")
    assert code == 1
    assert err.startswith(f"error: {bent}: the verdict is '")


def test_absent_recordings_are_a_notice_and_exit_code_0(shell, small_recipe, tmp_path):
    recipe = small_recipe(CUTS_ONLY.replace("cut-", "none-"))
    code, out, err = shell("fit", recipe, "--out", tmp_path / "out", "--depfile", tmp_path / "inputs.mk")
    assert code == 0
    assert "skipped" in out
    assert "[data-absent]" in err
    assert list(tmp_path.iterdir()) == []
    code, out, _ = shell("fit", recipe, "--out", tmp_path / "out", "--json")
    assert code == 0
    assert [warning["code"] for warning in json.loads(out)["warnings"]] == ["data-absent"]


def test_a_bad_recipe_is_exit_code_3_and_one_line_with_its_line(shell, small_recipe, tmp_path):
    recipe = small_recipe(CUTS_ONLY + "metod = 1\n")
    code, out, err = shell("fit", recipe, "--out", tmp_path / "out")
    assert (code, out) == (3, "")
    assert err == f"error: {recipe}:10: coefficients.metod: unknown key; did you mean method?\n"
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_result_is_exit_code_3(shell, small_recipe, tmp_path):
    (tmp_path / "mine.txt").write_text("")
    code, _, err = shell("fit", small_recipe(CUTS_ONLY), "--out", tmp_path)
    assert code == 3
    assert "mine.txt" in err
    assert err.count("\n") == 1


def test_the_rule_for_make_names_the_recipe_and_every_recording(shell, small_recipe, tmp_path, recordings_folder):
    recipe = small_recipe(CUTS_ONLY)
    rule = tmp_path / "out" / "inputs.mk"
    code, _, _ = shell("fit", recipe, "--out", tmp_path / "out", "--depfile", rule)
    assert code == 0
    assert rule.read_text().splitlines()[0].split() == [
        f"{rule}:", str(recipe), str(recordings_folder / "cut-0.h5"), str(recordings_folder / "cut-2.h5"),
    ]  # fmt: skip
    code, _, _ = shell("fit", recipe, "--out", tmp_path / "out")  # a result with its rule is replaced like any other
    assert code == 0


def test_the_schema_of_recipes_knows_every_table_and_describes_every_key(shell):
    code, out, _ = shell("schema")
    schema = json.loads(out)
    assert code == 0
    assert {"cutter", "cuts", "impact", "stability", "expect", "map"} <= set(schema["properties"])
    assert schema["additionalProperties"] is False
    assert all(entry["description"] for entry in schema["properties"].values())
    code, out, _ = shell("schema", "--setup", "--json")
    assert "conditions" in json.loads(out)["result"]["properties"]
