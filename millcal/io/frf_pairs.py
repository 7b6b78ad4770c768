"""One measured pair of an FRF after another, and the matrix that they make.

Files of other programs hold pairs: one response to one reference. A reader hands over what its file says of each; what it
does not say stays None and is a problem until the user states it. Putting the pairs together is the same question for all
files: one abscissa, no pair twice, signs turned once, gaps told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from millcal.data import Frf, Hit, HitSpectra, Notice
from millcal.errors import RecordingError
from millcal.physics.structure import DERIVATIVES, convert_frf, convert_frf_variance

SAME = 1e-3  # of a step, beside the digits that an abscissa is written with: frequencies this close are one line
WRITTEN = 2e-5  # relative; twice the sixth digit
FEWEST = 2  # lines
LARGEST = 1e30  # in any unit; what is larger is damage, and its square would overflow


@dataclass(frozen=True, eq=False)
class Pair:
    """One response to one reference, in SI where its unit is known."""

    place: str  # the file and the record or columns, for messages
    values: np.ndarray  # complex (frequency,)
    output: str | None  # dof with its sign; None where the file does not name it
    input: str | None
    form: str | None
    coherence: np.ndarray | None = None  # (frequency,)
    variance: np.ndarray | None = None  # (frequency,)


@dataclass(frozen=True, eq=False)
class Measured:
    """What one file holds of an FRF."""

    path: Path
    format: str
    frequency: np.ndarray  # (frequency,) Hz
    pairs: tuple[Pair, ...]
    multiple: Mapping[str, np.ndarray] = field(default_factory=dict)  # multiple coherence of an output
    spectrum: Mapping[str, np.ndarray] = field(default_factory=dict)  # |F| of an input, N s
    estimator: str = "unknown"
    hits_used: Mapping[str, int] = field(default_factory=dict)  # of an input
    band: tuple[float, float] | None = None  # usable, Hz
    damping_shift: float = 0.0  # 1/s
    hits: tuple[Hit, ...] = ()
    tests: tuple[HitSpectra, ...] = ()
    problems: tuple[str, ...] = ()  # each `what; mending`
    notices: tuple[Notice, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)


def pairs_of(path: Path, frf: Frf) -> Measured:
    """The pairs of an FRF of millcal, those that were measured."""

    def column(array: np.ndarray | None, o: int, i: int) -> np.ndarray | None:
        return None if array is None else array[:, o, i]

    pairs = [
        Pair(
            f"{path}: {output}/{one}",
            frf.values[:, o, i],
            output,
            one,
            frf.form,
            column(frf.coherence, o, i),
            column(frf.variance, o, i),
        )
        for i, one in enumerate(frf.inputs)
        for o, output in enumerate(frf.outputs)
        if np.isfinite(frf.values[:, o, i]).any()
    ]
    multiple = {} if frf.multiple_coherence is None else dict(zip(frf.outputs, frf.multiple_coherence.T, strict=True))
    spectrum = {} if frf.force_spectrum is None else dict(zip(frf.inputs, frf.force_spectrum.T, strict=True))
    return Measured(
        path,
        "millcal-result",
        frf.frequency,
        tuple(pairs),
        multiple,
        spectrum,
        frf.estimator,
        dict(zip(frf.inputs, frf.hits_used, strict=True)),
        frf.usable_band,
        frf.damping_shift,
        frf.hits,
        frf.tests,
        notices=frf.notices,
    )


def check_frequency(where: str, frequency: np.ndarray) -> None:
    """Refuse an abscissa that is none of an FRF.   frequency : (frequency,) Hz"""
    if len(frequency) < FEWEST:
        raise RecordingError(f"{where}: {len(frequency)} lines; an FRF needs at least {FEWEST}, export it again")
    if not np.isfinite(frequency).all():
        raise RecordingError(f"{where}: line {int(np.argmin(np.isfinite(frequency))) + 1} has no frequency; mend it")
    steps = np.diff(frequency)
    if frequency[0] < 0 or (steps <= 0).any():
        at = 0 if frequency[0] < 0 else int(np.argmax(steps <= 0)) + 1
        raise RecordingError(
            f"{where}: the frequency does not rise at line {at + 1}, {frequency[at]:g} Hz; give rising frequencies from 0 on"
        )
    if frequency[-1] < 10 and np.median(steps) < 0.01:
        raise RecordingError(
            f"{where}: the first column runs from {frequency[0]:g} to {frequency[-1]:g} in steps of {np.median(steps):.3g}, "
            "which are times and no frequencies; 'millcal frf' makes an FRF of a recording"
        )


def known_values(where: str, values: np.ndarray) -> np.ndarray:
    """Values as they are, nan where one is infinite, as a line at rest may be; refused where no measurement can be so large.

    values : complex (frequency,)   returns the same shape
    """
    values = np.where(np.isfinite(values), values, complex(np.nan, np.nan))
    size = np.maximum(np.abs(values.real), np.abs(values.imag))
    if np.nanmax(size, initial=0.0) > LARGEST:
        line = int(np.nanargmax(size))
        raise RecordingError(
            f"{where}: a value of {size[line]:.1e} at line {line + 1}; damaged, copy or export it again"
        )
    return values


def renamed(files: Sequence[Measured], outputs: Sequence[str], inputs: Sequence[str]) -> list[Measured]:
    """The pairs under the dofs that the user states, in the order of the files or, in one file, of its dofs."""
    if not outputs and not inputs:
        return list(files)
    if all(len(file.pairs) == 1 for file in files):
        names = [_for_each(files, given, what) for given, what in ((outputs, "--response"), (inputs, "--hammer"))]
        return [
            _with_names(f, {f.pairs[0].output: o}, {f.pairs[0].input: i}) for f, o, i in zip(files, *names, strict=True)
        ]
    if len(files) > 1:
        many = next(file for file in files if len(file.pairs) != 1)
        raise RecordingError(
            f"{many.path}: holds {len(many.pairs)} pairs; dofs can be stated for one file, or for files of one pair each"
        )
    maps = []
    for given, side, what in ((outputs, "output", "--response"), (inputs, "input", "--hammer")):
        own = list(dict.fromkeys(getattr(pair, side) for pair in files[0].pairs))
        if given and len(given) != len(own):
            raise RecordingError(
                f"{files[0].path}: {len(own)} {side}s ({', '.join(map(str, own))}) and {len(given)} names; "
                f"give {what} once for each"
            )
        maps.append(dict(zip(own, given or own, strict=True)))
    return [_with_names(files[0], *maps)]


def _for_each(files: Sequence[Measured], given: Sequence[str], what: str) -> list[str | None]:
    if given and len(given) not in (1, len(files)):
        raise RecordingError(
            f"{files[0].path}: {len(files)} files and {len(given)} names; give {what} once, or for each file"
        )
    return [None] * len(files) if not given else list(given) * (len(files) if len(given) == 1 else 1)


def _with_names(
    file: Measured, outputs: Mapping[str | None, str | None], inputs: Mapping[str | None, str | None]
) -> Measured:
    """A file under other dofs; what is hung on the dofs goes along."""

    def name(names: Mapping[str | None, str | None], own: str | None) -> str | None:
        return names.get(own) or own

    def keys(names: Mapping[str | None, str | None], items: Mapping[str, Any]) -> dict[str, Any]:
        return {bare_dof(name(names, key) or key): value for key, value in items.items()}

    pairs = [replace(p, output=name(outputs, p.output), input=name(inputs, p.input)) for p in file.pairs]
    tests = tuple(
        replace(
            test,
            outputs=tuple(name(outputs, dof) or dof for dof in test.outputs),
            inputs=tuple(name(inputs, dof) or dof for dof in test.inputs),
        )
        for test in file.tests
    )
    return replace(
        file,
        pairs=tuple(pairs),
        multiple=keys(outputs, file.multiple),
        spectrum=keys(inputs, file.spectrum),
        hits_used=keys(inputs, file.hits_used),
        tests=tests,
    )


def bare_dof(dof: str) -> str:
    """A dof without its sign."""
    return dof.lstrip("+-")


def joined(files: Sequence[Measured]) -> Frf:
    """The FRF matrix of all pairs of some files; the first one's form, estimator and lines.

    raises RecordingError for a problem that is left, unequal abscissae, and a pair that stands twice with unequal values
    """
    for file in files:
        for problem in problems_of(file):
            raise RecordingError(f"{file.path}: {problem}")
    first = files[0]
    for file in files[1:]:
        check_same_lines(str(file.path), file.frequency, str(first.path), first.frequency)
        if file.damping_shift != first.damping_shift:
            raise RecordingError(
                f"{file.path}: measured under another exponential window than {first.path}; join FRFs of one window"
            )
    notices = [notice for file in files for notice in file.notices]
    pairs, turned = _turned([pair for file in files for pair in file.pairs])
    notices += turned
    form = pairs[0].form or ""
    pairs = [_converted(pair, form, first.frequency, notices) for pair in pairs]
    pairs = _without_copies(pairs, notices)
    outputs = tuple(dict.fromkeys(pair.output or "" for pair in pairs))
    inputs = tuple(dict.fromkeys(pair.input or "" for pair in pairs))
    shape = (len(first.frequency), len(outputs), len(inputs))
    values = np.full(shape, np.nan, complex)
    coherence, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    for pair in pairs:
        place = (slice(None), outputs.index(pair.output or ""), inputs.index(pair.input or ""))
        values[place] = pair.values
        for array, own in ((coherence, pair.coherence), (variance, pair.variance)):
            if own is not None:
                array[place] = own
    there = {(pair.output, pair.input) for pair in pairs}
    missing = [f"{o}/{i}" for o in outputs for i in inputs if (o, i) not in there]
    if missing:
        named = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
        notices.append(
            Notice("not-measured", f"pairs that no file holds are left blank: {named}", str(first.path), "note")
        )
    if form != "transmissibility" and not set(inputs) & set(outputs):
        message = f"no response was measured where the hammer hit ({', '.join(inputs)}); name the dofs with --response and --hammer"
        notices.append(Notice("no-driving-point", message, str(first.path)))
    bands = [file.band for file in files if file.band is not None]
    whole = (float(first.frequency[0]), float(first.frequency[-1]))
    return Frf(
        frequency=first.frequency,
        values=values,
        coherence=None if all(pair.coherence is None for pair in pairs) else coherence,
        multiple_coherence=_by_dof([file.multiple for file in files], outputs, shape[0]),
        variance=None if all(pair.variance is None for pair in pairs) else variance,
        force_spectrum=_by_dof([file.spectrum for file in files], inputs, shape[0]),
        form=form,  # type: ignore[arg-type]
        estimator=first.estimator,
        outputs=outputs,
        inputs=inputs,
        hits_used=tuple(max((int(file.hits_used.get(dof, 0)) for file in files), default=0) for dof in inputs),
        usable_band=(max(low for low, _ in bands), min(high for _, high in bands)) if bands else whole,
        hits=tuple(hit for file in files for hit in file.hits),
        damping_shift=first.damping_shift,
        tests=() if turned else tuple(test for file in files for test in file.tests),
        notices=tuple(dict.fromkeys(notices)),
    )


def problems_of(file: Measured) -> tuple[str, ...]:
    """What must be stated before a file can be used, each `what; mending`."""
    if not file.pairs:
        return ("holds no FRF; measure it again",)
    unnamed = any(pair.output is None or pair.input is None for pair in file.pairs)
    where = "it does not say where it was measured; name response and hammer with --response tipX --hammer tipX"
    return (*file.problems, *((where,) if unnamed else ()))


def check_same_lines(where: str, lines: np.ndarray, other: str, expected: np.ndarray) -> None:
    """Refuse pairs on unequal abscissae: interpolating an FRF bends its resonances.   lines, expected : (frequency,) Hz"""
    same = len(lines) == len(expected)
    if same:
        step = float(np.median(np.diff(expected)))
        same = bool(np.all(np.abs(lines - expected) <= SAME * step + WRITTEN * np.abs(expected)))
    if not same:
        told = (f"{len(x)} lines from {x[0]:g} to {x[-1]:g} Hz" for x in (lines, expected))
        here, there = told
        raise RecordingError(f"{where}: {here} where {other} has {there}; export them on the same lines")


def _turned(pairs: Sequence[Pair]) -> tuple[list[Pair], list[Notice]]:
    """Signs of the dofs taken into the values, as for the channels of a recording: -tipX is minus what moves along tipX.

    Where a file holds both directions at one place, the sign stays in the name.
    """
    both = {
        side: {dof for dof in (getattr(p, side) for p in pairs) if dof.startswith("-")}
        & {f"-{bare_dof(dof)}" for dof in (getattr(p, side) for p in pairs) if not dof.startswith("-")}
        for side in ("output", "input")
    }
    result, signed = [], []
    for pair in pairs:
        sign, names = 1.0, {}
        for side in ("output", "input"):
            dof = getattr(pair, side)
            if dof in both[side]:
                names[side] = dof
                continue
            names[side] = bare_dof(dof)
            if dof.startswith("-"):
                sign = -sign
                signed.append(dof)
        result.append(replace(pair, values=sign * pair.values, **names))
    if not signed:
        return result, []
    told = ", ".join(dict.fromkeys(signed))
    message = f"dofs against their axis are turned, and the values with them: {told}"
    return result, [Notice("dof-turned", message, pairs[0].place.split(": ")[0], "note")]


def _converted(pair: Pair, form: str, frequency: np.ndarray, notices: list[Notice]) -> Pair:
    """A pair in the form of the first one."""
    own = pair.form or ""
    if own == form:
        return pair
    if form not in DERIVATIVES or own not in DERIVATIVES:
        raise RecordingError(f"{pair.place}: a {own} beside a {form}; read the two one by one")
    message = f"a {own} among others is converted to {form}"
    notices.append(Notice("form-converted", message, pair.place, "note"))
    variance = None if pair.variance is None else convert_frf_variance(frequency, pair.variance, own, form)
    return replace(pair, values=convert_frf(frequency, pair.values, own, form), variance=variance, form=form)


def _without_copies(pairs: Sequence[Pair], notices: list[Notice]) -> list[Pair]:
    """Each pair once: a copy is left out, two different measurements of one pair are refused."""
    kept: dict[tuple[str | None, str | None], Pair] = {}
    for pair in pairs:
        other = kept.setdefault((pair.output, pair.input), pair)
        if other is pair:
            continue
        if not np.allclose(pair.values, other.values, rtol=1e-5, atol=0, equal_nan=True):
            raise RecordingError(
                f"{pair.place}: {pair.output}/{pair.input} stands in {other.place} too, with other values; "
                "leave one of them out, or name them differently"
            )
        message = f"{pair.output}/{pair.input} stands in {other.place} too, with the same values; one is taken"
        notices.append(Notice("pair-twice", message, pair.place, "note"))
    return list(kept.values())


def _by_dof(files: Sequence[Mapping[str, np.ndarray]], dofs: Sequence[str], lines: int) -> np.ndarray | None:
    """What files say of each dof, nan where none does; None where none says anything.   returns (frequency, dof)"""
    if not any(files):
        return None
    blank = np.full(lines, np.nan)
    return np.stack([next((f[dof] for f in files if dof in f), blank) for dof in dofs], axis=1)
