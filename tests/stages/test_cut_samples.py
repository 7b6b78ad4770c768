"""A cut sample by sample, against its truth: where it begins and ends, where the spindle stands, what is taken out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from millcal.data import Channel
from millcal.errors import RecordingError
from millcal.physics.changing_coefficients import Chip, Trend
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.spindle import SpindleMotion
from millcal.physics.tool_path import ToolPath
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.conditioning import condition_cut, sample_cut

SPINDLE = 39.87  # Hz: 125.4 samples per revolution at 5 kHz
CUTTER = Cutter(0.012, 2, np.radians(30), runout=8e-6, runout_angle=1.0)
DOWN = CuttingConditions(2 * np.pi * SPINDLE, 0.08e-3, 3e-3, 4e-3, "down")
LAW = Kienzle(np.array([1500e6, 420e6, 240e6]), np.array([0.21, 0.46, 0.34]))
MARK = np.radians(25)


@cache
def a_cut(
    seconds=1.5, *, rate=5000.0, air=0.4, ramp=0.1, noise=8.0, variation=0.0, drift=None, chip=None, seed=0, **more
):
    timeline = Timeline(seconds, air, air, ramp)
    begin, end = timeline.steady_span
    course = ((begin, 1.0), (end, 1.0 + (drift or 0.0)))
    chips = (Chip(begin + chip[0] * seconds, (chip[1],) * 3),) if chip else ()
    chain = MeasuringChain(noise=noise, lowpass=600.0, offset=(9.0, -14.0, 6.0), drift=(0.8, -0.5, 1.1))
    recording, _ = simulate_cut(
        LAW, CUTTER, DOWN, rng=np.random.default_rng(seed), sample_rate=rate, timeline=timeline, initial_angle=0.7,
        dynamometer=chain, pulse=True, pulse_angle=MARK, encoder=3600, variation=variation, variation_frequency=0.7,
        trend=Trend(drift=(course,) * 3, chips=chips) if drift or chip else None, name="cut.h5", **more,
    )  # fmt: skip
    return recording


def only(recording, *names):
    """The recording with some of its channels."""
    rows = [row for row, channel in enumerate(recording.channels) if channel.name in names]
    return replace(recording, samples=recording.samples[rows], channels=tuple(recording.channels[row] for row in rows))


def with_channel(recording, name, values):
    """The recording with other values in a channel."""
    samples = np.array(recording.samples)
    samples[[channel.name for channel in recording.channels].index(name)] = values
    return replace(recording, samples=samples)


def of_channel(recording, name):
    return np.array(recording.samples[[channel.name for channel in recording.channels].index(name)])


def angle_error(found, *, variation=0.0, constant=False):
    """Degrees by which the angle is off; `constant` leaves the constant that nobody states in."""
    time = found.start + np.arange(found.angle.size) / found.sample_rate
    error = found.angle - SpindleMotion(SPINDLE, 0.7, variation, 0.7).angle(time)
    if constant:
        return np.degrees((error + np.pi) % (2 * np.pi) - np.pi)
    return np.degrees(error - error.mean())


def codes(found):
    return {notice.code for notice in found.notices}


FORCES = ("fx", "fy", "fz")
SOURCES = {"speed": FORCES, "pulse": (*FORCES, "pulse"), "encoder": (*FORCES, "pulse", "encoder")}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("seconds", [12 / SPINDLE, 1.5, 60.0])
def test_the_angle_of_a_constant_speed_is_right_to_a_sixth_of_a_degree(source, seconds):
    """A sample is 2.9 degrees at 5 kHz: that is all that a single pulse knows."""
    rate = 5000.0 if seconds < 10 else 2000.0
    found = sample_cut(only(a_cut(seconds, rate=rate), *SOURCES[source]))
    assert found.angle_from == source
    assert np.abs(angle_error(found)).max() < 0.16
    assert 0 <= found.angle[0] < 2 * np.pi
    assert np.all(np.diff(found.angle) > 0)
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=2e-4)


def test_the_force_tells_a_constant_speed_better_than_pulses_known_to_a_sample():
    """Pulses alone are off by some hundredths of a degree that grow over the record, which an exponent would take for its own."""
    found = sample_cut(only(a_cut(6.0), *SOURCES["pulse"]))
    assert found.angle_from == "pulse"
    assert np.ptp(angle_error(found)) < 0.03


@pytest.mark.parametrize(("source", "limit"), [("speed", 0.6), ("pulse", 1.6), ("encoder", 0.1)])
@pytest.mark.parametrize("variation", [0.001, 0.01])
def test_a_slowly_varying_speed_is_followed(variation, source, limit):
    """At 1 % the spindle runs 30 degrees ahead and behind of uniform motion; a pulse is known to half a sample, 1.4 degrees."""
    found = sample_cut(only(a_cut(3.0, variation=variation), *SOURCES[source]))
    uniform = np.polynomial.Polynomial.fit(np.arange(found.angle.size), found.angle, 1)(np.arange(found.angle.size))
    assert np.degrees(np.ptp(found.angle - uniform)) > 4000 * variation
    assert np.abs(angle_error(found, variation=variation)).max() < limit


def test_noise_as_strong_as_a_quarter_of_the_cut_is_told_from_it():
    recording = only(a_cut(1.5, noise=40.0, drift=0.2), *FORCES)
    found = sample_cut(recording)
    assert 0.48 < found.start < 0.63
    assert 1.85 < found.start + found.force.shape[1] / 5000 < 2.02
    assert found.air_force.std(axis=1) == pytest.approx([40, 40, 40], rel=0.05)
    assert np.abs(angle_error(found)).max() < 0.3


def few_teeth_or_many(cutter, conditions, noise=8.0, air=0.3, **timeline):
    recording, _ = simulate_cut(
        LAW, cutter, conditions, rng=np.random.default_rng(0), sample_rate=5000.0, timeline=Timeline(0.6, air, air, **timeline),
        dynamometer=MeasuringChain(noise=noise, lowpass=600.0), name="cut.h5",
    )  # fmt: skip
    found = sample_cut(recording)
    return found.start, found.start + found.force.shape[1] / 5000


@pytest.mark.parametrize("ramp", [0.02, 0.05, 0.15])
def test_a_ramp_is_left_out_where_the_mean_force_outweighs_the_teeth(ramp):
    slot = replace(DOWN, radial_depth=12e-3, direction="slot")
    begin, end = few_teeth_or_many(replace(CUTTER, teeth=4, runout=0.0), slot, ramp=ramp)
    assert 0.3 + ramp <= begin < 0.3 + ramp + 0.12
    assert 0.9 + ramp - 0.12 < end <= 0.9 + ramp + 5e-3


def test_a_finishing_cut_not_much_above_its_noise_is_told_from_the_air():
    begin, end = few_teeth_or_many(CUTTER, replace(DOWN, radial_depth=0.3e-3), 9.0, 0.5, ramp=0.05)
    assert 0.52 < begin < 0.65
    assert 1.06 < end < 1.18


@pytest.mark.parametrize(("source", "phase"), [("speed", 0.7), ("pulse", MARK), ("encoder", MARK)])
def test_a_stated_phase_makes_the_angle_that_of_tooth_0(source, phase):
    found = sample_cut(only(a_cut(), *SOURCES[source]), spindle_phase=phase)
    assert found.angle_from == "stated"
    assert 0 <= found.angle[0] < 2 * np.pi
    assert np.abs(angle_error(found, constant=True)).max() < (1.2 if source == "pulse" else 0.2)
    assert sample_cut(replace(only(a_cut(), *SOURCES[source]), spindle_phase=phase)).angle == pytest.approx(found.angle)


def test_pulses_that_were_missed_or_doubled_do_not_move_the_angle():
    recording = only(a_cut(3.0), "fx", "fy", "pulse")
    pulse = of_channel(recording, "pulse")
    rises = np.flatnonzero(np.diff(pulse) > 0) + 1
    for rise in rises[[20, 21, 60]]:
        pulse[rise : rise + 5] = 0.0
    pulse[rises[40] + 40 : rises[40] + 43] = 1.0
    pulse[rises[80] + 8 : rises[80] + 10] = 1.0
    found = sample_cut(with_channel(recording, "pulse", pulse))
    assert np.abs(angle_error(found)).max() < 0.16
    said = next(notice.message for notice in found.notices if notice.code == "pulse-mended")
    assert said.startswith("pulses: 3 missed, 2 double")


def test_a_pulse_that_is_none_gives_way_to_the_speed():
    recording = only(a_cut(), "fx", "fy", "pulse")
    noise = (np.random.default_rng(1).random(recording.samples.shape[1]) > 0.97).astype(float)
    found = sample_cut(with_channel(recording, "pulse", noise))
    assert found.angle_from == "speed"
    assert "pulse-unusable" in codes(found)
    assert np.abs(angle_error(found)).max() < 0.16


def test_an_encoder_may_count_down_and_stumble_where_it_wraps_and_be_coarse():
    recording = a_cut()
    encoder = of_channel(recording, "encoder")
    down = sample_cut(with_channel(recording, "encoder", 2 * np.pi - encoder))
    assert np.abs(angle_error(down)).max() < 0.1
    assert "encoder-sense" in codes(down)
    wraps = np.flatnonzero(np.diff(encoder) < -3)
    stumbling = np.array(encoder)
    stumbling[wraps] = np.random.default_rng(2).uniform(0.5, 5.5, wraps.size)
    assert np.abs(angle_error(sample_cut(with_channel(recording, "encoder", stumbling)))).max() < 0.1
    rising = np.unwrap(encoder)
    assert sample_cut(with_channel(recording, "encoder", rising)).angle == pytest.approx(sample_cut(recording).angle)
    coarse = np.floor(encoder / (2 * np.pi) * 24) / 24 * 2 * np.pi
    assert np.abs(angle_error(sample_cut(with_channel(recording, "encoder", coarse)))).max() < 3.0


def test_an_encoder_in_another_unit_gives_way_to_the_pulse():
    recording = a_cut()
    found = sample_cut(with_channel(recording, "encoder", of_channel(recording, "encoder") / 8))
    assert found.angle_from == "pulse"
    assert "encoder-unusable" in codes(found)


@pytest.mark.parametrize("change", [{"drift": 0.5}, {"drift": -0.4}, {"chip": (0.4, 0.5)}, {"chip": (0.6, -0.4)}, {}])
@pytest.mark.parametrize("ramp", [0.02, 0.1, 0.3])
def test_wear_and_broken_edges_do_not_end_the_cut_and_ramps_do(change, ramp):
    recording = only(a_cut(3.0, ramp=ramp, **change), "fx", "fy", "fz", "pulse")
    found = sample_cut(recording)
    begin, end = 0.4 + ramp, 3.4 + ramp
    stop = found.start + found.force.shape[1] / found.sample_rate
    assert begin - 0.1 * ramp <= found.start <= begin + 5 / SPINDLE + 0.1 * ramp
    assert end + 0.1 * ramp >= stop >= end - 5 / SPINDLE - 0.1 * ramp


@pytest.mark.parametrize("change", [{"drift": 0.5}, {"chip": (0.4, 0.5)}])
def test_changing_coefficients_do_not_spoil_the_speed(change):
    found = sample_cut(only(a_cut(3.0, **change), *FORCES))
    assert found.angle_from == "speed"
    assert np.abs(angle_error(found)).max() < 0.05


def test_the_force_is_the_record_s_less_offset_and_drift_and_the_air_tells_its_noise():
    recording = a_cut(1.0)
    clean = a_cut(1.0, noise=0.0)
    found = sample_cut(recording)
    first = round(found.start * found.sample_rate)
    time = first / 5000 + np.arange(found.force.shape[1]) / 5000
    line = np.array([[9.0], [-14.0], [6.0]]) + np.outer([0.8, -0.5, 1.1], time)
    exact = clean.samples[:3, first : first + time.size] - line
    off = found.force - exact
    assert off.mean(axis=1) == pytest.approx([0, 0, 0], abs=0.5)
    assert off.std(axis=1) == pytest.approx([8, 8, 8], rel=0.03)
    assert found.air_force.std(axis=1) == pytest.approx([8, 8, 8], rel=0.05)
    assert np.abs(found.air_force.mean(axis=1)).max() < 0.1
    assert len(found.air_spans) == 2
    assert found.air_spans[1] == (found.air_spans[0][1], found.air_force.shape[1])
    assert "offset-removed" in codes(found)


def test_without_air_the_force_stays_as_it_is():
    recording = a_cut(1.0, air=0.0, ramp=0.0)
    found = sample_cut(recording)
    assert "no-air-cut" in codes(found)
    assert found.air_force.shape == (3, 0)
    assert np.array_equal(found.force, recording.samples[:3])


def test_the_axis_along_the_tool_may_be_missing_and_the_others_may_not():
    assert sample_cut(only(a_cut(), "fx", "fy")).axes == ("x", "y")
    with pytest.raises(RecordingError, match="no force channel for fy"):
        sample_cut(only(a_cut(), "fx", "fz"))


def test_the_conditions_stand_at_every_sample():
    found = sample_cut(a_cut())
    swept = np.arccos(1 - 2 * 4 / 12)
    for values, value in (
        (found.feed_per_tooth, 0.08e-3),
        (found.axial_depth, 3e-3),
        (found.entry, np.pi - swept),
        (found.leave, np.pi),
        (found.feed_direction, 0.0),
    ):
        assert values == pytest.approx(np.full(found.angle.size, value))
    assert found.conditions == DOWN


def test_air_alone_is_no_cut():
    rng = np.random.default_rng(0)
    recording = only(a_cut(), *FORCES)
    with pytest.raises(RecordingError, match=r"cut.h5: .* of the force follows the spindle"):
        sample_cut(replace(recording, samples=rng.normal(0, 8, recording.samples.shape)))


def test_what_is_no_number_is_refused_with_its_time_within_the_cut_only():
    recording = a_cut()
    force = of_channel(recording, "fy")
    force[round(1.1 * 5000)] = np.nan
    with pytest.raises(RecordingError, match=r"cut.h5: a force is not a number at 1.1 s, within the steady cut"):
        sample_cut(with_channel(recording, "fy", force))
    force = of_channel(recording, "fy")
    force[500] = np.nan
    found = sample_cut(with_channel(recording, "fy", force))
    assert np.isfinite(found.air_force).all()


def test_stated_times_are_kept_and_progress_is_told():
    told = []
    found = sample_cut(a_cut(), steady=(0.8, 1.4), air=[(0.05, 0.3)], progress=lambda share, label: told.append(share))
    assert found.start == 0.8
    assert found.force.shape[1] == 3000
    assert found.air_spans == ((0, 1250),)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_clipping_and_a_wrongly_stated_speed_are_said():
    recording = a_cut()
    clipped = with_channel(recording, "fy", np.minimum(of_channel(recording, "fy"), 300.0))
    assert "clipped" in codes(sample_cut(clipped))
    wrong = replace(recording, conditions=replace(DOWN, spindle_speed=1.04 * DOWN.spindle_speed))
    for source in SOURCES.values():
        found = sample_cut(only(wrong, *source))
        assert "speed-off" in codes(found)
        assert np.abs(angle_error(found)).max() < 0.2


PATH = ToolPath(
    position=np.array([0.0, 2e-3, 20e-3]), axial_depth=np.array([0.0, 2e-3, 4e-3]),
    entry=np.radians([90.0, 90.0, 120.0]), leave=np.radians([180.0, 180.0, 180.0]),
    feed_direction=np.radians([0.0, 0.0, 90.0]), name="path.csv",
)  # fmt: skip
RATE_OF_FEED = 0.08e-3 * 2 * SPINDLE


def test_an_engagement_table_is_followed_by_the_feed_rate():
    found = sample_cut(a_cut(), engagement=PATH, path_start=0.35)
    time = found.start + np.arange(found.angle.size) / found.sample_rate
    at = PATH.at(np.clip(RATE_OF_FEED * (time - 0.35), 0, 0.02))
    assert found.start < 0.5  # the ramp belongs to the cut: the table describes it
    for values, expected in zip((found.axial_depth, found.entry, found.leave, found.feed_direction), at, strict=False):
        assert values == pytest.approx(expected)
    assert found.conditions.axial_depth == 4e-3
    recorded = replace(a_cut(), engagement=PATH, path_start=0.35)
    assert sample_cut(recorded).axial_depth == pytest.approx(found.axial_depth)


def test_a_position_that_was_recorded_says_where_the_tool_is_and_how_it_feeds():
    recording = a_cut()
    time = np.arange(recording.samples.shape[1]) / 5000
    position = RATE_OF_FEED * np.where(time < 1.2, time - 0.35, 0.85 + 0.5 * (time - 1.2))
    samples = np.vstack([recording.samples, position])
    channels = (*recording.channels, Channel("s", "displacement", "m", "path"))
    found = sample_cut(replace(recording, samples=samples, channels=channels), engagement=PATH)
    at = found.start + np.arange(found.angle.size) / 5000
    expected = np.interp(np.interp(at, time, position), PATH.position, PATH.axial_depth)
    assert found.axial_depth == pytest.approx(expected)
    assert found.feed_per_tooth[at < 1.1] == pytest.approx(0.08e-3)
    assert found.feed_per_tooth[at > 1.3] == pytest.approx(0.04e-3)


def test_the_feed_of_the_table_wins_over_the_conditions():
    by_rate = replace(PATH, feed_rate=np.full(3, 1.5 * RATE_OF_FEED))
    found = sample_cut(a_cut(), engagement=by_rate, path_start=0.35)
    assert found.feed_per_tooth == pytest.approx(np.full(found.angle.size, 0.12e-3))
    by_tooth = replace(PATH, feed_per_tooth=np.full(3, 0.12e-3))
    assert sample_cut(a_cut(), engagement=by_tooth, path_start=0.35).axial_depth == pytest.approx(found.axial_depth)


@pytest.mark.parametrize(
    ("path", "start", "says"),
    [
        (PATH, None, "give path_start_s"),
        (replace(PATH, position=PATH.position / 5), 0.35, r"path.csv: the table ends at 4 mm, and the cut is at 1\d"),
        (PATH, 1.0, r"path.csv: the table begins at 0 mm, and the cut is at -"),
    ],
)
def test_a_table_that_does_not_cover_the_cut_is_refused(path, start, says):
    with pytest.raises(RecordingError, match=says):
        sample_cut(a_cut(), engagement=path, path_start=start)


def test_changing_engagement_without_pulse_or_encoder_is_warned_of():
    found = sample_cut(only(a_cut(), *FORCES), engagement=PATH, path_start=0.35)
    assert "angle-from-speed" in codes(found)


def test_a_cut_along_a_path_has_no_harmonics():
    with pytest.raises(RecordingError, match=r"cut.h5: .*engagement"):
        condition_cut(replace(a_cut(), engagement=PATH))
