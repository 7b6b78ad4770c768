"""What the report tells beside its results: warnings to look into and notes of what was done, each message once."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from millcal.data import CutForce, CutVibration, Notice
from millcal.report.wording import cut_names

LEVELS = ("warning", "note")


@dataclass(frozen=True)
class Told:
    """A message and all the places that it is about."""

    code: str
    message: str
    places: tuple[str, ...]


def grouped(summary: Mapping[str, Any], records: Iterable[Any], level: str) -> list[Told]:
    """The notices of a level, those of the summary first; a message that several places share stands once."""
    records = [record for record in records if record is not None]
    notices = [notice for notice in _all(summary, records) if notice.level == level]
    shown = _places(summary, records)
    places: dict[tuple[str, str], dict[str, None]] = {}  # of each message, in order and once
    for notice in notices:
        where = places.setdefault((notice.code, notice.message), {})
        if notice.where:
            where[shown.get(notice.where, notice.where)] = None
    return [Told(code, message, tuple(where)) for (code, message), where in places.items()]


def _all(summary: Mapping[str, Any], records: Sequence[Any]) -> list[Notice]:
    told = [
        Notice(str(entry.get("code", "")), str(entry.get("message", "")), str(entry.get("where", "")), level)
        for level in LEVELS
        for entry in summary.get(f"{level}s") or ()
    ]
    return told + [notice for record in records for notice in record.notices]


def _places(summary: Mapping[str, Any], records: Sequence[Any]) -> dict[str, str]:
    """What a place is called here: a cut as in the tables, any other file without its folder."""
    entries = summary.get("recordings") or ()
    files = {str(entry[key]): entry.get("kind") for entry in entries for key in ("name", "path") if entry.get(key)}
    names = cut_names([record.name for record in records if isinstance(record, (CutForce, CutVibration))])
    of_cuts = {PurePath(name).name: short for name, short in names.items()}
    shown = {}
    for file, kind in files.items():
        last = PurePath(file).name
        shown[file] = of_cuts.get(last, last) if kind == "cut" else last
    return {**shown, **names}
