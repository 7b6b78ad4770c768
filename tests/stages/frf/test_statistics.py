"""What the FRF promises over many draws of the noise: intervals that cover, good hits kept, bad hits found.

Each study runs fully under `make test-long` and with fewer draws, and so wider tolerances, in `make test`.
"""

import numpy as np
import pytest
from scipy.stats import f as fisher

from millcal.stages.frf import estimate_frf

NOISE = {"low": (0.0002, 0.0005), "medium": (0.002, 0.005), "high": (0.01, 0.02)}
full = pytest.mark.long


def kinds(hit):
    return {reason.split(":")[0] for reason in hit.reasons}


def covered(frf, structure):
    """Share of the lines of all outputs where the truth lies in the circular 95 % band of the estimate."""
    inside = (frf.frequency >= structure.band[0]) & (frf.frequency <= structure.band[1])
    error = np.abs(frf.values[inside] - structure.accelerance(frf.frequency[inside], frf.outputs, frf.inputs))
    n, m = frf.hits_used[0], len(frf.inputs)
    return np.mean(error < np.sqrt(frf.variance[inside] * fisher.ppf(0.95, 2, 2 * (n - m))))


@pytest.mark.parametrize("seeds", [4, pytest.param(40, marks=full)])
@pytest.mark.parametrize("level", NOISE)
@pytest.mark.parametrize("system", ["A", "B"])
def test_the_95_percent_band_covers_85_to_98_percent_of_the_lines_and_no_good_hit_is_lost(
    impact_test, structures, system, level, seeds
):
    shares, hits, lost = [], 0, 0
    for seed in range(seeds):
        recording, _ = impact_test(np.random.default_rng(seed), system, noise=NOISE[level])
        frf = estimate_frf(recording)
        shares.append(covered(frf, structures[system]))
        hits += len(frf.hits)
        lost += sum(not hit.accepted for hit in frf.hits)
    assert 0.85 < np.mean(shares) < 0.98
    assert lost <= 0.01 * hits


@pytest.mark.parametrize("seeds", [3, pytest.param(20, marks=full)])
@pytest.mark.parametrize("level", NOISE)
@pytest.mark.parametrize("system", ["A", "B"])
def test_97_percent_of_double_hits_are_found(impact_test, system, level, seeds):
    """Second pulses of 40, 15 and 6 %, and of 30 % merged with the first."""
    faults = {1: (0.4, 40.0), 2: (0.15, 20.0), 3: (0.06, 12.0), 4: (0.3, 1.3), 5: (0.3, 2.2)}
    found = []
    for seed in range(seeds):
        recording, _ = impact_test(
            np.random.default_rng(1000 + seed), system, hits=6, noise=NOISE[level], second=faults, responses=("tipX",)
        )
        hits = estimate_frf(recording).hits
        assert hits[0].accepted
        found += ["double" in kinds(hit) for hit in hits[1:]]
    missed = len(found) - sum(found)
    assert missed <= max(1, 0.03 * len(found))


@pytest.mark.parametrize("seeds", [3, pytest.param(30, marks=full)])
@pytest.mark.parametrize("level", NOISE)
@pytest.mark.parametrize("system", ["A", "B"])
def test_every_overload_is_found_where_the_input_range_is_known(impact_test, system, level, seeds):
    for seed in range(seeds):
        for cut in (0.05, 0.15):
            recording, _ = impact_test(
                np.random.default_rng(seed), system, hits=4, noise=NOISE[level], overload={2: cut},
                peaks=[700, 750, 1000, 800], responses=("tipX",),
            )  # fmt: skip
            assert [kinds(hit) for hit in estimate_frf(recording).hits] == [set(), set(), {"overload"}, set()]


@pytest.mark.parametrize("seeds", [2, pytest.param(20, marks=full)])
@pytest.mark.parametrize("level", NOISE)
@pytest.mark.parametrize("system", ["A", "B"])
def test_every_hit_of_a_continuous_recording_is_found_within_a_few_samples(impact_test, system, level, seeds):
    for seed in range(seeds):
        recording, onsets = impact_test(np.random.default_rng(seed), system, hits=6, noise=NOISE[level], seconds=0.5)
        hits = estimate_frf(recording).hits
        assert [hit.onset for hit in hits] == pytest.approx(onsets, abs=0.2e-3)


@full
@pytest.mark.parametrize("system", ["A", "B"])
def test_taking_the_noise_off_the_force_leaves_no_bias(impact_test, structures, system):
    """The mean over many draws approaches the truth as the noise of the mean does."""
    structure = structures[system]
    total = 0
    for seed in range(60):
        recording, _ = impact_test(np.random.default_rng(seed), system, noise=NOISE["high"], responses=("tipX",))
        frf = estimate_frf(recording, resolution=25600 / 16384)  # the same lines in each draw
        inside = (frf.frequency >= structure.band[0]) & (frf.frequency <= structure.band[1])
        total = total + frf.values[inside, 0, 0]
    truth = structure.accelerance(frf.frequency[inside], ("tipX",), ("tipX",))[:, 0, 0]
    spread = np.sqrt(np.mean(frf.variance[inside, 0, 0]) / 60)
    assert np.sqrt(np.mean(np.abs(total / 60 - truth) ** 2)) < 2.0 * spread
