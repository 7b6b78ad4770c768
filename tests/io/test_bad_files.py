"""Bad files by the dozen: each ends in one clear line and exit code 3, or in a warning and a right result."""

import gzip
import json
import os
import re
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from millcal.cli import main

RATE = 10000
N = 400


def forces(n=N):
    """Three forces of a cut.   returns (axis, n)"""
    t = np.arange(n) / RATE
    rng = np.random.default_rng(5)
    return np.round(100 * np.sin(2 * np.pi * np.outer([200, 200, 100], t) + 1) + rng.normal(0, 1, (3, n)), 3)


def rows(n=N, *, time=True):
    """The cells of a good table."""
    columns = forces(n)
    return [([f"{i / RATE:.4f}"] if time else []) + [f"{f:.3f}" for f in columns[:, i]] for i in range(n)]


def table(cells=None, header="Time [s],Fx [N],Fy [N],Fz [N]", delimiter=","):
    cells = rows() if cells is None else cells
    return "\n".join([*([header] if header else []), *(delimiter.join(row) for row in cells)]) + "\n"


def changed(row, column, text):
    cells = rows()
    cells[row][column] = text
    return table(cells)


def recording(path, **changes):
    """A recording file of the contract with something wrong in it."""
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "millcal-recording"
        file.attrs["version"] = changes.get("version", 1)
        file.attrs["kind"] = changes.get("kind", "cut")
        if changes.get("rate", RATE):
            file.attrs["sample_rate_hz"] = changes.get("rate", RATE)
        for key, value in changes.get("attributes", {}).items():
            file.attrs[key] = value
        file.create_group("channels")
        for name, values in changes.get("channels", dict(zip(["fx", "fy", "fz"], forces(), strict=True))).items():
            dataset = file.create_dataset(f"channels/{name}", data=values)
            dataset.attrs["unit"] = changes.get("unit", "N")
            dataset.attrs["quantity"] = "force"
            dataset.attrs["dof"] = f"tip{name[-1].upper()}"
        if "segments" in changes:
            file["segments"] = changes["segments"]


