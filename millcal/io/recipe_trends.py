"""The keys of `[[simulate.cuts]]` that let coefficients change while cutting: `drift`, `drift_rise`, `drift_edge`, `chip`."""

from itertools import pairwise
from typing import Annotated, Any

from pydantic import Field, PlainValidator, WithJsonSchema, field_validator

from millcal.io.keys import Positive, Table
from millcal.physics.changing_coefficients import STEADY, Chip, Points, Trend

DIRECTIONS = ("t", "r", "a")
_WRITE = "write a share such as 0.2, points [[t_s, factor], ...], or {t = ..., r = ..., a = ...} of them"
_NUMBER = {"type": "number"}
_POINTS = {"type": "array", "minItems": 2, "items": {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}}
_COURSE = {"anyOf": [_NUMBER, _POINTS]}
_SCHEMA = {
    "anyOf": [
        *_COURSE["anyOf"],
        {"type": "object", "properties": dict.fromkeys(DIRECTIONS, _COURSE), "additionalProperties": False},
    ]
}


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _course(value: Any) -> float | Points:
    """A share by which something rises linearly over the cut, or points of time and factor."""
    if _is_number(value):
        if not value > -1:
            raise ValueError(f"{value:g} takes away all of a coefficient and more; write a share above -1")
        return float(value)
    if not isinstance(value, (list, tuple)) or len(value) < 2:
        raise ValueError(f"is no course; {_WRITE}")
    if not all(isinstance(p, (list, tuple)) and len(p) == 2 and all(map(_is_number, p)) for p in value):
        raise ValueError(f"holds something else than points; {_WRITE}")
    times, factors = zip(*value, strict=True)
    if any(later < earlier for earlier, later in pairwise(times)):
        raise ValueError("has points that go back in time; put them in order")
    if min(factors) <= 0:
        raise ValueError(f"has a factor of {min(factors):g}; a factor is above 0, and 1 is no change")
    return tuple((float(time), float(factor)) for time, factor in value)


def _of_directions(value: Any) -> tuple[Any, Any, Any]:
    """One course for all directions, or a table of them; what a table leaves out stays as it is."""
    if not isinstance(value, dict):
        course = _course(value)
        return course, course, course
    unknown = sorted(set(value) - set(DIRECTIONS))
    if unknown:
        raise ValueError(f"speaks of a direction {unknown[0]!r}; known are t, r and a")
    return tuple(_course(value.get(direction, 0.0)) for direction in DIRECTIONS)  # type: ignore[return-value]


def _sizes(value: Any) -> tuple[float, float, float]:
    """One size for all directions, or a table of them."""
    sizes = value if isinstance(value, dict) else dict.fromkeys(DIRECTIONS, value)
    unknown = sorted(set(sizes) - set(DIRECTIONS))
    if unknown or not all(_is_number(size) and size > -1 for size in sizes.values()):
        raise ValueError("is no size; write a share such as 0.12, or {t = 0.12, r = 0.2, a = 0.1}")
    return tuple(float(sizes.get(direction, 0.0)) for direction in DIRECTIONS)  # type: ignore[return-value]


Courses = Annotated[Any, PlainValidator(_of_directions), WithJsonSchema(_SCHEMA)]
Sizes = Annotated[
    Any,
    PlainValidator(_sizes),
    WithJsonSchema(
        {
            "anyOf": [
                _NUMBER,
                {"type": "object", "properties": dict.fromkeys(DIRECTIONS, _NUMBER), "additionalProperties": False},
            ]
        }
    ),
]


class ChipTable(Table):
    """A piece of the edge breaks off."""

    time_s: Positive = Field(description="when, s after the first sample")
    size: Sizes = Field(description="share by which the specific forces rise, such as 0.12, or {t = 0.12, r = 0.2}")


class TrendKeys(Table):
    """Coefficients that change while cutting; without these keys they do not."""

    drift: Courses | None = Field(
        None,
        description="share by which the coefficients rise linearly over the steady cut, or points [[t_s, factor], ...]",
    )
    drift_rise: Courses | None = Field(None, description="the same for the rises mt, mr, ma of Kienzle's law")
    drift_edge: Courses | None = Field(
        None, description="the same for the edge coefficients of the linear-edge law, beside `drift`"
    )
    chip: Annotated[tuple[ChipTable, ...], Field(strict=False)] = Field(
        (), description="broken edge, {time_s = 3.6, size = 0.12}, or a list of them"
    )

    @field_validator("chip", mode="before")
    @classmethod
    def _one_or_more(cls, value: Any) -> Any:
        return (value,) if isinstance(value, dict) else value

    def trend(self, steady: tuple[float, float]) -> Trend | None:
        """What changes, None where nothing does.   steady : s, over which a share rises"""
        shape = self.drift_rise or self.drift_edge
        if self.drift is None and shape is None and not self.chip:
            return None
        chips = tuple(Chip(chip.time_s, chip.size) for chip in self.chip)
        return Trend(_points(self.drift, steady), _points(shape, steady), chips)


def _points(courses: tuple[Any, Any, Any] | None, steady: tuple[float, float]) -> tuple[Points, Points, Points]:
    begin, end = steady
    return tuple(  # type: ignore[return-value]
        ((begin, 1.0), (end, 1.0 + course)) if isinstance(course, float) else course
        for course in courses or (STEADY, STEADY, STEADY)
    )
