"""The stability map: where it is stable, by what kind of chatter that ends, and what a shop wants to know marked.

Shaded is what is stable, column by column from the crossings, so that islands of chatter and pockets of stable cutting come
out as they are; where probabilities are known, their levels are shaded instead. All is drawn as lines and areas and nothing as
an image: it follows the colours of the page, also at night and on paper, and stays small.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from millcal.data import OperatingPoint, StabilityMap
from millcal.report.charts import Band, Frame, Item, Line, Marks, Note, Panel, Rule, Whiskers, chart, span_of, thin
from millcal.report.digits import significant
from millcal.report.figures import POINTS, Column, Figure
from millcal.report.stability_against import otherwise, otherwise_in_words
from millcal.report.stability_regions import (
    KINDS,
    Area,
    areas,
    chances,
    edges,
    inner_crossings,
    simplified,
    stable_stretches,
    stretches_above,
    stretches_with_best,
)
from millcal.report.stability_wording import every_speed, unsafe
from millcal.report.wording import percent
from millcal.units import to_shop

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # of the probability: shaded from each on
CONTOURS = (0.05, 0.5, 0.95)  # of them, drawn as lines
LINES = ("main strong", "flip strong", "fold strong")  # by kind
LIMITS = ("Hopf limit: chatter between the tooth passings", "flip limit: period doubling", "fold limit")
HARMONICS = 8  # of the tooth passing beside the chatter frequency
MOST_SIMULATED = 1500  # marks of simulated cuts
HEIGHT = 300.0
FINE = 0.08  # of a pixel: how far off a drawn line may be


def rpm_of(speed: np.ndarray) -> np.ndarray:
    """Spindle speeds as they are drawn.   speed : (n,) rad/s   returns (n,) rpm"""
    return to_shop(np.asarray(speed, float), "spindle_speed_rpm")


def depth_drawn(map_: StabilityMap) -> float:
    """Highest depth of the picture, m: a lobe's peak may go to infinity, the depths of a shop do not."""
    if map_.probability_depth is not None and len(map_.probability_depth):
        return float(map_.probability_depth[-1])
    finite = map_.limit_depth[np.isfinite(map_.limit_depth)]
    highest = 1.08 * float(finite.max()) if len(finite) else 0.0
    asked = [1.35 * map_.operating.axial_depth] if map_.operating else []
    asked += [
        1.08 * float(cuts.axial_depth.max()) for cuts in (map_.tests, map_.simulated) if cuts and len(cuts.axial_depth)
    ]
    wanted = [1.4 * best.axial_depth for best in map_.best]
    if np.isfinite(map_.absolute_minimum) and map_.absolute_minimum > 0:
        wanted.append(5.0 * map_.absolute_minimum)
    returns = map_.crossing_depth[(map_.crossing_loses == 0) & (map_.crossing_depth < 12 * map_.absolute_minimum)]
    if len(returns):  # islands are seen whole where they are not out of all proportion
        wanted.append(1.1 * float(returns.max()))
        highest = max(highest, wanted[-1])
    top = max([min(max(wanted), highest) if wanted and highest else highest or max(wanted, default=0.0), *asked])
    if np.isfinite(map_.deepest) and map_.deepest > 0:
        top = max([min(top or map_.deepest, map_.deepest), *asked])
    return top or 1e-3


