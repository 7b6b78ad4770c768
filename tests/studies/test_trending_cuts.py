"""The simulated cuts beside what the paper and its reproduction say of them."""

import numpy as np
import pytest

from millcal.studies.trending_cuts import (
    CASES,
    NAMES,
    PAPER_CASES,
    SAMPLES,
    TRUE,
    coefficients_over_time,
    simulate_case,
)

NOISE = {"static": (32.2, 18.6), "ascending": (37.6, 24.6), "alternating": (33.3, 20.9)}  # N, t and r


@pytest.mark.parametrize("case", PAPER_CASES)
def test_noise_is_that_of_15_db_of_the_whole_record(case):
    cut = simulate_case(case, 0)
    assert cut.sigma == pytest.approx(NOISE[case], abs=0.06)
    assert np.std(cut.force - cut.clean, axis=0) == pytest.approx(cut.sigma, rel=0.06)


def test_a_static_record_has_the_forces_of_the_reproduction():
    cut = simulate_case("static", 0)
    assert np.count_nonzero(cut.active) == 1120
    assert np.count_nonzero(cut.air) == 1180
    assert cut.clean[:, 0].max() == pytest.approx(430, abs=1)
    assert np.sqrt(np.mean(cut.clean[:, 0] ** 2)) == pytest.approx(181, abs=1)
    assert np.sqrt(np.mean(cut.clean[cut.active, 0] ** 2)) == pytest.approx(262, abs=1)


@pytest.mark.parametrize("case", CASES)
def test_every_case_starts_from_the_table_and_moves_by_what_it_says(case):
    truth = coefficients_over_time(case)
    assert truth.shape == (SAMPLES, len(NAMES))
    moved = np.ptp(truth, axis=0) / TRUE
    expected = {
        "static": (0, 0, 0, 0),
        "ascending": (0.2,) * 4,
        "alternating": (0.4,) * 4,
        "sine2": (0.4,) * 4,
        "square2": (0.4,) * 4,
        "wear+chip": (0.2646, 0, 0.2646, 0),
        "split": (0.2, 0, 0.4, 0),
    }[case]
    assert moved == pytest.approx(expected, abs=1e-3)
    if case == "alternating":
        assert truth[0] == pytest.approx(1.2 * TRUE)


def test_a_seed_draws_the_same_noise_in_every_case_and_another_seed_another():
    units = [(cut.force - cut.clean) / cut.sigma for cut in (simulate_case(case, 5) for case in CASES)]
    for unit in units[1:]:
        assert unit == pytest.approx(units[0], abs=1e-9)
    other = simulate_case("static", 6)
    assert abs(np.corrcoef(((other.force - other.clean) / other.sigma)[:, 0], units[0][:, 0])[0, 1]) < 0.1
