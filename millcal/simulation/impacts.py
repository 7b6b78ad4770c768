"""Impact tests as recorded: half-sine hits on a structure of modes or on a dynamometer, with what goes wrong in a shop.

Force and response of a record are built from their exact Fourier integrals on the lines of a period long enough for the
structure to come to rest, through the anti-alias filter that both channels share. So X/F is the accelerance at every line
(for a dynamometer its transmissibility) to rounding, at any onset between two samples, which no sampled time integration gives.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from millcal.data import AXES, Channel, Recording
from millcal.physics.hammer import HitFault, Pulse
from millcal.physics.measuring_chain import MeasuringChain, anti_alias
from millcal.physics.shaped_modes import ShapedMode, accelerance_between
from millcal.simulation.noise import measured
from millcal.simulation.truth import shop_values

TIP = ("tipX", "tipY", "tipZ")  # what the dynamometer's channels measure
REST = 1e-12  # share of a response that may wrap around the period


def record_of_pulses(
    pulses: Sequence[Pulse],
    modes: Sequence[ShapedMode],
    hammer: str,
    accelerometers: Sequence[str],
    sample_rate: float,
    n_samples: int,
    *,
    hammer_chain: MeasuringChain = MeasuringChain(),
    accelerometer: MeasuringChain = MeasuringChain(),
    dynamometer: MeasuringChain | None = None,
) -> np.ndarray:
    """Hammer, dynamometer and accelerations, band limited and without noise.

    returns (1 + three with a dynamometer + accelerometer, sample), N and m/s^2
    """
    slowest = min(part.decay_rate for part in (*modes, *([dynamometer] if dynamometer else [])))
    rest = np.log(1 / REST) / slowest
    period = 1 << int(np.ceil(np.log2(n_samples + rest * sample_rate)))
    frequency = np.fft.rfftfreq(period, 1 / sample_rate)
    filtered = np.sum([pulse.spectrum(frequency) for pulse in pulses], axis=0) * anti_alias(frequency, sample_rate)
    accelerance = accelerance_between(frequency, modes, accelerometers, [hammer])[:, :, 0].T
    spectra = [
        filtered * hammer_chain.gain(frequency, 1),
        *([filtered * dynamometer.transfer(frequency, 3)[:, TIP.index(hammer)]] if dynamometer else []),
        filtered * accelerance * accelerometer.gain(frequency, len(accelerometers)),
    ]
    return np.fft.irfft(np.vstack(spectra) * sample_rate, period, axis=1)[:, :n_samples]


def simulate_impact(
    modes: Sequence[ShapedMode],
    *,
    rng: np.random.Generator,
    hammer: str,
    accelerometers: Sequence[str] = (),
    dynamometer: MeasuringChain | None = None,
    sample_rate: float,
    hits: int,
    record: float,
    peak: float,
    pulse: float,
    pretrigger: float = 0.01,
    peak_spread: float = 0.1,
    pulse_spread: float = 0.05,
    onset_jitter: float = 0.0,
    faults: Sequence[HitFault] = (),
    layout: Literal["segmented", "continuous"] = "segmented",
    hammer_chain: MeasuringChain = MeasuringChain(),
    accelerometer: MeasuringChain = MeasuringChain(),
    name: str = "",
) -> tuple[Recording, dict]:
    """One impact test with the hammer at one dof, and the truth behind it (JSON, in the shop's units).

    accelerometers : dofs whose acceleration is measured   dynamometer : what was hit, with three force channels that answer
    record, pulse, pretrigger, onset_jitter : s; a hit begins at pretrigger + uniform(0, onset_jitter) in its record
    peak : N, mean over the hits   peak_spread, pulse_spread : relative standard deviations
    layout : "segmented" stores each hit as a record of its own that begins at rest; "continuous" lets one hit follow the
        other every `record` seconds, so that a slow structure still moves when it is hit again
    """
    length = round(record * sample_rate)
    faulty = {fault.hit: fault for fault in faults}
    planned: list[list[Pulse]] = []
    for hit in range(hits):
        size = peak * max(1 + peak_spread * rng.standard_normal(), 0.2)
        duration = pulse * max(1 + pulse_spread * rng.standard_normal(), 0.2)
        onset = pretrigger + onset_jitter * rng.uniform()
        planned.append(_pulses(onset, duration, size, faulty.get(hit), hammer_chain.full_scale))
    dofs = (modes, hammer, accelerometers, sample_rate)
    chains = {"hammer_chain": hammer_chain, "accelerometer": accelerometer, "dynamometer": dynamometer}
    if layout == "segmented":
        values = np.hstack([record_of_pulses(pulses, *dofs, length, **chains) for pulses in planned])
        segments = np.array([[hit * length, length] for hit in range(hits)])
    else:
        values = record_of_pulses(_one_after_the_other(planned, record), *dofs, hits * length, **chains)
        segments = None
    time = np.arange(values.shape[1]) / sample_rate
    values[:1] = measured(values[:1], hammer_chain, sample_rate, rng, time=time)
    channels = [Channel("hammer", "force", "N", hammer, hammer_chain.full_scale)]
    if dynamometer is not None:
        values[1:4] = measured(values[1:4], dynamometer, sample_rate, rng, time=time)
        forces = zip(AXES, TIP, strict=True)
        channels += [Channel("f" + axis, "force", "N", dof, dynamometer.full_scale, "response") for axis, dof in forces]
    first = len(channels)
    values[first:] = measured(values[first:], accelerometer, sample_rate, rng, time=time)
    channels += [
        Channel("acc_" + dof, "acceleration", "m/s^2", dof, accelerometer.full_scale) for dof in accelerometers
    ]
    recording = Recording(
        samples=values, sample_rate=sample_rate, channels=tuple(channels), kind="impact", name=name, segments=segments
    )
    truth = {
        "kind": "impact",
        "input": hammer,
        "outputs": [channel.dof for channel in channels[1:]],
        "hits": [
            {
                "index": hit,
                **shop_values(
                    onset_s=hit * length / sample_rate + pulses[0].onset,
                    peak_N=pulses[0].peak,
                    pulse_ms=pulses[0].duration,
                ),
                "fault": faulty[hit].kind if hit in faulty else None,
            }
            for hit, pulses in enumerate(planned)
        ],
    }
    return recording, truth


def _pulses(
    onset: float, duration: float, peak: float, fault: HitFault | None, full_scale: float | None
) -> list[Pulse]:
    """The pulses of one hit, good or with its fault."""
    if fault is None:
        return [Pulse(onset, duration, peak)]
    if fault.kind == "double":
        return [Pulse(onset, duration, peak), Pulse(onset + fault.delay, duration, fault.ratio * peak)]
    if fault.kind == "weak":
        return [Pulse(onset, duration, fault.ratio * peak)]
    if full_scale is None:
        raise ValueError(f"hit {fault.hit} overloads a hammer without full scale")
    return [Pulse(onset, duration, fault.ratio * full_scale)]


def _one_after_the_other(planned: Sequence[Sequence[Pulse]], record: float) -> list[Pulse]:
    """All pulses on the time of the whole recording."""
    return [
        Pulse(hit * record + pulse.onset, pulse.duration, pulse.peak)
        for hit, pulses in enumerate(planned)
        for pulse in pulses
    ]
