"""Write numbers and quantities for people."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))

#: Probability of a certain conclusion, the usual level of confidence.
SURE = 0.95

#: Standard gravity in m/s2, by definition (CGPM 1901): the "g" of sensors.
STANDARD_GRAVITY = 9.80665

IN_SI = {
    "acceleration": {
        "m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "mm/s2": 1e-3, "cm/s2": 1e-2, "gal": 1e-2,
        "in/s2": 0.0254, "ft/s2": 0.3048,
    },
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "in/s": 0.0254},
    "displacement": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254},
    "force": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
}  # fmt: skip
#: Units of a channel: the measured quantity and the unit's size in m/s2, m/s, m or N (SI, international foot and
#: pound).
CHANNEL_UNITS = {unit: (kind, size) for kind, units in IN_SI.items() for unit, size in units.items()}

#: Smallest mass in kg that is written in tonnes.
TONNES = 1e4

#: Range of sizes that are written without a power of ten.
PLAIN = (1e-4, 1e6)

MOST_DECIMALS = 6

#: Smallest displayed value of a flexibility; a larger unit of force raises a smaller value above this.
LEAST_PER_FORCE = 0.1

#: Smallest count of consecutive numbers that is written as "first to last".
LONG_ROW = 4

#: Largest relative standard deviation that is not shown.
NEGLIGIBLE_STD = 1e-9

#: Half width of the interval that holds 95 % of a normal distribution, in standard deviations.
NORMAL_95 = 1.959963984540054

UNKNOWN = "not determined"


@dataclass(frozen=True)
class Units:
    """Units for display, by the size of the values.

    Parameters
    ----------
    relative : bool, optional
        Whether the total mass is unknown and set to 1. Masses are then shown as fractions of the total, and stiffnesses
        per total mass.
    """

    relative: bool = False

    def of_mass(self, values: Iterable[float]) -> tuple[float, str]:
        """Return the size of the display unit of masses in kg, and its name."""
        return (1.0, "of the total") if self.relative else fitting(values, "kg")

    def of_stiffness(self, values: Iterable[float]) -> tuple[float, str]:
        """Return the size of the display unit of stiffnesses in N/m, and its name."""
        return (1.0, "1/s² per total mass") if self.relative else fitting(values, "N/m")


AUTOMATIC = Units()


def exponential(value: float, digits: int = 2) -> str:
    """Write a number as a power of ten with `digits` significant digits; zero is written as 0."""
    return "0" if value == 0 else f"{value:.{digits - 1}e}"


def significant(value: float | None, digits: int = 4) -> str:
    """Write a number with `digits` significant digits; None and nan become a dash."""
    if value is None or math.isnan(value):
        return "–"
    if value == 0:
        return "0"
    if not PLAIN[0] <= abs(value) < PLAIN[1]:
        return exponential(value, digits)
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    shown = f"{value:.{decimals}f}"
    return shown.rstrip("0").rstrip(".") if "." in shown else shown


def significants(values: Sequence[float | None], digits: int = 4) -> list[str]:
    """Write numbers in one format, with `digits` significant digits of the largest."""
    sizes = [abs(value) for value in values if value is not None and math.isfinite(value)]
    largest = max(sizes, default=0.0)
    if not PLAIN[0] <= largest < PLAIN[1]:
        return [significant(value, digits) for value in values]
    decimals = max(0, digits - 1 - math.floor(math.log10(largest)))
    return ["–" if value is None or math.isnan(value) else f"{value:.{decimals}f}" for value in values]


def percent(value: float | None, digits: int = 2) -> str:
    """Write a ratio as percent; a value too small for the digits, but not zero, becomes "< 0.01 %"."""
    if value is None or math.isnan(value):
        return "–"
    least = 10.0**-digits
    if 0 < abs(100 * value) < 0.5 * least:
        return f"< {least:.{digits}f} %"
    return f"{100 * value:.{digits}f} %"


def signed(value: float, decimals: int) -> str:
    """Write a number with its sign; a number that rounds to zero has no sign."""
    shown = f"{value:+.{decimals}f}"
    return shown[1:] if not shown.strip("+-0.") else shown


def percents(values: Sequence[float | None], *, sign: bool = False) -> list[str]:
    """Write ratios as percent in one format, with at least two significant digits of the largest."""
    sizes = [abs(100 * value) for value in values if value is not None and math.isfinite(value)]
    largest = max(sizes, default=0.0)
    digits = 2 if largest == 0 else min(max(2, 1 - math.floor(math.log10(largest))), MOST_DECIMALS)
    if not sign:
        return [percent(value, digits) for value in values]
    return ["–" if value is None or math.isnan(value) else f"{signed(100 * value, digits)} %" for value in values]


def column_name(name: str, unit: str = "") -> str:
    """Name a column of a machine-readable table with its unit, such as story_stiffness_std_N_per_m.

    Parameters
    ----------
    name : str
    unit : str, optional
        Empty for a quantity without a unit.
    """
    plain = unit.replace("²", "2").replace("/", "_per_").replace(" ", "_")
    return f"{name}_{plain}" if plain else name


def probability(value: float | None) -> str:
    """Write a p-value; a tiny one becomes "< 1e-9"."""
    if value is None:
        return "–"
    return "< 1e-9" if value < 1e-9 else f"{value:.2g}"


def equals(value: float) -> str:
    """Write a p-value for a sentence: "p = 0.012", "p < 1e-9"."""
    shown = probability(value)
    return f"p {shown}" if shown.startswith("<") else f"p = {shown}"


def chance(value: float) -> str:
    """Write a probability in percent, limited to "< 0.1 %" and "> 99.9 %"."""
    if value < 0.0005:
        return "< 0.1 %"
    return "> 99.9 %" if value > 0.9995 else f"{100 * value:.1f} %"


def with_std(value: float | None, std: float | None, unit: str = "", factor: float | None = None) -> str:
    """Write value ± std, with at least two significant digits of the standard deviation.

    Parameters
    ----------
    value, std : float or None
    unit : str, optional
    factor : float, optional
        Size of the shown unit in the unit of the value. Default: choose a prefix by the size of the value.
    """
    if value is None or math.isnan(value):
        return UNKNOWN
    if factor is None:
        factor, unit = fitting([value], unit)
    value = value / factor
    if std is None or not math.isfinite(std) or std <= NEGLIGIBLE_STD * abs(value):
        return f"{significant(value, 5)} {unit}".strip()
    std = std / factor
    largest = max(abs(value), std)
    if abs(value) >= PLAIN[1] or largest < PLAIN[0]:
        power = math.floor(math.log10(largest))
        return f"({_to_digits(value / 10.0**power, std / 10.0**power)})e{power:+03d} {unit}".strip()
    return f"{_to_digits(value, std)} {unit}".strip()


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Write a value with `digits` significant digits and a unit prefix that fits its size."""
    factor, unit = fitting([value], unit)
    return f"{significant(value / factor, digits)} {unit}"


