"""How many modes, of which kind, and where: seeds, then one mode after the other, as long as each earns its unknowns.

A mode is added where it takes most from the residual, then all are refined together. It stays when Schwarz's criterion
falls and the squared residual by a tenth: the criterion alone never stops on real structures, where what the model cannot
describe (joints, cables, a little nonlinearity) is far above the noise.

Real modes are preferred. Where complex ones would halve what is left, a response that comes late against the hammer is
the first suspect, as one delay explains what takes a phase for every mode; only then complex modes are taken.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.mode_fit import Channels, Fit, Model, fit_poles, residual_after
from millcal.numerics.pole_search import Poles, groups_of, search_poles
from millcal.stages.modes.delays import estimate_delays, is_plausible
from millcal.stages.modes.possible import is_possible
from millcal.stages.modes.problem import Problem

REMAINDER = (-2, 0, 2)  # powers of s: mass below the band, flexibility above it, and its rise towards the next mode
ORDERS = tuple(range(2, 17))  # of the stabilisation chart
SURE = 4  # orders that have a pole which is no accident
LITTLE = 0.01  # share of the squared residual
COMPLEX_GAIN = 0.5  # share of the squared residual that complex modes may leave, to be taken
AS_GOOD = 1.2  # times the squared residual of complex modes that a delay may leave, to be believed instead

GAIN = 0.1  # share of the squared residual that a mode must take away
DAMPINGS = (0.002, 0.007, 0.025, 0.09)  # of the grid of seeds
PATIENCE = 3  # modes that may be added past a fit that is possible


class Found(NamedTuple):
    """Modes of one kind, and the delays with which they were found."""

    fit: Fit
    model: Model
    delay: np.ndarray | None = None  # (output,) s, taken out of the values; None: not asked for by the data
    delay_sd: np.ndarray | None = None


class Seeds(NamedTuple):
    """Candidates for one more mode."""

    natural_frequency: np.ndarray  # (seed,) Hz
    damping_ratio: np.ndarray
    sure: int  # the first ones, poles that several orders of the chart have


def stabilisation_chart(problem: Problem) -> Poles:
    """Poles of every order, from all pairs that were measured."""
    values, weight = problem.empty(len(problem.lines)), problem.empty(len(problem.lines), dtype=float)
    for test in problem.tests:
        channels = test.channels
        size = np.abs(np.einsum("ljj->lj", channels.root)) / np.sqrt(channels.values.shape[1])
        test.put(values, channels.values.transpose(1, 0, 2))
        test.put(weight, (size[None] / channels.noise[:, None, None]).transpose(1, 0, 2))
    weight = np.where(np.isfinite(values), np.nan_to_num(weight), 0.0)
    orders = [order for order in ORDERS if 3 * order < len(problem.lines)]
    return search_poles(problem.frequency, np.nan_to_num(values), weight / max(weight.max(), 1e-300), orders)


def thinning(problem: Problem, poles: Poles) -> int:
    """Every how many lines will do for the search: two within half the width of the narrowest pole that several orders have."""
    frequency, damping, count = groups_of(poles)
    sure = count >= SURE
    if not sure.any():
        return 1
    spacing = np.interp(frequency, problem.frequency, np.gradient(problem.frequency))  # there; lines may be uneven
    narrowest = float((frequency * damping / spacing)[sure].min())  # lines
    return int(np.clip(narrowest / 2, 1, max(1, len(problem.lines) // 200)))


def search(
    problem: Problem,
    poles: Poles,
    *,
    powers: tuple[int, ...],
    count: int | None,
    near: Sequence[float],
    complex_modes: bool | None,
    most: int,
) -> Found:
    """Real modes; with a delay, or complex, where asked for or where the data ask for them.

    powers : of the remainder   count, near, complex_modes, most : see `fit_modes`
    """
    seeds = seeds_of(poles, problem.frequency)
    real, turning = Model(False, powers), Model(True, powers)
    if _hardly_lost(problem, seeds, turning):
        problem = problem.without_losses()

    def grown(problem: Problem, model: Model) -> tuple[Fit, bool]:
        if count is None and not len(near):
            return grow(
                problem.channels, problem.frequency, seeds, model,
                most=most, possible=lambda fit: is_possible(problem, fit, model),
            )  # fmt: skip
        return grow_as_told(problem.channels, problem.frequency, seeds, model, count=count, near=near), False

    if complex_modes:
        return Found(grown(problem, turning)[0], turning)
    fit, held_back = grown(problem, real)
    if not len(fit.natural_frequency) or COMPLEX_GAIN * fit.cost <= fit.expected:  # no model leaves less than noise
        return Found(fit, real)
    rival = fit_poles(problem.channels, fit.natural_frequency, fit.damping_ratio, turning, max_steps=3)
    if not held_back and not _asks_for(rival, fit):
        return Found(fit, real)
    delay, spread = estimate_delays(problem, fit, real)
    if is_plausible(delay, spread, problem.frequency[-1]):
        in_time = problem.turned(delay)
        again, _ = grown(in_time, real)
        if again.cost < AS_GOOD * rival.cost:
            return Found(again, real, delay, spread)
    if complex_modes is None:
        rival, _ = grown(problem, turning)
        if _asks_for(rival, fit) and is_possible(problem, rival, turning):
            return Found(rival, turning)
    return Found(fit, real)


def _asks_for(rival: Fit, fit: Fit) -> bool:
    """Whether complex modes earn their unknowns."""
    return criterion(rival) < criterion(fit) and rival.cost < COMPLEX_GAIN * fit.cost


def _hardly_lost(problem: Problem, seeds: Seeds, model: Model) -> bool:
    """Whether what the windows took away changes nothing that the search could see, at the poles of the chart."""
    if not seeds.sure:
        return False
    poles = seeds.natural_frequency[: seeds.sure], seeds.damping_ratio[: seeds.sure]
    exact = fit_poles(problem.channels, *poles, model, max_steps=3)
    poles = exact.natural_frequency, exact.damping_ratio
    without = fit_poles(problem.without_losses().channels, *poles, model, max_steps=0)
    return without.cost < (1 + LITTLE) * exact.cost


def seeds_of(poles: Poles, frequency: np.ndarray) -> Seeds:
    """The groups of stable poles, and a grid for what they missed."""
    f, z, count = groups_of(poles)
    grid = np.geomspace(max(frequency[0], 0.01 * frequency[-1]), frequency[-1], 60)
    grid_f, grid_z = (axis.ravel() for axis in np.meshgrid(grid, DAMPINGS))
    return Seeds(np.concatenate([f, grid_f]), np.concatenate([z, grid_z]), int(np.sum(count >= SURE)))


def criterion(fit: Fit) -> float:
    """Schwarz's criterion, smaller is better: of the noise as it is seen, and never below what is known of it."""
    return fit.rows * float(np.log(max(fit.cost / fit.expected, 1.0))) + fit.unknowns * float(np.log(fit.rows))


