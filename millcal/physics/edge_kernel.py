"""The force on a helical end mill at one instant, compiled: contact along each edge, chip, law, and the slopes of all.

The edge of tooth j is cut by the surface between two heights, which follow from entry and exit and the lag of the helix. With
x the lag of a point behind the bottom of the edge, the angle of that point is phi = p - x, and so is every line of the chip's
lower envelope (see `cutting_force`) a wave of x:

    a_k sin(p - x) + U_k cos(x) - V_k sin(x),     U = c0 C - s0 S,  V = c0 S + s0 C,
    C = cos psi_j - cos psi_(j-k),  S the same of the sines,      c0 = rho cos(lambda), s0 = rho sin(lambda).

Gauss-Legendre nodes lie between the two heights, so entry and exit are exact. Where runout ends the contact inside, the force
of the edge itself ends at once; there a node counts by the share of its stretch on which the chip, taken as straight, is there.

This module imports numba and so is imported where it is used. Loops of other modules call its functions; numba's cache does
not notice an edit here in what it keeps of them. They take `STAMP` in as a variable of an enclosing function, which is part of
the cache's key: see `millcal.physics.follow_ensemble`.
"""

import hashlib
import inspect
import math
import sys
from typing import NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import chip_lines

STAMP = int(hashlib.sha256(inspect.getsource(sys.modules[__name__]).encode()).hexdigest()[:15], 16)
LAWS = ("kienzle", "linear-edge")
SMALLEST_CHIP = 1e-12  # m: keeps the logarithm finite where the weight is nil, as in `kienzle_functions`


class Edge(NamedTuple):
    """What stays the same over all samples: the cutter, the law, and where the nodes lie."""

    lag: np.ndarray  # psi_j, (tooth,), rad
    wind: float  # lag per height, rad/m; negative for a left-hand helix
    rise: np.ndarray  # a_k over the feed per tooth, (tooth, k)
    cosines: np.ndarray  # C, (tooth, k)
    sines: np.ndarray  # S, (tooth, k)
    node: np.ndarray  # -1..1, (node,)
    weight: np.ndarray  # summing to 1, (node,)
    before: np.ndarray  # from the start of a node's own stretch to the node, in 0..1 as the weights, (node,)
    linear: bool  # linear-edge law; else Kienzle
    reference: float  # h0, m
    axes: np.ndarray  # 0, 1, 2 for x, y, z, (axis,)


def edge_of(cutter: Cutter, law: str, reference_chip: float, axes: tuple[str, ...], nodes: int) -> Edge:
    """The constants of a kernel; without a helix all heights are alike and one node serves."""
    if law not in LAWS:
        raise ValueError(f"{law=} is none of {', '.join(LAWS)}")
    lag = cutter.tooth_lag()
    rise, _ = chip_lines(cutter, 1.0, np.zeros((cutter.teeth, 1)))
    ahead = (np.arange(cutter.teeth)[:, np.newaxis] - np.arange(1, cutter.teeth + 1)) % cutter.teeth
    wind = float(cutter.helix_lag(np.array(1.0)))
    straight = abs(wind) < 1e-9
    node, weight = np.polynomial.legendre.leggauss(1 if straight else nodes)
    return Edge(
        lag,
        0.0 if straight else wind,
        np.ascontiguousarray(rise),
        np.cos(lag)[:, np.newaxis] - np.cos(lag)[ahead],
        np.sin(lag)[:, np.newaxis] - np.sin(lag)[ahead],
        node,
        weight / 2,
        (node + 1) / 2 - np.concatenate([[0.0], np.cumsum(weight / 2)[:-1]]),
        law == "linear-edge",
        float(reference_chip),
        np.array(["xyz".index(axis) for axis in axes]),
    )


@intrinsic  # type: ignore[misc]
def _bits(typing, number):  # type: ignore[no-untyped-def]
    """The 64 bits of a float."""
    return types.int64(types.float64), lambda context, builder, _, args: builder.bitcast(
        args[0], context.get_value_type(types.int64)
    )


