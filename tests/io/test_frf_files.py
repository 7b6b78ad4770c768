"""FRF files in and out: what goes out comes back, what a file does not say is asked for, and damage is one line."""

import os
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import pyuff

from millcal.data import Frf
from millcal.errors import RecordingError
from millcal.io.formats.uff_writer import even_lines
from millcal.io.frf_files import SUFFIXES, converted, is_frf_file, read_frf, write_frf
from millcal.io.frf_units import frf_unit
from millcal.io.inspection import inspect_recording
from millcal.physics.structure import Mode, convert_frf, receptance

MODES = [Mode(640.0, 0.03, 2e7, "x"), Mode(1480.0, 0.02, 6e7, "x"), Mode(910.0, 0.04, 3e7, "y")]
FREQUENCY = np.arange(401) * (51200 / 8192)


def make(form="accelerance", dofs=("tipX", "tipY"), frequency=FREQUENCY, **changes):
    """An FRF of two directions with everything a file may hold."""
    rng = np.random.default_rng(3)
    values = receptance(frequency, MODES)
    values[:, 0, 1] = values[:, 1, 0] = 0.2 * values[:, 0, 0] - 0.1 * values[:, 1, 1]
    with np.errstate(invalid="ignore"):
        values = convert_frf(frequency, values, "receptance", form)
    parts = {
        "coherence": rng.uniform(0.9, 1, values.shape),
        "variance": rng.uniform(1e-20, 1e-19, values.shape),
        "multiple_coherence": rng.uniform(0.9, 1, values.shape[:2]),
        "force_spectrum": rng.uniform(1e-3, 1, (len(frequency), 2)),
    }
    own = {
        "frequency": frequency, "values": values, "form": form, "estimator": "h1", "outputs": tuple(dofs), "inputs": tuple(dofs),
        "hits_used": (5, 7), "usable_band": (float(frequency[1]), float(frequency[-2])),
    }  # fmt: skip
    return Frf(**(own | parts | changes))


def plain(**changes):
    """The same without what only some files hold."""
    return make(**{"coherence": None, "variance": None, "multiple_coherence": None, "force_spectrum": None, **changes})


def codes(frf):
    return [notice.code for notice in frf.notices]


def same(one, other, rtol=0.0):
    np.testing.assert_array_equal(one.frequency, other.frequency)
    np.testing.assert_allclose(one.values, other.values, rtol=rtol, atol=0, equal_nan=True)
    assert (one.form, one.outputs, one.inputs) == (other.form, other.outputs, other.inputs)
    assert (one.usable_band, one.hits_used, one.estimator) == (other.usable_band, other.hits_used, other.estimator)


# ---- there and back


@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance", "transmissibility"])
@pytest.mark.parametrize(("name", "binary"), [("a.uff", True), ("a.unv", True), ("a.csv", False), ("a.h5", False)])
def test_what_is_written_comes_back_to_the_last_bit(tmp_path, name, binary, form):
    frf = make(form) if form != "transmissibility" else replace(make("receptance"), form=form)
    written = write_frf(tmp_path / name, frf, binary=binary)
    read = read_frf(written.paths)
    same(read, frf)
    np.testing.assert_array_equal(read.coherence, frf.coherence)
    np.testing.assert_array_equal(read.multiple_coherence, frf.multiple_coherence)
    held = {"a.uff": [], "a.unv": []}.get(name, ["variance", "force_spectrum"])
    for part in held:
        np.testing.assert_array_equal(getattr(read, part), getattr(frf, part))
    lost = " ".join(notice.message for notice in written.notices)
    assert ("variance" in lost) == ("variance" not in held)


def test_text_of_a_universal_file_keeps_thirteen_digits_and_the_lines_exactly(tmp_path):
    frf = make()
    write_frf(tmp_path / "a.uff", frf)
    same(read_frf(tmp_path / "a.uff"), frf, rtol=1e-12)
    write_frf(tmp_path / "b.uff", read_frf(tmp_path / "a.uff"))
    assert (tmp_path / "a.uff").read_bytes().splitlines()[24:] == (tmp_path / "b.uff").read_bytes().splitlines()[24:]


def test_a_cutpro_file_for_each_pair_comes_back_by_its_name(tmp_path):
    frf = plain(form="receptance")
    written = write_frf(tmp_path / "spindle.frf", frf)
    assert [path.name for path in written.paths] == [
        f"spindle_{o}_{i}.frf" for i in frf.inputs for o in frf.outputs
    ]  # fmt: skip
    read = read_frf(written.paths)
    np.testing.assert_array_equal(read.values, frf.values)
    np.testing.assert_array_equal(read.frequency, frf.frequency)
    assert (read.outputs, read.inputs, read.form) == (frf.outputs, frf.inputs, "receptance")


def test_cutpro_gets_a_receptance_without_the_lines_that_have_no_value(tmp_path):
    written = write_frf(tmp_path / "x.frf", plain())
    rows = np.loadtxt(written.paths[0])
    expected = receptance(FREQUENCY, MODES)[1:, 0, 0]
    np.testing.assert_allclose(rows[:, 1] + 1j * rows[:, 2], expected, rtol=1e-13)
    np.testing.assert_array_equal(rows[:, 0], FREQUENCY[1:])
    assert {"form-converted", "lines-left-out"} <= {notice.code for notice in written.notices}


@pytest.mark.parametrize(("name", "binary"), [("a.uff", False), ("a.uff", True), ("a.csv", False)])
def test_lines_without_a_value_stay_without_one(tmp_path, name, binary):
    frf = converted(plain(), "receptance")
    assert np.isnan(frf.values[0]).all()
    write_frf(tmp_path / name, frf, binary=binary)
    same(read_frf(tmp_path / name), frf, rtol=0 if name != "a.uff" or binary else 1e-12)


@pytest.mark.parametrize(("name", "binary"), [("a.uff", False), ("a.uff", True), ("a.csv", False)])
def test_pairs_that_were_not_measured_stay_blank_and_are_told(tmp_path, name, binary):
    values = plain().values.copy()
    values[:, 1, 0] = np.nan
    frf = plain(values=values)
    write_frf(tmp_path / name, frf, binary=binary)
    read = read_frf(tmp_path / name)
    same(read, frf, rtol=0 if name != "a.uff" or binary else 1e-12)
    assert "tipY/tipX" in next(notice.message for notice in read.notices if notice.code == "not-measured")


