"""Cuts as recorded: force on the tool, accelerations of the structure, and a pulse per revolution.

The force is a Fourier series in the spindle angle whose coefficients `physics.cutting_force` integrates exactly. It is cut
off below half the sample rate and evaluated at each sample's angle, so it is exact at any speed and free of aliasing.
Sensors and structure act on each harmonic by their gain at its frequency: the steady state, which holds at constant or
slowly varying speed. Coefficients that change while cutting are weights on several such series (`physics.changing_coefficients`).
The tool enters and leaves by a cosine ramp of the force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import AXES, Channel, Recording
from millcal.physics.changing_coefficients import Trend, force_series
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge, force_harmonics
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode, accelerance_between
from millcal.physics.spindle import SpindleMotion
from millcal.simulation.noise import measured
from millcal.simulation.truth import rounded, shop_values, truth_over_time

TIP = ("tipX", "tipY", "tipZ")
BLOCK = 8192  # samples: three axes of complex numbers stay in the cache
INSTANTS = 201  # at which the truth of changing coefficients is told


@dataclass(frozen=True)
class Timeline:
    """How long the tool is in the air, entering, cutting, leaving, and in the air again; all in s."""

    steady: float
    air_before: float = 0.0
    air_after: float = 0.0
    ramp: float = 0.0  # entry, and exit as long again

    @property
    def duration(self) -> float:
        """s"""
        return self.air_before + 2 * self.ramp + self.steady + self.air_after

    @property
    def steady_span(self) -> tuple[float, float]:
        """From, to, s after the first sample."""
        begin = self.air_before + self.ramp
        return begin, begin + self.steady

    def engagement(self, time: np.ndarray) -> np.ndarray:
        """Share of the full force, 0 in the air and 1 in the steady cut.   time : (t,) s   returns (t,)"""
        begin, end = self.steady_span
        if self.ramp == 0:
            return ((time >= begin) & (time < end + 1e-12)).astype(float)
        outside = np.maximum(begin - time, time - end) / self.ramp
        return 0.5 + 0.5 * np.cos(np.pi * np.clip(outside, 0.0, 1.0))


@dataclass(frozen=True)
class Line:
    """A vibration that does not follow the spindle: a force at a frequency of its own, as chatter makes it."""

    frequency: float  # Hz
    amplitude: tuple[float, float, float]  # N, in x, y, z of the tool


def synthesise(harmonics: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Re sum_k c_k exp(j k angle) by Horner's scheme, block by block; `cutting_force.force_at` is the plain form.

    harmonics : complex (row, k)   angle : (sample,) rad   returns (row, sample)
    """
    result = np.empty((len(harmonics), len(angle)))
    for start in range(0, len(angle), BLOCK):
        turn = np.exp(1j * angle[start : start + BLOCK])
        total = np.broadcast_to(harmonics[:, -1:], (len(harmonics), len(turn))).copy()
        for coefficient in harmonics[:, -2::-1].T:
            total *= turn
            total += coefficient[:, np.newaxis]
        result[:, start : start + BLOCK] = total.real
    return result


