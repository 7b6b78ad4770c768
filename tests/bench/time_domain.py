"""Cuts in the time domain: steps in a second, and what a map of points costs and says beside multipliers."""

import sys
import time

import numpy as np
from measure import spread, table

from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import Regeneration, TipModes, tip_of_modes, tip_of_shapes
from millcal.physics.stability.time_domain import simulate_points, steps_for
from millcal.physics.structure import Mode
from millcal.stages.stability.time_domain import simulated_cuts

RPM = 2 * np.pi / 60
STIFFNESS, MASS, DAMPING = 1.64e6, 2.51, 114.0
FLEXURE = tip_of_shapes(
    [np.sqrt(STIFFNESS / MASS) / (2 * np.pi)], [DAMPING / 2 / np.sqrt(STIFFNESS * MASS)], [[MASS**-0.5, 0.0]]
)
INSERT = Regeneration(1, np.arccos(2 * 5 / 15.88 - 1), np.pi, 903.9e6, 534.5e6)  # one tooth, 15.88 mm, 5 mm down
TWO_BY_TWO = tip_of_modes(
    (Mode(456.780, 0.111705, 7.9331e6, "x"), Mode(1448.889, 0.017037, 14.6917e6, "x"),
     Mode(516.518, 0.02458, 9.3746e6, "y"), Mode(1408.448, 0.031358, 12.4064e6, "y"))
)  # fmt: skip
HALF = Regeneration(4, np.pi / 2, np.pi, 1319.4e6, 788.8e6)
HELICAL = Regeneration(4, np.pi / 2, np.pi, 1319.4e6, 788.8e6, wind=np.tan(np.deg2rad(30)) / 10e-3)
FEED = 0.1e-3


def plain(speed: float, depth: float, steps: int, revolutions: int) -> int:
    """The same cut of one mode and one tooth as a script writes it, in plain Python.   returns steps"""
    dt = 2 * np.pi / speed / steps
    w, zeta = np.sqrt(STIFFNESS / MASS), DAMPING / 2 / np.sqrt(STIFFNESS * MASS)
    x = v = 0.0
    angle = (np.arange(steps) + 0.5) * 2 * np.pi / steps
    sine, cosine = np.sin(angle).tolist(), np.cos(angle).tolist()
    left = [0.0] * steps
    for _ in range(revolutions):
        for k in range(steps):
            force = 0.0
            if angle[k] >= INSERT.entry and angle[k] <= INSERT.leave:
                reach = (x + v * dt / 2) * sine[k]
                chip = FEED * sine[k] + reach - left[k]
                if chip > 0:
                    force = -depth * chip * (INSERT.ktc * cosine[k] + INSERT.krc * sine[k])
                    left[k] = reach
                else:
                    left[k] -= FEED * sine[k]
            v += dt * (force / MASS - 2 * zeta * w * v - w**2 * x)
            x += dt * v
    return revolutions * steps


def time_domain(options) -> str:
    """Cuts step by step, one thread; million steps per CPU second, most / median of the repeats. Where nothing cuts, the tip goes
    to the next tooth in one multiplication, and the steps between count as well."""

    def cuts(
        tip: TipModes, cut: Regeneration, rpm: float, depth: float, steps: int | None, revolutions: int, phases: int
    ):
        def run() -> int:
            seen = simulate_points(
                [rpm * RPM], [depth], tip, cut, feed_per_tooth=FEED, revolutions=revolutions, kept=1,
                phases=phases, steps_per_revolution=steps,
            )  # fmt: skip
            return seen.steps

        return run

    resolved = steps_for(6000 * RPM, 1e-3, TWO_BY_TWO, HALF)
    ways = {
        "one mode, one straight tooth, every step kept": cuts(FLEXURE, INSERT, 4500, 2e-3, 400, 20_000, 400),
        "the same, looked at eight times a revolution": cuts(FLEXURE, INSERT, 4500, 2e-3, 400, 20_000, 8),
        "the same in chatter": cuts(FLEXURE, INSERT, 6500, 8e-3, 400, 20_000, 8),
        f"2 x 2 modes, four straight teeth, half immersion, {resolved} steps": cuts(
            TWO_BY_TWO, HALF, 6000, 1e-3, None, 2000, 8
        ),
        "the same with a helix of 30 deg": cuts(TWO_BY_TWO, HELICAL, 6000, 4e-3, None, 500, 8),
        "one mode, one straight tooth, plain Python": lambda: plain(4500 * RPM, 2e-3, 400, 500),
    }
    rows = []
    for name, way in ways.items():
        way()
        rates = []
        for _ in range(options.repeats):
            start = time.process_time()
            steps = way()
            rates.append(steps / (time.process_time() - start) / 1e6)
        rows.append((name, f"{max(rates):.1f} / {np.median(rates):.1f}"))

    points = [
        values.ravel() for values in np.meshgrid(np.linspace(2500, 7500, 41) * RPM, np.linspace(0.5, 10, 20) * 1e-3)
    ]
    costs = []
    for _ in range(options.repeats):
        start = time.process_time()
        found, _ = simulated_cuts(FLEXURE, INSERT, *points, feed_per_tooth=FEED)
        costs.append(time.process_time() - start)
    start = time.process_time()
    radius = floquet.spectral_radius(*points, FLEXURE, INSERT)
    multipliers = time.process_time() - start
    same = (found.period == 1) == (radius < 1)
    far = np.abs(radius - 1) > 0.01
    said = (
        f"A map of 820 cuts (41 speeds, 20 depths, 400 to 2000 revolutions each): {spread(costs)} CPU s, least / median; its "
        f"multipliers: {multipliers:.2f} s. Both say the same of {same.sum()} cuts, and of {same[far].sum()} of the "
        f"{far.sum()} whose spectral radius is more than 0.01 from one."
    )
    return table(("cut", "million steps per CPU s"), *rows) + "\n\n" + said


if __name__ == "__main__":
    from argparse import Namespace

    sys.stdout.write(time_domain(Namespace(repeats=3)) + "\n")