def lobes(map_: StabilityMap) -> Figure:
    """What is stable with its bounds, the chatter frequency with the lobes' numbers, and what was asked, tried and advised."""
    rpm, top, frame = rpm_of(map_.spindle_speed), depth_drawn(map_) * 1e3, Frame()
    ends = (float(rpm[0]), float(rpm[-1]))
    inner = frame.width - frame.left - frame.right
    fine = (FINE * top / HEIGHT, FINE * (ends[1] - ends[0]) / inner)
    items, key = _bounds(map_, rpm, top, fine)
    for more, told in (
        _asked(map_),
        _simulated(map_),
        _tested(map_),
        _best(map_),
        _operating(map_.operating, ends, top),
    ):
        items += more
        key += told
    chatter, f_range = _chatter(map_, rpm, inner)
    panels = [
        Panel("limit of the axial depth, mm", items, HEIGHT, (0.0, top), most_ticks=6),
        Panel("chatter frequency, Hz, and number of the lobe", chatter, 90, f_range, most_ticks=3),
    ]
    label = (
        f"Limit of the axial depth from {rpm[0]:.0f} to {rpm[-1]:.0f} rpm; smallest limit "
        f"{significant(map_.absolute_minimum * 1e3)} mm with chatter at {significant(map_.absolute_minimum_frequency, 4)} Hz"
    )
    svg = chart(panels, x_label="spindle speed, rpm", x_range=ends, label=label, frame=frame, hover=True)
    if any(item.kind == "passing" for item in chatter if isinstance(item, Line)):
        key.append(("line passing", "multiples of the tooth passing"))
    told = []
    if unsafe(map_):
        told.append("The zero-order limit leaves out period doubling: the cut may chatter well below it.")
    if map_.best:
        told.append(
            "Between two lobes the cut takes most, and a speed off such a pocket loses it"
            + (": how far off it may be stands in the table." if any(b.speed_margin for b in map_.best) else ".")
        )
    if np.any(map_.crossing_loses == 0):
        told.append("Beyond a limit there may be stable cutting again: only where it is shaded.")
    if np.isfinite(map_.deepest) and map_.deepest * 1e3 <= 1.001 * top:
        told.append(f"Looked at was up to {significant(map_.deepest * 1e3)} mm.")
    if differ := otherwise_in_words(map_):
        told.append(differ)
    return Figure(
        "stability-map",
        "Limit depth and speed",
        " ".join(told),
        (svg,),
        columns_of(map_, POINTS),
        key,
        hint="spindle speed",
    )


def columns_of(map_: StabilityMap, most: int) -> list[Column]:
    """The map speed by speed: limit with its band and kind, chatter frequency and lobe, at no more than so many speeds."""
    finite = np.where(np.isfinite(map_.limit_depth), map_.limit_depth, np.nan)
    corners = np.flatnonzero((np.diff(map_.lobe) != 0) | (np.diff(map_.limit_kind) != 0))
    kept = thin(map_.spindle_speed, finite, most)
    if len(corners) < most // 4:
        kept = np.union1d(kept, np.concatenate([corners, corners + 1]))
    columns = [
        Column("spindle speed", "rpm", rpm_of(map_.spindle_speed[kept])),
        Column("limit depth", "mm", map_.limit_depth[kept] * 1e3),
    ]
    if map_.limit_low is not None and map_.limit_high is not None:
        columns += [
            Column("limit low", "mm", map_.limit_low[kept] * 1e3),
            Column("limit high", "mm", map_.limit_high[kept] * 1e3),
        ]
    kinds = [KINDS[int(k)] if 0 <= k < len(KINDS) else "none" for k in map_.limit_kind[kept]]
    columns += [
        Column("kind", "", np.array(kinds)),
        Column("chatter frequency", "Hz", map_.chatter_frequency[kept]),
        Column("lobe", "", np.where(map_.lobe[kept] >= 0, map_.lobe[kept], np.nan)),
    ]
    return columns


Drawn = tuple[list[Item], list[tuple[str, str]]]  # what is drawn, and what the key says of it


