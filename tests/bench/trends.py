"""Following coefficients that change: compiled loops over the samples against the plain step of numpy, on the same draws."""

import sys
import time

import numpy as np
from measure import spread, table

from millcal.numerics import ensemble_kalman, interacting_models, recursive_least_squares
from millcal.numerics.interacting_kernel import Motions, transitions
from millcal.physics.disc_filters import follow_ensemble, follow_least_squares, follow_models
from millcal.physics.disc_force import shape, shape_and_slope, shape_tables
from millcal.studies.trending_cuts import BOX, CONDITIONS, DISCS, REFERENCE_CHIP, geometry, simulate_case
from millcal.studies.trending_methods import ensembles, inflation_of

CUT = simulate_case("ascending", 0)
SAMPLES = np.count_nonzero(CUT.active)
DISC_HEIGHT = CONDITIONS.axial_depth / DISCS
INFLATION = inflation_of(50, 10.0)
STARTS = 1000
MOTIONS = Motions(np.array([0, 2]), np.array([4, 5]), np.zeros(3), np.array([0.0, 1e-5, 1e-4]))
CHANCES = interacting_models.switching(3, 0.999)


def in_newtons():
    """Polynomials of the active samples for k in N/mm^2."""
    return CUT.tables._replace(coefficients=1e6 * CUT.tables.coefficients)


def at(tables, sample):
    return tables.of(slice(sample, sample + 1))


def plain_ensemble(force_of, members, rng, inflation, samples=SAMPLES):
    """`ensemble_kalman.step` sample by sample.   force_of : (sample, direction, k, m) -> N"""
    state, means = ensemble_kalman.start(members), np.empty((samples, 4))
    noise = np.diag(CUT.sigma**2)
    for sample in range(samples):

        def observe(X, sample=sample):
            return np.stack([force_of(sample, i, X[:, 2 * i], X[:, 2 * i + 1]) for i in range(2)], axis=1)

        state, _ = ensemble_kalman.step(
            state,
            CUT.active_force[sample],
            observe=observe,
            noise=noise,
            rng=rng,
            limits=BOX,
            inflation=inflation,
        )
        means[sample] = state.members.mean(axis=0)
    return means


def by_discs(samples_chips):
    """The force of all members by the powers of all discs."""

    def force_of(sample, direction, k, m):
        chip = np.broadcast_to(samples_chips[:, :, [sample]], (*samples_chips.shape[:2], len(k)))
        return 1e6 * k * shape(chip, m, DISC_HEIGHT, REFERENCE_CHIP)

    return force_of


def by_polynomials(tables):
    samples = [at(tables, sample) for sample in range(len(tables.coefficients))]
    return lambda sample, direction, k, m: k * shape_and_slope(samples[sample], m[:, None])[0][:, 0]


def plain_least_squares(tables, start):
    state, found = recursive_least_squares.Estimate(start, 10 * np.eye(2)), np.empty((SAMPLES, 2))
    for sample, here in enumerate([at(tables, sample) for sample in range(SAMPLES)]):

        def observe(x, here=here):
            value, slope = shape_and_slope(here, x[1:])
            return x[0] * value, np.array([[value[0], x[0] * slope[0]]])

        state, _ = recursive_least_squares.step(
            state,
            CUT.active_force[sample, :1],
            observe=observe,
            noise=np.eye(1),
            forgetting=0.98,
            limits=BOX[:2],
            projection="clip",
        )
        found[sample] = state.mean
    return found


def plain_models(tables, start):
    state, found = start, np.empty((SAMPLES, 4))
    models = transitions(MOTIONS, 6)
    for sample, here in enumerate([at(tables, sample) for sample in range(SAMPLES)]):

        def observe(x, here=here):
            predicted, slopes = np.empty(2), np.zeros((2, 6))
            for d in range(2):
                value, slope = shape_and_slope(here, x[2 * d + 1 : 2 * d + 2])
                predicted[d], slopes[d, 2 * d + 1] = np.exp(x[2 * d]) * value[0], np.exp(x[2 * d]) * slope[0]
                slopes[d, 2 * d] = predicted[d]
            return predicted, slopes

        state, info = interacting_models.step(
            state,
            CUT.active_force[sample],
            models=models,
            chances=CHANCES,
            observe=observe,
            noise=np.diag(CUT.sigma**2),
        )
        found[sample] = info.mean[:4]
    return found


