"""The main job without a dynamometer: cuts by way of forces to coefficients and a map, and options at their lines."""

import json
import time

import pytest
from heard_recordings import CUTS, CUTTER_KEYS, TAPS, TRUTH, record_all

from millcal import pipeline
from millcal.cli import main
from millcal.data import Coefficients, CutVibration, ForceHarmonics, StabilityMap
from millcal.errors import MillcalError
from millcal.io.recipes import read_recipe
from millcal.io.results import read_result, read_results
from millcal.io.summaries import value_at

HEARD = CUTTER_KEYS + "".join(f'[[cuts]]\nrecording = "{cut}"\n' for cut in CUTS)
IMPACT = f"[impact]\nrecordings = {json.dumps(TAPS)}\n"
LINES = IMPACT + "[modes]\nfit = false\n"  # the FRF and no modes, which take the most time
FORCES = "[forces]\nadvise_rpm = [2000, 6000]\n"
MAP = '[stability]\nrpm = [2000, 8000]\npoints = 20\nmembers = 50\ndirection = "slot"\n'
WHOLE = 'title = "Heard"\nseed = 3\n' + HEARD + IMPACT + FORCES + MAP


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of the recordings."""
    made = tmp_path_factory.mktemp("heard")
    record_all(made)
    return made


@pytest.fixture
def recipe(folder):
    """recipe(text) writes a recipe beside the recordings.   returns its path"""

    def write(text=WHOLE):
        path = folder / "small.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    """The result of a recipe with all stages: (folder, PipelineResult)."""
    path = folder / "whole.toml"
    path.write_text(WHOLE)
    out = tmp_path_factory.mktemp("whole") / "out"
    return out, pipeline.run(read_recipe(path), out)


def test_cuts_without_force_channels_end_in_coefficients_and_a_map(whole):
    out, found = whole
    assert sorted(path.name for path in out.iterdir()) == [
        "coefficients.h5", "cuts.h5", "forces.h5", "frf.h5", "modes.h5", "report.html", "stability.h5", "summary.json",
    ]  # fmt: skip
    assert [cut.angle_from for cut in read_results(out / "cuts.h5", CutVibration)] == ["pulse", "pulse"]
    forces = read_result(out / "forces.h5", ForceHarmonics)
    assert forces.advice is not None
    fit = read_result(out / "coefficients.h5", Coefficients)
    assert fit.posterior.names == forces.posterior.names
    assert read_result(out / "stability.h5", StabilityMap).limit_low is not None
    summary = json.loads((out / "summary.json").read_text())
    assert summary == found.summary
    for name, value in TRUTH.items():
        unit = "N_per_mm2" if name.endswith("c") else "N_per_mm"
        assert value_at(summary, f"coefficients.{name}_{unit}") == pytest.approx(value, rel=0.03)
        assert value_at(summary, f"forces.coefficients.{name}_{unit}") == pytest.approx(value, rel=0.03)
    assert summary["forces"]["unobservable"] == ["Kae"]
    assert summary["forces"]["method"] == summary["method"] == "gtls"
    assert [cut["name"].rsplit("/", 1)[-1] for cut in summary["cuts"]] == list(CUTS)
    assert summary["verdict"] == summary["forces"]["verdict"]


def test_the_report_is_made_again_from_the_folder_alone(whole, capsys):
    out, _ = whole
    before = (out / "report.html").read_bytes()
    with pytest.raises(SystemExit) as end:
        main(["report", str(out)])
    assert end.value.code == 0
    assert (out / "report.html").read_bytes() == before


def test_the_same_recipe_gives_the_same_bytes(whole, folder, tmp_path):
    out, _ = whole
    plan = read_recipe(folder / "whole.toml")
    time.sleep(1.05)  # the resolution of a stamp
    pipeline.run(plan, tmp_path / "again")
    names = sorted(path.name for path in out.iterdir())
    assert [(tmp_path / "again" / name).read_bytes() for name in names] == [(out / name).read_bytes() for name in names]


def test_fit_tells_of_the_forces_between_modes_and_coefficients(recipe, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["fit", str(recipe(HEARD + IMPACT + FORCES)), "--out", str(tmp_path / "out"), "--quiet"])
    assert end.value.code == 0
    out = capsys.readouterr().out
    places = [out.index(words) for words in ("real modes", "forces along x y z by gtls", "linear-edge law by gtls")]
    assert places == sorted(places)
    assert "best spindle speeds" in out


def test_gtls_of_the_coefficients_alone_and_an_frf_of_a_file_say_the_same(whole, recipe, tmp_path):
    out, found = whole
    text = HEARD + f'[modes]\nfit = false\n[coefficients]\nmethod = "gtls"\n[forces]\nfrf_file = "{out / "frf.h5"}"\n'
    plan = read_recipe(recipe(text))
    again = pipeline.run(plan, tmp_path / "out")
    assert again.summary["coefficients"] == found.summary["coefficients"]
    assert (out / "frf.h5").as_posix() in again.provenance["inputs"]
    short = pipeline.run(read_recipe(recipe(HEARD + LINES + '[coefficients]\nmethod = "gtls"\n')), tmp_path / "short")
    assert short.summary["coefficients"] == found.summary["coefficients"]
    assert short.summary["forces"]["advice"] is None


@pytest.mark.parametrize(
    ("keys", "name", "value"),
    [
        ('method = "rtls"\nslack_N = 0.02', "method", "rtls"),
        ('method = "tikhonov"\nregularization = 1e-5', "regularization", 1e-5),
        ('frf = "modes"', "frf_from", "modes"),
        ("harmonics = 2", "harmonics", 4),
    ],
)
def test_every_key_of_the_recipe_reaches_the_stage(keys, name, value, recipe, tmp_path):
    tests = IMPACT if "modes" in keys else LINES
    found = pipeline.run(read_recipe(recipe(HEARD + tests + f"[forces]\n{keys}\n")), tmp_path / "out")
    told = found.summary["forces"][name]
    assert (len(told) if name == "harmonics" else told) == value
    assert found.summary["method"] == found.summary["forces"]["method"]


def test_a_cut_that_shows_no_ktc_gives_no_map_and_says_why(tmp_path):
    """Four equal teeth in a slot: their cutting force is constant, only the edges are heard."""
    record_all(tmp_path, teeth=4)
    text = WHOLE.replace("teeth = 2", "teeth = 4").replace(IMPACT, LINES)
    path = tmp_path / "four.toml"
    path.write_text(text)
    found = pipeline.run(read_recipe(path), tmp_path / "out")
    assert "stability" not in found.results
    (notice,) = [notice for notice in found.notices if notice.code == "no-stability-map"]
    assert "Ktc and Krc are not known" in notice.message
    assert {"Ktc", "Krc"} <= set(found.summary["forces"]["unobservable"])
    assert found.summary["coefficients"]["Kte"]["value"] == pytest.approx(TRUTH["Kte"], rel=0.1)


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        (HEARD + IMPACT + '[forces]\nphase = "known"\n', "forces.phase", ""),
        (HEARD + IMPACT + FORCES + '[coefficients]\nlaw = "kienzle"\n', "coefficients.law", "linear-edge law alone"),
        (HEARD + IMPACT + FORCES + "[coefficients]\nharmonics = 4\n", "coefficients.harmonics", "goes with method nls"),
        (HEARD + IMPACT + FORCES + '[sensor]\nrecordings = ["tap-tipX.h5"]\n', "coefficients.sensor", "has no place"),
        (HEARD + '[forces]\nfrf_file = "absent.h5"\n', "forces.frf_file", "is absent"),
        (HEARD.replace(CUTS[1], TAPS[0]) + IMPACT + FORCES, None, TAPS[0]),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_told_at_its_line_and_leaves_nothing(text, key, said, recipe, tmp_path):
    path = recipe(text)
    with pytest.raises(MillcalError) as refused:
        pipeline.run(read_recipe(path), tmp_path / "out")
    assert said in str(refused.value)
    if key:
        assert str(refused.value).startswith(f"{path}:")
        assert f" {key}: " in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_progress_rises_over_all_stages(recipe, tmp_path):
    told = []
    pipeline.run(
        read_recipe(recipe(HEARD + LINES + FORCES)), tmp_path / "out", progress=lambda *said: told.append(said)
    )
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert any("force" in label for _, label in told)
