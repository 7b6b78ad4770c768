"""Cuts heard by accelerometers whose truth is known: harmonics, their covariance, their angle, and what is said."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.errors import RecordingError
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.stages.conditioning.vibration import condition_vibration

RATE = 5000.0
SPINDLE = 40.37  # Hz
CUTTER = Cutter(16e-3, 2)
SENSORS = tuple(Channel(f"a{i}", "acceleration", "m/s^2", dof) for i, dof in enumerate(("tipX", "tipY", "tableZ")))
PULSE = Channel("pulse", "pulse", "1", "spindle")
ENCODER = Channel("encoder", "angle", "rad", "spindle")
HIGHEST = 12
ORDER = np.arange(HIGHEST + 1)
START = 0.7  # rad, of the spindle at the first sample


def truth():
    """Harmonics of three accelerations, strong at the teeth's.   returns (3, 13)"""
    rng = np.random.default_rng(0)
    c = rng.standard_normal((3, 13)) + 1j * rng.standard_normal((3, 13))
    c *= np.where(ORDER % 2 == 0, 2.0, 0.05)
    c[:, 0] = 0
    return c


def angle_of(n, spindle=SPINDLE):
    return START + 2 * np.pi * spindle * np.arange(n) / RATE


def signal(c, angle):
    return np.real(c @ np.exp(1j * np.outer(ORDER, angle)))


def cut(seconds=1.0, *, noise=0.0, seed=0, air=0.0, spindle=SPINDLE, extra=(), channels=()):
    """Accelerations of a steady cut, and other rows with their channels."""
    n = round((seconds + 2 * air) * RATE)
    y = signal(truth(), angle_of(n, spindle))
    t = np.arange(n) / RATE
    y *= (t >= air) & (t < air + seconds)
    y += noise * np.random.default_rng(seed).standard_normal(y.shape)
    return Recording(
        samples=np.vstack([y, *extra]),
        sample_rate=RATE,
        channels=SENSORS + tuple(channels),
        name="cut.h5",
        cutter=CUTTER,
        conditions=CuttingConditions(2 * np.pi * SPINDLE, 0.1e-3, 2e-3, 16e-3, "slot"),
    )


def codes(result):
    return {notice.code for notice in result.notices}


def conditioned(recording, **options):
    return condition_vibration(recording, harmonics=HIGHEST, **options)


def turned(c, angle):
    """Harmonics in an angle that is greater by `angle`."""
    return c * np.exp(-1j * angle * ORDER)


# -- harmonics and their covariance


def test_without_noise_the_harmonics_come_back_exactly_in_the_angle_from_the_first_sample():
    result = conditioned(cut())
    assert (
        np.abs(result.harmonics - turned(truth(), -START)).max() < 2e-6
    )  # the line through its means leaves a trace of it
    assert result.angle_from == "speed"
    assert result.sensors == ("tipX", "tipY", "tableZ")
    assert result.steady == (0.0, 1.0)
    assert result.revolutions == 40
    assert result.synchronous_share == pytest.approx(1.0)
    assert result.ac_rms == pytest.approx(np.std(cut().samples, axis=1), rel=1e-2)
    assert result.force is None


def test_mean_and_drift_are_nothing_that_an_accelerometer_knows():
    recording = cut(noise=0.01)
    plain = conditioned(recording)
    line = np.array([[3.0], [-20.0], [0.0]]) + np.outer([5.0, 0.0, -7.0], np.linspace(0, 1, 5000))
    result = conditioned(replace(recording, samples=recording.samples + line))
    assert np.all(result.harmonics[:, 0] == 0)
    assert np.all(result.covariance[0] == 0)
    assert np.abs(result.harmonics - plain.harmonics).max() < 1e-5
    assert result.asynchronous_rms == pytest.approx(plain.asynchronous_rms, rel=1e-3)


