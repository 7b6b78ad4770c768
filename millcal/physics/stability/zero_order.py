"""Zero-order stability limit of milling in x and y, solved for the spindle speed one asks about.

The force on the tool is F = -b Q(phi) [r(t) - r(t - tau)] with b the axial depth and tau the tooth period. Altintas and
Budak replace Q by its mean over a revolution, a constant matrix Q in N/m^2, so that the loop closes where

    det(I + b (1 - e^{-j w tau}) G(w) Q) = 0.

With m an eigenvalue of the oriented receptance G Q this says m b = -1/2 + (j/2) cot(w tau / 2), that is

    b = -1 / (2 Re m),   Re m < 0,       w tau / 2 = arg m - pi/2 + n pi,   n integer.

Peers sweep w, compute a depth and one spindle speed per lobe, and leave the lower envelope of the curves to the eye or to
an interpolation. Here tau is given and the second equation is solved for w, so that the limit is exact at every speed and
low speeds, where hundreds of lobes crowd, need nothing special. Every solution is a crossing of a whole number by
w tau / 2 pi - arg m / pi + 1/2. The crossings are bracketed on a frequency grid that resolves the modes, the strongest
(largest -Re m) first, until nothing weaker can win; then they are polished on the continuous receptance.

Signs (glossary): angles clockwise from +y, feed along +x; up milling from 0 to arccos(1 - 2 a_e/D), down from
pi - arccos(..) to pi. The factors of Altintas are alpha = -(2 / K_tc) * integral of Q dphi over the engagement.

The zero-order theory knows one pitch (the mean is used), no helix, and no period doubling: at small radial immersion
with few teeth flip lobes lie outside it, and the true limit can be half of what it says.

References
----------
Altintas, Budak 1995, Analytical prediction of stability lobes in milling, CIRP Annals 44.
Altintas, Manufacturing Automation, 2nd ed., section 4.5.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.physics.stability.regeneration import TipModes
from millcal.physics.structure import Mode, receptance

WEAKEST_PEAK = 0.1  # share of the largest -Re m: the depths that go with it are ten times the absolute minimum


class Limit(NamedTuple):
    """The first loss of stability at each spindle speed; inf, nan and -1 where there is none in the range searched."""

    depth: np.ndarray  # b, (speed,), m
    frequency: np.ndarray  # chatter frequency, (speed,), Hz
    lobe: np.ndarray  # whole waves between two teeth, (speed,), integer


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The receptance at the tip as a function, and a grid of frequencies that resolves it."""

    at: Callable[[np.ndarray], np.ndarray]  # frequency (n,) Hz -> complex (n, 2, 2) m/N
    grid: np.ndarray  # (frequency,) Hz, ascending, > 0
    on_grid: np.ndarray  # complex (frequency, 2, 2) m/N


def directional_integrals(entry: float, leave: float) -> np.ndarray:
    """Integrals over the engagement of Q(phi) per unit of K_tc and of K_rc.

    entry, leave : rad   returns (2, 2, 2): [0] belongs to K_tc, [1] to K_rc; then (force x y, motion x y)
    """
    ss = (leave - entry) / 2 - (np.sin(2 * leave) - np.sin(2 * entry)) / 4  # of sin^2
    cc = (leave - entry) / 2 + (np.sin(2 * leave) - np.sin(2 * entry)) / 4  # of cos^2
    sc = (np.sin(leave) ** 2 - np.sin(entry) ** 2) / 2  # of sin cos
    return np.array([[[sc, cc], [-ss, -sc]], [[ss, sc], [sc, cc]]])


def directional_factors(entry: float, leave: float, radial_ratio: float) -> np.ndarray:
    """alpha_xx, alpha_xy; alpha_yx, alpha_yy of Altintas and Budak for K_r = K_rc / K_tc.   returns (2, 2)"""
    tangential, radial = directional_integrals(entry, leave)
    return -2 * (tangential + radial_ratio * radial)


def mean_cutting_matrix(ktc: float, krc: float, *, teeth: int, entry: float, leave: float) -> np.ndarray:
    """Q, the mean over a revolution of the force per depth against the regenerative motion.

    ktc, krc : N/m^2   entry, leave : rad   returns (2, 2) N/m^2
    """
    tangential, radial = directional_integrals(entry, leave)
    return teeth / (2 * np.pi) * (ktc * tangential + krc * radial)


