"""Impact tests to an FRF matrix: `millcal frf`."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from millcal.cli.speak import Json, Quiet, Seed, check_files, keep_and_reply, pairs, progress_bar


def frf(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC", help="Impact tests; several add inputs or hits.")],
    out: Annotated[Path, typer.Option("-o", "--output", help="FRF file to write.")],
    estimator: Annotated[
        Literal["h1", "h2", "hv"], typer.Option("--estimator", help="Noise in the response, in the force, in both.")
    ] = "h1",
    form: Annotated[
        Literal["accelerance", "mobility", "receptance", "transmissibility"] | None,
        typer.Option("--form", help="Form of the FRF; default: as measured. transmissibility: of a dynamometer."),
    ] = None,
    response: Annotated[
        list[str] | None,
        typer.Option("--response", metavar="NAME", help="Force channel that answers the hammer: a dynamometer's."),
    ] = None,
    keep: Annotated[
        list[str] | None, typer.Option("--keep", metavar="HIT", help="Use this hit whatever is found: 3, or tap_x:3.")
    ] = None,
    drop: Annotated[
        list[str] | None, typer.Option("--drop", metavar="HIT", help="Leave this hit out: 3, or tap_x:3.")
    ] = None,
    allow_double: Annotated[
        bool, typer.Option("--allow-double", help="Use double hits too, with all their pulses in the force window.")
    ] = False,
    weak: Annotated[
        float, typer.Option("--weak", min=0, max=1, help="Leave hits below this share of the median peak out.")
    ] = 0.15,
    hold_off_s: Annotated[
        float,
        typer.Option("--hold-off-s", min=0, help="Pulses of a continuous recording closer than this are one hit."),
    ] = 0.1,
    record_length_s: Annotated[
        float | None, typer.Option("--record-length-s", min=0, help="Length of each hit; default: by its decay.")
    ] = None,
    resolution_hz: Annotated[
        float | None, typer.Option("--resolution-hz", min=0, help="Lines at most this far apart, by added zeros.")
    ] = None,
    exponential: Annotated[
        float | None,
        typer.Option(
            "--exponential", metavar="END", help="Exponential window with this value at the record's end: 0.05."
        ),
    ] = None,
    delay: Annotated[
        list[str] | None,
        typer.Option("--delay", metavar="NAME=S", help="Channel or dof whose signal is late, and by how many s."),
    ] = None,
    flip: Annotated[
        list[str] | None, typer.Option("--flip", metavar="NAME", help="Channel or dof to turn; a dof is a response's.")
    ] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="Setup (TOML) that says what the columns of the files are.")
    ] = None,
    map: Annotated[
        list[str] | None, typer.Option("--map", metavar="CHANNEL=COLUMN", help="Axis map with sign: fx=+Fy.")
    ] = None,
    unit: Annotated[
        list[str] | None, typer.Option("--unit", metavar="COLUMN=UNIT", help="Unit of a column: F=N.")
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", min=0, help="Sample rate where a file has none.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: Seed = 0,
) -> None:
    """Impact tests to an FRF matrix with coherence and a table of the hits, each rejected one with its reasons.

    Example: millcal frf tap_x.h5 tap_y.h5 -o frf.h5
    """
    check_files([*recordings, setup], [out])
    from millcal.io.recipes import read_setup
    from millcal.io.recordings import read_recording
    from millcal.stages.frf import estimate_frf

    stated = {
        "setup": read_setup(setup) if setup else None,
        "map": pairs(map, "--map"),
        "units": pairs(unit, "--unit"),
        "rate_hz": rate_hz,
    }
    with progress_bar(quiet) as progress:
        taps = [
            read_recording(path, **stated, progress=lambda share, label: progress(0.5 * share, label))
            for path in recordings
        ]
        found = estimate_frf(
            [_with_responses(tap, response or ()) for tap in taps],
            estimator=estimator,
            form=form,
            keep=keep or (),
            drop=drop or (),
            allow_double=allow_double,
            weak=weak,
            hold_off=hold_off_s,
            record_length=record_length_s,
            resolution=resolution_hz,
            exponential=exponential,
            delays=_seconds(pairs(delay, "--delay")),
            flip=flip or (),
            progress=lambda share, label: progress(0.5 + 0.5 * share, label),
        )
    keep_and_reply(
        "frf",
        found,
        out,
        read=[*recordings, setup],
        notices=found.notices,
        seed=seed,
        as_json=as_json,
        quiet=quiet,
    )


def _seconds(stated: dict[str, str]) -> dict[str, float]:
    """Delays as numbers."""
    found = {}
    for name, text in stated.items():
        try:
            found[name] = float(text)
        except ValueError:
            raise typer.BadParameter(
                f"{name}={text!r} is no number of seconds; write {name}=12e-6", param_hint="--delay"
            ) from None
    return found


def _with_responses(recording: Any, names: Iterable[str]) -> Any:
    """The recording with some force channels marked as responses."""
    known = [channel.name for channel in recording.channels if channel.quantity == "force"]
    for name in names:
        if name not in known:
            raise typer.BadParameter(
                f"{recording.name} has no force channel {name!r}; there are {', '.join(known)}", param_hint="--response"
            )
    channels = (replace(c, role="response") if c.name in names else c for c in recording.channels)
    return replace(recording, channels=tuple(channels))
