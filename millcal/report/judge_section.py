"""What the page says of judged cuts: the verdict of each, the lines that do not follow the spindle, and its figures."""

from collections.abc import Sequence
from dataclasses import replace

from millcal.data import Judgement
from millcal.report import blocks, judge_figure
from millcal.report.digits import significant
from millcal.report.wording import Verdict, cut_names
from millcal.report.wording import judged as verdict_of
from millcal.units import to_shop

LEVELS = {"stable": "good", "period-n": "bad", "chatter": "bad", "not known": "none"}
MOST = 6  # cuts that are drawn


def verdicts(found: Sequence[Judgement]) -> list[Verdict]:
    """The answer on each cut."""
    short = cut_names([cut.name for cut in found])
    said = []
    for cut in found:
        what = f"period {cut.period}" if cut.verdict == "period-n" else cut.verdict
        at = "" if cut.chatter_frequency is None else f" at {significant(cut.chatter_frequency, 4)} Hz"
        said.append(
            verdict_of(LEVELS[cut.verdict], f"{short[cut.name]}: {what}{at}", f"{cut.why[0].upper()}{cut.why[1:]}.")
        )
    return said


def sections(found: Sequence[Judgement]) -> list[dict | None]:
    """One section for each cut."""
    short = cut_names([cut.name for cut in found])
    return [_section(cut, short[cut.name], number) for number, cut in enumerate(found[:MOST])]


def _section(cut: Judgement, name: str, number: int) -> dict | None:
    figures = [replace(figure, name=f"{figure.name}-{number}") for figure in judge_figure.figures(cut)]
    return blocks.section(
        f"judged-{number}",
        f"Was that chatter: {name}",
        blocks.facts("The cut", _facts(cut)),
        *map(blocks.figure, figures),
    )


def _facts(cut: Judgement) -> list[tuple[str, str]]:
    _, unit, factor = judge_figure.SYMBOLS[cut.quantity]
    known = [
        ("channel", f"{cut.channel}, {cut.quantity.replace('_', ' ')}"),
        (
            "spindle speed",
            f"{60 * cut.spindle_frequency:.6g} rpm, {cut.teeth} {'tooth' if cut.teeth == 1 else 'teeth'}",
        ),
        ("judged", f"{cut.revolutions} turns from {cut.steady[0]:.4g} to {cut.steady[1]:.4g} s"),
    ]
    beat = judge_figure.BEAT[cut.per]
    if cut.metric is not None:
        known.append((f"M, change from {beat} to {beat}", f"{significant(factor * cut.metric, 3)} {unit}"))
    if cut.chatter_frequency is not None:
        known.append(("chatter frequency", f"{cut.chatter_frequency:.5g} Hz, {cut.chatter_share:.0%} of the power"))
    speeds = [f"{to_shop(speed, 'spindle_speed_rpm'):.0f}" for speed in cut.speeds_near()]
    if speeds:
        known.append(("speeds it points to, the nearest first", f"{', '.join(speeds[:6])} rpm"))
    known += [("note", notice.message) for notice in cut.notices if notice.code == "alias" and notice.level == "note"]
    return known
