"""Short recorded cuts with runout, wear and a low-pass, for tests of methods that follow coefficients."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from millcal.io.recordings import write_recording
from millcal.physics.changing_coefficients import STEADY, Chip, Trend
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import Kienzle
from millcal.physics.measuring_chain import MeasuringChain
from millcal.simulation import Timeline, simulate_cut

LAW = Kienzle(specific_force=np.array([1500e6, 420e6, 240e6]), rise=np.array([0.21, 0.46, 0.34]))
TRUTH = {"kt": 1500, "kr": 420, "ka": 240, "mt": 0.21, "mr": 0.46, "ma": 0.34}
CUTTER = Cutter(diameter=12e-3, teeth=2, helix=np.pi / 6, runout=8e-6, runout_angle=np.pi / 3)
# between two teeth: simulated chains answer a jump at once, where a real low-pass would smear it
CHIPPED = Trend((STEADY,) * 3, (STEADY,) * 3, (Chip(0.505, (0.15, 0.15, 0.15)),))


def record_cut(path: Path, *, feed: float = 80e-6, seed: int = 0, **more: Any) -> None:
    """Half a second of down milling at 4 kHz through a low-pass of 600 Hz; the cutter's runout is not told."""
    recording, _ = simulate_cut(
        LAW,
        CUTTER,
        CuttingConditions(80 * np.pi, feed, 2e-3, 4e-3, "down"),
        rng=np.random.default_rng(seed),
        sample_rate=4000.0,
        timeline=Timeline(0.5, 0.2, 0.2, 0.05),
        dynamometer=MeasuringChain(noise=2.0, lowpass=600.0, lowpass_order=2),
        name=path.name,
        **more,
    )
    known = replace(CUTTER, runout=0.0, runout_angle=0.0)
    write_recording(path, replace(recording, cutter=known))
