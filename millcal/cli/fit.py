"""The main job on the command line: `millcal fit`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, Quiet, progress_bar, reply


def fit(
    recipe: Annotated[
        Path, typer.Argument(metavar="RECIPE", help="Recipe (TOML): recordings, cutter, stages and expectations.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Result folder; an old result there is replaced as a whole.")],
    gate: Annotated[bool, typer.Option("--gate", help="End with 1 unless the verdict is 'fits'.")] = False,
    depfile: Annotated[
        Path | None, typer.Option("--depfile", help="Write a rule for make: on which files the result depends.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of everything random; default: the recipe's.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Recorded cuts and impact tests to cutting coefficients, a stability map and a report.

    Example: millcal fit recipes/slot-demo.toml --out build/slot-demo
    """
    from millcal import pipeline
    from millcal.io.make_rule import make_rule
    from millcal.io.provenance import sha256_of
    from millcal.io.recipes import read_recipe
    from millcal.io.results import write_text_atomically

    plan = read_recipe(recipe)
    with progress_bar(quiet) as progress:
        found = pipeline.run(plan, out, progress=progress, seed=seed)
    report = out / "report.html"
    result = found.summary if found.skipped else {**found.summary, "report": str(report)}
    inputs = {str(recipe): sha256_of(recipe), **found.provenance.get("inputs", {})}
    text = f"{plan.title}: skipped" if found.skipped else _text(plan.title, found, report)
    reply("fit", text, result, inputs=inputs, notices=found.notices, as_json=as_json, quiet=quiet)
    if found.skipped:
        return 0
    failures = [_miss(plan, entry) for entry in found.missed]
    if gate and not _fits(found):
        failures.append(f"{recipe}: the verdict is '{result['verdict']}'; see {report}")
    if failures:
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        typer.echo(f"error: {failures[0]}{more}", err=True)
        return 1
    if depfile is not None:
        write_text_atomically(depfile, make_rule(depfile, [recipe, *plan.recordings]))
    return 0


def _text(title: str, found: Any, report: Path) -> str:
    """The readable result, which ends with the path of the report."""
    from millcal.io.readable import brief_of

    parts = [
        title,
        *(
            brief_of(found.results[name])
            for name in ("frf", "modes", "sensor", "forces", "coefficients", "stability")
            if name in found.results
        ),
    ]
    if found.summary["expect"]:
        lines = [
            f"{'met   ' if e['ok'] else 'MISSED'}  {e['key']} = {_number(e['value'])}, expected {_interval(e['interval'])}"
            for e in found.summary["expect"]
        ]
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, f"report: {report}"])


def _fits(found: Any) -> bool:
    return str(found.summary["verdict"]).split(":")[0] == "fits"


def _miss(plan: Any, entry: dict[str, Any]) -> str:
    where = plan.document.where(("expect", entry["key"]))
    if entry["value"] is None:
        return f"{where}: there is no such number in the summary; see summary.json for its keys"
    return f"{where}: {_number(entry['value'])} is not {_interval(entry['interval'])}; see the report"


def _number(value: Any) -> str:
    return f"{value:.7g}" if isinstance(value, float) else "unknown" if value is None else str(value)


def _interval(wanted: Any) -> str:
    return f"'{wanted}...'" if isinstance(wanted, str) else f"within {wanted[0]:.7g} .. {wanted[1]:.7g}"
