"""The FRF of fitted modes at the lines of cuts, and its errors: those of frequencies, damping and residues, shared by all lines.

Modes know the FRF better than any line of it where they are all there is: three of them take a tenth of the error of H1. Where
the structure has modes that the fit has not, their FRF is wrong by more than its noise says: what they miss of the
measured one about a line, beyond its noise, is an error of that line.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Frf, ModalFit, Modes
from millcal.errors import IllPosedError
from millcal.numerics.errors_in_variables import MatrixError
from millcal.physics.structure import convert_frf, convert_frf_variance, modal_receptance

NEIGHBOURS = 6  # lines of the FRF to either side, over which what the modes miss is averaged
OWN = 0.5  # share of the covariance of a fit's parameters that is taken for each one's own: leaving out nine hits tells sixty
# parameters' errors in as few directions as there are hits, and many cuts would find those in which there is none
OFF = 1.7  # times the deviation that noise lets expect, rms over the lines: beyond, the modes are not the structure


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
    if not len(fit.frequency_deviation):
        nothing = np.zeros((0, len(frequency), len(sensors), len(inputs)), complex)
        return MatrixError(deviations=nothing), np.zeros(nothing.shape[1:])

    def moved(df: np.ndarray, dz: np.ndarray, dr: np.ndarray) -> np.ndarray:
        """Half the difference of the accelerances to either side."""
        high, low = (
            _accelerance(
                fit,
                frequency,
                modes.natural_frequency + sign * df,
                np.clip(modes.damping_ratio + sign * dz, 1e-6, 0.99),
                fit.residue + sign * dr,
                sensors,
                inputs,
            )
            for sign in (1.0, -1.0)
        )
        return (high - low) / 2

    parameters = fit.frequency_deviation, fit.damping_deviation, fit.residue_deviation
    left_out = [moved(*own) for own in zip(*parameters, strict=True)]
    still, held = np.zeros_like(modes.natural_frequency), np.zeros_like(fit.residue)
    frequency_sd, damping_sd = (np.sqrt(np.sum(own**2, axis=0)) for own in parameters[:2])
    alone = []
    for mode in np.eye(len(still)):
        alone += [moved(frequency_sd * mode, still, held), moved(still, damping_sd * mode, held)]
    for unit in (1.0, 1j):
        part = fit.residue_deviation.real if unit == 1.0 else fit.residue_deviation.imag
        sd = np.sqrt(np.sum(part**2, axis=0))
        for place in zip(*np.nonzero(sd > 0), strict=True):
            dr = held.astype(complex)
            dr[place] = unit * sd[place]
            alone.append(moved(still, still, dr))
    deviations = np.concatenate([np.sqrt(1 - OWN) * np.array(left_out), np.sqrt(OWN) * np.array(alone)])
    return MatrixError(deviations=deviations), np.sum(np.abs(deviations) ** 2, axis=0)


def missed(frf: Frf, modes: Modes, frequency: np.ndarray, sensors: Sequence[str], inputs: Sequence[str]) -> np.ndarray:
    """Variance of what the modes miss of the measured FRF about each line, beyond its noise: modes that the fit has not.

    returns (line, sensor, input)
    """
    step = frf.frequency[1] - frf.frequency[0]
    rows, _ = _places(sensors, frf.outputs, "sensors")
    columns, _ = _places(inputs, frf.inputs, "inputs")
    near = np.flatnonzero(
        (frf.frequency > 0)
        & (frf.frequency >= frequency.min() - NEIGHBOURS * step)
        & (frf.frequency <= frequency.max() + NEIGHBOURS * step)
    )
    at = frf.frequency[near]
    names_out, names_in = [frf.outputs[row] for row in rows], [frf.inputs[column] for column in columns]
    own = modal_frf(modes, at, [name.lstrip("+-") for name in names_out], [name.lstrip("+-") for name in names_in])
    row_sign = np.array([-1.0 if name.startswith("-") else 1.0 for name in names_out])
    column_sign = np.array([-1.0 if name.startswith("-") else 1.0 for name in names_in])
    measured = convert_frf(at, frf.values[near][:, rows][:, :, columns], frf.form, "accelerance")
    off = np.abs(measured * np.outer(row_sign, column_sign) - own) ** 2
    if frf.variance is not None:
        noise = np.nan_to_num(frf.variance[near][:, rows][:, :, columns])
        off = off - convert_frf_variance(at, noise, frf.form, "accelerance")
    windows = np.abs(frequency[:, None] - at) <= (NEIGHBOURS + 0.5) * step  # (line, near)
    mean = np.einsum("ln,nsd->lsd", windows, off) / windows.sum(axis=1)[:, None, None]
    return np.asarray(np.maximum(mean, 0.0))


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


def relative_disagreement(measured: np.ndarray, modal: np.ndarray) -> float:
    """The same over the size of the FRF."""
    return float(np.linalg.norm(measured - modal) / np.linalg.norm(measured))