@intrinsic  # type: ignore[misc]
def _float(typing, bits):  # type: ignore[no-untyped-def]
    """The float of 64 bits."""
    return types.float64(types.int64), lambda context, builder, _, args: builder.bitcast(
        args[0], context.get_value_type(types.float64)
    )


@njit(cache=True, fastmath={"contract"})
def exponential(x: float) -> float:
    """exp(x) to 2e-15, for |x| < 700. Without a branch or a call, so that a loop over it runs on whole vectors."""
    shifted = (
        x * 1.4426950408889634 + 6755399441055744.0
    )  # 1.5 * 2^52 rounds to an integer and leaves it in the low bits
    k = shifted - 6755399441055744.0
    r = (x - k * 0.6931471803691238) - k * 1.9082149292705877e-10
    p = 2.7249802403754295e-07
    p = p * r + 2.763736356454651e-06
    p = p * r + 2.4802490793309487e-05
    p = p * r + 0.00019841177203159914
    p = p * r + 0.0013888888046728956
    p = p * r + 0.008333333380812326
    p = p * r + 0.04166666666977311
    p = p * r + 0.16666666666560298
    p = p * r + 0.4999999999999606
    p = p * r + 1.0000000000000084
    p = p * r + 1.0
    return p * _float((_bits(shifted) << 52) + 4607182418800017408)  # type: ignore[call-arg]


@njit(cache=True, fastmath={"contract"})
def logarithm(x: float) -> float:
    """ln(x) to 2e-15 of 1 or of itself, for normal positive numbers; without a branch or a call."""
    moved = _bits(x) + 2638147582215219  # type: ignore[call-arg]
    # moved by the bits of 1 less those of sqrt(1/2), so that the mantissa lies within sqrt(1/2)..sqrt(2)
    # an integer in the low bits of 2^52 is that float plus the integer; 1023 is the bias of the exponent
    exponent = _float((moved >> 52) + 4841369599423283200) - 4503599627371519.0  # type: ignore[call-arg]
    m = _float((moved & 4503599627370495) + 4604544271217802189)  # type: ignore[call-arg]
    f = (m - 1.0) / (m + 1.0)
    u = f * f
    p = 0.16666833390625668
    p = p * u + 0.18138196339220064
    p = p * u + 0.2222284144369599
    p = p * u + 0.2857142630126691
    p = p * u + 0.3999999997734863
    p = p * u + 0.6666666666682823
    p = p * u + 1.9999999999999984
    return f * p + exponent * 0.6931471805599453


@njit(cache=True, fastmath={"contract"})
def sine_cosine(d: float) -> tuple[float, float]:
    """sin(d), cos(d) to 2e-15 for |d| up to a quarter of a revolution."""
    u = d * d
    s = -1.0149109422744767e-15
    s = s * u - 7.258951300368903e-13
    s = s * u + 1.604266076020591e-10
    s = s * u - 2.5051738874538275e-08
    s = s * u + 2.7557314421534168e-06
    s = s * u - 0.00019841269805176098
    s = s * u + 0.008333333333185951
    s = s * u - 0.16666666666663962
    s = s * u + 0.9999999999999989
    c = 3.4918782821168705e-15
    c = c * u + 4.1872188993857665e-15
    c = c * u - 1.1250825229615728e-11
    c = c * u + 2.087067306363603e-09
    c = c * u - 2.755721863271002e-07
    c = c * u + 2.4801586285759875e-05
    c = c * u - 0.0013888888882750614
    c = c * u + 0.04166666666646007
    c = c * u - 0.4999999999999678
    c = c * u + 0.9999999999999988
    return s * d, c


@njit(cache=True)
def contact_turns(p: float, depth: float, wind: float, entry: float, leave: float) -> tuple[int, int]:
    """First and one past the last whole turn by which a point of an edge in contact may stand off entry..leave."""
    low, high = (p - wind * depth, p) if wind > 0 else (p, p - wind * depth)
    return math.ceil((low - leave) / (2 * math.pi)), math.floor((high - entry) / (2 * math.pi)) + 1


