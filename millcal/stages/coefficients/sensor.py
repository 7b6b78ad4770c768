"""A measured dynamometer in the model: its transmissibility at the harmonics, how far it reaches, and what its noise costs.

The FRF is used as it was measured, cross-talk included. Below its usable band it runs to what a dynamometer is at rest: gain 1
on its own axis (that is its calibration) and the cross-talk of the lowest lines. Above the band nothing is known, and harmonics
there are left out of the fit unless they are asked for. One FRF serves all cuts, so its errors are common to them and no
comparison of cuts can show them: they are carried into the covariance from the FRF's own variance.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import AXES, CutForce, Frf, Notice
from millcal.errors import IllPosedError
from millcal.stages.coefficients.harmonic_model import HarmonicFit, Sensor, rows_of_harmonics, slopes, unit_force

REST = 0.05  # share of the usable band, from its lower end, that stands for the sensor at rest
ALIKE = 4  # neighbouring lines that share their error: the transform of an impact test is padded with zeros


def interpolated_sensor(frf: Frf) -> Sensor:
    """A measured transmissibility as a function of frequency, axes matched by the last letter of the dofs.

    A pair that was not measured has gain 1 on the axis itself, 0 across.

    Raises
    ------
    IllPosedError
        The FRF is no transmissibility (N/N).
    """
    from scipy.interpolate import CubicSpline

    if frf.form != "transmissibility":
        raise IllPosedError(
            f"sensor: the FRF is in the form {frf.form!r}; a dynamometer in the model needs force over force (N/N): "
            "measure the hammer's force against the dynamometer's channels"
        )
    low = frf.usable_band[0]
    splines = {}
    for i, j, o, c in _pairs(frf):
        known = np.isfinite(frf.values[:, o, c]) & (frf.frequency >= low)
        line, value = frf.frequency[known], frf.values[known, o, c]
        if len(line) < 2:
            continue
        if line[0] > 0:
            rest = 1.0 if i == j else value[_at_rest(frf, line)].real.mean()
            line, value = np.append(0.0, line), np.append(rest, value)
        splines[i, j] = CubicSpline(line, value), line[-1]

    def gain(frequency: np.ndarray) -> np.ndarray:
        total = np.repeat(np.eye(3, dtype=complex)[:, :, np.newaxis], len(frequency), axis=2)
        for pair, (spline, last) in splines.items():
            total[pair] = spline(np.minimum(frequency, last))
        return total

    return gain


def sensor_variance(frf: Frf, frequency: np.ndarray) -> np.ndarray:
    """E|error|^2 of the transmissibility, 0 where it is not known.   frequency : (k,) Hz   returns (axis, axis, k)"""
    total = np.zeros((3, 3, len(frequency)))
    if frf.variance is None:
        return total
    for i, j, o, c in _pairs(frf):
        known = np.isfinite(frf.variance[:, o, c])
        if not known.any():
            continue
        line, value = frf.frequency[known], frf.variance[known, o, c]
        total[i, j] = np.interp(frequency, line, value)
        if frf.usable_band[0] > 0:
            few = value[_at_rest(frf, line)]
            total[i, j, frequency == 0] = 0.0 if i == j or not len(few) else few.mean() * min(1.0, ALIKE / len(few))
    return total


def _at_rest(frf: Frf, line: np.ndarray) -> np.ndarray:
    """Which lines stand for the sensor at rest: the lowest of the usable band.   returns (line,) bool"""
    low, high = frf.usable_band
    return (line >= low) & (line <= max(low + REST * (high - low), line[line >= low].min(initial=high)))


def _pairs(frf: Frf) -> list[tuple[int, int, int, int]]:
    """Measured pairs: axis read, axis loaded, and their output and input."""
    outputs, inputs = (
        {dof[-1:].lower(): place for place, dof in reversed(list(enumerate(dofs)))}
        for dofs in (frf.outputs, frf.inputs)
    )
    return [
        (i, j, outputs[read], inputs[loaded])
        for i, read in enumerate(AXES)
        for j, loaded in enumerate(AXES)
        if read in outputs and loaded in inputs
    ]


def within_reach(
    frf: Frf, cuts: Sequence[CutForce], harmonics: int | None
) -> tuple[tuple[CutForce, ...], int, list[Notice]]:
    """The cuts with the harmonics that the FRF covers, or with those asked for; the highest of the fit; and notices.

    Raises
    ------
    IllPosedError
        Not even the first harmonic is covered, and none was asked for.
    """
    saved = min(cut.harmonics.shape[1] for cut in cuts) - 1
    spindle, high = max(cut.spindle_frequency for cut in cuts), frf.usable_band[1]
    covered = min(saved, int(high / spindle * (1 + 1e-9)))
    if covered < 1 and harmonics is None:
        raise IllPosedError(
            f"sensor: the FRF's usable band ends at {high:.0f} Hz, below the first harmonic, {spindle:.0f} Hz; "
            "hit with a harder tip, or do without the sensor's FRF"
        )
    band = covered if harmonics is None else min(saved, harmonics)
    kept = max(covered, band)
    notices = []
    if band > covered:
        message = (
            f"harmonics up to {band * spindle:.0f} Hz lie above the sensor FRF's usable band, {high:.0f} Hz; "
            "use fewer harmonics"
        )
        notices.append(Notice("sensor-band", message, "coefficients.harmonics"))
    elif kept < saved:
        message = (
            f"harmonics above {kept * spindle:.0f} Hz are left out: the sensor's FRF is usable up to {high:.0f} Hz"
        )
        notices.append(Notice("sensor-band", message, "sensor", "note"))
    pairs = {(i, j) for i, j, *_ in _pairs(frf)}
    if missing := [axis for i, axis in enumerate(AXES) if (i, i) not in pairs]:
        message = f"the sensor's FRF says nothing of {', '.join(missing)}, which is taken as perfect; hit it there too"
        notices.append(Notice("sensor-axis", message, "sensor"))
    if not sensor_variance(frf, np.array([0.5 * sum(frf.usable_band)])).any():
        message = "the sensor's FRF carries no variance: its errors are not in the intervals; hit at least three times"
        notices.append(Notice("sensor-variance", message, "sensor"))
    trimmed = (
        replace(c, harmonics=c.harmonics[:, : kept + 1], harmonics_variance=c.harmonics_variance[:, : kept + 1])
        for c in cuts
    )
    return tuple(trimmed), band, notices


def sensor_covariance(fit: HarmonicFit, frf: Frf) -> np.ndarray:
    """Covariance of (linear, shape) from the noise of the FRF, to first order.   returns (q + shape, q + shape)

    An error dG of the gain moves the model by dG x, x the force before the sensor, in all cuts alike; the fit follows by
    its pseudo-inverse. Errors at two harmonics, or of two pairs, are independent; real and imaginary part share the variance.
    """
    model = fit.model
    order, units = np.arange(model.band + 1), np.array([1.0, 1.0j])
    moved = []
    for cut, phase in zip(model.cuts, fit.phase, strict=True):
        force = np.einsum("jqk,q->jk", unit_force(model, cut, fit.shape, model.band), fit.linear)
        force = force * np.exp(1j * order * phase)
        spread = np.sqrt(sensor_variance(frf, order * cut.spindle_frequency) / 2)
        columns = np.zeros(
            (3, len(order), 3, 3, len(order), 2), complex
        )  # read, k; error of (read, loaded, k), Re or Im
        for i in range(3):
            columns[i, order, i, :, order] = np.einsum("jk,jk,u->kju", spread[i], force, units)
        moved.append(rows_of_harmonics(model, columns.reshape(3, len(order), -1)))
    slope = slopes(fit)
    scale = np.linalg.norm(slope, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    follows = np.linalg.pinv(slope / scale, rcond=1e-10) / scale[:, np.newaxis] @ np.concatenate(moved)
    n = len(fit.linear) + len(fit.shape)
    return (follows @ follows.T)[:n, :n]
