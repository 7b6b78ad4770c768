"""Without noise the force and the coefficients come back: any cutter, any engagement, any naming, and what cannot is named."""

from dataclasses import replace

import numpy as np
import pytest
from accelerometer_cuts import LAW, SENSORS, TIP, exact_frf, heard_cut, slot, structure

from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import force_harmonics
from millcal.stages.coefficients.from_forces import coefficients_of_forces
from millcal.stages.forces import reconstruct_forces
from millcal.stages.forces.methods import NAMES as METHODS

TRUTH = dict(zip(("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"), (*LAW.cutting, *LAW.edge), strict=True))
LINES = np.arange(4.0, 1600.0, 0.5)
D = 20e-3


def engagement(direction, radial_depth=6e-3, tooth_passing=78.0, teeth=2):
    return CuttingConditions(2 * np.pi * tooth_passing / teeth, 0.15e-3, 2e-3, radial_depth, direction)


CASES = {  # cutter, conditions
    "slot, two teeth": (Cutter(D, 2), slot(78.0)),
    "slot, two teeth, helix": (Cutter(D, 2, helix=0.5), slot(78.0)),
    "slot, three teeth": (Cutter(D, 3), engagement("slot", D, teeth=3)),
    "up, one tooth": (Cutter(D, 1), engagement("up", teeth=1)),
    "up, three teeth, helix": (Cutter(D, 3, helix=0.6), engagement("up", teeth=3)),
    "down, four teeth": (Cutter(D, 4, helix=0.5), engagement("down", teeth=4)),
    "down, six teeth, helix": (Cutter(D, 6, helix=0.5), engagement("down", 2e-3, teeth=6)),
    "up, unequal pitch": (
        Cutter(D, 4, helix=0.5, pitch=tuple(np.radians([80, 100, 85, 95]))), engagement("up", teeth=4)
    ),
    "down, unequal pitch and runout": (
        Cutter(D, 3, helix=0.5, pitch=tuple(np.radians([110, 125, 125])), runout=8e-6, runout_angle=1.0),
        engagement("down", teeth=3),
    ),
}  # fmt: skip


def heard(cutter, conditions, *, of=None, **options):
    options = {"noise": 0.0, "harmonics": 6 * cutter.teeth, "told": cutter} | options
    return heard_cut(of or structure(2012), conditions, np.random.default_rng(0), cutter=cutter, **options)


def assert_right(found, tolerance=1e-3):
    """The tolerance is what splines between the FRF's lines and rounding leave."""
    for name, value in zip(found.posterior.names, found.posterior.mean, strict=True):
        assert value == pytest.approx(TRUTH[name], rel=tolerance), name
    assert found.verdict == "fits"
    assert np.all(np.isfinite(found.posterior.covariance))


@pytest.mark.parametrize("case", CASES)
def test_any_cutter_and_engagement_gives_its_coefficients_back(case):
    cutter, conditions = CASES[case]
    found = reconstruct_forces([heard(cutter, conditions)], exact_frf(structure(2012), LINES))
    assert {"Ktc", "Krc", "Kte", "Kre"} <= set(found.posterior.names)
    assert_right(found)
    true = force_harmonics(LAW, cutter, conditions, int(found.order.max()))[:, found.order]
    size = np.abs(true).max()
    assert np.abs(found.force - true.T).max() < 1e-3 * size
    assert np.abs(found.free_force - true.T).max() < 1e-2 * size
    for axis, row in zip(found.axes, found.law_force[0], strict=True):
        if np.isfinite(row).all():
            mean = force_harmonics(LAW, cutter, conditions, 0)["xyz".index(axis), 0].real
            assert row.mean() == pytest.approx(mean, rel=2e-3, abs=1e-3 * size)


@pytest.mark.parametrize(("source", "phase"), [("speed", 0.4), ("pulse", -1.1), ("encoder", 2.9)])
@pytest.mark.parametrize("case", ["slot, two teeth", "down, four teeth", "up, unequal pitch"])
def test_an_angle_that_nobody_knows_is_found(case, source, phase):
    cutter, conditions = CASES[case]
    found = reconstruct_forces(
        [heard(cutter, conditions, phase=phase, angle_from=source)], exact_frf(structure(2012), LINES)
    )
    assert_right(found, 5e-3)
    period = 2 * np.pi / (1 if cutter.pitch else cutter.teeth)
    off = found.phase[0] - phase
    assert off - period * np.round(off / period) == pytest.approx(0.0, abs=np.radians(0.2))
    assert found.phase_from == "fitted"
    if cutter.pitch is None:
        assert abs(found.phase[0]) <= period / 2 + 1e-9


def test_a_stated_angle_is_believed_with_an_error_and_the_force_is_counted_from_tooth_0():
    cutter, conditions = CASES["slot, two teeth"]
    off = np.radians(2.0)
    found = reconstruct_forces([heard(cutter, conditions, phase_error=off)], exact_frf(structure(2012), LINES))
    true = force_harmonics(LAW, cutter, conditions, int(found.order.max()))[:, found.order].T
    assert found.phase[0] == pytest.approx(-off, abs=np.radians(0.1))
    assert np.abs(found.force - true).max() < 5e-3 * np.abs(true).max()


