"""Five recorded slot cuts (DynoWare, 10 kHz, 6000 rpm, two teeth), where they are at hand: figures found independently."""

import os
from pathlib import Path

import numpy as np
import pytest

from millcal.data import AXES
from millcal.io.recipes import Setup
from millcal.io.recordings import read_recording
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.stages.conditioning import condition_cut

FOLDER = Path(os.environ.get("MILLCAL_REFERENCE_DATA", "")) / "real" / "dynoware_slot_al"
FEEDS = (300, 600, 900, 1200, 1500)  # mm/min
AXIAL_DEPTH, TEETH = 3e-3, 2

pytestmark = pytest.mark.skipif(
    not os.environ.get("MILLCAL_REFERENCE_DATA") or not FOLDER.is_dir(),
    reason="the recorded slot cuts are not here; MILLCAL_REFERENCE_DATA names their folder",
)


@pytest.fixture(scope="module")
def cuts():
    found = {}
    for feed in FEEDS:
        setup = Setup(
            map={"fx": "+Fy", "fy": "+Fx", "fz": "+Fz"},
            acts_on="tool",
            cutter=Cutter(25e-3, TEETH, np.pi / 4),
            conditions=CuttingConditions(200 * np.pi, feed / 60e3 / 200, AXIAL_DEPTH, 25e-3, "slot"),
        )
        found[feed] = condition_cut(read_recording(FOLDER / f"6-n6000f{feed}ap3ae25.csv", setup=setup))
    return found


def coefficients(feeds, means):
    """Ktc Krc Kac (N/mm^2), Kte Kre Kae (N/mm) of the mean forces of a full slot.   means : (cut, axis) N"""
    slope, level = np.polyfit(np.array(feeds) / 60 / 200, np.array(means), 1)
    a = 1e3 * AXIAL_DEPTH
    x, y, z = (TEETH * a / 4, TEETH * a / 4, TEETH * a / np.pi)
    return [
        *(slope[1] / y, -slope[0] / x, slope[2] / z),
        *(level[1] * np.pi / (TEETH * a), -level[0] * np.pi / (TEETH * a), level[2] * 2 / (TEETH * a)),
    ]


def test_the_record_is_all_cut_and_holds_a_hundred_revolutions(cuts):
    for cut in cuts.values():
        assert cut.steady == pytest.approx((0.0, 1.0001))
        assert cut.revolutions == 100
        assert "no-air-cut" in {notice.code for notice in cut.notices}


def test_means_of_all_rows_are_the_published_ones(cuts):
    published = {  # tool x = dyno Fy, tool y = dyno Fx
        300: (-39.797, 63.018, 55.721),
        600: (-60.053, 107.138, 70.909),
        900: (-71.605, 137.673, 82.574),
        1200: (-76.747, 171.268, 85.227),
        1500: (-78.487, 210.739, 83.504),
    }
    for feed, means in published.items():
        assert cuts[feed].mean_all_rows == pytest.approx(means, abs=6e-4)


def test_mean_forces_give_the_published_coefficients_by_all_rows_and_by_whole_revolutions(cuts):
    by_rows = coefficients(FEEDS, [cuts[feed].mean_all_rows for feed in FEEDS])
    assert by_rows == pytest.approx([958.8599, 250.8633, 146.3614, 15.7580, 19.4337, 18.2075], abs=6e-5)
    whole = coefficients(FEEDS, [cuts[feed].harmonics[:, 0].real for feed in FEEDS])
    assert whole == pytest.approx([958.8230, 251.0634, 146.3910, 15.7534, 19.4242, 18.2056], abs=6e-5)


def test_spindle_frequency_to_a_thousandth_of_a_hertz(cuts):
    expected = dict(zip(FEEDS, (99.9960, 99.9955, 99.9957, 99.9969, 99.9928), strict=True))
    for feed, frequency in expected.items():
        assert cuts[feed].spindle_frequency == pytest.approx(frequency, abs=1e-3)
        assert cuts[feed].spindle_frequency_sd < 1e-3


@pytest.mark.parametrize(
    ("feed", "share", "band"),
    [
        (300, (99.76, 99.77, 99.11), 0.1),
        (600, (99.88, 99.87, 98.73), 0.1),
        (900, (99.89, 99.85, 97.81), 0.1),
        (1200, (98.87, 98.57, 92.73), 0.5),
        (1500, (98.07, 96.56, 89.57), 0.5),
    ],
)
def test_share_of_the_power_that_follows_the_spindle(cuts, feed, share, band):
    assert 100 * cuts[feed].synchronous_share == pytest.approx(share, abs=band)


def test_ac_and_asynchronous_rms_of_the_weakest_and_the_strongest_cut(cuts):
    assert cuts[300].ac_rms == pytest.approx([84, 87, 36], abs=0.5)
    assert cuts[300].asynchronous_rms == pytest.approx([4.1, 4.2, 3.4], abs=0.06)
    assert cuts[1500].ac_rms == pytest.approx([242, 235, 41], abs=0.5)
    assert cuts[1500].asynchronous_rms == pytest.approx([33.6, 43.6, 13.4], abs=0.1)


def test_the_once_per_revolution_line_is_that_of_runout_and_does_not_grow_with_feed(cuts):
    for feed in FEEDS:
        once = np.abs(cuts[feed].harmonics[:2, 1])
        assert once.min() > 60
        assert once.max() < 95


def test_chatter_lines_at_the_highest_feed_stand_one_tooth_passing_apart(cuts):
    lines = {axis: [peak.frequency for peak in cuts[1500].peaks if peak.axis == axis] for axis in AXES}
    for axis, frequency in (("y", 974.5), ("y", 775.0), ("y", 189.0), ("x", 389.0), ("z", 974.5)):
        assert min(abs(np.array(lines[axis]) - frequency)) < 1.0, (axis, frequency)
    assert min(abs(np.array([p.frequency for p in cuts[1200].peaks if p.axis == "y"]) - 790)) < 1.0
    told = {feed for feed in FEEDS if "chatter-lines" in {notice.code for notice in cuts[feed].notices}}
    assert told == {1200, 1500}


def test_nothing_else_is_made_up(cuts):
    for feed in (300, 600, 900):
        codes = {notice.code for notice in cuts[feed].notices}
        assert codes <= {"no-air-cut", "asynchronous"}
