"""Universal files: their datasets as they are in the field, and time records as recordings. The other reader is pyuff."""

import re
import struct

import h5py
import numpy as np
import pytest
import pyuff

from millcal.errors import RecordingError
from millcal.io.formats.uff_dofs import dof_names, nodes_of, split_dof
from millcal.io.formats.universal import is_universal, read_universal
from millcal.io.formats.universal_records import Dof
from millcal.io.inspection import inspect_recording
from millcal.io.recipes import Setup
from millcal.io.recordings import read_recording

RATE = 51200.0
ACCELERATION, FORCE, TIME, FREQUENCY = 12, 13, 17, 18


def header(**changes):
    """The eleven header lines of a dataset 58."""
    form = {"ordinate": 4, "count": 4, "even": 1, "first": "  0.00000E+00", "step": "  1.00000E-03"} | changes
    kind, dof, below = changes.get("kind", 1), changes.get("dof", (1, 1)), changes.get("reference", (0, 0))
    entity, x_kind = changes.get("entity", "NONE"), changes.get("x_kind", TIME)
    y_kind, y_unit = changes.get("y_kind", ACCELERATION), changes.get("y_unit", "m/s^2")
    return [
        *["NONE"] * 5,
        f"{kind:5d}{1:10d}{0:5d}{0:10d} {entity:<10}{dof[0]:10d}{dof[1]:4d} {'NONE':<10}{below[0]:10d}{below[1]:4d}",
        f"{form['ordinate']:10d}{form['count']:10d}{form['even']:10d}{form['first']}{form['step']}  0.00000E+00",
        f"{x_kind:10d}    0    0    0 {'NONE':<20} {changes.get('x_unit', 's'):<20}",
        f"{y_kind:10d}    0    0    0 {'NONE':<20} {y_unit:<20}",
        f"{changes.get('below', 0):10d}    0    0    0 {'NONE':<20} {'NONE':<20}",
        f"{0:10d}    0    0    0 {'NONE':<20} {'NONE':<20}",
    ]


def text_record(body, end="\n", **changes):
    """A dataset 58 with these lines of numbers."""
    return end.join(["    -1", "    58", *header(**changes), *body, "    -1", ""]).encode("latin-1")


def binary_record(data, *, order=1, stated=None, behind=b"", encoding=2, **changes):
    """A dataset 58b with these bytes."""
    stated = len(data) if stated is None else stated
    mark = f"    58b{order:6d}{encoding:6d}{11:12d}{stated:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    lines = "\n".join(["    -1", mark, *header(**changes), ""])
    return lines.encode() + data + behind + b"    -1\n"


def units(code=1, length=1.0, force=1.0):
    """A dataset 164."""
    factors = f"{length:25.16e}{force:25.16e}{1.0:25.16e}\n{273.15:25.16e}".replace("e", "D")
    return f"    -1\n   164\n{code:10d}{'Some units':<20}{1:10d}\n{factors}\n    -1\n".encode()


def only(path, data):
    path.write_bytes(data)
    (function,) = read_universal(path).functions
    return function


def values_of(path):
    return [function.values() for function in read_universal(path).functions]


def samples(n=64, seed=1):
    return np.random.default_rng(seed).normal(size=n)


def pyuff_set(y, x, kind=1, **more):
    return {
        "type": 58, "func_type": kind, "rsp_node": 1, "rsp_dir": 1, "ref_node": 0, "ref_dir": 0, "data": y, "x": x,
        "orddenom_spec_data_type": 0, "abscissa_spec_data_type": TIME, "abscissa_spacing": 1, "binary": 0, **more,
    }  # fmt: skip