@pytest.mark.parametrize("teeth", [2, 3, 4])
def test_runout_is_found_and_the_coefficients_are_right_with_it(teeth):
    """Two teeth without helix show c0 alone: what their s0 does is nothing. More teeth show both."""
    cutter = Cutter(D, teeth, runout=9e-6, runout_angle=0.6)
    conditions = engagement("up", teeth=teeth)
    cut = heard(cutter, conditions, told=Cutter(D, teeth))
    found = reconstruct_forces([cut], exact_frf(structure(2012), LINES))
    assert_right(found, 0.01)
    assert found.runout[0] == pytest.approx(9e-6 * np.cos(0.6), abs=0.2e-6)
    if teeth > 2:
        assert found.runout[1] == pytest.approx(9e-6 * np.sin(0.6), abs=0.2e-6)
    else:
        assert found.runout_sd[1] > 10e-6
    assert "runout-fitted" in {notice.code for notice in found.notices}


@pytest.mark.parametrize("case", ["slot, three teeth", "up, unequal pitch"])
def test_runout_that_is_not_seen_is_not_fitted(case):
    """Teeth at unequal pitch have all harmonics of the spindle without any runout."""
    found = reconstruct_forces([heard(*CASES[case])], exact_frf(structure(2012), LINES))
    assert found.runout is None
    assert found.runout_sd is None


def test_four_teeth_in_a_slot_do_not_tell_the_cutting_coefficients_by_name():
    cutter = Cutter(D, 4)
    found = reconstruct_forces([heard(cutter, engagement("slot", D, teeth=4))], exact_frf(structure(2012), LINES))
    assert not {"Ktc", "Krc"} & set(found.posterior.names)
    assert {"Ktc", "Krc"} <= {name for group in found.unobservable for name in group}
    assert found.verdict.startswith("fits in part: Ktc and Krc give no alternating force")
    assert found.law_force is None or np.isnan(found.law_force[0, 0]).all()
    for name, value in zip(found.posterior.names, found.posterior.mean, strict=True):
        assert value == pytest.approx(TRUTH[name], rel=1e-3)
    coefficients = coefficients_of_forces(found)
    assert coefficients.posterior.names == found.posterior.names
    assert coefficients.verdict == found.verdict
    assert np.isfinite(coefficients.residual_rms).all()


def test_forces_along_two_axes_are_enough_and_say_nothing_of_the_third():
    frf = exact_frf(structure(2012), LINES, TIP[:2])
    law = replace(LAW, cutting=LAW.cutting * [1, 1, 0], edge=LAW.edge * [1, 1, 0])
    found = reconstruct_forces([heard(*CASES["slot, two teeth"], law=law)], frf)
    assert found.axes == ("x", "y")
    assert set(found.posterior.names) == {"Ktc", "Krc", "Kte", "Kre"}
    assert_right(found)
    coefficients = coefficients_of_forces(found)
    assert np.isnan(coefficients.residual_rms[2])
    assert np.isfinite(coefficients.residual_rms[:2]).all()


def test_signs_names_and_order_of_inputs_and_outputs_do_not_matter():
    """A hammer that counts along -x and a sensor that was turned in the impact test, both known: the same force."""
    of, cut = structure(2012), heard(*CASES["slot, two teeth"])
    plain = exact_frf(of, LINES)
    order, turned = [2, 0, 1], np.array([1, -1, 1, 1, -1, 1])
    values = plain.values[:, ::-1][:, :, order] * turned[None, ::-1, None]
    values[:, :, 1] *= -1
    other = replace(
        plain,
        values=values,
        outputs=tuple(("-" if sign < 0 else "+") + name for name, sign in zip(SENSORS, turned, strict=True))[::-1],
        inputs=("tipZ", "-tipX", "+tipY"),
    )
    a, b = reconstruct_forces([cut], plain), reconstruct_forces([cut], other)
    assert b.force == pytest.approx(a.force, rel=1e-6)
    assert b.posterior.covariance == pytest.approx(a.posterior.covariance, rel=1e-4)


def test_points_beside_the_tip_are_not_mixed_with_it():
    """The point that is hit along most axes counts; an input along x of another point does not."""
    of = structure(2012)
    plain = exact_frf(of, LINES)
    values = np.concatenate([-3 * plain.values[:, :, :1], plain.values], axis=2)
    both = replace(plain, values=values, inputs=("noseX", *TIP), hits_used=(0,) * 4)
    cut = heard(*CASES["slot, two teeth"])
    assert reconstruct_forces([cut], both).force == pytest.approx(reconstruct_forces([cut], plain).force)


