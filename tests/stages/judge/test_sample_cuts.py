"""The sample recordings, made for other ends, are judged as what they are: steady cuts, and some with chatter."""

from dataclasses import replace
from pathlib import Path

import pytest

from millcal.io.recordings import read_recording
from millcal.stages.judge import judge_cut

SAMPLES = Path(__file__).parents[3] / "sample_data"
CUTS = sorted(path for path in SAMPLES.glob("*/*.h5") if not path.name.startswith("tap"))
CHATTER = {  # Hz
    **{f"chatter-fz{feed}.h5": ("chatter", 1503.0) for feed in ("060", "080", "100")},
    "cut-n11500-a4.h5": ("period-n", 863.02),
    "cut-n12000-a6.h5": ("chatter", 871.1),
}


@pytest.mark.parametrize("path", CUTS, ids=lambda path: path.stem)
def test_a_sample_cut_is_judged_as_what_it_is(path):
    found = judge_cut(read_recording(path))
    verdict, frequency = CHATTER.get(path.name, ("stable", None))
    assert found.verdict == verdict, found.why
    if frequency is not None:
        assert found.chatter_frequency == pytest.approx(frequency, rel=2e-4)


@pytest.mark.parametrize(("quantity", "rel"), [("displacement", 1e-3), ("acceleration", 2e-3)])
def test_probe_and_accelerometer_tell_the_same_chatter(quantity, rel):
    recording = read_recording(SAMPLES / "judged-cuts" / "cut-n12000-a6.h5")
    name = next(channel.name for channel in recording.channels if channel.quantity == quantity)
    found = judge_cut(recording, channel=name)
    assert found.verdict == "chatter"
    assert found.chatter_frequency == pytest.approx(871.1, rel=rel)
    assert found.unit in ("m", "m/s^2")


def test_the_flip_of_a_single_insert_is_at_an_odd_multiple_of_half_its_speed():
    recording = read_recording(SAMPLES / "judged-cuts" / "cut-n11500-a4.h5")
    found = judge_cut(replace(recording, channels=recording.channels[:2], samples=recording.samples[:2]))
    assert found.chatter_frequency / found.spindle_frequency == pytest.approx(4.5, abs=1e-3)


def test_the_change_from_tooth_to_tooth_is_that_of_the_worst_instant_wherever_the_cut_ends():
    """Few flashes in a tooth miss up to a fifth of a sharp motion, and another part of it with another end."""
    recording = read_recording(SAMPLES / "judged-cuts" / "cut-n11500-a4.h5")
    tooth = 60 / 11507
    ends = [0.8 - part * tooth for part in (0.0, 0.03, 0.06, 0.7)]
    found = [judge_cut(recording, channel="disp_tipX", steady=(0.3, end)).metric for end in ends]
    assert max(found) < 1.03 * min(found)
