"""The methods that go through a cut in the order of time: recursive least squares, ensembles, interacting models.

They begin from what the first revolutions say (`start`), of which only levels and phase are kept; shapes and runout begin as
wide as they are known beforehand. Noise is taken as white here. Units of time are used samples: the banks and rates of
the papers belong to tooth passes of 56 samples and are carried over to the tooth pass of the record.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from millcal.errors import RecipeError
from millcal.physics.followed import Followed
from millcal.physics.sampled_force import parameters_of
from millcal.stages.coefficients.trends.problem import DIRECTIONS, NAMES, CutRecord, Noise

PAPER_PASS = 56  # used samples per tooth pass in the papers' cut
LEVEL_REACH = np.log(3.0)  # an ensemble begins within a third and three times the level of the first revolutions
SHAPES = {"kienzle": (0.05, 0.85), "linear-edge": (0.0, 0.9)}
MOST_RUNOUT = 40e-6  # m, radius of the disc that runout stays in


@dataclass(frozen=True, eq=False)
class Limits:
    """Where parameters may be: a box, and a disc of the runout."""

    box: np.ndarray  # (parameter, 2), of levels, shapes, c0, s0
    runout: bool  # whether it is followed; else it stays where it is

    @property
    def disc(self) -> tuple[int, float] | None:
        """Index of c0, and the radius, m."""
        return (len(self.box) - 2, MOST_RUNOUT) if self.runout else None


def limits_of(
    record: CutRecord, start: np.ndarray, bounds: Mapping[str, tuple[float, float]] | None, runout: bool
) -> Limits:
    """The box by the user's bounds on coefficients, else about the first revolutions.   bounds : name -> low, high, SI"""
    D = record.directions
    box = np.empty((2 * D + 2, 2))
    box[0 : 2 * D : 2] = start[0 : 2 * D : 2, np.newaxis] + np.array([-LEVEL_REACH, LEVEL_REACH])
    box[1 : 2 * D : 2] = SHAPES[record.law]
    for d, given in bounds_by_direction(record, bounds).items():
        corners = corner_parameters(record, given)
        box[2 * d], box[2 * d + 1] = (
            (corners[:, 0].min(), corners[:, 0].max()),
            (corners[:, 1].min(), corners[:, 1].max()),
        )
    box[2 * D :] = (-MOST_RUNOUT, MOST_RUNOUT) if runout else start[2 * D : 2 * D + 2, np.newaxis]
    return Limits(box, runout)


def bounds_by_direction(
    record: CutRecord, bounds: Mapping[str, tuple[float, float]] | None
) -> dict[int, tuple[tuple[float, float], tuple[float, float]]]:
    """Both bounds of each direction that has them.   raises RecipeError where one has half, or a name is unknown"""
    given = dict(bounds or {})
    found = {}
    for d, letter in enumerate(DIRECTIONS[: record.directions]):
        names = [name.format(letter) for name in NAMES[record.law]]
        have = [name for name in names if name in given]
        if len(have) == 1:
            other = next(name for name in names if name != have[0])
            raise RecipeError(f"coefficients.bounds: {have[0]} is bounded and {other} is not; give both, or neither")
        if have:
            for name in names:
                low, high = given[name]
                if not low < high:
                    raise RecipeError(
                        f"coefficients.bounds: {name} has {low:g} as low and {high:g} as high; let low be below"
                    )
            found[d] = (tuple(given.pop(names[0])), tuple(given.pop(names[1])))
            try:
                corner_parameters(record, found[d])
            except ValueError:
                raise RecipeError(
                    f"coefficients.bounds: {names[0]} and {names[1]} allow a force of nothing or less; raise their lower bounds"
                ) from None
    if given:
        raise RecipeError(
            f"coefficients.bounds: {next(iter(given))} is no coefficient of the {record.law} law in these axes"
        )
    return found


def corner_parameters(
    record: CutRecord, given: tuple[tuple[float, float], tuple[float, float]], grid: int = 2
) -> np.ndarray:
    """Level and shape over a grid of both coefficients of one direction.   returns (point, 2)"""
    first, second = (np.linspace(*pair, grid) for pair in given)
    points = np.stack(np.meshgrid(first, second), axis=-1).reshape(-1, 2)
    values = np.concatenate(
        [points[:, :1].repeat(2, 1), points[:, 1:].repeat(2, 1)], axis=1
    )  # the same in two directions
    return parameters_of(values, record.law, record.reference_chip)[:, :2]


