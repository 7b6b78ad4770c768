"""Poles order by order: exact for exact data, stable where there are modes, quick to tell noise from them."""

import numpy as np
import pytest

from millcal.numerics.pole_search import groups_of, search_poles

FREQUENCY = np.linspace(300.0, 3000.0, 433)
FN, ZETA = np.array([650.0, 1200.0, 2100.0]), np.array([0.03, 0.018, 0.01])
SHAPES = np.array([[0.9, 0.6, 2.2], [0.35, 2.1, -0.9], [0.12, -0.25, 0.3], [0.55, 0.25, -0.8]])


def accelerance(inputs=3):
    s = 2j * np.pi * FREQUENCY[:, None]
    w = 2 * np.pi * FN
    return np.einsum("om,im,fm->foi", SHAPES, SHAPES[:inputs], s**2 / (s**2 + 2 * ZETA * w * s + w**2))


def search(values, orders=range(2, 15)):
    return search_poles(FREQUENCY, values, np.ones(values.shape), list(orders))


@pytest.mark.parametrize("inputs", [1, 2, 3])
def test_modes_stand_in_every_order_that_can_hold_them(inputs):
    poles = search(accelerance(inputs))
    for order in range(8, 15):
        of_order = poles.order == order
        for fn, zeta in zip(FN, ZETA, strict=True):
            nearest = np.argmin(np.abs(poles.frequency[of_order] - fn))
            assert poles.frequency[of_order][nearest] == pytest.approx(fn, rel=1e-3)
            assert poles.damping[of_order][nearest] == pytest.approx(zeta, rel=0.05)


def test_groups_of_stable_poles_are_the_modes_even_in_noise():
    rng = np.random.default_rng(0)
    values = accelerance()
    values = values + 0.01 * np.abs(values).mean() * rng.standard_normal((*values.shape, 2)) @ [1, 1j]
    frequency, damping, count = groups_of(search(values))
    assert list(count) == sorted(count, reverse=True)
    order = np.argsort(frequency[:3])
    np.testing.assert_allclose(frequency[:3][order], FN, rtol=0.005)
    np.testing.assert_allclose(damping[:3][order], ZETA, rtol=0.2)
    assert count[2] >= 9
    assert count[3:].sum() <= 2


def test_poles_are_those_of_scaled_and_mixed_channels():
    rng = np.random.default_rng(1)
    values = accelerance()
    mixed = 1e-6 * np.einsum("po,foi,ij->fpj", rng.standard_normal((5, 4)), values, rng.standard_normal((3, 3)))
    a, b = search(values, [6, 7, 8]), search(mixed, [6, 7, 8])
    for fn in FN:
        nearest = [poles.frequency[np.argmin(np.abs(poles.frequency - fn))] for poles in (a, b)]
        assert nearest[0] == pytest.approx(nearest[1], rel=1e-3)


def test_noise_alone_has_no_pole_that_many_orders_share():
    rng = np.random.default_rng(2)
    values = rng.standard_normal((len(FREQUENCY), 4, 3, 2)) @ [1, 1j]
    _, _, count = groups_of(search(values))
    assert not len(count) or count.max() < 12
    exact = groups_of(search(accelerance()))[2]
    assert (exact[:3] >= 6).all()


def test_no_stable_pole_is_no_group():
    poles = search(accelerance(), [2])
    assert not poles.stable.any()
    assert all(len(part) == 0 for part in groups_of(poles))
