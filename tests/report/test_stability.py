"""What the page shows of a stability map: bounds by kind, probabilities, cuts made and simulated, methods side by side."""

import re
from dataclasses import replace

import numpy as np
import pytest
import stability_maps
from stability_maps import RPM

from millcal.data import Notice, OperatingPoint
from millcal.report.page import render
from millcal.report.stability_against import otherwise
from millcal.report.stability_comparison import comparison
from millcal.report.stability_figure import depth_drawn, leaps, lobes
from millcal.report.stability_samples import bifurcation, samples_of
from millcal.report.stability_section import key_numbers
from millcal.report.stability_tables import best_speeds, limits, map_facts, methods_compared
from millcal.report.stability_wording import operating_verdict, theory_verdict


def polylines(svg, kind):
    """The lines of a class, each as points (n, 2)."""
    found = re.findall(rf'<polyline class="line {kind}" points="([^"]*)"', svg)
    return [np.array([pair.split(",") for pair in points.split()], float) for points in found]


def key_of(figure):
    return " | ".join(text for _, text in figure.key)


@pytest.mark.parametrize("name", stability_maps.MAKERS)
def test_every_map_makes_a_page_without_numbers_that_are_none(name):
    html = render({"stability": stability_maps.MAKERS[name]()}, {}, {})
    seen = re.sub(r"<(script|style|textarea).*?</\1>|<[^>]*>", " ", html, flags=re.DOTALL)
    assert not re.search(r"\b(nan|inf|None)\b", seen)


@pytest.mark.parametrize("name", stability_maps.MAKERS)
def test_a_large_map_stays_small(name):
    map_ = stability_maps.MAKERS[name]()
    assert sum(len(svg) for svg in lobes(map_).charts) < 120_000
    large = replace(stability_maps.with_islands(8000), tests=map_.tests, simulated=map_.simulated)
    figure = lobes(large)
    assert len(figure.charts[0]) + len(figure.csv) < 300_000


def test_flips_have_a_line_of_their_own_and_the_key_says_so():
    figure = lobes(stability_maps.with_islands())
    assert polylines(figure.charts[0], "flip strong")
    assert "flip limit" in key_of(figure)
    alone = lobes(stability_maps.limit_alone())
    assert "flip" not in alone.charts[0]
    assert "limit: stable below, chatter above" in key_of(alone)


def test_the_drawn_limit_is_that_of_the_record():
    map_ = stability_maps.limit_alone()
    figure = lobes(map_)
    lines = np.concatenate(polylines(figure.charts[0], "main strong"))
    rpm = 4000 + 10000 * lines[:, 0] / (900 - 58 - 30)
    depth = (1 - lines[:, 1] / 300) * depth_drawn(map_)
    order = np.argsort(rpm, kind="stable")
    low = map_.limit_depth < 2.5e-3  # higher up a tenth of a pixel across is many upwards
    drawn = np.interp(map_.spindle_speed[low] / RPM, rpm[order], depth[order])
    assert np.abs(drawn - map_.limit_depth[low]).max() < depth_drawn(map_) / 300


def test_the_column_of_kinds_tells_where_a_flip_is_first():
    map_ = stability_maps.with_islands()
    columns = {column.name: column for column in lobes(map_).columns}
    rpm = columns["spindle speed"].values
    flips = columns["kind"].values == "flip"
    assert flips.any()
    assert np.all((np.abs(rpm[flips] - 9340) < 110) | (np.abs(rpm[flips] - 6900) < 190))


def test_probabilities_are_shaded_in_nested_levels_instead_of_a_band():
    figure = lobes(stability_maps.probable())
    assert len(re.findall(r'class="band chance"', figure.charts[0])) == 5
    assert 'class="band main"' not in figure.charts[0]
    assert "stable with more than 5, 25, 50, 75, 95 %" in key_of(figure)


def test_probabilities_that_are_all_one_or_all_zero_can_be_drawn():
    map_ = stability_maps.probable()
    for value in (0.0, 1.0):
        figure = lobes(replace(map_, probability=np.full_like(map_.probability, value)))
        assert len(re.findall(r'class="band chance"', figure.charts[0])) == (5 if value else 0)


