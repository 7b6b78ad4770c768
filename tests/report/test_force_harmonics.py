"""What the page shows of a force that accelerations tell: its course, harmonics, sensors, methods, speeds, and what is not told."""

import html as markup
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from reconstructed_forces import MAKERS, advice, coefficients_of, vibrations

from millcal.data import AsynchronousPeak, Check, ForceHarmonics, Notice
from millcal.report import force_figures, force_harmonics_figures, force_harmonics_tables, speed_advice_figure, tables
from millcal.report.digits import plus_minus, significant
from millcal.report.page import render

MADE = {name: maker() for name, maker in MAKERS.items()}


@pytest.fixture(params=MADE)
def forces(request) -> ForceHarmonics:
    return MADE[request.param]


def seen(html: str) -> str:
    """The text of a page, without script, style and the numbers to copy, in one line."""
    bare = re.sub(r"(?s)<(script|style|textarea).*?</\1>", " ", html)
    return " ".join(markup.unescape(re.sub(r"<[^>]+>", " ", bare)).split())


def results_of(forces: ForceHarmonics) -> list[dict]:
    """The records of a result folder in each of the ways that they may stand there."""
    heard, fit = vibrations(forces), coefficients_of(forces)
    return [
        {"forces": forces},
        {"vibrations": heard, "forces": forces, "coefficients": fit},
        {"vibrations": heard},
        {"coefficients": fit},
    ]


def test_the_page_shows_nothing_unknown_as_nan_and_every_figure_with_its_numbers(forces):
    for results in results_of(forces):
        html = render(results, {}, {})
        assert not re.search(r"\b(nan|inf|None|undefined)\b", seen(html))
        body = html[html.index("<main>") : html.index('<section id="provenance">')]
        assert "nan" not in re.sub(r"(?s)<textarea.*?</textarea>", "", body)
        assert html.count("<figure") == html.count('class="csv"') >= 1
        ids = re.findall(r' id="([^"]*)"', html)
        assert len(ids) == len(set(ids))
        assert set(re.findall(r'href="#([^"]*)"', html)) <= set(ids)
        assert render(results, {}, {}) == html


def test_every_chart_is_a_well_formed_drawing_over_columns_of_one_length(forces):
    drawn = [
        *force_harmonics_figures.courses(forces),
        force_harmonics_figures.harmonics(forces),
        force_harmonics_figures.law_distance(forces),
        *force_harmonics_figures.accelerations(forces),
        force_harmonics_figures.methods(forces),
        speed_advice_figure.expected_spread(forces.advice, forces.conditions),
    ]
    for figure in drawn:
        if figure is None:
            continue
        assert len({len(column.values) for column in figure.columns}) == 1
        for svg in figure.charts:
            label = ElementTree.fromstring(svg).attrib["aria-label"]
            assert len(label) > 20
            assert "nan" not in label


def test_long_records_make_no_long_page():
    many = MADE["many cuts"]
    assert len(render({"vibrations": vibrations(many), "forces": many}, {}, {}).encode()) < 1_500_000


def test_the_sections_stand_in_the_order_of_the_work(results):
    forces = MADE["a slot"]
    page = {
        "frf": results["frf"],
        "stability": results["stability"],
        "vibrations": vibrations(forces),
        "forces": forces,
    }
    for more in ({}, {"coefficients": coefficients_of(forces)}):
        html = render({**page, **more}, {}, {})
        order = ("quality", "frf", "reconstruction", "accelerations", "coefficients", "law", "stability", "next-cut")
        places = [html.index(f'<section id="{name}">') for name in order]
        assert places == sorted(places)
        assert 'id="revolution-0"' not in html  # the same force stands there with its band
        assert html.count("Checks of the fit") == 1


