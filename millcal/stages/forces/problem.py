"""Cuts and an FRF as one inverse problem: which sensors, which lines, the FRF at these lines and the errors of both.

A line is a harmonic of one cut. Its noise is what the cut's spectrum has between the harmonics. The errors of the FRF are the
scatter of the hits about it, pooled over neighbouring lines, and they are shared: two lines closer than one over the response
window are wrong together, and two cuts at one speed are wrong alike, so that repeating a cut at the same speed does not
average the FRF away.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import AXES, CutVibration, Frf, Modes, Notice
from millcal.errors import IllPosedError
from millcal.numerics.errors_in_variables import MatrixError
from millcal.physics.cutter import Cutter
from millcal.physics.force_subspace import orders_of
from millcal.physics.structure import DERIVATIVES
from millcal.stages.forces.frf_errors import BENT, frf_at, independent_lines, measured_error
from millcal.stages.forces.frf_of_modes import missed, modal_error, modal_frf

MOST_HARMONICS = 12  # of the tooth passing, where nobody says how many: noise weights what little the last ones say
FEWEST_HARMONICS = 4
MOST_LINES = 72  # of all cuts: the work grows with their cube
BETWEEN = 3  # times the teeth: harmonics of the spindle up to there tell the runout
FEWEST_SENSORS = 2
DARK = 3.0  # power of the FRF at a line over its noise's, below which the line tells nothing
FEWEST_LINES = 8  # of an FRF: fewer are no curve
KEPT = 30  # harmonics of the spindle, at least
RUNOUT_SEEN = 0.01  # amplitude between the harmonics of the tooth passing over theirs
CHANCE_OF_RUNOUT = 1e-3  # that the noise of a cut looks like one
CHANCE_OF_LINES = 2.0  # times sensors over lines: how far a covariance is drawn to its diagonal

Note = Callable[..., None]  # takes code, sentence and level of a notice


@dataclass(frozen=True, eq=False)
class Problem:
    """The lines of all cuts, one cut behind the other."""

    cuts: tuple[CutVibration, ...]
    axes: tuple[str, ...]
    sensors: tuple[str, ...]
    cut: np.ndarray  # (line,) index
    order: np.ndarray  # (line,) of the spindle
    frequency: np.ndarray  # (line,) Hz
    matrix: np.ndarray  # accelerance, complex (line, sensor, axis)
    error: MatrixError
    measured: np.ndarray  # complex (line, sensor) m/s^2
    noise: np.ndarray  # complex (line, sensor, sensor) (m/s^2)^2
    frf_variance: np.ndarray  # (line, sensor, axis), of the matrix
    columns: tuple[int, ...]  # of the FRF, of each axis

    def of_lines(self, chosen: np.ndarray) -> "Problem":
        """Some of the lines.   chosen : (line,) bool"""
        shared, deviations = self.error
        return replace(
            self,
            cut=self.cut[chosen],
            order=self.order[chosen],
            frequency=self.frequency[chosen],
            matrix=self.matrix[chosen],
            error=MatrixError(
                None if shared is None else shared[:, chosen][:, :, :, chosen],
                None if deviations is None else deviations[:, chosen],
            ),
            measured=self.measured[chosen],
            noise=self.noise[chosen],
            frf_variance=self.frf_variance[chosen],
        )


def problem_of(
    cuts: Sequence[CutVibration],
    frf: Frf,
    harmonics: int | None,
    modes: Modes | None,
    runout: bool,
    note: Note,
) -> Problem:
    """Match sensors and axes, choose the lines, and take the FRF and all errors there.

    harmonics : of the tooth passing; None takes as many as the FRF covers, within reason
    runout : whether the harmonics of the spindle between those of the tooth passing are lines too

    Raises
    ------
    IllPosedError
        The cuts and the FRF have too few sensors in common, or no line lies in the band of the FRF.
    """
    axes, columns = axes_of(frf)
    check_frf(frf, modes is not None)
    sensors = sensors_in_common(cuts, frf, columns, note)
    lines = lines_of(cuts, frf, harmonics, runout, note)
    cut = np.array([number for number, _, _ in lines])
    order = np.array([k for _, k, _ in lines])
    frequency = np.array([f for _, _, f in lines])
    rows, row_sign = signed_places(sensors, frf.outputs)
    if modes is None:
        matrix = frf_at(frf, frequency, rows, columns)
        error, variance = measured_error(frf, frequency, rows, columns, matrix, note)
    else:
        matrix = modal_frf(modes, frequency, sensors, [frf.inputs[c] for c in columns])
        inputs = [frf.inputs[c] for c in columns]
        lowest = float(modes.natural_frequency.min())
        if frequency.min() < lowest:
            note(
                "lines-below-modes",
                f"{np.count_nonzero(frequency < lowest)} lines from {frequency.min():.4g} Hz on lie below the lowest fitted mode, "
                f"{lowest:.4g} Hz: a mode that is missing there is in no interval; take the measured FRF, or fit from lower",
            )
        error, variance = modal_error(modes, frequency, sensors, inputs)
        bent = BENT**2 * np.mean(np.abs(matrix) ** 2, axis=1, keepdims=True)
        beyond = np.array(np.broadcast_to(bent, matrix.shape))
        if not frf.damping_shift:  # else its values are those of a structure with more damping
            beyond += missed(frf, modes, frequency, sensors, inputs)
        error = error._replace(shared=independent_lines(beyond, frf, frequency))
        variance = variance + beyond
    signs = 1.0 if modes is not None else row_sign[:, None] * signed_places(axes_dofs(frf, columns), frf.inputs)[1]
    matrix = matrix * signs
    error = _turned(error, signs)
    own = [[cuts[number].sensors.index(sensor) for sensor in sensors] for number in range(len(cuts))]
    if "z" not in axes:
        note(
            "no-hits-along-z",
            "the FRF has no hits along z: what the axial force does at the sensors is taken for x and y; hit along z too",
        )
    problem = Problem(
        cuts=tuple(cuts),
        axes=axes,
        sensors=sensors,
        cut=cut,
        order=order,
        frequency=frequency,
        matrix=matrix,
        error=error,
        measured=np.array([cuts[c].harmonics[own[c], k] for c, k, _ in lines]),
        noise=np.array(
            [_shrunk(cuts[c].covariance[k][np.ix_(own[c], own[c])], cuts[c].lines_between[k]) for c, k, _ in lines]
        ),
        frf_variance=variance,
        columns=tuple(columns),
    )
    return _told(problem, note)


def _told(problem: Problem, note: Note) -> Problem:
    """Without the lines at which the FRF is no more than its noise: they tell nothing, and bend what others tell."""
    power = np.sum(np.abs(problem.matrix) ** 2, axis=(1, 2))
    noise = np.sum(problem.frf_variance, axis=(1, 2))
    dark = power - noise < DARK * noise
    left = problem.of_lines(~dark)
    if not dark.any() or len(np.unique(left.cut)) < len(problem.cuts):
        return problem
    shown = ", ".join(f"{f:.4g}" for f in problem.frequency[dark][:6])
    note(
        "dark-lines",
        f"the FRF is hardly more than its noise at {shown} Hz{' and others' if dark.sum() > 6 else ''}: those lines are left out; "
        "hit harder or with a softer tip, or cut faster",
    )
    return left


def check_frf(frf: Frf, modal: bool = False) -> None:
    """Refuse an FRF that cannot stand between force and acceleration.   modal : whether fitted modes take its place

    Raises
    ------
    IllPosedError
    """
    if frf.form not in DERIVATIVES:
        raise IllPosedError(
            f"frf: a {frf.form} is force over force and says nothing of motion; give the FRF from the hammer to the sensors"
        )
    inside = (frf.frequency > 0) & (frf.frequency >= frf.usable_band[0]) & (frf.frequency <= frf.usable_band[1])
    if inside.sum() < FEWEST_LINES:
        raise IllPosedError(
            f"frf: {inside.sum()} lines in its usable band, at least {FEWEST_LINES} make a curve; measure longer records"
        )
    if frf.damping_shift and not modal:
        raise IllPosedError(
            "frf: it was estimated with an exponential window, which damps every mode more than the machine does in a cut; "
            'estimate it without, or take the modes fitted to it (--modes, frf = "modes")'
        )


def _shrunk(covariance: np.ndarray, lines: float) -> np.ndarray:
    """A covariance of few lines, drawn towards its diagonal: its inverse would believe in what chance made small.

    covariance : complex (sensor, sensor), the mean over `lines` lines
    """
    share = min(1.0, CHANCE_OF_LINES * len(covariance) / max(float(lines), 1.0))
    return np.asarray((1 - share) * covariance + share * np.diag(np.diag(covariance)))


def _turned(error: MatrixError, signs: np.ndarray | float) -> MatrixError:
    """Errors of a matrix whose rows and columns are turned.   signs : (row, column) of 1 and -1"""
    if np.isscalar(signs):
        return error
    signs = np.asarray(signs)
    shared, deviations = error
    if shared is not None:
        shared = shared * signs.T[:, None, :, None, None] * signs.T[:, None, None, None, :]
    if deviations is not None:
        deviations = deviations * signs
    return MatrixError(shared, deviations)


def signed_places(dofs: Sequence[str], among: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Where dofs without sign stand among dofs that may have one, and the sign there.   returns (dof,), (dof,)"""
    plain = [name.lstrip("+-") for name in among]
    places = np.array([plain.index(dof) for dof in dofs])
    return places, np.array([-1.0 if among[place].startswith("-") else 1.0 for place in places])


