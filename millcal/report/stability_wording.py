"""What a stability map says in plain words: what it is worth, and whether the cut that was asked about is stable."""

from math import inf, isfinite

from millcal.data import CoefficientHistory, Coefficients, ForceHarmonics, OperatingPoint, StabilityMap
from millcal.report.digits import fixed, nominal, significant, with_interval
from millcal.report.wording import Verdict, fit_level, judged, percent
from millcal.units import to_shop

METHODS = {
    "zoa": "zero-order",
    "floquet": "Floquet multipliers",
    "frf": "Floquet multipliers, straight from the FRF",
    "time-domain": "simulated in the time domain",
}
SHORT = {"zoa": "zero-order", "floquet": "Floquet", "frf": "from the FRF", "time-domain": "time domain"}
KINDS = {"hopf": "chatter between the tooth passings", "flip": "period doubling", "fold": "static divergence"}
_DOUBTS = {
    "bad": "The map rests on coefficients that do not fit",
    "part": "The map rests on coefficients that are provisional",
}
UNSAFE = ("flip-lobes", "zoa-unsafe")  # notices after which the zero-order limit promises too much, or may
BEYOND_CUTTERS = 3.0  # diameters: deeper the edges of hardly any cutter reach
_UNSAFE_WORDS = "by the zero-order limit, which leaves out period doubling"


def unsafe(map_: StabilityMap) -> bool:
    """Whether the map is of the mean force where that may promise too much."""
    return map_.method == "zoa" and any(notice.code in UNSAFE for notice in map_.notices)


def too_deep(map_: StabilityMap, depth: float) -> bool:
    """Whether a depth in m is more than a cutter of this diameter has edges."""
    return isfinite(depth) and depth > BEYOND_CUTTERS * map_.diameter


def _reaches(map_: StabilityMap) -> str:
    return f"hardly a cutter of {nominal(map_.diameter * 1e3)} mm has edges longer than {BEYOND_CUTTERS:.0f} diameters"


def theory_verdict(map_: StabilityMap) -> Verdict | None:
    """What the map's depths are worth where its method or the cutter does not reach so far; None where it does."""
    told = []
    if unsafe(map_):
        told.append(next(_sentence(notice.message) for notice in map_.notices if notice.code in UNSAFE))
    if any(too_deep(map_, best.axial_depth) for best in map_.best):
        told.append(f"Some best speeds stand at depths that nobody cuts: {_reaches(map_)}.")
    if not told:
        return None
    head = f"These depths hold {_UNSAFE_WORDS}" if unsafe(map_) else "Some depths are beyond the cutter"
    return judged("part", head, " ".join(told))


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def every_speed(map_: StabilityMap) -> str:
    """Where the smallest limit holds: the zero-order limit is known at all speeds at once, others at those of the map."""
    return "every speed" if map_.method == "zoa" else "every speed of the map"


def map_verdict(fit: Coefficients | CoefficientHistory | ForceHarmonics | None) -> Verdict | None:
    """What the map is worth where its coefficients are in doubt; None where they are not."""
    level = fit_level(fit) if fit is not None else "good"
    if level not in _DOUBTS:
        return None
    return judged(level, _DOUBTS[level], "Its band and its probabilities know nothing of that.")


def operating_verdict(
    map_: StabilityMap, fit: Coefficients | CoefficientHistory | ForceHarmonics | None = None
) -> Verdict | None:
    """Whether the cut that the recipe names is stable; None where it names none."""
    point = map_.operating
    if point is None:
        return None
    place = f"{to_shop(point.spindle_speed, 'spindle_speed_rpm'):.0f} rpm and {nominal(point.axial_depth * 1e3)} mm"
    told = _limit_in_words(point)
    if point.p_stable is not None:
        told.append(f"Probability of a stable cut: {percent(point.p_stable)}.")
        level = "good" if point.p_stable >= 0.95 else "bad" if point.p_stable <= 0.05 else "part"
    else:
        told.append("No band is known.")
        level = "good" if point.stable else "bad"
    margin = margin_in_words(map_)
    told += [f"{margin}."] if margin else []
    head = {"good": "Stable", "part": "Stable or not: too close to tell", "bad": "Chatter"}[level]
    place = f"{head} at {place}"
    if unsafe(map_):
        place += f" {_UNSAFE_WORDS}"
        level = "part" if level == "good" else level
    if too_deep(map_, point.axial_depth):
        told.append(f"{_sentence(_reaches(map_))}")
        level = "part" if level == "good" else level
    doubt = map_verdict(fit)
    if doubt is not None:
        told.append(f"{doubt.head}.")
        level = "part" if level == "good" else level
    return judged(level, place, " ".join(told))


def _limit_in_words(point: OperatingPoint) -> list[str]:
    """The limit, what lies beyond it, and what is heard there."""
    if point.limit == inf:
        return []
    text = f"The limit there is {significant(point.limit * 1e3)} mm"
    if point.limit_interval is not None:
        value, low, high = with_interval(point.limit * 1e3, *(bound * 1e3 for bound in point.limit_interval))
        text = f"The limit there is {value} mm, with 95 % between {low} and {high} mm"
    told = [text + "."]
    if point.stable and point.axial_depth > point.limit:
        told.append("Beyond it lies a pocket that is stable, and this cut in it: shallower it chatters too.")
    if point.kind in KINDS and isfinite(point.chatter_frequency):
        what = f"{KINDS[point.kind]}, at {significant(point.chatter_frequency, 4)} Hz"
        told.append(f"Deeper it chatters: {what}." if point.stable else f"Expect {what}.")
    return told


def margin_in_words(map_: StabilityMap) -> str:
    """How far the speed may move before the depth asked about chatters; nothing where that is not known."""
    point = map_.operating
    if point is None or not point.stable or point.speed_margin is None:
        return ""
    ends = (point.spindle_speed - map_.spindle_speed[0], map_.spindle_speed[-1] - point.spindle_speed)
    words = [
        f"{way} by {fixed(to_shop(margin, 'spindle_speed_rpm'), 0)} rpm"
        if margin < 0.999 * end
        else f"{way} to the end of the map"
        for way, margin, end in zip(("fall", "rise"), point.speed_margin, ends, strict=True)
    ]
    return f"At this depth the speed may {words[0]} and {words[1]}"
