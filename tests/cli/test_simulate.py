"""`millcal simulate`: the same bytes for the same seed, kind words for a wrong recipe, and the truth comes back out."""

import json
from pathlib import Path

import numpy as np
import pytest

from millcal.cli import main
from millcal.data import Recording
from millcal.io.recordings import read_recording
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.conditioning import condition_cut

RECIPE = """
title = "Two cuts and a hit"
seed = 7
[cutter]
diameter_mm = 16
teeth = {teeth}
helix_deg = 30
runout_um = {runout}
runout_angle_deg = 20
[simulate]
sample_rate_hz = 12800
[simulate.law]
Ktc_N_per_mm2 = 820
Krc_N_per_mm2 = 260
Kac_N_per_mm2 = 230
Kte_N_per_mm = 18
Kre_N_per_mm = 16
Kae_N_per_mm = 6
[simulate.dynamometer]
{chain}
[simulate.hammer]
full_scale_N = 500
[simulate.accelerometer]
full_scale_g = 150
[simulate.conditions]
spindle_speed_rpm = 6000
axial_depth_mm = 2
radial_depth_mm = {radial}
direction = "{direction}"
"""
NOISY = 'noise_N = 1.5\nfull_scale_N = 2000\nmap = {fx = "+Fy", fy = "-Fx", fz = "+Fz"}\nacts_on = "workpiece"'
TEXT_CUTS = """
[[simulate.cuts]]
recording = "a.csv"
feed_per_tooth_mm = 0.1
duration_s = 0.2
start_time_s = 3
measuring_time_s = 50
[[simulate.cuts]]
recording = "b.txt"
format = "csv"
feed_mm_per_min = 1200
duration_s = 0.2
pulse = true
"""
HIT = """
[[simulate.modes]]
fn_hz = 900
zeta = 0.03
k_N_per_m = 2e7
shape = {tipX = 1.0}
[[simulate.impacts]]
recording = "tap.h5"
hammer = "tipX"
accelerometers = ["tipX"]
hits = 2
record_s = 0.1
peak_N = 200
pulse_ms = 0.3
"""


def recipe(text=TEXT_CUTS + HIT, *, chain=NOISY, teeth=2, runout=4, radial=16, direction="slot"):
    return RECIPE.format(chain=chain, teeth=teeth, runout=runout, radial=radial, direction=direction) + text


def simulate(folder: Path, text: str, *options: str, code=0) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recipe.toml").write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(folder / "recipe.toml"), "--out", str(folder / "out"), "--quiet", *options])
    assert ended.value.code == code
    return folder / "out"


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_the_same_seed_writes_the_same_bytes_and_another_seed_others(tmp_path):
    first, again = (bytes_of(simulate(tmp_path / name, recipe())) for name in "ab")
    other = bytes_of(simulate(tmp_path / "c", recipe(), "--seed", "8"))
    assert list(first) == ["a.csv", "b.txt", "tap.h5", "truth.json"]
    assert first == again
    assert all(first[name] != other[name] for name in first)


def test_a_recording_does_not_depend_on_those_after_it(tmp_path):
    alone = bytes_of(simulate(tmp_path / "alone", recipe(TEXT_CUTS)))
    beside = bytes_of(simulate(tmp_path / "beside", recipe()))
    assert alone["a.csv"] == beside["a.csv"]
    assert alone["b.txt"] == beside["b.txt"]


def test_text_read_back_through_the_map_is_the_force_on_the_tool(tmp_path):
    out = simulate(tmp_path / "text", recipe(TEXT_CUTS))
    plain = simulate(tmp_path / "plain", recipe(TEXT_CUTS, chain="noise_N = 1.5\nfull_scale_N = 2000"))
    mapping = {"fx": "+Fy", "fy": "-Fx", "fz": "+Fz"}
    turned = read_recording(out / "a.csv", map=mapping, acts_on="workpiece")
    straight = read_recording(plain / "a.csv", map={"fx": "+fx", "fy": "+fy", "fz": "+fz"}, acts_on="tool")
    assert turned.start_time == 3.0
    assert turned.sample_rate == 12800
    assert any(notice.code == "rows-against-header" for notice in turned.notices)
    assert np.abs(turned.samples - straight.samples).max() < 1e-3


