"""Cutting force of a helical end mill with runout: the force laws and the harmonics of the force, integrated exactly.

A tooth meets the surface left by the teeth before it. With a_k the feed since the tooth k places ahead passed and
b_k = e_j - e_{j-k} how much farther this tooth reaches out, its chip is (Montgomery & Altintas 1991; Kline & DeVor 1983)

    h(phi) = max(0, min over k = 1..N of [a_k sin(phi) + b_k])        phi in entry .. exit.

In u = sin(phi) this is the lower envelope of N rising lines: the contact begins at one u0, breaks at few u, and between
two breaks it is A sin(phi) + B. So contact loss by runout needs no grid, no slices of time and no smoothing: the force
harmonics are Gauss integrals over a few smooth pieces, and they vary smoothly with the runout, which a fit needs.
The helix is a lag: a slice at height z repeats the edge's force later by kappa(z) = z tan(helix) / R. Where the offset winds
with the helix, the pieces change along the axis, and the integral over the depth is split where they do.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions, engagement


@dataclass(frozen=True, eq=False)
class LinearEdge:
    """Linear-edge law, F_i = (K_ie + K_ic h) b for i = t, r, a  [Altintas, Manufacturing Automation, eq. 2.4]."""

    cutting: np.ndarray  # K_tc, K_rc, K_ac, (3,), N/m^2
    edge: np.ndarray  # K_te, K_re, K_ae, (3,), N/m

    def edge_force(self, chip_thickness: np.ndarray, chip_width: float) -> np.ndarray:
        """Force on one edge; none where there is no chip.   chip_thickness : (...,) m   chip_width : m   returns (..., 3) N"""
        h = np.asarray(chip_thickness)[..., np.newaxis]
        return np.where(h > 0, self.edge + self.cutting * h, 0.0) * chip_width


@dataclass(frozen=True, eq=False)
class Kienzle:
    """Kienzle law, F_i = k_i1.1 b h (h / h0)**(-m_i) for i = t, r, a."""

    specific_force: np.ndarray  # k_i1.1, (3,), N/m^2, for a chip of h = b = 1 mm
    rise: np.ndarray  # m_i, (3,)
    REFERENCE_CHIP = 1e-3  # h0, m

    def edge_force(self, chip_thickness: np.ndarray, chip_width: float) -> np.ndarray:
        """Force on one edge.   chip_thickness : (...,) m   chip_width : m   returns (..., 3) N"""
        h = np.maximum(np.asarray(chip_thickness), 0.0)[..., np.newaxis]
        with np.errstate(divide="ignore", invalid="ignore"):
            force = self.specific_force * chip_width * h ** (1 - self.rise) * self.REFERENCE_CHIP**self.rise
        return np.where(h > 0, force, 0.0)


def to_machine_axes(edge_force: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Force on the tool in machine axes from the force on one edge.

    F_x = -F_t cos - F_r sin; F_y = F_t sin - F_r cos; F_z = F_a.
    edge_force : (..., 3) N, tangential, radial, axial   angle : (...,) rad   returns (..., 3) N
    """
    t, r, a = np.moveaxis(edge_force, -1, 0)
    s, c = np.sin(angle), np.cos(angle)
    return np.stack([-t * c - r * s, t * s - r * c, a], axis=-1)


def radial_offset(cutter: Cutter, height: np.ndarray) -> np.ndarray:
    """e_j(z), how much farther than R tooth j reaches out because the cutter's axis is offset from the spindle's.

    rho cos(lambda + psi_j + kappa(z)): tooth j lags tooth 0 by psi_j, so it stands that much farther behind the offset.
    height : (slice,) m   returns (tooth, slice) m
    """
    lag = cutter.tooth_lag()[:, np.newaxis] + cutter.helix_lag(np.asarray(height))
    return cutter.runout * np.cos(cutter.runout_angle + lag)


@lru_cache(maxsize=64)
def _teeth_ahead(cutter: Cutter) -> tuple[np.ndarray, np.ndarray]:
    """For tooth j and k places: the tooth ahead, (tooth, k), and the share of a revolution since it passed, (tooth, k)."""
    n = cutter.teeth
    lag = cutter.tooth_lag()
    j, k = np.meshgrid(np.arange(n), np.arange(1, n + 1), indexing="ij")
    ahead = (j - k) % n
    return ahead, np.where(k == n, 1.0, (lag[j] - lag[ahead]) / (2 * np.pi) % 1.0)


