"""Cutting coefficients from the harmonics of the synchronous force of one or more cuts (the instantaneous fit).

The search starts from the mean-force coefficients, a handful of runouts and, for each, a scan of every record's phase; the
best starts are refined and the lowest kept. Then each cut is left out in turn: the spread of those fits gives the interval
(jackknife over cuts, Student's t), and what they say of the cut they have not seen is the only honest measure of the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import CutForce
from millcal.numerics.jackknife import jackknife_covariance
from millcal.numerics.separable_least_squares import solve_linear
from millcal.physics.cutting_force import Kienzle
from millcal.stages.coefficients.average import mean_forces, solve_means
from millcal.stages.coefficients.harmonic_model import (
    LARGEST_RUNOUT,
    HarmonicFit,
    HarmonicModel,
    modelled_harmonics,
    problem,
    refine,
    scan_phase,
    scan_phases,
    unit_force,
)

GUESS = np.array([800e6, 300e6, 150e6, 20e3, 20e3, 5e3])  # aluminium; only a start where the mean forces give none
STARTS_REFINED = 3
ROUGH = 1e-4  # tolerance while starts compete; only the winner is searched to the end
NO_FORCE = 0.03  # of the loudest axis, below which an axis has nothing to predict


@dataclass(frozen=True, eq=False)
class HarmonicStudy:
    """The fit, the fits with one cut left out, and the ratios residual / AC rms that judge them."""

    best: HarmonicFit
    rivals: tuple[HarmonicFit, ...]  # other minima found
    left_out: tuple[HarmonicFit, ...]  # one per cut; empty with fewer than three cuts
    in_sample: np.ndarray  # (axis,), up to `band`
    in_sample_by_cut: np.ndarray  # (cut, axis)
    predicted: np.ndarray | None  # (axis,), of cuts left out
    predicted_by_cut: np.ndarray | None  # (cut, axis)


def start_coefficients(cuts: Sequence[CutForce]) -> np.ndarray:
    """Linear-edge coefficients to start from: of the mean forces where these make sense, else a guess.   returns (6,)"""
    feeds = [cut.conditions.feed_per_tooth for cut in cuts]
    if np.ptp(feeds) <= 0.02 * max(feeds):
        return GUESS
    found = solve_means(cuts, mean_forces(cuts, "whole-revolutions"), 0.0)
    return found.coefficients if found.coefficients[0] > 0 else GUESS


def kienzle_start(linear: np.ndarray, cuts: Sequence[CutForce]) -> tuple[np.ndarray, np.ndarray]:
    """Kienzle constants that give the forces of a linear-edge law at the mean chip.   returns k (3,), m (3,)"""
    chip = 0.64 * float(np.mean([cut.conditions.feed_per_tooth for cut in cuts]))
    force = np.maximum(linear[:3], 0.05 * linear[0]) * chip + np.maximum(linear[3:], 0.0)
    rise = np.clip(np.maximum(linear[3:], 0.0) / force, 0.05, 0.7)  # d ln F / d ln h = 1 - m
    return force / (chip ** (1 - rise) * Kienzle.REFERENCE_CHIP**rise), rise


def runout_of_line(model: HarmonicModel, linear: np.ndarray) -> float:
    """Runout that the once-per-revolution line asks for: its size over that of the line of one micrometre, m.

    linear : linear-edge coefficients, SI, (6,)
    """
    micrometre = replace(model, law="linear-edge", taper=False, memo={})
    shape = np.zeros(len(micrometre.shape_names))
    shape[0] = 1e-6
    seen = [np.abs(cut.harmonics[:2, 1]).mean() for cut in model.cuts]
    unit = [np.abs(unit_force(micrometre, cut, shape, 1)[:2, :, 1] @ linear).mean() for cut in model.cuts]
    return 1e-6 * float(np.mean(seen) / max(np.mean(unit), 1e-300))


def start_shapes(model: HarmonicModel, linear: np.ndarray) -> list[np.ndarray]:
    """Runouts to start from: the size the once-per-revolution line asks for and sizes about it, in several directions."""
    rise = list(kienzle_start(linear, model.cuts)[1]) if model.law == "kienzle" else []
    names = model.runout_names
    if not names:
        return [np.array(rise)]
    size = float(np.clip(runout_of_line(model, linear), 1e-6, LARGEST_RUNOUT / 2))
    starts = []
    for c0 in (0.4 * size, 0.8 * size, 1.2 * size, 2.0 * size):
        for turn in (0.0,) if "s0" not in names else 2 * np.pi * np.arange(4) / 4:
            value = {"c0": c0 * np.cos(turn), "s0": c0 * np.sin(turn)}
            starts += [np.array([value.get(name, taper) for name in names] + rise) for taper in _tapers(model, c0)]
    return starts


def _tapers(model: HarmonicModel, c0: float) -> tuple[float, ...]:
    return (-2.0 * c0, 0.0, 2.0 * c0) if model.taper else (0.0,)


def search(model: HarmonicModel) -> tuple[HarmonicFit, tuple[HarmonicFit, ...]]:
    """The best fit found and its rivals, from several starts."""
    edge = start_coefficients(model.cuts)
    linear = (
        model.held if model.held is not None else kienzle_start(edge, model.cuts)[0] if model.law == "kienzle" else edge
    )
    n = len(model.sensor_modes)
    sensor = np.concatenate([np.asarray(model.sensor_modes, float), np.full(n, 0.1), np.ones(n)])
    ask = problem(model)
    rough = []
    for shape in start_shapes(model, edge):
        trial = HarmonicFit(model, shape, sensor, np.zeros(len(model.cuts)), linear, np.inf)
        for _ in range(2):  # phase and coefficients in turn
            trial = replace(trial, phase=scan_phases(trial))
            phase = trial.phase[:1] if model.common_phase else trial.phase
            matrix = ask.matrix(np.concatenate([shape, sensor, phase]))
            q = solve_linear(matrix, ask.data) if model.held is None else model.held
            trial = replace(trial, linear=q, cost=float(np.sum((ask.data - matrix @ q) ** 2)))
        rough.append(trial)
    rough.sort(key=lambda fit: fit.cost)
    fits = sorted((refine(fit, ROUGH) for fit in rough[:STARTS_REFINED]), key=lambda fit: fit.cost)
    return refine(fits[0]), tuple(fits[1:])


def ratio(cuts: Sequence[CutForce], modelled: Sequence[np.ndarray], band: int) -> tuple[np.ndarray, np.ndarray]:
    """RMS of what the model leaves over the RMS of the force, mean excluded, up to a harmonic.

    An axis that carries no force to speak of is measured against a share of the loudest: there is nothing in it to predict.

    modelled : complex (axis, k) for each cut   returns pooled over the cuts (axis,), and (cut, axis)
    """
    left = np.array(
        [
            np.sum(np.abs(c.harmonics[:, 1 : band + 1] - m[:, 1 : band + 1]) ** 2, 1)
            for c, m in zip(cuts, modelled, strict=True)
        ]
    )
    whole = np.array([np.sum(np.abs(cut.harmonics[:, 1 : band + 1]) ** 2, 1) for cut in cuts])
    whole = np.maximum(whole, np.maximum(NO_FORCE**2 * whole.max(axis=1, keepdims=True), 1e-300))
    return np.sqrt(left.sum(0) / np.maximum(whole.sum(0), 1e-300)), np.sqrt(left / whole)


def predict(fit: HarmonicFit, cut: CutForce, band: int) -> np.ndarray:
    """What a fit says of a cut it has not seen; only the record's phase is taken from it.   returns complex (axis, k)"""
    if fit.model.common_phase:
        return modelled_harmonics(fit, cut, float(fit.phase[0]), band)
    phase = scan_phase(fit.model, [cut.harmonics], [modelled_harmonics(fit, cut, 0.0, fit.model.band)])
    return modelled_harmonics(fit, cut, phase, band)


