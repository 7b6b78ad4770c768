"""Intervals of modal parameters, from leaving out one hit at a time.

The least-squares covariance knows the noise of the lines, not that of the hits: an error of the force spectrum multiplies
all responses of a hit at all frequencies alike, so that lines are not independent and the covariance comes out too small.
The jackknife over hits sees it. Each delete-one estimate is one Gauss-Newton step away from that of all hits, with the
windows' losses reckoned anew, so that it costs no search. Where hits are too few, the noise of the hammer, which is known from
the samples before the pulse, is carried through instead, beside the scatter of the lines.

References
----------
Efron, Tibshirani 1993, An Introduction to the Bootstrap, chapter 11.
"""

from typing import NamedTuple

import numpy as np

from millcal.numerics.modal_basis import pole_of, without_hit
from millcal.numerics.mode_fit import Channels, Fit, Model, Sensitivity, columns, combined, sensitivity, whitened
from millcal.stages.modes.problem import Problem

FEWEST_HITS = 3  # of a test, for a jackknife
SAMPLES = 64  # of the force that are gone through at a time
UNKNOWN = 3.0  # e-folds: a frequency or damping that is off by more is not known at all


class Deviations(NamedTuple):
    """Rows d whose products add up to the covariance, sum of d d^T, of everything that was fitted."""

    frequency: np.ndarray  # (deviation, mode) Hz
    damping: np.ndarray  # (deviation, mode)
    residue: np.ndarray  # (deviation, mode, output, input) s/kg
    dof: float
    source: str  # jackknife, least squares, none


def deviations(problem: Problem, fit: Fit, model: Model) -> Deviations:
    """Deviations by hit where every test has hits enough, else by the scatter of the lines and the noise of the hammer."""
    known = sensitivity(problem.channels, fit, model)
    if can_leave_hits_out(problem):
        return _by_hit(problem, fit, model, known)
    return _by_line(problem, fit, model, known)


def can_leave_hits_out(problem: Problem) -> bool:
    """Whether every test has hits enough for a jackknife, on all lines of the fit."""
    return not why_no_jackknife(problem)


def why_no_jackknife(problem: Problem) -> str:
    """What keeps hits from being left out one by one; empty where nothing does."""
    for test in problem.tests:
        spectra = test.spectra
        if spectra is None:
            return "the file holds no hits"
        if len(spectra.names) < max(FEWEST_HITS, len(spectra.inputs) + 2):
            n = len(spectra.names)
            hits = f"{n} hit{'s' if n > 1 else ''} at {', '.join(spectra.inputs)}"
            return f"{hits} {'are' if n > 1 else 'is'} too few to leave one out"
        if (
            not spectra.first_line
            <= problem.lines[0]
            <= problem.lines[-1]
            < spectra.first_line + spectra.response.shape[2]
        ):
            return "the band goes far beyond the usable one, where no hits are kept"
    return ""


def _by_hit(problem: Problem, fit: Fit, model: Model, known: Sensitivity) -> Deviations:
    base = residues(problem, fit, model)
    rows: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for places in hits_of(problem):
        changed = [(number, residual_without(problem, number, hit, fit, model)) for number, hit in places]
        moved = _moved(fit, *known.step(changed))
        residue = residues(problem, moved, model) - base
        step = (moved.natural_frequency - fit.natural_frequency, moved.damping_ratio - fit.damping_ratio, residue)
        rows.setdefault(places[0][0], []).append(step)
    parts, counts = [], []
    for steps in rows.values():
        n = len(steps)
        stacked = [np.stack([step[i] for step in steps]) for i in range(3)]
        parts.append([np.sqrt((n - 1) / n) * (part - part.mean(axis=0)) for part in stacked])
        counts.append(n)
    frequency, damping, residue = (np.concatenate([part[i] for part in parts]) for i in range(3))
    shares = np.stack([[np.sum(part[i] ** 2, axis=0) for i in (0, 1)] for part in parts])  # (test, 2, mode)
    freedom = np.array(counts)[:, None, None] - 1
    welch = shares.sum(axis=0) ** 2 / np.maximum(np.sum(shares**2 / freedom, axis=0), 1e-300)
    dof = float(np.median(welch)) if welch.size and np.all(shares.sum(axis=0) > 0) else float(min(counts) - 1)
    return Deviations(frequency, damping, residue, dof, "jackknife")


