"""Forces for print."""

from dataclasses import replace

import numpy as np

from millcal.report.paper import sheet
from millcal.report.paper.forces import mean_force, revolutions


def test_up_to_six_cuts_share_a_figure_and_more_have_their_own(figures):
    assert len(figures["force-revolution"].axes) == 5 * 3
    apart = [name for name in figures if name.startswith("seven cuts, two alike: force-revolution")]
    assert [name[-2:] for name in apart] == ["-1", "-3", "-6", "-7"]
    assert all(len(figures[name].axes) == 3 for name in apart)


def test_an_axis_has_one_scale_over_all_cuts_and_holds_all_that_is_drawn(figures, coefficients, cuts):
    axes = np.array(figures["force-revolution"].axes).reshape(5, 3)
    for row in range(3):
        low, high = axes[0, row].get_ylim()
        assert {panel.get_ylim() for panel in axes[:, row]} == {(low, high)}
        pairs = zip(coefficients.measured, cuts, strict=True)
        highest = max(float((measured + 2 * cut.scatter)[row].max()) for measured, cut in pairs)
        assert low < coefficients.modelled[:, row].min()
        assert highest < high


def test_cuts_of_the_same_conditions_are_told_apart_by_name(figures):
    titles = [figures[f"seven cuts, two alike: force-revolution-{n}"].axes[0].get_title("left") for n in (1, 3, 6)]
    assert "0-f300" in titles[0]
    assert "f900" not in titles[1]
    assert "5-f300" in titles[2]


def test_without_the_conditioned_cuts_there_is_no_band(coefficients, cuts):
    with sheet.style():
        bare, full = (revolutions(coefficients, c)["force-revolution"] for c in ((), cuts))
    assert "±2 sd of the revolutions" not in [text.get_text() for text in bare.legends[0].get_texts()]
    assert "±2 sd of the revolutions" in [text.get_text() for text in full.legends[0].get_texts()]


def test_the_quality_of_the_line_is_told_only_where_the_fit_is_of_the_means(coefficients):
    of_means = replace(coefficients, posterior=replace(coefficients.posterior, method="average"))
    with sheet.style():
        titles = [mean_force(fit, ()).axes[0].get_title("left") for fit in (coefficients, of_means)]
    assert titles == ["(a)", "(a) $R^2$ = 0.8650"]
