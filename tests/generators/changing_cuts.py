"""Cuts with changing coefficients as problems for the smoother, with runout or a low-pass in the record, the model, or neither.

The parameters are [ln k_t(h0), m_t, ln k_r(h0), m_r], k in N/mm^2 as in the paper, of force in the axes of the edge; where
the runout is looked for too, c0 and s0 in um follow. sigma is the root mean square of the air cut.

    record = recorded("ascending", seed=3)          as the paper has it
    record = recorded("wear+chip", 3, runout=KNOWN, modelled=Effects(runout=None))
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, lfilter

from millcal.numerics.smoothing import Problem
from millcal.numerics.trend_models import TrendModel, independent, layout_of, shared
from millcal.numerics.whitening import fit_autoregression, whiten
from millcal.physics.disc_force import ShapeTables, is_cutting, shape, shape_and_slope, shape_tables
from millcal.studies import trending_cuts as cuts

H0 = 0.06  # mm
LAYOUT = layout_of(2)
TAIL = 25  # samples after the exit in which a low-pass still shows the cut
FORGOTTEN = 35  # and after which it shows nothing
RUNOUT, RUNOUT_ANGLE = 12e-3, 1.0  # mm, rad


class Effects(NamedTuple):
    """What the force went through."""

    runout: float = 0.0  # mm, in the direction RUNOUT_ANGLE
    low_pass: float | None = None  # Hz, of second order
    delay: float = 0.0  # samples
    noise_before: bool = False  # the noise goes through the low-pass too, and a tenth of it is added behind
    whitened: bool = False


@dataclass(frozen=True)
class Record:
    """A problem, and what is true."""

    problem: Problem
    sigma: np.ndarray  # (2,) N
    truth: np.ndarray  # (step, 4) k_t, m_t, k_r, m_r
    clean: np.ndarray  # (step, 2) N, before any filter
    cutting: np.ndarray  # (step,) bool: no tail
    force: object  # (step, parameter) -> N, slopes: of the model before any filter

    def errors(self, mean, covariance):
        """RMSE and the share in the 90 % interval, of F_t N, k_t N/mm^2 and m_t.   returns two of (3,)"""
        force, slopes = self.force(mean)
        k, of_k = specific_force(mean)
        J = np.stack([slopes[:, 0], of_k, np.tile(np.eye(mean.shape[1])[1], (len(mean), 1))], axis=1)
        sd = np.sqrt(np.einsum("siP,sPQ,siQ->si", J, covariance, J))
        error = np.stack([force[:, 0] - self.clean[:, 0], k - self.truth[:, 0], mean[:, 1] - self.truth[:, 1]], axis=1)
        error, sd = error[self.cutting], sd[self.cutting]
        return np.sqrt(np.mean(error**2, axis=0)), np.mean(np.abs(error) < 1.645 * sd, axis=0)

    def chi2(self, fit):
        """Mean square of what is left."""
        predicted, _ = self.problem.predict(fit.model.parameters(fit.state)[fit.problem.block])
        return float(np.mean((self.problem.measured - predicted) ** 2))


def specific_force(mean):
    """k_t at 1 mm, and its slopes.   returns (step,), (step, parameter)"""
    k = np.exp(mean[:, 0] + mean[:, 1] * np.log(H0))
    slopes = np.zeros(mean.shape)
    slopes[:, 0], slopes[:, 1] = k, k * np.log(H0)
    return k, slopes


@lru_cache
def prior() -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the parameters when k and m are uniform in the box of Table 2."""
    rng = np.random.default_rng(0)
    mean, covariance = np.zeros(4), np.zeros((4, 4))
    for d in (0, 2):
        k, m = (rng.uniform(*cuts.BOX[d + i], 200_000) for i in range(2))
        pair = np.stack([np.log(k) - m * np.log(H0), m])
        mean[d : d + 2], covariance[d : d + 2, d : d + 2] = pair.mean(axis=1), np.cov(pair)
    return mean, covariance


def models(runout: bool = False) -> tuple[TrendModel, TrendModel]:
    """Both models of change; with c0 and s0, um, unknown to +-20."""
    mean, covariance = prior()
    if runout:
        mean = np.concatenate([mean, [0.0, 0.0]])
        covariance = np.block([[covariance, np.zeros((4, 2))], [np.zeros((2, 4)), 400 * np.eye(2)]])
    return independent(mean, covariance, LAYOUT), shared(mean, covariance, LAYOUT)


def disc_height() -> float:
    """mm"""
    return 1e3 * cuts.CONDITIONS.axial_depth / cuts.DISCS


