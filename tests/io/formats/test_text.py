"""Text tables: every way to write the same numbers gives the same numbers."""

import io
import os
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from millcal.cli import main
from millcal.errors import MillcalError
from millcal.io import samples
from millcal.io.formats import text
from millcal.io.inspection import inspect_recording
from millcal.io.keys import TextTable
from millcal.io.recipes import Setup
from millcal.io.recordings import read_recording

REFERENCE = os.environ.get("MILLCAL_REFERENCE_DATA", "")
needs_reference = pytest.mark.skipif(not REFERENCE, reason="MILLCAL_REFERENCE_DATA names no folder of reference data")
RATE = 12800

HEADERS = {
    "brackets": ("Time [s]", "Fx [N]", "Ax [m/s²]", "Uz [µm]"),
    "round": ("Time (s)", "Fx (N)", "Ax (m/s²)", "Uz (µm)"),
    "slash": ("Time/s", "Fx/N", "Ax/m/s²", "Uz/µm"),
    "endings": ("time_s", "Fx_N", "Ax_m_s2", "Uz_um"),
    "units row": ("Time", "Fx", "Ax", "Uz"),
    "milliseconds": ("t [ms]", "Fx [kN]", "Ax [g]", "Uz [mm]"),
    "none": None,
}
TO_SI = {"milliseconds": (1e3, 9.80665, 1e-3)}
UNITS = {"col1": "s", "col2": "N", "col3": "m/s^2", "col4": "um"}


def written(values, *, delimiter, decimal, header, line_end="\n", comment=None, preamble=()):
    """A table of numbers as text.   values : (row, 3)"""
    scale = 1e3 if header == "milliseconds" else 1.0
    lines = list(preamble)
    names = HEADERS[header]
    if names:
        lines.append((comment or "") + delimiter.join(names))
    if header == "units row":
        lines.append(delimiter.join(["s", "N", "m/s²", "µm"]))
    for i, row in enumerate(values):
        cells = [f"{scale * i / RATE:.9f}", *(repr(float(value)) for value in row)]
        lines.append(delimiter.join(cell.replace(".", decimal) for cell in cells))
    return line_end.join([*lines, ""])


numbers = st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-9)


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    data=st.data(),
    pair=st.sampled_from(
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), ("  ", "."), ("  ", ",")]
    ),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    header=st.sampled_from(list(HEADERS)),
    line_end=st.sampled_from(["\n", "\r\n", "\r"]),
    comment=st.sampled_from(["", "# ", "%"]),
)
def test_every_dialect_gives_back_the_numbers(tmp_path_factory, data, pair, encoding, header, line_end, comment):
    n = data.draw(st.integers(8, 30))
    values = np.array(data.draw(st.lists(st.tuples(numbers, numbers, numbers), min_size=n, max_size=n)))
    values += np.arange(n)[:, np.newaxis]  # no constant channel
    path = tmp_path_factory.mktemp("dialect") / "table.txt"
    content = written(
        values,
        delimiter=pair[0],
        decimal=pair[1],
        header=header,
        line_end=line_end,
        comment=comment if pair[0] != "%" else "",
    )
    path.write_bytes(content.encode(encoding))
    recording = read_recording(path, units=UNITS if header == "none" else None)
    to_si = TO_SI.get(header, (1.0, 1.0, 1e-6))
    np.testing.assert_allclose(recording.samples, (values * to_si).T, rtol=1e-14, atol=0)
    assert recording.sample_rate == RATE
    assert [channel.unit for channel in recording.channels] == ["N", "m/s^2", "m"]


def test_chinese_headers_in_gbk_are_read(tmp_path):
    path = tmp_path / "cut.txt"
    lines = ["采样频率:10 kHz", "时间[s]\t切向力[N]", *(f"{i / 1e4:.4f}\t{i % 7}.5" for i in range(50))]
    path.write_bytes("\r\n".join(lines).encode("gbk"))
    recording = read_recording(path)
    assert [channel.name for channel in recording.channels] == ["切向力"]
    assert recording.sample_rate == 1e4


def test_a_micro_sign_in_latin_1_is_not_taken_for_chinese(tmp_path):
    path = tmp_path / "cut.csv"
    path.write_bytes(
        written(np.arange(60.0).reshape(20, 3), delimiter=";", decimal=",", header="brackets").encode("latin-1")
    )
    assert [c["unit"] for c in inspect_recording(path)[0]["channels"]] == ["N", "m/s²", "µm"]


