"""The contribution of a mode with its losses, against sums written out sample by sample."""

import numpy as np
import pytest

from millcal.numerics.modal_basis import plan_loss, pole_of, pole_slopes, pole_terms, window_end, without_hit

D = 1 / 2000.0
LINES = 2j * np.pi * np.linspace(20.0, 400.0, 23) + 3.0  # a line off the axis, as with an exponential window


def cosine(fall):
    """1 - window from where the window begins to fall."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(fall) + 0.5) / fall) if fall else np.zeros(0)


@pytest.mark.parametrize("fall", [0, 1, 2, 17, 300])
def test_sums_beyond_a_window_are_those_written_out(fall):
    q = np.exp((pole_of(np.array([120.0]), np.array([0.05])) - LINES) * D)
    v = np.concatenate([cosine(fall), np.ones(40_000)])
    k = np.arange(len(v))
    expected = [np.sum(v * k**power * q[:, None] ** k, axis=1) for power in (0, 1)]
    np.testing.assert_allclose(window_end(q, q**fall, fall), expected, rtol=1e-9)


def hits(rng, inputs, count=4, length=12):
    force = rng.standard_normal((count, inputs, length))
    start = rng.integers(2, 9, count)
    stop = rng.integers(60, 90, (count, 2))
    fall = np.stack([np.full(count, 25), np.zeros(count, int)], axis=1)
    fall[2] = 31, 9  # a record of its own length
    return force, start, stop, fall


def spectra(force, start):
    n = start[:, None] + np.arange(force.shape[2])
    return np.einsum("hin,hnl->hil", force, np.exp(-LINES * n[..., None] * D))


def mixing_of(force, start):
    F = spectra(force, start)
    P = np.einsum("hil,hjl->lij", F, F.conj())
    return F, P, np.einsum("hil,lij->hjl", F.conj(), np.linalg.inv(P))


def written_out(pole, power, force, start, stop, fall, mixing):
    """Estimate of the response of one mode with residue 1, from samples beyond 30 decays: what the windows take off."""
    long = int(30 / (-pole.real * D))
    count, inputs, length = force.shape
    lost = np.zeros((2, len(LINES), inputs, inputs), complex)
    n = np.arange(long)
    for o in range(2):
        for h in range(count):
            v = np.zeros(long)
            v[stop[h, o] : stop[h, o] + fall[h, o]] = cosine(fall[h, o])
            v[stop[h, o] + fall[h, o] :] = 1.0
            for i in range(inputs):
                x = np.zeros(long, complex)
                for m in range(length):
                    after = n >= start[h] + m
                    x[after] += D * force[h, i, m] * np.exp(pole * (n[after] - start[h] - m) * D)
                X = (v * x) @ np.exp(-LINES * n[:, None] * D)
                lost[o, :, i] += pole ** power[o] * X[:, None] * mixing[h].T
    return lost


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("power", [(0, 0), (2, 1)])
def test_the_loss_is_that_of_the_samples(inputs, power):
    force, start, stop, fall = hits(np.random.default_rng(0), inputs)
    _, _, mixing = mixing_of(force, start)
    pole = pole_of(np.array([110.0]), np.array([0.04]))
    loss = plan_loss(LINES, force, start, stop, fall, mixing, D)
    value, _ = pole_terms(LINES, pole, np.array(power), loss, inputs)
    whole, _ = pole_terms(LINES, pole, np.array(power), None, inputs)
    expected = written_out(pole[0], power, force, start, stop, fall, mixing)
    np.testing.assert_allclose((whole - value)[:, 0], expected, rtol=1e-8, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("inputs", [1, 3])
def test_slopes_are_differences(inputs):
    force, start, stop, fall = hits(np.random.default_rng(1), inputs)
    loss = plan_loss(LINES, force, start, stop, fall, mixing_of(force, start)[2], D)
    poles, power, h = pole_of(np.array([90.0, 200.0]), np.array([0.1, 0.01])), np.array([2, 0]), 1e-4
    up, down = (pole_terms(LINES, poles + step, power, loss, inputs)[0] for step in (h, -h))
    slope = pole_terms(LINES, poles, power, loss, inputs)[1]
    np.testing.assert_allclose(slope, (up - down) / (2 * h), atol=1e-7 * np.abs(slope).max())


def test_a_window_beyond_the_decay_takes_nothing():
    force, start, _, fall = hits(np.random.default_rng(2), 1)
    stop = np.full((4, 2), 200_000)
    loss = plan_loss(LINES, force, start, stop, fall, mixing_of(force, start)[2], D)
    pole, power = pole_of(np.array([110.0]), np.array([0.04])), np.array([2, 2])
    np.testing.assert_array_equal(
        pole_terms(LINES, pole, power, loss, 1)[0], pole_terms(LINES, pole, power, None, 1)[0]
    )


@pytest.mark.parametrize("inputs", [1, 2])
def test_leaving_a_hit_out_is_planning_without_it(inputs):
    force, start, stop, fall = hits(np.random.default_rng(3), inputs)
    F, P, mixing = mixing_of(force, start)
    rest = np.arange(4) != 2
    ratio = P @ np.linalg.inv(P - np.einsum("il,jl->lij", F[2], F[2].conj()))
    left = without_hit(plan_loss(LINES, force, start, stop, fall, mixing, D), 2, ratio)
    again = plan_loss(
        LINES, force[rest], start[rest], stop[rest], fall[rest], mixing_of(force[rest], start[rest])[2], D
    )
    pole, power = pole_of(np.array([110.0]), np.array([0.04])), np.array([2, 2])
    np.testing.assert_allclose(
        pole_terms(LINES, pole, power, left, inputs), pole_terms(LINES, pole, power, again, inputs), rtol=1e-8
    )


def test_slopes_of_the_pole_are_differences():
    fn, zeta, h = np.array([110.0]), np.array([0.3]), 1e-6
    by_fn = (pole_of(fn * np.exp(h), zeta) - pole_of(fn * np.exp(-h), zeta)) / (2 * h)
    by_zeta = (pole_of(fn, zeta * np.exp(h)) - pole_of(fn, zeta * np.exp(-h))) / (2 * h)
    np.testing.assert_allclose(pole_slopes(fn, zeta)[:, 0], [by_fn[0], by_zeta[0]], rtol=1e-8)