def chip_lines(cutter: Cutter, feed_per_tooth: float, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and heights of the lines a_k sin(phi) + b_k of which the chip is the lower envelope.

    The teeth lag, so the surface under tooth j was left by tooth j - 1, and k places ahead of it by j - k; after k = N it
    meets its own last pass, with b = 0.
    offset : (tooth, ...) m   returns a (tooth, k), b (tooth, k, ...), m
    """
    ahead, turn = _teeth_ahead(cutter)
    return feed_per_tooth * cutter.teeth * turn, offset[:, np.newaxis] - offset[ahead]


def chip_thickness(cutter: Cutter, conditions: CuttingConditions, angle: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Static chip of every tooth at given spindle angles and heights, zero outside the engagement.

    angle : (angle,) rad   height : (slice,) m   returns (tooth, slice, angle) m
    """
    entry, leave = engagement(conditions, cutter.diameter)
    offsets = radial_offset(cutter, height)  # (tooth, slice)
    lag = cutter.tooth_lag()[:, np.newaxis] + cutter.helix_lag(np.asarray(height))
    phi = (angle - lag[:, :, np.newaxis]) % (2 * np.pi)
    a, b = chip_lines(cutter, conditions.feed_per_tooth, offsets)
    lines = a[:, :, np.newaxis, np.newaxis] * np.sin(phi[:, np.newaxis]) + b[..., np.newaxis]
    chip = np.maximum(lines.min(axis=1), 0.0)
    return np.where((phi >= entry) & (phi <= leave), chip, 0.0)


def contact_pieces(
    a: Sequence[float], b: Sequence[float], entry: float, leave: float
) -> list[tuple[float, float, float, float]]:
    """Intervals of phi in which one tooth cuts and h = A sin(phi) + B, in ascending order: (from, to, A, B).

    a, b : (k,) m, the lines of this tooth; few numbers, for which plain Python beats array calls
    entry, leave : rad, within 0..pi
    """
    lines = list(zip(a, b, strict=True))
    u = max(0.0, max(-height / slope for slope, height in lines))  # lowest sin(phi) at which every line is positive
    if u >= 1.0:
        return []
    envelope = []  # (u from, slope, height), walking up the concave envelope: slopes fall from piece to piece
    slope, height = min(lines, key=lambda line: (line[0] * u + line[1], line[0]))
    while True:
        envelope.append((u, slope, height))
        ahead = [((h - height) / (slope - s), s, h) for s, h in lines if s < slope - 1e-15]
        if not ahead or min(ahead)[0] >= 1.0:
            break
        crossing, slope, height = min(ahead)
        u = max(u, crossing)
    rising = [(math.asin(u), slope, height) for u, slope, height in envelope]
    ends = [lo for lo, _, _ in rising[1:]] + [math.pi / 2]
    pieces = [(lo, hi, slope, height) for (lo, slope, height), hi in zip(rising, ends, strict=True)]
    top_lo, _, slope, height = pieces.pop()
    falling = [(math.pi - hi, math.pi - lo, slope, height) for lo, hi, slope, height in reversed(pieces)]
    pieces = [*pieces, (top_lo, math.pi - top_lo, slope, height), *falling]
    inside = [(max(lo, entry), min(hi, leave), slope, height) for lo, hi, slope, height in pieces]
    return [piece for piece in inside if piece[1] - piece[0] > 1e-12]


@lru_cache(maxsize=256)
def _legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on 0..1."""
    s, w = np.polynomial.legendre.leggauss(n)
    return (s + 1) / 2, w / 2


@lru_cache(maxsize=256)
def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on 0..1 after x = s^3 (10 - 15 s + 6 s^2), which flattens a root h^(1-m) at the ends of contact."""
    s, w = _legendre(n)
    return s**3 * (10 - 15 * s + 6 * s**2), w * 30 * s**2 * (1 - s) ** 2


ChipFunctions = Callable[[np.ndarray], np.ndarray]  # chip (node,) -> (function, node)


def edge_harmonics(
    functions: ChipFunctions,
    cutter: Cutter,
    feed_per_tooth: float,
    offsets: np.ndarray,
    wind: np.ndarray,
    span: tuple[float, float],
) -> np.ndarray:
    """Fourier integrals of g(h(phi)), g sin(phi), g cos(phi) over one revolution, summed over teeth and slices.

    One-sided, so that f(theta) = Re sum_k c_k exp(j k theta). The Gauss nodes of a piece follow its length and the highest
    harmonic: about three to the shortest wave, and twenty for the chip itself.
    offsets : radial offset (tooth, slice) m   wind : exp(-j k kappa) times the width of each slice, (slice, harmonic), m
    span : entry and exit, rad   returns complex (3, function, harmonic), m
    """
    harmonics = wind.shape[1] - 1
    lag = cutter.tooth_lag()
    lo: list[float] = []
    hi: list[float] = []
    slope: list[float] = []
    height: list[float] = []
    psi: list[float] = []
    place: list[int] = []
    count: list[int] = []
    slopes, heights = chip_lines(cutter, feed_per_tooth, offsets)
    slopes, heights = slopes.tolist(), np.moveaxis(heights, 2, 0).tolist()
    for i in range(offsets.shape[1]):
        for a, b, tooth_lag in zip(slopes, heights[i], lag, strict=True):
            for piece in contact_pieces(a, b, *span):
                for column, value in zip((lo, hi, slope, height), piece, strict=True):
                    column.append(value)
                psi.append(tooth_lag)
                place.append(i)
                count.append(20 + int(1.1 * (harmonics + 1) * (piece[1] - piece[0])))
    if not lo:
        return np.zeros((3, len(functions(np.zeros(1))), harmonics + 1), complex)
    rules = [_gauss(n) for n in count]
    length = np.repeat(np.array(hi) - np.array(lo), count)
    phi = np.repeat(lo, count) + length * np.concatenate([rule[0] for rule in rules])
    weight = length * np.concatenate([rule[1] for rule in rules]) / np.pi
    chip = np.maximum(np.repeat(slope, count) * np.sin(phi) + np.repeat(height, count), 0.0)
    g = functions(chip) * weight
    turn = np.exp(-1j * (phi + np.repeat(psi, count)))
    kernel = np.empty((harmonics + 1, len(phi)), complex)
    kernel[0] = 0.5
    if harmonics:
        kernel[1] = turn
        for k in range(2, harmonics + 1):
            np.multiply(kernel[k - 1], turn, out=kernel[k])
    first = np.flatnonzero(np.diff(np.repeat(place, count), prepend=-1))
    values = np.concatenate([g, g * np.sin(phi), g * np.cos(phi)])  # (3 function, node)
    total = np.zeros((len(values), harmonics + 1), complex)
    for start, stop in zip(first, [*first[1:], len(phi)], strict=True):
        total += (values[:, start:stop] @ kernel[:, start:stop].T) * wind[np.repeat(place, count)[start]]
    return total.reshape(3, -1, harmonics + 1)


def _panels(
    cutter: Cutter,
    conditions: CuttingConditions,
    offset: Callable[[np.ndarray], np.ndarray],
    span: tuple[float, float],
    looks: int = 5,
) -> np.ndarray:
    """Heights between which every tooth keeps the same pieces of contact, so that the force per depth is smooth.

    Found by looking at `looks` heights and halving where two neighbours differ.   returns (end,) m
    """

    def pieces(height: np.ndarray) -> list[list[list[tuple[float, bool, bool]]]]:
        slopes, heights = chip_lines(cutter, conditions.feed_per_tooth, offset(height))
        rising = slopes.tolist()
        found = []
        for level in np.moveaxis(heights, 2, 0).tolist():
            teeth = [contact_pieces(a, b, *span) for a, b in zip(rising, level, strict=True)]
            found.append([[(slope, lo <= span[0], hi >= span[1]) for lo, hi, slope, _ in tooth] for tooth in teeth])
        return found

    grid = np.linspace(0.0, conditions.axial_depth, looks)
    at = pieces(grid)
    ends = [0.0]
    for i in range(looks - 1):
        low, high, below = grid[i], grid[i + 1], at[i]
        if below == at[i + 1]:
            continue
        for _ in range(10):  # what is missed by a thousandth is smaller by its square
            middle = (low + high) / 2
            low, high = (middle, high) if pieces(np.array([middle]))[0] == below else (low, middle)
        ends.append(float(high))
    return np.array([*ends, conditions.axial_depth])


def force_basis(
    functions: ChipFunctions,
    cutter: Cutter,
    conditions: CuttingConditions,
    harmonics: int,
    *,
    offset: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Harmonics of the force on the tool per unit of each coefficient, at spindle angle theta = 0 for tooth 0 at the bottom.

    The axes couple as in `to_machine_axes`: entry [axis, direction, function, k] is the harmonic k of F_axis when direction
    t, r or a has the edge force g_function(h) per unit of width. Slices are Gauss nodes along the axis, on panels that end
    where a tooth's pieces of contact change; where all slices are alike, one stands for all, times the exact helix factor.
    functions : chip (node,) m -> (function, node), e.g. 1 and h for the linear-edge law
    offset : height (slice,) m -> radial offset (tooth, slice) m; None: the cutter's own runout
    returns complex (3, 3, function, harmonics + 1), SI
    """
    span = engagement(conditions, cutter.diameter)
    offset = partial(radial_offset, cutter) if offset is None else offset
    ends = np.array([0.0, conditions.axial_depth])
    alike = float(np.ptp(offset(np.linspace(0.0, conditions.axial_depth, 5)), axis=1).max()) <= 1e-15
    if not alike:
        ends = _panels(cutter, conditions, offset, span)
    rules = [
        _legendre(5 + math.ceil(abs(float(cutter.helix_lag(high - low))) * (harmonics + 1) / 2))
        for low, high in itertools.pairwise(ends)
    ]
    panels = list(zip(itertools.pairwise(ends), rules, strict=True))
    height = np.concatenate([low + (high - low) * s for (low, high), (s, _) in panels])
    width = np.concatenate([(high - low) * w for (low, high), (_, w) in panels])
    wind = np.exp(-1j * np.outer(cutter.helix_lag(height), np.arange(harmonics + 1))) * width[:, np.newaxis]
    offsets = offset(height)
    if alike:
        offsets, wind = offsets[:, :1], wind.sum(axis=0, keepdims=True)
    plain, with_sin, with_cos = edge_harmonics(functions, cutter, conditions.feed_per_tooth, offsets, wind, span)
    basis = np.zeros((3, 3, *plain.shape), complex)
    basis[0, 0], basis[0, 1] = -with_cos, -with_sin
    basis[1, 0], basis[1, 1] = with_sin, -with_cos
    basis[2, 2] = plain
    return basis


def linear_edge_functions(chip: np.ndarray) -> np.ndarray:
    """1 and h, the factors of K_e and K_c.   chip : (node,) m   returns (2, node)"""
    return np.stack([np.ones_like(chip), chip])


def kienzle_functions(rise: np.ndarray) -> ChipFunctions:
    """h (h/h0)^(-m), one for each exponent.   rise : (function,)   returns the function chip (node,) -> (function, node)"""

    def functions(chip: np.ndarray) -> np.ndarray:
        h = np.maximum(chip, 1e-12)  # 1e-6 um: keeps h^(1-m) finite at the ends of contact, where its weight is nil
        return h ** (1 - np.asarray(rise)[:, np.newaxis]) * Kienzle.REFERENCE_CHIP ** np.asarray(rise)[:, np.newaxis]

    return functions


def force_harmonics(
    law: LinearEdge | Kienzle, cutter: Cutter, conditions: CuttingConditions, harmonics: int
) -> np.ndarray:
    """Harmonics of the spindle in the force on the tool: F(theta) = Re sum_k c_k exp(j k theta).

    returns complex (3, harmonics + 1) N
    """
    if isinstance(law, LinearEdge):
        basis = force_basis(linear_edge_functions, cutter, conditions, harmonics)
        return np.einsum("adfk,fd->ak", basis, np.stack([law.edge, law.cutting]))
    basis = force_basis(kienzle_functions(law.rise), cutter, conditions, harmonics)
    return np.einsum("addk,d->ak", basis, law.specific_force)


def force_at(harmonics: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """The force at spindle angles from its harmonics.   harmonics : (..., k) N   angle : (angle,) rad   returns (..., angle) N"""
    order = np.arange(harmonics.shape[-1])
    return np.real(harmonics @ np.exp(1j * np.outer(order, angle)))
