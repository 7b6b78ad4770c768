"""What the zero-order method asks of the tip of the tool, and what lines and modes have in common in answering.

The driving points along x and y at one point are found by the last letter of their dofs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.data import Notice
from millcal.errors import IllPosedError
from millcal.physics.stability.regeneration import TipModes
from millcal.physics.stability.zero_order import Limit

FEWEST_LINES = 8  # of an FRF in its usable band: fewer are no curve
KNOWN_LINE = 0.2  # a line says something where its standard deviation is at most this share of it,
KNOWN_ENOUGH = 0.05  # or this share of the resonance, so that what it may hide is twenty times stiffer

Solver = Callable[[np.ndarray, np.ndarray], Limit]  # spindle speed (speed,), cutting matrix (2, 2) -> limit


@dataclass(frozen=True, eq=False)
class Tip:
    """A structure that the zero-order method can be asked about."""

    solve: Solver
    minimum: Callable[[np.ndarray], tuple[float, float]]  # cutting matrix -> depth m, frequency Hz
    notices: tuple[Notice, ...] = ()
    inverse_sd: Callable[[np.ndarray, np.ndarray, Limit], np.ndarray] | None = None  # of 1/b, if the FRF has a variance
    band: tuple[float, float] | None = None  # Hz, of the lines
    band_of: str = "the usable band of the FRF"
    beyond: Solver | None = None  # with the lines above the band, which are not to be trusted
    draws: Callable[[np.random.Generator, int], Iterator[TipModes]] | None = None  # as it may be, if modes know;
    remainder: tuple[np.ndarray, np.ndarray] | None = None  # beside them: (remainder, 2, 2), and its powers of s


class Lines(NamedTuple):
    """The receptance in x and y on lines of an FRF; an axis without a driving point is zero."""

    frequency: np.ndarray  # (line,) Hz
    values: np.ndarray  # complex (line, 2, 2) m/N
    variance: np.ndarray | None  # (line, 2, 2) m^2/N^2
    notices: tuple[Notice, ...]

    @property
    def count(self) -> int:
        return len(self.frequency)


def driving_points(outputs: Sequence[str], inputs: Sequence[str], what: str) -> tuple[str, dict[str, tuple[int, int]]]:
    """The point that is hit and measured along x and y, and where: axis -> (output, input).

    outputs, inputs : dofs   what : "frf" or "modes", for the error
    """
    rows = {dof.lstrip("+-").lower(): i for i, dof in enumerate(outputs)}
    points: dict[str, dict[str, tuple[int, int]]] = {}
    for i, dof in enumerate(inputs):
        name = dof.lstrip("+-")
        if name[-1:].lower() in ("x", "y") and name.lower() in rows:
            points.setdefault(name[:-1], {})[name[-1].lower()] = (rows[name.lower()], i)
    if not points:
        raise IllPosedError(
            f"{what}: no point is both hit and measured along x or y; outputs are {', '.join(outputs)}, "
            f"inputs {', '.join(inputs)}; name the dofs tipX, tipY"
        )
    most = max(len(places) for places in points.values())
    fullest = [point for point, places in points.items() if len(places) == most]
    if len(fullest) > 1:
        raise IllPosedError(
            f"{what}: {' and '.join(fullest)} are both hit and measured; keep the one that is the tool tip"
        )
    return fullest[0], points[fullest[0]]


def at_tip(
    values: np.ndarray, places: dict[str, tuple[int, int]], outputs: Sequence[str], inputs: Sequence[str]
) -> np.ndarray:
    """The entries at a point in x and y, zero along an axis without a driving point, in the positive sense of both axes.

    values : (..., output, input)   places : of `driving_points`   returns (..., 2, 2)
    """
    axes = sorted(places)
    to = np.array(["xy".index(axis) for axis in axes])
    rows, columns = np.array([places[axis] for axis in axes]).T
    sense = [
        [-1.0 if dofs[i].startswith("-") else 1.0 for i in at] for dofs, at in ((outputs, rows), (inputs, columns))
    ]
    matrix = np.zeros((*values.shape[:-2], 2, 2), values.dtype)
    matrix[..., to[:, np.newaxis], to] = values[..., rows[:, np.newaxis], columns] * np.outer(*sense)
    return matrix


def missing_axes(present: set[str], rigid: str, where: str) -> list[Notice]:
    """Refuse a direction nobody spoke of; say which is taken as rigid, and which is not though it was called so."""
    missing = [axis for axis in "xy" if axis not in present]
    if len(missing) == 2:
        raise IllPosedError(f"{where}: neither x nor y is there; a limit needs the tip's dynamics across the spindle")
    for axis in missing:
        if axis not in rigid:
            raise IllPosedError(
                f"{where}: nothing along {axis}; add it, or state that it is rigid (--rigid {axis}, stability.rigid)"
            )
    notices = [Notice("rigid-axis", f"{axis} is taken as rigid, as stated", where, "note") for axis in missing]
    for axis in sorted(set(rigid) & present):  # what was measured is believed: a map without it would promise too much
        what = (
            f"{axis} is not taken as rigid: its dynamics are there and count; take them out if they are not the tip's"
        )
        notices.append(Notice("rigid-ignored", what, where))
    return notices


def lowest_known(lines: Lines, i: int, where: str) -> float:
    """Where the receptance of a driving point begins to be known, Hz.

    An accelerance says little at low frequency, and over w^2 its noise becomes the softest mode of all, with lobes of its
    own. So the lines count from the last stretch of unknown ones below the strongest resonance that is known.
    """
    if lines.variance is None or lines.count < FEWEST_LINES:
        return 0.0
    size, sd = np.abs(lines.values[:, i, i]), np.sqrt(lines.variance[:, i, i])
    known = sd <= KNOWN_LINE * size
    if not known.any():
        raise IllPosedError(f"{where}: the receptance is noise at every line; hit harder or more often")
    peak = int(np.argmax(np.where(known, size, 0.0)))
    unknown = ~known & (sd > KNOWN_ENOUGH * size[peak])
    around = np.convolve(unknown, np.ones(5), mode="same") > 2  # a single bad line, of the mains say, is none
    last = np.flatnonzero(around[:peak])
    return float(lines.frequency[last[-1] + 1]) if len(last) else 0.0