@pytest.mark.parametrize(
    "clock",
    [
        lambda s: f"{s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f}",
        lambda s: f"{s // 60:02.0f}:{s % 60:06.3f}",
        lambda s: f"2024-03-01 {s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f}",
        lambda s: f"2024-03-01T{s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f}",
    ],
)
def test_times_of_day_are_a_time_base(clock, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("ActualTime,Fx_N\n" + "".join(f"{clock(59.5 + i / 500)},{i % 7}\n" for i in range(1000)))
    recording = read_recording(path)
    assert recording.sample_rate == 500
    assert recording.samples.shape == (1, 1000)


def test_a_log_over_midnight_runs_on(tmp_path):
    path = tmp_path / "log.csv"
    seconds = (86399 + np.arange(1000) / 500) % 86400
    rows = (f"{s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f},{i % 7}\n" for i, s in enumerate(seconds))
    path.write_text("ActualTime,Fx_N\n" + "".join(rows))
    assert read_recording(path).sample_rate == 500


def test_a_short_gap_becomes_a_straight_line_and_is_told_with_place_and_count(tmp_path):
    path = tmp_path / "cut.csv"
    cells = [[f"{i / 1000:.3f}", f"{i * 2.0}", f"{i % 7}"] for i in range(2000)]
    for i in (1000, 1001, 1002):
        cells[i][1] = ""
    path.write_text("t_s,Fx_N,Fy_N\n" + "\n".join(map(",".join, cells)))
    recording = read_recording(path)
    np.testing.assert_allclose(recording.samples[0], 2.0 * np.arange(2000))
    (notice,) = recording.notices
    assert "'Fx'" in notice.message
    assert "3 missing values" in notice.message
    assert "line 1002" in notice.message


@pytest.mark.parametrize("block", [200, 997, 1 << 23])
def test_the_block_size_changes_nothing(block, tmp_path, monkeypatch):
    """Gaps, remarks and a cut last line stand across the edges of blocks as anywhere else."""
    path = tmp_path / "cut.csv"
    cells = [[f"{i / 1000:.3f}", f"{i * 2.0}", f"{i % 7}"] for i in range(900)]
    for i in (57, 300, 301, 302, 303, 599):
        cells[i][2] = "" if i % 2 else "NaN"
    lines = ["t_s,Fx_N,Fy_N", *map(",".join, cells)]
    lines.insert(400, "# a remark")
    path.write_text("\n".join(lines) + "\n0.900,18")
    monkeypatch.setattr(text, "BLOCK", block)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.samples[0], 2.0 * np.arange(900))
    np.testing.assert_allclose(
        recording.samples[1][300:304], np.interp(range(300, 304), [299, 304], [299 % 7, 304 % 7])
    )
    assert {notice.code for notice in recording.notices} == {"gaps-bridged", "lines-left-out", "last-line-cut"}
    (left_out,) = (notice.message for notice in recording.notices if notice.code == "lines-left-out")
    assert "line 401" in left_out


def test_samples_too_many_for_the_memory_stay_on_disk_and_are_the_same(tmp_path, monkeypatch):
    path = tmp_path / "cut.csv"
    values = np.random.default_rng(1).normal(size=(5000, 3))
    path.write_text(written(values, delimiter=",", decimal=".", header="brackets"))
    whole = read_recording(path).samples
    monkeypatch.setattr(samples, "IN_MEMORY", 1000)
    monkeypatch.setattr(text, "BLOCK", 10000)
    on_disk = read_recording(path)
    assert on_disk.samples.shape == whole.shape
    assert not isinstance(on_disk.samples, np.ndarray)
    np.testing.assert_array_equal(np.concatenate([block for _, block in on_disk.blocks(777)], axis=1), whole)
    np.testing.assert_array_equal(on_disk.block(1234, 3456), whole[:, 1234:3456])


def test_a_setup_states_what_looking_cannot_tell(tmp_path):
    path = tmp_path / "odd.txt"
    path.write_text("1 2 3\nno header\n" + "\n".join(f"{i}:{i * i}:{i % 3}" for i in range(20)))
    layout = TextTable(delimiter=":", skip_rows=2, columns=("t", "Fx", "Fy"), time="t", time_unit="ms")
    recording = read_recording(path, setup=Setup(text=layout, units={"Fx": "N", "Fy": "kN"}))
    np.testing.assert_allclose(recording.samples[1], np.arange(20) % 3 * 1e3)
    assert recording.sample_rate == 1000


DIALECT_SEED = "Time [s];Fx [N];Fy [N]\n" + "".join(f"0,{i:04d};{i % 7},5;-{i % 5}e-1\n" for i in range(40))


def never_a_traceback(folder: Path, content: bytes) -> None:
    """Whatever the bytes are: a result, or one line."""
    path = folder / "fuzz.csv"
    path.write_bytes(content)
    for action in (read_recording, inspect_recording):
        problem = said(action, path)
        assert problem is None or ("\n" not in problem.strip() and str(path) in problem)


def said(action, path: Path) -> str | None:
    """The message of the error, None where there is a result."""
    try:
        action(path)
    except MillcalError as problem:
        return str(problem)
    return None


