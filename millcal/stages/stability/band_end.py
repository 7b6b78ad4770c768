"""How much of a limit hangs on where the lines of an FRF end.

What the tip does above them is not known: a mass line stands there, and modes beyond the band are stiffness in it that nobody
sees. No bound follows from the lines alone, but how far limits move when the upper part of them is left out as well says how far
they may still be from where they would settle.
"""

import numpy as np

from millcal.data import Notice
from millcal.physics.stability.from_frf import crossings_of_receptance
from millcal.physics.stability.regeneration import Regeneration
from millcal.stages.stability.tip import FEWEST_LINES, Lines
from millcal.units import to_shop

KEPT = 0.8  # share of the band that stays
SPEEDS = 12  # tried
MOVED = 0.05  # share from which it is told
TOP = 0.05  # share of the band that is its end
STIFF = 0.02  # share of the largest receptance that the real part at the end must have,
RISING = 0.05  # and share of the largest absorption for what rises there to be a mode


def modes_at_the_end(lines: Lines) -> list[Notice]:
    """A tip that is no mass where its lines end: a mode stands about there or above.   lines : of the usable band"""
    frequency, notices = lines.frequency, []
    end = frequency >= (1 - TOP) * frequency[-1]
    largest = np.abs(frequency[:, np.newaxis] * np.einsum("fii->fi", lines.values).imag).max()
    for i, axis in enumerate("XY"):
        value = lines.values[:, i, i]
        if not value.any() or np.count_nonzero(end) < 2:
            continue
        absorbed = -frequency * value.imag
        rising = absorbed[-1] > RISING * largest and np.polyfit(frequency[end], absorbed[end], 1)[0] > 0
        stiff = np.median(value.real[end]) > STIFF * np.abs(value).max()
        if rising or stiff:
            what = (
                f"where the usable band ends, at {frequency[-1]:.0f} Hz, the tip is no mass along {axis.lower()} yet: a mode "
                "stands about there or above, and limits are made without it; hit with a harder tip"
            )
            notices.append(Notice("mode-at-end", what, "frf"))
    return notices


def moved_by_the_end(lines: Lines, speeds: np.ndarray, cut: Regeneration, deepest: float) -> list[Notice]:
    """By how much limits move at a few speeds when the upper fifth of the lines is left out.

    lines : of the usable band   speeds : of the map, ascending, (speed,) rad/s   deepest : m
    """
    kept = lines.frequency <= KEPT * lines.frequency[-1]
    if np.count_nonzero(kept) < FEWEST_LINES:
        return []
    tried = np.asarray(speeds, float)[np.unique(np.linspace(0, len(speeds) - 1, SPEEDS).astype(int))]
    whole, shorter = (
        np.minimum(
            crossings_of_receptance(tried, lines.frequency[those], lines.values[those], cut, deepest=deepest)
            .first(len(tried))
            .depth,
            deepest,
        )
        for those in (np.ones(lines.count, bool), kept)
    )
    apart = np.abs(np.log(shorter / whole))
    i = int(np.argmax(apart))
    if apart[i] < np.log1p(MOVED):
        return []
    many = np.count_nonzero(apart > np.log1p(MOVED))
    what = (
        f"limits hang on where the usable band ends: without its upper fifth, above {lines.frequency[kept][-1]:.0f} Hz, they "
        f"differ by more than {MOVED:.0%} at {many} of {len(tried)} speeds tried, most at {to_shop(tried[i], 'x_rpm'):.0f} rpm, "
        f"{to_shop(shorter[i], 'x_mm'):.3g} mm instead of {to_shop(whole[i], 'x_mm'):.3g}; what lines above the band would do is "
        "not known and may be as much, to either side; hit with a harder tip"
    )
    return [Notice("band-end", what, "frf")]
