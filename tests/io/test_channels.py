"""Units, axes and signs: stated, never guessed."""

import numpy as np
import pytest

from millcal.io.channels import choose_channels
from millcal.io.formats.source import Column
from millcal.io.keys import ChannelTable

DYNO = (Column("Time", "s"), Column("Fx", "N"), Column("Fy", "N"), Column("Fz", "N"))


def chosen(columns, **more):
    options = {"mapping": {}, "units": {}, "tables": {}, "acts_on": None, **more}
    return choose_channels(columns, where="cut.csv", **options)


def test_a_map_names_turns_and_orders_the_channels():
    selection = chosen(DYNO, mapping={"fx": "+Fy", "fy": "-Fx"})
    assert selection.rows == (2, 1)
    assert selection.gains.tolist() == [1, -1]
    assert [(c.name, c.dof) for c in selection.channels] == [("fx", "tipX"), ("fy", "tipY")]
    assert selection.mapping == {"fx": "+Fy", "fy": "-Fx"}
    assert [notice.code for notice in selection.notices] == ["columns-left-out"]


def test_without_a_map_every_column_keeps_its_name():
    selection = chosen(DYNO)
    assert [(c.name, c.dof) for c in selection.channels] == [("Fx", "Fx"), ("Fy", "Fy"), ("Fz", "Fz")]
    assert (selection.time, selection.time_scale) == (0, 1.0)


def test_the_reaction_on_the_workpiece_is_turned_unless_the_file_says_it_was():
    columns = (Column("fx", "N"), Column("fy", "N", acts_on="tool"), Column("a", "g"))
    selection = chosen(columns, acts_on="workpiece")
    np.testing.assert_allclose(selection.gains, [-1, 1, 9.80665])
    assert chosen((Column("fx", "N", acts_on="workpiece"),)).gains.tolist() == [-1]


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("N", "N", 1), ("kN", "N", 1e3), ("lbf", "N", 4.4482216152605), ("g", "m/s^2", 9.80665), ("m/s²", "m/s^2", 1),
        ("µm", "m", 1e-6), ("mm", "m", 1e-3), ("m", "m", 1),
        ("2.25 mV/N", "N", 1 / 2.25e-3), ("-100 mV/g", "m/s^2", -98.0665), ("0.01 V/N", "N", 100), ("mV, 10 mV/N", "N", 0.1),
        ("8 V/mm", "m", 1.25e-4), ("-3.7 pC/N", "N", -1 / 3.7),
    ],
)  # fmt: skip
def test_a_stated_unit_or_sensitivity_is_a_factor_to_si(unit, si, factor):
    selection = chosen((Column("Ax"),), units={"Ax": unit})
    assert selection.channels[0].unit == si
    assert selection.gains[0] == pytest.approx(factor, rel=1e-12)


def test_a_column_in_millivolts_needs_no_second_word():
    selection = chosen((Column("Ax", "mV"),), units={"Ax": "100 mV/g"})
    assert selection.gains[0] == pytest.approx(0.0980665)


def test_all_that_is_missing_is_told_at_once():
    columns = (Column("a"), Column("b", "stone"), Column("c", "V"), Column("d", "N"))
    problems = chosen(columns).problems
    assert [problem.split(";")[0] for problem in problems] == [
        "column 'a' has no unit",
        "column 'b': unknown unit 'stone'",
        "column 'c' is in V",
    ]
    assert all("--unit" in problem for problem in problems)


def test_a_dof_comes_from_the_map_or_the_name_and_its_minus_turns():
    columns = (Column("force", "N"), Column("acc_tipX", "g"), Column("c", "g", dof="-holdY"))
    assert [c.dof for c in chosen(columns).channels] == ["force", "tipX", "holdY"]
    assert chosen(columns).gains[2] == pytest.approx(-9.80665)
    mapped = chosen(columns, mapping={"hammer@tipZ": "force", "acc@-noseX": "acc_tipX"})
    assert [(c.name, c.dof) for c in mapped.channels] == [("hammer", "tipZ"), ("acc", "noseX")]
    assert mapped.gains[1] < 0


def test_a_table_of_a_setup_renames_scales_and_gives_the_range():
    tables = {
        "hammer": ChannelTable(column="col2", sensitivity="10 mV/N", dof="tipX", full_scale=5.0),
        "once": ChannelTable(column="col3", quantity="pulse"),
        "rest": ChannelTable(column="col4", quantity="ignore"),
        "t": ChannelTable(column="col1", quantity="time"),
    }
    columns = (Column("col1", "ms"), Column("col2"), Column("col3", "V"), Column("col4"))
    selection = chosen(columns, tables=tables)
    assert selection.problems == ()
    assert [(c.name, c.quantity, c.unit, c.dof, c.full_scale) for c in selection.channels] == [
        ("hammer", "force", "N", "tipX", 500.0),
        ("once", "pulse", "1", "once", None),
    ]
    assert (selection.time, selection.time_scale) == (0, 1e-3)


def test_a_table_says_which_force_answers_the_hammer_and_the_map_which_column_it_is():
    columns = (Column("Time", "s"), Column("Ch1", "N"), Column("Ch2", "N"))
    selection = chosen(
        columns,
        mapping={"hammer@tipX": "Ch1", "fx": "-Ch2"},
        tables={"fx": ChannelTable(role="response"), "hammer": ChannelTable(role="hammer")},
    )
    assert not selection.problems
    assert [(c.name, c.dof, c.role) for c in selection.channels] == [
        ("hammer", "tipX", "hammer"),
        ("fx", "tipX", "response"),
    ]
    assert selection.gains.tolist() == [1, -1]


def test_only_a_force_can_be_the_hammer():
    selection = chosen((Column("a", "g"),), tables={"a": ChannelTable(role="hammer")})
    assert "hammer is for a force" in selection.problems[0]


def test_a_unit_of_another_kind_than_the_quantity_is_told():
    tables = {"a": ChannelTable(quantity="force")}
    assert "is in g, which is no force" in chosen((Column("a", "g"),), tables=tables).problems[0]


def test_a_torque_beside_the_forces_is_left_out_with_a_word():
    selection = chosen((*DYNO, Column("Mz", "Nm")))
    assert len(selection.channels) == 3
    assert "'Mz' in Nm is left out" in selection.notices[0].message


def test_a_second_time_column_is_left_out_with_a_word():
    selection = chosen((Column("Time 1", "s"), Column("Fx", "N"), Column("Time 2", "s"), Column("Fy", "N")))
    assert (selection.time, selection.rows, selection.problems) == (0, (1, 3), ())
    assert "Time 2" in selection.notices[0].message
