"""Laws of the FRF of an impact test, on recordings of known structures."""

import re
from dataclasses import replace

import numpy as np
import pytest

from millcal.data import Channel
from millcal.errors import IllPosedError, MillcalError, RecordingError
from millcal.stages.frf import estimate_frf

NONE = (0.0, 0.0)
MEDIUM = (0.002, 0.005)


def kinds(hit):
    """The reasons against a hit, in one word each."""
    return {reason.split(":")[0] for reason in hit.reasons}


def turned(recording, dof):
    """The recording with one channel upside down."""
    row = next(i for i, channel in enumerate(recording.channels) if channel.dof == dof and channel.quantity != "force")
    samples = recording.samples.copy()
    samples[row] *= -1
    return replace(recording, samples=samples)


@pytest.mark.parametrize("system", ["A", "B"])
@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
def test_without_noise_every_estimator_gives_the_structure(impact_test, structures, relative_error, system, estimator):
    recording, _ = impact_test(np.random.default_rng(1), system, hits=3, noise=NONE)
    frf = estimate_frf(recording, estimator=estimator)
    assert relative_error(frf, structures[system].receptance, structures[system].band) < 1e-5
    inside = (frf.frequency >= structures[system].band[0]) & (frf.frequency <= structures[system].band[1])
    assert frf.coherence[inside].min() > 1 - 1e-8
    assert frf.multiple_coherence[inside].min() > 1 - 1e-8


@pytest.mark.parametrize("scale", [(1e3, 1.0), (1.0, 9.80665), (1e-3, 1e-3)])
def test_the_frf_scales_with_response_over_force(impact_test, scale):
    plain, _ = impact_test(np.random.default_rng(2), noise=MEDIUM)
    scaled, _ = impact_test(np.random.default_rng(2), noise=MEDIUM, scale=scale)
    a, b = estimate_frf(plain), estimate_frf(scaled)
    assert b.values == pytest.approx(a.values * scale[1] / scale[0], rel=1e-9)
    assert b.coherence == pytest.approx(a.coherence, rel=1e-9)
    assert b.variance == pytest.approx(a.variance * (scale[1] / scale[0]) ** 2, rel=1e-9)
    assert [hit.reasons for hit in b.hits] == [hit.reasons for hit in a.hits]


def test_forms_differ_by_powers_of_jw_and_have_no_value_where_that_divides_by_zero(impact_test):
    recording, _ = impact_test(np.random.default_rng(3))
    as_measured, mobility, receptance = (
        estimate_frf(recording, form=form) for form in (None, "mobility", "receptance")
    )
    jw = 2j * np.pi * as_measured.frequency[1:, None, None]
    assert as_measured.form == "accelerance"
    assert receptance.values[1:] * jw**2 == pytest.approx(as_measured.values[1:], rel=1e-12)
    assert mobility.values[1:] * jw == pytest.approx(as_measured.values[1:], rel=1e-12)
    assert receptance.variance[1:] * np.abs(jw) ** 4 == pytest.approx(as_measured.variance[1:], rel=1e-12)
    assert np.isfinite(as_measured.values).all()
    assert np.isnan(receptance.values[0]).all()
    assert np.isnan(mobility.values[0]).all()


def test_the_order_of_the_hits_does_not_matter(impact_test):
    recording, _ = impact_test(np.random.default_rng(4))
    shuffled = replace(recording, segments=recording.segments[np.random.default_rng(0).permutation(9)])
    a, b = estimate_frf(recording), estimate_frf(shuffled)
    assert b.values == pytest.approx(a.values, rel=1e-9)
    assert b.coherence == pytest.approx(a.coherence, rel=1e-9)


def test_hits_in_two_recordings_are_the_same_as_in_one(impact_test):
    recording, _ = impact_test(np.random.default_rng(5))
    parts = [replace(recording, segments=recording.segments[part]) for part in (slice(0, 4), slice(4, 9))]
    together, apart = estimate_frf(recording), estimate_frf(parts)
    assert apart.hits_used == (9,)
    assert apart.outputs == together.outputs
    inside = (together.frequency > 300) & (together.frequency < 3000)
    step = round(together.frequency[1] / apart.frequency[1])
    difference = apart.values[::step][inside] - together.values[inside]  # the windows differ a little
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(together.values[inside])


