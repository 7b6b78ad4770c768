"""Synthetic recordings with known truth: `millcal simulate`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from millcal.cli.speak import Json, Quiet, progress_bar, reply


def simulate(
    recipe: Annotated[Path, typer.Argument(metavar="RECIPE", help="Recipe with a [simulate] table.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the recordings and truth.json.")],
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed of everything random; default: the recipe's.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write synthetic recordings with known truth from a recipe.

    Example: millcal simulate recipes/simulate/slot-cuts.toml --out build/slot-cuts
    """
    import json

    import numpy as np

    from millcal.errors import RecipeError
    from millcal.io.provenance import sha256_of
    from millcal.io.recipes import read_recipe
    from millcal.io.results import write_text_atomically

    plan = read_recipe(recipe)
    if plan.simulate is None:
        raise RecipeError(f"{recipe}: there is no [simulate] table; see the recipes in recipes/simulate")
    seed = plan.seed if seed is None else seed
    tables = [*plan.simulate.cuts, *plan.simulate.impacts]
    truth: dict[str, Any] = {"title": plan.title, "seed": seed, **plan.simulate.truth(plan.cutter), "recordings": {}}
    lines = []
    with progress_bar(quiet) as progress:
        for number, table in enumerate(tables):
            progress(number / len(tables), table.recording)
            rng = np.random.default_rng([seed, number])  # a recording does not depend on those before it
            is_cut = number < len(plan.simulate.cuts)
            recording, known = _cut(plan, number, rng) if is_cut else _impact(plan, table, rng)
            path = out / table.recording
            _write(path, recording, table)
            truth["recordings"][table.recording] = known
            n_channels, n_samples = recording.samples.shape
            lines.append(f"{path}: {recording.kind}, {n_channels} channels, {n_samples} samples")
    write_text_atomically(out / "truth.json", json.dumps(truth, indent=1, ensure_ascii=False) + "\n")
    lines.append(f"{out / 'truth.json'}: the truth")
    inputs = {str(recipe): sha256_of(recipe)}
    reply("simulate", "\n".join(lines), truth, inputs=inputs, notices=(), as_json=as_json, quiet=quiet)


def _cut(plan: Any, number: int, rng: Any) -> tuple:
    """One cut of the recipe: (recording, truth)."""
    from millcal.io.keys import in_si
    from millcal.simulation import Line, Timeline, simulate_cut
    from millcal.simulation.regenerative import simulate_regenerative_cut

    options = plan.simulate
    table = options.cuts[number]
    keys = table.keys(options.conditions)
    trouble = keys.trouble(plan.cutter)
    if trouble:
        plan.document.refuse(("simulate", "cuts", number, trouble[0]), trouble[1])
    timeline = Timeline(table.duration_s, table.air_before_s, table.air_after_s, table.ramp_s)
    if table.regenerative:
        return simulate_regenerative_cut(
            options.law.law(),
            plan.cutter,
            keys.conditions(plan.cutter),
            rng=rng,
            sample_rate=table.sample_rate_hz or options.sample_rate_hz,
            timeline=timeline,
            modes=tuple(mode.mode() for mode in options.modes),
            speed_error=table.speed_error,
            accelerometers=table.accelerometers,
            accelerometer=options.accelerometer.chain(),
            displacements=table.displacements,
            probe=options.probe.chain(),
            pulse=table.pulse,
            name=table.recording,
        )
    angle, pulse_angle = in_si(table.initial_angle_deg, "_deg"), in_si(table.pulse_angle_deg, "_deg")
    return simulate_cut(
        options.law.law(),
        plan.cutter,
        keys.conditions(plan.cutter),
        rng=rng,
        sample_rate=table.sample_rate_hz or options.sample_rate_hz,
        timeline=timeline,
        initial_angle=angle,
        speed_error=table.speed_error,
        variation=table.speed_variation,
        variation_frequency=table.speed_variation_hz,
        dynamometer=options.dynamometer.chain() if table.dynamometer else None,
        modes=tuple(mode.mode() for mode in options.modes),
        accelerometers=table.accelerometers,
        accelerometer=options.accelerometer.chain(),
        lines=tuple(Line(line.frequency_hz, line.amplitude_N) for line in table.lines),
        pulse=table.pulse,
        pulse_angle=pulse_angle,
        encoder=table.encoder_counts if table.encoder else 0,
        trend=table.trend(timeline.steady_span),
        start_time=table.start_time_s,
        name=table.recording,
        axis_map=options.dynamometer.map,
        acts_on=options.dynamometer.acts_on,
    )


def _impact(plan: Any, table: Any, rng: Any) -> tuple:
    """One impact test of the recipe: (recording, truth)."""
    from millcal.simulation import simulate_impact

    options = plan.simulate
    return simulate_impact(
        tuple(mode.mode() for mode in options.modes),
        rng=rng,
        sample_rate=table.sample_rate_hz or options.sample_rate_hz,
        hammer_chain=options.hammer.chain(),
        accelerometer=options.accelerometer.chain(),
        dynamometer=options.dynamometer.chain() if table.dynamometer else None,
        name=table.recording,
        **table.arguments(),
    )


def _write(path: Path, recording: Any, table: Any) -> None:
    """Write a recording in the format its table names."""
    from millcal.io.formats.text_writer import write_csv, write_dynoware
    from millcal.io.recordings import write_recording

    if path.suffix == ".h5":
        write_recording(path, recording, counts=True)
    elif table.format == "dynoware":
        write_dynoware(path, recording, measuring_time=table.measuring_time_s)
    else:
        write_csv(path, recording)
