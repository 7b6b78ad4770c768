"""`millcal stability` from files to a map: the contract of its JSON, its refusals, and the same bytes twice."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from millcal.cli import main
from millcal.cli.stability import _round_points
from millcal.cli.stability_input import METHODS
from millcal.data import Coefficients, Frf, Modes, Posterior, StabilityMap
from millcal.io.results import read_result, write_result
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.structure import Mode, receptance
from millcal.stages import stability as stage

RPM = 2 * np.pi / 60
SETUP = """
[cutter]
diameter_mm = 20
teeth = 3
[conditions]
spindle_speed_rpm = 8000
feed_per_tooth_mm = 0.1
axial_depth_mm = 1.0
radial_depth_mm = 10
direction = "up"
"""
STRUCTURE = """
[[structure.modes]]
axis = "x"
fn_hz = 603
zeta = 0.039
k_N_per_m = 5.59e6
[[structure.modes]]
axis = "y"
fn_hz = 666
zeta = 0.035
k_N_per_m = 5.715e6
"""
COEFFICIENTS = ["--ktc", "600", "--krc", "42"]


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """Run the command in an empty folder with setup.toml.   returns (exit code, stdout, stderr)"""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "setup.toml").write_text(SETUP + STRUCTURE)
    (tmp_path / "cutter.toml").write_text(SETUP)

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["stability", *arguments])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


def test_modes_of_a_setup_give_the_published_limits_at_round_speeds_in_json(run, tmp_path):
    code, out, _ = run(*COEFFICIENTS, "--setup", "setup.toml", "--rpm", "4000", "16000", "-o", "map.h5", "--json")
    result = json.loads(out)["result"]
    assert code == 0
    limits = {round(row["rpm"]): row["crossings"][0] for row in result["limit"]}
    for rpm, ap in {6000: 1.9457, 8000: 1.0954, 10000: 1.3396, 12000: 4.0335, 14000: 2.7915}.items():
        assert limits[rpm]["ap_mm"] == pytest.approx(ap, abs=6e-5)
    assert limits[8000]["kind"] == "hopf"
    assert {"rpm", "ap_mm", "mrr_cm3_per_min", "p_stable"} <= set(result["best"][0])
    assert result["operating_point"]["limit_ap_mm"] == pytest.approx(1.0954, abs=6e-5)
    assert isinstance(read_result(tmp_path / "map.h5", StabilityMap), StabilityMap)


def test_the_table_shows_round_speeds_best_speeds_and_the_operating_point(run):
    code, out, _ = run(*COEFFICIENTS, "--setup", "setup.toml", "--rpm", "4000", "16000", "-o", "map.h5")
    assert code == 0
    assert "8000     1.095" in out
    assert "best speeds" in out
    assert "operating point 8000 rpm, 1 mm: limit 1.095 mm" in out


def test_modes_and_an_frf_of_them_give_the_same_limits(run, tmp_path):
    modes = Modes(
        natural_frequency=[603, 666], damping_ratio=[0.039, 0.035], stiffness=[5.59e6, 5.715e6], axes=("x", "y")
    )
    write_result(tmp_path / "modes.h5", modes, provenance={})
    frequency = np.arange(0.0, 2000.0, 1.0)
    frf = Frf(
        frequency=frequency,
        values=receptance(frequency, [Mode(603, 0.039, 5.59e6, "x"), Mode(666, 0.035, 5.715e6, "y")]),
        form="receptance",
        estimator="h1",
        outputs=("tipX", "tipY"),
        inputs=("tipX", "tipY"),
        hits_used=(1, 1),
        usable_band=(10.0, 2000.0),
    )
    write_result(tmp_path / "frf.h5", frf, provenance={})
    depths = []
    for option, name in (("--modes", "modes.h5"), ("--frf", "frf.h5")):
        code, _, _ = run(
            *COEFFICIENTS, option, name, "--setup", "cutter.toml", "--rpm", "4000", "16000", "-o", "map.h5"
        )
        assert code == 0
        depths.append(read_result(tmp_path / "map.h5", StabilityMap).limit_depth)
    np.testing.assert_allclose(depths[1], depths[0], rtol=1e-5)


def test_the_same_call_twice_writes_the_same_bytes(run, tmp_path):
    for name in ("one.h5", "two.h5"):
        run(*COEFFICIENTS, "--setup", "setup.toml", "-o", name)
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--setup", "setup.toml"], "--coefficients or --ktc"),
        (["--ktc", "600", "--setup", "setup.toml"], "go together"),
        ([*COEFFICIENTS], "--frf or --modes"),
        ([*COEFFICIENTS, "--frf", "a.h5", "--modes", "b.h5"], "exclude each other"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--method", "magic"], "there are: zoa"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--direction", "climb"], "up, down, slot"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--rpm", "9000", "4000"], "--rpm 9000 4000"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--kte", "20"], "--kte and --kre go together"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--method", "frf"], "frf needs a measured FRF"),
        (
            [*COEFFICIENTS, "--frf", "a.h5", "--setup", "cutter.toml", "--method", "floquet"],
            "fit them with 'millcal modes",
        ),
        (
            [*COEFFICIENTS, "--frf", "a.h5", "--setup", "cutter.toml", "--method", "frf", "--helix-deg", "30"],
            "straight teeth",
        ),
        (
            [*COEFFICIENTS, "--frf", "a.h5", "--setup", "cutter.toml", "--method", "frf", "--pitch-deg", "100,120,140"],
            "one pitch",
        ),
        ([*COEFFICIENTS, "--frf", "a.h5", "--setup", "cutter.toml", "--simulate-points", "5", "5"], "needs modes"),
        (
            [*COEFFICIENTS, "--setup", "setup.toml", "--method", "zoa", "--process-damping", "5"],
            "zoa knows no process damping",
        ),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--pitch-deg", "100,120"], "are not 3 angles"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--pitch-deg", "even"], "no list such as"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--deepest-mm", "0"], "0 is not above 0"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--deepest-mm", "inf"], "inf is no number"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--radial-depth-mm", "25"], "25 is more than the diameter, 20"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--radial-depth-mm", "3", "--direction", "slot"], "3 is no slot"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--diameter-mm", "5"], "10 is more than the diameter, 5"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--pitch-deg", "nan,120,120"], "are not 3 angles"),
        (["--ktc", "600", "--krc", "inf", "--setup", "setup.toml"], "inf is no number"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--operating", "10000", "-3"], "-3 is not above 0"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--operating", "0", "3"], "0 is not above 0"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--operating", "10000", "0"], "0 is not above 0"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--operating", "nan", "3"], "nan is no number"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--operating", "10000", "inf"], "inf is no number"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--rpm", "5000", "inf"], "inf is no number"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--points", "1000000"], "20000"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--probability", "--members", "0"], "needs draws"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--figure", "map.gif"], "does not say its format"),
        ([*COEFFICIENTS, "--setup", "setup.toml", "--csv", "map.h5"], "would be written over"),
    ],
)
def test_a_call_that_cannot_be_meant_is_one_line_and_exit_code_2(run, tmp_path, arguments, words):
    code, out, err = run(*arguments, "-o", "map.h5")
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert not (tmp_path / "map.h5").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--setup", "cutter.toml"], "no dynamics"),
        (["--setup", "nowhere.toml"], "nowhere.toml"),
        (["--setup", "cutter.toml", "--modes", "nowhere.h5"], "nowhere.h5"),
        (["--setup", "cutter.toml", "--frf", "setup.toml"], "setup.toml"),
        (["--setup", "setup.toml", "--tests", "nowhere.csv"], "nowhere.csv"),
        (["--setup", "setup.toml", "--tests", "cutter.toml"], "no column rpm"),
    ],
)
def test_files_that_cannot_be_used_are_one_line_and_exit_code_3(run, tmp_path, arguments, words):
    code, out, err = run(*COEFFICIENTS, *arguments, "-o", "map.h5")
    assert code == 3
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert not (tmp_path / "map.h5").exists()


def test_a_missing_axis_is_refused_until_it_is_called_rigid(run, tmp_path):
    modes = Modes(natural_frequency=[603], damping_ratio=[0.039], stiffness=[5.59e6], axes=("x",))
    write_result(tmp_path / "modes.h5", modes, provenance={})
    arguments = [*COEFFICIENTS, "--modes", "modes.h5", "--setup", "cutter.toml", "-o", "map.h5"]
    code, _, err = run(*arguments)
    assert code == 3
    assert "--rigid y" in err
    code, out, _ = run(*arguments, "--rigid", "y", "--json")
    assert code == 0
    assert "rigid-axis" in {note["code"] for note in json.loads(out)["notes"]}


def test_conditions_that_lack_what_a_map_does_not_need_may_be_options_instead(run, tmp_path):
    lacking = "".join(line + "\n" for line in (SETUP + STRUCTURE).splitlines() if not line.startswith("spindle_speed"))
    (tmp_path / "lacking.toml").write_text(lacking)
    code, _, err = run(*COEFFICIENTS, "--setup", "lacking.toml", "--rpm", "4000", "16000", "-o", "map.h5")
    assert code == 3
    assert "spindle_speed_rpm: is missing" in err
    assert "or leave [conditions] out and say --radial-depth-mm, --direction" in err
    before, after = lacking.split("[conditions]")
    (tmp_path / "without.toml").write_text(before + after[after.index("[[") :])
    options = ["--radial-depth-mm", "10", "--direction", "up", "--feed-per-tooth-mm", "0.1"]
    code, _, _ = run(*COEFFICIENTS, "--setup", "without.toml", "--rpm", "4000", "16000", *options, "-o", "map.h5")
    assert code == 0


@pytest.mark.parametrize("span", [("1e6", "1e7"), ("6000", "6000.001")])
def test_any_range_of_speeds_has_round_ones_to_show(run, span):
    code, out, err = run(*COEFFICIENTS, "--setup", "setup.toml", "--rpm", *span, "--points", "5", "-o", "map.h5")
    assert (code, err.count("Traceback")) == (0, 0)
    assert "limit mm" in out


def test_the_command_knows_the_methods_of_the_stage():
    assert set(METHODS) == set(stage.METHODS)


@pytest.mark.parametrize("span", [(4000.0, 16_000.0), (1000.0, 2000.0), (500.0, 60_000.0), (6000.0, 6010.0)])
def test_a_map_has_400_speeds_or_more_at_a_round_step(span):
    low, high = span
    step = (high - low) / (_round_points(low, high) - 1)
    assert _round_points(low, high) >= 400
    assert step / 10 ** np.floor(np.log10(step) + 1e-9) == pytest.approx(
        round(step / 10 ** np.floor(np.log10(step) + 1e-9))
    )


def coefficients_record(verdict="fits"):
    """Coefficients of two cuts at two feeds, with the arrays that a map does not look at left small."""
    cutter = Cutter(diameter=20e-3, teeth=3)
    conditions = tuple(CuttingConditions(8000 * RPM, feed, 1e-3, 10e-3, "up") for feed in (0.1e-3, 0.2e-3))
    known = Posterior(
        names=("Ktc", "Krc"),
        units=("N/m^2", "N/m^2"),
        mean=np.array([600e6, 42e6]),
        covariance=np.diag([20e6, 10e6]) ** 2,
        interval=np.array([[560e6, 640e6], [22e6, 62e6]]),
        law="linear-edge",
        method="average",
    )
    means, waves = np.zeros((2, 3)), np.zeros((2, 3, 4))
    return Coefficients(
        posterior=known, cutter=cutter, conditions=conditions, cuts=("one", "two"), verdict=verdict, checks=(),
        feed_per_tooth=np.array([0.1e-3, 0.2e-3]), measured_mean=means, modelled_mean=means, angle=np.zeros(4),
        measured=waves, modelled=waves, measured_amplitude=waves, modelled_amplitude=waves,
        residual_rms=np.zeros(3), r2=np.ones(3),
    )  # fmt: skip


def test_a_file_of_coefficients_brings_cutter_conditions_and_a_band(run, tmp_path):
    """Everything the cuts agree in need not be said again; of the feeds the highest; a bad verdict is passed on."""
    write_result(tmp_path / "c.h5", coefficients_record("does not fit: drift"), provenance={})
    (tmp_path / "modes.toml").write_text(STRUCTURE)
    code, out, err = run("--coefficients", "c.h5", "--setup", "modes.toml", "-o", "map.h5", "--json")
    result = json.loads(out)["result"]
    assert code == 0
    assert (result["teeth"], result["direction"], result["radial_depth_mm"]) == (3, "up", 10)
    assert result["feed_per_tooth_mm"] == pytest.approx(0.2)
    assert result["operating_point"]["rpm"] == pytest.approx(8000)
    assert 0 < result["operating_point"]["p_stable"] < 1
    low, high = result["operating_point"]["limit_ap_mm_ci95"]
    assert low < 1.0954 < high
    assert [result["limit"][i]["rpm"] for i in (0, -1)] == pytest.approx([2000, 16_000])
    assert "does not fit: drift" in err


FLOQUET = [*COEFFICIENTS, "--setup", "setup.toml", "--method", "floquet", "--rpm", "6000", "12000", "--points", "31"]


def test_floquet_gives_the_converged_limits_of_the_same_machine_in_json(run):
    """Reference values of the first crossings, to their last digit; zero order says 1.9457, 1.0954, 1.3396 and 4.0335 mm."""
    code, out, _ = run(*FLOQUET, "-o", "map.h5", "--json")
    assert code == 0
    limits = {round(row["rpm"]): row["crossings"][0] for row in json.loads(out)["result"]["limit"]}
    for rpm, ap in {6000: 2.02847, 8000: 1.09823, 10000: 1.36498, 12000: 4.29113}.items():
        assert limits[rpm]["ap_mm"] == pytest.approx(ap, abs=1e-4)
        assert limits[rpm]["kind"] == "hopf"
        assert limits[rpm]["loses"] is True
        assert limits[rpm]["chatter_hz"] > 600


LOW = ["--radial-depth-mm", "1", "--direction", "down", "--teeth", "2"]


def test_at_low_immersion_floquet_finds_flips_at_odd_multiples_of_half_the_tooth_passing(run, tmp_path):
    code, out, _ = run(*FLOQUET, *LOW, "--deepest-mm", "40", "-o", "map.h5", "--json")
    rows = json.loads(out)["result"]["limit"]
    flips = [(row["rpm"], c) for row in rows for c in row["crossings"] if c["kind"] == "flip"]
    assert code == 0
    assert flips
    for rpm, crossing in flips:
        halves = crossing["chatter_hz"] / (rpm * 2 / 60 / 2)
        assert halves == pytest.approx(round(halves), abs=1e-6)
        assert round(halves) % 2 == 1
        assert crossing["lobe"] == (round(halves) - 1) / 2


def test_edge_forces_give_torque_and_power_and_their_ratio_is_the_speed(run):
    code, out, _ = run(*FLOQUET, "--kte", "20", "--kre", "15", "-o", "map.h5", "--json")
    best = json.loads(out)["result"]["best"][0]
    assert code == 0
    assert best["power_W"] == pytest.approx(best["torque_Nm"] * best["rpm"] * RPM)
    specific = best["power_W"] / (best["mrr_cm3_per_min"] * 1e-6 / 60)  # J/m^3: above Ktc by the rubbing of the edge
    assert 600e6 < specific < 2 * 600e6


def test_without_edge_forces_torque_and_power_are_not_known(run):
    _, out, _ = run(*FLOQUET, "-o", "map.h5", "--json")
    assert {best["power_W"] for best in json.loads(out)["result"]["best"]} == {None}


def test_a_cut_beyond_the_limit_is_told_with_what_would_mend_it(run):
    code, out, _ = run(*FLOQUET, "--operating", "8000", "1.5", "-o", "map.h5", "--json")
    point = json.loads(out)["result"]["operating_point"]
    assert code == 0  # a verdict is no failure
    assert (point["stable"], point["kind"]) == (False, "hopf")
    assert point["limit_ap_mm"] == pytest.approx(1.09823, abs=1e-4)
    assert point["advice"]
    _, out, _ = run(*FLOQUET, "--operating", "8000", "1.5", "-o", "map.h5")
    assert "chatters by hopf" in out
    assert f"  - {point['advice'][0]}" in out


LOG = """rpm,axial_depth_mm,radial_depth_mm,feed_per_tooth_mm,stable
8000,0.9,10,0.1,1
8000,1.3,10,0.1,0
9000,0.5,10,0.1,0
8000,3,2,0.1,1
"""


def test_a_log_of_test_cuts_is_held_against_the_map(run, tmp_path):
    (tmp_path / "cuts.csv").write_text(LOG)
    code, out, err = run(*FLOQUET, "--tests", "cuts.csv", "-o", "map.h5", "--json")
    told = json.loads(out)["result"]["tests"]
    assert code == 0
    assert (told["on_map"], told["as_mapped"]) == (3, 2)
    assert "another radial depth" in err
    assert read_result(tmp_path / "map.h5", StabilityMap).tests.axial_depth == pytest.approx([0.9e-3, 1.3e-3, 0.5e-3])
    assert "cuts.csv" in {Path(name).name for name in json.loads(out)["inputs"]}


def test_methods_side_by_side_where_four_teeth_cut_all_the_way_agree(run, tmp_path):
    """The mean is all there is of four teeth in a slot, so zero order and Floquet are one."""
    slot = ["--direction", "slot", "--teeth", "4", "--rpm", "6000", "9000", "--points", "7"]
    arguments = [*COEFFICIENTS, "--setup", "setup.toml", *slot, "--method", "floquet", "--compare"]
    code, out, err = run(*arguments, "-o", "map.h5", "--json")
    told = json.loads(out)["result"]["compared"]
    assert code == 0
    assert set(told["methods"]) == {"floquet", "zoa", "time-domain"}
    assert told["methods"][0] == told["against"] == "floquet"
    differences = {entry["method"]: entry for entry in told["difference"]}
    assert differences["zoa"]["median"] < 1e-4
    assert differences["zoa"]["beyond"] == 0
    assert differences["time-domain"]["median"] < 0.05
    _, out, _ = run(*arguments, "-o", "map.h5")
    assert "methods side by side" in out
    assert "not-compared" not in err  # that there is no FRF to take is a note


def test_every_method_stands_beside_the_others_at_one_speed(run):
    """A step of 266.7 rpm: the slow method takes every third speed of the map, and each row holds them all."""
    asked = ["--direction", "slot", "--rpm", "6000", "14000", "--points", "31", "--method", "floquet", "--compare"]
    code, out, _ = run(*COEFFICIENTS, "--setup", "setup.toml", *asked, "-o", "map.h5", "--json")
    assert code == 0
    result = json.loads(out)["result"]
    limits = {entry["rpm"]: entry["crossings"][0]["ap_mm"] for entry in result["limit"] if entry["crossings"]}
    rows = result["compared"]["limit"]
    assert len(rows) == 11
    for row in rows:
        at = min(limits, key=lambda rpm: abs(rpm - row["rpm"]))
        assert at == pytest.approx(row["rpm"], rel=1e-9)
        assert row["floquet"]["ap_mm"] == limits[at]
        assert row["time-domain"]["ap_mm"] == pytest.approx(limits[at], rel=0.03)


def test_an_frf_and_its_modes_may_stand_side_by_side_alone(run):
    code, _, err = run(*COEFFICIENTS, "--frf", "a.h5", "--modes", "b.h5", "--setup", "cutter.toml", "-o", "map.h5")
    assert code == 2
    code, _, err = run(
        *COEFFICIENTS, "--frf", "a.h5", "--modes", "b.h5", "--setup", "cutter.toml", "--compare", "-o", "map.h5"
    )
    assert code == 3  # it would, if the files were there
    assert "a.h5" in err


def test_friction_without_process_damping_is_left_out_and_said(run):
    asked = [*COEFFICIENTS, "--setup", "setup.toml", "--rpm", "4000", "8000", "--points", "3", "-o", "map.h5"]
    code, _, err = run(*asked, "--method", "floquet", "--friction", "0.4", "--members", "0")
    assert code == 0
    assert "friction-ignored" in err
    assert "friction-ignored" not in run(*asked, "--method", "floquet", "--members", "0")[2]


def test_a_number_in_another_unit_is_told(run):
    asked = ["--setup", "setup.toml", "--rpm", "4000", "8000", "--points", "3", "--members", "0", "-o", "map.h5"]
    code, _, err = run("--ktc", "6e8", "--krc", "42e6", *asked)
    assert code == 0
    assert "coefficients.Ktc: 6e+08 N/mm2 is outside 50 to 20000" in err


def test_table_and_figure_are_written_beside_the_map(run, tmp_path):
    code, out, _ = run(*FLOQUET, "--csv", "lobes.csv", "--figure", "map.svg", "-o", "map.h5")
    assert code == 0
    lines = (tmp_path / "lobes.csv").read_text().splitlines()
    assert lines[0].startswith("rpm,limit_mm,crossing,ap_mm,kind,chatter_hz,lobe,loses")
    assert len({line.split(",")[0] for line in lines[1:]}) == 31
    assert (tmp_path / "map.svg").read_text().lstrip().startswith("<?xml")
    assert "csv: lobes.csv" in out
    assert "figure: map.svg" in out


def test_a_helix_of_the_setup_is_the_maps_and_an_option_goes_before_it(run, tmp_path):
    """Where the cut is deepest the edge lags by 20 degrees over it, and the limit is a percent off."""
    turned = (SETUP + STRUCTURE).replace("teeth = 3\n", "teeth = 3\nhelix_deg = 40\n")
    (tmp_path / "helix.toml").write_text(turned)
    limits = {}
    for name, more in {"setup": [], "helix": [], "option": ["--helix-deg", "40"], "none": ["--helix-deg", "0"]}.items():
        file = {"option": "setup", "none": "helix"}.get(name, name)
        arguments = [*FLOQUET[:4], "--setup", f"{file}.toml", *FLOQUET[6:-1], "7", *more]
        assert run(*arguments, "-o", "map.h5")[0] == 0
        limits[name] = read_result(tmp_path / "map.h5", StabilityMap).limit_depth
    np.testing.assert_allclose(limits["option"], limits["helix"])
    np.testing.assert_allclose(limits["none"], limits["setup"])
    assert np.max(np.abs(limits["helix"] / limits["setup"] - 1)) > 5e-3


def test_teeth_of_unequal_pitch_are_not_counted_anew_without_their_angles(run, tmp_path):
    (tmp_path / "uneven.toml").write_text(
        (SETUP + STRUCTURE).replace("teeth = 3\n", "teeth = 3\npitch_deg = [100, 120, 140]\n")
    )
    arguments = [*COEFFICIENTS, "--setup", "uneven.toml", "--teeth", "2", "-o", "map.h5"]
    code, _, err = run(*arguments)
    assert code == 2
    assert "--pitch-deg" in err
    assert run(*arguments, "--pitch-deg", "170,190")[0] == 0


def test_a_probability_map_falls_with_depth_at_every_speed_where_nothing_comes_back(run, tmp_path):
    write_result(tmp_path / "c.h5", coefficients_record(), provenance={})
    (tmp_path / "modes.toml").write_text(STRUCTURE)
    arguments = [
        "--coefficients",
        "c.h5",
        "--setup",
        "modes.toml",
        "--probability",
        "--samples",
        "300",
        "--points",
        "20",
    ]
    code, out, _ = run(*arguments, "-o", "map.h5", "--json")
    told = json.loads(out)["result"]["probability"]
    assert code == 0
    share = np.array(told["p_stable"])
    assert share.shape == (len(told["ap_mm"]), len(told["rpm"]))
    assert np.all(np.diff(share, axis=0) <= 1e-12)
    assert share.min() >= 0
    assert share.max() <= 1


def test_simulated_points_stand_over_a_map_of_another_method(run):
    arguments = [
        *COEFFICIENTS,
        "--setup",
        "setup.toml",
        "--rpm",
        "7000",
        "9000",
        "--points",
        "20",
        "--simulate-points",
        "2",
        "3",
    ]
    code, out, _ = run(*arguments, "-o", "map.h5", "--json")
    told = json.loads(out)["result"]["simulated"]
    assert code == 0
    assert len(told["cuts"]) == 6
    assert told["stable"] + told["period_n"] + told["chatter"] == 6


CASE = Path(os.environ.get("MILLCAL_REFERENCE_DATA", "")) / "cases" / "frf" / "04_B_med"


@pytest.mark.skipif(not CASE.is_dir(), reason="reference data are absent: MILLCAL_REFERENCE_DATA names their folder")
def test_an_impact_test_with_known_truth_gives_the_limit_of_the_truth(run, tmp_path, capsys):
    """From noisy lines to the map: within 0.5 % at half of the speeds, 3.5 % at nineteen of twenty, the band mostly right."""
    with pytest.raises(SystemExit):
        main(["frf", *(str(CASE / f"tap_tip{axis}.h5") for axis in "XYZ"), "-o", "frf.h5", "--quiet"])
    capsys.readouterr()
    truth = np.load(CASE / "truth.npz")
    frequency = np.arange(1.0, 6000.0, 0.5)
    shapes = truth["phi"][[list(truth["dofs"]).index(dof) for dof in ("tipX", "tipY")]]
    w, wn = 2 * np.pi * frequency[:, None], 2 * np.pi * truth["fn"]
    values = np.einsum("om,im,fm->foi", shapes, shapes, 1 / (wn**2 - w**2 + 2j * truth["zeta"] * wn * w))
    known = Frf(
        frequency=frequency, values=values, form="receptance", estimator="truth", outputs=("tipX", "tipY"),
        inputs=("tipX", "tipY"), hits_used=(1, 1), usable_band=(1.0, 6000.0),
    )  # fmt: skip
    write_result(tmp_path / "truth.h5", known, provenance={})
    maps = []
    for name in ("frf.h5", "truth.h5"):
        code, _, _ = run(
            "--ktc",
            "700",
            "--krc",
            "200",
            "--frf",
            name,
            "--setup",
            "cutter.toml",
            "--rpm",
            "2000",
            "12000",
            "-o",
            "map.h5",
        )
        assert code == 0
        maps.append(read_result(tmp_path / "map.h5", StabilityMap))
    measured, true = maps
    error = np.abs(measured.limit_depth / true.limit_depth - 1)
    assert np.median(error) < 0.005
    assert np.quantile(error, 0.95) < 0.035
    assert np.mean((measured.limit_low <= true.limit_depth) & (true.limit_depth <= measured.limit_high)) > 0.85


def test_simulated_cuts_of_the_operating_speed_are_a_figure_of_their_own(run):
    code, _, _ = run(
        *COEFFICIENTS, "--setup", "setup.toml", "--method", "floquet", "--rpm", "7000", "9000", "--points", "5",
        "--deepest-mm", "3", "--simulate-points", "2", "2", "--figure", "map.png", "-o", "map.h5",
    )  # fmt: skip
    assert code == 0
    assert Path("map-bifurcation.png").read_bytes().startswith(b"\x89PNG")
