"""A result folder's report again: `millcal report`."""

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, reply


class FigureFormat(StrEnum):
    """As `report.paper.sheet.FORMATS`, which is too heavy for --help."""

    pdf = "pdf"
    png = "png"
    svg = "svg"


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder that 'millcal fit' wrote.")],
    figures: Annotated[Path | None, typer.Option(help="Folder for figures to print, made where it is missing.")] = None,
    format: Annotated[FigureFormat, typer.Option(help="Format of these figures.")] = FigureFormat.pdf,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Make report.html of a result folder again from its records, without computing anything.

    With --figures also a file for each figure of a paper: stability map, frequency response, modes, force over one revolution,
    mean force against feed, coefficients or their history; as wide as one or two columns of a journal, 8 pt type, the fonts within.

    Example: millcal report build/slot-demo --figures build/figures
    """
    import json

    from millcal.data import (
        CoefficientHistory,
        Coefficients,
        CutForce,
        CutVibration,
        ForceHarmonics,
        Frf,
        Modes,
        StabilityMap,
    )
    from millcal.errors import RecordingError
    from millcal.io.provenance import sha256_of
    from millcal.io.results import (
        read_provenance,
        read_result,
        read_results,
        replaced_atomically,
        write_text_atomically,
    )
    from millcal.report.page import render

    types: dict[str, Any] = {
        "frf": Frf,
        "sensor": Frf,
        "modes": Modes,
        "forces": ForceHarmonics,
        "coefficients": (Coefficients, CoefficientHistory),
        "stability": StabilityMap,
    }
    files = [folder / f"{name}.h5" for name in ("cuts", *types)]
    there = [file for file in files if file.is_file()]
    if not there:
        raise RecordingError(f"{folder}: holds no results; make some with 'millcal fit RECIPE.toml --out {folder}'")
    results: dict[str, Any] = {file.stem: read_result(file, types[file.stem]) for file in there if file.stem != "cuts"}
    if folder / "cuts.h5" in there:
        cuts = read_results(folder / "cuts.h5", (CutForce, CutVibration))
        results["vibrations" if isinstance(cuts[0], CutVibration) else "cuts"] = cuts
    told = folder / "summary.json"
    summary = {}
    if told.is_file():
        there.append(told)
        try:
            summary = json.loads(told.read_text(encoding="utf-8"))
        except ValueError as problem:
            raise RecordingError(f"{told}: no JSON ({problem}); make the result again with 'millcal fit'") from None
    drawn = _drawn(results, figures, format.value) if figures is not None else {}
    page = folder / "report.html"
    write_text_atomically(page, render(results, summary, read_provenance(there[0])))
    for path, content in drawn.items():
        with replaced_atomically(path) as temporary:
            temporary.write_bytes(content)
    inputs = {file.as_posix(): sha256_of(file) for file in there}
    lines = [f"report: {page}", *(f"figure: {path}" for path in drawn)]
    result = {"report": str(page), "figures": [str(path) for path in drawn]}
    notices = _older(figures, drawn) if figures is not None else ()
    reply("report", "\n".join(lines), result, inputs=inputs, notices=notices, as_json=as_json, quiet=quiet)


def _drawn(results: dict[str, Any], folder: Path, format: str) -> dict[Path, bytes]:
    """The files of all figures that can be made of the records, to be written into a folder."""
    from millcal.errors import RecordingError
    from millcal.report.paper import figure_files

    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"{folder}: is a file; name a folder for the figures")
    files = figure_files(results, format)
    if not files:
        raise RecordingError(
            f"{folder}: there is nothing to draw; figures need coefficients, an FRF or a stability map, "
            f"and the results are only {', '.join(sorted(results))}"
        )
    return {folder / name: content for name, content in files.items()}


def _older(folder: Path, drawn: Iterable[Path]) -> list[Any]:
    """A word about figures in the folder that bear our names but are not of this result."""
    from millcal.data import Notice
    from millcal.report.paper import NAMES

    new = {path.stem for path in drawn}
    ours = (
        path
        for path in sorted(folder.iterdir())
        if path.suffix[1:] in list(FigureFormat) and NAMES.fullmatch(path.stem)
    )
    older = [path.name for path in ours if path.stem not in new]
    message = f"older figures, not of this result: {', '.join(older)}; remove them"
    return [Notice("older-figures", message, str(folder))] if older else []
