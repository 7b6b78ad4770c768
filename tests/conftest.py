"""A small recipe with its synthetic recordings, for the tests of the main job from end to end."""

from pathlib import Path

import numpy as np
import pytest

RECIPE = """\
title = "Small slot cuts"
seed = 4

[cutter]
diameter_mm = 16
teeth = 2
helix_deg = 30

[conditions]
spindle_speed_rpm = 6000
axial_depth_mm = 2
direction = "slot"

[[cuts]]
recording = "cut-0.h5"
feed_per_tooth_mm = 0.04

[[cuts]]
recording = "cut-1.h5"
feed_per_tooth_mm = 0.07

[[cuts]]
recording = "cut-2.h5"
feed_per_tooth_mm = 0.10

[conditioning]
harmonics = 8

[coefficients]
method = "average"

[impact]
recordings = ["tap-x.h5", "tap-y.h5"]

[stability]
rpm = [4000, 12000]
points = 60
members = 50
spindle_speed_rpm = 6000
axial_depth_mm = 2

[expect]
"coefficients.Ktc_N_per_mm2" = [810, 830]
verdict = "fits"
"""


@pytest.fixture(scope="session")
def recordings_folder(tmp_path_factory) -> Path:
    """Three slot cuts with air before and after, and an impact test in x and in y, as recordings."""
    from millcal.io.recordings import write_recording
    from millcal.physics.cutter import Cutter, CuttingConditions
    from millcal.physics.cutting_force import LinearEdge
    from millcal.physics.measuring_chain import MeasuringChain
    from millcal.physics.shaped_modes import ShapedMode
    from millcal.simulation import Timeline, simulate_cut, simulate_impact

    folder = tmp_path_factory.mktemp("recordings")
    law = LinearEdge(cutting=np.array([820e6, 260e6, 110e6]), edge=np.array([18e3, 16e3, 3e3]))
    cutter = Cutter(diameter=16e-3, teeth=2, helix=np.pi / 6)
    for number, feed in enumerate([40e-6, 70e-6, 100e-6]):
        recording, _ = simulate_cut(
            law,
            cutter,
            CuttingConditions(200 * np.pi, feed, 2e-3, 16e-3, "slot"),
            rng=np.random.default_rng(number),
            sample_rate=5000.0,
            timeline=Timeline(0.4, 0.1, 0.1, 0.02),
            dynamometer=MeasuringChain(noise=1.0),
            name=f"cut-{number}.h5",
        )
        write_recording(folder / f"cut-{number}.h5", recording)
    modes = (
        ShapedMode(700.0, 0.03, 2e7, (("tipX", 1.0),)),
        ShapedMode(900.0, 0.03, 3e7, (("tipY", 1.0),)),
    )
    for axis in "xy":
        test, _ = simulate_impact(
            modes,
            rng=np.random.default_rng(ord(axis)),
            sample_rate=6400.0,
            hammer=f"tip{axis.upper()}",
            accelerometers=("tipX", "tipY"),
            hits=3,
            record=0.2,
            peak=200.0,
            pulse=5e-4,
            hammer_chain=MeasuringChain(noise=0.05),
            accelerometer=MeasuringChain(noise=0.05),
            name=f"tap-{axis}.h5",
        )
        write_recording(folder / f"tap-{axis}.h5", test)
    return folder


@pytest.fixture
def coarse_png(monkeypatch) -> None:
    """Figures of few dots, for tests that ask what a figure is and not how fine."""
    from millcal.report.paper import sheet

    monkeypatch.setitem(sheet._STYLE, "savefig.dpi", 60)


@pytest.fixture(scope="session")
def recipe_text() -> str:
    return RECIPE


@pytest.fixture
def small_recipe(recordings_folder):
    """small_recipe(text) writes a recipe beside the recordings; by default the whole one."""
    written = []

    def write(text: str = RECIPE, name: str = "small.toml") -> Path:
        path = recordings_folder / name
        path.write_text(text, encoding="utf-8")
        written.append(path)
        return path

    yield write
    for path in written:
        path.unlink(missing_ok=True)
