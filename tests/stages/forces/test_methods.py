"""The methods beside the noise-weighted one: what each is equal to, what the options do, and that all are compared alike."""

import numpy as np
import pytest
from accelerometer_cuts import LAW, TWO_TEETH, drawn_frf, heard_cut, slot, structure

from millcal.numerics.linear_inverse import as_real_vector
from millcal.physics.force_subspace import NAMES as COEFFICIENTS
from millcal.physics.force_subspace import force_constraint, harmonic_basis
from millcal.stages.forces import reconstruct_forces
from millcal.stages.forces.frf_errors import frf_at
from millcal.stages.forces.methods import NAMES

OF = structure(2012)
CONDITIONS = slot(72.0)
ORDERS = (2, 4, 6)
CUT = heard_cut(OF, CONDITIONS, np.random.default_rng(1), noise=0.5)
FRF = drawn_frf(OF, np.random.default_rng(1))
BASIS = harmonic_basis(TWO_TEETH, CONDITIONS, ORDERS)
MATRIX = frf_at(FRF, 36.0 * np.array(ORDERS), np.arange(6), [0, 1, 2])
HEARD = CUT.harmonics[:, ORDERS].T


def force(method="gtls", **options):
    return reconstruct_forces([CUT], FRF, method=method, harmonics=3, phase="known", **options)


def test_least_squares_takes_every_line_by_itself():
    alone = [np.linalg.lstsq(A, y, rcond=None)[0] for A, y in zip(MATRIX, HEARD, strict=True)]
    assert force("ls").force == pytest.approx(np.array(alone), rel=1e-9)


def test_constrained_least_squares_is_that_of_the_coefficients():
    """a = G W K in parts, columns scaled; the edge coefficient along z has no alternating force."""
    told = [i for i, name in enumerate(COEFFICIENTS) if name != "Kae"]
    slopes = as_real_vector((MATRIX @ BASIS[:, :, told]).reshape(-1, len(told)))
    scale = np.linalg.norm(slopes, axis=0)
    expected = np.linalg.lstsq(slopes / scale, as_real_vector(HEARD.ravel()), rcond=None)[0] / scale
    found = force("constrained-ls")
    assert found.posterior.names == tuple(COEFFICIENTS[i] for i in told)
    assert found.posterior.mean == pytest.approx(expected, rel=1e-6)
    assert found.force == pytest.approx(BASIS[:, :, told] @ expected, rel=1e-6)


@pytest.mark.parametrize("method", ["constrained-ls", "rtls", "gtls"])
def test_methods_that_ask_for_the_law_obey_it(method):
    rows = force_constraint(BASIS).rows
    left = rows @ as_real_vector(force(method).force.ravel())
    assert np.abs(left).max() < 1e-6 * np.abs(force(method).force).max()
    free = rows @ as_real_vector(force("ls").force.ravel())
    assert np.abs(free).max() > 1e-3 * np.abs(force("ls").force).max()


def test_methods_go_over_into_each_other():
    plain, total = force("ls").force, force("tls").force
    size = np.abs(plain).max()
    assert np.abs(force("tikhonov", regularization=1e-9).force - plain).max() < 1e-9 * size
    assert np.abs(force("tikhonov", regularization=1e6).force).max() < 1e-6 * size
    assert np.abs(force("rtls", slack=1e9).force - total).max() < 1e-6 * size
    tight, exact = force("rtls", slack=1e-6).force, force("rtls").force
    assert np.abs(tight - exact).max() < 1e-4 * size
    assert 1e-4 * size < np.abs(total - plain).max()


@pytest.mark.parametrize("how", ["gcv", "l-curve", "discrepancy"])
def test_the_weight_of_tikhonov_is_chosen_and_told(how):
    found = force("tikhonov", regularization=how)
    assert found.regularization_from == how
    assert found.regularization > 0
    same = force("tikhonov", regularization=found.regularization)
    assert same.regularization_from == "given"
    assert same.force == pytest.approx(found.force, rel=1e-9)


def test_all_methods_are_compared_on_the_same_lines():
    for method in NAMES:
        own = force(method)
        assert own.compared_methods == NAMES
        row = NAMES.index(method)
        assert own.compared[row] == pytest.approx(own.posterior.mean, rel=1e-9)
        assert own.compared_sd[row] == pytest.approx(np.sqrt(np.diag(own.posterior.covariance)), rel=1e-6)
        assert own.recommended == "gtls"
        assert own.force_covariance.shape == (3, 6, 6)
        assert np.linalg.eigvalsh(own.force_covariance).min() > -1e-9 * np.abs(own.force_covariance).max()


@pytest.mark.parametrize("method", ["ls", "tls", "constrained-ls", "rtls", "gtls"])
def test_the_spread_of_a_force_is_that_over_repetitions(method):
    """Stated rms over the lines against the errors of 30 cuts and impact tests, at 72 Hz."""
    truth = np.einsum("lap,p->la", BASIS, np.concatenate([LAW.cutting, LAW.edge]))
    off, stated = [], []
    for seed in range(30):
        cut = heard_cut(OF, CONDITIONS, np.random.default_rng(seed), noise=0.5)
        frf = drawn_frf(OF, np.random.default_rng(500 + seed))
        found = reconstruct_forces([cut], frf, method=method, harmonics=3, phase="known")
        off.append(np.sum(np.abs(found.force - truth) ** 2))
        stated.append(np.sum(np.einsum("lpp->l", found.force_covariance)))
    assert np.sqrt(np.mean(stated) / np.mean(off)) == pytest.approx(1.0, abs=0.3)


def test_weighting_by_noise_pays():
    """Errors of Ktc and Krc over seeds: gtls below least squares with the law, that below least squares without."""
    rms = {}
    for method in ("ls", "constrained-ls", "gtls"):
        errors = []
        for seed in range(25):
            cut = heard_cut(OF, slot((60.0, 72.0, 84.0)[seed % 3]), np.random.default_rng(seed), noise=0.5)
            frf = drawn_frf(OF, np.random.default_rng(500 + seed))
            found = reconstruct_forces([cut], frf, method=method, phase="known")
            errors.append([found.posterior["Ktc"] / 1000e6 - 1, found.posterior["Krc"] / 700e6 - 1])
        rms[method] = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms["gtls"] < rms["constrained-ls"])
    assert np.all(rms["gtls"] < 0.8 * rms["ls"])
