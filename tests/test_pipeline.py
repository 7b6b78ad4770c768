"""The main job: stages in their order, a folder that is whole or as it was, and the same bytes each time."""

import json
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from millcal import pipeline
from millcal.data import Coefficients, CutForce, Frf, Modes, StabilityMap
from millcal.errors import MillcalError, RecipeError, RecordingError
from millcal.io.recipes import read_recipe
from millcal.io.recordings import write_recording
from millcal.io.results import read_provenance, read_result, read_results
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import simulate_impact


def bytes_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def whole(recordings_folder, recipe_text, tmp_path_factory):
    """The result of the whole small recipe: (folder, PipelineResult)."""
    path = recordings_folder / "whole.toml"
    path.write_text(recipe_text)
    out = tmp_path_factory.mktemp("whole") / "out"
    return out, pipeline.run(read_recipe(path), out)


def test_every_stage_leaves_its_record_and_the_summary_its_answers(whole):
    out, found = whole
    assert sorted(path.name for path in out.iterdir()) == [
        "coefficients.h5", "cuts.h5", "frf.h5", "modes.h5", "report.html", "stability.h5", "summary.json",
    ]  # fmt: skip
    assert len(read_results(out / "cuts.h5", CutForce)) == 3
    assert read_result(out / "frf.h5", Frf).inputs == ("tipX", "tipY")
    assert read_result(out / "modes.h5", Modes).fit.inputs == ("tipX", "tipY")
    assert read_result(out / "coefficients.h5", Coefficients).posterior["Ktc"] == pytest.approx(820e6, rel=0.01)
    assert read_result(out / "stability.h5", StabilityMap).method == "zoa"
    summary = json.loads((out / "summary.json").read_text())
    assert summary == found.summary
    assert {"coefficients", "modes", "best", "expect", "report", "verdict"} <= set(summary)
    assert summary["best"][0]["rpm"] > 4000
    assert [mode["fn_hz"] for mode in summary["modes"]] == pytest.approx([700, 900], rel=1e-3)
    assert summary["modal_fit"]["residual_relative"] < 0.02
    assert [entry["ok"] for entry in summary["expect"]] == [True, True]
    assert found.missed == []
    assert len(summary["recordings"]) == 5


def test_every_file_carries_the_recipe_the_seed_and_the_sum_of_every_input(whole):
    out, _ = whole
    for name in ("cuts.h5", "frf.h5", "modes.h5", "coefficients.h5", "stability.h5"):
        origin = read_provenance(out / name)
        assert origin["seed"] == 4
        assert origin["recipe"].startswith('title = "Small slot cuts"')
        assert [path.rsplit("/", 1)[1] for path in origin["inputs"]] == [
            "cut-0.h5", "cut-1.h5", "cut-2.h5", "tap-x.h5", "tap-y.h5",
        ]  # fmt: skip
        assert set(origin["versions"]) >= {"millcal", "numpy", "scipy"}


def test_the_same_recipe_twice_gives_the_same_bytes_in_every_file(small_recipe, tmp_path):
    recipe = read_recipe(small_recipe())
    pipeline.run(recipe, tmp_path / "a")
    time.sleep(1.05)  # the resolution of a stamp
    pipeline.run(recipe, tmp_path / "another" / "b")
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "another" / "b")


def test_another_seed_moves_the_band_and_nothing_that_was_measured(whole, small_recipe, tmp_path):
    pipeline.run(read_recipe(small_recipe()), tmp_path / "out", seed=5)
    first, second = (read_result(folder / "stability.h5", StabilityMap) for folder in (whole[0], tmp_path / "out"))
    assert (first.limit_low != second.limit_low).any()
    assert (first.limit_depth == second.limit_depth).all()


CUTS_ONLY = """\
[[cuts]]
recording = "cut-0.h5"
[[cuts]]
recording = "cut-2.h5"
[conditioning]
harmonics = 6
[coefficients]
method = "average"
"""
IMPACT_ONLY = '[impact]\nrecordings = ["tap-x.h5"]\n'
BY_HAND = (
    CUTS_ONLY
    + """\
[cutter]
diameter_mm = 16
teeth = 2
helix_deg = 30
[structure]
modes = [
  {axis = "x", fn_hz = 700, zeta = 0.03, k_N_per_m = 2e7},
  {axis = "y", fn_hz = 900, zeta = 0.03, k_N_per_m = 3e7},
]
[stability]
rpm = [4000, 12000]
points = 20
"""
)


