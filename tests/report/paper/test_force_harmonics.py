"""A force that accelerations tell, for print."""

import pytest
from reconstructed_forces import MAKERS, advice, coefficients_of

from millcal.report.paper import figures_of, sheet
from millcal.report.paper.force_harmonics import advice_file, forces_file


@pytest.mark.parametrize(
    ("case", "given"),
    [
        ("a slot", {"force-harmonics", "force-methods", "speed-advice"}),
        ("four teeth", {"force-harmonics", "force-methods"}),
        ("hardly anything", {"force-harmonics"}),
    ],
)
def test_each_record_gives_the_figures_it_can(figures, case, given):
    found = {name.rpartition(": ")[2] for name in figures if name.startswith(f"accelerations, {case}: ")}
    assert found == given


def test_beside_the_forces_their_coefficients_add_only_intervals():
    forces = MAKERS["a slot"]()
    fit = coefficients_of(forces)
    with sheet.style():
        alone, both = set(figures_of({"forces": forces})), set(figures_of({"forces": forces, "coefficients": fit}))
        assert both - alone == {"coefficients"}
        assert set(figures_of({"coefficients": fit})) == {"force-revolution", "coefficients"}


def test_every_axis_has_its_course_and_its_amplitudes(figures):
    labels = [axes.get_ylabel() for axes in figures["accelerations, a slot: force-harmonics"].axes]
    for axis in "xyz":
        assert labels.count(f"$F_{axis}$ (N)") == 1
        assert labels.count(f"amplitude\nof $F_{axis}$ (N)") == 1


def test_no_more_than_three_cuts_are_drawn(figures):
    labels = [axes.get_ylabel() for axes in figures["accelerations, many cuts: force-harmonics"].axes]
    assert labels.count("$F_x$ (N)") == 3


def test_the_recommended_method_stands_first(figures):
    rows = figures["accelerations, many cuts: force-methods"].axes[0].get_yticklabels()
    assert [label.get_text() for label in rows][:2] == ["gtls", "ls"]


def test_what_is_not_known_is_not_in_the_legend(figures):
    def entries(case):
        return {text.get_text() for text in figures[f"accelerations, {case}: force-harmonics"].legends[0].get_texts()}

    assert entries("hardly anything") == {"from accelerations, without mean", "amplitude of a harmonic"}
    assert "dynamometer, the same harmonics" in entries("two cuts, a bad sensor")


@pytest.mark.usefixtures("coarse_png")
@pytest.mark.parametrize("format", ["svg", "png"])
def test_the_same_record_gives_the_same_file(format):
    forces = MAKERS["four teeth"]()
    assert forces_file(forces, format) == forces_file(forces, format)


def test_the_advice_alone_is_a_file():
    assert advice_file(advice(("Ktc", "Krc")), "svg").startswith(b"<?xml")
