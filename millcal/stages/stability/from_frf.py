"""Crossings straight from a measured FRF, with what its noise makes of them and what its band leaves open.

The noise of the lines goes to first order through every crossing that may be the limit; as the limit is the lowest of them,
so are the ends of its band the lowest of theirs. What no first order sees is a crossing that the noise alone makes or
unmakes, at the foot of a narrow tongue: `moved_by_noise` looks for that with noise added anew at a few speeds.
"""

from collections.abc import Callable

import numpy as np

from millcal.data import Frf, Notice
from millcal.physics.stability.frf_spread import inverse_depth_sd
from millcal.physics.stability.from_frf import (
    CutBasis,
    MeasuredCut,
    crossings_at,
    measured_cut,
    one_behind_the_other,
)
from millcal.physics.stability.regeneration import Crossings, Regeneration
from millcal.stages.stability.lines import usable_lines
from millcal.stages.stability.tip import Lines

NINETY_FIVE = 1.96  # standard deviations on either side
WEAK = 0.1  # share of the highest resonance from which a mode is counted
SHORT_BAND, VERY_SHORT = 2.5, 1.6  # times the highest mode (`measured_receptance` has what limits are off by)
LATE_START = 0.5  # share of the lowest mode at which the lines may begin
DRAWS, SPEEDS = 6, 8  # with noise added
JUMP = 4.0  # standard deviations of 1/b


def crossings_of_frf(
    dynamics: Frf,
    speeds: np.ndarray,
    cut: Regeneration,
    *,
    deepest: float,
    rigid: str = "",
    progress: Callable[[float], None] | None = None,
) -> tuple[Crossings, np.ndarray | None, np.ndarray | None, tuple[Notice, ...]]:
    """Crossings of each speed, the ends of the 95 % band of the first limit where the FRF has a variance, and notices.

    speeds : (speed,) rad/s   deepest : m   rigid : axes that may be missing
    returns Crossings, (speed,) m or None twice (inf where nothing is found), notices

    Raises IllPosedError where the lines are no receptance to stand on, or a tooth cuts through too many waves.
    """
    lines, notices = usable_lines(dynamics, rigid)
    found, ends = crossings_of_lines(lines, speeds, cut, deepest=deepest, progress=progress)
    told = (*notices, *of_the_band(lines))
    if ends is None:
        return found, None, None, told
    low, high = np.where(ends > 0, 1 / np.where(ends > 0, ends, 1.0), np.inf)
    return found, low, high, told


