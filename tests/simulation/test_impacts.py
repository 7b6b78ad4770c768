"""Simulated impact tests: X/F is the accelerance to rounding, and every fault is where it was asked for."""

import numpy as np
import pytest

from millcal.physics.hammer import HitFault, Pulse
from millcal.physics.measuring_chain import MeasuringChain, anti_alias
from millcal.physics.shaped_modes import ShapedMode, accelerance_between
from millcal.simulation import simulate_impact
from millcal.simulation.impacts import record_of_pulses

RATE = 25_600.0
DOFS = ("tipX", "noseX")
MODES = (
    ShapedMode(640.0, 0.03, 2e7, (("tipX", 1.0), ("noseX", 0.4))),
    ShapedMode(1500.0, 0.02, 3e7, (("tipX", 1.0), ("noseX", -0.2))),
)
HAMMER = MeasuringChain(noise=0.1, full_scale=500.0)
ACCELEROMETER = MeasuringChain(noise=0.05, full_scale=2000.0)


def impact(*, seed=1, hits=6, **options):
    options = {"record": 0.16, "peak": 300.0, "pulse": 0.25e-3, "onset_jitter": 1e-3} | options
    chains = {"hammer_chain": HAMMER, "accelerometer": ACCELEROMETER}
    rng = np.random.default_rng(seed)
    return simulate_impact(
        MODES, rng=rng, hammer="tipX", accelerometers=DOFS, sample_rate=RATE, hits=hits, **chains, **options
    )


def test_response_over_force_is_the_accelerance_to_rounding_at_any_onset():
    record = record_of_pulses([Pulse(0.0100137, 0.25e-3, 300.0)], MODES, "tipX", DOFS, RATE, 1 << 14)
    spectra = np.fft.rfft(record, axis=1)
    frequency = np.fft.rfftfreq(record.shape[1], 1 / RATE)
    expected = accelerance_between(frequency, MODES, DOFS, ["tipX"])[:, :, 0].T
    band = (frequency > 20) & (frequency < 5000)
    error = np.abs(spectra[1:] / spectra[0] - expected)[:, band].max()
    assert error < 1e-6 * np.abs(expected[:, band]).max()


def test_the_measured_force_is_the_half_sine_but_for_what_the_filter_takes():
    pulse = Pulse(0.01, 1e-3, 300.0)
    record = record_of_pulses([pulse], MODES, "tipX", DOFS, RATE, 4096)
    time = np.arange(4096) / RATE
    assert np.abs(record[0] - pulse.force(time)).max() < 0.02 * 300
    assert record[0].sum() / RATE == pytest.approx(300.0 * 2e-3 / np.pi, rel=1e-6)  # the impulse is whole


def test_the_pulse_s_spectrum_is_its_fourier_integral():
    pulse = Pulse(0.2e-3, 0.3e-3, 100.0)
    time = np.linspace(0, 0.6e-3, 60_001)
    frequency = np.array([0.0, 500.0, 1 / 0.6e-3, 4000.0, 5000.0])  # among them the removable pole and the first zero
    slow = np.trapezoid(pulse.force(time) * np.exp(-2j * np.pi * np.outer(frequency, time)), time, axis=1)
    assert pulse.spectrum(frequency) == pytest.approx(slow, abs=1e-9)
    assert abs(pulse.spectrum(np.array([1.5 / 0.3e-3]))[0]) < 1e-15


def test_the_anti_alias_filter_is_flat_below_and_nothing_at_half_the_rate():
    assert anti_alias(np.array([0.0, RATE / 2.56, RATE / 2]), RATE) == pytest.approx([1.0, 1.0, 0.0])


def test_hits_stand_in_segments_at_the_onsets_of_the_truth():
    recording, truth = impact()
    assert recording.kind == "impact"
    assert np.array_equal(recording.segments[:, 1], np.full(6, 4096))
    assert np.array_equal(recording.segments[:, 0], 4096 * np.arange(6))
    for (start, length), hit in zip(recording.segments, truth["hits"], strict=True):
        force = recording.samples[0, start : start + length]
        peak = start + np.argmax(force)
        assert peak / RATE == pytest.approx(hit["onset_s"] + hit["pulse_ms"] / 2e3, abs=1.5 / RATE)
        assert force.max() == pytest.approx(hit["peak_N"], rel=0.05)


