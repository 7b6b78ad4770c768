"""Structures with six accelerometers, their impact tests, and cuts on them: what force reconstruction is tested on.

Cuts come as `CutVibration` from the exact harmonics of the force plus noise of a known covariance, without samples: theta
counts from tooth 0 by what the record says, so that a phase can be stated wrong. FRFs come in two ways. `measured_frf`
simulates the hits and runs the real estimate on them; `drawn_frf` adds white noise, through the response's window, to the
exact response, which is some thirty times as fast: the errors are those of a windowed H1 but for the tail that a window cuts
off. What may be wrong at a machine is made by the functions at the end.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import CutVibration, Frf, HitSpectra, Recording
from millcal.numerics.frequency_response import CrossSpectra, estimate
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge, force_harmonics
from millcal.physics.hammer import Pulse
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode, accelerance_between
from millcal.simulation import simulate_impact
from millcal.stages.frf import estimate_frf

TIP = ("tipX", "tipY", "tipZ")
SENSORS = ("noseX", "noseY", "noseZ", "headX", "headY", "headZ")
LAW = LinearEdge(cutting=np.array([1000e6, 700e6, 250e6]), edge=np.array([50e3, 30e3, 15e3]))  # of Pawelko et al. 2012
TWO_TEETH = Cutter(diameter=20e-3, teeth=2)


def slot(tooth_passing: float, cutter: Cutter = TWO_TEETH) -> CuttingConditions:
    """The slot of Pawelko et al. 2012 at a tooth-passing frequency, Hz."""
    speed = 2 * np.pi * tooth_passing / cutter.teeth
    return CuttingConditions(speed, 0.15e-3, 2e-3, cutter.diameter, "slot")


@dataclass(frozen=True)
class Structure:
    """Modes, and where the sensors are; the force acts at the tip."""

    modes: tuple[ShapedMode, ...]
    sensors: tuple[str, ...] = SENSORS

    def accelerance(self, frequency: np.ndarray, inputs: Sequence[str] = TIP) -> np.ndarray:
        """frequency : (f,) Hz   returns complex (f, sensor, input) m/s^2/N"""
        return accelerance_between(frequency, self.modes, self.sensors, inputs)

    def condition(self, frequency: np.ndarray) -> np.ndarray:
        """Condition number of the accelerance.   frequency : (f,) Hz   returns (f,)"""
        return np.linalg.cond(self.accelerance(np.asarray(frequency, float)))


def structure(
    seed: int,
    *,
    natural_frequency: Sequence[float] = (60.0, 82.0, 103.0),
    damping_ratio: Sequence[float] = (0.1, 0.15, 0.07),
    mass: Sequence[float] = (200.0, 150.0, 130.0),
    sensors: Sequence[str] = SENSORS,
) -> Structure:
    """Modes that move each sensor by +-(0.3 .. 1) and the tip along directions at right angles; any number of modes.

    Seed 2012 with three modes is the structure on which the published method was studied again.
    """
    rng = np.random.default_rng(seed)
    n = len(natural_frequency)
    at_sensors = rng.uniform(0.3, 1.0, (len(sensors), n)) * rng.choice([-1.0, 1.0], size=(len(sensors), n))
    turns = [np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(-(-n // 3))]
    at_tip = np.hstack(turns)[:, :n]
    shapes = [
        tuple(zip((*sensors, *TIP), (float(v) for v in (*at_sensors[:, m], *at_tip[:, m])), strict=True))
        for m in range(n)
    ]
    stiffness = np.asarray(mass) * (2 * np.pi * np.asarray(natural_frequency)) ** 2
    modes = zip(natural_frequency, damping_ratio, stiffness.tolist(), shapes, strict=True)
    return Structure(tuple(ShapedMode(*mode) for mode in modes), tuple(sensors))


# what is heard of a cut


def heard_cut(
    of: Structure,
    conditions: CuttingConditions,
    rng: np.random.Generator,
    *,
    law: LinearEdge | Kienzle = LAW,
    cutter: Cutter = TWO_TEETH,
    told: Cutter | None = None,
    noise: float | np.ndarray = 0.0,
    sample_rate: float = 2048.0,
    revolutions: int = 40,
    harmonics: int = 12,
    lines_between: int | None = 20,
    phase: float = 0.0,
    phase_error: float = 0.0,
    angle_from: str = "stated",
    dynamometer: bool = False,
    name: str = "cut.h5",
) -> CutVibration:
    """Harmonics of the accelerations under the force of `cutter`, with noise and the covariance that a record would tell.

    told : cutter that the record states; None: `cutter` without its runout
    noise : white, m/s^2 rms of a sample: of all, (sensor,), or its covariance (sensor, sensor)
    harmonics : of the spindle   lines_between : from which each covariance is drawn; None: it is exact
    phase : rad, of tooth 0 where the record begins to count, unless `angle_from` is "stated": then what is stated is
        `phase_error` too large   dynamometer : its force beside them, exact
    """
    frequency = conditions.spindle_speed / (2 * np.pi)
    order = np.arange(harmonics + 1)
    force = force_harmonics(law, cutter, conditions, harmonics)
    accelerance = of.accelerance(order * frequency)
    clean = np.einsum("ksd,dk->sk", accelerance, force)
    # a record that counts from theta_0 sees tooth 0 there: x = Re sum c e^{jk(theta + theta_0)}
    counted_from = -phase_error if angle_from == "stated" else phase
    turn = np.exp(1j * order * counted_from)
    samples = revolutions / frequency * sample_rate
    sensors = len(of.sensors)
    noise = np.asarray(noise, float)
    power = noise if noise.ndim == 2 else np.diag(np.broadcast_to(noise**2, sensors))
    covariance = np.broadcast_to(4.0 / samples * power, (harmonics + 1, sensors, sensors)).astype(complex)
    covariance = covariance.copy()
    covariance[0] = 0.0
    error = _complex_normal(rng, covariance)
    known = covariance
    if lines_between is not None:
        between = _complex_normal(rng, np.repeat(covariance[:, np.newaxis], lines_between, axis=1))
        known = np.einsum("kls,klt->kst", between, between.conj()) / lines_between
    heard = np.where(order > 0, (clean + error.T) * turn, 0.0)
    time = np.linspace(0.0, revolutions / frequency, 50)
    size = np.sqrt(0.5 * np.sum(np.abs(heard) ** 2, axis=1))
    noise_rms = np.sqrt(np.diag(power))
    return CutVibration(
        name=name,
        cutter=told or replace(cutter, runout=0.0, runout_angle=0.0),
        conditions=conditions,
        sensors=of.sensors,
        harmonics=heard,
        covariance=known,
        lines_between=np.full(harmonics + 1, float(lines_between or 1000)),
        angle_from=angle_from,  # type: ignore[arg-type]
        ac_rms=np.hypot(size, noise_rms),
        asynchronous_rms=noise_rms,
        overview_time=time,
        overview_low=np.repeat(-size[:, np.newaxis], len(time), axis=1),
        overview_high=np.repeat(size[:, np.newaxis], len(time), axis=1),
        force=force * turn if dynamometer else None,
        sample_rate=sample_rate,
        spindle_frequency=frequency,
        spindle_frequency_sd=0.0,
        revolutions=revolutions,
        steady=(0.0, revolutions / frequency),
    )


def _complex_normal(rng: np.random.Generator, covariance: np.ndarray) -> np.ndarray:
    """Circular draws with E[e e^H] = covariance.   covariance : (..., n, n)   returns complex (..., n)"""
    values, vectors = np.linalg.eigh(covariance)
    draws = rng.standard_normal((*values.shape, 2)) @ np.array([1.0, 1j]) / np.sqrt(2)
    return np.einsum("...st,...t->...s", vectors, np.sqrt(np.maximum(values, 0.0)) * draws)


# what is known from the hammer


@dataclass(frozen=True)
class Hits:
    """How the tip is hit; the values of the study of structure 2012 (half-sines of 3400 N and 3 ms at 2048 Hz)."""

    number: int = 9  # in each direction
    peak: float = 3400.0  # N
    duration: float = 3e-3  # s
    sample_rate: float = 2048.0  # Hz
    record: float = 1.0  # s
    pretrigger: float = 0.02  # s
    response_window: float = 0.15  # s after the hit, of `drawn_frf`
    force_noise: float = 5.0  # N rms of a sample
    acceleration_noise: float = 1.0  # m/s^2 rms of a sample


def impact_tests(of: Structure, rng: np.random.Generator, hits: Hits = Hits()) -> list[Recording]:
    """Hits at the tip in three directions, as recorded."""
    return [
        simulate_impact(
            of.modes,
            rng=rng,
            hammer=dof,
            accelerometers=of.sensors,
            sample_rate=hits.sample_rate,
            hits=hits.number,
            record=hits.record,
            peak=hits.peak,
            pulse=hits.duration,
            pretrigger=hits.pretrigger,
            hammer_chain=MeasuringChain(noise=hits.force_noise),
            accelerometer=MeasuringChain(noise=hits.acceleration_noise),
            name=f"tap-{dof}.h5",
        )[0]
        for dof in TIP
    ]


def measured_frf(of: Structure, rng: np.random.Generator, hits: Hits = Hits()) -> Frf:
    """The FRF that the project itself finds from such hits."""
    return estimate_frf(impact_tests(of, rng, hits))


def drawn_frf(of: Structure, rng: np.random.Generator, hits: Hits = Hits()) -> Frf:
    """The same kind of record, from exact spectra and the noise that goes through the windows."""
    rate = hits.sample_rate
    points = 1 << int(np.ceil(np.log2(hits.record * rate)))
    frequency = np.arange(points // 2 + 1) * rate / points
    exact = of.accelerance(frequency)
    first = round(hits.pretrigger * rate)
    width = int(np.ceil(hits.duration * rate)) + 2
    stop = first + round(hits.response_window * rate)
    fall = (stop - first) // 4
    window = np.zeros(points)
    window[:stop] = 1.0
    window[stop - fall : stop] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fall) + 0.5) / fall)
    window[: max(0, first - 4)] = 0.0
    time = np.arange(points) / rate
    force_power = width * hits.force_noise**2
    response_power = float(np.sum(window**2)) * hits.acceleration_noise**2
    shape = (len(frequency), len(of.sensors), len(TIP))
    values, coherence, variance = np.empty(shape, complex), np.empty(shape), np.empty(shape)
    spectrum = np.empty((len(frequency), len(TIP)))
    multiple = np.zeros((2, len(frequency), len(of.sensors)))
    tests = []
    for column, dof in enumerate(TIP):
        sums = CrossSpectra(1, len(of.sensors), len(frequency))
        kept = np.empty((hits.number, len(of.sensors), len(frequency)), complex)
        forces = np.empty((hits.number, 1, width))
        for hit in range(hits.number):
            peak = hits.peak * (1 + 0.1 * rng.standard_normal())
            pulse = Pulse((first + rng.uniform()) / rate, hits.duration * (1 + 0.05 * rng.standard_normal()), peak)
            true = pulse.force(time)
            forces[hit, 0] = true[first : first + width] + hits.force_noise * rng.standard_normal(width)
            own = np.zeros(points)
            own[first : first + width] = forces[hit, 0]
            noise = hits.acceleration_noise * rng.standard_normal((len(of.sensors), stop)) * window[:stop]
            kept[hit] = exact[:, :, column].T * np.fft.rfft(true) + np.fft.rfft(noise, points)
            sums.add(
                np.fft.rfft(own)[np.newaxis],
                kept[hit],
                np.array([force_power]),
                np.full(len(of.sensors), response_power),
            )
        found = estimate(sums)
        values[..., column], coherence[..., column] = found.values[..., 0], found.coherence[..., 0]
        variance[..., column] = found.variance[..., 0]
        spectrum[:, column] = np.sqrt(sums.Sff[0, 0].real / hits.number) / rate
        multiple += found.explained, found.total
        tests.append(
            HitSpectra(
                response=kept.astype(np.complex64),
                force=forces,
                force_start=np.full(hits.number, first),
                window_stop=np.full((hits.number, len(of.sensors)), float(stop - fall)),
                window_fall=np.full((hits.number, len(of.sensors)), float(fall)),
                force_noise=np.array([hits.number * force_power]),
                response_noise=np.full(len(of.sensors), response_power),
                first_line=0,
                outputs=of.sensors,
                forms=("accelerance",) * len(of.sensors),
                inputs=(dof,),
                sample_rate=rate,
                names=tuple(f"tap-{dof}.h5:{hit}" for hit in range(hits.number)),
            )
        )
    return Frf(
        frequency=frequency,
        values=values,
        coherence=coherence,
        multiple_coherence=multiple[0] / np.maximum(multiple[1], 1e-300),
        variance=variance,
        force_spectrum=spectrum,
        form="accelerance",
        estimator="h1",
        outputs=of.sensors,
        inputs=TIP,
        hits_used=(hits.number,) * len(TIP),
        usable_band=(1.0 / hits.record, 1.0 / hits.duration),
        tests=tuple(tests),
    )


def exact_frf(of: Structure, frequency: np.ndarray, inputs: Sequence[str] = TIP) -> Frf:
    """The FRF without errors and without hits, as another program may deliver it.   frequency : (f,) Hz"""
    frequency = np.asarray(frequency, float)
    return Frf(
        frequency=frequency,
        values=of.accelerance(frequency, inputs),
        form="accelerance",
        estimator="h1",
        outputs=of.sensors,
        inputs=tuple(inputs),
        hits_used=(0,) * len(inputs),
        usable_band=(float(frequency[0]), float(frequency[-1])),
    )


# what may be wrong


def useless_sensor(cut: CutVibration, sensor: str, rng: np.random.Generator, noise: float) -> CutVibration:
    """A sensor that came loose: its harmonics are noise, of a size that its record shows.   noise : m/s^2, of a harmonic"""
    row = cut.sensors.index(sensor)
    harmonics, covariance = cut.harmonics.copy(), cut.covariance.copy()
    harmonics[row, 1:] = noise / np.sqrt(2) * (rng.standard_normal((harmonics.shape[1] - 1, 2)) @ np.array([1.0, 1j]))
    covariance[1:, row, :] = covariance[1:, :, row] = 0.0
    covariance[1:, row, row] = noise**2
    rms = cut.ac_rms.copy()
    rms[row] = noise * np.sqrt(harmonics.shape[1] / 2)
    return replace(cut, harmonics=harmonics, covariance=covariance, ac_rms=rms)


def turned_sensor(cut: CutVibration, sensor: str) -> CutVibration:
    """A sensor mounted the other way round than in the impact test."""
    sign = np.where(np.array(cut.sensors) == sensor, -1.0, 1.0)
    return replace(cut, harmonics=cut.harmonics * sign[:, np.newaxis], covariance=cut.covariance * np.outer(sign, sign))


def wrong_gain(cut: CutVibration, sensor: str, gain: float) -> CutVibration:
    """A sensor whose sensitivity was set to another value than in the impact test."""
    size = np.where(np.array(cut.sensors) == sensor, gain, 1.0)
    return replace(cut, harmonics=cut.harmonics * size[:, np.newaxis], covariance=cut.covariance * np.outer(size, size))


def moved_sensor(of: Structure, sensor: str, rng: np.random.Generator) -> Structure:
    """The structure with that sensor at another place: cut on one, hit the other."""
    modes = []
    for mode in of.modes:
        shape = dict(mode.shape)
        shape[sensor] = float(rng.uniform(0.3, 1.0) * rng.choice([-1.0, 1.0]))
        modes.append(replace(mode, shape=tuple(shape.items())))
    return replace(of, modes=tuple(modes))


def hit_elsewhere(of: Structure, rng: np.random.Generator, share: float = 1.0) -> Structure:
    """The structure as it answers hits at another point than where it is cut.   share : of the tip's motion that differs"""
    modes = []
    for mode in of.modes:
        shape = dict(mode.shape)
        for dof in TIP:
            shape[dof] += share * float(rng.uniform(0.3, 1.0) * rng.choice([-1.0, 1.0]))
        modes.append(replace(mode, shape=tuple(shape.items())))
    return replace(of, modes=tuple(modes))


def other_stiffness(of: Structure, factor: float) -> Structure:
    """The structure after a change of clamping: every natural frequency times sqrt(factor)."""
    modes = tuple(
        replace(mode, stiffness=mode.stiffness * factor, natural_frequency=mode.natural_frequency * factor**0.5)
        for mode in of.modes
    )
    return replace(of, modes=modes)


def poor_tooth_passing(of: Structure, low: float, high: float, harmonic: int = 1) -> float:
    """Tooth-passing frequency at which the sensors tell the three forces of that harmonic apart worst: an anti-resonance.

    low, high : Hz   returns Hz
    """
    passing = np.linspace(low, high, 2000)
    return float(passing[np.argmax(of.condition(harmonic * passing))])
