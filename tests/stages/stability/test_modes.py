"""The stability map of fitted modes: the same limit as by hand or by lines, and a band that holds what the fit left open."""

import re
from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Frf, ModalFit, Modes, Notice
from millcal.errors import IllPosedError
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode
from millcal.physics.stability.zero_order import limit_of_one_mode, mean_cutting_matrix, minimum_of_one_mode
from millcal.physics.structure import Mode, convert_frf, modal_receptance
from millcal.simulation import simulate_impact
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import fit_modes
from millcal.stages.stability import choice, map_stability
from millcal.stages.stability.dynamics import advise
from millcal.stages.stability.modes import BEYOND

RPM = 2 * np.pi / 60
KTC, KRC = 1319.4e6, 788.8e6
BY_HAND = Modes(
    natural_frequency=[456.78, 1448.89, 516.52, 1408.45],
    damping_ratio=[0.1117, 0.0170, 0.0246, 0.0314],
    stiffness=[7.933e6, 14.69e6, 9.375e6, 12.41e6],
    axes=("x", "x", "y", "y"),
)
CUT = {
    "teeth": 2,
    "diameter": 20e-3,
    "radial_depth": 10e-3,
    "direction": "down",
    "feed_per_tooth": 0.1e-3,
    "spindle_speed": (4000 * RPM, 16_000 * RPM),
}
DOFS = ("tipX", "tipY")
LINES = np.arange(1.0, 2500.0, 1.0)


def residues(modes, turn=0.0):
    """A = alpha / (2j w_d) of real modes, with the machine's axes turned under them by an angle."""
    w = 2 * np.pi * np.asarray(modes.natural_frequency)
    alpha = w**2 / modes.stiffness
    along = np.array([{"x": (1.0, 0.0), "y": (0.0, 1.0)}[axis] for axis in modes.axes])
    along = along @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    factor = alpha / (2j * w * np.sqrt(1 - np.asarray(modes.damping_ratio) ** 2))
    return factor[:, None, None] * along[:, :, None] * along[:, None, :]


@pytest.fixture(autouse=True)
def unchallenged(monkeypatch):
    """Nothing is held against zero order here: that is the matter of `test_choice`, and dear over hundreds of draws."""
    monkeypatch.setattr(choice, "_rival", lambda *given: None)


def fitted(modes=BY_HAND, *, residue=None, remainder=None, powers=(), deviations=None, dof=7.0, form="accelerance",
           band=(100.0, 2400.0), dofs=DOFS, noise=0.0):  # fmt: skip
    """Modes as a fit leaves them, with the fields that the map does not look at left empty.

    deviations : (frequency, damping, residue), each (deviation, mode, ...)   noise : of the lines, share of the largest
    """
    residue = residues(modes) if residue is None else residue
    shape = residue.shape[1:]
    remainder = np.zeros((0, *shape)) if remainder is None else remainder
    lines = LINES[(band[0] <= LINES) & (band[1] >= LINES)]
    receptance = modal_receptance(
        lines, modes.natural_frequency, modes.damping_ratio, residue, remainder, np.array(powers)
    )
    curve = convert_frf(lines, receptance, "receptance", form)
    error = np.random.default_rng(0).standard_normal((2, *curve.shape))
    count = len(modes.natural_frequency)
    none = (np.zeros((0, count)), np.zeros((0, count)), np.zeros((0, count, *shape), complex))
    moved = none if deviations is None else deviations
    fit = ModalFit(
        residue=residue, remainder=remainder, remainder_power=np.array(powers, float),
        frequency_deviation=moved[0], damping_deviation=moved[1], residue_deviation=moved[2], dof=dof,
        interval_from="none" if deviations is None else "jackknife", frequency=lines,
        measured=curve + noise * np.abs(curve).max() * (error[0] + 1j * error[1]), modelled=curve, synthesised=curve,
        residual=np.zeros(shape), residual_relative=0.0, complex_modes=False, mac=np.eye(count),
        complexity=np.zeros(count), chart_order=np.zeros(0), chart_frequency=np.zeros(0), chart_damping=np.zeros(0),
        chart_stable=np.zeros(0), form=form, outputs=dofs, inputs=dofs, band=band,
    )  # fmt: skip
    return replace(modes, fit=fit)


