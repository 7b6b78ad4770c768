"""What the receptance of every tip obeys, because a wrong one still gives a map, only of another machine.

It takes up power: -w (G - G^H) / 2j has no negative eigenvalue at any frequency, so that no motion in x and y, in whatever
phase, is fed by the structure. On the diagonal that is the sign of Im G; of the whole matrix it says that cross terms are
never larger than driving points allow. It is reciprocal: G = G^T, as nothing that turns is large in a spindle's end. And it
answers at once: far above its modes a driving point is -1 / (m w^2), whose phase a delay between the channels of hammer and
response turns in proportion to the frequency.

What none of these sees: cross terms of which both are conjugated, or both turned in sign. The latter is the same tip with
one axis mirrored. The former changes the phase of one axis against the other and takes up as much power; where the modes are
real and lie apart it moves little.
"""

from collections.abc import Iterable

import numpy as np

from millcal.data import Notice
from millcal.errors import IllPosedError
from millcal.stages.stability.tip import FEWEST_LINES, Lines

TOLERATED_POWER = 0.1  # share of the largest absorption that may be given back before it is told,
GIVEN_BACK = 0.25  # and of the whole, weighted by the resonances, before it is refused
CERTAIN = 3.0  # standard deviations
UNLIKE = 0.3  # share of themselves by which two cross terms may differ,
COUNTS = 0.02  # and of the driving points
ABOVE = 1.3  # times the highest mode: where a driving point begins to be a mass
SEEN = 0.02  # share of the largest absorption from which a peak is a mode
CLEAR = 0.2  # share of a line up to which its deviation leaves a phase
FEWEST_PHASES = 24  # lines
LATE = 0.03  # rad at the highest mode: twice a damping ratio of 1.5 %
STRAIGHT = 0.2  # of the turn: how far phases may lie about their line


def physical(lines: Lines, axes: Iterable[str], what: str, point: str) -> list[Notice]:
    """Refuse what is no tip at all, and tell what is doubtful.

    what : "frf" or "modes", for messages   point : of the tip
    """
    axes = sorted(axes)
    return [
        *absorbs_power(lines, axes, what, point),
        *_absorbs_in_every_direction(lines, what, point),
        *_reciprocal(lines, what, point),
    ]


def absorbs_power(lines: Lines, axes: Iterable[str], what: str, point: str) -> list[Notice]:
    """A driving point takes up power: Im of its receptance is negative. The wrong sign at resonance is refused.

    what : "frf" or "modes", for messages
    """
    frequency, values, notices = lines.frequency, lines.values, []
    for axis in sorted(axes):
        i = "xy".index(axis)
        absorbed = -frequency * values[:, i, i].imag  # in proportion to the real part of the mobility
        peak = int(np.argmax(np.abs(absorbed)))
        dof = f"{point}{axis.upper()}"
        if np.sum(absorbed * np.abs(frequency * values[:, i, i]) ** 2) < 0:
            raise IllPosedError(
                f"{what} {dof}/{dof}: Im of the receptance is positive at its resonance, {frequency[peak]:.0f} Hz, as if the "
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
                    f"{what} {dof}/{dof}",
                )
            )
    return notices


def _absorbs_in_every_direction(lines: Lines, what: str, point: str) -> list[Notice]:
    """Refuse cross terms that are far larger than the driving points allow; tell those that are a little."""
    frequency, values = lines.frequency, lines.values
    if not (values[:, 0, 1].any() or values[:, 1, 0].any()):
        return []
    loss = (values - values.conj().swapaxes(1, 2)) / 2j
    power = np.linalg.eigvalsh(-frequency[:, np.newaxis, np.newaxis] * loss)  # ascending
    if lines.variance is not None:  # what noise may have taken off the smaller one
        power[:, 0] += CERTAIN * frequency * np.sqrt(lines.variance.sum(axis=(1, 2)))
    weight = (frequency * np.linalg.norm(values, axis=(1, 2))) ** 2
    least, most = weight @ np.minimum(power[:, 0], 0.0), weight @ power[:, 1]
    wrong = power[:, 0] < -TOLERATED_POWER * power[:, 1].max()
    where = f"{what} {point}X/{point}Y"
    if least < -GIVEN_BACK * most:
        worst = frequency[int(np.argmin(power[:, 0]))]
        raise IllPosedError(
            f"{where}: the cross receptances are larger than the driving points allow, or out of phase with them, as if the "
            f"structure gave power to the hammer, most at {worst:.0f} Hz; check the units, signs and dofs of the cross terms, "
            "or leave them out"
        )
    if not wrong.any():
        return []
    at = frequency[wrong]
    told = (
        f"at {len(at)} lines from {at[0]:.0f} to {at[-1]:.0f} Hz the cross receptances are larger than the driving points allow; "
        "check the units, signs and dofs of the cross terms"
    )
    return [Notice("not-passive", told, where)]


