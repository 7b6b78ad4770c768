"""The force on the tool sample by sample, for coefficients that change while cutting, with its slopes in every parameter.

Each direction d = t, r(, a) has two parameters: kappa_d, the logarithm of its specific force (N/m^2) at a reference chip h0,
and a shape s_d. Near h0 the force hardly depends on the shape, so what is known well and what is known poorly are apart.

    kienzle:      F_d = exp(kappa_d) integral of h (h/h0)^(-s_d) dz             s = m, the rise
    linear-edge:  F_d = exp(kappa_d) integral of [(1 - s_d) h + s_d h0] dz      s = the edge's share of the force at h0

The last two parameters are the runout, c0 = rho cos(lambda) and s0 = rho sin(lambda), m. A parameter vector is
[kappa_t, s_t, kappa_r, s_r, (kappa_a, s_a,) c0, s0]. What is compiled lives in `edge_kernel`, imported at the first call.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from millcal.physics.cutter import Cutter
from millcal.physics.cutting_force import Kienzle

if TYPE_CHECKING:
    from millcal.physics.edge_kernel import Edge

SPREAD = 50_000  # samples that quantiles of chips are taken from, of more
GOLDEN = (5**0.5 - 1) / 2


class Passage(NamedTuple):
    """How the tool meets the work at each sample; a number stands for all of them.

    `angle` is the spindle's against the machine, as an encoder or a pulse tells it: clockwise from +y. Entry and exit are
    counted from the normal of the feed, as everywhere. So the angle of tooth 0 in its engagement is `angle + feed_direction`,
    and a path that turns a corner needs no other angle. The force is in machine axes.
    """

    angle: np.ndarray  # (sample,), rad, of tooth 0 at the bottom of the helix
    feed_per_tooth: np.ndarray  # (sample,), m
    axial_depth: np.ndarray  # (sample,), m; 0 where nothing is cut
    entry: np.ndarray  # (sample,), rad
    leave: np.ndarray  # (sample,), rad; not above entry where nothing is cut, and at most half a revolution above it
    feed_direction: np.ndarray  # (sample,), rad, from +x towards +y


def fixed(values: np.ndarray, kind: type = float) -> np.ndarray:
    """A contiguous read-only view: numba compiles once more for arrays that it may write to, so all are given alike."""
    view: np.ndarray = np.ascontiguousarray(values, kind).view()
    view.flags.writeable = False
    return view


def columns(passage: Passage) -> Passage:
    """The fields as arrays of one length, ready for a kernel."""
    length = np.size(passage.angle)
    return Passage(*(fixed(np.broadcast_to(np.asarray(field, float), (length,))) for field in passage))


def directions_of(parameters: int, axes: tuple[str, ...]) -> int:
    """Number of directions in a parameter vector, 2 or 3.   raises ValueError where it fits neither, or z lacks its own"""
    if parameters not in (6, 8):
        raise ValueError(f"{parameters=} is neither 6 (t, r, runout) nor 8 (t, r, a, runout)")
    if parameters == 6 and "z" in axes:
        raise ValueError("a force along z needs kappa_a and s_a; leave z out of the axes")
    return (parameters - 2) // 2


@lru_cache(maxsize=32)
def _edge(cutter: Cutter, law: str, reference_chip: float, axes: tuple[str, ...], nodes: int) -> "Edge":
    """The constants of the kernel, made once: a search asks for the same thousands of times, and Gauss nodes take their time."""
    from millcal.physics.edge_kernel import edge_of

    return edge_of(cutter, law, reference_chip, axes, nodes)


def sampled_force(
    parameters: np.ndarray,
    passage: Passage,
    cutter: Cutter,
    *,
    law: str,
    reference_chip: float,
    axes: tuple[str, ...] = ("x", "y", "z"),
    nodes: int = 8,
) -> tuple[np.ndarray, np.ndarray]:
    """Force on the tool at every sample and its slope in every parameter. The runout of `cutter` itself is not used.

    Heights of entry and exit are exact; where runout ends the contact between them, the nodes nearest to that place count in
    part, and the error falls with their number: with 12 some thousandths of the force, where there is runout, else less.
    parameters : (parameter,) for all samples, or (sample, parameter)   law : kienzle, linear-edge   reference_chip : h0, m
    nodes : Gauss nodes on each piece of an edge in contact
    returns force (sample, axis) N, slopes (sample, axis, parameter) N per unit of each
    """
    from millcal.physics.edge_kernel import force_of_samples

    values = fixed(np.atleast_2d(np.asarray(parameters, float)))
    directions_of(values.shape[1], axes)
    met = columns(passage)
    if np.ndim(parameters) == 2 and len(values) != len(met.angle):
        raise ValueError(f"{len(values)} rows of parameters for {len(met.angle)} samples")
    force = np.empty((len(met.angle), len(axes)))
    slopes = np.empty((*force.shape, values.shape[1]))
    force_of_samples(values, *met, _edge(cutter, law, reference_chip, tuple(axes), nodes), force, slopes)
    return force, slopes


def _chips(
    passage: Passage, cutter: Cutter, runout: tuple[float, float], nodes: int, space: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean chip (sample,) m, and chips (node,) m with the length of edge that meets each (node,) m, for `space` nodes."""
    from millcal.physics.edge_kernel import chips_of_samples

    met = columns(passage)
    mean, chip, width = np.empty(len(met.angle)), np.empty(space), np.empty(space)
    edge = _edge(cutter, "kienzle", Kienzle.REFERENCE_CHIP, ("x", "y"), nodes)
    count = chips_of_samples(float(runout[0]), float(runout[1]), *met, edge, mean, chip, width)
    if space and count > space:
        return _chips(passage, cutter, runout, nodes, count)
    return mean, chip[:count], width[:count]


