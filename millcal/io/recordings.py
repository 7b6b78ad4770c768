"""Any file to a `Recording`, and a `Recording` to the file of the contract.

A format plugs in as one line of `FORMATS`: a function that recognises a file by its first bytes and one that opens it.
What all formats share is done here once: units, axes and signs, the time base, missing cells, the cut's keys, and
keeping large samples on disk.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from millcal.data import Channel, Notice, Recording, SamplesOnDisk
from millcal.errors import RecordingError
from millcal.io.channels import Selection, choose_channels
from millcal.io.engagement import completed, read_engagement
from millcal.io.formats import hdf5, hdf5_other, text, uff, wav
from millcal.io.formats.foreign import refuse_foreign
from millcal.io.formats.recording_writer import write_recording
from millcal.io.formats.source import Progress, Source, silent
from millcal.io.formats.time_base import TimeBase, checked_rate
from millcal.io.gaps import bridged
from millcal.io.keys import ConditionsTable, CutterTable
from millcal.io.recipes import Setup
from millcal.io.samples import IN_MEMORY, Chained, Scratch, in_memory_if_small

__all__ = [
    "FORMATS",
    "Format",
    "join_recordings",
    "mapping_of",
    "open_source",
    "read_recording",
    "write_recording",
]

FEWEST = 8  # samples of a recording
LARGEST = 1e15  # a larger value is no measurement, and its square would overflow
HEAD = 4096  # bytes by which a format is recognised
KINDS = ("cut", "impact", "air")
_OF_CUT = ("steady", "air", "path_start", "spindle_phase")  # of a recording, beside cutter and conditions


class Format(NamedTuple):
    """How a format is recognised, from its path and first bytes, and opened, with what a setup says about it."""

    sniff: Callable[[Path, bytes], bool]
    open_source: Callable[[Path, Setup], Source]


FORMATS = {  # asked in this order; text takes what no other one claims
    "millcal-recording": Format(hdf5.sniff, hdf5.open_source),
    "hdf5": Format(hdf5_other.sniff, hdf5_other.open_source),
    "uff": Format(uff.sniff, uff.open_source),
    "wav": Format(wav.sniff, wav.open_source),
    "text": Format(text.sniff, text.open_source),
}


def open_source(path: Path, setup: Setup | None = None) -> Source:
    """Recognise a file and open it."""
    path = Path(path)
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: a folder; name the recording in it")
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise RecordingError(f"{path}: {reason}; check the path and the permissions") from None
    if not head:
        raise RecordingError(f"{path}: empty; export the recording again")
    refuse_foreign(path, head)
    known = next(known for known in FORMATS.values() if known.sniff(path, head))
    return known.open_source(path, setup or Setup())


def read_recording(
    path: Path,
    *,
    setup: Setup | None = None,
    map: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
    acts_on: str | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Read a file of any known format.

    setup : what the file does not say; the other arguments win over it
    map : channel -> signed column, `fx -> +Fy`; `name@dof -> column` also gives point and direction
    units : column -> unit (`kN`) or sensitivity (`100 mV/g`)
    rate_hz : sample rate, where the file has no time or a wrong one
    acts_on : tool or workpiece; the reaction on a workpiece is turned, once, where the file does not say "tool"
    """
    path, setup = Path(path), setup or Setup()
    source = open_source(path, setup)
    if source.missing:
        raise RecordingError(f"{path}: {source.missing[0]}")
    chosen = chosen_channels(source, setup, map, units, acts_on)
    if chosen.problems:
        raise RecordingError(f"{path}: {chosen.problems[0]}")
    stated = setup.sample_rate if rate_hz is None else rate_hz
    if stated is not None:
        checked_rate(stated, str(path), "state another with --rate-hz")
    if chosen.time is None and source.sample_rate is None and stated is None:
        raise RecordingError(
            f"{path}: no time column and no sample rate; state --rate-hz, sample_rate_hz in a recipe, or the time "
            f"column by its unit, such as --unit {source.columns[0].name}=s"
        )
    if source.rows is not None and source.rows < FEWEST:
        raise RecordingError(f"{path}: only {source.rows} samples; a recording needs at least {FEWEST}")
    samples, rate, start, notices = _samples(source, chosen, stated, progress or silent)
    notices += _constant_channels(path, samples, chosen.channels, source.trusted)
    of_cut = _cut_of(source, setup, notices)
    return Recording(
        samples=samples,
        sample_rate=rate,
        channels=chosen.channels,
        kind=_kind(path, setup.kind or source.attributes.get("kind", "cut")),
        name=str(path),
        segments=source.segments,
        start_time=start,
        **of_cut,
        notices=(*source.notices, *chosen.notices, *notices),
    )


def mapping_of(
    path: Path,
    *,
    setup: Setup | None = None,
    map: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    acts_on: str | None = None,
) -> dict[str, str]:
    """Which signed column each channel comes from: {"fx": "+Fy"}."""
    setup = setup or Setup()
    return dict(chosen_channels(open_source(path, setup), setup, map, units, acts_on).mapping)


