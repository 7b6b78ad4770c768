"""What the user must be told of a history: does the law hold, what cannot be known, and what would mend it."""

from collections.abc import Sequence

import numpy as np

from millcal.data import Check, Notice
from millcal.stages.coefficients.trends.problem import DIRECTIONS, CutRecord, Noise, short_name
from millcal.units import to_shop

WARN, REFUSE = 1.10, 1.15  # chi2 of the stiff model: white noise stays below, ignored runout or a low-pass does not
GROSS = 0.5  # of the rms of the force: this is no law that does not quite hold
SMALL_RESIDUAL = 0.1  # of the rms of the force: below, a law that is not exact is still of use
SHAPE_SD, COEFFICIENT_SD = 0.05, 0.10  # above, level and shape are not told apart
UNSEEN = 0.7  # of the prior's sd: the record has said next to nothing
AT_BOUND = 0.05
PHASE_OFF = 0.05  # rad, from the stated phase
RESTLESS_TREND = 60.0  # scale of a trend per record: above, it follows single teeth
LARGE_CHANGE = 2.0
MEANS = 0.05  # of a mean force, by which it may be missed
LINE_SHARE, MOSTLY = 0.1, 0.5  # of the residual's power: a line worth telling, and lines that are most of it
RESTLESS = (0.5, 1.5)  # mean square of normalised innovations that a consistent filter stays within


def check_noise(chi2: float, noise: Noise, residual_share: np.ndarray, hints: Sequence[str]) -> Check:
    """Residuals against the noise.   residual_share : rms of the residual over that of the force, (axis,)"""
    name = "residuals"
    source = {"air": "the air cut", "idle": "the samples between teeth", "residual": "the residuals themselves"}[
        noise.source
    ]
    if noise.source == "residual":
        worst = float(np.max(residual_share))
        message = f"no air cut to tell the noise: the residual is {worst:.1%} of the force and taken for noise"
        good = worst < SMALL_RESIDUAL
        return Check(name, good, message if good or not hints else f"{message}: {'; '.join(hints)}")
    said = f"residuals are {np.sqrt(chi2):.3g} times the noise of {source} (chi2 {chi2:.3g})"
    if chi2 <= REFUSE:
        doubt = "" if chi2 <= WARN else ": a little more than noise; look at the innovations"
        return Check(name, True, said + doubt)
    told = list(hints) or ["look for chatter, a resonance of the dynamometer, a wrong engagement or another law"]
    if np.max(residual_share) > GROSS:
        told = ["first check the direction of the cut, the axis map, its signs and the number of teeth", *told]
    return Check(name, False, f"{said} and {np.max(residual_share):.1%} of the force: {'; '.join(told)}")


def residual_lines(record: CutRecord, residual: np.ndarray, most: int = 3) -> list[str]:
    """Where in frequency the residual is, if it is mostly in a few lines.   residual : (sample, axis) N"""
    n = min(len(residual), 1 << 16)
    rate, spindle = record.cuts[0].sample_rate, record.cuts[0].spindle_frequency
    window = np.hanning(n)[:, np.newaxis]
    power = np.sum(np.abs(np.fft.rfft((residual[:n] - residual[:n].mean(axis=0)) * window, axis=0)) ** 2, axis=1)
    wide = max(1, round(0.25 * spindle * n / rate))  # lines of a quarter of the spindle's frequency to either side
    power[: max(wide, 2)] = 0.0
    if not power.any():
        return []
    rest, told, share = power.copy(), [], 0.0
    for _ in range(most):
        at = int(np.argmax(rest))
        part = float(rest[max(at - wide, 0) : at + wide + 1].sum() / power.sum())
        if part < LINE_SHARE:
            break
        told.append(at * rate / n)
        share += part
        rest[max(at - wide, 0) : at + wide + 1] = 0.0
    if share < MOSTLY:
        return []
    order = [frequency / spindle for frequency in told]
    follows = all(abs(k - round(k)) < 0.1 for k in order)
    what = (
        f"harmonics {', '.join(str(round(k)) for k in order)} of the spindle: a resonance, runout or an engagement the model lacks"
        if follows
        else "not all harmonics of the spindle: chatter or a resonance"
    )
    said = ", ".join(f"{frequency:.0f}" for frequency in told)
    mend = (
        "; a low-pass on the force (lowpass_hz) below them leaves them out"
        if min(order) > 2 * record.cutter.teeth
        else ""
    )
    return [f"{share:.0%} of the residual's power is at {said} Hz, {what}{mend}"]


