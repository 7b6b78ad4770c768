"""Everything about a fit as one record: numbers, intervals, curves for the report, and what to be told before relying on it."""

import numpy as np

from millcal.data import Frf, ModalFit, Modes, Notice
from millcal.numerics.mode_fit import Fit
from millcal.numerics.pole_search import Poles
from millcal.stages.modes.intervals import deviations, modelled, remainders, residues
from millcal.stages.modes.possible import complexity, driving_constants, mac, measured_driving_points, moves, shapes_of
from millcal.stages.modes.problem import Problem, forms_of, measured_values, problem_of
from millcal.stages.modes.search import Found

TURNED = np.radians(20.0)  # phase of a driving point beyond which a mode's stiffness is doubtful
EXPLAINED = 0.5  # share of the response that a fit may leave


def answer(frf: Frf, problem: Problem, lines: np.ndarray, found: Found, poles: Poles) -> Modes:
    """The record of a fit, its curves on all lines of the band.

    problem : with delays taken out, on the lines of the fit   lines : of the band, indices among those of the FRF
    """
    fit, model = found.fit, found.model
    residue = residues(problem, fit, model)
    spread = deviations(problem, fit, model)
    full = problem
    if len(lines) != len(problem.lines):
        full = problem_of(frf, lines)
        full = full if found.delay is None else full.turned(found.delay)
    measured = measured_values(frf, lines)
    as_measured = modelled(full, fit, model, exact=True)
    left, size = (np.nansum(np.abs(part) ** 2, axis=0) for part in (measured - as_measured, measured))
    shapes = shapes_of(residue)
    record = ModalFit(
        residue=residue,
        remainder=remainders(problem, fit, model),
        remainder_power=np.array(model.remainder, float),
        frequency_deviation=spread.frequency,
        damping_deviation=spread.damping,
        residue_deviation=spread.residue,
        dof=spread.dof,
        interval_from=spread.source,  # type: ignore[arg-type]
        frequency=frf.frequency[lines],
        measured=measured,
        modelled=as_measured,
        synthesised=modelled(full, fit, model, exact=False),
        residual=np.sqrt(np.divide(left, size, out=np.full(size.shape, np.nan), where=size > 0)),
        residual_relative=float(np.sqrt(left.sum() / size.sum())),
        complex_modes=model.complex_modes,
        mac=mac(shapes),
        complexity=complexity(shapes),
        chart_order=poles.order,
        chart_frequency=poles.frequency,
        chart_damping=poles.damping,
        chart_stable=poles.stable.astype(float),
        delay=found.delay,
        delay_sd=found.delay_sd,
        form=forms_of(frf)[0],  # type: ignore[arg-type]
        outputs=frf.outputs,
        inputs=frf.inputs,
        band=(float(frf.frequency[lines[0]]), float(frf.frequency[lines[-1]])),
    )
    constants = driving_constants(problem, fit, residue)
    dofs = [frf.inputs[i] for _, i in measured_driving_points(problem, residue)]
    return Modes(
        natural_frequency=fit.natural_frequency,
        damping_ratio=fit.damping_ratio,
        stiffness=_stiffness(fit, constants, dofs, frf.inputs[0]),
        axes=tuple(dofs[int(np.argmax(row.real))][-1:].lower() if dofs else "" for row in constants),
        fit=record,
        notices=tuple(_notices(record, fit, constants, dofs)),
    )


def _stiffness(fit: Fit, constants: np.ndarray, dofs: list[str], first: str) -> np.ndarray:
    """k at the driving point of the first input; nan where it was not measured or the constant is no structure's."""
    if first not in dofs:
        return np.full(len(constants), np.nan)
    alpha = constants[:, dofs.index(first)].real
    return (2 * np.pi * fit.natural_frequency) ** 2 / np.where(alpha > 0, alpha, np.nan)


def _notices(record: ModalFit, fit: Fit, constants: np.ndarray, dofs: list[str]) -> list[Notice]:
    notices = []
    if record.residual_relative > EXPLAINED:
        left = f"{100 * record.residual_relative:.0f} %"
        message = f"the modes leave {left} of the FRF unexplained; narrow the band, or see the coherence"
        notices.append(Notice("poor-fit", message))
    low, high = record.band
    outside = [f"{fn:.0f}" for fn in fit.natural_frequency if not low <= fn <= high]
    if outside:
        message = (
            f"{', '.join(outside)} Hz is outside of the band: it stands for what lies there, and is no mode to rely on"
        )
        notices.append(Notice("mode-outside-band", message))
    if record.delay is not None:
        told = ", ".join(f"{dof} {1e6 * tau:.1f}" for dof, tau in zip(record.outputs, record.delay, strict=True))
        message = (
            f"responses come late against the hammer, by {told} us; the modes are fitted with that taken out, the FRF "
        )
        notices.append(Notice("delay", message + "has it in: state it when the FRF is estimated (--delay)"))
    for dof, own in zip(dofs, constants.T, strict=True):
        notices += _of_driving_point(dof, record, fit, own)
    if record.interval_from != "jackknife":
        message = "intervals come from the scatter of the lines alone, as there are not three hits; they are too short"
        notices.append(Notice("intervals-from-lines", message))
    return notices


def _of_driving_point(dof: str, record: ModalFit, fit: Fit, constants: np.ndarray) -> list[Notice]:
    """What the constants of one driving point say of its sign and of its phases, in the modes in which it moves."""
    moving = moves(fit, constants)
    frequency, constants = fit.natural_frequency[moving], constants[moving]
    negative = [f"{fn:.0f}" for fn, constant in zip(frequency, constants.real, strict=True) if constant <= 0]
    turned = [
        f"{fn:.0f}"
        for fn, constant in zip(frequency, constants, strict=True)
        if abs(np.sin(np.angle(constant))) > np.sin(TURNED)
    ]
    notices = []
    if negative and len(negative) == len(frequency):
        message = f"every mode gives power to the hammer at {dof}: turn the sign of the accelerometer or of the hammer"
        notices.append(Notice("accelerometer-polarity", message))
    elif negative:
        message = f"the driving point {dof} gives power away at {', '.join(negative)} Hz, which no structure does: those modes "
        notices.append(Notice("not-passive", message + "have no stiffness there"))
    if turned and record.complex_modes:
        message = f"at {dof} the modes at {', '.join(turned)} Hz are far from real; their stiffness is a guess"
        notices.append(Notice("complex-driving-point", message))
    return notices
