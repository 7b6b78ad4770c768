"""What real tests bring: a noisy hammer, sensors of several kinds, dead channels, gaps, uneven lines, records of any length."""

from dataclasses import replace

import impact_cases
import numpy as np
import pytest
from impact_cases import HAMMER, KINDS, STRUCTURES, Structure, make_case
from impact_errors import frf_error, modal_errors

from millcal.data import Frf
from millcal.errors import IllPosedError
from millcal.numerics.mode_fit import Fit, Model, fit_poles
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import corrected_frf, fit_modes
from millcal.stages.modes.problem import lines_of, problem_of, stride_of

TOOL = STRUCTURES["B"]
ONE = {"recordings": HAMMER[:1]}
LINES = np.arange(300.0, 3000.0, 2.0)


def codes(modes):
    return [notice.code for notice in modes.notices]


def errors(structure, modes):
    fit = modes.fit
    return modal_errors(structure, modes.natural_frequency, modes.damping_ratio, fit.residue, fit.outputs, fit.inputs)


def lines_only(structure, frequency=LINES, dofs=("tipX", "tipY"), noise=0.0, seed=0):
    """A receptance of another program."""
    values = structure.receptance(frequency, dofs, dofs)
    rng = np.random.default_rng(seed)
    values = values + noise * np.abs(values).mean() * (rng.standard_normal((*values.shape, 2)) @ [1, 1j])
    return Frf(
        frequency=frequency,
        values=values,
        form="receptance",
        estimator="unknown",
        outputs=dofs,
        inputs=dofs,
        hits_used=(0,) * len(dofs),
        usable_band=(float(frequency[0]), float(frequency[-1])),
    )


def fit_at_truth(frf, structure) -> Fit:
    """The fit that starts from the true modes."""
    problem = problem_of(frf, lines_of(frf, None)[:: stride_of(frf)])
    true = structure.natural_frequency[structure.in_band], structure.damping_ratio[structure.in_band]
    return fit_poles(problem.channels, *true, Model(False, (-2, 0, 2)))


@pytest.mark.parametrize("name", ["04_B_med", "06_A_med", "10_C_light"])
def test_the_true_modes_leave_what_is_expected_of_noise(name):
    """One for each real number by the accelerometers; of the noise of the force, twice its average is allowed for."""
    case = make_case(name, 4)
    fit = fit_at_truth(estimate_frf(case.recordings), case.structure)
    assert 0.5 < fit.cost / fit.expected < 1.1
    assert 0.9 < fit.cost / fit.rows < 1.5


@pytest.mark.parametrize("name", ["04_B_med", "10_C_light"])
def test_noise_of_the_hammer_is_no_mode(name, monkeypatch):
    """It multiplies the whole response of a hit, and stands at a resonance far above the noise of the accelerometers."""
    monkeypatch.setitem(impact_cases.KINDS, "noisy hammer", replace(KINDS[name], noise=(1e-2, 5e-4)))
    case = make_case("noisy hammer", 1)
    modes = fit_modes(estimate_frf(case.recordings))
    assert len(modes.natural_frequency) == 3
    assert not modes.fit.complex_modes
    assert modes.fit.delay is None
    assert errors(case.structure, modes).natural_frequency < 2e-4


@pytest.mark.parametrize("known", ["variance", "coherence"])
def test_noise_of_another_programs_hammer_is_no_mode_either(known, monkeypatch):
    """A file without hits tells it by the variance of its lines, or by their coherence."""
    monkeypatch.setitem(impact_cases.KINDS, "noisy hammer", replace(KINDS["06_A_med"], noise=(2e-2, 5e-4)))
    case = make_case("noisy hammer", 1)
    frf = replace(estimate_frf(case.recordings), tests=(), hits_used=(0, 0, 0))
    modes = fit_modes(frf if known == "variance" else replace(frf, variance=None))
    assert len(modes.natural_frequency) == 3
    assert not modes.fit.complex_modes
    assert errors(case.structure, modes).natural_frequency < 5e-4


