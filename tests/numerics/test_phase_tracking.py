"""The phase of a wandering period, followed over many turns."""

import numpy as np
import pytest

from millcal.numerics.phase_tracking import track_phase


def stretches(phase, *, noise=0.0, growth=0.0, seed=0):
    rng = np.random.default_rng(seed)
    c = (rng.standard_normal((2, 10)) + 1j * rng.standard_normal((2, 10))) / np.arange(1, 11)
    size = 1 + growth * np.arange(len(phase)) / len(phase)
    found = c * np.exp(1j * np.multiply.outer(phase, np.arange(1, 11)))[:, np.newaxis] * size[:, np.newaxis, np.newaxis]
    return found + noise * (rng.standard_normal(found.shape) + 1j * rng.standard_normal(found.shape))


@pytest.mark.parametrize("swing", [0.05, 3.0, 20.0])
def test_the_phase_is_followed_however_far_it_goes(swing):
    phase = swing * np.sin(2 * np.pi * np.arange(600) / 400)
    found = track_phase(stretches(phase, growth=0.5))
    assert found == pytest.approx(phase - phase[300], abs=1e-6)


def test_noise_does_not_make_it_lose_its_way():
    phase = 10 * np.sin(2 * np.pi * np.arange(600) / 400)
    found = track_phase(stretches(phase, noise=0.1))
    off = found - phase
    assert np.abs(off - off.mean()).max() < 0.3


def test_one_stretch_has_no_phase():
    assert track_phase(stretches(np.array([0.7]))) == pytest.approx([0.0])
