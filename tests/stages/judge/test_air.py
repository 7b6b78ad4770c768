"""The cut is found in its recording turn by turn, whatever hums beside it and however short it is."""

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.stages.judge import judge_cut

RATE, SPINDLE = 12_800.0, 111.3  # Hz


def recorded(turns, *, before=0.3, after=0.05, teeth=1, mode=890.0, noise=0.1, hum=0.2, gentle=0.0, tone=None, seed=0):
    """A cut whose harmonics are large at a mode alone, in air with hum; the tool rings in and out.

    gentle : share of the cut before its tone, at (Hz, amplitude), begins
    """
    rng = np.random.default_rng(seed)
    cut = turns / SPINDLE
    time = np.arange(round((before + cut + after) * RATE)) / RATE
    within = (time >= before) & (time < before + cut)
    y = np.zeros(len(time))
    passing = teeth * SPINDLE
    for k in range(1, int(0.4 * RATE / passing)):
        size = 1 / np.hypot(1 - (k * passing / mode) ** 2, 0.1 * k * passing / mode) * (k * passing / mode) ** 2
        y += np.where(within, size / k * np.cos(2 * np.pi * k * passing * time + rng.uniform(0, 6.28)), 0.0)
    rms = np.std(y[within])
    for start in (before, before + cut):
        since = np.clip(time - start, 0, None)
        y += np.where(
            time >= start, rms * np.exp(-0.03 * 2 * np.pi * mode * since) * np.sin(2 * np.pi * mode * since), 0.0
        )
    if tone:
        begins = before + gentle * cut
        for f, a in ((tone[0], tone[1]), (tone[0] + passing, 0.3 * tone[1]), (tone[0] - passing, 0.3 * tone[1])):
            y += np.where(within & (time > begins), a * rms * np.cos(2 * np.pi * f * time), 0.0)
    for k, share in ((1, 1.0), (2, 0.3), (3, 0.5), (5, 0.2)):
        y += hum * rms * np.sqrt(2) * share * np.cos(2 * np.pi * 50.003 * k * time + k)
    y += noise * rms * rng.normal(size=len(y))
    recording = Recording(
        samples=y[np.newaxis],
        sample_rate=RATE,
        channels=(Channel("a", "acceleration", "m/s^2", "tipX"),),
        name="cut.h5",
        cutter=Cutter(diameter=12e-3, teeth=teeth),
        conditions=CuttingConditions(2 * np.pi * SPINDLE, 0.1e-3, 1e-3, 3e-3, "down"),
    )
    return recording, (before, before + cut)


@pytest.mark.parametrize("turns", [14, 33, 120, 300])
@pytest.mark.parametrize("teeth", [1, 3])
def test_a_cut_beside_hum_is_found_and_its_ringing_is_no_chatter(turns, teeth):
    for seed in range(3):
        recording, (enters, leaves) = recorded(turns, teeth=teeth, seed=seed)
        found = judge_cut(recording)
        assert found.steady[0] > enters - 2 / SPINDLE
        assert found.steady[1] < leaves + 2 / SPINDLE
        assert found.steady[1] - found.steady[0] > 0.5 * (leaves - enters)
        assert found.verdict == "stable", found.why


def test_a_cut_in_air_without_any_noise_is_found():
    recording, (enters, leaves) = recorded(20, noise=0.0, hum=0.0)
    found = judge_cut(recording)
    assert enters - 2 / SPINDLE < found.steady[0] < found.steady[1] < leaves + 2 / SPINDLE
    assert found.verdict == "stable", found.why


def test_a_cut_that_is_gentle_before_it_chatters_is_no_air_there():
    recording, (enters, leaves) = recorded(300, tone=(1043.0, 30.0), gentle=0.6, noise=0.02)
    found = judge_cut(recording)
    assert found.steady[1] - found.steady[0] > 0.3 * (leaves - enters)
    assert found.verdict == "chatter", found.why
    assert found.chatter_frequency == pytest.approx(1043.0, rel=1e-3)


def test_a_record_that_is_all_cut_is_judged_from_end_to_end():
    recording, _ = recorded(100, before=0.0, after=0.0)
    assert judge_cut(recording).steady == pytest.approx((0.0, recording.duration), abs=1e-3)