def test_json_is_one_object_that_holds_the_truth(tmp_path, capsys):
    out = simulate(tmp_path / "json", recipe(), "--json")
    told = json.loads(capsys.readouterr().out)
    truth = json.loads((out / "truth.json").read_text())
    assert told["command"] == "simulate"
    assert told["result"] == truth
    assert truth["law"]["Ktc_N_per_mm2"] == 820
    assert truth["cutter"]["runout_um"] == 4
    assert truth["recordings"]["b.txt"]["conditions"]["feed_per_tooth_mm"] == pytest.approx(0.1)
    assert len(truth["recordings"]["tap.h5"]["hits"]) == 2


NOISE_FREE = "".join(
    f'[[simulate.cuts]]\nrecording = "f{feed}.h5"\nfeed_per_tooth_mm = {feed}\nduration_s = 0.4\npulse = true\n'
    "initial_angle_deg = 0\n"
    for feed in (0.05, 0.1, 0.15)
)


@pytest.mark.parametrize(
    ("method", "teeth", "runout", "radial", "direction", "tolerance"),
    [
        ("average", 2, 0, 16, "slot", 1e-6),
        ("nls", 2, 0, 5, "up", 1e-6),
        ("nls", 3, 3, 5, "down", 1e-6),
        ("nls", 2, 3, 16, "slot", 2e-5),  # two teeth do not show how the offset winds along the helix
    ],
)
def test_the_truth_of_cuts_without_noise_comes_back_out(tmp_path, method, teeth, runout, radial, direction, tolerance):
    text = recipe(NOISE_FREE, chain="", teeth=teeth, runout=runout, radial=radial, direction=direction)
    out = simulate(tmp_path / "clean", text)
    recordings: list[Recording] = [read_recording(path) for path in sorted(out.glob("*.h5"))]
    fit = fit_coefficients([condition_cut(recording, offset="none") for recording in recordings], method=method)
    expected = {"Ktc": 820e6, "Krc": 260e6, "Kac": 230e6, "Kte": 18e3, "Kre": 16e3, "Kae": 6e3}
    assert {name: fit.posterior[name] for name in expected} == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("Ktc_N_per_mm2 = 820\n", ""), "simulate.law: is no whole law"),
        (("axial_depth_mm = 2\n", ""), "axial_depth_mm: is missing"),
        (("direction = \"slot\"", "direction = \"sideways\""), "direction"),
        (('recording = "b.txt"', 'recording = "a.csv"'), "two recordings are named a.csv"),
        (('"+Fy", fy = "-Fx"', '"+Fy", fy = "-Fy"'), "does not name three columns"),
        (("hits = 2", "hits = 2\nfaults = [{hit = 5, kind = \"weak\", ratio = 0.1}]"), "beyond the last"),
        (('shape = {tipX = 1.0}', 'shape = {tipX = "a"}'), "shape"),
        (("diameter_mm = 16\n", ""), "diameter_mm: is missing"),
        (('recording = "tap.h5"', 'recording = "../tap.h5"'), "recording"),
    ],
)  # fmt: skip
def test_a_wrong_recipe_ends_in_one_line_that_names_the_key(tmp_path, capsys, change, says):
    text = recipe()
    assert change[0] in text
    out = simulate(tmp_path / "wrong", text.replace(*change), code=3)
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert told.count("\n") == 1
    assert says in told
    assert not out.exists()


def test_a_recipe_without_anything_to_simulate_says_so(tmp_path, capsys):
    simulate(tmp_path / "cuts", '[impact]\nrecordings = ["tap.h5"]\n', code=3)
    assert "there is no [simulate] table" in capsys.readouterr().err


def test_an_output_that_cannot_be_a_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").mkdir()
    (tmp_path / "file" / "out").write_text("something else")
    simulate(tmp_path / "file", recipe(), code=3)
    assert capsys.readouterr().err.count("\n") == 1
    assert (tmp_path / "file" / "out").read_text() == "something else"
