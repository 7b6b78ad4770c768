"""The tip of the tool from the lines of a measured FRF.

Any form becomes receptance and lines outside the usable band are left out.
"""

import numpy as np

from millcal.data import Frf, Notice
from millcal.errors import IllPosedError
from millcal.physics import structure
from millcal.physics.stability import zero_order
from millcal.physics.stability.zero_order import Limit
from millcal.stages.stability_tip import (
    FEWEST_LINES,
    Lines,
    Tip,
    absorbs_power,
    at_tip,
    driving_points,
    lowest_known,
    missing_axes,
)


def tip_of_lines(frf: Frf, teeth: int, rigid: str) -> Tip:
    """The zero-order method on the lines of an FRF; `rigid` names axes that may be missing."""
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
    notices += [*lines.notices, *absorbs_power(lines, places, "frf", point)]
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


def tip_receptance(frf: Frf, band: tuple[float, float]) -> Lines:
    """The receptance matrix in x and y at the point that is both hit and measured, on the lines of a band."""
    if frf.form not in structure.DERIVATIVES:
        raise IllPosedError(f"frf: a {frf.form} is no response to a force; give accelerance, mobility or receptance")
    point, places = driving_points(frf.outputs, frf.inputs, "frf")
    where = f"frf {point}"
    own = ["xy".index(axis) for axis in places]

    measured = at_tip(frf.values, places, frf.outputs, frf.inputs)
    kept = (frf.frequency > 0) & (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    kept &= np.isfinite(measured[:, own, own]).all(axis=1)
    frequency = frf.frequency[kept]
    values = structure.convert_frf(frequency, measured[kept], frf.form, "receptance")
    notices = []
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
