"""Tables and numbers as the terminal shows them."""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Rows under a header, columns two blanks apart; numbers to the right, texts to the left."""
    shown = [[cell(item) for item in row] for row in rows]
    numeric = [all(_is_number(row[i]) for row in shown) for i in range(len(header))]
    widths = [max([len(name), *(len(row[i]) for row in shown)]) for i, name in enumerate(header)]
    lines = [
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        )
        for line in [list(header), *shown]
    ]
    return "\n".join(line.rstrip() for line in lines)


def cell(item: Any) -> str:
    """Four digits are enough to read, and all four are shown; a dash is what is not known."""
    if item is None or (isinstance(item, float) and not isfinite(item)):
        return "-"
    if isinstance(item, float):
        return f"{item:.0f}" if abs(item) >= 999.95 or item == 0 else f"{item:#.4g}"
    return str(item)


def interval(bounds: Sequence[float | None] | None) -> str:
    """`12.00 to 14.00`, a dash where neither end is known."""
    if bounds is None or all(bound is None for bound in bounds):
        return "-"
    return " to ".join(cell(bound) for bound in bounds)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True
