"""Impact tests, simulated sample by sample, and the FRFs made of them with the covariance of their errors.

A hit is a half-sine in x, y or z; its response at the six sensors is exact; white noise goes on every sample of force and
acceleration. The FRF is estimated three ways from the same hits: by H1 of the records as they are, by H1 behind windows that keep
the pulse and the decay, and by modes fitted to H1. What the hits do not agree upon is the error of H1, line by line.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.errors_in_variables import MatrixError
from millcal.numerics.impact_windows import window
from millcal.numerics.mode_fit import Channels, Model, columns, fit_poles, sensitivity
from millcal.numerics.pole_search import search_poles
from millcal.physics.hammer import Pulse
from millcal.studies.forces_structure import AXES, SENSORS, Structure

SAMPLE_RATE, SAMPLES = 2048.0, 2048  # Hz; records of 1 s, so that lines are 1 Hz apart and every speed falls on one
HITS = 9  # in each direction
PEAK, SPREAD, DURATION = 3400.0, 0.1, 3e-3  # N, relative standard deviation, s
ONSET = 4 / SAMPLE_RATE  # s

FORCE_WINDOW, RESPONSE_WINDOW, FALL = 6e-3, 0.15, 0.2  # s, s, share of the response window that is its cosine end
POOLED = 20  # lines to either side whose residuals are pooled
LINES = 480  # lines that are kept, unless more are wanted

BAND = slice(20, 260)  # lines in which modes are fitted
SEARCHED = slice(40, 141)  # lines in which the search for them begins
MODAL = Model(complex_modes=False, remainder=())


class Hits(NamedTuple):
    """Spectra of the hits in one axis."""

    force: np.ndarray  # complex (hit, line)
    response: np.ndarray  # complex (hit, line, sensor)


class Estimate(NamedTuple):
    """Accelerances of some lines, and what is known of their errors."""

    lines: np.ndarray  # (line,) Hz, ascending
    matrix: np.ndarray  # complex (line, sensor, axis)
    shared: np.ndarray | None = None  # E[Delta Delta^H], axes apart, lines apart: complex (axis, line, sensor, sensor)
    deviations: np.ndarray | None = None  # of a fitted model: (deviation, line, sensor, axis)
    window: np.ndarray | None = None  # of the responses, (sample,)

    def together(self, lines: np.ndarray) -> tuple[np.ndarray, MatrixError]:
        """Lines in any order and as often as wanted, with what their errors have in common.   lines : (line,) Hz

        White noise behind a window w is alike at two lines as the transform of w^2 at their distance, counted from the pulse.
        That of the hammer, whose window is shorter and which matters little, is taken to be alike in the same way.
        """
        matrix, error = self.at(lines)
        if self.shared is None or self.window is None:
            return matrix, error
        apart = np.subtract.outer(lines, lines)
        square = np.fft.fft(self.window**2, SAMPLES)
        alike = square[apart % SAMPLES] / square[0] * np.exp(2j * np.pi * apart * (ONSET + DURATION / 2))
        values, vectors = np.linalg.eigh(self.shared[:, np.searchsorted(self.lines, lines)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))[..., np.newaxis, :] @ vectors.conj().swapaxes(2, 3)
        return matrix, error._replace(shared=np.einsum("lm,alsu,amtu->alsmt", alike, root, root.conj()))

    def at(self, lines: np.ndarray) -> tuple[np.ndarray, MatrixError]:
        """Some of them, as if the errors of each were its own.   lines : (line,) Hz"""
        place = np.searchsorted(self.lines, lines)
        deviations = None if self.deviations is None else self.deviations[:, place]
        if self.shared is None:
            return self.matrix[place], MatrixError(deviations=deviations)
        n = len(lines)
        shared = np.zeros((AXES, n, SENSORS, n, SENSORS), complex)
        each = np.arange(n)
        shared[:, each, :, each, :] = self.shared[:, place].swapaxes(0, 1)
        return self.matrix[place], MatrixError(shared, deviations)


class Sums(NamedTuple):
    """H1 of all lines."""

    matrix: np.ndarray  # complex (line, sensor, axis)
    energy: np.ndarray  # |F|^2 of all hits, (axis, line)
    residual: np.ndarray  # X - H F, complex (axis, line, sensor, hit)


class ImpactTest(NamedTuple):
    """One impact test, estimated three ways."""

    plain: Estimate
    windowed: Estimate
    modal: Estimate | None


class Hammer(NamedTuple):
    """What every hit of a structure has in common: a pulse of 1 N and what follows."""

    force: np.ndarray  # (sample,)
    response: np.ndarray  # (axis, sensor, sample)


def hammer_on(structure: Structure) -> Hammer:
    """The pulse and its response, exact on every line of a record, which is long enough for the structure to come to rest."""
    force = Pulse(ONSET, DURATION, 1.0).force(np.arange(SAMPLES) / SAMPLE_RATE)
    G = structure.accelerance(np.fft.rfftfreq(SAMPLES, 1 / SAMPLE_RATE))
    G[-1] = G[-1].real  # the line at half the sample rate has no phase
    spectra = np.fft.rfft(force)[:, np.newaxis, np.newaxis] * G
    return Hammer(force, np.fft.irfft(spectra, SAMPLES, axis=0).transpose(2, 1, 0))


def impact_test(
    hammer: Hammer,
    sigma_force: float,
    sigma_acceleration: float,
    rng: np.random.Generator,
    lines: np.ndarray,
    *,
    modal: bool = True,
) -> ImpactTest:
    """Nine hits in each direction and the FRFs made of them.

    sigma_... : N and m/s^2, of the noise of a sample   lines : where FRFs are wanted, Hz, ascending
    modal : whether modes are fitted, which takes as long as all else
    """
    return estimates(hits_on(hammer, sigma_force, sigma_acceleration, rng), lines, modal=modal)


def hits_on(
    hammer: Hammer, sigma_force: float, sigma_acceleration: float, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Nine hits in each direction as they are recorded.

    sigma_... : N and m/s^2, of the noise of a sample   returns by axis force (hit, sample) and response (hit, sensor, sample)
    """
    axes = []
    for axis in range(AXES):
        peak = PEAK * (1 + SPREAD * rng.standard_normal(HITS))
        force = peak[:, np.newaxis] * hammer.force + sigma_force * rng.standard_normal((HITS, SAMPLES))
        response = peak[:, np.newaxis, np.newaxis] * hammer.response[axis]
        axes.append((force, response + sigma_acceleration * rng.standard_normal(response.shape)))
    return axes


