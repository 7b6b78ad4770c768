"""The figure of the advice on speeds: how well one more cut would tell the coefficients, against its spindle speed."""

from collections.abc import Sequence

import numpy as np

from millcal.data import CuttingConditions, SpeedAdvice
from millcal.report.charts import Frame, Item, Line, Marks, Panel, Rule, Tags, chart, decades_of
from millcal.report.figures import Column, Figure
from millcal.units import to_shop


def cutting_first(names: Sequence[str]) -> list[int]:
    """Columns that are drawn: Ktc, Krc and Kac as far as there are, else all."""
    cutting = [column for column, name in enumerate(names) if name.endswith("c")]
    return cutting or list(range(len(names)))


def in_rpm(speeds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Spindle speeds as the shop has them.   speeds : (n,) rad/s   returns (n,) rpm"""
    return np.asarray(to_shop(np.asarray(speeds, float), "spindle_speed_rpm"))


def expected_spread(advice: SpeedAdvice | None, conditions: Sequence[CuttingConditions] = ()) -> Figure | None:
    """Expected standard deviations against the speed, best speeds and those of the cuts marked; None without advice."""
    if advice is None or len(advice.spindle_speed) < 2 or not advice.names:
        return None
    rpm = in_rpm(advice.spindle_speed)
    percent = 100 * advice.relative_sd
    shown = cutting_first(advice.names)
    order = np.argsort(rpm, kind="stable")
    best = in_rpm(advice.best)
    cuts = np.unique(np.round(in_rpm([c.spindle_speed for c in conditions])))
    inside = cuts[(cuts >= rpm.min()) & (cuts <= rpm.max())]
    items: list[Item] = [Rule(float(speed), "x", "border") for speed in inside]
    items += [
        Line(rpm[order], percent[order, column], f"shade{k}", advice.names[column]) for k, column in enumerate(shown)
    ]
    items.append(Tags(best.tolist(), [str(number) for number in range(1, len(best) + 1)]))
    y_range = decades_of(*(percent[:, column] for column in shown))
    for column in shown:
        at_best = np.interp(best, rpm[order], percent[order, column])
        items.append(Marks(best, at_best, "best", "diamond", size=4))
    under: list[Item] = [Rule(float(speed), "x", "border") for speed in inside]
    under.append(Line(rpm[order], advice.condition[order], "main"))
    low, high = decades_of(advice.condition)
    panels = [
        Panel("expected standard deviation, %", items, 190, y_range, log=True),
        Panel("condition number", under, 70, (low, max(high, 2 * low)), log=True, most_ticks=3),
    ]
    names = ", ".join(advice.names[column] for column in shown)
    svg = chart(
        panels,
        x_label="spindle speed, rpm",
        x_range=(float(rpm.min()), float(rpm.max())),
        label=f"Expected relative standard deviation of {names} after one more cut against its spindle speed; the best is "
        f"{best[0]:.0f} rpm" if len(best) else f"Expected relative standard deviation of {names} against spindle speed",
        frame=Frame(right=88.0),
        hover=True,
    )  # fmt: skip
    columns = [Column("spindle speed", "rpm", rpm)]
    columns += [Column(f"{name} sd", "%", percent[:, k]) for k, name in enumerate(advice.names)]
    columns += [
        Column("condition number", "", advice.condition),
        Column("worst harmonic of the tooth passing", "", advice.worst_harmonic.astype(float)),
    ]
    key = []
    if len(best):
        key.append(("marks diamond best", "best speeds, best first"))
    if len(inside):
        key.append(("line border", "speeds of the cuts"))
    beyond = len(cuts) - len(inside)
    out = f" {beyond} of the speeds cut so far lie outside the picture." if beyond else ""
    caption = (
        "What one more cut with the accelerometers would leave of doubt, with all that is known already. Where the curve "
        f"rises, a harmonic falls where the FRF does not tell the directions of the force apart.{out}"
    )
    return Figure("speed-advice", "At which speed to cut next", caption, (svg,), columns, key, hint="spindle speed")
