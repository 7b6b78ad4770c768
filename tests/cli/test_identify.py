"""`millcal identify` from files to coefficients: the contract of its JSON, its refusals, and the same bytes twice."""

import inspect
import json

import numpy as np
import pytest

from millcal.cli import identify as command
from millcal.cli import main
from millcal.data import Coefficients
from millcal.io.results import read_result
from millcal.stages import coefficients as stage
from millcal.stages.coefficients import choice, trends

TRUTH = {"Ktc": 820, "Krc": 260, "Kac": 110, "Kte": 18, "Kre": 16, "Kae": 3}  # of the recordings in conftest


@pytest.fixture
def run(recordings_folder, tmp_path, capsys, monkeypatch):
    """Run the command beside the recordings, the result in an empty folder.   returns (exit code, stdout, stderr)"""
    monkeypatch.chdir(recordings_folder)

    def run(*arguments, cuts=("cut-0.h5", "cut-1.h5", "cut-2.h5")):
        with pytest.raises(SystemExit) as end:
            main(["identify", *cuts, "-o", str(tmp_path / "c.h5"), *arguments])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


@pytest.mark.parametrize("method", ["average", "nls"])
def test_the_truth_of_the_recordings_comes_back_with_the_keys_of_the_contract(run, tmp_path, method):
    code, out, _ = run("--method", method, "--json")
    told = json.loads(out)
    assert code == 0
    assert told["command"] == "identify"
    assert set(told["inputs"]) == {"cut-0.h5", "cut-1.h5", "cut-2.h5"}
    for name, value in TRUTH.items():
        entry = told["result"]["coefficients"][name]
        assert set(entry) >= {"value", "unit", "sd", "ci95"}
        assert entry["unit"] == ("N/mm^2" if name[2] == "c" else "N/mm")
        assert entry["value"] == pytest.approx(value, rel=0.1)
    assert told["result"]["verdict"] == "fits"
    assert set(told["result"]["r2"]) == {"x", "y", "z"}
    saved = read_result(tmp_path / "c.h5", Coefficients)
    assert saved.posterior["Ktc"] / 1e6 == pytest.approx(told["result"]["coefficients"]["Ktc"]["value"])


def test_the_same_command_gives_the_same_bytes(run, tmp_path):
    run()
    first = (tmp_path / "c.h5").read_bytes()
    run()
    assert (tmp_path / "c.h5").read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "cuts", "code", "said"),
    [
        (["--method", "guess"], None, 2, "there are: nls, average"),
        (["--law", "cubic"], None, 2, "there are: linear-edge, kienzle"),
        (["--feed-per-tooth-mm", "0.1"], None, 2, "1 feeds for 3 recordings"),
        (["--method", "average", "--law", "kienzle"], None, 3, "use method nls"),
        (["--method", "average"], ["cut-0.h5"], 3, "one feed per tooth"),
        ([], ["absent.h5"], 3, "absent.h5"),
        ([], ["tap-x.h5"], 3, "tap-x.h5"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_no_file(run, tmp_path, arguments, cuts, code, said):
    found, out, err = run(*arguments, **({"cuts": cuts} if cuts else {}))
    assert (found, out) == (code, "")
    assert said in err
    assert len([line for line in err.splitlines() if line.startswith("error:")]) == 1
    assert "Traceback" not in err
    assert not (tmp_path / "c.h5").exists()


def test_the_choices_of_the_command_are_those_of_the_stage():
    assert set(command.METHODS) == {*choice.FITTING, *choice.FOLLOWING, *choice.FROM_ACCELERATIONS}
    assert set(command.FROM_ACCELERATIONS) == set(choice.FROM_ACCELERATIONS)
    assert set(choice.FITTING) == set(stage.METHODS)
    assert set(command.FOLLOWING) == set(choice.FOLLOWING) == set(trends.METHODS)
    assert set(command.LAWS) == set(stage.LAW_NAMES)
    options = set(inspect.signature(command.identify).parameters)
    assert options >= set(inspect.signature(stage.fit_coefficients).parameters) - {"cuts"}


def test_a_setup_may_leave_the_feed_to_the_command(run, tmp_path):
    setup = tmp_path / "setup.toml"
    setup.write_text(
        "[cutter]\ndiameter_mm = 16\nteeth = 2\nhelix_deg = 30\n"
        '[conditions]\nspindle_speed_rpm = 6000\naxial_depth_mm = 2\ndirection = "slot"\n'
    )
    feeds = [f"--feed-per-tooth-mm={f}" for f in (0.04, 0.07, 0.1)]
    code, out, _ = run("--method", "average", "--json", "--setup", str(setup), *feeds)
    assert code == 0
    assert np.isclose(json.loads(out)["result"]["coefficients"]["Ktc"]["value"], TRUTH["Ktc"], rtol=0.01)
    code, _, err = run("--method", "average", "--setup", str(setup))
    assert code == 3
    assert "feed_per_tooth_mm: is missing" in err


def test_a_feed_given_by_hand_goes_before_the_file(run):
    code, out, _ = run("--method", "average", "--json", *[f"--feed-per-tooth-mm={f}" for f in (0.08, 0.14, 0.2)])
    assert code == 0
    assert np.isclose(json.loads(out)["result"]["coefficients"]["Ktc"]["value"], TRUTH["Ktc"] / 2, rtol=0.01)
