"""A wandering signal read at even steps of its phase is periodic again; a steady one, and a tone of its own, change nothing."""

import numpy as np
import pytest

from millcal.numerics import spectra
from millcal.numerics.straighten import straightened

N, CYCLE, EVERY = 30_000, 0.0079, 3


def wandering(depth, *, tone=0.0, noise=0.02):
    """Harmonics of three teeth whose speed swings by a share, four times in the record.   returns (1, N)"""
    time, slow = np.arange(N), 2 * np.pi * 4 / N
    phase = 2 * np.pi * CYCLE * (time + depth / slow * np.sin(slow * time))
    y = sum(np.cos(EVERY * k * phase + k) / k for k in range(1, 10))
    y += tone * np.cos(2 * np.pi * 0.0703 * time)
    return (y + noise * np.random.default_rng(0).normal(size=N))[np.newaxis]


def left(y):
    """Share of the power that harmonics leave."""
    found = spectra.fit_harmonics(spectra.reader_of(y), 0, N, CYCLE, 30)
    return 1 - 0.5 * np.sum(np.abs(found[0, 1:]) ** 2) / y.var()


@pytest.mark.parametrize("depth", [2e-3, 3e-3])
def test_what_the_wander_took_from_the_harmonics_comes_back(depth):
    y = wandering(depth)
    straight, gain = straightened(y, CYCLE, harmonics=6, every=EVERY)
    assert left(y) > 0.05
    assert left(straight) < 0.02
    assert gain == pytest.approx(left(y) - left(straight), abs=0.05)


def test_a_steady_signal_is_left_alone():
    assert straightened(wandering(0.0), CYCLE, harmonics=6, every=EVERY) is None


def test_a_large_tone_of_its_own_passes_for_no_wander():
    assert straightened(wandering(0.0, tone=4.0), CYCLE, harmonics=6, every=EVERY) is None


def test_two_channels_are_straightened_alike():
    y = wandering(1e-3)
    straight, _ = straightened(np.concatenate([y, 3 * y]), CYCLE, harmonics=6, every=EVERY)
    assert straight[1] == pytest.approx(3 * straight[0], abs=1e-9)
