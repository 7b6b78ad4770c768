"""`millcal report`: the page again, without computing."""

import json
import subprocess
import sys

import numpy as np
import pytest
from histories import worn

from millcal.cli import main
from millcal.data import Frf, Modes
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


@pytest.fixture
def measured(folder):
    """The folder with an FRF in it, which can be drawn."""
    frequency = np.linspace(10.0, 1000.0, 50)
    values = 1 / (2e7 * (1 - (frequency / 400) ** 2 + 0.1j * frequency / 400))
    frf = Frf(
        frequency=frequency,
        values=values[:, np.newaxis, np.newaxis],
        form="receptance",
        estimator="h1",
        outputs=("tipX",),
        inputs=("tipX",),
        hits_used=(5,),
        usable_band=(20.0, 900.0),
    )
    write_result(folder / "frf.h5", frf, provenance=PROVENANCE)
    return folder


def test_figures_are_written_into_a_folder_that_is_made(measured, tmp_path, capsys):
    wanted = tmp_path / "paper" / "figures"
    assert run(measured, "--figures", wanted) == 0
    assert [path.name for path in wanted.iterdir()] == ["frf.pdf"]
    assert (wanted / "frf.pdf").read_bytes().startswith(b"%PDF")
    assert capsys.readouterr().out.splitlines() == [
        f"report: {measured / 'report.html'}",
        f"figure: {wanted / 'frf.pdf'}",
    ]


@pytest.mark.parametrize(("format", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_the_format_of_figures_can_be_chosen_and_json_names_them(measured, tmp_path, format, magic, capsys):
    wanted = tmp_path / "figures"
    assert run(measured, "--figures", wanted, "--format", format, "--json") == 0
    path = wanted / f"frf.{format}"
    assert json.loads(capsys.readouterr().out)["result"]["figures"] == [str(path)]
    assert path.read_bytes().startswith(magic)


def test_a_figure_is_replaced_and_what_is_older_or_not_ours_is_left_with_a_word(measured, tmp_path, capsys):
    wanted = tmp_path / "figures"
    wanted.mkdir()
    for name in ("frf.pdf", "mean-force.pdf", "notes.pdf", "coefficients.h5"):
        (wanted / name).write_text("old")
    assert run(measured, "--figures", wanted) == 0
    assert (wanted / "frf.pdf").read_bytes().startswith(b"%PDF")
    assert all((wanted / name).read_text() == "old" for name in ("mean-force.pdf", "notes.pdf", "coefficients.h5"))
    warning = capsys.readouterr().err
    assert "mean-force.pdf" in warning
    assert "notes.pdf" not in warning
    assert "coefficients.h5" not in warning


def test_results_that_cannot_be_drawn_are_an_error_that_says_what_would_be_needed(folder, tmp_path, capsys):
    assert run(folder, "--figures", tmp_path / "figures") == 3
    error = capsys.readouterr().err
    assert "figures need coefficients, an FRF or a stability map" in error
    assert "modes" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "figures").exists()


def test_a_file_is_no_folder_for_figures_and_stays(measured, tmp_path, capsys):
    (tmp_path / "figures").write_text("mine")
    assert run(measured, "--figures", tmp_path / "figures") == 3
    assert "is a file" in capsys.readouterr().err
    assert (tmp_path / "figures").read_text() == "mine"


def test_the_formats_are_those_that_can_be_written():
    from millcal.cli.report import FigureFormat
    from millcal.report.paper.sheet import FORMATS

    assert tuple(FigureFormat) == FORMATS


def test_without_figures_matplotlib_is_not_imported(folder):
    script = (
        f"import sys; from millcal.cli import main\ntry: main(['report', {str(folder)!r}])\nexcept SystemExit: pass\n"
    )
    script += "print('matplotlib' in sys.modules)"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ended.stdout.splitlines()[-1] == "False"


def test_a_history_in_the_place_of_coefficients_makes_its_page_and_its_figure(folder):
    write_result(folder / "coefficients.h5", worn(), provenance=PROVENANCE)
    assert run(folder, "--figures", folder / "figures", "--format", "svg") == 0
    assert 'id="specific-force"' in (folder / "report.html").read_text(encoding="utf-8")
    assert [path.name for path in (folder / "figures").iterdir()] == ["history.svg"]
