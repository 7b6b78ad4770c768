"""An FRF to modes: how many, where, with which residues, and how well each is known. Nobody has to click.

The modes are fitted to all entries of the FRF at once, in the form that was measured and with what the records' ends took
away (`numerics.modal_basis`), so that neither a division by w^2 nor a decay cut short biases them. Real modes are preferred;
complex ones are taken where they halve what is left, or where real ones would need a driving point that gives power away.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from millcal.data import Frf, ModalFit, Modes, Notice
from millcal.errors import IllPosedError
from millcal.numerics.mode_fit import Fit, Model, fit_poles
from millcal.numerics.pole_search import Poles, groups_of, search_poles
from millcal.physics.structure import DERIVATIVES, convert_frf
from millcal.stages.modes.intervals import Deviations, deviations, modelled, remainders, residues
from millcal.stages.modes.problem import (
    FEWEST_LINES,
    Problem,
    forms_of,
    lines_of,
    measured_values,
    problem_of,
    stride_of,
)
from millcal.stages.modes.search import criterion, grow, seeds_of

REMAINDER = (-2, 0, 2)  # powers of s: mass below the band, flexibility above it, and its rise towards the next mode
ORDERS = tuple(range(2, 17))  # of the stabilisation chart
SURE = 4  # orders that have a pole which is no accident
COMPLEX_GAIN = 0.5  # share of the squared residual that complex modes must take away
TURNED = np.radians(15.0)  # phase of a driving point beyond which a mode is not real
SPLIT = np.radians(40.0)  # and beyond which it is no mode at all
ALIKE = 0.9  # of two close modes: they are one
OVERDAMPED = 0.5  # damping ratio of what is no resonance
EXPLAINED = 0.5  # share of the response that a fit must leave at most

Progress = Callable[[float, str], None]


def fit_modes(
    frf: Frf,
    *,
    band: tuple[float, float] | None = None,
    modes: int | None = None,
    near: Sequence[float] = (),
    remainder: int | None = None,
    complex_modes: bool | None = None,
    most: int = 12,
    progress: Progress | None = None,
) -> Modes:
    """Modes of a measured FRF with intervals.

    band : Hz, the usable one when None   modes : how many; None lets the data decide, up to `most`
    near : frequencies in Hz where modes are known to be; alone, they are all there are
    remainder : terms for the modes outside the band, 0 to 4; None takes three
    complex_modes : True or False where the user knows
    raises IllPosedError where the FRF has no form, no lines or no mode to fit
    """
    progress = progress or (lambda share, label: None)
    if frf.form not in DERIVATIVES:
        raise IllPosedError(f"modes: a {frf.form} is no response of a structure to a force; give an FRF of motion")
    lines = lines_of(frf, band)
    for frequency in near:
        if not frf.frequency[lines[0]] <= frequency <= frf.frequency[lines[-1]]:
            raise IllPosedError(
                f"modes: no line near {frequency:g} Hz, the band goes from {frf.frequency[lines[0]]:g} to "
                f"{frf.frequency[lines[-1]]:g} Hz; widen it"
            )
    problem = problem_of(frf, lines[:: stride_of(frf)])
    progress(0.1, "seeds")
    poles = _chart(frf, problem)
    powers = (*REMAINDER, 4)[: 3 if remainder is None else remainder]
    progress(0.3, "modes")
    coarse = problem_of(frf, problem.lines[:: _thinning(problem, poles)])
    fit, model = _search(frf, coarse, poles, powers, modes, near, complex_modes, most)
    fit = fit_poles(problem.channels, fit.natural_frequency, fit.damping_ratio, model)  # to the last digit
    if not len(fit.natural_frequency):
        raise IllPosedError(
            f"modes: no mode stands out of the noise between {problem.frequency[0]:g} and {problem.frequency[-1]:g} Hz; "
            "look at the coherence, or name one with near"
        )
    progress(0.8, "intervals")
    return _record(frf, problem, lines, fit, model, poles)


def corrected_frf(frf: Frf, modes: Modes) -> Frf:
    """The FRF on the lines of the fit without what windows and the records' ends took away.

    Measured less modelled plus synthesised: noise and everything the modes do not describe stay as they are.
    """
    fit = modes.fit
    if fit is None:
        raise IllPosedError("modes: given by hand; only fitted ones can correct an FRF")
    lines = np.flatnonzero((frf.frequency >= fit.frequency[0]) & (frf.frequency <= fit.frequency[-1]))
    if len(lines) != len(fit.frequency) or not np.allclose(frf.frequency[lines], fit.frequency):
        raise IllPosedError("modes: fitted to another FRF; fit this one first")
    lost = fit.synthesised - fit.modelled
    values = frf.values[lines] + _in_form(frf, frf.frequency[lines], lost)

    def of_lines(array: np.ndarray | None) -> np.ndarray | None:
        return None if array is None else array[lines]

    return replace(
        frf,
        frequency=frf.frequency[lines],
        values=values,
        coherence=of_lines(frf.coherence),
        multiple_coherence=of_lines(frf.multiple_coherence),
        variance=of_lines(frf.variance),
        force_spectrum=of_lines(frf.force_spectrum),
        damping_shift=0.0,
        tests=(),
        notices=(
            *frf.notices,
            Notice("truncation-corrected", "what the records' ends took away is put back", level="note"),
        ),
    )


def _in_form(frf: Frf, frequency: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values in the measured forms, in the form of the FRF.   values : complex (line, output, input)"""
    out = np.array(values)
    for row, form in enumerate(forms_of(frf)):
        if form != frf.form:
            out[:, row] = convert_frf(frequency, out[:, row], form, frf.form)
    return out


