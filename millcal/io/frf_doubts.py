"""What can be doubted in an FRF of another program, by physics alone: the sign of its driving points, and drift at 0 Hz.

A passive structure absorbs at the point where it is hit: Im of the accelerance is positive there, that of the receptance
negative. Two mistakes turn it: a sensor or hammer of the wrong sign, and a file that was written for x = Re X e^{-jwt},
whose FRF is the complex conjugate. The impulse response tells them apart, for a conjugated FRF answers before the hit;
of a mobility nothing else does.

A tool in its spindle is stiffest at rest. Where its receptance grows towards 0 Hz beyond every resonance, it is the offset of
an accelerometer that was divided by w^2; a stability map would find the softest mode of all there.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Frf, Notice
from millcal.io.frf_pairs import bare_dof
from millcal.physics.structure import DERIVATIVES, convert_frf

FEWEST_LINES = 32
_CLEAR = 0.5  # of the power at all lines
_BACKWARDS = 3.0  # times more energy before the hit than after it
_DRIFT = 3.0  # times the largest receptance above
_STEEP = 1.5  # power of the frequency by which a drift falls at least; an offset of the accelerance falls by 2
_OCTAVES = 2.0  # over which it falls at least


def doubts(frf: Frf, where: str) -> list[Notice]:
    """Notices about the driving points of an FRF."""
    return [*polarity(frf, where), *low_frequency_drift(frf, where)]


def polarity(frf: Frf, where: str) -> list[Notice]:
    """Notices about driving points that give power back."""
    if frf.form not in DERIVATIVES:
        return []
    turned, right, backwards = [], [], []
    for dof in frf.inputs:
        if dof not in frf.outputs:
            continue
        column = frf.values[:, frf.outputs.index(dof), frf.inputs.index(dof)]
        inside = _above_drift(frf, column)
        if _answers_before_the_hit(frf.frequency[inside], column[inside], frf.form):
            backwards.append(dof)
            column = column.conj()  # which leaves the sign in doubt
        share = _absorbed(frf.frequency[inside], column[inside], frf.form)
        if share < -_CLEAR:
            turned.append(dof)
        elif share > _CLEAR:
            right.append(dof)
    notices = []
    if backwards:
        message = (
            f"the response at {_named(backwards)} comes before the hit: the file has the phase of its FRF conjugated; "
            "take the other sign of the imaginary part with --conjugate"
        )
        notices.append(Notice("conjugated", message, where))
    if turned and not right:
        message = (
            f"the response at {_named(turned)} moves against the hammer: accelerometer polarity or hammer sign; "
            "turn it with a sign in front of its dof, as in --response=-tipX"
        )
        notices.append(Notice("accelerometer-polarity", message, where))
    elif turned:
        message = f"the response at {_named(turned)} moves against the hammer, elsewhere it does not; check that sensor"
        notices.append(Notice("driving-point-sign", message, where))
    return notices


def _named(dofs: Sequence[str]) -> str:
    return ", ".join(bare_dof(dof) for dof in dofs)


def _above_drift(frf: Frf, column: np.ndarray) -> np.ndarray:
    """The lines that say something: with a value, in the usable band, not at rest and above a drift.   returns (frequency,)"""
    low, high = max(frf.usable_band[0], _end_of_drift(frf, column)), frf.usable_band[1]
    return (frf.frequency >= low) & (frf.frequency <= high) & (frf.frequency > 0) & np.isfinite(column)


def _absorbed(frequency: np.ndarray, column: np.ndarray, form: str) -> float:
    """Net share of the absorbed power, -1 to 1: of mobility or accelerance the clearer one, for noise clouds one of them.

    frequency : (line,) Hz   column : complex (line,)
    """
    shares = []
    for taken in (
        convert_frf(frequency, column, form, "mobility").real,
        convert_frf(frequency, column, form, "accelerance").imag,
    ):
        shares.append(float(taken.sum() / max(np.abs(taken).sum(), 1e-300)))
    return max(shares, key=abs)


def _answers_before_the_hit(frequency: np.ndarray, column: np.ndarray, form: str) -> bool:
    """Whether the impulse response lies in negative time.   frequency : (line,) Hz   column : complex (line,)"""
    if len(frequency) < FEWEST_LINES:
        return False
    step = float(np.median(np.diff(frequency)))
    if np.abs(np.diff(frequency) / step - 1).max() > 1e-3:
        return False
    mobility = convert_frf(
        frequency, column, form, "mobility"
    )  # whose modes are equally high, whatever their frequency
    fade = np.ones(len(mobility))  # the cut at the top would ring over the whole of time
    length = len(fade) // 4
    fade[-length:] = np.cos(np.linspace(0, np.pi / 2, length)) ** 2
    answer = np.fft.irfft(np.concatenate([np.zeros(round(frequency[0] / step), complex), mobility * fade]))
    far = len(answer) // 4  # where both halves wrap round
    before, after = np.sum(answer[-1:-far:-1] ** 2), np.sum(answer[1:far] ** 2)
    return bool(before > _BACKWARDS * after)


def low_frequency_drift(frf: Frf, where: str) -> list[Notice]:
    """Notices about driving points whose receptance grows towards 0 Hz beyond every resonance."""
    if frf.form not in DERIVATIVES:
        return []
    ends = []
    for dof in frf.inputs:
        if dof in frf.outputs:
            column = frf.values[:, frf.outputs.index(dof), frf.inputs.index(dof)]
            ends.append(_end_of_drift(frf, column))
    if not any(ends):
        return []
    message = (
        f"below {max(ends):.0f} Hz the receptance grows towards 0 Hz beyond every resonance, as by drift or noise of a sensor; "
        f"leave these lines out with 'millcal export --band {max(ends):.0f} {frf.usable_band[1]:.0f}'"
    )
    return [Notice("low-frequency-drift", message, where)]


def _end_of_drift(frf: Frf, column: np.ndarray) -> float:
    """The frequency where the receptance stops falling from its lowest lines on, Hz; 0 where that is no drift.

    Looked at are medians over thirds of an octave, which neither a bad line nor a sharp antiresonance moves.
    """
    inside = (frf.frequency >= frf.usable_band[0]) & (frf.frequency <= frf.usable_band[1]) & (frf.frequency > 0)
    inside &= np.isfinite(column)
    if inside.sum() < 3:
        return 0.0
    lines = frf.frequency[inside]
    size = np.abs(convert_frf(lines, column[inside], frf.form, "receptance"))
    third = np.floor(3 * np.log2(lines / lines[0]) + 1e-9).astype(int)
    there = np.unique(third)
    level = np.array([np.median(size[third == k]) for k in there])
    middle = np.array([np.median(lines[third == k]) for k in there])
    rising = np.flatnonzero(np.diff(level) >= 0)
    valley = int(rising[0]) if len(rising) else len(level) - 1
    if valley == 0 or level[0] <= _DRIFT * size[lines > middle[valley]].max(initial=0.0):
        return 0.0
    octaves = np.log2(middle[valley] / middle[0])
    steep = np.log2(level[0] / max(level[valley], 1e-300)) >= _STEEP * octaves
    return float(middle[valley]) if octaves >= _OCTAVES and steep else 0.0