def _bounds(map_: StabilityMap, rpm: np.ndarray, top: float, fine: tuple[float, float]) -> Drawn:
    """The stable area or the levels of the probability, the band, and the bounds by kind.   fine : in mm and rpm"""
    out_of_sight = min(3 * top, map_.deepest * 1e3)  # where no limit was found

    def shown(depth: np.ndarray) -> np.ndarray:
        return np.minimum(np.where(np.isnan(depth), out_of_sight, depth * 1e3), out_of_sight)

    def filled(found: Sequence[Area], kind: str) -> Band:
        pieces = []
        for area in found:
            low, high = shown(area.low), shown(area.high)
            kept = np.union1d(simplified(area.x, low, *fine), simplified(area.x, high, *fine))
            pieces += [np.stack([area.x, low, high])[:, kept], np.full((3, 1), np.nan)]
        return Band(*(np.concatenate(pieces, axis=1) if pieces else np.empty((3, 0))), kind)

    def line(x: np.ndarray, depth: np.ndarray, kind: str) -> Line:
        y = shown(depth)
        kept = simplified(x, y, *fine)
        return Line(x[kept], y[kept], kind)

    columns = stable_stretches(map_)
    speeds, topped = stretches_with_best(map_)
    stable = areas(rpm_of(speeds), topped)
    items: list[Item] = []
    key: list[tuple[str, str]] = []
    if likely := chances(map_):
        for level in LEVELS:
            found = areas(rpm, stretches_above(likely, level))
            items.append(filled(found, "chance"))
            if level in CONTOURS:
                items += [line(e.x, e.y, "chance middle" if level == 0.5 else "chance") for e in edges(found)]
        steps = ", ".join(percent(level).removesuffix(" %") for level in LEVELS)
        key.append(("span chance-all", f"stable with more than {steps} %, the darker the likelier"))
        key.append(
            ("line chance", f"{percent(CONTOURS[0])} and {percent(CONTOURS[-1])}, dotted {percent(CONTOURS[1])}")
        )
    else:
        items.append(filled(stable, "stable"))
        key.append(("span stable", "stable"))
        if map_.limit_low is not None and map_.limit_high is not None:
            low, high = shown(map_.limit_low), shown(map_.limit_high)
            kept = np.union1d(simplified(rpm, low, *fine), simplified(rpm, high, *fine))
            items.append(Band(rpm[kept], low[kept], high[kept], "main"))
            items += [Line(rpm[kept], bound[kept], "main faint") for bound in (low, high)]
            key.insert(0, ("span band-main", "95 % band of the limit"))
    within = inner_crossings(map_, columns)
    if len(within):
        depth = map_.crossing_depth[within] * 1e3
        items.append(Marks(rpm_of(map_.crossing_speed[within]), depth, "within", "point", size=0.7))
        key.append(("line within", "further crossings, within chatter"))
    lines = edges(stable)
    items += [line(e.x, e.y, LINES[e.kind]) for e in lines]
    kinds = sorted({e.kind for e in lines})
    told = [(f"line {LINES[kind]}", LIMITS[kind]) for kind in kinds]
    if kinds in ([], [0]):
        told = [("line main strong", "limit: stable below, chatter above")]
    if np.isfinite(map_.absolute_minimum):
        items.append(Rule(map_.absolute_minimum * 1e3, "y", "limit"))
        key.append(("line limit", f"stable at {every_speed(map_)} below {significant(map_.absolute_minimum * 1e3)} mm"))
    return items, told + key


def _asked(map_: StabilityMap) -> Drawn:
    """How deep was looked, where the picture goes deeper."""
    if not np.isfinite(map_.deepest) or map_.deepest >= depth_drawn(map_):
        return [], []
    return [Rule(map_.deepest * 1e3, "y", "rule")], [("line rule", "looked at up to here")]


def _best(map_: StabilityMap) -> Drawn:
    if not map_.best:
        return [], []
    safe = [best.axial_depth if best.safe_depth is None else best.safe_depth for best in map_.best]
    speeds = rpm_of(np.array([best.spindle_speed for best in map_.best]))
    numbers = [str(i + 1) for i in range(len(speeds))]
    at_safe = ", at the safe depth" if all(best.safe_depth is not None for best in map_.best) else ""
    items: list[Item] = [Marks(speeds, np.array(safe) * 1e3, "best", "diamond", numbers, size=4.5)]
    return items, [("marks diamond best", "best speeds, numbered as in the table" + at_safe)]


def reach(point: OperatingPoint, ends: tuple[float, float], top: float) -> list[tuple[float, float]]:
    """From where to where the point may move before it chatters, or back until it does not: rpm, then mm; none where unknown.

    What does not end within the picture ends well beyond its rim, where an end stroke is out of sight: there was no limit.

    ends, top : of the picture, rpm and mm
    """
    bars = []
    speed, depth = float(rpm_of(point.spindle_speed)), point.axial_depth * 1e3
    if point.speed_margin is not None:
        fall, rise = (float(rpm_of(margin)) for margin in point.speed_margin)
        beyond = 0.1 * (ends[1] - ends[0])
        left, right = speed - fall, speed + rise
        bars.append((left if left > ends[0] else ends[0] - beyond, right if right < ends[1] else ends[1] + beyond))
    else:
        bars.append((speed, speed))
    limit = min(point.limit * 1e3, 1.5 * top)
    bars.append((min(depth, limit), max(depth, limit)))
    return bars


def _operating(point: OperatingPoint | None, ends: tuple[float, float], top: float) -> Drawn:
    """The operating point with bars as far as speed and depth may go."""
    if point is None:
        return [], []
    speed, depth = rpm_of(np.array([point.spindle_speed])), np.array([point.axial_depth * 1e3])
    (left, right), (low, high) = reach(point, ends, top)
    items: list[Item] = []
    if right > left:
        items.append(Whiskers(depth, np.array([left]), np.array([right]), "operating", lying=True))
    if point.stable and high > low:
        items.append(Whiskers(speed, np.array([low]), np.array([high]), "operating"))
    items.append(Marks(speed, depth, "operating", "cross", ["operating point"], size=5.5, below=True))
    bars = ", with bars as far as it stays stable" if len(items) > 1 else ""
    return items, [("marks cross operating", f"operating point{bars}")]


