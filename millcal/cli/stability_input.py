"""What `millcal stability` is given: coefficients, cutter, conditions, dynamics, and which methods these allow."""

from math import isfinite
from pathlib import Path
from typing import Any

import typer

# those of the stage, which --help must not import; a test keeps them equal
METHODS = ("zoa", "floquet", "frf", "time-domain")
OF_MODES = ("floquet", "time-domain")
DAMPED = ("floquet", "time-domain")  # methods that know of process damping
WHOLE = 1e-9  # share by which a radial depth may exceed the diameter in the last digit,
SLOT = 1e-3  # and by which that of a slot may fall short of it


def one_of(options: dict[str, Any]) -> None:
    """Refuse none and several of what excludes each other."""
    given = [name for name, value in options.items() if value is not None]
    if len(given) != 1:
        names = " or ".join(options)
        raise typer.BadParameter(f"{' and '.join(given)} exclude each other" if given else f"give {names}")


def together(options: dict[str, Any]) -> None:
    """Refuse half of a pair."""
    if len({value is None for value in options.values()}) > 1:
        raise typer.BadParameter(f"{' and '.join(options)} go together")


def finite(options: dict[str, float | None]) -> None:
    """Refuse inf and nan, which float reads like any number."""
    for option, value in options.items():
        if value is not None and not isfinite(value):
            raise typer.BadParameter(f"{value:g} is no number", param_hint=option)


def above_zero(options: dict[str, float | None]) -> None:
    """Refuse what is no size."""
    finite(options)
    for option, value in options.items():
        if value is not None and not value > 0:
            raise typer.BadParameter(f"{value:g} is not above 0", param_hint=option)


def friction_ignored() -> Any:
    """What is said of a flank that rubs nowhere."""
    from millcal.data import Notice

    what = "counts with process damping alone, and there is none: it is left out; give --process-damping, too"
    return Notice("friction-ignored", what, "--friction")


def width_of_cut(radial_depth: float, direction: str, diameter: float) -> None:
    """Refuse a width that this cutter does not cut.   radial_depth, diameter : m"""
    from millcal.units import to_shop

    wide, whole = to_shop(radial_depth, "_mm"), to_shop(diameter, "_mm")
    if wide > whole * (1 + WHOLE):
        what = f"{wide:g} is more than the diameter, {whole:g}; correct one"
        raise typer.BadParameter(what, param_hint="--radial-depth-mm")
    if direction == "slot" and wide < whole * (1 - SLOT):
        what = f"{wide:g} is no slot of a cutter of {whole:g} mm; leave it out, or give --direction up or down"
        raise typer.BadParameter(what, param_hint="--radial-depth-mm")


def read_cutting(coefficients: Path | None, ktc: float | None, krc: float | None, setup: Path | None) -> tuple:
    """Cutter, conditions of the cuts, coefficients and notices; the setup goes before the file of coefficients."""
    from millcal.data import CoefficientHistory, Coefficients, Notice
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
        said = _read_setup(setup)
        cutter, cuts = said.cutter or cutter, cuts if said.conditions is None else (said.conditions,)
    return cutter, cuts, posterior, notices


def read_dynamics(frf: Path | None, modes: Path | None, setup: Path | None) -> tuple[Any, Any]:
    """The FRF and the modes, None for what was not given."""
    from millcal.data import Modes
    from millcal.errors import RecipeError
    from millcal.io.frf_files import read_frf
    from millcal.io.results import read_result

    lines = None if frf is None else read_frf(frf)
    if modes is not None:
        return lines, read_result(modes, Modes)
    if lines is not None:
        return lines, None
    found = _read_setup(setup).modes
    if found is None:
        raise RecipeError(f"{setup}: no dynamics; add [[structure.modes]], or give --frf or --modes")
    return None, found


def _read_setup(path: Path) -> Any:
    """A setup; of conditions that are not whole a map needs less than a cut does, and options say it."""
    from millcal.errors import RecipeError
    from millcal.io.recipes import read_setup

    try:
        return read_setup(path)
    except RecipeError as problem:
        if ": conditions." not in str(problem) or "is missing" not in str(problem):
            raise
        way_out = "or leave [conditions] out and say --radial-depth-mm, --direction, --feed-per-tooth-mm and --rpm"
        raise RecipeError(f"{problem}; {way_out}") from None


def geometry(cutter: Any, teeth: int | None, diameter_mm: float | None, helix_deg: float | None, pitch_deg: str | None):
    """The cutter as the stage takes it: what options say goes before what the cutter is."""
    from math import cos, sin

    from millcal.units import from_shop

    if cutter is None and (teeth is None or diameter_mm is None):
        raise typer.BadParameter("--teeth and --diameter-mm are needed, because no cutter is given")
    count = teeth or cutter.teeth
    pitch = None if cutter is None else cutter.pitch
    if pitch_deg is not None:
        pitch = _pitch(pitch_deg, count)
    elif pitch is not None and len(pitch) != count:
        raise typer.BadParameter(
            f"--teeth {count}: the cutter has {len(pitch)} teeth of unequal pitch; add --pitch-deg"
        )
    rho, angle = (0.0, 0.0) if cutter is None else (cutter.runout, cutter.runout_angle)
    return {
        "teeth": count,
        "diameter": cutter.diameter if diameter_mm is None else from_shop(diameter_mm, "diameter_mm"),
        "pitch": pitch,
        "helix": from_shop(helix_deg, "helix_deg")
        if helix_deg is not None
        else 0.0
        if cutter is None
        else cutter.helix,
        "runout": (rho * cos(angle), rho * sin(angle)),
    }


def _pitch(written: str, teeth: int) -> tuple[float, ...]:
    """`70,110,70,110` in rad."""
    from millcal.units import from_shop

    try:
        degrees = [float(part) for part in written.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{written!r} is no list such as 70,110,70,110", param_hint="--pitch-deg") from None
    if len(degrees) != teeth or not (min(degrees) > 0 and abs(sum(degrees) - 360) <= 0.01):  # nan is neither
        raise typer.BadParameter(
            f"{written} are not {teeth} angles above 0 that add up to 360; give one from each tooth to the next",
            param_hint="--pitch-deg",
        )
    return tuple(from_shop(angle * 360 / sum(degrees), "_deg") for angle in degrees)


def why_not(method: str, *, frf: bool, modes: bool, helix: float, pitch: Any, damping: float) -> str:
    """Why a method cannot be used on what is given, empty where it can."""
    if method in OF_MODES and not modes:
        return f"{method} needs modes; fit them with 'millcal modes FRF.h5 -o modes.h5' and give --modes"
    if damping and method not in DAMPED:
        return f"{method} knows no process damping; take floquet or time-domain, or leave --process-damping out"
    if method != "frf":
        return ""
    if not frf:
        return "frf needs a measured FRF; give --frf, or take floquet, which is exact for modes"
    if helix:
        return "frf knows straight teeth alone; --helix-deg 0 leaves the helix out, floquet with --modes has it"
    if pitch is not None and max(pitch) - min(pitch) > 1e-6:
        return "frf knows one pitch alone; take floquet with --modes"
    return ""
