"""The contract's keys: one model for each table of a recipe or a SETUP.toml, in shop units as they are written.

The suffix of a key is its unit; `Table.arguments()` is the table in SI under the names without suffix, which are the
keyword arguments of the stage of that name. Recording attributes are the same keys, so recordings use these too.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.units import from_shop, suffix_of, to_shop

Positive = Annotated[float, Field(gt=0)]


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= pair[1]:
        raise ValueError(f"{list(pair)} does not rise; write [from, to] with from below to")
    return pair


def _not_falling(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"{list(pair)} is the wrong way round; write [lowest, highest]")
    return pair


def _pairs(value: Any) -> Any:
    """One pair stands for a list of one."""
    return [value] if isinstance(value, list) and value and not isinstance(value[0], list) else value


def tuple_of(item: Any, *more: Any) -> Any:
    """Type of a tuple that is written as a TOML array, its items as strict as ever."""
    return Annotated[tuple[(item, *more)], Field(strict=False)]


Span = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_rising)]
Spans = Annotated[tuple[Span, ...], Field(strict=False), BeforeValidator(_pairs)]
Interval = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_not_falling)]
Direction = Literal["up", "down", "slot"]
Quantity = Literal[
    "force", "acceleration", "velocity", "displacement", "angle", "pulse", "sound_pressure", "sound", "time", "ignore"
]


class Table(BaseModel):
    """A table of keys: unknown ones are errors, and a number is not a text."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    renamed: ClassVar[dict[str, str]] = {}  # key -> argument, where it is more than the unit's suffix
    not_arguments: ClassVar[frozenset[str]] = frozenset()  # keys that the pipeline itself reads

    def arguments(self) -> dict[str, Any]:
        """The table as keyword arguments of its stage, in SI."""
        keys = [key for key in type(self).model_fields if key not in self.not_arguments]
        return {argument_of(type(self), key): in_si(getattr(self, key), key) for key in keys}


def argument_of(table: type[Table], key: str) -> str:
    """Name of the SI argument a key becomes: `lowpass_hz` -> `lowpass`."""
    suffix = suffix_of(key)
    return table.renamed.get(key) or (key if suffix is None else key[: -len(suffix) - 1])


def in_si(value: Any, key: str) -> Any:
    """A value or a tuple of them in the unit of the key's suffix, in SI; a text, a switch and None stay."""
    if isinstance(value, tuple):
        return tuple(in_si(item, key) for item in value)
    if isinstance(value, dict):
        return {name: in_si(item, key) for name, item in value.items()}
    if value is None or isinstance(value, (str, bool)):
        return value
    return from_shop(value, "_rpm" if key == "rpm" else key)


