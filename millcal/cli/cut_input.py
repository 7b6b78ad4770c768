"""What the command line says of cuts besides their files: values for each recording, bounds of coefficients."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from millcal.cli.speak import pairs


def for_each(values: Sequence[Any] | None, number: int, option: str) -> list[Any]:
    """One value for each recording: as many as there are, one for all, or none."""
    if not values:
        return [None] * number
    if len(values) not in (1, number):
        raise typer.BadParameter(
            f"{len(values)} values for {number} recordings; give one for all or one for each", param_hint=option
        )
    return [*values] * (number // len(values))


def bounds_of(items: Sequence[str] | None) -> dict[str, tuple[float, float]] | None:
    """`kt=500:2500` and `mt=0.1:0.7` as a recipe writes them: {"kt_N_per_mm2": (500, 2500), "mt": (0.1, 0.7)}."""
    if not items:
        return None
    found = {}
    for name, written in pairs(items, "--bounds").items():
        low, colon, high = written.partition(":")
        try:
            pair = (float(low), float(high))
        except ValueError:
            colon = ""
        if not colon or not 0 <= pair[0] < pair[1]:
            raise typer.BadParameter(
                f"{name}={written} is no NAME=LOW:HIGH with 0 <= LOW < HIGH", param_hint="--bounds"
            )
        known = [f"{letter}{d}{end}" for d in "tra" for letter, end in (("k", ""), ("m", ""), ("K", "c"), ("K", "e"))]
        if name not in known:
            raise typer.BadParameter(
                f"{name!r} is no coefficient; there are: {', '.join(known)}", param_hint="--bounds"
            )
        unit = "" if name[0] == "m" else "_N_per_mm" if name[-1] == "e" else "_N_per_mm2"
        found[name + unit] = pair
    return found


def read_cut(
    path: Path,
    setup: Path | None,
    *,
    feed: float | None,
    engagement: Path | None,
    path_start: float | None,
    spindle_phase: float | None,
    **how: Any,
) -> Any:
    """A cut, with cutter and conditions, from its file, the setup and what the command line says besides."""
    from millcal.errors import RecipeError, RecordingError
    from millcal.io.engagement import read_engagement
    from millcal.io.recipes import Setup, read_setup
    from millcal.io.recordings import read_recording
    from millcal.units import from_shop

    stated = read_setup(setup, feed_per_tooth_mm=feed) if setup else Setup()
    own = {"path_start": path_start, "spindle_phase": spindle_phase}
    if engagement is not None:
        own["engagement"] = read_engagement(engagement)
    recording = read_recording(
        path, setup=replace(stated, **{key: value for key, value in own.items() if value is not None}), **how
    )
    if recording.kind != "cut":
        raise RecordingError(f"{path}: is an {recording.kind} recording and no cut; give recordings of cuts")
    if path_start is not None and recording.engagement is None:
        raise RecipeError(
            "--path-start-s: there is no path without an engagement table; give --engagement, or leave it out"
        )
    for missing, value in (("cutter", recording.cutter), ("conditions", recording.conditions)):
        if value is None:
            raise RecipeError(f"{path}: no {missing} known; give --setup SETUP.toml with a [{missing}] table")
    if feed is None:
        return recording
    return replace(recording, conditions=replace(recording.conditions, feed_per_tooth=from_shop(feed, "x_mm")))
