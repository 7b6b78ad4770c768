"""Facts of the harmonics of a milling force: closed forms, the equations between them, and what the printed ones get wrong.

The published equations are those of Pawelko, Powalka and Berczynski 2012 ("Estimation of cutting force model coefficients with
regularized inverse problem"), quoted by their numbers. Its Fourier coefficients are two-sided: half of ours.
"""

import numpy as np
import pytest
from structure_2012 import COEFFICIENTS, CUTTER, conditions

from millcal.numerics.linear_inverse import as_real_vector
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import LinearEdge, force_harmonics
from millcal.physics.force_subspace import NAMES, force_constraint, harmonic_basis, orders_of

SLOT = conditions(80.0)
FEED, DEPTH = SLOT.feed_per_tooth, SLOT.axial_depth
A, B = DEPTH * FEED, DEPTH  # the paper's a_p f_z and a_p
UNEQUAL = tuple(np.radians([84.0, 96.0, 87.0, 93.0]))
PAPER_ORDER = [0, 3, 1, 4, 2, 5]  # Kc Kce Kt Kte Ka Kae among ours


def milling(direction="slot", radial=0.02, feed=FEED):
    return CuttingConditions(500.0, feed, DEPTH, radial, direction)


HALF, QUARTER = milling("up", 0.01), milling("down", 0.005)


def two_sided(cutter, cut, harmonics, axes="xyz"):
    """Two-sided Fourier coefficients of W at the harmonics of the tooth passing.   returns (harmonic, axis, coefficient)"""
    return harmonic_basis(cutter, cut, cutter.teeth * np.arange(1, harmonics + 1), axes) / 2


def constraint(cutter, cut, axes="xyz", harmonics=2):
    return force_constraint(harmonic_basis(cutter, cut, orders_of(cutter, harmonics), axes))


def exact_slot():
    """The two-sided harmonics 1 and 2 of the slot with two teeth, in closed form (instead of eq. 19).   returns (2, 3) N"""
    Kc, Kt, Ka, Kce, Kte, _ = COEFFICIENTS
    pi = np.pi
    return np.array(
        [
            [
                A * Kt / 4 + 2 * B * Kte / (3 * pi) + 1j * (A * Kc / 4 + 4 * B * Kce / (3 * pi)),
                -A * Kc / 4 - 2 * B * Kce / (3 * pi) + 1j * (A * Kt / 4 + 4 * B * Kte / (3 * pi)),
                -2 * A * Ka / (3 * pi),
            ],
            [
                2 * B * Kte / (15 * pi) + 8j * B * Kce / (15 * pi),
                -2 * B * Kce / (15 * pi) + 8j * B * Kte / (15 * pi),
                -2 * A * Ka / (15 * pi),
            ],
        ]
    )


PUBLISHED = np.array(
    [[65.2324 + 117.4413j, -96.2207 + 77.9648j, -15.9155], [2.5465 + 16.9765j, -4.2441 + 10.1859j, -3.1831]]
)
ROW = np.array([1, 1j, 0, -5 / 3, -5j / 3, 0])  # what holds for exp(-j k w t)
PRINTED_ROW = np.array([1j, 1, 0, -5j / 3, -5 / 3, 0])  # eq. 21


def closed_form(cutter, cut, harmonics):
    """W_k of a straight cutter with equal pitch, from E_m, the integral of e^(j(m - kz) phi) over the engagement.

    returns two-sided (harmonic, axis, coefficient)
    """
    entry, leave = engagement(cut, cutter.diameter)
    z, f = cutter.teeth, cut.feed_per_tooth
    found = []
    for k in range(1, harmonics + 1):
        p = np.arange(-2, 3) - k * z
        turn = np.divide(
            np.exp(1j * p * leave) - np.exp(1j * p * entry), 1j * p, where=p != 0, out=np.zeros(5, complex)
        )
        E = dict(zip(range(-2, 3), np.where(p == 0, leave - entry, turn), strict=True))
        s, c = (E[1] - E[-1]) / 2j, (E[1] + E[-1]) / 2
        ss, sc = (2 * E[0] - E[2] - E[-2]) / 4, (E[2] - E[-2]) / 4j
        x, y, axial = [-f * sc, -f * ss, 0, -c, -s, 0], [f * ss, -f * sc, 0, s, -c, 0], [0, 0, f * s, 0, 0, E[0]]
        found.append(z / (2 * np.pi) * cut.axial_depth * np.array([x, y, axial]))
    return np.array(found)


