"""Names and units as files write them."""

import pytest

from millcal.io.formats.dynoware import keys_of, stated_rate, stated_rows
from millcal.io.formats.headers import is_time, is_units_row, name_and_unit, unique_names


@pytest.mark.parametrize(
    ("cell", "name", "unit"),
    [
        ("Fx [N]", "Fx", "N"), ("Fx(kN)", "Fx", "kN"), ('"Fx [N]"', "Fx", "N"), ("Fx / N", "Fx", "N"), ("a/m/s^2", "a", "m/s^2"),
        ("Ax in g", "Ax", "g"), ("acc_tipX_m_s2", "acc_tipX", "m/s^2"), ("time_s", "time", "s"), ("力（N）", "力", "N"),
        ("Fx [stone]", "Fx", "stone"), ("Fx []", "Fx", None), ("Force (left)", "Force (left)", None), ("ch_1", "ch_1", None),
        ("ratio a/b", "ratio a/b", None), ("Fx", "Fx", None), ("F_n", "F_n", None), ("m/s", "m/s", None),
    ],
)  # fmt: skip
def test_a_header_cell_is_a_name_and_the_unit_it_states(cell, name, unit):
    assert name_and_unit(cell) == (name, unit)


@pytest.mark.parametrize("name", ["Time", "t", "TIME", "Zeit", "ActualTime", "X_Value", "时间", "timestamp"])
def test_the_time_is_known_by_its_name(name):
    assert is_time(name, None)


@pytest.mark.parametrize("name", ["Fx", "tool", "timer", "torque", "T1"])
def test_other_names_are_no_time(name):
    assert not is_time(name, None)


def test_a_row_of_units_is_told_from_a_row_of_names():
    assert is_units_row(["s", "N", "N", "kN"])
    assert is_units_row(["[s]", "(N)", "m/s²", "µm"])
    assert is_units_row(["s", "N", "stone", ""])
    assert not is_units_row(["Time", "Fx", "Fy", "Fz"])
    assert not is_units_row(["", "", ""])


def test_equal_names_get_numbers_and_empty_ones_their_place():
    assert unique_names(["Fx", "", "Fx", "Fx"]) == (["Fx", "col2", "Fx_2", "Fx_3"], ["Fx", "Fx"])


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("Sampling rate [Hz]:,10000", 1e4), ("Sample Rate (kHz);51,2", 51200.0), ("# fs = 25.6 kHz", 25600.0),
        ("Sampling frequency: 2000 Hz", 2000.0), ("Sample rate:\t48000 S/s", 48000.0), ("fs: 10000", None), ("Delay [Hz]:,3", None),
    ],
)  # fmt: skip
def test_a_header_states_its_rate_with_a_unit(line, rate):
    assert stated_rate(keys_of([line])) == (pytest.approx(rate) if rate else None)


def test_the_header_promises_rows():
    assert stated_rows(keys_of(["Samples per channel:,500001"])) == 500001
