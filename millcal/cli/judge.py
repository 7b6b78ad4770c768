"""Was that chatter: `millcal judge`."""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from millcal.cli.cut_input import for_each
from millcal.cli.speak import Json, NoSeed, Quiet, check_files, pairs, progress_bar, reply

FIGURES = (".png", ".svg", ".pdf", ".html")
PARTLY_DONE = 4  # exit code of a batch


def judge(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="REC...", help="Recordings of cuts: displacement, acceleration, velocity, sound or force."
        ),
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Result file, HDF5.")] = None,
    setup: Annotated[
        Path | None, typer.Option("--setup", help="SETUP.toml with [cutter], [conditions], [map], [units].")
    ] = None,
    channel: Annotated[
        str | None, typer.Option("--channel", help="Channel to judge by; default: the one that shows most.")
    ] = None,
    teeth: Annotated[int | None, typer.Option("--teeth", min=1, help="Default: the cutter's.")] = None,
    rpm: Annotated[
        list[float] | None,
        typer.Option("--rpm", help="Spindle speed, to 3 percent: one, or one for each; default: the recording's."),
    ] = None,
    axial_depth_mm: Annotated[
        list[float] | None, typer.Option("--axial-depth-mm", help="For the log: one, or one for each recording.")
    ] = None,
    steady: Annotated[
        tuple[float, float] | None,
        typer.Option("--steady", metavar="FROM TO", help="The cut, s after the first sample; default: found."),
    ] = None,
    modes: Annotated[
        Path | None,
        typer.Option("--modes", help="Modes of the tool, a result file: says what the sample rate cannot show."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option("--log", help="Cuts log to write, CSV, as `millcal stability --tests` reads it.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help="Figure of one cut to write, .png, .svg or .pdf; .html is a page of all."),
    ] = None,
    maps: Annotated[
        list[str] | None, typer.Option("--map", metavar="mic=+Audio", help="Channel = signed column.")
    ] = None,
    units: Annotated[list[str] | None, typer.Option("--unit", metavar="Audio=Pa", help="Unit of a column.")] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", help="Sampling rate, where the file does not say it.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: NoSeed = 0,
) -> None:
    """Judge recorded cuts: stable, a motion that repeats after some teeth, chatter with its frequency, or not known and why.

    Example: millcal judge cut.h5 --figure cut.png

    Example: millcal judge sound.csv --teeth 4 --rpm 6000 --unit Audio=Pa

    Example: millcal judge cut-*.h5 --log cuts.csv
    """
    number = len(recordings)
    speeds, depths = for_each(rpm, number, "--rpm"), for_each(axial_depth_mm, number, "--axial-depth-mm")
    for option, values in (("--rpm", rpm), ("--axial-depth-mm", axial_depth_mm)):
        if values and not all(0 < value < float("inf") for value in values):
            raise typer.BadParameter("is above zero and finite", param_hint=option)
    _check_no_values(recordings, {"--rpm": rpm, "--axial-depth-mm": axial_depth_mm})
    if steady is not None and not 0 <= steady[0] < steady[1] < float("inf"):
        raise typer.BadParameter(f"{steady[0]:g} to {steady[1]:g} is no stretch", param_hint="--steady")
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise typer.BadParameter(
            f"{figure} does not say its format; end it with {', '.join(FIGURES)}", param_hint="--figure"
        )
    if figure is not None and number > 1 and figure.suffix.lower() != ".html":
        raise typer.BadParameter("is of one cut; name one recording", param_hint="--figure")
    check_files([*recordings, setup, modes], [output, log, figure])

    from millcal.data import Notice
    from millcal.errors import RecordingError
    from millcal.io.judge_summary import cuts_log, judgement_text, judgements_text
    from millcal.io.provenance import provenance
    from millcal.io.results import replaced_atomically, write_result, write_results, write_text_atomically
    from millcal.io.summaries import summarise
    from millcal.stages.judge import judge_cut

    stated = {"map": pairs(maps, "--map"), "units": pairs(units, "--unit"), "rate_hz": rate_hz}
    found, deep, notices = [], [], []
    used: list[Path] = []
    refused: dict[str, str] = {}
    with progress_bar(quiet) as progress:
        known = _modes(modes, setup)
        for i, path in enumerate(recordings):
            progress(i / number, path.name)
            try:
                cut = _cut(path, setup, speeds[i], depths[i], **stated)
                if cut.recording.kind == "impact":
                    notices.append(Notice("impact-test", "is an impact test and no cut; it is left out", str(path)))
                    used.append(path)
                    continue
                judgement = judge_cut(
                    cut.recording,
                    channel=channel,
                    teeth=teeth,
                    spindle_speed=cut.speed,
                    steady=steady,
                    modes=known,
                    no_runout=cut.no_runout,
                )
            except RecordingError as problem:
                if number == 1:
                    raise
                refused[str(path)] = " ".join(str(problem).split())
                continue
            notices += [*cut.recording.notices, *judgement.notices]
            found.append(judgement)
            deep.append(cut.depth)
            used.append(path)
    for problem in refused.values():
        typer.echo(f"error: {problem}", err=True)
    if not found and refused:
        raise typer.Exit(3)
    if not found:
        raise RecordingError(f"{recordings[0]}: is an impact test and no cut; give recordings of cuts")
    if log is not None:
        _check_log(found, deep)

    origin = provenance([path for path in (*used, setup, modes) if path is not None], seed=seed)
    written: dict[str, str] = {}
    if output is not None:
        if number == 1:
            write_result(output, found[0], provenance=origin)
        else:
            write_results(output, found, provenance=origin)
    if log is not None:
        write_text_atomically(log, cuts_log(found, deep))
        written["log"] = str(log)
    if figure is not None:
        content = _drawn(found, figure.suffix[1:].lower(), origin)
        with replaced_atomically(figure) as temporary:
            temporary.write_bytes(content)
        written["figure"] = str(figure)
    told = summarise(found[0]) if number == 1 else {"cuts": [summarise(cut) for cut in found]}
    if refused:
        told["refused"] = [{"recording": path, "why": why} for path, why in refused.items()]
    text = judgement_text(found[0]) if number == 1 else judgements_text(found, deep)
    reply(
        "judge",
        "\n".join([text, *(f"{what}: {path}" for what, path in written.items())]),
        {**told, "output": None if output is None else str(output), **written},
        inputs=origin["inputs"],
        notices=notices,
        as_json=as_json,
        quiet=quiet,
    )
    if refused:
        raise typer.Exit(PARTLY_DONE)


def _check_no_values(recordings: list[Path], options: dict[str, list[float] | None]) -> None:
    """Refuse a number among the recordings that was meant for an option: each takes one value."""
    for path in recordings:
        try:
            float(path.name)
        except ValueError:
            continue
        given = [option for option, values in options.items() if values]
        if given and not path.exists():
            raise typer.BadParameter(
                f"takes one value each time; {path} is taken for a recording: write {given[0]} once for each value",
                param_hint=" or ".join(given),
            )


def _drawn(found: list[Any], format: str, origin: dict[str, Any]) -> bytes:
    """One cut as a figure to print, or all as a page."""
    if format == "html":
        from millcal.report.page import render

        return render({"judgements": found}, {"title": "Was that chatter?"}, origin).encode("utf-8")
    from millcal.report.paper.judge import judgement_file

    return judgement_file(found[0], format)


class _Cut(NamedTuple):
    """A recording and what is known of its cut."""

    recording: Any
    speed: float | None  # rad/s
    depth: float | None  # m
    no_runout: bool  # stated


def _cut(path: Path, setup: Path | None, rpm: float | None, depth_mm: float | None, **how: Any) -> _Cut:
    """A cut from its file, with what setup and command line say of it; neither depth nor feed is needed."""
    from dataclasses import replace

    from millcal.io.recipes import Setup, read_setup
    from millcal.io.recordings import read_recording
    from millcal.units import from_shop

    stated = read_setup(setup, spindle_speed_rpm=rpm, partial=True) if setup else Setup()
    recording = read_recording(path, setup=stated, **how)
    conditions = recording.conditions
    speed = None if rpm is None else from_shop(rpm, "x_rpm")
    depth = None if depth_mm is None else from_shop(depth_mm, "x_mm")
    if conditions is not None:
        conditions = replace(
            conditions, spindle_speed=speed or conditions.spindle_speed, axial_depth=depth or conditions.axial_depth
        )
        speed, depth = conditions.spindle_speed, conditions.axial_depth
    document = stated.document
    return _Cut(
        replace(recording, conditions=conditions),
        speed or stated.spindle_speed,
        depth or stated.axial_depth,
        document is not None
        and ("cutter", "runout_um") in document.places
        and stated.cutter == recording.cutter
        and stated.cutter.runout == 0,
    )


def _modes(modes: Path | None, setup: Path | None) -> tuple[float, ...]:
    """Natural frequencies of the tool in Hz, where a file says them."""
    from millcal.data import Modes
    from millcal.io.recipes import read_setup
    from millcal.io.results import read_result

    found = read_result(modes, Modes) if modes is not None else None
    if found is None and setup is not None:
        found = read_setup(setup, partial=True).modes
    return () if found is None else tuple(float(f) for f in found.natural_frequency)


def _check_log(found: list[Any], depths: list[float | None]) -> None:
    """A log needs the depth of every cut."""
    from millcal.errors import RecipeError

    for cut, depth in zip(found, depths, strict=True):
        if depth is None or not depth > 0:
            raise RecipeError(
                f"{cut.name}: no axial depth is known, which a cuts log needs; give --axial-depth-mm, or --setup SETUP.toml "
                "with axial_depth_mm in [conditions]"
            )
