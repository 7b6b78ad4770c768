"""The tip of the tool from the lines of a measured FRF.

Any form becomes receptance and lines outside the usable band are left out.
"""

from collections.abc import Iterable

import numpy as np

from millcal.data import Frf, Notice
from millcal.errors import IllPosedError
from millcal.physics import structure
from millcal.physics.stability import zero_order
from millcal.physics.stability.zero_order import Limit, joined
from millcal.stages.stability.physical import late_answers, physical
from millcal.stages.stability.tip import (
    FEWEST_LINES,
    Lines,
    Tip,
    at_tip,
    driving_points,
    lowest_known,
    missing_axes,
)

MEASURED = 0.9  # share of the lines from which a cross term with gaps counts as measured
COARSE = 0.005  # share of the resonance by which the curve between lines may be off before it is told


def usable_lines(frf: Frf, rigid: str) -> tuple[Lines, list[Notice]]:
    """The receptance at the tip on the lines that a limit may stand on, and what is to be said of them.

    rigid : axes that may be missing
    """
    point, places = driving_points(frf.outputs, frf.inputs, "frf")
    notices = missing_axes(set(places), rigid, f"frf {point}")
    notices += _of_the_record(frf, f"frf {point}")
    lines = tip_receptance(frf, frf.usable_band)
    low = max(
        (lowest_known(lines, "xy".index(axis), f"frf {point}{axis.upper()}/{point}{axis.upper()}") for axis in places),
        default=0.0,
    )
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
    notices += [*lines.notices, *physical(lines, places, "frf", point), *late_answers(lines, places, point)]
    notices += _too_coarse(lines, places, point)
    return lines, notices


def tip_of_lines(frf: Frf, teeth: int, rigid: str) -> Tip:
    """The zero-order method on the lines of an FRF; `rigid` names axes that may be missing."""
    lines, notices = usable_lines(frf, rigid)
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


def _broken(frequency: np.ndarray, where: str) -> Notice:
    """Lines without a value."""
    at = f"{frequency[0]:g} Hz" + ("" if len(frequency) == 1 else f" to {frequency[-1]:g} Hz")
    many = "1 line has" if len(frequency) == 1 else f"{len(frequency)} lines have"
    what = f"{many} no value, {at}: left out, and what stands there is taken from the lines beside; mend the file"
    return Notice("lines-missing", what, where)


def _of_the_record(frf: Frf, where: str) -> list[Notice]:
    """What the record's end and its window have done to the lines, which no limit should stand on."""
    if frf.damping_shift:
        raise IllPosedError(
            f"{where}: an exponential window added {frf.damping_shift:.3g} 1/s of damping to every mode, which the limit "
            "would be too high by; fit its modes (millcal modes, stability.dynamics) and map those"
        )
    codes = {notice.code for notice in frf.notices}
    if "truncated" in codes and "truncation-corrected" not in codes:
        what = "the record ended before the structure came to rest, which bends the lines about its resonances; "
        return [Notice("truncated", what + "modes are fitted without that (millcal modes, stability.dynamics)", where)]
    return []


def _too_coarse(lines: Lines, axes: Iterable[str], point: str) -> list[Notice]:
    """Whether a curve through every other line misses the lines between, so that one through all is off by a sixteenth of it."""
    notices = []
    for axis in sorted(axes):
        i = "xy".index(axis)
        value = lines.values[:, i, i]
        if lines.count < 3 * FEWEST_LINES:
            continue
        missed = np.abs(joined(lines.frequency[::2], value[::2])(lines.frequency[1:-1:2]) - value[1:-1:2])
        size = np.abs(value[1:-1:2])
        high = size > 0.5 * size.max()
        noise = 0.0 if lines.variance is None else np.sqrt(np.median(lines.variance[1:-1:2, i, i][high]))
        worst = float(missed[high].max())
        if worst > 4 * noise and worst / 16 > COARSE * size.max():
            at, dof = lines.frequency[1:-1:2][high][np.argmax(missed[high])], f"{point}{axis.upper()}"
            what = (
                f"about {at:.0f} Hz the lines are so far apart that a curve between them is off by some "
                f"{worst / 16 / size.max():.1%}; estimate the FRF with lines closer together (resolution_hz), or map its modes"
            )
            notices.append(Notice("coarse-lines", what, f"frf {dof}/{dof}"))
    return notices


def tip_receptance(frf: Frf, band: tuple[float, float]) -> Lines:
    """The receptance matrix in x and y at the point that is both hit and measured, on the lines of a band."""
    if frf.form not in structure.DERIVATIVES:
        raise IllPosedError(f"frf: a {frf.form} is no response to a force; give accelerance, mobility or receptance")
    point, places = driving_points(frf.outputs, frf.inputs, "frf")
    where = f"frf {point}"
    own = ["xy".index(axis) for axis in places]

    measured = at_tip(frf.values, places, frf.outputs, frf.inputs)
    kept = (frf.frequency > 0) & (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    finite = np.isfinite(measured)
    bare = ~finite[:, own, own].all(axis=1)
    for entry in ((0, 1), (1, 0)):  # a cross term that was measured, but for some lines
        if np.count_nonzero(finite[kept, *entry]) > MEASURED * np.count_nonzero(kept):
            bare |= ~finite[:, *entry]
    notices = []
    if (kept & bare).any():
        notices.append(_broken(frf.frequency[kept & bare], where))
    kept &= ~bare
    frequency = frf.frequency[kept]
    values = structure.convert_frf(frequency, measured[kept], frf.form, "receptance")
    unmeasured = ~np.isfinite(values).all(axis=0)
    if unmeasured.any():
        notices.append(Notice("cross-terms", "cross receptances with gaps are taken as zero", where, "note"))
        values[:, unmeasured] = 0.0

    variance = None
    if frf.variance is not None:
        spread = np.abs(at_tip(frf.variance[kept], places, frf.outputs, frf.inputs))
        spread = structure.convert_frf_variance(frequency, spread, frf.form, "receptance")
        if np.isfinite(spread[:, own, own]).all():
            variance = np.where(np.isfinite(spread), spread, 0.0)
        else:
            notices.append(Notice("variance-unknown", "the FRF's variance has gaps, so the band leaves it out", where))
    return Lines(frequency, values, variance, tuple(notices))