def strongest(
    tests: Sequence[Channels], fit: Fit, model: Model, seeds: Seeds, frequency: np.ndarray
) -> tuple[float, float]:
    """The seed that takes most from the residual, beside the modes there are.   returns f_n Hz, zeta"""
    left = residual_after(tests, fit, model)
    energy = np.zeros(len(frequency))
    for residual, channels in zip(left, tests, strict=True):
        share = np.sum(np.abs(residual / channels.noise[:, None, None]) ** 2, axis=(0, 2))
        energy += share * np.mean(np.abs(np.einsum("ljj->lj", channels.root)) ** 2, axis=1)
    peaks = np.argsort(-energy)[:24]
    f = np.concatenate([seeds.natural_frequency, np.repeat(frequency[peaks], len(DAMPINGS))])
    z = np.concatenate([seeds.damping_ratio, np.tile(DAMPINGS, len(peaks))])
    gain = np.zeros(len(f))
    for channels, residual in zip(tests, left, strict=True):
        s = channels.s
        for j in range(channels.values.shape[2]):
            weight = np.abs(channels.root[:, j, j])
            for d in np.unique(channels.power):
                mine = channels.power == d
                gain += _gain(s, weight, int(d), f, z, fit, model, residual[mine][:, :, j] / channels.noise[mine, None])
    for fn, zeta in zip(fit.natural_frequency, fit.damping_ratio, strict=True):  # not the same mode again
        gain[np.abs(f / fn - 1.0) < 0.3 * zeta] = 0.0
    best = int(np.argmax(gain))
    return float(f[best]), float(z[best])


