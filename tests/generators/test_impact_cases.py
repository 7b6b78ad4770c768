"""The generator against recordings that were made by another program, from the same structures and levels of noise."""

import os
from pathlib import Path

import numpy as np
import pytest
from impact_cases import HAMMER, KINDS, RATE, STRUCTURES, make_case

from millcal.io.recordings import read_recording

OUTSIDE = os.environ.get("MILLCAL_REFERENCE_DATA", "")
CASES = Path(OUTSIDE) / "cases" / "frf"
needs_reference_data = pytest.mark.skipif(
    not CASES.is_dir() or not OUTSIDE,
    reason="reference data absent: set MILLCAL_REFERENCE_DATA to the folder that holds cases/frf",
)
STORED = ("01_exact_A", "04_B_med", "06_A_med", "12_B_badhits", "14_A_continuous")


@needs_reference_data
@pytest.mark.parametrize("name", STORED)
def test_the_receptance_is_that_of_the_stored_truth(name):
    truth, structure = np.load(CASES / name / "truth.npz"), STRUCTURES[KINDS[name].structure]
    found = structure.receptance(truth["freq"], tuple(truth["dofs"]), HAMMER)
    assert np.linalg.norm(found - truth["values_f_out_in"]) < 1e-12 * np.linalg.norm(found)


def sizes(recording):
    """Largest force, and largest response per largest force: medians over the pieces of 8192 samples that hold a hit."""
    samples = recording.block(0, 1 << 20)
    pieces = samples[:, : samples.shape[1] // 8192 * 8192].reshape(len(samples), -1, 8192)
    largest = np.abs(pieces).max(axis=2)
    largest = largest[:, largest[0] > 0.3 * largest[0].max()]
    return np.median(largest[0]), np.median(largest[1:] / largest[0], axis=1)


@needs_reference_data
@pytest.mark.parametrize("name", STORED)
def test_recordings_are_alike_those_stored(name):
    """Same channels, records and labels; peaks of a like size, and noise and offset too before the first hit."""
    stored = [read_recording(path) for path in sorted((CASES / name).glob("*.h5"))]
    truth = dict(np.load(CASES / name / "truth.npz"))
    case = make_case(name, 0)
    assert len(case.recordings) == len(stored)
    assert "labels" not in truth or case.labels == tuple(truth["labels"])
    for made, given in zip(case.recordings, stored, strict=True):
        assert [(c.dof, c.quantity) for c in made.channels] == [(c.dof, c.quantity) for c in given.channels]
        assert made.segments is None or (made.segments == given.segments).all()
        (force, ratio), (stored_force, stored_ratio) = sizes(made), sizes(given)
        assert force == pytest.approx(stored_force, rel=0.5)
        assert ratio == pytest.approx(stored_ratio, rel=0.35)
        if max(KINDS[name].noise) > 0:
            quiet = slice(0, 150 if made.segments is not None else round(0.3 * RATE))
            ours, theirs = made.block(0, 8192)[:, quiet], given.block(0, 8192)[:, quiet]
            assert ours.std(axis=1) == pytest.approx(theirs.std(axis=1), rel=0.4)
            assert ours.mean(axis=1) == pytest.approx(theirs.mean(axis=1), rel=0.4, abs=0.3 * theirs.std())


def test_a_seed_makes_the_same_case_again_and_another_one_another():
    first, again, other = make_case("03_B_low", 1), make_case("03_B_low", 1), make_case("03_B_low", 2)
    assert (first.recordings[0].samples == again.recordings[0].samples).all()
    assert not np.allclose(first.onset, other.onset)
