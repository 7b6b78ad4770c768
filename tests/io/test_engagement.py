"""Engagement tables as people write them, and as they get them wrong; the keys that name them."""

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.errors import RecipeError, RecordingError
from millcal.io.engagement import completed, read_engagement
from millcal.io.keys import ConditionsTable
from millcal.io.recipes import read_recipe, read_setup
from millcal.io.recordings import read_recording, write_recording
from millcal.physics.cutter import Cutter

HEADER = "s_mm,axial_depth_mm,entry_deg,exit_deg,feed_direction_deg"
TABLE = f"{HEADER}\n0,1.5,113.6,180,0\n24,1.5,90,180,0\n24,2,90,180,45\n40.5,2,90,150,45\n"
CUTTER = Cutter(0.010, 2)


@pytest.fixture
def write(tmp_path):
    def written(text, name="path.csv"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


def test_a_table_is_read_in_si(write):
    found = read_engagement(write(TABLE))
    assert found.position == pytest.approx([0, 0.024, 0.024, 0.0405])
    assert found.axial_depth == pytest.approx([1.5e-3, 1.5e-3, 2e-3, 2e-3])
    assert np.degrees(found.entry) == pytest.approx([113.6, 90, 90, 90])
    assert np.degrees(found.leave) == pytest.approx([180, 180, 180, 150])
    assert np.degrees(found.feed_direction) == pytest.approx([0, 0, 45, 45])
    assert found.feed_per_tooth is None
    assert found.feed_rate is None
    assert found.name.endswith("path.csv")


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(line.replace(",", ";").replace(".", ",") for line in TABLE.splitlines()),
        "# from the CAM system\n" + TABLE.replace("24,2,", "# the corner\n24,2,"),
        TABLE.replace(HEADER, "s [mm],Axial depth [mm],Entry [deg],Exit [deg],Feed direction [deg]"),
        TABLE.replace(",", "\t").replace("\n", "\r\n"),
        "\n".join(",".join(reversed(line.split(","))) for line in TABLE.splitlines()) + "\n",
        "\n".join(line + (",remark" if i == 0 else ",straight") for i, line in enumerate(TABLE.splitlines())),
        "\ufeff" + TABLE,
    ],
    ids=["german", "remarks", "brackets", "tabs", "order", "words", "mark"],
)
def test_other_ways_to_write_it_read_alike(write, text):
    plain, other = read_engagement(write(TABLE)), read_engagement(write(text, "other.csv"))
    for column in ("position", "axial_depth", "entry", "leave", "feed_direction"):
        assert getattr(other, column) == pytest.approx(getattr(plain, column))


def test_a_feed_is_per_tooth_or_per_minute(write):
    lines = TABLE.splitlines()

    def with_feed(name, value):
        return "\n".join([f"{lines[0]},{name}", *(f"{line},{value}" for line in lines[1:])])

    assert read_engagement(write(with_feed("feed_per_tooth_mm", 0.08))).feed_per_tooth == pytest.approx([8e-5] * 4)
    assert read_engagement(write(with_feed("feed_mm_per_min", 600))).feed_rate == pytest.approx([0.01] * 4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (TABLE.replace("24,2,", "23,2,"), "line 4: s_mm goes back"),
        (TABLE.replace("40.5,2", "40.5,-2"), "line 5: axial_depth_mm is below 0"),
        (TABLE.replace("150", "190"), "line 5: an angle outside 0 to 180"),
        (TABLE.replace("90,150", "160,150"), "line 5: entry_deg is above exit_deg"),
        (TABLE.replace("40.5,2,90", "24,2,90"), "line 5: the third row at one place"),
        (TABLE.replace("0,1.5,113.6,180,0\n", "0,1.5,,180,0\n"), "line 2: '' is no number"),
        (TABLE.replace("exit_deg", "exit"), "unknown column 'exit'"),
        (TABLE.replace("exit_deg", "exit_mm"), "column 'exit_mm' is in mm; write it as exit_deg"),
        ("\n".join(line.rsplit(",", 1)[0] for line in TABLE.splitlines()), "no column feed_direction_deg"),
        (f"{HEADER}\n0,1.5,113.6,180,0\n", "1 rows of numbers"),
        (TABLE.replace("180,0\n24,2", "180\n24,2"), "line 3: not as many cells"),
        (TABLE.replace("150,45", "150"), "line 5: 4 cells under 5 columns"),
        (f"{HEADER},feed_mm_per_min\n0,1,90,180,0,500\n9,1,90,180,0,0\n", "line 3: the feed is not above 0"),
        (f"{HEADER},feed_mm_per_min,feed_per_tooth_mm\n0,1,90,180,0,5,1\n9,1,90,180,0,5,1\n", "both say the feed"),
        (f"{HEADER}\n5,1,90,180,0\n5,1,90,180,0\n", "line 3: all rows are at 5 mm"),
    ],
)
def test_what_is_wrong_is_told_with_its_line_and_its_mending(write, text, says):
    with pytest.raises(RecordingError) as refused:
        read_engagement(write(text))
    assert says in str(refused.value)
    assert "path.csv" in str(refused.value)


