"""Simulated recordings, conditioned and fitted as a user's would be: how often do the 95 % intervals hold the truth?

Noise, quantisation, drift and an unknown spindle angle are in every record; what a coefficient misses its interval by is
therefore a fault of the whole chain. The full study is marked long.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.conditioning import condition_cut

LAW = LinearEdge(cutting=np.array([820e6, 260e6, 230e6]), edge=np.array([18e3, 16e3, 6e3]))
TRUTH = np.concatenate([LAW.cutting, LAW.edge])
CHAIN = MeasuringChain(
    offset=(4.0, -3.0, 8.0),
    drift=(0.6, -0.4, 1.2),
    noise=1.5,
    coloured_noise=0.4,
    coloured_corner=30.0,
    full_scale=2000.0,
)
TIMELINE = Timeline(steady=0.6, air_before=0.15, air_after=0.15, ramp=0.1)
FEEDS = (0.05, 0.075, 0.1, 0.125, 0.15)  # mm


def two_teeth(runout: float) -> Cutter:
    """Two teeth whose offset stands on tooth 0 at mid depth, where c0 is the whole runout."""
    return Cutter(diameter=16e-3, teeth=2, helix=0.5, runout=runout, runout_angle=-1.5e-3 * np.tan(0.5) / 8e-3)


CASES = {  # cutter, direction, radial depth, options of the fit
    "average": (two_teeth(0.0), "slot", 16e-3, {"method": "average"}),
    "average with runout": (two_teeth(8e-6), "slot", 16e-3, {"method": "average", "contact_loss": "fit"}),
    "nls": (two_teeth(0.0), "slot", 16e-3, {}),
    "nls with runout": (two_teeth(8e-6), "slot", 16e-3, {}),
    "nls, three teeth down": (
        Cutter(diameter=16e-3, teeth=3, helix=0.5, runout=6e-6, runout_angle=1.0), "down", 4e-3, {}
    ),
}  # fmt: skip


@lru_cache(maxsize=16)  # methods see the same cuts
def series(
    cutter: Cutter,
    direction: str,
    radial_depth: float,
    seed: int,
    chain: MeasuringChain,
    wander: float = 1e-3,
    offset: str = "auto",
):
    """Five conditioned cuts; the runout is nobody's knowledge.   wander : share by which the spindle may miss its speed"""
    rng = np.random.default_rng(seed)
    cuts = []
    for feed in FEEDS:
        conditions = CuttingConditions(
            spindle_speed=200 * np.pi,
            feed_per_tooth=feed * 1e-3,
            axial_depth=3e-3,
            radial_depth=radial_depth,
            direction=direction,
        )
        recording, _ = simulate_cut(
            LAW, cutter, conditions, rng=rng, sample_rate=10_000.0, timeline=TIMELINE, initial_angle=None,
            speed_error=rng.uniform(-wander, wander), dynamometer=chain, name=f"fz{feed}",
        )  # fmt: skip
        known = replace(recording, cutter=replace(cutter, runout=0.0, runout_angle=0.0), conditions=conditions)
        cuts.append(condition_cut(known, harmonics=12, offset=offset))
    return cuts


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seeds", [3, pytest.param(100, marks=pytest.mark.long)])
def test_the_intervals_of_the_whole_chain_hold_the_truth_about_as_often_as_they_say(case, seeds):
    """90 to 99 % over coefficients and seeds, widened by the binomial error of the seeds."""
    cutter, direction, radial_depth, options = CASES[case]
    inside = []
    for seed in range(seeds):
        interval = fit_coefficients(series(cutter, direction, radial_depth, seed, CHAIN), **options).posterior.interval[
            :6
        ]
        inside.append((interval[:, 0] <= TRUTH) & (interval[:, 1] >= TRUTH))
    share, slack = np.mean(inside), 2 * np.sqrt(0.05 * 0.95 / seeds)
    print(f"{case}: {share:.3f} of the coefficients in {seeds} seeds; each {np.mean(inside, axis=0).round(3)}")
    assert 0.90 - slack <= share <= min(0.99 + slack, 1.0)


@pytest.mark.parametrize("case", ["average", "nls", "nls with runout", "nls, three teeth down"])
@pytest.mark.parametrize(("wander", "error"), [(0.0, 1e-6), (1e-3, 1e-4)])
def test_a_chain_without_noise_gives_the_coefficients_back(case, wander, error):
    """To a millionth where the revolution is a whole number of samples; else the harmonics that are not kept leak a little."""
    cutter, direction, radial_depth, options = CASES[case]
    found = fit_coefficients(series(cutter, direction, radial_depth, 1, MeasuringChain(), wander, "none"), **options)
    assert found.posterior.mean[:6] == pytest.approx(TRUTH, rel=error)
