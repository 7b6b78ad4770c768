"""From parameters over time to the record: coefficients with bands, what is drawn, and the state of the tool at the end."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from millcal.data import Check, CoefficientHistory, Jump, Notice, Posterior
from millcal.physics.sampled_force import coefficients_of
from millcal.stages.coefficients.trends.problem import DIRECTIONS, NAMES, CutRecord, Noise, short_name

NORMAL = 1.959964  # half width of a 95 % interval in standard deviations
MOST_STEPS = 1000
DEEP = 0.5  # of the largest axial depth: a tool that leaves tells little
WINDOWS = 3
WINDOW_TURNS = 2.0  # revolutions of force that are drawn in each
MOST_DRAWN = 800  # samples of a window
UNITS = {"kienzle": ("N/m^2", "1"), "linear-edge": ("N/m^2", "N/m")}


class Course(NamedTuple):
    """Parameters at some steps, as any method leaves them; runout last, no phases."""

    at: np.ndarray  # (step,) int, sample at which the values hold
    mean: np.ndarray  # (step, parameter)
    covariance: np.ndarray  # (step, parameter, parameter)
    innovation_mean: np.ndarray  # (step, axis)
    innovation_square: np.ndarray  # (step, axis)
    count: np.ndarray  # (step,)


def step_edges(used: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Borders of at most a thousand steps with about as many used samples each, none across two cuts.   returns (step + 1,) int"""
    at = np.flatnonzero(used)
    each = max(1, -(-len(at) // MOST_STEPS))
    borders = at[each::each]
    turns = 1 + np.flatnonzero(np.diff(cut))
    return np.unique(np.concatenate([[0], borders, turns, [len(used)]]))


def names_of(record: CutRecord) -> tuple[str, ...]:
    """kt kr ka mt mr ma, or Ktc Krc Kac Kte Kre Kae."""
    return tuple(name.format(d) for name in NAMES[record.law] for d in DIRECTIONS[: record.directions])


def _signs(record: CutRecord) -> np.ndarray:
    """Of the coefficients in that order: an axial force that pulls has negative ones, a rise has no sign.   (coefficient,)"""
    axial = record.sign[record.axes.index("z")] if "z" in record.axes else 1.0
    level = np.ones(record.directions)
    level[2:] = axial
    return np.concatenate([level, np.ones(record.directions) if record.law == "kienzle" else level])


def history(
    record: CutRecord,
    course: Course,
    *,
    method: str,
    noise: Noise,
    runout: bool,
    held: bool,
    chi2: float,
    modelled: np.ndarray,
    checks: Sequence[Check],
    verdict: str,
    notices: Sequence[Notice],
    slope: np.ndarray | None = None,
    slope_sd: np.ndarray | None = None,
    jumps: Sequence[Jump] = (),
    model: str = "",
) -> CoefficientHistory:
    """The record.

    runout : whether it was followed   held : or was found by the start and kept, without an interval of its own
    modelled : (sample, axis) N   slope, slope_sd : (direction,) 1/s, of the specific force
    """
    D, signs = record.directions, _signs(record)
    values, slopes = coefficients_of(course.mean, record.law, record.reference_chip)
    sd = np.sqrt(np.maximum(np.einsum("scp,spq,scq->sc", slopes, course.covariance, slopes), 0.0))
    values = values * signs
    level = course.mean[:, 0 : 2 * D : 2]
    level_sd = np.sqrt(np.maximum(np.diagonal(course.covariance, axis1=1, axis2=2), 0.0))[:, 0 : 2 * D : 2]
    low, high = np.exp(level - NORMAL * level_sd), np.exp(level + NORMAL * level_sd)
    level_sign = signs[:D]
    both = np.stack([level_sign * low, level_sign * high])
    at, window = _windows(record)
    residual = record.force - modelled
    missing = np.full(D, np.nan)
    return CoefficientHistory(
        posterior=_posterior(record, course, values, slopes, signs, method, runout),
        method=method,
        cutter=record.cutter,
        conditions=tuple(cut.conditions for cut in record.cuts),
        cuts=tuple(short_name(cut) for cut in record.cuts),
        verdict=verdict,
        checks=tuple(checks),
        time=record.cuts[0].start + record.time[course.at],
        cut=record.cut[course.at],
        names=names_of(record),
        units=tuple(np.repeat(UNITS[record.law], D)),
        value=values,
        low=values - NORMAL * sd,
        high=values + NORMAL * sd,
        reference_chip=record.reference_chip,
        directions=DIRECTIONS[:D],
        specific_force=level_sign * np.exp(level),
        specific_low=both.min(axis=0),
        specific_high=both.max(axis=0),
        axes=record.axes,
        innovation_mean=course.innovation_mean,
        innovation_square=course.innovation_square,
        innovation_samples=course.count,
        shown=record.cuts[0].start + record.time[at],
        shown_window=window,
        measured=record.force[at].T,
        modelled=modelled[at].T,
        residual_rms=np.sqrt(np.mean(residual**2, axis=0)),
        r2=1 - np.var(residual, axis=0) / np.maximum(np.var(record.force, axis=0), 1e-300),
        noise=noise.sd,
        noise_from=noise.source,  # type: ignore[arg-type]
        chi2=chi2,
        chip_range=(record.chips.low, record.chips.high),
        slope_per_minute=missing if slope is None else 60 * slope,
        slope_low=missing if slope is None or slope_sd is None else 60 * (slope - NORMAL * slope_sd),
        slope_high=missing if slope is None or slope_sd is None else 60 * (slope + NORMAL * slope_sd),
        jumps=tuple(jumps),
        runout=(float(course.mean[-1, -2]), float(course.mean[-1, -1])) if runout or held else None,
        model=model,
        notices=tuple(dict.fromkeys(notices)),
    )


def _posterior(
    record: CutRecord,
    course: Course,
    values: np.ndarray,
    slopes: np.ndarray,
    signs: np.ndarray,
    method: str,
    runout: bool,
) -> Posterior:
    """The last step at which the tool was not yet leaving, with runout where it was followed."""
    D = record.directions
    depth = record.passage.axial_depth[course.at]
    end = int(np.flatnonzero(depth >= DEEP * depth.max())[-1])
    values, slopes = values[end], slopes[end]
    names, units = names_of(record), tuple(np.repeat(UNITS[record.law], D))
    rows = slopes * signs[:, np.newaxis]
    mean = values
    if runout:
        names, units = (*names, "c0", "s0"), (*units, "m", "m")
        rows = np.concatenate([rows, np.eye(2, 2 * D + 2, 2 * D)])
        mean = np.concatenate([values, course.mean[end, -2:]])
    covariance = rows @ course.covariance[end] @ rows.T
    half = NORMAL * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Posterior(
        names=names,
        units=units,
        mean=mean,
        covariance=(covariance + covariance.T) / 2,
        interval=np.stack([mean - half, mean + half], axis=1),
        law=record.law,  # type: ignore[arg-type]
        method=method,
    )


def _windows(record: CutRecord) -> tuple[np.ndarray, np.ndarray]:
    """Samples of the short windows that are drawn, at the beginning, the middle and the end, and the window of each."""
    n = len(record.force)
    turn = 2 * np.pi / max(float(np.median(np.diff(record.passage.angle[: min(n, 1000)]))), 1e-12)
    length = int(min(WINDOW_TURNS * turn, MOST_DRAWN, n // WINDOWS))
    starts = np.linspace(min(record.memory, n - length), n - length, WINDOWS).astype(int)
    for border in record.edges[1:-1]:  # a window lies within one piece
        over = (starts < border) & (border < starts + length)
        starts[over] = np.where(border + length <= n, border, border - length)
    at = np.concatenate([np.arange(start, start + length) for start in starts])
    return at, np.repeat(np.arange(WINDOWS), length)


def parameters_over_time(record: CutRecord, course: Course, phase: np.ndarray, *, hold: str) -> np.ndarray:
    """Parameters at every sample from those at the steps, phases last.

    hold : "before", a filter's estimate holds until the next; "nearest", a smoother's is the best about it
    """
    index = np.arange(len(record.force))
    if hold == "before":
        step = np.clip(np.searchsorted(course.at, index, "left"), 0, len(course.at) - 1)
    else:
        middle = (course.at[1:] + course.at[:-1]) / 2
        step = np.searchsorted(middle, index)
    own = course.mean[step]
    return np.concatenate([own, np.broadcast_to(phase, (len(own), len(phase)))], axis=1)


def jumps_of(found: list[tuple[int, np.ndarray, np.ndarray, float]], time: np.ndarray, directions: int) -> list[Jump]:
    """The jumps as records.   found : block, change, covariance, log Bayes factor   time : (block,) s"""
    levels = np.arange(0, 2 * directions, 2)
    return [
        Jump(
            time=float(time[at]),
            change=tuple(float(value) for value in change[levels]),
            sd=tuple(float(value) for value in np.sqrt(np.maximum(np.diag(covariance)[levels], 0.0))),
            log_bayes_factor=float(factor),
        )
        for at, change, covariance, factor in found
    ]
