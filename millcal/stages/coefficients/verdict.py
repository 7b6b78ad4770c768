"""Whether an instantaneous fit may be believed: the checks, and the sentence they add up to.

`fits`: every check passed. `fits in part`: the cuts left out are predicted to 35 % and at most one other check failed; the
coefficients are provisional. `does not fit` otherwise, with the failed checks in the order in which they should be looked
at: what is no cutting force at all first, what is a matter of the law last. The thresholds are judgement from one real data
set and from synthetic cuts; they stand here together.
"""

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from millcal.data import AXES, Check, CutForce, Notice
from millcal.numerics.jackknife import jackknife_covariance, student_quantile
from millcal.numerics.separable_least_squares import solve_linear
from millcal.stages.coefficients.average import (
    ContactLoss,
    MeanForceFit,
    lack_of_fit,
    mean_forces,
)
from millcal.stages.coefficients.harmonic import HarmonicStudy
from millcal.stages.coefficients.harmonic_model import HarmonicFit, modelled_harmonics, unit_force

PREDICTION = np.array([0.15, 0.15, 0.25])  # residual / AC rms of a cut left out, x y z
PROVISIONAL = 0.35
ASYNCHRONOUS = 0.02  # share of the AC power of the axis
ASYNCHRONOUS_FORCE = 0.05  # and share of the AC force of the loudest axis: less is a sensor's noise on a quiet axis
SPREAD_OF_MODELS = 0.15  # of Ktc
BENT_OF_NOISE = 3.0  # misfit of the means over the noise of the means, in rms
ABOVE_TOOTH_PASSING = 1.5  # measured over predicted

# what a failed check says in the verdict
REASONS = {
    "asynchronous": "force that does not follow the spindle (chatter or drift)",
    "contact-loss": "teeth lose contact by runout",
    "untested": "too few cuts to test it",
    "left-out": "cuts left out are not predicted",
    "above-tooth-passing": "harmonics above the tooth passing exceed the prediction",
    "resonance": "a resonance does not explain it",
    "mean-force": "mean forces do not lie on a line",
    "offset": "alternating and mean forces contradict each other",
    "models": "Ktc depends on the model",
    "axis-map": "signs or sizes of the coefficients speak against the axis map",
    "line": "R2 of the mean forces is below 0.9",
}


def _list(found: Sequence[str]) -> str:
    return ", ".join(found)


def short_name(cut: CutForce) -> str:
    """The recording's name without folder and ending."""
    return PurePath(cut.name).stem


def check_asynchronous(cuts: Sequence[CutForce]) -> Check:
    """Chatter, drift or another machine: force that does not follow the spindle."""
    share = np.array([1 - cut.synchronous_share for cut in cuts])
    rest = np.array([cut.asynchronous_rms / max(cut.ac_rms.max(), 1e-300) for cut in cuts])
    loud = [
        f"{short_name(cut)} {AXES[i]} {100 * share[f, i]:.1f} %"
        for f, cut in enumerate(cuts)
        for i in range(3)
        if share[f, i] > ASYNCHRONOUS and rest[f, i] > ASYNCHRONOUS_FORCE
    ]
    message = f"{100 * share.max():.1f} % of the AC power at most does not follow the spindle"
    if loud:
        message = (
            f"force that does not follow the spindle (chatter, drift) exceeds {100 * ASYNCHRONOUS:.0f} %: {_list(loud)}"
        )
    return Check("asynchronous", not loud, message)


def check_contact(cuts: Sequence[CutForce], runout: np.ndarray, share: float = 0.5) -> Check:
    """Whether runout takes a tooth out of the cut: the largest step between neighbours against the smallest feed.

    runout : radial offset of every tooth, (tooth,) m   share : of the smallest feed that is too much
    """
    feed = min(cut.conditions.feed_per_tooth for cut in cuts)
    step = float(np.max(np.abs(runout - np.roll(runout, 1)))) if len(runout) > 1 else 0.0
    message = (
        f"teeth differ by {step * 1e6:.1f} um between neighbours; the smallest feed per tooth is {feed * 1e6:.0f} um"
    )
    if step > share * feed:
        message += "; contact is lost" + (" for whole revolutions" if step >= feed else " for part of the engagement")
    return Check("contact-loss", step <= share * feed, message)


