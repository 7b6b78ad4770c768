"""The zero-phase low-pass against the filter it stands for."""

import numpy as np
import pytest

from millcal.numerics.low_pass import low_pass_kernel, smoothed
from millcal.numerics.spectra import reader_of


def gain(kernel, frequency):
    """Real, because the kernel is symmetric."""
    n = np.arange(len(kernel)) - len(kernel) // 2
    return np.exp(-2j * np.pi * np.outer(np.atleast_1d(frequency), n)) @ kernel


@pytest.mark.parametrize("cutoff", [0.003, 0.05, 0.2, 0.45])
def test_gain_is_one_at_zero_and_minus_3_db_at_the_cutoff_without_any_phase(cutoff):
    kernel = low_pass_kernel(cutoff)
    assert gain(kernel, 0.0).real == pytest.approx(1.0, abs=1e-12)
    assert gain(kernel, cutoff).real == pytest.approx(np.sqrt(0.5), abs=1e-9)
    response = gain(kernel, np.linspace(0, 0.5, 50))
    assert np.abs(response.imag).max() < 1e-12
    assert response.real.min() > -1e-9


def test_it_is_the_butterworth_filter_run_forward_and_backward():
    from scipy.signal import butter, sosfiltfilt

    x = np.random.default_rng(1).standard_normal((2, 4000))
    corner = (
        np.arctan(np.tan(np.pi * 0.05) / (np.sqrt(2) - 1) ** (1 / 8)) / np.pi
    )  # each run is higher than both together
    expected = sosfiltfilt(butter(4, 2 * corner, output="sos"), x, padlen=2000)
    found = smoothed(reader_of(x), 0, 4000, low_pass_kernel(0.05))(0, 4000)
    assert found[:, 500:-500] == pytest.approx(expected[:, 500:-500], abs=1e-9)


def test_blocks_of_any_size_give_the_same_samples():
    x = np.random.default_rng(2).standard_normal((3, 3000))
    read = smoothed(reader_of(x), 0, 3000, low_pass_kernel(0.1))
    pieces = np.concatenate([read(a, min(a + 313, 3000)) for a in range(0, 3000, 313)], axis=1)
    assert pieces == pytest.approx(read(0, 3000), abs=1e-12)


def test_a_line_passes_unchanged_up_to_the_ends():
    x = np.array([3.0 + 0.25 * np.arange(500)])
    assert smoothed(reader_of(x), 0, 500, low_pass_kernel(0.05))(0, 500) == pytest.approx(x, abs=1e-9)


def test_samples_outside_the_range_have_no_influence():
    x = np.random.default_rng(3).standard_normal((1, 2000))
    spoiled = x.copy()
    spoiled[:, :300] = np.nan
    kernel = low_pass_kernel(0.05)
    assert np.array_equal(
        smoothed(reader_of(x), 300, 1800, kernel)(300, 1800), smoothed(reader_of(spoiled), 300, 1800, kernel)(300, 1800)
    )


@pytest.mark.parametrize("cutoff", [0.0, -0.1, 0.5, 1.0])
def test_a_cutoff_outside_the_band_is_refused(cutoff):
    with pytest.raises(ValueError, match="cutoff"):
        low_pass_kernel(cutoff)
