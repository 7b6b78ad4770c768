"""Stable depths of one mode in one direction, from one function of two numbers: published crossings, and other methods."""

import json
from pathlib import Path

import numpy as np
import pytest

from millcal.physics.stability import floquet
from millcal.physics.stability.one_direction import boundary, common_direction, signed_distance, stable_edges
from millcal.physics.stability.regeneration import KINDS, Regeneration, tip_of_shapes
from millcal.physics.stability.stable_depths import edge_table, edges_of, is_stable
from millcal.physics.stability.zero_order import mean_cutting_matrix
from millcal.physics.stability.zero_order_draws import limits_of_one_mode

RPM = 2 * np.pi / 60
STIFFNESS = 0.03993 * (2 * np.pi * 922.0) ** 2
ORACLES = json.loads((Path(__file__).parents[2] / "references" / "stability" / "oracles.json").read_text())["cases"]
ONE_MODE = [
    c for c in ORACLES if c["modes"] == "IS1" and not (c["pitch_deg"] or c["helix"] or c["process_damping"])
]  # fmt: skip


def engaged(immersion, direction):
    swept = np.arccos(1 - 2 * immersion)
    return (0.0, swept) if direction == "up" else (np.pi - swept, np.pi)


def tip(frequency=922.0, damping=0.011, stiffness=STIFFNESS, angle=0.0):
    size = 2 * np.pi * frequency / np.sqrt(stiffness)
    return tip_of_shapes([frequency], [damping], size * np.array([[np.cos(angle), np.sin(angle)]]))


@pytest.mark.parametrize("case", ONE_MODE, ids=lambda c: f"{c['N']}-{c['a_over_D']}-{c['milling']}")
def test_all_edges_of_the_benchmark_come_out_islands_among_them(case):
    """Crossings computed by two other methods: first limits, flips that close again, pockets between flip and Hopf."""
    cut = Regeneration(case["N"], *engaged(case["a_over_D"], case["milling"]), case["Kt"], case["Kn"])
    for row in case["crossings"]:
        force = [[case["Kt"], case["Kn"]]]
        found = stable_edges(np.array([row["rpm"] * RPM]), [tip()], cut, force, deepest=row["amax_m"])[0, 0]
        expected = [crossing["ap_m"] for crossing in row["list"]]
        np.testing.assert_allclose(found[np.isfinite(found)], expected, atol=6e-9)
        exact = boundary(np.array([row["rpm"] * RPM]), tip(), cut, deepest=row["amax_m"])
        np.testing.assert_allclose(exact.depth, expected, atol=6e-11)  # half of the last printed digit
        assert [KINDS[kind][0].upper() for kind in exact.kind] == [crossing["type"] for crossing in row["list"]]
        assert list(exact.loses) == [crossing["loses_stability"] for crossing in row["list"]]


@pytest.mark.parametrize("seed", range(10))
def test_labels_are_those_of_the_multipliers(seed):
    """Any angle of the mode, overlapping teeth, up to eight waves between two teeth and far beyond the limit."""
    rng = np.random.default_rng(seed)
    teeth, swept = int(rng.integers(1, 7)), np.arccos(1 - 2 * rng.uniform(0.02, 1))
    entry, leave = (0.0, swept) if rng.random() < 0.5 else (np.pi - swept, np.pi)
    frequency, damping, stiffness = rng.uniform(200, 2000), rng.uniform(0.005, 0.08), rng.uniform(2e6, 3e7)
    cut = Regeneration(teeth, entry, leave, 7e8, 7e8 * rng.uniform(0.05, 0.8))
    mode = tip(frequency, damping, stiffness, rng.uniform(0, np.pi))
    speeds = 2 * np.pi * frequency / teeth / rng.uniform(0.5, 8, 15)
    deepest = rng.choice([5, 20, 60]) * 2 * stiffness * damping / (7e8 * teeth * swept / (2 * np.pi))
    depth = rng.uniform(0, deepest, (15, 20))
    edges = stable_edges(speeds, [mode], cut, [[cut.ktc, cut.krc]], deepest=deepest)[0]
    radius = floquet.spectral_radius(np.repeat(speeds, 20), depth.ravel(), mode, cut, tolerance=1e-6)
    clear = np.abs(radius - 1) > 1e-5
    assert np.array_equal(is_stable(edges[:, np.newaxis], depth).ravel()[clear], (radius < 1)[clear])


