"""What is written is there whole or not at all, and the remains of killed processes do not pile up."""

import os
import subprocess
import sys

import pytest

from millcal.errors import RecipeError
from millcal.io.replacing import replaced_atomically, replaced_folder, tidy_remains


@pytest.fixture(scope="module")
def dead():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def folder_with(path, text):
    path.mkdir()
    (path / "x.txt").write_text(text)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_takes_the_place_of_the_old_one_as_a_whole(tmp_path):
    out = tmp_path / "out"
    folder_with(out, "old")
    with replaced_folder(out) as new:
        (new / "y.txt").write_text("new")
        assert names(out) == ["x.txt"]
    assert (names(out), names(tmp_path)) == (["y.txt"], ["out"])


def test_a_block_that_fails_leaves_the_old_folder_and_no_remains(tmp_path):
    out = tmp_path / "out"
    folder_with(out, "old")
    with pytest.raises(RecipeError, match="out: cannot be written"), replaced_folder(out):
        raise OSError(28, "No space left on device")
    assert (names(out), names(tmp_path)) == (["x.txt"], ["out"])


def test_the_next_writer_removes_the_remains_of_dead_processes_and_no_others(tmp_path, dead):
    folder_with(tmp_path / f".out.{dead}.part", "half")
    folder_with(tmp_path / ".out.1.part", "at work")  # a process that lives as long as the machine
    folder_with(tmp_path / f".other.{dead}.part", "of another place")
    (tmp_path / f".f.h5.{dead}.part").write_text("half")
    (tmp_path / ".out.notes.part").write_text("somebody's own")
    with replaced_folder(tmp_path / "out") as new:
        (new / "x.txt").write_text("new")
    with replaced_atomically(tmp_path / "f.h5") as temporary:
        temporary.write_text("new")
    assert names(tmp_path) == sorted([".out.1.part", ".out.notes.part", f".other.{dead}.part", "f.h5", "out"])


def test_an_old_folder_that_was_put_aside_and_never_replaced_is_put_back(tmp_path, dead):
    folder_with(tmp_path / f".out.{dead}.old", "old")
    folder_with(tmp_path / f".out.{dead}.part", "new, but nobody knows whether whole")
    tidy_remains(tmp_path / "out")
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "x.txt").read_text() == "old"


def test_an_old_folder_that_was_replaced_is_removed(tmp_path, dead):
    folder_with(tmp_path / f".out.{dead}.old", "old")
    folder_with(tmp_path / "out", "new")
    tidy_remains(tmp_path / "out")
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "x.txt").read_text() == "new"


def test_remains_under_the_number_of_this_very_process_are_in_nobodys_way(tmp_path):
    folder_with(tmp_path / f".out.{os.getpid()}.part", "half, by a process of the same number")
    with replaced_folder(tmp_path / "out") as new:
        (new / "y.txt").write_text("new")
    assert names(tmp_path / "out") == ["y.txt"]