@pytest.mark.parametrize("seconds", [0.15, 1.0, 3.0])
def test_the_stated_covariance_of_the_harmonics_is_that_of_their_errors(seconds):
    """e^H C^-1 e over the sensors is 1 on average, but for what a covariance from few draws adds to its inverse.

    The error of the angle's constant is found, as by whoever uses the harmonics.
    """
    ratios, draws = [], []
    for seed in range(25):
        result = conditioned(cut(seconds, noise=0.3, seed=seed), steady=(0.0, seconds))
        inverse = np.array([np.linalg.inv(c) for c in result.covariance[1:]])
        expected = turned(truth(), -START)[:, 1:].T  # (k, sensor)
        along = 1j * ORDER[1:, np.newaxis] * expected
        weighted = np.einsum("kab,kb->ka", inverse, along).conj()
        error = result.harmonics[:, 1:].T - expected
        turn = np.sum(weighted * error).real / np.sum(weighted * along).real
        error -= turn * along
        ratios.append(np.mean(np.einsum("ka,kab,kb->k", error.conj(), inverse, error).real) / 3)
        draws.append(result.lines_between[1:].mean())
    expected = np.mean(draws) / (np.mean(draws) - 3)
    assert np.mean(ratios) == pytest.approx(expected, rel=0.15)  # 900 complex draws, some lines shared


def test_of_white_noise_the_covariance_is_4_s2_over_the_samples_and_the_rest_is_the_noise():
    results = [conditioned(cut(2.0, noise=0.5, seed=seed), steady=(0.0, 2.0)) for seed in range(6)]
    n = results[0].revolutions / SPINDLE * RATE
    mean = np.mean([result.covariance[1:] for result in results], axis=(0, 1)) / (4 * 0.25 / n)
    assert mean == pytest.approx(np.eye(3), abs=0.08)
    assert results[0].asynchronous_rms == pytest.approx(0.5, rel=0.03)
    assert results[0].ac_rms == pytest.approx(np.std(cut(2.0, noise=0.5).samples, axis=1), rel=0.02)


def test_two_or_three_revolutions_are_enough_to_say_something():
    result = conditioned(cut(2.6 / SPINDLE, noise=0.1), steady=(0.0, 2.6 / SPINDLE))
    assert result.revolutions == 2
    assert "few-revolutions" in codes(result)
    assert all(np.linalg.cond(c) < 1000 for c in result.covariance[1:])
    sd = np.sqrt(4 * 0.01 / (2 / SPINDLE * RATE))
    assert np.sqrt(np.mean(np.diagonal(result.covariance[1:], axis1=1, axis2=2).real)) == pytest.approx(sd, rel=0.5)


def test_a_speed_half_a_per_cent_off_is_found():
    result = conditioned(cut(spindle=1.005 * SPINDLE, noise=0.3))
    assert result.spindle_frequency == pytest.approx(1.005 * SPINDLE, rel=1e-5)
    assert abs(result.spindle_frequency - 1.005 * SPINDLE) < 5 * result.spindle_frequency_sd
    assert "speed-off" not in codes(result)
    assert "speed-off" in codes(conditioned(cut(spindle=1.02 * SPINDLE, noise=0.3)))


def test_a_sensor_that_rattles_does_not_drown_the_others():
    recording = cut(spindle=1.005 * SPINDLE, noise=0.1)
    plain = conditioned(recording)
    rattle = 100.0 * np.random.default_rng(9).standard_normal(5000)
    result = conditioned(with_row(recording, 2, recording.samples[2] + rattle), steady=(0.0, 1.0))
    assert result.spindle_frequency == pytest.approx(1.005 * SPINDLE, rel=2e-5)
    assert result.harmonics[:2, 2] == pytest.approx(plain.harmonics[:2, 2], rel=5e-3)
    assert result.covariance[2, 0, 0] == pytest.approx(plain.covariance[2, 0, 0], rel=0.5)
    assert result.asynchronous_rms[2] == pytest.approx(100.0, rel=0.1)
    assert "asynchronous" in codes(result)


def test_the_cut_is_found_between_air_and_the_noise_of_the_sensors():
    result = conditioned(cut(air=0.5, noise=0.2))
    assert result.steady == pytest.approx((0.5, 1.5), abs=2 / SPINDLE)
    assert result.overview_time[-1] == pytest.approx(2.0, abs=0.01)


# -- angle