def search_near(model: HarmonicModel, near: HarmonicFit) -> HarmonicFit:
    """The best fit about the answer to a similar question: from there, and from half and twice its runout."""
    fits = [refine(replace(near, model=model), ROUGH)]
    for factor in (0.5, 2.0) if model.runout_names else ():
        shape = near.shape.copy()
        shape[: len(model.runout_names)] *= factor
        trial = replace(near, model=model, shape=shape)
        fits.append(refine(replace(trial, phase=scan_phases(trial)), ROUGH))
    return refine(min(fits, key=lambda fit: fit.cost))


def study(model: HarmonicModel, best: HarmonicFit | None = None) -> HarmonicStudy:
    """Fit (or take the fit given), leave each cut out, and judge up to the band of the fit."""
    band = model.band
    best, rivals = (best, ()) if best is not None else search(model)
    cuts = model.cuts
    in_sample, by_cut = ratio(
        cuts, [modelled_harmonics(best, c, p, band) for c, p in zip(cuts, best.phase, strict=True)], band
    )
    if len(cuts) < 3:
        return HarmonicStudy(best, rivals, (), in_sample, by_cut, None, None)
    left_out = tuple(
        refine(replace(best, model=model.without(i), phase=np.delete(best.phase, i), cost=np.inf))
        for i in range(len(cuts))
    )
    predicted = [predict(fit, cut, band) for fit, cut in zip(left_out, cuts, strict=True)]
    return HarmonicStudy(best, rivals, left_out, in_sample, by_cut, *ratio(cuts, predicted, band))


def parameters(fit: HarmonicFit) -> np.ndarray:
    """Linear coefficients, then runout and exponents.   returns (q + shape,)"""
    return np.concatenate([fit.linear, fit.shape])


def left_out_covariance(found: HarmonicStudy) -> np.ndarray:
    """Jackknife over cuts.   returns (q + shape, q + shape)"""
    return jackknife_covariance(np.stack([parameters(fit) for fit in found.left_out]))
