"""`millcal judge`: what it says, writes and refuses."""

import json
import re

import numpy as np
import pytest

from millcal.cli import main
from millcal.data import Channel, Judgement, Recording
from millcal.io.cuts_log import read_cuts_log
from millcal.io.recordings import write_recording
from millcal.io.results import read_result, read_results
from millcal.physics.cutter import Cutter, CuttingConditions

RATE, SPINDLE, TEETH = 8000.0, 95.0, 3
M_UM = 4 / np.pi * 2.6 * np.sin(np.pi * (871.0 / 285.0 - 3))  # both lines look alike once per tooth


def recording(path, chatter, *, known=True, unit="m", quantity="displacement"):
    """Half a micrometre of forced vibration, and chatter of some at 871 Hz."""
    rng, time = np.random.default_rng(1), np.arange(6000) / RATE
    y = sum(0.5e-6 / k * np.cos(2 * np.pi * TEETH * k * SPINDLE * time + k) for k in range(1, 6))
    y += chatter * np.cos(2 * np.pi * 871.0 * time) + 0.3 * chatter * np.cos(2 * np.pi * (871.0 - 285.0) * time)
    y += 5e-9 * rng.normal(size=len(time))
    write_recording(
        path,
        Recording(
            samples=y[np.newaxis],
            sample_rate=RATE,
            channels=(Channel("tip", quantity, unit, "tipX"),),
            cutter=Cutter(diameter=12e-3, teeth=TEETH) if known else None,
            conditions=CuttingConditions(2 * np.pi * SPINDLE, 0.1e-3, 1.5e-3, 4e-3, "down") if known else None,
        ),
    )


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """Run the command beside recordings.   returns (exit code, stdout, stderr)"""
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "good.h5", 0.0)
    recording(tmp_path / "bad.h5", 2e-6)
    recording(tmp_path / "mute.h5", 2e-6, known=False)

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main(["judge", *map(str, words)])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


def test_the_keys_of_the_contract(run):
    code, out, _ = run("bad.h5", "--json")
    told = json.loads(out)
    result = told["result"]
    assert (code, told["command"], set(told["inputs"])) == (0, "judge", {"bad.h5"})
    assert result["verdict"] == "chatter"
    assert result["period"] is None
    assert result["chatter_hz"] == pytest.approx(871.0, abs=0.3)
    assert result["stable_rpm"][:2] == pytest.approx([871.0 * 60 / 3, 871.0 * 60 / 6], rel=1e-3)
    assert result["M_um"] == pytest.approx(M_UM, rel=0.03)
    assert result["spindle_speed_rpm"] == pytest.approx(5700.0, rel=1e-4)
    stable = json.loads(run("good.h5", "--json")[1])["result"]
    assert (stable["verdict"], stable["period"], stable["chatter_hz"]) == ("stable", 1, None)
    assert stable["M_um"] < 0.02


def test_a_reader_sees_the_verdict_first(run):
    code, out, err = run("bad.h5")
    assert code == 0
    assert out.startswith("chatter: ")
    assert "871" in out
    near = re.search(r"speeds it points to, the nearest first: (.*) rpm", out)
    assert near is not None
    assert [float(rpm) for rpm in near[1].split(", ")] == pytest.approx([5807, 4355, 8710, 3484, 2903], abs=2)
    assert "note: the noise does not fall off" in out  # the line may be an alias
    assert err == ""


def test_several_cuts_make_a_table_and_a_log_that_can_be_read_back(run, tmp_path):
    code, out, _ = run("good.h5", "bad.h5", "--log", "cuts.csv", "-o", "cuts.h5")
    assert code == 0
    assert "good.h5" in out.splitlines()[1]
    good, bad = read_cuts_log(tmp_path / "cuts.csv")
    assert (good.stable, bad.stable) == (True, False)
    assert good.axial_depth == pytest.approx(1.5e-3)
    assert good.radial_depth == pytest.approx(4e-3)
    assert good.direction == "down"
    assert bad.chatter_frequency == pytest.approx(871.0, abs=0.3)
    assert bad.metric == pytest.approx(1e-6 * M_UM, rel=0.03)
    kept = read_results(tmp_path / "cuts.h5", Judgement)
    assert [cut.verdict for cut in kept] == ["stable", "chatter"]