def hits_of(problem: Problem) -> list[list[tuple[int, int]]]:
    """Every hit: the tests it stands in, and its number there."""
    places: dict[str, list[tuple[int, int]]] = {}
    for number, test in enumerate(problem.tests):
        for hit, name in enumerate(test.spectra.names):  # type: ignore[union-attr]
            places.setdefault(name, []).append((number, hit))
    return list(places.values())


def residual_without(problem: Problem, number: int, hit: int, fit: Fit, model: Model) -> np.ndarray:
    """Whitened residual of a test at the fit, once one of its hits is left out.   returns (output, row)"""
    test = problem.tests[number]
    channels, spectra, F, P = test.channels, test.spectra, test.force, test.power
    X = spectra.response[:, :, problem.lines - spectra.first_line]
    kept = np.arange(len(F)) != hit
    noise = np.diag(spectra.force_noise / len(F))
    rest = P - np.einsum("il,jl->lij", F[hit], F[hit].conj()) + noise
    own = np.arange(rest.shape[1])
    least = 0.5 * (rest[:, own, own].real + np.diag(noise) * kept.sum())
    rest[:, own, own] = np.maximum(rest[:, own, own].real, least)
    cross = np.einsum("hol,hil->oli", X[kept], F[kept].conj())
    own = np.einsum("ol,il->oli", X[hit], F[hit].conj())
    inverse, inverse_all = np.linalg.inv(rest), np.linalg.inv(P)
    change = np.einsum("oli,lij->olj", cross, inverse) - np.einsum("oli,lij->olj", cross + own, inverse_all)
    change = change if test.turn is None else change * test.turn[:, :, None]
    loss = None if channels.loss is None else without_hit(channels.loss, hit, P @ inverse)
    left_out = channels._replace(values=channels.values + change, loss=loss)
    phi, _ = columns(left_out, fit.natural_frequency, fit.damping_ratio, model)
    return whitened(channels, left_out.values - combined(phi, fit.linear[number]))


def _moved(fit: Fit, poles: np.ndarray, linear: tuple[np.ndarray, ...]) -> Fit:
    n = len(fit.natural_frequency)
    factor = np.exp(np.clip(poles, -UNKNOWN, UNKNOWN))
    return fit._replace(
        natural_frequency=fit.natural_frequency * factor[:n],
        damping_ratio=np.minimum(fit.damping_ratio * factor[n:], 0.99),
        linear=tuple(a + b for a, b in zip(fit.linear, linear, strict=True)),
    )


def _by_line(problem: Problem, fit: Fit, model: Model, known: Sensitivity) -> Deviations:
    """Deviations from the scatter of the lines about the model, and from the noise that the hammer is known to have.

    All there is of one hit, and too small where the model does not fit. The noise of the hammer scatters no lines: it
    multiplies the whole response by an error that is smooth over a resonance, and outweighs the other where damping is light.
    """
    base = residues(problem, fit, model)
    freedom = max(fit.rows - fit.unknowns, 1)
    sd = np.sqrt(fit.cost / freedom)
    values, vectors = np.linalg.eigh(known.inverse)
    steps: list[Fit] = []
    for value, vector in zip(values, vectors.T, strict=True):
        pole = sd * np.sqrt(max(value, 0.0)) * vector
        linear = []
        for part in known.parts:
            linear.append(-part.linear(part.slope @ pole))
        steps.append(_moved(fit, pole, tuple(linear)))
    still = np.zeros(len(known.inverse))
    for number, part in enumerate(known.parts):
        inverse = sd * np.linalg.inv(part.triangle) / part.scale[:, :, None]  # columns are independent deviations
        for o in range(len(inverse)):
            for column in inverse[o].T:
                linear = [np.zeros_like(own) for own in fit.linear]
                linear[number][o] = column
                steps.append(_moved(fit, still, tuple(linear)))
    steps += _by_hammer(problem, fit, model, known)
    n = len(fit.natural_frequency)
    residue = np.stack([residues(problem, step, model) - base for step in steps])
    flat = [
        np.stack([step.natural_frequency - fit.natural_frequency for step in steps]),
        np.stack([step.damping_ratio - fit.damping_ratio for step in steps]),
        np.nan_to_num(residue.real.reshape(len(steps), -1)),
        np.nan_to_num(residue.imag.reshape(len(steps), -1)),
    ]
    rows = np.linalg.qr(np.concatenate(flat, axis=1), mode="r")  # as few as have the same products
    frequency, damping, real, imag = np.split(rows, [n, 2 * n, 2 * n + base.size], axis=1)
    residue = np.where(np.isfinite(base), (real + 1j * imag).reshape(len(rows), *base.shape), np.nan)
    return Deviations(frequency, damping, residue, float(freedom), "least squares")


