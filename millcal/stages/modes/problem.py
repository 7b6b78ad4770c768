"""An FRF as the least-squares problem of its modes: the form that was measured, whitened, with what its windows lost.

Each group of hits that was estimated together is one test with its own windows. An FRF of another program says nothing of
its hits: then its variance or coherence gives the weights, or the scatter between neighbouring lines where it has neither.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from millcal.data import Frf, HitSpectra
from millcal.errors import IllPosedError
from millcal.numerics.modal_basis import plan_loss
from millcal.numerics.mode_fit import Channels
from millcal.physics.structure import DERIVATIVES, convert_frf, convert_frf_variance

FEWEST_LINES = 16
FORCE_NOISE = 2.0  # times what noise of the force leaves on average: smooth over a resonance, it averages little
ROUNDING = 1e-6  # share of the largest value of a pair that no other program's digits tell
USUAL_HITS = 5  # where a file has coherence and does not say of how many hits
SILENT = 1e-8  # noise below this share of the response is rounding, and says nothing of the weights


@dataclass(frozen=True, eq=False)
class Test:
    """One test of an FRF: which entries it holds, and what a fit asks of it."""

    channels: Channels
    rows: np.ndarray  # outputs of the FRF, (output, 1)
    columns: np.ndarray  # inputs, (1, input); or (output, 1) where each of the test's outputs is a pair of its own
    spectra: HitSpectra | None = None
    force: np.ndarray | None = None  # F_h(s), complex (hit, input, line)
    power: np.ndarray | None = None  # sum of F F^H without its noise, (line, input, input)
    turn: np.ndarray | None = None  # e^{s tau} by which delays were taken out of the values, complex (output, line)

    def put(self, matrix: np.ndarray, values: np.ndarray) -> None:
        """Write values (..., output, input) of this test to their places in a matrix (..., output, input) of the FRF."""
        matrix[..., self.rows, self.columns] = values


@dataclass(frozen=True, eq=False)
class Problem:
    """All tests of an FRF on the lines of the fit."""

    tests: tuple[Test, ...]
    lines: np.ndarray  # indices among the lines of the FRF
    frequency: np.ndarray  # (line,) Hz
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def channels(self) -> tuple[Channels, ...]:
        return tuple(test.channels for test in self.tests)

    def empty(self, *leading: int, dtype: type = complex) -> np.ndarray:
        """A matrix of nan over all outputs and inputs, for tests to put theirs in.   returns (..., output, input)"""
        return np.full((*leading, len(self.outputs), len(self.inputs)), np.nan, dtype)

    def without_losses(self) -> "Problem":
        """The same as if no window had taken anything away."""
        tests = (replace(test, channels=test.channels._replace(loss=None)) for test in self.tests)
        return replace(self, tests=tuple(tests))

    def turned(self, delay: np.ndarray) -> "Problem":
        """The same with delays taken out of the values.   delay : (output,) s, of the response behind the force"""
        return replace(self, tests=tuple(_turned(test, np.nan_to_num(delay)) for test in self.tests))


def _turned(test: Test, delay: np.ndarray) -> Test:
    channels = test.channels
    turn = np.exp(channels.s * delay[test.rows[:, 0]][:, None])
    return replace(test, channels=channels._replace(values=channels.values * turn[:, :, None]), turn=turn)


def forms_of(frf: Frf) -> tuple[str, ...]:
    """The form in which each output was measured; that of the FRF where nothing is known of its hits."""
    found = dict.fromkeys(frf.outputs, frf.form)
    for test in frf.tests:
        found.update(zip(test.outputs, test.forms, strict=True))
    return tuple(found[output] for output in frf.outputs)


def measured_values(frf: Frf, lines: np.ndarray) -> np.ndarray:
    """Values of some lines in the form each output was measured in.   returns complex (line, output, input)"""
    forms = forms_of(frf)
    return converted(frf.frequency[lines], frf.values[lines], [frf.form] * len(forms), forms)


def converted(frequency: np.ndarray, values: np.ndarray, forms: Sequence[str], to: Sequence[str]) -> np.ndarray:
    """Values with each output in another form.   values : complex (line, output, input)   forms, to : of each output"""
    out = np.array(values)
    for row, (form, wanted) in enumerate(zip(forms, to, strict=True)):
        if form != wanted:
            out[:, row] = convert_frf(frequency, out[:, row], form, wanted)
    return out


def lines_of(frf: Frf, band: tuple[float, float] | None) -> np.ndarray:
    """Lines within the band, the usable one when none is given, that hold values."""
    low, high = band or frf.usable_band
    measured = np.isfinite(frf.values).any(axis=(1, 2)) & (frf.frequency > 0)
    lines = np.flatnonzero(measured & (frf.frequency >= low) & (frf.frequency <= high))
    if len(lines) and not np.nan_to_num(frf.values[lines]).any():
        raise IllPosedError(f"modes: every value between {low:g} and {high:g} Hz is zero; check the channels")
    if len(lines) < FEWEST_LINES:
        raise IllPosedError(
            f"modes: {len(lines)} lines between {low:g} and {high:g} Hz; give a band within "
            f"{frf.frequency[0]:g} to {frf.frequency[-1]:g} Hz, or measure longer"
        )
    return lines


def stride_of(frf: Frf) -> int:
    """How many lines may be passed over: lines closer than one over the longest window say nothing new."""
    if not frf.tests or len(frf.frequency) < 2:
        return 1
    points = frf.tests[0].sample_rate / (frf.frequency[1] - frf.frequency[0])
    longest = max(int((test.window_stop + test.window_fall).max()) for test in frf.tests)
    return max(1, int(points / longest))


def problem_of(frf: Frf, lines: np.ndarray) -> Problem:
    """The problem on some lines."""
    frequency = frf.frequency[lines]
    s = frf.damping_shift + 2j * np.pi * frequency
    values = measured_values(frf, lines)
    power = np.array([DERIVATIVES[form] for form in forms_of(frf)])
    if frf.tests:
        tests = tuple(_of_hits(frf, spectra, s, values, power) for spectra in frf.tests)
    else:
        tests = (_of_lines(frf, lines, s, values, power),)
    return Problem(tests, lines, frequency, frf.outputs, frf.inputs)


def _of_hits(frf: Frf, spectra: HitSpectra, s: np.ndarray, values: np.ndarray, power: np.ndarray) -> Test:
    rows = tuple(frf.outputs.index(output) for output in spectra.outputs)
    columns = tuple(frf.inputs.index(given) for given in spectra.inputs)
    interval = 1.0 / spectra.sample_rate
    force = force_spectra(spectra, s, frf.frequency)
    P = np.einsum("hil,hjl->lij", force, force.conj())
    own = np.arange(len(columns))
    P[:, own, own] -= np.minimum(spectra.force_noise, 0.5 * P[:, own, own].real)
    mixing = np.einsum("hil,lij->hjl", force.conj(), np.linalg.inv(P))
    loss = plan_loss(s, spectra.force, spectra.force_start, spectra.window_stop, spectra.window_fall, mixing, interval)
    noise = _noise_of_hits(spectra)
    own_values = values[:, rows][:, :, columns].transpose(1, 0, 2)
    carried = np.einsum("oli,i->o", np.abs(own_values) ** 2, spectra.force_noise / len(force))
    excess = FORCE_NOISE * len(columns) * float(np.sum(carried / noise**2))
    channels = Channels(s, own_values, np.linalg.cholesky(P), noise, power[list(rows)], loss, excess)
    return Test(channels, np.array(rows)[:, None], np.array(columns)[None], spectra, force, P)


def _noise_of_hits(spectra: HitSpectra) -> np.ndarray:
    """Noise of each response in each part of a line, that of rounding where one has no noise.   returns (output,)"""
    size = np.sqrt(np.mean(np.abs(spectra.response) ** 2, axis=(0, 2)))
    noise = np.sqrt(0.5 * spectra.response_noise)
    alive = size > 0
    if not (noise[alive] > SILENT * size[alive]).all():
        noise = SILENT * size
    return np.where(alive, noise, noise.max(initial=0.0))


def force_spectra(spectra: HitSpectra, s: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Spectra of the pulses, with the record's origin as time zero.

    s : (line,) of the lines wanted   frequency : (frequency,) Hz, all lines of the FRF   returns complex (hit, input, line)
    """
    interval = 1.0 / spectra.sample_rate
    step = frequency[1] - frequency[0]
    points = round(spectra.sample_rate / step)
    at = np.rint(s.imag / (2 * np.pi * step)).astype(int)
    fading = np.exp(-s[0].real * interval * np.arange(spectra.force.shape[2]))
    plain = np.fft.rfft(spectra.force * fading, points)[:, :, at]
    return plain * np.exp(-s * interval * spectra.force_start[:, None])[:, None]


