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
    AsynchronousPeak,
    BestSpeed,
    Check,
    Coefficients,
    CutForce,
    Frf,
    Hit,
    Modes,
    Notice,
    Posterior,
    Recording,
    StabilityMap,
)
from millcal.errors import RecordingError
from millcal.io.provenance import provenance
from millcal.io.results import (
    kind_of,
    read_provenance,
    read_result,
    read_results,
    write_result,
    write_results,
    write_text_atomically,
)
from millcal.physics.cutter import Cutter, CuttingConditions

CUTTER = Cutter(diameter=25e-3, teeth=2, helix=0.7854, pitch=(3.0, 2 * np.pi - 3.0))
CONDITIONS = CuttingConditions(628.3, 1e-4, 3e-3, 25e-3, "slot")


def cut(rng, name="cut µ.csv"):
    def real(*shape):
        return rng.standard_normal(shape)

    return CutForce(
        name=name, cutter=CUTTER, conditions=CONDITIONS,
        harmonics=real(3, 5) + 1j * real(3, 5), harmonics_variance=real(3, 5) ** 2, mean_all_rows=real(3),
        revolution_means=real(3, 7), average_angle=real(16), average=real(3, 16), scatter=np.full((3, 16), np.nan),
        ac_rms=real(3), asynchronous_rms=real(3), overview_time=real(9), overview_low=real(3, 9),
        overview_high=real(3, 9), removed_offset=real(3), removed_drift=real(3), sample_rate=1e4,
        spindle_frequency=99.99, spindle_frequency_sd=np.nan, revolutions=7, steady=(0.1, 0.9),
        air=((0.0, 0.05), (0.95, 1.0)), peaks=(AsynchronousPeak("x", 975.0, 9.4, np.inf),),
        notices=(Notice("no-air", "a word; é", "cut"),),
    )  # fmt: skip


def frf(rng, n=40, optional=True):
    values = rng.standard_normal((n, 2, 1)) + 1j * rng.standard_normal((n, 2, 1))
    return Frf(
        frequency=np.arange(n, dtype=float), values=values,
        coherence=np.full((n, 2, 1), np.nan) if optional else None,
        variance=np.abs(values) if optional else None, form="receptance", estimator="h1", outputs=("tipX", "tipY"),
        inputs=("tipX",), hits_used=(5,), usable_band=(20.0, np.inf),
        hits=(Hit("a.h5", 0, 0.1, 250.0, False, ("double",)), Hit("a.h5", 1, np.nan, 250.0, True)),
    )  # fmt: skip


def coefficients(rng):
    n = 3
    posterior = Posterior(
        names=("Ktc", "Krc"), units=("N/m^2", "N/m^2"), mean=np.array([9e8, 2e8]), covariance=np.eye(2),
        interval=np.array([[8e8, 1e9], [1e8, np.inf]]), law="linear-edge", method="average",
    )  # fmt: skip
    return Coefficients(
        posterior=posterior, cutter=CUTTER, conditions=(CONDITIONS,) * n, cuts=("a", "b", "c"), verdict="fits",
        checks=(Check("signs", True, "fine"),), feed_per_tooth=rng.random(n), measured_mean=rng.random((n, 3)),
        modelled_mean=rng.random((n, 3)), angle=rng.random(8), measured=rng.random((n, 3, 8)),
        modelled=rng.random((n, 3, 8)), measured_amplitude=rng.random((n, 3, 4)),
        modelled_amplitude=rng.random((n, 3, 4)), residual_rms=rng.random(3), r2=rng.random(3), band=(0, 6),
        alternatives=(("kienzle", (("r2", 0.5), ("bic", np.nan))),),
    )  # fmt: skip


def stability_map(rng):
    return StabilityMap(
        spindle_speed=rng.random(6), limit_depth=np.full(6, np.inf), chatter_frequency=rng.random(6),
        lobe=np.arange(6.0), method="zoa", teeth=2, radial_depth=1e-2, diameter=25e-3, direction="down",
        feed_per_tooth=None, absolute_minimum=1e-3, absolute_minimum_frequency=800.0,
        best=(BestSpeed(600.0, 2e-3, 1e-6, None),), operating_point=(600.0, 1e-3),
    )  # fmt: skip


