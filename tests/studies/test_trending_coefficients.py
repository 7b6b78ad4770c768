"""The study beside the paper's Table 3, its bands over fresh noise, and what each of the paper's printed errors would do."""

import numpy as np
import pytest

from millcal.studies import trending_coefficients as study
from millcal.studies.trending_coefficients import PAPER_CASES, Extent, force_rms_of_ensembles, simulate_case
from millcal.studies.trending_methods import (
    MEMBERS,
    box_prior,
    by_ensemble,
    by_smoothing,
    ensembles,
    perturbations,
    tangential_deviation,
)
from millcal.studies.trending_summary import summarise

# N: mean and standard deviation over draws of the noise, static, ascending, alternating; published with the method's study
BANDS = {
    "EnKF": ((3.92, 0.90), (22.64, 1.59), (54.3, 1.4)),
    "EnKF* 50, 10": ((6.55, 0.67), (7.82, 0.81), (9.62, 0.77)),
    "EnKF* 50, 1": ((8.25, 0.68), (9.53, 0.79), (9.40, 0.67)),
    "EnKF* 100, 10": ((5.77, 0.73), (7.29, 0.93), (13.54, 0.93)),
    "EnKF* 200, 10": ((5.03, 0.85), (7.67, 1.03), (21.71, 1.07)),
    "IMM": ((3.94, 0.88), (5.92, 0.89), (7.28, 0.72)),
    "RLS, no box": ((5.17, 0.64), (7.11, 0.86), (15.09, 0.93)),
    "smoother": ((1.50, 0.69), (2.12, 0.75), (2.58, 0.52)),
}
ONE_DRAW = {  # N, from and to, of a single draw
    "EnKF": ((0, 7.0), (17, 28), (49, 60)),
    "EnKF* 50, 10": ((0, 8.8), (0, 10.5), (0, 12.2)),
    "EnKF* 50, 1": ((0, 10.5), (0, 12.1), (0, 11.7)),
    "EnKF* 100, 10": ((0, 8.2), (0, 10.4), (0, 16.6)),
    "EnKF* 200, 10": ((0, 7.8), (0, 11.1), (0, 25.3)),
    "IMM": ((0, 7.0), (0, 8.9), (0, 9.7)),
    "RLS, no box": ((0, 7.3), (0, 10.0), (0, 18.2)),
    "RLS": ((0, np.inf), (0, 10.6), (0, np.inf)),
    "smoother": ((0, 4.0), (0, 4.8), (0, 4.4)),
}
RATIOS = {  # one method over another in a case, on the same noise: from and to of a single draw
    ("EnKF* 50, 10", "EnKF", "static"): (1.05, np.inf),
    ("EnKF* 50, 10", "EnKF", "ascending"): (0, 0.50),
    ("EnKF* 50, 10", "EnKF", "alternating"): (0, 0.26),
    ("EnKF* 50, 10", "EnKF* 50, 1", "static"): (0, 0.92),
    ("EnKF* 200, 10", "EnKF* 50, 10", "static"): (0, 1.0),
    ("EnKF* 200, 10", "EnKF* 50, 10", "alternating"): (1.8, np.inf),
    ("EnKF* 50, 10", "RLS", "alternating"): (0, 1 / 1.2),
    ("smoother", "EnKF* 50, 10", "static"): (0, 0.6),
    ("smoother", "EnKF* 50, 10", "ascending"): (0, 0.65),
    ("smoother", "EnKF* 50, 10", "alternating"): (0, 0.55),
}


@pytest.fixture(scope="module")
def small():
    return study.run(Extent(starts=10, draws=5, starts_of_draw=8), seed=20)


@pytest.fixture(scope="module")
def large():
    return study.run(Extent(starts=200, draws=32, starts_of_draw=24), seed=21)


def check_bands(found, outside=0):
    """outside : draws that may miss the band of one draw; the tails are heavier than a normal distribution's."""
    for method, bands in BANDS.items():
        draws = found.scatter[method]
        for column, (mean, deviation) in enumerate(bands):
            sure = 3.5 * deviation / np.sqrt(len(draws))
            assert draws[:, column].mean() == pytest.approx(mean, abs=sure), (method, PAPER_CASES[column])
    for method, ranges in ONE_DRAW.items():
        alone = [found.runs[method][case].force_rms for case in PAPER_CASES]
        draws = np.array([alone, *found.scatter[method]])
        low, high = np.transpose(ranges)
        missed = np.count_nonzero((draws < low) | (draws > high), axis=0)
        assert np.all(missed <= outside), (method, draws)


