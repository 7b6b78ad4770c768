"""The `[simulate]` table of a recipe: what synthetic recordings to make, with which truth.

The keys are the shop's; a table turns itself into SI and into the laws, modes and chains of `physics`, which is all that the
simulation knows. Keys that a cut shares with the rest of the recipe (its conditions) have the same names.
"""

from pathlib import PurePath
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from millcal.io.keys import ConditionsTable, Direction, Positive, Table, in_si, keys_of, tuple_of
from millcal.io.recipe_trends import TrendKeys
from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import Kienzle, LinearEdge
from millcal.physics.hammer import HitFault
from millcal.physics.measuring_chain import MeasuringChain
from millcal.physics.shaped_modes import ShapedMode

NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=-0.5, lt=0.5)]
Three = tuple_of(float, float, float)
LINEAR_EDGE = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
KIENZLE = ("kt_N_per_mm2", "kr_N_per_mm2", "ka_N_per_mm2", "mt", "mr", "ma")
CHANNEL = r"^[+-][A-Za-z]\w*$"


class LawTable(Table):
    """The true coefficients: the six keys of the linear-edge law, or the six of Kienzle's."""

    Ktc_N_per_mm2: float | None = Field(None, description="tangential cutting coefficient, N/mm^2")
    Krc_N_per_mm2: float | None = Field(None, description="radial cutting coefficient, N/mm^2")
    Kac_N_per_mm2: float | None = Field(None, description="axial cutting coefficient, N/mm^2")
    Kte_N_per_mm: float | None = Field(None, description="tangential edge coefficient, N/mm")
    Kre_N_per_mm: float | None = Field(None, description="radial edge coefficient, N/mm")
    Kae_N_per_mm: float | None = Field(None, description="axial edge coefficient, N/mm")
    kt_N_per_mm2: float | None = Field(None, description="tangential force on a chip of 1 mm x 1 mm, N/mm^2")
    kr_N_per_mm2: float | None = Field(None, description="radial force on a chip of 1 mm x 1 mm, N/mm^2")
    ka_N_per_mm2: float | None = Field(None, description="axial force on a chip of 1 mm x 1 mm, N/mm^2")
    mt: float | None = Field(None, lt=1, description="rise of the tangential force")
    mr: float | None = Field(None, lt=1, description="rise of the radial force")
    ma: float | None = Field(None, lt=1, description="rise of the axial force")

    @model_validator(mode="after")
    def _one_law(self) -> "LawTable":
        if self.model_fields_set not in (set(LINEAR_EDGE), set(KIENZLE)):
            raise ValueError(f"is no whole law; give {', '.join(LINEAR_EDGE)}, or {', '.join(KIENZLE)}")
        return self

    def law(self) -> LinearEdge | Kienzle:
        """The law in SI."""
        names = KIENZLE if self.Ktc_N_per_mm2 is None else LINEAR_EDGE
        first, last = np.array([in_si(getattr(self, name), name) for name in names]).reshape(2, 3)
        return Kienzle(first, last) if names is KIENZLE else LinearEdge(first, last)


class _ChainTable(Table):
    """What every measuring chain has; `arguments()` are the fields of `MeasuringChain`."""

    not_arguments: ClassVar = frozenset({"map", "acts_on"})
    lowpass_hz: Positive | None = Field(None, description="corner of the amplifier's Butterworth low-pass, Hz")
    lowpass_order: int = Field(2, ge=1, le=8, description="order of that low-pass")
    coloured_corner_hz: Positive = Field(10.0, description="corner of the coloured noise, Hz")
    bits: int = Field(16, ge=8, le=16, description="bits of the converter")

    def chain(self) -> MeasuringChain:
        """The chain in SI."""
        return MeasuringChain(**{name: value for name, value in self.arguments().items() if value is not None})


class HammerTable(_ChainTable):
    """The impact hammer's chain."""

    noise_N: NotNegative = Field(0.0, description="white noise, N rms")
    coloured_noise_N: NotNegative = Field(0.0, description="coloured noise, N rms")
    full_scale_N: Positive | None = Field(None, description="input range, N; no converter when absent")


class AccelerometerTable(_ChainTable):
    """The chain of each accelerometer."""

    noise_g: NotNegative = Field(0.0, description="white noise, g rms")
    coloured_noise_g: NotNegative = Field(0.0, description="coloured noise, g rms")
    full_scale_g: Positive | None = Field(None, description="input range, g; no converter when absent")


