"""What every tip obeys: power, reciprocity, an answer at once; and what is said of an FRF that does not."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.errors import IllPosedError
from millcal.stages.stability.lines import usable_lines
from tests.stages.stability.test_from_frf import measured, tip


def told(frf):
    return {notice.code for notice in usable_lines(frf, "")[1]}


def changed(frf, change):
    """With the cross terms as a function makes them."""
    values = frf.values.copy()
    values[:, 0, 1], values[:, 1, 0] = change(values[:, 0, 1], values[:, 1, 0])
    return replace(frf, values=values)


@pytest.mark.parametrize("angle", [0.0, 30.0, 75.0])
def test_modes_in_any_directions_are_a_tip(angle):
    assert not told(measured(modes=tip(directions=(angle, angle + 55.0))))


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_noise_is_no_offence(noise):
    for seed in range(5):
        assert not told(measured(noise=noise, rng=np.random.default_rng(seed))) - {"low-frequency-noise"}


@pytest.mark.parametrize(
    "change", [lambda a, b: (8 * a, 8 * b), lambda a, b: (a, -8 * b), lambda a, b: (3j * a, 3j * b)]
)
def test_cross_terms_that_no_driving_points_allow_are_refused(change):
    with pytest.raises(IllPosedError, match="cross receptances are larger"):
        usable_lines(changed(measured(), change), "")


def test_cross_terms_a_little_too_large_are_told():
    """A mode alone in a direction of its own has them as large as they can be: two fifths more are too much."""
    assert "not-passive" in told(changed(measured(), lambda a, b: (1.4 * a, 1.4 * b)))


def test_two_cross_terms_that_are_not_one_another_are_told():
    assert told(changed(measured(), lambda a, b: (a, 0.6 * b))) == {"not-reciprocal"}
    noisy = measured(noise=0.3, rng=np.random.default_rng(0))
    assert "not-reciprocal" not in told(noisy)


def test_both_cross_terms_turned_are_the_same_tip_with_one_axis_mirrored():
    assert not told(changed(measured(), lambda a, b: (-a, -b)))


@pytest.mark.parametrize("delay", [30e-6, 8e-6, -20e-6])
def test_a_delay_is_told_with_its_size(delay):
    frf = measured()
    late = replace(frf, values=frf.values * np.exp(-2j * np.pi * frf.frequency * delay)[:, np.newaxis, np.newaxis])
    said = [notice for notice in usable_lines(late, "")[1] if notice.code == "late-response"]
    assert [notice.where for notice in said] == ["frf tipX/tipX", "frf tipY/tipY"]
    assert all(f" {abs(delay) * 1e6:.0f} us {'after' if delay > 0 else 'before'} " in n.message for n in said)


def test_a_delay_too_small_to_matter_and_heavy_damping_are_none():
    frf = measured()
    late = replace(frf, values=frf.values * np.exp(-2j * np.pi * frf.frequency * 2e-6)[:, np.newaxis, np.newaxis])
    assert not told(late)
    damped = replace(tip(), pole=tip().pole.real * 8 + 1j * tip().pole.imag)
    assert not told(measured(modes=damped))


def test_a_line_without_a_value_is_left_out_and_told_with_its_frequency():
    frf = measured()
    values = frf.values.copy()
    values[450, 0, 0] = np.nan
    values[470, 0, 1] = np.nan
    lines, notices = usable_lines(replace(frf, values=values), "")
    (said,) = notices
    assert said.code == "lines-missing"
    assert "900 Hz to 940 Hz" in said.message
    assert lines.count == usable_lines(frf, "")[0].count - 2
    assert lines.values[:, 0, 1].any()  # one gap is no reason to take a cross term as zero