def test_a_result_and_a_figure_hold_what_was_said(run, tmp_path):
    code, _, _ = run("bad.h5", "-o", "j.h5", "--figure", "j.svg")
    assert code == 0
    found = read_result(tmp_path / "j.h5", Judgement)
    assert found.chatter_frequency == pytest.approx(871.0, abs=0.3)
    assert (tmp_path / "j.svg").read_text().startswith("<?xml")
    first = (tmp_path / "j.svg").read_bytes()
    run("bad.h5", "--figure", "j.svg")
    assert (tmp_path / "j.svg").read_bytes() == first


def test_a_page_holds_all_cuts_with_their_verdicts(run, tmp_path):
    code, out, _ = run("good.h5", "bad.h5", "--figure", "cuts.html")
    assert code == 0
    assert "figure: cuts.html" in out
    page = (tmp_path / "cuts.html").read_text(encoding="utf-8")
    assert page.count("<h2>Was that chatter: ") == 2
    assert "bad: chatter at 871" in page
    assert "good: stable" in page
    assert 'src="http' not in page


def test_teeth_and_speed_on_the_command_line_do_for_a_file_that_says_nothing(run):
    code, out, _ = run("mute.h5", "--teeth", 3, "--rpm", 5720, "--json")
    assert code == 0
    assert json.loads(out)["result"]["verdict"] == "chatter"
    assert run("mute.h5", "--teeth", 3)[0] == 3
    code, _, err = run("mute.h5")
    assert code == 3
    assert "--teeth" in err


