"""The records that travel between the stages: frozen, SI inside, float64 or complex128, leading axis first.

Shape, unit and axis names of an array are declared once, on its field; they serve the constructor's check, the attributes
in the HDF5 file and the reader. A record never loads or saves itself, and whatever a report draws is in the record: a
report computes nothing that a stage did not save.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.modal_constants import (
    Constant,
    DrivingConstants,
    Estimate,
    driving_constants,
    driving_points,
    interval,
    interval_of_constant,
    mode_shapes,
    turned,
)
from millcal.physics.tool_path import ToolPath

AXES = ("x", "y", "z")


def array(unit: str, *dims: str, optional: bool = False) -> Any:
    """Declare a field that holds an array: its SI unit and the names of its axes."""
    metadata = {"unit": unit, "dims": dims}
    return field(metadata=metadata, default=None) if optional else field(metadata=metadata)


class Record:
    """Base of the records: checks that the axes agree, then makes the arrays read-only."""

    def __post_init__(self) -> None:
        lengths: dict[str, int] = {}
        for f in fields(self):  # type: ignore[arg-type]
            if "dims" not in f.metadata or getattr(self, f.name) is None:
                continue
            value = getattr(self, f.name)
            dims = f.metadata["dims"]
            if not hasattr(value, "read_block"):  # an array on disk stays there
                value = np.asarray(value).view()
                value.flags.writeable = False
                object.__setattr__(self, f.name, value)
            if len(value.shape) != len(dims):
                raise ValueError(f"{type(self).__name__}.{f.name} has axes {dims}, got {value.shape=}")
            for dim, length in zip(dims, value.shape, strict=True):
                if lengths.setdefault(dim, length) != length:
                    raise ValueError(f"{type(self).__name__}.{f.name}: {dim} is {length} here, {lengths[dim]} before")


class SamplesOnDisk(Protocol):
    """Samples too many for the memory: a shape, and a block at a time in SI units.

    Where some channels can be read without the others, `read_rows(start, stop, rows)` does it.
    """

    shape: tuple[int, int]

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        ...


Level = Literal["warning", "note"]


@dataclass(frozen=True)
class Notice:
    """Something the user should know, that does not stop the work: a warning to look into, or a note of what was done."""

    code: str  # short and stable, for scripts: "axis-swap", "rows-against-header"
    message: str  # one sentence: what, and what to do
    where: str = ""  # file, cut or key
    level: Level = "warning"  # a note goes into the JSON and the report, not to the terminal


@dataclass(frozen=True)
class Channel:
    """What one row of `Recording.samples` measures, in the SI unit of its quantity."""

    name: str
    quantity: str  # force, acceleration, velocity, displacement, angle, pulse, sound_pressure, sound
    unit: str  # SI: N, m/s^2, m/s, m, rad, 1, Pa; FS: a sound as a share of full scale
    dof: str  # point and direction: tipX
    full_scale: float | None = None  # input range in `unit`, for overload
    role: Literal["hammer", "response"] | None = None  # in an impact test; None: only a force is the hammer
    delay: float = 0.0  # s by which the signal is behind; an FRF is corrected for it


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording(Record):
    """One file of samples: a cut, an impact test or an air cut. Forces are the forces on the tool."""

    samples: np.ndarray | SamplesOnDisk = array("SI of each channel", "channel", "sample")
    sample_rate: float  # Hz
    channels: tuple[Channel, ...]
    kind: Literal["cut", "impact", "air"] = "cut"
    name: str = ""  # file it came from, for messages
    segments: np.ndarray | None = array("sample", "segment", "start and length", optional=True)  # int64
    start_time: float = 0.0  # s, the time column's first value
    cutter: Cutter | None = None
    conditions: CuttingConditions | None = None
    steady: tuple[float, float] | None = None  # s after the first sample
    air: tuple[tuple[float, float], ...] | None = None  # s after the first sample
    engagement: ToolPath | None = None  # where depth and angles change along the path
    path_start: float | None = None  # s after the first sample: when that path begins
    spindle_phase: float | None = None  # rad, of tooth 0 at the pulse, the encoder's zero or the first sample
    notices: tuple[Notice, ...] = ()

    @property
    def duration(self) -> float:
        """s"""
        return self.samples.shape[1] / self.sample_rate

    def block(self, start: int, stop: int, rows: list[int] | None = None) -> np.ndarray:
        """Samples start..stop of all channels, or of some, from memory or from disk.   returns (channel, stop - start)"""
        if rows is not None and hasattr(self.samples, "read_rows"):
            return self.samples.read_rows(start, stop, rows)
        block = (
            self.samples.read_block(start, stop) if hasattr(self.samples, "read_block") else self.samples[:, start:stop]
        )
        return block if rows is None else block[rows]

    def blocks(self, size: int = 1 << 20, rows: list[int] | None = None) -> Iterator[tuple[int, np.ndarray]]:
        """All samples in blocks of `size`, of all channels or of some: (index of the first sample, (channel, size))."""
        for start in range(0, self.samples.shape[1], size):
            yield start, self.block(start, min(start + size, self.samples.shape[1]), rows)

    def rows_of(self, quantity: str) -> list[int]:
        """Indices of the channels that measure a quantity, in channel order."""
        return [row for row, channel in enumerate(self.channels) if channel.quantity == quantity]

    def force_rows(self) -> list[int]:
        """Indices of the force channels in x, y, z of the tool, found by the last letter of their dof; -1 where missing."""
        rows = {self.channels[row].dof[-1:].lower(): row for row in self.rows_of("force")}
        return [rows.get(axis, -1) for axis in AXES]


@dataclass(frozen=True)
class AsynchronousPeak:
    """A line of the spectrum that is no harmonic of the spindle: chatter, a resonance, mains."""

    axis: str
    frequency: float  # Hz
    amplitude: float  # N
    exceeds: float  # times the local median amplitude


@dataclass(frozen=True, eq=False, kw_only=True)
class CutForce(Record):
    """A conditioned cut: its force synchronous with the spindle, and what does not follow the spindle.

    F(t) = Re sum_k harmonics[:, k] exp(j k theta(t)), theta = 2 pi spindle_frequency t + phase; harmonic 0 is the mean.
    """

    name: str
    cutter: Cutter
    conditions: CuttingConditions
    harmonics: np.ndarray = array("N", "axis", "harmonic")  # complex
    harmonics_variance: np.ndarray = array("N^2", "axis", "harmonic")  # E|error|^2, of blocks and air cut
    mean_all_rows: np.ndarray = array("N", "axis")  # of every row of the steady part, not only whole revolutions
    revolution_means: np.ndarray = array("N", "axis", "revolution")
    average_angle: np.ndarray = array("rad", "angle")
    average: np.ndarray = array("N", "axis", "angle")  # synchronous average over one revolution
    scatter: np.ndarray = array("N", "axis", "angle")  # standard deviation over the revolutions, at that angle
    ac_rms: np.ndarray = array("N", "axis")
    asynchronous_rms: np.ndarray = array("N", "axis")
    overview_time: np.ndarray = array("s", "overview")  # the whole record, thinned to envelopes for the report
    overview_low: np.ndarray = array("N", "axis", "overview")
    overview_high: np.ndarray = array("N", "axis", "overview")
    removed_offset: np.ndarray = array("N", "axis")  # at the middle of the steady part
    removed_drift: np.ndarray = array("N/s", "axis")
    sample_rate: float  # Hz
    spindle_frequency: float  # Hz, refined
    spindle_frequency_sd: float  # Hz
    revolutions: int
    steady: tuple[float, float]  # s
    air: tuple[tuple[float, float], ...] = ()  # s; empty where the record holds no air cut
    phase_from_pulse: bool = False  # theta = 0 at the once-per-revolution pulse
    lowpass: float | None = None  # Hz
    peaks: tuple[AsynchronousPeak, ...] = ()
    notices: tuple[Notice, ...] = ()

    @property
    def synchronous_share(self) -> np.ndarray:
        """Share of the AC power that follows the spindle.   returns (axis,)"""
        return 1.0 - (self.asynchronous_rms / np.maximum(self.ac_rms, 1e-300)) ** 2


@dataclass(frozen=True)
class Hit:
    """One hit of the hammer and what was found about it."""

    recording: str
    index: int  # within the recording, from 0
    onset: float  # s
    peak: float  # N
    accepted: bool
    reasons: tuple[str, ...] = ()  # double, overload, weak, inconsistent, ...
    remarks: tuple[str, ...] = ()  # what was mended or does no harm: a drift taken off, a late response moved back


@dataclass(frozen=True, eq=False, kw_only=True)
class HitSpectra(Record):
    """The hits that some columns of an FRF were estimated from: what a fit needs to leave one out and to undo the windows.

    Spectra are plain sums over the samples, X(s_k) = sum x[n] e^{-s_k n / rate}, with s_k = damping_shift + j w_k. A record is
    1 up to `window_stop`, falls along half a cosine over `window_fall` samples, and is 0 from there on.
    """

    response: np.ndarray = array("SI of the response", "hit", "output", "line")  # complex
    force: np.ndarray = array("N", "hit", "input", "sample")  # within its window; zero beside it
    force_start: np.ndarray = array("sample", "hit")  # of the first sample in `force`, counted from the record's origin
    window_stop: np.ndarray = array("sample", "hit", "output")  # of the time without delay, so not always whole
    window_fall: np.ndarray = array("sample", "hit", "output")
    force_noise: np.ndarray = array("N^2", "input")  # E|noise|^2 of a line, summed over the hits
    response_noise: np.ndarray = array("square of the response", "output")  # E|noise|^2 of a line, mean over the hits
    first_line: int  # the first line's index among the lines of the FRF
    outputs: tuple[str, ...]
    forms: tuple[str, ...]  # as each output was measured: accelerance, mobility, receptance, transmissibility
    inputs: tuple[str, ...]
    sample_rate: float  # Hz
    names: tuple[str, ...]  # of the hits: "tap_x.h5:3"


@dataclass(frozen=True, eq=False, kw_only=True)
class Frf(Record):
    """Frequency response matrix X/F with coherence and variance. Convention x(t) = Re X e^{+j w t}."""

    frequency: np.ndarray = array("Hz", "frequency")
    values: np.ndarray = array("by form", "frequency", "output", "input")  # complex
    coherence: np.ndarray | None = array("1", "frequency", "output", "input", optional=True)  # nan for a single hit
    multiple_coherence: np.ndarray | None = array("1", "frequency", "output", optional=True)
    variance: np.ndarray | None = array("square of values", "frequency", "output", "input", optional=True)
    force_spectrum: np.ndarray | None = array("N s", "frequency", "input", optional=True)  # |F|, rms over the hits
    form: Literal["accelerance", "mobility", "receptance", "transmissibility"]
    estimator: str
    outputs: tuple[str, ...]  # dofs
    inputs: tuple[str, ...]
    hits_used: tuple[int, ...]  # per input
    usable_band: tuple[float, float]  # Hz
    hits: tuple[Hit, ...] = ()
    damping_shift: float = 0.0  # 1/s; of an exponential window: `values` are those at s = damping_shift + j w
    tests: tuple[HitSpectra, ...] = ()  # empty for an FRF of another program
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalFit(Record):
    """What a fit found beside frequency and damping, and what a reader needs to believe it.

    The model, in the form of the FRF (power d of s: receptance 0, mobility 1, accelerance 2), is

        H(s) = s^d [sum_r (alpha_r + beta_r s) / (s^2 + 2 zeta_r w_r s + w_r^2) + R_0 / s^2 + R_1 + R_2 s^2 + ...]

    alpha = phi_o phi_i are the modal constants; beta is zero for real modes, and in general
    alpha + beta s = A (s - p*) + A* (s - p) with the residue A at the pole p = -zeta w + j w sqrt(1 - zeta^2).
    """

    residue: np.ndarray = array(
        "s/kg", "mode", "output", "input"
    )  # A, complex, of the receptance; alpha / (2j w_d) if real
    remainder: np.ndarray = array("SI by power of s", "remainder", "output", "input")  # of the modes outside the band
    remainder_power: np.ndarray = array("1", "remainder")  # of s in the receptance: -2, 0, 2
    frequency_deviation: np.ndarray = array("Hz", "deviation", "mode")  # covariance = deviation^T deviation
    damping_deviation: np.ndarray = array("1", "deviation", "mode")
    residue_deviation: np.ndarray = array("s/kg", "deviation", "mode", "output", "input")
    dof: float  # degrees of freedom behind the deviations
    interval_from: Literal["jackknife", "least squares", "none"]
    frequency: np.ndarray = array("Hz", "line")  # the lines of the fit
    measured: np.ndarray = array("by form", "line", "output", "input")
    modelled: np.ndarray = array("by form", "line", "output", "input")  # as measured: with what the record cut off
    synthesised: np.ndarray = array("by form", "line", "output", "input")  # the FRF of the structure itself
    residual: np.ndarray = array("1", "output", "input")  # |measured - modelled| / |measured|
    residual_relative: float  # the same over all
    complex_modes: bool
    mac: np.ndarray = array("1", "mode", "other mode")  # modal assurance criterion of the shapes
    complexity: np.ndarray = array("rad", "mode")  # mean phase deviation of the shape from a line
    chart_order: np.ndarray = array("1", "pole")  # the stabilisation chart: every pole of every order
    chart_frequency: np.ndarray = array("Hz", "pole")
    chart_damping: np.ndarray = array("1", "pole")
    chart_stable: np.ndarray = array("1", "pole")  # 1 where frequency and damping are those of the order below
    delay: np.ndarray | None = array("s", "output", optional=True)  # of each response behind the hammer, estimated
    delay_sd: np.ndarray | None = array("s", "output", optional=True)
    form: Literal["accelerance", "mobility", "receptance"]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    band: tuple[float, float]  # Hz

    @property
    def driving_points(self) -> dict[str, tuple[int, int]]:
        """Where a point was hit and measured in one direction, whatever their signs: dof -> (output, input)."""
        pairs = driving_points(self.outputs, self.inputs)
        return {self.inputs[i].lstrip("+-"): (o, i) for o, i in pairs if np.isfinite(self.residue[:, o, i]).all()}

    @property
    def shapes(self) -> tuple[tuple[str, ...], np.ndarray]:
        """The shape of every mode and the dofs it goes over.   returns dofs and complex (mode, dof)"""
        dofs = self.inputs if len(self.inputs) > len(self.outputs) else self.outputs
        return dofs, mode_shapes(self.residue)


@dataclass(frozen=True, eq=False, kw_only=True)
class Modes(Record):
    """Modes of the structure at the tool tip: given by hand along machine axes, or fitted to an FRF."""

    natural_frequency: np.ndarray = array("Hz", "mode")
    damping_ratio: np.ndarray = array("1", "mode")
    stiffness: np.ndarray = array("N/m", "mode")  # of a fit: at the driving point of the first input; nan where none
    axes: tuple[str, ...]  # of each mode: x, y or z, along which it moves most
    fit: ModalFit | None = None
    notices: tuple[Notice, ...] = ()

    @property
    def frequency_estimate(self) -> Estimate:
        """Natural frequencies with their deviations, none where no fit knows them.   Hz"""
        nothing = np.empty((0, len(self.axes)))
        return Estimate(self.natural_frequency, self.fit.frequency_deviation if self.fit else nothing)

    @property
    def damping_estimate(self) -> Estimate:
        """Damping ratios with their deviations, none where no fit knows them."""
        nothing = np.empty((0, len(self.axes)))
        return Estimate(self.damping_ratio, self.fit.damping_deviation if self.fit else nothing)

    def driving_constants(self, output: int, given: int) -> DrivingConstants:
        """k, m and c of every fitted mode at a driving point, one of `fit.driving_points`.

        Where hammer and response count the other way round, so do their residues.
        """
        assert self.fit is not None
        sign = turned(self.fit.outputs[output], self.fit.inputs[given])
        residue, deviation = self.fit.residue[:, output, given], self.fit.residue_deviation[:, :, output, given]
        return driving_constants(
            self.frequency_estimate, self.damping_estimate, Estimate(sign * residue, sign * deviation)
        )

    def interval(self, estimate: Estimate) -> np.ndarray:
        """The 95 % interval of what the fit found of frequency or damping, never below 0; nan where none is known.

        returns (mode, low and high)
        """
        return interval(estimate, self.fit.dof if self.fit else 0.0)

    @property
    def delay_interval(self) -> np.ndarray | None:
        """The 95 % interval of the estimated delays, None where there are none.   s, (output, low and high)"""
        if self.fit is None or self.fit.delay is None or self.fit.delay_sd is None:
            return None
        return interval(Estimate(self.fit.delay, self.fit.delay_sd[np.newaxis]), self.fit.dof, lowest=-np.inf)

    def interval_of_constant(self, constant: Constant) -> np.ndarray:
        """The same of k, m or c; infinite at the high end where the mode cannot be told from one that does not move."""
        return interval_of_constant(constant, self.fit.dof if self.fit else 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior(Record):
    """What is known of parameters: a mean, a covariance, and how the interval is to be read."""

    names: tuple[str, ...]  # Ktc Krc Kac Kte Kre Kae, or kt kr ka mt mr ma, then c0, s0, t0 of the runout
    units: tuple[str, ...]  # SI: N/m^2, N/m, 1, m
    mean: np.ndarray = array("SI of each parameter", "parameter")
    covariance: np.ndarray = array("SI products", "parameter", "parameter")
    interval: np.ndarray = array("SI of each parameter", "parameter", "low and high")  # 95 %
    law: Literal["linear-edge", "kienzle"]
    method: str
    dof: float = np.inf  # degrees of freedom behind the covariance: few cuts have long tails

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Draws from the normal distribution, or from Student's t where few cuts stand behind the covariance.

        returns (member, parameter)
        """
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        scale = np.where(spread > 0, spread, 1.0)  # correlation, so that N/m^2 beside m factorises
        values, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = rng.standard_normal((n, len(self.mean))) @ root.T
        if np.isfinite(self.dof):
            draws *= np.sqrt(self.dof / rng.chisquare(self.dof, size=(n, 1)))
        return self.mean + draws * spread

    def __getitem__(self, name: str) -> float:
        return float(self.mean[self.names.index(name)])


