"""Interacting multiple models: Kalman filters that move differently share one observation and their estimates.

A state stays with its model from one observation to the next with probability p, else goes over to any other alike (Blom &
Bar-Shalom 1988). Each step mixes the models' estimates by the chance that the state came over, lets each move it its own
way, x = F x with noise Q, takes the observation in, and weighs the models by how well they had foretold it. An observation
through a function is linearised once, at the common mean, or for each model at its own (extended Kalman filter).

So a coefficient that rests is followed with the calm of a static model, and one that drifts by the model that drifts.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

Linearised = tuple[np.ndarray, np.ndarray]  # predicted (observation,), slopes (observation, state)
Observe = Callable[[np.ndarray], Linearised]
LeftOut = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Model(NamedTuple):
    """How the state moves from one observation to the next."""

    transition: np.ndarray  # F, (state, state)
    noise: np.ndarray  # Q, (state, state)


class Mixture(NamedTuple):
    """What each model believes, and how far it is believed."""

    mean: np.ndarray  # (model, state)
    covariance: np.ndarray  # (model, state, state)
    probability: np.ndarray  # (model,)


class MixtureInfo(NamedTuple):
    """The models taken together."""

    mean: np.ndarray  # (state,)
    covariance: np.ndarray  # (state, state), with the spread between the models
    innovation: np.ndarray  # (observation,): observation less what the common mean foretells
    innovation_covariance: np.ndarray  # (observation, observation), as predicted
    log_likelihood: float  # of the observation given those before


def start(mean: np.ndarray, covariance: np.ndarray, models: int, probability: np.ndarray | None = None) -> Mixture:
    """All models begin alike.   mean : (state,)   covariance : (state, state)   probability : (model,), None: equal"""
    equal = np.full(models, 1 / models)
    return Mixture(
        np.tile(np.asarray(mean, float), (models, 1)),
        np.tile(np.asarray(covariance, float), (models, 1, 1)),
        equal if probability is None else np.asarray(probability, float),
    )


def switching(models: int, stay: float) -> np.ndarray:
    """Chances to go from one model to another, rows sum to 1.   returns (from, to)"""
    if models == 1:
        return np.ones((1, 1))
    chances = np.full((models, models), (1 - stay) / (models - 1))
    np.fill_diagonal(chances, stay)
    return chances


def step(
    state: Mixture,
    observation: np.ndarray,
    *,
    models: Sequence[Model],
    chances: np.ndarray,
    observe: Observe,
    noise: np.ndarray,
    common: bool = True,
    left_out: LeftOut | None = None,
) -> tuple[Mixture, MixtureInfo]:
    """One observation.

    observation : (observation,)   chances : as `switching`   noise : covariance, (observation, observation)
    common : linearise once, at the common predicted mean; else for each model at its own
    left_out : slopes (observation, state), common spread (state, state) -> variance of what linearising leaves out,
        (observation,), which is added to the noise
    """
    prior, mixed = mix(state, chances)
    means = np.stack([model.transition @ x for model, x in zip(models, mixed.mean, strict=True)])
    covariances = np.stack(
        [
            model.transition @ P @ model.transition.T + model.noise
            for model, P in zip(models, mixed.covariance, strict=True)
        ]
    )
    centre, spread = combine(Mixture(means, covariances, prior))
    predicted, slopes = observe(centre)
    if left_out is not None:
        noise = noise + np.diag(left_out(slopes, spread))
    log_weight = np.log(prior)
    for j in range(len(models)):
        y, H = (predicted + slopes @ (means[j] - centre), slopes) if common else observe(means[j])
        means[j], covariances[j], log_likelihood = update(means[j], covariances[j], observation - y, H, noise)
        log_weight[j] += log_likelihood
    top = log_weight.max()
    weight = np.exp(log_weight - top)
    posterior = Mixture(means, covariances, weight / weight.sum())
    mean, covariance = combine(posterior)
    info = MixtureInfo(
        mean,
        covariance,
        observation - predicted,
        slopes @ spread @ slopes.T + noise,
        float(top + np.log(weight.sum())),
    )
    return posterior, info


def mix(state: Mixture, chances: np.ndarray) -> tuple[np.ndarray, Mixture]:
    """What each model starts a step from: the states that came over to it.   returns its probability (model,) and these"""
    joint = state.probability[:, np.newaxis] * chances  # (from, to)
    prior = joint.sum(axis=0)
    share = joint / prior
    mean = share.T @ state.mean
    apart = state.mean[:, np.newaxis] - mean  # (from, to, state)
    covariance = np.einsum("ij,iab->jab", share, state.covariance) + np.einsum("ij,ija,ijb->jab", share, apart, apart)
    return prior, Mixture(mean, covariance, prior)


def combine(state: Mixture) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the mixture.   returns (state,), (state, state)"""
    mean = state.probability @ state.mean
    apart = state.mean - mean
    spread = np.einsum("j,ja,jb->ab", state.probability, apart, apart)
    return mean, np.einsum("j,jab->ab", state.probability, state.covariance) + spread


def update(
    mean: np.ndarray, covariance: np.ndarray, innovation: np.ndarray, slopes: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """The Kalman update in Joseph's form, and the log-likelihood of the innovation.

    mean : (state,)   covariance : (state, state)   innovation : (observation,)   slopes : (observation, state)
    """
    P, H = covariance, slopes
    S = H @ P @ H.T + noise
    G = np.linalg.solve(S, H @ P).T
    keep = np.eye(len(mean)) - G @ H
    updated = keep @ P @ keep.T + G @ noise @ G.T
    misfit = innovation @ np.linalg.solve(S, innovation)
    log_likelihood = -0.5 * (misfit + np.linalg.slogdet(2 * np.pi * S)[1])
    return mean + G @ innovation, (updated + updated.T) / 2, float(log_likelihood)
