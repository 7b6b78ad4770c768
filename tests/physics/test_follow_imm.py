"""The compiled loop of interacting models against the plain steps, and what it makes of simulated cuts."""

import itertools

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from millcal.numerics import interacting_models as imm
from millcal.numerics.interacting_kernel import transitions
from millcal.physics.cutter import Cutter
from millcal.physics.follow_imm import JUMP, STAY, TRENDS, Motion, bank, follow_imm, motions_of
from millcal.physics.followed import left_out
from millcal.physics.sampled_force import Passage, sampled_force

CUTTER = Cutter(diameter=10e-3, teeth=2, helix=np.pi / 4)
H0 = 60e-6
SHARE = {"kienzle": (0.18, 0.55, 0.4), "linear-edge": (0.25, 0.35, 0.3)}
NODES = 6


def passage(samples, revolution=117, entry=2.0):
    return Passage(2 * np.pi / revolution * np.arange(samples), 1e-4, 2e-3, entry, np.pi, 0.2)


def truth_of(law, samples, axial, rise=0.2, runout=(3e-6, -2e-6)):
    """Specific forces that rise by a share over the record."""
    level = np.log([2.8e9, 1.6e9, 0.7e9][: 3 if axial else 2])
    theta = np.empty((samples, 2 * len(level) + 2))
    theta[:, 0:-2:2] = level + np.log1p(rise * np.linspace(0, 1, samples))[:, np.newaxis]
    theta[:, 1:-2:2] = SHARE[law][: len(level)]
    theta[:, -2:] = runout
    return theta


