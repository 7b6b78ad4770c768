"""Where to begin: coefficients that do not change, runout and the spindle's phase, from the first revolutions of each cut.

The phase is scanned with the force linear in its levels, then everything is refined together. Runout of several teeth has
minima of its own (a tooth's label is as good as its neighbour's), so a few are tried. No later sample is looked at, so that
a filter that begins here is causal from there on.
"""

from dataclasses import dataclass, replace

import numpy as np

from millcal.errors import IllPosedError
from millcal.stages.coefficients.trends.problem import CutRecord

SCANNED = 6  # revolutions of the scan
FITTED = 20  # revolutions of the fit
PHASES = 48  # per tooth
SHAPE = {"kienzle": (0.3, 0.2), "linear-edge": (0.3, 0.25)}  # mean and sd of what is known of a shape beforehand
LIKELY_SHAPE = {"kienzle": 0.25, "linear-edge": 0.3}
SHAPE_RANGE = {"kienzle": (-0.3, 0.95), "linear-edge": (-0.5, 0.97)}
RUNOUT_SD = 20e-6  # m
WOUND = 0.5  # rad, helix lag over the depth
MOST_RUNOUT = 60e-6  # m, either component
PHASE_SD = 0.1  # rad, about what the scan says
STATED_PHASE_SD = 1e-3  # rad
COARSE_NOISE = 0.1  # of the rms of an axis, where nothing tells the noise


@dataclass(frozen=True, eq=False)
class Start:
    """A fit of constant parameters."""

    record: CutRecord  # with the sign of the axial force
    parameters: np.ndarray  # (parameter,), phases last
    covariance: np.ndarray  # (parameter, parameter), for the noise given
    residual: np.ndarray  # (sample, axis) N, over the revolutions of the fit
    samples: np.ndarray  # (sample,) bool, of the record

    @property
    def runout(self) -> tuple[float, float]:
        """c0, s0, m"""
        own = 2 * self.record.directions
        return float(self.parameters[own]), float(self.parameters[own + 1])

    @property
    def phase(self) -> np.ndarray:
        """(cut,) rad"""
        return self.parameters[2 * self.record.directions + 2 :]


