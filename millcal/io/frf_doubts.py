"""What can be doubted in an FRF of another program, by physics alone: the sign of its driving points, and drift at 0 Hz.

A passive structure absorbs at the point where it is hit: Im of the accelerance is positive there, that of the receptance
negative. Two mistakes turn it: a sensor or hammer of the wrong sign, and a file that was written for x = Re X e^{-jwt},
whose FRF is the complex conjugate. The impulse response tells them apart, for a conjugated FRF answers before the hit.

A tool in its spindle is stiffest at rest. Where its receptance grows towards 0 Hz beyond every resonance, it is the offset of
an accelerometer that was divided by w^2; a stability map would find the softest mode of all there.
"""

import numpy as np

from millcal.data import Frf, Notice
from millcal.io.frf_pairs import bare_dof
from millcal.physics.structure import DERIVATIVES, convert_frf

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
    turned, right, conjugated = [], [], []
    for dof in frf.inputs:
        if dof not in frf.outputs:
            continue
        column = frf.values[:, frf.outputs.index(dof), frf.inputs.index(dof)]
        share = _absorbed(frf, column)
        if share < -_CLEAR:
            turned.append(dof)
            if _answers_before_the_hit(frf.frequency, column):
                conjugated.append(dof)
        elif share > _CLEAR:
            right.append(dof)
    if not turned:
        return []
    named = ", ".join(bare_dof(dof) for dof in turned)
    if conjugated == turned:
        message = (
            f"the response at {named} comes before the hit: the file has the phase of its FRF conjugated; "
            "take the other sign of the imaginary part with --conjugate"
        )
        return [Notice("conjugated", message, where)]
    if not right:
        message = (
            f"the response at {named} moves against the hammer: accelerometer polarity or hammer sign; "
            "turn it with a sign in front of its dof, as in --response=-tipX"
        )
        return [Notice("accelerometer-polarity", message, where)]
    message = f"the response at {named} moves against the hammer, elsewhere it does not; check that sensor"
    return [Notice("driving-point-sign", message, where)]


def _absorbed(frf: Frf, column: np.ndarray) -> float:
    """Net share of the absorbed power, -1 to 1; each line counts by its accelerance, so that drift at DC counts little."""
    inside = (frf.frequency >= frf.usable_band[0]) & (frf.frequency <= frf.usable_band[1]) & (frf.frequency > 0)
    inside &= np.isfinite(column)
    taken = convert_frf(frf.frequency[inside], column[inside], frf.form, "accelerance").imag
    return float(taken.sum() / max(np.abs(taken).sum(), 1e-300))


def _answers_before_the_hit(frequency: np.ndarray, column: np.ndarray) -> bool:
    """Whether the impulse response lies in negative time.   frequency : even lines   column : complex (frequency,)"""
    step = float(np.median(np.diff(frequency)))
    first = round(frequency[0] / step)
    if len(frequency) < 32 or np.abs(np.diff(frequency) / step - 1).max() > 1e-3:
        return False
    # Lines at both ends fade out, so that drift at DC and the cut at the top do not ring over the whole of time.
    fade = np.hanning(len(frequency) + 2)[1:-1]
    spectrum = np.concatenate([np.zeros(first, complex), np.where(np.isfinite(column), column, 0.0) * fade])
    answer = np.fft.irfft(spectrum)
    half = len(answer) // 2
    near = slice(1, half // 2)  # far from the hit both halves wrap round
    before, after = np.sum(answer[::-1][near] ** 2), np.sum(answer[near] ** 2)
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
        f"below {max(ends):.0f} Hz the receptance grows towards 0 Hz beyond every resonance, as by the drift of a sensor; leave "
        f"these lines out with 'millcal export --band {max(ends):.0f} {frf.usable_band[1]:.0f}'"
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