@dataclass(frozen=True)
class Check:
    """One question asked of a fit, and its answer."""

    name: str
    passed: bool
    message: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Coefficients(Record):
    """Coefficients identified from cuts, with what a reader needs to believe them or not."""

    posterior: Posterior
    cutter: Cutter
    conditions: tuple[CuttingConditions, ...]  # of each cut
    cuts: tuple[str, ...]
    verdict: str  # "fits", "fits in part: ...", "does not fit: ..."
    checks: tuple[Check, ...]
    feed_per_tooth: np.ndarray = array("m", "cut")
    measured_mean: np.ndarray = array("N", "cut", "axis")
    modelled_mean: np.ndarray = array("N", "cut", "axis")
    angle: np.ndarray = array("rad", "angle")
    measured: np.ndarray = array("N", "cut", "axis", "angle")  # one revolution, all saved harmonics
    modelled: np.ndarray = array("N", "cut", "axis", "angle")
    measured_amplitude: np.ndarray = array("N", "cut", "axis", "harmonic")
    modelled_amplitude: np.ndarray = array("N", "cut", "axis", "harmonic")
    residual_rms: np.ndarray = array("N", "axis")
    r2: np.ndarray = array("1", "axis")
    in_sample: np.ndarray | None = array("1", "axis", optional=True)  # residual / AC rms, in the band of the fit
    left_out: np.ndarray | None = array("1", "axis", optional=True)
    left_out_by_cut: np.ndarray | None = array("1", "cut", "axis", optional=True)
    in_sample_wide: np.ndarray | None = array("1", "axis", optional=True)  # the same over all saved harmonics
    left_out_wide: np.ndarray | None = array("1", "axis", optional=True)
    phase: np.ndarray | None = array("rad", "cut", optional=True)
    band: tuple[int, int] = (0, 0)  # harmonics used
    alternatives: tuple[
        tuple[str, tuple[tuple[str, float], ...]], ...
    ] = ()  # other models: (name, ((key, SI value), ...))
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class CutSamples(Record):
    """A cut sample by sample: the force on the tool, where the spindle stands, and how the tool meets the work.

    Offset and drift of the amplifier are taken out; nothing is smoothed. The spindle angle counts from tooth 0 only where
    `angle_from` is "stated": else it misses a constant, which whoever fits these samples finds.
    """

    name: str
    cutter: Cutter
    conditions: CuttingConditions
    force: np.ndarray = array("N", "axis", "sample")
    axes: tuple[str, ...]  # x, y, z: those that were measured
    angle: np.ndarray = array("rad", "sample")  # of the spindle, rising without jumps
    angle_from: Literal["speed", "pulse", "encoder", "stated"]
    feed_per_tooth: np.ndarray = array("m", "sample")
    axial_depth: np.ndarray = array("m", "sample")
    entry: np.ndarray = array("rad", "sample")
    leave: np.ndarray = array("rad", "sample")
    feed_direction: np.ndarray = array("rad", "sample")  # of the feed in the axes of the forces, from +x towards +y
    sample_rate: float  # Hz
    start: float  # s, of the first sample here after the first of the recording
    spindle_frequency: float  # Hz
    air_force: np.ndarray = array("N", "axis", "air sample")  # of the air cuts, less offset and drift; none is allowed
    air_spans: tuple[tuple[int, int], ...] = ()  # of `air_force`: what is one piece, (start, stop)
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True)
class Jump:
    """A sudden change of the coefficients: a chipped edge, another material."""

    time: float  # s, as the history's
    change: tuple[float, ...]  # of ln(specific force) at the reference chip, in each direction t, r(, a)
    sd: tuple[float, ...]
    log_bayes_factor: float  # of the record with this jump against the record without


