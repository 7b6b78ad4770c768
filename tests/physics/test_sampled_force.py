"""Laws of the force sample by sample: the force of the harmonics, thin slices, finite differences, rotations, and inverses."""

import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import (
    Kienzle,
    LinearEdge,
    chip_thickness,
    force_harmonics,
    to_machine_axes,
)
from millcal.physics.sampled_force import (
    Passage,
    chip_quantiles,
    coefficients_of,
    mean_chip,
    parameters_of,
    sampled_force,
)

H0 = 60e-6
LAWS = {
    "kienzle": Kienzle(np.array([1700e6, 350e6, 120e6]), np.array([0.18, 0.55, 0.3])),
    "linear-edge": LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3])),
}
UNEQUAL = tuple(np.radians([84.0, 96.0, 87.0, 93.0]))
CUTTERS = [
    Cutter(0.010, 1, 0.6),
    Cutter(0.010, 2, 0.7, runout=12e-6, runout_angle=0.7),
    Cutter(0.012, 3, 0.5),
    Cutter(0.016, 4, 0.5, pitch=UNEQUAL, runout=15e-6, runout_angle=2.0),
]
CUTS = [
    ("up", 3e-3, 2e-3),
    ("down", 2e-3, 12e-3),
    ("slot", 0.01, 3e-3),
]  # the second is deep: lags of more than a tooth


def values_of(law):
    law = LAWS[law]
    return np.concatenate([law.specific_force, law.rise] if isinstance(law, Kienzle) else [law.cutting, law.edge])


def parameters(law, cutter):
    runout = cutter.runout * np.array([np.cos(cutter.runout_angle), np.sin(cutter.runout_angle)])
    return np.concatenate([parameters_of(values_of(law), law, H0), runout])


def passage_of(cut, cutter, angle, feed_direction=0.0):
    return Passage(angle, cut.feed_per_tooth, cut.axial_depth, *engagement(cut, cutter.diameter), feed_direction)


def force_of_thin_slices(law, cutter, cut, angle, slices=3000):
    """The force by summing chips on many slices: the slow form.   returns (angle, axis) N"""
    height = (np.arange(slices) + 0.5) * cut.axial_depth / slices
    chip = chip_thickness(cutter, cut, angle, height)  # (tooth, slice, angle)
    lag = cutter.tooth_lag()[:, np.newaxis] + cutter.helix_lag(height)
    on_edge = LAWS[law].edge_force(chip, cut.axial_depth / slices)
    return to_machine_axes(on_edge, angle - lag[:, :, np.newaxis]).sum(axis=(0, 1))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("cut", CUTS, ids=lambda cut: cut[0])
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: f"{cutter.teeth}-teeth")
def test_force_is_that_of_its_harmonics(cutter, cut, law):
    direction, radial, depth = cut
    cut = CuttingConditions(600.0, 80e-6, depth, radial, direction)
    angle = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    force, _ = sampled_force(
        parameters(law, cutter), passage_of(cut, cutter, angle), cutter, law=law, reference_chip=H0, nodes=24
    )
    found = np.fft.rfft(force, axis=0)[:25].T / 2048
    found[:, 0] /= 2
    expected = force_harmonics(LAWS[law], cutter, cut, 24)
    assert np.linalg.norm(found - expected) < 6e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("helix", [-0.6, 0.0, 0.6])
