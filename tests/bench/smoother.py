"""The offline smoother: CPU time and error for each simulated case, and for a minute at 10 kHz."""

import sys
import time
from pathlib import Path

import numpy as np
from measure import spread, table

sys.path.insert(0, str(Path(__file__).parents[1] / "generators"))

from changing_cuts import long_cut, models, recorded

from millcal.numerics.smoothing import smooth
from millcal.studies.trending_cuts import CASES

SEEDS = 16
SECONDS = 60
CUTTING_PER_PASS = 56  # samples above the threshold


def timed(work):
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def smoother(options) -> str:
    """Both models of change, scales, jumps and average; 16 seeds of 2340 samples each, 15 dB; CPU time of one thread."""
    smooth(recorded("static", 0).problem, models())
    rows = []
    for case in CASES:
        costs, errors, cover, jumps, names = [], [], [], [], []
        for seed in range(SEEDS):
            record = recorded(case, seed)
            cost, found = timed(lambda record=record: smooth(record.problem, models()))
            error, inside = record.errors(found.mean, found.covariance)
            costs.append(cost)
            errors.append(error)
            cover.append(inside)
            jumps.append(len(found.fit.jumps))
            names.append(found.fit.model.name == "shared")
        force, k, m = np.sqrt(np.mean(np.square(errors), axis=0))
        of_force, of_k, _ = np.mean(cover, axis=0)
        rows.append(
            (
                case,
                spread([1e3 * cost for cost in costs], ".0f"),
                f"{force:.2f}",
                f"{k:.0f}",
                f"{1e3 * m:.1f}",
                f"{of_force:.2f}, {of_k:.2f}",
                f"{np.mean(jumps):.2f}",
                f"{np.mean(names):.2f}",
            )
        )
    head = (
        "case",
        "CPU ms",
        "force, N",
        "k_t, N/mm2",
        "m_t x 1000",
        "covered: force, k_t",
        "jumps",
        "one shared trend",
    )
    meaning = (
        "Force, k_t and m_t: root mean square error over seeds and samples; covered: their share within 90 % intervals."
    )
    return "\n\n".join([table(head, *rows), meaning, a_minute(options.repeats)])


def a_minute(repeats: int) -> str:
    record = long_cut(SECONDS)
    steps = len(record.problem.time)
    start = np.tile(models()[0].dynamics.start[:4], (steps, 1))
    of_force = [timed(lambda: record.problem.predict(start))[0] for _ in range(repeats)]
    runs = [timed(lambda: smooth(record.problem, models(), block=CUTTING_PER_PASS)) for _ in range(repeats)]
    found = runs[-1][1]
    error, _ = record.errors(found.mean, found.covariance)
    places = [int(np.searchsorted(found.fit.problem.block, at)) for at in found.fit.jumps]
    true = int(np.searchsorted(record.problem.time, 0.6))
    return (
        f"{SECONDS} s at 10 kHz, {steps} samples that cut, in blocks of {CUTTING_PER_PASS}: "
        f"{spread([cost for cost, _ in runs], '.1f')} s of CPU, where the force with its slopes takes "
        f"{spread(of_force, '.2f')} s each time it is asked for. Force to {error[0]:.2f} N, k_t to {error[1]:.0f} N/mm2; "
        f"jump at sample {', '.join(map(str, places))}, in truth at {true}."
    )
