"""Fitted modes for print."""

from dataclasses import replace

import numpy as np
import pytest
from modal_fits import cut_off, six_by_three

from millcal.data import Modes
from millcal.report.paper import sheet
from millcal.report.paper.frf import driving_points
from millcal.report.paper.modes import modal_figures


def texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_modes_given_by_hand_give_no_figure():
    by_hand = Modes(
        natural_frequency=np.array([900.0]), damping_ratio=np.array([0.01]), stiffness=np.array([1e7]), axes=("x",)
    )
    with sheet.style():
        assert modal_figures(by_hand) == {}


def test_every_mode_is_marked_in_every_panel(figures):
    natural = six_by_three().natural_frequency
    for axes in figures["modal-fit"].axes:
        rules = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
        assert rules == pytest.approx(natural)


def test_a_correction_is_in_the_legend_and_only_where_there_is_one(figures):
    assert "fitted, corrected" in texts(figures["a record cut off: modal-fit"])
    assert "fitted" in texts(figures["one FRF without hits: modal-fit"])


def test_the_assurance_criterion_is_written_in_its_cells(figures):
    cells = [text.get_text() for text in figures["modal-chart"].axes[1].texts]
    assert len(cells) == 25
    assert cells[0] == "1"
    assert cells[8] == f"{six_by_three().fit.mac[1, 3]:.2f}"[1:]


def test_one_frf_without_a_chart_gives_one_figure_of_one_column(figures):
    assert "one FRF without hits: modal-chart" not in figures
    assert figures["one FRF without hits: modal-fit"].get_figwidth() * 25.4 == pytest.approx(sheet.SINGLE)


@pytest.mark.parametrize(("form", "drawn"), [("accelerance", True), ("receptance", False)])
def test_the_sheet_of_an_frf_shows_the_fit_where_there_is_one_in_its_form(frf, form, drawn):
    with sheet.style():
        figure = driving_points(replace(frf, form=form), cut_off())["frf"]
    assert ("fitted, corrected" in texts(figure)) == drawn
    lines = {axes: [line for line in axes.lines if len(line.get_xdata()) > 2] for axes in figure.axes[:4]}
    assert {len(found) for found in lines.values()} == {2 if drawn else 1}


def test_an_frf_of_other_points_than_those_fitted_stays_as_measured(frf):
    elsewhere = replace(frf, outputs=("spindleX", "spindleY"), inputs=("spindleX", "spindleY"))
    with sheet.style():
        figure = driving_points(elsewhere, six_by_three())["frf"]
    assert not [text for text in texts(figure) if text.startswith("fitted")]
