"""What every figure for print keeps to, and which figures there are."""

import re
from itertools import combinations

import numpy as np
import pytest
from matplotlib.lines import Line2D
from matplotlib.text import Text

from millcal.report.paper import NAMES, figure_files, figures_of, sheet

UNIT = re.compile(r"\([^()]+\)$")


def texts_of(figure):
    """Every text that is seen, with its box in pixels."""
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent()) for text in seen]


def wrong_in(figures, find):
    """What is found wrong in any of the figures, each with the figure's name."""
    with sheet.style():
        return [(name, wrong) for name, figure in figures.items() for wrong in find(figure)]


def test_every_axis_says_its_quantity_and_unit_or_shares_a_neighbours(figures):
    def find(figure):
        for axes in figure.axes:
            for axis, shows in ((axes.xaxis, "labelbottom"), (axes.yaxis, "labelleft")):
                ticks = [label.get_text() for label in axis.get_ticklabels()]
                words = any(re.search("[a-z]", label) for label in ticks)
                if axis.get_tick_params().get(shows, True) and not words and not UNIT.search(axis.get_label_text()):
                    yield axis.get_label_text()

    assert wrong_in(figures, find) == []


def test_a_legend_stands_beside_the_panels_and_never_on_the_data(figures):
    def find(figure):
        assert len(figure.legends) == 1
        assert not any(axes.get_legend() for axes in figure.axes)
        box = figure.legends[0].get_window_extent()
        yield from (axes.get_ylabel() for axes in figure.axes if box.overlaps(axes.get_window_extent()))

    assert wrong_in(figures, find) == []


def test_nothing_is_cut_off_at_the_rim(figures):
    def find(figure):
        paper = figure.bbox
        for text, box in texts_of(figure):
            if min(box.x0, box.y0) < -0.5 or box.x1 > paper.x1 + 0.5 or box.y1 > paper.y1 + 0.5:
                yield text

    assert wrong_in(figures, find) == []


def test_no_text_stands_on_another(figures):
    def find(figure):
        for (one, a), (other, b) in combinations(texts_of(figure), 2):
            shared = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
            if min(shared) > 1:  # boxes include the space of letters that are not there
                yield one, other

    assert wrong_in(figures, find) == []


def test_no_word_stands_on_a_line(figures):
    def find(figure):
        for axes in figure.axes:
            paths = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
            points = [path.interpolated(50).vertices for path in paths if len(path.vertices)]
            for text in axes.texts:
                box = text.get_window_extent()
                if any(box.count_contains(p[np.isfinite(p).all(axis=1)]) for p in points):
                    yield text.get_text()

    assert wrong_in(figures, find) == []


def test_what_the_legend_tells_apart_differs_without_colour(figures):
    def find(figure):
        handles = figure.legends[0].get_lines()
        looks = [(line.get_linestyle(), line.get_marker()) for line in handles if isinstance(line, Line2D)]
        return [look for look in looks if looks.count(look) > 1]

    assert wrong_in(figures, find) == []


def test_figures_are_as_wide_as_one_or_two_columns_and_fit_on_a_page(figures):
    def find(figure):
        width, height = figure.get_size_inches() * 25.4
        assert width == pytest.approx(sheet.SINGLE) or width == pytest.approx(sheet.DOUBLE)
        yield from [height] if height > 235 else []

    assert wrong_in(figures, find) == []


def test_no_type_is_smaller_than_seven_points(figures):
    def find(figure):
        return [text.get_text() for text in figure.findobj(Text) if text.get_text() and text.get_fontsize() < 7]

    assert wrong_in(figures, find) == []


def test_all_records_give_all_figures(results):
    with sheet.style():
        assert set(figures_of(results)) == {
            "stability-map", "frf", "modal-fit", "modal-chart", "force-revolution", "mean-force", "coefficients",
        }  # fmt: skip


@pytest.mark.parametrize(
    ("record", "given"),
    [
        ("cuts", set()),
        ("frf", {"frf"}),
        ("modes", {"modal-fit", "modal-chart"}),
        ("coefficients", {"force-revolution", "mean-force", "coefficients"}),
        ("stability", {"stability-map"}),
    ],
)
def test_each_record_alone_gives_the_figures_it_can(results, record, given):
    with sheet.style():
        assert set(figures_of({record: results[record]})) == given


def test_every_figure_bears_one_of_the_known_names(figures):
    assert [name for name in figures if not NAMES.fullmatch(name.rpartition(": ")[2])] == []


@pytest.mark.usefixtures("coarse_png")
@pytest.mark.parametrize("format", sheet.FORMATS)
def test_the_same_records_give_the_same_bytes_whatever_the_user_has_set(results, format):
    import matplotlib

    records = {"stability": results["stability"]}
    first = figure_files(records, format)
    with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 20, "axes.grid": False, "savefig.bbox": "tight"}):
        assert figure_files(records, format) == first
    assert list(first) == [f"stability-map.{format}"]


def test_every_figure_twice_has_the_same_bytes(results, hard_results):
    records = {"frf": results["frf"], **hard_results["one cut"]}
    assert figure_files(records, "pdf") == figure_files(records, "pdf")
