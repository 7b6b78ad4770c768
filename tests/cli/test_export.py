"""`millcal export` and `millcal inspect` of FRF files, and a map straight from a file of another program."""

import json

import numpy as np
import pytest

from millcal.cli import main
from millcal.data import Frf
from millcal.io.frf_files import read_frf, write_frf
from millcal.physics.structure import Mode, convert_frf, receptance

MODES = [Mode(640.0, 0.03, 2e7, "x"), Mode(910.0, 0.04, 3e7, "y")]
FREQUENCY = np.arange(1601) * 1.25


@pytest.fixture
def run(capsys):
    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        output = capsys.readouterr()
        return end.value.code, output.out, output.err

    return run


@pytest.fixture
def frf():
    values = convert_frf(FREQUENCY, receptance(FREQUENCY, MODES), "receptance", "accelerance")
    return Frf(
        frequency=FREQUENCY,
        values=values,
        form="accelerance",
        estimator="h1",
        outputs=("tipX", "tipY"),
        inputs=("tipX", "tipY"),
        hits_used=(5, 5),
        usable_band=(20.0, 1900.0),
    )


def test_a_result_becomes_a_universal_file_in_another_form(run, frf, tmp_path):
    write_frf(tmp_path / "frf.h5", frf)
    code, out, err = run(
        "export", tmp_path / "frf.h5", "-o", tmp_path / "frf.uff", "--form", "receptance", "--binary", "--json"
    )
    assert (code, err) == (0, "")
    told = json.loads(out)
    assert told["command"] == "export"
    assert list(told["inputs"]) == [str(tmp_path / "frf.h5")]
    assert told["result"]["form"] == "receptance"
    assert told["result"]["files"] == [str(tmp_path / "frf.uff")]
    read = read_frf(tmp_path / "frf.uff")
    np.testing.assert_array_equal(read.values[1:], convert_frf(FREQUENCY, frf.values, "accelerance", "receptance")[1:])


def test_single_files_of_another_program_become_one_result(run, frf, tmp_path):
    for name, k in (("x.frf", 0), ("y.frf", 1)):
        h = receptance(FREQUENCY, MODES)[:, k, k] * (-1 if k else 1)
        np.savetxt(tmp_path / name, np.c_[FREQUENCY, h.real, h.imag])
    dofs = ["--response", "tipX", "--response=-tipY", "--hammer", "tipX", "--hammer", "tipY"]
    files = [tmp_path / "x.frf", tmp_path / "y.frf"]
    code, out, err = run("export", *files, *dofs, "--band", 10, 1500, "-o", tmp_path / "tip.h5")
    assert (code, err) == (0, "")
    assert f"written: {tmp_path / 'tip.h5'}" in out
    read = read_frf(tmp_path / "tip.h5")
    np.testing.assert_allclose(
        read.values[:, [0, 1], [0, 1]], receptance(FREQUENCY, MODES)[:, [0, 1], [0, 1]], rtol=1e-12
    )
    assert read.usable_band == (10, 1500)
    code, _, err = run("export", *files, "-o", tmp_path / "no.h5")
    assert code == 3
    assert "name response and hammer with --response tipX --hammer tipX" in err
    assert not (tmp_path / "no.h5").exists()


def test_pairs_become_one_cutpro_file_each(run, frf, tmp_path):
    write_frf(tmp_path / "frf.uff", frf)
    code, out, _ = run("export", tmp_path / "frf.uff", "-o", tmp_path / "spindle.frf")
    assert code == 0
    assert len([line for line in out.splitlines() if line.startswith("written: ")]) == 4
    assert {p.name for p in tmp_path.glob("*.frf")} == {f"spindle_tip{o}_tip{i}.frf" for o in "XY" for i in "XY"}


