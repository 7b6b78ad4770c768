"""Simulated cuts whose coefficients change: the three cases of Schwenzer et al. (2020), and four that they did not try.

Ten revolutions of a two-fluted end mill of 23 discs, force in the axes of the edge, white noise of 15 dB. What the paper
leaves open is settled as its Table 3 asks: the signal-to-noise ratio is one of power over all samples, those in the air too;
"ascending" is +20 % of k and m over the record; "alternating" is +-20 %, one period that starts at the top. The last
was found by its fit to the table, not read from the paper.

    cut = simulate_case("ascending", seed=3)
    cut.force (sample, 2) t, r in N      cut.truth (sample, 4) k_t, m_t, k_r, m_r with k in N/mm^2 at a chip of 1 mm
    cut.active (sample,) where the law holds and filters work       cut.air (sample,) where nothing cuts
    cut.tables: S(m) of the active samples for a chip of 1 mm; `physics.disc_force.force_and_slopes` makes forces of them

Time runs from 0 to 1 over the record (`cut.time`). A specific force of the paper in N/mm^2 is 1e6 times one in SI.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.disc_force import ShapeTables, disc_chips, is_cutting, shape, shape_tables

CUTTER = Cutter(diameter=10e-3, teeth=2, helix=np.pi / 4)
DISCS = 23
REVOLUTIONS, SAMPLES_PER_REVOLUTION = 10, 234
SAMPLES = REVOLUTIONS * SAMPLES_PER_REVOLUTION
SAMPLE_RATE = 10e3  # Hz
CONDITIONS = CuttingConditions(
    spindle_speed=2 * np.pi * SAMPLE_RATE / SAMPLES_PER_REVOLUTION,
    feed_per_tooth=0.1e-3,
    axial_depth=2e-3,
    radial_depth=3e-3,
    direction="down",
)
THRESHOLD = 0.01e-3  # h_TH, m, of the sum of all chips
REFERENCE_CHIP = 1e-3  # m: k of the paper is that of a chip of 1 mm
NOISE_DB = 15.0

NAMES = ("k_t", "m_t", "k_r", "m_r")
TRUE = np.array([1700.0, 0.18, 350.0, 0.55])  # Table 2, X5CrNi18-10 [Koenig et al. 1982, p. 95]; k in N/mm^2
BOX = np.array([[500.0, 2500.0], [0.1, 0.7], [200.0, 1600.0], [0.2, 0.8]])  # Table 2, which is also eq. 7

_ALL, _K_ONLY = np.ones(4), np.array([1.0, 0.0, 1.0, 0.0])
_K_T, _K_R = np.array([1.0, 0, 0, 0]), np.array([0, 0, 1.0, 0])


def _wear_and_chip(t: np.ndarray) -> np.ndarray:
    return 0.15 * (1 - np.exp(-t / 0.3)) + 0.12 * (t >= 0.614)


def _change(drift: np.ndarray, of: np.ndarray) -> np.ndarray:
    """A relative change of some of the coefficients.   drift : (sample,)   of : (4,)   returns (sample, 4)"""
    return np.outer(drift, of)


CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # time 0..1 -> relative change of the four
    "static": lambda t: _change(0 * t, _ALL),
    "ascending": lambda t: _change(0.2 * t, _ALL),
    "alternating": lambda t: _change(0.2 * np.cos(2 * np.pi * t), _ALL),
    "sine2": lambda t: _change(0.2 * np.sin(4 * np.pi * t), _ALL),
    "square2": lambda t: _change(np.where(t % 0.5 < 0.25, 0.2, -0.2), _ALL),
    "wear+chip": lambda t: _change(_wear_and_chip(t), _K_ONLY),
    "split": lambda t: _change(0.2 * t, _K_T) + _change(0.2 * np.cos(2 * np.pi * t), _K_R),
}
PAPER_CASES = ("static", "ascending", "alternating")
CASES = tuple(CHANGES)


class SimulatedCut(NamedTuple):
    """A cut whose coefficients are known at every sample."""

    case: str
    time: np.ndarray  # (sample,) 0..1
    angle: np.ndarray  # (sample,) rad, of the spindle
    active: np.ndarray  # (sample,) bool: the chips add up to the threshold
    air: np.ndarray  # (sample,) bool: no chip at all
    chips: np.ndarray  # (tooth, disc, sample) m
    tables: ShapeTables  # of the active samples
    truth: np.ndarray  # (sample, 4) k_t, m_t, k_r, m_r
    clean: np.ndarray  # (sample, 2) N, tangential and radial
    force: np.ndarray  # (sample, 2) N, with noise
    sigma: np.ndarray  # (2,) N, of the noise

    @property
    def active_time(self) -> np.ndarray:
        """(active,) 0..1"""
        return self.time[self.active]

    @property
    def active_truth(self) -> np.ndarray:
        """(active, 4)"""
        return self.truth[self.active]

    @property
    def active_force(self) -> np.ndarray:
        """(active, 2) N"""
        return np.ascontiguousarray(self.force[self.active])


class Geometry(NamedTuple):
    """What all cases share."""

    angle: np.ndarray  # (sample,) rad
    chips: np.ndarray  # (tooth, disc, sample) m
    active: np.ndarray  # (sample,) bool
    air: np.ndarray  # (sample,) bool
    tables: ShapeTables  # of the active samples


@lru_cache(maxsize=1)
def geometry() -> Geometry:
    """Where the ten revolutions meet the work."""
    angle = 2 * np.pi * (np.arange(SAMPLES) / SAMPLES_PER_REVOLUTION)
    chips = disc_chips(CUTTER, CONDITIONS, angle, DISCS)
    active = is_cutting(chips, THRESHOLD)
    tables = shape_tables(chips[:, :, active], CONDITIONS.axial_depth / DISCS, REFERENCE_CHIP)
    return Geometry(angle, chips, active, ~np.any(chips > 0, axis=(0, 1)), tables)


def coefficients_over_time(case: str) -> np.ndarray:
    """The true k_t, m_t, k_r, m_r.   case : one of CASES   returns (sample, 4)"""
    return TRUE * (1 + CHANGES[case](np.arange(SAMPLES) / SAMPLES))


def simulate_case(case: str, seed: int, *, decibel: float = NOISE_DB) -> SimulatedCut:
    """The force of a case with noise; one seed draws the same noise, to its scale, in all cases.

    case : one of CASES   decibel : mean power of the force over that of the noise, over all samples
    """
    angle, chips, active, air, tables = geometry()
    truth = coefficients_over_time(case)
    disc_height = CONDITIONS.axial_depth / DISCS
    clean = np.stack(
        [1e6 * truth[:, i] * shape(chips, truth[:, i + 1], disc_height, REFERENCE_CHIP) for i in (0, 2)], axis=1
    )
    sigma = np.sqrt(np.mean(clean**2, axis=0) / 10 ** (decibel / 10))
    noise = np.random.default_rng([seed, 0]).standard_normal((SAMPLES, 2))
    time = np.arange(SAMPLES) / SAMPLES
    return SimulatedCut(case, time, angle, active, air, chips, tables, truth, clean, clean + sigma * noise, sigma)
