"""The tip of the tool from modes: along machine axes as somebody gave them, or fitted to an FRF.

Fitted modes bring whole residues, so that a mode may move along both axes and out of phase, and a remainder for the modes
outside the band of the fit. With a remainder the receptance is known in that band and a little beyond, and there chatter is
looked for; without one the modes are taken for the whole structure.

What a fit knows about its errors are deviations, rows whose product deviation^T deviation is the covariance of all
frequencies, damping ratios and residues together. A draw is the fit plus their sum, each by a normal number, all of them
stretched by one root of dof / chi^2 (Student's t): the limit is solved for each draw anew, so that corners between lobes
and pairs of close modes are as likely as they are.
"""

from collections.abc import Iterator

import numpy as np

from millcal.data import ModalFit, Modes, Notice
from millcal.physics import structure
from millcal.physics.stability import zero_order
from millcal.stages.stability.tip import (
    Lines,
    Solver,
    Tip,
    absorbs_power,
    at_tip,
    driving_points,
    lowest_known,
    missing_axes,
)

BEYOND = 1.1  # times the ends of the band of the fit: a remainder goes on smoothly, but not for ever
LEAST_DAMPING = 0.05  # share of its damping that a mode keeps in any draw
SMOOTHED = 9  # lines over which the misfit is averaged
APART = 8  # lines after which noise is another, however many zeros were added to the records
ALIKE = 0.5  # correlation of the misfit with itself so far away, from which on it is no noise
MISSED = 0.02  # share of a driving point that a model may miss before it is told


