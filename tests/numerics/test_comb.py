"""A fundamental is found among its harmonics, whatever large tones stand beside them."""

import numpy as np
import pytest

from millcal.numerics.comb import comb_cycle

N = 40_000


def lines(frequency, amplitude, rng, noise=0.05, n=N):
    """Cosines of drawn phases in noise.   frequency : cycles per sample   returns (1, n)"""
    phase = rng.uniform(0, 2 * np.pi, len(frequency))
    time = np.arange(n)
    y = sum(a * np.cos(2 * np.pi * f * time + p) for f, a, p in zip(frequency, amplitude, phase, strict=True))
    return (y + noise * rng.normal(size=n))[np.newaxis]


@pytest.mark.parametrize("stated", [0.99, 1.0, 1.02])
def test_the_fundamental_is_found_to_its_standard_deviation(stated):
    cycle, rng, off = 0.00781234, np.random.default_rng(3), []
    for _ in range(20):
        y = lines(cycle * np.arange(1, 13), 1 / np.arange(1, 13), rng)
        found, seen = comb_cycle(y, stated * cycle)
        off.append((found.cycle - cycle) / found.sd)
        assert len(seen) >= 8
    assert np.max(np.abs(off)) < 4
    assert abs(np.mean(off)) < 1.5


@pytest.mark.parametrize("place", [9.1, 9.3, 9.5, 9.9])
def test_a_tone_ten_times_as_large_as_all_harmonics_does_not_draw_it(place):
    cycle, rng = 0.0078, np.random.default_rng(5)
    own = cycle * np.arange(2, 13, 2)
    company = cycle * (place + 2.0 * np.arange(-2, 3))  # a tooth passing of two teeth apart
    y = lines([*own, *company], [*np.full(6, 0.3), 0.2, 1, 3, 1, 0.2], rng)
    found, _ = comb_cycle(y, 1.01 * cycle, every=2)
    assert found.cycle == pytest.approx(cycle, rel=1e-5)


@pytest.mark.parametrize(("every", "stated"), [(1, 1.005), (4, 1.003), (5, 0.997)])
def test_without_any_noise_the_peaks_tell_and_not_their_skirts(every, stated):
    """A Hann window's skirts stand far above nothing, a line and more away from every harmonic."""
    cycle, rng, n = 0.0264, np.random.default_rng(7), 2200
    order = every * np.arange(1, int(0.45 / cycle / every) + 1)
    y = lines(cycle * order, 1 / np.arange(1, len(order) + 1), rng, noise=0.0, n=n)
    found, seen = comb_cycle(y, stated * cycle, every=every)
    assert found.cycle == pytest.approx(cycle, rel=1e-4)
    assert set(seen) == set(order.tolist())


def test_noise_alone_shows_no_comb():
    rng = np.random.default_rng(1)
    few = [len(comb_cycle(rng.normal(size=(1, N)), 0.0078)[1]) for _ in range(20)]
    assert np.mean(few) < 1.5
