"""Sudden changes in a record whose trends are smoothed: where they are, whether they pay, and how large they are.

The Bayes factor of a shock at every step comes with a pass of the smoother [deJong1988]_: the best is put in, kept if the
evidence pays for its place, moved to where it is best among the others, and taken out again if it no longer pays.

References
----------
.. [deJong1988] P. de Jong, A cross-validation filter for time series models, Biometrika 75 (1988) 594-600.
"""

import numpy as np

from millcal.numerics.state_space import filter_states, shock_evidence, smooth_states
from millcal.numerics.trend_fit import TrendFit, fit_at, guessed, likeliest, price, usual_scales, with_jumps

SLOW = 0.03  # scale of a trend that cannot swallow a jump
MOST_JUMPS = 8
AT_ODDS = 3.5  # standard deviations by which a block's own residual may exceed what is usual
LEAST_GAIN = 1.0  # of a jump at given scales, below which none is tried
DOUBT = 3.0  # a guess of the evidence that misses by less than this is worth a fit
APART = 10  # steps between two jumps at least: nearer ones are one that is not where it seems, or a misfit
REACH = 60  # steps to either side over which the place of a jump is refined


def find_jumps(fit: TrendFit, *, reach: int = REACH) -> TrendFit:
    """Put in jumps that the evidence pays for, move them to where they are best, and take out those that no longer pay.

    They are looked for in the linearised record, from the likeliest scales and, where that leads nowhere, from a trend too
    slow to swallow a jump; what promises to pay is fitted.
    reach : blocks to either side over which a place is refined
    """
    slow = np.where(usual_scales(fit.model, 1.0, 0.0) > 0, np.minimum(fit.scales, SLOW), fit.scales)
    for scales in (None, slow):
        while len(fit.jumps) < MOST_JUMPS:
            found = _promising(fit, fit.scales if scales is None else scales)
            if found is None:
                break
            likely, jumps = found
            candidate = likeliest(fit_at(fit.problem, fit.model, likely, jumps, start=fit), 1)
            if candidate.evidence <= fit.evidence:
                break
            fit = candidate
    return pruned(refined(fit, reach))


def _promising(fit: TrendFit, scales: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]] | None:
    """Jumps that are put in one by one, the best at these scales, as long as they pay there or at the likeliest scales.

    Of jumps that undo each other the first alone does not pay at the likeliest scales; with slow trends it does.
    returns the likeliest scales and the jumps of the largest evidence, None where it does not come near that of the fit
    """
    jumps, likely, best = fit.jumps, fit.scales, None
    most = fit.evidence - DOUBT
    while len(jumps) < MOST_JUMPS:
        seen, intensity = with_jumps(fit, jumps), scales[fit.model.scale_of]
        filtered = filter_states(fit.model.dynamics, intensity, seen)
        smoothed = smooth_states(fit.model.dynamics, intensity, seen, filtered, covariance=False)
        gain = shock_evidence(smoothed, fit.model.shock)
        gain[_taken(fit, jumps)] = -np.inf
        at = int(np.argmax(gain))
        if gain[at] < LEAST_GAIN:
            break
        jumps = tuple(sorted((*jumps, at)))
        likely, evidence = guessed(fit, jumps, likely)
        if evidence > most:
            best, most = (likely, jumps), evidence
        elif gain[at] < price(fit, (at,)):
            break
    return best


def _taken(fit: TrendFit, jumps: tuple[int, ...] | list[int]) -> np.ndarray:
    """Blocks where no further jump can be: the first, and those too near to one.   returns (block,) bool"""
    first = np.searchsorted(fit.problem.block, np.arange(len(fit.state)))
    taken = np.zeros(len(first), bool)
    taken[0] = True
    for at in jumps:
        taken |= np.abs(first - first[at]) < APART
    return taken


def refined(fit: TrendFit, reach: int) -> TrendFit:
    """Each jump where its Bayes factor is largest, all others in place; twice."""
    for _ in range(2):
        jumps = list(fit.jumps)
        for number, at in enumerate(fit.jumps):
            others = [*jumps[:number], *jumps[number + 1 :]]
            seen = with_jumps(fit, others)
            intensity = fit.scales[fit.model.scale_of]
            filtered = filter_states(fit.model.dynamics, intensity, seen)
            smoothed = smooth_states(fit.model.dynamics, intensity, seen, filtered, covariance=False)
            gain = shock_evidence(smoothed, fit.model.shock)
            gain[_taken(fit, others)] = -np.inf
            low = max(at - reach, 1)
            near = gain[low : at + reach + 1]
            if np.isfinite(near).any():
                jumps[number] = low + int(np.argmax(near))
        if tuple(sorted(jumps)) == fit.jumps:
            break
        moved = fit_at(fit.problem, fit.model, fit.scales, sorted(jumps), start=fit)
        if moved.evidence <= fit.evidence:
            break
        fit = moved
    return fit


def pruned(fit: TrendFit) -> TrendFit:
    """Without the jumps whose evidence does not pay for their place."""
    while fit.jumps:
        without = []
        for i in range(len(fit.jumps)):
            others = (*fit.jumps[:i], *fit.jumps[i + 1 :])
            scales, evidence = guessed(fit, others, fit.scales)
            if evidence > fit.evidence - DOUBT:
                without.append(likeliest(fit_at(fit.problem, fit.model, scales, others, start=fit), 1))
        best = max([fit, *without], key=lambda candidate: candidate.evidence)
        if best is fit:
            break
        fit = best
    return fit


def blocks_at_odds(fit: TrendFit) -> np.ndarray:
    """Blocks that no parameters explain as others are explained: there may be a jump within.   returns blocks, sorted"""
    count = np.bincount(fit.problem.block)
    if count.max() == 1:
        return np.zeros(0, np.int64)
    freedom = np.maximum(count * fit.problem.measured.shape[1] - len(fit.model.limits), 0)
    unexplained = fit.seen.value[:, -1] ** 2
    usual = np.median(unexplained[freedom > 0] / freedom[freedom > 0]) if np.any(freedom) else 1.0
    excess = (unexplained / max(usual, 1e-300) - freedom) / np.sqrt(2 * np.maximum(freedom, 1))
    worst = np.argsort(excess)[-2 * MOST_JUMPS :]
    return np.sort(worst[(excess[worst] > AT_ODDS) & (freedom[worst] > 0)])


def jump_sizes(fit: TrendFit) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """Each jump: its block, the change of the parameters, its covariance, and the log Bayes factor against its absence."""
    found = []
    for at in fit.jumps:
        D = np.diag(fit.model.shock)
        G = fit.model.slopes(fit.state[at : at + 1])[0]
        r, N = fit.smoothed.r[at], fit.smoothed.N[at]
        others = tuple(other for other in fit.jumps if other != at)
        without = fit_at(fit.problem, fit.model, fit.scales, others, start=fit)
        factor = fit.log_likelihood - without.log_likelihood
        found.append((at, G @ D @ r, G @ (D - D @ N @ D) @ G.T, factor))
    return found
