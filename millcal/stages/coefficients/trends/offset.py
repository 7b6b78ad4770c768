"""What the offset of the amplifier leaves unsure: air cut of some tenths of a second does not tell it exactly.

The offset that was taken out of a cut is a mean over its air cut. What is wrong with it is in every sample alike, so that no
length of cut averages it out: after half a second of air it may be twice what the noise of the cut itself leaves unsure.
"""

import numpy as np

from millcal.stages.coefficients.trends.problem import CutRecord, Noise, evenly_spread, whitened

ENOUGH = 60_000  # samples that tell how parameters answer to an offset
WITH_DRIFT = 4 / 3  # of the variance: a line through air on both sides, on average over a cut between them


def offset_variance(record: CutRecord, noise: Noise, number: int) -> np.ndarray:
    """Of the offset that was taken out of one cut; 0 where there was no air cut to take it from.   returns (axis,) N^2"""
    cut = record.cuts[number]
    samples = cut.air_force.shape[1]
    if not samples or noise.source != "air":
        return np.zeros(len(record.axes))
    slow = np.array([channel.sd / max(1 - float(np.sum(channel.coefficients)), 0.05) for channel in noise.channels])
    return slow**2 * record.every / samples * (WITH_DRIFT if len(cut.air_spans) > 1 else 1.0)


def offset_spread(
    record: CutRecord, noise: Noise, used: np.ndarray, parameters: np.ndarray, prior_sd: np.ndarray
) -> np.ndarray:
    """Covariance that the offsets add to the parameters of each cut.

    Shapes and runout bear it as constants of all cuts do; a level, which may have changed between cuts, as in its cut alone.
    parameters : (cut, parameter), phases last   used : (sample,) bool   prior_sd : (parameter,), 0 for what is held
    returns (cut, parameter, parameter) without phases
    """
    D, own, cuts, axes = record.directions, 2 * record.directions + 2, len(record.cuts), len(record.axes)
    variance = np.array([offset_variance(record, noise, number) for number in range(cuts)])
    if not variance.any():
        return np.zeros((cuts, own, own))
    free = np.flatnonzero(prior_sd > 0)
    unit = prior_sd[free]
    part = evenly_spread(record, ENOUGH)
    some, seen = record.of(part), used[part]
    slopes = np.concatenate([some.response(parameters[some.cut])[1], some.phase_slopes(parameters[0])], axis=2)
    slopes = whitened(some, noise, slopes[:, :, free] * unit)
    per_newton = np.array(
        [(1 - float(np.sum(c.coefficients))) / c.sd for c in noise.channels]
    )  # of a constant, whitened
    normal, along = np.empty((cuts, len(free), len(free))), np.empty((cuts, len(free), axes))
    for number in range(cuts):
        X = slopes[seen & (some.cut == number)]
        share = np.sum(used & (record.cut == number)) / max(len(X), 1)
        normal[number] = np.tensordot(X, X, ([0, 1], [0, 1])) * share
        along[number] = X.sum(axis=0).T * per_newton * share

    def moved(squares: np.ndarray, number: int) -> np.ndarray:
        all_of_them = np.zeros((len(prior_sd), axes))
        all_of_them[free] = unit[:, np.newaxis] * np.linalg.solve(squares + np.eye(len(free)), along[number])
        return all_of_them[:own]

    together = [moved(normal.sum(axis=0), number) for number in range(cuts)]  # N of one cut's offset -> parameters
    added = np.zeros((cuts, own, own))
    for number in range(cuts):
        for other in range(cuts):
            response = together[other].copy()
            response[0 : 2 * D : 2] = moved(normal[number], number)[0 : 2 * D : 2] if other == number else 0.0
            added[number] += (response * variance[other]) @ response.T
    return added
