"""The tip of the tool from modes: along machine axes as somebody gave them, or fitted to an FRF.

Fitted modes bring whole residues, so that a mode may move along both axes and out of phase, and a remainder for the modes
outside the band of the fit. With a remainder the receptance is known in that band and a little beyond, and there chatter is
looked for; without one the modes are taken for the whole structure.

What a fit knows about its errors are deviations, rows whose product deviation^T deviation is the covariance of all
frequencies, damping ratios and residues together. A draw is the fit plus their sum, each by a normal number, all of them
stretched by one root of dof / chi^2 (Student's t): the limit is solved for each draw anew, so that corners between lobes
and pairs of close modes are as likely as they are.

Methods that follow the motion in time need poles and nothing else. There the remainder of the modes above the band is a
flexibility; that of the modes below, an inertia line, becomes one heavily damped mode below the band where it is not small.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from millcal.data import ModalFit, Modes, Notice
from millcal.physics import structure
from millcal.physics.stability import regeneration, zero_order
from millcal.physics.stability.regeneration import TipModes
from millcal.stages.stability.physical import physical
from millcal.stages.stability.tip import (
    Lines,
    Tip,
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
SMALL = 0.003  # share of the receptance at every resonance below which a remainder is left out
RANK = 1e-4  # of a residue's larger shape: a second one below that is noise
BELOW = 5.0  # times below the lowest frequency of the band: where a mode stands for an inertia line,
HEAVY = 0.7  # its damping ratio: far from ringing, and a hundredth of itself off from three times the band's lowest frequency on
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
    modes = _modes(record)
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


def _modes(record: Modes) -> list[structure.Mode]:
    columns = (record.natural_frequency, record.damping_ratio, record.stiffness, record.axes)
    return [structure.Mode(float(f), float(z), float(k), axis) for f, z, k, axis in zip(*columns, strict=True)]


class _Fitted(NamedTuple):
    """What a fit knows of the tip: residues and remainder in x and y, and their errors along the deviations."""

    places: dict[str, tuple[int, int]]
    point: str
    natural: np.ndarray  # (mode,) Hz
    damping: np.ndarray  # (mode,)
    residue: np.ndarray  # complex (mode, 2, 2) s/kg
    remainder: np.ndarray  # (remainder, 2, 2)
    moved: np.ndarray  # of the residue, complex (deviation, mode, 2, 2)
    unmeasured: bool  # cross receptances, taken as zero
    known_errors: bool


def _at_the_tip(record: Modes, fit: ModalFit) -> _Fitted:
    point, places = driving_points(fit.outputs, fit.inputs, "modes")
    residue, remainder = (at_tip(values, places, fit.outputs, fit.inputs) for values in (fit.residue, fit.remainder))
    unmeasured = ~(np.isfinite(residue).all(axis=0) & np.isfinite(remainder).all(axis=0))
    residue[:, unmeasured], remainder[:, unmeasured] = 0.0, 0.0
    moved = np.where(unmeasured, 0.0, at_tip(fit.residue_deviation, places, fit.outputs, fit.inputs))
    known = fit.interval_from != "none" and len(moved) > 0 and fit.dof > 0
    known &= all(np.isfinite(part).all() for part in (fit.frequency_deviation, fit.damping_deviation, moved))
    return _Fitted(
        places,
        point,
        record.natural_frequency,
        record.damping_ratio,
        residue,
        remainder,
        moved,
        unmeasured.any(),
        known,
    )


def _drawn(
    fitted: _Fitted, fit: ModalFit, rng: np.random.Generator, n: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Frequencies, damping ratios and residues as they may be."""
    numbers = rng.standard_normal((n, len(fitted.moved)))
    if np.isfinite(fit.dof):
        numbers *= np.sqrt(fit.dof / rng.chisquare(fit.dof, size=(n, 1)))
    natural, damping = fitted.natural, fitted.damping
    for z in numbers:
        frequency = np.maximum(natural + z @ fit.frequency_deviation, 0.5 * natural)
        ratio = np.clip(damping + z @ fit.damping_deviation, LEAST_DAMPING * damping, 0.99)
        yield frequency, ratio, fitted.residue + np.tensordot(z, fitted.moved, 1)


