"""A published experiment again, beside its own numbers: `millcal study`."""

from pathlib import Path
from typing import Annotated

import typer

from millcal.cli.speak import Json, Quiet, progress_bar, reply
from millcal.cli.studies import Name, study_file


def study(
    name: Annotated[Name, typer.Argument(metavar="NAME", help=f"{', '.join(Name)}.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for tables and figures; an old study there is replaced.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer levels, fewer starts and fewer draws of the noise.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of everything random.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a published experiment again and set its numbers, or its claims, beside the paper's.

    trending-coefficients: Schwenzer et al. 2020, Table 3 and Figures 2 and 3. Sixteen ensemble Kalman filters and least squares
    follow cutting coefficients that rest, rise or swing, and so do two methods that the paper did not try.

    forces-from-accelerations: Pawelko et al. 2012, Figures 6 to 9. Cutting coefficients from accelerations and an impact test by
    least squares, total least squares, Tikhonov and their constraint, and by methods that know more of the errors.

    Example: millcal study trending-coefficients --out build/trending-coefficients --quick
    """
    import json

    from millcal.io.provenance import provenance
    from millcal.io.replacing import check_folder, replaced_folder, tidy_remains

    file = study_file(name)
    tidy_remains(out.resolve())
    check_folder(out, file.FILES.__contains__, "study")
    with progress_bar(quiet) as progress:
        made = file.make(quick, seed, progress)
    summary = {**made.summary, "quick": quick}
    kept = json.dumps(
        {**summary, "provenance": provenance([], seed=seed)}, indent=1, ensure_ascii=False, allow_nan=False
    )
    files = {"summary.json": kept + "\n", **made.files}
    with replaced_folder(out) as folder:
        for own, content in files.items():
            (folder / own).write_bytes(content if isinstance(content, bytes) else content.encode())
    result = {**summary, "output": str(out), "files": [str(out / own) for own in files]}
    lines = [made.text, "", *(f"{out / own}" for own in files)]
    reply("study", "\n".join(lines), result, inputs={}, notices=(), as_json=as_json, quiet=quiet)