@njit(cache=True)
def contact(p: float, depth: float, wind: float, entry: float, leave: float, turn: int) -> tuple[float, float, float]:
    """The piece of an edge in contact in one turn: lag of its middle, half its extent in lag, and its height.

    p : angle of the bottom of the edge   returns rad, rad, m
    """
    low, high = (p - wind * depth, p) if wind > 0 else (p, p - wind * depth)
    low = max(low, entry + 2 * math.pi * turn)
    high = min(high, leave + 2 * math.pi * turn)
    height = depth if wind == 0.0 else (high - low) / abs(wind)
    return p - (low + high) / 2, (high - low) / 2, height


@njit(cache=True)
def contact_share(h: float, fall: float, half: float, weight: float, before: float) -> tuple[float, float, float]:
    """The share of a node's stretch on which there is a chip, and its slopes in the chip and in the chip's fall.

    h : chip at the node, m, below 0 where there is none   fall : -dh/dx, m/rad   half : of the piece in contact, rad
    """
    if half <= 0.0:
        return (1.0, 0.0, 0.0) if h > 0.0 else (0.0, 0.0, 0.0)
    steep = max(abs(fall), 1e-15)
    inside = (
        before if fall > 0.0 else weight - before
    )  # from the node to the end of its stretch towards the thicker chip
    extent = 2 * half * weight
    share = h / (steep * extent) + inside / weight
    if share >= 1.0:
        return 1.0, 0.0, 0.0
    if share <= 0.0:
        return 0.0, 0.0, 0.0
    by_h = 1 / (steep * extent)
    return share, by_h, -h / fall * by_h if abs(fall) > 1e-15 else 0.0


