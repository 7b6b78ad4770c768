"""The zero-order limit: published tables, closed forms, and the classical lobes as the slow way."""

import numpy as np
import pytest

from millcal.physics.stability.floquet import spectral_radius
from millcal.physics.stability.regeneration import Regeneration, tip_of_modes, tip_of_residues, tip_of_shapes
from millcal.physics.stability.zero_order import (
    absolute_minimum,
    directional_factors,
    directional_integrals,
    dynamics_of_lines,
    dynamics_of_modes,
    dynamics_of_tip,
    limit,
    limit_along,
    limit_of_one_mode,
    mean_cutting_matrix,
    minimum_of_one_mode,
    oriented,
)
from millcal.physics.stability.zero_order_draws import limits_of_draws, limits_of_one_mode
from millcal.physics.structure import Mode, modal_receptance, receptance

RPM = 2 * np.pi / 60
WECK = (Mode(603, 0.039, 5.59e6, "x"), Mode(666, 0.035, 5.715e6, "y"))
TWO_BY_TWO = (
    Mode(456.780432115313, 0.111705399393456, 7933097.18086825, "x"),
    Mode(1448.88914030656, 0.0170370095790783, 14691778.4389479, "x"),
    Mode(516.51818914797, 0.0245796327070992, 9374613.81193087, "y"),
    Mode(1408.44814086966, 0.0313576019295683, 12406389.7145168, "y"),
)
ISOTROPIC = (Mode(500, 0.02, 8e6, "x"), Mode(500, 0.02, 8e6, "y"))
INSPERGER = Mode(922.0, 0.011, 0.03993 * (2 * np.pi * 922.0) ** 2, "x")


def engaged(immersion, direction):
    """Entry and exit angle at a radial depth of that share of the diameter."""
    swept = np.arccos(1 - 2 * immersion)
    return (0.0, swept) if direction == "up" else (np.pi - swept, np.pi)


def cutting(ktc, krc, teeth, immersion, direction):
    entry, leave = engaged(immersion, direction)
    return mean_cutting_matrix(ktc, krc, teeth=teeth, entry=entry, leave=leave)


def limit_mm(modes, matrix, teeth, rpm):
    speeds = np.asarray(rpm, float) * RPM
    return limit(speeds, dynamics_of_modes(modes, speeds, teeth), matrix, teeth).depth * 1e3


def printed(text):
    """A number as printed, with half a unit of its last digit (and a little, for rounding of halves) as tolerance."""
    decimals = len(text.split(".")[1])
    return pytest.approx(float(text), abs=0.51 * 10.0**-decimals)


E5 = [  # modes, Ktc, Krc N/mm2, teeth, direction, alpha, minimum mm, at Hz, {rpm: limit mm}
    (WECK, 600, 42, 3, "up", "-1.10996 -1.6408 1.5008 .89004", "1.08683", "632.98",
     "6000 1.9457, 8000 1.0954, 10000 1.3396, 12000 4.0335, 14000 2.7915"),
    (WECK, 600, 42, 3, "down", ".89004 -1.5008 1.6408 -1.10996", "3.51941", "606.46",
     "6000 4.8958, 8000 3.6608, 10000 4.23, 12000 9.0542, 14000 6.6064"),
    (WECK, 600, 42, 4, "up", "-1.10996 -1.6408 1.5008 .89004", ".81512", "632.98",
     "6000 .8215, 8000 1.2869, 10000 3.0275, 12000 1.1785, 14000 .8968"),
    (WECK, 600, 42, 4, "down", ".89004 -1.5008 1.6408 -1.10996", "2.63956", "606.46", ""),
    (TWO_BY_TWO, 1319.4, 788.8, 2, "down", ".0609 -.97295 2.16864 -1.9391", ".9571", "1440.27",
     "4000 1.0858, 6000 1.6154, 8000 1.1395, 10000 1.457, 14000 4.6197"),
    (TWO_BY_TWO, 1319.4, 788.8, 2, "up", "", "1.81558", "510.6",
     "4000 2.2347, 6000 1.8179, 8000 2.1599, 10000 1.816, 14000 4.7619"),
    (ISOTROPIC, 695.388, 280.955, 4, "up", "", ".59344", "502.49", ""),
    (ISOTROPIC, 695.388, 280.955, 4, "down", "", ".59344", "502.49", ""),
]  # fmt: skip


