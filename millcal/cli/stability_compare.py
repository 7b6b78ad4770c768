"""The maps of other methods beside the one that was asked for: `millcal stability --compare`."""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

from millcal.cli.stability_input import METHODS, OF_MODES, why_not


def other_maps(
    found: Any,
    frf: Any,
    modes: Any,
    posterior: Any,
    asked: Mapping[str, Any],
    of_method: Mapping[str, Any],
    progress: Callable[[float, str], None],
) -> tuple[list, list]:
    """Maps of every other method that applies, and notices of those that do not.

    asked : arguments of the map   of_method : what `why_not` asks about
    """
    from millcal.data import Notice
    from millcal.errors import IllPosedError
    from millcal.stages.stability import map_stability

    maps, notices = [], []
    rest = [method for method in METHODS if method != found.method]
    for number, method in enumerate(rest):
        reason = why_not(method, frf=frf is not None, modes=modes is not None, **of_method)
        if not reason:
            try:
                maps.append(
                    map_stability(
                        modes if frf is None or (modes is not None and method in OF_MODES) else frf,
                        posterior,
                        **{**asked, **(_coarse(found) if method == "time-domain" else {})},
                        method=method,
                        members=0,
                        progress=lambda done, label, number=number: progress((number + done) / len(rest), label),
                    )
                )
            except IllPosedError as problem:
                reason = str(problem)
        if reason:
            notices.append(Notice("not-compared", reason, f"--compare {method}", "note"))
    return maps, notices


def _coarse(found: Any) -> dict[str, Any]:
    """Some speeds of the map alone, for a method that is slow: the round ones, or where these are no even part of it every nth.

    They are speeds of the map to the last digit but one, for beside a lobe the limit of a neighbour is another.
    """
    from millcal.io.stability_readable import ROUND_SPEEDS, round_speeds
    from millcal.units import to_shop

    speeds = found.spindle_speed
    shown = round_speeds(to_shop(speeds, "x_rpm"))
    if len(shown) < 2 or len({after - before for before, after in pairwise(shown)}) > 1:
        shown = list(range(0, len(speeds), -(-len(speeds) // ROUND_SPEEDS)))
    if len(shown) < 2:
        shown = [0, len(speeds) - 1]
    return {"spindle_speed": (float(speeds[shown[0]]), float(speeds[shown[-1]])), "points": len(shown)}
