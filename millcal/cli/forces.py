"""Cutting forces from accelerations: `millcal forces`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.cut_input import for_each
from millcal.cli.speak import Json, Quiet, Seed, check_choice, check_files, keep_and_reply, pairs, progress_bar, reply
from millcal.cli.vibration_input import hear_cuts, read_dynamics

# those of the stage, which --help must not import; a test keeps them equal
METHODS = ("gtls", "rtls", "constrained-ls", "tikhonov", "tls", "ls")
PHASES = ("auto", "fit", "known")
RUNOUTS = ("auto", "fit", "known")
WEIGHTS = ("gcv", "l-curve", "discrepancy")
FIGURES = (".png", ".svg", ".pdf")


def forces(
    frf: Annotated[Path, typer.Option("--frf", help="FRF from the forces to the sensors that heard the cuts.")],
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="CUT...", help="Recordings of cuts with accelerometers.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Result file, HDF5.")] = None,
    modes: Annotated[
        Path | None, typer.Option("--modes", help="Modes fitted to that FRF, a result file, in place of its lines.")
    ] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="SETUP.toml with [cutter], [conditions], [map], [units].")
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="gtls (default): weighted by all noise, with all that the law demands; to compare: rtls, constrained-ls, "
            "tikhonov, tls, ls.",
        ),
    ] = "gtls",
    harmonics: Annotated[
        int | None, typer.Option("--harmonics", min=1, help="Harmonics of the tooth passing; default: by the data.")
    ] = None,
    regularization: Annotated[
        str,
        typer.Option("--regularization", help="gcv, l-curve, discrepancy or a number in (m/s^2)/N (tikhonov)."),
    ] = "gcv",
    slack: Annotated[
        float, typer.Option("--slack-N", min=0.0, help="By how much forces may miss what the law demands (rtls).")
    ] = 0.0,
    phase: Annotated[
        str,
        typer.Option(
            "--phase", help="Angle of tooth 0: fit, known (as stated), or auto: one that is stated holds to 3 degrees."
        ),
    ] = "auto",
    runout: Annotated[
        str,
        typer.Option(
            "--runout", help="Runout: fit, known (the cutter's own, also none), or auto: fitted where it is seen."
        ),
    ] = "auto",
    spindle_phase_deg: Annotated[
        list[float] | None,
        typer.Option(
            "--spindle-phase-deg",
            help="Angle of tooth 0 at the pulse, the encoder's zero or the first sample: one, or one for each cut.",
        ),
    ] = None,
    compare: Annotated[bool, typer.Option("--compare", help="Print every method side by side.")] = False,
    advise: Annotated[
        bool,
        typer.Option(
            "--advise",
            help="Print the best spindle speeds for the next cut, by the FRF's lines; --setup and --frf are enough.",
        ),
    ] = False,
    rpm: Annotated[
        tuple[float, float] | None,
        typer.Option("--rpm", metavar="LO HI", help="Speeds for --advise; default: half to twice the cuts'."),
    ] = None,
    table: Annotated[Path | None, typer.Option("--csv", help="Table of the harmonics to write.")] = None,
    figure: Annotated[Path | None, typer.Option("--figure", help="Figure to write, .png, .svg or .pdf.")] = None,
    maps: Annotated[
        list[str] | None, typer.Option("--map", metavar="ax@headX=-Acc1", help="Channel at a place = signed column.")
    ] = None,
    units: Annotated[list[str] | None, typer.Option("--unit", metavar="Acc1=g", help="Unit of a column.")] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", help="Sampling rate, where the file does not say it.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: Seed = 0,
) -> None:
    """Harmonics of the cutting force, and the coefficients behind them, from accelerations in a cut and an FRF.

    Example: millcal forces cut-1.h5 cut-2.h5 --frf frf.h5 --compare -o forces.h5

    Example: millcal forces --frf frf.h5 --setup setup.toml --advise --rpm 3000 12000
    """
    recordings = recordings or []
    check_choice("--method", method, METHODS)
    check_choice("--phase", phase, PHASES)
    check_choice("--runout", runout, RUNOUTS)
    weight = _weight(regularization)
    if regularization != "gcv" and method != "tikhonov":
        raise typer.BadParameter(f"goes with --method tikhonov, not {method}", param_hint="--regularization")
    if slack > 0 and method != "rtls":
        raise typer.BadParameter(f"goes with --method rtls, not {method}", param_hint="--slack-N")
    if rpm is not None and not advise:
        raise typer.BadParameter("--rpm is the range of --advise; add it, or leave --rpm out")
    if rpm is not None and not 0 < rpm[0] < rpm[1]:
        raise typer.BadParameter(f"--rpm {rpm[0]:g} {rpm[1]:g} is no range; give the lowest speed, then the highest")
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise typer.BadParameter(
            f"{figure} does not say its format; end it with {', '.join(FIGURES)}", param_hint="--figure"
        )
    if recordings and output is None:
        raise typer.BadParameter("-o is needed: the file for the result")
    if not recordings:
        of_cuts = {"--csv": table, "--compare": compare, "--modes": modes, "--spindle-phase-deg": spindle_phase_deg}
        of_cuts |= {"--method": method != "gtls", "--phase": phase != "auto", "--runout": runout != "auto"}
        of_cuts |= {"--regularization": regularization != "gcv", "--slack-N": slack > 0}
        _without_cuts(advise, setup, {**of_cuts, "--map": maps, "--unit": units, "--rate-hz": rate_hz})
    phases = for_each(spindle_phase_deg, len(recordings), "--spindle-phase-deg") if recordings else []
    read = [*recordings, frf, modes, setup]
    check_files(recordings, [])
    check_files(read, [output, table, figure], once=False)

    with progress_bar(quiet) as progress:
        progress(0.0, frf.name)
        dynamics, fitted, notices = read_dynamics(frf, modes)
        found = None
        if recordings:
            cuts, told = hear_cuts(
                recordings,
                setup,
                feeds=[None] * len(recordings),
                phases=phases,
                harmonics=harmonics,
                progress=lambda share, label: progress(0.6 * share, label),
                map=pairs(maps, "--map"),
                units=pairs(units, "--unit"),
                rate_hz=rate_hz,
            )
            from millcal.stages.forces import reconstruct_forces

            found = reconstruct_forces(
                cuts,
                dynamics,
                method=method,
                harmonics=harmonics,
                modes=fitted,
                phase=phase,
                runout=runout,
                regularization=weight,
                slack=slack,
                progress=lambda share, label: progress(0.6 + 0.3 * share, label),
            )
            notices += [*told, *found.notices]
        if advise:
            progress(0.9, "speeds")
            found = _advised(dynamics, setup, found, rpm, harmonics)
    said = {"read": read, "notices": notices, "as_json": as_json, "quiet": quiet, "seed": seed}
    if not recordings:
        _reply_advice(found, output, figure, **said)
        return
    keep_and_reply("forces", found, output, text=_text(found, compare), more=_drawn(found, table, figure), **said)


def _weight(written: str) -> str | float:
    """A way to choose Tikhonov's weight, or the weight itself."""
    if written in WEIGHTS:
        return written
    try:
        weight = float(written)
    except ValueError:
        weight = 0.0
    if not 0 < weight < float("inf"):
        raise typer.BadParameter(
            f"{written!r} is neither {', '.join(WEIGHTS)} nor a number above 0", param_hint="--regularization"
        )
    return weight


