"""The main job with methods that follow coefficients: a history in the folder, a map where it ends, options at their lines."""

import csv
import json
import re
import time

import pytest
from short_cuts import record_cut

from millcal import pipeline
from millcal.cli import main
from millcal.data import CoefficientHistory, StabilityMap
from millcal.errors import MillcalError
from millcal.io.recipes import read_recipe
from millcal.io.results import read_result
from millcal.io.summaries import value_at

CUTS = """\
seed = 3
[cutter]
diameter_mm = 12
teeth = 2
helix_deg = 30
[[cuts]]
recording = "fine.h5"
[[cuts]]
recording = "coarse.h5"
[coefficients]
law = "kienzle"
method = "enkf-inflated"
members = 50
chain_lowpass_hz = 600
"""
MAP = """\
[structure]
modes = [
  {axis = "x", fn_hz = 700, zeta = 0.03, k_N_per_m = 2e7},
  {axis = "y", fn_hz = 900, zeta = 0.03, k_N_per_m = 3e7},
]
[stability]
method = "zoa"
rpm = [4000, 12000]
points = 20
members = 50
"""
EXPECT = """\
[expect]
"coefficients.kt_N_per_mm2" = [1300, 1700]
"coefficients.mt" = [0.15, 0.27]
method = "enkf-inflated"
"""


@pytest.fixture(scope="module")
def cuts(tmp_path_factory):
    """The folder of the recordings and of the recipe for all stages."""
    folder = tmp_path_factory.mktemp("cuts")
    record_cut(folder / "fine.h5")
    record_cut(folder / "coarse.h5", feed=120e-6, seed=1)
    (folder / "followed.toml").write_text(CUTS + MAP + EXPECT)
    return folder


@pytest.fixture
def recipe(cuts):
    """recipe(text) writes a recipe beside the recordings.   returns its path"""

    def write(text=CUTS):
        path = cuts / "small.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope="module")
def followed(cuts, tmp_path_factory):
    """The result of a recipe with a history and a map: (folder, PipelineResult)."""
    path = cuts / "followed.toml"
    out = tmp_path_factory.mktemp("followed") / "out"
    return out, pipeline.run(read_recipe(path), out)


def test_a_history_takes_the_place_of_coefficients_and_the_map_stands_on_its_end(followed):
    out, found = followed
    assert sorted(path.name for path in out.iterdir()) == [
        "coefficients.h5", "history.csv", "modes.h5", "report.html", "stability.h5", "summary.json",
    ]  # fmt: skip
    history = read_result(out / "coefficients.h5", CoefficientHistory)
    rows = list(csv.DictReader((out / "history.csv").open(newline="")))
    assert len(rows) == len(history.time)
    assert read_result(out / "stability.h5", StabilityMap).limit_low is not None
    summary = json.loads((out / "summary.json").read_text())
    assert summary == found.summary
    assert [cut["angle_from"] for cut in summary["cuts"]] == ["speed", "speed"]
    assert [entry["ok"] for entry in summary["expect"]] == [True, True, True]
    assert {"jumps", "slope_percent_per_min"} <= set(summary)
    assert value_at(summary, "coefficients.kt_N_per_mm2") == pytest.approx(history.posterior["kt"] / 1e6)


def test_the_report_is_made_again_from_the_folder_alone(followed, capsys):
    out, _ = followed
    before = (out / "report.html").read_bytes()
    with pytest.raises(SystemExit) as end:
        main(["report", str(out)])
    assert end.value.code == 0
    assert (out / "report.html").read_bytes() == before


def test_the_command_of_the_map_takes_a_history(followed, tmp_path, capsys):
    out, _ = followed
    files = ["--coefficients", str(out / "coefficients.h5"), "--modes", str(out / "modes.h5")]
    conditions = ["--method", "zoa", "--rpm", "4000", "12000", "--points", "20", "--members", "50"]
    with pytest.raises(SystemExit) as end:
        main(["stability", *files, *conditions, "--seed", "3", "-o", str(tmp_path / "map.h5")])
    assert end.value.code == 0
    assert read_result(tmp_path / "map.h5", StabilityMap).limit_depth == pytest.approx(
        read_result(out / "stability.h5", StabilityMap).limit_depth
    )


def test_the_same_recipe_gives_the_same_bytes_and_another_seed_another_ensemble(followed, cuts, tmp_path):
    out, _ = followed
    plan = read_recipe(cuts / "followed.toml")
    time.sleep(1.05)  # the resolution of a stamp
    pipeline.run(plan, tmp_path / "again")
    names = sorted(path.name for path in out.iterdir())
    assert [(tmp_path / "again" / name).read_bytes() for name in names] == [(out / name).read_bytes() for name in names]
    pipeline.run(plan, tmp_path / "other", seed=4)
    assert (tmp_path / "other" / "history.csv").read_bytes() != (out / "history.csv").read_bytes()