# ---- datasets


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("even", [0, 1])
@pytest.mark.parametrize("is_complex", [False, True])
def test_what_pyuff_writes_is_read_in_every_form(tmp_path, binary, double, even, is_complex):
    if binary and not double:
        pytest.skip("pyuff writes doubles under the header of singles")
    y = samples() + (1j * samples(seed=2) if is_complex else 0)
    x = np.arange(64) / 1024
    ordinate = {(False, False): 2, (False, True): 4, (True, False): 5, (True, True): 6}[is_complex, double]
    more = {"binary": binary, "abscissa_spacing": even, "ord_data_type": ordinate}
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(pyuff_set(y, x, 4 if is_complex else 1, **more), force_double=double)
    function = read_universal(tmp_path / "a.uff").functions[0]
    digits = 0 if binary else 1e-5 if not double else 1e-11
    np.testing.assert_allclose(function.values(), y, rtol=0, atol=digits * 4)
    np.testing.assert_allclose(function.x(), x, rtol=0 if binary and not even else 1e-5, atol=0)
    assert function.is_complex == is_complex


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("width", ["f", "d"])
@pytest.mark.parametrize("x_width", ["", "f", "d"])
def test_binary_numbers_of_either_order_and_width_are_read_to_the_bit(tmp_path, order, width, x_width):
    y = samples().astype("f4" if width == "f" else "f8")
    x = (np.arange(64) / 64).astype("f4")
    rows = [struct.pack(order + x_width + width, *((a, b) if x_width else (b,))) for a, b in zip(x, y, strict=True)]
    changes = {"ordinate": 2 if width == "f" else 4, "count": 64, "even": 0 if x_width else 1}
    data = binary_record(b"".join(rows), order=1 if order == "<" else 2, **changes)
    if (x_width, width) == ("d", "f"):
        return  # nobody writes it
    function = only(tmp_path / "a.uff", data)
    np.testing.assert_array_equal(function.values(), y)
    np.testing.assert_array_equal(function.values(10, 20), y[10:20])
    if x_width:
        np.testing.assert_array_equal(function.x(), x)


@pytest.mark.parametrize("behind", [b"", b"\n", b"\r\n", b"\x00" * 7])
@pytest.mark.parametrize("stated", [None, 64 * 4, 64 * 8 + 7, 0])
def test_a_wrong_byte_count_and_a_line_end_behind_the_numbers_do_no_harm(tmp_path, behind, stated):
    y = samples()
    data = binary_record(y.tobytes(), behind=behind, stated=stated, count=64)
    (tmp_path / "a.uff").write_bytes(data + binary_record(2 * y.tobytes()[:512], count=64))
    found = read_universal(tmp_path / "a.uff").functions
    assert len(found) == 2
    np.testing.assert_array_equal(found[0].values(), y)


def test_numbers_that_look_like_the_end_of_a_record_are_numbers(tmp_path):
    y = samples(8)
    y[3] = struct.unpack("<d", b"\n    -1\n")[0]
    function = only(tmp_path / "a.uff", binary_record(y.tobytes(), count=8))
    np.testing.assert_array_equal(function.values(), y)


@pytest.mark.parametrize(
    ("lines", "changes"),
    [
        (["  1.00000E+00 -2.50000E+00  3.00000E+00  4.00000E+00"], {"ordinate": 2}),
        (["-1.00000E-001-2.50000E+000-3.00000E+000-4.00000E+000"], {"ordinate": 2}),  # three digits fill the column
        (["  1.00000D+00 -2.50000D+00  3.00000D+00  4.00000D+00"], {"ordinate": 2}),
        (["  1.00000-101 -2.50000E+00  3.00000E+00  4.00000E+00"], {"ordinate": 2}),  # the letter gives way
        (["  1.00000E+00", "-2.5", "", "3 4."], {"ordinate": 2}),
        (["  1.000000000000E+00 -2.500000000000E+00  3.000000000000E+00  4.000000000000E+00"], {}),
        (["  1.000000000000E+00 -2.500000000000E+00  3.000000000000E+00  4.000000000000E+00", "  0.0"], {}),  # padded
    ],
)  # fmt: skip
def test_columns_that_touch_and_numbers_of_fortran_are_read(tmp_path, lines, changes):
    values = only(tmp_path / "a.uff", text_record(lines, **changes)).values()
    assert values.tolist()[1:] == ([-2.5, 3, 4] if lines[0][0] == " " else [-2.5, -3, -4])
    assert abs(values[0]) in (1, 0.1, 1e-101)


def test_uneven_text_columns_are_read(tmp_path):
    lines = [f"{x:13.5E}{10 * x:20.12E}{x + 1:13.5E}{10 * x + 10:20.12E}" for x in (0, 2.5)]
    function = only(tmp_path / "a.uff", text_record(lines, even=0, step="  0.00000E+00"))
    assert (function.x().tolist(), function.values().tolist()) == ([0, 1, 2.5, 3.5], [0, 10, 25, 35])


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("shift", [0, 2])
def test_line_ends_and_shifted_columns_do_no_harm(tmp_path, end, shift):
    data = text_record(["1 2 3 4"], end, entity="tip", dof=(7, -2))
    if shift:
        data = re.sub(rb"\n    1  ", b"\n  1 ", data, count=1).replace(b"         4         4         1", b"4 4 1")
    function = only(tmp_path / "a.uff", data)
    assert function.response == Dof("tip", 7, -2)
    assert function.values().tolist() == [1, 2, 3, 4]


