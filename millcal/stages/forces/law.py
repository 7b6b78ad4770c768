"""The force law on the lines: coefficients to harmonics, what the lines can tell of them, and the angle of tooth 0.

The unknowns of a fit are as many combinations of coefficients as the lines show, each scaled to one, and then the phases:
one for all cuts whose angle counts from the same pulse or encoder, one for each cut that counts from its first sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import CutVibration
from millcal.errors import IllPosedError, RecipeError
from millcal.numerics.linear_inverse import as_real_vector
from millcal.physics.force_subspace import NAMES, force_constraint, harmonic_basis
from millcal.stages.forces.problem import Problem

UNITS = dict(zip(NAMES, ("N/m^2",) * 3 + ("N/m",) * 3, strict=True))
BELIEVED = np.radians(3.0)  # standard deviation of an angle that somebody has stated


@dataclass(frozen=True, eq=False)
class Law:
    """The linear-edge law of a cutter on the lines of a problem."""

    basis: np.ndarray  # complex (line, axis, coefficient), N per N/m^2 and N/m, tooth 0 at angle 0
    order: np.ndarray  # (line,) of the spindle
    group: np.ndarray  # (line,) which phase turns it; -1: none, the angle is known
    combinations: np.ndarray  # (coefficient, unknown): coefficients of unit unknowns
    unobservable: tuple[tuple[str, ...], ...]
    rank: int
    constraint: np.ndarray  # real (row, 2 line axis): what [Re F; Im F] must give zero
    complex_rows: int
    phase_mean: np.ndarray  # (group,) rad
    phase_precision: np.ndarray  # (group,) 1/rad^2
    stated: np.ndarray  # (group,) bool: somebody said the angle, so that it is looked for nearby
    period: float  # rad, after which a phase is the same again

    @property
    def known(self) -> list[int]:
        """Indices of the coefficients that the lines tell by themselves."""
        hidden = {name for names in self.unobservable for name in names}
        return [i for i, name in enumerate(NAMES) if name not in hidden]

    def values(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force on the lines and its slopes.   theta : (unknown + group,)   returns (line, axis), (line, axis, theta)"""
        n = self.combinations.shape[1]
        turn = np.exp(1j * self.order * np.append(theta[n:], 0.0)[self.group])
        slopes = np.zeros((*self.basis.shape[:2], len(theta)), complex)
        slopes[:, :, :n] = (self.basis @ self.combinations) * turn[:, None, None]
        force = slopes[:, :, :n] @ theta[:n]
        for g in range(len(theta) - n):
            own = self.group == g
            slopes[own, :, n + g] = 1j * self.order[own, None] * force[own]
        return force, slopes

    def turned(self, phases: np.ndarray) -> "Law":
        """The law with these phases known.   phases : (group,) rad"""
        turn = np.exp(1j * self.order * np.append(phases, 0.0)[self.group])
        none = np.zeros(0)
        return replace(
            self,
            basis=self.basis * turn[:, None, None],
            group=np.full(len(self.group), -1),
            phase_mean=none,
            phase_precision=none,
            stated=none.astype(bool),
            constraint=force_constraint(self.basis * turn[:, None, None]).rows,
        )

    def coefficients(self, theta: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All six, those that are hidden as the smallest that give the force.   returns (6,), (6, 6) SI"""
        n = self.combinations.shape[1]
        return self.combinations @ theta[:n], self.combinations @ covariance[:n, :n] @ self.combinations.T


def law_of(problem: Problem, phase: str) -> Law:
    """The law on the lines of a problem.   phase : auto, fit or known

    Raises
    ------
    RecipeError
        The phase is to be known and is not.
    IllPosedError
        The lines show nothing of any coefficient.
    """
    basis = np.empty((len(problem.order), len(problem.axes), len(NAMES)), complex)
    for number, cut in enumerate(problem.cuts):
        own = problem.cut == number
        basis[own] = harmonic_basis(cut.cutter, cut.conditions, problem.order[own], problem.axes)
    constraint = force_constraint(basis)
    space = constraint.space
    if not space.rank:
        raise IllPosedError(
            "forces: these harmonics carry no force of any coefficient; use more harmonics or another cut"
        )
    scale = np.where(space.scale > 0, space.scale, np.inf)
    stack = as_real_vector(basis.reshape(-1, len(NAMES)))
    _, size, rows = np.linalg.svd(stack / scale)
    groups, precision, stated = _phases(problem.cuts, phase)
    return Law(
        basis=basis,
        order=problem.order,
        group=groups[problem.cut],
        combinations=((rows[: space.rank] / size[: space.rank, None]) / scale).T,
        unobservable=constraint.unobservable,
        rank=space.rank,
        constraint=constraint.rows,
        complex_rows=constraint.complex_rows,
        phase_mean=np.zeros(len(precision)),
        phase_precision=precision,
        stated=stated,
        period=2 * np.pi / int(np.gcd.reduce(problem.order)),
    )


def _phases(cuts: Sequence[CutVibration], phase: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which phase turns each cut (-1: none), how well it is known, and whether it was stated.

    returns (cut,), (group,) 1/rad^2, (group,)
    """
    sources = [cut.angle_from for cut in cuts]
    if phase == "known":
        unknown = [cut.name for cut in cuts if cut.angle_from != "stated"]
        if unknown:
            raise RecipeError(
                f"forces.phase: known, but nothing says where tooth 0 is in {unknown[0]}; give spindle_phase_deg, or "
                'phase = "fit"'
            )
        return np.full(len(cuts), -1), np.zeros(0), np.zeros(0, bool)
    keys: list[object] = [number if source == "speed" else source for number, source in enumerate(sources)]
    names = list(dict.fromkeys(keys))
    precision = [BELIEVED**-2 if name == "stated" and phase == "auto" else 0.0 for name in names]
    stated = np.array([name == "stated" for name in names], bool)
    return np.array([names.index(key) for key in keys]), np.array(precision), stated
