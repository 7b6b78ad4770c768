"""Conditioning of cuts whose truth is known: what is cut, what is taken out, what is said."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.errors import RecordingError
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge, force_harmonics
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.conditioning import condition_cut

RATE = 10_000.0
SPINDLE = 119.371  # Hz: 83.77 samples per revolution
CUTTER = Cutter(0.012, 2, np.radians(30))
LAW = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
FORCES = tuple(Channel("f" + axis, "force", "N", "tip" + axis.upper()) for axis in "xyz")
PULSE = Channel("pulse", "pulse", "1", "spindle")


def conditions(frequency=SPINDLE):
    return CuttingConditions(2 * np.pi * frequency, 0.1e-3, 2e-3, 12e-3, "slot")


def truth():
    """Harmonics of a two-tooth force with runout, (axis, 11)."""
    rng = np.random.default_rng(0)
    c = rng.standard_normal((3, 11)) + 1j * rng.standard_normal((3, 11))
    c *= np.array([100, 30, 100, 5, 40, 2, 20, 1, 10, 1, 5])
    c[:, 0] = [-60.0, 120.0, 70.0]
    return c


def cut(
    seconds=1.0,
    *,
    air=0.0,
    ramp=0.0,
    frequency=SPINDLE,
    stated=None,
    noise=0.0,
    offset=0.0,
    drift=0.0,
    phase=0.4,
    rate=RATE,
    seed=0,
    harmonics=None,
    wander=0.0,
):
    """A recording: air, linear ramp, steady cut, ramp, air."""
    n = round((seconds + 2 * air + 2 * ramp) * rate)
    t = np.arange(n) / rate
    angle = 2 * np.pi * frequency * t + phase + wander * np.sin(2 * np.pi * 3.3 * t)
    c = truth() if harmonics is None else harmonics
    force = np.real(c @ np.exp(1j * np.outer(np.arange(c.shape[1]), angle)))
    if air or ramp:
        end = air + 2 * ramp + seconds
        share = np.minimum(t - air, end - t) / ramp if ramp else np.where((t >= air) & (t < end), 1.0, 0.0)
        force *= np.clip(share, 0, 1)
    force += noise * np.random.default_rng(seed).standard_normal(force.shape)
    force += np.broadcast_to(offset, 3)[:, np.newaxis] + np.outer(np.broadcast_to(drift, 3), t)
    return Recording(
        samples=force,
        sample_rate=rate,
        channels=FORCES,
        name="cut.h5",
        cutter=CUTTER,
        conditions=conditions(stated or frequency),
    )


def codes(result):
    return {notice.code for notice in result.notices}


def at_first_steady_sample(result, harmonics, phase=0.4, frequency=SPINDLE):
    """The truth in the result's angle, which starts at the first steady sample."""
    start = phase + 2 * np.pi * frequency * result.steady[0]
    return harmonics * np.exp(1j * start * np.arange(harmonics.shape[1]))


@pytest.mark.parametrize("frequency", [SPINDLE, 100.0, 33.337, 400.01])
def test_a_noise_free_cut_gives_its_harmonics_mean_and_speed_exactly(frequency):
    result = condition_cut(cut(frequency=frequency))
    assert result.spindle_frequency == pytest.approx(frequency, rel=1e-7)
    expected = at_first_steady_sample(result, truth(), frequency=frequency)
    assert np.abs(result.harmonics[:, :11] - expected).max() < 1e-6
    assert result.harmonics[:, 0].real == pytest.approx([-60.0, 120.0, 70.0], abs=1e-9)
    assert result.revolutions == int(frequency + 1e-9)
    assert result.asynchronous_rms.max() < 1e-5
    assert result.synchronous_share == pytest.approx(1.0)
    assert result.steady == (0.0, 1.0)


def test_the_mean_over_whole_revolutions_is_free_of_the_part_that_is_left_over():
    """Half a revolution too many moves the mean of all rows, never the mean over whole revolutions."""
    result = condition_cut(cut(9.5 / SPINDLE))
    assert result.revolutions == 9
    assert result.harmonics[:, 0].real == pytest.approx(truth()[:, 0].real, abs=1e-6)
    assert np.abs(result.mean_all_rows - truth()[:, 0].real).max() > 0.1
    assert result.mean_all_rows == pytest.approx(cut(9.5 / SPINDLE).samples.mean(axis=1))
    assert result.revolution_means.shape == (3, 9)
    assert result.revolution_means == pytest.approx(np.tile(truth()[:, :1].real, 9), abs=1e-6)


