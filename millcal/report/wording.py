"""What the report calls things: parameters with their units, cuts and their conditions, and verdicts in plain words."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import degrees
from pathlib import PurePath
from typing import Any

from millcal.data import CoefficientHistory, Coefficients, Cutter, CuttingConditions, ForceHarmonics
from millcal.report.digits import fixed, nominal, significant
from millcal.units import to_shop


@dataclass(frozen=True)
class Parameter:
    """How a parameter of a fit is shown."""

    name: str
    meaning: str
    unit: str  # on the shop floor
    factor: float  # SI value of that unit


SIDES = {"t": "tangential", "r": "radial", "a": "axial"}
_RUNOUT = {
    "c0": "runout: half of how much one tooth stands out, at mid depth",
    "s0": "runout: across c0, at mid depth",
    "t0": "taper of the runout over the depth",
    "rho": "runout: distance of the cutter's axis from the spindle's",
}
_WORDS = {  # of other entries, as far as a stage gives them
    "sse": ("SSE", "sum of squared residuals", "N²", 1.0),
    "sse_ratio": ("SSE ratio", "sum of squared residuals against the adopted model", "", 1.0),
}


def parameter(name: str) -> Parameter:
    """The parameter of this name; a name that is not known stays as it is, in SI."""
    if len(name) == 3 and name[0] == "K" and name[1] in SIDES:
        if name[2] == "c":
            return Parameter(name, f"{SIDES[name[1]]} force per area of chip", "N/mm²", 1e6)
        return Parameter(name, f"{SIDES[name[1]]} force per length of edge", "N/mm", 1e3)
    if len(name) == 2 and name[1] in SIDES and name[0] in "km":
        if name[0] == "k":
            return Parameter(name, f"{SIDES[name[1]]} force on a chip of 1 mm × 1 mm, per mm²", "N/mm²", 1e6)
        return Parameter(name, f"{SIDES[name[1]]} exponent: the force grows as h^(1−m)", "1", 1.0)
    if name in _RUNOUT:
        return Parameter(name, _RUNOUT[name], "µm", 1e-6)
    if name in _WORDS:
        return Parameter(*_WORDS[name])
    return Parameter(name, "", "", 1.0)


def law_in_words(law: str) -> str:
    """The law of the force as a sentence begins."""
    return {"linear-edge": "Linear-edge law", "kienzle": "Kienzle law"}.get(law, law)


def time_unit(duration: float) -> tuple[float, str]:
    """The unit that a time of so many seconds is shown in: its length in s, and its name.

    >>> time_unit(0.4), time_unit(12.0), time_unit(480.0)
    ((0.001, 'ms'), (1.0, 's'), (60.0, 'min'))
    """
    if duration >= 300:
        return 60.0, "min"
    return (1.0, "s") if duration >= 0.5 else (1e-3, "ms")


def conditions_in_words(c: CuttingConditions) -> str:
    """The conditions of a cut in one line, shop-floor units."""
    width = "slot" if c.direction == "slot" else f"a_e {nominal(c.radial_depth * 1e3)} mm {c.direction}"
    return (
        f"{to_shop(c.spindle_speed, 'spindle_speed_rpm'):.0f} rpm, f_z {nominal(c.feed_per_tooth * 1e3)} mm, "
        f"a_p {nominal(c.axial_depth * 1e3)} mm, {width}"
    )


def cutter_in_words(cutter: Cutter) -> list[tuple[str, str]]:
    """The cutter as pairs of what and how much."""
    facts = [
        ("diameter", f"{nominal(cutter.diameter * 1e3)} mm"),
        ("teeth", str(cutter.teeth)),
        ("helix", f"{nominal(degrees(cutter.helix))}°"),
    ]
    if cutter.pitch is not None:
        facts.append(("pitch", ", ".join(f"{fixed(degrees(pitch), 1)}°" for pitch in cutter.pitch)))
    if cutter.runout:
        facts.append(("runout", f"{significant(cutter.runout * 1e6)} µm at {fixed(degrees(cutter.runout_angle), 0)}°"))
    return facts


@dataclass(frozen=True)
class Verdict:
    """The answer in plain words: a level for colour and sign, a headline and what stands behind it."""

    level: str  # good, part, bad, none
    sign: str
    head: str
    text: str


_SIGNS = {"good": "✓", "part": "!", "bad": "✕", "none": "i"}


def judged(level: str, head: str, text: str) -> Verdict:
    """A verdict with the sign of its level: good, part, bad or none."""
    return Verdict(level, _SIGNS[level], head, text)


def fit_level(fit: Coefficients | CoefficientHistory | ForceHarmonics) -> str:
    """good, part or bad as the verdict of the fit begins; none where it says something else."""
    beginnings = {"does not fit": "bad", "fits in part": "part", "fits": "good"}
    return next((level for begins, level in beginnings.items() if fit.verdict.strip().startswith(begins)), "none")


def fit_verdict(fit: Coefficients | CoefficientHistory | ForceHarmonics) -> Verdict:
    """What the verdict of the fit means for the one who wants to use the coefficients."""
    level, why = fit_level(fit), fit.verdict.partition(":")[2]
    cuts = "the 1 cut" if len(fit.cuts) == 1 else f"the {len(fit.cuts)} cuts"
    if level == "bad":
        text = why.strip() or "; ".join(check.message for check in fit.checks if not check.passed)
        warning = "Do not use the coefficients as material constants."
        return judged(level, f"The force model does not fit {cuts}", f"{_sentence(text)} {warning}".strip())
    if level == "part":
        text = f"{_sentence(why)} Take the coefficients as provisional.".strip()
        return judged(level, f"The force model fits {cuts} in part", text)
    if level == "good":
        return judged(level, f"The force model fits {cuts}", _sentence(why))
    return judged(level, _sentence(fit.verdict).rstrip("."), "")


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Each file's name without its folder, as long as no two files share it.

    >>> short_names(["cuts/a.csv", "cuts/b.csv"])["cuts/a.csv"], short_names(["1/a.csv", "2/a.csv"])["1/a.csv"]
    ('a.csv', '1/a.csv')
    """
    full = list(dict.fromkeys(names))
    last = [PurePath(name).name or name for name in full]
    return {name: short if last.count(short) == 1 else name for name, short in zip(full, last, strict=True)}


