"""Coefficients from mean forces: exact without noise, honest with it, and not deaf to a wrong map or a lost contact."""

import numpy as np
import pytest

from millcal.errors import IllPosedError, RecipeError
from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import LinearEdge
from millcal.stages.coefficients import fit_coefficients

LAW = LinearEdge(cutting=np.array([800e6, 300e6, 150e6]), edge=np.array([20e3, 22e3, 6e3]))
TRUTH = np.concatenate([LAW.cutting, LAW.edge])
TWO = Cutter(diameter=25e-3, teeth=2, helix=0.5)
FOUR = Cutter(diameter=16e-3, teeth=4, helix=0.6, pitch=tuple(np.radians([84.0, 96.0, 86.0, 94.0])))


def two_teeth_with(runout: float) -> Cutter:
    """Two teeth whose offset stands on tooth 0 at mid depth of 3 mm."""
    lag = 1.5e-3 * np.tan(0.5) / 12.5e-3
    return Cutter(diameter=25e-3, teeth=2, helix=0.5, runout=runout, runout_angle=-lag)


@pytest.mark.parametrize("cutter", [TWO, FOUR], ids=["two teeth", "four teeth of unequal pitch"])
@pytest.mark.parametrize(("direction", "radial"), [("slot", None), ("up", 4e-3), ("down", 4e-3)])
def test_without_noise_the_six_coefficients_come_back(series, cutter, direction, radial):
    found = fit_coefficients(series(LAW, cutter, direction=direction, radial=radial), method="average")
    assert found.posterior.mean == pytest.approx(TRUTH, rel=1e-9)
    assert found.r2 == pytest.approx(np.ones(3), abs=1e-12)
    assert found.verdict == "fits"


def test_without_noise_contact_loss_and_coefficients_come_back_together(series):
    cuts = series(LAW, two_teeth_with(9e-6), (0.025, 0.05, 0.075, 0.1, 0.125))
    found = fit_coefficients(cuts, method="average", contact_loss="fit")
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=2e-3)  # the offset winds with the helix, c0 does not
    assert found.posterior["c0"] == pytest.approx(9e-6, rel=2e-3)


def test_contact_loss_is_reported_and_fails_the_verdict_where_the_straight_line_is_asked_for(series):
    cuts = series(LAW, two_teeth_with(9e-6), (0.025, 0.05, 0.075, 0.1, 0.125))
    found = fit_coefficients(cuts, method="average")
    assert "contact-loss" in {notice.code for notice in found.notices}
    assert "contact" in found.verdict
    assert dict(found.alternatives)["with contact loss"] != ()


def test_runout_shares_the_chip_out_and_leaves_the_mean_cutting_force(series):
    """Only the edge part falls: a tooth out of contact has no edge force, but its chip is cut by another."""
    chip_only = LinearEdge(cutting=LAW.cutting, edge=np.zeros(3))
    for runout in (5e-6, 30e-6):
        plain, uneven = (series(chip_only, cutter) for cutter in (TWO, two_teeth_with(runout)))
        for a, b in zip(plain, uneven, strict=True):
            assert b.harmonics[:, 0] == pytest.approx(a.harmonics[:, 0], rel=1e-9)


