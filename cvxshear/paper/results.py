"""A printed figure beside the recomputed one."""

from __future__ import annotations

from dataclasses import dataclass

from cvxshear.paper import tables
from cvxshear.util.typing import Json

EXACT = "to the last digit"
ROUNDED = "from rounded figures"
MISPRINT = "misprint"
DIFFERS = "differs"


@dataclass(frozen=True)
class Row:
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

    @property
    def difference(self) -> float:
        """Recomputed less printed."""
        return self.recomputed - tables.value(self.printed)

    @property
    def agrees(self) -> bool:
        """Whether the recomputed figure, rounded to the printed number of digits, is the printed one."""
        return same_digits(self.recomputed, self.printed)

    @property
    def distance(self) -> float | None:
        """The difference in standard deviations of what chance makes of it; None where no chance is involved."""
        return None if self.chance is None else self.difference / self.chance

    @property
    def verdict(self) -> str:
        """In words; empty where the paper gives no more than a rough figure."""
        if self.misprint:
            return MISPRINT
        if self.distance is not None:
            return f"{self.distance:+.1f} standard errors"
        if self.printed.startswith("about"):
            return ""
        if self.agrees:
            return EXACT
        if self.from_rounded is not None and same_digits(self.from_rounded, self.printed):
            return ROUNDED
        return DIFFERS

    def to_dict(self) -> Json:
        """The fields and what follows from them."""
        return {
            "what": self.what,
            "where": self.where,
            "printed": self.printed,
            "recomputed": self.recomputed,
            "difference": self.difference,
            "agrees": self.agrees,
            "from_rounded": self.from_rounded,
            "std_error": self.std_error,
            "distance": self.distance,
            "misprint": self.misprint,
            "verdict": self.verdict,
        }


@dataclass(frozen=True)
class Section:
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

    def to_dict(self) -> Json:
        """Title, rows and notes."""
        return {"title": self.title, "rows": [row.to_dict() for row in self.rows], "notes": list(self.notes)}


@dataclass(frozen=True)
class Reproduction:
    """The paper's figures and ours.

    Parameters
    ----------
    sections : tuple of Section
    backend : str
    samples : tuple of int
        Numbers of random samples of Table 3.
    seed : int
    """

    sections: tuple[Section, ...]
    backend: str
    samples: tuple[int, ...]
    seed: int

    @property
    def rows(self) -> tuple[Row, ...]:
        """All rows of all sections."""
        return tuple(row for section in self.sections for row in section.rows)

    @property
    def summary(self) -> str:
        """How many figures agree, in a sentence or two."""
        results = [row for section in self.sections if section.counted for row in section.rows]
        fixed = [row for row in results if row.chance is None and not row.printed.startswith("about")]
        counts = {name: sum(row.verdict == name for row in fixed) for name in (EXACT, ROUNDED, MISPRINT, DIFFERS)}
        return (
            f"{len(fixed)} printed results that no chance is involved in: {counts[EXACT]} are met to the last printed "
            f"digit, {counts[ROUNDED]} more once computed, as the paper did, from its own rounded figures, "
            f"{counts[MISPRINT]} is a misprint, {counts[DIFFERS]} differ."
        )

    def section(self, title: str) -> Section:
        """The first section whose title begins so."""
        return next(each for each in self.sections if each.title.startswith(title))

    def to_dict(self) -> Json:
        """The documented JSON."""
        return {
            "backend": self.backend,
            "samples": list(self.samples),
            "seed": self.seed,
            "summary": self.summary,
            "sections": [section.to_dict() for section in self.sections],
        }


def same_digits(number: float, printed: str) -> bool:
    """Whether a number rounds to a printed one, a zero of either sign being zero."""
    count = tables.decimals(printed)
    return round(number, count) == round(tables.value(printed), count)
