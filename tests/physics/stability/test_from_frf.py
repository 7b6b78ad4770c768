"""Crossings from lines of a receptance: against converged numbers, Floquet, and the multi-frequency form written out."""

import numpy as np
import pytest
from stability_cases import RPM, TYPES, case_cut, cut, machine, oracles

from millcal.errors import IllPosedError
from millcal.numerics.circle_sweep import circle_crossings
from millcal.physics.stability.floquet import all_crossings
from millcal.physics.stability.frf_spread import inverse_depth_sd
from millcal.physics.stability.from_frf import crossings_at, crossings_of_receptance, measured_cut
from millcal.physics.stability.measured_receptance import receptance_of_lines, resonances
from millcal.physics.stability.regeneration import FLIP, HOPF, TipModes, h0, tip_of_shapes
from millcal.physics.stability.stable_depths import edges_of

LOW_IMMERSION = [case for case in oracles()["cases"] if case["a_over_D"] <= 0.1]


def lines(tip, *, band=5.0, spacing=1.0, start=None):
    """Lines up to `band` times the highest mode."""
    frequency = np.arange(start or spacing, band * np.abs(tip.pole).max() / (2 * np.pi), spacing)
    return frequency, tip.receptance(frequency)


def solved(rpm, tip, this, *, deepest, **options):
    return crossings_of_receptance(np.atleast_1d(rpm) * RPM, *lines(tip, **options), this, deepest=deepest)


def errors_against_oracles(band, cases):
    """Relative errors of every edge of the stable set; kinds and numbers must agree."""
    found = []
    for case in cases:
        tip, deepest = machine(case["modes"]), max(row["amax_m"] for row in case["crossings"])
        rows = [row for row in case["crossings"] if row["amax_m"] == deepest]
        rpm = np.array([row["rpm"] for row in rows])
        edges = edges_of(solved(rpm, tip, case_cut(case), deepest=1.02 * deepest, band=band), complete=True)
        for i, row in enumerate(rows):
            own = (edges.speed == i) & (edges.depth < deepest)
            assert edges.kind[own].tolist() == [TYPES[known["type"]] for known in row["list"]]
            known = np.array([known["ap_m"] for known in row["list"]])
            found.append(np.abs(edges.depth[own] / known - 1))
    return np.concatenate(found)


@pytest.mark.parametrize(("band", "median", "worst"), [(5.0, 1e-4, 5e-3), (3.0, 5e-4, 2e-2)])
def test_a_band_of_some_times_the_highest_mode_gives_every_flip_and_the_depths_of_the_oracles(band, median, worst):
    """A quarter of the cases stands for all; the others are among the long tests."""
    error = errors_against_oracles(band, LOW_IMMERSION[::4])
    assert np.median(error) < median
    assert error.max() < worst


@pytest.mark.long
@pytest.mark.parametrize(("band", "median", "worst"), [(5.0, 1e-4, 5e-3), (3.0, 5e-4, 2e-2)])
def test_every_immersion_and_number_of_teeth_agrees_with_the_oracles(band, median, worst):
    error = errors_against_oracles(band, oracles()["cases"])
    assert np.median(error) < median
    assert error.max() < worst


@pytest.mark.parametrize(
    ("name", "teeth", "immersion", "direction"),
    [
        ("IS1", 2, 0.05, "up"),
        ("IS1", 3, 0.5, "down"),
        ("ROT2", 2, 0.1, "down"),
        ("ROT2", 3, 0.6, "up"),
        ("UBC22", 2, 0.1, "down"),
    ],
)
def test_all_crossings_are_those_of_floquet_cross_terms_and_overlapping_teeth_included(
    name, teeth, immersion, direction
):
    tip, this = machine(name), cut(teeth, immersion, direction, name)
    speed, deepest = np.array([6200.0, 8900.0, 13_700.0]) * RPM, 6e-3
    floquet = all_crossings(speed, tip, this, deepest=deepest, order=60)
    found = crossings_of_receptance(speed, *lines(tip, band=8.0), this, deepest=deepest)
    for i in range(len(speed)):
        own, other = found.speed == i, floquet.speed == i
        assert found.kind[own].tolist() == floquet.kind[other].tolist()
        assert found.loses[own].tolist() == floquet.loses[other].tolist()
        np.testing.assert_allclose(found.depth[own], floquet.depth[other], rtol=5e-4)
        np.testing.assert_allclose(found.frequency[own], floquet.frequency[other], rtol=1e-3)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_resonance_narrower_than_a_step_of_the_sweep_is_not_passed_over(direction):
    """One tooth that passes as often as the tool swings: all that its mode does is done within some hundredths of a rad."""
    tip, this = tip_of_shapes([922.0], [0.004], machine("IS1").output[:1].real), cut(1, 0.1, direction, "IS1")
    speed, deepest = np.linspace(53_000, 58_000, 12) * RPM, 8e-3
    floquet = all_crossings(speed, tip, this, deepest=deepest)
    found = crossings_of_receptance(speed, *lines(tip), this, deepest=deepest)
    assert len(floquet.depth) >= 4
    assert found.speed.tolist() == floquet.speed.tolist()
    assert found.kind.tolist() == floquet.kind.tolist()
    np.testing.assert_allclose(found.depth, floquet.depth, rtol=1e-2)


