"""The smoother on simulated cuts against what it has been measured to reach, and what runout and a low-pass do to it.

By default few seeds of each case; at full length (`make test-long`) sixteen, and the truths that no model holds.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest
from changing_cuts import RUNOUT, Effects, long_cut, models, recorded

from millcal.numerics.smoothing import smooth
from millcal.studies import trending_cuts as cuts

FEW, MANY = 3, 16


class Band(NamedTuple):
    """For one seed, and the mean and scatter of one seed's error."""

    force: float  # N, at most
    k_t: float  # N/mm^2, at most
    of_force: tuple[float, float]
    of_k_t: tuple[float, float]


BANDS = {
    "static": Band(4.0, 135, (1.50, 0.69), (36, 28)),
    "ascending": Band(4.8, 185, (2.12, 0.75), (69, 34)),
    "alternating": Band(4.4, 160, (2.58, 0.52), (58, 30)),
    "sine2": Band(4.6, 185, (2.97, 0.46), (64, 35)),
    "square2": Band(7.0, 205, (2.38, 0.94), (69, 40)),
    "wear+chip": Band(5.8, 190, (2.82, 0.81), (73, 34)),
    "split": Band(4.4, 165, (1.82, 0.73), (50, 33)),
}
EDGES = np.array([0.25, 0.5, 0.75])  # of square2
FIRST_SEED = 1000  # of those that are judged here; the bands come from others


class Found(NamedTuple):
    error: np.ndarray  # (seed, 3) F_t N, k_t N/mm^2, m_t
    cover: np.ndarray  # (seed, 3)
    name: list[str]
    jumps: list[np.ndarray]  # steps
    chi2: np.ndarray  # (seed, 2) of the independent and the shared model


def smoothed(case, seeds, effects=Effects(), modelled=None, *, find_runout=False, chosen=(0, 1), **options):
    error, cover, name, jumps, chi2 = [], [], [], [], []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        record = recorded(case, seed, effects, modelled, find_runout=find_runout, **options)
        found = smooth(record.problem, [models(find_runout)[i] for i in chosen])
        rmse, inside = record.errors(found.mean, found.covariance)
        error.append(rmse)
        cover.append(inside)
        name.append(found.fit.model.name)
        jumps.append(np.searchsorted(found.fit.problem.block, found.fit.jumps))
        chi2.append([record.chi2(fit) for fit in found.alternatives.values()])
    return Found(np.array(error), np.array(cover), name, jumps, np.array(chi2))


@lru_cache
def usual(case, seeds):
    """Cases as the paper has them, smoothed once for all tests."""
    return smoothed(case, seeds)


def judge(seeds):
    """All cases, within the bands of a seed, but for one in sixteen, and of a mean over seeds."""
    for case, band in BANDS.items():
        force, k_t, _ = usual(case, seeds).error.T
        for values, most, (mean, sd) in ((force, band.force, band.of_force), (k_t, band.k_t, band.of_k_t)):
            assert np.count_nonzero(values > most) <= seeds // 16, (case, values)
            assert np.mean(values) <= mean + 3.5 * sd / np.sqrt(seeds), (case, values)
            assert np.max(values) <= 1.3 * most, (case, values)


def root_mean_square(found):
    return np.sqrt(np.mean(found.error[:, 0] ** 2))


def edges_in_steps():
    return np.searchsorted(np.flatnonzero(cuts.geometry().active), cuts.SAMPLES * EDGES)


def test_every_case_is_followed():
    judge(FEW)
    assert np.mean([root_mean_square(usual(case, FEW)) for case in BANDS]) <= 2.7


def test_intervals_cover_what_they_say_on_average():
    """Of few seeds; the trends of one record share their error, so that the band is wide."""
    cover = np.mean([usual(case, FEW).cover.mean(axis=0) for case in BANDS], axis=0)
    assert np.all(cover > 0.75), cover


def test_edges_are_found_and_smooth_cases_have_none():
    found = usual("square2", FEW)
    for jumps in found.jumps:
        assert len(jumps) == 3
        assert np.all(np.abs(jumps - edges_in_steps()) <= 5)
    false = sum(
        len(jumps)
        for case in ("static", "ascending", "alternating", "sine2", "split")
        for jumps in usual(case, FEW).jumps
    )
    assert false <= 1


def test_directions_with_trends_of_their_own_are_never_taken_for_one():
    assert usual("split", FEW).name == ["independent"] * FEW
    assert usual("sine2", FEW).name == ["shared"] * FEW