def cut_names(names: Iterable[str]) -> dict[str, str]:
    """What a cut is called: its file without folder and ending, as long as no two cuts share that.

    A name that has lost its ending before stays as it is, whatever points are in it.

    >>> cut_names(["cuts/f0.05.csv", "f0.1"]), cut_names(["a.csv", "a.h5"])
    ({'cuts/f0.05.csv': 'f0.05', 'f0.1': 'f0.1'}, {'a.csv': 'a.csv', 'a.h5': 'a.h5'})
    """
    short = short_names(names)
    bare = {name: re.sub(r"(?<=.)\.[A-Za-z]\w*$", "", PurePath(name).name) or name for name in short}
    taken = list(bare.values())
    return {name: bare[name] if taken.count(bare[name]) == 1 else short[name] for name in short}


_SPELT: tuple[
    tuple[re.Pattern[str], Callable[[re.Match[str]], str]], ...
] = (  # how messages spell it, and what is shown
    (re.compile(r"(?<=\d )um\b(?![-.]\w)"), lambda _: "µm"),
    (re.compile(r"(?<![\w.-])((?:N/)?mm|cm|m/s)\^?([23])\b(?![-.]\w)"), lambda unit: unit[1] + "²³"[int(unit[2]) - 2]),
    (re.compile(r"\bR2(?= of\b)"), lambda _: "R²"),
    (re.compile(r"(?<=\d)%(?!\w)"), lambda _: " %"),
)


def spelt(text: str) -> str:
    """A message with its units as a page can show them; names of files and keys stay.

    >>> spelt("4.5 um, 820 N/mm2, 10.4% in z"), spelt("cut-um.csv: coefficients.Ktc_N_per_mm2")
    ('4.5 µm, 820 N/mm², 10.4 % in z', 'cut-um.csv: coefficients.Ktc_N_per_mm2')
    """
    for pattern, shown in _SPELT:
        text = pattern.sub(shown, text)
    return text


@dataclass(frozen=True)
class Question:
    """What a check asks: what holds where it passes and where it fails, and where in the report to see a failure."""

    passed: str
    failed: str
    place: str = ""  # id of a figure or a section
    look: str = ""