def test_the_mean_at_a_whole_number_of_samples_per_revolution_is_the_plain_mean_of_those_rows():
    recording = cut(1.0001, frequency=100.0, noise=5.0)
    result = condition_cut(recording)
    assert result.revolutions == 100
    assert result.harmonics[:, 0].real == pytest.approx(recording.samples[:, :10_000].mean(axis=1), abs=1e-10)


def test_power_splits_exactly_into_synchronous_and_asynchronous():
    result = condition_cut(cut(noise=20.0))
    synchronous = 0.5 * np.sum(np.abs(result.harmonics[:, 1:]) ** 2, axis=1)
    assert synchronous + result.asynchronous_rms**2 == pytest.approx(result.ac_rms**2, rel=2e-3)
    assert result.asynchronous_rms == pytest.approx(20.0, rel=0.02)


def test_the_stated_variance_of_the_harmonics_is_their_scatter_over_recordings():
    results = [condition_cut(cut(0.4, noise=30.0, seed=seed)) for seed in range(40)]
    found = np.array([result.harmonics for result in results])
    scatter = np.mean(np.abs(found - found.mean(axis=0)) ** 2, axis=0) * 40 / 39
    stated = np.mean([result.harmonics_variance for result in results], axis=0)
    assert np.mean(scatter[:, 1:]) / np.mean(stated[:, 1:]) == pytest.approx(1.0, abs=0.1)
    assert np.mean(scatter[:, 0]) / np.mean(stated[:, 0]) == pytest.approx(1.0, abs=0.5)
    speeds = np.array([result.spindle_frequency for result in results])
    assert np.std(speeds) / np.mean([result.spindle_frequency_sd for result in results]) == pytest.approx(1.0, abs=0.4)


def test_spindle_speed_with_noise_is_right_to_1e_5():
    found = [condition_cut(cut(noise=20.0, seed=seed)).spindle_frequency for seed in range(10)]
    assert np.abs(np.array(found) / SPINDLE - 1).max() < 1e-5


@pytest.mark.parametrize("error", [-0.07, 0.05])
def test_a_wrongly_stated_speed_is_measured_and_said(error):
    result = condition_cut(cut(noise=5.0, stated=SPINDLE * (1 + error)))
    assert result.spindle_frequency == pytest.approx(SPINDLE, rel=1e-5)
    assert result.harmonics[:, 0].real == pytest.approx(truth()[:, 0].real, abs=0.5)
    assert "speed-off" in codes(result)


def test_a_record_that_does_not_turn_with_the_spindle_keeps_the_stated_speed_and_says_so():
    result = condition_cut(cut(noise=20.0, harmonics=np.zeros((3, 11))))
    assert result.spindle_frequency == pytest.approx(SPINDLE)
    assert "not-synchronous" in codes(result)
    assert "asynchronous" in codes(result)


# -- steady cut and air


@pytest.mark.parametrize("noise", [0.0, 10.0])
@pytest.mark.parametrize("ramp_revolutions", [0, 2, 5, 10])
def test_the_steady_cut_is_found_within_a_revolution_between_ramps_and_air(ramp_revolutions, noise):
    ramp = ramp_revolutions / SPINDLE
    result = condition_cut(cut(1.0, air=0.3, ramp=ramp, noise=noise))
    start, stop = result.steady
    revolution = 1 / SPINDLE
    assert start == pytest.approx(0.3 + ramp, abs=revolution)
    assert stop == pytest.approx(1.3 + ramp, abs=revolution)
    before, after = result.air
    assert before == pytest.approx((0.0, 0.3), abs=2.5 * revolution)
    assert before[1] <= 0.3 + 1e-9
    assert after == pytest.approx((1.3 + 2 * ramp, 1.6 + 2 * ramp), abs=2.5 * revolution)
    assert after[0] >= 1.3 + 2 * ramp - 1e-9


def test_a_long_smooth_ramp_leaves_no_trace_in_the_mean():
    """A tool that enters over fifty revolutions; the foot of the ramp is within two per cent of the level."""
    recording = cut(1.0, air=0.2, ramp=50 / SPINDLE)
    t = np.arange(recording.samples.shape[1]) / RATE
    end = 0.2 + 100 / SPINDLE + 1.0
    share = np.clip(np.minimum(t - 0.2, end - t) / (50 / SPINDLE), 0, 1)
    force = np.real(truth() @ np.exp(1j * np.outer(np.arange(11), 2 * np.pi * SPINDLE * t)))
    result = condition_cut(replace(recording, samples=force * (0.5 - 0.5 * np.cos(np.pi * share))))
    assert result.harmonics[:, 0].real == pytest.approx(truth()[:, 0].real, rel=2e-4)
    assert result.steady[1] - result.steady[0] > 0.9


