"""Harmonics, fundamental, average period and lines of signals whose truth is known."""

import numpy as np
import pytest

from millcal.numerics.residual_lines import asynchronous_lines
from millcal.numerics.spectra import (
    average_periods,
    block_harmonics,
    buffered,
    evaluate,
    fit_harmonics,
    reader_of,
    refine_cycle,
    search_cycle,
    turned,
)

CYCLE = 1 / 83.7719  # no whole number of samples per period


def some_harmonics(count=12, channels=3, seed=1):
    rng = np.random.default_rng(seed)
    c = rng.standard_normal((channels, count + 1)) + 1j * rng.standard_normal((channels, count + 1))
    c *= 100.0 / (1 + np.arange(count + 1))
    c[:, 0] = c[:, 0].real
    return c


def signal(harmonics, cycle, length, phase=0.0):
    """The plain sum, against which the fast ones are held."""
    angle = 2 * np.pi * cycle * np.arange(length) + phase
    return np.real(harmonics @ np.exp(1j * np.outer(np.arange(harmonics.shape[1]), angle)))


@pytest.mark.parametrize("length", [84, 419, 5000, 12345])
def test_harmonics_of_a_noise_free_signal_are_exact_for_any_number_of_samples(length):
    truth = some_harmonics()
    found = fit_harmonics(reader_of(signal(truth, CYCLE, length)), 0, length, CYCLE, 20)
    assert np.abs(found[:, :13] - truth).max() < 1e-10 * np.abs(truth).max()
    assert np.abs(found[:, 13:]).max() < 1e-10 * np.abs(truth).max()


def test_harmonics_are_the_least_squares_solution_of_cosines_and_sines():
    rng = np.random.default_rng(2)
    y = rng.standard_normal((2, 501))
    found = fit_harmonics(reader_of(y), 0, 501, CYCLE, 9)
    angle = 2 * np.pi * CYCLE * np.outer(np.arange(501), np.arange(1, 10))
    design = np.hstack([np.ones((501, 1)), np.cos(angle), np.sin(angle)])
    solved = np.linalg.lstsq(design, y.T)[0].T
    assert found[:, 0] == pytest.approx(solved[:, 0], abs=1e-12)
    assert found[:, 1:] == pytest.approx(solved[:, 1:10] - 1j * solved[:, 10:], abs=1e-12)


def test_every_block_of_a_periodic_signal_has_the_harmonics_of_the_whole():
    truth = some_harmonics()
    edges = np.array([7, 100, 300, 517, 5000, 14000])
    found = block_harmonics(reader_of(signal(truth, CYCLE, 14000)), edges, CYCLE, 12)
    first = turned(truth, -2 * np.pi * CYCLE * 7)  # theta counts from the first edge
    assert np.abs(found - first).max() < 1e-9


def test_the_evaluated_series_is_the_plain_sum():
    truth = some_harmonics(30)
    y = evaluate(truth, CYCLE, 1234, 10_000)
    assert y == pytest.approx(signal(truth, CYCLE, 11_234)[:, 1234:], abs=1e-9)


def test_a_buffered_reader_gives_the_same_samples_from_fewer_reads():
    y = np.arange(30_000.0).reshape(3, -1)
    reads = []

    def read(start, stop):
        reads.append(start)
        return y[:, start:stop]

    served = buffered(read, 10_000, size=1000)
    assert all(np.array_equal(served(at, at + 10), y[:, at : at + 10]) for at in range(0, 10_000, 10))
    assert len(reads) == 10
    assert np.array_equal(served(50, 8000), y[:, 50:8000])


@pytest.mark.parametrize("error", [-0.08, -0.02, 0.0, 0.03, 0.09])
def test_the_fundamental_is_found_from_a_stated_one_that_is_wrong(error):
    truth, n = some_harmonics(), 3000
    found = search_cycle(signal(truth, CYCLE, n), CYCLE / (1 + error))
    assert found == pytest.approx(CYCLE, rel=0.25 / (n * CYCLE))  # a part of a bin, which the refinement takes over


def test_the_fundamental_is_found_where_only_tooth_passing_lines_are():
    truth = np.zeros((3, 13), complex)
    truth[:, [4, 8, 12]] = [100.0, 40j, 10.0]
    found = search_cycle(signal(truth, CYCLE, 3000), CYCLE * 1.06)
    assert found == pytest.approx(CYCLE, rel=2e-3)


@pytest.mark.parametrize("periods", [3, 8, 40, 300])
def test_the_refined_fundamental_of_a_noise_free_signal_is_right_to_1e_7(periods):
    length = int(periods / CYCLE)
    start = CYCLE * (1 + 0.1 / (12 * min(periods, 32)))
    found = refine_cycle(reader_of(signal(some_harmonics(), CYCLE, length)), 0, length, start)
    assert found.cycle == pytest.approx(CYCLE, rel=1e-7)


