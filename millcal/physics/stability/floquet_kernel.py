"""The monodromy matrix of a cut and its multipliers, compiled: see `floquet` for the equations and what the arrays mean.

Everything is per radian of spindle rotation: times are angles, a pole is s / Omega, integrals over time carry 1 / Omega. The
arrays of a `Problem` do not depend on speed or depth; `_prepare` makes the four matrices of one speed, `_monodromy` the
matrix of one depth from them, `_multipliers` its eigenvalues by elimination to Hessenberg form and the double-shift QR
iteration (Wilkinson, Reinsch 1971: elmhes, hqr), which for the sizes here, 7 to 80, is quicker than a call of LAPACK.

This module imports numba and so is imported where it is used. It is long because numba's cache does not notice an edit in what a
kernel inlines from elsewhere.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

LARGE = 80  # unknowns, from which on a call of LAPACK is worth it
MOST_STEPS = 60  # of the QR iteration for one eigenvalue


class Problem(NamedTuple):
    """One cut over one period, its force on polynomials: speed and depth are free."""

    pole: np.ndarray  # complex (mode,), 1/s
    output: np.ndarray  # complex (mode, 2)
    given: np.ndarray  # complex (mode, 2)
    flexibility: np.ndarray  # (2, 2)
    direct: np.ndarray  # (2, 2): sum of 2 Re c b^T, zero for real modes
    period: float  # rad
    start: np.ndarray  # (piece,), rad
    length: np.ndarray  # (piece,), rad
    order: np.ndarray  # integer (piece,): Gauss nodes n
    table: np.ndarray  # integer (piece,): which of the tables below
    node: np.ndarray  # (table, largest n), 0..1
    inner: np.ndarray  # (q,): nodes of the integrals from a node to the next, 0..1
    weight: np.ndarray  # (table, n + 1, q, n): integral of polynomial j from node i - 1 to node i; i = n: to the end
    piece: np.ndarray  # integer (unknown,)
    place: np.ndarray  # integer (unknown,): node within its piece
    row: np.ndarray  # (unknown, 2): what is taken of r, or of r' where `rubs`
    column: np.ndarray  # (unknown, 2): force per unknown and depth
    rubs: np.ndarray  # bool (unknown,): a velocity, whose column counts as 1 / Omega and which leaves no wave
    now: np.ndarray  # (unknown, unknown): S0
    before: np.ndarray  # (unknown, remembered): S1, of those that the next period remembers
    memory: np.ndarray  # integer (remembered,): unknowns
    plain: bool  # S0 is one and S1 the projection on `memory`


@njit(cache=True, error_model="numpy")
def _prepare(p, speed, gamma, phi, evolution, feed, block, stretch, ends, waves):
    """The matrices of one speed.

    gamma : (unknown, unknown)   phi : (unknown, 2 mode)   evolution : (2 mode, 2 mode)   feed : (2 mode, unknown)
    block : complex (n + 1, n), stretch : (2, n), ends : two complex (unknown,): scratch
    waves : gamma S0, gamma S1, feed S0, feed S1, where S0 and S1 are not plain
    """
    unknowns = len(p.piece)
    gamma[:] = 0.0
    evolution[:] = 0.0
    seen, force = ends
    for m in range(len(p.pole)):
        s = p.pole[m] / speed
        size = math.hypot(abs(p.output[m, 0]), abs(p.output[m, 1]))
        for a in range(unknowns):
            seen[a] = 2 * (p.output[m, 0] * p.row[a, 0] + p.output[m, 1] * p.row[a, 1])
            force[a] = p.given[m, 0] * p.column[a, 0] + p.given[m, 1] * p.column[a, 1]
            if p.rubs[a]:
                seen[a] *= p.pole[m]
                force[a] /= speed
        length = -1.0
        stop = 0
        for piece in range(len(p.start)):
            n = p.order[piece]
            if p.length[piece] != length:
                length = p.length[piece]
                _integrals(s, length, n, p.table[piece], p, block, stretch, speed)
            begin, end = stop, p.start[piece] + length
            while stop < unknowns and p.piece[stop] == piece:
                stop += 1
            to_end = 2 * size * np.exp(s * (p.period - end))
            for b in range(begin, stop):
                at_end = to_end * force[b] * block[n, p.place[b]]
                feed[2 * m, b] = at_end.real
                feed[2 * m + 1, b] = at_end.imag
                for a in range(begin, stop):
                    push = force[b] * block[p.place[a], p.place[b]]
                    gamma[a, b] += seen[a].real * push.real - seen[a].imag * push.imag
            for a in range(stop, unknowns):
                later = seen[a] * np.exp(s * (_angle(p, a) - end))
                for b in range(begin, stop):
                    gamma[a, b] += (later * force[b] * block[n, p.place[b]]).real
        for a in range(unknowns):
            free = seen[a] / (2 * size) * np.exp(s * _angle(p, a))
            phi[a, 2 * m] = free.real
            phi[a, 2 * m + 1] = -free.imag
        whole = np.exp(s * p.period)
        evolution[2 * m, 2 * m] = evolution[2 * m + 1, 2 * m + 1] = whole.real
        evolution[2 * m, 2 * m + 1], evolution[2 * m + 1, 2 * m] = -whole.imag, whole.imag
    for a in range(unknowns):
        for b in range(unknowns):
            if p.piece[a] == p.piece[b] and p.place[a] == p.place[b]:
                at_once = 0.0
                for k in range(2):
                    for l in range(2):
                        matrix = p.direct[k, l] if p.rubs[a] else p.flexibility[k, l]
                        at_once += p.row[a, k] * matrix * p.column[b, l]
                gamma[a, b] += at_once / speed if p.rubs[b] else at_once
    if not p.plain:
        now, before, feed_now, feed_before = waves
        _times(gamma, p.now, now)
        _times(gamma, p.before, before)
        _times(feed, p.now, feed_now)
        _times(feed, p.before, feed_before)


@njit(cache=True, error_model="numpy")
def _angle(p, unknown):
    """Where an unknown stands, rad since the start of the period."""
    piece = p.piece[unknown]
    return p.start[piece] + p.length[piece] * p.node[p.table[piece], p.place[unknown]]


@njit(cache=True, error_model="numpy")
def _times(left, right, out):
    """out = left right, with a right that is mostly zero."""
    out[:] = 0.0
    for c in range(right.shape[0]):
        for b in range(right.shape[1]):
            by = right[c, b]
            if by != 0.0:
                for a in range(left.shape[0]):
                    out[a, b] += left[a, c] * by


@njit(cache=True, error_model="numpy")
def _integrals(s, length, n, table, p, block, stretch, speed):
    """Of e^{s (t_i - t)} times each Lagrange polynomial, up to each node and over the whole piece: block (n + 1, n).

    From one node to the next what was there turns and fades by e^{s h}, and the stretch between is added.
    """
    real, imag = stretch
    before = 0.0
    for i in range(n + 1):
        here = p.node[table, i] if i < n else 1.0
        gap = length * (here - before)
        before = here
        for j in range(n):
            real[j] = imag[j] = 0.0
        carry = np.exp(s * gap)
        q = len(p.inner)
        # the inner nodes lie symmetrically, and e^{s h (1 - u)} = e^{s h} / e^{s h u}
        for k in range(q // 2):
            size, turn = math.exp(s.real * gap * p.inner[k]), s.imag * gap * p.inner[k]
            cosine, sine = math.cos(turn), math.sin(turn)
            early = complex(cosine, -sine) * carry * (length / (speed * size))
            late = complex(cosine, sine) * (size * length / speed)
            for j in range(n):
                first, last = p.weight[table, i, k, j], p.weight[table, i, q - 1 - k, j]
                real[j] += early.real * first + late.real * last
                imag[j] += early.imag * first + late.imag * last
        for j in range(n):
            block[i, j] = complex(real[j], imag[j])
            if i > 0:
                block[i, j] += carry * block[i - 1, j]


@njit(cache=True, error_model="numpy")
def _monodromy(p, depth, gamma, phi, evolution, feed, waves, left, right, matrix):
    """The matrix from (remembered unknowns, modal state) to themselves a period later.   left, right : scratch"""
    unknowns, remembered, states = len(p.piece), len(p.memory), evolution.shape[0]
    columns = remembered + states
    now, before, feed_now, feed_before = waves
    # w = phi z - b gamma (S0 w - S1 w_before):   left w = right
    for a in range(unknowns):
        for b in range(unknowns):
            left[a, b] = depth * (gamma[a, b] if p.plain else now[a, b])
        for k in range(remembered):
            right[a, k] = depth * (gamma[a, p.memory[k]] if p.plain else before[a, k])
        left[a, a] += 1.0
        for k in range(states):
            right[a, remembered + k] = phi[a, k]
    if unknowns > LARGE:
        right[:] = np.linalg.solve(left, right)
    else:
        _solve(left, right, unknowns, columns)
    for k in range(remembered):
        for c in range(columns):
            matrix[k, c] = right[p.memory[k], c]
    # z' = E z - b feed (S0 w - S1 w_before)
    for s in range(states):
        row = matrix[remembered + s]
        for k in range(remembered):
            row[k] = depth * (feed[s, p.memory[k]] if p.plain else feed_before[s, k])
        for c in range(states):
            row[remembered + c] = evolution[s, c]
        for a in range(unknowns):
            # what rubs leaves no wave, but pushes
            by = depth * (feed[s, a] if p.plain else feed_now[s, a])
            for c in range(columns):
                row[c] -= by * right[a, c]


@njit(cache=True, error_model="numpy")
def _solve(left, right, n, columns):
    """right becomes left^-1 right, by elimination with row pivots; left is lost."""
    for k in range(n):
        top = k
        for i in range(k + 1, n):
            if abs(left[i, k]) > abs(left[top, k]):
                top = i
        if top != k:
            for j in range(k, n):
                left[k, j], left[top, j] = left[top, j], left[k, j]
            for j in range(columns):
                right[k, j], right[top, j] = right[top, j], right[k, j]
        pivot = left[k, k]
        if pivot == 0.0:
            pivot = 1e-300
            left[k, k] = pivot
        for i in range(k + 1, n):
            share = left[i, k] / pivot
            if share != 0.0:
                for j in range(k + 1, n):
                    left[i, j] -= share * left[k, j]
                for j in range(columns):
                    right[i, j] -= share * right[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            share = left[k, i]
            for j in range(columns):
                right[k, j] -= share * right[i, j]
        pivot = left[k, k]
        for j in range(columns):
            right[k, j] /= pivot


@njit(cache=True, error_model="numpy")
def _eigenvalues(a, n, real, imag):
    """Eigenvalues of a real matrix, which is lost.   real, imag : (n,), filled"""
    for m in range(1, n - 1):
        pivot, top = 0.0, m
        for i in range(m, n):
            if abs(a[i, m - 1]) > abs(pivot):
                pivot, top = a[i, m - 1], i
        if top != m:
            for j in range(m - 1, n):
                a[top, j], a[m, j] = a[m, j], a[top, j]
            for i in range(n):
                a[i, top], a[i, m] = a[i, m], a[i, top]
        if pivot != 0.0:
            for i in range(m + 1, n):
                share = a[i, m - 1]
                if share != 0.0:
                    share /= pivot
                    a[i, m - 1] = 0.0
                    for j in range(m, n):
                        a[i, j] -= share * a[m, j]
                    for k in range(n):
                        a[k, m] += share * a[k, i]
    for i in range(2, n):
        for j in range(i - 1):
            a[i, j] = 0.0
    norm = 0.0
    for i in range(n):
        for j in range(max(i - 1, 0), n):
            norm += abs(a[i, j])
    high, shift, steps = n - 1, 0.0, 0
    while high >= 0:
        low = high
        while low > 0:
            size = abs(a[low - 1, low - 1]) + abs(a[low, low])
            if size == 0.0:
                size = norm
            if abs(a[low, low - 1]) <= 2.3e-16 * size:
                a[low, low - 1] = 0.0
                break
            low -= 1
        x = a[high, high]
        if low == high:
            real[high], imag[high] = x + shift, 0.0
            high -= 1
            steps = 0
            continue
        y, w = a[high - 1, high - 1], a[high, high - 1] * a[high - 1, high]
        if low == high - 1:
            half = 0.5 * (y - x)
            inside = half * half + w
            root = math.sqrt(abs(inside))
            x += shift
            if inside >= 0.0:
                root = half + (root if half >= 0.0 else -root)
                real[high - 1] = real[high] = x + root
                if root != 0.0:
                    real[high] = x - w / root
                imag[high - 1] = imag[high] = 0.0
            else:
                real[high - 1] = real[high] = x + half
                imag[high - 1], imag[high] = root, -root
            high -= 2
            steps = 0
            continue
        if steps == MOST_STEPS:  # never seen; a multiplier that is not known must not count as stable
            real[high], imag[high] = np.nan, 0.0
            high -= 1
            steps = 0
            continue
        if steps % 10 == 9:  # an odd shift now and then breaks a circle
            shift += x
            for i in range(high + 1):
                a[i, i] -= x
            size = abs(a[high, high - 1]) + abs(a[high - 1, high - 2])
            x = y = 0.75 * size
            w = -0.4375 * size * size
        steps += 1
        m = high - 2
        while True:
            z = a[m, m]
            r, s = x - z, y - z
            f = (r * s - w) / a[m + 1, m] + a[m, m + 1]
            g = a[m + 1, m + 1] - z - r - s
            h = a[m + 2, m + 1]
            size = abs(f) + abs(g) + abs(h)
            f, g, h = f / size, g / size, h / size
            if m == low:
                break
            u = abs(a[m, m - 1]) * (abs(g) + abs(h))
            v = abs(f) * (abs(a[m - 1, m - 1]) + abs(z) + abs(a[m + 1, m + 1]))
            if u <= 2.3e-16 * v:
                break
            m -= 1
        for i in range(m + 2, high + 1):
            a[i, i - 2] = 0.0
            if i != m + 2:
                a[i, i - 3] = 0.0
        for k in range(m, high):
            if k != m:
                f, g = a[k, k - 1], a[k + 1, k - 1]
                h = a[k + 2, k - 1] if k != high - 1 else 0.0
                x = abs(f) + abs(g) + abs(h)
                if x != 0.0:
                    f, g, h = f / x, g / x, h / x
            s = math.sqrt(f * f + g * g + h * h)
            if f < 0.0:
                s = -s
            if s == 0.0:
                continue
            if k == m:
                if low != m:
                    a[k, k - 1] = -a[k, k - 1]
            else:
                a[k, k - 1] = -s * x
            f += s
            x, y, z = f / s, g / s, h / s
            g, h = g / f, h / f
            for j in range(k, high + 1):
                f = a[k, j] + g * a[k + 1, j]
                if k != high - 1:
                    f += h * a[k + 2, j]
                    a[k + 2, j] -= f * z
                a[k + 1, j] -= f * y
                a[k, j] -= f * x
            for i in range(low, min(high, k + 3) + 1):
                f = x * a[i, k] + y * a[i, k + 1]
                if k != high - 1:
                    f += z * a[i, k + 2]
                    a[i, k + 2] -= f * h
                a[i, k + 1] -= f * g
                a[i, k] -= f


@njit(cache=True, error_model="numpy")
def _room(p):
    """Arrays for `_prepare` and `_monodromy`."""
    unknowns, states, n = len(p.piece), 2 * len(p.pole), p.order.max()
    remembered = len(p.memory)
    size = remembered + states
    full = 0 if p.plain else unknowns
    waves = (
        np.empty((full, full)),
        np.empty((full, remembered)),
        np.empty((states, full)),
        np.empty((states, remembered)),
    )
    largest = max(size, unknowns)
    return (
        np.empty((unknowns, unknowns)),
        np.empty((unknowns, states)),
        np.empty((states, states)),
        np.empty((states, unknowns)),
        np.empty((n + 1, n), np.complex128),
        np.empty((2, n)),
        (np.empty(unknowns, np.complex128), np.empty(unknowns, np.complex128)),
        waves,
        np.empty((unknowns, unknowns)),
        np.empty((unknowns, size)),
        np.empty((size, size)),
        np.empty(largest),
        np.empty(largest),
    )


@njit(cache=True, error_model="numpy")
def matrices(p, speed):
    """Gamma, phi, evolution and feed of one speed, for those who solve in another way."""
    gamma, phi, evolution, feed, block, stretch, ends, waves, _, _, _, _, _ = _room(p)
    _prepare(p, speed, gamma, phi, evolution, feed, block, stretch, ends, waves)
    return gamma, phi, evolution, feed


@njit(cache=True, error_model="numpy")
def multipliers_of(p, speed, depth):
    """All multipliers of one point.   returns complex (k,)"""
    gamma, phi, evolution, feed, block, stretch, ends, waves, left, right, matrix, real, imag = _room(p)
    _prepare(p, speed, gamma, phi, evolution, feed, block, stretch, ends, waves)
    _monodromy(p, depth, gamma, phi, evolution, feed, waves, left, right, matrix)
    n = matrix.shape[0]
    _eigenvalues(matrix, n, real, imag)
    found = np.empty(n, np.complex128)
    for i in range(n):
        found[i] = complex(real[i], imag[i])
    return found


@njit(cache=True, error_model="numpy")
def radii(p, speed, depth, out):
    """The largest |mu| of points of many speeds.   speed, depth, out : (point,)"""
    gamma, phi, evolution, feed, block, stretch, ends, waves, left, right, matrix, real, imag = _room(p)
    n = matrix.shape[0]
    for i in range(len(speed)):
        if i == 0 or speed[i] != speed[i - 1]:
            _prepare(p, speed[i], gamma, phi, evolution, feed, block, stretch, ends, waves)
        _monodromy(p, depth[i], gamma, phi, evolution, feed, waves, left, right, matrix)
        _eigenvalues(matrix, n, real, imag)
        largest = 0.0
        for k in range(n):
            largest = max(largest, real[k] * real[k] + imag[k] * imag[k])
            if math.isnan(real[k]):
                largest = np.inf
        out[i] = math.sqrt(largest)


@njit(cache=True, error_model="numpy")
def spectra(p, speed, depth, keep, out):
    """The largest multipliers of points of many speeds, largest first.   out : complex (point, keep)"""
    gamma, phi, evolution, feed, block, stretch, ends, waves, left, right, matrix, real, imag = _room(p)
    n = matrix.shape[0]
    size = np.empty(n)
    for i in range(len(speed)):
        if i == 0 or speed[i] != speed[i - 1]:
            _prepare(p, speed[i], gamma, phi, evolution, feed, block, stretch, ends, waves)
        _monodromy(p, depth[i], gamma, phi, evolution, feed, waves, left, right, matrix)
        _eigenvalues(matrix, n, real, imag)
        for k in range(n):
            size[k] = real[k] * real[k] + imag[k] * imag[k]
            if math.isnan(size[k]):
                size[k] = np.inf
        for rank in range(min(keep, n)):
            top = rank
            for k in range(rank + 1, n):
                if size[k] > size[top]:
                    top = k
            size[rank], size[top] = size[top], size[rank]
            real[rank], real[top] = real[top], real[rank]
            imag[rank], imag[top] = imag[top], imag[rank]
            out[i, rank] = complex(real[rank], imag[rank])
        for rank in range(n, keep):
            out[i, rank] = 0.0


@njit(cache=True, error_model="numpy")
def flips(p, speed, deepest, out, count):
    """Depths at which a multiplier is -1: real negative eigenvalues of K(-1) (S0 + S1).

    out : (speed, unknown), filled to count, ascending   count : integer (speed,)
    """
    gamma, phi, evolution, feed, block, stretch, ends, waves, left, _, _, _, _ = _room(p)
    unknowns, states = phi.shape
    real, imag = np.empty(unknowns), np.empty(unknowns)
    away = np.empty((states, states))  # -1 - E
    answer = np.empty((states, unknowns))
    matrix = np.empty((unknowns, unknowns))
    wave = p.now.copy()
    for a in range(unknowns):
        for k in range(len(p.memory)):
            wave[a, p.memory[k]] += p.before[a, k]
    for i in range(len(speed)):
        _prepare(p, speed[i], gamma, phi, evolution, feed, block, stretch, ends, waves)
        for k in range(states):
            for c in range(states):
                away[k, c] = -evolution[k, c]
            away[k, k] -= 1.0
            for a in range(unknowns):
                answer[k, a] = feed[k, a]
        _solve(away, answer, states, unknowns)
        for a in range(unknowns):
            for b in range(unknowns):
                total = gamma[a, b]
                for k in range(states):
                    total += phi[a, k] * answer[k, b]
                left[a, b] = total
        _times(left, wave, matrix)
        _eigenvalues(matrix, unknowns, real, imag)
        found = 0
        for k in range(unknowns):
            if imag[k] == 0.0 and real[k] < 0.0 and -1.0 / real[k] <= deepest:
                out[i, found] = -1.0 / real[k]
                found += 1
        out[i, :found].sort()
        count[i] = found


@njit(cache=True, error_model="numpy")
def loudest(p, speed, depth, multiplier, out):
    """Of the frequencies that a multiplier may stand for the one at which the tip moves most, Hz.

    Its motion is e^{st} times a periodic one, s = ln(mu) / T: the null vector w of 1 + b K(mu) (S0 - S1 / mu) makes the force,
    and each harmonic of that moves the tip by G(s + 2 pi j k / T).

    speed, depth, out : (point,)   multiplier : complex (point,)
    """
    gamma, phi, evolution, feed, block, stretch, ends, waves, _, _, _, _, _ = _room(p)
    unknowns, states = phi.shape
    away, given = np.empty((states, states), np.complex128), feed.astype(np.complex128)
    wave, loop = np.empty((unknowns, unknowns), np.complex128), np.empty((unknowns, unknowns), np.complex128)
    begin = np.empty(unknowns, np.complex128)
    share = np.empty(unknowns)
    for a in range(unknowns):
        n = p.order[p.piece[a]]
        share[a] = p.length[p.piece[a]] * p.weight[p.table[p.piece[a]], : n + 1, :, p.place[a]].sum()
    highest = np.abs(p.pole).max()
    for i in range(len(speed)):
        if i == 0 or speed[i] != speed[i - 1]:
            _prepare(p, speed[i], gamma, phi, evolution, feed, block, stretch, ends, waves)
        mu = multiplier[i]
        for k in range(states):
            for c in range(states):
                away[k, c] = -evolution[k, c]
            away[k, k] += mu
            for a in range(unknowns):
                given[k, a] = feed[k, a]
        carried = np.linalg.solve(away, given)
        for a in range(unknowns):
            begin[a] = math.cos(1.0 + a * a)  # any vector that no mode is at right angles to
            for b in range(unknowns):
                wave[a, b] = p.now[a, b]
                total = gamma[a, b] + 0j
                for k in range(states):
                    total += phi[a, k] * carried[k, b]
                loop[a, b] = total
            for k in range(len(p.memory)):
                wave[a, p.memory[k]] -= p.before[a, k] / mu
        whole = depth[i] * (loop @ wave)
        for a in range(unknowns):
            whole[a, a] += 1.0 + 1e-12j  # beside the pole, not on it
        force = wave @ np.linalg.solve(whole, begin)
        time = p.period / speed[i]
        base = np.log(mu) / time
        reach = math.ceil(1.5 * highest * time / (2 * math.pi)) + 2
        most = -1.0
        for k in range(-reach, reach + 1):
            s = base + 2j * math.pi * k / time
            x = y = 0j
            for a in range(unknowns):
                part = force[a] * share[a] * np.exp(-s * _angle(p, a) / speed[i])
                if p.rubs[a]:
                    part /= speed[i]
                x += part * p.column[a, 0]
                y += part * p.column[a, 1]
            right, up = (
                p.flexibility[0, 0] * x + p.flexibility[0, 1] * y,
                p.flexibility[1, 0] * x + p.flexibility[1, 1] * y,
            )
            for m in range(len(p.pole)):
                one = (p.given[m, 0] * x + p.given[m, 1] * y) / (s - p.pole[m])
                other = (np.conj(p.given[m, 0]) * x + np.conj(p.given[m, 1]) * y) / (s - np.conj(p.pole[m]))
                right += p.output[m, 0] * one + np.conj(p.output[m, 0]) * other
                up += p.output[m, 1] * one + np.conj(p.output[m, 1]) * other
            size = abs(right) ** 2 + abs(up) ** 2
            if size > most:
                most = size
                out[i] = abs(s.imag) / (2 * math.pi)
