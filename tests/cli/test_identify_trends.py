"""`millcal identify` with methods that follow: what they leave on disk, that each option counts, and what is refused."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest
from short_cuts import CHIPPED, TRUTH, record_cut

from millcal.cli import main
from millcal.data import CoefficientHistory
from millcal.io.results import read_provenance, read_result

NLS = ("--method", "nls")
TABLE = "s_mm,axial_depth_mm,entry_deg,exit_deg,feed_direction_deg\n0,2,110,180,0\n40,2,110,180,0\n"


@pytest.fixture(scope="module")
def cuts(tmp_path_factory):
    """A steady cut, one whose edge chips, and one at another feed.   returns the folder"""
    folder = tmp_path_factory.mktemp("cuts")
    record_cut(folder / "steady.h5")
    record_cut(folder / "chipped.h5", seed=1, trend=CHIPPED)
    record_cut(folder / "coarse.h5", feed=120e-6, seed=2)
    (folder / "path.csv").write_text(TABLE)
    return folder


@pytest.fixture
def run(cuts, tmp_path, capsys, monkeypatch):
    """Run the command beside the recordings.   returns (exit code, stdout, stderr)"""
    monkeypatch.chdir(cuts)

    def run(*arguments, recordings=("steady.h5",), output="c.h5"):
        with pytest.raises(SystemExit) as end:
            main(["identify", *recordings, "-o", str(tmp_path / output), *arguments])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


def kienzle(*arguments):
    return ("--law", "kienzle", "--chain-lowpass-hz", "600", *arguments)


@pytest.mark.parametrize("method", ["smooth", "imm", "rls", "enkf-inflated"])
def test_the_truth_comes_back_with_its_intervals_in_the_shape_of_the_contract(run, tmp_path, method):
    code, out, _ = run("--method", method, "--json", *kienzle())
    told = json.loads(out)
    assert code == 0
    assert (told["command"], set(told["inputs"])) == ("identify", {"steady.h5"})
    result = told["result"]
    assert result["method"] == method
    assert {"coefficients", "verdict", "r2", "residual_rms_N", "jumps", "slope_percent_per_min", "history"} <= set(
        result
    )
    for name, value in TRUTH.items():
        entry = result["coefficients"][name]
        assert entry["unit"] == ("1" if name[0] == "m" else "N/mm^2")
        assert abs(entry["value"] - value) < max(5 * entry["sd"], 0.01 * value), name
    saved = read_result(tmp_path / "c.h5", CoefficientHistory)
    assert saved.posterior["kt"] / 1e6 == pytest.approx(result["coefficients"]["kt"]["value"])
    assert saved.runout is not None


def test_a_chipped_edge_is_found_at_its_time(run):
    code, out, _ = run("--trend", "--json", *kienzle(), recordings=["chipped.h5"])
    (jump,) = json.loads(out)["result"]["jumps"]
    assert code == 0
    assert jump["time_s"] == pytest.approx(0.505, abs=0.01)
    assert jump["change_percent"]["t"]["value"] == pytest.approx(15, abs=1)


def test_several_cuts_are_followed_one_behind_the_other(run, tmp_path):
    code, out, _ = run("--method", "rls", "--json", *kienzle(), recordings=["steady.h5", "coarse.h5"])
    assert code == 0
    assert [cut["name"] for cut in json.loads(out)["result"]["cuts"]] == ["steady.h5", "coarse.h5"]
    history = read_result(tmp_path / "c.h5", CoefficientHistory)
    assert set(history.cut) == {0, 1}
    assert np.all(np.diff(history.time) > 0)


@pytest.mark.usefixtures("coarse_png")
def test_table_and_figure_are_written_and_told_of(run, tmp_path):
    table, figure = tmp_path / "h.csv", tmp_path / "h.png"
    code, out, _ = run("--method", "imm", "--csv", str(table), "--figure", str(figure), *kienzle())
    assert code == 0
    assert out.splitlines()[-2:] == [f"csv: {table}", f"figure: {figure}"]
    rows = list(csv.DictReader(table.open(newline="")))
    history = read_result(tmp_path / "c.h5", CoefficientHistory)
    assert len(rows) == len(history.time)
    assert float(rows[-1]["kt_N_per_mm2"]) == pytest.approx(history.value[-1, 0] / 1e6, rel=1e-9)
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.h5", "h.csv", "h.png"]


def test_trend_is_smooth_and_with_causal_imm(run):
    methods = {
        flags: json.loads(run(*flags, "--json", "--no-jumps", *kienzle())[1])["result"]["method"]
        for flags in [("--trend",), ("--causal",), ("--trend", "--causal")]
    }
    assert list(methods.values()) == ["smooth", "imm", "imm"]


def test_a_seed_makes_the_ensemble_and_the_same_seed_the_same_bytes(run, tmp_path):
    for name, seed in (("a.h5", 1), ("b.h5", 1), ("c.h5", 2)):
        assert run("--method", "enkf", "--seed", str(seed), "--members", "40", *kienzle(), output=name)[0] == 0
    first, again, other = ((tmp_path / name).read_bytes() for name in ("a.h5", "b.h5", "c.h5"))
    assert first == again
    assert first != other
    values = [read_result(tmp_path / name, CoefficientHistory).value for name in ("a.h5", "c.h5")]
    assert not np.array_equal(*values)
    assert read_provenance(tmp_path / "c.h5")["seed"] == 2


OPTIONS = {
    "law": ("rls", ["--law", "linear-edge"]),
    "runout": ("rls", ["--runout", "known"]),
    "corner": ("rls", ["--chain-lowpass-hz", "500"]),
    "order": ("rls", ["--chain-lowpass-order", "3"]),
    "smoothing": ("rls", ["--lowpass-hz", "300"]),
    "bounds": ("rls", ["--bounds", "kt=1490:1510", "--bounds", "mt=0.2:0.22"]),
    "forgetting": ("rls", ["--forgetting", "0.995"]),
    "members": ("enkf", ["--members", "60"]),
    "inflate every": ("enkf-inflated", ["--inflate-every", "20"]),
    "inflation": ("enkf-inflated", ["--inflation", "3"]),
    "engagement": ("rls", ["--engagement", "path.csv", "--path-start-s", "0.18"]),
    "phase": ("rls", ["--spindle-phase-deg", "40"]),
}


@pytest.fixture(scope="module")
def by_default(cuts, tmp_path_factory):
    """What each method finds without the option.   returns method -> values"""
    found = {}
    for method in ("rls", "enkf", "enkf-inflated"):
        path = tmp_path_factory.mktemp("default") / "c.h5"
        with pytest.raises(SystemExit):
            main(["identify", str(cuts / "steady.h5"), "-o", str(path), "--quiet", "--method", method, *kienzle()])
        found[method] = read_result(path, CoefficientHistory)
    return found


@pytest.mark.parametrize("name", OPTIONS)
def test_every_option_reaches_the_method(run, tmp_path, by_default, name):
    method, arguments = OPTIONS[name]
    code, _, err = run("--method", method, *kienzle(), *arguments)
    assert code == 0, err
    found = read_result(tmp_path / "c.h5", CoefficientHistory)
    usual = by_default[method]
    assert found.names != usual.names or not np.array_equal(found.value, usual.value)


def test_without_looking_for_jumps_there_are_none(run):
    code, out, _ = run("--trend", "--no-jumps", "--json", *kienzle(), recordings=["chipped.h5"])
    assert (code, json.loads(out)["result"]["jumps"]) == (0, [])


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--method", "guess"], 2, "there are: nls, average, gtls, smooth, imm, rls, enkf, enkf-inflated"),
        (["--trend", *NLS], 2, "--trend follows coefficients that change, and --method nls does not; keep one"),
        (["--causal", *NLS], 2, "--causal goes in the order of time, and --method nls does not"),
        (["--causal", "--method", "smooth"], 2, "--method smooth does not; keep one, or choose imm"),
        (["--members", "50"], 3, "coefficients.members: goes with method enkf or enkf-inflated, not nls; leave it out"),
        (["--trend", "--members", "50"], 3, "goes with method enkf or enkf-inflated, not smooth"),
        (["--method", "rls", "--no-jumps"], 3, "coefficients.jumps: goes with"),
        (["--method", "enkf", "--inflation", "4"], 3, "coefficients.inflation: goes with method enkf-inflated, not enkf"),
        (["--trend", "--harmonics", "5"], 3, "coefficients.harmonics: goes with method nls, not smooth"),
        (["--trend", "--rows", "all"], 3, "coefficients.rows: goes with method average, not smooth"),
        (["--trend", "--sensor", "s.h5"], 3, "chain_lowpass_hz, or use method nls"),
        (["--chain-lowpass-hz", "300"], 3, "coefficients.chain_lowpass_hz: goes with method smooth"),
        (["--trend", "--chain-lowpass-hz", "2500"], 3, "chain_lowpass_hz: 2500 Hz is not below half the sample rate"),
        (["--trend", "--lowpass-hz", "2500"], 3, "lowpass_hz: 2500 Hz is not below half the sample rate"),
        (["--method", "rls", "--forgetting", "2"], 2, "2 is not above 0 and at most 1"),
        (["--trend", "--runout", "maybe"], 2, "there are: fit, known"),
        (["--trend", "--bounds", "kt=2000:500"], 2, "kt=2000:500 is no NAME=LOW:HIGH"),
        (["--trend", "--bounds", "kx=1:2"], 2, "'kx' is no coefficient; there are: kt, mt"),
        (["--trend", "--law", "kienzle", "--bounds", "kt=500:900"], 3, "kt is bounded and mt is not; give both"),
        (["--trend", "--bounds", "kt=500:900", "--bounds", "mt=0.1:0.5"], 3, "kt is no coefficient of the linear-edge law"),
        (["--csv", "h.csv"], 3, "--csv: goes with smooth, imm, rls, enkf, enkf-inflated, not nls"),
        (["--figure", "h.png"], 3, "--figure: goes with smooth"),
        (["--trend", "--figure", "h.txt"], 2, "end it with .png, .svg, .pdf"),
        (["--trend", "--csv", "steady.h5"], 2, "steady.h5 would be written over"),
        (["--trend", "--csv", "h.csv", "--figure", "./h.csv"], 2, "end it with .png"),
        (["--engagement", "path.csv"], 3, "--engagement: goes with smooth"),
        (["--trend", "--engagement", "path.csv"], 3, "nothing says where on the path the tool is; give path_start_s"),
        (["--trend", "--engagement", "absent.csv"], 3, "absent.csv: no such file"),
        (["--trend", "--engagement", "path.csv", "--csv", "path.csv"], 2, "path.csv would be written over"),
        (["--trend", "--path-start-s", "0", "--path-start-s", "1"], 2, "2 values for 1 recordings"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)  # fmt: skip
def test_what_cannot_be_done_is_one_line_and_leaves_no_file(run, tmp_path, cuts, arguments, code, said):
    before = sorted(path.name for path in cuts.iterdir())
    found, out, err = run(*arguments)
    assert (found, out) == (code, "")
    assert said in err
    assert len([line for line in err.splitlines() if line.startswith("error:")]) == 1
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []
    assert sorted(path.name for path in cuts.iterdir()) == before


def test_a_method_that_does_not_follow_waits_for_no_compiler(cuts, tmp_path):
    script = (
        "import sys\nfrom millcal.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as end:\n    assert not end.code\n"
        "assert 'numba' not in sys.modules"
    )
    files = [str(cuts / "steady.h5"), "-o", str(tmp_path / "c.h5"), "--quiet"]
    subprocess.run([sys.executable, "-c", script, "identify", *files], check=True, capture_output=True)
