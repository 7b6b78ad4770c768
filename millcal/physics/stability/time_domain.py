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
from typing import NamedTuple

import numpy as np

from millcal.errors import IllPosedError
from millcal.physics.stability.regeneration import Regeneration, TipModes

PER_WAVE = 40  # steps to the shortest wave of the tip
IN_CUT = 40  # steps of a tooth in cut, at least
LEAST = 200  # steps of a revolution
LAG = 2  # steps that the edge of one slice lags, at most


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
    revolutions: np.ndarray  # how many were run, integer (cut,)
    steps: int  # of time, of all cuts together


def steps_for(spindle_speed: float, depth: float, tip: TipModes, cut: Regeneration) -> int:
    """Steps of a revolution that resolve the waves of the tip, which the cut makes stiffer, and the passage of a tooth."""
    stiffer = depth * np.hypot(cut.ktc, cut.krc) * np.sum(_participation(tip))
    highest = np.sqrt(np.max(np.abs(tip.pole), initial=0.0) ** 2 + stiffer)
    wanted = max(PER_WAVE * highest / spindle_speed, IN_CUT * 2 * np.pi / (cut.leave - cut.entry), LEAST)
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
    run = _Run(
        spindle_speed, depth, tip, cut, (feed_per_tooth, kte, kre, runout), steps_per_revolution, slices, kick, linear
    )
    run.lay_out(np.arange(run.steps))
    kept = run.forward(revolutions, revolutions).reshape(-1, 4)
    step = np.arange(len(kept))
    return TimeDomain(step * run.dt, step * spindle_speed * run.dt, kept[:, :2].T, kept[:, 2:].T, run.steps)


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
    undecided : asked with the samples of one cut, (phase, flash, 2) m, whether as many more revolutions as are kept are wanted
    most : revolutions of one cut, at most   progress : told the share of the cuts that is done
    """
    speeds, depths = np.broadcast_arrays(np.asarray(spindle_speed, float), np.asarray(depth, float))
    per_revolution = flashes_per_revolution(cut, (0.0, 0.0) if linear else runout)
    found = np.empty((speeds.size, phases, kept * per_revolution, 2))
    ran = np.empty(speeds.size, int)
    total = 0
    for i, (speed, b) in enumerate(zip(speeds.ravel(), depths.ravel(), strict=True)):
        if progress is not None:
            progress(i / speeds.size)
        run = _Run(
            float(speed),
            float(b),
            tip,
            cut,
            (feed_per_tooth, kte, kre, runout),
            steps_per_revolution,
            slices,
            kick,
            linear,
        )
        period = run.steps / per_revolution
        at = np.arange(per_revolution)[:, np.newaxis] * period + np.arange(phases) * period / phases
        run.lay_out(np.floor(at.ravel() + 1e-9).astype(int))
        rows = run.forward(revolutions, kept)
        while True:
            samples = rows[..., :2].reshape(kept * per_revolution, phases, 2).transpose(1, 0, 2)
            if undecided is None or run.gone + kept > most or not undecided(samples):
                break
            rows = run.forward(kept, kept)
        found[i], ran[i] = samples, run.gone
        total += run.gone * run.steps
    return Strobed(found, per_revolution, ran, total)


class _Run:
    """The tables of one cut and where it has got to."""

    def __init__(
        self,
        spindle_speed: float,
        depth: float,
        tip: TipModes,
        cut: Regeneration,
        driven: tuple[float, float, float, tuple[float, float]],
        steps: int | None,
        slices: int | None,
        kick: tuple[float, float],
        linear: bool,
    ) -> None:
        from millcal.physics.stability import time_domain_kernel as kernel

        self.kernel = kernel
        feed, kte, kre, runout = (0.0, 0.0, 0.0, (0.0, 0.0)) if linear else driven
        self.steps = steps_for(spindle_speed, depth, tip, cut) if steps is None else steps
        if cut.equal_pitch and self.steps % cut.teeth:
            raise ValueError(f"{self.steps=} of a revolution are no whole number for each of {cut.teeth} teeth")
        self.dt = 2 * np.pi / spindle_speed / self.steps
        self.tip, self.cut, self.depth = tip, cut, depth
        self.travel = feed * cut.teeth
        self.runout = runout
        self.slices = slices_for(depth, cut, self.steps) if slices is None else slices
        flexible = bool(np.any(tip.flexibility))
        grip = depth * np.hypot(cut.ktc, cut.krc) * np.linalg.norm(tip.flexibility, 2) * np.ceil(cut.in_cut)
        if flexible and grip > 0.9:
            raise IllPosedError(
                f"stability.method: the flexibility above the modes gives way to the cut by {grip:.2g} of its own motion "
                "within one step of the time domain; use floquet, or fit the modes that it stands for"
            )
        half = np.exp(tip.pole * self.dt / 2)[:, np.newaxis]
        late = 2 * tip.output * (half - 1)
        self.moves = kernel.Tip(
            2 * tip.output,
            2 * tip.output * half,
            2 * tip.output * half * tip.pole[:, np.newaxis],
            np.einsum("mi,mj->ij", late / tip.pole[:, np.newaxis], tip.given).real.copy(),
            np.einsum("mi,mj->ij", late, tip.given).real.copy(),
            np.ascontiguousarray(tip.flexibility, dtype=float),
            flexible,
        )
        ploughing = (0.0, 0.0)
        if cut.indentation:
            per_rate = cut.indentation / (cut.radius * spindle_speed)
            ploughing = (cut.indentation_friction * per_rate, per_rate)
        self.edge = kernel.Edge(cut.ktc, cut.krc, float(kte), float(kre), ploughing, linear)
        self.state = tip.given @ np.asarray(kick, complex)
        self.held = np.zeros(2)
        self.gone = 0

    def lay_out(self, sampled: np.ndarray) -> None:
        """The tables of one revolution.   sampled : steps that are looked at, rising, integer (sample,)"""
        step, sine, cosine, width, offset, before, tap, whole = _entries(
            self.cut, self.steps, self.depth, self.slices, self.runout
        )
        stops = np.union1d(step, sampled)
        jumps = np.diff(stops, append=stops[0] + self.steps)
        distinct, jump = np.unique(jumps, return_inverse=True)
        s, turn = self.tip.pole, distinct[:, np.newaxis] * self.dt
        push = np.exp(s * (turn - self.dt)) * (np.exp(s * self.dt) - 1) / s
        sample = np.full(len(stops), -1)
        sample[np.searchsorted(stops, sampled)] = np.arange(len(sampled))
        travel = self.travel * (stops + 0.5) / self.steps
        self.stops = self.kernel.Stops(
            jump.ravel(), distinct, travel, sample, np.exp(s * turn), push[:, :, np.newaxis] * self.tip.given
        )
        first = np.searchsorted(step, np.append(stops, self.steps))
        self.entries = self.kernel.Entries(first, sine, cosine, width, offset, before, tap, whole)
        self.samples = len(sampled)
        last = self.travel * ((step + 0.5) / self.steps - 1)  # where a rigid tool was in the revolution before
        self.surface = np.zeros(len(step)) if self.edge.linear else last * sine + offset

    def forward(self, revolutions: int, kept: int) -> np.ndarray:
        """More revolutions.   returns what was seen in the last of them, (kept, sample, 4) m and N"""
        rows = np.empty((kept, self.samples, 4))
        self.kernel.run(
            self.entries, self.stops, self.moves, self.edge, self.depth, self.travel,
            self.gone, revolutions, self.state, self.surface, self.held, rows,
        )  # fmt: skip
        self.gone += revolutions
        return rows


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