def test_other_datasets_units_and_author_are_found(tmp_path):
    author = b"    -1\n   151\nmodel.db\nsomething\nDBAPP\n01-Jan-20\n01-Jan-20\nANALYSER\n01-Jan-20\n    -1\n"
    nodes = b"    -1\n  2411\n         1         1         1        11\n   -1.0   2.0   3.0\n    -1\n"
    data = author + units(5, 1000, 1000) + nodes + text_record(["1 2 3 4"]) + nodes
    (tmp_path / "a.unv").write_bytes(data)
    found = read_universal(tmp_path / "a.unv")
    assert (found.program, found.model, found.others) == ("ANALYSER", "model.db", {2411: 2})
    assert found.functions[0].units.length == 1000


def test_units_behind_the_records_hold_for_them_too(tmp_path):
    assert only(tmp_path / "a.uff", text_record(["1 2 3 4"]) + units(9, 3.5, 2)).units.length == 3.5


def test_a_named_system_of_units_beats_factors_that_contradict_it(tmp_path):
    (tmp_path / "a.uff").write_bytes(units(1, 3.28084, 0.224809) + text_record(["1 2 3 4"]))
    found = read_universal(tmp_path / "a.uff")
    assert found.functions[0].units.length == 1
    assert [notice.code for notice in found.notices] == ["units-contradict"]


