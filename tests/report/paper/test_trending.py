"""Figures of the study of trending coefficients, drawn from courses made up here."""

import re

import numpy as np
import pytest
from matplotlib.lines import Line2D
from matplotlib.text import Text

from millcal.report.paper import sheet, trending
from millcal.report.paper.trending import Course

CASES = ("static", "ascending", "alternating")
METHODS = ("RLS", "EnKF", "EnKF*", "IMM", "smoother")
GROUPS = {"published": METHODS[:3], "others": METHODS[3:]}
STEPS = np.arange(1, 1121)


def courses(level, size):
    """Of every method in every case; IMM is the same from every start, and the smoother has a deviation of its own."""
    found = {}
    for number, method in enumerate(METHODS):
        wave = level + size * np.sin(STEPS / (20 + 7 * number))
        deviation = np.full(len(STEPS), 0.0 if method == "IMM" else size / 3)
        found[method] = {case: Course(wave, deviation, own=method == "smoother") for case in CASES}
    return found


RMS = {method: {case: 7.25 for case in CASES} for method in METHODS}
TRUTH = {case: (np.full(len(STEPS), 1700.0), np.full(len(STEPS), 0.18)) for case in CASES}


@pytest.fixture(scope="module")
def figures():
    with sheet.style():
        drawn = {
            "errors": trending.errors(courses(0, 20), RMS, {"EnKF*": 50}),
            "coefficients": trending.coefficients(courses(1700, 90), courses(0.18, 0.02), TRUTH, GROUPS),
        }
        for figure in drawn.values():
            figure.draw_without_rendering()
        yield drawn


def texts_of(figure):
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent()) for text in seen]


@pytest.mark.parametrize("name", ["errors", "coefficients"])
def test_all_words_stand_on_the_sheet_and_none_on_another(figures, name):
    texts, paper = texts_of(figures[name]), figures[name].bbox
    for number, (text, box) in enumerate(texts):
        assert min(box.x0, box.y0) > -0.5, text
        assert box.x1 < paper.x1 + 0.5, text
        assert box.y1 < paper.y1 + 0.5, text
        for other, place in texts[:number]:
            shared = min(box.x1, place.x1) - max(box.x0, place.x0), min(box.y1, place.y1) - max(box.y0, place.y0)
            assert min(shared) <= 1, (text, other)


@pytest.mark.parametrize("name", ["errors", "coefficients"])
def test_they_fit_the_page_and_every_axis_has_its_unit(figures, name):
    figure = figures[name]
    width, height = figure.get_size_inches() * 25.4
    assert width == pytest.approx(sheet.DOUBLE)
    assert height < 235
    assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text()) >= 7
    for axes in figure.axes:
        for axis, shows in ((axes.xaxis, "labelbottom"), (axes.yaxis, "labelleft")):
            if axis.get_tick_params().get(shows, True):
                assert re.search(r"\([^()]+\)$", axis.get_label_text())


@pytest.mark.parametrize("name", ["errors", "coefficients"])
def test_what_the_legend_tells_apart_differs_without_colour(figures, name):
    handles = figures[name].legends[0].findobj(Line2D)  # also those beside a tube
    looks = [(line.get_linestyle(), line.get_marker()) for line in handles]
    assert len(set(looks)) == len(looks) >= 2


def test_methods_are_as_dark_as_thin_lines_need():
    """Contrast with white of at least 3 to 1, and no two methods of one hue."""

    def linear(colour):
        channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        return np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)

    for look in trending.LOOKS:
        luminance = linear(look.line) @ [0.2126, 0.7152, 0.0722]
        assert 1.05 / (luminance + 0.05) > 3, look
    assert len({look.line for look in trending.LOOKS}) == len(trending.LOOKS)


def test_a_method_without_scatter_has_no_tube_in_the_errors(figures):
    panels = np.reshape(figures["errors"].axes, (3, 5))
    assert all(len(panel.collections) == 0 for panel in panels[1:, 3])
    assert all(len(panel.collections) == 1 for panel in panels[1:, 0])


def test_whose_deviation_it_is_is_said(figures):
    for figure in figures.values():
        told = [text.get_text() for text in figure.legends[0].get_texts()]
        assert any("smoother" in text and "of its own" in text for text in told)
        assert not any("IMM" in text and "of its own" in text for text in told)


def test_inflations_are_marked_where_they_are(figures):
    panels = np.reshape(figures["errors"].axes, (3, 5))
    dotted = [line for line in panels[1, 2].lines if len(line.get_xdata()) == 2]
    assert [line.get_xdata()[0] for line in dotted] == list(range(50, 1121, 50))
    assert not [line for line in panels[1, 1].lines if len(line.get_xdata()) == 2]


def test_spikes_do_not_set_the_scale_and_what_is_common_does():
    one = courses(0, 20)
    spiked = one["RLS"]["static"].mean.copy()
    spiked[:5] = 5000.0
    one["RLS"]["static"] = Course(spiked, one["RLS"]["static"].deviation)
    with sheet.style():
        low, high = trending.errors(one, RMS, {}).axes[0].get_ylim()
    assert 25 < high < 60
    assert low == -high
