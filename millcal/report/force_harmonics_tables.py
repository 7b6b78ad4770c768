"""Tables of a force that accelerations tell: its harmonics, the sensors, what the law demands, the methods, the next speeds."""

from math import degrees, isfinite

import numpy as np

from millcal.data import ForceHarmonics, SpeedAdvice
from millcal.report.digits import UNKNOWN, fixed, nominal, plus_minus, significant
from millcal.report.force_harmonics_figures import NORMAL, OUTSIDE, amplitude_sd, normalised, there
from millcal.report.speed_advice_figure import cutting_first, in_rpm
from millcal.report.tables import LINEAR_EDGE, SHADES, Table
from millcal.report.tables import coefficients as with_untold
from millcal.report.wording import cut_names, parameter

METHODS = {
    "ls": "least squares at each harmonic (ls)",
    "tls": "total least squares at each harmonic (tls)",
    "tikhonov": "regularised least squares at each harmonic (tikhonov)",
    "constrained-ls": "least squares that obeys the law's equations between the harmonics (constrained-ls)",
    "rtls": "total least squares that obeys the law's equations between the harmonics (rtls)",
    "gtls": "total least squares weighted by the noise of cut and FRF, within the law (gtls)",
}
FITTED_WITH = {"gcv": "generalised cross-validation", "l-curve": "the L-curve", "discrepancy": "the expected residual"}
MOST_LINES = 60  # of the harmonics that are listed
MOST_ORDERS = 14  # columns of the residuals
USELESS = 0.1  # of an even share: a sensor that hardly counts


def harmonics(forces: ForceHarmonics) -> Table:
    """Every line: amplitude with standard deviation and phase along each axis, and the condition of the FRF there."""
    deviation, size = amplitude_sd(forces), np.abs(forces.force)
    names, several = cut_names(forces.cuts), len(forces.cuts) > 1
    rows = []
    lowest = np.argsort(forces.order, kind="stable")[:MOST_LINES]
    for k in np.sort(lowest).tolist():
        cells = []
        for row in range(len(forces.axes)):
            value, sd = float(size[k, row]), float(deviation[k, row])
            cells += [significant(value), significant(sd, 2) if isfinite(sd) else UNKNOWN]
            cells.append(_phase(complex(forces.force[k, row])) if not value < 2 * sd else UNKNOWN)
        named = [names[forces.cuts[int(forces.cut[k])]]] if several else []
        rows.append(
            [
                *named,
                _named(forces, float(forces.order[k])),
                fixed(float(forces.frequency[k]), 1),
                *cells,
                fixed(float(forces.condition[k]), 1),
            ]
        )
    per_axis = ["peak, N", "sd, N", "phase, °"] * len(forces.axes)
    first = ["cut"] if several else []
    note = (
        "Harmonics of the spindle, in brackets which of the tooth passing. Force on the tool, amplitude of the cosine; its phase "
        "counts from tooth 0 at the bottom and stands where the amplitude exceeds two standard deviations."
    )
    if len(rows) < len(forces.cut):
        note = f"The lowest {len(rows)} of {len(forces.cut)}. {note}"
    return Table(
        "The harmonics in numbers",
        [*first, "harmonic", "Hz", *per_axis, "condition"],
        rows,
        groups=(("", 2 + several), *((f"F{axis}", 3) for axis in forces.axes), ("", 1)),
        words=(0,) if several else (),
        note=note,
    )


def _phase(force: complex) -> str:
    """In whole degrees above -180."""
    angle = round(degrees(float(np.angle(force))))
    return fixed(180.0 if angle == -180 else angle, 0)


def _named(forces: ForceHarmonics, order: float) -> str:
    """A harmonic of the spindle, and which of the tooth passing it is: 4 (2)."""
    number = order / forces.cutter.teeth
    whole = abs(number - round(number)) < 1e-9
    return f"{nominal(order)} ({round(number)})" if whole else nominal(order)


def coefficients(forces: ForceHarmonics) -> Table:
    """Every coefficient of the linear-edge law with its interval; those that no line shows say so."""
    names = LINEAR_EDGE if forces.posterior.law == "linear-edge" else ()
    missing = [name for name in names if name not in forces.posterior.names]
    return with_untold(forces.posterior, missing, note=untold_in_words(forces))


def untold_in_words(forces: ForceHarmonics) -> str:
    """What of the law no line shows, in a sentence; nothing where all is shown."""
    told = [" and ".join(names) if len(names) > 1 else names[0] for names in forces.unobservable if names]
    alone = [words for words, names in zip(told, forces.unobservable, strict=True) if len(names) == 1]
    mixed = [words for words, names in zip(told, forces.unobservable, strict=True) if len(names) > 1]
    parts = []
    if alone:
        parts.append(f"No harmonic of these cuts shows {_and(alone)}: accelerations cannot tell {_them(alone)}.")
    if mixed:
        parts.append(f"One combination is not told in each of: {'; '.join(mixed)}.")
    return " ".join(parts)


