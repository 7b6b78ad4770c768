"""Stability of a cut from coefficients and the dynamics of the tip: limits, lobes, probabilities, best speeds."""

from millcal.stages.stability.dynamics import advise
from millcal.stages.stability.map import METHODS, map_stability

__all__ = ["METHODS", "advise", "map_stability"]
