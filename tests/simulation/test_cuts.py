"""Simulated cuts: the samples are those of the slow sum, and each flaw of the measuring chain has its stated size."""

import numpy as np
import pytest

from millcal.data import Channel
from millcal.physics.changing_coefficients import Chip, Trend
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import (
    Kienzle,
    LinearEdge,
    chip_thickness,
    force_at,
    force_harmonics,
    to_machine_axes,
)
from millcal.physics.measuring_chain import MeasuringChain, quantisation_step
from millcal.physics.shaped_modes import ShapedMode, accelerance_between, receptance_between
from millcal.physics.spindle import SpindleMotion
from millcal.physics.structure import Mode, receptance
from millcal.simulation import Line, Timeline, as_dynamometer_channels, simulate_cut
from millcal.simulation.cuts import synthesise
from millcal.simulation.noise import coloured_noise

LAW = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
CUTTER = Cutter(0.016, 3, np.radians(30), runout=6e-6, runout_angle=0.5)
SLOT = CuttingConditions(2 * np.pi * 100, 0.1e-3, 2e-3, 0.016, "slot")
DOWN = CuttingConditions(2 * np.pi * 100, 0.05e-3, 3e-3, 3e-3, "down")
MODES = (
    ShapedMode(310.0, 0.04, 9e7, (("tipX", 1.1), ("noseX", 1.0))),
    ShapedMode(1450.0, 0.02, 2e7, (("tipX", 1.0), ("tipY", 0.2), ("noseX", 0.1))),
)


def cut(law=LAW, cutter=CUTTER, conditions=SLOT, *, seed=1, rate=10_000, steady=0.2, timeline=None, **options):
    rng = np.random.default_rng(seed)
    timeline = timeline or Timeline(steady)
    return simulate_cut(law, cutter, conditions, rng=rng, sample_rate=rate, timeline=timeline, **options)


def amplitude(signal, frequency, rate):
    """Complex amplitude of a line in a signal that holds whole periods of it."""
    time = np.arange(signal.shape[-1]) / rate
    return 2 * np.mean(signal * np.exp(-2j * np.pi * frequency * time), axis=-1)


@pytest.mark.parametrize("law", [LAW, Kienzle(LAW.cutting, np.array([0.25, 0.4, 0.3]))])
@pytest.mark.parametrize("conditions", [SLOT, DOWN])
def test_the_samples_are_the_slow_sum_over_slices_but_for_what_lies_beyond_half_the_sample_rate(law, conditions):
    """The sum at sixteen angles a sample, low-passed by dropping the harmonics from half the sample rate on."""
    recording, _ = cut(law, conditions=conditions, rate=20_000, steady=0.01, initial_angle=0.7)
    height = (np.arange(100) + 0.5) * conditions.axial_depth / 100
    angle = 0.7 + 2 * np.pi * np.arange(200 * 16) / (200 * 16)
    chip = chip_thickness(CUTTER, conditions, angle, height)
    lag = CUTTER.tooth_lag()[:, np.newaxis] + CUTTER.helix_lag(height)
    slow = (
        to_machine_axes(law.edge_force(chip, conditions.axial_depth / 100), angle - lag[:, :, np.newaxis]).sum((0, 1)).T
    )
    spectrum = np.fft.rfft(slow, axis=1)
    spectrum[:, 100:] = 0  # 99 harmonics of 100 Hz lie below 10 kHz
    expected = np.fft.irfft(spectrum, angle.size, axis=1)[:, ::16]
    assert np.abs(recording.samples - expected).max() < 3e-3 * np.abs(expected).max()


def test_horner_s_scheme_is_the_plain_series():
    rng = np.random.default_rng(2)
    harmonics = rng.standard_normal((4, 60)) + 1j * rng.standard_normal((4, 60))
    angle = np.linspace(0, 80, 20_001)
    assert synthesise(harmonics, angle) == pytest.approx(force_at(harmonics, angle), abs=1e-10)