def test_intervals_of_one_hit_know_the_noise_of_the_hammer(monkeypatch):
    """The scatter of the lines alone holds the truth in one of five."""
    monkeypatch.setitem(impact_cases.KINDS, "noisy hammer", replace(KINDS["04_B_med"], noise=(1e-2, 5e-4), **ONE))
    held = []
    for seed in range(8):
        case = make_case("noisy hammer", seed)
        modes = fit_modes(estimate_frf(case.recordings, drop=range(1, 9)))
        for estimate, true in (
            (modes.frequency_estimate, TOOL.natural_frequency),
            (modes.damping_estimate, TOOL.damping_ratio),
        ):
            low, high = modes.interval(estimate).T
            held += list((low <= true) & (true <= high))
        assert "1 hit at tipX" in modes.notices[-1].message
    assert np.mean(held) > 0.85


def with_displacement(name, seed, dofs, monkeypatch):
    """A case where some accelerometers are displacement sensors, which say 1e-7 m where the others say 1 m/s^2."""
    accelerance = Structure.accelerance

    def mixed(self, frequency, outputs, inputs):
        values = accelerance(self, frequency, outputs, inputs)
        for dof in dofs:
            values[:, outputs.index(dof)] = 1e7 * self.receptance(frequency, (dof,), inputs)[:, 0]
        return values

    with monkeypatch.context() as patch:
        patch.setattr(Structure, "accelerance", mixed)
        case = make_case(name, seed)
    recordings = []
    for recording in case.recordings:
        moved = [c.dof in dofs and c.quantity != "force" for c in recording.channels]
        scale = np.where(moved, 1e-7, 1.0)
        channels = tuple(
            replace(c, quantity="displacement", unit="m", full_scale=c.full_scale * 1e-7) if there else c
            for c, there in zip(recording.channels, moved, strict=True)
        )
        recordings.append(replace(recording, samples=recording.samples * scale[:, None], channels=channels))
    return case, recordings


@pytest.mark.parametrize("dofs", [("tipX",), ("holdX", "noseX")])
def test_sensors_of_two_kinds_are_fitted_in_what_each_measures_and_told_in_one_form(dofs, monkeypatch):
    case, recordings = with_displacement("10_C_light", 3, dofs, monkeypatch)
    frf = estimate_frf(recordings)
    modes = fit_modes(frf)
    fit = modes.fit
    assert {form for test in frf.tests for form in test.forms} == {"receptance", "accelerance"}
    assert errors(case.structure, modes).residue < 5e-4
    assert fit.residual_relative < 3e-3
    for values in (fit.measured, fit.modelled):  # cut off, but of the right size in the one form
        assert frf_error(case.structure, fit.frequency, values, fit.form, fit.outputs, fit.inputs) < 0.3
    assert frf_error(case.structure, fit.frequency, fit.synthesised, fit.form, fit.outputs, fit.inputs) < 1e-3
    mended = corrected_frf(frf, modes)
    assert frf_error(case.structure, mended.frequency, mended.values, mended.form, frf.outputs, frf.inputs) < 2e-3


def test_records_of_all_lengths_cut_each_hit_elsewhere():
    case = make_case("10_C_light", 3)
    lengths = np.linspace(1500, 4000, 9).astype(int)
    recordings = [replace(r, segments=np.c_[r.segments[:, 0], lengths]) for r in case.recordings]
    modes = fit_modes(estimate_frf(recordings))
    assert modes.fit.interval_from == "jackknife"
    assert errors(case.structure, modes).residue < 5e-4


def test_roving_accelerometers_are_two_tests_of_one_input():
    """Four accelerometers here, four there, two of them in both: outputs that were measured twice have twice the hits."""
    first, second = (make_case("04_B_med", seed).recordings[0] for seed in (3, 4))

    def of(recording, rows, name):
        rows = [0, *(1 + row for row in rows)]
        channels = tuple(recording.channels[row] for row in rows)
        return replace(recording, samples=recording.samples[rows], channels=channels, name=name)

    frf = estimate_frf([of(first, (0, 1, 2, 3), "a.h5"), of(second, (2, 3, 4, 5), "b.h5")])
    assert sorted(len(test.names) for test in frf.tests) == [9, 9, 18]
    modes = fit_modes(frf)
    assert modes.fit.interval_from == "jackknife"
    assert errors(TOOL, modes).residue < 6e-3