def estimates(axes: list[tuple[np.ndarray, np.ndarray]], lines: np.ndarray, *, modal: bool = True) -> ImpactTest:
    """The FRFs made of hits.   axes : as `hits_on` gives them   lines, modal : as in `impact_test`"""
    keep, tail = _windows()
    count = max(LINES, int(lines.max(initial=0)) + POOLED + 1)
    plain = [_spectra(force, response, count) for force, response in axes]
    gated = [
        _spectra(force[:, : len(keep)] * keep, response[:, :, : len(tail)] * tail, count) for force, response in axes
    ]
    raw, windowed = h1(plain), h1(gated)
    fitted = fit_modes(raw, windowed, lines) if modal else None
    return ImpactTest(estimate(raw, lines, np.ones(SAMPLES)), estimate(windowed, lines, tail), fitted)


def _windows() -> tuple[np.ndarray, np.ndarray]:
    """Of the force and of the response, as long as they are not zero."""
    pulse, decay = round(FORCE_WINDOW * SAMPLE_RATE), round(RESPONSE_WINDOW * SAMPLE_RATE)
    fall = round(FALL * decay)
    return window(pulse, 0, pulse, 0, 0), window(decay, 0, decay - fall, 0, fall)


def _spectra(force: np.ndarray, response: np.ndarray, count: int) -> Hits:
    """force : (hit, sample)   response : (hit, sensor, sample)   count : of lines"""
    F = np.fft.rfft(force, SAMPLES)[:, :count]
    X = np.fft.rfft(response, SAMPLES)[:, :, :count]
    return Hits(F, X.swapaxes(1, 2))