def test_a_record_that_is_all_cut_is_kept_whole():
    for seed in range(5):
        assert condition_cut(cut(1.0, noise=40.0, seed=seed)).steady == (0.0, 1.0)


def test_a_burst_within_the_cut_does_not_end_it():
    recording = cut(1.0, noise=2.0)
    samples = recording.samples.copy()
    samples[:, 4000:4150] *= 1.5
    assert condition_cut(replace(recording, samples=samples)).steady == (0.0, 1.0)


def test_two_cuts_in_a_record_are_told_and_the_longer_is_taken():
    one, two = cut(0.8, air=0.2), cut(1.2, air=0.2)
    result = condition_cut(replace(one, samples=np.hstack([one.samples, two.samples])))
    assert "several-cuts" in codes(result)
    assert result.steady == pytest.approx((1.4, 2.6), abs=2 / SPINDLE)


def test_stated_times_are_kept_and_those_of_the_call_win():
    recording = replace(cut(1.0, air=0.3), steady=(0.4, 1.2), air=((0.05, 0.25),))
    assert condition_cut(recording).steady == (0.4, 1.2)
    assert condition_cut(recording).air == ((0.05, 0.25),)
    assert condition_cut(recording, steady=(0.5, 1.0)).steady == (0.5, 1.0)
    assert condition_cut(recording, air=[(1.4, 1.6)]).air == ((1.4, 1.6),)


@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_offset_and_drift_are_taken_from_the_air_before_and_after(noise):
    offset, drift = np.array([12.0, -7.0, 3.0]), np.array([4.0, -2.0, 1.0])
    result = condition_cut(cut(2.0, air=0.5, ramp=0.05, offset=offset, drift=drift, noise=noise))
    middle = sum(result.steady) / 2
    assert result.removed_drift == pytest.approx(drift, abs=1e-9 + 0.1 * noise)
    assert result.removed_offset == pytest.approx(offset + drift * middle, abs=1e-3 + 0.1 * noise)
    assert result.harmonics[:, 0].real == pytest.approx([-60.0, 120.0, 70.0], abs=1e-3 + 0.1 * noise)
    (said,) = [notice for notice in result.notices if notice.code == "offset-removed"]
    assert "N/s" in said.message
    assert said.level == "note"


def test_air_on_one_side_gives_the_level_only():
    recording = cut(1.0, air=0.4, offset=5.0)
    result = condition_cut(replace(recording, samples=recording.samples[:, : round(1.3 * RATE)]))
    assert result.removed_offset == pytest.approx(5.0)
    assert np.all(result.removed_drift == 0)
    assert len(result.air) == 1
    (said,) = [notice for notice in result.notices if notice.code == "offset-removed"]
    assert "drift stays in" in said.message
    assert said.level == "warning"


def test_without_air_the_offset_stays_and_the_user_is_told_who_absorbs_it():
    result = condition_cut(cut(offset=5.0))
    assert np.all(result.removed_offset == 0)
    assert result.harmonics[:, 0].real == pytest.approx([-55.0, 125.0, 75.0], abs=1e-6)
    assert "edge coefficients absorb" in next(n.message for n in result.notices if n.code == "no-air-cut")


def test_offset_none_leaves_everything_in_and_offset_air_demands_air():
    result = condition_cut(cut(1.0, air=0.4, offset=5.0), offset="none")
    assert np.all(result.removed_offset == 0)
    assert "offset-kept" in codes(result)
    with pytest.raises(RecordingError, match="no air cut"):
        condition_cut(cut(), offset="air")


