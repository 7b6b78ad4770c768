"""Pawelko, Powalka, Berczynski, "Estimation of cutting force model coefficients with regularized inverse problem", 2012, again.

Six accelerometers hear a slot being cut; an impact test at the same sensors gives the FRF; both are noisy. The paper's 648 variants
of two noises and twelve speeds, ten times each, through its own methods and through better ones; further structures than the
one drawn for it; a spindle whose pulse is three degrees off; and what else pays, and what does not.

The paper prints neither masses nor shapes nor the hammer's force, so its numbers cannot be met; what it says of them can be tested.
The one free scale, the force of the hits, is such that its two limits, 1 m/s^2 and an FRF error of 15 %, are the same point.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from millcal.stages.forces.law import BELIEVED
from millcal.studies.forces_bench import TRUE, Bench, bench_of, stream
from millcal.studies.forces_cuts import PASSINGS, SOUGHT, cut_record, force_law, wanted_lines
from millcal.studies.forces_further import ANGLE, Answers, run_further
from millcal.studies.forces_methods import (
    GTLS,
    GTLS_WINDOWED,
    HARMONICS,
    LS,
    LS_ALL,
    METHODS,
    MORE_HARMONICS,
    RTLS,
    WEIGHTED,
    Told,
    estimate_by,
    gtls,
    lines_of,
    with_angle,
)
from millcal.studies.forces_structure import SEED, Structure, condition, random_structure
from millcal.studies.forces_tests import ImpactTest, impact_test

Progress = Callable[[float, str], None]

FORCES = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)  # N, standard deviations of the noise on the hammer
ACCELERATIONS = (
    0.0,
    0.2,
    0.4,
    0.6,
    0.8,
    1.0,
    1.2,
    1.4,
    1.6,
)  # m/s^2, on the accelerometers, in the impact test and in the cut
FRFS = ("plain", "windowed", "modal")

ENSEMBLE = (LS, RTLS, LS_ALL, GTLS, GTLS_WINDOWED)
ENSEMBLE_NOISE = (0.0, 1.0)  # N, m/s^2
ANGLE_NOISE = (0.0, 0.4)  # N, m/s^2
ANGLES = ("known", "ignored", "fitted", "believed")


class Extent(NamedTuple):
    """How much is computed."""

    forces: tuple[float, ...]  # N
    accelerations: tuple[float, ...]  # m/s^2
    repeats: int  # of every variant
    structures: int  # half of them with orthogonal directions
    structure_repeats: int
    angle_repeats: int
    further_repeats: int = 0


FULL = Extent(FORCES, ACCELERATIONS, 10, 30, 10, 10, 40)
QUICK = Extent((0.0, 25.0), (0.0, 0.4, 1.0), 2, 2, 1, 2)  # the further ways take as long again


class Runs(NamedTuple):
    """The variants of the paper, on its own structure."""

    error: np.ndarray  # of Ktc, Kte, Krc, Kre, relative: (force, acceleration, repeat, passing, method, 4)
    deviation: np.ndarray  # standard deviations that methods state, relative: (..., weighted method, 4)
    frf_error: np.ndarray  # eq. 24 of both harmonics, Frobenius: (force, acceleration, repeat, passing, frf)


class Ensemble(NamedTuple):
    """Other structures at one level of noise."""

    error: np.ndarray  # relative, (structure, repeat, passing, method, 4), methods as in ENSEMBLE
    condition: np.ndarray  # (structure, passing)


class Angles(NamedTuple):
    """A spindle that lags its pulse by ANGLE, through GTLS with windowed H1: the angle known, ignored, fitted, or fitted by
    somebody who believes what is stated to 3 degrees.
    """

    error: np.ndarray  # relative, (repeat, passing, way, 4), ways as in ANGLES
    deviation: np.ndarray  # likewise, as stated: the bound of Cramer, Rao and Fisher, relative
    angle: (
        np.ndarray
    )  # as fitted by who believes nothing, with its stated standard deviation, rad, (repeat, passing, 2)


class Study(NamedTuple):
    """All of it."""

    seed: int
    extent: Extent
    condition: np.ndarray  # of the exact FRF, (passing,)
    runs: Runs
    ensemble: Ensemble
    angles: Angles
    further: dict[str, Answers]  # by way


def run(extent: Extent = FULL, *, seed: int = 0, progress: Progress | None = None) -> Study:
    """The experiment.   seed : of all noise   progress : told the share done and what is done"""
    tell = progress or (lambda share, label: None)
    variants = len(extent.forces) * len(extent.accelerations) * extent.repeats
    steps = variants + extent.structures * extent.structure_repeats + extent.angle_repeats + extent.further_repeats
    done = 0

    def step(label: str) -> None:
        nonlocal done
        tell(done / steps, label)
        done += 1

    bench = bench_of(random_structure(SEED))
    runs = _runs(bench, extent, seed, step)
    ensemble = _ensemble(extent, seed, step)
    angles = _angles(bench, extent, seed, step)
    further = run_further(bench, extent.further_repeats, seed, step)
    tell(1.0, "done")
    conditions = np.array([condition(bench.frf[passing]) for passing in PASSINGS])
    return Study(seed, extent, conditions, runs, ensemble, angles, further)


def variant(
    bench: Bench,
    noise: tuple[float, float],
    repeat: int,
    seed: int,
    methods: Sequence[str] = METHODS,
    *,
    series: int = 0,
) -> tuple[ImpactTest, dict[int, dict[str, Told]]]:
    """One impact test and a cut at every speed.

    noise : N, m/s^2   series : tells apart what has the same noise and number
    returns the test, and by passing and method what is said of the coefficients
    """
    names = [method for method in methods if method in WEIGHTED]
    modal = any(WEIGHTED[name][0] == "modal" for name in names)
    lines = wanted_lines(PASSINGS, MORE_HARMONICS)
    test = impact_test(bench.hammer, *noise, stream(seed, series, 0, *noise, repeat), lines, modal=modal)
    told = {}
    for passing in PASSINGS:
        rng = stream(seed, series, passing, *noise, repeat)
        record = cut_record(bench.accelerations[passing], passing, noise[1], MORE_HARMONICS, rng)
        told[passing] = {method: estimate_by(method, test, record, passing) for method in methods}
    return test, told


def _runs(bench: Bench, extent: Extent, seed: int, step: Callable[[str], None]) -> Runs:
    shape = (len(extent.forces), len(extent.accelerations), extent.repeats, len(PASSINGS))
    error = np.empty((*shape, len(METHODS), len(SOUGHT)))
    deviation = np.empty((*shape, len(WEIGHTED), len(SOUGHT)))
    frf_error = np.empty((*shape, len(FRFS)))
    for i, force in enumerate(extent.forces):
        for j, acceleration in enumerate(extent.accelerations):
            for repeat in range(extent.repeats):
                step(f"noise {force:g} N, {acceleration:g} m/s²")
                test, told = variant(bench, (force, acceleration), repeat, seed)
                for k, passing in enumerate(PASSINGS):
                    at = i, j, repeat, k
                    error[at], deviation[at] = errors_of(told[passing], METHODS), deviations_of(told[passing])
                    frf_error[at] = [frf_error_of(test, name, passing, bench.frf[passing]) for name in FRFS]
    return Runs(error, deviation, frf_error)


def errors_of(told: Mapping[str, Told], methods: Sequence[str]) -> np.ndarray:
    """Relative.   returns (method, 4)"""
    return np.array([told[method].value / TRUE - 1 for method in methods])


def deviations_of(told: Mapping[str, Told]) -> np.ndarray:
    """Relative.   returns (weighted method, 4)"""
    return np.array([told[method].deviation / TRUE for method in WEIGHTED])


def frf_error_of(test: ImpactTest, name: str, passing: int, exact: np.ndarray) -> float:
    """Eq. 24, with the norm of Frobenius.   name : one of FRFS"""
    found, _ = getattr(test, name).at(lines_of(passing, HARMONICS))
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def ensemble_structures(count: int) -> list[Structure]:
    """Half with orthogonal directions, half with directions of their own."""
    half = (count + 1) // 2
    orthogonal = [random_structure(1 + number) for number in range(half)]
    return orthogonal + [random_structure(101 + number, orthogonal=False) for number in range(count - half)]


def _ensemble(extent: Extent, seed: int, step: Callable[[str], None]) -> Ensemble:
    shape = (extent.structures, extent.structure_repeats, len(PASSINGS))
    error, conditions = np.empty((*shape, len(ENSEMBLE), len(SOUGHT))), np.empty((extent.structures, len(PASSINGS)))
    for number, structure in enumerate(ensemble_structures(extent.structures)):
        bench = bench_of(structure)
        conditions[number] = [condition(bench.frf[passing]) for passing in PASSINGS]
        for repeat in range(extent.structure_repeats):
            step(f"structure {number + 1} of {extent.structures}")
            _, told = variant(bench, ENSEMBLE_NOISE, repeat, seed, ENSEMBLE, series=1 + number)
            for k, passing in enumerate(PASSINGS):
                error[number, repeat, k] = errors_of(told[passing], ENSEMBLE)
    return Ensemble(error, conditions)


def _angles(bench: Bench, extent: Extent, seed: int, step: Callable[[str], None]) -> Angles:
    shape = (extent.angle_repeats, len(PASSINGS))
    error, deviation = (np.empty((*shape, len(ANGLES), len(SOUGHT))) for _ in range(2))
    angle = np.empty((*shape, 2))
    lines, sigma = wanted_lines(PASSINGS, HARMONICS), ANGLE_NOISE[1]
    law, order = force_law(HARMONICS), np.arange(1, HARMONICS + 1)
    for repeat in range(extent.angle_repeats):
        step(f"angle of the spindle, {repeat + 1} of {extent.angle_repeats}")
        rng = stream(seed, 10_000, 0, repeat)
        frf = impact_test(bench.hammer, *ANGLE_NOISE, rng, lines, modal=False).windowed
        for k, passing in enumerate(PASSINGS):
            right, off = (
                cut_record(
                    bench.accelerations[passing],
                    passing,
                    sigma,
                    HARMONICS,
                    stream(seed, 10_000, passing, repeat),
                    angle=lag,
                )
                for lag in (0.0, ANGLE)
            )
            here = frf.at(lines_of(passing, HARMONICS))
            fitted, *angle[repeat, k] = with_angle(here, off, law, order)
            believed, *_ = with_angle(here, off, law, order, believed=BELIEVED)
            ways = gtls(here, right, law), gtls(here, off, law), fitted, believed
            error[repeat, k] = [told.value / TRUE - 1 for told in ways]
            deviation[repeat, k] = [told.deviation / TRUE for told in ways]  # type: ignore[operator]
    return Angles(error, deviation, angle)
