"""What is in a file: `millcal inspect`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, NoSeed, Quiet, progress_bar, reply


def inspect(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recordings or FRFs of any known format.")],
    setup: Annotated[
        Path | None, typer.Option("--setup", help="Setup (TOML) with what the files do not say about themselves.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Say what is in a file of any known format, and what must be stated before it can be read.

    Units need not be known: values are shown as they stand in the file.

    Example: millcal inspect cut1.csv cut2.h5
    """
    from millcal.io.inspection import inspect_recording
    from millcal.io.provenance import sha256_of
    from millcal.io.recipes import read_setup

    stated = read_setup(setup) if setup else None
    results, notices = [], []
    with progress_bar(quiet) as progress:
        for number, path in enumerate(files):

            def share_of_all(share: float, label: str, number: int = number, path: Path = path) -> None:
                progress((number + share) / len(files), path.name)

            result, said = inspect_recording(path, setup=stated, progress=share_of_all)
            results.append(result)
            notices += said
    reply(
        "inspect",
        "\n\n".join(_table(result) for result in results),
        results[0] if len(results) == 1 else {"files": results},
        inputs={str(path): sha256_of(path) for path in files} if as_json else {},
        notices=notices,
        as_json=as_json,
        quiet=quiet,
    )


def _table(result: dict[str, Any]) -> str:
    """One file as a short table."""
    rate, duration = result["sample_rate_hz"], result["duration_s"]
    clock = f"{rate:.10g} Hz, {duration:.6g} s" if rate else "sample rate unknown"
    lines = [f"{result['file']}: {result['format']}, {result['samples']} samples, {clock}"]
    if "frf" in result:
        low, high, count = result["frf"]["frequency_hz"]
        lines = [
            f"{result['file']}: {result['format']}, FRF ({result['frf']['form'] or 'form not said'}), "
            f"{count} lines from {low:.6g} to {high:.6g} Hz"
        ]
    if result["channels"]:
        what = "pair" if "frf" in result else "channel"
        lines.append(f"  {what:<14} {'quantity':<13} {'unit':<7} {'min':>12} {'max':>12} {'mean':>12} {'rms':>12}")
    for channel in result["channels"]:
        words = [channel["name"] or "", channel["quantity"] or "?", channel["unit"] or "?"]
        numbers = [channel[key] for key in ("min", "max", "mean", "rms")]
        shown = " ".join(f"{'-' if value is None else format(value, '.6g'):>12}" for value in numbers)
        lines.append(f"  {words[0]:<14} {words[1]:<13} {words[2]:<7} {shown}")
    for dataset in result["details"].get("datasets", ()):
        shape = " x ".join(map(str, dataset["shape"])) or "one value"
        said = ", ".join(f"{key} = {value}" for key, value in dataset["attributes"].items())
        lines.append(f"  {dataset['path']}: {shape}, {dataset['type']}{f' ({said})' if said else ''}")
    lines += [f"  missing: {what}" for what in result["missing"]]
    return "\n".join(lines)