def crossings_of_lines(
    lines: Lines,
    speeds: np.ndarray,
    cut: Regeneration,
    *,
    deepest: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[Crossings, np.ndarray | None]:
    """The same of usable lines: crossings, and the ends of the 95 % band as 1/b, which may lie below zero.

    speeds : (speed,) rad/s   deepest : m   returns Crossings, (2, speed) 1/m, the larger first and 0 where nothing is found; None
    without a variance
    """
    problem = _problem(lines, cut, deepest)
    parts: list[Crossings] = []
    ends = np.zeros((2, len(speeds)))
    for those, basis in problem.bases(np.asarray(speeds, float)):
        for i in those.tolist():
            if progress is not None:
                progress(len(parts) / len(speeds))
            found, angle = crossings_at(problem, float(speeds[i]), basis, i)
            parts.append(found)
            if lines.variance is not None:
                ends[:, i] = _ends(problem, float(speeds[i]), basis, found, angle, lines.variance)
    return one_behind_the_other(parts), None if lines.variance is None else ends


def moved_by_noise(
    dynamics: Frf,
    speeds: np.ndarray,
    cut: Regeneration,
    *,
    deepest: float,
    rng: np.random.Generator,
    rigid: str = "",
) -> tuple[Notice, ...]:
    """Whether limits of the lines with their noise added once more leave the band, as a crossing that comes or goes does.

    speeds : (speed,) rad/s, a few of which are tried   deepest : m
    """
    lines, _ = usable_lines(dynamics, rigid)
    if lines.variance is None:
        return ()
    tried = np.asarray(speeds, float)[np.unique(np.linspace(0, len(speeds) - 1, SPEEDS).astype(int))]
    _, bounds = crossings_of_lines(lines, tried, cut, deepest=deepest)
    assert bounds is not None
    middle, sd = bounds.mean(axis=0), (bounds[0] - bounds[1]) / (2 * NINETY_FIVE)
    outside = np.zeros(len(tried), int)
    for _ in range(DRAWS):
        noise = rng.standard_normal((2, *lines.values.shape)) * np.sqrt(lines.variance / 2)
        problem = _problem(lines._replace(values=lines.values + noise[0] + 1j * noise[1]), cut, deepest)
        for those, basis in problem.bases(tried):
            for i in those.tolist():
                first = crossings_at(problem, float(tried[i]), basis, 0)[0].first(1).depth[0]
                outside[i] += abs(1 / first - middle[i]) > JUMP * sd[i] + 0.02 * middle[i]
    if not outside.any():
        return ()
    what = (
        f"the noise of the FRF makes or unmakes a limit at {np.count_nonzero(outside)} of {len(tried)} speeds tried, more than "
        "its band says; fit modes (millcal modes) or average more hits"
    )
    return (Notice("noise-moves-limits", what, "frf"),)


def _problem(lines: Lines, cut: Regeneration, deepest: float) -> MeasuredCut:
    return measured_cut(lines.frequency, lines.values, cut, deepest=deepest)


def _ends(
    problem: MeasuredCut,
    speed: float,
    basis: CutBasis,
    found: Crossings,
    angle: np.ndarray,
    variance: np.ndarray,
) -> tuple[float, float]:
    """Ends of the band of the first limit of one speed as 1/b, the larger first; 0 where there is none.   1/m"""
    most, least = 0.0, -np.inf
    for i in np.argsort(found.depth, kind="stable"):
        if not found.loses[i]:
            continue
        if found.depth[i] > problem.deepest or found.depth[i] * most > 2:
            break  # far above what is lowest: no noise that a band can tell brings it down
        inverse = 1 / found.depth[i]
        spread = NINETY_FIVE * inverse_depth_sd(problem, speed, basis, float(angle[i]), float(found.depth[i]), variance)
        most, least = max(most, inverse + spread), max(least, inverse - spread)
    return most, least if most else 0.0


def of_the_band(lines: Lines) -> list[Notice]:
    """What a band that ends too early, or begins too late, leaves open."""
    frequency = lines.frequency
    absorbed = -frequency[:, np.newaxis] * np.einsum("fii->fi", lines.values).imag  # in proportion to the mobility
    peaks = []
    for power in absorbed.T:
        inner = power[1:-1]
        top = (inner > power[:-2]) & (inner >= power[2:]) & (inner > WEAK * np.abs(absorbed).max())
        peaks += frequency[1:-1][top].tolist()
    if not peaks:
        what = "no resonance stands in the usable band; limits count what little the lines know"
        return [Notice("no-resonance", what, "frf")]
    notices = []
    if frequency[-1] < SHORT_BAND * max(peaks):
        off = (
            "limits may be anywhere within a multiple"
            if frequency[-1] < VERY_SHORT * max(peaks)
            else "some limits may be off by percents"
        )
        what = (
            f"the usable band ends at {frequency[-1]:.0f} Hz, less than {SHORT_BAND:g} times the resonance at {max(peaks):.0f} Hz: "
            f"above it the tip is taken as a mass, and {off}; hit with a harder tip"
        )
        notices.append(Notice("short-band", what, "frf"))
    if frequency[0] > LATE_START * min(peaks):
        what = (
            f"the lines begin at {frequency[0]:.0f} Hz, near the resonance at {min(peaks):.0f} Hz: below them its value there "
            "stands for the static one"
        )
        notices.append(Notice("late-start", what, "frf"))
    return notices
