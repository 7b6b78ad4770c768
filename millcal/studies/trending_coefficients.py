"""Schwenzer et al., "Identifying trending model coefficients with an ensemble Kalman filter", IFAC 2020: their Table 3 again.

Sixteen settings of the ensemble Kalman filter follow coefficients that rest, rise or swing, from many initial ensembles; beside
them recursive least squares as the paper has it and without its box, and two methods that the paper did not try. The force
error is that of eq. 25, its root mean square over the starts and over the samples at which the filters are active.

One draw of the measurement noise decides more than a thousand starts do: one table says little of the method. So the study
draws the noise anew, with fewer starts, and says how far the numbers of a table scatter; what one setting is worth against
another is judged by the ratio on the same noise.

What had to be settled to compute anything (the evidence is the table itself)
    eq. 18-20   C and D are printed the other way round: a gain C (D + Gamma)^-1 of theirs cannot be formed
    eq. 18      the prediction is of the same sample as the measurement
    eq. 21      P_0 / lambda, given to ten members drawn anew about the mean of all
    eq. 24      a disc is engaged where its angle is above entry *and* below exit
    eq. 4, 6    f(x_{k-1}) on the right, and 1/rho
    Gamma       the variance of the noise
"""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from millcal.studies.trending_cuts import CASES, PAPER_CASES, SimulatedCut, geometry, simulate_case
from millcal.studies.trending_methods import (
    by_ensemble,
    by_least_squares,
    by_models,
    by_smoothing,
    ensembles,
    inflation_of,
    perturbations,
    tangential_deviation,
    tangential_error,
)

__all__ = ["CASES", "FULL", "PAPER_CASES", "QUICK", "Extent", "Study", "run", "simulate_case"]

Progress = Callable[[float, str], None]

STEPS, DIVISORS = (50, 100, 200), (1.0, 1.5, 2.0, 5.0, 10.0)  # of the inflation: active samples, lambda
PAPER: dict[tuple[int, float] | None, tuple[float, float, float]] = {  # Table 3, N; None: the classic filter
    None: (3.8, 23.2, 50.7),
    (50, 1.0): (7.8, 8.6, 8.6),
    (50, 1.5): (7.6, 8.4, 8.5),
    (50, 2.0): (7.5, 8.3, 8.5),
    (50, 5.0): (6.9, 7.7, 8.4),
    (50, 10.0): (6.4, 7.2, 8.9),
    (100, 1.0): (6.6, 7.3, 11.5),
    (100, 1.5): (6.5, 7.2, 11.9),
    (100, 2.0): (6.4, 7.1, 12.2),
    (100, 5.0): (6.0, 6.8, 13.0),
    (100, 10.0): (5.6, 6.6, 14.1),
    (200, 1.0): (4.7, 7.3, 19.6),
    (200, 1.5): (4.6, 7.3, 20.2),
    (200, 2.0): (4.6, 7.3, 20.6),
    (200, 5.0): (4.4, 7.2, 22.2),
    (200, 10.0): (4.2, 7.3, 23.6),
}
CHOSEN = (50, 10.0)  # the setting that the paper recommends and draws
ENKF, RLS, FREE, MODELS, SMOOTHER = "EnKF", "RLS", "RLS, no box", "IMM", "smoother"


def name_of(setting: tuple[int, float] | None) -> str:
    """EnKF, or EnKF* with step and lambda."""
    return ENKF if setting is None else f"{ENKF}* {setting[0]}, {setting[1]:g}"


ENSEMBLES = {name_of(setting): setting for setting in PAPER}
STARRED = name_of(CHOSEN)
METHODS = (*ENSEMBLES, RLS, FREE, MODELS, SMOOTHER)


class Claim(NamedTuple):
    """That one method has a smaller or a larger force error than another in a case."""

    method: str
    other: str
    case: str
    smaller: bool
    said: bool  # by the paper, in its table or its text; else by this study