def test_faults_are_where_they_were_asked_for():
    faults = (HitFault(1, "double", 0.4, 5e-3), HitFault(3, "overload", 1.4), HitFault(4, "weak", 0.05))
    recording, truth = impact(faults=faults, peak_spread=0.0)
    assert [hit["fault"] for hit in truth["hits"]] == [None, "double", None, "overload", "weak", None]
    force = recording.samples[0].reshape(6, 4096)
    clipped = np.sum(np.abs(force) >= HAMMER.full_scale * (1 - 1e-9), axis=1)
    assert clipped[3] >= 2
    assert np.all(np.delete(clipped, 3) == 0)
    late = int((0.01 + 1e-3 + 3e-3) * RATE)
    assert force[1, late:].max() == pytest.approx(0.4 * 300, rel=0.1)
    assert np.abs(np.delete(force, 1, axis=0)[:, late:]).max() < 3.0
    assert force[4].max() < 0.1 * 300


def test_in_a_continuous_recording_the_structure_still_moves_when_it_is_hit_again():
    slow = (ShapedMode(60.0, 0.02, 2e6, (("tipX", 1.0), ("noseX", 1.0))),)
    options = {"rng": None, "hammer": "tipX", "accelerometers": DOFS, "sample_rate": 5120.0, "hits": 2, "record": 0.25}
    options |= {"peak": 300.0, "pulse": 2e-3, "peak_spread": 0.0, "pulse_spread": 0.0}
    parts = {}
    for layout in ("segmented", "continuous"):
        recording, _ = simulate_impact(slow, **options | {"rng": np.random.default_rng(0)}, layout=layout)
        parts[layout] = recording
    assert parts["continuous"].segments is None
    first, second = parts["continuous"].samples.reshape(3, 2, -1).transpose(1, 0, 2)
    alone = parts["segmented"].samples[:, : first.shape[1]]
    assert first == pytest.approx(alone, abs=0.02 * np.abs(alone).max())
    assert np.abs(second[1, :40]).max() > 0.05 * np.abs(second[1]).max()
    tail = record_of_pulses([Pulse(0.01, 2e-3, 300.0)], slow, "tipX", DOFS, 5120.0, 2 * first.shape[1])[
        :, first.shape[1] :
    ]
    assert second[1:] == pytest.approx((first + tail)[1:], abs=1e-9 + 0.01 * np.abs(first[1:]).max())


def test_the_same_seed_gives_the_same_samples():
    assert np.array_equal(impact(seed=3)[0].samples, impact(seed=3)[0].samples)
    assert not np.array_equal(impact(seed=3)[0].samples, impact(seed=4)[0].samples)


def test_a_hit_on_a_dynamometer_shows_its_transfer_function_to_rounding_and_cross_talk_with_it():
    chain = MeasuringChain(resonance=(975.0, 790.0, 1000.0), damping_ratio=(0.02, 0.03, 0.05), cross_talk=0.02)
    for axis, dof in enumerate(("tipX", "tipY", "tipZ")):
        record = record_of_pulses([Pulse(0.0100137, 0.25e-3, 300.0)], (), dof, (), RATE, 1 << 15, dynamometer=chain)
        assert record.shape == (4, 1 << 15)
        spectra = np.fft.rfft(record, axis=1)
        frequency = np.fft.rfftfreq(record.shape[1], 1 / RATE)
        band = frequency < 5000
        expected = chain.transfer(frequency, 3)[:, axis]
        assert np.abs(spectra[1:] / spectra[0] - expected)[:, band].max() < 1e-6 * np.abs(expected[:, band]).max()
        assert expected[axis, 0] == 1.0


def test_the_dynamometer_s_channels_say_that_they_answer_the_hammer():
    recording, truth = impact(hits=2, dynamometer=MeasuringChain(full_scale=4000.0))
    assert [(c.name, c.role) for c in recording.channels[:4]] == [
        ("hammer", None),
        ("fx", "response"),
        ("fy", "response"),
        ("fz", "response"),
    ]
    assert truth["outputs"] == ["tipX", "tipY", "tipZ", *DOFS]
    assert recording.samples.shape[0] == 4 + len(DOFS)
