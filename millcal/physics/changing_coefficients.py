"""Coefficients that change while the tool cuts: wear, and the sudden change of a chipped edge.

The force is linear in the coefficients of the linear-edge law, and in the specific forces of Kienzle's. So it is a sum of
Fourier series, each multiplied by a coefficient that changes over time. Where a rise m changes too, F is interpolated
between the series at a few values of it (Chebyshev nodes): h^(-m) is an exponential in m, which seven nodes follow to 1e-8
over the changes that wear makes. A sensor acts on the harmonics by their gain, as if the coefficients stood still:
a trend over seconds moves nothing within the milliseconds of an amplifier, and a jump is not smeared by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge, force_basis, kienzle_functions, linear_edge_functions

Points = tuple[tuple[float, float], ...]  # (s after the first sample, factor), in the order of time
STEADY: Points = ((0.0, 1.0),)
NODES = 7  # values of a rise between which the force is interpolated


@dataclass(frozen=True)
class Chip:
    """A piece of the edge breaks off: from then on a factor on all forces of a direction."""

    time: float  # s after the first sample
    size: tuple[float, float, float]  # relative change, of t, r, a: 0.12 is 12 % more


@dataclass(frozen=True)
class Trend:
    """Factors on the coefficients over time, straight between the points and constant beside them; in t, r, a.

    `drift` is on the specific forces (Kienzle), or on the cutting and edge coefficients alike (linear edge); `shape` on the
    rises (Kienzle), or once more on the edge coefficients, which wear raises most (linear edge).
    """

    drift: tuple[Points, Points, Points] = (STEADY, STEADY, STEADY)
    shape: tuple[Points, Points, Points] = (STEADY, STEADY, STEADY)
    chips: tuple[Chip, ...] = ()

    def specific_factor(self, time: np.ndarray) -> np.ndarray:
        """Drift and chips together.   time : (t,) s   returns (3, t)"""
        factor = _along(self.drift, time)
        for chip in self.chips:
            factor = factor * np.where(time >= chip.time, 1.0 + np.asarray(chip.size)[:, np.newaxis], 1.0)
        return factor

    def shape_factor(self, time: np.ndarray) -> np.ndarray:
        """time : (t,) s   returns (3, t)"""
        return _along(self.shape, time)


def _along(points: Sequence[Points], time: np.ndarray) -> np.ndarray:
    return np.array([np.interp(time, *np.array(of_direction).T) for of_direction in points])


def coefficients_at(law: LinearEdge | Kienzle, trend: Trend, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The law's two arrays over time: cutting and edge, or specific force and rise.   returns (3, t), (3, t)"""
    specific, shape = trend.specific_factor(time), trend.shape_factor(time)
    if isinstance(law, LinearEdge):
        return law.cutting[:, np.newaxis] * specific, law.edge[:, np.newaxis] * specific * shape
    return law.specific_force[:, np.newaxis] * specific, law.rise[:, np.newaxis] * shape


@dataclass(frozen=True, eq=False)
class ForceSeries:
    """The force as a sum of series in the spindle angle, each with a weight that changes over time."""

    harmonics: np.ndarray  # (series, axis, k), complex
    weights: np.ndarray  # (series, t)

    def mean_force(self, within: np.ndarray) -> np.ndarray:
        """Mean over the samples `within`, a mask.   returns (axis,) N"""
        return self.weights[:, within].mean(axis=1) @ self.harmonics[:, :, 0].real


def force_series(
    law: LinearEdge | Kienzle,
    trend: Trend,
    cutter: Cutter,
    conditions: CuttingConditions,
    harmonics: int,
    time: np.ndarray,
) -> ForceSeries:
    """The series whose weighted sum is the force on the tool.   time : (t,) s"""
    first, last = coefficients_at(law, trend, time)
    if isinstance(law, LinearEdge):
        basis = force_basis(linear_edge_functions, cutter, conditions, harmonics)  # (axis, direction, function, k)
        of_each = np.concatenate([basis[:, :, 1], basis[:, :, 0]], axis=1)
        return _merged(np.moveaxis(of_each, 1, 0), np.concatenate([first, last]))
    nodes = [_nodes(float(rise.min()), float(rise.max())) for rise in last]
    basis = force_basis(kienzle_functions(np.concatenate(nodes)), cutter, conditions, harmonics)
    direction = np.repeat(np.arange(3), [len(values) for values in nodes])
    series = [basis[:, d, function] for function, d in enumerate(direction)]
    weights = [k * share for k, rise, at in zip(first, last, nodes, strict=True) for share in _shares(at, rise)]
    return _merged(np.array(series), np.array(weights))


def _merged(harmonics: np.ndarray, weights: np.ndarray) -> ForceSeries:
    """Series whose weights change alike are one: wear that raises all coefficients by one share costs no more than none."""
    groups: list[list[int]] = []
    courses: list[np.ndarray] = []
    for i, weight in enumerate(weights):
        scale = weight[np.argmax(np.abs(weight))]
        course = weight / scale if scale != 0 else np.zeros_like(weight)
        same = next((k for k, other in enumerate(courses) if np.allclose(course, other, rtol=0, atol=1e-14)), None)
        if same is None:
            groups.append([])
            courses.append(course)
        groups[same if same is not None else -1].append(i)
    size = np.array([weight[np.argmax(np.abs(weight))] for weight in weights])
    merged = [np.tensordot(size[group], harmonics[group], axes=1) for group in groups]
    return ForceSeries(np.array(merged), np.array(courses))


def _nodes(low: float, high: float) -> np.ndarray:
    """Chebyshev nodes of an interval; one where it is a point."""
    if high == low:
        return np.array([low])
    return (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)


def _shares(nodes: np.ndarray, at: np.ndarray) -> list[np.ndarray]:
    """Lagrange's polynomials of the nodes.   at : (t,)   returns (t,) for each node"""
    others = [np.delete(nodes, i) for i in range(len(nodes))]
    return [
        np.prod([(at - x) / (own - x) for x in rest] or [np.ones_like(at)], axis=0)
        for own, rest in zip(nodes, others, strict=True)
    ]
