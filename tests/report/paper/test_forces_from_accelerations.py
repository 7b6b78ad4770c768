"""Figures of the study of forces from accelerations, drawn from errors made up here."""

import numpy as np
import pytest
from matplotlib.text import Text

from millcal.report.paper import forces_from_accelerations as paper
from millcal.report.paper import sheet

METHODS = (
    "LS",
    "TLS",
    "Tikhonov GCV",
    "Tikhonov L-curve",
    "RTLS",
    "LS all rows",
    "GTLS",
    "GTLS windowed",
    "GTLS modal",
)
NOISE = np.linspace(0, 1.6, 9)


def panels():
    """Errors that grow with the noise, and a bias that does not; without noise most are rounding."""
    courses = {m: 30 * NOISE / (i + 1) + 1e-13 for i, m in enumerate(METHODS)}
    return {"Ktc": {**courses, "Tikhonov GCV": 10.4 + NOISE}, "Krc": {m: 1.5 * course for m, course in courses.items()}}


@pytest.fixture(scope="module", params=[False, True], ids=["linear", "log"])
def figure(request):
    with sheet.style():
        x = np.geomspace(3.2, 21.7, len(NOISE)) if request.param else NOISE
        drawn = paper.errors(x, panels(), "noise of the accelerations (m/s²)", limit=10.0, log=request.param)
        drawn.draw_without_rendering()
        yield drawn


def test_all_words_stand_on_the_sheet_and_none_on_another(figure):
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in seen]
    for number, (text, box) in enumerate(boxes):
        assert min(box.x0, box.y0) > -0.5, text
        assert box.x1 < figure.bbox.x1 + 0.5, text
        assert box.y1 < figure.bbox.y1 + 0.5, text
        for other, place in boxes[:number]:
            shared = min(box.x1, place.x1) - max(box.x0, place.x0), min(box.y1, place.y1) - max(box.y0, place.y0)
            assert min(shared) <= 1, (text, other)


def test_every_method_is_in_the_legend_and_the_claim_last(figure):
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*METHODS, "limit of the paper's claim"]


def test_rounding_is_left_out_and_all_else_is_on_the_scale(figure):
    for panel in figure.axes:
        low, high = panel.get_ylim()
        drawn = np.concatenate([line.get_ydata() for line in panel.lines[1:]])
        assert np.isnan(drawn).any()
        assert np.nanmin(drawn) >= low > 1e-3
        assert np.nanmax(drawn) <= high
        assert low < 10 < high


def test_no_two_methods_look_alike():
    assert len(set(paper.looks_of(METHODS).values())) == len(METHODS)
