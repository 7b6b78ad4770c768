"""The generator against a stored structure, its noise against what it states, and its fast way against the slow one."""

import numpy as np
import pytest
from accelerometer_cuts import (
    LAW,
    SENSORS,
    TWO_TEETH,
    Hits,
    drawn_frf,
    heard_cut,
    measured_frf,
    poor_tooth_passing,
    slot,
    structure,
)

from millcal.physics.cutting_force import force_harmonics
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.conditioning.vibration import condition_vibration


def test_seed_2012_is_the_structure_of_the_stored_case():
    """|G| of sensor 1 and x at three frequencies, of cases/forces/structure_2012.json; the condition of page forces.md."""
    of = structure(2012)
    found = np.abs(of.accelerance(np.array([53.0, 78.0, 106.0]))[:, 0, 0])
    assert found == pytest.approx([0.006327630390539279, 0.003453307370249125, 0.017364228705393406], rel=1e-12)


def test_what_is_heard_without_noise_is_accelerance_times_force():
    of, conditions = structure(3), slot(78.0)
    cut = heard_cut(of, conditions, np.random.default_rng(0))
    force = force_harmonics(LAW, TWO_TEETH, conditions, 12)
    for k in (2, 4):
        assert cut.harmonics[:, k] == pytest.approx(of.accelerance(np.array([k * 39.0]))[0] @ force[:, k], rel=1e-12)
    assert np.abs(cut.harmonics[:, 1::2]).max() < 1e-12  # two equal teeth
    turned = heard_cut(of, conditions, np.random.default_rng(0), angle_from="pulse", phase=0.3)
    assert turned.harmonics[:, 2] == pytest.approx(cut.harmonics[:, 2] * np.exp(0.6j))


def test_the_noise_has_the_covariance_that_is_stated():
    mixed = np.random.default_rng(5).standard_normal((6, 6))
    options = {"noise": mixed @ mixed.T, "harmonics": 400, "lines_between": None}
    of, conditions = structure(3), slot(78.0)
    noisy = heard_cut(of, conditions, np.random.default_rng(0), **options)
    clean = heard_cut(of, conditions, np.random.default_rng(0), harmonics=400)
    error = (noisy.harmonics - clean.harmonics)[:, 1:]
    found = error @ error.conj().T / error.shape[1]
    assert np.linalg.norm(found - noisy.covariance[1]) < 0.2 * np.linalg.norm(found)
    drawn = heard_cut(of, conditions, np.random.default_rng(0), **(options | {"lines_between": 20}))
    assert np.linalg.norm(drawn.covariance.mean(axis=0) - noisy.covariance[1]) < 0.03 * np.linalg.norm(found)


def errors(of, frf):
    band = (frf.frequency > 40) & (frf.frequency < 320)
    exact = of.accelerance(frf.frequency[band])
    off = frf.values[band] - exact
    return np.linalg.norm(off) / np.linalg.norm(exact), np.mean(np.abs(off) ** 2) / np.mean(frf.variance[band])


def test_an_frf_that_is_drawn_has_the_errors_of_one_that_is_measured_and_both_state_them():
    of = structure(2012)
    slow, fast = (errors(of, make(of, np.random.default_rng(1))) for make in (measured_frf, drawn_frf))
    assert slow[0] == pytest.approx(fast[0], rel=0.15)
    assert slow[1] == pytest.approx(1.0, abs=0.15)
    assert fast[1] == pytest.approx(1.0, abs=0.15)
    quiet = drawn_frf(of, np.random.default_rng(1), Hits(force_noise=0.0, acceleration_noise=0.0))
    assert errors(of, quiet)[0] < 1e-12


def test_hits_that_are_drawn_average_to_their_frf():
    of = structure(2012)
    frf = drawn_frf(of, np.random.default_rng(2), Hits(force_noise=0.0))
    test = frf.tests[1]
    points = 2 * (len(frf.frequency) - 1)
    force = np.zeros((9, points))
    for hit, (start, own) in enumerate(zip(test.force_start.astype(int), test.force[:, 0], strict=True)):
        force[hit, start : start + len(own)] = own
    spectra = np.fft.rfft(force)
    found = np.einsum("hk,hok->ok", spectra.conj(), test.response) / np.sum(np.abs(spectra) ** 2, axis=0)
    assert pytest.approx(frf.values[40:320, :, 1], rel=1e-4, abs=1e-6) == found[:, 40:320].T


def test_a_poor_speed_is_one_where_the_sensors_tell_the_forces_apart_badly():
    of = structure(2012)
    poor = poor_tooth_passing(of, 45.0, 110.0, harmonic=2)
    assert of.condition([2 * poor])[0] > 2 * np.median(of.condition(np.linspace(90.0, 220.0, 50)))
    assert of.sensors == SENSORS


def test_a_cut_that_is_made_at_once_is_the_one_that_is_recorded_and_conditioned():
    """The same harmonics within the noise that both state, which agrees by 15 % on the average; the mean is nothing known."""
    of, conditions = structure(2012), slot(78.0)
    options = {"noise": 0.5, "revolutions": 78, "angle_from": "pulse", "phase": 0.4, "lines_between": None}
    made = heard_cut(of, conditions, np.random.default_rng(0), **options)
    recording, _ = simulate_cut(
        LAW,
        TWO_TEETH,
        conditions,
        rng=np.random.default_rng(1),
        sample_rate=2048.0,
        timeline=Timeline(2.0),
        initial_angle=0.0,
        dynamometer=None,
        modes=of.modes,
        accelerometers=of.sensors,
        accelerometer=MeasuringChain(noise=0.5),
        pulse=True,
        pulse_angle=0.4,
    )
    found = condition_vibration(recording, steady=(0.0, 2.0), harmonics=12)
    assert found.sensors == made.sensors
    assert found.angle_from == "pulse"
    late = np.angle(np.vdot(made.harmonics[:, 2], found.harmonics[:, 2])) / 2  # a pulse is known to a sample at best
    assert abs(late) < 2 * np.pi * 39 / 2048
    turned = found.harmonics[:, 1:] * np.exp(-1j * np.arange(1, 13) * late)
    sd = np.sqrt(np.einsum("kss->sk", made.covariance).real)[:, 1:]
    assert np.sqrt(np.mean((np.abs(turned - made.harmonics[:, 1:]) / sd) ** 2)) == pytest.approx(np.sqrt(2), rel=0.25)
    stated = np.sqrt(np.einsum("kss->sk", found.covariance).real)[:, 1:]
    assert np.mean(stated) == pytest.approx(np.mean(sd), rel=0.15)
    assert np.abs(found.harmonics[:, 0]).max() == np.abs(made.harmonics[:, 0]).max() == 0
