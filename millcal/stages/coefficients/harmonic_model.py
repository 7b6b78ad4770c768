"""The model of the instantaneous fit: harmonics of the spindle in the force of each cut, from few unknowns.

    Y_f(k) = G(k) e^{j k phase_f} B_f(k; c0, s0, t0, m) q + noise

q are the linear coefficients; c0 and s0 the runout, t0 its taper along the axis, m the exponents of Kienzle's law, phase_f
the spindle angle of record f at its first sample. G is the sensor: 1, a measured transmissibility, or (as a diagnostic only)
one mode per axis of static gain 1 whose frequency, damping and residue are unknowns as well.

Runout. The cutter's axis is offset in parallel, so tooth j at height z reaches out by c0 cos(.) - s0 sin(.) of its own angle
on the cutter, helix included; (c0, s0) = rho (cos, sin)(lambda) at mid depth. Two teeth show c0 alone and s0 is taken as 0,
unless the helix winds by half a radian over the depth; with equal pitch their labels may be exchanged, so c0 >= 0. Three
teeth or more show both.

The unit of a record is its harmonics, the mean included, so the noise of 150 000 samples is left behind at the door; by
Parseval the fit equals least squares in time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from millcal.data import CutForce
from millcal.numerics.separable_least_squares import separable_least_squares
from millcal.physics.cutting_force import force_basis, kienzle_functions, linear_edge_functions

LARGEST_RUNOUT = 80e-6  # m
RISE = (-0.3, 0.98)  # bounds of Kienzle's exponents
WINDING = 0.5  # rad of helix lag over the depth, from which two teeth show both parts of the runout
LEAST_LEVEL = 0.1  # of the loudest axis: an axis with less force weighs as if it had this much
RESIDUE_RIDGE = 0.05  # pulls the residue of a fitted sensor mode towards that of a plain resonator, 1

Sensor = Callable[[np.ndarray], np.ndarray]  # frequency (k,) Hz -> (axis, axis, k)


@dataclass(frozen=True, eq=False)
class HarmonicModel:
    """What is asked: cuts, law, unknowns, band and weights."""

    cuts: tuple[CutForce, ...]
    law: str  # linear-edge, kienzle
    band: int  # highest harmonic used
    mean_weight: float  # of the mean force against a harmonic
    weight: np.ndarray  # (axis,) 1/N
    taper: bool = False
    common_phase: bool = False  # the records carry a once-per-revolution pulse: one angle for all
    sensor: Sensor | None = None
    sensor_modes: tuple[float, ...] = ()  # Hz, starting frequency of one fitted mode per axis; empty: none
    held: np.ndarray | None = None  # linear coefficients taken from elsewhere, for a comparison
    memo: dict[tuple, np.ndarray] = field(
        default_factory=dict, repr=False
    )  # unit forces, shared by variants of one question

    @property
    def runout_names(self) -> tuple[str, ...]:
        cutter = self.cuts[0].cutter
        if cutter.teeth == 1:
            return ()
        winding = min(float(cutter.helix_lag(np.array(cut.conditions.axial_depth))) for cut in self.cuts)
        both = cutter.teeth > 2 or winding > WINDING
        return ("c0", *(("s0",) if both else ()), *(("t0",) if self.taper else ()))

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Unknowns that shape the force, before those of sensor and phase."""
        return self.runout_names + (("mt", "mr", "ma") if self.law == "kienzle" else ())

    def without(self, index: int) -> "HarmonicModel":
        """The same question with one cut left out."""
        return replace(self, cuts=self.cuts[:index] + self.cuts[index + 1 :])


def model_of(cuts: tuple[CutForce, ...], *, law: str, band: int, mean_weight: float, **options: Any) -> HarmonicModel:
    """The question with each axis weighted by its own AC force, and one phase for all where the records carry a pulse."""
    level = np.sqrt(np.mean([np.sum(np.abs(cut.harmonics[:, 1:]) ** 2, axis=1) / 2 for cut in cuts], axis=0))
    weight = 1 / np.maximum(level, max(LEAST_LEVEL * level.max(), 1e-300))
    pulse = all(cut.phase_from_pulse for cut in cuts)
    return HarmonicModel(cuts, law, band, mean_weight, weight, common_phase=pulse, **options)


