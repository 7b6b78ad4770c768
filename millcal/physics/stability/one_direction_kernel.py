"""The stable depths of one structure and force at many speeds, from the trace of `one_direction`, compiled.

This module imports numba and so is imported where it is used.
"""

import numpy as np
from numba import njit

NEGLIGIBLE = 1e-11
CANCELLED = 1e10  # terms so much larger than their sum leave it 1e-6
HALVINGS = 16
MOST_ORDERS = 100  # of Neumann's series in a stretch
SIDE = 1e-7  # of a flip's depth: so near to it stability is asked on both sides


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def add_series(sigma, ratio, reach, length, plain, with_ratio, node, weight, inner, inner_weight, lagrange, series):  # type: ignore[no-untyped-def]
    """Coefficients of t in (xi / reach)^n: the trace of the product of what each stretch makes of displacement and velocity.

    Volterra's equation v = Phi z0 - xi K (q v) at Gauss's nodes of a stretch, K the integrals of sin(w (t - s)) with Lagrange's
    polynomials, is solved by Neumann's series: its terms are the powers of xi, and fall as 1 / (2 n)!.

    sigma, ratio : (sigma,), (ratio,)   length : of stretches in tooth periods, (stretch,)
    plain, with_ratio : q = plain + K_rc / K_tc with_ratio at the nodes, (stretch, node)
    node .. lagrange : of `one_direction`   series : (ratio, sigma, term), written
    """
    nodes, terms = len(node), series.shape[2]
    kernel, end = np.empty((nodes, nodes)), np.empty((2, nodes))
    w, turned = np.empty((nodes, 2)), np.empty((nodes, 2))
    stretch = np.empty((MOST_ORDERS, 2, 2))
    product, before = np.empty((terms, 2, 2)), np.empty((terms, 2, 2))
    was_cut = False
    for a in range(len(sigma)):
        products = np.zeros((len(ratio), terms, 2, 2))
        products[:, 0, 0, 0] = 1.0
        products[:, 0, 1, 1] = 1.0
        for p in range(len(length)):
            phase = 2 * np.pi * sigma[a] * length[p]
            cuts = False
            for i in range(nodes):
                cuts = cuts or plain[p, i] != 0 or with_ratio[p, i] != 0
            if cuts and (p == 0 or length[p] != length[p - 1] or not was_cut):
                for i in range(nodes):
                    for j in range(nodes):
                        kernel[i, j] = 0.0
                    for m in range(len(inner)):
                        here = np.sin(phase * node[i] * (1 - inner[m])) * inner_weight[m] * phase * node[i]
                        for j in range(nodes):
                            kernel[i, j] += here * lagrange[i, m, j]
                    end[0, i] = phase * weight[i] * np.sin(phase * (1 - node[i]))
                    end[1, i] = phase * weight[i] * np.cos(phase * (1 - node[i]))
            was_cut = cuts
            for b in range(len(ratio)):
                stretch[0, 0, 0] = stretch[0, 1, 1] = np.cos(phase)
                stretch[0, 0, 1], stretch[0, 1, 0] = np.sin(phase), -np.sin(phase)
                orders = 1
                if cuts:
                    for i in range(nodes):
                        w[i, 0], w[i, 1] = np.cos(phase * node[i]), np.sin(phase * node[i])
                    largest, small = 1.0, 0
                    while orders < min(MOST_ORDERS, terms) and small < 2:
                        for i in range(nodes):
                            q = -reach * (plain[p, i] + ratio[b] * with_ratio[p, i])
                            w[i, 0] *= q
                            w[i, 1] *= q
                        size = 0.0
                        for i in range(2):
                            for c in range(2):
                                total = 0.0
                                for j in range(nodes):
                                    total += end[i, j] * w[j, c]
                                stretch[orders, i, c] = total
                                size = max(size, abs(total))
                        largest = max(largest, size)
                        small = small + 1 if size < 1e-17 * largest else 0
                        orders += 1
                        for i in range(nodes):
                            first, second = 0.0, 0.0
                            for j in range(nodes):
                                first += kernel[i, j] * w[j, 0]
                                second += kernel[i, j] * w[j, 1]
                            turned[i, 0], turned[i, 1] = first, second
                        w, turned = turned, w
                before[:] = products[b]
                product[:] = 0.0
                for k in range(orders):
                    c00, c01, c10, c11 = stretch[k, 0, 0], stretch[k, 0, 1], stretch[k, 1, 0], stretch[k, 1, 1]
                    for t in range(terms - k):
                        product[t + k, 0, 0] += c00 * before[t, 0, 0] + c01 * before[t, 1, 0]
                        product[t + k, 0, 1] += c00 * before[t, 0, 1] + c01 * before[t, 1, 1]
                        product[t + k, 1, 0] += c10 * before[t, 0, 0] + c11 * before[t, 1, 0]
                        product[t + k, 1, 1] += c10 * before[t, 0, 1] + c11 * before[t, 1, 1]
                products[b] = product
        for b in range(len(ratio)):
            for t in range(terms):
                series[b, a, t] = products[b, t, 0, 0] + products[b, t, 1, 1]


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _interpolated(series, place, scale, coefficient):  # type: ignore[no-untyped-def]
    """Coefficients at a place between nodes of sigma (six points), each times a power of the scale.   returns terms used"""
    first = int(np.floor(place)) - 2
    first = min(max(first, 0), len(series) - 6)
    t = place - first
    terms = series.shape[1]
    for n in range(terms):
        coefficient[n] = 0.0
    for j in range(6):
        weight = 1.0
        for other in range(6):
            if other != j:
                weight *= (t - other) / (j - other)
        for n in range(terms):
            coefficient[n] += weight * series[first + j, n]
    power = 1.0
    for n in range(terms):
        coefficient[n] *= power
        power *= scale


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _flip(coefficient, share, decay):  # type: ignore[no-untyped-def]
    """1 + T(2 beta) + D, which is 0 where a multiplier is -1.   share : of the deepest"""
    total = 0.0
    for n in range(len(coefficient) - 1, -1, -1):
        total = total * share + coefficient[n]
    return 1 + decay * total + decay * decay


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _stable(coefficient, share, decay, polynomial):  # type: ignore[no-untyped-def]
    """Whether  1 - z T(beta (1 - z)) + z^2 D  has no root in the unit disc.

    coefficient : those of (xi / xi_max)^n, xi_max = 2 beta of the deepest   share : of the deepest
    polynomial : room for two more than the coefficients
    """
    # T in powers of 1 - z = 2 y: terms of (share y)^n, kept up to the last that matters.
    power, largest, used = 1.0, 0.0, 0
    half = 0.5 * share  # (xi / xi_max) = share (1 - z) / 2
    for n in range(len(coefficient)):
        here = abs(coefficient[n]) * power  # on the circle |1 - z| reaches 2
        largest = max(largest, here)
        if here > NEGLIGIBLE * max(largest, 1.0):
            used = n
        power *= share
    if decay * largest > CANCELLED:
        return False
    power = half**used
    polynomial[0] = coefficient[used] * power
    degree = 0
    for n in range(used - 1, -1, -1):
        power = power / half
        polynomial[degree + 1] = -polynomial[degree]
        for j in range(degree, 0, -1):
            polynomial[j] -= polynomial[j - 1]
        degree += 1
        polynomial[0] += coefficient[n] * power
    for j in range(degree, -1, -1):
        polynomial[j + 1] = -decay * polynomial[j]
    polynomial[0] = 1.0
    degree += 1
    if degree < 2:
        degree = 2
        polynomial[2] = 0.0
    polynomial[2] += decay * decay
    while degree > 0 and abs(polynomial[degree]) < NEGLIGIBLE:
        degree -= 1
    # Schur and Cohn, from the highest down: stable while every reflection is below 1.
    while degree > 0:
        k = polynomial[degree]
        if not abs(k) < 1:
            return False
        shrink = 1 / (1 - k * k)
        i, j = 1, degree - 1
        while i < j:
            a, b = polynomial[i], polynomial[j]
            polynomial[i], polynomial[j] = (a - k * b) * shrink, (b - k * a) * shrink
            i += 1
            j -= 1
        if i == j:
            polynomial[i] *= (1 - k) * shrink
        degree -= 1
    return True


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _edge(coefficient, low, high, stable_at_low, decay, polynomial):  # type: ignore[no-untyped-def]
    """Where between two shares of the deepest stability changes."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _stable(coefficient, middle, decay, polynomial) == stable_at_low:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _flip_between(coefficient, low, high, decay):  # type: ignore[no-untyped-def]
    """The root of `_flip` between two shares at which its signs differ (Illinois)."""
    at_low, at_high = _flip(coefficient, low, decay), _flip(coefficient, high, decay)
    for _ in range(60):
        new = high - at_high * (high - low) / (at_high - at_low)
        value = _flip(coefficient, new, decay)
        if (value < 0) == (at_high < 0):
            at_low /= 2
        else:
            low, at_low = high, at_high
        done = abs(new - high) < 1e-13
        high, at_high = new, value
        if done or value == 0:
            break
    return high


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _turn(flip, i):  # type: ignore[no-untyped-def]
    """Where the parabola through three values about the i-th has its point nearest to zero; i itself where there is none."""
    bend = flip[i - 1] + flip[i + 1] - 2 * flip[i]
    if bend * flip[i] <= 0:
        return float(i)
    return i + 0.5 * (flip[i - 1] - flip[i + 1]) / bend


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def edges_of_draw(series, place, decay, scale, deepest, depths, edges):  # type: ignore[no-untyped-def]
    """The edges of the set of stable depths at many speeds.

    series : t in (xi / reach)^n on nodes of sigma, (sigma, term)   place : between the nodes, (speed,)
    decay : exp(-zeta w tau), (speed,)   scale : 2 xi / (1 - z) per depth over the reach, 1/m   deepest : m
    edges : (speed, edge), inf, written
    """
    terms, room = series.shape[1], edges.shape[1]
    coefficient, polynomial = np.empty(terms), np.empty(terms + 3)
    stable, flip = np.empty(depths + 1, np.bool_), np.empty(depths + 1)
    at, flag = np.empty(6), np.empty(6, np.bool_)  # the ends of a step, and both sides of the flips within
    for s in range(len(place)):
        _interpolated(series, place[s], scale * deepest, coefficient)
        e, found = decay[s], 0
        stable[0], flip[0] = True, _flip(coefficient, 0.0, e)
        for i in range(1, depths + 1):
            stable[i] = _stable(coefficient, i / depths, e, polynomial)
            flip[i] = _flip(coefficient, i / depths, e)
        for i in range(depths):
            at[0], flag[0], count = i / depths, stable[i], 1
            if flip[i] * flip[i + 1] < 0:
                at[1] = _flip_between(coefficient, at[0], (i + 1) / depths, e)
                count = 3
            else:  # a pair of flips within the step, where a parabola through three values says so
                for j in (i, i + 1):
                    if 0 < j < depths and count == 1:
                        turn = _turn(flip, j)
                        if i < turn < i + 1 and _flip(coefficient, turn / depths, e) * flip[i] < 0:
                            at[1] = _flip_between(coefficient, at[0], turn / depths, e)
                            at[3] = _flip_between(coefficient, turn / depths, (i + 1) / depths, e)
                            count = 5
            for j in range(1, count, 2):
                at[j + 1] = at[j] * (1 + SIDE)
                at[j] *= 1 - SIDE
                flag[j] = _stable(coefficient, at[j], e, polynomial)
                flag[j + 1] = _stable(coefficient, at[j + 1], e, polynomial)
            at[count], flag[count] = (i + 1) / depths, stable[i + 1]
            for j in range(count):
                if flag[j] != flag[j + 1] and found < room:
                    share = 0.5 * (at[j] + at[j + 1])  # both sides of a flip, or the ends of a step
                    if j % 2 == 0:
                        share = _edge(coefficient, at[j], at[j + 1], flag[j], e, polynomial)
                    edges[s, found] = deepest * share
                    found += 1
