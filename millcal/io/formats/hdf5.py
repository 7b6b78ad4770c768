"""The recording file of millcal (HDF5, version 1), and reading any HDF5 dataset in blocks.

`/channels/<name>` is one dataset per channel; attributes state unit, quantity, dof, scale, full scale and, in an
impact test, the role of a force that is not the hammer's and the delay of a signal that is behind the others. Samples may be
integer counts (value = stored x scale). Large files are not loaded: any part is read when it is asked for.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from millcal.errors import RecordingError
from millcal.io.formats.source import Column, Progress, Source

FORMAT = "millcal-recording"
VERSION = 1
BLOCK = 1 << 18  # samples at a time
SIGNATURE = b"\x89HDF\r\n\x1a\n"
_FILTERS = {
    305: "lzo", 307: "bzip2", 32000: "lzf", 32001: "blosc", 32004: "lz4", 32008: "bitshuffle", 32013: "zfp",
    32015: "zstd", 32026: "blosc2",
}  # fmt: skip
_TEXTS = ("unit", "quantity", "dof", "acts_on", "role")
_CANNOT_READ = "cut short or damaged; copy the file again"


def sniff(path: Path, head: bytes) -> bool:
    """An HDF5 file that says it is a recording of millcal."""
    if not head.startswith(SIGNATURE):
        return False
    with opened(path) as file:
        return text_of(file.attrs.get("format", "")) == FORMAT


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """The file open for reading; whatever the library says against it becomes one line."""
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError) as problem:
        reason = str(problem).lower()
        if "filter" in reason or "plugin" in reason:
            what = "compressed with a filter that is not installed; run 'pip install hdf5plugin'"
            raise RecordingError(f"{path}: {what}") from None
        raise RecordingError(f"{path}: {_CANNOT_READ}") from None


def open_source(path: Path, setup: Any = None) -> Source:
    """Open a recording file of the contract."""
    with opened(path) as file:
        version = number_of(file.attrs.get("version", VERSION))
        if version is None or version > VERSION:
            raise RecordingError(f"{path}: a recording of a newer version ({version}); update millcal")
        names = _channel_names(path, file)
        datasets = [file["channels"][name] for name in names]
        for name, dataset in zip(names, datasets, strict=True):
            check_dataset(path, f"channels/{name}", dataset)
            if dataset.ndim != 1:
                raise RecordingError(f"{path}: channel '{name}' has shape {dataset.shape}; store one row of samples")
        lengths = {name: dataset.shape[0] for name, dataset in zip(names, datasets, strict=True)}
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise RecordingError(f"{path}: channels of unequal lengths ({told}); write the recording again")
        scales = [_scale(path, name, dataset) for name, dataset in zip(names, datasets, strict=True)]
        columns = tuple(_column(name, dataset) for name, dataset in zip(names, datasets, strict=True))
        rows = next(iter(lengths.values()))
        segments = _segments(path, file, rows)
        attributes = {key: plain(value) for key, value in file.attrs.items()}
        rate = number_of(file.attrs.get("sample_rate_hz"))
    paths = [(f"channels/{name}", None, None) for name in names]
    read_block = reader(path, paths, scales)
    return Source(
        path=path,
        format="millcal-recording",
        columns=columns,
        blocks=lambda progress: blocks_of(read_block, rows, progress),
        rows=rows,
        read_block=read_block,
        read_rows=read_block,
        sample_rate=rate,
        attributes=attributes,
        segments=segments,
        place=lambda row: f"sample {row}",
        trusted=True,
        details={"kind": attributes.get("kind", "cut"), "segments": 0 if segments is None else len(segments)},
    )


Where = tuple[str, str | None, int | None]  # dataset, field of a compound type, column of a table


def reader(path: Path, places: Sequence[Where], scales: Sequence[float]) -> Callable[..., np.ndarray]:
    """A function that reads samples start..stop of several datasets, or of some of them, scaled.

    returns (channel, stop - start)
    """

    def read_block(start: int, stop: int, rows: Sequence[int] | None = None) -> np.ndarray:
        wanted = range(len(places)) if rows is None else rows
        with opened(path) as file:
            result = np.empty((len(wanted), stop - start))
            for row, of in enumerate(wanted):
                (name, part, column), scale = places[of], scales[of]
                dataset = file[name]
                values = dataset[start:stop] if column is None else dataset[start:stop, column]
                result[row] = values if part is None else values[part]
                result[row] *= scale
            return result

    return read_block


def blocks_of(read_block: Callable[[int, int], np.ndarray], rows: int, progress: Progress) -> Iterator[np.ndarray]:
    """All samples in order, in blocks."""
    for start in range(0, rows, BLOCK):
        yield read_block(start, min(start + BLOCK, rows))
        progress(min((start + BLOCK) / rows, 1.0), "reading")


def check_dataset(path: Path, name: str, dataset: Any) -> None:
    """Refuse what is no array of numbers, or what cannot be decompressed here."""
    if not isinstance(dataset, h5py.Dataset):
        raise RecordingError(f"{path}: '{name}' is no dataset; name one with numbers")
    kinds = dataset.dtype.fields.values() if dataset.dtype.fields else [(dataset.dtype,)]
    if not any(kind[0].kind in "iufb" for kind in kinds):
        raise RecordingError(f"{path}: '{name}' holds no numbers; name another dataset, or write the recording again")
    properties = dataset.id.get_create_plist()
    for i in range(properties.get_nfilters()):
        code = properties.get_filter(i)[0]
        if h5py.h5z.filter_avail(code):
            continue
        with suppress(ImportError):
            import hdf5plugin  # noqa: F401  registers its filters
        if not h5py.h5z.filter_avail(code):
            filter_name = _FILTERS.get(code, f"number {code}")
            raise RecordingError(
                f"{path}: '{name}' is compressed with the filter {filter_name}, which is not installed; "
                "run 'pip install hdf5plugin', or store it with gzip"
            )


def _channel_names(path: Path, file: h5py.File) -> list[str]:
    """Channels in the order of `channel_order`, else of creation, else of the alphabet."""
    group = file.get("channels")
    if not isinstance(group, h5py.Group) or not len(group):
        raise RecordingError(f"{path}: a recording without channels; write it again")
    if "channel_order" in file.attrs:
        order = [text_of(name) for name in np.atleast_1d(file.attrs["channel_order"])]
        if sorted(order) != sorted(group):
            raise RecordingError(
                f"{path}: channel_order names {', '.join(order)} and the file has {', '.join(group)}; correct it"
            )
        return order
    try:
        names: list[str] = []
        group.id.links.iterate(lambda name: names.append(name.decode()), idx_type=h5py.h5.INDEX_CRT_ORDER)
        return names
    except (RuntimeError, ValueError):  # the order of creation was not kept
        return sorted(group)


def _column(name: str, dataset: h5py.Dataset) -> Column:
    attributes = {key: plain(value) for key, value in dataset.attrs.items()}
    text = {key: str(attributes[key]) if key in attributes else None for key in _TEXTS}
    numbers = {"full_scale": number_of(attributes.get("full_scale")), "delay": number_of(attributes.get("delay_s"))}
    return Column(name, **text, written=name, **numbers)


def _scale(path: Path, name: str, dataset: h5py.Dataset) -> float:
    scale = number_of(dataset.attrs.get("scale", 1.0))
    if scale is None or not np.isfinite(scale) or scale == 0:
        raise RecordingError(f"{path}: channel '{name}': scale is no number that counts can be multiplied with; set it")
    return scale


def _segments(path: Path, file: h5py.File, rows: int) -> np.ndarray | None:
    """Start and length of the pre-cut records, within the samples and in order."""
    if "segments" not in file:
        return None
    check_dataset(path, "segments", file["segments"])
    segments = np.asarray(file["segments"][()])
    mending = "write (start, length) of each record, in samples"
    if segments.ndim != 2 or segments.shape[1] != 2 or segments.dtype.kind not in "iu":
        raise RecordingError(f"{path}: segments have shape {segments.shape} and type {segments.dtype}; {mending}")
    segments = segments.astype(np.int64)
    bad = (segments[:, 0] < 0) | (segments[:, 1] <= 0) | (segments.sum(axis=1) > rows)
    if bad.any() or not len(segments):
        which = f"segment {int(np.argmax(bad))} is outside the {rows} samples" if bad.any() else "no segments are given"
        raise RecordingError(f"{path}: {which}; {mending}")
    return segments


def text_of(value: Any) -> str:
    """An attribute as text."""
    value = plain(value)
    return value if isinstance(value, str) else str(value)


def number_of(value: Any) -> float | None:
    """An attribute as a number, None where it is none."""
    if value is None:
        return None
    try:
        return float(np.asarray(plain(value)).reshape(-1)[0])
    except (TypeError, ValueError, IndexError):
        return None


def plain(value: Any) -> Any:
    """An attribute's value as Python's own: numbers, text, lists of them."""
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace")
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()] if value.ndim else plain(value.item())
    return value.item() if isinstance(value, np.generic) else value
