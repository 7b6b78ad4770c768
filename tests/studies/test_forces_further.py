"""What else pays in the study of forces from accelerations: errors that lines share, harmonics, cuts, windows, angles."""

import numpy as np
import pytest

from millcal.studies import forces_further as further
from millcal.studies import forces_tests as impact
from millcal.studies.forces_bench import bench_of, stream
from millcal.studies.forces_cuts import SOUGHT, wanted_lines
from millcal.studies.forces_further import BASE, LOG, WAYS, of_all, run_further
from millcal.studies.forces_structure import SEED, random_structure
from millcal.studies.forces_summary import MAIN, coverage_percent, rms_percent

KTE = SOUGHT.index("Kte")


@pytest.fixture(scope="module")
def bench():
    return bench_of(random_structure(SEED))


@pytest.fixture(scope="module")
def found(bench):
    return run_further(bench, 1, 3, lambda label: None)


def stated(found, way):
    """Mean deviation of Ktc and Krc."""
    return found[way].deviation.mean(axis=(0, 1))[list(MAIN)]


def bound(found, way):
    return rms_percent(found[way].bound)[list(MAIN)]


def test_errors_at_near_lines_are_alike_as_the_window_says(bench):
    """Of windowed H1, 5, 10 and 47 Hz apart; those of plain H1 are not alike at any other line."""
    lines = np.array([53, 58, 63, 110])
    exact = bench.structure.accelerance(lines)
    errors = {"plain": [], "windowed": []}
    for number in range(40):
        test = impact.impact_test(bench.hammer, 0.0, 1.0, stream(11, number), lines, modal=False)
        for name, own in errors.items():
            own.append(getattr(test, name).matrix - exact)
    for name, own in errors.items():
        seen = np.einsum("tlsa,tmsa->lm", np.array(own), np.conj(own))
        size = np.sqrt(np.diag(seen).real)
        shared = getattr(test, name).together(lines)[1].shared
        told = np.einsum("alsms->lm", shared)
        scale = np.sqrt(np.diag(told).real)
        np.testing.assert_allclose(seen / np.outer(size, size), told / np.outer(scale, scale), atol=0.1, err_msg=name)
    assert abs(told[0, 1]) > 0.4 * scale[0] * scale[1]
    assert abs(told[0, 3]) < 0.1 * scale[0] * scale[3]


def test_what_lines_share_leaves_each_line_as_it_is(bench):
    lines = wanted_lines((53, 58), 2)
    test = impact.impact_test(bench.hammer, 5.0, 1.0, stream(12), lines, modal=False).windowed
    apart, together = test.at(lines)[1].shared, test.together(lines)[1].shared
    for line in range(len(lines)):
        np.testing.assert_allclose(together[:, line, :, line], apart[:, line, :, line], rtol=1e-9, atol=1e-18)
    twice = test.together(np.repeat(lines[:1], 2))[1].shared
    np.testing.assert_allclose(twice[:, 0, :, 1], twice[:, 0, :, 0], rtol=1e-9, atol=1e-18)


def test_every_way_answers_once_for_each_of_its_cuts(found):
    answers = {way: own.error.shape[1] for way, own in found.items()}
    assert tuple(answers) == tuple(way for ways in WAYS.values() for way in ways)
    assert answers[BASE] == answers[further.THRICE] == answers[further.OWN_MODES] == answers[further.FITTED] == 12
    assert answers[further.THREE] == 4
    assert answers[further.TOGETHER] == answers[of_all(further.OWN_WINDOWS)] == 1
    for way, own in found.items():
        assert np.isfinite(own.error).all(), way
        assert np.all(own.deviation > 0), way


def test_a_repeated_cut_averages_its_own_noise_and_not_the_frf(found):
    """Three cuts would be worth 1 / sqrt 3 with an exact FRF, and three speeds nearly are."""
    same, apart, three = (
        stated(found, way) / stated(found, BASE) for way in (further.THRICE, further.THRICE_APART, further.THREE)
    )
    assert np.all(same > 0.7)
    assert np.all(same < 1)
    assert np.all(apart < same)
    assert np.all(three < 0.75 * same)


def test_the_log_determinant_draws_forces_to_zero(found):
    """Kte of plain H1; with four harmonics twice as much."""
    two, four = (
        np.mean(found[f"{name} {LOG}"].error[..., KTE] - found[name].error[..., KTE]) for name in further.PLAIN
    )
    assert two < -0.05
    assert four < 1.4 * two
    assert abs(np.mean(found[f"{BASE} {LOG}"].error[..., KTE] - found[BASE].error[..., KTE])) < 0.03


def test_bounds_fall_with_all_that_is_known(found):
    order = (further.FITTED, further.BELIEVING, BASE, further.THRICE, further.THREE, further.TOGETHER, further.MODAL)
    bounds = np.array([bound(found, way) for way in order])
    assert np.all(np.diff(bounds, axis=0) < 0)
    assert np.all(bound(found, further.FITTED) < 1.6 * bound(found, BASE))
    harmonics = np.array([bound(found, way) for way in further.HARMONICS_TRIED])
    assert np.all(np.diff(harmonics, axis=0) < 0)
    for way in (BASE, further.THRICE, further.THREE, further.TOGETHER):
        assert np.all(100 * stated(found, way) > 0.8 * bound(found, way)), way
        assert np.all(100 * stated(found, way) < 1.5 * bound(found, way)), way


def test_windows_found_in_the_data_are_as_good_as_those_given(found):
    for own, given in ((further.OWN_WINDOWS, BASE), (of_all(further.OWN_WINDOWS), further.TOGETHER)):
        apart = np.abs(found[own].error - found[given].error) / found[given].deviation
        assert np.median(apart) < 0.5, own
        ratio = stated(found, own) / stated(found, given)
        assert np.all(ratio > 0.8), own
        assert np.all(ratio < 1.4), own


@pytest.mark.long
def test_errors_and_intervals_of_every_way(bench):
    found = run_further(bench, 40, 5, lambda label: None)

    def rms(way):
        return rms_percent(found[way].error)

    known, fitted, believed = rms(BASE), rms(further.FITTED), rms(further.BELIEVING)
    assert np.all(fitted[list(MAIN)] <= 1.6 * known[list(MAIN)])
    assert np.all(believed[list(MAIN)] <= 1.6 * known[list(MAIN)])
    assert np.all(rms(further.TOGETHER)[list(MAIN)] < rms(further.MEAN)[list(MAIN)])
    bias = {name: 100 * found[f"{name} {LOG}"].error[..., KTE].mean() for name in further.PLAIN}
    assert list(bias.values()) == [pytest.approx(-9, abs=3), pytest.approx(-19, abs=4)]
    for way in (*further.HARMONICS_TRIED, further.OWN_WINDOWS, further.OWN_MODES, further.THRICE, further.FITTED):
        held = coverage_percent(found[way].error, found[way].deviation)
        assert np.all(held > 90), (way, held)
        assert np.all(held < 98.5), (way, held)
    assert coverage_percent(found[further.THRICE_APART].error, found[further.THRICE_APART].deviation).max() < 92
