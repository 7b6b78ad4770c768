"""Where simulated cuts come out otherwise than the map says: there linear theory and the time domain differ."""

import numpy as np

from millcal.data import StabilityMap
from millcal.report.stability_regions import stable_stretches


def otherwise(map_: StabilityMap) -> tuple[np.ndarray, np.ndarray]:
    """Simulated cuts that chatter where the map is stable, and those that are stable where it has chatter.

    Only where both neighbouring speeds of the map say the same; none of a map that was made of simulated cuts.
    returns two masks (cut,)
    """
    cuts = map_.simulated
    if cuts is None or map_.method == "time-domain":
        none = np.zeros(0 if cuts is None else len(cuts.period), bool)
        return none, none
    columns, speeds = stable_stretches(map_), map_.spindle_speed
    after = np.searchsorted(speeds, cuts.spindle_speed * (1 - 1e-9))
    before = np.searchsorted(speeds, cuts.spindle_speed * (1 + 1e-9)) - 1
    told = []
    for i, j, depth in zip(before.tolist(), after.tolist(), cuts.axial_depth.tolist(), strict=True):
        if i < 0 or j >= len(speeds) or depth > map_.deepest:
            told.append((False, False))
            continue
        stable = [any(s.low <= depth <= s.high for s in columns[k]) for k in (i, j)]
        told.append((all(stable), not any(stable)))
    by_map = np.array(told, bool).reshape(-1, 2)
    return (cuts.period != 1) & by_map[:, 0], (cuts.period == 1) & by_map[:, 1]


def otherwise_in_words(map_: StabilityMap) -> str:
    """How many simulated cuts are so, as a sentence or two of a caption; nothing where all are as the map says."""
    chatter, stable = (int(np.count_nonzero(which)) for which in otherwise(map_))
    if map_.simulated is None or not chatter + stable:
        return ""
    told = []
    if chatter:
        told.append(f"{chatter} {'chatters' if chatter == 1 else 'chatter'} where the map is stable")
    if stable:
        told.append(f"{stable} {'is' if stable == 1 else 'are'} stable where the map has chatter")
    return (
        f"Of {len(map_.simulated.period)} simulated cuts {' and '.join(told)} (ringed): there the linear theory of the map and "
        "the simulation, in which a tooth may leave the cut, differ."
    )