def lines_of(modes):
    """The FRF that fitted modes stand for."""
    fit = modes.fit
    values = modal_receptance(
        LINES, modes.natural_frequency, modes.damping_ratio, fit.residue, fit.remainder, fit.remainder_power
    )
    return Frf(
        frequency=LINES, values=values, form="receptance", estimator="h1", outputs=fit.outputs, inputs=fit.inputs,
        hits_used=(5,) * len(fit.inputs), usable_band=(fit.band[0] / BEYOND, fit.band[1] * BEYOND),
    )  # fmt: skip


def spread(modes, share, rng, hits=8):
    """Deviations of a leave-one-out fit: each mode's frequency, damping and residue, correlated at random."""
    count = len(modes.natural_frequency)
    residue = residues(modes)
    f = share * 0.2 * modes.natural_frequency * modes.damping_ratio * rng.standard_normal((hits, count))
    zeta = share * modes.damping_ratio * rng.standard_normal((hits, count))
    parts = rng.standard_normal((2, hits, count, 1, 1))
    return tuple(part / np.sqrt(hits) for part in (f, zeta, share * residue * (parts[0] + 0.3j * parts[1])))


def codes(found):
    return {notice.code for notice in found.notices}


def test_fitted_modes_with_the_constants_of_modes_by_hand_give_their_map():
    exact, found = (map_stability(modes, (KTC, KRC), **CUT, points=200) for modes in (BY_HAND, fitted()))
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-10)
    np.testing.assert_allclose(found.chatter_frequency, exact.chatter_frequency, rtol=1e-10)
    assert found.absolute_minimum == pytest.approx(exact.absolute_minimum, rel=1e-10)
    assert found.limit_low is None


def test_one_fitted_mode_has_the_limit_and_the_minimum_of_the_closed_form():
    """2 k zeta (1 + zeta) / |A| at f_n sqrt(1 + 2 zeta), and every lobe about it."""
    mode = Mode(500.0, 0.03, 8e6, "x")
    one = Modes(natural_frequency=[500.0], damping_ratio=[0.03], stiffness=[8e6], axes=("x",))
    found = map_stability(
        fitted(one, residue=residues(one)[:, :1, :1], dofs=("tipX",)),
        (KTC, KRC),
        **CUT,
        points=50,
        rigid="y",
        method="zoa",
    )
    cutting = mean_cutting_matrix(KTC, KRC, teeth=2, entry=np.pi / 2, leave=np.pi)
    np.testing.assert_allclose(
        found.limit_depth, limit_of_one_mode(found.spindle_speed, mode, cutting, 2).depth, rtol=1e-10
    )
    depth, frequency = minimum_of_one_mode(mode, cutting)
    assert found.absolute_minimum == pytest.approx(depth, rel=1e-9)
    assert found.absolute_minimum_frequency == pytest.approx(frequency, rel=1e-6)


@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize("phase", [0.0, 0.1])
def test_the_lines_that_modes_stand_for_give_the_map_of_the_modes(turn, phase):
    """Modes across the axes, modes out of phase, and a remainder: 1e-5 is the spline between the lines."""
    remainder = 1e-9 * np.array([np.diag([-4e5, -1e5]), np.diag([9.0, 7.0])])
    modes = fitted(
        residue=residues(BY_HAND, turn) * np.exp(1j * phase), remainder=remainder, powers=(-2, 0), band=(150.0, 2200.0)
    )
    by_modes, by_lines = (map_stability(d, (KTC, KRC), **CUT, points=100) for d in (modes, lines_of(modes)))
    np.testing.assert_allclose(by_modes.limit_depth, by_lines.limit_depth, rtol=1e-5)
    assert by_modes.absolute_minimum == pytest.approx(by_lines.absolute_minimum, rel=1e-6)


