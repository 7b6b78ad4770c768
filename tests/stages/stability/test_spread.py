"""Bands and probabilities: carried between speeds, past the deepest depth, and by few draws."""

import numpy as np
import pytest

from millcal.physics.stability.regeneration import Regeneration
from millcal.stages.stability import map_stability
from millcal.stages.stability.from_frf import NINETY_FIVE, crossings_of_frf, crossings_of_lines
from millcal.stages.stability.lines import usable_lines
from millcal.stages.stability.spread import Spread, band_speeds
from tests.stages.stability.test_from_frf import measured
from tests.stages.stability.test_methods import BOTH, CUT, KRC, KTC, ONE, RPM, TWO, codes, coefficients
from tests.stages.stability.test_modes import fitted, residues


def two_modes():
    """A fit that leaves frequencies, damping and residues a little open."""
    residue, share = residues(TWO), np.random.default_rng(3).standard_normal((4, 2))
    deviations = (share * 0.2, share * 1e-4, 0.003 * residue * share[:, :, None, None])
    return fitted(TWO, residue=residue, deviations=deviations, dof=np.inf, dofs=("tipX", "tipY"))


def test_the_band_at_a_speed_does_not_hang_on_how_many_speeds_the_map_has():
    """Few enough that all are solved, against a map where the band is carried from speed to speed."""
    some = {**BOTH, "method": "floquet", "deepest": 4e-3, "spindle_speed": (8000 * RPM, 10_000 * RPM)}
    coarse, fine = (
        map_stability(two_modes(), (KTC, KRC), **some, points=points, members=60, rng=np.random.default_rng(0))
        for points in (9, 201)
    )
    within = np.isfinite(coarse.limit_high)
    assert within.sum() > 4
    for one, other in ((coarse.limit_low, fine.limit_low[::25]), (coarse.limit_high, fine.limit_high[::25])):
        width = (coarse.limit_high - coarse.limit_low)[within]
        np.testing.assert_array_less(np.abs(other - one)[within], 0.15 * width)
    known = np.isfinite(fine.limit_depth)
    assert np.mean((fine.limit_low <= fine.limit_depth)[known] & (fine.limit_depth <= fine.limit_high)[known]) > 0.98


def test_a_draw_is_carried_as_a_share_of_the_limit_of_each_speed():
    """One that is a tenth deeper everywhere is so between its speeds, however the limit runs there."""
    speed = np.linspace(1.0, 2.0, 41)
    limit = 1e-3 * (2 + np.cos(9 * speed))[:, np.newaxis]
    share = np.array([0.9, 1.0, 1.1])
    at = np.arange(0, 41, 10)
    edges = share[:, np.newaxis, np.newaxis] * limit[at]
    spread = Spread(speed[at], edges, speed, limit)
    np.testing.assert_allclose(spread.edges_at(speed), share[:, np.newaxis, np.newaxis] * limit, rtol=1e-12)
    np.testing.assert_allclose(spread.band(speed), np.array([0.9, 1.1])[:, np.newaxis] * limit[:, 0], rtol=1e-12)


def test_islands_stay_in_the_order_of_their_edges_where_draws_differ_in_them():
    speed = np.linspace(1.0, 2.0, 11)
    limit = np.stack([1e-3 * speed, 1.5e-3 * speed, 2e-3 * speed], axis=1)
    edges = np.full((2, 2, 3), np.inf)
    edges[0] = 1.1 * limit[[0, 10]]
    edges[1, 0], edges[1, 1, 0] = 0.9 * limit[0], 0.9 * limit[10, 2]  # without the island at the other end
    found = Spread(speed[[0, 10]], edges, speed, limit).edges_at(speed)
    np.testing.assert_allclose(found[0], 1.1 * limit, rtol=1e-12)
    with np.errstate(invalid="ignore"):
        assert not np.any(np.diff(found, axis=2) < 0)
    np.testing.assert_allclose(found[:, [0, 10]], edges, rtol=1e-12)


def test_the_speeds_of_the_band_stand_on_both_sides_of_jumps_and_where_the_limit_falls():
    speeds = np.linspace(0.0, 1.0, 1001)
    depth = np.where(speeds < 0.5, 1.0, 3.0) * np.where(speeds > 0.8, np.exp(-5 * (speeds - 0.8)), 1.0)
    own = np.array([0.12345])
    chosen = band_speeds(speeds, depth, own, 40)
    assert len(chosen) <= 41
    assert own[0] in chosen
    jump = np.searchsorted(speeds, 0.5)
    assert {speeds[jump - 1], speeds[jump]} <= set(chosen)
    falling = np.count_nonzero(chosen > 0.8)
    assert falling > 1.5 * np.count_nonzero(chosen < 0.2)
    np.testing.assert_array_equal(band_speeds(speeds[:30], depth[:30], own, 40), np.unique([*speeds[:30], *own]))