@pytest.mark.parametrize("binary", [False, True])
def test_uneven_lines_are_written_with_their_frequencies(tmp_path, binary):
    lines = np.array([1.0, 2.5, 7.0, 20.0, 55.0])
    frf = plain(frequency=lines, usable_band=(1.0, 20.0))
    write_frf(tmp_path / "a.uff", frf, binary=binary)
    same(read_frf(tmp_path / "a.uff"), frf, rtol=0 if binary else 1e-12)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("dofs", [("1X", "-2Y"), ("noseX", "hammer"), ("x", "tipy"), ("toolholder_frontX", "12Z")])
def test_dofs_come_back_as_they_were(tmp_path, dofs, binary):
    frf = plain(inputs=dofs, outputs=dofs)
    write_frf(tmp_path / "a.uff", frf, binary=binary)
    read = read_frf(tmp_path / "a.uff")
    names = tuple(dof.lstrip("-") for dof in dofs)
    assert (read.outputs, read.inputs) == (names, names)
    signs = np.array([-1.0 if dof.startswith("-") else 1.0 for dof in dofs])
    np.testing.assert_allclose(read.values, frf.values * np.outer(signs, signs), rtol=1e-12)


@pytest.mark.parametrize("name", ["a.uff", "a.csv", "a.h5", "a.frf"])
def test_the_same_frf_gives_the_same_bytes(tmp_path, name):
    for folder in ("one", "two"):
        written = write_frf(tmp_path / folder / name, make())
    assert written.paths[0].read_bytes() == (tmp_path / "one" / written.paths[0].name).read_bytes()


def test_even_lines_are_found_whatever_made_them():
    for n, rate in [(8192, 51200.0), (6000, 51200.0), (4096, 25600.0), (30000, 48828.125), (1000, 44100.0)]:
        for lines in (
            np.fft.rfftfreq(n, 1 / rate),
            np.arange(n // 2) * (rate / n),
            3.7 + np.arange(n // 2) * (rate / n),
        ):
            first, step, even = even_lines(lines)
            assert even
            np.testing.assert_allclose(first + step * np.arange(len(lines)), lines, rtol=1e-15, atol=0)
    assert not even_lines(np.array([0, 1, 2.001, 3]))[2]


def test_the_spectra_of_the_hits_are_said_to_stay_behind(tmp_path):
    from millcal.data import Hit

    frf = make(hits=(Hit("tap.h5", 0, 0.1, 100.0, True),))
    for name in ("a.uff", "a.csv"):
        (notice,) = (n for n in write_frf(tmp_path / name, frf).notices if n.code == "not-held")
        assert "hits" in notice.message


def test_an_exponential_window_is_a_warning_in_every_file_but_our_own(tmp_path):
    frf = plain(damping_shift=12.5)
    for name in ("a.uff", "a.csv", "a.frf"):
        assert "exponential-window" in [n.code for n in write_frf(tmp_path / name, frf).notices]
    for name in ("a.uff", "a.csv"):
        assert read_frf(tmp_path / name).damping_shift == 12.5
    assert not write_frf(tmp_path / "a.h5", frf).notices


def test_a_suffix_that_is_no_format_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"no format has the suffix '.xlsx'; use one of \.h5"):
        write_frf(tmp_path / "a.xlsx", plain())
    with pytest.raises(RecordingError, match="only a universal file can be binary"):
        write_frf(tmp_path / "a.csv", plain(), binary=True)
    assert not list(tmp_path.iterdir())


# ---- pyuff as the other side


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
def test_pyuff_reads_what_we_write(tmp_path, binary, form):
    frf = make(form, dofs=("tipX", "-3Z"))
    write_frf(tmp_path / "a.uff", frf, binary=binary)
    sets = pyuff.UFF(str(tmp_path / "a.uff")).read_sets()
    assert [s["type"] for s in sets] == [151, 164] + [58] * 10
    assert (sets[1]["units_code"], sets[1]["length"], sets[1]["force"]) == (1, 1, 1)
    pairs = {(s["rsp_node"], s["rsp_dir"], s["ref_node"], s["ref_dir"]): s for s in sets[2:] if s["func_type"] == 4}
    assert set(pairs) == {(*a, *b) for a in ((1, 1), (3, -3)) for b in ((1, 1), (3, -3))}
    of = pairs[3, -3, 1, 1]
    np.testing.assert_allclose(of["data"], frf.values[:, 1, 0], rtol=0 if binary else 1e-12)
    np.testing.assert_allclose(of["x"], FREQUENCY, rtol=1e-10)
    assert (of["ordinate_spec_data_type"], of["orddenom_spec_data_type"]) == (
        {"receptance": 8, "mobility": 11, "accelerance": 12}[form],
        13,
    )
    assert of["rsp_ent_name"] == "NONE"
    assert of["ref_ent_name"] == "tip"
    assert sum(s["func_type"] == 6 for s in sets[2:]) == 4


def pyuff_file(path, frf, *, binary=0, even=1, double=True, **more):
    """All pairs of an FRF by pyuff, node 1 along x and node 2 along y."""
    sets = [
        {"type": 58, "func_type": 4, "rsp_node": 1 + o, "rsp_dir": 1 + o, "ref_node": 1 + i, "ref_dir": 1 + i, "binary": binary,
         "data": frf.values[:, o, i], "x": frf.frequency, "abscissa_spacing": even, "abscissa_spec_data_type": 18,
         "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13, "ord_data_type": 6 if double else 5,
         "ordinate_axis_units_lab": "m/s^2", "orddenom_axis_units_lab": "N"} | more
        for i in range(2) for o in range(2)
    ]  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, force_double=double)


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
def test_we_read_what_pyuff_writes(tmp_path, binary, even):
    frf = plain()
    pyuff_file(tmp_path / "a.uff", frf, binary=binary, even=even)
    read = read_frf(tmp_path / "a.uff")
    np.testing.assert_allclose(read.values, frf.values, rtol=0 if binary else 1e-11)
    np.testing.assert_allclose(read.frequency, frf.frequency, rtol=1e-5)
    assert (read.form, read.outputs, read.inputs) == ("accelerance", ("1X", "2Y"), ("1X", "2Y"))
    assert read.notices == ()


