"""The force law on the lines: coefficients to harmonics, what the lines can tell of them, where tooth 0 is, and the runout.

The unknowns of a fit are as many combinations of coefficients as the lines show, each scaled to a force of one newton; then the
angles: one for all cuts that count from the same pulse or encoder, with a small one for each of them, because a pulse is known
to a sample only, and one for each cut that counts from its first sample; and the runout (c0, s0) where it is fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from millcal.data import CutVibration
from millcal.errors import IllPosedError, RecipeError
from millcal.numerics.linear_inverse import as_real_vector
from millcal.physics.cutter import Cutter
from millcal.physics.force_subspace import NAMES, ForceConstraint, force_constraint, harmonic_basis
from millcal.stages.forces.problem import Problem

UNITS = dict(zip(NAMES, ("N/m^2",) * 3 + ("N/m",) * 3, strict=True))
BELIEVED = np.radians(3.0)  # standard deviation of an angle that somebody has stated
PULSE = 0.3  # samples: standard deviation of where a pulse is in one cut, where the cut does not say it
LEAST = 0.05  # the same at least
USUAL_RUNOUT = 20e-6  # m: standard deviation of c0 and s0 before anything is known
STEP = 1e-8  # m, of the difference that is the slope by the runout

Basis = Callable[[float, float], np.ndarray]  # c0, s0 in m -> complex (line, axis, coefficient)


@dataclass(frozen=True, eq=False)
class Law:
    """The linear-edge law of a cutter on the lines of a problem.

    Unknowns theta: combinations, then angles, then c0 and s0 in units of `USUAL_RUNOUT`, if they are fitted.
    """

    basis_at: Basis  # N per N/m^2 and N/m, tooth 0 at angle 0
    order: np.ndarray  # (line,) of the spindle
    cut: np.ndarray  # (line,)
    turns: np.ndarray  # (cut, angle): which angles add up to the cut's
    angle_precision: np.ndarray  # (angle,) 1/rad^2; 0 where nothing is known
    stated: np.ndarray  # (angle,) bool: somebody said it, so that it is looked for nearby
    period: float  # rad, after which an angle is the same again
    fits_runout: bool
    combinations: np.ndarray  # (coefficient, unknown): coefficients of unit unknowns
    constraint: ForceConstraint

    @property
    def known(self) -> list[int]:
        """Indices of the coefficients that the lines tell by themselves."""
        return [int(i) for i in np.flatnonzero(self.constraint.told)]

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of combinations and of angles."""
        return self.combinations.shape[1], self.turns.shape[1]

    @property
    def precision(self) -> np.ndarray:
        """What is known of theta beforehand, about zero.   returns (theta,)"""
        runout = np.ones(2 if self.fits_runout else 0)
        return np.concatenate([np.zeros(self.sizes[0]), self.angle_precision, runout])

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Combinations, angles in rad, (c0, s0) in m."""
        n, angles = self.sizes
        runout = theta[n + angles :] * USUAL_RUNOUT if self.fits_runout else np.zeros(2)
        return theta[:n], theta[n : n + angles], runout

    def values(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force on the lines and its slopes.   returns complex (line, axis), (line, axis, theta)"""
        z, angles, (c0, s0) = self.split(theta)
        n = len(z)
        phase = (self.turns @ angles)[self.cut] if len(angles) else np.zeros(len(self.order))
        turn = np.exp(1j * self.order * phase)[:, None, None]
        slopes = np.zeros((len(self.order), self.basis_at(c0, s0).shape[1], len(theta)), complex)
        slopes[:, :, :n] = (self.basis_at(c0, s0) @ self.combinations) * turn
        force = slopes[:, :, :n] @ z
        for i in range(len(angles)):
            slopes[:, :, n + i] = (1j * self.order * self.turns[self.cut, i])[:, None] * force
        if self.fits_runout:
            coefficients = self.combinations @ z
            for i, moved in enumerate((self.basis_at(c0 + STEP, s0), self.basis_at(c0, s0 + STEP))):
                change = (moved - self.basis_at(c0, s0)) @ coefficients
                slopes[:, :, n + len(angles) + i] = change * turn[:, :, 0] * (USUAL_RUNOUT / STEP)
        return force, slopes

    def fixed(self, theta: np.ndarray) -> "Law":
        """The law with angles and runout as they are there, and only the coefficients unknown."""
        _, angles, (c0, s0) = self.split(theta)
        phase = (self.turns @ angles)[self.cut] if len(angles) else np.zeros(len(self.order))
        basis = self.basis_at(c0, s0) * np.exp(1j * self.order * phase)[:, None, None]
        return replace(
            self,
            basis_at=lambda c0, s0: basis,
            turns=np.zeros((len(self.turns), 0)),
            angle_precision=np.zeros(0),
            stated=np.zeros(0, bool),
            fits_runout=False,
            constraint=force_constraint(basis),
        )

    @property
    def basis(self) -> np.ndarray:
        """Of a law without runout to fit: complex (line, axis, coefficient)."""
        return self.basis_at(0.0, 0.0)

    def coefficients(self, theta: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All six, those that are hidden as the smallest that give the force.   returns (6,), (6, 6) SI"""
        n = self.combinations.shape[1]
        return self.combinations @ theta[:n], self.combinations @ covariance[:n, :n] @ self.combinations.T


def law_of(problem: Problem, phase: str, runout: bool) -> Law:
    """The law on the lines of a problem.

    phase : auto, fit or known; search takes no notice of what is stated   runout : fit it; else it is the cutter's own

    Raises
    ------
    RecipeError
        The phase is to be known and is not.
    IllPosedError
        The lines show nothing of any coefficient.
    """
    cutter = problem.cuts[0].cutter
    basis_at = _basis_at(problem, cutter, runout)
    basis = basis_at(*((0.25 * USUAL_RUNOUT,) * 2 if runout else (0.0, 0.0)))
    constraint = force_constraint(basis)
    space = constraint.space
    if not space.rank:
        raise IllPosedError(
            "forces: these harmonics carry no force of any coefficient; use more harmonics or another cut"
        )
    scale = np.where(space.scale > 0, space.scale, np.inf)
    _, size, rows = np.linalg.svd(as_real_vector(basis.reshape(-1, len(NAMES))) / scale, full_matrices=False)
    turns, precision, stated = _angles(problem.cuts, phase)
    equal = cutter.pitch is None or np.ptp(cutter.pitch) < 1e-9
    return Law(
        basis_at=basis_at,
        order=problem.order,
        cut=problem.cut,
        turns=turns,
        angle_precision=precision,
        stated=stated,
        # with a runout to fit, the teeth may exchange their numbers
        period=2 * np.pi / (cutter.teeth if runout and equal else int(np.gcd.reduce(problem.order))),
        fits_runout=runout,
        combinations=((rows[: space.rank] / size[: space.rank, None]) / scale).T,
        constraint=constraint,
    )


def _basis_at(problem: Problem, cutter: Cutter, runout: bool) -> Basis:
    """The basis by the runout, kept for those that are asked for again."""

    alike: dict[tuple, list[int]] = {}  # cuts that differ in their speed alone have one basis
    for number, cut in enumerate(problem.cuts):
        orders = problem.order[problem.cut == number]
        alike.setdefault((replace(cut.conditions, spindle_speed=0.0), tuple(orders)), []).append(number)

    @lru_cache(maxsize=64)
    def basis_at(c0: float, s0: float) -> np.ndarray:
        own = (
            replace(cutter, runout=float(np.hypot(c0, s0)), runout_angle=float(np.arctan2(s0, c0)))
            if runout
            else cutter
        )
        basis = np.empty((len(problem.order), len(problem.axes), len(NAMES)), complex)
        for (conditions, orders), numbers in alike.items():
            found = harmonic_basis(own, conditions, orders, problem.axes)
            for number in numbers:
                basis[problem.cut == number] = found
        return basis

    return basis_at


def _angles(cuts: Sequence[CutVibration], phase: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which angles add up to that of tooth 0 in each cut, how well each is known, and whether it was stated.

    returns (cut, angle), (angle,) 1/rad^2, (angle,)
    """
    if phase == "known":
        unknown = [cut.name for cut in cuts if cut.angle_from != "stated"]
        if unknown:
            raise RecipeError(
                f"forces.phase: known, but nothing says where tooth 0 is in {unknown[0]}; give spindle_phase_deg, or "
                'phase = "fit"'
            )
        return np.zeros((len(cuts), 0)), np.zeros(0), np.zeros(0, bool)
    keys = [_counted_from(number, cut, phase) for number, cut in enumerate(cuts)]
    names = list(dict.fromkeys(keys))
    turns = [np.array([key == name for key in keys], float) for name in names]
    stated = [name[0] for name in names]
    precision = [BELIEVED**-2 if said and phase == "auto" else 0.0 for said in stated]
    for number, (cut, key) in enumerate(zip(cuts, keys, strict=True)):
        if keys.count(key) > 1:
            turns.append(np.eye(len(cuts))[number])
            precision.append(_pulse_sd(cut) ** -2)
            stated.append(True)
    return np.stack(turns, axis=1), np.array(precision), np.array(stated, bool)


def _counted_from(number: int, cut: CutVibration, phase: str) -> tuple[bool, str]:
    """Whether the angle was stated, and what it is the angle of: one for all pulses, one for each first sample."""
    stated = cut.angle_from == "stated" and phase != "search"
    mark = cut.counts_from or (
        "pulse" if cut.angle_from == "stated" else {"speed": "start"}.get(cut.angle_from, cut.angle_from)
    )
    return stated, f"start {number}" if mark == "start" else mark


def _pulse_sd(cut: CutVibration) -> float:
    """By how much the pulse or the encoder's zero of one cut may stand off that of the others, rad."""
    sample = 2 * np.pi * cut.spindle_frequency / cut.sample_rate
    return PULSE * sample if cut.angle_sd is None else max(cut.angle_sd, LEAST * sample)