@lru_cache
def lags() -> tuple[np.ndarray, np.ndarray]:
    """cos and -sin of each tooth's and disc's angle behind the bottom of tooth 0.   returns two of (tooth, disc, 1)"""
    height = cuts.CONDITIONS.axial_depth / cuts.DISCS * np.arange(cuts.DISCS)
    helix = np.tan(cuts.CUTTER.helix) * 2 / cuts.CUTTER.diameter * height
    lag = 2 * np.pi / cuts.CUTTER.teeth * np.arange(cuts.CUTTER.teeth)[:, np.newaxis] + helix
    return np.cos(lag)[:, :, np.newaxis], -np.sin(lag)[:, :, np.newaxis]


def chips_with(c0: float, s0: float) -> tuple[np.ndarray, np.ndarray]:
    """Chips of each tooth and disc in mm, and their slopes in c0 and s0; a tooth cuts behind the one before.

    returns (tooth, disc, sample), (2, tooth, disc, 1)
    """
    slopes = np.stack([part - np.roll(part, 1, axis=0) for part in lags()])
    round_chips = 1e3 * cuts.geometry().chips
    chips = np.where(round_chips > 0, round_chips + c0 * slopes[0] + s0 * slopes[1], 0.0)
    return np.maximum(chips, 0.0), slopes


@lru_cache(maxsize=4)
def tables(c0: float, s0: float) -> ShapeTables:
    """S(m) of all samples, with chips in mm."""
    return shape_tables(chips_with(c0, s0)[0], disc_height(), 1.0)


def force_of_discs(parameters: np.ndarray, c0: float, s0: float) -> tuple[np.ndarray, np.ndarray]:
    """Force at all samples by the tables.   parameters : (sample, 4)   returns (sample, 2) N, (sample, 2, 4)"""
    S, dS = (v.T for v in shape_and_slope(tables(c0, s0), parameters[:, 1::2].T))
    k = np.exp(parameters[:, 0::2] + parameters[:, 1::2] * np.log(H0))
    force, slopes = k * S, np.zeros((len(parameters), 2, 4))
    for d in range(2):
        slopes[:, d, 2 * d] = force[:, d]
        slopes[:, d, 2 * d + 1] = k[:, d] * dS[:, d] + force[:, d] * np.log(H0)
    return force, slopes


