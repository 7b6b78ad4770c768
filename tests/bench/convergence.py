"""How two methods come to the multipliers of the slot at 5000 rpm that everybody compares with."""

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
from measure import table

sys.path.append(str(Path(__file__).parents[1] / "generators"))

DEPTHS = (0.2e-3, 0.5e-3, 0.7e-3, 1.0e-3)
QUOTED = (0.8192, 1.0726, 1.2197, 1.4040)
STEPS = (40, 80, 160, 320, 640)
ORDERS = (10, 15, 20, 25, 30, 40)


def convergence(options) -> str:
    """|mu| of the benchmark of Insperger and Stepan (922 Hz, two teeth), slot, 5000 rpm: the four values that are quoted as
    reference, first-order semi-discretization with p steps of a tooth period, its limit from p and p / 2, and n Gauss nodes.
    """
    from semi_discretization import StructuredSemiDiscretization
    from stability_cases import RPM, cut, machine

    from millcal.physics.stability.floquet import spectral_radius

    tip, this, speed = machine("IS1"), cut(2, 1.0, "down"), 5000 * RPM
    exact = spectral_radius(np.full(4, speed), np.array(DEPTHS), tip, this, order=60)

    def row(name, values):
        values = np.asarray(values)
        return (name, *(f"{value:.9f}" for value in values), f"{np.abs(values - exact).max():.0e}")

    rows, before = [("quoted", *(f"{value}" for value in QUOTED), f"{np.abs(QUOTED - exact).max():.0e}")], None
    for steps in STEPS:
        slow = StructuredSemiDiscretization(tip, this, steps)
        found = np.array([slow.radius(speed, depth) for depth in DEPTHS])
        rows.append(row(f"p = {steps}", found))
        if before is not None:
            rows.append(row(f"limit from {steps // 2} and {steps}", found + (found - before) / 3))
        before = found
    known_as = StructuredSemiDiscretization(tip, this, 200)
    rows.insert(1, row("p = 200", [known_as.radius(speed, depth) for depth in DEPTHS]))
    for order in ORDERS:
        found = spectral_radius(np.full(4, speed), np.array(DEPTHS), tip, this, order=order)
        rows.append(row(f"n = {order}", found))
    return table(("", *(f"{1e3 * depth:g} mm" for depth in DEPTHS), "largest error"), *rows)


if __name__ == "__main__":
    sys.stdout.write(convergence(Namespace()) + "\n")