def test_the_refined_fundamental_scatters_as_its_standard_deviation_says_and_below_1e_5():
    rng = np.random.default_rng(3)
    clean = signal(some_harmonics(), CYCLE, 8400)
    found = [
        refine_cycle(reader_of(clean + 20 * rng.standard_normal(clean.shape)), 0, 8400, CYCLE * (1 + 2e-4))
        for _ in range(60)
    ]
    errors = np.array([f.cycle for f in found]) / CYCLE - 1
    stated = np.sqrt(np.mean([f.sd**2 for f in found])) / CYCLE
    assert np.sqrt(np.mean(errors**2)) < 1e-5
    assert np.sqrt(np.mean(errors**2)) / stated == pytest.approx(1.0, abs=0.3)  # 60 draws: 9 % standard error


def test_power_splits_exactly_into_what_follows_and_what_does_not():
    """Parseval, for least squares: the residual is orthogonal to the model, whatever the number of samples."""
    rng = np.random.default_rng(4)
    n = 4777
    y = signal(some_harmonics(), CYCLE, n) + 10 * rng.standard_normal((3, n))
    c = fit_harmonics(reader_of(y), 0, n, CYCLE, 12)
    found = average_periods(reader_of(y), 0, n, CYCLE, c)
    model = evaluate(c, CYCLE, 0, n)
    assert found.power == pytest.approx(y.var(axis=1), rel=1e-12)
    assert found.power == pytest.approx(model.var(axis=1) + found.residual_power, rel=1e-12)
    whole = round(57 / CYCLE)
    c = fit_harmonics(reader_of(y), 0, whole, CYCLE, 12)
    found = average_periods(reader_of(y), 0, whole, CYCLE, c)
    by_harmonics = 0.5 * np.sum(np.abs(c[:, 1:]) ** 2, axis=1)
    assert found.power - found.residual_power == pytest.approx(by_harmonics, rel=1e-3)


@pytest.mark.parametrize("phase", [0.0, 1.0, -2.5])
def test_the_average_period_is_the_signal_at_those_angles_and_the_scatter_is_the_noise(phase):
    rng = np.random.default_rng(5)
    n, truth = 83772, some_harmonics()
    y = signal(truth, CYCLE, n, phase)  # theta = phase at the first sample
    c = fit_harmonics(reader_of(y), 0, n, CYCLE, 12)
    clean = average_periods(reader_of(y), 0, n, CYCLE, c, phase=phase)
    expected = np.real(truth @ np.exp(1j * np.outer(np.arange(13), clean.angle)))
    assert clean.average == pytest.approx(expected, abs=1e-8)
    assert clean.scatter.max() < 1e-6
    noisy = average_periods(reader_of(y + 3 * rng.standard_normal(y.shape)), 0, n, CYCLE, c, phase=phase)
    assert np.sqrt(np.mean(noisy.scatter**2)) == pytest.approx(3.0, rel=0.01)
    assert np.abs(noisy.average - expected).max() < 6 * 3 / np.sqrt(1000)


def test_a_residual_beyond_the_harmonics_is_still_in_the_average():
    truth = some_harmonics(20)
    n = 83772
    y = signal(truth, CYCLE, n)
    c = fit_harmonics(reader_of(y), 0, n, CYCLE, 5)
    found = average_periods(reader_of(y), 0, n, CYCLE, c)
    expected = np.real(truth @ np.exp(1j * np.outer(np.arange(21), found.angle)))
    assert np.abs(found.average - expected).max() < 0.02 * np.abs(expected).max()


def test_white_noise_shows_a_line_in_about_one_recording_of_a_hundred():
    rng = np.random.default_rng(6)
    alarms = 0
    for _ in range(200):
        y = rng.standard_normal((3, 4000))
        alarms += bool(
            asynchronous_lines(reader_of(y), 0, 4000, CYCLE, fit_harmonics(reader_of(y), 0, 4000, CYCLE, 12))
        )
    assert alarms <= 8  # binomial(200, 0.01): 99.98 %


@pytest.mark.parametrize("longest", [1 << 17, 4000])
def test_a_line_between_the_harmonics_is_found_with_frequency_and_amplitude(longest):
    rng = np.random.default_rng(7)
    n, f = 20_000, 3.37 * CYCLE
    y = signal(some_harmonics(), CYCLE, n) + rng.standard_normal((3, n))
    y[1] += 2.0 * np.cos(2 * np.pi * f * np.arange(n) + 0.4)
    c = fit_harmonics(reader_of(y), 0, n, CYCLE, 20)
    (line,) = asynchronous_lines(reader_of(y), 0, n, CYCLE, c, longest=longest)
    assert line.channel == 1
    assert line.frequency == pytest.approx(f, abs=0.2 / min(n, longest))
    assert line.amplitude == pytest.approx(2.0, rel=0.05)
    assert line.exceeds > 4