@dataclass(frozen=True, eq=False, kw_only=True)
class CoefficientHistory(Record):
    """Coefficients that change while cutting, followed through recorded cuts, with what a reader needs to believe them.

    Steps are the instants that are kept, of all cuts one behind the other; `time` runs on over the cuts without a gap.
    """

    posterior: Posterior  # at the last step: the tool as the record leaves it
    method: str  # rls, enkf, enkf-inflated, imm, smooth
    cutter: Cutter
    conditions: tuple[CuttingConditions, ...]  # of each cut
    cuts: tuple[str, ...]
    verdict: str  # "fits", "does not fit: ..."
    checks: tuple[Check, ...]
    time: np.ndarray = array("s", "step")
    cut: np.ndarray = array("1", "step")  # index of the cut a step belongs to
    names: tuple[str, ...]  # of the coefficients: kt kr ka mt mr ma, or Ktc Krc Kac Kte Kre Kae; no runout
    units: tuple[str, ...]
    value: np.ndarray = array("SI of each coefficient", "step", "coefficient")
    low: np.ndarray = array("SI of each coefficient", "step", "coefficient")  # 95 % band, at each step by itself
    high: np.ndarray = array("SI of each coefficient", "step", "coefficient")
    reference_chip: float  # m: h0, near the chips of these cuts, where the force is known best
    directions: tuple[str, ...]  # t, r(, a)
    specific_force: np.ndarray = array("N/m^2", "step", "direction")  # on a chip of thickness h0
    specific_low: np.ndarray = array("N/m^2", "step", "direction")
    specific_high: np.ndarray = array("N/m^2", "step", "direction")
    axes: tuple[str, ...]  # x, y, z: those that were measured
    innovation_mean: np.ndarray = array("1", "step", "axis")  # over the samples of a step, in standard deviations
    innovation_square: np.ndarray = array("1", "step", "axis")  # mean square; 1 where model and noise are right
    shown: np.ndarray = array("s", "shown")  # instants of the force that are drawn: short windows of the record
    shown_window: np.ndarray = array("1", "shown")  # index of the window
    measured: np.ndarray = array("N", "axis", "shown")
    modelled: np.ndarray = array("N", "axis", "shown")
    residual_rms: np.ndarray = array("N", "axis")
    r2: np.ndarray = array("1", "axis")
    noise: np.ndarray = array("N", "axis")  # standard deviation, of the air cut where there is one
    noise_from: Literal["air", "idle", "residual"]
    chi2: float  # mean square of the normalised residuals of the stiff model: 1 where model and noise are right
    chip_range: tuple[float, float]  # m, 5 % and 95 % of the chips: where the force is known
    slope_per_minute: np.ndarray = array("1/min", "direction")  # of the specific force, relative, over the whole time
    slope_low: np.ndarray = array("1/min", "direction")  # 95 %
    slope_high: np.ndarray = array("1/min", "direction")
    innovation_samples: np.ndarray | None = array("1", "step", optional=True)  # behind each step, for what to expect
    jumps: tuple[Jump, ...] = ()
    runout: tuple[float, float] | None = None  # m, (c0, s0) as in the posterior; None: not estimated
    model: str = ""  # what was chosen among the trend models, and by how much
    notices: tuple[Notice, ...] = ()

    @property
    def law(self) -> str:
        """linear-edge or kienzle"""
        return self.posterior.law