CLAIMS = (
    Claim(STARRED, ENKF, "static", False, True),
    Claim(STARRED, ENKF, "ascending", True, True),
    Claim(STARRED, ENKF, "alternating", True, True),
    Claim(STARRED, name_of((50, 1.0)), "static", True, True),
    Claim(name_of((200, 10.0)), STARRED, "static", True, True),
    Claim(name_of((200, 10.0)), STARRED, "alternating", False, True),
    Claim(STARRED, RLS, "static", True, True),
    Claim(STARRED, RLS, "ascending", True, True),
    Claim(STARRED, RLS, "alternating", True, True),
    Claim(RLS, FREE, "static", True, True),
    *(Claim(better, STARRED, case, True, False) for better in (MODELS, SMOOTHER) for case in PAPER_CASES),
)


class Extent(NamedTuple):
    """How much is computed."""

    starts: int  # initial ensembles of the table
    draws: int  # of the noise, for the scatter
    starts_of_draw: int


FULL, QUICK = Extent(1000, 24, 24), Extent(24, 4, 8)


class Runs(NamedTuple):
    """What all starts of a method come to in a case, on one draw of the noise."""

    force_rms: float  # N, of eq. 25, tangential
    k_rms: float  # N/mm^2, of k_t in the second half of the record
    m_rms: float  # of m_t, likewise
    mean: np.ndarray  # (3, active) over the starts: force error N, k_t N/mm^2, m_t
    deviation: np.ndarray  # (3, active) between the starts; of the smoother, which has no starts, its own


class Paired(NamedTuple):
    """A claim beside the ratios of the two errors, each of the two on the same noise."""

    claim: Claim
    paper: float | None  # ratio in Table 3
    ratios: np.ndarray  # (draw,)

    @property
    def holds(self) -> int:
        """In how many draws."""
        return int(np.count_nonzero(self.ratios < 1 if self.claim.smaller else self.ratios > 1))


class Study(NamedTuple):
    """The table and its scatter."""

    seed: int
    extent: Extent
    runs: Mapping[str, Mapping[str, Runs]]  # by method and case
    scatter: Mapping[str, np.ndarray]  # by method: force_rms, (draw, case) N
    claims: tuple[Paired, ...]
    truth: Mapping[str, np.ndarray]  # by case: k_t, m_t, k_r, m_r of the active samples, (active, 4)
    smoothers: Mapping[str, tuple[str, int]]  # by case: which trend model had the larger evidence, and its jumps


def run(extent: Extent = FULL, *, seed: int = 0, progress: Progress | None = None) -> Study:
    """All methods in the three cases, then again on fresh noise.

    seed : of the noise, the ensembles and all that the filters draw   progress : told the share done and what is done
    """
    tell = progress or (lambda share, label: None)
    passes = extent.starts + extent.draws * extent.starts_of_draw

    def share(done: int, label: str) -> None:
        tell(done / passes, label)

    cuts = {case: simulate_case(case, seed) for case in PAPER_CASES}
    smoothers: dict[str, tuple[str, int]] = {}
    runs = _all_methods(cuts, seed, extent.starts, lambda n: share(n, f"start {n + 1} of {extent.starts}"), smoothers)
    scatter: dict[str, list[list[float]]] = {method: [] for method in METHODS}
    for draw, fresh in enumerate(fresh_seeds(seed, extent.draws)):
        done = extent.starts + draw * extent.starts_of_draw
        label = f"noise {draw + 1} of {extent.draws}"
        again = _all_methods(
            {case: simulate_case(case, fresh) for case in PAPER_CASES},
            fresh,
            extent.starts_of_draw,
            lambda n, done=done, label=label: share(done + n, label),  # type: ignore[misc]
        )
        for method in METHODS:
            scatter[method].append([again[method][case].force_rms for case in PAPER_CASES])
    tell(1.0, "done")
    scattered = {method: np.array(rows) for method, rows in scatter.items()}
    truth = {case: cut.active_truth for case, cut in cuts.items()}
    return Study(seed, extent, runs, scattered, tuple(_paired(scattered)), truth, smoothers)


def fresh_seeds(seed: int, count: int) -> list[int]:
    """Seeds of other draws of everything, which depend on one."""
    return [int(word) for word in np.random.SeedSequence([seed, 9]).generate_state(count)]