def dynamics_of_modes(modes: Iterable[Mode], spindle_speed: np.ndarray, teeth: int) -> Dynamics:
    """The continuous receptance of modes along machine axes, searched as far as they can chatter; those along z take no part.

    spindle_speed : (speed,) rad/s, the speeds to be asked
    """
    modes = tuple(mode for mode in modes if mode.axis in ("x", "y"))
    natural = np.array([mode.natural_frequency for mode in modes])
    damping = np.array([mode.damping_ratio for mode in modes])

    def at(frequency: np.ndarray) -> np.ndarray:
        return receptance(frequency, modes, axes=("x", "y"))

    return dynamics_of_receptance(at, natural, damping, search_range(natural, spindle_speed, teeth))


def dynamics_of_tip(tip: TipModes, spindle_speed: np.ndarray, teeth: int) -> Dynamics:
    """`dynamics_of_modes` for modes of any direction, complex ones among them.   spindle_speed : (speed,) rad/s"""
    natural, damping = np.abs(tip.pole) / (2 * np.pi), -tip.pole.real / np.abs(tip.pole)
    return dynamics_of_receptance(tip.receptance, natural, damping, search_range(natural, spindle_speed, teeth))


def search_range(natural_frequency: np.ndarray, spindle_speed: np.ndarray, teeth: int) -> tuple[float, float]:
    """From far below to far above all modes, Hz.

    Above all modes the depth grows with the frequency, and one tooth frequency holds a whole lobe: three times the higher
    of both is beyond the lowest solution of every speed.
    """
    tooth_frequency = np.asarray(spindle_speed) * teeth / (2 * np.pi)
    low = 0.01 * min([*natural_frequency, tooth_frequency.min()])
    return low, 3 * max([*natural_frequency, tooth_frequency.max()])


def dynamics_of_receptance(
    at: Callable[[np.ndarray], np.ndarray],
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    band: tuple[float, float],
) -> Dynamics:
    """A continuous receptance within a band, with a grid about each of its resonances.

    at : frequency (n,) Hz -> complex (n, 2, 2) m/N   natural_frequency, damping_ratio : (mode,) Hz, 1   band : Hz, > 0
    """
    grid = resonance_grid(natural_frequency, damping_ratio, band)
    return Dynamics(at, grid, at(grid))


def resonance_grid(
    natural_frequency: np.ndarray, damping_ratio: np.ndarray, band: tuple[float, float], *, per_mode: int = 241
) -> np.ndarray:
    """Frequencies of a band, dense at the resonances: within +-74 half widths `per_mode` lines each.   returns (line,) Hz"""
    low, high = band
    half_widths = np.sinh(np.linspace(-5, 5, per_mode))
    pieces = [np.geomspace(low, high, 2 + int(np.log(high / low) * per_mode / 2.41))]
    pieces += [f * (1 + zeta * half_widths) for f, zeta in zip(natural_frequency, damping_ratio, strict=True)]
    grid = np.unique(np.concatenate(pieces))
    return grid[(grid >= low) & (grid <= high)]


def dynamics_of_lines(frequency: np.ndarray, values: np.ndarray, *, per_line: int = 4) -> Dynamics:
    """A measured receptance matrix, joined by a cubic spline of its complex values (error: fourth power of the spacing).

    The spline goes through the lines and so keeps their noise; smoothing is the business of who estimates or fits the FRF.

    frequency : (frequency,) Hz, ascending, > 0   values : complex (frequency, 2, 2) m/N   per_line : cells between two lines
    """
    spline = joined(frequency, values)
    steps = np.arange(per_line) / per_line
    grid = np.append((frequency[:-1, None] + np.diff(frequency)[:, None] * steps).ravel(), frequency[-1])
    return Dynamics(spline, grid, spline(grid))