# ---- what a universal file says of its units


@pytest.mark.parametrize(
    ("said", "form", "factor"),
    [
        ({"ordinate_axis_units_lab": "g"}, "accelerance", 9.80665),
        ({"ordinate_axis_units_lab": "g", "orddenom_axis_units_lab": "kN"}, "accelerance", 9.80665e-3),
        ({"ordinate_axis_units_lab": "m/s²/N", "orddenom_axis_units_lab": "NONE"}, "accelerance", 1),
        ({"ordinate_axis_units_lab": "(mm/s2)/N", "ordinate_spec_data_type": 0}, "accelerance", 1e-3),
        ({"ordinate_axis_units_lab": "mm", "ordinate_spec_data_type": 8}, "receptance", 1e-3),
        ({"ordinate_axis_units_lab": "m/s", "ordinate_spec_data_type": 1}, "mobility", 1),
        (
            {"ordinate_axis_units_lab": "NONE", "ordinate_spec_data_type": 0, "ordinate_axis_lab": "Inertance"},
            "accelerance",
            1,
        ),
        (
            {"func_type": 5, "ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "N"},
            "transmissibility",
            1,
        ),
    ],
)
def test_the_record_tells_form_and_unit(tmp_path, said, form, factor):
    frf = plain()
    kind = said.get("func_type", 4)
    pyuff_file(tmp_path / "a.uff", frf, **(said | {"func_type": 4}))
    if kind == 5:  # which pyuff does not write
        data = (tmp_path / "a.uff").read_text()
        (tmp_path / "a.uff").write_text(re.sub(r"\n {4}4( {9}\d)", r"\n    5\1", data))
    read = read_frf(tmp_path / "a.uff")
    assert read.form == form
    np.testing.assert_allclose(read.values, factor * frf.values, rtol=1e-9)
    assert ("unit-assumed" in codes(read)) == (said["ordinate_axis_units_lab"] == "NONE")


@pytest.mark.parametrize(
    ("system", "motion", "force"),
    [((1, 1.0, 1.0), 1, 1), ((5, 1000.0, 1000.0), 1e-3, 1e-3), ((9, 2.0, 0.5), 0.5, 2), ((1, 3.28, 0.22), 1, 1)],
)
def test_the_units_of_the_file_scale_what_has_no_unit_of_its_own(tmp_path, system, motion, force):
    code, length, per_newton = system
    units = {"type": 164, "units_code": code, "length": length, "force": per_newton, "temp": 1.0, "temp_offset": 0.0}
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(units)
    pyuff_file(tmp_path / "a.uff", plain(), ordinate_axis_units_lab="NONE", orddenom_axis_units_lab="NONE")
    read = read_frf(tmp_path / "a.uff")
    np.testing.assert_allclose(read.values, plain().values * motion / force, rtol=1e-9)
    assert ("units-contradict" in codes(read)) == (length == 3.28)


def test_a_unit_on_the_axis_beats_those_of_the_file(tmp_path):
    units = {"type": 164, "units_code": 5, "length": 1000.0, "force": 1000.0, "temp": 1.0, "temp_offset": 0.0}
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(units)
    pyuff_file(tmp_path / "a.uff", plain())
    read = read_frf(tmp_path / "a.uff")
    np.testing.assert_allclose(read.values, plain().values, rtol=1e-9)
    assert "units-disagree" in codes(read)


SILENT = {
    "nothing": ({"ordinate_spec_data_type": 0, "ordinate_axis_units_lab": "NONE"}, "record 1 does not say what it measures"),
    "two things": ({"ordinate_spec_data_type": 8}, "record 1 says accelerance by its unit, receptance by its data type"),
    "volts": ({"ordinate_axis_units_lab": "V"}, "record 1 is in 'V', which is not known"),
    "another unit": ({"ordinate_axis_units_lab": "in/s^2"}, "record 1 is in 'in/s.2', which is not known"),
    "dynamic mass": ({"orddenom_spec_data_type": 12, "ordinate_spec_data_type": 13}, "over acceleration and not over force"),
}  # fmt: skip


@pytest.mark.parametrize("what", SILENT)
def test_what_a_record_does_not_say_is_asked_for(tmp_path, what):
    said, why = SILENT[what]
    pyuff_file(tmp_path / "a.uff", plain(), **said)
    with pytest.raises(RecordingError, match=why):
        read_frf(tmp_path / "a.uff")
    if what != "dynamic mass":
        read = read_frf(tmp_path / "a.uff", unit="mm/s^2/N")
        assert read.form == "accelerance"
        np.testing.assert_allclose(read.values, 1e-3 * plain().values, rtol=1e-9)
        result, _ = inspect_recording(tmp_path / "a.uff")
        assert re.search(why, result["missing"][0])


def test_a_stated_form_wins_and_is_told(tmp_path):
    pyuff_file(tmp_path / "a.uff", plain())
    read = read_frf(tmp_path / "a.uff", form="receptance", unit="um/N")
    assert read.form == "receptance"
    np.testing.assert_allclose(read.values, 1e-6 * plain().values, rtol=1e-9)
    assert "form-overruled" in codes(read)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"form": "inertance"}, "form inertance: not known; use one of receptance, mobility"),
        ({"unit": "furlong/N"}, "--unit furlong/N: no unit of an FRF"),
        ({"form": "receptance", "unit": "g/N"}, "the unit of accelerance, not of receptance"),
    ],
)
def test_what_is_stated_must_make_sense(tmp_path, stated, said):
    write_frf(tmp_path / "a.csv", plain())
    with pytest.raises(RecordingError, match=said):
        read_frf(tmp_path / "a.csv", **stated)


