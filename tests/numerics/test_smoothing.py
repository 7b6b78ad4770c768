"""The iterated smoother against slow ways to the same answers, on a small law with two directions and a constant.

Direction d at a step with chip h shows exp(level_d - shape_d ln h), of some thirty times the noise; the constant makes every
other step a little larger.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from millcal.numerics import smoothing, trend_fit
from millcal.numerics.smoothing import averaged, draw_deviations, smooth
from millcal.numerics.state_space import Observed, filter_states, smooth_states
from millcal.numerics.trend_fit import Problem, blocks_of, fit_at, likeliest, linearised, usual_scales
from millcal.numerics.trend_jumps import find_jumps, jump_sizes
from millcal.numerics.trend_models import MODELS, Layout, layout_of

MEAN = np.array([3.4, 0.2, 3.0, 0.5, 0.0])
COVARIANCE = np.diag([0.3, 0.1, 0.3, 0.1, 1.0]) ** 2
LAYOUT = layout_of(2)
TRUE = np.array([3.5, 0.25, 3.1, 0.45, 0.5])

every_model = pytest.mark.parametrize("name", MODELS)


def model_of(name, layout: Layout = LAYOUT):
    return MODELS[name](MEAN, COVARIANCE, layout)


def law(steps, seed=0):
    log_chip = np.random.default_rng([seed, 7]).uniform(-1.2, 0.4, steps)
    beat = 0.02 * (-1.0) ** np.arange(steps)

    def predict(p):
        size = 1 + p[:, 4] * beat
        seen = np.stack([np.exp(p[:, 2 * d] - p[:, 2 * d + 1] * log_chip) for d in range(2)], axis=1)
        slopes = np.zeros((steps, 2, 5))
        for d in range(2):
            slopes[:, d, 2 * d] = seen[:, d] * size
            slopes[:, d, 2 * d + 1] = -seen[:, d] * size * log_chip
            slopes[:, d, 4] = seen[:, d] * beat
        return seen * size[:, np.newaxis], slopes

    return predict


def record(truth, seed=0, block=1, noise=1.0):
    """truth : (step, 5)"""
    steps = len(truth)
    predict = law(steps, seed)
    measured = predict(truth)[0] + noise * np.random.default_rng(seed).standard_normal((steps, 2))
    time = (np.arange(steps) + 1.0) / steps
    return Problem(measured, predict, time, blocks_of(time, block))


def drifting(steps, *, change=lambda t: 0.2 * t, shapes=0.0):
    """All levels move alike, and the shapes so many times as much."""
    moved = change(np.arange(steps) / steps)
    return TRUE + np.outer(moved, [1, shapes, 1, shapes, 0])


def transitions(model, scales, seen, steps):
    """F and the root of Q of each step, by the definition."""
    n = len(model.dynamics.start)
    level_of = {speed: level for level, speed in model.dynamics.speeds}
    for k in range(steps):
        dt = seen.interval[k]
        F, Q = np.eye(n), np.diag(seen.shock[k])
        for speed, level in level_of.items():
            F[level, speed] = dt
        for state, scale in zip(model.dynamics.noisy, scales[model.scale_of], strict=True):
            if state in level_of:
                pair = np.ix_([level_of[state], state], [level_of[state], state])
                Q[pair] += scale**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            else:
                Q[state, state] += scale**2 * dt
        if k == 0:
            Q = Q + F @ model.dynamics.start_covariance @ F.T
        values, vectors = np.linalg.eigh(Q)
        yield F, vectors * np.sqrt(np.maximum(values, 0.0))


# ---- one fit


@every_model
@pytest.mark.parametrize("block", [1, 3])
def test_the_fit_is_the_least_penalised_squares(name, block, monkeypatch):
    """Against a general minimiser that moves every disturbance by itself."""
    monkeypatch.setattr(trend_fit, "CONVERGED", 1e-11)
    problem, model, scales = record(drifting(12), block=block), model_of(name), usual_scales(model_of(name))
    jumps = (2,)
    fit = fit_at(problem, model, scales, jumps)
    steps, n = fit.state.shape
    moves = list(transitions(model, scales, fit.seen, steps))

    def trajectory(u):
        x, states = model.dynamics.start, []
        for (F, root), kick in zip(moves, u.reshape(steps, n), strict=True):
            x = F @ x + root @ kick
            states.append(x)
        return np.array(states)

    def left(u):
        p = model.parameters(trajectory(u))[problem.block]
        return np.concatenate([(problem.measured - problem.predict(p)[0]).ravel(), u])

    found = least_squares(left, np.zeros(steps * n), xtol=1e-12, ftol=1e-12, gtol=1e-10)
    assert model.parameters(fit.state) == pytest.approx(model.parameters(trajectory(found.x)), abs=1e-5)
    assert fit.converged


@every_model
def test_a_converged_fit_is_within_its_tolerance_of_the_fixed_point(name, monkeypatch):
    problem, model = record(drifting(60)), model_of(name)
    fit = fit_at(problem, model, usual_scales(model))
    monkeypatch.setattr(trend_fit, "CONVERGED", 1e-10)
    exact = fit_at(problem, model, usual_scales(model))
    sd = np.sqrt(np.max(np.diag(averaged(fit)[1][30])))
    assert np.abs(model.parameters(fit.state) - model.parameters(exact.state)).max() < min(1e-3, 0.05 * sd)
    assert fit.log_likelihood == pytest.approx(exact.log_likelihood, abs=0.01)


@every_model
def test_the_fit_does_not_depend_on_where_it_begins(name):
    problem, model = record(drifting(60)), model_of(name)
    plain = fit_at(problem, model, usual_scales(model))
    far = np.tile(model.begin(TRUE + np.array([1.2, -0.3, -1.0, 0.4, 2.0])), (60, 1))
    again = fit_at(problem, model, usual_scales(model), start=far)
    assert plain.converged
    assert again.converged
    assert model.parameters(again.state) == pytest.approx(model.parameters(plain.state), abs=3e-3)


def test_no_pass_moves_a_parameter_farther_than_it_may():
    problem, model = record(drifting(40)), model_of("independent")
    seen_at = []

    def predict(p):
        seen_at.append(p.copy())
        return problem.predict(p)

    start = np.tile(model.begin(TRUE + np.array([2.0, 0, 2.0, 0, 0])), (40, 1))
    fit_at(
        problem._replace(predict=predict),
        model._replace(limits=np.array([0.1, 0.05, 0.1, 0.05, 9.0])),
        usual_scales(model),
        start=start,
    )
    moved = np.abs(np.diff(np.array(seen_at), axis=0)).max(axis=(0, 1))
    assert np.all(moved[:4] <= [0.1 + 1e-9, 0.05 + 1e-9] * 2)


def test_a_step_to_where_the_model_has_no_value_is_not_taken():
    problem, model = record(drifting(40)), model_of("independent")

    def predict(p):
        seen, slopes = problem.predict(p)
        return np.where(p[:, :1] > 3.75, np.nan, seen), slopes

    start = np.tile(model.begin(TRUE + np.array([-0.9, 0, -0.9, 0, 0])), (40, 1))
    bold = model._replace(limits=np.full(5, np.inf))
    fit = fit_at(problem._replace(predict=predict), bold, usual_scales(model), start=start)
    assert np.all(np.isfinite(fit.state))
    plain = fit_at(problem, model, usual_scales(model))
    assert model.parameters(fit.state) == pytest.approx(model.parameters(plain.state), abs=0.01)


def test_a_fit_that_runs_out_of_passes_says_so(monkeypatch):
    monkeypatch.setattr(trend_fit, "PASSES", 1)
    assert not fit_at(record(drifting(40)), model_of("shared"), np.array([1.0])).converged


@every_model
def test_the_linearised_record_is_exact_for_a_linear_law(name):
    """Its value does not depend on where it was linearised, where parameters are linear in the states."""
    problem, model = record(drifting(20)), model_of(name)
    slopes = problem.predict(np.tile(TRUE, (20, 1)))[1]
    flat = problem._replace(predict=lambda p: (np.einsum("saP,sP->sa", slopes, p), slopes))
    here, there = (np.tile(model.begin(p), (20, 1)) for p in (MEAN, TRUE))
    (one, left), (two, _) = linearised(flat, model, here), linearised(flat, model, there)
    assert one.value == pytest.approx(two.value)
    assert one.matrix == pytest.approx(two.matrix)
    assert left == pytest.approx(np.sum((problem.measured - np.einsum("saP,P->sa", slopes, MEAN)) ** 2))


# ---- blocks


def test_blocks_are_no_longer_than_asked_and_end_at_breaks():
    breaks = np.zeros(50, bool)
    breaks[[13, 14, 30]] = True
    block = blocks_of(np.arange(50.0), 7, breaks)
    assert np.all(np.isin(np.diff(block), [0, 1]))
    assert np.bincount(block).max() == 7
    assert np.all(np.diff(block)[np.flatnonzero(breaks) - 1] == 1)
    assert np.bincount(block).tolist() == [7, 6, 1, 7, 7, 2, 7, 7, 6]


def test_blocks_of_one_step_are_the_steps():
    assert np.array_equal(blocks_of(np.arange(9.0), 1), np.arange(9))


@every_model
@pytest.mark.parametrize("block", [2, 5, 40])
def test_compressed_blocks_say_what_all_their_observations_say(name, block):
    """Blocks of fewer observations than parameters, of more, and all in one; the last one shorter."""
    steps = 43
    problem, model = record(drifting(steps), block=block), model_of(name)
    blocks = int(problem.block[-1]) + 1
    state = np.tile(model.begin(TRUE), (blocks, 1)) + 0.01 * np.arange(blocks)[:, np.newaxis]
    compressed, _ = linearised(problem, model, state)
    p = model.parameters(state)[problem.block]
    predicted, slopes = problem.predict(p)
    rows = slopes @ model.slopes(state)[problem.block]
    values = problem.measured - predicted + np.einsum("san,sn->sa", rows, state[problem.block])
    matrix, value = np.zeros((blocks, 2 * block, state.shape[1])), np.zeros((blocks, 2 * block))
    for b in range(blocks):
        of = problem.block == b
        matrix[b, : 2 * of.sum()] = rows[of].reshape(-1, state.shape[1])
        value[b, : 2 * of.sum()] = values[of].ravel()
    plain = Observed(matrix, value, compressed.interval, compressed.shock)
    scales = usual_scales(model)[model.scale_of]
    passes = [filter_states(model.dynamics, scales, seen) for seen in (compressed, plain)]
    assert passes[0].log_likelihood == pytest.approx(passes[1].log_likelihood, rel=1e-10)
    smoothed = [
        smooth_states(model.dynamics, scales, seen, done)
        for seen, done in zip((compressed, plain), passes, strict=True)
    ]
    assert smoothed[0].mean == pytest.approx(smoothed[1].mean, abs=1e-8)
    assert smoothed[0].covariance == pytest.approx(smoothed[1].covariance, abs=1e-8)
    assert smoothed[0].score == pytest.approx(smoothed[1].score, abs=1e-7)


def test_time_runs_from_the_start_of_the_record_to_the_middle_of_its_blocks():
    problem = record(drifting(10), block=4)
    seen, _ = linearised(problem, model_of("shared"), np.tile(model_of("shared").begin(TRUE), (3, 1)))
    assert np.cumsum(seen.interval) == pytest.approx([0.25, 0.65, 0.95])


@every_model
def test_in_the_end_blocks_leave_no_trace(name):
    truth = drifting(160, change=lambda t: 0.2 * np.cos(2 * np.pi * t))
    by_blocks, by_steps = (smooth(record(truth), [model_of(name)], block=block) for block in (8, 1))
    sd = np.sqrt(np.einsum("spp->sp", by_steps.covariance))
    assert np.all(np.abs(by_blocks.mean - by_steps.mean) < 0.2 * sd)
    assert np.sqrt(np.einsum("spp->sp", by_blocks.covariance)) == pytest.approx(sd, rel=0.15)


# ---- scales


@every_model
def test_the_likeliest_scales_are_a_maximum(name):
    problem, model = record(drifting(200, change=lambda t: 0.3 * np.sin(9 * t))), model_of(name)
    fit = likeliest(fit_at(problem, model, usual_scales(model)), rounds=4)
    for index in range(len(fit.scales)):
        for factor in (0.7, 1.4):
            scales = fit.scales.copy()
            scales[index] *= factor
            if not -0.01 < (np.log10(scales[index]) - model.box[index, 0]) / np.ptp(model.box[index]) < 1.01:
                continue
            near = filter_states(model.dynamics, scales[model.scale_of], fit.seen)
            assert near.log_likelihood < fit.log_likelihood + 0.05


def test_the_scale_of_a_trend_comes_back_from_trends_of_known_scale():
    """The median of many, for which the true states are drawn."""
    found = []
    for seed in range(15):
        rng = np.random.default_rng([seed, 5])
        speed = 10 * np.cumsum(rng.standard_normal(300)) / np.sqrt(300)
        truth = drifting(300, change=lambda t, speed=speed: np.cumsum(speed) / 300)
        model = model_of("shared")
        found.append(likeliest(fit_at(record(truth, seed), model, usual_scales(model))).scales[0])
    assert np.median(found) == pytest.approx(10, rel=0.3)


@every_model
def test_an_average_over_one_scale_is_the_smoother(name):
    problem, model = record(drifting(50)), model_of(name)
    scales = usual_scales(model)
    fit = fit_at(problem, model, scales)
    single = model._replace(groups=tuple(tuple((i, scales[i : i + 1]) for i, _ in group) for group in model.groups))
    mean, covariance = averaged(replace(fit, model=single))
    plain = smooth_states(model.dynamics, scales[model.scale_of], fit.seen, fit.filtered)
    G = model.slopes(plain.mean)
    assert mean == pytest.approx(model.parameters(plain.mean), abs=1e-10)
    assert covariance == pytest.approx(G @ plain.covariance @ G.transpose(0, 2, 1), abs=1e-12)


def test_groups_that_do_not_meet_average_as_all_scales_together():
    """Two directions without the constant: the weights of a grid over all scales are products."""
    problem = record(drifting(30))
    model = MODELS["independent"](MEAN, COVARIANCE * np.diag([1, 1, 1, 1, 0]), LAYOUT)
    grids = (np.array([0.1, 1.0, 8.0]), np.array([0.01, 0.1]))
    of_each = tuple(tuple((index, grids[i]) for i, (index, _) in enumerate(group)) for group in model.groups)
    together = (tuple(pair for group in of_each for pair in group),)
    fit = fit_at(problem, model, usual_scales(model))
    (mean, covariance), (mean_too, covariance_too) = (
        averaged(replace(fit, model=model._replace(groups=groups))) for groups in (of_each, together)
    )
    assert mean == pytest.approx(mean_too, abs=1e-6)
    of_levels = np.ix_(range(30), [0, 1], [0, 1])
    assert covariance[of_levels] == pytest.approx(covariance_too[of_levels], abs=1e-6)


def test_a_covariance_averaged_over_scales_of_directions_that_meet_stays_one():
    """The constant is seen by both directions, so that what each group takes away of its variance is counted twice."""
    for seed in range(10):
        model = model_of("independent")
        fit = likeliest(fit_at(record(drifting(60), seed), model, usual_scales(model)))
        assert np.linalg.eigvalsh(averaged(fit)[1]).min() > 0


# ---- what intervals promise


def drawn_from(model, scales, steps, seed):
    """A trajectory of the model itself.   returns (step, parameter)"""
    blank = np.zeros((steps, len(model.dynamics.start)))
    seen = Observed(blank[:, np.newaxis], blank[:, :1], np.full(steps, 1 / steps), blank)
    rng, x, states = np.random.default_rng([seed, 11]), model.dynamics.start, []
    for F, root in transitions(model, scales, seen, steps):
        x = F @ x + root @ rng.standard_normal(len(x))
        states.append(x)
    return model.parameters(np.array(states))


@every_model
def test_intervals_cover_nine_tenths_of_trajectories_drawn_from_the_model(name):
    """Scales unknown: found, and averaged over."""
    model = model_of(name)
    scales = usual_scales(model, 1.0, 0.05)
    inside = []
    for seed in range(60):
        truth = drawn_from(model, scales, 80, seed)
        fit = likeliest(fit_at(record(truth, seed), model, usual_scales(model)))
        mean, covariance = averaged(fit)
        inside.append(np.abs(mean - truth) < 1.645 * np.sqrt(np.einsum("spp->sp", covariance)))
    cover = np.mean(inside, axis=(0, 1))
    assert np.all(cover > 0.80), cover
    assert 0.86 < np.mean(cover[:4]) < 0.96, cover


@every_model
def test_drawn_deviations_spread_as_the_smoother_says(name):
    problem, model = record(drifting(25)), model_of(name)
    fit = fit_at(problem, model, usual_scales(model), (10,))
    states, shocks = draw_deviations(fit, np.random.default_rng(0), 4000)
    plain = smooth_states(model.dynamics, fit.scales[model.scale_of], fit.seen, fit.filtered)
    drawn = np.einsum("ikm,ikn->kmn", states, states) / len(states)
    sd = np.sqrt(np.einsum("knn->kn", plain.covariance))
    scale = np.maximum(sd[:, :, np.newaxis] * sd[:, np.newaxis], 1e-12)
    rate = np.sqrt(2 / len(states))
    assert np.abs((drawn - plain.covariance) / scale).max() < 5 * rate
    assert np.abs(states.mean(axis=0) / np.maximum(sd, 1e-9)).max() < 5 * rate

    D = np.diag(model.shock)
    left = np.diag(D - D @ fit.smoothed.N[10] @ D)
    assert np.var(shocks[:, 0], axis=0) == pytest.approx(left, rel=5 * rate, abs=1e-12)


# ---- jumps


def stepped(*jumps, steps=160):
    """Levels that jump.   jumps : (place, size)"""
    return drifting(steps, change=lambda t: sum(size * (np.arange(steps) >= at) for at, size in jumps))


@every_model
def test_a_jump_is_found_where_it_is_and_as_large_as_it_is(name):
    found = smooth(record(stepped((93, 0.2))), [model_of(name)], block=8)
    ((at, change, covariance, factor),) = jump_sizes(found.fit)
    assert abs(at - 93) <= 1
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(change[[0, 2]] - 0.2) < 3 * sd[[0, 2]])
    assert np.all(sd[[0, 2]] < 0.05)
    assert factor > 20
    assert change[4] == 0


def test_the_factor_of_a_jump_is_the_evidence_lost_without_it():
    problem, model = record(stepped((93, 0.2))), model_of("independent")
    fit = fit_at(problem, model, usual_scales(model), (93,))
    without = fit_at(problem, model, usual_scales(model))
    ((_, _, _, factor),) = jump_sizes(fit)
    assert factor == pytest.approx(fit.log_likelihood - without.log_likelihood, abs=0.02)


@every_model
@pytest.mark.parametrize("places", [(60, 76), (40, 80, 120)])
def test_jumps_that_undo_each_other_are_all_found(name, places):
    truth = stepped(*((at, 0.2 * (-1) ** i) for i, at in enumerate(places)))
    found = smooth(record(truth), [model_of(name)], block=8).fit.jumps
    assert len(found) == len(places)
    assert np.all(np.abs(np.subtract(found, places)) <= 2)


@every_model
def test_smooth_records_have_no_jumps(name):
    """At most one in twenty by chance."""
    false = 0
    for seed in range(20):
        problem, model = record(drifting(160, change=lambda t: 0.2 * np.sin(4 * t)), seed, block=8), model_of(name)
        false += len(find_jumps(likeliest(fit_at(problem, model, usual_scales(model)))).jumps)
    assert false <= 1


@every_model
@pytest.mark.parametrize("at", [1, 2, 158])
def test_a_jump_near_an_end_is_no_trouble_and_none_stands_before_the_first_step(name, at):
    found = smooth(record(stepped((at, 0.5))), [model_of(name)], block=4)
    assert all(jump > 0 for jump in found.fit.jumps)
    assert np.all(np.isfinite(found.mean))


def test_a_jump_of_a_long_record_comes_to_its_step_without_all_steps():
    """Blocks of a step stand only about the jump."""
    found = smooth(record(stepped((301, 0.3), steps=800)), [model_of("shared")], block=16, finest=100)
    block = found.fit.problem.block
    (at,) = found.fit.jumps
    assert abs(int(np.flatnonzero(block == at)[0]) - 301) <= 1
    assert block[-1] + 1 < 400
    assert found.mean.shape == (800, 5)
    level = found.mean[:, 0]
    assert level[330] - level[270] == pytest.approx(0.3, abs=0.05)


def test_a_law_that_does_not_hold_opens_no_more_blocks_than_may_hide_a_jump():
    """Every other block sees a beat that the law does not know."""
    problem = record(drifting(800), block=8)
    problem.measured[problem.block % 2 == 0] *= 1 + 0.3 * (-1.0) ** np.arange(400)[:, np.newaxis]
    found = smooth(problem, [model_of("shared")], block=8, finest=100)
    assert found.alternatives["shared"].problem.block[-1] + 1 <= 100 + 16 * 7


def test_without_jumps_none_is_looked_for():
    assert smooth(record(stepped((93, 0.2))), [model_of("shared")], jumps=False).fit.jumps == ()


# ---- models


def test_the_model_that_is_true_is_chosen():
    models = [model_of(name) for name in MODELS]
    alike = drifting(160, change=lambda t: 0.3 * np.cos(2 * np.pi * t))
    apart = alike.copy()
    apart[:, 2] = TRUE[2] + 0.3 * np.arange(160) / 160
    for truth, chosen in ((alike, "shared"), (apart, "independent")):
        for seed in range(5):
            found = smooth(record(truth, seed), models, block=8)
            assert found.fit.model.name == chosen
            assert found.evidence[chosen] == max(found.evidence.values())
            assert set(found.alternatives) == set(MODELS)


@pytest.mark.parametrize("lead", [2.0, 4.0])
def test_a_stiffer_model_must_be_decisively_better(lead, monkeypatch):
    problem, models = record(drifting(80)), [model_of(name) for name in MODELS]
    usual = smooth(problem, models, block=8)
    behind = usual.evidence["shared"] - usual.evidence["independent"]
    monkeypatch.setattr(smoothing, "DECISIVE", behind + 3.0 - lead)
    assert smooth(problem, models, block=8).fit.model.name == ("shared" if lead > 3.0 else "independent")


def test_what_is_told_grows_to_the_end():
    told = []
    smooth(
        record(drifting(80)), [model_of(name) for name in MODELS], block=8, tell=lambda share, what: told.append(share)
    )
    assert told == sorted(told)
    assert 0 <= told[0] <= told[-1] <= 1
