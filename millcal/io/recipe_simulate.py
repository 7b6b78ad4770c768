"""The `[simulate]` table of a recipe: what synthetic recordings to make, with which truth.

The keys are the shop's; a table turns itself into SI and into the laws, modes and chains of `physics`, which is all that the
simulation knows. Keys that a cut shares with the rest of the recipe (its conditions) have the same names.
"""

from math import pi
from pathlib import PurePath
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from millcal.physics.cutter import CuttingConditions
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.physics.hammer import HitFault
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode
from millcal.units import from_shop

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Three = tuple[float, float, float]
AxisName = Literal["fx", "fy", "fz"]
LINEAR_EDGE = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
KIENZLE = ("kt_N_per_mm2", "kr_N_per_mm2", "ka_N_per_mm2", "mt", "mr", "ma")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    def si(self, key: str):
        """A key's value in SI, element by element; None stays None."""
        value = getattr(self, key)
        if isinstance(value, tuple):
            return tuple(from_shop(item, key) for item in value)
        return None if value is None else from_shop(value, key)


class LawTable(_Table):
    """`[simulate.law]`: the six keys of the linear-edge law, or the six of Kienzle's."""

    Ktc_N_per_mm2: float | None = None
    Krc_N_per_mm2: float | None = None
    Kac_N_per_mm2: float | None = None
    Kte_N_per_mm: float | None = None
    Kre_N_per_mm: float | None = None
    Kae_N_per_mm: float | None = None
    kt_N_per_mm2: float | None = None
    kr_N_per_mm2: float | None = None
    ka_N_per_mm2: float | None = None
    mt: float | None = None
    mr: float | None = None
    ma: float | None = None

    @model_validator(mode="after")
    def _one_law(self) -> "LawTable":
        given = self.model_fields_set
        if given not in (set(LINEAR_EDGE), set(KIENZLE)):
            raise ValueError(f"give either {', '.join(LINEAR_EDGE)} or {', '.join(KIENZLE)}")
        return self

    def law(self) -> LinearEdge | Kienzle:
        """The law in SI."""
        names = LINEAR_EDGE if self.Ktc_N_per_mm2 is not None else KIENZLE
        first, last = np.array([self.si(name) for name in names]).reshape(2, 3)
        return LinearEdge(first, last) if names is LINEAR_EDGE else Kienzle(first, last)


class _ChainTable(_Table):
    """What the chains of force and acceleration share."""

    lowpass_hz: Positive | None = None
    lowpass_order: Annotated[int, Field(ge=1, le=8)] = 2
    coloured_corner_hz: Positive = 10.0
    warming_time_s: Positive = 10.0
    bits: Annotated[int, Field(ge=8, le=32)] = 16

    def _chain(self, unit: str, **more) -> MeasuringChain:
        return MeasuringChain(
            lowpass=self.lowpass_hz,
            lowpass_order=self.lowpass_order,
            noise=self.si("noise_" + unit),
            coloured_noise=self.si("coloured_noise_" + unit),
            coloured_corner=self.coloured_corner_hz,
            warming_time=self.warming_time_s,
            full_scale=self.si("full_scale_" + unit),
            bits=self.bits,
            **more,
        )


class ForceChainTable(_ChainTable):
    """`[simulate.hammer]`, and the measuring part of `[simulate.dynamometer]`."""

    noise_N: NotNegative = 0.0
    coloured_noise_N: NotNegative = 0.0
    full_scale_N: Positive | None = None

    def chain(self) -> MeasuringChain:
        """The chain in SI."""
        return self._chain("N")


class AccelerometerTable(_ChainTable):
    """`[simulate.accelerometer]`: alike for all accelerometers."""

    noise_g: NotNegative = 0.0
    coloured_noise_g: NotNegative = 0.0
    full_scale_g: Positive | None = None

    def chain(self) -> MeasuringChain:
        """The chain in SI."""
        return self._chain("g")


class DynamometerTable(ForceChainTable):
    """`[simulate.dynamometer]`: lists are in x, y, z of the tool."""

    resonance_hz: Three | None = None
    zeta: Three | None = None
    offset_N: Three = (0.0, 0.0, 0.0)
    drift_N_per_s: Three = (0.0, 0.0, 0.0)
    warming_N: Three = (0.0, 0.0, 0.0)
    map: dict[AxisName, Annotated[str, Field(pattern=r"^[+-]\w+$")]] = {}
    acts_on: Literal["tool", "workpiece"] = "tool"

    @model_validator(mode="after")
    def _whole(self) -> "DynamometerTable":
        if (self.resonance_hz is None) != (self.zeta is None):
            raise ValueError("resonance_hz and zeta belong together")
        if self.map and len({column[1:] for column in self.map.values()}) != 3:
            raise ValueError('map names three different columns, such as {fx = "+Fy", fy = "+Fx", fz = "+Fz"}')
        return self

    def chain(self) -> MeasuringChain:
        """The chain in SI."""
        return self._chain(
            "N",
            resonance=self.resonance_hz or (),
            damping_ratio=self.zeta or (),
            offset=self.offset_N,
            drift=self.drift_N_per_s,
            warming=self.warming_N,
        )


class ModeTable(_Table):
    """`[[simulate.modes]]`: one mode of the structure, with its shape over named points."""

    fn_hz: Positive
    zeta: Annotated[float, Field(gt=0, lt=1)]
    k_N_per_m: Positive
    shape: dict[str, float]

    def mode(self) -> ShapedMode:
        """The mode in SI."""
        return ShapedMode(self.fn_hz, self.zeta, self.k_N_per_m, tuple(self.shape.items()))


