"""The FRFs of a universal file: each function of type 4 (or 5, transmissibility) is one pair, in SI.

What a record measures is said three times: by the unit on its axis, by its data type, and by the word on its axis. They
are asked in this order and must not contradict each other. The scale comes from the unit on the axis, else from the
units of the file (dataset 164), else it is taken as SI with a warning. What nobody says must be stated.

Coherence (type 6) and multiple coherence (26) go to the pairs with the same response and reference.
"""

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats.uff import QUANTITIES, counted, is_time_record
from millcal.io.formats.uff_dofs import LONGEST, dof_names, split_dof
from millcal.io.formats.universal import Function, Universal
from millcal.io.formats.universal_records import Axis, Dof
from millcal.io.frf_pairs import Measured, Pair, bare_dof, check_frequency, check_same_lines, known_values
from millcal.io.frf_units import FORM_OF, form_of_words, frf_unit, stated_unit
from millcal.units import FILE_UNITS, normal_unit

FRF, TRANSMISSIBILITY, COHERENCE, MULTIPLE_COHERENCE = 4, 5, 6, 26
OURS = "millcal "  # begins the free lines of a record that we wrote
_FREQUENCY_AXIS, _TIME_AXIS = 18, 17
_HERTZ = {"": 1.0, "hz": 1.0, "1/s": 1.0, "khz": 1e3, "rad/s": 1 / (2 * np.pi), "cpm": 1 / 60, "rpm": 1 / 60}
_STATE = "state the unit of its numbers with --unit g/N, m/s^2/N, m/N or the like"


def holds_frf(found: Universal) -> bool:
    """Whether any function of a file is a pair of an FRF."""
    return any(function.kind in (FRF, TRANSMISSIBILITY) for function in found.functions)


def measured_of(found: Universal, *, form: str | None = None, unit: str | None = None) -> Measured:
    """The pairs of a universal file.   form, unit : as the user states them, before what the file says"""
    records = [f for f in found.functions if f.kind in (FRF, TRANSMISSIBILITY)]
    if not records:
        held = ", ".join(f"{n} x {what}" for what, n in counted(found.functions).items())
        time = any(is_time_record(f) for f in found.functions)
        mending = "'millcal frf' makes an FRF of time records" if time else "export the FRFs (function type 4)"
        raise RecordingError(f"{found.path}: no FRF in this universal file, it holds {held}; {mending}")
    stated = stated_unit(form, unit)
    names = _names(records)
    first = records[0]
    frequency = _frequency(first)
    notices = list(found.notices)
    problems: list[str] = []
    pairs = []
    for record in records:
        check_same_lines(record.where, _frequency(record), f"record {first.number}", frequency)
        own, factor = _form_and_factor(record, stated, problems, notices)
        if not record.is_complex:
            message = "real numbers without a phase are taken as the real part; export complex ones"
            notices.append(Notice("real-frf", message, record.where))
        output, reference = names[record.number]
        values = factor * known_values(record.where, record.values().astype(complex))
        pairs.append(Pair(f"{record.where} ({output}/{reference})", values, output, reference, own))
    pairs, multiple = _with_coherence(found, pairs, records, names, frequency, notices)
    others = [f for f in found.functions if f.kind not in (FRF, TRANSMISSIBILITY, COHERENCE, MULTIPLE_COHERENCE)]
    if others:
        told = ", ".join(f"{n} x {what}" for what, n in counted(others).items())
        notices.append(
            Notice("records-left-out", f"only FRFs and coherences are taken, not {told}", str(found.path), "note")
        )
    words = _our_words(first.ids[3]) | _our_words(first.ids[4])
    return Measured(
        path=found.path,
        format="uff",
        frequency=frequency,
        pairs=tuple(pairs),
        multiple=multiple,
        estimator=str(words.get("estimator", "unknown")),
        hits_used={bare_dof(names[r.number][1]): int(_our_words(r.ids[4]).get("hits", 0)) for r in records},
        band=_band(words.get("band"), frequency),
        damping_shift=float(words.get("shift", 0.0)),
        problems=tuple(dict.fromkeys(problems)),
        notices=tuple(dict.fromkeys(notices)),
        details={"program": found.program, "model": found.model, "records": counted(found.functions)},
    )