def _and(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _them(words: list[str]) -> str:
    return "it" if len(words) == 1 else "them"


def sensors(forces: ForceHarmonics) -> Table | None:
    """What each sensor adds and how well it fits; None where neither is known."""
    if not there(forces.sensor_residual) and not there(forces.sensor_share):
        return None
    left, even = normalised(forces), 1 / len(forces.sensors)
    known_ones = forces.sensor_residual[np.isfinite(forces.sensor_residual)]
    usual = float(np.median(known_ones)) if len(known_ones) else np.nan
    rows = []
    for row, sensor in enumerate(forces.sensors):
        share, residual = float(forces.sensor_share[row]), float(forces.sensor_residual[row])
        known = np.flatnonzero(np.isfinite(left[:, row]))
        worst = int(known[np.argmax(left[known, row])]) if len(known) else -1
        rows.append(
            [
                sensor,
                fixed(100 * share, 0),
                _noise_share(forces, row),
                fixed(float(np.sqrt(residual)), 2),
                f"{fixed(float(left[worst, row]), 1)} at {fixed(float(forces.frequency[worst]), 0)} Hz"
                if known.size
                else UNKNOWN,
                sensor_in_words(residual, share / even, 2 * len(forces.cut), usual),
            ]
        )
    headings = ("sensor", "share, %", "cut noise, %", "difference / expected", "largest", "")
    note = (
        "Share: how much of what is known of the coefficients comes from this sensor. Difference: rms over the harmonics "
        "of measured less FRF times force, beside what noise and FRF let expect; 1 where all is right. Cut noise: its part in "
        "that expectation; where it is small a better impact test helps, where it is large a longer cut."
    )
    return Table("Sensors", headings, rows, words=(0, 5), note=note)


def _noise_share(forces: ForceHarmonics, row: int) -> str:
    """How much of the variance that is expected of a sensor is noise of the cut; the rest is of the FRF."""
    if forces.noise is None:
        return UNKNOWN
    whole = float(np.sum(forces.deviation[:, row] ** 2))
    return fixed(100 * float(np.sum(forces.noise[:, row] ** 2)) / whole, 0) if whole > 0 else UNKNOWN


def sensor_in_words(residual: float, share: float, dof: int, usual: float) -> str:
    """A word about a sensor.

    residual : mean square over the expected one   share : times an even one   dof : real numbers behind the residual
    usual : the residual that half of the sensors exceed; where all are off, it is none of them
    """
    if not isfinite(residual):
        return "not tested" if not share < USELESS else "tells nothing"
    if residual > (1 + NORMAL * 2**0.5 * dof**-0.5) ** 2 + 0.25:
        if not residual > 2 * usual:
            return "! off, as others are: see FRF and law"
        off = "far off" if residual > 4 else "off"
        return f"✕ {off}: check its place, direction and sensitivity"
    return "✓ fits, but tells hardly anything" if share < USELESS else "✓ fits"


def residuals(forces: ForceHarmonics) -> Table | None:
    """How far each sensor is off at each harmonic, shaded where noise does not explain it; None without expectations.

    Several cuts share a column: rms over them.
    """
    left = normalised(forces)
    if not there(left):
        return None
    orders = np.unique(forces.order)
    cells = np.stack([_rms(left[forces.order == order]) for order in orders], axis=1)  # (sensor, order)
    count = np.array([np.count_nonzero(forces.order == order) for order in orders])
    kept = np.arange(len(orders))
    if len(orders) > MOST_ORDERS:
        worst = np.argsort(-np.nan_to_num(cells).max(axis=0), kind="stable")[:MOST_ORDERS]
        kept = np.sort(worst)
    limit = 1 + (OUTSIDE - 1) / np.sqrt(count)
    rows, levels = [], []
    for row, sensor in enumerate(forces.sensors):
        rows.append([sensor, *(fixed(float(cells[row, k]), 1) for k in kept)])
        levels.append([None, *(_level(float(cells[row, k] / limit[k])) for k in kept)])
    note = (
        "|measured − FRF × force| over what is expected of it. Shaded where noise explains it in less than one case of "
        "twenty: a row is a sensor in doubt, a column a harmonic at which FRF, noise or law are in doubt."
    )
    if len(forces.cuts) > 1:
        note += f" Rms over {len(forces.cuts)} cuts."
    if len(kept) < len(orders):
        note += f" The worst {len(kept)} of {len(orders)} harmonics."
    one = len(forces.cuts) == 1
    headings = ["harmonic", *(nominal(float(orders[k])) for k in kept)]
    if one:
        at = {float(order): float(f) for order, f in zip(forces.order, forces.frequency, strict=True)}
        headings = ["", *(f"{nominal(float(orders[k]))} ({fixed(at[float(orders[k])], 0)} Hz)" for k in kept)]
    return Table("Which sensor and which harmonic do not fit", headings, rows, note=note, levels=levels, shade="doubt")


def residuals_by_cut(forces: ForceHarmonics) -> Table | None:
    """The same over all sensors for each cut, where there are several."""
    left = normalised(forces)
    if len(forces.cuts) < 2 or not there(left):
        return None
    names = cut_names(forces.cuts)
    rows, levels = [], []
    for number, name in enumerate(forces.cuts):
        here = forces.cut == number
        value = float(_rms(left[here].ravel()[:, np.newaxis])[0])
        spread = 1 + (OUTSIDE - 1) / max(int(here.sum()) * len(forces.sensors), 1) ** 0.5
        angle, sd = degrees(float(forces.phase[number])), degrees(float(forces.phase_sd[number]))
        turned = plus_minus(angle, angle - NORMAL * sd, angle + NORMAL * sd) if sd > 0 else fixed(angle, 1)
        rows.append([names[name], str(np.count_nonzero(here)), fixed(value, 2), turned])
        levels.append([None, None, _level(value / spread), None])
    note = "Rms over sensors and harmonics; 1 where all is right. The angle is that of tooth 0 where the cut was counted from."
    headings = ("cut", "harmonics", "difference / expected", f"tooth 0, ° ({forces.phase_from})")
    return Table("Which cut does not fit", headings, rows, note=note, levels=levels, shade="doubt")


def _rms(values: np.ndarray) -> np.ndarray:
    """Over the first axis, of what is known; nan where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.sum(np.where(known, values, 0.0) ** 2, axis=0)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


def _level(times: float) -> int | None:
    """How dark a cell is that is so many times the limit; none below it."""
    if not times > 1:
        return None
    return int(min(1 + 3 * np.log2(times), SHADES - 1))


def law(forces: ForceHarmonics, note: str = "") -> Table:
    """What the law demands of the harmonics and what they tell of it."""
    lines, axes = len(forces.cut), len(forces.axes)
    rows = [
        [
            "real numbers that the harmonics are",
            str(2 * lines * axes),
            f"{lines} harmonic{'s' if lines > 1 else ''}, {axes} {'axes' if axes > 1 else 'axis'}",
        ],
        ["combinations of coefficients that they show", str(forces.rank), "rank of the law"],
        ["real equations between the harmonics", str(forces.constraint_rows), "what the law leaves no choice in"],
        [
            "those linear in the complex harmonics",
            str(forces.complex_rows),
            "all that a complex constraint would catch",
        ],
    ]
    return Table("What the law demands", ("", "number", ""), rows, words=(0, 2), note=note)


def compared(forces: ForceHarmonics) -> Table | None:
    """Every coefficient by every method; None where only one was tried."""
    if len(forces.compared_methods) < 2 or not there(forces.compared):
        return None
    headings = ["method"]
    for name in forces.posterior.names:
        headings.append(f"{name}, {parameter(name).unit}")
    rows = []
    for k, method in enumerate(forces.compared_methods):
        cells = []
        for i, name in enumerate(forces.posterior.names):
            factor = parameter(name).factor
            value, half = float(forces.compared[k, i]) / factor, NORMAL * float(forces.compared_sd[k, i]) / factor
            cells.append(plus_minus(value, value - half, value + half) if isfinite(half) else significant(value))
        rows.append([f"{method} ◂ recommended" if method == forces.recommended else method, *cells])
    note = "± is 95 %; a method without it cannot say how far off it may be."
    return Table("Every method", headings, rows, note=note)


def best_speeds(advice: SpeedAdvice | None) -> Table | None:
    """The speeds for the next cut, best first."""
    if advice is None or not advice.best:
        return None
    order = np.argsort(advice.spindle_speed)
    speed = advice.spindle_speed[order]
    shown = cutting_first(advice.names)
    rows = []
    for number, best in enumerate(advice.best, 1):
        nearest = order[int(np.argmin(np.abs(speed - best)))]
        rows.append(
            [
                str(number),
                fixed(float(in_rpm([best])[0]), 0),
                *(significant(100 * float(advice.relative_sd[nearest, column]), 2) for column in shown),
                fixed(float(advice.condition[nearest]), 1),
                nominal(float(advice.worst_harmonic[nearest])),
            ]
        )
    headings = (
        "", "speed, rpm", *(f"sd of {advice.names[column]}, %" for column in shown), "condition", "told worst",
    )  # fmt: skip
    note = (
        f"Expected of one cut with {advice.harmonics} harmonics of the tooth passing. Told worst: the harmonic of the tooth "
        "passing at which the FRF tells the directions of the force apart worst."
    )
    return Table("Speeds for the next cut", headings, rows, note=note)
