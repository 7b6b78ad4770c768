"""What the page shows of modes: tables, curves, the stabilisation chart and the shapes."""

import dataclasses
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest
from modal_fits import cut_off, single, six_by_three

from millcal.data import Modes
from millcal.report import modal_figures, modal_tables
from millcal.report.modal_curves import (
    cross_pairs,
    driving_pairs,
    fitted_pair,
    magnitudes_drawn,
    share,
    taken_away,
)
from millcal.report.page import render

MADE = {maker.__name__: maker() for maker in (six_by_three, single, cut_off)}


@pytest.fixture(params=MADE)
def modes(request) -> Modes:
    return MADE[request.param]


def seen(html: str) -> str:
    """The text of a page, without script and style, in one line."""

    class Reader(HTMLParser):
        inside, words = "", []

        def handle_starttag(self, tag, attributes):
            self.inside = tag

        def handle_data(self, data):
            if self.inside not in ("script", "style", "textarea"):
                self.words.append(data)

    reader = Reader()
    reader.words = []
    reader.feed(html)
    return " ".join(" ".join(reader.words).split())


def section_of(html: str) -> str:
    return html[html.index('<section id="modes">') :].partition("</section>")[0]


def test_a_page_of_modes_shows_nothing_unknown_as_nan_and_every_figure_with_its_numbers(modes):
    html = render({"modes": modes}, {}, {})
    assert not re.search(r"\b(nan|inf|None|undefined)\b", seen(html))
    assert "nan" not in section_of(html)
    assert html.count("<figure") == html.count('class="csv"') > 0
    assert render({"modes": modes}, {}, {}) == html


def test_with_all_records_the_page_stays_small_and_its_ids_are_unique(results):
    html = render({**results, "modes": MADE["six_by_three"]}, {}, {})
    ids = re.findall(r' id="([^"]*)"', html)
    assert len(ids) == len(set(ids))
    assert html.index('id="frf"') < html.index('id="modes"') < html.index('id="stability"')
    assert len(html.encode()) < 2_000_000


def test_the_numbers_of_a_mode_are_those_of_the_record_with_the_digits_of_their_intervals():
    modes = MADE["six_by_three"]
    row = modal_tables.modes(modes).rows[0]
    low, high = modes.interval(modes.frequency_estimate)[0]
    value, half = (float(part) for part in row[2].split(" ± "))
    assert value == pytest.approx(640.0)
    assert half == pytest.approx((high - low) / 2, rel=0.05)
    assert row[1] == "x"
    assert row[4] == "tipX"
    assert float(row[5].split(" ± ")[0]) == pytest.approx(modes.stiffness[0] / 1e6, rel=1e-3)


def test_a_mode_is_shown_where_it_is_softest():
    modes = MADE["six_by_three"]
    table = modal_tables.modes(modes)
    k = np.stack([modes.driving_constants(*pair).stiffness.value for pair in modes.fit.driving_points.values()])
    assert [row[4] for row in table.rows] == ["tipX", "tipY", "tipX", "tipY", "tipX"]
    for row, softest in zip(table.rows, np.nanmin(k, axis=0), strict=True):
        assert float(row[5].split(" ± ")[0]) == pytest.approx(softest / 1e6, rel=1e-2)


def test_a_stiffness_that_no_structure_has_is_a_dash_and_one_without_a_high_end_says_over():
    table = modal_tables.stiffness(MADE["six_by_three"])
    assert table.rows[1][3] == "–"
    assert "below zero" in table.note
    assert re.fullmatch(r"over \d+", table.rows[0][3])
    assert "hardly moves" in table.note


def test_one_driving_point_has_no_table_of_stiffness_of_its_own_nor_one_frf_of_residuals_or_shapes():
    modes = MADE["single"]
    assert modal_tables.stiffness(modes) is None
    assert modal_tables.residual(modes.fit) is None
    assert modal_tables.alike(modes) is None
    assert modal_figures.shapes(modes, modes.fit) is None
    assert modal_figures.stabilisation(modes, modes.fit) is None
    assert "No intervals" in modal_tables.modes(modes).note


def test_without_a_driving_point_there_is_no_stiffness_and_the_table_says_so():
    modes = MADE["single"]
    apart = dataclasses.replace(modes, fit=dataclasses.replace(modes.fit, outputs=("noseX",)))
    table = modal_tables.modes(apart)
    assert not any("k," in heading for heading in table.headings)
    assert "No point was both hit and measured" in table.note
    assert "Hammer tipX, response noseX" in seen(render({"modes": apart}, {}, {}))


def test_modes_given_by_hand_stay_a_short_table():
    by_hand = Modes(
        natural_frequency=np.array([900.0]), damping_ratio=np.array([0.01]), stiffness=np.array([1e7]), axes=("x",)
    )
    html = render({"modes": by_hand}, {}, {})
    assert "x 900.0 1.00 10.0" in seen(html)
    assert "<figure" not in html


