"""The map by methods that see period doubling: limits of the physics, islands in the probabilities, bands that hold."""

from dataclasses import replace

import numpy as np
import pytest

from millcal.data import CutTests, Modes, Posterior
from millcal.errors import IllPosedError
from millcal.io.summaries import summarise
from millcal.physics.stability import floquet
from millcal.physics.stability.regeneration import FLIP, HOPF, Regeneration, tip_of_modes
from millcal.physics.stability.stable_depths import edge_table, edges_of, is_stable
from millcal.physics.structure import Mode
from millcal.stages.stability import map_stability
from millcal.stages.stability.modes import poles_of_modes
from millcal.stages.stability.pockets import around
from tests.stages.stability.test_modes import fitted, lines_of, residues

RPM = 2 * np.pi / 60
KTC, KRC = 600e6, 200e6
ONE = Modes(natural_frequency=[922.0], damping_ratio=[0.011], stiffness=[1.34e6], axes=("x",))
TWO = Modes(natural_frequency=[922.0, 1100.0], damping_ratio=[0.02, 0.03], stiffness=[1.34e6, 2.0e6], axes=("x", "y"))
CUT = {
    "teeth": 2,
    "diameter": 12e-3,
    "radial_depth": 1.2e-3,
    "direction": "down",
    "feed_per_tooth": 0.1e-3,
    "spindle_speed": (5000 * RPM, 20_000 * RPM),
    "rigid": "y",
}
BOTH = {key: value for key, value in CUT.items() if key != "rigid"}
ENTRY, LEAVE = float(np.arccos(2 * 0.1 - 1)), np.pi
PROBLEM = Regeneration(2, ENTRY, LEAVE, KTC, KRC)
MODES_OF_ONE = [Mode(922.0, 0.011, 1.34e6, "x")]


def coefficients(share=0.05, correlation=0.3):
    mean, sd = np.array([KTC, KRC]), share * np.array([KTC, KRC])
    shape = np.array([[1.0, correlation], [correlation, 1.0]])
    return Posterior(
        names=("Ktc", "Krc"), units=("N/m^2",) * 2, mean=mean, covariance=shape * np.outer(sd, sd),
        interval=np.stack([mean - 2 * sd, mean + 2 * sd], axis=1), law="linear-edge", method="average",
    )  # fmt: skip


def codes(found):
    return {notice.code for notice in found.notices}


@pytest.fixture(scope="module")
def one():
    return map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=40, deepest=6e-3)


def test_floquet_maps_the_crossings_of_the_physics(one):
    found = floquet.boundary(one.spindle_speed, tip_of_modes(MODES_OF_ONE), PROBLEM, deepest=6e-3)
    np.testing.assert_allclose(one.crossing_depth, found.depth, rtol=1e-9)
    np.testing.assert_array_equal(one.crossing_kind, found.kind)
    first = found.first(40)
    np.testing.assert_allclose(one.limit_depth, first.depth, rtol=1e-9)
    np.testing.assert_array_equal(one.limit_kind, first.kind)
    assert {FLIP, HOPF, -1} == set(one.limit_kind)
    assert one.absolute_minimum <= first.depth.min() * (1 + 1e-9)


def test_flips_chatter_at_half_the_tooth_frequency_or_an_odd_multiple_of_it(one):
    flips = one.crossing_kind == FLIP
    halves = one.crossing_frequency[flips] / (2 * one.crossing_speed[flips] / (2 * np.pi))  # of the tooth frequency
    np.testing.assert_allclose(halves % 1, 0.5, atol=1e-9)


@pytest.mark.parametrize("method", ["floquet", "frf"])
def test_with_four_teeth_in_a_slot_every_method_is_the_zero_order_one(method):
    """The mean force is the force there: nothing is periodic."""
    cut = {**BOTH, "teeth": 4, "direction": "slot", "points": 12, "spindle_speed": (6000 * RPM, 12_000 * RPM)}
    modes = fitted(TWO, residue=residues(TWO))
    frf = replace(lines_of(modes), usable_band=(1.0, 2500.0))
    zoa = map_stability(modes, (KTC, KRC), **cut, method="zoa")
    found = map_stability(frf if method == "frf" else modes, (KTC, KRC), **cut, method=method)
    within = zoa.limit_depth < found.deepest
    rtol = {"floquet": 1e-5, "frf": 0.01}[method]
    np.testing.assert_allclose(found.limit_depth[within], zoa.limit_depth[within], rtol=rtol)