@dataclass(frozen=True, eq=False, kw_only=True)
class CutVibration(Record):
    """A conditioned cut as accelerometers hear it: what follows the spindle, and the noise beside it.

    a(t) = Re sum_k harmonics[:, k] exp(j k theta(t)), theta = 2 pi spindle_frequency t + phase. Theta counts from tooth 0 only
    where `angle_from` is "stated"; else from the pulse or the encoder's zero, or from the first sample, and whoever uses
    it finds the constant. Velocities and displacements are in here as accelerations.
    """

    name: str
    cutter: Cutter
    conditions: CuttingConditions
    sensors: tuple[str, ...]  # dofs, without sign: a sensor that counts backwards is turned
    harmonics: np.ndarray = array("m/s^2", "sensor", "harmonic")  # complex; 0 is nothing an accelerometer knows
    covariance: np.ndarray = array(
        "(m/s^2)^2", "harmonic", "sensor", "other sensor"
    )  # complex, E[e e^H] of the harmonics, from the lines between
    lines_between: np.ndarray = array("1", "harmonic")  # behind each covariance
    angle_from: Literal["speed", "pulse", "encoder", "stated"]
    counts_from: Literal["start", "pulse", "encoder"] | None = None  # what a stated angle is the angle of
    angle_sd: float | None = None  # rad, of where that is in this cut; None: not known
    ac_rms: np.ndarray = array("m/s^2", "sensor")
    asynchronous_rms: np.ndarray = array("m/s^2", "sensor")
    overview_time: np.ndarray = array("s", "overview")  # the whole record, thinned to envelopes for the report
    overview_low: np.ndarray = array("m/s^2", "sensor", "overview")
    overview_high: np.ndarray = array("m/s^2", "sensor", "overview")
    force: np.ndarray | None = array(
        "N", "axis", "harmonic", optional=True
    )  # of a dynamometer beside them, to compare; nan for an axis it has not
    sample_rate: float  # Hz
    spindle_frequency: float  # Hz, refined
    spindle_frequency_sd: float  # Hz
    revolutions: int
    steady: tuple[float, float]  # s
    peaks: tuple[AsynchronousPeak, ...] = ()
    notices: tuple[Notice, ...] = ()

    @property
    def synchronous_share(self) -> np.ndarray:
        """Share of the power that follows the spindle.   returns (sensor,)"""
        return 1.0 - (self.asynchronous_rms / np.maximum(self.ac_rms, 1e-300)) ** 2


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedAdvice(Record):
    """How well one more acceleration cut would tell the coefficients, against its spindle speed."""

    spindle_speed: np.ndarray = array("rad/s", "speed")
    names: tuple[str, ...]  # coefficients
    relative_sd: np.ndarray = array("1", "speed", "coefficient")  # expected, with what is known already
    condition: np.ndarray = array("1", "speed")  # condition number of the noise-weighted problem
    best: tuple[float, ...]  # rad/s, best first, apart from each other
    worst_harmonic: np.ndarray = array("1", "speed")  # tooth-passing harmonic that tells the forces worst there
    harmonics: int  # of the tooth passing that were reckoned with


