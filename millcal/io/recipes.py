"""Recipes and setups: TOML in shop units to frozen objects in SI, with every mistake named by file, line and key.

The models of the tables stand in `keys` and `recipe_tables`; here they are read, checked against each other, and made
into what the stages take.
"""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from millcal.data import Modes
from millcal.io.engagement import completed, read_engagement
from millcal.io.keys import (
    ChannelTable,
    ConditionsTable,
    Hdf5Table,
    SetupTables,
    SourceTables,
    StructureTable,
    TextTable,
)
from millcal.io.recipe_simulate import SimulateTable
from millcal.io.recipe_tables import (
    CoefficientsTable,
    ConditioningTable,
    ForcesTable,
    FrfTable,
    ImpactTable,
    ModesTable,
    RecipeTables,
    StabilityTable,
)
from millcal.io.toml_documents import Document, read_toml, validated
from millcal.io.toml_places import Loc
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.tool_path import ToolPath


@dataclass(frozen=True)
class Setup:
    """What a recording does not say about itself: how its columns become channels, the cutter and the conditions."""

    map: dict[str, str] = field(default_factory=dict)  # channel -> signed column: fx -> +Fy
    units: dict[str, str] = field(default_factory=dict)  # column -> unit
    acts_on: str | None = None  # tool, workpiece; None: as the file says
    sample_rate: float | None = None  # Hz
    channels: dict[str, ChannelTable] = field(default_factory=dict)
    hdf5: Hdf5Table | None = None
    text: TextTable | None = None
    kind: str | None = None  # cut, impact, air
    cutter: Cutter | None = None
    conditions: CuttingConditions | None = None
    spindle_speed: float | None = None  # rad/s, as stated, whether or not there are conditions
    axial_depth: float | None = None  # m, the same
    steady: tuple[float, float] | None = None  # s
    air: tuple[tuple[float, float], ...] | None = None  # s
    engagement: ToolPath | None = None
    path_start: float | None = None  # s
    spindle_phase: float | None = None  # rad
    modes: Modes | None = None  # of the structure at the tool tip, given by hand
    document: Document | None = field(default=None, repr=False)

    def where(self, key: str) -> str:
        """`setup.toml:4: map.fx`, for errors."""
        return self.document.where(tuple(key.split("."))) if self.document else key


@dataclass(frozen=True)
class CutEntry:
    """One recorded cut of a recipe."""

    recording: Path
    conditions: CuttingConditions | None  # None: as the recording says
    steady: tuple[float, float] | None = None  # s
    air: tuple[tuple[float, float], ...] | None = None  # s
    table: Path | None = None  # engagement table, a file that the recipe reads
    engagement: ToolPath | None = None  # what it holds; None: no table, or its file is absent
    path_start: float | None = None  # s
    spindle_phase: float | None = None  # rad


@dataclass(frozen=True)
class Impact:
    """The impact tests of a recipe, and how to read them."""

    recordings: tuple[Path, ...]
    setup: Setup


@dataclass(frozen=True)
class SensorTest(Impact):
    """Impact tests on the dynamometer."""

    frf: FrfTable


@dataclass(frozen=True)
class Structure:
    """Dynamics given by hand."""

    modes: Modes


