"""Coefficients for print."""

from dataclasses import replace

from millcal.report.paper import sheet
from millcal.report.paper.coefficients import intervals


def test_every_coefficient_has_a_panel_with_its_unit_and_runout_has_none(figures):
    labels = [axes.get_xlabel() for axes in figures["coefficients"].axes]
    assert labels[0] == r"$K_{\mathrm{tc}}$ (N/mm²)"
    assert labels[5] == r"$K_{\mathrm{ae}}$ (N/mm)"
    assert len(labels) == 6


def test_a_model_without_a_common_parameter_is_left_out(figures):
    rows = [label.get_text() for label in figures["another law: coefficients"].axes[0].get_yticklabels()]
    assert rows == ["this fit (nls)", "harmonics to 30"]


def test_a_fit_without_coefficients_gives_no_figure(coefficients):
    posterior = coefficients.posterior
    only_runout = replace(
        posterior,
        names=("c0",),
        units=("m",),
        mean=posterior.mean[6:],
        covariance=posterior.covariance[6:, 6:],
        interval=posterior.interval[6:],
    )
    with sheet.style():
        assert intervals(replace(coefficients, posterior=only_runout)) == {}
