"""The compiled loop of recursive least squares against the plain steps, and what it makes of simulated cuts."""

import itertools

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from millcal.numerics import recursive_least_squares as rls
from millcal.physics.cutter import Cutter
from millcal.physics.follow_rls import follow_rls
from millcal.physics.followed import left_out
from millcal.physics.sampled_force import Passage, sampled_force

CUTTER = Cutter(diameter=10e-3, teeth=2, helix=np.pi / 4)
H0 = 60e-6
LEVEL, SHARE = np.log([2.8e9, 1.6e9, 0.7e9]), {"kienzle": (0.18, 0.55, 0.4), "linear-edge": (0.25, 0.35, 0.3)}
NODES = 6


def truth_of(law, axial, samples, rise=0.2, runout=(3e-6, -2e-6)):
    count = 3 if axial else 2
    theta = np.empty((samples, 2 * count + 2))
    theta[:, 0:-2:2] = LEVEL[:count] + np.log1p(rise * np.linspace(0, 1, samples))[:, np.newaxis]
    theta[:, 1:-2:2] = SHARE[law][:count]
    theta[:, -2:] = runout
    return theta


def record(law, axes, samples, lowpass=None, seed=0, noise=5.0, **truth):
    met = Passage(2 * np.pi / 117 * np.arange(samples), 1e-4, 2e-3, 2.0, np.pi, 0.2)
    theta = truth_of(law, "z" in axes, samples, **truth)
    force, _ = sampled_force(theta, met, CUTTER, law=law, reference_chip=H0, axes=axes, nodes=NODES)
    clean = force if lowpass is None else lfilter(*lowpass, force, axis=0)
    measured = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    used = np.abs(force).max(axis=1) > 50.0
    measured[~used] = np.nan
    return theta, met, measured, used


