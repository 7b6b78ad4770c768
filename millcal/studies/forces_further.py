"""What else pays, and what does not, where GTLS of windowed H1 is the base: harmonics, cuts, windows, modes, angles.

Everything at one level of noise, on the study's own structure and of the same hits and cuts, so that ways differ by nothing else.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.errors_in_variables import MatrixError, parts, residual_covariance
from millcal.stages.forces.law import BELIEVED
from millcal.stages.modes import fit_modes
from millcal.studies.forces_bench import TRUE, Bench, stream
from millcal.studies.forces_cuts import (
    PASSINGS,
    SOUGHT,
    TRUTH,
    CutRecord,
    ForceLaw,
    cut_record,
    force_law,
    wanted_lines,
)
from millcal.studies.forces_methods import HARMONICS, Told, fit_gtls, gtls, lines_of, turned, with_angle
from millcal.studies.forces_tests import ImpactTest, estimates, hits_on
from millcal.studies.forces_tool import frf_of_hits, heard, told_by_tool

NOISE = (5.0, 1.0)  # N, m/s^2
SERIES = 20_000  # of the streams of random numbers
MOST_HARMONICS = 6
ANGLE = np.radians(3.0)  # by which the spindle lags where its pulse says it is
ALIKE = 3  # cuts at one speed, or at as many
STRIDE = len(PASSINGS) // ALIKE  # places between the speeds that are cut together
STEP = 0.05  # standard deviations, of the differences that are the curvature of a likelihood

BASE = "2 harmonics"
HARMONICS_TRIED = {BASE: HARMONICS, "3 harmonics": 3, "4 harmonics": 4, "6 harmonics": 6}
LOG = "+ log-determinant"
PLAIN = {"plain H1": HARMONICS, "plain H1 4 harmonics": 4}
OWN_WINDOWS, OWN_MODES = "windows found in the data", "modes found in the data"
THRICE, THRICE_APART, THREE = "the same speed", "the same speed with FRF errors unlinked", "three speeds"
MEAN, APART, TOGETHER, MODAL = "mean of single fits", "FRF errors unlinked", "one fit", "three modes fitted"
FITTED, BELIEVING = "angle fitted", "angle fitted and believed to 3°"


def of_all(way: str) -> str:
    """The name of the same with all cuts."""
    return f"{way} for 12 cuts"


WAYS: dict[str, tuple[str, ...]] = {  # by what they have in common
    "one cut": (*HARMONICS_TRIED, f"{BASE} {LOG}", *(f"{name}{end}" for name in PLAIN for end in ("", f" {LOG}"))),
    "one cut by the stages": (OWN_WINDOWS, OWN_MODES),
    "three cuts": (THRICE, THRICE_APART, THREE),
    "twelve cuts at twelve speeds": (MEAN, APART, TOGETHER, MODAL, of_all(OWN_WINDOWS), of_all(OWN_MODES)),
    "spindle 3° off": (FITTED, BELIEVING, of_all(FITTED)),
}


class Answers(NamedTuple):
    """What one way says; nan where it states no deviation, or no bound is reckoned."""

    error: np.ndarray  # of Ktc, Kte, Krc, Kre, relative: (repeat, answer, 4)
    deviation: np.ndarray  # standard deviations that are stated, relative: (repeat, answer, 4)
    bound: np.ndarray  # those of Cramer, Rao and Fisher, relative: (repeat, answer, 4)


class Said(NamedTuple):
    """One answer."""

    way: str
    told: Told
    bound: np.ndarray | None = None  # SI, (4,)


Frf = tuple[np.ndarray, MatrixError]


def run_further(bench: Bench, repeats: int, seed: int, step: Callable[[str], None]) -> dict[str, Answers]:
    """Every way, by name; nothing where there are no repeats.   step : told what is done"""
    found: dict[str, list[list[Said]]] = {}
    for repeat in range(repeats):
        step(f"what else pays, {repeat + 1} of {repeats}")
        own: dict[str, list[Said]] = {}
        for said in _of_one_test(bench, seed, repeat):
            own.setdefault(said.way, []).append(said)
        for way, answers in own.items():
            found.setdefault(way, []).append(answers)
    nothing = np.full(len(SOUGHT), np.nan)

    def table(way: str, of: Callable[[Said], np.ndarray | None]) -> np.ndarray:
        rows = [[of(said) for said in answers] for answers in found[way]]
        return np.array([[nothing if row is None else row / TRUE for row in own] for own in rows])

    return {
        way: Answers(
            table(way, lambda said: said.told.value) - 1,
            table(way, lambda said: said.told.deviation),
            table(way, lambda said: said.bound),
        )
        for ways in WAYS.values()
        for way in ways
        if way in found
    }


def _of_one_test(bench: Bench, seed: int, repeat: int) -> Iterator[Said]:
    """One impact test, cuts at all speeds, and all that can be made of them."""
    hits = hits_on(bench.hammer, *NOISE, stream(seed, SERIES, 0, repeat))
    test = estimates(hits, wanted_lines(PASSINGS, MOST_HARMONICS))
    cuts = {passing: [_cut(bench, seed, repeat, passing, number) for number in range(ALIKE)] for passing in PASSINGS}
    first = [cuts[passing][0] for passing in PASSINGS]
    singles = []
    for passing, record in zip(PASSINGS, first, strict=True):
        said = list(_of_one_cut(bench, test, record, passing))
        singles.append(said[0].told)
        yield from said
        yield from _thrice(bench, test, cuts[passing], passing)
    for number in range(STRIDE):
        chosen = slice(number, None, STRIDE)
        yield _jointly(THREE, bench, test, first[chosen], PASSINGS[chosen])
    yield Said(MEAN, _mean(singles))
    yield _jointly(APART, bench, test, first, PASSINGS, apart=True)
    yield _jointly(TOGETHER, bench, test, first, PASSINGS)
    yield _jointly(MODAL, bench, test, first, PASSINGS, modal=True)
    yield from _of_tool(hits, first)
    off = [_cut(bench, seed, repeat, passing, 0, ANGLE) for passing in PASSINGS]
    for passing, record in zip(PASSINGS, off, strict=True):
        yield _with_angle(FITTED, bench, test, [record], [passing])
        yield _with_angle(BELIEVING, bench, test, [record], [passing], BELIEVED)
    yield _with_angle(of_all(FITTED), bench, test, off, PASSINGS)


def _cut(bench: Bench, seed: int, repeat: int, passing: int, number: int, angle: float = 0.0) -> CutRecord:
    rng = stream(seed, SERIES, passing, repeat, number)
    return cut_record(bench.accelerations[passing], passing, NOISE[1], MOST_HARMONICS, rng, angle=angle)


def _of_one_cut(bench: Bench, test: ImpactTest, record: CutRecord, passing: int) -> Iterator[Said]:
    """The base first."""
    for estimate, tried in ((test.windowed, HARMONICS_TRIED), (test.plain, PLAIN)):
        for name, harmonics in tried.items():
            law, lines = force_law(harmonics), lines_of(passing, harmonics)
            frf = estimate.at(lines)
            yield Said(name, gtls(frf, record, law), bound(bench, lines, frf, record, law.basis, law))
            if name in (BASE, *PLAIN):
                yield Said(f"{name} {LOG}", with_log_determinant(frf, record, law))


def _thrice(bench: Bench, test: ImpactTest, records: Sequence[CutRecord], passing: int) -> Iterator[Said]:
    yield _jointly(THRICE, bench, test, records, [passing] * ALIKE)
    yield _jointly(THRICE_APART, bench, test, records, [passing] * ALIKE, apart=True)


def _jointly(
    way: str,
    bench: Bench,
    test: ImpactTest,
    records: Sequence[CutRecord],
    passings: Sequence[int],
    *,
    apart: bool = False,
    modal: bool = False,
) -> Said:
    """One fit to several cuts.   apart : whether the FRF's errors are taken for independent between the lines"""
    lines, law, record = _laid_together(records, passings)
    estimate = test.modal if modal else test.windowed
    assert estimate is not None
    frf = estimate.at(lines) if apart else estimate.together(lines)
    of_bound = None if apart else bound(bench, lines, frf, record, law.basis, law)
    return Said(way, gtls(frf, record, law), of_bound)