def _our_words(line: str) -> dict:
    """What we wrote into a free line of a record; empty where somebody else wrote it."""
    with suppress(ValueError):
        words = json.loads(line.removeprefix(OURS)) if line.startswith(OURS) else {}
        return words if isinstance(words, dict) else {}
    return {}


def _band(told: object, frequency: np.ndarray) -> tuple[float, float] | None:
    """The usable band in Hz, from the numbers of its lines or as it is; None where nothing is told."""
    if not isinstance(told, list) or len(told) != 2:
        return None
    on_lines = all(isinstance(end, int) and 0 <= end < len(frequency) for end in told)
    low, high = (float(frequency[end]) if on_lines else float(end) for end in told)
    return low, high


def _names(records: Sequence[Function]) -> dict[int, tuple[str, str]]:
    """Output and input of each record; ours keep a name that is longer than a record's field, or in small letters."""
    general = dof_names(dof for record in records for dof in (record.response, record.reference))
    names = {}
    for record in records:
        own = [general[record.response], general[record.reference]]
        said = _our_words(record.ids[1]).get("pair", own)
        for i, dof in enumerate((record.response, record.reference)):
            if isinstance(said, list) and len(said) == 2 and _stands_for(str(said[i]), dof):
                own[i] = str(said[i])
        names[record.number] = (own[0], own[1])
    return names


def _stands_for(name: str, dof: Dof) -> bool:
    """Whether a dof could be written as this one: another program may have renamed it since."""
    point, direction = split_dof(name)
    points = (dof.entity,) if dof.entity else ("", str(dof.node))
    return direction == dof.direction and point[:LONGEST].strip() in points


def _frequency(record: Function) -> np.ndarray:
    """The abscissa in Hz; our own with all its digits, where they agree with the six of the record."""
    axis = record.abscissa
    if axis.kind == _TIME_AXIS:
        raise RecordingError(f"{record.where}: an FRF over time; export it over frequency")
    scale = _HERTZ.get(axis.unit.lower())
    if scale is None:
        raise RecordingError(f"{record.where}: a frequency in {axis.unit!r}; export it in Hz")
    words = _our_words(record.ids[3]).get("lines")
    lines = record.x()
    if record.even and isinstance(words, list) and len(words) == 2:
        exact = float(words[0]) + float(words[1]) * np.arange(record.count)
        if (
            abs(words[1] - record.step) <= 2 * record.step_rounding + 1e-9 * record.step
            and abs(words[0] - record.first) < record.step
        ):
            lines = exact
    check_frequency(record.where, scale * lines)
    return scale * lines


def _form_and_factor(
    record: Function, stated: tuple[str | None, float | None], problems: list[str], notices: list[Notice]
) -> tuple[str | None, float]:
    """The form of a record and its factor to SI, by what the user states, else by what the record says."""
    said = _said_forms(record)
    form, factor = stated
    if form is not None:
        against = [f"{told} by {how}" for how, told in said.items() if told != form]
        if against:
            message = f"{form} as stated, though the file says {', '.join(against)}"
            notices.append(Notice("form-overruled", message, str(record.path)))
        return form, _factor(record, form, problems, notices) if factor is None else factor
    forms = set(said.values())
    if len(forms) > 1:
        told = ", ".join(f"{form} by {how}" for how, form in said.items())
        problems.append(f"record {record.number} says {told}; {_STATE}")
        return None, 1.0
    if not forms:
        kind = f"data type {record.numerator.kind}, unit {record.numerator.unit or 'none'!r}"
        problems.append(f"record {record.number} does not say what it measures ({kind}); {_STATE}")
        return None, 1.0
    own = forms.pop()
    return own, _factor(record, own, problems, notices)


