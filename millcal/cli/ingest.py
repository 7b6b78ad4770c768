"""Any file to a recording of millcal: `millcal ingest`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, check_files, pairs, progress_bar, reply


def ingest(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Files of any known format; several become one segment each.")
    ],
    out: Annotated[Path, typer.Option("-o", "--output", help="Recording (HDF5) to write.")],
    setup: Annotated[
        Path | None,
        typer.Option("--setup", help="Setup (TOML): map, units, cutter, conditions, and what else is not said."),
    ] = None,
    map: Annotated[
        list[str] | None,
        typer.Option(
            "--map", metavar="CHANNEL=COLUMN", help="Axis map with sign: fx=+Fy; with the place: ax@tipX=-Acc1."
        ),
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(
            "--unit", metavar="COLUMN=UNIT", help="Unit or sensitivity of a column: Fx=kN, 'Ax=100 mV/g', t=ms."
        ),
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", min=0, help="Sample rate where a file has none, or a wrong one.")
    ] = None,
    acts_on: Annotated[
        Literal["tool", "workpiece"] | None,
        typer.Option("--acts-on", help="What the force channels act on; a reaction on the workpiece is turned."),
    ] = None,
    kind: Annotated[
        Literal["cut", "impact", "air"] | None,
        typer.Option("--kind", help="What was recorded; default: a cut, or for several files an impact test."),
    ] = None,
    air: Annotated[
        list[str] | None,
        typer.Option("--air", metavar="FROM:TO", help="Seconds without cutting; offset and drift there are removed."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Bring any file into the recording format, with units, axes and signs stated.

    Nothing is taken off the samples unless --air says where the tool cuts nothing: conditioning does that later.

    Example: millcal ingest cut.csv -o cut.h5 --map fx=+Fy --map fy=+Fx --map fz=+Fz
    """
    check_files([*files, setup], [out], once=False)
    from dataclasses import replace

    import numpy as np

    from millcal.io.air_cut import without_offset
    from millcal.io.inspection import inspect_recording
    from millcal.io.provenance import sha256_of
    from millcal.io.recipes import read_setup
    from millcal.io.recordings import join_recordings, mapping_of, read_recording, write_recording

    stated = {
        "setup": read_setup(setup) if setup else None,
        "map": pairs(map, "--map"),
        "units": pairs(unit, "--unit"),
        "acts_on": acts_on,
    }
    spans = [_span(text) for text in air or ()]
    with progress_bar(quiet) as progress:
        recordings = []
        for number, path in enumerate(files):

            def share_of_all(share: float, label: str, number: int = number, path: Path = path) -> None:
                progress(0.6 * (number + share) / len(files), path.name)

            recordings.append(read_recording(path, **stated, rate_hz=rate_hz, progress=share_of_all))
        recording = recordings[0] if len(recordings) == 1 else join_recordings(recordings)
        offset = drift = np.zeros(len(recording.channels))
        if spans:
            recording, offset, drift = without_offset(recording, spans)
        if kind or len(files) > 1:
            recording = replace(recording, kind=kind or "impact")
        progress(0.7, "writing")
        write_recording(out, recording)
        progress(0.9, "checking")
        result, _ = inspect_recording(out)
    names = [channel.name for channel in recording.channels]
    mapping = mapping_of(files[0], **stated)
    result |= {
        "mapping": mapping,
        "removed_offset": dict(zip(names, offset.tolist(), strict=True)),
        "removed_drift_per_s": dict(zip(names, drift.tolist(), strict=True)),
        "output": str(out),
    }
    inputs = [*files, *([setup] if setup else [])]
    lines = [f"{out}: {recording.kind}, {result['samples']} samples at {recording.sample_rate:.10g} Hz"]
    for row, channel in enumerate(recording.channels):
        taken = f"offset {offset[row]:.4g}, drift {drift[row]:.4g} per s removed" if spans else "nothing removed"
        lines.append(f"  {channel.name} = {mapping[channel.name]} in {channel.unit}, {channel.dof}; {taken}")
    reply(
        "ingest",
        "\n".join(lines),
        result,
        inputs={str(path): sha256_of(path) for path in inputs} if as_json else {},
        notices=recording.notices,
        as_json=as_json,
        quiet=quiet,
    )


def _span(text: str) -> tuple[float, float]:
    """`0:0.5` as two numbers."""
    begin, _, end = text.partition(":")
    try:
        span = float(begin), float(end)
    except ValueError:
        span = (1.0, 0.0)
    if not 0 <= span[0] < span[1]:
        raise typer.BadParameter(f"{text!r} is not FROM:TO in seconds", param_hint="--air")
    return span
