"""The rate of the sampler, however the times were written."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from millcal.errors import RecordingError
from millcal.io.formats.time_base import TimeBase, fewest_digits, unwrapped_midnights


def base(times, blocks=1):
    clock = TimeBase("cut.csv", "t", lambda row: f"line {row + 2}")
    for part in np.array_split(np.asarray(times, dtype=float), blocks):
        clock.add(part)
    return clock


def rate(times, *, stated=None, header=None, blocks=1):
    return base(times, blocks).rate(stated, header)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    frequency=st.sampled_from([1000, 1650, 8192, 10000, 12800, 20480, 25600, 44100, 48000, 51200, 65536, 100000]),
    decimals=st.integers(4, 9),
    start=st.floats(0, 100),
    seconds=st.floats(1.0, 5.0),
    blocks=st.integers(1, 7),
)
def test_a_rounded_column_gives_the_rate_to_within_its_rounding(frequency, decimals, start, seconds, blocks):
    times = np.round(round(start, decimals) + np.arange(int(seconds * frequency)) / frequency, decimals)
    found, _ = rate(times, blocks=blocks)
    assert found == pytest.approx(frequency, rel=2 * 10.0**-decimals / seconds + 1e-9)
    if decimals >= 7:
        assert found == frequency


@pytest.mark.parametrize("digits", [5, 6, 7])
def test_times_of_so_many_significant_digits_give_the_rate(digits):
    """C's %g loses decimals as the time grows."""
    times = [float(f"{i / 51200:.{digits}g}") for i in range(51200)]
    found, _ = rate(times)
    assert found == 51200
    assert 1 / np.median(np.diff(times)) != pytest.approx(51200, rel=1e-4)


def test_an_exact_column_keeps_a_rate_that_is_not_round():
    found, notices = rate(np.arange(20000) / 12345.678)
    assert found == pytest.approx(12345.678, rel=1e-12)
    assert notices == []


def test_the_header_wins_where_the_times_agree_and_loses_where_they_do_not():
    steps_rounded_once = 1.95e-5 * np.arange(5000)  # 51282 Hz
    assert rate(steps_rounded_once, header=51200.0)[0] == 51200
    assert rate(steps_rounded_once)[0] == pytest.approx(51282, rel=1e-4)
    found, (notice,) = rate(np.arange(5000) / 5000, header=10000.0)
    assert (found, notice.code) == (5000, "rate-against-header")


def test_a_stated_rate_wins_over_everything_and_the_contradiction_is_told():
    found, (notice,) = rate(np.arange(5000) / 5000, stated=10000.0, header=5000.0)
    assert (found, notice.code) == (10000, "rate-against-times")
    gaps = np.concatenate([np.arange(100), np.arange(500, 600)]) / 5000
    assert rate(gaps, stated=5000.0)[0] == 5000


def test_milliseconds_of_a_fast_sampler_repeat_and_still_give_the_rate():
    found, (notice,) = rate(np.floor(np.arange(40000) / 10) / 1000)
    assert found == 10000
    assert notice.code == "rounded-times"


def test_jitter_is_told_and_its_mean_rate_taken():
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, 5000)
    found, notices = rate((np.arange(5000) + jitter) / 5000)
    assert found == pytest.approx(5000, rel=1e-3)
    assert {notice.code for notice in notices} >= {"uneven-times"}


@pytest.mark.parametrize("blocks", [1, 3])
@pytest.mark.parametrize(
    ("times", "said"),
    [
        (np.delete(np.arange(1000), 500) / 1024, "jumps by 0.00195312 s at line 502"),
        (np.concatenate([np.arange(500), np.arange(400, 900)]) / 1000, "backwards at line 502"),
        (np.full(100, 3.0), "does not advance"),
        ((np.arange(2000) + 1e-4 * np.arange(2000.0) ** 2) / 1000, "uneven steps"),
        (np.arange(1000) / 1e9, "sample rate of 1e\\+09 Hz"),
        (np.where(np.arange(1000) == 7, np.nan, np.arange(1000)), "no time at line 9"),
    ],
)
def test_a_broken_clock_is_refused_with_the_place(times, said, blocks):
    with pytest.raises(RecordingError, match=said):
        rate(times, blocks=blocks)


@given(st.floats(1, 1e6), st.floats(1e-9, 1e-2))
def test_the_number_with_the_fewest_digits_lies_in_the_interval(middle, width):
    low, high = middle * (1 - width), middle * (1 + width)
    assert low <= fewest_digits(low, high) <= high


def test_midnight_is_passed_in_a_block_or_between_two():
    day = np.array([86398.0, 86399.0, 0.0, 1.0])
    np.testing.assert_array_equal(unwrapped_midnights(day, None), [86398, 86399, 86400, 86401])
    np.testing.assert_array_equal(unwrapped_midnights(day[2:], 86399.0), [86400, 86401])
    np.testing.assert_array_equal(unwrapped_midnights(day[2:] + 2, 86401.0), [86402, 86403])
