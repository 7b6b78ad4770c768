"""Fitted modes in the place of the FRF: better where they are all there is, and told where they are not."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from accelerometer_cuts import LAW, drawn_frf, heard_cut, slot, structure

from millcal.errors import IllPosedError
from millcal.stages.forces import reconstruct_forces
from millcal.stages.modes import fit_modes

THREE = structure(2012)


@lru_cache(maxsize=20)
def fitted(seed):
    frf = drawn_frf(THREE, np.random.default_rng(seed))
    return frf, fit_modes(frf, band=(30.0, 300.0), modes=3)


def heard(seed, of=THREE, passing=72.0):
    return heard_cut(of, slot(passing), np.random.default_rng(seed), noise=0.5, angle_from="pulse", phase=0.4)


@pytest.mark.parametrize("seeds", [8, pytest.param(80, marks=pytest.mark.long)])
def test_modes_have_smaller_errors_than_the_lines_and_intervals_that_hold_the_truth(seeds):
    off, scaled, sd = {"modes": [], "lines": []}, [], {"modes": [], "lines": []}
    for seed in range(seeds):
        frf, modes = fitted(seed)
        for name, given in (("modes", modes), ("lines", None)):
            found = reconstruct_forces([heard(seed, passing=(60.0, 72.0, 84.0, 95.0)[seed % 4])], frf, modes=given)
            assert found.frf_from == ("modes" if name == "modes" else "measured")
            assert not found.verdict.startswith("does not fit"), found.verdict
            at = [found.posterior.names.index(n) for n in ("Ktc", "Krc")]
            error, deviation = (
                found.posterior.mean[at] - LAW.cutting[:2],
                np.sqrt(np.diag(found.posterior.covariance))[at],
            )
            off[name].append(error / LAW.cutting[:2])
            sd[name].append(deviation / LAW.cutting[:2])
            if name == "modes":
                scaled.append(error / deviation)
    held, slack = np.mean(np.abs(scaled) < 1.96), 3 * np.sqrt(0.05 * 0.95 / (2 * seeds))
    rms = {name: np.sqrt(np.mean(np.square(own))) for name, own in off.items()}
    print(f"held {held:.3f}, rms error of Ktc and Krc {rms}")
    assert np.mean(sd["modes"]) < 0.8 * np.mean(sd["lines"])
    assert held >= 0.9 - slack
    assert rms["modes"] < rms["lines"] * (0.9 if seeds > 50 else 1.2)


def test_a_mode_that_the_fit_has_not_is_told():
    of = structure(2012, natural_frequency=(60.0, 82.0, 103.0, 140.0), damping_ratio=(0.1, 0.15, 0.07, 0.04),
                   mass=(200.0, 150.0, 130.0, 120.0))  # fmt: skip
    frf = drawn_frf(of, np.random.default_rng(1))
    modes = fit_modes(frf, band=(40.0, 300.0), modes=2)
    found = reconstruct_forces([heard(1, of)], frf, modes=modes)
    modal = next(check for check in found.checks if check.name == "modes")
    assert not modal.passed
    assert "modes are missing" in found.verdict
    assert reconstruct_forces([heard(1, of)], frf).verdict.startswith("fits")


def test_modes_of_other_points_are_refused():
    frf, modes = fitted(0)
    cut = heard(0)
    renamed = replace(modes, fit=replace(modes.fit, outputs=tuple(f"else{name}" for name in modes.fit.outputs)))
    with pytest.raises(IllPosedError, match=r"^modes: noseX.* not among their sensors"):
        reconstruct_forces([cut], frf, modes=renamed)
    with pytest.raises(IllPosedError, match="given by hand"):
        reconstruct_forces([cut], frf, modes=replace(modes, fit=None))