def axes_dofs(frf: Frf, columns: Sequence[int]) -> list[str]:
    """Inputs of the FRF without their sign."""
    return [frf.inputs[column].lstrip("+-") for column in columns]


def sensors_in_common(cuts: Sequence[CutVibration], frf: Frf, columns: Sequence[int], note: Note) -> tuple[str, ...]:
    """Dofs that every cut and the FRF have, in the order of the first cut.   columns : of the FRF, that are needed"""
    inside = (frf.frequency > 0) & (frf.frequency >= frf.usable_band[0]) & (frf.frequency <= frf.usable_band[1])
    whole = np.isfinite(frf.values[inside][:, :, list(columns)]).all(axis=(0, 2))
    known = [name.lstrip("+-") for name, measured in zip(frf.outputs, whole, strict=True) if measured]
    partly = [name for name, measured in zip(frf.outputs, whole, strict=True) if not measured]
    if partly:
        note("frf-in-part", f"{', '.join(partly)}: not measured from every direction of the hammer, so left out")
    common = tuple(dof for dof in cuts[0].sensors if dof in known and all(dof in cut.sensors for cut in cuts))
    if len(common) < FEWEST_SENSORS:
        heard = ", ".join(cuts[0].sensors)
        raise IllPosedError(
            f"{cuts[0].name}: its sensors {heard} and the outputs {', '.join(known)} of the FRF have "
            f"{'only ' + common[0] if common else 'none'} in common; name the same points alike in both, and hit the machine "
            "with the sensors where they were in the cut"
        )
    left = [dof for cut in cuts for dof in cut.sensors if dof not in common]
    if left:
        note(
            "sensors-left-out",
            f"{', '.join(dict.fromkeys(left))}: not in the FRF or not in every cut, so left out",
        )
    return common


