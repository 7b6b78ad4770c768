"""What a Floquet multiplier and a map cost, beside semi-discretization at its best and as shop scripts do it."""

import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from measure import table

sys.path.append(str(Path(__file__).parents[1] / "generators"))

RPM = 2 * np.pi / 60
MACHINES = {"1": "IS1", "2x1": "ASYM2", "2x2": "UBC22"}  # modes in x and in y
RANGE = {"1": (5000, 20_000), "2x1": (5000, 20_000), "2x2": (3000, 15_000)}  # rpm
IMMERSIONS = (0.05, 0.1, 0.5, 1.0)
STEPS = (40, 60, 80, 120, 160, 240, 320, 480, 640, 960, 1280)
LARGEST = 400  # rows of a matrix of semi-discretization that the bench waits for
POINTS, FEW = 60, 20
SHARE = 0.95  # of the points that must hold the error


def problem(modes: str, immersion: float):
    """Tip, cut of two teeth, down, and the deepest cut that is looked at, m."""
    from stability_cases import cut, machine, oracles

    name = MACHINES[modes]
    this = cut(2, immersion, "down", name)
    deepest = max(
        row["amax_m"]
        for case in oracles()["cases"]
        if (case["modes"], case["a_over_D"], case["N"], case["milling"]) == (name, immersion, 2, "down")
        for row in case["crossings"]
    )
    return machine(name), this, deepest


def random_points(modes, tip, this, deepest, rng):
    """Speeds and depths at which |mu| is .5 to 1.6, and |mu| to 1e-9."""
    from millcal.physics.stability.floquet import spectral_radius

    speed = rng.uniform(*RANGE[modes], 30 * POINTS) * RPM
    depth = deepest * rng.uniform(0.02, 1, len(speed)) ** 1.5
    radius = spectral_radius(speed, depth, tip, this)
    those = np.flatnonzero((radius > 0.5) & (radius < 1.6))[:POINTS]
    return speed[those], depth[those], spectral_radius(speed[those], depth[those], tip, this, tolerance=1e-9)


def seconds(call, least: float = 0.05) -> float:
    """CPU seconds of one call, the best of three times as many as take a while; what takes long is called twice in all."""
    call()
    best = np.inf
    for _ in range(3):
        count, start = 0, time.process_time()
        while time.process_time() - start < least:
            call()
            count += 1
        best = min(best, (time.process_time() - start) / count)
        if best > 0.3:
            break
    return best


def semi_discretized(tip, this, speed, depth, known) -> list[tuple[int, float, float]]:
    """What each number of steps reaches, as far as there is time.   returns steps, error of |mu|, CPU s a point"""
    from semi_discretization import StructuredSemiDiscretization

    reached = []
    for steps in STEPS:
        slow = StructuredSemiDiscretization(tip, this, steps)
        if len(slow.matrix(speed[0], depth[0])) > LARGEST:
            break
        errors = np.array([abs(slow.radius(*point) - mu) for *point, mu in zip(speed, depth, known, strict=True)])
        off = np.sort(errors)[int(np.ceil(SHARE * len(errors))) - 1]
        cost = median(seconds(partial(slow.radius, speed[i], depth[i]), 0.005) for i in range(3))
        reached.append((steps, off, cost))
        if off <= 1e-4:
            break
    return reached


def least_order(tip, this, speed, depth, known, tolerance):
    """The least order that holds nearly all points."""
    from millcal.physics.stability.floquet import spectral_radius

    for order in range(3, 120):
        if np.mean(np.abs(spectral_radius(speed, depth, tip, this, order=order) - known) <= tolerance) >= SHARE:
            return order
    raise RuntimeError(f"no order holds {tolerance}")


def cost_of_points() -> str:
    """One row for every number of modes and immersion."""
    from millcal.physics.stability.floquet import multipliers, radius_map, spectral_radius

    rows, ratios = [], []
    for modes in MACHINES:
        for immersion in IMMERSIONS:
            tip, this, deepest = problem(modes, immersion)
            speed, depth, known = random_points(modes, tip, this, deepest, np.random.default_rng(6))
            orders, colds = [], []
            for tolerance in (1e-3, 1e-4):
                orders.append(least_order(tip, this, speed, depth, known, tolerance))
                many = np.tile(speed, 50), np.tile(depth, 50)
                spent = seconds(partial(spectral_radius, *many, tip, this, order=orders[-1]))
                colds.append(spent / len(many[0]))
            size = len(multipliers(speed[0], depth[0], tip, this, order=orders[-1]))
            scan = np.linspace(0.02, 1, 50) * deepest
            spent = seconds(partial(radius_map, speed, scan, tip, this, order=orders[-1]))
            grid = spent / (len(scan) * len(speed))
            reached, cells = semi_discretized(tip, this, speed[:FEW], depth[:FEW], known[:FEW]), []
            for tolerance, cold in zip((1e-3, 1e-4), colds, strict=True):
                steps, off, each = next((row for row in reached if row[1] <= tolerance), reached[-1])
                if off > tolerance:
                    cells.append(f"more than {each / cold:.0f} (p = {steps} still {off:.0e} off)")
                    continue
                cells.append(f"{each / cold:.0f} (p = {steps})")
                if tolerance == 1e-3:
                    ratios.append(each / cold)
            rows.append((
                modes, f"{immersion:g}", f"{orders[0]}, {orders[1]} / {size}", f"{1e6 * colds[0]:.1f}, {1e6 * colds[1]:.1f}",
                f"{1e-3 / colds[1]:.0f} k", f"{1e-3 / grid:.0f} k", *cells,
            ))  # fmt: skip
    head = ("modes", "a/D", "n / matrix", "us at 1e-3, 1e-4", "a second, each its own speed", "a second, on a grid",
            "semi-discretization costs times, at 1e-3", "at 1e-4")  # fmt: skip
    return table(head, *rows) + f"\n\nLeast of the ratios at 1e-3 where it was reached: {min(ratios):.0f}."


