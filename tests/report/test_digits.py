"""Numbers as a reader wants them."""

import pytest

from millcal.report.digits import fixed, log_ticks, nice_ticks, plus_minus, significant, tick_labels, with_interval


@pytest.mark.parametrize(
    ("value", "half", "shown"),
    [
        (893.2, 197.0, "890 ± 200"),
        (21.46, 16.4, "21 ± 16"),
        (958.8599, 0.0051, "958.860 ± 0.005"),
        (-12.3, 41.0, "−12 ± 41"),
        (0.3, 0.012, "0.300 ± 0.012"),
    ],
)
def test_a_value_shows_the_digits_its_interval_deserves(value, half, shown):
    assert plus_minus(value, value - half, value + half) == shown


def test_value_and_ends_of_an_interval_have_the_same_decimals():
    for scale in (1e-3, 1.0, 1e4):
        parts = with_interval(1.23456 * scale, 1.1 * scale, 1.4 * scale)
        assert len({len(part.partition(".")[2]) for part in parts}) == 1


def test_an_interval_that_is_lopsided_is_written_out():
    assert plus_minus(10.0, 9.0, 15.0) == "10.0 (9.0 to 15.0)"


def test_what_cannot_be_known_is_a_dash_and_never_nan():
    nan = float("nan")
    assert significant(nan) == fixed(None, 2) == with_interval(1.0, nan, nan)[1] == "–"
    assert plus_minus(1.0, nan, nan) == "1.000"


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-371, 622), (0.0213, 0.0219), (5999.6, 6000.1), (-3e-9, 4e-9)])
def test_ticks_are_round_lie_inside_and_are_at_least_two(low, high):
    ticks = nice_ticks(low, high, 4)
    assert len(ticks) >= 2
    assert all(low <= tick <= high for tick in ticks)
    assert len(set(tick_labels(ticks))) == len(ticks)


def test_logarithmic_ticks_lie_inside():
    for low, high in ((0.02, 45.0), (60.0, 5800.0), (3e-7, 2e3), (2.1, 4.8)):
        ticks = log_ticks(low, high)
        assert ticks
        assert all(low <= tick <= high for tick in ticks)