def _reciprocal(lines: Lines, what: str, point: str) -> list[Notice]:
    """Two cross terms that are not one another, as mobilities, which no end of the band outweighs."""
    mobility = lines.frequency[:, np.newaxis, np.newaxis] * lines.values
    one, other = mobility[:, 0, 1], mobility[:, 1, 0]
    if not (one.any() and other.any()):
        return []
    apart = float(np.sum(np.abs(one - other) ** 2))
    if lines.variance is not None:
        noise = lines.frequency**2 * (lines.variance[:, 0, 1] + lines.variance[:, 1, 0])
        apart -= 2 * float(noise.sum())
    apart = np.sqrt(max(apart, 0.0))
    size = np.sqrt(np.linalg.norm(one) * np.linalg.norm(other))
    driving = np.sqrt(np.linalg.norm(mobility[:, 0, 0]) * np.linalg.norm(mobility[:, 1, 1]))
    if apart <= max(UNLIKE * size, COUNTS * driving):
        return []
    told = (
        f"the two cross receptances differ by {apart / size:.0%} of themselves, and of a tool at rest they are one; check the "
        "sign, sensitivity and place of the sensors, or leave them out"
    )
    return [Notice("not-reciprocal", told, f"{what} {point}X/{point}Y")]


def late_answers(lines: Lines, axes: Iterable[str], point: str) -> list[Notice]:
    """A delay between hammer and response: a phase in proportion to the frequency above the modes, where a tip is a mass."""
    notices = []
    for axis in sorted(axes):
        i = "xy".index(axis)
        value = lines.values[:, i, i]
        absorbed = np.abs(lines.frequency * value.imag)
        inner = absorbed[1:-1]
        peaks = (inner > absorbed[:-2]) & (inner >= absorbed[2:])
        if lines.count < FEWEST_LINES or not peaks.any():
            continue
        highest = lines.frequency[1:-1][peaks & (inner > SEEN * inner[peaks].max())].max()
        strongest = lines.frequency[1:-1][peaks][np.argmax(inner[peaks])]
        mass = lines.frequency > ABOVE * highest
        if lines.variance is not None:
            mass &= np.sqrt(lines.variance[:, i, i]) < CLEAR * np.abs(value)
        if np.count_nonzero(mass) < FEWEST_PHASES:
            continue
        w = 2 * np.pi * lines.frequency[mass]
        phase = np.unwrap(2 * np.angle(-value[mass])) / 2  # twice: of a mass or of a spring
        basis = np.stack([w[0] / w, -w], axis=1)  # what damping leaves of a mode below, and a delay
        fitted = np.linalg.lstsq(basis, phase, rcond=None)[0]
        left, delay = phase - basis @ fitted, float(fitted[1])
        sd = left.std() * np.sqrt(np.linalg.inv(basis.T @ basis)[1, 1])
        turn = abs(delay) * (w[-1] - w[0])
        if abs(delay) * 2 * np.pi * strongest > LATE and abs(delay) > CERTAIN * sd and left.std() < STRAIGHT * turn:
            dof = f"{point}{axis.upper()}"
            side, way = ("after", "falls") if delay > 0 else ("before", "rises")
            degrees = np.degrees(abs(delay)) * 2 * np.pi * strongest
            told = (
                f"the response comes {abs(delay) * 1e6:.0f} us {side} the force: above the modes the phase {way} with the "
                f"frequency, {degrees:.1f} deg at {strongest:.0f} Hz, and limits go astray by it; measure both channels through "
                "the same filters and converters, or take the delay out"
            )
            notices.append(Notice("late-response", told, f"frf {dof}/{dof}"))
    return notices