def test_an_old_history_does_not_outlive_another_method(recipe, tmp_path):
    out = tmp_path / "out"
    pipeline.run(read_recipe(recipe(CUTS)), out)
    assert (out / "history.csv").exists()
    pipeline.run(read_recipe(recipe(CUTS.split("[coefficients]")[0] + '[coefficients]\nmethod = "average"\n')), out)
    assert {path.name for path in out.iterdir()} == {"cuts.h5", "coefficients.h5", "summary.json", "report.html"}


def test_an_interrupt_while_it_follows_leaves_nothing(recipe, tmp_path):
    def stop(share, label):
        if share > 0.25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pipeline.run(read_recipe(recipe(CUTS)), tmp_path / "out", progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_progress_rises_while_the_method_follows(recipe, tmp_path):
    told = []
    pipeline.run(read_recipe(recipe(CUTS)), tmp_path / "out", progress=lambda *said: told.append(said))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert sum(0.2 < share < 0.9 for share in shares) >= 1
    assert any("coarse.h5" in label for _, label in told)


OPTIONS = {  # beside those of the command line, which has a test of its own
    "chip": "chip_threshold_um = 20",
    "share": "inflated_share = 0.3",
    "nodes": "nodes = 3",
    "smoothing": "[conditioning]\nlowpass_hz = 800",
    "offset": '[conditioning]\noffset = "none"',
}
GIVEN = """\
forgetting = 0.9
bounds = {kt_N_per_mm2 = [500, 2500], mt = [0.1, 0.7]}
chain_lowpass_order = 3
jumps = false
inflate_every = 20
inflation = 3
"""


def with_option(line):
    """The recipe with one more line of [coefficients], which goes before one of the same key."""
    key = line.split(" ")[0]
    return "\n".join(kept for kept in CUTS.splitlines() if not kept.startswith(f"{key} =")) + f"\n{line}\n"


@pytest.mark.parametrize("name", OPTIONS)
def test_every_key_of_the_recipe_reaches_the_method(name, followed, recipe, tmp_path):
    pipeline.run(read_recipe(recipe(with_option(OPTIONS[name]))), tmp_path / "out")
    found = (tmp_path / "out" / "history.csv").read_text()
    assert found != (followed[0] / "history.csv").read_text()


def test_options_come_to_the_stage_in_si(recipe, tmp_path, monkeypatch):
    class SeenError(Exception):
        pass

    def stage(cuts, **options):
        raise SeenError(options)

    monkeypatch.setattr(pipeline, "identify_coefficients", stage)
    monkeypatch.setattr(pipeline, "_check_options", lambda _: None)
    with pytest.raises(SeenError) as seen:
        pipeline.run(read_recipe(recipe(CUTS + GIVEN)), tmp_path / "out")
    (options,) = seen.value.args
    assert options["bounds"] == {"kt": (500e6, 2500e6), "mt": (0.1, 0.7)}
    wanted = {"forgetting": 0.9, "chain_lowpass": 600.0, "chain_lowpass_order": 3, "jumps": False, "inflate_every": 20}
    assert {name: options[name] for name in wanted} == wanted
    assert options["inflation"] == 3
    assert options["chip_threshold"] == pytest.approx(0.5e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_option("forgetting = 0.9"), "coefficients.forgetting: goes with method rls, not enkf-inflated; leave it out"),
        (with_option("harmonics = 4"), "coefficients.harmonics: goes with method nls"),
        (with_option('method = "nls"'), "coefficients.chain_lowpass_hz: goes with method smooth, imm, rls"),
        (with_option('sensor = "fine.h5"'), "coefficients.sensor: method enkf-inflated has no place for"),
        (with_option("chain_lowpass_hz = 2500"), "coefficients.chain_lowpass_hz: 2500 Hz is not below half"),
        (with_option("bounds = {kt_N_per_mm2 = [800, 840]}"), "coefficients.bounds: kt is bounded and mt is not"),
        (with_option("[conditioning]\nlowpass_hz = 2500"), "conditioning.lowpass_hz: 2500 Hz is not below half"),
        (with_option("[conditioning]\nharmonics = 8"), "conditioning.harmonics: method enkf-inflated takes every sample"),
        (with_option("bounds = {kt = [800, 840]}"), "coefficients.bounds: 'kt' is no coefficient with its unit"),
        (with_option("bounds = {mt = [0.4, 0.2]}"), "does not rise"),
        (with_option("members = 5"), "coefficients.members"),
        (with_option("forgetting = 1.5"), "coefficients.forgetting"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_told_at_its_line(text, said, recipe, tmp_path):
    path = recipe(text)
    with pytest.raises(MillcalError) as refused:
        pipeline.run(read_recipe(path), tmp_path / "out")
    place, _, rest = str(refused.value).partition(": ")
    named = re.match(r"\w+\.(\w+)", rest)
    line = next(i for i, row in enumerate(text.splitlines(), 1) if row.startswith(f"{named[1]} ="))
    assert place == f"{path}:{line}"
    assert said in rest
    assert list(tmp_path.iterdir()) == []
