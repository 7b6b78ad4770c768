"""Series of cuts that are right but unusual: what cannot be seen is not compared, what was not tested is not praised."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import LinearEdge
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.coefficients.average import search_contact_loss

LAW = LinearEdge(cutting=np.array([800e6, 300e6, 150e6]), edge=np.array([20e3, 22e3, 6e3]))
TRUTH = np.concatenate([LAW.cutting, LAW.edge])
TWO = Cutter(diameter=16e-3, teeth=2, helix=0.5)


def check(found, name):
    return next(check for check in found.checks if check.name == name)


@pytest.mark.parametrize("teeth", [4, pytest.param(6, marks=pytest.mark.long)])
def test_in_a_slot_with_many_teeth_the_chip_does_not_alternate_and_the_means_decide(series, teeth):
    """sum over teeth of sin^2 is constant for N >= 3: only the edge force is in the harmonics, so Ktc is not compared."""
    cutter = Cutter(diameter=16e-3, teeth=teeth, helix=0.5)
    found = fit_coefficients(series(LAW, cutter, scatter=0.2, seed=1))
    assert check(found, "offset").passed
    assert "not tested" in check(found, "offset").message
    assert "alternating force alone" not in dict(found.alternatives)
    assert found.posterior["Ktc"] == pytest.approx(800e6, rel=0.05)


def test_an_axis_without_force_neither_steers_the_fit_nor_fails_it(series):
    flat = LinearEdge(cutting=np.array([800e6, 300e6, 0.0]), edge=np.array([20e3, 22e3, 0.0]))
    found = fit_coefficients(series(flat, TWO, scatter=0.2, seed=3))
    assert found.verdict == "fits", found.checks
    assert found.posterior["Ktc"] == pytest.approx(800e6, rel=0.02)
    assert np.all(np.isfinite(found.left_out))


@pytest.mark.parametrize("method", ["average", "nls"])
def test_repeated_feeds_are_as_good_as_others(series, method):
    found = fit_coefficients(series(LAW, TWO, (0.04, 0.04, 0.12, 0.12), scatter=0.1, seed=2), method=method)
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=0.1)


def test_two_cuts_are_not_called_a_fit(series):
    for method in ("average", "nls"):
        found = fit_coefficients(series(LAW, TWO, (0.05, 0.1), scatter=0.1, seed=2), method=method)
        assert found.verdict == "fits in part: too few cuts to test it"


def test_contact_loss_cannot_be_fitted_to_two_cuts(series):
    with pytest.raises(IllPosedError, match="three cuts"):
        fit_coefficients(series(LAW, TWO, (0.05, 0.1)), method="average", contact_loss="fit")


def test_runout_that_hides_in_the_straight_line_shows_in_the_once_per_revolution_line(series):
    worn = replace(TWO, runout=14e-6)
    cuts = [replace(cut, cutter=TWO) for cut in series(LAW, worn, (0.05, 0.055, 0.06), scatter=0.3, seed=4)]
    found = fit_coefficients(cuts, method="average", contact_loss="off")
    assert not check(found, "contact-loss").passed


def test_quiet_records_have_an_interval_of_c0_too(series):
    """The profile is followed to its ends, however narrow it is."""
    worn = replace(TWO, runout=12e-6, runout_angle=-1.5e-3 * np.tan(0.5) / 8e-3)
    inside = []
    for seed in range(8):
        cuts = [replace(cut, cutter=TWO) for cut in series(LAW, worn, scatter=0.02, seed=seed)]
        fit, _ = search_contact_loss(cuts, np.stack([cut.harmonics[:, 0].real for cut in cuts]))
        low, high = fit.interval[6]
        assert high > low
        inside.append((fit.interval[:6, 0] <= TRUTH) & (fit.interval[:6, 1] >= TRUTH))
    assert np.mean(inside) > 0.8


def test_cuts_of_different_immersion_at_one_feed_determine_the_mean_force(series):
    cuts = [
        *series(LAW, TWO, (0.08,), direction="slot"),
        *series(LAW, TWO, (0.08,), direction="down", radial=5e-3),
        *series(LAW, TWO, (0.08,), direction="up", radial=5e-3),
    ]
    assert fit_coefficients(cuts, method="average").posterior.mean == pytest.approx(TRUTH, rel=1e-6)


def test_a_helix_that_winds_far_shows_both_parts_of_the_runout_of_two_teeth(series):
    deep = Cutter(diameter=10e-3, teeth=2, helix=0.7, runout=10e-6, runout_angle=1.2)
    cuts = [replace(cut, cutter=replace(deep, runout=0.0, runout_angle=0.0)) for cut in series(LAW, deep, depth=8e-3)]
    found = fit_coefficients(cuts)
    assert found.posterior.names[-2:] == ("c0", "s0")
    assert np.hypot(found.posterior["c0"], found.posterior["s0"]) == pytest.approx(10e-6, rel=1e-3)
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=1e-4)


def test_one_tooth_has_no_runout_to_taper(series):
    with pytest.raises(IllPosedError, match="one tooth"):
        fit_coefficients(series(LAW, Cutter(diameter=16e-3, teeth=1)), taper=True)