def _laid_together(records: Sequence[CutRecord], passings: Sequence[int]) -> tuple[np.ndarray, ForceLaw, CutRecord]:
    """Lines, law and record of several cuts one behind the other; the law is the same at any speed."""
    law = force_law(HARMONICS)
    lines = np.concatenate([lines_of(passing, HARMONICS) for passing in passings])
    values = np.concatenate([record.values[:HARMONICS] for record in records])
    noise = np.concatenate([record.noise[:HARMONICS] for record in records])
    return lines, law._replace(basis=np.tile(law.basis, (len(passings), 1, 1))), CutRecord(values, noise)


def _mean(singles: Sequence[Told]) -> Told:
    """With the deviation of a mean of independent values."""
    deviations = np.array([told.deviation for told in singles])
    return Told(
        np.mean([told.value for told in singles], axis=0), np.sqrt(np.sum(deviations**2, axis=0)) / len(singles)
    )


def _of_tool(hits: list[tuple[np.ndarray, np.ndarray]], records: Sequence[CutRecord]) -> Iterator[Said]:
    """What the stages of the project make of the same hits and cuts."""
    cuts = [heard(record, passing) for record, passing in zip(records, PASSINGS, strict=True)]
    frf = frf_of_hits(hits)
    for way, modes in ((OWN_WINDOWS, None), (OWN_MODES, fit_modes(frf))):
        for cut in cuts:
            yield Said(way, told_by_tool([cut], frf, harmonics=HARMONICS, modes=modes))
        yield Said(of_all(way), told_by_tool(cuts, frf, harmonics=HARMONICS, modes=modes))


