"""The FRF of fitted modes at the lines of cuts, and its errors: those of frequencies, damping and residues, shared by all lines.

Modes know the FRF better than any line of it where they are all there is: three of them take a tenth of the error of H1. Where
the structure has modes that the fit has not, their FRF is wrong by more than its noise says, so a check against the
measured one belongs to it.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Frf, ModalFit, Modes
from millcal.errors import IllPosedError
from millcal.numerics.errors_in_variables import MatrixError
from millcal.physics.structure import convert_frf, modal_receptance

OFF = 3.0  # times the deviation that noise lets expect, rms over the lines: beyond, the modes are not the structure


def modal_frf(modes: Modes, frequency: np.ndarray, sensors: Sequence[str], inputs: Sequence[str]) -> np.ndarray:
    """Accelerance of the fit.   frequency : (line,) Hz   returns complex (line, sensor, input), all dofs without sign"""
    fit = _fit_of(modes)
    return _accelerance(fit, frequency, modes.natural_frequency, modes.damping_ratio, fit.residue, sensors, inputs)


def modal_error(
    modes: Modes, frequency: np.ndarray, sensors: Sequence[str], inputs: Sequence[str]
) -> tuple[MatrixError, np.ndarray]:
    """What the fit's deviations make of the accelerance: real factors common to all lines and entries.

    returns the errors, and the variance of each entry (line, sensor, input)
    """
    fit = _fit_of(modes)
    sides = []
    for sign in (1.0, -1.0):
        sides.append(
            [
                _accelerance(
                    fit,
                    frequency,
                    modes.natural_frequency + sign * df,
                    np.clip(modes.damping_ratio + sign * dz, 1e-6, 0.99),
                    fit.residue + sign * dr,
                    sensors,
                    inputs,
                )
                for df, dz, dr in zip(
                    fit.frequency_deviation, fit.damping_deviation, fit.residue_deviation, strict=True
                )
            ]
        )
    deviations = (np.array(sides[0]) - np.array(sides[1])) / 2
    if not len(deviations):
        deviations = np.zeros((0, len(frequency), len(sensors), len(inputs)), complex)
    return MatrixError(deviations=deviations), np.sum(np.abs(deviations) ** 2, axis=0)


def _fit_of(modes: Modes) -> ModalFit:
    if modes.fit is None:
        raise IllPosedError(
            "modes: given by hand, without shapes at the sensors; give modes that were fitted to the FRF"
        )
    return modes.fit


def _accelerance(
    fit: ModalFit,
    frequency: np.ndarray,
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    residue: np.ndarray,
    sensors: Sequence[str],
    inputs: Sequence[str],
) -> np.ndarray:
    rows, row_sign = _places(sensors, fit.outputs, "sensors")
    columns, column_sign = _places(inputs, fit.inputs, "inputs")
    values = modal_receptance(
        frequency, natural_frequency, damping_ratio, residue, fit.remainder, tuple(fit.remainder_power)
    )[:, rows][:, :, columns]
    if not np.isfinite(values).all():
        raise IllPosedError("modes: the fit holds no value for some sensor and input; fit all of them, or use the FRF")
    return convert_frf(frequency, values * np.outer(row_sign, column_sign), "receptance", "accelerance")


def _places(dofs: Sequence[str], among: Sequence[str], what: str) -> tuple[list[int], np.ndarray]:
    plain = [name.lstrip("+-") for name in among]
    wanted = [dof.lstrip("+-") for dof in dofs]
    missing = [dof for dof in wanted if dof not in plain]
    if missing:
        raise IllPosedError(f"modes: {', '.join(missing)} not among their {what} {', '.join(plain)}; fit the whole FRF")
    places = [plain.index(dof) for dof in wanted]
    return places, np.array([-1.0 if among[place].startswith("-") else 1.0 for place in places])


def disagreement(measured: np.ndarray, modal: np.ndarray, variance: np.ndarray) -> float:
    """How far the modes are off the measured FRF at the lines, in its deviations, rms.   all (line, sensor, axis)"""
    return float(np.sqrt(np.mean(np.abs(measured - modal) ** 2 / np.maximum(variance, 1e-300))))


def relative_disagreement(measured: np.ndarray, modal: np.ndarray) -> float:
    """The same over the size of the FRF."""
    return float(np.linalg.norm(measured - modal) / np.linalg.norm(measured))


def why_not(frf: Frf, modes: Modes) -> str:
    """What keeps modes from standing for the FRF; empty where nothing does."""
    if modes.fit is None:
        return "they were given by hand, without shapes at the sensors"
    missing = {dof.lstrip("+-") for dof in frf.inputs} - {dof.lstrip("+-") for dof in modes.fit.inputs}
    return f"they were fitted without {', '.join(sorted(missing))}" if missing else ""