def join_recordings(recordings: Sequence[Recording]) -> Recording:
    """Several recordings of the same channels one behind the other, one segment for each: an impact test hit by hit."""
    first = recordings[0]
    segments, begin = [], 0
    for recording in recordings:
        here = f"{recording.name}: joined with {first.name}"
        if recording.sample_rate != first.sample_rate:
            raise RecordingError(
                f"{here}: inconsistent rates, {recording.sample_rate:g} Hz and {first.sample_rate:g} Hz; "
                "join recordings of one rate"
            )
        names, expected = ([channel.name for channel in r.channels] for r in (recording, first))
        if recording.channels != first.channels:
            raise RecordingError(
                f"{here}: channels {', '.join(names)} and {', '.join(expected)} differ in name, unit or dof; "
                "join recordings of the same channels"
            )
        length = recording.samples.shape[1]
        own = np.array([[0, length]]) if recording.segments is None else np.asarray(recording.segments)
        segments.append(own + np.array([begin, 0]))
        begin += length
    return replace(
        first,
        samples=in_memory_if_small(Chained([recording.samples for recording in recordings])),
        segments=np.concatenate(segments),
        notices=tuple(notice for recording in recordings for notice in recording.notices),
    )


def chosen_channels(
    source: Source,
    setup: Setup,
    mapping: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
    acts_on: str | None,
) -> Selection:
    """The channels of an opened file, by its own words, the setup's, and those of the call, the later winning."""
    return choose_channels(
        source.columns,
        where=str(source.path),
        mapping={**setup.map, **(mapping or {})},
        units={**setup.units, **(units or {})},
        tables=setup.channels,
        acts_on=acts_on or setup.acts_on or source.attributes.get("acts_on"),
    )


def _samples(
    source: Source, chosen: Selection, stated: float | None, progress: Progress
) -> tuple[np.ndarray | SamplesOnDisk, float, float, list[Notice]]:
    """Samples in SI, their rate in Hz, the time of the first in s, and notices."""
    path, notices = source.path, []
    if source.read_block is not None and chosen.time is None:
        samples = in_memory_if_small(_InSi(source, chosen))
        if isinstance(samples, np.ndarray):
            _check_values(samples, chosen.channels, source, 0)
        start = hdf5.number_of(source.attributes.get("start_time_s")) or 0.0
        return samples, _stated_rate(source, stated), start, []
    time = chosen.time
    clock = None if time is None else TimeBase(path, source.columns[time].name, source.place)
    scratch = Scratch(len(chosen.rows))
    rows = list(chosen.rows)
    seconds = chosen.time_scale or 1.0
    gains = chosen.gains[:, np.newaxis]

    def wanted() -> Iterator[np.ndarray]:
        for block in source.blocks(progress):
            if clock is not None:
                clock.add(block[time] * seconds)
            yield block[rows] * gains

    names = [source.columns[row].name for row in rows]
    for block in bridged(wanted(), names, path, source.place, notices):
        _check_values(block, chosen.channels, source, scratch.shape[1])
        scratch.append(block)
    if scratch.shape[1] < FEWEST:
        raise RecordingError(f"{path}: only {scratch.shape[1]} rows of numbers; a recording needs at least {FEWEST}")
    if clock is None:
        return scratch.settled(), _stated_rate(source, stated), 0.0, notices
    if chosen.time_scale is None:
        notices += _time_without_unit(clock, stated, source.sample_rate)
        return scratch.settled(), stated or source.sample_rate or 0.0, clock.first, notices
    rate, more = rate_of(clock, stated, source.sample_rate)
    return scratch.settled(), rate, clock.first, notices + more


def rate_of(clock: TimeBase, stated: float | None, header: float | None) -> tuple[float, list[Notice]]:
    """Sample rate in Hz from the times, what the user states and what the header says, and notices."""
    rate, notices = clock.rate(stated, header)
    mending = "check the unit of the time column, or state the rate with --rate-hz"
    return checked_rate(rate, clock.where, mending), notices


def _time_without_unit(clock: TimeBase, stated: float | None, header: float | None) -> list[Notice]:
    """A time column without a unit does no harm where the rate is stated; where the header's rate makes it seconds, too."""
    if stated is not None:
        return []
    span = clock.last - clock.first
    if header is None or span <= 0 or abs((clock.n - 1) / span / header - 1) > 0.01:
        name = clock.where.split("column ")[-1].strip("'")
        raise RecordingError(f"{clock.where} has no unit; state it with --unit {name}=s (or ms, us)")
    message = "the time has no unit; the header's sample rate shows that it is in s"
    return [Notice("time-unit", message, clock.where, "note")]


