"""The printed figures, as text, so that the number of printed digits is part of them.

High precision identification method of mass and stiffness matrix for shear-type frame test model, Sections 5
and 6. Cases 1 and 2 are its two initial masses; "present" is its own method, "Ref. [23]" Qi's, "Ref. [17]" Berman's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

KILO = 1e3
"""The paper prints stiffnesses in kN/m."""

INITIAL_MASS = {1: (9.5, 7.5, 5.5), 2: (7.5, 7.5, 7.5)}
"""Initial floor masses of the two cases of Section 5.1, kg."""

PAPER_METHODS = {"two-stage": "present", "qi": "Ref. [23]", "berman": "Ref. [17]"}
"""Our name of each method, and the paper's."""

ITERATIONS = {1: "14", 2: "16"}
"""Section 5.1, of the present method."""

TABLE_1 = {
    ("two-stage", 1): {(1, 1): "10", (2, 2): "7.5", (3, 3): "5"},
    ("two-stage", 2): {(1, 1): "10", (2, 2): "7.5", (3, 3): "5"},
    ("qi", 1): {(1, 1): "9.911", (2, 2): "7.563", (3, 3): "5.236"},
    ("qi", 2): {(1, 1): "9.379", (2, 2): "7.525", (3, 3): "6.164"},
    ("berman", 1): {
        (1, 1): "10.016", (1, 2): "0.226", (1, 3): "0", (2, 2): "7.597", (2, 3): "-0.004", (3, 3): "5.177",
    },
    ("berman", 2): {
        (1, 1): "10.081", (1, 2): "1.129", (1, 3): "0", (2, 2): "7.984", (2, 3): "0.565", (3, 3): "5.887",
    },
}  # fmt: skip
"""Corrected mass matrices, kg, upper triangle: entry (i, j) by method and case."""

MISPRINT = ("berman", 1, (2, 3))
"""Where Table 1 does not print what its formula gives."""

TABLE_2 = {
    ("two-stage", 1): ("1.800", "1.200", "0.600"),
    ("qi", 1): ("1.824", "1.193", "0.609"),
    ("berman", 1): ("1.819", "1.153", "0.609"),
    ("two-stage", 2): ("1.800", "1.200", "0.600"),
    ("qi", 2): ("1.884", "1.131", "0.633"),
    ("berman", 2): ("1.888", "0.962", "0.640"),
}
"""Identified story stiffnesses, kN/m, by method and case."""

LARGEST_ERRORS = {
    ("qi", 1): ("4.72", "1.50"),
    ("qi", 2): ("23.28", "5.75"),
    ("berman", 1): ("3.54", "3.92"),
    ("berman", 2): ("17.74", "19.83"),
}
"""Section 5.1: largest relative errors of the floor masses and of the story stiffnesses, percent."""

PARAMETERS = ("m1", "m2", "m3", "k1", "k2", "k3")

TABLE_3 = {
    0.01: ("0.038", "-0.055", "0.008", "0.060", "-0.031", "-0.022"),
    0.02: ("-0.003", "-0.008", "0.017", "0.307", "-0.119", "-0.147"),
    0.03: ("-0.065", "0.265", "-0.267", "-0.103", "0.196", "-0.316"),
    0.04: ("-0.516", "0.280", "0.611", "-0.786", "-0.108", "0.397"),
    0.05: ("-0.303", "0.595", "-0.286", "-0.093", "0.257", "-0.667"),
}
"""Errors of the mean value, percent, by standard deviation of the noise, for each of `PARAMETERS`."""

TABLE_3_SAMPLES = 100
"""Random samples of Table 3 (Section 5.2)."""

FIGURE_6_SIGMA = 0.05
FIGURE_6 = "about 5"
"""Section 5.2: the coefficient of variation of mass and stiffness at that noise, percent."""

STRUCTURES = ("Structure 1", "Structure 2", "Structure 3")
"""The states of the test frame, by their counterweights."""

TABLE_4 = {"Structure 1": ("13.5", "8.6"), "Structure 2": ("27.5", "22.6"), "Structure 3": ("41", "36.1")}
"""Counterweights on floors 1 and 2, kg."""