def test_where_zero_order_is_wrong_that_is_told_with_the_speed():
    found = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=60)
    (told,) = (notice.message for notice in found.notices if notice.code == "methods-disagree")
    assert "rpm" in told
    slot = map_stability(ONE, (KTC, KRC), **{**CUT, "teeth": 4, "direction": "slot"}, method="floquet", points=30)
    assert "methods-disagree" not in codes(slot)


def test_stiffer_modes_and_weaker_coefficients_move_all_depths_by_the_same_factor(one):
    for modes, known in ((replace(ONE, stiffness=2 * ONE.stiffness), (KTC, KRC)), (ONE, (KTC / 2, KRC / 2))):
        found = map_stability(modes, known, **CUT, method="floquet", points=40, deepest=12e-3)
        np.testing.assert_allclose(found.crossing_depth, 2 * one.crossing_depth, rtol=1e-6)


def test_how_deep_it_looked_is_told_unless_it_was_asked_and_holds_the_operating_point():
    found = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=10, operating_point=(9000 * RPM, 30e-3))
    assert found.deepest == pytest.approx(45e-3)
    assert "deepest" in codes(found)
    asked = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=10, deepest=3e-3)
    assert asked.deepest == 3e-3
    assert "deepest" not in codes(asked)
    assert np.all(asked.crossing_depth <= 3e-3)


def test_best_speeds_and_operating_point_hold_against_the_way_round_the_circle():
    found = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=60, operating_point=(7500 * RPM, 2e-3))
    best = np.array([best.spindle_speed for best in found.best])
    at = np.append(around(best, *CUT["spindle_speed"]), 7500 * RPM)  # a best speed holds a little off, too
    every = edge_table(
        edges_of(floquet.all_crossings(at, tip_of_modes(MODES_OF_ONE), PROBLEM, deepest=found.deepest), complete=True),
        len(at),
    )[:, 0]
    every = np.append(every[:-1].reshape(3, -1).min(axis=0), every[-1])
    limits = [*(best.axial_depth for best in found.best), found.operating.limit]
    np.testing.assert_allclose(limits, np.minimum(every, found.deepest), rtol=1e-6)
    assert "pocket-missed" not in codes(found)


