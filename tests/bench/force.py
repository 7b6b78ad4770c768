"""Force harmonics by exact integrals against the plain way: slices and angles on a grid; and the fit that uses them."""

import time

import numpy as np
from measure import spread, table

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge, chip_thickness, force_harmonics, to_machine_axes
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.coefficients import fit_coefficients
from millcal.stages.conditioning import condition_cut

LAW = LinearEdge(cutting=np.array([820e6, 260e6, 230e6]), edge=np.array([18e3, 16e3, 6e3]))
CUTTER = Cutter(diameter=16e-3, teeth=3, helix=0.5, runout=8e-6, runout_angle=1.0)
HARMONICS = 12


def conditions(feed: float) -> CuttingConditions:
    return CuttingConditions(200 * np.pi, feed, 3e-3, 16e-3, "slot")


def on_a_grid(cut: CuttingConditions, angles: int, slices: int) -> np.ndarray:
    """The sum over slices at equal angles, and its discrete Fourier transform."""
    angle = 2 * np.pi * np.arange(angles) / angles
    force = np.zeros((3, angles))
    for some in np.array_split((np.arange(slices) + 0.5) / slices * cut.axial_depth, max(slices // 25, 1)):
        chip = chip_thickness(CUTTER, cut, angle, some)
        phi = angle - (CUTTER.tooth_lag()[:, np.newaxis] + CUTTER.helix_lag(some))[:, :, np.newaxis]
        force += to_machine_axes(LAW.edge_force(chip, cut.axial_depth / slices), phi).sum((0, 1)).T
    harmonics = np.fft.rfft(force)[:, : HARMONICS + 1] * 2 / angles
    harmonics[:, 0] /= 2
    return harmonics


def timed(work, repeats: int) -> list[float]:
    """CPU ms of each repeat, after one that is not counted."""
    work()
    costs = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        costs.append(1e3 * (time.process_time() - start))
    return costs


def force(options) -> str:
    """Three teeth with runout, slot, 12 harmonics; error over the largest harmonic; CPU ms, least / median of the repeats."""
    cut = conditions(50e-6)
    exact = force_harmonics(LAW, CUTTER, cut, HARMONICS)
    finest = on_a_grid(cut, 16384, 400)
    rows = []
    ways = {
        "exact integrals (millcal)": lambda: force_harmonics(LAW, CUTTER, cut, HARMONICS),
        "256 angles, 12 slices": lambda: on_a_grid(cut, 256, 12),
        "1024 angles, 50 slices": lambda: on_a_grid(cut, 1024, 50),
        "4096 angles, 200 slices": lambda: on_a_grid(cut, 4096, 200),
    }
    for name, work in ways.items():
        error = np.abs(work() - exact).max() / np.abs(exact).max()
        shown = (
            f"{np.abs(finest - exact).max() / np.abs(exact).max():.0e} from 16384 x 400"
            if "millcal" in name
            else f"{error:.0e}"
        )
        rows.append((name, spread(timed(work, options.repeats)), shown))
    first = table(("way", "CPU ms", "error"), *rows)

    rng = np.random.default_rng(1)
    cuts = []
    for feed in (50e-6, 75e-6, 100e-6, 125e-6, 150e-6):
        recording, _ = simulate_cut(
            LAW, CUTTER, conditions(feed), rng=rng, sample_rate=10_000.0, initial_angle=None,
            timeline=Timeline(0.8, 0.15, 0.15, 0.05), dynamometer=MeasuringChain(noise=1.5),
        )  # fmt: skip
        cuts.append(condition_cut(recording, harmonics=12))
    fits = [
        (
            f"identify --method {name}",
            spread(timed(lambda name=name: fit_coefficients(cuts, method=name), options.repeats)),
        )
        for name in ("average", "nls")
    ]
    second = table(("five cuts of 1.2 s, three teeth, conditioned", "CPU ms"), *fits)
    return (
        f"{first}\n\n{second}\n\n`nls` covers the fit, all fits with a cut left out, the checks and the other models."
    )
