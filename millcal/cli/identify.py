"""Cutting coefficients from dynamometer cuts, or from what accelerometers heard: `millcal identify`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.cut_input import bounds_of, for_each, read_cut
from millcal.cli.speak import (
    Json,
    Progress,
    Quiet,
    Seed,
    check_choice,
    check_files,
    keep_and_reply,
    pairs,
    progress_bar,
)
from millcal.cli.vibration_input import hear_cuts, read_dynamics

# those of the stage, which --help must not import; a test keeps them equal
METHODS = ("nls", "average", "gtls", "smooth", "imm", "rls", "enkf", "enkf-inflated")
FOLLOWING = METHODS[3:]
FROM_ACCELERATIONS = ("gtls",)
LAWS = ("linear-edge", "kienzle")
FIGURES = (".png", ".svg", ".pdf")


def identify(
    recordings: Annotated[list[Path], typer.Argument(metavar="CUT...", help="Recordings of cuts.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Result file, HDF5.")],
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            help="nls (default): force within the revolution; average: mean forces; gtls: accelerations and --frf; and those "
            "that follow coefficients through the cut: smooth, imm, rls, enkf, enkf-inflated.",
        ),
    ] = None,
    trend: Annotated[
        bool, typer.Option("--trend", help="Coefficients that change: method smooth, or imm with --causal.")
    ] = False,
    causal: Annotated[
        bool, typer.Option("--causal", help="In the order of time, without looking ahead: method imm.")
    ] = False,
    law: Annotated[str, typer.Option("--law", help="linear-edge, or kienzle (not average).")] = "linear-edge",
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
        typer.Option(
            "--harmonics",
            min=1,
            help="Highest harmonic used (nls; of the tooth passing: gtls); default: the teeth, or all of --sensor.",
        ),
    ] = None,
    taper: Annotated[bool, typer.Option("--taper", help="Let the runout vary along the axis (nls).")] = False,
    mean_weight: Annotated[
        float, typer.Option("--mean-weight", min=0.0, help="Weight of mean forces (nls); 1 where offsets are suspect.")
    ] = 5.0,
    sensor: Annotated[
        Path | None, typer.Option("--sensor", help="FRF of the dynamometer, force over force, a result file (nls).")
    ] = None,
    frf: Annotated[
        Path | None, typer.Option("--frf", help="FRF from the forces to the sensors that heard the cuts (gtls).")
    ] = None,
    modes: Annotated[
        Path | None, typer.Option("--modes", help="Modes fitted to that FRF, in place of its lines (gtls).")
    ] = None,
    lowpass_hz: Annotated[
        float | None,
        typer.Option("--lowpass-hz", help="Low-pass before all else; methods that follow put it on the model too."),
    ] = None,
    runout: Annotated[
        str, typer.Option("--runout", help="fit, or known: the cutter's own, also none (following).")
    ] = "fit",
    chain_lowpass_hz: Annotated[
        float | None,
        typer.Option("--chain-lowpass-hz", help="Butterworth low-pass that the force went through (following)."),
    ] = None,
    chain_lowpass_order: Annotated[
        int, typer.Option("--chain-lowpass-order", min=1, max=8, help="Order of that low-pass.")
    ] = 2,
    bounds: Annotated[
        list[str] | None,
        typer.Option(
            "--bounds", metavar="kt=500:2500", help="What is known of a coefficient beforehand, N/mm2 (following)."
        ),
    ] = None,
    jumps: Annotated[
        bool, typer.Option("--jumps/--no-jumps", help="Look for sudden changes, a chipped edge (smooth, imm).")
    ] = True,
    forgetting: Annotated[
        float, typer.Option("--forgetting", help="Share of the past that each sample keeps (rls).")
    ] = 0.98,
    members: Annotated[int, typer.Option("--members", min=10, help="Members of the ensemble (enkf).")] = 100,
    inflate_every: Annotated[
        int, typer.Option("--inflate-every", min=1, help="Updates between two inflations (enkf-inflated).")
    ] = 50,
    inflation: Annotated[
        float, typer.Option("--inflation", min=1.0, help="The first covariance divided by this is the inflation.")
    ] = 10.0,
    engagement: Annotated[
        list[Path] | None,
        typer.Option("--engagement", help="Engagement table, CSV, along the path: one, or one for each cut in turn."),
    ] = None,
    path_start_s: Annotated[
        list[float] | None, typer.Option("--path-start-s", help="When that path begins: one, or one for each cut.")
    ] = None,
    spindle_phase_deg: Annotated[
        list[float] | None,
        typer.Option(
            "--spindle-phase-deg",
            help="Angle of tooth 0 at the pulse, the encoder's zero or the first sample: one, or one for each cut.",
        ),
    ] = None,
    table: Annotated[
        Path | None, typer.Option("--csv", help="Table of the coefficients over time to write (following).")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Figure of them to write, .png, .svg or .pdf (following).")
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
    seed: Seed = 0,
) -> None:
    """Cutting coefficients from dynamometer cuts, with intervals, checks and a verdict; with --trend as they change in the cut.

    Example: millcal identify slot_f*.h5 --method nls -o coefficients.h5

    Example: millcal identify cut-1.h5 cut-2.h5 --method gtls --frf frf.h5 -o coefficients.h5

    Example: millcal identify long-cut.h5 --trend --law kienzle --csv history.csv -o coefficients.h5
    """
    method = _method(method, trend, causal)
    following, hearing = method in FOLLOWING, method in FROM_ACCELERATIONS
    check_choice("--law", law, LAWS)
    check_choice("--runout", runout, ("fit", "known"))
    if feed_per_tooth_mm and len(feed_per_tooth_mm) != len(recordings):
        raise typer.BadParameter(f"{len(feed_per_tooth_mm)} feeds for {len(recordings)} recordings; give one for each")
    if feed_per_tooth_mm and min(feed_per_tooth_mm) <= 0:
        raise typer.BadParameter("a feed per tooth is above zero", param_hint="--feed-per-tooth-mm")
    if not 0 < forgetting <= 1:
        raise typer.BadParameter(f"{forgetting:g} is not above 0 and at most 1", param_hint="--forgetting")
    if chain_lowpass_hz is not None and not chain_lowpass_hz > 0:
        raise typer.BadParameter(f"{chain_lowpass_hz:g} is not above 0", param_hint="--chain-lowpass-hz")
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise typer.BadParameter(
            f"{figure} does not say its format; end it with {', '.join(FIGURES)}", param_hint="--figure"
        )
    number = len(recordings)
    tables = for_each(engagement, number, "--engagement")
    starts = for_each(path_start_s, number, "--path-start-s")
    phases = for_each(spindle_phase_deg, number, "--spindle-phase-deg")
    read = [*recordings, setup, sensor, frf, modes, *(engagement or ())]
    check_files(recordings if hearing else [], [])
    check_files(read, [output, table, figure], once=False)
    known = bounds_of(bounds)

    import numpy as np

    from millcal.data import Frf
    from millcal.errors import RecipeError
    from millcal.io.recipe_tables import bounds_in_si
    from millcal.io.results import read_result
    from millcal.stages.coefficients.choice import identify_coefficients, own_options
    from millcal.stages.conditioning import condition_cut
    from millcal.stages.conditioning.samples import sample_cut
    from millcal.units import from_shop

    options: dict[str, Any] = {
        "law": law,
        "rows": rows,
        "taper": taper,
        "harmonics": None if hearing else harmonics,
        "contact_loss": contact_loss,
        "mean_weight": mean_weight,
        "runout": runout,
        "chain_lowpass": chain_lowpass_hz,
        "chain_lowpass_order": chain_lowpass_order,
        "smoothing": lowpass_hz if following else None,
        "bounds": bounds_in_si(known),
        "jumps": jumps,
        "forgetting": forgetting,
        "members": members,
        "inflate_every": inflate_every,
        "inflation": inflation,
    }
    own_options(method, sensor=sensor is not None, **options)  # before anything is read
    for option, given, takers in (
        ("--csv", table, FOLLOWING),
        ("--figure", figure, FOLLOWING),
        ("--engagement", engagement, FOLLOWING),
        ("--path-start-s", path_start_s, FOLLOWING),
        ("--spindle-phase-deg", spindle_phase_deg, FOLLOWING + FROM_ACCELERATIONS),
        ("--frf", frf, FROM_ACCELERATIONS),
        ("--modes", modes, FROM_ACCELERATIONS),
        ("--lowpass-hz", lowpass_hz, METHODS[:2] + FOLLOWING),
    ):
        if given and method not in takers:
            trend_too = ", or add --trend" if set(FOLLOWING) <= set(takers) and not hearing else ""
            raise RecipeError(f"{option}: goes with {', '.join(takers)}, not {method}; leave it out{trend_too}")
    if hearing and frf is None:
        raise RecipeError(f"--frf: method {method} needs it, an FRF from the forces to the sensors; give one")

    feeds: list[float | None] = [*feed_per_tooth_mm] if feed_per_tooth_mm else [None] * number
    stated = {"map": pairs(maps, "--map"), "units": pairs(units, "--unit"), "rate_hz": rate_hz}
    with progress_bar(quiet) as progress:
        if frf is not None:
            heard = {"feeds": feeds, "phases": phases, "harmonics": harmonics, **stated}
            found, notices = _from_accelerations(recordings, setup, frf, modes, method, progress, heard)
        else:
            cuts, notices = [], []
            read_share = 0.1 if following else 0.9
            for i, path in enumerate(recordings):
                progress(read_share * i / number, path.name)
                recording = read_cut(
                    path,
                    setup,
                    feed=feeds[i],
                    engagement=tables[i],
                    path_start=starts[i],
                    spindle_phase=None if phases[i] is None else from_shop(phases[i], "x_deg"),
                    **stated,
                )
                notices += recording.notices
                cuts.append(sample_cut(recording) if following else condition_cut(recording, lowpass=lowpass_hz))
                notices += cuts[-1].notices
            found = identify_coefficients(
                cuts,
                method=method,
                **options,
                sensor=read_result(sensor, Frf) if sensor else None,
                rng=np.random.default_rng(seed),
                progress=lambda share, label: progress(read_share + (1 - read_share) * share, label),
            )
    keep_and_reply(
        "identify",
        found,
        output,
        read=read,
        notices=[*notices, *found.notices],
        seed=seed,
        more=_drawn(found, table, figure),
        as_json=as_json,
        quiet=quiet,
    )


def _method(method: str | None, trend: bool, causal: bool) -> str:
    """What --method, --trend and --causal mean together."""
    if method is not None:
        check_choice("--method", method, METHODS)
    by_flags = "imm" if causal else "smooth" if trend else None
    if method is None:
        return by_flags or "nls"
    if trend and method not in FOLLOWING:
        raise typer.BadParameter(f"--trend follows coefficients that change, and --method {method} does not; keep one")
    if causal and method not in FOLLOWING[1:]:
        raise typer.BadParameter(
            f"--causal goes in the order of time, and --method {method} does not; keep one, or choose imm"
        )
    return method


def _from_accelerations(
    recordings: list[Path],
    setup: Path | None,
    frf: Path,
    modes: Path | None,
    method: str,
    progress: Progress,
    heard: dict[str, Any],
) -> tuple[Any, list[Any]]:
    """Coefficients by way of the forces that the accelerations tell, and what is to be told.   heard : as of `hear_cuts`"""
    from millcal.stages.coefficients.from_forces import coefficients_of_forces
    from millcal.stages.forces import reconstruct_forces

    dynamics, fitted, notices = read_dynamics(frf, modes)
    cuts, told = hear_cuts(recordings, setup, progress=lambda share, label: progress(0.6 * share, label), **heard)
    found = reconstruct_forces(
        cuts,
        dynamics,
        method=method,
        harmonics=heard["harmonics"],
        modes=fitted,
        progress=lambda share, label: progress(0.6 + 0.4 * share, label),
    )
    return coefficients_of_forces(found), [*notices, *told, *found.notices]


def _drawn(found: Any, table: Path | None, figure: Path | None) -> dict[str, tuple[Path, bytes]]:
    """What is written of a history besides its record."""
    from millcal.io.history_table import history_table

    files = {} if table is None else {"csv": (table, history_table(found).encode())}
    if figure is not None:
        from millcal.report.paper.history import history_file

        files["figure"] = (figure, history_file(found, figure.suffix[1:].lower()))
    return files