def test_the_mean_over_whole_revolutions_is_the_closed_form():
    recording, _ = cut(cutter=Cutter(0.016, 4, 0.5), steady=0.2)
    a, f, n = SLOT.axial_depth, SLOT.feed_per_tooth, 4
    (Ktc, Krc, Kac), (Kte, Kre, Kae) = LAW.cutting, LAW.edge
    expected = [
        -n * a / 4 * Krc * f - n * a / np.pi * Kre,
        n * a / 4 * Ktc * f + n * a / np.pi * Kte,
        n * a / np.pi * Kac * f + n * a / 2 * Kae,
    ]
    assert recording.samples.mean(axis=1) == pytest.approx(expected, rel=1e-10)


def test_there_is_no_force_in_the_air_and_all_of_it_in_the_steady_cut():
    timeline = Timeline(0.1, 0.05, 0.07, 0.02)
    recording, truth = cut(timeline=timeline, initial_angle=0.0)
    always, _ = cut(steady=timeline.duration, initial_angle=0.0)
    time = np.arange(recording.samples.shape[1]) / recording.sample_rate
    begin, end = truth["steady_s"]
    steady = (time >= begin) & (time <= end)
    assert recording.samples[:, steady] == pytest.approx(always.samples[:, : len(time)][:, steady], abs=1e-9)
    assert np.abs(recording.samples[:, (time <= 0.05) | (time > 0.19 + 1e-9)]).max() < 1e-9
    assert recording.duration == pytest.approx(0.26)


def test_a_varying_speed_turns_the_force_with_the_spindle():
    options = {"initial_angle": 0.3, "speed_error": 1e-3, "variation": 0.01, "variation_frequency": 2.0}
    recording, truth = cut(**options)
    time = np.arange(recording.samples.shape[1]) / recording.sample_rate
    f = truth["spindle_frequency_hz"]
    angle = 0.3 + 2 * np.pi * f * np.array(
        [np.trapezoid(1 + 0.01 * np.sin(4 * np.pi * s), s) for s in (np.linspace(0, t, 400) for t in time[::100])]
    )
    expected = force_at(force_harmonics(LAW, CUTTER, SLOT, 49), angle)
    assert f == pytest.approx(100.1)
    assert recording.samples[:, ::100] == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_the_pulse_comes_once_per_revolution_where_the_mark_passes():
    recording, truth = cut(pulse=True, pulse_angle=1.0, initial_angle=0.2, speed_error=2e-4, steady=1.0, rate=25_600)
    pulse = recording.samples[recording.rows_of("pulse")[0]]
    rising = np.flatnonzero(np.diff(pulse) > 0) + 1
    turns = 0.2 / (2 * np.pi) + truth["spindle_frequency_hz"] * rising / recording.sample_rate
    assert len(rising) == 100
    assert np.all((turns - 1.0 / (2 * np.pi)) % 1 < truth["spindle_frequency_hz"] / recording.sample_rate + 1e-9)


def test_white_noise_has_its_rms_and_coloured_noise_its_rms_and_corner():
    chain = MeasuringChain(noise=2.0)
    noisy, clean = cut(steady=1.0, dynamometer=chain, initial_angle=0.0), cut(steady=1.0, initial_angle=0.0)
    assert (noisy[0].samples - clean[0].samples).std(axis=1) == pytest.approx(np.full(3, 2.0), rel=0.03)
    slow = coloured_noise(np.random.default_rng(3), (1, 200_000), 50.0, 10_000)[0]
    power = np.abs(np.fft.rfft(slow)) ** 2
    frequency = np.fft.rfftfreq(len(slow), 1e-4)
    assert slow.std() == pytest.approx(1.0, rel=0.03)
    assert power[frequency < 50].sum() / power.sum() == pytest.approx(0.5, abs=0.03)  # arctan(1) / (pi/2)


def test_counts_are_whole_numbers_of_the_step_and_end_at_the_full_scale():
    chain = MeasuringChain(full_scale=100.0, bits=10)
    recording, _ = cut(dynamometer=chain)
    step = quantisation_step(100.0, 10)
    counts = recording.samples / step
    assert counts == pytest.approx(np.rint(counts), abs=1e-9)
    assert np.abs(recording.samples).max() == pytest.approx(100.0)  # the cut is stronger than the range
    fine, _ = cut(dynamometer=MeasuringChain(full_scale=2000.0), initial_angle=0.0)
    clean, _ = cut(initial_angle=0.0)
    error = fine.samples - clean.samples
    assert np.abs(error).max() <= quantisation_step(2000.0, 16) / 2 + 1e-9
    assert recording.channels[0].full_scale == 100.0


