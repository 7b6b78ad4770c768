"""Results on disk: any record of `data.py` to and from one HDF5 file, by the metadata of its fields.

An array is a dataset of the field's name with attributes `unit` and `axes`; text, numbers and plain tuples of them are
attributes; a nested record is a group, several of them are numbered groups; everything else (notices, hits, the cutter)
is a JSON attribute. What is None is absent. The FRF file of the contract falls out of this rule.

The bytes depend on the record alone: no clock, no order of a set. A file is written under a temporary name in the same
folder, flushed and renamed, so that a killed run leaves the old result or the new one, never half of one.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import h5py
import numpy as np
from pydantic import TypeAdapter, ValidationError

from millcal.data import Frf, Record
from millcal.errors import RecordingError
from millcal.io.replacing import replaced_atomically

FORMAT = "millcal-result"
VERSION = 1
_COMPRESS_ABOVE = 1 << 16  # bytes; a small dataset is smaller without chunks

R = TypeVar("R", bound=Record)


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text file in UTF-8 with the line ends it has, whole or not at all."""
    with replaced_atomically(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def write_result(path: Path, record: Record, *, provenance: dict) -> None:
    """Write one record to an HDF5 file."""
    with _new_file(path, provenance) as file:
        _write_record(file, record)


def write_results(path: Path, records: Sequence[Record], *, provenance: dict) -> None:
    """Write several records of one type to an HDF5 file, as groups 0000, 0001, ..."""
    with _new_file(path, provenance) as file:
        file.attrs["records"] = type(records[0]).__name__
        _write_many(file, records)


def read_result(path: Path, record_type: type[R] | tuple[type[R], ...]) -> R:
    """Read back the record of a file that `write_result` made; a plain FRF file of the contract will do as an `Frf`.

    record_type : of several types that will do, the one that the file says it holds
    """
    with _opened(path) as file:
        return _read_record(file, _kind_held(path, file, "record", record_type))


def read_results(path: Path, record_type: type[R] | tuple[type[R], ...]) -> tuple[R, ...]:
    """Read back the records of a file that `write_results` made.   record_type : as of `read_result`"""
    with _opened(path) as file:
        return _read_many(file, _kind_held(path, file, "records", record_type))


def read_provenance(path: Path) -> dict:
    """The provenance a result was written with; empty for a file that carries none."""
    with _opened(path) as file:
        return json.loads(_text(file.attrs.get("provenance", "{}")))


@contextmanager
def _new_file(path: Path, provenance: dict) -> Iterator[h5py.File]:
    with replaced_atomically(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        file.attrs["provenance"] = json.dumps(provenance, sort_keys=True, ensure_ascii=False)
        yield file


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The file open for reading; whatever is wrong with it becomes one error that names it."""
    if not Path(path).is_file():
        raise RecordingError(f"{path}: no such file; check the path, or make the result first")
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise RecordingError(f"{path}: no HDF5 file, or one cut short; make the result again") from None
    with file:
        try:
            yield file
        except (OSError, KeyError, ValueError, TypeError, RuntimeError, ValidationError) as problem:
            reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
            raise RecordingError(f"{path}: damaged result ({reason}); make the result again") from None


def _kind_held(path: Path, file: h5py.File, attribute: str, record_type: type[R] | tuple[type[R], ...]) -> type[R]:
    """Which of the types that will do a file holds."""
    types = record_type if isinstance(record_type, tuple) else (record_type,)
    held = _text(file.attrs.get(attribute, ""))
    kind = next((one for one in types if one.__name__ == held), types[0])
    _check_kind(path, file, attribute, kind, types)
    return kind


def _check_kind(
    path: Path, file: h5py.File, attribute: str, record_type: type[Record], any_of: Sequence[type[Record]] = ()
) -> None:
    found = _text(file.attrs.get("format", ""))
    kind = _text(file.attrs.get(attribute, ""))
    wanted = record_type.__name__
    if found == FORMAT and kind == wanted and int(file.attrs.get("version", 0)) <= VERSION:
        return
    if record_type is Frf and not found and {"frequency", "values"} <= set(file):
        return
    if found == FORMAT and int(file.attrs.get("version", 0)) > VERSION:
        raise RecordingError(f"{path}: written by a newer millcal; update millcal to read it")
    held = kind or _text(file.attrs.get("records", file.attrs.get("record", ""))) or found or "no result of millcal"
    needed = " or ".join(one.__name__ for one in any_of) or wanted
    raise RecordingError(f"{path}: holds {held} where {needed} is needed; {_MAKERS.get(wanted, 'give another file')}")


_MAKERS = {
    "Frf": "make one with 'millcal frf'",
    "Coefficients": "make them with 'millcal identify'",
    "CoefficientHistory": "make one with 'millcal identify --method smooth'",
    "StabilityMap": "make one with 'millcal stability'",
    "CutForce": "make them with 'millcal fit'",
    "CutVibration": "make them with 'millcal fit'",
    "ForceHarmonics": "make them with 'millcal forces'",
    "Judgement": "make one with 'millcal judge'",
    "SpeedAdvice": "make one with 'millcal forces --advise'",
    "Modes": "make them with 'millcal modes'",
}


def _write_record(group: h5py.Group, record: Record) -> None:
    group.attrs["record"] = type(record).__name__
    hints = _hints(type(record))
    for field in fields(record):  # type: ignore[arg-type]
        value, hint = getattr(record, field.name), _without_none(hints[field.name])
        if value is None:
            continue
        if "dims" in field.metadata:
            _write_array(group, field, np.asarray(value))
        elif _is_record(hint):
            _write_record(group.create_group(field.name), value)
        elif _is_record(_item_of(hint)):
            _write_many(group.create_group(field.name), value)
        elif _is_plain(hint):
            group.attrs[field.name] = value
        elif _is_plain(_item_of(hint)):
            dtype = h5py.string_dtype() if _item_of(hint) is str else _item_of(hint)
            group.attrs.create(field.name, list(value), dtype=dtype, shape=(len(value),))
        else:
            tree = TypeAdapter(hints[field.name]).dump_python(value)
            group.attrs[field.name] = json.dumps(tree, ensure_ascii=False, default=lambda x: x.tolist())


def _write_many(group: h5py.Group, records: Sequence[Record]) -> None:
    for number, record in enumerate(records):
        _write_record(group.create_group(f"{number:04d}"), record)


def _write_array(group: h5py.Group, field: Field, value: np.ndarray) -> None:
    options: dict[str, Any] = {}
    if value.nbytes > _COMPRESS_ABOVE:
        options = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    dataset = group.create_dataset(field.name, data=value, track_times=False, **options)
    dataset.attrs["unit"] = field.metadata["unit"]
    dataset.attrs.create("axes", list(field.metadata["dims"]), dtype=h5py.string_dtype())


def _read_record(group: h5py.Group, record_type: type[R]) -> R:
    hints = _hints(record_type)
    values = {}
    for field in fields(record_type):  # type: ignore[arg-type]
        hint = _without_none(hints[field.name])
        stored = group if "dims" in field.metadata or _is_record(hint) or _is_record(_item_of(hint)) else group.attrs
        if field.name not in stored:
            values[field.name] = _absent(group, record_type, field, hints[field.name])
        elif "dims" in field.metadata:
            values[field.name] = group[field.name][()]
        elif _is_record(hint):
            values[field.name] = _read_record(group[field.name], hint)
        elif _is_record(_item_of(hint)):
            values[field.name] = _read_many(group[field.name], _item_of(hint))
        elif _is_plain(hint):
            value = group.attrs[field.name]
            values[field.name] = _text(value) if isinstance(value, (str, bytes)) else np.asarray(value).item()
        elif _is_plain(_item_of(hint)):
            values[field.name] = tuple(
                _text(item) if isinstance(item, (str, bytes)) else item
                for item in np.atleast_1d(group.attrs[field.name]).tolist()
            )
        else:
            tree = json.loads(_text(group.attrs[field.name]))
            values[field.name] = TypeAdapter(hints[field.name]).validate_python(tree)
    return record_type(**values)


def _read_many(group: h5py.Group, record_type: type[R]) -> tuple[R, ...]:
    return tuple(_read_record(group[name], record_type) for name in sorted(group))


def _absent(group: h5py.Group, record_type: type[Record], field: Field, hint: Any) -> Any:
    """What an absent field stands for: None or its default; in an FRF of another program, what can be taken for it."""
    if field.default is not MISSING:
        return field.default
    if NoneType in get_args(hint):
        return None
    if record_type is Frf and field.name == "usable_band":
        return float(group["frequency"][0]), float(group["frequency"][-1])
    if record_type is Frf and field.name == "hits_used":
        return (0,) * group["values"].shape[2]
    if record_type is Frf and field.name == "estimator":
        return "unknown"
    raise KeyError(f"{field.name} is missing")


@cache
def _hints(record_type: type) -> dict[str, Any]:
    return get_type_hints(record_type)


def _without_none(hint: Any) -> Any:
    """The type that stands beside None: `float | None` -> float."""
    if get_origin(hint) in (Union, UnionType):
        left = [item for item in get_args(hint) if item is not NoneType]
        return left[0] if len(left) == 1 else hint
    return hint


def _item_of(hint: Any) -> Any:
    """The one type of all items of a tuple, or None: `tuple[str, ...]` -> str, `tuple[int, int]` -> int."""
    items = {item for item in get_args(hint) if item is not Ellipsis}
    return items.pop() if get_origin(hint) is tuple and len(items) == 1 else None


def _is_plain(hint: Any) -> bool:
    return hint in (str, int, float, bool) or get_origin(hint) is Literal


def _is_record(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Record)


def _text(value: Any) -> str:
    return value.decode("utf-8") if isinstance(value, bytes) else str(value)
