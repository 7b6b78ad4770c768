"""What the command line needs of cuts that accelerometers heard: the cuts conditioned, and the FRF of their sensors."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from millcal.cli.cut_input import read_cut
from millcal.cli.speak import Progress


def hear_cuts(
    recordings: Sequence[Path],
    setup: Path | None,
    *,
    feeds: Sequence[float | None],
    phases: Sequence[float | None],
    harmonics: int | None,
    progress: Progress,
    **how: Any,
) -> tuple[list[Any], list[Any]]:
    """The cuts and what is to be told of them.

    feeds : mm, of each cut   phases : degrees, of tooth 0   harmonics : of the tooth passing, that will be asked for
    how : map, units, rate_hz, as of `read_recording`
    """
    from millcal.stages.conditioning.vibration import condition_vibration
    from millcal.stages.forces.problem import spindle_harmonics
    from millcal.units import from_shop

    cuts, notices = [], []
    for number, path in enumerate(recordings):
        progress(number / len(recordings), path.name)
        phase = phases[number]
        recording = read_cut(
            path,
            setup,
            feed=feeds[number],
            engagement=None,
            path_start=None,
            spindle_phase=None if phase is None else from_shop(phase, "x_deg"),
            **how,
        )
        notices += recording.notices
        cuts.append(condition_vibration(recording, harmonics=spindle_harmonics(recording.cutter, harmonics)))
        notices += cuts[-1].notices
    return cuts, notices


def read_dynamics(frf: Path, modes: Path | None) -> tuple[Any, Any, list[Any]]:
    """The FRF of the sensors, the modes fitted to it or None, and what is to be told of them."""
    from millcal.data import Modes
    from millcal.io.frf_files import read_frf
    from millcal.io.results import read_result

    found = read_frf(frf)
    ours = frf.suffix.lower() in (".h5", ".hdf5")  # what millcal itself found was told when it did
    return found, read_result(modes, Modes) if modes else None, [] if ours else [*found.notices]
