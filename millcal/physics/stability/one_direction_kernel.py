"""The stable depths of one structure and force at many speeds, from the trace of `one_direction`, compiled.

This module imports numba and so is imported where it is used.
"""

import numpy as np
from numba import njit

NEGLIGIBLE = 1e-11
CANCELLED = 1e10  # terms so much larger than their sum leave it 1e-6
HALVINGS = 16
CIRCLE = 256  # angles from which Newton's method may start
NEAR = 1e-3  # share of a depth that halving may have left
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
    kernel, end = np.empty((nodes, nodes)), np.empty((2, nodes))  # K transposed
    q, w, turned = np.empty(nodes), np.empty((2, nodes)), np.empty((2, nodes))
    stretch = np.empty((MOST_ORDERS, 2, 2))
    products, product = np.empty((len(ratio), 2, 2, terms)), np.empty((2, 2, terms))
    degrees = np.empty(len(ratio), np.int64)
    was_cut = False
    for a in range(len(sigma)):
        products[:] = 0.0
        products[:, 0, 0, 0] = 1.0
        products[:, 1, 1, 0] = 1.0
        degrees[:] = 1
        for p in range(len(length)):
            phase = 2 * np.pi * sigma[a] * length[p]
            cuts = False
            for i in range(nodes):
                cuts = cuts or plain[p, i] != 0 or with_ratio[p, i] != 0
            if cuts and (p == 0 or length[p] != length[p - 1] or not was_cut):
                for i in range(nodes):
                    for j in range(nodes):
                        kernel[j, i] = 0.0
                    for m in range(len(inner)):
                        here = np.sin(phase * node[i] * (1 - inner[m])) * inner_weight[m] * phase * node[i]
                        for j in range(nodes):
                            kernel[j, i] += here * lagrange[i, m, j]
                    end[0, i] = phase * weight[i] * np.sin(phase * (1 - node[i]))
                    end[1, i] = phase * weight[i] * np.cos(phase * (1 - node[i]))
            was_cut = cuts
            for b in range(len(ratio)):
                stretch[0, 0, 0] = stretch[0, 1, 1] = np.cos(phase)
                stretch[0, 0, 1], stretch[0, 1, 0] = np.sin(phase), -np.sin(phase)
                orders = 1
                if cuts:
                    for i in range(nodes):
                        q[i] = -reach * (plain[p, i] + ratio[b] * with_ratio[p, i])
                        w[0, i], w[1, i] = np.cos(phase * node[i]), np.sin(phase * node[i])
                    largest, small = 1.0, 0
                    while orders < min(MOST_ORDERS, terms) and small < 2:
                        size = 0.0
                        for c in range(2):
                            at_end, fast = 0.0, 0.0
                            for j in range(nodes):
                                w[c, j] *= q[j]
                                turned[c, j] = 0.0
                                at_end += end[0, j] * w[c, j]
                                fast += end[1, j] * w[c, j]
                            stretch[orders, 0, c], stretch[orders, 1, c] = at_end, fast
                            size = max(size, abs(at_end), abs(fast))
                            for j in range(nodes):
                                here = w[c, j]
                                for i in range(nodes):
                                    turned[c, i] += kernel[j, i] * here
                        largest = max(largest, size)
                        small = small + 1 if size < 1e-17 * largest else 0
                        orders += 1
                        w, turned = turned, w
                degree = min(degrees[b] + orders - 1, terms)
                product[:, :, :degree] = 0.0
                for k in range(orders):
                    known = min(degrees[b], terms - k)
                    for i in range(2):
                        for c in range(2):
                            first, second = stretch[k, i, 0], stretch[k, i, 1]
                            for t in range(known):
                                product[i, c, t + k] += first * products[b, 0, c, t] + second * products[b, 1, c, t]
                products[b, :, :, :degree] = product[:, :, :degree]
                degrees[b] = degree
        for b in range(len(ratio)):
            for t in range(terms):
                series[b, a, t] = products[b, 0, 0, t] + products[b, 1, 1, t]


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _interpolated(series, place, between, scale, coefficient):  # type: ignore[no-untyped-def]
    """Coefficients at a place between nodes of sigma (six points), or at a node, each times a power of the scale."""
    if not between:
        power = 1.0
        for n in range(series.shape[1]):
            coefficient[n] = series[int(place), n] * power
            power *= scale
        return
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
def _cancels(coefficient, share, decay):  # type: ignore[no-untyped-def]
    """Whether `_stable` says no only because it does not know."""
    power, largest = 1.0, 0.0
    for n in range(len(coefficient)):
        largest = max(largest, abs(coefficient[n]) * power)
        power *= share
    return decay * largest > CANCELLED


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
def edges_of_draw(series, place, between, decay, scale, deepest, depths, edges, flips, cancelled):  # type: ignore[no-untyped-def]
    """The edges of the set of stable depths at many speeds.

    series : t in (xi / reach)^n on nodes of sigma, (sigma, term)   place : in the nodes, (speed,), between them or not
    decay : exp(-zeta w tau), (speed,)   scale : 2 xi / (1 - z) per depth over the reach, 1/m   deepest : m
    edges : (speed, edge) m, inf, written   flips : bool (speed, edge), written
    cancelled : bool (speed,), written: where terms leave too little of their sum to say how deep a cut stays stable; no edges
    """
    terms, room = series.shape[1], edges.shape[1]
    coefficient, polynomial = np.empty(terms), np.empty(terms + 3)
    stable, flip = np.empty(depths + 1, np.bool_), np.empty(depths + 1)
    at, flag = np.empty(6), np.empty(6, np.bool_)  # the ends of a step, and both sides of the flips within
    for s in range(len(place)):
        _interpolated(series, place[s], between, scale * deepest, coefficient)
        e, found = decay[s], 0
        cancelled[s] = False
        stable[0], flip[0] = True, _flip(coefficient, 0.0, e)
        for i in range(1, depths + 1):
            stable[i] = _stable(coefficient, i / depths, e, polynomial)
            cancelled[s] |= stable[i - 1] and not stable[i] and _cancels(coefficient, i / depths, e)
            flip[i] = _flip(coefficient, i / depths, e)
        if cancelled[s]:
            continue
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
                    edges[s, found], flips[s, found] = deepest * share, j % 2 == 1
                    found += 1


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def polish(series, row, scale, decay, flip, depth, angle):  # type: ignore[no-untyped-def]
    """Depths and angles of multipliers on the unit circle, z = exp(-j angle), by Newton from depths that are nearly right.

    series : at the speeds, (speed, term)   row : speed of each crossing, (crossing,)   decay : (speed,)
    flip : bool (crossing,), those are left as they are   depth, angle : (crossing,) m, rad, written
    """
    terms, size = series.shape[1], np.empty(CIRCLE + 1)
    for c in range(len(row)):
        if flip[c]:
            angle[c] = np.pi
            continue
        coefficient, e = series[row[c]], decay[row[c]]
        start = depth[c] * scale
        angle[c] = np.nan
        for i in range(CIRCLE + 1):
            value, _, _ = _characteristic(coefficient, start, np.pi * i / CIRCLE, e, terms)
            size[i] = abs(value)
        # From the least on, for other multipliers are near the circle too.
        for _ in range(8):
            i = int(np.argmin(size))
            x, theta = start, np.pi * min(max(i, 0.5), CIRCLE - 0.5) / CIRCLE
            for _ in range(30):
                value, by_x, by_angle = _characteristic(coefficient, x, theta, e, terms)
                determinant = by_x.real * by_angle.imag - by_x.imag * by_angle.real
                dx = -(value.real * by_angle.imag - value.imag * by_angle.real) / determinant
                turn = -(by_x.real * value.imag - by_x.imag * value.real) / determinant
                x += dx
                theta += turn
                if abs(dx) < 1e-14 * x and abs(turn) < 1e-14:
                    break
            if abs(x - start) < NEAR * start and 0 < theta < np.pi:
                depth[c], angle[c] = x / scale, theta
                break
            low = high = i  # the valley that led nowhere
            while low > 0 and size[low - 1] >= size[low]:
                low -= 1
            while high < CIRCLE and size[high + 1] >= size[high]:
                high += 1
            size[low : high + 1] = np.inf
            if not np.isfinite(size.min()):
                break


@njit(cache=True, error_model="numpy")  # type: ignore[misc]
def _characteristic(coefficient, x, theta, decay, terms):  # type: ignore[no-untyped-def]
    """1 - z T + z^2 D at a depth, in units of 1 / scale, and a z on the circle.   returns it, its slopes by x and by theta"""
    z = np.exp(-1j * theta)
    half = 0.5 * (1 - z)
    y = x * half
    total, slope = 0j, 0j
    for n in range(terms - 1, -1, -1):
        slope = slope * y + total
        total = total * y + coefficient[n]
    value = 1 - z * decay * total + z * z * decay * decay
    by_z = -decay * total + 2 * z * decay * decay + z * decay * slope * 0.5 * x
    return value, -z * decay * slope * half, -1j * z * by_z
