"""What the page shows of coefficients that change while cutting: their course, the windows, the innovations, the tables."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from histories import MAKERS, two_cuts, unknown, wide, worn
from scipy.stats import chi2

from millcal.data import CoefficientHistory, Jump
from millcal.report import history_figures, history_tables
from millcal.report.history_figures import expected_mean, expected_rms, range_of, settled, stretches
from millcal.report.page import render

MADE = {name: maker() for name, maker in MAKERS.items()}


@pytest.fixture(params=MADE)
def history(request) -> CoefficientHistory:
    return MADE[request.param]


def seen(html: str) -> str:
    """The text of a page, without script, style and the numbers to copy, in one line."""
    bare = re.sub(r"(?s)<(script|style|textarea).*?</\1>", " ", html)
    return " ".join(re.sub(r"<[^>]+>", " ", bare).split())


def test_the_page_shows_nothing_unknown_as_nan_and_every_figure_with_its_numbers(history):
    html = render({"coefficients": history}, {}, {})
    assert not re.search(r"\b(nan|inf|None|undefined)\b", seen(html))
    sections = html[html.index('<section id="coefficients">') : html.index('<section id="provenance">')]
    assert "nan" not in sections
    assert html.count("<figure") == html.count('class="csv"') >= 4
    ids = re.findall(r' id="([^"]*)"', html)
    assert len(ids) == len(set(ids))
    links = set(re.findall(r'href="#([^"]*)"', html))
    assert links <= set(ids)
    assert render({"coefficients": history}, {}, {}) == html


def test_every_chart_is_a_well_formed_drawing(history):
    figures = [
        history_figures.specific_force(history),
        history_figures.coefficients(history),
        history_figures.innovations(history),
        *history_figures.windows(history),
    ]
    for figure in figures:
        for svg in figure.charts:
            assert len(ElementTree.fromstring(svg).attrib["aria-label"]) > 20
        assert len({len(column.values) for column in figure.columns}) == 1


def test_a_long_history_makes_no_long_page(results):
    long = replace(two_cuts(), notices=())
    repeated = {
        name: np.tile(getattr(long, name), (20, *[1] * (getattr(long, name).ndim - 1)))
        for name in (
            "value", "low", "high", "specific_force", "specific_low", "specific_high", "innovation_mean", "innovation_square",
        )
    }  # fmt: skip
    many = replace(
        long, **repeated, time=np.linspace(0, 3600, 80_000), cut=np.zeros(80_000),
        innovation_samples=np.tile(long.innovation_samples, 20),
    )  # fmt: skip
    assert len(render({**results, "coefficients": many}, {}, {}).encode()) < 2_500_000


def test_it_stands_in_place_of_the_sections_of_a_fit(results):
    html = render({**results, "coefficients": worn()}, {}, {})
    assert html.index('id="frf"') < html.index('id="coefficients"') < html.index('id="stability"')
    assert "Cutting coefficients while cutting" in html
    assert 'id="revolution-0"' not in html
    assert "The force model fits the 1 cut" in html


def test_a_history_that_does_not_fit_doubts_the_map_and_says_why(results):
    html = seen(render({**results, "coefficients": wide()}, {}, {}))
    assert "The map rests on coefficients that do not fit" in html
    assert "Why the model does not fit ✕ The model leaves more than noise : see" in html


def test_the_numbers_of_the_record_are_on_the_page():
    html = seen(render({"coefficients": worn()}, {}, {}))
    for text in (
        "9.4 ± 2.6",
        "31.4",
        "1.00 ± 0.20",
        "%/s",
        "65 µm",
        "21 to 98 µm",
        "2090 ± 130",
        "at 7.44 s",
        "0.9820",
    ):
        assert text in html
    assert "1.50 ± 0.30" in seen(render({"coefficients": two_cuts()}, {}, {}))


def test_the_length_of_the_record_chooses_its_units():
    labels = {name: history_figures.specific_force(history).columns[0].heading for name, history in MADE.items()}
    assert labels == {"worn": "time [s]", "two_cuts": "time [min]", "wide": "time [ms]", "unknown": "time [ms]"}
    assert history_tables.rate_unit(two_cuts())[1] == "%/min"


def test_only_several_cuts_have_borders_and_names():
    of_two = history_figures.specific_force(two_cuts())
    assert ">pass1<" in of_two.charts[0]
    assert 'class="border"' in of_two.charts[0]
    of_one = history_figures.specific_force(worn())
    assert "wear<" not in of_one.charts[0]
    assert 'class="border"' not in of_one.charts[0]
    assert of_one.charts[0].count('class="jump"') == len(worn().directions) * len(worn().jumps)


def test_the_end_of_a_cut_is_where_the_next_begins():
    spans = history_figures.cut_spans(two_cuts())
    assert [cut for cut, _, _ in spans] == [0, 1]
    assert spans[0][2] == spans[1][1] == pytest.approx(240.0, abs=0.2)
    assert spans[1][2] == two_cuts().time[-1]


def test_a_prior_does_not_flatten_the_picture():
    history = two_cuts()
    for i in range(len(history.directions)):
        value, low, high = (v[:, i] for v in (history.specific_force, history.specific_low, history.specific_high))
        bottom, top = range_of(value, low, high)
        assert top < 0.8 * high.max()
        late = slice(len(value) // 4, None)
        assert bottom < low[late].min()
        assert high[late].max() < top
    nothing = np.full(5, np.nan)
    assert settled(nothing, nothing).all()


def test_white_innovations_lie_within_the_expected_range_and_others_do_not():
    history = worn()
    shown = stretches(history)
    for kind, expected in (("mean", expected_mean), ("rms", expected_rms)):
        low, high = expected(shown["samples"])
        inside = (shown[kind] > low) & (shown[kind] < high)
        assert 0.87 < inside.mean() <= 1.0
    loud = stretches(wide())
    assert (loud["rms"] > expected_rms(loud["samples"])[1]).all()


@pytest.mark.parametrize("n", [5, 30, 400])
def test_the_range_of_the_rms_is_that_of_chi_square(n):
    low, high = expected_rms(np.array([float(n)]))
    assert low[0] == pytest.approx(np.sqrt(chi2.ppf(0.025, n) / n), rel=0.03)
    assert high[0] == pytest.approx(np.sqrt(chi2.ppf(0.975, n) / n), rel=0.01)


def test_stretches_keep_the_mean_of_all_samples():
    history = worn()
    shown = stretches(history)
    n = history.innovation_samples[:, np.newaxis]
    weighted = (shown["mean"] * shown["samples"]).sum(axis=0) / shown["samples"].sum(axis=0)
    np.testing.assert_allclose(weighted, (n * history.innovation_mean).sum(axis=0) / n.sum())
    np.testing.assert_allclose(shown["samples"].sum(axis=0), n.sum())
    squares = (shown["rms"] ** 2 * shown["samples"]).sum(axis=0)
    np.testing.assert_allclose(squares, (n * history.innovation_square).sum(axis=0))


def test_without_the_number_of_samples_no_range_is_claimed():
    figure = history_figures.innovations(unknown())
    assert "expected" not in figure.caption
    assert all("expected" not in column.name for column in figure.columns)
    silent = replace(unknown(), innovation_square=np.full((3, 2), np.nan))
    assert history_figures.innovations(silent) is None


def test_what_the_record_can_tell_is_the_spread_behind_its_bands_and_the_check_on_them():
    table = history_tables.told_apart(worn())
    assert float(table.rows[0][1]) == pytest.approx(0.6, abs=0.005)
    assert float(table.rows[0][3]) == pytest.approx(0.013, abs=0.003)
    assert "k and m are told apart" in table.note
    assert (
        "not separable here; the force is valid for chips of 21 to 98 µm only."
        in history_tables.told_apart(wide()).note
    )
    assert history_tables.told_apart(unknown()) is None


def test_an_axial_force_that_pulls_is_known_as_well_as_one_that_pushes():
    history = two_cuts()
    turned = replace(
        history, specific_force=-history.specific_force, specific_low=-history.specific_high,
        specific_high=-history.specific_low, value=-history.value, low=-history.high, high=-history.low,
    )  # fmt: skip
    assert history_tables.told_apart(turned).rows == history_tables.told_apart(history).rows


def test_an_edge_share_whose_band_holds_zero_is_not_told():
    history = two_cuts()
    low = history.low.copy()
    low[-1, 3] = -1e3
    assert history_tables.told_apart(replace(history, low=low)).rows[0][3] == "not told from zero"


def test_a_change_that_holds_zero_neither_rises_nor_falls():
    assert [row[-1] for row in history_tables.change(wide()).rows] == ["not told from zero"] * 2
    assert [row[-1] for row in history_tables.change(worn()).rows] == ["rises"] * 2
    falls = replace(
        worn(), slope_per_minute=np.array([-0.1, -0.2]), slope_low=np.array([-0.2, -0.3]), slope_high=-np.ones(2) / 99
    )
    assert [row[-1] for row in history_tables.change(falls).rows] == ["falls"] * 2


def test_a_filter_that_gives_no_slope_says_nothing_of_a_change():
    table = history_tables.change(unknown())
    assert table.title == "Specific force"
    assert list(table.headings) == ["direction", "end, N/mm²"]
    html = seen(render({"coefficients": unknown()}, {}, {}))
    assert "change" not in html


def test_only_a_smoother_knows_the_start():
    assert "start, N/mm²" in history_tables.change(worn()).headings
    assert "start, N/mm²" not in history_tables.change(two_cuts()).headings


def test_a_jump_names_its_cut_where_there_are_several():
    jumped = replace(two_cuts(), jumps=(Jump(300.0, (0.1, 0.1, 0.1), (0.02, 0.02, 0.02), 12.0),))
    table = history_tables.jumps(jumped)
    assert table.rows[0][:3] == ["1", "5.000", "pass2"]
    assert history_tables.jumps(worn()).headings[2] != "cut"
    assert history_tables.jumps(two_cuts()) is None


def test_an_axis_has_one_scale_in_all_windows():
    figures = history_figures.windows(worn())
    assert [figure.title.partition(":")[0] for figure in figures] == ["Start", "Middle", "End"]
    ticks = [re.findall(r'text-anchor="end">([^<]+)</text>', figure.charts[0]) for figure in figures]
    assert ticks[0] == ticks[1] == ticks[2]
    assert len(figures[0].columns) == 1 + 2 * len(worn().axes)
