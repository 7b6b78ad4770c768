"""Cuts whose force comes from the motion: with a stiff tool they are the cuts of a known force, with a soft one they chatter."""

import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode
from millcal.simulation import Timeline, simulate_cut
from millcal.simulation.regenerative import simulate_regenerative_cut

LAW = LinearEdge(cutting=np.array([700e6, 210e6, 0.0]), edge=np.array([12e3, 10e3, 0.0]))
CUTTER = Cutter(diameter=12e-3, teeth=2, helix=0.3, runout=3e-6, runout_angle=0.7)
CONDITIONS = CuttingConditions(2 * np.pi * 120.0, 0.08e-3, 1e-3, 4e-3, "down")
RATE = 12_800.0


def modes(stiffness):
    return (
        ShapedMode(880.0, 0.03, stiffness, (("tipX", 1.0), ("noseX", 0.2))),
        ShapedMode(1010.0, 0.03, 1.3 * stiffness, (("tipY", 1.0), ("noseX", 0.1))),
    )


def recorded(stiffness, **more):
    return simulate_regenerative_cut(
        LAW,
        CUTTER,
        CONDITIONS,
        rng=np.random.default_rng(0),
        sample_rate=RATE,
        timeline=Timeline(0.5, 0.1, 0.1),
        modes=modes(stiffness),
        accelerometers=("noseX",),
        displacements=("tipX",),
        pulse=True,
        **more,
    )


def test_a_stiff_tool_shakes_as_under_a_force_that_asks_nothing_of_the_motion():
    """Against `simulate_cut`, to what the recorder's filter takes and the steps of time leave: lines up to 0.4 of the rate."""
    stiff = 1e11
    found, truth = recorded(stiff)
    plain, _ = simulate_cut(
        LAW,
        CUTTER,
        CONDITIONS,
        rng=np.random.default_rng(0),
        sample_rate=RATE,
        timeline=Timeline(0.5, 0.1, 0.1),
        initial_angle=-2 * np.pi * 120.0 * 0.1,
        dynamometer=None,
        modes=modes(stiff),
        accelerometers=("noseX",),
    )
    inside = slice(round(0.35 * RATE), round(0.55 * RATE))  # settled, 24 whole turns
    spectra = [np.abs(np.fft.rfft(r.samples[0, inside])) for r in (found, plain)]
    low = slice(1, int(0.35 * len(spectra[0]) * 2 * 0.5))
    assert spectra[0][low] == pytest.approx(spectra[1][low], abs=0.03 * spectra[1][low].max())
    assert truth["change_per_turn_um"] < 0.01
    assert truth["spindle_frequency_hz"] == pytest.approx(120.0)


def test_it_rests_before_the_cut_and_rings_out_after():
    found, _ = recorded(3e6)
    probe = found.samples[1]
    before, after = probe[: round(0.09 * RATE)], probe[-round(0.02 * RATE) :]
    assert np.abs(before).max() < 1e-3 * np.abs(probe).max()
    assert np.abs(after).max() < 0.05 * np.abs(probe).max()


def test_a_soft_tool_chatters_and_a_stiff_one_does_not():
    assert recorded(2e6)[1]["change_per_turn_um"] > 5
    assert recorded(2e8)[1]["change_per_turn_um"] < 0.1


def test_the_pulse_comes_once_a_turn_and_noise_is_the_chains():
    found, _ = recorded(2e8, accelerometer=MeasuringChain(noise=0.5), speed_error=0.001)
    edges = np.flatnonzero(np.diff(found.samples[2]) > 0)
    assert np.diff(edges).mean() == pytest.approx(RATE / 120.12, rel=2e-4)
    assert np.std(found.samples[0][: round(0.09 * RATE)]) == pytest.approx(0.5, rel=0.1)
    assert [channel.quantity for channel in found.channels] == ["acceleration", "displacement", "pulse"]
    assert found.cutter.runout == 0.0
