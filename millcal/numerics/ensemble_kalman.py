"""Ensemble Kalman filters for coefficients that an observation sees through any function: one instant at a time.

The members are the states themselves; what they predict is handed in, row by row. Written as an inverse problem (Schwenzer
et al. 2020, eq. 18, whose two covariances are printed the other way round, and whose prediction must be of the same instant)

    C = Cov(X, Y),  D = Cov(Y, Y),  R = Cov(E, E),      x_j += C (D + R)^-1 (y + e_j - y_j),

with X the members, Y their predictions and E the perturbations of the observation. The form with the predictions in the
state, [Y; X] and H = [I 0] (eq. 12), moves the members alike. All covariances here divide by the number of members.

Order of the draws, for whoever repeats these steps elsewhere: `walk` draws standard_normal((member, state)), the perturbed
update standard_normal((member, observation)), the inflation permutation(member) and standard_normal((count, state)).
Nothing is drawn for what is not asked for.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

Observe = Callable[[np.ndarray], np.ndarray]  # members (member, state) -> predictions (member, observation)
Disc = tuple[int, float]  # the first of two neighbouring states, and the radius of the disc about 0 that holds both


class Ensemble(NamedTuple):
    """Where the filter stands."""

    members: np.ndarray  # (member, state)
    covariance0: np.ndarray  # (state, state), or of the first states: what an inflation goes back to
    updates: int = 0  # taken in so far


class Inflation(NamedTuple):
    """Some members are drawn anew about the mean, again and again, lest the ensemble stop listening."""

    every: int  # updates from one to the next
    subset: int  # members drawn anew, M
    fraction: float  # of the covariance at the start, 1/lambda


class EnsembleInfo(NamedTuple):
    """What an update met."""

    innovation: np.ndarray  # (observation,): observation less the mean prediction
    innovation_covariance: np.ndarray  # (observation, observation), as predicted: D + noise
    spread: np.ndarray  # (state,): standard deviation of the members afterwards
    at_bound: np.ndarray  # (state,): share of the members at a bound afterwards


Update = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def start(members: np.ndarray) -> Ensemble:
    """The filter before the first observation.   members : (member, state), copied"""
    members = np.array(members, float)
    return Ensemble(members, _covariance(members, members))


def step(
    state: Ensemble,
    observation: np.ndarray,
    *,
    observe: Observe,
    noise: np.ndarray,
    rng: np.random.Generator,
    update: str | Update = "perturbed",
    walk: np.ndarray | None = None,
    limits: np.ndarray | None = None,
    discs: Sequence[Disc] = (),
    inflation: Inflation | None = None,
) -> tuple[Ensemble, EnsembleInfo]:
    """One observation: random walk, prediction, update, projection, and the inflation when its turn has come.

    observation : (observation,)   noise : its covariance, (observation, observation)   update : of `UPDATES`, or a function
    walk : standard deviation of the step before the observation, (state,)   limits, discs : as in `project`
    """
    members = state.members if walk is None else random_walk(state.members, walk, rng)
    predictions = observe(members)
    analyse = UPDATES[update] if isinstance(update, str) else update
    members = project(analyse(members, predictions, observation, noise, rng), limits, discs)
    updates = state.updates + 1
    if inflation is not None and updates % inflation.every == 0:
        members = inflate(members, state.covariance0, count=inflation.subset, fraction=inflation.fraction, rng=rng)
        members = project(members, limits, discs)
    info = EnsembleInfo(
        observation - predictions.mean(axis=0),
        _covariance(predictions, predictions) + noise,
        members.std(axis=0),
        at_bound(members, limits, discs),
    )
    return Ensemble(members, state.covariance0, updates), info


def perturbed(
    members: np.ndarray, predictions: np.ndarray, observation: np.ndarray, noise: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Every member meets an observation of its own (Burgers et al. 1998), with the covariance R that was really drawn.

    members : (member, state)   predictions : (member, observation)   returns the members, (member, state)
    """
    X, Y = members, predictions
    E = rng.standard_normal(Y.shape) @ semidefinite_root(noise).T
    C, D, R = _covariance(X, Y), _covariance(Y, Y), E.T @ E / len(E)
    return X + (observation + E - Y) @ np.linalg.solve(D + R, C.T)


