"""Each method on a simulated cut whose coefficients change: k_t, m_t, k_r, m_r after every active sample.

The ensemble filters and recursive least squares are set as Schwenzer et al. (2020) set them; the paper's letters and its units,
N/mm^2 at a chip of 1 mm, are kept because P_0 = 10 I of its least squares means those. Interacting models and the smoother are the
better ways to do the same; they are given the same prior and nothing of the case.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from millcal.numerics.ensemble_kalman import Inflation
from millcal.numerics.interacting_kernel import Motions
from millcal.numerics.interacting_models import Mixture, start, switching
from millcal.numerics.smoothing import Problem, Trajectory, smooth
from millcal.numerics.trend_models import independent, layout_of, shared
from millcal.physics.disc_filters import follow_ensemble, follow_least_squares, follow_models
from millcal.physics.disc_force import ShapeTables, force_and_slopes, shape_and_slope, shape_tables
from millcal.studies.trending_cuts import BOX, CONDITIONS, DISCS, REFERENCE_CHIP, SimulatedCut, geometry

MEMBERS = 100  # J
SUBSET = 10  # M, drawn anew at an inflation
FORGETTING = 0.98  # rho
COVARIANCE = 10.0 * np.eye(2)  # P_0 of the least squares, of k in N/mm^2 and m alike

CHIP = 0.06e-3  # m, amid the chips: ln k there hardly depends on m
SPEED = 1e-3  # prior standard deviation of the change of ln k from one active sample to the next
DRIFTS = (0.0, 1e-5, 1e-4)  # of that change from sample to sample, for each of the interacting models
STAY = 0.999

_WIDE, _WIDE_DEGREE = (-0.5, 1.3), 20  # rises that least squares without a box run through


def ensembles(seed: int, starts: int) -> np.ndarray:
    """Initial ensembles, uniform in the box of Table 2.   returns (start, member, 4)"""
    low, high = BOX.T
    return low + (high - low) * np.random.default_rng([seed, 1]).random((starts, MEMBERS, 4))


def perturbations(seed: int, starts: int) -> Iterator[np.ndarray]:
    """What perturbs the measurements of each start, the same for every case and every setting.

    yields (active, member, 2), one array that each start fills anew
    """
    normals = np.empty((np.count_nonzero(geometry().active), MEMBERS, 2))
    for number in range(starts):
        yield np.random.default_rng([seed, 2, number]).standard_normal(out=normals)


def inflation_of(step: int, divisor: float) -> Inflation:
    """Every `step` active samples, 10 of the 100 members by P_0 / divisor (eq. 21)."""
    return Inflation(step, SUBSET, 1 / divisor)


def by_ensemble(
    cut: SimulatedCut, members: np.ndarray, normals: np.ndarray, rng: np.random.Generator, inflation: Inflation | None
) -> np.ndarray:
    """The ensemble Kalman filter from one start, by its mean.

    members : (member, 4)   normals : (active, member, 2)   rng : of the inflations   returns (active, 4)
    """
    return follow_ensemble(
        _tables(REFERENCE_CHIP),
        cut.active_force,
        cut.sigma,
        members,
        rng=rng,
        limits=BOX,
        inflation=inflation,
        normals=normals,
    )


def by_least_squares(cut: SimulatedCut, starts: np.ndarray, *, box: bool) -> np.ndarray:
    """Recursive least squares in either direction.   starts : (start, 4)   returns (start, active, 4)"""
    tables = _tables(REFERENCE_CHIP, wide=True)
    found = [
        follow_least_squares(
            tables,
            cut.active_force[:, i],
            starts[:, 2 * i : 2 * i + 2],
            COVARIANCE,
            forgetting=FORGETTING,
            limits=BOX[2 * i : 2 * i + 2] if box else None,
        )
        for i in range(2)
    ]
    return np.concatenate(found, axis=2)


def by_models(cut: SimulatedCut, members: np.ndarray) -> np.ndarray:
    """Three interacting models of ln k: one that rests, two whose trend changes slowly or fast.

    They begin where the ensemble is, with its covariance.   members : (start, member, 4)   returns (start, active, 4)
    """
    motions = Motions(np.array([0, 2]), np.array([4, 5]), np.zeros(len(DRIFTS)), np.array(DRIFTS))
    levels = np.concatenate([_levels(members[..., :2]), _levels(members[..., 2:])], axis=-1)
    paths = follow_models(
        _tables(CHIP),
        cut.active_force,
        cut.sigma,
        [_beginning(state) for state in levels],
        motions=motions,
        chances=switching(len(DRIFTS), STAY),
    )
    return np.concatenate([_coefficients(paths[..., :2]), _coefficients(paths[..., 2:])], axis=2)


def by_smoothing(cut: SimulatedCut) -> tuple[np.ndarray, Trajectory]:
    """The smoother, which knows the whole record; the noise it takes from the air.

    returns the coefficients (active, 4), and all that it found: kappa_t, m_t, kappa_r, m_r with kappa = ln k at `CHIP` in N/mm^2
    """
    tables = _tables(CHIP)
    noise = np.sqrt(np.mean(cut.force[cut.air] ** 2, axis=0))

    def predict(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        predicted, slopes = np.empty((len(parameters), 2)), np.zeros((len(parameters), 2, 4))
        for i in range(2):
            level, rise = parameters[:, 2 * i], parameters[:, 2 * i + 1]
            force, by = force_and_slopes(tables, level, rise, CHIP)
            predicted[:, i], slopes[:, i, 2 * i : 2 * i + 2] = force / noise[i], by / noise[i]
        return predicted, slopes

    time = cut.active_time
    mean, covariance = box_prior()
    problem = Problem(cut.active_force / noise, predict, time, np.arange(len(time)))
    gaps = np.concatenate([[False], np.diff(np.flatnonzero(cut.active)) > 1])
    models = [model(mean, covariance, layout_of(2)) for model in (independent, shared)]
    found = smooth(problem, models, breaks=gaps)
    pairs = [_coefficients(found.mean[:, 2 * i : 2 * i + 2]) for i in range(2)]
    return np.concatenate(pairs, axis=1), found


def tangential_deviation(cut: SimulatedCut, found: np.ndarray, trajectory: Trajectory) -> np.ndarray:
    """How sure the smoother is of the tangential force, k_t and m_t, to first order.

    found : (active, 4)   returns standard deviations, (3, active): N, N/mm^2, 1
    """
    P, k, distance = trajectory.covariance[:, :2, :2], found[:, 0], np.log(CHIP / REFERENCE_CHIP)
    _, by = force_and_slopes(_tables(CHIP), trajectory.mean[:, 0], trajectory.mean[:, 1], CHIP)
    of_k = k[:, np.newaxis] * np.array([1.0, distance])  # dk/d(kappa, m)
    of_m = np.broadcast_to([0.0, 1.0], of_k.shape)
    return np.sqrt(np.stack([np.einsum("sa,sab,sb->s", slope, P, slope) for slope in (by, of_k, of_m)]))


def box_prior() -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of kappa_t, m_t, kappa_r, m_r where k and m are uniform in the box.   returns (4,), (4, 4)"""
    mean, covariance = np.zeros(4), np.zeros((4, 4))
    distance = np.log(CHIP / REFERENCE_CHIP)
    for i in (0, 2):
        (a, b), (low, high) = BOX[i], BOX[i + 1]
        first = (b * np.log(b) - a * np.log(a)) / (b - a) - 1  # E ln k
        second = (b * np.log(b) ** 2 - a * np.log(a) ** 2) / (b - a) - 2 * first  # E ln^2 k
        of_rise = (high - low) ** 2 / 12
        mean[i], mean[i + 1] = first - distance * (low + high) / 2, (low + high) / 2
        covariance[i, i] = second - first**2 + distance**2 * of_rise
        covariance[i, i + 1] = covariance[i + 1, i] = -distance * of_rise
        covariance[i + 1, i + 1] = of_rise
    return mean, covariance


