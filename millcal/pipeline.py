"""The main job: a recipe's recordings through all its stages into one result folder. Only this file knows their order.

    cuts -> conditioning ----------------> coefficients -> stability -> report
    hits on the dynamometer -> sensor ----------^             |
    impact tests -> frf -> modes (or modes by hand) ----------^
                     v
    cuts heard by accelerometers -> forces -> coefficients, where no dynamometer was there

Methods that follow coefficients through a cut take its samples in place of what conditioning makes of them, and leave a
history: the map stands on where it ends.

A recipe may leave stages out; what is left out for a reason of the recipe is said in a notice. The map stands on the FRF,
as it was measured and with its noise, unless its window or the record's end has bent it, or the recipe says otherwise. The
folder takes its place as a whole at the end (`io.replacing`), so that a run that is killed leaves the old result or none.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from millcal.data import (
    CoefficientHistory,
    Coefficients,
    CutForce,
    CutSamples,
    CutTests,
    CutVibration,
    ForceHarmonics,
    Frf,
    Modes,
    Notice,
    Record,
    Recording,
)
from millcal.errors import IllPosedError, MillcalError, RecipeError, RecordingError
from millcal.io.cuts_log import cuts_on_map, read_cuts_log
from millcal.io.frf_files import read_frf
from millcal.io.history_table import write_history_table
from millcal.io.keys import in_si
from millcal.io.provenance import provenance
from millcal.io.recipe_tables import ForcesTable, FrfTable
from millcal.io.recipes import Impact, Recipe
from millcal.io.recordings import read_recording
from millcal.io.replacing import check_folder, replaced_folder, tidy_remains
from millcal.io.results import read_result, write_result, write_results, write_text_atomically
from millcal.io.summaries import summarise, summarise_notices, value_at, without_nan
from millcal.report.page import render
from millcal.stages.coefficients.choice import follows, identify_coefficients, own_options
from millcal.stages.coefficients.from_forces import coefficients_of_forces
from millcal.stages.conditioning import condition_cut
from millcal.stages.conditioning.samples import sample_cut
from millcal.stages.conditioning.vibration import condition_vibration
from millcal.stages.forces import reconstruct_forces
from millcal.stages.forces.advice import advise_speeds
from millcal.stages.forces.problem import spindle_harmonics
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import corrected_frf, fit_modes
from millcal.stages.stability import advise, map_stability

Progress = Callable[[float, str], None]  # share done in 0..1, what is being done

RECORD_FILES = {name: f"{name}.h5" for name in ("frf", "sensor", "modes", "forces", "coefficients", "stability")}
HISTORY_TABLE = "history.csv"
FILES = ("cuts.h5", *RECORD_FILES.values(), HISTORY_TABLE, "summary.json", "report.html")


@dataclass(frozen=True)
class PipelineResult:
    """What a run found, or why it did not run."""

    summary: dict[str, Any]  # what summary.json holds
    results: dict[str, Any] = field(
        default_factory=dict
    )  # cuts, samples or vibrations (tuples), frf, sensor, modes, forces, coefficients, ...
    notices: tuple[Notice, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    skipped: bool = False  # the recipe's recordings are absent

    @property
    def missed(self) -> list[dict[str, Any]]:
        """The expectations that failed."""
        return [entry for entry in self.summary.get("expect", []) if not entry["ok"]]


def run(recipe: Recipe, out: Path, *, progress: Progress | None = None, seed: int | None = None) -> PipelineResult:
    """Run every stage a recipe names and replace the result folder `out`; the same recipe gives the same bytes.

    progress : called with (share, label)   seed : in place of the recipe's
    """
    absent = [path for path in recipe.recordings if not path.is_file()]
    if recipe.recordings and set(absent) >= set(recipe.recordings) - {
        recipe.test_cuts
    }:  # a log alone is nothing to fit
        message = f"skipped, because its recordings are absent ({absent[0]}); put them there to run it"
        notice = Notice("data-absent", message, str(recipe.path))
        return PipelineResult({"title": recipe.title}, notices=(notice,), skipped=True)
    if absent:
        _refuse_absent(recipe, absent[0])
    if not recipe.recordings:
        raise RecipeError(f"{recipe.path}: no recordings to fit; name them under [[cuts]], [impact] or [sensor]")
    out = Path(out)
    tidy_remains(out.resolve())
    check_folder(out, lambda name: name in FILES or name.endswith(".mk"), "result")
    seed = recipe.seed if seed is None else seed
    with _at_its_line(recipe):
        results, recordings, notices = _stages(recipe, seed, progress or (lambda share, label: None))
    origin = provenance(recipe.recordings, recipe.text, seed)
    summary = _summary(recipe, results, recordings, notices, origin)
    with replaced_folder(out) as folder:
        _write(folder, results, summary, origin)
    return PipelineResult(summary, results, tuple(notices), origin)


def _stages(recipe: Recipe, seed: int, progress: Progress) -> tuple[dict[str, Any], list[dict[str, Any]], list[Notice]]:
    """The records of all stages, what was recorded, and every notice, each once."""
    results: dict[str, Any] = {}
    recordings: list[dict[str, Any]] = []
    notices: list[Notice] = []
    following = bool(recipe.cuts) and recipe.forces is None and follows(recipe.coefficients.method)
    kind = "samples" if following else "cuts" if recipe.forces is None else "vibrations"
    ends = (0.0, 0.1, 0.15, 0.2, 0.2, 0.9, 1.0) if following else (0.0, 0.45, 0.55, 0.7, 0.8, 0.9, 1.0)
    taken = list(pairwise(ends))  # shares of the progress

    if recipe.cuts:
        _check_options(recipe)
        cuts = _cuts(recipe, _part(progress, *taken[0]), recordings, notices)
        results[kind] = cuts
    if recipe.impact or recipe.frf_file:
        results["frf"] = (
            _frf(recipe.impact, recipe.frf, _part(progress, *taken[1]), recordings, notices)
            if recipe.impact
            else _frf_of_file(recipe.frf_file, notices)
        )
        _modes(recipe, results, _part(progress, *taken[2]), notices)
    elif recipe.structure:
        results["modes"] = recipe.structure.modes
    if recipe.sensor_test:
        tests = recipe.sensor_test
        results["sensor"] = _frf(
            tests, tests.frf, _part(progress, *taken[3]), recordings, notices, form="transmissibility"
        )
    if recipe.forces is not None:
        results["forces"] = _forces(recipe.forces, cuts, results, _part(progress, *taken[4]))
        results["coefficients"] = coefficients_of_forces(results["forces"])
        notices += [*results["forces"].notices, *results["coefficients"].notices]
    elif recipe.cuts:
        progress(taken[4][0], "coefficients")
        results["coefficients"] = identify_coefficients(
            cuts,
            sensor=read_result(recipe.sensor, Frf) if recipe.sensor else results.get("sensor"),
            smoothing=recipe.conditioning.arguments()["lowpass"] if following else None,
            rng=np.random.default_rng(seed),
            progress=_part(progress, *taken[4]),
            **recipe.coefficients.arguments(),
        )
        notices += results["coefficients"].notices
    if recipe.stability:
        dynamics = _dynamics(recipe, results, notices)
        reason = _why_no_map(results.get("coefficients"), dynamics)
        if reason:
            notices.append(Notice("no-stability-map", reason, recipe.where("stability")))
        else:
            arguments = _map_arguments(recipe, results["coefficients"])
            results["stability"] = map_stability(
                dynamics,
                results["coefficients"].posterior,
                modes=results.get("modes") if recipe.stability.dynamics in (None, "modes") else None,
                **arguments,
                tests=_test_cuts(recipe, arguments, notices),
                rng=np.random.default_rng(seed),
                progress=_part(progress, *taken[5]),
            )
            notices += results["stability"].notices
            if results["coefficients"].verdict != "fits":
                said = "the map rests on coefficients whose verdict is not `fits`, and its band knows nothing of that"
                notices.append(Notice("doubtful-coefficients", said, recipe.where("stability")))
    return results, recordings, list(dict.fromkeys(notices))


def _check_options(recipe: Recipe) -> None:
    """Refuse options that do not go with the method before anything is read."""
    given = recipe.coefficients.arguments()
    method = (
        given.pop("method") if recipe.forces is None else "gtls"
    )  # or another of the stage forces, with as few options
    given.pop("method", None)
    own_options(method, sensor=bool(recipe.sensor or recipe.sensor_test), **given)
    if not follows(method):
        return
    if "harmonics" in recipe.conditioning.model_fields_set:
        raise RecipeError(f"conditioning.harmonics: method {method} takes every sample and no harmonics; leave it out")


def _cuts(
    recipe: Recipe, progress: Progress, recordings: list, notices: list[Notice]
) -> tuple[CutForce, ...] | tuple[CutSamples, ...] | tuple[CutVibration, ...]:
    """Read the cuts one at a time, and condition them, or take their samples where the method follows those."""
    found: list[Any] = []
    for number, entry in enumerate(recipe.cuts):
        part = _part(progress, number / len(recipe.cuts), (number + 1) / len(recipe.cuts), entry.recording.name)
        setup = replace(
            recipe.setup,
            conditions=entry.conditions,
            steady=entry.steady,
            air=entry.air,
            engagement=entry.engagement,
            path_start=entry.path_start,
            spindle_phase=entry.spindle_phase,
        )
        recording = read_recording(entry.recording, setup=setup, progress=_part(part, 0.0, 0.5))
        _note(recording, entry.recording, recordings, notices)
        if recording.cutter is None or recording.conditions is None:
            missing = "cutter" if recording.cutter is None else "conditions"
            raise RecipeError(
                f"{recipe.where(f'cuts.{number}')}: no {missing}, neither here nor in {entry.recording}; "
                f"add a [{missing}] table"
            )
        found.append(_conditioned(recipe, recording, _part(part, 0.5, 1.0)))
        notices += found[-1].notices
    return tuple(found)


def _conditioned(recipe: Recipe, recording: Recording, progress: Progress) -> CutForce | CutSamples | CutVibration:
    """What the recipe's method takes of a cut."""
    options = recipe.conditioning
    if recipe.forces is not None:
        needed = spindle_harmonics(recording.cutter, recipe.forces.harmonics)
        return condition_vibration(recording, harmonics=max(options.harmonics, needed), progress=progress)
    if follows(recipe.coefficients.method):
        return sample_cut(recording, offset=options.offset, progress=progress)
    return condition_cut(recording, progress=progress, **options.arguments())


