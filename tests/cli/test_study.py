"""`millcal study` as a shell sees it."""

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pytest

import millcal.cli.studies.trending_coefficients as layout
from millcal.cli import main
from millcal.cli.studies import Name, study_file
from millcal.report.paper import sheet
from millcal.studies import forces_from_accelerations, trending_coefficients


def make_small(monkeypatch):
    """The smallest studies there are, with figures of few dots."""
    monkeypatch.setattr(trending_coefficients, "QUICK", trending_coefficients.Extent(2, 1, 1))
    small = forces_from_accelerations.Extent((0.0, 25.0), (0.0, 1.0), 1, 1, 1, 1)
    monkeypatch.setattr(forces_from_accelerations, "QUICK", small)
    monkeypatch.setitem(sheet._STYLE, "savefig.dpi", 60)


@pytest.fixture
def shell(capsys, monkeypatch):
    """shell("study", ...) -> (exit code, stdout, stderr)"""
    make_small(monkeypatch)

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        streams = capsys.readouterr()
        return end.value.code, streams.out, streams.err

    return call


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    """Each study from one seed, told in words and as JSON.   returns name -> two of (folder, exit code, stdout, stderr)"""
    found = {name: [] for name in Name}
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        for name, more in ((name, more) for name in Name for more in ([], ["--json"])):
            folder, out, err = tmp_path_factory.mktemp("study") / "study", StringIO(), StringIO()
            with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
                main(["study", name, "--quick", "--out", str(folder), "--seed", "5", *more])
            found[name].append((folder, end.value.code, out.getvalue(), err.getvalue()))
    return found


@pytest.mark.parametrize("name", Name)
def test_a_study_leaves_tables_and_figures_and_says_the_same_twice(twice, name):
    files = study_file(name).FILES
    (first, code, out, err), (second, code_of_second, told, _) = twice[name]
    assert (code, err) == (0, "")
    assert {path.name for path in first.iterdir()} == set(files)
    assert (first / "table.txt").read_text() in out
    assert out.splitlines()[-1].startswith(str(first))

    said = json.loads(told)
    assert code_of_second == 0
    assert said["command"] == "study"
    assert (said["result"]["study"], said["result"]["quick"]) == (name, True)
    kept = json.loads((second / "summary.json").read_text())
    assert kept.pop("provenance")["seed"] == 5
    assert kept.items() <= said["result"].items()
    for file in files:
        assert (first / file).read_bytes() == (second / file).read_bytes(), file


def test_a_study_sets_the_papers_numbers_beside_its_own(twice):
    _, (_, _, told, _) = twice["trending-coefficients"]
    assert json.loads(told)["result"]["table"][0]["cases"]["alternating"]["paper_N"] == 50.7
    (_, _, out, _), _ = twice["forces-from-accelerations"]
    assert "up to 1.0 m/s²: does not hold" in out


def test_an_old_study_is_replaced_and_what_is_foreign_is_not(shell, tmp_path, monkeypatch):
    found = trending_coefficients.run(trending_coefficients.Extent(1, 1, 1))
    monkeypatch.setattr(trending_coefficients, "run", lambda *_, **__: found)
    monkeypatch.setattr(layout, "figures", lambda found: {})
    out = tmp_path / "study"
    out.mkdir()
    (out / "table.csv").write_text("old")
    (out / "notes.txt").write_text("mine")
    code, _, err = shell("study", "trending-coefficients", "--quick", "--out", out)
    assert code == 3
    assert "holds notes.txt" in err
    assert err.count("\n") == 1
    (out / "notes.txt").unlink()
    assert shell("study", "trending-coefficients", "--quick", "--out", out)[0] == 0
    assert (out / "table.csv").read_text() != "old"
    assert [path.name for path in tmp_path.iterdir()] == ["study"]


def test_a_file_in_place_of_the_folder_and_an_unknown_study_are_one_line(shell, tmp_path):
    place = tmp_path / "file"
    place.write_text("")
    code, _, err = shell("study", "trending-coefficients", "--out", place)
    assert (code, err.count("\n")) == (3, 1)
    code, _, err = shell("study", "wear", "--out", tmp_path / "out")
    assert (code, err.count("\n")) == (2, 1)
    assert "trending-coefficients" in err


def test_an_interrupted_study_leaves_nothing_behind(shell, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(trending_coefficients, "run", interrupt)
    code, _, err = shell("study", "trending-coefficients", "--quick", "--out", tmp_path / "out")
    assert code == 130
    assert "interrupted" in err
    assert list(tmp_path.iterdir()) == []