def tangential_error(cut: SimulatedCut, found: np.ndarray) -> np.ndarray:
    """Delta F_t of eq. 25: what the coefficients found make of the force, less what the true ones do.

    found : (..., active, 4)   returns (..., active) N
    """
    shape, _ = shape_and_slope(_tables(REFERENCE_CHIP, wide=True), found[..., 1])
    return found[..., 0] * shape - cut.clean[cut.active, 0]


def in_newtons(tables: ShapeTables) -> ShapeTables:
    """Tables that make newtons of a specific force in N/mm^2."""
    return tables._replace(coefficients=1e6 * tables.coefficients)


def _levels(pairs: np.ndarray) -> np.ndarray:
    """k, m to kappa, m.   pairs : (..., 2)"""
    return np.stack([np.log(pairs[..., 0]) - pairs[..., 1] * np.log(CHIP / REFERENCE_CHIP), pairs[..., 1]], axis=-1)


def _coefficients(states: np.ndarray) -> np.ndarray:
    """kappa, m to k, m.   states : (..., 2)"""
    return np.stack([np.exp(states[..., 0] + states[..., 1] * np.log(CHIP / REFERENCE_CHIP)), states[..., 1]], axis=-1)


def _beginning(state: np.ndarray) -> Mixture:
    """All models where an ensemble is.   state : kappa and m of both directions, of the members, (member, 4)"""
    covariance = np.diag([0.0] * 4 + [SPEED**2] * 2)
    covariance[:4, :4] = np.cov(state.T, bias=True)
    return start(np.append(state.mean(axis=0), [0.0, 0.0]), covariance, len(DRIFTS))


@lru_cache(maxsize=4)
def _tables(reference_chip: float, wide: bool = False) -> ShapeTables:
    """Of the active samples, for k in N/mm^2."""
    place = geometry()
    options: dict[str, Any] = {"rise": _WIDE, "degree": _WIDE_DEGREE} if wide else {}
    chips, disc_height = place.chips[:, :, place.active], CONDITIONS.axial_depth / DISCS
    return in_newtons(shape_tables(chips, disc_height, reference_chip, **options))
