"""One period of a cut, piece by piece, compiled: see `by_pieces` for the equations.

`lay` divides the period and finds whose wave each node meets, `prepare` makes the matrices of the pieces at one speed, `solve`
those of one depth; `pass_through` carries a state through the period, and `krylov` does so again and again.

A state is the motion on the nodes of the last pieces, from `Lay.kept` on, then of each mode real and imaginary part. On a piece
of n nodes and d directions an array of motion or force holds direction a at node i in place a n + i.

This module imports numba and so is imported where it is used. It is long because numba's cache does not notice an edit in what a
kernel inlines from elsewhere.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

APART = 1e-9  # rad: ends of pieces nearer than that are one
FAST = {"reassoc", "contract"}


class Shape(NamedTuple):
    """The geometry of a cut, in a period that is one pitch, or the pattern of pitches that repeats."""

    period: float  # rad
    lag: np.ndarray  # of each tooth of the pattern behind the first, (tooth,) rad
    delay: np.ndarray  # since the tooth before, (tooth,) rad
    entry: float  # rad
    swept: float  # from entry to exit, rad
    ktc: float  # N/m^2
    krc: float
    wind: float  # rad/m
    straight: float  # rad over the depth, below which the mean angle stands for all heights


class Tip(NamedTuple):
    """The modes as seen along the directions in which the tip moves and is pushed."""

    pole: np.ndarray  # complex (mode,), 1/s
    seen: np.ndarray  # complex (mode, direction), of length one
    given: np.ndarray  # complex (mode, direction)
    flexibility: np.ndarray  # (direction, direction), m/N
    rows: np.ndarray  # (direction, 2): of the motion
    columns: np.ndarray  # (direction, 2): of the force


class Tables(NamedTuple):
    """Gauss nodes of every order, and what a polynomial does to another in a convolution; order n begins at *_at[n]."""

    node: np.ndarray
    bary: np.ndarray
    node_at: np.ndarray
    fine: np.ndarray  # nodes of the impulse response
    fine_at: np.ndarray
    weight: np.ndarray  # (fine node, n + 1, n): up to node i, i = n: over the piece
    weight_at: np.ndarray
    more: int  # fine nodes beyond the order


class Lay(NamedTuple):
    """Pieces, nodes, and forces and sources on them."""

    start: np.ndarray  # (piece,) rad
    length: np.ndarray
    order: np.ndarray  # integer
    first: np.ndarray  # integer (piece + 1,): its motion begins there, d n numbers
    met: np.ndarray  # integer (piece + 1,): waves met on it, one for each delay
    force: np.ndarray  # (.., n, d, d): force against each wave
    force_at: np.ndarray  # integer (wave,)
    total: np.ndarray  # (.., n, d, d): force against the motion
    total_at: np.ndarray  # integer (piece,)
    source: (
        np.ndarray
    )  # integer: piece of the wave that a node meets, (.., n); of the period before: less its number of pieces
    source_at: np.ndarray  # integer (wave,)
    share: np.ndarray  # of the nodes of that piece
    share_at: np.ndarray  # integer: (.., n) where those of a node begin
    kept: int  # the first piece that the next period meets
    same: bool  # each node meets its own wave of the period before


@njit(cache=True, error_model="numpy")
def _marks(shape, lag):
    """Ends of pieces, ascending, from 0 to the period: of teeth and edges, and where those come back as ends of waves."""
    teeth = len(shape.lag)
    ends = np.empty(4 * teeth + 1)
    ends[0] = 0.0
    count = 1
    for j in range(teeth):
        for end in (0.0, shape.swept, lag, shape.swept + lag):
            ends[count] = (shape.lag[j] + end) % shape.period
            count += 1
    ends = _apart(ends[:count], shape.period)
    if teeth == 1:
        return ends
    again = np.empty(len(ends) * teeth)
    count = 0
    for j in range(teeth):
        for end in ends[:-1]:
            t = (end + shape.delay[j]) % shape.period
            if (t - shape.lag[j]) % shape.period <= shape.swept + lag or shape.swept + lag >= shape.period:
                again[count] = t
                count += 1
    return _apart(np.concatenate((ends[:-1], again[:count])), shape.period)


@njit(cache=True, error_model="numpy")
def _apart(ends, period):
    ends = np.sort(np.where(period - ends < APART, 0.0, ends))
    kept = np.empty(len(ends) + 1)
    kept[0] = 0.0
    count = 1
    for end in ends:
        if end - kept[count - 1] > APART:
            kept[count] = end
            count += 1
    kept[count] = period
    return kept[: count + 1]


@njit(cache=True, error_model="numpy")
def _nodes(waves, decades):
    """`cut_period.nodes_of`, with decades for the tolerance."""
    return int(max(math.ceil(waves / 2 + decades / 4 + decades / 2 * waves ** (1 / 3) - 1e-9), 3))


@njit(cache=True, error_model="numpy")
def _antiderivative(angle, ktc, krc, out):
    s = math.sin(angle)
    c = math.cos(angle)
    square, ss, cc = s * s / 2, (angle - s * c) / 2, (angle + s * c) / 2
    out[0, 0], out[0, 1] = ktc * square + krc * ss, ktc * cc + krc * square
    out[1, 0], out[1, 1] = krc * square - ktc * ss, krc * cc - ktc * square


@njit(cache=True, error_model="numpy")
def _force(shape, angle, lag, depth, tip, low, high, out):
    """Adds the force of a tooth against the motion, N/m: of a straight edge per depth.   angle : at the helix bottom, rad"""
    if lag > shape.straight:
        _antiderivative(max(angle - lag, shape.entry), shape.ktc, shape.krc, low)
        _antiderivative(min(angle, shape.entry + shape.swept), shape.ktc, shape.krc, high)
        for k in range(2):
            for l in range(2):
                high[k, l] = (high[k, l] - low[k, l]) / shape.wind
    else:
        by = depth if shape.wind > 0.0 else 1.0
        s, c = math.sin(angle - lag / 2), math.cos(angle - lag / 2)
        for k in range(2):
            push = shape.ktc * c + shape.krc * s if k == 0 else shape.krc * c - shape.ktc * s
            high[k, 0], high[k, 1] = by * push * s, by * push * c
    size = len(tip.rows)
    for a in range(size):
        for b in range(size):
            for k in range(2):
                for l in range(2):
                    out[a, b] += tip.columns[a, k] * high[k, l] * tip.rows[b, l]


@njit(cache=True, error_model="numpy")
def lay(shape, tip, tables, depth, rate, decades, most):
    """The `Lay` of one depth.   rate : waves, rad per rad   decades : of accuracy   most : waves of a piece, rad"""
    lag = shape.wind * depth
    swept = shape.swept + (lag if lag > shape.straight else 0.0)
    seen_lag = swept - shape.swept
    marks = _marks(shape, seen_lag)
    teeth, size, period = len(shape.lag), len(tip.rows), shape.period
    around = math.ceil(swept / period) + 1
    # count pieces
    parts = np.zeros(len(marks) - 1, np.int64)
    for p in range(len(parts)):
        middle = (marks[p] + marks[p + 1]) / 2
        for j in range(teeth):
            if (middle - shape.lag[j]) % period < swept:
                parts[p] = max(1, math.ceil(rate * (marks[p + 1] - marks[p]) / most - 1e-9))
    pieces = parts.sum()
    start, length, order = np.empty(pieces), np.empty(pieces), np.empty(pieces, np.int64)
    first, met = np.zeros(pieces + 1, np.int64), np.zeros(pieces + 1, np.int64)
    total_at = np.empty(pieces, np.int64)
    p = 0
    for m in range(len(parts)):
        for part in range(parts[m]):
            length[p] = (marks[m + 1] - marks[m]) / parts[m]
            start[p] = marks[m] + part * length[p]
            order[p] = _nodes(rate * length[p], decades)
            first[p + 1] = first[p] + size * order[p]
            total_at[p] = first[p] * size
            p += 1
    total = np.zeros(first[pieces] * size)
    force, force_at = np.zeros(first[pieces] * size * teeth), np.empty(pieces * teeth, np.int64)
    source, source_at = np.empty(first[pieces] * teeth, np.int64), np.empty(pieces * teeth, np.int64)
    share_at = np.empty(first[pieces] * teeth, np.int64)
    share = np.empty(first[pieces] * teeth * order.max())
    low, high = np.empty((2, 2)), np.empty((2, 2))
    same = teeth == 1
    wave = forces = sources = shares = 0
    kept = pieces
    for p in range(pieces):
        n = order[p]
        all_of = total[total_at[p] : total_at[p] + n * size * size].reshape(n, size, size)
        middle = start[p] + length[p] / 2
        for j in range(teeth):
            if (middle - shape.lag[j]) % period >= swept:
                continue
            each = force[forces : forces + n * size * size].reshape(n, size, size)
            force_at[wave], source_at[wave] = forces, sources
            forces += n * size * size
            for i in range(n):
                t = start[p] + length[p] * tables.node[tables.node_at[n] + i]
                since = (middle - shape.lag[j]) % period + t - middle
                for _ in range(around):
                    if since < swept + APART:
                        _force(shape, shape.entry + since, lag, depth, tip, low, high, each[i])
                    since += period
                for a in range(size):
                    for b in range(size):
                        all_of[i, a, b] += each[i, a, b]
                past = t - shape.delay[j]
                before = past < -APART
                place = past + period if before else past
                from_ = p if same else max(0, np.searchsorted(start, place + 2 * APART, side="right") - 1)
                share_at[sources + i] = shares
                source[sources + i] = from_ - pieces if before else from_
                if same:
                    continue
                if before and from_ < kept:
                    kept = from_
                q = order[from_]
                inside = (place - start[from_]) / length[from_]
                at, on, whole = tables.node_at[q], -1, 0.0
                for k in range(q):
                    gap = inside - tables.node[at + k]
                    if abs(gap) < 1e-14:
                        on = k
                        gap = 1.0
                    share[shares + k] = tables.bary[at + k] / gap
                    whole += share[shares + k]
                for k in range(q):
                    share[shares + k] = (1.0 if k == on else 0.0) if on >= 0 else share[shares + k] / whole
                shares += q
            sources += n
            wave += 1
        met[p + 1] = wave
    return Lay(
        start, length, order, first, met, force[:forces].copy(), force_at[:wave].copy(), total, total_at,
        source[:sources].copy(), source_at[:wave].copy(), share[:shares].copy(), share_at[:sources].copy(),
        0 if same else kept, same,
    )  # fmt: skip


class Prepared(NamedTuple):
    """The pieces at one speed; they do not depend on the depth but for the lay."""

    push: np.ndarray  # (.., d n, d n): motion by the forces of the piece itself
    push_at: np.ndarray  # integer (piece,)
    free: np.ndarray  # (.., d n, 2 mode): motion by the modes at its start
    feed: np.ndarray  # (.., 2 mode, d n): modes at its end by its forces
    free_at: np.ndarray  # integer (piece,)
    across: np.ndarray  # complex (piece, mode): modes over the piece
    gap: np.ndarray  # complex (piece + 1, mode): over what is not cut before it, and after the last


@njit(cache=True, error_model="numpy", fastmath=FAST)
def prepare(lay, shape, tip, tables, speed):
    """The `Prepared` of one speed."""
    pieces, modes, size = len(lay.start), len(tip.pole), len(tip.rows)
    push_at, free_at = np.empty(pieces, np.int64), np.empty(pieces, np.int64)
    pushes = frees = 0
    for p in range(pieces):
        full = size * lay.order[p]
        push_at[p], free_at[p] = pushes, frees
        pushes += full * full
        frees += full * 2 * modes
    push, free, feed = np.zeros(pushes), np.empty(frees), np.empty(frees)
    across, gap = np.empty((pieces, modes), np.complex128), np.empty((pieces + 1, modes), np.complex128)
    most = lay.order.max()
    wave = np.empty((most + tables.more, modes), np.complex128)
    table, ends = np.zeros(most * most), np.empty(most, np.complex128)
    end = 0.0
    for p in range(pieces):
        n, length = lay.order[p], lay.length[p]
        full, q = size * n, n + tables.more
        for m in range(modes):
            s = tip.pole[m] / speed
            across[p, m] = np.exp(s * length)
            gap[p, m] = np.exp(s * (lay.start[p] - end))
        end = lay.start[p] + length
        out = push[push_at[p] : push_at[p] + full * full].reshape(full, full)
        moved = free[free_at[p] : free_at[p] + full * 2 * modes].reshape(full, 2 * modes)
        after = feed[free_at[p] : free_at[p] + full * 2 * modes].reshape(2 * modes, full)
        if p > 0 and lay.order[p - 1] == n and abs(lay.length[p - 1] - length) < 1e-13:
            out[:] = push[push_at[p - 1] : push_at[p - 1] + full * full].reshape(full, full)
            moved[:] = free[free_at[p - 1] : free_at[p - 1] + full * 2 * modes].reshape(full, 2 * modes)
            after[:] = feed[free_at[p - 1] : free_at[p - 1] + full * 2 * modes].reshape(2 * modes, full)
            continue
        for m in range(modes):
            s = tip.pole[m] / speed * length
            for k in range(q):
                wave[k, m] = np.exp(s * tables.fine[tables.fine_at[n] + k])
            for i in range(n):
                whole = np.exp(s * tables.node[tables.node_at[n] + i])
                for a in range(size):
                    one = tip.seen[m, a] * whole
                    moved[a * n + i, 2 * m] = one.real
                    moved[a * n + i, 2 * m + 1] = -one.imag
        at = tables.weight_at[n]
        # what the modes are at the end
        for m in range(modes):
            ends[:n] = 0.0
            for k in range(q):
                by = wave[k, m] * (length / speed)
                row = at + (k * (n + 1) + n) * n
                for j in range(n):
                    ends[j] += by * tables.weight[row + j]
            for b in range(size):
                for j in range(n):
                    one = tip.given[m, b] * ends[j]
                    after[2 * m, b * n + j] = one.real
                    after[2 * m + 1, b * n + j] = one.imag
        # the motion by the impulse response, which is a polynomial, too
        for a in range(size):
            for b in range(size):
                some = False
                for m in range(modes):
                    some = some or abs(tip.seen[m, a] * tip.given[m, b]) > 0.0
                if some:
                    table[: n * n] = 0.0
                    for k in range(q):
                        by = 0.0
                        for m in range(modes):
                            by += (tip.seen[m, a] * tip.given[m, b] * wave[k, m]).real
                        by *= length / speed
                        row = at + k * (n + 1) * n
                        for j in range(n * n):
                            table[j] += by * tables.weight[row + j]
                    for i in range(n):
                        for j in range(n):
                            out[a * n + i, b * n + j] = table[i * n + j]
                for i in range(n):
                    out[a * n + i, b * n + i] += tip.flexibility[a, b]
    for m in range(modes):
        gap[pieces, m] = np.exp(tip.pole[m] / speed * (shape.period - end))
    return Prepared(push, push_at, free, feed, free_at, across, gap)


class Answer(NamedTuple):
    """What moves each piece, solved."""

    matrix: np.ndarray  # (.., d n, 2 mode + d n)
    at: np.ndarray  # integer (piece,)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def solve(lay, prepared, tip, depth):
    """The motion by the modes at the start of each piece and by the waves that it meets.

    With A the motion by a force, H the force against the motion and h that of the waves, u = free y - A (H u - h), so that
    u = (1 + A H)^-1 (free y + A h).   depth : m, what the forces of the lay count per
    """
    modes, size = len(tip.pole), len(tip.rows)
    pieces = len(lay.start)
    at = np.empty(pieces, np.int64)
    count = 0
    for p in range(pieces):
        full = size * lay.order[p]
        at[p] = count
        count += full * (full + 2 * modes)
    answer = np.empty(count)
    for p in range(pieces):
        n = lay.order[p]
        full = size * n
        push = prepared.push[prepared.push_at[p] : prepared.push_at[p] + full * full].reshape(full, full)
        free = prepared.free[prepared.free_at[p] : prepared.free_at[p] + full * 2 * modes].reshape(full, 2 * modes)
        force = lay.total[lay.total_at[p] : lay.total_at[p] + full * size].reshape(n, size, size)
        left, right = np.zeros((full, full)), np.empty((full, full + 2 * modes))
        for r in range(full):
            for c in range(2 * modes):
                right[r, c] = free[r, c]
            for b in range(size):
                for i in range(n):
                    right[r, 2 * modes + b * n + i] = depth * push[r, b * n + i]
                    for a in range(size):
                        left[r, a * n + i] += depth * push[r, b * n + i] * force[i, b, a]
            left[r, r] += 1.0
        answer[at[p] : at[p] + full * (full + 2 * modes)] = np.linalg.solve(left, right).ravel()
    return Answer(answer, at)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _met(lay, p, size, before, motion, h):
    """The force h of the waves that are met on a piece.   before, motion : u of the last period and of this"""
    pieces, n, first = len(lay.start), lay.order[p], lay.first[p]
    full = size * n
    h[:full] = 0.0
    for w in range(lay.met[p], lay.met[p + 1]):
        force = lay.force[lay.force_at[w] : lay.force_at[w] + full * size].reshape(n, size, size)
        if lay.same:
            for i in range(n):
                for a in range(size):
                    for b in range(size):
                        h[a * n + i] += force[i, a, b] * before[first + b * n + i]
            continue
        for i in range(n):
            from_ = lay.source[lay.source_at[w] + i]
            share = lay.share_at[lay.source_at[w] + i]
            past = before if from_ < 0 else motion
            if from_ < 0:
                from_ += pieces
            q, there = lay.order[from_], lay.first[from_]
            for b in range(size):
                total = 0.0
                for k in range(q):
                    total += lay.share[share + k] * past[there + b * q + k]
                for a in range(size):
                    h[a * n + i] += force[i, a, b] * total


@njit(cache=True, error_model="numpy", fastmath=FAST)
def pass_through(lay, prepared, answer, tip, depth, state, motion, pushed):
    """One period.   state : changed   motion, pushed : u and force of all nodes, filled"""
    modes, size, pieces = len(tip.pole), len(tip.rows), len(lay.start)
    begin = lay.first[lay.kept]
    tail = lay.first[pieces] - begin
    before = np.zeros(lay.first[pieces])
    before[begin:] = state[:tail]
    modal = state[tail:].copy()
    most = size * lay.order.max()
    given, h = np.empty(2 * modes + most), np.empty(most)
    for p in range(pieces):
        n, first = lay.order[p], lay.first[p]
        full = size * n
        for m in range(modes):
            here = complex(modal[2 * m], modal[2 * m + 1]) * prepared.gap[p, m]
            given[2 * m], given[2 * m + 1] = here.real, here.imag
        _met(lay, p, size, before, motion, h)
        for c in range(full):
            given[2 * modes + c] = h[c]
        width = full + 2 * modes
        for r in range(full):
            total = 0.0
            row = answer.at[p] + r * width
            for c in range(width):
                total += answer.matrix[row + c] * given[c]
            motion[first + r] = total
        force = lay.total[lay.total_at[p] : lay.total_at[p] + full * size].reshape(n, size, size)
        for a in range(size):
            for i in range(n):
                total = -h[a * n + i]
                for b in range(size):
                    total += force[i, a, b] * motion[first + b * n + i]
                pushed[first + a * n + i] = depth * total
        at = prepared.free_at[p]
        for m in range(modes):
            there = complex(given[2 * m], given[2 * m + 1]) * prepared.across[p, m]
            real, imag = there.real, there.imag
            for c in range(full):
                real -= prepared.feed[at + 2 * m * full + c] * pushed[first + c]
                imag -= prepared.feed[at + (2 * m + 1) * full + c] * pushed[first + c]
            modal[2 * m], modal[2 * m + 1] = real, imag
    for m in range(modes):
        here = complex(modal[2 * m], modal[2 * m + 1]) * prepared.gap[pieces, m]
        state[tail + 2 * m], state[tail + 2 * m + 1] = here.real, here.imag
    state[:tail] = motion[begin:]


@njit(cache=True, error_model="numpy")
def krylov(lay, prepared, answer, tip, depth, basis, hessenberg, done, wanted):
    """More steps of Arnoldi's method on the period, each vector made orthogonal twice.   returns how many there are

    basis : (most + 1, state), of which `done` + 1 are there   hessenberg : (most + 1, most)
    """
    motion, pushed = np.empty(lay.first[-1]), np.empty(lay.first[-1])
    for k in range(done, wanted):
        new = basis[k].copy()
        pass_through(lay, prepared, answer, tip, depth, new, motion, pushed)
        size = math.sqrt(np.dot(new, new))
        for _ in range(2):
            along = np.dot(basis[: k + 1], new)
            new -= np.dot(along, basis[: k + 1])
            hessenberg[: k + 1, k] += along
        left = math.sqrt(np.dot(new, new))
        if not left > 1e-14 * size:  # the whole space that the start reaches
            hessenberg[k + 1, k] = 0.0
            return k + 1
        hessenberg[k + 1, k] = left
        basis[k + 1] = new / left
    return wanted


@njit(cache=True, error_model="numpy", fastmath=FAST)
def answer_to(lay, prepared, tip, motion, out):
    """The motion by the forces H u - h per depth, where all changes its sign from period to period.   motion, out : (node,)"""
    modes, size, pieces = len(tip.pole), len(tip.rows), len(lay.start)
    before = -motion
    most = size * lay.order.max()
    pushed, h = np.empty(most), np.empty(most)
    at_start = np.zeros((pieces, modes), np.complex128)  # of each piece
    modal = np.zeros(modes, np.complex128)
    for p in range(pieces):
        n, first = lay.order[p], lay.first[p]
        full = size * n
        _met(lay, p, size, before, motion, h)
        force = lay.total[lay.total_at[p] : lay.total_at[p] + full * size].reshape(n, size, size)
        for a in range(size):
            for i in range(n):
                total = -h[a * n + i]
                for b in range(size):
                    total += force[i, a, b] * motion[first + b * n + i]
                pushed[a * n + i] = total
        push = prepared.push[prepared.push_at[p] : prepared.push_at[p] + full * full].reshape(full, full)
        for r in range(full):
            total = 0.0
            for c in range(full):
                total += push[r, c] * pushed[c]
            out[first + r] = total
        feed = prepared.feed[prepared.free_at[p] : prepared.free_at[p] + full * 2 * modes].reshape(2 * modes, full)
        for m in range(modes):
            at_start[p, m] = modal[m] * prepared.gap[p, m]
            real = imag = 0.0
            for c in range(full):
                real += feed[2 * m, c] * pushed[c]
                imag += feed[2 * m + 1, c] * pushed[c]
            modal[m] = at_start[p, m] * prepared.across[p, m] + complex(real, imag)
    for m in range(modes):  # y(0) = - y(T)
        whole = prepared.gap[pieces, m]
        for p in range(pieces):
            whole *= prepared.gap[p, m] * prepared.across[p, m]
        modal[m] *= -prepared.gap[pieces, m] / (1 + whole)
    for p in range(pieces):
        full, first = size * lay.order[p], lay.first[p]
        free = prepared.free[prepared.free_at[p] : prepared.free_at[p] + full * 2 * modes].reshape(full, 2 * modes)
        for m in range(modes):
            modal[m] *= prepared.gap[p, m]
            here = at_start[p, m] + modal[m]
            for r in range(full):
                out[first + r] += free[r, 2 * m] * here.real + free[r, 2 * m + 1] * here.imag
            modal[m] *= prepared.across[p, m]