def check_ratios(found, outside=0):
    seen = {(p.claim.method, p.claim.other, p.claim.case): p.ratios for p in found.claims}
    for names, (low, high) in RATIOS.items():
        assert np.count_nonzero((seen[names] <= low) | (seen[names] >= high)) <= outside, (names, seen[names])
    for case in PAPER_CASES:
        assert seen["IMM", "EnKF* 50, 10", case].mean() < 0.9


def test_every_cell_is_within_its_band_on_fresh_noise(small):
    check_bands(small)


def test_methods_compare_on_the_same_noise_as_they_should(small):
    check_ratios(small)


def test_the_mean_over_noise_is_near_every_cell_of_the_papers_table(small):
    for setting, printed in study.PAPER.items():
        ours = small.scatter[study.name_of(setting)].mean(axis=0)
        assert np.abs(np.log(ours / printed)) == pytest.approx(np.zeros(3), abs=0.45), (setting, ours)
    apart = summarise(small)["rms_log_ratio_to_paper"]
    assert all(apart[case]["mean_of_draws"] < limit for case, limit in zip(PAPER_CASES, (0.3, 0.2, 0.15), strict=True))


@pytest.mark.long
def test_bands_and_ratios_hold_over_many_draws(large):
    check_bands(large, outside=2)
    check_ratios(large, outside=2)
    ratio = large.scatter["IMM"].mean(axis=0) / large.scatter["EnKF* 50, 10"].mean(axis=0)
    assert np.all(ratio <= (0.62, 0.78, 0.78)), ratio
    worst = max(
        abs(np.log(large.scatter[study.name_of(setting)].mean(axis=0) / printed)).max()
        for setting, printed in study.PAPER.items()
    )
    assert worst < 0.4


def test_inflation_and_step_order_the_settings_as_in_the_paper(small):
    """Static improves with step and lambda; alternating worsens with the step."""
    mean = {setting: small.scatter[study.name_of(setting)].mean(axis=0) for setting in study.PAPER if setting}
    for step in study.STEPS:
        static = [mean[step, divisor][0] for divisor in study.DIVISORS]
        assert np.all(np.diff(static) < 0)
    for divisor in study.DIVISORS:
        assert np.all(np.diff([mean[step, divisor][0] for step in study.STEPS]) < 0)
        assert np.all(np.diff([mean[step, divisor][2] for step in study.STEPS]) > 0)


def test_the_other_start_of_a_method_changes_little_but_for_the_classic_filter(small):
    """The paper's finding: inflated ensembles forget where they began, classic ones of the alternating case do not."""
    classic = small.runs["EnKF"]["alternating"].deviation[1].mean()
    inflated = small.runs["EnKF* 50, 10"]["alternating"].deviation[1].mean()
    assert inflated < 0.3 * classic


def test_a_seed_gives_one_result_and_another_seed_another():
    tiny = Extent(starts=2, draws=1, starts_of_draw=1)
    shares = []
    one = study.run(tiny, seed=3, progress=lambda share, label: shares.append(share))
    two, other = study.run(tiny, seed=3), study.run(tiny, seed=4)
    assert summarise(one) == summarise(two)
    assert summarise(one)["table"] != summarise(other)["table"]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


def six_states(cut, members, normals, samples):
    """The filter with the forces in the state, [F_t F_r k_t m_t k_r m_r] and H = [I 0]: eqs. 9-17 as they are written."""
    from millcal.physics.disc_force import shape
    from millcal.studies.trending_cuts import BOX

    chips = cut.chips[:, :, cut.active]
    H = np.hstack([np.eye(2), np.zeros((2, 4))])
    theta, means = members.T.copy(), []
    for k in range(samples):
        chip = np.broadcast_to(chips[:, :, [k]], (*chips.shape[:2], MEMBERS))
        forces = [1e6 * theta[i] * shape(chip, theta[i + 1], 2e-3 / 23, 1e-3) for i in (0, 2)]
        X = np.vstack([*forces, theta])
        deviation = X - X.mean(axis=1, keepdims=True)
        P = deviation @ deviation.T / MEMBERS
        eps = cut.sigma[:, None] * normals[k].T
        R = eps @ eps.T / MEMBERS
        G = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        X = X + G @ (cut.active_force[k][:, None] + eps - H @ X)
        theta = np.clip(X[2:], BOX[:, :1], BOX[:, 1:])
        means.append(theta.mean(axis=1))
    return np.array(means)