def _of_lines(frf: Frf, lines: np.ndarray, s: np.ndarray, values: np.ndarray, power: np.ndarray) -> Test:
    """All pairs as one test, each pair a channel of its own, weighted by what is known of its noise."""
    rows, columns = np.nonzero(np.isfinite(values).all(axis=0))
    if not values[:, rows, columns].any():
        raise IllPosedError("modes: no pair of output and input has values on all lines of the band; narrow the band")
    frequency = frf.frequency[lines]
    alive = values[:, rows, columns].any(axis=0)
    noise = [_noise(frf, lines, o, i, values[:, o, i]) for o, i in zip(rows[alive], columns[alive], strict=True)]
    slope = float(np.mean([own.slope for own in noise]))
    middle = np.exp(np.mean(np.log(frequency)))
    root = (frequency / middle) ** -slope
    level = np.full(len(rows), max(own.level for own in noise))  # also of a pair that never moves
    level[alive] = [own.level for own in noise]
    level *= np.sqrt(0.5)  # of each part
    beyond = sum(float(np.sum(2.0 * (own.variance * root**2 / own.level**2 - 1.0))) for own in noise if own.measured)
    excess = FORCE_NOISE * max(beyond, 0.0)
    channels = Channels(
        s, values[:, rows, columns].T[:, :, None], root[:, None, None], level, power[rows], None, excess
    )
    return Test(channels, rows[:, None], columns[:, None])