def test_sensors_that_the_frf_has_not_are_left_out_and_said():
    of, cut = structure(2012), heard(*CASES["slot, two teeth"])
    plain = exact_frf(of, LINES)
    fewer = replace(plain, values=plain.values[:, 1:], outputs=SENSORS[1:])
    found = reconstruct_forces([cut], fewer)
    assert found.sensors == SENSORS[1:]
    assert_right(found)
    assert next(n.message for n in found.notices if n.code == "sensors-left-out").startswith("noseX")
    three = replace(plain, values=plain.values[:, :3], outputs=SENSORS[:3])
    found = reconstruct_forces([cut], three)
    assert_right(found, 0.02)
    assert "nothing over to check" in next(check.message for check in found.checks if check.name == "frf")


def test_an_frf_without_variance_says_that_its_errors_are_not_in_the_intervals():
    found = reconstruct_forces([heard(*CASES["slot, two teeth"])], exact_frf(structure(2012), LINES))
    assert "frf-without-variance" in {notice.code for notice in found.notices}


@pytest.mark.parametrize("form", ["receptance", "mobility"])
def test_the_form_of_the_frf_does_not_matter(form):
    of, cut = structure(2012), heard(*CASES["slot, two teeth"])
    plain = exact_frf(of, LINES)
    power = {"mobility": 1, "receptance": 2}[form]
    other = replace(plain, values=plain.values / (2j * np.pi * LINES[:, None, None]) ** power, form=form)
    a, b = reconstruct_forces([cut], plain), reconstruct_forces([cut], other)
    assert b.force == pytest.approx(a.force, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_the_force_back_where_nothing_is_wrong(method):
    options = {"regularization": 1e-9} if method == "tikhonov" else {}
    cutter, conditions = CASES["slot, two teeth"]
    found = reconstruct_forces(
        [heard(cutter, conditions)], exact_frf(structure(2012), LINES), method=method, harmonics=2, **options
    )
    true = force_harmonics(LAW, cutter, conditions, 4)[:, [2, 4]].T
    assert found.method == method
    assert np.abs(found.force - true).max() < 2e-3 * np.abs(true).max()
    assert_right(found, 0.01)


def test_several_cuts_of_one_cutter_have_one_answer_and_each_its_force():
    cutter = CASES["down, four teeth"][0]
    cuts = [
        heard(cutter, engagement("down", tooth_passing=f, teeth=4), phase=0.4, angle_from="pulse", name=f"{f}.h5")
        for f in (60.0, 78.0, 95.0)
    ]
    found = reconstruct_forces(cuts, exact_frf(structure(2012), LINES))
    assert_right(found)
    assert found.phase == pytest.approx([0.4] * 3, abs=np.radians(0.2))
    assert found.cuts == ("60.0.h5", "78.0.h5", "95.0.h5")
    for number, cut in enumerate(cuts):
        own = found.cut == number
        assert found.frequency[own] == pytest.approx(found.order[own] * cut.spindle_frequency)
        true = force_harmonics(LAW, cutter, cut.conditions, int(found.order.max()))[:, found.order[own]].T
        assert np.abs(found.force[own] - true).max() < 2e-3 * np.abs(true).max()
    result = coefficients_of_forces(found)
    assert result.measured.shape == (3, 3, len(result.angle))
    assert np.all(result.r2 > 0.99)


def test_a_dynamometer_beside_the_sensors_shows_the_same_force():
    cut = heard(*CASES["slot, two teeth"], phase=0.7, angle_from="pulse", dynamometer=True)
    found = reconstruct_forces([cut], exact_frf(structure(2012), LINES))
    assert found.dynamometer[0] == pytest.approx(found.alternating[0], abs=0.01 * np.abs(found.alternating).max())


def test_lines_beyond_the_frf_are_left_out_and_none_at_all_is_refused():
    of, cut = structure(2012), heard(*CASES["slot, two teeth"])
    found = reconstruct_forces([cut], exact_frf(of, np.arange(4.0, 200.0, 0.5)))
    assert found.frequency == pytest.approx([78.0, 156.0])
    assert "lines-left-out" in {notice.code for notice in found.notices}
    assert_right(found)
    with pytest.raises(IllPosedError, match=r"^cut.h5: its tooth passing of 78 Hz") as caught:
        reconstruct_forces([cut], exact_frf(of, np.arange(4.0, 60.0, 0.5)))
    assert "\n" not in str(caught.value)


def test_the_answer_is_the_same_each_time_and_finite():
    cut, frf = heard(*CASES["slot, two teeth"]), exact_frf(structure(2012), LINES)
    a, b = reconstruct_forces([cut], frf), reconstruct_forces([cut], frf)
    for name in (
        "force",
        "free_force",
        "free_sd",
        "condition",
        "deviation",
        "sensor_share",
        "alternating_sd",
        "compared",
    ):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
        assert np.all(np.isfinite(getattr(a, name))), name
    assert a.sensor_share.sum() == pytest.approx(1.0)
