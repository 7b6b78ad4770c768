"""The stability map: what the coefficients' and the FRF's uncertainty make of the limit, and what is refused or told."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Frf, Modes, Posterior
from millcal.errors import IllPosedError
from millcal.physics.cutting_force import Kienzle
from millcal.physics.structure import Mode, convert_frf, convert_frf_variance, receptance
from millcal.stages.stability import choice, map_stability
from millcal.stages.stability.lines import tip_receptance
from millcal.stages.stability.pockets import held

RPM = 2 * np.pi / 60
KTC, KRC = 1319.4e6, 788.8e6
MODES = Modes(
    natural_frequency=[456.780432115313, 1448.88914030656, 516.51818914797, 1408.44814086966],
    damping_ratio=[0.111705399393456, 0.0170370095790783, 0.0245796327070992, 0.0313576019295683],
    stiffness=[7933097.18086825, 14691778.4389479, 9374613.81193087, 12406389.7145168],
    axes=("x", "x", "y", "y"),
)
ONE = Modes(natural_frequency=[500.0], damping_ratio=[0.03], stiffness=[8e6], axes=("x",))
BAND = (20.0, 2000.0)  # Hz
CUT = {
    "teeth": 2,
    "diameter": 20e-3,
    "radial_depth": 10e-3,
    "direction": "down",
    "feed_per_tooth": 0.1e-3,
    "spindle_speed": (4000 * RPM, 16_000 * RPM),
    "method": "zoa",
}


def posterior(mean=(KTC, KRC), sd=(50e6, 60e6), edge=20e3, law="linear-edge", names=("Ktc", "Krc"), correlation=0.3):
    """Coefficients with an uninvolved edge coefficient between them."""
    names = (names[0], "Kte", *names[1:])
    mean = np.array([mean[0], edge, *mean[1:]])
    sd = np.array([sd[0], edge / 10, *sd[1:]])
    shape = np.full((len(sd), len(sd)), correlation) + (1 - correlation) * np.eye(len(sd))
    covariance = shape * np.outer(sd, sd)
    interval = np.stack([mean - 2 * sd, mean + 2 * sd], axis=1)
    units = ("N/m^2",) * len(sd)
    return Posterior(
        names=names, units=units, mean=mean, covariance=covariance, interval=interval, law=law, method="average"
    )


def measured(*, spacing=1.0, noise=0.0, rng=None, form="receptance", highest=2500.0, low=20.0, modes=MODES):
    """An FRF of the modes along x and y, with white noise of a share of its largest value."""
    columns = zip(modes.natural_frequency, modes.damping_ratio, modes.stiffness, modes.axes, strict=True)
    frequency = np.arange(0.0, highest, spacing)
    values = receptance(frequency, [Mode(*row) for row in columns])
    variance = np.full(values.shape, (noise * np.abs(values).max()) ** 2)
    if noise:
        error = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
        values = values + np.sqrt(variance / 2) * error
    return Frf(
        frequency=frequency,
        values=convert_frf(frequency, values, "receptance", form),
        variance=convert_frf_variance(frequency, variance, "receptance", form) if noise else None,
        form=form,
        estimator="h1",
        outputs=("tipX", "tipY"),
        inputs=("tipX", "tipY"),
        hits_used=(5, 5),
        usable_band=(low, highest),
    )


@pytest.fixture(autouse=True)
def unchallenged(monkeypatch):
    """Nothing is held against zero order here: that is the matter of `test_choice`, and dear over hundreds of seeds."""
    monkeypatch.setattr(choice, "_rival", lambda *given: None)


def codes(found):
    return {notice.code for notice in found.notices}


def test_edge_coefficients_do_not_move_the_limit_nor_its_band():
    small, large = (
        map_stability(MODES, posterior(edge=edge), **CUT, points=30, rng=np.random.default_rng(0))
        for edge in (1e3, 50e3)
    )
    np.testing.assert_array_equal(small.limit_depth, large.limit_depth)
    np.testing.assert_allclose(small.limit_low, large.limit_low, rtol=1e-9)


def test_the_band_is_that_of_every_draw_solved_by_itself():
    """Interpolating between solved ratios costs less than a hundredth of the band, and errs to the safe side at corners."""
    known = posterior()
    found = map_stability(MODES, known, **CUT, points=12, members=100, rng=np.random.default_rng(5))
    two = replace(known, **{name: getattr(known, name)[[0, 2]] for name in ("mean", "interval")},
                  names=("Ktc", "Krc"), units=("N/m^2",) * 2, covariance=known.covariance[np.ix_([0, 2], [0, 2])])  # fmt: skip
    draws = two.sample(np.random.default_rng(5), 100)
    each = [map_stability(MODES, tuple(draw), **CUT, points=12, members=0).limit_depth for draw in draws]
    low, high = np.quantile(1 / np.array(each), [0.975, 0.025], axis=0, method="weibull") ** -1
    width = found.limit_high - found.limit_low
    assert np.max(np.abs(found.limit_low - low) / width) < 0.01
    assert np.max(np.abs(found.limit_high - high) / width) < 0.01


def test_few_cuts_behind_the_coefficients_make_the_band_wider_by_students_factor():
    """Three degrees of freedom: 3.18 instead of 1.96 standard errors."""
    widths = []
    for dof in (np.inf, 3.0):
        known = replace(posterior(sd=(10e6, 12e6)), dof=dof)
        found = map_stability(MODES, known, **CUT, points=20, members=20_000, rng=np.random.default_rng(0))
        widths.append(np.median(found.limit_high - found.limit_low))
    assert widths[1] / widths[0] == pytest.approx(3.18 / 1.96, rel=0.05)


def test_coefficients_without_an_interval_give_a_line_and_say_so():
    known = posterior()
    unknown = replace(known, covariance=np.full(known.covariance.shape, np.nan))
    found = map_stability(MODES, unknown, **CUT, points=20, rng=np.random.default_rng(0))
    assert found.limit_low is None
    assert "no-band" in codes(found)


def test_certain_ratio_or_certain_coefficients_need_no_grid_of_ratios():
    exact = posterior(sd=(0.0, 0.0))
    assert map_stability(MODES, exact, **CUT, points=5, rng=np.random.default_rng(0)).limit_low is None
    along = posterior(sd=(KTC * 0.05, KRC * 0.05), correlation=1.0)
    found = map_stability(MODES, along, **CUT, points=20, members=4000, rng=np.random.default_rng(0))
    np.testing.assert_allclose(found.limit_low, found.limit_depth / (1 + 1.96 * 0.05), rtol=0.01)


def test_the_band_shrinks_with_the_covariance_onto_the_limit():
    for scale in (1.0, 1e-3):
        known = posterior(sd=(50e6 * scale, 60e6 * scale))
        found = map_stability(MODES, known, **CUT, points=20, rng=np.random.default_rng(0))
        relative = (found.limit_high - found.limit_low) / found.limit_depth
        assert np.all(found.limit_low <= found.limit_depth * (1 + 1e-6))
        assert np.median(relative) == pytest.approx(0.16 * scale, rel=0.4)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_the_true_limit_is_inside_the_band_of_coefficients_at_the_stated_rate(direction):
    """150 estimates scattered as their covariance says; a binomial tolerance of three standard deviations."""
    truth = map_stability(ONE, (KTC, KRC), **{**CUT, "direction": direction}, points=4, rigid="y").limit_depth
    known = posterior()
    inside = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        estimate = replace(known, mean=known.sample(rng, 1)[0])
        found = map_stability(
            ONE, estimate, **{**CUT, "direction": direction}, points=4, members=400, rigid="y", rng=rng
        )
        inside.append((found.limit_low <= truth) & (truth <= found.limit_high))
    rate = np.mean(inside, axis=0)
    assert np.all(np.abs(rate - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 150) + 0.01)


def coverage_of_the_frf_band(seeds, noise, spacing, points=60):
    truth = map_stability(MODES, (KTC, KRC), **CUT, points=points).limit_depth
    inside = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        frf = measured(noise=noise, spacing=spacing, rng=rng)
        found = map_stability(frf, (KTC, KRC), **CUT, points=points, members=500, rng=rng)
        inside.append((found.limit_low <= truth) & (truth <= found.limit_high))
    return np.mean(inside)


def test_the_true_limit_is_inside_the_band_of_a_noisy_frf_at_nearly_the_stated_rate():
    """Over all speeds; corners between lobes, where the lowest of two noisy crossings counts, hold less."""
    assert 0.92 < coverage_of_the_frf_band(16, 0.01, 1.0) < 0.985


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.002, 0.01, 0.02])
@pytest.mark.parametrize("spacing", [0.5, 2.0])
def test_the_band_of_a_noisy_frf_holds_over_noise_and_line_spacing(noise, spacing):
    assert 0.92 < coverage_of_the_frf_band(60, noise, spacing, points=200) < 0.985


def test_both_uncertainties_together_are_wider_than_either():
    frf = measured(noise=0.01, rng=np.random.default_rng(0))
    widths = []
    for dynamics, known in ((frf, (KTC, KRC)), (replace(frf, variance=None), posterior()), (frf, posterior())):
        found = map_stability(dynamics, known, **CUT, points=60, rng=np.random.default_rng(1))
        widths.append(np.median(found.limit_high - found.limit_low))
    assert widths[2] == pytest.approx(np.hypot(*widths[:2]), rel=0.15)


def test_without_any_uncertainty_there_is_no_band_and_no_probability():
    found = map_stability(MODES, (KTC, KRC), **CUT, points=20, operating_point=(8000 * RPM, 1e-3))
    assert found.limit_low is None
    assert found.operating.p_stable is None
    assert all(best.p_stable is None and best.safe_depth is None for best in found.best)


@pytest.mark.parametrize("form", ["accelerance", "mobility", "receptance"])
def test_an_frf_of_any_form_gives_the_limit_of_its_modes(form):
    exact = map_stability(MODES, (KTC, KRC), **CUT, points=60)
    found = map_stability(measured(form=form), (KTC, KRC), **CUT, points=60)
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-5)
    np.testing.assert_allclose(found.chatter_frequency, exact.chatter_frequency, rtol=1e-5)
    assert found.absolute_minimum == pytest.approx(exact.absolute_minimum, rel=1e-6)


def test_the_order_of_outputs_and_inputs_does_not_matter_and_foreign_dofs_are_left_alone():
    frf = measured()
    mixed = replace(
        frf,
        values=np.concatenate([frf.values[:, ::-1], 7 * frf.values[:, :1]], axis=1),
        outputs=("tipY", "tipX", "tipZ"),
    )
    np.testing.assert_array_equal(tip_receptance(mixed, BAND).values, tip_receptance(frf, BAND).values)


def test_a_driving_point_with_the_wrong_sign_is_refused_with_its_name_and_frequency():
    frf = measured()
    with pytest.raises(IllPosedError, match=r"tipX/tipX: Im of the receptance is positive .* Hz.*turn the sign"):
        map_stability(replace(frf, values=-frf.values), (KTC, KRC), **CUT)
    with pytest.raises(IllPosedError, match="conjugated"):
        map_stability(replace(frf, values=frf.values.conj()), (KTC, KRC), **CUT)


def test_lines_at_which_a_driving_point_gives_power_back_are_told():
    frf = measured()
    values = frf.values.copy()
    values[700:720, 0, 0] = values[440, 0, 0].conj()
    assert "not-passive" in codes(map_stability(replace(frf, values=values), (KTC, KRC), **CUT, points=10))


def test_a_missing_axis_is_refused_unless_the_user_says_that_it_is_rigid():
    frf = measured()
    only_x = replace(frf, values=frf.values[:, :1, :1], outputs=("tipX",), inputs=("tipX",))
    modes_x = Modes(**{
        **{name: getattr(MODES, name)[:2] for name in ("natural_frequency", "damping_ratio", "stiffness")},
        "axes": ("x", "x"),
    })  # fmt: skip
    for dynamics in (only_x, modes_x):
        with pytest.raises(IllPosedError, match="nothing along y; add it"):
            map_stability(dynamics, (KTC, KRC), **CUT)
    by_lines, by_modes = (map_stability(d, (KTC, KRC), **CUT, points=40, rigid="y") for d in (only_x, modes_x))
    assert "rigid-axis" in codes(by_lines) & codes(by_modes)
    np.testing.assert_allclose(by_lines.limit_depth, by_modes.limit_depth, rtol=1e-5)


def test_an_axis_that_was_measured_counts_though_it_is_called_rigid_and_that_is_told():
    for dynamics in (measured(), MODES):
        plain = map_stability(dynamics, (KTC, KRC), **CUT, points=10)
        called = map_stability(dynamics, (KTC, KRC), **CUT, points=10, rigid="x")
        np.testing.assert_array_equal(called.limit_depth, plain.limit_depth)
        assert codes(called) - codes(plain) == {"rigid-ignored"}


def test_a_response_that_is_not_at_the_point_of_the_force_is_refused():
    frf = replace(measured(), outputs=("shankX", "shankY"))
    with pytest.raises(IllPosedError, match="no point is both hit and measured"):
        map_stability(frf, (KTC, KRC), **CUT)


def test_two_driving_points_are_refused_because_only_one_is_the_tip():
    frf = measured()
    twice = replace(
        frf,
        values=np.tile(frf.values, (1, 2, 2)),
        outputs=("tipX", "tipY", "shankX", "shankY"),
        inputs=("tipX", "tipY", "shankX", "shankY"),
        hits_used=(5,) * 4,
    )
    with pytest.raises(IllPosedError, match="tip and shank are both"):
        map_stability(twice, (KTC, KRC), **CUT)


def test_gaps_in_the_cross_receptance_are_taken_as_zero_and_told():
    frf = measured()
    values = frf.values.copy()
    values[:, 0, 1] = np.nan
    found = map_stability(replace(frf, values=values), (KTC, KRC), **CUT, points=20)
    assert "cross-terms" in codes(found)
    np.testing.assert_allclose(
        found.limit_depth, map_stability(frf, (KTC, KRC), **CUT, points=20).limit_depth, rtol=1e-9
    )


def test_limits_whose_chatter_lies_outside_the_usable_band_are_not_shown_and_that_is_told():
    inside = map_stability(measured(), (KTC, KRC), **CUT, points=200)
    narrow = map_stability(replace(measured(), usable_band=(20.0, 900.0)), (KTC, KRC), **CUT, points=200)
    assert "band-limited" not in codes(inside)
    assert "band-limited" in codes(narrow)
    chatter = narrow.chatter_frequency[np.isfinite(narrow.chatter_frequency)]
    assert chatter.max() <= 900.0
    assert np.all(narrow.limit_depth >= inside.limit_depth * (1 - 1e-6))


def test_noise_of_an_accelerance_at_low_frequency_makes_no_lobes_of_its_own():
    """White noise on the accelerance is 1 / w^2 on the receptance: at 10 Hz a hundred times the softest mode."""
    rng = np.random.default_rng(0)
    frf = measured(form="accelerance", low=2.0)
    sd = 0.005 * np.abs(frf.values).max()
    error = rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape)
    noisy = replace(frf, values=frf.values + sd / np.sqrt(2) * error, variance=np.full(frf.values.shape, sd**2))
    found = map_stability(noisy, (KTC, KRC), **CUT, points=100, rng=rng)
    exact = map_stability(MODES, (KTC, KRC), **CUT, points=100)
    assert "low-frequency-noise" in codes(found)
    assert "low-frequency-noise" not in codes(map_stability(frf, (KTC, KRC), **CUT, points=10))
    assert np.median(np.abs(found.limit_depth / exact.limit_depth - 1)) < 0.05
    assert found.chatter_frequency.min() > 200
    assert np.mean((found.limit_low <= exact.limit_depth) & (exact.limit_depth <= found.limit_high)) > 0.9


def test_an_frf_of_noise_alone_is_refused():
    frf = measured(noise=0.01, rng=np.random.default_rng(0))
    with pytest.raises(IllPosedError, match="tipX/tipX: the receptance is noise"):
        map_stability(replace(frf, variance=np.abs(frf.values) ** 2), (KTC, KRC), **CUT)


def test_an_frf_with_hardly_any_line_in_its_usable_band_is_refused():
    with pytest.raises(IllPosedError, match="usable band"):
        map_stability(replace(measured(), usable_band=(500.0, 504.0)), (KTC, KRC), **CUT)


def test_a_kienzle_law_enters_by_its_slope_at_the_mean_chip_of_the_feed():
    """The slope of `Kienzle.edge_force` itself, by differences, gives the same map; a rise of 0 is the linear law."""
    law = Kienzle(specific_force=np.array([700e6, 300e6, 0.0]), rise=np.array([0.25, 0.4, 0.0]))
    kienzle = posterior(
        (700e6, 300e6, 0.25, 0.4), (20e6, 20e6, 0.01, 0.01), law="kienzle", names=("kt", "kr", "mt", "mr")
    )
    mean_chip = CUT["feed_per_tooth"] * 2 / np.pi  # half immersion: the mean of a sine from 90 to 180 degrees
    force = law.edge_force(mean_chip * np.array([1 - 1e-5, 1 + 1e-5]), 1.0)
    slope = (force[1] - force[0]) / (2e-5 * mean_chip)
    found = map_stability(MODES, kienzle, **CUT, points=20, rng=np.random.default_rng(0))
    expected = map_stability(MODES, tuple(slope[:2]), **CUT, points=20)
    np.testing.assert_allclose(found.limit_depth, expected.limit_depth, rtol=1e-7)
    assert "kienzle-tangent" in codes(found)
    assert np.all(found.limit_low < found.limit_depth)
    straight = posterior((KTC, KRC, 0.0, 0.0), (1e6, 1e6, 0.0, 0.0), law="kienzle", names=("kt", "kr", "mt", "mr"))
    linear = map_stability(MODES, (KTC, KRC), **CUT, points=20)
    np.testing.assert_allclose(
        map_stability(MODES, straight, **CUT, points=20).limit_depth, linear.limit_depth, rtol=1e-9
    )


def test_a_kienzle_law_without_a_feed_is_refused():
    kienzle = posterior((700e6, 300e6, 0.25, 0.4), (1e6,) * 4, law="kienzle", names=("kt", "kr", "mt", "mr"))
    with pytest.raises(IllPosedError, match="feed_per_tooth_mm"):
        map_stability(MODES, kienzle, **{**CUT, "feed_per_tooth": None})


def test_the_best_speeds_are_the_tops_of_the_pockets_ranked_by_what_may_be_run():
    found = map_stability(MODES, posterior(), **CUT, operating_point=(8000 * RPM, 1e-3), rng=np.random.default_rng(0))
    fine = map_stability(MODES, (KTC, KRC), **CUT, points=20_001)
    rate = fine.spindle_speed * held(fine.spindle_speed, fine.limit_depth, fine.spindle_speed)
    runnable = [best.spindle_speed * best.safe_depth for best in found.best]
    assert runnable == sorted(runnable, reverse=True)
    assert 1 <= len(found.best) <= 5
    for best in found.best:
        near = np.abs(fine.spindle_speed - best.spindle_speed) < 40 * RPM
        assert best.spindle_speed * best.axial_depth >= rate[near].max() * (1 - 1e-2)
        assert 0 < best.p_stable < 1
        assert best.safe_depth < best.axial_depth
        volume = best.axial_depth * CUT["radial_depth"] * CUT["feed_per_tooth"] * 2 * best.spindle_speed / (2 * np.pi)
        assert best.removal_rate == pytest.approx(volume)
    assert max(b.spindle_speed * b.axial_depth for b in found.best) == pytest.approx(rate.max(), rel=5e-3)


def test_the_operating_point_is_surely_stable_far_below_the_limit_and_surely_not_far_above():
    probabilities, limits = [], []
    for share in (0.5, 1.0, 2.0):
        at = map_stability(MODES, (KTC, KRC), **CUT, points=2, operating_point=(8000 * RPM, 0.1)).operating.limit
        found = map_stability(
            MODES, posterior(), **CUT, points=2, operating_point=(8000 * RPM, share * at), rng=np.random.default_rng(0)
        )
        probabilities.append(found.operating.p_stable)
        limits.append(found.operating.limit)
        assert found.operating.limit_interval[0] < at < found.operating.limit_interval[1]
    assert probabilities[0] == 1.0
    assert 0.3 < probabilities[1] < 0.7
    assert probabilities[2] == 0.0
    assert limits == [limits[0]] * 3


def test_a_slot_needs_no_radial_depth_and_is_the_full_immersion():
    slot = map_stability(MODES, (KTC, KRC), **{**CUT, "direction": "slot", "radial_depth": None}, points=20)
    full = map_stability(MODES, (KTC, KRC), **{**CUT, "direction": "up", "radial_depth": 20e-3}, points=20)
    np.testing.assert_allclose(slot.limit_depth, full.limit_depth, rtol=1e-9)
    assert slot.radial_depth == CUT["diameter"]


def test_unequal_pitch_and_a_missing_feed_are_told():
    found = map_stability(
        MODES,
        (KTC, KRC),
        **{**CUT, "radial_depth": 1e-3, "feed_per_tooth": None},
        pitch=np.radians([170.0, 190.0]),
        points=10,
    )
    assert {"mean-pitch", "no-feed"} <= codes(found)
    assert all(np.isnan(best.removal_rate) for best in found.best)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"spindle_speed": (0.0, 100.0)}, "no range of spindle speeds"),
        ({"spindle_speed": (100.0, 50.0)}, "no range of spindle speeds"),
        ({"spindle_speed": (100.0, np.inf)}, "no range of spindle speeds"),
        ({"points": 1_000_000}, "2 to 100000"),
        ({"radial_depth": 0.0}, "not engaged"),
        ({"radial_depth": 1.25 * CUT["diameter"]}, "more than the diameter"),
        ({"deepest": np.inf}, "no depth"),
        ({"operating_point": (0.0, 1e-3)}, "no operating point"),
        ({"operating_point": (1000.0, np.nan)}, "no operating point"),
    ],
)
def test_a_map_that_cannot_be_drawn_is_refused_with_the_key(change, words):
    with pytest.raises(IllPosedError, match=rf"stability\..*{words}"):
        map_stability(MODES, (KTC, KRC), **{**CUT, **change})


def test_a_negative_ktc_is_refused_and_vague_coefficients_are_told():
    with pytest.raises(IllPosedError, match="Ktc"):
        map_stability(MODES, (-KTC, KRC), **CUT)
    vague = posterior(sd=(800e6, 60e6))
    found = map_stability(MODES, vague, **CUT, points=10, rng=np.random.default_rng(0))
    assert "coefficients-vague" in codes(found)


def test_coefficients_without_krc_are_refused_by_name():
    known = posterior(names=("Ktc", "Kac"))
    with pytest.raises(IllPosedError, match="Krc"):
        map_stability(MODES, known, **CUT)


def test_an_unknown_method_lists_those_there_are():
    with pytest.raises(ValueError, match="zoa"):
        map_stability(MODES, (KTC, KRC), **{**CUT, "method": "magic"})


def test_the_same_seed_gives_the_same_band_and_progress_ends_at_one():
    shares = []
    first, second = (
        map_stability(
            MODES, posterior(), **CUT, points=20, rng=np.random.default_rng(3), progress=lambda s, _: shares.append(s)
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.limit_low, second.limit_low)
    half = shares[: len(shares) // 2]
    assert half == sorted(half)
    assert half[-1] == 1.0
