"""First-order semi-discretization at its best, and as shop scripts do it: what the Floquet method is held against.

At its best: compiled, exact means of the cutting matrix (made once for all points), only the tip motions that a later tooth
meets are states, free flight in one move, and a product that touches nothing but the rows that change. As shop scripts do
it: zeroth order, half of each neighbour for the delay, a dense matrix per step, all of them multiplied.
"""

import numba
import numpy as np
from scipy.linalg import expm

from millcal.physics.stability.regeneration import Regeneration, TipModes


class StructuredSemiDiscretization:
    """The best case for one tip and one straight cut with equal pitch; `steps` of a tooth period."""

    def __init__(self, tip: TipModes, cut: Regeneration, steps: int) -> None:
        self.teeth, self.steps = cut.teeth, steps
        seen = [axis for axis in range(2) if np.abs(tip.output[:, axis]).max() > 0]
        modes = len(tip.pole)
        self.a = np.zeros((2 * modes, 2 * modes))
        b, c = np.zeros((2 * modes, 2)), np.zeros((2, 2 * modes))
        for i, s in enumerate(tip.pole):
            at = slice(2 * i, 2 * i + 2)
            self.a[at, at] = [[s.real, -s.imag], [s.imag, s.real]]
            b[at] = tip.given[i].real, tip.given[i].imag
            c[:, at] = np.stack([2 * tip.output[i].real, -2 * tip.output[i].imag], axis=-1)
        self.b, self.c = np.ascontiguousarray(b[:, seen]), np.ascontiguousarray(c[seen])
        edges = 2 * np.pi / cut.teeth * np.arange(steps + 1) / steps
        summed = np.zeros((steps + 1, 2, 2))
        for turn in range(cut.teeth + 1):
            summed += _integral(np.clip(edges + 2 * np.pi * turn / cut.teeth, cut.entry, cut.leave), cut)
        mean = np.diff(summed, axis=0) * steps / (2 * np.pi / cut.teeth)
        self.mean = np.ascontiguousarray(mean[np.ix_(range(steps), seen, seen)])
        in_cut = np.abs(self.mean).max(axis=(1, 2)) > 1e-12 * np.abs(self.mean).max()
        # the period begins where the cut does, so that what is not in cut comes last
        begin = int(np.argmax(in_cut & ~np.roll(in_cut, 1))) if not in_cut.all() else 0
        self.mean = np.ascontiguousarray(np.roll(self.mean, -begin, axis=0)[: in_cut.sum()])
        assert np.roll(in_cut, -begin)[: in_cut.sum()].all()

    def matrix(self, spindle_speed: float, depth: float) -> np.ndarray:
        """The monodromy matrix: of the tip's modes and of the tip at the steps in cut."""
        dt = 2 * np.pi / (self.teeth * spindle_speed * self.steps)
        return _monodromy(self.a, self.b, self.c, depth * self.mean, dt, self.steps)

    def radius(self, spindle_speed: float, depth: float) -> float:
        """The largest multiplier's size."""
        return np.abs(np.linalg.eigvals(self.matrix(spindle_speed, depth))).max()


def _integral(angle, cut):
    s, c = np.sin(2 * angle) / 4, np.cos(2 * angle) / 4
    sc, ss, cc = -c, angle / 2 - s, angle / 2 + s
    rows = (
        np.stack([cut.ktc * sc + cut.krc * ss, cut.ktc * cc + cut.krc * sc], -1),
        np.stack([cut.krc * sc - cut.ktc * ss, cut.krc * cc - cut.ktc * sc], -1),
    )
    return np.stack(rows, axis=-2)


