"""Modes of a linear system from an estimated frequency response: all channels and inputs in one least-squares problem.

Frequencies and damping ratios are common to all channels and enter nonlinearly; residues and the remainder of modes outside
the band enter linearly and are projected out (Golub & Pereyra 1973, Kaufman 1975), channel by channel, so that the search
has two unknowns a mode whatever the number of channels. The basis comes from `modal_basis` with its exact losses, and its
derivatives are analytic.

Every channel is whitened: a row of the estimate H = X F^H S_ff^-1 has the covariance sigma^2 S_ff^-1, so H L / sigma with
L L^H = S_ff has white noise of unit variance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.modal_basis import Loss, pole_of, pole_slopes, pole_terms

LARGEST_DAMPING = 0.9


class Channels(NamedTuple):
    """Rows of a frequency response that were estimated together: all outputs of one test to its inputs."""

    s: np.ndarray  # (line,) complex, 1/s
    values: np.ndarray  # (output, line, input) complex
    root: np.ndarray  # (line, input, input) L with L L^H = S_ff; of one input: the square root of S_ff
    noise: np.ndarray  # (output,) standard deviation of the real and of the imaginary part of the noise in a line
    power: np.ndarray  # (output,) of s by which each output's form differs from the receptance
    loss: Loss | None  # what windows took away; None: nothing is known of them
    excess: float = 0.0  # cost that noise of the force is expected to leave beside that of the response


class Model(NamedTuple):
    """Which terms stand in the model."""

    complex_modes: bool
    remainder: tuple[int, ...]  # powers of s in the receptance


class Fit(NamedTuple):
    """Frequencies and damping, and what follows from them."""

    natural_frequency: np.ndarray  # (mode,) Hz
    damping_ratio: np.ndarray  # (mode,)
    linear: tuple[np.ndarray, ...]  # of each test: (output, unknown)
    cost: float  # squared residual over the noise
    rows: int  # real numbers fitted
    unknowns: int
    expected: float  # cost of noise alone


class _Solved(NamedTuple):
    """One test at given poles: the linear unknowns solved for, whitened and stacked as real rows.

    Outputs whose functions are alike, as where no window took anything away, share one basis: "base" is 1, or output.
    """

    basis: np.ndarray  # Q of the functions, (base, row, unknown)
    triangle: np.ndarray  # R of the functions with columns of unit length, (base, unknown, unknown)
    scale: np.ndarray  # (output, unknown) length of the columns over the noise
    linear: np.ndarray  # (output, unknown)
    residual: np.ndarray  # (output, row) over the noise
    moving: np.ndarray  # derivatives of the modes' functions by ln f_n and ln zeta, (base, row, 2, modal unknown)
    strength: np.ndarray  # linear unknowns of the modes over the noise, (output, modal unknown)


def columns(
    channels: Channels, natural_frequency: np.ndarray, damping_ratio: np.ndarray, model: Model, *, exact: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Functions of the model, not whitened, and their derivatives by ln f_n and ln zeta.

    Each mode has the column alpha / (s^2 + 2 zeta w s + w^2), and a second one with s in the numerator for complex modes;
    the remainder has one column for each power of s. Each column stands once for every input that it may belong to.

    exact : False for the frequency response of the structure itself, without the losses of the windows
    returns complex (output, line, input, unknown) and (2, output, line, input, unknown), the latter without the remainder;
        one output stands for all where they have the same functions
    """
    m, n = channels.values.shape[2], len(natural_frequency)
    s, power = channels.s, channels.power
    if not exact or channels.loss is None:
        channels = channels._replace(loss=None)
        power = power[:1] if (power == power[0]).all() else power
    p = pole_of(natural_frequency, damping_ratio)
    value, slope = pole_terms(s, np.concatenate([p, p.conj()]), power, channels.loss, m)
    turn = pole_slopes(natural_frequency, damping_ratio)  # (2, mode)

    def shaped(a: np.ndarray) -> np.ndarray:  # a number for each mode among (output, mode, line, input, input)
        return a[:, None, None, None]

    gap = shaped(p - p.conj())
    functions, slopes = [], []
    for order in range(2 if model.complex_modes else 1):  # p^order phi(p), over the gap
        weight, weight_slope = p**order, (np.ones(n) if order else np.zeros(n))
        up, down = value[:, :n], value[:, n:]
        column = (shaped(weight) * up - shaped(weight.conj()) * down) / gap
        functions.append(column)
        own = []
        for d in turn:
            rise = shaped(d * weight_slope) * up + shaped(d * weight) * slope[:, :n]
            sink = shaped((d * weight_slope).conj()) * down + shaped((d * weight).conj()) * slope[:, n:]
            own.append((rise - sink - shaped(d - d.conj()) * column) / gap)
        slopes.append(np.stack(own))
    modal = np.stack(functions, axis=2)  # (output, mode, order, line, source, input)
    modal_slope = np.stack(slopes, axis=3)
    rest = np.zeros((len(power), len(model.remainder), len(s), m, m), complex)
    for k, remainder in enumerate(model.remainder):
        rest[:, k, :, range(m), range(m)] = (s ** (power[:, None] + remainder))[None]
    flat = [
        np.moveaxis(part, (-3, -1, -2), (1, 2, -1)).reshape(len(power), len(s), m, part.shape[1] * m)
        for part in (modal.reshape(len(power), modal.shape[1] * modal.shape[2], *modal.shape[3:]), rest)
    ]
    count = modal.shape[1] * modal.shape[2]
    flat_slope = np.moveaxis(modal_slope.reshape(2, len(power), count, *modal.shape[3:]), (-3, -1, -2), (2, 3, -1))
    return np.concatenate(flat, axis=-1), flat_slope.reshape(2, len(power), len(s), m, count * m)


