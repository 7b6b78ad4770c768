"""Cuts that may chatter, as sensors on the structure would have recorded them.

`simulate_cut` lets a known force act; here the force comes from the motion, by `physics.stability.time_domain`, with teeth that
leave the cut. The force of every step then goes through the structure to each sensor, exactly in the frequency domain, so
that the tool rings on when it has left the work. A recorder's anti-aliasing filter, flat to 0.4 of the sample rate and shut
at half of it, stands before the samples.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import Channel, Recording
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import LinearEdge
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode, receptance_between
from millcal.physics.spindle import SpindleMotion
from millcal.physics.stability.regeneration import Regeneration, tip_of_shapes
from millcal.physics.stability.time_domain import TimeDomain, simulate_cut
from millcal.simulation.cuts import SETTLED, Timeline
from millcal.simulation.noise import measured
from millcal.simulation.truth import rounded, shop_conditions

IN_PLANE = ("tipX", "tipY")
FLAT, SHUT = 0.4, 0.5  # of the sample rate
LAST_TURNS = 50  # that the truth is told of


def simulate_regenerative_cut(
    law: LinearEdge,
    cutter: Cutter,
    conditions: CuttingConditions,
    *,
    rng: np.random.Generator,
    sample_rate: float,
    timeline: Timeline,
    modes: Sequence[ShapedMode],
    speed_error: float = 0.0,
    accelerometers: Sequence[str] = (),
    accelerometer: MeasuringChain = MeasuringChain(),
    displacements: Sequence[str] = (),
    probe: MeasuringChain = MeasuringChain(),
    pulse: bool = False,
    name: str = "",
) -> tuple[Recording, dict]:
    """One cut as a measuring chain would have recorded it, and the truth behind it (JSON, in the shop's units).

    Edge coefficients make force in x and y; nothing acts along z. The tool enters and leaves at once.

    sample_rate : Hz   modes : of the structure; their shapes at tipX and tipY are what regenerates
    speed_error : share by which the spindle misses the conditions' speed
    accelerometers, displacements : dofs that are measured   pulse : one a turn, at the angle zero of tooth 0
    """
    frequency = conditions.spindle_speed / (2 * np.pi) * (1 + speed_error)
    natural = np.array([mode.natural_frequency for mode in modes])
    shape = np.array(
        [mode.at(IN_PLANE) * 2 * np.pi * mode.natural_frequency / np.sqrt(mode.stiffness) for mode in modes]
    )
    tip = tip_of_shapes(natural, np.array([mode.damping_ratio for mode in modes]), shape)
    cut = Regeneration(
        cutter.teeth,
        *engagement(conditions, cutter.diameter),
        float(law.cutting[0]),
        float(law.cutting[1]),
        pitch=cutter.pitch,
        wind=float(np.tan(cutter.helix) / cutter.radius),
    )
    motion = simulate_cut(
        2 * np.pi * frequency,
        conditions.axial_depth,
        tip,
        cut,
        feed_per_tooth=conditions.feed_per_tooth,
        kte=float(law.edge[0]),
        kre=float(law.edge[1]),
        runout=(cutter.runout * np.cos(cutter.runout_angle), cutter.runout * np.sin(cutter.runout_angle)),
        revolutions=int(np.ceil(timeline.steady * frequency)),
    )
    time = np.arange(round(timeline.duration * sample_rate)) / sample_rate
    sensors = [*accelerometers, *displacements]
    derivatives = np.repeat([2, 0], [len(accelerometers), len(displacements)])
    heard = _heard(motion, modes, sensors, derivatives, timeline, frequency, sample_rate, time)
    split = len(accelerometers)
    parts, channels = [], []
    if accelerometers:
        gained = _through(heard[:split], accelerometer, sample_rate)
        parts.append(measured(gained, accelerometer, sample_rate, rng, time=time))
        channels += [
            Channel("acc_" + dof, "acceleration", "m/s^2", dof, accelerometer.full_scale) for dof in accelerometers
        ]
    if displacements:
        parts.append(measured(_through(heard[split:], probe, sample_rate), probe, sample_rate, rng, time=time))
        channels += [Channel("disp_" + dof, "displacement", "m", dof, probe.full_scale) for dof in displacements]
    if pulse:
        begin = timeline.steady_span[0]
        turning = SpindleMotion(frequency, -2 * np.pi * frequency * begin, 0.0, 1.0)
        parts.append(np.atleast_2d(turning.pulse(time, 0.0, np.pi / 18)))
        channels.append(Channel("pulse", "pulse", "1", "spindle", 1.0))
    recording = Recording(
        samples=np.vstack(parts),
        sample_rate=sample_rate,
        channels=tuple(channels),
        name=name,
        cutter=replace(cutter, runout=0.0, runout_angle=0.0),  # nobody at the machine knows it
        conditions=conditions,
    )
    truth = {
        "kind": "cut",
        "conditions": shop_conditions(conditions),
        "spindle_frequency_hz": rounded(frequency),
        "steady_s": [rounded(t) for t in timeline.steady_span],
        **_repetition(motion, cutter.teeth),
    }
    return recording, truth


def _heard(
    motion: TimeDomain,
    modes: Sequence[ShapedMode],
    sensors: Sequence[str],
    derivatives: np.ndarray,
    timeline: Timeline,
    frequency: float,
    sample_rate: float,
    time: np.ndarray,
) -> np.ndarray:
    """What the structure does at each sensor under the force of every step.   time : (sample,) s   returns (sensor, sample)"""
    from scipy.interpolate import CubicSpline

    own = motion.steps_per_revolution * frequency
    settle = np.log(1 / SETTLED) / min(mode.decay_rate for mode in modes)
    before = int(np.ceil(timeline.steady_span[0] * own))
    held = motion.force[:, : int(timeline.steady * own)]
    total = 1 << int(np.ceil(np.log2((timeline.duration + settle) * own + before + 8)))
    force = np.zeros((2, total))
    force[:, before : before + held.shape[1]] = held
    f = np.fft.rfftfreq(total, 1 / own)
    through = (
        receptance_between(f, modes, sensors, IN_PLANE)
        * ((2j * np.pi * f)[:, np.newaxis] ** derivatives)[..., np.newaxis]
    )
    hold = np.exp(-1j * np.pi * f / own) * np.sinc(f / own)  # a force that stands still over a step
    roll = np.clip((f / sample_rate - FLAT) / (SHUT - FLAT), 0.0, 1.0)
    answer = np.einsum("fsa,af->sf", through, np.fft.rfft(force)) * hold * (0.5 + 0.5 * np.cos(np.pi * roll))
    steps = np.fft.irfft(answer, total)
    late = before / own - timeline.steady_span[0]  # the first step lies between two samples
    at = np.arange(total) / own - late
    return np.array([CubicSpline(at, row)(time) for row in steps])


def _through(values: np.ndarray, chain: MeasuringChain, sample_rate: float) -> np.ndarray:
    """Signals through the chain's low-pass.   values : (sensor, sample)"""
    if chain.lowpass is None:
        return values
    n = values.shape[1]
    gain = chain.gain(np.fft.rfftfreq(2 * n, 1 / sample_rate), len(values))
    return np.fft.irfft(np.fft.rfft(values, 2 * n) * gain, 2 * n)[:, :n]


def _repetition(motion: TimeDomain, teeth: int) -> dict[str, float]:
    """How much the motion of the tip changes from turn to turn, and from tooth to tooth, in its last turns."""
    turn = motion.steps_per_revolution
    turns = motion.displacement[:, -LAST_TURNS * turn :].reshape(2, -1, turn)
    by_tooth = turns.reshape(2, -1, turn // teeth)
    return {
        "change_per_turn_um": round(1e6 * float(np.abs(np.diff(turns, axis=1)).mean(axis=1).max()), 4),
        "change_per_tooth_um": round(1e6 * float(np.abs(np.diff(by_tooth, axis=1)).mean(axis=1).max()), 4),
    }