def test_one_trend_forced_on_two_fails_visibly():
    forced = smoothed("split", FEW, chosen=(1,))
    assert np.all(forced.error[:, 0] > 13), forced.error[:, 0]
    assert np.all(forced.chi2[:, 0] > usual("split", FEW).chi2[:, 0] + 0.05)


def test_without_a_shared_trend_to_lean_on_the_error_is_what_it_was():
    """The independent model alone."""
    for case, most in {"ascending": 4.8, "square2": 7.0}.items():
        assert np.all(smoothed(case, 2, chosen=(0,)).error[:, 0] <= most)


def in_blocks_of_a_pass(seconds):
    record = long_cut(seconds)
    found = smooth(record.problem, models(), block=56)
    return found, *record.errors(found.mean, found.covariance), np.searchsorted(record.problem.time, 0.6)


def test_a_longer_cut_in_blocks_of_a_pass():
    """The jump comes to its place though no block begins there."""
    found, error, cover, true = in_blocks_of_a_pass(6)
    (jump,) = np.searchsorted(found.fit.problem.block, found.fit.jumps)
    assert abs(jump - true) <= 15
    assert np.all(error < [1.6, 50, 0.01]), error
    assert np.all(cover > 0.65), cover


# ---- runout and low-pass

LOW_PASS = Effects(low_pass=300.0)
COLOURED = Effects(low_pass=300.0, noise_before=True)


def test_runout_that_is_known_does_no_harm_and_ignored_it_does():
    known = smoothed("ascending", 2, Effects(runout=RUNOUT))
    ignored = smoothed("ascending", 2, Effects(runout=RUNOUT), Effects())
    assert np.all(known.error[:, 0] < 4.8)
    assert np.all(ignored.error[:, 0] > 2 * known.error[:, 0])
    assert np.all(ignored.chi2[:, 1] > known.chi2[:, 1] + 0.08)


