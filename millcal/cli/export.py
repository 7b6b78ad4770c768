"""An FRF to the files of other programs, and theirs to a result of millcal: `millcal export`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, check_files, reply


def export(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FRF", help="FRF of any known format (HDF5, UFF, CutPro, CSV); several are joined."),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--output", help="File to write; its suffix says how: .uff, .unv, .frf, .csv, .h5.")
    ],
    form: Annotated[
        Literal["accelerance", "mobility", "receptance"] | None,
        typer.Option("--form", help="Form to write; default: as it is."),
    ] = None,
    binary: Annotated[
        bool, typer.Option("--binary", help="Binary numbers in a universal file (58b), with all their digits.")
    ] = False,
    response: Annotated[
        list[str] | None,
        typer.Option(
            "--response",
            metavar="DOF",
            help="Dof of the response, of each file or of all: tipX; -tipX turns its values.",
        ),
    ] = None,
    hammer: Annotated[
        list[str] | None,
        typer.Option("--hammer", metavar="DOF", help="Dof of the hammer, of each file or of all: tipX."),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit", metavar="UNIT", help="Unit of the files' numbers, which tells their form: g/N, m/s^2/N, m/N."
        ),
    ] = None,
    conjugate: Annotated[
        bool, typer.Option("--conjugate", help="The files have the other sign of the imaginary part.")
    ] = False,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option("--band", metavar="LO HI", help="Usable band in Hz; default: as the files say, else all lines."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """An FRF to the files of other programs, or theirs to HDF5, with form, unit and dofs stated where a file is silent.

    Example: millcal export x.frf y.frf --response tipX --response tipY --hammer tipX --hammer tipY -o tip.h5
    """
    check_files(files, [out])
    from millcal.io.frf_files import converted, read_frf, write_frf
    from millcal.io.provenance import provenance
    from millcal.io.readable import text_of
    from millcal.io.summaries import summarise

    frf = read_frf(
        files,
        unit=unit,
        outputs=response,
        inputs=hammer,
        conjugate=conjugate,
        band=band,
    )
    if form is not None:
        frf = converted(frf, form)
    origin = provenance(files, seed=seed)
    written = write_frf(out, frf, binary=binary, provenance=origin)
    paths = [str(path) for path in written.paths]
    reply(
        "export",
        "\n".join([text_of(frf), *(f"written: {path}" for path in paths)]),
        {**summarise(frf), "output": str(out), "files": paths},
        inputs=origin["inputs"],
        notices=[*frf.notices, *written.notices],
        as_json=as_json,
        quiet=quiet,
    )
