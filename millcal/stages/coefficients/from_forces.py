"""Coefficients from forces that accelerations told: the answer of the forces in the shape of an identification.

What stands for the measured force is the force of every harmonic by itself, for which the law was not asked. It has no mean,
since no accelerometer knows one, and only the harmonics that were reconstructed. Some of these are known badly, so R2 and
the residual weight them by what is known of each.
"""

import numpy as np

from millcal.data import AXES, Coefficients, ForceHarmonics
from millcal.errors import IllPosedError
from millcal.stages.coefficients.answer import alternative


def coefficients_of_forces(forces: ForceHarmonics) -> Coefficients:
    """The coefficients behind reconstructed forces, with the verdict and the checks of the reconstruction.

    Raises
    ------
    IllPosedError
        The lines tell no coefficient by itself.
    """
    if not forces.posterior.names:
        hidden = "; ".join(" with ".join(names) for names in forces.unobservable)
        raise IllPosedError(
            f"forces: these harmonics tell no coefficient by itself ({hidden}); use more harmonics, fewer teeth or another "
            "radial depth"
        )
    cuts, highest = len(forces.cuts), int(forces.order.max())
    rows = [AXES.index(axis) for axis in forces.axes]
    free = forces.force if forces.free_force is None else forces.free_force
    law = _law_on_lines(forces)
    measured = np.full((cuts, 3, highest + 1), np.nan, complex)
    modelled = measured.copy()
    for number in range(cuts):
        own = forces.cut == number
        place = np.ix_([number], rows, forces.order[own].astype(int))
        measured[place], modelled[place] = free[own].T, law[own].T
    mean = np.full((cuts, 3), np.nan)
    modelled_mean = mean.copy()
    if forces.law_force is not None:
        modelled_mean[:, rows] = forces.law_force.mean(axis=2)
    left = np.abs(free - law) ** 2
    residual, r2 = np.full(3, np.nan), np.full(3, np.nan)
    if forces.free_force is not None and forces.free_sd is not None:
        weight = 1.0 / np.maximum(forces.free_sd, 1e-300) ** 2
        weight = weight / weight.sum(axis=0)
        lines = len(forces.order) / cuts
        residual[rows] = np.sqrt(lines * np.sum(weight * left, axis=0) / 2)
        r2[rows] = 1 - np.sum(weight * left, axis=0) / np.maximum(np.sum(weight * np.abs(free) ** 2, axis=0), 1e-300)
    others = [
        alternative(method, dict(zip(forces.posterior.names, values, strict=True)))
        for method, values in zip(forces.compared_methods, forces.compared, strict=True)
        if method != forces.method and np.all(np.isfinite(values))
    ]
    return Coefficients(
        posterior=forces.posterior,
        cutter=forces.cutter,
        conditions=forces.conditions,
        cuts=forces.cuts,
        verdict=forces.verdict,
        checks=forces.checks,
        feed_per_tooth=np.array([conditions.feed_per_tooth for conditions in forces.conditions]),
        measured_mean=mean,
        modelled_mean=modelled_mean,
        angle=forces.angle,
        measured=_curve(forces, free, rows),
        modelled=_curve(forces, law, rows),
        measured_amplitude=np.abs(measured),
        modelled_amplitude=np.abs(modelled),
        residual_rms=residual,
        r2=r2,
        phase=forces.phase,
        band=(int(forces.order.min()), highest),
        alternatives=tuple(others),
        notices=forces.notices,
    )


def _law_on_lines(forces: ForceHarmonics) -> np.ndarray:
    """Force of the law at the lines; where it does not tell an axis, what was reconstructed.   returns (line, axis)"""
    force = np.array(forces.force)
    if forces.law_force is None:
        return force
    turn = np.exp(-1j * np.multiply.outer(forces.order, forces.angle)) * (2 / len(forces.angle))
    for number in range(len(forces.cuts)):
        own = np.flatnonzero(forces.cut == number)
        of_law = turn[own] @ forces.law_force[number].T  # (line, axis)
        force[own] = np.where(np.isfinite(of_law), of_law, force[own])
    return force


def _curve(forces: ForceHarmonics, harmonics: np.ndarray, rows: list[int]) -> np.ndarray:
    """One revolution of harmonics on the lines.   harmonics : (line, axis)   returns (cut, 3, angle)"""
    curves = np.full((len(forces.cuts), 3, len(forces.angle)), np.nan)
    for number in range(len(forces.cuts)):
        own = forces.cut == number
        wave = np.exp(1j * np.multiply.outer(forces.order[own], forces.angle))
        curves[number, rows] = np.real(harmonics[own].T @ wave)
    return curves
