"""The zero-order map against the plain way: sweep the chatter frequency, draw every lobe, take the lower envelope."""

import sys
import time
from statistics import median

import numpy as np
from measure import spread, table

from millcal.data import Modes, Posterior
from millcal.physics.stability.zero_order import dynamics_of_modes, limit, mean_cutting_matrix
from millcal.physics.structure import Mode, receptance
from millcal.stages.stability import map_stability

RPM = 2 * np.pi / 60
ROWS = ((456.780, 0.111705, 7.9331e6, "x"), (1448.889, 0.017037, 14.6917e6, "x"),
        (516.518, 0.02458, 9.3746e6, "y"), (1408.448, 0.031358, 12.4064e6, "y"))  # fmt: skip
TEETH, KTC, KRC = 2, 1319.4e6, 788.8e6
SPEEDS = np.linspace(4000, 16_000, 400) * RPM


def plain_sweep(modes, cutting, lines=8000, lobes=20):
    """Limit at each speed as a shop script does it: parametric lobes on a frequency grid, interpolated, the lowest taken."""
    frequency = np.linspace(0.25, 3000, lines)
    eigenvalue = np.linalg.eigvals(receptance(frequency, modes, axes=("x", "y")) @ cutting)
    straight = np.abs(np.diff(eigenvalue, axis=0)).sum(axis=1)
    crossed = np.abs(eigenvalue[1:] - eigenvalue[:-1, ::-1]).sum(axis=1)
    swapped = np.concatenate([[0], np.cumsum(crossed < straight)]) % 2 == 1
    eigenvalue[swapped] = eigenvalue[swapped][:, ::-1]
    lowest = np.full(len(SPEEDS), np.inf)
    for m in eigenvalue.T:
        depth = np.where(m.real < 0, -1 / (2 * m.real), np.inf)
        phase = 2 * np.arctan2(-m.real, m.imag)
        for waves in range(lobes):
            speed = (2 * np.pi) ** 2 * frequency / (TEETH * (phase + 2 * np.pi * waves))
            slow, fast = np.minimum(speed[:-1], speed[1:]), np.maximum(speed[:-1], speed[1:])
            usable = np.isfinite(depth[:-1]) & np.isfinite(depth[1:]) & (fast < 1.05 * slow)
            first = np.searchsorted(SPEEDS, slow[usable])
            last = np.searchsorted(SPEEDS, fast[usable])
            for segment, begin, end in zip(np.flatnonzero(usable), first, last, strict=True):
                for i in range(begin, end):
                    share = (SPEEDS[i] - speed[segment]) / (speed[segment + 1] - speed[segment])
                    here = depth[segment] + share * (depth[segment + 1] - depth[segment])
                    lowest[i] = min(lowest[i], here)
    return lowest


def stability(options) -> str:
    """A map of 400 speeds, two modes along x and two along y, half immersion; CPU ms, least / median of the repeats."""
    modes = [Mode(*row) for row in ROWS]
    columns = dict(
        zip(("natural_frequency", "damping_ratio", "stiffness", "axes"), zip(*ROWS, strict=True), strict=True)
    )
    cutting = mean_cutting_matrix(KTC, KRC, teeth=TEETH, entry=np.pi / 2, leave=np.pi)
    known = Posterior(
        names=("Ktc", "Krc"),
        units=("N/m^2", "N/m^2"),
        mean=np.array([KTC, KRC]),
        covariance=np.diag([50e6, 60e6]) ** 2,
        interval=np.zeros((2, 2)),
        law="linear-edge",
        method="average",
    )

    def direct():
        return limit(SPEEDS, dynamics_of_modes(modes, SPEEDS, TEETH), cutting, TEETH).depth

    def whole_stage():
        return map_stability(
            Modes(**columns), known, teeth=TEETH, diameter=20e-3, radial_depth=10e-3, direction="down",
            feed_per_tooth=1e-4, spindle_speed=(SPEEDS[0], SPEEDS[-1]), points=400, members=200,
            rng=np.random.default_rng(0),
        )  # fmt: skip

    exact = direct()
    ways = {
        "solved at the speed": (direct, 20),
        "plain sweep, 8000 lines": (lambda: plain_sweep(modes, cutting), 1),
        "plain sweep, 2000 lines": (lambda: plain_sweep(modes, cutting, lines=2000), 1),
        "the stage with a band of 200 draws": (whole_stage, 1),
    }
    costs, found = {}, {}
    for name, (way, loops) in ways.items():
        costs[name] = []
        for _ in range(options.repeats):
            start = time.process_time()
            for _ in range(loops):
                found[name] = way()
            costs[name].append(1e3 * (time.process_time() - start) / loops)
    least = median(costs["solved at the speed"])
    rows = []
    for name, cost in costs.items():
        if name.startswith("the stage"):
            error = "-"
        else:
            off = np.abs(found[name] / exact - 1)
            error = f"{np.median(off):.1e} / {np.max(off):.1e}"
        rows.append((name, spread(cost), f"{median(cost) / least:.1f}", error))
    return table(("way", "CPU ms", "times", "relative error of the depth, median / largest"), *rows)


if __name__ == "__main__":
    from argparse import Namespace

    sys.stdout.write(stability(Namespace(repeats=3)) + "\n")