def test_with_a_remainder_chatter_is_looked_for_in_the_band_and_a_little_beyond():
    remainder = 1e-9 * np.diag([5.0, 5.0])[None]
    wide, narrow = (
        map_stability(fitted(remainder=remainder, powers=(0,), band=band), (KTC, KRC), **CUT, points=200, method="zoa")
        for band in ((100.0, 2400.0), (300.0, 500.0))
    )
    assert "band-limited" in codes(narrow)
    chatter = narrow.chatter_frequency[np.isfinite(narrow.chatter_frequency)]
    assert 500.0 < chatter.max() <= 500.0 * BEYOND
    assert chatter.min() >= 300.0 / BEYOND
    assert np.all(narrow.limit_depth >= wide.limit_depth * (1 - 1e-9))


def test_the_band_is_that_of_every_draw_of_modes_solved_by_itself():
    """Drawn here by their covariance, from its root, against the draws along the deviations."""
    rng = np.random.default_rng(4)
    deviations = spread(BY_HAND, 0.04, rng)
    modes = fitted(deviations=deviations, dof=np.inf)
    found = map_stability(modes, (KTC, KRC), **CUT, points=10, members=250, rng=rng)
    flat = np.concatenate(
        [*deviations[:2], *(part(deviations[2]).reshape(8, -1) for part in (np.real, np.imag))], axis=1
    )
    values, vectors = np.linalg.eigh(flat.T @ flat)
    draws = rng.standard_normal((250, flat.shape[1])) * np.sqrt(np.maximum(values, 0)) @ vectors.T
    each = []
    for draw in draws:
        df, dz, da, db = np.split(draw, [4, 8, 24])
        moved = replace(
            BY_HAND, natural_frequency=BY_HAND.natural_frequency + df, damping_ratio=BY_HAND.damping_ratio + dz
        )
        drawn = fitted(moved, residue=modes.fit.residue + (da + 1j * db).reshape(4, 2, 2))
        each.append(map_stability(drawn, (KTC, KRC), **CUT, points=10, members=0).limit_depth)
    low, high = np.quantile(each, [0.025, 0.975], axis=0)
    width = high - low
    assert np.max(np.abs(found.limit_low - low) / width) < 0.25  # both are quantiles of 250 draws
    assert np.max(np.abs(found.limit_high - high) / width) < 0.25
    assert np.mean((found.limit_low - low) / width) == pytest.approx(0, abs=0.1)
    assert np.mean((found.limit_high - high) / width) == pytest.approx(0, abs=0.1)


def known_coefficients(sd):
    from millcal.data import Posterior

    mean, spread = np.array([KTC, KRC]), np.array([KTC, KRC]) * sd
    return Posterior(
        names=("Ktc", "Krc"), units=("N/m^2",) * 2, mean=mean, covariance=np.diag(spread**2),
        interval=np.stack([mean - 2 * spread, mean + 2 * spread], axis=1), law="linear-edge", method="average",
    )  # fmt: skip


def test_the_band_carries_both_modes_and_coefficients():
    """Together they are as wide as the root of the sum of squares."""
    modes = fitted(deviations=spread(BY_HAND, 0.04, np.random.default_rng(1)), dof=np.inf)
    widths = []
    for dynamics, known in (
        (modes, (KTC, KRC)),
        (BY_HAND, known_coefficients(0.04)),
        (modes, known_coefficients(0.04)),
    ):
        found = map_stability(dynamics, known, **CUT, points=60, rng=np.random.default_rng(2))
        widths.append(np.median((found.limit_high - found.limit_low) / found.limit_depth))
    assert widths[2] == pytest.approx(np.hypot(*widths[:2]), rel=0.12)


