"""A TOML file and its mistakes: each is one line that names file, line and key, and says what to write instead."""

import difflib
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from millcal.errors import RecipeError
from millcal.io.keys import Table
from millcal.io.toml_places import Loc, locate

M = TypeVar("M", bound=Table)


@dataclass(frozen=True)
class Document:
    """A TOML file, and the line of each of its keys."""

    path: Path
    text: str
    data: dict[str, Any]
    places: dict[Loc, int]

    def where(self, loc: Loc) -> str:
        """`recipe.toml:9: cuts.0.air_s`; the line is that of the nearest table above a key that is absent."""
        nearest = loc
        while nearest and nearest not in self.places:
            nearest = nearest[:-1]
        key = f" {'.'.join(map(str, loc))}:" if loc else ""
        return f"{self.path}:{self.places.get(nearest, 1)}:{key}".removesuffix(":")

    def refuse(self, loc: Loc, what: str) -> NoReturn:
        """Refuse a key.   what : `what is wrong; what to do`"""
        raise RecipeError(f"{self.where(loc)}: {what}")


def read_toml(path: Path) -> Document:
    """Read a TOML file; what is wrong with it is one line with the number of the line."""
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as problem:
        raise RecipeError(f"{path}: {(problem.strerror or str(problem)).lower()}; check the path") from None
    except UnicodeDecodeError as problem:
        line = problem.object.count(b"\n", 0, problem.start) + 1
        raise RecipeError(f"{path}:{line}: not UTF-8; save the file as UTF-8") from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        found = re.fullmatch(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", str(problem), re.DOTALL)
        what, line, column = found.groups() if found else (str(problem), None, None)
        place = f"{path}:{line or text.rstrip().count(chr(10)) + 1}:"
        at = f" at column {column}" if column else ""
        raise RecipeError(f"{place} not TOML{at}: {what[:1].lower() + what[1:]}; correct that line") from None
    return Document(path=path, text=text, data=data, places=locate(text))


def validated(model: type[M], document: Document) -> M:
    """The document as a model; of several mistakes the first unknown key is told, else the first by line."""
    try:
        return model.model_validate(document.data)
    except ValidationError as problem:
        errors = [(_loc_in(document.data, error["loc"]), error) for error in problem.errors()]
    locs = [loc for loc, _ in errors]
    causes = [  # a list that lost a bad item is then too short as well: keep the item's error
        (loc, error) for loc, error in errors if not any(deep[: len(loc)] == loc and deep != loc for deep in locs)
    ]
    loc, error = min(causes, key=lambda item: (item[1]["type"] != "extra_forbidden", _line(document, item[0])))
    document.refuse(loc, _told(model, loc, error))


def _line(document: Document, loc: Loc) -> int:
    while loc and loc not in document.places:
        loc = loc[:-1]
    return document.places.get(loc, 0)


def _loc_in(data: Any, loc: Loc) -> Loc:
    """The part of pydantic's location that is in the data, and a missing last key: no names of unions or validators."""
    path: list[str | int] = []
    for part in loc:
        in_table = isinstance(data, dict) and part in data
        if in_table or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]
            path.append(part)
        elif isinstance(data, dict) and part == loc[-1]:
            path.append(part)
    return tuple(path)


def _told(model: type[Table], loc: Loc, error: Any) -> str:
    """One mistake in words: what is wrong; what to do."""
    table, field_info = _model_at(model, loc)
    description = field_info.description if field_info else ""
    give = f"give {description}" if description else "correct it"
    value = error.get("input")
    shown = f"{value!r}" if isinstance(value, (str, int, float, bool)) else "this"
    kind, context = error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key; {_suggestion(str(loc[-1]), table)}"
    if kind == "missing":
        return f"{'has too few items' if isinstance(error['loc'][-1], int) else 'is missing'}; {give}"
    if kind == "value_error":
        return str(context["error"])
    if kind == "literal_error":
        return f"{shown} is not {context['expected']}; {give}"
    words = {
        "float_type": "is no number",
        "int_type": "is no whole number",
        "bool_type": "is neither true nor false",
        "string_type": "is no text",
        "finite_number": "is not finite",
        "greater_than": f"is not above {context.get('gt')}",
        "greater_than_equal": f"is below {context.get('ge')}",
        "less_than": f"is not below {context.get('lt')}",
        "less_than_equal": f"is above {context.get('le')}",
        "model_type": "is no table",
        "model_attributes_type": "is no table",
        "dict_type": "is no table",
        "tuple_type": "is no list",
        "list_type": "is no list",
        "too_short": f"has fewer than {context.get('min_length')} items",
        "too_long": f"has more than {context.get('max_length')} items",
    }
    what = words.get(kind, error["msg"][:1].lower() + error["msg"][1:])
    return f"{shown} {what}; {give}" if kind in words else f"{what}; {give}"


def _model_at(model: type[BaseModel], loc: Loc) -> tuple[type[BaseModel], Any]:
    """The model of the table a location is in, and the field it names (None for an unknown key)."""
    info = None
    for part in loc:
        if isinstance(part, str) and part in model.model_fields:
            info = model.model_fields[part]
            deeper = model_in(info.annotation)
            if deeper is not None and part != loc[-1]:
                model = deeper
        elif isinstance(part, str):
            info = None
    return model, info


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The model somewhere in a type: `tuple[CutTable, ...] | None` -> CutTable."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for item in get_args(annotation) if (found := model_in(item))), None)


def _suggestion(key: str, table: type[BaseModel]) -> str:
    """`did you mean ...?`: keys that read alike, or have a word that does; else every key of the table."""
    known = list(table.model_fields)
    alike = difflib.get_close_matches(key, known, n=1, cutoff=0.7)
    if not alike:
        words = {word: name for name in reversed(known) for word in name.split("_") if len(word) > 2}
        parts = [part for part in key.lower().split("_") if len(part) > 2] or [key]
        near = [match for part in parts for match in difflib.get_close_matches(part, words, n=1, cutoff=0.6)]
        alike = [words[near[0]]] if near else []
    return f"did you mean {alike[0]}?" if alike else f"known here: {', '.join(known)}"