def start_of(theta):
    mean = theta[0].copy()
    mean[0:-2:2] += 0.1
    mean[1:-2:2] += 0.05
    mean[-2:] = 0.0
    return mean, np.diag(np.array([0.2, 0.1] * (len(mean) // 2 - 1) + [5e-6, 5e-6]) ** 2)


def plain(mean, covariance, met, measured, used, edges, *, law, axes, noise, lowpass, disc, **options):
    """The same by numerics' step, with matrices."""
    state = rls.Estimate(mean, covariance)
    b, a = lowpass or (np.ones(1), np.ones(1))
    memory = np.zeros((max(len(a), len(b)) - 1, len(axes), len(mean) + 1))
    at = [np.broadcast_to(field, len(used)) for field in met]
    means, covariances, normalised, bounds = [], [], [], []
    for k in range(edges[0], edges[-1]):
        seen = {}

        def observe(x, k=k, seen=seen, memory=memory):
            now = Passage(*(field[[k]] for field in at))
            force, slopes = sampled_force(x, now, CUTTER, law=law, reference_chip=H0, axes=axes, nodes=NODES)
            rows = np.column_stack([slopes[0], force[0] - slopes[0] @ (x - mean)])
            out, seen["memory"] = lfilter(b, a, rows[np.newaxis], axis=0, zi=memory)
            return out[0, :, -1] + out[0, :, :-1] @ (x - mean), out[0, :, :-1]

        if used[k]:
            state, info = rls.step(
                state,
                measured[k],
                observe=observe,
                noise=np.diag(noise**2),
                left_out=lambda slopes, spread: left_out(slopes, spread, len(mean) // 2 - 1),
                ceiling=np.diag(covariance),
                discs=() if disc is None else [disc],
                **options,
            )
            normalised.append(info.normalised)
            bounds.append(info.at_bound)
        else:
            observe(state.mean)
        memory = seen["memory"]
        means.append(state.mean)
        covariances.append(state.covariance)
    ends = np.array(edges[1:]) - edges[0] - 1
    return np.array(means)[ends], np.array(covariances)[ends], np.array(normalised), np.array(bounds)


@pytest.mark.parametrize("law", SHARE)
@pytest.mark.parametrize("axes", [("x", "y"), ("x", "y", "z")])
@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("projection", [None, "nearest", "clip"])
def test_the_loop_is_the_plain_step(law, axes, filtered, projection):
    lowpass = butter(2, 0.12) if filtered else None
    theta, met, measured, used = record(law, axes, 260, lowpass)
    mean, covariance = start_of(theta)
    noise, edges = np.full(len(axes), 5.0), np.array([7, 60, 61, 150, 250])
    limits, disc = None, None
    if projection:  # a box that is hit, and a disc that the true runout is outside of
        limits = np.column_stack([theta[0] - 0.02, theta[0] + 0.06])
        limits[-2:] = -2e-6, 2e-6
        disc = (len(mean) - 2, 2e-6)
    options = {
        "law": law,
        "axes": axes,
        "noise": noise,
        "forgetting": 0.98,
        "limits": limits,
        "disc": disc,
        "projection": projection or "nearest",
        "lowpass": lowpass,
    }
    got = follow_rls(mean, covariance, met, measured, used, edges, CUTTER, reference_chip=H0, nodes=NODES, **options)
    means, covariances, normalised, bounds = plain(mean, covariance, met, measured, used, edges, **options)
    assert got.mean == pytest.approx(means, rel=1e-8, abs=1e-15)
    scale = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert got.covariance / scale[:, :, None] / scale[:, None] == pytest.approx(
        covariances / scale[:, :, None] / scale[:, None], abs=1e-7
    )
    count = [used[lo:hi].sum() for lo, hi in itertools.pairwise(edges)]
    assert got.count.tolist() == count
    last = slice(sum(count[:-1]), None)
    assert got.innovation_mean[-1] == pytest.approx(normalised[last].mean(axis=0), rel=1e-6)
    assert got.innovation_square[-1] == pytest.approx((normalised[last] ** 2).mean(axis=0), rel=1e-6)
    assert got.at_bound[-1] == pytest.approx(bounds[last].mean(axis=0))
    assert bool(bounds.any()) == bool(projection)


def follow(theta, met, measured, used, edges, axes, law="kienzle", **options):
    mean, covariance = start_of(theta)
    return follow_rls(
        mean,
        covariance,
        met,
        measured,
        used,
        edges,
        CUTTER,
        law=law,
        reference_chip=H0,
        axes=axes,
        noise=np.full(len(axes), 5.0),
        nodes=NODES,
        **options,
    )


@pytest.mark.parametrize("law", SHARE)
def test_full_memory_on_a_cut_that_rests_finds_the_truth(law):
    theta, met, measured, used = record(law, ("x", "y", "z"), 2400, rise=0.0)
    got = follow(theta, met, measured, used, np.array([0, 2400]), ("x", "y", "z"), law, forgetting=1.0)
    error = (got.mean[0] - theta[0]) / np.sqrt(np.diag(got.covariance[0]))
    assert np.sqrt(np.mean(error**2)) < 2.0
    assert np.abs(error).max() < 4.0
    assert got.innovation_square[0] == pytest.approx(np.ones(3), abs=0.15)


def test_forgetting_follows_a_rise_that_a_full_memory_averages():
    theta, met, measured, used = record("kienzle", ("x", "y"), 4800, rise=0.4)
    edges = np.arange(0, 4801, 600)
    late = []
    for rho in (0.99, 1.0):
        got = follow(theta, met, measured, used, edges, ("x", "y"), forgetting=rho)
        late.append(np.abs(got.mean[-1, [0, 2]] - theta[-1, [0, 2]]).max())
    assert late[0] < 0.03
    assert late[1] > 0.08


def test_runout_that_one_tooth_cannot_show_stays_as_it_was():
    one = Cutter(diameter=10e-3, teeth=1, helix=np.pi / 4)
    met = Passage(2 * np.pi / 117 * np.arange(60_000), 1e-4, 2e-3, 2.0, np.pi, 0.0)
    theta = truth_of("kienzle", False, 1)[0]
    force, _ = sampled_force(theta, met, one, law="kienzle", reference_chip=H0, axes=("x", "y"), nodes=NODES)
    mean, covariance = start_of(theta[np.newaxis])
    got = follow_rls(
        mean,
        covariance,
        met,
        force,
        np.abs(force).max(axis=1) > 50.0,
        np.array([0, 60_000]),
        one,
        law="kienzle",
        reference_chip=H0,
        axes=("x", "y"),
        noise=np.full(2, 5.0),
        nodes=NODES,
    )
    assert got.mean[0, :4] == pytest.approx(theta[:4], rel=1e-6)
    assert got.mean[0, 4:] == pytest.approx(mean[4:], abs=1e-15)
    assert np.diag(got.covariance[0])[4:] == pytest.approx(np.diag(covariance)[4:])


def test_a_low_pass_is_taken_for_what_it_is():
    lowpass = butter(2, 0.06)
    theta, met, measured, used = record("kienzle", ("x", "y"), 2400, lowpass, rise=0.0)
    errors = []
    for assumed in (lowpass, None):
        got = follow(theta, met, measured, used, np.array([0, 2400]), ("x", "y"), lowpass=assumed, forgetting=0.998)
        errors.append(np.abs(got.mean[0, :4] - theta[-1, :4]).max())
    assert errors[0] < 0.04
    assert errors[1] > 10 * errors[0]


def test_a_projection_that_does_not_exist_is_refused():
    theta, met, measured, used = record("kienzle", ("x", "y"), 20)
    with pytest.raises(ValueError, match="none of nearest, clip"):
        follow(theta, met, measured, used, np.array([0, 20]), ("x", "y"), projection="mirror")
