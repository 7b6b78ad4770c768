"""At which spindle speeds one more acceleration cut would tell the coefficients best, from the FRF alone.

What a cut will tell is known before it is made: the law says what its harmonics are worth, the FRF how strongly they move the
sensors, its variance and the noise of the sensors how well. The size of the coefficients hardly matters, because speeds
are compared; where nothing is known of them, those of a soft aluminium are assumed.
"""

from itertools import pairwise

import numpy as np

from millcal.data import ForceHarmonics, Frf, SpeedAdvice
from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.force_subspace import NAMES, force_constraint, harmonic_basis
from millcal.physics.structure import convert_frf_variance
from millcal.stages.forces.frf_errors import BENT, alike_lines, frf_at
from millcal.stages.forces.problem import axes_dofs, axes_of, check_frf, force_orders, harmonics_for, signed_places

ASSUMED = np.array([800e6, 300e6, 150e6, 20e3, 20e3, 5e3])  # in the order of NAMES, SI
DURATION = 2.0  # s of steady cut
QUIET = 1e-3  # m/s^2 of a harmonic, where nothing tells the noise of the sensors
APART = 0.04  # of a speed, between two that are advised
MOST = 5


def advise_speeds(
    frf: Frf,
    cutter: Cutter,
    conditions: CuttingConditions,
    *,
    spindle_speed: tuple[float, float],
    points: int = 200,
    harmonics: int | None = None,
    given: ForceHarmonics | None = None,
) -> SpeedAdvice:
    """Expected relative standard deviation of the coefficients after one more cut, against its spindle speed.

    spindle_speed : rad/s, lowest and highest   harmonics : of the tooth passing; None takes as many as a reconstruction
    given : what earlier cuts have told: their coefficients, sensors and noise are taken, and what they know is added

    Raises
    ------
    IllPosedError
        At no speed do two harmonics lie in the band of the FRF, or no coefficient can be told.
    """
    if not 0 < spindle_speed[0] < spindle_speed[1]:
        raise IllPosedError("rpm: the lowest speed is above zero and below the highest; correct them")
    check_frf(frf)
    axes, columns = axes_of(frf)
    sensors = given.sensors if given is not None else _sensors(frf, axes_dofs(frf, columns))
    rows, row_sign = signed_places(sensors, frf.outputs)
    signs = row_sign[:, None] * signed_places(axes_dofs(frf, columns), frf.inputs)[1]
    speeds = np.linspace(*spindle_speed, points)
    cuts = 1 if given is None else len(given.cuts)
    harmonics = harmonics or harmonics_for(cutter, cuts, False)
    orders = np.array(force_orders(cutter, harmonics, False))
    frequency = np.multiply.outer(speeds / (2 * np.pi), orders)  # (speed, line)
    low, high = max(frf.usable_band[0], 1e-9), frf.usable_band[1]
    inside = (frequency >= low) & (frequency <= high)
    usable = inside.sum(axis=1) >= min(2, len(orders))
    if not usable.any():
        raise IllPosedError(
            f"rpm: at no speed do two harmonics of the tooth passing lie in the usable band of the FRF, {low:.4g} to {high:.4g} Hz"
        )
    flat = np.clip(frequency, low, high).ravel()
    shape = (*frequency.shape, len(sensors), len(axes))
    matrix = (frf_at(frf, flat, rows, columns) * signs).reshape(shape)
    variance = _variance(frf, flat, rows, columns).reshape(shape)
    variance = variance + BENT**2 * np.mean(np.abs(matrix) ** 2, axis=2, keepdims=True)

    basis = harmonic_basis(cutter, conditions, orders, axes)
    known = np.flatnonzero(force_constraint(basis).told)
    if not {"Ktc", "Krc"} & {NAMES[i] for i in known}:
        raise IllPosedError(
            "forces: such a cut gives no alternating force of Ktc and Krc at any speed (a slot with four teeth or six); advise for "
            "another radial depth or fewer teeth"
        )
    if not len(known):
        raise IllPosedError(
            "forces: these harmonics carry no force of any coefficient; use another cut or more harmonics"
        )
    law, past = _law(given, known)
    scale = np.maximum(np.abs(law[known]), 1e-3 * np.abs(ASSUMED[known]))
    force = basis @ law  # (line, axis)
    noise = _noise(frf, rows, given)
    of_frf = np.einsum("nlsa,la->nls", variance, np.abs(force) ** 2)
    spread = noise + of_frf
    slopes = np.einsum("nlsa,lap->nlsp", matrix, basis[:, :, known] * scale)
    turn = np.einsum("nlsa,la->nls", matrix, 1j * orders[:, None] * force)  # the angle of tooth 0 is found as well
    slopes = np.concatenate([slopes, turn[..., None]], axis=3)
    weight = np.where(inside, 1.0, 0.0)[:, :, None] / spread
    if given is not None:  # where the FRF is wrong as it was in an earlier cut, its error does not average out
        repeated = _repeated(frf, flat, given).reshape(frequency.shape)
        weight = weight * (1 - repeated[:, :, None] * of_frf / spread)
    information = 2 * np.einsum("nlsp,nls,nlsq->npq", slopes.conj(), weight, slopes).real
    n = len(known)
    own = (
        information[:, :n, :n]
        - np.einsum("np,nq->npq", information[:, :n, n], information[:, n, :n])
        / np.maximum(information[:, n, n], 1e-300)[:, None, None]
    )
    own = own + past * np.outer(scale, scale)
    sd = np.full((points, n), np.nan)
    covariance = np.linalg.pinv(own[usable], hermitian=True)
    sd[usable] = np.sqrt(np.maximum(np.einsum("npp->np", covariance), 0.0))
    whitened = matrix / np.sqrt(spread)[..., None]
    by_line = np.where(inside, np.linalg.cond(whitened), -np.inf)
    condition = np.full(points, np.nan)
    condition[usable] = _condition(basis, whitened[usable], inside[usable])
    names = tuple(NAMES[i] for i in known)
    wanted = [i for i, name in enumerate(names) if name in ("Ktc", "Krc")]
    score = np.log(np.where(np.isfinite(sd[:, wanted]), sd[:, wanted], np.inf)).mean(axis=1)
    return SpeedAdvice(
        spindle_speed=speeds,
        names=names,
        relative_sd=sd,
        condition=condition,
        best=_best(speeds, score),
        worst_harmonic=orders[np.argmax(by_line, axis=1)] / cutter.teeth,
        harmonics=harmonics,
    )


