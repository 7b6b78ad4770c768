"""Frequency response of a linear system from the spectra of several hits, with one or several inputs at a time.

With rows for the hits, X = F H^T + noise. H1 (least squares) takes the noise to be in the response, H2 in the force, Hv in
both, each scaled by its own noise. The noise that remains in the force spectrum of a hammer makes the plain H1 too small
by 1 + N_ff/S_ff; its expectation is known from the samples before the pulse and taken off S_ff.

References
----------
.. [BendatPiersol2010] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley 2010, chapters 6, 7 and 9.
.. [DeGroatDowling1993] R. D. DeGroat, E. M. Dowling, The data least squares problem and channel equalization, IEEE
   Transactions on Signal Processing 41 (1993) 407-411.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class FrequencyResponse(NamedTuple):
    """Estimate of one group of inputs. nan where the hits are too few to tell."""

    values: np.ndarray  # (frequency, output, input) complex
    coherence: np.ndarray  # (frequency, output, input) ordinary, of each input with each output
    variance: np.ndarray  # (frequency, output, input) E|error|^2
    explained: np.ndarray  # (frequency, output) response power that follows the forces
    total: np.ndarray  # (frequency, output) response power


class CrossSpectra:
    """Sums over hits of the products of their spectra: all that an estimate needs of them, in the room of one hit.

    A hit is added when it is transformed, and taken off again when it turns out to be unlike the others. What is left then
    has the rounding of the sum that it was taken from, 1e-16 of it. Frequency is the last axis here, as transforms have it.
    """

    def __init__(self, inputs: int, outputs: int, lines: int) -> None:
        self.hits = 0
        self.Sff = np.zeros((inputs, inputs, lines), complex)  # conj(F_j) F_k
        self.Sfx = np.zeros((inputs, outputs, lines), complex)  # conj(F_j) X_o
        self.Sxx = np.zeros((outputs, lines))
        self.force_noise = np.zeros(inputs)  # expected |noise|^2 of a line
        self.response_noise = np.zeros(outputs)

    def add(
        self,
        force: np.ndarray,
        response: np.ndarray,
        force_noise: np.ndarray,
        response_noise: np.ndarray,
        sign: int = 1,
    ) -> None:
        """One hit more, or with sign = -1 one less.

        force : (input, frequency) complex   response : (output, frequency) complex
        force_noise : (input,), response_noise : (output,) expected |noise|^2 of a line
        """
        self.hits += sign
        for j, conjugate in enumerate(force.conj() * sign):
            self.Sff[j] += conjugate * force
            for own, spectrum in zip(self.Sfx[j], response, strict=True):  # row by row: nothing large in between
                own += conjugate * spectrum
        for power, spectrum in zip(self.Sxx, response, strict=True):
            size = np.square(spectrum.real)
            size += np.square(spectrum.imag)
            power += sign * size
        self.force_noise += sign * force_noise
        self.response_noise += sign * response_noise


def joined(parts: Sequence[tuple[CrossSpectra, Sequence[int], Sequence[int]]], inputs: int) -> CrossSpectra:
    """Sums over several tests in common rows.

    parts : sums of one test, the common input that each of its inputs is, and its outputs in the common order
    """
    first, _, rows = parts[0]
    total = CrossSpectra(inputs, len(rows), first.Sxx.shape[-1])
    for sums, columns, rows in parts:
        total.hits += sums.hits
        total.Sff[np.ix_(columns, columns)] += sums.Sff
        total.Sfx[columns] += sums.Sfx[:, rows]
        total.Sxx += sums.Sxx[rows]
        total.force_noise[columns] += sums.force_noise
        total.response_noise += sums.response_noise[rows]
    return total


def estimate(sums: CrossSpectra, *, estimator: str = "h1") -> FrequencyResponse:
    """Frequency response of all outputs to all inputs.   estimator : a key of `ESTIMATORS`

    The variance is that of the residual response times the inverse of S_ff [BendatPiersol2010]_ 9.2; with as many hits as
    inputs nothing is left to tell it from, nor the coherence.
    """
    n, m = sums.hits, len(sums.Sff)
    Sff = np.ascontiguousarray(sums.Sff.transpose(2, 0, 1))  # (frequency, input, input)
    Sfx = sums.Sfx.transpose(2, 0, 1)  # (frequency, input, output)
    Sxx = sums.Sxx.T  # (frequency, output)
    values = ESTIMATORS[estimator](Sff, Sfx, Sxx, sums.force_noise, sums.response_noise)

    diagonal = np.einsum("fjj->fj", Sff).real
    inverse = inverse_of(Sff)
    crossed = np.abs(Sfx) ** 2
    if m == 1:
        explained = crossed[:, 0] * inverse[:, 0].real
    else:
        explained = np.einsum("fjo,fjk,fko->fo", Sfx.conj(), inverse, Sfx, optimize=True).real
    explained = np.clip(explained, 0.0, Sxx)
    if n > m:
        scatter = (Sxx - explained) / (n - m)
        variance = scatter[:, :, None] * np.einsum("fjj->fj", inverse).real[:, None, :]
        coherence = divide(crossed.transpose(0, 2, 1), Sxx[:, :, None] * diagonal[:, None, :]).clip(0.0, 1.0)
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


def condition(Sff: np.ndarray) -> float:
    """How well several inputs are told apart by the hits: median condition number of the scaled forces over the lines.

    Sff : (input, input, frequency) sums over the hits of conj(F_j) F_k, on lines with enough force only
    """
    size = np.sqrt(np.maximum(np.einsum("jjf->jf", Sff).real, 1e-300))
    squares = np.linalg.eigvalsh((Sff / (size[:, None] * size)).transpose(2, 0, 1))
    return float(np.median(np.sqrt(squares[:, -1] / np.maximum(squares[:, 0], 1e-16))))


def predicted(force: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the other hits say that the response of each should be, and how far these are from each other.

    For one input by the median over the hits, real and imaginary part apart, which some odd hits do not move. For several by
    least squares over the other hits, with errors brought to the size of their noise by 1 / sqrt(1 + leverage): a hit that
    stands alone in its direction is not well foretold.

    force : (hit, input, frequency) complex   response : (hit, output, frequency) complex
    returns as response, and the usual deviation (hit,)
    """
    if force.shape[1] == 1:
        H = response / force
        usual = np.median(H.real, axis=0) + 1j * np.median(H.imag, axis=0)
        expected = usual * force
        return expected, np.full(len(force), np.median(deviation(response, expected)))
    expected, among = np.empty_like(response), np.empty(len(force))
    for hit in range(len(force)):
        rest = np.arange(len(force)) != hit
        F, X = force[rest].transpose(2, 0, 1), response[rest].transpose(2, 0, 1)  # (frequency, hit, ...)
        Q, R = np.linalg.qr(F)
        seen = Q.conj().transpose(0, 2, 1) @ X
        own = np.linalg.solve(R.transpose(0, 2, 1), force[hit].T[:, :, None])[:, :, 0]  # F_h R^-1
        left = np.sqrt(np.maximum(1.0 - np.sum(np.abs(Q) ** 2, axis=2), 1e-6))[:, :, None]
        error = (response[hit].T - (own[:, None, :] @ seen)[:, 0]) / np.sqrt(1.0 + np.sum(np.abs(own) ** 2, axis=1))[
            :, None
        ]
        expected[hit] = response[hit] - error.T
        among[hit] = np.median(deviation(response[rest], (X - (X - Q @ seen) / left).transpose(1, 2, 0)))
    return expected, among


