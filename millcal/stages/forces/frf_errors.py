"""A measured FRF at the lines of cuts, and its errors there, from the scatter of the hits.

The error of H1 is the hits' residual over the power of their forces. Its covariance between the sensors is that of the
residuals, pooled over neighbouring lines; between two lines it is the transform of the squared response window, because noise
that a window cut short is alike at lines closer than one over its length.

No scatter shows what all hits have in common: the tail of the decay that the window cut off. It ends where the decay is 15 dB
below the noise of the hits' mean, which is 0.18 of its standard deviation, after some five and a half time constants; the
sum over the tail is then at most 0.18 T / 11 for a window of T samples, beside the noise's sqrt(T).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from millcal.data import Frf, HitSpectra
from millcal.numerics.errors_in_variables import MatrixError
from millcal.physics.structure import convert_frf, convert_frf_variance

POOLED = 16  # independent lines to either side
BENT = 0.004  # of a value: what windows, the ends of the records and interpolation bend, where no noise is seen
CUT_OFF = 0.016  # 10^(-15/20) / 11: see above
USUAL_HITS = 5  # where a file has coherence and does not say of how many hits
FALL = (3 / 8, 1 / 2, 1 / 8)  # (1 + cos)^2 / 4 in cosines of 0, 1 and 2 times


def frf_at(frf: Frf, frequency: np.ndarray, rows: np.ndarray, columns: list[int]) -> np.ndarray:
    """Accelerance at any frequencies within the band, by cubic splines through the lines.

    frequency : (line,) Hz   rows, columns : outputs and inputs   returns complex (line, row, column)
    """
    from scipy.interpolate import CubicSpline

    near = _near(frf, frequency)
    values = frf.values[near][:, rows][:, :, columns]
    at = CubicSpline(frf.frequency[near], values, axis=0)(frequency)
    return convert_frf(frequency, at, frf.form, "accelerance")


def _near(frf: Frf, frequency: np.ndarray) -> np.ndarray:
    """Lines of the FRF about these frequencies, without 0 Hz."""
    step = frf.frequency[1] - frf.frequency[0]
    low, high = frequency.min() - 8 * step, frequency.max() + 8 * step
    return np.flatnonzero((frf.frequency > 0) & (frf.frequency >= low) & (frf.frequency <= high))


class _ColumnError(NamedTuple):
    """Errors of one column of the FRF."""

    covariance: np.ndarray  # complex (line, row, row), E[d d^H]
    alike: np.ndarray  # complex (line, line), correlation between lines


def measured_error(
    frf: Frf,
    frequency: np.ndarray,
    rows: np.ndarray,
    columns: list[int],
    matrix: np.ndarray,
    note: Callable[..., None],
) -> tuple[MatrixError, np.ndarray]:
    """Covariance of the accelerance between sensors and lines, and the variance of each entry.

    matrix : the accelerance itself, (line, row, column)   returns the errors, and (line, row, column)
    """
    lines, n = len(frequency), len(rows)
    shared = np.zeros((len(columns), lines, n, lines, n), complex)
    variance = np.zeros((lines, n, len(columns)))
    silent = []
    for c, column in enumerate(columns):
        own = _of_hits(frf, frequency, rows, column)
        own = _of_file(frf, frequency, rows, column) if own is None else own
        if own is None:
            silent.append(frf.inputs[column])
        covariance = np.zeros((lines, n, n), complex) if own is None else own.covariance
        alike = _triangle(frf, frequency) if own is None else own.alike
        bent = BENT**2 * np.mean(np.abs(matrix[:, :, c]) ** 2, axis=1)
        covariance = covariance + bent[:, None, None] * np.eye(n)
        root = _root(covariance)
        shared[c] = np.einsum("lm,lsu,mtu->lsmt", alike, root, root.conj())
        variance[:, :, c] = np.einsum("lss->ls", covariance).real
    if silent:
        note(
            "frf-without-variance",
            f"the FRF says nothing of its noise at {', '.join(silent)}: only that of the cut is in the intervals, which are too "
            "narrow; estimate the FRF from its hits with 'millcal frf'",
        )
    return MatrixError(shared=shared), variance


def _root(covariance: np.ndarray) -> np.ndarray:
    """Hermitian roots.   covariance : (line, n, n)"""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ vectors.conj().transpose(0, 2, 1)


def _of_hits(frf: Frf, frequency: np.ndarray, rows: np.ndarray, column: int) -> _ColumnError | None:
    """From the hits in that direction; None where some of the outputs are not among theirs."""
    covariance = np.zeros((len(frequency), len(rows), len(rows)), complex)
    alike = np.eye(len(frequency), dtype=complex)
    places = {frf.outputs[int(row)]: i for i, row in enumerate(rows)}
    covered: set[str] = set()
    for test in frf.tests:
        if frf.inputs[column] not in test.inputs:
            continue
        kept = [i for i, output in enumerate(test.outputs) if output in places]
        if not kept:
            continue
        covered |= {test.outputs[i] for i in kept}
        found = _residual_covariance(frf, test, frequency, column, kept)
        at = np.array([places[test.outputs[i]] for i in kept])
        covariance[:, at[:, None], at[None]] = found
        alike = window_correlation(test, frequency)
    return _ColumnError(covariance, alike) if covered == set(places) else None


def _residual_covariance(frf: Frf, test: HitSpectra, frequency: np.ndarray, column: int, kept: list[int]) -> np.ndarray:
    """Covariance of a column of the accelerance.   kept : outputs of the test   returns complex (line, kept, kept)"""
    step = frf.frequency[1] - frf.frequency[0]
    hits, inputs = len(test.names), len(test.inputs)
    own = test.inputs.index(frf.inputs[column])
    columns = [frf.inputs.index(name) for name in test.inputs]
    rows = [frf.outputs.index(test.outputs[i]) for i in kept]
    length = float((test.window_stop + test.window_fall).mean())
    stride = max(1, round(test.sample_rate / step / length))  # lines closer than this are alike
    first, last = test.first_line, test.first_line + test.response.shape[2] - 1
    result = np.empty((len(frequency), len(kept), len(kept)), complex)
    forms = [test.forms[i] for i in kept]
    for number, f in enumerate(frequency):
        centre = round(f / step)
        lines = centre + stride * np.arange(-POOLED, POOLED + 1)
        lines = lines[(lines >= max(first, 1)) & (lines <= last)]
        at = frf.frequency[lines]
        s = frf.damping_shift + 2j * np.pi * at
        F = _force_spectra(test, s)  # (hit, input, line)
        P = np.einsum("hil,hjl->lij", F, F.conj())
        inverse = np.linalg.inv(P)[:, own, own].real  # (line,)
        X = test.response[:, kept][:, :, lines - first].astype(complex)
        H = frf.values[lines][:, rows][:, :, columns]
        for i, form in enumerate(forms):
            if form != frf.form:
                H[:, i] = convert_frf(at, H[:, i], frf.form, form)
        if hits - inputs >= 2:
            residual = X - np.einsum("loi,hil->hol", H, F)
            scatter = np.einsum("hol,hpl,l->op", residual, residual.conj(), inverse) / (len(lines) * (hits - inputs))
        else:
            scatter = np.diag(test.response_noise[kept]).astype(complex) * float(np.mean(inverse))
        factor = np.array([convert_frf(np.array([f]), np.ones(1, complex), form, "accelerance")[0] for form in forms])
        result[number] = scatter * np.outer(factor, factor.conj())
    return result * (1 + CUT_OFF**2 * length)


def _force_spectra(test: HitSpectra, s: np.ndarray) -> np.ndarray:
    """Spectra of the pulses at any s, with the record's origin as time zero.   returns complex (hit, input, line)"""
    time = (test.force_start[:, None] + np.arange(test.force.shape[2])) / test.sample_rate  # (hit, sample)
    return np.einsum("his,hsl->hil", test.force, np.exp(-time[:, :, None] * s))


