"""The fit of the force within the revolution: exact without noise, honest with it, and its verdict earned."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.coefficients.harmonic import study
from millcal.stages.coefficients.harmonic_model import (
    HarmonicFit,
    model_of,
    noise_covariance,
    problem,
    refine,
    scan_phases,
)

LAW = LinearEdge(cutting=np.array([800e6, 300e6, 150e6]), edge=np.array([20e3, 22e3, 6e3]))
TRUTH = np.concatenate([LAW.cutting, LAW.edge])
FEEDS = (0.04, 0.06, 0.08, 0.1, 0.12)


def two_teeth(runout: float = 0.0) -> Cutter:
    """Two teeth whose offset stands on tooth 0 at mid depth of 3 mm, where c0 is the whole runout."""
    lag = 1.5e-3 * np.tan(0.5) / 12.5e-3
    return Cutter(diameter=25e-3, teeth=2, helix=0.5, runout=runout, runout_angle=-lag)


CUTTERS = {
    "two teeth": two_teeth(),
    "two teeth with runout": two_teeth(8e-6),
    "two teeth that lose contact": two_teeth(18e-6),
    "three teeth with runout": Cutter(diameter=16e-3, teeth=3, helix=0.5, runout=10e-6, runout_angle=0.7),
    "four unequal teeth with runout": Cutter(
        diameter=16e-3,
        teeth=4,
        helix=0.6,
        pitch=tuple(np.radians([84.0, 96.0, 86.0, 94.0])),
        runout=7e-6,
        runout_angle=-2.0,
    ),
}
BARE = {name: replace(cutter, runout=0.0, runout_angle=0.0) for name, cutter in CUTTERS.items()}


def unlabelled(cuts):
    """The same cuts with a cutter whose runout nobody knows."""
    return tuple(replace(cut, cutter=replace(cut.cutter, runout=0.0, runout_angle=0.0)) for cut in cuts)


@pytest.mark.parametrize("name", CUTTERS)
@pytest.mark.parametrize(("direction", "radial"), [("slot", None), ("down", 4e-3)])
def test_without_noise_the_coefficients_come_back_to_a_millionth(series, name, direction, radial):
    cuts = unlabelled(series(LAW, CUTTERS[name], FEEDS, direction=direction, radial=radial))
    model = model_of(cuts, law="linear-edge", band=max(2, cuts[0].cutter.teeth), mean_weight=5.0)
    found = study(model)
    assert found.best.linear == pytest.approx(TRUTH, rel=1e-6)
    assert np.linalg.norm(found.best.shape) == pytest.approx(CUTTERS[name].runout, abs=2e-10)
    assert found.predicted == pytest.approx(np.zeros(3), abs=1e-5)


@pytest.mark.parametrize("name", ["two teeth with runout", "three teeth with runout"])
def test_without_noise_kienzle_comes_back_to_a_millionth(series, name):
    law = Kienzle(specific_force=np.array([700e6, 250e6, 120e6]), rise=np.array([0.25, 0.45, 0.35]))
    cuts = unlabelled(series(law, CUTTERS[name], FEEDS))
    found = study(model_of(cuts, law="kienzle", band=cuts[0].cutter.teeth, mean_weight=5.0))
    assert found.best.linear == pytest.approx(law.specific_force, rel=1e-6)
    assert found.best.shape[-3:] == pytest.approx(law.rise, rel=1e-6)


def test_the_whole_answer_of_a_clean_series_fits_and_says_so(series):
    cuts = unlabelled(series(LAW, CUTTERS["two teeth with runout"], FEEDS, scatter=0.2, seed=5))
    found = fit_coefficients(cuts)
    assert found.verdict == "fits", found.checks
    assert found.posterior.names == ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae", "c0")
    assert np.all(found.left_out < 0.03)
    assert found.measured == pytest.approx(found.modelled, abs=5.0)


def test_a_pulse_makes_one_phase_serve_all_cuts(series):
    cuts = series(LAW, CUTTERS["three teeth with runout"], FEEDS)
    order = np.arange(cuts[0].harmonics.shape[1])
    shifted = []
    for number, cut in enumerate(cuts):  # undo each record's own angle, add one for all
        own = np.random.default_rng(0).uniform(0, 2 * np.pi, number + 1)[number]
        shifted.append(replace(cut, harmonics=cut.harmonics * np.exp(1j * order * (1.1 - own)), phase_from_pulse=True))
    found = fit_coefficients(unlabelled(shifted))
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=1e-5)
    assert np.ptp(found.phase) == 0.0
    assert "tooth-label" not in {notice.code for notice in found.notices}


def test_tooth_labels_of_two_equal_teeth_change_nothing_but_the_sign_of_c0(series):
    cuts = unlabelled(series(LAW, CUTTERS["two teeth with runout"], FEEDS))
    model = model_of(cuts, law="linear-edge", band=4, mean_weight=1.0)
    fit = study(model).best
    ask = problem(model)
    other = np.concatenate([-fit.shape, fit.phase + np.pi])
    here = np.concatenate([fit.shape, fit.phase])
    assert ask.matrix(other) @ fit.linear == pytest.approx(ask.matrix(here) @ fit.linear, rel=1e-9, abs=1e-9)


def test_slopes_of_the_model_are_those_of_differences(series):
    cuts = unlabelled(series(LAW, CUTTERS["three teeth with runout"], FEEDS[:3]))
    model = model_of(cuts, law="kienzle", band=4, mean_weight=2.0, taper=True, sensor_modes=(900.0, 800.0, 950.0))
    ask = problem(model)
    p = np.concatenate(
        [[6e-6, 3e-6, -4e-6, 0.2, 0.3, 0.4], [900.0, 800.0, 950.0], [0.05] * 3, [1.0, 0.9, 1.1], [0.3, 1.0, 2.0]]
    )
    q = np.array([7e8, 3e8, 1e8])
    slope = ask.derivative(p, q)
    for i in range(len(p)):
        step = np.zeros(len(p))
        step[i] = 1e-4 * ask.scale[i]
        central = (ask.matrix(p + step) @ q - ask.matrix(p - step) @ q) / (2 * step[i])
        assert slope[:, i] == pytest.approx(central, rel=1e-3, abs=1e-3 * np.abs(central).max())


def test_the_fit_in_harmonics_is_the_fit_in_time(series):
    """Parseval: the squares over harmonics equal those over the revolution, mean of squares and all."""
    cuts = unlabelled(series(LAW, CUTTERS["two teeth with runout"], FEEDS[:2], scatter=1.0, seed=2))
    model = model_of(cuts, law="linear-edge", band=12, mean_weight=1.0)
    ask = problem(model)
    angle = 2 * np.pi * np.arange(64) / 64
    in_time = sum(
        np.mean(
            (np.real(cut.harmonics @ np.exp(1j * np.outer(np.arange(13), angle))) * model.weight[:, np.newaxis]) ** 2,
            axis=1,
        ).sum()
        for cut in cuts
    )
    assert np.sum(ask.data**2) == pytest.approx(in_time, rel=1e-12)


def test_taper_is_found_where_it_is_and_not_where_it_is_not(series):
    cuts = unlabelled(series(LAW, CUTTERS["two teeth with runout"], FEEDS))
    found = fit_coefficients(cuts, taper=True)
    assert found.posterior["t0"] == pytest.approx(0.0, abs=1e-8)
    # an offset across the teeth winds with the helix: to first order t0 = -rho (tan(helix) a / R) sin(lambda)
    across = replace(CUTTERS["two teeth with runout"], runout=12e-6, runout_angle=0.6)
    lag = float(across.helix_lag(np.array(3e-3)))
    found = fit_coefficients(unlabelled(series(LAW, across, FEEDS)), taper=True)
    assert found.posterior["c0"] == pytest.approx(12e-6 * np.cos(0.6 + lag / 2), rel=5e-3)
    assert found.posterior["t0"] == pytest.approx(-12e-6 * lag * np.sin(0.6 + lag / 2), rel=0.1)


@pytest.mark.parametrize("name", ["two teeth", "two teeth with runout", "three teeth with runout"])
@pytest.mark.parametrize("seeds", [6, pytest.param(120, marks=pytest.mark.long)])
def test_the_intervals_hold_the_truth_about_as_often_as_they_say(series, name, seeds):
    """90 to 99 % of the six coefficients over all seeds, widened by the binomial error of the seeds."""
    inside = []
    for seed in range(seeds):
        cuts = unlabelled(series(LAW, CUTTERS[name], FEEDS, scatter=0.5, seed=500 + seed))
        found = study(model_of(cuts, law="linear-edge", band=cuts[0].cutter.teeth, mean_weight=5.0))
        from millcal.stages.coefficients.instantaneous import _posterior

        interval = _posterior(found, "linear-edge")[0].interval[:6]
        inside.append((interval[:, 0] <= TRUTH) & (interval[:, 1] >= TRUTH))
    share, slack = np.mean(inside), 2 * np.sqrt(0.05 * 0.95 / seeds)
    assert 0.90 - slack <= share <= min(0.99 + slack, 1.0), f"{name}: {np.mean(inside, axis=0)}"


def test_one_cut_gives_the_interval_of_its_own_noise_and_says_how_narrow_it_is(series):
    cuts = unlabelled(series(LAW, CUTTERS["three teeth with runout"], (0.1,), scatter=0.2, seed=1))
    found = fit_coefficients(cuts, harmonics=9)
    assert "narrow-intervals" in {notice.code for notice in found.notices}
    assert found.verdict == "fits in part: too few cuts to test it"
    errors = []
    for seed in range(20):
        again = unlabelled(series(LAW, CUTTERS["three teeth with runout"], (0.1,), scatter=0.2, seed=seed))
        model = model_of(again, law="linear-edge", band=9, mean_weight=5.0)
        start = HarmonicFit(model, np.array([7.6e-6, 6.4e-6]), np.zeros(0), np.zeros(1), TRUTH, np.inf)
        fit = refine(replace(start, phase=scan_phases(start)))
        errors.append((fit.linear - TRUTH) / np.sqrt(np.diag(noise_covariance(fit))[:6]))
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_chatter_offset_and_a_wrong_law_are_each_named_in_the_verdict(series):
    cuts = unlabelled(series(LAW, CUTTERS["two teeth"], FEEDS, scatter=0.2, seed=4))
    loud = [replace(cut, asynchronous_rms=0.3 * cut.ac_rms) for cut in cuts]
    assert "does not follow the spindle" in fit_coefficients(loud).verdict

    def offset(cut):
        harmonics = cut.harmonics.copy()
        harmonics[1, 0] += 40.0
        return replace(cut, harmonics=harmonics)

    assert "contradict" in fit_coefficients([offset(cut) for cut in cuts]).verdict

    def transient(cut):  # grows with the feed, above the tooth passing, in phase with nothing
        harmonics = cut.harmonics.copy()
        harmonics[:2, 4] += 600e3 * cut.conditions.feed_per_tooth
        return replace(cut, harmonics=harmonics)

    found = fit_coefficients([transient(cut) for cut in cuts])
    assert "above the tooth passing" in found.verdict
    assert "transient" in next(check.message for check in found.checks if check.name == "above-tooth-passing")


def test_a_wrong_axis_map_is_named(series):
    def mirrored(cut):
        return replace(cut, harmonics=cut.harmonics[[1, 0, 2]])

    found = fit_coefficients([mirrored(cut) for cut in unlabelled(series(LAW, CUTTERS["two teeth"], FEEDS))])
    assert "axis-swap" in {notice.code for notice in found.notices}
    assert found.verdict != "fits"


def test_no_force_within_the_revolution_is_refused(series):
    with pytest.raises(IllPosedError, match="harmonics"):
        fit_coefficients(series(LAW, CUTTERS["two teeth"], FEEDS), harmonics=0)