def tip_of_modes(record: Modes, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    """The zero-order method on modes.

    speeds : rad/s, among them the lowest and the highest that will be asked   rigid : axes that may be missing
    """
    return (
        _by_hand(record, speeds, teeth, rigid)
        if record.fit is None
        else _fitted(record, record.fit, speeds, teeth, rigid)
    )


def _by_hand(record: Modes, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    columns = (record.natural_frequency, record.damping_ratio, record.stiffness, record.axes)
    modes = [structure.Mode(float(f), float(z), float(k), axis) for f, z, k, axis in zip(*columns, strict=True)]
    notices = missing_axes({mode.axis for mode in modes}, rigid, "modes")
    modes = [mode for mode in modes if mode.axis in ("x", "y")]
    if len(modes) == 1:
        return Tip(
            solve=lambda speed, cutting: zero_order.limit_of_one_mode(speed, modes[0], cutting, teeth),
            minimum=lambda cutting: zero_order.minimum_of_one_mode(modes[0], cutting),
            notices=tuple(notices),
        )
    tip = zero_order.dynamics_of_modes(modes, speeds, teeth)
    return Tip(
        solve=lambda speed, cutting: zero_order.limit(speed, tip, cutting, teeth),
        minimum=lambda cutting: zero_order.absolute_minimum(zero_order.oriented(tip, cutting)),
        notices=tuple(notices),
    )


def _fitted(record: Modes, fit: ModalFit, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    point, places = driving_points(fit.outputs, fit.inputs, "modes")
    where = f"modes {point}"
    notices = missing_axes(set(places), rigid, where)
    residue, remainder = (at_tip(values, places, fit.outputs, fit.inputs) for values in (fit.residue, fit.remainder))
    unmeasured = ~(np.isfinite(residue).all(axis=0) & np.isfinite(remainder).all(axis=0))
    if unmeasured.any():
        notices.append(
            Notice("cross-terms", "cross receptances that were not measured are taken as zero", where, "note")
        )
        residue[:, unmeasured], remainder[:, unmeasured] = 0.0, 0.0
    natural, damping = record.natural_frequency, record.damping_ratio

    def dynamics(natural: np.ndarray, damping: np.ndarray, residue: np.ndarray) -> zero_order.Dynamics:
        def at(frequency: np.ndarray) -> np.ndarray:
            return structure.modal_receptance(frequency, natural, damping, residue, remainder, fit.remainder_power)

        return zero_order.dynamics_of_receptance(at, natural, damping, band)

    low, high = fit.band
    band = zero_order.search_range(natural, speeds, teeth)
    limited = bool(np.any(remainder))
    if limited:
        known = max(_known_from(fit, places, point).values(), default=0.0)
        if known > low:
            what = f"below {known:.0f} Hz the fit is noise, so chatter there is not looked for"
            notices.append(Notice("low-frequency-noise", what, where, "note"))
        band = (known if known > low else max(low, fit.frequency[fit.frequency > 0].min()) / BEYOND, high * BEYOND)
    tip = dynamics(natural, damping, residue)
    inside = (tip.grid >= low) & (tip.grid <= high)
    notices += absorbs_power(Lines(tip.grid[inside], tip.on_grid[inside], None, ()), places, "modes", point)

    notices += _missed(fit, places, point)

    deviations = (fit.frequency_deviation, fit.damping_deviation)
    moved = at_tip(fit.residue_deviation, places, fit.outputs, fit.inputs)
    moved = np.where(unmeasured, 0.0, moved)

    def draws(rng: np.random.Generator, n: int) -> Iterator[Solver]:
        numbers = rng.standard_normal((n, len(moved)))
        if np.isfinite(fit.dof):
            numbers *= np.sqrt(fit.dof / rng.chisquare(fit.dof, size=(n, 1)))
        for z in numbers:
            frequency = np.maximum(natural + z @ deviations[0], 0.5 * natural)
            ratio = np.clip(damping + z @ deviations[1], LEAST_DAMPING * damping, 0.99)
            drawn = dynamics(frequency, ratio, residue + np.tensordot(z, moved, 1))
            yield lambda speed, cutting, drawn=drawn: zero_order.limit_along(
                speed, zero_order.oriented(drawn, cutting, halvings=8), teeth
            )

    known_errors = fit.interval_from != "none" and len(moved) > 0 and fit.dof > 0
    known_errors &= all(np.isfinite(part).all() for part in (*deviations, moved))
    if not known_errors:
        notices.append(Notice("no-band", "the modes carry no interval, so the limit has no band from them", where))
    return Tip(
        solve=lambda speed, cutting: zero_order.limit(speed, tip, cutting, teeth),
        minimum=lambda cutting: zero_order.absolute_minimum(zero_order.oriented(tip, cutting)),
        notices=tuple(notices),
        band=(float(tip.grid[0]), float(tip.grid[-1])) if limited else None,
        band_of="the band of the modal fit and a little beyond",
        draws=draws if known_errors else None,
    )


def _missed(fit: ModalFit, places: dict[str, tuple[int, int]], point: str) -> list[Notice]:
    """What the model itself lacks, apart from noise: a misfit that goes on from line to line."""
    notices = []
    for axis, (o, i) in sorted(places.items()):
        moving = fit.frequency > 0
        measured, modelled = (
            structure.convert_frf(fit.frequency[moving], values[moving, o, i], fit.form, "mobility")
            for values in (fit.measured, fit.modelled)
        )
        misfit = measured - modelled
        power = np.sum(np.abs(misfit) ** 2)
        alike = np.abs(np.sum(misfit[APART:] * misfit[:-APART].conj())) / max(power, 1e-300)
        share = alike * np.sqrt(power) / np.linalg.norm(measured)
        if alike > ALIKE and share > MISSED:
            dof = f"{point}{axis.upper()}"
            what = (
                f"the modes miss {share:.0%} of what was measured by more than noise; the limit may be off by as much, "
            )
            notices.append(Notice("modes-misfit", what + "and its band does not know of it", f"modes {dof}/{dof}"))
    return notices


def _known_from(fit: ModalFit, places: dict[str, tuple[int, int]], point: str) -> dict[str, float]:
    """Where the fit of each driving point begins to follow what was measured, Hz; its misfit stands for the noise."""
    moving = fit.frequency > 0
    frequency = fit.frequency[moving]
    modelled, measured = (
        structure.convert_frf(
            frequency, at_tip(values[moving], places, fit.outputs, fit.inputs), fit.form, "receptance"
        )
        for values in (fit.modelled, fit.measured)
    )
    misfit = np.abs(measured - modelled) ** 2
    window = np.ones(SMOOTHED)
    many = np.convolve(np.ones(len(frequency)), window, mode="same")
    found = {}
    for axis in places:
        i = "xy".index(axis)
        spread = np.zeros(misfit.shape)
        spread[:, i, i] = np.convolve(misfit[:, i, i], window, mode="same") / many
        lines, dof = Lines(frequency, modelled, spread, ()), f"{point}{axis.upper()}"
        found[axis] = lowest_known(lines, i, f"modes {dof}/{dof}")
    return found