def recursive_least_squares(
    record: CutRecord, noise: Noise, used: np.ndarray, edges: np.ndarray, begin: "Begin", *, forgetting: float, **_: Any
) -> Followed:
    """Exponential forgetting, linearised at the estimate, projected onto the limits."""
    from millcal.physics.follow_rls import follow_rls

    return follow_rls(
        begin.mean,
        np.diag(begin.sd**2),
        noise=noise.sd,
        forgetting=forgetting,
        limits=begin.limits.box,
        disc=begin.limits.disc,
        **_of(record, used, edges, begin.phase),
    )


def interacting(
    record: CutRecord,
    noise: Noise,
    used: np.ndarray,
    edges: np.ndarray,
    begin: "Begin",
    *,
    per_pass: float,
    jumps: bool,
    **_: Any,
) -> Followed:
    """A bank of extended Kalman filters: no change, trends of several paces, and for jumps a fast walk."""
    from millcal.physics.follow_imm import bank, follow_imm

    pace = PAPER_PASS / per_pass
    models, stay = bank(int(used.sum()), pace=pace, jumps=jumps)
    return follow_imm(
        begin.mean,
        np.diag(begin.sd**2),
        noise=noise.sd,
        models=models,
        stay=stay,
        rate=1e-4 * pace,
        **_of(record, used, edges, begin.phase),
    )


def ensemble(
    record: CutRecord,
    noise: Noise,
    used: np.ndarray,
    edges: np.ndarray,
    begin: "Begin",
    *,
    members: int,
    inflation: tuple[int, float, float] | None,
    rng: np.random.Generator,
    **_: Any,
) -> Followed:
    """Perturbed observations; with `inflation` = (updates, share of the members, fraction of P0) now and then wider again."""
    from millcal.numerics.ensemble_kalman import Inflation
    from millcal.physics.follow_ensemble import follow_ensemble

    if inflation is not None:
        every, share, fraction = inflation
        wider = Inflation(every, max(2, round(share * members)), fraction)
    return follow_ensemble(
        begin.draw(rng, members),
        noise=np.diag(noise.sd**2),
        limits=begin.limits.box,
        disc=begin.limits.disc,
        inflation=None if inflation is None else wider,
        rng=rng,
        **_of(record, used, edges, begin.phase),
    )


@dataclass(frozen=True, eq=False)
class Begin:
    """What a filter begins with."""

    mean: np.ndarray  # (parameter,) without phases
    sd: np.ndarray  # (parameter,); 0 for what is known
    phase: np.ndarray  # (cut,) rad
    limits: Limits
    corners: Mapping[int, np.ndarray]  # direction -> level and shape over a fine grid of its bounded coefficients

    def draw(self, rng: np.random.Generator, members: int) -> np.ndarray:
        """Members spread evenly over the box, over the user's bounds where there are some, and over the disc of the runout."""
        low, high = self.limits.box.T
        drawn = rng.uniform(low, high, (members, len(low)))
        for d, points in self.corners.items():
            drawn[:, 2 * d : 2 * d + 2] = points[rng.integers(len(points), size=members)]
        if self.limits.runout:
            radius, angle = MOST_RUNOUT * np.sqrt(rng.random(members)), rng.uniform(0, 2 * np.pi, members)
            drawn[:, -2:] = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        return drawn


def _of(record: CutRecord, used: np.ndarray, edges: np.ndarray, phase: np.ndarray) -> dict[str, Any]:
    """What every filter is told of the cuts."""
    return {
        "passage": record.turned(phase),
        "measured": record.force * record.sign,
        "used": used,
        "edges": edges,
        "cutter": record.cutter,
        "law": record.law,
        "reference_chip": record.reference_chip,
        "axes": record.axes,
        "lowpass": record.lowpass,
        "nodes": record.nodes,
    }


FILTERS: dict[str, Callable[..., Followed]] = {
    "rls": recursive_least_squares,
    "enkf": ensemble,
    "enkf-inflated": ensemble,
    "imm": interacting,
}