def joined(frequency: np.ndarray, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The curve between lines: a cubic spline of complex values.   frequency : (frequency,) Hz   values : (frequency, ...)"""
    from scipy.interpolate import CubicSpline

    return CubicSpline(frequency, values)


def limit_of_one_mode(spindle_speed: np.ndarray, mode: Mode, cutting: np.ndarray, teeth: int) -> Limit:
    """Limit of a single mode along x or y: one root per lobe, and only the two lobes about the weakest frequency.

    With A = Q_xx (or Q_yy), w tau/2 - atan((k - m w^2) / (c w)) = n pi has exactly one root for each n >= 0, and its depth
    is b = ((k - m w^2)^2 + c^2 w^2) / (2 |A| |k - m w^2|), for w > w_n where A > 0 and w < w_n where A < 0. Over w that has
    one minimum, at w_n sqrt(1 +- 2 zeta): the roots on both sides of it are the only candidates.

    spindle_speed : (speed,) rad/s   cutting : Q, (2, 2) N/m^2
    """
    axis = "xy".index(mode.axis)
    stiffness, zeta = float(cutting[axis, axis]), mode.damping_ratio  # A
    spindle_speed = np.asarray(spindle_speed, float)
    nowhere = np.full(spindle_speed.shape, np.inf)
    if stiffness == 0:
        return Limit(nowhere, nowhere * np.nan, np.full(spindle_speed.shape, -1))
    sign = np.sign(stiffness)
    # In units of the mode: r = w / w_n, and turns of the mode in a tooth period.
    turns = mode.natural_frequency * 2 * np.pi / (teeth * spindle_speed)
    weakest = np.sqrt(max(1 + sign * 2 * zeta, 0.0))
    nearest = np.floor(turns * weakest - np.arctan2(1 - weakest**2, 2 * zeta * weakest) / np.pi)
    n = nearest + np.array([[0.0], [1.0]])
    r = _phase_root(n, turns, zeta)
    u = sign * (r**2 - 1)
    valid = (u > 0) & (r > 0)
    safe = np.where(valid, u, 1.0)
    depth = np.where(valid, mode.stiffness * (u**2 + (2 * zeta * r) ** 2) / (2 * abs(stiffness) * safe), np.inf)
    first = (np.argmin(depth, axis=0), np.arange(len(turns)))
    found = np.isfinite(depth[first])
    frequency = np.where(found, r[first] * mode.natural_frequency, np.nan)
    return Limit(depth[first], frequency, np.where(found, np.floor(r[first] * turns), -1).astype(int))


def minimum_of_one_mode(mode: Mode, cutting: np.ndarray) -> tuple[float, float]:
    """The depth below which no speed chatters, 2 k zeta (1 +- zeta) / |A| at f_n sqrt(1 +- 2 zeta).   returns m, Hz

    Where A < 0 and zeta > 1/2 the weakest frequency is 0, with k / (2 |A|).
    """
    axis = "xy".index(mode.axis)
    stiffness, zeta = float(cutting[axis, axis]), mode.damping_ratio
    if stiffness == 0:
        return np.inf, np.nan
    if stiffness < 0 and zeta > 0.5:
        return mode.stiffness / (2 * abs(stiffness)), 0.0
    sign = np.sign(stiffness)
    depth = 2 * mode.stiffness * zeta * (1 + sign * zeta) / abs(stiffness)
    return float(depth), float(mode.natural_frequency * np.sqrt(1 + sign * 2 * zeta))


def _phase_root(n: np.ndarray, turns: np.ndarray, zeta: float) -> np.ndarray:
    """r with  turns r - atan2(1 - r^2, 2 zeta r) / pi = n,  by Newton within a bracket that bisection narrows.

    The left side rises strictly from -1/2 at r = 0, so n >= 0 has one root, between (n - 1/2) / turns and (n + 1/2) / turns.
    n : (lobe, speed)   turns : (speed,)   returns (lobe, speed), nan for n < 0
    """
    low, high = np.maximum(n - 0.5, 0.0) / turns, (n + 0.5) / turns
    r = np.where(n >= 0, (low + high) / 2, np.nan)
    before = np.full(r.shape, np.inf)
    for _ in range(100):
        u, v = 1 - r**2, 2 * zeta * r
        error = turns * r - np.arctan2(u, v) / np.pi - n
        slope = turns + 2 * zeta * (1 + r**2) / (u**2 + v**2) / np.pi
        low, high = np.where(error < 0, r, low), np.where(error < 0, high, r)
        step = r - error / slope
        there = np.abs(step - r) <= 1e-15 * r
        sure = (step >= low) & (step <= high) & (np.abs(error) < before / 2)  # Newton alone can go round in a circle
        new = np.where(sure | there, step, (low + high) / 2)
        if np.all(there | np.isnan(r)):
            return new
        r, before = new, np.abs(error)
    return r


def limit(spindle_speed: np.ndarray, dynamics: Dynamics, cutting: np.ndarray, teeth: int) -> Limit:
    """The smallest positive depth over all lobes and both eigenvalues, at each spindle speed.

    spindle_speed : (speed,) rad/s, > 0   cutting : Q, (2, 2) N/m^2
    """
    return limit_along(spindle_speed, oriented(dynamics, cutting), teeth)


@dataclass(frozen=True, eq=False)
class Branches:
    """The eigenvalues of G Q along the grid, each continuous, with the grid refined at the maxima of -Re m."""

    dynamics: Dynamics
    cutting: np.ndarray
    grid: np.ndarray  # (frequency,) Hz
    root: np.ndarray  # (frequency,) 1/m: half the difference of the eigenvalues, of continuous sign
    strength: np.ndarray  # (2, frequency) 1/m: -Re m, half the inverse depth
    phase: np.ndarray  # (2, frequency): arg m / pi - 1/2, unwrapped


def oriented(dynamics: Dynamics, cutting: np.ndarray, *, halvings: int = 36) -> Branches:
    """Follow both eigenvalues of the oriented receptance along the grid.

    The grid gets a line at each maximum of -Re m, so that between two lines the depth is monotone: then of all crossings
    in a cell the one nearest to its stronger end is the lowest, however many lobes the cell holds. Far weaker maxima, the
    noise between resonances, are left: only at speeds where a cell holds several lobes would they count, and never there.

    halvings : steps in search of each maximum; 36 find it to 3e-8 of a cell, 8 to a fiftieth, which costs the minimum 1e-7
    """
    grid, root, strength, _ = _follow(dynamics.grid, dynamics.on_grid, cutting)
    branches = Branches(dynamics, cutting, grid, root, strength, strength)
    inner = strength[:, 1:-1]
    matters = inner > WEAKEST_PEAK * max(strength.max(), 0.0)
    branch, top = np.nonzero((inner > strength[:, :-2]) & (inner >= strength[:, 2:]) & matters)
    peaks = _highest(branches, branch, grid[top], grid[top + 2], halvings)
    merged = np.concatenate([grid, peaks])
    order = np.argsort(merged, kind="stable")
    fresh = np.concatenate([dynamics.on_grid, dynamics.at(peaks)])
    grid, first = np.unique(merged[order], return_index=True)
    return Branches(dynamics, cutting, *_follow(grid, fresh[order][first], cutting))


def _follow(
    grid: np.ndarray, matrix: np.ndarray, cutting: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Grid, root, strength and phase of `Branches` from the receptance on a grid."""
    trace, determinant, root = _quadratic(matrix, cutting)
    turned = np.real(np.conj(root[:-1]) * root[1:]) < 0
    root = root * np.concatenate([[1.0], np.cumprod(np.where(turned, -1.0, 1.0))])
    value = np.stack(_eigenvalues(trace, determinant, root))
    return grid, root, -value.real, np.unwrap(np.angle(value), axis=1) / np.pi - 0.5


def _quadratic(matrix: np.ndarray, cutting: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace and determinant of G Q, and half the difference of its eigenvalues.   matrix : G, (n, 2, 2)   returns 3 x (n,)"""
    trace = np.einsum("nij,ji->n", matrix, cutting)
    determinant = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
    determinant = determinant * (cutting[0, 0] * cutting[1, 1] - cutting[0, 1] * cutting[1, 0])
    return trace, determinant, np.sqrt(trace**2 / 4 - determinant)


def _eigenvalues(trace: np.ndarray, determinant: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both eigenvalues; the smaller from the product, so that a structure with one axis has an exact zero."""
    plus, minus = trace / 2 + root, trace / 2 - root
    plus_is_large = np.abs(plus) >= np.abs(minus)
    large = np.where(plus_is_large, plus, minus)
    small = determinant / np.where(large == 0, 1.0, large)
    return np.where(plus_is_large, large, small), np.where(plus_is_large, small, large)


def _eigenvalue_near(branches: Branches, branch: np.ndarray, cell: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """The eigenvalue of a branch within a cell of the grid.   branch, cell, frequency : (n,)   returns complex (n,) 1/m"""
    trace, determinant, root = _quadratic(branches.dynamics.at(frequency), branches.cutting)
    reference = branches.root[cell] + branches.root[cell + 1]
    root = np.where(np.real(np.conj(reference) * root) < 0, -root, root)
    plus, minus = _eigenvalues(trace, determinant, root)
    return np.where(branch == 0, plus, minus)


def _highest(branches: Branches, branch: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int) -> np.ndarray:
    """Frequencies of the maxima of -Re m between low and high, by golden section.   returns (n,) Hz"""
    if not len(branch):
        return np.empty(0)
    ratio = (np.sqrt(5) - 1) / 2

    def strength(frequency: np.ndarray) -> np.ndarray:
        cell = np.clip(np.searchsorted(branches.grid, frequency, side="right") - 1, 0, len(branches.grid) - 2)
        return -_eigenvalue_near(branches, branch, cell, frequency).real

    left, right = high - ratio * (high - low), low + ratio * (high - low)
    at_left, at_right = strength(left), strength(right)
    for _ in range(steps):
        falling = at_left > at_right
        low, high = np.where(falling, low, left), np.where(falling, right, high)
        new = np.where(falling, high - ratio * (high - low), low + ratio * (high - low))
        at_new = strength(new)
        left, right = np.where(falling, new, right), np.where(falling, left, new)
        at_left, at_right = np.where(falling, at_new, at_right), np.where(falling, at_left, at_new)
    return (low + high) / 2


def absolute_minimum(branches: Branches) -> tuple[float, float]:
    """The depth below which no spindle speed chatters, and where.   returns m, Hz; inf and nan when nothing chatters"""
    branch, line = np.unravel_index(np.argmax(branches.strength), branches.strength.shape)
    strength = branches.strength[branch, line]
    if not strength > 0:
        return np.inf, np.nan
    return float(1 / (2 * strength)), float(branches.grid[line])


def limit_along(spindle_speed: np.ndarray, branches: Branches, teeth: int) -> Limit:
    """`limit`, for eigenvalues already followed."""
    period = 2 * np.pi / (teeth * np.asarray(spindle_speed, float))  # tau, s
    speed, branch, cell, whole = _crossings(period, branches)
    frequency, error = _polish(period[speed], whole, branches, branch, cell)
    strength = -_eigenvalue_near(branches, branch, cell, frequency).real
    strength[np.abs(error) > 1e-6] = 0.0  # a jump of the phase between two lines, no solution
    best = np.full(period.shape, 0.0)
    np.maximum.at(best, speed, strength)
    found = best > 0
    chatter = np.full(period.shape, np.nan)
    first = (strength >= best[speed]) & (strength > 0)
    chatter[speed[first]] = frequency[first]
    depth = np.where(found, 1 / (2 * np.where(found, best, 1.0)), np.inf)
    lobe = np.where(found, np.floor(np.where(found, chatter, 0.0) * period), -1)
    return Limit(depth, chatter, lobe.astype(int))


def _crossings(period: np.ndarray, branches: Branches) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The crossings of whole numbers by  f tau - phase  that can be the lowest limit of their speed.

    Cells are taken from the strongest down; a speed is done when the strongest cell left cannot beat what it has.
    period : (speed,) s   returns speed, branch, cell, whole number: integers (n,)
    """
    ends = np.maximum(branches.strength[:, :-1], branches.strength[:, 1:])  # (2, cell)
    order = np.argsort(-ends, axis=None, kind="stable")
    order = order[: np.count_nonzero(ends > 0)]
    branch, cell = np.unravel_index(order, ends.shape)
    bound = np.append(ends.ravel()[order], 0.0)
    f0, f1 = branches.grid[cell], branches.grid[cell + 1]
    p0, p1 = branches.phase[branch, cell], branches.phase[branch, cell + 1]
    s0, s1 = branches.strength[branch, cell], branches.strength[branch, cell + 1]

    best = np.zeros(len(period))
    active = np.arange(len(period))
    found = []
    start, size = 0, 128
    while start < len(order) and len(active):
        part = slice(start, min(start + size, len(order)))
        tau = period[active, np.newaxis]
        x0, x1 = tau * f0[part] - p0[part], tau * f1[part] - p1[part]
        row, column = np.nonzero(np.floor(x0) != np.floor(x1))
        x0, x1, column = x0[row, column], x1[row, column], column + start
        rises = x1 > x0
        near_end, near_start = np.floor(x1) + ~rises, np.floor(x0) + rises
        whole = np.where(s1[column] > s0[column], near_end, near_start)
        strength = s0[column] + (whole - x0) / (x1 - x0) * (s1[column] - s0[column])
        np.maximum.at(best, active[row], strength)
        found.append((active[row], column, whole, strength))
        start, size = part.stop, min(2 * size, 4096)
        active = active[best[active] < 1.02 * bound[start]]  # 2 %: the interpolated strength is an estimate
    if not found:
        return (np.empty(0, int),) * 4
    speed, column, whole, strength = (np.concatenate(parts) for parts in zip(*found, strict=True))
    keep = strength > 0.95 * best[speed]
    speed, column, whole = speed[keep], column[keep], whole[keep]
    return speed, branch[column], cell[column], whole


def _polish(
    period: np.ndarray, whole: np.ndarray, branches: Branches, branch: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Frequency in the cell where  f tau - phase  is the whole number, by false position (Illinois).

    returns (n,) Hz, and what is left of the difference (n,)
    """
    low, high = branches.grid[cell], branches.grid[cell + 1]
    p0, p1 = branches.phase[branch, cell], branches.phase[branch, cell + 1]
    e0, e1 = period * low - p0 - whole, period * high - p1 - whole
    width, origin = high - low, low
    frequency = new = low
    error = e0
    for _ in range(60):
        gap = e1 - e0
        share = np.where(gap != 0, -e0 / np.where(gap != 0, gap, 1.0), 0.5)
        new = low + np.clip(share, 0.0, 1.0) * (high - low)
        phase = np.angle(_eigenvalue_near(branches, branch, cell, new)) / np.pi - 0.5
        expected = p0 + (new - origin) / width * (p1 - p0)
        error = period * new - phase - 2 * np.round((expected - phase) / 2) - whole
        same = np.sign(error) == np.sign(e1)
        low, e0 = np.where(same, low, high), np.where(same, e0 / 2, e1)
        high, e1 = new, error
        if not np.any(np.abs(new - frequency) > 1e-15 * new):
            break
        frequency = new
    return new, error


def inverse_depth_sd(
    limit: Limit, spindle_speed: np.ndarray, branches: Branches, variance: np.ndarray, teeth: int, step: float
) -> np.ndarray:
    """Standard deviation of 1/b that circular complex errors of the receptance cause, to first order.

    An error dG at the chatter frequency moves the eigenvalue by dm = (m dtr - ddet) / (2 m - tr), and with the tooth period
    held the frequency by dw = Im(dm/m) / (tau/2 - Im(m'/m)), so that -d(Re m) = Re(kappa dm) with
    kappa = -1 + j Re(m') / (tau/2 - Im(m'/m)) / m. Errors of the entries are taken as independent.

    spindle_speed : (speed,) rad/s   variance : E|dG|^2 at the chatter frequencies, (speed, 2, 2) m^2/N^2
    step : Hz, for the slope m', e.g. the line spacing   returns (speed,) 1/m, 0 where there is no limit
    """
    found = np.isfinite(limit.depth)
    frequency = limit.frequency[found]
    cutting, grid = branches.cutting, branches.grid

    def nearest(frequency: np.ndarray, value: np.ndarray) -> np.ndarray:
        plus, minus = _eigenvalues(*_quadratic(branches.dynamics.at(frequency), cutting))
        return np.where(np.abs(plus - value) <= np.abs(minus - value), plus, minus)

    matrix = branches.dynamics.at(frequency)
    trace, determinant, root = _quadratic(matrix, cutting)
    pair = np.stack(_eigenvalues(trace, determinant, root))
    strength = 1 / (2 * limit.depth[found])
    value = pair[np.argmin(np.abs(-pair.real - strength), axis=0), np.arange(len(frequency))]
    below, above = np.maximum(frequency - step, grid[0]), np.minimum(frequency + step, grid[-1])
    slope = (nearest(above, value) - nearest(below, value)) / (2 * np.pi * (above - below))

    adjugate = np.stack([matrix[:, 1, 1], -matrix[:, 1, 0], -matrix[:, 0, 1], matrix[:, 0, 0]], axis=1).reshape(
        -1, 2, 2
    )
    by_entry = value[:, None, None] * cutting.T - adjugate * np.linalg.det(cutting)
    by_entry = by_entry / (2 * value - trace)[:, None, None]
    tau = 2 * np.pi / (teeth * np.asarray(spindle_speed)[found])
    kappa = -1 + 1j * slope.real / (tau / 2 - np.imag(slope / value)) / value
    spread = np.zeros(found.shape)
    # half of E|dG|^2 lies along any one direction of the complex plane; 1/b = 2 strength
    spread[found] = 2 * np.sqrt(0.5 * np.abs(kappa) ** 2 * np.sum(np.abs(by_entry) ** 2 * variance[found], axis=(1, 2)))
    return spread