def modes(_rng):
    return Modes(
        natural_frequency=np.array([900.0]), damping_ratio=np.array([0.01]), stiffness=np.array([1e7]), axes=("x",)
    )


def recording(rng):
    return Recording(samples=rng.random((1, 5)), sample_rate=1e3, channels=(), kind="air")


MAKERS = [cut, frf, coefficients, stability_map, modes]


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


@pytest.mark.parametrize("maker", MAKERS, ids=lambda m: m.__name__)
def test_a_record_comes_back_as_it_went(maker, tmp_path):
    record = maker(np.random.default_rng(1))
    write_result(tmp_path / "r.h5", record, provenance={})
    assert_equal(read_result(tmp_path / "r.h5", type(record)), record)


@pytest.mark.parametrize("maker", MAKERS, ids=lambda m: m.__name__)
def test_the_same_record_gives_the_same_bytes_at_another_time_and_place(maker, tmp_path):
    record = maker(np.random.default_rng(1))
    sums = set()
    for folder in ("a", "b/c"):
        path = tmp_path / folder / "r.h5"
        write_result(path, record, provenance={"seed": 1, "millcal": "x"})
        sums.add(hashlib.sha256(path.read_bytes()).hexdigest())
        time.sleep(1.1 if folder == "a" else 0)  # HDF5 stamps have a resolution of one second
    assert len(sums) == 1


def test_several_records_of_one_type_share_a_file_in_their_order(tmp_path):
    rng = np.random.default_rng(2)
    cuts = [cut(rng, f"cut {i}") for i in range(12)]
    write_results(tmp_path / "cuts.h5", cuts, provenance={})
    back = read_results(tmp_path / "cuts.h5", CutForce)
    assert [c.name for c in back] == [c.name for c in cuts]
    assert_equal(back[11], cuts[11])
    assert kind_of(tmp_path / "cuts.h5") == "CutForce"


def test_an_frf_has_the_layout_of_the_contract(tmp_path):
    record = frf(np.random.default_rng(3))
    write_result(tmp_path / "frf.h5", record, provenance={})
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


def test_the_provenance_comes_back_and_holds_the_sum_of_every_input(tmp_path):
    (tmp_path / "in.csv").write_bytes(b"1,2\n")
    made = provenance([tmp_path / "in.csv"], recipe_text="title = 'µ'\n", seed=7)
    write_result(tmp_path / "r.h5", modes(None), provenance=made)
    back = read_provenance(tmp_path / "r.h5")
    assert back == made
    assert back["inputs"][(tmp_path / "in.csv").as_posix()] == hashlib.sha256(b"1,2\n").hexdigest()
    assert back["recipe"] == "title = 'µ'\n"


def _another_kind(path):
    write_result(path, modes(None), provenance={})


def _cut_short(path):
    write_result(path, frf(np.random.default_rng(0), n=4000), provenance={})
    path.write_bytes(path.read_bytes()[:-5000])


def _no_hdf5(path):
    path.write_text("a,b\n")


def _field_missing(path):
    write_result(path, frf(np.random.default_rng(0)), provenance={})
    with h5py.File(path, "a") as file:
        del file["values"]


def _newer(path):
    write_result(path, frf(np.random.default_rng(0)), provenance={})
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99


def _axes_disagree(path):
    write_result(path, frf(np.random.default_rng(0)), provenance={})
    with h5py.File(path, "a") as file:
        del file["frequency"]
        file["frequency"] = np.arange(3.0)


@pytest.mark.parametrize(
    "spoil",
    [_another_kind, _cut_short, _no_hdf5, _field_missing, _newer, _axes_disagree, lambda path: None],
    ids=["another kind", "cut short", "no hdf5", "field missing", "newer", "axes disagree", "absent"],
)
def test_a_file_that_is_not_the_result_asked_for_is_one_line_that_names_it(spoil, tmp_path):
    spoil(tmp_path / "f.h5")
    with pytest.raises(RecordingError) as caught:
        read_result(tmp_path / "f.h5", Frf)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "f.h5") + ": ")
    assert "; " in message
    assert "\n" not in message


def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "r.h5"
    write_result(path, modes(None), provenance={})
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_result(path, modes(None), provenance={"bad": object()})
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
from test_results import frf
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
