"""What every command says and how: options they share, the JSON envelope, notices and progress."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from millcal import __version__

Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no warnings on stderr.")]
Seed = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]
NoSeed = Annotated[int, typer.Option("--seed", help="Taken by every command; nothing is random in this one.")]

Progress = Callable[[float, str], None]  # share done in 0..1, what is being done


def reply(
    command: str,
    text: str,
    result: Mapping,
    *,
    inputs: Mapping[str, str],
    notices: Iterable,
    as_json: bool,
    quiet: bool,
) -> None:
    """Print a command's result: the text, or one JSON object; warnings go to stderr either way, notes only into the JSON.

    inputs : path -> sha256   notices : `millcal.data.Notice`
    """
    from millcal.io.summaries import summarise_notices, without_nan

    notices = list(dict.fromkeys(notices))
    if as_json:
        envelope = {
            "schema_version": 1,
            "millcal": __version__,
            "command": command,
            "inputs": dict(inputs),
            **summarise_notices(notices),
            "result": result,
        }
        typer.echo(json.dumps(without_nan(envelope), indent=1, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo(text)
    if not quiet:
        for line in _grouped(notice for notice in notices if notice.level == "warning"):
            typer.echo(f"warning: {line}", err=True)


def keep_and_reply(
    command: str,
    record: Any,
    output: Path,
    *,
    read: Iterable[Path | None],
    notices: Iterable,
    seed: int = 0,
    more: Mapping[str, tuple[Path, bytes]] | None = None,
    text: str | None = None,
    told: Mapping[str, Any] | None = None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write the record a stage has found to its result file, and print it.

    read : the files it was made of   notices : all of the command, those of the record among them
    more : files to write beside it, what it is -> (where, what it holds)   text : in place of the record's own
    told : what the JSON says beside the record
    """
    from millcal.io.provenance import provenance
    from millcal.io.readable import text_of
    from millcal.io.results import replaced_atomically, write_result
    from millcal.io.summaries import summarise

    origin = provenance([path for path in read if path is not None], seed=seed)
    write_result(output, record, provenance=origin)
    more = more or {}
    for path, content in more.values():
        with replaced_atomically(path) as temporary:
            temporary.write_bytes(content)
    written = {what: str(path) for what, (path, _) in more.items()}
    reply(
        command,
        "\n".join([text_of(record) if text is None else text, *(f"{what}: {path}" for what, path in written.items())]),
        {**summarise(record), **(told or {}), "output": str(output), **written},
        inputs=origin["inputs"],
        notices=notices,
        as_json=as_json,
        quiet=quiet,
    )


def _grouped(notices: Iterable) -> list[str]:
    """One line for a notice that several places share."""
    places: dict[tuple[str, str], list[str]] = {}
    for notice in notices:
        places.setdefault((notice.code, notice.message), []).append(notice.where)
    lines = []
    for (code, message), where in places.items():
        named = [place for place in where if place]
        place = named[0] if named else ""
        more = f" (and {len(named) - 1} more)" if len(named) > 1 else ""
        lines.append(f"{place}{more}{': ' if place else ''}{message} [{code}]")
    return lines


def check_choice(option: str, value: str | None, choices: Sequence[str | None]) -> None:
    """Refuse a value that is none of the choices, and name them."""
    if value not in choices:
        known = ", ".join(filter(None, choices))
        raise typer.BadParameter(f"{value!r} is not known; there are: {known}", param_hint=option)


def check_files(read: Iterable[Path | None], written: Iterable[Path | None], *, once: bool = True) -> None:
    """Refuse to write over what is read, also by another name of it, and to write or (`once`) read one file twice."""
    inputs = [path for path in read if path is not None]
    outputs = [path for path in written if path is not None]
    for number, path in enumerate(inputs):
        if once and any(_same(path, other) for other in inputs[:number]):
            raise typer.BadParameter(f"{path} is read twice; name each file once")
    for number, path in enumerate(outputs):
        if any(_same(path, other) for other in [*inputs, *outputs[:number]]):
            raise typer.BadParameter(f"{path} would be written over; name another file for the result", param_hint="-o")


def _same(one: Path, other: Path) -> bool:
    return one.resolve() == other.resolve() or (one.exists() and other.exists() and one.samefile(other))


def pairs(items: Iterable[str] | None, option: str) -> dict[str, str]:
    """Options such as `--map fx=+Fy --map fy=+Fx` as a dict."""
    found = {}
    for item in items or ():
        name, equals, value = item.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise typer.BadParameter(f"{item!r} is not NAME=VALUE", param_hint=option)
        found[name.strip()] = value.strip()
    return found


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress]:
    """A bar on stderr for work of more than two seconds; silent when quiet or when stderr is no terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda share, label: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, label: bar.update(task, completed=share, description=label)