def _forces(
    options: ForcesTable, cuts: tuple[CutVibration, ...], results: Mapping[str, Any], progress: Progress
) -> ForceHarmonics:
    """Forces from what accelerometers heard of the cuts and in the impact tests; where asked for, speeds for the next cut."""
    progress(0.0, "forces")
    if options.frf == "modes" and "modes" not in results:
        raise IllPosedError('forces.frf: no modes could be fitted to the FRF; write "measured"')
    modes = results["modes"] if options.frf == "modes" else None
    forces = reconstruct_forces(cuts, results["frf"], modes=modes, progress=progress, **options.arguments())
    if options.advise_rpm is None:
        return forces
    try:
        advice = advise_speeds(
            results["frf"],
            forces.cutter,
            forces.conditions[-1],
            spindle_speed=in_si(options.advise_rpm, "rpm"),
            harmonics=options.harmonics,
            given=forces,
        )
    except IllPosedError as problem:
        told = Notice("no-advice", f"no speeds for the next cut: {problem}", "forces.advise_rpm")
        return replace(forces, notices=(*forces.notices, told))
    return replace(forces, advice=advice)


def _frf(
    impact: Impact, options: FrfTable, progress: Progress, recordings: list, notices: list[Notice], **more: str
) -> Frf:
    """Read impact tests and estimate their FRF.   more : arguments in place of the options'"""
    tests = []
    share = 0.5 / len(impact.recordings)
    for number, path in enumerate(impact.recordings):
        part = _part(progress, number * share, (number + 1) * share)
        tests.append(read_recording(path, setup=impact.setup, progress=part))
        _note(tests[-1], path, recordings, notices)
    frf = estimate_frf(tests, progress=_part(progress, 0.5, 1.0), **{**options.arguments(), **more})
    notices += frf.notices
    return frf


