"""What every stability method is asked: how the tip answers a force, and how the cut answers the waves between teeth.

The tip. Each mode is a pole s with an output shape c and an input shape b in the plane of x and y,

    r(t) = sum over modes of 2 Re c z,     z' = s z + b . F,     G(s) = sum c b^T / (s - pole) + conjugate + flexibility,

which holds for real and complex modes of any direction alike. A real mode of mass-normalised shape p (kg^-1/2) has c = p and
b = p / (2 j w_d). The flexibility stands for the modes above those that are named and answers at once.

The cut. F(t) = - sum over teeth of  H_j(t) [r(t) - r(t - tau_j)],  H_j the integral over the engaged height of

    H0(phi) = [[s (K_tc c + K_rc s),  c (K_tc c + K_rc s)],  [s (K_rc c - K_tc s),  c (K_rc c - K_tc s)]],   s, c = sin, cos phi,

with phi clockwise from +y, tooth j lagging as in `cutter`. H0 = B C^T has rank one: C = (s, c) takes the chip from the
motion, B = (K_tc c + K_rc s, K_rc c - K_tc s) makes the force. Edge forces do not depend on the motion and take no part.

Process damping, the flank rubbing on the wave it has just cut: F = - b / (R Omega) sum_j H0(phi_j; mu C, C) r', with the
indentation constant C (N/m) as radial and mu C as tangential coefficient.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from millcal.physics.structure import Mode

FLIP, HOPF, FOLD = 1, 0, 2  # how a cut loses stability: multiplier -1, a complex pair, +1
KINDS = ("hopf", "flip", "fold")  # by these numbers


@dataclass(frozen=True, eq=False)
class TipModes:
    """The dynamics of the tip in x and y as poles with shapes, and the flexibility of what lies above them."""

    pole: np.ndarray  # s, complex (mode,), 1/s, imaginary part > 0
    output: np.ndarray  # c, complex (mode, 2)
    given: np.ndarray  # b, complex (mode, 2): the units of c b^T are s/kg
    flexibility: np.ndarray  # (2, 2), m/N

    def receptance(self, frequency: np.ndarray) -> np.ndarray:
        """G, complex (frequency, 2, 2) m/N.   frequency : (frequency,) Hz"""
        s = 2j * np.pi * np.asarray(frequency, float)[:, np.newaxis]
        residue = self.output[:, :, np.newaxis] * self.given[:, np.newaxis, :]
        matrix = np.einsum("fm,mij->fij", 1 / (s - self.pole), residue)
        matrix += np.einsum("fm,mij->fij", 1 / (s - self.pole.conj()), residue.conj())
        return matrix + self.flexibility


def tip_of_shapes(natural_frequency: np.ndarray, damping_ratio: np.ndarray, shape: np.ndarray) -> TipModes:
    """Real modes of any direction.   natural_frequency : (mode,) Hz   shape : p, mass-normalised, (mode, 2) kg^-1/2"""
    w = 2 * np.pi * np.asarray(natural_frequency, float)
    zeta, shape = np.asarray(damping_ratio, float), np.asarray(shape, float).reshape(-1, 2)
    damped = w * np.sqrt(1 - zeta**2)
    pole = -zeta * w + 1j * damped
    return TipModes(pole, shape.astype(complex), shape / (2j * damped[:, np.newaxis]), np.zeros((2, 2)))


def tip_of_modes(modes: Iterable[Mode]) -> TipModes:
    """Modes along machine axes, of stiffness k at the tip: p = w / sqrt(k) along x or y; those along z take no part."""
    modes = [mode for mode in modes if mode.axis in ("x", "y")]
    natural = np.array([mode.natural_frequency for mode in modes])
    shape = np.zeros((len(modes), 2))
    for i, mode in enumerate(modes):
        shape[i, "xy".index(mode.axis)] = 2 * np.pi * mode.natural_frequency / np.sqrt(mode.stiffness)
    return tip_of_shapes(natural, np.array([mode.damping_ratio for mode in modes]), shape)


def tip_of_residues(
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    residue: np.ndarray,
    flexibility: np.ndarray | None = None,
    *,
    negligible: float = 1e-9,
) -> TipModes:
    """Modes by their residues, as `structure.modal_receptance` has them; a residue of rank two counts as two modes.

    natural_frequency : (mode,) Hz   residue : complex (mode, 2, 2) s/kg   flexibility : (2, 2) m/N
    negligible : singular values below this share of a residue's largest are left out
    """
    w, zeta = 2 * np.pi * np.asarray(natural_frequency, float), np.asarray(damping_ratio, float)
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    left, size, right = np.linalg.svd(np.asarray(residue, complex))
    mode, rank = np.nonzero(size > negligible * np.maximum(size[:, :1], 1e-300))
    output = left[mode, :, rank] * np.sqrt(size[mode, rank])[:, np.newaxis]
    given = right[mode, rank, :] * np.sqrt(size[mode, rank])[:, np.newaxis]
    return TipModes(poles[mode], output, given, np.zeros((2, 2)) if flexibility is None else np.asarray(flexibility))


@dataclass(frozen=True)
class Regeneration:
    """How the cut answers the waves that one tooth leaves for the next."""

    teeth: int
    entry: float  # rad
    leave: float  # rad
    ktc: float  # N/m^2
    krc: float  # N/m^2
    pitch: tuple[float, ...] | None = None  # rad, from tooth k to tooth k + 1 (`Cutter.pitch`); None: equal
    wind: float = 0.0  # tan(helix) / R, rad/m: the lag of the edge per height
    indentation: float = 0.0  # C of process damping, N/m; 0: none
    indentation_friction: float = 0.3  # mu
    radius: float = np.nan  # R, m, needed with process damping alone

    def __post_init__(self) -> None:
        if not 0 <= self.entry < self.leave <= np.pi + 1e-9:
            raise ValueError(f"{self.entry=} to {self.leave=} is no engagement")
        if self.pitch is not None and (len(self.pitch) != self.teeth or abs(sum(self.pitch) - 2 * np.pi) > 1e-6):
            raise ValueError(f"{self.pitch=} rad are not {self.teeth} pitches of one revolution")
        if self.indentation and not self.radius > 0:
            raise ValueError("process damping needs the radius of the cutter")

    @property
    def equal_pitch(self) -> bool:
        return self.pitch is None or float(np.ptp(self.pitch)) < 1e-9

    @property
    def in_cut(self) -> float:
        """Teeth in cut on average, of a straight cutter."""
        return self.teeth * (self.leave - self.entry) / (2 * np.pi)

    def with_force(self, ktc: float, krc: float) -> "Regeneration":
        return replace(self, ktc=ktc, krc=krc)


class Crossings(NamedTuple):
    """Depths at which a multiplier crosses the unit circle, of many speeds one behind the other, lowest first at each."""

    speed: np.ndarray  # integer (crossing,): which of the speeds asked
    depth: np.ndarray  # (crossing,) m
    kind: np.ndarray  # integer (crossing,): HOPF, FLIP, FOLD
    frequency: np.ndarray  # chatter frequency, (crossing,) Hz
    loses: np.ndarray  # bool (crossing,): stability is lost with growing depth, else a multiplier comes back

    def first(self, speeds: int) -> "Crossings":
        """The first loss of stability of each speed; inf, -1 and nan where there is none.   returns arrays (speeds,)"""
        depth, kind = np.full(speeds, np.inf), np.full(speeds, -1)
        frequency, loses = np.full(speeds, np.nan), np.zeros(speeds, bool)
        for i in np.flatnonzero(self.loses)[::-1]:
            if self.depth[i] <= depth[self.speed[i]]:
                at = self.speed[i]
                depth[at], kind[at], frequency[at], loses[at] = self.depth[i], self.kind[i], self.frequency[i], True
        return Crossings(np.arange(speeds), depth, kind, frequency, loses)


def h0(angle: np.ndarray, ktc: float, krc: float) -> np.ndarray:
    """H0, force per depth against the motion, of a tooth at an angle.   angle : (...,) rad   returns (..., 2, 2) N/m^2"""
    s, c = np.sin(angle), np.cos(angle)
    force = np.stack([ktc * c + krc * s, krc * c - ktc * s], axis=-1)
    return force[..., :, np.newaxis] * np.stack([s, c], axis=-1)[..., np.newaxis, :]