def test_few_hits_behind_the_modes_make_the_band_wider_by_students_factor():
    """Three degrees of freedom: 3.18 instead of 1.96 standard errors."""
    deviations = spread(BY_HAND, 0.01, np.random.default_rng(1))
    widths = []
    for dof in (np.inf, 3.0):
        found = map_stability(
            fitted(deviations=deviations, dof=dof), (KTC, KRC), **CUT, points=40, rng=np.random.default_rng(0)
        )
        widths.append(np.median(found.limit_high - found.limit_low))
    assert widths[1] / widths[0] == pytest.approx(3.18 / 1.96, rel=0.15)


def test_modes_without_an_interval_give_a_line_and_say_so():
    for modes in (fitted(), fitted(deviations=tuple(d * np.nan for d in spread(BY_HAND, 1, np.random.default_rng(0))))):
        found = map_stability(modes, (KTC, KRC), **CUT, points=10, rng=np.random.default_rng(0))
        assert found.limit_low is None
        assert "no-band" in codes(found)


@pytest.mark.parametrize("seeds", [20, pytest.param(150, marks=pytest.mark.long)])
def test_estimates_scattered_as_their_deviations_say_cover_the_true_limit_at_the_stated_rate(seeds):
    """The deviations are a sample of as many draws as there are degrees of freedom, as leaving hits out gives them."""
    truth = map_stability(BY_HAND, (KTC, KRC), **CUT, points=6).limit_depth
    inside = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        unit = [d * np.sqrt(8) for d in spread(BY_HAND, 0.03, np.random.default_rng(99))]  # columns of a root
        df, dz, da = (np.tensordot(rng.standard_normal((9, 8)) / np.sqrt(8), part, 1) for part in unit)
        deviations = tuple(d[1:] / np.sqrt(8) for d in (df, dz, da))
        modes = replace(
            BY_HAND, natural_frequency=BY_HAND.natural_frequency + df[0], damping_ratio=BY_HAND.damping_ratio + dz[0]
        )
        modes = fitted(modes, residue=residues(BY_HAND) + da[0], deviations=deviations, dof=8.0)
        found = map_stability(modes, (KTC, KRC), **CUT, points=6, members=100, rng=rng)
        inside.append((found.limit_low <= truth) & (truth <= found.limit_high))
    assert 0.95 - 3 * np.sqrt(0.05 * 0.95 / seeds) - 0.02 < np.mean(inside) < 0.995


def test_a_response_counted_the_other_way_is_the_same_structure():
    modes = fitted()
    sign = np.array([-1.0, 1.0])
    turned = replace(modes.fit, residue=modes.fit.residue * sign[:, None], outputs=("-tipX", "tipY"))
    first, second = (
        map_stability(m, (KTC, KRC), **CUT, points=30).limit_depth for m in (modes, replace(modes, fit=turned))
    )
    np.testing.assert_array_equal(first, second)


def test_modes_that_give_power_to_the_hammer_are_refused():
    modes = fitted()
    wrong = replace(modes, fit=replace(modes.fit, residue=-modes.fit.residue))
    with pytest.raises(IllPosedError, match=r"modes tipX/tipX: Im of the receptance is positive"):
        map_stability(wrong, (KTC, KRC), **CUT)


def test_modes_of_another_point_or_another_axis_are_refused():
    modes = fitted()
    with pytest.raises(IllPosedError, match="no point is both hit and measured"):
        map_stability(replace(modes, fit=replace(modes.fit, outputs=("shankX", "shankY"))), (KTC, KRC), **CUT)
    only_x = fitted(residue=residues(BY_HAND)[:, :1, :1], dofs=("tipX",))
    with pytest.raises(IllPosedError, match="nothing along y"):
        map_stability(only_x, (KTC, KRC), **CUT)


def test_a_cross_receptance_that_was_not_measured_is_taken_as_zero_and_told():
    modes = fitted()
    residue = modes.fit.residue.copy()
    residue[:, 0, 1] = np.nan
    found = map_stability(replace(modes, fit=replace(modes.fit, residue=residue)), (KTC, KRC), **CUT, points=20)
    exact = map_stability(modes, (KTC, KRC), **CUT, points=20)
    assert "cross-terms" in codes(found)
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-12)


