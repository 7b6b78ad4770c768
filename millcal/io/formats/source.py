"""What every format hands over: named columns, the units as the file states them, and the numbers in blocks.

A format knows its file and nothing else. Units, axes, signs, the time base and missing cells are the same question for
every format and are settled above, in `millcal.io.channels` and `millcal.io.recordings`; so a new format is one file
with two functions, `sniff(path, head) -> bool` and `open_source(path, setup) -> Source`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from millcal.data import Notice

Progress = Callable[[float, str], None]  # share done in 0..1, what is being done


def silent(share: float, label: str) -> None:
    """The progress of nobody who watches."""


@dataclass(frozen=True)
class Column:
    """One column of numbers as the file describes it; None is what the file does not say."""

    name: str
    unit: str | None = None  # as written
    written: str = ""  # the whole header cell: "Fx [N]"
    quantity: str | None = None  # "time" marks the time column
    dof: str | None = None
    full_scale: float | None = None  # in `unit`
    acts_on: str | None = None
    role: str | None = None  # hammer, response
    delay: float | None = None  # s


@dataclass(frozen=True)
class Source:
    """An opened file: what it says of itself, and its numbers."""

    path: Path
    format: str
    columns: tuple[Column, ...]
    blocks: Callable[[Progress], Iterator[np.ndarray]]  # (column, n) in the file's units, in order, NaN where blank
    rows: int | None = None  # where known without reading
    read_block: Callable[[int, int], np.ndarray] | None = None  # (column, stop - start), where any part can be read
    read_rows: Callable[[int, int, Sequence[int]], np.ndarray] | None = None  # the same of some columns
    sample_rate: float | None = None  # Hz, as the file states it
    attributes: Mapping[str, Any] = field(default_factory=dict)  # the contract's keys
    segments: np.ndarray | None = None
    place: Callable[[int], str] = lambda row: f"row {row + 1}"  # where a row stands in the file
    notices: list[Notice] = field(default_factory=list)  # grows while the blocks are read
    details: Mapping[str, Any] = field(default_factory=dict)  # what else `inspect` should show
    missing: tuple[str, ...] = ()  # what must be stated before it can be read
    trusted: bool = False  # our own layout: a constant channel may be meant