def test_cuts_made_and_simulated_are_told_apart_by_shape():
    map_ = stability_maps.tried()
    figure = lobes(map_)
    svg = figure.charts[0]
    made = map_.tests.stable > 0
    inside = map_.tests.axial_depth <= depth_drawn(map_)
    for kind, shape, which in (("tested", "ring", made), ("failed", "cross", ~made)):
        drawn = re.search(rf'<g class="marks {shape} {kind}">(.*?)</g>', svg)[1]
        assert len(re.findall("<(?:circle|path)", drawn)) == np.count_nonzero(which & inside)
    periods = re.findall(r'class="note period"[^>]*>(\d+)<', svg)
    assert sorted(map(int, periods)) == sorted(map_.simulated.period[map_.simulated.period > 1].astype(int).tolist())
    assert "repeats every so many teeth" in key_of(figure)


def test_no_deeper_than_was_looked_is_shaded():
    map_ = stability_maps.with_islands()
    deeper = replace(map_, deepest=5e-3, operating=replace(map_.operating, axial_depth=6e-3))
    assert depth_drawn(deeper) == pytest.approx(8.1e-3)
    svg = lobes(deeper).charts[0]
    shaded = re.search(r'class="band stable" (?:points|d)="([^"]*)"', svg)[1]
    height = min(float(y) for y in re.findall(r",(-?[\d.]+)", shaded))
    assert height == pytest.approx(300 * (1 - 5 / 8.1), abs=0.1)


def test_the_chatter_frequency_is_not_joined_where_another_mode_rings():
    map_ = stability_maps.limit_alone()
    quiet = replace(map_, lobe=np.zeros(500), chatter_frequency=np.full(500, 900.0))
    assert len(leaps(quiet)) == 0
    other = np.where(np.arange(500) < 240, 900.0, 1100.0) + 0.1 * np.arange(500)
    assert leaps(replace(quiet, chatter_frequency=other)).tolist() == [240]


def test_samples_once_per_tooth_stand_with_the_bounds_of_the_map():
    map_ = stability_maps.tried()
    found = samples_of(map_)
    flips = sorted(at for at, kind in found.bounds if kind == 1)
    half = 110 * np.sqrt(1 - ((5 - 6.2) / 3.1) ** 2)
    assert flips == pytest.approx([9340 - half, 9340 + half], abs=8)
    assert found.along == "speed"
    assert "5 mm" in bifurcation(map_).caption
    assert bifurcation(stability_maps.with_islands()) is None


def test_samples_along_the_depth_have_the_depth_as_abscissa():
    map_ = stability_maps.tried()
    turned = replace(
        map_.simulated,
        bifurcation_speed=np.full(3600, 9340 * RPM),
        bifurcation_depth=np.linspace(1e-3, 11e-3, 3600),
    )
    found = samples_of(replace(map_, simulated=turned))
    assert found.along == "depth"
    assert sorted(at for at, kind in found.bounds if kind == 1) == pytest.approx([3.1, 9.3], abs=0.05)


def test_methods_have_lines_of_their_own_and_the_slow_one_points():
    maps = stability_maps.compared()
    figure = comparison(maps)
    for kind in ("by-floquet", "by-frf", "by-zoa"):
        assert polylines(figure.charts[0], kind)
    assert 'class="marks ring by-time-domain"' in figure.charts[0]
    assert key_of(figure).count("|") == 5
    assert len(figure.charts[0]) < 100_000
    assert comparison(maps[::-1]).charts == figure.charts


def test_methods_stand_side_by_side_where_both_have_the_speed():
    zoa, exact = stability_maps.limit_alone(), stability_maps.with_islands()
    few = replace(
        zoa,
        **{
            name: getattr(zoa, name)[::250]
            for name in ("spindle_speed", "limit_depth", "chatter_frequency", "limit_kind", "lobe")
        },
    )
    table = methods_compared([exact, few])
    told = {row[0]: row[2] for row in table.rows}
    assert told["4000"] == f"{zoa.limit_depth[0] * 1e3:.2f}"
    assert list(told.values()).count("–") > 5
    assert methods_compared([exact]) is None


