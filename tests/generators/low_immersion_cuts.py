"""Test cuts of sample_data/low-immersion, judged in the time domain with the truth; run as a script it writes them.

What the log says is what a shop would note: speed, depth, whether the cut chattered, by how much the once-per-tooth position
changed, the frequency heard, the mean power. The runout is left out, because with two teeth it repeats as a period doubling does.
"""

import csv
import json
import sys
from io import StringIO
from pathlib import Path

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.cutting_force import LinearEdge
from millcal.physics.mean_torque import mean_torque
from millcal.physics.stability.regeneration import Regeneration, tip_of_shapes
from millcal.physics.stability.time_domain import simulate_cut, simulate_points, steps_for

FOLDER = Path(__file__).parents[2] / "sample_data" / "low-immersion"
FEED = 0.08e-3  # m per tooth
REPEATS = 0.01  # of the feed: change from tooth to tooth of a cut that is called stable
FINER = 4  # steps, than the least: so short an engagement is otherwise not the same from tooth to tooth
MADE = {  # rpm: depths in mm
    8400: (2.4, 4.6), 8800: (4.0, 7.6), 9600: (3.0, 6.0), 10200: (5.0,), 10600: (3.0, 5.0), 10800: (2.0, 3.6, 5.2),
    11000: (3.6,), 11600: (3.0, 5.2), 12200: (3.0, 5.0), 13400: (4.0, 8.0),
}  # fmt: skip


def log() -> str:
    """The log as CSV."""
    truth = json.loads((FOLDER / "truth.json").read_text())
    law, radial = truth["law"], truth["recordings"]["down-fz060.h5"]["conditions"]["radial_depth_mm"]
    cutter = Cutter(diameter=truth["cutter"]["diameter_mm"] * 1e-3, teeth=truth["cutter"]["teeth"])
    edge = {"kte": law["Kte_N_per_mm"] * 1e3, "kre": law["Kre_N_per_mm"] * 1e3}
    entry, leave = engagement(CuttingConditions(1.0, FEED, 1e-3, radial * 1e-3, "down"), cutter.diameter)
    cut = Regeneration(cutter.teeth, entry, leave, law["Ktc_N_per_mm2"] * 1e6, law["Krc_N_per_mm2"] * 1e6)
    tip = _tip(truth["modes"])
    rpm, depth = np.array([(speed, depth) for speed, depths in MADE.items() for depth in depths]).T
    speed, depth = rpm * 2 * np.pi / 60, depth * 1e-3
    change = np.array([_change(omega, ap, tip, cut, edge) for omega, ap in zip(speed, depth, strict=True)])
    forces = LinearEdge(
        cutting=np.array([law[f"{name}_N_per_mm2"] for name in ("Ktc", "Krc", "Kac")]) * 1e6,
        edge=np.array([law[f"{name}_N_per_mm"] for name in ("Kte", "Kre", "Kae")]) * 1e3,
    )
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        [
            "rpm",
            "axial_depth_mm",
            "radial_depth_mm",
            "feed_per_tooth_mm",
            "stable",
            "M_um",
            "chatter_hz",
            "power_W",
            "direction",
        ]
    )
    for i, (omega, ap) in enumerate(zip(speed, depth, strict=True)):
        stable = change[i] <= REPEATS * FEED
        heard = "" if stable else f"{_heard(omega, ap, tip, cut, edge):.0f}"
        power = omega * mean_torque(forces, cutter, CuttingConditions(omega, FEED, ap, radial * 1e-3, "down"))
        shop = [f"{rpm[i]:.0f}", f"{ap * 1e3:.1f}", f"{radial:g}", f"{FEED * 1e3:g}", int(stable)]
        rows.writerow([*shop, f"{change[i] * 1e6:.1f}", heard, f"{power:.0f}", "down"])
    return text.getvalue()


def _tip(modes):
    natural = np.array([mode["fn_hz"] for mode in modes])
    shape = np.array([[mode["shape"][dof] for dof in ("tipX", "tipY")] for mode in modes])
    scale = 2 * np.pi * natural / np.sqrt([mode["k_N_per_m"] for mode in modes])
    return tip_of_shapes(natural, np.array([mode["zeta"] for mode in modes]), shape * scale[:, np.newaxis])


def _change(speed, depth, tip, cut, edge):
    """From tooth to tooth at the worst phase, once settled, m."""
    run = {
        "feed_per_tooth": FEED,
        "revolutions": 800,
        "kept": 200,
        "steps_per_revolution": FINER * steps_for(speed, depth, tip, cut),
    }
    seen = simulate_points(np.array([speed]), np.array([depth]), tip, cut, **run, **edge).displacement[0]
    return np.abs(np.diff(seen, axis=1)).mean(axis=1).max()


def _heard(speed, depth, tip, cut, edge):
    """The strongest line of the tip's motion that is no harmonic of the teeth, Hz."""
    steps = steps_for(speed, depth, tip, cut)
    moved = simulate_cut(speed, depth, tip, cut, feed_per_tooth=FEED, revolutions=500, **edge).displacement
    passing = moved[:, -256 * steps :].reshape(2, -1, steps // cut.teeth)  # one row for each tooth
    free = (passing - passing.mean(axis=1, keepdims=True)).reshape(2, -1)
    lines = np.abs(np.fft.rfft(free * np.hanning(free.shape[1]))).max(axis=0)
    return np.argmax(lines) / 256 * speed / (2 * np.pi)


if __name__ == "__main__":
    (FOLDER / "cuts.csv").write_text(log())
    sys.stdout.write(log())
