"""A minute of a cut at 10 kHz, with runout, through every method that follows coefficients: CPU time against real time."""

import time

import numpy as np
from measure import spread, table

from millcal.data import CutSamples
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.follow_ensemble import follow_ensemble
from millcal.physics.follow_imm import bank, follow_imm
from millcal.physics.follow_rls import follow_rls
from millcal.physics.measuring_chain import discrete_butterworth
from millcal.physics.sampled_force import Passage, mean_chip, parameters_of, sampled_force
from millcal.stages.coefficients.trends import follow_coefficients

SECONDS, RATE = 60, 10e3
NODES = 12
CUTTER = Cutter(diameter=12e-3, teeth=2, helix=np.radians(30))
CONDITIONS = CuttingConditions(
    spindle_speed=2 * np.pi * 39.7, feed_per_tooth=0.08e-3, axial_depth=3e-3, radial_depth=4e-3, direction="down"
)
CHIP = 48e-6
TRUTH = parameters_of(np.array([1500e6, 420e6, 240e6, 0.21, 0.46, 0.34]), "kienzle", CHIP)
NOISE = 8.0  # N
LOWPASS = 600.0  # Hz


def a_cut(seed):
    """Passage, parameters, force with a wear of a fifth and white noise, and the samples that cut."""
    rng = np.random.default_rng(seed)
    count = int(SECONDS * RATE)
    angle = CONDITIONS.spindle_speed * np.arange(count) / RATE
    entry, leave = engagement(CONDITIONS, CUTTER.diameter)
    passage = Passage(angle, *(np.full(count, v) for v in (0.08e-3, 3e-3, entry, leave, 0.0)))
    parameters = np.tile(np.concatenate([TRUTH, [4e-6, 6.9e-6]]), (count, 1))
    parameters[:, [0, 2, 4]] += np.log1p(0.2 * np.arange(count) / count)[:, np.newaxis]
    force, _ = sampled_force(parameters, passage, CUTTER, law="kienzle", reference_chip=CHIP, nodes=NODES)
    used = mean_chip(passage, CUTTER, (4e-6, 6.9e-6)) > 0.5e-6
    return passage, parameters, force, force + NOISE * rng.standard_normal(force.shape), used


def timed(work, repeats):
    found, costs = work(), []  # the first call compiles
    for _ in range(repeats):
        start = time.process_time()
        found = work()
        costs.append(time.process_time() - start)
    return costs, found


def followed_cut(options) -> str:
    """60 s at 10 kHz, two teeth, runout unknown, three axes, 12 Gauss nodes on each edge in contact; one thread."""
    from scipy.signal import lfilter

    passage, truth, clean, noisy, used = a_cut(0)
    chain = discrete_butterworth(LOWPASS, 2, RATE)
    edges = np.linspace(0, len(used), 1001).astype(int)
    mean = np.concatenate([TRUTH + np.tile([0.2, 0.05], 3), [0.0, 0.0]])
    spread0 = np.diag([0.3, 0.1] * 3 + [20e-6, 20e-6]) ** 2
    models, stay = bank(int(used.sum()))
    common = {"law": "kienzle", "reference_chip": CHIP, "axes": ("x", "y", "z"), "nodes": NODES}

    def ensemble(force, lowpass):
        rng = np.random.default_rng(1)
        members = rng.multivariate_normal(mean, spread0, 50)
        return follow_ensemble(
            members, passage, force, used, edges, CUTTER, noise=NOISE**2 * np.eye(3), rng=rng, lowpass=lowpass, **common
        )

    def interacting(force, lowpass):
        return follow_imm(
            mean, spread0, passage, force, used, edges, CUTTER,
            noise=np.full(3, NOISE), models=models, stay=stay, lowpass=lowpass, **common,
        )  # fmt: skip

    def least_squares(force, lowpass):
        return follow_rls(
            mean, spread0, passage, force, used, edges, CUTTER, noise=np.full(3, NOISE), lowpass=lowpass, **common
        )

    smoothed = lfilter(*chain, clean, axis=0) + noisy - clean
    level = truth[edges[1:] - 1, 0]
    rows = []
    for name, follow in (("EnKF, 50 members", ensemble), ("IMM", interacting), ("RLS", least_squares)):
        for what, force, lowpass in (("", noisy, None), (", low-pass in the model", smoothed, chain)):
            costs, found = timed(lambda f=follow, y=force, c=lowpass: f(y, c), options.repeats)
            off = np.sqrt(np.mean((found.mean[len(level) // 2 :, 0] - level[len(level) // 2 :]) ** 2))
            rows.append((name + what, spread(costs, ".2f"), f"{SECONDS / np.median(costs):.0f}", f"{off:.2%}"))
    costs, found = timed(lambda: whole(passage, noisy), 1)
    true_level = np.interp(found.time, np.arange(len(used)) / RATE, truth[:, 0] - TRUTH[0])
    force_at = np.log(found.specific_force[:, 0]) - TRUTH[0] - TRUTH[1] * np.log(CHIP / found.reference_chip)
    off = np.sqrt(np.mean((force_at - true_level) ** 2))
    rows.append(("smooth, the whole stage", spread(costs, ".1f"), f"{SECONDS / np.median(costs):.1f}", f"{off:.2%}"))
    head = ("method", "CPU s", "times real time", "tangential force at 48 um, rms error")
    said = f"{int(used.sum())} of {len(used)} samples cut; the errors of the filters are those of the second half; the plain "
    said += "ensemble has collapsed by then, as it must where coefficients change, and stands here for its time."
    return "\n\n".join([table(head, *rows), said])


def whole(passage, force):
    """The stage from samples to history, with half a second of air before."""
    rng = np.random.default_rng(2)
    samples = CutSamples(
        name="minute.h5",
        cutter=CUTTER,
        conditions=CONDITIONS,
        force=force.T,
        axes=("x", "y", "z"),
        angle=passage.angle,
        angle_from="speed",
        feed_per_tooth=passage.feed_per_tooth,
        axial_depth=passage.axial_depth,
        entry=passage.entry,
        leave=passage.leave,
        feed_direction=passage.feed_direction,
        sample_rate=RATE,
        start=0.0,
        spindle_frequency=39.7,
        air_force=NOISE * rng.standard_normal((3, int(RATE / 2))),
        air_spans=((0, int(RATE / 2)),),
    )
    return follow_coefficients([samples], method="smooth", law="kienzle", nodes=NODES, rng=rng)