def _by_hammer(problem: Problem, fit: Fit, model: Model, known: Sensitivity) -> list[Fit]:
    """One step for every sample within the force windows, of the size of its noise, which is independent of the others'.

    An error dF of one input of hit h moves H = X F^H S_ff^-1 by -H dF f_h^H S_ff^-1 to first order.
    """
    steps = []
    for number, test in enumerate(problem.tests):
        spectra, channels = test.spectra, test.channels
        if spectra is None or test.force is None or not spectra.force_noise.any():
            continue
        hits, inputs, samples = spectra.force.shape
        phi, _ = columns(channels, fit.natural_frequency, fit.damping_ratio, model)
        H = combined(phi, fit.linear[number])
        mixing = np.einsum("hil,lij->hlj", test.force.conj(), np.linalg.inv(test.power))
        noise = np.sqrt(spectra.force_noise / (hits * samples))  # of a sample
        for hit in range(hits):
            for i in range(inputs):
                moved = whitened(channels, -noise[i] * H[:, :, i, None] * mixing[hit])
                for some in np.array_split(np.arange(samples), -(-samples // SAMPLES)):
                    later = np.exp(-np.outer(channels.s, spectra.force_start[hit] + some) / spectra.sample_rate)
                    poles, linear = known.steps(number, _turned_rows(moved, np.repeat(later, inputs, axis=0)))
                    steps += [_moved(fit, pole, tuple(part[k] for part in linear)) for k, pole in enumerate(poles)]
    return steps


def _turned_rows(rows: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Whitened rows, real parts before imaginary ones, times complex numbers of each line and input.

    rows : (output, row)   factor : (line and input, factor)   returns (output, row, factor)
    """
    real, imag = np.split(rows, 2, axis=1)
    product = (real + 1j * imag)[:, :, None] * factor
    return np.concatenate([product.real, product.imag], axis=1)


def residues(problem: Problem, fit: Fit, model: Model) -> np.ndarray:
    """Residues of the receptance at the poles; nan where a pair was not measured.   returns complex (mode, output, input)"""
    n = len(fit.natural_frequency)
    p = pole_of(fit.natural_frequency, fit.damping_ratio)
    out = problem.empty(n)
    orders = 2 if model.complex_modes else 1
    for test, linear in zip(problem.tests, fit.linear, strict=True):
        m = test.channels.values.shape[2]
        own = linear[:, : n * orders * m].reshape(len(linear), n, orders, m)
        powers = p[:, None] ** np.arange(orders)
        values = np.einsum("onki,nk->noi", own, powers) / (p - p.conj())[:, None, None]
        test.put(out, values)
    return out


def remainders(problem: Problem, fit: Fit, model: Model) -> np.ndarray:
    """Coefficients of the remainder in the receptance.   returns (remainder, output, input)"""
    k = len(model.remainder)
    out = problem.empty(k, dtype=float)
    for test, linear in zip(problem.tests, fit.linear, strict=True):
        m = test.channels.values.shape[2]
        own = linear[:, linear.shape[1] - k * m :].reshape(len(linear), k, m)
        test.put(out, own.transpose(1, 0, 2))
    return out


def modelled(problem: Problem, fit: Fit, model: Model, *, exact: bool) -> np.ndarray:
    """The model on the problem's lines, in the forms that were measured.

    exact : True with delays and what the windows lost, as the measured values have it; False for the structure itself, at
        s = j w
    returns complex (line, output, input)
    """
    out = problem.empty(len(problem.lines))
    for test, linear in zip(problem.tests, fit.linear, strict=True):
        channels: Channels = test.channels
        if not exact:
            channels = channels._replace(s=2j * np.pi * problem.frequency)
        phi, _ = columns(channels, fit.natural_frequency, fit.damping_ratio, model, exact=exact)
        values = combined(phi, linear).transpose(1, 0, 2)
        test.put(out, values if test.turn is None or not exact else values / test.turn.T[:, :, None])
    return out
