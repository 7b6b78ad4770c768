"""A resonant dynamometer between the tool and the record: what its FRF restores, and what its noise costs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from millcal.data import CutForce, Frf
from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import LinearEdge, force_at
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import simulate_impact
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.coefficients.harmonic import search
from millcal.stages.coefficients.harmonic_model import model_of as question
from millcal.stages.coefficients.harmonic_model import refine
from millcal.stages.coefficients.sensor import interpolated_sensor, sensor_covariance, sensor_variance, within_reach
from millcal.stages.frf import estimate_frf

LAW = LinearEdge(cutting=np.array([820e6, 260e6, 230e6]), edge=np.array([18e3, 16e3, 6e3]))
TRUTH = np.concatenate([LAW.cutting, LAW.edge])
FEEDS = (0.05, 0.075, 0.1, 0.125, 0.15)
LAG = (
    1.5e-3 * np.tan(np.pi / 6) / 8e-3
)  # to mid depth, where the offset stands on tooth 0: two teeth show that part alone
CUTTER = Cutter(diameter=16e-3, teeth=2, helix=np.pi / 6, runout=4e-6, runout_angle=-LAG)
BARE = replace(CUTTER, runout=0.0, runout_angle=0.0)
RESONANT = MeasuringChain(resonance=(975.0, 790.0, 1000.0), damping_ratio=(0.02, 0.01, 0.05))
DOFS = ("tipX", "tipY", "tipZ")


def through(cuts, chain: MeasuringChain) -> tuple[CutForce, ...]:
    """The cuts as a dynamometer would show them, with a cutter whose runout nobody knows."""
    shown = []
    for cut in cuts:
        gain = chain.transfer(np.arange(cut.harmonics.shape[1]) * cut.spindle_frequency, 3)
        harmonics = np.einsum("ijk,jk->ik", gain, cut.harmonics)
        mean = harmonics[:, 0].real
        shown.append(
            replace(
                cut,
                cutter=BARE,
                harmonics=harmonics,
                mean_all_rows=mean,
                revolution_means=np.repeat(mean[:, np.newaxis], 20, axis=1),
                average=force_at(harmonics, cut.average_angle),
                ac_rms=np.sqrt(np.sum(np.abs(harmonics[:, 1:]) ** 2, axis=1) / 2),
            )
        )
    return tuple(shown)


def frf_of(values: np.ndarray, frequency: np.ndarray, *, variance: float = 0.0, **more) -> Frf:
    """A transmissibility.   values : complex (frequency, output, input)"""
    n = values.shape[2]
    known = {
        "form": "transmissibility",
        "estimator": "h1",
        "outputs": DOFS[: values.shape[1]],
        "inputs": DOFS[:n],
        "hits_used": (6,) * n,
        "usable_band": (0.0, 1300.0),
        "variance": np.full(values.shape, variance),
    }
    return Frf(frequency=frequency, values=values, **known | more)


def true_frf(chain: MeasuringChain = RESONANT, **more) -> Frf:
    frequency = np.arange(0.0, 2000.0, 2.0)
    return frf_of(chain.transfer(frequency, 3).transpose(2, 0, 1), frequency, **more)


def hit_frf(chain: MeasuringChain, seed: int) -> Frf:
    """What six noisy hits in each direction give."""
    tests = [
        simulate_impact(
            (),
            rng=np.random.default_rng([seed, axis]),
            hammer=DOFS[axis],
            dynamometer=replace(chain, noise=0.8),
            hammer_chain=MeasuringChain(noise=0.2),
            sample_rate=8192.0,
            hits=6,
            record=0.25,
            peak=800.0,
            pulse=0.6e-3,
            name=f"tap-{axis}.h5",
        )[0]
        for axis in range(3)
    ]
    return estimate_frf(tests)


def test_without_noise_the_true_frf_gives_the_coefficients_to_a_millionth(series):
    """Harmonics at 100 to 1200 Hz, over all three resonances."""
    cuts = through(series(LAW, CUTTER, FEEDS), RESONANT)
    found = fit_coefficients(cuts, sensor=true_frf())
    assert found.band == (0, 12)
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=1e-6)
    assert found.verdict == "fits"


def test_ignoring_the_sensor_biases_the_coefficients_and_fails_the_verdict(series):
    cuts = through(series(LAW, CUTTER, FEEDS), RESONANT)
    found = fit_coefficients(cuts, harmonics=12, mean_weight=1.0)
    assert found.verdict.startswith("does not fit")
    assert np.abs(found.posterior.mean[:6] / TRUTH - 1).max() > 0.15
    # mean forces know of no resonance and hold the answer by their weight; the verdict stands
    held = fit_coefficients(cuts, harmonics=12)
    assert held.verdict.startswith("does not fit")
    assert 0.02 < np.abs(held.posterior.mean[:6] / TRUTH - 1).max() < 0.05
    # and with the harmonics of the default, far below the resonances, the alternating force still says so
    checks = {check.name: check.passed for check in fit_coefficients(cuts).checks}
    assert not checks["offset"]
    assert not checks["above-tooth-passing"]


def test_cross_talk_is_undone_in_the_harmonics_and_at_rest(series):
    chain = replace(RESONANT, cross_talk=0.02)
    cuts = through(series(LAW, CUTTER, FEEDS), chain)
    assert fit_coefficients(cuts, sensor=true_frf(chain)).posterior.mean[:6] == pytest.approx(TRUTH, rel=1e-6)
    alone = fit_coefficients(through(series(LAW, CUTTER, FEEDS), MeasuringChain(cross_talk=0.02)))
    assert np.abs(alone.posterior.mean[:6] / TRUTH - 1).max() > 0.02


def test_a_stiff_sensor_changes_nothing(series):
    cuts = series(LAW, BARE, FEEDS, scatter=0.3, seed=2)
    plain = fit_coefficients(cuts, harmonics=6)
    stiff = fit_coefficients(cuts, harmonics=6, sensor=true_frf(MeasuringChain()))
    assert stiff.posterior.mean == pytest.approx(plain.posterior.mean, rel=1e-9, abs=1e-15)
    assert stiff.posterior.interval == pytest.approx(plain.posterior.interval, rel=1e-6, abs=1e-12)
    assert stiff.verdict == plain.verdict
    assert [check.passed for check in stiff.checks] == [check.passed for check in plain.checks]


def test_with_noise_and_a_measured_frf_all_six_are_within_three_percent(series):
    chain = replace(RESONANT, cross_talk=0.01)
    cuts = through(series(LAW, CUTTER, FEEDS, scatter=0.1, seed=5), chain)
    found = fit_coefficients(cuts, sensor=hit_frf(chain, seed=5))
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=0.03)
    assert found.verdict == "fits"


def shares_covered(series, seeds: range) -> np.ndarray:
    """How often each coefficient's truth is within its interval, cuts and hits drawn anew.   returns (coefficient,)"""
    chain = replace(RESONANT, cross_talk=0.01)
    inside = []
    for seed in seeds:
        cuts = through(series(LAW, CUTTER, FEEDS, scatter=0.1, seed=seed), chain)
        interval = fit_coefficients(cuts, sensor=hit_frf(chain, seed)).posterior.interval[:6]
        inside.append((interval[:, 0] <= TRUTH) & (interval[:, 1] >= TRUTH))
    return np.mean(inside, axis=0)