def axes_of(frf: Frf) -> tuple[tuple[str, ...], list[int]]:
    """The axes along which one point is hit, the one with most of them, and their columns.

    Raises
    ------
    IllPosedError
        No point is hit along x and y.
    """
    points: dict[str, dict[str, int]] = {}
    for column, name in enumerate(frf.inputs):
        dof = name.lstrip("+-")
        if dof[-1:].lower() in AXES:
            points.setdefault(dof[:-1], {}).setdefault(dof[-1].lower(), column)
    whole = {point: own for point, own in points.items() if {"x", "y"} <= set(own)}
    if not whole:
        raise IllPosedError(
            f"frf: no point is hit along x and y; its inputs are {', '.join(frf.inputs)}. Hit the tool tip along x, y and z, "
            "and name the hammer's channels tipX, tipY, tipZ"
        )
    point = max(whole, key=lambda name: (len(whole[name]), "tip" in name.lower()))
    own = whole[point]
    axes = tuple(axis for axis in AXES if axis in own)
    return axes, [own[axis] for axis in axes]


def lines_of(
    cuts: Sequence[CutVibration], frf: Frf, harmonics: int | None, runout: bool, note: Note
) -> list[tuple[int, int, float]]:
    """The lines: cut, order of the spindle, frequency in Hz; those that the FRF covers and the cut holds."""
    low, high = frf.usable_band
    lines, beyond = [], []
    wanted = harmonics or harmonics_for(cuts[0].cutter, len(cuts), runout)
    for number, cut in enumerate(cuts):
        orders = force_orders(cut.cutter, wanted, runout)
        found = [(number, k, k * cut.spindle_frequency) for k in orders if k < cut.harmonics.shape[1]]
        if harmonics and len(found) < len(orders):
            note(
                "harmonics-left-out",
                f"{cut.name}: of {harmonics} harmonics of the tooth passing its record holds "
                f"{(cut.harmonics.shape[1] - 1) / cut.cutter.teeth:.3g}; sample faster, or ask for fewer",
            )
        inside = [line for line in found if max(low, 1e-9) <= line[2] <= high]
        beyond += [line[2] for line in found if line not in inside]
        if not inside:
            f = cut.cutter.teeth * cut.spindle_frequency
            raise IllPosedError(
                f"{cut.name}: its tooth passing of {f:.4g} Hz and the harmonics lie outside the usable band of the FRF, "
                f"{low:.4g} to {high:.4g} Hz; hit harder or softer, or cut at another speed"
            )
        lines += inside
    if beyond:
        note(
            "lines-left-out",
            f"{len(beyond)} harmonics, {min(beyond):.4g} to {max(beyond):.4g} Hz, lie outside the usable band of the FRF, "
            f"{low:.4g} to {high:.4g} Hz",
            "warning" if harmonics else "note",
        )
    return lines


