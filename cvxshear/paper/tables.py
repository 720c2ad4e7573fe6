"""Printed figures of the paper as text, which keeps the number of printed digits.

The source is "High precision identification method of mass and stiffness matrix for shear-type frame test model",
Sections 5 and 6. Cases 1 and 2 are its two initial masses. "Present" is its own method, "Ref. [23]" Qi's, "Ref. [17]"
Berman's.
"""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

PRINTED: dict[str, Any] = tomllib.loads(
    resources.files("cvxshear.paper").joinpath("printed.toml").read_text(encoding="utf-8")
)
"""Tables of figures; the file says what each holds, and in which unit."""

MISPRINT = ("berman", "1", "23")
"""Method, case and entry of Table 1 that differs from the formula's value."""


def note(name: str, **gaps: object) -> str:
    """Return a note for readers of the recomputed figures."""
    words: str = PRINTED["notes"][name]
    return words.format(**gaps)


def value(printed: str) -> float:
    """Read a printed figure as a number."""
    return float(printed.removeprefix("about "))


def decimals(printed: str) -> int:
    """Count the printed decimals."""
    return len(printed.partition(".")[2])


def values(printed: Sequence[str]) -> Floats:
    """Read printed figures as numbers."""
    return np.array([value(each) for each in printed])


TO_THE_DIGIT = "to the last digit"
ROUNDED = "from rounded figures"
MISPRINTED = "misprint"
DIFFERS = "differs"
"""Possible results of the comparison of a recomputed figure with the printed one."""


@dataclass(frozen=True)
class PaperRow(InJson):
    """One figure.

    Parameters
    ----------
    what : str
        The quantity and its unit.
    where : str
        Place in the paper.
    printed : str
        Figure as printed.
    recomputed : float
    from_rounded : float, optional
        The same figure, computed from other printed figures of the paper.
    std_error : float, optional
        Standard error of a figure from random samples.
    chance : float, optional
        Standard deviation of `difference` if both figures come from different random samples.
    misprint : bool, optional
        Whether the printed figure differs from the paper's own formula.
    """

    what: str
    where: str
    printed: str
    recomputed: float
    from_rounded: float | None = None
    std_error: float | None = None
    chance: float | None = None
    misprint: bool = False

    json_keys = "what where printed recomputed difference agrees from_rounded std_error distance misprint verdict"

    @property
    def difference(self) -> float:
        """Recomputed figure minus printed figure."""
        return self.recomputed - value(self.printed)

    @property
    def agrees(self) -> bool:
        """Whether the recomputed figure, rounded to the printed number of digits, equals the printed one."""
        return same_digits(self.recomputed, self.printed)

    @property
    def distance(self) -> float | None:
        """Difference in standard deviations of random sampling; None for figures without random samples."""
        return None if self.chance is None else self.difference / self.chance

    @property
    def verdict(self) -> str:
        """Comparison of the figures in words; empty if the paper gives only a rough figure."""
        if self.misprint:
            return MISPRINTED
        if self.distance is not None:
            return f"{self.distance:+.1f} standard errors"
        if self.printed.startswith("about"):
            return ""
        if self.agrees:
            return TO_THE_DIGIT
        if self.from_rounded is not None and same_digits(self.from_rounded, self.printed):
            return ROUNDED
        return DIFFERS


@dataclass(frozen=True)
class PaperSection(InJson):
    """The rows of one table or statement of the paper.

    Parameters
    ----------
    title : str
    rows : tuple of PaperRow
    notes : tuple of str, optional
        Notes for readers of the rows.
    printed_in : str, optional
        Header of the printed figures.
    counted : bool, optional
        Whether the rows are results of the paper, which the summary counts, and not its input.
    """

    title: str
    rows: tuple[PaperRow, ...]
    notes: tuple[str, ...] = ()
    printed_in: str = "printed"
    counted: bool = True

    json_keys = "title rows notes"


@dataclass(frozen=True)
class Reproduction(InJson):
    """The paper's figures and ours.

    Parameters
    ----------
    sections : tuple of PaperSection
    backend : str
    samples : tuple of int
        Numbers of random samples of Table 3.
    seed : int
    """

    sections: tuple[PaperSection, ...]
    backend: str
    samples: tuple[int, ...]
    seed: int

    json_keys = "backend samples seed summary sections"

    @property
    def summary(self) -> str:
        """Number of figures that agree, in a sentence or two."""
        results = [row for section in self.sections if section.counted for row in section.rows]
        fixed = [row for row in results if row.chance is None and not row.printed.startswith("about")]
        verdicts = (TO_THE_DIGIT, ROUNDED, MISPRINTED, DIFFERS)
        counts = {name: sum(row.verdict == name for row in fixed) for name in verdicts}
        return (
            f"{len(fixed)} printed results that no chance is involved in: {counts[TO_THE_DIGIT]} are met to the last "
            f"printed digit, {counts[ROUNDED]} more once computed, as the paper did, from its own rounded figures, "
            f"{counts[MISPRINTED]} is a misprint, {counts[DIFFERS]} differ."
        )


def rows(
    where: str, what: str, printed: Sequence[str], found: Sequence[float] | Floats, rounded: Floats | None = None
) -> Iterator[PaperRow]:
    """Pair the figures of one line of a table with ours; `what` has a place for their numbers from 1."""
    from_rounded = [None] * len(printed) if rounded is None else rounded.tolist()
    for place, each in enumerate(zip(printed, found, from_rounded, strict=True), 1):
        yield PaperRow(what.format(place), where, each[0], float(each[1]), each[2])


def same_digits(number: float, printed: str) -> bool:
    """Return whether a number rounds to a printed one; the sign of zero does not matter."""
    count = decimals(printed)
    return round(number, count) == round(value(printed), count)