def test_with_a_pulse_the_angle_counts_from_its_leading_edge_and_with_a_phase_from_tooth_0():
    n = 5000
    pulse = (((angle_of(n) - 1.3) / (2 * np.pi)) % 1.0 < 0.1).astype(float)
    recording = cut(extra=[pulse], channels=[PULSE])
    expected = turned(truth(), -1.3)
    result = conditioned(recording)
    assert result.angle_from == "pulse"
    late = 2 * np.pi * SPINDLE / RATE  # a square pulse is known to a sample
    assert np.abs(result.harmonics[:, 2] / expected[:, 2] - 1).max() < 0.1 * late
    result = conditioned(replace(recording, spindle_phase=1.3))
    assert result.angle_from == "stated"
    assert np.abs(result.harmonics[:, 2] / truth()[:, 2] - 1).max() < 0.1 * late
    assert conditioned(recording, steady=(0.31, 0.9)).harmonics[:, 2] == pytest.approx(expected[:, 2], rel=0.1)


@pytest.mark.parametrize("sense", [1, -1])
def test_with_an_encoder_the_angle_is_the_encoders_in_the_mean(sense):
    encoder = sense * ((angle_of(5000) - 0.9) % (2 * np.pi))
    recording = cut(extra=[encoder], channels=[ENCODER])
    result = conditioned(recording)
    assert result.angle_from == "encoder"
    assert np.abs(result.harmonics - turned(truth(), -0.9)).max() < 1e-6
    assert conditioned(recording, spindle_phase=0.9).harmonics == pytest.approx(truth(), abs=1e-6)


def test_without_either_a_stated_phase_is_that_of_tooth_0_at_the_first_sample_of_the_recording():
    for steady in (None, (0.213, 0.9)):
        result = conditioned(cut(), spindle_phase=START, steady=steady)
        assert result.angle_from == "stated"
        assert np.abs(result.harmonics - truth()).max() < 1e-5


def test_a_stated_phase_from_the_speed_alone_is_as_uncertain_as_the_way_to_the_cut_is_long():
    errors, stated = [], []
    for seed in range(25):
        result = conditioned(cut(1.0, air=1.0, noise=0.5, seed=seed), steady=(1.2, 2.0), spindle_phase=START)
        errors.append(np.abs(result.harmonics - truth())[:, 12] ** 2)
        stated.append(np.diagonal(result.covariance[12]).real)
    assert 0.4 < np.mean(errors) / np.mean(stated) < 2.2  # one angle in 25 recordings
    plain = conditioned(cut(1.0, air=1.0, noise=0.5), steady=(1.2, 2.0))
    assert np.trace(plain.covariance[12]).real < 0.3 * np.sum(np.mean(stated, axis=0))


def test_a_pulse_that_falls_between_samples_always_alike_leaves_its_angle_open_by_a_part_of_a_sample():
    spindle = 50.0  # 100 samples per revolution
    n = 5000
    pulse = ((angle_of(n, spindle) / (2 * np.pi)) % 1.0 < 0.1).astype(float)
    recording = cut(spindle=spindle, extra=[pulse], channels=[PULSE])
    recording = replace(recording, conditions=replace(recording.conditions, spindle_speed=2 * np.pi * spindle))
    result = conditioned(recording, spindle_phase=0.0)
    sd = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2).real.T)[:, 2]
    assert sd == pytest.approx(2 * 2 * np.pi / 100 / np.sqrt(12) * np.abs(truth()[:, 2]), rel=0.05)
    assert np.all(np.abs(result.harmonics[:, 2] - truth()[:, 2]) < 2 * sd)


# -- quantities and signs


def test_a_sensor_that_counts_backwards_is_turned_and_loses_its_sign():
    recording = cut(noise=0.1)
    channels = (SENSORS[0], replace(SENSORS[1], dof="-tipY"), replace(SENSORS[2], dof="+tableZ"))
    samples = recording.samples * np.array([[1.0], [-1.0], [1.0]])
    result, plain = conditioned(replace(recording, samples=samples, channels=channels)), conditioned(recording)
    assert result.sensors == plain.sensors
    assert result.harmonics == pytest.approx(plain.harmonics)
    assert result.covariance == pytest.approx(plain.covariance)


