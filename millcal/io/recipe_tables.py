"""The tables of a recipe beside those it shares with a setup: one for each stage, its keys the stage's options."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from millcal.io.keys import (
    ConditionsTable,
    CutterTable,
    Direction,
    Interval,
    Positive,
    SourceTables,
    Span,
    StructureTable,
    Table,
    tuple_of,
)
from millcal.io.recipe_simulate import SimulateTable
from millcal.units import from_shop

Hit = Annotated[int, Field(ge=0)] | str
_BOUNDED = re.compile(r"k[tra]_N_per_mm2|m[tra]|K[tra]c_N_per_mm2|K[tra]e_N_per_mm")


def _of_coefficients(bounds: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    for key, (low, _) in bounds.items():
        if not _BOUNDED.fullmatch(key):
            raise ValueError(
                f"{key!r} is no coefficient with its unit; write for example kt_N_per_mm2, mt or Kte_N_per_mm"
            )
        if low < 0 or (low == 0 and key[0] != "m" and key[2] != "e"):
            raise ValueError(f"{key} begins at {low:g}, and a tool that cuts has it above 0; raise the lower bound")
    return bounds


Bounds = Annotated[dict[str, Span], AfterValidator(_of_coefficients)]


def bounds_in_si(bounds: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]] | None:
    """Bounds of coefficients by their names alone, in SI: {"kt_N_per_mm2": (500, 900)} is {"kt": (5e8, 9e8)}."""
    if bounds is None:
        return None
    return {key.split("_")[0]: (from_shop(low, key), from_shop(high, key)) for key, (low, high) in bounds.items()}


class CutTable(ConditionsTable):
    """One recorded cut."""

    recording: str = Field(description="file of the cut, relative to the recipe; environment variables are expanded")


class ConditioningTable(Table):
    """What is done to a cut before anything is identified from it."""

    lowpass_hz: Positive | None = Field(
        None,
        description="corner of a low-pass on the force, Hz; none when absent; methods that follow coefficients put it on "
        "the model too",
    )
    harmonics: int = Field(30, ge=1, description="number of harmonics of the spindle to save")
    offset: Literal["auto", "air", "none"] = Field(
        "auto",
        description="offset and drift: auto by the air cuts if there are any, air insists on them, none stays in",
    )


class ImpactTable(SourceTables):
    """The impact tests."""

    recordings: tuple_of(str, ...) = Field(
        min_length=1, description="list of the files of the impact tests, relative to the recipe"
    )


class FrfTable(Table):
    """Options of the FRF estimate."""

    estimator: Literal["h1", "h2", "hv"] = Field("h1", description="h1 for noise on the response, h2, hv")
    form: Literal["accelerance", "mobility", "receptance", "transmissibility"] | None = Field(
        None, description="form of the FRF; as measured when absent; transmissibility is a dynamometer's"
    )
    keep: tuple_of(Hit, ...) = Field((), description="hits to use whatever is found: 3, or 'tap_y.h5:3' among several")
    drop: tuple_of(Hit, ...) = Field((), description="hits to leave out: 3, or 'tap_y.h5:3' among several recordings")
    allow_double: bool = Field(False, description="use double hits too")
    weak: float = Field(0.15, ge=0, lt=1, description="hits below this share of the median peak are left out")
    hold_off_s: Positive = Field(0.1, description="pulses closer than this are one hit, s")
    record_length_s: Positive | None = Field(None, description="length of each hit, s; by its decay when absent")
    resolution_hz: Positive | None = Field(None, description="distance of the lines at most, Hz, by adding zeros")
    exponential: float | None = Field(
        None, gt=0, lt=1, description="value at the record's end of an exponential window; modes are corrected for it"
    )
    delays_s: dict[str, float] | None = Field(
        None, description="channel or dof = s by which its signal is behind, {acc_tipX = 12e-6}"
    )
    flip: tuple_of(str, ...) = Field((), description="channels or dofs to turn: a dof is that of a response")


class ModesTable(Table):
    """Options of the modal fit, which follows the FRF of an impact test."""

    renamed: ClassVar = {"complex": "complex_modes"}
    not_arguments: ClassVar = frozenset({"fit"})
    fit: bool = Field(True, description="fit modes to the FRF of [impact]; false leaves them out")
    band_hz: Span | None = Field(None, description="[lowest, highest] line of the fit, Hz; the usable band when absent")
    modes: int | None = Field(None, ge=1, description="how many modes; by the data when absent")
    near_hz: tuple_of(Positive, ...) = Field((), description="frequencies where modes are known to be, Hz")
    remainder: int | None = Field(
        None, ge=0, le=4, description="terms for the modes outside the band; three when absent"
    )
    complex: bool | None = Field(None, description="complex modes, true or false; by the data when absent")
    most: int = Field(12, ge=1, description="most modes that are fitted where `modes` is absent")


class SensorTable(ImpactTable):
    """Impact tests on the dynamometer itself, whose force channels have the role response."""

    frf: FrfTable = Field(default_factory=FrfTable, description="options of the estimate of its transmissibility")

    @field_validator("frf")
    @classmethod
    def _of_forces(cls, frf: FrfTable) -> FrfTable:
        if frf.form not in (None, "transmissibility"):
            raise ValueError(f"form = {frf.form!r}: a dynamometer's FRF is a transmissibility; leave the form out")
        return frf


class CoefficientsTable(Table):
    """Options of the identification."""

    not_arguments: ClassVar = frozenset({"sensor"})
    method: Literal["nls", "average", "smooth", "imm", "rls", "enkf", "enkf-inflated", "gtls"] = Field(
        "nls",
        description="nls: the force within the revolution; average: mean forces; gtls: from accelerations, see [forces]; the "
        "others follow coefficients that change through the samples of each cut: smooth knows the whole record, imm, rls, enkf "
        "and enkf-inflated go in the order of time",
    )
    law: Literal["linear-edge", "kienzle"] = Field("linear-edge", description="force law")
    rows: Literal["whole-revolutions", "all"] = Field(
        "whole-revolutions", description="which samples the mean forces are taken over (average)"
    )
    taper: bool = Field(False, description="let the runout vary along the cutter (nls)")
    harmonics: int | None = Field(None, ge=1, description="highest harmonic of the fit; chosen when absent (nls)")
    contact_loss: Literal["report", "fit", "off"] = Field(
        "report",
        description="teeth that miss the cut by runout: report them, fit the runout with the coefficients, or off (average)",
    )
    mean_weight: Positive = Field(5.0, description="weight of the mean force beside one harmonic (nls)")
    runout: Literal["fit", "known"] = Field(
        "fit",
        description="estimate the runout, or take the cutter's own for known, also where that is none (following)",
    )
    chain_lowpass_hz: Positive | None = Field(
        None,
        description="corner of the Butterworth low-pass that the force went through, which becomes part of the model, Hz "
        "(following)",
    )
    chain_lowpass_order: int = Field(2, ge=1, le=8, description="order of that low-pass (following)")
    bounds: Bounds | None = Field(
        None,
        description="what is known beforehand of coefficients, {kt_N_per_mm2 = [500, 2500], mt = [0.1, 0.7]}: both of a "
        "direction or neither (following)",
    )
    chip_threshold_um: float = Field(
        0.5, ge=0, description="mean chip below which a sample says nothing, um (following)"
    )
    jumps: bool = Field(True, description="look for sudden changes, such as a chipped edge (smooth, imm)")
    forgetting: float = Field(0.98, gt=0, le=1, description="share of the past that each sample keeps (rls)")
    members: int = Field(100, ge=10, description="members of the ensemble (enkf, enkf-inflated)")
    inflate_every: int = Field(50, ge=1, description="updates between two inflations of the ensemble (enkf-inflated)")
    inflated_share: float = Field(
        0.1, gt=0, le=1, description="share of the members that each inflation draws anew (enkf-inflated)"
    )
    inflation: float = Field(
        10.0, ge=1, description="by what the first covariance is divided for these draws (enkf-inflated)"
    )
    nodes: int = Field(8, ge=2, le=64, description="Gauss nodes along each edge in contact (following)")
    sensor: str | None = Field(
        None, description="FRF file of the dynamometer, N/N; or give its tests in [sensor] (nls)"
    )

    def arguments(self) -> dict[str, Any]:
        return {**super().arguments(), "bounds": bounds_in_si(self.bounds)}


class ForcesTable(Table):
    """Options of forces from accelerations; with this table the cuts need no dynamometer, and [impact] hits their sensors."""

    not_arguments: ClassVar = frozenset({"frf", "frf_file", "advise_rpm"})
    method: Literal["gtls", "rtls", "constrained-ls", "tikhonov", "tls", "ls"] = Field(
        "gtls",
        description="gtls: weighted by the noise of cut and FRF, with all that the law demands; the others to compare: "
        "constrained-ls and rtls with what the law demands, tikhonov, tls and ls without",
    )
    harmonics: int | None = Field(None, ge=1, description="harmonics of the tooth passing; chosen when absent")
    phase: Literal["auto", "fit", "known"] = Field(
        "auto",
        description="angle of tooth 0: fit it with the coefficients, take the stated one for known, or auto: one that is "
        "stated holds to 3 degrees, one that is not is fitted",
    )
    runout: Literal["auto", "fit", "known"] = Field(
        "auto",
        description="fit the runout with the coefficients, take the cutter's own for known, also where that is none, or auto: "
        "it is fitted where the harmonics of the spindle show it and the cutter has none stated",
    )
    regularization: Literal["gcv", "l-curve", "discrepancy"] | Positive = Field(
        "gcv", description="where the weight comes from, or the weight itself in (m/s^2)/N (tikhonov)"
    )
    slack_N: float = Field(0.0, ge=0, description="by how much forces may miss what the law demands, N (rtls)")
    frf: Literal["measured", "modes"] = Field(
        "measured", description="the FRF as measured with its noise, or the modes fitted to it"
    )
    frf_file: str | None = Field(None, description="file of an FRF, in place of [impact]")
    advise_rpm: Span | None = Field(
        None, description="[lowest, highest] spindle speed among which the best for the next cut is sought, rpm"
    )

    def trouble(self) -> tuple[str, str] | None:
        """A key that does not go with the method: (key, `what is wrong; what to do`); None where all do."""
        if self.regularization != "gcv" and self.method != "tikhonov":
            return "regularization", f"goes with method tikhonov, not {self.method}; leave it out"
        if self.slack_N > 0 and self.method != "rtls":
            return "slack_N", f"goes with method rtls, not {self.method}; leave it out"
        return None


class StabilityTable(Table):
    """Options of the stability map; what is absent is that of the cuts, where they agree."""

    renamed: ClassVar = {
        "rpm": "spindle_speed",
        "spindle_speed_rpm": "operating_speed",
        "process_damping_N_per_mm": "indentation",
        "friction": "indentation_friction",
    }
    not_arguments: ClassVar = frozenset({"dynamics", "tests"})
    OF_MODES: ClassVar = ("floquet", "time-domain")
    method: Literal["zoa", "floquet", "frf", "time-domain"] | None = Field(
        None,
        description="zoa: zero-order approximation; right in interrupted cuts too are floquet, of modes, and frf, of the FRF as "
        "measured; time-domain: of modes, with teeth that leave the cut; when absent floquet of modes where "
        "it differs from zoa, else zoa",
    )
    dynamics: Literal["frf", "corrected", "modes"] | None = Field(
        None,
        description="what the map stands on: frf as measured, corrected for what windows and the records' ends took "
        "away, or the modes fitted to it; when absent the FRF, and one of the others where it is bent or the method needs modes",
    )
    rpm: Span = Field(description="[lowest, highest] spindle speed of the map, rpm")
    points: int = Field(400, ge=2, le=20_000, description="number of speeds of the map")
    deepest_mm: Positive | None = Field(
        None, description="how deep to look, mm; by the map itself when absent, with zoa as deep as there are limits"
    )
    members: int = Field(2000, ge=0, description="draws for the band on the limit and for probabilities; 0 for none")
    probability: bool | Annotated[int, Field(ge=2)] = Field(
        False, description="map of the probability that a cut is stable: true, or its number of depths"
    )
    rigid: Literal["", "x", "y"] = Field("", description="axis without measured dynamics that is known to be rigid")
    radial_depth_mm: Positive | None = Field(None, description="width of engagement, mm; the cuts' when absent")
    direction: Direction | None = Field(None, description="up, down or slot; the cuts' when absent")
    feed_per_tooth_mm: Positive | None = Field(None, description="feed per tooth for removal rates, mm")
    process_damping_N_per_mm: float = Field(
        0.0, ge=0, description="indentation constant of process damping, N/mm (floquet, time-domain); 0 for none"
    )
    friction: float = Field(0.3, ge=0, description="friction of the flank, with process damping")
    spindle_speed_rpm: Positive | None = Field(None, description="spindle speed of the operating point, rpm")
    axial_depth_mm: Positive | None = Field(None, description="axial depth of the operating point, mm")
    tests: str | None = Field(
        None, description="cuts log (CSV) of cuts judged stable or not, to hold against the map; relative to the recipe"
    )
    simulate: tuple_of(Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]) | None = Field(
        None, description="[speeds, depths] of a grid of cuts in the time domain, whatever the method"
    )

    def trouble(self) -> tuple[str, str] | None:
        """A key that does not go with the method: (key, `what is wrong; what to do`); None where all do."""
        modal = self.method in self.OF_MODES
        if modal and self.dynamics in ("frf", "corrected"):
            return "dynamics", f"method {self.method} is of modes; leave the key out"
        if self.method == "frf" and self.dynamics == "modes":
            return "dynamics", 'method frf is of the FRF as measured; leave the key out, or write method = "floquet"'
        if self.process_damping_N_per_mm and self.method is not None and not modal:
            return "process_damping_N_per_mm", f"method {self.method} knows none; take floquet, or leave it out"
        if "friction" in self.model_fields_set and not self.process_damping_N_per_mm:
            return "friction", "counts with process_damping_N_per_mm alone; write that, too, or leave it out"
        if self.probability and self.members < 2:
            return "probability", "needs draws; leave `members` out"
        return None


def _interval_or_text(value: Any) -> Any:
    """An expectation is an interval of numbers, or the beginning of a text."""
    if isinstance(value, str):
        return value
    if isinstance(value, list) and len(value) == 2 and all(type(item) in (int, float) for item in value):
        return tuple(float(item) for item in value)
    raise ValueError("is neither [lowest, highest] nor a text; write for example [690, 720]")


class RecipeTables(SourceTables):
    """A recipe: one calibration, from the recordings to the report."""

    title: str = Field("", description="title of the report; the file's name when absent")
    seed: int = Field(0, ge=0, description="seed of everything random")
    cutter: CutterTable | None = Field(None, description="the cutter")
    conditions: ConditionsTable = Field(
        default_factory=ConditionsTable, description="keys of [[cuts]] that are the same for every cut"
    )
    cuts: tuple_of(CutTable, ...) = Field((), description="the recorded cuts")
    conditioning: ConditioningTable = Field(default_factory=ConditioningTable, description="conditioning of the cuts")
    impact: ImpactTable | None = Field(None, description="impact tests at the tool tip")
    frf: FrfTable = Field(default_factory=FrfTable, description="options of the FRF estimate")
    modes: ModesTable = Field(default_factory=ModesTable, description="options of the modal fit")
    structure: StructureTable | None = Field(None, description="dynamics given by hand")
    sensor: SensorTable | None = Field(None, description="impact tests on the dynamometer, for the fit")
    forces: ForcesTable | None = Field(
        None, description="options of forces from accelerations, in place of forces measured"
    )
    coefficients: CoefficientsTable = Field(
        default_factory=CoefficientsTable, description="options of the identification"
    )
    stability: StabilityTable | None = Field(None, description="options of the stability map; no map when absent")
    simulate: SimulateTable | None = Field(None, description="synthetic recordings to write")
    expect: dict[str, Annotated[Interval | str, BeforeValidator(_interval_or_text)]] = Field(
        default_factory=dict,
        description="dotted path into summary.json = [lowest, highest], or the beginning of a text",
    )

    @field_validator("expect")
    @classmethod
    def _named(cls, expect: dict[str, Any]) -> dict[str, Any]:
        for key in expect:
            if not all(key.split(".")):
                raise ValueError(f"{key!r} is no dotted path; write for example 'coefficients.Ktc_N_per_mm2'")
        return expect