class _Noise(NamedTuple):
    """Noise of the lines of a pair."""

    slope: float  # power of the frequency
    level: float  # standard deviation at the middle of the band
    variance: np.ndarray  # (line,)
    measured: bool  # the variance has in it what scatters no lines, the noise of the hammer


def _noise(frf: Frf, lines: np.ndarray, o: int, i: int, values: np.ndarray) -> _Noise:
    """Noise of the lines of a pair: from the FRF's variance or coherence, or from the scatter about neighbours.

    Each is noisy itself, and larger where a resonance is, so that a power of the frequency is laid through its medians: an
    accelerometer's white noise falls with the square of the frequency in a receptance.
    """
    frequency = frf.frequency[lines]
    variance, measured = _variance(frf, lines, o, i, values)
    floor = (ROUNDING * np.abs(values).max()) ** 2
    parts = np.array_split(np.arange(len(lines)), min(12, len(lines) // 4))
    level = [0.5 * np.log(max(float(np.median(variance[part])), floor)) for part in parts]
    middle = np.array([np.log(float(np.median(frequency[part]))) for part in parts])
    slope, offset = np.polyfit(middle - np.mean(np.log(frequency)), level, 1)
    return _Noise(float(slope), float(np.exp(offset)), variance, measured)


def _variance(frf: Frf, lines: np.ndarray, o: int, i: int, values: np.ndarray) -> tuple[np.ndarray, bool]:
    """Variance of the lines of a pair, and whether it was measured.   returns (line,)

    From coherence it is |H|^2 (1 - g^2) / (g^2 (n - 1)) for n hits; files of other programs do not say how many.
    """
    if frf.variance is not None and np.isfinite(frf.variance[lines, o, i]).all():
        own = frf.variance[lines, o, i]
        return convert_frf_variance(frf.frequency[lines], own, frf.form, forms_of(frf)[o]), True
    if frf.coherence is not None:
        coherence = frf.coherence[lines, o, i]
        if np.median(coherence) < 1.0:  # it is 1 of a single hit, and nan where it was not measured
            hits = frf.hits_used[i] if frf.hits_used[i] > 1 else USUAL_HITS
            return np.abs(values) ** 2 * (1.0 / np.maximum(coherence, 1e-3) - 1.0) / (hits - 1), True
    bend = np.abs(np.diff(values, 2)) ** 2 / 6.0  # E|second difference|^2 of white noise is six times its variance
    return np.concatenate([bend[:1], bend, bend[-1:]]), False
