"""`millcal frf`: recordings in, an FRF file and a table of the hits out; every mistake one line."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from millcal.cli import main
from millcal.data import Frf
from millcal.io.results import read_provenance, read_result

TAP = Path(__file__).parents[1] / "references" / "impact_12_B_badhits" / "tap_tipX.h5"


@pytest.fixture
def run(capsys):
    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["frf", *map(str, arguments)])
        output = capsys.readouterr()
        return end.value.code, output.out, output.err

    return run


@pytest.fixture
def text_recording(tmp_path):
    """A continuous tap test as a text without a header: time, force in lbf, acceleration in g."""
    rng = np.random.default_rng(1)
    rate, n = 10_000.0, 30_000
    t = np.arange(n) / rate
    force, acceleration = 0.01 * rng.standard_normal(n), 0.002 * rng.standard_normal(n)
    for start in (3000, 11_000, 20_500):
        force[start : start + 12] += 40 * np.sin(np.pi * np.arange(12) / 12)
        tail = t[: n - start]
        acceleration[start:] += 3 * np.exp(-60 * tail) * np.sin(2 * np.pi * 400 * tail)
    path = tmp_path / "tap.csv"
    np.savetxt(path, np.c_[t, force, acceleration], delimiter=",", fmt="%.6f")
    return path


STATED = (
    "--map",
    "hammer@tipX=col2",
    "--map",
    "acc@tipX=col3",
    "--unit",
    "col1=s",
    "--unit",
    "col2=lbf",
    "--unit",
    "col3=g",
)


def test_the_table_names_every_hit_and_the_reason_against_it(run, tmp_path):
    code, out, err = run(TAP, "-o", tmp_path / "frf.h5")
    assert code == 0
    assert err == ""
    assert "8 of 13 hits used" in out
    rows = [line for line in out.splitlines() if "tap_tipX.h5" in line]
    assert len(rows) == 13
    assert sum("double: second pulse" in row for row in rows) == 3
    assert sum("overload: " in row for row in rows) == 2


def test_json_carries_what_the_contract_promises(run, tmp_path):
    code, out, _ = run(TAP, "-o", tmp_path / "frf.h5", "--json")
    assert code == 0
    envelope = json.loads(out)
    assert envelope["command"] == "frf"
    assert list(envelope["inputs"]) == [TAP.as_posix()]
    result = envelope["result"]
    assert {"hits", "outputs", "inputs", "frequency_hz", "coherence_median", "usable_band_hz"} <= set(result)
    assert set(result["hits"][0]) == {"recording", "index", "onset_s", "peak_N", "accepted", "reasons", "remarks"}
    assert [hit["index"] for hit in result["hits"] if not hit["accepted"]] == [2, 5, 8, 10, 11]
    assert result["coherence_median"] > 0.99
    assert result["inputs"] == ["tipX"]
    assert result["outputs"][:3] == ["tipX", "tipY", "tipZ"]


def test_the_file_has_the_layout_of_the_contract_and_reads_back(run, tmp_path):
    path = tmp_path / "frf.h5"
    run(TAP, "-o", path, "--form", "receptance")
    with h5py.File(path) as file:
        lines, outputs, inputs = file["values"].shape
        assert file["frequency"].shape == (lines,)
        assert file["coherence"].shape == file["variance"].shape == (lines, outputs, inputs)
        assert file["multiple_coherence"].shape == (lines, outputs)
        assert file.attrs["form"] == "receptance"
        assert file.attrs["estimator"] == "h1"
    frf = read_result(path, Frf)
    assert np.isnan(frf.values[0]).all()
    assert frf.hits_used == (8,)
    assert len(frf.hits) == 13
    assert TAP.as_posix() in read_provenance(path)["inputs"]


def test_the_same_input_gives_the_same_bytes(run, tmp_path):
    for name in ("a.h5", "b.h5"):
        run(TAP, "-o", tmp_path / name)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_text_recording_needs_its_units_stated_and_then_works(run, text_recording, tmp_path):
    code, _, err = run(text_recording, "-o", tmp_path / "frf.h5")
    assert code == 3
    assert err.startswith(f"error: {text_recording}")
    assert err.count("\n") == 1
    assert not (tmp_path / "frf.h5").exists()
    code, out, err = run(text_recording, "-o", tmp_path / "frf.h5", *STATED)
    assert code == 0, err
    assert "3 of 3 hits used" in out
    frf = read_result(tmp_path / "frf.h5", Frf)
    assert frf.hits[0].peak == pytest.approx(40 * 4.4482216, rel=0.01)
    assert frf.form == "accelerance"


def test_hits_are_kept_and_dropped_by_number(run, tmp_path):
    code, out, _ = run(TAP, "-o", tmp_path / "frf.h5", "--keep", 2, "--drop", 0, "--drop", "tap_tipX:1", "--json")
    assert code == 0
    hits = json.loads(out)["result"]["hits"]
    assert [hit["index"] for hit in hits if not hit["accepted"]] == [0, 1, 5, 8, 10, 11]
    code, out, _ = run(TAP, "-o", tmp_path / "frf.h5", "--allow-double", "--json")
    assert [hit["index"] for hit in json.loads(out)["result"]["hits"] if not hit["accepted"]] == [5, 10]


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["--keep", "99"], 3, "hits 0 to 12"),
        (["--drop", "tap_tipZ:1"], 3, "no recording is called tap_tipZ"),
        (["--estimator", "h3"], 2, "h1"),
        (["--form", "compliance"], 2, "receptance"),
        (["--map", "fx"], 2, "NAME=VALUE"),
        (["--flip", "acc_tipQ"], 3, "no channel or dof of that name"),
        (["--delay", "tipX=soon"], 2, "tipX=12e-6"),
        (["--delay", "tipX"], 2, "NAME=VALUE"),
        (["--delay", "tipQ=1e-6"], 3, "no channel or dof of that name"),
        (["--exponential", "1.5"], 3, "no window ends there"),
        ([f for i in (0, 1, 3, 4, 6, 7, 9, 12) for f in ("--drop", str(i))], 3, "no hit is good enough"),
    ],
)
def test_mistakes_end_in_one_line_and_write_nothing(run, tmp_path, arguments, code, word):
    found, out, err = run(TAP, "-o", tmp_path / "frf.h5", *arguments)
    assert found == code
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert word in err
    assert not (tmp_path / "frf.h5").exists()


def test_force_channels_named_as_responses_give_a_transmissibility(run, tmp_path):
    """A text of hammer and dynamometer, which says nothing of who answers whom."""
    from millcal.physics.measuring_chain import MeasuringChain
    from millcal.simulation import simulate_impact

    chain = MeasuringChain(resonance=(700.0,) * 3, damping_ratio=(0.05,) * 3, noise=0.5)
    options = {"hits": 3, "record": 0.5, "peak": 800.0, "pulse": 1e-3, "layout": "continuous", "sample_rate": 5000.0}
    recording, _ = simulate_impact((), rng=np.random.default_rng(3), hammer="tipX", dynamometer=chain, **options)
    path = tmp_path / "tap.csv"
    time = np.arange(recording.samples.shape[1]) / recording.sample_rate
    header = "Time [s],Hammer [N],Fx [N],Fy [N],Fz [N]"
    np.savetxt(path, np.c_[time, recording.samples.T], delimiter=",", fmt="%.5f", header=header, comments="")
    stated = ("--map", "hammer@tipX=Hammer", "--map", "fx=Fx")
    code, _, err = run(path, *stated, "-o", tmp_path / "frf.h5")
    assert code == 3
    assert "--response" in err
    code, out, err = run(path, *stated, "--response", "fx", "-o", tmp_path / "frf.h5")
    assert (code, err.count("error")) == (0, 0)
    assert "transmissibility" in out
    frf = read_result(tmp_path / "frf.h5", Frf)
    assert (frf.form, frf.outputs, frf.inputs) == ("transmissibility", ("tipX",), ("tipX",))
    assert abs(frf.values[np.argmin(np.abs(frf.frequency - 700)), 0, 0]) == pytest.approx(10.0, rel=0.1)
    code, _, err = run(path, *stated, "--response", "fq", "-o", tmp_path / "no.h5")
    assert code == 2
    assert "'fq'" in err
    setup = tmp_path / "setup.toml"
    setup.write_text("[map]\n'hammer@tipX' = '+Hammer'\nfx = '+Fx'\n[channels.fx]\nrole = 'response'\n")
    code, _, _ = run(path, "--setup", setup, "-o", tmp_path / "again.h5")
    assert code == 0
    np.testing.assert_array_equal(read_result(tmp_path / "again.h5", Frf).values, frf.values)


def test_a_turned_channel_is_mended_as_the_warning_says(run, tmp_path):
    code, _, err = run(TAP, "-o", tmp_path / "plain.h5", "--flip", "tipX", "--flip", "tipX")
    assert (code, err) == (0, "")
    code, _, err = run(TAP, "-o", tmp_path / "frf.h5", "--flip", "hammer")
    assert code == 0
    assert "--flip tipX" in err
    code, _, err = run(TAP, "-o", tmp_path / "mended.h5", "--flip", "hammer", "--flip", "tipX")
    assert code == 0
    assert "--flip" not in err
    plain, mended = (read_result(tmp_path / name, Frf).values for name in ("plain.h5", "mended.h5"))
    np.testing.assert_allclose(mended[:, 0], plain[:, 0])
    np.testing.assert_allclose(mended[:, 1], -plain[:, 1])


def test_delays_and_an_exponential_window_reach_the_estimate(run, tmp_path):
    run(TAP, "-o", tmp_path / "plain.h5")
    code, _, _ = run(TAP, "-o", tmp_path / "late.h5", "--delay", "tipX=1e-5", "--delay", "acc_tipY=1.5e-5")
    assert code == 0
    plain, late = (read_result(tmp_path / name, Frf) for name in ("plain.h5", "late.h5"))
    turn = np.exp(2j * np.pi * plain.frequency[:, None] * np.array([1e-5, 1.5e-5]))
    np.testing.assert_allclose(late.values[1:-1, :2, 0], (plain.values[:, :2, 0] * turn)[1:-1], rtol=1e-9)
    code, _, err = run(TAP, "-o", tmp_path / "faded.h5", "--exponential", "0.05")
    assert code == 0
    assert "exponential window" in err
    assert read_result(tmp_path / "faded.h5", Frf).damping_shift > 0


def test_what_was_mended_of_a_hit_stands_in_the_table_and_in_the_json(run, tmp_path):
    """A late trigger of one hit."""
    from millcal.io.recordings import read_recording, write_recording

    recording = read_recording(TAP)
    samples = np.array(recording.block(0, recording.samples.shape[1]))
    start, count = recording.segments[3]
    samples[1:, start : start + count] = np.roll(samples[1:, start : start + count], 4, axis=1)
    write_recording(tmp_path / "late.h5", replace(recording, samples=samples))
    code, out, _ = run(tmp_path / "late.h5", "-o", tmp_path / "frf.h5")
    assert code == 0
    (row,) = (line for line in out.splitlines() if "skew" in line)
    assert "used; skew: response 4.00 samples late" in row
    _, out, _ = run(tmp_path / "late.h5", "-o", tmp_path / "frf.h5", "--json")
    hits = json.loads(out)["result"]["hits"]
    assert [bool(hit["remarks"]) for hit in hits] == [number == 3 for number in range(13)]
    assert read_result(tmp_path / "frf.h5", Frf).hits[3].remarks[0].startswith("skew")


def test_a_delay_of_a_channel_is_read_from_its_file_and_from_a_setup(run, tmp_path):
    from millcal.io.recordings import read_recording, write_recording

    recording = read_recording(TAP)
    channels = tuple(replace(c, delay=1e-5) if c.name == "acc_tipX" else c for c in recording.channels)
    write_recording(tmp_path / "own.h5", replace(recording, channels=channels))
    assert [c.delay for c in read_recording(tmp_path / "own.h5").channels][:3] == [0.0, 1e-5, 0.0]
    setup = tmp_path / "setup.toml"
    setup.write_text("[channels.acc_tipX]\ndelay_s = 1e-5\n")
    run(tmp_path / "own.h5", "-o", tmp_path / "a.h5")
    run(TAP, "--setup", setup, "-o", tmp_path / "b.h5")
    run(TAP, "--delay", "acc_tipX=1e-5", "-o", tmp_path / "c.h5")
    a, b, c = (read_result(tmp_path / name, Frf).values for name in ("a.h5", "b.h5", "c.h5"))
    np.testing.assert_array_equal(a, c)
    np.testing.assert_array_equal(b, c)


def test_the_recipe_takes_the_same_options_in_si():
    from millcal.io.recipe_tables import FrfTable

    given = FrfTable(delays_s={"acc_tipX": 12e-6}, flip=("tipX",), exponential=0.05).arguments()
    assert (given["delays"], given["flip"], given["exponential"]) == ({"acc_tipX": 12e-6}, ("tipX",), 0.05)