@njit(cache=True)
def add_force(
    parameters: np.ndarray,
    angle: float,
    feed: float,
    depth: float,
    entry: float,
    leave: float,
    direction: float,
    edge: Edge,
    force: np.ndarray,
    slopes: np.ndarray,
) -> bool:
    """Writes the force on the tool at one instant and its slopes in every parameter; False where nothing is cut.

    parameters : (parameter,)   angle, entry, leave, direction : rad   feed, depth : m
    force : (axis,), N, and slopes : (axis, parameter), N per unit of each, are overwritten
    """
    force[:] = 0.0
    slopes[:, :] = 0.0
    if depth <= 0.0 or leave <= entry:
        return False
    last = parameters.size
    c0, s0 = parameters[last - 2], parameters[last - 1]
    axial = last == 8
    h0 = edge.reference
    shape_t, shape_r = parameters[1], parameters[3]
    size_t, size_r = math.exp(parameters[0]), math.exp(parameters[2])
    shape_a, size_a = 0.0, 0.0
    if axial:
        shape_a, size_a = parameters[5], math.exp(parameters[4])
    tx = ty = rx = ry = az = 0.0  # force of each direction in x, y, z
    tx_s = ty_s = rx_s = ry_s = az_s = 0.0  # its slope in its own shape
    x_c = y_c = z_c = x_s = y_s = z_s = 0.0  # slopes in c0 and s0
    teeth = edge.lag.size
    cut = False
    for tooth in range(teeth):
        p = angle + direction - edge.lag[tooth]
        first, end = contact_turns(p, depth, edge.wind, entry, leave)
        for turn in range(first, end):
            middle, half, height = contact(p, depth, edge.wind, entry, leave, turn)
            if half <= 0.0 and edge.wind != 0.0:
                continue
            sin_p, cos_p, sin_m, cos_m = math.sin(p), math.cos(p), math.sin(middle), math.cos(middle)
            for i in range(edge.node.size):
                sin_d, cos_d = sine_cosine(half * edge.node[i])
                sin_x, cos_x = sin_m * cos_d + cos_m * sin_d, cos_m * cos_d - sin_m * sin_d
                sin_phi, cos_phi = sin_p * cos_x - cos_p * sin_x, cos_p * cos_x + sin_p * sin_x
                h = feed * edge.rise[tooth, teeth - 1] * sin_phi  # the tooth's own last pass, without any offset
                fall = feed * edge.rise[tooth, teeth - 1] * cos_phi  # less dh/dx
                by_c0 = by_s0 = 0.0
                for k in range(teeth - 1):
                    with_c0 = edge.cosines[tooth, k] * cos_x - edge.sines[tooth, k] * sin_x
                    with_s0 = -(edge.sines[tooth, k] * cos_x + edge.cosines[tooth, k] * sin_x)
                    line = feed * edge.rise[tooth, k] * sin_phi + c0 * with_c0 + s0 * with_s0
                    if line < h:
                        h, by_c0, by_s0 = line, with_c0, with_s0
                        fall = feed * edge.rise[tooth, k] * cos_phi - c0 * with_s0 + s0 * with_c0
                w = height * edge.weight[i]
                if edge.linear:
                    share, by_h, by_fall = contact_share(h, fall, half, edge.weight[i], edge.before[i])
                    if share == 0.0:
                        continue
                    chip, cuts = (h, 1.0) if h > 0.0 else (0.0, 0.0)
                    wt, wr, wa = size_t * w, size_r * w, size_a * w
                    on_edge = share * h0
                    gt, gr, ga = (
                        wt * ((1 - shape_t) * chip + shape_t * on_edge),
                        wr * ((1 - shape_r) * chip + shape_r * on_edge),
                        wa * ((1 - shape_a) * chip + shape_a * on_edge),
                    )
                    gt_s, gr_s, ga_s = wt * (on_edge - chip), wr * (on_edge - chip), wa * (on_edge - chip)
                    edge_c0 = h0 * (by_h * by_c0 - by_fall * by_s0)  # d fall / dc0 = -by_s0, d fall / ds0 = by_c0
                    edge_s0 = h0 * (by_h * by_s0 + by_fall * by_c0)
                    chip_c0, chip_s0 = cuts * by_c0, cuts * by_s0
                    gt_c, gt_o = (
                        wt * ((1 - shape_t) * chip_c0 + shape_t * edge_c0),
                        wt * ((1 - shape_t) * chip_s0 + shape_t * edge_s0),
                    )
                    gr_c, gr_o = (
                        wr * ((1 - shape_r) * chip_c0 + shape_r * edge_c0),
                        wr * ((1 - shape_r) * chip_s0 + shape_r * edge_s0),
                    )
                    ga_c, ga_o = (
                        wa * ((1 - shape_a) * chip_c0 + shape_a * edge_c0),
                        wa * ((1 - shape_a) * chip_s0 + shape_a * edge_s0),
                    )
                else:
                    if h <= 0.0:
                        continue
                    h = max(h, SMALLEST_CHIP)
                    log_h = logarithm(h / h0)
                    gt_h = size_t * w * exponential(-shape_t * log_h)
                    gr_h = size_r * w * exponential(-shape_r * log_h)
                    gt, gr = gt_h * h, gr_h * h
                    gt_s, gr_s = -gt * log_h, -gr * log_h
                    gt_h, gr_h = gt_h * (1 - shape_t), gr_h * (1 - shape_r)
                    ga = ga_s = ga_h = 0.0
                    if axial:
                        ga_h = size_a * w * exponential(-shape_a * log_h)
                        ga = ga_h * h
                        ga_s = -ga * log_h
                        ga_h *= 1 - shape_a
                    gt_c, gr_c, ga_c = gt_h * by_c0, gr_h * by_c0, ga_h * by_c0
                    gt_o, gr_o, ga_o = gt_h * by_s0, gr_h * by_s0, ga_h * by_s0
                cut = True
                tx -= gt * cos_phi
                ty += gt * sin_phi
                rx -= gr * sin_phi
                ry -= gr * cos_phi
                az += ga
                tx_s -= gt_s * cos_phi
                ty_s += gt_s * sin_phi
                rx_s -= gr_s * sin_phi
                ry_s -= gr_s * cos_phi
                az_s += ga_s
                x_c -= gt_c * cos_phi + gr_c * sin_phi
                y_c += gt_c * sin_phi - gr_c * cos_phi
                z_c += ga_c
                x_s -= gt_o * cos_phi + gr_o * sin_phi
                y_s += gt_o * sin_phi - gr_o * cos_phi
                z_s += ga_o
    if not cut:
        return False
    sin_f, cos_f = math.sin(direction), math.cos(direction)
    for row in range(edge.axes.size):
        axis = edge.axes[row]
        if axis == 2:
            if axial:
                force[row] = az
                slopes[row, 4], slopes[row, 5] = az, az_s
                slopes[row, 6], slopes[row, 7] = z_c, z_s
            continue
        on_x, on_y = (cos_f, -sin_f) if axis == 0 else (sin_f, cos_f)
        slopes[row, 0], slopes[row, 1] = on_x * tx + on_y * ty, on_x * tx_s + on_y * ty_s
        slopes[row, 2], slopes[row, 3] = on_x * rx + on_y * ry, on_x * rx_s + on_y * ry_s
        slopes[row, last - 2], slopes[row, last - 1] = on_x * x_c + on_y * y_c, on_x * x_s + on_y * y_s
        force[row] = slopes[row, 0] + slopes[row, 2]
    return True


