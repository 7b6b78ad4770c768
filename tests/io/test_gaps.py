"""Missing cells: bridged where short, refused where long, wherever the blocks are cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from millcal.errors import RecordingError
from millcal.io.gaps import LONGEST, bridged


def run(values, cuts=()):
    notices = []
    blocks = np.split(np.atleast_2d(values), sorted(cuts), axis=1)
    names = [f"c{i}" for i in range(len(np.atleast_2d(values)))]
    out = list(bridged((b for b in blocks if b.shape[1]), names, "cut.csv", lambda row: f"line {row}", notices))
    return np.concatenate(out, axis=1), notices


@settings(max_examples=80, deadline=None)
@given(
    gaps=st.lists(st.tuples(st.integers(0, 3900), st.integers(1, 12), st.integers(0, 1)), max_size=2),
    cuts=st.lists(st.integers(0, 4000), max_size=6),
)
def test_straight_lines_stay_straight_wherever_gaps_and_blocks_are(gaps, cuts):
    line = np.array([[2.0], [-1.0]]) * np.arange(4000) + 7
    holed = line.copy()
    for start, length, column in gaps:
        holed[column, start : start + length] = np.nan
    found, notices = run(holed, cuts)
    inside = slice(int(np.isnan(holed[:, :30]).sum()), None)  # at the very start the nearest value stands
    np.testing.assert_allclose(found[:, inside], line[:, inside], rtol=1e-9, atol=1e-6)
    assert len(notices) == np.isnan(holed).any(axis=1).sum()


def test_at_the_ends_the_nearest_value_stands():
    found, _ = run(np.r_[np.nan, np.nan, np.arange(1000.0), np.inf], [1, 1001])
    assert (found[0, 0], found[0, 1], found[0, -1]) == (0, 0, 999)


@pytest.mark.parametrize("cuts", [[], [55], [40, 52, 53, 60], list(range(1, 3000, 7))])
def test_a_long_gap_is_refused_with_its_place(cuts):
    values = np.arange(3000.0)
    values[50 : 50 + LONGEST + 1] = np.nan
    with pytest.raises(RecordingError, match=r"column 'c0' .* line 50"):
        run(values, cuts)


def test_many_short_gaps_are_refused_with_their_number():
    values = np.arange(1000.0)
    values[::50] = np.nan
    with pytest.raises(RecordingError, match="misses 20 of 1000 values, the first at line 0"):
        run(values)
