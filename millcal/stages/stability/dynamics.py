"""Which dynamics a stability map should stand on, where an FRF and the modes fitted to it are both at hand.

The FRF as it was measured knows what no model does, so it goes first where the modes miss any of it. Where they describe it
to within its noise, they are the same structure without the noise, and the limit is known ten times better. Three things
bend an FRF, and its variance knows of none of them: an exponential window, a record that ended while the structure still
rang, and lines too far apart to be joined by a curve. What windows and the records' ends took away is the difference
between the fit as measured and the fit of the structure itself. Where that is more than the fit leaves unexplained, the
modes are the better structure; where it is less, the FRF with that difference put back is.
"""

from typing import Literal, NamedTuple

import numpy as np

from millcal.data import Frf, ModalFit, Modes
from millcal.physics.structure import DERIVATIVES, convert_frf, convert_frf_variance, modal_receptance
from millcal.stages.stability.tip import driving_points

WITHIN = 1.3  # times the noise: the fit leaves no more than that
BENT = 0.3  # times the noise: less is lost in it
LINES = 4  # in the half-power width of a mode: with fewer, a cubic between them is a percent off
WEAK = 0.1  # share of the highest resonance at the tip below which a mode's width does not matter


class Advice(NamedTuple):
    """What to map, and what is wrong with the FRF as measured; empty where nothing is."""

    dynamics: Literal["frf", "corrected", "modes"]
    why: str = ""


def advise(frf: Frf, modes: Modes) -> Advice:
    """Whether the limit should come from the FRF, from the FRF with what it lost put back, or from its fitted modes."""
    fit = modes.fit
    if fit is None or frf.form not in DERIVATIVES:
        return Advice("frf")
    _, places = driving_points(frf.outputs, frf.inputs, "frf")
    pairs = list(places.values())
    lost, left, noise = _norms(frf, fit, pairs)
    spacing = float(np.median(np.diff(frf.frequency)))
    width = _narrowest(modes, fit, pairs)
    coarse = LINES * spacing > width
    if frf.damping_shift:
        why = "an exponential window added damping to the FRF"
    elif lost > BENT * noise or any(notice.code == "truncated" for notice in frf.notices):
        why = "the records of the FRF ended before the structure came to rest"
    elif coarse:
        why = f"the lines of the FRF, {spacing:.3g} Hz apart, are too few for a mode {width:.3g} Hz wide"
    elif left < WITHIN * noise:
        return Advice("modes", "the modes describe the FRF to within its noise")
    else:
        return Advice("frf")
    return Advice("modes" if coarse or lost > left else "corrected", why)


def _norms(frf: Frf, fit: ModalFit, pairs: list[tuple[int, int]]) -> tuple[float, float, float]:
    """Of what was lost, what the fit leaves, and the noise, at the driving points and as mobility, which no end outweighs."""
    lines = np.searchsorted(frf.frequency, fit.frequency).clip(0, len(frf.frequency) - 1)
    outputs, inputs = zip(*pairs, strict=True)

    def norm(values: np.ndarray) -> float:
        mobility = convert_frf(fit.frequency, values[:, outputs, inputs], fit.form, "mobility")
        return float(np.sqrt(np.nansum(np.abs(mobility) ** 2)))

    noise = 0.0
    if frf.variance is not None:
        variance = convert_frf_variance(fit.frequency, frf.variance[lines][:, outputs, inputs], frf.form, "mobility")
        noise = float(np.sqrt(np.nansum(variance)))
    return norm(fit.synthesised - fit.modelled), norm(fit.measured - fit.modelled), noise


def _narrowest(modes: Modes, fit: ModalFit, pairs: list[tuple[int, int]]) -> float:
    """The least half-power width 2 zeta f_n of the modes that are seen at the tip, Hz."""
    resonance = np.abs(
        modal_receptance(modes.natural_frequency, modes.natural_frequency, modes.damping_ratio, fit.residue)
    )
    width = 2 * modes.damping_ratio * modes.natural_frequency
    seen = [width[(peaks := np.nan_to_num(resonance[:, o, i])) > WEAK * peaks.max()] for o, i in pairs]
    return float(np.min(np.concatenate(seen))) if seen else np.inf
