"""Limit depth against spindle speed: `millcal stability`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, Quiet, Seed, check_choice, check_files, keep_and_reply, progress_bar
from millcal.cli.stability_input import (
    METHODS,
    above_zero,
    finite,
    friction_ignored,
    geometry,
    one_of,
    read_cutting,
    read_dynamics,
    together,
    why_not,
    width_of_cut,
)  # fmt: skip

FIGURES = (".png", ".svg", ".pdf")
MANY, FEW = 400, 60  # speeds of a map, at least; those of cuts in time take long
MOST = 20_000  # speeds that are worth their time
FRICTION = 0.3  # of the flank


def stability(
    output: Annotated[Path, typer.Option("-o", "--output", help="Result file, HDF5.")],
    coefficients: Annotated[Path | None, typer.Option("--coefficients", help="Result of `millcal identify`.")] = None,
    ktc: Annotated[float | None, typer.Option("--ktc", help="Ktc in N/mm2, instead of --coefficients.")] = None,
    krc: Annotated[float | None, typer.Option("--krc", help="Krc in N/mm2, instead of --coefficients.")] = None,
    kte: Annotated[
        float | None, typer.Option("--kte", help="Kte in N/mm, for torque and power; default: the coefficients'.")
    ] = None,
    kre: Annotated[float | None, typer.Option("--kre", help="Kre in N/mm, with --kte.")] = None,
    frf: Annotated[
        Path | None, typer.Option("--frf", help="FRF at the tool tip: of `millcal frf`, UFF, CutPro, CSV.")
    ] = None,
    modes: Annotated[Path | None, typer.Option("--modes", help="Modes at the tool tip, a result file.")] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="SETUP.toml with [cutter], [conditions], and [structure] if no FRF.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            help="zoa: zero-order approximation. Right in interrupted cuts, too: floquet, of modes; frf, of an FRF as measured; "
            "time-domain, of modes, with teeth that leave the cut. Default: floquet of modes where it differs "
            "from zoa, else zoa, which warns where frf differs.",
        ),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Print every method that applies side by side; takes --frf and --modes.")
    ] = False,
    rpm: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--rpm", metavar="LO HI", help="Spindle speeds of the map; default: a quarter to twice the cuts'."
        ),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            min=2,
            max=MOST,
            help="Speeds of the map; default: at a round step, 400 or more (time-domain: 60).",
        ),
    ] = None,
    deepest_mm: Annotated[
        float | None,
        typer.Option(
            "--deepest-mm", help="How deep to look; default: by the map itself, zoa: as deep as there are limits."
        ),
    ] = None,
    teeth: Annotated[int | None, typer.Option("--teeth", min=1, help="Default: the cutter's.")] = None,
    diameter_mm: Annotated[float | None, typer.Option("--diameter-mm", help="Default: the cutter's.")] = None,
    helix_deg: Annotated[
        float | None, typer.Option("--helix-deg", min=-89, max=89, help="Default: the cutter's, else 0.")
    ] = None,
    pitch_deg: Annotated[
        str | None, typer.Option("--pitch-deg", metavar="A,B,...", help="Angle from each tooth to the next.")
    ] = None,
    radial_depth_mm: Annotated[float | None, typer.Option("--radial-depth-mm", help="Default: the cuts'.")] = None,
    direction: Annotated[str | None, typer.Option("--direction", help="up, down or slot; default: the cuts'.")] = None,
    feed_per_tooth_mm: Annotated[
        float | None, typer.Option("--feed-per-tooth-mm", help="Default: the highest of the cuts.")
    ] = None,
    damping: Annotated[
        float,
        typer.Option(
            "--process-damping", metavar="N_PER_MM", min=0, help="Indentation constant of process damping, N/mm."
        ),
    ] = 0.0,
    friction: Annotated[
        float | None, typer.Option("--friction", min=0, help="Of the flank, with --process-damping; default: 0.3.")
    ] = None,
    operating: Annotated[
        tuple[float, float] | None,
        typer.Option("--operating", metavar="RPM AP_MM", help="A cut to judge; default: the cuts', where they agree."),
    ] = None,
    rigid: Annotated[str, typer.Option("--rigid", help="x or y: nothing is known along it but that it is rigid.")] = "",
    members: Annotated[
        int, typer.Option("--members", "--samples", min=0, help="Draws for band and probabilities; 0: none.")
    ] = 2000,
    probability: Annotated[
        bool, typer.Option("--probability", help="Map of the probability that a cut is stable, by speed and depth.")
    ] = False,
    tests: Annotated[
        Path | None,
        typer.Option("--tests", help="Cuts log (CSV) of cuts judged stable or not, to hold against the map."),
    ] = None,
    simulate: Annotated[
        tuple[int, int] | None,
        typer.Option("--simulate-points", metavar="SPEEDS DEPTHS", help="Cuts in the time domain on such a grid."),
    ] = None,
    table: Annotated[Path | None, typer.Option("--csv", help="Table of the lobes to write.")] = None,
    figure: Annotated[Path | None, typer.Option("--figure", help="Figure to write, .png, .svg or .pdf.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: Seed = 0,
) -> None:
    """Limit depth against spindle speed from coefficients and an FRF or modes, with the best stable speeds.

    Example: millcal stability --coefficients coefficients.h5 --frf frf.h5 --rpm 4000 16000 -o map.h5

    Example: millcal stability --coefficients coefficients.h5 --modes modes.h5 --method floquet --probability -o map.h5
    """
    one_of({"--coefficients": coefficients, "--ktc with --krc": ktc})
    together({"--ktc": ktc, "--krc": krc})
    together({"--kte": kte, "--kre": kre})
    if not (compare and frf is not None and modes is not None):
        said = setup if frf is None and modes is None else None
        one_of({"--frf": frf, "--modes": modes, "--setup with [structure]": said})
    check_choice("--method", method, (None, *METHODS))
    check_choice("--direction", direction, (None, "up", "down", "slot"))
    check_choice("--rigid", rigid, ("", "x", "y"))
    above_zero(
        {
            "--deepest-mm": deepest_mm,
            "--diameter-mm": diameter_mm,
            "--radial-depth-mm": radial_depth_mm,
            "--feed-per-tooth-mm": feed_per_tooth_mm,
        }
    )
    for name, pair in {"--operating": operating, "--rpm": rpm}.items():
        for value in pair or ():
            (above_zero if pair is operating else finite)({name: value})
    finite({"--ktc": ktc, "--krc": krc, "--kte": kte, "--kre": kre, "--helix-deg": helix_deg})
    finite({"--process-damping": damping, "--friction": friction})
    if simulate is not None and min(simulate) < 1:
        raise typer.BadParameter("give at least one speed and one depth", param_hint="--simulate-points")
    if simulate is not None and frf is not None and modes is None:
        raise typer.BadParameter("the time domain needs modes; give --modes", param_hint="--simulate-points")
    if probability and members < 2:
        raise typer.BadParameter("needs draws; leave --members out", param_hint="--probability")
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise typer.BadParameter(
            f"{figure} does not say its format; end it with {', '.join(FIGURES)}", param_hint="--figure"
        )
    read = [coefficients, frf, modes, setup, tests]
    drawn = [] if figure is None else [figure, *([_beside(figure)] if simulate else [])]
    check_files(read, [output, table, *drawn])
    import numpy as np

    from millcal.units import from_shop

    cutter, cuts, posterior, notices = read_cutting(coefficients, ktc, krc, setup)
    cutting = geometry(cutter, teeth, diameter_mm, helix_deg, pitch_deg)
    of_method = {"helix": cutting["helix"], "pitch": cutting["pitch"], "damping": damping}
    reason = method and why_not(method, frf=frf is not None, modes=frf is None or modes is not None, **of_method)
    if reason:
        raise typer.BadParameter(reason, param_hint="--method")
    lines, fitted = read_dynamics(frf, modes, setup)
    if friction is not None and not damping:
        notices.append(friction_ignored())
    if frf is not None and frf.suffix.lower() not in (".h5", ".hdf5"):  # what millcal itself found was told when it did
        notices += lines.notices

    def known(option: float | str | None, key: str, field: str) -> Any:
        """A condition: as the option says, else as all cuts have it."""
        if option is not None:
            return from_shop(option, key)
        values = {getattr(cut, field) for cut in cuts}
        if len(values) != 1:
            why = "the cuts differ in it" if values else "no cut says it"
            raise typer.BadParameter(f"--{key.replace('_', '-')} is needed, because {why}")
        return values.pop()

    slot = direction == "slot"
    speeds = {cut.spindle_speed for cut in cuts}
    if rpm is None and len(speeds) != 1:
        raise typer.BadParameter("--rpm is needed: the lowest and the highest spindle speed of the map")
    low, high = (s / 4 * 60 / (2 * np.pi) for s in (min(speeds), 8 * min(speeds))) if rpm is None else rpm
    if not 0 < low < high:
        raise typer.BadParameter(f"--rpm {low:g} {high:g} is no range; give the lowest speed, then the highest")
    point = None if operating is None else (from_shop(operating[0], "x_rpm"), from_shop(operating[1], "x_mm"))
    if point is None and len(at := {(cut.spindle_speed, cut.axial_depth) for cut in cuts}) == 1:
        point = at.pop()
    feed = max((cut.feed_per_tooth for cut in cuts), default=None)
    toward = known(direction, "direction", "direction")
    if radial_depth_mm is not None or not slot:
        width_of_cut(known(radial_depth_mm, "radial_depth_mm", "radial_depth"), toward, cutting["diameter"])
    asked = {
        **cutting,
        "radial_depth": cutting["diameter"] if slot else known(radial_depth_mm, "radial_depth_mm", "radial_depth"),
        "direction": toward,
        "feed_per_tooth": feed if feed_per_tooth_mm is None else from_shop(feed_per_tooth_mm, "feed_per_tooth_mm"),
        "spindle_speed": (from_shop(low, "x_rpm"), from_shop(high, "x_rpm")),
        "points": points or _round_points(low, high, FEW if method == "time-domain" else MANY),
        "deepest": None if deepest_mm is None else from_shop(deepest_mm, "deepest_mm"),
        "indentation": from_shop(damping, "x_N_per_mm"),
        "indentation_friction": FRICTION if friction is None else friction,
        "edge": None if kte is None else (from_shop(kte, "Kte_N_per_mm"), from_shop(kre, "Kre_N_per_mm")),
        "rigid": rigid,
    }
    made = None
    if tests is not None:
        from millcal.io.cuts_log import cuts_on_map, read_cuts_log

        where = {key: asked[key] for key in ("radial_depth", "direction", "diameter")}
        made, told = cuts_on_map(read_cuts_log(tests), tests, **where)
        notices += told
    with progress_bar(quiet) as progress:
        from millcal.stages.stability import map_stability

        share = 0.5 if compare else 1.0
        found = map_stability(
            fitted if lines is None else lines,
            posterior,
            **asked,
            method=method,
            modes=fitted,
            members=members,
            probability=probability,
            operating_point=point,
            tests=made,
            simulate=simulate,
            rng=np.random.default_rng(seed),
            progress=lambda done, label: progress(share * done, label),
        )
        others: list = []
        if compare:
            from millcal.cli.stability_compare import other_maps

            others, left_out = other_maps(
                found, lines, fitted, posterior, asked, of_method, lambda done, label: progress(0.5 + 0.5 * done, label)
            )
            notices += left_out
    keep_and_reply(
        "stability",
        found,
        output,
        read=read,
        notices=[*notices, *found.notices],
        seed=seed,
        more=_drawn(found, others, table, figure),
        **_compared(found, others),
        as_json=as_json,
        quiet=quiet,
    )


def _compared(found: Any, others: list) -> dict[str, Any]:
    """What is told beside the map where methods stand side by side."""
    if not others:
        return {}
    from millcal.io.readable import text_of
    from millcal.io.stability_readable import compared_text
    from millcal.io.stability_summary import compared

    maps = [found, *others]
    coarsest = min((one.spindle_speed for one in maps), key=len)
    return {"told": {"compared": compared(maps, coarsest)}, "text": f"{text_of(found)}\n\n{compared_text(maps)}"}


def _drawn(found: Any, others: list, table: Path | None, figure: Path | None) -> dict[str, tuple[Path, bytes]]:
    """What is written of the map besides its record."""
    from millcal.io.stability_table import stability_table

    files = {} if table is None else {"csv": (table, stability_table(found).encode())}
    if figure is not None:
        from millcal.report.paper.stability import bifurcation_file, stability_file

        files["figure"] = (figure, stability_file(found, figure.suffix[1:].lower(), others=others))
        if (line := bifurcation_file(found, figure.suffix[1:].lower())) is not None:
            files["bifurcation"] = (_beside(figure), line)
    return files


def _beside(figure: Path) -> Path:
    """Where the figure of the simulated cuts of one speed goes."""
    return figure.with_stem(f"{figure.stem}-bifurcation")


def _round_points(low: float, high: float, least: int = MANY) -> int:
    """Speeds of a map with so many points or more, at a step of 1, 2 or 5 times a power of ten where the range allows."""
    steps = [mantissa * 10.0**power for power in range(4, -4, -1) for mantissa in (5, 2, 1)]
    step = next((step for step in steps if (high - low) / step >= least - 1), steps[-1])
    return min(round((high - low) / step) + 1, MOST)