def combined(functions: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """The model of all outputs.   functions : (output or 1, line, input, unknown)   linear : (output, unknown)"""
    return (functions @ linear[:, None, :, None])[..., 0]


def whitened(channels: Channels, matrix: np.ndarray) -> np.ndarray:
    """H L / sigma with lines and inputs as real rows.   matrix : (output, line, input)   returns (output, row)"""
    return _rows(channels, matrix) / channels.noise[:, None]


def _rows(channels: Channels, matrix: np.ndarray) -> np.ndarray:
    """H L with lines and inputs as real rows.   matrix : (output or 1, line, input, ...)   returns (output or 1, row, ...)"""
    if channels.root.shape[-1] == 1:
        rooted = matrix * channels.root[:, 0, 0].reshape(1, -1, 1, *[1] * (matrix.ndim - 3))
    else:
        rooted = np.einsum("oli...,lij->olj...", matrix, channels.root)
    rows = rooted.reshape(len(matrix), matrix.shape[1] * matrix.shape[2], *matrix.shape[3:])
    return np.concatenate([rows.real, rows.imag], axis=1)


def _solve(channels: Channels, fn: np.ndarray, zeta: np.ndarray, model: Model) -> _Solved:
    """Solve for the linear unknowns at given poles."""
    functions, slopes = columns(channels, fn, zeta, model)
    a, y = _rows(channels, functions), _rows(channels, channels.values)
    scale = np.linalg.norm(a, axis=1)
    scale = np.where(scale > 0, scale, 1.0)
    q, r = np.linalg.qr(a / scale[:, None, :])
    z = (y[:, None, :] @ q)[:, 0]  # (output, unknown)
    noise = channels.noise[:, None]
    linear = np.linalg.solve(r, z[..., None])[..., 0] / scale
    residual = (y - (q @ z[..., None])[..., 0]) / noise
    modal = slopes.shape[-1]
    moving = _rows(channels, np.moveaxis(slopes, 0, 3))
    return _Solved(q, r, scale / noise, linear, residual, moving, linear[:, :modal] / noise)


def _normal(parts: Sequence[_Solved], modes: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, normal matrix and gradient of the projected problem, with Kaufman's Jacobian."""
    cost, normal, gradient = 0.0, np.zeros((2, modes, 2, modes)), np.zeros((2, modes))
    for part in parts:
        base, row, _, modal = part.moving.shape
        each = modal // max(modes, 1)  # unknowns of a mode
        D = part.moving.reshape(base, row, 2 * modal)
        D = D - part.basis @ (np.swapaxes(part.basis, 1, 2) @ D)
        products = (np.swapaxes(D, 1, 2) @ D).reshape(base, 2, modal, 2, modal)
        along = (part.residual[:, None, :] @ D).reshape(-1, 2, modal)  # (output, ...)
        pairs = part.strength[:, :, None] * part.strength[:, None, :]  # (output, modal, modal)
        pairs = pairs.sum(axis=0, keepdims=True) if base == 1 else pairs
        weighted = np.sum(products * pairs[:, None, :, None, :], axis=0)
        normal += weighted.reshape(2, modes, each, 2, modes, each).sum(axis=(2, 5))
        gradient += np.sum(along * part.strength[:, None], axis=0).reshape(2, modes, each).sum(axis=2)
        cost += float(np.sum(part.residual**2))
    return cost, normal.reshape(2 * modes, 2 * modes), gradient.ravel()


def fit_poles(
    tests: Sequence[Channels],
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    model: Model,
    *,
    tolerance: float = 1e-9,
    smallest_step: float = 1e-6,
    max_steps: int = 60,
) -> Fit:
    """Refine poles by Levenberg and Marquardt's damping of the projected Gauss-Newton step.

    tolerance, smallest_step : relative fall of the cost and relative change of a pole that end the search together
    """
    fn, zeta = np.array(natural_frequency, float), np.array(damping_ratio, float)
    parts = [_solve(channels, fn, zeta, model) for channels in tests]
    if len(fn):
        damping = 1e-4
        cost, normal, gradient = _normal(parts, len(fn))
        for _ in range(max_steps):
            diagonal = np.maximum(np.diag(normal), 1e-300)
            step = np.linalg.solve(normal + damping * np.diag(diagonal), gradient)
            step *= min(1.0, 0.5 / max(np.abs(step).max(), 1e-300))  # half an e-fold a step at most
            new_fn = fn * np.exp(step[: len(fn)])
            new_zeta = np.minimum(zeta * np.exp(step[len(fn) :]), LARGEST_DAMPING)
            tried = [_solve(channels, new_fn, new_zeta, model) for channels in tests]
            new_cost, new_normal, new_gradient = _normal(tried, len(fn))
            if new_cost < cost:
                fallen = 1.0 - new_cost / cost
                fn, zeta, parts, cost, normal, gradient = new_fn, new_zeta, tried, new_cost, new_normal, new_gradient
                damping = max(damping / 10.0, 1e-12)
                if fallen < tolerance and np.abs(step).max() < smallest_step:
                    break
            elif np.abs(step).max() < 1e-13 or damping > 1e8:
                break
            else:
                damping = 10.0 * max(damping, 1e-8)
    order = np.argsort(fn)
    if (order != np.arange(len(fn))).any():
        fn, zeta = fn[order], zeta[order]
        parts = [_solve(channels, fn, zeta, model) for channels in tests]
    rows = sum(part.residual.size for part in parts)
    return Fit(
        fn,
        zeta,
        tuple(part.linear for part in parts),
        float(sum(np.sum(part.residual**2) for part in parts)),
        rows,
        2 * len(fn) + sum(part.linear.size for part in parts),
        rows + sum(channels.excess for channels in tests),
    )


def residual_after(tests: Sequence[Channels], fit: Fit, model: Model) -> list[np.ndarray]:
    """What the model leaves of the values, not whitened.   returns for each test complex (output, line, input)"""
    left = []
    for channels, linear in zip(tests, fit.linear, strict=True):
        phi, _ = columns(channels, fit.natural_frequency, fit.damping_ratio, model)
        left.append(channels.values - combined(phi, linear))
    return left


class Part(NamedTuple):
    """One test at a fit, linearised: residual = slope dp + basis (triangle (scale d linear))."""

    basis: np.ndarray  # (output, row, unknown), orthonormal
    triangle: np.ndarray  # (output, unknown, unknown)
    scale: np.ndarray  # (output, unknown)
    residual: np.ndarray  # (output, row)
    slope: np.ndarray  # (output, row, 2 mode)

    def linear(self, residual: np.ndarray) -> np.ndarray:
        """The change of the linear unknowns that explains a residual.   residual : (output, row)   returns (output, unknown)"""
        along = (residual[:, None, :] @ self.basis)[:, 0]
        return np.linalg.solve(self.triangle, along[..., None])[..., 0] / self.scale


class Sensitivity(NamedTuple):
    """The Gauss-Newton step at a fit: how its unknowns follow a change of the data."""

    inverse: np.ndarray  # of the projected normal matrix, (2 mode, 2 mode)
    parts: tuple[Part, ...]

    def step(self, changed: Sequence[tuple[int, np.ndarray]]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Change of the poles and of the linear unknowns, for residuals of some tests that stand in place of the fit's.

        changed : (number of the test, whitened residual (output, row)) at the fitted unknowns
        returns (2 mode,) of ln f_n then ln zeta, and of each test (output, unknown)
        """
        gradient, residuals = np.zeros(len(self.inverse)), [part.residual for part in self.parts]
        for number, residual in changed:
            residuals[number] = residual
        for part, residual in zip(self.parts, residuals, strict=True):
            along = (residual[:, None, :] @ part.basis)[:, 0]
            free = residual - (part.basis @ along[..., None])[..., 0]
            gradient += np.einsum("ork,or->k", part.slope, free)
        poles = self.inverse @ gradient
        pairs = zip(self.parts, residuals, strict=True)
        return poles, tuple(part.linear(residual - part.slope @ poles) for part, residual in pairs)

    def steps(self, number: int, changes: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The same for many changes of the residual of one test, each beside the fit's.

        changes : (output, row, change)
        returns (change, 2 mode) of ln f_n then ln zeta, and of each test (change, output, unknown)
        """
        own = self.parts[number]
        along = np.swapaxes(own.basis, 1, 2) @ changes  # (output, unknown, change)
        gradient = np.einsum("ork,orc->ck", own.slope, changes - own.basis @ along, optimize=True)
        poles = gradient @ self.inverse
        linear = []
        for part in self.parts:
            right = -(np.swapaxes(part.basis, 1, 2) @ part.slope) @ poles.T
            right = right + along if part is own else right
            linear.append(np.moveaxis(np.linalg.solve(part.triangle, right) / part.scale[:, :, None], -1, 0))
        return poles, tuple(linear)


def sensitivity(tests: Sequence[Channels], fit: Fit, model: Model) -> Sensitivity:
    """The linearised problem at a fit, for intervals."""
    modes = len(fit.natural_frequency)
    solved = [_solve(channels, fit.natural_frequency, fit.damping_ratio, model) for channels in tests]
    normal = _normal(solved, modes)[1]
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    parts = []
    for part in solved:
        outputs, modal = part.strength.shape
        by_mode = part.moving.reshape(*part.moving.shape[:3], modes, modal // modes)
        strength = part.strength.reshape(outputs, 1, 1, modes, -1)
        slope = np.sum(by_mode * strength, axis=-1).reshape(outputs, -1, 2 * modes)
        basis, triangle = (np.broadcast_to(own, (outputs, *own.shape[1:])) for own in (part.basis, part.triangle))
        parts.append(Part(basis, triangle, part.scale, part.residual, slope))
    return Sensitivity(np.linalg.pinv(normal / np.outer(scale, scale)) / np.outer(scale, scale), tuple(parts))
