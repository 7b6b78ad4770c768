"""First-order semi-discretization: the slow way to the multipliers of a cut, that anyone can check.

Over a step the cutting matrix is its exact mean and the delayed tip a straight line between steps; the modes then move
exactly. Insperger and Stepan, Updated semi-discretization method for periodic delay-differential equations (2004). The error falls
with the square of the step, so that two step numbers give the limit.
"""

import numpy as np
from cutting_matrix import delays, mean_over_steps, real_form
from scipy.linalg import expm

from millcal.physics.stability.regeneration import Regeneration, TipModes


def multipliers(spindle_speed: float, depth: float, tip: TipModes, cut: Regeneration, steps: int) -> np.ndarray:
    """Multipliers, largest first: of a tooth period with equal pitch, of a revolution else.

    spindle_speed : rad/s   depth : m   steps : of the period, with every delay a whole number of them   returns (k,)
    """
    if tip.flexibility.any():
        raise ValueError("a flexibility that answers at once makes the error fall with the step alone")
    period = 2 * np.pi / cut.teeth if cut.equal_pitch else 2 * np.pi
    step = period / steps
    behind = np.rint(delays(cut) / step).astype(int)
    if not np.allclose(behind * step, delays(cut)):
        raise ValueError(f"{steps} steps do not divide the delays")
    dt = step / spindle_speed
    a, b, c = real_form(tip)
    edges = step * np.arange(steps + 1)
    cutting = mean_over_steps(edges, depth, cut, cut.ktc, cut.krc)
    state = a - b @ cutting.sum(axis=1) @ c
    if cut.indentation:
        rubbing = mean_over_steps(edges, depth, cut, cut.indentation_friction * cut.indentation, cut.indentation)
        state = state - b @ rubbing.sum(axis=1) @ c @ a / (cut.radius * spindle_speed)

    # x' = state x + b (start + (end - start) t / dt): the exponential of the whole holds the integrals of both
    size, oldest = len(a), behind.max()
    whole = np.zeros((steps, size + 4, size + 4))
    whole[:, :size, :size] = state * dt
    whole[:, :size, size : size + 2] = b * dt
    whole[:, size : size + 2, size + 2 :] = np.eye(2)
    whole = expm(whole)
    moved, of_start, of_slope = whole[:, :size, :size], whole[:, :size, size : size + 2], whole[:, :size, size + 2 :]

    # every row below is a row of a matrix that acts on (x_0, r_-1, ..., r_-oldest)
    columns = size + 2 * oldest
    x = np.eye(size, columns)
    past = [np.eye(columns)[size + 2 * (k - 1) : size + 2 * k] for k in range(oldest, 0, -1)]  # r_-oldest first
    past.append(c @ x)
    for i in range(steps):
        start = sum(cutting[i, j] @ past[i + oldest - lag] for j, lag in enumerate(behind))
        end = sum(cutting[i, j] @ past[i + oldest - lag + 1] for j, lag in enumerate(behind))
        x = moved[i] @ x + of_start[i] @ start + of_slope[i] @ (end - start)
        past.append(c @ x)
    matrix = np.vstack([x, *past[-2 : -2 - oldest : -1]])
    while not (met := matrix.any(axis=0)).all():  # motions that no tooth meets decide nothing
        matrix = matrix[np.ix_(met, met)]
    found = np.linalg.eigvals(matrix)
    return found[np.argsort(-np.abs(found))]


def spectral_radius(spindle_speed: float, depth: float, tip: TipModes, cut: Regeneration, steps: int) -> float:
    """The largest multiplier's size."""
    return float(np.abs(multipliers(spindle_speed, depth, tip, cut, steps)[0]))


def richardson(coarse: float, fine: float) -> float:
    """The limit from a number of steps and twice that number."""
    return fine + (fine - coarse) / 3