def test_shades_grow_with_the_number_in_the_cell():
    modes = MADE["six_by_three"]
    for table in (modal_tables.alike(modes), modal_tables.residual(modes.fit)):
        cells = [
            (float(text.removesuffix(" %")), level)
            for row, levels in zip(table.rows, table.levels, strict=True)
            for text, level in zip(row[1:], levels[1:], strict=True)
        ]
        cells.sort()
        assert [level for _, level in cells] == sorted(level for _, level in cells)
        assert len({level for _, level in cells}) > 2
    assert 'class="agree level-8"' in render({"modes": modes}, {}, {})


def test_a_residual_has_one_shade_in_every_report():
    fit = MADE["six_by_three"].fit
    levels = [
        modal_tables.residual(dataclasses.replace(fit, residual=np.full((6, 3), value))).levels[0][1]
        for value in (1e-4, 1e-2, 0.1, 1.0, 3.0)
    ]
    assert levels == [0, 3, 6, 8, 8]


def test_a_corrected_fit_is_said_to_be_one_and_only_where_something_was_taken_away():
    words = seen(render({"modes": MADE["cut_off"]}, {}, {}))
    lost = share(taken_away(MADE["cut_off"].fit))
    assert f"took {lost} of the FRF away" in words
    assert "fitted, corrected" in words
    as_recorded = dataclasses.replace(MADE["six_by_three"].fit, delay=None, delay_sd=None)
    words = seen(render({"modes": dataclasses.replace(MADE["six_by_three"], fit=as_recorded)}, {}, {}))
    assert "corrected" not in words


def test_a_delay_is_shown_with_its_interval_and_is_not_taken_for_a_record_cut_off():
    modes = MADE["six_by_three"]
    late = np.exp(-2j * np.pi * np.outer(modes.fit.frequency, modes.fit.delay))[:, :, np.newaxis]
    fit = dataclasses.replace(modes.fit, measured=modes.fit.measured * late, modelled=modes.fit.modelled * late)
    assert taken_away(fit) < 1e-9
    modes = dataclasses.replace(modes, fit=fit)
    table = modal_tables.delays(modes)
    low, high = modes.delay_interval[0] * 1e6
    value, half = (float(part) for part in table.rows[0][1].split(" ± "))
    assert (value, half) == pytest.approx((12.0, (high - low) / 2), rel=0.05)
    words = seen(render({"modes": modes}, {}, {}))
    assert "The responses came later than the hammer." in words
    assert "of the FRF away" not in words


def test_a_mode_outside_of_the_band_is_in_the_tables_and_on_no_curve():
    modes = MADE["six_by_three"]
    far = dataclasses.replace(modes, natural_frequency=np.array([20.0, 668.0, 1180.0, 1505.0, 40_000.0]))
    for figure in modal_figures.driving_points(far, far.fit):
        numbers = [text.text for text in tree_of(figure).iter("text") if text.get("class") == "tick strong"]
        assert numbers == ["2", "3", "4"]
    assert len(modal_tables.modes(far).rows) == 5
    above = dataclasses.replace(modes, natural_frequency=modes.natural_frequency * 100)
    assert "<svg" in render({"modes": above}, {}, {})


def test_the_fitted_curve_is_the_structures_own_and_the_rest_is_counted_against_what_was_recorded():
    modes = MADE["cut_off"]
    fit = modes.fit
    pair = fitted_pair(modes, fit, 0, 0)
    drawn = fit.frequency >= pair.frequency[0]
    assert pair.fitted == pytest.approx(np.abs(fit.synthesised[drawn, 0, 0]))
    assert pair.left == pytest.approx(np.abs((fit.measured - fit.modelled)[drawn, 0, 0]))
    assert np.median(pair.left) < 0.1 * np.median(np.abs(pair.fitted - pair.measured))


def test_a_response_that_counts_the_other_way_round_is_turned_in_its_phase():
    modes = MADE["six_by_three"]
    turned = dataclasses.replace(modes.fit, outputs=("-tipX", *modes.fit.outputs[1:]), measured=-modes.fit.measured)
    as_it_was, now = (fitted_pair(modes, fit, 0, 0).measured_phase for fit in (modes.fit, turned))
    assert now == pytest.approx(as_it_was)
    assert next(iter(turned.driving_points)) == "tipX"


def test_every_frf_is_a_driving_point_or_across_and_those_not_measured_are_neither():
    fit = MADE["six_by_three"].fit
    assert driving_pairs(fit) == [(0, 0), (1, 1), (2, 2)]
    assert len(cross_pairs(fit)) == 15
    assert cross_pairs(fit)[0] == (0, 1)
    measured = fit.measured.copy()
    residue = fit.residue.copy()
    measured[:, 1], residue[:, 1] = np.nan, np.nan
    fewer = dataclasses.replace(fit, measured=measured, residue=residue)
    assert driving_pairs(fewer) == [(0, 0), (2, 2)]
    assert len(cross_pairs(fewer)) == 13
    modes = dataclasses.replace(MADE["six_by_three"], fit=fewer)
    assert not re.search(r"\bnan\b", render({"modes": modes}, {}, {}))


