"""Which modes a structure can have, and which only describe a curve.

A fit to measured lines can always be made better by one more term. On real structures, where joints and cables do what the
model cannot, the terms that do it betray themselves: they are gone after one swing, they lie on top of each other and move
alike, or a driving point would give power away.
"""

import numpy as np

from millcal.numerics.mode_fit import Fit, Model
from millcal.physics.modal_constants import driving_points, mode_shapes, turned
from millcal.stages.modes.intervals import residues
from millcal.stages.modes.problem import Problem

OVERDAMPED = 0.5  # damping ratio of what is no resonance
ALIKE = 0.9  # modal assurance criterion of modes that are one
CLOSE = 0.5  # distance of two modes over the sum of their half widths, zeta f_n
SPLIT = np.radians(40.0)  # phase of a driving point's constant beyond which it belongs to no mode
HARDLY = 0.02  # share of the largest resonance below which a mode's sign at a driving point says nothing


def is_possible(problem: Problem, fit: Fit, model: Model) -> bool:
    """Whether all modes of a fit can be those of one structure."""
    residue = residues(problem, fit, model)
    fn, zeta = fit.natural_frequency, fit.damping_ratio
    if (zeta > OVERDAMPED).any():
        return False
    apart = np.abs(fn[:, None] - fn) / (zeta * fn + (zeta * fn)[:, None])
    if np.triu((apart < CLOSE) & (whole_mac(residue) > ALIKE), 1).any():
        return False
    for constants in driving_constants(problem, fit, residue).T:  # of one driving point
        sign = np.sign(np.sum(np.sign(constants.real) * resonance(fit, constants)))  # the sensor may be turned
        if np.any((np.abs(np.angle(constants * sign)) > SPLIT) & moves(fit, constants)):
            return False
    return True


def resonance(fit: Fit, constants: np.ndarray) -> np.ndarray:
    """Size of each mode's resonance at a driving point, but for a factor.   constants : complex (mode,)"""
    return np.abs(constants) / (fit.natural_frequency**2 * fit.damping_ratio)


def moves(fit: Fit, constants: np.ndarray) -> np.ndarray:
    """Whether a driving point moves enough in each mode for the sign and the phase of its constant to say something."""
    size = resonance(fit, constants)
    return size > HARDLY * size.max(initial=0.0)


def driving_constants(problem: Problem, fit: Fit, residue: np.ndarray) -> np.ndarray:
    """2j w_d A of each driving point, real and positive for real modes.   returns complex (mode, driving point)"""
    w_d = 2 * np.pi * fit.natural_frequency * np.sqrt(1 - fit.damping_ratio**2)
    signs = [
        (o, i, turned(problem.outputs[o], problem.inputs[i])) for o, i in measured_driving_points(problem, residue)
    ]
    return np.array([2j * w_d * sign * residue[:, o, i] for o, i, sign in signs]).reshape(len(signs), len(w_d)).T


def measured_driving_points(problem: Problem, residue: np.ndarray) -> list[tuple[int, int]]:
    """(output, input) of the driving points that have residues."""
    return [pair for pair in driving_points(problem.outputs, problem.inputs) if np.isfinite(residue[:, *pair]).all()]


def mac(shapes: np.ndarray) -> np.ndarray:
    """Modal assurance criterion |phi^H psi|^2 / (phi^H phi psi^H psi).   shapes : (mode, dof)   returns (mode, mode)"""
    product = np.abs(shapes.conj() @ shapes.T) ** 2
    own = np.maximum(np.diag(product), 1e-300)
    return product / np.sqrt(np.outer(own, own))


def whole_mac(residue: np.ndarray) -> np.ndarray:
    """The same of whole residue matrices: modes alike in where they are seen and in what excites them.

    residue : complex (mode, output, input), nan where nothing was measured
    """
    return mac(np.nan_to_num(residue).reshape(len(residue), int(np.prod(residue.shape[1:]))))  # also of no mode


def shapes_of(residue: np.ndarray) -> np.ndarray:
    """Mode shapes over the dofs that were measured, zero for the others.   returns complex (mode, dof)"""
    return np.nan_to_num(mode_shapes(residue))


def complexity(shapes: np.ndarray) -> np.ndarray:
    """Mean phase deviation of each shape from the straight line through it, weighted by size.   returns (mode,) rad"""
    line = np.exp(0.5j * np.angle(np.sum(shapes**2, axis=1)))[:, None]
    turned = shapes / line
    off = np.arctan2(np.abs(turned.imag), np.abs(turned.real))
    size = np.abs(shapes)
    return np.sum(size * off, axis=1) / np.maximum(size.sum(axis=1), 1e-300)
