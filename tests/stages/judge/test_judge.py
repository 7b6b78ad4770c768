"""A cut is judged by what does not repeat with its teeth; what a record cannot tell is said."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.errors import RecordingError
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.stages.judge import judge_cut

RATE = 12_800.0
SPINDLE = 100.37  # Hz


def cut(
    lines=(),
    *,
    teeth=4,
    spindle=SPINDLE,
    seconds=2.0,
    noise=0.02,
    runout=0.2,
    rate=RATE,
    quantity="acceleration",
    unit="m/s^2",
    air=0.0,
    envelope=None,
    seed=0,
    alternating=0.0,
    stated=None,
):
    """Harmonics of teeth and of runout, and lines of (Hz, amplitude), with company a tooth passing away.

    runout : amplitude of the spindle's harmonics beside those of the teeth   envelope : of the lines, function of time
    alternating : amplitude at odd multiples of half the tooth passing
    """
    rng, time = np.random.default_rng(seed), np.arange(round(seconds * rate)) / rate
    y = np.zeros(len(time))
    for k in range(1, min(10 * teeth, int(0.45 * rate / spindle))):
        size = 1.0 if k % teeth == 0 else runout if k % teeth in (1, teeth - 1) else 0.0
        if teeth % 2 == 0 and k % teeth == teeth // 2:
            size = max(size, alternating)
        y += size / (1 + k / teeth) * np.cos(2 * np.pi * k * spindle * time + rng.uniform(0, 6.28))
    grow = np.ones(len(time)) if envelope is None else envelope(time)
    for frequency, amplitude in lines:
        y += grow * amplitude * np.cos(2 * np.pi * frequency * time + rng.uniform(0, 6.28))
    y = np.concatenate([np.zeros(round(air * rate)), y])
    y += noise * rng.normal(size=len(y))
    return Recording(
        samples=y[np.newaxis],
        sample_rate=rate,
        channels=(Channel("s", quantity, unit, "tipX"),),
        name="cut.h5",
        cutter=Cutter(diameter=12e-3, teeth=teeth),
        conditions=CuttingConditions(2 * np.pi * (stated or spindle), 0.1e-3, 1e-3, 3e-3, "down"),
    )


def company(frequency, amplitude=1.0, teeth=4, spindle=SPINDLE):
    """A chatter line and its neighbours a tooth passing to either side."""
    passing = teeth * spindle
    return [(frequency, amplitude), (frequency + passing, 0.3 * amplitude), (abs(frequency - passing), 0.3 * amplitude)]


def codes(found):
    return {notice.code for notice in found.notices}


def test_a_cut_that_repeats_with_every_tooth_is_stable_whatever_its_runout():
    for runout in (0.0, 0.5, 0.9):
        found = judge_cut(cut(runout=runout, stated=1.005 * SPINDLE))
        assert (found.verdict, found.period) == ("stable", 1), found.why
        assert found.spindle_frequency == pytest.approx(SPINDLE, rel=1e-5)
        assert found.chatter_frequency is None
        assert found.metric_relative < 0.15


def test_chatter_is_found_at_its_frequency_and_points_to_its_speeds():
    found = judge_cut(cut(company(918.4)))
    assert (found.verdict, found.period) == ("chatter", None)
    assert found.chatter_frequency == pytest.approx(918.4, abs=3 * found.chatter_frequency_sd)
    assert found.chatter_frequency_sd < 0.1
    rpm = 60 * np.array(found.stable_speeds) / (2 * np.pi)
    assert rpm[:3] == pytest.approx(60 * 918.4 / (4 * np.arange(1, 4)), rel=1e-4)
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=1e-5)


def test_the_lobes_of_a_published_sound_of_chatter():
    """Six teeth at a tooth passing of 165.6 Hz with chatter at 898.8 Hz: 8988, 4494, 2996, 2247 rpm."""
    spindle = 165.6 / 6
    found = judge_cut(
        cut(
            company(898.8, 2.0, 6, spindle), teeth=6, spindle=spindle, seconds=3.0, quantity="sound_pressure", unit="Pa"
        )
    )
    assert found.verdict == "chatter"
    assert 60 * np.array(found.stable_speeds[:4]) / (2 * np.pi) == pytest.approx([8988, 4494, 2996, 2247], rel=1e-4)


@pytest.mark.parametrize("offset", [0.03, 0.1, 0.47])
def test_chatter_beside_a_harmonic_of_the_spindle_is_seen(offset):
    """offset : in turns of the spindle"""
    f = (9 + offset) * SPINDLE
    found = judge_cut(cut(company(f), seconds=3.0))
    assert found.verdict == "chatter", found.why
    assert found.chatter_frequency == pytest.approx(f, abs=0.2)


@pytest.mark.parametrize(("teeth", "n"), [(1, 2), (3, 2), (4, 3), (5, 2)])
def test_a_line_at_a_fraction_of_the_tooth_passing_is_a_motion_of_that_period(teeth, n):
    passing = teeth * SPINDLE
    f = (round(900 / passing) + 1 / n) * passing
    found = judge_cut(cut(company(f, 1.0, teeth), teeth=teeth, seconds=2.0))
    assert (found.verdict, found.period) == ("period-n", n), found.why


def test_every_other_tooth_of_four_that_cuts_otherwise_is_a_flip():
    found = judge_cut(cut(alternating=2.0, runout=0.1))
    assert (found.verdict, found.period) == ("period-n", 2), found.why
    assert found.chatter_frequency / SPINDLE % 4 == pytest.approx(2.0, abs=1e-3)
    assert found.metric > 0


def test_with_two_teeth_a_flip_and_strong_runout_look_the_same_and_that_is_said():
    found = judge_cut(cut(teeth=2, alternating=1.0))
    assert found.verdict == "not known"
    assert "runout" in found.why
    assert "flip" in found.why


def test_a_measured_runout_tells_the_two_apart():
    alternating = cut(teeth=2, alternating=1.0)
    small = replace(alternating, cutter=Cutter(diameter=12e-3, teeth=2, runout=0.3e-6))
    large = replace(alternating, cutter=Cutter(diameter=12e-3, teeth=2, runout=45e-6))
    assert judge_cut(small).verdict == "period-n"
    assert judge_cut(large).verdict == "stable"


def test_alternation_that_grows_while_the_tooth_passing_does_not_is_a_flip():
    steady, time = cut(teeth=2, runout=0.0, seconds=2.0), np.arange(round(2 * RATE)) / RATE
    swing = (
        6.0
        * np.exp(3 * (time - 2.0))
        * sum(np.cos(2 * np.pi * p * SPINDLE * time) / (1 + p / 2) for p in (1, 3, 5, 7, 9))
    )
    found = judge_cut(replace(steady, samples=steady.samples + swing))
    assert (found.verdict, found.period) == ("period-n", 2), found.why
    assert "grows" in found.why


def test_a_tone_that_is_in_the_air_as_well_is_the_machines():
    recording = cut(air=1.0)
    time = np.arange(recording.samples.shape[1]) / RATE
    hum = 0.5 * np.cos(2 * np.pi * 1234.5 * time)
    found = judge_cut(replace(recording, samples=recording.samples + hum))
    assert found.verdict == "stable", found.why
    assert "not-of-the-cut" in codes(found)
    assert found.steady[0] > 1.0
    heard_once = judge_cut(replace(recording, samples=recording.samples + hum * (time > 1.0)))
    assert heard_once.verdict != "stable"


def test_hum_of_the_mains_is_no_chatter():
    found = judge_cut(cut([(50.0, 0.15), (250.0, 0.1)], seconds=3.0))
    assert found.verdict == "stable", found.why


def test_a_small_tone_without_company_is_not_known():
    found = judge_cut(cut([(1234.5, 0.3)], teeth=3))
    assert found.verdict == "not known"
    assert "air cut" in found.why
    with_company = judge_cut(cut(company(1234.5, 0.3, 3), teeth=3))
    assert with_company.verdict == "chatter"


def test_high_harmonics_that_come_back_folded_are_no_chatter():
    recording = cut(noise=0.01, rate=3000.0, seconds=4.0)
    time = np.arange(recording.samples.shape[1]) / 3000.0
    folded = sum(0.08 * np.cos(2 * np.pi * 4 * SPINDLE * k * time) for k in (4, 5, 6))
    found = judge_cut(replace(recording, samples=recording.samples + folded))
    assert found.verdict == "stable", found.why


def test_chatter_that_begins_during_the_cut_is_seen_and_its_growth_told():
    found = judge_cut(cut(company(918.4, 3.0), envelope=lambda t: np.exp(6 * (t - 2.0)), seconds=2.0))
    assert found.verdict == "chatter"
    assert "grows" in found.why


def test_a_ringing_that_dies_away_after_entry_is_no_chatter():
    found = judge_cut(cut(company(918.4, 3.0), envelope=lambda t: np.exp(-8 * t), seconds=2.0))
    assert found.verdict == "stable", found.why


def test_a_spindle_that_wanders_is_no_chatter():
    rng, time = np.random.default_rng(1), np.arange(round(3 * RATE)) / RATE
    phase = 2 * np.pi * SPINDLE * time + 2 * np.pi * SPINDLE * 0.001 / (2 * np.pi * 1.3) * np.sin(
        2 * np.pi * 1.3 * time
    )
    y = sum(np.cos(4 * k * phase + k) / k for k in range(1, 12)) + 0.02 * rng.normal(size=len(time))
    found = judge_cut(replace(cut(seconds=3.0), samples=y[np.newaxis]))
    assert found.verdict == "stable", found.why


def test_few_turns_show_chatter_but_not_its_absence():
    assert judge_cut(cut(seconds=6.5 / SPINDLE)).verdict == "not known"
    assert judge_cut(cut(company(955.0, 2.0), seconds=12 / SPINDLE)).verdict == "chatter"


def test_the_metric_of_a_displacement_is_the_mean_change_from_tooth_to_tooth():
    """M of a cosine at f over the tooth passing F is 4 a |sin(pi f / F)| / pi."""
    f, size = 918.4, 1.0
    found = judge_cut(cut([(f, size)], noise=1e-6, runout=0.0, quantity="displacement", unit="m", seconds=4.0))
    expected = 4 / np.pi * abs(np.sin(np.pi * f / (4 * SPINDLE))) * size
    assert found.metric == pytest.approx(expected, rel=0.02)


def test_runout_is_not_in_the_metric():
    found = judge_cut(cut(runout=1.0, noise=1e-4))
    assert found.metric < 5e-4


def test_of_several_sensors_the_one_that_hears_chatter_is_told():
    quiet, loud = cut(), cut(company(918.4))
    both = replace(
        quiet,
        samples=np.concatenate([quiet.samples, loud.samples]),
        channels=(Channel("a", "acceleration", "m/s^2", "tipX"), Channel("b", "acceleration", "m/s^2", "tipY")),
    )
    assert (judge_cut(both).channel, judge_cut(both).verdict) == ("b", "chatter")
    assert judge_cut(both, channel="a").verdict == "stable"


def test_a_pulse_per_revolution_gives_the_speed_where_the_signal_does_not():
    recording = cut(noise=3.0, runout=0.0)
    time = np.arange(recording.samples.shape[1]) / RATE
    pulse = ((time * SPINDLE) % 1.0 < 0.03).astype(float)
    found = judge_cut(
        replace(
            recording,
            samples=np.concatenate([recording.samples, pulse[np.newaxis]]),
            channels=(*recording.channels, Channel("pulse", "pulse", "1", "spindle")),
        ),
        spindle_speed=2 * np.pi * 1.02 * SPINDLE,
    )
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=2e-4)


def test_noise_that_holds_no_cut_is_not_known():
    recording = cut()
    noise = np.random.default_rng(3).normal(size=recording.samples.shape)
    found = judge_cut(replace(recording, samples=noise))
    assert found.verdict == "not known"
    assert "not-synchronous" in codes(found)


def test_a_sample_rate_that_cannot_show_chatter_is_told():
    slow = cut(rate=1800.0, seconds=4.0)
    assert "sample-rate" in codes(judge_cut(slow))
    assert "sample-rate" not in codes(judge_cut(cut()))
    assert "sample-rate" in codes(judge_cut(cut(), modes=(900.0, 7000.0)))
    assert "sample-rate" not in codes(judge_cut(slow, modes=(128.0,)))


def test_a_line_far_from_all_modes_is_held_against_its_aliases():
    found = judge_cut(cut(company(701.3, 2.0), rate=4000.0, seconds=4.0), modes=(3300.0,))
    assert "alias" in {notice.code for notice in found.notices if notice.level == "warning"}
    assert found.peaks[0].alias_of == pytest.approx(4000.0 - 701.3, abs=0.1)


def test_clipping_is_told():
    recording = cut(company(918.4))
    clipped = np.clip(recording.samples, -1.0, 1.0)
    assert "clipped" in codes(judge_cut(replace(recording, samples=clipped)))


def test_teeth_of_uneven_pitch_are_looked_at_once_a_turn():
    pitch = tuple(np.radians([85.0, 95.0, 85.0, 95.0]))
    recording = replace(cut(runout=1.0, alternating=2.0), cutter=Cutter(diameter=12e-3, teeth=4, pitch=pitch))
    found = judge_cut(recording)
    assert (found.verdict, found.period) == ("stable", 1)
    assert "uneven-pitch" in codes(found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cutter": None}, "--teeth"),
        ({"conditions": None}, "--rpm"),
        ({"channels": (Channel("p", "pulse", "1", ""),)}, "no channel of"),
        ({"steady": (1.0, 9.0)}, "steady_s"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(change, message):
    with pytest.raises(RecordingError, match=message):
        judge_cut(replace(cut(), **change))


def test_a_sample_that_is_no_number_is_told_with_its_time():
    recording = cut()
    broken = np.array(recording.samples)
    broken[0, 12_800] = np.nan
    with pytest.raises(RecordingError, match="at 1 s"):
        judge_cut(replace(recording, samples=broken, steady=(0.5, 1.9)))


def only_teeth(rate=RATE, seconds=2.0, spindle=SPINDLE, alone=(1.0, 0.6, 0.35, 0.2)):
    """Harmonics of four teeth and nothing of the spindle."""
    time = np.arange(round(seconds * rate)) / rate
    y = sum(a * np.cos(2 * np.pi * 4 * spindle * k * time + k) for k, a in enumerate(alone, 1))
    return y + 0.05 * np.random.default_rng(5).normal(size=len(time))


@pytest.mark.parametrize("off", [0.97, 0.972, 0.98, 0.985, 1.015, 1.02, 1.03])
def test_a_stable_cut_without_runout_is_stable_at_a_speed_stated_to_3_percent(off):
    found = judge_cut(replace(cut(stated=off * SPINDLE), samples=only_teeth()[np.newaxis]))
    assert found.verdict == "stable", found.why
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=1e-4)


@pytest.mark.parametrize("off", [0.9, 1.05, 1.18])
def test_harmonics_of_a_speed_that_is_not_the_stated_one_are_no_chatter(off):
    found = judge_cut(replace(cut(stated=off * SPINDLE), samples=only_teeth()[np.newaxis]))
    assert found.verdict == "not known", found.why
    assert f"{60 * SPINDLE:.5g} rpm" in found.why


def test_a_measured_runout_that_a_resonance_may_amplify_claims_no_flip():
    alternating = cut(teeth=2, alternating=1.0)
    for runout in (2e-6, 3e-6, 8e-6):
        found = judge_cut(replace(alternating, cutter=Cutter(diameter=12e-3, teeth=2, runout=runout)))
        assert found.verdict == "not known", found.why
        assert "amplifies" in found.why


def test_without_runout_teeth_that_cut_differently_flip():
    alternating = cut(teeth=2, alternating=1.0)
    found = judge_cut(alternating, no_runout=True)
    assert (found.verdict, found.period) == ("period-n", 2), found.why
    assert "no runout" in found.why
    assert judge_cut(cut(teeth=2, runout=0.0, alternating=0.05), no_runout=True).verdict == "stable"


@pytest.mark.parametrize("teeth", [2, 3, 4])
def test_noise_is_said_to_follow_nothing_whatever_the_teeth(teeth):
    recording = cut(teeth=teeth)
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(size=recording.samples.shape)
        found = judge_cut(replace(recording, samples=noise))
        assert found.verdict == "not known"
        assert "nothing" in found.why


def test_a_weak_line_in_company_is_not_passed_over():
    found = judge_cut(cut(company(918.4, 0.07), noise=0.01))
    assert found.verdict == "stable"
    assert "watch it" in found.why
    assert "all that stands out" not in found.why
    assert "all that stands out" in judge_cut(cut()).why


def test_no_tool_chatters_where_a_fast_recorder_folds():
    fast = judge_cut(cut(company(918.4), rate=44_100.0, seconds=1.0))
    assert fast.verdict == "chatter"
    assert all(peak.alias_of is None for peak in fast.peaks)
    assert "alias" not in codes(fast)


def test_tones_whole_turns_apart_tell_the_speed_that_no_harmonic_shows():
    """Heavy chatter with nothing of the harmonics above the noise, but what the cut modulates it by."""
    recording = cut(
        [(1261.7, 1.0), (1261.7 + SPINDLE, 0.06), (1261.7 + 4 * SPINDLE, 0.05)], noise=0.05, stated=1.002 * SPINDLE
    )
    quiet = cut(noise=0.0).samples[0]
    found = judge_cut(replace(recording, samples=recording.samples - quiet))
    assert (found.verdict, found.period) == ("chatter", None), found.why
    assert found.chatter_frequency == pytest.approx(1261.7, abs=0.1)
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=2e-4)


def test_one_line_far_above_the_noise_without_overtones_is_chatter_though_nothing_follows_the_spindle():
    quiet = cut(noise=0.0).samples[0]
    for lines, verdict in (([(2338.1, 1.0)], "chatter"), ([(2338.1, 1.0), (4676.2, 0.1)], "not known")):
        recording = cut(lines, noise=0.01)
        found = judge_cut(replace(recording, samples=recording.samples - quiet))
        assert found.verdict == verdict, found.why
        assert "not-synchronous" in codes(found)


def test_chatter_that_a_speed_nearby_would_make_a_harmonic_does_not_draw_the_speed():
    """At a speed 0.9 % lower the strongest line would be harmonic 15; its distances say otherwise."""
    passing = 4 * SPINDLE
    f = 15 * SPINDLE * 0.9912
    lines = [(f + k * passing, a) for k, a in ((0, 3.0), (1, 0.5), (-1, 0.5), (2, 0.1), (-2, 0.1))]
    lines += [(f + k * SPINDLE, 0.2) for k in (-1, 1)]
    recording = cut(lines, noise=0.3, seconds=0.6, runout=0.0)
    weak = cut(noise=0.0, seconds=0.6, runout=0.0).samples[0]
    found = judge_cut(replace(recording, samples=recording.samples - 0.97 * weak))
    assert found.verdict == "chatter", found.why
    assert found.chatter_frequency == pytest.approx(f, abs=1.0)
    assert found.spindle_frequency == pytest.approx(SPINDLE, rel=1e-3)


def test_a_large_harmonic_that_comes_back_folded_is_not_called_chatter():
    """Two thousand turns a second fold harmonic 15 of the teeth, on a mode above half the sample rate, into the middle."""
    above = 18 * 4 * SPINDLE
    assert above > RATE / 2
    found = judge_cut(cut([(RATE - above, 2.0)], runout=0.0))
    assert found.verdict == "not known"
    assert "comes back from above half the sample rate" in found.why
    assert judge_cut(cut([(RATE - above + 60.0, 2.0)], runout=0.0)).verdict == "chatter"


def test_chatter_at_a_multiple_of_50_hz_is_no_hum_where_the_mains_do_not_hum():
    assert judge_cut(cut(company(650.0, 0.35), runout=0.0)).verdict == "chatter"
    hum = [(50.0 * k, 0.2 / k) for k in (1, 3, 5, 9)]
    assert judge_cut(cut(hum, runout=0.0)).verdict == "stable"


def test_drift_of_a_short_record_is_no_chatter():
    recording = cut(seconds=0.25)
    time = np.arange(recording.samples.shape[1]) / RATE
    found = judge_cut(replace(recording, samples=recording.samples + 20 * time + 60 * time**2))
    assert found.verdict == "stable", found.why


def test_chatter_without_order_is_seen_though_it_hides_its_own_surroundings():
    rng = np.random.default_rng(4)
    recording = cut(runout=0.0, seconds=1.5)
    n = recording.samples.shape[1]
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    hump = np.exp(-0.5 * ((frequency - 1650.0) / 120.0) ** 2) * np.fft.rfft(rng.normal(size=n))
    wild = np.fft.irfft(hump, n)
    found = judge_cut(replace(recording, samples=recording.samples + 2.0 * wild / wild.std()))
    assert found.verdict == "chatter", found.why
    assert found.chatter_frequency == pytest.approx(1650.0, abs=150.0)


def test_fewer_than_three_samples_per_tooth_are_judged_and_two_are_refused():
    assert judge_cut(cut(teeth=6, spindle=400.3, rate=6400.0, seconds=1.0)).verdict == "stable"
    with pytest.raises(RecordingError, match="do not show the tooth passing"):
        judge_cut(cut(teeth=6, spindle=400.3, rate=4900.0))


@pytest.mark.parametrize("turns", [4, 6])
def test_fewer_than_eight_turns_never_claim_what_a_ringing_may_be(turns):
    ringing = [(1290.0, 0.6)]
    found = judge_cut(cut(ringing, seconds=turns / SPINDLE, envelope=lambda t: np.exp(-30 * t)))
    assert found.verdict == "not known", found.why


@pytest.mark.parametrize("stated", [9000.0, 9500.0, 12000.0, 12500.0])
def test_the_teeth_at_another_speed_are_no_chatter_though_some_harmonics_agree(stated):
    """At 9000 rpm eleven turns are nine of the true 11 000."""
    found = judge_cut(cut(teeth=1, spindle=11_000 / 60, seconds=0.7, stated=stated / 60))
    assert found.verdict == "not known"
    assert "11000 rpm" in found.why
    assert "not-synchronous" in codes(found)


@pytest.mark.parametrize("teeth", [1, 3])
def test_lines_of_a_flip_are_a_comb_of_this_speed(teeth):
    passing = teeth * SPINDLE
    lines = [((m + 0.5) * passing, 2.0 / (1 + abs(m - 4))) for m in range(9)]
    found = judge_cut(cut(lines, teeth=teeth, runout=0.0, seconds=1.0))
    assert (found.verdict, found.period) == ("period-n", 2), found.why
