"""The cut in the time domain: the waves that the tooth before left are kept as they are, and a tooth may leave the cut.

The modes of the tip are propagated exactly under a force that is held over a step,

    z' = s z + b . F:      z(t + dt) = e^(s dt) z(t) + (e^(s dt) - 1) / s  b . F,

with the force of mid-step, so that the error falls with the square of the step. A stretch of edge at the angle phi reaches

    (x + feed) sin phi + y cos phi + e

into the workpiece, e its radial offset by runout. Its chip is what that is beyond the surface left there; where it is
not, the tooth is out of the cut, makes no force and leaves the surface as it was. Thus unequal pitch and runout need no rules
of their own: how far the feed went since the tooth before, and which tooth cut last, the surface knows. Each slice of a helix
lags and keeps its surface. With unequal pitch the teeth meet a place between the steps of the tooth before; its surface is
taken there from a cubic through the four steps around. A step that is engaged in part counts with that part.

Where nothing cuts, the modes go to the next step that counts in one multiplication.

What is left out: the trochoid (teeth move on circles), axial motion, and the material behind the flank but for the process
damping of `Regeneration`. A flexibility answers within the step, by rounds of force and deflection.

With `linear` the teeth never leave the cut and feed, edge forces and runout are left out: growth from period to period is then
the multiplier of the Floquet methods, to the error of the step.

References
----------
Schmitz, Smith 2019, Machining Dynamics, 2nd ed., section 4.4 (time-domain simulation, "regenerative force, dynamic deflection").
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from millcal.errors import IllPosedError
from millcal.physics.stability.regeneration import Regeneration, TipModes

if TYPE_CHECKING:
    from millcal.physics.stability import time_domain_kernel as kernel

PER_WAVE = 40  # steps to the shortest wave of the tip
IN_CUT = 40  # steps of a tooth in cut, at least
LEAST = 200  # steps of a revolution
BETWEEN = 5  # steps from a tooth to the next, at least: the cubic takes from four
LAG = 2  # steps that the edge of one slice lags, at most
ACROSS = 0.3  # of the largest sine of the angle: where the feed is seen in the chip
GRIP = 0.5  # of the cut on the flexibility: beyond, rounds of force and deflection do not settle


class _Driven(NamedTuple):
    """What drives a cut beside its waves."""

    feed_per_tooth: float
    kte: float
    kre: float
    runout: tuple[float, float]


class TimeDomain(NamedTuple):
    """One cut, step by step."""

    time: np.ndarray  # start of each step, (step,) s
    angle: np.ndarray  # of the spindle there, (step,) rad
    displacement: np.ndarray  # of the tip there, x and y, (2, step) m
    force: np.ndarray  # on the tool over the step, x and y, (2, step) N
    steps_per_revolution: int


class Strobed(NamedTuple):
    """Cuts looked at once per period of what drives them."""

    displacement: np.ndarray  # x and y, (cut, phase, flash, 2) m
    per_revolution: int  # flashes: the teeth, or fewer where the teeth are not alike
    astray: np.ndarray  # the surface from the feed, in the revolutions looked at and as a share of it, at most, (cut,)
    revolutions: np.ndarray  # how many were run, integer (cut,)
    steps: int  # of time, of all cuts together


def steps_for(spindle_speed: float, depth: float, tip: TipModes, cut: Regeneration) -> int:
    """Steps of a revolution that resolve the waves of the tip, which the cut makes stiffer, and the passage of a tooth."""
    stiffer = depth * np.hypot(cut.ktc, cut.krc) * np.sum(_participation(tip))
    highest = np.sqrt(np.max(np.abs(tip.pole), initial=0.0) ** 2 + stiffer)
    closest = 2 * np.pi / cut.teeth if cut.pitch is None else min(cut.pitch)
    wanted = max(
        PER_WAVE * highest / spindle_speed,
        IN_CUT * 2 * np.pi / (cut.leave - cut.entry),
        BETWEEN * 2 * np.pi / closest,
        LEAST,
    )
    return int(np.ceil(wanted / cut.teeth)) * cut.teeth


def _participation(tip: TipModes) -> np.ndarray:
    """|p|^2 of each mode, for a real one of mass-normalised shape p.   returns (mode,) 1/kg"""
    size = np.linalg.norm(tip.output, axis=1) * np.linalg.norm(tip.given, axis=1)
    return np.asarray(2 * np.abs(tip.pole.imag) * size)


def slices_for(depth: float, cut: Regeneration, steps: int) -> int:
    """Slices of which none lags by more than `LAG` steps."""
    return max(1, int(np.ceil(abs(cut.wind) * depth / (2 * np.pi / steps) / LAG)))


def flashes_per_revolution(cut: Regeneration, runout: tuple[float, float] = (0.0, 0.0)) -> int:
    """How often in a revolution everything that drives the cut repeats: once a tooth where all are alike."""
    if np.any(np.asarray(runout)):
        return 1
    if cut.equal_pitch or cut.pitch is None:
        return cut.teeth
    pitch = np.asarray(cut.pitch)
    for shift in range(1, cut.teeth):
        if cut.teeth % shift == 0 and np.allclose(pitch, np.roll(pitch, shift), rtol=0, atol=1e-9):
            return cut.teeth // shift
    return 1


def simulate_cut(
    spindle_speed: float,
    depth: float,
    tip: TipModes,
    cut: Regeneration,
    *,
    feed_per_tooth: float,
    kte: float = 0.0,
    kre: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    revolutions: int = 100,
    steps_per_revolution: int | None = None,
    slices: int | None = None,
    kick: tuple[float, float] = (0.0, 0.0),
    linear: bool = False,
) -> TimeDomain:
    """Every step of one cut, from a tip at rest in the surface that a rigid tool has left.

    spindle_speed : rad/s   depth, feed_per_tooth : m, the feed that of the mean tooth   kte, kre : N/m
    runout : (c0, s0) = rho cos, sin of its angle from tooth 0 at the helix bottom, m
    steps_per_revolution : None: `steps_for`   slices : None: `slices_for`   kick : impulse on the tip at the start, N s
    linear : waves alone, no feed, and teeth that never leave the cut
    """
    steps = steps_per_revolution or steps_for(spindle_speed, depth, tip, cut)
    driven = _Driven(feed_per_tooth, kte, kre, runout)
    run = _start(spindle_speed, depth, tip, cut, driven, steps, slices, kick, linear, np.arange(steps))
    kept = run.forward(revolutions, revolutions).reshape(-1, 4)
    step = np.arange(len(kept))
    angle = step * (2 * np.pi / steps)
    return TimeDomain(angle / spindle_speed, angle, kept[:, :2].T, kept[:, 2:].T, steps)


def simulate_points(
    spindle_speed: np.ndarray,
    depth: np.ndarray,
    tip: TipModes,
    cut: Regeneration,
    *,
    feed_per_tooth: float,
    kte: float = 0.0,
    kre: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    revolutions: int = 400,
    kept: int = 200,
    phases: int = 8,
    steps_per_revolution: int | None = None,
    slices: int | None = None,
    kick: tuple[float, float] = (0.0, 0.0),
    linear: bool = False,
    undecided: Callable[[np.ndarray], bool] | None = None,
    most: int = 2000,
    progress: Callable[[float], None] | None = None,
) -> Strobed:
    """Many cuts, each looked at once per period in its last revolutions; for the other arguments see `simulate_cut`.

    spindle_speed, depth : (cut,) rad/s, m   kept : revolutions at the end that are looked at
    phases : of the period, evenly spread
    In a cut that repeats the surface advances by the feed at every angle: `astray` is 0. It is not where the tip has swung so
    far that it dug out what the passes after it should have cut.
    undecided : asked with the samples of one cut, (phase, flash, 2) m, whether as many more revolutions as are kept are wanted
    most : revolutions of one cut, at most   progress : told the share of the cuts that is done
    """
    speeds, depths = np.broadcast_arrays(np.asarray(spindle_speed, float), np.asarray(depth, float))
    per_revolution = flashes_per_revolution(cut, (0.0, 0.0) if linear else runout)
    found = np.empty((speeds.size, phases, kept * per_revolution, 2))
    ran, astray = np.empty(speeds.size, int), np.empty(speeds.size)
    total = 0
    driven = _Driven(feed_per_tooth, kte, kre, runout)
    for i, (speed, b) in enumerate(zip(speeds.ravel(), depths.ravel(), strict=True)):
        if progress is not None:
            progress(i / speeds.size)
        steps = steps_per_revolution or steps_for(float(speed), float(b), tip, cut)
        flash = np.arange(per_revolution)[:, np.newaxis] + np.arange(phases) / phases  # in periods
        sampled = np.floor(flash.ravel() * steps / per_revolution + 1e-9).astype(int)
        run = _start(float(speed), float(b), tip, cut, driven, steps, slices, kick, linear, sampled)
        run.forward(revolutions - kept, 0)
        while True:
            surface = run.surface.copy()
            rows = run.forward(kept, kept)
            samples = rows[..., :2].reshape(kept * per_revolution, phases, 2).transpose(1, 0, 2)
            if undecided is None or run.gone + kept > most or not undecided(samples):
                break
        found[i], ran[i], astray[i] = samples, run.gone, _astray(run, surface, kept)
        total += run.gone * steps
    return Strobed(found, per_revolution, astray, ran, total)


def _astray(run: "_Run", surface: np.ndarray, revolutions: int) -> float:
    """How far the surface has come in some revolutions, beside the feed across it, where that differs most; nan without a feed."""
    sine = np.where(run.entries.width > 0, run.entries.sine, 0.0)
    across = sine > ACROSS * sine.max()
    if run.edge.linear or not run.travel > 0 or not across.any():
        return np.nan
    return float(np.max(np.abs((run.surface - surface)[across] / (run.travel * revolutions * sine[across]) - 1)))


@dataclass
class _Run:
    """The tables of one cut and where it has got to."""

    entries: "kernel.Entries"
    stops: "kernel.Stops"
    moves: "kernel.Tip"
    edge: "kernel.Edge"
    depth: float
    travel: float  # of the feed in one revolution, m
    samples: int  # of a revolution
    state: np.ndarray
    surface: np.ndarray
    held: np.ndarray
    gone: int = 0  # revolutions

    def forward(self, revolutions: int, kept: int) -> np.ndarray:
        """More revolutions.   returns what was seen in the last of them, (kept, sample, 4) m and N"""
        from millcal.physics.stability.time_domain_kernel import run

        rows = np.empty((kept, self.samples, 4))
        run(
            self.entries, self.stops, self.moves, self.edge, self.depth, self.travel,
            self.gone, revolutions, self.state, self.surface, self.held, rows,
        )  # fmt: skip
        self.gone += revolutions
        return rows


def _start(
    spindle_speed: float,
    depth: float,
    tip: TipModes,
    cut: Regeneration,
    driven: _Driven,
    steps: int,
    slices: int | None,
    kick: tuple[float, float],
    linear: bool,
    sampled: np.ndarray,
) -> _Run:
    """A tip at rest but for a kick, and the surface of a rigid tool.   sampled : steps of a revolution looked at, rising"""
    from millcal.physics.stability import time_domain_kernel as kernel

    if cut.equal_pitch and steps % cut.teeth:
        raise ValueError(f"{steps=} of a revolution are no whole number for each of {cut.teeth} teeth")
    grip = depth * np.hypot(cut.ktc, cut.krc) * np.linalg.norm(tip.flexibility, 2) * np.ceil(cut.in_cut)
    if grip > GRIP:
        raise IllPosedError(
            f"stability.method: the flexibility above the modes gives way to the cut by {grip:.2g} of its own motion "
            "within one step of the time domain; use floquet, or fit the modes that it stands for"
        )
    feed, kte, kre, runout = _Driven(0.0, 0.0, 0.0, (0.0, 0.0)) if linear else driven
    slices = slices_for(depth, cut, steps) if slices is None else slices
    dt = 2 * np.pi / spindle_speed / steps
    travel = feed * cut.teeth
    step, sine, cosine, width, offset, before, tap, whole = _entries(cut, steps, depth, slices, runout)
    at = np.union1d(step, sampled)
    jumps, jump = np.unique(np.diff(at, append=at[0] + steps), return_inverse=True)
    s, ahead = tip.pole, jumps[:, np.newaxis] * dt
    push = np.exp(s * (ahead - dt)) * (np.exp(s * dt) - 1) / s
    sample = np.full(len(at), -1)
    sample[np.searchsorted(at, sampled)] = np.arange(len(sampled))
    ploughing = (0.0, 0.0)
    if cut.indentation:
        per_rate = cut.indentation / (cut.radius * spindle_speed)
        ploughing = (cut.indentation_friction * per_rate, per_rate)
    last = travel * ((step + 0.5) / steps - 1)  # where a rigid tool was in the revolution before
    return _Run(
        entries=kernel.Entries(
            np.searchsorted(step, np.append(at, steps)), sine, cosine, width, offset, before, tap, whole
        ),
        stops=kernel.Stops(
            jump.ravel(),
            jumps,
            travel * (at + 0.5) / steps,
            sample,
            np.exp(s * ahead),
            push[:, :, np.newaxis] * tip.given,
        ),
        moves=_moves(tip, dt),
        edge=kernel.Edge(cut.ktc, cut.krc, float(kte), float(kre), ploughing, linear),
        depth=depth,
        travel=travel,
        samples=len(sampled),
        state=tip.given @ np.asarray(kick, complex),
        surface=np.zeros(len(step)) if linear else last * sine + offset,
        held=np.zeros(2),
    )


def _moves(tip: TipModes, dt: float) -> "kernel.Tip":
    """`time_domain_kernel.Tip` of a step."""
    from millcal.physics.stability import time_domain_kernel as kernel

    s = tip.pole[:, np.newaxis]
    half = np.exp(s * dt / 2)
    late = 2 * tip.output * (half - 1)
    return kernel.Tip(
        2 * tip.output,
        2 * tip.output * half,
        2 * tip.output * half * s,
        np.einsum("mi,mj->ij", late / s, tip.given).real.copy(),
        np.einsum("mi,mj->ij", late, tip.given).real.copy(),
        np.ascontiguousarray(tip.flexibility, dtype=float),
        bool(np.any(tip.flexibility)),
    )


def _entries(
    cut: Regeneration, steps: int, depth: float, slices: int, runout: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """Step, sine, cosine, width, offset, before, tap and whole of `time_domain_kernel.Entries`, in the order of time.

    A tooth or slice whose lag is no whole number of steps has angles of its own, that part of a step behind.
    """
    turn = 2 * np.pi / steps
    pitch = np.full(cut.teeth, 2 * np.pi / cut.teeth) if cut.pitch is None else np.asarray(cut.pitch)
    height = (np.arange(slices) + 0.5) * depth / slices
    lag = np.concatenate([[0.0], np.cumsum(pitch)[:-1]])[:, np.newaxis] + cut.wind * height  # (tooth, slice)
    places = np.round(lag / turn, 9)
    shift = np.floor(places).astype(int)
    part = places - shift
    behind = np.roll(part, 1, axis=0) - part  # of the tooth before: its place at the same angle is that much farther
    whole = bool(np.all(np.abs(behind) < 1e-6))
    low = int(np.floor(cut.entry / turn)) - 2  # two steps more at either end for the cubic
    count = int(np.ceil(cut.leave / turn)) + 4 - low
    if count > steps or pitch.min() < 4 * turn:
        raise ValueError(f"{steps=} of a revolution are too few")
    place = low + np.arange(count)
    end = (place + 1 - part[..., np.newaxis]) * turn  # (tooth, slice, place)
    share = np.clip((np.minimum(end, cut.leave) - np.maximum(end - turn, cut.entry)) / turn, 0.0, 1.0)
    used = share > 1e-9 if whole else np.ones(share.shape, bool)
    step = (place + shift[..., np.newaxis]) % steps
    order = np.flatnonzero(used)
    order = order[np.argsort(step.ravel()[order], kind="stable")]
    number = np.full(step.size, -1)
    number[order] = np.arange(len(order))
    number = number.reshape(step.shape)

    at = np.arange(count) + (np.zeros_like(behind) if whole else behind)[..., np.newaxis]
    floor = np.floor(at + 1e-9).astype(int)
    t = at - floor
    taps = np.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ],
        axis=-1,
    )
    tooth, slice_ = np.ogrid[: cut.teeth, :slices]
    ahead = ((tooth - 1) % cut.teeth)[..., np.newaxis, np.newaxis]
    around = np.clip(floor[..., np.newaxis] + np.arange(-1, 3), 0, count - 1)
    before = number[ahead, slice_[..., np.newaxis, np.newaxis], around]
    middle = end - turn / 2
    if whole:  # else a place would not be at one angle for all teeth
        middle = (np.minimum(end, cut.leave) + np.maximum(end - turn, cut.entry)) / 2
    c0, s0 = runout
    offset = np.broadcast_to((c0 * np.cos(lag) - s0 * np.sin(lag))[..., np.newaxis], step.shape)

    def in_order(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values.reshape(step.size, *values.shape[3:])[order])

    angle = in_order(middle)
    return (
        in_order(step), np.sin(angle), np.cos(angle), in_order(share) / slices, in_order(offset),
        in_order(before), in_order(taps), whole,
    )  # fmt: skip