def _frf_of_file(path: Path, notices: list[Notice]) -> Frf:
    """An FRF that was made before, and what was found about it then."""
    frf = read_frf(path)
    notices += frf.notices
    return frf


def _modes(recipe: Recipe, results: dict[str, Any], progress: Progress, notices: list[Notice]) -> None:
    """Fit modes to the FRF; where there are none to fit the FRF is still worth its report."""
    if not recipe.modes.fit:
        return
    try:
        results["modes"] = fit_modes(results["frf"], progress=progress, **recipe.modes.arguments())
    except IllPosedError as problem:
        reason = f"none could be fitted: {str(problem).removeprefix('modes: ')}"
        notices.append(Notice("no-modes", reason, recipe.where("modes")))
    else:
        notices += results["modes"].notices


def _dynamics(recipe: Recipe, results: Mapping[str, Any], notices: list[Notice]) -> Frf | Modes | None:
    """What the map stands on: as the recipe says, else what `advise` says."""
    frf, modes, wanted = results.get("frf"), results.get("modes"), recipe.stability.dynamics
    method = recipe.stability.method
    if frf is None or wanted == "modes" or method in recipe.stability.OF_MODES:
        return modes
    if wanted is None and modes is not None:
        wanted, why = advise(frf, modes)
        if method == "frf" and wanted == "modes":  # which are another method's
            wanted = "corrected" if frf.damping_shift else "frf"
        if why and wanted != "frf":
            name = {"modes": "its modes", "corrected": "the FRF without that"}[wanted]
            what = f"{why}: the map stands on {name}; stability.dynamics chooses"
            notices.append(Notice(f"map-from-{wanted}", what, recipe.where("stability"), "note"))
    if wanted == "corrected":
        return None if modes is None else corrected_frf(frf, modes)
    return modes if wanted == "modes" else frf


