"""Maps of probability: the limits of a thousand structures and forces at three hundred speeds, by each method and one by one."""

import sys
import time
from functools import partial
from statistics import median

import numpy as np
from measure import spread, table

from millcal.physics.stability import floquet
from millcal.physics.stability.one_direction import boundary, stable_edges
from millcal.physics.stability.regeneration import Regeneration, tip_of_modes
from millcal.physics.stability.stable_depths import edge_table, edges_of, stable_share
from millcal.physics.stability.zero_order import dynamics_of_modes, limit, mean_cutting_matrix
from millcal.physics.stability.zero_order_draws import limits_of_draws
from millcal.physics.structure import Mode

RPM = 2 * np.pi / 60
FOUR = ((456.780, 0.111705, 7.9331e6, "x"), (1448.889, 0.017037, 14.6917e6, "x"),
        (516.518, 0.02458, 9.3746e6, "y"), (1408.448, 0.031358, 12.4064e6, "y"))  # fmt: skip
ONE = ((922.0, 0.011, 1.34e6, "x"),)
DRAWS, ALONE = 1000, 4  # draws together, and those of them that are also taken one by one
SPEEDS = np.linspace(4000, 16_000, 300) * RPM
DEPTHS = np.linspace(0, 6e-3, 61)[1:]


def drawn(rows, ktc, krc):
    """Frequencies known to 1 %, damping to 10 %, stiffness to 5 %, forces to 5 and 10 %; deterministic."""
    rng = np.random.default_rng(0)
    factors = rng.normal(1, [0.01, 0.1, 0.05], (DRAWS, len(rows), 3))
    modes = [[Mode(*(np.array(row[:3]) * f), row[3]) for row, f in zip(rows, some, strict=True)] for some in factors]
    return modes, np.array([ktc, krc]) * rng.normal(1, [0.05, 0.1], (DRAWS, 2))


def cost_of(way, repeats):
    """CPU seconds of the repeats, and what the last gave; what is compiled at the first call is there before."""
    way()
    spent, found = [], None
    for _ in range(repeats):
        start = time.process_time()
        found = way()
        spent.append(time.process_time() - start)
    return spent, found


def stability_draws(options) -> str:
    """A map of probability over 1000 draws x 300 speeds, two teeth, down; CPU s, least / median of the repeats, one thread.

    One by one: four of the draws alone, and their cost in proportion. The error is that of the first limit against them, for
    floquet at its own tolerance of 1e-4.
    """
    rows = []

    def add(name, together, alone):
        (cost, found), (each, exact) = cost_of(together, options.repeats), cost_of(alone, options.repeats)
        finite = np.isfinite(exact) & np.isfinite(found[:ALONE])
        off = np.abs(found[:ALONE][finite] / exact[finite] - 1)
        each = [DRAWS / ALONE * one for one in each]
        rows.append((
            name, spread(cost), f"{DRAWS * len(SPEEDS) / median(cost):.2g}", spread(each, ".1f"),
            f"{median(each) / median(cost):.1f}", f"{np.median(off):.0e} / {off.max():.0e}",
        ))  # fmt: skip

    for name, structure, ktc, krc, entry in (
        ("zero order, one mode, a/D 0.1", ONE, 6e8, 2e8, np.pi - np.arccos(0.8)),
        ("zero order, 2 x 2 modes, a/D 0.5", FOUR, 1319.4e6, 788.8e6, np.pi / 2),
    ):
        modes, force = drawn(structure, ktc, krc)
        matrices = np.array([mean_cutting_matrix(*some, teeth=2, entry=entry, leave=np.pi) for some in force])
        tips = [tip_of_modes(some) for some in modes]
        add(
            name,
            lambda tips=tips, matrices=matrices: limits_of_draws(SPEEDS, tips, matrices, 2),
            lambda modes=modes, matrices=matrices: np.array([
                limit(SPEEDS, dynamics_of_modes(some, SPEEDS, 2), matrix, 2).depth
                for some, matrix in zip(modes[:ALONE], matrices[:ALONE], strict=True)
            ]),
        )  # fmt: skip

    modes, force = drawn(ONE, 6e8, 2e8)
    tips = [tip_of_modes(some) for some in modes]
    for immersion in (0.1, 0.5, 1.0):
        cut = Regeneration(2, np.pi - np.arccos(1 - 2 * immersion), np.pi, 6e8, 2e8)

        def shares(cut=cut):
            edges = stable_edges(SPEEDS, tips, cut, force, deepest=DEPTHS[-1])
            stable_share(edges, DEPTHS)
            return edges[:, :, 0]

        def columns(cut=cut):
            found = []
            for tip, some in zip(tips[:ALONE], force[:ALONE], strict=True):
                crossings = floquet.boundary(SPEEDS, tip, cut.with_force(*some), deepest=DEPTHS[-1])
                found.append(edge_table(edges_of(crossings, complete=True), len(SPEEDS))[:, 0])
            return np.array(found)

        add(f"exact, one mode, a/D {immersion}, islands and 60 depths", shares, columns)
    first = table(
        ("map", "CPU s", "limits or columns per s", "one by one, CPU s", "times", "error, median / largest"), *rows
    )

    rows = []
    for immersion in (0.05, 0.1, 0.5, 1.0):
        cut = Regeneration(2, np.pi - np.arccos(1 - 2 * immersion), np.pi, 6e8, 2e8)
        speeds, tip = np.linspace(5000, 20_000, 200) * RPM, tip_of_modes([Mode(*ONE[0])])
        ways = [boundary, floquet.boundary]
        costs = [cost_of(partial(way, speeds, tip, cut, deepest=DEPTHS[-1]), options.repeats)[0] for way in ways]
        rows.append((
            f"{immersion}", *(spread([1e3 * c for c in cost], ".0f") for cost in costs),
            f"{median(costs[1]) / median(costs[0]):.1f}",
        ))  # fmt: skip
    single = table(("a/D", "trace of one mode, CPU ms", "multipliers of any modes, CPU ms", "times"), *rows)
    return f"{first}\n\nThe whole boundary of one structure with one mode, 200 speeds up to 6 mm:\n\n{single}"


if __name__ == "__main__":
    from argparse import Namespace

    sys.stdout.write(stability_draws(Namespace(repeats=2)) + "\n")
