"""Synthetic recordings with known truth: cuts and impact tests as a measuring chain would have stored them.

A layer beside the stages: it predicts with `physics` and adds what is random by a generator handed in, so the same seed
gives the same samples. Signals are built from spectra that end below half the sample rate, so no sample is aliased and the
truth is exact where a sampled time simulation would be approximate.
"""

from millcal.simulation.cuts import Line, Timeline, as_dynamometer_channels, simulate_cut
from millcal.simulation.impacts import simulate_impact

__all__ = ["Line", "Timeline", "as_dynamometer_channels", "simulate_cut", "simulate_impact"]
