"""The sample recordings against the truth beside them, without the code that reads and conditions recordings."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge, force_harmonics
from millcal.physics.shaped_modes import ShapedMode, accelerance_between

SAMPLES = Path(__file__).parents[2] / "sample_data"
SENSORS = ("noseX", "noseY", "noseZ", "headX", "headY", "headZ")
TIP = ("tipX", "tipY", "tipZ")
CUTS = [  # folder, folder of the impact test, cut, noise of a sample with its counts in g
    *[("no-dynamometer", "no-dynamometer", f"down-n{n}", 0.0107) for n in (2280, 2900, 3350, 3600)],
    *[("six-accelerometers", "impact-test", f"up-fz{n}", 0.0031) for n in ("060", "120")],
]


@pytest.mark.parametrize(("folder", "structure", "name", "noise"), CUTS)
def test_accelerations_of_a_sample_cut_are_those_of_its_true_law_and_modes(folder, structure, name, noise):
    """Every harmonic of the spindle up to 1200 Hz, by the phase of the spindle too, within four deviations of the noise."""
    truth = json.loads((SAMPLES / folder / "truth.json").read_text())
    told = json.loads((SAMPLES / structure / "truth.json").read_text())["modes"]
    own, known, law = truth["recordings"][name + ".h5"], truth["cutter"], truth["law"]
    modes = [ShapedMode(m["fn_hz"], m["zeta"], m["k_N_per_m"], tuple(m["shape"].items())) for m in told]
    c = own["conditions"]
    cut = CuttingConditions(
        c["spindle_speed_rpm"] * 2 * np.pi / 60,
        c["feed_per_tooth_mm"] * 1e-3,
        c["axial_depth_mm"] * 1e-3,
        c["radial_depth_mm"] * 1e-3,
        c["direction"],
    )
    cutter = Cutter(
        known["diameter_mm"] * 1e-3,
        known["teeth"],
        np.radians(known["helix_deg"]),
        runout=known["runout_um"] * 1e-6,
        runout_angle=np.radians(known["runout_angle_deg"]),
    )
    steel = LinearEdge(
        np.array([law[f"K{i}c_N_per_mm2"] for i in "tra"]) * 1e6,
        np.array([law[f"K{i}e_N_per_mm"] for i in "tra"]) * 1e3,
    )
    spindle = own["spindle_frequency_hz"]
    highest = int(1200 / spindle)
    order = np.arange(1, highest + 1)
    force = force_harmonics(steel, cutter, cut, highest)[:, 1:]
    expected = np.einsum("ksd,dk->sk", accelerance_between(order * spindle, modes, SENSORS, TIP), force)

    with h5py.File(SAMPLES / folder / f"{name}.h5") as file:
        rate = float(file.attrs["sample_rate_hz"])
        found = [file["channels"]["acc_" + sensor] for sensor in SENSORS]
        samples = np.array([channel[()] * channel.attrs.get("scale", 1.0) for channel in found])
    begin, end = own["steady_s"]
    begin += 0.1  # what rings after the entry has died away, but for the column's 1e-2
    turns = int((end - begin) * spindle)
    time = np.arange(round(begin * rate), round((begin + turns / spindle) * rate)) / rate
    angle = np.radians(own["initial_angle_deg"]) + 2 * np.pi * spindle * time
    taper = 1 - np.cos(2 * np.pi * (np.arange(len(time)) + 0.5) / len(time))
    kernel = np.exp(-1j * np.outer(order, angle)) * taper
    part = samples[:, round(begin * rate) : round(begin * rate) + len(time)]
    heard = 2 * part @ kernel.T / len(time)
    sd = 2 * noise * 9.80665 * np.sqrt(1.5 / len(time))  # of a harmonic, rms, with the taper
    assert np.abs(heard - expected).max() < 4 * sd + 1e-3 * np.abs(expected).max()
    assert np.abs(expected).max() > 50 * sd