@dataclass(frozen=True)
class Recipe:
    """One calibration: what was recorded, what to do with it, and what must come out."""

    path: Path
    text: str
    title: str
    seed: int
    cutter: Cutter | None
    cuts: tuple[CutEntry, ...]
    setup: Setup  # of the cuts; without their conditions
    impact: Impact | None
    structure: Structure | None
    conditioning: ConditioningTable
    frf: FrfTable
    modes: ModesTable
    forces: ForcesTable | None  # None: the cuts' forces were measured
    coefficients: CoefficientsTable
    stability: StabilityTable | None  # None: the recipe asks for no map
    simulate: SimulateTable | None
    expect: dict[str, tuple[float, float] | str]
    sensor: Path | None  # FRF of the dynamometer, a result file
    sensor_test: SensorTest | None  # or the impact tests it is estimated from
    frf_file: Path | None  # FRF of the sensors that heard the cuts, in place of `impact`
    test_cuts: Path | None  # cuts log to hold against the map
    document: Document = field(repr=False)

    @property
    def map(self) -> dict[str, str]:
        return self.setup.map

    @property
    def units(self) -> dict[str, str]:
        return self.setup.units

    @property
    def acts_on(self) -> str | None:
        return self.setup.acts_on

    @property
    def recordings(self) -> tuple[Path, ...]:
        """Every file the recipe reads, each once, in the recipe's order."""
        impact = self.impact.recordings if self.impact else (self.frf_file,) if self.frf_file else ()
        sensor = (self.sensor,) if self.sensor else self.sensor_test.recordings if self.sensor_test else ()
        tables = [*(cut.table for cut in self.cuts if cut.table), *([self.test_cuts] if self.test_cuts else [])]
        return tuple(dict.fromkeys([*(cut.recording for cut in self.cuts), *impact, *sensor, *tables]))

    def where(self, key: str) -> str:
        """`recipe.toml:9: stability.rpm`, for errors."""
        return self.document.where(tuple(int(part) if part.isdigit() else part for part in key.split(".")))


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe."""
    document = read_toml(path)
    tables = validated(RecipeTables, document)
    cutter = tables.cutter.cutter() if tables.cutter else None
    if not tables.cuts and not any((tables.impact, tables.sensor, tables.simulate)):
        document.refuse((), "no [[cuts]], no [impact], no [sensor] and no [simulate]; name at least one recording")
    forces = _forces(document, tables)
    frf_file = forces.frf_file if forces else None
    if "modes" in tables.model_fields_set and tables.impact is None and frf_file is None:
        document.refuse(("modes",), "no [impact] to fit modes to; add one, or give them by hand in [structure]")
    if tables.stability is not None:
        _check_stability(document, tables)
    test_cuts = tables.stability.tests if tables.stability else None
    sensor = tables.coefficients.sensor
    if sensor and tables.sensor:
        document.refuse(("coefficients", "sensor"), "the dynamometer is given twice; keep this key or [sensor]")
    return Recipe(
        path=document.path,
        text=document.text,
        title=tables.title or document.path.stem,
        seed=tables.seed,
        cutter=cutter,
        cuts=tuple(_cut(document, number, tables, cutter) for number in range(len(tables.cuts))),
        setup=_setup(tables, document, cutter=cutter, kind="cut"),
        impact=Impact(**_tests(document, "impact", tables.impact)) if tables.impact else None,
        structure=_structure(tables),
        conditioning=tables.conditioning,
        frf=tables.frf,
        modes=tables.modes,
        forces=forces,
        coefficients=tables.coefficients,
        stability=tables.stability,
        simulate=tables.simulate,
        expect=tables.expect,
        sensor=_path(document, ("coefficients", "sensor"), sensor) if sensor else None,
        sensor_test=SensorTest(**_tests(document, "sensor", tables.sensor), frf=tables.sensor.frf)
        if tables.sensor
        else None,
        frf_file=_path(document, ("forces", "frf_file"), frf_file) if frf_file else None,
        test_cuts=_path(document, ("stability", "tests"), test_cuts) if test_cuts else None,
        document=document,
    )


def read_setup(
    path: Path,
    *,
    feed_per_tooth_mm: float | None = None,
    spindle_speed_rpm: float | None = None,
    partial: bool = False,
) -> Setup:
    """Read and check a SETUP.toml.

    feed_per_tooth_mm : of this recording, in place of what the setup says   spindle_speed_rpm : where the setup says none
    partial : conditions need not be whole; where they are not there are none, and speed and depth stand by themselves
    """
    document = read_toml(path)
    tables = validated(SetupTables, document)
    if feed_per_tooth_mm is not None:
        feed = {"feed_per_tooth_mm": feed_per_tooth_mm, "feed_mm_per_min": None}
        tables = tables.model_copy(update={"conditions": tables.conditions.model_copy(update=feed)})
    if spindle_speed_rpm is not None and tables.conditions.spindle_speed_rpm is None:
        speed = {"spindle_speed_rpm": spindle_speed_rpm}
        tables = tables.model_copy(update={"conditions": tables.conditions.model_copy(update=speed)})
    cutter = tables.cutter.cutter() if tables.cutter else None
    keys, engagement = tables.conditions, None
    if keys.engagement is not None:
        engagement = read_engagement(_path(document, ("conditions", "engagement"), keys.engagement))
        keys = completed(keys, engagement, cutter)
    whole = not partial or keys.are_whole()
    conditions = _conditions(document, ("conditions",), keys, cutter) if whole else None
    given = keys.arguments()
    return _setup(
        tables,
        document,
        cutter=cutter,
        kind=tables.kind,
        conditions=conditions,
        spindle_speed=given["spindle_speed"],
        axial_depth=given["axial_depth"],
        steady=given["steady"],
        air=given["air"],
        engagement=engagement,
        path_start=given["path_start"],
        spindle_phase=given["spindle_phase"],
        modes=_modes(tables.structure),
    )


def _setup(tables: SourceTables, document: Document, **more: Any) -> Setup:
    mapping = {key: value for key, value in tables.map.items() if key != "acts_on"}
    return Setup(
        map=mapping,
        units=tables.units,
        acts_on=tables.map.get("acts_on", tables.acts_on),
        sample_rate=tables.sample_rate_hz,
        channels=tables.channels,
        hdf5=tables.hdf5,
        text=tables.text,
        document=document,
        **more,
    )


def _conditions(document: Document, loc: Loc, keys: ConditionsTable, cutter: Cutter | None) -> CuttingConditions | None:
    """Conditions from keys that were merged, None when there are none; a mistake is told at `loc`."""
    if not keys.has_conditions():
        return None
    trouble = keys.trouble(cutter)
    if trouble:
        key, what = trouble
        place = (*loc, key) if key else loc
        if (*loc, key) not in document.places and ("conditions", key) in document.places:
            place = ("conditions", key)
        document.refuse(place, what)
    return keys.conditions(cutter)


def _cut(document: Document, number: int, tables: RecipeTables, cutter: Cutter | None) -> CutEntry:
    entry = tables.cuts[number]
    loc = ("cuts", number)
    keys = entry.over(tables.conditions)
    table = engagement = None
    if keys.engagement is not None:
        place = (*loc, "engagement") if entry.engagement is not None else ("conditions", "engagement")
        table = _path(document, place, keys.engagement)
        if table.is_file():
            engagement = read_engagement(table)
            keys = completed(keys, engagement, cutter)
    given = keys.arguments()
    untold = table is not None and engagement is None  # absent, as the recordings may be: nothing to check against
    return CutEntry(
        recording=_path(document, (*loc, "recording"), entry.recording),
        conditions=None if untold else _conditions(document, loc, keys, cutter),
        steady=given["steady"],
        air=given["air"],
        table=table,
        engagement=engagement,
        path_start=given["path_start"],
        spindle_phase=given["spindle_phase"],
    )


def _tests(document: Document, key: str, table: ImpactTable) -> dict[str, Any]:
    """Recordings of impact tests and how to read them."""
    names = enumerate(table.recordings)
    paths = tuple(_path(document, (key, "recordings", number), name) for number, name in names)
    return {"recordings": paths, "setup": _setup(table, document, kind="impact")}


def _structure(tables: RecipeTables) -> Structure | None:
    modes = _modes(tables.structure)
    return None if modes is None else Structure(modes)


def _modes(structure: StructureTable | None) -> Modes | None:
    """The modes of a `[structure]` table."""
    if structure is None:
        return None
    modes = [mode.arguments() for mode in structure.modes]
    return Modes(
        natural_frequency=[mode["natural_frequency"] for mode in modes],
        damping_ratio=[mode["damping_ratio"] for mode in modes],
        stiffness=[mode["stiffness"] for mode in modes],
        axes=tuple(mode["axis"] for mode in modes),
    )


def _forces(document: Document, tables: RecipeTables) -> ForcesTable | None:
    """Options of forces from accelerations, None where the cuts' forces were measured; what does not go together is refused."""
    forces, coefficients = tables.forces, tables.coefficients
    chosen = "method" in coefficients.model_fields_set
    if forces is None and not (chosen and coefficients.method == "gtls"):
        return None
    place: Loc = ("coefficients", "method") if forces is None else ("forces",)
    if not tables.cuts:
        document.refuse(place, "no [[cuts]] to reconstruct the forces of; name at least one recording")
    forces = forces or ForcesTable()
    if chosen and coefficients.method != "gtls":
        what = f"{coefficients.method!r} is for forces that were measured, and [forces] reconstructs them"
        document.refuse(("coefficients", "method"), f'{what}; leave one out, or write "gtls"')
    if chosen and forces.method != "gtls":
        what = f'{forces.method!r} beside coefficients.method = "gtls", and the coefficients come of these forces'
        document.refuse(("forces", "method"), f"{what}; leave one of the two out")
    trouble = forces.trouble()
    if trouble:
        document.refuse(("forces", trouble[0]), trouble[1])
    if tables.impact is not None and forces.frf_file is not None:
        document.refuse(("forces", "frf_file"), "the FRF is given twice; keep this key or [impact]")
    if tables.impact is None and forces.frf_file is None:
        document.refuse(place, "no FRF of the sensors; add [impact] with hits that they heard, or forces.frf_file")
    if forces.frf == "modes" and not tables.modes.fit:
        document.refuse(("forces", "frf"), '[modes] says that none are fitted; let it, or write "measured"')
    for key in ("lowpass_hz", "offset"):
        if key in tables.conditioning.model_fields_set:
            document.refuse(
                ("conditioning", key), "is for forces that were measured, and the cuts here give none; leave it out"
            )
    return forces


