"""Cutting coefficients from dynamometer cuts: `millcal identify`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, check_files, keep_and_reply, pairs, progress_bar

METHODS = ("nls", "average")  # those of the stage, which --help must not import; a test keeps them equal
LAWS = ("linear-edge", "kienzle")


def identify(
    recordings: Annotated[list[Path], typer.Argument(metavar="CUT...", help="Recordings of cuts, one feed each.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Result file, HDF5.")],
    method: Annotated[
        str, typer.Option("--method", help="nls: force within the revolution; average: mean forces.")
    ] = "nls",
    law: Annotated[str, typer.Option("--law", help="linear-edge, or kienzle (nls only).")] = "linear-edge",
    setup: Annotated[
        Path | None, typer.Option("--setup", help="SETUP.toml with [cutter], [conditions], [map], [units].")
    ] = None,
    feed_per_tooth_mm: Annotated[
        list[float] | None,
        typer.Option(
            "--feed-per-tooth-mm", help="Feed of each recording in turn, where neither file nor setup says it."
        ),
    ] = None,
    rows: Annotated[
        str, typer.Option("--rows", help="whole-revolutions, or all rows of the steady part (average only).")
    ] = "whole-revolutions",
    contact_loss: Annotated[
        str, typer.Option("--contact-loss", help="report, fit (runout c0 is an unknown too) or off (average only).")
    ] = "report",
    harmonics: Annotated[
        int | None,
        typer.Option("--harmonics", min=1, help="Highest harmonic used (nls); default: the teeth, or all of --sensor."),
    ] = None,
    taper: Annotated[bool, typer.Option("--taper", help="Let the runout vary along the axis (nls).")] = False,
    mean_weight: Annotated[
        float, typer.Option("--mean-weight", min=0.0, help="Weight of mean forces (nls); 1 where offsets are suspect.")
    ] = 5.0,
    sensor: Annotated[
        Path | None, typer.Option("--sensor", help="FRF of the dynamometer, force over force, a result file (nls).")
    ] = None,
    lowpass_hz: Annotated[
        float | None, typer.Option("--lowpass-hz", help="Zero-phase low-pass before all else.")
    ] = None,
    maps: Annotated[
        list[str] | None, typer.Option("--map", metavar="fx=+Fy", help="Tool axis = signed column.")
    ] = None,
    units: Annotated[list[str] | None, typer.Option("--unit", metavar="Fx=N", help="Unit of a column.")] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", help="Sampling rate, where the file does not say it.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Cutting coefficients from dynamometer cuts, with intervals, checks and a verdict.

    Example: millcal identify slot_f*.h5 --method nls -o coefficients.h5
    """
    if method not in METHODS:
        raise typer.BadParameter(f"{method!r} is not known; there are: {', '.join(METHODS)}", param_hint="--method")
    if law not in LAWS:
        raise typer.BadParameter(f"{law!r} is not known; there are: {', '.join(LAWS)}", param_hint="--law")
    if feed_per_tooth_mm and len(feed_per_tooth_mm) != len(recordings):
        raise typer.BadParameter(f"{len(feed_per_tooth_mm)} feeds for {len(recordings)} recordings; give one for each")
    if feed_per_tooth_mm and min(feed_per_tooth_mm) <= 0:
        raise typer.BadParameter("a feed per tooth is above zero", param_hint="--feed-per-tooth-mm")

    check_files([*recordings, setup, sensor], [output], once=False)
    from millcal.data import Frf
    from millcal.errors import RecipeError
    from millcal.io.recipes import read_setup
    from millcal.io.recordings import read_recording
    from millcal.io.results import read_result
    from millcal.stages.coefficients import fit_coefficients
    from millcal.stages.conditioning import condition_cut
    from millcal.units import from_shop

    feeds: list[float | None] = [*feed_per_tooth_mm] if feed_per_tooth_mm else [None] * len(recordings)
    cuts, notices = [], []
    with progress_bar(quiet) as progress:
        for number, (path, feed) in enumerate(zip(recordings, feeds, strict=True)):
            progress(number / len(recordings), path.name)
            stated = read_setup(setup, feed_per_tooth_mm=feed) if setup else None
            recording = read_recording(
                path, setup=stated, map=pairs(maps, "--map"), units=pairs(units, "--unit"), rate_hz=rate_hz
            )
            notices += recording.notices
            conditions = recording.conditions
            for missing, value in (("cutter", recording.cutter), ("conditions", conditions)):
                if value is None:
                    raise RecipeError(f"{path}: no {missing} known; give --setup SETUP.toml with a [{missing}] table")
            if feed is not None:
                conditions = replace(conditions, feed_per_tooth=from_shop(feed, "x_mm"))
            cut = condition_cut(
                replace(recording, conditions=conditions),
                steady=recording.steady,
                air=recording.air,
                lowpass=lowpass_hz,
            )
            notices += cut.notices
            cuts.append(cut)
        progress(0.9, "coefficients")
        found = fit_coefficients(
            cuts,
            method=method,
            law=law,
            rows=rows,
            taper=taper,
            harmonics=harmonics,
            contact_loss=contact_loss,
            mean_weight=mean_weight,
            sensor=read_result(sensor, Frf) if sensor else None,
        )
    keep_and_reply(
        "identify",
        found,
        output,
        read=[*recordings, setup, sensor],
        notices=[*notices, *found.notices],
        as_json=as_json,
        quiet=quiet,
    )
