"""How numbers and quantities are written for people."""

from __future__ import annotations

import math

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))


def significant(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits; a dash for none."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.{digits}g}" if 1e-4 <= abs(value) < 1e6 or value == 0 else f"{value:.{digits - 1}e}"


def percent(value: float | None, digits: int = 2) -> str:
    """A ratio as percent."""
    return "–" if value is None or math.isnan(value) else f"{100 * value:.{digits}f} %"


def probability(value: float | None) -> str:
    """A probability, short where it is tiny."""
    if value is None:
        return "–"
    return "< 1e-9" if value < 1e-9 else f"{value:.2g}"


def with_std(value: float | None, std: float | None, unit: str = "", factor: float = 1.0) -> str:
    """value ± std, the value to the digits that the standard deviation leaves meaningful."""
    if value is None or math.isnan(value):
        return "not determined"
    value = value / factor
    if std is None or math.isnan(std) or std <= 0:
        return f"{significant(value, 5)} {unit}".strip()
    std = std / factor
    if abs(value) >= 1e6 or max(abs(value), std) < 1e-3:
        return f"{value:.3e} ± {std:.1e} {unit}".strip()
    decimals = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{decimals}f} ± {std:.{decimals}f} {unit}".strip()


def scaled(values: list[float], unit: str) -> tuple[float, str]:
    """A factor and a prefixed unit in which the values are easy to read."""
    largest = max((abs(value) for value in values if not math.isnan(value)), default=1.0)
    for factor, prefix in PREFIXES:
        if largest >= 10 * factor or factor == 1.0:
            return factor, f"{prefix}{unit}"
    return 1.0, unit
