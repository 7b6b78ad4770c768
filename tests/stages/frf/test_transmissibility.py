"""Hits on a dynamometer: force over force is 1 at rest, has one form, and is never mixed with motion."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.errors import RecordingError
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode
from millcal.simulation import simulate_impact
from millcal.stages.frf import estimate_frf

DOFS = ("tipX", "tipY", "tipZ")
CHAIN = MeasuringChain(resonance=(975.0, 790.0, 1000.0), damping_ratio=(0.02, 0.03, 0.05), cross_talk=0.01)
MODES = (ShapedMode(700.0, 0.03, 2e7, (("noseX", 1.0), ("tipX", 1.0))),)


def hits(axis=0, *, seed=1, noise=0.8, number=6, chain=CHAIN, **options):
    """An impact test on the dynamometer along one of its axes."""
    options = {"record": 0.25, "peak": 800.0, "pulse": 0.6e-3, "sample_rate": 8192.0, "dynamometer": chain} | options
    if options["dynamometer"] is not None:
        options["dynamometer"] = replace(options["dynamometer"], noise=noise)
    return simulate_impact(
        MODES if options.get("accelerometers") else (),
        rng=np.random.default_rng([seed, axis]),
        hammer=DOFS[axis],
        hits=number,
        hammer_chain=MeasuringChain(noise=noise / 4),
        accelerometer=MeasuringChain(noise=0.05),
        name=f"tap-{axis}.h5",
        **options,
    )[0]


def with_channels(recording, change):
    return replace(recording, channels=tuple(change(channel) for channel in recording.channels))


def inside(frf):
    return (frf.frequency >= frf.usable_band[0]) & (frf.frequency <= frf.usable_band[1])


def test_the_frf_of_hits_on_a_dynamometer_is_its_transfer_function_within_the_variance():
    frf = estimate_frf([hits(axis) for axis in range(3)])
    assert (frf.form, frf.outputs, frf.inputs, frf.hits_used) == ("transmissibility", DOFS, DOFS, (6, 6, 6))
    assert not frf.notices
    assert frf.usable_band[0] <= 10
    assert frf.usable_band[1] > 2000
    assert np.median(frf.coherence[inside(frf)][:, range(3), range(3)]) > 0.999
    error = variance = 0.0
    for seed in range(4):
        frf = estimate_frf([hits(axis, seed=seed) for axis in range(3)])
        true = CHAIN.transfer(frf.frequency, 3).transpose(2, 0, 1)
        error = error + np.sum(np.abs(frf.values - true)[inside(frf)] ** 2)
        variance = variance + np.sum(frf.variance[inside(frf)])
    assert error == pytest.approx(variance, rel=0.3)


def test_without_noise_the_transfer_function_comes_back_at_every_line():
    frf = estimate_frf(hits(noise=0.0, number=3, record=1.0))
    used = inside(frf)
    expected = CHAIN.transfer(frf.frequency, 3)[:, 0].T
    error = np.abs(frf.values[:, :, 0] - expected)[used]
    assert error.max() < 2e-3 * np.abs(expected).max()


def test_at_rest_a_dynamometer_reads_the_force_and_the_line_at_zero_has_a_value():
    frf = estimate_frf(hits())
    assert np.isfinite(frf.values[0]).all()
    low = inside(frf) & (frf.frequency < 60)
    assert frf.values[low, 0, 0].real == pytest.approx(1.0, abs=0.02)


def test_a_wrong_calibration_and_a_wrong_sign_are_told():
    test = hits()
    loud = replace(test, samples=test.samples * np.array([[1.0], [0.8], [0.8], [0.8]]))
    (told,) = estimate_frf(loud).notices
    assert told.code == "gain-at-rest"
    assert "0.80" in told.message
    turned = replace(test, samples=test.samples * np.array([[1.0], [-1.0], [1.0], [1.0]]))
    assert [notice.code for notice in estimate_frf(turned).notices] == ["dynamometer-polarity"]


@pytest.mark.parametrize("form", ["accelerance", "mobility", "receptance"])
def test_force_over_force_has_no_other_form(form):
    with pytest.raises(RecordingError, match="leave the form out"):
        estimate_frf(hits(), form=form)


def test_motion_and_forces_in_one_recording_need_a_choice():
    both = hits(accelerometers=("noseX", "tipX"))
    with pytest.raises(RecordingError, match=r"choose with form = transmissibility .* or accelerance"):
        estimate_frf(both)
    forces = estimate_frf(both, form="transmissibility")
    assert (forces.form, forces.outputs) == ("transmissibility", DOFS)
    motion = estimate_frf(both, form="receptance")
    assert (motion.form, motion.outputs) == ("receptance", ("noseX", "tipX"))


def test_motion_in_one_recording_and_forces_in_another_are_two_frfs():
    motion = hits(accelerometers=("tipX",), dynamometer=None)
    with pytest.raises(RecordingError, match="one by one"):
        estimate_frf([hits(1), motion])


def test_unmarked_force_channels_are_hammers_and_the_way_out_is_named():
    plain = with_channels(hits(), lambda channel: replace(channel, role=None, dof=channel.name))
    with pytest.raises(RecordingError, match="role = 'response'"):
        estimate_frf(plain)
    with pytest.raises(RecordingError, match="role = 'response'"):
        estimate_frf(plain, form="transmissibility")


def test_a_recording_without_a_hammer_is_refused():
    every = with_channels(hits(), lambda channel: replace(channel, role="response", dof=channel.name))
    with pytest.raises(RecordingError, match="one must be the hammer"):
        estimate_frf(every)
