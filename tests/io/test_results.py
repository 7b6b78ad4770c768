"""Results go to disk and back unchanged, byte for byte the same each time, and whole or not at all."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import fields

import h5py
import numpy as np
import pytest

from millcal.data import (
    CutForce,
    Frf,
)
from millcal.errors import RecordingError
from millcal.io.provenance import provenance
from millcal.io.results import (
    read_provenance,
    read_result,
    read_results,
    write_result,
    write_results,
    write_text_atomically,
)


def assert_equal(left, right):
    assert type(left) is type(right)
    for field in fields(left):
        a, b = getattr(left, field.name), getattr(right, field.name)
        if "dims" in field.metadata and a is not None:
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        elif hasattr(a, "__dataclass_fields__") and field.name == "posterior":
            assert_equal(a, b)
        else:
            assert repr(a) == repr(b), field.name  # repr, because nan is not nan


def test_a_record_comes_back_as_it_went(record, tmp_path):
    write_result(tmp_path / "r.h5", record, provenance={})
    assert_equal(read_result(tmp_path / "r.h5", type(record)), record)


def test_the_same_record_gives_the_same_bytes_in_another_place(record, tmp_path):
    sums = set()
    for folder in ("a", "b/c"):
        path = tmp_path / folder / "r.h5"
        write_result(path, record, provenance={"seed": 1, "millcal": "x"})
        sums.add(hashlib.sha256(path.read_bytes()).hexdigest())
    assert len(sums) == 1


def test_the_same_record_gives_the_same_bytes_in_another_second(make_record, tmp_path):
    record = make_record("coefficients")
    write_result(tmp_path / "1.h5", record, provenance={})
    time.sleep(1.05)  # the resolution of a stamp in HDF5
    write_result(tmp_path / "2.h5", record, provenance={})
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()


def test_several_records_of_one_type_share_a_file_in_their_order(make_record, tmp_path):
    cuts = [make_record("cut", i, name=f"cut {i}") for i in range(12)]
    write_results(tmp_path / "cuts.h5", cuts, provenance={})
    back = read_results(tmp_path / "cuts.h5", CutForce)
    assert [c.name for c in back] == [c.name for c in cuts]
    assert_equal(back[11], cuts[11])


def test_an_frf_has_the_layout_of_the_contract(make_record, tmp_path):
    write_result(tmp_path / "frf.h5", make_record("frf"), provenance={})
    with h5py.File(tmp_path / "frf.h5") as file:
        assert file["values"].shape == (40, 2, 1)
        assert file["values"].dtype == np.complex128
        assert list(file["values"].attrs["axes"]) == ["frequency", "output", "input"]
        assert file["frequency"].attrs["unit"] == "Hz"
        assert file.attrs["form"] == "receptance"
        assert list(file.attrs["outputs"]) == ["tipX", "tipY"]
        assert list(file.attrs["inputs"]) == ["tipX"]
        assert list(file.attrs["hits_used"]) == [5]


def test_an_frf_of_another_program_needs_only_what_the_contract_names(tmp_path):
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["frequency"] = np.arange(5.0)
        file["values"] = np.ones((5, 1, 1), complex)
        file.attrs["form"], file.attrs["estimator"] = "receptance", b"h1"
        file.attrs["outputs"], file.attrs["inputs"], file.attrs["hits_used"] = ["tipX"], ["tipX"], [4]
    record = read_result(tmp_path / "f.h5", Frf)
    assert record.inputs == ("tipX",)
    assert record.estimator == "h1"
    assert record.usable_band == (0.0, 4.0)
    assert record.coherence is None


def test_the_provenance_comes_back_and_holds_the_sum_of_every_input(make_record, tmp_path):
    (tmp_path / "in.csv").write_bytes(b"1,2\n")
    made = provenance([tmp_path / "in.csv"], recipe_text="title = 'µ'\n", seed=7)
    write_result(tmp_path / "r.h5", make_record("modes"), provenance=made)
    back = read_provenance(tmp_path / "r.h5")
    assert back == made
    assert back["inputs"][(tmp_path / "in.csv").as_posix()] == hashlib.sha256(b"1,2\n").hexdigest()
    assert back["recipe"] == "title = 'µ'\n"


def _another_kind(path, make_record):
    write_result(path, make_record("modes"), provenance={})


def _cut_short(path, make_record):
    write_result(path, make_record("frf", n=4000), provenance={})
    path.write_bytes(path.read_bytes()[:-5000])


def _no_hdf5(path, make_record):
    path.write_text("a,b\n")


def _field_missing(path, make_record):
    write_result(path, make_record("frf"), provenance={})
    with h5py.File(path, "a") as file:
        del file["values"]


def _newer(path, make_record):
    write_result(path, make_record("frf"), provenance={})
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99


def _axes_disagree(path, make_record):
    write_result(path, make_record("frf"), provenance={})
    with h5py.File(path, "a") as file:
        del file["frequency"]
        file["frequency"] = np.arange(3.0)


@pytest.mark.parametrize(
    "spoil",
    [_another_kind, _cut_short, _no_hdf5, _field_missing, _newer, _axes_disagree, lambda path, make_record: None],
    ids=["another kind", "cut short", "no hdf5", "field missing", "newer", "axes disagree", "absent"],
)
def test_a_file_that_is_not_the_result_asked_for_is_one_line_that_names_it(spoil, make_record, tmp_path):
    spoil(tmp_path / "f.h5", make_record)
    with pytest.raises(RecordingError) as caught:
        read_result(tmp_path / "f.h5", Frf)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "f.h5") + ": ")
    assert "; " in message
    assert "\n" not in message


def test_a_failing_write_leaves_the_old_file_and_nothing_else(make_record, tmp_path):
    path = tmp_path / "r.h5"
    write_result(path, make_record("modes"), provenance={})
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_result(path, make_record("modes"), provenance={"bad": object()})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_text_atomically(tmp_path / "file" / "x.txt", "a")


def test_text_keeps_its_line_ends(tmp_path):
    write_text_atomically(tmp_path / "a.txt", "µ\r\n\n")
    assert (tmp_path / "a.txt").read_bytes() == "µ\r\n\n".encode()


KILLED = """
import sys, numpy as np
sys.path.insert(0, sys.argv[2])
from conftest import frf
from millcal.io.results import write_result
record = frf(np.random.default_rng(int(sys.argv[3])), n=200_000)
print("ready", flush=True)
while True:
    write_result(sys.argv[1], record, provenance={})
"""


@pytest.mark.parametrize("delay", [0.0, 0.07, 0.3])
def test_a_writer_that_is_killed_leaves_a_whole_file_or_none(delay, tmp_path):
    path = tmp_path / "f.h5"
    writer = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), os.path.dirname(__file__), "1"], stdout=subprocess.PIPE
    )
    assert writer.stdout.readline() == b"ready\n"
    time.sleep(delay)
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    if path.exists():
        assert len(read_result(path, Frf).frequency) == 200_000
