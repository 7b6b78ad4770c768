"""`millcal forces` and `millcal identify --method gtls`: from recordings to forces, what they leave on disk, what is refused."""

import csv
import inspect
import json

import numpy as np
import pytest
from heard_recordings import CUTS, CUTTER_KEYS, PULSE_ANGLE, TAPS, TRUTH, record_all

from millcal.cli import forces as command
from millcal.cli import identify, main
from millcal.data import Coefficients, ForceHarmonics, SpeedAdvice, StabilityMap
from millcal.io.recipe_tables import ForcesTable
from millcal.io.results import read_provenance, read_result
from millcal.stages import forces as stage
from millcal.stages.forces import methods

SETUP = (
    CUTTER_KEYS
    + '[conditions]\nspindle_speed_rpm = 3360\nfeed_per_tooth_mm = 0.15\naxial_depth_mm = 2\ndirection = "slot"\n'
)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Cuts, hits, the FRF and its modes, and a setup.   returns the folder"""
    folder = tmp_path_factory.mktemp("heard")
    record_all(folder)
    (folder / "setup.toml").write_text(SETUP)
    (folder / "cutter.toml").write_text(CUTTER_KEYS)
    for arguments in (
        ["frf", *(str(folder / tap) for tap in TAPS), "-o", str(folder / "frf.h5"), "-q"],
        ["modes", str(folder / "frf.h5"), "-o", str(folder / "modes.h5"), "-q"],
    ):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 0
    return folder


@pytest.fixture
def run(recordings, tmp_path, capsys, monkeypatch):
    """Run a command beside the recordings.   returns (exit code, stdout, stderr)"""
    monkeypatch.chdir(recordings)
    capsys.readouterr()

    def run(*arguments, name="forces", cuts=CUTS, frf="frf.h5", output="f.h5"):
        words = [name, *cuts]
        words += ["--frf", frf] if frf else []
        words += ["-o", str(tmp_path / output)] if output else []
        with pytest.raises(SystemExit) as end:
            main([*words, *map(str, arguments)])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


def found(out):
    """The result that a command with --json printed."""
    return json.loads(out)["result"]


def test_the_truth_of_the_recordings_comes_back_with_the_keys_of_the_contract(run, tmp_path):
    code, out, _ = run("--json")
    told = json.loads(out)
    assert code == 0
    assert told["command"] == "forces"
    assert set(told["inputs"]) == {*CUTS, "frf.h5"}
    result = told["result"]
    assert {"harmonics", "condition_number", "regularization", "bandwidth_hz", "convention", "constraint"} <= set(
        result
    )
    for name, value in TRUTH.items():
        entry = result["coefficients"][name]
        assert entry["value"] == pytest.approx(value, rel=0.03), name
        assert entry["ci95"][0] < entry["value"] < entry["ci95"][1]
    assert result["coefficients"]["Kae"]["value"] is None
    assert result["unobservable"] == ["Kae"]
    assert result["constraint"]["rank"] == 5
    assert result["phase_deg"] == pytest.approx([np.degrees(PULSE_ANGLE)] * 2, abs=0.5)
    assert [sensor["dof"] for sensor in result["sensors"]] == ["noseX", "noseY", "noseZ", "headX", "headY", "headZ"]
    assert sum(sensor["share"] for sensor in result["sensors"]) == pytest.approx(1.0)
    first = result["harmonics"][0]
    assert (first["cut"], first["k"], first["spindle_harmonic"]) == (CUTS[0], 1, 2)
    assert first["frequency_hz"] == pytest.approx(112.0, abs=0.1)
    # exact force of this slot: Fx1 = a_p f_z (Krc/4 + j Ktc/4) + a_p (2 Kre + 4j Kte)/(3 pi)
    exact = 2 * 0.15 * (700 + 1000j) / 4 + 2 * (2 * 30 + 4j * 50) / (3 * np.pi)
    assert complex(*first["Fx_N"]) == pytest.approx(exact, rel=0.02)
    assert first["Fx_amplitude_N"] == pytest.approx(2 * abs(complex(*first["Fx_N"])))
    saved = read_result(tmp_path / "f.h5", ForceHarmonics)
    assert saved.posterior["Ktc"] / 1e6 == pytest.approx(result["coefficients"]["Ktc"]["value"])
    assert read_provenance(tmp_path / "f.h5")["inputs"] == told["inputs"]


def test_the_same_command_gives_the_same_bytes(run, tmp_path):
    written = []
    for name in ("a.h5", "b.h5"):
        table = tmp_path / f"{name}.csv"
        assert run("--csv", table, "--advise", output=name)[0] == 0
        written.append(((tmp_path / name).read_bytes(), table.read_bytes()))
    assert written[0] == written[1]


def test_compare_prints_every_method_and_marks_the_recommended_one(run):
    code, out, _ = run("--compare")
    assert code == 0
    for method in command.METHODS:
        assert sum(line.split("  ")[0] == method for line in out.splitlines()) == 1
    assert "recommended: " in out
    assert "methods side by side" not in run()[1]


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("ls", []),
        ("tls", []),
        ("tikhonov", ["--regularization", "1e-5"]),
        ("constrained-ls", []),
        ("rtls", ["--slack-N", "0.01"]),
    ],
)
def test_every_method_reconstructs_the_force(run, method, options):
    code, out, err = run("--method", method, "--json", *options)
    assert code == 0, err
    result = found(out)
    assert result["method"] == method
    amplitude = next(line["Fy_amplitude_N"] for line in result["harmonics"] if line["k"] == 1)
    assert amplitude == pytest.approx(248.0, rel=0.05)
    if method == "tikhonov":
        assert (result["regularization"], result["regularization_from"]) == (1e-5, "given")


@pytest.mark.parametrize(
    "options",
    [
        ["--harmonics", "2"],
        ["--phase", "known", "--spindle-phase-deg", str(np.degrees(PULSE_ANGLE))],
        ["--modes", "modes.h5"],
        ["--setup", "cutter.toml"],
    ],
    ids=lambda options: options[0],
)
def test_options_reach_the_stage_and_the_truth_still_comes_back(run, options):
    code, out, err = run(*options, "--json")
    assert code == 0, err
    result = found(out)
    assert result["coefficients"]["Ktc"]["value"] == pytest.approx(TRUTH["Ktc"], rel=0.06)
    lines = len(result["harmonics"])
    assert lines == 4 if "--harmonics" in options else lines > 8  # as many as the FRF covers
    assert result["phase_from"] == ("stated" if "--phase" in options else "fitted")
    assert result["frf_from"] == ("modes" if "--modes" in options else "measured")


def test_table_and_figure_are_written_and_told_of(run, tmp_path):
    table, figure = tmp_path / "h.csv", tmp_path / "h.svg"
    code, out, _ = run("--csv", table, "--figure", figure)
    assert code == 0
    assert out.splitlines()[-2:] == [f"csv: {table}", f"figure: {figure}"]
    assert len(list(csv.DictReader(table.open(newline="")))) == 20
    assert b"<svg" in figure.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f.h5", "h.csv", "h.svg"]


def test_advice_needs_no_cut_and_with_cuts_it_knows_what_they_told(run, tmp_path):
    code, out, err = run("--advise", "--setup", "setup.toml", "--rpm", 2000, 6000, "--json", cuts=(), output=None)
    assert code == 0, err
    assert json.loads(out)["result"]["output"] is None
    alone = found(out)["advice"]
    assert pytest.approx([alone["curve"]["rpm"][0], alone["curve"]["rpm"][-1]]) == [2000, 6000]
    assert all(2000 <= best["rpm"] <= 6000 for best in alone["best"])
    assert alone["best"]
    assert list(tmp_path.iterdir()) == []
    code, out, _ = run("--advise", "--rpm", 2000, 6000, "--json")
    more, known = found(out)["advice"], found(out)["coefficients"]["Ktc"]
    assert more["curve"]["rpm"] == alone["curve"]["rpm"]
    assert max(more["curve"]["relative_sd"]["Ktc"]) <= 1.001 * known["sd"] / known["value"]
    assert read_result(tmp_path / "f.h5", ForceHarmonics).advice is not None
    figure = tmp_path / "a.png"
    code, out, _ = run("--advise", "--setup", "setup.toml", "--figure", figure, cuts=(), output="a.h5")
    assert code == 0
    assert "best spindle speeds" in out
    assert out.splitlines()[-1] == f"figure: {figure}"
    speeds = read_result(tmp_path / "a.h5", SpeedAdvice).spindle_speed * 30 / np.pi
    assert [speeds[0], speeds[-1]] == pytest.approx([1680, 6720])


def test_identify_gives_the_coefficients_of_the_same_forces_and_a_map_stands_on_them(run, tmp_path):
    expected = found(run("--json")[1])["coefficients"]
    code, out, err = run("--method", "gtls", "--json", name="identify", output="c.h5")
    assert code == 0, err
    result = found(out)
    assert result["method"] == "gtls"
    for name in TRUTH:
        assert result["coefficients"][name]["value"] == pytest.approx(expected[name]["value"])
        assert result["coefficients"][name]["ci95"] == pytest.approx(expected[name]["ci95"])
    fit = read_result(tmp_path / "c.h5", Coefficients)
    assert "Kae" not in fit.posterior.names
    words = ["--coefficients", tmp_path / "c.h5", "--rpm", "2000", "8000", "--points", "20", "--members", "50"]
    code, _, err = run(*words, name="stability", cuts=(), output="map.h5")
    assert code == 0, err
    found_map = read_result(tmp_path / "map.h5", StabilityMap)
    assert np.all(found_map.limit_low <= found_map.limit_high)


@pytest.mark.parametrize(
    ("arguments", "how", "code", "said"),
    [
        (["--method", "svd"], {}, 2, "there are: gtls, rtls"),
        (["--phase", "pulse"], {}, 2, "there are: auto, fit, known"),
        (["--method", "tikhonov", "--regularization", "some"], {}, 2, "'some' is neither gcv"),
        (["--method", "tikhonov", "--regularization", "-1"], {}, 2, "'-1' is neither gcv"),
        (["--regularization", "l-curve"], {}, 2, "goes with --method tikhonov, not gtls"),
        (["--slack-N", "3"], {}, 2, "goes with --method rtls, not gtls"),
        (["--rpm", "2000", "6000"], {}, 2, "is the range of --advise"),
        (["--advise", "--rpm", "6000", "2000"], {}, 2, "is no range"),
        (["--spindle-phase-deg", "1", "--spindle-phase-deg", "2", "--spindle-phase-deg", "3"], {}, 2, "3 values for 2"),
        (["--figure", "x.gif"], {}, 2, "does not say its format"),
        ([], {"output": None}, 2, "-o is needed"),
        ([], {"cuts": ()}, 2, "name recordings of cuts"),
        (["--advise"], {"cuts": ()}, 2, "--setup is needed"),
        (["--advise", "--setup", "setup.toml", "--compare"], {"cuts": ()}, 2, "--compare is for forces"),
        (["--advise", "--setup", "cutter.toml"], {"cuts": ()}, 3, "no conditions to advise for"),
        ([], {"frf": None}, 2, "--frf"),
        ([], {"frf": "absent.h5"}, 3, "absent.h5"),
        ([], {"frf": "modes.h5"}, 3, "holds Modes where Frf is needed"),
        (["--modes", "frf.h5"], {}, 3, "holds Frf where Modes is needed"),
        ([], {"cuts": ("absent.h5",)}, 3, "absent.h5"),
        ([], {"cuts": (TAPS[0],)}, 3, "is an impact recording and no cut"),
        (["--phase", "known"], {}, 3, "forces.phase"),
        (["--method", "nls", "--modes", "modes.h5"], {"name": "identify"}, 3, "--frf: goes with gtls, not nls"),
        (["--method", "gtls"], {"name": "identify", "frf": None}, 3, "--frf: method gtls needs it"),
        (["--method", "gtls", "--law", "kienzle"], {"name": "identify"}, 3, "linear-edge law alone"),
        (["--method", "gtls", "--taper"], {"name": "identify"}, 3, "coefficients.taper: goes with method nls, not gtls"),
        (["--method", "gtls", "--lowpass-hz", "500"], {"name": "identify"}, 3, "--lowpass-hz: goes with nls"),
        (["--method", "gtls", "--csv", "c.csv"], {"name": "identify"}, 3, "--csv: goes with smooth"),
        (["--method", "gtls", "--trend"], {"name": "identify"}, 2, "--trend follows coefficients that change"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_one_line_and_leaves_no_file(run, tmp_path, arguments, how, code, said):
    ended, out, err = run(*arguments, **how)
    assert (ended, out) == (code, "")
    errors = [line for line in err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert said in errors[0]
    assert ";" in errors[0]
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("read", [CUTS[0], "frf.h5", "setup.toml"])
def test_nothing_that_is_read_is_written_over(run, recordings, tmp_path, read):
    before = (recordings / read).read_bytes()
    code, _, err = run("--setup", "setup.toml", "--csv", recordings / read)
    assert code == 2
    assert "would be written over" in err
    assert (recordings / read).read_bytes() == before


def test_the_choices_of_the_command_and_of_recipes_are_those_of_the_stage():
    assert set(command.METHODS) == set(methods.NAMES)
    assert set(command.PHASES) == set(stage.PHASES)
    fields = ForcesTable.model_fields
    assert set(fields["method"].annotation.__args__) == set(command.METHODS)
    assert set(fields["phase"].annotation.__args__) == set(command.PHASES)
    options = set(inspect.signature(command.forces).parameters)
    assert options >= set(inspect.signature(stage.reconstruct_forces).parameters) - {"cuts", "progress"}
    assert set(identify.FROM_ACCELERATIONS) <= set(command.METHODS)