class CutterTable(Table):
    """The cutter."""

    diameter_mm: Positive = Field(description="diameter of the cutter, mm")
    teeth: int = Field(ge=1, description="number of teeth")
    helix_deg: float = Field(0.0, gt=-89, lt=89, description="helix angle, degrees; 0 for straight teeth")
    pitch_deg: tuple_of(Positive, ...) | None = Field(
        None, description="angles from each tooth to the next in degrees, one per tooth, 360 in all; equal when absent"
    )
    runout_um: float = Field(0.0, ge=0, description="distance of the cutter's axis from the spindle's, um")
    runout_angle_deg: float = Field(0.0, description="from tooth 0 to that offset, in the sense of rotation, degrees")

    @field_validator("pitch_deg")
    @classmethod
    def _whole_turn(cls, pitch: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        if pitch is None:
            return None
        teeth = info.data.get("teeth", len(pitch))
        if len(pitch) != teeth:
            raise ValueError(f"{len(pitch)} pitches for {teeth} teeth; give one per tooth")
        if abs(sum(pitch) - 360) > 1e-4:
            raise ValueError(f"the pitches add up to {sum(pitch):g} degrees; make it 360")
        return pitch

    def cutter(self) -> Cutter:
        """The cutter in SI."""
        values = self.arguments()
        if values["pitch"] is not None:  # rounded degrees must still close the turn
            values["pitch"] = tuple(from_shop(p * 360 / sum(self.pitch_deg), "_deg") for p in self.pitch_deg)
        return Cutter(**values)


class ConditionsTable(Table):
    """How a cut was made; every key may come from `[conditions]`, from `[[cuts]]` or from the recording."""

    spindle_speed_rpm: Positive | None = Field(None, description="spindle speed, rpm")
    feed_per_tooth_mm: Positive | None = Field(None, description="feed per tooth, mm (or give feed_mm_per_min)")
    feed_mm_per_min: Positive | None = Field(None, description="feed rate, mm/min (or give feed_per_tooth_mm)")
    axial_depth_mm: Positive | None = Field(None, description="depth along the spindle, mm")
    radial_depth_mm: Positive | None = Field(
        None, description="width of engagement, mm; a slot's is the diameter when absent"
    )
    direction: Direction | None = Field(None, description="up (conventional), down (climb) or slot")
    steady_s: Span | None = Field(None, description="[from, to] of the steady cut, s; found when absent")
    air_s: Spans | None = Field(
        None, description="[from, to] of an air cut before or after, or a list of them, s; found when absent"
    )
    engagement: str | None = Field(
        None, description="engagement table (CSV) along the tool's path, in place of axial_depth_mm and radial_depth_mm"
    )
    path_start_s: float | None = Field(
        None, description="when that path begins, s; not needed with a channel of displacement whose dof is path"
    )
    spindle_phase_deg: float | None = Field(
        None,
        description="angle of tooth 0 where the pulse rises or the encoder is zero, else at the first sample, degrees; "
        "estimated when absent",
    )

    _CONDITIONS: ClassVar = ("spindle_speed_rpm", "axial_depth_mm", "direction")

    def over(self, defaults: "ConditionsTable") -> "ConditionsTable":
        """These keys, and where one is absent, that of `defaults`."""
        mine = {key: value for key, value in self if value is not None}
        theirs = {key: value for key, value in defaults if value is not None}
        feeds = {"feed_per_tooth_mm", "feed_mm_per_min"}
        if feeds & set(mine):
            theirs = {key: value for key, value in theirs.items() if key not in feeds}
        return ConditionsTable(**{k: v for k, v in {**theirs, **mine}.items() if k in ConditionsTable.model_fields})

    def trouble(self, cutter: Cutter | None) -> tuple[str, str] | None:
        """What keeps these keys from being conditions: (key, `what is wrong; what to do`); None when nothing does."""
        feeds = [key for key in ("feed_per_tooth_mm", "feed_mm_per_min") if getattr(self, key) is not None]
        if len(feeds) == 2:
            return feeds[1], "stands beside feed_per_tooth_mm; give one of the two"
        for key in self._CONDITIONS:
            if getattr(self, key) is None:
                return key, f"is missing; give {type(self).model_fields[key].description}"
        if not feeds:
            return "feed_per_tooth_mm", "is missing; give the feed per tooth in mm, or feed_mm_per_min"
        if cutter is None:
            return "", "conditions without a cutter; add a [cutter] table"
        if self.radial_depth_mm is None and self.direction != "slot":
            return "radial_depth_mm", "is missing; give the width of engagement, mm"
        diameter = to_shop(cutter.diameter, "_mm")
        if self.radial_depth_mm is not None and self.radial_depth_mm > diameter * (1 + 1e-9):
            return "radial_depth_mm", f"{self.radial_depth_mm:g} is more than the diameter, {diameter:g}; correct one"
        if self.direction == "slot" and self.radial_depth_mm is not None and self.radial_depth_mm < 0.999 * diameter:
            return "radial_depth_mm", (
                f"{self.radial_depth_mm:g} is no slot of a cutter of {diameter:g} mm; write direction = up or down"
            )
        return None

    def has_conditions(self) -> bool:
        """Whether any key of the conditions is given at all."""
        return any(getattr(self, key) is not None for key in type(self).model_fields if key in _CONDITION_KEYS)

    def are_whole(self) -> bool:
        """Whether all is given that conditions need, right or wrong."""
        fed = self.feed_per_tooth_mm is not None or self.feed_mm_per_min is not None
        wide = self.radial_depth_mm is not None or self.direction == "slot"
        return fed and wide and all(getattr(self, key) is not None for key in self._CONDITIONS)

    def conditions(self, cutter: Cutter) -> CuttingConditions:
        """The conditions in SI; `trouble` must have found nothing."""
        v = self.arguments()
        feed = v["feed_per_tooth"]
        if feed is None:
            feed = from_shop(self.feed_mm_per_min / (self.spindle_speed_rpm * cutter.teeth), "_mm")
        radial = cutter.diameter if v["radial_depth"] is None else v["radial_depth"]
        return CuttingConditions(v["spindle_speed"], feed, v["axial_depth"], radial, v["direction"])


_CONDITION_KEYS = frozenset(ConditionsTable.model_fields) - {
    "steady_s",
    "air_s",
    "engagement",
    "path_start_s",
    "spindle_phase_deg",
}


def keys_of(cutter: Cutter | None, conditions: CuttingConditions | None) -> dict[str, Any]:
    """A cutter and conditions as the contract's keys, for recording attributes and JSON."""
    keys: dict[str, Any] = {}
    if cutter is not None:
        keys = {
            "diameter_mm": to_shop(cutter.diameter, "_mm"),
            "teeth": cutter.teeth,
            "helix_deg": to_shop(cutter.helix, "_deg"),
            "runout_um": to_shop(cutter.runout, "_um"),
            "runout_angle_deg": to_shop(cutter.runout_angle, "_deg"),
        }
        if cutter.pitch is not None:
            keys["pitch_deg"] = [to_shop(pitch, "_deg") for pitch in cutter.pitch]
    if conditions is not None:
        keys["spindle_speed_rpm"] = to_shop(conditions.spindle_speed, "_rpm")
        keys["feed_per_tooth_mm"] = to_shop(conditions.feed_per_tooth, "_mm")
        keys["axial_depth_mm"] = to_shop(conditions.axial_depth, "_mm")
        keys["radial_depth_mm"] = to_shop(conditions.radial_depth, "_mm")
        keys["direction"] = conditions.direction
    return {key: float(f"{value:.12g}") if isinstance(value, float) else value for key, value in keys.items()}


class ChannelTable(Table):
    """One channel of a file that does not say enough about itself; the table's name is the channel's."""

    column: str | None = Field(None, description="column of a text file; the channel's own name when absent")
    number: int | None = Field(None, ge=0, description="column number of a text file without a header, from 0")
    dataset: str | None = Field(None, description="path of the dataset in an HDF5 file that is no recording")
    quantity: Quantity | None = Field(None, description="what is measured; by the unit when absent")
    unit: str | None = Field(None, description="unit of the values, such as N, kN, lbf, g, m/s^2, mm, V")
    sensitivity: str | None = Field(None, description="of a channel in V, with its unit, such as '10 mV/N'")
    dof: str | None = Field(None, description="point and direction, such as tipX; a minus in front turns the channel")
    scale: float | None = Field(None, description="value = stored x scale, before the unit")
    full_scale: float | None = Field(None, gt=0, description="input range in the channel's unit, to see overload")
    role: Literal["hammer", "response"] | None = Field(
        None, description="of a force in an impact test: the hammer (when absent), or response for a dynamometer's"
    )
    delay_s: float | None = Field(None, description="by which the signal is behind the others, s; negative: ahead")


class Hdf5Table(Table):
    """Where things are in an HDF5 file that is no recording of millcal; its channels stand under [channels]."""

    sample_rate: str | None = Field(None, description="path of the sample rate in Hz: 'group/dataset' or 'group@name'")
    time: str | None = Field(None, description="path of a dataset of times")
    attributes: dict[str, str] = Field(
        default_factory=dict, description="key of the cut -> path of its value, such as 'run@rpm'"
    )


class TextTable(Table):
    """How a text file is written, where it cannot be told from the file."""

    delimiter: str | None = Field(None, description="what parts the columns; found when absent")
    decimal: Literal[".", ","] | None = Field(None, description="the decimal mark; found when absent")
    encoding: str | None = Field(None, description="utf-8, latin-1, gbk, ...; found when absent")
    skip_rows: int | None = Field(None, ge=0, description="rows before the header; found when absent")
    columns: tuple_of(str, ...) | None = Field(None, description="names of the columns of a file without a header")
    time: str | None = Field(None, description="name of the time column; found when absent")
    time_unit: Literal["s", "ms", "us", "h:m:s"] | None = Field(None, description="unit of the time column")


class SourceTables(Table):
    """How the columns of a file become channels; the same in recipes, in [impact] and in a SETUP.toml."""

    map: dict[str, str] = Field(
        default_factory=dict,
        description="channel = signed column, such as fx = '+Fy'; also acts_on = tool or workpiece",
    )
    units: dict[str, str] = Field(default_factory=dict, description="column = unit, such as Fx = 'N'")
    acts_on: Literal["tool", "workpiece"] | None = Field(
        None, description="what the force channels act on; the reaction of a table dynamometer is turned"
    )
    sample_rate_hz: Positive | None = Field(None, description="sample rate, Hz, where the file does not say it")
    channels: dict[str, ChannelTable] = Field(
        default_factory=dict, description="one table for each channel that needs more than a unit"
    )
    hdf5: Hdf5Table | None = Field(None, description="where things are in a foreign HDF5 file")
    text: TextTable | None = Field(None, description="how a text file is written")

    @field_validator("map")
    @classmethod
    def _map(cls, mapping: dict[str, str]) -> dict[str, str]:
        acts_on = mapping.get("acts_on", "tool")
        if acts_on not in ("tool", "workpiece"):
            raise ValueError(f"acts_on = {acts_on!r} is neither tool nor workpiece; write one of them")
        columns = [value.strip().lstrip("+-").strip() for key, value in mapping.items() if key != "acts_on"]
        for key, column in zip([key for key in mapping if key != "acts_on"], columns, strict=True):
            if not column:
                raise ValueError(f"{key} names no column; write for example {key} = '+Fy'")
            if columns.count(column) > 1:
                raise ValueError(f"column {column} is used more than once; map each column to one channel")
        return mapping


class ModeTable(Table):
    """One mode of the structure at the tool tip."""

    renamed: ClassVar = {"fn_hz": "natural_frequency", "zeta": "damping_ratio", "k_N_per_m": "stiffness"}
    axis: Literal["x", "y", "z"] = Field(description="axis the mode moves along, x, y or z")
    fn_hz: Positive = Field(description="natural frequency, Hz")
    zeta: float = Field(gt=0, lt=1, description="damping ratio; 2 % is 0.02")
    k_N_per_m: Positive = Field(description="modal stiffness, N/m")


class StructureTable(Table):
    """Dynamics given by hand, where there is no impact test."""

    modes: tuple_of(ModeTable, ...) = Field(min_length=1, description="modes at the tool tip")


class SetupTables(SourceTables):
    """A SETUP.toml: what a recording does not say about itself."""

    kind: Literal["cut", "impact", "air"] | None = Field(None, description="what was recorded; a cut when absent")
    cutter: CutterTable | None = Field(None, description="the cutter")
    conditions: ConditionsTable = Field(default_factory=ConditionsTable, description="how the cut was made")
    structure: StructureTable | None = Field(None, description="dynamics given by hand, for `stability`")