def force_with_runout(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force at all samples disc by disc, c0 and s0 in um behind the four.   returns (sample, 2) N, (sample, 2, 6)"""
    chips, of_chip = chips_with(*(1e-3 * parameters[0, 4:]))
    log_chip = np.log(np.where(chips > 0, chips, 1.0))
    force, slopes = np.zeros((len(parameters), 2)), np.zeros((len(parameters), 2, 6))
    for d in range(2):
        kappa, m = parameters[:, 2 * d], parameters[:, 2 * d + 1]
        stress = disc_height() * np.exp(kappa + m * (np.log(H0) - log_chip))
        force[:, d] = np.sum(stress * chips, axis=(0, 1))
        slopes[:, d, 2 * d] = force[:, d]
        slopes[:, d, 2 * d + 1] = np.sum(stress * chips * (np.log(H0) - log_chip), axis=(0, 1))
        steep = (1 - m) * np.where(chips > 0, stress, 0.0)
        slopes[:, d, 4:] = 1e-3 * np.einsum("tdn,itdk->ni", steep, of_chip)
    return force, slopes


def through(effects: Effects, values: np.ndarray) -> np.ndarray:
    """The low-pass, or the delay, over all samples.   values : (sample, ...)"""
    if effects.low_pass is not None:
        values = lfilter(*butter(2, effects.low_pass / (cuts.SAMPLE_RATE / 2)), values, axis=0)
    if effects.delay:
        whole, part = int(effects.delay), effects.delay % 1
        late = [np.concatenate([np.zeros_like(values[: whole + i]), values[: len(values) - whole - i]]) for i in (0, 1)]
        values = (1 - part) * late[0] + part * late[1]
    return values


def recorded(
    case: str,
    seed: int,
    effects: Effects = Effects(),
    modelled: Effects | None = None,
    *,
    find_runout: bool = False,
    **options,
) -> Record:
    """A case of `trending_cuts` that went through some effects, and a model that knows of some.

    modelled : the same effects when absent   find_runout : the model has c0 and s0 as parameters
    options : of `simulate_case`
    """
    modelled = effects if modelled is None else modelled
    cut = cuts.simulate_case(case, seed, **options)
    c0, s0 = effects.runout * np.cos(RUNOUT_ANGLE), effects.runout * np.sin(RUNOUT_ANGLE)
    chips = chips_with(c0, s0)[0]
    clean = np.stack([cut.truth[:, i] * shape(chips, cut.truth[:, i + 1], disc_height(), 1.0) for i in (0, 2)], axis=1)
    noise = cut.force - cut.clean
    if effects.noise_before:
        behind = 0.1 * cut.sigma * np.random.default_rng([seed, 1]).standard_normal(clean.shape)
        force = through(effects, clean + noise) + behind
    else:
        force = through(effects, clean) + noise

    known = (modelled.runout * np.cos(RUNOUT_ANGLE), modelled.runout * np.sin(RUNOUT_ANGLE))
    cutting = is_cutting(1e-3 * chips_with(*known)[0], cuts.THRESHOLD)
    since = np.arange(len(cutting)) - np.maximum.accumulate(
        np.where(chips.any(axis=(0, 1)), np.arange(len(cutting)), -999)
    )
    used = cutting | ((since > 0) & (since <= TAIL)) if modelled.low_pass else cutting
    air = since > FORGOTTEN if effects.low_pass else cut.air
    at = np.flatnonzero(used)
    last = np.maximum(np.searchsorted(at, np.arange(len(used)), "right") - 1, 0)
    sigma = np.sqrt(np.mean(force[air] ** 2, axis=0))
    colour = [fit_autoregression(runs(force[:, d], air)) for d in range(2)] if modelled.whitened else None

    def white(values: np.ndarray) -> np.ndarray:
        if colour is None:
            return values / sigma.reshape(1, 2, *[1] * (values.ndim - 2))
        return np.stack([whiten(colour[d], values[:, d]) for d in range(2)], axis=1)

    def plain(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return force_with_runout(p) if find_runout else force_of_discs(p, *known)

    def predict(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        predicted, slopes = plain(p[last])
        return tuple(white(through(modelled, values))[used] for values in (predicted, slopes))

    return Record(
        Problem(white(force)[used], predict, cut.time[used], np.arange(len(at))),
        sigma,
        cut.truth[used],
        clean[used],
        cutting[used],
        lambda p: tuple(values[used] for values in plain(p[last])),
    )


def runs(values: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """The stretches of chosen samples."""
    at = np.flatnonzero(chosen)
    return np.split(values[at], 1 + np.flatnonzero(np.diff(at) > 1))


def long_cut(seconds: float, seed: int = 0) -> Record:
    """Whole revolutions at a constant speed: k and m along one period of a cosine, +-20 %, and +10 % at once at 0.6 of the time.

    The spindle angle of every revolution is the same, so that one table serves them all.
    """
    per_turn = cuts.SAMPLES_PER_REVOLUTION
    turns = int(seconds * cuts.SAMPLE_RATE / per_turn)
    active = np.flatnonzero(cuts.geometry().active[:per_turn])
    table = tables(0.0, 0.0).of(active)
    time = (np.arange(turns)[:, np.newaxis] * per_turn + active).ravel() / (turns * per_turn)
    truth = cuts.TRUE * (1 + 0.2 * np.cos(2 * np.pi * time) + 0.1 * (time >= 0.6))[:, np.newaxis]

    def force(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k = np.exp(p[:, 0::2] + p[:, 1::2] * np.log(H0))
        found, slopes = np.empty((len(p), 2)), np.zeros((len(p), 2, p.shape[1]))
        for d in range(2):
            S, dS = shape_and_slope(table, p[:, 2 * d + 1].reshape(turns, -1))
            found[:, d] = k[:, d] * S.ravel()
            slopes[:, d, 2 * d] = found[:, d]
            slopes[:, d, 2 * d + 1] = k[:, d] * dS.ravel() + found[:, d] * np.log(H0)
        return found, slopes

    level = np.log(truth[:, 0::2]) - truth[:, 1::2] * np.log(H0)
    clean, _ = force(np.stack([level[:, 0], truth[:, 1], level[:, 1], truth[:, 3]], axis=1))
    sigma = np.sqrt(np.mean(clean**2, axis=0) * len(active) / per_turn / 10 ** (cuts.NOISE_DB / 10))
    measured = clean / sigma + np.random.default_rng([seed, 2]).standard_normal(clean.shape)

    def predict(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, slopes = force(p)
        return found / sigma, slopes / sigma[:, np.newaxis]

    steps = np.arange(len(time))
    return Record(Problem(measured, predict, time, steps), sigma, truth, clean, np.ones(len(time), bool), force)
