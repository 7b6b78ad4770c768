"""Where poles may be: the poly-reference least-squares complex frequency-domain estimate, order by order.

The frequency response is taken as H = B(z) A(z)^-1 with matrix polynomials in z = e^{j theta}, where theta runs over half a
circle along the band, and A is found by linear least squares with B eliminated (Guillaume et al. 2003, eqs. 3 to 12). Its
roots are quick and need no starting values, but noise biases their damping, and what windows took away they do not know:
seeds and a stabilisation chart, not results. Coefficients are complex, since the band does not begin at zero frequency.

References
----------
Guillaume, Verboven, Vanlanduit, Van der Auweraer, Peeters 2003, A poly-reference implementation of the least-squares
complex frequency-domain estimator, IMAC XXI.
Cauberghe, Guillaume, Verboven, Vanlanduit, Parloo 2005, On the influence of the parameter constraint on the stability of
the poles and the discrimination capabilities of the stabilisation diagrams, Mechanical Systems and Signal Processing 19.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

HALF_CIRCLE = np.pi  # of theta along the band


class Poles(NamedTuple):
    """Poles of every order, and which of them the order below has too."""

    order: np.ndarray  # (pole,)
    frequency: np.ndarray  # (pole,) Hz, undamped
    damping: np.ndarray  # (pole,)
    stable: np.ndarray  # (pole,) bool


def search_poles(
    frequency: np.ndarray,
    values: np.ndarray,
    weight: np.ndarray,
    orders: Sequence[int],
    *,
    largest_damping: float = 0.5,
    near_frequency: float = 0.01,
    near_damping: float = 0.1,
) -> Poles:
    """Poles in the band for every order of the denominator.

    frequency : (line,) Hz, ascending   values : complex (line, output, input)   weight : (line, output, input)
    orders : ascending   near_frequency, near_damping : relative distance within which a pole is that of the order below
    """
    lines, outputs, inputs = values.shape
    low, width = frequency[0], max(frequency[-1] - frequency[0], 1e-300)
    theta = HALF_CIRCLE * (frequency - low) / width
    most = max(orders)
    omega = np.exp(1j * np.outer(theta, np.arange(most + 1)))  # (line, order)
    normal = np.zeros((most + 1, inputs, most + 1, inputs), complex)
    # B has its own unknowns for each output; what is left of A's columns once B is eliminated adds up over the outputs.
    eliminated = {order: np.zeros((order + 1, inputs, order + 1, inputs), complex) for order in orders}
    for o in range(outputs):
        w = np.sqrt(np.mean(weight[:, o] ** 2, axis=1))[:, None]  # one weight a line: B is shared by the inputs
        X = omega * w
        Y = -(X[:, :, None] * values[:, o, None, :]).reshape(lines, -1)
        R, S, T = X.conj().T @ X, X.conj().T @ Y, Y.conj().T @ Y
        normal += T.reshape(normal.shape)
        cross = S.reshape(most + 1, most + 1, inputs)
        for order in orders:
            k = slice(order + 1)
            part = cross[k, k].reshape(order + 1, -1)
            eliminated[order] += (part.conj().T @ np.linalg.solve(R[k, k], part)).reshape(eliminated[order].shape)
    found: list[tuple[int, np.ndarray, np.ndarray]] = []
    for order in orders:
        size = order * inputs
        M = (normal[: order + 1, :, : order + 1] - eliminated[order]).reshape(size + inputs, size + inputs)
        # With A_0 = 1 the poles that only describe noise come out growing, and fall away; with A_order = 1 they decay and stay.
        A = np.linalg.lstsq(M[inputs:, inputs:], -M[inputs:, :inputs], rcond=1e-13)[0].reshape(order, inputs, inputs)
        companion = np.zeros((size, size), complex)  # of the polynomial in 1/z
        companion[:-inputs, inputs:] = np.eye(size - inputs)
        companion[-inputs:] = -A[::-1].transpose(1, 0, 2).reshape(inputs, size)
        z = 1.0 / np.linalg.eigvals(companion)
        z = z[np.isfinite(z)]
        s = 2j * np.pi * (low + width * (-1j * np.log(z)) / HALF_CIRCLE)
        fn = np.abs(s) / (2 * np.pi)
        zeta = -s.real / np.abs(s)
        good = (s.imag > 0) & (zeta > 1e-6) & (zeta < largest_damping) & (fn >= low) & (fn <= frequency[-1])
        ascending = np.argsort(fn[good])
        found.append((order, fn[good][ascending], zeta[good][ascending]))
    return _with_stability(found, near_frequency, near_damping)


def _with_stability(found: list[tuple[int, np.ndarray, np.ndarray]], near_f: float, near_z: float) -> Poles:
    stable: list[np.ndarray] = [np.zeros(len(found[0][1]), bool)]
    for (_, f0, z0), (_, f1, z1) in pairwise(found):
        close = np.abs(f1[:, None] - f0) < near_f * f0  # (pole, pole of the order below)
        close &= np.abs(z1[:, None] - z0) < near_z * z0
        stable.append(np.any(close, axis=1))
    return Poles(
        np.concatenate([np.full(len(f), order) for order, f, _ in found]),
        np.concatenate([f for _, f, _ in found]),
        np.concatenate([z for _, _, z in found]),
        np.concatenate(stable),
    )


def groups_of(poles: Poles, *, near_frequency: float = 0.01) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stable poles of all orders gathered by frequency: median frequency, median damping, and how many, most first.

    returns three arrays (group,)
    """
    f, z = poles.frequency[poles.stable], poles.damping[poles.stable]
    if not len(f):
        return np.zeros(0), np.zeros(0), np.zeros(0, int)
    order = np.argsort(f)
    f, z = f[order], z[order]
    # a new group where the gap to the next is wider than poles of one mode scatter
    starts = np.flatnonzero(np.diff(np.log(f), prepend=-np.inf) > near_frequency)
    parts = list(zip(np.split(f, starts[1:]), np.split(z, starts[1:]), strict=True))
    count = np.array([len(part) for part, _ in parts])
    rank = np.argsort(-count, kind="stable")
    middle_f = np.array([np.median(part) for part, _ in parts])[rank]
    middle_z = np.array([np.median(part) for _, part in parts])[rank]
    return middle_f, middle_z, count[rank]