@pytest.mark.parametrize("method", ["frf", "floquet", "zoa"])
def test_a_probability_does_not_hang_on_how_deep_the_map_looks(method):
    """Just below its limit a cut is stable with one half, though the map ends there and shows none."""
    if method == "frf":
        dynamics, known = measured(noise=0.02, rng=np.random.default_rng(2)), (KTC, KRC)
    else:
        dynamics, known = two_modes(), coefficients()
    some = {**BOTH, "spindle_speed": (7400 * RPM, 7600 * RPM), "points": 3, "method": method, "members": 400}
    limit = map_stability(dynamics, known, **some, deepest=4e-3).limit_depth[1]
    deep, shallow = (
        map_stability(
            dynamics, known, **some, deepest=deepest, operating_point=(7500 * RPM, 0.99 * limit),
            rng=np.random.default_rng(0),
        )
        for deepest in (4e-3, 0.995 * limit)
    )  # fmt: skip
    assert np.isinf(shallow.operating.limit)
    assert 0.2 < deep.operating.p_stable < 0.9
    assert shallow.operating.p_stable == pytest.approx(deep.operating.p_stable, abs=0.03)
    assert shallow.limit_low[1] == pytest.approx(deep.limit_low[1], rel=0.01)
    assert np.isinf(shallow.limit_high[1])
    assert np.all(shallow.crossing_depth <= shallow.deepest)


def test_an_end_of_the_band_is_never_mixed_of_a_limit_and_none():
    """Of draws half of which have no limit at all the lower end is a limit that some have."""
    edges = np.full((40, 1, 1), np.inf)
    edges[:2, 0, 0] = [3e-3, 3.1e-3]
    at = np.array([1.0])
    low, high = Spread(at, edges, at, edges[0]).band(at)[:, 0]
    assert 3e-3 <= low <= 3.1e-3
    assert np.isinf(high)
    edges[1, 0, 0] = np.inf
    assert Spread(at, edges, at, edges[0]).band(at)[0, 0] == pytest.approx(3e-3)


@pytest.mark.parametrize("many", [39, 60, 200])
def test_ends_of_few_draws_hold_nineteen_of_twenty(many):
    rng, at = np.random.default_rng(0), np.array([1.0])
    held = []
    for _ in range(2000):
        edges = 1 / (10 + rng.standard_normal((many, 1, 1)))
        low, high = Spread(at, edges, at, edges[0]).band(at)[:, 0]
        truth = 1 / (10 + rng.standard_normal())
        held.append(low <= truth <= high)
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)


def test_how_many_draws_there_are_is_told_where_they_are_fewer_than_asked_or_too_few():
    some = {**BOTH, "points": 2, "method": "floquet", "deepest": 3e-3}

    def told(members, modes, **other):
        found = map_stability(
            modes, coefficients(), **{**some, **other}, members=members, probability=5, rng=np.random.default_rng(0)
        )
        return found, {n.code: n.message for n in found.notices if n.code in ("draws", "few-draws", "no-probability")}

    found, words = told(5000, two_modes())
    assert found.draws == 200
    assert "200 draws instead of 5000" in words["draws"]
    found, words = told(300, TWO)
    assert found.draws == 300
    assert not words
    found, words = told(20, TWO)
    assert "90%" in words["few-draws"]
    found, words = told(1, TWO)
    assert found.draws is None
    assert "one draw makes no band" in words["draws"]
    assert "nothing was drawn" in words["no-probability"]


def test_the_time_domain_says_that_it_follows_nothing_uncertain():
    found = map_stability(
        ONE, coefficients(), **{**CUT, "spindle_speed": (9000 * RPM, 10_000 * RPM)}, method="time-domain", points=2,
        deepest=4e-3, probability=True, rng=np.random.default_rng(0),
    )  # fmt: skip
    (why,) = (notice.message for notice in found.notices if notice.code == "no-probability")
    assert "time-domain does not follow what is uncertain" in why
    assert found.draws is None
    assert "no-band" in codes(found)


def test_noise_that_leaves_the_upper_end_open_counts_in_full():
    """sd of 1/b from a band whose upper end is none is that of the lower end, not half of it."""
    cut = Regeneration(2, np.pi - np.arccos(1 - 2 * 0.1), np.pi, 600e6, 200e6)
    speeds = np.array([7500.0]) * RPM
    frf = measured(noise=0.01, rng=np.random.default_rng(2))
    lines = usable_lines(frf, "")[0]
    loud = lines._replace(variance=lines.variance * 70.0**2)
    (found, usual), (_, ends) = (crossings_of_lines(one, speeds, cut, deepest=4e-3) for one in (lines, loud))
    assert ends[1, 0] < 0
    sd, alone = ((one[0] - one[1]) / (2 * NINETY_FIVE) for one in (ends, usual))
    assert sd == pytest.approx(70 * alone, rel=0.2)
    assert ends[0] - 1 / found.first(1).depth == pytest.approx(NINETY_FIVE * sd, rel=0.2)
    _, low, high, _ = crossings_of_frf(frf, speeds, cut, deepest=4e-3)
    np.testing.assert_allclose([1 / low, 1 / high], usual)