def test_a_single_hit_has_neither_coherence_nor_variance_and_says_so(impact_test):
    recording, _ = impact_test(np.random.default_rng(6), hits=1)
    frf = estimate_frf(recording)
    assert np.isnan(frf.coherence).all()
    assert np.isnan(frf.multiple_coherence).all()
    assert np.isnan(frf.variance).all()
    assert np.isfinite(frf.values).all()
    assert "single-hit" in {notice.code for notice in frf.notices}


def test_outputs_and_inputs_follow_the_order_of_channels_and_recordings(impact_test, structures, relative_error):
    a, _ = impact_test(np.random.default_rng(7), forces=("tipX",), responses=("headX", "tipX"), name="a.h5")
    b, _ = impact_test(np.random.default_rng(8), forces=("tipY",), responses=("headX", "tipX"), name="b.h5")
    frf = estimate_frf([b, a])
    assert frf.inputs == ("tipY", "tipX")
    assert frf.outputs == ("headX", "tipX")
    assert {hit.recording for hit in frf.hits} == {"a.h5", "b.h5"}
    assert relative_error(frf, structures["B"].receptance, (300, 3000)) < 0.08


def test_what_stands_in_no_recording_is_unknown_and_named(impact_test):
    a, _ = impact_test(np.random.default_rng(9), forces=("tipX",), responses=("tipX",))
    b, _ = impact_test(np.random.default_rng(10), forces=("tipY",), responses=("tipY",))
    frf = estimate_frf([a, b])
    assert np.isnan(frf.values[:, 0, 1]).all()
    assert np.isfinite(frf.values[:, [0, 1], [0, 1]]).all()
    assert np.isfinite(frf.multiple_coherence[1:]).all()
    assert "not-measured" in {notice.code for notice in frf.notices}


def test_a_three_axis_hammer_gives_all_inputs_at_once_by_least_squares(impact_test, structures, relative_error):
    directions = np.array([[1, 0.1], [0.9, -0.1], [0.2, 1], [-0.1, 0.9], [0.7, 0.7], [0.7, -0.6]])
    recording, _ = impact_test(
        np.random.default_rng(11), hits=6, noise=NONE, forces=("tipX", "tipY"), directions=directions
    )
    frf = estimate_frf(recording)
    assert frf.inputs == ("tipX", "tipY")
    assert relative_error(frf, structures["B"].receptance, structures["B"].band) < 1e-5
    noisy, _ = impact_test(np.random.default_rng(11), hits=6, forces=("tipX", "tipY"), directions=directions)
    found = estimate_frf(noisy)
    assert relative_error(found, structures["B"].receptance, structures["B"].band) < 0.1
    inside = (found.frequency > 300) & (found.frequency < 3000)
    assert np.median(found.multiple_coherence[inside]) > 0.95
    assert np.median(found.coherence[inside]) < 0.9  # each input alone explains a part only


def test_several_force_channels_hit_in_one_direction_only_are_refused(impact_test):
    directions = np.tile([1.0, 0.5], (5, 1))
    recording, _ = impact_test(
        np.random.default_rng(12), hits=5, noise=NONE, forces=("tipX", "tipY"), directions=directions
    )
    with pytest.raises(IllPosedError, match="one direction"):
        estimate_frf(recording)
    with pytest.raises(IllPosedError, match="1 usable hits for 2"):
        estimate_frf(replace(recording, segments=recording.segments[:1]))


def test_the_usable_band_ends_where_the_pulse_has_lost_20_db(impact_test, structures):
    """A half-sine of length d: |F| falls to a tenth at 1.3 / d or so, its first zero is at 1.5 / d."""
    recording, _ = impact_test(np.random.default_rng(13), "A")
    low, high = estimate_frf(recording).usable_band
    assert 1.0 / structures["A"].pulse < high < 1.5 / structures["A"].pulse
    assert low <= 2 * 25600 / 8192


def test_an_accelerometer_glued_on_the_other_side_is_noticed(impact_test):
    recording, _ = impact_test(np.random.default_rng(14), responses=("tipX",))
    assert not estimate_frf(recording).notices
    assert [notice.code for notice in estimate_frf(turned(recording, "tipX")).notices] == ["accelerometer-polarity"]


def test_one_turned_driving_point_among_several_is_named(impact_test):
    a, _ = impact_test(np.random.default_rng(15), forces=("tipX",))
    b, _ = impact_test(np.random.default_rng(16), forces=("tipY",))
    notices = estimate_frf([a, turned(b, "tipY")]).notices
    assert [notice.code for notice in notices] == ["driving-point-sign"]
    assert "tipY" in notices[0].message