@pytest.mark.parametrize(("quantity", "times"), [("velocity", 1), ("displacement", 2)])
def test_velocities_and_displacements_give_the_same_accelerations_and_errors(quantity, times):
    """The noise of the velocity is that of the acceleration, integrated: near a harmonic it is divided by j w as well."""
    n, rng = 10_000, np.random.default_rng(3)
    w = 2j * np.pi * np.fft.rfftfreq(n, 1 / RATE)
    w[: round(20 * n / RATE)] = 1e9  # nothing slow: integrated, it would be all
    a = signal(truth(), angle_of(n)) + 0.1 * rng.standard_normal((3, n))
    exact = truth() / np.where(ORDER > 0, (2j * np.pi * SPINDLE * ORDER) ** times, 1)
    v = signal(exact, angle_of(n)) + np.fft.irfft(np.fft.rfft(a - signal(truth(), angle_of(n))) / w**times, n)
    recording = cut(2.0)
    unit = {"velocity": "m/s", "displacement": "m"}[quantity]
    channels = (SENSORS[0], replace(SENSORS[1], quantity=quantity, unit=unit), SENSORS[2])
    plain = conditioned(replace(recording, samples=a), steady=(0.0, 2.0))
    mixed = conditioned(replace(recording, samples=np.vstack([a[0], v[1], a[2]]), channels=channels), steady=(0.0, 2.0))
    error = np.abs(mixed.harmonics - plain.harmonics)[1, 2:]
    assert np.all(error < np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2).real.T[1, 2:]))
    plain_sd, mixed_sd = (np.sqrt(r.covariance[3:, 1, 1].real) for r in (plain, mixed))
    assert mixed_sd == pytest.approx(plain_sd, rel=0.25)
    assert mixed.ac_rms == pytest.approx(plain.ac_rms, rel=0.02)


def test_a_dynamometer_beside_the_sensors_is_kept_in_the_same_angle():
    rng = np.random.default_rng(4)
    c = rng.standard_normal((2, 13)) + 1j * rng.standard_normal((2, 13))
    c[:, 0] = c[:, 0].real
    channels = [Channel("fx", "force", "N", "tipX"), Channel("fz", "force", "N", "tipZ")]
    recording = cut(extra=[signal(c, angle_of(5000))], channels=channels)
    result = conditioned(recording, spindle_phase=START)
    assert np.all(np.isnan(result.force[1]))
    assert result.force[[0, 2]] == pytest.approx(c, abs=1e-6)
    assert result.sensors == ("tipX", "tipY", "tableZ")


# -- what does not follow the spindle


def test_chatter_is_told_with_its_sensor_and_does_not_spoil_what_is_far_from_it():
    recording = cut(3.0, noise=0.1)
    plain = conditioned(recording)
    t = np.arange(15_000) / RATE
    lines = [np.cos(2 * np.pi * f * t) for f in (3.37 * SPINDLE, 5.37 * SPINDLE)]
    samples = recording.samples + np.outer([0.0, 3.0, 0.5], lines[0]) + np.outer([0.0, 1.0, 0.2], lines[1])
    result = conditioned(replace(recording, samples=samples))
    assert {"chatter-lines", "asynchronous"} <= codes(result)
    assert {peak.axis for peak in result.peaks} == {"tipY", "tableZ"}
    strongest = max(result.peaks, key=lambda peak: peak.amplitude)
    assert strongest.frequency == pytest.approx(3.37 * SPINDLE, abs=0.1)
    assert strongest.amplitude == pytest.approx(3.0, rel=0.05)
    ratio = np.diagonal(result.covariance, axis1=1, axis2=2).real / np.maximum(
        np.diagonal(plain.covariance, axis1=1, axis2=2).real, 1e-300
    )
    assert np.all(ratio[9:] < 2)
    assert np.all(ratio[1:, 0] < 1.3)  # the sensor that does not hear it
    sd = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2).real.T)
    assert np.all(np.abs(result.harmonics - turned(truth(), -START))[:, 1:] < 5 * sd[:, 1:])


