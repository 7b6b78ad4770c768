"""What each study of `millcal study` leaves behind: one file each, imported when it is asked for.

A file has FILES, the names that it writes, and `make(quick, seed, progress)`, which runs the study and lays out what was found.
"""

import importlib
from collections.abc import Callable
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

Progress = Callable[[float, str], None]


class Name(StrEnum):
    """The studies there are."""

    trending_coefficients = "trending-coefficients"
    forces_from_accelerations = "forces-from-accelerations"


class Made(NamedTuple):
    """A study laid out: the result for JSON, the same in words, and every file but summary.json."""

    summary: dict[str, Any]
    text: str
    files: dict[str, str | bytes]


class StudyFile(Protocol):
    """What a file of this folder holds."""

    FILES: tuple[str, ...]

    def make(self, quick: bool, seed: int, progress: Progress) -> Made:
        """Run the study."""


def study_file(name: Name) -> StudyFile:
    """The file of a study."""
    found: Any = importlib.import_module(f"millcal.cli.studies.{name.name}")
    return found  # type: ignore[no-any-return]


def names_of(tables: tuple[str, ...], figures: tuple[str, ...]) -> tuple[str, ...]:
    """All that a study writes: its summary, its tables, and its figures for a screen and for print."""
    drawn = [f"{name}.{format}" for name in figures for format in FORMATS]
    return ("summary.json", *tables, *drawn)


FORMATS = ("png", "svg")


def figure_files(figures: dict[str, Any]) -> dict[str, bytes]:
    """Figures as files; to be called within the sheet's style.   figures : by name"""
    from millcal.report.paper import sheet

    return {
        f"{name}.{format}": sheet.file_bytes(figure, format) for name, figure in figures.items() for format in FORMATS
    }