def test_offset_drift_and_warming_are_added_as_stated():
    chain = MeasuringChain(offset=(1.0, -2.0, 3.0), drift=(0.5, 0.0, -1.0), warming=(4.0, 0.0, 0.0), warming_time=2.0)
    drifting, clean = cut(dynamometer=chain, initial_angle=0.0)[0], cut(initial_angle=0.0)[0]
    t = np.arange(clean.samples.shape[1]) / clean.sample_rate
    expected = [1 + 0.5 * t + 4 * (1 - np.exp(-t / 2)), -2 + 0 * t, 3 - t]
    assert drifting.samples - clean.samples == pytest.approx(np.array(expected), abs=1e-9)


def test_a_dynamometer_s_resonance_magnifies_each_harmonic_by_its_gain_and_leaves_the_mean():
    chain = MeasuringChain(resonance=(900.0, 1100.0, 2000.0), damping_ratio=(0.03, 0.05, 0.02))
    ringing, clean = cut(dynamometer=chain, initial_angle=0.0)[0], cut(initial_angle=0.0)[0]
    assert ringing.samples.mean(axis=1) == pytest.approx(clean.samples.mean(axis=1))
    gain = amplitude(ringing.samples, 900.0, 10_000) / amplitude(clean.samples, 900.0, 10_000)
    assert gain[0] == pytest.approx(1 / (2j * 0.03))
    assert gain[1] == pytest.approx(1 / (1 - (9 / 11) ** 2 + 2j * 0.05 * 9 / 11))


def test_a_low_pass_takes_half_the_power_at_its_corner_whatever_its_order():
    for order in (1, 2, 4):
        chain = MeasuringChain(lowpass=600.0, lowpass_order=order)
        assert np.abs(chain.gain(np.array([0.0, 600.0]), 1)[0]) ** 2 == pytest.approx([1.0, 0.5])
    far = np.abs(MeasuringChain(lowpass=600.0, lowpass_order=4).gain(np.array([6000.0]), 1))[0, 0]
    assert far == pytest.approx(1e-4, rel=1e-3)


def test_accelerations_are_accelerance_times_force_harmonic_by_harmonic():
    recording, _ = cut(modes=MODES, accelerometers=("noseX", "tipY"), initial_angle=0.0)
    assert [channel.dof for channel in recording.channels[3:]] == ["noseX", "tipY"]
    for frequency in (100.0, 300.0, 1500.0):
        force = amplitude(recording.samples[:3], frequency, 10_000)
        accelerance = accelerance_between(np.array([frequency]), MODES, ("noseX", "tipY"), ("tipX", "tipY", "tipZ"))[0]
        expected = accelerance @ force
        found = amplitude(recording.samples[3:], frequency, 10_000)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_accelerations_follow_the_slow_integration_of_each_mode_through_entry_and_exit():
    """Each mode's x'' + 2 zeta w x' + w^2 x = phi F w^2 / k, stepped by the exact solution for a force linear in between."""
    from scipy.linalg import expm

    rate, fine = 10_000, 16
    timeline = Timeline(0.05, 0.02, 0.03, 0.01)
    options = {
        "timeline": timeline,
        "initial_angle": 0.4,
        "conditions": CuttingConditions(600.0, 5e-5, 3e-3, 4e-3, "up"),
    }
    recording, _ = cut(modes=MODES, accelerometers=("noseX", "tipY"), rate=rate, **options)
    time = np.arange(recording.samples.shape[1] * fine) / (rate * fine)
    harmonics = force_harmonics(LAW, CUTTER, options["conditions"], 52)  # of 95.5 Hz below 5 kHz
    force = force_at(harmonics, 0.4 + 600.0 * time) * timeline.engagement(time)
    expected = np.zeros((2, len(time)))
    for mode in MODES:
        w, drive = 2 * np.pi * mode.natural_frequency, mode.at(("tipX", "tipY", "tipZ")) @ force
        A = np.array(
            [[0, 1, 0, 0], [-(w**2), -2 * mode.damping_ratio * w, w**2 / mode.stiffness, 0], [0, 0, 0, 1], [0] * 4]
        )
        step = expm(A / (rate * fine))  # of x, v, force and its slope
        x = np.zeros(2)
        motion = np.empty(len(time))
        for i, (now, then) in enumerate(zip(drive, np.append(drive[1:], 0.0), strict=True)):
            motion[i] = A[1, 0] * x[0] + A[1, 1] * x[1] + A[1, 2] * now
            x = step[:2] @ np.array([*x, now, (then - now) * rate * fine])
        expected += np.outer(mode.at(("noseX", "tipY")), motion)
    found = recording.samples[3:]
    assert np.abs(found - expected[:, ::fine]).max() < 2e-3 * np.abs(expected).max()
    rings = time[::fine] > 0.091  # the tool is out again
    assert np.abs(found[:, rings]).max() > 0.01 * np.abs(expected).max()


