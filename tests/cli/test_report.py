"""`millcal report`: the page again, without computing."""

import json

import numpy as np
import pytest

from millcal.cli import main
from millcal.data import Modes
from millcal.io.results import write_result

PROVENANCE = {"versions": {"millcal": "0.1.0"}, "seed": 3, "inputs": {"tap.h5": "ab" * 32}, "recipe": "seed = 3\n"}


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main(["report", *map(str, arguments)])
    return end.value.code


@pytest.fixture
def folder(tmp_path):
    modes = Modes(
        natural_frequency=np.array([843.0]), damping_ratio=np.array([0.031]), stiffness=np.array([2.1e7]), axes=("x",)
    )
    write_result(tmp_path / "modes.h5", modes, provenance=PROVENANCE)
    (tmp_path / "summary.json").write_text(json.dumps({"title": "A slender holder"}), encoding="utf-8")
    return tmp_path


def test_the_page_holds_what_the_folder_holds(folder, capsys):
    assert run(folder) == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "A slender holder" in page
    assert "843" in page
    assert "ab" * 32 in page
    assert capsys.readouterr().out.strip() == f"report: {folder / 'report.html'}"


def test_twice_gives_the_same_bytes(folder):
    run(folder)
    first = (folder / "report.html").read_bytes()
    run(folder)
    assert (folder / "report.html").read_bytes() == first


def test_json_names_the_files_that_were_read(folder, capsys):
    assert run(folder, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["command"] == "report"
    assert told["result"]["report"].endswith("report.html")
    assert {path.rpartition("/")[2] for path in told["inputs"]} == {"modes.h5", "summary.json"}


def test_a_folder_without_summary_is_enough(folder):
    (folder / "summary.json").unlink()
    assert run(folder) == 0


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "modes.h5").unlink(), "holds no results"),
        (lambda folder: (folder / "modes.h5").write_bytes(b"no HDF5"), "modes.h5"),
        (lambda folder: (folder / "summary.json").write_text("{"), "summary.json"),
    ],
    ids=["nothing there", "a file that is no HDF5", "a summary cut short"],
)
def test_a_folder_that_cannot_be_used_ends_in_one_line_and_leaves_the_old_page(folder, spoil, said, capsys):
    run(folder)
    before = (folder / "report.html").read_bytes()
    capsys.readouterr()
    spoil(folder)
    assert run(folder) == 3
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert said in error
    assert (folder / "report.html").read_bytes() == before