@numba.njit(cache=True)
def _monodromy(a, b, c, cutting, dt, steps):
    """Columns and rows: x where the cut begins, then r at the edges of the steps in cut of the period before."""
    size, seen, cuts = len(a), len(c), len(cutting)
    width = size + seen * (cuts + 1)
    found = np.zeros((width, width))
    x = np.zeros((size, width))
    for i in range(size):
        x[i, i] = 1.0
    moved, one, two = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    term, grown, state = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    new = np.empty((size, width))
    reach = size  # columns beyond are still zero
    for k in range(seen):
        for j in range(width):
            total = 0.0
            for i in range(size):
                total += c[k, i] * x[i, j]
            found[size + k, j] = total
    for step in range(cuts):
        bh = b @ cutting[step]
        state[:] = a - bh @ c
        # moved = exp(A dt), one = its integral, two = the integral of its integral / dt, by their series
        for i in range(size):
            for j in range(size):
                term[i, j] = dt if i == j else 0.0
                one[i, j] = term[i, j]
                two[i, j] = term[i, j] / 2
        k = 1
        while True:
            largest = 0.0
            for i in range(size):
                for j in range(size):
                    total = 0.0
                    for m in range(size):
                        total += state[i, m] * term[m, j]
                    grown[i, j] = total * dt / (k + 1)
                    largest = max(largest, abs(grown[i, j]))
            term[:] = grown
            for i in range(size):
                for j in range(size):
                    one[i, j] += term[i, j]
                    two[i, j] += term[i, j] / (k + 2)
            k += 1
            if largest < 1e-13 * dt or k > 60:
                break
        for i in range(size):
            for j in range(size):
                total = 1.0 if i == j else 0.0
                for m in range(size):
                    total += state[i, m] * one[m, j]
                moved[i, j] = total
        of_end = two @ bh
        of_start = one @ bh - of_end
        for i in range(size):
            for j in range(reach):
                total = 0.0
                for m in range(size):
                    total += moved[i, m] * x[m, j]
                new[i, j] = total
            for j in range(reach, reach + 2 * seen if step == 0 else reach + seen):
                new[i, j] = 0.0
        at = size + seen * step
        for i in range(size):
            for k in range(seen):
                new[i, at + k] += of_start[i, k]
                new[i, at + seen + k] += of_end[i, k]
        reach = at + 2 * seen
        for i in range(size):
            for j in range(reach):
                x[i, j] = new[i, j]
        for k in range(seen):
            for j in range(reach):
                total = 0.0
                for i in range(size):
                    total += c[k, i] * x[i, j]
                found[at + seen + k, j] = total
    rest = (steps - cuts) * dt
    for i in range(0, size, 2):  # free flight: each mode turns and decays by itself
        decay = np.exp(a[i, i] * rest)
        cosine, sine = decay * np.cos(a[i + 1, i] * rest), decay * np.sin(a[i + 1, i] * rest)
        for j in range(width):
            found[i, j] = cosine * x[i, j] - sine * x[i + 1, j]
            found[i + 1, j] = sine * x[i, j] + cosine * x[i + 1, j]
    return found


class DenseSemiDiscretization:
    """As shop scripts do it: zeroth order, the delayed term the mean of two steps, dense matrices, all multiplied."""

    def __init__(self, tip: TipModes, cut: Regeneration, steps: int) -> None:
        mode = tip.pole[0]
        if len(tip.pole) > 1 or np.abs(tip.output[:, 1]).max() > 0:
            raise ValueError("one mode along x")
        self.natural, self.teeth, self.steps = np.abs(mode), cut.teeth, steps
        self.damping = -mode.real / self.natural
        self.size = np.real(2j * mode.imag * (tip.output[0, 0] * tip.given[0, 0]))  # 1 / mass
        parts = (np.arange(20 * steps) + 0.5) / (20 * steps) * 2 * np.pi / cut.teeth
        total = np.zeros(len(parts))
        for tooth in range(cut.teeth):
            angle = (parts + 2 * np.pi * tooth / cut.teeth) % (2 * np.pi)
            s, c = np.sin(angle), np.cos(angle)
            total += ((angle >= cut.entry) & (angle < cut.leave)) * s * (cut.ktc * c + cut.krc * s)
        self.mean = total.reshape(steps, 20).mean(axis=1)

    def radius(self, spindle_speed: float, depth: float) -> float:
        """The largest multiplier's size."""
        k, w, zeta = self.steps, self.natural, self.damping
        dt = 2 * np.pi / (self.teeth * spindle_speed * k)
        product = np.eye(k + 2)
        for mean in depth * self.mean * self.size:
            a = np.array([[0.0, 1.0], [-(w**2) - mean, -2 * zeta * w]])
            moved = expm(a * dt)
            given = (moved - np.eye(2)) @ np.linalg.solve(a, [0.0, mean]) / 2
            one = np.zeros((k + 2, k + 2))
            one[:2, :2] = moved
            one[:2, k] = one[:2, k + 1] = given
            one[2, 0] = 1.0
            one[range(3, k + 2), range(2, k + 1)] = 1.0
            product = one @ product
        return np.abs(np.linalg.eigvals(product)).max()
