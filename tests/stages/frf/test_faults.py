"""Faults of one hit beside its pulse: left out or mended, told in words, and what slips through does no harm.

Harm is the error of the FRF with the fault over that of the same recording, without it and without that hit. Each study runs
fully under `make test-long` and with fewer draws in `make test`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from impact_cases import RATE, half_sine

from millcal.stages.frf import estimate_frf

LOW, MEDIUM, HIGH = (0.0002, 0.0005), (0.002, 0.005), (0.01, 0.02)
HITS = 6
WINDOW = {"A": 0.15, "B": 0.03}  # s, most of the decay


def kinds(hit):
    return {reason.split(":")[0] for reason in hit.reasons}


def difference(frf, other):
    """Relative, over the usable lines."""
    inside = (frf.frequency > frf.usable_band[0]) & (frf.frequency < frf.usable_band[1])
    return np.linalg.norm((frf.values - other.values)[inside]) / np.linalg.norm(other.values[inside])


def spoiled(recording, hit, change):
    """The recording with one hit changed in place by `change(channels, samples)`."""
    samples = recording.samples.copy()
    start, count = recording.segments[hit]
    change(samples[:, start : start + count])
    return replace(recording, samples=samples)


def late_bump(structure, at, size):
    """Something of `size` times a hit that excites the structure at another point."""

    def change(own):
        n = own.shape[1]
        frequency = np.fft.rfftfreq(4 * n, 1 / RATE)
        F = half_sine(frequency, at, 2 * structure.pulse, 1000.0 * size)
        X = structure.accelerance(frequency, structure.dofs, ("headX",))[:, :, 0].T * F
        own[1:] += np.fft.irfft(X, 4 * n)[:, :n] * RATE

    return change


def lost(row, start, count, value=None):
    def change(own):
        own[row, start : start + count] = own[row, start - 1] if value is None else value

    return change


def lost_of_the_pulse(count):
    def change(own):
        top = int(np.argmax(own[0]))
        own[0, top : top + count] = 0.0

    return change


def drift(row, share, shape=lambda x: x):
    def change(own):
        own[row] += share * np.abs(own[row]).max() * shape(np.linspace(0, 1, own.shape[1]))

    return change


def skew(samples):
    def change(own):
        n = own.shape[1]
        turn = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * n, 1 / RATE) * samples / RATE)
        own[1:] = np.fft.irfft(np.fft.rfft(own[1:], 2 * n) * turn, 2 * n)[:, :n]

    return change


@dataclass(frozen=True)
class Fault:
    """A fault at random, and what must come of it."""

    make: Callable  # rng, structure, system -> change
    kinds: set  # one of these among the reasons, or a remark
    harm: float  # at most, in 95 % of the draws
    left_out: tuple[float, float, float] = (0.0, 0.0, 0.0)  # share of the hits at least, in low, medium and high noise
    mended: tuple[float, float, float] = (0.0, 0.0, 0.0)


def anywhere(rng, system):
    return int(rng.integers(180, 160 + RATE * WINDOW[system]))


FAULTS = {
    "late bump of 30 %": Fault(
        lambda rng, structure, system: late_bump(structure, 160 / RATE + WINDOW[system] * rng.uniform(0.3, 1.5), 0.3),
        {"late", "drift", "inconsistent"}, 1.3, (0.9, 0.8, 0.1),
    ),
    "late bump of 3 %": Fault(
        lambda rng, structure, system: late_bump(structure, 160 / RATE + WINDOW[system] * rng.uniform(0.3, 1.5), 0.03),
        {"late", "drift", "inconsistent"}, 1.3, (0.8, 0.0, 0.0),
    ),
    "drop-out": Fault(
        lambda rng, structure, system: lost(rng.integers(1, 4), anywhere(rng, system), rng.integers(8, 200), 0.0),
        {"drop-out", "unsettled"}, 1.15, (0.95, 0.95, 0.9),
    ),
    "stuck sample": Fault(
        lambda rng, structure, system: lost(rng.integers(1, 4), anywhere(rng, system), rng.integers(10, 200)),
        {"stuck", "drop-out", "unsettled"}, 1.15, (0.95, 0.95, 0.9),
    ),
    "drop-out in the pulse": Fault(
        lambda rng, structure, system: lost_of_the_pulse(max(2, int(RATE * structure.pulse / 4))),
        {"drop-out", "double", "weak", "inconsistent", "drift", "unsettled", "cut", "overload"}, 1.15, (0.95, 0.95, 0.95),
    ),
    "late trigger of 5 samples": Fault(
        lambda rng, structure, system: skew(5 * rng.choice([-1, 1])), set(), 1.2, mended=(0.95, 0.95, 0.95)
    ),
    "late trigger of a third of a sample": Fault(
        lambda rng, structure, system: skew(0.3 * rng.choice([-1, 1])), set(), 1.2, mended=(0.95, 0.1, 0.0)
    ),
    "drift of 5 %": Fault(
        lambda rng, structure, system: drift(rng.integers(0, 4), 0.05), set(), 1.2, mended=(0.95, 0.95, 0.6)
    ),
    "drift of 50 %": Fault(
        lambda rng, structure, system: drift(rng.integers(0, 4), 0.5), {"drift", "unsettled"}, 1.2, (0.95, 0.95, 0.95)
    ),
    "bent rest": Fault(
        lambda rng, structure, system: drift(rng.integers(1, 4), 0.05, lambda x: 1 - np.exp(-4 * x)),
        {"drift", "unsettled"}, 1.2, (0.95, 0.5, 0.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("seeds", [2, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("system", ["A", "B"])
def test_a_fault_is_found_where_it_matters_and_what_slips_through_does_no_harm(
    impact_test, structures, relative_error, system, name, seeds
):
    fault, structure = FAULTS[name], structures[system]
    harm, wrong = [], 0
    for level, noise in enumerate((LOW, MEDIUM, HIGH)):
        left_out = mended = 0
        for seed in range(seeds):
            rng = np.random.default_rng([seed, level])
            sound, _ = impact_test(rng, system, noise=noise, hits=HITS)
            hit = int(rng.integers(HITS))
            frf = estimate_frf(spoiled(sound, hit, fault.make(rng, structure, system)))
            without = estimate_frf(sound, drop=[hit])
            harm.append(
                relative_error(frf, structure.receptance, structure.band)
                / relative_error(without, structure.receptance, structure.band)
            )
            found = frf.hits[hit]
            assert kinds(found) <= fault.kinds
            left_out += not found.accepted
            mended += found.accepted and bool(found.remarks)
            wrong += sum(bool(other.reasons or other.remarks) for other in frf.hits if other.index != hit)
        slack = 1.0 if seeds < 20 else 0.0  # one of a few
        assert left_out >= fault.left_out[level] * seeds - slack
        assert mended >= fault.mended[level] * seeds - slack
    assert np.quantile(harm, 0.95) < fault.harm
    assert wrong <= 0.01 * 3 * seeds * (HITS - 1)


def test_what_is_lost_outside_of_the_windows_is_a_remark(impact_test):
    sound, _ = impact_test(np.random.default_rng(1), "B")
    frf = estimate_frf(spoiled(sound, 4, lost(2, 7500, 300, 0.0)))
    assert frf.hits_used == (9,)
    assert frf.hits[4].accepted
    assert "outside of its window" in frf.hits[4].remarks[0]
    assert difference(frf, estimate_frf(sound)) < 0.01


def test_a_bump_after_the_window_is_a_remark(impact_test, structures):
    sound, _ = impact_test(np.random.default_rng(2), "B")
    frf = estimate_frf(spoiled(sound, 4, late_bump(structures["B"], 0.2, 0.5)))
    assert frf.hits[4].accepted
    assert "after its window" in frf.hits[4].remarks[0]


def test_only_some_sensors_late_are_moved_alone_and_sensors_that_disagree_cost_the_hit(impact_test, structures):
    sound, _ = impact_test(np.random.default_rng(3), "B", noise=LOW)

    def some(samples):
        def change(own):
            whole = own.copy()
            for row, shift in samples.items():
                moved = whole.copy()
                skew(shift)(moved)
                own[row] = moved[row]

        return change

    frf = estimate_frf(spoiled(sound, 2, some({3: 8.0})))
    assert frf.hits[2].accepted
    assert "acc_headX 8.00 samples late" in frf.hits[2].remarks[0]
    assert difference(frf, estimate_frf(sound)) < 1e-4
    frf = estimate_frf(spoiled(sound, 2, some({1: -6.0, 3: 8.0})))
    assert kinds(frf.hits[2]) == {"inconsistent"}


def test_a_late_response_comes_back_with_its_window(impact_test):
    """What a modal fit is told of a hit that was moved is what it is told of the hit as it should have been."""
    sound, _ = impact_test(np.random.default_rng(4), "B", noise=LOW)
    expected, found = (estimate_frf(recording) for recording in (sound, spoiled(sound, 5, skew(6.0))))
    assert "skew" in {notice.code for notice in found.notices}
    a, b = expected.tests[0], found.tests[0]
    assert np.linalg.norm(b.response[5] - a.response[5]) < 0.01 * np.linalg.norm(a.response[5])
    assert b.window_stop == pytest.approx(a.window_stop, abs=5)


def test_a_rest_that_bends_after_every_hit_alike_is_the_measuring_chain_and_costs_no_hit(impact_test):
    """A high-pass droops after each hit by the same share."""
    recording, _ = impact_test(np.random.default_rng(5), "B", noise=LOW)
    for hit in range(9):
        recording = spoiled(recording, hit, drift(1, 0.05, lambda x: (x > 0.02) * np.exp(-3 * x)))
    frf = estimate_frf(recording)
    assert frf.hits_used == (9,)


@pytest.mark.parametrize("seeds", [3, pytest.param(40, marks=pytest.mark.long)])
@pytest.mark.parametrize(("system", "least"), [("A", 0.95), ("B", 0.75)])
def test_a_cut_off_pulse_of_unknown_range_is_found_by_its_flat_top_or_its_shape(impact_test, system, least, seeds):
    """15 % cut off, of pulses of 70 and of 6 samples; the others are smaller, as they are where one is too large."""
    found = wrong = 0
    for noise in (LOW, MEDIUM):
        for seed in range(seeds):
            peaks = [600, 700, 1000, 550, 650, 500]
            recording, _ = impact_test(
                np.random.default_rng(seed), system, hits=6, noise=noise, overload={2: 0.15}, peaks=peaks,
                responses=("tipX",), full_scale=False,
            )  # fmt: skip
            hits = estimate_frf(recording).hits
            found += kinds(hits[2]) == {"overload"}
            wrong += sum(bool(kinds(hit)) for hit in hits if hit.index != 2)
    assert found >= least * 2 * seeds - (1 if seeds < 20 else 0)
    assert wrong <= 0.01 * 10 * seeds