def mutated(seed: bytes, changes: list[tuple[int, bytes]]) -> bytes:
    for at, new in changes:
        at %= len(seed)
        seed = seed[:at] + new + seed[at + len(new) // 2 :]
    return seed


changes = st.lists(
    st.tuples(st.integers(0, 10**4), st.binary(max_size=6) | st.sampled_from([b";", b"\n", b",", b"nan", b'"', b"\r"]))
)


@settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(content=st.binary(max_size=400) | st.text(alphabet="0123456789.,;-eE \t\n:#naN[]", max_size=400).map(str.encode))
def test_random_bytes_never_give_a_traceback(tmp_path_factory, content):
    never_a_traceback(tmp_path_factory.mktemp("fuzz"), content)


@settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(changes=changes)
def test_a_mutated_table_never_gives_a_traceback(tmp_path_factory, changes):
    never_a_traceback(tmp_path_factory.mktemp("fuzz"), mutated(DIALECT_SEED.encode(), changes))


@pytest.mark.long
@settings(max_examples=5000, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    content=st.binary(max_size=2000)
    | st.text(alphabet="0123456789.,;-eE \t\n:#naN[]()/s", max_size=2000).map(str.encode)
    | changes.map(lambda c: mutated(DIALECT_SEED.encode(), c))
    | changes.map(lambda c: mutated(DIALECT_SEED.encode("utf-16"), c))
)
def test_no_bytes_at_all_give_a_traceback(tmp_path_factory, content):
    never_a_traceback(tmp_path_factory.mktemp("fuzz"), content)


@needs_reference
@pytest.mark.parametrize(("feed", "start"), [(300, 8.0), (600, 5.0), (900, 3.0), (1200, 2.0), (1500, 2.0)])
def test_a_real_dynoware_export_is_read_to_the_digit(feed, start):
    path = Path(REFERENCE) / "real/dynoware_slot_al" / f"6-n6000f{feed}ap3ae25.csv"
    recording = read_recording(path, map={"fx": "+Fy", "fy": "+Fx", "fz": "-Fz"})
    plain = pd.read_csv(io.StringIO("\n".join(path.read_text().splitlines()[20:])), header=None).to_numpy()
    np.testing.assert_array_equal(recording.samples, plain[:, [2, 1, 3]].T * [[1], [1], [-1]])
    assert (recording.sample_rate, recording.start_time) == (10000, start)
    assert [channel.dof for channel in recording.channels] == ["tipX", "tipY", "tipZ"]
    assert "rows-against-header" in {notice.code for notice in recording.notices}


@needs_reference
def test_a_rounded_time_column_gives_the_rate_of_the_sampler():
    """1 / median(dt) of this file is 51282 Hz."""
    path = Path(REFERENCE) / "real/cutpro_hammer/Point1_Channel1_CH1.txt"
    recording = read_recording(path, units={"col1": "s", "col2": "N", "col3": "m/s^2"})
    assert recording.sample_rate == 51200
    assert recording.samples[0].max() == pytest.approx(249.7, abs=0.05)


@needs_reference
def test_units_at_the_end_of_column_names_are_read():
    recording = read_recording(
        Path(REFERENCE) / "cases/frf/13_B_continuous_csv/tap.csv", map={"hammer@tipX": "force", "acc_tipX": "acc_tipX"}
    )
    assert recording.sample_rate == 25600
    assert [(c.name, c.unit, c.dof) for c in recording.channels] == [
        ("hammer", "N", "tipX"),
        ("acc_tipX", "m/s^2", "tipX"),
    ]


@pytest.mark.long
def test_a_long_text_file_needs_no_more_memory_than_a_short_one(tmp_path):
    import subprocess
    import sys

    peak = {}
    for megabytes in (20, 400):
        path = tmp_path / f"{megabytes}.csv"
        row = "".join(f"{i / 1e4:.4f},{i % 977}.25,{i % 389}.5,{i % 173}.125\n" for i in range(10000))
        with path.open("w") as file:
            file.write("Time [s],Fx [N],Fy [N],Fz [N]\n")
            for _ in range(megabytes * 10**6 // len(row)):
                file.write(row)
        script = (
            "import sys, resource; from pathlib import Path; from millcal.io.recordings import read_recording, write_recording\n"
            "r = read_recording(Path(sys.argv[1]), rate_hz=1e4); write_recording(Path(sys.argv[1] + '.h5'), r)\n"
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
        )
        run = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True)
        peak[megabytes] = float(run.stdout)
    assert peak[400] < 300


def test_ingest_writes_what_was_read(tmp_path, capsys):
    values = np.random.default_rng(2).normal(size=(300, 3))
    path, out = tmp_path / "cut.csv", tmp_path / "cut.h5"
    path.write_text(written(values, delimiter=";", decimal=",", header="milliseconds"))
    with pytest.raises(SystemExit) as end:
        main(["ingest", str(path), "-o", str(out), "--map", "fx=-Fx", "--map", "ax@tipY=Ax", "--acts-on", "workpiece"])
    assert end.value.code == 0
    with h5py.File(out) as file:
        np.testing.assert_allclose(file["channels/fx"][()], 1e3 * values[:, 0])  # turned by the map and by the reaction
        assert file["channels/fx"].attrs["acts_on"] == "tool"
        assert file["channels/ax"].attrs["dof"] == "tipY"
        assert set(file["channels"]) == {"fx", "ax"}
