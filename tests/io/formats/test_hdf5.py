"""HDF5: the recording of the contract, and any other file by its paths."""

import h5py
import numpy as np
import pytest

from millcal.errors import RecordingError
from millcal.io import samples
from millcal.io.inspection import inspect_recording
from millcal.io.recipes import read_setup
from millcal.io.recordings import read_recording


def contract_file(path, **attributes):
    """Counts with a scale, a turned channel, a reaction, segments and the cut's keys."""
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {"format": "millcal-recording", "version": 1, "kind": "cut", "sample_rate_hz": 10000.0, **attributes}
        )
        group = file.create_group("channels", track_order=True)
        for name, unit, dof, more in [
            ("b", "kN", "tipY", {"scale": 0.5, "full_scale": 3.0, "acts_on": "workpiece"}),
            ("a", "g", "-tipX", {}),
        ]:
            dataset = group.create_dataset(name, data=np.arange(100, dtype=np.int16))
            dataset.attrs.update(
                {"unit": unit, "quantity": "force" if unit == "kN" else "acceleration", "dof": dof, **more}
            )
        file["segments"] = np.array([[0, 40], [40, 60]])


CUT = {
    "diameter_mm": 25.0, "teeth": 2, "helix_deg": 45.0, "spindle_speed_rpm": 6000.0, "feed_mm_per_min": 600.0,
    "axial_depth_mm": 3.0, "radial_depth_mm": 12.5, "direction": "down", "steady_s": [0.001, 0.008], "air_s": [[0.0, 0.001]],
}  # fmt: skip


def test_counts_scales_signs_and_the_cut_are_read(tmp_path):
    contract_file(tmp_path / "cut.h5", **CUT)
    recording = read_recording(tmp_path / "cut.h5")
    np.testing.assert_allclose(recording.samples, np.outer([-500.0, -9.80665], np.arange(100)))
    assert [(c.name, c.dof, c.full_scale) for c in recording.channels] == [("b", "tipY", 3000.0), ("a", "tipX", None)]
    assert recording.segments.tolist() == [[0, 40], [40, 60]]
    assert recording.cutter.teeth == 2
    assert recording.conditions.feed_per_tooth == pytest.approx(0.05e-3)
    assert recording.conditions.direction == "down"
    assert (recording.steady, recording.air) == ((0.001, 0.008), ((0.0, 0.001),))


def test_the_order_of_channels_is_as_stated_else_of_creation_else_of_the_alphabet(tmp_path):
    path = tmp_path / "cut.h5"
    contract_file(path)
    assert [c.name for c in read_recording(path).channels] == ["b", "a"]
    with h5py.File(path, "a") as file:
        file.attrs["channel_order"] = ["a", "b"]
    assert [c.name for c in read_recording(path).channels] == ["a", "b"]


def test_a_large_recording_is_read_where_it_is_asked_for(tmp_path, monkeypatch):
    contract_file(tmp_path / "cut.h5")
    whole = read_recording(tmp_path / "cut.h5").samples
    monkeypatch.setattr(samples, "IN_MEMORY", 100)
    lazy = read_recording(tmp_path / "cut.h5").samples
    assert not isinstance(lazy, np.ndarray)
    np.testing.assert_array_equal(lazy.read_block(13, 77), whole[:, 13:77])
    np.testing.assert_array_equal(lazy.read_block(90, 200), whole[:, 90:])


def test_inspect_shows_values_in_the_units_of_the_file(tmp_path):
    contract_file(tmp_path / "cut.h5")
    result, _ = inspect_recording(tmp_path / "cut.h5")
    assert result["sample_rate_hz"] == 10000
    b = result["channels"][0]
    assert (b["unit"], b["quantity"], b["max"], b["mean"]) == ("kN", "force", 49.5, 24.75)
    assert result["missing"] == []


SETUP = """
kind = "cut"
[hdf5]
sample_rate = "run@fs"
attributes.spindle_speed_rpm = "run/speed"
[channels.fx]
dataset = "run/forces"
number = 1
unit = "kN"
[channels.ax]
dataset = "run/table"
column = "acc"
dof = "-tipX"
[channels.fy]
dataset = "run/wide"
number = 0
"""


@pytest.fixture
def foreign(tmp_path):
    n = 50
    with h5py.File(tmp_path / "daq.h5", "w") as file:
        run = file.create_group("run")
        run.attrs["fs"] = 5000
        run["speed"] = 6000.0
        run["forces"] = np.column_stack([np.arange(n), np.arange(n) ** 2])
        run["wide"] = np.vstack([3.0 * np.arange(n), np.ones(n)])
        run["wide"].attrs["unit"] = "N"
        table = np.zeros(n, dtype=[("counter", "u1"), ("timestamp", "u8"), ("acc", "f4")])
        table["acc"] = np.arange(n) % 5
        run["table"] = table
        run["table"].attrs["unit"] = "g"
        run["time"] = np.arange(n) / 2500
    return tmp_path / "daq.h5"


def setup_of(tmp_path, text):
    (tmp_path / "setup.toml").write_text(text)
    return read_setup(tmp_path / "setup.toml")


def test_another_file_is_read_by_the_paths_of_a_setup(foreign, tmp_path):
    recording = read_recording(foreign, setup=setup_of(tmp_path, SETUP))
    n = np.arange(50)
    np.testing.assert_allclose(recording.samples, [1e3 * n**2, -9.80665 * (n % 5), 3.0 * n])
    assert recording.sample_rate == 5000
    assert [(c.name, c.unit, c.dof) for c in recording.channels] == [
        ("fx", "N", "fx"),
        ("ax", "m/s^2", "tipX"),
        ("fy", "N", "fy"),
    ]


def test_a_dataset_of_times_gives_the_rate(foreign, tmp_path):
    text = SETUP.replace('sample_rate = "run@fs"', 'time = "run/time"')
    assert read_recording(foreign, setup=setup_of(tmp_path, text)).sample_rate == 2500


def test_without_a_setup_inspect_lists_what_the_file_holds(foreign):
    result, _ = inspect_recording(foreign)
    listed = {item["path"]: item["shape"] for item in result["details"]["datasets"]}
    assert listed["run/forces"] == [50, 2]
    assert "--setup" in result["missing"][0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("run/forces", "run/force", "channels.fx: no 'run/force' in the file; it has run/forces"),
        ("number = 1", "number = 2", "has shape 50 x 2; give number, 0 to 1"),
        ('column = "acc"', 'column = "speed"', "is a table of counter, timestamp, acc"),
        ("run@fs", "run@rate", "'run' has no attribute 'rate'; it has fs"),
        ("run@fs", "run/forces", "is no single value"),
        ("run/table", "run", "'run' is no dataset"),
        ('unit = "kN"', "", "column 'fx' has no unit"),
    ],
)
def test_a_path_that_leads_nowhere_is_one_line(old, new, said, foreign, tmp_path):
    with pytest.raises(RecordingError) as problem:
        read_recording(foreign, setup=setup_of(tmp_path, SETUP.replace(old, new)))
    assert said in str(problem.value)