def test_what_is_left_is_on_the_drawing_but_not_where_the_curves_would_be_pressed_flat():
    modes = MADE["six_by_three"]
    pair = fitted_pair(modes, modes.fit, 0, 0)
    low, high = magnitudes_drawn(pair)
    assert low < np.median(pair.left) < pair.measured.min()
    tiny = dataclasses.replace(pair, left=pair.left * 1e-9)
    low, high = magnitudes_drawn(tiny)
    assert low >= min(0.99e-5 * high, pair.measured.min() / 1.3)


def tree_of(figure):
    return ElementTree.fromstring(figure.charts[0].replace(" data-log", ""))


def test_every_mode_is_marked_over_its_curve_and_numbered_as_in_the_table():
    modes = MADE["six_by_three"]
    for figure in modal_figures.driving_points(modes, modes.fit):
        tree = tree_of(figure)
        numbers = [text.text for text in tree.iter("text") if text.get("class") == "tick strong"]
        assert numbers == [row[0] for row in modal_tables.modes(modes).rows]
        rules = [path for path in tree.iter("path") if path.get("class") == "rule"]
        assert len(rules) == 2 * len(numbers)  # magnitude and phase


def test_the_stabilisation_chart_draws_every_pole_and_its_numbers_hold_damping_and_stability():
    modes = MADE["six_by_three"]
    figure = modal_figures.stabilisation(modes, modes.fit)
    circles = list(tree_of(figure).iter("circle"))
    fit = modes.fit
    inside = (fit.chart_frequency >= 300) & (fit.chart_frequency <= 3000)
    assert len(circles) == inside.sum()
    columns = {column.name: column.values for column in figure.columns}
    assert list(columns) == ["frequency", "order", "damping", "stable"]  # the page's script reads the ordinate second
    order = np.argsort(fit.chart_frequency)
    assert columns["damping"] == pytest.approx(100 * fit.chart_damping[order])
    assert (columns["stable"] == "yes").sum() == (fit.chart_stable > 0).sum()
    assert 'data-y="' in figure.charts[0]


def test_a_shape_points_to_the_side_it_moves_to_and_its_largest_is_one():
    modes = MADE["six_by_three"]
    figure = modal_figures.shapes(modes, modes.fit)
    assert len(figure.charts) == 5
    values = {column.name: column.values for column in figure.columns}
    assert values["mode 4"][[0, 1, 4]] == pytest.approx([0.25, 1.0, -0.5])
    assert "tipY 1.00" in figure.charts[3]
    assert "noseY −0.50" in figure.charts[3]
    assert len(re.findall(r'class="line back"', figure.charts[3])) == 3  # tipZ, noseX, noseY


def test_many_points_make_a_tall_chart_but_not_an_endless_one():
    modes = MADE["six_by_three"]
    fit = modes.fit
    many = dataclasses.replace(
        fit,
        outputs=tuple(f"p{n}X" for n in range(120)),
        residue=np.repeat(fit.residue, 20, axis=1),
        residue_deviation=np.repeat(fit.residue_deviation, 20, axis=2),
        measured=np.repeat(fit.measured, 20, axis=1),
        modelled=np.repeat(fit.modelled, 20, axis=1),
        synthesised=np.repeat(fit.synthesised, 20, axis=1),
        residual=np.repeat(fit.residual, 20, axis=0),
        remainder=np.repeat(fit.remainder, 20, axis=1),
        delay=None,
        delay_sd=None,
    )
    figure = modal_figures.shapes(dataclasses.replace(modes, fit=many), many)
    height = float(re.search(r'viewBox="0 0 \d+ (\d+)', figure.charts[0])[1])
    assert height < 760
    assert 20 <= figure.charts[0].count('class="tick" x') <= 45
    html = render({"modes": dataclasses.replace(modes, fit=many)}, {}, {})
    assert "9 of 359 are drawn" in seen(html)
    assert len(html.encode()) < 2_000_000


@pytest.mark.parametrize(
    ("value", "text"), [(0.3, "30 %"), (0.0256, "2.6 %"), (0.00012, "0.01 %"), (3e-7, "< 0.01 %"), (0.0, "0.00 %")]
)
def test_a_share_has_two_digits_but_no_more_than_anybody_needs(value, text):
    assert share(value) == text


def test_the_key_numbers_are_the_modes_with_the_highest_peaks_where_they_are_softest():
    numbers = modal_tables.key_numbers(MADE["six_by_three"])
    assert [entry["name"] for entry in numbers] == ["Mode 1", "Mode 2", "Mode 3", "Mode 4"]
    assert numbers[1]["word"].endswith("k 19.5 N/µm at tipY")