class ProbeTable(_ChainTable):
    """The chain of each displacement probe."""

    noise_um: NotNegative = Field(0.0, description="white noise, um rms")
    coloured_noise_um: NotNegative = Field(0.0, description="coloured noise, um rms")
    full_scale_um: Positive | None = Field(None, description="input range, um; no converter when absent")


class DynamometerTable(HammerTable):
    """The dynamometer's chain; lists are in x, y, z of the tool."""

    renamed: ClassVar = {"zeta": "damping_ratio", "drift_N_per_s": "drift"}
    resonance_hz: Three | None = Field(None, description="natural frequencies, Hz; none when absent")
    zeta: Three | None = Field(None, description="damping ratios of these resonances; 2 % is 0.02")
    cross_talk: float = Field(0.0, gt=-0.5, lt=0.5, description="share of each other axis that a channel shows")
    offset_N: Three = Field((0.0, 0.0, 0.0), description="offsets, N")
    drift_N_per_s: Three = Field((0.0, 0.0, 0.0), description="linear drifts, N/s")
    warming_N: Three = Field((0.0, 0.0, 0.0), description="what warming adds in the end, N")
    warming_time_s: Positive = Field(10.0, description="time constant of that warming, s")
    map: dict[str, Annotated[str, Field(pattern=CHANNEL)]] = Field(
        default_factory=dict, description="tool axis = signed column of a text file, such as fx = '+Fy'"
    )
    acts_on: Literal["tool", "workpiece"] = Field("tool", description="sign of a text file's forces")

    @field_validator("map")
    @classmethod
    def _three_columns(cls, mapping: dict[str, str]) -> dict[str, str]:
        if mapping and (set(mapping) != {"fx", "fy", "fz"} or len({name[1:] for name in mapping.values()}) < 3):
            raise ValueError("does not name three columns; write for example {fx = '+Fy', fy = '+Fx', fz = '+Fz'}")
        return mapping

    @model_validator(mode="after")
    def _damped(self) -> "DynamometerTable":
        if (self.resonance_hz is None) != (self.zeta is None):
            raise ValueError("resonance_hz and zeta belong together; give both")
        return self


class ModeTable(Table):
    """One mode of the structure, with its shape over named points."""

    fn_hz: Positive = Field(description="natural frequency, Hz")
    zeta: float = Field(gt=0, lt=1, description="damping ratio; 2 % is 0.02")
    k_N_per_m: Positive = Field(description="stiffness where the shape is 1, N/m")
    shape: dict[str, float] = Field(description="displacement of each point and direction, such as {tipX = 1.0}")

    def mode(self) -> ShapedMode:
        """The mode in SI."""
        return ShapedMode(self.fn_hz, self.zeta, self.k_N_per_m, tuple(self.shape.items()))


class LineTable(Table):
    """A force that does not follow the spindle, as chatter makes it."""

    frequency_hz: Positive = Field(description="its frequency, Hz")
    amplitude_N: Three = Field(description="its amplitude in x, y, z of the tool, N")


class _RecordingTable(Table):
    """What cuts and impact tests share."""

    recording: str = Field(pattern=r"^\w[\w.-]*\.(h5|csv|txt)$", description="file name ending in .h5, .csv or .txt")
    sample_rate_hz: Positive | None = Field(None, description="sample rate, Hz; that of [simulate] when absent")
    accelerometers: tuple_of(str, ...) = Field((), description="points and directions of the accelerometers")


