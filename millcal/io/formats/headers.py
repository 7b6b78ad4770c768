"""Names and units from the cells of a header: `Fx [N]`, `Fx (N)`, `Fx/N`, `Fx in N`, `force_N`, and a row of units.

A unit is taken only where the file says one. What stands in brackets and is no unit we know stays visible, so that the
error can name it.
"""

import re

from millcal.io.formats.time_base import time_unit
from millcal.units import FILE_UNITS, normal_unit

# Units of things that are no channel of a recording; their columns are left out with a word, not refused.
OTHER_UNITS = {"nm", "n.m", "n*m", "n·m", "nmm", "n.mm", "degc", "°c", "℃", "a", "w", "kw", "rpm", "1/min", "%", "bar"}
_SENSOR_UNITS = {"uv", "µv", "pc", "nc"}  # with a sensitivity they become something
_TIME_NAME = re.compile(
    r"(actual|elapsed|relative|abs\w*)?[ _]?(time|zeit|temps|tiempo|tempo|时间|時間)([ _]?(stamp|axis|\d))?|t|x[ _]?value",
    re.IGNORECASE,
)
_BRACKETS = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|（(?P<wide>[^）]*)）)\s*")
_WORD_IN = re.compile(r"(?P<name>.+?)\s+in\s+(?P<unit>\S+)")
# Endings after an underscore, as keys have them; "1" is not among them because of names like ch_1.
_ENDINGS = {
    "m_s2": "m/s^2", "m_per_s2": "m/s^2", "mm_s2": "mm/s^2", "m_s": "m/s", "mm_s": "mm/s",
    **{unit: unit for unit in ("N", "kN", "mN", "lbf", "g", "m", "mm", "um", "rad", "deg", "V", "mV", "Pa")},
    **{unit: unit for unit in ("s", "ms", "us")},
}  # fmt: skip


def is_unit(text: str) -> bool:
    """Whether a text is a unit that files use, of a channel, of time, or of something else."""
    bare = text.strip().strip("[]()").strip()
    return bare != "" and (
        normal_unit(bare) in FILE_UNITS
        or time_unit(bare) is not None
        or bare.lower() in OTHER_UNITS
        or bare.lower() in _SENSOR_UNITS
    )


def is_time(name: str, unit: str | None) -> bool:
    """Whether a column is the time, by its name or by its unit."""
    return time_unit(unit) is not None or (unit is None and _TIME_NAME.fullmatch(name.strip()) is not None)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """The name and, where the header cell states one, the unit as written.

    >>> name_and_unit("Fx [N]"), name_and_unit("ax/m/s²"), name_and_unit("acc_tipX_m_s2"), name_and_unit("Fx")
    (('Fx', 'N'), ('ax', 'm/s²'), ('acc_tipX', 'm/s^2'), ('Fx', None))
    """
    cell = cell.strip().strip("'\"").strip()
    if is_unit(cell):
        return cell, None
    found = _BRACKETS.fullmatch(cell)
    if found:
        unit = next(part for part in (found["square"], found["round"], found["wide"]) if part is not None).strip()
        # Square brackets hold units; round ones may hold a remark, which then belongs to the name.
        if found["name"] and (is_unit(unit) or (found["square"] is not None and unit)):
            return found["name"], unit
        return (found["name"], None) if found["name"] and not unit else (cell, None)
    found = _WORD_IN.fullmatch(cell)
    if found and is_unit(found["unit"]):
        return found["name"], found["unit"]
    name, slash, unit = cell.partition("/")
    if slash and name.strip() and is_unit(unit):
        return name.strip(), unit.strip()
    endings = [ending for ending in _ENDINGS if cell.endswith("_" + ending) and len(cell) > len(ending) + 1]
    if endings:
        ending = max(endings, key=len)
        return cell[: -len(ending) - 1], _ENDINGS[ending]
    return cell, None


def is_units_row(cells: list[str]) -> bool:
    """Whether a row under the header is one of units: known ones in at least half of its written cells."""
    written = [cell for cell in cells if cell.strip().strip("[]()-")]
    return bool(written) and sum(is_unit(cell) for cell in written) * 2 >= len(written)


def unique_names(names: list[str]) -> tuple[list[str], list[str]]:
    """Names made different by a number, and those that were not: Fx, Fx -> Fx, Fx_2."""
    seen: dict[str, int] = {}
    result, repeated = [], []
    for number, name in enumerate(names, start=1):
        name = name or f"col{number}"
        seen[name] = seen.get(name, 0) + 1
        if seen[name] > 1:
            repeated.append(name)
            name = f"{name}_{seen[name]}"
        result.append(name)
    return result, repeated