# -- phase


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_with_a_pulse_the_angle_is_zero_at_its_leading_edge(late):
    """The phase is right to a small part of a sample, although the edge falls between samples."""
    recording = cut(1.0, noise=1.0)
    edge = 2.0 + late  # rad, of the truth's angle
    angle = 2 * np.pi * SPINDLE * np.arange(10_000) / RATE + 0.4 - edge
    beside = (angle + np.pi) % (2 * np.pi) - np.pi
    step = 2 * np.pi * SPINDLE / RATE
    pulse = np.clip(beside / step + 0.5, 0, 1) * (beside < 0.5)
    result = condition_cut(replace(recording, samples=np.vstack([recording.samples, pulse]), channels=(*FORCES, PULSE)))
    assert result.phase_from_pulse
    expected = truth() * np.exp(1j * edge * np.arange(11))
    assert np.abs(np.angle(result.harmonics[:, 2] / expected[:, 2])).max() < 2e-3
    assert np.abs(result.harmonics[:, :11] - expected).max() < 0.6
    at_grid = np.real(expected @ np.exp(1j * np.outer(np.arange(11), result.average_angle)))
    assert np.sqrt(np.mean((result.average - at_grid) ** 2)) < 0.3
    assert not codes(result) & {"pulse-disagrees", "pulse-unusable"}


def test_the_phase_by_pulse_does_not_depend_on_where_the_steady_cut_begins():
    recording = cut(1.0, noise=0.5)
    pulse = (((SPINDLE * np.arange(10_000) / RATE) % 1) < 0.1).astype(float)
    recording = replace(recording, samples=np.vstack([recording.samples, pulse]), channels=(*FORCES, PULSE))
    early, late = (condition_cut(recording, steady=span) for span in ((0.0, 0.5), (0.4567, 1.0)))
    turn = np.angle(late.harmonics[:, 2] / early.harmonics[:, 2])
    assert np.abs(turn).max() < 0.02  # a square pulse is only known to a sample: 0.075 rad, averaged over revolutions


def test_a_pulse_that_contradicts_the_harmonics_is_said():
    recording = cut(1.0)
    pulse = (((1.03 * SPINDLE * np.arange(10_000) / RATE) % 1) < 0.1).astype(float)
    result = condition_cut(replace(recording, samples=np.vstack([recording.samples, pulse]), channels=(*FORCES, PULSE)))
    assert "pulse-disagrees" in codes(result)
    silent = np.zeros(10_000)
    result = condition_cut(
        replace(recording, samples=np.vstack([recording.samples, silent]), channels=(*FORCES, PULSE))
    )
    assert "pulse-unusable" in codes(result)
    assert not result.phase_from_pulse


# -- what is said of the cut


def test_chatter_lines_one_tooth_passing_apart_are_told():
    recording = cut(1.0, noise=1.0)
    t = np.arange(10_000) / RATE
    samples = recording.samples.copy()
    for f in (777.0, 777.0 - 2 * SPINDLE):
        samples[1] += 12.0 * np.cos(2 * np.pi * f * t)
    result = condition_cut(replace(recording, samples=samples))
    assert [round(peak.frequency) for peak in result.peaks if peak.axis == "y"] == [538, 777]
    assert result.peaks[-1].amplitude == pytest.approx(12.0, rel=0.05)
    assert "chatter-lines" in codes(result)
    assert "chatter-lines" not in codes(condition_cut(recording))


def test_a_wandering_spindle_is_told_and_noise_is_not_mistaken_for_it():
    assert "speed-wander" in codes(condition_cut(cut(1.0, wander=0.03)))
    assert "speed-wander" not in codes(condition_cut(cut(1.0, noise=30.0)))


def test_a_drifting_mean_is_told():
    assert "mean-drift" in codes(condition_cut(cut(drift=[40.0, 0.0, 0.0])))
    assert "mean-drift" not in codes(condition_cut(cut(noise=20.0)))


def test_clipped_forces_are_told_with_and_without_a_stated_range():
    recording = cut(noise=1.0)
    samples = np.clip(recording.samples, -150.0, 150.0)
    ranged = tuple(replace(channel, full_scale=150.0) for channel in FORCES)
    assert "clipped" in codes(condition_cut(replace(recording, samples=samples, channels=ranged)))
    assert "clipped" in codes(condition_cut(replace(recording, samples=samples)))
    assert "clipped" not in codes(condition_cut(recording))
    counts = replace(recording, samples=np.round(recording.samples))  # coarse steps are no clipping
    assert "clipped" not in codes(condition_cut(counts))


def test_few_revolutions_are_told_and_less_than_two_are_refused():
    assert "few-revolutions" in codes(condition_cut(cut(3.2 / SPINDLE)))
    with pytest.raises(RecordingError, match="at least 2"):
        condition_cut(cut(1.5 / SPINDLE))


def test_no_harmonic_is_kept_near_half_the_sample_rate():
    result = condition_cut(cut(frequency=400.01, rate=10_000.0))
    assert result.harmonics.shape[1] - 1 == int(0.45 * 10_000 / 400.01)
    assert "nyquist" in codes(result)


