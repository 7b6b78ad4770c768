"""Laws of the frequency response from hits: exact data give the exact response, and each estimator its own limit."""

import numpy as np
import pytest

from millcal.numerics.frequency_response import (
    ESTIMATORS,
    CrossSpectra,
    condition,
    deviation,
    estimate,
    inverse_of,
    joined,
    predicted,
)

LINES = 40


def cgauss(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def hits(rng, n=8, inputs=1, outputs=3, noise=(0.0, 0.0)):
    """Spectra of n hits on a random system: force, response, system (frequency, output, input)."""
    H = cgauss(rng, LINES, outputs, inputs)
    F = cgauss(rng, n, inputs, LINES) + 2.0 * rng.uniform(0.5, 1.5, (n, inputs, 1))
    X = np.einsum("foi,hif->hof", H, F)
    return F + noise[0] * cgauss(rng, *F.shape), X + noise[1] * cgauss(rng, *X.shape), H


def summed(F, X, noise=(0.0, 0.0)):
    sums = CrossSpectra(F.shape[1], X.shape[1], F.shape[2])
    for force, response in zip(F, X, strict=True):
        sums.add(force, response, np.full(len(force), noise[0] ** 2), np.full(len(response), noise[1] ** 2))
    return sums


def solved(F, X, noise=(0.0, 0.0), estimator="h1"):
    return estimate(summed(F, X, noise), estimator=estimator)


@pytest.mark.parametrize(("estimator", "inputs"), [("h1", 1), ("h1", 3), ("h2", 1), ("h2", 3), ("hv", 1), ("hv", 3)])
def test_without_noise_every_estimator_returns_the_system(estimator, inputs):
    F, X, H = hits(np.random.default_rng(1), inputs=inputs)
    assert solved(F, X, estimator=estimator).values == pytest.approx(H, rel=1e-6)


def test_as_many_hits_as_inputs_are_enough_and_leave_nothing_for_coherence_or_variance():
    F, X, H = hits(np.random.default_rng(2), n=3, inputs=3)
    found = solved(F, X)
    assert found.values == pytest.approx(H, rel=1e-6)
    assert np.isnan(found.coherence).all()
    assert np.isnan(found.variance).all()


def test_several_inputs_are_the_least_squares_solution_at_each_line():
    F, X, _ = hits(np.random.default_rng(3), n=9, inputs=2, noise=(0, 0.3))
    found = solved(F, X).values
    for f in range(LINES):
        expected = np.linalg.lstsq(F[:, :, f], X[:, :, f], rcond=None)[0].T
        assert found[f] == pytest.approx(expected, rel=1e-9)


def test_one_input_alone_equals_that_input_among_others_that_were_never_hit_together():
    rng = np.random.default_rng(4)
    Fa, Xa, _ = hits(rng, noise=(0, 0.2))
    Fb, Xb, _ = hits(rng, noise=(0, 0.2))
    zero = np.zeros_like(Fa)
    F = np.concatenate([np.concatenate([Fa, zero], 1), np.concatenate([zero, Fb], 1)])
    both = solved(F, np.concatenate([Xa, Xb]))
    assert both.values[:, :, [0]] == pytest.approx(solved(Fa, Xa).values, rel=1e-9)
    assert both.values[:, :, [1]] == pytest.approx(solved(Fb, Xb).values, rel=1e-9)


def test_variance_of_one_input_is_the_closed_form_of_the_coherence():
    """Bendat and Piersol: |H|^2 (1 - g^2) / (g^2 (n - 1)) for the plain H1."""
    F, X, _ = hits(np.random.default_rng(5), n=7, noise=(0, 0.4))
    found = solved(F, X)
    g2 = found.coherence
    assert found.variance == pytest.approx(np.abs(found.values) ** 2 * (1 - g2) / (g2 * 6), rel=1e-9)
    assert found.explained / found.total == pytest.approx(g2[:, :, 0], rel=1e-9)


def test_noise_of_the_force_no_longer_biases_h1_once_it_is_taken_off():
    """E[H1] = H / (1 + Nff/Sff) without; the mean over many hits tells."""
    noise = (1.0, 0.0)
    F, X, H = hits(np.random.default_rng(6), n=6000, noise=noise)
    plain, freed = (solved(F, X, sizes).values for sizes in ((0.0, 0.0), noise))
    assert np.abs(plain / H).mean() < 0.87
    assert np.abs(freed / H).mean() == pytest.approx(1.0, abs=0.008)


def test_hv_goes_to_h1_without_force_noise_and_to_h2_without_response_noise():
    F, X, _ = hits(np.random.default_rng(7), noise=(0.1, 0.1))
    assert solved(F, X, (1e-6, 1.0), "hv").values == pytest.approx(solved(F, X).values, rel=1e-6)
    assert solved(F, X, (1.0, 1e-6), "hv").values == pytest.approx(solved(F, X, estimator="h2").values, rel=1e-6)


def test_hv_lies_between_h1_and_h2_in_size():
    F, X, _ = hits(np.random.default_rng(8), noise=(0.3, 0.3))
    size = {name: np.abs(solved(F, X, (0.3, 0.3) if name == "hv" else (0, 0), name).values) for name in ESTIMATORS}
    assert (size["h1"] <= size["hv"] * (1 + 1e-9)).all()
    assert (size["hv"] <= size["h2"] * (1 + 1e-9)).all()


def test_hv_is_consistent_where_both_channels_are_noisy():
    noise = (0.5, 0.5)
    F, X, H = hits(np.random.default_rng(9), n=6000, noise=noise)
    assert np.abs(solved(F, X, noise, "hv").values / H).mean() == pytest.approx(1.0, abs=0.015)


@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
def test_with_several_inputs_each_estimator_is_unbiased_under_its_own_noise(estimator):
    """H1 with the force's noise taken off, H2 with noise in the forces alone, Hv with both."""
    noise = {"h1": (1.0, 0.5), "h2": (1.0, 0.0), "hv": (1.0, 1.0)}[estimator]
    F, X, H = hits(np.random.default_rng(10), n=6000, inputs=3, outputs=2, noise=noise)
    found = solved(F, X, noise, estimator).values
    plain = solved(F, X).values
    bias = np.abs(np.mean(found / H) - 1.0)
    assert bias < 0.02
    assert np.abs(np.mean(plain / H) - 1.0) > 5 * bias
    assert np.linalg.norm(found - H) < 0.4 * np.linalg.norm(plain - H)


def test_h2_of_several_inputs_is_hv_without_noise_in_the_response():
    F, X, _ = hits(np.random.default_rng(13), inputs=2, noise=(0.3, 0.0))
    expected = solved(F, X, (0.3, 1e-4), "hv").values
    assert solved(F, X, (0.3, 0.0), "h2").values == pytest.approx(expected, rel=1e-5)


def test_a_hit_that_is_taken_off_the_sums_was_never_there():
    F, X, _ = hits(np.random.default_rng(14), inputs=2)
    sums = summed(F, X, (0.1, 0.2))
    sums.add(1e3 * F[0], 1e3 * X[1], np.ones(2), np.ones(3))
    sums.add(1e3 * F[0], 1e3 * X[1], np.ones(2), np.ones(3), sign=-1)
    fresh = summed(F, X, (0.1, 0.2))
    assert sums.hits == fresh.hits
    assert sums.force_noise == pytest.approx(fresh.force_noise)
    assert estimate(sums).values == pytest.approx(estimate(fresh).values, rel=1e-7)


def test_sums_of_two_tests_joined_are_those_of_all_their_hits():
    F, X, _ = hits(np.random.default_rng(15), inputs=2, noise=(0.0, 0.3))
    parts = [(summed(F[:3], X[:3]), [0, 1], [0, 2]), (summed(F[3:, ::-1], X[3:, [2, 0, 1]]), [1, 0], [1, 0])]
    assert estimate(joined(parts, 2)).values == pytest.approx(solved(F, X[:, [0, 2]]).values, rel=1e-9)


def test_hits_in_one_direction_only_do_not_tell_inputs_apart():
    rng = np.random.default_rng(11)
    F = cgauss(rng, 6, 1, LINES) * np.array([1.0, 2.0, 3.0])[None, :, None]
    assert condition(np.einsum("hjf,hkf->jkf", F.conj(), F)) > 1e6
    F = cgauss(rng, 6, 3, LINES)
    assert condition(np.einsum("hjf,hkf->jkf", F.conj(), F)) < 30


def test_a_matrix_that_cannot_be_inverted_gives_nan_and_its_neighbours_their_inverse():
    matrices = np.array([np.eye(2), np.ones((2, 2)), 4e12 * np.eye(2)], complex)
    found = inverse_of(matrices)
    assert found[0] == pytest.approx(np.eye(2))
    assert np.isnan(found[1]).all()
    assert found[2] == pytest.approx(np.eye(2) / 4e12)


@pytest.mark.parametrize("inputs", [1, 2])
def test_the_hit_that_differs_from_the_others_shows_in_the_deviation(inputs):
    F, X, _ = hits(np.random.default_rng(12), n=9, inputs=inputs, noise=(0, 0.01))
    X[4] *= 1.3
    expected, usual = predicted(F, X)
    found = deviation(X, expected)
    assert np.argmax(found / usual) == 4
    assert found[4] == pytest.approx(1 - 1 / 1.3, abs=0.06)
    assert usual[4] == pytest.approx(0.01 * np.sqrt(3) / np.linalg.norm(X[3]) * np.sqrt(LINES), rel=0.5)


def test_with_several_inputs_every_hit_is_as_far_from_what_is_expected_as_its_noise():
    """Also one that is alone in its direction."""
    sizes = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        F, X, _ = hits(rng, n=7, inputs=2)
        F[0] *= 5.0
        H = cgauss(rng, LINES, 3, 2)
        X = np.einsum("foi,hif->hof", H, F) + 0.3 * cgauss(rng, *X.shape)
        expected, _ = predicted(F, X)
        sizes.append(np.mean(np.abs(X - expected) ** 2, axis=(1, 2)))
    assert np.mean(sizes, axis=0) == pytest.approx(np.full(7, 0.09), rel=0.06)