@dataclass(frozen=True, eq=False, kw_only=True)
class ForceHarmonics(Record):
    """The cutting force that accelerations and an FRF tell of, harmonic by harmonic, and the coefficients behind it.

    F(t) = Re sum force exp(j order theta), theta the spindle angle of tooth 0. Lines are the harmonics of all cuts, one cut
    behind the other. The mean force is nothing that an accelerometer knows: where the law tells it, `law_force` has it.
    """

    method: str  # ls, tls, tikhonov, constrained-ls, rtls, gtls
    cutter: Cutter
    conditions: tuple[CuttingConditions, ...]  # of each cut
    cuts: tuple[str, ...]
    axes: tuple[str, ...]  # x, y, z: those along which the FRF has an input
    sensors: tuple[str, ...]
    verdict: str  # "fits", "does not fit: ..."
    checks: tuple[Check, ...]
    cut: np.ndarray = array("1", "line")  # index
    order: np.ndarray = array("1", "line")  # of the spindle
    frequency: np.ndarray = array("Hz", "line")
    force: np.ndarray = array("N", "line", "axis")  # complex
    force_covariance: np.ndarray = array("N^2", "line", "part", "other part")  # of Re x, Re y, .., Im x, Im y, ..
    free_force: np.ndarray | None = array(
        "N", "line", "axis", optional=True
    )  # complex: of every line by itself, the law not asked, weighted as in the fit
    free_sd: np.ndarray | None = array("N", "line", "axis", optional=True)  # root of E|error|^2
    condition: np.ndarray = array("1", "line")  # condition number of each line's FRF matrix, weighted by the noise
    condition_number: float  # of what the method solved
    regularization: float | None = None  # Tikhonov's, (m/s^2)/N
    regularization_from: str = ""  # gcv, l-curve, discrepancy, given
    band: tuple[float, float]  # Hz: lowest and highest line
    measured: np.ndarray = array("m/s^2", "line", "sensor")  # complex harmonics of the accelerations
    modelled: np.ndarray = array("m/s^2", "line", "sensor")  # complex: FRF times force
    deviation: np.ndarray = array("m/s^2", "line", "sensor")  # expected |measured - modelled|, of cut and FRF
    noise: np.ndarray | None = array("m/s^2", "line", "sensor", optional=True)  # of the cut alone, in that deviation
    sensor_residual: np.ndarray = array("1", "sensor")  # mean square over the expected one: 1 where all is right
    sensor_share: np.ndarray = array("1", "sensor")  # of what is known of the coefficients; they add up to 1
    chi2: float  # mean square of all weighted residuals per degree of freedom: 1 where FRF, noise and law are right
    dof: int
    angle: np.ndarray = array("rad", "angle")  # of tooth 0, one revolution
    alternating: np.ndarray = array("N", "cut", "axis", "angle")  # the lines' force
    alternating_sd: np.ndarray = array("N", "cut", "axis", "angle")
    law_force: np.ndarray | None = array(
        "N", "cut", "axis", "angle", optional=True
    )  # of the coefficients, with its mean and all harmonics; nan for an axis whose coefficients are not all known
    dynamometer: np.ndarray | None = array(
        "N", "cut", "axis", "angle", optional=True
    )  # the same lines of a dynamometer that was there too
    posterior: Posterior  # of the coefficients that these lines can tell
    unobservable: tuple[tuple[str, ...], ...] = ()  # coefficients, or combinations of them, that no line shows
    rank: int  # of the law: how many combinations of coefficients the lines show
    constraint_rows: int  # real equations between the harmonics that the law demands
    complex_rows: int  # those among them that are linear in the complex harmonics
    phase: np.ndarray = array("rad", "cut")  # of tooth 0 at the angle from which the cut was counted
    phase_sd: np.ndarray = array("rad", "cut")  # 0 where it was not fitted
    phase_from: Literal["stated", "fitted"]
    runout: tuple[float, float] | None = (
        None  # m, (c0, s0) = rho cos, sin of its angle from tooth 0 at the helix bottom
    )
    runout_sd: tuple[float, float] | None = None  # m
    frf_from: Literal["measured", "modes"]
    compared_methods: tuple[str, ...]  # every method on the same lines
    compared: np.ndarray = array("SI of each coefficient", "method", "parameter")  # in the order of the posterior
    compared_sd: np.ndarray = array("SI of each coefficient", "method", "parameter")  # nan where a method has none
    recommended: str  # among them
    recommended_why: str
    advice: SpeedAdvice | None = None
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True)
class BestSpeed:
    """A speed worth running: the top of a stable pocket."""

    spindle_speed: float  # rad/s
    axial_depth: float  # m: the least limit within half a percent of that speed
    removal_rate: float  # m^3/s; nan without a feed per tooth
    p_stable: float | None  # at that depth, the least within half a percent of that speed
    safe_depth: float | None = None  # m, stable with 97.5 %: the lower end of the band, the least as far
    torque: float | None = (
        None  # N m, mean over a revolution at the safe depth, else at the limit; None without K_te or feed
    )
    power: float | None = None  # W, of that
    # rad/s: how far the speed may be off, either way, before nine tenths of that depth are more than may be run
    speed_margin: float | None = None


