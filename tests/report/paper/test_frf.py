"""Driving points for print."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.report.paper import sheet
from millcal.report.paper.frf import driving_points


def test_one_direction_takes_one_column_and_two_take_the_page(figures):
    assert figures["one direction, one hit: frf"].get_figwidth() * 25.4 == pytest.approx(sheet.SINGLE)
    assert figures["frf"].get_figwidth() * 25.4 == pytest.approx(sheet.DOUBLE)


def test_without_coherence_its_panel_is_missing(figures):
    assert len(figures["one direction, one hit: frf"].axes) == 2
    assert len(figures["frf"].axes) == 6


def test_the_phase_is_not_joined_across_its_branch_cut(figures):
    phase = figures["no driving point: frf"].axes[1].lines[0].get_ydata()
    leaps = np.abs(np.diff(phase))
    assert np.isnan(phase).any()
    assert leaps[np.isfinite(leaps)].max() <= 180


def test_directions_compare_on_one_scale(figures):
    first, second = figures["frf"].axes[:2]
    assert first.get_ylim() == second.get_ylim()


def test_more_than_three_directions_go_on_further_figures(frf):
    dofs = ("noseX", "noseY", "tipX", "tipY")
    values = np.tile(frf.values, (1, 2, 2))
    bare = {"coherence": None, "multiple_coherence": None, "variance": None, "force_spectrum": None}
    with sheet.style():
        figures = driving_points(replace(frf, values=values, outputs=dofs, inputs=dofs, hits_used=(5,) * 4, **bare))
    assert {name: len(figure.axes) for name, figure in figures.items()} == {"frf-1": 6, "frf-2": 2}