@pytest.mark.parametrize("seed", range(6))
def test_the_boundary_is_that_of_the_multipliers_with_kinds_and_chatter_frequencies(seed):
    rng = np.random.default_rng(seed)
    cut = Regeneration(
        int(rng.integers(1, 7)), *engaged(rng.uniform(0.02, 1), "down"), 7e8, rng.uniform(0.1, 0.8) * 7e8
    )
    mode = tip(rng.uniform(200, 2000), rng.uniform(0.005, 0.08), 1e7, rng.uniform(0, np.pi))
    natural = np.abs(mode.pole[0])
    speeds, deepest = natural / cut.teeth / rng.uniform(0.4, 6, 25), 1e7 * 40 * 0.03 / (7e8 * cut.in_cut)
    found = boundary(speeds, mode, cut, deepest=deepest)
    other = edges_of(floquet.boundary(speeds, mode, cut, deepest=deepest, tolerance=1e-6), complete=True)
    np.testing.assert_allclose(edge_table(found, 25), edge_table(other, 25), rtol=3e-6)
    for part in ("kind", "loses"):
        np.testing.assert_array_equal(getattr(found, part), getattr(other, part))
    np.testing.assert_allclose(found.frequency, other.frequency, rtol=1e-5)


def test_each_draw_has_the_edges_of_its_own_structure_and_force_alone():
    """The table over sigma and K_rc / K_tc, spanned by all draws, against one that a single draw spans."""
    rng = np.random.default_rng(2)
    cut, speeds = Regeneration(2, *engaged(0.1, "down"), 6e8, 2e8), np.linspace(5000, 12_000, 60) * RPM
    tips = [tip(922 * g, 0.011 * h, STIFFNESS * k) for g, h, k in rng.normal(1, [0.03, 0.2, 0.1], (12, 3))]
    force = np.array([6e8, 2e8]) * rng.normal(1, [0.1, 0.3], (12, 2))
    together = stable_edges(speeds, tips, cut, force, deepest=8e-3)
    for i in range(12):
        alone = stable_edges(speeds, tips[i : i + 1], cut, force[i : i + 1], deepest=8e-3)[0]
        np.testing.assert_allclose(together[i, :, : alone.shape[1]], alone, atol=2e-7)
        assert np.all(np.isinf(together[i, :, alone.shape[1] :]))


@pytest.mark.parametrize("speeds", [np.linspace(3000, 30_000, 40), np.array([120.0, 300.0, 700.0])])
def test_where_the_cutting_is_constant_the_first_edge_is_the_zero_order_limit(speeds):
    """Four teeth in a slot: the sum of their forces does not turn with the cutter, and the mean of the zero order is exact."""
    ktc, krc = 6e8, 2e8
    cut, matrix = Regeneration(4, 0.0, np.pi, ktc, krc), mean_cutting_matrix(ktc, krc, teeth=4, entry=0.0, leave=np.pi)
    zero_order = limits_of_one_mode(speeds * RPM, 922.0, 0.011, STIFFNESS, matrix[0, 0], 4)[0]
    deepest = 1.2e-3
    found = stable_edges(speeds * RPM, [tip()], cut, [[ktc, krc]], deepest=deepest)[0, :, 0]
    shallow = zero_order < deepest
    assert shallow.any()
    np.testing.assert_allclose(found[shallow], zero_order[shallow], rtol=1e-6, atol=2e-9)
    assert np.all(np.isinf(found[~shallow]))


