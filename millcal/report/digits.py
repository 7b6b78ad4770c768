"""Numbers as a reader wants them: as many digits as their interval deserves, a real minus sign, a dash for the unknown."""

import math
from collections.abc import Sequence

UNKNOWN = "–"
MINUS = "−"


def _known(value: float | None) -> bool:
    return value is not None and not math.isnan(value)


def fixed(value: float | None, decimals: int) -> str:
    """A number with so many decimals; negative decimals round to tens, hundreds ...

    >>> fixed(893.2, -1), fixed(-0.04, 1), fixed(None, 2)
    ('890', '0.0', '–')
    """
    if not _known(value):
        return UNKNOWN
    if math.isinf(value):
        return "∞" if value > 0 else MINUS + "∞"
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    if text.startswith("-"):
        text = text[1:] if not any(digit in text for digit in "123456789") else MINUS + text[1:]
    return text


def rounded_down(value: float | None, decimals: int) -> str:
    """A number to so many decimals, never above it: for what must not be exceeded.

    >>> rounded_down(10.749, 2), rounded_down(1.2, 2), rounded_down(None, 2)
    ('10.74', '1.20', '–')
    """
    if value is None or not math.isfinite(value):
        return fixed(value, decimals)
    return fixed(math.floor(value * 10.0**decimals * (1 + 1e-12)) / 10.0**decimals, decimals)


def significant(value: float | None, digits: int = 3) -> str:
    """A number to so many significant digits, without an exponent wherever that stays readable.

    >>> significant(0.012345), significant(12345.0), significant(0.0), significant(2.5e-7)
    ('0.0123', '12345', '0', '2.50·10⁻⁷')
    """
    if not _known(value) or math.isinf(value):
        return fixed(value, 0)
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if -5 < power < 6:
        return fixed(value, min(max(digits - 1 - power, 0), 9))
    return f"{fixed(value / 10.0**power, digits - 1)}·{ten_to(power)}"


def ten_to(power: int) -> str:
    """10 to a power in raised digits: 10⁻³."""
    return "10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def nominal(value: float | None) -> str:
    """A number that somebody has set, to six digits and without trailing zeros.

    >>> nominal(0.025), nominal(12000.0), nominal(None)
    ('0.025', '12000', '–')
    """
    if not _known(value) or math.isinf(value):
        return fixed(value, 0)
    return f"{value:.6g}".replace("-", MINUS)


def decimals_for(spread: float, value: float = 0.0) -> int:
    """Decimals that show two significant digits of a spread, but never more than six significant digits of the value.

    >>> decimals_for(197.0, 893.0), decimals_for(0.031, 15.8), decimals_for(0.0, 700.0)
    (-1, 3, 3)
    """
    finest = 5 - (math.floor(math.log10(abs(value))) if value else 0)
    if not spread > 0 or math.isinf(spread):
        return finest
    return min(1 - math.floor(math.log10(spread)), finest)


def with_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """A value and the ends of its interval, all to the decimals that the half-width deserves.

    >>> with_interval(893.2, 696.0, 1090.4)
    ('890', '700', '1090')
    """
    if not (_known(low) and _known(high)) or math.isinf(high - low):
        return significant(value, 4), fixed(low, 0), fixed(high, 0)
    decimals = decimals_for((high - low) / 2, value)
    return fixed(value, decimals), fixed(low, decimals), fixed(high, decimals)


def plus_minus(value: float, low: float, high: float) -> str:
    """`890 ± 200`; `890 (700 to 1500)` where the interval is lopsided; the bare value where there is no interval."""
    centre, lowest, highest = with_interval(value, low, high)
    if not (_known(low) and _known(high)) or not high > low or math.isinf(high - low):
        return centre
    below, above = value - low, high - value
    if abs(below - above) > 0.1 * (above + below):
        return f"{centre} ({lowest} to {highest})"
    half = (high - low) / 2
    return f"{centre} ± {fixed(half, decimals_for(half, value))}"


def csv_number(value: float) -> str:
    """A number for a machine: seven significant digits, empty where unknown."""
    return f"{value:.7g}" if math.isfinite(value) else ""


def nice_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers between two ends, 1, 2 or 5 apart times a power of ten, at most so many intervals."""
    span = high - low
    if not span > 0:
        return [low]
    rough = span / most
    power = 10.0 ** math.floor(math.log10(rough))
    steps = [factor * power for factor in (0.2, 0.5, 1, 2, 5, 10)]
    at = next(i for i, step in enumerate(steps) if step >= rough * (1 - 1e-9))
    while at and math.floor(high / steps[at] + 1e-9) - math.ceil(low / steps[at] - 1e-9) < 1:  # one tick shows no scale
        at -= 1
    step = steps[at]
    first = math.ceil(low / step - 1e-9)
    return [
        round(k * step, 12 - math.floor(math.log10(step))) for k in range(first, math.floor(high / step + 1e-9) + 1)
    ]


def log_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Powers of ten between two positive ends; with 2 and 5 between them, or round numbers, where the range is short."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    factors: Sequence[int] = (1, 2, 5) if math.log10(high / low) < 2.1 else (1,)
    stride = max(1, math.ceil((last - first) / most))
    ticks = [factor * 10.0**power for power in range(first, last + 1, stride) for factor in factors]
    inside = [tick for tick in ticks if low <= tick <= high]
    return inside if len(inside) > 1 else [tick for tick in nice_ticks(low, high, most) if tick > 0]


def tick_labels(ticks: Sequence[float]) -> list[str]:
    """Labels of ticks, all with the decimals that the finest of them needs."""
    if not ticks:
        return []
    largest = max(abs(tick) for tick in ticks)
    if largest >= 1e6 or (0 < largest < 1e-3):
        return [significant(tick, 1) if tick else "0" for tick in ticks]
    needed = 0
    for tick in ticks:
        while needed < 6 and abs(tick - round(tick, needed)) > 1e-9 * largest:
            needed += 1
    return [fixed(tick, needed) for tick in ticks]


def log_tick_labels(ticks: Sequence[float]) -> list[str]:
    """Labels of logarithmic ticks: plain from 0.001 to 10000, else powers of ten."""
    labels = []
    for tick in ticks:
        power = round(math.log10(tick)) if math.isclose(tick, 10.0 ** round(math.log10(tick)), rel_tol=1e-9) else None
        plain = 9e-4 < tick < 2e4
        labels.append(f"{tick:.10g}" if plain else ten_to(power) if power is not None else significant(tick, 1))
    return labels