def h1(axes: list[Hits]) -> Sums:
    """H1 of single inputs, and what is left of each hit."""
    count = axes[0].force.shape[1]
    matrix = np.empty((count, SENSORS, AXES), complex)
    energy, residual = np.empty((AXES, count)), np.empty((AXES, count, SENSORS, HITS), complex)
    for axis, (F, X) in enumerate(axes):
        energy[axis] = np.sum(np.abs(F) ** 2, axis=0)
        matrix[:, :, axis] = np.einsum("hl,hls->ls", F.conj(), X) / energy[axis, :, np.newaxis]
        residual[axis] = np.moveaxis(X - F[:, :, np.newaxis] * matrix[:, :, axis], 0, -1)
    return Sums(matrix, energy, residual)


def estimate(sums: Sums, lines: np.ndarray, window: np.ndarray) -> Estimate:
    """H1 at some lines with the covariance of its errors.   window : of the responses, (sample,)

    The residuals of a line have HITS - 1 degrees of freedom; their covariance is pooled over the lines around, so that a matrix
    of six sensors has full rank, and divided by the energy of all hits in the line.
    """
    around = lines[:, np.newaxis] + np.arange(-POOLED, POOLED + 1)
    seen = np.moveaxis(sums.residual[:, around], 2, 3).reshape(AXES, len(lines), SENSORS, -1)
    spread = seen @ seen.conj().swapaxes(2, 3) / ((HITS - 1) * around.shape[1])
    return Estimate(lines, sums.matrix[lines], spread / sums.energy[:, lines, np.newaxis, np.newaxis], window=window)


def fit_modes(raw: Sums, windowed: Sums, lines: np.ndarray) -> Estimate:
    """Three modes common to all sensors and axes, fitted to H1 of the whole records, and how their errors move the FRF.

    The deviations are the square root of the covariance of poles and residues, each carried to the lines: those of the residues
    at fixed poles, one set for each sensor and axis, then those of the poles, which the residues follow.
    windowed : with less noise, where the search begins
    """
    s = 2j * np.pi * np.arange(LINES)
    tests = []
    for axis in range(AXES):
        energy, values = raw.energy[axis, BAND], raw.matrix[BAND, :, axis]
        spread = np.mean(np.abs(raw.residual[axis, BAND]) ** 2, axis=(0, 2)) * HITS / (HITS - 1)
        rounding = 1e-9 * np.abs(values).max(axis=0) * np.sqrt(energy.mean())
        root = np.sqrt(energy)[:, np.newaxis, np.newaxis]
        noise = np.sqrt(spread / 2) + rounding
        tests.append(Channels(s[BAND], values.T[:, :, np.newaxis], root, noise, np.full(SENSORS, 2), None))
    searched = windowed.matrix[SEARCHED]
    found = search_poles(np.arange(LINES)[SEARCHED], searched, np.ones(searched.shape), [1])
    fit = fit_poles(tests, found.frequency, found.damping, MODAL)
    modes = len(fit.natural_frequency)
    steady = sensitivity(tests, fit, MODAL)
    functions, slopes = columns(
        tests[0]._replace(s=2j * np.pi * lines), fit.natural_frequency, fit.damping_ratio, MODAL
    )
    phi, by_pole = functions[0, :, 0], slopes[:, 0, :, 0]  # (line, mode), (2, line, mode)
    matrix = np.empty((len(lines), SENSORS, AXES), complex)
    of_residues = np.zeros((AXES, SENSORS, modes, len(lines), SENSORS, AXES), complex)
    of_poles = np.empty((2 * modes, len(lines), SENSORS, AXES), complex)
    root = np.linalg.cholesky(steady.inverse)
    for axis, (linear, part) in enumerate(zip(fit.linear, steady.parts, strict=True)):
        matrix[:, :, axis] = phi @ linear.T
        free = np.linalg.inv(part.triangle * part.scale[:, np.newaxis])  # of the residues, (sensor, mode, mode)
        following = free @ np.swapaxes(part.basis, 1, 2) @ part.slope  # (sensor, mode, 2 mode)
        moved = np.einsum("dlm,sm->sldm", by_pole, linear).reshape(SENSORS, len(lines), 2 * modes)
        of_poles[..., axis] = np.moveaxis((moved - phi @ following) @ root, 2, 0).swapaxes(1, 2)
        each = np.arange(SENSORS)
        of_residues[axis, each, :, :, each, axis] = np.swapaxes(phi @ free, 1, 2)
    deviations = np.concatenate([of_residues.reshape(-1, *matrix.shape), of_poles])
    return Estimate(lines, matrix, deviations=deviations)
