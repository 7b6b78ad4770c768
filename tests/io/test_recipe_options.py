"""The recipe's table of a stage is the keyword arguments of that stage, with the same defaults."""

import inspect
from dataclasses import fields
from typing import Literal, get_args, get_origin

import pytest

from millcal.io.recipe_tables import (
    CoefficientsTable,
    ConditioningTable,
    ForcesTable,
    FrfTable,
    ModesTable,
    StabilityTable,
)
from millcal.stages.coefficients.choice import identify_coefficients
from millcal.stages.conditioning import condition_cut
from millcal.stages.forces import reconstruct_forces
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import fit_modes
from millcal.stages.stability import map_stability

# arguments that the pipeline takes from elsewhere: the cut's entry, the cutter, a file, the seed, the bar
STAGES = {
    "conditioning": (ConditioningTable, condition_cut, {"steady", "air", "progress"}),
    "frf": (FrfTable, estimate_frf, {"progress"}),
    "modes": (ModesTable, fit_modes, {"progress"}),
    "forces": (ForcesTable, reconstruct_forces, {"modes", "progress"}),
    "coefficients": (CoefficientsTable, identify_coefficients, {"sensor", "smoothing", "rng", "progress"}),
    "stability": (
        StabilityTable,
        map_stability,
        {"modes", "teeth", "diameter", "pitch", "helix", "runout", "edge", "tests", "rng", "progress"},
    ),
}
REPLACED = {"operating_speed", "axial_depth"}  # together they are the operating point


def options_of(function):
    parameters = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("name", STAGES)
def test_the_keys_of_a_table_are_the_options_of_its_stage(name):
    table, function, from_elsewhere = STAGES[name]
    given = {"rpm": (1000.0, 2000.0)} if name == "stability" else {}
    arguments = set(table(**given).arguments())
    if arguments >= REPLACED:
        arguments = arguments - REPLACED | {"operating_point"}
    assert arguments == set(options_of(function)) - from_elsewhere


@pytest.mark.parametrize("name", STAGES)
def test_what_a_table_leaves_out_is_what_the_stage_takes_by_default(name):
    table, function, _ = STAGES[name]
    given = {"rpm": (1000.0, 2000.0)} if name == "stability" else {}
    options = options_of(function)
    for argument, value in table(**given).arguments().items():
        default = options.get(argument, inspect.Parameter.empty)
        if default is not inspect.Parameter.empty:
            assert value == default, argument


@pytest.mark.parametrize("name", STAGES)
def test_every_choice_of_a_table_is_one_that_its_stage_speaks_of(name):
    table, function, _ = STAGES[name]
    known = inspect.getdoc(function) + inspect.getsource(inspect.getmodule(function))
    for key, info in table.model_fields.items():
        for choice in get_args(info.annotation) if get_origin(info.annotation) is Literal else ():
            assert choice in known, (key, choice)


def test_every_record_field_is_declared_so_that_it_can_be_stored():
    """Nothing but arrays with metadata, plain values, nested dataclasses and tuples of them stands in a record."""
    from millcal import data

    names = ("CutForce", "CutVibration", "Frf", "Modes", "ModalFit", "Posterior", "Coefficients", "StabilityMap")
    for name in (*names, "ForceHarmonics", "SpeedAdvice"):
        for field in fields(getattr(data, name)):
            assert "dims" in field.metadata or "ndarray" not in str(field.type), (name, field.name)
