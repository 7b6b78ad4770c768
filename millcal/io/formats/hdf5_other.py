"""Any other HDF5 file, by the paths that a setup names.

    [hdf5]
    sample_rate = "run1@fs"              # attribute `fs` of `run1`, or the path of a scalar dataset, in Hz
    time = "run1/time"                   # instead of a rate: a dataset of times in s
    attributes.spindle_speed_rpm = "run1@rpm"   # keys of the cut, by the path of their values

    [channels.fx]
    dataset = "run1/forces"              # 1-D, or 2-D with `number`, or a table of named fields with `column`
    number = 0                           # column of a 2-D dataset (or row, where there are fewer rows than columns)
    unit = "N"                           # else the dataset's own attribute `unit` or `units`

Without such a table `inspect` lists what the file holds, so that the table can be written.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from millcal.errors import RecordingError
from millcal.io.formats.hdf5 import (
    BLOCK,
    SIGNATURE,
    check_dataset,
    number_of,
    opened,
    plain,
    text_of,
)
from millcal.io.formats.source import Column, Progress, Source
from millcal.io.keys import ChannelTable, Hdf5Table

RESULT = "millcal-result"
_MOST_LISTED = 200
_STATE = "name the datasets in a setup ([hdf5] sample_rate, [channels.fx] dataset) and pass it with --setup"


def sniff(path: Path, head: bytes) -> bool:
    """Any HDF5 file; asked after our own."""
    return head.startswith(SIGNATURE)


def open_source(path: Path, setup: Any = None) -> Source:
    """Open an HDF5 file by the datasets that `[channels]` of the setup names."""
    tables: Mapping[str, ChannelTable] = getattr(setup, "channels", None) or {}
    wanted = {name: table for name, table in tables.items() if table.dataset and table.quantity != "ignore"}
    layout = getattr(setup, "hdf5", None) or Hdf5Table()
    with opened(path) as file:
        listing = _listing(file)
        details = {"datasets": listing}
        if not wanted:
            held = f"HDF5, but no recording of millcal, with {len(listing)} datasets"
            if text_of(file.attrs.get("format", "")) == RESULT:
                held = f"a result of millcal ({text_of(file.attrs.get('record', 'several'))}), and no recording"
            return Source(
                path, "hdf5", (), lambda progress: iter(()), rows=0, details=details, missing=(f"{held}; {_STATE}",)
            )
        pickers, columns = [], []
        for name, table in wanted.items():
            dataset = _at(path, file, table.dataset, f"channels.{name}")
            check_dataset(path, table.dataset, dataset)
            pickers.append(_picker(path, name, table, dataset))
            unit = next(
                (dataset.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in dataset.attrs), None
            )
            columns.append(Column(name, unit=None if unit is None else text_of(unit), written=name))
        if layout.time:
            dataset = _at(path, file, layout.time, "hdf5.time")
            check_dataset(path, layout.time, dataset)
            pickers.append(_picker(path, "time", ChannelTable(dataset=layout.time), dataset))
            columns.append(
                Column("time", unit=text_of(dataset.attrs.get("unit", "s")), written=layout.time, quantity="time")
            )
        lengths = {column.name: length for column, (*_, length) in zip(columns, pickers, strict=True)}
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise RecordingError(f"{path}: channels of unequal lengths ({told}); name datasets of one length")
        rate = _value(path, file, layout.sample_rate, "hdf5.sample_rate") if layout.sample_rate else None
        values = {key: _value(path, file, place, f"hdf5.attributes.{key}") for key, place in layout.attributes.items()}
    rows = next(iter(lengths.values()))

    def read_block(start: int, stop: int) -> np.ndarray:
        with opened(path) as file:
            return np.stack([_picked(file, picker, start, stop) for picker in pickers])

    def blocks(progress: Progress) -> Iterator[np.ndarray]:
        for start in range(0, rows, BLOCK):
            yield read_block(start, min(start + BLOCK, rows))
            progress(min((start + BLOCK) / rows, 1.0), "reading")

    return Source(
        path=path,
        format="hdf5",
        columns=tuple(columns),
        blocks=blocks,
        rows=rows,
        read_block=read_block,
        sample_rate=number_of(rate),
        attributes=values,
        place=lambda row: f"sample {row}",
        details=details,
    )


Picker = tuple[str, str | None, int | None, bool, int]  # dataset, field, column, lies in rows, length


def _picker(path: Path, name: str, table: ChannelTable, dataset: h5py.Dataset) -> Picker:
    """Which part of a dataset a channel is."""
    key = f"channels.{name}"
    part = None
    if dataset.dtype.fields:
        fields = list(dataset.dtype.fields)
        part = table.column or name
        if part not in fields:
            raise RecordingError(
                f"{path}: {key}: '{table.dataset}' is a table of {', '.join(fields)}; name one of them as column"
            )
    shape = dataset.shape
    if len(shape) == 2 and min(shape) == 1:
        return table.dataset, part, 0, shape[0] == 1, max(shape)
    if len(shape) == 2:
        in_rows = shape[0] < shape[1]
        if table.number is None or table.number >= min(shape):
            raise RecordingError(
                f"{path}: {key}: '{table.dataset}' has shape {shape[0]} x {shape[1]}; give number, 0 to {min(shape) - 1}"
            )
        return table.dataset, part, table.number, in_rows, max(shape)
    if len(shape) != 1:
        raise RecordingError(
            f"{path}: {key}: '{table.dataset}' has {len(shape)} axes; name a row or a table of numbers"
        )
    return table.dataset, part, None, False, shape[0]


def _picked(file: h5py.File, picker: Picker, start: int, stop: int) -> np.ndarray:
    name, part, column, in_rows, _ = picker
    dataset = file[name]
    span = slice(start, stop)
    values = dataset[span if column is None else (column, span) if in_rows else (span, column)]
    return np.asarray(values if part is None else values[part], dtype=np.float64)


def _at(path: Path, file: h5py.File, place: str, key: str) -> Any:
    if place not in file:
        names = ", ".join(item["path"] for item in _listing(file)[:12]) or "no dataset"
        raise RecordingError(f"{path}: {key}: no '{place}' in the file; it has {names}")
    return file[place]


def _value(path: Path, file: h5py.File, place: str, key: str) -> Any:
    """The value at 'group/dataset' or 'group@attribute'."""
    holder, at, name = place.partition("@")
    found = _at(path, file, holder or "/", key)
    if not at:
        if not isinstance(found, h5py.Dataset) or found.size != 1:
            raise RecordingError(
                f"{path}: {key}: '{place}' is no single value; name one, or an attribute as group@name"
            )
        return plain(np.asarray(found[()]).reshape(-1)[0])
    if name not in found.attrs:
        names = ", ".join(found.attrs) or "none"
        raise RecordingError(f"{path}: {key}: '{holder or '/'}' has no attribute '{name}'; it has {names}")
    return plain(found.attrs[name])


def _listing(file: h5py.File) -> list[dict[str, Any]]:
    """Path, shape, type and attributes of the datasets."""
    found: list[dict[str, Any]] = []

    def look(name: str, item: Any) -> bool | None:
        if isinstance(item, h5py.Dataset):
            attributes = {key: text_of(value)[:60] for key, value in item.attrs.items()}
            found.append(
                {"path": name, "shape": list(item.shape or ()), "type": str(item.dtype)[:60], "attributes": attributes}
            )
        return True if len(found) >= _MOST_LISTED else None

    file.visititems(look)
    return found