@pytest.mark.parametrize(
    ("text", "files", "notices"),
    [
        (CUTS_ONLY, {"cuts.h5", "coefficients.h5"}, set()),
        (IMPACT_ONLY, {"frf.h5", "modes.h5"}, set()),
        (IMPACT_ONLY + "[modes]\nfit = false\n", {"frf.h5"}, set()),
        (BY_HAND, {"cuts.h5", "coefficients.h5", "modes.h5", "stability.h5"}, set()),
        (
            CUTS_ONLY + "[cutter]\ndiameter_mm = 16\nteeth = 2\nhelix_deg = 30\n[stability]\nrpm = [4000, 12000]\n",
            {"cuts.h5", "coefficients.h5"},
            {"no-stability-map"},
        ),
        (
            IMPACT_ONLY + "[cutter]\ndiameter_mm = 16\nteeth = 2\n[stability]\nrpm = [4000, 12000]\n",
            {"frf.h5", "modes.h5"},
            {"no-stability-map"},
        ),
    ],
    ids=["cuts only", "impact only", "no modes wanted", "modes by hand", "no dynamics", "no cuts"],
)
def test_a_recipe_may_leave_stages_out_and_a_map_that_cannot_be_made_is_said(
    text, files, notices, small_recipe, tmp_path
):
    found = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == files | {"summary.json", "report.html"}
    assert {notice.code for notice in found.notices} & {"no-stability-map"} == notices


def test_modes_that_cannot_be_fitted_are_a_warning_and_the_run_goes_on(small_recipe, tmp_path):
    text = IMPACT_ONLY + "[modes]\nband_hz = [700, 700.5]\n"
    found = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    (warning,) = (notice for notice in found.notices if notice.code == "no-modes")
    assert warning.level == "warning"
    assert warning.where.endswith("small.toml:3: modes")
    assert found.summary["modes"] is None
    assert (tmp_path / "out" / "frf.h5").exists()


def with_dynamics(recipe_text, dynamics):
    return recipe_text.replace("points = 60\n", f'points = 20\ndynamics = "{dynamics}"\n')


def test_the_map_stands_on_the_frf_or_on_the_modes_as_the_recipe_says(whole, small_recipe, recipe_text, tmp_path):
    """With noise of a thousandth both say the same; the band of the modes is their own."""
    maps = {}
    for dynamics in ("frf", "corrected", "modes"):
        recipe = read_recipe(small_recipe(with_dynamics(recipe_text, dynamics)))
        maps[dynamics] = pipeline.run(recipe, tmp_path / dynamics).results["stability"]
    assert maps["modes"].limit_depth == pytest.approx(maps["frf"].limit_depth, rel=0.02)
    assert maps["corrected"].limit_depth == pytest.approx(maps["frf"].limit_depth, rel=0.01)
    assert (maps["modes"].limit_depth != maps["frf"].limit_depth).any()
    assert maps["modes"].absolute_minimum == pytest.approx(whole[1].results["stability"].absolute_minimum, rel=0.02)
    assert maps["modes"].limit_low is not None


def test_a_map_of_modes_that_could_not_be_fitted_is_left_out_with_the_reason(small_recipe, recipe_text, tmp_path):
    text = with_dynamics(recipe_text, "modes") + "[modes]\nband_hz = [700, 700.5]\n"
    found = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    assert {"no-modes", "no-stability-map"} <= {notice.code for notice in found.notices}
    assert not (tmp_path / "out" / "stability.h5").exists()


def test_where_the_records_end_too_early_the_map_stands_on_the_modes(whole, small_recipe, recipe_text, tmp_path):
    """25 ms hold three time constants of the slower mode, and the FRF is wrong by what is left."""
    truth = whole[1].results["stability"].absolute_minimum
    minimum = {}
    for dynamics in ("", "frf"):
        text = with_dynamics(recipe_text, dynamics) if dynamics else recipe_text
        recipe = read_recipe(small_recipe(text + "[frf]\nrecord_length_s = 0.025\n"))
        found = pipeline.run(recipe, tmp_path / f"out{dynamics}")
        codes = [notice.code for notice in found.notices]
        assert codes.count("map-from-modes") == (dynamics == "")
        assert "truncated" in codes
        minimum[dynamics] = found.results["stability"].absolute_minimum
    assert abs(minimum["frf"] / truth - 1) > 0.005
    assert abs(minimum[""] / truth - 1) < 0.001