class LineTable(_Table):
    """An entry of `lines`: a force that does not follow the spindle."""

    frequency_hz: Positive
    amplitude_N: Three


class _RecordingTable(_Table):
    """What cuts and impact tests share."""

    recording: Annotated[str, Field(pattern=r"^[\w.-]+\.(h5|csv|txt)$")]
    sample_rate_hz: Positive | None = None
    accelerometers: tuple[str, ...] = ()


class CutTable(_RecordingTable):
    """`[[simulate.cuts]]`"""

    format: Literal["dynoware", "csv"] = "dynoware"  # of a text file
    spindle_speed_rpm: Positive
    feed_per_tooth_mm: Positive | None = None
    feed_mm_per_min: Positive | None = None
    axial_depth_mm: Positive
    radial_depth_mm: Positive
    direction: Literal["up", "down", "slot"]
    duration_s: Positive  # of the steady cut
    air_before_s: NotNegative = 0.0
    air_after_s: NotNegative = 0.0
    ramp_s: NotNegative = 0.0
    start_time_s: float = 0.0  # of the first row
    measuring_time_s: Positive | None = None  # that the text header claims; the file may be a part
    initial_angle_deg: float | None = None  # None: drawn
    speed_error: float = 0.0  # share by which the spindle misses its speed
    speed_variation: float = 0.0
    speed_variation_hz: Positive = 1.0
    pulse: bool = False
    pulse_angle_deg: float = 0.0
    dynamometer: bool = True
    lines: tuple[LineTable, ...] = ()

    @model_validator(mode="after")
    def _one_feed(self) -> "CutTable":
        if (self.feed_per_tooth_mm is None) == (self.feed_mm_per_min is None):
            raise ValueError("give feed_per_tooth_mm or feed_mm_per_min")
        if not self.dynamometer and not self.accelerometers:
            raise ValueError("without dynamometer and accelerometers nothing is recorded")
        return self

    def conditions(self, teeth: int) -> CuttingConditions:
        """The conditions in SI."""
        speed = self.si("spindle_speed_rpm")
        feed = self.si("feed_per_tooth_mm")
        if feed is None:
            feed = self.si("feed_mm_per_min") / (teeth * speed / (2 * pi))
        return CuttingConditions(speed, feed, self.si("axial_depth_mm"), self.si("radial_depth_mm"), self.direction)


class FaultTable(_Table):
    """An entry of `faults`: a hit gone wrong."""

    hit: Annotated[int, Field(ge=0)]
    kind: Literal["double", "weak", "overload"]
    ratio: Positive
    delay_ms: NotNegative = 0.0


class ImpactTable(_RecordingTable):
    """`[[simulate.impacts]]`"""

    hammer: str
    hits: Annotated[int, Field(ge=1)]
    record_s: Positive
    peak_N: Positive
    pulse_ms: Positive
    pretrigger_s: NotNegative = 0.01
    peak_spread: NotNegative = 0.1
    pulse_spread: NotNegative = 0.05
    onset_jitter_s: NotNegative = 0.0
    layout: Literal["segmented", "continuous"] = "segmented"
    faults: tuple[FaultTable, ...] = ()

    def options(self) -> dict:
        """The arguments of `simulate_impact` that this table gives, in SI."""
        keys = ("record_s", "peak_N", "pulse_ms", "pretrigger_s", "onset_jitter_s")
        return {key.rsplit("_", 1)[0]: self.si(key) for key in keys} | {
            "hammer": self.hammer,
            "accelerometers": self.accelerometers,
            "hits": self.hits,
            "peak_spread": self.peak_spread,
            "pulse_spread": self.pulse_spread,
            "layout": self.layout,
            "faults": tuple(HitFault(f.hit, f.kind, f.ratio, f.si("delay_ms")) for f in self.faults),
        }


class SimulateTable(_Table):
    """`[simulate]`"""

    sample_rate_hz: Positive = 25600.0
    law: LawTable | None = None
    dynamometer: DynamometerTable = DynamometerTable()
    accelerometer: AccelerometerTable = AccelerometerTable()
    hammer: ForceChainTable = ForceChainTable()
    modes: tuple[ModeTable, ...] = ()
    cuts: tuple[CutTable, ...] = ()
    impacts: tuple[ImpactTable, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> "SimulateTable":
        if not self.cuts and not self.impacts:
            raise ValueError("nothing to simulate: add [[simulate.cuts]] or [[simulate.impacts]]")
        if self.cuts and self.law is None:
            raise ValueError("cuts need the coefficients of [simulate.law]")
        sensors = [table.accelerometers for table in (*self.cuts, *self.impacts)]
        if any(sensors) and not self.modes:
            raise ValueError("accelerometers need the structure's [[simulate.modes]]")
        names = [table.recording for table in (*self.cuts, *self.impacts)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two recordings are named {twice[0]}")
        for table in self.impacts:
            if PurePath(table.recording).suffix != ".h5":
                raise ValueError(f"{table.recording}: an impact test is written as .h5")
            if not table.accelerometers:
                raise ValueError(f"{table.recording}: an impact test needs accelerometers")
            if any(fault.kind == "overload" for fault in table.faults) and self.hammer.full_scale_N is None:
                raise ValueError(f"{table.recording}: an overload needs [simulate.hammer] full_scale_N")
        for table in self.cuts:
            if self.dynamometer.map and PurePath(table.recording).suffix == ".h5":
                raise ValueError(f"{table.recording}: a map is for text; a recording holds the tool's axes")
        return self
