"""Cuts as recorded: force on the tool, accelerations of the structure, and a pulse per revolution.

The force is a Fourier series in the spindle angle whose coefficients `physics.cutting_force` integrates exactly. It is cut
off below half the sample rate and evaluated at each sample's angle, so it is exact at any speed and free of aliasing.
The dynamometer acts on each harmonic by its gain at the harmonic's frequency: the steady state, which holds at constant or
slowly varying speed. The structure rings longer, so accelerometers hear it as it is set going and left alone. Coefficients
that change while cutting are weights on several such series (`physics.changing_coefficients`). The tool enters and leaves by
a cosine ramp of the force.
"""

from collections.abc import Callable, Mapping, Sequence
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
from millcal.simulation.truth import rounded, shop_conditions, shop_values, truth_over_time

TIP = ("tipX", "tipY", "tipZ")
BLOCK = 8192  # samples: three axes of complex numbers stay in the cache
SETTLED = 1e-12  # share of a mode's ringing that is left
AFTER = 256  # samples
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


def accelerations(
    force: Callable[[np.ndarray], np.ndarray],
    modes: Sequence[ShapedMode],
    sensors: Sequence[str],
    chain: MeasuringChain,
    sample_rate: float,
    n_samples: int,
) -> np.ndarray:
    """What the structure answers to a force at the tip, with the ringing of its modes, through the sensors' chain.

    The force is asked for from long before the record, so that a cut in which the record begins has settled by then, and
    until a little after it; there it fades, since the period of the transform may not begin and end with a jump.

    force : function of time, (t,) s -> (axis, t) N   returns (sensor, n_samples) m/s^2
    """
    slowest = min(part.decay_rate for part in (*modes, chain))
    settle = np.log(1 / SETTLED) / slowest * sample_rate
    period = 1 << int(np.ceil(np.log2(n_samples + settle + 2 * AFTER)))
    before = period - n_samples - AFTER
    frequency = np.fft.rfftfreq(period, 1 / sample_rate)
    driven = force(np.arange(-before, period - before) / sample_rate)
    fading = 0.5 + 0.5 * np.cos(np.pi * (np.arange(AFTER) + 0.5) / AFTER)
    driven[:, -AFTER:] *= fading
    driven[:, :AFTER] *= fading[::-1]
    spectrum = np.fft.rfft(driven)
    answer = np.einsum("fsa,af->sf", accelerance_between(frequency, modes, sensors, TIP), spectrum)
    answer *= chain.gain(frequency, len(sensors))
    return np.fft.irfft(answer, period)[:, before : before + n_samples]


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

    def drive(harmonics: np.ndarray, at_lines: np.ndarray, at: np.ndarray) -> np.ndarray:
        """A force through the steady state, (row, sample); before the record and after it as at its ends.   at : (sample,) s"""
        angle, nearest = motion.angle(at), np.clip(at, time[0], time[-1])
        if weights is None:
            samples = synthesise(harmonics[0], angle)
        else:
            samples = np.zeros((harmonics.shape[1], len(at)))
            place = np.rint(nearest * sample_rate).astype(int)
            for part, weight in zip(harmonics, weights, strict=True):
                samples += weight[place] * synthesise(part, angle)
        for frequency, amplitude in zip(line_frequency, at_lines.T, strict=True):
            samples += np.real(amplitude[:, np.newaxis] * np.exp(2j * np.pi * frequency * at))
        return samples * timeline.engagement(nearest)

    channels: list[Channel] = []
    parts = []
    if dynamometer is not None:
        channels += [
            Channel("f" + axis, "force", "N", dof, dynamometer.full_scale) for axis, dof in zip(AXES, TIP, strict=True)
        ]
        transfer = dynamometer.transfer(order_frequency, 3)
        through = np.array([np.einsum("imk,mk->ik", transfer, part) for part in force])
        at_lines = np.einsum("imk,mk->ik", dynamometer.transfer(line_frequency, 3), line_force)
        parts.append(measured(drive(through, at_lines, time), dynamometer, sample_rate, rng, time=time))
    if accelerometers:
        channels += [
            Channel("acc_" + dof, "acceleration", "m/s^2", dof, accelerometer.full_scale) for dof in accelerometers
        ]
        heard = accelerations(
            lambda at: drive(force, line_force, at), modes, accelerometers, accelerometer, sample_rate, len(time)
        )
        parts.append(measured(heard, accelerometer, sample_rate, rng, time=time))
    samples = np.vstack(parts)
    if pulse:
        channels.append(Channel("pulse", "pulse", "1", "spindle", 1.0))
        samples = np.vstack([samples, motion.pulse(time, pulse_angle, np.pi / 18)])
    if encoder:
        channels.append(Channel("encoder", "angle", "rad", "spindle"))
        count = np.floor((motion.angle(time) - pulse_angle) / (2 * np.pi) % 1.0 * encoder) % encoder
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
        "conditions": shop_conditions(conditions),
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