# One tooth, D 15.88 mm, radial depth 5 mm, down, the flexure compliant along x; k, m, c as measured. F flip, H Hopf; mm.
FLEXURE = """2500 7.79251H, 3000 2.56558F 4.95428F 7.11042H, 3500 3.40265H, 3679 6.33290H, 3750 10.69471H, 3873, 3920 10.73921F,
4000 8.92305F, 4117 7.20995F, 4222 6.12507F, 4252 5.86098F, 4400 4.74230F, 4500 4.10073F, 4567 3.70390F, 4750 2.72027F,
5000 1.90966F, 5233 7.23551H, 5500 4.39657H, 6000 3.27544H, 6500 3.69398H, 7000 5.85903H, 7250 9.02270H, 7500"""


def test_the_flexure_of_cornelius_loses_stability_where_collocation_says_so():
    """Every first loss to the last digit, flips where the zero order sees none, and the flip island at 3000 rpm."""
    stiffness, mass, damping = 1.64e6, 2.51, 114.0
    mode = tip(np.sqrt(stiffness / mass) / (2 * np.pi), damping / (2 * np.sqrt(stiffness * mass)), stiffness)
    cut = Regeneration(1, *engaged(5 / 15.88, "down"), 903.9e6, 534.5e6)
    for row in FLEXURE.replace("\n", " ").split(","):
        rpm, *expected = row.split()
        found = boundary(np.array([float(rpm) * RPM]), mode, cut, deepest=12e-3)
        told = [
            f"{depth * 1e3:.5f}{KINDS[kind][0].upper()}" for depth, kind in zip(found.depth, found.kind, strict=True)
        ]
        assert told[: len(expected)] == expected, rpm
        assert bool(told) == bool(expected), rpm


def test_stiffness_over_force_is_the_unit_of_depth():
    cut, speeds = Regeneration(3, *engaged(0.2, "up"), 6e8, 2e8), np.linspace(4000, 9000, 20) * RPM
    one = stable_edges(speeds, [tip()], cut, [[6e8, 2e8]], deepest=4e-3)
    softer = stable_edges(speeds, [tip(stiffness=STIFFNESS / 2)], cut, [[12e8, 4e8]], deepest=1e-3)
    np.testing.assert_allclose(softer * 4, one, rtol=1e-7)


def test_the_distance_to_the_nearest_edge_is_positive_in_the_stable_set():
    edges = np.array([2.0, 3.0, 5.0, np.inf])
    depth = np.array([0.5, 1.9, 2.2, 2.9, 3.5, 5.0, 9.0])
    np.testing.assert_allclose(signed_distance(edges, depth), [1.5, 0.1, -0.2, -0.1, 0.5, -0.0, -4.0])
    assert np.all(np.isinf(signed_distance(np.array([np.inf]), depth)))


def test_other_structures_and_cutters_are_refused():
    speeds, force = np.array([500.0]), [[6e8, 2e8]]
    cut = Regeneration(2, 0.0, 1.0, 6e8, 2e8)
    two = tip_of_shapes([500.0, 900.0], [0.02, 0.02], [[1.0, 0.0], [0.5, 0.0]])
    assert common_direction([two]) is None
    assert common_direction([tip(), tip(angle=0.1)]) is None
    np.testing.assert_allclose(np.abs(common_direction([tip(angle=0.3)] * 2)), [np.cos(0.3), np.sin(0.3)])
    with pytest.raises(ValueError, match="one real mode"):
        stable_edges(speeds, [two], cut, force, deepest=1e-3)
    with pytest.raises(ValueError, match="helix"):
        stable_edges(speeds, [tip()], Regeneration(2, 0.0, 1.0, 6e8, 2e8, wind=50.0), force, deepest=1e-3)
    with pytest.raises(ValueError, match="K_tc"):
        stable_edges(speeds, [tip()], cut, [[-6e8, 2e8]], deepest=1e-3)
