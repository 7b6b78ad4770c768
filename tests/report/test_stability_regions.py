"""Stable areas from crossings: what is stable by count is what is shaded, and islands and pockets close."""

from dataclasses import replace

import numpy as np
import pytest
import stability_maps

from millcal.report.stability_regions import (
    RIM,
    Stretch,
    areas,
    chances,
    edges,
    inner_crossings,
    simplified,
    stable_stretches,
    stretches_above,
    stretches_with_best,
)

HOPF, FLIP = 0, 1


def with_crossings(*columns):
    """A map with these crossings (depth, kind, loses) at each speed."""
    speeds = np.linspace(500, 600, len(columns))
    rows = [(speed, *crossing) for speed, column in zip(speeds, columns, strict=True) for crossing in column]
    found = np.array(rows, float).reshape(-1, 4)
    first = [min((d for d, _, loses in column if loses), default=np.inf) for column in columns]
    none = np.full(len(columns), np.nan)
    return replace(
        stability_maps.with_islands(),
        spindle_speed=speeds,
        limit_depth=np.array(first),
        limit_kind=np.where(np.isfinite(first), 0, -1),
        chatter_frequency=none,
        lobe=none,
        crossing_speed=found[:, 0],
        crossing_depth=found[:, 1],
        crossing_kind=found[:, 2],
        crossing_frequency=np.full(len(found), np.nan),
        crossing_loses=found[:, 3],
    )


def inside(found, x, y):
    """Whether a point lies in any of the areas."""
    return any(a.x[0] <= x <= a.x[-1] and np.interp(x, a.x, a.low) <= y <= np.interp(x, a.x, a.high) for a in found)


def test_multipliers_are_counted_a_pair_at_a_hopf_crossing_and_one_at_a_flip():
    overlapping = [(1.0, HOPF, 1), (1.5, FLIP, 1), (2.0, HOPF, 0), (3.0, FLIP, 0), (5.0, HOPF, 1)]
    (column,) = stable_stretches(with_crossings(overlapping))
    assert column == [Stretch(0, 1.0, RIM, HOPF), Stretch(3.0, 5.0, FLIP, HOPF)]


def test_a_pair_that_parts_on_the_real_axis_comes_back_one_by_one():
    (column,) = stable_stretches(with_crossings([(1.0, HOPF, 1), (2.0, FLIP, 0), (2.5, FLIP, 0)]))
    assert column == [Stretch(0, 1.0, RIM, HOPF), Stretch(2.5, np.inf, FLIP, RIM)]


def test_with_one_of_a_pair_back_inside_the_cut_still_chatters():
    (column,) = stable_stretches(with_crossings([(1.0, HOPF, 1), (2.0, FLIP, 0)]))
    assert column == [Stretch(0, 1.0, RIM, HOPF)]


def test_ends_of_the_stable_set_alone_are_taken_as_such():
    map_ = with_crossings([(1.0, HOPF, 1), (2.0, FLIP, 0), (3.0, HOPF, 1)])
    (column,) = stable_stretches(replace(map_, method="time-domain"))
    assert column == [Stretch(0, 1.0, RIM, HOPF), Stretch(2.0, 3.0, FLIP, HOPF)]


def test_without_crossings_the_limit_is_the_only_end():
    alone = replace(
        stability_maps.limit_alone(),
        **{f"crossing_{name}": np.empty(0) for name in ("speed", "depth", "kind", "frequency", "loses")},
    )
    stretches = stable_stretches(alone)
    assert [column[0].high for column in stretches] == alone.limit_depth.tolist()
    assert {len(column) for column in stretches} == {1}


@pytest.mark.parametrize("name", stability_maps.MAKERS)
def test_every_depth_lies_in_an_area_where_its_column_is_stable(name):
    map_ = stability_maps.MAKERS[name]()
    stretches = stable_stretches(map_)
    found = areas(map_.spindle_speed, stretches)
    rng = np.random.default_rng(3)
    for i in rng.choice(len(map_.spindle_speed), 60):
        for depth in 12e-3 * rng.random(5):
            stable = any(s.low < depth < s.high for s in stretches[i])
            assert inside(found, map_.spindle_speed[i], depth) == stable


