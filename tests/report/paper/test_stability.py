"""The stability map for print shows what the record holds."""

from dataclasses import replace

import numpy as np
import pytest
import stability_maps
from stability_maps import RPM

from millcal.report.paper import sheet
from millcal.report.paper.stability import PURPLE, bifurcation, comparison, stability_file, stability_map


def test_best_speeds_stand_on_the_map_with_their_numbers(stability):
    with sheet.style():
        upper = stability_map(stability).axes[0]
    assert [text.get_text() for text in upper.texts] == ["1", "2", "3"]
    assert max(best.axial_depth for best in stability.best) * 1e3 < upper.get_ylim()[1]


def test_the_limit_is_drawn_as_it_is(stability):
    with sheet.style():
        line = stability_map(stability).axes[0].lines[0]
    finite = np.isfinite(stability.limit_depth)
    inside = finite & (stability.limit_depth < 10e-3)
    np.testing.assert_allclose(line.get_ydata()[inside], stability.limit_depth[inside] * 1e3)


def test_the_chatter_frequency_is_not_joined_from_lobe_to_lobe(stability):
    with sheet.style():
        line = stability_map(stability).axes[1].lines[0]
    leaps = np.count_nonzero(np.diff(stability.lobe))
    assert leaps > 2
    assert np.count_nonzero(np.isnan(line.get_xdata())) == leaps


def test_a_map_without_any_limit_can_be_drawn(figures):
    assert len(figures["without any limit: stability-map"].axes) == 2


def test_kinds_of_limit_differ_in_style_and_an_island_is_closed():
    with sheet.style():
        upper = stability_map(stability_maps.with_islands()).axes[0]
    styles = {(line.get_color(), line.get_linestyle()) for line in upper.lines if line.get_zorder() == 3}
    assert len({style for _, style in styles}) == len(styles) == 2
    flips = [line.get_xydata() for line in upper.lines if line.get_zorder() == 3 and line.get_linestyle() == "--"]
    lone = [xy for xy in flips if np.all(np.abs(xy[:, 0] - 9340) < 150)]
    ends = sorted(map(tuple, [xy[end] for xy in lone for end in (0, -1)]))
    assert ends[0] == pytest.approx(ends[1])
    assert ends[-1] == pytest.approx(ends[-2])


def test_probabilities_have_a_shade_each_in_the_legend():
    with sheet.style():
        figure = stability_map(stability_maps.probable())
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [text for text in texts if text.startswith("stable with")] == [
        f"stable with > {share} %" for share in (5, 25, 50, 75, 95)
    ]


def test_simulated_periods_are_marked_with_their_number():
    with sheet.style():
        figure = stability_map(stability_maps.tried())
    markers = {line.get_marker() for line in figure.axes[0].lines}
    assert {"$2$", "$3$", "s", "1", "o", "x"} <= markers
    assert "_" not in {line.get_marker() for line in figure.axes[0].lines if line.get_color() == PURPLE}  # as a tick


def test_the_zero_order_limit_is_dashed_beside_the_others_and_the_time_domain_points():
    with sheet.style():
        figure = comparison(stability_maps.compared())
    legend = figure.legends[0]
    handles = dict(zip((t.get_text() for t in legend.get_texts()), legend.legend_handles, strict=True))
    assert handles["Floquet: Hopf limit"].get_linestyle() == "-"
    assert handles["Floquet: flip limit"].get_color() == sheet.MODEL != handles["zero-order"].get_color()
    assert handles["zero-order"].get_linestyle() == "--"
    assert handles["time domain"].get_marker() == "o"


def test_only_a_map_with_samples_has_a_picture_of_them():
    with sheet.style():
        assert bifurcation(stability_maps.with_islands()) is None
        axes = bifurcation(stability_maps.tried()).axes[0]
    assert axes.get_ylabel() == "displacement (µm)"


def test_a_file_of_the_map_is_that_of_the_methods_where_others_are_given():
    first, *others = stability_maps.compared()
    alone, together = stability_file(first, "svg"), stability_file(first, "svg", others=others)
    assert alone.startswith(b"<?xml")
    assert alone != together == stability_file(first, "svg", others=others)


def test_a_chatter_frequency_of_one_speed_alone_is_a_dot():
    map_ = stability_maps.with_islands(26)
    some = np.arange(26) % 5 == 0
    lone = replace(map_, chatter_frequency=np.where(some, map_.chatter_frequency, np.nan))
    with sheet.style():
        lower = stability_map(lone).axes[1]
    dots = [line.get_xydata() for line in lower.lines if line.get_marker() == "."]
    assert sum(len(xy) for xy in dots) == np.count_nonzero(some)


def test_a_margin_has_an_end_stroke_only_where_it_ends_within_the_map():
    map_ = stability_maps.with_islands()
    open_ended = replace(map_.operating, speed_margin=(700 * RPM, np.inf), limit=np.inf)
    with sheet.style():
        axes = stability_map(replace(map_, operating=open_ended)).axes[0]
        texts = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    (lying,) = [line for line in axes.lines if line.get_marker() == "|" and len(line.get_xdata())]
    low, high = axes.get_xlim()
    assert low < lying.get_xdata()[0] == pytest.approx(8200)
    assert lying.get_xdata()[1] > high + 0.05 * (high - low)
    (top,) = [line.get_ydata()[0] for line in axes.lines if line.get_marker() == "_"]
    assert top > 1.2 * axes.get_ylim()[1]
    assert "it may move so far" in texts


def test_methods_side_by_side_keep_what_was_asked_and_advised_and_show_which_side_is_stable():
    zero_order, exact, *others = stability_maps.compared()
    with sheet.style():
        figure = comparison([exact, zero_order, *others])
        axes = figure.axes[0]
        deep = replace(exact, best=tuple(replace(best, axial_depth=90e-3) for best in exact.best))
        beyond = comparison([deep, zero_order]).axes[0]
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"best speeds, Floquet", "operating point", "Floquet: stable"} <= set(texts)
    assert [text.get_text() for text in axes.texts] == ["1", "2"]
    assert {"X", "D"} <= {line.get_marker() for line in axes.lines}
    assert len(axes.collections) > 0
    assert not beyond.texts  # none is drawn above the picture


def test_an_operating_point_beside_the_map_is_not_drawn():
    map_ = stability_maps.with_islands()
    beside = replace(map_.operating, spindle_speed=20000 * RPM)
    with sheet.style():
        figure = stability_map(replace(map_, operating=beside))
    assert "X" not in {line.get_marker() for line in figure.axes[0].lines}
    assert "operating point" not in [text.get_text() for text in figure.legends[0].get_texts()]


def test_simulated_cuts_that_differ_from_the_map_have_a_ring():
    map_ = stability_maps.tried()
    with sheet.style():
        figure = stability_map(map_)
    assert "simulated otherwise than mapped" in [text.get_text() for text in figure.legends[0].get_texts()]
    rings = [line for line in figure.axes[0].lines if line.get_marker() == "h" and line.get_markersize() == 6.5]
    assert sum(len(line.get_xdata()) for line in rings) == 1