def test_an_exponential_window_is_mapped_by_its_modes_and_refused_as_an_frf(whole, small_recipe, recipe_text, tmp_path):
    """The window adds 15 1/s to a mode that decays with 132 1/s, and the limit would rise with it."""
    window = "[frf]\nexponential = 0.05\n"
    found = pipeline.run(read_recipe(small_recipe(recipe_text + window)), tmp_path / "out")
    assert "map-from-modes" in {notice.code for notice in found.notices}
    truth = whole[1].results["stability"].absolute_minimum
    assert found.results["stability"].absolute_minimum == pytest.approx(truth, rel=0.01)
    with pytest.raises(MillcalError, match="exponential window added"):
        pipeline.run(read_recipe(small_recipe(with_dynamics(recipe_text, "frf") + window)), tmp_path / "frf")


def with_map(text, keys):
    """Of few speeds and no band, by another method."""
    return text.replace("points = 60\nmembers = 50\n", f"points = 8\nmembers = 0\n{keys}\n")


LOW = 'radial_depth_mm = 3\ndirection = "down"'  # immersion, where few nodes are needed


def test_floquet_takes_the_modes_and_frf_the_lines_without_being_told(small_recipe, recipe_text, tmp_path):
    """The cutter's helix is floquet's to take; a straight cutter is the frf's."""
    straight = recipe_text.replace("helix_deg = 30", "helix_deg = 0")
    maps = {}
    for method in ("floquet", "frf"):
        found = pipeline.run(
            read_recipe(small_recipe(with_map(straight, f'method = "{method}"\n{LOW}'))), tmp_path / method
        )
        maps[method] = read_result(tmp_path / method / "stability.h5", StabilityMap)
        assert found.summary["stability"]["method"] == method
        assert not {notice.code for notice in found.notices} & {"map-from-modes", "no-stability-map"}
    both = np.isfinite(maps["floquet"].limit_depth) & np.isfinite(maps["frf"].limit_depth)
    assert both.sum() > 3
    ratio = maps["frf"].limit_depth[both] / maps["floquet"].limit_depth[both]
    assert np.median(np.abs(ratio - 1)) < 0.05


LOG = """rpm,axial_depth_mm,stable,radial_depth_mm
6000,0.01,1,
7000,0.01,0,
8000,0.01,1,2
"""


def test_test_cuts_of_a_recipe_are_held_against_its_map_and_are_among_its_inputs(
    recordings_folder, small_recipe, recipe_text, tmp_path
):
    path = small_recipe(recipe_text.replace("points = 60\n", 'points = 20\ntests = "cuts.csv"\n'))
    (path.parent / "cuts.csv").write_text(LOG)
    found = pipeline.run(read_recipe(path), tmp_path / "out")
    told = found.summary["stability"]["tests"]
    assert (told["on_map"], told["as_mapped"]) == (2, 1)
    assert "tests-left-out" in {notice.code for notice in found.notices}
    assert any(name.endswith("cuts.csv") for name in found.provenance["inputs"])
    assert read_result(tmp_path / "out" / "stability.h5", StabilityMap).tests.stable == pytest.approx([1, 0])


def test_a_log_that_is_absent_is_named_with_its_key_and_one_alone_is_nothing_to_fit(
    small_recipe, recipe_text, tmp_path
):
    text = recipe_text.replace("points = 60\n", 'points = 20\ntests = "nowhere.csv"\n')
    with pytest.raises(RecordingError, match=r"stability\.tests: .*nowhere\.csv is absent"):
        pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    path = small_recipe(text.replace("cut-", "absent-").replace("tap-", "absent-").replace("nowhere", "alone"))
    (path.parent / "alone.csv").write_text(LOG)
    assert pipeline.run(read_recipe(path), tmp_path / "out").skipped


def test_conditions_of_the_recipe_win_over_those_of_the_recording(small_recipe, tmp_path, recipe_text):
    text = recipe_text.replace("axial_depth_mm = 2\ndirection", "axial_depth_mm = 4\ndirection")
    found = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    assert found.summary["coefficients"]["Ktc"]["value"] == pytest.approx(410, rel=0.01)


def test_recordings_that_are_all_absent_skip_the_recipe_and_leave_the_folder_alone(small_recipe, tmp_path, recipe_text):
    text = recipe_text.replace("cut-", "absent-").replace("tap-", "absent-")
    found = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")
    assert found.skipped
    assert [notice.code for notice in found.notices] == ["data-absent"]
    assert not (tmp_path / "out").exists()


