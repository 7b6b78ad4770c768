"""A stability map as JSON, as text and as a table: every crossing, islands, tests beside the map, methods side by side."""

import csv
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from millcal.data import BestSpeed, OperatingPoint, StabilityMap
from millcal.io.readable import text_of
from millcal.io.stability_readable import compared_text
from millcal.io.stability_summary import compared, summarise_stability
from millcal.io.stability_table import stability_table
from millcal.io.summaries import summarise

RPM = 2 * np.pi / 60


def zoa_map(limit=(2e-3, np.inf), **more):
    """Two speeds, 3000 and 6000 rpm, of the zero-order approximation; no limit at the second."""
    limit = np.array(limit)
    speeds, lost = np.array([3000 * RPM, 6000 * RPM]), np.isfinite(limit)
    frequency = np.where(lost, 800.0, np.nan)
    return StabilityMap(
        **{
            "spindle_speed": speeds, "limit_depth": limit, "chatter_frequency": frequency,
            "limit_kind": np.where(lost, 0, -1), "lobe": np.where(lost, 8, -1), "crossing_speed": speeds[lost],
            "crossing_depth": limit[lost], "crossing_kind": np.zeros(lost.sum()), "crossing_frequency": frequency[lost],
            "crossing_loses": np.ones(lost.sum()), "method": "zoa", "teeth": 2, "radial_depth": 1e-2, "diameter": 25e-3,
            "direction": "down", "feed_per_tooth": None, "absolute_minimum": 1e-3, "absolute_minimum_frequency": 810.0,
            "best": (BestSpeed(200 * np.pi, 2e-3, np.nan, None),), **more,
        }
    )  # fmt: skip


def test_a_map_lists_the_crossings_of_each_speed_and_none_where_there_is_no_limit():
    told = summarise(zoa_map(limit_low=np.array([1e-3, 5e-3]), limit_high=np.array([3e-3, np.inf])))
    assert told["limit"][0]["rpm"] == pytest.approx(3000)
    assert told["limit"][0]["crossings"] == [
        {"ap_mm": 2.0, "kind": "hopf", "chatter_hz": 800.0, "loses": True, "lobe": 8, "ap_mm_ci95": [1.0, 3.0]}
    ]
    assert told["limit"][1]["crossings"] == []
    assert told["best"][0]["mrr_cm3_per_min"] is None
    assert told["best"][0]["p_stable"] is None
    assert told["minimum"] == {"ap_mm": 1.0, "chatter_hz": 810.0}
    placed = summarise(zoa_map(absolute_minimum_speed=4500 * RPM))["minimum"]
    assert placed == {"ap_mm": 1.0, "chatter_hz": 810.0, "rpm": pytest.approx(4500)}
    assert told["deepest_mm"] is None


def test_an_island_of_stable_depths_above_the_first_limit_is_told(make_record):
    """Period doubling at 1.5 mm, its end at 1.8 mm, Hopf at 2.5 mm: stable again in between."""
    found = make_record("stability_map")
    kinds = [(c["kind"], c["ap_mm"], c["loses"]) for c in summarise(found)["limit"][3]["crossings"]]
    assert kinds == [("flip", 1.5, True), ("flip", pytest.approx(1.8), False), ("hopf", 2.5, True)]
    assert "1.800 to 2.500" in text_of(found)


def test_the_lobe_of_a_crossing_is_its_whole_waves_between_two_teeth(make_record):
    found = make_record("stability_map")
    first, *above = summarise(found)["limit"][3]["crossings"]
    assert first["lobe"] == found.lobe[3]  # as the method has counted
    for crossing in above:
        assert crossing["lobe"] == int(crossing["chatter_hz"] * 2 * np.pi / (found.teeth * 800.0))


def test_what_the_map_says_of_a_test_cut_is_read_off_the_record(make_record):
    """At the speed of the cut, which is none of the map's: by its nearest column this cut chatters."""
    found = make_record("stability_map")
    beside = replace(found.tests, spindle_speed=np.array([600.0, 790.0]), stable_by_map=np.array([1.0, 1.0]))
    told = summarise(replace(found, tests=beside))["tests"]
    assert [cut["stable_by_map"] for cut in told["cuts"]] == [True, True]
    assert (told["on_map"], told["as_mapped"]) == (2, 2)


