"""Cutting forces from accelerations: harmonics of the force, coefficients, and whether FRF, law and sensors agree.

The accelerations of a cut stand at the harmonics of the tooth passing, and an impact test tells what each newton at the tip
does there [Pawelko, Powalka, Berczynski 2012]. The force law leaves few forces possible. `gtls` uses all of that with the
errors that cut and FRF are known to have; the other methods are there to compare with. Its fit also judges: with the force
free, the accelerations must lie where the FRF can move the sensors; under the law, little more may be left.

The published constraint has its sign and scale wrong and is one of the many that hold; `physics.force_subspace` derives all.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from millcal.data import AXES, CutVibration, ForceHarmonics, Frf, Modes, Posterior
from millcal.errors import IllPosedError, RecipeError
from millcal.numerics.linear_inverse import as_real, as_real_vector
from millcal.physics.cutting_force import force_at
from millcal.physics.force_subspace import NAMES, harmonic_basis
from millcal.stages.forces import methods
from millcal.stages.forces.advice import advise_speeds
from millcal.stages.forces.fit import LawFit, fit_law
from millcal.stages.forces.judge import MUCH, judge, unlikely
from millcal.stages.forces.law import UNITS, Law, law_of
from millcal.stages.forces.methods import Reconstruction, coefficients_from_force, solver, system_of
from millcal.stages.forces.problem import RUNOUT_SEEN, Problem, notice_collector, problem_of, runout_seen
from millcal.stages.forces.remarks import line_condition

__all__ = ["PHASES", "advise_speeds", "reconstruct_forces"]

PHASES = ("auto", "fit", "known")
RUNOUTS = ("auto", "fit", "known")
ANGLES = 360
WIDENED = 1.2  # chi-square per degree of freedom from which it is said that the intervals are wider for it
LAW_ORDERS = 120  # harmonics of the spindle in the law's own force, for the drawing
NORMAL = 1.959964  # quantile of 95 %
NEEDED = {"x": ("Ktc", "Krc", "Kte", "Kre"), "y": ("Ktc", "Krc", "Kte", "Kre"), "z": ("Kac", "Kae")}


def reconstruct_forces(
    cuts: Sequence[CutVibration],
    frf: Frf,
    *,
    method: str = "gtls",
    harmonics: int | None = None,
    modes: Modes | None = None,
    phase: str = "auto",
    runout: str = "auto",
    regularization: float | str = "gcv",
    slack: float = 0.0,
    progress: Callable[[float, str], None] | None = None,
) -> ForceHarmonics:
    """The force behind the accelerations of cuts with one cutter, and its coefficients by the linear-edge law.

    method : ls, tls, tikhonov, constrained-ls, rtls or gtls
    harmonics : of the tooth passing; None takes up to twelve, as far as the FRF reaches
    modes : fitted to the FRF, to take its place   phase : auto believes a stated angle of tooth 0 to 3 degrees and finds one
        that nobody stated; fit finds it in any case; known takes what is stated for exact
    runout : auto fits it where harmonics of the spindle between those of the tooth passing show it and the cutter has none
        stated; fit; known takes the cutter's own, also where that is none
    regularization : gcv, l-curve, discrepancy or a weight in (m/s^2)/N (tikhonov)   slack : N by which the force may miss the
        law (rtls)   progress : called with (share done, label)

    Raises
    ------
    RecipeError
        An option is unknown, or the phase is to be known and is not.
    IllPosedError
        Cuts and FRF do not belong together, or do not determine the force.
    """
    for name, value, known in (
        ("method", method, methods.NAMES),
        ("phase", phase, PHASES),
        ("runout", runout, RUNOUTS),
    ):
        if value not in known:
            raise RecipeError(f"forces.{name}: {value!r} is unknown; choose one of {', '.join(known)}")
    if harmonics is not None and harmonics < 1:
        raise RecipeError(f"forces.harmonics: {harmonics} is less than one; leave it out, or give 2 or more")
    if not cuts:
        raise IllPosedError("cuts: there are none; name at least one recording of a cut")
    if any(cut.cutter != cuts[0].cutter for cut in cuts):
        raise IllPosedError("cuts: they were made with different cutters; identify each cutter by itself")
    tell = progress or (lambda share, label: None)
    notices, note = notice_collector(" ".join(cut.name for cut in cuts))

    def fit(fits_runout: bool) -> tuple[Problem, Law, LawFit]:
        notices.clear()
        tell(0.0, "FRF at the harmonics")
        problem = problem_of(cuts, frf, harmonics, modes, fits_runout or cuts[0].cutter.runout > 0, note)
        law = law_of(problem, phase, fits_runout)
        tell(0.3, "force")
        return problem, law, fit_law(problem, law)

    fits_runout = _fits_runout(cuts, runout)
    try:
        problem, law, fitted = fit(fits_runout)
    except IllPosedError:
        if not fits_runout or runout == "fit":
            raise
        problem, law, fitted = fit(False)  # nobody asked for it, and the lines do not tell it
    if law.fits_runout and runout == "auto" and unlikely(fitted.fit.chi2, fitted.fit.dof):
        told = list(notices)
        other = fit(False)  # what is between the harmonics of the tooth passing may be no runout: a bearing, a belt
        if unlikely(other[2].fit.chi2, other[2].fit.dof):
            notices[:] = told
        else:
            problem, law, fitted = other
    turned = law.fixed(fitted.fit.theta)
    answers = _all_methods(problem, fitted, turned, method, regularization, slack, note)
    tell(0.8, "checks")
    chosen = answers[method]
    values, covariance = _coefficients(chosen, fitted, turned, method)
    judged = judge(problem, fitted, (values, covariance), frf, modes, note)
    names = tuple(NAMES[i] for i in law.known)
    scale = max(1.0, judged.chi2 / judged.dof) if judged.dof > 0 else 1.0
    if scale > WIDENED:
        said = f"the residuals are {np.sqrt(scale):.2g} times what is expected: so are the intervals"
        note("intervals-widened", said, "note" if scale < MUCH else "warning")
    compared = [_told(name, answers, fitted, turned, law, scale) for name in methods.NAMES]
    own = np.array(law.known, int)
    sd = np.sqrt(np.maximum(scale * np.diag(covariance)[own], 0.0))
    phases = fitted.phases
    drawn = _curves(problem, chosen, phases, np.sqrt(scale))
    tell(1.0, "forces")
    return ForceHarmonics(
        method=method,
        cutter=cuts[0].cutter,
        conditions=tuple(cut.conditions for cut in cuts),
        cuts=tuple(cut.name for cut in cuts),
        axes=problem.axes,
        sensors=problem.sensors,
        verdict=judged.verdict,
        checks=judged.checks,
        cut=problem.cut,
        order=problem.order,
        frequency=problem.frequency,
        force=drawn.force,
        force_covariance=drawn.covariance,
        free_force=None
        if judged.free_force is None
        else judged.free_force * np.exp(-1j * problem.order * phases[problem.cut])[:, None],
        free_sd=judged.free_sd,
        condition=line_condition(problem, fitted),
        condition_number=chosen.condition_number,
        regularization=chosen.regularization,
        regularization_from=_chosen_by(method, regularization),
        band=(float(problem.frequency.min()), float(problem.frequency.max())),
        measured=problem.measured,
        modelled=np.einsum("lsd,ld->ls", problem.matrix, chosen.force),
        deviation=np.sqrt(fitted.fit.expected),
        noise=np.sqrt(np.maximum(np.einsum("lss->ls", problem.noise).real, 0.0)),
        sensor_residual=judged.sensor_residual,
        sensor_share=judged.sensor_share,
        chi2=judged.chi2 / max(judged.dof, 1),
        dof=judged.dof,
        angle=drawn.angle,
        alternating=drawn.alternating,
        alternating_sd=drawn.sd,
        law_force=_law_force(problem, fitted.runout, values, names, drawn.angle),
        dynamometer=_dynamometer(problem, phases, drawn.angle),
        posterior=Posterior(
            names=names,
            units=tuple(UNITS[name] for name in names),
            mean=values[own],
            covariance=scale * covariance[np.ix_(own, own)],
            interval=values[own][:, None] + NORMAL * sd[:, None] * np.array([-1.0, 1.0]),
            law="linear-edge",
            method=method,
        ),
        unobservable=law.constraint.unobservable,
        rank=law.constraint.rank,
        constraint_rows=len(law.constraint.rows),
        complex_rows=law.constraint.complex_rows,
        phase=phases,
        phase_sd=np.sqrt(scale) * fitted.phase_sd,
        phase_from="stated" if fitted.common_phase is None else "fitted",
        runout=fitted.runout,
        runout_sd=None if fitted.runout_sd is None else _pair(np.sqrt(scale) * np.array(fitted.runout_sd)),
        frf_from="measured" if modes is None else "modes",
        compared_methods=methods.NAMES,
        compared=np.array([value for value, _ in compared]),
        compared_sd=np.array([deviation for _, deviation in compared]),
        recommended=judged.recommended,
        recommended_why=judged.recommended_why,
        notices=tuple(dict.fromkeys(notices)),
    )


def _fits_runout(cuts: Sequence[CutVibration], runout: str) -> bool:
    """Whether the runout is an unknown."""
    cutter = cuts[0].cutter
    if runout == "known" or cutter.teeth == 1:  # a tooth alone has its chip whatever the runout
        return False
    return runout == "fit" or (cutter.runout == 0 and runout_seen(cuts) > RUNOUT_SEEN)


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _chosen_by(method: str, regularization: float | str) -> str:
    if method != "tikhonov":
        return ""
    return regularization if isinstance(regularization, str) else "given"


def _all_methods(
    problem: Problem,
    fitted: LawFit,
    law: Law,
    wanted: str,
    regularization: float | str,
    slack: float,
    note: Callable[..., None],
) -> dict[str, Reconstruction]:
    """Every method on the same lines; one that has no answer here is left out, unless it is the one that is wanted."""
    fit = fitted.fit
    n = law.combinations.shape[1]
    angles = fitted.law.sizes[1]
    kept = [i for i in range(len(fit.theta)) if not n <= i < n + angles]  # angles turn the frame, not the force in it
    slopes = as_real_vector(fit.slopes[:, :, kept].reshape(-1, len(kept)))
    own = fit.covariance[np.ix_(kept, kept)]
    root = np.linalg.cholesky(fit.residual_covariance)
    weighted = np.linalg.solve(root, as_real_vector((problem.matrix @ (law.basis @ law.combinations)).reshape(-1, n)))
    answers = {
        "gtls": Reconstruction(fit.values, slopes @ own @ slopes.T, float(np.linalg.cond(weighted))),
    }
    system = system_of(problem, fit.values)
    for name in methods.METHODS:
        try:
            answers[name] = solver(name, law, regularization, slack)(system)
        except IllPosedError:
            if name == wanted:
                raise
    found = answers.get("tikhonov")
    if found is not None and found.edge and wanted == "tikhonov":
        end = "lowest" if found.edge == "low" else "highest"
        note(
            "regularization-edge",
            f"Tikhonov's weight stands on the {end} end of its range: {regularization} finds none",
        )
    return answers


def _coefficients(found: Reconstruction, fitted: LawFit, law: Law, method: str) -> tuple[np.ndarray, np.ndarray]:
    """All six and their covariance.   law : with its phases known"""
    if method == "gtls":
        return fitted.law.coefficients(fitted.fit.theta, fitted.fit.covariance)
    return coefficients_from_force(found, law)


def _told(
    method: str, answers: dict[str, Reconstruction], fitted: LawFit, turned: Law, law: Law, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """The coefficients that can be told by one method, and their standard deviations; nan where it has no answer."""
    if method not in answers:
        nothing = np.full(len(law.known), np.nan)
        return nothing, nothing
    values, covariance = _coefficients(answers[method], fitted, turned, method)
    return values[law.known], np.sqrt(np.maximum(scale * np.diag(covariance)[law.known], 0.0))


class _Curves(NamedTuple):
    """The force counted from tooth 0: its harmonics, and one revolution of what the lines show."""

    force: np.ndarray  # complex (line, axis)
    covariance: np.ndarray  # (line, part, part), parts Re x, Re y, .., Im x, ..
    angle: np.ndarray  # (angle,) rad
    alternating: np.ndarray  # (cut, axis, angle)
    sd: np.ndarray  # (cut, axis, angle)


def _curves(problem: Problem, found: Reconstruction, phases: np.ndarray, widened: float) -> _Curves:
    """phases : (cut,) of tooth 0 at the angle from which each cut was counted   widened : factor of the deviations"""
    lines, axes = found.force.shape
    turn = np.exp(-1j * problem.order * phases[problem.cut])
    rotation = as_real(np.diag(np.repeat(turn, axes)))
    force = found.force * turn[:, None]
    covariance = widened**2 * rotation @ found.covariance @ rotation.T
    place = np.arange(lines * axes).reshape(lines, axes)
    parts = np.concatenate([place, place + lines * axes], axis=1)  # (line, part)
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    alternating = np.empty((len(problem.cuts), axes, ANGLES))
    sd = np.empty_like(alternating)
    for number in range(len(problem.cuts)):
        own = np.flatnonzero(problem.cut == number)
        wave = np.exp(1j * np.multiply.outer(problem.order[own], angle))  # (line, angle)
        alternating[number] = np.real(force[own].T @ wave)
        seen = np.concatenate([wave.real, -wave.imag])
        for axis in range(axes):
            at = np.concatenate([place[own, axis], place[own, axis] + lines * axes])
            variance = np.einsum("pa,pq,qa->a", seen, covariance[np.ix_(at, at)], seen)
            sd[number, axis] = np.sqrt(np.maximum(variance, 0.0))
    return _Curves(force, covariance[parts[:, :, None], parts[:, None, :]], angle, alternating, sd)


def _law_force(
    problem: Problem,
    runout: tuple[float, float] | None,
    values: np.ndarray,
    names: tuple[str, ...],
    angle: np.ndarray,
) -> np.ndarray | None:
    """The whole force of the law, mean and all, along the axes whose coefficients are all told.

    runout : c0 and s0 that were fitted, None for the cutter's own   values : (6,)
    returns (cut, axis, angle) N, nan along other axes; None where there is no such axis
    """
    known = [axis for axis in problem.axes if set(NEEDED[axis]) <= set(names)]
    if not known:
        return None
    force = np.full((len(problem.cuts), len(problem.axes), len(angle)), np.nan)
    for number, cut in enumerate(problem.cuts):
        cutter = cut.cutter
        if runout is not None:
            cutter = replace(cutter, runout=float(np.hypot(*runout)), runout_angle=float(np.arctan2(*runout[::-1])))
        basis = harmonic_basis(cutter, cut.conditions, np.arange(LAW_ORDERS + 1), problem.axes)
        own = force_at((basis @ values).T, angle)
        for row, axis in enumerate(problem.axes):
            if axis in known:
                force[number, row] = own[row]
    return force


def _dynamometer(problem: Problem, phases: np.ndarray, angle: np.ndarray) -> np.ndarray | None:
    """The same lines of the force that was measured beside the accelerations.   returns (cut, axis, angle) N"""
    if all(cut.force is None for cut in problem.cuts):
        return None
    rows = [AXES.index(axis) for axis in problem.axes]
    curves = np.full((len(problem.cuts), len(rows), len(angle)), np.nan)
    for number, cut in enumerate(problem.cuts):
        if cut.force is not None:
            order = problem.order[problem.cut == number]
            turn = np.exp(1j * np.multiply.outer(order, angle - phases[number]))
            curves[number] = np.real(cut.force[np.ix_(rows, order)] @ turn)
    return curves
