"""Frequency response of a linear system from the spectra of several hits, with one or several inputs at a time.

With rows for the hits, X = F H^T + noise. H1 (least squares) takes the noise to be in the response, H2 in the force, Hv in
both, each scaled by its own noise. The noise that remains in the force spectrum of a hammer makes the plain H1 too small
by 1 + N_ff/S_ff; its expectation is known from the samples before the pulse and taken off S_ff.

References
----------
.. [BendatPiersol2010] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley 2010, chapters 6, 7 and 9.
"""

from typing import NamedTuple

import numpy as np

from millcal.errors import IllPosedError


class FrequencyResponse(NamedTuple):
    """Estimate of one group of inputs. nan where the hits are too few to tell."""

    values: np.ndarray  # (frequency, output, input) complex
    coherence: np.ndarray  # (frequency, output, input) ordinary, of each input with each output
    variance: np.ndarray  # (frequency, output, input) E|error|^2
    explained: np.ndarray  # (frequency, output) response power that follows the forces
    total: np.ndarray  # (frequency, output) response power


def estimate(
    force: np.ndarray,
    response: np.ndarray,
    force_noise: np.ndarray,
    response_noise: np.ndarray,
    *,
    estimator: str = "h1",
) -> FrequencyResponse:
    """Frequency response of all outputs to all inputs.

    force : (hit, input, frequency) complex   response : (hit, output, frequency) complex
    force_noise : (input,), response_noise : (output,) expected |noise|^2 of a line, summed over the hits
    estimator : a key of `ESTIMATORS`
    """
    F = np.ascontiguousarray(force.transpose(2, 0, 1))  # (frequency, hit, input)
    X = np.ascontiguousarray(response.transpose(2, 0, 1))  # (frequency, hit, output)
    n, m = F.shape[1:]
    FH = F.conj().transpose(0, 2, 1)
    Sff, Sfx = FH @ F, FH @ X  # sums over the hits of conj(F) F, conj(F) X
    Sxx = np.sum(X.real**2 + X.imag**2, axis=1)  # (frequency, output)
    values = ESTIMATORS[estimator](Sff, Sfx, Sxx, force_noise, response_noise)

    diagonal = np.einsum("fjj->fj", Sff).real
    inverse = inverse_of(Sff)
    explained = np.einsum("fjo,fjk,fko->fo", Sfx.conj(), inverse, Sfx).real
    explained = np.clip(explained, 0.0, Sxx)
    if n > m:
        # variance of the residual response, then of the estimate [BendatPiersol2010]_ 9.2
        scatter = (Sxx - explained) / (n - m)
        variance = scatter[:, :, None] * np.einsum("fjj->fj", inverse).real[:, None, :]
        power = Sxx[:, :, None] * diagonal[:, None, :]
        coherence = divide(np.abs(Sfx.transpose(0, 2, 1)) ** 2, power).clip(0.0, 1.0)
    else:
        variance = np.full(values.shape, np.nan)
        coherence = np.full(values.shape, np.nan)
    return FrequencyResponse(values, coherence, variance, explained, Sxx)


def divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and nan where b is zero."""
    out = np.full(np.broadcast_shapes(a.shape, b.shape), np.nan, np.result_type(a, b))
    return np.divide(a, b, out=out, where=b != 0)


def inverse_of(matrices: np.ndarray) -> np.ndarray:
    """Inverse of Hermitian matrices; nan where one cannot be inverted.   matrices : (frequency, input, input)"""
    if matrices.shape[-1] == 1:
        return divide(np.ones(1), matrices)
    scale = np.sqrt(np.einsum("fjj->fj", matrices).real)
    scale = np.where(scale > 0, scale, 1.0)
    scaled = matrices / (scale[:, :, None] * scale[:, None, :])
    good = np.linalg.eigvalsh(scaled)[:, 0] > 1e-12
    inverse = np.full(matrices.shape, np.nan, complex)
    inverse[good] = np.linalg.inv(scaled[good])
    return inverse / (scale[:, :, None] * scale[:, None, :])


def condition(force: np.ndarray) -> float:
    """How well several inputs are told apart by the hits: median condition number of the scaled S_ff over the lines.

    force : (hit, input, frequency) complex, lines with enough force only
    """
    unit = force / np.maximum(np.linalg.norm(force, axis=0), 1e-300)
    singular = np.linalg.svd(unit.transpose(2, 0, 1), compute_uv=False)
    return float(np.median(singular[:, 0] / np.maximum(singular[:, -1], 1e-300)))


def deviation(force: np.ndarray, response: np.ndarray) -> np.ndarray:
    """How far the response of each hit is from that of the median frequency response: relative, over all given lines.

    force : (hit, frequency)   response : (hit, output, frequency)   returns (hit,)
    """
    H = response / force[:, None, :]
    usual = np.median(H.real, axis=0) + 1j * np.median(H.imag, axis=0)
    error = np.sum(np.abs(response - usual * force[:, None, :]) ** 2, axis=(1, 2))
    return np.sqrt(error / np.maximum(np.sum(np.abs(response) ** 2, axis=(1, 2)), 1e-300))


def h1(Sff, Sfx, Sxx, force_noise, response_noise):
    """Least squares, S_fx / S_ff, with the expected noise taken off S_ff (never more than half of it)."""
    diagonal = np.einsum("fjj->fj", Sff).real
    less = np.minimum(force_noise, 0.5 * diagonal)
    freed = Sff - less[:, :, None] * np.eye(len(force_noise))
    return (inverse_of(freed) @ Sfx).transpose(0, 2, 1)


def h2(Sff, Sfx, Sxx, force_noise, response_noise):
    """S_xx / S_xf, for one input: right where the noise is in the force alone. Not the choice for a hammer."""
    if Sff.shape[-1] > 1:
        raise IllPosedError("estimator h2: needs one force channel in a recording; use h1 or hv")
    return divide(Sxx, Sfx[:, 0, :].conj())[:, :, None]


def hv(Sff, Sfx, Sxx, force_noise, response_noise):
    """Total least squares with every channel scaled by its own noise, so that newton and m/s^2 may be compared.

    The residual has the direction of the smallest eigenvector of the cross-spectra of [F, x], each output alone. Where
    no noise can be seen the channels are scaled by their power.
    """
    m, outputs = Sfx.shape[1:]
    power = np.einsum("fjj->fj", Sff).real
    noisy = force_noise.min() > 0 and response_noise.min() > 0
    p = np.sqrt(force_noise if noisy else power.mean(axis=0))
    q = np.sqrt(response_noise if noisy else Sxx.mean(axis=0))
    q = np.where(q > 0, q, 1.0)
    Z = np.empty((len(Sff), outputs, m + 1, m + 1), complex)  # conj(z) z, z = [F/p, x/q]
    Z[..., :m, :m] = (Sff / (p[:, None] * p))[:, None]
    Z[..., :m, m] = (Sfx / (p[:, None] * q)).transpose(0, 2, 1)
    Z[..., m, :m] = Z[..., :m, m].conj()
    Z[..., m, m] = Sxx / q**2
    v = np.linalg.eigh(Z)[1][..., 0]  # z @ v is smallest
    return divide(-v[..., :m], v[..., m:]) * q[:, None] / p


ESTIMATORS = {"h1": h1, "h2": h2, "hv": hv}
