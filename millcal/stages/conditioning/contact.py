"""Where the tool is in the work, for whoever follows the force sample by sample.

A steady cut is a level (`steady`); here the level may change: wear, a broken edge, another engagement. So contact is all that
is stronger than a share of what is usual, and a ramp is what changes much within a few revolutions at an end.
"""

import numpy as np

from millcal.errors import RecordingError
from millcal.numerics.revolutions import Survey, longest, stretches
from millcal.stages.conditioning.forces import Note
from millcal.stages.conditioning.steady import AIR_REVOLUTIONS

CONTACT = 0.3  # of the usual strength, above the noise of the air cut
FULL = 0.97  # of the strength of the revolutions that follow: the ramp is over
NEAR = 20  # revolutions of air beside the cut
NEIGHBOURS = 20  # revolutions at most with which an end is compared


def contact_revolutions(survey: Survey, where: str, note: Note, *, whole: bool) -> tuple[int, int, float]:
    """Revolutions first..last of the cut, and the strength in N that parts it from the air.

    whole : from the first contact to the last, ramps and gaps included, as an engagement table describes them; else the
        longest stretch without its ramps
    """
    strength = survey.strength
    usable = np.isfinite(strength)
    if usable.sum() < 2:
        raise RecordingError(
            f"{where}: holds {len(strength)} whole revolutions at the stated speed, {int(usable.sum())} of them all numbers; "
            "a cut needs at least 2, check the spindle speed and the sample rate"
        )
    strong = strength[usable & (strength > (0.25 if whole else 0.5) * np.quantile(strength[usable], 0.95))]
    if not len(strong):
        raise RecordingError(f"{where}: the forces never change; check the channels named in the map")
    level = float(np.median(strong))
    weak = strength[usable & (strength < 0.5 * level)]
    noise = float(np.median(weak)) if len(weak) >= AIR_REVOLUTIONS else 0.0  # powers add
    limit = float(np.sqrt(noise**2 + CONTACT**2 * (level**2 - noise**2)))
    runs = stretches(_bridged(strength, limit), bridge=3)
    if whole:
        return runs[0][0], runs[-1][1], limit
    first, last = longest(runs)
    if any(low != first and high - low > 0.5 * (last - first) for low, high in runs):
        note("several-cuts", "several stretches look like a cut; the longest is used, give steady_s for another")
    foot = _ramp(_whole_strength(survey, first, last, slice(max(first - NEAR, 0), first))) if first > 0 else 0
    heel = _ramp(_whole_strength(survey, first, last, slice(last, last + NEAR))[::-1]) if last < len(strength) else 0
    if last - first > foot + heel + 1:
        first, last = first + foot, last - heel
    return first, last, limit


def _whole_strength(survey: Survey, first: int, last: int, air: slice) -> np.ndarray:
    """Strength with what the mean force has more than in the air nearby: it grows with the ramp even where several teeth at
    once leave so steady a force that the ramp itself swings more.   returns (last - first,) N
    """
    away = survey.mean[:, first:last] - np.nanmedian(survey.mean[:, air], axis=1, keepdims=True)
    whole = np.sqrt(survey.strength[first:last] ** 2 + np.sum(away**2, axis=0))
    whole[~np.isfinite(whole)] = np.nanmedian(whole)  # refused by its time, once the cut is known
    return whole


def _bridged(strength: np.ndarray, limit: float) -> np.ndarray:
    """Revolutions in contact; what is no number in between is taken for contact."""
    contact = np.nan_to_num(strength, nan=-1.0) > limit
    for low, high in stretches(~np.isfinite(strength)):
        if low > 0 and high < len(strength) and contact[low - 1] and contact[high]:
            contact[low:high] = True
    return contact


def _ramp(strength: np.ndarray) -> int:
    """Revolutions at the beginning in which the tool is not yet fully in the work.

    The last of a ramp is flat: half again as many revolutions as it takes from nine tenths to nearly all are left out
    beside it, and one more because the contact begins within a revolution. Drift over a cut is slower by far.
    """
    ahead = min(NEIGHBOURS, max(len(strength) // 20, 3))  # so few that a drift of half the force is no ramp
    level = np.array([np.median(strength[i : i + ahead]) for i in range(min(len(strength), len(strength) // 2 + 1))])
    share = strength[: len(level)] / level
    nearly = np.flatnonzero(share >= 0.9)
    full = np.flatnonzero(share >= FULL)
    if not len(nearly) or not len(full):
        return 0
    return int(full[0]) + int(1.5 * max(full[0] - nearly[0], 0)) + 1
