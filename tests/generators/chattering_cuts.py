"""Recordings of cuts that are stable, flip or chatter, as a displacement sensor, an accelerometer or a microphone has them.

The motion comes from the simulation in the time domain, so its lines are those of the waves between the teeth, with teeth that
leave the cut, and nothing of them is drawn by hand. What it truly is, the motion itself says.
"""

from dataclasses import dataclass

import numpy as np

from millcal.data import Channel, Recording
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.stability.regeneration import Regeneration, tip_of_shapes
from millcal.physics.stability.time_domain import TimeDomain, simulate_cut

KTC, KRC = 600e6, 200e6
NATURAL, DAMPING, STIFFNESS = np.array([922.0, 1100.0]), np.array([0.011, 0.02]), np.array([1.34e6, 2.0e6])
DIAMETER = 12e-3
QUANTITIES = {"displacement": "m", "acceleration": "m/s^2", "sound_pressure": "Pa"}
MOVES = 0.01  # of the feed: less from turn to turn is none
LITTLE, MUCH = 0.05, 0.25  # of the feed, amplitude from tooth to tooth: every other tooth leaves the cut at a half


@dataclass(frozen=True)
class Cut:
    """One cut that may chatter."""

    teeth: int
    rpm: float
    depth: float  # m
    immersion: float  # a_e / D
    direction: str = "down"
    feed: float = 0.1e-3  # m
    modes: int = 2  # along x, then y too

    @property
    def conditions(self) -> CuttingConditions:
        speed = self.rpm * 2 * np.pi / 60
        return CuttingConditions(speed, self.feed, self.depth, self.immersion * DIAMETER, self.direction)

    def run(self, runout: float = 0.0, angle: float = 0.3, revolutions: int = 250, speed: float = 1.0) -> TimeDomain:
        """The cut in the time domain.   runout : m   angle : rad   speed : by what factor the spindle misses its speed"""
        w = 2 * np.pi * NATURAL[: self.modes]
        shape = np.diag(w / np.sqrt(STIFFNESS[: self.modes]))
        tip = tip_of_shapes(NATURAL[: self.modes], DAMPING[: self.modes], np.pad(shape, ((0, 0), (0, 2 - self.modes))))
        cut = Regeneration(self.teeth, *engagement(self.conditions, DIAMETER), KTC, KRC)
        return simulate_cut(
            self.conditions.spindle_speed * speed,
            self.depth,
            tip,
            cut,
            feed_per_tooth=self.feed,
            runout=(runout * np.cos(angle), runout * np.sin(angle)),
            revolutions=revolutions,
        )

    def truth(self, found: TimeDomain) -> str:
        """What a cut with its runout does in the end: `stable`, `alternates`, `unclear` between the two, or `chatter`.

        A motion that comes back every turn may still differ from tooth to tooth by more than the teeth's offsets explain.
        """
        turn = found.steps_per_revolution
        tooth = turn // self.teeth
        turns = found.displacement[0][-40 * turn :].reshape(-1, turn)
        if np.abs(np.diff(turns, axis=0)).mean(axis=0).max() > MOVES * self.feed:
            return "chatter"
        by_tooth = turns.mean(axis=0).reshape(self.teeth, tooth)
        ways = np.abs(np.fft.rfft(by_tooth, axis=0))[1:] / self.teeth * 2  # of teeth that differ
        if self.teeth % 2 == 0:
            ways[-1] /= 2
        swing = ways.max(initial=0.0) / self.feed
        alike = by_tooth.mean(axis=0)
        if swing > MUCH and np.var(by_tooth - alike) < np.var(alike):
            return "unclear"  # a large forced vibration with some runout in it
        return "stable" if swing < LITTLE else "alternates" if swing > MUCH else "unclear"


def recorded(
    found: TimeDomain,
    cut: Cut,
    quantity: str,
    rng: np.random.Generator,
    *,
    rate: float = 12_800.0,
    noise: float = 0.03,
    lead: float = 0.3,
    air: float = 0.0,
    tone: float = 0.0,
    name: str = "cut.h5",
) -> Recording:
    """What a sensor makes of the motion along x.

    noise : rms over that of the signal   lead : share of the cut that is left out at the beginning
    air : s of noise before   tone : amplitude of another machine's hum at 1237 Hz, over the rms; in the air too
    """
    dt = found.time[1] - found.time[0]
    x = _band_limited(found.displacement[0], 1 / dt, rate, quantity, rng)
    x = x[int(lead * len(x)) :]
    size = float(np.std(x))
    x = np.concatenate([np.full(round(air * rate), x.mean()), x])
    x = x + noise * size * rng.normal(size=len(x))
    x = x + tone * size * np.cos(2 * np.pi * 1237.0 * np.arange(len(x)) / rate)
    return Recording(
        samples=x[np.newaxis],
        sample_rate=rate,
        channels=(Channel("sensor", quantity, QUANTITIES[quantity], "tipX"),),
        name=name,
        cutter=Cutter(diameter=DIAMETER, teeth=cut.teeth),
        conditions=cut.conditions,
    )


def _band_limited(x: np.ndarray, own: float, rate: float, quantity: str, rng: np.random.Generator) -> np.ndarray:
    """Samples at the recorder's rate, nothing above 0.45 of it; sound goes by a room of its own."""
    from scipy.interpolate import CubicSpline

    n = len(x)
    spectrum = np.fft.rfft(np.concatenate([x, x[::-1]]))
    frequency = np.fft.rfftfreq(2 * n, 1 / own)
    spectrum[frequency > 0.45 * rate] = 0.0
    if quantity != "displacement":
        spectrum *= -((2 * np.pi * frequency) ** 2)
    if quantity == "sound_pressure":  # echoes, and little below 200 Hz
        delay, size = rng.uniform(0.0, 0.02, 12), rng.normal(size=12) * 0.01
        spectrum *= (frequency / (frequency + 200.0)) * (
            0.02 + np.exp(-2j * np.pi * np.multiply.outer(frequency, delay)) @ size
        )
    y = np.fft.irfft(spectrum, 2 * n)[:n]
    at = np.arange(2 / rate, (n - 1) / own - 4 / rate, 1 / rate)
    return CubicSpline(np.arange(n) / own, y)(at)
