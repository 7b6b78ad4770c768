"""From the columns of a file to the channels of a recording: units, axes, signs, and which column is the time.

Nothing here is guessed. A unit comes from the file or from the user; a column of volts needs its sensitivity; a channel
gets the axis that the map gives it. With a map the recording holds what the map names and nothing else; without one it
holds every column of numbers under its own name.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from millcal.data import Channel, Notice
from millcal.io.formats.headers import OTHER_UNITS, is_time
from millcal.io.formats.source import Column
from millcal.io.formats.time_base import time_unit
from millcal.io.keys import ChannelTable
from millcal.units import FILE_UNITS, normal_unit

TIP_FORCES = {"fx": "tipX", "fy": "tipY", "fz": "tipZ"}  # names of the map whose place and direction are known
QUANTITY_UNITS = {
    "force": "N", "acceleration": "m/s^2", "velocity": "m/s", "displacement": "m", "angle": "rad", "pulse": "1",
    "sound_pressure": "Pa", "sound": "FS",
}  # fmt: skip
_SENSITIVITY = re.compile(
    r"(?:(?P<column>mV|V|uV|µV|pC|nC)\s*[,:]\s*)?(?P<value>[+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*"
    r"(?P<signal>mV|V|uV|µV|pC|nC|FS)\s*/\s*(?P<unit>.+)"
)
_SIGNALS = {
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "uV": ("V", 1e-6),
    "µV": ("V", 1e-6),
    "pC": ("C", 1e-12),
    "nC": ("C", 1e-9),
    "FS": ("FS", 1.0),
}
_DOF_ENDING = re.compile(r"(?:^|.*[_ .])(?P<dof>[A-Za-z]+\d*[XYZ])")
_KNOWN = "N, kN, lbf, m/s^2, g, m/s, um, mm, m, deg, Pa, s for the time, or a sensitivity such as '100 mV/g'"


@dataclass(frozen=True)
class Selection:
    """Which columns become channels, by which factor, and what is still missing."""

    time: int | None  # index of the time column
    time_scale: float | None  # s per unit of the time column; None where its unit is not stated
    rows: tuple[int, ...] = ()  # column of each channel
    gains: np.ndarray = field(default_factory=lambda: np.empty(0))  # SI per unit of the column, with the sign
    channels: tuple[Channel, ...] = ()
    mapping: Mapping[str, str] = field(default_factory=dict)  # channel -> signed column
    problems: tuple[str, ...] = ()  # each `what; mending`
    notices: tuple[Notice, ...] = ()


def choose_channels(
    columns: Sequence[Column],
    *,
    where: str,
    mapping: Mapping[str, str],
    units: Mapping[str, str],
    tables: Mapping[str, ChannelTable],
    acts_on: str | None,
) -> Selection:
    """Settle units, axes and signs of all channels; problems are collected, so that `inspect` can show them all.

    mapping : channel -> signed column, `fx -> +Fy`, `hammer@tipX -> force`   units : column -> unit or sensitivity
    tables : the `[channels]` of a setup   acts_on : tool or workpiece, where the file does not say
    """
    problems: list[str] = []
    notices: list[Notice] = []
    stated = {_column_index(columns, name, problems, "--unit"): unit for name, unit in units.items()}
    stated.pop(None, None)
    time = _time_column(columns, stated, tables)
    wanted = _wanted(columns, time, mapping, tables, problems)
    chosen = []
    for name, dof, sign, row in wanted:
        table = tables.get(name) or ChannelTable()
        column = columns[row]
        if table.quantity in ("ignore", "time"):
            continue
        text = stated.get(row) or table.sensitivity or table.unit or column.unit
        if not mapping and row not in stated and text is not None and text.strip("[]() ").lower() in OTHER_UNITS:
            message = f"column '{column.name}' in {text} is left out: no channel of a recording has that unit"
            notices.append(Notice("columns-left-out", message, where))
            continue
        measured = _gain(column, text, table.quantity or column.quantity, problems)
        if measured is None:
            continue
        quantity, unit, gain = measured
        dof = dof or table.dof or (mapping and TIP_FORCES.get(name)) or column.dof or _dof_of(name)
        if dof.startswith(("-", "+")):
            sign, dof = (-sign if dof[0] == "-" else sign), dof[1:]
        if quantity == "force" and (column.acts_on or acts_on or "tool") == "workpiece":
            sign = -sign
        gain *= (table.scale or 1.0) * sign
        full_scale = table.full_scale if table.full_scale is not None else column.full_scale
        full_scale = None if full_scale is None else abs(full_scale * gain)
        role = table.role or column.role
        if role not in (None, "response") and (role != "hammer" or quantity != "force"):
            problems.append(
                f"channel '{name}': a {quantity} cannot have the role {role!r}; hammer is for a force, or response"
            )
        delay = (column.delay or 0.0) if table.delay_s is None else table.delay_s
        chosen.append((row, gain, Channel(name, quantity, unit, dof, full_scale, role, delay), sign))  # type: ignore[arg-type]
    of_full_scale = [channel.name for row, _, channel, _ in chosen if channel.unit == "FS" and row not in stated]
    if of_full_scale:
        message = (
            f"{', '.join(of_full_scale)}: shares of full scale, since the file does not say how many pascals that is; "
            f'--unit "{of_full_scale[0]}=0.05 FS/Pa" would'
        )
        notices.append(Notice("full-scale", message, where, "note"))
    left_out = [c.name for i, c in enumerate(columns) if i != time and i not in {row for row, *_ in chosen}]
    clocks = [c.name for i, c in enumerate(columns) if i != time and is_time(c.name, c.unit) and c.name in left_out]
    if not mapping and time is not None and clocks:
        message = f"a further time column is left out, one is enough: {', '.join(clocks)}"
        notices.append(Notice("columns-left-out", message, where, "note"))
    if mapping and left_out:
        message = f"columns that the map does not name are left out: {', '.join(left_out)}"
        notices.append(Notice("columns-left-out", message, where, "note"))
    if not chosen and not problems:
        problems.append("no channel besides the time; export the recording again with its channels")
    return Selection(
        time=time,
        time_scale=None if time is None else time_unit(stated.get(time) or columns[time].unit),
        rows=tuple(row for row, *_ in chosen),
        gains=np.array([gain for _, gain, *_ in chosen]),
        channels=tuple(channel for *_, channel, _ in chosen),
        mapping={c.name: f"{'-' if sign < 0 else '+'}{columns[row].name}" for row, _, c, sign in chosen},
        problems=tuple(problems),
        notices=tuple(notices),
    )


def _column_index(columns: Sequence[Column], name: str, problems: list[str], option: str) -> int | None:
    """The column of that name, or whose header cell reads so."""
    for of in (lambda c: c.name, lambda c: c.written, lambda c: c.name.lower()):
        found = [i for i, column in enumerate(columns) if of(column) in (name, name.lower())]
        if len(found) == 1:
            return found[0]
    problems.append(f"no column '{name}'; the file has {', '.join(c.name for c in columns)}: correct {option}")
    return None


def _time_column(
    columns: Sequence[Column], stated: Mapping[int | None, str], tables: Mapping[str, ChannelTable]
) -> int | None:
    """The column that is said to be the time, or whose stated unit is one of time."""
    named = {_source_of(name, table, columns) for name, table in tables.items() if table.quantity == "time"}
    for i, column in enumerate(columns):
        if column.name in named:
            return i
    for i in range(len(columns)):
        if time_unit(stated.get(i)) is not None:
            return i
    for i, column in enumerate(columns):
        if column.quantity == "time" or (column.quantity is None and is_time(column.name, column.unit)):
            return i
    return None


def _wanted(
    columns: Sequence[Column],
    time: int | None,
    mapping: Mapping[str, str],
    tables: Mapping[str, ChannelTable],
    problems: list[str],
) -> list[tuple[str, str | None, float, int]]:
    """Name, dof, sign and column of every channel asked for."""
    wanted: list[tuple[str, str | None, float, int]] = []
    for key, value in mapping.items():
        name, _, dof = key.partition("@")
        signed = value.strip()
        sign = -1.0 if signed.startswith("-") else 1.0
        row = _column_index(columns, signed.lstrip("+-").strip(), problems, "--map")
        if row is not None and row == time:
            problems.append(f"the map takes the time column '{columns[row].name}' for '{name}'; correct --map")
        elif row is not None:
            wanted.append((name.strip(), dof.strip() or None, sign, row))
    renamed = {}
    named = {name for name, *_ in wanted}
    for name, table in tables.items():
        if name in named and table.column is None and table.number is None and table.dataset is None:
            continue  # the map says which column it is
        row = _column_index(columns, _source_of(name, table, columns), problems, f"[channels.{name}]")
        if row is not None:
            renamed[row] = name
    if mapping:
        mapped = {name for name, *_ in wanted}
        wanted += [(name, None, 1.0, row) for row, name in renamed.items() if name not in mapped and row != time]
    else:
        clocks = [
            row for row, c in enumerate(columns) if row == time or c.quantity == "time" or is_time(c.name, c.unit)
        ]
        rows = [row for row in range(len(columns)) if row in renamed or row not in clocks]
        wanted = [(renamed.get(row, columns[row].name), None, 1.0, row) for row in rows]
    return wanted


def _source_of(name: str, table: ChannelTable, columns: Sequence[Column]) -> str:
    """Which column a table of a setup speaks of: by name, by number, or its own name."""
    if table.dataset is not None:  # `column` and `number` are then parts of the dataset
        return name
    if table.column is None and table.number is not None and table.number < len(columns):
        return columns[table.number].name
    return table.column or name


def _gain(column: Column, text: str | None, quantity: str | None, problems: list[str]) -> tuple[str, str, float] | None:
    """Quantity, SI unit and factor of a column, or None after adding the problem."""
    name = column.written or column.name
    how = (
        f"""state it with --unit "{column.name}=..." or under [units] ({_KNOWN}), or leave the column out with --map"""
    )
    if text is None or not text.strip():
        if quantity == "pulse":
            return "pulse", "1", 1.0
        problems.append(f"column '{name}' has no unit; {how}")
        return None
    sensitivity = _SENSITIVITY.fullmatch(text.strip())
    if sensitivity:
        return _gain_of_sensitivity(column, sensitivity, problems)
    unit = normal_unit(text)
    if unit in ("V", "mV") and quantity == "pulse":
        return "pulse", "1", 1.0
    if unit not in FILE_UNITS:
        problems.append(f"column '{name}': unknown unit '{text.strip()}'; {how}")
        return None
    found, si, factor = FILE_UNITS[unit]
    if found == "voltage":
        problems.append(
            f"column '{name}' is in {unit}; state its sensitivity, such as --unit \"{column.name}=100 mV/g\" "
            f'or "{column.name}=2.25 mV/N", or --unit {column.name}=1 for a once-per-revolution pulse'
        )
        return None
    if quantity is not None and QUANTITY_UNITS.get(quantity) != si:
        problems.append(f"column '{name}' is in {unit}, which is no {quantity.replace('_', ' ')}; correct one of them")
        return None
    return quantity or found, si, factor


def _gain_of_sensitivity(column: Column, match: re.Match, problems: list[str]) -> tuple[str, str, float] | None:
    """A voltage (or charge) per unit: `100 mV/g`. The column is in V (pC) unless it says otherwise, or `mV, 100 mV/g` does."""
    name = column.written or column.name
    measured = FILE_UNITS.get(normal_unit(match["unit"]))
    try:
        value = float(match["value"])
    except ValueError:
        value = 0.0
    if measured is None or measured[0] in ("voltage", "sound") or value == 0:
        problems.append(
            f"column '{name}': '{match.group()}' is no sensitivity; write a voltage per unit, "
            f'such as --unit "{column.name}=100 mV/g"'
        )
        return None
    kind, signal = _SIGNALS[match["signal"]]
    written = match["column"] or (column.unit and column.unit.strip("[]() ")) or ("pC" if kind == "C" else kind)
    written = normal_unit(written) if normal_unit(written) in _SIGNALS else written
    if written not in _SIGNALS or _SIGNALS[written][0] != kind:
        right = "pC" if kind == "C" else kind
        problems.append(
            f"column '{name}' is in {written}, and '{match.group()}' is for a column in {right}; correct --unit"
        )
        return None
    quantity, si, factor = measured
    return quantity, si, _SIGNALS[written][1] / (value * signal) * factor


def _dof_of(name: str) -> str:
    """The point and direction that a channel's name ends in, else the name: acc_tipX -> tipX."""
    found = _DOF_ENDING.fullmatch(name)
    return found["dof"] if found else name
