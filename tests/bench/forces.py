"""Forces from accelerations: a long cut from samples to coefficients, and the noise-weighted fit beside plainer ones."""

import sys
import time
from pathlib import Path

import numpy as np
from measure import spread, table, take_turns
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[1] / "generators"))

from accelerometer_cuts import LAW, Hits, impact_tests, slot, structure

from millcal.numerics.errors_in_variables import fit_errors_in_variables, parts, residual_covariance
from millcal.physics.cutter import Cutter
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut
from millcal.stages.conditioning.vibration import condition_vibration
from millcal.stages.forces import advise_speeds, reconstruct_forces
from millcal.stages.forces.law import law_of
from millcal.stages.forces.problem import notice_collector, problem_of
from millcal.stages.frf import estimate_frf

SENSORS = ("noseX", "noseY", "noseZ", "headX", "headY", "headZ", "ramX")  # and a pulse: eight channels
RATE, STEADY = 25_600.0, 9.8  # Hz, s
OF = structure(7, natural_frequency=(180.0, 260.0, 390.0), damping_ratio=(0.05, 0.06, 0.04), mass=(30.0, 25.0, 20.0),
               sensors=SENSORS)  # fmt: skip
PASSINGS = (112.0, 141.0, 165.0, 190.0)  # Hz
CUTTER = Cutter(diameter=20e-3, teeth=2, runout=6e-6, runout_angle=0.8)
PLAIN = Cutter(diameter=20e-3, teeth=2)


def recorded(number: int, cutter: Cutter = CUTTER, steady: float = STEADY):
    """A cut at one of the speeds."""
    return simulate_cut(
        LAW, cutter, slot(PASSINGS[number], cutter), rng=np.random.default_rng(number), sample_rate=RATE,
        timeline=Timeline(steady, 0.1, 0.05, 0.05), initial_angle=None, dynamometer=None, modes=OF.modes,
        accelerometers=SENSORS, accelerometer=MeasuringChain(noise=0.5), pulse=True, pulse_angle=0.7,
        name=f"cut-{number}.h5",
    )[0]  # fmt: skip


def timed(work, repeats: int, times: int = 1) -> list[float]:
    """CPU ms of a call over repeats, after one that is not counted."""
    work()
    costs = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(times):
            work()
        costs.append(1e3 * (time.process_time() - start) / times)
    return costs


def one_fit(frf, repeats: int) -> str:
    """The coefficients from the lines of one cut without runout, three ways, with the angle of tooth 0 known."""
    cut = condition_vibration(recorded(0, PLAIN, 1.0))
    problem = problem_of([cut], frf, None, None, False, notice_collector("")[1])
    law = law_of(problem, "fit", False)
    angle = reconstruct_forces([cut], frf, phase="fit", runout="known").phase[0]
    law = law.fixed(np.append(np.zeros(law.sizes[0]), angle))
    slopes = law.basis @ law.combinations
    A, y = parts(problem.matrix @ slopes), parts(problem.measured)
    start = np.linalg.lstsq(A, y, rcond=None)[0]
    scale = np.abs(start)

    def objective(theta):
        covariance = residual_covariance(problem.noise, problem.error, slopes @ theta)
        residual = y - A @ theta
        return float(residual @ np.linalg.solve(covariance, residual))

    def by_fit():
        return fit_errors_in_variables(
            problem.matrix, problem.measured, problem.noise, problem.error, law.values, start
        ).theta

    def by_bfgs():
        return scale * minimize(lambda z: objective(scale * z), start / scale, method="BFGS").x

    ways = (
        ("least squares", lambda: np.linalg.lstsq(A, y, rcond=None)[0], 50),
        ("GTLS with its covariance", by_fit, 10),
        ("its minimum by BFGS with numerical slopes", by_bfgs, 1),
    )
    costs = [timed(work, repeats, times) for _, work, times in ways]
    rows = [
        (name, spread(cost), f"{min(cost) / min(costs[1]):.2g}", f"{objective(work()):.6g}")
        for (name, work, _), cost in zip(ways, costs, strict=True)
    ]
    lines, sensors = problem.measured.shape
    return table((f"one cut, {lines} lines of {sensors} sensors", "CPU ms", "of GTLS", "chi-square"), *rows)


def forces(options) -> str:
    """10 s at 25.6 kHz, seven accelerometers and a pulse, two teeth with runout; CPU time of one thread, least / median."""
    recordings = [recorded(number) for number in range(len(PASSINGS))]
    hits = Hits(
        number=5, peak=1500.0, duration=1e-3, sample_rate=RATE, record=0.4, force_noise=0.5, acceleration_noise=0.3
    )
    frf = estimate_frf(impact_tests(OF, np.random.default_rng(9), hits))
    cuts = [condition_vibration(recording) for recording in recordings]
    speeds = 2 * np.pi * np.array([2000.0, 9000.0]) / 60
    ways = {
        "condition_vibration": lambda: condition_vibration(recordings[0]),
        "reconstruct_forces, runout known": lambda: reconstruct_forces(cuts[:1], frf, runout="known"),
        "reconstruct_forces, runout fitted": lambda: reconstruct_forces(cuts[:1], frf, runout="fit"),
        "the whole: one cut, runout fitted": lambda: reconstruct_forces(
            [condition_vibration(recordings[0])], frf, runout="fit"
        ),
        "reconstruct_forces, 4 cuts, runout known": lambda: reconstruct_forces(cuts, frf, runout="known"),
        "reconstruct_forces, 4 cuts, runout fitted": lambda: reconstruct_forces(cuts, frf, runout="fit"),
        "advise_speeds, 200 speeds": lambda: advise_speeds(
            frf, PLAIN, slot(PASSINGS[0]), spindle_speed=(speeds[0], speeds[1]), points=200
        ),
    }
    rows = [(name, spread(timed(work, options.repeats))) for name, work in ways.items()]
    study = [sys.executable, "-m", "millcal", "study", "forces-from-accelerations", "--quick", "--quiet", "--out"]
    costs = take_turns({"study": [*study, "build/bench-study"]}, min(options.repeats, 3))["study"]
    rows.append(("study forces-from-accelerations --quick", spread([1e3 * cost.cpu for cost in costs])))
    return "\n\n".join([table(("work", "CPU ms"), *rows), one_fit(frf, options.repeats)])