@njit(cache=True)
def force_of_samples(
    parameters: np.ndarray,
    angle: np.ndarray,
    feed: np.ndarray,
    depth: np.ndarray,
    entry: np.ndarray,
    leave: np.ndarray,
    direction: np.ndarray,
    edge: Edge,
    force: np.ndarray,
    slopes: np.ndarray,
) -> None:
    """`add_force` of every sample.   parameters : (1, parameter) for all samples, or (sample, parameter)"""
    each = parameters.shape[0] > 1
    for i in range(angle.size):
        add_force(
            parameters[i if each else 0],
            angle[i],
            feed[i],
            depth[i],
            entry[i],
            leave[i],
            direction[i],
            edge,
            force[i],
            slopes[i],
        )


@njit(cache=True)
def chips_of_samples(
    c0: float,
    s0: float,
    angle: np.ndarray,
    feed: np.ndarray,
    depth: np.ndarray,
    entry: np.ndarray,
    leave: np.ndarray,
    direction: np.ndarray,
    edge: Edge,
    mean: np.ndarray,
    chip: np.ndarray,
    width: np.ndarray,
) -> int:
    """Mean chip of every sample, and the chips at all nodes of all samples one behind the other as far as the space reaches.

    mean : (sample,), m   chip, width : (node,), m, chip thickness and length of edge (along the axis) that meets it
    returns how many of `chip` there are, whether or not they found space
    """
    teeth = edge.lag.size
    count = 0
    for i in range(angle.size):
        mean[i] = 0.0
        if depth[i] <= 0.0 or leave[i] <= entry[i]:
            continue
        for tooth in range(teeth):
            p = angle[i] + direction[i] - edge.lag[tooth]
            first, end = contact_turns(p, depth[i], edge.wind, entry[i], leave[i])
            for turn in range(first, end):
                middle, half, height = contact(p, depth[i], edge.wind, entry[i], leave[i], turn)
                if half <= 0.0 and edge.wind != 0.0:
                    continue
                for n in range(edge.node.size):
                    x = middle + half * edge.node[n]
                    sin_x, cos_x, sin_phi = math.sin(x), math.cos(x), math.sin(p - x)
                    h = feed[i] * edge.rise[tooth, teeth - 1] * sin_phi
                    for k in range(teeth - 1):
                        of_c0 = edge.cosines[tooth, k] * cos_x - edge.sines[tooth, k] * sin_x
                        of_s0 = -(edge.sines[tooth, k] * cos_x + edge.cosines[tooth, k] * sin_x)
                        h = min(h, feed[i] * edge.rise[tooth, k] * sin_phi + c0 * of_c0 + s0 * of_s0)
                    if h <= 0.0:
                        continue
                    mean[i] += h * height * edge.weight[n] / depth[i]
                    if count < chip.size:
                        chip[count], width[count] = h, height * edge.weight[n]
                    count += 1
    return count
