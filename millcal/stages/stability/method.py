"""What a stability map asks, and what a method that answers it looks like.

A method is put on a structure once and then asked for speeds and cuts: all else, from best speeds to probabilities, is made
of its crossings and knows nothing of how they were found.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from millcal.data import Notice, SimulatedCuts
from millcal.physics.stability.regeneration import Crossings, Regeneration
from millcal.physics.stability.stable_depths import edge_table

Progress = Callable[[float], None]  # share done


@dataclass(frozen=True)
class Asked:
    """The cut that a map is for, and where it looks."""

    cut: Regeneration  # with the mean of the coefficients
    speeds: tuple[float, float]  # lowest and highest, rad/s: of the map, the operating point and the tests
    least_depth: float = 0.0  # m, of the operating point and the tests: that deep at least
    deepest: float | None = None  # m; None: the method's choice
    rigid: str = ""  # axes that may be missing from the dynamics
    feed_per_tooth: float | None = None  # m
    edge: tuple[float, float] | None = None  # K_te, K_re, N/m
    runout: tuple[float, float] = (0.0, 0.0)  # c0, s0, m


class Solution(NamedTuple):
    """Where stability is lost and comes back at each speed, and what the method says of it."""

    crossings: Crossings
    edges: Crossings  # of the stable set, among them (`stable_depths.edges_of`)
    inverse_sd: np.ndarray | None = None  # of 1/b of the first limit, from noise of the dynamics, (speed,) 1/m
    simulated: SimulatedCuts | None = None
    notices: tuple[Notice, ...] = ()


class Sampling(NamedTuple):
    """How a band is to be drawn."""

    speeds: np.ndarray  # (speed,) rad/s
    members: int
    draws: np.ndarray | None  # K_tc, K_rc, (member, 2) N/m^2; None: they are exact
    rng: np.random.Generator
    progress: Progress


Solve = Callable[[np.ndarray, Regeneration, Progress], Solution]  # spindle speed (speed,) rad/s


@dataclass(frozen=True, eq=False)
class Method:
    """A method on a structure."""

    name: str
    solve: Solve
    deepest: float  # m: how deep it looks
    minimum: Callable[[Regeneration], tuple[float, float]] | None = None  # over every speed: depth m, frequency Hz
    outline: Solve | None = None  # `solve` without the chatter frequencies, where these cost time
    with_noise: Solve | None = None  # `solve`, and the noise of the lines
    refine: tuple[int, int] = (3, 21)  # rounds, and speeds in each, with which a pocket is looked at again
    ratios: int = 2  # K_rc / K_tc at which draws of coefficients are solved,
    strengths: int = 1  # and K_tc; 1: depths go with 1 / K
    draw: Callable[[Sampling], np.ndarray] | None = None  # structures as they may be: edges (member, speed, edge) m
    banded: bool = True  # whether what is uncertain is followed at all
    band_speeds: int | None = None  # speeds of the band; None: all
    check: Callable[[np.ndarray, Regeneration], Crossings] | None = None  # edges at a few speeds, found another way
    further: Callable[[float], "Method"] | None = None  # the same, to look down to another depth, m
    told: Callable[[np.ndarray, Solution, np.random.Generator | None], list[Notice]] | None = None  # of the whole map
    notices: tuple[Notice, ...] = ()

    def table(self, speeds: np.ndarray, cut: Regeneration, progress: Progress = lambda share: None) -> np.ndarray:
        """Edges of the stable set.   speeds : (speed,) rad/s   returns (speed, edge) m"""
        return edge_table((self.outline or self.solve)(speeds, cut, progress).edges, len(speeds))
