"""A measured FRF straight to crossings: what is refused, what is told, and what its noise makes of the limit."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from millcal.data import Channel, Frf, Recording
from millcal.errors import IllPosedError
from millcal.physics.stability.regeneration import FLIP, Regeneration, TipModes, tip_of_shapes
from millcal.stages.frf import estimate_frf
from millcal.stages.stability.from_frf import crossings_of_frf, moved_by_noise

RPM = 2 * np.pi / 60
HIT = Path(os.environ.get("MILLCAL_REFERENCE_DATA", "")) / "real" / "cutpro_hammer" / "Point1_Channel1_CH1.txt"
SWEPT = np.arccos(1 - 2 * 0.1)
CUT = Regeneration(2, np.pi - SWEPT, np.pi, 600e6, 200e6)
SPEEDS = np.array([5000.0, 7500.0, 9000.0]) * RPM
DEEPEST = 4e-3


def tip(frequency=(922.0, 1100.0), stiffness=(1.34e6, 2.01e6), directions=(30.0, 110.0)) -> TipModes:
    """Modes in directions of their own, so that cross terms count."""
    angle = np.radians(directions)
    size = 2 * np.pi * np.array(frequency) / np.sqrt(stiffness)
    shape = size[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return tip_of_shapes(np.array(frequency), np.array([0.011, 0.02]), shape)


def measured(*, noise=0.0, rng=None, highest=5000.0, lowest=10.0, spacing=2.0, axes="XY", modes=None):
    """Receptance lines with errors of a share of each line, as the record of an impact test has them."""
    frequency = np.arange(0.0, highest, spacing)
    values = (modes or tip()).receptance(frequency)
    at = ["XY".index(axis) for axis in axes]
    values = values[:, at][:, :, at]
    variance = (noise * np.abs(values)) ** 2
    if noise:
        error = rng.standard_normal((2, *values.shape)) * np.sqrt(variance / 2)
        values = values + error[0] + 1j * error[1]
    dofs = tuple(f"tip{axis}" for axis in axes)
    return Frf(
        frequency=frequency,
        values=values,
        variance=variance if noise else None,
        form="receptance",
        estimator="h1",
        outputs=dofs,
        inputs=dofs,
        hits_used=(5,) * len(axes),
        usable_band=(lowest, highest),
    )


def codes(notices):
    return {notice.code for notice in notices}


def test_lines_without_variance_have_crossings_and_no_band():
    found, low, high, notices = crossings_of_frf(measured(), SPEEDS, CUT, deepest=DEEPEST)
    assert set(found.speed.tolist()) == {0, 1, 2}
    assert low is None
    assert high is None
    assert not codes(notices)


def test_a_conjugated_receptance_is_refused():
    frf = measured()
    with pytest.raises(IllPosedError, match="gave power to the hammer"):
        crossings_of_frf(replace(frf, values=frf.values.conj()), SPEEDS, CUT, deepest=DEEPEST)


def test_a_direction_nobody_measured_must_be_stated_as_rigid():
    lone = measured(axes="X")
    with pytest.raises(IllPosedError, match="rigid"):
        crossings_of_frf(lone, SPEEDS, CUT, deepest=DEEPEST)
    found, *_, notices = crossings_of_frf(lone, SPEEDS, CUT, deepest=DEEPEST, rigid="y")
    assert len(found.depth)
    assert "rigid-axis" in codes(notices)


def test_a_band_that_ends_soon_above_the_highest_mode_or_begins_near_the_lowest_is_told():
    soon = crossings_of_frf(measured(highest=1800.0), SPEEDS[:1], CUT, deepest=DEEPEST)[3]
    late = crossings_of_frf(measured(lowest=700.0), SPEEDS[:1], CUT, deepest=DEEPEST)[3]
    assert codes(soon) == {"short-band"}
    assert codes(late) == {"late-start"}


def test_the_band_holds_the_noise_free_limit_in_nineteen_of_twenty():
    rng = np.random.default_rng(11)
    truth = crossings_of_frf(measured(), SPEEDS, CUT, deepest=DEEPEST)[0].first(len(SPEEDS)).depth
    inside = []
    for _ in range(20):
        _, low, high, _ = crossings_of_frf(measured(noise=0.02, rng=rng), SPEEDS, CUT, deepest=DEEPEST)
        inside.append((low < truth) & (truth < high))
    assert 0.88 <= np.mean(inside) <= 1.0


def test_the_band_lies_about_the_limit_and_grows_with_the_noise():
    widths = []
    for noise in (0.005, 0.02):
        frf = measured(noise=noise, rng=np.random.default_rng(2))
        found, low, high, _ = crossings_of_frf(frf, SPEEDS, CUT, deepest=DEEPEST)
        first = found.first(len(SPEEDS)).depth
        assert np.all((low < first) & (first < high))
        widths.append(np.log(high / low))
    assert np.all(widths[1] > 2 * widths[0])


def tongue_edge(modes: TipModes) -> float:
    """A speed at which the first limit jumps, rad/s, to a part in a million."""

    def first(speed):
        return crossings_of_frf(measured(modes=modes), np.array([speed]), CUT, deepest=DEEPEST)[0].first(1).depth[0]

    speeds = np.linspace(11_000, 12_500, 16) * RPM
    depths = np.minimum([first(speed) for speed in speeds], DEEPEST)
    i = int(np.argmax(np.abs(np.diff(np.log(depths)))))
    low, high = speeds[i], speeds[i + 1]
    for _ in range(16):
        middle = (low + high) / 2
        at = min(first(middle), DEEPEST)
        if abs(np.log(at / depths[i])) < abs(np.log(at / depths[i + 1])):
            low, depths[i] = middle, at
        else:
            high, depths[i + 1] = middle, at
    assert depths.max() > 1.1 * depths.min()
    return float(low if depths[i] > depths[i + 1] else high)


def test_beside_the_edge_of_a_tongue_noise_makes_a_limit_that_no_first_order_sees_and_that_is_told():
    edge = tongue_edge(tip())
    frf = measured(noise=0.01, rng=np.random.default_rng(1))
    told = moved_by_noise(frf, np.array([edge]), CUT, deepest=DEEPEST, rng=np.random.default_rng(0))
    assert codes(told) == {"noise-moves-limits"}
    calm = moved_by_noise(frf, SPEEDS, CUT, deepest=DEEPEST, rng=np.random.default_rng(0))
    assert not calm


def test_a_short_cut_with_few_teeth_has_flips():
    found = crossings_of_frf(measured(), np.array([12_500.0]) * RPM, CUT, deepest=10e-3)[0]
    assert FLIP in found.kind


@pytest.mark.skipif(not HIT.is_file(), reason="reference data absent: set MILLCAL_REFERENCE_DATA")
def test_a_real_hit_has_flip_lobes_far_below_what_the_next_pair_would_allow():
    """A real tool of 1070 Hz; two teeth at a tenth of the diameter, near 1070 Hz / (k + 1/2) tooth passings."""
    table = np.loadtxt(HIT)
    recording = Recording(
        samples=table[:, 1:].T.copy(),
        sample_rate=51200.0,
        channels=(Channel("hammer", "force", "N", "tipX"), Channel("acc", "acceleration", "m/s^2", "tipX")),
        kind="impact",
        name="hammer.txt",
    )
    frf = replace(
        estimate_frf(recording, record_length=1.0, resolution=1.0, form="receptance"), usable_band=(150.0, 3500.0)
    )
    speeds = np.array([12_000.0, 20_000.0]) * RPM
    found, low, _, notices = crossings_of_frf(frf, speeds, CUT, deepest=60e-3, rigid="y")
    first = found.first(2)
    assert first.kind.tolist() == [FLIP, FLIP]
    np.testing.assert_allclose(first.depth, [27e-3, 23e-3], rtol=0.1)
    next_pair = min(found.depth[(found.kind != FLIP) & found.loses])
    assert next_pair > 1.3 * first.depth.max()
    assert low is None  # one hit knows nothing of its noise
    assert {"rigid-axis", "short-band"} <= codes(notices)