def check_means(record: CutRecord, modelled: np.ndarray, scored: np.ndarray) -> Check:
    """Mean forces of every cut, which the regression over the feeds goes through, against those of the model.

    modelled : (sample, axis) N   scored : (sample,) bool
    """
    worst, at = 0.0, 0
    for number in range(len(record.cuts)):
        of_cut = scored & (record.cut == number)
        mean = record.force[of_cut].mean(axis=0)
        off = float(np.linalg.norm(mean - modelled[of_cut].mean(axis=0)) / max(np.linalg.norm(mean), 1e-300))
        if off > worst:
            worst, at = off, number
    where = f" ({short_name(record.cuts[at])})" if len(record.cuts) > 1 else ""
    said = f"the mean force is met to {worst:.1%}{where}"
    if worst <= MEANS:
        return Check("mean force", True, said)
    return Check(
        "mean force",
        False,
        f"{said}: these coefficients are not those of a regression of mean forces; an offset of the amplifier, or another law",
    )


def check_separable(record: CutRecord, shape_sd: np.ndarray, relative_sd: np.ndarray) -> Check:
    """Level against shape, at the best known step.   shape_sd, relative_sd : (direction,), of s and of k or K_c"""
    first, second = ("k", "m") if record.law == "kienzle" else ("Kc", "Ke")
    weak = [
        DIRECTIONS[d] for d in range(record.directions) if shape_sd[d] > SHAPE_SD or relative_sd[d] > COEFFICIENT_SD
    ]
    chips = f"{1e6 * record.chips.low:.0f} to {1e6 * record.chips.high:.0f} um"
    if not weak:
        return Check("separable", True, f"{first} and {second} are told apart; chips of {chips}")
    remedy = "cut with a second feed, twice or half as large, more immersion up to a_e/D = 0.5, a smaller axial depth, or longer"
    return Check(
        "separable",
        False,
        f"{first} and {second} are not separable here in {', '.join(weak)} (sd of the shape "
        f"{', '.join(f'{value:.2g}' for value in shape_sd)}): the force is known for chips of {chips} only; {remedy}",
    )