def test_runout_is_found_as_two_constants():
    record = recorded("wear+chip", FIRST_SEED, Effects(runout=RUNOUT), Effects(), find_runout=True)
    found = smooth(record.problem, models(runout=True)[1:])
    error, _ = record.errors(found.mean, found.covariance)
    assert error[0] < 5.8
    truth = 1e3 * RUNOUT * np.array([np.cos(1.0), np.sin(1.0)])
    sd = np.sqrt(np.diag(found.covariance[0])[4:])
    assert np.all(np.abs(found.mean[0, 4:] - truth) < 3 * sd), (found.mean[0, 4:], sd)
    assert np.all(sd < [1.0, 4.0])
    assert np.ptp(found.mean[:, 4:], axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_low_pass_belongs_into_the_model():
    inside, ignored = smoothed("ascending", 2, LOW_PASS), smoothed("ascending", 1, LOW_PASS, Effects())
    assert np.all(inside.error[:, 0] <= 5)
    assert np.all((inside.chi2[:, 1] > 0.85) & (inside.chi2[:, 1] < 1.2)), inside.chi2
    assert np.all(ignored.error[:, 0] > 60)


def test_a_delay_in_its_place_is_better_than_nothing_and_worse_than_the_low_pass():
    delayed, inside = smoothed("ascending", 1, LOW_PASS, Effects(delay=7.5)), smoothed("ascending", 1, LOW_PASS)
    assert 2 * inside.error[0, 0] < delayed.error[0, 0] < 60


def test_coloured_noise_is_whitened():
    white = smoothed("ascending", 2, COLOURED, COLOURED._replace(whitened=True))
    assumed = smoothed("ascending", 2, COLOURED)
    assert np.all(white.error[:, 0] <= 5)
    assert np.all((white.chi2 > 0.85) & (white.chi2 < 1.2)), white.chi2
    assert np.all(assumed.error[:, 0] > 1.5 * white.error[:, 0])
    assert np.mean(assumed.cover[:, 0]) < 0.8


# ---- at full length


@pytest.mark.long
def test_every_case_is_followed_over_many_seeds():
    judge(MANY)
    assert np.mean([root_mean_square(usual(case, MANY)) for case in BANDS]) <= 2.7
    cover = np.mean([usual(case, MANY).cover.mean(axis=0) for case in BANDS], axis=0)
    assert np.all((cover > 0.84) & (cover < 0.98)), cover
    right = [
        len(jumps) == 3 and np.all(np.abs(jumps - edges_in_steps()) <= 5) for jumps in usual("square2", MANY).jumps
    ]
    assert np.mean(right) >= 0.95 - 1e-9 or sum(right) >= MANY - 1
    smooth_cases = ("static", "ascending", "alternating", "sine2", "split")
    false = sum(len(jumps) for case in smooth_cases for jumps in usual(case, MANY).jumps)
    assert false <= len(smooth_cases) * MANY / 20
    assert usual("split", MANY).name == ["independent"] * MANY


@pytest.mark.long
def test_a_minute():
    found, error, cover, true = in_blocks_of_a_pass(60)
    assert found.fit.model.name == "independent"
    (jump,) = np.searchsorted(found.fit.problem.block, found.fit.jumps)
    assert abs(jump - true) <= 5
    assert np.all(error < [0.8, 40, 0.008]), error
    assert np.all(cover > 0.85), cover


@pytest.mark.long
def test_the_independent_model_over_many_seeds():
    """With jumps, so that the staircase is followed better than by a trend alone."""
    most = {
        "static": 4.4,
        "ascending": 4.8,
        "alternating": 5.5,
        "sine2": 6.3,
        "square2": 8.0,
        "wear+chip": 8.5,
        "split": 4.7,
    }
    for case, band in most.items():
        assert np.all(smoothed(case, MANY, chosen=(0,)).error[:, 0] <= band), case


@pytest.mark.long
@pytest.mark.parametrize("decibel", [5.0, 25.0])
def test_other_noise(decibel):
    """Eight seeds; RMSE of force and k_t as measured elsewhere, with room for the scatter of eight."""
    expected = {
        5.0: {"static": (4.7, 222), "ascending": (5.7, 222), "square2": (8.5, 222), "wear+chip": (8.8, 222)},
        25.0: {"static": (0.49, 24), "ascending": (0.70, 24), "square2": (0.70, 24), "wear+chip": (0.78, 24)},
    }[decibel]
    for case, (force, k_t) in expected.items():
        found = smoothed(case, 8, decibel=decibel)
        rms = np.sqrt(np.mean(found.error**2, axis=0))
        assert rms[0] < 1.5 * force, (case, rms)
        assert rms[1] < 1.6 * k_t, (case, rms)
        assert found.cover.mean(axis=0)[0] > 0.75, (case, found.cover.mean(axis=0))


OUTSIDE = {  # force N, k_t, coverage of the force, as measured elsewhere over 32 seeds
    "r drifts by itself": (
        lambda t: cuts._change(0.2 * t, cuts._ALL) + cuts._change(0.06 * np.cos(2 * np.pi * t), cuts._K_R),
        (1.96, 58, 0.96),
    ),
    "k up, m down": (
        lambda t: cuts._change(0.2 * t, np.array([1.0, -1.0, 1.0, -1.0])),
        (1.96, 67, 0.94),
    ),
    "only m": (lambda t: cuts._change(0.2 * t, 1 - cuts._K_ONLY), (2.01, 64, 0.93)),
    "k_t a ramp, m_t a sine": (
        lambda t: (
            cuts._change(0.2 * t, cuts._K_T) + cuts._change(0.2 * np.sin(2 * np.pi * t), np.array([0, 1.0, 0, 0]))
        ),
        (3.32, 103, 0.89),
    ),
    "a sine of eight periods": (lambda t: cuts._change(0.2 * np.sin(16 * np.pi * t), cuts._ALL), (5.76, 82, 0.75)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", OUTSIDE)
def test_truths_that_no_model_holds(name, monkeypatch):
    change, (force, k_t, cover) = OUTSIDE[name]
    monkeypatch.setitem(cuts.CHANGES, name, change)
    found = smoothed(name, 8)
    rms = np.sqrt(np.mean(found.error**2, axis=0))
    assert rms[0] < 1.5 * force, rms
    assert rms[1] < 2 * k_t, rms
    assert found.cover.mean(axis=0)[0] > cover - 0.12, found.cover.mean(axis=0)


@pytest.mark.long
@pytest.mark.parametrize("case", ["ascending", "wear+chip"])
def test_effects_over_many_seeds(case):
    def rms(effects, modelled=None, **options):
        return np.sqrt(np.mean(smoothed(case, 8, effects, modelled, **options).error[:, 0] ** 2))

    known = rms(Effects(runout=RUNOUT))
    assert known < 4
    assert rms(Effects(runout=RUNOUT), Effects()) > 2 * known
    assert rms(Effects(runout=RUNOUT), Effects(), find_runout=True) < 1.4 * known
    assert rms(LOW_PASS) < 4
    assert rms(LOW_PASS, Effects()) > 60
    assert rms(COLOURED) > 6
    assert (
        rms(COLOURED, COLOURED._replace(whitened=True)) < {"ascending": 4, "wear+chip": 5.3}[case]
    )  # a chip in noise like it