def test_where_the_fit_is_noise_at_low_frequency_it_makes_no_lobes():
    """A tenth of a percent of the accelerance is, over w^2, more than all modes at 10 Hz."""
    remainder = np.diag([-2e-3, -2e-3])[None]  # what noise may leave of the modes below the band
    options = {"remainder": remainder, "powers": (-2,), "band": (5.0, 2400.0)}
    noisy = map_stability(fitted(**options, noise=1e-3), (KTC, KRC), **CUT, points=100)
    exact = map_stability(BY_HAND, (KTC, KRC), **CUT, points=100)
    assert "low-frequency-noise" in codes(noisy)
    np.testing.assert_allclose(noisy.limit_depth, exact.limit_depth, rtol=0.01)


def test_what_the_modes_lack_is_told_and_noise_is_not():
    """A twentieth more of the FRF at one mode, against noise of the same size."""
    noisy = fitted(noise=0.01)
    lacking = fitted()
    curve = lacking.fit.modelled * np.where(lacking.fit.frequency > 1000, 1.05, 1.0)[:, None, None]
    lacking = replace(lacking, fit=replace(lacking.fit, measured=curve))
    assert "modes-misfit" not in codes(map_stability(noisy, (KTC, KRC), **CUT, points=10))
    found = map_stability(lacking, (KTC, KRC), **CUT, points=10)
    told = [notice.message for notice in found.notices if notice.code == "modes-misfit"]
    assert len(told) == 2
    assert all(re.search(r"miss [345]% of what", message) for message in told)


def test_an_frf_with_an_exponential_window_is_refused_and_a_truncated_one_is_told():
    frf = lines_of(fitted())
    with pytest.raises(IllPosedError, match=r"exponential window added 30 1/s of damping .*millcal modes"):
        map_stability(replace(frf, damping_shift=30.0), (KTC, KRC), **CUT)
    cut_off = replace(frf, notices=(Notice("truncated", "still 20 %", "tap.h5"),))
    assert "truncated" in codes(map_stability(cut_off, (KTC, KRC), **CUT, points=10))
    assert "truncated" not in codes(map_stability(frf, (KTC, KRC), **CUT, points=10))


def test_an_frf_that_nothing_has_bent_is_mapped_as_it_is():
    modes = fitted()
    assert advise(lines_of(modes), modes) == ("frf", "")
    assert advise(lines_of(modes), BY_HAND) == ("frf", "")


def test_what_the_records_ends_took_away_decides_between_the_corrected_frf_and_its_modes():
    """Against the noise whether anything has to be done, against what the fit leaves what."""
    modes, rng = fitted(), np.random.default_rng(0)
    size = np.abs(modes.fit.measured)
    frf = replace(
        lines_of(modes), variance=np.full((len(LINES), 2, 2), (1e-4 * size.max() / (2 * np.pi * 1000) ** 2) ** 2)
    )
    lost = 1e-2 * size * np.exp(2j * np.pi * rng.random(size.shape))
    for left, advised in ((1e-3, "modes"), (1e-1, "corrected")):
        misfit = left * size * np.exp(2j * np.pi * rng.random(size.shape))
        fit = replace(modes.fit, modelled=modes.fit.synthesised - lost, measured=modes.fit.synthesised - lost + misfit)
        advice = advise(frf, replace(modes, fit=fit))
        assert advice.dynamics == advised
        assert "before the structure came to rest" in advice.why
    hidden = replace(modes.fit, modelled=modes.fit.synthesised - 1e-6 * lost)
    assert advise(frf, replace(modes, fit=hidden)) == ("modes", "the modes describe the FRF to within its noise")
    missed = replace(hidden, measured=modes.fit.measured + misfit)
    assert advise(frf, replace(modes, fit=missed)) == ("frf", "")
    assert "exponential window" in advise(replace(frf, damping_shift=20.0), modes).why