def test_weak_double_and_overloaded_hits_are_left_out_with_their_reasons(impact_test):
    peaks = [700, 800, 80, 1100, 750, 850, 800]
    recording, _ = impact_test(
        np.random.default_rng(17), hits=7, peaks=peaks, second={1: (0.3, 8.0)}, overload={3: 0.15}, noise=MEDIUM
    )
    frf = estimate_frf(recording)
    assert [kinds(hit) for hit in frf.hits] == [set(), {"double"}, {"weak"}, {"overload"}, set(), set(), set()]
    assert [hit.accepted for hit in frf.hits] == [not hit.reasons for hit in frf.hits]
    assert frf.hits_used == (4,)


def test_a_hit_on_another_point_is_inconsistent(impact_test):
    recording, _ = impact_test(np.random.default_rng(18))
    other, _ = impact_test(np.random.default_rng(19), forces=("tipY",))
    samples = recording.samples.copy()
    start, count = recording.segments[6]
    samples[:, start : start + count] = other.samples[:, start : start + count]
    frf = estimate_frf(replace(recording, samples=samples))
    assert [hit.index for hit in frf.hits if not hit.accepted] == [6]
    assert kinds(frf.hits[6]) == {"inconsistent"}


def test_keep_and_drop_overrule_what_was_found(impact_test):
    recording, _ = impact_test(np.random.default_rng(20), second={1: (0.3, 8.0)})
    frf = estimate_frf(recording, keep=[1], drop=[0])
    assert [hit.accepted for hit in frf.hits] == [False] + 8 * [True]
    assert kinds(frf.hits[1]) == {"double"}
    assert kinds(frf.hits[0]) == {"dropped"}
    assert estimate_frf(recording, drop=["tap:0"]).hits_used == (7,)
    assert estimate_frf(recording, drop=["tap.h5:0"]).hits_used == (7,)


def test_keep_and_drop_must_name_a_hit_that_exists_in_a_recording_that_is_given(impact_test):
    recording, _ = impact_test(np.random.default_rng(21), hits=3)
    with pytest.raises(RecordingError, match="hits 0 to 2"):
        estimate_frf(recording, drop=[3])
    with pytest.raises(RecordingError, match="no recording is called other"):
        estimate_frf(recording, drop=["other:1"])
    with pytest.raises(RecordingError, match="say which one, as in tap:1"):
        estimate_frf([recording, replace(recording, name="b.h5")], drop=[1])


@pytest.mark.parametrize("after", [1.3, 8.0, 100.0])
def test_double_hits_give_the_right_frf_when_they_are_allowed(impact_test, structures, relative_error, after):
    recording, _ = impact_test(np.random.default_rng(22), hits=6, second={hit: (0.4, after) for hit in range(6)})
    with pytest.raises(IllPosedError, match="6 double"):
        estimate_frf(recording)
    frf = estimate_frf(recording, allow_double=True)
    assert frf.hits_used == (6,)
    assert relative_error(frf, structures["B"].receptance, structures["B"].band) < 0.08


def test_a_continuous_recording_gives_what_its_segments_give(impact_test, structures, relative_error):
    recording, onsets = impact_test(np.random.default_rng(23), seconds=0.5)
    frf = estimate_frf(recording)
    assert [hit.onset for hit in frf.hits] == pytest.approx(onsets, abs=1e-4)
    assert all(hit.accepted for hit in frf.hits)
    assert relative_error(frf, structures["B"].receptance, structures["B"].band) < 0.06


def test_a_recording_on_disk_gives_the_same_as_in_memory(impact_test):
    recording, _ = impact_test(np.random.default_rng(24), seconds=0.5)

    class OnDisk:
        shape = recording.samples.shape

        def read_block(self, start, stop):
            return recording.samples[:, start:stop]

    there = replace(recording, samples=OnDisk())
    assert (estimate_frf(there).values == estimate_frf(recording).values).all()


def test_the_next_hit_cuts_the_record_earlier_and_a_ringing_start_is_told(impact_test):
    recording, _ = impact_test(np.random.default_rng(25), "A", seconds=0.08, hits=6)
    frf = estimate_frf(recording, hold_off=0.02, keep=range(6))
    assert frf.hits_used == (6,)
    assert "truncated" in {notice.code for notice in frf.notices}


def test_a_recording_that_starts_with_the_pulse_takes_its_rest_from_the_end(impact_test, structures, relative_error):
    recording, onsets = impact_test(np.random.default_rng(26), hits=3, seconds=0.6)
    start = int(onsets[0] * 25600) - 5
    cut = replace(recording, samples=recording.samples[:, start:])
    frf = estimate_frf(cut)
    assert [hit.accepted for hit in frf.hits] == [True] * 3
    assert relative_error(frf, structures["B"].receptance, structures["B"].band) < 0.1


