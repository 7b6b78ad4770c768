"""The zero-order limit compiled, for many structures and forces: draws of a fit, or particles of a learner.

One mode: the two lobes about the weakest frequency, each by Newton (see `zero_order.limit_of_one_mode`). Any modes: the steps
of `zero_order.oriented` and `zero_order.limit_along` in one pass over a draw, with nothing allocated inside the loop over
speeds. Numbers within rounding of those of `zero_order`.

This module imports numba and so is imported where it is used.
"""

import numpy as np
from numba import njit

WEAKEST_PEAK = 0.1  # as in `zero_order`
ROOT = 0.6180339887498949  # of the golden section


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def one_mode_depths(natural_turns, damping_ratio, stiffness, cutting, teeth, spindle_speed, depth):  # type: ignore[no-untyped-def]
    """Limits of single modes.

    natural_turns, damping_ratio, stiffness, cutting : natural frequency rad/s, 1, N/m, A in N/m^2, (draw,)
    spindle_speed : (speed,) rad/s   depth : (draw, speed) m, written
    """
    for i in range(len(natural_turns)):
        zeta, stiff = damping_ratio[i], abs(cutting[i])
        sign = 1.0 if cutting[i] > 0 else -1.0
        weakest = np.sqrt(max(1 + sign * 2 * zeta, 0.0))
        turned = np.arctan2(1 - weakest**2, 2 * zeta * weakest) / np.pi
        for j in range(len(spindle_speed)):
            best = np.inf
            if stiff > 0:
                turns = natural_turns[i] / (teeth * spindle_speed[j])
                nearest = np.floor(turns * weakest - turned)
                for n in (nearest, nearest + 1.0):
                    if n < 0:
                        continue
                    r = _phase_root(n, turns, zeta)
                    u = sign * (r * r - 1)
                    if u > 0 and r > 0:
                        best = min(best, stiffness[i] * (u * u + (2 * zeta * r) ** 2) / (2 * stiff * u))
            depth[i, j] = best


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _phase_root(n, turns, zeta):  # type: ignore[no-untyped-def]
    """r with  turns r - atan2(1 - r^2, 2 zeta r) / pi = n;  see `zero_order._phase_root`."""
    low, high = max(n - 0.5, 0.0) / turns, (n + 0.5) / turns
    r = 0.5 * (low + high)
    before = np.inf
    for _ in range(100):
        u, v = 1 - r * r, 2 * zeta * r
        error = turns * r - np.arctan2(u, v) / np.pi - n
        slope = turns + 2 * zeta * (1 + r * r) / (u * u + v * v) / np.pi
        if error < 0:
            low = r
        else:
            high = r
        step = r - error / slope
        if abs(step - r) <= 1e-15 * r:
            return step
        if not (low <= step <= high and abs(error) < before / 2):
            step = 0.5 * (low + high)
        r, before = step, abs(error)
    return r


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _receptance(frequency, pole, residue, remainder, power):  # type: ignore[no-untyped-def]
    """G at one frequency, Hz.   returns xx, xy, yx, yy"""
    s = 2j * np.pi * frequency
    xx, xy, yx, yy = 0j, 0j, 0j, 0j
    for m in range(len(pole)):
        a, b = 1 / (s - pole[m]), 1 / (s - np.conj(pole[m]))
        xx += a * residue[m, 0, 0] + b * np.conj(residue[m, 0, 0])
        xy += a * residue[m, 0, 1] + b * np.conj(residue[m, 0, 1])
        yx += a * residue[m, 1, 0] + b * np.conj(residue[m, 1, 0])
        yy += a * residue[m, 1, 1] + b * np.conj(residue[m, 1, 1])
    for d in range(len(power)):
        factor = s ** power[d]
        xx += factor * remainder[d, 0, 0]
        xy += factor * remainder[d, 0, 1]
        yx += factor * remainder[d, 1, 0]
        yy += factor * remainder[d, 1, 1]
    return xx, xy, yx, yy


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _eigenvalues(frequency, pole, residue, remainder, power, cutting, reference):  # type: ignore[no-untyped-def]
    """Both eigenvalues of G Q, with half their difference of the sign next to a reference.   returns root, plus, minus"""
    xx, xy, yx, yy = _receptance(frequency, pole, residue, remainder, power)
    trace = xx * cutting[0, 0] + xy * cutting[1, 0] + yx * cutting[0, 1] + yy * cutting[1, 1]
    determinant = (xx * yy - xy * yx) * (cutting[0, 0] * cutting[1, 1] - cutting[0, 1] * cutting[1, 0])
    root = np.sqrt(trace * trace / 4 - determinant)
    if (np.conj(reference) * root).real < 0:
        root = -root
    plus, minus = trace / 2 + root, trace / 2 - root
    # The smaller from the product, so that a structure with one axis has an exact zero.
    if abs(plus) >= abs(minus):
        if plus != 0:
            minus = determinant / plus
    else:
        plus = determinant / minus
    return root, plus, minus


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def any_modes_depths(grid, pole, residue, remainder, power, cutting, teeth, spindle_speed, depth):  # type: ignore[no-untyped-def]
    """Limits of one structure at all speeds.

    grid : Hz, ascending, resolves the resonances   pole : complex (mode,) 1/s   residue : complex (mode, 2, 2) s/kg
    remainder : (term, 2, 2), power : integer (term,): their powers of s   cutting : Q, (2, 2) N/m^2
    spindle_speed : (speed,) rad/s   depth : (speed,) m, written
    """
    lines = len(grid)
    most = lines + 64  # room for the maxima
    at = np.empty(most)
    root = np.empty(most, np.complex128)
    value = np.empty((2, most), np.complex128)
    at[:lines] = grid
    before = 0j
    for i in range(lines):
        before, value[0, i], value[1, i] = _eigenvalues(grid[i], pole, residue, remainder, power, cutting, before)
        root[i] = before

    # A line at each maximum of -Re m that matters: then the depth is monotone in every cell.
    strongest = 0.0
    for k in range(2):
        for i in range(lines):
            strongest = max(strongest, -value[k, i].real)
    count = lines
    for k in range(2):
        for i in range(1, lines - 1):
            here = -value[k, i].real
            if (
                here <= -value[k, i - 1].real
                or here < -value[k, i + 1].real
                or here <= WEAKEST_PEAK * strongest
                or count == most
            ):
                continue
            low, high = grid[i - 1], grid[i + 1]
            left, right = high - ROOT * (high - low), low + ROOT * (high - low)
            at_left, at_right = 0.0, 0.0
            known = 0  # 1: the value on the left is to be found, 2: on the right
            for _ in range(10):
                if known != 2:
                    _, plus, minus = _eigenvalues(left, pole, residue, remainder, power, cutting, root[i])
                    at_left = -(plus if k == 0 else minus).real
                if known != 1:
                    _, plus, minus = _eigenvalues(right, pole, residue, remainder, power, cutting, root[i])
                    at_right = -(plus if k == 0 else minus).real
                if at_left > at_right:
                    high, right, at_right = right, left, at_left
                    left = high - ROOT * (high - low)
                    known = 1
                else:
                    low, left, at_left = left, right, at_right
                    right = low + ROOT * (high - low)
                    known = 2
            at[count] = 0.5 * (low + high)
            root[count], value[0, count], value[1, count] = _eigenvalues(
                at[count], pole, residue, remainder, power, cutting, root[i]
            )
            count += 1
    order = np.argsort(at[:count])
    line, difference = at[order], root[order]
    strength, phase = np.empty((2, count)), np.empty((2, count))
    for k in range(2):
        for i in range(count):
            m = value[k, order[i]]
            strength[k, i] = -m.real
            angle = np.arctan2(m.imag, m.real) / np.pi - 0.5
            if i > 0:
                angle += 2 * np.round((phase[k, i - 1] - angle) / 2)
            phase[k, i] = angle

    # Cells from the strongest down, of both eigenvalues one behind the other.
    ends = np.empty(2 * (count - 1))
    for k in range(2):
        for i in range(count - 1):
            ends[k * (count - 1) + i] = -max(strength[k, i], strength[k, i + 1])
    cells = np.argsort(ends)
    positive = 0
    while positive < len(cells) and ends[cells[positive]] < 0:
        positive += 1
    f0, f1, p0, p1 = np.empty(positive), np.empty(positive), np.empty(positive), np.empty(positive)
    s0, s1, bound = np.empty(positive), np.empty(positive), np.empty(positive)
    reference, branch = np.empty(positive, np.complex128), np.empty(positive, np.int64)
    for c in range(positive):
        k, i = cells[c] // (count - 1), cells[c] % (count - 1)
        f0[c], f1[c], p0[c], p1[c] = line[i], line[i + 1], phase[k, i], phase[k, i + 1]
        s0[c], s1[c], bound[c] = strength[k, i], strength[k, i + 1], -ends[cells[c]]
        reference[c], branch[c] = difference[i] + difference[i + 1], k

    for j in range(len(spindle_speed)):
        tau = 2 * np.pi / (teeth * spindle_speed[j])
        rough, exact = 0.0, 0.0  # largest strength: interpolated in its cell, and solved for
        for c in range(positive):
            if bound[c] < rough / 1.02 or bound[c] < exact:  # 2 %: the interpolated strength is an estimate
                break
            x0, x1 = tau * f0[c] - p0[c], tau * f1[c] - p1[c]
            whole0, whole1 = np.floor(x0), np.floor(x1)
            if whole0 == whole1:
                continue
            rises = 1.0 if x1 > x0 else 0.0
            whole = whole1 + 1 - rises if s1[c] > s0[c] else whole0 + rises
            estimate = s0[c] + (whole - x0) / (x1 - x0) * (s1[c] - s0[c])
            if estimate < 0.95 * rough:
                continue
            rough = max(rough, estimate)
            # False position (Illinois).
            low, high, e0, e1 = f0[c], f1[c], x0 - whole, x1 - whole
            new, last, error, m = low, low, e0, 0j
            for _ in range(60):
                gap = e1 - e0
                share = 0.5 if gap == 0 else min(max(-e0 / gap, 0.0), 1.0)
                new = low + share * (high - low)
                _, plus, minus = _eigenvalues(new, pole, residue, remainder, power, cutting, reference[c])
                m = plus if branch[c] == 0 else minus
                angle = np.arctan2(m.imag, m.real) / np.pi - 0.5
                expected = p0[c] + (new - f0[c]) / (f1[c] - f0[c]) * (p1[c] - p0[c])
                error = tau * new - angle - 2 * np.round((expected - angle) / 2) - whole
                if (error < 0) == (e1 < 0):
                    e0 = e0 / 2
                else:
                    low, e0 = high, e1
                high, e1 = new, error
                if abs(new - last) <= 1e-12 * new or error == 0:
                    break
                last = new
            if abs(error) <= 1e-6:  # else a jump of the phase between two lines, no solution
                exact = max(exact, -m.real)
        depth[j] = 1 / (2 * exact) if exact > 0 else np.inf
