"""Everything about a fit as one record: numbers, intervals, curves for the report, and what to be told before relying on it."""

import numpy as np

from millcal.data import Frf, ModalFit, Modes, Notice
from millcal.numerics.mode_fit import Fit
from millcal.numerics.pole_search import Poles
from millcal.stages.modes.delays import SURE
from millcal.stages.modes.intervals import deviations, modelled, remainders, residues, why_no_jackknife
from millcal.stages.modes.possible import complexity, driving_constants, mac, measured_driving_points, moves, shapes_of
from millcal.stages.modes.problem import Problem, converted, forms_of, measured_values, problem_of
from millcal.stages.modes.search import Found

TURNED = np.radians(20.0)  # phase of a driving point beyond which a mode's stiffness is doubtful
EXPLAINED = 0.3  # share of the response that a fit may leave
LACKING = 0.02  # share of it that is worth a word where it is no noise
MISFIT = 4.0  # times the squared residual of noise


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
    measured, as_measured = measured_values(frf, lines), modelled(full, fit, model, exact=True)
    residual, residual_relative = _residual(full, measured, as_measured)
    forms = forms_of(frf)

    def curve(values: np.ndarray) -> np.ndarray:  # all in the form of the first output, whatever they were measured in
        return converted(full.frequency, values, forms, forms[:1] * len(forms))

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
        measured=curve(measured),
        modelled=curve(as_measured),
        synthesised=curve(modelled(full, fit, model, exact=False)),
        residual=residual,
        residual_relative=residual_relative,
        complex_modes=model.complex_modes,
        mac=mac(shapes),
        complexity=complexity(shapes),
        chart_order=poles.order,
        chart_frequency=poles.frequency,
        chart_damping=poles.damping,
        chart_stable=poles.stable.astype(float),
        delay=found.delay,
        delay_sd=found.delay_sd,
        form=forms[0],  # type: ignore[arg-type]
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
        notices=tuple(_notices(record, fit, constants, dofs, _intervals_from(problem))),
    )


def _intervals_from(problem: Problem) -> str:
    """Why intervals do not come from leaving hits out, and what they know instead."""
    why = why_no_jackknife(problem)
    if any(test.spectra is None for test in problem.tests):
        return f"{why}: intervals come from the scatter of the lines alone and are too short"
    return f"{why}: intervals come from the noise of the channels alone; how hits differ they do not know"


def _residual(problem: Problem, measured: np.ndarray, as_measured: np.ndarray) -> tuple[np.ndarray, float]:
    """What the fit leaves of each pair, and of all: |measured - modelled| / |measured| in the forms that were measured.

    Pairs in several forms add up as receptances at the middle of the band, where they are of one unit.
    measured, as_measured : complex (line, output, input)   returns (output, input) and their whole
    """
    power = np.zeros(len(problem.outputs))
    for test in problem.tests:
        power[test.rows[:, 0]] = test.channels.power
    scale = (2 * np.pi * problem.frequency.mean()) ** -power[:, None]
    fitted = np.where(np.isfinite(as_measured), scale * measured, np.nan)
    left, size = (np.nansum(np.abs(part) ** 2, axis=0) for part in (fitted - scale * as_measured, fitted))
    each = np.sqrt(np.divide(left, size, out=np.full(size.shape, np.nan), where=size > 0))
    return each, float(np.sqrt(left.sum() / size.sum()))


def _stiffness(fit: Fit, constants: np.ndarray, dofs: list[str], first: str) -> np.ndarray:
    """k at the driving point of the first input; nan where it was not measured or the constant is no structure's."""
    if first not in dofs:
        return np.full(len(constants), np.nan)
    alpha = constants[:, dofs.index(first)].real
    return (2 * np.pi * fit.natural_frequency) ** 2 / np.where(alpha > 0, alpha, np.nan)


def _notices(record: ModalFit, fit: Fit, constants: np.ndarray, dofs: list[str], behind: str) -> list[Notice]:
    """What a user should know before relying on the numbers.   behind : where intervals come from"""
    notices = []
    if record.residual_relative > EXPLAINED:
        left = f"{100 * record.residual_relative:.0f} %"
        message = f"the modes leave {left} of the FRF unexplained; narrow the band, or see the coherence"
        notices.append(Notice("poor-fit", message))
    elif record.residual_relative > LACKING and fit.cost > MISFIT * fit.expected:
        left = f"{100 * record.residual_relative:.0f} %"
        message = f"the modes leave {left} of the FRF, far more than its noise: the structure is not quite what they say, and "
        notices.append(Notice("modes-lack", message + "their intervals know nothing of that"))
    low, high = record.band
    lost = np.isfinite(record.measured).any(axis=0) & ~np.isfinite(record.residue).all(axis=0)
    if lost.any():
        pairs = ", ".join(f"{record.outputs[o]}/{record.inputs[i]}" for o, i in np.argwhere(lost))
        message = f"{pairs}: left out of the fit, as not every line of the band has a value; narrow the band"
        notices.append(Notice("pairs-left-out", message))
    outside = [f"{fn:.0f}" for fn in fit.natural_frequency if not low <= fn <= high]
    if outside:
        message = (
            f"{', '.join(outside)} Hz is outside of the band: it stands for what lies there, and is no mode to rely on"
        )
        notices.append(Notice("mode-outside-band", message))
    if record.delay is not None and record.delay_sd is not None:
        sure = np.abs(record.delay) > SURE * record.delay_sd
        late = [(dof, tau) for dof, tau, known in zip(record.outputs, record.delay, sure, strict=True) if known]
        told = ", ".join(f"{dof} by {1e6 * tau:.1f} us" for dof, tau in late)
        mending = " ".join(f"--delay {dof}={tau:.2e}" for dof, tau in late)
        message = f"responses come late against the hammer, {told}; the modes are fitted with that taken out, the FRF has it in: "
        notices.append(Notice("delay", message + f"estimate it with {mending}"))
    for dof, own in zip(dofs, constants.T, strict=True):
        notices += _of_driving_point(dof, record, fit, own)
    if record.interval_from != "jackknife":
        notices.append(Notice("intervals-from-lines", behind))
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
    if record.residual_relative > EXPLAINED:
        return []  # signs of terms that describe nothing
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
