"""What the user may ask of an FRF: an exponential window, delays, turned channels, several inputs, recordings that differ."""

import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from impact_cases import RATE

from millcal.data import Channel, Recording
from millcal.errors import IllPosedError, RecordingError
from millcal.stages.frf import estimate_frf

NONE, LOW = (0.0, 0.0), (0.0002, 0.0005)


def laplace(structure, s, outputs, inputs):
    """Accelerance at complex s.   returns (line, output, input)"""
    wn = 2 * np.pi * structure.natural_frequency
    poles = s[:, None] ** 2 / (s[:, None] ** 2 + 2 * structure.damping_ratio * wn * s[:, None] + wn**2)
    o, i = (structure.shape[[structure.dofs.index(dof) for dof in dofs]] for dofs in (outputs, inputs))
    return np.einsum("om,im,fm->foi", o, i, poles)


def off(frf, truth, band):
    inside = (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    return np.linalg.norm(frf.values[inside] - truth[inside]) / np.linalg.norm(truth[inside])


def at_shifted_s(frf, structure):
    return laplace(structure, frf.damping_shift + 2j * np.pi * frf.frequency, frf.outputs, frf.inputs)


def delayed(recording, late):
    """The recording with signals of some rows `late[row]` seconds behind, each hit for itself."""
    samples = recording.samples.copy()
    for start, count in recording.segments:
        own = samples[:, start : start + count]
        frequency = np.fft.rfftfreq(2 * count, 1 / RATE)
        for row, seconds in late.items():
            turn = np.exp(-2j * np.pi * frequency * seconds)
            own[row] = np.fft.irfft(np.fft.rfft(own[row], 2 * count) * turn, 2 * count)[:count]
    return replace(recording, samples=samples)


@pytest.mark.parametrize("end", [0.05, 1e-4])
def test_an_exponential_window_is_the_laplace_variable_moved_and_no_scale(impact_test, structures, end):
    """The H of the windowed signals is the truth at s = a + jw, exactly; pitfall 4 of the peers is another scale."""
    recording, _ = impact_test(np.random.default_rng(1), hits=3, noise=NONE)
    frf = estimate_frf(recording, exponential=end)
    assert frf.damping_shift == pytest.approx(np.log(1 / end) / (8192 / RATE))
    assert off(frf, at_shifted_s(frf, structures["B"]), (300, 3000)) < 1e-6
    assert "exponential-window" in {notice.code for notice in frf.notices}


def test_an_exponential_window_leaves_less_of_what_a_short_record_cuts_off(impact_test, structures):
    """What is lost at the end is multiplied by the window's value there."""
    recording, _ = impact_test(np.random.default_rng(2), hits=3, noise=NONE, length=600)
    plain, faded = estimate_frf(recording), estimate_frf(recording, exponential=0.001)
    error = off(plain, at_shifted_s(plain, structures["B"]), (300, 3000))
    assert error > 0.1
    assert off(faded, at_shifted_s(faded, structures["B"]), (300, 3000)) < 0.01 * error


@pytest.mark.parametrize("end", [0.0, 1.0, -1.0])
def test_an_exponential_window_ends_between_0_and_1(impact_test, end):
    recording, _ = impact_test(np.random.default_rng(3), hits=1)
    with pytest.raises(IllPosedError, match="exponential"):
        estimate_frf(recording, exponential=end)


@pytest.mark.parametrize("seconds", [12e-6, -7.3e-6, 3e-3])
@pytest.mark.parametrize("exponential", [None, 0.05])
def test_a_delay_that_is_stated_is_taken_off_exactly(impact_test, structures, seconds, exponential):
    """Positive where the response is behind the hammer. Of a whole channel, of a fraction of a sample, with any window."""
    recording, _ = impact_test(np.random.default_rng(4), hits=3, noise=NONE)
    late = delayed(recording, {1: seconds, 3: 2 * seconds})
    frf = estimate_frf(late, delays={"acc_tipX": seconds, "headX": 2 * seconds}, exponential=exponential)
    assert off(frf, at_shifted_s(frf, structures["B"]), (300, 3000)) < 1e-5
    assert off(estimate_frf(late), at_shifted_s(frf, structures["B"]), (300, 3000)) > 1e-2


def test_a_hammer_that_is_late_is_the_responses_early(impact_test, structures):
    recording, _ = impact_test(np.random.default_rng(5), hits=3, noise=NONE)
    frf = estimate_frf(delayed(recording, {0: 20e-6}), delays={"hammer_tipX": 20e-6})
    assert off(frf, at_shifted_s(frf, structures["B"]), (300, 3000)) < 1e-5


def test_a_channel_may_bring_its_own_delay_and_the_call_wins(impact_test, structures):
    recording, _ = impact_test(np.random.default_rng(6), hits=3, noise=NONE)
    late = delayed(recording, {1: 12e-6})
    own = replace(late, channels=tuple(replace(c, delay=12e-6) if c.name == "acc_tipX" else c for c in late.channels))
    assert off(estimate_frf(own), at_shifted_s(estimate_frf(own), structures["B"]), (300, 3000)) < 1e-5
    assert (estimate_frf(own, delays={"acc_tipX": 0.0}).values == estimate_frf(late).values).all()


def test_a_long_delay_costs_nothing_because_the_window_moves_with_the_response(impact_test):
    recording, _ = impact_test(np.random.default_rng(7), noise=LOW)
    samples = recording.samples.copy()
    for start, count in recording.segments:
        samples[1:, start : start + count] = np.roll(samples[1:, start : start + count], 128, axis=1)
    plain = estimate_frf(recording)
    late = estimate_frf(replace(recording, samples=samples), delays=dict.fromkeys(plain.outputs, 128 / RATE))
    inside = (plain.frequency > 300) & (plain.frequency < 3000)
    assert np.median(late.variance[inside] / plain.variance[inside]) == pytest.approx(1.0, abs=0.1)
    assert late.tests[0].window_stop == pytest.approx(plain.tests[0].window_stop, abs=150)


def test_a_driving_point_that_is_late_is_told_with_its_delay_and_one_in_time_is_not(impact_test):
    recording, _ = impact_test(np.random.default_rng(8), noise=LOW, responses=("tipX",))
    assert not estimate_frf(recording).notices
    (notice,) = estimate_frf(delayed(recording, {1: 20e-6})).notices
    assert notice.code == "response-late"
    assert "--delay tipX=" in notice.message
    assert 14 <= float(notice.message.split("--delay tipX=")[1].removesuffix("e-6")) <= 20


def turned(recording, *names):
    samples = recording.samples.copy()
    samples[[row for row, channel in enumerate(recording.channels) if channel.name in names]] *= -1
    return replace(recording, samples=samples)


@pytest.mark.parametrize("names", [("acc_tipX",), ("hammer_tipX",), ("acc_tipX", "acc_headX")])
def test_flip_turns_channels_back(impact_test, names):
    recording, _ = impact_test(np.random.default_rng(9), hits=3)
    frf = estimate_frf(turned(recording, *names), flip=names)
    assert frf.values == pytest.approx(estimate_frf(recording).values, rel=1e-9)
    assert not frf.notices


def test_what_the_notice_says_about_a_turned_accelerometer_mends_it(impact_test):
    recording, _ = impact_test(np.random.default_rng(10), responses=("tipX", "headX"))
    (notice,) = estimate_frf(turned(recording, "acc_tipX")).notices
    assert notice.code == "accelerometer-polarity"
    option = notice.message.split("--flip ")[1].split()[0]
    assert not estimate_frf(turned(recording, "acc_tipX"), flip=[option]).notices


@pytest.mark.parametrize("option", ["flip", "delays"])
def test_a_name_that_is_no_channel_is_refused(impact_test, option):
    recording, _ = impact_test(np.random.default_rng(11), hits=1)
    wrong = {"flip": ["acc_tipQ"], "delays": {"acc_tipQ": 1e-6}}[option]
    with pytest.raises(
        RecordingError, match="acc_tipQ: no channel or dof of that name; there are hammer_tipX, acc_tipX"
    ):
        estimate_frf(recording, **{option: wrong})


OBLIQUE = np.array([[1, 0.1], [0.9, -0.3], [0.2, 1], [-0.1, 0.9], [0.7, 0.7], [0.7, -0.6], [0.4, 0.9], [1, 0.3]])


@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
def test_every_estimator_takes_several_inputs_at_once(impact_test, structures, estimator):
    recording, _ = impact_test(
        np.random.default_rng(12), hits=8, noise=NONE, forces=("tipX", "tipY"), directions=OBLIQUE
    )
    frf = estimate_frf(recording, estimator=estimator)
    assert off(frf, at_shifted_s(frf, structures["B"]), (300, 3000)) < 1e-4


def test_an_odd_hit_among_oblique_ones_is_left_out(impact_test):
    recording, _ = impact_test(np.random.default_rng(13), hits=8, forces=("tipX", "tipY"), directions=OBLIQUE)
    assert estimate_frf(recording).hits_used == (8, 8)
    samples = recording.samples.copy()
    start, count = recording.segments[5]
    samples[2:, start : start + count] *= 1.6
    frf = estimate_frf(replace(recording, samples=samples))
    assert [hit.index for hit in frf.hits if not hit.accepted] == [5]
    assert "inconsistent" in frf.hits[5].reasons[0]


def test_force_channels_with_delays_of_their_own_are_refused(impact_test):
    recording, _ = impact_test(np.random.default_rng(14), hits=8, forces=("tipX", "tipY"), directions=OBLIQUE)
    with pytest.raises(RecordingError, match="unequal delays"):
        estimate_frf(recording, delays={"hammer_tipX": 1e-5})


def test_pre_cut_hits_long_and_short_and_a_continuous_recording_go_together(impact_test, structures, relative_error):
    """Each keeps its own length; one common length would cut the long ones, or fill the short ones up."""
    long, _ = impact_test(np.random.default_rng(15), hits=3, name="long.h5", noise=LOW)
    short, _ = impact_test(np.random.default_rng(16), hits=3, length=3000, name="short.h5", noise=LOW)
    running, _ = impact_test(np.random.default_rng(17), hits=3, seconds=0.5, name="running.h5", noise=LOW)
    frf = estimate_frf([long, short, running])
    assert frf.hits_used == (9,)
    assert relative_error(frf, structures["B"].receptance, (300, 3000)) < 0.008
    uneven = replace(long, segments=np.array([[0, 8192], [8192, 4000], [2 * 8192, 8192]]))
    assert relative_error(estimate_frf(uneven), structures["B"].receptance, (300, 3000)) < 0.01


def test_the_record_is_cut_where_the_next_hit_comes_and_the_fit_is_told(impact_test, structures):
    """Hits 30 ms apart: the windows end before the next hit, and say where."""
    recording, onsets = impact_test(np.random.default_rng(18), "B", hits=5, seconds=0.06, noise=LOW)
    frf = estimate_frf(recording, hold_off=0.01, keep=range(5))
    test = frf.tests[0]
    gaps = np.diff(onsets, append=recording.duration) * RATE
    lead = test.force_start.min()
    assert ((test.window_stop + test.window_fall).max(axis=1) <= lead + gaps + 64).all()


class OnTheFly:
    """Hits on the machine, every second or so, made when they are asked for: no sample is kept."""

    def __init__(self, structure, seconds, channels, rate=RATE):
        self.shape = (channels, int(seconds * rate))
        self.rate, self.period = rate, int(1.1 * rate)
        n = self.period
        frequency = np.fft.rfftfreq(2 * n, 1 / rate)
        from impact_cases import anti_alias, half_sine

        F = half_sine(frequency, 0.02, structure.pulse, 1000.0) * anti_alias(frequency, rate)
        X = structure.accelerance(frequency, structure.dofs, ("tipX",))[:, :, 0].T * F
        X = X[np.arange(channels - 1) % len(X)]
        self.hit = np.fft.irfft(np.vstack([F[None], X]), 2 * n)[:, :n] * rate
        self.noise = 1e-3 * np.abs(self.hit).max(axis=1)
        self.read = 0

    def read_rows(self, start, stop, rows):
        """Each second has its own noise and its own size of hit, whoever asks."""
        stop = min(stop, self.shape[1])
        out = np.empty((len(rows), stop - start))
        for number in range(start // self.period, -(-stop // self.period)):
            a, b = max(start, number * self.period), min(stop, (number + 1) * self.period)
            rng = np.random.default_rng(number)
            size = rng.uniform(0.7, 1.3)
            own = size * self.hit[rows, a - number * self.period : b - number * self.period]
            noise = np.random.default_rng([number, a]).standard_normal(own.shape)
            out[:, a - start : b - start] = own + self.noise[rows, None] * noise
        self.read += out.size
        return out

    def read_block(self, start, stop):
        return self.read_rows(start, stop, list(range(self.shape[0])))


def recording_of(samples, rate=RATE):
    channels = [Channel("hammer", "force", "N", "tipX")]
    channels += [Channel(f"acc{k}", "acceleration", "m/s^2", f"p{k}X") for k in range(1, samples.shape[0] - 1)]
    channels.insert(1, Channel("acc0", "acceleration", "m/s^2", "tipX"))
    return Recording(samples=samples, sample_rate=rate, channels=tuple(channels), kind="impact", name="long.h5")


@pytest.mark.parametrize(
    ("seconds", "channels", "rate", "megabytes"),
    [(66.0, 6, RATE, 30), pytest.param(1200.0, 8, 51200.0, 600, marks=pytest.mark.long)],
)
def test_a_recording_larger_than_the_memory_is_read_through_with_progress(
    structures, seconds, channels, rate, megabytes
):
    """66 s: 10 Msamples, 81 MB; twenty minutes: half a gigasample, 3.9 GB. The samples are never there as a whole."""
    samples = OnTheFly(structures["B"], seconds, channels, rate)
    told = []
    begin = time.process_time()
    tracemalloc.start()
    frf = estimate_frf(recording_of(samples, rate), progress=lambda share, label: told.append(share))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(
        f"{samples.shape[0] * samples.shape[1] / 1e6:.0f} Msamples: {time.process_time() - begin:.0f} s, {peak / 1e6:.0f} MB"
    )
    assert frf.hits_used == (len(frf.hits),) == (int(np.ceil(samples.shape[1] / samples.period)),)
    assert peak < megabytes * 1e6
    assert samples.read < 2.2 * samples.shape[0] * samples.shape[1]  # the force, each hit to judge it, and its window
    assert np.diff(told).min() >= 0
    assert len(told) > len(frf.hits)
    assert np.diff(told).max() < 0.2