def test_the_interval_is_that_of_three_straight_lines_in_a_slot(series):
    """Textbook simple regression: half width t(n-2) s / sqrt(sum of squares of the feed), times the slope's factor."""
    from scipy.stats import linregress, t

    cuts = series(LAW, TWO, scatter=0.5, seed=3)
    found = fit_coefficients(cuts, method="average").posterior
    feeds = [cut.conditions.feed_per_tooth for cut in cuts]
    line = linregress(feeds, [cut.harmonics[1, 0].real for cut in cuts])
    factor = 4 / (2 * 3e-3)  # F_y = (N a / 4) Ktc f + ...
    assert found["Ktc"] == pytest.approx(line.slope * factor, rel=1e-9)
    half = (found.interval[0, 1] - found.interval[0, 0]) / 2
    assert half == pytest.approx(t.ppf(0.975, 3) * line.stderr * factor, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "cutter", "feeds", "contact_loss"),
    [
        ("no runout", TWO, (0.04, 0.06, 0.08, 0.1, 0.12), "report"),
        ("runout", two_teeth_with(8e-6), (0.04, 0.06, 0.08, 0.1, 0.12), "fit"),
        ("contact loss", two_teeth_with(12e-6), (0.025, 0.05, 0.075, 0.1, 0.125), "fit"),
    ],
)
@pytest.mark.parametrize("seeds", [15, pytest.param(400, marks=pytest.mark.long)])
def test_the_intervals_hold_the_truth_about_as_often_as_they_say(series, name, cutter, feeds, contact_loss, seeds):
    """90 to 99 % of the six coefficients over all seeds, widened by the binomial error of the seeds."""
    inside = []
    for seed in range(seeds):
        cuts = series(LAW, cutter, feeds, scatter=0.5, seed=1000 + seed)
        interval = fit_coefficients(cuts, method="average", contact_loss=contact_loss).posterior.interval[:6]
        inside.append((interval[:, 0] <= TRUTH) & (interval[:, 1] >= TRUTH))
    share, slack = np.mean(inside), 2 * np.sqrt(0.05 * 0.95 / seeds)
    assert 0.90 - slack <= share <= min(0.99 + slack, 1.0), f"{name}: {np.mean(inside, axis=0)}"


def swapped(cuts, turn):
    from dataclasses import replace

    turned = []
    for cut in cuts:
        harmonics = cut.harmonics.copy()
        harmonics[:2] = np.array(turn) @ cut.harmonics[:2]
        turned.append(replace(cut, harmonics=harmonics))
    return turned


@pytest.mark.parametrize(
    ("turn", "code", "mending"),
    [
        (((0, 1), (1, 0)), "axis-swap", "fx=+(present fy), fy=+(present fx)"),
        (((-1, 0), (0, 1)), "axis-sign", "fx=-(present fx), fy=+(present fy)"),
        (((0, -1), (1, 0)), "axis-swap", "fx=+(present fy), fy=-(present fx)"),
    ],
)
def test_a_wrong_axis_map_is_named_with_its_mending(series, turn, code, mending):
    found = fit_coefficients(swapped(series(LAW, TWO), turn), method="average")
    notice = next(n for n in found.notices if n.code == code)
    assert mending in notice.message
    assert "axis map" in found.verdict


def test_a_swap_in_a_slot_exchanges_ktc_and_krc(series):
    found = fit_coefficients(swapped(series(LAW, TWO), ((0, 1), (1, 0))), method="average").posterior
    assert (-found["Ktc"], -found["Krc"]) == pytest.approx((LAW.cutting[1], LAW.cutting[0]), rel=1e-9)


def test_one_feed_is_refused_and_two_give_no_interval(series):
    with pytest.raises(IllPosedError, match="one feed per tooth"):
        fit_coefficients(series(LAW, TWO, (0.1, 0.1)), method="average")
    found = fit_coefficients(series(LAW, TWO, (0.05, 0.1)), method="average")
    assert found.posterior.mean == pytest.approx(TRUTH, rel=1e-9)
    assert not np.isfinite(found.posterior.interval).any()
    assert "two-cuts" in {notice.code for notice in found.notices}


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"method": "guess"}, "coefficients.method"),
        ({"method": "average", "law": "kienzle"}, "coefficients.law"),
        ({"method": "average", "rows": "some"}, "coefficients.rows"),
        ({"method": "average", "contact_loss": "maybe"}, "coefficients.contact_loss"),
        ({"method": "average", "taper": True}, "coefficients.taper: True goes with method nls"),
        ({"method": "average", "harmonics": 4}, "coefficients.harmonics"),
        ({"method": "nls", "contact_loss": "fit"}, "coefficients.contact_loss: 'fit' goes with method average"),
        ({"method": "nls", "rows": "all"}, "coefficients.rows"),
    ],
)
def test_an_unknown_option_is_refused_by_its_key(series, options, key):
    with pytest.raises(RecipeError, match=key):
        fit_coefficients(series(LAW, TWO), **options)


def test_cuts_of_different_cutters_are_refused(series):
    with pytest.raises(IllPosedError, match="different cutters"):
        fit_coefficients([*series(LAW, TWO, (0.05,)), *series(LAW, FOUR, (0.1,))], method="average")