def test_the_intervals_hold_the_truth_with_the_noise_of_the_frf_in_them(series):
    n = 8
    assert np.all(n * shares_covered(series, range(n)) >= binom.ppf(1e-3, n, 0.95))


@pytest.mark.long
def test_the_intervals_hold_the_truth_in_nineteen_of_twenty(series):
    n = 100
    covered = n * shares_covered(series, range(1000, 1000 + n))
    assert np.all(covered >= binom.ppf(1e-3, n, 0.95))
    assert covered.mean() / n > 0.9


def test_what_the_noise_of_the_frf_costs_is_what_many_frfs_show(series):
    cuts = through(series(LAW, CUTTER, FEEDS), RESONANT)
    frequency = np.arange(0.0, 1500.0, 4.0)
    true = RESONANT.transfer(frequency, 3).transpose(2, 0, 1)
    frf = frf_of(true, frequency, variance=0.01**2, usable_band=(4.0, 1300.0))
    model = question(cuts, law="linear-edge", band=12, mean_weight=5.0, sensor=interpolated_sensor(frf))
    best, _ = search(model)
    expected = np.sqrt(np.diag(sensor_covariance(best, frf))[:6])
    rng = np.random.default_rng(8)
    n, drawn = 40, []
    for _ in range(n):
        parts = rng.standard_normal((2, len(frequency) // 4 + 1, 3, 3)) * 0.01 / np.sqrt(2)
        noise = np.repeat(parts[0] + 1j * parts[1], 4, axis=0)[
            : len(frequency)
        ]  # neighbours share it, as padding makes it
        noisy = interpolated_sensor(replace(frf, values=true + noise))
        drawn.append(refine(replace(best, model=replace(model, sensor=noisy))).linear)
    spread = np.std(drawn, axis=0)
    assert np.all(np.abs(spread / expected - 1) < 3.5 / np.sqrt(2 * n) + 0.05)


@pytest.mark.parametrize(("top", "band"), [(1300.0, 12), (1150.0, 11), (500.0, 5), (1e5, 12)])
def test_the_fit_takes_every_harmonic_that_the_frf_covers_and_no_more(series, top, band):
    cuts, highest, notices = within_reach(true_frf(usable_band=(0.0, top)), series(LAW, BARE, FEEDS), None)
    assert highest == band
    assert {cut.harmonics.shape for cut in cuts} == {(3, band + 1)}
    assert ("sensor-band" in [notice.code for notice in notices]) == (band < 12)


def test_harmonics_asked_for_beyond_the_frf_are_taken_and_told(series):
    cuts = through(series(LAW, CUTTER, FEEDS), RESONANT)
    found = fit_coefficients(cuts, sensor=true_frf(usable_band=(0.0, 500.0)), harmonics=8)
    assert found.band == (0, 8)
    (told,) = [notice for notice in found.notices if notice.code == "sensor-band"]
    assert "500 Hz" in told.message
    assert fit_coefficients(cuts, sensor=true_frf(), harmonics=3).band == (0, 3)


def test_an_frf_that_covers_no_harmonic_is_refused(series):
    cuts = series(LAW, BARE, FEEDS)
    with pytest.raises(IllPosedError, match="below the first harmonic"):
        fit_coefficients(cuts, sensor=true_frf(usable_band=(0.0, 80.0)))


def test_an_frf_of_motion_is_refused(series):
    cuts = series(LAW, BARE, FEEDS)
    with pytest.raises(IllPosedError, match="force over force"):
        fit_coefficients(cuts, sensor=true_frf(form="accelerance"))


def test_between_the_lines_the_frf_is_that_of_the_sensor():
    """Four lines in the half-power width, as an impact test gives at least."""
    frequency = np.arange(0.0, 2000.0, 2 * 0.02 * 975 / 4)
    chain = replace(RESONANT, damping_ratio=(0.02, 0.03, 0.05))
    gain = interpolated_sensor(frf_of(chain.transfer(frequency, 3).transpose(2, 0, 1), frequency))
    between = np.linspace(1.0, 1300.0, 997)
    true = chain.transfer(between, 3)
    assert np.abs(gain(between) - true).max() < 0.01 * np.abs(true).max()


def test_below_the_usable_band_the_sensor_is_what_it_is_at_rest():
    chain = MeasuringChain(cross_talk=0.03)
    frequency = np.arange(0.0, 2000.0, 2.0)
    values = chain.transfer(frequency, 3).transpose(2, 0, 1).copy()
    values[frequency < 20] = 7.0  # drift and mains of a short record
    gain = interpolated_sensor(frf_of(values, frequency, usable_band=(20.0, 1300.0)))
    assert gain(np.array([0.0, 10.0, 50.0])) == pytest.approx(chain.transfer(np.array([0.0, 10.0, 50.0]), 3))


def test_an_axis_that_nobody_hit_is_taken_as_perfect_and_told(series):
    chain = MeasuringChain(resonance=(975.0, 790.0, 1e9), damping_ratio=(0.02, 0.01, 0.05))
    frequency = np.arange(0.0, 2000.0, 2.0)
    frf = frf_of(chain.transfer(frequency, 3).transpose(2, 0, 1)[:, :2, :2], frequency)
    found = fit_coefficients(through(series(LAW, CUTTER, FEEDS), chain), sensor=frf)
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=1e-5)
    assert "sensor-axis" in [notice.code for notice in found.notices]


def test_pairs_that_stand_in_no_recording_are_no_cross_talk():
    frequency = np.arange(0.0, 2000.0, 2.0)
    values = RESONANT.transfer(frequency, 3).transpose(2, 0, 1).copy()
    values[:, ~np.eye(3, dtype=bool)] = np.nan
    frf = frf_of(values, frequency, variance=np.nan)
    at = np.array([100.0, 900.0])
    assert interpolated_sensor(frf)(at) == pytest.approx(RESONANT.transfer(at, 3))
    assert not sensor_variance(frf, at).any()


def test_mean_forces_need_no_sensor_and_say_so(series):
    cuts = series(LAW, BARE, FEEDS)
    found = fit_coefficients(cuts, method="average", sensor=true_frf())
    assert "sensor-unused" in [notice.code for notice in found.notices]
    assert found.posterior.mean == pytest.approx(fit_coefficients(cuts, method="average").posterior.mean)