def check_followed(square: np.ndarray, count: np.ndarray) -> Check:
    """Innovations of a filter against what it foretold, in the second half.   square, count : (step, axis), (step,)"""
    late = slice(len(square) // 2, None)
    weight = count[late, np.newaxis]
    mean = np.nansum(square[late] * weight, axis=0) / max(int(weight.sum()), 1)
    said = f"mean square of the normalised innovations {', '.join(f'{value:.2f}' for value in mean)} in the second half, 1 is right"
    if np.max(mean) > RESTLESS[1]:
        return Check(
            "innovations", False, said + ": the filter is surer than it should be, it has collapsed or lags behind"
        )
    if np.max(mean) < RESTLESS[0]:
        return Check("innovations", False, said + ": the noise is taken too large")
    return Check("innovations", True, said)


def check_offset(record: CutRecord) -> Check:
    """Whether an air cut told the offset of the amplifier."""
    without = [short_name(cut) for cut in record.cuts if not cut.air_force.shape[1]]
    if not without:
        return Check("air cut", True, "offset and drift are those of the air cuts")
    return Check(
        "air cut",
        False,
        f"no air cut in {', '.join(without)}: an offset of the amplifier would be taken for edge force or exponent, and the "
        "intervals do not know of it; record half a second of air before and after",
    )


def check_pace(scales: np.ndarray, converged: bool) -> Check:
    """Whether what changes has been a trend.   scales : of the trends, per record"""
    fastest = float(np.max(scales))
    if converged and fastest < RESTLESS_TREND:
        return Check("pace", True, "the coefficients change slowly beside the teeth")
    what = (
        f"the coefficients change as fast as the teeth pass (scale {fastest:.0f})"
        if converged
        else "the fit did not settle"
    )
    return Check("pace", False, f"{what}: runout, a low-pass or an engagement that the model lacks looks like that")


def change_notices(record: CutRecord, level: np.ndarray) -> list[Notice]:
    """Specific forces that change more than wear and chipped edges make them.   level : (step, direction), ln"""
    most = float(np.exp(np.max(np.ptp(level, axis=0))))
    if most < LARGE_CHANGE:
        return []
    message = (
        f"a specific force changes {most:.3g}-fold within the record: engagement that is not as stated looks like that, such as "
        "the ramp of an entry or exit; leave it out by steady_s, or give it in the engagement table"
    )
    return [Notice("large-change", message, "cuts")]


def bound_notices(at_bound: np.ndarray, names: Sequence[str]) -> list[Notice]:
    """Parameters that lie at a bound for long.   at_bound : (step, parameter)"""
    late = at_bound[len(at_bound) // 2 :].mean(axis=0)
    told = [f"{name} ({share:.0%})" for name, share in zip(names, late, strict=True) if share > AT_BOUND]
    if not told:
        return []
    message = (
        f"at a bound in the second half of the record: {', '.join(told)}; widen coefficients.bounds, or doubt the law"
    )
    return [Notice("at-bound", message, "coefficients.bounds")]


def runout_notices(record: CutRecord, sd: np.ndarray, prior_sd: np.ndarray) -> list[Notice]:
    """Components of the runout that the record does not see.   sd, prior_sd : (2,) m"""
    unseen = [
        name
        for name, own, before in zip(("c0", "s0"), sd, prior_sd, strict=True)
        if before > 0 and own > UNSEEN * before
    ]
    if not unseen:
        return []
    before = to_shop(float(np.max(prior_sd)), "x_um")
    message = (
        f"runout {' and '.join(unseen)} cannot be seen: with {record.cutter.teeth} teeth and this helix it hardly changes the "
        f"force, and no more is known of it than beforehand, {before:.0f} um; trust the force, not the runout"
    )
    return [Notice("runout-unseen", message, "cuts", "note")]


def one_feed_notice(record: CutRecord) -> list[Notice]:
    """One feed in all cuts: level and shape come from the shape of the chip alone."""
    feeds = record.passage.feed_per_tooth
    if np.ptp(feeds) > 0.1 * feeds.max():
        return []
    message = (
        "all at one feed: exponent and edge force rest on the chip's course within the engagement; a second feed tells "
        "them better"
    )
    return [Notice("single-feed", message, "cuts", "note")]


def phase_notices(record: CutRecord, phase: np.ndarray) -> list[Notice]:
    """Cuts whose stated spindle phase the force contradicts.   phase : (cut,) rad, what was found beside the stated"""
    told = []
    for cut, off in zip(record.cuts, np.angle(np.exp(1j * phase)), strict=True):
        if cut.angle_from == "stated" and abs(off) > PHASE_OFF:
            message = (
                f"the force says {to_shop(float(off), 'x_deg'):+.1f} deg against the stated spindle phase; the runout's angle "
                "counts from where the force has it, check spindle_phase_deg"
            )
            told.append(Notice("phase-off", message, cut.name))
    return told


def conclude(checks: Sequence[Check], residual_share: np.ndarray) -> str:
    """The verdict."""
    failed = {check.name: check for check in checks if not check.passed}
    if "residuals" in failed:
        reason = failed["residuals"].message
        if np.max(residual_share) < SMALL_RESIDUAL:
            return f"fits in part: {reason}"
        return f"does not fit: {reason}"
    for name in ("pace", "mean force", "innovations", "air cut", "separable"):
        if name in failed:
            return f"fits in part: {failed[name].message}"
    return "fits"