@pytest.mark.parametrize("known", ["coefficients", "one mode", "two modes"])
def test_a_probability_counts_the_draws_whose_stable_set_holds_the_depth(known):
    """Each draw solved by itself, islands and all; drawn here by the covariance."""
    rng = np.random.default_rng(3)
    posterior, many = coefficients(), 200
    if known == "coefficients":
        modes, cut = ONE, CUT
        tips = [tip_of_modes(MODES_OF_ONE)] * many
    else:
        base, cut = (ONE, CUT) if known == "one mode" else (TWO, BOTH)
        dofs = ("tipX",) if known == "one mode" else ("tipX", "tipY")
        residue = residues(base)[:, : len(dofs), : len(dofs)]
        shares = rng.standard_normal((4, len(base.axes)))
        deviations = (shares * 2.0, shares * 5e-4, 0.02 * residue * shares[:, :, None, None])
        modes = fitted(base, residue=residue, deviations=deviations, dof=np.inf, dofs=dofs)
        tips = list(poles_of_modes(modes).draws(rng, many))
    found = map_stability(
        modes, posterior, **cut, method="floquet", points=6, deepest=5e-3, members=2000, probability=20,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    forces = posterior.sample(rng, many)
    each = np.zeros((20, 6))
    for tip, force in zip(tips, forces, strict=True):
        edges = edges_of(
            floquet.boundary(found.spindle_speed, tip, PROBLEM.with_force(*force), deepest=5e-3, depths=10),
            complete=True,
        )
        table = edge_table(edges, 6)
        each += [is_stable(table, np.full(6, depth)) for depth in found.probability_depth]
    each /= many
    drawn = 200 if known == "two modes" else 1000
    sd = np.sqrt(0.25 / many + 0.25 / drawn)
    assert np.abs(found.probability - each).max() < 4 * sd
    assert np.abs(found.probability - each).mean() < 0.5 * sd
    assert 0.0 < found.probability.mean() < 1.0


def test_an_island_of_flips_is_an_island_of_the_probability():
    """At 7500 rpm flips from 1.9 to 2.4 mm, stable above them up to 2.55 mm; the coefficients nearly exact."""
    cut = {**CUT, "radial_depth": 1.2e-3, "spindle_speed": (7500 * RPM, 7600 * RPM)}
    found = map_stability(
        ONE, coefficients(1e-3), **cut, method="floquet", points=2, deepest=3e-3, probability=60,
        rng=np.random.default_rng(0), operating_point=(7500 * RPM, 2.45e-3),
    )  # fmt: skip
    at = np.interp([1.5e-3, 2.1e-3, 2.45e-3, 2.8e-3], found.probability_depth, found.probability[:, 0])
    np.testing.assert_allclose(at, [1, 0, 1, 0], atol=0.02)
    assert found.operating.stable
    assert found.operating.limit < 2e-3
    assert found.operating.kind == "hopf"
    assert found.operating.p_stable > 0.9
    assert "island" in found.operating.advice[0]
    below = map_stability(ONE, (KTC, KRC), **cut, method="floquet", points=2, operating_point=(7500 * RPM, 2.1e-3))
    assert not below.operating.stable
    assert below.operating.kind == "flip"


def test_zero_order_probabilities_fall_with_depth_and_meet_the_band():
    found = map_stability(
        TWO, coefficients(), **BOTH, method="zoa", points=50, probability=True, rng=np.random.default_rng(0)
    )
    assert np.all(np.diff(found.probability, axis=0) <= 1e-12)
    for edge, share in ((found.limit_low, 0.975), (found.limit_high, 0.025)):
        for i in range(50):
            if edge[i] < found.probability_depth[-2]:
                step = found.probability_depth[1] - found.probability_depth[0]
                around = np.interp([edge[i] + step, edge[i] - step], found.probability_depth, found.probability[:, i])
                assert around[0] <= share + 0.02
                assert around[1] >= share - 0.02


def test_without_anything_uncertain_there_is_no_probability_and_that_is_said():
    found = map_stability(ONE, (KTC, KRC), **CUT, points=5, probability=True, rng=np.random.default_rng(0))
    assert found.probability is None
    assert "no-probability" in codes(found)


@pytest.mark.parametrize("seeds", [25, pytest.param(200, marks=pytest.mark.long)])
def test_the_band_of_floquet_holds_the_true_limit_at_the_stated_rate(seeds):
    """Estimates scattered as their covariance says, fitted mode and coefficients together; speeds go together."""
    base = residues(ONE)[:, :1, :1]
    unit = (np.array([[2.0]]), np.array([[4e-4]]), 0.02 * base[np.newaxis])
    truth = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=5, deepest=8e-3).limit_depth
    inside = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        z = rng.standard_normal(3)
        deviations = tuple(
            np.concatenate([part * (i == j) for j in range(3)]) for i, part in enumerate(unit)
        )  # three independent errors
        moved = replace(
            ONE, natural_frequency=ONE.natural_frequency + 2.0 * z[0], damping_ratio=ONE.damping_ratio + 4e-4 * z[1]
        )
        modes = fitted(moved, residue=base * (1 + 0.02 * z[2]), deviations=deviations, dof=np.inf, dofs=("tipX",))
        known = coefficients()
        known = replace(known, mean=known.sample(rng, 1)[0])
        found = map_stability(modes, known, **CUT, method="floquet", points=5, deepest=8e-3, members=200, rng=rng)
        inside.append((found.limit_low <= truth) & (truth <= found.limit_high))
    rate = float(np.mean(inside))
    print(f"\n{rate:.3f} of the limits held, of {seeds} seeds")
    assert 0.95 - 3 * np.sqrt(0.05 * 0.95 / seeds) - 0.01 < rate < 0.995


def test_torque_and_power_are_those_of_the_depth_that_may_be_run():
    found = map_stability(ONE, (KTC, KRC), **CUT, points=40, edge=(20e3, 5e3))
    for best in found.best:
        swept = LEAVE - ENTRY
        per_depth = 6e-3 * 2 / (2 * np.pi) * (KTC * 0.1e-3 * (np.cos(ENTRY) - np.cos(LEAVE)) + 20e3 * swept)
        assert best.torque == pytest.approx(per_depth * best.axial_depth)
        assert best.power == pytest.approx(best.torque * best.spindle_speed)
    assert all(best.torque is None for best in map_stability(ONE, (KTC, KRC), **CUT, points=40).best)
    safe = map_stability(ONE, coefficients(), **CUT, points=40, edge=(20e3, 5e3), rng=np.random.default_rng(0)).best[0]
    assert safe.torque == pytest.approx(per_depth * safe.safe_depth)