@dataclass(frozen=True, eq=False)
class HarmonicFit:
    """The answer: unknowns and what they cost."""

    model: HarmonicModel
    shape: np.ndarray  # in the order of shape_names, SI
    sensor: np.ndarray  # frequency (3), damping (3), residue (3) of the fitted modes, or empty
    phase: np.ndarray  # (cut,) rad
    linear: np.ndarray  # Ktc Krc Kac Kte Kre Kae, or kt kr ka
    cost: float


def symmetric_labels(model: HarmonicModel) -> bool:
    """Whether exchanging the two teeth changes nothing but the sign of c0."""
    cutter = model.cuts[0].cutter
    return cutter.teeth == 2 and (cutter.pitch is None or abs(cutter.pitch[0] - np.pi) < 1e-9)


def unit_force(model: HarmonicModel, cut: CutForce, shape: np.ndarray, band: int) -> np.ndarray:
    """Harmonics of the force on the tool per unit of each linear coefficient, at phase 0, before any sensor.

    shape : in the order of shape_names   returns complex (axis, coefficient, k)
    """
    key = (id(cut), model.law, band, model.shape_names, shape.tobytes())
    if key not in model.memo:
        if len(model.memo) > 5000:
            model.memo.clear()
        model.memo[key] = _unit_force(model, cut, shape, band)
    return model.memo[key]


def _unit_force(model: HarmonicModel, cut: CutForce, shape: np.ndarray, band: int) -> np.ndarray:
    value = dict(zip(model.shape_names, shape, strict=True))
    cutter, depth = cut.cutter, cut.conditions.axial_depth
    lag = cutter.tooth_lag()[:, np.newaxis]
    c0, s0, t0 = (value.get(name, 0.0) for name in ("c0", "s0", "t0"))

    def offset(height: np.ndarray) -> np.ndarray:
        turn = lag + cutter.helix_lag(height - depth / 2)
        return (c0 + t0 * (height / depth - 0.5)) * np.cos(turn) - s0 * np.sin(turn)

    if model.law == "kienzle":
        rise = np.array([value["mt"], value["mr"], value["ma"]])
        basis = force_basis(kienzle_functions(rise), cutter, cut.conditions, band, offset=offset)
        return np.stack([basis[:, d, d] for d in range(3)], axis=1)
    basis = force_basis(linear_edge_functions, cutter, cut.conditions, band, offset=offset)
    return basis[:, :, ::-1].transpose(0, 2, 1, 3).reshape(3, 6, -1)  # cutting before edge


def sensor_gain(model: HarmonicModel, cut: CutForce, values: np.ndarray, band: int) -> np.ndarray | None:
    """Transmissibility at the harmonics of a cut's spindle, or None where the sensor is taken as perfect.

    returns complex (axis, axis, k)
    """
    frequency = np.arange(band + 1) * cut.spindle_frequency
    gain = None if model.sensor is None else model.sensor(frequency)
    if model.sensor_modes:
        natural, damping, residue = (part[:, np.newaxis] for part in values.reshape(3, 3))
        w2 = frequency**2  # static gain exactly 1: D = w^2 / (wr^2 - w^2 + 2 j zeta wr w)
        own = 1 + residue * w2 / (natural**2 - w2 + 2j * damping * natural * frequency)
        own = np.einsum("ik,ij->ijk", own, np.eye(3))
        gain = own if gain is None else np.einsum("ijk,jlk->ilk", own, gain)
    return gain


def modelled_harmonics(fit: HarmonicFit, cut: CutForce, phase: float, band: int) -> np.ndarray:
    """What the fit says of a cut, of the fit or left out of it.   returns complex (axis, k) N"""
    force = np.einsum("aqk,q->ak", unit_force(fit.model, cut, fit.shape, band), fit.linear)
    gain = sensor_gain(fit.model, cut, fit.sensor, band)
    force = force if gain is None else np.einsum("ijk,jk->ik", gain, force)
    return force * np.exp(1j * np.arange(band + 1) * phase)


def rows_of_harmonics(model: HarmonicModel, harmonics: np.ndarray) -> np.ndarray:
    """Complex harmonics as weighted real rows: the mean, then Re and Im over sqrt 2 (Parseval).   (axis, k, ...) -> (rows, ...)"""
    factor = np.concatenate([[model.mean_weight], np.full(model.band, np.sqrt(0.5))])
    weighted = harmonics * (model.weight[:, np.newaxis] * factor).reshape(3, -1, *[1] * (harmonics.ndim - 2))
    real, imag = weighted.real, weighted[:, 1:].imag
    return np.concatenate([real.reshape(-1, *real.shape[2:]), imag.reshape(-1, *imag.shape[2:])])