def test_an_island_is_closed_by_edges_of_its_own_kind():
    (lone,) = [island for island in stability_maps.ISLANDS if island[0] == 9340]
    map_ = stability_maps.with_islands(2001, (lone,))
    flips = [e for e in edges(areas(map_.spindle_speed, stable_stretches(map_))) if e.kind == FLIP]
    ends = sorted((float(x), float(y)) for e in flips for x, y in ((e.x[0], e.y[0]), (e.x[-1], e.y[-1])))
    step = map_.spindle_speed[1] - map_.spindle_speed[0]
    for end, at in ((ends[:2], 9340 - 110), (ends[-2:], 9340 + 110)):
        assert end[0] == pytest.approx(end[1])  # the lower edge meets the upper
        assert end[0][0] == pytest.approx(at * stability_maps.RPM, abs=step)
        assert 5e-3 < end[0][1] < 7e-3


def test_areas_that_meet_share_their_ends():
    def column(*ends):
        return [Stretch(low, high, HOPF, HOPF) for low, high in ends]

    columns = [column((0, 9)), column((0, 3), (5, 9)), column((0, 4), (4.5, 9)), column((0, 9))]
    found = areas(np.arange(4.0), columns)
    assert len(found) == 4
    whole = sum(np.trapezoid(a.high - a.low, a.x) for a in found)
    assert whole == pytest.approx(27 - (0.5 * 2 / 2 + (2 + 0.5) / 2 + 0.5 * 0.5 / 2))
    assert sorted((a.x[0], a.x[-1]) for a in found) == [(0, 0.5), (0.5, 2.5), (0.5, 2.5), (2.5, 3)]


def test_a_steep_island_stays_one():
    columns = [[(1.0 + i, FLIP, 1), (1.4 + i, FLIP, 0)] for i in range(5)]
    map_ = with_crossings(*columns)
    found = areas(map_.spindle_speed, stable_stretches(map_))
    assert sorted(len(a.x) for a in found) == [5, 5]


def test_a_speed_without_a_limit_opens_the_area():
    map_ = with_crossings([(2.0, HOPF, 1)], [], [(3.0, HOPF, 1)])
    (area,) = areas(map_.spindle_speed, stable_stretches(map_))
    assert area.high.tolist() == [2.0, np.inf, 3.0]
    assert [e.y.tolist() for e in edges([area])] == [[2.0, np.inf], [np.inf, 3.0]]


def test_where_the_kind_changes_the_edges_meet():
    map_ = with_crossings([(2.0, HOPF, 1)], [(3.0, FLIP, 1)], [(4.0, FLIP, 1)])
    hopf, flip = edges(areas(map_.spindle_speed, stable_stretches(map_)))
    assert (hopf.x[-1], hopf.y[-1]) == (flip.x[0], flip.y[0]) == (525.0, 2.5)


def test_levels_of_a_probability_are_nested_and_end_where_it_passes_them():
    map_ = stability_maps.probable()
    smooth = chances(map_)
    heights = []
    for level in (0.05, 0.5, 0.95):
        columns = stretches_above(smooth, level)
        heights.append([sum(s.high - s.low for s in column) for column in columns])
        for k in (0, 70, 107):
            for s in columns[k]:
                for end, kind in ((s.low, s.below), (s.high, s.above)):
                    if kind != RIM:
                        assert np.interp(end, *smooth[k]) == pytest.approx(level)
    assert np.all(np.diff(heights, axis=0) <= 0)


def test_crossings_within_chatter_are_those_that_bound_nothing():
    map_ = stability_maps.with_islands()
    within = inner_crossings(map_, stable_stretches(map_))
    rpm = map_.crossing_speed[within] / stability_maps.RPM
    hidden = (np.abs(rpm - 12200) < 240) & (map_.crossing_kind[within] == FLIP)
    assert np.count_nonzero(hidden) == np.count_nonzero((map_.crossing_kind == FLIP) & (map_.crossing_speed > 1200))
    returning = with_crossings([(1.0, HOPF, 1), (2.0, FLIP, 0)])
    assert inner_crossings(returning, stable_stretches(returning)).tolist() == [1]
    of_the_cut = replace(returning, method="time-domain")
    assert len(inner_crossings(of_the_cut, stable_stretches(of_the_cut))) == 0