def _note(recording: Recording, path: Path, recordings: list, notices: list[Notice]) -> None:
    """Keep what a recording is, not its samples."""
    recordings.append({**summarise(recording), "path": path.as_posix()})
    notices += recording.notices


def _why_no_map(coefficients: Coefficients | CoefficientHistory | None, dynamics: Frf | Modes | None) -> str:
    """What a stability map lacks, empty when nothing."""
    if coefficients is None:
        return "no map, because no cuts give coefficients; add [[cuts]]"
    if dynamics is None:
        return (
            "no map, because the dynamics are unknown; add [impact] recordings that show modes, or [[structure.modes]]"
        )
    posterior = coefficients.posterior
    needed = ("kt", "kr") if posterior.law == "kienzle" else ("Ktc", "Krc")
    missing = [name for name in needed if name not in posterior.names]
    if missing:
        why = (
            "the harmonics of these cuts do not show it"
            if len(missing) == 1
            else "the harmonics of these cuts show neither"
        )
        return (
            f"no map, because {' and '.join(missing)} are not known: {why}; cut with fewer teeth or less radial depth, where the "
            "force within the tooth passing depends on the chip"
        )
    if not posterior[needed[0]] > 0:
        return f"no map, because {needed[0]} is not positive; see the checks of the coefficients, the axis map first"
    return ""


def _map_arguments(recipe: Recipe, coefficients: Coefficients | CoefficientHistory) -> dict[str, Any]:
    """Options of the map; what the recipe does not say is that of the cuts, where they agree."""
    options = recipe.stability.arguments()
    cutter, cuts = coefficients.cutter, coefficients.conditions
    given = {
        name: options.pop(name)
        for name in ("radial_depth", "direction", "feed_per_tooth", "operating_speed", "axial_depth")
    }
    for name, key in (("radial_depth", "radial_depth_mm"), ("direction", "direction")):
        if given[name] is None:
            values = {getattr(conditions, name) for conditions in cuts}
            if len(values) > 1:
                where = recipe.where(f"stability.{key}")
                raise RecipeError(f"{where}: the cuts differ in it; say which the map is for")
            given[name] = values.pop()
    if given["feed_per_tooth"] is None:  # a map for the best feed that was tried, if none is named
        given["feed_per_tooth"] = max(conditions.feed_per_tooth for conditions in cuts)
    speed, depth = given.pop("operating_speed"), given.pop("axial_depth")
    return {
        **options,
        **given,
        "teeth": cutter.teeth,
        "diameter": cutter.diameter,
        "pitch": cutter.pitch,
        "helix": cutter.helix,
        "runout": (cutter.runout * np.cos(cutter.runout_angle), cutter.runout * np.sin(cutter.runout_angle)),
        "operating_point": None if speed is None else (speed, depth),
    }


def _test_cuts(recipe: Recipe, arguments: Mapping[str, Any], notices: list[Notice]) -> CutTests | None:
    """Cuts of the recipe's log that belong on the map."""
    if recipe.test_cuts is None:
        return None
    slot = arguments["direction"] == "slot" or arguments["radial_depth"] is None
    made, told = cuts_on_map(
        read_cuts_log(recipe.test_cuts),
        recipe.test_cuts,
        radial_depth=arguments["diameter"] if slot else arguments["radial_depth"],
        direction=arguments["direction"],
        diameter=arguments["diameter"],
    )
    notices += told
    return made