def _check_stability(document: Document, tables: RecipeTables) -> None:
    """A map needs a cutter, dynamics and coefficients."""
    if tables.cutter is None:
        document.refuse(("stability",), "no [cutter] for the map; add one")
    hit = tables.impact is not None or (tables.forces is not None and tables.forces.frf_file is not None)
    if hit and tables.structure is not None:
        other = "[impact]" if tables.impact is not None else "forces.frf_file"
        document.refuse(("structure",), f"dynamics are given twice; keep [structure] or {other}")
    trouble = tables.stability.trouble()
    if trouble:
        document.refuse(("stability", trouble[0]), trouble[1])
    method, of_modes = tables.stability.method, tables.stability.method in tables.stability.OF_MODES
    if method == "frf" and not hit:
        document.refuse(("stability", "method"), "no [impact] to take an FRF from; add one, or take floquet")
    if method == "frf" and tables.cutter.helix_deg:
        document.refuse(
            ("stability", "method"), "frf knows straight teeth alone, and the cutter has a helix; take floquet"
        )
    if method == "frf" and len(set(tables.cutter.pitch_deg or ())) > 1:
        document.refuse(("stability", "method"), "frf knows one pitch alone, and the cutter has several; take floquet")
    if of_modes and hit and not tables.modes.fit:
        document.refuse(("stability", "method"), f"{method} is of modes, and [modes] says that none are fitted; let it")
    dynamics = tables.stability.dynamics
    if dynamics in ("frf", "corrected") and not hit:
        document.refuse(("stability", "dynamics"), "no [impact] to take an FRF from; add one, or leave the key out")
    if dynamics in ("modes", "corrected") and hit and not tables.modes.fit:
        document.refuse(("stability", "dynamics"), '[modes] says that none are fitted; let it, or write "frf"')
    diameter, radial = tables.cutter.diameter_mm, tables.stability.radial_depth_mm
    if radial is not None and radial > diameter * (1 + 1e-9):
        document.refuse(
            ("stability", "radial_depth_mm"), f"{radial:g} is more than the diameter, {diameter:g}; correct one"
        )
    point = [key for key in ("spindle_speed_rpm", "axial_depth_mm") if getattr(tables.stability, key) is not None]
    if len(point) == 1:
        document.refuse(
            ("stability", point[0]), "half an operating point; give both spindle_speed_rpm and axial_depth_mm"
        )


def _path(document: Document, loc: Loc, name: str) -> Path:
    """A path of the recipe: environment variables expanded, relative to the recipe's folder."""
    if not name.strip():
        document.refuse(loc, "is empty; name a file")
    return Path(os.path.normpath(document.path.parent / os.path.expandvars(name)))