def test_cuts_made_are_held_against_the_map():
    made = CutTests(
        spindle_speed=np.array([7500.0, 7500.0, 7500.0]) * RPM,
        axial_depth=np.array([1e-3, 2.1e-3, 2.45e-3]),
        stable=np.array([1.0, 0.0, 1.0]),
        name="cuts.csv",
    )
    seen = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=5, tests=made)
    blind = map_stability(ONE, (KTC, KRC), **CUT, method="zoa", points=5, tests=made)
    assert [n.message for n in seen.notices if n.code == "tests"] == ["3 of 3 test cuts went as the map says"]
    np.testing.assert_array_equal(
        seen.tests.stable_by_map, [1, 0, 1]
    )  # no speed of the map is within 1000 rpm of theirs
    assert summarise(seen)["tests"]["as_mapped"] == 3
    np.testing.assert_array_equal(blind.tests.stable_by_map, [1, 1, 1])
    (told,) = (n.message for n in blind.notices if n.code == "tests")
    assert told.startswith("2 of 3")
    assert "7500 rpm 2.1 mm chattered" in told


@pytest.mark.parametrize("method", ["zoa", "floquet"])
def test_cuts_outside_the_map_neither_agree_with_it_nor_not(method):
    def told(rpm, depth_mm):
        made = CutTests(
            spindle_speed=np.array(rpm) * RPM, axial_depth=np.array(depth_mm) * 1e-3,
            stable=np.array([1.0] + [0.0] * (len(rpm) - 1)), name="cuts.csv",
        )  # fmt: skip
        found = map_stability(ONE, (KTC, KRC), **CUT, method=method, points=5, tests=made)
        return [(n.message, n.level) for n in found.notices if n.code == "tests"]

    within = "1 of 1 test cuts went as the map says"
    assert told([7500], [1.0]) == [(within, "note")]
    assert told([7500, 170, 180], [1.0, 0.2, 9.0]) == [(f"{within}; 2 more lie outside the map", "note")]
    assert told([7500, 25_000], [1.0, 0.2]) == [(f"{within}; 1 more lies outside the map", "note")]
    ((nothing, level),) = told([170, 180], [1.0, 0.2])
    assert nothing.startswith("no test cut lies on this map of 5000 to 20000 rpm")
    assert level == "warning"


def test_process_damping_deepens_the_limit_and_a_helix_changes_it():
    plain = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=10, deepest=4e-3)
    damped = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=10, deepest=4e-3, indentation=2e5)
    assert np.all(np.minimum(damped.limit_depth, 4e-3) >= np.minimum(plain.limit_depth, 4e-3) * (1 - 1e-9))
    assert np.any(damped.limit_depth > plain.limit_depth)
    blind = map_stability(ONE, (KTC, KRC), **CUT, method="zoa", points=5, indentation=2e5)
    assert "no-process-damping" in codes(blind)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"helix": 0.5}, marks=pytest.mark.long),
        {"indentation": 1e5},
        {"pitch": tuple(np.radians([170.0, 190.0]))},
    ],
)
def test_bands_with_helix_process_damping_or_unequal_pitch_are_those_of_draws_by_themselves(options):
    cut = {**CUT, "spindle_speed": (9000 * RPM, 10_000 * RPM)}
    known = coefficients()
    found = map_stability(
        ONE, known, **cut, **options, method="floquet", points=2, deepest=4e-3, rng=np.random.default_rng(0)
    )
    draws = known.sample(np.random.default_rng(1), 30)
    each = [
        map_stability(
            ONE, tuple(draw), **cut, **options, method="floquet", points=2, deepest=5e-3, members=0
        ).limit_depth
        for draw in draws
    ]
    inside = (found.limit_low <= each) & (np.array(each) <= found.limit_high)
    assert np.all(np.abs(inside.mean(axis=0) - 0.95) < 0.14)


@pytest.mark.parametrize(
    ("method", "dynamics", "options", "words"),
    [
        ("floquet", "frf", {}, "fit them first"),
        ("time-domain", "frf", {}, "fit them first"),
        ("frf", "modes", {}, "only modes"),
        ("frf", "frf", {"helix": 0.5}, "a helix"),
        ("frf", "frf", {"pitch": tuple(np.radians([170.0, 190.0]))}, "unequal pitch"),
        ("frf", "frf", {"indentation": 1e5}, "process damping"),
        ("time-domain", "modes", {"feed_per_tooth": None}, "feed_per_tooth_mm"),
    ],
)
def test_what_a_method_cannot_do_is_refused_with_the_way_out(method, dynamics, options, words):
    modes = fitted(TWO, residue=residues(TWO))
    with pytest.raises(IllPosedError, match=words):
        map_stability(
            lines_of(modes) if dynamics == "frf" else modes, (KTC, KRC), **{**BOTH, **options}, method=method, points=5
        )


