"""What a simulation knows, as JSON in the units of the shop."""

from millcal.units import to_shop


def rounded(value: float) -> float:
    """Nine digits: what is left by a change of unit, and by another machine's order of summing."""
    return float(f"{value:.9g}")


def shop_values(**values: float) -> dict[str, float]:
    """SI values in the unit of their key."""
    return {key: rounded(to_shop(value, key)) for key, value in values.items()}
