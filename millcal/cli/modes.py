"""An FRF to modes: `millcal modes`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, check_files, keep_and_reply, progress_bar


def modes(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FRF", help="FRF: of `millcal frf`, UFF, CutPro, CSV; several are joined."),
    ],
    out: Annotated[Path, typer.Option("-o", "--output", help="File of modes to write, HDF5.")],
    band: Annotated[
        tuple[float, float] | None,
        typer.Option("--band", metavar="LO HI", help="Band of the fit in Hz; default: the usable one."),
    ] = None,
    count: Annotated[
        int | None, typer.Option("--modes", metavar="N", min=1, help="How many modes; default: by the data.")
    ] = None,
    near: Annotated[
        list[str] | None,
        typer.Option(
            "--near", metavar="HZ,HZ...", help="Where modes are known to be: 650,1200. Alone, there are no others."
        ),
    ] = None,
    most: Annotated[int, typer.Option("--most", min=1, help="Most modes that the data may ask for.")] = 12,
    remainder: Annotated[
        int | None,
        typer.Option("--remainder", min=0, max=4, help="Terms for the modes outside the band; default: three."),
    ] = None,
    complex_modes: Annotated[
        bool | None, typer.Option("--complex/--real", help="Complex or real modes; default: by the data.")
    ] = None,
    corrected: Annotated[
        Path | None,
        typer.Option("--corrected", metavar="FRF2", help="Write the FRF too, without what the records' ends cut off."),
    ] = None,
    response: Annotated[
        list[str] | None,
        typer.Option(
            "--response", metavar="DOF", help="Dof of the response, where a file does not say it: tipX, -tipX."
        ),
    ] = None,
    hammer: Annotated[
        list[str] | None,
        typer.Option("--hammer", metavar="DOF", help="Dof of the hammer, where a file does not say it."),
    ] = None,
    form: Annotated[
        Literal["accelerance", "mobility", "receptance"] | None,
        typer.Option("--form", help="What the files hold, where they do not say it."),
    ] = None,
    unit: Annotated[
        str | None, typer.Option("--unit", metavar="UNIT", help="Unit of the files' numbers: g/N, m/s^2/N, m/N.")
    ] = None,
    conjugate: Annotated[
        bool, typer.Option("--conjugate", help="The files have the other sign of the imaginary part.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Modes of an FRF: frequency, damping, stiffness, mass and shape, each with its interval.

    Example: millcal modes frf.h5 -o modes.h5
    """
    known = _frequencies(near or ())
    if band is not None and not 0 <= band[0] < band[1]:
        raise typer.BadParameter(
            f"--band {band[0]:g} {band[1]:g} is no range; give the lowest frequency, then the highest"
        )
    if count is not None and len(known) > count:
        raise typer.BadParameter(f"--modes {count} is less than the {len(known)} frequencies of --near; leave one out")
    check_files(files, [out, corrected])

    from millcal.io.frf_files import read_frf, write_frf
    from millcal.io.provenance import provenance
    from millcal.stages.modes import corrected_frf, fit_modes

    frf = read_frf(files, form=form, unit=unit, outputs=response, inputs=hammer, conjugate=conjugate)
    ours = all(path.suffix.lower() in (".h5", ".hdf5") for path in files)  # their notices were told when they were made
    told = [notice for notice in frf.notices if not ours or notice.code == "form-overruled"]
    with progress_bar(quiet) as progress:
        found = fit_modes(
            frf,
            band=band,
            modes=count,
            near=known,
            remainder=remainder,
            complex_modes=complex_modes,
            most=most,
            progress=progress,
        )
    if corrected is not None:
        origin = provenance(files, seed=seed)
        told += write_frf(corrected, corrected_frf(frf, found), provenance=origin).notices
    keep_and_reply(
        "modes",
        found,
        out,
        read=files,
        notices=[*told, *found.notices],
        seed=seed,
        as_json=as_json,
        quiet=quiet,
    )


def _frequencies(items: list[str] | tuple[str, ...]) -> tuple[float, ...]:
    """`650,1200`, once or several times, as numbers."""
    found = []
    for item in ",".join(items).split(",") if items else ():
        try:
            found.append(float(item))
        except ValueError:
            raise typer.BadParameter(f"{item!r} is no frequency in Hz; write 650,1200", param_hint="--near") from None
    return tuple(found)