def _said_forms(record: Function) -> dict[str, str]:
    """The form by each of the ways in which a record may tell it."""
    said = {}
    axis, below = record.numerator, record.denominator
    whole = frf_unit(axis.unit)
    alone = FILE_UNITS.get(normal_unit(axis.unit))
    if whole is not None and axis.unit not in ("1", "-", "%"):
        said["its unit"] = whole[0]
    elif alone is not None and alone[0] in FORM_OF:
        said["its unit"] = FORM_OF[alone[0]]
    if axis.kind in QUANTITIES:
        said["its data type"] = FORM_OF[QUANTITIES[axis.kind]]
    elif (word := form_of_words(axis.label)) is not None and not said:
        said["its label"] = word
    if record.kind == TRANSMISSIBILITY:
        said.setdefault("its function type", "transmissibility")
    if QUANTITIES.get(below.kind, "force") != "force":
        raise RecordingError(
            f"{record.where}: over {QUANTITIES[below.kind]} and not over force; export the response over the force"
        )
    return said


def _factor(record: Function, form: str, problems: list[str], notices: list[Notice]) -> float:
    """SI per number of a record whose form is known."""
    axis, below = record.numerator, record.denominator
    whole = frf_unit(axis.unit)
    if whole is not None:
        return whole[1]
    above = _axis_factor(record, axis, "force" if form == "transmissibility" else "length", problems, notices)
    return above / _axis_factor(record, below, "force", problems, notices)


def _axis_factor(record: Function, axis: Axis, dimension: str, problems: list[str], notices: list[Notice]) -> float:
    """SI per unit of one axis."""
    known = FILE_UNITS.get(normal_unit(axis.unit))
    if known is not None and known[0] != "voltage":
        factor = known[2]
        if record.units is not None and axis.unit:
            own = 1 / (record.units.force if dimension == "force" else record.units.length)
            if abs(own / factor - 1) > 1e-3 and abs(own - 1) > 1e-3:
                message = f"the unit on the axis, {axis.unit}, is not that of the file's units; the axis is believed"
                notices.append(Notice("units-disagree", message, str(record.path)))
        return factor
    if axis.unit and re.search(r"[A-Za-z]", axis.unit):
        problems.append(f"record {record.number} is in {axis.unit!r}, which is not known; {_STATE}")
        return 1.0
    if record.units is not None:
        return 1 / (record.units.force if dimension == "force" else record.units.length)
    si = "N" if dimension == "force" else "m, m/s or m/s^2"
    message = (
        f"neither the record nor the file says the unit of its {dimension}; {si} is taken, state another with --unit"
    )
    notices.append(Notice("unit-assumed", message, str(record.path)))
    return 1.0


def _with_coherence(
    found: Universal,
    pairs: Sequence[Pair],
    records: Sequence[Function],
    names: dict[int, tuple[str, str]],
    frequency: np.ndarray,
    notices: list[Notice],
) -> tuple[list[Pair], dict[str, np.ndarray]]:
    """The pairs with their coherences, and the multiple coherence of each output; one that fits nowhere is told."""
    result, multiple = list(pairs), {}

    def place(dof: Dof) -> tuple[int, int]:
        return dof.node, abs(dof.direction)

    for record in found.functions:
        if record.kind not in (COHERENCE, MULTIPLE_COHERENCE):
            continue
        fits = [k for k, pair in enumerate(records) if place(pair.response) == place(record.response)]
        if record.kind == COHERENCE:
            same = [k for k in fits if place(records[k].reference) == place(record.reference)]
            # A coherence without a reference belongs to the only pair of its response, if there is one.
            fits = same or (fits if record.reference.node == 0 and len(fits) == 1 else [])
        lines = _frequency(record) if record.abscissa.kind in (0, 1, _FREQUENCY_AXIS) else np.empty(0)
        if not fits or len(lines) != len(frequency):
            why = "no FRF has its response and reference" if not fits else "its lines are not those of the FRF"
            notices.append(Notice("coherence-left-out", f"a coherence is left out: {why}", record.where))
            continue
        values = np.real(record.values())
        if record.kind == MULTIPLE_COHERENCE:
            multiple[bare_dof(names[records[fits[0]].number][0])] = values
        else:
            for k in fits:
                result[k] = replace(result[k], coherence=values)
    return result, multiple
