"""`method = nls`: the fit of the force within the revolution, judged by what it says of cuts it has not seen."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import Check, Coefficients, CutForce, Frf, Notice, Posterior
from millcal.errors import IllPosedError
from millcal.numerics.jackknife import student_quantile
from millcal.stages.coefficients import average, verdict
from millcal.stages.coefficients.answer import NO_AIR_CUT, Alternative, alternative, answer
from millcal.stages.coefficients.harmonic import (
    HarmonicStudy,
    left_out_covariance,
    parameters,
    predict,
    ratio,
    search_near,
    study,
)
from millcal.stages.coefficients.harmonic_model import (
    condition,
    model_of,
    modelled_harmonics,
    noise_covariance,
    refine,
    seen_coefficients,
)
from millcal.stages.coefficients.resonance import diagnose
from millcal.stages.coefficients.sensor import interpolated_sensor, sensor_covariance, within_reach

LAW_NAMES = {
    "linear-edge": (average.NAMES, average.UNITS),
    "kienzle": (("kt", "kr", "ka"), ("N/m^2",) * 3),
}
SHAPE_UNITS = {"c0": "m", "s0": "m", "t0": "m", "mt": "1", "mr": "1", "ma": "1"}


def instantaneous(
    cuts: tuple[CutForce, ...],
    *,
    law: str,
    taper: bool,
    harmonics: int | None,
    mean_weight: float,
    sensor: Frf | None,
) -> Coefficients:
    """The fit, its intervals, its checks and what other models say; options as in `fit_coefficients`."""
    teeth = cuts[0].cutter.teeth
    if taper and teeth == 1:
        raise IllPosedError("coefficients.taper: one tooth has no runout to taper; leave it out")
    gain, of_sensor = None, []
    if sensor is not None:
        gain = interpolated_sensor(sensor)
        cuts, harmonics, of_sensor = within_reach(sensor, cuts, harmonics)
    saved = min(cut.harmonics.shape[1] for cut in cuts) - 1
    band = min(saved, harmonics if harmonics is not None else max(teeth, 2))
    if band < 1:
        raise IllPosedError(f"coefficients.harmonics: {band} leaves no force within the revolution; use 1 or more")
    model = model_of(cuts, law=law, band=band, mean_weight=mean_weight, taper=taper, sensor=gain)
    found = study(model)
    best = found.best
    posterior, notices = _posterior(found, law, sensor)
    notices += _what_is_not_seen(found, posterior.names)
    notices += of_sensor
    if not any(cut.air for cut in cuts):
        notices.append(NO_AIR_CUT)

    checks = [
        verdict.check_asynchronous(cuts),
        verdict.check_contact(cuts, _tooth_offsets(found)),
        verdict.check_prediction(found),
    ]
    alternatives: list[Alternative] = []
    if saved > band:
        checks.append(verdict.check_above_tooth_passing(found, saved))
        if not checks[-1].passed and (diagnosis := diagnose(found, saved)):
            checks.append(diagnosis[0])
            alternatives.append(diagnosis[1])
    feeds = [cut.conditions.feed_per_tooth for cut in cuts]
    if law == "linear-edge" and found.left_out and np.ptp(feeds) > 0.02 * max(feeds):
        more_checks, others = _other_models(found, saved, sensor)
        checks += more_checks
        alternatives = others + alternatives
        of_map = average.axis_map_notices(cuts, average.mean_forces(cuts, "whole-revolutions"))
        checks.append(verdict.check_axis_map(of_map))
        notices += of_map

    modelled = [modelled_harmonics(best, cut, phase, saved) for cut, phase in zip(cuts, best.phase, strict=True)]
    unseen = [predict(fit, cut, saved) for fit, cut in zip(found.left_out, cuts, strict=False)]
    in_wide, _ = ratio(cuts, modelled, saved)
    left = np.stack([cut.harmonics[:, 1 : saved + 1] - m[:, 1:] for cut, m in zip(cuts, modelled, strict=True)])
    return answer(
        cuts,
        posterior,
        verdict.conclude(checks, found.predicted),
        checks,
        modelled=modelled,
        means=(average.mean_forces(cuts, "whole-revolutions"), np.stack([value[:, 0].real for value in modelled])),
        residual_rms=np.sqrt(np.mean(np.sum(np.abs(left) ** 2, axis=2) / 2, axis=0)),
        r2=1 - in_wide**2,
        alternatives=alternatives,
        notices=notices,
        in_sample=found.in_sample,
        left_out=found.predicted,
        left_out_by_cut=found.predicted_by_cut,
        in_sample_wide=in_wide,
        left_out_wide=ratio(cuts, unseen, saved)[0] if unseen else None,
        phase=best.phase % (2 * np.pi),
        band=(0, band),
    )


def _posterior(found: HarmonicStudy, law: str, sensor: Frf | None = None) -> tuple[Posterior, list[Notice]]:
    """Jackknife over the cuts where there are three; else the noise within the records, with a warning.

    The noise of the sensor's FRF, which no comparison of cuts can show, comes on top.
    """
    best = found.best
    names, units = LAW_NAMES[law]
    n = len(best.model.cuts)
    notices = []
    if found.left_out:
        covariance, dof = left_out_covariance(found), n - 1.0
    else:
        covariance, dof = noise_covariance(best), np.inf
        message = (
            f"{n} cut{'s' if n > 1 else ''}: intervals are from the noise within the records alone, 10 to 40 times "
            "narrower than the scatter of cuts; add cuts to have three or more"
        )
        notices.append(Notice("narrow-intervals", message, "cuts"))
    if sensor is not None:
        covariance = covariance + sensor_covariance(best, sensor)
    mean = parameters(best)
    half = student_quantile(dof) * np.sqrt(np.diag(covariance))
    posterior = Posterior(
        names=(*names, *best.model.shape_names),
        units=(*units, *(SHAPE_UNITS[name] for name in best.model.shape_names)),
        mean=mean,
        covariance=covariance,
        interval=np.stack([mean - half, mean + half], axis=1),
        law=law,  # type: ignore[arg-type]
        method="nls",
        dof=dof,
    )
    return posterior, notices


def _other_models(found: HarmonicStudy, saved: int, sensor: Frf | None) -> tuple[list[Check], list[Alternative]]:
    """What mean forces alone, alternating force alone and all harmonics say, and whether they agree."""
    best = found.best
    model, cuts = best.model, best.model.cuts
    names = (*average.NAMES, *model.shape_names)
    forces = average.mean_forces(cuts, "whole-revolutions")
    plain, teeth = average.solve_means(cuts, forces, 0.0), cuts[0].cutter.teeth
    means, loss = average.search_contact_loss(cuts, forces) if teeth > 1 else (plain, average.NO_CONTACT_LOSS)
    ktc = {"this fit": float(best.linear[0]), "mean forces": float((means if loss.explains else plain).coefficients[0])}
    checks = [verdict.check_means(cuts, plain, loss)]
    alternatives = []
    alternating = replace(model, mean_weight=0.0)
    seen = seen_coefficients(replace(best, model=alternating), np.abs(best.linear))
    if seen[0] and seen[3]:
        ac_only = study(alternating, search_near(alternating, best))
        of_sensor = None if sensor is None else np.sqrt(np.diag(sensor_covariance(ac_only.best, sensor))[[0, 3]])
        checks.append(verdict.check_means_against_ac(found, ac_only, of_sensor))
        of_ac = dict(zip(names, parameters(ac_only.best), strict=True))
        hidden = [name for name, known in zip(average.NAMES, seen, strict=True) if not known]
        shown = {name: value for name, value in of_ac.items() if name not in hidden}
        alternatives.append(alternative("alternating force alone", shown))
    else:
        checks.append(verdict.ALTERNATING_IS_BLIND)
    alternatives.append(alternative("mean forces", dict(zip(average.NAMES, plain.coefficients, strict=True))))
    if loss.explains:
        named = dict(zip(average.NAMES, means.coefficients, strict=True)) | {"c0": loss.runout}
        alternatives.append(alternative("mean forces with contact loss", named))
    if saved > model.band:
        wide = refine(replace(best, model=replace(model, band=saved, mean_weight=1.0)))
        ktc["all harmonics"] = float(wide.linear[0])
        alternatives.append(alternative(f"harmonics to {saved}", dict(zip(names, parameters(wide), strict=True))))
    checks.append(verdict.check_spread(ktc))
    return checks, alternatives


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
        message = (
            f"the data hardly tell {' and '.join(large) or 'the phases'} apart (condition number {number:.0e}); "
            "hold one, or add feeds"
        )
        notices.append(Notice("unobservable", message, "cuts"))
    teeth = found.best.model.cuts[0].cutter.teeth
    if teeth == 2 and "s0" not in names:
        message = "two teeth show c0 = rho cos(lambda) at mid depth only; rho and lambda cannot be told apart"
        notices.append(Notice("runout-combination", message, "cutter", "note"))
    elif teeth > 1 and found.best.model.cuts[0].cutter.pitch is None and not found.best.model.common_phase:
        message = f"teeth carry no label: the phase, and with it lambda, is known up to multiples of 360/{teeth} deg"
        notices.append(Notice("tooth-label", message, "cutter", "note"))
    best = found.best
    for rival in found.rivals:
        if rival.cost < 1.1 * best.cost and abs(rival.linear[0] - best.linear[0]) > 0.15 * abs(best.linear[0]):
            message = (
                f"a second minimum fits nearly as well ({rival.cost / best.cost:.2f} of the cost) with "
                f"{names[0]} = {rival.linear[0] / 1e6:.0f} N/mm2"
            )
            notices.append(Notice("several-minima", message, "cuts"))
            break
    return notices