def test_test_cuts_are_held_against_the_map(make_record):
    told = summarise(make_record("stability_map"))["tests"]
    assert [cut["stable_by_map"] for cut in told["cuts"]] == [True, False]
    assert (told["on_map"], told["as_mapped"]) == (2, 1)
    said = text_of(make_record("stability_map"))
    assert "cuts é.csv: 1 of 2 came out as the map says" in said
    assert "1.6 mm: stable, and the map says chatter" in said


def test_simulated_cuts_are_counted_by_their_period(make_record):
    said = text_of(make_record("stability_map"))
    assert re.search(
        r"simulated cuts: 3 at \d+ to \d+ rpm, [\d.]+( to [\d.]+)? mm; 1 repeat every tooth, 1 every 2 teeth", said
    )
    assert "1 never: chatter" in said


def test_a_cut_without_a_limit_says_so_in_words(make_record):
    point = OperatingPoint(700.0, 1e-3, np.inf, True, "", np.nan, (np.inf, np.inf), 1.0, (np.inf, 30.0))
    said = text_of(replace(make_record("stability_map"), operating=point, draws=1000))
    assert "1 mm: no limit found, stable with probability above 0.997" in said
    assert "before this depth chatters the speed may rise by 286 rpm" in said


@pytest.mark.parametrize(
    ("share", "draws", "words"),
    [(1.0, 60, "above 0.95"), (1.0, 2000, "above 0.998"), (0.0, 200, "below 0.015"), (0.5233, 60, "0.52"), (1.0, 4, "above 0.5")],
)  # fmt: skip
def test_a_probability_says_no_more_than_its_draws_bear(make_record, share, draws, words):
    """None of n draws: up to 3 / n by 95 %."""
    point = OperatingPoint(700.0, 1e-3, 2e-3, True, "hopf", 500.0, (1.5e-3, 3e-3), share)
    record = replace(make_record("stability_map"), operating=point, draws=draws)
    assert f"stable with probability {words}\n" in text_of(record)
    assert summarise_stability(record)["draws"] == draws


def test_a_margin_that_reaches_the_end_of_the_map_may_be_wider(make_record):
    point = OperatingPoint(700.0, 0.5e-3, 1e-3, True, "hopf", 810.0, speed_margin=(200.0, 100.0))  # the map is from 500
    said = text_of(replace(make_record("stability_map"), operating=point))
    assert "the speed may fall by 1910 or more rpm and rise by 955 rpm" in said


def test_one_of_a_thing_is_said_as_one(make_record):
    found = make_record("stability_map")
    assert ", 1 tooth, " in text_of(zoa_map(teeth=1))
    assert ", 2 teeth, " in text_of(zoa_map())
    for by_map, says in (([1.0, np.nan], "1 lies outside"), ([np.nan, np.nan], "2 lie outside")):
        tests = replace(found.tests, stable_by_map=np.array(by_map))
        assert f"  {says} the map" in text_of(replace(found, tests=tests))


def test_where_no_limit_was_found_the_text_names_no_depth():
    none = zoa_map((np.inf, np.inf), method="floquet", deepest=1e-3, absolute_minimum=np.inf, best=())
    said = text_of(none)
    assert said.splitlines()[0].endswith("at these speeds no limit was found, looked for down to 1.000 mm")
    assert "look deeper (--deepest-mm)" in said


def test_a_map_that_ends_above_every_limit_does_not_promise_what_it_did_not_look_for():
    first = text_of(zoa_map(deepest=1e-3, absolute_minimum=3.375e-3)).splitlines()[0]
    assert first.endswith("below 3.375 mm; the map goes down to 1.000 mm, where there is no limit yet")


def test_the_operating_point_says_what_to_do(make_record):
    point = summarise(make_record("stability_map"))["operating_point"]
    assert (point["stable"], point["kind"], point["advice"]) == (False, "hopf", ["less µ"])
    assert point["speed_margin_rpm"] == [None, pytest.approx(30 / RPM)]
    said = text_of(make_record("stability_map"))
    assert "chatters by hopf about 810 Hz" in said
    assert said.splitlines()[-1] != "  - less µ"  # the tests follow
    assert "  - less µ" in said.splitlines()


def test_the_best_speeds_as_text_are_those_of_the_safe_depth_or_of_the_limit_where_no_band_is_known(make_record):
    best = BestSpeed(200 * np.pi, 4e-3, 1e-5, 0.5, 3e-3)  # 600 cm^3/min at the limit
    found = replace(make_record("stability_map"), best=(best,))
    assert summarise(found)["best"][0]["safe_ap_mm"] == pytest.approx(3.0)
    header, row = _table_after(text_of(found), "best speeds")
    assert re.split(" {2,}", header.strip()) == ["rpm", "safe mm", "cm3/min", "limit mm", "p stable at limit"]
    assert [float(cell) for cell in row.split()] == pytest.approx([6000, 3.0, 450.0, 4.0, 0.5])
    header, row = _table_after(text_of(replace(found, best=(replace(best, safe_depth=None),))), "best speeds")
    assert "safe" not in header
    assert [float(cell) for cell in row.split()] == pytest.approx([6000, 4.0, 600.0])