def test_fewer_harmonics_on_request_leave_the_asynchronous_share_as_it_is():
    few, many = condition_cut(cut(noise=3.0), harmonics=4), condition_cut(cut(noise=3.0))
    assert few.harmonics.shape == (3, 5)
    assert few.harmonics == pytest.approx(many.harmonics[:, :5])
    assert few.asynchronous_rms == pytest.approx(many.asynchronous_rms)


def test_the_low_pass_takes_high_harmonics_and_turns_none():
    recording = cut(1.2)  # room for the filter beside the steady cut, as ramps and air are
    plain = condition_cut(recording, steady=(0.1, 1.1))
    smooth = condition_cut(recording, steady=(0.1, 1.1), lowpass=300.0)
    ratio = smooth.harmonics[:, 1:11] / plain.harmonics[:, 1:11]
    f = SPINDLE * np.arange(1, 11)
    warped = np.tan(np.pi * f / RATE) / np.tan(np.pi * 300.0 / RATE)
    assert ratio.real.mean(axis=0) == pytest.approx(1 / (1 + (np.sqrt(2) - 1) * warped**8), abs=0.002)
    assert np.abs(ratio.imag).max() < 0.002
    assert smooth.harmonics[:, 0] == pytest.approx(plain.harmonics[:, 0], abs=0.02)
    assert smooth.lowpass == 300.0
    with pytest.raises(RecordingError, match="low-pass"):
        condition_cut(cut(), lowpass=6000.0)


def test_the_overview_is_the_envelope_of_the_whole_record():
    recording = cut(1.0, air=0.3, offset=5.0)
    result = condition_cut(recording)
    assert len(result.overview_time) <= 2000
    assert result.overview_low.min(axis=1) == pytest.approx(recording.samples.min(axis=1))
    assert result.overview_high.max(axis=1) == pytest.approx(recording.samples.max(axis=1))
    assert result.overview_time[-1] == pytest.approx(1.6, abs=2e-3)


# -- what cannot be used


def test_a_missing_axis_is_named_with_the_map():
    recording = cut()
    with pytest.raises(RecordingError, match=r"fz.*map"):
        condition_cut(replace(recording, samples=recording.samples[:2], channels=FORCES[:2]))


def test_what_is_no_number_is_refused_in_the_cut_and_harmless_outside():
    recording = cut(1.0, air=0.4)
    samples = recording.samples.copy()
    samples[1, 1000] = np.nan
    spoiled = replace(recording, samples=samples)
    result = condition_cut(spoiled, lowpass=2000.0)
    assert np.all(np.isfinite(result.harmonics))
    samples[2, 9000] = np.nan
    with pytest.raises(RecordingError, match=r"not a number at 0\.9 s"):
        condition_cut(replace(recording, samples=samples), steady=(0.5, 1.2))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"cutter": None}, "cutter"),
        ({"conditions": None}, "conditions"),
        ({"kind": "impact"}, "impact"),
        ({"conditions": conditions(5000.0)}, "samples per second"),
        ({"samples": np.zeros((3, 10_000))}, "never change"),
        ({"samples": np.full((3, 10_000), np.nan)}, "numbers"),
        ({"steady": (0.5, 3.0)}, "steady_s"),
        ({"air": ((2.0, 3.0),)}, "air_s"),
    ],
)
def test_what_is_no_cut_is_refused_in_one_line_that_says_what_to_do(change, word):
    with pytest.raises(RecordingError, match=word) as refused:
        condition_cut(replace(cut(), **change))
    assert str(refused.value).startswith("cut.h5: ")
    assert "\n" not in str(refused.value)


class OnDisk:
    """Samples that a function makes when they are asked for."""

    def __init__(self, make, channels, length):
        self.make, self.shape, self.largest = make, (channels, length), 0

    def read_block(self, start, stop):
        self.largest = max(self.largest, stop - start)
        return self.make(start, stop)


def test_samples_on_disk_give_the_same_result_block_by_block(monkeypatch):
    from millcal.numerics import revolutions

    recording = cut(3.0, air=0.5, noise=5.0, offset=4.0)
    on_disk = OnDisk(lambda start, stop: recording.samples[:, start:stop], *recording.samples.shape)
    plain = condition_cut(recording, lowpass=2000.0)
    monkeypatch.setattr(revolutions, "WHOLE_RECORD", 16_000)
    blocks = condition_cut(replace(recording, samples=on_disk), lowpass=2000.0)
    assert blocks.harmonics == pytest.approx(plain.harmonics, abs=1e-8)
    assert blocks.steady == plain.steady
    assert blocks.air == plain.air
    assert blocks.average == pytest.approx(plain.average, abs=1e-8)
    assert np.array_equal(blocks.overview_low, plain.overview_low)