def _stated_rate(source: Source, stated: float | None) -> float:
    rate = source.sample_rate if stated is None else stated
    if rate is None:
        raise RecordingError(f"{source.path}: no sample rate in the file; state it with --rate-hz")
    return checked_rate(rate, str(source.path), "state another with --rate-hz")


class _InSi:
    """Samples of a file that can be read anywhere, in SI and with their signs."""

    def __init__(self, source: Source, chosen: Selection) -> None:
        self._source, self._chosen = source, chosen
        self.shape = (len(chosen.rows), source.rows or 0)

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        return self.read_rows(start, stop, range(self.shape[0]))

    def read_rows(self, start: int, stop: int, rows: Sequence[int]) -> np.ndarray:
        """Samples start..stop of some channels.   returns (channel, stop - start)"""
        start, stop, _ = slice(start, stop).indices(self.shape[1])
        stop, columns = max(start, stop), [self._chosen.rows[row] for row in rows]
        if self._source.read_rows is not None:
            block = self._source.read_rows(start, stop, columns)
        else:
            block = self._source.read_block(start, stop)[columns]  # type: ignore[misc]
        block *= self._chosen.gains[list(rows), np.newaxis]
        if 8 * self.shape[0] * self.shape[1] > IN_MEMORY:
            _check_values(block, [self._chosen.channels[row] for row in rows], self._source, start)
        return block


def _check_values(block: np.ndarray, channels: Sequence[Channel], source: Source, first: int) -> None:
    """Refuse what no sensor delivers."""
    good = np.abs(block) < LARGEST  # False for NaN, too
    if good.all():
        return
    row, column = np.argwhere(~good)[0]
    raise RecordingError(
        f"{source.path}: channel '{channels[row].name}' is {block[row, column]:.3g} {channels[row].unit} at "
        f"{source.place(first + int(column))}; mend the value, or leave the channel out with --map"
    )


def _constant_channels(
    path: Path, samples: np.ndarray | SamplesOnDisk, channels: Sequence[Channel], trusted: bool
) -> list[Notice]:
    """A sensor always has noise: a constant channel is dead. In our own layout it may be simulated, and is only told."""
    first = samples[:, :1] if isinstance(samples, np.ndarray) else samples.read_block(0, 1)
    constant = np.ones(len(channels), dtype=bool)
    step = 1 << 18
    for start in range(0, samples.shape[1], step):
        stop = min(start + step, samples.shape[1])
        block = samples[:, start:stop] if isinstance(samples, np.ndarray) else samples.read_block(start, stop)
        constant &= (block == first).all(axis=1)
        if not constant.any():
            return []
    notices = []
    for channel, value in zip(np.array(channels, dtype=object)[constant], first[constant, 0], strict=True):
        what = f"channel '{channel.name}' is constant, {value:.6g} {channel.unit} in all samples: dead or not connected"
        if not trusted:
            raise RecordingError(f"{path}: {what}; leave it out with --map, or check the sensor")
        notices.append(Notice("constant-channel", what, str(path)))
    return notices


def _kind(path: Path, kind: Any) -> Any:
    if kind not in KINDS:
        raise RecordingError(f"{path}: kind is {kind!r}, which is none of {', '.join(KINDS)}; write one of them")
    return kind


def _cut_of(source: Source, setup: Setup, notices: list[Notice]) -> dict[str, Any]:
    """Cutter, conditions and what else a recording says of its cut, from the file's own keys; what the setup says wins."""
    attributes = source.attributes
    of_cutter = {key: attributes[key] for key in CutterTable.model_fields if key in attributes}
    of_cut = {key: attributes[key] for key in ConditionsTable.model_fields if key in attributes}
    try:
        if isinstance(of_cutter.get("teeth"), float) and of_cutter["teeth"].is_integer():
            of_cutter["teeth"] = int(of_cutter["teeth"])
        cutter = setup.cutter or (CutterTable(**of_cutter).cutter() if "diameter_mm" in of_cutter else None)
        keys = ConditionsTable(**of_cut)
    except ValidationError as problem:
        error = problem.errors()[0]
        key = ".".join(str(part) for part in error["loc"])
        raise RecordingError(
            f"{source.path}: attribute {key} is {error.get('input')!r}; {error['msg'].lower()}: correct the attribute"
        ) from None
    conditions, engagement = setup.conditions, setup.engagement
    if engagement is None and keys.engagement is not None:
        engagement = read_engagement(source.path.parent / keys.engagement)
        keys = completed(keys, engagement, cutter)
    if conditions is None and keys.has_conditions():
        trouble = keys.trouble(cutter)
        if trouble is None:
            conditions = keys.conditions(cutter)
        else:
            message = f"the file's cutting conditions are not taken: {trouble[0]} {trouble[1]}"
            notices.append(Notice("conditions-incomplete", message, str(source.path)))
    given = keys.arguments()
    own = {key: given[key] if getattr(setup, key) is None else getattr(setup, key) for key in _OF_CUT}
    return {"cutter": cutter, "conditions": conditions, "engagement": engagement, **own}