def _fitted(record: Modes, fit: ModalFit, speeds: np.ndarray, teeth: int, rigid: str) -> Tip:
    fitted = _at_the_tip(record, fit)
    point, places, natural, remainder = fitted.point, fitted.places, fitted.natural, fitted.remainder
    where = f"modes {point}"
    notices = missing_axes(set(places), rigid, where)
    if fitted.unmeasured:
        notices.append(
            Notice("cross-terms", "cross receptances that were not measured are taken as zero", where, "note")
        )

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
    tip = dynamics(natural, fitted.damping, fitted.residue)
    inside = (tip.grid >= low) & (tip.grid <= high)
    notices += physical(Lines(tip.grid[inside], tip.on_grid[inside], None, ()), places, "modes", point)

    notices += _missed(fit, places, point)

    def draws(rng: np.random.Generator, n: int) -> Iterator[TipModes]:
        for parts in _drawn(fitted, fit, rng, n):
            yield regeneration.tip_of_residues(*parts)

    if not fitted.known_errors:
        notices.append(Notice("no-band", "the modes carry no interval, so the limit has no band from them", where))
    return Tip(
        solve=lambda speed, cutting: zero_order.limit(speed, tip, cutting, teeth),
        minimum=lambda cutting: zero_order.absolute_minimum(zero_order.oriented(tip, cutting)),
        notices=tuple(notices),
        band=(float(tip.grid[0]), float(tip.grid[-1])) if limited else None,
        band_of="the band of the modal fit and a little beyond",
        draws=draws if fitted.known_errors else None,
        remainder=(fitted.remainder, fit.remainder_power.astype(int)),
    )


class Poles(NamedTuple):
    """The tip for methods that follow its motion, and draws of it where a fit knows its errors."""

    tip: TipModes
    notices: tuple[Notice, ...]
    draws: Callable[[np.random.Generator, int], Iterator[TipModes]] | None


def poles_of_modes(record: Modes) -> Poles:
    """Poles, shapes and flexibility of the tip in x and y; what `tip_of_modes` tells of the modes is not told again."""
    if record.fit is None:
        modes, notices = _modes(record), []
        if axial := [mode for mode in modes if mode.axis == "z"]:
            what = f"{len(axial)} of the modes move along z, where a stability limit in x and y does not look"
            notices.append(Notice("axial-modes", what, "modes", "note"))
        return Poles(regeneration.tip_of_modes(modes), tuple(notices), None)
    fit = record.fit
    fitted = _at_the_tip(record, fit)
    flexibility, line, notices = _beyond_the_band(fitted, fit)

    def tip(natural: np.ndarray, damping: np.ndarray, residue: np.ndarray) -> TipModes:
        parts = ([natural, line[0]], [damping, line[1]], [residue, line[2]])
        return regeneration.tip_of_residues(*(np.concatenate(part) for part in parts), flexibility, negligible=RANK)

    def draws(rng: np.random.Generator, n: int) -> Iterator[TipModes]:
        for parts in _drawn(fitted, fit, rng, n):
            yield tip(*parts)

    return Poles(
        tip(fitted.natural, fitted.damping, fitted.residue), tuple(notices), draws if fitted.known_errors else None
    )


def _beyond_the_band(
    fitted: _Fitted, fit: ModalFit
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray], list[Notice]]:
    """What the remainder becomes where only poles count.   returns flexibility, a mode (none or one of each), notices"""
    where, flexibility = f"modes {fitted.point}", np.zeros((2, 2))
    line = (np.empty(0), np.empty(0), np.empty((0, 2, 2), complex))
    notices = []
    whole = structure.modal_receptance(
        fitted.natural, fitted.natural, fitted.damping, fitted.residue, fitted.remainder, fit.remainder_power
    )
    peak = np.abs(whole).max(axis=(1, 2))
    for power, term in zip(fit.remainder_power.astype(int), fitted.remainder, strict=True):
        share = float(np.max(np.abs(term).max() * (2 * np.pi * fitted.natural) ** power / peak))
        if power == 0:
            flexibility = np.real(term)
        elif power == -2 and share > SMALL:
            size, shape = np.linalg.eigh((term + term.T).real / 2)
            mass = (shape * np.maximum(size, 0.0)) @ shape.T  # its inverse; what would give power back is noise
            # where the fit is noise, a line that goes on to nought would be a soft tip, and chatter there of its own making
            known = max(_known_from(fit, fitted.places, fitted.point).values(), default=0.0)
            lowest = max(fit.band[0], known, fit.frequency[fit.frequency > 0].min()) / BELOW
            damped = 2 * np.pi * lowest * np.sqrt(1 - HEAVY**2)
            line = (np.array([lowest]), np.array([HEAVY]), mass[np.newaxis] / (2j * damped))
            what = (
                f"what moves below the band of the fit, {share:.1%} of the receptance at a resonance, is taken as one mode at "
                f"{lowest:.0f} Hz; chatter slower than {BELOW * lowest:.0f} Hz stands on that alone"
            )
            notices.append(Notice("modes-below", what, where, "note"))
        elif share > SMALL:
            what = f"the fit's remainder with s^{power}, {share:.1%} of the receptance at a resonance, is left out"
            notices.append(Notice("remainder-left-out", what, where))
    return flexibility, line, notices


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