def test_one_absent_recording_is_an_error_at_its_line(small_recipe, tmp_path, recipe_text):
    path = small_recipe(recipe_text.replace("tap-y.h5", "tap-q.h5"))
    with pytest.raises(RecordingError, match=r"small\.toml:33: impact\.recordings\.1: .*tap-q\.h5 is absent"):
        pipeline.run(read_recipe(path), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_failing_run_leaves_the_old_result(small_recipe, tmp_path, recordings_folder, recipe_text):
    out = tmp_path / "out"
    pipeline.run(read_recipe(small_recipe(CUTS_ONLY)), out)
    before = bytes_of(out)
    shutil.copy(recordings_folder / "cut-0.h5", tmp_path / "short.h5")
    with open(tmp_path / "short.h5", "r+b") as file:
        file.truncate(5000)
    broken = small_recipe(CUTS_ONLY.replace("cut-2.h5", str(tmp_path / "short.h5")), "broken.toml")
    with pytest.raises(MillcalError, match=r"short\.h5"):
        pipeline.run(read_recipe(broken), out)
    assert bytes_of(out) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "short.h5"]


def test_a_stage_that_refuses_an_option_names_its_line(small_recipe, tmp_path):
    text = CUTS_ONLY + 'law = "kienzle"\n'
    with pytest.raises(MillcalError, match=r"small\.toml:9: coefficients\.law: "):
        pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")


def test_a_recording_without_conditions_is_told_at_its_cut(small_recipe, tmp_path, recordings_folder):
    shutil.copy(recordings_folder / "cut-0.h5", tmp_path / "bare.h5")
    with h5py.File(tmp_path / "bare.h5", "a") as file:
        for key in ("spindle_speed_rpm", "feed_per_tooth_mm", "axial_depth_mm", "radial_depth_mm", "direction"):
            file.attrs.pop(key, None)
    text = f'[[cuts]]\nrecording = "{tmp_path / "bare.h5"}"\n'
    with pytest.raises(MillcalError, match="conditions"):
        pipeline.run(read_recipe(small_recipe(text)), tmp_path / "out")