BROKEN = {
    "without numbers": (text_record([])[:-8], "record 1: cut short, 0 bytes cannot hold 4 values"),
    "in its header": (text_record(["1 2 3 4"])[:200], "record 1 of the universal file is cut short, before its numbers"),
    "in its numbers": (text_record(["1.0 2.0 3.0"]), "record 1: cut short, 3 of 4 numbers"),
    "in binary numbers": (binary_record(samples().tobytes(), count=64)[:-200], "record 1 .* is cut short, .* of 64 values"),
    "in a binary header": (binary_record(b"")[:100], "record 1 of the universal file is cut short"),
    "with a word": (text_record(["1 two 3 4"]), "record 1: its text holds something that is no number"),
    "empty record": (text_record([], count=0), "record 1: holds no values"),
    "number type": (text_record(["1 2 3 4"], ordinate=3), "values of type 3"),
    "no step": (text_record(["1 2 3 4"], step="  0.00000E+00"), "evenly spaced at steps of 0"),
    "VAX numbers": (binary_record(samples().tobytes(), count=64, encoding=1), "another notation than IEEE 754"),
    "no byte order": (binary_record(samples().tobytes(), count=64, order=7), "without byte order"),
    "no functions": (units(), "without functions.* it holds nothing"),
    "only nodes": (b"    -1\n    15\n    1 0 0 0\n    -1\n", "it holds 1 of type 15"),
    "bad units": (units(9, 0.0) + text_record(["1 2 3 4"]), "factors 0, 1"),
    "no identity": (text_record(["1 2 3 4"]).replace(b"    1         1 ", b"a response of it"), "no response and reference"),
    "garbage between": (units() + b"Some words.\n" + text_record(["1 2 3 4"]), "no dataset begins at byte"),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_is_one_line_that_names_the_record(tmp_path, what):
    data, said = BROKEN[what]
    (tmp_path / "a.uff").write_bytes(data)
    with pytest.raises(RecordingError, match=said) as problem:
        values_of(tmp_path / "a.uff")
    assert str(problem.value).startswith(f"{tmp_path / 'a.uff'}: ")
    assert re.search(r"[;:] .*[;,:] ?\w", str(problem.value)), "no mending"


def test_an_end_that_was_never_written_is_the_end_of_the_file(tmp_path):
    assert only(tmp_path / "a.uff", text_record(["1 2 3 4"])[:-7]).values().tolist() == [1, 2, 3, 4]
    y = samples()
    data = binary_record(y.tobytes(), count=64)
    np.testing.assert_array_equal(only(tmp_path / "b.uff", data[:-7]).values(), y)


def test_a_table_of_numbers_is_no_universal_file():
    assert is_universal(b"    -1\r\n   151\r\n")
    assert is_universal(b"    -1" + b" " * 74 + b"\n    58b     1     2\n")
    assert not is_universal(b"    -1    58\n    -2    60\n")
    assert not is_universal(b"-1\n58\n")


# ---- dofs


def test_names_and_nodes_of_dofs_are_each_others_inverse():
    dofs = ["tipX", "-tipY", "12Z", "3RX", "holderX", "hammer", "tipx"]
    nodes = nodes_of(dofs)
    names = dof_names(nodes.values())
    assert [names[nodes[dof]] for dof in dofs] == [*dofs[:-1], "tipX"]
    assert split_dof("-12RZ") == ("12", -6)


def test_an_entity_that_stands_for_several_nodes_names_none_of_them():
    dofs = [Dof("TestCase", 1, 1), Dof("TestCase", 2, 1)]
    assert list(dof_names(dofs).values()) == ["1X", "2X"]
    assert list(dof_names([Dof("acc", 3, 1), Dof("hammer", 3, 1)]).values()) == ["3X", "3X"]  # one place


def test_an_entity_with_its_direction_is_not_told_twice():
    assert list(dof_names([Dof("1+Z", 1, 3), Dof("tip:-X", 4, -1)]).values()) == ["1Z", "-tipX"]


def test_a_name_like_another_node_s_number_is_not_taken_for_it():
    names = list(dof_names([Dof("2", 1, 1), Dof("", 2, 1)]).values())
    assert len(set(names)) == 2


# ---- recordings


def hits(n=3, size=256):
    """Force and acceleration of some hits.   returns (hit, channel, sample)"""
    return np.random.default_rng(7).normal(size=(n, 2, size)) * [[[50], [3]]]


def write_hits(path, data, *, binary=0, order="by hit", unit=("N", "g")):
    x = np.arange(data.shape[2]) / RATE
    sets = [
        (hit, row, pyuff_set(data[hit, row], x, binary=binary, ordinate_spec_data_type=kind, rsp_dir=way,
                             ordinate_axis_units_lab=unit[row], abscissa_axis_units_lab="s"))
        for hit in range(len(data)) for row, (kind, way) in enumerate([(FORCE, 1), (ACCELERATION, -1)])
    ]  # fmt: skip
    if order == "by channel":
        sets.sort(key=lambda item: (item[1], item[0]))
    pyuff.UFF(str(path)).write_sets([item for *_, item in sets])


@pytest.mark.parametrize("order", ["by hit", "by channel"])
@pytest.mark.parametrize("binary", [0, 1])
def test_several_records_of_a_channel_are_hits(tmp_path, order, binary):
    data = hits()
    write_hits(tmp_path / "tap.uff", data, order=order, binary=binary)
    recording = read_recording(tmp_path / "tap.uff")
    expected = np.concatenate(list(data), axis=1) * [[1.0], [-9.80665]]  # the accelerometer looks along -x
    np.testing.assert_allclose(recording.samples, expected, rtol=0 if binary else 1e-10, atol=0)
    assert recording.segments.tolist() == [[0, 256], [256, 256], [512, 256]]
    assert recording.kind == "impact"
    assert recording.sample_rate == RATE  # written as 1.95313E-05 s
    assert [(c.name, c.quantity, c.unit, c.dof) for c in recording.channels] == [
        ("force_1X", "force", "N", "1X"),
        ("acceleration_1X", "acceleration", "m/s^2", "1X"),
    ]
    assert [notice.code for notice in recording.notices] == ["rounded-step"]


@pytest.mark.parametrize("binary", [0, 1])
def test_a_part_of_the_samples_is_that_part(tmp_path, binary, monkeypatch):
    from millcal.io import samples as storage

    write_hits(tmp_path / "tap.uff", hits(), binary=binary)
    whole = read_recording(tmp_path / "tap.uff").samples
    monkeypatch.setattr(storage, "IN_MEMORY", 100)
    lazy = read_recording(tmp_path / "tap.uff").samples
    np.testing.assert_array_equal(lazy.read_block(200, 600), whole[:, 200:600])


def test_units_come_from_the_record_else_from_the_file_else_from_the_user(tmp_path):
    path = tmp_path / "a.uff"
    values = " ".join(map(str, range(1, 17)))
    path.write_bytes(units(5, 1000, 1000) + text_record([values], count=16, y_unit="NONE"))
    np.testing.assert_allclose(read_recording(path).samples[0], np.arange(1, 17) * 1e-3)
    path.write_bytes(units(5, 1000, 1000) + text_record([values], count=16, y_unit="g"))
    np.testing.assert_allclose(read_recording(path).samples[0], np.arange(1, 17) * 9.80665)
    path.write_bytes(text_record([values], count=16, y_unit="NONE"))
    with pytest.raises(RecordingError, match="'acceleration_1X' has no unit; state it with --unit"):
        read_recording(path)
    stated = read_recording(path, units={"acceleration_1X": "mm/s^2"})
    np.testing.assert_allclose(stated.samples[0], np.arange(1, 17) * 1e-3)


def test_uneven_times_that_are_rounded_give_the_rate_of_the_clock(tmp_path):
    n = 4096
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(
        pyuff_set(samples(n), np.arange(n) / RATE, abscissa_spacing=0, ordinate_spec_data_type=ACCELERATION,
                  ordinate_axis_units_lab="m/s2")
    )  # fmt: skip
    assert read_recording(tmp_path / "a.uff").sample_rate == RATE


def test_the_time_of_the_first_sample_and_its_unit_are_kept(tmp_path):
    values = " ".join(map(str, range(1, 17)))
    data = text_record([values], count=16, first=" -2.00000E+00", step="  1.00000E-01", x_unit="ms")
    (tmp_path / "a.uff").write_bytes(data)
    recording = read_recording(tmp_path / "a.uff")
    assert (recording.sample_rate, recording.start_time) == (10_000.0, -2e-3)


UNFIT = {
    "hits missing": ([{}, {}, {"dof": (2, 1)}], r"unequal numbers of time records \(1X 2, 2X 1\)"),
    "lengths": ([{}, {"dof": (2, 1), "count": 15}], "record 2: 15 samples where record 1 of the same hit has 16"),
    "rates": ([{}, {"dof": (2, 1), "step": "  2.00000E-03"}], "record 2: sampled every 0.002 where record 1"),
    "complex": ([{"ordinate": 6, "count": 8}], "record 1: a time record of complex numbers"),
    "time unit": ([{"x_unit": "fortnights"}], "a time in 'fortnights'"),
    "only FRFs": ([{"kind": 4, "ordinate": 6, "count": 8, "x_kind": FREQUENCY}], "without time records .it holds 1 x FRF"),
}  # fmt: skip


@pytest.mark.parametrize("what", UNFIT)
def test_records_that_make_no_recording_are_one_line(tmp_path, what):
    changes, said = UNFIT[what]
    values = " ".join(map(str, range(1, 17)))
    (tmp_path / "a.uff").write_bytes(b"".join(text_record([values], **({"count": 16} | change)) for change in changes))
    with pytest.raises(RecordingError, match=said):
        read_recording(tmp_path / "a.uff")


def test_inspect_shows_the_channels_and_what_else_is_in_the_file(tmp_path):
    path = tmp_path / "a.uff"
    write_hits(path, hits())
    frf = text_record(["1 2 3 4 5 6 7 8"], kind=4, ordinate=6, x_kind=FREQUENCY)
    path.write_bytes(path.read_bytes() + frf)
    result, notices = inspect_recording(path)
    assert (result["format"], result["samples"], result["sample_rate_hz"]) == ("uff", 768, RATE)
    assert [channel["unit"] for channel in result["channels"]] == ["N", "g"]
    assert result["details"]["records"] == {"FRF": 1}
    assert result["details"]["segments"] == 3
    assert "records-left-out" in {notice.code for notice in notices}


def test_the_frf_of_a_recording_is_that_of_its_universal_file(tmp_path):
    """Every sample of a recording, written by another program's writer and read back."""
    from pathlib import Path

    from millcal.stages.frf import estimate_frf

    original = Path(__file__).parents[2] / "references" / "impact_12_B_badhits" / "tap_tipX.h5"
    recording = read_recording(original)
    with h5py.File(original) as file:
        segments = file["segments"][()]
    quantities = {"force": (FORCE, "N"), "acceleration": (ACCELERATION, "m/s^2")}
    nodes = nodes_of(channel.dof for channel in recording.channels)
    sets = []
    for start, length in segments:
        block = recording.block(start, start + length)
        for row, channel in enumerate(recording.channels):
            kind, unit = quantities[channel.quantity]
            dof = nodes[channel.dof]
            sets.append(
                pyuff_set(block[row], np.arange(length) / recording.sample_rate, binary=1, rsp_ent_name=dof.entity,
                          rsp_dir=dof.direction, rsp_node=dof.node, ordinate_spec_data_type=kind,
                          ordinate_axis_units_lab=unit)
            )  # fmt: skip
    pyuff.UFF(str(tmp_path / "tap.uff")).write_sets(sets)
    read = read_recording(tmp_path / "tap.uff", setup=Setup())
    np.testing.assert_array_equal(read.samples, recording.samples)
    assert read.sample_rate == recording.sample_rate
    drop = [2, 5, 8, 10, 11]  # overloads are known by the full scale, which a universal file does not hold
    one, other = (estimate_frf(r, drop=drop) for r in (read, recording))
    np.testing.assert_allclose(one.values, other.values, rtol=1e-12, atol=0, equal_nan=True)
    assert (one.outputs, one.inputs) == (other.outputs, other.inputs)
