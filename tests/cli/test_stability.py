"""`millcal stability` from files to a map: the contract of its JSON, its refusals, and the same bytes twice."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from millcal.cli import main
from millcal.cli.stability import METHODS, _round_points
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
