"""The main job on the sample recordings, from files to the report, with warm caches."""

import sys
import tempfile
from pathlib import Path

from measure import spread, table, take_turns

RECIPE = "recipes/slot-demo.toml"


def main_job(options) -> str:
    """Wall and CPU seconds and peak memory of `millcal fit` on the demo's recipe."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "millcal", "fit", RECIPE, "--out", str(Path(folder) / "out"), "--quiet"]
        costs = take_turns({"fit": command}, options.repeats)["fit"]
    return table(
        ("command", "wall s (least / median)", "CPU s (least / median)", "peak MB"),
        (
            f"`millcal fit {RECIPE}`",
            spread([cost.wall for cost in costs]),
            spread([cost.cpu for cost in costs]),
            f"{max(cost.peak for cost in costs):.0f}",
        ),
    )
