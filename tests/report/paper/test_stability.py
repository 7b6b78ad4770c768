"""The stability map for print shows what the record holds."""

import numpy as np

from millcal.report.paper import sheet
from millcal.report.paper.stability import stability_map


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