def _chart(frf: Frf, problem: Problem) -> Poles:
    """Poles of every order, from all pairs that were measured."""
    values = measured_values(frf, problem.lines)
    weight = np.zeros(values.shape)
    for test in problem.tests:
        channels = test.channels
        size = np.abs(np.einsum("ljj->lj", channels.root))
        block = size[None] / channels.noise[:, None, None] / channels.values.shape[1] ** 0.5
        test.put(weight, block.transpose(1, 0, 2))
    values = np.where(weight > 0, np.nan_to_num(values), 0.0)
    orders = [order for order in ORDERS if 3 * order < len(problem.lines)]
    return search_poles(problem.frequency, values, weight / max(weight.max(), 1e-300), orders)


def _thinning(problem: Problem, poles: Poles) -> int:
    """Every how many lines will do for the search: two within half the width of the narrowest pole that several orders have."""
    frequency, damping, count = groups_of(poles)
    sure = count >= SURE
    if not sure.any():
        return 1
    narrowest = float((frequency * damping)[sure].min())
    spacing = float(problem.frequency[1] - problem.frequency[0])
    return int(np.clip(narrowest / (2 * spacing), 1, max(1, len(problem.lines) // 200)))


def _search(
    frf: Frf,
    problem: Problem,
    poles: Poles,
    powers: tuple[int, ...],
    count: int | None,
    near: Sequence[float],
    complex_modes: bool | None,
    most: int,
) -> tuple[Fit, Model]:
    """Real modes, and complex ones where asked for or where the data ask for them."""
    seeds = seeds_of(poles, problem.frequency)
    channels = problem.channels

    def grown(model: Model) -> tuple[Fit, bool]:
        return grow(
            channels, problem.frequency, seeds, model,
            count=count, most=most, start=near, possible=lambda fit: _is_possible(frf, problem, fit, model),
        )  # fmt: skip

    model = Model(bool(complex_modes), powers)
    fit, held_back = grown(model)
    if complex_modes is None and len(fit.natural_frequency):
        other = Model(True, powers)
        rival = fit_poles(channels, fit.natural_frequency, fit.damping_ratio, other, max_steps=2)
        if held_back or _asks_for(rival, fit):
            rival, _ = grown(other)
            if _asks_for(rival, fit) and _is_possible(frf, problem, rival, other):
                fit, model = rival, other
    return fit, model


def _asks_for(rival: Fit, fit: Fit) -> bool:
    """Whether complex modes earn their unknowns."""
    return criterion(rival) < criterion(fit) and rival.cost < COMPLEX_GAIN * fit.cost


def _is_possible(frf: Frf, problem: Problem, fit: Fit, model: Model) -> bool:
    """Whether the modes can be those of a structure, and not terms that describe a curve.

    No mode is as good as gone after one swing. No two modes lie within half a width of their resonances and move alike: one
    with a joint that rattles or a stiffness that changes looks like that. And in no mode does a driving point give power
    away while it takes power up in the others; the constant of a complex mode may turn, but not by more than `SPLIT`.
    """
    residue = residues(problem, fit, model, (len(frf.outputs), len(frf.inputs)))
    fn, zeta = fit.natural_frequency, fit.damping_ratio
    if (zeta > OVERDAMPED).any():
        return False
    apart = np.abs(fn[:, None] - fn) / (zeta * fn + (zeta * fn)[:, None])
    alike = mac_of(residue) > ALIKE
    if np.triu((apart < 0.5) & alike, 1).any():
        return False
    for constants in _complex_constants(frf, fit, residue).T:  # of one driving point
        size = np.abs(constants) / (fn**2 * zeta)  # of the resonance
        sign = np.sign(np.sum(np.sign(constants.real) * size))
        if np.any((np.abs(np.angle(constants * sign)) > SPLIT) & (size > 0.02 * size.max())):
            return False
    return True


def mac_of(residue: np.ndarray) -> np.ndarray:
    """Modal assurance criterion of whole residue matrices: modes alike in where they are seen and in what excites them.

    residue : complex (mode, output, input), nan where nothing was measured   returns (mode, mode)
    """
    return _mac(np.nan_to_num(residue).reshape(len(residue), -1))


def _complex_constants(frf: Frf, fit: Fit, residue: np.ndarray) -> np.ndarray:
    """2j w_d A of each driving point.   returns complex (mode, driving point)"""
    w_d = 2 * np.pi * fit.natural_frequency * np.sqrt(1 - fit.damping_ratio**2)
    pairs = driving_points(frf.outputs, frf.inputs)
    alpha = 2j * w_d[:, None, None] * residue
    return np.stack([alpha[:, o, i] for o, i in pairs], axis=1) if pairs else np.zeros((len(w_d), 0), complex)


def driving_constants(frf: Frf, fit: Fit, residue: np.ndarray) -> np.ndarray:
    """alpha = Re(2j w_d A) of each driving point.   returns (mode, driving point)"""
    return _complex_constants(frf, fit, residue).real


def driving_points(outputs: Sequence[str], inputs: Sequence[str]) -> list[tuple[int, int]]:
    """(output, input) that are one point in one direction, in the order of the inputs."""
    names = [dof.lstrip("+-") for dof in outputs]
    return [(names.index(dof.lstrip("+-")), i) for i, dof in enumerate(inputs) if dof.lstrip("+-") in names]


def _record(frf: Frf, problem: Problem, lines: np.ndarray, fit: Fit, model: Model, poles: Poles) -> Modes:
    """Everything about a fit, with intervals, on all lines of the band."""
    shape = (len(frf.outputs), len(frf.inputs))
    residue = residues(problem, fit, model, shape)
    spread = deviations(problem, fit, model, shape)
    full = problem if len(lines) == len(problem.lines) else problem_of(frf, lines)
    measured = measured_values(frf, lines)
    as_measured = modelled(full, fit, model, shape, exact=True)
    synthesised = modelled(full, fit, model, shape, exact=False)
    left, size = np.abs(measured - as_measured) ** 2, np.abs(measured) ** 2
    w_d = 2 * np.pi * fit.natural_frequency * np.sqrt(1 - fit.damping_ratio**2)
    alpha = driving_constants(frf, fit, residue)
    pairs = driving_points(frf.outputs, frf.inputs)
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = (2 * np.pi * fit.natural_frequency[:, None]) ** 2 / alpha if pairs else np.zeros((len(w_d), 0))
    first = [k for k, (_, i) in enumerate(pairs) if i == 0]
    at_first = stiffness[:, first[0]] if first else np.full(len(w_d), np.nan)
    shapes = _shapes(residue)
    residual = np.sqrt(
        np.divide(np.nansum(left, 0), np.nansum(size, 0), out=np.full(shape, np.nan), where=np.nansum(size, 0) > 0)
    )
    record = ModalFit(
        residue=residue,
        remainder=remainders(problem, fit, model, shape),
        remainder_power=np.array(model.remainder, float),
        frequency_deviation=spread.frequency,
        damping_deviation=spread.damping,
        residue_deviation=spread.residue,
        dof=spread.dof,
        interval_from=spread.source,  # type: ignore[arg-type]
        frequency=frf.frequency[lines],
        measured=measured,
        modelled=as_measured,
        synthesised=synthesised,
        residual=residual,
        residual_relative=float(np.sqrt(np.nansum(left) / np.nansum(size))),
        complex_modes=model.complex_modes,
        mac=_mac(shapes),
        complexity=_complexity(shapes),
        chart_order=poles.order,
        chart_frequency=poles.frequency,
        chart_damping=poles.damping,
        chart_stable=poles.stable.astype(float),
        form=forms_of(frf)[0],  # type: ignore[arg-type]
        outputs=frf.outputs,
        inputs=frf.inputs,
        band=(float(frf.frequency[lines[0]]), float(frf.frequency[lines[-1]])),
    )
    return Modes(
        natural_frequency=fit.natural_frequency,
        damping_ratio=fit.damping_ratio,
        stiffness=at_first,
        axes=_axes(frf, alpha, pairs),
        fit=record,
        notices=tuple(_notices(frf, fit, record, alpha, pairs, spread)),
    )


def _axes(frf: Frf, alpha: np.ndarray, pairs: list[tuple[int, int]]) -> tuple[str, ...]:
    """The direction in which each mode is softest, by the last letter of the driving points' dofs; empty where none is."""
    letters = [frf.inputs[i][-1:].lower() for _, i in pairs]
    return tuple(letters[int(np.argmax(row))] if len(row) else "" for row in alpha)


def _shapes(residue: np.ndarray) -> np.ndarray:
    """Mode shapes over the outputs, as the column of the input that moves each most.   returns complex (mode, output)"""
    strength = np.nansum(np.abs(residue) ** 2, axis=1)
    best = np.argmax(strength, axis=1)
    return np.nan_to_num(residue[np.arange(len(residue)), :, best])


def _mac(shapes: np.ndarray) -> np.ndarray:
    """|phi^H psi|^2 / (phi^H phi psi^H psi).   returns (mode, mode)"""
    product = np.abs(shapes.conj() @ shapes.T) ** 2
    own = np.maximum(np.diag(product), 1e-300)
    return product / np.sqrt(np.outer(own, own))


def _complexity(shapes: np.ndarray) -> np.ndarray:
    """Mean phase deviation of each shape from the straight line through it, weighted by size.   returns (mode,) rad"""
    line = np.exp(0.5j * np.angle(np.sum(shapes**2, axis=1)))[:, None]
    turned = shapes / line
    off = np.arctan2(np.abs(turned.imag), np.abs(turned.real))
    size = np.abs(shapes)
    return np.sum(size * off, axis=1) / np.maximum(size.sum(axis=1), 1e-300)


def _notices(
    frf: Frf, fit: Fit, record: ModalFit, alpha: np.ndarray, pairs: list[tuple[int, int]], spread: Deviations
) -> list[Notice]:
    """What a user should know before relying on the numbers."""
    notices = []
    if record.residual_relative > EXPLAINED:
        left = f"{100 * record.residual_relative:.0f} %"
        notices.append(
            Notice("poor-fit", f"the modes leave {left} of the FRF unexplained; narrow the band, or see the coherence")
        )
    for k, (_, i) in enumerate(pairs):
        negative = [f"{fn:.0f}" for fn, a in zip(fit.natural_frequency, alpha[:, k], strict=True) if a <= 0]
        if len(negative) == len(alpha):
            message = f"every mode gives power to the hammer at {frf.inputs[i]}: turn the sign of the accelerometer or the hammer"
            notices.append(Notice("accelerometer-polarity", message))
        elif negative:
            message = f"the driving point {frf.inputs[i]} gives power away at {', '.join(negative)} Hz, which no structure does: "
            notices.append(Notice("not-passive", message + "those modes have no stiffness there"))
    for o, i in pairs:
        phase = np.angle(2j * record.residue[:, o, i])
        turned = [
            f"{fn:.0f}"
            for fn, a in zip(fit.natural_frequency, phase, strict=True)
            if np.abs(np.sin(a)) > np.sin(TURNED)
        ]
        if turned and record.complex_modes:
            message = (
                f"at {frf.inputs[i]} the modes at {', '.join(turned)} Hz are far from real; their stiffness is a guess"
            )
            notices.append(Notice("complex-driving-point", message))
    if spread.source != "jackknife":
        message = "intervals come from the scatter of the lines alone, as there are not three hits; they are too short"
        notices.append(Notice("intervals-from-lines", message))
    return notices