def _summary(
    recipe: Recipe, results: Mapping[str, Any], recordings: list, notices: list[Notice], origin: dict[str, Any]
) -> dict[str, Any]:
    """What summary.json holds: the answers first, then what they rest on."""
    fit = summarise(results["coefficients"]) if "coefficients" in results else {}
    chart = summarise(results["stability"]) if "stability" in results else {}
    for key in ("limit", "probability"):  # the curves are in stability.h5
        chart.pop(key, None)
    if "simulated" in chart:
        del chart["simulated"]["cuts"]
    modes = summarise(results["modes"]) if "modes" in results else {}
    summary = {
        "title": recipe.title,
        "verdict": fit.pop("verdict", None),
        "coefficients": fit.pop("coefficients", None),
        "modes": modes.pop("modes", None),
        "best": chart.pop("best", None),
        "expect": [],
        "report": "report.html",
        **{key: fit.pop(key, None) for key in ("method", "law", "r2", "residual_rms_N", "checks")},
        **{key: fit.pop(key) for key in ("slope_percent_per_min", "jumps") if key in fit},  # of a history
        "fit": fit or None,
        "stability": chart or None,
        "modal_fit": modes or None,
        "frf": summarise(results["frf"]) if "frf" in results else None,
        "sensor": summarise(results["sensor"]) if "sensor" in results else None,
        **({"forces": summarise(results["forces"])} if "forces" in results else {}),
        "cuts": [summarise(cut) for key in ("cuts", "samples", "vibrations") for cut in results.get(key, ())],
        "recordings": recordings,
        **summarise_notices(notices),
        "provenance": origin,
    }
    summary = without_nan(summary)
    summary["expect"] = [_expectation(summary, key, wanted) for key, wanted in recipe.expect.items()]
    return summary


def _expectation(summary: Mapping[str, Any], key: str, wanted: tuple[float, float] | str) -> dict[str, Any]:
    """An expectation beside what was found; a text is met by what begins with it."""
    value = value_at(summary, key)
    if isinstance(wanted, str):
        return {
            "key": key,
            "value": value,
            "interval": wanted,
            "ok": isinstance(value, str) and value.startswith(wanted),
        }
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return {"key": key, "value": value, "interval": list(wanted), "ok": is_number and wanted[0] <= value <= wanted[1]}


def _write(folder: Path, results: Mapping[str, Any], summary: dict[str, Any], origin: dict[str, Any]) -> None:
    """All files of a result folder."""
    for key in ("cuts", "vibrations"):
        if results.get(key):
            write_results(folder / "cuts.h5", results[key], provenance=origin)
    for name, file in RECORD_FILES.items():
        if isinstance(results.get(name), Record):
            write_result(folder / file, results[name], provenance=origin)
    if isinstance(results.get("coefficients"), CoefficientHistory):
        write_history_table(folder / HISTORY_TABLE, results["coefficients"])
    text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_text_atomically(folder / "summary.json", text)
    write_text_atomically(folder / "report.html", render(results, summary, origin))


def _refuse_absent(recipe: Recipe, path: Path) -> None:
    keys = {
        **{cut.recording: f"cuts.{number}.recording" for number, cut in enumerate(recipe.cuts)},
        **{cut.table: f"cuts.{number}.engagement" for number, cut in enumerate(recipe.cuts) if cut.table},
        **({recipe.test_cuts: "stability.tests"} if recipe.test_cuts else {}),
        **{
            test: f"{key}.recordings.{number}"
            for key, tests in (("impact", recipe.impact), ("sensor", recipe.sensor_test))
            for number, test in enumerate(tests.recordings if tests else ())
        },
    }
    other = "forces.frf_file" if path == recipe.frf_file else "coefficients.sensor"
    where = recipe.where(keys.get(path, other))
    raise RecordingError(f"{where}: {path} is absent, other recordings are there; check the path")


@contextmanager
def _at_its_line(recipe: Recipe) -> Iterator[None]:
    """A stage names the option it refuses (`stability.rpm: ...`); here the recipe's file and line are put before it."""
    try:
        yield
    except (RecipeError, IllPosedError) as problem:
        key, _, rest = str(problem).partition(": ")
        if key.split(".")[0] not in (
            "cuts",
            "impact",
            "conditioning",
            "frf",
            "modes",
            "sensor",
            "forces",
            "coefficients",
            "stability",
            "structure",
        ):
            raise
        raise _same_kind(problem, f"{recipe.where(key)}: {rest}") from None


def _same_kind(problem: MillcalError, message: str) -> MillcalError:
    return type(problem)(message)


def _part(progress: Progress, start: float, stop: float, name: str = "") -> Progress:
    """The progress of one part of the work, from 0 to 1, as that of the whole; its labels after `name`."""
    return lambda share, label: progress(start + (stop - start) * share, f"{name}: {label}" if name else label)
