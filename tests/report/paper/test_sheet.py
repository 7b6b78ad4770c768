"""How a figure for print becomes a file."""

import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest

from millcal.report.paper import sheet

STYLE_OF_THE_PAGE = (Path(sheet.__file__).parents[1] / "template" / "style.css").read_text()


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    with sheet.style():
        figure, ((axes,),) = sheet.sheet(sheet.SINGLE, 40.0)
        (line,) = axes.plot([1, 2, 3], [10, 1000, 20])
        sheet.scale(axes, "x", (1, 3), label="time (s)")
        sheet.scale(axes, "y", (1, 1e4), label=r"$F_x$ (N)", log=True)
        sheet.legend(figure, [(line, "measured")], columns=1)
        return {format: sheet.file_bytes(figure, format) for format in sheet.FORMATS}


def test_a_pdf_carries_its_fonts_as_truetype_and_says_nothing_of_the_clock(files):
    assert b"/FontFile2" in files["pdf"]
    assert b"/Type3" not in files["pdf"]
    assert not re.search(rb"Date|Producer|Creator", files["pdf"])


def test_a_pdf_and_an_svg_are_as_wide_as_a_column(files):
    points = float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", files["pdf"])[1])
    assert points / 72 * 25.4 == pytest.approx(sheet.SINGLE, abs=0.01)
    points = float(re.search(rb'<svg[^>]*? width="([\d.]+)pt"', files["svg"])[1])
    assert points / 72 * 25.4 == pytest.approx(sheet.SINGLE, abs=0.01)


def test_an_svg_needs_no_font_and_holds_no_picture(files):
    assert not re.search(rb"<text|<image|dc:date", files["svg"])


def test_a_png_has_600_dots_per_inch_and_no_word_of_its_maker(files):
    assert int.from_bytes(files["png"][16:20], "big") == int(sheet.SINGLE / 25.4 * 600)
    assert b"tEXt" not in files["png"]


def test_the_style_ends_with_its_block():
    before = dict(matplotlib.rcParams)
    with sheet.style():
        assert matplotlib.rcParams["font.size"] == 8
    assert dict(matplotlib.rcParams) == before


def test_pyplot_is_never_imported():
    script = (
        "import sys, millcal.report.paper as paper; paper.figure_files({}); print('matplotlib.pyplot' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


@pytest.mark.parametrize("name", ["ink", "muted", "grid", "main", "model", "stable", "usable"])
def test_ink_has_the_colours_of_the_page(name):
    assert getattr(sheet, name.upper()) == re.search(rf"--{name}: (#\w+);", STYLE_OF_THE_PAGE)[1]


def test_areas_differ_in_grey():
    def grey(colour):
        return sum(w * int(colour[i : i + 2], 16) for w, i in ((0.299, 1), (0.587, 3), (0.114, 5)))

    assert grey(sheet.STABLE) - grey(sheet.BAND) > 25
    assert grey(sheet.BAND) - grey(sheet.MAIN) > 25


@pytest.mark.parametrize("text", ["5 $ and 6 $", "a_b_c", "f_z 0.1 mm", "100 %", r"C:\cuts\a.txt"])
def test_any_name_can_be_written(text):
    with sheet.style():
        figure, ((axes,),) = sheet.sheet(sheet.SINGLE, 40.0)
        axes.set_title(sheet.plain(text))
        figure.draw_without_rendering()


@pytest.mark.parametrize("width", [sheet.SINGLE, sheet.DOUBLE])
def test_a_legend_has_as_many_columns_as_fit_and_leaves_the_panels_their_height(width):
    heights = []
    for many in (3, 17):
        with sheet.style():
            figure, ((axes,),) = sheet.sheet(width, 60.0)
            lines = axes.plot([[0]] * 2, [list(range(many))] * 2)
            words = ["limit" if k % 2 else "simulated: repeats every so many teeth" for k in range(many)]
            sheet.legend(figure, list(zip(lines, words, strict=True)), columns=4)
            for dots in (72, 600):  # of vector files and of pixels
                figure.set_dpi(dots)
                figure.draw_without_rendering()
                box = figure.legends[0].get_window_extent()
                assert 0 <= box.x0 < box.x1 <= figure.bbox.width
                assert box.y0 > axes.get_window_extent().y1
            heights.append(axes.get_window_extent().height / figure.dpi * 25.4)
    assert heights[1] > 0.75 * heights[0]