@pytest.mark.long
def test_a_long_recording_never_lies_in_memory():
    """Six million samples of three forces would be 144 MB."""
    import tracemalloc

    c, rng = truth(), np.random.default_rng(0)

    def make(start, stop):
        turn = np.exp(2j * np.pi * (SPINDLE / RATE * np.arange(start, stop) % 1.0))
        force, power = 10 * rng.standard_normal((3, stop - start)), np.ones(stop - start, complex)
        for k in range(11):
            force += c[:, k : k + 1].real * power.real - c[:, k : k + 1].imag * power.imag
            power *= turn
        return force

    on_disk = OnDisk(make, 3, 6_000_000)
    tracemalloc.start()
    result = condition_cut(replace(cut(), samples=on_disk))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 80e6
    assert on_disk.largest <= 1 << 17
    assert result.spindle_frequency == pytest.approx(SPINDLE, rel=1e-8)
    assert np.abs(result.harmonics[:, :11] - c).max() < 0.05


def test_a_simulated_cut_with_a_pulse_gives_back_the_harmonics_of_its_force_law():
    """Offset, drift, ramps, a speed that misses the stated one, noise: what is left is the noise."""
    from millcal.physics.cutting_force import LinearEdge, force_harmonics
    from millcal.physics.measuring_chain import MeasuringChain
    from millcal.simulation import Timeline, simulate_cut

    law = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
    cutter = Cutter(16e-3, 3, np.pi / 6, runout=8e-6, runout_angle=0.4)
    down = CuttingConditions(2 * np.pi * 122.017, 60e-6, 2e-3, 8e-3, "down")
    recording, told = simulate_cut(
        law,
        cutter,
        down,
        rng=np.random.default_rng(1),
        sample_rate=20_000.0,
        timeline=Timeline(1.0, 0.3, 0.3, 0.1),
        initial_angle=1.1,
        speed_error=2e-4,
        dynamometer=MeasuringChain(noise=1.0, offset=(10.0, -5.0, 3.0), drift=(2.0, 1.0, -1.0)),
        pulse=True,
    )
    result = condition_cut(recording)
    assert result.spindle_frequency == pytest.approx(told["spindle_frequency_hz"], rel=2e-6)
    law_says, order = force_harmonics(law, cutter, down, 30), np.arange(31)
    error = result.harmonics - law_says
    turn = np.sum((law_says.conj() * error).imag * order) / np.sum(np.abs(order * law_says) ** 2)
    assert abs(turn) < 0.05 * 2 * np.pi / (20_000 / 122.017)  # a square pulse, timed to a twentieth of a sample
    error = result.harmonics * np.exp(-1j * turn * order) - law_says
    assert np.mean(np.abs(error[:, 1:]) ** 2) < 1.3 * np.mean(result.harmonics_variance[:, 1:])
    assert np.abs(error[:, 0]).max() < 0.05  # of the air cuts' noise, mostly


def test_the_stated_variance_of_the_mean_knows_of_the_air_cut():
    """Over many recordings the error of the mean is as large as its variance says, offset and drift being unknown."""
    errors, stated = [], []
    conditions = CuttingConditions(200 * np.pi, 1e-4, 2e-3, 16e-3, "slot")
    truth = force_harmonics(LAW, CUTTER, conditions, 0)[:, 0].real
    for seed in range(30):
        recording, _ = simulate_cut(
            LAW,
            CUTTER,
            conditions,
            rng=np.random.default_rng(seed),
            sample_rate=5000.0,
            timeline=Timeline(0.4, 0.1, 0.1, 0.05),
            dynamometer=MeasuringChain(noise=3.0, offset=(5.0, -4.0, 3.0), drift=(2.0, 1.0, -1.0)),
        )
        cut = condition_cut(recording, harmonics=4)
        errors.append(cut.harmonics[:, 0].real - truth)
        stated.append(cut.harmonics_variance[:, 0].real)
    ratio = np.mean(np.square(errors)) / np.mean(stated)
    assert 0.6 < ratio < 1.6  # 90 errors: the binomial scatter of their mean square is 15 %
