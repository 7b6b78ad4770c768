"""Limit depth against spindle speed: `millcal stability`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, Quiet, Seed, check_choice, check_files, keep_and_reply, progress_bar

METHODS = ("zoa",)  # those of the stage, which --help must not import; a test keeps them equal


def stability(
    output: Annotated[Path, typer.Option("-o", "--output", help="Result file, HDF5.")],
    coefficients: Annotated[Path | None, typer.Option("--coefficients", help="Result of `millcal identify`.")] = None,
    ktc: Annotated[float | None, typer.Option("--ktc", help="Ktc in N/mm2, instead of --coefficients.")] = None,
    krc: Annotated[float | None, typer.Option("--krc", help="Krc in N/mm2, instead of --coefficients.")] = None,
    frf: Annotated[
        Path | None, typer.Option("--frf", help="FRF at the tool tip: of `millcal frf`, UFF, CutPro, CSV.")
    ] = None,
    modes: Annotated[Path | None, typer.Option("--modes", help="Modes at the tool tip, a result file.")] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="SETUP.toml with [cutter], [conditions], and [structure] if no FRF.")
    ] = None,
    method: Annotated[str, typer.Option("--method", help="zoa: zero-order approximation.")] = "zoa",
    rpm: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--rpm", metavar="LO HI", help="Spindle speeds of the map; default: a quarter to twice the cuts'."
        ),
    ] = None,
    points: Annotated[
        int | None, typer.Option("--points", min=2, help="Speeds of the map; default: at a round step, 400 or more.")
    ] = None,
    teeth: Annotated[int | None, typer.Option("--teeth", min=1, help="Default: the cutter's.")] = None,
    diameter_mm: Annotated[float | None, typer.Option("--diameter-mm", help="Default: the cutter's.")] = None,
    radial_depth_mm: Annotated[float | None, typer.Option("--radial-depth-mm", help="Default: the cuts'.")] = None,
    direction: Annotated[str | None, typer.Option("--direction", help="up, down or slot; default: the cuts'.")] = None,
    feed_per_tooth_mm: Annotated[
        float | None, typer.Option("--feed-per-tooth-mm", help="Default: the highest of the cuts.")
    ] = None,
    operating: Annotated[
        tuple[float, float] | None,
        typer.Option("--operating", metavar="RPM AP_MM", help="A cut to judge; default: the cuts', where they agree."),
    ] = None,
    rigid: Annotated[str, typer.Option("--rigid", help="x or y: nothing is known along it but that it is rigid.")] = "",
    members: Annotated[int, typer.Option("--members", min=0, help="Draws for the band; 0: no band.")] = 2000,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: Seed = 0,
) -> None:
    """Limit depth against spindle speed from coefficients and an FRF or modes, with the best stable speeds.

    Example: millcal stability --coefficients coefficients.h5 --frf frf.h5 --rpm 4000 16000 -o map.h5
    """
    _one_of({"--coefficients": coefficients, "--ktc with --krc": ktc})
    _one_of(
        {"--frf": frf, "--modes": modes, "--setup with [structure]": setup if frf is None and modes is None else None}
    )
    if (ktc is None) != (krc is None):
        raise typer.BadParameter("--ktc and --krc go together")
    check_choice("--method", method, METHODS)
    check_choice("--direction", direction, (None, "up", "down", "slot"))
    check_choice("--rigid", rigid, ("", "x", "y"))

    check_files([coefficients, frf, modes, setup], [output])
    import numpy as np

    from millcal.stages.stability import map_stability
    from millcal.units import from_shop

    cutter, cuts, posterior, notices = _cutting(coefficients, ktc, krc, setup)
    dynamics = _dynamics(frf, modes, setup)
    if frf is not None and frf.suffix.lower() not in (".h5", ".hdf5"):  # what millcal itself found was told when it did
        notices += dynamics.notices

    def known(option: float | str | None, key: str, field: str) -> Any:
        """A condition: as the option says, else as all cuts have it."""
        if option is not None:
            return from_shop(option, key)
        values = {getattr(cut, field) for cut in cuts}
        if len(values) != 1:
            why = "the cuts differ in it" if values else "no cut says it"
            raise typer.BadParameter(f"--{key.replace('_', '-')} is needed, because {why}")
        return values.pop()

    if cutter is None and (teeth is None or diameter_mm is None):
        raise typer.BadParameter("--teeth and --diameter-mm are needed, because no cutter is given")
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

    with progress_bar(quiet) as progress:
        found = map_stability(
            dynamics,
            posterior,
            teeth=teeth or cutter.teeth,
            diameter=cutter.diameter if diameter_mm is None else from_shop(diameter_mm, "diameter_mm"),
            pitch=None if cutter is None else cutter.pitch,
            radial_depth=None if slot else known(radial_depth_mm, "radial_depth_mm", "radial_depth"),
            direction=known(direction, "direction", "direction"),
            feed_per_tooth=feed if feed_per_tooth_mm is None else from_shop(feed_per_tooth_mm, "feed_per_tooth_mm"),
            spindle_speed=(from_shop(low, "x_rpm"), from_shop(high, "x_rpm")),
            points=points or _round_points(low, high),
            rigid=rigid,
            method=method,
            members=members,
            operating_point=point,
            rng=np.random.default_rng(seed),
            progress=progress,
        )
    keep_and_reply(
        "stability",
        found,
        output,
        read=[coefficients, frf, modes, setup],
        notices=[*notices, *found.notices],
        seed=seed,
        as_json=as_json,
        quiet=quiet,
    )


def _one_of(options: dict[str, Any]) -> None:
    given = [name for name, value in options.items() if value is not None]
    if len(given) != 1:
        names = " or ".join(options)
        raise typer.BadParameter(f"{' and '.join(given)} exclude each other" if given else f"give {names}")


def _cutting(coefficients: Path | None, ktc: float | None, krc: float | None, setup: Path | None) -> tuple:
    """Cutter, conditions of the cuts, coefficients and notices; the setup goes before the file of coefficients."""
    from millcal.data import CoefficientHistory, Coefficients, Notice
    from millcal.io.recipes import read_setup
    from millcal.io.results import read_result
    from millcal.units import from_shop

    cutter, cuts, notices = None, (), []
    if coefficients is None:
        posterior = (from_shop(ktc, "Ktc_N_per_mm2"), from_shop(krc, "Krc_N_per_mm2"))
    else:
        fit = read_result(coefficients, (Coefficients, CoefficientHistory))
        posterior, cutter, cuts = fit.posterior, fit.cutter, fit.conditions
        if fit.verdict != "fits":
            notices.append(Notice("coefficients-doubtful", f"the coefficients: {fit.verdict}", str(coefficients)))
    if setup is not None:
        said = read_setup(setup)
        cutter, cuts = said.cutter or cutter, cuts if said.conditions is None else (said.conditions,)
    return cutter, cuts, posterior, notices


def _dynamics(frf: Path | None, modes: Path | None, setup: Path | None) -> Any:
    """The FRF or the modes, from whichever file holds them."""
    from millcal.data import Modes
    from millcal.errors import RecipeError
    from millcal.io.frf_files import read_frf
    from millcal.io.recipes import read_setup
    from millcal.io.results import read_result

    if frf is not None:
        return read_frf(frf)
    if modes is not None:
        return read_result(modes, Modes)
    found = read_setup(setup).modes
    if found is None:
        raise RecipeError(f"{setup}: no dynamics; add [[structure.modes]], or give --frf or --modes")
    return found


def _round_points(low: float, high: float) -> int:
    """Speeds of a map with 400 points or more, at a step of 1, 2 or 5 times a power of ten where the range allows."""
    steps = [mantissa * 10.0**power for power in range(4, -4, -1) for mantissa in (5, 2, 1)]
    step = next((step for step in steps if (high - low) / step >= 399), steps[-1])
    return round((high - low) / step) + 1