def test_a_spindle_that_wanders_is_told():
    n = 10_000
    angle = angle_of(n) + 0.05 * np.sin(2 * np.pi * 3.0 * np.arange(n) / RATE)
    assert "speed-wander" in codes(conditioned(replace(cut(2.0), samples=signal(truth(), angle))))


# -- dirty files


def with_row(recording, row, values, **changes):
    samples = recording.samples.copy()
    samples[row] = values
    return replace(recording, samples=samples, **changes)


def test_a_dead_channel_is_left_out_and_named():
    recording = cut(noise=0.1)
    for values, word in ((0.0, "never changes"), (1.5, "never changes"), (np.nan, "no number")):
        result = conditioned(with_row(recording, 1, values))
        assert result.sensors == ("tipX", "tableZ")
        assert result.harmonics.shape == (2, 13)
        (said,) = [notice for notice in result.notices if notice.code == "dead-channel"]
        assert "a1 (tipY)" in said.message
        assert word in said.message
    died = recording.samples[1].copy()
    died[1000:] = died[1000]
    result = conditioned(with_row(recording, 1, died), steady=(0.3, 0.9))
    assert result.sensors == ("tipX", "tableZ")
    with pytest.raises(RecordingError, match=r"cut.h5: the vibrations never change"):
        conditioned(replace(recording, samples=np.zeros((3, 5000))))


def test_a_sample_that_is_no_number_is_told_with_its_channel_within_the_cut_only():
    recording = cut(1.0, air=0.5, noise=0.1)
    samples = recording.samples.copy()
    samples[1, 1000] = np.nan
    assert np.isfinite(conditioned(replace(recording, samples=samples)).harmonics).all()
    samples[2, 5000] = np.nan
    with pytest.raises(RecordingError, match=r"cut.h5: a vibration is not a number at 1 s, .*\(a2\)"):
        conditioned(replace(recording, samples=samples), steady=(0.6, 1.4))


def test_clipping_is_told_with_the_channels_name():
    recording = cut(noise=0.1)
    clipped = np.clip(recording.samples[0], -1.0, 1.0)
    said = [n.message for n in conditioned(with_row(recording, 0, clipped)).notices if n.code == "clipped"]
    assert len(said) == 1
    assert said[0].startswith("a0 stands still")
    ranged = (replace(SENSORS[0], full_scale=1.0), *SENSORS[1:])
    said = [
        n.message for n in conditioned(with_row(recording, 0, clipped, channels=ranged)).notices if n.code == "clipped"
    ]
    assert said[0].startswith("a0 reaches its input range of 1 m/s^2")