def _gain(
    s: np.ndarray,
    weight: np.ndarray,
    power: int,
    f: np.ndarray,
    z: np.ndarray,
    fit: Fit,
    model: Model,
    residual: np.ndarray,
) -> np.ndarray:
    """Squared residual that each seed would take, with residues of its own in each channel; losses left aside.

    residual : complex (output, line)   returns (seed,)
    """

    def modal(fn: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        w = 2 * np.pi * fn
        return (weight * s**power)[:, None] / (s[:, None] ** 2 + 2 * zeta * w * s[:, None] + w**2)

    def stacked(a: np.ndarray) -> np.ndarray:
        return np.concatenate([a.real, a.imag])

    known = [modal(fit.natural_frequency, fit.damping_ratio)]
    known += [(weight * s ** (power + k))[:, None] for k in model.remainder]
    a = stacked(np.concatenate(known, axis=1))
    norm = np.linalg.norm(a, axis=0)
    basis = np.linalg.qr(a / np.where(norm > 0, norm, 1.0))[0]
    new = stacked(modal(f, z))
    new = new / np.linalg.norm(new, axis=0)
    new -= basis @ (basis.T @ new)
    size = np.sum(new**2, axis=0)
    r = stacked((weight * residual).T)
    return np.where(size > 1e-8, np.sum((new.T @ r) ** 2, axis=1) / np.maximum(size, 1e-8), 0.0)


def grow(
    tests: Sequence[Channels],
    frequency: np.ndarray,
    seeds: Seeds,
    model: Model,
    *,
    most: int,
    possible: Callable[[Fit], bool] = lambda fit: True,
) -> tuple[Fit, bool]:
    """As many modes as the data bear: those of the chart, where they are possible together, then one after the other.

    possible : whether a fit can be a structure. With too few modes a good one may not look like it, so that growth goes on
        past what is impossible, but ends at the last fit that is not
    returns the fit, and whether the data would have borne more modes, were they possible
    """
    empty = np.zeros(0)
    fit = fit_poles(tests, empty, empty, model)
    if 0 < seeds.sure <= most:
        charted = _refined(tests, seeds.natural_frequency[: seeds.sure], seeds.damping_ratio[: seeds.sure], model)
        charted = _pruned(tests, charted, model)
        fit = charted if possible(charted) else fit
    taken = fit
    while (1 - GAIN) * fit.cost > fit.expected and len(fit.natural_frequency) < min(
        most, len(taken.natural_frequency) + PATIENCE
    ):
        tried = _with(tests, fit, model, *strongest(tests, fit, model, seeds, frequency))
        if not _earns(tried, fit):
            break
        fit = tried
        if possible(fit):
            taken = fit
    return taken, taken is not fit


def grow_as_told(
    tests: Sequence[Channels],
    frequency: np.ndarray,
    seeds: Seeds,
    model: Model,
    *,
    count: int | None,
    near: Sequence[float],
) -> Fit:
    """Modes near the frequencies that the user knows, each with the best damping of a few, and as many as there shall be."""
    empty = np.zeros(0)
    fit = fit_poles(tests, empty, empty, model)
    for fn in near:
        fit = min((_with(tests, fit, model, float(fn), zeta) for zeta in DAMPINGS[1:]), key=lambda tried: tried.cost)
    while len(fit.natural_frequency) < (count or 0):
        fit = _with(tests, fit, model, *strongest(tests, fit, model, seeds, frequency))
    return fit


def _earns(fit: Fit, without: Fit) -> bool:
    """Whether a mode more earns its unknowns."""
    return criterion(fit) < criterion(without) and fit.cost < (1 - GAIN) * without.cost


def _pruned(tests: Sequence[Channels], fit: Fit, model: Model) -> Fit:
    """The fit without the modes that do not earn their unknowns."""
    while len(fit.natural_frequency):
        each = range(len(fit.natural_frequency))
        rest = [(np.delete(fit.natural_frequency, k), np.delete(fit.damping_ratio, k)) for k in each]
        without = min((fit_poles(tests, *poles, model, max_steps=0) for poles in rest), key=lambda tried: tried.cost)
        if _earns(fit, without):
            break
        fit = _refined(tests, without.natural_frequency, without.damping_ratio, model)
    return fit


def _with(tests: Sequence[Channels], fit: Fit, model: Model, fn: float, zeta: float) -> Fit:
    """The fit with one mode more, all refined."""
    return _refined(tests, np.append(fit.natural_frequency, fn), np.append(fit.damping_ratio, zeta), model)


def _refined(tests: Sequence[Channels], natural_frequency: np.ndarray, damping_ratio: np.ndarray, model: Model) -> Fit:
    """A fit near enough to be compared with others."""
    return fit_poles(tests, natural_frequency, damping_ratio, model, tolerance=1e-3, smallest_step=1e-3, max_steps=20)