def _with_angle(
    way: str,
    bench: Bench,
    test: ImpactTest,
    records: Sequence[CutRecord],
    passings: Sequence[int],
    believed: float = np.inf,
) -> Said:
    lines, law, record = _laid_together(records, passings)
    order = np.tile(np.arange(1, HARMONICS + 1), len(passings))
    frf = test.windowed.together(lines)
    told, *_ = with_angle(frf, record, law, order, believed=believed)
    slopes = turned(law, order, np.append(_truth(law), ANGLE))[1]
    return Said(way, told, bound(bench, lines, frf, record, slopes, law, believed**-2))


def _truth(law: ForceLaw) -> np.ndarray:
    return np.array([TRUTH[name] for name in law.names])


def bound(
    bench: Bench,
    lines: np.ndarray,
    frf: Frf,
    record: CutRecord,
    slopes: np.ndarray,
    law: ForceLaw,
    precision: float = 0.0,
) -> np.ndarray:
    """Standard deviations that no unbiased estimate beats [Cramer, Rao, Fisher], with the errors' covariances as estimated.

    The FRF's errors are unknowns, too: taken out, they add to the noise.
    slopes : of the force at the truth, (line, axis, unknown), an angle behind the coefficients   precision : of that angle
    returns (4,) SI
    """
    exact = bench.structure.accelerance(lines)
    covariance = residual_covariance(record.noise[: len(lines)], frf[1], law.basis @ _truth(law))
    J = np.linalg.solve(np.linalg.cholesky(covariance), parts(exact @ slopes))
    information = J.T @ J
    information[-1, -1] += precision
    scale = np.sqrt(np.diag(information))
    deviation = np.sqrt(np.diag(np.linalg.inv(information / np.outer(scale, scale)))) / scale
    return deviation[[law.names.index(name) for name in SOUGHT]]


def with_log_determinant(frf: Frf, record: CutRecord, law: ForceLaw) -> Told:
    """The likelihood with the FRF integrated out in place of the one with the FRF at its best: its bias is the point.

    The deviations are those of its curvature.
    """
    from scipy.optimize import minimize

    matrix, error = frf
    n = len(matrix)
    fit = fit_gtls(frf, record, law)
    root = np.linalg.cholesky(fit.covariance)
    slopes, measured = parts(matrix @ law.basis), parts(record.values[:n])

    def objective(away: np.ndarray) -> float:
        """away : from the fit without it, in its deviations"""
        theta = fit.theta + root @ away
        lower = np.linalg.cholesky(residual_covariance(record.noise[:n], error, law.basis @ theta))
        left = np.linalg.solve(lower, measured - slopes @ theta)
        return float(left @ left + 2 * np.sum(np.log(np.diag(lower))))

    away = minimize(objective, np.zeros(len(fit.theta)), method="BFGS", options={"gtol": 1e-3}).x
    covariance = root @ np.linalg.inv(_curvature(objective, away) / 2) @ root.T
    place = [law.names.index(name) for name in SOUGHT]
    return Told((fit.theta + root @ away)[place], np.sqrt(np.diag(covariance)[place]))


def _curvature(of: Callable[[np.ndarray], float], at: np.ndarray) -> np.ndarray:
    """Second differences.   at : (n,)   returns (n, n)"""
    h = STEP * np.eye(len(at))
    up, down = np.array([of(at + e) for e in h]), np.array([of(at - e) for e in h])
    middle = of(at)
    result = np.diag(up + down - 2 * middle)
    for i in range(len(at)):
        for j in range(i):
            both = of(at + h[i] + h[j]) + of(at - h[i] - h[j])
            result[i, j] = result[j, i] = (both - up[i] - down[i] - up[j] - down[j] + 2 * middle) / 2
    return result / STEP**2