def _without_cuts(advise: bool, setup: Path | None, options: dict[str, Any]) -> None:
    """Refuse a call that names no cuts and asks for what only cuts can tell."""
    if not advise:
        raise typer.BadParameter("name recordings of cuts, or add --advise for the speeds to cut at")
    if setup is None:
        raise typer.BadParameter("--setup is needed with --advise and no cuts: its [cutter] and [conditions]")
    for option, given in options.items():
        if given:
            raise typer.BadParameter(f"{option} is for forces, and no cuts are named; leave it out")


def _advised(
    dynamics: Any, setup: Path | None, found: Any, rpm: tuple[float, float] | None, harmonics: int | None
) -> Any:
    """The forces with the speeds for the next cut; the speeds alone where there are no cuts."""
    from dataclasses import replace

    from millcal.errors import RecipeError
    from millcal.io.recipes import read_setup
    from millcal.stages.forces.advice import advise_speeds
    from millcal.units import from_shop

    if found is not None:
        cutter, conditions = found.cutter, found.conditions[-1]
        speeds = [cut.spindle_speed for cut in found.conditions]
    else:
        stated = read_setup(setup, spindle_speed_rpm=None if rpm is None else sum(rpm) / 2)  # it is what is asked for
        cutter, conditions = stated.cutter, stated.conditions
        for missing, value in (("cutter", cutter), ("conditions", conditions)):
            if value is None:
                raise RecipeError(f"{setup}: no {missing} to advise for; add a [{missing}] table")
        speeds = [conditions.spindle_speed]
    span = (min(speeds) / 2, 2 * max(speeds)) if rpm is None else tuple(from_shop(speed, "x_rpm") for speed in rpm)
    advice = advise_speeds(dynamics, cutter, conditions, spindle_speed=span, harmonics=harmonics, given=found)
    return advice if found is None else replace(found, advice=advice)


def _reply_advice(
    advice: Any,
    output: Path | None,
    figure: Path | None,
    *,
    read: Any,
    notices: Any,
    as_json: bool,
    quiet: bool,
    seed: int,
) -> None:
    """The speeds alone, kept and drawn where files for that are named."""
    from millcal.io.provenance import provenance
    from millcal.io.readable import text_of
    from millcal.io.results import replaced_atomically, write_result
    from millcal.io.summaries import summarise

    origin = provenance([path for path in read if path is not None], seed=seed)
    text = text_of(advice)
    result = {"advice": summarise(advice), "output": None if output is None else str(output)}
    if output is not None:
        write_result(output, advice, provenance=origin)
    if figure is not None:
        from millcal.report.paper.force_harmonics import advice_file

        drawn = advice_file(advice, figure.suffix[1:].lower())
        with replaced_atomically(figure) as temporary:
            temporary.write_bytes(drawn)
        text, result = f"{text}\nfigure: {figure}", {**result, "figure": str(figure)}
    reply("forces", text, result, inputs=origin["inputs"], notices=notices, as_json=as_json, quiet=quiet)


def _text(found: Any, compare: bool) -> str:
    from millcal.io.force_readable import compared_text
    from millcal.io.readable import text_of

    return text_of(found) + (f"\n\n{compared_text(found)}" if compare else "")


def _drawn(found: Any, table: Path | None, figure: Path | None) -> dict[str, tuple[Path, bytes]]:
    """What is written of the forces besides their record."""
    from millcal.io.force_table import force_table

    files = {} if table is None else {"csv": (table, force_table(found).encode())}
    if figure is not None:
        from millcal.report.paper.force_harmonics import forces_file

        files["figure"] = (figure, forces_file(found, figure.suffix[1:].lower()))
    return files