def cut_short(path):
    recording(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def zipped(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("cut.csv", table())


def named_twice():
    return table(header="Time [s],Fx [N],Fx [N],Fz [N]")


def from_text(text, encoding="utf-8"):
    def write(path):
        path.write_bytes(text.encode(encoding))

    return write


def from_bytes(data):
    def write(path):
        path.write_bytes(data)

    return write


def short_last_row():
    return table()[:-9]


def late_blanks():
    cells = rows()
    for row in cells[200:]:
        row[2] = ""
    return table(cells)


def nan_stretch():
    cells = rows()
    for row in cells[100:150]:
        row[1] = "NaN"
    return table(cells)


def some_words():
    cells = rows()
    for row in cells[::7]:
        row[3] = "n/a"
    return table(cells)


def every_value(column, text):
    cells = rows()
    for row in cells:
        row[column] = text
    return table(cells)


def time_changed(change):
    cells = rows()
    for i, row in enumerate(cells):
        row[0] = f"{change(i):.4f}"
    return table(cells)


DYNOWARE = "DynoWare,Version 2.5.1.2\nSampling rate [Hz]:,10000\nSamples per channel:,{}\nTime,Fx,Fy,Fz\ns,N,N,N\n"
MIXED = "Time [s];Fx [N];Fy [N];Fz [N]\n" + "\n".join(f"{i / RATE:.4f};1,5;{i % 7}.5;2,5" for i in range(50))

# name, how the file is made, what the one line must say
REFUSED = {
    "empty.csv": (from_bytes(b""), "empty"),
    "blank.csv": (from_text("\n\n  \n"), "holds nothing"),
    "header_only.csv": (from_text(table([])), "no rows of numbers"),
    "prose.txt": (from_text("Cut 1 went well.\nCut 2 did not.\nThe tool broke.\nWe went home.\n"), "no table of numbers"),
    "two_rows.csv": (from_text(table(rows(2))), "only 2 rows"),
    "binary.csv": (from_bytes(np.random.default_rng(1).bytes(5000)), "binary"),
    "zeros.csv": (from_bytes(bytes(5000)), "binary"),
    "zip.csv": (zipped, "zip archive"),
    "sheet.xlsx": (zipped, "save the sheet as CSV"),
    "packed.csv.gz": (from_bytes(gzip.compress(table().encode())), "gzip archive; unpack"),
    "cut.dwd": (from_bytes(b"DWD\x00\x01\x00" + bytes(200)), "export it as text"),
    "old.mat": (from_bytes(b"MATLAB 5.0 MAT-file, Platform: PCWIN64" + bytes(200)), "MAT file"),
    "cut.tdms": (from_bytes(b"TDSm\x0e\x00\x00\x00" + bytes(200)), "TDMS file; this format is not yet read"),
    "frf.uff": (from_text("    -1\n    58\nresponse\n"), "universal file"),
    "sound.wav": (from_bytes(b"RIFF\x24\x08\x00\x00WAVEfmt " + bytes(200)), "WAV file"),
    "unit_missing.csv": (from_text(table(header="Time [s],Fx,Fy [N],Fz [N]")), r"column 'Fx' has no unit; state it with --unit"),
    "unit_unknown.csv": (from_text(table(header="Time [s],Fx [dyn],Fy [N],Fz [N]")), r"'Fx \[dyn\]': unknown unit 'dyn'"),
    "volts.csv": (from_text(table(header="Time [s],Fx [V],Fy [N],Fz [N]")), r"is in V; state its sensitivity"),
    "time_unit_missing.csv": (from_text(table(header="Time,Fx [N],Fy [N],Fz [N]")), "column 'Time' has no unit"),
    "no_time.csv": (from_text(table(rows(time=False), "Fx [N],Fy [N],Fz [N]")), "no sample rate; state --rate-hz"),
    "no_header.csv": (from_text(table(header="")), "'col1' has no unit"),
    "word_in_numbers.csv": (from_text(changed(123, 2, "oops")), r"line 125: column 'Fy' holds 'oops'"),
    "long_row.csv": (from_text(table().replace("\n0.0123,", "\n0.0123,1.0,")), "line 125: 5 cells where the table has 4"),
    "short_row.csv": (from_text(table().replace("\n0.0123,", "\n")), "line 125: 3 cells where the table has 4"),
    "nan_stretch.csv": (from_text(nan_stretch()), "column 'Fx' misses 50 values in a row from line 102"),
    "many_gaps.csv": (from_text(some_words()), r"column 'Fz' misses \d+ of 400 values"),
    "column_ends_early.csv": (from_text(late_blanks()), "column 'Fy' has no values from line 202 on"),
    "dead.csv": (from_text(every_value(2, "")), "column 'Fy' holds no numbers"),
    "constant.csv": (from_text(every_value(3, "0.000")), "channel 'Fz' is constant"),
    "overflow.csv": (from_text(every_value(1, "inf")), "column 'Fx' holds no numbers"),
    "huge.csv": (from_text(changed(77, 1, "1e300")), r"'Fx' is 1e\+300 N at line 79"),
    "time_backwards.csv": (from_text(time_changed(lambda i: (i if i < 200 else i - 100) / RATE)), "backwards at line 202"),
    "time_jump.csv": (from_text(time_changed(lambda i: (i if i < 200 else i + 300) / RATE)), "jumps by 0.0301 s at line 202"),
    "time_constant.csv": (from_text(time_changed(lambda i: 2.5)), "the time does not advance"),
    "time_gone.csv": (from_text(changed(50, 0, "")), "no time at line 52"),
    "time_in_ms.csv": (from_text(time_changed(lambda i: i * 0.5)), "sample rate of 2 Hz is not one of a cut"),
    "time_uneven.csv": (from_text(time_changed(lambda i: i / RATE + (i / 2000) ** 2)), "time jumps|uneven steps"),
    "decimal_commas.csv": (
        from_text("t [s],F [N]\n" + "\n".join(f"0,{i:04d},{i % 9},5" for i in range(50))),
        "decimal commas in a table whose cells are separated by commas",
    ),
    "both_decimals.csv": (from_text(MIXED), "some numbers have a decimal point and some a decimal comma"),
    "thousands.csv": (from_text("t;F [N]\n" + "\n".join(f"{i};1.234,{i}" for i in range(50))), "thousands separators"),
    "cut_short.h5": (cut_short, "cut short or damaged"),
    "not_hdf5.h5": (from_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100)), "cut short or damaged"),
    "no_channels.h5": (lambda path: recording(path, channels={}), "without channels"),
    "unequal.h5": (
        lambda path: recording(path, channels={"fx": forces()[0], "fy": forces()[1, :300]}),
        "unequal lengths (.*fx 400, fy 300)",
    ),
    "two_axes.h5": (lambda path: recording(path, channels={"fx": forces()}), r"has shape \(3, 400\)"),
    "words.h5": (lambda path: recording(path, channels={"fx": np.array([b"a", b"b"])}), "holds no numbers"),
    "segments_outside.h5": (lambda path: recording(path, segments=[[0, 100], [350, 100]]), "segment 1 is outside the 400"),
    "segments_shape.h5": (lambda path: recording(path, segments=[0, 100, 200]), r"segments have shape \(3,\)"),
    "no_rate.h5": (lambda path: recording(path, rate=None), "no sample rate"),
    "absurd_rate.h5": (lambda path: recording(path, rate=1e12), "sample rate of 1e[+]12 Hz"),
    "negative_rate.h5": (lambda path: recording(path, rate=-1000.0), "sample rate of -1000 Hz"),
    "unit_unknown.h5": (lambda path: recording(path, unit="stone"), "unknown unit 'stone'"),
    "unknown_kind.h5": (lambda path: recording(path, kind="song"), "'song', which is none of"),
    "newer.h5": (lambda path: recording(path, version=2), "newer version"),
    "nan.h5": (lambda path: recording(path, channels={"fx": np.where(np.arange(N) == 7, np.nan, 1.0)}), "'fx' is nan N"),
    "order.h5": (lambda path: recording(path, attributes={"channel_order": ["fx", "fq"]}), "channel_order names fx, fq"),
    "bad_cutter.h5": (
        lambda path: recording(path, attributes={"diameter_mm": -3.0, "teeth": 2}),
        "attribute diameter_mm is -3.0",
    ),
    "foreign.h5": (lambda path: h5py.File(path, "w").create_dataset("run/force", data=forces()).file.close(), "no recording"),
    "folder.csv": (lambda path: path.mkdir(), "a folder"),
    "absent.csv": (lambda path: None, "no such file"),
}  # fmt: skip

