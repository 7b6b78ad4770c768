"""Coefficients that change while cutting, for print."""

from dataclasses import replace

import numpy as np
import pytest
from histories import MAKERS, two_cuts, unknown, wide, worn

from millcal.report.history_figures import range_of
from millcal.report.paper import figures_of, sheet
from millcal.report.paper.history import history_file, history_sheet


@pytest.mark.parametrize("maker", MAKERS.values(), ids=list(MAKERS))
def test_a_history_gives_one_sheet_in_place_of_the_figures_of_a_fit(maker):
    with sheet.style():
        assert set(figures_of({"coefficients": maker()})) == {"history"}


def test_every_coefficient_and_every_axis_has_its_panels(figures):
    labels = [axes.get_ylabel() for axes in figures["two cuts, three directions: history"].axes]
    for name in ("tc", "rc", "ac"):
        assert labels.count(rf"$K_{{\mathrm{{{name}}}}}$ (N/mm²)") == 1
    for name in ("te", "re", "ae"):
        assert labels.count(rf"$K_{{\mathrm{{{name}}}}}$ (N/mm)") == 1
    assert [labels.count(f"$F_{axis}$ (N)") for axis in "xyz"] == [3, 3, 3]
    assert len(labels) == 3 + 6 + 9 + 2


def test_the_scales_are_those_of_the_page(figures):
    history = worn()
    panel = figures["a jump: history"].axes[0]
    values = (history.specific_force[:, 0], history.specific_low[:, 0], history.specific_high[:, 0])
    assert panel.get_ylim() == pytest.approx(range_of(*(v / 1e6 for v in values)))


def test_an_axis_has_one_scale_in_all_windows(figures):
    panels = [axes for axes in figures["a jump: history"].axes if axes.get_ylabel() == "$F_x$ (N)"]
    assert len({axes.get_ylim() for axes in panels}) == 1
    assert [panel.get_title(loc="left").partition(",")[0] for panel in panels] == ["(c) start", "(d) middle", "(e) end"]


def test_jumps_borders_and_bands_are_in_the_legend_where_they_are_drawn(figures):
    def entries(name):
        return {text.get_text() for text in figures[f"{name}: history"].legends[0].get_texts()}

    assert {"jump", "estimate, with 95 % band"} <= entries("a jump")
    assert "next cut" not in entries("a jump")
    assert "next cut" in entries("two cuts, three directions")
    assert not any("95 %" in text for text in entries("nothing but values"))


def test_without_innovations_the_sheet_ends_with_the_forces():
    silent = replace(unknown(), innovation_mean=np.full((3, 2), np.nan))
    with sheet.style():
        labels = [axes.get_ylabel() for axes in history_sheet(silent).axes]
    assert not any("innovations" in label for label in labels)


@pytest.mark.parametrize("format", ["pdf", "svg"])
def test_a_file_of_it_has_the_same_bytes_each_time(format):
    history = wide()
    first = history_file(history, format)
    assert first == history_file(history, format)
    assert first[:5] in (b"%PDF-", b"<?xml")


def test_a_long_history_is_thinned():
    assert len(history_file(two_cuts(), "svg")) < 2_000_000