def test_the_table_of_limits_says_where_it_is_stable_again():
    map_ = stability_maps.with_islands(points=301)
    table = limits(map_)
    row = next(row for row in table.rows if row[0] == "7000")
    assert "flip" in row
    low, high = (float(value) for value in row[-1].split(" to "))
    assert low == pytest.approx(3.2 + 1.3 * np.sqrt(1 - (100 / 190) ** 2), abs=0.006)
    assert high > low
    assert "stable again, mm" not in limits(stability_maps.limit_alone()).headings


def test_best_speeds_say_torque_and_power_where_they_are_known():
    map_ = stability_maps.with_islands()
    table = best_speeds(map_)
    assert list(table.headings[-2:]) == ["torque, N m", "power, kW"]
    assert table.rows[0][-2:] == ["3.10", "1.84"]
    without = replace(map_, best=tuple(replace(b, torque=None, power=None) for b in map_.best))
    assert "torque, N m" not in best_speeds(without).headings
    (_, first), *_ = [fact for fact in map_facts(stability_maps.tried()) if fact[0] == "cuts made"]
    assert re.fullmatch(r"\d+ stable, \d+ chatter", first)


def test_the_operating_point_is_told_with_its_margins_and_advice():
    map_ = stability_maps.with_islands()
    verdict = operating_verdict(map_)
    assert verdict.level == "good"
    assert "Deeper it chatters: period doubling, at 742.0 Hz." in verdict.text
    assert "the speed may fall by 700 rpm and rise by 1900 rpm." in verdict.text
    html = render({"stability": map_}, {}, {})
    assert "<li>Raise the speed by 150 rpm" in html
    assert html.count('class="whisker operating"') == 2


def test_a_margin_that_reaches_the_rim_of_the_map_is_told_as_such():
    map_ = stability_maps.with_islands()
    point = replace(map_.operating, speed_margin=(4900 * RPM, np.inf))
    told = operating_verdict(replace(map_, operating=point)).text
    assert "fall to the end of the map and rise to the end of the map" in told


def test_a_cut_in_a_pocket_beyond_the_limit_is_stable_and_warned_about():
    map_ = stability_maps.with_islands()
    point = OperatingPoint(7000 * RPM, 4.6e-3, 2.1e-3, True, "hopf", 930.0)
    verdict = operating_verdict(replace(map_, operating=point))
    assert verdict.level == "good"
    assert "pocket" in verdict.text
    chatter = operating_verdict(replace(map_, operating=replace(point, stable=False, kind="flip", axial_depth=3e-3)))
    assert chatter.level == "bad"
    assert "Expect period doubling" in chatter.text


def test_only_the_zero_order_limit_speaks_of_every_speed():
    assert "stable at every speed below 1.10 mm" in key_of(lobes(stability_maps.limit_alone()))
    assert "stable at every speed of the map below 1.10 mm" in key_of(lobes(stability_maps.with_islands()))


@pytest.mark.parametrize("code", ["flip-lobes", "zoa-unsafe"])
def test_nothing_is_green_where_the_zero_order_limit_may_promise_too_much(code):
    exact = stability_maps.with_islands()
    zero_order = replace(
        stability_maps.limit_alone(), operating=replace(exact.operating, p_stable=0.999), best=exact.best
    )
    assert operating_verdict(zero_order).level == "good"
    assert theory_verdict(zero_order) is None
    warned = replace(zero_order, notices=(Notice(code, "the zero-order limit is up to 6 times too deep"),))
    verdict = operating_verdict(warned)
    assert verdict.level == "part"
    assert verdict.head == ("Stable at 8900 rpm and 2.5 mm by the zero-order limit, which leaves out period doubling")
    assert theory_verdict(warned).level == "part"
    assert "up to 6 times too deep." in theory_verdict(warned).text
    assert [number["level"] for number in key_numbers(warned)] == ["part", "part"]
    assert 'class="verdict good"' not in render({"stability": warned}, {}, {})
    assert "leaves out period doubling" in lobes(warned).caption
    assert "leaves out period doubling" not in lobes(zero_order).caption
    chatters = replace(warned, operating=replace(warned.operating, stable=False, p_stable=0.01))
    assert operating_verdict(chatters).level == "bad"