def check_above_tooth_passing(found: HarmonicStudy, saved: int) -> Check:
    """Harmonics of the tooth passing above the band of the fit: as the law predicts, or an excess, and of which kind.

    An excess that grows with the feed is a transient of entry and exit (or a law that is wrong there); one that sits near one
    frequency is a resonance.
    """
    fit = found.best
    cuts, teeth = fit.model.cuts, fit.model.cuts[0].cutter.teeth
    orders = [k for k in range(teeth, saved + 1, teeth) if k > max(teeth, fit.model.band)][:3]
    if not orders:
        return Check("above-tooth-passing", True, "no harmonics above the band of the fit to compare")
    measured = np.abs([cut.harmonics[:2, orders] for cut in cuts])
    modelled = np.abs(
        [modelled_harmonics(fit, c, p, max(orders))[:2, orders] for c, p in zip(cuts, fit.phase, strict=True)]
    )
    noise = np.sqrt([cut.harmonics_variance[:2, orders] for cut in cuts])
    ac = np.array([np.sqrt(np.sum(np.abs(cut.harmonics[:2, 1:]) ** 2, axis=1) / 2) for cut in cuts])[:, :, np.newaxis]
    excess = (measured > ABOVE_TOOTH_PASSING * modelled + 3 * noise) & (measured > 0.05 * ac)
    if not excess.any():
        return Check("above-tooth-passing", True, f"harmonics {_list([str(k) for k in orders])} are as predicted")
    feeds = np.array([cut.conditions.feed_per_tooth for cut in cuts])
    ratio = measured[excess] / np.maximum(modelled[excess], 1e-12)
    hit = [orders[i] for i in np.flatnonzero(excess.any(axis=(0, 1)))]
    growth = [
        np.corrcoef(feeds, measured[:, axis, i])[0, 1]
        for axis in range(2)
        for i in range(len(orders))
        if excess[:, axis, i].sum() > 1
    ]
    kind = (
        "and grow with the feed: a transient at entry and exit, not a resonance"
        if growth and np.mean(growth) > 0.7
        else (
            "near one frequency: a resonance of tool, workpiece or dynamometer"
            if len(hit) == 1
            else "at no steady feed dependence"
        )
    )
    message = f"harmonics {_list([str(k) for k in hit])} are {ratio.min():.1f} to {ratio.max():.1f} times the prediction, {kind}"
    return Check("above-tooth-passing", False, message)


def check_prediction(found: HarmonicStudy) -> Check:
    """The cut left out, predicted from the others."""
    if found.predicted is None:
        return Check("untested", False, "fewer than three cuts: none can be left out, so nothing speaks for the model")
    values = _list([f"{axis} {value:.2f}" for axis, value in zip(AXES, found.predicted, strict=True)])
    limits = f"(limits {PREDICTION[0]:.2f} in x, y and {PREDICTION[2]:.2f} in z)"
    return Check(
        "left-out",
        bool(np.all(found.predicted <= PREDICTION)),
        f"residual over AC force of cuts left out: {values} {limits}",
    )


def check_means(cuts: Sequence[CutForce], plain: MeanForceFit, loss: ContactLoss) -> Check:
    """The straight line of the mean forces against their noise, or explained by contact loss."""
    misfit = np.sqrt(np.maximum(lack_of_fit(cuts, plain.residual), 0.0))
    # one per cent of the force is no misfit, however quiet the record: amplifiers drift by as much between cuts
    small = np.abs(plain.residual).max(axis=0) < 0.01 * np.abs(mean_forces(cuts, "whole-revolutions")).max()
    bent = np.where(small, 0.0, misfit)
    values = _list([f"{axis} {value:.1f}" for axis, value in zip(AXES, misfit, strict=True)])
    if np.all(bent <= BENT_OF_NOISE):
        return Check("mean-force", True, f"mean forces lie on the line: misfit over noise {values}")
    if loss.explains:
        rest = f"sum of squares falls to {loss.ratio:.2f} with c0 = {loss.runout * 1e6:.0f} um (F = {loss.f_value:.0f})"
        return Check(
            "mean-force", True, f"mean forces bend (misfit over noise {values}), explained by contact loss: {rest}"
        )
    return Check(
        "mean-force",
        False,
        f"mean forces do not lie on a line: misfit over noise {values}, not explained by contact loss",
    )


def check_axis_map(notices: Sequence[Notice]) -> Check:
    """What `axis_map_notices` found, as a check."""
    if notices:
        return Check("axis-map", False, notices[0].message)
    return Check("axis-map", True, "signs and sizes are those of a right axis map")


