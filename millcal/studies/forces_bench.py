"""A structure with what is exact about it, and the random numbers of the study of forces from accelerations.

Every variant draws from a stream of its own, named by its noises and its number: no result depends on what else is computed.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from millcal.studies.forces_cuts import PASSINGS, SOUGHT, TRUTH, exact_accelerations
from millcal.studies.forces_methods import HARMONICS, lines_of
from millcal.studies.forces_structure import Structure
from millcal.studies.forces_tests import Hammer, hammer_on

TRUE = np.array([TRUTH[name] for name in SOUGHT])


class Bench(NamedTuple):
    """Everything that noise does not change."""

    structure: Structure
    hammer: Hammer
    accelerations: Mapping[int, np.ndarray]  # by passing: complex (line, sensor) m/s^2
    frf: Mapping[int, np.ndarray]  # by passing: complex (line, sensor, axis)


def bench_of(structure: Structure) -> Bench:
    """The hammer, and at every speed the FRF and the accelerations of the cut."""
    return Bench(
        structure,
        hammer_on(structure),
        {passing: exact_accelerations(structure, passing) for passing in PASSINGS},
        {passing: structure.accelerance(lines_of(passing, HARMONICS)) for passing in PASSINGS},
    )


def stream(seed: int, *name: float) -> np.random.Generator:
    """Random numbers of their own for what is named by numbers, to a thousandth."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(round(1000 * part) for part in name)))
