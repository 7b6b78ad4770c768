"""Hits and cuts of the study of forces from accelerations as recordings, and what the stages of the project say of them.

The study's own FRFs have windows of lengths that are given; `estimate_frf` finds its own in the data.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Channel, CutVibration, Frf, Modes, Recording
from millcal.stages.forces import reconstruct_forces
from millcal.stages.frf import estimate_frf
from millcal.studies.forces_cuts import CUTTER, NEAR, SOUGHT, CutRecord, conditions
from millcal.studies.forces_methods import Told
from millcal.studies.forces_tests import SAMPLE_RATE, SAMPLES

TIP = ("tipX", "tipY", "tipZ")
PLACES = ("noseX", "noseY", "noseZ", "headX", "headY", "headZ")
AHEAD = 64  # samples of rest that are moved from the end of a hit to its beginning, to be a pretrigger


def frf_of_hits(axes: Sequence[tuple[np.ndarray, np.ndarray]]) -> Frf:
    """The FRF that the project finds from hits.   axes : as `hits_on` gives them"""
    return estimate_frf([recorded_hits(*own, dof) for own, dof in zip(axes, TIP, strict=True)])


def recorded_hits(force: np.ndarray, response: np.ndarray, dof: str) -> Recording:
    """Hits in one direction as one recording.   force : (hit, sample)   response : (hit, sensor, sample)"""
    hits, sensors, samples = response.shape
    record = np.empty((1 + sensors, hits, samples))
    record[0], record[1:] = force, response.swapaxes(0, 1)
    return Recording(
        samples=np.roll(record, AHEAD, axis=2).reshape(1 + sensors, -1),
        sample_rate=SAMPLE_RATE,
        channels=(
            Channel(name="hammer", quantity="force", unit="N", dof=dof),
            *(Channel(name=place, quantity="acceleration", unit="m/s^2", dof=place) for place in PLACES),
        ),
        kind="impact",
        name=f"tap-{dof}.h5",
        segments=np.stack([samples * np.arange(hits), np.full(hits, samples)], axis=1),
    )


def heard(record: CutRecord, passing: int) -> CutVibration:
    """A cut as it is conditioned, with the angle of tooth 0 stated.   passing : Hz"""
    lines, sensors = record.values.shape
    order = CUTTER.teeth * np.arange(1, lines + 1)
    harmonics = np.zeros((sensors, order[-1] + 1), complex)
    harmonics[:, order] = 2 * record.values.T  # one-sided
    covariance = np.zeros((order[-1] + 1, sensors, sensors), complex)
    covariance[order] = 4 * record.noise
    noise = np.sqrt(SAMPLES * np.einsum("lss->ls", record.noise).real.mean(axis=0))
    rms = np.sqrt(np.sum(np.abs(harmonics) ** 2, axis=1) / 2)
    return CutVibration(
        name=f"cut-{passing}.h5",
        cutter=CUTTER,
        conditions=conditions(passing),
        sensors=PLACES,
        harmonics=harmonics,
        covariance=covariance,
        lines_between=np.full(order[-1] + 1, 2.0 * NEAR),
        angle_from="stated",
        ac_rms=np.hypot(rms, noise),
        asynchronous_rms=noise,
        overview_time=np.array([0.0, SAMPLES / SAMPLE_RATE]),
        overview_low=np.repeat(-rms[:, np.newaxis], 2, axis=1),
        overview_high=np.repeat(rms[:, np.newaxis], 2, axis=1),
        sample_rate=SAMPLE_RATE,
        spindle_frequency=passing / CUTTER.teeth,
        spindle_frequency_sd=0.0,
        revolutions=passing // CUTTER.teeth,
        steady=(0.0, SAMPLES / SAMPLE_RATE),
    )


def told_by_tool(cuts: Sequence[CutVibration], frf: Frf, *, harmonics: int, modes: Modes | None = None) -> Told:
    """Ktc, Kte, Krc, Kre with the deviations that are stated, by the default method with the angle known."""
    found = reconstruct_forces(cuts, frf, harmonics=harmonics, modes=modes, phase="known", runout="known").posterior
    place = [found.names.index(name) for name in SOUGHT]
    return Told(found.mean[place], np.sqrt(np.diag(found.covariance)[place]))