def test_a_table_that_is_absent_is_said(tmp_path):
    with pytest.raises(RecordingError, match=r"none.csv: no such file or directory; check the path"):
        read_engagement(tmp_path / "none.csv")


def test_the_table_completes_the_conditions(write):
    path = read_engagement(write(TABLE))
    keys = completed(ConditionsTable(spindle_speed_rpm=3000, feed_per_tooth_mm=0.1, axial_depth_mm=9.0), path, CUTTER)
    assert keys.trouble(CUTTER) is None
    assert keys.axial_depth_mm == pytest.approx(2.0)
    assert keys.radial_depth_mm == pytest.approx(5.0)
    assert keys.direction == "down"
    up = read_engagement(write(f"{HEADER}\n0,1,0,60,0\n9,1,0,60,0\n", "up.csv"))
    assert completed(ConditionsTable(), up, CUTTER).direction == "up"
    slot = read_engagement(write(f"{HEADER}\n0,1,0,180,0\n9,1,0,180,0\n", "slot.csv"))
    assert completed(ConditionsTable(), slot, CUTTER).direction == "slot"
    assert completed(ConditionsTable(direction="down"), up, CUTTER).direction == "down"  # what is stated stays


RECIPE = """
[cutter]
diameter_mm = 10
teeth = 2
[conditions]
spindle_speed_rpm = 3000
feed_per_tooth_mm = 0.1
engagement = "path.csv"
path_start_s = 0.4
[[cuts]]
recording = "a.h5"
spindle_phase_deg = 90
[[cuts]]
recording = "b.h5"
engagement = "other.csv"
path_start_s = 0.7
"""


def test_a_recipe_names_tables_for_all_cuts_and_for_one(write, tmp_path):
    write(TABLE)
    write(TABLE.replace(",2,", ",3,"), "other.csv")
    recipe = read_recipe(write(RECIPE, "recipe.toml"))
    first, second = recipe.cuts
    assert first.conditions.axial_depth == pytest.approx(2e-3)
    assert first.spindle_phase == pytest.approx(np.pi / 2)
    assert (first.path_start, second.path_start) == (0.4, 0.7)
    assert second.engagement.axial_depth.max() == pytest.approx(3e-3)
    assert second.spindle_phase is None
    assert set(recipe.recordings) == {tmp_path / name for name in ("a.h5", "b.h5", "path.csv", "other.csv")}


def test_a_recipe_whose_table_is_absent_can_still_be_read_and_skipped(write):
    recipe = read_recipe(write(RECIPE, "recipe.toml"))
    assert recipe.cuts[0].engagement is None
    assert recipe.cuts[0].table.name == "path.csv"


def test_a_recording_takes_the_table_from_a_setup_and_keeps_it(write, tmp_path):
    write(TABLE)
    text = RECIPE.split("[[cuts]]")[0] + "spindle_phase_deg = 30\n"
    setup = read_setup(write(text, "setup.toml"))
    samples = np.random.default_rng(0).normal(size=(1, 50))
    bare = Recording(samples=samples, sample_rate=1e3, channels=(Channel("fx", "force", "N", "tipX"),))
    write_recording(tmp_path / "bare.h5", bare)
    found = read_recording(tmp_path / "bare.h5", setup=setup)
    assert found.engagement.span == pytest.approx((0, 0.0405))
    assert found.path_start == 0.4
    assert found.spindle_phase == pytest.approx(np.pi / 6)
    assert found.conditions.axial_depth == pytest.approx(2e-3)
    write_recording(tmp_path / "told.h5", found)
    again = read_recording(tmp_path / "told.h5")
    assert again.engagement.axial_depth == pytest.approx(found.engagement.axial_depth)
    assert (again.path_start, again.spindle_phase) == pytest.approx((0.4, np.pi / 6))
    assert again.conditions == found.conditions


def test_a_setup_with_half_the_conditions_says_what_is_missing(write):
    write(TABLE)
    with pytest.raises(RecipeError, match=r"feed_per_tooth_mm: is missing"):
        read_setup(write(RECIPE.split("[[cuts]]")[0].replace("feed_per_tooth_mm = 0.1\n", ""), "setup.toml"))
