"""What the user should know of a reconstruction and no verdict stands on: sensors that tell nothing, harmonics at which the
forces are not told, and teeth that do not cut alike.
"""

import numpy as np

from millcal.stages.forces.fit import LawFit
from millcal.stages.forces.problem import RUNOUT_SEEN, Note, Problem, runout_seen

USELESS = 0.01  # share of what is known
NEARLY_SINGULAR = 20.0  # condition number of a line
UNKNOWN_FORCE = 1.0  # standard deviation of a line's force over the force itself


def tell_sensors(problem: Problem, fitted: LawFit, share: np.ndarray, note: Note) -> None:
    useless = [sensor for sensor, own in zip(problem.sensors, share, strict=True) if own < USELESS]
    if useless:
        note(
            "useless-sensors",
            f"{', '.join(useless)} tell{'s' if len(useless) == 1 else ''} less than 1 % of what is known here: too noisy, or "
            "still where the force moves the others; put it elsewhere",
        )


def line_condition(problem: Problem, fitted: LawFit) -> np.ndarray:
    """Condition number of the FRF at each line, weighted with its noise.   returns (line,)"""
    return np.array([np.linalg.cond(A) for A in _whitened(problem, fitted)])


def _whitened(problem: Problem, fitted: LawFit) -> list[np.ndarray]:
    """The FRF of each line over the root of the residual's covariance there."""
    lines, rows, _ = problem.matrix.shape
    n = lines * rows
    found = []
    for line, A in enumerate(problem.matrix):
        at = line * rows + np.arange(rows)
        both = np.concatenate([at, at + n])
        root = np.linalg.cholesky(fitted.fit.residual_covariance[np.ix_(both, both)])
        found.append(np.linalg.solve(root, np.block([[A.real, -A.imag], [A.imag, A.real]])))
    return found


def tell_lines(problem: Problem, fitted: LawFit, note: Note) -> None:
    """Harmonics at which the sensors cannot tell the forces: an anti-resonance, or too much noise."""
    force = np.abs(fitted.fit.values)
    teeth = problem.cuts[0].cutter.teeth
    told: dict[str, list[str]] = {"warning": [], "note": []}
    for line, A in enumerate(_whitened(problem, fitted)):
        own = np.linalg.cond(A)
        axes = len(problem.axes)
        sd = np.sqrt(np.sum(np.diag(np.linalg.pinv(A.T @ A)).reshape(2, axes), axis=0))
        lost = [
            f"F{axis} ({deviation:.2g} N of {size:.2g} N)"
            for axis, deviation, size in zip(problem.axes, sd, force[line], strict=True)
            if deviation > UNKNOWN_FORCE * size and axis != "z"
        ]
        harmonic = problem.order[line] / teeth
        if not lost and own < NEARLY_SINGULAR:
            continue
        why = f"condition {own:.2g}" + (f", deviation of {', '.join(lost)}" if lost else "")
        level = "warning" if harmonic == 1 and lost else "note"
        told[level].append(
            f"harmonic {harmonic:.3g} of {problem.cuts[problem.cut[line]].name} at {problem.frequency[line]:.4g} Hz ({why})"
        )
    if told["warning"]:
        note(
            "poor-line",
            f"the first harmonic tells little where the FRF has an anti-resonance or is noisy: {'; '.join(told['warning'])}; "
            "cut at another speed (--advise)",
        )
    if told["note"]:
        note("poor-lines", f"lines that tell little by themselves: {'; '.join(told['note'])}", "note")


def tell_runout(problem: Problem, fitted: LawFit, note: Note) -> None:
    """Runout that was found, or that is there and was not asked for."""
    if fitted.runout is not None and fitted.runout_sd is not None:
        c0, s0 = (f"{1e6 * v:.2g} +- {1e6 * d:.1g}" for v, d in zip(fitted.runout, fitted.runout_sd, strict=True))
        note(
            "runout-fitted",
            f"the harmonics of the spindle tell a runout of c0 {c0} um and s0 {s0} um, which is in the coefficients",
            "note",
        )
        return
    cutter = problem.cuts[0].cutter
    seen = runout_seen(problem.cuts)
    if not cutter.runout and cutter.pitch is None and seen > RUNOUT_SEEN:
        note(
            "runout-seen",
            f"harmonics of the spindle between those of the tooth passing have {seen:.0%} of their size: the teeth do not cut "
            "alike, which is not in the coefficients; take runout = auto, or state runout_um of the cutter",
        )