def test_depths_beyond_any_cutter_are_told_as_such():
    map_ = stability_maps.with_islands()
    assert theory_verdict(map_) is None
    assert all("level" not in number for number in key_numbers(map_))
    slim = replace(map_, diameter=2e-3)  # its edges are no 8 mm long
    assert "hardly a cutter of 2 mm" in theory_verdict(slim).text
    _, best = key_numbers(slim)
    assert best["level"] == "part"
    assert "longer than a cutter's edges" in best["word"]
    assert operating_verdict(slim).level == "good"
    assert operating_verdict(replace(slim, diameter=0.5e-3)).level == "part"


def test_best_speeds_say_how_far_off_they_may_be():
    map_ = stability_maps.with_islands()
    assert "± rpm" not in best_speeds(map_).headings
    first, second = map_.best
    margins = replace(first, speed_margin=390 * RPM), replace(second, speed_margin=0.6 * RPM)
    table = best_speeds(replace(map_, best=margins))
    assert table.headings[2] == "± rpm"
    assert [row[2] for row in table.rows] == ["390", "below 1"]
    assert "nine tenths of the limit" in table.note
    assert "the least within 0.5 % of the speed" in table.note


def test_the_smallest_limit_is_told_with_its_speed_where_it_has_one():
    told = {speed: dict(map_facts(replace(stability_maps.with_islands(), absolute_minimum_speed=speed)))
            for speed in (8123 * RPM, np.nan)}  # fmt: skip
    assert " mm at 8123 rpm, chatter at " in told[8123 * RPM]["smallest limit"]
    assert "rpm" not in list(told.values())[1]["smallest limit"]


def test_a_limit_stands_beside_the_speed_at_which_it_was_found():
    """Four hundred speeds do not fall on round ones."""
    map_ = stability_maps.with_islands(points=400)
    table = limits(map_)
    assert "round" not in table.title
    own = {f"{speed / RPM:.0f}": depth * 1e3 for speed, depth in zip(map_.spindle_speed, map_.limit_depth, strict=True)}
    assert any(int(row[0]) % 100 for row in table.rows)
    assert all(row[1] == f"{own[row[0]]:.2f}" for row in table.rows if not row[1].startswith(">"))


def test_simulated_cuts_that_differ_from_the_map_are_ringed_and_counted():
    map_ = stability_maps.tried()
    cuts = map_.simulated
    chatter, stable = otherwise(map_)
    assert not stable.any()
    assert cuts.period[chatter].tolist() == [3]  # alone made otherwise than the map
    figure = lobes(map_)
    assert "Of 144 simulated cuts 1 chatters where the map is stable (ringed)" in figure.caption
    drawn = re.search(r'<g class="marks ring otherwise">(.*?)</g>', figure.charts[0])[1]
    assert drawn.count("<circle") == 1
    as_mapped = replace(map_, simulated=replace(cuts, period=np.where(chatter, 1, cuts.period)))
    assert "ringed" not in lobes(as_mapped).caption
    assert "otherwise" not in lobes(as_mapped).charts[0]
    assert not np.any(otherwise(replace(map_, method="time-domain")))


def test_methods_stand_over_what_the_most_exact_holds_for_stable():
    maps = stability_maps.compared()
    figure = comparison(maps)
    assert 'class="band stable"' in figure.charts[0]
    assert polylines(figure.charts[0], "by-flip")
    assert "Floquet multipliers: flip limit" in key_of(figure)
    assert "zero-order limit" in figure.caption
    assert "zero-order limit" not in comparison(maps[1:]).caption