@pytest.mark.parametrize(("modes", "ktc", "krc", "teeth", "direction", "alpha", "lowest", "at", "rows"), E5)
def test_published_half_immersion_tables_come_out_to_every_digit(
    modes, ktc, krc, teeth, direction, alpha, lowest, at, rows
):
    """Directional factors, absolute minimum with its chatter frequency, and limits at round speeds."""
    factors = directional_factors(*engaged(0.5, direction), krc / ktc).ravel()
    for found, text in zip(factors, alpha.split(), strict=False):
        assert found == printed(text)
    matrix = cutting(ktc * 1e6, krc * 1e6, teeth, 0.5, direction)
    speeds = np.array([4000.0, 14000.0]) * RPM
    depth, frequency = absolute_minimum(oriented(dynamics_of_modes(modes, speeds, teeth), matrix))
    assert depth * 1e3 == printed(lowest)
    assert frequency == printed(at)
    for row in filter(None, rows.split(", ")):
        rpm, text = row.split()
        assert limit_mm(modes, matrix, teeth, [float(rpm)])[0] == printed(text), rpm


def test_the_published_minimum_of_an_isotropic_slot_comes_out():
    matrix = cutting(695.388e6, 280.955e6, 4, 1.0, "up")
    depth, frequency = absolute_minimum(oriented(dynamics_of_modes(ISOTROPIC, np.array([500.0]), 4), matrix))
    assert depth * 1e3 == printed(".22223")
    assert frequency == printed("501.84")


@pytest.mark.parametrize(
    ("immersion", "lowest", "at"), [(0.05, "1.31137", "932.09"), (0.5, ".12674", "924.12"), (1.0, ".04793", "923.59")]
)
def test_the_minima_of_the_two_degree_benchmark_come_out(immersion, lowest, at):
    modes = [INSPERGER, Mode(INSPERGER.natural_frequency, INSPERGER.damping_ratio, INSPERGER.stiffness, "y")]
    matrix = cutting(6e8, 2e8, 2, immersion, "down")
    depth, frequency = absolute_minimum(oriented(dynamics_of_modes(modes, np.array([1000.0]), 2), matrix))
    assert depth * 1e3 == printed(lowest)
    assert frequency == printed(at)


@pytest.mark.parametrize(
    ("immersion", "row"),
    [
        (1.0, "0.3699 0.3250 1.1138 0.3001 0.5694 2.1295 0.3069"),
        (0.1, "1.4375 1.9892 5.2626 2.9649 1.3547 2.4950 4.7066"),
        (
            0.05,
            "2.5769 3.5657 9.4336 5.3148 2.4284 4.4725 8.4369",
        ),  # a reference prints 2.4285: 2.428446, rounded twice
    ],
)
def test_the_one_degree_benchmark_of_insperger_and_stepan_comes_out(immersion, row):
    speeds = np.array([5000, 6000, 7000, 7500, 8000, 9000, 10000]) * RPM
    found = limit_of_one_mode(speeds, INSPERGER, cutting(6e8, 2e8, 2, immersion, "down"), 2).depth * 1e3
    for depth, text in zip(found, row.split(), strict=True):
        assert depth == printed(text)


# One tooth, D 15.88 mm, radial depth 5 mm, down, the flexure compliant along x; k, m, c as measured.
STIFFNESS, MASS, DAMPING = 1.64e6, 2.51, 114.0
FLEXURE = Mode(np.sqrt(STIFFNESS / MASS) / (2 * np.pi), DAMPING / (2 * np.sqrt(STIFFNESS * MASS)), STIFFNESS, "x")
FLEXURE_LIMITS = """2500 8.42140, 3000 5.01723, 3500 3.98550, 3679 7.09296, 3750 11.55404, 3873 14.46424, 3920 14.07845,
4000 13.41802, 4117 12.44667, 4222 11.57395, 4252 11.32522, 4400 10.10917, 4500 9.30564, 4567 8.78004, 4750 7.42121,
5000 5.83456, 5233 4.73017, 5500 3.92597, 6000 3.44309, 6500 4.00077, 7000 6.34268, 7250 9.71241, 7500 21.11635"""


