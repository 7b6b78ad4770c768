"""Intervals of modes against the truth over many seeds. Fewer seeds, and so wider tolerances, in the quick form."""

import numpy as np
import pytest
from impact_cases import make_case

from millcal.stages.frf import estimate_frf
from millcal.stages.modes import fit_modes

FIRST = 100  # seed, of a series of its own


def held(case, modes):
    """Whether the 95 % intervals of f_n, zeta and k at the softest driving point hold the truth.   returns bool (3, mode)"""
    structure, fit = case.structure, modes.fit
    fn, zeta = structure.natural_frequency, structure.damping_ratio
    alpha = structure.modal_constants(fit.outputs, fit.inputs)
    rows = [modes.interval(modes.frequency_estimate), modes.interval(modes.damping_estimate)]
    points = list(fit.driving_points.values())
    stiffness = []
    for mode in range(len(fn)):
        o, i = max(points, key=lambda pair: alpha[(mode, *pair)])
        low, high = modes.interval_of_constant(modes.driving_constants(o, i).stiffness)[mode]
        stiffness.append(low <= (2 * np.pi * fn[mode]) ** 2 / alpha[mode, o, i] <= high)
    inside = [(row[:, 0] <= truth) & (truth <= row[:, 1]) for row, truth in zip(rows, (fn, zeta), strict=True)]
    return np.array([*inside, stiffness])


@pytest.mark.parametrize("kind", ["04_B_med", "06_A_med", "12_B_badhits", "14_A_continuous"])
@pytest.mark.parametrize("seeds", [6, pytest.param(40, marks=pytest.mark.long)])
def test_95_percent_intervals_hold_the_truth(kind, seeds):
    found = []
    for seed in range(FIRST, FIRST + seeds):
        case = make_case(kind, seed)
        modes = fit_modes(estimate_frf(case.recordings))
        assert len(modes.natural_frequency) == 3
        found.append(held(case, modes))
    shares = np.mean(found, axis=(0, 2))  # of fn, zeta, k
    print(f"\n{kind}, {seeds} seeds: fn {shares[0]:.3f}, zeta {shares[1]:.3f}, k {shares[2]:.3f}")
    slack = 3.0 * np.sqrt(0.9 * 0.1 / (3 * seeds)) if seeds < 40 else 0.02
    assert (shares >= 0.90 - slack).all()
    assert shares.mean() >= 0.92 - slack
