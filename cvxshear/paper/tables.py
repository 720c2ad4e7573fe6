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

KILO = 1e3
"""The paper prints stiffnesses in kN/m."""

INITIAL_MASS = {1: (9.5, 7.5, 5.5), 2: (7.5, 7.5, 7.5)}
"""Initial floor masses of the two cases of Section 5.1, kg."""

PAPER_METHODS = {"two-stage": "present", "qi": "Ref. [23]", "berman": "Ref. [17]"}
"""Names of the methods: ours, and the paper's."""

ITERATIONS = {1: "14", 2: "16"}
"""Number of iterations of the present method by case (Section 5.1)."""

_PRINTED = tomllib.loads(resources.files("cvxshear.paper").joinpath("printed.toml").read_text(encoding="utf-8"))
"""Tables of figures, with their contents and units."""



def _by_case(name: str) -> dict[tuple[str, int], Any]:
    """Read a table of Section 5 by method and case."""
    return {(method, int(case)): each for method, cases in _PRINTED[name].items() for case, each in cases.items()}


TABLE_1 = {
    key: {(int(place[0]), int(place[1])): text for place, text in entries.items()}
    for key, entries in _by_case("table_1").items()
}
"""Corrected mass matrices, kg, upper triangle: entry (i, j) by method and case."""

MISPRINT = ("berman", 1, (2, 3))
"""Method, case and entry of Table 1 that differs from the formula's value."""

TABLE_2 = dict(sorted(_by_case("table_2").items(), key=lambda item: item[0][1]))
"""Identified story stiffnesses, kN/m, by method and case, the first case first."""

LARGEST_ERRORS = _by_case("largest_errors")
"""Section 5.1: largest relative errors of the floor masses and of the story stiffnesses, percent."""

PARAMETERS = ("m1", "m2", "m3", "k1", "k2", "k3")

TABLE_3 = {float(sigma): tuple(texts) for sigma, texts in _PRINTED["table_3"].items()}
"""Errors of the mean value, percent, by standard deviation of the noise, for each of `PARAMETERS`."""

TABLE_3_SAMPLES = 100
"""Random samples of Table 3 (Section 5.2)."""

FIGURE_6_SIGMA = 0.05
FIGURE_6 = "about 5"
"""Coefficient of variation of mass and stiffness at this noise, percent (Section 5.2)."""

STRUCTURES = ("Structure 1", "Structure 2", "Structure 3")
"""States of the test frame, which differ by their counterweights."""

TABLE_4, TABLE_5, TABLE_6_MASS, TABLE_6_NET_MASS, TABLE_6_STIFFNESS, TABLE_7, TABLE_8 = (
    {structure: tuple(texts) for structure, texts in _PRINTED[f"table_{name}"].items()}
    for name in ("4", "5", "6_mass", "6_net_mass", "6_stiffness", "7", "8")
)
"""Tables of the steel frame by structure, two figures per structure."""

TOTAL_NET_MASS = "31.33"
"""Total mass without counterweights (Section 6), kg."""

NET_MASS_DIFFERENCE = "2.41"
STIFFNESS_DIFFERENCE = "5.73"
LARGEST_FREQUENCY_ERROR = "1.72"
"""Largest differences between the structures, relative to the larger, and largest error of Table 8, percent
(Section 7)."""


def note(name: str, **gaps: object) -> str:
    """Return a note for readers of the recomputed figures."""
    words: str = _PRINTED["notes"][name]
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
