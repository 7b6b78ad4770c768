"""Whether the forces may be believed: the FRF first, then the law, the sensors, the angle, and how well it is all known.

Two chi-squares tell what is wrong. With the force of every line free, the accelerations must lie where the FRF can move the
sensors: more sensors than forces leave something over. If they do not, the FRF is of other points, or a sensor is wrong. If
they do, and the law leaves much more, the force is none of this law: another engagement, another cutter, chatter. Few modes
move the sensors the same few ways wherever they are hit, so a wrong FRF may show in the law alone.

Where the law does not hold, its force is not there, and neither its residuals nor the weights that follow from it tell of
sensors: those of the free force do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.data import Check, Frf, Modes
from millcal.errors import IllPosedError
from millcal.numerics.errors_in_variables import parts, residual_covariance
from millcal.physics.force_subspace import NAMES
from millcal.physics.structure import convert_frf_variance
from millcal.stages.forces.fit import LawFit, fit_law, free_force
from millcal.stages.forces.frf_errors import frf_at
from millcal.stages.forces.frf_of_modes import OFF, modal_error, relative_disagreement
from millcal.stages.forces.law import BELIEVED, law_of
from millcal.stages.forces.problem import Note, Problem, signed_places
from millcal.stages.forces.remarks import line_condition, tell_lines, tell_runout, tell_sensors

CHANCE = 1e-3  # that a right model is called wrong
MUCH = 2.25  # chi-square per degree of freedom from which it matters; below, the intervals are widened by its root
FAR_BETTER = 0.25  # of chi-square, that another angle leaves of it
IMPRECISE = 0.1  # relative standard deviation of Ktc or Krc
FAR = np.radians(2.0)  # from what is stated, of a tooth's angle
MODES_OFF = 0.05  # of the FRF's size


@dataclass(frozen=True, eq=False)
class Judgement:
    """The verdict and what it stands on."""

    verdict: str
    checks: tuple[Check, ...]
    chi2: float
    dof: int
    sensor_residual: np.ndarray  # (sensor,)
    sensor_share: np.ndarray  # (sensor,)
    recommended: str
    recommended_why: str
    free_force: np.ndarray | None  # complex (line, axis) N, the law not asked; None with fewer sensors than axes
    free_sd: np.ndarray | None  # (line, axis), root of E|error|^2


def judge(
    problem: Problem,
    fitted: LawFit,
    answer: tuple[np.ndarray, np.ndarray],
    frf: Frf,
    modes: Modes | None,
    note: Note,
) -> Judgement:
    """Ask everything that can be asked of the fit of the law.   answer : coefficients of the method used, (6,), (6, 6)"""
    fit = fitted.fit
    share = np.einsum("spq,pq->s", fit.information, fit.covariance)
    share = share / share.sum()
    residual = np.mean(np.abs(fit.residual) ** 2 / fit.expected, axis=0)
    covariance = fit.residual_covariance
    free = _free(problem, covariance, range(len(problem.sensors)))
    law_check = _law_check(fitted, free)
    if not law_check.passed:
        covariance = residual_covariance(problem.noise, problem.error, free_force(problem))
        free = _free(problem, covariance, range(len(problem.sensors)))
    frf_check, culprit = _frf_check(problem, covariance, free)
    sensors = (residual, 2 * len(problem.order)) if law_check.passed else (free.residual, free.dof // len(residual))
    checks = [
        frf_check,
        law_check,
        _sensor_check(problem, *sensors) if frf_check.passed else _culprit_check(culprit),
        _sign_check(fitted),
        _angle_check(problem, fitted, law_check.passed, note),
        _precision_check(problem, fitted, answer),
        Check("minimum", fit.converged, "the fit stands at its minimum" if fit.converged else "the fit did not end"),
    ]
    if modes is not None and not frf.damping_shift:
        checks.append(_modes_check(problem, frf, modes))
    tell_sensors(problem, fitted, share, note)
    tell_lines(problem, fitted, note)
    tell_runout(problem, fitted, note)
    recommended, why = _recommended(frf_check.passed, law_check.passed)
    alone = len(problem.sensors) >= len(problem.axes)
    if not alone:
        note(
            "few-sensors",
            f"{len(problem.sensors)} sensors for {len(problem.axes)} axes: only with the law is there a force at all, and little "
            "to check it by; use as many sensors as axes and some more",
        )
    return Judgement(
        verdict=_verdict(checks),
        checks=tuple(checks),
        chi2=fit.chi2,
        dof=fit.dof,
        sensor_residual=residual,
        sensor_share=share,
        recommended=recommended,
        recommended_why=why,
        free_force=free.force if alone else None,
        free_sd=free.sd if alone else None,
    )


def _verdict(checks: list[Check]) -> str:
    failed = {check.name: check.message for check in checks if not check.passed}
    if not failed:
        return "fits"
    if set(failed) <= {"precision"}:
        return f"fits in part: {failed['precision']}"
    return "does not fit: " + "; ".join(failed.values())


def unlikely(chi2: float, dof: int) -> bool:
    """Whether a chi-square is more than a right model leaves, and enough more to matter."""
    from scipy.special import chdtrc

    return dof > 0 and chi2 > MUCH * dof and float(chdtrc(dof, chi2)) < CHANCE


class _Free(NamedTuple):
    """The force of every line by itself, and what it leaves."""

    chi2: float
    dof: int
    force: np.ndarray  # complex (line, axis)
    sd: np.ndarray  # (line, axis)
    residual: np.ndarray  # (sensor,), mean square over the expected one


def _free(problem: Problem, covariance: np.ndarray, sensors: Sequence[int]) -> _Free:
    """The force without the law by some sensors.   covariance : of the parts of all residuals"""
    chosen = list(sensors)
    lines, rows, axes = problem.matrix.shape
    at = np.array([line * rows + row for line in range(lines) for row in chosen])
    at = np.concatenate([at, at + lines * rows])
    root = np.linalg.cholesky(covariance[np.ix_(at, at)])
    blocks = np.zeros((lines, len(chosen), lines, axes), complex)
    blocks[np.arange(lines), :, np.arange(lines), :] = problem.matrix[:, chosen]
    flat = blocks.reshape(lines * len(chosen), lines * axes)
    A = np.linalg.solve(root, np.block([[flat.real, -flat.imag], [flat.imag, flat.real]]))
    y = np.linalg.solve(root, parts(problem.measured[:, chosen]))
    solution = np.linalg.lstsq(A, y, rcond=None)[0]
    left = y - A @ solution
    n = lines * axes
    inverse = np.linalg.pinv(A.T @ A, hermitian=True)
    variance = np.diag(inverse)
    told = root @ A  # what the force explains is no residual
    expected = np.diag(covariance)[at] - np.einsum("ip,pq,iq->i", told, inverse, told)
    off = ((root @ left) ** 2).reshape(2, lines, -1).sum(axis=(0, 1))
    return _Free(
        chi2=float(left @ left),
        dof=2 * lines * max(len(chosen) - axes, 0),
        force=(solution[:n] + 1j * solution[n:]).reshape(lines, axes),
        sd=np.sqrt(np.maximum(variance[:n] + variance[n:], 0.0)).reshape(lines, axes),
        residual=off / np.maximum(expected.reshape(2, lines, -1).sum(axis=(0, 1)), 1e-300),
    )


def _frf_check(problem: Problem, covariance: np.ndarray, free: _Free) -> tuple[Check, str]:
    """The check, and the sensor without which it would be passed, if that is so of one."""
    sensors, axes = len(problem.sensors), len(problem.axes)
    if free.dof <= 0:
        message = f"{sensors} sensors and {axes} axes leave nothing over to check the FRF by; use more sensors"
        return Check("frf", True, message), ""
    size = np.sqrt(free.chi2 / free.dof)
    if not unlikely(free.chi2, free.dof):
        message = f"the FRF explains the accelerations: residual {size:.2f} times the expected one"
        return Check("frf", True, message), ""
    culprit = ""
    said = (
        "it was taken at other points, in another state of the machine, or with other signs: repeat the impact test with "
        "the sensors where they are in the cut"
    )
    if "z" not in problem.axes:
        said = f"it has no hits along z, and the axial force moves the sensors too: hit along z; or {said}"
    if sensors - 1 > axes:
        without = [_free(problem, covariance, [s for s in range(sensors) if s != row]) for row in range(sensors)]
        best = min(range(sensors), key=lambda row: without[row].chi2)
        if not unlikely(without[best].chi2, without[best].dof):
            culprit = problem.sensors[best]
            said = f"without {culprit} it would be right: look at its mounting, sign and sensitivity"
    message = f"the FRF does not explain the accelerations: residual {size:.2f} times the expected one; {said}"
    return Check("frf", False, message), culprit


def _law_check(fitted: LawFit, free: _Free) -> Check:
    fit = fitted.fit
    more, dof = fit.chi2 - free.chi2, fit.dof - free.dof
    size = np.sqrt(max(more, 0.0) / max(dof, 1))
    if dof <= 0:
        return Check(
            "law", True, "as many coefficients as the lines have parts: nothing is left over to check the law by"
        )
    if not unlikely(more, dof):
        return Check("law", True, f"the law explains the force: residual {size:.2f} times the expected one")
    return Check(
        "law",
        False,
        f"no force of this law: residual {size:.2f} times the expected one; check cutter, depths, direction (up or down), "
        "feed direction and runout, that the cut did not chatter, and that the FRF was hit where the tool cuts",
    )


def _culprit_check(culprit: str) -> Check:
    """Where the FRF does not fit, a wrong sensor spoils the residuals of others too: it is the one without which all is right."""
    if culprit:
        return Check(
            "sensors", False, f"{culprit} does not go with the others; check its mounting, sign and sensitivity"
        )
    return Check("sensors", True, "no single sensor is why the FRF does not explain the accelerations")


def _sensor_check(problem: Problem, residual: np.ndarray, dof: int) -> Check:
    """Whether some sensors are further off than the others.   residual : (sensor,), of `dof` degrees of freedom each"""
    bad = [
        f"{sensor} ({np.sqrt(value):.2g} times)"
        for sensor, value in zip(problem.sensors, residual, strict=True)
        if unlikely(dof * value, dof) and value > 2 * np.median(residual)
    ]
    if not bad:
        return Check("sensors", True, "no sensor is further off than the others")
    return Check(
        "sensors", False, f"further off than expected: {', '.join(bad)}; check their mounting, sign and sensitivity"
    )


def _sign_check(fitted: LawFit) -> Check:
    values, covariance = fitted.law.coefficients(fitted.fit.theta, fitted.fit.covariance)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = fitted.law.known
    wrong = [NAMES[i] for i in (0, 1) if i in known and values[i] <= 0]
    wrong += [NAMES[i] for i in (3, 4) if i in known and values[i] < -2 * sd[i]]
    if not wrong:
        return Check("signs", True, "the coefficients have the signs of a tool that cuts")
    return Check(
        "signs",
        False,
        f"{', '.join(wrong)} negative: check direction (up or down), the axes and the sign of the hammer and of the sensors, and "
        "the spindle angle",
    )


def _angle_check(problem: Problem, fitted: LawFit, law_holds: bool, note: Note) -> Check:
    """Whether a stated angle of tooth 0 is right, and one that was found is the only one."""
    common = fitted.common_phase
    if not law_holds and (common is None or fitted.law.stated[0]):
        far = _far_off(problem, fitted)
        if far is not None:
            return far
    if common is None:
        return _known_angle(problem, fitted)
    angle, sd = common
    said = f"{np.degrees(angle):+.2g} +- {np.degrees(sd):.2g} degrees"
    if fitted.law.stated[0]:
        if abs(angle) > 4 * BELIEVED:
            return Check("angle", False, f"the stated spindle angle is off by {said}; correct it, or leave it out")
        if abs(angle) > max(3 * sd, FAR):
            note("spindle-angle", f"tooth 0 stands {said} from where it is stated: corrected")
        return Check("angle", True, f"the lines put tooth 0 {said} from where it is stated")
    if fitted.ambiguous:
        others = ", ".join(f"{np.degrees(value):.0f}" for value in fitted.ambiguous)
        return Check(
            "angle",
            False,
            f"tooth 0 may stand at {np.degrees(angle):.0f} or {others} degrees: state spindle_phase_deg, or cut at a speed "
            "where the FRF tells more",
        )
    return Check(
        "angle", True, f"the lines tell where tooth 0 is: {np.degrees(angle):.4g} +- {np.degrees(sd):.2g} degrees"
    )


def _far_off(problem: Problem, fitted: LawFit) -> Check | None:
    """Whether another angle than the stated one lets the law hold."""
    try:
        found = fit_law(problem, law_of(problem, "search", fitted.law.fits_runout))
    except IllPosedError:
        return None
    if found.common_phase is None or found.fit.chi2 > FAR_BETTER * fitted.fit.chi2:
        return None
    off, sd = found.common_phase
    off = off - found.law.period * np.round(off / found.law.period)
    return Check(
        "angle",
        False,
        f"the stated spindle angle is off by {np.degrees(off):+.4g} +- {np.degrees(sd):.2g} degrees, with which the residuals "
        f"fall to {np.sqrt(found.fit.chi2 / fitted.fit.chi2):.0%}; correct it, or leave it out",
    )


def _known_angle(problem: Problem, fitted: LawFit) -> Check:
    """Whether an angle that was taken for known is where the lines put it."""
    try:
        found = fit_law(problem, law_of(problem, "fit", fitted.law.fits_runout))
    except IllPosedError:
        return Check("angle", True, "the lines do not tell the spindle angle: it is as stated")
    assert found.common_phase is not None
    off, sd = found.common_phase
    said = f"{np.degrees(off):+.2g} +- {np.degrees(sd):.2g} degrees"
    if abs(off) > max(4 * sd, FAR / 4):
        return Check("angle", False, f"the stated spindle angle is off by {said}; take phase = auto, or correct it")
    return Check("angle", True, f"the lines put tooth 0 {said} from where it is stated")


def _precision_check(problem: Problem, fitted: LawFit, answer: tuple[np.ndarray, np.ndarray]) -> Check:
    values, covariance = answer
    known = [i for i in (0, 1) if i in fitted.law.known]
    hidden = [NAMES[i] for i in (0, 1) if i not in fitted.law.known]
    if hidden:
        message = (
            f"{' and '.join(hidden)} give no alternating force in this cut, so accelerations do not tell them; cut with fewer "
            "teeth or at another radial depth"
        )
        return Check("precision", False, message)
    relative = {NAMES[i]: float(np.sqrt(covariance[i, i]) / max(abs(values[i]), 1e-300)) for i in known}
    loose = {name: value for name, value in relative.items() if value > IMPRECISE}
    if not loose:
        said = ", ".join(f"{name} to {value:.1%}" for name, value in relative.items())
        return Check("precision", True, f"known with a standard deviation of: {said}")
    worst = int(np.argmax(line_condition(problem, fitted)))
    said = ", ".join(f"{name} to {value:.0%}" for name, value in loose.items())
    return Check(
        "precision",
        False,
        f"only known with a standard deviation of: {said}; the FRF is worst at {problem.frequency[worst]:.4g} Hz "
        f"(harmonic {problem.order[worst] / problem.cuts[0].cutter.teeth:.3g}): cut at the speeds that are advised, or longer",
    )


def _modes_check(problem: Problem, frf: Frf, modes: Modes) -> Check:
    """Whether the modes are the measured FRF at the lines, to the noise of both: what they miss of it is no noise."""
    measured = _measured(problem, frf)
    off = relative_disagreement(measured, problem.matrix)
    seen = np.sqrt(np.mean(np.abs(measured - problem.matrix) ** 2))
    own = modal_error(modes, problem.frequency, problem.sensors, [frf.inputs[column] for column in problem.columns])[1]
    noise = float(np.sqrt(np.mean(own) + _noise_of(problem, frf)))
    said = f"the modes are {off:.1%} off the measured FRF at the lines, {seen / max(noise, 1e-300):.2g} times its noise"
    if off > MODES_OFF and seen > OFF * noise:
        return Check("modes", False, f"{said}: modes are missing; take the measured FRF, or fit more of them")
    return Check("modes", True, said)


def _measured(problem: Problem, frf: Frf) -> np.ndarray:
    rows, row_sign = signed_places(problem.sensors, frf.outputs)
    sign = np.array([-1.0 if frf.inputs[column].startswith("-") else 1.0 for column in problem.columns])
    return frf_at(frf, problem.frequency, rows, list(problem.columns)) * row_sign[:, None] * sign


def _noise_of(problem: Problem, frf: Frf) -> float:
    """Mean variance of the measured FRF at the lines, as an accelerance; 0 where it says nothing."""
    if frf.variance is None:
        return 0.0
    near = [int(np.argmin(np.abs(frf.frequency - f))) for f in problem.frequency]
    rows, _ = signed_places(problem.sensors, frf.outputs)
    own = frf.variance[near][:, rows][:, :, list(problem.columns)]
    return float(np.nanmean(convert_frf_variance(frf.frequency[near], own, frf.form, "accelerance")))


def _recommended(frf_right: bool, law_right: bool) -> tuple[str, str]:
    if frf_right and not law_right:
        return (
            "ls",
            "the law does not hold here, and this method does not ask for it: its forces stand, no coefficients do",
        )
    why = "it weights every line and sensor by the noise of cut and FRF, and asks for all that the law demands"
    if not frf_right:
        return "gtls", f"{why}; but see the verdict, no method mends a wrong FRF"
    return "gtls", why