def timed(work, repeats, times=1):
    """CPU ms of a call over repeats, and what it gave; a first call, which compiles, is not counted."""
    found, costs = work(), []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(times):
            found = work()
        costs.append(1e3 * (time.process_time() - start) / times)
    return costs, found


def filters(options):
    """A row for each way to pass once through the record."""
    tables, members = in_newtons(), ensembles(0, 1)[0]
    place = geometry()
    chips = place.chips[:, :, place.active]
    start = members.mean(axis=0)[:2]
    levels = shape_tables(chips, DISC_HEIGHT, 0.06e-3)
    levels = levels._replace(coefficients=1e6 * levels.coefficients)
    spread_of = np.diag([0.1, 0.03, 0.1, 0.03, 1e-6, 1e-6])
    begin = interacting_models.start(np.array([8.2, 0.4, 7.4, 0.5, 0.0, 0.0]), spread_of, 3)

    def ensemble(inflation):
        return follow_ensemble(
            tables, CUT.active_force, CUT.sigma, members, rng=np.random.default_rng(1), limits=BOX, inflation=inflation
        )

    def least_squares():
        return follow_least_squares(
            tables, CUT.active_force[:, 0], start[None], 10 * np.eye(2), forgetting=0.98, limits=BOX[:2]
        )[0]

    def models():
        return follow_models(levels, CUT.active_force, CUT.sigma, [begin], motions=MOTIONS, chances=CHANCES)[0]

    discs, polynomials = by_discs(chips), by_polynomials(tables)

    def plain(force_of, inflation):
        return lambda: plain_ensemble(force_of, members, np.random.default_rng(1), inflation)

    ways = (  # what, how, work, calls in a repeat
        ("EnKF, 100 members, both directions", "plain step, 46 discs", plain(discs, None), 1),
        ("", "plain step, polynomials", plain(polynomials, None), 1),
        ("", "compiled", lambda: ensemble(None), 20),
        ("the same, inflated every 50", "plain step, polynomials", plain(polynomials, INFLATION), 1),
        ("", "compiled", lambda: ensemble(INFLATION), 20),
        ("RLS with box, one direction", "plain step", lambda: plain_least_squares(tables, start), 1),
        ("", "compiled", least_squares, 50),
        ("IMM of three, both directions", "plain step", lambda: plain_models(levels, begin), 1),
        ("", "compiled", models, 50),
    )
    rows, reference = [], (None, 0.0)
    for what, how, work, times in ways:
        costs, found = timed(work, options.repeats, times)
        if what:
            reference = (found, min(costs))
        apart = np.max(np.abs(found / reference[0] - 1))
        rows.append((what, how, spread(costs), f"{reference[1] / min(costs):.1f}", f"{apart:.0e}"))
    return table(("filter", "way", "CPU ms", "times faster", "largest relative difference"), *rows)


def thousand(options):
    """A thousand initial ensembles in one case and one setting."""
    tables, members = in_newtons(), ensembles(0, STARTS)
    shape_ = (SAMPLES, members.shape[1], 2)
    normals = np.empty(shape_)

    def follow(number, **more):
        return follow_ensemble(
            tables,
            CUT.active_force,
            CUT.sigma,
            members[number],
            rng=np.random.default_rng(number),
            limits=BOX,
            inflation=INFLATION,
            **more,
        )

    np.random.default_rng(0).standard_normal(out=normals)
    polynomials = by_polynomials(tables)
    few = 10
    ways = {
        "plain step, polynomials (ten, times a hundred)": (
            lambda: [plain_ensemble(polynomials, members[n], np.random.default_rng(n), INFLATION) for n in range(few)],
            STARTS / few,
        ),
        "compiled, each with draws of its own": (lambda: [follow(n) for n in range(STARTS)], 1),
        "compiled, draws shared with other settings": (lambda: [follow(n, normals=normals) for n in range(STARTS)], 1),
    }
    rows = []
    for name, (work, times) in ways.items():
        costs, _ = timed(work, 1)
        rows.append((name, f"{1e-3 * costs[0] * times:.1f}"))
    return table(("1000 initial ensembles, inflated every 50", "CPU s"), *rows)


def trends(options) -> str:
    """The record of Schwenzer et al. 2020: 2340 samples, 1120 of them active; least / median of the repeats, one thread."""
    return "\n\n".join([filters(options), thousand(options)])


if __name__ == "__main__":
    from argparse import Namespace

    sys.stdout.write(trends(Namespace(repeats=3)) + "\n")
