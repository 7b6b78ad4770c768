"""The figures of the modes: fitted over measured FRFs, the stabilisation chart, the shapes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import ModalFit, Modes
from millcal.report.charts import (
    HALF,
    SMALL,
    Band,
    Frame,
    Item,
    Line,
    Marks,
    Panel,
    Rule,
    Tags,
    chart,
    decades_of,
    thin,
)
from millcal.report.digits import fixed, log_tick_labels, log_ticks
from millcal.report.driving_points import FORMS, PHASE_MIDDLE
from millcal.report.figures import Column, Figure
from millcal.report.modal_curves import (
    FittedPair,
    cross_pairs,
    driving_pairs,
    fitted_in_words,
    fitted_pair,
    magnitudes_drawn,
    marks_drawn,
    mean_magnitude,
    mode_names,
    share,
)

MOST_DRIVING = 6  # driving points that are drawn
MOST_CROSS = 9  # other FRFs that are drawn
POINTS = 500  # of a curve
MOST_NAMED = 40  # dofs of a shape that are named one by one
POLES = (
    ("marks dot stable-pole", "stable pole"),
    ("marks ring faint-pole", "other pole"),
    ("line faint behind", "all FRFs, root mean square"),
    ("line rule", "a mode that was taken"),
)
DIRECTIONS = {"x": "dot", "y": "square", "z": "diamond"}  # the mark of a direction


def key(fit: ModalFit) -> list[tuple[str, str]]:
    """What the lines over the FRFs are."""
    return [
        ("line under", "measured"),
        ("line over", fitted_in_words(fit)),
        ("span left", "what the fit leaves"),
        ("line rule", "a mode"),
    ]


def driving_points(modes: Modes, fit: ModalFit) -> list[Figure]:
    """Fitted over measured for each driving point: magnitude with what is left, and phase."""
    figures = []
    for output, given in driving_pairs(fit)[:MOST_DRIVING]:
        pair = fitted_pair(modes, fit, output, given)
        panels = [_magnitude(modes, fit, pair, 180.0, magnitudes_drawn(pair)), _phase(modes, fit, pair)]
        figures.append(_figure(fit, output, given, pair, panels, HALF))
    return figures


def cross(modes: Modes, fit: ModalFit) -> list[Figure]:
    """The same for the other pairs, magnitudes only and on one scale, so that they compare."""
    shown = {at: fitted_pair(modes, fit, *at) for at in cross_pairs(fit)[:MOST_CROSS]}
    if not shown:
        return []
    y_range = magnitudes_drawn(*shown.values())
    return [
        _figure(fit, *at, pair, [_magnitude(modes, fit, pair, 120.0, y_range)], SMALL) for at, pair in shown.items()
    ]


def _magnitude(modes: Modes, fit: ModalFit, pair: FittedPair, height: float, y_range: tuple[float, float]) -> Panel:
    symbol, unit, _ = FORMS[fit.form]
    marks = marks_drawn(modes, (float(pair.frequency[0]), float(pair.frequency[-1])))
    rules: list[Item] = [Rule(frequency, "x") for frequency, _ in marks]
    tags = Tags([frequency for frequency, _ in marks], [number for _, number in marks])
    left = _line(pair, pair.left, "")
    lines = [
        Band(left.x, np.full(len(left.x), y_range[0] / 10), left.y, "left"),
        _line(pair, pair.measured, "under"),
        _line(pair, pair.fitted, "over"),
    ]
    return Panel(f"|{symbol}|, {unit}", [*rules, *lines, tags], height, y_range, log=True, most_ticks=6)


def _line(pair: FittedPair, values: np.ndarray, kind: str) -> Line:
    kept = _kept(pair, values, POINTS)
    return Line(pair.frequency[kept], values[kept], kind)


def _kept(pair: FittedPair, values: np.ndarray, most: int) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return thin(pair.frequency, np.log(values), most)


def _phase(modes: Modes, fit: ModalFit, pair: FittedPair) -> Panel:
    middle = PHASE_MIDDLE[fit.form]
    quarter = [(angle, fixed(angle, 0)) for angle in (middle - 90.0, middle, middle + 90.0)]
    marks = marks_drawn(modes, (float(pair.frequency[0]), float(pair.frequency[-1])))
    items: list[Item] = [Rule(frequency, "x") for frequency, _ in marks]
    for phase, kind in ((pair.measured_phase, "under"), (pair.fitted_phase, "over")):
        kept = thin(pair.frequency, phase, POINTS)
        leaps = np.flatnonzero(np.abs(np.diff(phase[kept])) > 180.0) + 1  # from one branch to the next
        items.append(Line(*(np.insert(v[kept], leaps, np.nan) for v in (pair.frequency, phase)), kind))
    return Panel("phase, deg", items, 84.0, (middle - 135.0, middle + 135.0), ticks=quarter)


def _figure(fit: ModalFit, output: int, given: int, pair: FittedPair, panels: Sequence[Panel], frame: Frame) -> Figure:
    unit = FORMS[fit.form][1]
    to, at = fit.inputs[given], fit.outputs[output]
    left = share(float(fit.residual[output, given]))
    driving = len(panels) > 1
    label = (
        f"{fit.form} from {to} to {at} against frequency, measured and fitted with {len(fit.residue)} modes: magnitude"
        f"{' and phase' if driving else ''}; {left} is left unexplained"
    )
    ends = (float(pair.frequency[0]), float(pair.frequency[-1]))
    svg = chart(panels, x_label="frequency, Hz", x_range=ends, x_log=_wide(ends), label=label, frame=frame, hover=True)
    kept = _kept(pair, pair.fitted, 500 if driving else 250)
    numbers = {
        ("frequency", "Hz"): pair.frequency,
        ("measured", unit): pair.measured,
        ("fitted", unit): pair.fitted,
        ("left", unit): pair.left,
    }
    if driving:
        numbers |= {("measured phase", "deg"): pair.measured_phase, ("fitted phase", "deg"): pair.fitted_phase}
    columns = [Column(*what, values[kept]) for what, values in numbers.items()]
    name = f"fit-{output}-{given}"
    if driving:
        return Figure(
            name, f"Hammer {to}, response {at}", f"Left by the fit: {left}.", (svg,), columns, hint="frequency"
        )
    return Figure(name, f"{at} over {to}: {left} left", "", (svg,), columns, hint="frequency")


def _wide(ends: tuple[float, float]) -> bool:
    """Whether a band is so wide that its low modes want a logarithmic scale."""
    return ends[0] > 0 and ends[1] > 6 * ends[0]


def stabilisation(modes: Modes, fit: ModalFit) -> Figure | None:
    """Every pole of every order; a mode of the structure comes again at each order, one of noise does not."""
    if not len(fit.chart_order):
        return None
    symbol, unit, _ = FORMS[fit.form]
    order = np.lexsort((fit.chart_order, fit.chart_frequency))
    f, n, z, stable = (
        v[order] for v in (fit.chart_frequency, fit.chart_order, fit.chart_damping, fit.chart_stable > 0)
    )
    low, high = float(n.min()) - 1.0, float(n.max()) + 1.0
    magnitude = mean_magnitude(fit)
    faintest, strongest = decades_of(magnitude)

    def height(value: np.ndarray) -> np.ndarray:
        """A magnitude as a place of the ordinate, whose numbers are orders."""
        return low + (high - low) * np.log(np.maximum(value, faintest) / faintest) / np.log(strongest / faintest)

    x_range = (float(fit.frequency[0]), float(fit.frequency[-1]))
    marks = marks_drawn(modes, x_range)
    kept = thin(fit.frequency, np.log(np.maximum(magnitude, faintest)), POINTS)
    values = log_ticks(faintest, strongest, 5)
    items: list[Item] = [
        Line(fit.frequency[kept], height(magnitude[kept]), "faint behind"),
        *(Rule(frequency, "x") for frequency, _ in marks),
        Marks(f[~stable], n[~stable], "faint-pole", "ring", size=2.4),
        Marks(f[stable], n[stable], "stable-pole", "dot", size=3.2),
        Tags([frequency for frequency, _ in marks], [number for _, number in marks]),
    ]
    panel = Panel(
        "order of the model",
        items,
        230.0,
        (low, high),
        most_ticks=8,
        right_label=f"rms |{symbol}|, {unit}",
        right_ticks=list(zip(height(np.array(values)).tolist(), log_tick_labels(values), strict=True)),
    )
    label = (
        f"Stabilisation chart: {len(f)} poles of orders {n.min():.0f} to {n.max():.0f} against frequency, {stable.sum()} of them "
        f"stable, and {len(modes.axes)} modes that were taken"
    )
    svg = chart(
        [panel],
        x_label="frequency, Hz",
        x_range=x_range,
        label=label,
        frame=Frame(right=64.0),
        hover=True,
        by_point=True,
    )
    columns = [
        Column("frequency", "Hz", f),
        Column("order", "", n),
        Column("damping", "%", 100 * z),
        Column("stable", "", np.where(stable, "yes", "no")),
    ]
    caption = (
        "A mode of the structure is found again at every order, one of the noise is not. A pole is stable where frequency and "
        "damping are nearly those of the order below; the modes themselves are then fitted anew, all together."
    )
    return Figure("stabilisation", "Stabilisation chart", caption, (svg,), columns, POLES, hint="pole")


def shapes(modes: Modes, fit: ModalFit) -> Figure | None:
    """How far and which way each measured point moves in each mode; None of a single point."""
    dofs, shape = fit.shapes
    if len(dofs) < 2:
        return None
    step = max(16.0 if len(dofs) <= MOST_NAMED else 640.0 / len(dofs), 2.0)
    place = np.arange(len(dofs), dtype=float)
    stride = -(-len(dofs) // MOST_NAMED)
    ticks = [(float(row), dof) for row, dof in enumerate(dofs) if row % stride == 0]
    left = 14.0 + 8.2 * max(len(dof) for _, dof in ticks)  # letters are wider on paper
    svgs = []
    for name, values in zip(mode_names(modes), shape.real, strict=True):
        items: list[Item] = [Rule(0.0, "x", "zero")]
        for side, kind in ((values > 0, "forth"), (values <= 0, "back")):
            stems = np.stack([np.zeros(len(dofs)), values, np.full(len(dofs), np.nan)], axis=1)[side].ravel()
            rows = np.repeat(place[side], 3)
            items.append(Line(stems, rows, kind))
            for mark in ("dot", "square", "diamond"):
                own = np.array([DIRECTIONS.get(dof[-1:].lower(), "dot") == mark for dof in dofs]) & side
                items.append(Marks(values[own], place[own], kind, mark, size=min(3.6, step / 3)))
        panel = Panel(name, items, step * len(dofs) + 6, (len(dofs) - 0.5, -0.5), ticks=ticks)
        words = ", ".join(f"{dof} {fixed(float(v), 2)}" for dof, v in zip(dofs, values, strict=True))
        svgs.append(
            chart(
                [panel],
                x_label="displacement over the largest",
                x_range=(-1.12, 1.12),
                x_ticks=[(-1.0, fixed(-1, 0)), (0.0, "0"), (1.0, "1")],
                label=f"Shape of mode {name}: {words}",
                frame=replace(SMALL, left=left),
            )
        )
    columns = [Column("dof", "", np.array(dofs))]
    for number, values in enumerate(shape, 1):
        columns += [Column(f"mode {number}", "", values.real), Column(f"{number} out of step", "", values.imag)]
    letters = {dof[-1:].lower() for dof in dofs}
    key = [
        (f"marks {mark} forth", f"along {axis}")
        for axis, mark in DIRECTIONS.items()
        if axis in letters and letters <= set(DIRECTIONS)
    ]
    caption = "Right and left are with and against the point that moves most. What moves out of step is in the numbers."
    return Figure("mode-shapes", "Mode shapes", caption, svgs, columns, key, "thirds")