def test_the_standard_deviation_of_an_amplitude_is_that_of_many_draws():
    forces = MADE["a slot"]
    rng = np.random.default_rng(4)
    n = len(forces.axes)
    deviation = force_harmonics_figures.amplitude_sd(forces)
    for line in range(len(forces.cut)):
        parts = np.concatenate([forces.force[line].real, forces.force[line].imag])
        draws = rng.multivariate_normal(parts, forces.force_covariance[line], size=20_000, method="eigh")
        size = np.abs(draws[:, :n] + 1j * draws[:, n:])
        assert deviation[line] == pytest.approx(size.std(axis=0), rel=0.03)


def test_a_harmonic_without_force_has_the_spread_of_its_parts():
    forces = MADE["four teeth"]
    nothing = replace(forces, force=np.zeros_like(forces.force))
    n = len(forces.axes)
    variance = np.diagonal(forces.force_covariance, axis1=1, axis2=2)
    expected = np.sqrt((variance[:, :n] + variance[:, n:]) / 2)
    assert force_harmonics_figures.amplitude_sd(nothing) == pytest.approx(expected)


def test_the_numbers_of_the_record_are_on_the_page():
    forces = MADE["a slot"]
    html = seen(render({"forces": forces}, {}, {}))
    for mean, (low, high), factor in zip(
        forces.posterior.mean, forces.posterior.interval, (1e6,) * 3 + (1e3,) * 2, strict=True
    ):
        assert plus_minus(mean / factor, low / factor, high / factor) in html
    for value in np.abs(forces.force).ravel():
        assert significant(float(value)) in html
    assert "78 to 234 Hz, 3 harmonics of 1 cut" in html
    assert "41.30 ± 0.92°, fitted" in html
    assert "31 degrees of freedom" in html
    assert forces.recommended_why in html
    for text in ("rank of the law", "real equations between the harmonics 13", "2400", "1950", "2800"):
        assert text in html


def test_what_accelerations_do_not_tell_is_said_and_no_number(forces):
    told = {name for names in forces.unobservable for name in names}
    for table in (
        force_harmonics_tables.coefficients(forces),
        tables.coefficients(forces.posterior, tables.untold(coefficients_of(forces))),
    ):
        assert [row[0] for row in table.rows] == ["Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"]
        for row in table.rows:
            assert ("not told by accelerations" in row[5]) == (row[0] in told)
            assert (row[1] == "–") == (row[0] in told)


def test_combinations_that_are_not_told_are_named():
    forces = replace(MADE["a slot"], unobservable=(("Kae",), ("Ktc", "Kte")))
    words = force_harmonics_tables.untold_in_words(forces)
    assert "shows Kae" in words
    assert "Ktc and Kte" in words
    assert force_harmonics_tables.untold_in_words(replace(forces, unobservable=())) == ""


def test_the_sensor_that_does_not_fit_is_shaded_and_named_and_no_other():
    forces = MADE["two cuts, a bad sensor"]
    table = force_harmonics_tables.residuals(forces)
    shaded = [
        row[0] for row, levels in zip(table.rows, table.levels, strict=True) if any(v is not None for v in levels)
    ]
    assert shaded == ["quillX"]
    words = {row[0]: row[-1] for row in force_harmonics_tables.sensors(forces).rows}
    assert [name for name, word in words.items() if word.startswith("✕")] == ["quillX"]
    html = seen(render({"forces": forces}, {}, {}))
    assert "The force model does not fit the 2 cuts" in html
    assert "quillX is 22 % off" in html


def test_a_harmonic_that_fits_nowhere_is_a_shaded_column():
    forces = MADE["a slot"]
    off = forces.measured + 6 * forces.deviation * (forces.order == 4)[:, np.newaxis]
    table = force_harmonics_tables.residuals(replace(forces, measured=off))
    dark = np.array([[level is not None for level in levels[1:]] for levels in table.levels])
    assert dark[:, 1].all()
    assert not dark[:, [0, 2]].any()


def test_noise_alone_leaves_few_cells_shaded():
    table = force_harmonics_tables.residuals(MADE["many cuts"])
    dark = [level is not None for levels in table.levels for level in levels[1:]]
    assert np.mean(dark) < 0.12


