"""The tip of the tool as the stability map needs it, from modes or from a measured FRF.

From an FRF: the driving points along x and y at one point are found by the last letter of their dofs, any form becomes
receptance, lines outside the usable band are left out, and the sign of the driving points is checked, because a
receptance with the wrong sign still gives a map, only of another machine.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.data import Frf, Modes, Notice
from millcal.errors import IllPosedError
from millcal.physics import structure
from millcal.physics.stability import zero_order
from millcal.physics.stability.zero_order import Limit

FEWEST_LINES = 8  # of an FRF in its usable band: fewer are no curve
KNOWN_LINE = 0.2  # a line says something where its standard deviation is at most this share of it,
KNOWN_ENOUGH = 0.05  # or this share of the resonance, so that what it may hide is twenty times stiffer
TOLERATED_POWER = 0.1  # a driving point may give back this share of its largest absorption before it is told

Solver = Callable[[np.ndarray, np.ndarray], Limit]  # spindle speed (speed,), cutting matrix (2, 2) -> limit


@dataclass(frozen=True, eq=False)
class Tip:
    """What the map asks of a structure, with the method already chosen."""

    solve: Solver
    minimum: Callable[[np.ndarray], tuple[float, float]]  # cutting matrix -> depth m, frequency Hz
    notices: tuple[Notice, ...] = ()
    inverse_sd: Callable[[np.ndarray, np.ndarray, Limit], np.ndarray] | None = None  # of 1/b, if the FRF has a variance
    band: tuple[float, float] | None = None  # Hz, of the lines
    beyond: Solver | None = None  # with the lines above the band, which are not to be trusted


def zero_order_tip(dynamics: Frf | Modes, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    """The zero-order method on modes or on the lines of an FRF.

    speeds : rad/s, among them the lowest and the highest that will be asked   rigid : axes that may be missing
    """
    if isinstance(dynamics, Modes):
        return _of_modes(dynamics, speeds, teeth, rigid)
    return _of_lines(dynamics, teeth, rigid)


def _of_modes(record: Modes, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    columns = (record.natural_frequency, record.damping_ratio, record.stiffness, record.axes)
    modes = [structure.Mode(float(f), float(z), float(k), axis) for f, z, k, axis in zip(*columns, strict=True)]
    notices = _missing_axes({mode.axis for mode in modes}, rigid, "modes")
    modes = [mode for mode in modes if mode.axis in ("x", "y")]
    if len(modes) == 1:
        return Tip(
            solve=lambda speed, cutting: zero_order.limit_of_one_mode(speed, modes[0], cutting, teeth),
            minimum=lambda cutting: zero_order.minimum_of_one_mode(modes[0], cutting),
            notices=tuple(notices),
        )
    tip = zero_order.dynamics_of_modes(modes, speeds, teeth)
    return Tip(
        solve=lambda speed, cutting: zero_order.limit(speed, tip, cutting, teeth),
        minimum=lambda cutting: zero_order.absolute_minimum(zero_order.oriented(tip, cutting)),
        notices=tuple(notices),
    )


def _of_lines(frf: Frf, teeth: int, rigid: str) -> Tip:
    point, places = _driving_points(frf)
    notices = _missing_axes(set(places), rigid, f"frf {point}")
    lines = tip_receptance(frf, frf.usable_band)
    low = max((_lowest_known(lines, "xy".index(axis), f"{point}{axis.upper()}") for axis in places), default=0.0)
    if lines.count and low > lines.frequency[0]:
        what = f"below {low:.0f} Hz the receptance is noise, so chatter there is not looked for"
        notices.append(Notice("low-frequency-noise", what, f"frf {point}", "note"))
        lines = tip_receptance(frf, (low, frf.usable_band[1]))
    if lines.count < FEWEST_LINES:
        low, high = frf.usable_band
        raise IllPosedError(
            f"frf {point}: {lines.count} lines between {low:g} and {high:g} Hz, the usable band; measure again with a "
            "harder tip or more hits"
        )
    notices += [*lines.notices, *_absorbs_power(lines, sorted(places), point)]
    tip = zero_order.dynamics_of_lines(lines.frequency, lines.values)
    spacing = float(np.median(np.diff(lines.frequency)))
    above = tip_receptance(frf, (lines.frequency[0], np.inf))
    beyond = zero_order.dynamics_of_lines(above.frequency, above.values) if above.count > lines.count else None

    def inverse_sd(speed: np.ndarray, cutting: np.ndarray, limit: Limit) -> np.ndarray:
        # Between two lines the spline has at best half their variance; the nearest line's is kept, to the safe side.
        middles = (lines.frequency[:-1] + lines.frequency[1:]) / 2
        nearest = np.searchsorted(middles, limit.frequency)
        branches = zero_order.oriented(tip, cutting)
        return zero_order.inverse_depth_sd(limit, speed, branches, lines.variance[nearest], teeth, spacing)

    return Tip(
        solve=lambda speed, cutting: zero_order.limit(speed, tip, cutting, teeth),
        minimum=lambda cutting: zero_order.absolute_minimum(zero_order.oriented(tip, cutting)),
        notices=tuple(notices),
        inverse_sd=None if lines.variance is None else inverse_sd,
        band=(float(lines.frequency[0]), float(lines.frequency[-1])),
        beyond=None if beyond is None else lambda speed, cutting: zero_order.limit(speed, beyond, cutting, teeth),
    )


class Lines(NamedTuple):
    """The receptance in x and y on lines of an FRF; an axis without a driving point is zero."""

    frequency: np.ndarray  # (line,) Hz
    values: np.ndarray  # complex (line, 2, 2) m/N
    variance: np.ndarray | None  # (line, 2, 2) m^2/N^2
    notices: tuple[Notice, ...]

    @property
    def count(self) -> int:
        return len(self.frequency)


def tip_receptance(frf: Frf, band: tuple[float, float]) -> Lines:
    """The receptance matrix in x and y at the point that is both hit and measured, on the lines of a band."""
    if frf.form not in structure.DERIVATIVES:
        raise IllPosedError(f"frf: a {frf.form} is no response to a force; give accelerance, mobility or receptance")
    point, places = _driving_points(frf)
    axes, where = sorted(places), f"frf {point}"
    outputs, inputs = zip(*(places[axis] for axis in axes), strict=True)
    to = ["xy".index(axis) for axis in axes]
    own = np.arange(len(axes))

    measured = frf.values[:, outputs][:, :, inputs]
    kept = (frf.frequency > 0) & (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    kept &= np.isfinite(measured[:, own, own]).all(axis=1)
    frequency = frf.frequency[kept]
    measured = structure.convert_frf(frequency, measured[kept], frf.form, "receptance")
    notices = []
    unmeasured = ~np.isfinite(measured).all(axis=0)
    if unmeasured.any():
        notices.append(Notice("cross-terms", "cross receptances with gaps are taken as zero", where, "note"))
        measured[:, unmeasured] = 0.0
    values = np.zeros((len(frequency), 2, 2), complex)
    values[np.ix_(range(len(frequency)), to, to)] = measured

    variance = None
    if frf.variance is not None:
        spread = frf.variance[kept][:, outputs][:, :, inputs]
        spread = structure.convert_frf_variance(frequency, spread, frf.form, "receptance")
        if np.isfinite(spread[:, own, own]).all():
            variance = np.zeros(values.shape)
            variance[np.ix_(range(len(frequency)), to, to)] = np.where(np.isfinite(spread), spread, 0.0)
        else:
            notices.append(Notice("variance-unknown", "the FRF's variance has gaps, so the band leaves it out", where))
    return Lines(frequency, values, variance, tuple(notices))


def _lowest_known(lines: Lines, i: int, dof: str) -> float:
    """Where the receptance of a driving point begins to be known, Hz.

    An accelerance says little at low frequency, and over w^2 its noise becomes the softest mode of all, with lobes of its
    own. So the lines count from the last stretch of unknown ones below the strongest resonance that is known.
    """
    if lines.variance is None or lines.count < FEWEST_LINES:
        return 0.0
    size, sd = np.abs(lines.values[:, i, i]), np.sqrt(lines.variance[:, i, i])
    known = sd <= KNOWN_LINE * size
    if not known.any():
        raise IllPosedError(f"frf {dof}/{dof}: the receptance is noise at every line; hit harder or more often")
    peak = int(np.argmax(np.where(known, size, 0.0)))
    unknown = ~known & (sd > KNOWN_ENOUGH * size[peak])
    around = np.convolve(unknown, np.ones(5), mode="same") > 2  # a single bad line, of the mains say, is none
    last = np.flatnonzero(around[:peak])
    return float(lines.frequency[last[-1] + 1]) if len(last) else 0.0


def _driving_points(frf: Frf) -> tuple[str, dict[str, tuple[int, int]]]:
    """The point that is hit and measured along x and y, and where: axis -> (output, input)."""
    outputs = {dof.lstrip("+-").lower(): i for i, dof in enumerate(frf.outputs)}
    points: dict[str, dict[str, tuple[int, int]]] = {}
    for i, dof in enumerate(frf.inputs):
        name = dof.lstrip("+-")
        if name[-1:].lower() in ("x", "y") and name.lower() in outputs:
            points.setdefault(name[:-1], {})[name[-1].lower()] = (outputs[name.lower()], i)
    if not points:
        raise IllPosedError(
            f"frf: no point is both hit and measured along x or y; outputs are {', '.join(frf.outputs)}, "
            f"inputs {', '.join(frf.inputs)}; name the dofs tipX, tipY"
        )
    most = max(len(places) for places in points.values())
    fullest = [point for point, places in points.items() if len(places) == most]
    if len(fullest) > 1:
        raise IllPosedError(
            f"frf: {' and '.join(fullest)} are both hit and measured; keep the one that is the tool tip"
        )
    return fullest[0], points[fullest[0]]


def _absorbs_power(lines: Lines, axes: list[str], point: str) -> list[Notice]:
    """A driving point takes up power: Im of its receptance is negative. The wrong sign at resonance is refused."""
    frequency, values, notices = lines.frequency, lines.values, []
    for axis in axes:
        i = "xy".index(axis)
        absorbed = -frequency * values[:, i, i].imag  # in proportion to the real part of the mobility
        peak = int(np.argmax(np.abs(absorbed)))
        dof = f"{point}{axis.upper()}"
        if np.sum(absorbed * np.abs(frequency * values[:, i, i]) ** 2) < 0:
            raise IllPosedError(
                f"frf {dof}/{dof}: Im of the receptance is positive at its resonance, {frequency[peak]:.0f} Hz, as if the "
                "structure gave power to the hammer; turn the sign of the force or of the response (or the phase, where a "
                "file has it conjugated)"
            )
        wrong = absorbed < -TOLERATED_POWER * absorbed[peak]
        if wrong.any():
            at = frequency[wrong]
            notices.append(
                Notice(
                    "not-passive",
                    f"Im of the receptance is positive at {len(at)} lines from {at[0]:.0f} to {at[-1]:.0f} Hz; those lines are "
                    "noise or the sensors were not at one point",
                    f"frf {dof}/{dof}",
                )
            )
    return notices


def _missing_axes(present: set[str], rigid: str, where: str) -> list[Notice]:
    """Refuse a direction nobody spoke of; say which is taken as rigid."""
    missing = [axis for axis in "xy" if axis not in present]
    if len(missing) == 2:
        raise IllPosedError(f"{where}: neither x nor y is there; a limit needs the tip's dynamics across the spindle")
    for axis in missing:
        if axis not in rigid:
            raise IllPosedError(
                f"{where}: nothing along {axis}; add it, or state that it is rigid (--rigid {axis}, stability.rigid)"
            )
    return [Notice("rigid-axis", f"{axis} is taken as rigid, as stated", where, "note") for axis in missing]