def test_the_filter_with_forces_in_its_state_moves_the_coefficients_alike():
    cut, members = simulate_case("ascending", 1), ensembles(1, 1)[0]
    (normals,) = perturbations(1, 1)
    ours = by_ensemble(cut, members, normals, np.random.default_rng(0), None)[:300]
    assert ours == pytest.approx(six_states(cut, members, normals, 300), rel=1e-5)


def test_the_gain_as_printed_cannot_be_formed():
    """Eqs. 18-20: C is of the forces and D of coefficients and forces; their sum and product have no shape."""
    rng = np.random.default_rng(0)
    X, Y = rng.standard_normal((4, 100)), rng.standard_normal((2, 100))
    C, D = Y @ Y.T / 100, X @ Y.T / 100
    with pytest.raises(ValueError, match="broadcast"):
        C @ np.linalg.inv(D + np.eye(2))
    assert (D @ np.linalg.inv(C + np.eye(2))).shape == (4, 2)


def test_a_measurement_one_sample_later_as_printed_doubles_the_error_of_the_resting_case():
    cases = [simulate_case("static", seed) for seed in (31, 32)]
    right = [force_rms_of_ensembles(cut, None, 1, 6) for cut in cases]
    late = [force_rms_of_ensembles(cut, None, 1, 6, lag=1) for cut in cases]
    assert np.mean(late) > 1.6 * np.mean(right)


def test_lambda_the_other_way_round_would_turn_the_papers_trend():
    """Static error falls with lambda in the table; with lambda P_0 for P_0 / lambda it rises."""
    cut = simulate_case("static", 33)
    at_1, at_5 = (force_rms_of_ensembles(cut, (50, divisor), 1, 6) for divisor in (1.0, 5.0))
    turned = force_rms_of_ensembles(cut, (50, 1 / 5.0), 1, 6)
    assert at_5 < at_1 < turned


def test_the_noise_is_what_the_filters_are_told():
    """15 of amplitude, or of power, for 15 dB: other tables than the paper's."""
    louder = [simulate_case("static", 34, decibel=10 * np.log10(15.0)), simulate_case("static", 34)]
    errors = [force_rms_of_ensembles(cut, study.CHOSEN, 1, 6) for cut in louder]
    assert errors[0] > 1.2 * errors[1]


def test_the_prior_of_the_better_methods_is_the_box():
    from millcal.studies.trending_cuts import BOX

    k_and_m = BOX[:, 0] + np.ptp(BOX, axis=1) * np.random.default_rng(2).random((400_000, 4))
    logarithm = np.log(0.06)
    drawn = k_and_m.copy()
    for i in (0, 2):
        drawn[:, i] = np.log(k_and_m[:, i]) - k_and_m[:, i + 1] * logarithm
    mean, covariance = box_prior()
    assert mean == pytest.approx(drawn.mean(axis=0), abs=5e-3)
    assert covariance == pytest.approx(np.cov(drawn.T), abs=3e-3)


def test_the_smoother_knows_how_sure_it_is():
    """Over draws of the noise its errors have the size that it says: of the force, of k_t and of m_t."""
    squares = []
    for seed in range(40, 52):
        cut = simulate_case("alternating", seed)
        found, trajectory = by_smoothing(cut)
        error = np.stack([study.tangential_error(cut, found), *(found - cut.active_truth)[:, :2].T])
        squares.append(np.mean((error / tangential_deviation(cut, found, trajectory)) ** 2, axis=1))
    assert np.all(np.abs(np.log(np.mean(squares, axis=0))) < np.log(2.2))


@pytest.mark.parametrize(("case", "model", "jumps"), [("wear+chip", "shared", 1), ("split", "independent", 0)])
def test_the_smoother_finds_the_model_that_made_the_record(case, model, jumps):
    cut = simulate_case(case, 2)
    found, trajectory = by_smoothing(cut)
    assert trajectory.fit.model.name == model
    assert len(trajectory.fit.jumps) == jumps
    assert np.sqrt(np.mean(study.tangential_error(cut, found) ** 2)) < {"wear+chip": 5.8, "split": 4.4}[case]