@pytest.mark.parametrize(
    ("residual", "share", "usual", "word"),
    [
        (1.0, 1.0, 1.0, "✓ fits"),
        (1.0, 0.02, 1.0, "✓ fits, but tells hardly anything"),
        (30.0, 1.0, 1.0, "✕ far off: check its place, direction and sensitivity"),
        (30.0, 1.0, 25.0, "! off, as others are: see FRF and law"),
        (np.nan, 1.0, 1.0, "not tested"),
        (np.nan, 0.0, np.nan, "tells nothing"),
    ],
)
def test_a_word_about_a_sensor(residual, share, usual, word):
    assert force_harmonics_tables.sensor_in_words(residual, share, 6, usual) == word


def test_what_the_record_does_not_hold_is_not_in_the_key_and_is_said():
    html = seen(render({"forces": MADE["hardly anything"]}, {}, {}))
    assert "95 % band" not in html
    assert "The record holds no force by the law" in html
    assert "No dynamometer was there to compare" in html
    assert "does not say what difference is to be expected" in html
    assert "not known: nothing is left over to test the force" in html
    assert "Every method" not in html
    assert "1 harmonic at 78 Hz" in html
    with_all = seen(render({"forces": MADE["two cuts, a bad sensor"]}, {}, {}))
    assert "dynamometer, the same harmonics" in with_all
    assert "No dynamometer was there" not in with_all


def test_an_axis_has_one_scale_in_all_cuts():
    figures = force_harmonics_figures.courses(MADE["two cuts, a bad sensor"])
    ticks = [re.findall(r'text-anchor="end">([^<]+)</text>', figure.charts[0]) for figure in figures]
    assert len(ticks) == 2
    assert ticks[0] == ticks[1]


def test_the_recommended_method_is_marked_and_a_wild_one_leaves_the_picture_with_its_number():
    forces = MADE["many cuts"]
    figure = force_harmonics_figures.methods(forces)
    wild = significant(float(forces.compared[1, 1]) / 1e6)
    assert f"{wild} →" in figure.charts[1]
    assert all("gtls ◂" in svg for svg in figure.charts)
    assert forces.recommended_why in figure.caption
    rows = force_harmonics_tables.compared(forces).rows
    assert [row[0] for row in rows if "recommended" in row[0]] == ["gtls ◂ recommended"]
    unknown = replace(forces, recommended="", recommended_why="")
    assert "◂" not in force_harmonics_figures.methods(unknown).charts[0]


def test_a_method_without_a_deviation_has_no_plus_minus():
    forces = MADE["a slot"]
    rows = {row[0]: row[1:] for row in force_harmonics_tables.compared(forces).rows}
    assert not any("±" in cell for cell in rows["tls"])
    assert all("±" in cell for cell in rows["ls"])


def test_the_force_of_each_harmonic_by_itself_is_near_that_of_a_law_that_holds():
    forces = MADE["a slot"]
    missed = force_harmonics_figures.misses(forces)
    assert (missed < 4).all()
    assert 0.2 < np.sqrt(np.mean(missed**2)) < 1.3
    another = replace(forces, free_force=forces.free_force + 5 * forces.free_sd * (forces.order == 4)[:, np.newaxis])
    assert (force_harmonics_figures.misses(another)[1] > 3).all()
    assert len(force_harmonics_figures.law_distance(forces).columns) == 3 + len(forces.axes)
    assert force_harmonics_figures.law_distance(MADE["hardly anything"]) is None


def test_a_law_that_does_not_hold_is_shown_where_the_reason_points():
    forces = replace(
        MADE["a slot"],
        verdict="does not fit: no force of this law",
        checks=(Check("law", False, "no force of this law: residual 9 times the expected one"),),
    )
    html = render({"forces": forces}, {}, {})
    assert 'href="#law-distance"' in html
    without = render({"forces": replace(forces, free_force=None, free_sd=None)}, {}, {})
    assert "law-distance" not in without
    assert "The force is none of this law" in seen(without)