def test_units_of_an_frf_in_every_spelling():
    same_unit = ["m/s^2/N", "(m/s^2)/N", "m/(N s^2)", "m/(N·s²)", "m/s²/N", "[m/s2/N]", "m/s/s/N", "1/kg", "m s^-2/N"]
    assert {frf_unit(text) for text in same_unit} == {("accelerance", 1.0)}
    assert frf_unit("m/(Ns)") == frf_unit("m/s/N") == ("mobility", 1.0)
    assert frf_unit("µm/N") == ("receptance", 1e-6)
    assert frf_unit("N/N") == ("transmissibility", 1.0)
    assert {frf_unit(text) for text in ("N/m", "V/N", "g", "", "furlong/N", "s")} == {None}


# ---- what makes one matrix


def edited(tmp_path, change, frf=None, **options):
    """A universal file with some of its text changed."""
    write_frf(tmp_path / "a.uff", plain() if frf is None else frf, **options)
    text = (tmp_path / "a.uff").read_text()
    assert change(text) != text
    (tmp_path / "a.uff").write_text(change(text))
    return tmp_path / "a.uff"


def records(text):
    """Header and units, and the records of a universal file."""
    parts = text.split("    -1\n    58\n")
    return parts[0], [f"    -1\n    58\n{part}" for part in parts[1:]]


def test_the_order_of_the_records_is_the_order_of_the_dofs_only(tmp_path):
    path = edited(tmp_path, lambda text: records(text)[0] + "".join(records(text)[1][::-1]))
    read = read_frf(path)
    assert (read.outputs, read.inputs) == (("tipY", "tipX"), ("tipY", "tipX"))
    np.testing.assert_allclose(read.values, plain().values[:, ::-1, ::-1], rtol=1e-12)


def test_response_and_reference_exchanged_is_the_transposed_matrix(tmp_path):
    values = np.random.default_rng(1).normal(size=(401, 2, 2)) + 1j
    pyuff_file(tmp_path / "a.uff", plain(values=values))
    text = (tmp_path / "a.uff").read_text()
    dofs = r"(\n    4.{25})(.{25})(.{25})"
    assert len(re.findall(dofs, text)) == 4
    (tmp_path / "b.uff").write_text(re.sub(dofs, r"\1\3\2", text))
    one, other = read_frf(tmp_path / "a.uff"), read_frf(tmp_path / "b.uff")
    np.testing.assert_allclose(one.values, np.swapaxes(other.values, 1, 2), rtol=1e-12)


def test_a_direction_against_its_axis_turns_the_values(tmp_path):
    frf = plain()
    pyuff_file(tmp_path / "a.uff", frf)
    text = (tmp_path / "a.uff").read_text()
    turned = re.sub(r"(\n    4.{36} {9}2)   2", r"\1  -2", text)  # all responses along y
    (tmp_path / "a.uff").write_text(turned)
    read = read_frf(tmp_path / "a.uff")
    assert read.outputs == ("1X", "2Y")
    np.testing.assert_allclose(read.values, frf.values * [[[1], [-1]]], rtol=1e-9)
    assert {"dof-turned", "driving-point-sign"} <= set(codes(read))


def test_a_direction_stays_in_the_name_where_both_are_measured(tmp_path):
    frf = plain(outputs=("tipX", "-tipX"))
    write_frf(tmp_path / "a.uff", frf, binary=True)
    read = read_frf(tmp_path / "a.uff")
    assert read.outputs == ("tipX", "-tipX")
    np.testing.assert_array_equal(read.values, frf.values)


def test_a_coherence_goes_to_its_pair_and_one_without_a_pair_is_told(tmp_path):
    frf = plain(coherence=make().coherence)
    path = edited(tmp_path, lambda text: records(text)[0] + "".join(records(text)[1][k] for k in (4, 0, 5, 3)), frf)
    read = read_frf(path)
    np.testing.assert_allclose(read.coherence[:, 0, 0], frf.coherence[:, 0, 0], rtol=1e-12)
    assert np.isnan(read.coherence[:, 1, 1]).all()
    assert "coherence-left-out" in codes(read)


def test_other_functions_are_left_out_with_a_word(tmp_path):
    path = edited(tmp_path, lambda text: text.replace("\n    4         4 ", "\n    9         4 "))
    read = read_frf(path)
    assert np.isnan(read.values[:, 1, 1]).all()
    assert any("1 x power spectral density" in notice.message for notice in read.notices)


def test_a_record_that_stands_twice_is_taken_once(tmp_path):
    read = read_frf(edited(tmp_path, lambda text: text + records(text)[1][0]))
    same(read, plain(), rtol=1e-12)
    assert "pair-twice" in codes(read)


def test_magnitudes_without_phase_are_told(tmp_path):
    pyuff_file(tmp_path / "a.uff", plain(values=plain().values.real), ord_data_type=4)
    assert "real-frf" in codes(read_frf(tmp_path / "a.uff"))