def test_more_resolution_by_zeros_adds_lines_and_moves_none(impact_test):
    recording, _ = impact_test(np.random.default_rng(27))
    coarse, fine = estimate_frf(recording), estimate_frf(recording, resolution=0.5 * 25600 / 8192)
    assert fine.frequency[::2] == pytest.approx(coarse.frequency)
    assert fine.values[::2] == pytest.approx(coarse.values, rel=1e-6, abs=1e-9)


def test_a_gap_of_missing_samples_costs_its_hit_only(impact_test):
    recording, _ = impact_test(np.random.default_rng(28))
    samples = recording.samples.copy()
    samples[2, recording.segments[4, 0] + 500] = np.nan
    frf = estimate_frf(replace(recording, samples=samples))
    assert [hit.index for hit in frf.hits if not hit.accepted] == [4]
    assert kinds(frf.hits[4]) == {"gap"}
    assert np.isfinite(frf.values).all()


def test_a_dead_channel_is_named_and_does_not_spoil_the_others(impact_test):
    recording, _ = impact_test(np.random.default_rng(29))
    samples = recording.samples.copy()
    samples[2] = 0.0
    frf = estimate_frf(replace(recording, samples=samples))
    assert frf.hits_used == (9,)
    assert [notice.code for notice in frf.notices] == ["dead-channel"]
    assert (frf.values[:, 1] == 0).all()


def without(recording, quantity):
    rows = [i for i, channel in enumerate(recording.channels) if channel.quantity != quantity]
    return replace(recording, samples=recording.samples[rows], channels=tuple(recording.channels[i] for i in rows))


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda r: without(r, "force"), "no force channel"),
        (lambda r: without(r, "acceleration"), "no acceleration"),
        (lambda r: replace(r, channels=(r.channels[0], *[replace(c, dof="tipX") for c in r.channels[1:]])), "two channels"),
        (lambda r: replace(r, segments=None, samples=np.zeros((4, 50_000))), "no hit found"),
        (lambda r: replace(r, segments=np.array([[0, 100]])), "at least 128"),
    ],
)  # fmt: skip
def test_a_recording_that_is_no_impact_test_is_refused_by_name(impact_test, spoil, word):
    recording, _ = impact_test(np.random.default_rng(30), hits=2)
    with pytest.raises(RecordingError, match=rf"^tap\.h5: .*{word}"):
        estimate_frf(spoil(recording))


def test_recordings_of_one_frf_have_one_rate_and_one_sensor_at_a_dof(impact_test):
    recording, _ = impact_test(np.random.default_rng(31), hits=2)
    with pytest.raises(RecordingError, match="one rate"):
        estimate_frf([recording, replace(recording, sample_rate=51200.0)])
    channels = tuple(
        Channel(c.name, "velocity", "m/s", c.dof) if c.quantity != "force" else c for c in recording.channels
    )
    with pytest.raises(RecordingError, match="different dofs"):
        estimate_frf([recording, replace(recording, channels=channels)])


def test_velocity_and_displacement_sensors_keep_their_form(impact_test):
    recording, _ = impact_test(np.random.default_rng(32), hits=3, noise=NONE)
    for quantity, unit, form in (("velocity", "m/s", "mobility"), ("displacement", "m", "receptance")):
        channels = tuple(
            Channel(c.name, quantity, unit, c.dof) if c.quantity != "force" else c for c in recording.channels
        )
        assert estimate_frf(replace(recording, channels=channels)).form == form


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"resolution": 1e-6}, "resolution 1e-06 Hz: give"),
        ({"resolution": 0.0}, "resolution 0 Hz: give"),
        ({"record_length": 1e-4}, "record_length 0.0001 s"),
        ({"record_length": 100.0}, "record_length 100 s"),
        ({"delays": {"tipX": float("nan")}}, "delay tipX=nan"),
        ({"delays": {"tipX": 0.5}}, "delay tipX=0.5"),
        ({"keep": (2,), "drop": (2,)}, "one hit is in both"),
    ],
)
def test_options_that_no_impact_test_has_are_refused(impact_test, options, said):
    recording, _ = impact_test(np.random.default_rng(0), hits=4)
    with pytest.raises(MillcalError, match=re.escape(said)):
        estimate_frf(recording, **options)
