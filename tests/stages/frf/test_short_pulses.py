"""Pulses of a few samples ring in the converter's filter; ringing is no second hit, and a second hit stays one."""

from dataclasses import replace

import impact_cases
import pytest
from impact_cases import KINDS, STRUCTURES, make_case

from millcal.stages.frf import estimate_frf


@pytest.fixture
def short(monkeypatch):
    """Function that makes a case of a kind with pulses of some samples."""

    def make(samples, seed, **more):
        pulse = samples / impact_cases.RATE
        monkeypatch.setitem(STRUCTURES, "short", replace(STRUCTURES["B"], pulse=pulse))
        monkeypatch.setitem(KINDS, "short", replace(KINDS["04_B_med"], structure="short", **more))
        return make_case("short", seed)

    return make


@pytest.mark.parametrize("samples", [3.8, 5.1])
def test_ringing_is_no_second_hit(short, samples):
    hits = [hit for seed in range(3) for hit in estimate_frf(short(samples, seed).recordings).hits]
    assert sum(not hit.accepted for hit in hits) <= 0.01 * len(hits) + 1


@pytest.mark.parametrize("share", [0.15, 0.3])
@pytest.mark.parametrize("later", [1e-3, 6e-3])
def test_a_second_hit_of_short_pulses_is_found(short, share, later):
    doubles = {hit: (share, later) for hit in (1, 4, 7)}
    hits = estimate_frf(short(3.8, 0, doubles=doubles).recordings).hits
    found = {(hit.recording, hit.index) for hit in hits if any(reason.startswith("double") for reason in hit.reasons)}
    assert found == {(hit.recording, hit.index) for hit in hits if hit.index in doubles}