@dataclass(frozen=True)
class OperatingPoint:
    """A cut asked about: is it stable, by how much, and what would make it better."""

    spindle_speed: float  # rad/s
    axial_depth: float  # m
    limit: float  # m, the first loss of stability at that speed; inf where none
    stable: bool  # at that depth: above the first limit there may be stable islands
    kind: Literal["hopf", "flip", "fold", ""]  # of the crossing that bounds it from above, or that it lies beyond
    chatter_frequency: float  # Hz, of that crossing; nan where there is none
    limit_interval: tuple[float, float] | None = None  # m, 95 %
    p_stable: float | None = None
    speed_margin: tuple[float, float] | None = None  # rad/s that the speed may fall and rise before this depth chatters
    advice: tuple[str, ...] = ()  # what to do, best first
    bound: float = np.nan  # m, depth of the crossing that `kind` is of: on an island that above it, not the first limit


@dataclass(frozen=True, eq=False, kw_only=True)
class CutTests(Record):
    """Cuts that were made and judged by ear, eye or `millcal judge`: drawn over a map."""

    spindle_speed: np.ndarray = array("rad/s", "test")
    axial_depth: np.ndarray = array("m", "test")
    stable: np.ndarray = array("1", "test")  # 1 stable, 0 chatter
    # 1 stable, 0 chatter by the map at the speed of the cut, nan outside the map; None: not held against one
    stable_by_map: np.ndarray | None = array("1", "test", optional=True)
    name: str = ""  # file they came from


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedCuts(Record):
    """Cuts of the time domain: where they went, sampled once per tooth or revolution."""

    spindle_speed: np.ndarray = array("rad/s", "cut")
    axial_depth: np.ndarray = array("m", "cut")
    period: np.ndarray = array(
        "1", "cut"
    )  # revolutions (or teeth, see `per`) after which it repeats; 0: never, chatter
    metric: np.ndarray = array(
        "m", "cut"
    )  # M of period 1: mean change from one sample to the next, worst sampling phase
    per: Literal["tooth", "revolution"] = "tooth"  # what the samples are taken once of
    bifurcation_speed: np.ndarray | None = array(
        "rad/s", "sample", optional=True
    )  # of the cuts along one line of the map
    bifurcation_depth: np.ndarray | None = array("m", "sample", optional=True)
    bifurcation_displacement: np.ndarray | None = array("m", "sample", optional=True)  # once-per samples, settled