def cost_of_maps() -> str:
    """200 speeds, 100 depths: every point, and by columns of the boundary."""
    from millcal.physics.stability.floquet import boundary, order_of, radius_map
    from millcal.physics.stability.stable_depths import edge_table, edges_of, is_stable

    rows = []
    for modes in MACHINES:
        for immersion in IMMERSIONS:
            tip, this, deepest = problem(modes, immersion)
            speed, depth = np.linspace(*RANGE[modes], 200) * RPM, np.linspace(0.01, 1, 100) * deepest
            order = order_of(speed, deepest, tip, this)
            radius = radius_map(speed, depth, tip, this)
            whole = seconds(partial(radius_map, speed, depth, tip, this), 0.01)
            found = boundary(speed, tip, this, deepest=deepest)
            columns = seconds(partial(boundary, speed, tip, this, deepest=deepest), 0.01)
            stable = is_stable(edge_table(edges_of(found, complete=True), 200)[np.newaxis], depth[:, np.newaxis])
            wrong = np.sum(stable != (radius < 1))
            rows.append((modes, f"{immersion:g}", f"{order.min()}-{order.max()}", f"{whole:.3f}", f"{columns:.3f}",
                         f"{whole / columns:.1f}", f"{wrong}"))  # fmt: skip
    return table(("modes", "a/D", "n", "every point, s", "columns, s", "times", "points that differ, of 20 000"), *rows)


def shop_scripts() -> str:
    """Zeroth order, dense: cost, error and wrong labels of a 200 x 100 map, asked at 1200 of its points."""
    from semi_discretization import DenseSemiDiscretization

    from millcal.physics.stability.floquet import spectral_radius

    rows = []
    for immersion, steps in ((1.0, 40), (1.0, 80), (0.05, 40), (0.05, 80)):
        tip, this, deepest = problem("1", immersion)
        deepest = {1.0: 4e-3, 0.05: 8e-3}[immersion]
        speed, depth = np.linspace(5000, 20_000, 200) * RPM, np.linspace(0, deepest, 100)
        chosen = np.random.default_rng(8).choice(20_000, 1200 if steps == 40 else 400, replace=False)
        speed, depth = speed[chosen % 200], depth[chosen // 200]
        known = spectral_radius(speed, depth, tip, this, tolerance=1e-8)
        slow = DenseSemiDiscretization(tip, this, steps)
        start = time.process_time()
        found = np.array([slow.radius(w, b) for w, b in zip(speed, depth, strict=True)])
        cost = (time.process_time() - start) / len(speed)
        ours = seconds(partial(spectral_radius, speed, depth, tip, this)) / len(speed)
        wrong, off = np.sum((found < 1) != (known < 1)), np.abs(found - known)
        own = spectral_radius(speed, depth, tip, this)
        here = np.sum((own < 1) != (known < 1))
        rows.append((f"{immersion:g}", f"{steps}", f"{1e6 * cost:.0f}", f"{1e6 * ours:.1f}", f"{cost / ours:.0f}",
                     f"{np.median(off):.0e} / {off.max():.0e}", f"{100 * wrong / len(speed):.2f} %",
                     f"{np.abs(own - known).max():.0e}", f"{100 * here / len(speed):.2f} %"))  # fmt: skip
    head = ("a/D", "steps", "us a point", "Floquet, us", "times", "error of \\|mu\\|, median / largest", "wrong labels",
            "Floquet, largest error", "wrong labels")  # fmt: skip
    return table(head, *rows)


def floquet(options) -> str:
    """Multipliers of two-tooth cuts, down, at 60 random points with |mu| from .5 to 1.6; CPU time of one thread.

    The order n is the least that holds 1e-3 and 1e-4 at 95 % of the points; rates are those of 1e-4. Semi-discretization of
    the first order is compiled, takes exact means, keeps only what is in cut and multiplies nothing that is zero; p is the
    least that holds the error at 95 % of 20 points, and the cost is held against the Floquet cost of the same error. Then
    maps of 200 speeds and 100 depths at the order of the rule, and a plain dense semi-discretization of order zero, as shop
    scripts have it.
    """
    single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
    run = subprocess.run(
        [sys.executable, __file__], env=os.environ | single, stdout=subprocess.PIPE, text=True, check=True
    )
    return run.stdout.strip()


if __name__ == "__main__":
    for part in (cost_of_points, cost_of_maps, shop_scripts):
        print(part(), end="\n\n", flush=True)