HISTORY_PLACES = {"specific-force", "coefficient-history", "innovations"}  # ids of a page of a history
QUESTIONS = {
    "axis-map": Question("Signs and sizes agree with the axis map", "Signs or sizes speak against the axis map"),
    "untested": Question("Enough cuts to test the model", "Too few cuts to test the model"),
    "asynchronous": Question(
        "The force follows the spindle",
        "Some force does not follow the spindle",
        "quality",
        "the rest that no harmonic of the spindle explains: chatter or drift",
    ),
    "contact-loss": Question(
        "The teeth stay in contact",
        "Teeth lose contact by runout",
        "harmonics",
        "harmonic 1 and the others between the tooth passings, which are runout",
    ),
    "above-tooth-passing": Question(
        "Harmonics above the tooth passing are as predicted",
        "Harmonics above the tooth passing exceed the prediction",
        "harmonics",
        "measured dots above the rings of the model",
    ),
    "resonance": Question(
        "A resonance explains the excess",
        "A resonance does not explain the excess",
        "harmonics",
        "whether the excess sits near one frequency, as that of a resonance would",
    ),
    "left-out": Question(
        "Cuts left out are predicted",
        "Cuts left out are not predicted",
        "coefficients",
        "each cut predicted from the others",
    ),
    "mean-force": Question(
        "Mean forces lie on a line",
        "Mean forces do not lie on a line",
        "mean-force",
        "measured dots that bend away from the line of the model",
    ),
    "line": Question(
        "R² of the mean forces is above 0.9",
        "R² of the mean forces is below 0.9",
        "mean-force",
        "the differences, and how large they are beside the force",
    ),
    "offset": Question(
        "Alternating and mean forces agree",
        "Alternating and mean forces contradict each other",
        "intervals",
        "what the alternating force alone and the mean forces say of each coefficient",
    ),
    "residuals": Question(
        "The model leaves no more than noise",
        "The model leaves more than noise",
        "force",
        "the difference of measured and modelled force beside the range of the noise",
    ),
    "pace": Question(
        "The coefficients change slowly beside the teeth",
        "The coefficients change as fast as the teeth pass",
        "coefficient-history",
        "swings from one tooth to the next",
    ),
    "air cut": Question(
        "An air cut tells the offset of the amplifier",
        "No air cut tells the offset of the amplifier",
        "force",
        "a difference of measured and modelled force that is not about zero",
    ),
    "mean force": Question(
        "The mean forces are met",
        "The mean forces are not met",
        "force",
        "the mean of measured and modelled force over a revolution",
    ),
    "innovations": Question(
        "Nothing but noise was not foreseen",
        "More than noise was not foreseen",
        "innovations",
        "means off zero and rms above 1, and when",
    ),
    "separable": Question(
        "The record tells the coefficients of a direction apart",
        "The record does not tell the coefficients of a direction apart",
        "coefficient-history",
        "how wide their bands are beside that of the specific force",
    ),
    "frf": Question(
        "The FRF explains the accelerations",
        "The FRF does not explain the accelerations",
        "accelerations",
        "whether one sensor or one harmonic is off, or all are",
    ),
    "law": Question(
        "The law explains the force",
        "The force is none of this law",
        "law-distance",
        "at which harmonics the force by itself is far from that of the law",
    ),
    "sensors": Question(
        "No sensor is off",
        "Some sensor is off",
        "accelerations",
        "the row of that sensor",
    ),
    "signs": Question(
        "The coefficients have the signs of a tool that cuts",
        "The coefficients have signs of no tool that cuts",
        "coefficients",
        "which of them are negative",
    ),
    "angle": Question(
        "The angle of tooth 0 is known",
        "The angle of tooth 0 is wrong or not known",
        "reconstruction",
        "the angle of tooth 0",
    ),
    "precision": Question(
        "Ktc and Krc are known well enough",
        "Ktc or Krc are hardly known",
        "coefficients",
        "how wide their intervals are, and which of them no harmonic shows",
    ),
    "minimum": Question("The fit stands at its minimum", "The fit did not end"),
    "modes": Question("The modes are the measured FRF", "The modes are not the measured FRF"),
    "models": Question(
        "The models agree on Ktc", "Ktc depends on the model", "coefficients", "what other models say of the same cuts"
    ),
}


def question(name: str) -> Question:
    """What the check of this name asks; a name that is not known stands for itself."""
    words = name.replace("-", " ")
    words = words[:1].upper() + words[1:]
    return QUESTIONS.get(name) or Question(words, words)


def channels_in_words(channels: Iterable[Mapping[str, Any]]) -> str:
    """What was recorded: the directions of each quantity with its unit."""
    kinds: dict[str, list[str]] = {}
    for channel in channels:
        unit = str(channel.get("unit") or "").replace("^2", "²")
        kind = f"{str(channel.get('quantity') or 'channel').replace('_', ' ')}{', ' + unit if unit else ''}"
        kinds.setdefault(kind, []).append(str(channel.get("dof") or channel.get("name") or ""))
    return "; ".join(f"{kind}: {' '.join(dofs)}" for kind, dofs in kinds.items())


def percent(share: float | None) -> str:
    """A probability in per cent, never rounded to certainty.

    >>> percent(0.954), percent(0.9999), percent(0.0001), percent(None)
    ('95 %', '> 99 %', '< 1 %', '–')
    """
    if share is None or share != share:
        return "–"
    if share > 0.995:
        return "> 99 %"
    return "< 1 %" if share < 0.005 else f"{100 * share:.0f} %"


def _sentence(text: str) -> str:
    """With a capital, unless it begins with a symbol, and a full stop."""
    text = text.strip()
    if re.match(r"[a-z]{2,}(?=[ ,])", text):
        text = text[0].upper() + text[1:]
    return text if not text or text[-1] in ".!?" else text + "."