@dataclass(frozen=True, eq=False, kw_only=True)
class StabilityMap(Record):
    """Limit depth against spindle speed, with a band or probabilities where coefficients or dynamics carry a covariance.

    Crossings are of all speeds one behind the other. Kinds are numbered as in `millcal.physics.stability.regeneration`.
    """

    spindle_speed: np.ndarray = array("rad/s", "speed")
    limit_depth: np.ndarray = array("m", "speed")  # first loss of stability; inf where none was found up to `deepest`
    chatter_frequency: np.ndarray = array("Hz", "speed")
    limit_kind: np.ndarray = array("1", "speed")  # 0 Hopf, 1 flip, 2 fold; -1 where there is no limit
    lobe: np.ndarray = array("1", "speed")  # whole waves between two teeth; -1 where there is no limit
    limit_low: np.ndarray | None = array("m", "speed", optional=True)  # 95 % band
    limit_high: np.ndarray | None = array("m", "speed", optional=True)
    draws: int | None = None  # that the band and the probabilities stand on
    crossing_speed: np.ndarray = array("rad/s", "crossing")
    crossing_depth: np.ndarray = array("m", "crossing")
    crossing_kind: np.ndarray = array("1", "crossing")
    crossing_frequency: np.ndarray = array("Hz", "crossing")
    crossing_loses: np.ndarray = array(
        "1", "crossing"
    )  # 1: stability is lost with growing depth; 0: one multiplier returns
    probability: np.ndarray | None = array("1", "depth", "speed", optional=True)  # that a cut is stable
    probability_depth: np.ndarray | None = array("m", "depth", optional=True)
    method: str  # zoa, floquet, frf, time-domain
    deepest: float = np.inf  # m, how deep was looked
    teeth: int
    radial_depth: float  # m
    diameter: float  # m
    direction: str
    feed_per_tooth: float | None
    absolute_minimum: float  # m; of zoa over all speeds, else over those of the map
    absolute_minimum_frequency: float  # Hz
    absolute_minimum_speed: float = np.nan  # rad/s, refined between the speeds of the map; nan where that is not known
    best: tuple[BestSpeed, ...] = ()
    operating: OperatingPoint | None = None
    tests: CutTests | None = None
    simulated: SimulatedCuts | None = None
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True)
class ChatterPeak:
    """A line of the spectrum that follows neither the teeth nor the spindle."""

    frequency: float  # Hz
    amplitude: float  # SI of the channel
    share: float  # of the power of the whole signal
    alias_of: float | None = None  # Hz: the frequency above Nyquist it may stand for