def test_a_simplified_line_stays_within_what_is_allowed():
    x = np.linspace(0, 10, 3000)
    y = np.sin(3 * x) + 0.3 * np.cos(17 * x)
    kept = simplified(x, y, 0.01, 1e-6 * x[-1])
    assert {0, 2999} <= set(kept.tolist())
    assert len(kept) < 600
    assert np.max(np.abs(np.interp(x, x[kept], y[kept]) - y)) < 0.05
    assert simplified(x, 2 * x, 0.01, 0.01).tolist() == [0, 2999]


def test_a_probability_that_leaps_between_two_depths_does_so_where_the_map_has_its_bound():
    map_ = stability_maps.with_islands(200)
    depth = np.linspace(0.5e-3, 12e-3, 24)  # coarse
    stable = np.array(
        [[any(s.low < d < s.high for s in column) for column in stable_stretches(map_)] for d in depth], float
    )
    sharp = replace(map_, probability=stable, probability_depth=depth)
    for level in (0.05, 0.5, 0.95):
        found = stretches_above(chances(sharp), level)
        for i, column in enumerate(stable_stretches(map_)):
            if depth[0] < column[0].high < depth[-1]:
                assert found[i][0].high == pytest.approx(column[0].high, rel=1e-5)
    banded = replace(sharp, limit_low=0.99 * map_.limit_depth, limit_high=1.01 * map_.limit_depth)
    steps = [stretches_above(chances(banded), level) for level in (0.95, 0.5, 0.05)]
    inside = [i for i in range(200) if depth[0] < map_.limit_depth[i] * 0.99 and map_.limit_depth[i] % 0.5e-3 > 0.1e-3]
    low, _, high = ([column[i][0].high for i in inside if map_.limit_depth[i] < 4e-3] for column in steps)
    ratio = np.array(high) / np.array(low)
    assert np.median(ratio) == pytest.approx((1 + 0.01 * 45 / 47.5) / (1 - 0.01 * 45 / 47.5), abs=1e-4)


def test_a_best_speed_between_two_columns_is_a_top_of_the_line():
    coarse = with_crossings([(1.0, HOPF, 1)], [(2.0, HOPF, 1)], [(1.5, FLIP, 1), (4.0, FLIP, 0), (6.0, HOPF, 1)])
    best = coarse.best[0]

    def drawn(speed, depth):
        return stretches_with_best(replace(coarse, best=(replace(best, spindle_speed=speed, axial_depth=depth),)))

    speeds, columns = drawn(570, 3.0)
    np.testing.assert_allclose(speeds, [500, 550, 570, 600])
    assert columns[2] == [Stretch(0, 3.0, RIM, HOPF)]
    assert [line.y[line.x == 570].tolist() for line in edges(areas(speeds, columns)) if 570 in line.x] == [[3.0]]
    assert len(drawn(580, 3.0)[1][2]) == 2  # nearer to the column with a pocket
    for speed, depth in ((550, 2.0), (570, 1.0), (570, np.inf), (700, 9.0)):  # known, no top, no limit, beyond the rim
        assert len(drawn(speed, depth)[0]) == 3


def test_the_smallest_limit_between_two_speeds_is_drawn():
    map_ = with_crossings([(2.0, HOPF, 1)], [(1.4, FLIP, 1), (3.0, FLIP, 0), (3.5, HOPF, 1)], [(1.2, HOPF, 1)])
    deep = replace(map_, best=(), absolute_minimum=1.0, absolute_minimum_speed=580.0)
    speeds, columns = stretches_with_best(deep)
    assert speeds.tolist() == [500, 550, 580, 600]
    assert columns[2] == [Stretch(0, 1.0, RIM, HOPF)]
    (line,) = [edge for edge in edges(areas(speeds, columns)) if edge.kind == HOPF and 580 in edge.x]
    assert line.y[line.x == 580] == 1.0
    unknown = replace(deep, absolute_minimum_speed=np.nan)
    assert stretches_with_best(unknown)[0].tolist() == [500, 550, 600]
