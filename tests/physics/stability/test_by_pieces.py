"""The walk through a period piece by piece: against the matrix of all nodes, and what it makes of order, pattern and depth."""

from dataclasses import replace

import numpy as np
import pytest
from stability_cases import RPM, cut, machine
from test_floquet_order import random_point

from millcal.physics.stability import by_pieces, floquet
from millcal.physics.stability.floquet_kernel import flips, loudest, multipliers_of
from millcal.physics.stability.regeneration import TipModes
from millcal.physics.stability.stable_depths import edges_of

FLEXIBLE = replace(machine("UBC22"), flexibility=np.array([[2e-9, 5e-10], [5e-10, 3e-9]]))
PUSHED_ELSEWHERE = TipModes(  # a shape that is complex and an input that is another
    machine("ROT2").pole,
    machine("ROT2").output * np.exp([[0.2j], [-0.1j]]),
    machine("ROT2").given * np.exp([[0.1j], [0.1j]]),
    np.zeros((2, 2)),
)


def pitch(*degrees):
    return tuple(np.radians(degrees))


CASES = {  # tip, cut, rpm, depth m
    "helix": (machine("UBC22"), cut(4, 0.1, "down", "UBC22", wind=70.0), 4000, 3e-3),
    "a helix longer than a pitch": (machine("ROT2"), cut(3, 0.3, "up", wind=900.0), 12000, 4e-3),
    "next to no helix": (machine("IS1"), cut(2, 0.3, "down", wind=0.01), 9000, 1e-3),
    "one direction": (machine("IS1"), cut(4, 0.6, "up", pitch=pitch(80, 90, 100, 90)), 7000, 0.2e-3),
    "two pitches in turn": (machine("ROT2"), cut(4, 0.6, "up", pitch=pitch(85, 95, 85, 95)), 9000, 0.4e-3),
    "four pitches, slot": (machine("UBC22"), cut(4, 1.0, "up", "UBC22", pitch=pitch(80, 100, 85, 95)), 6000, 0.6e-3),
    "pitches and helix": (FLEXIBLE, cut(4, 0.5, "down", "UBC22", pitch=pitch(80, 100, 85, 95), wind=60.0), 6000, 0.6e-3),
    "complex modes": (PUSHED_ELSEWHERE, cut(3, 0.5, "up", pitch=pitch(110, 120, 130), wind=40.0), 8000, 0.5e-3),
}  # fmt: skip
EVERY = pytest.mark.parametrize(("tip", "this", "rpm", "depth"), CASES.values(), ids=CASES)


def at_once(tip, this, rpm, depth, order=28):
    """The problem of all nodes at once, and the depth it counts by."""
    return floquet.problem_of(tip, this, depth, order), rpm * RPM, 1.0 if this.wind else depth


@EVERY
def test_the_walk_has_the_multipliers_of_the_matrix_of_all_nodes_at_once(tip, this, rpm, depth):
    known = multipliers_of(*at_once(tip, this, rpm, depth))
    known = known[np.argsort(-np.abs(known))][:4]
    found = floquet.multipliers(rpm * RPM, depth, tip, this, tolerance=1e-9)[:4]
    # kinks that come back two delays later are kinks of the one and not of the other
    assert np.abs(found) == pytest.approx(np.abs(known), abs=2e-5 if not this.equal_pitch else 1e-9)


@EVERY
def test_arnoldi_finds_the_largest_of_the_matrix(tip, this, rpm, depth):
    whole = np.abs(floquet.multipliers(rpm * RPM, depth, tip, this))
    assert whole[0] == pytest.approx(floquet.spectral_radius([rpm * RPM], [depth], tip, this)[0], rel=1e-9)
    ready = by_pieces.Cut(tip, this)
    some = np.abs(ready.at(rpm * RPM, depth, ready.rate(rpm * RPM, depth), 4.0).largest(by_pieces.KEPT))
    near = whole[: len(some)] > 0.9
    assert some[near] == pytest.approx(whole[: len(some)][near], abs=1e-8)
    assert some == pytest.approx(whole[: len(some)], abs=by_pieces.WITHIN)