def _condition(basis: np.ndarray, whitened: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Condition number of what a fit solves at each speed: of forces of one newton that the law allows.

    basis : complex (line, axis, coefficient)   whitened : complex (speed, line, sensor, axis)   inside : (speed, line) bool
    """
    space = force_constraint(basis).space
    half = space.basis.shape[0] // 2
    allowed = (space.basis[:half] + 1j * space.basis[half:]).reshape(*basis.shape[:2], space.rank)
    moved = np.einsum("nlsa,lar->nlsr", whitened, allowed) * inside[:, :, None, None]
    flat = moved.reshape(len(moved), -1, space.rank)
    return np.asarray(np.linalg.cond(np.concatenate([flat.real, flat.imag], axis=1)))


def _sensors(frf: Frf, inputs: list[str]) -> tuple[str, ...]:
    """Outputs that may stay where they are in a cut: all but those at the point that is hit."""
    point = inputs[0][:-1].lower()
    names = [name.lstrip("+-") for name in frf.outputs]
    away = tuple(name for name in names if name[:-1].lower() != point)
    if not away:
        raise IllPosedError(
            "frf: every output is at the tool tip, where no sensor stays in a cut; measure at other points too"
        )
    return away


def _variance(frf: Frf, frequency: np.ndarray, rows: np.ndarray, columns: list[int]) -> np.ndarray:
    """Of the accelerance, straight between the lines; 0 where the FRF says nothing.   returns (line, row, column)"""
    if frf.variance is None:
        return np.zeros((len(frequency), len(rows), len(columns)))
    own = np.nan_to_num(frf.variance[:, rows][:, :, columns])
    place = np.clip(np.searchsorted(frf.frequency, frequency), 1, len(frf.frequency) - 1)
    step = frf.frequency[place] - frf.frequency[place - 1]
    share = ((frequency - frf.frequency[place - 1]) / step)[:, None, None]
    between = (1 - share) * own[place - 1] + share * own[place]
    return convert_frf_variance(frequency, between, frf.form, "accelerance")


def _repeated(frf: Frf, frequency: np.ndarray, given: ForceHarmonics) -> np.ndarray:
    """How much of the FRF's error at each line stands in an earlier cut's, 0 to 1.   frequency : (line,) Hz"""
    both = np.concatenate([frequency, given.frequency])
    alike = np.abs(alike_lines(frf, both, len(frequency))) ** 2
    return np.asarray(alike.max(axis=1))


def _law(given: ForceHarmonics | None, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients, and the information that earlier cuts have of those that one more cut tells.   returns (6,), (n, n)"""
    values = ASSUMED.copy()
    past = np.zeros((len(known), len(known)))
    if given is None:
        return values, past
    told = given.posterior
    for name, value in zip(told.names, told.mean, strict=True):
        values[NAMES.index(name)] = value
    both = [i for i, k in enumerate(known) if NAMES[k] in told.names]
    at = [told.names.index(NAMES[known[i]]) for i in both]
    sd = np.sqrt(np.diag(told.covariance))[at]
    alike = told.covariance[np.ix_(at, at)] / np.outer(sd, sd)
    past[np.ix_(both, both)] = np.linalg.pinv(alike, hermitian=True) / np.outer(sd, sd)
    return values, past


def _noise(frf: Frf, rows: np.ndarray, given: ForceHarmonics | None) -> np.ndarray:
    """Variance of a harmonic of each sensor: of the earlier cuts' fit, else that of the impact test over a cut's time.

    returns (sensor,) (m/s^2)^2
    """
    if given is not None and given.noise is not None:
        return np.asarray(np.mean(given.noise**2, axis=0))
    variance = np.full(len(rows), QUIET**2)
    for test in frf.tests:
        length = float((test.window_stop + test.window_fall / 2).mean())
        for output, form, noise in zip(test.outputs, test.forms, test.response_noise, strict=True):
            place = np.flatnonzero(rows == frf.outputs.index(output))
            if len(place) and form == "accelerance":
                variance[place] = 4 * noise / length / (DURATION * test.sample_rate)
    return variance


def _best(speeds: np.ndarray, score: np.ndarray) -> tuple[float, ...]:
    """Minima of the score, best first, apart from each other; the ends of the range count."""
    around = np.concatenate([[np.inf], score, [np.inf]])
    falls = [b < a for a, b in pairwise(around)]
    rises = [b >= a for a, b in pairwise(around)]
    minima = [i for i in range(len(score)) if np.isfinite(score[i]) and falls[i] and rises[i + 1]]
    chosen: list[float] = []
    for i in sorted(minima, key=lambda i: score[i]):
        if all(abs(speeds[i] / other - 1) > APART for other in chosen):
            chosen.append(float(speeds[i]))
    return tuple(chosen[:MOST])