def test_the_slot_of_the_paper_has_the_closed_form_and_the_listed_values():
    F = two_sided(CUTTER, SLOT, 2) @ COEFFICIENTS
    np.testing.assert_allclose(F, exact_slot(), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(exact_slot(), PUBLISHED, atol=6e-5)


@pytest.mark.parametrize("cut", [SLOT, HALF, QUARTER, milling("down", 0.013)], ids=["slot", "half", "quarter", "down"])
@pytest.mark.parametrize("teeth", [1, 2, 3, 4, 6])
def test_any_engagement_and_number_of_teeth_has_the_closed_form(teeth, cut):
    cutter = Cutter(0.02, teeth)
    W = two_sided(cutter, cut, 4)
    np.testing.assert_allclose(W, closed_form(cutter, cut, 4), atol=1e-12 * np.abs(W).max())


def test_the_basis_is_that_of_the_force_law():
    cutter = Cutter(0.02, 3, helix=0.5, pitch=tuple(np.radians([110, 130, 120])), runout=8e-6, runout_angle=0.7)
    law = LinearEdge(cutting=COEFFICIENTS[:3], edge=COEFFICIENTS[3:])
    basis = harmonic_basis(cutter, HALF, range(1, 10), "zx")
    expected = force_harmonics(law, cutter, HALF, 9)[[2, 0], 1:]
    np.testing.assert_allclose((basis @ COEFFICIENTS).T, expected, rtol=1e-12)


def test_cutting_coefficients_of_the_plane_are_in_the_first_harmonic_of_the_slot_alone():
    W = two_sided(CUTTER, SLOT, 4, "xy")
    assert np.abs(W[1:, :, :2]).max() < 1e-14 * np.abs(W[0, :, :2]).max()


def test_the_corrected_row_holds_for_the_harmonics():
    F = exact_slot().ravel()
    assert abs(ROW @ F) < 1e-14 * np.linalg.norm(ROW) * np.linalg.norm(F)
    assert abs(ROW @ (two_sided(CUTTER, SLOT, 2) @ COEFFICIENTS).ravel()) < 1e-14 * np.linalg.norm(
        ROW
    ) * np.linalg.norm(F)


def test_the_printed_row_holds_for_the_other_sign_of_the_exponent_only():
    F = exact_slot().ravel()
    size = np.linalg.norm(PRINTED_ROW) * np.linalg.norm(F)
    assert abs(PRINTED_ROW @ F) / size == pytest.approx(0.426, abs=1e-3)
    assert abs(PRINTED_ROW @ F) == pytest.approx(216, abs=0.5)
    assert abs(PRINTED_ROW @ F.conj()) < 1e-14 * size


def test_equation_19_is_four_and_two_times_the_harmonics_with_x_and_y_exchanged():
    """It is printed with the period 30/N as a factor, taken off here."""
    Kc, Kt, _, Kce, Kte, _ = COEFFICIENTS
    pi = np.pi
    printed = np.array(
        [
            [
                -Kc * A - 8 * Kce * B / (3 * pi) + 1j * (Kt * A + 16 * Kte * B / (3 * pi)),
                Kt * A + 8 * Kte * B / (3 * pi) + 1j * (Kc * A + 16 * Kce * B / (3 * pi)),
            ],
            [
                -4 * Kce * B / (15 * pi) + 16j * Kte * B / (15 * pi),
                4 * Kte * B / (15 * pi) + 16j * Kce * B / (15 * pi),
            ],
        ]
    )
    ratio = printed / exact_slot()[:, [1, 0]]
    np.testing.assert_allclose(ratio, [[4, 4], [2, 2]], rtol=1e-12)
    F = np.column_stack([printed, np.zeros(2)]).ravel()  # and its own row does not follow from it
    assert abs(PRINTED_ROW @ F) / (np.linalg.norm(PRINTED_ROW) * np.linalg.norm(F)) == pytest.approx(2.5e-2, abs=1e-3)


def test_the_other_equations_of_the_slot_hold_too():
    (_, _, z1), (x2, y2, z2) = exact_slot()
    size = 1e-14 * np.abs(exact_slot()).max()
    assert abs((x2 - 1j * y2) + 5 / 3 * np.conj(x2 + 1j * y2)) < size
    assert abs(z1 - 5 * z2) < size
    rows = constraint(CUTTER, SLOT).rows
    assert len(rows) == 7
    assert np.linalg.norm(rows @ as_real_vector(exact_slot().ravel())) < 1e-13 * np.linalg.norm(exact_slot())


def test_a_complex_row_is_two_rows_of_the_constraint():
    rows = constraint(CUTTER, SLOT).rows
    for row in (as_real_vector(ROW.conj()), as_real_vector((1j * ROW).conj())):  # Re(ROW F) and -Im(ROW F)
        np.testing.assert_allclose(rows.T @ (rows @ row), row, atol=1e-12)


NONE = ()
PLANE = ("Kac", "Kae")  # nothing in x and y tells the axial coefficients


@pytest.mark.parametrize(
    ("teeth", "helix", "cut", "axes", "harmonics", "rank", "real_rows", "complex_rows", "hidden"),
    [
        (2, 0.0, SLOT, "xy", 2, 4, 4, 1, NONE),
        (2, 0.0, SLOT, "xyz", 2, 5, 7, 2, ("Kae",)),
        (2, 0.0, SLOT, "xy", 1, 4, 0, 0, NONE),
        (2, 0.0, SLOT, "xy", 3, 4, 8, 3, NONE),
        (2, 0.0, SLOT, "xy", 4, 4, 12, 5, NONE),
        (3, 0.0, SLOT, "xy", 2, 4, 4, 0, NONE),
        (4, 0.0, SLOT, "xy", 2, 2, 6, 2, ("Ktc", "Krc")),
        (6, 0.0, SLOT, "xy", 2, 2, 6, 2, ("Ktc", "Krc")),
        (1, 0.0, HALF, "xy", 2, 4, 4, 0, NONE),
        (2, 0.0, HALF, "xy", 2, 4, 4, 0, NONE),
        (4, 0.0, HALF, "xy", 2, 4, 4, 0, NONE),
        (4, 0.0, HALF, "xyz", 2, 5, 7, 1, ("Kae",)),
        (4, 0.0, QUARTER, "xy", 2, 4, 4, 0, NONE),
        (2, np.arctan(0.15 * 10.0), SLOT, "xy", 2, 4, 4, 1, NONE),  # 0.15 rad per mm of depth at a radius of 10 mm
    ],
)
def test_ranks_rows_and_hidden_coefficients_are_as_published(
    teeth, helix, cut, axes, harmonics, rank, real_rows, complex_rows, hidden
):
    found = constraint(Cutter(0.02, teeth, helix), cut, axes, harmonics)
    assert (found.rank, len(found.rows), found.complex_rows) == (rank, real_rows, complex_rows)
    expected = {*hidden, *(() if "z" in axes else PLANE)}
    assert found.unobservable == tuple((name,) for name in NAMES if name in expected)
    assert [name for name, told in zip(NAMES, found.told, strict=True) if not told] == [
        n for n in NAMES if n in expected
    ]


@pytest.mark.parametrize("cut", [SLOT, HALF, QUARTER])
@pytest.mark.parametrize("cutter", [Cutter(0.02, 4, 0.5), Cutter(0.02, 4, pitch=UNEQUAL), Cutter(0.02, 3, runout=5e-6)])
def test_the_constraint_holds_for_all_coefficients_of_any_cutter_and_for_nothing_else(cutter, cut):
    basis = harmonic_basis(cutter, cut, orders_of(cutter, 2))
    found = force_constraint(basis)
    rng = np.random.default_rng(3)
    F = as_real_vector((basis @ (COEFFICIENTS * rng.uniform(0.2, 3, 6))).ravel())
    assert np.linalg.norm(found.rows @ F) < 1e-12 * np.linalg.norm(F)
    other = rng.normal(size=len(F))
    off = other - found.space.basis @ (found.space.basis.T @ other)
    assert np.linalg.norm(found.rows @ other) == pytest.approx(np.linalg.norm(off))


def test_two_cuts_with_the_same_coefficients_bind_each_other():
    """Each cut alone leaves its four unknowns; together they have the same four."""
    one, other = (harmonic_basis(CUTTER, milling(feed=feed), [2, 4], "xy") for feed in (0.1e-3, 0.2e-3))
    both = force_constraint(np.concatenate([one, other]))
    assert both.rank == 4
    assert len(both.rows) == len(force_constraint(one).rows) + len(force_constraint(other).rows) + 4


def test_equation_23_in_the_printed_order_gives_the_listed_wrong_coefficients():
    W = two_sided(CUTTER, SLOT, 2, "xy")[:, :, PAPER_ORDER[:4]]
    F = exact_slot()[:, :2]
    left = np.concatenate([F[0].real, F[0].imag, F[1].real, F[1].imag])
    right = np.vstack([W[0].real, W[0].imag, W[1].real, W[1].imag])
    printed = np.vstack([W[0].real, W[0].imag, W[1].imag, W[1].real])
    shop_floor = [1e6, 1e3, 1e6, 1e3]
    np.testing.assert_allclose(np.linalg.lstsq(right, left)[0] / shop_floor, [1000, 50, 700, 30], rtol=1e-10)
    wrong = np.linalg.lstsq(printed * shop_floor, left)[0]
    np.testing.assert_allclose(wrong, [1244.577, 21.186, 846.746, 12.712], atol=6e-4)


def test_a_helix_is_one_factor_for_each_harmonic():
    straight, helical = Cutter(0.02, 3), Cutter(0.02, 3, helix=0.6)
    k = 3 * np.arange(1, 5)[:, None, None]
    x = k * DEPTH * np.tan(0.6) / 0.02
    expected = harmonic_basis(straight, HALF, k.ravel()) * np.exp(-1j * x) * np.sin(x) / x
    np.testing.assert_allclose(harmonic_basis(helical, HALF, k.ravel()), expected, atol=1e-13 * np.abs(expected).max())


def test_a_harmonic_of_which_whole_waves_fit_on_the_edge_vanishes():
    helical = Cutter(0.02, 2, helix=np.arctan(np.pi * 0.02 / (4 * DEPTH)))  # 4 a_p tan(helix) / D = pi
    basis = harmonic_basis(helical, SLOT, [2, 4])
    assert np.abs(basis[1]).max() < 1e-11 * np.abs(basis[0]).max()
    assert constraint(helical, SLOT, "xy").rank == 4
    assert constraint(helical, SLOT, "xyz").rank == 5


def test_unequal_pitch_is_a_sum_of_lags_for_the_edge_and_one_weighted_by_the_chip_for_the_rest():
    """A tooth behind a longer pitch meets a thicker chip; with equal chips both factors were sum exp(-j n psi)."""
    cutter, one = Cutter(0.02, 4, pitch=UNEQUAL), Cutter(0.02, 1)
    n = np.arange(1, 13)
    psi = cutter.tooth_lag()
    share = 4 * np.array([UNEQUAL[3], *UNEQUAL[:3]]) / (2 * np.pi)  # of the pitch before each tooth
    turn = np.exp(-1j * np.outer(n, psi))
    single, basis = harmonic_basis(one, HALF, n), harmonic_basis(cutter, HALF, n)
    atol = 1e-13 * np.abs(basis).max(axis=(0, 1))
    expected = single * np.where(np.arange(6) < 3, (turn @ share)[:, None, None], turn.sum(axis=1)[:, None, None])
    assert np.all(np.abs(basis - expected) <= atol)


@pytest.mark.parametrize(
    ("cutter", "orders"),
    [
        (Cutter(0.02, 3), [3, 6]),
        (Cutter(0.02, 2, pitch=(np.pi, np.pi)), [2, 4]),
        (Cutter(0.02, 2, pitch=(3.0, 2 * np.pi - 3.0)), [1, 2, 3, 4]),
        (Cutter(0.02, 2, runout=1e-6), [1, 2, 3, 4]),
        (Cutter(0.02, 4, pitch=tuple(np.radians([80, 100, 80, 100]))), [2, 4, 6, 8]),
        (Cutter(0.02, 4, pitch=tuple(np.radians([80, 100, 80, 100])), runout=1e-6), list(range(1, 9))),
    ],
)
def test_the_orders_are_those_that_carry_force(cutter, orders):
    np.testing.assert_array_equal(orders_of(cutter, 2), orders)
    all_of_them = np.arange(1, 2 * cutter.teeth + 1)
    size = np.abs(harmonic_basis(cutter, HALF, all_of_them)).max(axis=(1, 2))
    np.testing.assert_array_equal(all_of_them[size > 1e-12 * size.max()], orders)


def test_a_force_counted_from_another_angle_turns_each_harmonic_by_its_order():
    angle, order = np.linspace(0, 2 * np.pi, 7), np.array([2, 4, 6])
    c = harmonic_basis(CUTTER, HALF, order, "x")[:, 0] @ COEFFICIENTS
    later = np.real(np.exp(1j * np.outer(angle - 0.3, order)) @ c)
    np.testing.assert_allclose(np.real(np.exp(1j * np.outer(angle, order)) @ (c * np.exp(-0.3j * order))), later)
