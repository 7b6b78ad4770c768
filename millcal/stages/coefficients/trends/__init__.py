"""Coefficients that change while cutting, followed through recorded cuts, with bands, jumps, checks and a verdict.

`smooth` looks into the future of a file and is the best that is known for it; `imm` goes through it in the order of time, as
a monitor at the machine would; `rls`, `enkf` and `enkf-inflated` are the methods of the papers. All see the same
problem (`problem`), begin alike (`start`) and answer alike (`answer`).
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from millcal.data import CoefficientHistory, CutSamples, Notice
from millcal.errors import IllPosedError, RecipeError
from millcal.numerics.smoothing import jump_sizes
from millcal.numerics.whitening import Autoregression
from millcal.physics.sampled_force import coefficients_of
from millcal.stages.coefficients.trends import judge
from millcal.stages.coefficients.trends.answer import (
    Course,
    history,
    jumps_of,
    parameters_over_time,
    step_edges,
)
from millcal.stages.coefficients.trends.filters import (
    FILTERS,
    Begin,
    bounds_by_direction,
    corner_parameters,
    limits_of,
)
from millcal.stages.coefficients.trends.hints import beyond_noise, find_hints
from millcal.stages.coefficients.trends.offset import offset_spread
from millcal.stages.coefficients.trends.problem import LAWS, CutRecord, Noise, cut_record, noise_of, used_samples
from millcal.stages.coefficients.trends.smooth import correlation_time, samples_per_pass, smooth_cut, wear_of
from millcal.stages.coefficients.trends.start import Start, find_start, prior_of, winds
from millcal.units import to_shop

METHODS = ("smooth", "imm", "rls", "enkf", "enkf-inflated")

Progress = Callable[[float, str], None]


def follow_coefficients(
    cuts: Sequence[CutSamples],
    *,
    method: str = "smooth",
    law: str = "kienzle",
    runout: str = "fit",
    lowpass: float | None = None,
    lowpass_order: int = 2,
    smoothing: float | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    chip_threshold: float = 0.5e-6,
    jumps: bool = True,
    forgetting: float = 0.98,
    members: int = 100,
    inflate_every: int = 50,
    inflated_share: float = 0.1,
    inflation: float = 10.0,
    nodes: int = 8,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> CoefficientHistory:
    """Coefficients over time from cuts of one cutter.

    method : one of METHODS   law : kienzle or linear-edge
    runout : fit, or known (the cutter's own, also where that is none)
    lowpass, lowpass_order : Butterworth low-pass of the force chain, Hz, which is put into the model; None: there is none
    smoothing : corner of a low-pass that both the force and the model go through, Hz, to leave out what lies above: resonances
        of the dynamometer, chatter; None: none
    bounds : coefficient -> low, high, SI, what is known beforehand; both of a direction or neither
    chip_threshold : mean chip over the axial depth below which a sample says nothing, m
    jumps : look for sudden changes (smooth, imm)   forgetting : rho per sample (rls)
    members, inflate_every, inflated_share, inflation : size of the ensemble, updates between two inflations, share of the
        members that is drawn anew, and by what the first covariance is divided for that (enkf, enkf-inflated)
    nodes : Gauss nodes along each edge in contact   progress : called with (share, label)

    Raises
    ------
    RecipeError
        An option is unknown or out of range.
    IllPosedError
        The cuts cannot be followed.
    """
    for name, value, known in (
        ("method", method, METHODS),
        ("law", law, LAWS),
        ("runout", runout, ("fit", "known")),
    ):
        if value not in known:
            raise RecipeError(f"coefficients.{name}: {value!r} is unknown; choose one of {', '.join(known)}")
    if not 0 < forgetting <= 1:
        raise RecipeError(
            f"coefficients.forgetting: {forgetting:g} is not in (0, 1]; 0.98 forgets over some 50 samples"
        )
    for name, number, least in (
        ("members", members, 10),
        ("inflate_every", inflate_every, 1),
        ("inflation", inflation, 1),
        ("nodes", nodes, 2),
        ("chain_lowpass_order", lowpass_order, 1),
    ):
        if number < least:
            raise RecipeError(f"coefficients.{name}: {number:g} is below {least}; raise it")
    if not cuts:
        raise IllPosedError("cuts: there are none; name at least one recording of a cut")
    tell = progress or (lambda share, label: None)

    tell(0.0, "start")
    record = cut_record(cuts, law=law, lowpass=lowpass, lowpass_order=lowpass_order, smoothing=smoothing, nodes=nodes)
    bounds_by_direction(record, bounds)  # refused before anything is fitted
    noise = noise_of(record, np.full(len(record.force), np.nan))
    own = cuts[0].cutter
    known = (
        (own.runout * np.cos(own.runout_angle), own.runout * np.sin(own.runout_angle))
        if runout == "known"
        else (0.0, 0.0)
    )
    fitted = runout == "fit" and own.teeth > 1
    start = find_start(record, None if noise is None else noise.sd, runout=fitted, known=known)
    noise = noise or noise_of(start.record, start.record.contact(start.phase, start.runout))
    if fitted and not winds(record) and (noise is None or beyond_noise(start, noise) > judge.REFUSE):
        start = find_start(record, None if noise is None else noise.sd, runout=True, known=known, only_c0=True)
    record = start.record
    chip = record.contact(start.phase, start.runout)
    notices = [*record.notices, *(notice for cut in cuts for notice in cut.notices)]
    if noise is None:
        noise = _noise_of_residual(start)
        notices.append(
            Notice("no-air-cut", "neither air cut nor a sample between teeth tells the noise: the residuals do, and edge "
                   "forces absorb the amplifier's offset", "cuts")
        )  # fmt: skip
    used = used_samples(record, chip, chip_threshold, noise.order)
    if used.sum() < 20 * record.parameters:
        raise IllPosedError(
            f"cuts: {int(used.sum())} samples with a chip are too few for {record.parameters} parameters; give a longer cut"
            + ("" if record.every == 1 else ", or a higher conditioning.lowpass_hz")
        )
    beyond = beyond_noise(start, noise)
    hints = find_hints(record, start, noise, beyond, runout=fitted, lowpass=lowpass, smoothing=smoothing)
    holds = beyond <= judge.REFUSE and noise.source != "residual"
    followed = fitted and holds
    prior = _prior(record, start, bounds, runout=followed, phase=holds)
    if not holds:
        notices.append(
            Notice(
                "runout-held",
                "the law does not hold to the noise: runout and spindle phase stay as the first revolutions say",
                "cuts",
                "note",
            )
        )

    if method == "smooth":
        found = _smoothed(record, noise, used, start, prior, beyond, jumps, rng, tell)
    else:
        found = _filtered(
            record, noise, used, start, prior, bounds, method, followed, rng, tell,
            forgetting=forgetting, members=members, jumps=jumps,
            inflation=(inflate_every, inflated_share, 1 / inflation) if method == "enkf-inflated" else None,
        )  # fmt: skip
    course, phase, chi2, more = found
    unsure = offset_spread(record, noise, used, _by_cut(record, course, phase), prior[1])
    course = course._replace(covariance=course.covariance + unsure[record.cut[course.at]])
    over_time = parameters_over_time(record, course, phase, hold="nearest" if method == "smooth" else "before")
    modelled = record.response(over_time, slopes=False)[0]
    scored = record.settled(record.memory)
    share = np.sqrt(
        np.mean((record.force - modelled)[scored] ** 2, axis=0)
        / np.maximum(np.mean(record.force[scored] ** 2, axis=0), 1e-300)
    )
    loud = np.sqrt(np.mean(record.force[scored] ** 2, axis=0))
    share = share * loud / loud.max()  # a quiet axis may be all noise
    values, slopes = coefficients_of(course.mean, record.law, record.reference_chip)
    sd = np.sqrt(np.diagonal(course.covariance, axis1=1, axis2=2))
    D = record.directions
    of_first = np.sqrt(np.einsum("scp,spq,scq->sc", slopes, course.covariance, slopes))[:, :D] / np.abs(values[:, :D])
    hints += judge.residual_lines(record, (record.force - modelled)[scored])
    if method != "smooth":  # innovations say whether the filter knows its errors, residuals whether the law holds
        late = np.flatnonzero(used)[used.sum() // 2 :]
        chi2 = max(chi2, float(np.mean(((record.force - modelled)[late] / noise.sd) ** 2)))
    checks = [
        judge.check_noise(chi2, noise, share, hints),
        judge.check_means(record, modelled, scored),
        judge.check_separable(record, np.min(sd[:, 1 : 2 * D : 2], axis=0), np.min(of_first, axis=0)),
    ]
    if method != "smooth":
        checks.append(judge.check_followed(course.innovation_square, course.count))
    checks += [*more.pop("checks", []), judge.check_offset(record)]
    notices += judge.change_notices(
        record, course.mean[len(course.mean) // 20 if method != "smooth" else 0 :, 0 : 2 * D : 2]
    )
    notices += _assumed(record, lowpass, lowpass_order, smoothing, phase)
    notices += judge.one_feed_notice(record)
    notices += judge.phase_notices(record, phase)
    if followed:
        notices += judge.runout_notices(record, sd[-1, 2 * D : 2 * D + 2], prior[1][2 * D : 2 * D + 2])
    notices += more.pop("notices", [])
    tell(1.0, "coefficients")
    return history(
        record,
        course,
        method=method,
        noise=noise,
        runout=followed,
        held=fitted and not followed,
        chi2=chi2,
        modelled=modelled,
        checks=checks,
        verdict=judge.conclude(checks, share),
        notices=notices,
        **more,
    )


def _assumed(
    record: CutRecord, lowpass: float | None, lowpass_order: int, smoothing: float | None, phase: np.ndarray
) -> list[Notice]:
    """What the answer rests on, for the record."""
    chain = (
        "no low-pass in the force chain"
        if lowpass is None
        else (f"a Butterworth low-pass of {lowpass:g} Hz, order {lowpass_order}, in the force chain, taken as exact")
    )
    extra = "" if smoothing is None else f", force and model smoothed at {smoothing:g} Hz"
    found = ", ".join(f"{to_shop(float(angle), 'x_deg'):.2f}" for angle in phase)
    message = f"assumed: {chain}{extra}; found: tooth 0 is {found} deg ahead of the recorded spindle angle"
    return [Notice("assumed", message, "coefficients", "note")]


def _by_cut(record: CutRecord, course: Course, phase: np.ndarray) -> np.ndarray:
    """Mean parameters of each cut, phases last.   returns (cut, parameter)"""
    cut = record.cut[course.at]
    mean = [
        np.mean(course.mean[cut == number] if number in cut else course.mean, axis=0) for number in range(len(phase))
    ]
    return np.concatenate([mean, np.broadcast_to(phase, (len(phase), len(phase)))], axis=1)


def _prior(
    record: CutRecord, start: Start, bounds: Mapping[str, tuple[float, float]] | None, *, runout: bool, phase: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd of all parameters: the usual, or those of a uniform distribution within the user's bounds.

    runout, phase : whether they are followed; else they stay where the start has them
    """
    mean, sd = prior_of(record, start.parameters)
    for d, given in bounds_by_direction(record, bounds).items():
        points = corner_parameters(record, given, 40)
        mean[2 * d : 2 * d + 2], sd[2 * d : 2 * d + 2] = points.mean(axis=0), points.std(axis=0)
    D = record.directions
    if not runout:
        mean[2 * D : 2 * D + 2], sd[2 * D : 2 * D + 2] = start.runout, 0.0
    if not phase:
        sd[2 * D + 2 :] = 0.0
    return mean, sd


def _noise_of_residual(start: Start) -> Noise:
    sd = np.sqrt(np.mean(start.residual[start.record.of(start.samples).settled(start.record.memory)] ** 2, axis=0))
    return Noise(tuple(Autoregression(np.zeros(0), float(s), float(s)) for s in sd), "residual")


Found = tuple[Course, np.ndarray, float, dict]


def _smoothed(
    record: CutRecord,
    noise: Noise,
    used: np.ndarray,
    start: Start,
    prior: tuple[np.ndarray, np.ndarray],
    beyond: float,
    jumps: bool,
    rng: np.random.Generator,
    tell: Progress,
) -> Found:
    """The smoother; where the law does not hold to the noise, with noise that is as large and as coloured as what is left."""
    widened = 1.0
    if beyond > judge.REFUSE or noise.source == "residual":
        part = record.of(start.samples)
        alike = correlation_time(start.residual[part.settled(part.memory)], round(samples_per_pass(record, used)))
        widened = float(np.sqrt(max(beyond, 1.0) * alike))
    found = smooth_cut(
        record,
        noise.scaled(widened),
        used,
        start.parameters,
        prior,
        jumps=jumps,
        tell=lambda share, label: tell(0.1 + 0.8 * share, label),
    )
    trajectory = found.trajectory
    chi2 = found.chi2 * widened**2
    covariance = trajectory.block_covariance
    if widened == 1.0 and chi2 > judge.WARN:
        covariance = covariance * chi2
    block = trajectory.fit.problem.block
    edges = step_edges(used, record.cut)
    at = np.flatnonzero(used)
    step = np.searchsorted(edges, at, "right") - 1
    count = np.bincount(step, minlength=len(edges) - 1)
    kept = np.flatnonzero(count)
    last = np.searchsorted(step, kept, "right") - 1  # the last used sample of each step
    middle = (last + np.searchsorted(step, kept, "left")) // 2
    normalised = found.residual * widened
    own = 2 * record.directions + 2
    course = Course(
        at=at[middle],
        mean=trajectory.block_mean[block[middle], :own],
        covariance=covariance[block[middle], :own, :own],
        innovation_mean=_by_step(normalised, step, kept, count),
        innovation_square=_by_step(normalised**2, step, kept, count),
        count=count[kept],
    )
    tell(0.92, "wear and jumps")
    wear = wear_of(found, record, rng)
    time = record.cuts[0].start + np.bincount(block, record.time[used]) / np.bincount(block)
    grown = float(np.sqrt(chi2)) if widened == 1.0 and chi2 > judge.WARN else 1.0
    evidence = trajectory.evidence
    difference = evidence["shared"] - evidence["independent"]
    chosen = {"shared": "one trend shared by all directions", "independent": "a trend for each direction"}
    notices = []
    if widened > 1.0 or grown > 1.0:
        notices.append(
            Notice("intervals-widened", f"the residuals exceed the noise: intervals are {max(widened, grown):.3g} times as wide "
                   "as the noise alone would make them", "cuts", "note")
        )  # fmt: skip
    trends = trajectory.fit.scales[
        np.unique(trajectory.fit.model.scale_of[: len(trajectory.fit.model.dynamics.speeds)])
    ]
    more = {
        "checks": [judge.check_pace(trends, trajectory.fit.converged)],
        "slope": wear.slope,
        "slope_sd": wear.sd * grown,
        "jumps": jumps_of(jump_sizes(trajectory.fit), time, record.directions),
        "model": f"{chosen[trajectory.fit.model.name]} (log evidence {difference:+.1f} for the shared one)",
        "notices": notices,
    }
    return course, trajectory.block_mean[-1, own:], chi2, more


def _by_step(values: np.ndarray, step: np.ndarray, kept: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Means over the steps.   values : (used sample, axis)   returns (kept step, axis)"""
    sums = np.stack([np.bincount(step, column, minlength=len(count)) for column in values.T], axis=1)
    return sums[kept] / count[kept, np.newaxis]


def _filtered(
    record: CutRecord,
    noise: Noise,
    used: np.ndarray,
    start: Start,
    prior: tuple[np.ndarray, np.ndarray],
    bounds: Mapping[str, tuple[float, float]] | None,
    method: str,
    runout: bool,
    rng: np.random.Generator,
    tell: Progress,
    **options: object,
) -> Found:
    """One of the filters, in the order of time."""
    own = 2 * record.directions + 2
    corners = {d: corner_parameters(record, given, 40) for d, given in bounds_by_direction(record, bounds).items()}
    limits = limits_of(record, start.parameters, bounds, runout)
    begin = Begin(prior[0][:own], prior[1][:own], start.phase, limits, corners)
    edges = step_edges(used, record.cut)
    tell(0.2, f"{method} through {record.time[-1]:.3g} s")
    followed = FILTERS[method](
        record, noise, used, edges, begin, per_pass=samples_per_pass(record, used), rng=rng, **options
    )
    kept = np.flatnonzero(followed.count)
    last = np.array([np.flatnonzero(used[edges[i] : edges[i + 1]])[-1] + edges[i] for i in kept])
    course = Course(
        at=last,
        mean=followed.mean[kept],
        covariance=followed.covariance[kept],
        innovation_mean=followed.innovation_mean[kept],
        innovation_square=followed.innovation_square[kept],
        count=followed.count[kept],
    )
    late = kept[len(kept) // 2 :]
    weight = followed.count[late][:, np.newaxis]
    chi2 = float(np.mean(np.sum(followed.innovation_square[late] * weight, axis=0) / weight.sum()))
    names = [f"{what} {d}" for d in "tra"[: record.directions] for what in ("level", "shape")]
    names += ["c0", "s0"] if runout else []  # what is held lies at its bounds by that alone
    notices = judge.bound_notices(followed.at_bound[kept][:, : len(names)], names)
    if noise.order:
        notices.append(
            Notice(
                "coloured-noise",
                "the noise of the air cut is coloured, and this method takes it as white: its intervals are too short; "
                "method smooth whitens it",
                "cuts",
            )
        )
    return course, start.phase, chi2, {"notices": notices}


__all__ = ["LAWS", "METHODS", "follow_coefficients"]