def prior_of(record: CutRecord, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is known of the parameters beforehand, about where they were found: mean and sd, (parameter,).

    Levels are as good as free; a shape lies where those of metals do, unless the record says otherwise.
    """
    D = record.directions
    mean, sd = np.array(parameters, float), np.empty(len(parameters))
    shape_mean, shape_sd = SHAPE[record.law]
    sd[0 : 2 * D : 2] = 1.0
    mean[1 : 2 * D : 2], sd[1 : 2 * D : 2] = shape_mean, shape_sd
    mean[2 * D : 2 * D + 2], sd[2 * D : 2 * D + 2] = 0.0, RUNOUT_SD
    for number, cut in enumerate(record.cuts):
        sd[2 * D + 2 + number] = STATED_PHASE_SD if cut.angle_from == "stated" else PHASE_SD
    return mean, sd


def first_revolutions(record: CutRecord, revolutions: float) -> np.ndarray:
    """The first so many of each cut.   returns (sample,) bool"""
    angle = record.passage.angle
    first = np.array([angle[record.cut == number][0] for number in range(len(record.cuts))])
    return angle - first[record.cut] < 2 * np.pi * revolutions


def winds(record: CutRecord) -> bool:
    """Whether s0 is seen well: with two teeth only as far as the helix winds over the depth."""
    lag = float(record.cutter.helix_lag(np.max(record.passage.axial_depth)))
    return record.cutter.teeth > 2 or abs(lag) > WOUND


def find_start(
    record: CutRecord,
    noise_sd: np.ndarray | None,
    *,
    runout: bool,
    known: tuple[float, float],
    only_c0: bool = False,
) -> Start:
    """Constant parameters of the first revolutions.

    noise_sd : (axis,) N, None where nothing tells it   runout : whether it is a parameter; else it is `known`, m
    only_c0 : leave s0 at 0, where the law does not hold so well that so weak a component could be trusted

    Raises
    ------
    IllPosedError
        No phase lets the tool cut as the force says.
    """
    rms = np.sqrt(np.mean(record.force**2, axis=0))
    sd = np.maximum(COARSE_NOISE * rms, 1e-9 * rms.max()) if noise_sd is None else noise_sd
    runout = runout and record.cutter.teeth > 1
    D = record.directions
    parameters = np.zeros(record.parameters)
    parameters[1 : 2 * D : 2] = LIKELY_SHAPE[record.law]
    parameters[2 * D : 2 * D + 2] = known
    feeds = [float(np.max(record.passage.feed_per_tooth[record.cut == number])) for number in range(len(record.cuts))]
    first = int(np.argmax(feeds))  # where runout matters least
    record, candidates = _scan(record, parameters, np.maximum(sd, COARSE_NOISE * rms), first)
    fixed = np.zeros(record.parameters, bool)
    fixed[2 * D : 2 * D + 2] = True
    part = first_revolutions(record, FITTED)
    one = part & (record.cut == first)
    wide = np.maximum(sd, 0.02 * rms)  # a coarse fit need not be sharper than the law
    fits = [_refined(record.of(one), c, wide, _only_cut(record, first, fixed)) for c in candidates]
    fits.sort(key=lambda fit: fit[1])
    best = fits[0]
    if runout:
        fixed[2 * D : 2 * D + 2] = False, only_c0
        reach = min(0.15 * float(np.max(record.passage.feed_per_tooth)), RUNOUT_SD)
        tried = []
        for seed in fits[:2]:
            for around in (0.0, 0.5) if only_c0 else (0.0, 0.25, 0.5, 0.75):
                p = seed[0].copy()
                p[2 * D] = reach * np.cos(2 * np.pi * around)
                p[2 * D + 1] = 0.0 if only_c0 else reach * np.sin(2 * np.pi * around)
                tried.append(_refined(record.of(one), p, wide, _only_cut(record, first, fixed)))
        best = min(tried, key=lambda fit: fit[1])
    parameters, _, covariance, left = _refined(record.of(one), best[0], sd, _only_cut(record, first, fixed))
    residual = np.empty((len(part), len(record.axes)))
    residual[one] = left
    for number in set(range(len(record.cuts))) - {first}:  # of its own level: the edge may have worn in between
        its = part & (record.cut == number)
        _, candidates = _scan(record, parameters, wide, number, signed=False)
        of_cut = _only_cut(record, number, np.ones(record.parameters, bool))
        of_cut[0 : 2 * D : 2] = False
        refits = [_refined(record.of(its), candidate, sd, of_cut) for candidate in candidates]
        its_own, _, its_covariance, left = min(refits, key=lambda fit: fit[1])
        at = 2 * D + 2 + number
        parameters[at], covariance[at, at], residual[its] = its_own[at], its_covariance[at, at], left
    return Start(record, parameters, covariance, residual[part], part)


def _scan(
    record: CutRecord, parameters: np.ndarray, sd: np.ndarray, number: int, *, signed: bool = True
) -> tuple[CutRecord, list[np.ndarray]]:
    """The most likely phases of one cut, best first, with the levels that go with them.

    returns the record, its axial force turned where it pulls, and candidates (parameter,)
    """
    D, own = record.directions, 2 * record.directions + 2
    part = record.of(first_revolutions(record, SCANNED) & (record.cut == number))
    cutter = record.cutter
    repeats = cutter.teeth if cutter.pitch is None and not np.any(parameters[2 * D : own]) else 1
    grid = np.arange(PHASES * cutter.teeth // repeats) * 2 * np.pi / (PHASES * cutter.teeth)
    if record.cuts[number].angle_from == "stated":
        grid = np.zeros(1)
    target = (part.force / sd).ravel()
    found = []
    for phase in grid:
        p = parameters.copy()
        p[0 : 2 * D : 2] = 0.0
        p[own + number] = phase
        columns = part.through_chain(part.response(p, slopes=False)[1][:, :, 0 : 2 * D : 2]) / sd[:, np.newaxis]
        matrix = columns.reshape(len(target), D)
        level = np.linalg.lstsq(matrix, target, rcond=None)[0]
        cost = float(np.sum((target - matrix @ level) ** 2))
        if level[0] > 0:
            found.append((cost, phase, level))
    if not found:
        raise IllPosedError(
            f"{record.cuts[number].name}: no spindle phase gives a force that resists the cut; check the axis map, the direction "
            "of the cut and what the force acts on"
        )
    found.sort(key=lambda entry: entry[0])
    if signed and D == 3 and found[0][2][2] < 0:
        record = replace(record, sign=np.where(np.array(record.axes) == "z", -1.0, 1.0))
    apart: list[np.ndarray] = []
    for _, phase, level in found:
        if len(apart) == 3:
            break
        if any(
            abs(np.angle(np.exp(1j * (phase - p[own + number])))) < 2.5 * (2 * np.pi / PHASES / cutter.teeth)
            for p in apart
        ):
            continue
        p = parameters.copy()
        p[0 : 2 * D : 2] = np.log(np.maximum(np.abs(level), 0.02 * level[0]))
        p[own + number] = phase
        apart.append(p)
    return record, apart


def _only_cut(record: CutRecord, number: int, fixed: np.ndarray) -> np.ndarray:
    """Fixed too: the phases of other cuts; that of this one is free."""
    mask = fixed.copy()
    own = 2 * record.directions + 2
    mask[own:] = np.arange(len(record.cuts)) != number
    return mask


def _refined(
    part: CutRecord, parameters: np.ndarray, sd: np.ndarray, fixed: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Least squares with the prior; parameters, cost, covariance and residual (sample, axis) N."""
    from scipy.optimize import least_squares

    D, own = part.directions, 2 * part.directions + 2
    mean, prior_sd = prior_of(part, parameters)
    free = np.flatnonzero(~fixed)
    low, high = np.full(len(parameters), -np.inf), np.full(len(parameters), np.inf)
    low[1 : 2 * D : 2], high[1 : 2 * D : 2] = SHAPE_RANGE[part.law]
    low[2 * D : own], high[2 * D : own] = -MOST_RUNOUT, MOST_RUNOUT
    settled = part.settled(part.memory)  # a low-pass begins at rest here, and did not there
    unit = prior_sd[free]

    def spread(x: np.ndarray) -> np.ndarray:
        p = parameters.copy()
        p[free] = x * unit
        return p

    last: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The force, and its slopes before the chain, whose filtering a step that is rejected does not need."""
        key = x.tobytes()
        if key not in last:
            last.clear()
            last[key] = part.response(spread(x), slopes=False)
        return last[key]

    def residual(x: np.ndarray) -> np.ndarray:
        p = spread(x)
        off = (at(x)[0] - part.force) / sd
        return np.concatenate([off[settled].ravel(), ((p - mean) / prior_sd)[free]])

    def slopes(x: np.ndarray) -> np.ndarray:
        p = spread(x)
        own_slopes = part.through_chain(at(x)[1])
        columns = np.concatenate([own_slopes, part.phase_slopes(p)], axis=2)[:, :, free] / sd[:, np.newaxis]
        return np.concatenate([columns[settled].reshape(-1, len(free)) * unit, np.diag(unit / prior_sd[free])])

    begin = np.clip(parameters, low + 1e-3 * prior_sd, high - 1e-3 * prior_sd)
    found = least_squares(
        residual,
        begin[free] / unit,
        slopes,
        bounds=(low[free] / unit, high[free] / unit),
        xtol=1e-7,
        ftol=1e-8,
        max_nfev=40,
    )
    p = spread(found.x)
    covariance = np.zeros((len(p), len(p)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac.T @ found.jac) * np.outer(unit, unit)
    p[own:] %= 2 * np.pi
    return p, float(2 * found.cost), covariance, part.force - part.response(p, slopes=False)[0]