def window_correlation(test: HitSpectra, frequency: np.ndarray) -> np.ndarray:
    """How alike the errors at two lines are: the transform of the squared window, counted from the pulse.

    frequency : (line,) Hz   returns complex (line, line)
    """
    apart, place = np.unique(np.round(frequency[:, None] - frequency[None], 9), return_inverse=True)
    return _transform(test, apart)[place].reshape(len(frequency), len(frequency))


def _transform(test: HitSpectra, apart: np.ndarray) -> np.ndarray:
    """Of the squared response window, counted from the pulse, 1 at 0.   apart : (n,) Hz   returns complex (n,)"""
    begin = float(test.force_start.mean())  # of both windows
    weight = np.abs(test.force).sum(axis=(0, 1))
    pulse = float(weight @ np.arange(len(weight)) / weight.sum())  # after that
    stop, fall = float(test.window_stop.mean()) - begin, float(test.window_fall.mean())
    rate = 2 * np.pi * np.asarray(apart) / test.sample_rate  # rad per sample
    total = _integral(rate, 0.0, stop)
    whole = stop
    for order, share in enumerate(FALL):  # the square of half a cosine from 1 to 0 is a sum of three cosines
        own = order * np.pi / max(fall, 1e-9)
        for turn in (own, -own):
            total += share / 2 * np.exp(-1j * turn * stop) * _integral(rate - turn, stop, stop + fall)
    whole += FALL[0] * fall
    return np.asarray(total * np.exp(1j * rate * pulse) / whole)