def square_root(
    members: np.ndarray, predictions: np.ndarray, observation: np.ndarray, noise: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Nothing is drawn: the symmetric transform of the ensemble (Bishop et al. 2001; Wang, Bishop & Julier 2004).

    X' = (I + S S')^(-1/2) X with S the predictions' deviations in units of the noise; few observations, so by the SVD of S.
    The mean and the covariance are those of the Kalman filter that takes C and D for its own.
    members : (member, state)   predictions : (member, observation)   returns the members, (member, state)
    """
    mean, J = members.mean(axis=0), len(members)
    A = members - mean
    L = np.linalg.cholesky(noise)
    S = np.linalg.solve(L, (predictions - predictions.mean(axis=0)).T).T / np.sqrt(J)
    U, s, Vt = np.linalg.svd(S, full_matrices=False)
    whitened = np.linalg.solve(L, observation - predictions.mean(axis=0))
    shift = (A.T @ U / np.sqrt(J)) @ (s / (1 + s**2) * (Vt @ whitened))
    return mean + shift + A + U @ ((1 / np.sqrt(1 + s**2) - 1)[:, np.newaxis] * (U.T @ A))


UPDATES: dict[str, Update] = {"perturbed": perturbed, "square-root": square_root}


def random_walk(members: np.ndarray, deviation: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What coefficients that change unseen may have done since the last observation.   deviation : (state,)"""
    return members + rng.standard_normal(members.shape) * deviation


def inflate(
    members: np.ndarray, covariance0: np.ndarray, *, count: int, fraction: float, rng: np.random.Generator
) -> np.ndarray:
    """A few members, chosen at random, are drawn anew from N(mean of all, fraction x covariance at the start).

    Schwenzer et al. 2020, section 3.3, where the rule is left open; this one reproduces their Table 3. States beyond those
    of `covariance0`, such as those of a filter that the predictions run through, take the mean.
    covariance0 : (n, n), of the first n states   returns (member, state)
    """
    n = len(covariance0)
    chosen = rng.permutation(len(members))[:count]
    z = rng.standard_normal((count, n))
    inflated = members.copy()
    inflated[chosen] = members.mean(axis=0)
    inflated[chosen, :n] += np.sqrt(fraction) * z @ semidefinite_root(covariance0).T
    return inflated


def project(members: np.ndarray, limits: np.ndarray | None, discs: Sequence[Disc] = ()) -> np.ndarray:
    """The nearest members within a box and within discs; those inside stay as they are.

    limits : lowest and highest of the first states, (n, 2); infinite ends are none
    discs : of pairs of states whose limits, if any, hold the whole disc   returns (member, state)
    """
    projected = members.copy()
    if limits is not None:
        n = len(limits)
        projected[:, :n] = np.clip(projected[:, :n], limits[:, 0], limits[:, 1])
    for first, radius in discs:
        distance = np.hypot(projected[:, first], projected[:, first + 1])
        outside = distance > radius
        projected[outside, first : first + 2] *= (radius / distance[outside])[:, np.newaxis]
    return projected


def at_bound(members: np.ndarray, limits: np.ndarray | None, discs: Sequence[Disc] = ()) -> np.ndarray:
    """The share of members that stand at an end of a box or on the rim of a disc.   returns (state,)"""
    share = np.zeros(members.shape[1])
    if limits is not None:
        n = len(limits)
        share[:n] = np.mean((members[:, :n] <= limits[:, 0]) | (members[:, :n] >= limits[:, 1]), axis=0)
    for first, radius in discs:
        rim = np.hypot(members[:, first], members[:, first + 1]) >= radius * (1 - 1e-12)
        share[first : first + 2] = np.maximum(share[first : first + 2], np.mean(rim))
    return share


def semidefinite_root(covariance: np.ndarray) -> np.ndarray:
    """Lower triangular L with L L' = covariance; a state without variance of its own gets a column of zeros.

    Cholesky's, where a pivot below 1e-13 of its diagonal is nothing: known states need no special case.
    """
    P = np.asarray(covariance, float)
    L = np.zeros_like(P)
    for j in range(len(P)):
        pivot = P[j, j] - L[j, :j] @ L[j, :j]
        if pivot > 1e-13 * P[j, j]:
            L[j, j] = np.sqrt(pivot)
            L[j + 1 :, j] = (P[j + 1 :, j] - L[j + 1 :, :j] @ L[j, :j]) / L[j, j]
    return L


def _covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of two sets of columns, over the members.   a : (member, p)   b : (member, q)   returns (p, q)"""
    return (a - a.mean(axis=0)).T @ (b - b.mean(axis=0)) / len(a)
