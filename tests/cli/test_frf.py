"""`millcal frf`: recordings in, an FRF file and a table of the hits out; every mistake one line."""

import json
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
