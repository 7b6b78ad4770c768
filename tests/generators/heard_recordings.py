"""Recordings without a dynamometer, on disk: hits at the tip and two cuts, heard by the same six accelerometers."""

from pathlib import Path

import numpy as np
from accelerometer_cuts import LAW, SENSORS, TIP, slot, structure

from millcal.io.recordings import write_recording
from millcal.physics.cutter import Cutter
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut, simulate_impact

TRUTH = {
    "Ktc": 1000,
    "Krc": 700,
    "Kac": 250,
    "Kte": 50,
    "Kre": 30,
}  # Kae is nothing that a slot of straight teeth shows
CUTS = ("cut-0.h5", "cut-1.h5")
TAPS = tuple(f"tap-{dof}.h5" for dof in TIP)
OF = structure(7, natural_frequency=(180.0, 260.0, 390.0), damping_ratio=(0.05, 0.06, 0.04), mass=(30.0, 25.0, 20.0))
RATE = 4096.0  # Hz
PULSE_ANGLE = 0.7  # rad
SLOTS = tuple(slot(tooth_passing) for tooth_passing in (112.0, 141.0))  # Hz

CUTTER_KEYS = "[cutter]\ndiameter_mm = 20\nteeth = 2\n"


def record_all(folder: Path, *, teeth: int = 2) -> None:
    """Write the two cuts and the three impact tests; the tip has accelerometers of its own during the hits only."""
    for number, conditions in enumerate(SLOTS):
        recording, _ = simulate_cut(
            LAW,
            Cutter(diameter=20e-3, teeth=teeth),
            conditions,
            rng=np.random.default_rng(number),
            sample_rate=RATE,
            timeline=Timeline(1.0, 0.1, 0.1, 0.05),
            initial_angle=None,
            dynamometer=None,
            modes=OF.modes,
            accelerometers=SENSORS,
            accelerometer=MeasuringChain(noise=0.05),
            pulse=True,
            pulse_angle=PULSE_ANGLE,
            name=CUTS[number],
        )
        write_recording(folder / CUTS[number], recording)
    for number, dof in enumerate(TIP):
        test, _ = simulate_impact(
            OF.modes,
            rng=np.random.default_rng(10 + number),
            sample_rate=RATE,
            hammer=dof,
            accelerometers=(*SENSORS, "tipX", "tipY"),
            hits=5,
            record=0.4,
            peak=1500.0,
            pulse=1e-3,
            hammer_chain=MeasuringChain(noise=0.5),
            accelerometer=MeasuringChain(noise=0.05),
            name=TAPS[number],
        )
        write_recording(folder / TAPS[number], test)