class SimulatedCutTable(_RecordingTable, TrendKeys):
    """One cut to simulate."""

    format: Literal["dynoware", "csv"] = Field("dynoware", description="form of a text file")
    spindle_speed_rpm: Positive | None = Field(None, description="spindle speed, rpm")
    feed_per_tooth_mm: Positive | None = Field(None, description="feed per tooth, mm (or give feed_mm_per_min)")
    feed_mm_per_min: Positive | None = Field(None, description="feed rate, mm/min (or give feed_per_tooth_mm)")
    axial_depth_mm: Positive | None = Field(None, description="depth along the spindle, mm")
    radial_depth_mm: Positive | None = Field(None, description="width of engagement, mm")
    direction: Direction | None = Field(None, description="up (conventional), down (climb) or slot")
    duration_s: Positive = Field(description="length of the steady cut, s")
    air_before_s: NotNegative = Field(0.0, description="air cut before, s")
    air_after_s: NotNegative = Field(0.0, description="air cut after, s")
    ramp_s: NotNegative = Field(0.0, description="entry of the tool, and its exit, s")
    start_time_s: float = Field(0.0, description="time of the first row of a text file, s")
    measuring_time_s: Positive | None = Field(
        None, description="length the header of a text file claims, s; the file's own when absent"
    )
    initial_angle_deg: float | None = Field(
        None, description="spindle angle at the first sample, degrees; drawn when absent"
    )
    speed_error: Share = Field(0.0, description="share by which the spindle misses its speed")
    speed_variation: Share = Field(0.0, description="share by which the speed swings")
    speed_variation_hz: Positive = Field(1.0, description="frequency of that swing, Hz")
    pulse: bool = Field(False, description="record a pulse per revolution")
    pulse_angle_deg: float = Field(0.0, description="spindle angle at which the pulse rises, degrees")
    encoder: bool = Field(
        False, description="record the spindle angle, from 0 to 360 degrees; zero where the pulse rises"
    )
    encoder_counts: int = Field(3600, ge=8, le=65536, description="counts of the encoder per revolution")
    dynamometer: bool = Field(True, description="record the forces")
    lines: tuple_of(LineTable, ...) = Field((), description="forces that do not follow the spindle")
    regenerative: bool = Field(
        False, description="the force comes from the motion of the tool, so that the cut may chatter; no dynamometer"
    )
    displacements: tuple_of(str, ...) = Field(
        (), description="points and directions whose displacement is recorded, of a regenerative cut"
    )

    @model_validator(mode="after")
    def _regenerates(self) -> "SimulatedCutTable":
        if not self.regenerative:
            if self.displacements:
                raise ValueError("displacements of a cut that is not regenerative; set regenerative = true")
            return self
        if PurePath(self.recording).suffix != ".h5":
            raise ValueError(f"{self.recording} is no .h5; regenerative cuts are written as recordings")
        if not self.accelerometers and not self.displacements:
            raise ValueError("nothing is measured; give accelerometers or displacements")
        other = (
            "ramp_s",
            "lines",
            "encoder",
            "speed_variation",
            "initial_angle_deg",
            "pulse_angle_deg",
            *TrendKeys.model_fields,
        )
        given = [key for key in other if getattr(self, key) != type(self).model_fields[key].default]
        if given:
            raise ValueError(f"{given[0]} is not for a regenerative cut; leave it out")
        return self

    @model_validator(mode="after")
    def _measures(self) -> "SimulatedCutTable":
        if not self.dynamometer and not self.accelerometers and not self.displacements:
            raise ValueError("nothing is measured; give accelerometers, or leave the dynamometer in")
        return self

    def keys(self, defaults: ConditionsTable) -> ConditionsTable:
        """The cut's conditions, and where a key is absent, that of `defaults`."""
        own = {key: getattr(self, key) for key in ConditionsTable.model_fields if key in type(self).model_fields}
        return ConditionsTable(**own).over(defaults)


class FaultTable(Table):
    """A hit gone wrong."""

    hit: int = Field(ge=0, description="number of the hit, from 0")
    kind: Literal["double", "weak", "overload"] = Field(description="double, weak or overload")
    ratio: Positive = Field(
        description="second peak over the first; weak peak over the usual one; overloading peak over the full scale"
    )
    delay_ms: NotNegative = Field(0.0, description="of the second peak after the first, ms")


class SimulatedImpactTable(_RecordingTable):
    """One impact test to simulate."""

    not_arguments: ClassVar = frozenset({"recording", "sample_rate_hz", "faults", "dynamometer"})
    hammer: str = Field(description="point and direction that is hit, such as tipX")
    dynamometer: bool = Field(False, description="the hits go on the dynamometer, whose forces are recorded")
    hits: int = Field(ge=1, description="number of hits")
    record_s: Positive = Field(description="length of each hit's record, s")
    peak_N: Positive = Field(description="mean peak of the hits, N")
    pulse_ms: Positive = Field(description="mean length of the half-sine, ms")
    pretrigger_s: NotNegative = Field(0.01, description="time before the hit, s")
    peak_spread: NotNegative = Field(0.1, description="standard deviation of the peaks over their mean")
    pulse_spread: NotNegative = Field(0.05, description="standard deviation of the lengths over their mean")
    onset_jitter_s: NotNegative = Field(0.0, description="the onset varies uniformly over this time, s")
    layout: Literal["segmented", "continuous"] = Field("segmented", description="records of their own, or one long one")
    faults: tuple_of(FaultTable, ...) = Field((), description="hits gone wrong")

    @model_validator(mode="after")
    def _possible(self) -> "SimulatedImpactTable":
        if PurePath(self.recording).suffix != ".h5":
            raise ValueError(f"{self.recording} is no .h5; impact tests are written as recordings")
        if not (self.accelerometers or self.dynamometer):
            raise ValueError("no accelerometers; name their points and directions, or set dynamometer = true")
        if self.dynamometer and self.hammer not in ("tipX", "tipY", "tipZ"):
            raise ValueError(f"{self.hammer} is no axis of the dynamometer; hit it along tipX, tipY or tipZ")
        if any(fault.hit >= self.hits for fault in self.faults):
            raise ValueError(f"a fault is on a hit beyond the last, {self.hits - 1}; number hits from 0")
        return self

    def arguments(self) -> dict[str, Any]:
        """The arguments of `simulate_impact` that this table gives, in SI."""
        faults = tuple(HitFault(**fault.arguments()) for fault in self.faults)
        return super().arguments() | {"faults": faults}


