"""Charts as inline SVG."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from millcal.report.charts import (
    HALF,
    Band,
    Frame,
    Line,
    Marks,
    Panel,
    Rule,
    Span,
    Tags,
    Whiskers,
    chart,
    decades_of,
    span_of,
    thin,
)


def drawn(*items, **options):
    panel = Panel("force <F>, N", items, 100, options.pop("y_range", (-1.0, 1.0)), log=options.pop("log", False))
    svg = chart([panel], x_label="angle & more", x_range=(0.0, 10.0), label='a "chart"', **options)
    return svg, ElementTree.fromstring(svg)


X = np.linspace(0, 10, 50)


def test_a_chart_is_well_formed_and_says_what_it_shows():
    _, tree = drawn(
        Span(1, 2, "steady", "steady"),
        Rule(0.0, "y"),
        Band(X, np.sin(X) - 0.1, np.sin(X) + 0.1, "main"),
        Line(X, np.sin(X), "main", "sine"),
        Marks(X[::9], np.cos(X[::9]), "best", "diamond", ["1", "2"]),
        Whiskers(X[:3], np.zeros(3), np.ones(3), "measured"),
    )
    assert tree.get("role") == "img"
    assert tree.get("aria-label") == 'a "chart"'
    texts = [text.text for text in tree.iter("text")]
    assert {"force <F>, N", "angle & more", "steady", "sine", "1", "2"} <= set(texts)


def test_a_line_breaks_where_a_value_is_missing_and_nothing_says_nan():
    y = np.sin(X)
    y[20:25] = np.nan
    svg, tree = drawn(Line(X, y, "main"))
    assert len(list(tree.iter("polyline"))) == 2
    assert "nan" not in svg


def test_an_infinite_value_stays_out_of_the_picture():
    svg, _ = drawn(Line(X, np.where(X > 5, np.inf, 0.0), "main"), Band(X, 0 * X, np.full(50, np.inf), "main"))
    assert "inf" not in svg


def test_what_leaves_the_panel_is_cut_off_and_marks_outside_are_not_drawn():
    _, tree = drawn(Marks(np.array([5.0, 5.0, 20.0]), np.array([0.0, 3.0, 0.0]), "best"))
    assert len(list(tree.iter("circle"))) == 1


def test_labels_at_the_ends_of_lines_do_not_overlap():
    lines = [Line(X, np.full(50, 0.01 * i), "main", f"line {i}") for i in range(4)]
    _, tree = drawn(*lines)
    heights = sorted(float(text.get("y")) for text in tree.iter("text") if (text.text or "").startswith("line "))
    assert min(np.diff(heights)) >= 12


def test_a_logarithmic_scale_puts_decades_at_equal_distances():
    svg, _ = drawn(Line(X[1:], X[1:], "main"), y_range=(0.001, 1000.0), log=True)
    rows = [float(y) for y in re.findall(r"M[\d.]+,([\d.]+)h", re.search(r'class="grid" d="([^"]*)"', svg)[1])]
    assert len(rows) > 2
    assert np.ptp(np.diff(rows)) < 0.2


def test_thinning_keeps_the_peaks_and_the_ends():
    y = np.zeros(100_000)
    y[54_321], y[77_777] = 1.0, -2.0
    kept = thin(np.arange(100_000), y, 400)
    assert {0, 54_321, 77_777, 99_999} <= set(kept.tolist())
    assert len(kept) <= 402
    assert np.all(np.diff(kept) > 0)


def test_ranges_hold_all_finite_values_and_never_collapse():
    low, high = span_of(np.array([1.0, np.nan, np.inf, 3.0]))
    assert low < 1.0 < 3.0 < high < 4.0
    low, high = span_of(np.full(5, 2.0))
    assert low < 2.0 < high
    low, high = decades_of(np.array([0.0, np.nan, 1e-30, 5.0]))
    assert 0 < low < 5.0 < high


def test_tags_stand_above_the_panel_in_order_and_do_not_overlap():
    panel = Panel("magnitude", [Tags((5.0, 5.05, 5.1, 9.99), ("1", "2", "3", "4"))], 100, (0.0, 1.0))
    tree = ElementTree.fromstring(chart([panel], x_label="x", x_range=(0.0, 10.0), label="tags", frame=HALF))
    tags = [text for text in tree.iter("text") if text.get("class") == "tick strong"]
    places = [float(tag.get("x")) for tag in tags]
    assert [tag.text for tag in tags] == ["1", "2", "3", "4"]
    assert min(np.diff(places)) >= 10
    assert places[-1] < HALF.width
    label = next(text for text in tree.iter("text") if text.text == "magnitude")
    assert float(label.get("y")) < float(tags[0].get("y")) - 10


def test_a_second_ordinate_stands_at_the_right_in_the_places_of_the_first():
    panel = Panel("left", [], 100, (0.0, 10.0), right_label="right, N", right_ticks=[(0.0, "one"), (10.0, "ten")])
    tree = ElementTree.fromstring(chart([panel], x_label="x", x_range=(0.0, 1.0), label="two", frame=Frame(right=60)))
    heights = {text.text: float(text.get("y")) for text in tree.iter("text")}
    assert heights["one"] - heights["ten"] == 100
    assert "right, N" in heights


def test_a_name_beside_the_end_of_a_line_stands_behind_a_piece_of_that_line():
    lines = [Line(X, X, "shade0", "tipX"), Line(X, 2 * X, "thin shade1", "tipY")]
    panel = Panel("y", lines, 90.0, (0.0, 2.0))
    svg = chart([panel], x_label="x", x_range=(0.0, 1.0), label="two lines with their names", frame=Frame(right=80.0))
    for kind, name in (("shade0", "tipX"), ("thin shade1", "tipY")):
        assert re.search(rf'<path class="line {kind}" d="[^"]*"/><text class="series {kind}"[^>]*>{name}<', svg)


def test_names_of_spans_stand_above_tags():
    items = [Span(0.0, 1.0, "clear", "first cut"), Tags([0.5], ["1"])]
    panel = Panel("y", items, 90.0, (0.0, 1.0))
    svg = chart([panel], x_label="x", x_range=(0.0, 1.0), label="a span with a name and a tag in it")
    texts = {text.text: text for text in ElementTree.fromstring(svg).iter("text") if text.get("class") != "tick"}
    assert float(texts["first cut"].get("y")) < float(texts["1"].get("y")) - 9
