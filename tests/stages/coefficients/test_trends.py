"""Following coefficients through simulated dynamometer cuts: what comes back, what is told, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from millcal.errors import IllPosedError, RecipeError
from millcal.physics.changing_coefficients import Chip, Trend
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation.cuts import Timeline, simulate_cut
from millcal.stages.coefficients.trends import follow_coefficients
from millcal.stages.conditioning.samples import sample_cut

CUTTER = Cutter(diameter=12e-3, teeth=2, helix=np.radians(30))
WORN = replace(CUTTER, runout=8e-6, runout_angle=np.radians(60))
CONDITIONS = CuttingConditions(
    spindle_speed=2 * np.pi * 39.7, feed_per_tooth=0.08e-3, axial_depth=3e-3, radial_depth=4e-3, direction="down"
)
STEEL = Kienzle(np.array([1500e6, 420e6, 240e6]), np.array([0.21, 0.46, 0.34]))
ALUMINIUM = LinearEdge(np.array([800e6, 250e6, 120e6]), np.array([20e3, 15e3, 5e3]))


def cut(
    seed=0,
    *,
    law=STEEL,
    cutter=WORN,
    conditions=CONDITIONS,
    seconds=1.2,
    noise=8.0,
    lowpass=None,
    air=0.3,
    trend=None,
    **chain,
):
    """A sampled cut with air before and after."""
    recording, _ = simulate_cut(
        law,
        cutter,
        conditions,
        rng=np.random.default_rng(seed),
        sample_rate=5000.0,
        timeline=Timeline(seconds, air, air, 0.05),
        dynamometer=MeasuringChain(noise=noise, lowpass=lowpass, **chain),
        name=f"cut{seed}.h5",
        initial_angle=None,
        **({} if trend is None else {"trend": trend}),
    )
    return sample_cut(recording)


def followed(*cuts, seed=0, **options):
    return follow_coefficients(cuts, rng=np.random.default_rng(seed), **options)


def error(history, step, truth):
    """Values less the truth in standard deviations of their bands.   truth : (coefficient,)"""
    sd = (history.high[step] - history.low[step]) / 3.92
    return (history.value[step] - truth) / sd


TRUTH = np.concatenate([STEEL.specific_force, STEEL.rise])


def test_a_steady_cut_gives_its_coefficients_runout_and_a_good_verdict():
    found = followed(cut(lowpass=600.0), lowpass=600.0)
    assert found.verdict == "fits"
    assert 0.9 < found.chi2 < 1.1
    assert np.all(np.abs(error(found, -1, TRUTH)) < 4)
    c0, s0 = found.runout
    assert np.hypot(c0, s0) == pytest.approx(8e-6, abs=1.5e-6)
    assert np.all((found.slope_low < 0) & (found.slope_high > 0))
    assert not found.jumps


def test_wear_and_a_chipped_edge_are_told_apart():
    wear = ((0.35, 1.0), (1.55, 1.15))
    trend = Trend(drift=(wear, wear, wear), chips=(Chip(0.9, (0.12, 0.12, 0.12)),))
    found = followed(cut(trend=trend))
    (jump,) = found.jumps
    assert jump.time == pytest.approx(0.9, abs=0.02)
    assert np.all(np.abs(np.array(jump.change) - np.log(1.12)) < 4 * np.array(jump.sd))
    true_slope = np.log(1.15) / 1.2 * 60
    assert np.all(np.abs(found.slope_per_minute - true_slope) < 0.25 * true_slope)
    at_end = TRUTH * np.array([1.15 * 1.12] * 3 + [1.0] * 3)
    assert np.all(np.abs(error(found, -1, at_end)) < 4.5)


@pytest.mark.parametrize("method", ["imm", "rls", "enkf-inflated"])
def test_every_filter_comes_to_the_force_of_a_steady_cut(method):
    found = followed(cut(lowpass=600.0), lowpass=600.0, method=method)
    true_force = STEEL.specific_force * (found.reference_chip / 1e-3) ** -STEEL.rise
    late = len(found.time) // 2
    assert np.all(np.abs(np.mean(found.specific_force[late:], axis=0) / true_force - 1) < 0.03)
    assert not found.verdict.startswith("does not fit")


def test_the_plain_ensemble_collapses_where_the_edge_wears_and_says_so():
    wear = ((0.35, 1.0), (1.55, 1.4))
    found = followed(cut(trend=Trend(drift=(wear, wear, wear)), noise=3.0), method="enkf")
    failed = {check.name: check.message for check in found.checks if not check.passed}
    assert "collapsed or lags behind" in failed["innovations"]
    assert found.verdict != "fits"


def test_a_forgotten_low_pass_is_named():
    found = followed(cut(lowpass=400.0, noise=2.0))
    assert found.verdict != "fits"
    (corner,) = re.findall(r"low-pass of about (\d+) Hz", found.verdict)
    assert float(corner) == pytest.approx(400, rel=0.15)
    assert followed(cut(lowpass=400.0, noise=2.0), lowpass=400.0).verdict == "fits"


def test_forgotten_runout_is_named():
    found = followed(cut(noise=3.0), runout="known")
    assert "runout brings chi2" in found.verdict


def test_a_resonance_is_left_out_by_smoothing_below_it():
    ringing = {"resonance": (900.0, 900.0, 900.0), "damping_ratio": (0.02, 0.02, 0.02)}
    raw = followed(cut(noise=3.0, **ringing))
    smoothed = followed(cut(noise=3.0, **ringing), smoothing=150.0)
    truth = STEEL.specific_force[0] * (raw.reference_chip / 1e-3) ** -STEEL.rise[0]
    off = [abs(found.specific_force[-1, 0] / truth - 1) for found in (raw, smoothed)]
    assert raw.chi2 > 3
    assert smoothed.chi2 < raw.chi2 / 3
    assert off[1] < 0.04


def test_cuts_of_two_feeds_share_their_runout_and_tell_the_exponent_better():
    fast = replace(CONDITIONS, feed_per_tooth=0.2e-3)  # a slow one has less force on the same noise and offset
    one = followed(cut(1, seconds=1.0))
    two = followed(cut(1, seconds=0.5), cut(2, seconds=0.5, conditions=fast))
    assert two.cuts == ("cut1.h5", "cut2.h5")
    assert set(two.cut) == {0, 1}
    assert np.all(np.abs(error(two, -1, TRUTH)) < 4.5)

    def sd_of_rise(found):
        return float(np.min(found.high[:, 3] - found.low[:, 3]))

    assert sd_of_rise(two) < 0.85 * sd_of_rise(one)
    assert not any(notice.code == "single-feed" for notice in two.notices)


def test_the_linear_edge_law_and_an_axial_force_that_pulls():
    pulls = LinearEdge(ALUMINIUM.cutting * np.array([1, 1, -1]), ALUMINIUM.edge * np.array([1, 1, -1]))
    found = followed(cut(law=pulls), law="linear-edge")
    truth = np.concatenate([pulls.cutting, pulls.edge])
    assert found.names == ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
    assert np.all(np.abs(error(found, -1, truth)) < 4)
    assert found.posterior["Kac"] < 0


def test_without_air_the_samples_between_teeth_tell_the_noise():
    found = followed(cut(air=0.0))
    assert found.noise_from == "idle"
    assert found.noise == pytest.approx([8.0] * 3, rel=0.1)


def test_a_slot_without_air_takes_its_residuals_for_noise_and_warns():
    slot = replace(CONDITIONS, radial_depth=12e-3, direction="slot")
    found = followed(cut(air=0.0, conditions=slot, cutter=replace(WORN, teeth=4)))
    assert found.noise_from == "residual"
    assert any(notice.code == "no-air-cut" for notice in found.notices)


def test_coloured_noise_is_whitened():
    found = followed(cut(noise=2.0, coloured_noise=8.0, coloured_corner=300.0))
    assert 0.85 < found.chi2 < 1.15
    assert np.all(np.abs(error(found, -1, TRUTH)) < 4)


def test_bounds_make_the_prior_of_the_smoother_and_the_box_of_the_ensemble():
    narrow = {"kt": (1499e6, 1501e6), "mt": (0.2095, 0.2105)}
    free, told = (followed(cut(seconds=0.4), bounds=bounds) for bounds in (None, narrow))
    assert told.high[-1, 3] - told.low[-1, 3] < 0.5 * (free.high[-1, 3] - free.low[-1, 3])
    wrong = {"kt": (300e6, 500e6), "mt": (0.05, 0.1)}
    caught = followed(cut(seconds=0.4), method="enkf", bounds=wrong)
    assert caught.value[-1, 0] <= 500e6 * 1.2
    assert any(notice.code == "at-bound" for notice in caught.notices)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "kalman"}, "coefficients.method"),
        ({"law": "exponential"}, "coefficients.law"),
        ({"runout": "free"}, "coefficients.runout"),
        ({"forgetting": 1.2}, "coefficients.forgetting"),
        ({"members": 2, "method": "enkf"}, "coefficients.members"),
        ({"bounds": {"kt": (1e9, 2e9)}}, "mt is not"),
        ({"bounds": {"kt": (2e9, 1e9), "mt": (0.1, 0.3)}}, "let low be below"),
        ({"bounds": {"kt": (0.0, 2e9), "mt": (0.1, 0.3)}}, "nothing or less"),
        ({"bounds": {"Ktc": (1e9, 2e9), "Kte": (1e3, 2e3)}}, "no coefficient of the kienzle law"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(options, said):
    with pytest.raises(RecipeError, match=said):
        followed(cut(seconds=0.3), **options)


def test_a_channel_that_never_changes_is_refused():
    found = cut(seconds=0.3)
    dead = replace(found, force=found.force * np.array([[1.0], [1.0], [0.0]]))
    with pytest.raises(IllPosedError, match="along z never changes"):
        followed(dead)


@pytest.mark.parametrize(("stated", "told"), [(0.3, False), (0.5, True)])
def test_a_stated_spindle_phase_that_the_force_contradicts_is_told(stated, told):
    recording, _ = simulate_cut(
        STEEL,
        WORN,
        CONDITIONS,
        rng=np.random.default_rng(0),
        sample_rate=5000.0,
        timeline=Timeline(0.3, 0.2, 0.2, 0.05),
        dynamometer=MeasuringChain(noise=8.0),
        encoder=2048,
        pulse_angle=0.3,
    )
    found = followed(sample_cut(recording, spindle_phase=stated), method="rls")
    assert any(notice.code == "phase-off" for notice in found.notices) == told


def test_a_low_pass_beyond_half_the_sample_rate_and_no_cuts_are_refused():
    with pytest.raises(IllPosedError, match="half the sample rate"):
        followed(cut(seconds=0.3), lowpass=4000.0)
    with pytest.raises(IllPosedError, match="there are none"):
        followed()


def test_the_same_seed_gives_the_same_ensemble_and_another_seed_another():
    first, again, other = (followed(cut(seconds=0.3), method="enkf", seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.value, again.value)
    assert not np.array_equal(first.value, other.value)


@pytest.mark.parametrize("seeds", [6, pytest.param(60, marks=pytest.mark.long)])
def test_intervals_of_the_smoother_hold_as_often_as_they_say(seeds):
    wear = ((0.35, 1.0), (0.95, 1.1))
    trend, slope = Trend(drift=(wear, wear, wear)), np.log(1.1) / 0.6 * 60
    hits = []
    for seed in range(seeds):
        found = followed(cut(seed, seconds=0.6, lowpass=600.0, trend=trend), lowpass=600.0)
        factor = np.interp(found.time, *np.array(wear).T)[:, np.newaxis]
        true_force = factor * STEEL.specific_force * (found.reference_chip / 1e-3) ** -STEEL.rise
        true = np.concatenate([factor * STEEL.specific_force, np.broadcast_to(STEEL.rise, (len(factor), 3))], axis=1)
        hits.append(
            [
                np.mean((found.specific_low <= true_force) & (true_force <= found.specific_high)),
                np.mean((found.low <= true) & (true <= found.high)),
                np.mean((found.slope_low <= slope) & (slope <= found.slope_high)),
            ]
        )
    covered = np.mean(hits, axis=0)
    print(f"held by 95 % intervals: force {covered[0]:.1%}, coefficients {covered[1]:.1%}, wear {covered[2]:.1%}")
    few = seeds < 20
    assert np.all(covered > (0.80 if few else 0.90)), covered
    assert np.all(covered <= 1.0)


def test_what_little_air_leaves_unsure_of_the_offset_is_in_the_intervals():
    whole = cut(seconds=0.4, lowpass=None, conditions=replace(CONDITIONS, radial_depth=12e-3, direction="slot"))
    little = replace(whole, air_force=whole.air_force[:, :400], air_spans=((0, 400),))
    sure, unsure = followed(whole), followed(little)
    step = len(sure.time) // 2

    def half(found):
        return (np.log(found.specific_high) - np.log(found.specific_low))[step] / 2

    wrong = 1.96 * 8.0 / np.sqrt(400)  # N, as the mean of so little air may be
    moved = [
        np.log(followed(replace(little, force=little.force + wrong * axis[:, np.newaxis])).specific_force[step])
        - np.log(unsure.specific_force[step])
        for axis in np.eye(3)
    ]
    expected = np.sqrt(np.sum(np.square(moved), axis=0) * (1 - 4 / 3 * 400 / whole.air_force.shape[1]))
    assert np.sqrt(half(unsure) ** 2 - half(sure) ** 2) == pytest.approx(expected, rel=0.25)


def test_wear_between_two_feeds_is_not_taken_for_an_exponent():
    worn, later = ((0.35, 1.0), (0.85, 1.1)), ((0.35, 1.1), (0.85, 1.2))
    slow = replace(CONDITIONS, feed_per_tooth=0.03e-3)
    first = cut(1, seconds=0.5, trend=Trend(drift=(worn,) * 3), conditions=slow)
    second = cut(2, seconds=0.5, trend=Trend(drift=(later,) * 3))
    found = followed(first, second)
    assert found.verdict == "fits"
    assert not found.jumps
    assert np.all(np.abs(error(found, -1, TRUTH * np.array([1.2] * 3 + [1.0] * 3))) < 4.5)


def test_a_filter_that_leaves_more_than_noise_does_not_fit_however_unsure_it_is():
    ringing = {"resonance": (900.0, 900.0, 900.0), "damping_ratio": (0.02, 0.02, 0.02)}
    assert followed(cut(noise=3.0, **ringing), method="imm").verdict != "fits"


def test_another_law_is_named_where_it_would_explain_the_residuals():
    found = followed(cut(noise=1.0), law="linear-edge")
    assert 'set law = "kienzle"' in found.verdict


def test_windows_that_are_drawn_lie_within_one_cut():
    found = followed(cut(1, seconds=0.5), cut(2, seconds=0.5), method="rls")
    border = found.time[found.cut == 0].max()
    for number in range(3):
        window = found.shown[found.shown_window == number]
        assert window.max() <= border + 0.01 or window.min() >= border - 0.01


def test_wear_within_the_first_revolutions_is_no_fault_of_the_law():
    wear = ((0.35, 1.0), (0.95, 1.1))
    found = followed(cut(seconds=0.6, trend=Trend(drift=(wear,) * 3)))
    assert found.verdict == "fits"
    assert found.runout is not None
    assert not {"runout-held", "intervals-widened"} & {notice.code for notice in found.notices}
