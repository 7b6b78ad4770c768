"""A result folder's report again: `millcal report`."""

from pathlib import Path
from typing import Annotated

import typer

from millcal.cli.speak import Json, Quiet, reply


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder that 'millcal fit' wrote.")],
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make report.html of a result folder again from its records, without computing anything.

    Example: millcal report build/slot-demo
    """
    import json

    from millcal.data import Coefficients, CutForce, Frf, Modes, StabilityMap
    from millcal.errors import RecordingError
    from millcal.io.provenance import sha256_of
    from millcal.io.results import read_provenance, read_result, read_results, write_text_atomically
    from millcal.report.page import render

    types = {"frf": Frf, "sensor": Frf, "modes": Modes, "coefficients": Coefficients, "stability": StabilityMap}
    files = [folder / f"{name}.h5" for name in ("cuts", *types)]
    there = [file for file in files if file.is_file()]
    if not there:
        raise RecordingError(f"{folder}: holds no results; make some with 'millcal fit RECIPE.toml --out {folder}'")
    results = {
        file.stem: read_results(file, CutForce) if file.stem == "cuts" else read_result(file, types[file.stem])
        for file in there
    }
    told = folder / "summary.json"
    summary = {}
    if told.is_file():
        there.append(told)
        try:
            summary = json.loads(told.read_text(encoding="utf-8"))
        except ValueError as problem:
            raise RecordingError(f"{told}: no JSON ({problem}); make the result again with 'millcal fit'") from None
    page = folder / "report.html"
    write_text_atomically(page, render(results, summary, read_provenance(there[0])))
    inputs = {file.as_posix(): sha256_of(file) for file in there}
    reply("report", f"report: {page}", {"report": str(page)}, inputs=inputs, notices=(), as_json=as_json, quiet=quiet)