TOTAL_NET_MASS = "31.33"
"""Total mass without counterweights (Section 6), kg."""

TABLE_5 = {"Structure 1": ("2.990", "7.934"), "Structure 2": ("2.380", "6.331"), "Structure 3": ("2.030", "5.420")}
"""Measured natural frequencies, Hz."""

TABLE_6_MASS = {
    "Structure 1": ("26.545", "26.885"),
    "Structure 2": ("40.238", "41.192"),
    "Structure 3": ("53.730", "54.700"),
}
"""Identified floor masses, counterweights included, kg."""

TABLE_6_NET_MASS = {
    "Structure 1": ("13.045", "18.285"),
    "Structure 2": ("12.738", "18.592"),
    "Structure 3": ("12.730", "18.600"),
}
"""Identified floor masses without counterweights, kg."""

TABLE_6_STIFFNESS = {
    "Structure 1": ("25.517", "25.176"),
    "Structure 2": ("25.019", "24.239"),
    "Structure 3": ("24.054", "23.842"),
}
"""Identified story stiffnesses, kN/m."""

TABLE_7 = {"Structure 1": ("3.030", "7.932"), "Structure 2": ("2.421", "6.329"), "Structure 3": ("2.065", "5.418")}
"""Analytical natural frequencies, Hz."""

TABLE_8 = {"Structure 1": ("1.338", "-0.025"), "Structure 2": ("1.723", "-0.032"), "Structure 3": ("1.724", "-0.037")}
"""Relative errors of the analytical natural frequencies, percent (Eq. 29)."""

NET_MASS_DIFFERENCE = "2.41"
STIFFNESS_DIFFERENCE = "5.73"
LARGEST_FREQUENCY_ERROR = "1.72"
"""Section 7, percent: largest differences between the structures, relative to the larger, and largest of Table 8."""


def value(printed: str) -> float:
    """Read a printed figure as a number."""
    return float(printed.removeprefix("about "))


def decimals(printed: str) -> int:
    """How many decimals it is printed with."""
    return len(printed.partition(".")[2])


def values(printed: tuple[str, ...]) -> Floats:
    """Read printed figures as numbers."""
    return np.array([value(each) for each in printed])


TO_THE_DIGIT = "to the last digit"
ROUNDED = "from rounded figures"
MISPRINTED = "misprint"
DIFFERS = "differs"
"""How a recomputed figure compares with the printed one."""


@dataclass(frozen=True)
class Row(InJson):
    """One figure.

    Parameters
    ----------
    what : str
        The quantity and its unit.
    where : str
        In the paper.
    printed : str
        As it stands there.
    recomputed : float
    from_rounded : float, optional
        The same figure computed from other figures of the paper as they are printed.
    std_error : float, optional
        Of a recomputed figure that rests on random samples.
    chance : float, optional
        Standard deviation of `difference` where printed and recomputed figure rest on other random samples.
    misprint : bool, optional
        Whether the paper does not print what its own formula gives.
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
        """Recomputed less printed."""
        return self.recomputed - value(self.printed)

    @property
    def agrees(self) -> bool:
        """Whether the recomputed figure, rounded to the printed number of digits, is the printed one."""
        return same_digits(self.recomputed, self.printed)

    @property
    def distance(self) -> float | None:
        """Difference in standard deviations of what chance makes of it; None where no chance is involved."""
        return None if self.chance is None else self.difference / self.chance

    @property
    def verdict(self) -> str:
        """How the figures compare, in words; empty where the paper gives no more than a rough one."""
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
class Section(InJson):
    """The rows of one table or statement of the paper.

    Parameters
    ----------
    title : str
    rows : tuple of Row
    notes : tuple of str, optional
        What a reader of the rows should know.
    printed_in : str, optional
        Header of the figures that ours are compared with.
    counted : bool, optional
        Whether these are results of the paper, which the summary counts; not what went in.
    """

    title: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    printed_in: str = "printed"
    counted: bool = True

    json_keys = "title rows notes"


def same_digits(number: float, printed: str) -> bool:
    """Whether a number rounds to a printed one, a zero of either sign being zero."""
    count = decimals(printed)
    return round(number, count) == round(value(printed), count)