def test_lines_too_far_apart_for_a_curve_are_told_with_the_error_and_the_modes_are_advised():
    modes = fitted()
    fine = lines_of(modes)
    every = slice(9, None, 20)  # 20 Hz: 2.5 lines in the width of the mode at 1449 Hz
    coarse = replace(fine, frequency=fine.frequency[every], values=fine.values[every])
    assert advise(coarse, modes).dynamics == "modes"
    exact, found = (map_stability(frf, (KTC, KRC), **CUT, points=200) for frf in (fine, coarse))
    assert "coarse-lines" not in codes(exact)
    (told,) = (n.message for n in found.notices if n.code == "coarse-lines" and n.where.endswith("tipX"))
    share = float(re.search(r"off by some ([\d.]+)%", told).group(1)) / 100
    assert share / 3 < abs(found.absolute_minimum / exact.absolute_minimum - 1) < 3 * share


MACHINE = (
    ShapedMode(310.0, 0.045, 9e7, (("tipX", 1.15), ("tipY", 0.1))),
    ShapedMode(850.0, 0.035, 8.5e7, (("tipY", 1.0), ("tipX", 0.06))),
    ShapedMode(1450.0, 0.025, 4.4e7, (("tipX", 1.0), ("tipY", -0.04))),
    ShapedMode(1530.0, 0.022, 4.2e7, (("tipX", 0.04), ("tipY", 1.0))),
)
SLOT = {**CUT, "diameter": 16e-3, "radial_depth": 16e-3, "direction": "slot", "points": 25}


def of_machine():
    """The modes of the machine without any error."""
    w = 2 * np.pi * np.array([mode.natural_frequency for mode in MACHINE])
    zeta = np.array([mode.damping_ratio for mode in MACHINE])
    alpha = (
        np.array([np.outer(mode.at(DOFS), mode.at(DOFS)) / mode.stiffness for mode in MACHINE]) * w[:, None, None] ** 2
    )
    known = Modes(
        natural_frequency=w / (2 * np.pi),
        damping_ratio=zeta,
        stiffness=[mode.stiffness for mode in MACHINE],
        axes=tuple("xyxy"),
    )
    return fitted(known, residue=alpha / (2j * w * np.sqrt(1 - zeta**2))[:, None, None])


@pytest.mark.long
@pytest.mark.parametrize(
    ("hits", "record", "noise"),
    [(8, 0.16, (0.3, 0.3)), (5, 0.16, (0.3, 1.0)), (6, 0.04, (0.1, 0.1)), (5, 0.025, (0.3, 0.3))],
    ids=["eight hits", "five noisy hits", "records cut short", "records of three time constants"],
)
def test_from_noisy_hits_by_way_of_modes_the_band_holds_the_true_limit(hits, record, noise):
    """Errors of the speeds go together, so that 50 seeds are worth little more than 50 trials: 0.90 is 1.6 sigma."""
    truth = map_stability(of_machine(), (820e6, 260e6), **SLOT).limit_depth
    inside, error = [], []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        chains = {
            name: MeasuringChain(noise=n) for name, n in zip(("hammer_chain", "accelerometer"), noise, strict=True)
        }
        taps = [
            simulate_impact(
                MACHINE, rng=rng, hammer=dof, accelerometers=DOFS, sample_rate=25_600.0, hits=hits, record=record,
                peak=290.0, pulse=2.5e-4, pretrigger=0.008, onset_jitter=5e-4, name=dof, **chains,
            )[0]
            for dof in DOFS
        ]  # fmt: skip
        found = map_stability(fit_modes(estimate_frf(taps)), (820e6, 260e6), **SLOT, members=400, rng=rng)
        inside.append((found.limit_low <= truth) & (truth <= found.limit_high))
        error.append(np.median(np.abs(found.limit_depth / truth - 1)))
    print(f"\n{hits} hits, {record} s: {np.mean(inside):.3f} of the limits held, median error {np.median(error):.1e}")
    assert 0.90 <= np.mean(inside) < 0.995
    assert np.median(error) < 1e-3