def test_sensors_without_a_place_or_with_the_same_one_are_told():
    recording = cut(noise=0.1)
    nowhere = (SENSORS[0], replace(SENSORS[1], dof=""), SENSORS[2])
    result = conditioned(replace(recording, channels=nowhere))
    assert result.sensors == ("tipX", "tableZ")
    assert "a1" in next(n.message for n in result.notices if n.code == "no-dof")
    twice = (replace(SENSORS[0], quantity="displacement"), replace(SENSORS[1], dof="-tipX"), SENSORS[2])
    result = conditioned(replace(recording, channels=twice))
    assert result.sensors == ("tipX", "tableZ")
    assert result.harmonics[0] == pytest.approx(-conditioned(recording).harmonics[1], abs=2e-3)
    assert "a0 is left out" in next(n.message for n in result.notices if n.code == "same-dof")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"channels": tuple(replace(c, quantity="force") for c in SENSORS)}, "no channel of acceleration"),
        ({"channels": tuple(replace(c, dof="") for c in SENSORS)}, "no sensor says where it sits: a0, a1, a2"),
        ({"cutter": None}, "cutter"),
        ({"kind": "impact"}, "impact"),
        ({"steady": (0.5, 3.0)}, "steady_s"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(change, word):
    with pytest.raises(RecordingError, match=word) as refused:
        conditioned(replace(cut(), **change))
    assert str(refused.value).startswith("cut.h5: ")
    assert "\n" not in str(refused.value)


def test_harmonics_above_what_the_sample_rate_carries_are_told():
    result = condition_vibration(cut(0.5, noise=0.1), harmonics=80)
    assert result.harmonics.shape[1] == int(0.45 * RATE / SPINDLE) + 1
    assert "nyquist" in codes(result)


# -- long records


class OnDisk:
    """Samples that are read block by block."""

    def __init__(self, samples):
        self.shape, self.samples, self.largest = samples.shape, samples, 0

    def read_block(self, start, stop):
        self.largest = max(self.largest, stop - start)
        return self.samples[:, start:stop]


def test_a_record_on_disk_gives_the_same_block_by_block(monkeypatch):
    from millcal.numerics import revolutions
    from millcal.stages.conditioning import reference, vibration

    n = 30_000
    encoder = angle_of(n) % (2 * np.pi)
    recording = cut(5.0, air=0.5, noise=0.1, extra=[encoder], channels=[ENCODER])
    plain = conditioned(recording)
    monkeypatch.setattr(revolutions, "WHOLE_RECORD", 16_000)
    monkeypatch.setattr(reference, "BLOCK", 4000)
    on_disk = OnDisk(recording.samples)
    blocks = conditioned(replace(recording, samples=on_disk))
    assert blocks.harmonics == pytest.approx(plain.harmonics, abs=1e-8)
    assert blocks.covariance == pytest.approx(plain.covariance, rel=1e-6, abs=1e-12)
    assert np.array_equal(blocks.overview_low, plain.overview_low)
    monkeypatch.setattr(vibration, "LONGEST", 9000)  # stretches of 3000 samples
    blocks = conditioned(replace(recording, samples=on_disk))
    assert blocks.harmonics == pytest.approx(plain.harmonics, abs=1e-8)
    trace, before = (np.trace(r.covariance[1:], axis1=1, axis2=2).real for r in (blocks, plain))
    assert np.mean(trace / before) == pytest.approx(1.0, abs=0.15)


def test_a_simulated_cut_gives_back_the_accelerations_of_its_structure_under_its_force():
    """Ramps, air, a speed that misses the stated one, a pulse, noise: what is left of the error is the noise."""
    from millcal.physics.cutting_force import LinearEdge, force_harmonics
    from millcal.physics.measuring_chain import MeasuringChain
    from millcal.physics.shaped_modes import ShapedMode, accelerance_between
    from millcal.simulation import Timeline, simulate_cut

    law = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
    conditions = CuttingConditions(2 * np.pi * 40.0, 0.1e-3, 2e-3, 8e-3, "down")
    modes = [
        ShapedMode(150.0, 0.05, 2e7, (("tipX", 1.0), ("tipY", 0.3), ("tableZ", 0.2))),
        ShapedMode(260.0, 0.04, 3e7, (("tipX", -0.2), ("tipY", 1.0), ("tableZ", -0.4))),
    ]
    dofs = ("tipX", "tipY", "tableZ")
    recording, told = simulate_cut(
        law,
        CUTTER,
        conditions,
        rng=np.random.default_rng(1),
        sample_rate=RATE,
        timeline=Timeline(2.0, 0.3, 0.3, 0.1),
        initial_angle=None,
        speed_error=5e-3,
        modes=modes,
        accelerometers=dofs,
        accelerometer=MeasuringChain(noise=0.1, offset=(0.5, -0.2, 0.0)),
        pulse=True,
        pulse_angle=0.6,
    )
    result = conditioned(replace(recording, name="cut.h5", spindle_phase=0.6))
    assert result.spindle_frequency == pytest.approx(told["spindle_frequency_hz"], rel=2e-5)
    force = force_harmonics(law, CUTTER, conditions, HIGHEST)
    gain = accelerance_between(result.spindle_frequency * ORDER, modes, dofs, ("tipX", "tipY", "tipZ"))
    error = result.harmonics - np.einsum("ksa,ak->sk", gain, force)
    ratios = [(error[:, k].conj() @ np.linalg.solve(result.covariance[k], error[:, k])).real / 3 for k in ORDER[1:]]
    assert 0.4 < np.mean(ratios) < 2.0
    sd = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2).real.T)
    assert np.all(sd[:, 2] < 0.05 * np.abs(result.harmonics[:, 2]))
