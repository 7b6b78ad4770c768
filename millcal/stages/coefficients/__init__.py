"""Cutting coefficients from conditioned dynamometer cuts, with intervals, checks and a verdict.

`average` is the regression of mean forces that everybody knows; `nls` fits the force within the revolution, finds runout
and phase, predicts cuts it has not seen, and says whether its law holds. What the two share, and the shape of the answer,
stands here; the methods are functions in a dict.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from millcal.data import Check, Coefficients, CutForce, Frf, Notice, Posterior
from millcal.errors import IllPosedError, RecipeError
from millcal.numerics.jackknife import student_quantile
from millcal.physics.cutting_force import force_at
from millcal.stages.coefficients import average, verdict
from millcal.stages.coefficients.harmonic import (
    HarmonicStudy,
    interpolated_sensor,
    left_out_covariance,
    parameters,
    predict,
    ratio,
    search,
    sensor_band_notice,
    study,
)
from millcal.stages.coefficients.harmonic_model import (
    HarmonicFit,
    HarmonicModel,
    condition,
    modelled_harmonics,
    noise_covariance,
)

ANGLES = 360  # points of the curves that are kept for the report
LAW_NAMES = {
    "linear-edge": (average.NAMES, average.UNITS),
    "kienzle": (("kt", "kr", "ka"), ("N/m^2",) * 3),
}
SHAPE_UNITS = {"c0": "m", "s0": "m", "t0": "m", "mt": "1", "mr": "1", "ma": "1"}


def fit_coefficients(
    cuts: Sequence[CutForce],
    *,
    method: str = "nls",
    law: str = "linear-edge",
    rows: str = "whole-revolutions",
    taper: bool = False,
    harmonics: int | None = None,
    contact_loss: str = "auto",
    mean_weight: float = 5.0,
    sensor: Frf | None = None,
) -> Coefficients:
    """Coefficients of a force law from cuts of one cutter.

    method : average or nls   law : linear-edge or kienzle (nls only)
    rows : whole-revolutions, or all rows of the steady part (average only, to compare with others' numbers)
    taper : let the runout vary along the axis (nls)   harmonics : highest harmonic used (nls; default: the tooth passing)
    contact_loss : auto (look for it and say so), on (fit the runout c0 with the coefficients), off (average)
    mean_weight : weight of the mean forces against the harmonics (nls); 1 where offsets are suspect
    sensor : measured transmissibility of the dynamometer, N/N (nls)

    Raises
    ------
    RecipeError
        An option is unknown or does not go with the method.
    IllPosedError
        The cuts cannot determine the coefficients.
    """
    if method not in METHODS:
        raise RecipeError(f"coefficients.method: {method!r} is unknown; choose one of {', '.join(METHODS)}")
    if law not in LAW_NAMES:
        raise RecipeError(f"coefficients.law: {law!r} is unknown; choose one of {', '.join(LAW_NAMES)}")
    if not cuts:
        raise IllPosedError("cuts: there are none; name at least one recording of a cut")
    if any(cut.cutter != cuts[0].cutter for cut in cuts):
        raise IllPosedError("cuts: they were made with different cutters; identify each cutter by itself")
    own = {
        "average": {"law": law, "rows": rows, "contact_loss": contact_loss},
        "nls": {"law": law, "taper": taper, "harmonics": harmonics, "mean_weight": mean_weight, "sensor": sensor},
    }
    return METHODS[method](tuple(cuts), **own[method])


def average_force(cuts: tuple[CutForce, ...], *, law: str, rows: str, contact_loss: str) -> Coefficients:
    """The regression of mean forces, with contact loss looked for and the axis map questioned."""
    if law != "linear-edge":
        raise RecipeError(f"coefficients.law: mean forces give the linear-edge law only, not {law!r}; use method nls")
    if rows not in ("whole-revolutions", "all"):
        raise RecipeError(f"coefficients.rows: {rows!r} is unknown; choose whole-revolutions or all")
    if contact_loss not in ("auto", "on", "off"):
        raise RecipeError(f"coefficients.contact_loss: {contact_loss!r} is unknown; choose auto, on or off")
    average.check_feeds(cuts)
    forces = average.mean_forces(cuts, rows)
    plain = average.solve_means(cuts, forces, 0.0)
    notices = [*average.axis_map_notices(cuts, forces), *average.curvature_notice(forces, plain.residual, cuts)]
    with_loss, loss = plain, average.ContactLoss(0.0, 1.0, 0.0, False)
    if contact_loss != "off" and cuts[0].cutter.teeth > 1 and len(cuts) > 2:
        with_loss, loss = average.search_contact_loss(cuts, forces)
    chosen = with_loss if contact_loss == "on" else plain
    alternatives = []
    if loss.explains and contact_loss == "auto":
        alternatives.append(
            _alternative(
                "with contact loss", dict(zip(average.NAMES, with_loss.coefficients, strict=True)) | {"c0": loss.runout}
            )
        )
        notices.append(Notice(
            "contact-loss",
            f"runout of c0 = {loss.runout * 1e6:.0f} um takes a tooth out of the cut at the small feeds and explains the bend of the "
            f"means (sum of squares falls to {loss.ratio:.2f}, F = {loss.f_value:.0f}); the straight line is biased: "
            f"Ktc {with_loss.coefficients[0] / 1e6:.0f} instead of {plain.coefficients[0] / 1e6:.0f} N/mm2 (contact_loss = on)",
            "cuts",
        ))  # fmt: skip
    if not any(cut.air for cut in cuts):
        notices.append(
            Notice(
                "no-air-cut", "no air cut in any record: the edge coefficients absorb the amplifier's offset", "cuts"
            )
        )
    if len(cuts) == 2:
        notices.append(
            Notice("two-cuts", "two cuts leave no scatter: no interval can be given; add a third feed", "cuts")
        )
    r2 = average.r_squared(forces, chosen.residual)
    checks = (
        Check(
            "axis-map", not any(n.code in ("axis-swap", "axis-sign", "sign") for n in notices), _map_message(notices)
        ),
        verdict.check_means(cuts, plain, loss),
        Check("line", bool(np.all(r2 > 0.9)), "R2 of the means x, y, z: " + ", ".join(f"{value:.4f}" for value in r2)),
    )
    posterior = average.posterior_of(chosen)
    return _answer(
        cuts,
        posterior,
        verdict.mean_force_verdict(plain, checks),
        checks,
        modelled=_mean_force_curves(cuts, chosen),
        residual=chosen.residual,
        means=(forces, chosen.modelled),
        r2=r2,
        alternatives=alternatives,
        notices=notices,
    )


def _map_message(notices: Sequence[Notice]) -> str:
    found = [n.message for n in notices if n.code in ("axis-swap", "axis-sign", "sign")]
    return found[0] if found else "signs and sizes are those of a right axis map: all positive, Ktc > Krc"


def _mean_force_curves(cuts: tuple[CutForce, ...], fit: average.MeanForceFit) -> list[np.ndarray]:
    """The force over the revolution that mean-force coefficients imply; only each record's phase is taken from it."""
    band = min(cut.harmonics.shape[1] for cut in cuts) - 1
    model = _model(cuts, law="linear-edge", band=band, mean_weight=1.0)
    shape = np.array([fit.runout, *[0.0] * (len(model.runout_names) - 1)]) if model.runout_names else np.zeros(0)
    held = HarmonicFit(model, shape, np.zeros(0), np.zeros(len(cuts)), fit.coefficients, np.inf)
    return [predict(held, cut, band) for cut in cuts]


def _model(cuts: tuple[CutForce, ...], *, law: str, band: int, mean_weight: float, **options: Any) -> HarmonicModel:
    level = np.sqrt(np.mean([np.sum(np.abs(cut.harmonics[:, 1:]) ** 2, axis=1) / 2 for cut in cuts], axis=0))
    weight = 1 / np.maximum(
        level, 1e-6 * max(level.max(), 1e-300)
    )  # an axis without force weighs little, not infinitely
    pulse = all(cut.phase_from_pulse for cut in cuts)
    return HarmonicModel(cuts, law, band, mean_weight, weight, common_phase=pulse, **options)


def instantaneous(
    cuts: tuple[CutForce, ...], *, law: str, taper: bool, harmonics: int | None, mean_weight: float, sensor: Frf | None
) -> Coefficients:
    """The fit of the force within the revolution, judged by what it says of cuts left out."""
    teeth = cuts[0].cutter.teeth
    saved = min(cut.harmonics.shape[1] for cut in cuts) - 1
    band = min(saved, harmonics if harmonics is not None else max(teeth, 2))
    if band < 1:
        raise IllPosedError(f"coefficients.harmonics: {band} leaves no force within the revolution; use 1 or more")
    gain = None if sensor is None else interpolated_sensor(sensor)
    model = _model(cuts, law=law, band=band, mean_weight=mean_weight, taper=taper and teeth > 1, sensor=gain)
    found = study(model)
    best = found.best
    notices = [] if sensor is None else list(sensor_band_notice(sensor, cuts, band))
    names, units = LAW_NAMES[law]
    names, units = (*names, *model.shape_names), (*units, *(SHAPE_UNITS[name] for name in model.shape_names))
    mean = parameters(best)
    if found.left_out:
        covariance, dof = left_out_covariance(found), float(len(cuts) - 1)
    else:
        covariance, dof = noise_covariance(best), np.inf
        notices.append(Notice(
            "narrow-intervals",
            f"{len(cuts)} cut{'s' if len(cuts) > 1 else ''}: intervals are from the noise within the records alone, 10 to 40 times narrower than "
            "the scatter of cuts; add cuts to have three or more",
            "cuts",
        ))  # fmt: skip
    half = student_quantile(dof) * np.sqrt(np.diag(covariance))
    posterior = Posterior(
        names=names, units=units, mean=mean, covariance=covariance, interval=np.stack([mean - half, mean + half], axis=1),
        law=law, method="nls", dof=dof,  # type: ignore[arg-type]
    )  # fmt: skip
    notices += _what_is_not_seen(found, names)
    forces = average.mean_forces(cuts, "whole-revolutions")
    checks: list[Check] = [verdict.check_asynchronous(cuts), verdict.check_contact(cuts, _tooth_offsets(found))]
    if saved > band:
        checks.append(verdict.check_above_tooth_passing(found, saved))
    ktc = {law: float(mean[0])} if law == "linear-edge" else {}
    alternatives: list[tuple[str, tuple[tuple[str, float], ...]]] = []
    feeds = np.array([cut.conditions.feed_per_tooth for cut in cuts])
    if law == "linear-edge" and len(cuts) > 2 and np.ptp(feeds) > 0.02 * feeds.max():
        plain = average.solve_means(cuts, forces, 0.0)
        notices += average.axis_map_notices(cuts, forces)
        with_loss, loss = (
            (plain, average.ContactLoss(0.0, 1.0, 0.0, False))
            if teeth == 1
            else average.search_contact_loss(cuts, forces)
        )
        checks.append(verdict.check_means(cuts, plain, loss))
        if found.left_out:
            ac_only = study(replace(model, mean_weight=0.0))
            # the means' own contact loss is the effective one of this fit: c0 for two teeth, for more the means decide
            runout = float(best.shape[0]) if teeth == 2 else loss.runout
            checks.append(verdict.check_means_against_ac(runout, found, ac_only))
            alternatives.append(
                _alternative("alternating force alone", dict(zip(names, parameters(ac_only.best), strict=True)))
            )
        alternatives.append(_alternative("mean forces", dict(zip(average.NAMES, plain.coefficients, strict=True))))
        if loss.explains:
            named = dict(zip(average.NAMES, with_loss.coefficients, strict=True)) | {"c0": loss.runout}
            alternatives.append(_alternative("mean forces with contact loss", named))
        ktc["mean forces"] = float((with_loss if loss.explains else plain).coefficients[0])
        if saved > band:
            wide = search(replace(model, band=saved, mean_weight=1.0))[0]
            ktc["all harmonics"] = float(wide.linear[0])
            alternatives.append(_alternative(f"harmonics to {saved}", dict(zip(names, parameters(wide), strict=True))))
        checks.append(verdict.check_spread(ktc))
    checks.insert(2, verdict.check_prediction(found))
    if not any(cut.air for cut in cuts):
        notices.append(
            Notice(
                "no-air-cut", "no air cut in any record: the edge coefficients absorb the amplifier's offset", "cuts"
            )
        )
    modelled = [modelled_harmonics(best, cut, phase, saved) for cut, phase in zip(cuts, best.phase, strict=True)]
    unseen = [predict(fit, cut, saved) for fit, cut in zip(found.left_out, cuts, strict=False)]
    in_wide, _ = ratio(cuts, modelled, saved)
    out_wide = ratio(cuts, unseen, saved)[0] if unseen else None
    means = np.stack([value[:, 0].real for value in modelled])
    residual = np.sqrt(np.mean([np.sum(np.abs(c.harmonics[:, 1:saved + 1] - m[:, 1:]) ** 2, 1) / 2 for c, m in zip(cuts, modelled, strict=True)], 0))  # fmt: skip
    return replace(
        _answer(
            cuts, posterior, verdict.conclude(checks, found.predicted), tuple(checks),
            modelled=modelled, residual=None, means=(forces, means), r2=1 - in_wide**2, alternatives=alternatives, notices=notices,
        ),
        residual_rms=residual, in_sample=found.in_sample, left_out=found.predicted, left_out_by_cut=found.predicted_by_cut,
        in_sample_wide=in_wide, left_out_wide=out_wide, phase=best.phase % (2 * np.pi), band=(0, band),
    )  # fmt: skip


def _tooth_offsets(found: HarmonicStudy) -> np.ndarray:
    """Radial offset of every tooth at mid depth.   returns (tooth,) m"""
    value = dict(zip(found.best.model.shape_names, found.best.shape, strict=True))
    lag = found.best.model.cuts[0].cutter.tooth_lag()
    return value.get("c0", 0.0) * np.cos(lag) - value.get("s0", 0.0) * np.sin(lag)


def _what_is_not_seen(found: HarmonicStudy, names: Sequence[str]) -> list[Notice]:
    """What the data leave open: combinations, labels, other minima."""
    notices = []
    number, direction = condition(found.best)
    if number > 1e4:
        large = [names[i] for i in np.argsort(-np.abs(direction[: len(names)]))[:3] if abs(direction[i]) > 0.2]
        message = f"the data hardly tell {' and '.join(large) or 'the phases'} apart (condition number {number:.0e}); hold one, or add feeds"
        notices.append(Notice("unobservable", message, "cuts"))
    teeth = found.best.model.cuts[0].cutter.teeth
    if teeth == 2:
        message = "two teeth show c0 = rho cos(lambda) at mid depth only; rho and lambda cannot be told apart"
        notices.append(Notice("runout-combination", message, "cutter"))
    elif teeth > 2 and found.best.model.cuts[0].cutter.pitch is None and not found.best.model.common_phase:
        message = f"teeth carry no label: the phase, and with it lambda, is known up to multiples of 360/{teeth} deg"
        notices.append(Notice("tooth-label", message, "cutter"))
    best = found.best
    for rival in found.rivals:
        if rival.cost < 1.1 * best.cost and abs(rival.linear[0] - best.linear[0]) > 0.15 * abs(best.linear[0]):
            message = f"a second minimum fits as well (cost {rival.cost / best.cost:.2f}) with a first coefficient of {rival.linear[0] / 1e6:.0f} N/mm2"
            notices.append(Notice("several-minima", message, "cuts"))
            break
    return notices


def _alternative(name: str, values: dict[str, float]) -> tuple[str, tuple[tuple[str, float], ...]]:
    return name, tuple((key, float(value)) for key, value in values.items())


def _answer(
    cuts: tuple[CutForce, ...], posterior: Posterior, sentence: str, checks: tuple[Check, ...], *, modelled: Sequence[np.ndarray],
    residual: np.ndarray | None, means: tuple[np.ndarray, np.ndarray], r2: np.ndarray, alternatives: Sequence[Any], notices: Sequence[Notice],
) -> Coefficients:  # fmt: skip
    """The record, with both force curves and both spectra for the report."""
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    saved = min(cut.harmonics.shape[1] for cut in cuts)
    measured = np.stack([cut.harmonics[:, :saved] for cut in cuts])
    predicted = np.stack([value[:, :saved] for value in modelled])
    rms = np.full(3, np.nan) if residual is None else np.sqrt(np.mean(residual**2, axis=0))
    return Coefficients(
        posterior=posterior, cutter=cuts[0].cutter, conditions=tuple(cut.conditions for cut in cuts), cuts=tuple(cut.name for cut in cuts),
        verdict=sentence, checks=checks, feed_per_tooth=np.array([cut.conditions.feed_per_tooth for cut in cuts]),
        measured_mean=means[0], modelled_mean=means[1], angle=angle,
        measured=force_at(measured, angle), modelled=force_at(predicted, angle),
        measured_amplitude=np.abs(measured), modelled_amplitude=np.abs(predicted),
        residual_rms=rms, r2=r2, alternatives=tuple(alternatives), notices=tuple(dict.fromkeys(notices)),
    )  # fmt: skip


METHODS: dict[str, Callable[..., Coefficients]] = {"average": average_force, "nls": instantaneous}