def force_orders(cutter: Cutter, harmonics: int, runout: bool) -> list[int]:
    """Harmonics of the spindle that tell of the cutting force.

    The first is the spindle's own as well: every rotor has some unbalance, which acts elsewhere. So it is left out unless it
    is that of the tooth passing.
    """
    orders = set(orders_of(replace(cutter, runout=0.0), harmonics))
    if runout:
        orders |= set(range(2, min(BETWEEN, harmonics) * cutter.teeth))
    return sorted(int(order) for order in orders if order > 1 or cutter.teeth == 1)


def harmonics_for(cutter: Cutter, cuts: int, runout: bool) -> int:
    """How many harmonics of the tooth passing are taken where nobody says it: all that help, within what is affordable."""
    for harmonics in range(MOST_HARMONICS, FEWEST_HARMONICS, -1):
        if cuts * len(force_orders(cutter, harmonics, runout)) <= MOST_LINES:
            return harmonics
    return FEWEST_HARMONICS


def spindle_harmonics(cutter: Cutter, harmonics: int | None) -> int:
    """Harmonics of the spindle that conditioning has to keep for so many of the tooth passing."""
    return max(KEPT, (harmonics or MOST_HARMONICS) * cutter.teeth)


def runout_seen(cuts: Sequence[CutVibration]) -> float:
    """Amplitude of the harmonics of the spindle that teeth without runout have not over those that they have, where it is no noise.

    The first harmonic does not count: see `force_orders`. Teeth at unequal pitch may have all, and then nothing is seen.
    """
    shares = [0.0]
    for cut in cuts:
        order = np.arange(2, min(cut.harmonics.shape[1], 2 * cut.cutter.teeth + 2))
        forced = np.isin(order, orders_of(replace(cut.cutter, runout=0.0), 3))
        between, passing = order[~forced], order[forced]
        if not len(between) or not len(passing):
            continue
        noise = np.einsum("kss->ks", cut.covariance[between]).real
        power = np.abs(cut.harmonics[:, between].T) ** 2
        # power over the mean of as many lines of noise goes beyond x with the chance (1 + x / lines)^-lines
        lines = np.maximum(cut.lines_between[between], 1.0)[:, None]
        seen = lines * np.expm1(np.log(power.size / CHANCE_OF_RUNOUT) / lines)
        excess = np.sum(np.where(power > seen * noise, power, 0.0))
        shares.append(float(np.sqrt(excess / max(np.sum(np.abs(cut.harmonics[:, passing]) ** 2), 1e-300))))
    return max(shares)


def notice_collector(where: str) -> tuple[list[Notice], Note]:
    """A list, and the function that adds to it."""
    notices: list[Notice] = []

    def note(code: str, message: str, level: str = "warning") -> None:
        notices.append(Notice(code, message, where, level))  # type: ignore[arg-type]

    return notices, note
