"""A recipe without a dynamometer: when its cuts go through the stage of forces, and what does not go together, by line."""

import re

import pytest

from millcal.errors import MillcalError
from millcal.io.recipe_tables import ForcesTable
from millcal.io.recipes import read_recipe

CUTS = """\
[cutter]
diameter_mm = 20
teeth = 2
[[cuts]]
recording = "cut.h5"
"""
IMPACT = '[impact]\nrecordings = ["tap.h5"]\n'
FORCES = "[forces]\n"
GTLS = '[coefficients]\nmethod = "gtls"\n'


def read(tmp_path, text):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    return read_recipe(path)


@pytest.mark.parametrize(
    ("text", "goes"),
    [
        (CUTS + IMPACT, False),
        (CUTS + IMPACT + FORCES, True),
        (CUTS + IMPACT + GTLS, True),
        (CUTS + IMPACT + FORCES + GTLS, True),
        (CUTS + IMPACT + '[forces]\nmethod = "rtls"\n', True),
    ],
)
def test_the_table_or_the_method_of_the_coefficients_sends_the_cuts_through_the_forces(text, goes, tmp_path):
    assert (read(tmp_path, text).forces is not None) == goes


def test_without_a_table_the_options_are_the_defaults(tmp_path):
    assert read(tmp_path, CUTS + IMPACT + GTLS).forces == ForcesTable()
    assert ForcesTable(slack_N=3.0).arguments()["slack"] == 3.0
    assert set(ForcesTable().arguments()) == {"method", "harmonics", "phase", "runout", "regularization", "slack"}


def test_an_frf_of_a_file_is_one_of_the_files_that_the_recipe_reads(tmp_path):
    recipe = read(tmp_path, CUTS + '[forces]\nfrf_file = "build/../frf.h5"\n[modes]\nmodes = 2\n')
    assert recipe.frf_file == tmp_path / "frf.h5"
    assert recipe.recordings == (tmp_path / "cut.h5", tmp_path / "frf.h5")


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        (CUTS + IMPACT + '[forces]\nmethod = "rtls"\n' + GTLS, "forces.method", "the coefficients come of these forces"),
        (CUTS + IMPACT + FORCES + '[coefficients]\nmethod = "nls"\n', "coefficients.method", "is for forces that were measured"),
        (CUTS + FORCES, "forces", "no FRF of the sensors; add [impact]"),
        (CUTS + GTLS, "coefficients.method", "no FRF of the sensors; add [impact]"),
        (IMPACT + FORCES, "forces", "no [[cuts]]"),
        (CUTS + IMPACT + '[forces]\nfrf_file = "frf.h5"\n', "forces.frf_file", "the FRF is given twice"),
        (CUTS + IMPACT + '[forces]\nregularization = "l-curve"\n', "forces.regularization", "goes with method tikhonov"),
        (CUTS + IMPACT + "[forces]\nslack_N = 3\n", "forces.slack_N", "goes with method rtls, not gtls"),
        (CUTS + IMPACT + "[forces]\nslack_N = -3\n", "forces.slack_N", "is below 0"),
        (CUTS + IMPACT + "[forces]\nharmonics = 0\n", "forces.harmonics", "is below 1"),
        (CUTS + IMPACT + '[forces]\nmethod = "svd"\n', "forces.method", "is not 'gtls'"),
        (CUTS + IMPACT + '[forces]\nphase = "pulse"\n', "forces.phase", "is not 'auto'"),
        (CUTS + IMPACT + "[forces]\nadvise_rpm = [9000, 3000]\n", "forces.advise_rpm", "does not rise"),
        (CUTS + IMPACT + "[forces]\nfrf = 'modes'\n[modes]\nfit = false\n", "forces.frf", "says that none are fitted"),
        (CUTS + IMPACT + FORCES + "[conditioning]\nlowpass_hz = 500\n", "conditioning.lowpass_hz", "leave it out"),
        (CUTS + IMPACT + FORCES + '[conditioning]\noffset = "air"\n', "conditioning.offset", "leave it out"),
        (
            CUTS + '[forces]\nfrf_file = "frf.h5"\n[structure]\nmodes = [{axis = "x", fn_hz = 1, zeta = 0.1, k_N_per_m = 1}]\n'
            "[stability]\nrpm = [1, 2]\n",
            "structure",
            "keep [structure] or forces.frf_file",
        ),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_told_at_its_line(text, key, said, tmp_path):
    with pytest.raises(MillcalError) as refused:
        read(tmp_path, text)
    place, _, rest = str(refused.value).partition(": ")
    table, _, name = key.partition(".")
    lines = text.splitlines()
    header = lines.index(f"[{table}]")
    line = next((i for i in range(header, len(lines)) if re.match(rf"{name} =", lines[i])), header) if name else header
    assert place == f"{tmp_path / 'recipe.toml'}:{line + 1}"
    assert rest.startswith(f"{key}: ")
    assert said in rest
    assert ";" in rest
