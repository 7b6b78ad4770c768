"""The cuts log: what is read, what is left blank, and what is wrong told with its line and column."""

import numpy as np
import pytest

from millcal.errors import RecordingError
from millcal.io.cuts_log import cuts_on_map, read_cuts_log

RPM = 2 * np.pi / 60
HEADER = "rpm,axial_depth_mm,radial_depth_mm,feed_per_tooth_mm,stable,M_um,chatter_hz,power_W"
LOG = f"""{HEADER}
9200,1.5,0.8,0.08,1,0.6,,310
8400,2.0,0.8,0.08,0,41,623.4,
"""
MAP = {"radial_depth": 0.8e-3, "direction": "down"}


@pytest.fixture
def write(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "cuts.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


def test_a_row_is_a_cut_in_si_and_what_is_blank_is_not_known(write):
    one, other = read_cuts_log(write(LOG))
    assert (one.spindle_speed, one.axial_depth, one.stable) == (pytest.approx(9200 * RPM), pytest.approx(1.5e-3), True)
    assert (one.radial_depth, one.feed_per_tooth) == pytest.approx((0.8e-3, 0.08e-3))
    assert (one.metric, one.chatter_frequency, one.power) == (pytest.approx(6e-7), None, 310.0)
    assert (other.stable, other.chatter_frequency, other.power, other.line) == (False, 623.4, None, 3)


@pytest.mark.parametrize(
    "text",
    [
        LOG.replace(",", ";"),
        LOG.replace(",", ";").replace("0.8", "0,8").replace("1.5", "1,5"),  # decimal commas
        LOG.replace(",", "\t"),
        LOG.replace("\n", "\r\n"),
        "\ufeff# judged by ear\n\n" + LOG,
        LOG.replace("rpm,", "spindle_speed_rpm,").replace("axial_depth_mm", " Axial_Depth_mm "),
        LOG.replace(",1,", ",stable,").replace(",0,", ",chatter,"),
        "\n".join(f"{line},{word}" for line, word in zip(LOG.splitlines(), ("note", "a", "b"), strict=True)),
    ],
)
def test_spreadsheets_write_it_in_many_ways(write, text):
    plain = [(c.spindle_speed, c.axial_depth, c.stable, c.radial_depth) for c in read_cuts_log(write(LOG))]
    assert [(c.spindle_speed, c.axial_depth, c.stable, c.radial_depth) for c in read_cuts_log(write(text))] == plain


def test_three_columns_are_enough(write):
    (cut,) = read_cuts_log(write("stable,rpm,axial_depth_mm\n1,9000,2\n"))
    assert cut.radial_depth is cut.direction is cut.power is None
    found, notices = cuts_on_map([cut], write(LOG), **MAP)
    assert found.axial_depth == pytest.approx([2e-3])
    assert notices == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds nothing"),
        (LOG.replace("stable", "good"), "line 1: no column stable"),
        (LOG.split("\n", 1)[1], "line 1: no column rpm, axial_depth_mm, stable"),
        (LOG.replace("8400", "fast"), "line 3, rpm: 'fast' is no number"),
        (LOG.replace("8400", ""), "line 3, rpm: is blank"),
        (LOG.replace("2.0", "-2"), "line 3, axial_depth_mm: -2 is not above 0"),
        (LOG.replace(",0,", ",2,"), "line 3, stable: '2' is neither 1 nor 0"),
        (LOG.replace("0.8,0.08,0", "0;8,0.08,0"), "line 3, radial_depth_mm: '0;8' is no number"),
        (LOG.replace("310", "310,5,6"), "line 2: 10 cells under 8 columns"),
        (LOG.replace("M_um", "rpm"), "two columns are rpm"),
        (LOG.replace("M_um", "direction").replace("0.6", "climb"), "line 2, direction: 'climb' is none of up, down"),
    ],
)
def test_what_is_wrong_is_told_with_its_line_and_column(write, text, says):
    with pytest.raises(RecordingError) as refused:
        read_cuts_log(write(text))
    assert says in str(refused.value)
    assert "cuts.csv" in str(refused.value)


def test_a_log_that_is_absent_is_said(tmp_path):
    with pytest.raises(RecordingError, match=r"none.csv: no such file or directory; check the path of the cuts log"):
        read_cuts_log(tmp_path / "none.csv")


def test_cuts_of_another_engagement_or_without_a_verdict_are_left_out_and_told(write):
    more = "8000,1,2.4,0.08,1,,,\n8000,1,0.8,0.08,,,,\n"
    path = write((LOG + more).replace("power_W", "direction").replace("310", "up"))
    found, notices = cuts_on_map(read_cuts_log(path), path, **MAP)
    assert found.spindle_speed == pytest.approx([8400 * RPM])
    assert found.stable == pytest.approx([0])
    assert {notice.code: notice.message[:6] for notice in notices} == {
        "tests-left-out": "2 rows",
        "tests-not-judged": "1 row ",
    }


def test_numbers_that_are_right_in_another_unit_are_told(write):
    def told(rows):
        path = write("rpm,axial_depth_mm,stable\n" + rows)
        return [notice.message for notice in cuts_on_map(read_cuts_log(path), path, **MAP)[1]]

    assert told("9000,1,1\n150,0.02,0\n") == []
    (speeds,) = told("150,1,1\n170,2,0\n")
    assert "no rpm is above 170; if these are Hz" in speeds
    (depths,) = told("9000,0.001,1\n9000,0.002,0\n")
    assert "no axial_depth_mm is above 0.002; if these are m" in depths


def test_a_log_of_which_nothing_belongs_on_the_map_is_refused(write):
    path = write(LOG)
    with pytest.raises(
        RecordingError, match=r"none of its cuts belongs on this map of down, 3 mm; they have radial depth 0.8"
    ):
        cuts_on_map(read_cuts_log(path), path, radial_depth=3e-3, direction="down")
    path = write(LOG.replace(",1,0.6", ",,0.6").replace(",0,41", ",,41"))
    with pytest.raises(RecordingError, match="no cut in it is judged"):
        cuts_on_map(read_cuts_log(path), path, **MAP)


def test_a_row_deeper_than_any_cutter_is_told_with_its_line(tmp_path):
    path = tmp_path / "cuts.csv"
    path.write_text("rpm,axial_depth_mm,stable\n9000,1.5,1\n10800,1500,0\n")
    told = [
        (notice.where, notice.message)
        for notice in cuts_on_map(read_cuts_log(path), path, **MAP, diameter=16e-3)[1]
        if notice.code == "tests-unit"
    ]
    assert told == [
        (f"{path}: line 3", "axial_depth_mm: 1500 is more than 10 diameters; if it is in um, divide by 1000")
    ]
