"""`method = average`: the regression of mean forces, with contact loss looked for and the axis map questioned."""

from dataclasses import replace

import numpy as np

from millcal.data import Check, Coefficients, CutForce, Notice
from millcal.errors import IllPosedError, RecipeError
from millcal.stages.coefficients import average, verdict
from millcal.stages.coefficients.answer import NO_AIR_CUT, alternative, answer
from millcal.stages.coefficients.harmonic import predict, runout_of_line
from millcal.stages.coefficients.harmonic_model import HarmonicFit, model_of


def average_force(cuts: tuple[CutForce, ...], *, law: str, rows: str, contact_loss: str) -> Coefficients:
    """The regression of mean forces, with contact loss looked for and the axis map questioned."""
    if law != "linear-edge":
        raise RecipeError(f"coefficients.law: mean forces give the linear-edge law only, not {law!r}; use method nls")
    if rows not in ("whole-revolutions", "all"):
        raise RecipeError(f"coefficients.rows: {rows!r} is unknown; choose whole-revolutions or all")
    if contact_loss not in ("report", "fit", "off"):
        raise RecipeError(f"coefficients.contact_loss: {contact_loss!r} is unknown; choose report, fit or off")
    average.check_feeds(cuts)
    forces = average.mean_forces(cuts, rows)
    plain = average.solve_means(cuts, forces, 0.0)
    of_map = average.axis_map_notices(cuts, forces)
    notices = [*of_map, *average.curvature_notice(forces, plain.residual, cuts)]
    with_loss, loss = plain, average.NO_CONTACT_LOSS
    looked = contact_loss != "off" and cuts[0].cutter.teeth > 1 and len(cuts) > 2
    if contact_loss == "fit" and not looked:
        raise IllPosedError(
            f"coefficients.contact_loss: 'fit' needs two teeth and three cuts at least, not {cuts[0].cutter.teeth} and "
            f"{len(cuts)}; use report"
        )
    if looked:
        with_loss, loss = average.search_contact_loss(cuts, forces)
    chosen = with_loss if contact_loss == "fit" else plain
    alternatives = []
    if loss.explains and contact_loss == "report":
        named = dict(zip(average.NAMES, with_loss.coefficients, strict=True)) | {"c0": loss.runout}
        alternatives.append(alternative("with contact loss", named))
        message = (
            f"runout of c0 = {loss.runout * 1e6:.0f} um takes a tooth out of the cut at the small feeds and explains the "
            f"bend of the means (sum of squares falls to {loss.ratio:.2f}, F = {loss.f_value:.0f}); the straight line is "
            f"biased: Ktc {with_loss.coefficients[0] / 1e6:.0f} instead of {plain.coefficients[0] / 1e6:.0f} N/mm2; "
            "contact_loss = fit takes it into the answer"
        )
        notices.append(Notice("contact-loss", message, "cuts"))
    if not any(cut.air for cut in cuts):
        notices.append(NO_AIR_CUT)
    if len(cuts) == 2:
        notices.append(
            Notice("two-cuts", "two cuts leave no scatter: no interval can be given; add a third feed", "cuts")
        )
    r2 = average.r_squared(forces, chosen.residual)
    steady = np.abs(chosen.residual).max(axis=0) < 0.01 * np.abs(forces).max()  # a flat axis has no R2 to speak of
    checks = (
        verdict.check_axis_map(of_map),
        verdict.check_scatter(len(cuts)),
        verdict.check_means(cuts, plain, loss),
        _contact(cuts, chosen, loss, looked=looked),
        Check(
            "line", bool(np.all((r2 > 0.9) | steady)), f"R2 of the means x, y, z: {', '.join(f'{v:.4f}' for v in r2)}"
        ),
    )
    return answer(
        cuts,
        average.posterior_of(chosen),
        verdict.mean_force_verdict(chosen, checks),
        checks,
        modelled=_mean_force_curves(cuts, chosen),
        means=(forces, chosen.modelled),
        residual_rms=np.sqrt(np.mean(chosen.residual**2, axis=0)),
        r2=r2,
        alternatives=alternatives,
        notices=notices,
    )


def _contact(
    cuts: tuple[CutForce, ...], fit: average.MeanForceFit, loss: average.ContactLoss, *, looked: bool
) -> Check:
    """Whether teeth lose contact: as the fit found, as the means say, or as the once-per-revolution line betrays."""
    lag = cuts[0].cutter.tooth_lag()
    if fit.runout > 0:
        return verdict.check_contact(cuts, fit.runout * np.cos(lag))
    if loss.explains:
        size = f"c0 = {loss.runout * 1e6:.0f} um, F = {loss.f_value:.0f}"
        return Check("contact-loss", False, f"teeth lose contact by runout ({size}), which biases the straight line")
    if cuts[0].cutter.teeth == 1 or cuts[0].cutter.pitch is not None:
        return Check("contact-loss", True, "not tested: one tooth, or unequal pitch, hides runout in the mean force")
    model = model_of(cuts, law="linear-edge", band=1, mean_weight=1.0)
    offsets = runout_of_line(model, fit.coefficients) * np.cos(lag)
    # the straight line knows nothing of contact: a fifth of the feed takes 6 % of the edge force of two teeth away
    found = verdict.check_contact(cuts, offsets, share=0.2)
    by = "the mean forces and the once-per-revolution line" if looked else "the once-per-revolution line"
    return Check("contact-loss", found.passed, f"{found.message} (by {by})")


def _mean_force_curves(cuts: tuple[CutForce, ...], fit: average.MeanForceFit) -> list[np.ndarray]:
    """The force over the revolution that mean-force coefficients imply; only each record's phase is taken from it."""
    band = min(cut.harmonics.shape[1] for cut in cuts) - 1
    model = model_of(cuts, law="linear-edge", band=band, mean_weight=1.0)
    shape = np.array([fit.runout, *[0.0] * (len(model.runout_names) - 1)]) if model.runout_names else np.zeros(0)
    model = replace(
        model, common_phase=False
    )  # a pulse tells the angle up to its own mounting, which nobody fitted here
    held = HarmonicFit(model, shape, np.zeros(0), np.zeros(len(cuts)), fit.coefficients, np.inf)
    return [predict(held, cut, band) for cut in cuts]