def check_scatter(n_cuts: int) -> Check:
    """Whether anything tests the line: two cuts lie on any line."""
    if n_cuts < 3:
        return Check("untested", False, "two cuts leave no scatter, so nothing speaks for or against the line")
    return Check("untested", True, f"{n_cuts} cuts test the line")


# in a slot with three teeth or more the chip's force stands still, and the alternating force says nothing of Ktc
ALTERNATING_IS_BLIND = Check(
    "offset", True, "not tested: the alternating force alone does not determine Ktc and Kte here"
)


def check_means_against_ac(whole: HarmonicStudy, ac_only: HarmonicStudy, sensor_sd: np.ndarray | None = None) -> Check:
    """Coefficients of the means alone against those of the alternating force alone, under the runout of the fit.

    The difference is formed for every set of cuts with one left out, and its jackknife deviation judges it; the tangential
    pair Ktc, Kte at 95 % together (Bonferroni). An offset of the amplifier, or a law that is wrong, makes them disagree.

    sensor_sd : what the noise of a sensor's FRF adds to Ktc and Kte of the alternating force, the same in every set, (2,)
    """
    model, cuts = whole.best.model, whole.best.model.cuts
    forces = mean_forces(cuts, "whole-revolutions")
    pair = [0, 3]

    def difference(keep: np.ndarray, fit: HarmonicFit) -> np.ndarray:
        matrix = np.concatenate([unit_force(model, cuts[i], whole.best.shape, 0)[:, :, 0].real for i in keep])
        return (fit.linear - solve_linear(matrix, forces[keep].ravel()))[pair]

    every = np.arange(len(cuts))
    gap = difference(every, ac_only.best)
    without = np.stack([difference(np.delete(every, i), fit) for i, fit in enumerate(ac_only.left_out)])
    spread = np.sqrt(np.diag(jackknife_covariance(without)))
    if sensor_sd is not None:
        spread = np.hypot(spread, sensor_sd)
    # two per cent is no contradiction, however quiet the record
    limit = np.maximum(student_quantile(len(cuts) - 1, 1 - 0.05 / 2) * spread, 0.02 * np.abs(whole.best.linear[pair]))
    ac, share = ac_only.best.linear[pair], np.abs(gap) / limit
    means = ac - gap
    told = (
        f"Ktc {ac[0] / 1e6:.3g} against {means[0] / 1e6:.3g} N/mm2 ({share[0]:.1f} of what may be), "
        f"Kte {ac[1] / 1e3:.3g} against {means[1] / 1e3:.3g} N/mm ({share[1]:.1f} of what may be)"
    )
    if np.all(share <= 1):
        return Check("offset", True, f"alternating and mean forces give one answer: {told}")
    message = f"alternating and mean forces contradict each other (offset, or a law that is wrong): {told}"
    return Check("offset", False, message)


def check_spread(values: dict[str, float]) -> Check:
    """How far Ktc moves from model to model.   values : model -> Ktc, N/m^2"""
    low, high = min(values.values()), max(values.values())
    spread = (high - low) / max(abs(np.mean(list(values.values()))), 1e-300)
    message = f"Ktc over models: {_list([f'{name} {value / 1e6:.0f}' for name, value in values.items()])} N/mm2"
    return Check("models", bool(spread <= SPREAD_OF_MODELS), f"{message}, a spread of {100 * spread:.0f} %")


def conclude(checks: Sequence[Check], predicted: np.ndarray | None) -> str:
    """The verdict that the checks add up to."""
    failed = [check for check in checks if not check.passed]
    if not failed:
        return "fits"
    others = [check for check in failed if check.name not in ("left-out", "resonance")]  # the last only explains
    reasons = "; ".join(REASONS[check.name] for check in failed)
    if (predicted is None or np.all(predicted <= PROVISIONAL)) and len(others) <= 1:
        return f"fits in part: {reasons}"
    return f"does not fit: {reasons}"


def mean_force_verdict(fit: MeanForceFit, checks: Sequence[Check]) -> str:
    """The verdict on an average-force regression: what its own checks say."""
    failed = [check for check in checks if not check.passed]
    if not failed:
        return "fits"
    reasons = "; ".join(REASONS[check.name] for check in failed)
    half = np.diff(fit.interval, axis=1)[0, 0] / 2
    sure = not np.isfinite(half) or half < 0.25 * abs(fit.coefficients[0])
    return f"{'fits in part' if sure and len(failed) == 1 else 'does not fit'}: {reasons}"