def _tested(map_: StabilityMap) -> Drawn:
    """Cuts that were made."""
    if map_.tests is None:
        return [], []
    items: list[Item] = []
    key = []
    stable = map_.tests.stable > 0
    for which, kind, shape, word in ((stable, "tested", "ring", "stable"), (~stable, "failed", "cross", "chatter")):
        if which.any():
            n, b = rpm_of(map_.tests.spindle_speed[which]), map_.tests.axial_depth[which] * 1e3
            items.append(Marks(n, b, kind, shape, size=4.0))
            key.append((f"marks {shape} {kind}", f"cut made: {word}"))
    return items, key


def _simulated(map_: StabilityMap) -> Drawn:
    """Cuts of the time domain: stable, repeating every so many periods, or never."""
    cuts = map_.simulated
    if cuts is None or not len(cuts.period):
        return [], []
    items: list[Item] = []
    key = []
    chosen = np.unique(np.linspace(0, len(cuts.period) - 1, MOST_SIMULATED).astype(int)) if len(cuts.period) else []
    n, b, period = rpm_of(cuts.spindle_speed[chosen]), cuts.axial_depth[chosen] * 1e3, cuts.period[chosen]
    several = "teeth" if cuts.per == "tooth" else "revolutions"
    for which, kind, shape, word in (
        (period == 1, "simulated-stable", "dot", "stable"),
        (period == 0, "simulated-chatter", "tripod", "chatter"),
    ):
        if which.any():
            items.append(Marks(n[which], b[which], kind, shape, size=2.2))
            key.append((f"marks {shape} {kind}", f"simulated: {word}"))
    repeating = period > 1
    if repeating.any():
        numbers = [f"{p:.0f}" for p in period[repeating]]
        items.append(Marks(n[repeating], b[repeating], "period", "word", numbers))
        key.append(("digit", f"simulated: repeats every so many {several}"))
    differ = np.logical_or(*otherwise(map_))[chosen]
    if differ.any():
        items.append(Marks(n[differ], b[differ], "otherwise", "ring", size=6.0))
        key.append(("marks ring otherwise", "simulated otherwise than mapped"))
    return items, key


def leaps(map_: StabilityMap) -> np.ndarray:
    """Before which speeds the chatter frequency leaps: another lobe, another kind, or another mode that rings.

    returns indices of speeds
    """
    step = np.abs(np.diff(map_.chatter_frequency))
    usual = np.nanmedian(step) if np.isfinite(step).any() else 0.0
    far = (step > 10 * usual) & (step > 0.02 * map_.chatter_frequency[1:])
    return np.flatnonzero((np.diff(map_.lobe) != 0) | (np.diff(map_.limit_kind) != 0) | far) + 1


def _chatter(map_: StabilityMap, rpm: np.ndarray, width: float) -> tuple[list[Item], tuple[float, float]]:
    """The chatter frequency by kind, the tooth passing faint, and the lobes' numbers."""
    frequency, lobe, breaks = map_.chatter_frequency, map_.lobe, leaps(map_)
    low, high = span_of(frequency, margin=0.16)
    items: list[Item] = []
    for multiple in range(1, HARMONICS + 1):
        passing = multiple * map_.teeth * rpm / 60
        if np.isfinite(frequency).any() and passing[0] < high and passing[-1] > low:
            items.append(Line(rpm[[0, -1]], passing[[0, -1]], "passing"))
    for kind in range(len(KINDS)):
        own = map_.limit_kind == kind
        for run in np.split(np.arange(len(own)), breaks):
            run = run[own[run]]
            if len(run) == 1:
                items.append(Marks(rpm[run], frequency[run], LINES[kind].split()[0], "dot", size=1.5))
            elif len(run):
                kept = run[thin(rpm[run], frequency[run], POINTS)]
                items.append(Line(rpm[kept], frequency[kept], LINES[kind].split()[0]))
    change = np.flatnonzero(np.diff(lobe) != 0) + 1
    room = 34.0 / width * (rpm[-1] - rpm[0])
    for start, stop in pairwise([0, *change.tolist(), len(lobe)]):
        if np.isfinite(lobe[start]) and lobe[start] >= 0 and rpm[stop - 1] - rpm[start] > room:
            items.append(Note((rpm[start] + rpm[stop - 1]) / 2, high - 0.1 * (high - low), f"{lobe[start]:.0f}"))
    return items, (low, high)