def test_a_channel_that_never_moves_takes_nothing_from_the_others():
    frf = lines_only(TOOL, noise=0.01)
    values = frf.values.copy()
    values[:, 0, 1] = values[:, 1, 0] = 0.0
    modes = fit_modes(replace(frf, values=values))
    np.testing.assert_allclose(modes.natural_frequency, TOOL.natural_frequency, rtol=3e-5)
    assert (modes.fit.residue[:, 0, 1] == 0).all()
    case = make_case("04_B_med", 3)
    dead = [replace(r, samples=r.samples * np.where(np.arange(7) == 4, 0.0, 1.0)[:, None]) for r in case.recordings]
    modes = fit_modes(estimate_frf(dead))
    np.testing.assert_allclose(modes.natural_frequency, TOOL.natural_frequency, rtol=2e-4)
    with pytest.raises(IllPosedError, match="is zero"):
        fit_modes(replace(frf, values=0 * values))


def test_a_pair_with_gaps_is_left_out_and_told():
    frf = lines_only(TOOL, noise=0.01)
    values = frf.values.copy()
    values[200:210, 0, 1] = np.nan
    modes = fit_modes(replace(frf, values=values))
    assert "pairs-left-out" in codes(modes)
    assert np.isnan(modes.fit.residue[:, 0, 1]).all()
    kept = np.isfinite(modes.fit.residual)
    assert kept.tolist() == [[True, False], [True, True]]
    share = np.linalg.norm(modes.fit.residual[kept] * np.linalg.norm(frf.values, axis=0)[kept])
    assert modes.fit.residual_relative == pytest.approx(share / np.linalg.norm(frf.values[:, kept]), rel=1e-9)
    np.testing.assert_allclose(modes.natural_frequency, TOOL.natural_frequency, rtol=3e-5)


@pytest.mark.parametrize(
    "frequency",
    [
        np.geomspace(300, 3000, 1500),
        np.r_[np.arange(300.0, 800, 2), np.arange(1100.0, 3000, 2)],
        np.r_[300.0, 300.1, np.arange(310.0, 3000, 4)],
    ],
    ids=["logarithmic", "gap", "first step odd"],
)
def test_lines_may_be_uneven(frequency):
    modes = fit_modes(lines_only(TOOL, frequency, noise=0.01))
    np.testing.assert_allclose(modes.natural_frequency, TOOL.natural_frequency, rtol=5e-5)
    np.testing.assert_allclose(modes.damping_ratio, TOOL.damping_ratio, rtol=5e-3)


@pytest.mark.parametrize("zeta", [1e-4, 0.3])
def test_damping_may_be_very_light_or_very_heavy(zeta):
    structure = replace(
        TOOL, natural_frequency=np.array([650.0, 1200.0]), damping_ratio=np.full(2, zeta), shape=TOOL.shape[:, :2]
    )
    modes = fit_modes(lines_only(structure, noise=0.003))
    np.testing.assert_allclose(modes.damping_ratio, zeta, rtol=1e-3)


def test_one_frequency_in_two_directions_is_a_mode_with_both_stiffnesses():
    shape = np.zeros((6, 2))
    shape[0, 0], shape[1, 1] = 1.0, 1.2
    structure = replace(
        TOOL, natural_frequency=np.full(2, 1000.0), damping_ratio=np.full(2, 0.02), shape=shape, band=(500, 2000)
    )
    modes = fit_modes(lines_only(structure, np.arange(500.0, 2000, 2), noise=0.003))
    np.testing.assert_allclose(modes.natural_frequency, [1000.0], rtol=1e-5)
    k = [
        modes.driving_constants(*place).stiffness.value[0]
        for place in (modes.fit.driving_points[d] for d in HAMMER[:2])
    ]
    np.testing.assert_allclose(k, (2e3 * np.pi) ** 2 / np.array([1.0, 1.44]), rtol=1e-3)


def test_more_modes_than_allowed_are_told():
    modes = fit_modes(lines_only(TOOL, noise=0.001), most=2)
    assert len(modes.natural_frequency) <= 2
    assert "most-modes" in codes(modes)
    assert "most-modes" not in codes(fit_modes(lines_only(TOOL, noise=0.001)))


def test_far_too_many_modes_are_still_numbers():
    modes = fit_modes(lines_only(TOOL, noise=0.01), modes=15)
    assert len(modes.natural_frequency) == 15
    assert np.isfinite(modes.fit.residue_deviation).all()
