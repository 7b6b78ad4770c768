"""All factors b > 0 with det(I + b M(theta)) = 0 for an angle theta on half a circle, without a scan of b.

M(theta) is a complex matrix that varies smoothly, so b = -1 / lambda wherever an eigenvalue lambda(theta) is real and
negative: an eigenvalue problem in one unknown instead of a search in two. In periodic systems theta is the angle of a
multiplier mu = e^{j theta} and b what the feedback is multiplied with. From 1 + b lambda(mu) = 0 follows

    Re d(ln mu) / db = Im(d lambda / d theta) / (b^2 |d lambda / d theta|^2),

so that mu leaves the unit circle with growing b exactly where Im lambda rises with theta. Every complex crossing stands for
a pair, so the number of multipliers outside at a factor is the sum over the crossings below it, 2 for each within the half
circle and 1 at its ends, with the sign of `rising`.

At the ends 0 and pi a matrix of a real system is real, and its real negative eigenvalues are crossings themselves (mu = 1,
mu = -1). Just beside such an end the imaginary part may change its sign at once, a pocket as thin as a hair: the
grid is drawn together there.

Eigenvalues are followed from angle to angle by nearness. A step is halved where an eigenvalue that may cross moves far for
its size, where it could be taken for another, or where its imaginary part turns back shortly before zero.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

REAL = 1e-9  # share of imaginary parts in the largest entry up to which a matrix at an end is real
LEAST_STEP = 1e-6  # rad
NEAR_END = np.pi * 4.0 ** -np.arange(3, 8)  # distances from an end at which the grid has angles: 0.05 .. 2e-4 rad
ROUNDS = 14  # of halving
STEPS = 32  # of the even grid with which the search begins


class CircleCrossings(NamedTuple):
    """Where eigenvalues cross the negative real axis, smallest factor first."""

    angle: np.ndarray  # theta, (crossing,) rad; exactly 0 or pi at an end
    factor: np.ndarray  # b, (crossing,)
    rising: np.ndarray  # bool (crossing,): Im lambda rises with theta, the multiplier leaves the circle with growing b


class _Chart(NamedTuple):
    """The largest eigenvalues along the angles, and how they go on from one angle to the next."""

    angle: np.ndarray  # (angle,)
    value: np.ndarray  # complex (angle, kept)
    after: np.ndarray  # integer (angle - 1, kept): the place at the next angle


def circle_crossings(
    matrix: Callable[[np.ndarray], np.ndarray],
    largest: float,
    *,
    steps: int = STEPS,
    extra: np.ndarray | None = None,
    start: float = 0.0,
    tolerance: float = 1e-10,
) -> CircleCrossings:
    """Crossings with a factor up to `largest`, for angles from `start` to pi.

    matrix : angle (t,) rad -> M, complex (t, R, R); real at 0 and pi if those ends are crossings of their own
    steps : of the even grid with which the search begins   extra : angles (k,) about which M is known to change fast
    start : 0 or above, where M is not to be asked for below   tolerance : of |Im lambda / lambda| at a crossing
    """
    angle = first_angles(steps, start)
    if extra is not None:
        extra = np.asarray(extra, float)
        angle = _apart(np.concatenate([angle, extra[(extra > start) & (extra < np.pi)]]))
    chart = _followed(matrix, angle, largest)
    inner = _within(matrix, chart, largest, tolerance)
    ends = [_at_end(chart, index, largest) for index in (0, -1)]
    found = CircleCrossings(*(np.concatenate(parts) for parts in zip(inner, *ends, strict=True)))
    order = np.argsort(found.factor, kind="stable")
    return CircleCrossings(*(part[order] for part in found))


def first_angles(steps: int = STEPS, start: float = 0.0) -> np.ndarray:
    """The angles at which the search begins, for who wants to prepare them.   returns (angle,) rad, from start to pi"""
    return _apart(np.concatenate([np.linspace(start, np.pi, steps + 1), np.pi - NEAR_END, start + NEAR_END]))


def _apart(angle: np.ndarray) -> np.ndarray:
    """Ascending, without those that differ by less than a step may; the last stays."""
    angle = np.unique(angle)
    kept = np.append(np.diff(angle) > LEAST_STEP, True)
    kept[0] = True
    return angle[kept]


def _eigenvalues(matrix: Callable[[np.ndarray], np.ndarray], angle: np.ndarray) -> np.ndarray:
    """Largest first; exactly real ones where the matrix at 0 or pi is real.   returns complex (angle, R)"""
    values = np.asarray(matrix(angle), complex)
    found = np.linalg.eigvals(values)
    for i in np.flatnonzero((angle == 0) | (angle == np.pi)):
        size = np.abs(values[i]).max()
        if np.abs(values[i].imag).max() <= REAL * size:
            found[i] = np.linalg.eigvals(values[i].real)
    return np.take_along_axis(found, np.argsort(-np.abs(found), axis=1), axis=1)


def _followed(matrix: Callable[[np.ndarray], np.ndarray], angle: np.ndarray, largest: float) -> _Chart:
    """The chart on a grid fine enough to tell every crossing."""
    value = _eigenvalues(matrix, angle)
    for _ in range(ROUNDS):
        chart, halve = _doubtful(angle, value, largest)
        halve &= np.diff(angle) > 2 * LEAST_STEP
        if not halve.any():
            break
        middle = (angle[:-1] + angle[1:])[halve] / 2
        at = np.flatnonzero(halve) + 1
        angle, value = np.insert(angle, at, middle), np.insert(value, at, _eigenvalues(matrix, middle), axis=0)
    else:
        chart, _ = _doubtful(angle, value, largest)
    return chart


def _doubtful(angle: np.ndarray, value: np.ndarray, largest: float) -> tuple[_Chart, np.ndarray]:
    """The chart of what was evaluated, and the steps that are too long to be sure of it.   returns chart, bool (step,)"""
    floor = 1 / largest
    counted = int(np.max(np.count_nonzero(np.abs(value) > 0.3 * floor, axis=1), initial=0))
    kept = value[:, : min(counted + 1, value.shape[1])]
    before, behind = kept[:-1], kept[1:]
    distance = np.abs(before[:, :, np.newaxis] - behind[:, np.newaxis, :])  # (step, from, to)
    after = np.argmin(distance, axis=2)
    jump = np.take_along_axis(distance, after[:, :, np.newaxis], axis=2)[:, :, 0]
    back, jump_back = np.argmin(distance, axis=1), np.min(distance, axis=1)
    here = np.arange(kept.shape[1])
    mutual = np.take_along_axis(back, after, axis=1) == here
    mutual_back = np.take_along_axis(after, back, axis=1) == here
    np.put_along_axis(distance, after[:, :, np.newaxis], np.inf, axis=2)
    second = distance.min(axis=2)
    arrival, origin = np.take_along_axis(behind, after, axis=1), np.take_along_axis(before, back, axis=1)

    to_ray = np.minimum(_distance_to_ray(before, floor), _distance_to_ray(arrival, floor))
    size = np.maximum(np.abs(before), np.abs(arrival))
    may_cross = to_ray <= jump
    unclear = may_cross & (~mutual | (second < 2 * jump))
    fast = (jump > 0.5 * size) & (size > floor) & (np.minimum(before.real, arrival.real) < 0) & (to_ray <= 2 * jump)
    # and from behind: a sharp resonance may carry one so far in a step that the nearest to it is a tiny one
    lost = ~mutual_back & (np.minimum(_distance_to_ray(behind, floor), _distance_to_ray(origin, floor)) <= jump_back)
    doubt = np.any(unclear | fast | lost, axis=1)
    chart = _Chart(angle, kept, after)
    if len(angle) > 2:
        doubt |= _turns_back(chart, floor)
    return chart, doubt


def _distance_to_ray(value: np.ndarray, floor: float) -> np.ndarray:
    """Distance from the real axis below -floor."""
    return np.hypot(value.imag, np.maximum(value.real + floor, 0.0))


def _turns_back(chart: _Chart, floor: float) -> np.ndarray:
    """Steps beside an angle where |Im| of an eigenvalue is least, and below half of both neighbours or, by the parabola through
    the three, near zero or beyond.

    returns bool (step,)
    """
    angle, value, after = chart
    first = value[:-2]
    middle = np.take_along_axis(value[1:-1], after[:-1], axis=1)
    last = np.take_along_axis(value[2:], np.take_along_axis(after[1:], after[:-1], axis=1), axis=1)
    y0, y1, y2 = first.imag, middle.imag, last.imag
    least = (np.abs(y1) <= np.abs(y0)) & (np.abs(y1) <= np.abs(y2)) & (y0 * y1 > 0) & (y2 * y1 > 0)
    least &= middle.real < -0.7 * floor
    h0, h1 = (angle[1:-1] - angle[:-2])[:, np.newaxis], (angle[2:] - angle[1:-1])[:, np.newaxis]
    d0, d1 = (y1 - y0) / h0, (y2 - y1) / h1
    slope, bend = (d0 * h1 + d1 * h0) / (h0 + h1), 2 * (d1 - d0) / (h0 + h1)
    lowest = y1 - slope**2 / (2 * np.where(bend == 0, np.inf, bend))
    # beside a resonance the course is no parabola: a least value far below both its neighbours is no sure one either
    deep = 2 * np.abs(y1) < np.minimum(np.abs(y0), np.abs(y2))
    near = least & (deep | (lowest * np.sign(y1) < 0.5 * np.abs(y1)))
    doubt = np.zeros(len(angle) - 1, bool)
    rows = near.any(axis=1)
    doubt[:-1] |= rows
    doubt[1:] |= rows
    return doubt


def _within(
    matrix: Callable[[np.ndarray], np.ndarray], chart: _Chart, largest: float, tolerance: float
) -> CircleCrossings:
    """Crossings between two angles of the chart, by false position (Illinois) on the imaginary part."""
    before, arrival = chart.value[:-1], np.take_along_axis(chart.value[1:], chart.after, axis=1)
    changes = (before.imag * arrival.imag < 0) & (np.minimum(before.real, arrival.real) < -0.5 / largest)
    step, place = np.nonzero(changes)
    low, high = chart.angle[step], chart.angle[step + 1]
    at_low, at_high = before[step, place], arrival[step, place]
    y_low, y_high = at_low.imag.copy(), at_high.imag.copy()  # halved where an end stays twice
    rising = y_high > y_low
    angle, found = low.copy(), at_low.copy()
    moved = np.zeros(len(low), int)  # which end the last step moved: -1 low, 1 high
    todo = np.arange(len(low))
    for _ in range(60):
        if not len(todo):
            break
        i = todo
        share = y_low[i] / (y_low[i] - y_high[i])
        new = low[i] + share * (high[i] - low[i])
        values = _eigenvalues(matrix, new)
        between = at_low[i] + share * (at_high[i] - at_low[i])
        value = values[np.arange(len(i)), np.argmin(np.abs(values - between[:, np.newaxis]), axis=1)]
        angle[i], found[i] = new, value
        is_low = (value.imag > 0) == (y_low[i] > 0)
        y_high[i] = np.where(is_low, np.where(moved[i] == -1, y_high[i] / 2, y_high[i]), value.imag)
        y_low[i] = np.where(is_low, value.imag, np.where(moved[i] == 1, y_low[i] / 2, y_low[i]))
        low[i], high[i] = np.where(is_low, new, low[i]), np.where(is_low, high[i], new)
        at_low[i], at_high[i] = np.where(is_low, value, at_low[i]), np.where(is_low, at_high[i], value)
        moved[i] = np.where(is_low, -1, 1)
        done = (np.abs(value.imag) <= tolerance * np.abs(value)) | (high[i] - low[i] <= 1e-12)
        todo = i[~done]
    # two eigenvalues taken for each other at the least step leave a change of sign without a zero
    good = (np.abs(found.imag) <= 1e-6 * np.abs(found)) & (found.real <= -1 / largest)
    return CircleCrossings(angle[good], -1 / found.real[good], rising[good])


def _at_end(chart: _Chart, end: int, largest: float) -> CircleCrossings:
    """Real negative eigenvalues at the first (0) or last (-1) angle, where that is 0 or pi."""
    angle = chart.angle[end]
    value = chart.value[end]
    real = (value.imag == 0) & (value.real <= -1 / largest)
    if angle not in (0.0, np.pi):
        real[:] = False
    place = np.flatnonzero(real)
    if end == 0:
        beside = chart.value[1][chart.after[0][place]]
        rising = beside.imag > 0
    else:
        beside = chart.value[-2]
        rising = np.empty(len(place), bool)
        for i, at in enumerate(place):
            rising[i] = beside[np.argmin(np.abs(beside - value[at]))].imag < 0
    return CircleCrossings(np.full(len(place), angle), -1 / value.real[place], rising)