def _integral(rate: np.ndarray, low: float, high: float) -> np.ndarray:
    """Of exp(-j rate x) from low to high."""
    middle, length = (low + high) / 2, high - low
    return np.asarray(length * np.exp(-1j * rate * middle) * np.sinc(rate * length / (2 * np.pi)))


def independent_lines(variance: np.ndarray, frf: Frf, frequency: np.ndarray) -> np.ndarray:
    """Errors of the entries apart from each other, alike only at lines that are one.

    variance : (line, row, column)   returns (column, line, row, line, row)
    """
    lines, rows, columns = variance.shape
    root = np.sqrt(variance)
    alike = _triangle(frf, frequency)
    shared = np.zeros((columns, lines, rows, lines, rows), complex)
    at = np.arange(rows)
    for c in range(columns):
        shared[c][:, at, :, at] = alike * np.einsum("ls,ms->slm", root[:, :, c], root[:, :, c])
    return shared


def alike_lines(frf: Frf, frequency: np.ndarray, first: int) -> np.ndarray:
    """How alike the errors of the FRF are between the first lines and the others, by its windows or its spacing.

    frequency : (line,) Hz   returns complex (first, line - first)
    """
    step = frf.frequency[1] - frf.frequency[0]
    apart = frequency[:first, None] - frequency[None, first:]
    if not frf.tests:
        return np.maximum(0.0, 1.0 - np.abs(apart) / step).astype(complex)
    found, place = np.unique(np.round(np.abs(apart), 3), return_inverse=True)
    return np.asarray(_transform(frf.tests[0], found)[place].reshape(apart.shape))


def _triangle(frf: Frf, frequency: np.ndarray) -> np.ndarray:
    """Correlation of lines of an FRF of which only the lines are known: one line apart is independent."""
    step = frf.frequency[1] - frf.frequency[0]
    return np.maximum(0.0, 1.0 - np.abs(frequency[:, None] - frequency[None]) / step).astype(complex)


def _of_file(frf: Frf, frequency: np.ndarray, rows: np.ndarray, column: int) -> _ColumnError | None:
    """From the variance or the coherence in the file; None where it has neither."""
    variance = None
    if frf.variance is not None:
        variance = frf.variance[:, rows, column]
    elif frf.coherence is not None and np.nanmedian(frf.coherence[:, rows, column]) < 1.0:
        hits = frf.hits_used[column] if frf.hits_used[column] > 1 else USUAL_HITS
        coherence = np.maximum(frf.coherence[:, rows, column], 1e-3)
        variance = np.abs(frf.values[:, rows, column]) ** 2 * (1 / coherence - 1) / (hits - 1)
    if variance is None or not np.isfinite(variance[_near(frf, frequency)]).all():
        return None
    step = frf.frequency[1] - frf.frequency[0]
    result = np.zeros((len(frequency), len(rows), len(rows)), complex)
    at = np.arange(len(rows))
    for number, f in enumerate(frequency):
        near = np.abs(frf.frequency - f) <= (POOLED + 0.5) * step
        near &= frf.frequency > 0
        pooled = np.mean(convert_frf_variance(frf.frequency[near], variance[near], frf.form, "accelerance"), axis=0)
        result[number, at, at] = pooled
    return _ColumnError(result, _triangle(frf, frequency))