def test_what_the_file_does_not_say_is_stated(run, tmp_path):
    table = "\n".join(f"{f},{f},{2 * f}" for f in range(1, 50))
    (tmp_path / "a.csv").write_text(f"frequency,re,im\n{table}\n")
    dofs = ["--response", "1X", "--hammer", "2X"]
    code, _, err = run("export", tmp_path / "a.csv", *dofs, "-o", tmp_path / "a.uff")
    assert code == 3
    assert "neither unit nor form of the FRF is said" in err
    code, _, err = run("export", tmp_path / "a.csv", *dofs, "--unit", "g/N", "-o", tmp_path / "a.uff")
    assert code == 0
    assert "[no-driving-point]" in err
    read = read_frf(tmp_path / "a.uff")
    assert (read.form, read.outputs, read.inputs) == ("accelerance", ("1X",), ("2X",))
    np.testing.assert_allclose(read.values[:, 0, 0], 9.80665 * np.arange(1, 50) * (1 + 2j), rtol=1e-12)


def test_a_phase_of_the_other_sign_is_found_and_mended(run, frf, tmp_path):
    write_frf(tmp_path / "a.csv", Frf(**{**vars(frf), "values": frf.values.conj()}))
    code, _, err = run("export", tmp_path / "a.csv", "-o", tmp_path / "b.csv")
    assert code == 0
    assert "comes before the hit" in err
    code, _, err = run("export", tmp_path / "a.csv", "--conjugate", "-o", tmp_path / "b.csv")
    assert (code, err) == (0, "")
    np.testing.assert_array_equal(read_frf(tmp_path / "b.csv").values, frf.values)


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["-o", "a.xlsx"], 3, "no format has the suffix"),
        (["-o", "b.csv", "--binary"], 3, "only a universal file can be binary"),
        (["-o", "b.csv", "--unit", "furlong/N"], 3, "no unit of an FRF"),
        (["-o", "b.csv", "--form", "inertance"], 2, "inertance"),
        (["-o", "b.csv", "--band", "3000", "4000"], 3, "no part of the lines from 0 to 2000 Hz"),
        ([], 2, "--output"),
    ],
)
def test_a_wrong_option_is_one_line_and_writes_nothing(run, frf, tmp_path, monkeypatch, options, code, said):
    monkeypatch.chdir(tmp_path)
    write_frf("a.csv", frf)
    ended, out, err = run("export", "a.csv", *options)
    assert (ended, out) == (code, "")
    assert said in err
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("name", ["frf.uff", "frf.csv", "frf.h5"])
def test_inspect_shows_what_is_inside(run, frf, tmp_path, name):
    write_frf(tmp_path / name, frf)
    code, out, err = run("inspect", tmp_path / name)
    assert (code, err) == (0, "")
    assert "FRF (accelerance), 1601 lines from 0 to 2000 Hz" in out
    assert [line.split()[0] for line in out.splitlines()[2:]] == ["tipX/tipX", "tipY/tipX", "tipX/tipY", "tipY/tipY"]


def cut():
    return ["--ktc", 700, "--krc", 200, "--teeth", 2, "--diameter-mm", 16, "--direction", "slot", "--rpm", 4000, 12000]


@pytest.mark.parametrize("name", ["frf.uff", "frf.csv"])
def test_the_map_of_a_foreign_file_is_that_of_the_result(run, frf, tmp_path, name):
    maps = []
    for path in (tmp_path / "frf.h5", tmp_path / name):
        write_frf(path, frf)
        code, out, _ = run("stability", "--frf", path, *cut(), "--json", "-o", tmp_path / "map.h5")
        assert code == 0
        maps.append([row["crossings"][0]["ap_mm"] for row in json.loads(out)["result"]["limit"]])
    np.testing.assert_allclose(maps[1], maps[0], rtol=1e-9)


def test_the_map_of_a_foreign_file_passes_its_doubts_on(run, frf, tmp_path):
    drift = np.zeros_like(frf.values)
    drift[:, [0, 1], [0, 1]] = 5e-3
    write_frf(tmp_path / "a.csv", Frf(**{**vars(frf), "values": frf.values + drift, "usable_band": (1.25, 2000.0)}))
    code, _, err = run("stability", "--frf", tmp_path / "a.csv", *cut(), "-o", tmp_path / "map.h5")
    assert code == 0
    assert "millcal export --band" in err
