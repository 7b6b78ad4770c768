"""Stability from cuts that are simulated in time: points of a map, the limit between them, and where a cut goes beyond it.

A cut is called stable when it repeats with what drives it: once per tooth, or once per revolution where the teeth are not alike.
It is looked at under a strobe of that period at eight phases, along x and along y, and it repeats when the mean change from
flash to flash is at most a tenthousandth of the feed per tooth (10 nm at 0.1 mm) at every phase: motions scale with the feed,
because force is linear in chip and motion, and beyond the limit they grow until teeth leave the cut. (Measured cuts are
judged at 1 um; there is no noise here, and a stiff tool that chatters may move less than that.) Close to the limit
transients die slowly: a change that falls as a power does, within what was looked at (`numerics.periodicity`) or from one such
stretch to the next, is taken to die, and one that falls otherwise is run on, five times as long at most.

Far beyond the limit a tip may swing so wide that it digs out what the next hundreds of passes should cut, and then rest: in
the air, or cutting with what is left of its arc, which may well be stable. So a cut that repeats is stable only if the surface
has gone with the feed at every angle, as it does in every steady cut.

The limit of a speed lies between two depths of the grid of which one chatters and the other does not, and is found by halving.
What the simulation knows beyond a multiplier, and why limits may differ from it by more than a halving:
- Cuts that chatter once disturbed, though a small wave dies, because teeth leave the cut. The start from rest with the whole
  chip is such a disturbance.
- Edge forces end with the chip. Where a cut runs out to nothing (the exit of down milling, the entry of up), waves move that place,
  and K_e over the feed adds to the stiffness of the cut there: the smaller the feed, the lower the limit.
- Teeth that are not alike do not meet their own deflection again, so that near a resonance the steady motion itself may take some
  of them out of the cut, and a cut with fewer teeth is more stable.

A period doubling of an even number of teeth repeats every revolution, as runout does. So with runout such a cut counts as
stable only if it repeats every tooth with the runout left out.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from millcal.data import Notice, SimulatedCuts
from millcal.errors import IllPosedError
from millcal.numerics.periodicity import change, periodicity
from millcal.physics.stability.regeneration import FLIP, HOPF, Crossings, Regeneration, TipModes
from millcal.physics.stability.time_domain import flashes_per_revolution, simulate_cut, simulate_points, steps_for

REPEATS = 1e-4  # of the feed per tooth: change from flash to flash up to which a cut repeats
ASTRAY = 0.5  # of the feed: a surface that has come less far, or farther, was dug out
LOCKED = 0.05  # of the change over one period: what may be left over n of them, where a cut repeats after n ..
NEARLY = 0.01  # .. and of the feed per tooth: it may still be on its way there
FLASHES = 200  # looked at, after as many that are not
LONGER = 5  # times as long where it is not decided
LONGEST = 12  # periods told apart from chatter
HALVINGS = 5  # of the step between two depths
FALLS = 0.97  # of the change before: what is above it is steady
EVEN = 0.3  # of what is lost from stretch to stretch: by how much that may differ in a power
RESTS = 0.1  # of the last change: what a power may seem to leave
GRAIN = 0.1  # of the feed per tooth: a change below that may be the steps'
FINER = 3  # times that the steps are halved to find out
STAYS = 0.75  # of the change: what is left of one that is not the steps'
NOT_KEPT = np.empty((0, 0, 2))


class _Cut(NamedTuple):
    """What is simulated at every point."""

    tip: TipModes
    cut: Regeneration
    feed_per_tooth: float
    kte: float
    kre: float
    runout: tuple[float, float]

    def options(self) -> dict[str, Any]:
        return {"feed_per_tooth": self.feed_per_tooth, "kte": self.kte, "kre": self.kre, "runout": self.runout}


class _Outcome(NamedTuple):
    """How one cut went."""

    period: int  # in what `SimulatedCuts` says; 1: stable, 0: never
    metric: float  # m
    samples: np.ndarray  # (phase, flash, 2), m; those of a grid are not kept
    doubled: bool  # the change over two periods is far less than over one
    hidden: bool  # chatter that repeats every revolution, as runout does
    decided: bool
    dug: bool  # the tip has dug out what it should cut now, or later


def crossings_in_time(
    tip: TipModes,
    cut: Regeneration,
    speeds: np.ndarray,
    *,
    deepest: float,
    depths: int = 20,
    feed_per_tooth: float | None,
    kte: float = 0.0,
    kre: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] | None = None,
) -> tuple[Crossings, SimulatedCuts, tuple[Notice, ...]]:
    """Depths at which simulated cuts begin and cease to chatter, and the cuts of the grid.

    speeds : (speed,) rad/s   deepest, feed_per_tooth : m   depths : of the grid, evenly spaced down to the deepest
    kte, kre : N/m   runout : (c0, s0) m   progress : told the share that is done

    A flip is a cut that repeats every other tooth, anything else beyond the limit counts as a Hopf; the end of a chattering
    stretch has the kind of its beginning.
    """
    what = _Cut(tip, cut, _feed(feed_per_tooth), kte, kre, runout)
    speeds = np.asarray(speeds, float)
    grid = deepest * np.arange(1, depths + 1) / depths
    rows: list[tuple[int, float, int, float, bool]] = []
    outcomes: list[_Outcome] = []
    for i, speed in enumerate(speeds):
        if progress is not None:
            progress(i / len(speeds))
        column = [_simulated(what, speed, depth) for depth in grid]
        outcomes += [outcome._replace(samples=NOT_KEPT) for outcome in column]
        kind, frequency = HOPF, np.nan
        stable = np.array([True, *(outcome.period == 1 for outcome in column)])  # nothing cut is stable
        for k in np.flatnonzero(np.diff(stable)):
            above, below = (grid[k - 1] if k else 0.0), grid[k]
            if stable[k]:
                rests, chatters, outcome = _between(what, speed, above, below, column[k])
                kind, frequency = _chatter(what, speed, chatters, outcome)
            else:
                rests, chatters, _ = _between(what, speed, below, above, column[k - 1])
            rows.append((i, (rests + chatters) / 2, kind, frequency, bool(stable[k])))
    at, depth, kinds, frequencies, loses = zip(*rows, strict=True) if rows else ((),) * 5
    crossings = Crossings(
        np.array(at, int), np.array(depth, float), np.array(kinds, int), np.array(frequencies, float),
        np.array(loses, bool),
    )  # fmt: skip
    points = np.repeat(speeds, depths), np.tile(grid, len(speeds))
    notices = [
        Notice(
            "depth-grid",
            f"the time domain was looked at every {1e3 * deepest / depths:.3g} mm of depth: what lies between two stable cuts "
            f"is not shown, and limits hold to {1e3 * deepest / depths / 2 ** (HALVINGS + 1):.2g} mm",
            level="note",
        )
    ]
    return crossings, _record(what, *points, outcomes), (*notices, *_notices(outcomes))


def simulated_cuts(
    tip: TipModes,
    cut: Regeneration,
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    *,
    feed_per_tooth: float | None,
    kte: float = 0.0,
    kre: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] | None = None,
) -> tuple[SimulatedCuts, tuple[Notice, ...]]:
    """Cuts at given points of a map.   spindle_speed, depth : (cut,) rad/s, m; for the others see `crossings_in_time`"""
    what = _Cut(tip, cut, _feed(feed_per_tooth), kte, kre, runout)
    outcomes = []
    for i, (speed, b) in enumerate(zip(spindle_speed, depth, strict=True)):
        if progress is not None:
            progress(i / len(depth))
        outcomes.append(_simulated(what, float(speed), float(b))._replace(samples=NOT_KEPT))
    return _record(what, np.asarray(spindle_speed, float), np.asarray(depth, float), outcomes), _notices(outcomes)


def with_bifurcation(
    simulated: SimulatedCuts,
    tip: TipModes,
    cut: Regeneration,
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    *,
    feed_per_tooth: float | None,
    kte: float = 0.0,
    kre: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    flashes: int = 60,
    progress: Callable[[float], None] | None = None,
) -> SimulatedCuts:
    """With where the cuts along a line of the map come to rest: a point where they repeat, two at a flip, a cloud in chatter.

    spindle_speed, depth : of the cuts along the line, either may be one number, rad/s and m   flashes : kept of each cut
    """
    what = _Cut(tip, cut, _feed(feed_per_tooth), kte, kre, runout)
    speeds, depths = np.broadcast_arrays(np.asarray(spindle_speed, float), np.asarray(depth, float))
    seen = []
    for i, (speed, b) in enumerate(zip(speeds, depths, strict=True)):
        if progress is not None:
            progress(i / len(speeds))
        seen.append(_simulated(what, float(speed), float(b)).samples[:, -flashes:])
    every = np.array(seen)  # (cut, phase, flash, 2)
    axis = int(np.argmax(np.ptp(every, axis=2).max(axis=(0, 1))))
    phase = int(np.argmax(np.ptp(every[..., axis], axis=2).sum(axis=0)))  # where most is to be seen
    kept = every[:, phase, :, axis]
    return replace(
        simulated,
        bifurcation_speed=np.repeat(speeds, kept.shape[1]),
        bifurcation_depth=np.repeat(depths, kept.shape[1]),
        bifurcation_displacement=kept.ravel(),
    )


def _feed(feed_per_tooth: float | None) -> float:
    if feed_per_tooth is None or not feed_per_tooth > 0:
        raise IllPosedError(
            "stability.feed_per_tooth_mm: a cut in the time domain needs a feed, teeth leave the cut by it; give the feed per tooth"
        )
    return feed_per_tooth


def _simulated(what: _Cut, speed: float, depth: float) -> _Outcome:
    """One cut, at steps so fine that what does not repeat is the motion and not they.

    Where a chip runs out to nothing, a tooth leaves the cut a step earlier or later from pass to pass, and what that makes is
    halved with the step. Chatter is not.
    """
    outcome = _at_steps(what, speed, depth, None)
    steps = steps_for(speed, depth, what.tip, what.cut)
    for _ in range(FINER):
        if outcome.period == 1 or outcome.dug or not outcome.metric < GRAIN * what.feed_per_tooth:
            return outcome
        steps *= 2
        before, outcome = outcome, _at_steps(what, speed, depth, steps)
        if outcome.metric > STAYS * before.metric:
            return outcome
    return outcome if outcome.hidden or outcome.dug else outcome._replace(period=1)


def _at_steps(what: _Cut, speed: float, depth: float, steps: int | None) -> _Outcome:
    """One cut, until it is decided.   steps : of a revolution, None: `steps_for`"""
    threshold = REPEATS * what.feed_per_tooth
    levels: list[float] = []  # M(1) of each stretch that was looked at

    def undecided(samples: np.ndarray) -> bool:
        rows = _rows(samples)
        levels.append(float(change(rows, 1).mean()))
        if periodicity(rows, threshold, longest=1).period == 1 or _dies_out(levels):
            return False
        if len(levels) > 1:
            return levels[-1] < FALLS * levels[-2]
        half = rows.shape[1] // 2
        return bool(change(rows[:, half:], 1).mean() < FALLS * change(rows[:, :half], 1).mean())

    each = flashes_per_revolution(what.cut, what.runout)
    kept = -(-FLASHES // each)
    strobed = simulate_points(
        np.array([speed]), np.array([depth]), what.tip, what.cut, **what.options(),
        revolutions=2 * kept, kept=kept, most=2 * LONGER * kept, undecided=undecided, steps_per_revolution=steps,
    )  # fmt: skip
    samples = strobed.displacement[0]
    found = periodicity(_rows(samples), threshold, longest=LONGEST)
    period = found.period
    if _dies_out(levels):
        period = 1
    elif period != 1:
        locked = np.flatnonzero(found.lasting <= min(LOCKED * found.change[0], NEARLY * what.feed_per_tooth))
        period = int(locked[0]) + 1 if len(locked) else 0
    dug = bool(strobed.astray[0] > ASTRAY)
    if dug:
        period = 0
    if 1 < each < what.cut.teeth and period > 1:  # a pattern of pitches that repeats within a revolution
        period = period // each if period % each == 0 and period > each else 0
    hidden = False
    if period == 1 and np.any(what.runout) and what.cut.equal_pitch and what.cut.teeth % 2 == 0:
        hidden = _simulated(what._replace(runout=(0.0, 0.0)), speed, depth).period != 1
        period = 0 if hidden else 1
    ended = int(strobed.revolutions[0]) + kept > 2 * LONGER * kept
    decided = period == 1 or not ended or levels[-1] >= FALLS * levels[-2]
    doubled = bool(found.change[1] <= LOCKED * found.change[0])
    return _Outcome(period, float(found.change[0]), samples, doubled, hidden, decided, dug)


def _between(
    what: _Cut, speed: float, rests: float, chatters: float, outcome: _Outcome
) -> tuple[float, float, _Outcome]:
    """A depth that is stable and one that chatters, brought together by halving, with how the latter went."""
    for _ in range(HALVINGS):
        middle = (rests + chatters) / 2
        tried = _simulated(what, speed, middle)
        if tried.period == 1:
            rests = middle
        else:
            chatters, outcome = middle, tried
    return rests, chatters, outcome


def _dies_out(levels: list[float]) -> bool:
    """Whether the change falls from stretch to stretch as a power does, towards nothing."""
    if len(levels) < 4:
        return False
    first, second, third, last = levels[-4:]
    ratios = np.array([second / first, third / second, last / third])
    steps = second - third, third - last
    bend = steps[0] - steps[1]
    rest = last - steps[1] ** 2 / bend if bend > 0 else last  # Aitken: where a power tends to
    return bool(ratios.max() < FALLS and np.ptp(ratios) < EVEN * (1 - ratios.mean()) and rest < RESTS * last)


def _rows(samples: np.ndarray) -> np.ndarray:
    """The strobe of every phase along x and along y.   samples : (phase, flash, 2)   returns (row, flash)"""
    return np.moveaxis(samples, 2, 0).reshape(-1, samples.shape[1])


def _chatter(what: _Cut, speed: float, depth: float, outcome: _Outcome) -> tuple[int, float]:
    """Kind of a loss of stability, and the strongest line of the motion beside the tooth-passing ones.   returns kind, Hz"""
    smooth = what
    if outcome.hidden:
        smooth = what._replace(runout=(0.0, 0.0))
        outcome = _simulated(smooth, speed, depth)
    each = flashes_per_revolution(smooth.cut, smooth.runout)
    kept = -(-FLASHES // each)
    history = simulate_cut(speed, depth, smooth.tip, smooth.cut, **smooth.options(), revolutions=2 * kept)
    steps = (
        history.steps_per_revolution // each
        if history.steps_per_revolution % each == 0
        else history.steps_per_revolution
    )
    motion = history.displacement[:, -kept * each * steps :].reshape(2, -1, steps)
    motion = (motion - motion.mean(axis=1, keepdims=True)).reshape(2, -1)
    power = np.abs(np.fft.rfft(motion * np.hanning(motion.shape[1]), axis=1)) ** 2
    total = power.sum(axis=0)
    top = int(np.clip(np.argmax(total[1:]) + 1, 1, len(total) - 2))
    below, at, above = np.log(np.maximum(total[top - 1 : top + 2], 1e-300))
    bend = below - 2 * at + above
    between = 0.5 * (below - above) / bend if bend < 0 else 0.0
    resolution = 1 / (motion.shape[1] * (history.time[1] - history.time[0]))
    frequency = float((top + between) * resolution)
    driving = speed * each / (2 * np.pi)
    if outcome.doubled:
        return FLIP, float((np.floor(frequency / driving) + 0.5) * driving)
    return HOPF, frequency


def _record(what: _Cut, speed: np.ndarray, depth: np.ndarray, outcomes: list[_Outcome]) -> SimulatedCuts:
    alike = flashes_per_revolution(what.cut, what.runout) == what.cut.teeth
    return SimulatedCuts(
        spindle_speed=speed,
        axial_depth=depth,
        period=np.array([outcome.period for outcome in outcomes], float),
        metric=np.array([outcome.metric for outcome in outcomes]),
        per="tooth" if alike else "revolution",
    )


def _notices(outcomes: list[_Outcome]) -> tuple[Notice, ...]:
    notices = []
    open_ = sum(not outcome.decided for outcome in outcomes)
    if open_:
        notices.append(
            Notice(
                "undecided-cuts",
                f"{open_} of {len(outcomes)} simulated cuts were still coming to rest after {2 * LONGER * FLASHES} periods "
                "and count as chatter: they lie close to the limit",
            )
        )
    hidden = sum(outcome.hidden for outcome in outcomes)
    if hidden:
        notices.append(
            Notice(
                "hidden-flips",
                f"{hidden} of {len(outcomes)} simulated cuts repeat every revolution and count as chatter: without runout they "
                "do not repeat every tooth",
            )
        )
    return tuple(notices)