BROKEN = {
    "two measurements of one pair": (
        lambda text: text + records(text)[1][3].replace('"pair":["tipY","tipY"]', '"pair":["tipX","tipX"]').replace(
            "tip                1   2 tip                1   2", "tip                1   1 tip                1   1"
        ),
        r"record 5 .tipX/tipX.: tipX/tipX stands in .*record 1 .* too, with other values",
    ),
    "other lines": (lambda text: text[: text.index("    -1\n    58\n")] + records(text)[1][0] + records(text)[1][1].replace(
        "6.25000E+00", "6.50000E+00"), "record 2: 401 lines from 0 to 2600 Hz where record 1 has 401 lines from 0 to 2500 Hz"),
    "no FRF": (lambda text: re.sub(r"\n    4 {9}(\d)", r"\n    9         \1", text), "no FRF .*it holds 4 x power spectral"),
    "cut short": (lambda text: text[:-2000], "record 4: cut short"),
    "over time": (lambda text: text.replace("        18    0", "        17    0"), "record 1: an FRF over time"),
    "in rpm-": (lambda text: text.replace(" Hz ", " ms "), "record 1: a frequency in 'ms'"),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_records_that_make_no_matrix_are_one_line(tmp_path, what):
    change, said = BROKEN[what]
    path = edited(tmp_path, change)
    with pytest.raises(RecordingError, match=said) as problem:
        read_frf(path)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("suffix", [".uff", ".csv", ".h5"])
def test_files_of_different_formats_make_one_matrix(tmp_path, suffix):
    frf = plain()
    x = plain(values=frf.values[:, :, :1], inputs=("tipX",), hits_used=(5,))
    y = converted(plain(values=frf.values[:, :, 1:], inputs=("tipY",), hits_used=(7,)), "receptance")
    write_frf(tmp_path / f"x{suffix}", x)
    write_frf(tmp_path / "y.uff", y, binary=True)
    read = read_frf([tmp_path / f"x{suffix}", tmp_path / "y.uff"])
    np.testing.assert_allclose(read.values[1:], frf.values[1:], rtol=1e-12)
    assert np.isnan(read.values[0, :, 1]).all()  # a receptance says nothing at 0 Hz
    assert (read.form, read.hits_used) == ("accelerance", (5, 7))
    assert "form-converted" in codes(read)


def test_files_under_different_windows_are_not_joined(tmp_path):
    for name, shift in (("x.csv", 3.0), ("y.csv", 0.0)):
        write_frf(tmp_path / name, plain(damping_shift=shift))
    with pytest.raises(RecordingError, match="another exponential window"):
        read_frf([tmp_path / "x.csv", tmp_path / "y.csv"])


# ---- text


def rows(h, delimiter="\t", point=".", end="\r\n", form="%.6e"):
    lines = [delimiter.join(form % x for x in (f, v.real, v.imag)) for f, v in zip(FREQUENCY, h, strict=True)]
    return end.join([*lines, ""]).replace(".", point)


H = receptance(FREQUENCY, MODES)[:, 0, 0]
TIP = {"outputs": "tipX", "inputs": "tipX"}
BARE = {
    "tabs": rows(H),
    "blanks": rows(H, "   ", end="\n"),
    "commas": rows(H, ", "),
    "semicolons and decimal commas": rows(H, ";", ","),
    "tabs and decimal commas": rows(H, "\t", ","),
    "words before": "Freq\tHz\tReal\tm/N\tImag\tm/N\r\n" + rows(H),
    "a title and a count": "FRF of the spindle, measured\r\n401\r\n\r\n" + rows(H),
    "words behind the first row": rows(H).replace("\r\n", "\tFreq\tHz\tReal\tm/N\tImag\tReal\t\n", 1),
    "words glued to the first row": rows(H).replace("\r\n", "Freq Hz Real m/N\n", 1),
    "delimiters at the end of lines": rows(H, end="\t\n"),
    "mixed line ends": rows(H, end="\n").replace("\n", "\r\n", 100).replace("\r\n", "\r", 10),
    "comments": "# Freq [Hz] Real [m/N] Imag [m/N]\n% made by hand\n" + rows(H),
    "a byte order mark": "\ufeff" + rows(H),
    "exponents of three digits": re.sub(r"e([+-])(\d\d)\b", r"e\g<1>0\2", rows(H)),
    "words at the end": rows(H) + "End of file\n",
}


@pytest.mark.parametrize("what", BARE)
@pytest.mark.parametrize("name", ["spindle.frf", "Point_1_Channel_1.txt"])
def test_three_bare_columns_are_a_receptance_in_metres_per_newton(tmp_path, what, name):
    (tmp_path / name).write_bytes(BARE[what].encode("utf-8"))
    read = read_frf(tmp_path / name, **TIP)
    np.testing.assert_allclose(read.values[:, 0, 0], H, rtol=2e-6)
    np.testing.assert_allclose(read.frequency, FREQUENCY)
    assert (read.form, read.outputs, read.inputs) == ("receptance", ("tipX",), ("tipX",))
    assert set(codes(read)) <= {"unit-assumed"}
    assert ("unit-assumed" in codes(read)) == ("m/N" not in BARE[what])


def test_the_words_around_bare_columns_state_the_unit(tmp_path):
    (tmp_path / "a.txt").write_text("Freq Hz Real um/N Imag um/N\n" + rows(H))
    np.testing.assert_allclose(read_frf(tmp_path / "a.txt", **TIP).values[:, 0, 0], 1e-6 * H, rtol=2e-6)
    read = read_frf(tmp_path / "a.txt", unit="g/N", **TIP)
    assert read.form == "accelerance"
    np.testing.assert_allclose(read.values[:, 0, 0], 9.80665 * H, rtol=2e-6)


@pytest.mark.parametrize("text", ["NaN", "nan", "1.#QNAN", "-1.#IND", "inf"])
def test_the_line_at_rest_may_hold_no_number(tmp_path, text):
    first = rows(H).split("\r\n")[0]
    (tmp_path / "a.frf").write_text(rows(H).replace(first, f"0.0\t{text}\t{text}", 1))
    read = read_frf(tmp_path / "a.frf", **TIP)
    assert not np.isfinite(read.values[0, 0, 0])
    np.testing.assert_allclose(read.values[1:, 0, 0], H[1:], rtol=2e-6)
    assert "accelerometer-polarity" not in codes(read)


def phased(h, unit, degrees=True):
    phase = np.angle(h, deg=degrees)
    rows = "\n".join(f"{f:.9g};{abs(v):.9e};{p:.9f}" for f, v, p in zip(FREQUENCY, h, phase, strict=True))
    return f"Frequency (Hz);Magnitude ({unit});Phase ({'deg' if degrees else 'rad'})\n{rows}\n"


def cells(header, *columns, delimiter=",", point="."):
    body = "\n".join(delimiter.join(f"{x:.12e}".replace(".", point) for x in row) for row in zip(*columns, strict=True))
    return f"{header}\n{body}\n"


NAMED = {
    "real and imaginary": (cells("frequency_hz,re [m/N],im [m/N]", FREQUENCY, H.real, H.imag), 1),
    "with blanks": (cells("frequency_hz, re [um/N], im [um/N]", FREQUENCY, H.real, H.imag), 1e-6),
    "in words": (
        cells("Frequency (Hz)\tReal Part (m/N)\tImaginary Part (m/N)", FREQUENCY, H.real, H.imag, delimiter="\t"),
        1,
    ),
    "in kHz": (cells("f [kHz];re [m/N];im [m/N]", FREQUENCY / 1e3, H.real, H.imag, delimiter=";", point=","), 1),
    "magnitude": (phased(H, "mm/N"), 1e-3),
    "in radians": (phased(H, "m/N", degrees=False), 1),
    "phase_deg": (cells("frequency,magnitude [m/N],phase_deg", FREQUENCY, abs(H), np.angle(H, deg=True)), 1),
    "unwrapped": (cells("frequency,magnitude [m/N],phase_deg", FREQUENCY, abs(H), np.angle(H, deg=True) + 720), 1),
    "decibels": (
        cells("# unit = m/N\nfreq,mag [dB],phase [deg]", FREQUENCY, 20 * np.log10(abs(H)), np.angle(H, deg=True)),
        1,
    ),
    "by lines above": (cells("# form = receptance\n# unit = mm/N\nfrequency,re,im", FREQUENCY, H.real, H.imag), 1e-3),
    "with a coherence": (cells("f,H re [m/N],H im [m/N],coherence", FREQUENCY, H.real, H.imag, 0 * FREQUENCY + 0.9), 1),
}


@pytest.mark.parametrize("what", NAMED)
def test_a_table_that_names_its_columns_is_read_by_them(tmp_path, what):
    text, factor = NAMED[what]
    (tmp_path / "a.csv").write_text(text)
    read = read_frf(tmp_path / "a.csv", **TIP)
    np.testing.assert_allclose(read.frequency, FREQUENCY, rtol=1e-12)
    np.testing.assert_allclose(read.values[:, 0, 0], factor * H, rtol=1e-7)
    assert read.form == "receptance"
    assert (read.coherence is not None) == ("coherence" in text)


@pytest.mark.parametrize(
    "header",
    [
        "frequency_hz,tipX/tipX re [g/N],tipX/tipX im [g/N],tipY/tipX re [g/N],tipY/tipX im [g/N]",
        'frequency_hz,"H(tipX,tipX) re [g/N]","H(tipX,tipX) im [g/N]","H(tipY,tipX) re [g/N]","H(tipY,tipX) im [g/N]"',
        'frequency_hz,"re(tipX/tipX) [g/N]","im(tipX/tipX) [g/N]","re(tipY/tipX) [g/N]","im(tipY/tipX) [g/N]"',
        "frequency_hz,tipX/tipX_re [g/N],tipX/tipX_im [g/N],tipY/tipX_re [g/N],tipY/tipX_im [g/N]",
    ],
)
def test_columns_name_their_pair(tmp_path, header):
    (tmp_path / "a.csv").write_text(cells(header, FREQUENCY, H.real, H.imag, 2 * H.real, 2 * H.imag))
    read = read_frf(tmp_path / "a.csv")
    assert (read.outputs, read.inputs, read.form) == (("tipX", "tipY"), ("tipX",), "accelerance")
    np.testing.assert_allclose(read.values[:, 1, 0], 2 * 9.80665 * H, rtol=1e-11)


def test_columns_of_responses_alone_need_the_hammer(tmp_path):
    text = cells("f,tipX re [m/N],tipX im [m/N],tipY re [m/N],tipY im [m/N]", FREQUENCY, H.real, H.imag, H.real, H.imag)
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordingError, match="does not say where it was measured"):
        read_frf(tmp_path / "a.csv")
    assert read_frf(tmp_path / "a.csv", inputs="tipX").outputs == ("tipX", "tipY")