def test_a_record_that_begins_in_the_cut_has_no_entry_in_it():
    whole, _ = cut(modes=MODES, accelerometers=("noseX", "tipY"), initial_angle=0.2)
    later, _ = cut(modes=MODES, accelerometers=("noseX", "tipY"), initial_angle=0.2, steady=0.1)
    assert later.samples[3:] == pytest.approx(whole.samples[3:, :1000], abs=1e-7 * np.abs(whole.samples[3:]).max())


@pytest.mark.parametrize("pulse_angle", [0.0, 1.1])
def test_harmonics_counted_from_the_pulse_are_turned_by_its_angle(pulse_angle):
    """a = Re sum G_k F_k e^{jk theta}, theta = pulse_angle where the pulse rises, with the runout that is not told."""
    options = {"modes": MODES, "accelerometers": ("noseX",), "rate": 25_600, "steady": 0.5, "pulse": True}
    recording, _ = cut(dynamometer=None, initial_angle=None, pulse_angle=pulse_angle, **options)
    acceleration, pulse = recording.samples
    rise = np.flatnonzero(np.diff(pulse) > 0)[0] + 1
    after = acceleration[rise : rise + 256 * 40]  # whole revolutions
    for k in (1, 2, 3, 6):
        force = force_harmonics(LAW, CUTTER, SLOT, k)[:, k]
        gain = accelerance_between(np.array([100.0 * k]), MODES, ("noseX",), ("tipX", "tipY", "tipZ"))[0, 0]
        expected = gain @ force * np.exp(1j * k * pulse_angle)
        late = k * 2 * np.pi * 100 / 25_600  # the pulse is up to one sample late
        assert abs(amplitude(after, 100.0 * k, 25_600) - expected) < 1.01 * late * abs(expected) + 1e-9


def test_a_mode_that_moves_the_tip_along_one_axis_is_that_of_the_structure():
    shaped = [ShapedMode(900.0, 0.03, 2e7, (("tipX", 1.0),)), ShapedMode(1200.0, 0.02, 3e7, (("tipY", 1.0),))]
    plain = [Mode(900.0, 0.03, 2e7, "x"), Mode(1200.0, 0.02, 3e7, "y")]
    frequency = np.linspace(0, 3000, 301)
    tip = ("tipX", "tipY")
    assert receptance_between(frequency, shaped, tip, tip) == pytest.approx(receptance(frequency, plain))


def test_chatter_is_a_line_of_its_own_frequency_and_size():
    line = Line(1234.0, (50.0, 20.0, 0.0))
    with_line = cut(lines=[line], initial_angle=0.0, steady=0.5)[0]
    without = cut(initial_angle=0.0, steady=0.5)[0]
    found = amplitude(with_line.samples - without.samples, 1234.0, 10_000)
    assert np.abs(found) == pytest.approx([50.0, 20.0, 0.0], abs=1e-9)