def test_an_inertia_line_becomes_a_mode_below_the_band_and_a_flexibility_stays():
    """From three times the band's lowest frequency on, the poles miss a tenth of the line at most, less and less."""
    remainder = np.array([np.diag([30.0, 10.0]), 1e-9 * np.diag([20.0, 30.0])])
    modes = fitted(TWO, residue=residues(TWO), remainder=remainder, powers=(-2, 0), band=(100.0, 2400.0))
    poles, frf = poles_of_modes(modes), lines_of(modes)
    far = frf.frequency > 300.0
    error = np.abs(poles.tip.receptance(frf.frequency[far]) - frf.values[far]).max(axis=(1, 2))
    line = 30.0 / (2 * np.pi * frf.frequency[far]) ** 2
    assert np.all(error < 0.1 * 300.0 / frf.frequency[far] * line)
    assert "modes-below" in {notice.code for notice in poles.notices}
    np.testing.assert_array_equal(poles.tip.flexibility, remainder[1])


def test_an_inertia_line_where_the_fit_is_noise_makes_no_chatter_of_its_own():
    """Taken down to 5 Hz the line is a soft tip, that chatters at some 10 Hz before any mode does."""
    remainder = np.diag([3.0, 3.0])[np.newaxis]
    noisy = fitted(TWO, residue=residues(TWO), remainder=remainder, powers=(-2,), band=(5.0, 2400.0), noise=1e-2)
    slow = {**BOTH, "radial_depth": 6e-3, "spindle_speed": (2000 * RPM, 3000 * RPM), "method": "floquet", "points": 11}
    found = map_stability(noisy, (KTC, KRC), **slow)
    assert found.chatter_frequency.min() > 700.0
    bare = map_stability(TWO, (KTC, KRC), **slow)
    np.testing.assert_allclose(found.limit_depth, bare.limit_depth, rtol=0.05)


def test_an_inertia_line_that_is_nothing_at_the_resonances_is_left_out():
    remainder = np.diag([0.02, 0.01])[np.newaxis]
    poles = poles_of_modes(fitted(TWO, residue=residues(TWO), remainder=remainder, powers=(-2,)))
    assert len(poles.tip.pole) == 2
    assert not poles.notices


def test_the_same_seed_gives_the_same_probabilities_and_progress_ends_at_one():
    shares = []
    maps = [
        map_stability(
            ONE, coefficients(), **CUT, method="floquet", points=8, probability=5, rng=np.random.default_rng(3),
            progress=lambda share, _: shares.append(share),
        )
        for _ in range(2)
    ]  # fmt: skip
    np.testing.assert_array_equal(maps[0].probability, maps[1].probability)
    half = shares[: len(shares) // 2]
    assert half == sorted(half)
    assert half[-1] == 1.0


@pytest.mark.parametrize("method", ["zoa", "floquet"])
def test_a_depth_asked_too_shallow_never_makes_a_deep_operating_point_stable(method):
    """At 12 000 rpm chatter begins at 0.94 mm: 8 mm are no stable cut, however little deep one asked to look."""
    point = (12_000 * RPM, 8e-3)
    found = map_stability(ONE, (KTC, KRC), **CUT, method=method, points=20, deepest=0.5e-3, operating_point=point)
    assert not found.operating.stable
    assert 0.5e-3 < found.operating.limit < 2e-3
    assert "deepest" in codes(found)
    assert found.deepest >= 8e-3


def test_the_time_domain_says_that_it_has_no_band_and_has_none():
    found = map_stability(
        ONE, coefficients(), **{**CUT, "spindle_speed": (9000 * RPM, 10_000 * RPM)}, method="time-domain", points=2,
        deepest=4e-3, rng=np.random.default_rng(0),
    )  # fmt: skip
    assert "no-band" in codes(found)
    assert found.limit_low is None
    assert found.probability is None


def test_where_no_limit_was_found_none_is_spoken_of():
    point = (13_700 * RPM, 0.5e-3)
    found = map_stability(ONE, (KTC, KRC), **CUT, method="floquet", points=20, deepest=1e-3, operating_point=point)
    assert np.isinf(found.operating.limit)
    assert any("no limit was found down to 1 mm" in line for line in found.operating.advice)
    assert not any("90% of the limit at this speed" in line for line in found.operating.advice)
