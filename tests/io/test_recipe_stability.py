"""The `[stability]` table: methods and what goes with them, test cuts, process damping."""

import re

import pytest

from millcal.errors import RecipeError
from millcal.io.recipe_tables import StabilityTable
from millcal.io.recipes import read_recipe

HIT = '[impact]\nrecordings = ["tap.h5"]\n'
BY_HAND = '[[structure.modes]]\naxis = "x"\nfn_hz = 900\nzeta = 0.02\nk_N_per_m = 1e6\n'


@pytest.fixture
def read(tmp_path):
    """A recipe with dynamics, keys of [stability] and more of [cutter]."""

    def read(keys, dynamics=HIT, cutter=""):
        path = tmp_path / "recipe.toml"
        path.write_text(
            f"[cutter]\ndiameter_mm = 16\nteeth = 2\n{cutter}\n{dynamics}\n[stability]\nrpm = [4000, 12000]\n{keys}\n"
            '[[cuts]]\nrecording = "a.h5"\n'
        )
        return read_recipe(path)

    return read


def test_keys_are_arguments_in_si(read):
    recipe = read(
        'method = "floquet"\ndeepest_mm = 4\nprocess_damping_N_per_mm = 20\nfriction = 0.4\nprobability = 30\n'
        'simulate = [20, 10]\ntests = "log/cuts.csv"'
    )
    given = recipe.stability.arguments()
    assert (given["deepest"], given["indentation"]) == pytest.approx((4e-3, 20e3))
    assert (given["indentation_friction"], given["probability"], given["simulate"]) == (0.4, 30, (20, 10))
    assert "tests" not in given
    assert recipe.test_cuts == recipe.path.parent / "log" / "cuts.csv"
    assert recipe.test_cuts in recipe.recordings


def test_a_map_without_test_cuts_reads_none(read):
    assert read("").test_cuts is None


@pytest.mark.parametrize(
    ("keys", "more", "says"),
    [
        ('method = "magic"', {}, "stability.method"),
        ('method = "frf"', {"dynamics": BY_HAND}, "stability.method: no [impact] to take an FRF from"),
        ('method = "frf"', {"cutter": "helix_deg = 30"}, "stability.method: frf knows straight teeth alone"),
        ('method = "frf"', {"cutter": "pitch_deg = [170, 190]"}, "stability.method: frf knows one pitch alone"),
        ('method = "frf"\ndynamics = "modes"', {}, "stability.dynamics: method frf is of the FRF as measured"),
        ('method = "floquet"\ndynamics = "frf"', {}, "stability.dynamics: method floquet is of modes"),
        ('method = "floquet"', {"dynamics": f"{HIT}[modes]\nfit = false\n"}, "floquet is of modes, and [modes] says that none"),
        ('method = "zoa"\nprocess_damping_N_per_mm = 5', {}, "stability.process_damping_N_per_mm: method zoa knows none"),
        ("friction = 0.4", {}, "stability.friction: counts with process_damping_N_per_mm alone"),
        ("process_damping_N_per_mm = -5", {}, "stability.process_damping_N_per_mm"),
        ("deepest_mm = 0", {}, "stability.deepest_mm"),
        ("probability = true\nmembers = 0", {}, "stability.probability: needs draws"),
        ("simulate = [0, 5]", {}, "stability.simulate"),
        ('tests = " "', {}, "stability.tests: is empty"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused_at_its_line(read, keys, more, says):
    with pytest.raises(RecipeError) as refused:
        read(keys, **more)
    assert re.search(r"recipe\.toml:\d+: ", str(refused.value))
    assert says in str(refused.value)


def test_the_methods_of_a_recipe_are_those_of_the_command():
    from typing import get_args

    from millcal.cli.stability_input import METHODS, OF_MODES

    named, absent = get_args(StabilityTable.model_fields["method"].annotation)
    assert (get_args(named), absent) == (METHODS, type(None))
    assert StabilityTable.OF_MODES == OF_MODES