def test_resonances_are_the_peaks_that_stand_out_by_half_their_height_and_not_those_of_noise():
    tip = tip_of_shapes([500.0, 530.0, 1400.0], [0.01, 0.02, 0.03], [[0.5, 0.0], [0.0, 0.4], [0.3, 0.6]])
    frequency, values = lines(tip)
    size = np.abs(values.imag).max()
    values = values + 0.005 * size * np.random.default_rng(3).standard_normal(values.shape) * (1 + 1j)
    found = resonances(frequency, values, 0.05 * size)
    known = {500.0: 0.01, 530.0: 0.02, 1400.0: 0.03}
    nearest = [min(known, key=lambda natural: abs(natural - peak)) for peak in found[:, 1]]
    assert set(nearest) == set(known)
    for natural, (low, peak, high) in zip(nearest, found, strict=True):
        assert peak == pytest.approx(natural, rel=known[natural])
        assert (high - low) / (2 * natural) == pytest.approx(known[natural], rel=0.4)


def written_out(rpm, tip, this, harmonics, **options):
    """The multi-frequency matrix of Budak, Altintas and Merdol on lines: blocks H_(k-l) (1 - e^(-j theta)) G(v_l), slow and plain.

    At last it is written for as many instants of the period, by which the eigenvalues stay and conjugate pairs become real.
    """
    receptance = receptance_of_lines(*lines(tip, **options))
    period, many = 2 * np.pi / (this.teeth * rpm * RPM), len(harmonics)
    end = (this.leave - this.entry) * this.teeth / (2 * np.pi)
    x, weight = np.polynomial.legendre.leggauss(200)
    share = end * (x + 1) / 2
    force = h0(this.entry + share * 2 * np.pi / this.teeth, this.ktc, this.krc) * (weight * end / 2)[:, None, None]
    blocks = np.einsum("ns,sij->nij", np.exp(-2j * np.pi * np.arange(1 - many, many)[:, None] * share), force)
    full = blocks[harmonics[:, None] - harmonics + many - 1]  # (k, l, 2, 2)

    def matrix(angle):
        turn = angle[:, None] / (2 * np.pi) + harmonics
        product = np.einsum("klab,tlbc->tkalc", full, receptance.at(turn / period))
        instants = np.exp(2j * np.pi * np.arange(many)[:, None] / many * turn[:, None])  # (t, instant, k)
        product = np.einsum("tmk,tkalc,tnl->tmanc", instants, product, instants.conj() / many, optimize=True)
        return product.reshape(len(angle), 2 * many, 2 * many) * (1 - np.exp(-1j * angle))[:, None, None]

    return matrix


def test_the_basis_of_the_cut_has_the_eigenvalues_of_the_multi_frequency_form_written_out():
    tip, this, rpm, deepest = machine("ROT2"), cut(2, 0.1, "down"), 9500.0, 14e-3
    found = solved(rpm, tip, this, deepest=deepest, band=2.0)
    slow = circle_crossings(written_out(rpm, tip, this, np.arange(-16, 16), band=2.0), deepest)
    assert len(found.depth) >= 2
    np.testing.assert_allclose(found.depth, slow.factor, rtol=3e-5)
    assert found.loses.tolist() == slow.rising.tolist()


def test_an_odd_set_of_harmonics_loses_the_flip_that_is_the_limit():
    """1-DOF, a/D = 0.1, down, 7500 rpm: 1.921 mm by a flip. The even number of harmonics is no matter of taste."""
    tip, this, deepest = machine("IS1"), cut(2, 0.1, "down"), 3e-3
    even, odd = (circle_crossings(written_out(7500.0, tip, this, np.arange(low, 12)), deepest) for low in (-12, -11))
    assert even.angle[0] == np.pi
    assert even.factor[0] == pytest.approx(1.92132e-3, rel=1e-2)
    assert not np.any(odd.angle == np.pi)
    assert odd.factor[0] > 1.2 * even.factor[0]