def mean_chip(
    passage: Passage, cutter: Cutter, runout: tuple[float, float] = (0.0, 0.0), *, nodes: int = 8
) -> np.ndarray:
    """Integral of the chip over depth and teeth, over the axial depth, at each sample: 0 in air.

    runout : c0, s0, m   returns (sample,) m
    """
    return _chips(passage, cutter, runout, nodes, 0)[0]


class ChipRange(NamedTuple):
    """Chips that the edges have met over some samples, by length of edge."""

    low: float  # m, 5 % are thinner
    high: float  # m, 5 % are thicker
    reference: float  # m, exp of the mean of ln h weighted by h^0.75: about where the force is known best


def chip_quantiles(
    passage: Passage, cutter: Cutter, runout: tuple[float, float] = (0.0, 0.0), *, nodes: int = 8
) -> ChipRange:
    """Chips met over the samples; of many, over some spread so that no revolution of the tool repeats in them.

    runout : c0, s0, m   raises ValueError where nothing is cut
    """
    met = columns(passage)
    if len(met.angle) > SPREAD:
        some = np.sort((np.arange(SPREAD) * GOLDEN % 1.0 * len(met.angle)).astype(int))
        met = Passage(*(field[some] for field in met))
    _, chip, width = _chips(met, cutter, runout, nodes, 16 * len(met.angle))
    if not len(chip):
        raise ValueError("no tooth cuts at any of these samples")
    order = np.argsort(chip)
    share = np.cumsum(width[order])
    low, high = chip[order[np.searchsorted(share, [0.05 * share[-1], 0.95 * share[-1]])]]
    heavy = width * chip**0.75
    return ChipRange(float(low), float(high), float(np.exp(np.sum(heavy * np.log(chip)) / np.sum(heavy))))


def coefficients_of(parameters: np.ndarray, law: str, reference_chip: float) -> tuple[np.ndarray, np.ndarray]:
    """The law's own coefficients from the parameters, and their slopes in them.

    parameters : (..., parameter), runout last
    returns kt kr (ka) mt mr (ma), or Ktc Krc (Kac) Kte Kre (Kae), SI, (..., 2 direction), and slopes (..., 2 direction, parameter)
    """
    theta = np.asarray(parameters, float)
    count = (theta.shape[-1] - 2) // 2
    size, shape = np.exp(theta[..., 0 : 2 * count : 2]), theta[..., 1 : 2 * count : 2]
    values = np.empty((*theta.shape[:-1], 2 * count))
    slopes = np.zeros((*values.shape, theta.shape[-1]))
    for d in range(count):
        at_h0, s = size[..., d], shape[..., d]
        if law == "kienzle":
            log_ratio = np.log(reference_chip / Kienzle.REFERENCE_CHIP)
            values[..., d], values[..., count + d] = at_h0 * np.exp(s * log_ratio), s
            slopes[..., d, 2 * d], slopes[..., d, 2 * d + 1] = values[..., d], values[..., d] * log_ratio
            slopes[..., count + d, 2 * d + 1] = 1.0
        else:
            values[..., d], values[..., count + d] = (1 - s) * at_h0, s * reference_chip * at_h0
            slopes[..., d, 2 * d], slopes[..., d, 2 * d + 1] = values[..., d], -at_h0
            slopes[..., count + d, 2 * d] = values[..., count + d]
            slopes[..., count + d, 2 * d + 1] = reference_chip * at_h0
    return values, slopes


def parameters_of(values: np.ndarray, law: str, reference_chip: float) -> np.ndarray:
    """The inverse of `coefficients_of`, without runout.

    values : (..., 2 direction), SI   returns (..., 2 direction): kappa_t, s_t, kappa_r, ...
    raises ValueError where the force at h0 is not above 0, of which there is no logarithm
    """
    given = np.asarray(values, float)
    count = given.shape[-1] // 2
    first, second = given[..., :count], given[..., count:]
    if law == "kienzle":
        at_h0, shape = first * (reference_chip / Kienzle.REFERENCE_CHIP) ** -second, second
    else:
        at_h0 = first + second / reference_chip
        shape = second / (reference_chip * at_h0)
    if not np.all(at_h0 > 0):
        raise ValueError(f"specific force {at_h0} at the reference chip is not above 0")
    theta = np.empty(given.shape)
    theta[..., ::2], theta[..., 1::2] = np.log(at_h0), shape
    return theta
