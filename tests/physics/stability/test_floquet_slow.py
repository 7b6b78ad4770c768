"""The Floquet method against two slow ones that share nothing with it: semi-discretization, and motions followed in time."""

import linear_time
import numpy as np
import pytest
import semi_discretization
from stability_cases import RPM, cut, machine

from millcal.physics.stability.floquet import multipliers


def pitch(*degrees):
    return tuple(np.radians(degrees))


POINTS = {  # machine, cut, rpm, depth m
    "two modes in x and two in y": ("UBC22", cut(2, 0.5, "down", "UBC22"), 6000, 1.5e-3),
    "unequal pitch": ("IS1", cut(4, 0.1, "down", pitch=pitch(70, 110, 70, 110)), 5000, 2e-3),
    "helix": ("IS1", cut(2, 0.1, "down", wind=115.0), 10000, 2e-3),
    "modes of any direction, overlapping teeth": ("ROT2", cut(3, 0.5, "down"), 9000, 0.4e-3),
    "process damping": ("ASYM2", cut(2, 0.5, "down", indentation=3e4, radius=5e-3), 6000, 0.3e-3),
    "unequal pitch, overlapping": ("ROT2", cut(4, 0.6, "up", pitch=pitch(80, 90, 100, 90)), 9000, 0.4e-3),
    "unequal pitch, overlapping, helix": (
        "ROT2",
        cut(4, 0.5, "down", pitch=pitch(80, 90, 100, 90), wind=60.0),
        9000,
        0.4e-3,
    ),
    "helix longer than a pitch": ("ROT2", cut(3, 0.3, "up", wind=900.0), 12000, 4e-3),
    "all at once": (
        "UBC22",
        cut(3, 0.75, "up", "UBC22", pitch=pitch(110, 120, 130), wind=90.0, indentation=3e4, radius=5e-3),
        6000,
        0.6e-3,
    ),
}
QUICK = ("two modes in x and two in y", "unequal pitch", "helix", "modes of any direction, overlapping teeth")
EVERY = pytest.mark.parametrize(
    ("name", "this", "rpm", "depth"),
    [pytest.param(*point, id=name, marks=() if name in QUICK else pytest.mark.long) for name, point in POINTS.items()],
)


@EVERY
def test_semi_discretization_goes_to_the_same_multiplier_with_the_square_of_the_step(name, this, rpm, depth):
    """With forty steps to a wave and more, twice the steps take away three quarters of the error; two numbers give the limit."""
    tip, speed = machine(name), rpm * RPM
    here = abs(multipliers(speed, depth, tip, this, tolerance=1e-8)[0])
    period = 2 * np.pi / speed / (this.teeth if this.equal_pitch else 1)
    unit = 1 if this.equal_pitch else 36  # so that every delay is a whole number of steps
    steps = unit * int(np.ceil(40 * np.abs(tip.pole).max() / (2 * np.pi) * period / unit))
    coarse, fine = (semi_discretization.spectral_radius(speed, depth, tip, this, p) for p in (steps, 2 * steps))
    assert 3.7 < (coarse - here) / (fine - here) < 4.2
    assert semi_discretization.richardson(coarse, fine) == pytest.approx(here, abs=5e-5)


@EVERY
def test_motions_followed_in_time_grow_as_the_multiplier_says(name, this, rpm, depth):
    """A differential equation solver that knows neither nodes nor matrices finds |mu| to 1e-6."""
    tip, speed = machine(name), rpm * RPM
    here = abs(multipliers(speed, depth, tip, this, tolerance=1e-8)[0])
    assert linear_time.spectral_radius(speed, depth, tip, this, motions=12) == pytest.approx(here, abs=1e-6)


def test_the_slow_ways_know_the_benchmark():
    """Slot, 5000 rpm: what is printed of first-order semi-discretization, p = 40, 80, 160, and the converged value."""
    tip, this, speed = machine("IS1"), cut(2, 1.0, "down"), 5000 * RPM
    for depth, rows, exact in (
        (0.2e-3, (0.8087, 0.8169, 0.8190), 0.819742784),
        (0.5e-3, (1.0437, 1.0662, 1.0720), 1.073975587),
        (1.0e-3, (1.3503, 1.3921, 1.4029), 1.406473525),
    ):
        found = [semi_discretization.spectral_radius(speed, depth, tip, this, steps) for steps in (40, 80, 160)]
        assert found == pytest.approx(rows, abs=1e-4)
        assert semi_discretization.richardson(*found[1:]) == pytest.approx(exact, abs=3e-4)
    assert linear_time.spectral_radius(speed, depth, tip, this) == pytest.approx(exact, abs=1e-7)