def test_a_folder_with_something_else_in_it_is_not_replaced(small_recipe, tmp_path):
    recipe = read_recipe(small_recipe(CUTS_ONLY))
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RecipeError, match=r"holds notes\.txt, which is no part of a result"):
        pipeline.run(recipe, tmp_path)
    with pytest.raises(RecipeError, match="is a file; name a folder"):
        pipeline.run(recipe, tmp_path / "notes.txt")
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_empty_folder_and_an_old_result_are_replaced(small_recipe, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    pipeline.run(read_recipe(small_recipe(BY_HAND)), out)
    (out / "inputs.mk").write_text("")
    pipeline.run(read_recipe(small_recipe(CUTS_ONLY)), out)
    assert {path.name for path in out.iterdir()} == {"cuts.h5", "coefficients.h5", "summary.json", "report.html"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_link_to_a_result_keeps_pointing_to_it(small_recipe, tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    recipe = read_recipe(small_recipe(IMPACT_ONLY))
    for _ in range(2):
        pipeline.run(recipe, tmp_path / "link")
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "disk" / "frf.h5").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "link"]


def test_an_interrupted_run_leaves_nothing_behind(small_recipe, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "render", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(read_recipe(small_recipe(IMPACT_ONLY)), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_one_line(small_recipe, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecipeError, match="cannot be written"):
        pipeline.run(read_recipe(small_recipe(IMPACT_ONLY)), tmp_path / "file" / "out")


def test_progress_rises_from_0_to_1_and_says_which_file(small_recipe, tmp_path):
    told = []
    pipeline.run(
        read_recipe(small_recipe()), tmp_path / "out", progress=lambda share, label: told.append((share, label))
    )
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] == pytest.approx(1.0)
    assert any("cut-1.h5" in label for _, label in told)


@pytest.mark.parametrize(
    ("wanted", "ok"),
    [
        ('"coefficients.Ktc_N_per_mm2" = [810, 830]', True),
        ('"coefficients.Ktc_N_per_mm2" = [830, 840]', False),
        ('"coefficients.Kxx" = [0, 1]', False),
        ('"r2.y" = [0.99, 1]', True),
        ('"cuts.1.revolutions" = [30, 50]', True),
        ('verdict = "does not fit"', False),
        ('law = "linear-edge"', True),
    ],
)
def test_an_expectation_is_a_dotted_path_and_an_interval_or_the_beginning_of_a_text(wanted, ok, whole, small_recipe):
    _, found = whole
    recipe = read_recipe(small_recipe(CUTS_ONLY + f"[expect]\n{wanted}\n"))
    ((key, interval),) = recipe.expect.items()
    assert pipeline._expectation(found.summary, key, interval)["ok"] is ok


RUN = """
import sys
from millcal import pipeline
from millcal.io.recipes import read_recipe
recipe = read_recipe(sys.argv[1])
print("ready", flush=True)
while True:
    pipeline.run(recipe, sys.argv[2])
"""


@pytest.mark.parametrize("delay", [0.05, 0.4, 0.9, pytest.param(1.7, marks=pytest.mark.long)])
def test_a_killed_run_leaves_a_whole_result_or_none(delay, small_recipe, tmp_path):
    out = tmp_path / "out"
    run = subprocess.Popen([sys.executable, "-c", RUN, str(small_recipe(CUTS_ONLY)), str(out)], stdout=subprocess.PIPE)
    assert run.stdout.readline() == b"ready\n"
    time.sleep(delay)
    run.send_signal(signal.SIGKILL)
    run.wait()
    if out.exists():
        assert {path.name for path in out.iterdir()} == {"cuts.h5", "coefficients.h5", "summary.json", "report.html"}
        read_result(out / "coefficients.h5", Coefficients)
        json.loads((out / "summary.json").read_text())


SENSOR = """\
[cutter]
diameter_mm = 16
teeth = 2
helix_deg = 30

[[cuts]]
recording = "cut-0.h5"
[[cuts]]
recording = "cut-1.h5"
[[cuts]]
recording = "cut-2.h5"

[sensor]
recordings = ["hits.h5"]
"""


@pytest.fixture
def hits_on_the_dynamometer(recordings_folder):
    """An impact test on the dynamometer of the small cuts, along x."""
    chain = MeasuringChain(resonance=(400.0, 900.0, 900.0), damping_ratio=(0.1, 0.1, 0.1), noise=0.5)
    options = {"hits": 4, "record": 0.2, "peak": 800.0, "pulse": 1e-3, "sample_rate": 5000.0}
    test, _ = simulate_impact((), rng=np.random.default_rng(2), hammer="tipX", dynamometer=chain, **options)
    path = recordings_folder / "hits.h5"
    write_recording(path, test)
    yield path
    path.unlink(missing_ok=True)


def test_hits_on_the_dynamometer_become_the_sensor_of_the_fit(small_recipe, hits_on_the_dynamometer, tmp_path):
    found = pipeline.run(read_recipe(small_recipe(SENSOR)), tmp_path / "out")
    sensor = read_result(tmp_path / "out" / "sensor.h5", Frf)
    assert (sensor.form, sensor.inputs) == ("transmissibility", ("tipX",))
    assert found.summary["sensor"]["form"] == "transmissibility"
    assert found.summary["fit"]["harmonics"][1] == int(sensor.usable_band[1] / 100)
    assert "hits.h5" in str(list(found.provenance["inputs"]))
    # the same by way of a file
    text = SENSOR.replace('[sensor]\nrecordings = ["hits.h5"]', f'[coefficients]\nsensor = "{tmp_path}/out/sensor.h5"')
    again = pipeline.run(read_recipe(small_recipe(text)), tmp_path / "again")
    assert again.summary["coefficients"] == found.summary["coefficients"]
    # and it matters, for the cuts were not made on that dynamometer
    plain = pipeline.run(read_recipe(small_recipe(SENSOR.split("[sensor]")[0])), tmp_path / "plain")
    assert plain.summary["coefficients"] != found.summary["coefficients"]


def test_a_mistake_about_the_sensor_is_told_at_its_line(small_recipe, hits_on_the_dynamometer, tmp_path):
    with pytest.raises(RecordingError, match=r"small.toml:14: sensor.recordings.0: .*gone.h5 is absent"):
        pipeline.run(read_recipe(small_recipe(SENSOR.replace("hits.h5", "gone.h5"))), tmp_path / "out")
    with pytest.raises(RecordingError, match="role = 'response'"):
        pipeline.run(read_recipe(small_recipe(SENSOR.replace("hits.h5", "tap-x.h5"))), tmp_path / "out")
    with pytest.raises(RecipeError, match=r"small.toml:16: .*given twice; keep this key or \[sensor\]"):
        read_recipe(small_recipe(SENSOR + '[coefficients]\nsensor = "sensor.h5"\n'))
    with pytest.raises(RecipeError, match="is a transmissibility; leave the form out"):
        read_recipe(small_recipe(SENSOR + '[sensor.frf]\nform = "mobility"\n'))
    assert not (tmp_path / "out").exists()