TEXTS = {
    "empty": ("", "empty"),
    "prose": ("Nothing was measured.\nThe hammer broke.\n", "no FRF was found"),
    "two columns": ("\n".join(f"{k}\t{k + 1}" for k in range(50)), "no FRF was found"),
    "four columns": ("\n".join(f"{k} 1.5 2.5 3.5" for k in range(50)), "line 1 has more than three numbers; name the columns"),
    "one line": ("1.0 2.0 3.0\n", "1 lines; an FRF needs at least 2"),
    "cut short": (rows(H)[:-20], "line 401, the last one, is cut short"),
    "a short row": (rows(H).replace(rows(H).split("\r\n")[200], "1250\t3.5"), "line 201 holds .* where three numbers are needed"),
    "backwards": ("3 1 1\n2 1 1\n1 1 1\n", "the frequency does not rise at line 2, 2 Hz"),
    "a frequency twice": ("1 1 1\n2 1 1\n2 1 1\n", "the frequency does not rise at line 3"),
    "times": ("\n".join(f"{k / 51200:.6e} 1 2" for k in range(4096)), "times and no frequencies; 'millcal frf'"),
    "no form": (cells("frequency,re,im", FREQUENCY, H.real, H.imag), "neither unit nor form of the FRF is said"),
    "unknown unit": (cells("frequency,re [x/N],im [x/N]", FREQUENCY, H.real, H.imag), "'x/N' is not known"),
    "two units": (cells("frequency,re [m/N],im [g/N]", FREQUENCY, H.real, H.imag), "in unequal units"),
    "half a pair": (
        cells("f,a/a re [m/N],a/a im [m/N],b/a re [m/N]", FREQUENCY, H.real, H.imag, H.real),
        "only real; an FRF needs real and imaginary part",
    ),
    "a pair twice": (
        cells("f,a/a re [m/N],a/a im [m/N],a/a re [m/N]", FREQUENCY, H.real, H.imag, H.real),
        "two columns 'a/a re",
    ),
    "a word": (cells("f,re [m/N],im [m/N]", FREQUENCY, H.real, H.imag) + "1e9,x,y\n", "line 403: column .* holds 'x'"),
    "a cell too few": (cells("f,re [m/N],im [m/N]", FREQUENCY, H.real, H.imag) + "1e9,3\n1e10,3,3\n", "line 403: 2 cells"),
    "a table cut short": (cells("f,re [m/N],im [m/N]", FREQUENCY, H.real, H.imag)[:-25], "line 402, the last one, is cut short"),
    "phase without unit": (
        cells("f,mag [m/N],phase", FREQUENCY, abs(H), np.angle(H)),
        "the phase has no unit",
    ),
    "contradiction": (
        cells("# form = accelerance\nf,re [m/N],im [m/N]", FREQUENCY, H.real, H.imag),
        "says accelerance and receptance",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", TEXTS)
def test_a_text_that_is_no_frf_is_one_line(tmp_path, what):
    text, said = TEXTS[what]
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(RecordingError, match=said) as problem:
        read_frf(tmp_path / "a.txt", **TIP)
    assert str(problem.value).startswith(f"{tmp_path / 'a.txt'}: ")
    assert "\n" not in str(problem.value)


# ---- names, signs and phases


def test_one_file_for_each_pair_is_named_by_the_user(tmp_path):
    for name, k in (("1.frf", 1.0), ("2.frf", 2.0), ("3.frf", 3.0)):
        (tmp_path / name).write_text(rows(k * H))
    paths = [tmp_path / f"{k}.frf" for k in (1, 2, 3)]
    read = read_frf(paths, outputs="1X", inputs=["1X", "2X", "-3X"])
    assert (read.outputs, read.inputs) == (("1X",), ("1X", "2X", "3X"))
    np.testing.assert_allclose(read.values[:, 0], np.outer(H, [1, 2, -3]), rtol=2e-6)
    with pytest.raises(RecordingError, match="3 files and 2 names; give --hammer once, or for each file"):
        read_frf(paths, outputs="1X", inputs=["1X", "2X"])
    with pytest.raises(RecordingError, match="name response and hammer with --response"):
        read_frf(paths)


@pytest.mark.parametrize("name", ["a.uff", "a.csv", "a.h5"])
def test_a_whole_matrix_is_renamed_and_turned(tmp_path, name):
    write_frf(tmp_path / name, plain(coherence=make().coherence))
    read = read_frf(tmp_path / name, outputs=["noseX", "-noseY"], inputs=["noseX", "noseZ"])
    assert (read.outputs, read.inputs, read.hits_used) == (("noseX", "noseY"), ("noseX", "noseZ"), (5, 7))
    np.testing.assert_allclose(read.values, plain().values * [[[1], [-1]]], rtol=1e-12)
    with pytest.raises(RecordingError, match=r"2 outputs .tipX, tipY. and 1 names; give --response once for each"):
        read_frf(tmp_path / name, outputs=["noseX"])


@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
def test_a_driving_point_that_gives_power_is_told_with_its_cause(tmp_path, form):
    frf = plain(form=form)
    one = frf.values * [[[1, 1], [-1, -1]]]
    for name, values in {
        "right": frf.values, "turned": -frf.values, "conjugated": frf.values.conj(), "both": -frf.values.conj(), "one": one,
    }.items():  # fmt: skip
        write_frf(tmp_path / f"{name}.csv", replace(frf, values=values))
    found = {p.stem: codes(read_frf(p)) for p in sorted(tmp_path.glob("*.csv"))}
    assert found == {
        "right": [],
        "turned": ["accelerometer-polarity"],
        "conjugated": ["conjugated"],
        "both": ["conjugated", "accelerometer-polarity"],
        "one": ["driving-point-sign"],
    }
    same(read_frf(tmp_path / "conjugated.csv", conjugate=True), frf)
    mended = read_frf(tmp_path / "turned.csv", outputs=["-tipX", "-tipY"])
    np.testing.assert_array_equal(mended.values, frf.values)


@pytest.mark.parametrize("form", ["receptance", "accelerance"])
def test_drift_towards_rest_is_told_and_a_stated_band_leaves_it_out(tmp_path, form):
    lines = np.arange(1, 2001) * 1.0
    clean = receptance(lines, MODES)[:, :1, :1]
    drift = -3e-3 / (2 * np.pi * lines[:, None, None]) ** 2  # an offset of the accelerance
    for name, values in (("clean.csv", clean), ("drift.csv", clean + drift)):
        values = convert_frf(lines, values, "receptance", form)
        write_frf(tmp_path / name, Frf(frequency=lines, values=values, form=form, estimator="unknown", outputs=("tipX",),
                                       inputs=("tipX",), hits_used=(0,), usable_band=(1.0, 2000.0)))  # fmt: skip
    assert codes(read_frf(tmp_path / "clean.csv")) == []
    assert codes(read_frf(tmp_path / "drift.csv")) == ["low-frequency-drift"]
    read = read_frf(tmp_path / "drift.csv", band=(150.0, 1800.0))
    assert (read.usable_band, codes(read)) == ((150.0, 1800.0), [])


@pytest.mark.parametrize("band", [(100.0, 100.0), (9e3, 1e4), (300.0, 200.0)])
def test_a_band_without_lines_is_refused(tmp_path, band):
    write_frf(tmp_path / "a.csv", plain())
    with pytest.raises(RecordingError, match="no part of the lines from 0 to 2500 Hz"):
        read_frf(tmp_path / "a.csv", band=band)


# ---- HDF5


def contract_file(path, frf, **attributes):
    with h5py.File(path, "w") as file:
        file["frequency"], file["values"] = frf.frequency, frf.values
        file.attrs.update({"form": frf.form, "outputs": list(frf.outputs), "inputs": list(frf.inputs)} | attributes)


def test_the_plain_file_of_the_contract_is_read_with_its_unit(tmp_path):
    contract_file(tmp_path / "a.h5", plain())
    np.testing.assert_array_equal(read_frf(tmp_path / "a.h5").values, plain().values)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["values"].attrs["unit"] = "g/N"
    np.testing.assert_allclose(read_frf(tmp_path / "a.h5").values, 9.80665 * plain().values, rtol=1e-12)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["values"].attrs["unit"] = "m/N"
    with pytest.raises(RecordingError, match="a accelerance in m/N; correct one of the two"):
        read_frf(tmp_path / "a.h5")


def test_a_result_of_millcal_is_read_as_it_is(tmp_path):
    from millcal.data import Hit, Notice

    frf = make(hits=(Hit("tap.h5", 0, 0.1, 100.0, True),), notices=(Notice("x", "y"),))
    write_frf(tmp_path / "a.h5", frf, provenance={"seed": 3})
    read = read_frf(tmp_path / "a.h5")
    assert (read.hits, read.notices) == (frf.hits, frf.notices)


def test_other_files_are_named_for_what_they_are(tmp_path):
    from millcal.io.recordings import read_recording, write_recording

    source = Path(__file__).parents[1] / "references" / "impact_12_B_badhits" / "tap_tipX.h5"
    write_recording(tmp_path / "cut.h5", read_recording(source))
    for name, data, said in [
        ("cut.h5", None, "holds millcal-recording where Frf is needed; make one with 'millcal frf'"),
        ("a.zip", b"PK\x03\x04" + bytes(50), "zip archive"),
        ("a.bin", bytes(range(256)) * 20, "binary, and of no format"),
        ("folder", None, "a folder"),
        ("absent.uff", None, "no such file"),
    ]:
        (tmp_path / "folder").mkdir(exist_ok=True)
        if data:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(RecordingError, match=said):
            read_frf(tmp_path / name)


# ---- inspect


@pytest.mark.parametrize("name", ["a.uff", "a.csv", "a.h5", "a.frf"])
def test_inspect_tells_the_pairs_of_an_frf(tmp_path, name):
    path = write_frf(tmp_path / name, make("receptance")).paths[0]
    assert is_frf_file(path)
    result, _ = inspect_recording(path)
    assert result["frf"]["form"] == "receptance"
    assert result["frf"]["frequency_hz"] == [0.0, 2500.0, 401]
    pairs = ["tipX/tipX"] if name == "a.frf" else ["tipX/tipX", "tipY/tipX", "tipX/tipY", "tipY/tipY"]
    assert [channel["name"] for channel in result["channels"]] == pairs
    assert result["channels"][0]["max"] == pytest.approx(np.abs(make("receptance").values[:, 0, 0]).max())
    assert result["missing"] == []


def test_inspect_takes_recordings_for_recordings(tmp_path):
    t = np.arange(4096) / 25600
    for name, text in [
        ("a.csv", cells("t [s],F [N],a [g]", t, np.sin(t), np.cos(t))),
        ("b.txt", cells("0.0,1.0,2.0", t[1:], t[1:], t[1:])),
        ("c.csv", cells("Time;Fx;Fy;Fz", t, t, t, t, delimiter=";")),
    ]:
        (tmp_path / name).write_text(text)
        assert not is_frf_file(tmp_path / name)
    (tmp_path / "d.txt").write_text(rows(H))
    assert is_frf_file(tmp_path / "d.txt")
    assert inspect_recording(tmp_path / "d.txt")[0]["missing"][0].startswith("it does not say where it was measured")


def test_every_suffix_has_a_writer(tmp_path):
    for suffix in SUFFIXES:
        assert write_frf(tmp_path / f"a{suffix}", plain()).paths[0].stat().st_size > 1000


# ---- a real tool

REAL = Path(os.environ.get("MILLCAL_REFERENCE_DATA", "")) / "real" / "cutpro_hammer"


@pytest.mark.skipif(not REAL.is_dir(), reason="real FRFs absent: set MILLCAL_REFERENCE_DATA")
def test_a_real_tool_measured_at_five_points_is_read_and_written(tmp_path):
    paths = [REAL / f"Point_{k}_Channel_1_CH1.txt" for k in range(1, 6)]
    points = [f"{k}X" for k in range(1, 6)]
    frf = read_frf(paths, outputs="1X", inputs=points)
    assert (frf.form, frf.values.shape) == ("receptance", (5001, 1, 5))
    driving = frf.values[:, 0, 0]
    above = frf.frequency > 300
    peak = int(np.flatnonzero(above)[np.argmin(driving.imag[above])])
    assert abs(frf.frequency[peak] - 1071) < 6  # the dominant mode, by several methods 1068 to 1074 Hz
    assert "low-frequency-drift" in codes(frf)  # 0.77 m/N at 0 Hz
    assert not {"accelerometer-polarity", "conjugated"} & set(codes(frf))
    assert "conjugated" in codes(read_frf(paths, outputs="1X", inputs=points, conjugate=True))
    assert "accelerometer-polarity" in codes(read_frf(paths, outputs="-1X", inputs=points))
    for name, binary in (("a.uff", True), ("a.csv", False), ("a.h5", False)):
        write_frf(tmp_path / name, frf, binary=binary)
        np.testing.assert_array_equal(read_frf(tmp_path / name).values, frf.values)


@pytest.mark.skipif(not REAL.is_dir(), reason="real FRFs absent: set MILLCAL_REFERENCE_DATA")
def test_a_real_hit_over_time_is_no_frf():
    with pytest.raises(RecordingError, match="times and no frequencies"):
        read_frf(REAL / "Point1_Channel1_CH1.txt", **TIP)


# ---- damage


def damaged(data, rng):
    """A file with something wrong in it: cut off, bytes changed, lost, doubled, or characters of its head."""
    data, kind = bytearray(data), rng.integers(5)
    at, to = rng.integers(len(data), size=2)
    if kind == 0:
        return bytes(data[:at])
    if kind == 1:
        for place in rng.integers(len(data), size=5):
            data[place] = rng.integers(256)
    elif kind == 2:
        del data[at : at + 150]
    elif kind == 3:
        data[at:at] = data[to : to + 150]
    else:
        for place in rng.integers(min(len(data), 1500), size=3):
            data[place] = rng.choice(list(b"0123456789 -+.EeD\n"))
    return bytes(data)


def endure(tmp_path, seeds):
    """Read damaged files: a result, or one line."""
    frf = make(frequency=np.arange(30) * 6.25)
    options = {"a.uff": False, "b.uff": True, "c.csv": False, "d.frf": False}
    made = [write_frf(tmp_path / name, frf, binary=binary).paths[0].read_bytes() for name, binary in options.items()]
    told = []
    for seed in seeds:
        path = tmp_path / f"x{list(options)[seed % 4][1:]}"
        path.write_bytes(damaged(made[seed % 4], np.random.default_rng(seed)))
        for read in (read_frf, inspect_recording):
            try:
                read(path)
            except RecordingError as problem:
                told.append(str(problem).removeprefix(str(path)))
    assert all(re.fullmatch(": [^\n]*", line) for line in told)
    return len(told)


def test_a_damaged_file_is_a_result_or_one_line(tmp_path):
    assert endure(tmp_path, range(80)) > 40


@pytest.mark.long
def test_many_damaged_files_are_results_or_one_line(tmp_path):
    assert endure(tmp_path, range(1000, 4000)) > 1500