def test_a_recommendation_that_is_not_the_method_of_the_report_says_so():
    forces = replace(MADE["a slot"], recommended="ls", recommended_why="the law does not hold here")
    caption = force_harmonics_figures.methods(forces).caption
    assert "Recommended: ls, because the law does not hold here." in caption
    assert "those of gtls" in caption


def test_methods_stand_side_by_side_in_one_place_only():
    forces = MADE["a slot"]
    fit = replace(coefficients_of(forces), alternatives=(("ls", (("Ktc", 1e9),)),))
    assert "Other models" in seen(render({"coefficients": fit}, {}, {}))
    html = seen(render({"coefficients": fit, "forces": forces}, {}, {}))
    assert "Other models" not in html
    assert "Every method on the same lines" in html


def test_a_recommended_method_without_an_answer_is_not_marked():
    forces = MADE["a slot"]
    compared = np.where(np.arange(len(forces.compared_methods))[:, np.newaxis] == 0, np.nan, forces.compared)
    failed = replace(forces, compared=compared, recommended="ls")
    assert "◂" not in force_harmonics_figures.methods(failed).charts[0]


def test_the_best_speeds_stand_best_first_with_what_is_expected_there():
    told = advice(("Ktc", "Krc", "Kte"))
    table = force_harmonics_tables.best_speeds(told)
    assert [row[:2] for row in table.rows] == [["1", "2400"], ["2", "1950"], ["3", "2800"]]
    at = int(np.argmin(np.abs(told.spindle_speed - told.best[0])))
    assert table.rows[0][2:4] == [significant(100 * float(v), 2) for v in told.relative_sd[at, :2]]
    assert "sd of Kte, %" not in table.headings
    figure = speed_advice_figure.expected_spread(told)
    assert "speeds of the cuts" not in dict(figure.key).values()
    nothing = replace(told, best=())
    assert force_harmonics_tables.best_speeds(nothing) is None
    assert speed_advice_figure.expected_spread(nothing).charts


def test_where_only_edge_coefficients_are_told_the_advice_draws_those():
    figure = speed_advice_figure.expected_spread(advice(("Kte", "Kre")))
    assert ">Kte</text>" in figure.charts[0]


def test_a_fit_to_accelerations_compares_forces_without_their_mean():
    fit = coefficients_of(MADE["a slot"])
    assert force_figures.mean_force(fit) is None
    figure = force_figures.one_revolution(fit, ())[0]
    columns = {column.name: column.values for column in figure.columns}
    assert "Fx measured" in columns
    assert columns["Fx modelled"].mean() == pytest.approx(0.0, abs=2.0)
    assert abs(fit.modelled_mean[0, 0]) > 50
    html = seen(render({"coefficients": fit}, {}, {}))
    assert "Both are without their mean, which accelerations do not tell" in html


def test_an_axis_without_a_sensor_is_left_out():
    fit = coefficients_of(MADE["two cuts, a bad sensor"])
    assert len(force_figures.one_revolution(fit, ())[0].charts) == 2
    assert [text for text, _ in tables.spectrum(fit).groups[1:]] == [
        f"F{axis}, % of the measured AC power" for axis in "xy"
    ]


def test_what_is_told_of_the_recordings_bears_the_names_of_cuts_and_sensors():
    forces = MADE["two cuts, a bad sensor"]
    heard = vibrations(forces)
    peak = AsynchronousPeak("quillX", 417.3, 0.21, 8.0)
    notice = Notice("asynchronous", "lines at 417 Hz are no harmonics", heard[1].name)
    heard = (heard[0], replace(heard[1], peaks=(peak,), notices=(notice,)))
    html = seen(render({"vibrations": heard}, {}, {}))
    assert "n3060 quillX 417.3 0.210 8.0" in html
    assert "n3060 · asynchronous" in html
    assert "from the pulse" in html
    for sensor in forces.sensors:
        assert f"{sensor}, m/s²" in html