def per_force(value: float, std: float | None, unit: str) -> str:
    """Write a flexibility ± its standard deviation with a readable unit of force: "1.4 rad/(MN m)".

    Parameters
    ----------
    value, std : float
    unit : str
        Unit with N in the denominator, such as "m/N" or "rad/(N m)".
    """
    factor, prefix = next((each for each in reversed(PREFIXES) if abs(value) * each[0] >= LEAST_PER_FORCE), PREFIXES[0])
    above, line, below = unit.partition("/")
    unit = f"{above}{line}{below.replace('N', f'{prefix}N', 1)}"
    return with_std(value * factor, None if std is None else std * factor, unit, 1.0)


def _to_digits(value: float, std: float) -> str:
    decimals = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def with_stds(values: Sequence[float], stds: Sequence[float]) -> list[str]:
    """Write each value ± std in one format; a value may lack a standard deviation.

    The format shows at least two digits of the largest standard deviation and one of the smallest.
    """
    known = [std for std in stds if math.isfinite(std) and std > 0]
    if known:
        two, one = 1 - math.floor(math.log10(max(known))), -math.floor(math.log10(min(known)))
    decimals = min(max(two, one, 0), MOST_DECIMALS) if known else MOST_DECIMALS - 2
    return [
        "–" if math.isnan(value)
        else f"{value:.{decimals}f} ± {std:.{decimals}f}" if math.isfinite(std) and std > 0
        else f"{value:.{decimals}f}"
        for value, std in zip(values, stds, strict=True)
    ]  # fmt: skip


def fitting(values: Iterable[float], unit: str) -> tuple[float, str]:
    """Choose the size and name of a unit that fits the values: tonnes for kg, prefixes for N and N/m."""
    if unit == "kg":
        heavy = max((abs(value) for value in values if not math.isnan(value)), default=0.0) >= TONNES
        return (1e3, "t") if heavy else (1.0, "kg")
    return scaled(values, unit) if unit.startswith("N") else (1.0, unit)


def scaled(values: Iterable[float], unit: str) -> tuple[float, str]:
    """Choose a factor and a prefixed unit in which the values are easy to read."""
    largest = max((abs(value) for value in values if not math.isnan(value)), default=1.0)
    return next((size, f"{prefix}{unit}") for size, prefix in PREFIXES if largest >= 10 * size or not prefix)


def counted(number: int, noun: str) -> str:
    """Write a count and its noun, which is plural unless the count is 1."""
    return f"{number} {noun if number == 1 else _plural(noun)}"


def _plural(noun: str) -> str:
    return f"{noun.removesuffix('y')}ies" if noun.endswith("y") else f"{noun}s"


def numbered(noun: str, numbers: Sequence[int]) -> str:
    """Name things by their ascending numbers: "floor 2", "stories 1, 3"."""
    return f"{noun if len(numbers) == 1 else _plural(noun)} {ranged(numbers)}"


def ranged(numbers: Sequence[int]) -> str:
    """Write ascending numbers; long runs of consecutive numbers are shortened: "1, 11 to 20"."""
    rows: list[list[int]] = []
    for number in numbers:
        if rows and number == rows[-1][-1] + 1:
            rows[-1].append(number)
        else:
            rows.append([number])
    return ", ".join(f"{row[0]} to {row[-1]}" if len(row) >= LONG_ROW else ", ".join(map(str, row)) for row in rows)


def capital(text: str) -> str:
    """Write the first letter as a capital."""
    return text[:1].upper() + text[1:]


def listed(words: Sequence[str], last: str = "and") -> str:
    """Join words: "a", "a and b", "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""