def test_how_far_a_best_speed_may_be_off_stands_beside_it_where_it_is_known(make_record):
    best = BestSpeed(200 * np.pi, 4e-3, 1e-5, 0.5, 3e-3, speed_margin=120 * RPM)
    found = replace(make_record("stability_map"), best=(best,))
    assert summarise(found)["best"][0]["speed_margin_rpm"] == pytest.approx(120)
    header, row = _table_after(text_of(found), "best speeds")
    assert re.split(" {2,}", header.strip())[:3] == ["rpm", "+- rpm", "safe mm"]
    assert [float(cell) for cell in row.split()[:3]] == pytest.approx([6000, 120, 3.0])


def test_torque_and_power_stand_beside_the_best_speeds_where_they_are_known(make_record):
    best = BestSpeed(200 * np.pi, 4e-3, 1e-5, 0.5, 3e-3, torque=1.5, power=300 * np.pi)
    found = replace(make_record("stability_map"), best=(best,))
    told = summarise(found)["best"][0]
    assert told["power_W"] == pytest.approx(told["torque_Nm"] * told["rpm"] * RPM)
    header, row = _table_after(text_of(found), "best speeds")
    assert re.split(" {2,}", header.strip())[-2:] == ["N m", "W"]
    assert [float(cell) for cell in row.split()[-2:]] == pytest.approx([1.5, 942.5])


def test_methods_side_by_side_say_how_far_they_differ_and_where():
    one, other = zoa_map((2e-3, 1e-3)), zoa_map((2e-3, 4e-4), method="floquet", limit_kind=np.array([0, 1]))
    told = compared([one, other], one.spindle_speed)
    assert told["limit"][1]["floquet"] == {"ap_mm": pytest.approx(0.4), "kind": "flip"}
    (difference,) = told["difference"]
    assert difference["ratio"] == pytest.approx(0.4)
    assert difference["rpm"] == pytest.approx(6000)
    assert difference["beyond"] == 1
    said = compared_text([one, other])
    assert "0.4000 flip" in said
    assert "most at 6000 rpm: 2.5 times less deep" in said


def test_methods_are_set_side_by_side_at_one_speed_and_never_at_a_neighbours():
    one, other = zoa_map((2e-3, 1e-3)), zoa_map((2e-3, 4e-4), method="floquet")
    other = replace(other, spindle_speed=np.array([3000 * RPM, 6010 * RPM]))
    told = compared([one, other], one.spindle_speed)
    assert "floquet" in told["limit"][0]
    assert "floquet" not in told["limit"][1]
    (difference,) = told["difference"]
    assert (difference["speeds"], difference["beyond"]) == (1, 0)
    assert difference["ratio"] == pytest.approx(1)
    assert "more than 10 % at 0 of 1 speeds" in compared_text([one, other])


def test_no_limit_is_as_deep_as_was_looked():
    """A method that finds no limit above another's is not infinitely far from it."""
    one, other = zoa_map((2e-3, 4e-3), deepest=5e-3), zoa_map((2e-3, np.inf), method="floquet", deepest=5e-3)
    (difference,) = compared([one, other], one.spindle_speed)["difference"]
    assert difference["ratio"] == pytest.approx(1.25)


def test_the_table_has_a_line_for_each_crossing_and_one_for_a_speed_without(make_record):
    found = make_record("stability_map")
    lines = list(csv.DictReader(StringIO(stability_table(found))))
    assert len(lines) == len(found.crossing_depth) + 2  # two speeds have none
    depths = [float(line["ap_mm"]) * 1e-3 for line in lines if line["ap_mm"]]
    assert depths == pytest.approx(found.crossing_depth)
    limits = {float(line["rpm"]): line["limit_mm"] for line in lines}
    assert [float(limit or "inf") * 1e-3 for limit in limits.values()] == pytest.approx(found.limit_depth)
    assert [line["loses"] for line in lines if line["kind"] == "flip"] == ["1", "0"]


def _table_after(text, title):
    """The header and the first row of the table under a line that begins so."""
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith(title))
    return lines[at + 1 : at + 3]
