"""Impact tests with truth: errors within their bands, hits labelled as they were made, onsets where they were.

The error is ||dH|| / ||H|| of the receptance over all channels in the case's band, at the lines of the estimate.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from millcal.data import Channel, Recording
from millcal.io.recordings import read_recording
from millcal.stages.frf import estimate_frf

HERE = Path(__file__).parents[2] / "references" / "impact_12_B_badhits"
OUTSIDE = os.environ.get("MILLCAL_REFERENCE_DATA", "")
needs_reference_data = pytest.mark.skipif(
    not (Path(OUTSIDE) / "cases" / "frf").is_dir() or not OUTSIDE,
    reason="reference data absent: set MILLCAL_REFERENCE_DATA to the folder that holds cases/frf",
)
KIND = {"good": set(), "double": {"double"}, "weak": {"weak"}, "clip_force": {"overload"}, "clip_acc": {"overload"}}


def receptance(truth):
    """Function that rebuilds the receptance of a case at any lines."""
    dofs, phi = list(truth["dofs"]), np.asarray(truth["phi"])
    wn, zeta = 2 * np.pi * np.asarray(truth["fn"]), np.asarray(truth["zeta"])

    def at(frequency, outputs, inputs):
        w = 2 * np.pi * frequency[:, None]
        poles = 1 / (wn**2 - w**2 + 2j * zeta * wn * w)
        o, i = (phi[[dofs.index(dof) for dof in names]] for names in (outputs, inputs))
        return np.einsum("om,im,fm->foi", o, i, poles)

    return at


def case(name):
    folder = Path(OUTSIDE) / "cases" / "frf" / name
    return [read_recording(path) for path in sorted(folder.glob("*.h5"))], dict(np.load(folder / "truth.npz"))


def kinds(frf):
    return [{reason.split(":")[0] for reason in hit.reasons} for hit in frf.hits]


@needs_reference_data
@pytest.mark.parametrize(
    ("name", "band"),
    [
        ("01_exact_A", 6.5e-6),
        ("04_B_med", 2.5e-2),
        ("06_A_med", 2.6e-3),
        ("12_B_badhits", 5e-3),
        ("14_A_continuous", 9e-4),
    ],
)
def test_h1_is_within_its_band(relative_error, name, band):
    recordings, truth = case(name)
    frf = estimate_frf(recordings)
    assert relative_error(frf, receptance(truth), truth["band"]) < band


@needs_reference_data
def test_the_coherence_of_medium_noise_is_high(relative_error):
    recordings, truth = case("04_B_med")
    frf = estimate_frf(recordings)
    inside = (frf.frequency >= truth["band"][0]) & (frf.frequency <= truth["band"][1])
    assert np.median(frf.coherence[inside]) > 0.995


@needs_reference_data
@pytest.mark.parametrize(("name", "tolerance"), [("12_B_badhits", None), ("14_A_continuous", 0.5e-3)])
def test_hits_are_labelled_as_they_were_made_and_found_where_they_were(name, tolerance):
    recordings, truth = case(name)
    frf = estimate_frf(recordings)
    assert kinds(frf) == [KIND[label] for label in truth["labels"]]
    assert [hit.accepted for hit in frf.hits] == [label == "good" for label in truth["labels"]]
    if tolerance:
        assert [hit.onset for hit in frf.hits] == pytest.approx(truth["onset_s"], abs=tolerance)


@needs_reference_data
def test_a_text_recording_of_continuous_hits_is_within_its_band(relative_error):
    """The file is the part from 0.2 to 2.6 s of fourteen hits, nine of them good; two of the nine stand in it, so that the
    band of the whole, 7.5e-3, widens by sqrt(9 / 2)."""
    folder = Path(OUTSIDE) / "cases" / "frf" / "13_B_continuous_csv"
    truth = dict(np.load(folder / "truth.npz"))
    recording = read_recording(
        folder / "tap.csv",
        map={"hammer@tipX": "force_N", "acc@tipX": "acc_tipX_m_s2", "acc2@holdX": "acc_holdX_m_s2"},
        units={"force_N": "N", "acc_tipX_m_s2": "m/s^2", "acc_holdX_m_s2": "m/s^2"},
    )
    frf = estimate_frf(recording)
    assert kinds(frf) == [KIND[label] for label in truth["labels"][:3]]
    assert [hit.onset for hit in frf.hits] == pytest.approx(truth["onset_s"][:3] - 0.2, abs=0.3e-3)
    assert frf.hits_used == (2,)
    assert relative_error(frf, receptance(truth), truth["band"]) < 7.5e-3 * np.sqrt(9 / 2)


def test_bad_hits_are_rejected_with_their_reasons_and_the_rest_gives_the_frf(relative_error):
    truth = json.loads((HERE / "truth.json").read_text())
    frf = estimate_frf(read_recording(HERE / "tap_tipX.h5"))
    assert kinds(frf) == [KIND[label] for label in truth["labels"]]
    assert [hit.index for hit in frf.hits if not hit.accepted] == [2, 5, 8, 10, 11]
    assert relative_error(frf, receptance({**truth, "fn": truth["fn_hz"]}), truth["band_hz"]) < 5e-3


@pytest.mark.skipif(
    not (Path(OUTSIDE) / "real" / "cutpro_hammer").is_dir() or not OUTSIDE,
    reason="reference data absent: set MILLCAL_REFERENCE_DATA to the folder that holds real/cutpro_hammer",
)
def test_a_real_single_hit_gives_the_plain_ratio_and_no_coherence():
    table = np.loadtxt(Path(OUTSIDE) / "real" / "cutpro_hammer" / "Point1_Channel1_CH1.txt")
    rate = 51200.0
    recording = Recording(
        samples=table[:, 1:].T.copy(),
        sample_rate=rate,
        channels=(Channel("hammer", "force", "N", "tipX"), Channel("acc", "acceleration", "m/s^2", "tipX")),
        kind="impact",
        name="hammer.txt",
    )
    frf = estimate_frf(recording, record_length=1.0, resolution=1.0)
    plain = np.fft.rfft(table[:, 2]) / np.fft.rfft(table[:, 1])
    assert frf.frequency == pytest.approx(np.fft.rfftfreq(len(table), 1 / rate))
    inside = (frf.frequency >= 500) & (frf.frequency <= 3500)
    difference = frf.values[inside, 0, 0] - plain[inside]
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(plain[inside])
    assert np.isnan(frf.coherence).all()
    assert "single-hit" in {notice.code for notice in frf.notices}
    assert frf.hits[0].peak == pytest.approx(249.7, abs=0.1)