def start_of(theta):
    """A guess some way off, with the doubt to go with it."""
    mean = theta[0].copy()
    mean[0:-2:2] += 0.1
    mean[1:-2:2] += 0.05
    mean[-2:] = 0.0
    deviation = np.array([0.2, 0.1] * (len(mean) // 2 - 1) + [5e-6, 5e-6])
    return mean, np.diag(deviation**2)


def record(law, axes, samples=600, lowpass=None, seed=0, noise=5.0, **truth):
    met = passage(samples)
    theta = truth_of(law, samples, "z" in axes, **truth)
    force, _ = sampled_force(theta, met, CUTTER, law=law, reference_chip=H0, axes=axes, nodes=NODES)
    clean = force if lowpass is None else lfilter(*lowpass, force, axis=0)
    measured = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    used = np.abs(force).max(axis=1) > 50.0
    measured[~used] = np.nan
    return theta, met, measured, used, clean


def plain(mean, covariance, met, measured, used, edges, models, *, law, axes, noise, stay, rate, lowpass):
    """The same by numerics' step, with matrices."""
    P = len(mean)
    motions = motions_of(models, P)
    n = P + (P - 2) // 2
    matrices = transitions(motions, n)
    start, spread = np.zeros(n), np.zeros((n, n))
    start[:P], spread[:P, :P] = mean, covariance
    spread[range(P, n), range(P, n)] = rate**2
    state = imm.start(start, spread, len(models))
    b, a = lowpass or (np.ones(1), np.ones(1))
    memory = np.zeros((max(len(a), len(b)) - 1, len(axes), P + 1))
    centre, total = start, 0.0
    means, covariances, probabilities, normalised = [], [], [], []
    at = [np.broadcast_to(field, len(used)) for field in met]
    for k in range(edges[0], edges[-1]):
        seen = {}

        def observe(x, k=k, seen=seen, memory=memory):
            now = Passage(*(field[[k]] for field in at))
            force, slopes = sampled_force(x[:P], now, CUTTER, law=law, reference_chip=H0, axes=axes, nodes=NODES)
            rows = np.column_stack([slopes[0], force[0] - slopes[0] @ (x[:P] - start[:P])])
            out, seen["memory"] = lfilter(b, a, rows[np.newaxis], axis=0, zi=memory)
            return out[0, :, -1] + out[0, :, :-1] @ (x[:P] - start[:P]), np.hstack(
                [out[0, :, :-1], np.zeros((len(axes), n - P))]
            )

        if used[k]:
            state, info = imm.step(
                state,
                measured[k],
                models=matrices,
                chances=imm.switching(len(models), stay),
                observe=observe,
                noise=np.diag(noise**2),
                left_out=lambda slopes, spread: left_out(slopes, spread, len(mean) // 2 - 1),
            )
            centre = info.mean
            total += info.log_likelihood
            normalised.append(info.innovation / np.sqrt(np.diag(info.innovation_covariance)))
        else:
            observe(centre)
        memory = seen["memory"]
        means.append(centre[:P])
        covariances.append(imm.combine(state)[1][:P, :P])
        probabilities.append(state.probability)
    ends = np.array(edges[1:]) - edges[0] - 1
    return (
        np.array(means)[ends],
        np.array(covariances)[ends],
        np.array(probabilities)[ends],
        np.array(normalised),
        total,
    )


@pytest.mark.parametrize("law", SHARE)
@pytest.mark.parametrize("axes", [("x", "y"), ("x", "y", "z"), ("y",)])
@pytest.mark.parametrize("filtered", [False, True])
def test_the_loop_is_the_plain_step(law, axes, filtered):
    lowpass = butter(2, 0.12) if filtered else None
    theta, met, measured, used, _ = record(law, axes, 260, lowpass)
    mean, covariance = start_of(theta)
    models = [*TRENDS, JUMP]
    noise, edges = np.full(len(axes), 5.0), np.array([7, 60, 61, 150, 250])
    options = {"law": law, "axes": axes, "noise": noise, "stay": 0.995, "rate": 1e-4, "lowpass": lowpass}
    got = follow_imm(
        mean, covariance, met, measured, used, edges, CUTTER, reference_chip=H0, models=models, nodes=NODES, **options
    )
    means, covariances, probabilities, normalised, total = plain(
        mean, covariance, met, measured, used, edges, models, **options
    )
    assert got.mean == pytest.approx(means, rel=1e-9, abs=1e-16)
    scale = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert got.covariance / scale[:, :, None] / scale[:, None] == pytest.approx(
        covariances / scale[:, :, None] / scale[:, None], abs=1e-8
    )
    assert got.probability == pytest.approx(probabilities, abs=1e-8)
    assert got.log_likelihood == pytest.approx(total, rel=1e-9)
    count = [used[lo:hi].sum() for lo, hi in itertools.pairwise(edges)]
    assert got.count.tolist() == count
    first = normalised[: count[0]]
    assert got.innovation_mean[0] == pytest.approx(first.mean(axis=0), rel=1e-8)
    assert got.innovation_square[0] == pytest.approx((first**2).mean(axis=0), rel=1e-8)


def follow(law, axes, samples=2400, lowpass=None, assumed=None, models=TRENDS, **truth):
    theta, met, measured, used, _ = record(law, axes, samples, lowpass, **truth)
    mean, covariance = start_of(theta)
    edges = np.arange(0, samples + 1, samples // 8)
    got = follow_imm(
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
        models=models,
        lowpass=assumed,
        nodes=NODES,
    )
    return got, theta[edges[1:] - 1]


@pytest.mark.parametrize("law", SHARE)
@pytest.mark.parametrize("axes", [("x", "y"), ("x", "y", "z")])
def test_rising_forces_are_followed_within_their_intervals(law, axes):
    got, theta = follow(law, axes)
    error = (got.mean - theta)[2:] / np.sqrt(np.diagonal(got.covariance, axis1=1, axis2=2))[2:]
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert np.abs(got.mean - theta)[-1, [0, 2]].max() < 0.02
    assert got.innovation_square[2:].mean() == pytest.approx(1.0, abs=0.1)


def test_what_rests_is_known_to_rest():
    got, _ = follow("kienzle", ("x", "y"), rise=0.0)
    assert got.probability[-1].argmax() == 0
    assert np.sqrt(got.covariance[-1, 0, 0]) < 0.005


@pytest.mark.parametrize("known", [True, False])
def test_known_runout_stays_and_unknown_is_found(known):
    theta, met, measured, used, _ = record("kienzle", ("x", "y"), 2400, noise=2.0)
    mean, covariance = start_of(theta)
    if known:
        mean[-2:] = theta[0, -2:]
        covariance[-2:] = 0.0
        covariance[:, -2:] = 0.0
    got = follow_imm(
        mean,
        covariance,
        met,
        measured,
        used,
        np.array([0, 2400]),
        CUTTER,
        law="kienzle",
        reference_chip=H0,
        axes=("x", "y"),
        noise=np.full(2, 2.0),
        nodes=NODES,
    )
    if known:
        assert got.mean[0, -2:] == pytest.approx(theta[0, -2:], rel=1e-12)
        assert np.abs(got.covariance[0, -2:]).max() < 1e-20
    else:
        error = got.mean[0, -2:] - theta[0, -2:]
        assert np.abs(error).max() < 4 * np.sqrt(np.diag(got.covariance[0])[-2:]).max() < 2e-6


def test_a_low_pass_is_taken_for_what_it_is():
    """Ignored, or taken for the whole samples of its delay, it spoils the coefficients; put into the model it does not."""
    lowpass = butter(2, 0.06)
    theta, met, measured, used, _ = record("kienzle", ("x", "y"), 2400, lowpass, rise=0.0)
    mean, covariance = start_of(theta)
    errors = {}
    options = {"law": "kienzle", "reference_chip": H0, "axes": ("x", "y"), "noise": np.full(2, 5.0), "nodes": NODES}
    delay = Passage(met.angle - 7.5 * (met.angle[1] - met.angle[0]), *met[1:])  # sqrt(2) / (0.06 pi) samples
    for name, at, assumed in (("model", met, lowpass), ("ignored", met, None), ("delay", delay, None)):
        got = follow_imm(mean, covariance, at, measured, used, np.array([0, 2400]), CUTTER, lowpass=assumed, **options)
        errors[name] = np.abs(got.mean[0, :4] - theta[-1, :4]).max()
    assert errors["model"] < 0.02
    assert errors["ignored"] > 10 * errors["model"]
    assert errors["delay"] > 3 * errors["model"]


def test_a_jump_needs_the_model_that_jumps():
    samples, theta = 2400, truth_of("kienzle", 2400, False, rise=0.0)
    theta[1200:, [0, 2]] += np.log(1.2)
    met = passage(samples)
    force, _ = sampled_force(theta, met, CUTTER, law="kienzle", reference_chip=H0, axes=("x", "y"), nodes=NODES)
    used = np.abs(force).max(axis=1) > 50.0
    mean, covariance = start_of(theta)
    error = {}
    for name, models in (("trends", TRENDS), ("with jumps", [*TRENDS, JUMP])):
        misses = []
        for seed in range(4):
            measured = force + 10 * np.random.default_rng(seed).standard_normal(force.shape)
            got = follow_imm(
                mean,
                covariance,
                met,
                measured,
                used,
                np.array([0, *range(1240, 1320)]),
                CUTTER,
                law="kienzle",
                reference_chip=H0,
                axes=("x", "y"),
                noise=np.full(2, 10.0),
                models=models,
                nodes=NODES,
            )
            misses.append(got.mean[1:, 0] - theta[1201, 0])
        error[name] = np.sqrt(np.mean(np.square(misses)))
    assert error["with jumps"] < 0.7 * error["trends"]


def test_models_of_no_kind_are_matrices_of_rest():
    rest, trend = transitions(motions_of([Motion(), Motion(0.1, 0.2)], 6), 8)
    assert np.array_equal(np.diag(rest.transition), [1, 1, 1, 1, 1, 1, 0, 0])
    assert not rest.noise.any()
    assert trend.transition[0, 6] == trend.transition[2, 7] == 1.0
    assert trend.noise[0, 0] == pytest.approx(0.1**2 + 0.2**2 / 3)


@pytest.mark.parametrize("noise", [5.0, 0.5])
@pytest.mark.parametrize("off", [-1, 1])
def test_a_start_far_off_is_left_behind_even_where_the_sensor_is_quiet(noise, off):
    """All parameters one standard deviation off, runout too, of which the force is no smooth function."""
    met = Passage(2 * np.pi / 234 * np.arange(2340), 1e-4, 2e-3, 1.98, np.pi, 0.2)
    theta = np.array([21.7, 0.2, 20.9, 0.5, 6e-6, -4e-6])
    force, _ = sampled_force(theta, met, CUTTER, law="kienzle", reference_chip=H0, axes=("x", "y"), nodes=12)
    used = np.abs(force).max(axis=1) > 20.0
    deviation = np.array([0.5, 0.15, 0.6, 0.15, 1e-5, 1e-5])
    got = follow_imm(
        theta + off * deviation * [1, 1, 1, -1, 1, -1],
        np.diag(deviation**2),
        met,
        force + noise * np.random.default_rng(1).standard_normal(force.shape),
        used,
        np.array([0, 1170, 2340]),
        CUTTER,
        law="kienzle",
        reference_chip=H0,
        axes=("x", "y"),
        noise=np.full(2, noise),
    )
    error = (got.mean[-1] - theta) / np.sqrt(np.diag(got.covariance[-1]))
    assert np.abs(error).max() < 4
    assert got.innovation_square[-1] == pytest.approx(np.ones(2), abs=0.2)
    assert got.probability[-1].argmax() == 0


def test_a_short_cut_has_the_models_of_a_short_cut():
    models, stay = bank(800)
    assert [model.drift for model in models] == pytest.approx([model.drift for model in TRENDS])
    assert stay == STAY
    longer, stays = bank(300_000, jumps=True)
    assert longer[0] == Motion()
    assert longer[-1] == JUMP
    drifts = np.array([model.drift for model in longer[1:-1]])
    assert np.all(drifts[1:] / drifts[:-1] <= 100 * (1 + 1e-9))
    assert STAY < stays < 1


@pytest.mark.parametrize("change", ["rest", "wear"])
def test_a_long_cut_is_followed_better_by_models_of_its_own(change):
    """Twelve seconds at 10 kHz; likelihood and error agree about which bank is right."""
    samples = 120_000
    time = np.linspace(0, 1, samples)
    met = passage(samples)
    theta = truth_of("kienzle", samples, False, rise=0.0)
    theta[:, [0, 2]] += 0.15 * (1 - np.exp(-time / 0.3))[:, np.newaxis] if change == "wear" else 0.0
    force, _ = sampled_force(theta, met, CUTTER, law="kienzle", reference_chip=H0, axes=("x", "y"), nodes=NODES)
    used = np.abs(force).max(axis=1) > 50.0
    measured = force + 40 * np.random.default_rng(2).standard_normal(force.shape)
    edges = np.arange(0, samples + 1, 1200)
    mean, covariance = start_of(theta)
    errors, evidence = [], []
    for models, stay in (bank(int(used.sum()), jumps=True), (TRENDS, STAY)):
        got = follow_imm(
            mean,
            covariance,
            met,
            measured,
            used,
            edges,
            CUTTER,
            law="kienzle",
            reference_chip=H0,
            axes=("x", "y"),
            noise=np.full(2, 40.0),
            models=models,
            stay=stay,
            nodes=NODES,
        )
        misses = (got.mean - theta[edges[1:] - 1])[20:, [0, 2]]
        errors.append(np.sqrt(np.mean(misses**2)))
        evidence.append(got.log_likelihood)
        assert np.mean(np.abs(misses) < 1.96 * np.sqrt(got.covariance[20:, [0, 2], [0, 2]])) > 0.85
    assert evidence[0] > evidence[1] + 10
    assert errors[0] < (0.7 if change == "rest" else 0.95) * errors[1]


def test_the_bank_does_not_depend_on_the_rate_of_sampling():
    """Four times the samples with twice the noise tell as much: the same intervals, and about the same estimates."""
    found = []
    for finer in (1, 4):
        samples = 4800 * finer
        met = passage(samples, revolution=117 * finer)
        theta = truth_of("kienzle", samples, False)
        force, _ = sampled_force(theta, met, CUTTER, law="kienzle", reference_chip=H0, axes=("x", "y"), nodes=NODES)
        used = np.abs(force).max(axis=1) > 50.0
        noise = 20.0 * finer**0.5
        models, stay = bank(int(used.sum()), pace=1 / finer, jumps=True)
        mean, covariance = start_of(theta)
        got = follow_imm(
            mean,
            covariance,
            met,
            force + noise * np.random.default_rng(finer).standard_normal(force.shape),
            used,
            np.linspace(0, samples, 11).astype(int),
            CUTTER,
            law="kienzle",
            reference_chip=H0,
            axes=("x", "y"),
            noise=np.full(2, noise),
            models=models,
            stay=stay,
            rate=1e-4 / finer,
            nodes=NODES,
        )
        found.append((got.mean[2:, [0, 2]], np.sqrt(got.covariance[2:, [0, 2], [0, 2]])))
    (mean, sd), (fine_mean, fine_sd) = found
    assert np.median(fine_sd / sd) == pytest.approx(1.0, abs=0.15)
    assert np.abs(fine_mean - mean).max() < 4 * np.hypot(sd, fine_sd).max()