def test_modes_say_what_the_sample_rate_cannot_show(run, tmp_path):
    (tmp_path / "setup.toml").write_text(
        "[cutter]\ndiameter_mm = 12\nteeth = 3\n[[structure.modes]]\n"
        'axis = "x"\nfn_hz = 5200\nzeta = 0.02\nk_N_per_m = 2e7\n'
    )
    code, _, err = run("good.h5", "--setup", "setup.toml")
    assert code == 0
    assert "[sample-rate]" in err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["bad.h5", "--channel", "mic"], 3, "no channel 'mic'"),
        (["bad.h5", "good.h5", "--figure", "a.png"], 2, "one recording"),
        (["bad.h5", "--figure", "a.bmp"], 2, "format"),
        (["bad.h5", "--steady", "0.5", "0.2"], 2, "no stretch"),
        (["bad.h5", "--steady", "0", "inf"], 2, "no stretch"),
        (["bad.h5", "--axial-depth-mm", "inf", "--log", "a.csv"], 2, "finite"),
        (["bad.h5", "--rpm", "nan"], 2, "finite"),
        (["bad.h5", "good.h5", "--rpm", "5700", "5800"], 2, "--rpm once for each"),
        (["bad.h5", "-o", "bad.h5"], 2, "written over"),
        (["mute.h5", "--teeth", "3", "--rpm", "5700", "--log", "a.csv"], 3, "axial depth"),
        (["nowhere.h5"], 3, "nowhere.h5"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(run, words, code, said):
    found, out, err = run(*words)
    assert found == code
    assert out == ""
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_depth_and_speed_on_the_command_line_do_for_the_log(run, tmp_path):
    code, _, err = run("mute.h5", "--teeth", 3, "--rpm", 5700, "--axial-depth-mm", 2.5, "--log", "cuts.csv")
    assert (code, err) == (0, "")
    (cut,) = read_cuts_log(tmp_path / "cuts.csv")
    assert (cut.axial_depth, cut.stable, cut.radial_depth) == (pytest.approx(2.5e-3), False, None)


def test_a_setup_need_say_nothing_that_a_verdict_does_not_rest_on(run, tmp_path):
    setup = tmp_path / "setup.toml"
    setup.write_text("[cutter]\ndiameter_mm = 12\nteeth = 3\n")
    code, out, _ = run("mute.h5", "--setup", setup, "--rpm", 5700, "--json")
    assert code == 0
    assert json.loads(out)["result"]["verdict"] == "chatter"
    setup.write_text(
        "[cutter]\ndiameter_mm = 12\nteeth = 3\n[conditions]\nspindle_speed_rpm = 5700\naxial_depth_mm = 2\n"
    )
    assert run("mute.h5", "--setup", setup, "--log", "cuts.csv")[0] == 0
    assert read_cuts_log(tmp_path / "cuts.csv")[0].axial_depth == pytest.approx(2e-3)
    setup.write_text("[cutter]\ndiameter_mm = 12\nteeth = 3\n")
    code, _, err = run("mute.h5", "--setup", setup)
    assert code == 3
    assert "--rpm" in err


def test_an_impact_test_among_the_cuts_is_left_out_with_a_word(run, tmp_path):
    time = np.arange(4000) / RATE
    hit = np.exp(-(((time - 0.1) / 2e-4) ** 2))
    ring = np.where(time > 0.1, np.exp(-40 * (time - 0.1)) * np.sin(2 * np.pi * 900 * (time - 0.1)), 0.0)
    write_recording(
        tmp_path / "hit.h5",
        Recording(
            samples=np.array([hit, 1e-6 * ring]),
            sample_rate=RATE,
            channels=(Channel("hammer", "force", "N", "tipX"), Channel("tip", "displacement", "m", "tipX")),
            kind="impact",
        ),
    )
    code, out, err = run(
        "good.h5",
        "hit.h5",
        "bad.h5",
        "--axial-depth-mm",
        1,
        "--axial-depth-mm",
        2,
        "--axial-depth-mm",
        3,
        "--log",
        "cuts.csv",
    )
    assert code == 0
    assert "[impact-test]" in err
    assert "hit" not in out
    assert [cut.axial_depth for cut in read_cuts_log(tmp_path / "cuts.csv")] == pytest.approx([1e-3, 3e-3])
    code, _, err = run("hit.h5")
    assert code == 3
    assert "impact test" in err


@pytest.mark.parametrize(("key", "verdict"), [("runout_um = 0", "period-n"), ("", "not known")])
def test_a_runout_stated_as_none_is_not_a_runout_unsaid(run, tmp_path, key, verdict):
    rng, time = np.random.default_rng(2), np.arange(12_000) / RATE
    y = sum(np.cos(2 * np.pi * k * SPINDLE * time + k) / (1 + k / 2) for k in range(1, 20))
    samples = 1e-6 * (y + 0.01 * rng.normal(size=len(time)))
    channels = (Channel("tip", "displacement", "m", "Z"),)
    write_recording(tmp_path / "two.h5", Recording(samples=samples[np.newaxis], sample_rate=RATE, channels=channels))
    (tmp_path / "setup.toml").write_text(f"[cutter]\ndiameter_mm = 12\nteeth = 2\n{key}\n")
    code, out, _ = run("two.h5", "--setup", "setup.toml", "--rpm", 60 * SPINDLE, "--json")
    assert (code, json.loads(out)["result"]["verdict"]) == (0, verdict)


def test_a_bad_file_among_cuts_costs_its_own_line_and_no_other(run, tmp_path):
    (tmp_path / "broken.csv").write_text("")
    code, out, err = run("good.h5", "broken.csv", "bad.h5", "nowhere.h5", "--log", "cuts.csv", "--json")
    told = json.loads(out)
    assert code == 4
    assert [cut["verdict"] for cut in told["result"]["cuts"]] == ["stable", "chatter"]
    assert [cut["recording"] for cut in told["result"]["refused"]] == ["broken.csv", "nowhere.h5"]
    assert set(told["inputs"]) == {"good.h5", "bad.h5"}
    assert [cut.stable for cut in read_cuts_log(tmp_path / "cuts.csv")] == [True, False]
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    assert [line.split(":")[1].strip() for line in errors] == ["broken.csv", "nowhere.h5"]
    code, out, err = run("broken.csv", "nowhere.h5", "--log", "none.csv")
    assert (code, out, len(err.splitlines())) == (3, "", 2)
    assert not (tmp_path / "none.csv").exists()


def test_what_repeats_with_the_turn_is_told_in_turns(run, tmp_path):
    (tmp_path / "uneven.toml").write_text(
        "[cutter]\ndiameter_mm = 12\nteeth = 3\npitch_deg = [110, 120, 130]\n[conditions]\nspindle_speed_rpm = 5700\n"
    )
    code, out, _ = run("mute.h5", "--setup", "uneven.toml", "-o", "turns.h5", "--figure", "turns.html")
    assert code == 0
    assert "from turn to turn" in out
    assert "whole turns apart" in out
    assert "tooth to tooth" not in out
    assert read_result(tmp_path / "turns.h5", Judgement).per == "revolution"
    assert "Once per turn" in (tmp_path / "turns.html").read_text(encoding="utf-8")
    even = json.loads(run("mute.h5", "--setup", "uneven.toml", "--teeth", 2, "--json")[1])["result"]
    assert even["per"] == "tooth"  # a pitch of three teeth says nothing of two