def test_the_dynamometer_s_channels_turn_back_into_the_tool_s():
    recording, _ = cut(pulse=True)
    turned = as_dynamometer_channels(recording, {"fx": "+Fy", "fy": "-Fx", "fz": "+Fz"}, "workpiece")
    assert [channel.name for channel in turned.channels] == ["Fx", "Fy", "Fz", "pulse"]
    fx, fy, fz, pulse = recording.samples
    assert np.array_equal(turned.samples, np.array([fy, -fx, -fz, pulse]))


def test_the_same_seed_gives_the_same_samples_and_another_seed_others():
    chain = MeasuringChain(noise=1.0)
    samples = [cut(seed=seed, dynamometer=chain, initial_angle=None)[0].samples for seed in (4, 4, 5)]
    assert np.array_equal(samples[0], samples[1])
    assert not np.array_equal(samples[0], samples[2])


def test_the_recording_does_not_tell_the_runout():
    recording, _ = cut()
    assert recording.cutter == Cutter(CUTTER.diameter, CUTTER.teeth, CUTTER.helix)
    assert recording.conditions == SLOT


def test_the_truth_is_in_the_units_of_its_keys():
    recording, truth = cut(initial_angle=np.pi / 2)
    assert truth["conditions"] == {
        "spindle_speed_rpm": 6000.0,
        "feed_per_tooth_mm": 0.1,
        "axial_depth_mm": 2.0,
        "radial_depth_mm": 16.0,
        "direction": "slot",
    }
    assert truth["initial_angle_deg"] == 90.0
    assert truth["mean_force_N"] == pytest.approx(recording.samples.mean(axis=1))


WORN = Trend(drift=(((0.0, 1.0), (0.2, 1.4)),) * 3, chips=(Chip(0.1, (0.12, 0.12, 0.12)),))


def test_a_worn_edge_scales_the_force_that_the_sharp_one_has():
    sharp, _ = cut()
    worn, truth = cut(trend=WORN)
    time = np.arange(2000) / 10_000
    factor = (1 + 2 * time) * np.where(time >= 0.1, 1.12, 1.0)
    assert worn.samples == pytest.approx(sharp.samples * factor, abs=1e-9)
    told = truth["coefficients"]
    assert told["time_s"][:: len(told["time_s"]) - 1] == [0.0, 0.2]
    assert told["Krc_N_per_mm2"][-1] == pytest.approx(260 * 1.4 * 1.12)
    assert told["chips"] == [{"time_s": 0.1, "size": [0.12, 0.12, 0.12]}]


def test_a_trend_of_nothing_is_no_trend():
    plain, without = cut(seed=3, initial_angle=None)
    still, known = cut(seed=3, initial_angle=None, trend=Trend())
    assert still.samples == pytest.approx(plain.samples, abs=1e-9)
    assert known["mean_force_N"] == pytest.approx(without["mean_force_N"], rel=1e-8)


def test_the_amplifier_acts_on_a_changing_force_as_on_a_constant_one():
    """The change within the amplifier's memory of 0.3 ms is 0.06 %: so near is the filtered changing force to the truth."""
    chain = MeasuringChain(lowpass=600.0)
    trend = Trend(drift=(((0.0, 1.0), (0.2, 1.4)),) * 3)
    constant, _ = cut(dynamometer=chain)
    changing, _ = cut(dynamometer=chain, trend=trend)
    factor = 1 + 2 * np.arange(2000) / 10_000
    assert changing.samples == pytest.approx(constant.samples * factor, abs=1e-9)


def test_the_encoder_counts_the_spindle_angle_from_where_the_pulse_rises():
    recording, _ = cut(initial_angle=0.3, encoder=3600, pulse=True, pulse_angle=1.0, variation=0.02)
    pulse, encoder = recording.samples[-2:]
    motion = SpindleMotion(100.0, 0.3, 0.02, 1.0)
    exact = (motion.angle(np.arange(2000) / 10_000) - 1.0) % (2 * np.pi)
    assert np.all((exact - encoder >= -1e-9) & (exact - encoder < 2 * np.pi / 3600 + 1e-9))
    rises = np.flatnonzero(np.diff(pulse) > 0) + 1
    assert np.all(encoder[rises] < 0.1)
    assert recording.channels[-1] == Channel("encoder", "angle", "rad", "spindle")