@EVERY
def test_the_chatter_frequency_is_that_of_the_matrix(tip, this, rpm, depth):
    known, multiplier = np.empty(1), floquet.multipliers(rpm * RPM, depth, tip, this, tolerance=1e-9)[:1]
    problem, speed, by = at_once(tip, this, rpm, depth)
    loudest(problem, np.array([speed]), np.array([by]), multiplier, known)
    found = floquet.chatter_frequency(np.array([speed]), np.array([depth]), multiplier, tip, this)
    assert found == pytest.approx(known, abs=0.02)


@pytest.mark.parametrize("degrees", [(85, 95, 85, 95), (110, 120, 130), (75, 105, 90, 90)], ids=str)
def test_flips_are_those_of_the_matrix(degrees):
    tip, this = machine("ROT2"), cut(len(degrees), 0.75, "down", pitch=pitch(*degrees))
    speeds, deepest = np.linspace(5000, 12000, 6) * RPM, 5e-3
    number = 0
    for speed in speeds:
        problem = floquet.problem_of(tip, this, 0.0, 30)
        known, count = np.empty((1, len(problem.piece))), np.empty(1, np.int64)
        flips(problem, np.array([speed]), deepest, known, count)
        found = floquet.flip_depths(speed, tip, this, deepest=deepest)
        assert found == pytest.approx(known[0, : count[0]], rel=1e-3)
        number += len(found)
    assert number > 0 or degrees == (85, 95, 85, 95)


@pytest.mark.parametrize("wind", [0.0, 60.0])
def test_a_pattern_that_repeats_has_the_multipliers_of_the_revolution(wind):
    tip, this = machine("UBC22"), cut(6, 0.6, "down", "UBC22", pitch=pitch(55, 65, 55, 65, 55, 65), wind=wind)
    speed, depth = 6000 * RPM, 0.5e-3
    short, whole = by_pieces.Cut(tip, this), by_pieces.Cut(tip, this, whole=True)
    assert (short.repeats, whole.repeats) == (3, 1)
    rate = short.rate(speed, depth)
    found, known = (np.abs(one.at(speed, depth, rate, 9.0).largest(4)) for one in (short, whole))
    assert found == pytest.approx(known, rel=1e-7)


@pytest.mark.parametrize(("count", "seed"), [(60, 1), pytest.param(600, 2, marks=pytest.mark.long)])
def test_the_rule_holds_its_tolerance_with_helix_and_pitches_that_overlap(count, seed):
    """But for a millionth: kinks that come back two delays later leave some 1e-6."""
    rng, errors = np.random.default_rng(seed), []
    while len(errors) < count:
        tip, this, speed, depth = random_point(rng)
        unequal = 2 * np.pi / this.teeth * (1 + 0.2 * rng.uniform(-1, 1, this.teeth))
        kind = {"wind": rng.uniform(20, 200) if rng.random() < 0.6 else 0.0, "indentation": 0.0, "pitch": None}
        if this.teeth > 1 and rng.random() < 0.7:
            kind["pitch"] = tuple(unequal * 2 * np.pi / unequal.sum())
        this = replace(this, **kind)
        ready = by_pieces.Cut(tip, this)
        rate = ready.rate(speed, depth)
        if not by_pieces.suits(this) or rate > 200:
            continue
        exact, *found = (abs(ready.at(speed, depth, rate, d).largest(1)[0]) for d in (14.0, 3.0, 4.0, 6.0))
        if 0.5 < exact < 2:
            errors.append(np.abs(np.array(found) - exact))
    assert np.all(np.max(errors, axis=0) <= (1e-3, 1e-4, 3e-6))


def test_far_beyond_the_limit_rounding_brings_no_stability_back():
    """A revolution multiplies waves by 1e14 there, and a dozen multipliers lie at the circle."""
    tip = machine("ROT2")
    degrees = pitch(84.52951, 96.68513, 86.49277, 92.29259)
    this = cut(4, 0.75, "down", pitch=tuple(np.array(degrees) * 2 * np.pi / sum(degrees)))
    found = floquet.boundary(np.array([6598.62 * RPM]), tip, this, deepest=20e-3)
    edges = edges_of(found, complete=True)
    assert edges.depth == pytest.approx([0.321365e-3], abs=1e-7)
    assert edges.loses.tolist() == [True]
