"""After how many flashes of a strobe a motion repeats."""

import numpy as np
import pytest

from millcal.numerics.periodicity import change, changes, dies, periodicity, strobe

FLASHES = np.arange(200)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 7])
def test_a_motion_of_period_n_is_told_from_its_multiples(n, rng):
    samples = np.tile(rng.normal(size=n), 40)
    found = periodicity(samples, 1e-9)
    assert found.period == n
    assert np.flatnonzero(found.change < 1e-12)[0] + 1 == n


def test_a_motion_on_a_torus_never_repeats():
    samples = np.cos(2 * np.pi * (np.sqrt(5) - 1) / 2 * FLASHES)
    assert periodicity(samples, 1e-2).period == 0


def test_a_blind_phase_does_not_hide_period_two():
    """One phase at which both halves cross looks still; another does not."""
    blind, seeing = np.zeros(200), 0.3 * (-1.0) ** FLASHES
    assert periodicity(blind, 1e-6).period == 1
    found = periodicity(np.array([blind, seeing]), 1e-6)
    assert (found.period, found.phase) == (2, 1)
    assert found.change[0] == pytest.approx(0.6)


@pytest.mark.parametrize("multiplier", [0.99, -0.995, 0.99 * np.exp(1.1j)])
def test_a_transient_that_dies_slowly_repeats_and_one_that_grows_does_not(multiplier):
    dying = np.real(multiplier**FLASHES)
    assert change(dying, 1) > 1e-3
    assert periodicity(dying, 1e-6).period == 1
    assert periodicity(np.real(multiplier ** -FLASHES.astype(float)), 1e-6).period == 0


def test_what_dies_towards_period_two_has_period_two():
    samples = (-1.0) ** FLASHES * (1 + 0.99**FLASHES)
    assert periodicity(samples, 1e-6).period == 2


def test_steady_chatter_is_rarely_taken_for_a_transient(rng):
    """Of 2000 tori of any rotation, the slowest of which beat over the whole window."""
    turns, start = rng.uniform(0, 1, 2000), rng.uniform(0, 1, 2000)
    samples = np.cos(2 * np.pi * (turns[:, np.newaxis] * FLASHES + start[:, np.newaxis]))
    assert np.mean(dies(samples, 1)) < 2e-3


def test_white_noise_makes_the_change_that_the_closed_form_says(rng):
    noise = rng.normal(0, 0.7, (50, 4000))
    assert change(noise, 3).mean() == pytest.approx(2 * 0.7 / np.sqrt(np.pi), rel=0.01)


def test_changes_are_the_change_of_every_period(rng):
    samples = rng.normal(size=(3, 60))
    assert np.array_equal(changes(samples, 4)[2], change(samples, 3))


def test_a_strobe_between_the_samples_is_exact_for_a_quintic_and_close_for_a_sine(rng):
    i, at = np.arange(50.0), rng.uniform(0, 49, (3, 40))
    quintic = np.polynomial.Polynomial(rng.normal(size=6), domain=[0, 49])
    assert strobe(quintic(i), at) == pytest.approx(quintic(at), abs=1e-10)
    inside = rng.uniform(3, 46, 200)
    assert strobe(np.sin(2 * np.pi * i / 20), inside) == pytest.approx(np.sin(2 * np.pi * inside / 20), abs=2e-5)


def test_too_few_flashes_are_refused():
    with pytest.raises(ValueError, match="twice"):
        periodicity(np.zeros(20), 1e-6)
    with pytest.raises(ValueError, match="outside"):
        strobe(np.zeros(10), np.array([9.5]))
