"""Laws of the modal fit: what must not change it, what must follow, and the slow way against the fast one."""

from dataclasses import replace

import numpy as np
import pytest
from impact_cases import STRUCTURES, make_case
from impact_errors import modal_errors

from millcal.data import Frf
from millcal.errors import IllPosedError
from millcal.physics.structure import convert_frf, convert_frf_variance
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import corrected_frf, fit_modes


@pytest.fixture(scope="module")
def tool():
    """Noisy hits in three directions on three modes."""
    case = make_case("04_B_med", 3)
    frf = estimate_frf(case.recordings)
    return case, frf, fit_modes(frf)


def codes(modes):
    return [notice.code for notice in modes.notices]


def errors(case, modes):
    fit = modes.fit
    return modal_errors(
        case.structure, modes.natural_frequency, modes.damping_ratio, fit.residue, fit.outputs, fit.inputs
    )


def converted(frf, form):
    return replace(
        frf,
        values=convert_frf(frf.frequency, frf.values, frf.form, form),
        variance=convert_frf_variance(frf.frequency, frf.variance, frf.form, form),
        form=form,
    )


def plain(structure, frequency, outputs=("tipX", "tipY"), inputs=("tipX", "tipY"), form="receptance", **more):
    """An FRF of another program: lines and nothing else."""
    return Frf(
        frequency=frequency,
        values=convert_frf(frequency, structure.receptance(frequency, outputs, inputs), "receptance", form),
        form=form,
        estimator="unknown",
        outputs=outputs,
        inputs=inputs,
        hits_used=(0,) * len(inputs),
        usable_band=(float(frequency[0]), float(frequency[-1])),
        **more,
    )


@pytest.mark.parametrize("form", ["receptance", "mobility"])
def test_the_form_asked_for_does_not_move_the_modes(tool, form):
    """Modes are fitted in the form that was measured, whatever the FRF was converted to."""
    _, frf, modes = tool
    again = fit_modes(converted(frf, form))
    np.testing.assert_allclose(again.natural_frequency, modes.natural_frequency, rtol=1e-9)
    np.testing.assert_allclose(again.fit.residue, modes.fit.residue, rtol=1e-6)


def test_stiffer_numbers_for_a_hammer_that_reads_twice(tool):
    case, _, modes = tool
    louder = [
        replace(
            r,
            samples=r.samples * np.array([[2.0]] + [[1.0]] * (len(r.channels) - 1)),
            channels=(replace(r.channels[0], full_scale=2 * r.channels[0].full_scale), *r.channels[1:]),
        )
        for r in case.recordings
    ]
    again = fit_modes(estimate_frf(louder))
    np.testing.assert_allclose(again.natural_frequency, modes.natural_frequency, rtol=1e-9)
    np.testing.assert_allclose(again.stiffness, 2 * modes.stiffness, rtol=1e-6)


def test_leaving_hits_out_one_by_one_gives_the_deviations(tool):
    """The jackknife takes one Gauss-Newton step from all hits; here each set of hits is estimated and fitted anew."""
    case, _, _ = tool
    recording = case.recordings[0]
    whole = fit_modes(estimate_frf(recording), modes=3)
    left_out = [fit_modes(estimate_frf(recording, drop=(hit,)), modes=3) for hit in range(9)]
    for name, deviation in (("natural_frequency", "frequency_deviation"), ("damping_ratio", "damping_deviation")):
        values = np.array([getattr(modes, name) for modes in left_out])
        slow = np.sqrt(8 / 9 * np.sum((values - values.mean(axis=0)) ** 2, axis=0))
        fast = np.sqrt(np.sum(getattr(whole.fit, deviation) ** 2, axis=0))
        np.testing.assert_allclose(fast, slow, rtol=0.1)


def test_the_lines_of_another_program_do_as_well():
    structure = STRUCTURES["B"]
    modes = fit_modes(plain(structure, np.arange(300.0, 3000.0, 2.0)))
    np.testing.assert_allclose(modes.natural_frequency, structure.natural_frequency, rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratio, structure.damping_ratio, rtol=1e-8)
    alpha = structure.modal_constants(("tipX",), ("tipX",))[:, 0, 0]
    np.testing.assert_allclose(modes.stiffness, (2 * np.pi * structure.natural_frequency) ** 2 / alpha, rtol=1e-6)
    assert "intervals-from-lines" in codes(modes)