class SimulateTable(Table):
    """Synthetic recordings to write, see `millcal simulate`."""

    sample_rate_hz: Positive = Field(25600.0, description="sample rate, Hz")
    law: LawTable | None = Field(None, description="true coefficients")
    conditions: ConditionsTable = Field(
        default_factory=ConditionsTable, description="keys of [[simulate.cuts]] that are the same for every cut"
    )
    dynamometer: DynamometerTable = Field(default_factory=DynamometerTable, description="chain of the dynamometer")
    accelerometer: AccelerometerTable = Field(
        default_factory=AccelerometerTable, description="chain of each accelerometer"
    )
    hammer: HammerTable = Field(default_factory=HammerTable, description="chain of the impact hammer")
    probe: ProbeTable = Field(default_factory=ProbeTable, description="chain of each displacement probe")
    modes: tuple_of(ModeTable, ...) = Field((), description="modes of the structure")
    cuts: tuple_of(SimulatedCutTable, ...) = Field((), description="cuts to simulate")
    impacts: tuple_of(SimulatedImpactTable, ...) = Field((), description="impact tests to simulate")

    @model_validator(mode="after")
    def _complete(self) -> "SimulateTable":
        tables = (*self.cuts, *self.impacts)
        names = [table.recording for table in tables]
        twice = [name for name in names if names.count(name) > 1]
        if not tables:
            raise ValueError("nothing to simulate; add [[simulate.cuts]] or [[simulate.impacts]]")
        if twice:
            raise ValueError(f"two recordings are named {twice[0]}; rename one")
        if self.conditions.engagement is not None:
            raise ValueError("an engagement table for simulated cuts, whose engagement is constant; leave it out")
        if self.cuts and self.law is None:
            raise ValueError("cuts without a law; add [simulate.law] with its coefficients")
        for key, law, other in (
            ("drift_rise", KIENZLE, "drift_edge is for the linear-edge law"),
            ("drift_edge", LINEAR_EDGE, "drift_rise is for Kienzle's"),
        ):
            if any(getattr(cut, key) is not None for cut in self.cuts) and law[0] not in self.law.model_fields_set:
                raise ValueError(f"{key} for a law that has none; {other}")
        if any(table.accelerometers for table in tables) and not self.modes:
            raise ValueError("accelerometers without a structure; add [[simulate.modes]]")
        if any(cut.regenerative for cut in self.cuts):
            if not any(value for mode in self.modes for dof, value in mode.shape.items() if dof in ("tipX", "tipY")):
                raise ValueError("a regenerative cut whose tool does not move; add modes with a shape at tipX or tipY")
            if LINEAR_EDGE[0] not in self.law.model_fields_set:
                raise ValueError("a regenerative cut by Kienzle's law; give the keys of the linear-edge law")
        overloads = [fault for table in self.impacts for fault in table.faults if fault.kind == "overload"]
        if overloads and self.hammer.full_scale_N is None:
            raise ValueError("an overload of a hammer without full scale; add full_scale_N under [simulate.hammer]")
        if self.dynamometer.map and any(PurePath(table.recording).suffix == ".h5" for table in self.cuts):
            raise ValueError(
                "a map for a cut in .h5, which holds the tool's axes; write that cut as .csv, or drop the map"
            )
        return self

    def truth(self, cutter: Cutter | None) -> dict[str, Any]:
        """What holds for every recording, in the keys of a recipe: cutter, law, dynamometer that was hit, and structure."""
        known: dict[str, Any] = {}
        if self.law is not None:
            known = {"cutter": keys_of(cutter, None), "law": self.law.model_dump(exclude_none=True)}
        if any(table.dynamometer for table in self.impacts):
            keys = ("resonance_hz", "zeta", "cross_talk", "lowpass_hz", "lowpass_order")
            known["dynamometer"] = {key: getattr(self.dynamometer, key) for key in keys}
        if self.modes:
            known["modes"] = [mode.model_dump() for mode in self.modes]
        return known