# name, how it is made, the code of the warning
WARNED = {
    "cut.h5.csv": (lambda path: recording(path), None),
    "wrong_suffix.h5": (from_text(table()), None),
    "tabs.csv": (from_text(table(header="Time [s]\tFx [N]\tFy [N]\tFz [N]", delimiter="\t")), None),
    "last_row_cut.csv": (from_text(short_last_row()), "last-line-cut"),
    "one_blank.csv": (from_text(changed(100, 2, "")), "gaps-bridged"),
    "one_infinity.csv": (from_text(changed(100, 2, "inf")), "gaps-bridged"),
    "same_names.csv": (from_text(named_twice()), "duplicate-names"),
    "footer.csv": (from_text(table() + "End of data\n"), "lines-left-out"),
    "remark_inside.csv": (from_text(table().replace("\n0.0200,", "\n# paused\n0.0200,")), "lines-left-out"),
    "header_against_rows.csv": (
        from_text(DYNOWARE.format(500001) + table(header="").replace("\n", "\n")),
        "rows-against-header",
    ),
    "header_rate.csv": (from_text("# sampling rate: 20000 Hz\n" + table()), "rate-against-header"),
    "gbk_garbage.csv": (
        from_bytes("时间 [s],力x [N],力y [N],力z [N]\n".encode("gbk") + table(header="").encode() + b"\xff\xfe\x80\n"),
        "lines-left-out",
    ),
    "words_column.csv": (
        from_text(
            table([[*row, "ok"] for row in rows()], "Time [s],Fx [N],Fy [N],Fz [N],Status")
        ),
        "text-columns",
    ),
    "torque_too.csv": (
        from_text(table([[*row, f"{i % 5}.25"] for i, row in enumerate(rows())], "Time [s],Fx [N],Fy [N],Fz [N],Mz [Nm]")),
        "columns-left-out",
    ),
}  # fmt: skip