def test_a_tip_turned_with_its_cut_has_the_same_depths():
    """Only the angle between both counts, so the tip that up milling meets can be turned to where down milling cuts."""
    frequency, values = lines(machine("ROT2"), spacing=2.0)
    up, down = cut(2, 0.1, "up"), cut(2, 0.1, "down")
    c, s = np.cos(down.entry - up.entry), np.sin(down.entry - up.entry)
    turn = np.array([[c, s], [-s, c]])  # clockwise
    speed = np.array([5000.0, 9000.0]) * RPM
    one = crossings_of_receptance(speed, frequency, values, up, deepest=5e-3)
    other = crossings_of_receptance(speed, frequency, turn @ values @ turn.T, down, deepest=5e-3)
    assert one.kind.tolist() == other.kind.tolist()
    np.testing.assert_allclose(one.depth, other.depth, rtol=1e-8)


def test_between_lines_a_cubic_keeps_the_depths_while_the_half_power_width_holds_five_lines():
    """922 Hz at 1.1 %: 20 Hz wide."""
    tip, this, rpm = machine("IS1"), cut(2, 0.1, "down"), np.array([5000.0, 7500.0, 9000.0])
    fine, coarse = (solved(rpm, tip, this, deepest=3e-3, spacing=spacing) for spacing in (0.5, 4.0))
    np.testing.assert_allclose(coarse.depth, fine.depth, rtol=5e-3)


def test_lines_that_begin_at_a_hundred_hertz_keep_the_depths():
    tip, this, rpm = machine("UBC22"), cut(2, 0.1, "down", "UBC22"), np.array([4000.0, 8000.0])
    whole, late = (solved(rpm, tip, this, deepest=6e-3, start=start) for start in (1.0, 100.0))
    np.testing.assert_allclose(late.depth, whole.depth, rtol=2e-2)
    assert late.kind.tolist() == whole.kind.tolist()


def test_a_receptance_of_measured_lines_goes_on_as_its_mass_line_and_mirrors_at_zero():
    tip = machine("ROT2")
    receptance = receptance_of_lines(*lines(tip, band=4.0))
    at = np.array([1500.0, 5000.0, 7000.0])
    np.testing.assert_array_equal(receptance.at(-at), receptance.at(at).conj())
    known = tip.receptance(at)
    assert np.abs(receptance.at(at) - known).max(axis=(1, 2)) == pytest.approx(0, abs=0.05 * np.abs(known[1]).max())
    assert not receptance.at(np.array([1.01 * receptance.reach])).any()


def test_above_lines_that_a_mode_beyond_them_rules_nothing_is_made_up():
    tip = machine("IS1")
    stiff = TipModes(tip.pole, tip.output, tip.given, np.eye(2) * 1e-6)  # whatever lies above answers at once
    receptance = receptance_of_lines(*lines(stiff))
    assert not receptance.mass_line.any()
    assert not receptance.at(np.array([1.001 * receptance.frequency[-1]])).any()


@pytest.mark.parametrize("kind", [FLIP, HOPF])
def test_the_spread_of_a_crossing_is_that_of_lines_with_noise(kind):
    """120 draws with 1 % on each line: the standard deviation within 20 %, 95 % of them within the band."""
    rng = np.random.default_rng(5)
    tip, this, deepest = machine("IS1"), cut(2, 0.1, "down"), 4e-3
    speed = (7500.0 if kind == FLIP else 9000.0) * RPM
    frequency, values = lines(tip, spacing=4.0)
    variance = (0.01 * np.abs(values)) ** 2
    problem = measured_cut(frequency, values, this, deepest=deepest)
    ((_, basis),) = problem.bases(np.array([speed]))
    found, angle = crossings_at(problem, speed, basis, 0)
    assert found.kind[0] == kind
    sd = inverse_depth_sd(problem, speed, basis, float(angle[0]), float(found.depth[0]), variance)
    inverse = []
    for _ in range(120):
        noise = rng.standard_normal((2, *values.shape)) * np.sqrt(variance / 2)
        noisy = measured_cut(frequency, values + noise[0] + 1j * noise[1], this, deepest=deepest)
        inverse.append(1 / crossings_at(noisy, speed, basis, 0)[0].depth[0])
    moved = np.array(inverse) - 1 / found.depth[0]
    assert np.std(moved) == pytest.approx(sd, rel=0.2)
    assert abs(np.mean(moved)) < 0.3 * sd
    assert 0.88 <= np.mean(np.abs(moved) < 1.96 * sd) <= 1.0


def test_helix_unequal_pitch_and_process_damping_are_refused_and_so_is_a_cut_through_too_many_waves():
    tip = machine("IS1")
    for more in ({"wind": 50.0}, {"pitch": (3.0, 2 * np.pi - 3.0)}, {"indentation": 1e5, "radius": 0.01}):
        with pytest.raises(ValueError, match="equal pitch"):
            solved(5000.0, tip, cut(2, 0.1, "down", **more), deepest=3e-3)
    with pytest.raises(IllPosedError, match="zoa"):
        solved(100.0, tip, cut(2, 0.5, "down"), deepest=3e-3)
