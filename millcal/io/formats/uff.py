"""Time records of a universal file as a recording: one channel for each dof and quantity, one segment for each hit.

Several records of one channel are hits, laid one behind the other in the order of the file. The sampling interval has six
digits there, 1.95313E-05 s for 51.2 kHz; of all rates that it may mean, the one with the fewest digits is taken.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats.source import Column, Progress, Source
from millcal.io.formats.time_base import MATTERS, TimeBase, fewest_digits, time_unit
from millcal.io.formats.uff_dofs import dof_names
from millcal.io.formats.universal import Function, Universal, is_universal, read_universal

TIME, UNKNOWN = 1, 0  # function types
TIME_AXIS = 17
QUANTITIES = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}  # by specific data type
SI = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N"}
_BLOCK = 1 << 18  # samples at a time


def sniff(path: Path, head: bytes) -> bool:
    """A file that begins as a universal file does."""
    return is_universal(head)


def open_source(path: Path, setup: Any = None) -> Source:
    """Open the time records of a universal file; what else it holds is told."""
    found = read_universal(path)
    records = [f for f in found.functions if is_time_record(f)]
    others = counted([f for f in found.functions if f not in records])
    details = {"program": found.program, "model": found.model, "records": others, "segments": 0}
    if not records:
        held = ", ".join(f"{n} x {what}" for what, n in others.items())
        missing = (
            f"a universal file without time records (it holds {held}); an FRF is read by 'millcal export' and --frf"
        )
        return Source(path, "uff", (), lambda progress: iter(()), rows=0, details=details, missing=(missing,))
    channels = _channels(path, records)
    _check_hits(path, channels)
    rate, start, notices = _rate(path, records)
    lengths = [record.count for record in channels[0]]
    ends = np.cumsum(lengths)
    segments = np.stack([ends - lengths, lengths], axis=1)
    columns = _columns(channels)
    reader = _Reader(channels, ends, [_scale(records[0]) for records in channels])
    if others:
        held = ", ".join(f"{n} x {what}" for what, n in others.items())
        notices.append(Notice("records-left-out", f"only the time records are taken, not {held}", str(path), "note"))
    hits = len(lengths)
    return Source(
        path=path,
        format="uff",
        columns=columns,
        blocks=reader.blocks,
        rows=int(ends[-1]),
        read_block=reader.read_block,
        sample_rate=rate,
        attributes={"start_time_s": start, **({"kind": "impact"} if hits > 1 else {})},
        segments=segments if hits > 1 else None,
        place=lambda row: _place(row, ends),
        notices=[*found.notices, *notices],
        details={**details, "segments": hits if hits > 1 else 0},
    )


def is_time_record(function: Function) -> bool:
    """Whether a function is a time record, by its type or, where that is unknown, by its abscissa."""
    return function.kind == TIME or (function.kind == UNKNOWN and function.abscissa.kind == TIME_AXIS)


def counted(functions: Sequence[Function]) -> dict[str, int]:
    """How many functions of each kind."""
    kinds = [function.what for function in functions]
    return {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}


def holds_time_records(found: Universal) -> bool:
    """Whether any function of a file is a time record."""
    return any(is_time_record(function) for function in found.functions)


def _channels(path: Path, records: Sequence[Function]) -> list[list[Function]]:
    """The records of each channel, in the order of the file."""
    channels: dict[tuple, list[Function]] = {}
    for record in records:
        if record.is_complex:
            raise RecordingError(f"{record.where}: a time record of complex numbers; export it as real ones")
        key = (record.response, QUANTITIES.get(record.numerator.kind, record.numerator.kind), record.numerator.unit)
        channels.setdefault(key, []).append(record)
    return list(channels.values())


def _check_hits(path: Path, channels: Sequence[Sequence[Function]]) -> None:
    """Every channel has every hit, and the channels of one hit have one length."""
    counts = [len(records) for records in channels]
    if len(set(counts)) > 1:
        names = dof_names(record.response for records in channels for record in records)
        told = ", ".join(f"{names[records[0].response]} {len(records)}" for records in channels)
        raise RecordingError(f"{path}: channels with unequal numbers of time records ({told}); export every hit whole")
    for hit in zip(*channels, strict=True):
        for record in hit:
            if record.count != hit[0].count:
                raise RecordingError(
                    f"{record.where}: {record.count} samples where record {hit[0].number} of the same hit has "
                    f"{hit[0].count}; export channels of one length"
                )


def _rate(path: Path, records: Sequence[Function]) -> tuple[float, float, list[Notice]]:
    """Sample rate in Hz, time of the first sample in s, and notices; all records have one rate."""
    first = records[0]
    seconds = 1.0
    if first.abscissa.unit:
        known = time_unit(first.abscissa.unit)
        if known is None:
            raise RecordingError(
                f"{first.where}: a time in {first.abscissa.unit!r}; export it in s, or state the rate with --rate-hz"
            )
        seconds = known
    if not first.even:
        times = first.x() * seconds
        clock = TimeBase(path, f"abscissa of record {first.number}", lambda row: f"sample {row}")
        clock.add(times)
        rate, notices = clock.rate(None, None)
        _check_uneven(records, rate, seconds)
        return rate, float(times[0]), notices
    doubt = max(first.step_rounding / first.step, 1e-12)
    rate = fewest_digits(1 / (first.step * (1 + doubt)) / seconds, 1 / (first.step * (1 - doubt)) / seconds)
    for record in records:
        if not record.even or abs(record.step / first.step - 1) > 2 * doubt:
            raise RecordingError(
                f"{record.where}: sampled every {record.step:g} where record {first.number} is every {first.step:g}; "
                "export records of one rate"
            )
    notices = []
    if doubt > 1e-6:
        message = f"the sampling interval is rounded to {first.step:.10g} s; a rate of {rate:.10g} Hz is taken for it"
        notices.append(Notice("rounded-step", message, str(path), "warning" if doubt > MATTERS else "note"))
    return rate, first.first * seconds, notices


def _check_uneven(records: Sequence[Function], rate: float, seconds: float) -> None:
    for record in records:
        times = record.first + record.step * np.arange(record.count) if record.even else record.x()
        span = (times[-1] - times[0]) * seconds * rate
        if record.count > 1 and abs(span - (record.count - 1)) > 0.5:
            raise RecordingError(f"{record.where}: sampled at another rate than the first record; export one rate")


def _scale(record: Function) -> float:
    """SI per number of a record without a unit of its own, from the units of the file; 1 where it has one."""
    quantity, units = QUANTITIES.get(record.numerator.kind), record.units
    if record.numerator.unit or quantity is None or units is None:
        return 1.0
    return 1 / (units.force if quantity == "force" else units.length)


def _columns(channels: Sequence[Sequence[Function]]) -> tuple[Column, ...]:
    """Name, unit and dof of each channel: `force 1X`, or what stands for it where the quantity is not said."""
    names = dof_names(record.response for records in channels for record in records)
    columns = []
    for records in channels:
        axis, dof = records[0].numerator, names[records[0].response]
        quantity = QUANTITIES.get(axis.kind)
        unit = axis.unit or (SI[quantity] if quantity and records[0].units else None)
        columns.append((f"{quantity or axis.label or 'channel'}_{dof.lstrip('-')}", unit, quantity, dof))
    kinds = [name for name, *_ in columns]
    return tuple(
        Column(name if kinds.count(name) == 1 else f"{name}_{number}", unit, name, quantity, dof)
        for number, (name, unit, quantity, dof) in enumerate(columns, start=1)
    )


def _place(row: int, ends: np.ndarray) -> str:
    hit = int(np.searchsorted(ends, row, side="right"))
    return f"sample {row - (ends[hit - 1] if hit else 0)} of hit {hit}"


class _Reader:
    """The samples of all hits laid one behind the other; numbers in text are kept once they were read."""

    def __init__(self, channels: Sequence[Sequence[Function]], ends: np.ndarray, scales: Sequence[float]) -> None:
        self._channels, self._ends, self._scales = channels, ends, scales
        self._text: dict[int, np.ndarray] = {}

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        result = np.empty((len(self._channels), stop - start))
        begin = 0
        for hit, end in enumerate(self._ends):
            a, b = max(start, begin), min(stop, int(end))
            if a < b:
                for row, records in enumerate(self._channels):
                    result[row, a - start : b - start] = self._part(records[hit], a - begin, b - begin)
            begin = int(end)
        result *= np.array(self._scales)[:, np.newaxis]
        return result

    def blocks(self, progress: Progress) -> Iterator[np.ndarray]:
        """All samples in order, in blocks."""
        rows = int(self._ends[-1])
        for start in range(0, rows, _BLOCK):
            yield self.read_block(start, min(start + _BLOCK, rows))
            progress(min((start + _BLOCK) / rows, 1.0), "reading")

    def _part(self, record: Function, start: int, stop: int) -> np.ndarray:
        if record.binary is not None:
            return record.values(start, stop)
        if record.number not in self._text:
            self._text[record.number] = record.values()
        return self._text[record.number][start:stop]