def test_close_modes_that_move_apart_are_two():
    """A tool that is nearly alike in x and y: 1 % between the modes, less than their width."""
    structure = replace(
        STRUCTURES["B"],
        natural_frequency=np.array([1000.0, 1010.0]),
        damping_ratio=np.array([0.02, 0.025]),
        shape=np.eye(6)[:, :2] + 0.05,
    )
    modes = fit_modes(plain(structure, np.arange(500.0, 2000.0, 1.0)))
    np.testing.assert_allclose(modes.natural_frequency, [1000, 1010], rtol=1e-6)
    assert set(modes.axes) == {"x", "y"}


def test_a_delay_is_found_taken_out_and_told():
    case = make_case("04_B_med", 5)
    frf = estimate_frf(case.recordings)
    late = replace(frf, values=frf.values * np.exp(-2j * np.pi * frf.frequency * 15e-6)[:, None, None])
    modes = fit_modes(late)
    np.testing.assert_allclose(modes.fit.delay, 15e-6, atol=0.3e-6)
    assert "delay" in codes(modes)
    assert not modes.fit.complex_modes
    found, plain_errors = errors(case, modes), errors(case, fit_modes(frf))
    assert found.residue < 1.5 * plain_errors.residue
    assert modes.fit.residual_relative < 1.1 * fit_modes(frf).fit.residual_relative
    assert fit_modes(frf).fit.delay is None


def test_a_turned_accelerometer_is_told_and_has_no_stiffness(tool):
    _, frf, modes = tool
    turned = fit_modes(replace(frf, values=-frf.values))
    assert codes(turned).count("accelerometer-polarity") == 3
    assert np.isnan(turned.stiffness).all()
    np.testing.assert_allclose(turned.natural_frequency, modes.natural_frequency, rtol=1e-7)


def test_what_the_user_knows_is_obeyed(tool):
    _, frf, modes = tool
    assert len(fit_modes(frf, modes=2).natural_frequency) == 2
    assert len(fit_modes(frf, modes=5).natural_frequency) == 5
    near = fit_modes(frf, near=(1180.0, 640.0))
    np.testing.assert_allclose(near.natural_frequency, modes.natural_frequency[:2], rtol=0.01)
    narrow = fit_modes(frf, band=(900.0, 1500.0))
    assert narrow.fit.band[0] >= 900.0
    assert narrow.fit.band[1] <= 1500.0
    inside = (narrow.natural_frequency > 900.0) & (narrow.natural_frequency < 1500.0)
    np.testing.assert_allclose(narrow.natural_frequency[inside], [1200.0], rtol=1e-3)
    assert inside.all() or "mode-outside-band" in codes(narrow)
    assert fit_modes(frf, complex_modes=True).fit.complex_modes
    assert len(fit_modes(frf, remainder=0, complex_modes=False).fit.remainder_power) == 0


def test_real_modes_stay_real_and_complex_ones_are_found():
    structure = STRUCTURES["B"]
    frequency = np.arange(300.0, 3000.0, 2.0)
    frf = plain(structure, frequency)
    assert not fit_modes(frf).fit.complex_modes
    w_d = 2 * np.pi * structure.natural_frequency * np.sqrt(1 - structure.damping_ratio**2)
    p = 2 * np.pi * structure.natural_frequency * -structure.damping_ratio + 1j * w_d
    A = structure.modal_constants(("tipX", "tipY"), ("tipX", "tipY")) / (2j * w_d)[:, None, None]
    A = A * np.exp(1j * np.radians([12.0, -15.0, 10.0]))[:, None, None]
    s = 2j * np.pi * frequency[:, None]
    values = np.einsum("moi,fm->foi", A, 1 / (s - p)) + np.einsum("moi,fm->foi", A.conj(), 1 / (s - p.conj()))
    modes = fit_modes(replace(frf, values=values))
    assert modes.fit.complex_modes
    assert modes.fit.delay is None
    np.testing.assert_allclose(modes.natural_frequency, structure.natural_frequency, rtol=1e-8)
    np.testing.assert_allclose(modes.fit.residue, A, rtol=1e-5, atol=1e-8 * np.abs(A).max())