def test_force_is_that_of_thin_slices_for_either_hand_of_helix_and_none(helix, law):
    cutter = Cutter(0.016, 3, helix, runout=10e-6, runout_angle=-1.0)
    cut = CuttingConditions(600.0, 80e-6, 9e-3, 6e-3, "down")
    angle = np.random.default_rng(1).uniform(-20, 20, 60)
    force, _ = sampled_force(
        parameters(law, cutter), passage_of(cut, cutter, angle), cutter, law=law, reference_chip=H0, nodes=24
    )
    expected = force_of_thin_slices(law, cutter, cut, angle)
    tolerance = 2e-3 if helix else 1e-12  # without a helix one node is exact
    assert force == pytest.approx(expected, abs=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("cutter", [CUTTERS[0], CUTTERS[1], CUTTERS[3], Cutter(0.01, 2, 0.0, runout=9e-6)], ids=str)
def test_slopes_are_finite_differences(cutter, law):
    cut = CuttingConditions(600.0, 60e-6, 3e-3, 4e-3, "down")
    angle = np.random.default_rng(2).uniform(0, 6, 200)
    met, theta = passage_of(cut, cutter, angle, 0.4), parameters(law, cutter)
    options = {"law": law, "reference_chip": H0}
    _, slopes = sampled_force(theta, met, cutter, **options)
    for i, step in enumerate([1e-5] * 6 + [1e-11] * 2):
        shift = step * np.eye(8)[i]
        up, _ = sampled_force(theta + shift, met, cutter, **options)
        down, _ = sampled_force(theta - shift, met, cutter, **options)
        difference = np.abs((up - down) / (2 * step) - slopes[..., i])
        scale = np.abs(slopes[..., 6:] if i > 5 else slopes[..., i]).max()
        # where a piece of contact begins or a line of the chip takes over within the step, the two sides differ
        assert np.quantile(difference, 0.98) <= 2e-5 * scale, i


@pytest.mark.parametrize("law", LAWS)
def test_kappa_multiplies_and_the_shape_does_nothing_at_the_reference_chip(law):
    cutter = Cutter(0.01, 1)
    angle = np.array([2.0, 2.5])
    met = Passage(angle, H0 / np.sin(angle), 1e-3, 0.0, np.pi, 0.0)  # the chip is h0 at both samples
    theta = np.array([21.0, 0.2, 20.0, 0.4, 19.0, 0.1, 0.0, 0.0])
    options = {"law": law, "reference_chip": H0}
    force, slopes = sampled_force(theta, met, cutter, **options)
    assert slopes[..., 1:6:2] == pytest.approx(np.zeros((2, 3, 3)), abs=1e-9 * np.abs(force).max())
    doubled, _ = sampled_force(theta + np.log(2) * np.array([1, 0, 1, 0, 1, 0, 0, 0]), met, cutter, **options)
    assert doubled == pytest.approx(2 * force, rel=1e-12)
    assert slopes[..., 0:6:2].sum(axis=2) == pytest.approx(force, rel=1e-12)


def test_a_tool_fed_another_way_meets_the_same_work_turned():
    """The feed turns by delta from +x towards +y, against the spindle's sense: a tooth stands where it did, seen from the
    feed, when the spindle stands delta earlier; the force turns along."""
    cutter, delta = CUTTERS[1], 0.9
    cut = CuttingConditions(600.0, 80e-6, 3e-3, 4e-3, "down")
    angle, theta = np.linspace(0, 7, 50), parameters("kienzle", CUTTERS[1])
    options = {"law": "kienzle", "reference_chip": H0}
    along, slopes = sampled_force(theta, passage_of(cut, cutter, angle), cutter, **options)
    turned, turned_slopes = sampled_force(theta, passage_of(cut, cutter, angle - delta, delta), cutter, **options)
    turn = np.array([[np.cos(delta), -np.sin(delta), 0], [np.sin(delta), np.cos(delta), 0], [0, 0, 1]])
    assert turned == pytest.approx(along @ turn.T, abs=1e-9 * np.abs(along).max())
    assert turned_slopes == pytest.approx(np.einsum("ab,sbp->sap", turn, slopes), abs=1e-9 * np.abs(slopes).max())


def test_axes_are_chosen_parameters_of_each_sample_and_idle_samples():
    cutter, angle = CUTTERS[3], np.linspace(0, 7, 40)
    cut = CuttingConditions(600.0, 80e-6, 3e-3, 4e-3, "up")
    options = {"law": "linear-edge", "reference_chip": H0}
    theta = parameters("linear-edge", cutter)
    met = passage_of(cut, cutter, angle)
    whole, slopes = sampled_force(theta, met, cutter, **options)
    plane, plane_slopes = sampled_force(theta[[0, 1, 2, 3, 6, 7]], met, cutter, axes=("y", "x"), **options)
    assert plane == pytest.approx(whole[:, [1, 0]], rel=1e-13)
    assert plane_slopes == pytest.approx(slopes[:, [1, 0]][:, :, [0, 1, 2, 3, 6, 7]], rel=1e-13)
    factor = np.linspace(1, 2, 40)
    each, _ = sampled_force(
        theta + np.log(factor)[:, np.newaxis] * (np.arange(8) % 2 == 0) * (np.arange(8) < 6), met, cutter, **options
    )
    assert each == pytest.approx(whole * factor[:, np.newaxis], rel=1e-12, abs=1e-12)
    idle = met._replace(axial_depth=np.where(angle < 3, 0.0, 3e-3), leave=np.where(angle > 5, met.entry, met.leave))
    force, _ = sampled_force(theta, idle, cutter, **options)
    cutting = (angle >= 3) & (angle <= 5)
    assert np.all(force[~cutting] == 0)
    assert force[cutting] == pytest.approx(whole[cutting], rel=1e-13)


def test_refuses_parameters_that_do_not_fit_the_axes():
    met = Passage(np.zeros(3), 1e-4, 1e-3, 0.0, 1.0, 0.0)
    options = {"law": "kienzle", "reference_chip": H0}
    with pytest.raises(ValueError, match="leave z out"):
        sampled_force(np.ones(6), met, CUTTERS[0], **options)
    with pytest.raises(ValueError, match="neither 6"):
        sampled_force(np.ones(7), met, CUTTERS[0], **options)
    with pytest.raises(ValueError, match="2 rows of parameters for 3 samples"):
        sampled_force(np.ones((2, 8)), met, CUTTERS[0], **options)
    with pytest.raises(ValueError, match="none of kienzle, linear-edge"):
        sampled_force(np.ones(8), met, CUTTERS[0], law="taylor", reference_chip=H0)


def test_mean_chip_over_a_revolution_is_the_feed():
    """The teeth together take away f_z N a_p per unit of the swept sine: the integral of h over phi is f_z (cos in - cos out)."""
    cut = CuttingConditions(600.0, 80e-6, 3e-3, 4e-3, "down")
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    for cutter in CUTTERS:
        entry, leave = engagement(cut, cutter.diameter)
        plain = mean_chip(passage_of(cut, cutter, angle), cutter)
        expected = cut.feed_per_tooth * cutter.teeth * (np.cos(entry) - np.cos(leave)) / (2 * np.pi)
        assert plain.mean() == pytest.approx(expected, rel=1e-5)
    teeth, small = CUTTERS[1], (2e-6, 1e-6)  # a runout that no tooth loses contact by for long takes nothing away
    offset = mean_chip(passage_of(cut, teeth, angle), teeth, small)
    assert offset.mean() == pytest.approx(mean_chip(passage_of(cut, teeth, angle), teeth).mean(), rel=2e-3)


def test_chips_met_are_those_of_the_sine():
    """Slot: phi is uniform over 0..pi, so the chip's quantiles are those of f_z sin(phi)."""
    cutter, feed = Cutter(0.01, 2, 0.6), 80e-6
    angle = np.linspace(0, 2 * np.pi, 3000, endpoint=False)
    found = chip_quantiles(Passage(angle, feed, 3e-3, 0.0, np.pi, 0.0), cutter)
    assert found.low == pytest.approx(feed * np.sin(0.05 * np.pi / 2), rel=0.02)
    assert found.high == pytest.approx(feed * np.sin(0.95 * np.pi / 2), rel=1e-3)
    chip = feed * np.sin((np.arange(5000) + 0.5) * np.pi / 5000)
    assert found.reference == pytest.approx(np.exp(np.average(np.log(chip), weights=chip**0.75)), rel=1e-3)
    many = chip_quantiles(Passage(2 * np.pi / 40.01 * np.arange(400_000), feed, 3e-3, 0.0, np.pi, 0.0), cutter)
    assert many == pytest.approx(found, rel=0.02)  # nearly the same 40 angles again and again
    with pytest.raises(ValueError, match="no tooth cuts"):
        chip_quantiles(Passage(angle, feed, 0.0, 0.0, np.pi, 0.0), cutter)


@pytest.mark.parametrize("law", LAWS)
def test_coefficients_and_parameters_are_inverse_and_slopes_are_finite_differences(law):
    values = values_of(law) * np.array([[1.0], [1.3]])
    theta = np.concatenate([parameters_of(values, law, H0), np.full((2, 2), 5e-6)], axis=1)
    back, slopes = coefficients_of(theta, law, H0)
    assert back == pytest.approx(values, rel=1e-12)
    for i in range(8):
        step = 1e-6 * np.eye(8)[i]
        difference = (coefficients_of(theta + step, law, H0)[0] - coefficients_of(theta - step, law, H0)[0]) / 2e-6
        assert slopes[..., i] == pytest.approx(difference, rel=1e-6, abs=1e-6 * np.abs(values).max())
    plane, _ = coefficients_of(theta[:, [0, 1, 2, 3, 6, 7]], law, H0)
    assert plane == pytest.approx(values[:, [0, 1, 3, 4]], rel=1e-12)
    with pytest.raises(ValueError, match="not above 0"):
        parameters_of(-values, law, H0)


def test_compiled_exponential_and_logarithm_are_those_of_the_library():
    from millcal.physics.edge_kernel import exponential, logarithm, sine_cosine

    x = np.linspace(-650, 650, 4001)
    assert np.array([exponential(v) for v in x]) == pytest.approx(np.exp(x), rel=4e-15)
    y = np.exp(np.linspace(-40, 40, 4001))
    assert np.array([logarithm(v) for v in y]) == pytest.approx(np.log(y), rel=4e-15, abs=4e-15)
    d = np.linspace(-np.pi / 2, np.pi / 2, 2001)
    assert np.array([sine_cosine(v) for v in d]) == pytest.approx(np.stack([np.sin(d), np.cos(d)], 1), abs=4e-15)


def test_numbers_arrays_and_read_only_arrays_meet_one_compiled_kernel():
    """Each kind of its own would be seconds of compiling more."""
    from millcal.physics.edge_kernel import force_of_samples

    angle = np.linspace(0, 3, 7)
    depth = np.full(7, 2e-3)
    depth.flags.writeable = False
    options = {"law": "kienzle", "reference_chip": H0}
    forces, kernels = [], []
    for met in (
        Passage(angle, 1e-4, 2e-3, 1.0, 3.0, 0.0),
        Passage(angle, np.full(7, 1e-4), depth, 1.0, np.full(7, 3.0), 0.0),
    ):
        forces.append(sampled_force(parameters("kienzle", CUTTERS[1]), met, CUTTERS[1], **options)[0])
        kernels.append(len(force_of_samples.signatures))
    assert np.array_equal(*forces)
    assert kernels[0] == kernels[1]
