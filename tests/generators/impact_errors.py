"""How far an FRF and its modes are from the truth: the measures of the acceptance tests and of the benchmark."""

from typing import NamedTuple

import numpy as np
from impact_cases import Structure

POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}


class ModalErrors(NamedTuple):
    """The worst of the modes within the band, all relative."""

    natural_frequency: float
    damping_ratio: float
    residue: float  # norm over all outputs and inputs
    driving: float  # of the modal constant at the driving point where the mode moves most: that of k, m and c

    def __str__(self) -> str:
        return " / ".join(f"{value:.1e}" for value in self[:3])


def frf_error(structure: Structure, frequency, values, form, outputs, inputs) -> float:
    """||dH|| / ||H|| as receptance, over all channels and the lines within the structure's band.

    frequency : (f,) Hz   values : (f, output, input) in `form`
    """
    inside = (frequency >= structure.band[0]) & (frequency <= structure.band[1])
    truth = structure.receptance(frequency[inside], outputs, inputs)
    found = values[inside] / ((2j * np.pi * frequency[inside]) ** POWER[form])[:, None, None]
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def modal_errors(structure: Structure, natural_frequency, damping_ratio, residue, outputs, inputs) -> ModalErrors:
    """Each true mode of the band against the nearest one found; infinite where one found serves two, or a pole is unstable.

    natural_frequency, damping_ratio : (mode,) found   residue : (mode, output, input) of the receptance
    """
    fn, zeta = structure.natural_frequency[structure.in_band], structure.damping_ratio[structure.in_band]
    if not len(natural_frequency):
        return ModalErrors(*[np.inf] * 4)
    nearest = np.argmin(np.abs(natural_frequency - fn[:, None]), axis=1)
    if len(set(nearest)) < len(fn) or (damping_ratio[nearest] <= 0).any():
        return ModalErrors(*[np.inf] * 4)
    alpha = structure.modal_constants(outputs, inputs)
    wd = 2 * np.pi * fn * np.sqrt(1 - zeta**2)
    A = alpha / (2j * wd)[:, None, None]
    found = residue[nearest]
    off = np.linalg.norm(found - A, axis=(1, 2)) / np.linalg.norm(A, axis=(1, 2))
    drives = [(outputs.index(dof), i) for i, dof in enumerate(inputs) if dof in outputs]
    driving = []
    for mode in range(len(fn)):
        o, i = max(drives, key=lambda drive: abs(alpha[(mode, *drive)]))
        constant = -2 * damped(natural_frequency, damping_ratio)[nearest[mode]] * found[mode, o, i].imag
        driving.append(abs(constant / alpha[mode, o, i] - 1))
    return ModalErrors(
        float(np.max(np.abs(natural_frequency[nearest] / fn - 1))),
        float(np.max(np.abs(damping_ratio[nearest] / zeta - 1))),
        float(np.max(off)),
        float(np.max(driving)),
    )


def damped(natural_frequency, damping_ratio):
    """Damped angular frequencies.   returns (mode,) rad/s"""
    return 2 * np.pi * natural_frequency * np.sqrt(1 - np.clip(damping_ratio, 0, 1) ** 2)