def deviation(actual: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """How far each hit's response is from another, relative to its size.   both (hit, output, frequency), returns (hit,)"""
    error = np.sum(np.abs(actual - expected) ** 2, axis=(1, 2))
    return np.sqrt(error / np.maximum(np.sum(np.abs(actual) ** 2, axis=(1, 2)), 1e-300))


def h1(Sff, Sfx, Sxx, force_noise, response_noise):
    """Least squares, S_fx / S_ff, with the expected noise taken off S_ff (never more than half of it)."""
    diagonal = np.einsum("fjj->fj", Sff).real
    less = np.minimum(force_noise, 0.5 * diagonal)
    freed = Sff - less[:, :, None] * np.eye(len(force_noise))
    return (inverse_of(freed) @ Sfx).transpose(0, 2, 1)


def h2(Sff, Sfx, Sxx, force_noise, response_noise):
    """Least squares with all noise in the force. Not the choice for a hammer, whose response has noise too.

    For one input that is S_xx / S_xf. For several, of each output the smallest error of the forces that explains it (the
    data least squares of [DeGroatDowling1993]_): with v the direction in which the part of S_ff that the response does not
    explain is smallest, H = v S_xx / (S_fx^H v). The forces are scaled by their noise.
    """
    m, outputs = Sfx.shape[1:]
    if m == 1:
        return divide(Sxx, Sfx[:, 0, :].conj())[:, :, None]
    p = np.sqrt(force_noise) if force_noise.min() > 0 else np.sqrt(np.einsum("fjj->fj", Sff).real.mean(axis=0))
    scaled, crossed = Sff / (p[:, None] * p), Sfx / p[:, None]
    H = np.empty((len(Sff), outputs, m), complex)
    for o in range(outputs):
        x = crossed[:, :, o]
        unexplained = scaled - divide(
            x[:, :, None] * x[:, None, :].conj(), np.maximum(Sxx[:, o], 1e-300)[:, None, None]
        )
        v = np.linalg.eigh(unexplained)[1][:, :, 0]
        H[:, o] = divide(v * Sxx[:, o, None], np.sum(x.conj() * v, axis=1)[:, None]) / p
    return H


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