def test_the_flexure_of_cornelius_has_its_geometry_its_minimum_and_its_limit_at_every_speed():
    immersion, ktc, knc = 5 / 15.88, 903.9e6, 534.5e6
    entry, leave = engaged(immersion, "down")
    assert np.degrees(entry) == printed("111.73271")
    by_tangential, by_radial = directional_integrals(entry, leave)[:, 0, 0]
    assert by_tangential == printed("-0.4314474")
    assert by_radial == printed("0.4237654")
    matrix = cutting(ktc, knc, 1, immersion, "down")
    assert matrix[0, 0] * 2 * np.pi / 1e6 == printed("-163.48275")
    depth, _ = minimum_of_one_mode(FLEXURE, matrix)
    zeta = FLEXURE.damping_ratio
    assert depth == pytest.approx(2 * STIFFNESS * zeta * (1 - zeta) / abs(matrix[0, 0]), rel=1e-13)
    assert depth * 1e3 == printed("3.44209")
    rows = [row.split() for row in FLEXURE_LIMITS.replace("\n", " ").split(",")]
    speeds = np.array([float(rpm) for rpm, _ in rows]) * RPM
    for found, (rpm, text) in zip(limit_of_one_mode(speeds, FLEXURE, matrix, 1).depth, rows, strict=True):
        assert found * 1e3 == printed(text), rpm


def test_one_tooth_that_always_cuts_is_turning_with_the_closed_form_of_its_minimum():
    """2 k zeta (1 + zeta) / K at f_n sqrt(1 + 2 zeta): 5.489088 mm at 1.0119289 f_n."""
    mode = Mode(100.0, 0.012, 2.26e8, "x")
    depth, frequency = minimum_of_one_mode(mode, np.array([[1e9, 0.0], [0.0, 0.0]]))
    assert depth * 1e3 == printed("5.489088")
    assert frequency / 100 == printed("1.0119289")


def random_case(seed):
    rng = np.random.default_rng(seed)
    modes = [
        Mode(rng.uniform(200, 2500), rng.uniform(0.005, 0.08), rng.uniform(2e6, 3e7), str(rng.choice(["x", "y"])))
        for _ in range(rng.integers(1, 5))
    ]
    teeth, direction = int(rng.integers(1, 7)), str(rng.choice(["up", "down"]))
    matrix = cutting(7e8, rng.uniform(0.05, 0.7) * 7e8, teeth, rng.uniform(0.02, 1), direction)
    return modes, teeth, matrix, rng.uniform(500, 20_000, 12)


def lower_envelope_mm(modes, matrix, teeth, rpm, frequency):
    """The classical way: every lobe of both eigenvalues as a curve over the speed, then the lowest curve at each speed."""
    eigenvalues = np.linalg.eigvals(receptance(frequency, modes, axes=("x", "y")) @ matrix)
    lowest = np.full(len(rpm), np.inf)
    for m in eigenvalues.T:
        positive = m.real < 0
        depth = np.full(len(m), np.inf)
        depth[positive] = -1 / (2 * m.real[positive]) * 1e3
        phase = np.maximum(2 * np.arctan2(-m.real, m.imag), 1e-9)  # w tau, up to whole turns
        for waves in range(400):
            speed = 60 * 2 * np.pi * frequency / (teeth * (phase + 2 * np.pi * waves))
            if speed[positive].max(initial=0.0) < rpm.min():
                break
            left, right = np.minimum(speed[:-1], speed[1:]), np.maximum(speed[:-1], speed[1:])
            whole = positive[:-1] & positive[1:] & (right < 1.05 * left)
            for i, n in enumerate(rpm):
                at = np.flatnonzero(whole & (left <= n) & (n < right))
                share = (n - speed[at]) / (speed[at + 1] - speed[at])
                lowest[i] = min(lowest[i], np.min(depth[at] + share * (depth[at + 1] - depth[at]), initial=np.inf))
    return lowest


