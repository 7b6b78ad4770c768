"""The `[simulate]` table in SI: laws, chains and faults as the simulation takes them."""

import numpy as np
import pytest
from pydantic import ValidationError

from millcal.io.recipe_simulate import (
    AccelerometerTable,
    DynamometerTable,
    LawTable,
    SimulatedCutTable,
    SimulatedImpactTable,
    SimulateTable,
)
from millcal.physics.changing_coefficients import STEADY, Chip
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.physics.measuring_chain import MeasuringChain

LINEAR = {"Ktc_N_per_mm2": 800.0, "Krc_N_per_mm2": 250.0, "Kac_N_per_mm2": 90.0}
LINEAR |= {"Kte_N_per_mm": 20.0, "Kre_N_per_mm": 18.0, "Kae_N_per_mm": 4.0}
KIENZLE = {"kt_N_per_mm2": 700.0, "kr_N_per_mm2": 200.0, "ka_N_per_mm2": 80.0, "mt": 0.25, "mr": 0.4, "ma": 0.3}


def test_the_two_laws_are_told_apart_by_their_keys():
    linear, kienzle = LawTable(**LINEAR).law(), LawTable(**KIENZLE).law()
    assert isinstance(linear, LinearEdge)
    assert np.array_equal(linear.cutting, [800e6, 250e6, 90e6])
    assert np.array_equal(linear.edge, [20e3, 18e3, 4e3])
    assert isinstance(kienzle, Kienzle)
    assert np.array_equal(kienzle.specific_force, [700e6, 200e6, 80e6])
    assert np.array_equal(kienzle.rise, [0.25, 0.4, 0.3])


@pytest.mark.parametrize("keys", [{}, LINEAR | KIENZLE, LINEAR | {"mt": 0.2}, {"kt_N_per_mm2": 700.0}])
def test_half_a_law_or_two_of_them_are_refused(keys):
    with pytest.raises(ValidationError, match="is no whole law"):
        LawTable(**keys)


def test_a_chain_without_keys_changes_nothing():
    assert DynamometerTable().chain() == MeasuringChain(offset=(0, 0, 0), drift=(0, 0, 0), warming=(0, 0, 0))


def test_the_keys_of_a_chain_become_si():
    chain = DynamometerTable(
        resonance_hz=(900.0, 1100.0, 2000.0),
        zeta=(0.03, 0.05, 0.02),
        drift_N_per_s=(1.0, 2.0, 3.0),
        full_scale_N=2000.0,
    ).chain()
    assert chain.damping_ratio == (0.03, 0.05, 0.02)
    assert chain.drift == (1.0, 2.0, 3.0)
    assert chain.full_scale == 2000.0
    assert AccelerometerTable(noise_g=2.0).chain().noise == pytest.approx(2 * 9.80665)


def test_a_resonance_needs_its_damping():
    with pytest.raises(ValidationError, match="belong together"):
        DynamometerTable(zeta=(0.03, 0.05, 0.02))


def test_the_faults_of_an_impact_test_become_si():
    table = SimulatedImpactTable(
        recording="tap.h5", hammer="tipX", accelerometers=("tipX",), hits=3, record_s=0.2, peak_N=300.0, pulse_ms=0.25,
        faults=({"hit": 1, "kind": "double", "ratio": 0.4, "delay_ms": 7.0},),
    )  # fmt: skip
    arguments = table.arguments()
    assert arguments["pulse"] == pytest.approx(0.25e-3)
    assert arguments["faults"][0].delay == pytest.approx(7e-3)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({}, "nothing to simulate"),
        ({"cuts": ({"recording": "a.h5", "duration_s": 1.0},)}, "cuts without a law"),
        (
            {"cuts": ({"recording": "a.h5", "duration_s": 1.0, "accelerometers": ("tipX",)},), "law": LINEAR},
            "simulate.modes",
        ),
        (
            {"cuts": ({"recording": "a.h5", "duration_s": 1.0, "dynamometer": False},), "law": LINEAR},
            "nothing is measured",
        ),
        (
            {
                "cuts": ({"recording": "a.h5", "duration_s": 1.0},),
                "law": LINEAR,
                "dynamometer": {"map": {"fx": "+Fy", "fy": "+Fx", "fz": "+Fz"}},
            },
            "a map for a cut in .h5",
        ),
    ],
)
def test_what_cannot_be_simulated_says_what_it_lacks(table, says):
    with pytest.raises(ValidationError, match=says):
        SimulateTable(**table)


def a_cut(**keys):
    return {"recording": "a.h5", "duration_s": 4.0} | keys


def test_a_share_rises_over_the_steady_cut_and_points_stand_as_they_are():
    points = [[0.5, 1.0], [2.0, 1.1]]
    table = SimulatedCutTable(**a_cut(drift={"t": 0.2, "a": points}, chip={"time_s": 2.4, "size": 0.12}))
    trend = table.trend((1.0, 5.0))
    assert trend.drift == (((1.0, 1.0), (5.0, 1.2)), ((1.0, 1.0), (5.0, 1.0)), ((0.5, 1.0), (2.0, 1.1)))
    assert trend.shape == (STEADY, STEADY, STEADY)
    assert trend.chips == (Chip(2.4, (0.12, 0.12, 0.12)),)


def test_a_cut_without_these_keys_has_no_trend():
    assert SimulatedCutTable(**a_cut()).trend((1.0, 5.0)) is None


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"drift": -1.0}, "takes away all"),
        ({"drift": "0.2"}, "is no course"),
        ({"drift": [[0.0, 1.0], [1.0, 1.1], [0.5, 1.2]]}, "back in time"),
        ({"drift": [[0.0, 1.0], [1.0, -0.1]]}, "a factor of -0.1"),
        ({"drift": {"x": 0.2}}, "direction 'x'"),
        ({"chip": {"time_s": 1.0, "size": "much"}}, "is no size"),
    ],
)
def test_what_is_no_trend_says_why(keys, says):
    with pytest.raises(ValidationError, match=says):
        SimulatedCutTable(**a_cut(**keys))


@pytest.mark.parametrize(("law", "key"), [(LINEAR, "drift_rise"), (KIENZLE, "drift_edge")])
def test_a_law_has_no_trend_of_what_it_does_not_have(law, key):
    with pytest.raises(ValidationError, match=f"{key} for a law that has none"):
        SimulateTable(law=law, cuts=(a_cut(**{key: 0.1}),))


REGENERATIVE = {"recording": "c.h5", "duration_s": 1.0, "regenerative": True}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "nothing is measured"),
        ({"displacements": ("tipX",), "recording": "c.csv"}, "is no .h5"),
        ({"displacements": ("tipX",), "ramp_s": 0.1}, "ramp_s is not for"),
        ({"displacements": ("tipX",), "regenerative": False}, "not regenerative"),
    ],
)
def test_what_a_regenerative_cut_cannot_have_is_refused(keys, said):
    with pytest.raises(ValidationError, match=said):
        SimulatedCutTable(**(REGENERATIVE | keys))
