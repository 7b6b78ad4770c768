"""`inspect` and `ingest` as a shell sees them."""

import json

import numpy as np
import pytest

from millcal.cli import main
from millcal.io.recordings import read_recording

CHANNEL_KEYS = {"name", "quantity", "unit", "dof", "min", "max", "mean", "rms"}
INSPECT_KEYS = {"format", "sample_rate_hz", "samples", "duration_s", "channels"}


@pytest.fixture
def cut(tmp_path):
    path = tmp_path / "cut.csv"
    rows = (f"{i / 1000:.3f},{i % 7},{i % 5},{i % 3}" for i in range(2000))
    path.write_text("Time [s],Fx [N],Fy [N],Fz [kN]\n" + "\n".join(rows))
    return path


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return end.value.code, out, err


def test_inspect_prints_the_keys_of_the_contract(cut, capsys):
    code, out, _ = run(capsys, "inspect", cut, "--json")
    result = json.loads(out)["result"]
    assert code == 0
    assert set(result) >= INSPECT_KEYS
    assert all(set(channel) >= CHANNEL_KEYS for channel in result["channels"])
    assert (result["samples"], result["duration_s"]) == (2000, 2.0)


def test_inspect_of_several_files_lists_them(cut, capsys):
    files = json.loads(run(capsys, "inspect", cut, cut, "--json")[1])["result"]["files"]
    assert len(files) == 2
    code, out, _ = run(capsys, "inspect", cut, cut)
    assert (code, out.count("2000 samples, 1000 Hz, 2 s")) == (0, 2)


def test_ingest_prints_what_inspect_does_and_what_it_did(cut, tmp_path, capsys):
    code, out, _ = run(capsys, "ingest", cut, "-o", tmp_path / "cut.h5", "--map", "fx=-Fy", "--map", "fz=+Fz", "--json")
    result = json.loads(out)["result"]
    assert code == 0
    assert set(result) >= INSPECT_KEYS | {"mapping", "removed_offset", "removed_drift_per_s"}
    assert result["mapping"] == {"fx": "-Fy", "fz": "+Fz"}
    assert result["removed_offset"] == {"fx": 0.0, "fz": 0.0}
    assert read_recording(tmp_path / "cut.h5").samples[1].max() == 2000


def test_ingest_takes_the_cut_from_a_setup(cut, tmp_path, capsys):
    setup = tmp_path / "setup.toml"
    setup.write_text(
        '[map]\nfx = "+Fy"\nfy = "+Fx"\nacts_on = "workpiece"\n[cutter]\ndiameter_mm = 25\nteeth = 2\n'
        '[conditions]\nspindle_speed_rpm = 6000\nfeed_mm_per_min = 600\naxial_depth_mm = 3\ndirection = "slot"\n'
    )
    assert run(capsys, "ingest", cut, "-o", tmp_path / "cut.h5", "--setup", setup)[0] == 0
    recording = read_recording(tmp_path / "cut.h5")
    assert recording.conditions.feed_per_tooth == pytest.approx(0.05e-3)
    assert recording.samples[0, 1] == -1


def test_ingest_removes_the_mean_of_the_air_and_says_so(cut, tmp_path, capsys):
    _, out, _ = run(capsys, "ingest", cut, "-o", tmp_path / "cut.h5", "--air", "0:0.7", "--json")
    removed = json.loads(out)["result"]["removed_offset"]
    assert removed["Fx"] == pytest.approx(3.0)
    assert read_recording(tmp_path / "cut.h5").air == ((0.0, 0.7),)


def test_several_files_become_one_impact_test_with_a_segment_each(cut, tmp_path, capsys):
    assert run(capsys, "ingest", cut, cut, "-o", tmp_path / "taps.h5")[0] == 0
    recording = read_recording(tmp_path / "taps.h5")
    assert recording.kind == "impact"
    np.testing.assert_array_equal(recording.segments, [[0, 2000], [2000, 2000]])


def test_a_stated_sensitivity_and_rate_serve_a_file_without_either(tmp_path, capsys):
    path = tmp_path / "volts.txt"
    path.write_text("\n".join(f"{i % 7 / 10} {i % 5 / 10}" for i in range(100)))
    stated = [
        "--rate-hz",
        25600,
        "--unit",
        "col1=2.25 mV/N",
        "--unit",
        "col2=100 mV/g",
        "--map",
        "hammer@tipX=col1",
        "--map",
        "a@tipX=col2",
    ]
    assert run(capsys, "ingest", path, "-o", tmp_path / "tap.h5", *stated, "--kind", "impact")[0] == 0
    recording = read_recording(tmp_path / "tap.h5")
    assert recording.sample_rate == 25600
    np.testing.assert_allclose(recording.samples[:, 1], [0.1 / 2.25e-3, 0.1 / 0.1 * 9.80665])
    assert [channel.dof for channel in recording.channels] == ["tipX", "tipX"]