def run(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code, *capsys.readouterr()


def test_there_are_more_than_forty_kinds():
    assert len(REFUSED) + len(WARNED) > 40


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_file_is_one_line_and_nothing_is_written(name, tmp_path, capsys):
    make, said = REFUSED[name]
    path, out = tmp_path / name, tmp_path / "out"
    make(path)
    out.mkdir()
    (out / "cut.h5").write_bytes(b"the old result")
    code, stdout, stderr = run(["ingest", path, "-o", out / "cut.h5"], capsys)
    assert code == 3
    assert stdout == ""
    assert re.fullmatch(r"error: [^\n]*\n", stderr), stderr
    assert stderr.startswith(f"error: {path}: ")
    assert re.search(said, stderr), stderr
    assert re.search(r"[;:] .*[;,] ?\w", stderr), "no mending"
    assert {file.name: file.read_bytes() for file in out.iterdir()} == {"cut.h5": b"the old result"}


@pytest.mark.parametrize("name", REFUSED)
def test_inspect_says_what_is_missing_or_refuses_in_one_line(name, tmp_path, capsys):
    path = tmp_path / name
    REFUSED[name][0](path)
    code, stdout, stderr = run(["inspect", path, "--json"], capsys)
    assert code in (0, 3)
    if code == 0:
        assert json.loads(stdout)["result"]["format"]
    else:
        assert re.fullmatch(r"error: [^\n]*\n", stderr), stderr


@pytest.mark.parametrize("name", WARNED)
def test_a_crooked_file_gives_a_warning_and_a_right_result(name, tmp_path, capsys):
    make, code_of_warning = WARNED[name]
    path, out = tmp_path / name, tmp_path / "cut.h5"
    make(path)
    code, stdout, stderr = run(["ingest", path, "-o", out, "--json"], capsys)
    assert code == 0, stderr
    told = json.loads(stdout)
    assert told["result"]["sample_rate_hz"] == RATE
    codes = {warning["code"] for warning in told["warnings"]}
    assert codes == ({code_of_warning} if code_of_warning else set())
    with h5py.File(out) as file:
        stored = np.stack([file["channels"][channel][()] for channel in file.attrs["channel_order"]])
    expected = forces()[:, : stored.shape[1]]
    assert stored.shape[1] >= N - 1
    off = np.abs(stored - expected).max(axis=0)
    bridged = [100] if code_of_warning == "gaps-bridged" else []
    assert np.delete(off, bridged).max() < 1e-12
    assert off.max() < 2  # a straight line over one sample


def test_a_file_without_permission_is_one_line(tmp_path, capsys):
    path = tmp_path / "cut.csv"
    path.write_text(table())
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("root reads everything")
    code, _, stderr = run(["inspect", path], capsys)
    assert code == 3
    assert "permission denied" in stderr


def test_files_of_different_rates_are_not_joined(tmp_path, capsys):
    slow = table([[f"{i / 5000:.4f}", *row[1:]] for i, row in enumerate(rows())])
    for name, text in {"a.csv": table(), "b.csv": slow}.items():
        (tmp_path / name).write_text(text)
    code, _, stderr = run(["ingest", tmp_path / "a.csv", tmp_path / "b.csv", "-o", tmp_path / "o.h5"], capsys)
    assert code == 3
    assert re.search(r"error: .*b\.csv: .*inconsistent rates, 5000 Hz and 10000 Hz; ", stderr)
    assert not (tmp_path / "o.h5").exists()


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (["--map", "fx=+Fq"], "no column 'Fq'; the file has Time, Fx, Fy, Fz"),
        (["--map", "fx=Time"], "takes the time column"),
        (["--unit", "Fq=N"], "no column 'Fq'"),
        (["--unit", "Fx=stone"], "unknown unit 'stone'"),
        (["--unit", "Fx=100 mV/g"], "is in N, and '100 mV/g' is for a column in V"),
        (["--unit", "Fx=0 mV/g"], "is no sensitivity"),
        (["--rate-hz", "1"], "sample rate of 1 Hz"),
        (["--air", "0.01:5"], "no air cut from 0.01 to 5 s"),
    ],
)
def test_a_statement_that_does_not_fit_the_file_is_one_line(option, said, tmp_path, capsys):
    path = tmp_path / "cut.csv"
    path.write_text(table())
    code, _, stderr = run(["ingest", path, "-o", tmp_path / "o.h5", *option], capsys)
    assert code == 3
    assert said in stderr
    assert stderr.count("\n") == 1
    assert os.listdir(tmp_path) == ["cut.csv"]


@pytest.mark.parametrize("option", [["--map", "fx"], ["--unit", "=N"], ["--air", "2:1"]])
def test_an_option_that_cannot_be_read_is_a_usage_error(option, tmp_path, capsys):
    code, _, stderr = run(["ingest", "cut.csv", "-o", tmp_path / "o.h5", *option], capsys)
    assert code == 2
    assert stderr.count("\n") == 1


def test_a_result_in_a_place_that_is_no_folder_is_one_line(tmp_path, capsys):
    path = tmp_path / "cut.csv"
    path.write_text(table())
    code, _, stderr = run(["ingest", path, "-o", path / "o.h5"], capsys)
    assert code == 3
    assert re.fullmatch(r"error: .*o\.h5: .*; .*\n", stderr)


def test_a_filter_that_is_not_installed_is_named(tmp_path, capsys, monkeypatch):
    path = Path(tmp_path / "cut.h5")
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "millcal-recording", "version": 1, "sample_rate_hz": 1e4})
        dataset = file.create_dataset("channels/fx", data=forces()[0], chunks=(100,), compression="lzf")
        dataset.attrs["unit"] = "N"
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: False)
    code, _, stderr = run(["inspect", path], capsys)
    assert code == 3
    assert "compressed with the filter lzf, which is not installed; run 'pip install hdf5plugin'" in stderr
