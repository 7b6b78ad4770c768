"""What is in a file: channels, their range, the sample rate, and what must still be stated before it can be read.

A file that holds an FRF and no recording is told by its pairs, each with the range of its magnitude.

Inspecting never fails for a missing unit, a bad rate or a dead channel: it says so under `missing`.
"""

from pathlib import Path
from typing import Any

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.channels import Selection
from millcal.io.formats.source import Progress, Source, silent
from millcal.io.formats.time_base import TimeBase
from millcal.io.frf_files import describe_frf, is_frf_file
from millcal.io.recipes import Setup
from millcal.io.recordings import chosen_channels, open_source, rate_of


def inspect_recording(
    path: Path, *, setup: Setup | None = None, progress: Progress | None = None
) -> tuple[dict[str, Any], tuple[Notice, ...]]:
    """What is in a file, as the contract's JSON, and notices.

    Values are those of the file, in the `unit` of each channel, which is null where the file does not say one; those of an
    FRF are in SI. A setup is for recordings: with one, nothing is taken for an FRF.
    """
    path = Path(path)
    if setup is None and path.is_file() and is_frf_file(path):
        return describe_frf(path)
    setup = setup or Setup()
    source = open_source(path, setup)
    chosen = chosen_channels(source, setup, None, None, None)
    missing = [*source.missing, *(chosen.problems if source.columns else ())]
    clock = None
    if chosen.time is not None and chosen.time_scale is not None:
        clock = TimeBase(path, source.columns[chosen.time].name, source.place)
    statistics = _Statistics(len(source.columns))
    trouble = ""
    for block in source.blocks(progress or silent):
        statistics.add(block)
        if clock is not None and not trouble:
            try:
                clock.add(block[chosen.time] * chosen.time_scale)
            except RecordingError as problem:
                trouble = str(problem)
    rate, notices = setup.sample_rate or source.sample_rate, []
    if clock is not None and statistics.rows and not trouble:
        try:
            rate, notices = rate_of(clock, setup.sample_rate, source.sample_rate)
        except RecordingError as problem:
            trouble = str(problem)
    if trouble:
        rate = setup.sample_rate
        missing.append(trouble.removeprefix(f"{path}: "))
    elif chosen.time is not None and chosen.time_scale is None and rate is None:
        name = source.columns[chosen.time].name
        missing.append(f"the unit of the time column '{name}'; state it with --unit {name}=s (or ms, us)")
    elif rate is None and source.columns:
        missing.append("the sample rate; state it with --rate-hz, or name the time column by its unit: --unit NAME=s")
    time = None if chosen.time is None else source.columns[chosen.time]
    result = {
        "file": str(path),
        "format": source.format,
        "sample_rate_hz": rate,
        "samples": statistics.rows,
        "duration_s": statistics.rows / rate if rate else None,
        "start_time_s": clock.first if clock is not None and statistics.rows else None,
        "time_column": None if time is None else {"name": time.name, "unit": time.unit},
        "channels": _channels(source, chosen, statistics),
        "missing": missing,
        "details": {**source.details, **({"attributes": dict(source.attributes)} if source.attributes else {})},
    }
    return result, (*source.notices, *notices)


class _Statistics:
    """Range, mean and power of columns that pass by in blocks; missing cells are counted apart."""

    def __init__(self, columns: int) -> None:
        self.rows = 0
        self.low, self.high = np.full(columns, np.inf), np.full(columns, -np.inf)
        self.total, self.power = np.zeros(columns), np.zeros(columns)
        self.count = np.zeros(columns, dtype=int)

    def add(self, block: np.ndarray) -> None:
        good = np.isfinite(block)
        known = np.where(good, np.clip(block, -1e150, 1e150), 0.0)
        self.rows += block.shape[1]
        self.count += good.sum(axis=1)
        self.low = np.minimum(self.low, np.where(good, block, np.inf).min(axis=1))
        self.high = np.maximum(self.high, np.where(good, block, -np.inf).max(axis=1))
        self.total += known.sum(axis=1)
        self.power += np.einsum("ij,ij->i", known, known)

    def of(self, i: int) -> dict[str, float | int | None]:
        n = int(self.count[i])
        known = {
            "min": float(self.low[i]),
            "max": float(self.high[i]),
            "mean": float(self.total[i] / max(n, 1)),
            "rms": float(np.sqrt(self.power[i] / max(n, 1))),
        }
        return {**(known if n else dict.fromkeys(known)), "missing_values": self.rows - n}


def _channels(source: Source, chosen: Selection, statistics: _Statistics) -> list[dict[str, Any]]:
    """Every column of numbers but the time; the quantity where the unit tells it."""
    settled = dict(zip(chosen.rows, chosen.channels, strict=True))
    return [
        {
            "name": column.name,
            "quantity": settled[i].quantity if i in settled else column.quantity,
            "unit": column.unit,
            "dof": settled[i].dof if i in settled else column.dof,
            **({"role": settled[i].role} if i in settled and settled[i].role else {}),
            **statistics.of(i),
        }
        for i, column in enumerate(source.columns)
        if i != chosen.time
    ]
