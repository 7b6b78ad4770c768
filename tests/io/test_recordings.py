"""Recordings to disk and back: the same numbers, the same bytes, whole or not at all."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.errors import RecordingError
from millcal.io import samples
from millcal.io.air_cut import without_offset
from millcal.io.recordings import join_recordings, read_recording, write_recording
from millcal.io.samples import Chained, Scratch
from millcal.physics.cutter import Cutter, CuttingConditions

FORCE = Channel("fx", "force", "N", "tipX", 500.0)
ACCELERATION = Channel("ax", "acceleration", "m/s^2", "tipX")


def cut(n=3000, **more):
    values = np.random.default_rng(3).normal(size=(2, n)) * 100
    values[0] = np.round(values[0] / 0.0305176) * 0.0305176  # as of a 16-bit converter
    return Recording(
        **{"samples": values, "sample_rate": 10000.0, "channels": (FORCE, ACCELERATION), "name": "cut", **more}
    )


def test_what_is_written_is_read_back(tmp_path):
    cutter = Cutter(0.025, 3, np.radians(30), tuple(np.radians([110, 120, 130])), 5e-6, 0.3)
    conditions = CuttingConditions(628.3185307179587, 0.05e-3, 3e-3, 12.5e-3, "down")
    recording = cut(
        cutter=cutter, conditions=conditions, steady=(0.01, 0.2), air=((0.0, 0.01),), start_time=2.5,
        segments=np.array([[0, 1000], [1000, 2000]]),
    )  # fmt: skip
    write_recording(tmp_path / "cut.h5", recording)
    back = read_recording(tmp_path / "cut.h5")
    np.testing.assert_array_equal(back.samples, recording.samples)
    np.testing.assert_array_equal(back.segments, recording.segments)
    assert (back.channels, back.kind, back.start_time) == (recording.channels, "cut", 2.5)
    assert (back.steady, back.air) == (recording.steady, recording.air)
    assert vars(back.conditions) == pytest.approx(vars(conditions))
    assert back.cutter.pitch == pytest.approx(cutter.pitch)
    assert back.cutter.runout == pytest.approx(cutter.runout)
    assert back.notices == ()


def test_which_force_answers_the_hammer_is_written_and_read_back(tmp_path):
    channels = (Channel("hammer", "force", "N", "tipX"), Channel("fx", "force", "N", "tipX", role="response"))
    write_recording(tmp_path / "tap.h5", cut(channels=channels, kind="impact"))
    assert read_recording(tmp_path / "tap.h5").channels == channels
    with h5py.File(tmp_path / "tap.h5", "a") as file:
        assert (file["channels/fx"].attrs["role"], "role" in file["channels/hammer"].attrs) == ("response", False)
        file["channels/fx"].attrs["role"] = "output"
    with pytest.raises(RecordingError, match="channel 'fx': a force cannot have the role 'output'"):
        read_recording(tmp_path / "tap.h5")


def test_the_layout_is_that_of_the_contract(tmp_path):
    write_recording(tmp_path / "cut.h5", cut(n=100_000))
    with h5py.File(tmp_path / "cut.h5") as file:
        assert (file.attrs["format"], file.attrs["version"], file.attrs["kind"]) == ("millcal-recording", 1, "cut")
        assert file.attrs["sample_rate_hz"] == 10000
        assert list(file.attrs["channel_order"]) == ["fx", "ax"]
        dataset = file["channels/fx"]
        assert (dataset.chunks, dataset.shuffle, dataset.compression, dataset.compression_opts) == (
            (65536,),
            True,
            "gzip",
            1,
        )
        stated = {key: dataset.attrs[key] for key in ("unit", "quantity", "dof", "full_scale", "acts_on")}
        assert stated == {"unit": "N", "quantity": "force", "dof": "tipX", "full_scale": 500.0, "acts_on": "tool"}


def test_the_same_recording_gives_the_same_bytes(tmp_path):
    write_recording(tmp_path / "a.h5", cut())
    time.sleep(1.1)  # HDF5 can store seconds
    write_recording(tmp_path / "b.h5", cut())
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_counts_are_smaller_and_tell_the_same(tmp_path):
    write_recording(tmp_path / "floats.h5", cut())
    write_recording(tmp_path / "counts.h5", cut(), counts=True)
    with h5py.File(tmp_path / "counts.h5") as file:
        assert [file["channels"][name].dtype for name in ("fx", "ax")] == [np.int16, np.float64]
        assert file["channels/fx"].attrs["scale"] == pytest.approx(0.0305176, rel=1e-9)
    np.testing.assert_allclose(read_recording(tmp_path / "counts.h5").samples, cut().samples, rtol=1e-12)
    assert (tmp_path / "counts.h5").stat().st_size < (tmp_path / "floats.h5").stat().st_size


def test_samples_on_disk_are_written_as_those_in_memory(tmp_path, monkeypatch):
    write_recording(tmp_path / "a.h5", cut(n=200_000))
    scratch = Scratch(2)
    for part in np.array_split(cut(n=200_000).samples, 7, axis=1):
        scratch.append(part)
    write_recording(tmp_path / "b.h5", cut(samples=scratch))
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    monkeypatch.setattr(samples, "IN_MEMORY", 1000)
    write_recording(tmp_path / "b.h5", read_recording(tmp_path / "b.h5"))  # onto the file it is read from
    np.testing.assert_array_equal(read_recording(tmp_path / "b.h5").block(0, 200_000), cut(n=200_000).samples)


def test_recordings_are_joined_with_a_segment_for_each():
    parts = [cut(n=100), cut(n=50, segments=np.array([[0, 20], [20, 30]]))]
    joined = join_recordings(parts)
    np.testing.assert_array_equal(joined.samples, np.hstack([part.samples for part in parts]))
    assert joined.segments.tolist() == [[0, 100], [100, 20], [120, 30]]


def test_a_chain_of_parts_is_read_across_their_edges():
    whole = np.arange(60.0).reshape(2, 30)
    chain = Chained([whole[:, :7], whole[:, 7:8], whole[:, 8:]])
    for start, stop in [(0, 30), (5, 9), (7, 8), (8, 30), (12, 12), (25, 99)]:
        np.testing.assert_array_equal(chain.read_block(start, stop), whole[:, start:stop])


def test_offset_and_drift_of_the_air_are_removed_from_forces_alone():
    time_s = np.arange(10000) / 10000.0
    line = np.array([[20.0], [5.0]]) + np.array([[-3.0], [1.0]]) * time_s
    straight, offset, drift = without_offset(cut(samples=line), [(0.0, 0.1), (0.8, 1.0)])
    np.testing.assert_allclose((offset[0], drift[0]), (20, -3), rtol=1e-9)
    np.testing.assert_allclose(straight.samples, [np.zeros(10000), line[1]], atol=1e-9)
    _, offset, drift = without_offset(cut(samples=line), [(0.0, 0.1)])
    np.testing.assert_allclose((offset[0], drift[0]), (line[0, :1000].mean(), 0))


INGEST = "import sys; from millcal.cli import main; print('ready', flush=True); main(['ingest', *sys.argv[1:]])"


def ingest_killed_after(seconds, path, out):
    process = subprocess.Popen(
        [sys.executable, "-c", INGEST, str(path), "-o", str(out)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    process.stdout.readline()
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()


def killed_ingests(tmp_path: Path, rows: int, delays) -> None:
    path, out = tmp_path / "cut.csv", tmp_path / "out" / "cut.h5"
    out.parent.mkdir()
    path.write_text("t_s,Fx_N\n" + "".join(f"{i / 1e4:.4f},{i % 977}.5\n" for i in range(rows)))
    for delay in delays:
        ingest_killed_after(delay, path, out)
        assert not out.exists() or read_recording(out).samples.shape == (1, rows)
        out.unlink(missing_ok=True)
    write_recording(out, cut())
    for delay in delays:
        ingest_killed_after(delay, path, out)
        assert read_recording(out).samples.shape in ((2, 3000), (1, rows))
        write_recording(out, cut())
        assert [file.name for file in out.parent.iterdir() if not file.name.startswith(".")] == ["cut.h5"]


def test_a_killed_ingest_leaves_the_old_recording_or_the_new_one(tmp_path):
    killed_ingests(tmp_path, 100_000, [0.5, 0.8])


@pytest.mark.long
def test_an_ingest_killed_at_any_moment_leaves_the_old_recording_or_the_new_one(tmp_path):
    killed_ingests(tmp_path, 1_000_000, np.linspace(0.0, 2.5, 26))