def force_rms_of_ensembles(
    cut: SimulatedCut, setting: tuple[int, float] | None, seed: int, starts: int, *, lag: int = 0
) -> float:
    """The force error of one setting.

    lag : samples by which the measurement comes after the prediction; eq. 18 as printed has 1
    """
    if lag:
        cut = cut._replace(force=np.roll(cut.force, -lag, axis=0))
    inflation = None if setting is None else inflation_of(*setting)
    members = ensembles(seed, starts)
    paths = [
        by_ensemble(cut, members[number], normals, _inflating(seed, number), inflation)
        for number, normals in enumerate(perturbations(seed, starts))
    ]
    return float(np.sqrt(np.mean(tangential_error(cut, np.array(paths)) ** 2)))


def _inflating(seed: int, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, 3, number])


def _all_methods(
    cuts: Mapping[str, SimulatedCut],
    seed: int,
    starts: int,
    tell: Callable[[int], None],
    smoothers: dict[str, tuple[str, int]] | None = None,
) -> dict[str, dict[str, Runs]]:
    """Every method in every case, from the same initial ensembles and with the same perturbations.

    smoothers : takes what the smoother says of its model
    """
    members = ensembles(seed, starts)
    sums = {(method, case): _Sums(cut) for method in METHODS for case, cut in cuts.items()}
    for number, normals in enumerate(perturbations(seed, starts)):
        tell(number)
        for case, cut in cuts.items():
            for method, setting in ENSEMBLES.items():
                inflation = None if setting is None else inflation_of(*setting)
                found = by_ensemble(cut, members[number], normals, _inflating(seed, number), inflation)
                sums[method, case].add(found)
    sure = {}
    for case, cut in cuts.items():
        for method, paths in _others(cut, members):
            for path in paths:
                sums[method, case].add(path)
        smoothed, trajectory = by_smoothing(cut)
        sums[SMOOTHER, case].add(smoothed)
        sure[case] = tangential_deviation(cut, smoothed, trajectory)
        if smoothers is not None:
            smoothers[case] = (trajectory.fit.model.name, len(trajectory.fit.jumps))
    runs = {method: {case: sums[method, case].runs() for case in cuts} for method in METHODS}
    runs[SMOOTHER] = {case: found._replace(deviation=sure[case]) for case, found in runs[SMOOTHER].items()}
    return runs


def _others(cut: SimulatedCut, members: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    means = members.mean(axis=1)
    yield RLS, by_least_squares(cut, means, box=True)
    yield FREE, by_least_squares(cut, means, box=False)
    yield MODELS, by_models(cut, members)


class _Sums:
    """Sums over the starts, so that a thousand paths need not be kept."""

    def __init__(self, cut: SimulatedCut) -> None:
        self.cut, self.count = cut, 0
        truth = cut.active_truth
        self.centre = np.stack([np.zeros(len(truth)), truth[:, 0], truth[:, 1]])  # sums of squares about it stay exact
        self.first, self.second = np.zeros_like(self.centre), np.zeros_like(self.centre)

    def add(self, found: np.ndarray) -> None:
        """found : (active, 4)"""
        off = np.stack([tangential_error(self.cut, found), found[:, 0], found[:, 1]]) - self.centre
        self.count += 1
        self.first += off
        self.second += off**2

    def runs(self) -> Runs:
        mean, square = self.first / self.count, self.second / self.count
        settled = self.cut.active_time >= 0.5
        return Runs(
            float(np.sqrt(np.mean(square[0]))),
            float(np.sqrt(np.mean(square[1, settled]))),
            float(np.sqrt(np.mean(square[2, settled]))),
            mean + self.centre,
            np.sqrt(np.maximum(square - mean**2, 0.0)),
        )


def _paired(scatter: Mapping[str, np.ndarray]) -> Iterator[Paired]:
    for claim in CLAIMS:
        column = PAPER_CASES.index(claim.case)
        printed = [PAPER[ENSEMBLES[m]][column] for m in (claim.method, claim.other) if m in ENSEMBLES]
        ratios = scatter[claim.method][:, column] / scatter[claim.other][:, column]
        yield Paired(claim, printed[0] / printed[1] if len(printed) == 2 else None, ratios)


def samples_at_work() -> int:
    """Active samples of a record."""
    return int(np.count_nonzero(geometry().active))