def simulate_cut(
    law: LinearEdge | Kienzle,
    cutter: Cutter,
    conditions: CuttingConditions,
    *,
    rng: np.random.Generator,
    sample_rate: float,
    timeline: Timeline,
    initial_angle: float | None = 0.0,
    speed_error: float = 0.0,
    variation: float = 0.0,
    variation_frequency: float = 1.0,
    dynamometer: MeasuringChain | None = MeasuringChain(),
    modes: Sequence[ShapedMode] = (),
    accelerometers: Sequence[str] = (),
    accelerometer: MeasuringChain = MeasuringChain(),
    lines: Sequence[Line] = (),
    pulse: bool = False,
    pulse_angle: float = 0.0,
    encoder: int = 0,
    trend: Trend | None = None,
    start_time: float = 0.0,
    name: str = "",
    axis_map: Mapping[str, str] | None = None,
    acts_on: str = "tool",
) -> tuple[Recording, dict]:
    """One cut as a measuring chain would have recorded it, and the truth behind it (JSON, in the shop's units).

    sample_rate : Hz   initial_angle : rad, of the spindle at the first sample; None: drawn
    speed_error : share by which the spindle misses the conditions' speed   variation, variation_frequency : as SpindleMotion
    dynamometer : None leaves the force channels out
    modes, accelerometers : structure, and the dofs at which its acceleration under the cutting force is measured
    pulse_angle : rad, spindle angle at which the once-per-revolution pulse rises, and the encoder's zero
    encoder : counts per revolution of an encoder that is recorded, from 0 to 2 pi; 0 for none
    trend : how the coefficients change while cutting; None: they do not   start_time : s, of the first sample
    axis_map, acts_on : name and turn the force channels as `as_dynamometer_channels` does; None: the tool's axes
    """
    initial_angle = rng.uniform(0.0, 2 * np.pi) if initial_angle is None else initial_angle
    frequency = conditions.spindle_speed / (2 * np.pi) * (1 + speed_error)
    motion = SpindleMotion(frequency, initial_angle, variation, variation_frequency)
    time = np.arange(round(timeline.duration * sample_rate)) / sample_rate
    highest = int(np.ceil(sample_rate / 2 / motion.highest_frequency)) - 1
    if trend is None:
        force = force_harmonics(law, cutter, conditions, highest)[np.newaxis]  # (series, axis, k)
        weights, mean = None, force[0, :, 0].real
    else:
        series = force_series(law, trend, cutter, conditions, highest, time)
        begin, end = timeline.steady_span
        force, weights, mean = series.harmonics, series.weights, series.mean_force((time >= begin) & (time <= end))
    order_frequency = np.arange(highest + 1) * motion.frequency
    line_phase = rng.uniform(0.0, 2 * np.pi, len(lines))
    line_frequency = np.array([line.frequency for line in lines])
    line_force = np.array([line.amplitude for line in lines]).reshape(-1, 3).T * np.exp(1j * line_phase)  # (axis, line)

    channels: list[Channel] = []
    harmonics, line_parts, chains = [], [], []
    if dynamometer is not None:
        channels += [
            Channel("f" + axis, "force", "N", dof, dynamometer.full_scale) for axis, dof in zip(AXES, TIP, strict=True)
        ]
        transfer = dynamometer.transfer(order_frequency, 3)
        harmonics.append(np.array([np.einsum("imk,mk->ik", transfer, part) for part in force]))
        line_parts.append(np.einsum("imk,mk->ik", dynamometer.transfer(line_frequency, 3), line_force))
        chains.append((dynamometer, 3))
    if accelerometers:
        n = len(accelerometers)
        channels += [
            Channel("acc_" + dof, "acceleration", "m/s^2", dof, accelerometer.full_scale) for dof in accelerometers
        ]
        at_orders, at_lines = (
            np.moveaxis(accelerance_between(at, modes, accelerometers, TIP), 0, 2)  # (sensor, axis, f)
            for at in (order_frequency, line_frequency)
        )
        gain = accelerometer.gain(order_frequency, n)
        harmonics.append(np.array([np.einsum("saf,af->sf", at_orders, part) * gain for part in force]))
        line_parts.append(np.einsum("saf,af->sf", at_lines, line_force) * accelerometer.gain(line_frequency, n))
        chains.append((accelerometer, n))

    angle = motion.angle(time)
    parts = np.concatenate(harmonics, axis=1)  # (series, channel, k)
    if weights is None:
        samples = synthesise(parts[0], angle)
    else:
        samples = np.zeros((parts.shape[1], len(time)))
        for part, weight in zip(parts, weights, strict=True):
            samples += weight * synthesise(part, angle)
    for frequency, amplitude in zip(line_frequency, np.concatenate(line_parts).T, strict=True):
        samples += np.real(amplitude[:, np.newaxis] * np.exp(2j * np.pi * frequency * time))
    samples *= timeline.engagement(time)
    first = 0
    for chain, n in chains:
        samples[first : first + n] = measured(samples[first : first + n], chain, sample_rate, rng, time=time)
        first += n
    if pulse:
        channels.append(Channel("pulse", "pulse", "1", "spindle", 1.0))
        samples = np.vstack([samples, motion.pulse(time, pulse_angle, np.pi / 18)])
    if encoder:
        channels.append(Channel("encoder", "angle", "rad", "spindle"))
        count = np.floor((angle - pulse_angle) / (2 * np.pi) % 1.0 * encoder) % encoder
        samples = np.vstack([samples, count * (2 * np.pi / encoder)])

    recording = Recording(
        samples=samples,
        sample_rate=sample_rate,
        channels=tuple(channels),
        name=name,
        start_time=start_time,
        cutter=replace(cutter, runout=0.0, runout_angle=0.0),  # nobody at the machine knows it
        conditions=conditions,
    )
    if axis_map:
        recording = as_dynamometer_channels(recording, axis_map, acts_on)
    truth = {
        "kind": "cut",
        "conditions": shop_values(
            spindle_speed_rpm=conditions.spindle_speed,
            feed_per_tooth_mm=conditions.feed_per_tooth,
            axial_depth_mm=conditions.axial_depth,
            radial_depth_mm=conditions.radial_depth,
        )
        | {"direction": conditions.direction},
        "spindle_frequency_hz": rounded(motion.frequency),
        "steady_s": [rounded(t) for t in timeline.steady_span],
        "mean_force_N": [rounded(value) for value in mean],  # on the tool, in the steady cut
        **shop_values(initial_angle_deg=motion.initial_angle),
    }
    if trend is not None:
        truth["coefficients"] = truth_over_time(law, trend, np.linspace(*timeline.steady_span, INSTANTS))
    return recording, truth


def as_dynamometer_channels(recording: Recording, axis_map: Mapping[str, str], acts_on: str = "tool") -> Recording:
    """The recording with its forces as a table dynamometer names and signs them: the inverse of what an ingest does.

    axis_map : tool axis -> signed channel, e.g. fx = "+Fy"   acts_on : "workpiece" turns the force into its reaction
    """
    reaction = -1.0 if acts_on == "workpiece" else 1.0
    samples = np.array(recording.samples)
    channels = list(recording.channels)
    own = {channel.name: row for row, channel in enumerate(recording.channels)}
    columns = []
    for tool_axis, column in axis_map.items():
        sign = -1.0 if column.startswith("-") else 1.0
        row = own[tool_axis]
        samples[row] *= sign * reaction
        channels[row] = replace(channels[row], name=column.lstrip("+-"), dof="")
        columns.append(row)
    rest = [row for row in range(len(channels)) if row not in columns]
    order = sorted(columns, key=lambda row: channels[row].name) + rest
    return replace(recording, samples=samples[order], channels=tuple(channels[row] for row in order))