@pytest.mark.parametrize("exponential", [None, 0.05])
def test_records_too_short_are_undone(exponential):
    """A fourth of the light modes' response is cut off; an exponential window is a shift of s, and no damping remains."""
    case = make_case("10_C_light", 2)
    frf = estimate_frf(case.recordings, exponential=exponential)
    modes = fit_modes(frf)
    assert errors(case, modes).damping_ratio < 5e-3
    assert errors(case, modes).residue < 5e-3
    corrected = corrected_frf(frf, modes)
    inside = (corrected.frequency >= 300) & (corrected.frequency <= 3000)
    truth = case.structure.accelerance(corrected.frequency[inside], frf.outputs, frf.inputs)
    lines = np.searchsorted(frf.frequency, corrected.frequency[inside])

    def error(values):
        return np.linalg.norm(values - truth) / np.linalg.norm(truth)

    assert error(frf.values[lines]) > 20 * error(corrected.values[inside])


def test_several_hammers_at_once_are_corrected_too():
    """Oblique hits with three force channels, in records that cut the decay: columns leak into each other and back."""
    case = make_case("11_B_oblique3", 1)
    frf = estimate_frf(case.recordings, record_length=0.02)
    modes = fit_modes(frf)
    corrected = corrected_frf(frf, modes)
    inside = (corrected.frequency >= 300) & (corrected.frequency <= 3000)
    truth = case.structure.accelerance(corrected.frequency[inside], frf.outputs, frf.inputs)
    lines = np.searchsorted(frf.frequency, corrected.frequency[inside])
    before = np.linalg.norm(frf.values[lines] - truth)
    assert np.linalg.norm(corrected.values[inside] - truth) < 0.5 * before
    assert errors(case, modes).damping_ratio < 0.02


def test_the_correction_is_none_where_nothing_was_cut():
    structure = STRUCTURES["B"]
    frf = plain(structure, np.arange(300.0, 3000.0, 2.0), form="accelerance")
    modes = fit_modes(frf)
    np.testing.assert_allclose(corrected_frf(frf, modes).values, frf.values, rtol=1e-12)
    with pytest.raises(IllPosedError, match="another FRF"):
        corrected_frf(plain(structure, np.arange(300.0, 3000.0, 3.0)), modes)


def test_one_hit_says_that_its_intervals_are_short(tool):
    case, _, _ = tool
    recording = case.recordings[0]
    modes = fit_modes(estimate_frf(recording, keep=(0,), drop=range(1, 9)))
    assert modes.fit.interval_from == "least squares"
    assert "intervals-from-lines" in codes(modes)


def test_noise_alone_holds_no_mode():
    rng = np.random.default_rng(0)
    frequency = np.arange(100.0, 1000.0, 2.0)
    frf = plain(STRUCTURES["B"], frequency)
    with pytest.raises(IllPosedError, match="none stands out"):
        fit_modes(replace(frf, values=rng.standard_normal((*frf.values.shape, 2)) @ [1, 1j]))


def test_what_cannot_be_fitted_is_refused(tool):
    _, frf, _ = tool
    with pytest.raises(IllPosedError, match="no response of a structure"):
        fit_modes(replace(frf, form="transmissibility"))
    with pytest.raises(IllPosedError, match="lines between"):
        fit_modes(frf, band=(600.0, 610.0))
    with pytest.raises(IllPosedError, match="outside of the band"):
        fit_modes(frf, near=(20_000.0,))


def test_the_same_frf_gives_the_same_numbers(tool):
    _, frf, modes = tool
    again = fit_modes(frf)
    np.testing.assert_array_equal(again.fit.residue, modes.fit.residue)
    np.testing.assert_array_equal(again.fit.residue_deviation, modes.fit.residue_deviation)
