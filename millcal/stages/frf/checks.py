"""What an FRF must fulfil whatever was hit: a dynamometer reads the force at rest, and a driving point takes power up."""

from collections.abc import Sequence

import numpy as np

from millcal.data import Notice
from millcal.physics.structure import convert_frf

GAIN_AT_REST = 0.05  # what hammer and dynamometer may differ by
LATE = 0.01  # rms over the lines by which a driving point may give power back, as a share of its size


def gain_at_rest(
    frequency: np.ndarray,
    values: np.ndarray,
    outputs: Sequence[str],
    inputs: Sequence[str],
    band: tuple[float, float],
) -> list[Notice]:
    """At rest a dynamometer reads the force that acts on it: where it does not, a sign or a calibration is wrong."""
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[0] + 0.02 * (band[1] - band[0])))
    notices = []
    for dof in inputs:
        if dof not in outputs or not len(lines):
            continue
        gain = float(np.median(values[lines, outputs.index(dof), inputs.index(dof)].real))
        if gain < 0:
            message = (
                f"the dynamometer answers against the hammer at {dof}; "
                f"turn its channel with --flip {dof}, or the hammer by its name"
            )
            notices.append(Notice("dynamometer-polarity", message))
        elif abs(gain - 1) > GAIN_AT_REST:
            message = f"at low frequency the dynamometer reads {gain:.2f} of the hammer's force at {dof}; "
            notices.append(Notice("gain-at-rest", message + "check both calibrations, and that the hit was straight"))
    return notices


def signs(
    frequency: np.ndarray,
    values: np.ndarray,
    measured: Sequence[str],
    outputs: Sequence[str],
    inputs: Sequence[str],
    band: tuple[float, float],
) -> list[Notice]:
    """A driving point takes power up: the real part of its mobility cannot be negative. Where it is, something is turned."""
    inside = (frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0)
    turned, right = [], []
    for dof in dict.fromkeys(inputs):
        if dof not in outputs or not inside.any():
            continue
        row = outputs.index(dof)
        taken = convert_frf(frequency[inside], values[inside, row, inputs.index(dof)], measured[row], "mobility").real
        share = taken.sum() / max(np.abs(taken).sum(), 1e-300)
        if share < -0.5:
            turned.append(dof)
        elif share > 0.5:
            right.append(dof)
    if not turned:
        return []
    flips = " ".join(f"--flip {dof}" for dof in turned)
    names = ", ".join(f"'{dof}'" for dof in turned)
    mending = f"turn it with {flips} (in a recipe flip = [{names}] under [frf])"
    where = f"the response at {', '.join(turned)} moves against the hammer"
    if not right:
        return [Notice("accelerometer-polarity", f"{where}: accelerometer polarity or hammer sign; {mending}")]
    return [Notice("driving-point-sign", f"{where}, elsewhere it does not; check that sensor, or {mending}")]


def lateness(
    frequency: np.ndarray,
    values: np.ndarray,
    variance: np.ndarray,
    measured: Sequence[str],
    outputs: Sequence[str],
    inputs: Sequence[str],
    band: tuple[float, float],
) -> list[Notice]:
    """A response that is late seems to give power back, the more the higher the frequency: its phase is turned by -w tau.

    The real part of the mobility of a driving point is not negative, so the phase stays within a right angle, and near
    it between the resonances of little damping. The least delay, late or early, that brings it back there is told, where
    one does: the part that breaks the bound beyond three standard deviations must fall to a tenth.
    """
    inside = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0))
    inside = inside[:: max(1, len(inside) // 1024)]
    notices = []
    for dof in dict.fromkeys(inputs):
        if dof not in outputs or len(inside) < 32:
            continue
        row, column = outputs.index(dof), inputs.index(dof)
        H = values[inside, row, column]
        near = np.ones(min(31, len(inside)))  # of few hits the variance of one line is hardly known
        sd = np.sqrt(np.convolve(variance[inside, row, column], near / len(near), mode="same"))
        sd = np.where(np.isfinite(sd), sd, 0.05 * np.abs(H))
        clear = np.abs(H) > 10.0 * sd
        if clear.sum() < 32:
            continue
        f = frequency[inside][clear]
        Y = convert_frf(f, H[clear], measured[row], "mobility")
        unit, spread = Y / np.abs(Y), 3.0 * sd[clear] / np.abs(H[clear])
        if _given_back(unit, spread) < LATE:
            continue
        delays = np.linspace(-0.25 / f[-1], 0.25 / f[-1], 201)
        size = np.array([_given_back(unit * np.exp(2j * np.pi * f * delay), spread) for delay in delays])
        good = size < 0.1 * size[len(delays) // 2]
        if not good.any():
            continue
        least = delays[good][np.argmin(np.abs(delays[good]))]
        word = "late" if least > 0 else "early"
        notices.append(
            Notice(
                "response-late",
                f"the driving point {dof} gives power back, as where its response is {1e6 * abs(least):.0f} us or more "
                f"{word}; if the chain has that delay, state it: --delay {dof}={1e6 * least:.0f}e-6",
            )
        )
    return notices


def _given_back(unit: np.ndarray, spread: np.ndarray) -> float:
    """Rms over the lines of the power that a driving point gives back, beyond what its noise may explain.

    unit : (line,) phase of the mobility   spread : (line,) three standard deviations of it
    """
    return float(np.sqrt(np.mean(np.maximum(-unit.real - spread, 0.0) ** 2)))
