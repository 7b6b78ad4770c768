"""A recipe says what it means in SI, and every mistake in it is one line with file, line and key."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from millcal.errors import RecipeError
from millcal.io.keys import ConditionsTable, CutterTable, SetupTables, keys_of
from millcal.io.recipe_tables import RecipeTables
from millcal.io.recipes import read_recipe, read_setup
from millcal.physics.cutter import Cutter, CuttingConditions

GOOD = """\
title = "slot cuts"
seed = 3
[cutter]
diameter_mm = 25
teeth = 2
helix_deg = 45.0
[map]
fx = "+Fy"
fy = "Fx"
acts_on = "workpiece"
[units]
Fx = "N"
[conditions]
spindle_speed_rpm = 6000
axial_depth_mm = 3
direction = "slot"
[[cuts]]
recording = "data/f300.csv"
feed_mm_per_min = 300
steady_s = [0.1, 0.9]
[[cuts]]
recording = "../f600.csv"
feed_per_tooth_mm = 0.05
air_s = [0, 0.1]
spindle_speed_rpm = 6001
[coefficients]
method = "average"
[structure]
modes = [
  { axis = "x", fn_hz = 900, zeta = 0.02, k_N_per_m = 1e7 },
]
[stability]
rpm = [3000, 12000]
spindle_speed_rpm = 6000
axial_depth_mm = 2
[expect]
"coefficients.Ktc_N_per_mm2" = [690, 720]
verdict = "fits"
"""


def written(folder, text, name="recipe.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def changed(old, new):
    """The good recipe with one line changed."""
    assert GOOD.count(old) == 1, old
    return GOOD.replace(old, new)


def test_a_recipe_is_in_si(tmp_path):
    recipe = read_recipe(written(tmp_path, GOOD))
    assert recipe.title == "slot cuts"
    assert recipe.seed == 3
    assert recipe.cutter == Cutter(diameter=25e-3, teeth=2, helix=np.pi / 4)
    first, second = recipe.cuts
    assert first.conditions == CuttingConditions(pytest.approx(200 * np.pi), 25e-6, 3e-3, 25e-3, "slot")
    assert first.steady == (0.1, 0.9)
    assert first.air is None
    assert second.conditions.spindle_speed == pytest.approx(6001 * np.pi / 30)
    assert second.conditions.feed_per_tooth == pytest.approx(50e-6)
    assert second.air == ((0.0, 0.1),)
    assert (recipe.map, recipe.units, recipe.acts_on) == ({"fx": "+Fy", "fy": "Fx"}, {"Fx": "N"}, "workpiece")
    assert recipe.structure.modes.stiffness == pytest.approx([1e7])
    assert recipe.stability.arguments()["spindle_speed"] == pytest.approx((100 * np.pi, 400 * np.pi))
    assert recipe.expect == {"coefficients.Ktc_N_per_mm2": (690.0, 720.0), "verdict": "fits"}
    assert recipe.text == GOOD


IMPACT = changed('[structure]\nmodes = [\n  { axis = "x", fn_hz = 900, zeta = 0.02, k_N_per_m = 1e7 },\n]\n', """\
[impact]
recordings = ["tap.h5"]
[modes]
band_hz = [200, 3000]
near_hz = [650, 1200]
complex = true
""")  # fmt: skip


def test_the_options_of_the_modal_fit_are_the_keys_of_modes(tmp_path):
    recipe = read_recipe(written(tmp_path, IMPACT))
    assert recipe.modes.fit
    assert recipe.modes.arguments() == {
        "band": (200.0, 3000.0), "modes": None, "near": (650.0, 1200.0), "remainder": None, "complex_modes": True,
        "most": 12,
    }  # fmt: skip
    assert recipe.stability.dynamics is None
    assert "dynamics" not in recipe.stability.arguments()


def test_a_map_of_modes_that_the_recipe_does_not_fit_is_refused(tmp_path):
    text = IMPACT.replace("complex = true", "fit = false").replace("rpm = [", 'dynamics = "modes"\nrpm = [')
    with pytest.raises(
        RecipeError, match=r"toml:\d+: stability\.dynamics: \[modes\] says that none are fitted; let it"
    ):
        read_recipe(written(tmp_path, text))


def test_paths_are_relative_to_the_recipe_and_may_name_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("MILLCAL_TEST_FOLDER", "/elsewhere")
    text = changed("../f600.csv", "${MILLCAL_TEST_FOLDER}/b.csv")
    first, second = read_recipe(written(tmp_path, text)).cuts
    assert first.recording == tmp_path / "data/f300.csv"
    assert second.recording == Path("/elsewhere/b.csv")


def test_a_cut_without_conditions_leaves_them_to_the_recording(tmp_path):
    recipe = read_recipe(written(tmp_path, '[[cuts]]\nrecording = "a.h5"\n'))
    assert recipe.cuts[0].conditions is None
    assert recipe.cutter is None
    assert recipe.title == "recipe"
    assert recipe.stability is None


def test_where_names_file_line_and_key(tmp_path):
    path = written(tmp_path, GOOD)
    recipe = read_recipe(path)
    assert recipe.where("stability.rpm") == f"{path}:33: stability.rpm"
    assert recipe.where("cuts.1.air_s") == f"{path}:24: cuts.1.air_s"
    assert recipe.where("cuts.1.steady_s") == f"{path}:21: cuts.1.steady_s"  # absent: its table's line


def test_a_setup_uses_the_same_keys(tmp_path):
    setup = read_setup(
        written(
            tmp_path,
            'acts_on = "workpiece"\nsample_rate_hz = 1e4\n[cutter]\ndiameter_mm = 10\nteeth = 4\n'
            "[conditions]\nspindle_speed_rpm = 3000\nfeed_mm_per_min = 1200\naxial_depth_mm = 1\nradial_depth_mm = 2\n"
            'direction = "down"\nair_s = [[0, 1], [5, 6]]\n[map]\nfx = "-Fy"\n[channels.acc]\nunit = "V"\n'
            'sensitivity = "10 mV/g"\ndof = "tipX"\n[hdf5]\nsample_rate = "raw@fs"\n',
        )
    )
    assert setup.conditions == CuttingConditions(pytest.approx(100 * np.pi), pytest.approx(1e-4), 1e-3, 2e-3, "down")
    assert setup.air == ((0.0, 1.0), (5.0, 6.0))
    assert setup.acts_on == "workpiece"
    assert setup.channels["acc"].sensitivity == "10 mV/g"
    assert setup.hdf5.sample_rate == "raw@fs"
    assert setup.where("map.fx").endswith("recipe.toml:14: map.fx")


def test_unequal_pitch_in_rounded_degrees_still_closes_the_turn(tmp_path):
    text = changed("teeth = 2", "teeth = 3\npitch_deg = [119.9999, 120.0, 120.0]")
    assert sum(read_recipe(written(tmp_path, text)).cutter.pitch) == pytest.approx(2 * np.pi, abs=1e-12)


def test_keys_and_si_are_inverse():
    cutter = Cutter(
        diameter=25e-3, teeth=2, helix=np.pi / 4, runout=11e-6, runout_angle=0.1, pitch=(3.0, 2 * np.pi - 3)
    )
    conditions = CuttingConditions(200 * np.pi, 25e-6, 3e-3, 20e-3, "down")
    keys = keys_of(cutter, conditions)
    cutter_keys = {key: value for key, value in keys.items() if key in CutterTable.model_fields}
    back = CutterTable.model_validate(cutter_keys).cutter()
    assert back.pitch == pytest.approx(cutter.pitch)
    assert back.runout == pytest.approx(cutter.runout)
    rest = {key: value for key, value in keys.items() if key not in cutter_keys}
    table = ConditionsTable.model_validate(rest)
    assert table.trouble(cutter) is None
    assert vars(table.conditions(cutter)) == pytest.approx(vars(conditions), abs=1e-12)
    assert keys["feed_per_tooth_mm"] == 0.025


# what is changed, what it becomes, the line of the mistake, what is said about it
BAD = {
    "no TOML": ("teeth = 2", "teeth 2", 5, "not TOML at column 7"),
    "open string": ('direction = "slot"', 'direction = "slot', 16, "not TOML"),
    "key twice": ("teeth = 2", "teeth = 2\nteeth = 3", 6, "not TOML"),
    "mixed array": ("[0.1, 0.9]", "[0.1, 0.9", 21, "not TOML"),
    "unknown table": ("[units]", "[unist]", 11, "unist: unknown key; did you mean units?"),
    "unknown key": ("diameter_mm = 25", "diametre_mm = 25", 4, "cutter.diametre_mm: unknown key; did you mean diameter_mm"),
    "unknown word": (
        "spindle_speed_rpm = 6001", "rmp = 6001", 25, "cuts.1.rmp: unknown key; did you mean spindle_speed_rpm?"
    ),
    "unit forgotten": ("diameter_mm = 25", "diameter = 25", 4, "did you mean diameter_mm?"),
    "key missing": ("diameter_mm = 25\n", "", 3, "cutter.diameter_mm: is missing; give diameter of the cutter, mm"),
    "recording missing": ('recording = "../f600.csv"\n', "", 21, "cuts.1.recording: is missing"),
    "empty recording": ('"../f600.csv"', '" "', 22, "cuts.1.recording: is empty; name a file"),
    "text for a number": ("diameter_mm = 25", 'diameter_mm = "25"', 4, "cutter.diameter_mm: '25' is no number"),
    "switch for a number": ("axial_depth_mm = 3", "axial_depth_mm = true", 15, "conditions.axial_depth_mm: True is no number"),
    "number for a text": ('title = "slot cuts"', "title = 5", 1, "title: 5 is no text"),
    "fraction of a tooth": ("teeth = 2", "teeth = 2.5", 5, "cutter.teeth: 2.5 is no whole number"),
    "no tooth": ("teeth = 2", "teeth = 0", 5, "cutter.teeth: 0 is below 1; give number of teeth"),
    "negative diameter": ("diameter_mm = 25", "diameter_mm = -25", 4, "cutter.diameter_mm: -25 is not above 0"),
    "infinite": ("diameter_mm = 25", "diameter_mm = inf", 4, "cutter.diameter_mm: inf is not finite"),
    "not a number": ("axial_depth_mm = 3", "axial_depth_mm = nan", 15, "is not finite"),
    "zero rpm": ("spindle_speed_rpm = 6001", "spindle_speed_rpm = 0", 25, "cuts.1.spindle_speed_rpm: 0 is not above 0"),
    "helix upright": ("helix_deg = 45.0", "helix_deg = 90", 6, "cutter.helix_deg: 90 is not below 89"),
    "pitch count": ("teeth = 2", "teeth = 2\npitch_deg = [120, 120, 120]", 6, "3 pitches for 2 teeth"),
    "pitch sum": ("teeth = 2", "teeth = 2\npitch_deg = [180, 170]", 6, "add up to 350 degrees; make it 360"),
    "direction": ('"slot"', '"climb"', 16, "conditions.direction: 'climb' is not 'up', 'down' or 'slot'"),
    "radial depth too large": (
        'direction = "slot"', 'direction = "up"\nradial_depth_mm = 26', 17, "26 is more than the diameter, 25; correct one"
    ),
    "no slot": ("axial_depth_mm = 3", "axial_depth_mm = 3\nradial_depth_mm = 5", 16, "5 is no slot of a cutter of 25 mm"),
    "radial depth missing": ('direction = "slot"', 'direction = "up"', 17, "cuts.0.radial_depth_mm: is missing"),
    "depth missing": ("axial_depth_mm = 3\n", "", 16, "cuts.0.axial_depth_mm: is missing"),
    "both feeds": (
        "feed_per_tooth_mm = 0.05", "feed_per_tooth_mm = 0.05\nfeed_mm_per_min = 600", 24, "give one of the two"
    ),
    "no feed": ("feed_mm_per_min = 300\n", "", 17, "cuts.0.feed_per_tooth_mm: is missing"),
    "steady reversed": ("[0.1, 0.9]", "[0.9, 0.1]", 20, "cuts.0.steady_s: [0.9, 0.1] does not rise"),
    "steady too short": ("[0.1, 0.9]", "[0.9]", 20, "cuts.0.steady_s: has too few items; give [from, to]"),
    "steady no list": ("[0.1, 0.9]", "0.9", 20, "cuts.0.steady_s: 0.9 is no list"),
    "modes of no FRF": ("[stability]", "[modes]\nmodes = 3\n[stability]", 32, "modes: no [impact] to fit modes to"),
    "map of no FRF": ("rpm = [3000, 12000]", 'rpm = [3000, 12000]\ndynamics = "frf"', 34, "no [impact] to take an FRF from"),
    "other dynamics": (
        "rpm = [3000, 12000]", 'rpm = [3000, 12000]\ndynamics = "modal"', 34, "is not 'frf', 'corrected' or 'modes'"
    ),
    "rpm reversed": ("rpm = [3000, 12000]", "rpm = [12000, 3000]", 33, "stability.rpm"),
    "half an operating point": ("axial_depth_mm = 2\n", "", 34, "half an operating point"),
    "method": ('"average"', '"avarage"', 27, "coefficients.method: 'avarage' is not 'nls', 'average', 'smooth'"),
    "acts on": ('"workpiece"', '"table"', 7, "acts_on = 'table' is neither tool nor workpiece"),
    "column twice": ('fy = "Fx"', 'fy = "-Fy"', 7, "column Fy is used more than once"),
    "no column": ('fy = "Fx"', 'fy = "-"', 7, "fy names no column"),
    "mode axis": ('axis = "x"', 'axis = "a"', 30, "structure.modes.0.axis: 'a' is not 'x', 'y' or 'z'"),
    "mode damping": ("zeta = 0.02", "zeta = 2", 30, "structure.modes.0.zeta: 2 is not below 1"),
    "expect no interval": ("[690, 720]", "[690]", 37, "is neither [lowest, highest] nor a text"),
    "expect reversed": ("[690, 720]", "[720, 690]", 37, "is the wrong way round"),
    "expect no path": ("verdict =", '"a..b" =', 36, "no dotted path"),
    "cuts no array": ("[[cuts]]\nrecording = \"data/f300.csv\"\nfeed_mm_per_min = 300\nsteady_s = [0.1, 0.9]\n[[cuts]]",
                      "[cuts]", 17, "cuts: this is no list"),
    "negative seed": ("seed = 3", "seed = -3", 2, "seed: -3 is below 0"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_a_mistake_is_one_line_with_file_line_and_key(kind, tmp_path):
    old, new, line, said = BAD[kind]
    path = written(tmp_path, changed(old, new))
    with pytest.raises(RecipeError) as caught:
        read_recipe(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}:"), message
    assert said in message
    assert "; " in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no [[cuts]], no [impact], no [sensor] and no [simulate]"),
        ('[cutter]\ndiameter_mm = 3\nteeth = 1\n[impact]\nrecordings = []\n', "impact.recordings"),
        ('[[cuts]]\nrecording = "a"\nspindle_speed_rpm = 1\nfeed_per_tooth_mm = 1\naxial_depth_mm = 1\n'
         'direction = "slot"\n', "conditions without a cutter"),
        ('[[cuts]]\nrecording = "a"\n[stability]\nrpm = [1, 2]\n', "no [cutter] for the map"),
    ],
)  # fmt: skip
def test_what_is_missing_altogether_is_said_too(text, said, tmp_path):
    with pytest.raises(RecipeError, match=r"recipe\.toml") as caught:
        read_recipe(written(tmp_path, text))
    assert said in str(caught.value)


def test_a_recipe_that_is_absent_or_not_text_is_one_line(tmp_path):
    with pytest.raises(RecipeError, match=r"absent\.toml: no such file or directory; check the path"):
        read_recipe(tmp_path / "absent.toml")
    (tmp_path / "b.toml").write_bytes(b'title = "\xe9"\n')
    with pytest.raises(RecipeError, match=r"b\.toml:1: not UTF-8"):
        read_recipe(tmp_path / "b.toml")
    with pytest.raises(RecipeError, match="is a directory"):
        read_recipe(tmp_path)


def tables_of(model, seen):
    """All models below a model."""
    from millcal.io.toml_documents import model_in

    if model not in seen:
        seen.add(model)
        for info in model.model_fields.values():
            inner = model_in(info.annotation)
            if inner is not None:
                tables_of(inner, seen)
    return seen


@pytest.mark.parametrize("model", sorted(tables_of(RecipeTables, set()) | tables_of(SetupTables, set()), key=str))
def test_every_key_is_documented(model: type[BaseModel]):
    undocumented = [key for key, info in model.model_fields.items() if not info.description]
    assert not undocumented
    assert model.__doc__