@pytest.mark.parametrize("seed", range(6))
def test_solving_at_the_speed_is_the_lower_envelope_of_the_classical_lobes(seed):
    modes, teeth, matrix, rpm = random_case(seed)
    rpm = rpm[:5]
    slow = lower_envelope_mm(modes, matrix, teeth, rpm, np.arange(0.1, 8000, 0.1))
    np.testing.assert_allclose(limit_mm(modes, matrix, teeth, rpm), slow, rtol=2e-3)


@pytest.mark.parametrize("seed", range(20))
def test_at_the_limit_the_characteristic_equation_holds_and_the_lobe_counts_whole_waves(seed):
    """det(I + b (1 - e^{-jw tau}) G Q) = 0, and Altintas' phase pi - 2 atan(kappa) is w tau less the whole waves."""
    modes, teeth, matrix, rpm = random_case(seed)
    speeds = rpm * RPM
    found = limit(speeds, dynamics_of_modes(modes, speeds, teeth), matrix, teeth)
    tau = 2 * np.pi / (teeth * speeds)
    loop = receptance(found.frequency, modes, axes=("x", "y")) @ matrix
    regeneration = found.depth * (1 - np.exp(-2j * np.pi * found.frequency * tau))
    determinant = np.linalg.det(np.eye(2) + regeneration[:, None, None] * loop)
    assert np.abs(determinant).max() < 1e-8
    inverse = -1 / regeneration  # the eigenvalue of G Q, and Altintas' Lambda is in proportion to minus its inverse
    kappa = (-1 / inverse).imag / (-1 / inverse).real
    turned = (np.pi - 2 * np.arctan(kappa)) / (2 * np.pi)
    np.testing.assert_allclose(found.frequency * tau, found.lobe + turned, atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_just_below_the_limit_no_frequency_and_no_lobe_closes_the_loop(seed):
    """Nyquist: the winding of det about 0 over all frequencies changes only at the limit, so it is 0 just below."""
    modes, teeth, matrix, rpm = random_case(seed)
    speeds = rpm[:3] * RPM
    depth = limit(speeds, dynamics_of_modes(modes, speeds, teeth), matrix, teeth).depth
    frequency = np.unique(np.concatenate([
        np.linspace(1e-3, 20_000, 400_000),
        *[m.natural_frequency * (1 + m.damping_ratio * np.linspace(-20, 20, 20_001)) for m in modes],
    ]))  # fmt: skip
    frequency = frequency[frequency > 0]
    g = receptance(frequency, modes, axes=("x", "y"))
    trace = np.einsum("nij,ji->n", g, matrix)
    determinant = g[:, 0, 0] * g[:, 1, 1] * np.linalg.det(matrix)
    for speed, limit_depth in zip(speeds, depth, strict=True):
        turn = 1 - np.exp(-2j * np.pi * frequency * 2 * np.pi / (teeth * speed))
        windings = []
        for b in limit_depth * np.array([0.999, 1.001]):
            loop = 1 + b * turn * trace + (b * turn) ** 2 * determinant
            windings.append(np.sum(np.angle(loop[1:] / loop[:-1])) / np.pi)
        assert abs(windings[0]) < 0.05
        assert abs(windings[1]) > 1.5


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("immersion", [0.05, 0.6, 1.0])
def test_with_one_mode_the_general_solution_is_the_closed_one_at_every_speed(axis, direction, immersion):
    mode = Mode(480.0, 0.025, 6e6, axis)
    matrix = cutting(8e8, 3e8, 3, immersion, direction)
    speeds = np.geomspace(20, 40_000, 300) * RPM
    closed = limit_of_one_mode(speeds, mode, matrix, 3)
    general = limit(speeds, dynamics_of_modes([mode], speeds, 3), matrix, 3)
    np.testing.assert_allclose(general.depth, closed.depth, rtol=1e-9)
    np.testing.assert_allclose(general.frequency, closed.frequency, rtol=1e-6)
    np.testing.assert_array_equal(general.lobe, closed.lobe)


@pytest.mark.parametrize("damping", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_heavily_damped_mode_has_limits_too(damping, direction):
    mode = Mode(480.0, damping, 6e6, "x")
    matrix = cutting(8e8, 1e8, 3, 0.3, direction)
    speeds = np.geomspace(300, 40_000, 100) * RPM
    closed = limit_of_one_mode(speeds, mode, matrix, 3)
    general = limit(speeds, dynamics_of_modes([mode], speeds, 3), matrix, 3)
    np.testing.assert_allclose(general.depth, closed.depth, rtol=1e-9)
    assert np.all(closed.depth >= minimum_of_one_mode(mode, matrix)[0] * (1 - 1e-12))


def test_as_the_speed_falls_to_zero_the_limit_falls_to_the_absolute_minimum():
    matrix = cutting(1319.4e6, 788.8e6, 2, 0.5, "down")
    speeds = np.array([2.0, 20.0, 200.0]) * RPM
    dynamics = dynamics_of_modes(TWO_BY_TWO, speeds, 2)
    lowest, _ = absolute_minimum(oriented(dynamics, matrix))
    depth = limit(speeds, dynamics, matrix, 2).depth
    assert np.all(depth >= lowest * (1 - 1e-12))
    assert depth[0] == pytest.approx(lowest, rel=1e-5)
    assert depth[1] == pytest.approx(lowest, rel=1e-3)


def test_no_speed_has_a_limit_below_the_absolute_minimum_and_some_speed_reaches_it():
    matrix = cutting(600e6, 42e6, 3, 0.5, "up")
    speeds = np.linspace(2000, 16_000, 4001) * RPM
    dynamics = dynamics_of_modes(WECK, speeds, 3)
    lowest, _ = absolute_minimum(oriented(dynamics, matrix))
    depth = limit(speeds, dynamics, matrix, 3).depth
    assert depth.min() == pytest.approx(lowest, rel=1e-6)
    assert depth.min() >= lowest * (1 - 1e-12)


def test_the_limit_scales_as_one_over_ktc_while_the_ratio_of_krc_is_held():
    rpm = np.linspace(3000, 15_000, 40)
    one = limit_mm(TWO_BY_TWO, cutting(1e9, 4e8, 2, 0.4, "down"), 2, rpm)
    three = limit_mm(TWO_BY_TWO, cutting(3e9, 12e8, 2, 0.4, "down"), 2, rpm)
    np.testing.assert_allclose(three, one / 3, rtol=1e-9)


@pytest.mark.parametrize("immersion", [0.05, 0.5, 0.9])
def test_up_and_down_have_one_limit_when_the_structure_is_the_same_all_round(immersion):
    rpm = np.linspace(3000, 15_000, 40)
    up, down = (limit_mm(ISOTROPIC, cutting(7e8, 3e8, 4, immersion, d), 4, rpm) for d in ("up", "down"))
    np.testing.assert_allclose(up, down, rtol=1e-9)


@pytest.mark.parametrize("teeth", [3, 4, 6])
@pytest.mark.parametrize("modes", [WECK, TWO_BY_TWO, ISOTROPIC])
def test_with_four_or_six_teeth_in_a_slot_a_multiplier_crosses_the_circle_at_the_limit(modes, teeth):
    """Their forces together do not turn with the cutter, so the mean is all there is; those of three teeth do."""
    speeds = np.linspace(5000, 16_000, 7) * RPM
    tip, cut = tip_of_modes(modes), Regeneration(teeth, 0.0, np.pi, 7e8, 3e8)
    depth = limit(speeds, dynamics_of_modes(modes, speeds, teeth), cutting(7e8, 3e8, teeth, 1.0, "up"), teeth).depth
    sides = [spectral_radius(speeds, depth * side, tip, cut, tolerance=1e-9) for side in (1 - 1e-6, 1 + 1e-6)]
    crosses = bool(np.all(sides[0] < 1) and np.all(sides[1] > 1))
    assert crosses == (teeth != 3)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_at_full_immersion_up_and_down_are_the_slot(direction):
    np.testing.assert_allclose(
        directional_integrals(*engaged(1.0, direction)), directional_integrals(0.0, np.pi), atol=1e-15
    )


def test_the_directional_integrals_are_those_of_the_force_on_a_moved_tool():
    """Q is minus the slope of the force on the tool against a displacement into the cut, summed over the engagement."""
    entry, leave = 0.4, 2.2
    angle = np.linspace(entry, leave, 20_001)
    s, c = np.sin(angle), np.cos(angle)
    for number, (ft, fr) in enumerate([(1.0, 0.0), (0.0, 1.0)]):
        force = np.stack([-ft * c - fr * s, ft * s - fr * c])  # per unit of chip
        chip = np.stack([s, c])  # of a unit displacement along x, y
        expected = -np.trapezoid(force[:, None] * chip, angle, axis=-1)
        np.testing.assert_allclose(directional_integrals(entry, leave)[number], expected, atol=1e-8)


def test_sampled_lines_give_the_modal_limit_with_the_fourth_power_of_the_spacing():
    matrix = cutting(1319.4e6, 788.8e6, 2, 0.5, "down")
    rpm = np.linspace(4000, 16_000, 60)
    exact = limit_mm(TWO_BY_TWO, matrix, 2, rpm)
    errors = []
    for spacing in (4.0, 2.0, 1.0):
        frequency = np.arange(20.0, 3000.0, spacing)
        lines = dynamics_of_lines(frequency, receptance(frequency, TWO_BY_TWO))
        errors.append(np.max(np.abs(limit(rpm * RPM, lines, matrix, 2).depth * 1e3 / exact - 1)))
    assert errors[2] < 2e-6
    assert errors[0] > 8 * errors[1] > 64 * errors[2]


def test_cross_receptance_counts_modes_at_an_angle_are_the_straight_ones_with_turned_cutting():
    """In axes turned by an angle R the same structure is R G R^T; the limit must be that of G with R^T Q R."""
    matrix = cutting(9e8, 3e8, 3, 0.3, "down")
    rpm = np.linspace(4000, 16_000, 40)
    turn = np.array([[np.cos(0.6), -np.sin(0.6)], [np.sin(0.6), np.cos(0.6)]])
    frequency = np.arange(20.0, 3000.0, 1.0)
    turned = dynamics_of_lines(frequency, turn @ receptance(frequency, WECK) @ turn.T)
    found = limit(rpm * RPM, turned, matrix, 3).depth * 1e3
    np.testing.assert_allclose(found, limit_mm(WECK, turn.T @ matrix @ turn, 3, rpm), rtol=1e-5)


def test_a_structure_that_nothing_excites_has_no_limit():
    """Along x alone, at the immersion where Q_xx vanishes, no depth chatters: inf, and no division by zero."""
    nothing = np.zeros((2, 2))
    speeds = np.array([100.0, 500.0])
    for found in (
        limit(speeds, dynamics_of_modes(WECK, speeds, 2), nothing, 2),
        limit_of_one_mode(speeds, WECK[0], nothing, 2),
    ):
        assert np.all(np.isinf(found.depth))
        assert np.all(np.isnan(found.frequency))
        assert np.all(found.lobe == -1)


@pytest.mark.parametrize("modes", [WECK, TWO_BY_TWO, ISOTROPIC])
def test_maxima_found_only_roughly_leave_the_limit_as_it_is_and_the_minimum_to_a_millionth(modes):
    speeds = np.linspace(1000, 16_000, 100) * RPM
    dynamics, matrix = dynamics_of_modes(modes, speeds, 2), cutting(1319e6, 788e6, 2, 0.5, "down")
    fine, rough = (oriented(dynamics, matrix, halvings=steps) for steps in (36, 8))
    np.testing.assert_allclose(limit_along(speeds, rough, 2).depth, limit_along(speeds, fine, 2).depth, rtol=1e-12)
    assert absolute_minimum(rough)[0] == pytest.approx(absolute_minimum(fine)[0], rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_draws_have_the_limits_of_each_structure_alone(seed):
    modes, teeth, matrix, rpm = random_case(seed)
    speeds = np.append(rpm, [50.0, 150.0]) * RPM
    softer = [Mode(m.natural_frequency, m.damping_ratio, m.stiffness / 2, m.axis) for m in modes]
    found = limits_of_draws(speeds, [tip_of_modes(modes), tip_of_modes(softer)], matrix, teeth)
    alone = limit(speeds, dynamics_of_modes(modes, speeds, teeth), matrix, teeth).depth
    np.testing.assert_allclose(found, [alone, alone / 2], rtol=1e-9)


def test_one_structure_serves_all_draws_of_the_force():
    speeds = np.linspace(4000, 15_000, 50) * RPM
    matrices = np.array([cutting(7e8, 7e8 * ratio, 3, 0.2, "down") for ratio in (0.2, 0.3, 0.5)])
    found = limits_of_draws(speeds, [tip_of_modes(WECK)], matrices, 3)
    for depth, matrix in zip(found, matrices, strict=True):
        np.testing.assert_allclose(depth, limit(speeds, dynamics_of_modes(WECK, speeds, 3), matrix, 3).depth, rtol=1e-9)


def test_many_single_modes_have_the_limits_of_each_along_its_own_direction():
    """A mode at an angle is one along x for the force and the chip of that direction, A = u^T Q u."""
    matrix, speeds = cutting(8e8, 3e8, 3, 0.3, "up"), np.geomspace(100, 40_000, 200) * RPM
    frequency, damping, angle = np.array([300.0, 480.0, 900.0]), np.array([0.01, 0.03, 0.6]), np.array([0.0, 0.7, 2.0])
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    shape = 2 * np.pi * frequency[:, None] / np.sqrt(6e6) * direction
    tips = [tip_of_shapes([f], [z], p[None]) for f, z, p in zip(frequency, damping, shape, strict=True)]
    along = np.einsum("ni,ij,nj->n", direction, matrix, direction)
    slow = [
        limit_of_one_mode(speeds, Mode(f, z, 6e6, "x"), np.diag([a, 0.0]), 3).depth
        for f, z, a in zip(frequency, damping, along, strict=True)
    ]
    np.testing.assert_allclose(limits_of_draws(speeds, tips, matrix, 3), slow, rtol=1e-11)
    np.testing.assert_allclose(limits_of_one_mode(speeds, frequency, damping, 6e6, along, 3), slow, rtol=1e-12)
    general = [limit(speeds, dynamics_of_tip(tip, speeds, 3), matrix, 3).depth for tip in tips]
    np.testing.assert_allclose(general, slow, rtol=1e-8)


def test_complex_modes_and_a_remainder_have_the_limits_of_their_lines():
    """Poles with complex residues, a flexibility and a free mass below them: compiled against a spline through close lines."""
    natural, damping = np.array([456.0, 1450.0]), np.array([0.08, 0.02])
    residue = np.array([[[1, 0.2j], [0.1, 0.8 - 0.1j]], [[0.6, -0.3], [-0.2 + 0.1j, 0.9]]]) * -2e-4j
    flexibility, mass = np.diag([4e-9, 6e-9]), np.diag([0.02, 0.03])
    frequency = np.arange(60.0, 5000.0, 0.5)
    values = modal_receptance(frequency, natural, damping, residue, np.stack([mass, flexibility]), (-2, 0))
    matrix, speeds = cutting(9e8, 3e8, 3, 0.4, "down"), np.linspace(3000, 15_000, 40) * RPM
    tip = tip_of_residues(natural, damping, residue, flexibility)
    found = limits_of_draws(
        speeds, [tip], matrix, 3, remainder=mass[None], remainder_power=(-2,), band=(frequency[0], frequency[-1])
    )
    np.testing.assert_allclose(
        found[0], limit(speeds, dynamics_of_lines(frequency, values), matrix, 3).depth, rtol=1e-5
    )


def test_draws_of_what_nothing_excites_have_no_limit():
    speeds = np.array([100.0, 500.0])
    for modes in (WECK, WECK[:1]):
        assert np.all(np.isinf(limits_of_draws(speeds, [tip_of_modes(modes)], np.zeros((2, 2)), 2)))
