"""The DynoWare export in the forms its users choose."""

import numpy as np
import pytest

from millcal.io.inspection import inspect_recording
from millcal.io.recordings import read_recording

FORCE = np.round(np.random.default_rng(4).normal(size=(2, 500)) * 300, 3)


def export(
    path,
    *,
    delimiter=",",
    decimal=".",
    promised=500,
    unit_of_time="s",
    start=2.0,
    rate=10000,
    encoding="utf-8",
    line_end="\r\n",
):
    """A short header, names, units and rows."""
    header = [("DynoWare", "Version 2.5.1.2"), ("Filename:", "Schnittkräfte.dwd"), ("Date:", " "), ("Time:", " ")]
    header += [("Sampling rate [Hz]:", f"{rate}"), ("Cycles:", "1"), ("Samples per channel:", f"{promised}")]
    rows = [("Time", "Fx", "Fy"), (unit_of_time, "N", "N")]
    rows += [(f"{start + i / 10000:.6g}", f"{x}", f"{y}") for i, (x, y) in enumerate(FORCE.T)]
    lines = [delimiter.join(cells) for cells in header] + [delimiter.join(r).replace(".", decimal) for r in rows]
    path.write_bytes(line_end.join([*lines, ""]).encode(encoding))


@pytest.mark.parametrize(
    ("delimiter", "decimal", "encoding", "line_end"),
    [
        (",", ".", "utf-8", "\n"),
        (";", ",", "latin-1", "\r\n"),
        ("\t", ",", "latin-1", "\r\n"),
        ("\t", ".", "utf-16", "\n"),
    ],
)
def test_every_form_of_the_export_gives_the_same_recording(delimiter, decimal, encoding, line_end, tmp_path):
    path = tmp_path / "cut.txt"
    export(path, delimiter=delimiter, decimal=decimal, encoding=encoding, line_end=line_end)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.samples, FORCE)
    assert (recording.sample_rate, recording.start_time, recording.notices) == (10000, 2.0, ())
    assert inspect_recording(path)[0]["format"] == "dynoware"


def test_fewer_rows_than_promised_are_told_and_taken(tmp_path):
    export(tmp_path / "cut.txt", promised=500001)
    (notice,) = read_recording(tmp_path / "cut.txt").notices
    assert notice.code == "rows-against-header"
    assert "500001" in notice.message
    assert "500 rows" in notice.message


def test_the_rate_of_the_header_shows_that_a_time_without_unit_is_in_seconds(tmp_path):
    export(tmp_path / "cut.txt", unit_of_time="")
    recording = read_recording(tmp_path / "cut.txt")
    assert recording.sample_rate == 10000
    assert [notice.code for notice in recording.notices] == ["time-unit"]


def test_a_header_that_speaks_of_another_rate_than_the_times_is_told(tmp_path):
    export(tmp_path / "cut.txt", rate=50000)
    recording = read_recording(tmp_path / "cut.txt")
    assert recording.sample_rate == 10000
    assert [notice.code for notice in recording.notices] == ["rate-against-header"]