@dataclass(frozen=True, eq=False, kw_only=True)
class Judgement(Record):
    """A recorded cut judged: stable, repeating every n teeth, or chatter; and the speeds its chatter points to."""

    name: str
    channel: str
    quantity: Literal["displacement", "acceleration", "velocity", "force", "sound_pressure", "sound"]
    unit: str  # SI of the channel
    teeth: int
    sample_rate: float  # Hz
    spindle_frequency: float  # Hz, refined
    spindle_frequency_sd: float  # Hz
    steady: tuple[float, float]  # s, what was judged
    revolutions: int
    verdict: Literal["stable", "period-n", "chatter", "not known"]
    why: str  # one sentence
    period: int | None = None  # teeth (`per`) after which the motion repeats; 1 stable; None: never
    metric: float | None = (
        None  # M, SI of the channel: mean change between samples once per tooth, worst sampling phase
    )
    metric_relative: float = np.nan  # M over the size of the alternating signal
    chatter_frequency: float | None = None  # Hz
    chatter_frequency_sd: float | None = None  # Hz
    chatter_share: float = 0.0  # of the power of all lines, noise left out, in those of the chatter
    peaks: tuple[ChatterPeak, ...] = ()
    stable_speeds: tuple[float, ...] = ()  # rad/s, 2 pi f_c / (teeth (k + 1)) of the chatter frequency, k = 0, 1, ...
    frequency: np.ndarray = array("Hz", "line")
    spectrum: np.ndarray = array("SI of the channel", "line")  # amplitude, as recorded
    remaining: np.ndarray = array("SI of the channel", "line")  # after the comb took tooth passing and spindle away
    sample_time: np.ndarray = array("s", "sample")
    once_per_tooth: np.ndarray = array("SI of the channel", "sample")
    overview_time: np.ndarray = array("s", "overview")  # the whole record, thinned to envelopes
    overview_low: np.ndarray = array("SI of the channel", "overview")
    overview_high: np.ndarray = array("SI of the channel", "overview")
    per: Literal["tooth", "revolution"] = (
        "tooth"  # what period and M count: turns, where the teeth are not evenly pitched
    )
    conditions: CuttingConditions | None = None
    notices: tuple[Notice, ...] = ()

    def speeds_near(self) -> tuple[float, ...]:
        """The stable speeds within a factor of two of the cut's own, the nearest first; where none is, the nearest.   rad/s"""
        own = 2 * np.pi * self.spindle_frequency
        away = {speed: abs(float(np.log(speed / own))) for speed in self.stable_speeds}
        nearest = sorted(away, key=lambda speed: away[speed])
        return tuple(speed for speed in nearest if away[speed] <= np.log(2.0)) or tuple(nearest[:1])