def scan_phase(model: HarmonicModel, measured: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> float:
    """The spindle angle that turns the prediction best onto the measurement, by a scan of the circle and Newton steps.

    measured, predicted : complex (axis, k) each, several to share one angle   returns rad
    """
    order = np.arange(model.band + 1)
    overlap = sum(
        np.einsum("i,ik,ik->k", model.weight**2, y.conj()[:, : model.band + 1], x[:, : model.band + 1])
        for y, x in zip(measured, predicted, strict=True)
    )
    overlap[0] = 0.0
    n = max(120, 24 * (model.band + 1))
    angle = 2 * np.pi * np.arange(n) / n
    score = np.real(np.exp(1j * np.outer(angle, order)) @ overlap)
    best = float(angle[np.argmax(score)])
    for _ in range(5):
        turn = overlap * np.exp(1j * order * best)
        slope, bend = -np.sum(order * turn.imag), -np.sum(order**2 * turn.real)
        if bend >= 0:
            break
        best -= float(np.clip(slope / bend, -np.pi / n, np.pi / n))
    return float(best)


def scan_phases(fit: HarmonicFit) -> np.ndarray:
    """The angle of every record, or the one they share, for given coefficients.   returns (cut,) rad"""
    model = fit.model
    predicted = [modelled_harmonics(fit, cut, 0.0, model.band) for cut in model.cuts]
    measured = [cut.harmonics for cut in model.cuts]
    if model.common_phase:
        return np.full(len(model.cuts), scan_phase(model, measured, predicted))
    return np.array([scan_phase(model, [y], [x]) for y, x in zip(measured, predicted, strict=True)])


class Problem(NamedTuple):
    """The fit as separable least squares; unknowns p are shape, sensor, phase."""

    data: np.ndarray  # (rows,)
    noise: np.ndarray  # variance of each row, (rows,)
    matrix: Callable[[np.ndarray], np.ndarray]  # p -> (rows, q)
    derivative: Callable[[np.ndarray, np.ndarray], np.ndarray]  # p, q -> (rows, p)
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    pull: np.ndarray


def problem(model: HarmonicModel) -> Problem:
    """Data, model matrix and slopes in weighted real rows."""
    band, cuts = model.band, model.cuts
    order = np.arange(band + 1)
    n_shape, n_sensor = len(model.shape_names), 3 * len(model.sensor_modes)
    n_phase = 1 if model.common_phase else len(cuts)
    lower, upper, scale = _limits(model, n_phase)
    pull = np.zeros(len(scale))
    pull[n_shape + 2 * n_sensor // 3 : n_shape + n_sensor] = RESIDUE_RIDGE
    data = np.concatenate([rows_of_harmonics(model, cut.harmonics[:, : band + 1]) for cut in cuts])
    spread = [np.sqrt(cut.harmonics_variance[:, : band + 1] / 2) * (1 + 1j) for cut in cuts]
    for value in spread:
        value[:, 0] *= np.sqrt(2)  # the whole variance of the mean is real
    noise = np.concatenate([rows_of_harmonics(model, value) for value in spread]) ** 2

    def seen(p: np.ndarray) -> list[np.ndarray]:
        phases = np.broadcast_to(p[n_shape + n_sensor :], (len(cuts),))
        columns = []
        for cut, angle in zip(cuts, phases, strict=True):
            x = unit_force(model, cut, p[:n_shape], band)
            gain = sensor_gain(model, cut, p[n_shape : n_shape + n_sensor], band)
            x = x if gain is None else np.einsum("ijk,jqk->iqk", gain, x)
            columns.append((x * np.exp(1j * order * angle)).transpose(0, 2, 1))
        return columns

    def matrix(p: np.ndarray) -> np.ndarray:
        return np.concatenate([rows_of_harmonics(model, columns) for columns in seen(p)])

    def derivative(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        slope = np.zeros((len(data), len(p)))
        now = matrix(p) @ q
        for i in range(n_shape + n_sensor):
            moved = p.copy()
            moved[i] += 1e-5 * scale[i] * (1 if p[i] + 1e-5 * scale[i] <= upper[i] else -1)
            slope[:, i] = (matrix(moved) @ q - now) / (moved[i] - p[i])
        block = len(data) // len(cuts)
        for f, columns in enumerate(seen(p)):
            column = n_shape + n_sensor + (0 if model.common_phase else f)
            slope[f * block : (f + 1) * block, column] += rows_of_harmonics(model, columns @ q * 1j * order)
        return slope

    return Problem(data, noise, matrix, derivative, lower, upper, scale, pull)


def _limits(model: HarmonicModel, n_phase: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper bound and natural step of every unknown."""
    runout, rise = (-LARGEST_RUNOUT, LARGEST_RUNOUT, 3e-6), (*RISE, 0.1)
    limits = [rise if name.startswith("m") else runout for name in model.shape_names]
    limits += [(0.85 * f, 1.15 * f, 0.02 * f) for f in model.sensor_modes]
    limits += [(0.005, 0.25, 0.02)] * len(model.sensor_modes) + [(-5.0, 10.0, 0.2)] * len(model.sensor_modes)
    limits += [(-np.inf, np.inf, 0.05)] * n_phase
    lower, upper, scale = np.array(limits).T
    if symmetric_labels(model):
        lower[0] = 0.0
    return lower, upper, scale


def _unknowns(fit: HarmonicFit) -> np.ndarray:
    return np.concatenate([fit.shape, fit.sensor, fit.phase[:1] if fit.model.common_phase else fit.phase])


def refine(start: HarmonicFit, tolerance: float = 1e-8) -> HarmonicFit:
    """Search all unknowns from a start: linear ones projected out, the others by trust-region Gauss-Newton.

    tolerance : relative change of the cost at which the search ends
    """
    model = start.model
    ask = problem(model)
    found = separable_least_squares(
        ask.matrix,
        ask.derivative,
        ask.data,
        _unknowns(start),
        lower=ask.lower,
        upper=ask.upper,
        scale=ask.scale,
        pull_to=np.ones(len(ask.pull)),
        pull=ask.pull,
        held=model.held,
        tolerance=tolerance,
    )
    shape, sensor, phase = np.split(found.nonlinear, np.cumsum([len(start.shape), len(start.sensor)]))
    return HarmonicFit(
        model, shape, sensor, np.broadcast_to(phase, (len(model.cuts),)).copy(), found.linear, found.cost
    )


def slopes(fit: HarmonicFit) -> np.ndarray:
    """Weighted rows of the fit by each unknown: linear, shape, sensor, phase.   returns (row, unknown)"""
    ask = problem(fit.model)
    p = _unknowns(fit)
    return np.concatenate([ask.matrix(p), ask.derivative(p, fit.linear)], axis=1)


def noise_covariance(fit: HarmonicFit) -> np.ndarray:
    """Covariance of (linear, shape) that the noise within the records alone would give.   returns (q + shape, q + shape)"""
    slope, noise = slopes(fit), problem(fit.model).noise
    scale = np.linalg.norm(slope, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(slope / scale, rcond=1e-10) / scale[:, np.newaxis]
    n = len(fit.linear) + len(fit.shape)
    return ((inverse * noise) @ inverse.T)[:n, :n]


def seen_coefficients(fit: HarmonicFit, size: np.ndarray) -> np.ndarray:
    """Which linear coefficients the rows of the fit determine, runout and phase being unknown as well.

    Seen is what the noise within the records leaves uncertain by less than a quarter of its size.
    size : of each coefficient, SI, (q,)   returns bool (q,)
    """
    ask = problem(fit.model)
    p = _unknowns(fit)
    slope = np.concatenate([ask.matrix(p) * size, ask.derivative(p, fit.linear) * ask.scale], axis=1)
    noise = np.sqrt(np.maximum(ask.noise, (1e-9 * np.abs(ask.data).max()) ** 2))
    _, values, vectors = np.linalg.svd(slope / noise[:, np.newaxis], full_matrices=False)
    spread = np.sqrt(np.sum((vectors / np.maximum(values, 1e-300)[:, np.newaxis]) ** 2, axis=0))
    return spread[: len(size)] < 0.25


def condition(fit: HarmonicFit) -> tuple[float, np.ndarray]:
    """Condition number of the scaled slopes of all unknowns, and the direction least seen.   returns number, (q + shape + ...,)"""
    slope = slopes(fit)
    scale = np.linalg.norm(slope, axis=0)
    _, values, vectors = np.linalg.svd(slope / np.where(scale > 0, scale, 1.0), full_matrices=False)
    return float(values[0] / max(values[-1], 1e-300)), vectors[-1]
